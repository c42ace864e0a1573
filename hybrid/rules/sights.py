"""Whether a sum of impacts has seen all of what lies between its start and its limit.

The gap's acceleration and the restitution are bounded over boxes that hold the motion, as
:mod:`hybrid.zeno.narrow` says; here in doubles, where these decide.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Look, Matrix, Programs, Sums
from .bounds import at_points, ranges
from .chebyshev import from_values, nodes, value
from .flights import fly
from .lengths import LAST_TERMS
from .sums import (
    CURVE_BASIS,
    LEAST_LOSS,
    POINTS_EACH,
    STATE_THERE,
    STRETCH_POINTS,
    hull,
    on_curve,
    part,
    restitution,
    shown,
)

__all__ = ("damped", "seen", "slows")

#: What the gap's acceleration, or the restitution, may be in a box beyond what it is at points,
#: against its size: bounds overestimate by a little that shrinks with the box.
EXCESS = 0.02

#: That many rates of change of the gap's acceleration: over a flight of time ``d`` its Taylor
#: polynomial of one degree less is off by ``bound * d**3 / 3!``. What acts for a share ``s`` of a
#: flight has rates of ``1 / s**3`` its size, so that nothing hides by being small and brief.
RATES, RATES_FACTORIAL = 3, 6.0

#: How often a tail is halved, at most. Three or four halvings leave one flight, a dozen more so
#: little of it that bounds of time, position and speed are as close as points are. A part that is
#: undecided there ends it, so that a tail in which something hides costs no more. (With nine the
#: first flights of Example 1 from 0.4 above its wall were undecided, and with twelve those from
#: there with r = 0.98: all steps were watched, in some hundred times the time.)
TAIL_HALVINGS = 16

#: How much wider a box is than the points in it, on either side.
BOX_MARGIN = 0.25

#: Slowest impacts that are asked for their restitution (as slow as a float can be, but for a
#: square), impacts of a tail that are asked one by one, and steps from there to the slowest.
SLOWEST, ASKED_IMPACTS, SLOW_STEPS = 1e-300, 400, 1500

#: Flights between which the restitution along a tail is interpolated.
LAW_POINTS = 12

#: What the restitution may be off, in what that does to the limit, against the sum's own error.
LAW_CAUTION = 64.0

# Columns of ``laws``, besides the restitution.
SPEED_GROWTH = 0

# Columns of ``stretches``: the numbers of the first impact and the last, infinite for the limit;
# which shares of each flight after them; how often it may yet be halved. Rows of ``box``: time, gap
# speed before an impact, states. What is bounded: the gap's acceleration, the restitution, and the
# last of the acceleration's rates; behind them the guards of other edges.
FIRST_IMPACT, LAST_IMPACT, SHARE_FROM, SHARE_TO, HALVINGS_LEFT = 0, 1, 2, 3, 4
TIME_ROW, SPEED_ROW, STATE_ROWS = 0, 1, 2
ACCELERATION, RESTITUTION, LAST_RATE, OTHER_GUARDS = 0, 1, 2, 3


def seen(
    a: AutomatonArrays,
    flow: int,
    at: int,
    sight: int,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    excess: float,
    room: Sums,
    look: Look,
) -> bool:
    """Whether bounds along a tail are what is there at its points, as far as doubles tell.

    From its limit on, flight by flight: of each no larger part is asked than the largest that did
    in the flight after it, which is lower.
    """
    put(look.stretches[0], 0.0, math.inf, 0.0, 1.0, TAIL_HALVINGS)
    count, n, flight, largest, most = 1, x.shape[0], -1.0, 1.0, 1.0
    while count > 0:
        count -= 1
        s = look.stretches[count]
        single, size = s[FIRST_IMPACT] == s[LAST_IMPACT], s[SHARE_TO] - s[SHARE_FROM]
        if single and s[FIRST_IMPACT] == flight:
            points = shown_again(s, n, room, look)
        else:
            points = shown(
                a.programs, flow, at, curve, t, x, v, r, r ** s[FIRST_IMPACT], r ** s[LAST_IMPACT],
                s[SHARE_FROM], s[SHARE_TO], room, look.shown,
            )  # fmt: skip
            flight = s[FIRST_IMPACT] if single else -1.0
            most, largest = (largest, 0.0) if single else (most, largest)
        boxed(s[LAST_IMPACT] < math.inf, look)
        asked = not single or size <= most or s[HALVINGS_LEFT] == 0.0
        if asked and fits(a, sight, n, points, excess, look):
            largest = max(largest, size) if single else largest
        elif s[HALVINGS_LEFT] > 0.0:
            halved(look.stretches, count, r)
            count += 2
        else:
            return False
    return True


def shown_again(s: Floats, n: int, room: Sums, look: Look) -> int:
    """Points of another part of the flight that is shown, whose ends are still put down."""
    leaves, lands = look.shown[0, n + 2], look.shown[0, n + 3]
    part(n, leaves, lands, s[SHARE_FROM], s[SHARE_TO], room.lines, 0, look.shown)
    hull(n, POINTS_EACH, look.shown)
    return POINTS_EACH


def damped(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    impacts: int,
    allowed: float,
    room: Sums,
    found: Matrix,
) -> float:
    """What the restitution at all impacts is off what a sum's flights have it, each as if it were
    the first; infinite where one is off by more than ``allowed``, or not below 1."""
    if not laws(p, flow, at, column, held, curve, t, x, v, r, room, found):
        return math.inf
    n, degree, fit = x.shape[0], curve.shape[0] - 1, found[LAW_POINTS + 1 :]
    w, total, state = 1.0, 0.0, room.lines[STATE_THERE, :n]
    for _ in range(min(impacts, ASKED_IMPACTS)):
        when, _ = on_curve(p, at, curve, degree, t, x, v, r * w, 1.0, room, state)
        bend = value(curve, degree, n + 1, w) + value(fit, LAW_POINTS, SPEED_GROWTH, w)
        law = restitution(p, at, when, state, -v * w * math.exp(bend), room)
        expected = math.exp(value(fit, LAW_POINTS, RESTITUTION, w))
        off = abs(law / expected - 1.0) * w
        if not law < 1.0 - LEAST_LOSS or not off <= allowed:
            return math.inf
        total += off
        w *= r
    return total


def slows(p: Programs, at: int, t: float, x: Floats, v: float, room: Sums) -> bool:
    """Whether the restitution is below 1 down to the slowest impacts, at a state."""
    fall = (math.log(SLOWEST) - math.log(v)) / (SLOW_STEPS - 1)  # the quotient may be denormal
    for k in range(SLOW_STEPS):
        if not restitution(p, at, t, x, -v * math.exp(fall * k), room) < 1.0 - LEAST_LOSS:
            return False
    return True


def laws(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    room: Sums,
    found: Matrix,
) -> bool:
    """Polynomials through the growth of the speed in a flight, and the restitution after it, in the
    place on the curve from which the flight begins; False where one is not to be had."""
    state = room.lines[STATE_THERE, : x.shape[0]]
    found[0, SPEED_GROWTH], found[0, RESTITUTION] = 0.0, math.log(r)
    for k in range(1, LAW_POINTS + 1):
        nodes(LAW_POINTS, room.small[CURVE_BASIS])
        w = room.small[CURVE_BASIS, k]
        when, speed = on_curve(p, at, curve, curve.shape[0] - 1, t, x, v, w, 1.0, room, state)
        status, length, u, _, _ = fly(
            p, flow, column, held, when, state, speed, room.c, room.series[:0], room.sides[:0],
            0.0, LAST_TERMS, room,
        )  # fmt: skip
        if status < 0:
            return False
        law = restitution(p, at, when + length, room.end, u, room)
        if not law > 0.0:
            return False
        found[k, SPEED_GROWTH], found[k, RESTITUTION] = math.log(-u / speed), math.log(law)
    from_values(LAW_POINTS, room.small)
    for k in range(LAW_POINTS + 1):
        for j in range(2):
            total = 0.0
            for i in range(LAW_POINTS + 1):
                total += room.small[k, i] * found[i, j]
            found[LAW_POINTS + 1 + k, j] = total
    return True


def put(s: Floats, first: float, last: float, begin: float, end: float, left: float) -> None:
    """Put a stretch down."""
    s[FIRST_IMPACT], s[LAST_IMPACT] = first, last
    s[SHARE_FROM], s[SHARE_TO], s[HALVINGS_LEFT] = begin, end, left


def halved(stretches: Matrix, place: int, r: float) -> None:
    """Two stretches of about half the time each; of a single flight, its two parts."""
    s, other = stretches[place], stretches[place + 1]
    first, last, left = s[FIRST_IMPACT], s[LAST_IMPACT], s[HALVINGS_LEFT] - 1.0
    begin, end = s[SHARE_FROM], s[SHARE_TO]
    if first == last:
        put(s, first, last, begin, 0.5 * (begin + end), left)
        put(other, first, last, 0.5 * (begin + end), end, left)
    else:
        middle = half_way(first, last, r)
        put(s, first, middle, 0.0, 1.0, left)
        put(other, middle + 1.0, last, 0.0, 1.0, left)


def half_way(first: float, last: float, r: float) -> float:
    """The last impact of the first half, in time, of those of a stretch."""
    return first + math.floor(math.log(0.5 * (1.0 + r ** (last - first))) / math.log(r))


def boxed(moves: bool, look: Look) -> None:
    """Bounds of time (within the flights), of gap speeds before impacts (down to rest where the
    stretch ends there), and of states."""
    box, least, most = look.box, look.shown[STRETCH_POINTS], look.shown[STRETCH_POINTS + 1]
    n = box.shape[0] - STATE_ROWS
    wider = BOX_MARGIN * (most[0] - least[0])
    box[TIME_ROW, 0] = max(least[0] - wider, least[n + 2])
    box[TIME_ROW, 1] = min(most[0] + wider, most[n + 3])
    box[SPEED_ROW, 0], box[SPEED_ROW, 1] = least[n + 1], most[n + 1] if moves else 0.0
    for j in range(n):
        wider = BOX_MARGIN * (most[j + 1] - least[j + 1])
        box[STATE_ROWS + j, 0] = math.nextafter(least[j + 1] - wider, -math.inf)
        box[STATE_ROWS + j, 1] = math.nextafter(most[j + 1] + wider, math.inf)


def fits(a: AutomatonArrays, sight: int, n: int, points: int, excess: float, look: Look) -> bool:
    """Whether what is bounded is in the box what it is at the points, but for an excess, and no
    other guard is zero there."""
    if ranges(a.bounds, sight, look.box, look.found) < 0:
        return False
    results, size, fit = a.bounds.index[sight, 2], 0.0, True
    for k in range(OTHER_GUARDS, a.bounds.index[sight, 3]):
        found = look.found[a.bounds.results[results + k]]
        fit = fit and (found[0] > 0.0 or found[1] < 0.0)
    for k in range(OTHER_GUARDS):
        found = look.found[a.bounds.results[results + k]]
        look.bounded[k, 0], look.bounded[k, 1] = found[0], found[1]
    if not (fit and sampled(a, sight, n, points, look)):
        return False
    for k in range(LAST_RATE):
        low, high = look.sampled[k, 0], look.sampled[k, 1]
        size = max(-low, high) if k == ACCELERATION else size
        wide = high - low + excess * (size if k == ACCELERATION else 1.0)
        top = math.nextafter(0.0, -math.inf) if k == ACCELERATION else 1.0 - LEAST_LOSS
        fit = fit and within(look.bounded[k], low - wide, min(high + wide, top))
    return fit and steady(n, points, excess, size, look)


def sampled(a: AutomatonArrays, sight: int, n: int, points: int, look: Look) -> bool:
    """Put down the least and the most of what is bounded at the points that are shown; False where
    something has no value."""
    results, exists = a.bounds.index[sight, 2], True
    for i in range(points):
        look.points[TIME_ROW, i], look.points[SPEED_ROW, i] = look.shown[i, 0], look.shown[i, n + 1]
        for j in range(n):
            look.points[STATE_ROWS + j, i] = look.shown[i, j + 1]
    at_points(a.bounds, sight, look.points, points, look.values)
    for k in range(OTHER_GUARDS):
        there = look.values[a.bounds.results[results + k]]
        low, high = math.inf, -math.inf
        for i in range(points):
            low, high = min(low, there[i]), max(high, there[i])
            exists = exists and not math.isnan(there[i])
        look.sampled[k, 0], look.sampled[k, 1] = low, high
    return exists


def within(found: Floats, low: float, high: float) -> bool:
    """Whether bounds are between two numbers."""
    return low <= found[0] and found[1] <= high


def brief(size: float, length: float) -> float:
    """The least last rate of what bends a flight of a length by an acceleration of a size; none
    bends one that is too short for a float."""
    shares = length**RATES
    return RATES_FACTORIAL * size / shares if shares > 0.0 else math.inf


def steady(n: int, points: int, excess: float, size: float, look: Look) -> bool:
    """Whether the last rate is small in a box, or what it is at the points, but for an excess."""
    small = brief(excess * size, longest(look.shown, n, points))
    low, high = look.sampled[LAST_RATE, 0], look.sampled[LAST_RATE, 1]
    wide, found = high - low + small + excess * max(-low, high), look.bounded[LAST_RATE]
    return within(found, -small, small) or within(found, low - wide, high + wide)


def longest(shown: Matrix, n: int, points: int) -> float:
    """The longest flight of a stretch that is shown."""
    length = 0.0
    for i in range(points):
        length = max(length, shown[i, n + 3] - shown[i, n + 2])
    return length
