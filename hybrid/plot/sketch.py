"""A small drawing of a run for notebooks, as inline SVG with a strip per state element."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ..trajectory.trajectory import Solution
from .figure import STYLES, Curve
from .of_run import path

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Lengths in pixels: the total width, the space for names, the height of a strip, the space between
#: two, and that below all; most strips; and an invisible distance.
SKETCH_WIDTH, NAMES, STRIP, BETWEEN_STRIPS, BELOW, MOST_STRIPS, UNSEEN = 420, 64, 38, 8, 16, 6, 0.6

#: Number of jumps above which a run is sampled evenly, and the number of samples; most limits
#: shown.
CROWDED, EVEN, MOST_LIMITS = 300, 500, 40


def sketch(run: Solution) -> str:
    """The run as SVG of some kilobytes, without fonts or scripts."""
    names = run.spec.element_names[:MOST_STRIPS]
    bottom = len(names) * (STRIP + BETWEEN_STRIPS)
    parts = [part for i, name in enumerate(names) for part in _strip(run, i, name)]
    for point in run.zeno if len(run.zeno) <= MOST_LIMITS else ():
        x, look = _across(run, np.array([point.t]))[0], STYLES["limit"]
        parts.append(
            f'<path d="M{x:.1f} 0V{bottom}" stroke="{look.color}" stroke-dasharray="3 3"/>'
        )
    for t, anchor, x in ((run.t0, "start", NAMES), (run.t1, "end", SKETCH_WIDTH)):
        parts.append(_text(x, bottom + 8, anchor, f"{t:.6g}"))
    more = len(run.spec.element_names) - len(names)
    parts.append(_text(NAMES - 6, bottom + 8, "end", f"+ {more} more" if more else "t"))
    height = bottom + BELOW
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SKETCH_WIDTH}" height="{height}" '
        f'viewBox="0 0 {SKETCH_WIDTH} {height}" fill="none" font-family="sans-serif" '
        f'font-size="11">{"".join(parts)}</svg>'
    )


def _strip(run: Solution, index: int, name: str) -> Iterator[str]:
    """One element over time: its name and its curves."""
    curves = _curves(run, index)
    values = np.concatenate([curve.y for curve in curves] or [np.zeros(1)])
    values = values[np.isfinite(values)]
    low, high = values.min(), values.max()
    top = index * (STRIP + BETWEEN_STRIPS) + 0.5 * BETWEEN_STRIPS
    size = high - low or 1.0
    middle = top + 0.5 * STRIP if high == low else None
    short = name if len(name) <= 9 else f"{name[:8]}…"
    yield _text(NAMES - 6, top + 0.5 * STRIP + 4, "end", short)
    yield f'<path d="M{NAMES} {top + STRIP}H{SKETCH_WIDTH}" stroke="currentColor" opacity=".2"/>'
    for curve in curves:
        look = STYLES[curve.look]
        y = top + STRIP * (high - curve.y) / size if middle is None else 0.0 * curve.y + middle
        drawn = _line(_across(run, curve.x), y, dots=not look.width)
        width = look.width or 2.0
        yield (
            f'<path d="{drawn}" stroke="{look.color}" stroke-width="{width}" '
            'stroke-linecap="round"/>'
        )


def _curves(run: Solution, index: int) -> list[Curve]:
    if len(run.jumps) <= CROWDED or run.options.get("save") != "dense":
        return path(run, index, points=EVEN)
    times = np.linspace(run.t0, run.t1, EVEN)
    rows = np.concatenate([np.reshape(v, (EVEN, -1)) for v in run(times)], axis=1)
    return [Curve(x=times, y=rows[:, index])]


def _across(run: Solution, t: Numbers) -> Numbers:
    return NAMES + (SKETCH_WIDTH - NAMES) * (t - run.t0) / ((run.t1 - run.t0) or 1.0)


def _line(x: Numbers, y: Numbers, dots: bool) -> str:
    """An SVG path through distinguishable points; NaN interrupts it."""
    found, last, pen = [], (np.inf, np.inf), "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not np.isfinite(b):
            pen = "M"
        elif pen == "M" or abs(a - last[0]) + abs(b - last[1]) > UNSEEN:
            found.append(f"{pen}{a:.1f} {b:.1f}" + "h0" * dots)
            last, pen = (a, b), "M" if dots else "L"
    return "".join(found)


def _text(x: float, y: float, anchor: str, said: str) -> str:
    place = f'x="{x}" y="{y:.0f}" text-anchor="{anchor}"'
    return f'<text {place} fill="currentColor">{escape(said)}</text>'
