"""Entering a mode: whether a guard is zero there, and by which power of the time it vanishes (3).

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Matrix, Now, Room
from .contacts import joined
from .guards import GUARD_ROUNDING, NEAR, TIE, at_largest, holds, moving, row_of, sizes_of, so_far
from .hops import drowns
from .lengths import step_length
from .places import (
    AT_START,
    BENDS,
    BOUNDS,
    CONTACT,
    CROSSING,
    EDGE,
    ENTERED,
    FIELD,
    FIELD_PROGRAM,
    FIRST_SUMMED,
    FLIGHTS,
    GUARD_POWER,
    GUARDS,
    GUARDS_END,
    HARD,
    IMPACT_COUNT,
    JOINS,
    KIND,
    LAST_USED,
    LASTED,
    MADE_OF,
    NONE,
    OWN,
    PULL,
    REACHES,
    RELEASE,
    RISES,
    SERIES,
    SWITCH,
    URGENT,
    T,
)
from .ties import hidden_of, side_at
from .zeros import EPS

__all__ = ("alike", "at_rest", "does", "far", "own_time", "set_off", "start", "starts", "turned")

#: Coefficients of a guard from this power on are compared with each other; for those below, the
#: sums of absolute terms are known.
HIGHER = 3

#: The gap speed, relative to those seen, at which a series of impacts that has no sum is over.
SPENT_SPEED = 1e-20

#: The speed of an impact, relative to the speeds seen, from which on a series that has no sum is at
#: its limit: the rest of it is less than the rounding of what it has taken so far.
LIMIT_SPEED = 1e-2 * EPS

#: Positions are known to so many spacings; a lower flight does not count.
POSITION_ROUNDING = 8.0

#: What a guard does at the start of an arc (:func:`does`). ``ARMED``: it waits for its next zero;
#: ``FIRES``: before any flow; ``RESTS``: its contact comes to rest. Faults: ``UNDECIDED``: no
#: derivative decides; ``OUTSIDE``: the state is outside the domain; ``BEYOND``: the flow leaves the
#: domain through the edge just taken. ``LEAVES``: the flow leaves the surface of a switching, which
#: may be a fault. ``DROWNS``: it waits, but its flight is so low that the gap is comparable to
#: rounding.
ARMED, FIRES, RESTS, UNDECIDED, OUTSIDE, BEYOND, LEAVES, DROWNS = range(8)


def starts(a: AutomatonArrays, run: Floats, now: Now, room: Room) -> int:
    """The first guard that fires before any flow at the start of an arc; ``NONE``; ``HARD`` if
    Python must decide; ``JOINED`` or ``WANTED`` if a contact comes to rest. Writes the orders of
    the guards."""
    field, fires, drowned = now.ints[FIELD], NONE, False
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        now.zeros[g - first, MADE_OF], now.zeros[g - first, REACHES] = -1.0, 0.0
        if now.ints[ENTERED] == 0:
            c = room.c[row_of(a, a.fields[field, FIELD_PROGRAM], field, g)]
            now.orders[g - first], what = start_of(a, run, now, room, g, c)
            if what == RESTS:
                now.impacts[a.guards[g, OWN]] = 0
                return joined(a, now, room, g)
            if what == FIRES:
                fires = g if fires == NONE else fires
            elif what not in (ARMED, DROWNS):
                return HARD
            drowned = drowned or what == DROWNS
    return HARD if drowned and fires == NONE else fires


def start_of(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int, c: Floats
) -> tuple[int, int]:
    """The power of the time by which a guard vanishes at the start of an arc, and what it does
    there; ``HARD`` if Python must decide."""
    kind, bounds = a.guards[guard, KIND], a.guards[guard, BOUNDS] == 1
    t, n, reach = now.floats[T], now.x.shape[0], so_far(now, now.x)
    used, order, sign = a.guards[guard, OWN] == now.ints[LAST_USED], 0, 1 if c[0] > 0.0 else -1
    own, loads, low = a.guards[guard, OWN], kind == RELEASE, False
    least, flights = now.ints[GUARD_POWER] if used else 0, now.ints[FLIGHTS]
    crossing, other, spent = a.guards[guard, CROSSING], False, now.spent[own] == flights
    before = side_at(now.tied[own], flights)
    side = side_at(now.touched[own], flights) if before == 0 else before
    urgent = a.guards[guard, URGENT] == 1
    outside = (bounds or urgent) and c[0] * crossing > 0.0
    beyond = before != 0 or outside  # rounding, of a guard that is large
    if kind == CONTACT and spent and abs(c[0]) <= GUARD_ROUNDING * EPS * reach:
        least = max(least, 1)  # another impact at this time has moved it by rounding
    if before != 0:  # it was zero, but for what steps have lost
        value, _, hides = hidden_of(a, run, now, room, guard, t, 0.0)
        least = max(least, 1) if abs(value) <= hides else least
    if least > 0 or beyond or not far(c[0], reach):
        size, rate, bend = sizes_of(a, room, guard, t, now.x)
        now.zeros[guard - a.fields[now.ints[FIELD], GUARDS], MADE_OF] = size
        high, fast = 0.0, math.inf
        if not math.isfinite(c[0]) or not size < math.inf:
            return 0, HARD
        if kind == CONTACT and (least == 0 or c[1] < 0.0):
            high, fast, _ = sizes_of(a, room, guard, t, now.seen)
            high = max(size, high) if high < math.inf else size
            fast = max(rate, fast) if fast < math.inf else rate
        out = crossing if side == 0 else 1 if c[1] > 0.0 else -1
        thrown = used or (kind == EDGE and shares(a, now, room, c))
        out = out if kind in (EDGE, SWITCH) and not thrown else 0
        waits = 0 if out == 0 else -crossing if crossing != 0 else side
        moves = waits != 0 and moving(a, now, room, guard, t, now.x, c[0], c[1], waits)
        if kind not in (CONTACT, RELEASE) and least == 0 and not moves:
            high = at_largest(a, now, room, guard, t, size)
        order, sign = start(c, room.c, n, c[0], c[1], t, size, rate, bend, high, fast, least, out)
        if crossing == 0 and before == 0:
            order, sign = turned(c[0], c[1], order, sign, side)
        off = used and kind == EDGE and least == 0 and set_off(c[0], crossing, size, high)
        if off and order > 0:
            return order, HARD
        if loads and sign == 0:  # bodies that fall together bear nothing, for good
            return 0, ARMED
        series = used and own == now.ints[SERIES] and now.ints[IMPACT_COUNT] > 1
        if settles(a, now, room, guard, c, order, sign, size, rate, bend, series):
            # impacts that rounding has brought to rest are an accumulation, which Python lists
            return order, HARD if now.impacts[own] >= run[FIRST_SUMMED] else RESTS
        low = kind == CONTACT and order == 1 and drowns(c[1], 2.0 * c[2], reach)
        if kind == CONTACT and used:
            now.floats[PULL] = 2.0 * c[2]
        hard = kind == CONTACT and a.guards[guard, BENDS] == 1
        if order > RISES or (order > 0 and hard):
            return order, HARD
    before = side if order > 0 else before
    what = does(
        kind, crossing, bounds, order, sign, True, used, spent, loads, other, before, urgent
    )
    passed = what == FIRES and not holds(a, room, guard, t, now.x)
    if passed or (what == LEAVES and used):
        return order, ARMED
    ends = loads and a.fields[now.ints[FIELD], JOINS] == 1 and now.ints[LAST_USED] != AT_START
    known = ends or urgent or (order > 0 and kind in (CONTACT, EDGE, SWITCH))
    if what == FIRES and not known:
        return order, HARD
    return order, DROWNS if low and what == ARMED else what


def turned(value: float, slope: float, order: int, sign: int, side: int) -> tuple[int, int]:
    """The power by which a guard vanishes, and its sign, where it has turned while rounding did not
    tell it from zero: it comes to zero in its own time, and fires there, if it is still on the
    ``side`` on which it was, or on its way there, whatever rounding makes of its value."""
    turns = order > 1 and sign == -side
    if turns and value * side > 0.0:
        return 0, side
    return (1, side) if turns and slope * side > 0.0 else (order, sign)


def set_off(value: float, crossing: int, size: float, high: float) -> bool:
    """Whether a reset has put the guard of its own edge to the side on which it waits, by more than
    the rounding of what it is made of, here and at the largest states seen. Where :func:`start`
    takes it for zero, it comes back in a time that rounding of the time hides."""
    return value * crossing < 0.0 and abs(value) > GUARD_ROUNDING * EPS * (size + high)


def shares(a: AutomatonArrays, now: Now, room: Room, c: Floats) -> bool:
    """Whether an edge's guard, whose series is given, is that of the edge just used: it has been
    thrown back by the same reset, however short the flight."""
    field = now.ints[FIELD]
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if a.guards[g, KIND] == EDGE and a.guards[g, OWN] == now.ints[LAST_USED]:
            return alike(c, room.c[row_of(a, a.fields[field, FIELD_PROGRAM], field, g)])
    return False


def alike(c: Floats, other: Floats) -> bool:
    """Whether two series are the same up to their sign, as those of one function are."""
    same, opposite = True, True
    for k in range(c.shape[0]):
        same = same and c[k] == other[k]
        opposite = opposite and c[k] == -other[k]
    return same or opposite


def settles(
    a: AutomatonArrays,
    now: Now,
    room: Room,
    guard: int,
    c: Floats,
    order: int,
    sign: int,
    size: float,
    rate: float,
    bend: float,
    series: bool,
) -> bool:
    """Whether a contact whose gap vanishes by a power of the time comes to rest: the gap speed is
    zero, too, and the force pushes."""
    if order == 0 or a.guards[guard, KIND] != CONTACT or a.guards[guard, BENDS] == 1:
        return False
    if order > 1:
        return sign <= 0
    _, seen, _ = sizes_of(a, room, guard, now.floats[T], now.seen)
    seen = max(rate, seen) if seen < math.inf else rate
    series = series and now.ints[LASTED] == 1
    return at_rest(c[0], c[1], 2.0 * c[2], size, seen, bend, series)


def at_rest(
    gap: float, speed: float, force: float, size: float, fast: float, bend: float, series: bool
) -> bool:
    """Whether a contact that is pushed together is at rest: its gap speed is rounding of the speeds
    seen (``fast``), or the flight to which it leads is lower than the rounding of the position or
    than the gap itself.

    ``size`` and ``bend`` are the sums of absolute terms of the gap and of its acceleration. In a
    ``series`` of impacts, which is summed, a far smaller speed still counts as motion.
    """
    if series:
        slow = abs(speed) <= SPENT_SPEED * fast
    else:
        height = max(POSITION_ROUNDING * EPS * size, abs(gap))
        slow = abs(speed) <= GUARD_ROUNDING * EPS * fast or speed * speed <= -2.0 * force * height
    return slow and force < -NEAR * bend


def does(
    kind: int,
    crossing: int,
    bounds: bool,
    order: int,
    sign: int,
    rests: bool,
    used: bool,
    spent: bool,
    derived: bool,
    passing: bool,
    before: int,
    urgent: bool,
) -> int:
    """What a guard does at the start of an arc (3).

    Parameters
    ----------
    order, sign
        As :func:`start` gives them.
    rests : bool
        Whether a contact whose gap and gap speed are zero may come to rest.
    used, spent : bool
        Whether its edge is the one just taken; whether it has been taken at this time.
    derived : bool
        The guard is not the author's (a load, or the end of sliding) and may jump.
    passing : bool
        There was no jump; a window of the past or a signal has ended, and the guard may have
        jumped.
    before : int
        Its sign before this time, at which it was zero; 0 if unknown.
    urgent : bool
        Whether it fires where it is beyond zero on entering.
    """
    urgent = urgent and not passing
    outwards = sign == crossing or (crossing == 0 and sign != 0)
    if kind == CONTACT and rests and order > 1 and sign <= 0:
        return RESTS
    if sign == 0:
        return FIRES if urgent and not used else UNDECIDED
    if order == 0:
        if outwards and (urgent or derived or before == -sign or (passing and before != sign)):
            return FIRES
        return OUTSIDE if outwards and crossing != 0 and bounds and not passing else ARMED
    if crossing == 0:
        return FIRES if before == -sign else ARMED
    touched = before == sign
    if not outwards:
        return LEAVES if kind == SWITCH and not touched else ARMED
    if kind == EDGE and touched:
        return ARMED
    if kind == EDGE and used:
        return BEYOND if bounds else ARMED
    return ARMED if spent and not bounds else FIRES


def start(
    c: Floats,
    states: Matrix,
    n: int,
    value: float,
    slope: float,
    t: float,
    size: float,
    rate: float,
    bend: float,
    high: float,
    fast: float,
    least: int,
    out: int,
) -> tuple[int, int]:
    """The power of the time by which a guard vanishes, if it is not :func:`far` from zero, and the
    sign that it takes next: 0 if no coefficient of its series along the flow decides.

    Parameters
    ----------
    c, states, n
        That series, and those of ``n`` states.
    value, slope : float
        The guard and its rate.
    size, rate, bend : float
        The sums of absolute terms of the guard and of its first two derivatives.
    high : float
        The same sum at the largest states seen; not used for a gap that clearly moves.
    fast : float
        The same for the rate of a gap; infinite for other guards. A gap that a force opens does not
        close at a speed that is rounding of this: impacts at one instant slow down until it is.
    least : int
        The least power by which it is known to vanish.
    out : int
        A sign that a rate does not give the guard of an edge or a switching if it turns back within
        rounding, as the guard then only touches zero: the one with which it would fire, or, if its
        sign before is known, either; 0 for that which has just fired, and where there is none.
    """
    moves = value > 0.0 and abs(slope) > GUARD_ROUNDING * EPS * fast
    noise = GUARD_ROUNDING * EPS * (size + (0.0 if moves else high))
    noise += TIE * EPS * abs(t) * abs(slope)  # as in :func:`.ties.since`: what is tied is zero here
    if least == 0 and not abs(value) <= noise:
        return 0, 1 if value > 0.0 else -1
    back = c[2] if slope * out > 0.0 > c[2] * out else 0.0
    if abs(back) > GUARD_ROUNDING * EPS * bend and slope * slope <= 4.0 * abs(back) * noise:
        # on the side on which it waits, by more than its own terms round, it comes in its own time
        return 0 if least == 0 and value * -out > GUARD_ROUNDING * EPS * size else 2, -out
    rate = fast if c[1] < 0.0 < c[2] and fast < math.inf else rate
    for k in range(max(least, 1), min(HIGHER, c.shape[0])):
        if abs(c[k]) > GUARD_ROUNDING * EPS * (rate if k == 1 else bend):
            return k, 1 if c[k] > 0.0 else -1
    own, most = min(own_time(c, 0.0), step_length(states, n)), 0.0
    own = own if own < math.inf else 1.0
    for k in range(HIGHER, c.shape[0]):
        most = max(most, abs(c[k]) * own**k)
    for k in range(max(least, HIGHER), c.shape[0]):
        if abs(c[k]) * own**k > GUARD_ROUNDING * EPS * most:
            return k, 1 if c[k] > 0.0 else -1
    if least == 0 and fast == math.inf and abs(value) > GUARD_ROUNDING * EPS * size:
        return 0, 1 if value > 0.0 else -1  # it stays what it is, which is not rounding here
    return c.shape[0], 0


def far(value: float, size: float) -> bool:
    """Whether a guard is clearly not zero, measured by the largest state."""
    return abs(value) > NEAR * size


def own_time(c: Floats, size: float) -> float:
    """A time over which a guard is close to a cubic, by its Taylor series.

    No term from the fourth on is larger there than all before it. ``size`` is that of the numbers
    in the guard; what is rounding beside it does not count.
    """
    length = math.inf
    for k in range(HIGHER + 1, c.shape[0]):
        bound = 0.0
        for j in range(HIGHER + 1 if c[k] != 0.0 else 0):
            low = max(abs(c[0]), GUARD_ROUNDING * EPS * size) if j == 0 else abs(c[j])
            if low > 0.0:
                bound = max(bound, (low / abs(c[k])) ** (1.0 / (k - j)))
        if bound > 0.0:
            length = min(length, bound)
    return length
