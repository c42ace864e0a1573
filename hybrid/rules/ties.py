"""Guards that are zero at one time: the order in which they fire (4).

Events next to each other in a step are judged at the event on which it ends, in spacings of its
time, in the rounding of each guard there, and in what the steps of another solver have lost.
Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .guards import (
    GUARD_ROUNDING,
    NEAR,
    TIE,
    TIED_IN_STEP,
    at_largest,
    holds,
    moving,
    row_of,
    sizes_of,
    so_far,
)
from .jets import afresh
from .lengths import behind
from .places import (
    ABSOLUTE,
    BLUR,
    CONTACT,
    CROSSING,
    EDGE,
    EVENT,
    FIELD,
    FIELD_PROGRAM,
    FLIGHTS,
    GUARDS,
    GUARDS_END,
    HALF_BEND,
    KIND,
    LOW,
    NONE,
    OFF,
    OWN,
    RATE,
    REACHES,
    RELATIVE,
    STEP_END,
    STEPS_LOST,
    SWITCH,
    TAU,
    TOLERANCES,
    URGENT,
    USES,
    USES_END,
    VALUE,
    WHEN,
    T,
)
from .polynomials import power_value
from .zeros import EPS

__all__ = ("latest", "since")

#: What the steps of a run have lost is at most counted as so many tolerances: the errors of stable
#: motions do not add up, those of others are beyond all count.
MOST_LOST = 16.0

#: Events further apart than this share of the arc are no tie, whatever was lost: what is done at
#: the first of them is then known no worse than to this share.
FURTHEST_APART = 1e-3

#: By so much what steps have lost may have grown along the way.
GROWN = 4.0

#: Steps of Newton's method from the first zero to the last of a tie, each of which squares what is
#: left.
GATHERINGS = 4


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


def together(a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float) -> int:
    """The guard declared first of those that are zero where a step ends. For the others, the sign
    before is noted; those whose condition fails there count as fired."""
    field, event = now.ints[FIELD], now.ints[EVENT]
    first, fires = a.fields[field, GUARDS], event
    now.ints[FLIGHTS] += 1
    note_sides(a, now, room, t, event)
    for g in range(first, a.fields[field, GUARDS_END]):
        if g == event:
            continue
        comes, zero = near(a, run, now, room, g, t), ago(a, now, room, g, t) >= 0.0
        if not (comes or zero):
            continue
        if (beside(a, now, g) and zero) or (comes and holds(a, room, g, t, now.end)):
            now.tied[a.guards[g, OWN]] = now.signs[g - first] * now.ints[FLIGHTS]
            now.tied[a.guards[event, OWN]] = now.signs[event - first] * now.ints[FLIGHTS]
            fires = min(fires, g)
        elif not holds(a, room, g, t, now.end):
            now.spent[a.guards[g, OWN]] = now.ints[FLIGHTS]
    now.tied[a.guards[fires, OWN]] = now.touched[a.guards[fires, OWN]] = 0
    return fires


def note_sides(a: AutomatonArrays, now: Now, room: Room, t: float, fired: int) -> None:
    """Note the sign before of each guard that rounding does not tell from zero where a step ends:
    whether it has passed zero is then seen by its sign behind the jump (3). ``fired`` is the guard
    that has ended it, ``NONE`` for a clock."""
    field, reach, way = now.ints[FIELD], so_far(now, now.end), (t - now.floats[T]) - now.floats[LOW]
    program = a.fields[field, FIELD_PROGRAM]
    first, last = a.fields[field, GUARDS], a.fields[field, GUARDS_END]
    if last - first < (1 if fired == NONE else 2):
        return
    bends = afresh(a.programs, program, 2, t, now.end, room.still, room.aside, room.work) >= 0
    if not bends and afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work):
        return
    for g in range(first, last):
        c = room.aside[row_of(a, program, field, g)]
        for k in range(3):
            now.zeros[g - first, VALUE + k] = c[k] if bends or k < 2 else 0.0
    for g in range(first, last):
        value, rate = now.zeros[g - first, VALUE], now.zeros[g - first, RATE]
        if a.guards[g, KIND] in (EDGE, SWITCH) and abs(value) <= NEAR * reach:
            noise = hidden_at(a, now, room, g, t, rate)
            stays = now.orders[g - first] == 1 and abs(rate) * way <= 2.0 * noise
            # it was zero when the arc began, and has left since: along a parabola
            side = 1 if rate - way * now.zeros[g - first, HALF_BEND] > 0.0 else -1
            before = now.signs[g - first]
            if abs(value) <= noise:
                off = moving(a, now, room, g, t, now.end, value, rate, before)
                side = side if stays and not off else before
                now.touched[a.guards[g, OWN]] = side * now.ints[FLIGHTS]


def side_at(noted: int, flights: int) -> int:
    """The sign that is noted of a guard for the end of a flight; 0 if it is for another's."""
    return 1 if noted == flights else -1 if noted == -flights else 0


def keep_sides(
    a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats, end: float, limit: Floats
) -> None:
    """Note for the limit of a sum the side on which the guard of each edge is where it begins: the
    state does not jump there, so a guard that is zero comes from that side, and one that is on the
    other, by rounding, fires. One that is urgent fires at the limit, whatever was before."""
    field, flights = now.ints[FIELD], now.ints[FLIGHTS]
    program, first = a.fields[field, FIELD_PROGRAM], a.fields[field, GUARDS]
    if afresh(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return
    for g in range(first, a.fields[field, GUARDS_END]):
        own, value = a.guards[g, OWN], room.aside[row_of(a, program, field, g), 0]
        if a.guards[g, KIND] == EDGE and a.guards[g, URGENT] == 0:
            side = side_at(now.touched[own], flights)
            side = (1 if value > 0.0 else -1 if value < 0.0 else 0) if side == 0 else side
            now.touched[own] = side * (flights + 1)
    if afresh(a.programs, program, 0, end, limit, room.still, room.aside, room.work) < 0:
        return
    for g in range(first, a.fields[field, GUARDS_END]):
        own, value = a.guards[g, OWN], room.aside[row_of(a, program, field, g), 0]
        if value * side_at(now.touched[own], flights + 1) < 0.0:
            now.tied[own] = now.touched[own]


def hidden_at(a: AutomatonArrays, now: Now, room: Room, guard: int, t: float, rate: float) -> float:
    """How far from zero a guard may be at ``now.end`` to be taken for zero on entering a mode
    (:func:`.entries.start`)."""
    size, _, _ = sizes_of(a, room, guard, t, now.end)
    high = at_largest(a, now, room, guard, t, size)
    return GUARD_ROUNDING * EPS * (size + high) + TIE * EPS * abs(t) * abs(rate)


def gathered(a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float, most: float) -> float:
    """Go on from the zero of a guard to where all that are at one time with it are zero, or beyond
    it; returns by how much. The time goes on by ``most`` at most."""
    field, later, moved = now.ints[FIELD], 0.0, 0.0
    first, last = a.fields[field, GUARDS], a.fields[field, GUARDS_END]
    for _ in range(GATHERINGS if now.floats[STEPS_LOST] > 0.0 else 0):
        step = 0.0
        for g in range(first, last):
            if g != now.ints[EVENT] and near(a, run, now, room, g, t + later):
                value, rate, _ = hidden_of(a, run, now, room, g, t + later, 0.0)
                if value * rate < 0.0:
                    step = max(step, -value / rate)
        if step <= EPS * abs(t):
            return later
        program = a.fields[field, FIELD_PROGRAM]
        if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
            return later
        for i in range(now.end.shape[0]):
            now.end[i] += step * room.aside[i, 1]
        moved += step
        later = min(moved, max(most, 0.0))
    return later


def pending(a: AutomatonArrays, now: Now, fired: int) -> bool:
    """Whether another guard was zero at this time and fires after the jump."""
    field, flights = now.ints[FIELD], now.ints[FLIGHTS]
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if g != fired and abs(now.tied[a.guards[g, OWN]]) == flights:
            return True
    return False


def remembered(a: AutomatonArrays, now: Now, fired: int) -> bool:
    """Whether another guard was zero at this time and fires after the jump, or has fired."""
    field, flights = now.ints[FIELD], now.ints[FLIGHTS]
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if g != fired and now.spent[a.guards[g, OWN]] == flights:
            return True
    return pending(a, now, fired)


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
    if now.zeros[place, REACHES] == 1.0:
        return 0.0
    if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return -1.0
    row, before = row_of(a, program, field, guard), now.signs[place]
    value, rate = room.aside[row, 0], room.aside[row, 1]
    rounding = rounding_there(a, now, room, guard, t, rate)
    return since(value, rate, before, t, rounding + 2.0 * now.zeros[place, OFF])


def rounding_there(
    a: AutomatonArrays, now: Now, room: Room, guard: int, t: float, rate: float
) -> float:
    """The rounding of a guard at ``now.end``: that of what it is made of there, and of what that
    has been as far as this does not hide the way that the guard has gone since the arc began."""
    here, _, _ = sizes_of(a, room, guard, t, now.end)
    way = (t - now.floats[T]) - now.floats[LOW]
    far = GUARD_ROUNDING * EPS * size_so_far(a, now, room, guard, t)
    return max(GUARD_ROUNDING * EPS * here, min(far, FURTHEST_APART * abs(rate) * way))


def size_so_far(a: AutomatonArrays, now: Now, room: Room, guard: int, t: float) -> float:
    """The sum of the terms of which a guard is made at ``now.end``, or has been: a state that is
    zero there has the rounding of what it was."""
    here, _, _ = sizes_of(a, room, guard, t, now.end)
    far, _, _ = sizes_of(a, room, guard, t, now.seen)
    return max(here, far) if far < math.inf else here


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


def hidden_by(lost: float, share: float, own: float, rate: float, way: float) -> float:
    """How far from zero a guard may be that the steps of a solver show there, as they have lost
    so much.

    Parameters
    ----------
    lost : float
        What they have lost, in tolerances.
    share : float
        What the tolerances allow, as a share of the states of which the guard is made.
    own : float
        The sum of the terms of which it is made.
    rate, way : float
        Its rate, and the time since the arc began; 0 where it begins.
    """
    hidden = GROWN * lost * share * max(own, abs(rate) * way)
    return min(hidden, FURTHEST_APART * abs(rate) * way) if way > 0.0 else hidden


def hidden_of(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int, t: float, way: float
) -> tuple[float, float, float]:
    """The value and the rate of a guard at ``now.end``, and how far from zero it may be that other
    solvers' steps show there, so long after an arc began; that is below zero where nothing is
    known of it, or to be hidden."""
    field, kind, size = now.ints[FIELD], a.guards[guard, KIND], 0.0
    program = a.fields[field, FIELD_PROGRAM]
    row = row_of(a, program, field, guard)
    if now.floats[STEPS_LOST] == 0.0 or kind not in (EDGE, CONTACT, SWITCH):
        return 0.0, 0.0, -1.0
    if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return 0.0, 0.0, -1.0
    value, rate = room.aside[row, 0], room.aside[row, 1]
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        i = a.uses[k]
        size = max(size, max(now.seen[i], abs(now.end[i])), abs(room.aside[i, 1]) * way)
    own = size_so_far(a, now, room, guard, t)
    if size == 0.0 or not own < math.inf:
        return value, rate, -1.0
    share = run[RELATIVE] + run[ABSOLUTE] / size
    return value, rate, hidden_by(now.floats[STEPS_LOST], share, own, rate, way)


def late_by(lost: float, share: float, error: float, t: float, way: float) -> float:
    """By how much the limit of a sum may come too late: by rounding, the ``error`` of the sum, and
    what the steps of a solver have lost on a ``way`` to it, as a share of that."""
    return error + GUARD_ROUNDING * EPS * abs(t) + GROWN * lost * share * way


def near(a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int, t: float) -> bool:
    """Whether a guard is about to fire at ``now.end``, or just has, and what another solver's
    steps have lost may hide that it does so there; one that turns back within that only touches
    (1)."""
    if now.floats[STEPS_LOST] == 0.0:
        return False
    field = now.ints[FIELD]
    before = now.signs[guard - a.fields[field, GUARDS]]
    way = (t - now.floats[T]) - now.floats[LOW]
    value, rate, hides = hidden_of(a, run, now, room, guard, t, way)
    fires = rate * before < 0.0 and rate * a.guards[guard, CROSSING] >= 0.0
    if not (fires and abs(value) <= hides):
        return False
    program = a.fields[field, FIELD_PROGRAM]
    if a.guards[guard, KIND] == CONTACT:
        return True
    fit = afresh(a.programs, program, 2, t, now.end, room.still, room.aside, room.work) == 0
    return fit and rate * rate > 4.0 * abs(room.aside[row_of(a, program, field, guard), 2]) * hides


def loses(run: Floats, now: Now, room: Room, h: float) -> float:
    """What another solver's step has lost, in tolerances of the largest states, as
    :func:`hidden_of` takes them: how far its end is from that of series of the flow, which
    ``room.c`` has; where these have not converged, one."""
    most, order = 0.0, room.c.shape[1] - 1
    for i in range(now.x.shape[0]):
        allowed = run[TOLERANCES + i] + run[RELATIVE] * max(now.seen[i], abs(now.end[i]))
        if not behind(room.c[i], h) <= allowed:
            return 1.0
        value, _ = power_value(room.c[i], 0, order, h)
        if value != now.end[i]:
            most = max(most, abs(value - now.end[i]) / allowed if allowed > 0.0 else 1.0)
    return most


def lose(run: Floats, now: Now, room: Room, h: float, known: bool) -> None:
    """Add what a step of another solver has lost. ``known``: there are series of the flow."""
    own = loses(run, now, room, h) if known else 1.0
    now.floats[STEPS_LOST] = min(now.floats[STEPS_LOST] + own, MOST_LOST)
