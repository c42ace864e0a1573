"""Speed against error: every method and tolerance on Example 1 and on a table that throws.

python benchmarks/methods.py
"""

from __future__ import annotations

import timeit

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.hard_spring import HardSpring

CASES = {
    "Example 1, t_inf": (HardSpring(), [2.1, 0.0], 2.0, 1.32961738383844857732),
    "table A, first stick": (BeadOnTable(r=0.3, omega=4.0), [1.5, 0.0], 1.7, 1.52191223348706821),
}
METHODS = ["DOP853", "RK45", "RK23", "Radau", "BDF", "LSODA", "taylor"]


def row(method, rtol, model, start, until, exact):
    options = {"solver": "taylor"} if method == "taylor" else {"method": method}

    def run():
        return hy.simulate(model, start, (0, until), rtol=rtol, atol=1e-12, zeno="stop", **options)

    point = run().zeno[0]
    seconds = min(timeit.repeat(run, number=3, repeat=3)) / 3
    error, bound = abs(point.t - exact), point.t_error
    print(f"{method:8} {rtol:7.0e} {error:9.1e} {bound:9.1e} {1e3 * seconds:8.2f}")


def main():
    for name, case in CASES.items():
        print(f"\n{name}\n{'method':8} {'rtol':>7} {'error':>9} {'bound':>9} {'ms':>8}")
        for method in METHODS:
            for rtol in (1e-6, 1e-9, 1e-12):
                row(method, rtol, *case)


if __name__ == "__main__":
    main()
