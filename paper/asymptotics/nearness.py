"""How near the solution that is cut off comes to the full one."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import log
from typing import Any

import attrs
import numpy as np

from hybrid.plot.figure import Curve, Figure, Panel, column

from ..claims import Claim, Number, verdict
from ..runs import FINE, OTHER, ZERO, force, twice, without_contact
from .cut import LATE, Case, truncated


def shrinks(model: Any, cases: Sequence[Case]) -> Claim:
    """The length of the last interval."""
    small = [case for case in cases if case.impacts >= 2]
    push = -force(model, {"x": model.wall})
    gaps = np.array([case.gap for case in small])
    leading = np.array([_leading(case, push) for case in small])
    rates = [_rate(float(Fraction(case.label)), case.gap) for case in small]
    off = np.abs(leading / gaps - 1)
    falls = bool(np.all(np.diff(gaps) < 0)) and bool(np.all(np.diff(rates[2:]) < 0))
    return Claim(
        place="Section 2",
        says="The length of the last interval diminishes to 0 as `r -> 0`.",
        verdict=verdict(falls and off[-1] < ZERO and gaps[-1] < 1e-80),
        found=f"From {gaps[0]:.10g} for r = {small[0].label} to {gaps[-1]:.10g} for r = "
        f"{small[-1].label}: faster than any power of r. To leading order it is "
        "`2 r^N w / (a (1 - r))`, with `N = [1/r]`, w the speed of the first impact and a = "
        f"{push:g} the force at the wall, so that `-log gap / ((1/r) log(1/r))` tends to 1; it is "
        f"{rates[-1]:.6f} for the last.",
        how="Simulated impact by impact, by two methods, and summed flight by flight, so that no "
        "digits are lost in a difference of times. The leading term, from the same first impact, "
        f"is off by {off[0]:.0e} for r = {small[0].label} and by {max(off[-1], 1e-16):.0e} for r = "
        f"{small[-1].label}.",
        numbers=[
            row
            for case, value, rate in zip(small, leading, rates, strict=True)
            for row in (
                case.number("gap", "gap"),
                Number(what="leading term", ours=float(value)),
                Number(what="`-log gap / ((1/r) log(1/r))`", ours=rate),
            )
        ],
        figures=[lengths(model, push)],
    )


def _leading(case: Case, push: float) -> float:
    """``2 r^N w / (a (1 - r))``."""
    r, w = case.model.r, -float(case.run.jumps.before.v[0])
    return 2 * r**case.impacts * w / (push * (1 - r))


def _rate(r: float, gap: float) -> float:
    return float(-log(gap) * r / log(1 / r))


def lengths(model: Any, push: float) -> Figure:
    """The gap over 1/r."""
    grid = np.arange(1.25, 50.01, 0.25)
    found = []
    for inverse in grid:
        made = attrs.evolve(model, r=1 / inverse)
        run = truncated(made, save="jumps", **FINE)
        found.append((run.zeno[0].truncation.gap, -float(run.jumps.before.v[0])))
    gaps, w = np.array(found).T
    leading = 2 * grid ** -np.floor(grid) * w / (push * (1 - 1 / grid))
    rates = -np.log(gaps) / (grid * np.log(grid))
    notes = [f"1/r = {i:g}: {gap:.12g}" for i, gap in zip(grid, gaps, strict=True)]
    whole = grid == np.floor(grid)
    return Figure(
        name="last-interval",
        title="Example 1: the last interval, theta_inf - theta_[1/r], over 1/r",
        columns=column(
            Panel(
                curves=[
                    Curve(x=grid, y=leading, look="line", name="2 r^N w / (a (1 - r))"),
                    Curve(x=grid, y=gaps, look="impact", name="simulated", notes=notes),
                ],
                x="1/r",
                y="theta_inf - theta_[1/r]",
                log="y",
            ),
            Panel(
                curves=[
                    Curve(x=grid[whole], y=rates[whole], look="series", name="1/r whole"),
                    Curve(x=grid[[0, -1]], y=[1.0, 1.0], look="surface", name="limit"),
                ],
                x="1/r",
                y="-log gap / ((1/r) log(1/r))",
            ),
        ),
    )


def approximates(cases: Sequence[Case]) -> Claim:
    """The distance of the two solutions at all times."""
    small = [case for case in cases if case.impacts >= 2]
    heights = np.array([case.cuts[0].height for case in small])
    speeds = [case.speeds for case in small]
    falls = bool(np.all(np.diff(heights) < 0) and np.all(np.diff([v for v, _ in speeds]) < 0))
    limit = [
        without_contact(small[-1].model, small[-1].model.wall, 0.0, LATE, **o).final.x
        for o in (FINE, OTHER)
    ]
    apart_from = small[-1].model.wall - float(limit[0])
    return Claim(
        place="Section 2",
        says="Consequently, the solutions of the system with at most `[1/r]` impacts are "
        "asymptotic approximations for the solutions of the full system.",
        verdict=verdict(falls and heights[-1] < 1e-80),
        found="With the contact held they are, uniformly in time: in position the solutions differ "
        "by the height of the next flight, in velocity by the speed that it starts with, and both "
        "fall faster than any power of r. Without a contact this is true up to `theta_inf` only: "
        f"{LATE:g} later the distance tends to {apart_from:.10f}, the fall from the wall.",
        how="The height of the first flight left out, from its series, and the speed after the "
        "last permitted impact; by two methods.",
        numbers=[
            *(
                row
                for case, pair in zip(small, speeds, strict=True)
                for row in (
                    case.number("largest distance in x", "height"),
                    twice(f"r = {case.label}: largest distance in x'", *pair),
                )
            ),
            twice(f"x, {LATE:g} after leaving the wall from rest", *limit),
        ],
    )
