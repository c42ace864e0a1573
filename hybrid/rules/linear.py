"""Small systems of linear equations, and the best fit of many."""

from __future__ import annotations

import math

from .arrays import Floats, Matrix

__all__ = ("solve", "unfitted")


def solve(a: Matrix, n: int, b: Matrix, columns: int) -> bool:
    """Solve ``a x = b`` for several right sides, in place; False where there is no solution.

    Rows are exchanged so that each pivot is the largest that is left in its column.
    """
    for p in range(n):
        best = p
        for i in range(p + 1, n):
            if abs(a[i, p]) > abs(a[best, p]):
                best = i
        if not abs(a[best, p]) > 0.0:
            return False
        exchange(a, p, best, n)
        exchange(b, p, best, columns)
        for i in range(p + 1, n):
            factor = a[i, p] / a[p, p]
            for j in range(p + 1, n):
                a[i, j] -= factor * a[p, j]
            for j in range(columns):
                b[i, j] -= factor * b[p, j]
    for p in range(n - 1, -1, -1):
        for j in range(columns):
            total = b[p, j]
            for i in range(p + 1, n):
                total -= a[p, i] * b[i, j]
            b[p, j] = total / a[p, p]
    return True


def exchange(a: Matrix, i: int, k: int, columns: int) -> None:
    """Exchange two rows."""
    if i != k:
        for j in range(columns):
            value = a[i, j]
            a[i, j] = a[k, j]
            a[k, j] = value


def unfitted(a: Matrix, rows: int, columns: int, b: Floats) -> None:
    """Leave of ``b`` what no sum of the columns of ``a`` gives: the rest of the best fit.

    By reflections (Householder's) that make ``a`` triangular; what they leave of ``b`` below the
    triangle is reflected back. No product of ``a`` with itself, which would lose half the digits.
    """
    for p in range(columns):
        mirror(a, p, rows, columns)
        reflect(a, p, rows, b)
    for p in range(columns):
        b[p] = 0.0
    for p in range(columns - 1, -1, -1):
        reflect(a, p, rows, b)


def mirror(a: Matrix, p: int, rows: int, columns: int) -> None:
    """Put into column ``p`` the direction of the reflection that clears it; reflect the others.

    The direction has length ``sqrt(2)``; it is zero where there is nothing to clear.
    """
    size = 0.0
    for i in range(p, rows):
        size += a[i, p] * a[i, p]
    size = math.sqrt(size)
    if size == 0.0:
        return
    scale = math.sqrt(size * (size + abs(a[p, p])))
    a[p, p] += math.copysign(size, a[p, p])
    for i in range(p, rows):
        a[i, p] /= scale
    for j in range(p + 1, columns):
        total = 0.0
        for i in range(p, rows):
            total += a[i, p] * a[i, j]
        for i in range(p, rows):
            a[i, j] -= total * a[i, p]


def reflect(a: Matrix, p: int, rows: int, b: Floats) -> None:
    """Reflect a vector at the direction in column ``p``."""
    total = 0.0
    for i in range(p, rows):
        total += a[i, p] * b[i]
    for i in range(p, rows):
        b[i] -= total * a[i, p]
