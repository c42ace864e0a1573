"""The loop of a run whose flows look a constant lag back: from window to window of the past.

:mod:`.runs` flies as far as the present windows hold. Here what has been flown is put down as the
record, in pieces, with its breaking points; at the end of a window the next one is read off the
record, as ``docs/notes/delays.md`` says. What is not plain is left to :mod:`hybrid.delay.memory`,
which has the same record: windows on functions of the caller's, and such as are guessed.
"""

from __future__ import annotations

import math

from .advance import after
from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Look, Now, PastArrays, Room, Sums
from .chebyshev import value
from .flights import fly
from .jets import steady
from .lengths import LAST_TERMS
from .places import (
    AGAIN,
    AT,
    AT_LIMIT,
    BEGAN,
    BREAK_ORDER,
    BREAKS,
    CURVE_DEGREE,
    CURVE_ROWS,
    END,
    FIELD,
    FIELD_PROGRAM,
    FINAL,
    FLIGHTS_DONE,
    FULL,
    GOES_ON,
    GUARDS,
    GUARDS_END,
    IN_ARC,
    JUMPS_BEFORE,
    JUMPS_DONE,
    JUMPS_MADE,
    LAST_SPEED,
    LAST_TIME,
    LOW,
    MADE,
    MAKE,
    NO_ROOM,
    PHASE,
    PIECES_KEPT,
    RATIO,
    REMAINING,
    RTOL,
    SERVES_UNTIL,
    SINCE,
    SINCE_LOW,
    STEPPED,
    STEPS_DONE,
    STEPS_MADE,
    SUMS_DONE,
    TAILS,
    TAU,
    TIGHT,
    TIGHTEST,
    WALKS,
    WINDOW,
    WINDOW_DEGREE,
    T,
)
from .polynomials import power_value
from .runs import go
from .sums import STATE_THERE, on_curve
from .tails import count

__all__ = ("bound", "look_back", "read")

#: Numbers of a window's frame.
FRAME = 2

#: Columns of a piece's row: where it begins and ends; the time from which it is counted, in two
#: floats, and there its middle and half its length.
BEGIN, UP_TO, FROM, FROM_LOW, PIECE_MIDDLE, PIECE_HALF = range(6)

#: What a window may differ from the record, against the tolerance of a step; rounding of what it
#: shows, and of its series; the order of an element that is smooth.
WINDOW_SHARE, SHOWN_ROUNDING, WINDOW_ROUNDING, SMOOTH_ORDER = 0.1, 4e-16, 1e-15, 1000000

#: Times nearer than this many roundings are one; windows this many times as long are not halved.
SAME_TIME_ROUNDINGS, UNHALVED = 8.0, 1e3

#: A flight as short as this many spacings of the time is no longer a piece of its own.
BRIEF_FLIGHT = 1e4

#: Places in a flight at which it is held against the limit.
LIMIT_PLACES = 4

#: Pieces for which there is room before a flight of a sum is put down.
SPARE_PIECES = 64


def look_back(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    left: Left,
    sums: Sums,
    look: Look,
    past: PastArrays,
) -> int:
    """Go on from ``now`` through windows; returns what the driver is asked for (:mod:`.places`)."""
    status = past.ints[AGAIN]
    past.ints[AGAIN] = GOES_ON
    while True:
        if status == GOES_ON:
            status = go(a, run, now, room, left, sums, look)
        if status == MAKE:
            return status
        if not recorded(a, now, left, sums, past, status):
            past.ints[AGAIN] = status
            return NO_ROOM
        if status != END or past.floats[SERVES_UNTIL] >= past.floats[FINAL]:
            return status
        t, _ = after(now.floats[T], now.floats[LOW], now.floats[TAU])
        passed(now, t, past)
        if read(t, past) == 0:
            return WINDOW
        run[LAST_TIME] = past.floats[SERVES_UNTIL]
        bound(a, past, room)
        status = GOES_ON


# -- the record ---------------------------------------------------------------------------


def recorded(
    a: AutomatonArrays, now: Now, left: Left, sums: Sums, past: PastArrays, status: int
) -> bool:
    """Put down what has been flown, and the windows on which sums were made; whether there was room
    for it."""
    ints, total = past.ints, now.ints[STEPS_MADE]
    if status == FULL and now.ints[PHASE] == WALKS:
        total += now.ints[MADE]
    while True:
        arc = ints[JUMPS_DONE]
        while ints[STEPS_DONE] < total and left.owner[ints[STEPS_DONE]] == arc:
            if ints[PIECES_KEPT] == past.degrees.shape[0]:
                return False
            step(left, past, ints[STEPS_DONE], now.x.shape[0])
            ints[STEPS_DONE] += 1
            ints[STEPPED] += 1
        if arc == now.ints[JUMPS_MADE]:
            return True
        if ints[BREAKS] == past.times.shape[0]:
            return False
        t, low, tail = left.when[arc, 0], left.when[arc, 1], ints[SUMS_DONE]
        if tail < now.ints[TAILS] and int(left.sums[tail, JUMPS_BEFORE]) == arc + 1:
            if not tail_kept(a, left, sums, past, tail, t, low):
                return False
            copied(past.shown, past.sights[tail])
            t, low = after(t, low, left.sums[tail, REMAINING])
            ints[SUMS_DONE] += 1
        else:
            jumped(left, past, arc, t)
        ints[JUMPS_DONE] += 1
        past.floats[SINCE], past.floats[SINCE_LOW] = t, low


def step(left: Left, past: PastArrays, place: int, n: int) -> None:
    """Put a step of the loop down as a piece."""
    length = left.spans[place, 1]
    put(past, past.floats[SINCE], past.floats[SINCE_LOW], left.spans[place, 0], length)
    for i in range(n):
        turned(past, i, left.series[place * n + i], length, n)
    kept(past)


def put(past: PastArrays, t: float, low: float, start: float, length: float) -> None:
    """The row of a new piece; its series are still to be put down."""
    place = past.ints[PIECES_KEPT]
    span = past.spans[place]
    span[BEGIN], span[UP_TO] = t + (low + start), t + (low + (start + length))
    span[FROM], span[FROM_LOW] = t, low
    span[PIECE_MIDDLE], span[PIECE_HALF] = start + 0.5 * length, 0.5 * length
    past.degrees[place] = 0


def kept(past: PastArrays) -> None:
    """Keep the piece that has been put down, if it has a length."""
    span = past.spans[past.ints[PIECES_KEPT]]
    if span[UP_TO] > span[BEGIN]:
        past.ints[PIECES_KEPT] += 1


def turned(past: PastArrays, i: int, c: Floats, length: float, n: int) -> None:
    """An element's power series over a step, by Chebyshev polynomials; nothing if nobody sees it.

    Term by term, and each factor by factor: a power of a long step may be too large.
    """
    place = past.ints[PIECES_KEPT]
    row = past.rows[place * n + i]
    for k in range(row.shape[0]):
        row[k] = 0.0
    if past.heard[i] == 0:
        return
    for k in range(c.shape[0]):
        term = c[k]
        for _ in range(k if term != 0.0 else 0):
            term *= length
        if term != 0.0:
            past.degrees[place] = max(past.degrees[place], k)
            for j in range(k + 1):
                row[j] += past.turn[j, k] * term


def jumped(left: Left, past: PastArrays, jump: int, t: float) -> None:
    """Note the breaking point that a jump is: what it changes jumps, the rest has a corner."""
    for i in range(past.own.shape[0]):
        past.own[i] = 1 if left.before[jump, i] == left.after[jump, i] else 0
    broken(past, t)


def broken(past: PastArrays, t: float) -> None:
    """Note a breaking point, of the orders in ``past.own``; those at one time are one."""
    place = past.ints[BREAKS]
    if place > 0 and t <= past.times[place - 1] + slack(t):
        for i in range(past.own.shape[0]):
            past.orders[place - 1, i] = min(past.orders[place - 1, i], past.own[i])
        return
    past.times[place] = t
    for i in range(past.own.shape[0]):
        past.orders[place, i] = past.own[i]
    past.ints[BREAKS] = place + 1


def tail_kept(
    a: AutomatonArrays, left: Left, sums: Sums, past: PastArrays, tail: int, t: float, low: float
) -> bool:
    """Put the flights of a sum down one by one while they are seen, then the limit alone; whether
    there was room for them."""
    ints, n = past.ints, past.own.shape[0]
    row, jump, field = left.sums[tail], ints[JUMPS_DONE], 0
    guard, begin = left.fired[jump], tail * CURVE_ROWS
    while not a.fields[field, GUARDS] <= guard < a.fields[field, GUARDS_END]:
        field += 1
    limit, degree = left.curves[begin + AT_LIMIT, :n], int(row[CURVE_DEGREE])
    curve, at = left.curves[begin : begin + degree + 1], a.guards[guard, AT]
    flow, column = a.fields[field, FIELD_PROGRAM], guard - a.fields[field, GUARDS]
    end, _ = after(t, low, row[REMAINING])
    most = count(t, row[RATIO], row[REMAINING])
    shortest = BRIEF_FLIGHT * (math.nextafter(abs(end), math.inf) - abs(end))
    state = sums.lines[STATE_THERE, :n]
    while True:
        full = ints[PIECES_KEPT] + SPARE_PIECES > past.degrees.shape[0]
        if full or ints[BREAKS] + 2 > past.times.shape[0]:
            return False
        w = row[RATIO] ** ints[FLIGHTS_DONE]
        since = value(curve, degree, 0, w) if ints[FLIGHTS_DONE] > 0 else 0.0
        jumped(left, past, jump, t + since)
        copied(left.after[jump], state)
        x, v = left.after[jump], row[LAST_SPEED]
        if ints[FLIGHTS_DONE] > 0:
            _, v = on_curve(a.programs, at, curve, degree, t, x, v, w, 1.0, sums, state)
        status, length, _, pieces, _ = fly(
            a.programs, flow, column, False, t + since, state, v, sums.starts, sums.lengths,
            sums.series, sums.branch, sums.end, sums.c, sums.aside, sums.work, sums.rows,
            sums.found, sums.sides, sums.sides[:0], 0.0, LAST_TERMS,
        )  # fmt: skip
        ends = status < 0 or ints[FLIGHTS_DONE] == most or length <= shortest
        if ends or near(limit, sums, past, pieces):
            break
        for piece in range(pieces):
            put(past, t, low + since, sums.starts[piece], sums.lengths[piece])
            for i in range(n):
                turned(past, i, sums.series[piece * n + i], sums.lengths[piece], n)
            kept(past)
        ints[FLIGHTS_DONE] += 1
    last = past.spans[ints[PIECES_KEPT] - 1, UP_TO]
    put(past, last, 0.0, 0.0, end - last)
    for i in range(n):
        line = past.rows[ints[PIECES_KEPT] * n + i]
        for k in range(line.shape[0]):
            line[k] = 0.0
        line[0], line[1] = 0.5 * (state[i] + limit[i]), 0.5 * (limit[i] - state[i])
        past.own[i] = 1
    past.degrees[ints[PIECES_KEPT]] = 1
    kept(past)
    broken(past, end)
    ints[FLIGHTS_DONE] = 0
    return True


def near(limit: Floats, sums: Sums, past: PastArrays, pieces: int) -> bool:
    """Whether nothing that is seen of a flight can be told from the limit."""
    n = limit.shape[0]
    for piece in range(pieces):
        for i in range(n):
            c = sums.series[piece * n + i]
            for k in range(LIMIT_PLACES + 1 if past.heard[i] == 1 else 0):
                s = sums.lengths[piece] * 0.5 * (1.0 - math.cos(math.pi * k / LIMIT_PLACES))
                there, _ = power_value(c, 0, c.shape[0] - 1, s)
                if not abs(there - limit[i]) <= allowed(past, i, abs(limit[i])):
                    return False
    return True


def allowed(past: PastArrays, i: int, size: float) -> float:
    """What a window may differ from an element of the record of this size."""
    return WINDOW_SHARE * (past.atol[i] + past.floats[RTOL] * size) + SHOWN_ROUNDING * size


def slack(t: float) -> float:
    """Times nearer to this one are it, if sums of such times are rounded."""
    return SAME_TIME_ROUNDINGS * (math.nextafter(abs(t), math.inf) - abs(t))


# -- the end of windows -------------------------------------------------------------------


def passed(now: Now, t: float, past: PastArrays) -> None:
    """Let the arc go on where windows end: note the breaking point that follows from theirs."""
    n, lags, any_met = past.own.shape[0], past.lags.shape[0], False
    for k in range(lags):
        here, b, place = t - past.lags[k], past.windows[k, 1], -1
        for e in range(n):
            past.least[k, e] = SMOOTH_ORDER
        if here >= b - max(slack(t), slack(here)):
            apart = max(slack(t), slack(b))
            place = following(past, b - apart, False)
            while place < past.ints[BREAKS] and past.times[place] <= b + apart:
                any_met = True
                for e in range(n):
                    past.least[k, e] = min(past.least[k, e], past.orders[place, e])
                place += 1
    if any_met and carried(now.ints[FIELD], past) <= past.ints[BREAK_ORDER]:
        broken(past, t)
    few = past.ints[STEPPED] <= 2 and not any_met
    past.ints[TIGHT] = past.ints[TIGHT] + 1 if few else min(past.ints[TIGHT], 0)
    now.ints[PHASE] = WALKS
    now.ints[STEPS_MADE] -= now.ints[MADE]
    past.ints[IN_ARC], past.floats[BEGAN] = now.ints[JUMPS_MADE], now.floats[TAU]
    copied(now.end, past.start)
    for g in range(now.signs.shape[0]):
        past.signs[g] = now.signs[g]


def carried(field: int, past: PastArrays) -> int:
    """Put down the orders of the elements where lags see breaking points; the least that is seen.

    Those are in ``past.least``.
    """
    n, own = past.own.shape[0], past.own
    for i in range(n):
        own[i] = SMOOTH_ORDER
        for k in range(past.lags.shape[0]):
            for e in range(n):
                if past.asks[field * n + i, k * n + e] == 1:
                    own[i] = min(own[i], past.least[k, e])
        own[i] += 1
    for _ in range(n):
        for i in range(n):
            for j in range(n):
                if j != i and past.uses[field * n + i, j] == 1:
                    own[i] = min(own[i], own[j] + 1)
    least = SMOOTH_ORDER
    for i in range(n):
        if past.heard[i] == 1:
            least = min(least, own[i])
    return least


def following(past: PastArrays, t: float, later: bool) -> int:
    """The place of the first breaking point at a time or after it; or ``later``, after it."""
    low, high = 0, past.ints[BREAKS]
    while low < high:
        middle = (low + high) // 2
        if past.times[middle] < t or (later and past.times[middle] == t):
            low = middle + 1
        else:
            high = middle
    return low


def next_break(past: PastArrays, s: float, apart: float) -> float:
    """The first breaking point after a time."""
    place = following(past, s + apart, True)
    return past.times[place] if place < past.ints[BREAKS] else math.inf


# -- windows ------------------------------------------------------------------------------


def read(t: float, past: PastArrays) -> int:
    """Read windows off the record, into ``past.shown``; 1 if it could be done.

    It cannot where the record is a function, where a lag is shorter than steps, and where the
    record is rough or not finite.
    """
    end, shortest = past.floats[FINAL], math.inf
    for k in range(past.lags.shape[0]):
        shortest = min(shortest, past.lags[k])
    if not shortest > slack(t):
        return 0
    if next_break(past, t - shortest, slack(t)) <= t:
        past.ints[TIGHT] = 0
    elif past.ints[TIGHT] >= past.ints[TIGHTEST]:
        return 0
    for k in range(past.lags.shape[0]):
        s = t - past.lags[k]
        b = window(k, t, s, end - t, past)
        if math.isnan(b):
            return 0
        end = min(end, b + (t - s))
    past.floats[SERVES_UNTIL] = min(past.floats[FINAL], max(end, t + slack(t)))
    past.ints[STEPPED] = 0
    return 1


def window(k: int, t: float, s: float, length: float, past: PastArrays) -> float:
    """The end of a window of a lag that looks at ``s``; NaN if there is none."""
    apart = max(slack(t), slack(s))
    b = min(min(next_break(past, s, apart), t), min(s + length, s + past.windows[k, 2]))
    b = max(b, s + apart)
    whole, first, high = b - s, 0, past.ints[PIECES_KEPT]
    while first < high:
        middle = (first + high) // 2
        if past.spans[middle, UP_TO] > s + apart:
            high = middle
        else:
            first = middle + 1
    first = min(first, past.ints[PIECES_KEPT] - 1)
    while True:
        last = first + 1
        while last < past.ints[PIECES_KEPT] and past.spans[last, BEGIN] < min(b, t) - apart:
            last += 1
        for piece in range(first, last):
            if past.degrees[piece] < 0:
                return math.nan
        exact = last == first + 1 and past.degrees[first] <= WINDOW_DEGREE
        fine, finite = shown(k, t, s, b, first, last, past)
        if not finite:
            return math.nan
        if exact or fine:
            if b - s < whole or whole >= past.windows[k, 2]:
                past.windows[k, 2] = 2.0 * (b - s)
            past.windows[k, 0], past.windows[k, 1] = s, b
            return b
        if b - s <= UNHALVED * apart:
            return math.nan
        b = shorter(s, b, first, last, apart, past)


def shorter(s: float, b: float, first: int, last: int, apart: float, past: PastArrays) -> float:
    """A nearer end: that of a piece, the middle one of them, or the middle."""
    low, high = first, last
    while low < high and not past.spans[low, UP_TO] > s + apart:
        low += 1
    while high > low and not past.spans[high - 1, UP_TO] < b - apart:
        high -= 1
    return past.spans[low + (high - low) // 2, UP_TO] if high > low else 0.5 * (s + b)


def shown(
    k: int, t: float, a: float, b: float, first: int, last: int, past: PastArrays
) -> tuple[bool, bool]:
    """Put down what a window shows of pieces of the record; whether its polynomial is the record,
    as far as the run can tell, and whether that is finite."""
    n, fine, share = past.own.shape[0], True, 0.5 * max(slack(t), slack(a)) / (b - a)
    base = k * (FRAME + (WINDOW_DEGREE + 1) * n)
    past.shown[base], past.shown[base + 1] = 0.5 * a + 0.5 * b, 0.5 * (b - a)
    for i in range(n):
        if past.seen[k, i] == 1:
            low, high, size, piece = math.inf, -math.inf, 0.0, first
            for j in range(WINDOW_DEGREE + 1):
                since = (b - a) * past.nodes[j]
                while piece + 1 < last and past.spans[piece + 1, BEGIN] - a <= since:
                    piece += 1
                value = at(past, piece, i, a, since)
                if not math.isfinite(value):
                    return False, False
                past.values[0, j] = value
                low, high, size = min(low, value), max(high, value), max(size, abs(value))
            noise, rest = share * (high - low), 0.0
            heard = False
            for j in range(WINDOW_DEGREE, -1, -1):
                term = 0.0
                for m in range(WINDOW_DEGREE + 1):
                    term += past.series[j, m] * past.values[0, m]
                rest += abs(term) if j > WINDOW_DEGREE - 3 else 0.0
                heard = heard or abs(term) > WINDOW_ROUNDING * size + noise
                past.values[1, j] = term if heard else 0.0
            fine = fine and rest <= allowed(past, i, size) + noise
            for j in range(WINDOW_DEGREE + 1):
                power = 0.0
                for m in range(j, WINDOW_DEGREE + 1):
                    power += past.powers[j, m] * past.values[1, m]
                past.shown[base + FRAME + j * n + i] = power
    return fine, True


def at(past: PastArrays, piece: int, i: int, s: float, since: float) -> float:
    """An element of the record at ``s + since``, by Clenshaw's rule.

    In two parts, so that on a short window it does not drown in the rounding of the time.
    """
    row, degree = past.rows[piece * past.own.shape[0] + i], past.degrees[piece]
    if degree == 0:
        return row[0]
    span = past.spans[piece]
    here = ((((s - span[FROM]) - span[FROM_LOW]) - span[PIECE_MIDDLE]) + since) / span[PIECE_HALF]
    value, before = 0.0, 0.0
    for j in range(degree, 0, -1):
        value, before = row[j] + 2.0 * here * value - before, value
    return row[0] + here * value - before


def bound(a: AutomatonArrays, past: PastArrays, room: Room) -> None:
    """Give the windows to the programs, and work out what follows from them."""
    for g in range(past.given.shape[0]):
        past.numbers[past.given[g, 0], 0] = past.shown[past.given[g, 1]]
    for g in range(past.ranged.shape[0]):
        a.bounds.numbers[past.ranged[g, 0]] = past.shown[past.ranged[g, 1]]
    for q in range(past.parts.shape[0]):
        part = past.parts[q]
        steady(
            past.ops[part[0] : part[1]],
            past.more[part[2] : part[3]],
            room.still,
            past.numbers[part[4] : part[5]],
            room.work,
        )
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
