"""One step of a solver as a polynomial; an arc's dense output is a list of these.

Every method's interpolant is a polynomial on its step. All are stored as Chebyshev coefficients, so
evaluation, root finding and saving handle a single form.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

if TYPE_CHECKING:
    from .automaton.shapes import Matrix, Numbers

#: Number of cached evaluation matrices: far more than solvers use repeatedly, and only some
#: megabytes if each step is evaluated at points of its own.
PLACES = 1024

#: A projected segment is resolved where its last coefficients are so small beside the largest, the
#: roundings of a projection, or more of them are no smaller, the rounding of the time; the most.
LAST_ROUNDED, MOST_RESOLVED = 16.0 * float(np.finfo(float).eps), 64


@attrs.frozen(eq=False)
class Segment:
    """The state on ``start <= tau <= start + length`` (local time of the arc).

    Attributes
    ----------
    coefficients : array, shape (degree + 1, n)
        Chebyshev coefficients in ``2 (tau - start) / length - 1``.
    """

    start: float
    length: float
    coefficients: Matrix

    @property
    def end(self) -> float:
        return self.start + self.length

    @property
    def degree(self) -> int:
        return len(self.coefficients) - 1

    def __call__(self, tau: Any) -> np.ndarray:
        """State at local times ``tau``; shape ``tau.shape + (n,)``."""
        xi = 2.0 * (np.asarray(tau, dtype=float) - self.start) / self.length - 1.0
        states: np.ndarray = _basis(xi if xi.ndim else float(xi), self.degree) @ self.coefficients
        return states

    def at(self, fractions: Numbers) -> Matrix:
        """State at fractions of the step, cached per set of fractions (as from :func:`nodes`)."""
        return _values_matrix(fractions.tobytes(), self.degree) @ self.coefficients

    def later(self, since: float) -> Segment:
        """The segment shifted by ``since``."""
        return Segment(since + self.start, self.length, self.coefficients)

    def cut(self, length: float) -> Segment:
        """The first part of the segment, or a slight extension of it."""
        if length == self.length:
            return self
        points = length / self.length * nodes(self.degree)
        values = chebyshev.chebvander(2.0 * points - 1.0, self.degree) @ self.coefficients
        return interpolated(self.start, length, values)


def projected(segment: Segment, t0: float, project: Callable[..., Any]) -> Segment:
    """A segment projected at its nodes onto the surface that its arc stays on.

    A constant segment that lies on the surface is returned as it is.
    """
    ends, degree = segment.at(nodes(1)), segment.degree
    if not segment.coefficients[1:].any():
        times = t0 + segment.start, t0 + segment.end
        rows = zip(times, ends, (False, True), strict=True)
        if all((project(t, x.tolist(), last) == x).all() for t, x, last in rows):
            return segment
    times = (t0 + segment.start + segment.length * nodes(degree)).tolist()
    states, inner = segment.at(nodes(degree)).tolist(), [False] * degree
    rows = zip(times, states, [*inner, True], strict=True)
    values = np.array([project(*row) for row in rows])
    return Segment(segment.start, segment.length, from_values(degree) @ values)


def resolved(segment: Segment, t0: float, project: Callable[..., Any]) -> Segment:
    """A segment of an arc that is projected wherever it is evaluated, as a polynomial alone.

    It goes through so many projected states that its last coefficients are rounding. None of them
    is at an end, where rounding may have them on the other side of a corner; and it is the segment
    itself where that is as close.
    """

    def states(places: Numbers) -> tuple[Numbers, Matrix]:
        taus = segment.start + 0.5 * (1.0 + places) * segment.length
        rows = zip((t0 + taus).tolist(), segment(taus).tolist(), strict=True)
        return taus, np.array([project(t, x) for t, x in rows])

    degree, last = max(segment.degree, 1), np.inf
    while True:
        degree = min(2 * degree, MOST_RESOLVED)
        places, to_coefficients = inner_nodes(degree)
        found = Segment(segment.start, segment.length, to_coefficients @ states(places)[1])
        sizes = np.abs(found.coefficients)
        tail, small = sizes[-2:].max(axis=0), LAST_ROUNDED * sizes.max(axis=0)
        if degree == MOST_RESOLVED or ((tail <= small) | (2.0 * tail >= last)).all():
            break
        last = tail
    taus, exact = states(0.5 * (places[1:] + places[:-1])[:: max(degree // 4, 1)])
    closer = np.abs(found(taus) - exact).max() < np.abs(segment(taus) - exact).max()
    return found if closer else segment


def terms(series: np.ndarray, length: Any) -> np.ndarray:
    """The terms of power series (coefficients on the last axis) at the end of a step.

    Multiplied factor by factor: a power of a long step alone may overflow.
    """
    found = series.copy()
    for k in range(1, series.shape[-1]):
        found[..., k:] *= length
    return found


def interpolated(start: float, length: float, values: Matrix) -> Segment:
    """The segment through states at :func:`nodes`; constant states stay exactly constant."""
    coefficients = from_values(len(values) - 1) @ (values - values[0])
    coefficients[0] += values[0]
    return Segment(start, length, coefficients)


def of_powers(start: float, length: float, powers: Matrix) -> Segment:
    """The segment whose states, a row each, are given by powers of the share of its length."""
    return Segment(start, length, from_powers(powers.shape[1] - 1) @ powers.T)


def straight(start: float, length: float, first: Numbers, last: Numbers) -> Segment:
    """The segment that leads along a straight line from one state to another."""
    return Segment(start, length, np.array([[0.5, 0.5], [-0.5, 0.5]]) @ np.array([first, last]))


def _basis(xi: Any, degree: int) -> np.ndarray:
    """Chebyshev polynomials at a number, or at an array of them on a new last axis."""
    terms = [xi**0, xi]
    for _ in range(degree - 1):
        terms.append(2.0 * xi * terms[-1] - terms[-2])
    return (
        np.array(terms[: degree + 1])
        if isinstance(xi, float)
        else np.stack(terms[: degree + 1], axis=-1)
    )


@cache
def nodes(degree: int) -> np.ndarray:
    """Chebyshev points of the second kind on [0, 1], ends included, increasing."""
    points = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / max(degree, 1))
    points.setflags(write=False)
    return points


@cache
def from_values(degree: int) -> np.ndarray:
    """Matrix from values at :func:`nodes` to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(2.0 * nodes(degree) - 1.0, degree))


@cache
def inner_nodes(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev points of the first kind on [-1, 1], none of them an end, increasing; and the
    matrix from values there to Chebyshev coefficients."""
    points = -np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    points.setflags(write=False)
    return points, np.linalg.inv(chebyshev.chebvander(points, degree))


@cache
def from_powers(degree: int) -> np.ndarray:
    """Matrix from coefficients of powers of the fraction to Chebyshev coefficients."""
    columns = []
    for power in range(degree + 1):
        shifted = np.array([1.0])
        for _ in range(power):
            shifted = chebyshev.chebmul(shifted, [0.5, 0.5])
        columns.append(np.pad(shifted, (0, degree + 1 - len(shifted))))
    return np.array(columns).T


@cache
def to_powers(degree: int) -> np.ndarray:
    """Matrix from Chebyshev coefficients to coefficients of powers of the fraction."""
    return np.linalg.inv(from_powers(degree))


@cache
def to_centred_powers(degree: int) -> np.ndarray:
    """Matrix from Chebyshev coefficients to coefficients of powers on [-1, 1]."""
    found = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        found[: k + 1, k] = chebyshev.cheb2poly(np.eye(degree + 1)[k][: k + 1])
    return found


@cache
def integrals(degree: int) -> np.ndarray:
    """Matrix from values at :func:`nodes` to integrals from 0 to each node."""
    columns = []
    for k in range(degree + 1):
        whole = chebyshev.chebint(np.eye(degree + 1)[k], lbnd=-1.0)
        columns.append(0.5 * chebyshev.chebval(2.0 * nodes(degree) - 1.0, whole))
    return np.array(columns).T @ from_values(degree)


def apply(matrix: Matrix, values: Any) -> Any:
    """A small constant matrix times a matrix of columns, for numpy or JAX.

    Written out, as for so few numbers a library call costs more than the product.
    """
    return (matrix[:, :, None] * values[None]).sum(axis=1)


@lru_cache(maxsize=PLACES)
def _values_matrix(fractions: bytes, degree: int) -> np.ndarray:
    return chebyshev.chebvander(2.0 * np.frombuffer(fractions) - 1.0, degree)
