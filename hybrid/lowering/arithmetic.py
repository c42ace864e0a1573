"""The operations of a graph on numbers: Python's, and numpy's scalars, which do not raise."""

from __future__ import annotations

import math
import operator
from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np


def _sign(x: float) -> float:
    return math.copysign(1.0, x) if x else x


def _max(x: float, y: float) -> float:
    return x if x >= y or x != x else y


def _min(x: float, y: float) -> float:
    return x if x <= y or x != x else y


def _sum(*terms: Any) -> Any:
    return sum(terms)


def _dot(*pairs: Any) -> Any:
    return sum(map(operator.mul, pairs[::2], pairs[1::2]))


def _solve(*numbers: Any) -> list[Any]:
    """Linear equations among the unknowns that the mask at the end counts; the others are 0."""
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
    """A few linear equations by elimination, written out.

    With ``exchange`` the row with the largest number of a column comes first; without, the matrix
    is definite, and its numbers may be arrays of JAX.
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
            if exchange and rows[i][k] == 0.0:  # of many contacts most do not touch each other
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
    """Numbers of which one is picked."""

    @cached_property
    def knots(self) -> list[float]:
        """Those behind the first, in order, each once."""
        return sorted(set(map(float, self[1:])))

    def wave(self, x: float) -> float:
        """A function of ``x`` that changes its sign at each knot, and is zero nowhere else."""
        knots = self.knots
        if not math.isfinite(x) or len(knots) < 2:
            return x - knots[0] if knots else math.nan
        i = min(max(bisect_right(knots, x) - 1, 0), len(knots) - 2)
        share = (x - knots[i]) / (knots[i + 1] - knots[i])
        return math.sin(math.pi * (i + min(max(share, -0.5), 1.5)))


def entry(table: Sequence[Any], place: Any) -> Any:
    """An entry of a table, or the nearest that there is."""
    return table[min(max(int(place), 0), len(table) - 1)] if math.isfinite(place) else math.nan


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x)) if x >= 0 else 1.0 - 1.0 / (1.0 + math.exp(x))


#: Every operation of a graph on Python numbers.
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
    "sign": _sign,
    "max": _max,
    "min": _min,
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

#: Those of a graph of a mode besides, of many numbers.
LONG: dict[str, Callable[..., Any]] = {
    "sum": _sum,
    "dot": _dot,
    "solve": _solve,
    "part": operator.getitem,
    "table": lambda *entries: Entries(entries),
    "pick": entry,
    "knot": entry,
    "wave": lambda x, table: table.wave(x),
}

#: The same operations on numpy scalars, where the plain ones would raise.
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
