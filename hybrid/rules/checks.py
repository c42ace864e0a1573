"""The series of a step compared with the flow, at two points of the way.

The last terms of a series say nothing about a force that is flat to rounding before it changes; the
flow itself does. It is evaluated on the polynomials. Its rounding is shown by a point beside them
and by its terms.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .jets import FLOW, KINKS, jets
from .kinks import (
    BAND,
    KINK_KIND,
    KINK_ROW,
    PART_ROW,
    POINT,
    STEP_KINK,
    WHOLE_ROW,
    count,
    states,
)
from .lengths import behind
from .polynomials import power_size, power_value, two_values
from .terms import TERMS_BESIDE, add_up, rounding_of
from .zeros import EPS

__all__ = ("arrives", "bends", "decided", "follows")

#: Where the series of a step is compared with the flow: inside, and at its end (at a kink just
#: before it); and the allowed difference, as a multiple of rounding.
HELD_INSIDE, HELD_BEFORE, MISSED = 0.55, 1.0 - 1e-9, 256.0

#: Roundings by which the elements of a state, and the time, are moved to measure rounding: by
#: different amounts, so that it shows in sums, differences, products and quotients of any two.
SHIFTS = (8, -13, 11, -16, 14, -19, 17)
SHIFT = -10

#: An element of the state counts as no smaller than this share of the largest.
SMALLEST = 1e-3

#: Safety factor for the rounding shown beside a point and by terms.
ROUNDING_BESIDE = 8.0

#: Denormal numbers lose digits; their error is less than this.
DENORMAL_LOSS = 1e-290


def follows(
    p: Programs,
    program: int,
    held: bool,
    t: float,
    h: float,
    crossed: int,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the polynomials of a step have the direction of the flow along it, up to rounding and
    the remainder of the series, and whether those of watched functions have their values.

    Parameters
    ----------
    held : bool
        Whether contacts are held, or the state slides on a surface. Forces then cancel and leave
        rounding that nothing here shows; they are taken to be at least of order one.
    crossed : int
        The kink at which the step ends; -1 if it ends at none.
    aside
        As many rows as ``c``, and four columns.
    work
        As in :func:`look`; before that are kept a point inside, and the rates of the polynomials
        there and at the end. A step that is accepted leaves its end there.
    """
    n, end = states(p, program), place(p, program, work)
    inside, last = HELD_INSIDE * h, h if crossed < 0 else short_of(p, program, crossed, t, h, c)
    scale, fastest = 0.0, 1.0 if held else 0.0
    for i in range(n):
        scale = max(scale, SMALLEST * abs(c[i, 0]))
        fastest = max(fastest, abs(c[i, 1]))
        there, slope, value, rate = two_values(c[i], inside, last)
        work[end - 3 * n + i], work[end - 2 * n + i] = there, slope
        work[end - n + i], work[end + i] = rate, value
    point, rates = work[end - 3 * n : end - 2 * n], work[end - 2 * n : end - n]
    if not _held(p, program, t, inside, h, scale, fastest, point, rates, sides, c, aside, work):
        return False
    point, rates = work[end : end + n], work[end - n : end]
    return _held(p, program, t, last, h, scale, fastest, point, rates, sides, c, aside, work)


def short_of(p: Programs, program: int, crossed: int, t: float, h: float, c: Matrix) -> float:
    """A place just before the kink at the end of a step, from where rounding does not hide on which
    side of it the state is; the place inside, if it hides that nearly everywhere."""
    kink = p.index[program, KINKS] + crossed
    series, order = c[p.kinks[kink, KINK_ROW]], c.shape[1] - 1
    size = power_size(series, 0, order, h) + abs(c[p.kinks[kink, PART_ROW], 0])
    _, rate = power_value(series, 0, order, h)
    hidden = MISSED * EPS * (size + abs(t * rate))
    if not hidden < (1.0 - HELD_INSIDE) * h * abs(rate):
        return HELD_INSIDE * h
    return min(HELD_BEFORE * h, h - hidden / abs(rate))


def _held(
    p: Programs,
    program: int,
    t: float,
    s: float,
    h: float,
    scale: float,
    fastest: float,
    point: Floats,
    rates: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether both hold at a point of the way, whose state and rates are given."""
    look(p, program, 0, t + s, point, False, sides, aside, work)
    _set_apart(p, program, aside)
    if _agrees(p, program, s, h, scale, fastest, rates, c, aside):
        return True
    add_up(p, program, 0, aside)
    look(p, program, 0, beside(t + s, point), point, False, sides, aside, work)
    along(c, s, point)
    return _agrees(p, program, s, h, scale, fastest, rates, c, aside)


def decided(
    p: Programs,
    program: int,
    t: float,
    h: float,
    kink: bool,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
    point: Floats,
) -> bool:
    """Whether the series of watched functions have their values along a polynomial of the state, up
    to rounding.

    Arguments as in :func:`follows`; ``point`` is room for a state.
    """
    for share in (HELD_INSIDE, HELD_BEFORE if kink else 1.0):
        s = share * h
        along(c, s, point)
        look(p, program, 0, t + s, point, False, sides, aside, work)
        _set_apart(p, program, aside)
        look(p, program, 0, beside(t + s, point), point, False, sides, aside, work)
        if not _decides(p, program, s, c, aside):
            return False
    return True


def bends(
    p: Programs,
    program: int,
    row: int,
    t: float,
    h: float,
    last: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the series of a gap, a row, has its second derivative along a step, up to rounding.

    The height of a low flight does not show it, being less than the rounding of the state; nor do
    the sides of kinks that are zero where the gap is (``|x|``). So the sides of the step are used
    and, where it ends at a kink or an impact, a point just before its end. That is the ``last`` of
    the two that are looked at. ``aside`` has four columns.
    """
    first = place(p, program, work)
    point = work[first : first + states(p, program)]
    for s in (HELD_INSIDE * h, last):
        along(c, s, point)
        look(p, program, 2, t + s, point, True, sides, aside, work)
        here = 2.0 * aside[row, 2]
        bend, size = second(c[row], s)
        off, allowed = abs(here - bend), MISSED * EPS * size
        if off > allowed:
            add_up(p, program, 2, aside)
            look(p, program, 2, beside(t + s, point), point, True, sides, aside, work)
            shown = abs(here - 2.0 * aside[row, 2]) + 2.0 * rounding_of(aside, row)
            if off > allowed + ROUNDING_BESIDE * shown:
                return False
    return True


def arrives(
    p: Programs,
    program: int,
    t: float,
    h: float,
    seen: bool,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
    end: Floats,
) -> bool:
    """Write the state at the end of a step into ``end``; returns whether the flow is finite there.

    With ``seen`` it is the state that :func:`follows` has left in ``work``, with the flow in the
    second column.
    """
    first = place(p, program, work)
    point = work[first : first + states(p, program)]
    if not seen:
        along(c, h, point)
        look(p, program, 0, t + h, point, False, sides, aside, work)
    finite = True
    for i in range(point.shape[0]):
        end[i] = point[i]
        finite = finite and math.isfinite(rate_of(p, program, i, aside, 1 if seen else 0))
    return finite


def place(p: Programs, program: int, work: Floats) -> int:
    """The place of a state in ``work``: at its end, before the sides of kinks."""
    return work.shape[0] - count(p, program) - states(p, program)


def along(c: Matrix, s: float, point: Floats) -> None:
    """The state on a step."""
    for i in range(point.shape[0]):
        point[i], _ = power_value(c[i], 0, c.shape[1] - 1, s)


def beside(t: float, point: Floats) -> float:
    """Move a state, each element by another amount, and a time by a few roundings: what changes by
    that is not known more accurately."""
    for i in range(point.shape[0]):
        point[i] *= 1.0 + SHIFTS[i % 7] * EPS
    return t * (1.0 + SHIFT * EPS)


def led(
    p: Programs,
    program: int,
    t: float,
    x: Floats,
    later: float,
    point: Floats,
    sides: Ints,
    aside: Matrix,
    work: Floats,
) -> None:
    """Write into ``point`` where the flow leads from ``(t, x)`` in a time of the size of rounding.
    What has no rate there stays."""
    for i in range(x.shape[0]):
        point[i] = x[i]
    look(p, program, 0, t, point, False, sides, aside, work)
    for i in range(x.shape[0]):
        moved = later * rate_of(p, program, i, aside, 0)
        point[i] += moved if math.isfinite(moved) else 0.0


def look(
    p: Programs,
    program: int,
    order: int,
    t: float,
    point: Floats,
    known: bool,
    sides: Ints,
    aside: Matrix,
    work: Floats,
) -> None:
    """Compute the first coefficients of all rows at a point, on the sides of kinks that their
    values show, or with ``known`` on those of the step.

    The latter are kept meanwhile at the end of ``work``, behind the room for equations, which has a
    place for each element of the state and each kink.
    """
    first = work.shape[0] - count(p, program)
    for i in range(count(p, program)):
        work[first + i] = sides[i]
        sides[i] = sides[i] if known else 0
    jets(p, program, order, t, point, sides, aside, work)
    for i in range(count(p, program)):
        sides[i] = int(work[first + i])


def _set_apart(p: Programs, program: int, aside: Matrix) -> None:
    """Copy the flow and the watched functions to the second column, as the first is overwritten;
    nothing is known yet of the flow's terms."""
    for j in range(p.index[program, FLOW], p.index[program, FLOW + 1]):
        row = p.flow[j]
        if row >= 0:
            aside[row, 1], aside[row, TERMS_BESIDE] = aside[row, 0], 0.0
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        row = p.kinks[j, WHOLE_ROW]
        aside[row, 1] = aside[row, 0]


def rate_of(p: Programs, program: int, i: int, aside: Matrix, column: int) -> float:
    """The flow of an element of the state: the value of a row, or a number."""
    row = p.flow[p.index[program, FLOW] + i]
    return aside[row, column] if row >= 0 else p.numbers[-1 - row]


def _agrees(
    p: Programs,
    program: int,
    s: float,
    h: float,
    scale: float,
    fastest: float,
    rates: Floats,
    c: Matrix,
    aside: Matrix,
) -> bool:
    """Whether both hold; the rounding that is shown is 0 until the point beside is evaluated."""
    if not _directs(p, program, s, h, scale, fastest, rates, c, aside):
        return False
    return _decides(p, program, s, c, aside)


def _directs(
    p: Programs,
    program: int,
    s: float,
    h: float,
    scale: float,
    fastest: float,
    rates: Floats,
    c: Matrix,
    aside: Matrix,
) -> bool:
    """Whether the polynomials of the state have the direction of the flow. If that is not finite,
    it is reported when the step ends there."""
    finite = True
    close = True
    for i in range(states(p, program)):
        rate, other = rate_of(p, program, i, aside, 1), rate_of(p, program, i, aside, 0)
        finite = finite and math.isfinite(rate) and math.isfinite(other)
        if abs(rate - rates[i]) <= MISSED * EPS * fastest:
            continue  # what follows allows more
        rounding = fastest + abs(2.0 * c[i, 2] * s) + abs(3.0 * c[i, 3] * s * s)
        rounding += max(abs(c[i, 0]), scale) / h
        left = (c.shape[1] - 1) * behind(c[i], s) / s  # of the slope, as of its last terms
        row = p.flow[p.index[program, FLOW] + i]
        shown = abs(rate - other) + (rounding_of(aside, row) if row >= 0 else 0.0)
        allowed = max(MISSED * EPS * rounding, left) + ROUNDING_BESIDE * shown + DENORMAL_LOSS
        close = close and not abs(rate - rates[i]) > allowed
    return close or not finite


def _decides(p: Programs, program: int, s: float, c: Matrix, aside: Matrix) -> bool:
    """Whether the series of watched functions have their values, up to rounding: of an argument in
    a band no less than that of 1, over which the function changes (``exp(a)`` by ``exp(1)``)."""
    order = c.shape[1] - 1
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        if p.kinks[j, KINK_KIND] == POINT:
            continue
        series = c[p.kinks[j, KINK_ROW]]
        value, other = aside[p.kinks[j, WHOLE_ROW], 1], aside[p.kinks[j, WHOLE_ROW], 0]
        off = abs(value - power_value(series, 0, order, s)[0])
        size, part = power_size(series, 0, order, s), abs(aside[p.kinks[j, PART_ROW], 0])
        size = size + part if part < math.inf else size
        if p.kinks[j, KINK_KIND] == BAND:
            size = max(size, 1.0)
        if p.kinks[j, KINK_KIND] == STEP_KINK:
            size += abs(value)
            off = min(off % 1.0, 1.0 - off % 1.0)  # from the nearest whole number
        if off > MISSED * EPS * size + ROUNDING_BESIDE * (abs(value - other) + behind(series, s)):
            return False
    return True


def second(c: Floats, s: float) -> tuple[float, float]:
    """The second derivative of a series, and the sum of the sizes of its terms."""
    value = 0.0
    size = 0.0
    for k in range(c.shape[0] - 1, 1, -1):
        value = value * s + k * (k - 1) * c[k]
        size = size * s + abs(k * (k - 1) * c[k])
    return value, size
