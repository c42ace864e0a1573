"""How far rounding of the gap at the impacts of a series puts off a limit that no sum gives.

Runs that are compared round gaps alike, and forget how they were moved, as each impact damps it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING

import numpy as np

from ..lowering import Contact, Field
from ..lowering.taylor import polynomial
from ..rules import unit
from ..rules.guards import GUARD_ROUNDING
from ..rules.zeros import EPS
from ..zeno.accumulate import hop
from ..zeno.flight import falls

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .cycles import Seen
    from .driver import Driver

#: The most impacts of a series that are looked at, the last ones.
IMPACTS_FLOWN_AGAIN = 64

#: How far beyond the length over which it has converged a series is used: growth need not be known
#: to more than a digit.
FAR = 4.0


def grown(driver: Driver, contact: Contact, field: Field) -> float:
    """How far the rounding of the gap may have moved the limit of the last impacts of a contact.

    An impact at a gap of ``d`` instead of zero is ``d / u`` early, at the speed ``u`` of the
    impact, though no earlier than the limit is late. What becomes of that is told by flying the
    impacts behind it once more from there.
    """
    if field.jets is None or driver.record.memory is not None or driver.model.samples:
        return 0.0  # other fields may have been flown on
    last = reversed(driver.cycles.last(IMPACTS_FLOWN_AGAIN))
    series = list(takewhile(lambda seen: seen.edge == contact.name, last))[::-1]
    gap, found = field.guards[field.column(contact.name)], 0.0
    for place, now in _rounded(driver, contact, field, series):
        t, x = now.t, now.x.tolist()
        size, _, _ = driver.scene.rounding(gap, field)(t, x)
        _, speed, _ = gap.lie(t, x)
        early = EPS * size * contact.law(t, x, -speed) / speed if speed > 0.0 else 0.0
        early = min(early, driver.t - t)
        ends = [
            _flown(field, contact, s, now.x, speed, len(series) - place) for s in (t, t + early)
        ]
        found += abs(ends[1] - ends[0]) + early
    return found


def _rounded(
    driver: Driver, contact: Contact, field: Field, series: list[Seen]
) -> Iterator[tuple[int, Seen]]:
    """The impacts at which the gap is rounded, and their numbers: not those to which a low flight
    has led, in which the gap is a coordinate of its own, if it could be flown so."""
    drowns, column = unit("hops").drowns, field.column(contact.name)
    yield from enumerate(series[:1], 1)
    for place, (before, now) in enumerate(pairwise(series), 2):
        t, x, reach = before.t, before.x, driver.reach(before.x)
        _, speed, force = field.guards[column].lie(t, x.tolist())
        near = GUARD_ROUNDING * EPS * reach
        low = speed > 0.0 and drowns(speed, force, reach)
        if not low or hop(field, contact, column, t, x, speed, near) is None:
            yield place, now


def _flown(field: Field, contact: Contact, t: float, x: StateVector, v: float, count: int) -> float:
    """The time that so many flights take, as far as they can be told."""
    spent, left = 0.0, count
    while left > 0 and v > 0.0:
        flight = _flight(field, contact, t + spent, x, v)
        if flight is None:
            break
        length, x, v = flight
        spent, left = spent + length, left - 1
    return spent


def _flight(
    field: Field, contact: Contact, t: float, x: StateVector, v: float
) -> tuple[float, np.ndarray, float] | None:
    """A flight, by one series if that reaches its end, and its impact: how long it takes, and the
    state and the gap speed behind it. How well the series follows the flow is not looked at: under
    a weak load it never does."""
    column = field.column(contact.name)
    series, values, _ = field.expand(t, x.tolist(), [])
    gap = [0.0, v, *values[column][2:]]
    s = falls(series, gap, FAR)
    if s is None:
        flown = hop(field, contact, column, t, x, v, 0.0)
        return None if flown is None else (flown[0], *flown[3:])
    end = [polynomial(c, s) for c in series]
    speed = polynomial([k * c for k, c in enumerate(gap)][1:], s)
    after = np.array(contact.impact(t + s, contact.land(t + s, end))[:-1])
    return s, after, -speed * contact.law(t + s, end, speed)
