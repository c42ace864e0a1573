"""The record of a run with delays: its pieces, its breaking points, and which times are equal."""

from __future__ import annotations

import math

from .arrays import PastArrays
from .places import BREAK_ORDER, BREAKS, PIECES_KEPT, RTOL

#: Columns of a piece's row: where it begins and ends; the time from which it is counted, in two
#: floats, and there its middle and half its length.
BEGIN, UP_TO, FROM, FROM_LOW, PIECE_MIDDLE, PIECE_HALF = range(6)

#: Allowed difference between a window and the record, relative to the tolerance of a step; and the
#: rounding of a window.
WINDOW_SHARE, SHOWN_ROUNDING = 0.1, 4e-16

#: The order of a smooth element.
SMOOTH_ORDER = 1000000

#: Times within this many roundings are equal.
SAME_TIME_ROUNDINGS = 8.0


def slack(t: float) -> float:
    """The tolerance within which times near this one, sums of several times, count as equal."""
    return SAME_TIME_ROUNDINGS * (math.nextafter(abs(t), math.inf) - abs(t))


def following(past: PastArrays, t: float, later: bool) -> int:
    """The place of the first breaking point at a time or after it; with ``later``, after it."""
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


def last_break(past: PastArrays, t: float, there: bool) -> float:
    """The last breaking point before a time, or there."""
    place = following(past, t, there)
    return past.times[place - 1] if place > 0 else -math.inf


def broken(past: PastArrays, t: float) -> None:
    """Note a breaking point, of the orders in ``past.own``, if lags see it; equal ones are
    merged."""
    place, seen = past.ints[BREAKS], False
    for i in range(past.own.shape[0]):
        seen = seen or (past.heard[i] == 1 and past.own[i] <= past.ints[BREAK_ORDER])
    if not seen:
        return
    if place > 0 and t <= past.times[place - 1] + slack(t):
        for i in range(past.own.shape[0]):
            past.orders[place - 1, i] = min(past.orders[place - 1, i], past.own[i])
        return
    past.times[place] = t
    for i in range(past.own.shape[0]):
        past.orders[place, i] = past.own[i]
    past.ints[BREAKS] = place + 1


def put(past: PastArrays, t: float, low: float, start: float, length: float) -> None:
    """The row of a new piece, whose series are still to be written."""
    place = past.ints[PIECES_KEPT]
    span = past.spans[place]
    span[BEGIN], span[UP_TO] = t + (low + start), t + (low + (start + length))
    span[FROM], span[FROM_LOW] = t, low
    span[PIECE_MIDDLE], span[PIECE_HALF] = start + 0.5 * length, 0.5 * length
    past.degrees[place] = 0


def kept(past: PastArrays) -> None:
    """Keep the piece just written, if it has a length."""
    span = past.spans[past.ints[PIECES_KEPT]]
    if span[UP_TO] > span[BEGIN]:
        past.ints[PIECES_KEPT] += 1


def holding(t: float, past: PastArrays) -> int:
    """The place of the piece that extends beyond a time; the last one if none does."""
    low, high = 0, past.ints[PIECES_KEPT]
    while low < high:
        middle = (low + high) // 2
        if past.spans[middle, UP_TO] > t:
            high = middle
        else:
            low = middle + 1
    return min(low, past.ints[PIECES_KEPT] - 1)


def at(past: PastArrays, piece: int, i: int, s: float, since: float) -> float:
    """An element of the record at ``s + since``, by Clenshaw's rule.

    The time is in two parts, so that a short window does not drown in its rounding.
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


def allowed(past: PastArrays, i: int, size: float) -> float:
    """The allowed difference between a window and the record, for an element of this size."""
    return WINDOW_SHARE * (past.atol[i] + past.floats[RTOL] * size) + SHOWN_ROUNDING * size


def corners(past: PastArrays, field: int, guard: int) -> None:
    """Find the orders of a jump's breaking point, of which those that are 0 in ``past.own`` are
    known: of what it changes."""
    for i in range(past.own.shape[0]):
        if past.own[i] > 0:
            past.own[i] = 1 if past.bent[guard, i] == 1 else SMOOTH_ORDER
    integrated(past, field)


def integrated(past: PastArrays, field: int) -> None:
    """Lower the orders of the elements to one more than of those on which their derivatives
    depend."""
    n, own = past.own.shape[0], past.own
    for _ in range(n):
        for i in range(n):
            for j in range(n):
                if j != i and past.uses[field * n + i, j] == 1:
                    own[i] = min(own[i], own[j] + 1)
