"""The loop of a run whose flows look a constant lag back: from window to window of the past.

:mod:`.runs` flies as far as the present windows hold. Here what has been flown is put down as the
record, in pieces, with its breaking points; at the end of a window the next one is read
(:mod:`.windows`), as ``docs/notes/delays.md`` says; if it was a guess that does not hold, what has
been flown is taken back. What is not plain is left to :mod:`hybrid.delay.memory`, which has the
same record: windows on functions of the caller's, and guesses in which something fires.
"""

from __future__ import annotations

import math

from .advance import after
from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Look, Now, PastArrays, Room, Sums
from .chebyshev import value
from .flights import fly
from .guesses import SINCE_PLACE, TO_PLACE
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
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FINAL,
    FLIGHTS,
    FLIGHTS_DONE,
    FOUND,
    FULL,
    GOES_ON,
    GUARDS,
    GUARDS_END,
    GUESSED,
    GUESSED_FROM,
    HOLDS,
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
    SERVES_UNTIL,
    SINCE,
    SINCE_LOW,
    STEPPED,
    STEPS_BEFORE,
    STEPS_DONE,
    STEPS_MADE,
    SUMS_DONE,
    TAILS,
    TAU,
    TIGHT,
    WALKS,
    WINDOW,
    T,
)
from .polynomials import power_value
from .record import UP_TO, allowed, broken, following, kept, put, slack
from .runs import go
from .sums import STATE_THERE, on_curve
from .tails import count
from .windows import BACKWARDS, FIXED, MOVES_ON, confirmed, nearer_guess, read

__all__ = ("bound", "ended", "look_back")

#: The order of an element that is smooth; the highest of breaking points that are noted once a lag
#: has turned back over its past: each is seen many times, and those times are themselves seen many
#: times.
SMOOTH_ORDER, TURNING = 1000000, 2

#: A lag that moves is at the end of its window as far as this many of the times that are one.
AT_THE_END = 1e2

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
        t, _ = after(now.floats[T], now.floats[LOW], now.floats[TAU])
        if past.ints[GUESSED] == 1 and (status != END or now.ints[JUMPS_MADE] > past.ints[IN_ARC]):
            first = (
                left.when[past.ints[IN_ARC], 0] if now.ints[JUMPS_MADE] > past.ints[IN_ARC] else t
            )
            back(now, past)
            found = nearer_guess(past.floats[GUESSED_FROM], first, past)
        elif status == MAKE:
            return status
        elif not recorded(a, now, left, sums, past, status):
            past.ints[AGAIN] = status
            return NO_ROOM
        else:
            found = holds(now, t, past) if past.ints[GUESSED] == 1 else HOLDS
        if found == HOLDS:
            if status != END or past.floats[SERVES_UNTIL] >= past.floats[FINAL]:
                return status
            if past.ints[PIECES_KEPT] == past.degrees.shape[0]:  # a guess is a piece, too
                past.ints[AGAIN] = status
                return NO_ROOM
            passed(now, t, past)
            found = read(t, False, past)
            tried(now, t, past)
        if found != FOUND:
            return WINDOW
        run[LAST_TIME] = past.floats[SERVES_UNTIL]
        bound(a, past, room)
        status = GOES_ON


# -- guesses --------------------------------------------------------------------------------


def tried(now: Now, t: float, past: PastArrays) -> None:
    """Keep the state from which windows are flown that may be guesses."""
    copied(now.floats, past.floats_before)
    copied(now.x, past.before[0])
    copied(now.seen, past.before[1])
    for k in range(now.ints.shape[0]):
        past.ints_before[k] = now.ints[k]
    past.floats[GUESSED_FROM], past.ints[STEPS_BEFORE] = t, past.ints[STEPS_DONE]


def holds(now: Now, t: float, past: PastArrays) -> int:
    """Whether a guess, flown up to a time, holds; if not it is taken back, and other windows have
    been read. The status as in :func:`.confirmed`."""
    since = past.floats[GUESSED_FROM]
    found = confirmed(since, t - since, past)
    if found == HOLDS:
        past.ints[GUESSED] = 0
    else:
        back(now, past)
    return found


def back(now: Now, past: PastArrays) -> None:
    """Be again where a guess began: behind steps of an arc that goes on."""
    copied(past.floats_before, now.floats)
    copied(past.before[0], now.x)
    copied(past.before[1], now.seen)
    copied(past.start, now.end)
    for k in range(now.ints.shape[0]):
        if k != EXPANSIONS and k != FLIGHTS:
            now.ints[k] = past.ints_before[k]
    now.ints[FLIGHTS] += 1  # what was tied, or spent, in what is taken back is so no more
    for g in range(now.signs.shape[0]):
        now.signs[g] = past.signs[g]
    past.ints[STEPS_DONE] = past.ints[STEPS_BEFORE]


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


# -- the end of windows -------------------------------------------------------------------


def passed(now: Now, t: float, past: PastArrays) -> None:
    """Let the arc go on where windows end."""
    ended(t, now.ints[FIELD], -1, past)
    now.ints[PHASE] = WALKS
    now.ints[STEPS_MADE] -= now.ints[MADE]
    past.ints[IN_ARC], past.floats[BEGAN] = now.ints[JUMPS_MADE], now.floats[TAU]
    copied(now.end, past.start)
    copied(now.end, past.present)
    for g in range(now.signs.shape[0]):
        past.signs[g] = now.signs[g]


def ended(t: float, field: int, fired: int, past: PastArrays) -> None:
    """Note the breaking point that follows, in a field, from those at which windows end.

    ``fired``: of lags that move, that which has come to the end of its window times two, and one
    more at the end ahead; -1 if none has.
    """
    n, any_met = past.own.shape[0], False
    for k in range(past.lags.shape[0]):
        met, end = meets(k, t, fired, past)
        for e in range(n):
            past.least[k, e] = SMOOTH_ORDER
        if met:
            apart = max(slack(t), slack(end))
            place = following(past, end - apart, False)
            while place < past.ints[BREAKS] and past.times[place] <= end + apart:
                any_met = True
                for e in range(n):
                    past.least[k, e] = min(past.least[k, e], past.orders[place, e])
                place += 1
    if any_met and carried(field, past) <= past.ints[BREAK_ORDER]:
        broken(past, t)
    few = past.ints[STEPPED] <= 2 and not any_met
    past.ints[TIGHT] = past.ints[TIGHT] + 1 if few else min(past.ints[TIGHT], 0)


def meets(k: int, t: float, fired: int, past: PastArrays) -> tuple[bool, float]:
    """Whether a lag has come to the end of its window; which one that is."""
    here, apart, frame = t - past.lags[k], max(slack(t), slack(t - past.lags[k])), past.windows[k]
    if past.moves[k] == FIXED:
        return here >= frame[TO_PLACE] - apart, frame[TO_PLACE]
    past.moves[k] = BACKWARDS if fired == 2 * k else MOVES_ON
    if past.moves[k] == BACKWARDS:
        past.ints[BREAK_ORDER] = min(past.ints[BREAK_ORDER], TURNING)
        return True, frame[SINCE_PLACE]
    return fired == 2 * k + 1 or here >= frame[TO_PLACE] - AT_THE_END * apart, frame[TO_PLACE]


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
