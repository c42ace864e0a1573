"""The guards of an arc: the first that fires in a step.

What leaves something to weigh is told apart, for the driver to judge; numbers in brackets are the
rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .away import away
from .checks import HELD_BEFORE, HELD_INSIDE, MISSED, ROUNDING_BESIDE, along, second
from .jets import OUTPUT, afresh
from .kinks import SIDE_BLUR, count
from .lengths import CONVERGED, LAST_TERMS, behind, own_length
from .places import (
    ABSOLUTE,
    AFFINE,
    BENDS,
    BLUR,
    BOUNDS,
    CONDITION,
    CROSSED,
    CROSSING,
    FIELD,
    FIELD_PROGRAM,
    FLOWING,
    GUARDS,
    GUARDS_END,
    LOOKS,
    MADE_OF,
    METHOD_ORDER,
    NONE,
    OFF,
    PHASE,
    REACHES,
    RELATIVE,
    SEES,
    SERIES_END,
    SIZES,
    STEP_LOSS,
    TAU,
    USES,
    USES_END,
    WATCH,
    WATCHED,
    WHEN,
    T,
)
from .polynomials import power_size, power_value
from .zeros import EPS, NEVER, outweighs, series, soon

__all__ = ("first_event", "moves_off")

#: A guard nearer to zero than this share of the state is looked at more closely.
NEAR = 1e-6

#: Rounding of a guard, in spacings of the terms that it is made of.
GUARD_ROUNDING = 64.0

#: Events this near in time, in spacings of floats, are at one time; those looked at for that lie
#: this near in the step, as landing may move the first by as much.
TIE, TIED_IN_STEP = 4.0, 1e-6

#: The rounding of a guard along a step is told from its terms up to this power.
TELLING = 2

#: A guard jumps within so many spacings of the time from the zero of the function that decides:
#: four for each of a quotient, a product and a sine, four for the place.
JUMPS_WITHIN = 16

#: A shift onto a guard that is so small beside the way to it is made along a straight line.
SMALL_SHIFT = 1e-6

#: A step so much longer than the guards' series is worth bounding them behind the ends of these.
WORTH_BOUNDING = 2.0


def first_event(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """The guard that fires first in a step (-1: none), and when (1); at 0 if that is not plain.
    Notes when others fire."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    fired, best = -1, math.inf
    for g in range(first, a.fields[field, GUARDS_END]):
        zero, c = now.zeros[g - first], room.c[row_of(a, series_of(a, now), field, g)]
        zero[REACHES] = 0.0
        order = now.orders[g - first] if starting or now.ints[PHASE] == LOOKS else 0
        if starting:
            zero[OFF] = abs(c[0]) if order == 1 else 0.0
        s = zero_of(a, run, now, room, g, order, h, starting)
        if s < best:
            fired, best = g, s
        curved = a.guards[g, AFFINE] == 0 and 0.0 < s < math.inf
        zero[WHEN], zero[BLUR] = s, blurred(c, s) if curved else 0.0
    if fired >= 0 and best > 0.0:
        signed(a, now, room, best)
    return fired, best


def signed(a: AutomatonArrays, now: Now, room: Room, s: float) -> None:
    """Put down the signs just before an event in a step, of guards that do not fire beside it:
    beyond the event they may pass zero, and fire after they have passed it the other way."""
    field, before, beside = now.ints[FIELD], (1.0 - TIED_IN_STEP) * s, (1.0 + TIED_IN_STEP) * s
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        zero = now.zeros[g - first]
        if zero[WHEN] > beside and before <= zero[SERIES_END]:
            c = room.c[row_of(a, series_of(a, now), field, g)]
            value, _ = power_value(c, 0, c.shape[0] - 1, before)
            now.signs[g - first] = 1 if value > 0.0 else -1


def zero_of(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    guard: int,
    order: int,
    h: float,
    starting: bool,
) -> float:
    """When a guard fires in a step; infinite where it does not, 0 where it is not plain.

    It is not where the guard does not begin with the sign with which it ended the last step, where
    a polynomial has it leave zero, or begin, outside the domain, where that of another solver's
    step has it leave zero to fire, by no more than the step may lose, or where it ends with another
    sign than it begins and crosses with: there it is as near to zero as rounding.
    """
    field = now.ints[FIELD]
    place = guard - a.fields[field, GUARDS]
    h = min(h, now.zeros[place, SERIES_END])  # behind which it is away from zero
    c = room.c[row_of(a, series_of(a, now), field, guard)]
    left = behind(c, h) if a.guards[guard, AFFINE] == 0 else 0.0
    crossing, bends = a.guards[guard, CROSSING], a.guards[guard, BENDS] == 1
    hides = max(hidden(a, now, room, guard) if bends else 0.0, ROUNDING_BESIDE * left)
    terms = power_size(c, 0, min(TELLING, c.shape[0] - 1), h)
    tolerance = max(left_open(a, run, guard, now.end), hides, GUARD_ROUNDING * EPS * terms)
    starting = starting or order > 0
    if not starting and not c[0] * now.signs[place] > 0.0:
        return 0.0
    slow = now.ints[PHASE] == SEES and order > 0 and abs(c[order]) * h**order <= tolerance
    goes = c[order] * crossing
    if starting and ((a.guards[guard, BOUNDS] == 1 and goes > 0.0) or (slow and goes >= 0.0)):
        return 0.0
    degree, near = c.shape[0] - 1, tolerance if order == 0 else NEVER
    if (order == 0 or (left == 0.0 and not bends)) and outweighs(c, order, degree, h, near):
        now.signs[place] = 1 if c[order] > 0.0 else -1
        return math.inf
    kinked = count(a.programs, series_of(a, now)) > 0
    if not kinked and (crossing == 0 or c[order] * crossing < 0.0):
        s = soon(c, order, degree, h)
        if s < math.inf and holds_at(a, now, room, guard, s):
            return fires(a, run, now, room, c, guard, order, s, c[order])
    listed = series(c, degree, h, order, near, room.rows, room.found)
    if listed < 0:
        return 0.0
    side, at_kink = 1.0 if c[order] > 0.0 else -1.0, bends and now.ints[CROSSED] >= 0
    reaches = at_kink and ends_at_zero(now, room, c, h)
    for k in range(listed):
        s, direction = room.found[k, 0], room.found[k, 1]
        if reaches and h - s <= TIED_IN_STEP * h:
            break
        if direction == 0.0:
            value, _ = power_value(c, 0, degree, s)
            if abs(value) <= own_open(a, run, now, room, guard, c, s):
                return 0.0
            continue
        side = direction
        if (crossing == 0 or direction * crossing > 0.0) and holds_at(a, now, room, guard, s):
            return fires(a, run, now, room, c, guard, order, s, -direction)
        if a.guards[guard, BOUNDS] == 1 or turns(a, run, now, room, guard, c, s, direction):
            return 0.0
    value, _ = power_value(c, 0, degree, h)
    size = power_size(c, 0, degree, h)
    now.signs[place] = 1 if (side if reaches else value) > 0.0 else -1
    if reaches:  # what it does at the kink is judged from both sides of it
        return math.inf
    least = 0.0 if at_kink else max(GUARD_ROUNDING * EPS * size, hides)
    clear = value * side > 0.0 and abs(value) > least
    return math.inf if clear else 0.0


def holds_at(a: AutomatonArrays, now: Now, room: Room, guard: int, s: float) -> bool:
    """Whether an edge's condition holds on the way along a step, of which ``room.c`` has the
    series. What rounding alone has moved on that way has stayed: it is as at the step's end."""
    if a.guards[guard, CONDITION] == NONE:
        return True
    along(room.c, s, room.there)
    n = now.end.shape[0]
    for i in range(n):
        if abs(room.there[i] - now.end[i]) <= TIE * EPS * abs(now.end[i]):
            room.there[i] = now.end[i]
    return holds(a, room, guard, room.c[n, 0] + s, room.there)


def holds(a: AutomatonArrays, room: Room, guard: int, t: float, x: Floats) -> bool:
    """Whether an edge's condition holds; one without a condition may always fire."""
    program = a.guards[guard, CONDITION]
    if program == NONE:
        return True
    if afresh(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return False
    return room.aside[a.programs.output[a.programs.index[program, OUTPUT]], 0] > 0.0


def ends_at_zero(now: Now, room: Room, c: Floats, h: float) -> bool:
    """Whether a guard, to its rounding or that of the time, is zero where a step ends at a kink."""
    value, slope = power_value(c, 0, c.shape[0] - 1, h)
    moved = abs(slope) * JUMPS_WITHIN * EPS * (abs(room.c[now.end.shape[0], 0]) + h)
    return abs(value) <= max(GUARD_ROUNDING * EPS * power_size(c, 0, c.shape[0] - 1, h), moved)


def hidden(a: AutomatonArrays, now: Now, room: Room, guard: int) -> float:
    """What rounding of a guard, and of the time, may hide of it where its formula changes: one that
    jumps there may have come to zero just before, as a saw does."""
    t = now.floats[T] + now.floats[TAU]
    size, rate, _ = sizes_of(a, room, guard, t, now.end)
    return GUARD_ROUNDING * EPS * (size + abs(t) * rate)


def fires(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    c: Floats,
    guard: int,
    order: int,
    s: float,
    before: float,
) -> float:
    """When a guard fires that crosses zero at ``s``, with a sign before that; 0 where that is not
    plain."""
    now.signs[guard - a.fields[now.ints[FIELD], GUARDS]] = 1 if before > 0.0 else -1
    if order == 1 and not has_left(a, now, room, c, guard, s):
        return 0.0
    return 0.0 if turns(a, run, now, room, guard, c, s, -before) else s


def left_open(a: AutomatonArrays, run: Floats, guard: int, x: Floats) -> float:
    """What the tolerances leave open of the states that a guard is made of."""
    return run[ABSOLUTE] + run[RELATIVE] * used(a, guard, x)


def used(a: AutomatonArrays, guard: int, x: Floats) -> float:
    """The size of the states that a guard is made of."""
    size = 0.0
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        size = max(size, abs(x[a.uses[k]]))
    return size


def own_open(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int, c: Floats, s: float
) -> float:
    """What the tolerances leave open of a guard on the way along a step, of which ``room.c`` has
    the series, in its own unit (:func:`in_unit`); never less than the rounding of its series
    ``c``. The unit is told from the whole way: its states may be zero there."""
    there, last, size = room.there, c.shape[0] - 1, 0.0
    along(room.c, s, there)
    own, _, _ = sizes_of(a, room, guard, room.c[now.end.shape[0], 0] + s, there)
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        size = max(size, power_size(room.c[a.uses[k]], 0, last, s))
    own += power_size(c, 0, last, s)
    return in_unit(left_open(a, run, guard, there), size, own, run[RELATIVE])


def in_unit(left: float, size: float, own: float, rtol: float) -> float:
    """What is left open of a guard, in its own unit, in which it may be far smaller than the
    states; never less than its own rounding, by which it cannot be told from zero.

    Parameters
    ----------
    left, size : float
        What is left open of the states that it is made of, and their size.
    own : float
        The sum of the terms of which it is made, where its states have that size.
    """
    return max(min(left, (left / size if size > 0.0 else rtol) * own), GUARD_ROUNDING * EPS * own)


def blurred(c: Floats, s: float) -> float:
    """By how much what a series leaves open may move its zero; a zero of order two is blurred by no
    more than where it is."""
    _, slope = power_value(c, 0, c.shape[0] - 1, s)
    left = ROUNDING_BESIDE * behind(c, s)
    return left / abs(slope) if left < abs(slope) * s else s


def turns(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    guard: int,
    c: Floats,
    s: float,
    direction: float,
) -> bool:
    """Whether a guard that crosses zero in a direction turns back before it is deeper than what the
    tolerances leave open."""
    _, slope = power_value(c, 0, c.shape[0] - 1, s)
    bend, _ = second(c, s)
    if slope * direction > 0.0 and bend * direction >= 0.0:  # it goes ever faster
        return False
    return shallow(slope, bend, direction, own_open(a, run, now, room, guard, c, s))


def shallow(slope: float, bend: float, direction: float, tolerance: float) -> bool:
    """Whether a guard that crosses zero with these derivatives turns back within a tolerance; one
    whose slope goes the other way, by rounding, does.

    As quotients: a guard may be so small that its squares are no numbers.
    """
    if slope == 0.0 or (slope > 0.0) != (direction > 0.0):
        return True
    return -2.0 * (bend / slope) * tolerance >= abs(slope)


def has_left(a: AutomatonArrays, now: Now, room: Room, c: Floats, guard: int, s: float) -> bool:
    """Whether a guard that was zero has been larger than its rounding on the way (2)."""
    size = now.zeros[guard - a.fields[now.ints[FIELD], GUARDS], MADE_OF]
    if size < 0.0:
        size, _, _ = sizes_of(a, room, guard, now.floats[T], now.x)
    noise = GUARD_ROUNDING * EPS * size + 2.0 * abs(c[0])
    for k in range(1, 4):
        value, _ = power_value(c, 0, c.shape[0] - 1, 0.25 * k * s)
        if abs(value) > noise:
            return True
    return False


def resolved(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float, h: float, kink: bool
) -> float:
    """How far of a step the guards are known: to what a step may lose by their series, or away from
    zero; -1 where they do not follow their series. ``kink``: the step ends where some may change
    their formula."""
    end = HELD_BEFORE if kink else 1.0
    field, program, shown = now.ints[FIELD], series_of(a, now), h
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        length = h
        if a.guards[g, AFFINE] == 0:
            share = min(max(run[STEP_LOSS], LAST_TERMS), CONVERGED)
            length = min(h, own_length(room.c[row_of(a, program, field, g)], share))
        now.zeros[g - first, SERIES_END] = length
        shown = min(shown, length)
    if kink and shown <= SIDE_BLUR * abs(t):  # rounding decides on the formula
        return shown
    own = run[METHOD_ORDER] == 0.0 and run[WATCHED] == 0.0
    if own and 0.0 < WORTH_BOUNDING * shown < h and count(a.programs, program) == 0:
        shown = away(a, run, now, room, program, t, shown, h)
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, AFFINE] == 0:
            length = min(shown, now.zeros[g - first, SERIES_END])
            for share in (HELD_INSIDE, end):
                if not follows(a, now, room, program, g, t, share * length):
                    return -1.0
    return shown


def follows(
    a: AutomatonArrays, now: Now, room: Room, made_by: int, guard: int, t: float, s: float
) -> bool:
    """Whether the series of a guard gives its value at a later time, but for rounding and what its
    last terms leave open."""
    field = now.ints[FIELD]
    program = a.fields[field, FIELD_PROGRAM]
    along(room.c, s, room.there)
    c = room.c[row_of(a, made_by, field, guard)]
    value, _ = power_value(c, 0, c.shape[0] - 1, s)
    if afresh(a.programs, program, 0, t + s, room.there, room.still, room.aside, room.work) < 0:
        return False
    off = abs(room.aside[row_of(a, program, field, guard), 0] - value)
    if off <= max(MISSED * EPS * abs(value), ROUNDING_BESIDE * behind(c, s)):
        return True
    size, _, _ = sizes_of(a, room, guard, t + s, room.there)
    return off <= MISSED * EPS * (size + power_size(c, 0, c.shape[0] - 1, s))


def begun(a: AutomatonArrays, now: Now, room: Room) -> None:
    """Put down the signs that guards have where a step begins: it is looked at once more."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        value = room.c[row_of(a, a.fields[field, FIELD_PROGRAM], field, g), 0]
        now.signs[g - first] = 1 if value > 0.0 else -1


def row_of(a: AutomatonArrays, program: int, field: int, guard: int) -> int:
    """The row of a guard in one of the programs of a field."""
    first = a.programs.index[program, OUTPUT]
    return a.programs.output[first + guard - a.fields[field, GUARDS]]


def series_of(a: AutomatonArrays, now: Now) -> int:
    """The program that has made the guards' series along a step."""
    return a.fields[now.ints[FIELD], WATCH if now.ints[PHASE] == SEES else FIELD_PROGRAM]


def sizes_of(
    a: AutomatonArrays, room: Room, guard: int, t: float, x: Floats
) -> tuple[float, float, float]:
    """The sums of the terms of which a guard and its first two derivatives are made."""
    program = a.guards[guard, SIZES]
    if program < 0 or afresh(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return math.inf, math.inf, math.inf
    rows, first = a.programs.output, a.programs.index[program, OUTPUT]
    size, rate = room.aside[rows[first], 0], room.aside[rows[first + 1], 0]
    return size, rate, room.aside[rows[first + 2], 0]


def at_largest(
    a: AutomatonArrays, now: Now, room: Room, guard: int, t: float, size: float
) -> float:
    """The sum of the terms of an edge's guard, which is ``size`` here, at the largest states seen,
    or the largest of these if that is less."""
    high = 0.0
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        high = max(high, now.seen[a.uses[k]])
    return min(high, max(size, sizes_of(a, room, guard, t, now.seen)[0]))


def moving(
    a: AutomatonArrays,
    now: Now,
    room: Room,
    guard: int,
    t: float,
    x: Floats,
    value: float,
    rate: float,
    waits: int,
) -> bool:
    """Whether the guard of an edge :func:`moves_off` zero at a state."""
    size, fast, _ = sizes_of(a, room, guard, t, x)
    _, fastest, _ = sizes_of(a, room, guard, t, now.seen)
    return moves_off(t, value, rate, waits, size, max(fast, fastest))


def moves_off(t: float, value: float, rate: float, waits: int, size: float, fast: float) -> bool:
    """Whether the guard of an edge is on the side on which it ``waits``, by more than the rounding
    of what it is made of, and clearly moves: it comes to zero in its own time, or has left it. How
    large the states have been before does not count then: a series of flights may be lower than
    that is rounded.

    ``size``: the sum of its terms; ``fast``: that of its rate, the larger of here and at the
    largest states seen.
    """
    noise = GUARD_ROUNDING * EPS * size + TIE * EPS * abs(t) * abs(rate)
    return value * waits > noise and abs(rate) > GUARD_ROUNDING * EPS * fast


def so_far(now: Now, x: Floats) -> float:
    """The size of the largest element that flows of a state, and of all that the run has seen."""
    return max(largest(now.seen, now.ints[FLOWING]), largest(x, now.ints[FLOWING]))


def largest(x: Floats, count: int) -> float:
    """The size of the largest of the first elements."""
    size = 0.0
    for i in range(count):
        size = max(size, abs(x[i]))
    return size
