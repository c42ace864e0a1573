"""The pictures of docs/zeno.md, drawn from the runs of that page.

python docs/figures/zeno.py [FOLDER]
"""

import re
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import hybrid as hy
from hybrid.plot.figure import IMPACT_COLOR, LIMIT_COLOR, LINE_COLOR, SURFACE_COLOR

HERE = Path(__file__).parent
WIDTH, INK = 6.4, "#333333"


def runs_of_the_page():
    """What its blocks of Python define."""
    scope = {"__name__": "page"}
    text = (HERE.parent / "zeno.md").read_text()
    with redirect_stdout(StringIO()):
        exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), scope)
    return scope


def panels(count, height, **options):
    """A figure with panels below each other."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, np.atleast_1d(figure.subplots(count, 1, **options))


def curve(axes, run, name="x", color=LINE_COLOR, until=None, **options):
    """A coordinate over time; thicker at rest, in a mode that slides, or after a limit."""
    for arc in run.arcs:
        if until is None or arc.t0 < until:
            tau = np.linspace(0.0, arc.length, 60)
            x = run.spec.record(arc.local(tau))[name]
            stays = ".rest(" in arc.mode or arc.mode.startswith("slide(")
            axes.plot(arc.t0 + (arc.low + tau), x, color=color, lw=2.6 if stays else 1.1, **options)


def mark(axes, t, label):
    """A limit of jumps."""
    axes.axvline(t, color=LIMIT_COLOR, lw=1, ls="--")
    axes.annotate(
        label,
        (t, 1),
        (3, -3),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        va="top",
        color=LIMIT_COLOR,
        fontsize=9,
    )


def ball(page):
    """Height over time; and over the time that is left, where every hop looks alike."""
    run = page["ball"]
    limit = run.zeno[0].t
    figure, (over, left) = panels(2, 4.8)
    curve(over, run)
    over.plot(run.jumps.t, 0 * run.jumps.t, ".", color=IMPACT_COLOR, ms=4)
    mark(over, limit, "t_inf")
    over.set(xlabel="t", ylabel="x")
    flights = [arc for arc in run.arcs if arc.mode == "flight"][:26]
    ends = np.cumsum([0.0] + [arc.length for arc in reversed(run.arcs[:-1])])[::-1]
    for arc, end in zip(flights, ends[1:], strict=False):
        tau = arc.length * np.sin(np.linspace(0.0, np.pi / 2, 200)) ** 2
        height = np.maximum(run.spec.record(arc.local(tau)).x, 1e-12)
        left.loglog(end + arc.length - tau, height, color=LINE_COLOR, lw=1.1)
    left.set(xlim=(3.0, 3e-4), ylim=(3e-9, 3.0), xlabel="t_inf - t", ylabel="x")
    return figure


def bead(page):
    """The bead and the table; and the force of the table, which holds it while positive."""
    run, model = page["bead"], page["Bead"]()
    t = np.linspace(run.t0, run.t1, 1500)
    omega = model.omega
    figure, (heights, force) = panels(2, 4.8, sharex=True)
    heights.plot(t, np.sin(omega * t), color=SURFACE_COLOR, lw=1.2, zorder=0)
    curve(heights, run)
    heights.set_ylabel("x")
    force.axhline(0.0, color=SURFACE_COLOR, lw=0.8)
    load = 9.8 - omega**2 * np.sin(omega * t)
    force.plot(t, load, color=SURFACE_COLOR, lw=0.8, ls=":")
    for point in run.zeno:
        last = point.t_release or run.t1
        held = (t >= point.t) & (t <= last)
        force.plot(t[held], load[held], color=LINE_COLOR, lw=2.6)
        for axes in (heights, force):
            axes.axvline(point.t, color=LIMIT_COLOR, lw=1, ls="--")
        if point.t_release:
            force.plot(last, 0.0, "o", color=IMPACT_COLOR, ms=5)
            heights.plot(last, np.sin(omega * last), "o", color=IMPACT_COLOR, ms=5)
    force.set(xlabel="t", ylabel="force at rest")
    return figure


def tanks(page):
    """Two levels in turn, ever faster, then both in the mode that follows."""
    run = page["tanks"]
    figure, (axes,) = panels(1, 2.8)
    for name, color in (("x1", LINE_COLOR), ("x2", IMPACT_COLOR)):
        curve(axes, run, name, color)
        axes.annotate(name, (0.4, run(0.0)[name]), (0, 4), textcoords="offset points", color=color)
    axes.axhline(5.0, color=SURFACE_COLOR, lw=0.8)
    mark(axes, run.zeno[0].t, "t_inf")
    axes.set(xlabel="t", ylabel="level")
    return figure


def gaps(page):
    """Length of the flights against their number."""
    figure, (axes,) = panels(1, 3.2)
    for name, label, color in (
        ("ball", "ball, r = 0.7: has a limit", LINE_COLOR),
        ("square", "1/k^2: has a limit", LIMIT_COLOR),
        ("harmonic", "1/k: has none", IMPACT_COLOR),
        ("lets_go", "forced oscillator: has none", INK),
    ):
        flights = [arc.length for arc in page[name].arcs if arc.mode == "flight"]
        lengths = flights[:-1][:60]  # the last leads to the limit, or to the end of the run
        axes.semilogy(range(1, len(lengths) + 1), lengths, ".-", color=color, lw=0.8, label=label)
    axes.set(xlabel="flight", ylabel="its length", ylim=(1e-7, 30))
    axes.legend(fontsize=8, frameon=False)
    return figure


def cut(page):
    """All impacts, and three of them."""
    full, few = page["ball"], page["cut"]
    figure, (axes,) = panels(1, 2.8)
    curve(axes, full, color=SURFACE_COLOR)
    curve(axes, few)
    axes.plot(few.jumps.t[:3], 0 * few.jumps.t[:3], "o", color=IMPACT_COLOR, ms=4)
    mark(axes, few.zeno[0].t, "cut off")
    mark(axes, full.zeno[0].t, "t_inf")
    axes.set(xlabel="t", ylabel="x")
    return figure


def sliding(page):
    """Two widths of a relay's hysteresis, and none."""
    figure, rows = panels(3, 5.0, sharex=True, sharey=True)
    for axes, width in zip(rows, (0.1, 0.02, 0.0), strict=True):
        model = page["Hysteresis"](width=width) if width else page["Sliding"]()
        run = hy.simulate(model, {"x": 0.5}, (0.0, 4.0))
        curve(axes, run)
        text = f"width {width:g}: {len(run.jumps)} switchings" if width else "sliding"
        axes.set(ylabel="x", ylim=(-0.2, 0.6))
        axes.annotate(text, (0.98, 0.85), xycoords="axes fraction", ha="right", va="top")
    rows[-1].set_xlabel("t")
    return figure


def main(folder=HERE):
    page = runs_of_the_page()
    for draw in (ball, bead, tanks, gaps, cut, sliding):
        draw(page).savefig(Path(folder) / f"zeno_{draw.__name__}.png", dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:])
