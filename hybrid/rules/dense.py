"""The first guard that fires in a step of another solver: by series of the flow, or its polynomial.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .cuts import with_cuts
from .formulas import EXPANDED_PARTS, formula
from .guards import SMALL_SHIFT, begun, first_event, resolved, row_of, series_of
from .jets import afresh
from .kinks import expanded, turn
from .lengths import behind
from .places import (
    AIM,
    CROSSED,
    FIELD,
    FIELD_PROGRAM,
    GUARDS,
    GUARDS_END,
    LOW,
    RELATIVE,
    STEP_END,
    TAU,
    TOLERANCES,
    UNTIL,
    WATCH,
    T,
)
from .polynomials import power_value, shift

__all__ = ("event_along", "foreseen")

#: A series of the flow and another solver's step may differ by so many times what a step may lose.
AGREES = 4.0


def foreseen(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """As :func:`event_along`, by series of the flow from where another solver's step begins, which
    ``room.c`` has; at 0 where these do not show that no guard fires, or one at the step's end, and
    below 0 where a guard does not begin with the sign with which it ended the last step.

    They do where they have converged there, to what a step may lose, lead to its state, and nothing
    changes its formula.
    """
    order, t = room.c.shape[1] - 1, now.floats[T] + now.floats[TAU]
    for i in range(now.x.shape[0]):
        allowed = run[TOLERANCES + i] + run[RELATIVE] * abs(now.end[i])
        value, _ = power_value(room.c[i], 0, order, h)
        if not max(behind(room.c[i], h), abs(value - now.end[i]) / AGREES) <= allowed:
            return -1, 0.0
    reach = reached(run, now, h)
    same, _ = formula(a.programs, series_of(a, now), t, reach, room)
    if same != reach or resolved(a, run, now, room, t, reach, False) != reach:
        return -1, 0.0
    if not (starting or continues(a, now, room)):
        return -1, -1.0
    now.ints[CROSSED] = -1
    guard, s = first_event(a, run, now, room, reach, starting)
    if abs(s - h) <= SMALL_SHIFT * h or (s == math.inf and keeps(a, now, room, t + h)):
        return guard, s
    begun(a, now, room)
    return -1, 0.0


def continues(a: AutomatonArrays, now: Now, room: Room) -> bool:
    """Whether guards begin a step with the signs with which they ended the last."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        value = room.c[row_of(a, a.fields[field, FIELD_PROGRAM], field, g), 0]
        if not value * now.signs[g - first] > 0.0:
            return False
    return True


def reached(run: Floats, now: Now, h: float) -> float:
    """How far a step is looked at: a little beyond its end, if it was made to end on a guard."""
    if now.floats[STEP_END] != now.floats[AIM]:
        return h
    length = (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    return min(h * (1.0 + SMALL_SHIFT), length - now.floats[TAU])


def event_along(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """As :func:`first_event`, in a step of another solver, of which ``room.c`` has the polynomial.

    The guards' series along it need not converge at its end: they are expanded anew as often as
    they must be, and where a guard changes its formula.
    """
    field, n, reach = now.ints[FIELD], now.x.shape[0], reached(run, now, h)
    t, done, program = now.floats[T] + now.floats[TAU], 0.0, a.fields[field, WATCH]
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    for part in range(EXPANDED_PARTS):
        for i in range(n):
            room.there[i] = room.c[i, 0]
        if expanded(a.programs, program, t + done, room.there, room.sides, room.c, room.work) < 0:
            return -1, 0.0
        same, crossed = formula(a.programs, program, t + done, reach - done, room)
        shown = resolved(a, run, now, room, t + done, same, crossed >= 0)
        if not shown > 0.0:
            return -1, 0.0
        now.ints[CROSSED] = crossed if shown == same else -1
        guard, s = first_event(a, run, now, room, shown, starting and part == 0)
        guard, s, further = with_cuts(a, now, room, guard, s, shown)
        shown += further
        if guard >= 0 or not s > 0.0:
            return guard, s if s == 0.0 else done + s
        if done + shown >= reach:
            return -1, math.inf if keeps(a, now, room, t + h) else 0.0
        turn(a.programs, program, now.ints[CROSSED], t + done, shown, room.c, room.sides)
        for i in range(n):
            shift(room.c[i], shown)
        done += shown
    return -1, 0.0


def keeps(a: AutomatonArrays, now: Now, room: Room, t: float) -> bool:
    """Whether the guards have at the end of a step the signs that its polynomial gives them."""
    field = now.ints[FIELD]
    program, first = a.fields[field, FIELD_PROGRAM], a.fields[field, GUARDS]
    if afresh(a.programs, program, 0, t, now.end, room.still, room.aside, room.work) < 0:
        return False
    for g in range(first, a.fields[field, GUARDS_END]):
        value = room.aside[row_of(a, program, field, g), 0]
        if not value * now.signs[g - first] > 0.0:
            return False
    return True
