"""A plain arc: Taylor steps from a jump to the first guard that fires, and onto it.

Plain is an arc whose start, events and end leave nothing to weigh: no guard next to zero but the
one just used, no two that fire next to each other, no tangency, no flight as low as rounding. Where
it is not, the status is ``LOOK``, and the driver flies the arc again with all the rules of
``docs/semantics.md``. Numbers in brackets are its rules.
"""

from __future__ import annotations

import math

from .arrays import Automaton, Floats, Left, Matrix, Now, Room
from .checks import MIDDLE, MISSED
from .jets import OUTPUT, jets
from .kinks import turn
from .lengths import ROUNDING, own_length
from .polynomials import power_value
from .steps import step
from .zeros import EPS, NEVER, series

#: Columns of the table of fields: its program, where its guards begin and end, whether its arcs may
#: be plain, and whether contacts are held in it.
PROGRAM, GUARDS, GUARDS_END, PLAIN, HELD = 0, 1, 2, 3, 4

#: Columns of the table of guards. ``TO`` is a field, -1 where it is not known yet; ``RESET``,
#: ``LAND`` and ``SIZES`` are programs, -1 where there is none; ``USES`` is where the elements of
#: the state begin that it is made of.
KIND, CROSSING, BOUNDS, AFFINE, TO, RESET, LAND, SIZES, USES, USES_END = range(10)

#: Kinds of guards whose jumps are made here.
EDGE, CONTACT = 0, 1

#: Places in the numbers of a run: last time, tolerances, series of impacts, and the longest steps:
#: the first of an arc, and the others.
LAST, ABSOLUTE, RELATIVE, SHARE, PATIENT, FIRST_STEP, MAX_STEP = 0, 1, 2, 3, 4, 5, 6

#: Places in a state's floats and integers.
T, LOW, TAU, TRIED = 0, 1, 2, 3
FIELD, FIRED, SERIES, COUNT, ENTERED, JUMPS, STEPS, EXPANSIONS = 0, 1, 2, 3, 4, 5, 6, 7

#: Why a call comes back: the run is at its end; the arrays are full; an arc has to be looked at
#: with all the rules; a jump has.
END, FULL, LOOK, JUMP = 1, 2, 3, 4

#: A guard has fired, and the state is on it.
LANDED = 0

#: A guard nearer to zero than this share of the state is looked at more closely.
NEAR = 1e-6

#: Rounding of a guard, in spacings of the terms that it is made of.
ROUNDED = 64.0

#: Events this near in time, in spacings of floats, are at one time; those looked at for that lie
#: this near in the step, as landing may move the first by as much.
TIE, BESIDE = 4.0, 1e-6

#: Most steps onto a guard: Newton's method, from a zero of its series.
LANDINGS = 10

#: A shift onto a guard that is so small beside the way to it is made along a straight line.
SMALL = 1e-6


def arc(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Fly the arc that begins at ``now`` to its end, which is put into ``now.end``.

    Returns
    -------
    status : int
        ``LANDED``, or ``END``; or ``FULL`` or ``LOOK``, and nothing has changed.
    """
    field, begun = now.ints[FIELD], now.ints[STEPS]
    if a.fields[field, PLAIN] == 0:
        return LOOK
    program, length = a.fields[field, PROGRAM], (run[LAST] - now.floats[T]) - now.floats[LOW]
    tau = 0.0
    made = 0
    copied(now.x, now.end)
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    while tau < length:
        if begun + made >= left.owner.shape[0]:
            return FULL
        t = now.floats[T] + tau
        status, h, crossed = step(
            a.programs,
            program,
            a.fields[field, HELD] == 1,
            t,
            tau,
            now.end,
            min(length - tau, run[FIRST_STEP] if made == 0 else run[MAX_STEP]),
            room.sides,
            room.c,
            room.aside,
            room.work,
            room.rows,
            room.found,
            now.end,
        )
        now.ints[EXPANSIONS] += 1
        if status < 0 or (made == 0 and not starts(a, now, room)):
            return LOOK
        shown = resolved(a, now, room, t, h)
        if not shown > 0.0:
            return LOOK
        if shown < h:
            h, crossed = shown, -1
        guard, s = first_event(a, run, now, room, h, made == 0)
        if guard >= 0:
            s = onto(a, now, room, guard, tau, s, min(h, length - tau))
        if not s > 0.0:
            return LOOK
        end = min(h, s)
        kept(now, room, left, begun + made, tau, end)
        made += 1
        if guard >= 0:
            now.floats[TAU], now.ints[FIRED], now.ints[STEPS] = tau + s, guard, begun + made
            return LANDED
        moved(room.c, end, now.end)
        turn(a.programs, program, crossed, room.c, room.sides)
        tau = length if tau + h >= length else tau + h
    now.floats[TAU], now.ints[STEPS] = length, begun + made
    return END


def copied(x: Floats, y: Floats) -> None:
    """Copy a state."""
    for i in range(x.shape[0]):
        y[i] = x[i]


def moved(c: Matrix, s: float, x: Floats) -> None:
    """The states at a time after their expansion."""
    for i in range(x.shape[0]):
        x[i], _ = power_value(c[i], 0, c.shape[1] - 1, s)


def kept(now: Now, room: Room, left: Left, place: int, tau: float, h: float) -> None:
    """Keep a step: the arc it belongs to, where it begins, how long it is, and its series."""
    left.owner[place] = now.ints[JUMPS]
    left.spans[place, 0] = tau
    left.spans[place, 1] = h
    n = now.x.shape[0]
    if left.series.shape[0] > 0:
        for i in range(n):
            for k in range(room.c.shape[1]):
                left.series[place * n + i, k] = room.c[i, k]


def row_of(a: Automaton, field: int, guard: int) -> int:
    """The row of a guard in the program of a field."""
    first = a.programs.index[a.fields[field, PROGRAM], OUTPUT]
    return a.programs.output[first + guard - a.fields[field, GUARDS]]


def size_of(a: Automaton, guard: int, order: int, t: float, x: Floats, room: Room) -> float:
    """The sum of the terms of which a guard (0) or its rate (1) is made."""
    program = a.guards[guard, SIZES]
    if jets(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return math.inf
    return room.aside[a.programs.output[a.programs.index[program, OUTPUT] + order], 0]


def starts(a: Automaton, now: Now, room: Room) -> bool:
    """Whether the start of an arc leaves nothing to weigh (3); notes the guards' orders."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if now.ints[ENTERED] == 0:
            now.orders[g - first] = 1 if g == now.ints[FIRED] else 0
            fit = leaves(a, now, room, g) if g == now.ints[FIRED] else away(a, now, room, g)
            if not fit:
                return False
    return True


def leaves(a: Automaton, now: Now, room: Room, guard: int) -> bool:
    """Whether the guard just used, which is zero, leaves zero into the domain, by its rate."""
    rate = room.c[row_of(a, now.ints[FIELD], guard), 1]
    if not abs(rate) > ROUNDED * EPS * size_of(a, guard, 1, now.floats[T], now.x, room):
        return False
    return a.guards[guard, BOUNDS] == 0 or rate * a.guards[guard, CROSSING] <= 0.0


def away(a: Automaton, now: Now, room: Room, guard: int) -> bool:
    """Whether another guard is further from zero than rounding, and inside the domain."""
    t, row = now.floats[T], row_of(a, now.ints[FIELD], guard)
    value, rate = room.c[row, 0], room.c[row, 1]
    if not abs(value) > NEAR * max(largest(now.seen), largest(now.x)):
        noise = size_of(a, guard, 0, t, now.x, room) + abs(t) * abs(rate) + largest(now.seen)
        if not abs(value) > ROUNDED * EPS * noise:
            return False
    return a.guards[guard, BOUNDS] == 0 or value * a.guards[guard, CROSSING] <= 0.0


def largest(x: Floats) -> float:
    """The size of the largest element."""
    size = 0.0
    for i in range(x.shape[0]):
        size = max(size, abs(x[i]))
    return size


def resolved(a: Automaton, now: Now, room: Room, t: float, h: float) -> float:
    """How far of a step the guards' series have converged; -1 where they do not follow them."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, AFFINE] == 0:
            h = min(h, own_length(room.c[row_of(a, field, g)], ROUNDING))
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, AFFINE] == 0:
            for share in (MIDDLE, 1.0):
                if not follows(a, now, room, g, t, share * h):
                    return -1.0
    return h


def follows(a: Automaton, now: Now, room: Room, guard: int, t: float, s: float) -> bool:
    """Whether the series of a guard gives its value at a later time, but for rounding."""
    field = now.ints[FIELD]
    row = row_of(a, field, guard)
    moved(room.c, s, room.there)
    value, size = summed(room.c[row], s)
    size += size_of(a, guard, 0, t + s, room.there, room)
    program = a.fields[field, PROGRAM]
    if jets(a.programs, program, 0, t + s, room.there, room.still, room.aside, room.work) < 0:
        return False
    return abs(room.aside[row, 0] - value) <= MISSED * EPS * size


def summed(c: Floats, s: float) -> tuple[float, float]:
    """The value of a series, and the sum of its terms' sizes."""
    value = 0.0
    size = 0.0
    for k in range(c.shape[0] - 1, -1, -1):
        value = value * s + c[k]
        size = size * s + abs(c[k])
    return value, size


def first_event(
    a: Automaton, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """The guard that fires first in a step (-1: none), and when (1); at 0 if that is not plain."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    fired, best, second = -1, math.inf, math.inf
    for g in range(first, a.fields[field, GUARDS_END]):
        order = now.orders[g - first] if starting else 0
        s = zero_of(a, run, now, room, g, order, h)
        if s < best:
            fired, best, second = g, s, best
        else:
            second = min(second, s)
    spacing = EPS * abs(now.floats[T])
    if second - best <= BESIDE * h + TIE * spacing:
        return fired, 0.0
    return fired, best


def zero_of(
    a: Automaton, run: Floats, now: Now, room: Room, guard: int, order: int, h: float
) -> float:
    """When a guard fires in a step; infinite where it does not, 0 where it is not plain."""
    c = room.c[row_of(a, now.ints[FIELD], guard)]
    crossing, tolerance = a.guards[guard, CROSSING], left_open(a, run, guard, now.end)
    degree = c.shape[0] - 1
    count = series(c, degree, h, order, NEVER if order else tolerance, room.rows, room.found)
    if count < 0:
        return 0.0
    for k in range(count):
        s, direction = room.found[k, 0], room.found[k, 1]
        if direction == 0.0:
            return 0.0
        if crossing == 0 or direction * crossing > 0.0:
            left = order == 0 or has_left(a, now, room, c, guard, s)
            return s if left and not turns(c, s, tolerance) else 0.0
        if a.guards[guard, BOUNDS] == 1:
            return 0.0
    value, size = summed(c, h)
    return math.inf if abs(value) > ROUNDED * EPS * size else 0.0


def left_open(a: Automaton, run: Floats, guard: int, x: Floats) -> float:
    """What the tolerances leave open of a guard."""
    size = 0.0
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        size = max(size, abs(x[a.uses[k]]))
    return run[ABSOLUTE] + run[RELATIVE] * size


def turns(c: Floats, s: float, tolerance: float) -> bool:
    """Whether a guard that crosses zero turns back before it is deeper than a tolerance."""
    slope = 0.0
    bend = 0.0
    for k in range(c.shape[0] - 1, 0, -1):
        bend = bend * s + k * (k - 1) * c[k] if k > 1 else bend
        slope = slope * s + k * c[k]
    return slope * bend <= 0.0 and slope * slope <= 2.0 * abs(bend) * tolerance


def has_left(a: Automaton, now: Now, room: Room, c: Floats, guard: int, s: float) -> bool:
    """Whether a guard that was zero has been larger than its rounding on the way (2)."""
    noise = ROUNDED * EPS * size_of(a, guard, 0, now.floats[T], now.x, room) + 2.0 * abs(c[0])
    for k in range(1, 4):
        value, _ = summed(c, 0.25 * k * s)
        if abs(value) > noise:
            return True
    return False


def onto(
    a: Automaton,
    now: Now,
    room: Room,
    guard: int,
    tau: float,
    s: float,
    most: float,
) -> float:
    """The time in a step at which a guard is zero, to rounding, the state put into ``now.end``.

    0 where it is not plain (5).
    """
    program, row = a.fields[now.ints[FIELD], PROGRAM], row_of(a, now.ints[FIELD], guard)
    t, least = now.floats[T] + tau, TIE * EPS * (abs(now.floats[T]) + tau)
    for _ in range(LANDINGS):
        if not least < s <= most:
            return 0.0
        moved(room.c, s, now.end)
        if jets(a.programs, program, 1, t + s, now.end, room.still, room.aside, room.work) < 0:
            return 0.0
        if room.aside[row, 1] == 0.0:
            return 0.0
        shift = -room.aside[row, 0] / room.aside[row, 1]
        if abs(shift) <= SMALL * s:
            if not least < s + shift <= most:
                return 0.0
            for i in range(now.end.shape[0]):
                now.end[i] += shift * room.aside[i, 1]
            return s + shift
        s += shift
    return 0.0
