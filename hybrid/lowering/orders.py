"""Order relations: argmax, sorting, and binary search in a table."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np

from .elements import mapped
from .graph import Graph, Ids

#: Largest sort that is written out; it needs one exchange per pair.
MOST_SORTED = 12

#: Tables up to this length are searched by nested choices, as JAX does, which have enclosures.
MOST_NESTED = 64


def largest(graph: Graph, equation: Any, x: Ids) -> Ids:
    """``argmax`` or ``argmin``; the first index in case of a tie."""
    flags = equation.invars[0].aval.dtype.kind == "b"
    op = "gt" if equation.primitive.name == "argmax" else "lt"
    (axis,) = equation.params["axes"]
    rows = np.moveaxis(x, axis, -1)
    found = [_first(graph, op, flags, row) for row in rows.reshape(-1, rows.shape[-1]).tolist()]
    return np.array(found, dtype=np.int64).reshape(rows.shape[:-1])


def _first(graph: Graph, op: str, flags: bool, row: list[int]) -> int:
    best, place = row[0], graph.const(0)
    for i, number in enumerate(row[1:], start=1):
        if not flags:
            better = graph.node(op, number, best)
        elif op == "gt":
            better = graph.node("and", number, graph.node("not", best))
        else:
            better = graph.node("and", best, graph.node("not", number))
        place = graph.node("select", better, graph.const(i), place)
        best = graph.node("select", better, number, best)
    return place


def in_order(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """A stable sort by the first operand, the others permuted along (bubble sort); None if there
    are several keys or too many numbers."""
    params = equation.params
    rows = [np.moveaxis(ids, params["dimension"], -1).copy() for ids in inputs]
    count = rows[0].shape[-1]
    if params["num_keys"] != 1 or count > MOST_SORTED:
        return None
    for last in range(count - 1, 0, -1):
        for i in range(last):
            wrong = mapped(graph, "gt", [rows[0][..., i], rows[0][..., i + 1]])
            for row in rows:
                first, second = row[..., i].copy(), row[..., i + 1].copy()
                row[..., i] = mapped(graph, "select", [wrong, second, first])
                row[..., i + 1] = mapped(graph, "select", [wrong, first, second])
    return [np.moveaxis(row, -1, params["dimension"]) for row in rows]


def searched(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``jnp.searchsorted`` in a long table, by binary search; None for other equations."""
    if not of_jax(equation, "searchsorted") or len(inputs) != 2:
        return None
    knots, numbers = inputs
    found = {"lt_to": "ge", "le_to": "gt"}
    passes = {found[name] for name in _primitives(equation.params["jaxpr"]) if name in found}
    if knots.ndim != 1 or len(knots) <= MOST_NESTED or len(passes) != 1:
        return None
    (op,) = passes
    table = graph.node("table", int(knots[0]), *knots.tolist())
    places = [_place(graph, table, len(knots), op, number) for number in numbers.reshape(-1)]
    return [np.array(places, dtype=np.int64).reshape(numbers.shape)]


def _place(graph: Graph, table: int, count: int, op: str, number: int) -> int:
    """Number of entries that ``number`` has passed; the table's first entry is a dummy."""
    place, step = graph.const(0), 1 << count.bit_length() >> 1
    while step:
        further = graph.node("add", place, graph.const(step))
        passed = graph.node(op, int(number), graph.node("knot", table, further))
        place = graph.node("select", passed, further, place)
        step //= 2
    return graph.node("min", place, graph.const(count))


def of_jax(equation: Any, name: str) -> bool:
    """Whether an equation calls the ``jax.numpy`` function of this name."""
    params = equation.params
    if params.get("name") != name or not hasattr(params.get("jaxpr"), "jaxpr"):
        return False
    source = params["jaxpr"].jaxpr.debug_info.func_filename or ""
    return "/jax/_src/numpy/" in source.replace("\\", "/")


def _primitives(closed: Any) -> Iterator[str]:
    for equation in closed.jaxpr.eqns:
        yield equation.primitive.name
        inner = (value for value in equation.params.values() if hasattr(value, "jaxpr"))
        yield from chain.from_iterable(map(_primitives, inner))
