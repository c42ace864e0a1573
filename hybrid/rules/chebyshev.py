"""Polynomials through values at Chebyshev points of [0, 1], several side by side.

The points are ``(1 - cos(pi j / degree)) / 2``, ends included, increasing. Coefficients are those
of the Chebyshev polynomials in ``2 w - 1``; a column of a matrix holds one polynomial.
"""

from __future__ import annotations

import math

from .arrays import Floats, Matrix

__all__ = ("differences", "evaluate", "from_values", "nodes", "value")


def nodes(degree: int, w: Floats) -> None:
    """The points."""
    for j in range(degree + 1):
        w[j] = 0.5 - 0.5 * math.cos(math.pi * j / degree)


def from_values(degree: int, to: Matrix) -> None:
    """The matrix from values at the points to coefficients: a cosine sum."""
    for k in range(degree + 1):
        for j in range(degree + 1):
            turn = math.cos(math.pi * (k * j % (2 * degree)) / degree)
            share = 2.0 / degree if k % 2 == 0 else -2.0 / degree
            share = 0.5 * share if k == 0 or k == degree else share
            to[k, j] = (0.5 * share if j == 0 or j == degree else share) * turn


def evaluate(c: Matrix, degree: int, w: float, line: Floats, values: Floats) -> None:
    """All polynomials at ``w``; ``line`` is room for as many numbers as they have coefficients."""
    b = 2.0 * w - 1.0
    for k in range(degree + 1):
        line[k] = 1.0 if k == 0 else b if k == 1 else 2.0 * b * line[k - 1] - line[k - 2]
    for j in range(c.shape[1]):
        values[j] = 0.0
    for k in range(degree + 1):
        for j in range(c.shape[1]):
            values[j] += line[k] * c[k, j]


def value(c: Matrix, degree: int, column: int, w: float) -> float:
    """One polynomial at ``w``, by Clenshaw's rule."""
    b = 2.0 * w - 1.0
    last = 0.0
    before = 0.0
    for k in range(degree, 0, -1):
        now = c[k, column] + 2.0 * b * last - before
        before = last
        last = now
    return c[0, column] + b * last - before


def differences(degree: int, r: float, w: float, line: Floats) -> None:
    """``T_k(2 r w - 1) - T_k(2 w - 1)``, by a recurrence of its own: exact for ``r`` near 1."""
    a = 2.0 * r * w - 1.0
    b = 2.0 * w - 1.0
    step = 2.0 * (r - 1.0) * w
    here = 1.0
    before = b
    for k in range(degree + 1):
        if k < 2:
            line[k] = step * k
        else:
            line[k] = 2.0 * (a * line[k - 1] + step * here) - line[k - 2]
        if k > 0:
            after = 2.0 * b * here - before
            before = here
            here = after
