"""How the limit of impacts changes with their start and with the parameters.

Let ``F`` take time and state after an impact to those after the next, and ``L`` to those of
their limit: ``L = L o F``. Along the curve ``y(w)`` of impacts (:mod:`.sums`) the derivative
``G(w) = DL(y(w))`` satisfies ::

    G(w) = G(r w) DF(y(w)),        G(0) known,

linear equations for its values at a few points of [0, 1], in which ``DF`` is the variation along
one flight and one impact. ``F`` leaves the parameters as they are: with ``G = (G_y, G_p)`` ::

    G_y(w) = G_y(r w) F_y(w),      G_p(w) = G_p(r w) + G_y(r w) F_p(w),

so that the equations for the parameters are as many as there are points, however many those are.
See ``docs/notes/gradients.md``.

A change of time and state is a matrix with these as its rows. Its columns are those of time, states
and parameters; that of the parameters themselves is not written down.
"""

from __future__ import annotations

import math

from .arrays import Changes, Floats, Ints, Matrix, Programs, Slopes, Sums
from .chebyshev import differences, from_values, nodes
from .flights import fly
from .jets import KINKS, afresh, values
from .kinks import KINK_ROW, count
from .lengths import LAST_TERMS
from .linear import solve
from .polynomials import power_value
from .slopes import onto_contacts, product, rates, read, reset
from .sums import KICK, READ, STATE_THERE, on_curve, touch, turned
from .variation import (
    GRADIENT,
    HELD_COUNT,
    KINKED,
    LAW_SLOPES,
    ONTO,
    RESET_SLOPES,
    REST_ROW,
    SLOPES_FROM,
    SLOPES_PROGRAM,
    SLOPES_UNTIL,
    SPEED_SLOPES,
    carried,
    composed,
    unmoved,
)
from .zeros import EPS

__all__ = ("limit",)

#: Points, which are doubled, and most of them: the last are among those before.
FEWEST_POINTS, MOST_POINTS = 3, 24

#: What is left of a derivative, relative, at which it is taken as it is; and at most.
SETTLED, USABLE = 1e-11, 1e-6

#: What is left of a difference, relative, that is rounding: a lost rank stays lost.
DIFFERENCE_ROUNDING = 1e-14

#: Share of a piece at whose distance from its end it is on its side of a kink; what rounding of
#: time and state makes of a kink, against its terms; a change of the flow below this, relative, is
#: none; and kinks are passed at one time by neighbours if those differ by less than this, relative.
KINK_SIDE, KINK_ROUNDING, SAME_FLOW, SAME_KINK_TIME = 1e-6, 16 * EPS, 1e-9, 1e-6

# Rows of ``lines``: flows where a flight begins and ends; the state there, and next to its start;
# how flow and time jump at a kink; the gradient of a gap, the flow at rest, and the speed.
FLOW_AT_START, FLOW_AT_END, STATE_AT_START, STATE_INSIDE, FLOW_JUMP = range(5)
TIME_JUMP, GAP_GRADIENT, DRIFT, FLOW_HERE, LIMIT_LINES = range(5, 10)

# Rows of ``small``: from values to coefficients; the points; and polynomials at one of them.
TO_SERIES, LIMIT_POINTS = 0, MOST_POINTS + 1
LIMIT_BASIS, LIMIT_SMALL = MOST_POINTS + 2, MOST_POINTS + 3


def limit(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    s: Slopes,
    contact: int,
    t: float,
    x: Floats,
    v: float,
    r: float,
    remaining: float,
    curve: Matrix,
    x_inf: Floats,
    directions: Matrix,
    incoming: Matrix,
    sums: Sums,
    room: Changes,
    out: Matrix,
) -> float:
    """From a change of time and state after the first impact to one at the limit.

    Parameters
    ----------
    p, flow, at, column, held
        As :func:`.sums.close` takes them.
    contact : int
        The row of the contact among the guards of ``s``.
    t, x, v, r, remaining, curve, x_inf
        The tail (:class:`hybrid.zeno.accumulate.Tail`).
    directions : Matrix
        A column for each direction in which the parameters change; no rows: each of them alone.
    incoming : Matrix
        The change of time and state with which the sum begins, a column for each parameter; or
        none, if that is not known.
    out : Matrix
        Gets the derivatives, by time and state of that impact and along the directions, of the
        time of the limit, of the state there, of the state at equal times, and of the ratio. Those
        at equal times have lost two ranks: gap and gap speed are zero at rest.

    Returns
    -------
    left : float
        What they may be off, relative; infinity where the impacts do not depend smoothly on their
        start: nothing is written where it is not below :data:`USABLE`.
    """
    own, least, before, degree = s.guards[contact], math.inf, math.inf, FEWEST_POINTS
    for i in range(MOST_POINTS + 1):
        room.known[i] = 0
    if not at_rest(p, at, s, own, t + remaining, x_inf, r, directions, sums, room):
        return math.inf
    while degree <= MOST_POINTS and least > SETTLED:
        for k in range(1, degree + 1):
            place = k * (MOST_POINTS // degree)
            nodes(degree, room.small[LIMIT_POINTS])
            w = room.small[LIMIT_POINTS, k]
            if room.known[place] == 0:
                if not mapped(
                    p, flow, at, column, held, s, own, t, x, v, w, curve, place, sums, room
                ):
                    return math.inf
                for i in range(1 + x.shape[0]):
                    directed(room.maps[place * (1 + x.shape[0]) + i], x, directions, room.read)
                room.known[place] = 1
        if not solved(degree, r, x, directions, room):
            return math.inf
        if degree > FEWEST_POINTS:
            change = compared(x, directions, incoming, room)
            left = change * min(1.0, change / before) if before < math.inf else change
            before = change
            if left < least:
                least = left
                copied(room.now, room.best)
        copied(room.now, room.last)
        degree *= 2
    if least <= USABLE:
        at_limit(s, own, t + remaining, x_inf, directions, room, out)
    return least


def copied(a: Matrix, b: Matrix) -> None:
    """Put down a matrix."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[i, j] = a[i, j]


def width(x: Floats, directions: Matrix, room: Changes) -> int:
    """Columns: time, states and directions."""
    return 1 + x.shape[0] + directions.shape[1] if directions.shape[0] > 0 else room.now.shape[1]


def directed(row: Floats, x: Floats, directions: Matrix, aside: Floats) -> None:
    """Of a row of derivatives those by the parameters become those along directions."""
    first = 1 + x.shape[0]
    if directions.shape[0] == 0:
        return
    for d in range(directions.shape[1]):
        total = 0.0
        for i in range(directions.shape[0]):
            total += row[first + i] * directions[i, d]
        aside[d] = total
    for d in range(directions.shape[1]):
        row[first + d] = aside[d]


# ---------------------------------------------------------------------------------------
# changes of time and state


def onto_gap(s: Slopes, own: Ints, t: float, x: Floats, change: Matrix, room: Changes) -> None:
    """Take away of a change what leads off the gap."""
    n, columns, across = x.shape[0], change.shape[1], room.lines[GAP_GRADIENT]
    values(s.programs, own[GRADIENT], t, x, room.sides, room.c, room.work, across)
    square = squared(across, n)
    for k in range(columns):
        share = product(across, change, 1 + n, columns, 1 + n, k) / square
        for i in range(1, 1 + n):
            change[i, k] -= across[i] * share


def squared(across: Floats, n: int) -> float:
    """The square of a gradient by the state."""
    square = 0.0
    for i in range(1, 1 + n):
        square += across[i] * across[i]
    return square


# ---------------------------------------------------------------------------------------
# from an impact to the next


def mapped(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    s: Slopes,
    own: Ints,
    t: float,
    x: Floats,
    v: float,
    w: float,
    curve: Matrix,
    place: int,
    sums: Sums,
    room: Changes,
) -> bool:
    """``DF`` at an impact of the curve, on the contact, in its place among the maps."""
    n, change, moved = x.shape[0], room.before, room.after
    columns, state, degree = change.shape[1], sums.lines[STATE_THERE, :n], curve.shape[0] - 1
    begins, speed = on_curve(p, at, curve, degree, t, x, v, w, 1.0, sums, state)
    status, length, u, pieces, crossed = fly(
        p, flow, column, held, begins, state, speed, sums.c, sums.series, sums.sides[:0], 0.0,
        LAST_TERMS, sums,
    )  # fmt: skip
    if status < 0 or not flown(p, flow, s, own, begins, n, pieces, crossed, sums, room):
        return False
    # the state at the impact has the gap speed that the flight has shown: in its own that drowns
    touch(p, at, begins + length, sums.end, sums)
    turned(sums.end, u - sums.lines[READ, n], sums.lines[READ])
    unmoved(change)
    onto_gap(s, own, begins, state, change, room)
    start, arrives, ends = room.lines[FLOW_AT_START], room.lines[FLOW_AT_END], begins + length
    rates(s, own[SLOPES_PROGRAM], begins, state, room, start)
    rates(s, own[SLOPES_PROGRAM], ends, sums.end, room, arrives)
    for k in range(columns):
        for i in range(n + 1):
            total = room.flight[i, k] if k > n else 0.0
            for j in range(n):
                total += room.flight[i, j] * (change[1 + j, k] - start[j] * change[0, k])
            moved[1 + i, k] = total
        # the gap is a coordinate of its own: its change must not be lost in the rounding of the
        # state's, however low the flight
        moved[0, k] = (speed * change[0, k] - moved[1 + n, k]) / u
        for i in range(n):
            moved[1 + i, k] += arrives[i] * moved[0, k]
    reset(s, own[RESET_SLOPES], ends, sums.end, 1 + n, columns, moved, change, room)
    if own[ONTO] >= 0 and not onto_contacts(
        s, own[ONTO], own[HELD_COUNT], ends, sums.end, 1 + n, columns, change, room
    ):
        return False
    onto_gap(s, own, ends, sums.end, change, room)
    for i in range(1 + n):
        for k in range(columns):
            room.maps[place * (1 + n) + i, k] = change[i, k]
    return True


def flown(
    p: Programs,
    flow: int,
    s: Slopes,
    own: Ints,
    t: float,
    n: int,
    pieces: int,
    crossed: int,
    sums: Sums,
    room: Changes,
) -> bool:
    """The matrix of a flight, with the gap as a coordinate of its own.

    It is carried at once where no formula changes on the way, else piece by piece.
    """
    x, inside, places = (
        room.lines[STATE_AT_START, :n],
        room.lines[STATE_INSIDE, :n],
        s.places[own[SLOPES_FROM] : own[SLOPES_UNTIL]],
    )
    unmoved(room.flight)
    for piece in range(pieces if crossed > 0 else 1):
        last = piece if crossed > 0 else pieces - 1
        begins = sums.starts[piece]
        length = sums.starts[last] + sums.lengths[last] - begins
        beside = KINK_SIDE * sums.lengths[piece]
        for j in range(n):
            series = sums.series[piece * n + j]
            x[j] = series[0]
            inside[j], _ = power_value(series, 0, series.shape[0] - 1, beside)
        if piece > 0 and not bent(p, flow, s, own, t, n, piece, crossed, sums, room):
            return False
        status = carried(
            s.programs, own[SLOPES_PROGRAM], places, t + begins, x, length, t + begins + beside,
            inside, room, room.piece,
        )  # fmt: skip
        if status < 0:
            return False
        for i in range(n + 1):
            for k in range(room.piece.shape[1]):
                room.aside[i, k] = room.piece[i, k]
        composed(room.aside, room.flight)
    return True


def bent(
    p: Programs,
    flow: int,
    s: Slopes,
    own: Ints,
    t: float,
    n: int,
    piece: int,
    crossed: int,
    sums: Sums,
    room: Changes,
) -> bool:
    """Through the start of a piece, where the flow may jump: ``1 + (f+ - f-) k_x / (k_t + k_x f-)``
    with ``k`` what is zero there. Whether neighbours have that at a time that is smooth."""
    jump, here, jumps = room.lines[FLOW_JUMP], room.lines[FLOW_HERE], False
    length = sums.lengths[piece - 1]
    for j in range(n):
        series = sums.series[(piece - 1) * n + j]
        _, here[j] = power_value(series, 0, series.shape[0] - 1, length)
        later = sums.series[piece * n + j, 1]
        jump[j] = later - here[j]
        jumps = jumps or abs(jump[j]) > SAME_FLOW * max(abs(later), abs(here[j]))
    if not jumps:
        return True
    now, x, columns = t + sums.starts[piece], room.lines[STATE_AT_START, :n], room.flight.shape[1]
    afresh(p, flow, 0, now, x, sums.sides, sums.aside, sums.work)
    read(s, own[KINKED], now, x, room)
    found = False
    for k in range(crossed):
        kink = sums.branch[count(p, flow) + k]
        if passed_at(p, flow, kink, now, x, here, length, sums, room):
            if not passed(kink, here, n, found, room):
                return False
            found = True
    for k in range(columns):
        for j in range(n):
            room.flight[j, k] -= jump[j] * room.lines[TIME_JUMP, k]
    return found


def passed_at(
    p: Programs,
    flow: int,
    kink: int,
    t: float,
    x: Floats,
    rates: Floats,
    length: float,
    sums: Sums,
    room: Changes,
) -> bool:
    """Whether a kink of a flow passes zero at the end of a piece; its value is in ``sums.aside``,
    and its derivatives are among those read."""
    n, columns = x.shape[0], room.before.shape[1]
    value = sums.aside[p.kinks[p.index[flow, KINKS] + kink, KINK_ROW], 0]
    row = room.read[kink * columns : (kink + 1) * columns]
    rate, size = row[0], abs(row[0] * t)
    for j in range(n):
        rate += row[1 + j] * rates[j]
        size += abs(row[1 + j] * x[j])
    return abs(value) <= KINK_SIDE * length * abs(rate) + KINK_ROUNDING * size and rate != 0.0


def passed(kink: int, rates: Floats, n: int, known: bool, room: Changes) -> bool:
    """When neighbours pass a kink; whether that is, if it is known of another, at the same time."""
    when, columns = room.lines[TIME_JUMP], room.flight.shape[1]
    row = room.read[kink * columns : (kink + 1) * columns]
    rate = row[0]
    for j in range(n):
        rate += row[1 + j] * rates[j]
    for k in range(columns):
        total = row[k] if k > n else 0.0
        for j in range(n):
            total += row[1 + j] * room.flight[j, k]
        time = -total / rate
        if known and abs(time - when[k]) > SAME_KINK_TIME * abs(when[k]):
            return False
        when[k] = time
    return True


# ---------------------------------------------------------------------------------------
# to the limit


def at_rest(
    p: Programs,
    at: int,
    s: Slopes,
    own: Ints,
    t: float,
    x: Floats,
    r: float,
    directions: Matrix,
    sums: Sums,
    room: Changes,
) -> bool:
    """``G(0)``: a speed of ``u`` is gone after ``2 u / (a (1 - r))``; and the flow at rest."""
    n, columns, turn = x.shape[0], room.before.shape[1], sums.lines[READ]
    drift, across, rest = room.lines[DRIFT], room.lines[GAP_GRADIENT], room.rest
    values(p, at + KICK, t, x, sums.sides, sums.c, sums.work, turn)
    fall = -turn[n + 1]
    if not fall > 0.0:
        return False
    lasts, resting = 2.0 / (fall * (1.0 - r)), own[REST_ROW] >= 0
    program = s.fields[own[REST_ROW], SLOPES_PROGRAM] if resting else own[SLOPES_PROGRAM]
    rates(s, program, t, x, room, drift)
    if not resting:
        for j in range(n):
            drift[j] += fall * turn[j]
    read(s, own[SPEED_SLOPES], t, x, room)
    for i in range(1 + n):
        gone = lasts if i == 0 else lasts * drift[i - 1] - turn[i - 1]
        for k in range(columns):
            rest[i, k] = gone * room.read[k] + (1.0 if i == k else 0.0)
    if own[ONTO] >= 0 and not onto_contacts(
        s, own[ONTO], own[HELD_COUNT], t, x, 1 + n, columns, rest, room
    ):
        return False
    values(s.programs, own[GRADIENT], t, x, room.sides, room.c, room.work, across)
    square = squared(across, n)
    for i in range(1 + n):
        share = 0.0
        for j in range(1, 1 + n):
            share += rest[i, j] * across[j]
        for k in range(columns):
            rest[i, k] -= share / square * across[k]
        directed(rest[i], x, directions, room.read)
    return True


def solved(degree: int, r: float, x: Floats, directions: Matrix, room: Changes) -> bool:
    """``G(1)``, from values at as many points as the degree."""
    small, lower, size = room.small, room.lower, 1 + x.shape[0]
    nodes(degree, small[LIMIT_POINTS])
    from_values(degree, small)
    for k in range(1, degree + 1):
        differences(degree, r, small[LIMIT_POINTS, k], small[LIMIT_BASIS])
        for j in range(degree + 1):
            total = 0.0
            for m in range(degree + 1):
                total += small[LIMIT_BASIS, m] * small[TO_SERIES + m, j]
            lower[k, j] = total
    return _by_states(degree, size, room) and _by_others(
        degree, size, width(x, directions, room), room
    )


def _by_states(degree: int, size: int, room: Changes) -> bool:
    """By time and state, for all points at once."""
    lower, equations, right = room.lower, room.equations, room.right
    for k in range(1, degree + 1):
        first = k * (MOST_POINTS // degree) * size
        for a in range(size):
            row = (k - 1) * size + a
            for j in range(1, degree + 1):
                share = lower[k, j] + (1.0 if j == k else 0.0)
                for b in range(size):
                    same = 1.0 if j == k and a == b else 0.0
                    equations[row, (j - 1) * size + b] = same - share * room.maps[first + b, a]
            for i in range(size):
                total = 0.0
                for b in range(size):
                    total += room.maps[first + b, a] * room.rest[i, b]
                right[row, i] = lower[k, 0] * total
    if not solve(equations, degree * size, right, size):
        return False
    for i in range(size):
        for b in range(size):
            room.now[i, b] = right[(degree - 1) * size + b, i]
    return True


def _by_others(degree: int, size: int, columns: int, room: Changes) -> bool:
    """By the parameters, or along directions, once it is known by states."""
    lower, shares, others = room.lower, room.shares, columns - size
    for k in range(1, degree + 1):
        first = k * (MOST_POINTS // degree) * size
        for j in range(1, degree + 1):
            room.equations[k - 1, j - 1] = -lower[k, j]
        for i in range(size):
            for c in range(others):
                shares[k - 1, i * others + c] = lower[k, 0] * room.rest[i, size + c]
            for b in range(size):
                there = lower[k, 0] * room.rest[i, b] + room.right[(k - 1) * size + b, i]
                for j in range(1, degree + 1):
                    there += lower[k, j] * room.right[(j - 1) * size + b, i]
                for c in range(others):
                    shares[k - 1, i * others + c] += there * room.maps[first + b, size + c]
    if others > 0 and not solve(room.equations, degree, shares, size * others):
        return False
    for i in range(size):
        for c in range(others):
            room.now[i, size + c] = shares[degree - 1, i * others + c]
    return True


def compared(x: Floats, directions: Matrix, incoming: Matrix, room: Changes) -> float:
    """What has changed: against the largest in time and state; for a parameter against its own, and
    what the largest makes of the change with which the sum begins."""
    size, columns, largest, worst = 1 + x.shape[0], width(x, directions, room), 1e-300, 0.0
    for i in range(size):
        for k in range(size):
            largest = max(largest, abs(room.now[i, k]))
    for k in range(columns):
        own, change = largest if k < size else 1e-300, 0.0
        for i in range(size):
            own = max(own, abs(room.now[i, k]))
            change = max(change, abs(room.now[i, k] - room.last[i, k]))
            if size <= k < size + incoming.shape[1]:
                own = max(own, largest * abs(incoming[i, k - size]))
        if not change <= worst * own:
            worst = change / own
    return worst if math.isfinite(worst) else math.inf


def at_limit(
    s: Slopes,
    own: Ints,
    t_inf: float,
    x_inf: Floats,
    directions: Matrix,
    room: Changes,
    out: Matrix,
) -> None:
    """From a change of time and state after the first impact to the moment of the limit, and to a
    change at equal times there."""
    n, found, drift = x_inf.shape[0], room.best, room.lines[DRIFT]
    size, law = 1 + n, room.lines[FLOW_HERE]
    values(s.programs, own[LAW_SLOPES], t_inf, x_inf, room.sides, room.c, room.work, law)
    directed(law, x_inf, directions, room.read)
    for k in range(width(x_inf, directions, room)):
        ratio = law[k] if k > n else 0.0
        for i in range(size):
            out[i, k] = found[i, k]
            ratio += law[i] * found[i, k]
        for i in range(1, size):
            moved = drift[i - 1] * found[0, k]
            least = DIFFERENCE_ROUNDING * (abs(found[i, k]) + abs(moved))
            later = found[i, k] - moved
            out[n + i, k] = later if abs(later) > least else 0.0
        out[2 * n + 1, k] = ratio
