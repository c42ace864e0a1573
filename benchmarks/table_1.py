"""Table 1 of the paper: Pyragas control, with the memory kept at impacts and restarted there.

    python benchmarks/table_1.py                          # the numbers
    python benchmarks/table_1.py --figures docs/figures   # and the figures of docs/delays.md

The system is ``models/pyragas.py``. Kept: the delay equation as it is written. Restarted: after an
impact the past is the state after it, which is what a solver sees that is started there again and
given no history. See ``docs/delays.md``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import hybrid as hy
from hybrid.pictures.figure import IMPACT, LIMIT, LINE, SURFACE
from models.pyragas import Pyragas

STARTS = (2.1, 2.5, 3.0, 5.0, 10.0, 100.0, 200.0)
EXACT = {"rtol": 1e-12, "atol": 1e-12}

#: What the paper prints; from 2.1 it chatters there.
PERIOD, AMPLITUDE = 1.22, 2.933

MODEL = Pyragas()
LIFTED = Pyragas(C=60.0, r=0.2)
RETURN = hy.return_map(MODEL, "impact", memory="restart", t_max=20.0, **EXACT)


def at_rest(x0, model=MODEL, until=5.0):
    """The run from a constant history, its memory kept."""
    return hy.simulate(model, {"x1": x0, "x2": 0.0}, (0.0, until), **EXACT)


def restarted(x0, until=40.0):
    """The run from a constant history, its memory restarted at impacts."""
    start = {"x1": x0, "x2": 0.0}
    return hy.simulate(MODEL, start, (0.0, until), memory="restart", **EXACT)


def top(arc):
    """The height at which a flight turns."""
    turn = brentq(lambda s: arc.local(s)[1], 0.0, arc.length, xtol=1e-15)
    return float(arc.local(turn)[0])


# ---------------------------------------------------------------------------------------
# the return map of the restarted system: from the speed after an impact to the next such speed


def returned(v):
    return float(RETURN({"x1": MODEL.wall, "x2": v}).x2)


def first_speed(x0):
    """Speed after the first impact from a height."""
    return float(RETURN({"x1": x0, "x2": 0.0}).x2)


def slope(v, h):
    """Derivative of the return map, by differences of the fourth order."""
    near, far = ((returned(v + k * h) - returned(v - k * h)) / (2 * k * h) for k in (1, 2))
    return (4 * near - far) / 3


def repelling():
    """The speed that returns to itself on the border, between chattering and the orbit."""
    return brentq(lambda v: returned(v) - v, 2.0, 2.2, xtol=1e-13)


def orbit():
    """The orbit of the table, with its multipliers."""
    guess = {"x1": MODEL.wall, "x2": 5.7}
    return hy.periodic_orbit(MODEL, guess, section="impact", memory="restart")


# ---------------------------------------------------------------------------------------
# numbers


def rows():
    """For each start what happens with the memory kept, restarted, and in the paper."""
    for x0 in STARTS:
        point = at_rest(x0).zeno[0]
        kept = f"{point.t:.12f} ± {point.t_error:.0e}, {point.verdict}"
        run, paper = restarted(x0), f"{PERIOD}, {AMPLITUDE}"
        if run.zeno:
            yield x0, kept, f"chatters, at rest at {run.zeno[0].t:.10f}", "chatters"
        else:
            yield x0, kept, f"{run.jumps.gaps[-1]:.6f}, {top(run.arcs[-2]) - MODEL.wall:.6f}", paper


def print_numbers():
    print(f"{'x1(0)':>6} | {'kept: at rest at':38} | {'restarted: T, max x1 - 2':30} | paper")
    for x0, kept, again, paper in rows():
        print(f"{x0:6g} | {kept:38} | {again:30} | {paper}")
    low, found = repelling(), orbit()
    print(
        f"\nRestarted, the orbit: T = {found.period:.13f}, max x1 = {found.extrema['x1'][1]:.12f},"
    )
    print(
        f"speed after the impact {found.start.x2:.12f}, multiplier {found.multipliers[1].real:.9f}"
    )
    border = brentq(lambda x0: first_speed(x0) - low, 2.38, 2.39, xtol=1e-14)
    print(f"The orbit that repels: speed {low:.12f}, multiplier {slope(low, 1e-4):.6f};")
    print(f"reached from x1(0) = {border:.12f}: below it chattering, above it the orbit")


# ---------------------------------------------------------------------------------------
# figures


def curve(axes, run):
    """``x1`` over time above the wall; rests are thick, impacts are marked."""
    for arc in run.arcs:
        s = np.linspace(0.0, arc.length, 200)
        thick = 2.6 if ".rest(" in arc.mode else 1.1
        axes.plot(arc.t0 + s, arc.local(s)[:, 0], color=LINE, lw=thick)
    impacts = run.jumps.t[run.jumps.edge == "impact"]
    axes.plot(impacts, np.full(len(impacts), MODEL.wall), ".", color=IMPACT, ms=4, label="impact")
    for number, point in enumerate(run.zeno):
        label = None if number else "accumulation"
        axes.axvline(point.t, color=LIMIT, lw=1, ls="--", label=label)
    high = axes.get_ylim()[1]
    below = MODEL.wall - 0.08 * (high - MODEL.wall)
    axes.axhspan(below, MODEL.wall, color=SURFACE, alpha=0.3, lw=0)
    axes.set_ylim(below, high)
    axes.set_ylabel("$x_1$")
    axes.set_xlim(run.t0, run.t1)


def cobweb(axes, speed, count=12):
    """Speeds after impacts, one after the other."""
    path = [(speed, 0.0)]
    for _ in range(count):
        after = returned(speed)
        path += [(speed, after), (after, after)]
        speed = after
    axes.plot(*np.array(path).T, color=IMPACT, lw=0.9)


def table_figure(path):
    """From x1 = 3 with both memories; the return map of the restarted system."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
    upper = figure.add_subplot(grid[0, 0])
    lower = figure.add_subplot(grid[1, 0], sharex=upper)
    runs = {"memory kept": at_rest(3.0, until=8.0), "memory restarted": restarted(3.0, 8.0)}
    for axes, (what, run) in zip((upper, lower), runs.items(), strict=True):
        curve(axes, run)
        axes.set_title(f"{what} at impacts", fontsize=9)
    upper.legend(fontsize=8, frameon=False)
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("$t$")
    axes = figure.add_subplot(grid[:, 1])
    parts = (0.02, 1.95, 20), (2.0, 3.0, 60), (3.05, 9.0, 40)
    speeds = np.concatenate([np.linspace(*part) for part in parts])
    axes.plot(speeds, [returned(v) for v in speeds], color=LINE, lw=1.4)
    axes.plot([0, 9], [0, 9], color=SURFACE, lw=0.9)
    for x0 in (2.1, 3.0):
        cobweb(axes, first_speed(x0))
    low, high = repelling(), float(orbit().start.x2)
    axes.plot(low, low, "o", color=LIMIT, mfc="white", ms=6)
    axes.plot(high, high, "o", color=LIMIT, ms=6)
    axes.annotate("border", (low, low), (low + 0.4, low - 0.3), fontsize=8)
    axes.annotate("orbit", (high, high), (high + 0.75, high - 0.1), fontsize=8)
    for x0 in (2.1, 3.0):
        axes.annotate(
            f"from {x0:g}", (first_speed(x0), 0.0), (first_speed(x0) + 0.1, 0.15), fontsize=8
        )
    axes.set_title("restarted: the return map", fontsize=9)
    axes.set_xlabel("speed after an impact")
    axes.set_ylabel("speed after the next")
    axes.set_xlim(0.0, 9.0)
    axes.set_ylim(0.0, 9.0)
    axes.set_aspect("equal")
    figure.savefig(path, dpi=150)


def release_figure(path):
    """C = 60, r = 0.2 from 2.5: rests, and the delayed force that ends them."""
    from matplotlib.figure import Figure

    run = at_rest(2.5, LIFTED, 8.0)
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    curve(upper, run)
    t = np.linspace(run.t0, run.t1, 4001)
    seen = np.where(t < LIFTED.tau, 2.5, run(np.maximum(t - LIFTED.tau, 0.0)).x1)
    pull = -9.0 + LIFTED.C * (seen - LIFTED.wall)
    lower.plot(t, pull, color=SURFACE, lw=1)
    for arc in run.arcs:
        if ".rest(" in arc.mode:
            at = (t >= arc.t0) & (t <= arc.t1)
            lower.plot(t[at], pull[at], color=LINE, lw=2.6)
    lower.axhline(0.0, color="black", lw=0.6)
    lower.set_ylabel("$-9 + 60\\,(x_1(t-1) - 2)$")
    lower.set_xlabel("$t$")
    upper.legend(fontsize=8, frameon=False, loc="upper right")
    figure.savefig(path, dpi=150)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--figures", type=Path, help="a folder for the figures")
    given = parser.parse_args()
    if given.figures:
        table_figure(given.figures / "pyragas_table.png")
        release_figure(given.figures / "pyragas_release.png")
    print_numbers()


if __name__ == "__main__":
    main()
