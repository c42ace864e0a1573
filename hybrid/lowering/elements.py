"""Elementwise operations on arrays of nodes, and choices among whole numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from .graph import Graph, Ids

#: Largest number of known whole numbers, e.g. table indices, among which a choice is written out
#: case by case; two such choices together may have that many each. A binary search for an index
#: makes choices whose steps share their conditions.
MOST_CHOICES = 64


def constant(graph: Graph, value: Any) -> Ids:
    array = np.asarray(value)
    flat = [graph.const(element) for element in array.reshape(-1)]
    return np.array(flat, dtype=np.int64).reshape(array.shape)


def mapped(graph: Graph, op: str, inputs: list[Ids]) -> Ids:
    return each(partial(distributed, graph, partial(graph.node, op)), *inputs)


def each(make: Callable[..., int], *inputs: Ids) -> Ids:
    """An array of ``make(*elements)`` over the broadcast inputs."""
    arrays = np.broadcast_arrays(*inputs)
    rows = zip(*(a.reshape(-1).tolist() for a in arrays), strict=True)
    return np.array([make(*row) for row in rows], dtype=np.int64).reshape(arrays[0].shape)


def quotient(graph: Graph, op: str, *arguments: int) -> int:
    """The integer quotient (``div``) or remainder (``rem``) of whole numbers."""

    def make(a: int, b: int) -> int:
        x, y = graph.value(a), graph.value(b)
        if x is None or not y:
            return graph.node("trunc", graph.node(op, a, b))
        quotient = abs(x) // abs(y) * (1 if x * y >= 0 else -1)
        return graph.const(quotient if op == "div" else x - y * quotient)

    return distributed(graph, make, *arguments)


def unsigned(graph: Graph, bits: int, value: int) -> int:
    """A whole number as unsigned: ``2**bits`` is added to a negative one."""
    if (known := graph.value(value)) is not None:
        return value if known >= 0 else graph.const(known + 2**bits)
    below = graph.node("lt", value, graph.const(0.0))
    return graph.node("select", below, graph.node("add", value, graph.const(2.0**bits)), value)


def distributed(graph: Graph, make: Callable[..., int], *arguments: int) -> int:
    """``make(*arguments)``, distributed over choices among whole numbers."""
    condition = choosing(graph, arguments)
    if condition is None:
        return make(*arguments)
    cases = [[taken(graph, condition, way, a) for a in arguments] for way in (1, 0)]
    yes, no = (distributed(graph, make, *case) for case in cases)
    return yes if yes == no else graph.node("select", condition, yes, no)


def choosing(graph: Graph, numbers: Sequence[int]) -> int | None:
    """The first condition among choices of whole numbers; None if there are none or too many."""
    counts = [graph.leaves(number) for number in numbers]
    if not few(counts):
        return None
    several = (n for n, count in zip(numbers, counts, strict=True) if count > 1)
    return next((graph.nodes[n][1] for n in several), None)


def few(counts: Sequence[int]) -> bool:
    """Whether all nodes are whole numbers or choices among few of them."""
    return 0 < math.prod(counts) <= MOST_CHOICES**2 and max(counts, default=1) <= MOST_CHOICES


def taken(graph: Graph, condition: int, way: int, number: int) -> int:
    """A choice, given that ``condition`` holds (``way=1``) or fails (``way=0``)."""
    if graph.leaves(number) <= 1:
        return number
    _, which, *cases = graph.nodes[number]
    yes, no = (taken(graph, condition, way, case) for case in cases)
    if which == condition:
        return yes if way else no
    return yes if yes == no else graph.node("select", which, yes, no)
