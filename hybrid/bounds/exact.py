"""A graph without rounded constants, for proofs.

An operation on constants is replaced by its result only if the result is exact. With the parameters
inserted as constants, terms multiplied by a parameter that is 0 vanish.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ..lowering.graph import Graph, Ids, fold, needed

#: Operations that are always exact on floats.
EXACT_OPERATIONS = {
    *("neg", "abs", "sign", "max", "min", "floor", "ceil", "round", "trunc", "real", "select"),
    *("gt", "ge", "lt", "le", "eq", "ne", "and", "or", "xor", "not", "is_finite"),
}

#: Operations whose result is finite whenever their arguments are.
TOTAL = EXACT_OPERATIONS | {
    *("const", "input", "add", "sub", "mul", "sin", "cos", "atan", "tanh", "asinh", "exp"),
    *("sinh", "cosh", "exp2", "expm1", "logistic", "cbrt", "erf", "erfc", "away"),
}


class FixedGraph(Graph):
    """A graph in which constants are not rounded.

    ``0 * a`` becomes 0 if ``a`` is certainly finite. With ``exact=False`` it always becomes 0, and
    so do ``0 / a`` and a choice between zeros: this is right for a derivative, which is needed only
    where the function is defined.
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
        sizes = [*map(math.prod, shapes)]
        return [
            np.array([next(ids) for _ in range(size)], dtype=np.int64).reshape(shape)
            for size, shape in zip(sizes, shapes, strict=True)
        ]


def _vanishes(op: str, values: Sequence[Any]) -> bool:
    """Whether an operation with these arguments, None if not constant, is zero where defined."""
    if op == "div":
        return bool(values[0] == 0)
    return op == "select" and bool(values[1] == 0 and values[2] == 0)


def _exact(op: str, values: Sequence[Any]) -> bool:
    """Whether the folded value of an operation is exact."""
    if op in EXACT_OPERATIONS:
        return True
    if op not in ("add", "sub", "mul") or not all(math.isfinite(v) for v in values):
        return False
    a, b = map(Fraction, values)
    exact = a + b if op == "add" else a - b if op == "sub" else a * b
    folded = fold(op, values)
    return folded is not None and Fraction(folded) == exact


def hides_derivatives(closed: Any) -> bool:
    """Whether a trace hides a derivative (``stop_gradient``) that proofs would need.

    Derivatives of a matrix factorisation are not needed if its factors only serve to solve
    equations.
    """
    return _hides(closed.jaxpr)


def _hides(jaxpr: Any) -> bool:
    held = (e for e in jaxpr.eqns if e.primitive.name == "stop_gradient")
    if any(not _solves(jaxpr, factors) for e in held for factors in _users(jaxpr, e)):
        return True
    return any(_hides(part) for e in jaxpr.eqns for part in _inner(e))


def _solves(jaxpr: Any, factors: Any) -> bool:
    """Whether an equation of a jaxpr computes the factors of a matrix, and these are only used to
    solve linear systems. False for None."""
    names = {factors.primitive.name} if factors is not None else set()
    names |= {e.primitive.name for part in _inner(factors) for e in part.eqns} if names else set()
    users = _users(jaxpr, factors) if names & {"lu", "cholesky"} else [None]
    return all(user is not None and user.primitive.name == "custom_linear_solve" for user in users)


def _users(jaxpr: Any, equation: Any) -> list[Any]:
    """The equations that use an equation's results, and None if the jaxpr returns them."""
    own = {id(var) for var in equation.outvars}
    found = [e for e in jaxpr.eqns if any(id(var) in own for var in e.invars)]
    return [*found, *([None] if any(id(var) in own for var in jaxpr.outvars) else [])]


def _inner(equation: Any) -> Iterator[Any]:
    """The jaxprs nested in an equation."""
    for inner in equation.params.values():
        for part in inner if isinstance(inner, tuple | list) else [inner]:
            part = getattr(part, "jaxpr", part)
            if hasattr(part, "eqns"):
                yield part
