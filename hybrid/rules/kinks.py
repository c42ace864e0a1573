"""How far the series of a step are valid, where the flow may change its formula.

A kink is a function with its own series, at whose zero another formula begins. Its zeros are
counted like those of a guard, within the length over which its series has converged. If rounding
hides or blurs a zero seen from afar, at the edges of a thin zone, the step goes part of the way and
looks again from nearby.

A function that is flat to rounding (``exp`` of a large negative number) does not show the pulse
that its argument leads to. Its argument is therefore watched like a kink while the function is
flat, and may change only a little per step while it is not. A denominator may change by no more
than its own size: there is then no pole within the step, nor near it in the complex plane, where a
quotient is a pulse.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .jets import FLOW, KINKS, jets, missing
from .lengths import CONVERGED, behind, own_length
from .polynomials import power_size, power_value
from .zeros import EPS, VANISHES, series

__all__ = ("expanded", "first_change", "holding", "in_bands", "kink_row", "turn")

#: Product and sum are never fused, so that plain Python passes a kink at the same place.
EXACT = True

#: Kinds of watched functions (:data:`hybrid.lowering.tape.KINDS`). A point is not watched along a
#: flow.
STEP_KINK, BAND, POLE, POINT = 1, 2, 3, 4

#: Within this share of the time from a kink, rounding decides the side of the kink.
SIDE_BLUR = 32.0 * EPS

#: Columns of the table of kinks: the watched row; whether the formula changes at its zero; its
#: kind; the row of the function itself, from which for a step function the nearest whole number is
#: subtracted; and the row of a part of it, to whose rounding it is known.
KINK_ROW, SWITCHES, KINK_KIND, WHOLE_ROW, PART_ROW = 0, 1, 2, 3, 4

#: Status codes: there are no series, or they are not finite.
NO_SERIES, NOT_FINITE = -1, -2

#: Largest change per step of the argument of a step function, as a share of the way to the whole
#: number behind the nearest, which is never reached unseen; and of ``exp``, as a share of the
#: order: up to the order the last terms of its series outweigh those that follow, and half of it
#: leaves room for a square.
STEP_CHANGE, EXP_CHANGE = 0.9, 0.5

#: Largest change per step of the argument of such a function whose derivatives are sought: at the
#: edge of the zone ``1 - tanh(a)**2`` is rounding alone, and so is its series, of what grows there
#: by ``exp(2 a)``: by 400, to 1e-13.
DERIVED_CHANGE = 3.0

#: Rounding of a kink's polynomial in Bernstein form, as a multiple of the sum of its terms: as many
#: roundings as its highest degree.
KINK_BLUR = 24.0 * EPS

#: Share of the way to a blurred zero that is gone before looking again.
APPROACH = 0.9

#: Share of the way to a zero on which hidden zeros are looked for.
SHORT_OF_ZERO = 0.999

#: A zero is as accurate as the time if its error is within so many roundings of the time.
ZERO_SPACINGS = 16.0

#: Where rounding hides whether a function that comes near zero crosses it, the hidden part is
#: shorter than 1e-7 of the way there; within this share of the time nothing of it is left.
HIDDEN = 1e-9


def states(p: Programs, program: int) -> int:
    """The number of state elements of a program."""
    return p.index[program, FLOW + 1] - p.index[program, FLOW]


def count(p: Programs, program: int) -> int:
    """The number of kinks of a program, including points."""
    return p.index[program, KINKS + 1] - p.index[program, KINKS]


def expanded(
    p: Programs, program: int, t: float, x: Floats, sides: Ints, c: Matrix, work: Floats
) -> int:
    """Compute the series from ``(t, x)``, with as many coefficients as ``c`` has columns; returns 0
    or a status code.

    In a branch that is not taken nothing happens: a watched function that is not a number there
    counts as constant. ``sides`` and ``work`` are as in :func:`.jets.jets`.
    """
    order = c.shape[1] - 1
    first = p.index[program, KINKS]
    for i in range(count(p, program)):
        if p.kinks[first + i, KINK_KIND] == POINT:
            sides[i] = 0
    if jets(p, program, order, t, x, sides, c, work) < 0:
        return NO_SERIES
    for i in range(x.shape[0]):
        if not (math.isfinite(c[i, 0]) and math.isfinite(c[i, order])):  # so are those between
            return NOT_FINITE
    for j in range(first, p.index[program, KINKS + 1]):
        if p.kinks[j, KINK_KIND] != POINT:
            _let_stand(c, p.kinks[j, KINK_ROW], order)
    return 0


def _let_stand(c: Matrix, row: int, order: int) -> None:
    """Replace a series with a missing coefficient by that of the constant 1."""
    if missing(c, row, order):
        for k in range(order + 1):
            c[row, k] = 1.0 if k == 0 else 0.0


def holding(p: Programs, program: int, c: Matrix) -> float:
    """Length over which the series of watched functions have converged and change little."""
    change = EXP_CHANGE * (c.shape[1] - 1)
    length = math.inf
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        kind, row = p.kinks[j, KINK_KIND], p.kinks[j, KINK_ROW]
        most = math.inf
        if kind == STEP_KINK:
            most = STEP_CHANGE * (1.0 - abs(c[row, 0]))
        elif kind == POLE:
            most = abs(c[row, 0])
        elif kind == BAND and p.bands[j, 0] - change < c[row, 0] < p.bands[j, 1] + change:
            most = change
        if kind != POINT:
            length = min(length, own_length(c[row], CONVERGED))
        if most < math.inf:
            length = _changing(c[row], length, most)
    return length


def in_bands(p: Programs, program: int, h: float, c: Matrix) -> float:
    """The given length, or a shorter one on which functions that are not flat change little, and
    to the end of which the arguments of those that are have not come where they are not."""
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        if p.kinks[j, KINK_KIND] == BAND:
            series = c[p.kinks[j, KINK_ROW]]
            off = max(p.bands[j, 0] - series[0], series[0] - p.bands[j, 1])
            h = _changing(series, h, max(APPROACH * off, DERIVED_CHANGE))
    return h


def _changing(c: Floats, length: float, most: float) -> float:
    """The given length, or the shorter one in which a series changes by ``most`` at most."""
    order = c.shape[0] - 1
    for k in range(1, order + 1):
        if c[k] != 0.0:
            length = min(length, (most / abs(c[k])) ** (1.0 / k))
    while power_size(c, 1, order, length) > most:
        length *= 0.9
    return length


def first_change(
    p: Programs,
    program: int,
    t: float,
    h: float,
    sides: Ints,
    c: Matrix,
    rows: Matrix,
    found: Matrix,
) -> tuple[float, int]:
    """How far a step may go with the formula with which it begins, and the kink that ends it.

    The kink is -1 if none is reached, though one may be near. A zero beyond the end that the time
    does not tell from it is at the end. The length is NaN if a watched series is not finite, and 0
    where the flow beyond a kink leads back to it.
    """
    chosen, blur = -1, min(ZERO_SPACINGS * EPS * max(abs(t), h), h)  # series reach no further
    first = p.index[program, KINKS]
    for i in range(count(p, program)):
        row = p.kinks[first + i, KINK_ROW]
        start = c[row, 0]
        level = _level(p, first + i, start, EXP_CHANGE * (c.shape[1] - 1))
        if not math.isnan(level):
            if sides[i] != 0 and _leads_back(c[row], sides[i], t, h):
                return 0.0, -1
            c[row, 0] = start - level
            begin = 1 if sides[i] != 0 else 0
            zero, reached = _first_zero(c[row, begin:], t, h + blur, sides[i], rows, found)
            c[row, 0] = start
            if math.isnan(zero):
                return math.nan, -1
            ends = reached and p.kinks[first + i, SWITCHES] == 1
            if zero < h or (ends and chosen < 0 and zero <= h + blur):
                h, chosen = min(h, zero), i if ends else -1
    return h, chosen


def _leads_back(c: Floats, side: int, t: float, h: float) -> bool:
    """Whether a function that has just crossed zero to one side goes to the other, by more than
    rounding of its terms and of the time: it may come again to the side to which it has crossed."""
    if not side * c[1] < 0.0:
        return False
    order, least = c.shape[0] - 1, ZERO_SPACINGS * EPS * abs(t)
    s = h
    while s > least:
        rise, _ = power_value(c, 1, order, s)
        noise = KINK_BLUR * power_size(c, 1, order, s) + abs(c[1]) * least + 2.0 * abs(c[0])
        if side * rise < -noise:
            return True
        s *= 0.5
    return False


def _level(p: Programs, kink: int, value: float, change: float) -> float:
    """The value at which a watched function changes the formula; NaN if it is not ahead."""
    kind = p.kinks[kink, KINK_KIND]
    if kind in (POLE, POINT):
        return math.nan
    if kind != BAND:
        return 0.0
    if value <= p.bands[kink, 0] - change:
        return p.bands[kink, 0]
    return p.bands[kink, 1] if value >= p.bands[kink, 1] + change else math.nan


def _first_zero(
    c: Floats, t: float, h: float, side: int, rows: Matrix, found: Matrix
) -> tuple[float, bool]:
    """The first zero of a series in ``(0, h]`` at which it changes sign, and whether it is one.

    If ``side`` is known, a zero at 0 has been divided out. Infinity if there is no zero; with
    False, a point on the way to a zero that rounding hides or blurs.
    """
    order = c.shape[0] - 1
    rest = power_size(c, 1, order, h)
    if abs(c[0]) > rest * (1.0 + KINK_BLUR) + behind(c, h) or rest == 0.0:
        return math.inf, False
    own = side if side != 0 else 1 if c[0] > 0.0 else -1
    listed = _zeros(c, own, h, rows, found)
    crossing = _crossing(listed, found, own)
    if crossing < math.inf and own * c[0] > 0.0:
        listed = _zeros(c, own, SHORT_OF_ZERO * crossing, rows, found)
    if listed < 0:
        return math.nan, False
    hidden = _hidden(listed, found, own, t, crossing)
    if hidden == math.inf:
        return math.inf, False
    if hidden != crossing or not (_close(crossing, t) or _exact(c, t, crossing)):
        return APPROACH * hidden, False
    return crossing, True


def _zeros(c: Floats, own: int, h: float, rows: Matrix, found: Matrix) -> int:
    """List the zeros of a series in ``(0, h]``, including places so near zero that rounding hides
    the sign; returns their number or a status code."""
    order = c.shape[0] - 1
    noise = KINK_BLUR * power_size(c, 0, order, h) + behind(c, h)
    listed = series(c, order, h, 0, noise, rows, found)
    return 0 if listed == VANISHES else listed


def _crossing(listed: int, found: Matrix, own: int) -> float:
    """The first listed zero at which a series changes sign; infinity if there is none."""
    for k in range(listed):
        if own * found[k, 1] < 0.0:
            return found[k, 0]
    return math.inf


def _hidden(listed: int, found: Matrix, own: int, t: float, crossing: float) -> float:
    """The first listed zero near which something may be hidden, or the crossing."""
    for k in range(listed):
        if own * found[k, 1] <= 0.0 and not _close(found[k, 0], t):
            return found[k, 0]
    return crossing


def _close(s: float, t: float) -> bool:
    """Whether a distance of time is so short that nothing is hidden within it."""
    return (1.0 - APPROACH) * s <= HIDDEN * max(abs(t), s)


def _exact(c: Floats, t: float, s: float) -> bool:
    """Whether a zero is known as accurately as the time."""
    order = c.shape[0] - 1
    _, slope = power_value(c, 0, order, s)
    off = EPS * power_size(c, 0, order, s) + behind(c, s)
    return off <= ZERO_SPACINGS * EPS * max(abs(t), s) * abs(slope)


def kink_row(p: Programs, program: int, kink: int) -> int:
    """The row of the function of a kink."""
    return p.kinks[p.index[program, KINKS] + kink, KINK_ROW]


def crossed_to(c: Matrix, row: int, side: int) -> int:
    """The side of a kink after a zero at which it changes sign."""
    if side != 0:
        return -side
    return -1 if c[row, 0] > 0.0 else 1


def turn(
    p: Programs, program: int, crossed: int, t: float, h: float, c: Matrix, sides: Ints
) -> int:
    """Set the sides for what follows a step of length ``h`` from ``t`` that ended on a kink (-1: on
    none). After one within rounding of the time, those of kinks passed just before are still
    known."""
    side = 0
    if crossed >= 0:
        side = crossed_to(c, kink_row(p, program, crossed), sides[crossed])
    for i in range(sides.shape[0]):
        if i == crossed:
            sides[i] = side
        elif h > SIDE_BLUR * abs(t):
            sides[i] = 0
    return side
