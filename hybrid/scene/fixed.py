"""A graph for readers that prove something: no constant is rounded.

An operation on constants is folded only where its result is exact. Where a model's
parameters are put in as constants, a term times a parameter that is 0 is gone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from .graph import Graph, Ids, fold
from .python import needed

#: Operations of which a float's result is always exact.
EXACT = {
    *("neg", "abs", "sign", "max", "min", "floor", "ceil", "round", "trunc", "real", "select"),
    *("gt", "ge", "lt", "le", "eq", "ne", "and", "or", "xor", "not", "is_finite"),
}

#: Operations whose result is finite wherever their arguments are.
TOTAL = EXACT | {
    *("const", "input", "add", "sub", "mul", "sin", "cos", "atan", "tanh", "asinh", "exp"),
    *("sinh", "cosh", "exp2", "expm1", "logistic", "cbrt", "erf", "erfc", "away"),
}


class FixedGraph(Graph):
    """A graph in which constants stay as exact as they were written.

    ``0 * a`` is 0 where ``a`` cannot fail to be finite; with ``exact=False`` everywhere, and
    so are ``0 / a`` and a choice between zeros, which is right for a derivative: what an
    expression does not depend on does not count.
    """

    def _simplify(self, key: tuple[Any, ...]) -> tuple[Any, ...]:
        op, arguments = key[0], key[1:]
        if op in ("const", "input"):
            return key
        values = [self.value(a) for a in arguments]
        if op == "mul" and any(v is not None and v == 0 for v in values) and self._total(arguments):
            return ("const", 0.0, "0.0")
        if not self.exact and _vanishes(op, values):
            return ("const", 0.0, "0.0")
        if all(v is not None for v in values) and not _exact(op, values):
            return key
        return super()._simplify(key)

    def _total(self, numbers: Sequence[int]) -> bool:
        nodes = [self.nodes[i] for i in needed(self, numbers)]
        return all(n[0] in TOTAL and (n[0] != "const" or math.isfinite(n[1])) for n in nodes)

    def arguments(self, shapes: Sequence[tuple[int, ...]], values: Sequence[float]) -> list[Ids]:
        """Nodes of the parameters: constants, in their shapes."""
        ids = iter([self.const(float(value)) for value in values])
        sizes = [int(np.prod(shape, dtype=int)) for shape in shapes]
        return [
            np.array([next(ids) for _ in range(size)], dtype=np.int64).reshape(shape)
            for size, shape in zip(sizes, shapes, strict=True)
        ]


def _vanishes(op: str, values: Sequence[Any]) -> bool:
    """Whether a derivative that is put together from these is zero wherever there is one."""
    if op == "div":
        return bool(values[0] == 0)
    return op == "select" and bool(values[1] == 0 and values[2] == 0)


def _exact(op: str, values: Sequence[Any]) -> bool:
    """Whether the folded value of an operation is the exact one."""
    if op in EXACT:
        return True
    if op not in ("add", "sub", "mul") or not all(math.isfinite(v) for v in values):
        return False
    a, b = map(Fraction, values)
    exact = a + b if op == "add" else a - b if op == "sub" else a * b
    folded = fold(op, values)
    return folded is not None and Fraction(folded) == exact


def hides_derivatives(closed: Any) -> bool:
    """Whether a trace holds back a derivative (``stop_gradient``): proofs rest on them all."""
    return "stop_gradient" in _primitives(closed.jaxpr)


def _primitives(jaxpr: Any) -> set[str]:
    """Names of the primitives of a jaxpr, inner ones included."""
    found = set()
    for equation in jaxpr.eqns:
        found.add(equation.primitive.name)
        for inner in equation.params.values():
            for part in inner if isinstance(inner, tuple | list) else [inner]:
                part = getattr(part, "jaxpr", part)
                found |= _primitives(part) if hasattr(part, "eqns") else set()
    return found
