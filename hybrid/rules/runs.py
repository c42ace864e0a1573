"""A run as far as it is plain: its loop, the sums of impacts, and the rest that follows.

What is not plain is left to the driver, as :mod:`.advance` says; of a sum that is all that needs
more than doubles to be believed, and what follows it but a rest that begins plainly.
"""

from __future__ import annotations

import math

from .advance import added, advance, after, enlarged
from .arcs import copied
from .arrays import Automaton, Floats, Left, Look, Now, Programs, Room, Sums
from .chebyshev import value
from .flights import fly
from .guards import ROUNDED, largest, row_of, starts
from .jets import jets, values
from .lengths import behind, step_length
from .places import (
    ABSOLUTE,
    AFFINE,
    AT,
    AT_REST,
    BEFORE,
    BEGINS,
    BOUNDS,
    CLOSING,
    CONTACT,
    CROSSING,
    CURVE_ROWS,
    DEGREE,
    DEPENDS,
    ENTERED,
    ERRORS,
    EXPANSIONS,
    FIELD,
    FIRED,
    FULL,
    GOES_ON,
    GUARDS,
    GUARDS_END,
    HARD,
    HOPS,
    JUMP,
    JUMPS,
    KIND,
    LAST,
    LEAVES,
    LIMIT,
    LOCAL,
    LOOK,
    LOW,
    LOW_AHEAD,
    MAKE,
    NONE,
    OPENS,
    PHASE,
    PLAIN,
    POWER,
    PROGRAM,
    RATIO,
    RELATIVE,
    REMAINING,
    REST,
    RESTS,
    SERIES,
    SIGHT,
    SPEED,
    STEPS,
    STRIKES,
    SUM,
    TAILS,
    TAU,
    TO,
    TRIED,
    UNKNOWN,
    WAS_LOW,
    T,
)
from .polynomials import power_value
from .sights import CAUTION, EXCESS, damped, seen, slows
from .sums import (
    ERROR,
    FLOOR,
    LAND,
    READ,
    STATE,
    TINY,
    TURN,
    close,
    on_curve,
    restitution,
    touch,
    turned,
)
from .sums import LIMIT as LIMITS
from .zeros import EPS, outweighs

__all__ = ("go",)

#: By which power of the time a gap opens where its load has come to be zero.
RISES = 3

#: Pieces of a tail in which other guards are looked at, each at two times; and where one is no sum
#: of states.
FEW, SHARES = 4, 100


def go(a: Automaton, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look) -> int:
    """Go on from ``now``; returns what the driver is asked for (see :mod:`.places`)."""
    status = GOES_ON
    while status == GOES_ON:
        status = advance(a, run, now, room, left)
        if status == SUM:
            status = accumulated(a, run, now, room, left, sums, look)
        elif status == OPENS:
            status = opened(a, now, room, left, sums)
        elif status == HOPS:
            status = hopped(a, run, now, room, left, sums)
        if status == JUMP:
            now.ints[PHASE] = BEGINS
    return status


def accumulated(
    a: Automaton, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look
) -> int:
    """Sum the impacts from the one at hand on, and go over their limit.

    Returns
    -------
    status : int
        ``GOES_ON`` behind the limit, or with the impact as it is; ``FULL`` behind the limit;
        ``MAKE``, to be called again; or ``JUMP``, and nothing has changed.
    """
    guard, place, field = now.ints[FIRED], now.ints[JUMPS], now.ints[FIELD]
    if run[RESTS] == 0.0:
        return JUMP
    flow, at = a.fields[field, PROGRAM], a.guards[guard, AT]
    if at == UNKNOWN:
        return MAKE
    if at < 0:
        return JUMP
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    x, v, column = left.after[place], now.floats[SPEED], guard - a.fields[field, GUARDS]
    rtol, atol = run[CLOSING] * run[RELATIVE], run[CLOSING] * run[ABSOLUTE]
    local = a.guards[guard, LOCAL] == 1
    degree, r = close(a.programs, flow, at, column, False, local, t, x, v, rtol, atol, sums)
    if degree == 0:
        now.floats[TRIED] = v
        return GOES_ON
    if a.guards[guard, REST] == UNKNOWN:
        return MAKE
    tail = now.ints[TAILS]
    put(tail, degree, r, v, place + 1, left, sums)
    if a.guards[guard, REST] < 0:
        return JUMP
    if not clear(a, now, room, left, sums, t, x):
        now.floats[TRIED] = v
        return GOES_ON
    if not unreached(a, now, room, t, x, listed(left, tail, 1)):
        return JUMP
    if not believed(a, run, now, flow, at, guard, tail, t, x, left, sums, look):
        return JUMP
    end, rest = after(t, low, left.sums[tail, REMAINING])
    if (run[LAST] - end) - rest < 0.0:
        now.floats[TRIED] = v
        return GOES_ON
    return rests(a, now, room, left, sums, t, low)


def put(tail: int, degree: int, r: float, v: float, jumps: int, left: Left, sums: Sums) -> None:
    """Put a sum down."""
    row, first = left.sums[tail], tail * CURVE_ROWS
    row[BEFORE], row[DEGREE], row[LEAVES], row[RATIO] = jumps, degree, v, r
    row[REMAINING] = sums.lines[LIMITS, 0]
    for k in range(degree + 1):
        copied(sums.lines[k], left.curves[first + k])
    copied(sums.lines[ERROR], left.curves[first + ERRORS])
    copied(sums.lines[STATE], left.curves[first + LIMIT])


def believed(
    a: Automaton,
    run: Floats,
    now: Now,
    flow: int,
    at: int,
    guard: int,
    tail: int,
    t: float,
    x: Floats,
    left: Left,
    sums: Sums,
    look: Look,
) -> bool:
    """Whether nothing hides between the flights of a sum, as far as doubles tell."""
    sight, row, first = a.guards[guard, SIGHT], left.sums[tail], tail * CURVE_ROWS
    curve = left.curves[first : first + int(row[DEGREE]) + 1]
    if sight == HARD:
        return False
    if a.guards[guard, DEPENDS] == 1:
        column = guard - a.fields[now.ints[FIELD], GUARDS]
        v, r, remaining, end = row[LEAVES], row[RATIO], row[REMAINING], t + row[REMAINING]
        error = max(left.curves[first + ERRORS, 0], FLOOR * abs(end))
        allowed = CAUTION * error * (1.0 - r) / remaining
        limit = left.curves[first + LIMIT, : x.shape[0]]
        most = count(row, t)
        if not damped(
            a, flow, at, column, curve, t, x, v, r, most, allowed, sums, look
        ) or not slows(a, at, end, limit, v, sums):
            return False
    if sight == NONE:
        return True
    excess = EXCESS * run[CLOSING] ** 0.5
    return seen(a, flow, at, sight, curve, t, x, row[LEAVES], row[RATIO], excess, sums, look)


def rests(a: Automaton, now: Now, room: Room, left: Left, sums: Sums, t: float, low: float) -> int:
    """Begin the rest that follows a sum, where its start leaves nothing to weigh."""
    guard, place, tail, n = now.ints[FIRED], now.ints[JUMPS], now.ints[TAILS], now.x.shape[0]
    field, first = a.guards[guard, REST], tail * CURVE_ROWS
    if a.fields[field, PLAIN] == 0:
        return JUMP
    x, (end, rest) = left.curves[first + AT_REST, :n], after(t, low, left.sums[tail, REMAINING])
    held(a.programs, a.guards[guard, AT], end, left.curves[first + LIMIT, :n], x, sums)
    if not begun(a, now, room, field, -1, 1, end, rest, x):
        return JUMP
    added(now, left, guard, t, low)
    enlarged(now, left.after[place])
    enlarged(now, now.x)
    now.ints[TAILS] = tail + 1
    return FULL if tail + 1 == left.sums.shape[0] else GOES_ON


def opened(a: Automaton, now: Now, room: Room, left: Left, sums: Sums) -> int:
    """End the rest of a contact whose load is zero, where what follows begins plainly.

    Returns
    -------
    status : int
        As that of :func:`accumulated`.
    """
    guard, place, at = now.ints[FIRED], now.ints[JUMPS], a.guards[now.ints[FIRED], AT]
    if a.guards[guard, TO] == UNKNOWN or at == UNKNOWN:
        return MAKE
    if at < 0 or a.fields[a.guards[guard, TO], PLAIN] == 0:
        return JUMP
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    held(a.programs, at, t, now.end, left.before[place], sums)
    copied(left.before[place], left.after[place])
    field, contact = a.guards[guard, TO], a.guards[guard, REST]
    if not begun(a, now, room, field, contact, RISES, t, low, left.after[place]):
        return JUMP
    added(now, left, guard, t, low)
    enlarged(now, now.x)
    return GOES_ON


def hopped(a: Automaton, run: Floats, now: Now, room: Room, left: Left, sums: Sums) -> int:
    """Fly the flight that begins here, which is so low that the gap would drown in the rounding of
    the state (7), by its series, in which gap and gap speed are coordinates of their own.

    Returns
    -------
    status : int
        ``GOES_ON`` to the impact at its end; ``FULL``, and it is still to be flown; or ``LOOK``,
        where it is long, goes beyond the end of the run, another guard comes near, or there is no
        room for it.
    """
    field, guard, v = now.ints[FIELD], now.ints[FIRED], now.floats[SPEED]
    flow, at, t = a.fields[field, PROGRAM], a.guards[guard, AT], now.floats[T]
    status, time, u, pieces, _ = fly(
        a.programs, flow, guard - a.fields[field, GUARDS], False, t, now.x, v, sums.starts,
        sums.lengths, sums.series, sums.branch, sums.end, sums.c, sums.aside, sums.work, sums.rows,
        sums.found, sums.sides,
    )  # fmt: skip
    end, low = after(t, now.floats[LOW], time)
    if status < 0 or (run[LAST] - end) - low < 0.0:
        return LOOK
    if now.ints[STEPS] + pieces > left.owner.shape[0]:
        return FULL if now.ints[STEPS] + now.ints[JUMPS] > 0 else LOOK
    read, n, before = sums.lines[READ], now.x.shape[0], left.before[now.ints[JUMPS]]
    values(a.programs, at + LAND, t + time, sums.end, sums.sides, sums.c, sums.work, read)
    copied(read[:n], before)
    if not unreached(a, now, room, t, now.x, time):
        return LOOK
    speed = restitution(a.programs, at, t + time, before, u, sums) * -u
    values(a.programs, at + TURN, t + time, before, sums.sides, sums.c, sums.work, read)
    copied(before, now.end)
    copied(before, left.after[now.ints[JUMPS]])
    turned(left.after[now.ints[JUMPS]], speed - read[n], read)
    for piece in range(pieces):
        taken(now, left, sums, piece)
    now.floats[TAU], now.floats[SPEED] = time, speed
    now.ints[STEPS] += pieces
    now.ints[EXPANSIONS] += pieces
    now.ints[LOW_AHEAD], now.ints[WAS_LOW], now.ints[PHASE] = 0, 1, STRIKES
    return GOES_ON


def taken(now: Now, left: Left, sums: Sums, piece: int) -> None:
    """Keep a piece of a flight as a step."""
    place, n = now.ints[STEPS] + piece, now.x.shape[0]
    left.owner[place] = now.ints[JUMPS]
    left.spans[place, 0], left.spans[place, 1] = sums.starts[piece], sums.lengths[piece]
    if left.series.shape[0] > 0:
        for i in range(n):
            own, kept = sums.series[piece * n + i], left.series[place * n + i]
            for k in range(kept.shape[0]):
                kept[k] = own[k] if k < own.shape[0] else 0.0


def unreached(a: Automaton, now: Now, room: Room, t: float, x: Floats, length: float) -> bool:
    """Whether no other guard can be zero within a flight, and no other contact has been passed: the
    first term of each outweighs rounding and all others. What has kinks is left to the driver."""
    field, fired = now.ints[FIELD], now.ints[FIRED]
    program, first, order = a.fields[field, PROGRAM], a.fields[field, GUARDS], room.c.shape[1] - 1
    if a.fields[field, GUARDS_END] - first == 1:
        return True
    if jets(a.programs, program, order, t, x, room.still, room.c, room.work) < 0:
        return False
    if room.still.shape[0] > 0 or not length <= step_length(room.c, x.shape[0]):
        return False
    rounding = ROUNDED * EPS * max(largest(now.seen), largest(x))
    for g in range(first, a.fields[field, GUARDS_END]):
        c = room.c[row_of(a, program, field, g)]
        passed = a.guards[g, KIND] == CONTACT and c[0] <= 0.0
        clear = outweighs(c, 0, order, length, rounding + behind(c, length))
        if g != fired and (passed or not clear):
            return False
    return True


def begun(
    a: Automaton,
    now: Now,
    room: Room,
    field: int,
    used: int,
    power: int,
    t: float,
    low: float,
    x: Floats,
) -> bool:
    """Begin an arc in another field, if its start leaves nothing to weigh; nothing that the driver
    asks for has changed if it does."""
    own, guard = now.ints[FIELD], now.ints[FIRED]
    copied(x, now.x)
    now.floats[T], now.floats[LOW] = t, low
    now.ints[FIELD], now.ints[FIRED], now.ints[POWER], now.ints[ENTERED] = field, used, power, 0
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    program, order = a.fields[field, PROGRAM], room.c.shape[1] - 1
    fit = jets(a.programs, program, order, t, now.x, room.sides, room.c, room.work) == 0
    if not (fit and starts(a, now, room)):
        now.ints[FIELD], now.ints[FIRED], now.ints[POWER] = own, guard, 1
        return False
    now.ints[SERIES], now.ints[ENTERED], now.ints[PHASE] = -1, 1, BEGINS
    now.ints[WAS_LOW] = 0
    return True


def clear(a: Automaton, now: Now, room: Room, left: Left, sums: Sums, t: float, x: Floats) -> bool:
    """Whether no other guard is reached along the tail, impacts and flights."""
    field, guard, place = now.ints[FIELD], now.ints[FIRED], now.ints[TAILS]
    first, last = a.fields[field, GUARDS], a.fields[field, GUARDS_END]
    if last - first == 1:
        return True
    shares = FEW
    for g in range(first, last):
        now.signs[g - first] = 0
        if g != guard and a.guards[g, AFFINE] == 0:
            shares = SHARES
    row, begin, n = left.sums[place], place * CURVE_ROWS, x.shape[0]
    limit, most = left.curves[begin + LIMIT, :n], count(row, t)
    remaining = row[REMAINING]
    for i in range(3 * shares):
        impact = i - 2 * shares
        since = remaining * i / (2 * shares - 1)
        if impact >= 0:
            since = listed(left, place, impact) if impact <= most else remaining
        if since < remaining:
            along_tail(a, now, left, sums, t, x, most, since, room.there)
            if not noted(a, now, room, t + since, room.there, 0.0):
                return False
    return noted(a, now, room, t + remaining, limit, ROUNDED * EPS * largest(limit))


def noted(a: Automaton, now: Now, room: Room, t: float, x: Floats, rounding: float) -> bool:
    """Note the signs of the other guards; whether they are inside, and those that they were."""
    field, fired = now.ints[FIELD], now.ints[FIRED]
    program, first = a.fields[field, PROGRAM], a.fields[field, GUARDS]
    if jets(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return False
    for g in range(first, a.fields[field, GUARDS_END]):
        if g != fired:
            value, was = room.aside[row_of(a, program, field, g), 0], now.signs[g - first]
            if was != 0:
                if not value * was > -rounding:
                    return False
            elif value == 0.0:
                return False
            else:
                now.signs[g - first] = 1 if value > 0.0 else -1
            inside = now.signs[g - first] * a.guards[g, CROSSING] <= 0
            if a.guards[g, BOUNDS] == 1 and not inside:
                return False
    return True


def count(row: Floats, t: float) -> int:
    """Impacts of a tail that a double can still tell from the limit."""
    end = abs(t + row[REMAINING])
    share = max(math.nextafter(end, math.inf) - end, TINY) / row[REMAINING]
    return max(0, math.ceil(math.log(min(max(share, TINY), 1.0)) / math.log(row[RATIO])))


def listed(left: Left, place: int, n: int) -> float:
    """The time from a tail's first impact to the n-th after it."""
    degree = int(left.sums[place, DEGREE])
    curve = left.curves[place * CURVE_ROWS :]
    return value(curve, degree, 0, left.sums[place, RATIO] ** n) if n > 0 else 0.0


def along_tail(
    a: Automaton,
    now: Now,
    left: Left,
    sums: Sums,
    t: float,
    x: Floats,
    most: int,
    since: float,
    state: Floats,
) -> None:
    """The state at a time after a tail's first impact: by the flight that covers it."""
    place, guard, field = now.ints[TAILS], now.ints[FIRED], now.ints[FIELD]
    row, begin, n = left.sums[place], place * CURVE_ROWS, x.shape[0]
    low, high = 0, most
    while low < high:
        middle = (low + high + 1) // 2
        if listed(left, place, middle) <= since:
            low = middle
        else:
            high = middle - 1
    degree, w = int(row[DEGREE]), row[RATIO] ** low
    curve, at = left.curves[begin : begin + degree + 1], a.guards[guard, AT]
    when, v = on_curve(
        a.programs, at, curve, degree, t, x, row[LEAVES], w, 1.0, sums, sums.lines[STATE, :n]
    )
    flow, column = a.fields[field, PROGRAM], guard - a.fields[field, GUARDS]
    status, length, _, pieces, _ = fly(
        a.programs, flow, column, False, when, sums.lines[STATE, :n], v, sums.starts, sums.lengths,
        sums.series, sums.branch, sums.end, sums.c, sums.aside, sums.work, sums.rows, sums.found,
        sums.sides,
    )  # fmt: skip
    if status < 0:
        copied(left.curves[begin + LIMIT, :n], state)
        return
    s = min(max(since - listed(left, place, low), 0.0), length)
    piece = pieces - 1
    while piece > 0 and sums.starts[piece] > s:
        piece -= 1
    for i in range(n):
        c = sums.series[piece * n + i]
        state[i], _ = power_value(c, 0, c.shape[0] - 1, s - sums.starts[piece])


def held(p: Programs, at: int, t: float, x: Floats, at_rest: Floats, sums: Sums) -> None:
    """The state with gap and gap speed at zero: two steps of Newton's method, and one."""
    copied(x, at_rest)
    touch(p, at, t, at_rest, sums)
    touch(p, at, t, at_rest, sums)
    turned(at_rest, -sums.lines[READ, x.shape[0]], sums.lines[READ])
