"""The terms of which coefficients are added up: their rounding is that of the sum.

It shows where terms cancel, as do ``9.8`` and ``a*sin(t)`` at the turn of a table that all but lets
go of a bead: what changes little beside that point says nothing of it. A coefficient that is no
sum, and no product with one, is its own and only term.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .jets import OPS
from .operations import ADD, COPY, DIV, DOT, MUL, NEG, SCALE, SELECT, SQUARE, SUB, SUM_OF, at
from .zeros import EPS

__all__ = ("add_up", "rounding_of")

#: The column of coefficients beside a step that gets the sums.
TERMS_BESIDE = 3


def add_up(p: Programs, program: int, k: int, c: Matrix) -> None:
    """Sum up the sizes of the terms of all coefficients of order ``k``, into a column behind it."""
    for row in range(c.shape[0]):
        c[row, TERMS_BESIDE] = abs(c[row, k])
    for j in range(p.index[program, OPS], p.index[program, OPS + 1]):
        op = p.ops[j]
        c[op[1], TERMS_BESIDE] = _sum(op[0], op[1], op[2], op[3], op[4], p.more, p.numbers, c, k)


def rounding_of(c: Matrix, row: int) -> float:
    """The rounding of a coefficient by its terms; 0 where these have no sum."""
    size = c[row, TERMS_BESIDE]
    return EPS * size if math.isfinite(size) else 0.0


def _sum(
    op: int, out: int, a: int, b: int, d: int, more: Ints, s: Floats, c: Matrix, k: int
) -> float:
    """That of one operation's result, from those of its arguments; ``more`` and what comes before
    it as in :func:`.operations.operate`."""
    if op in (ADD, SUB):
        return _size(c, s, a, k) + _size(c, s, b, k)
    if op in (NEG, COPY):
        return _size(c, s, a, k)
    if op in (SCALE, MUL, SQUARE):
        return _product(c, s, a, a if op == SQUARE else b, k)
    if op == DIV:
        below = abs(at(c, s, b, 0))
        by = abs(c[out, k]) * (_size(c, s, b, 0) if k == 0 else below)
        return (_size(c, s, a, k) + by) / below if below > 0.0 else math.inf
    if op == SELECT:
        return _size(c, s, b if at(c, s, a, 0) != 0.0 else d, k)
    total = 0.0
    if op == SUM_OF:
        for i in range(a, a + b):
            total += _size(c, s, more[i], k)
    elif op == DOT:
        for i in range(a, a + 2 * b, 2):
            total += _product(c, s, more[i], more[i + 1], k)
    else:
        total = abs(c[out, k])
    return total


def _size(c: Matrix, s: Floats, r: int, k: int) -> float:
    """The sum of an argument's terms."""
    if r < 0:
        return abs(at(c, s, r, k))
    return c[r, TERMS_BESIDE]


def _product(c: Matrix, s: Floats, a: int, b: int, k: int) -> float:
    """The sum of the terms of ``a_0 b_k`` and so on, each factor's too."""
    total = _size(c, s, a, k) * abs(at(c, s, b, 0)) + abs(at(c, s, a, 0)) * _size(c, s, b, k)
    for i in range(1, k):
        total += abs(at(c, s, a, i) * at(c, s, b, k - i))
    return total
