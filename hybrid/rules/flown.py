"""Adds what was flown to the record that delayed flows read."""

from __future__ import annotations

import math

from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Now, PastArrays, Sums
from .chebyshev import value
from .clocks import after, field_of
from .flights import fly
from .lengths import LAST_TERMS
from .places import (
    AT,
    AT_LIMIT,
    BEHIND,
    BREAKS,
    CURVE_DEGREE,
    CURVE_ROWS,
    FIELD_PROGRAM,
    FLIGHTS_DONE,
    FORGETS,
    FULL,
    GUARDS,
    JUMPS_BEFORE,
    JUMPS_DONE,
    JUMPS_MADE,
    LAST_SPEED,
    MADE,
    PHASE,
    PIECES_KEPT,
    RATIO,
    REMAINING,
    SINCE,
    SINCE_LOW,
    STEPPED,
    STEPS_DONE,
    STEPS_MADE,
    SUMS_DONE,
    TAILS,
    WALKS,
)
from .polynomials import power_value
from .record import (
    BEGIN,
    FROM,
    FROM_LOW,
    PIECE_HALF,
    PIECE_MIDDLE,
    UP_TO,
    allowed,
    broken,
    corners,
    kept,
    put,
)
from .sums import STATE_THERE, on_curve
from .tails import count

#: A flight shorter than this many spacings of the time is not a piece of its own.
BRIEF_FLIGHT = 1e4

#: Number of places at which a flight is compared with the limit.
LIMIT_PLACES = 4

#: Free pieces needed before a flight of a sum is recorded.
SPARE_PIECES = 64


def recorded(
    a: AutomatonArrays, now: Now, left: Left, sums: Sums, past: PastArrays, status: int
) -> bool:
    """Record what was flown, and the windows on which sums were made; returns whether there was
    room for it, and still is for a guess and the breaking points after it."""
    ints = past.ints
    while True:
        if not fits(now, left, past, status):
            return False
        walked(now, left, past, status)
        arc = ints[JUMPS_DONE]
        if arc == now.ints[JUMPS_MADE]:
            return True
        t, low, tail = left.when[arc, 0], left.when[arc, 1], ints[SUMS_DONE]
        if ints[BEHIND] == FORGETS:
            forgotten(left, past, arc, t)
        elif tail < now.ints[TAILS] and int(left.sums[tail, JUMPS_BEFORE]) == arc + 1:
            if not tail_kept(a, left, sums, past, tail, t, low):
                return False
            copied(past.shown, past.sights[tail])
            t, low = after(t, low, left.sums[tail, REMAINING])
            ints[SUMS_DONE] += 1
        else:
            jumped(a, left, past, arc, t)
        ints[JUMPS_DONE] += 1
        past.floats[SINCE], past.floats[SINCE_LOW] = t, low


def made(now: Now, status: int) -> int:
    """Number of steps that a call has made, including those of the present arc."""
    goes_on = status == FULL and now.ints[PHASE] == WALKS
    return now.ints[STEPS_MADE] + (now.ints[MADE] if goes_on else 0)


def fits(now: Now, left: Left, past: PastArrays, status: int) -> bool:
    """Whether there is room for what was flown, for a guess, and for what follows it."""
    steps = made(now, status) - past.ints[STEPS_DONE]
    jumps = now.ints[JUMPS_MADE] - past.ints[JUMPS_DONE]
    pieces, breaks = past.ints[PIECES_KEPT] + steps + 1, past.ints[BREAKS] + jumps + 2
    return pieces < past.degrees.shape[0] and breaks < past.times.shape[0]


def walked(now: Now, left: Left, past: PastArrays, status: int) -> None:
    """Record the steps of the arc that is due."""
    ints, total = past.ints, made(now, status)
    while ints[STEPS_DONE] < total and left.owner[ints[STEPS_DONE]] == ints[JUMPS_DONE]:
        step(left, past, ints[STEPS_DONE], now.x.shape[0])
        ints[STEPS_DONE] += 1
        ints[STEPPED] += 1


def step(left: Left, past: PastArrays, place: int, n: int) -> None:
    """Record a step of the loop as a piece."""
    length = left.spans[place, 1]
    put(past, past.floats[SINCE], past.floats[SINCE_LOW], left.spans[place, 0], length)
    for i in range(n):
        turned(past, i, left.series[place * n + i], length, n)
    kept(past)


def turned(past: PastArrays, i: int, c: Floats, length: float, n: int) -> None:
    """Write an element's power series over a step in Chebyshev polynomials; nothing if no lag sees
    it.

    Term by term, and each factor by factor, as a power of a long step may overflow.
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


def jumped(a: AutomatonArrays, left: Left, past: PastArrays, jump: int, t: float) -> None:
    """Note the breaking point of a jump."""
    for i in range(past.own.shape[0]):
        past.own[i] = 1 if left.before[jump, i] == left.after[jump, i] else 0
    corners(past, field_of(a, left.fired[jump]), left.fired[jump])
    broken(past, t)


def forgotten(left: Left, past: PastArrays, jump: int, t: float) -> None:
    """Start the record anew at a jump: the state after it stands for the whole past."""
    n, span = past.own.shape[0], past.spans[0]
    span[BEGIN], span[UP_TO], span[FROM], span[FROM_LOW] = -math.inf, t, 0.0, 0.0
    span[PIECE_MIDDLE], span[PIECE_HALF], past.degrees[0] = 0.0, 1.0, 0
    for i in range(n):
        past.rows[i, 0], past.own[i] = left.after[jump, i], 1
    past.ints[PIECES_KEPT], past.ints[BREAKS] = 1, 0
    broken(past, t)


def tail_kept(
    a: AutomatonArrays, left: Left, sums: Sums, past: PastArrays, tail: int, t: float, low: float
) -> bool:
    """Record the flights of a sum one by one as far as lags can tell them from the limit, then the
    limit alone; returns whether there was room."""
    ints, n = past.ints, past.own.shape[0]
    row, jump, begin = left.sums[tail], ints[JUMPS_DONE], tail * CURVE_ROWS
    guard = left.fired[jump]
    field = field_of(a, guard)
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
        jumped(a, left, past, jump, t + since)
        copied(left.after[jump], state)
        x, v = left.after[jump], row[LAST_SPEED]
        if ints[FLIGHTS_DONE] > 0:
            _, v = on_curve(a.programs, at, curve, degree, t, x, v, w, 1.0, sums, state)
        status, length, _, pieces, _ = fly(
            a.programs, flow, column, False, t + since, state, v, sums.c, sums.series,
            sums.sides[:0], 0.0, LAST_TERMS, sums,
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
    corners(past, field, guard)
    broken(past, end)
    ints[FLIGHTS_DONE] = 0
    return True


def near(limit: Floats, sums: Sums, past: PastArrays, pieces: int) -> bool:
    """Whether everything that lags see of a flight is within tolerance of the limit."""
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
