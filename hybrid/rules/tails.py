"""The impacts of a sum: their times, and other guards along them."""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs, Sums
from .chebyshev import value
from .flights import REACHED, fly
from .jets import OUTPUT, afresh
from .lengths import LAST_TERMS
from .sums import SMALLEST_DIVISOR, STATE_THERE, on_curve

__all__ = ("clear",)

#: Flights of a tail along which other guards are checked: the first, which are the highest, and
#: those at some times from there to the limit; more of these if a guard is not affine.
TAIL_FLIGHTS, TAIL_TIMES, TAIL_POINTS = 4, 8, 200


def clear(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    signs: Ints,
    rounding: float,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    remaining: float,
    limit: Floats,
    room: Sums,
) -> bool:
    """Whether no other guard is reached along a tail, nor at its limit.

    Parameters
    ----------
    flow, at, column, held
        As :func:`.sums.close` takes them.
    signs
        As :func:`.flights.fly` takes them.
    rounding : float
        How far a guard may be beyond zero at the limit.
    """
    times, last, state = TAIL_TIMES, -1, room.lines[STATE_THERE, : x.shape[0]]
    for g in range(signs.shape[0]):
        if g != column and p.affine[p.index[flow, OUTPUT] + g] == 0:
            times = TAIL_POINTS
    for i in range(TAIL_FLIGHTS + times if signs.shape[0] > 1 else 0):
        n, since = i, remaining * (i - TAIL_FLIGHTS) / times
        if i >= TAIL_FLIGHTS:
            n = covering(curve, r, count(t, r, remaining), since)
        if n > last:
            when, speed = on_curve(
                p, at, curve, curve.shape[0] - 1, t, x, v, r**n, 1.0, room, state
            )
            status, _, _, _, _ = fly(
                p, flow, column, held, when, state, speed, room.c, room.series[:0], signs, 0.0,
                LAST_TERMS, room,
            )  # fmt: skip
            if status == REACHED:
                return False
            last = n
    return kept(p, flow, column, t + remaining, limit, rounding, signs, room)


def kept(
    p: Programs,
    flow: int,
    column: int,
    t: float,
    x: Floats,
    rounding: float,
    signs: Ints,
    room: Sums,
) -> bool:
    """Whether the other guards have their signs at a state."""
    if afresh(p, flow, 0, t, x, room.sides, room.aside, room.work) < 0:
        return False
    for g in range(signs.shape[0]):
        own = room.aside[p.output[p.index[flow, OUTPUT] + g], 0]
        if g != column and (signs[g] == 0 or not own * signs[g] > -rounding):
            return False
    return True


def count(t: float, r: float, remaining: float) -> int:
    """Number of impacts of a tail that a double can tell from the limit."""
    end = abs(t + remaining)
    share = max(math.nextafter(end, math.inf) - end, SMALLEST_DIVISOR) / remaining
    return max(0, math.ceil(math.log(min(max(share, SMALLEST_DIVISOR), 1.0)) / math.log(r)))


def covering(curve: Matrix, r: float, most: int, since: float) -> int:
    """The last impact not later than a time after the first one of a tail."""
    low, high, degree = 0, most, curve.shape[0] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if value(curve, degree, 0, r**middle) <= since:
            low = middle
        else:
            high = middle - 1
    return low
