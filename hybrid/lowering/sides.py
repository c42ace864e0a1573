"""Formulas that change where a function is zero: the function, and the formula on each side."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any

import numpy as np

from .derivatives import node_shape
from .graph import WHOLE_VALUED, Graph, needed, rebuilt, states_in
from .python import Program

#: What an operation is where the function that decides is above zero, or below.
CHOICES: dict[str, Callable[..., int]] = {
    "abs": lambda graph, above, a: a if above else graph.node("neg", a),
    "sign": lambda graph, above, a: graph.const(1.0 if above else -1.0),
    "max": lambda graph, above, a, b: a if above else b,
    "min": lambda graph, above, a, b: b if above else a,
    **dict.fromkeys(("gt", "ge"), lambda graph, above, *rest: graph.const(above)),
    **dict.fromkeys(("lt", "le"), lambda graph, above, *rest: graph.const(not above)),
}

#: Operations that have the formula of below zero where the function that decides is zero.
LOW_AT_ZERO = {"gt", "le"}

#: What becomes of a value where an operation changes its formula: it may jump, or bends only, or
#: has no value beyond.
CHANGE_OF = {
    **dict.fromkeys(("gt", "ge", "lt", "le", "sign", "floor", "ceil", "trunc"), "jumps"),
    **dict.fromkeys(("round", "away", "rem"), "jumps"),
    **dict.fromkeys(("abs", "max", "min"), "bends"),
    **dict.fromkeys(("sqrt", "log", "log1p", "acosh", "asin", "acos", "atanh"), "ends"),
}

#: Of two operations that change at one place the one that says more.
_SEVERITY = ("ends", "jumps", "bends")

#: Random points at which the ratio of two functions is taken: what is one number there is one.
RATIO_SAMPLES = 20


def choosers(graph: Graph, roots: Sequence[int]) -> list[int]:
    """Functions by whose sign nodes take one formula or another, arguments first."""
    nodes = [graph.nodes[number] for number in needed(graph, roots)]
    found = [decider_of(graph, op, rest) for op, *rest in nodes if op in CHOICES]
    return list(dict.fromkeys(number for number in found if graph.flows(number)))


def one_sided(graph: Graph, roots: Sequence[int], signs: Mapping[int, int]) -> list[int]:
    """Nodes with the formulas that they have where some functions have these signs.

    ``signs`` are of :func:`choosers`, in their order. Behind the nodes follow these functions
    themselves, with the formulas that they have there.
    """
    nodes = [*roots, *signs]
    for place, sign in enumerate(signs.values(), start=len(roots)):
        decider = nodes[place]

        def chosen(node: tuple[Any, ...], decider: int = decider, sign: int = sign) -> int | None:
            op, *rest = node
            own = op in CHOICES and decider_of(graph, op, rest) == decider
            return CHOICES[op](graph, sign > 0, *rest) if own else None

        nodes = rebuilt(graph, nodes, chosen)
    return nodes


def decider_of(graph: Graph, op: str, arguments: list[int]) -> int:
    """The function whose zeros are the places at which an operation changes its formula."""
    a, *rest = arguments
    if op in ("gt", "ge", "lt", "le", "max", "min"):
        return graph.node("sub", a, rest[0])
    if op in ("floor", "ceil", "trunc", "round", "away", "rem"):
        turns = graph.node("div", a, rest[0]) if rest else a
        wave = "cos" if op in ("round", "away") else "sin"
        return graph.node(wave, graph.node("mul", graph.const(math.pi), turns))
    if op in ("log1p", "acosh"):
        return graph.node("add" if op == "log1p" else "sub", a, graph.const(1.0))
    if op in ("asin", "acos", "atanh"):
        return graph.node("sub", graph.const(1.0), graph.node("mul", a, a))
    return a


def on_zero(graph: Graph, size: int, gap: int, numbers: Sequence[float]) -> int:
    """A gap with the formula that it has where it is zero, if it has a corner there.

    It has one, as a distance ``|u|`` has, where its formulas are multiples of the function that
    decides between them, and positive on either side of its zero.

    Parameters
    ----------
    size : int
        Number of states.
    numbers
        Any values of the parameters.
    """
    for decider, side in _belongs(graph, gap).items():
        formulas = [one_sided(graph, [gap], {decider: sign})[0] for sign in (1, -1)]
        values = Program(graph, ["t", "x"], size, np.array([decider, *formulas])).bind(numbers)
        above, below = _ratios(values, size)
        if above > 0 > below:
            gap = formulas[0] if side > 0 else formulas[1]
    return gap


def _belongs(graph: Graph, root: int) -> dict[int, int]:
    """For each function of :func:`choosers` the sign of the side to which its zero belongs.

    Not of one whose zero belongs to either, as that of ``u > 0`` and ``u >= 0`` in one node.
    """
    sides: dict[int, set[int]] = {}
    for op, *rest in (graph.nodes[number] for number in needed(graph, [root])):
        if op in CHOICES:
            sides.setdefault(decider_of(graph, op, rest), set()).add(-1 if op in LOW_AT_ZERO else 1)
    return {n: min(sides[n]) for n in choosers(graph, [root]) if len(sides[n]) == 1}


def _ratios(values: Callable[..., tuple[float, ...]], size: int) -> tuple[float, float]:
    """The constant ratios of two functions to a first one; not a number where they are none."""
    draw, found = Random(0), set()
    for _ in range(RATIO_SAMPLES):
        x = [draw.uniform(-1.5, 1.5) for _ in range(size)]
        own, *others = values(draw.uniform(0.0, 1.5), x)
        if not own or not all(map(math.isfinite, others)):
            return math.nan, math.nan
        found.add(tuple(float(f"{other / own:.9g}") for other in others))
    above, below = found.pop()
    return (math.nan, math.nan) if found else (above, below)


def deciding(graph: Graph, roots: Sequence[int]) -> dict[int, str]:
    """Functions at whose zeros nodes change their formula, arguments first, and how each does
    there (:data:`CHANGE_OF`)."""
    found: dict[int, str] = {}
    order = needed(graph, roots)
    still = _steps(graph, order)
    for number in order:
        op, *arguments = graph.nodes[number]
        if op in CHANGE_OF:
            if still.issuperset(arguments):
                continue
            decider = decider_of(graph, op, arguments)
            ends = CHANGE_OF[op] == "ends" and not _never_negative(graph, decider)
            moves = states_in(graph, decider) and graph.flows(decider)
            if moves and (ends or CHANGE_OF[op] != "ends"):
                found[decider] = min(
                    found.get(decider, "jumps"), CHANGE_OF[op], key=_SEVERITY.index
                )
    return found


def _wave(graph: Graph, decider: int) -> int:
    """Of a search by halves what decides on them all."""
    op, *arguments = graph.nodes[decider]
    if op == "sub" and (knot := graph.nodes[arguments[1]])[0] == "knot":
        return graph.node("wave", arguments[0], knot[1])
    return decider


def _steps(graph: Graph, order: Sequence[int]) -> set[int]:
    """Nodes that change in jumps only, which is where what they are made of changes."""
    found: set[int] = set()
    for number in order:
        op, *arguments = graph.nodes[number]
        if op == "select":
            arguments = arguments[1:]
        elif op in WHOLE_VALUED or op in ("floor", "ceil", "round", "away"):
            arguments = []
        if op == "const" or (op != "input" and all(a in found for a in arguments)):
            found.add(number)
    return found


def deciders(
    graph: Graph, size: int, roots: Sequence[int]
) -> list[tuple[Program, bool, tuple[int, ...], str]]:
    """The same as (program, affine, elements, change)."""
    found = {_wave(graph, number): change for number, change in deciding(graph, roots).items()}
    return [
        (Program(graph, ["t", "x"], size, np.array(number)), *node_shape(graph, number), change)
        for number, change in found.items()
    ]


def _never_negative(graph: Graph, number: int) -> bool:
    """Whether a node is a sum or product of squares and the like, as a distance is."""
    op, *arguments = graph.nodes[number]
    if op == "const":
        return bool(arguments[0] >= 0)
    if op == "mul" and arguments[0] == arguments[1]:
        return True
    if op in ("add", "mul", "div", "max", "real"):
        return all(_never_negative(graph, a) for a in arguments)
    return op in ("abs", "exp", "exp2", "sqrt", "cosh", "logistic")
