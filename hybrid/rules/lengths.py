"""Over what length series are exact to rounding or a tolerance, and a gap's first zero in it.

The last two terms say how fast a series converges (Jorba & Zou, *A software package for the
numerical integration of ODEs by means of high-order Taylor methods*, Experimental Mathematics 14,
2005).
"""

from __future__ import annotations

import math

from .arrays import Floats, Matrix
from .zeros import first

__all__ = (
    "falls",
    "held_length",
    "min_own_length",
    "own_length",
    "step_length",
    "tolerated_length",
)

#: Size, relative to the state, to which the last terms of a step are held.
LAST_TERMS = 1e-16

#: Size, relative to the largest, of the last terms up to which a series may be used at all: what
#: follows is then no more than they are.
CONVERGED = 1e-3

#: A step that is cut to less than this share of what its last terms allow cannot be made.
SHORTEST_CUT = 1e-12

#: An element of the state is measured by its first terms, so many.
FIRST_TERMS = 3

#: Series of low flights have this order; those of short ones no less, and else half the usual one.
LOW_ORDER = 8

#: A flight is short up to this share of a usual step. The usual order is 1.65 times half the
#: natural logarithm of what is asked for, so that series of half the order are as exact up to a
#: share of exp(-2 / 1.65), which is 0.30.
SHORT_SHARE = 0.25

#: A step goes so many times as far as the flight is expected to, which is known but for how its
#: force changes.
STEP_FURTHER = 1.25

#: Below this coefficients have lost digits, or all of them; and a series of which the next one
#: would be smaller than this has not ended where they are zero.
FAINT, REPRESENTED = 1e-290, 1e-200


def falls(c: Matrix, size: int, gap: Floats, far: float, rows: Matrix, found: Matrix) -> float:
    """Where a gap first falls to zero, within ``far`` times the length over which the series of a
    gap and of a state have converged; infinity if it does not."""
    reach = far * min(step_length(c, size), own_length(gap, LAST_TERMS))
    return zero_of(gap, reach, rows, found)


def step_length(c: Matrix, size: int) -> float:
    """Length at which the last two terms of every element of the state fall to rounding."""
    return held_length(c, size, LAST_TERMS, math.inf)


def held_length(c: Matrix, size: int, share: float, length: float) -> float:
    """The length, or the shorter one at which they fall to a share of the element."""
    for i in range(size):
        length = _within(c[i], share, 0.0, length)
    return length


def tolerated_length(c: Matrix, size: int, loss: Floats, most: float) -> float:
    """Length, ``most`` at most, at which they fall to what a step may lose: a share of the element,
    in the first place of ``loss``, and a number for each, behind it; to rounding where that is
    more, and no further than all series have converged."""
    length = most
    for i in range(size):
        if loss[0] > CONVERGED or loss[1 + i] > CONVERGED * abs(c[i, 0]):
            length = _within(c[i], CONVERGED, 0.0, length)
        length = _within(c[i], max(loss[0], LAST_TERMS), loss[1 + i], length)
    return length


def _within(c: Floats, relative: float, absolute: float, length: float) -> float:
    """The length, or the shorter one at which the last two terms of an element are small enough.

    Against the element, or how far it goes by its speed or its acceleration, if that is more: so
    neither the unit of time nor other elements matter. One that is zero and at rest is measured by
    its other terms.
    """
    order = known(c)
    own = absolute + relative * abs(c[0])
    for k in range(order, order - 2, -1):
        last = abs(c[k])
        if last != 0.0 and last * power(length, k) > own:
            reach, size = (own / last) ** (1.0 / k), own
            for j in range(1, FIRST_TERMS):
                moved = relative * abs(c[j])
                own_move = moved * (reach if j == 1 else reach * reach)
                if reach == 0.0 or own_move > size:
                    reach = (moved / last) ** (1.0 / (k - j))
                    size = moved * (reach if j == 1 else reach * reach)
            length = min(length, reach if reach > 0.0 else own_length(c, relative))
    return length


def own_length(c: Floats, share: float) -> float:
    """Length at which the last two terms of a series fall to a share of the largest."""
    order = known(c)
    length = math.inf
    for last in range(order - 1, order + 1):
        if c[last] != 0.0:
            reach = _reach(c, order, last, share)
            length = min(length, reach) if reach >= 0.0 else length
    return length


def min_own_length(c: Floats, share: float, length: float) -> float:
    """The length, or :func:`own_length` where that is shorter, which takes longer to find."""
    last, power_of_length, largest = known(c), 1.0, 0.0
    for k in range(last - 1):
        largest = max(largest, abs(c[k]) * power_of_length)
        power_of_length *= length
    ends = max(abs(c[last - 1]), abs(c[last]) * length) * power_of_length
    return length if ends <= share * largest else min(length, own_length(c, share))


def behind(c: Floats, s: float) -> float:
    """What is left of a series behind its last terms, by their size: they fall.

    Where time has a small unit they are next to nothing, and the power may be no number.
    """
    order = known(c)
    left, far = abs(c[order - 1]) + abs(c[order]) * s, power(s, order - 1)
    if far < math.inf:
        return left * far
    for _ in range(order - 1):
        left *= s
    return left


def known(c: Floats) -> int:
    """The order of a series; a lower one where time has so small a unit that the last coefficients
    are next to nothing, or zero, which says nothing of how it converges.

    They are zero of polynomials, too, of which those before do not lead there.
    """
    order = c.shape[0] - 1
    if abs(c[order]) >= FAINT or abs(c[order - 1]) >= FAINT:
        return order
    first, last = 0, order
    while last > 0 and abs(c[last]) < FAINT:
        last -= 1
    while first < last and abs(c[first]) < FAINT:
        first += 1
    if last < FIRST_TERMS or first == last:
        return order
    ratio = (abs(c[last]) / abs(c[first])) ** (1.0 / (last - first))
    return order if abs(c[last]) * ratio * ratio >= REPRESENTED else last


def short_order(order: int) -> int:
    """The order of the series of short flights, by the usual one."""
    return min(order, max(LOW_ORDER, order // 2))


def power(s: float, k: int) -> float:
    """``s^k`` by squares, for ``k`` not below zero."""
    value = 1.0
    while k > 0:
        value *= s if k % 2 == 1 else 1.0
        s *= s
        k //= 2
    return value


def _reach(c: Floats, order: int, last: int, share: float) -> float:
    """Where a term is as large as a share of the largest of the others, the last two left out; -1
    where these are all zero."""
    reach, least = -1.0, 0.0  # shares of terms, against the last, that are not above it reach less
    for k in range(order - 1):
        size = share * abs(c[k] / c[last])
        if c[k] != 0.0 and not (least > 0.0 and size <= least):
            reach = max(reach, size ** (1.0 / (last - k)))
            least = size
        least /= reach
    return reach


def zero_of(gap: Floats, reach: float, rows: Matrix, found: Matrix) -> float:
    """First zero in ``(0, reach]`` at which a gap's series falls, by more than rounding.

    The zero at the start, if the series begins with 0, is divided out. Infinity if there is none.
    Rounding is as many spacings of its terms as it has.
    """
    if gap[0] < 0.0:
        return math.inf
    order = 1 if gap[0] == 0.0 else 0
    rounded = gap.shape[0] - 1.0
    zero = first(gap, gap.shape[0] - 1, reach, order, -1, rounded, rows, found)
    return zero if math.isfinite(zero) else math.inf
