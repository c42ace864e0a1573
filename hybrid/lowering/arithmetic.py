"""The operations of a graph on Python numbers, and on numpy scalars, which do not raise."""

from __future__ import annotations

import math
import operator
from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np


def _solve(*numbers: Any) -> list[Any]:
    """Solve for the unknowns selected by the trailing mask; the others are 0."""
    n = round(math.sqrt(len(numbers) + 1)) - 1
    held = [i for i in range(n) if numbers[n * n + n + i]]
    rows = [[numbers[i * n + j] for j in held] for i in held]
    found = solve(rows, [numbers[n * n + i] for i in held], exchange=True)
    solution = [0.0] * n
    for i, value in zip(held, found, strict=True):
        solution[i] = value
    return solution


def _solve_or_nan(*numbers: Any) -> list[Any]:
    try:
        return _solve(*numbers)
    except ZeroDivisionError:
        return [math.nan] * len(numbers)


def solve(matrix: list[list[Any]], right: list[Any], exchange: bool = False) -> list[Any]:
    """Solve a small linear system by elimination.

    With ``exchange`` rows are exchanged (partial pivoting). Without it the matrix must be definite,
    and its entries may be JAX arrays.
    """
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    size = len(rows)
    if size == 1:
        return [rows[0][1] / rows[0][0]]
    for k in range(size):
        if exchange:
            best = max(range(k, size), key=lambda i: abs(rows[i][k]))
            rows[k], rows[best] = rows[best], rows[k]
        for i in range(k + 1, size):
            if exchange and rows[i][k] == 0.0:  # with many contacts, most entries are zero
                continue
            factor = rows[i][k] / rows[k][k]
            pairs = zip(rows[i][k + 1 :], rows[k][k + 1 :], strict=True)
            rows[i][k + 1 :] = [p - factor * q for p, q in pairs]
    solution: list[Any] = [0.0] * size
    for i in reversed(range(size)):
        known = sum(rows[i][k] * solution[k] for k in range(i + 1, size))
        solution[i] = (rows[i][-1] - known) / rows[i][i]
    return solution


class Entries(tuple[Any, ...]):
    """The entries of a table."""

    @cached_property
    def knots(self) -> list[float]:
        """The entries after the first, sorted, without repetitions."""
        return sorted(set(map(float, self[1:])))

    def wave(self, x: float) -> float:
        """A function of ``x`` that is zero at the knots, exactly, and changes sign at each."""
        knots = self.knots
        if not math.isfinite(x) or len(knots) < 2:
            return x - knots[0] if knots else math.nan
        i = min(max(bisect_right(knots, x) - 1, 0), len(knots) - 2)
        share = (x - knots[i]) / (knots[i + 1] - knots[i])
        return math.sin(math.pi * max(min(share, 1.0 - share), -0.5)) * (1 - 2 * (i % 2))


def entry(table: Sequence[Any], place: Any) -> Any:
    """The table's entry at ``place``, clamped to its range; NaN if ``place`` is not finite."""
    return table[min(max(int(place), 0), len(table) - 1)] if math.isfinite(place) else math.nan


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x)) if x >= 0 else 1.0 - 1.0 / (1.0 + math.exp(x))


#: The scalar operations of a graph on Python numbers.
OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": math.pow,
    "rem": math.fmod,
    "gt": operator.gt,
    "ge": operator.ge,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": operator.not_,
    "select": lambda c, a, b: a if c else b,
    "abs": abs,
    "sign": lambda x: math.copysign(1.0, x) if x else x,
    "max": lambda x, y: x if x >= y or x != x else y,
    "min": lambda x, y: x if x <= y or x != x else y,
    "trunc": lambda x: int(x),
    "real": lambda x: float(x),
    "round": lambda x: float(round(x)),
    "away": lambda x: math.copysign(math.floor(abs(x) + 0.5), x),
    "floor": lambda x: float(math.floor(x)),
    "ceil": lambda x: float(math.ceil(x)),
    "is_finite": math.isfinite,
    "logistic": _logistic,
    **{
        name: getattr(math, name)
        for name in (
            *("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
            *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp2", "expm1", "log1p"),
            *("cbrt", "erf", "erfc", "lgamma"),
        )
    },
}

#: Operations on many numbers, which occur in mode graphs.
LONG: dict[str, Callable[..., Any]] = {
    "sum": lambda *terms: sum(terms),
    "dot": lambda *pairs: sum(map(operator.mul, pairs[::2], pairs[1::2])),
    "solve": _solve,
    "part": operator.getitem,
    "table": lambda *entries: Entries(entries),
    "pick": entry,
    "knot": entry,
    "wave": lambda x, table: table.wave(x),
}

#: The same operations on numpy scalars, which give NaN or infinity where Python would raise.
FORGIVING: dict[str, Callable[..., Any]] = {
    **OPERATIONS,
    **LONG,
    **{n: getattr(np, n) for n in ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh")},
    **{n: getattr(np, n) for n in ("tanh", "exp2", "expm1", "log1p", "cbrt", "floor", "ceil")},
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "div": np.divide,
    "pow": np.power,
    "round": np.round,
    "away": lambda x: np.copysign(np.floor(np.abs(x) + 0.5), x),
    "rem": np.fmod,
    "sign": np.sign,
    "logistic": lambda x: 1.0 / (1.0 + np.exp(-x)),
    "real": np.float64,
    "solve": _solve_or_nan,
    "lgamma": lambda x: math.lgamma(x) if math.isfinite(x) and x > 0 else np.float64("nan"),
    "trunc": lambda x: int(x) if np.isfinite(x) else 0,
}
