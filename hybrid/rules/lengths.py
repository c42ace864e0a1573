"""Over what length series are exact to rounding or a tolerance, and a gap's first zero in it.

The last two terms say how fast a series converges (Jorba & Zou, *A software package for the
numerical integration of ODEs by means of high-order Taylor methods*, Experimental Mathematics 14,
2005).
"""

from __future__ import annotations

import math

from .arrays import Floats, Matrix
from .zeros import first

__all__ = ("falls", "own_length", "step_length", "tolerated_length")

#: Size, relative to the state, to which the last terms of a step are held.
ROUNDING = 1e-16

#: An element of the state counts as no smaller than this share of the largest.
SMALLEST = 1e-3

#: Rounding of a gap's series, in spacings of its terms: as many as it has.
ROUNDED = 16.0


def falls(c: Matrix, size: int, gap: Floats, far: float, rows: Matrix, found: Matrix) -> float:
    """Where a gap first falls to zero, within ``far`` times the length over which the series of a
    gap and of a state have converged; infinity if it does not."""
    reach = far * min(step_length(c, size), own_length(gap, ROUNDING))
    return zero_of(gap, reach, rows, found)


def step_length(c: Matrix, size: int) -> float:
    """Length at which the last two terms of every element of the state fall to rounding."""
    least = _least(c, size)
    length = math.inf
    for i in range(size):
        length = _within(c[i], least, 0.0, 0.0, length)
    return length


def tolerated_length(c: Matrix, size: int, loss: Floats) -> float:
    """Length at which they fall to what a step may lose: a share of the element, in the first place
    of ``loss``, and a number for each, behind it; to rounding where that is more."""
    least = _least(c, size)
    length = math.inf
    for i in range(size):
        length = _within(c[i], least, loss[0], loss[1 + i], length)
    return length


def _least(c: Matrix, size: int) -> float:
    """As what an element of the state counts at least."""
    largest = 0.0
    for i in range(size):
        largest = max(largest, abs(c[i, 0]))
    return SMALLEST * largest


def _within(c: Floats, least: float, relative: float, absolute: float, length: float) -> float:
    """The length, or the shorter one at which the last two terms of an element are small enough.

    An element that is next to zero is measured by how far it goes.
    """
    order = c.shape[0] - 1
    own = ROUNDING * max(abs(c[0]), abs(c[1]), least)
    own = max(own, absolute + relative * abs(c[0]))
    if own == 0.0:
        return min(length, _from_zero(c))
    for k in range(order, order - 2, -1):
        last = abs(c[k])
        if last != 0.0 and last * length**k > own:
            reach = (own / last) ** (1.0 / k)
            length = min(length, max(reach, (relative * abs(c[1]) / last) ** (1.0 / (k - 1))))
    return length


def _from_zero(c: Floats) -> float:
    """Length at which the last two terms fall to rounding, of a state that is zero and at rest."""
    order = c.shape[0] - 1
    length = math.inf
    for last in range(order - 1, order + 1):
        if c[last] != 0.0:
            length = min(length, max(_reach(c, 2, last, ROUNDING), 0.0))
    return length


def own_length(c: Floats, share: float) -> float:
    """Length at which the last two terms of a series fall to a share of the largest."""
    order = c.shape[0] - 1
    length = math.inf
    for last in range(order - 1, order + 1):
        if c[last] != 0.0:
            reach = _reach(c, 0, last, share)
            length = min(length, reach) if reach >= 0.0 else length
    return length


def _reach(c: Floats, low: int, last: int, share: float) -> float:
    """Where a term is as large as a share of the largest of those from ``low`` on, the last two
    left out; -1 where these are all zero."""
    reach, least = -1.0, 0.0  # shares of terms, against the last, that are not above it reach less
    for k in range(low, c.shape[0] - 2):
        size = share * abs(c[k] / c[last])
        if c[k] != 0.0 and not (least > 0.0 and size <= least):
            reach = max(reach, size ** (1.0 / (last - k)))
            least = size
        least /= reach
    return reach


def zero_of(gap: Floats, reach: float, rows: Matrix, found: Matrix) -> float:
    """First zero in ``(0, reach]`` at which a gap's series falls, by more than rounding.

    The zero at the start, if the series begins with 0, is divided out. Infinity if there is none.
    """
    if gap[0] < 0.0:
        return math.inf
    order = 1 if gap[0] == 0.0 else 0
    zero = first(gap, gap.shape[0] - 1, reach, order, -1, ROUNDED, rows, found)
    return zero if math.isfinite(zero) else math.inf
