"""Two beads, one above the other, over a floor: do both come to rest, and when?

    python benchmarks/stacks.py

Impacts on the floor accumulate again and again while the upper bead strikes the lower one, and
these accumulations accumulate in turn. Restitutions, heights and speeds are random. The error is
against parabolas and geometric sums (``tests/systems.py``), down to speeds of 1e-10.
"""

from __future__ import annotations

import time

import numpy as np

import hybrid as hy
from tests.systems import Stacked, stacked

COUNT, UNTIL, TIGHT = 60, (0.0, 12.0), {"rtol": 1e-10, "atol": 1e-12}
BOTH = "falls.rest(floor, between)"
METHODS = [
    ("scipy", "DOP853"),
    ("scipy", "RK45"),
    ("scipy", "Radau"),
    ("taylor", None),
    ("diffrax", "Dopri8"),
]


def cases():
    """Columns: restitutions, heights, speeds."""
    random = np.random.default_rng(3)
    a, b = random.uniform(0.0, 0.9, (2, COUNT))
    y, (v, w) = random.uniform(1.001, 1.4, COUNT), random.uniform(-2.0, 2.0, (2, COUNT))
    return np.column_stack([a, b, np.ones(COUNT), y, v, w])


def alone(solver, method, case):
    """When both rest in a run; NaN if they do not."""
    a, b, *start = case
    try:
        run = hy.simulate(Stacked(a=a, b=b), start, UNTIL, solver=solver, method=method, **TIGHT)
    except hy.HybridError:
        return np.nan
    return next((arc.t0 for arc in run.arcs if arc.mode == BOTH), np.nan)


def main():
    table = cases().tolist()
    exact = np.array([stacked(*case) for case in table])
    print(f"{'':18} {'at rest':>8} {'largest error':>14} {'ms a run':>9}")
    for solver, method in METHODS:
        alone(solver, method, table[0])
        begun = time.perf_counter()
        found = np.array([alone(solver, method, case) for case in table])
        spent = 1e3 * (time.perf_counter() - begun) / COUNT
        rests, error = np.isfinite(found).sum(), np.nanmax(np.abs(found - exact))
        print(f"{solver:8} {method or '':9} {rests:5d}/{COUNT} {error:14.1e} {spent:9.1f}")
    a, b, x, y, v, w = np.array(table).T
    start, until = {"x": x, "y": y, "v": v, "w": w}, (0.0, exact + 1e-6)
    lanes = hy.ensemble(Stacked(), start, until, {"a": a, "b": b}, **TIGHT)
    rests = int((lanes["mode"] == BOTH).sum())
    print(f"{'ensemble':18} {rests:5d}/{COUNT} {'< 1e-06':>14}")


if __name__ == "__main__":
    main()
