"""The series of a step held against the flow, at two points of the way.

The last terms of a series say nothing of a force that is flat to rounding before it changes: the
flow itself does. It is read where the polynomials lead, and beside, which shows what rounding
makes of it.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .jets import FLOW, KINKS, jets
from .kinks import KINK_KIND, KINK_ROW, POINT, STEP_KINK, WHOLE_ROW, count, states
from .lengths import behind
from .polynomials import power_size, power_value, two_values
from .zeros import EPS

__all__ = ("arrives", "bends", "decided", "follows")

#: Where, besides its end, the series of a step is held against the flow (at a kink just before
#: that), and how far it may be off, as a multiple of rounding.
HELD_INSIDE, HELD_BEFORE, MISSED = 0.55, 1.0 - 1e-9, 256.0

#: Roundings by which elements of a state are moved to see what rounding does, and the time.
SHIFTS = (8, -8, 11, -11, 14, -14)
SHIFT = 8

#: An element of the state counts as no smaller than this share of the largest.
SMALLEST = 1e-3

#: What rounding shows beside a point, counted so many times: it may be more elsewhere.
ROUNDING_BESIDE = 8.0

#: Numbers next to the smallest lose digits; what they may be off is less than this.
DENORMAL_LOSS = 1e-290


def follows(
    p: Programs,
    program: int,
    held: bool,
    t: float,
    h: float,
    kink: bool,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the polynomials of a step have the flow's direction along it, but for rounding and
    what their last terms leave open, and those of what is watched are its values.

    Parameters
    ----------
    held : bool
        Contacts are held, or the state slides on a surface. There forces cancel, and leave rounding
        of the size of nothing that is seen here: they are taken to be of the order of one at least.
    kink : bool
        The step ends at a kink.
    aside
        As many rows as ``c``, and two columns.
    work
        As :func:`look` takes it; before that a point inside, and the rates of the polynomials
        there and at the end, are put aside. A step that holds leaves its end there.
    """
    n, end = states(p, program), place(p, program, work)
    inside, last = HELD_INSIDE * h, HELD_BEFORE * h if kink else h
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
    """Whether the series of what is watched have their values along a polynomial of the state, but
    for rounding. Arguments as :func:`follows` takes them; ``point`` gets a state."""
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
    ends: bool,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the series of a gap, a row, has its second derivative along a step, but for rounding.

    The height of a low flight says nothing of it: that is less than the rounding of the state. So
    do the sides of kinks that are zero where the gap is (``|x|``): those of the step are taken, and
    with ``ends``, which says that it ends at a kink or an impact, a point just before that.
    ``aside`` has three columns.
    """
    first = place(p, program, work)
    point = work[first : first + states(p, program)]
    for share in (HELD_INSIDE, HELD_BEFORE if ends else 1.0):
        s = share * h
        along(c, s, point)
        look(p, program, 2, t + s, point, True, sides, aside, work)
        here = 2.0 * aside[row, 2]
        look(p, program, 2, beside(t + s, point), point, True, sides, aside, work)
        bend, size = second(c[row], s)
        allowed = MISSED * EPS * size + ROUNDING_BESIDE * abs(here - 2.0 * aside[row, 2])
        if abs(here - bend) > allowed:
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
    """Put the state at the end of a step into ``end``; whether the flow is finite there.

    With ``seen`` that is what :func:`follows` has left in ``work``, and the flow in the second
    column.
    """
    first = place(p, program, work)
    point = work[first : first + states(p, program)]
    if not seen:
        along(c, h, point)
        look(p, program, 0, t + h, point, False, sides, aside, work)
    finite = True
    for i in range(point.shape[0]):
        end[i] = point[i]
        finite = finite and math.isfinite(_rate(p, program, i, aside, 1 if seen else 0))
    return finite


def place(p: Programs, program: int, work: Floats) -> int:
    """Where a state has its place in ``work``: at the end, before the sides of kinks."""
    return work.shape[0] - count(p, program) - states(p, program)


def along(c: Matrix, s: float, point: Floats) -> None:
    """The state on a step."""
    for i in range(point.shape[0]):
        point[i], _ = power_value(c[i], 0, c.shape[1] - 1, s)


def beside(t: float, point: Floats) -> float:
    """Move a state to another next to it, no two elements alike, and a time: what changes there by
    rounding is not known better."""
    for i in range(point.shape[0]):
        point[i] *= 1.0 + SHIFTS[i % 6] * EPS
    return t * (1.0 + SHIFT * EPS)


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
    """The first coefficients of all rows at a point, on the sides of kinks that values tell, or
    where ``known`` on those of the step.

    The latter are put aside meanwhile: into ``work``, whose end, behind the room for equations, has
    a place for each element of the state and for each kink.
    """
    first = work.shape[0] - count(p, program)
    for i in range(count(p, program)):
        work[first + i] = sides[i]
        sides[i] = sides[i] if known else 0
    jets(p, program, order, t, point, sides, aside, work)
    for i in range(count(p, program)):
        sides[i] = int(work[first + i])


def _set_apart(p: Programs, program: int, aside: Matrix) -> None:
    """Keep the flow, and what is watched, in the second column: the first is written again."""
    for j in range(p.index[program, FLOW], p.index[program, FLOW + 1]):
        row = p.flow[j]
        if row >= 0:
            aside[row, 1] = aside[row, 0]
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        row = p.kinks[j, WHOLE_ROW]
        aside[row, 1] = aside[row, 0]


def _rate(p: Programs, program: int, i: int, aside: Matrix, column: int) -> float:
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
    """Whether both hold; what rounding shows beside the point is nothing before that is read."""
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
    """Whether the polynomials of the state have the flow's direction; where that is not finite it
    is said when the step ends there."""
    finite = True
    close = True
    for i in range(states(p, program)):
        rate, other = _rate(p, program, i, aside, 1), _rate(p, program, i, aside, 0)
        finite = finite and math.isfinite(rate) and math.isfinite(other)
        if abs(rate - rates[i]) <= MISSED * EPS * fastest:
            continue  # what follows allows more
        rounding = fastest + abs(2.0 * c[i, 2] * s) + abs(3.0 * c[i, 3] * s * s)
        rounding += max(abs(c[i, 0]), abs(c[i, 1]), scale) / h
        left = (c.shape[1] - 1) * behind(c[i], s) / s  # of the slope, as of its last terms
        allowed = max(MISSED * EPS * rounding, left) + ROUNDING_BESIDE * abs(rate - other)
        allowed += DENORMAL_LOSS
        close = close and not abs(rate - rates[i]) > allowed
    return close or not finite


def _decides(p: Programs, program: int, s: float, c: Matrix, aside: Matrix) -> bool:
    """Whether the series of what is watched have its values, but for rounding."""
    order = c.shape[1] - 1
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        if p.kinks[j, KINK_KIND] == POINT:
            continue
        series = c[p.kinks[j, KINK_ROW]]
        value, other = aside[p.kinks[j, WHOLE_ROW], 1], aside[p.kinks[j, WHOLE_ROW], 0]
        off = abs(value - power_value(series, 0, order, s)[0])
        size = power_size(series, 0, order, s)
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
