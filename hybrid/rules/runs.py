"""A run as far as it is plain: its loop, the sums of impacts, and the rest that follows.

What is not plain is left to the driver, as :mod:`.advance` says; of a sum that is all that needs
more than doubles to be believed, and what follows it but a rest that begins plainly.
"""

from __future__ import annotations

from .advance import added, advance, after, enlarged
from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Look, Now, Programs, Room, Sums
from .entries import starts
from .guards import GUARD_ROUNDING, largest
from .hops import hop
from .jets import jets
from .places import (
    ABSOLUTE,
    AT,
    AT_LIMIT,
    AT_REST,
    BEGINS,
    BOUNDS,
    CLOSING,
    CROSSING,
    CURVE_DEGREE,
    CURVE_ROWS,
    DEPENDS,
    ENTERED,
    ERRORS,
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FIRED,
    FLIGHTS,
    FLOWN,
    FULL,
    GAP_SPEED,
    GOES_ON,
    GUARD_POWER,
    GUARDS,
    GUARDS_END,
    HARD,
    HOPS,
    JUMP,
    JUMPS_BEFORE,
    JUMPS_MADE,
    LAST_SPEED,
    LAST_TIME,
    LOCAL,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    MAKE,
    METHOD_ORDER,
    NONE,
    OPENS,
    PHASE,
    PLAIN,
    RATIO,
    RELATIVE,
    REMAINING,
    REST,
    REST_AFTER,
    RISES,
    SERIES,
    SIGHT,
    STEPS_MADE,
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
from .sights import EXCESS, LAW_CAUTION, damped, seen, slows
from .sums import (
    ERROR,
    READ,
    STATE_THERE,
    SUM_FLOOR,
    close,
    touch,
    turned,
)
from .sums import TO_LIMIT as LIMITS
from .tails import clear, count
from .zeros import EPS

__all__ = ("go",)


def go(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look
) -> int:
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
    a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look
) -> int:
    """Sum the impacts from the one at hand on, and go over their limit.

    Returns
    -------
    status : int
        ``GOES_ON`` behind the limit, or with the impact as it is; ``FULL`` behind the limit;
        ``MAKE``, to be called again; or ``JUMP``, and nothing has changed.
    """
    guard, place, field = now.ints[FIRED], now.ints[JUMPS_MADE], now.ints[FIELD]
    if run[REST_AFTER] == 0.0:
        return JUMP
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    if at == UNKNOWN:
        return MAKE
    if at < 0:
        return JUMP
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    x, v, column = left.after[place], now.floats[GAP_SPEED], guard - a.fields[field, GUARDS]
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
    if not untouched(a, now, left, sums, flow, at, column, t, x):
        now.floats[TRIED] = v
        return GOES_ON
    if not believed(a, run, now, flow, at, guard, tail, t, x, left, sums, look):
        return JUMP
    end, rest = after(t, low, left.sums[tail, REMAINING])
    if (run[LAST_TIME] - end) - rest < 0.0:
        now.floats[TRIED] = v
        return GOES_ON
    return rests(a, now, room, left, sums, t, low)


def put(tail: int, degree: int, r: float, v: float, jumps: int, left: Left, sums: Sums) -> None:
    """Put a sum down."""
    row, first = left.sums[tail], tail * CURVE_ROWS
    row[JUMPS_BEFORE], row[CURVE_DEGREE], row[LAST_SPEED], row[RATIO] = jumps, degree, v, r
    row[REMAINING] = sums.lines[LIMITS, 0]
    for k in range(degree + 1):
        copied(sums.lines[k], left.curves[first + k])
    copied(sums.lines[ERROR], left.curves[first + ERRORS])
    copied(sums.lines[STATE_THERE], left.curves[first + AT_LIMIT])


def believed(
    a: AutomatonArrays,
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
    curve = left.curves[first : first + int(row[CURVE_DEGREE]) + 1]
    if sight == HARD:
        return False
    if a.guards[guard, DEPENDS] == 1:
        column = guard - a.fields[now.ints[FIELD], GUARDS]
        v, r, remaining, end = row[LAST_SPEED], row[RATIO], row[REMAINING], t + row[REMAINING]
        error = max(left.curves[first + ERRORS, 0], SUM_FLOOR * abs(end))
        allowed = LAW_CAUTION * error * (1.0 - r) / remaining
        limit = left.curves[first + AT_LIMIT, : x.shape[0]]
        most = count(t, r, remaining)
        if not damped(
            a, flow, at, column, curve, t, x, v, r, most, allowed, sums, look
        ) or not slows(a, at, end, limit, v, sums):
            return False
    if sight == NONE:
        return True
    excess = EXCESS * run[CLOSING] ** 0.5
    return seen(a, flow, at, sight, curve, t, x, row[LAST_SPEED], row[RATIO], excess, sums, look)


def rests(
    a: AutomatonArrays, now: Now, room: Room, left: Left, sums: Sums, t: float, low: float
) -> int:
    """Begin the rest that follows a sum, where its start leaves nothing to weigh."""
    guard, place, tail, n = now.ints[FIRED], now.ints[JUMPS_MADE], now.ints[TAILS], now.x.shape[0]
    field, first = a.guards[guard, REST], tail * CURVE_ROWS
    if a.fields[field, PLAIN] == 0:
        return JUMP
    x, (end, rest) = left.curves[first + AT_REST, :n], after(t, low, left.sums[tail, REMAINING])
    held(a.programs, a.guards[guard, AT], end, left.curves[first + AT_LIMIT, :n], x, sums)
    if not begun(a, now, room, field, -1, 1, end, rest, x):
        return JUMP
    added(now, left, guard, t, low)
    enlarged(now, left.after[place])
    enlarged(now, now.x)
    now.ints[TAILS] = tail + 1
    return FULL if tail + 1 == left.sums.shape[0] else GOES_ON


def opened(a: AutomatonArrays, now: Now, room: Room, left: Left, sums: Sums) -> int:
    """End the rest of a contact whose load is zero, where what follows begins plainly.

    Returns
    -------
    status : int
        As that of :func:`accumulated`.
    """
    guard, place, at = now.ints[FIRED], now.ints[JUMPS_MADE], a.guards[now.ints[FIRED], AT]
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


def hopped(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums) -> int:
    """Fly the flight that begins here, which is so low that the gap would drown in the rounding of
    the state (7), by its series, in which gap and gap speed are coordinates of their own.

    Returns
    -------
    status : int
        ``GOES_ON`` to the impact at its end, or ``FLOWN``, where its pieces are to be kept before
        that; ``FULL``, and it is still to be flown; or ``LOOK``, where it is long, goes beyond the
        end of the run, another guard comes near, or there is no room for it.
    """
    field, guard, place = now.ints[FIELD], now.ints[FIRED], now.ints[JUMPS_MADE]
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    t, v = now.floats[T], now.floats[GAP_SPEED]
    before, behind = left.before[place], left.after[place]
    rounding = GUARD_ROUNDING * EPS * max(largest(now.seen), largest(now.x))
    status, time, speed, pieces = hop(
        a.programs, flow, at, guard - a.fields[field, GUARDS], False, t, now.x, v, rounding,
        now.signs[: domain(a, now)], before, behind, sums,
    )  # fmt: skip
    end, low = after(t, now.floats[LOW], time)
    if status < 0 or (run[LAST_TIME] - end) - low < 0.0:
        return LOOK
    own = run[METHOD_ORDER] == 0.0
    if own and now.ints[STEPS_MADE] + pieces > left.owner.shape[0]:
        return FULL if now.ints[STEPS_MADE] + now.ints[JUMPS_MADE] > 0 else LOOK
    copied(before, now.end)
    now.floats[TAU], now.floats[GAP_SPEED] = time, speed
    now.ints[LOW_AHEAD], now.ints[WAS_LOW], now.ints[PHASE] = 0, 1, STRIKES
    now.ints[FLIGHTS] += 1
    if not own:
        now.ints[MADE] = pieces
        return FLOWN
    for piece in range(pieces):
        taken(now, left, sums, piece)
    now.ints[STEPS_MADE] += pieces
    now.ints[EXPANSIONS] += pieces
    return GOES_ON


def taken(now: Now, left: Left, sums: Sums, piece: int) -> None:
    """Keep a piece of a flight as a step."""
    place, n = now.ints[STEPS_MADE] + piece, now.x.shape[0]
    left.owner[place] = now.ints[JUMPS_MADE]
    left.spans[place, 0], left.spans[place, 1] = sums.starts[piece], sums.lengths[piece]
    if left.series.shape[0] > 0:
        for i in range(n):
            own, kept = sums.series[piece * n + i], left.series[place * n + i]
            for k in range(kept.shape[0]):
                kept[k] = own[k] if k < own.shape[0] else 0.0


def begun(
    a: AutomatonArrays,
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
    now.ints[FIELD], now.ints[FIRED] = field, used
    now.ints[GUARD_POWER], now.ints[ENTERED] = power, 0
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    program, order = a.fields[field, FIELD_PROGRAM], room.c.shape[1] - 1
    fit = jets(a.programs, program, order, t, now.x, room.sides, room.c, room.work) == 0
    if not (fit and starts(a, now, room) == NONE):
        now.ints[FIELD], now.ints[FIRED], now.ints[GUARD_POWER] = own, guard, 1
        return False
    now.ints[SERIES], now.ints[ENTERED], now.ints[PHASE] = -1, 1, BEGINS
    now.ints[WAS_LOW] = 0
    return True


def untouched(
    a: AutomatonArrays,
    now: Now,
    left: Left,
    sums: Sums,
    flow: int,
    at: int,
    column: int,
    t: float,
    x: Floats,
) -> bool:
    """Whether no other guard is reached along the tail."""
    begin, n, row = now.ints[TAILS] * CURVE_ROWS, x.shape[0], left.sums[now.ints[TAILS]]
    curve = left.curves[begin : begin + int(row[CURVE_DEGREE]) + 1]
    limit, signs = left.curves[begin + AT_LIMIT, :n], now.signs[: domain(a, now)]
    return clear(
        a.programs, flow, at, column, False, signs, GUARD_ROUNDING * EPS * largest(limit), curve, t,
        x, row[LAST_SPEED], row[RATIO], row[REMAINING], limit, sums,
    )  # fmt: skip


def domain(a: AutomatonArrays, now: Now) -> int:
    """Put down the signs that guards have inside the domain, 0 of those that bound nothing; how
    many there are."""
    first, last = a.fields[now.ints[FIELD], GUARDS], a.fields[now.ints[FIELD], GUARDS_END]
    for g in range(first, last):
        now.signs[g - first] = -a.guards[g, CROSSING] * a.guards[g, BOUNDS]
    return last - first


def held(p: Programs, at: int, t: float, x: Floats, at_rest: Floats, sums: Sums) -> None:
    """The state with gap and gap speed at zero: two steps of Newton's method, and one."""
    copied(x, at_rest)
    touch(p, at, t, at_rest, sums)
    touch(p, at, t, at_rest, sums)
    turned(at_rest, -sums.lines[READ, x.shape[0]], sums.lines[READ])
