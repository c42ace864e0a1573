"""Guards that are zero at one time: the order in which they fire (4).

Events next to each other in a step are judged at the event on which it ends, in spacings of its
time and in the rounding of each guard there. Numbers in brackets are the rules of
``docs/semantics.md``.
"""

from __future__ import annotations

from .arrays import AutomatonArrays, Now, Room
from .guards import GUARD_ROUNDING, TIE, TIED_IN_STEP, holds, row_of, sizes_of
from .jets import afresh
from .places import (
    BLUR,
    EVENT,
    FIELD,
    FIELD_PROGRAM,
    FLIGHTS,
    GUARDS,
    GUARDS_END,
    OFF,
    OWN,
    STEP_END,
    TAU,
    WHEN,
    T,
)
from .zeros import EPS

__all__ = ("latest", "since")


def latest(a: AutomatonArrays, now: Now, room: Room, t: float) -> tuple[int, float]:
    """Of the guards next to the one on which a step ends, the one that fired longest before, and
    how long before; 0 if none did."""
    field, fired, most = now.ints[FIELD], now.ints[EVENT], 0.0
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if beside(a, now, g):
            before = ago(a, now, room, g, t)
            if before > most:
                fired, most = g, before
    return fired, most


def together(a: AutomatonArrays, now: Now, room: Room, t: float) -> int:
    """The guard declared first of those that are zero where a step ends. For the others, the sign
    before is noted; those whose condition fails there count as fired."""
    field, event = now.ints[FIELD], now.ints[EVENT]
    first, fires = a.fields[field, GUARDS], event
    now.ints[FLIGHTS] += 1
    for g in range(first, a.fields[field, GUARDS_END]):
        if beside(a, now, g) and ago(a, now, room, g, t) == 0.0:
            now.tied[a.guards[g, OWN]] = now.signs[g - first] * now.ints[FLIGHTS]
            now.tied[a.guards[event, OWN]] = now.signs[event - first] * now.ints[FLIGHTS]
            fires = min(fires, g)
        elif g != event and ago(a, now, room, g, t) == 0.0 and not holds(a, room, g, t, now.end):
            now.spent[a.guards[g, OWN]] = now.ints[FLIGHTS]
    now.tied[a.guards[fires, OWN]] = 0
    return fires


def remembered(a: AutomatonArrays, now: Now, fired: int) -> bool:
    """Whether any other guard was zero at this time, or has fired."""
    field, flights = now.ints[FIELD], now.ints[FLIGHTS]
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        own = a.guards[g, OWN]
        if g != fired and (abs(now.tied[own]) == flights or now.spent[own] == flights):
            return True
    return False


def beside(a: AutomatonArrays, now: Now, guard: int) -> bool:
    """Whether a guard fires next to the one on which a step ends, as far as series tell."""
    first, event = a.fields[now.ints[FIELD], GUARDS], now.ints[EVENT]
    if guard == event:
        return False
    own, other = now.zeros[guard - first], now.zeros[event - first]
    near = TIED_IN_STEP * (now.floats[STEP_END] - now.floats[TAU]) + TIE * EPS * abs(now.floats[T])
    return own[WHEN] - other[WHEN] <= max(near, own[BLUR] + other[BLUR])


def ago(a: AutomatonArrays, now: Now, room: Room, guard: int, t: float) -> float:
    """How long ago a guard has fired, by its value and rate at ``now.end`` (:func:`since`)."""
    field = now.ints[FIELD]
    program, place = a.fields[field, FIELD_PROGRAM], guard - a.fields[field, GUARDS]
    if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return -1.0
    row, before = row_of(a, program, field, guard), now.signs[place]
    value, rate = room.aside[row, 0], room.aside[row, 1]
    size, _, _ = sizes_of(a, room, guard, t, now.end)
    return since(value, rate, before, t, GUARD_ROUNDING * EPS * size + 2.0 * now.zeros[place, OFF])


def since(value: float, rate: float, before: int, t: float, rounding: float) -> float:
    """How long before a time a guard has fired, by its value and rate there: 0 if it is zero, to
    spacings of the time and to its ``rounding``; negative if it has not fired yet.

    ``before``: its sign on the way; with 0 only zero is recognised.
    """
    if abs(value) <= TIE * EPS * abs(t) * abs(rate) + rounding:
        return 0.0
    if value * before >= 0.0:
        return -1.0
    return value / rate if rate * before < 0.0 else 0.0
