"""Section 2 of the paper: at most ``[1/r]`` impacts, and what that leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import floor
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.run.truncate import permitted
from hybrid.simulation import simulate

from ..claims import Claim, Number, Section, verdict
from ..runs import FINE, OTHER, START, twice
from .after import coincide, stays
from .cut import RATIOS, Case, truncated
from .nearness import approximates, shrinks

#: Restitutions at which the full series is simulated, and how well its end is to be known.
FULL, KNOWN = ("0.5", "0.8", "0.99"), 1e-9

#: A fixed interval that holds all impacts for small r.
FIXED = 0.5


def section() -> Section:
    """All claims of section 2."""
    model = gallery.find("hard_spring").cls()
    cases = [Case.made(model, ratio) for ratio in RATIOS]
    return Section(
        name="asymptotics",
        title="2. Asymptotics",
        about="The same system with at most `[1/r]` impacts, as r tends to 0, on Example 1 from "
        "(2.1, 0). In all of our runs that are cut off the contact is then held by its force, "
        "unless it is said that there is none.",
        claims=[
            simulated(model),
            readings(cases),
            incomplete(cases),
            transient(cases),
            stays(cases),
            coincide(cases),
            shrinks(model, cases),
            approximates(cases),
        ],
    )


# ---------------------------------------------------------------------------------------
# what is cut off


def simulated(model: Any) -> Claim:
    """The full series, summed."""
    points = []
    for label in FULL:
        made = attrs.evolve(model, r=float(Fraction(label)))
        points.append(simulate(made, START, (0.0, 40.0), zeno="stop", **FINE).zeno[0])
    widths = [point.enclosure[1] - point.enclosure[0] for point in points if point.enclosure]
    known = len(widths) == len(points) and max(widths) < KNOWN
    return Claim(
        place="Section 2",
        says="Solutions of the system admit infinitely many jumps, and this makes, in general, "
        "impossible to find an exact solution or adequately to simulate it.",
        verdict=verdict(not known),
        found="All of its impacts are simulated: for Example 1 the time of their accumulation is "
        f"enclosed to {max(widths):.0e} or better for r = {', '.join(FULL)}.",
        how="The impacts are summed as a series, whose limit is proved by interval arithmetic from "
        "one of the impacts on; the error of the integration before it is measured by a second "
        "run, and added. (Exact solutions exist too: section 1 has two in closed form.)",
        numbers=[
            Number(what=f"r = {label}: `t_inf`", ours=point.t, error=point.t_error)
            for label, point in zip(FULL, points, strict=True)
        ],
    )


def readings(cases: Sequence[Case]) -> Claim:
    """The formula's cap and the text's."""
    few = [case for case in cases if case.impacts <= 4]
    strict = [sum(i < case.impacts for i in range(1, 100)) for case in few]
    none = [case.label for case, n in zip(few, strict, strict=True) if n == 0]
    loose = [case.impacts for case in few]
    wrong = [n for n in range(1, 1001) if floor(1 / (1 / n)) != n]
    right = all(permitted(1 / n) == n for n in range(1, 1001))
    return Claim(
        place="Section 2, the system with at most [1/r] impacts",
        says="`Delta x' |_{x = phi, i < [1/r]} = -(1 + r) x'`, with the additional condition that "
        "the number of impulsive moments has to be not more than `[1/r]`.",
        verdict=verdict(strict == loose, mended=loose == [_impacts(case.run) for case in few]),
        found="The formula permits `i < [1/r]`, one impact less than the text: for r = "
        f"{', '.join(none)}, as for all r > 1/2, none at all. Corrected to `i <= [1/r]`, as the "
        "text says and as we take it.",
        how="Both readings simulated; the gap is the time from the last permitted impact to "
        f"`theta_inf`. (In doubles `floor(1/r)` is off by one for {len(wrong)} of r = 1, 1/2, ..., "
        f"1/1000, first for 1/{wrong[0]}; ours is taken from the simplest fraction that rounds to "
        f"r{', and right for all' if right else ''}.)",
        numbers=[
            row
            for case in few
            for row in (
                Number(what=f"r = {case.label}: `[1/r]`", ours=case.impacts),
                case.number("gap with `i <= [1/r]`", "gap"),
                _strict(case),
            )
        ],
    )


def _strict(case: Case) -> Number:
    """The gap after one impact less."""
    what, impacts = f"r = {case.label}: gap with `i < [1/r]`", case.impacts - 1
    if not impacts:
        return Number(what=what, ours="no impact")
    runs = (truncated(case.model, impacts, **options) for options in (FINE, OTHER))
    one, other = (run.zeno[0].truncation.gap for run in runs)
    return twice(what, one, other)


def incomplete(cases: Sequence[Case]) -> Claim:
    """Each run that is cut off."""
    counts = [_impacts(case.run) for case in cases]
    expected = [case.impacts for case in cases]
    ends = all(case.run.mode == "flight.rest(impact)" for case in cases)
    return Claim(
        place="Section 2",
        says="For the fixed value of the parameter r, the incomplete chattering occurs only; each "
        "solution has a finite number of discontinuity moments, so that it is possible to make "
        "proper simulations.",
        verdict=verdict(counts == expected and ends),
        found=f"Each run has `[1/r]` impacts: {', '.join(map(str, counts))} for r = "
        f"{', '.join(RATIOS)}.",
        how="Simulated impact by impact; impacts counted in the record of the run.",
    )


def _impacts(run: Any) -> int:
    return int(np.sum(run.jumps.edge == "impact"))


def transient(cases: Sequence[Case]) -> Claim:
    """Impacts on a fixed interval."""
    last = [float(case.run.zeno[0].t) for case in cases]
    late = [float(case.again.zeno[0].t) for case in cases]
    small = [i for i, case in enumerate(cases) if case.impacts >= 2]
    counts = [_impacts(cases[i].run) for i in small]
    grows = bool(np.all(np.diff(counts) >= 0)) and counts[-1] >= 10 * counts[0]
    inside = all(last[i] < FIXED for i in small)
    return Claim(
        place="Section 1, definition; Section 2",
        says="The number of impacts increases unboundedly as the parameter tends to zero: the "
        "system admits the transient chattering, on a fixed interval.",
        verdict=verdict(grows and inside),
        found=f"On [0, {FIXED:g}] there are {counts[0]} impacts for r = {cases[small[0]].label}, "
        f"{counts[-1]} for r = {cases[-1].label}; there are `[1/r]` of them for every r <= 1/2.",
        how="Simulated. The time of the last impact permitted is less than that of the full "
        "accumulation, which falls to the first impact as r falls.",
        numbers=[
            row
            for i in small
            for row in (
                Number(what=f"r = {cases[i].label}: impacts", ours=_impacts(cases[i].run)),
                twice(f"r = {cases[i].label}: `theta_[1/r]`", last[i], late[i]),
                cases[i].number("`theta_inf`", "t_inf"),
            )
        ],
    )
