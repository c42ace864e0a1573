"""Generates scalar Python functions from the graph, as fast as hand-written ones.

The source is compiled once per class. ``bind`` inserts the parameter values and evaluates at once
what depends on parameters only. Python's ``math`` raises where IEEE arithmetic gives ``inf`` or
``nan``, also in a ``where`` branch that is not taken; such calls are repeated by the same source on
numpy scalars, which do not raise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import FlowError
from .arithmetic import FORGIVING, LONG, OPERATIONS
from .graph import Graph, Ids, needed

Scalar = Callable[..., Any]


#: Operations written inline; ``{0}``, ``{1}``, ``{2}`` are the arguments.
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


def literal(value: Any) -> str:
    """A constant as Python source."""
    if isinstance(value, float) and not math.isfinite(value):
        return {math.inf: "_inf", -math.inf: "(-_inf)"}.get(value, "_nan")
    return f"({value!r})" if str(value).startswith("-") else repr(value)


class Program:
    """Generated scalar code of some expressions of ``(t, x, *extra)``.

    ``uses``: which parameters it depends on.

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
        used = [graph.nodes[i] for i in needed(graph, outputs.reshape(-1).tolist())]
        own = {node[1] for node in used if node[0] == "input" and node[1].startswith("p")}
        self.uses = sorted(map(_index, own))
        self._code = compile(self.source, "<hybrid: generated>", "exec")
        self._maker: Scalar | None = None

    def bind(self, parameters: Sequence[float]) -> Scalar:
        """The function for these (flattened) parameter values."""
        forgiving: list[Scalar] = []

        def fallback(*arguments: Any) -> Any:
            with np.errstate(all="ignore"):
                if not forgiving:
                    wide = [np.float64(p) for p in parameters]
                    forgiving.append(self._make(FORGIVING)(_never, *wide))
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
            known = all(graph.nodes[a][0] == "const" for a in node[1:])
            expression = _expression(node, text, known)
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


def _expression(node: tuple[Any, ...], text: dict[int, str], known: bool) -> str:
    """A node as source; ``known``: of constants, which have stayed as they are no number."""
    arguments = [text[a] for a in node[1:]]
    if node[0] in TEMPLATES and not (known and node[0] == "div"):
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
