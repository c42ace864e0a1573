"""Entering a mode: whether a guard is zero there, and by which power of the time it vanishes (3).

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import Automaton, Floats, Now, Room
from .guards import NEAR, ROUNDED, largest, row_of, sizes_of
from .hops import drowns
from .lengths import step_length
from .places import (
    BOUNDS,
    CONTACT,
    CROSSING,
    EDGE,
    ENTERED,
    FIELD,
    FIRED,
    GUARDS,
    GUARDS_END,
    KIND,
    OTHER,
    POWER,
    PROGRAM,
    RELEASE,
    RISES,
    USES,
    USES_END,
    T,
)
from .zeros import EPS

__all__ = ("far", "may_vanish", "own_time", "starts", "vanishes", "vanishes_later")

#: Power of the time from which on the coefficients of a guard are compared with each other: what
#: those below are made of is known.
HIGHER = 3


def starts(a: Automaton, now: Now, room: Room) -> bool:
    """Whether the start of an arc leaves nothing to weigh; notes the guards' orders.

    No guard fires at once, no contact comes to rest, and no state is outside the domain.
    """
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if now.ints[ENTERED] == 0:
            c = room.c[row_of(a, a.fields[field, PROGRAM], field, g)]
            order, sign = start_of(a, now, room, g, c)
            now.orders[g - first] = order
            if not armed(a, now, g, c, order, sign):
                return False
    return True


def start_of(a: Automaton, now: Now, room: Room, guard: int, c: Floats) -> tuple[int, int]:
    """By which power of the time a guard vanishes at the start of an arc, and its sign next; 0
    where that is not plain."""
    t, seen, kind = now.floats[T], largest(now.seen), a.guards[guard, KIND]
    least = now.ints[POWER] if guard == now.ints[FIRED] else 0
    side = 1 if c[0] > 0.0 else -1
    if least == 0 and far(c[0], max(seen, largest(now.x))):
        return 0, side
    size, rate, bend = sizes_of(a, room, guard, t, now.x)
    if not math.isfinite(c[0]) or not size < math.inf:
        return 0, 0
    if least == 0:
        high, fast = 0.0, math.inf
        if kind == CONTACT:
            high, fast, _ = sizes_of(a, room, guard, t, now.seen)
            high = max(size, high) if high < math.inf else size
            fast = max(rate, fast) if fast < math.inf else rate
        elif kind != RELEASE:
            for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
                high = max(high, now.seen[a.uses[k]])
        if not may_vanish(c[0], c[1], t, size, high, fast):
            return 0, side
        if kind == CONTACT and not abs(c[1]) > ROUNDED * EPS * fast:
            return 0, 0
    order, sign = vanishes(c, size, rate, bend, max(least, 1))
    if sign != 0:
        return order, sign
    own = min(own_time(c, 0.0), step_length(room.c, now.x.shape[0]))
    return vanishes_later(c, own if own < math.inf else 1.0, least)


def armed(a: Automaton, now: Now, guard: int, c: Floats, order: int, sign: int) -> bool:
    """Whether a guard waits for its next zero, and its contact does not come to rest."""
    kind, free = a.guards[guard, KIND], a.guards[guard, BOUNDS] == 0
    used, outwards = guard == now.ints[FIRED], sign * a.guards[guard, CROSSING] > 0
    if sign == 0 or order > RISES:
        return False
    if order == 0:
        return not outwards or (kind == EDGE and free)
    if kind == OTHER:
        return False
    if kind == CONTACT and not used and order == 1:
        size = max(largest(now.seen), largest(now.x))
        return not outwards and not drowns(c[1], 2.0 * c[2], size)
    return not outwards or (kind == EDGE and free and used)


def far(value: float, size: float) -> bool:
    """Whether a guard is far from zero, against the largest state: nothing is to be weighed."""
    return abs(value) > NEAR * size


def may_vanish(
    value: float,
    rate: float,
    t: float,
    size: float,
    high: float,
    fast: float,
) -> bool:
    """Whether a guard that is not far from zero is zero but for rounding.

    Parameters
    ----------
    size : float
        The sum of the terms that it is made of.
    high : float
        What it is made of where states are as large as the run has seen them; a gap that clearly
        moves is not measured by it.
    fast : float
        The same of the rate of a gap, infinite of other guards.
    """
    moves = value > 0.0 and abs(rate) > ROUNDED * EPS * fast
    return abs(value) <= ROUNDED * EPS * (size + abs(t) * abs(rate) + (0.0 if moves else high))


def vanishes(c: Floats, size: float, rate: float, bend: float, least: int) -> tuple[int, int]:
    """By which power of the time a guard vanishes, and the sign that it takes next: 0 where none of
    the first coefficients of its series along the flow decides.

    Parameters
    ----------
    size, rate, bend : float
        The sums of the terms that it and its first two derivatives are made of.
    least : int
        The power by which it is known to vanish at least.
    """
    for k in range(least, min(HIGHER, c.shape[0])):
        terms = size if k == 0 else rate if k == 1 else bend
        if abs(c[k]) > ROUNDED * EPS * terms:
            return k, 1 if c[k] > 0.0 else -1
    return HIGHER, 0


def vanishes_later(c: Floats, own: float, least: int) -> tuple[int, int]:
    """The same by its other coefficients, compared with each other in a time in which the terms of
    its series are comparable."""
    most, scale = 0.0, own**HIGHER
    for k in range(HIGHER, c.shape[0]):
        most = max(most, abs(c[k]) * scale)
        scale *= own
    scale = own**HIGHER
    for k in range(HIGHER, c.shape[0]):
        if k >= least and abs(c[k]) * scale > ROUNDED * EPS * most:
            return k, 1 if c[k] > 0.0 else -1
        scale *= own
    return c.shape[0], 0


def own_time(c: Floats, size: float) -> float:
    """A time over which a guard is close to a cubic, from its Taylor series.

    No term from the fourth on is larger there than all before it. ``size`` is that of the numbers
    the guard is made of: what is rounding beside it counts for nothing.
    """
    length = math.inf
    for k in range(HIGHER + 1, c.shape[0]):
        bound = 0.0
        for j in range(HIGHER + 1 if c[k] != 0.0 else 0):
            low = max(abs(c[0]), ROUNDED * EPS * size) if j == 0 else abs(c[j])
            if low > 0.0:
                bound = max(bound, (low / abs(c[k])) ** (1.0 / (k - j)))
        if bound > 0.0:
            length = min(length, bound)
    return length
