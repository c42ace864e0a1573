"""Over what length series are exact to rounding or to a tolerance, and a gap's first zero in it.

The size of the last two terms shows how fast a series converges (Jorba & Zou, *A software package
for the numerical integration of ODEs by means of high-order Taylor methods*, Experimental
Mathematics 14, 2005).
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
    "time_scale",
    "tolerated_length",
)

#: Largest size of the last terms of a step, relative to the state.
LAST_TERMS = 1e-16

#: Largest size of the last terms, relative to the largest, at which a series may be used at all:
#: the remainder is then no larger than they are.
CONVERGED = 1e-3

#: A step cut to less than this share of what its last terms allow is refused. Series of a flow that
#: comes to rest in finite time may reach far beyond; the share leads to rounding of the time.
SHORTEST_CUT = 1e-20

#: No step is shorter: numbers next to the smallest have too few digits.
SHORTEST_STEP = 1e-300

#: Number of first terms by which a state element is measured.
FIRST_TERMS = 3

#: Order of the series of low flights, and the lowest order of those of short flights, which is
#: otherwise half the usual one.
LOW_ORDER = 8

#: A flight is short up to this share of a usual step. The usual order is 1.65 times half the
#: natural logarithm of the inverse tolerance, so that series of half the order are as exact up to
#: the share exp(-2 / 1.65) = 0.30.
SHORT_SHARE = 0.25

#: A step is this many times as long as the expected flight, whose force may change.
STEP_FURTHER = 1.25

#: Coefficients below the first have lost digits or underflowed; and if the next one of a series
#: would be below the second, zeros do not mean that it has ended.
FAINT, REPRESENTED = 1e-290, 1e-200


def falls(c: Matrix, size: int, gap: Floats, far: float, rows: Matrix, found: Matrix) -> float:
    """Where a gap first falls to zero, within ``far`` times the length over which the series of gap
    and state have converged; infinity if it does not."""
    reach = far * min(step_length(c, size), own_length(gap, LAST_TERMS))
    return zero_of(gap, reach, rows, found)


def step_length(c: Matrix, size: int) -> float:
    """Length at which the last two terms of every state element fall to rounding."""
    return held_length(c, size, LAST_TERMS, math.inf)


def held_length(c: Matrix, size: int, share: float, length: float) -> float:
    """The given length, or the shorter one at which they fall to a share of the element."""
    for i in range(size):
        length = _within(c[i], share, 0.0, length)
    return length


def tolerated_length(c: Matrix, size: int, loss: Floats, most: float) -> float:
    """Length, at most ``most``, at which they fall to what a step may lose: a share of the element,
    ``loss[0]``, plus a number for each, ``loss[1:]``; to rounding if that is more, and no further
    than all series have converged."""
    length = most
    for i in range(size):
        if loss[0] > CONVERGED or loss[1 + i] > CONVERGED * abs(c[i, 0]):
            length = _within(c[i], CONVERGED, 0.0, length)
        length = _within(c[i], max(loss[0], LAST_TERMS), loss[1 + i], length)
    return length


def _within(c: Floats, relative: float, absolute: float, length: float) -> float:
    """The given length, or the shorter one at which the last two terms of an element are small
    enough.

    They are measured by the element, or by how far it moves by its speed or acceleration if that is
    more, so that neither the unit of time nor other elements matter. An element that is zero and at
    rest is measured by its other terms.
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
    """Length at which the last two terms of a series fall to a share of its largest."""
    order = known(c)
    length = math.inf
    for last in range(order - 1, order + 1):
        if c[last] != 0.0:
            reach = _reach(c, order, last, share)
            length = min(length, reach) if reach >= 0.0 else length
    return length


def time_scale(c: Floats) -> float:
    """The time in which a function changes, as its series shows; 0 if the series ends. A phase
    (``sin(t + 3)`` at ``t = 0``) has no more digits than that time, whatever the time itself is."""
    length = own_length(c, CONVERGED)
    return length if length < math.inf else 0.0


def min_own_length(c: Floats, share: float, length: float) -> float:
    """The given length, or :func:`own_length` if shorter, which takes longer to compute."""
    if length == math.inf:  # powers of which compare with nothing
        return own_length(c, share)
    last, power_of_length, largest = known(c), 1.0, 0.0
    for k in range(last - 1):
        largest = max(largest, abs(c[k]) * power_of_length)
        power_of_length *= length
    ends = max(abs(c[last - 1]), abs(c[last]) * length) * power_of_length
    return length if ends <= share * largest else min(length, own_length(c, share))


def behind(c: Floats, s: float) -> float:
    """A bound on the remainder of a series, from the size of its last terms, which fall.

    With a small unit of time they are tiny, and the power may not be a number.
    """
    order = known(c)
    left, far = abs(c[order - 1]) + abs(c[order]) * s, power(s, order - 1)
    if far < math.inf:
        return left * far
    for _ in range(order - 1):
        left *= s
    return left


def known(c: Floats) -> int:
    """The order of a series; a lower one where the unit of time is so small that the last
    coefficients underflow, which says nothing about convergence.

    The last coefficients of a polynomial are zero too, but those before do not lead there.
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
    """The order of the series of short flights, from the usual one."""
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
    """Where a term equals a share of the largest of the others, the last two left out; -1 if these
    are all zero."""
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

    A zero at the start is divided out. Infinity if there is none. Rounding is one spacing of each
    term for each term.
    """
    if gap[0] < 0.0:
        return math.inf
    order = 1 if gap[0] == 0.0 else 0
    rounded = gap.shape[0] - 1.0
    zero = first(gap, gap.shape[0] - 1, reach, order, -1, rounded, rows, found)
    return zero if math.isfinite(zero) else math.inf
