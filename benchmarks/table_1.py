"""Table 1 of the paper: Pyragas control, with the memory kept at impacts and restarted there.

    python benchmarks/table_1.py                          # the numbers
    python benchmarks/table_1.py --figures docs/figures   # and the figures of docs/delays.md

The system is ``models/pyragas.py``; what is computed of it is in
``paper/control/pyragas.py``, for the report on the paper as well. Kept: the delay equation
as it is written. Restarted: after an impact the past is the state after it, which is what a solver
sees that is started there again and given no history. See ``docs/delays.md``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hybrid.plot.figure import Curve, Figure, Panel, column
from hybrid.plot.of_run import states_panel
from hybrid.plot.static import draw
from paper.control.figures import table_figure
from paper.control.pyragas import (
    AMPLITUDE,
    CHATTERS,
    PERIOD,
    STARTS,
    at_rest,
    border,
    model,
    orbit,
    row,
)

#: A system that is released by its past.
LIFTED = {"C": 60.0, "r": 0.2}


def rows():
    """For each start what happens with the memory kept, restarted, and in the paper."""
    for x0 in (CHATTERS, *STARTS):
        found = row(x0)
        kept = f"{found.rests:.12f} ± {found.error:.0e}, "
        kept += "certified" if found.certified else "estimated"
        if found.chatters is not None:
            yield x0, kept, f"chatters, at rest at {found.chatters:.9f}", "chatters"
        else:
            yield x0, kept, f"{found.period:.6f}, {found.amplitude:.6f}", f"{PERIOD}, {AMPLITUDE}"


def print_numbers():
    print(f"{'x1(0)':>6} | {'kept: at rest at':38} | {'restarted: T, max x1 - 2':30} | paper")
    for x0, kept, again, paper in rows():
        print(f"{x0:6g} | {kept:38} | {again:30} | {paper}")
    edge, found = border(), orbit()
    print(
        f"\nRestarted, the orbit: T = {found.period:.13f}, max x1 = {found.extrema['x1'][1]:.12f},"
    )
    print(
        f"speed after the impact {found.start.x2:.12f}, multiplier {found.multipliers[1].real:.9f}"
    )
    print(f"The orbit that repels: speed {edge.speed:.12f}, multiplier {edge.multiplier:.6f};")
    print(f"reached from x1(0) = {edge.start:.12f}: below it chattering, above it the orbit")


def released():
    """C = 60, r = 0.2 from 2.5, its memory kept."""
    return at_rest(2.5, 8.0, **LIFTED)


def release_figure():
    """Rests, and the delayed force that ends them."""
    run, own = released(), model(**LIFTED)
    t = np.linspace(run.t0, run.t1, 4001)
    seen = np.where(t < own.tau, 2.5, run(np.maximum(t - own.tau, 0.0)).x1)
    pull = -9.0 + own.C * (seen - own.wall)
    resting = np.zeros(len(t), dtype=bool)
    for arc in run.arcs:
        resting |= (".rest(" in arc.mode) & (t >= arc.t0) & (t <= arc.t1)
    curves = [
        Curve(x=[run.t0, run.t1], y=[0.0, 0.0], look="surface"),
        Curve(x=t, y=pull, look="other", name="force from the past"),
        Curve(x=t, y=np.where(resting, pull, np.nan), look="rest"),
    ]
    force = Panel(curves=curves, y=f"-9 + {own.C:g} (x1(t - 1) - 2)")
    return Figure(
        name="release",
        title=f"Released by the past: C = {own.C:g}, r = {own.r:g}, from x1 = 2.5",
        columns=column(states_panel(run, "x1", points=4000), force),
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--figures", type=Path, help="a folder for the figures")
    given = parser.parse_args()
    if given.figures:
        draw(table_figure(), given.figures / "pyragas_table.png")
        draw(release_figure(), given.figures / "pyragas_release.png")
    print_numbers()


if __name__ == "__main__":
    main()
