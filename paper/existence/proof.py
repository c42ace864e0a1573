"""The proof of Theorem 1, step by step, on runs of Example 1."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

import numpy as np

from hybrid.lowering import scene_of
from hybrid.simulation import simulate

from ..claims import Claim, Number, verdict
from ..runs import FINE, OTHER, ZERO, Attained, Spring, apart, force, twice, without_contact
from .intervals import COUNT, Flight, Ratios, flights, intervals

#: Starts from which the first fall is looked at, as shares of ``h - phi``.
SHARES = (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)

PROOF = "Section 1, proof of Theorem 1"


def claims(spring: Spring) -> list[Claim]:
    """The claims of the proof."""
    seen, again = (flights(spring.model, run) for run in (spring.run, spring.again))
    return [
        first_fall(spring),
        stays(spring, seen, again),
        halves(spring, seen),
        integrals(spring),
        intervals(spring, seen, again),
        limits(spring, seen, again),
        for_ever(spring),
    ]


# ---------------------------------------------------------------------------------------
# the motion


def first_fall(spring: Spring) -> Claim:
    """Time and speed of the first impact."""
    proved = spring.certificate
    low, high = proved.box["x"]
    one, other = (
        np.array([_fall(spring.model, low + share * (high - low), options) for share in SHARES])
        for options in (FINE, OTHER)
    )
    times, speeds = one.T
    off = Attained.of(spring.model, proved).most[1]
    longest = sqrt(2 * (high - low) / proved.m)
    holds = bool(np.all(times < longest) and np.all(speeds <= proved.M * times))
    return Claim(
        place=PROOF,
        says="`theta_1 < sqrt(2 (h - phi) / m)`, and `|x_2(theta_1)| <= M theta_1 < h_bar`.",
        verdict=verdict(holds and proved.M * longest < proved.right),
        found=f"From {len(SHARES)} heights up to {SHARES[-1]:.0%} of h - phi, Example 1 falls for "
        f"{times[-1]:.6f} at most and reaches a speed of {speeds[-1]:.6f}.",
        how="Simulated to the first impact by two methods; M and m are the certificate's.",
        numbers=[
            twice("longest `theta_1`", *(rows[-1, 0] for rows in (one, other))),
            Number(what="`sqrt(2 (h - phi) / m)`", ours=longest, error=longest * off),
            twice("greatest `|x_2(theta_1)|`", *(rows[-1, 1] for rows in (one, other))),
            twice("`M theta_1` of that fall", *(proved.M * rows[-1, 0] for rows in (one, other))),
            Number(what="`h_bar`", ours=proved.right),
        ],
    )


def _fall(model: Any, x: float, options: Any) -> tuple[float, float]:
    run = simulate(model, {"x": x, "v": 0.0}, (0.0, 1.0), max_jumps=1, **options)
    return float(run.jumps.t[0]), -float(run.jumps.before.v[0])


def stays(spring: Spring, seen: Sequence[Flight], again: Sequence[Flight]) -> Claim:
    """Speeds and heights after the first impact."""
    box, r = spring.certificate.box, spring.model.r
    (low, high), start = box["x"], float(spring.run.arcs[0].first[0])
    impacts = [-r * run.jumps.before.v[0] for run in (spring.run, spring.again)]
    fastest = [max(np.max(np.abs(f.v)) for f in found) for found in (seen, again)]
    tops = np.array([f.height for f in seen])
    above = all(np.all(f.x >= low * (1 - ZERO)) for f in seen)
    slower = fastest[0] <= impacts[0] * (1 + ZERO) and fastest[0] < box["v"][1]
    lower = bool(np.all(np.diff(tops) < 0)) and low + tops[0] < start < high
    return Claim(
        place=PROOF,
        says="`|x_2(t)| <= r |x_2(theta_1)| < r h_bar < h_bar`, "
        "`x_1(t) <= x_1(xi_1) < x_0 < h`; the trajectory of x(t) is in H.",
        verdict=verdict(bool(above and slower and lower)),
        found="The speed after the first impact is the greatest of all later; each flight is lower "
        "than the one before, and the first lower than the start.",
        how=f"The run of Example 1, {len(seen)} flights after the first impact, at 33 points each "
        "and at their tops.",
        numbers=[
            twice("`r |x_2(theta_1)|`", *impacts),
            twice("greatest `|x_2|` after the first impact", *fastest),
            Number(what="`x_0`", ours=start),
            *(
                twice(f"`x_1(xi_{n + 1})`", low + seen[n].height, low + again[n].height)
                for n in range(3)
            ),
        ],
    )


def halves(spring: Spring, seen: Sequence[Flight]) -> Claim:
    """A flight's way down mirrors its way up."""
    middle, impacts = len(seen[0].v) // 2, spring.run.jumps
    before, after = impacts.before.v[:COUNT], impacts.after.v[:COUNT]
    found = {
        "turning point from half-way, of the flight's length": max(
            abs(f.v[middle] / f.f[middle]) / f.length for f in seen
        ),
        "a flight's last speed from its first, relative": max(
            abs(f.v[-1] / f.v[0] + 1) for f in seen
        ),
        "speed after an impact from r times that before, relative": float(
            np.max(np.abs(after / before + spring.model.r))
        ),
    }
    return Claim(
        place=PROOF,
        says="Utilizing condition (C2), we obtain `xi_i = (theta_i + theta_{i+1}) / 2`; "
        "`x_2(theta_{i+1}+) = r x_2(theta_i+)`.",
        verdict=verdict(max(found.values()) < ZERO),
        found="Both hold, to rounding: a flight turns half-way and lands with the speed it left "
        "with, of which the impact leaves r times as much.",
        how=f"{len(seen)} flights and impacts of Example 1: the velocity half-way, over the force "
        "there, is the time to the turning point.",
        numbers=[
            Number(what=f"largest distance: {what}", ours=f"{max(value, 1e-16):.0e}")
            for what, value in found.items()
        ],
    )


def integrals(spring: Spring) -> Claim:
    """The integral equations along the run."""
    points, weights = np.polynomial.legendre.leggauss(24)
    rhs, worst = scene_of(spring.model).field("flight").rhs, 0.0
    arcs = [arc for arc in spring.run.arcs if arc.mode == "flight"][: COUNT + 1]
    for arc in arcs:
        s, w = 0.5 * arc.length * (points + 1.0), 0.5 * arc.length * weights
        f = np.array([rhs(0.0, list(state))[1] for state in arc.local(s)])
        (x, v), (x_end, v_end) = arc.first, arc.last
        speed = max(abs(v), abs(v_end))
        place = x + v * arc.length + np.sum(w * (arc.length - s) * f)
        worst = max(worst, abs(v + np.sum(w * f) - v_end) / speed, abs(place - x_end))
    return Claim(
        place=PROOF,
        says="The solution is `x_1(t) = x_0 + int (t - s) f ds`, `x_2(t) = int f ds` until the "
        "first impact, and `x_1(t) = phi + x_2(theta_i+) (t - theta_i) + int (t - s) f ds`, "
        "`x_2(t) = x_2(theta_i+) + int f ds` from each impact to the next.",
        verdict=verdict(worst < ZERO),
        found="They hold along the run, to rounding.",
        how=f"Both integrals over the first fall and {len(arcs) - 1} flights of Example 1, by "
        "Gauss quadrature of the force along our solution, against its state at the end.",
        numbers=[Number(what="largest difference", ours=f"{max(worst, 1e-16):.0e}")],
    )


# ---------------------------------------------------------------------------------------
# where it goes


def limits(spring: Spring, seen: Sequence[Flight], again: Sequence[Flight]) -> Claim:
    """Heights, speeds and the force's range from flight to flight."""
    rows, others = (
        np.array([(f.height, np.max(f.v), f.largest / f.least - 1) for f in found])
        for found in (seen, again)
    )
    bound, other = (Ratios.of(found, spring.model.r).mended for found in (seen, again))
    falls = bool(np.all(np.diff(rows, axis=0) < 0)) and bool(np.all(np.diff(bound) < 0))
    names, shown = ("greatest `x_1 - phi`", "greatest `x_2`"), (1, len(seen) // 2, len(seen))
    return Claim(
        place=PROOF,
        says="`max |x_1(t)| -> phi`, `max |x_2(t)| -> 0` and `M_i / m_i -> 1` on the intervals "
        "between impacts; this and the inequality for intervals prove the convergence.",
        verdict=verdict(falls and bound[0] < 1 and bool(np.all(rows[-1] < 1e-3 * rows[0]))),
        found="All three go to their limits. By the corrected inequality no interval of Example 1 "
        f"is longer than {bound[0]:.6f} of the one before, and that bound falls to r.",
        how=f"The largest and least values on {len(seen)} flights of the run of Example 1, each "
        "less than the one before.",
        numbers=[
            *(
                twice(f"flight {n}: {name}", rows[n - 1, k], others[n - 1, k])
                for n in shown
                for k, name in enumerate(names)
            ),
            *(_spread(n, seen[n - 1], again[n - 1]) for n in shown),
            twice("greatest `r M_i / m_{i+1}`, i = 1", bound[0], other[0]),
            twice(f"least, i = {len(bound)}", bound[-1], other[-1]),
        ],
    )


def _spread(number: int, one: Flight, other: Flight) -> Number:
    """``M_i / m_i - 1``, with the error of the ratio."""
    ratios = [flight.largest / flight.least for flight in (one, other)]
    return Number(
        what=f"flight {number}: `M_i / m_i - 1`", ours=ratios[0] - 1, error=apart(*ratios)
    )


def for_ever(spring: Spring) -> Claim:
    """What follows the accumulation."""
    run, late = spring.run, 0.5
    x, v = float(run.zeno[0].state.x), float(run.zeno[0].state.v)
    pull, wall = force(spring.model, {"x": x, "v": v}), spring.model.wall
    alone = [without_contact(spring.model, x, v, late, **o).final.x for o in (FINE, OTHER)]
    settled = run.settles()
    stands = settled.kind == "rest" and settled.for_ever and run.final.x == wall
    return Claim(
        place=PROOF,
        says="Let us show that the solution is continuable to `+oo` and it remains in the domain "
        "H. ... the orbit of x(t) is in H for all `t >= 0`.",
        verdict=verdict(bool(alone[0] >= wall), mended=bool(stands)),
        found="The recursion over impacts ends where they accumulate, and the system as written "
        f"says nothing of later times: there f = {pull:g} would pull the body through the wall. "
        "With the force of the contact, which holds it while f presses it on, it rests and stays "
        "in H for ever.",
        how=f"From the limit state under `x'' = f` alone, {late:g} later; and in the resting mode "
        f"derived from the contact. What the library says of that rest: {settled.reason}.",
        numbers=[
            twice(f"x at `t_inf` + {late:g}, equation alone", *alone),
            Number(what="x at the end of the run, contact held", ours=float(run.final.x)),
            Number(what="at the end of the run", ours="at rest" if stands else run.mode),
        ],
    )
