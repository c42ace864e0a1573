"""What it costs to pass an accumulation: a run to its limit and on, against its first ten jumps.

    python benchmarks/cost.py

Each is the best of twenty runs at rtol 1e-9; the first ten jumps are simulated one by one. Ratios
hold, milliseconds do not.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import hybrid as hy
from models import bead_on_table, bouncing_ball, hard_spring, two_tanks

RUNS = [
    ("ball", bouncing_ball.BouncingBall(), [1.0, 0.0], (0.0, 3.0)),
    ("Example 1", hard_spring.HardSpring(), [2.1, 0.0], (0.0, 2.0)),
    ("Example 2", bead_on_table.BeadOnTable(r=0.8), [1.9, 0.0], bead_on_table.UNTIL),
    ("two tanks", two_tanks.TwoTanks(), [8.0, 6.0], (0.0, 30.0)),
]


def best(model, start, span, **options):
    """Milliseconds of the best of twenty runs, the first left out."""
    times = []
    for _ in range(21):
        begin = time.perf_counter()
        hy.simulate(model, start, span, rtol=1e-9, save="jumps", **options)
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times[1:])


def main():
    print(f"{'':10} {'solver':8} {'to the limit, ms':>16} {'ten jumps, ms':>14} {'ratio':>6}")
    for name, model, start, span in RUNS:
        tenth = float(hy.simulate(model, start, span, rtol=1e-9).jumps.t[9])
        for solver in ("scipy", "taylor", "diffrax"):
            whole = best(model, start, span, solver=solver)
            cut = {"zeno": "truncate", "max_jumps": 100, "solver": solver}
            ten = best(model, start, (span[0], tenth + 1e-9), **cut)
            print(f"{name:10} {solver:8} {whole:16.2f} {ten:14.2f} {whole / ten:6.2f}")


if __name__ == "__main__":
    main()
