"""When a guard is reached: crossings and tangencies of a guard along one step.

A guard along a step is a function of one variable. It is sampled on the step's polynomial
and turned into Bernstein coefficients, whose sign changes bound the number of zeros from
above (Descartes): none means no zero, one means exactly one, more means look at both
halves. So two crossings inside one step are both found, and a guard that is zero at the
start of the step by construction (after a jump, at a release) is divided by the power of
the local time by which it vanishes; its next zero is found however close it is.

The semantics are in ``docs/semantics.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from .automaton.markers import Crossing
from .errors import FlowError
from .segment import Segment, from_values, nodes

if TYPE_CHECKING:
    from .scene import Guard

#: Degree at which a guard that is no polynomial is sampled, piece by piece.
SAMPLED = 12

#: Pieces of a run in which such a guard is sampled at least.
SHARES = 100

#: Pieces are halved until the last coefficients are this small against the largest.
RESOLVED = 1e-6

#: Most pieces at first, and most halvings of one.
PIECES, DEPTH = 4096, 12

#: A guard nearer to zero than this share of the state is looked at more closely.
NEAR = 1e-6

#: Gap and gap speed, relative to the state, below which a held contact stays closed.
CLOSED = 1e-12

#: A gap speed, against the states seen, at which a series of impacts that has no sum is over.
NOTHING = 1e-20

#: Jumps with no time between them after which a run is taken to be caught in a loop; impacts,
#: which slow down bodies in contact that strike each other again and again.
CAUGHT, STRUCK = 100, 10_000

EPS = float(np.finfo(float).eps)


@attrs.frozen
class Zero:
    """A zero of a guard along a step.

    Attributes
    ----------
    tau : float
        Local time in the arc.
    direction : int
        ``-1`` falling, ``+1`` rising, ``0`` touching without crossing.
    """

    tau: float
    direction: int


def zeros(
    guard: Guard,
    segment: Segment,
    t0: float,
    order: int,
    scale: float,
    tolerance: float,
    ends: dict[Any, float],
) -> Iterator[Zero]:
    """Zeros of a guard in ``(start, end]`` of a step, in order of time.

    Parameters
    ----------
    order : int
        Power of the local time by which the guard is known to vanish at the start.
    scale : float
        A time over which a guard that is no polynomial is smooth.
    tolerance : float
        A minimum no deeper (higher) than this is a tangency.
    ends : dict
        By edge: the guard at the end of the last step, on which this one must build, so
        that no sign is lost where two steps meet; and its largest size so far in the arc,
        for it cannot touch zero before it has left it. Updated here.
    """
    polynomial = guard.affine and segment.degree <= SAMPLED
    if polynomial:
        degree, pieces = max(segment.degree, order, 1), 1
    else:
        degree, pieces = SAMPLED, max(1, int(np.ceil(min(segment.length / scale, PIECES))))
    for left, right in pairwise([k / pieces for k in range(pieces + 1)]):
        piece = _Piece(guard, segment, t0, degree, tolerance, ends)
        depth = 0 if polynomial else DEPTH
        for fraction, direction in piece.zeros(left, right, order if left == 0.0 else 0, depth):
            yield Zero(segment.start + fraction * segment.length, direction)


@attrs.frozen
class _Piece:
    """A part of a step over which a guard is sampled."""

    guard: Guard
    segment: Segment
    t0: float
    degree: int
    tolerance: float
    ends: dict[Any, float]

    def zeros(
        self, left: float, right: float, order: int, depth: int
    ) -> Iterator[tuple[float, int]]:
        """Zeros between two fractions of the step; halved until the guard is resolved."""
        width = right - left
        values = self.sample(left + width * nodes(self.degree))
        if depth and not self.resolved(values):
            middle = 0.5 * (left + right)
            yield from self.zeros(left, middle, order, depth - 1)
            yield from self.zeros(middle, right, 0, depth - 1)
            return
        edge, seen = self.guard.edge, ("largest", self.guard.edge)
        values[0] = self.ends.get(edge, values[0])
        bernstein = to_bernstein(self.degree) @ values
        bernstein[0], bernstein[-1] = values[0], values[-1]
        away = max(self.ends.get(seen, 0.0), abs(float(values[0]))) > self.tolerance
        self.ends[edge] = float(values[-1])
        self.ends[seen] = max(self.ends.get(seen, 0.0), float(np.abs(values).max()))
        for root, direction in roots(bernstein, order, self.tolerance):
            if direction or away:
                yield left + width * root, direction

    def sample(self, fractions: np.ndarray) -> np.ndarray:
        start, length, value = self.segment.start, self.segment.length, self.guard.value
        states = self.segment.at(fractions).tolist()
        times = (self.t0 + start + length * fractions).tolist()
        values = np.array([value(t, x) for t, x in zip(times, states, strict=True)])
        if not np.all(np.isfinite(values)):
            raise FlowError(f"the guard of {self.guard.edge} is not finite")
        return values

    def resolved(self, values: np.ndarray) -> bool:
        series = np.abs(from_values(self.degree) @ values)
        return bool(series[-3:].max() <= RESOLVED * series.max() + 1e-3 * self.tolerance)


# ---------------------------------------------------------------------------------------
# polynomials in Bernstein form on [0, 1]


@cache
def to_bernstein(degree: int) -> np.ndarray:
    """Matrix from values at the nodes to Bernstein coefficients."""
    points = nodes(degree)
    basis = [
        [comb(degree, k) * p**k * (1 - p) ** (degree - k) for k in range(degree + 1)]
        for p in points
    ]
    return np.linalg.inv(np.array(basis))


@cache
def bernstein_from_powers(degree: int) -> np.ndarray:
    """Matrix from coefficients of powers to Bernstein's on [0, 1]."""
    rows = [
        [comb(i, k) / comb(degree, k) if k <= i else 0.0 for k in range(degree + 1)]
        for i in range(degree + 1)
    ]
    return np.array(rows)


def roots(bernstein: np.ndarray, order: int, tolerance: float) -> Iterator[tuple[float, int]]:
    """Zeros in ``(0, 1]`` of a polynomial that vanishes at 0 to the given order.

    Yields ``(point, direction)`` in order; direction 0 is a touch within ``tolerance``.
    """
    b = deflate(bernstein, order)
    low, high = float(b.min()), float(b.max())
    if (low > 0 or high < 0) and (order or low > tolerance or high < -tolerance):
        return
    found = list(_crossings(b.tolist(), 0.0, 1.0, 48))
    yield from found
    if not order and not found:
        yield from _touches(b, tolerance)


def deflate(bernstein: np.ndarray, order: int) -> np.ndarray:
    """Coefficients of ``p(s) / s^order``; what should vanish is dropped, not tested."""
    for _ in range(order):
        degree = len(bernstein) - 1
        bernstein = bernstein[1:] * degree / np.arange(1, degree + 1)
    return bernstein


def _crossings(
    b: list[float], left: float, right: float, depth: int
) -> Iterator[tuple[float, int]]:
    """Sign changes in ``(left, right]`` by Descartes' rule and halving.

    A zero at the right end of all counts as reached, from the sign before it.
    """
    signs = [1 if v > 0 else -1 for v in b if v]
    changes = sum(p != q for p, q in pairwise(signs))
    if changes == 0:
        if signs and b[-1] == 0.0 and right == 1.0:
            yield right, -signs[-1]
    elif changes == 1 and b[0] * b[-1] < 0:
        yield left + (right - left) * _one_root(b), signs[-1]
    elif depth == 0:
        if signs[0] != signs[-1]:
            yield 0.5 * (left + right), signs[-1]
    else:
        first, second = _halve(b)
        middle = 0.5 * (left + right)
        yield from _crossings(first, left, middle, depth - 1)
        before = [1 if v > 0 else -1 for v in first if v]
        after = [1 if v > 0 else -1 for v in second if v]
        if first[-1] == 0.0 and before and after and before[-1] != after[0]:
            yield middle, after[0]
        yield from _crossings(second, middle, right, depth - 1)


def _halve(b: list[float]) -> tuple[list[float], list[float]]:
    """De Casteljau: coefficients on the left and the right half."""
    left, right, row = [b[0]], [b[-1]], b
    while len(row) > 1:
        row = [0.5 * (p + q) for p, q in pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


def _value(b: Sequence[float], s: float) -> tuple[float, float]:
    """Value and derivative (de Casteljau)."""
    row, degree = list(b), len(b) - 1
    while len(row) > 2:
        row = [p + s * (q - p) for p, q in pairwise(row)]
    if degree == 0:
        return row[0], 0.0
    return row[0] + s * (row[1] - row[0]), degree * (row[1] - row[0])


def _one_root(b: list[float]) -> float:
    """The zero of a polynomial with exactly one sign change: Newton within a bracket."""
    left, right, rising = 0.0, 1.0, b[-1] > 0
    s = b[0] / (b[0] - b[-1])
    for _ in range(60):
        value, rate = _value(b, s)
        if value == 0.0:
            return s
        if (value > 0) == rising:
            right = s
        else:
            left = s
        new = s - value / rate if rate else left
        if not left < new < right:
            new = 0.5 * (left + right)
        if abs(new - s) <= 2 * EPS * s or right - left <= EPS:
            return new
        s = new
    return s


def _touches(b: np.ndarray, tolerance: float) -> Iterator[tuple[float, int]]:
    """Interior extrema next to zero of a polynomial that does not change sign."""
    degree = len(b) - 1
    slopes = (degree * np.diff(b)).tolist()
    positive = b.max() > -b.min()
    for point, direction in _crossings(slopes, 0.0, 1.0, 48):
        towards = direction == (1 if positive else -1)
        if towards and abs(_value(b.tolist(), point)[0]) <= tolerance and 0 < point < 1:
            yield point, 0


# ---------------------------------------------------------------------------------------
# guards at the start of an arc


def vanishing_order(
    guard: Guard, t: float, x: Sequence[float], series: Sequence[float], noise: Sequence[float]
) -> tuple[int, int]:
    """By which order a guard vanishes at a state, and the sign it takes next.

    Parameters
    ----------
    series : sequence
        Taylor coefficients of the guard along the flow.
    noise : sequence
        Rounding to be expected in each.

    Returns
    -------
    order, sign : int
        ``(0, sign)`` where the guard is not zero; sign 0 where no derivative decides.
    """
    for order, (value, small) in enumerate(zip(series, noise, strict=True)):
        if abs(value) > small:
            return order, 1 if value > 0 else -1
    return len(series), 0


def higher_noise(series: Sequence[float], own: float) -> list[float]:
    """Rounding in the coefficients from the third on, compared in the series' own time."""
    sizes = [abs(c) * own**k for k, c in enumerate(series)]
    largest = max(sizes[3:], default=0.0)
    return [64 * EPS * largest / own**k for k in range(3, len(series))]


def fires(crossing: Crossing, direction: int) -> bool:
    """Whether an edge fires on a crossing in this direction."""
    if crossing is Crossing.EITHER:
        return direction != 0
    return direction == (-1 if crossing is Crossing.FALLING else 1)


def time_scale(series: Sequence[float], size: float) -> float:
    """A time over which a guard is close to a cubic, from its Taylor series.

    ``size`` is that of the numbers the guard is made of: the guard itself may be small.
    """
    size = max(size, *map(abs, series[:4])) or 1.0
    bounds = [(size / abs(c)) ** (1.0 / k) for k, c in enumerate(series) if k >= 4 and c]
    return min(bounds, default=float("inf"))
