"""Piecewise formulas: the deciding function, and the formula on each side of its zero."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

import numpy as np

from .derivatives import node_shape
from .graph import WHOLE_VALUED, Graph, needed, rebuilt, states_in
from .python import Program

#: The result of an operation where its deciding function is positive (``above``) or negative.
CHOICES: dict[str, Callable[..., int]] = {
    "abs": lambda graph, above, a: a if above else graph.node("neg", a),
    "sign": lambda graph, above, a: graph.const(1.0 if above else -1.0),
    "max": lambda graph, above, a, b: a if above else b,
    "min": lambda graph, above, a, b: b if above else a,
    **dict.fromkeys(("gt", "ge"), lambda graph, above, *rest: graph.const(above)),
    **dict.fromkeys(("lt", "le"), lambda graph, above, *rest: graph.const(not above)),
}

#: Operations that at a zero of their deciding function have the formula of the negative side.
LOW_AT_ZERO = {"gt", "le"}

#: What the value does where an operation changes its formula: it jumps, has a corner (bends), or
#: becomes undefined (ends).
CHANGE_OF = {
    **dict.fromkeys(("gt", "ge", "lt", "le", "sign", "floor", "ceil", "trunc"), "jumps"),
    **dict.fromkeys(("round", "away", "rem"), "jumps"),
    **dict.fromkeys(("abs", "max", "min"), "bends"),
    **dict.fromkeys(("sqrt", "log", "log1p", "acosh", "asin", "acos", "atanh"), "ends"),
}

#: If two operations change at the same place, the first of these counts.
_SEVERITY = ("ends", "jumps", "bends")

#: Number of random points at which the ratio of two functions must agree to count as constant.
RATIO_SAMPLES = 20


def choosers(graph: Graph, roots: Sequence[int], flows: bool = True) -> list[int]:
    """Functions whose sign selects the formula of a node, arguments first. ``flows``: only those
    that change along a flow, not those of parameters alone."""
    nodes = [graph.nodes[number] for number in needed(graph, roots)]
    found = [decider_of(graph, op, rest) for op, *rest in nodes if op in CHOICES]
    return list(dict.fromkeys(n for n in found if not flows or graph.flows(n)))


def one_sided(graph: Graph, roots: Sequence[int], signs: Mapping[int, int]) -> list[int]:
    """Nodes with the formulas that hold where deciding functions have the given signs.

    ``signs`` maps functions of :func:`choosers`, in their order, to signs. These functions, with
    their own formulas there, are appended to the result.
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
    """The function at whose zeros an operation changes its formula."""
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
    """A gap with the formula that holds where it is zero, if it has a corner there.

    It has a corner, as a distance ``|u|`` does, if its formulas are multiples of the deciding
    function and positive on either side of the zero.

    Parameters
    ----------
    size : int
        Number of states.
    numbers
        Any parameter values.
    """
    for decider, side in _belongs(graph, gap).items():
        formulas = [one_sided(graph, [gap], {decider: sign})[0] for sign in (1, -1)]
        values = Program(graph, ["t", "x"], size, np.array([decider, *formulas])).bind(numbers)
        above, below = _ratios(values, size)
        if above > 0 > below:
            gap = formulas[0] if side > 0 else formulas[1]
    return gap


def _belongs(graph: Graph, root: int) -> dict[int, int]:
    """For each function of :func:`choosers`, the sign of the side that includes its zero.

    Functions whose zero belongs to both sides, as with ``u > 0`` and ``u >= 0`` in one node, are
    left out.
    """
    sides: dict[int, set[int]] = {}
    for op, *rest in (graph.nodes[number] for number in needed(graph, [root])):
        if op in CHOICES:
            sides.setdefault(decider_of(graph, op, rest), set()).add(-1 if op in LOW_AT_ZERO else 1)
    return {n: min(sides[n]) for n in choosers(graph, [root]) if len(sides[n]) == 1}


def _ratios(values: Callable[..., tuple[float, ...]], size: int) -> tuple[float, float]:
    """The constant ratios of two functions to a first one; NaN if they are not constant."""
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
    """Functions at whose zeros nodes change their formula, with the kind of change."""
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
    """One deciding function for all steps of a binary search; other functions are unchanged."""
    op, *arguments = graph.nodes[decider]
    if op == "sub" and (knot := graph.nodes[arguments[1]])[0] == "knot":
        return graph.node("wave", arguments[0], knot[1])
    return decider


def _steps(graph: Graph, order: Sequence[int]) -> set[int]:
    """Piecewise constant nodes, which jump only where their arguments do."""
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


class Decider(NamedTuple):
    """A function at whose zeros nodes change their formula (see :class:`.field.Kink`).

    ``node``: its node; ``under``: the nodes of others that choose its own formula, by their places
    among all.
    """

    program: Program
    affine: bool
    elements: tuple[int, ...]
    change: str
    node: int
    under: dict[int, list[int]]


def deciders(graph: Graph, size: int, roots: Sequence[int]) -> list[Decider]:
    """The result of :func:`deciding`, with programs."""
    own = deciding(graph, roots)
    found = {_wave(graph, number): change for number, change in own.items()}
    places = {number: place for place, number in enumerate(found)}
    made = []
    for number, change in found.items():
        under: dict[int, list[int]] = {}
        for chooser in choosers(graph, [number]):
            if chooser in own:
                under.setdefault(places[_wave(graph, chooser)], []).append(chooser)
        program = Program(graph, ["t", "x"], size, np.array(number))
        made.append(Decider(program, *node_shape(graph, number), change, number, under))
    return made


def above(graph: Graph, size: int, decider: Decider, places: Iterable[int]) -> Program:
    """A deciding function with the formula of the positive side of those at some places."""
    signs = {number: 1 for place in places for number in decider.under[place]}
    node, *_ = one_sided(graph, [decider.node], dict(sorted(signs.items())))
    return Program(graph, ["t", "x"], size, np.array(node))


def _never_negative(graph: Graph, number: int) -> bool:
    """Whether a node cannot be negative by construction, as a sum of squares."""
    op, *arguments = graph.nodes[number]
    if op == "const":
        return bool(arguments[0] >= 0)
    if op == "mul" and arguments[0] == arguments[1]:
        return True
    if op in ("add", "mul", "div", "max", "real"):
        return all(_never_negative(graph, a) for a in arguments)
    return op in ("abs", "exp", "exp2", "sqrt", "cosh", "logistic")
