"""The sum of infinitely many impacts: the chatter map, closed.

Let ``F`` take the state after an impact (with gap speed ``v``) to the state after the next.
Near a point of rest the impacts that tend to it lie on a curve ``y(w)``, on which the map
is multiplication: ``F(y(w)) = y(r w)`` with ``r`` the restitution at rest, ``y(0)`` the
point of rest, and the impacts at hand ``y(1), y(r), y(r^2), ...``. The curve is analytic
where flow, gap and restitution are. With ``D(w) = F(y(w)) - y(w)`` for time and state, and
``E(w) = log(v'/(r v))`` for the gap speed, the curve solves two linear equations::

    y(r w) - y(w) = D(w),    log v = log w + l(w),    l(r w) - l(w) = E(w).

The curve is a polynomial, for which they hold at a few points of ``[0, 1]``. ``D`` and ``E`` there
are computed by one Taylor flight each; the equations are solved, which moves the curve; and so
on by turns, each of which gains an order and takes one point more. Where moving the curve
changes nothing (a fixed wall, a flow that depends on nothing but the gap and the speed squared),
the flights that are known are kept. What the last turn changed bounds what is left. This is the map
of Nordmark & Piiroinen (Nonlinear Dynamics 58, 2009) to any order; see ``docs/notes/chatter.md``.

A model is given as programs: the flow with its guards, and three of what happens at the contact.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs, Sums
from .chebyshev import differences, evaluate, value
from .flights import NO_LENGTH, fly
from .jets import KINKS, afresh, values
from .kinks import NO_SERIES
from .lengths import LAST_TERMS
from .linear import solve, unfitted
from .zeros import EPS

__all__ = ("close", "hull", "impacts", "on_curve", "part", "restitution", "shown", "touch")

# Rows of ``lines``: Chebyshev coefficients of the curve; flights and impacts from its points; right
# sides, then values there. Of time and states at the limit: since the first impact; what the last
# turn has changed, and at last bounds on the error; the limit before; what may change. The start of
# a flight since the first impact, the state there, and what a program gives. Of a flight that is
# shown: where it has left the contact, where it strikes it, and the rates behind each.
CURVE, FLIGHT_ROWS, VALUE_ROWS = 0, 17, 34
TO_LIMIT, ERROR, OLD_LIMIT, ALLOWED, ON_CURVE, STATE_THERE, READ = 51, 52, 53, 54, 55, 56, 57
LEAVING, STRIKING, SUM_LINES = 58, 60, 62

# Rows of ``small``: equations; Chebyshev polynomials at a point; the points; what each turn has
# changed, against what may change; the gap's acceleration.
EQUATIONS, CURVE_BASIS, CURVE_POINTS, HISTORY, FIT = 0, 17, 18, 19, 20

# Places in ``times`` of where the curve is; in ``ints`` of how many flights are known, of the
# pieces of the first, of how many kinks it has crossed (-1 if none was flown), and of its branch.
GRID, KNOWN, PIECES, KINKS_CROSSED, BRANCH = 64, 0, 1, 2, 3

#: Programs of what happens at a contact, from the first of them on: the state moved onto it; change
#: of the state that changes the gap's speed by one, then gap speed and acceleration; the
#: restitution.
ONTO_CONTACT, KICK, RESTITUTION_LAW = 0, 1, 2

#: Most points on the curve.
MOST_DEGREE = 16

#: Points to which more are added: Leja's, each where those before, and 0, leave most room.
ADDED_POINTS = (
    1.0, 0.5, 0.2113, 0.8294, 0.0804, 0.935, 0.6528, 0.3391,
    0.0285, 0.9763, 0.7397, 0.1437, 0.422, 0.8874, 0.0103, 0.5806,
)  # fmt: skip

#: Order of the series of a flight: that of ``high``. Those of ``c`` do for flights of less than
#: half a piece, and where coefficients grow beyond what a double can be.
HIGH_ORDER, HALF_A_PIECE = 24, 0.5

#: Flights of a stretch of a tail at which it is looked, and points of each; then come two rows, of
#: the least and the most of each column.
STRETCH_FLIGHTS, POINTS_EACH = 5, 3
STRETCH_POINTS = STRETCH_FLIGHTS * POINTS_EACH

#: Rounding floor of an accumulation, relative.
SUM_FLOOR = 4e-15

#: Share of the tolerances that a sum may be off: it is a small part of a run's error.
SUM_SHARE = 1e-3

#: Logarithms of the speed's ratio below which the forces are taken to be even in the speed.
IDLE = 1e-13

#: Least loss at the impacts of a sum: ten thousand roundings of the restitution.
LEAST_LOSS = 1e-12

#: The speed of an impact at rest. The formula of a restitution may have a pole at zero, where it
#: has a limit: ``min(r, |u|^(-1/4))``. The square of this is the smallest normal float.
SLOW = 2.0**-511

#: Points off the nodes at which a curve is put to the test.
PROBES = (0.3, 0.1, 0.03, 0.01, 1e-3)

#: Times along a tail at which the forces are looked at, and how smooth they must be; degrees that
#: they may have beyond those of the curve.
FORCE_SAMPLES, FORCE_SMOOTHNESS, MORE_DEGREES = 64, 1e-5, 2

#: The last of the points of the curve between which its place at a time is interpolated: there are
#: four of them for each time.
LAST_POINT = 255

#: What is left after a turn, against what the turn changed: it shrinks, but not evenly. Where only
#: points are added it is compared with this share of the last two coefficients, of which it was
#: 0.0004 to 1.3 in sums along hard springs and soft ones.
TURN_CAUTION, LAST_COEFFICIENTS = 8.0, 0.25

#: What is left after a point more, against what was before, that still falls: rounding, of which
#: what may be is a cautious bound, does not.
STILL_FALLS = 0.5

#: Rounding of one flight, relative, as seen in the change from turn to turn; what the last terms of
#: its series leave of its length and of the speed at its end, against their own share: it was up to
#: 1.9; and their share of what the sum may be off.
FLIGHT_ROUNDING, TERMS_CAUTION, LAST_TERMS_SHARE = 3e-15, 4.0, 0.025

#: Most turns in which the speed before an impact is found where the restitution depends on it: the
#: error falls in each by the power of the speed by which that changes there.
LAW_TURNS = 60

#: The smallest that anything is compared with, and the largest logarithm of a speed's growth.
SMALLEST_DIVISOR, LARGEST_GROWTH = 1e-300, 700.0


def close(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    local: bool,
    t: float,
    x: Floats,
    v: float,
    rtol: float,
    atol: float,
    room: Sums,
) -> tuple[int, float]:
    """Sum the impacts that follow an impact with speed ``v``.

    Parameters
    ----------
    flow, at : int
        Programs: the flow with its guards, and the first of those of what happens at the contact.
    column : int
        Place of the gap among the guards.
    held : bool
        As :func:`.flights.fly` takes it.
    local : bool
        Whether all flights see the same forces, whenever they are.
    rtol, atol : float
        Tolerances of the run.

    Returns
    -------
    degree : int
        Of the curve; 0 where it cannot yet be done: the series does not converge well enough from
        here, as the impacts are too strong, or do not accumulate at all.
    r : float
        The restitution at rest.
    """
    lines, history, n = room.lines, room.small[HISTORY], x.shape[0]
    begin(lines, room.ints)
    steady, degree = local, 1
    r = at_rest(p, at, t, x, room)
    terms = max(LAST_TERMS, LAST_TERMS_SHARE * SUM_SHARE * rtol * (1.0 - r))
    while degree <= MOST_DEGREE and r > 0.0:
        fine, steady = flown(p, flow, at, column, held, steady, degree, t, x, v, r, terms, room)
        if not (fine and solved(degree, n, r, lines, room.small)):
            break
        if not steady:
            r = at_limit(p, at, t, x, room)
        turns = degree - 1
        if turns > 0:
            left, clear = compared(steady, degree, t, x, r, rtol, atol, terms, lines)
            history[turns - 1] = left
            falls = turns < 2 or left < STILL_FALLS * history[turns - 2]
            last = clear <= 1.0 or not (steady and falls) or degree == MOST_DEGREE
            if left <= 1.0 and last:
                r = at_limit(p, at, t, x, room)
                fits = r > 0.0 and tested(
                    p, flow, at, column, held, degree, t, x, v, r, terms, room
                )
                fits = fits and (steady or smooth(p, at, degree, t, x, room))
                return degree if fits and finished(p, at, t, x, r, terms, room) else 0, r
            if not (steady or hopeful(history, turns, MOST_DEGREE - degree)):
                break
        for j in range(n + 1):
            lines[OLD_LIMIT, j] = lines[TO_LIMIT, j]
        degree += 1
    return 0, r


def begin(lines: Matrix, ints: Ints) -> None:
    """Forget what is in the room."""
    ints[KINKS_CROSSED], ints[KNOWN], ints[PIECES] = -1, 0, 0
    for i in range(MOST_DEGREE + 1):
        for j in range(lines.shape[1]):
            lines[i, j] = 0.0


# ---------------------------------------------------------------------------------------
# what happens at the contact


def restitution(p: Programs, at: int, t: float, x: Floats, u: float, room: Sums) -> float:
    """The restitution of an impact with speed ``u``."""
    n, asked = x.shape[0], room.lines[READ]
    for j in range(n):
        asked[j] = x[j]
    asked[n] = u
    values(p, at + RESTITUTION_LAW, t, asked[: n + 1], room.sides, room.c, room.work, asked)
    return asked[0]


def touch(p: Programs, at: int, t: float, x: Floats, room: Sums) -> None:
    """Move a state onto the contact, and read there how it turns."""
    read = room.lines[READ]
    values(p, at + ONTO_CONTACT, t, x, room.sides, room.c, room.work, read)
    for j in range(x.shape[0]):
        x[j] = read[j]
    values(p, at + KICK, t, x, room.sides, room.c, room.work, read)


def turned(x: Floats, change: float, read: Floats) -> None:
    """Change the gap speed of a state, once it is read how it turns."""
    for j in range(x.shape[0]):
        x[j] += change * read[j]


def at_rest(p: Programs, at: int, t: float, x: Floats, room: Sums) -> float:
    """The restitution at rest; NaN where its series has no sum."""
    r = restitution(p, at, t, x, -SLOW, room)
    return r if 0.0 < r < 1.0 - LEAST_LOSS else math.nan


def at_limit(p: Programs, at: int, t: float, x: Floats, room: Sums) -> float:
    """The restitution at the limit; NaN where nothing pushes the contact together there."""
    n, lines = x.shape[0], room.lines
    state, end = lines[STATE_THERE, :n], t + lines[TO_LIMIT, 0]
    for j in range(n):
        state[j] = x[j] + lines[TO_LIMIT, j + 1]
    values(p, at + KICK, end, state, room.sides, room.c, room.work, lines[READ])
    return at_rest(p, at, end, state, room) if lines[READ, n + 1] < 0.0 else math.nan


# ---------------------------------------------------------------------------------------
# flights from the curve


def flown(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    steady: bool,
    degree: int,
    t: float,
    x: Floats,
    v: float,
    r: float,
    terms: float,
    room: Sums,
) -> tuple[bool, bool]:
    """Make the flights from the curve's points.

    Known are kept while the curve's place is idle; its start stays where it is.

    Returns
    -------
    fine : bool
        False where a flight is not to be had.
    steady : bool
        Whether moving the curve has changed nothing.
    """
    lines, points, n, idle = room.lines, room.small[CURVE_POINTS], x.shape[0], steady
    for k in range(degree):
        points[k] = (
            ADDED_POINTS[k] if steady or k == 0 else 0.5 - 0.5 * math.cos(math.pi * k / degree)
        )
        if k >= room.ints[KNOWN] or not (steady or k == 0):
            if not flight(
                p, flow, at, column, held, degree - 1, t, x, v, points[k], k, terms, room
            ):
                return False, False
            idle = idle and abs(bend(lines, k, r)) <= IDLE + TERMS_CAUTION * terms
        for j in range(n + 1):
            lines[VALUE_ROWS + k, j] = lines[FLIGHT_ROWS + k, j]
        lines[VALUE_ROWS + k, n + 1] = bend(lines, k, r)
    room.ints[KNOWN] = degree
    return True, idle


def tested(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    degree: int,
    t: float,
    x: Floats,
    v: float,
    r: float,
    terms: float,
    room: Sums,
) -> bool:
    """Whether flights from points between fulfil the curve's equation."""
    for k in range(len(PROBES)):
        w, place = PROBES[k], MOST_DEGREE
        if not flight(p, flow, at, column, held, degree, t, x, v, w, place, terms, room):
            return False
        if not follows(degree, r, w, place, terms, room.lines):
            return False
    return True


def flight(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    degree: int,
    t: float,
    x: Floats,
    v: float,
    w: float,
    place: int,
    terms: float,
    room: Sums,
) -> bool:
    """Make a flight and an impact from a point of the curve.

    Known are then its length, what is added to the state, and by what the gap speed is multiplied.
    """
    n, lines = x.shape[0], room.lines
    state = lines[STATE_THERE, :n]
    begins, speed = on_curve(p, at, lines, degree, t, x, v, w, 1.0, room, state)
    status, length, u, pieces, crossed = NO_SERIES, 0.0, 0.0, 0, 0
    if w * room.ints[PIECES] >= HALF_A_PIECE or room.ints[PIECES] == 0:
        status, length, u, pieces, crossed = fly(
            p, flow, column, held, begins, state, speed, room.high, room.series[:0],
            room.sides[:0], 0.0, terms, room,
        )  # fmt: skip
    if NO_LENGTH <= status < 0:
        status, length, u, pieces, crossed = fly(
            p, flow, column, held, begins, state, speed, room.c, room.series[:0], room.sides[:0],
            0.0, terms, room,
        )  # fmt: skip
    signs = p.index[flow, KINKS + 1] - p.index[flow, KINKS]
    if status < 0 or not same_branch(signs, pieces, crossed, room.branch, room.ints):
        return False
    after = -u * restitution(p, at, begins + length, room.end, u, room)
    if not after > 0.0:
        return False
    touch(p, at, begins + length, room.end, room)
    turned(room.end, after - u, lines[READ])
    lines[FLIGHT_ROWS + place, 0] = length
    for j in range(n):
        lines[FLIGHT_ROWS + place, j + 1] = room.end[j] - state[j]
    lines[FLIGHT_ROWS + place, n + 1] = after / speed
    return True


def on_curve(
    p: Programs,
    at: int,
    curve: Matrix,
    degree: int,
    t: float,
    x: Floats,
    v: float,
    w: float,
    share: float,
    room: Sums,
    state: Floats,
) -> tuple[float, float]:
    """The time of the impact ``y(w)``, and a share of the gap speed after it, with which the state
    is put down."""
    n, lines = x.shape[0], room.lines
    evaluate(curve, degree, w, room.small[CURVE_BASIS], lines[ON_CURVE])
    when, speed = t + lines[ON_CURVE, 0], share * v * w * grown(lines[ON_CURVE, n + 1])
    for j in range(n):
        state[j] = x[j] + lines[ON_CURVE, j + 1]
    touch(p, at, when, state, room)
    turned(state, speed - lines[READ, n], lines[READ])
    return when, speed


def grown(bend: float) -> float:
    """The factor of a logarithm; NaN where it is none that a speed could have."""
    return math.exp(bend) if abs(bend) < LARGEST_GROWTH else math.nan


def same_branch(signs: int, pieces: int, crossed: int, branch: Ints, ints: Ints) -> bool:
    """Whether a flight is on the branch of the first one, which is put down."""
    if ints[KINKS_CROSSED] < 0:
        ints[KINKS_CROSSED], ints[PIECES] = crossed, pieces
        for i in range(signs + crossed):
            ints[BRANCH + i] = branch[i]
    same = ints[KINKS_CROSSED] == crossed
    for i in range(signs + crossed):
        same = same and ints[BRANCH + i] == branch[i]
    return same


def follows(degree: int, r: float, w: float, place: int, terms: float, lines: Matrix) -> bool:
    """Whether a flight of the test fulfils the curve's equation."""
    length = lines[FLIGHT_ROWS + place, 0]
    change = value(lines, degree, 0, r * w) - value(lines, degree, 0, w)
    own = (TURN_CAUTION * FLIGHT_ROUNDING + TERMS_CAUTION * terms) * length
    return abs(length - change) <= lines[ALLOWED, 0] + own


def bend(lines: Matrix, place: int, r: float) -> float:
    """``E`` of a flight: how the speed shrinks, against the ratio at rest."""
    ratio = lines[FLIGHT_ROWS + place, lines.shape[1] - 1] / r
    return math.log(ratio) if 0.0 < ratio < math.inf else math.nan


def shown(
    p: Programs,
    flow: int,
    at: int,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    first: float,
    last: float,
    begin: float,
    end: float,
    room: Sums,
    out: Matrix,
) -> int:
    """Points of the flights from ``y(first)`` to ``y(last)`` of a tail, between two shares of each.

    A row of ``out`` is the time, the state, the gap speed at the end of the flight, and the times
    at which this begins and ends. The state is a cubic through those at its ends and their rates.
    Returns the number of points, fewer of a single flight.
    """
    count = STRETCH_POINTS if first > last else POINTS_EACH
    for i in range(0, count, POINTS_EACH):
        w = last + (first - last) * (i // POINTS_EACH) / (STRETCH_FLIGHTS - 1)
        leaves = end_of_flight(p, flow, at, curve, t, x, v, w, 1.0, LEAVING, room)
        lands = end_of_flight(p, flow, at, curve, t, x, v, r * w, -1.0 / r, STRIKING, room)
        part(x.shape[0], leaves, lands, begin, end, room.lines, i, out)
    hull(x.shape[0], count, out)
    return count


def part(
    n: int,
    leaves: float,
    lands: float,
    begin: float,
    end: float,
    lines: Matrix,
    first: int,
    out: Matrix,
) -> None:
    """Points of a flight between two shares, whose ends are put down, as rows from ``first`` on."""
    length = lands - leaves
    for i in range(first, first + POINTS_EACH):
        share = begin + (end - begin) * (i - first) / (POINTS_EACH - 1)
        for j in range(n):
            chord = lines[STRIKING, j] - lines[LEAVING, j]
            early = length * lines[LEAVING + 1, j] - chord
            late = length * lines[STRIKING + 1, j] - chord
            bow = share * (1.0 - share) * ((1.0 - share) * early - share * late)
            out[i, j + 1] = lines[LEAVING, j] + share * chord + bow
        out[i, 0], out[i, n + 1] = leaves + share * length, lines[STRIKING, n]
        out[i, n + 2], out[i, n + 3] = leaves, lands


def hull(n: int, count: int, out: Matrix) -> None:
    """The least and the most of each column of the first rows."""
    least, most = out[STRETCH_POINTS], out[STRETCH_POINTS + 1]
    for j in range(n + 4):
        least[j] = most[j] = out[0, j]
        for i in range(1, count):
            least[j], most[j] = min(least[j], out[i, j]), max(most[j], out[i, j])


def end_of_flight(
    p: Programs,
    flow: int,
    at: int,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    w: float,
    share: float,
    place: int,
    room: Sums,
) -> float:
    """One end of a flight, next to the impact ``y(w)``: put down are the state, and behind it the
    gap speed, a share of that after the impact; in the next line the rates. Returns the time."""
    n, lines = x.shape[0], room.lines
    state, degree = lines[place, :n], curve.shape[0] - 1
    when, lines[place, n] = on_curve(p, at, curve, degree, t, x, v, w, share, room, state)
    afresh(p, flow, 1, when, state, room.sides, room.aside, room.work)
    for j in range(n):
        lines[place + 1, j] = room.aside[j, 1]
    return when


def impacts(
    p: Programs,
    at: int,
    curve: Matrix,
    t: float,
    x: Floats,
    v: float,
    r: float,
    room: Sums,
    before: Matrix,
    after: Matrix,
) -> int:
    """The states before and after the impacts ``y(r)``, ``y(r^2)``, ..., the former from the
    latter: as many as there are rows."""
    read, degree = room.lines[READ], curve.shape[0] - 1
    for k in range(after.shape[0]):
        state, w = after[k], math.pow(r, k + 1.0)
        when, speed = on_curve(p, at, curve, degree, t, x, v, w, 1.0, room, state)
        struck = -speed / r
        for _ in range(LAW_TURNS):
            last, struck = struck, -speed / restitution(p, at, when, state, struck, room)
            if abs(struck - last) <= 2.0 * EPS * abs(struck):
                break
        values(p, at + KICK, when, state, room.sides, room.c, room.work, read)
        for j in range(x.shape[0]):
            before[k, j] = state[j]
        turned(before[k], struck - speed, read)
    return 0


# ---------------------------------------------------------------------------------------
# the curve through them


def solved(degree: int, n: int, r: float, lines: Matrix, small: Matrix) -> bool:
    """Solve for the coefficients of the curve, which is zero where it starts."""
    for k in range(degree):
        differences(degree, r, small[CURVE_POINTS, k], small[CURVE_BASIS])
        for j in range(degree):
            small[EQUATIONS + k, j] = small[CURVE_BASIS, j + 1]
    if not solve(small[EQUATIONS:], degree, lines[VALUE_ROWS:], n + 2):
        return False
    finite = True
    for j in range(n + 2):
        even, odd = 0.0, 0.0
        for k in range(degree, 0, -1):
            own = lines[VALUE_ROWS + k - 1, j]
            lines[CURVE + k, j] = own
            if k % 2 == 0:
                even += own
            else:
                odd += own
        lines[CURVE, j] = -(even + odd)
        lines[TO_LIMIT, j] = -2.0 * odd
        finite = finite and math.isfinite(even + odd)
    return finite and lines[TO_LIMIT, 0] > 0.0


def scale(t: float, x: Floats, j: int, lines: Matrix) -> float:
    """Size of time (0) or of an element of the state, over the tail."""
    return abs(lines[TO_LIMIT, j]) + abs(t if j == 0 else x[j - 1])


def rounding(t: float, x: Floats, j: int, r: float, terms: float, lines: Matrix) -> float:
    """Rounding of one flight, and its last terms, added up over the ``1 / (1 - r)`` flights that
    count."""
    size = lines[TO_LIMIT, 0] if j == 0 else scale(t, x, j, lines)
    return (FLIGHT_ROUNDING + TERMS_CAUTION * terms) / (1.0 - r) * size


def compared(
    steady: bool,
    degree: int,
    t: float,
    x: Floats,
    r: float,
    rtol: float,
    atol: float,
    terms: float,
    lines: Matrix,
) -> tuple[float, float]:
    """What is left, against what may be, with rounding and without: what the last turn has changed;
    where only points were added, as the last coefficients say."""
    worst, clear = 0.0, 0.0
    for j in range(x.shape[0] + 1):
        asked = max(SUM_SHARE * rtol, SUM_FLOOR) * scale(t, x, j, lines)
        asked += SUM_SHARE * atol if j > 0 else 0.0
        lines[ALLOWED, j] = asked + rounding(t, x, j, r, terms, lines)
        last = abs(lines[CURVE + degree, j]) + abs(lines[CURVE + degree - 1, j])
        change = abs(lines[TO_LIMIT, j] - lines[OLD_LIMIT, j])
        lines[ERROR, j] = LAST_COEFFICIENTS * last if steady else change
        worst = max(worst, lines[ERROR, j] / max(lines[ALLOWED, j], SMALLEST_DIVISOR))
        clear = max(clear, lines[ERROR, j] / max(asked, SMALLEST_DIVISOR))
    return worst, clear


def hopeful(history: Floats, turns: int, left: int) -> bool:
    """Whether the changes shrink fast enough (over two turns: odd orders may vanish)."""
    if turns < 3 or not history[turns - 3] > 0.0:
        return True
    rate = math.sqrt(history[turns - 1] / history[turns - 3])
    return rate < 1.0 and history[turns - 1] * rate**left < 1.0


# ---------------------------------------------------------------------------------------
# the end


def finished(p: Programs, at: int, t: float, x: Floats, r: float, terms: float, room: Sums) -> bool:
    """Put down bounds on the error, and the state at the limit."""
    n, lines = x.shape[0], room.lines
    for j in range(n + 1):
        least = SUM_FLOOR * scale(t, x, j, lines) + rounding(t, x, j, r, terms, lines)
        lines[ERROR, j] = TURN_CAUTION * lines[ERROR, j] + least
    state = lines[STATE_THERE, :n]
    for j in range(n):
        state[j] = x[j] + lines[TO_LIMIT, j + 1]
    touch(p, at, t + lines[TO_LIMIT, 0], state, room)
    turned(state, -lines[READ, n], lines[READ])
    return True


def smooth(p: Programs, at: int, degree: int, t: float, x: Floats, room: Sums) -> bool:
    """Whether forces vary along the tail, in steps of time, as a polynomial of its degree does."""
    n, lines, line = x.shape[0], room.lines, room.small[CURVE_BASIS]
    times, place, here = room.times, LAST_POINT, lines[ON_CURVE]
    for m in range(LAST_POINT + 1):
        times[GRID + m] = value(lines, degree, 0, m / LAST_POINT)
    columns = min(degree + 1 + MORE_DEGREES, MOST_DEGREE) + 1
    state, most = lines[STATE_THERE, :n], 0.0
    for i in range(FORCE_SAMPLES):
        since = lines[TO_LIMIT, 0] * i / (FORCE_SAMPLES - 1)
        while place > 1 and times[GRID + place - 1] < since:
            place -= 1
        w = (place - within(since, times[GRID + place], times[GRID + place - 1])) / LAST_POINT
        evaluate(lines, columns - 1, w, line, here)
        for j in range(n):
            state[j] = x[j] + here[j + 1]
        touch(p, at, t + here[0], state, room)
        turned(state, -lines[READ, n], lines[READ])
        values(p, at + KICK, t + here[0], state, room.sides, room.c, room.work, lines[READ])
        times[i] = lines[READ, n + 1]
        most = max(most, abs(times[i]))
        for k in range(columns):
            room.small[FIT + i, k] = line[k]
    unfitted(room.small[FIT:], FORCE_SAMPLES, columns, times)
    fits = True
    for i in range(FORCE_SAMPLES):
        fits = fits and abs(times[i]) <= FORCE_SMOOTHNESS * most
    return fits


def within(s: float, low: float, high: float) -> float:
    """Where a number lies between two others, as a share of the way."""
    return min(max((s - low) / (high - low), 0.0), 1.0) if high > low else 0.0
