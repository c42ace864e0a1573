"""One flight between two impacts of a contact, from Taylor series.

The gap is carried as a coordinate of its own: it starts at exactly zero with the speed
that the impact gave it, and only its higher coefficients come from the state. So a flight
of height 1e-18 over a wall at 2 is as accurate as any other (``docs/notes/chatter.md``).
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs, Sums
from .checks import HELD_BEFORE, bends, follows, look, short_of
from .jets import KINKS, OUTPUT
from .kinks import (
    KINK_KIND,
    KINK_ROW,
    NOT_FINITE,
    POINT,
    ZERO_SPACINGS,
    count,
    expanded,
    first_change,
    holding,
    kink_row,
    states,
    turn,
)
from .lengths import CONVERGED, behind, held_length, min_own_length, own_length, zero_of
from .polynomials import power_value
from .weak import few_terms, steady
from .zeros import EPS, outweighs, soon
from .zeros import series as zeros

__all__ = ("fly",)

#: Most Taylor steps in a flight (kinks apart, each of which may be crossed twice); a longer flight
#: belongs to the solver. Over a wall that shakes a step is a tenth of a turn, and low flights last
#: a few turns.
FLIGHT_STEPS = 32

#: Status codes besides those of :mod:`.kinks`: a step has no length, or no end; its series is not
#: that of the flow, or of the gap; the flight is too long; the gap does not fall where it is zero;
#: another guard may be zero on the way.
NO_LENGTH, OFF_SERIES, TOO_LONG, GAP_RISES, REACHED = -3, -4, -5, -6, -7

#: A piece at whose end the gap is zero.
ENDS_AT_ZERO = 1


def fly(
    p: Programs,
    program: int,
    column: int,
    held: bool,
    t: float,
    x: Floats,
    v: float,
    c: Matrix,
    series: Matrix,
    signs: Ints,
    rounding: float,
    terms: float,
    room: Sums,
) -> tuple[int, float, float, int, int]:
    """The flight that leaves a contact with gap speed ``v > 0``.

    Parameters
    ----------
    column : int
        The place of the gap among the program's outputs.
    held : bool
        As :func:`.checks.follows` takes it.
    c
        Gets the series of a piece; its columns say of what order they are.
    series
        Gets those of the state in all pieces, a row for each element, unless there are no rows.
    signs, rounding
        For each guard the sign that it must have on the way, 0 where it is that which it has at the
        start, which is put down; and nearer to zero than rounding none may come. With no signs
        guards are not looked at.
    terms
        To what share of a state, and of the gap, the last terms of its series fall in a piece.
    room
        ``starts`` and ``lengths`` get when each piece begins, from 0, and how long it is:
        :func:`most_pieces` says how many there may be. ``branch`` gets the sign of each kink where
        the flight begins (0 of a point, which is not watched), and the kinks that it crosses, in
        order: a place for each kink and each piece. ``end`` gets the state at the end.

    Returns
    -------
    status, time, speed, pieces, crossed
        0, or below zero where a few series do not reach the end: the flight is long against the
        time in which the forces or the gap change, and belongs to the solver. How long it takes,
        the gap speed at its end, and how many pieces there are and kinks that it crosses.
    """
    time, gap, speed = 0.0, 0.0, v
    crossings, kinks, end, sides = 0, count(p, program), room.end, room.sides
    most = min(most_pieces(kinks), room.starts.shape[0], room.branch.shape[0] - kinks)
    for i in range(x.shape[0]):
        end[i] = x[i]
    for i in range(kinks):
        sides[i] = 0
    for piece in range(most):
        status = expanded(p, program, t + time, end, sides, c, room.work)
        known = status
        if known < 0 and not few_terms(p, program, t + time, end, sides, c, room.work):
            return status, time, speed, piece, crossings
        if piece == 0:
            _begin(p, program, sides, c, room.branch)
        longest = _converged(p, program, signs, c)
        status, h, crossed, gap, speed = _piece(
            p, program, column, held, t + time, gap, speed, longest, terms, c, room
        )
        if known < 0 and not (
            status >= 0 and steady(p, program, t + time, h, sides, c, room.aside, room.work)
        ):
            status = known
        if status >= 0 and not _apart(p, program, column, h, rounding, signs, c, room):
            status = REACHED
        if status < 0:
            return status, time, speed, piece, crossings
        _keep(piece, time, h, c, series, room)
        time += h
        if status == ENDS_AT_ZERO:
            return 0 if speed < 0.0 else GAP_RISES, time, speed, piece + 1, crossings
        if crossed >= 0:
            room.branch[kinks + crossings] = crossed
            crossings += 1
        turn(p, program, crossed, t + time - h, h, c, sides)
        if crossed >= 0 and not _gap_goes_on(p, program, column, crossed, t + time, room):
            return OFF_SERIES, time, speed, piece + 1, crossings
    return TOO_LONG, time, speed, most, crossings


def _gap_goes_on(
    p: Programs, program: int, column: int, crossed: int, t: float, room: Sums
) -> bool:
    """Whether a gap and its speed go on where a flight has crossed a kink. If not, as where a floor
    begins to rise, they are no more what the flight has made of those with which it began.

    The formulas before and behind the kink may differ by what they change in the time by which
    rounding has put the state beside it.
    """
    row, kink = p.output[p.index[program, OUTPUT] + column], kink_row(p, program, crossed)
    sides, aside = room.sides, room.aside
    side = sides[crossed]
    sides[crossed] = -side
    look(p, program, 2, t, room.end, True, sides, aside, room.work)
    gap, speed, bend = aside[row, 0], aside[row, 1], aside[row, 2]
    sides[crossed] = side
    look(p, program, 2, t, room.end, True, sides, aside, room.work)
    off, rate = abs(aside[kink, 0]), abs(aside[kink, 1])
    late = ZERO_SPACINGS * EPS * abs(t) + (2.0 * off / rate if rate > 0.0 else 0.0)
    turned, bent = abs(aside[row, 1] - speed), 2.0 * abs(aside[row, 2] - bend)
    return turned <= late * bent and abs(aside[row, 0] - gap) <= late * (turned + late * bent)


def most_pieces(kinks: int) -> int:
    """How many pieces a flight may have."""
    return FLIGHT_STEPS + 2 * kinks + 1


def _begin(p: Programs, program: int, sides: Ints, c: Matrix, branch: Ints) -> None:
    """On which sides of its kinks a flight begins."""
    first = p.index[program, KINKS]
    for i in range(count(p, program)):
        own = sides[i] if sides[i] != 0 else c[p.kinks[first + i, KINK_ROW], 0]
        branch[i] = 1 if own > 0 else -1
        if p.kinks[first + i, KINK_KIND] == POINT:
            branch[i] = 0


def _converged(p: Programs, program: int, signs: Ints, c: Matrix) -> float:
    """How far the series of other guards have converged."""
    first, length = p.index[program, OUTPUT], math.inf
    for g in range(signs.shape[0]):
        if p.affine[first + g] == 0:
            length = min(length, own_length(c[p.output[first + g]], CONVERGED))
    return length


def _apart(
    p: Programs,
    program: int,
    column: int,
    h: float,
    rounding: float,
    signs: Ints,
    c: Matrix,
    room: Sums,
) -> bool:
    """Whether all guards but one keep their signs on a piece, and stay away from zero."""
    first = p.index[program, OUTPUT]
    for g in range(signs.shape[0]):
        if g != column:
            own = c[p.output[first + g]]
            if signs[g] == 0:
                signs[g] = 1 if own[0] > 0.0 else -1
            if not (own[0] * signs[g] > 0.0 and _keeps_off(own, h, rounding, room)):
                return False
    return True


def _keeps_off(c: Floats, h: float, rounding: float, room: Sums) -> bool:
    """Whether a series, and what it leaves open, is further from zero than rounding."""
    order, noise = c.shape[0] - 1, rounding + behind(c, h)
    if outweighs(c, 0, order, h, noise):
        return True
    end, _ = power_value(c, 0, order, h)
    away = abs(c[0]) > noise and abs(end) > noise and end * c[0] > 0.0
    return away and zeros(c, order, h, 0, noise, room.rows, room.found) == 0


def _piece(
    p: Programs,
    program: int,
    column: int,
    held: bool,
    t: float,
    gap: float,
    speed: float,
    most: float,
    terms: float,
    c: Matrix,
    room: Sums,
) -> tuple[int, float, int, float, float]:
    """A step of a flight, no longer than ``most``: its status, how long it is, the kink that ends
    it, and the gap and its speed there."""
    place, sides, aside = p.index[program, OUTPUT] + column, room.sides, room.aside
    row = p.output[place]
    reach, zero = _reach(p, program, row, gap, speed, terms, c, room)
    h = min(reach, zero, most)
    if not 0.0 < h < math.inf:
        return NO_LENGTH, h, -1, gap, speed
    h, crossed = first_change(p, program, t, h, sides, c, room.rows, room.found)
    if math.isnan(h):
        return NOT_FINITE, h, -1, gap, speed
    kink = crossed >= 0
    if not follows(p, program, held, t, h, crossed, sides, c, aside, room.work):
        return OFF_SERIES, h, -1, gap, speed
    lands = h == zero
    last = short_of(p, program, crossed, t, h, c) if kink else HELD_BEFORE * h if lands else h
    of_states = p.affine[place] == 1  # its series is theirs
    if not (of_states or bends(p, program, row, t, h, last, sides, c, aside, room.work)):
        return OFF_SERIES, h, -1, gap, speed
    rest, slope = power_value(c[row], 2, c.shape[1] - 1, h)
    gap += (speed + rest * h) * h
    speed += (2.0 * rest + slope * h) * h
    return ENDS_AT_ZERO if lands else 0, h, crossed, gap, speed


def _reach(
    p: Programs,
    program: int,
    row: int,
    gap: float,
    speed: float,
    terms: float,
    c: Matrix,
    room: Sums,
) -> tuple[float, float]:
    """How far the series hold, no further than to the zero that is found there: the first of the
    gap, as a coordinate of its own."""
    height, rate = c[row, 0], c[row, 1]  # of an element of the state, it may be
    order, low, zero = c.shape[1] - 1, 1 if gap == 0.0 else 0, math.inf
    c[row, 0], c[row, 1] = gap, speed
    if c[row, low] > 0.0 and count(p, program) == 0:
        zero = soon(c[row], low, order, math.inf)
    c[row, 0], c[row, 1] = height, rate
    reach = min(held_length(c, states(p, program), terms, zero), holding(p, program, c))
    c[row, 0], c[row, 1] = gap, speed
    reach = min_own_length(c[row], terms, reach)
    if zero == math.inf:
        zero = zero_of(c[row], reach, room.rows, room.found)
    elif reach < zero:
        zero = math.inf
    c[row, 0], c[row, 1] = height, rate
    return reach, zero


def _keep(piece: int, time: float, h: float, c: Matrix, series: Matrix, room: Sums) -> None:
    """Put down a piece, and the state at its end."""
    room.starts[piece], room.lengths[piece] = time, h
    n = room.end.shape[0]
    for i in range(n):
        room.end[i], _ = power_value(c[i], 0, c.shape[1] - 1, h)
        for k in range(series.shape[1] if series.shape[0] > 0 else 0):
            series[piece * n + i, k] = c[i, k] if k < c.shape[1] else 0.0
