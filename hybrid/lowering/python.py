"""A reader of the trace: scalar Python functions, as fast as hand-written ones.

The generated source is compiled once for a class; ``bind`` gives it the values of the
parameters, and what depends on parameters alone is computed there and then. Python's
``math`` raises where IEEE arithmetic gives ``inf`` or ``nan`` (also in the branch of a
``where`` that is not taken); such a call is answered by the same source run on numpy
scalars, which do not raise.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import FlowError
from .graph import Graph, Ids

Scalar = Callable[..., Any]


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
            factor = rows[i][k] / rows[k][k]
            rows[i] = [p - factor * q for p, q in zip(rows[i], rows[k], strict=True)]
    solution: list[Any] = [0.0] * size
    for i in reversed(range(size)):
        known = sum(rows[i][k] * solution[k] for k in range(i + 1, size))
        solution[i] = (rows[i][-1] - known) / rows[i][i]
    return solution


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
}

#: Operations written in place; ``{0}``, ``{1}``, ``{2}`` are the arguments.
TEMPLATES = {
    "add": "({0} + {1})",
    "sub": "({0} - {1})",
    "mul": "({0} * {1})",
    "div": "({0} / {1})",
    "neg": "(-{0})",
    "gt": "({0} > {1})",
    "ge": "({0} >= {1})",
    "lt": "({0} < {1})",
    "le": "({0} <= {1})",
    "eq": "({0} == {1})",
    "ne": "({0} != {1})",
    "and": "({0} & {1})",
    "or": "({0} | {1})",
    "not": "(not {0})",
    "select": "({1} if {0} else {2})",
}

#: The same operations on numpy scalars, where the plain ones would raise.
_FORGIVING: dict[str, Callable[..., Any]] = {
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


def literal(value: Any) -> str:
    """A constant as Python source."""
    if isinstance(value, float) and not math.isfinite(value):
        return {math.inf: "_inf", -math.inf: "(-_inf)"}.get(value, "_nan")
    return f"({value!r})" if str(value).startswith("-") else repr(value)


def needed(graph: Graph, roots: Sequence[int]) -> list[int]:
    """The nodes that the roots depend on, arguments first."""
    seen: set[int] = set()
    stack = list(roots)
    while stack:
        number = stack.pop()
        if number not in seen:
            seen.add(number)
            node = graph.nodes[number]
            if node[0] not in ("const", "input"):
                stack.extend(node[1:])
    return sorted(seen)


class Program:
    """Generated scalar code of some expressions of ``(t, x, *extra)``.

    Parameters
    ----------
    graph : Graph
    inputs : sequence of str
        Arguments of the function, e.g. ``("t", "x")``; ``x`` is unpacked to ``x0, x1, ...``.
    size : int
        Length of ``x``.
    outputs : array of node numbers
        A single number gives a function that returns a float, an array one that returns
        a tuple.
    """

    def __init__(self, graph: Graph, inputs: Sequence[str], size: int, outputs: Ids) -> None:
        self.source, self._foreign = _source(graph, inputs, size, outputs), graph.foreign
        self._code = compile(self.source, "<hybrid: generated>", "exec")
        self._maker: Scalar | None = None

    def bind(self, parameters: Sequence[float]) -> Scalar:
        """The function for these values of the (flattened) parameters."""
        forgiving: list[Scalar] = []

        def fallback(*arguments: Any) -> Any:
            with np.errstate(all="ignore"):
                if not forgiving:
                    wide = [np.float64(p) for p in parameters]
                    forgiving.append(self._make(_FORGIVING)(_never, *wide))
                return _plain(forgiving[0](*map(_numpy, arguments)))

        if self._maker is None:
            self._maker = self._make(OPERATIONS | LONG)
        try:
            return self._maker(fallback, *parameters)
        except (ValueError, OverflowError, ZeroDivisionError):
            return fallback

    def _make(self, operations: Any) -> Scalar:
        scope = {f"_{name}": function for name, function in operations.items()}
        scope.update(_inf=math.inf, _nan=math.nan, _foreign=self._called)
        exec(self._code, scope)
        return scope["_make"]

    def _called(self, number: int, *arguments: float) -> list[float]:
        return self._foreign[number](*arguments)


def _never(*arguments: Any) -> Any:
    raise FlowError("the generated code raises even on numpy scalars")


def _numpy(argument: Any) -> Any:
    return (
        [np.float64(v) for v in argument] if hasattr(argument, "__len__") else np.float64(argument)
    )


def _plain(result: Any) -> Any:
    return tuple(map(float, result)) if isinstance(result, tuple) else float(result)


def _source(graph: Graph, inputs: Sequence[str], size: int, outputs: Ids) -> str:
    flat = [int(i) for i in outputs.reshape(-1)]
    order = needed(graph, flat)
    fixed, uses = _fixed(graph, order), _uses(graph, order, flat)
    text: dict[int, str] = {}
    before, body = [], []
    for number in order:
        node = graph.nodes[number]
        if node[0] == "const":
            text[number] = literal(node[1])
        elif node[0] == "input":
            text[number] = node[1]
        else:
            expression = _expression(node, text)
            if number in fixed:
                before.append(f"n{number} = {expression}")
                text[number] = f"n{number}"
            elif uses[number] == 1 and len(expression) < 200:
                text[number] = expression
            else:
                body.append(f"n{number} = {expression}")
                text[number] = f"n{number}"
    names = sorted(
        (n[1] for n in graph.nodes if n[0] == "input" and n[1].startswith("p")), key=_index
    )
    count = 1 + max((_index(n) for n in names), default=-1)
    unpack = [", ".join(f"x{i}" for i in range(size)) + ", = x"] if "x" in inputs and size else []
    result = ", ".join(text[i] for i in flat)
    result = result if outputs.shape == () else f"({result},)"
    head = "".join(f"p{i}, " for i in range(count))
    lines = [f"def _make(_fallback, {head}*_rest):"]
    lines += [f"    {line}" for line in before]
    lines += [f"    def function({', '.join(inputs)}):"]
    lines += ["        try:"]
    lines += [f"            {line}" for line in [*unpack, *body, f"return {result}"]]
    lines += ["        except (ValueError, OverflowError, ZeroDivisionError):"]
    lines += [f"            return _fallback({', '.join(inputs)})"]
    return "\n".join([*lines, "    return function", ""])


def _index(name: str) -> int:
    return int(name[1:])


def _expression(node: tuple[Any, ...], text: dict[int, str]) -> str:
    arguments = [text[a] for a in node[1:]]
    if node[0] in TEMPLATES:
        return TEMPLATES[node[0]].format(*arguments)
    return f"_{node[0]}({', '.join(arguments)})"


def _fixed(graph: Graph, order: Sequence[int]) -> set[int]:
    """Nodes that depend on parameters and constants only."""
    fixed: set[int] = set()
    for number in order:
        op, *arguments = graph.nodes[number]
        if op == "input":
            steady = arguments[0].startswith("p")
        else:
            steady = op == "const" or all(a in fixed for a in arguments)
        if steady:
            fixed.add(number)
    return fixed


def _uses(graph: Graph, order: Sequence[int], roots: Sequence[int]) -> dict[int, int]:
    uses = dict.fromkeys(order, 0)
    for number in order:
        node = graph.nodes[number]
        if node[0] not in ("const", "input"):
            for argument in node[1:]:
                uses[argument] += 1
    for root in roots:
        uses[root] += 1
    return uses
