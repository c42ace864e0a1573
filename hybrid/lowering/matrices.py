"""Linear algebra on small matrices, written as arithmetic on the elements.

A library solves ``A y = b`` by factors of ``A``, but the dependence on time and state is visible in
the equations themselves. Up to three equations are solved by determinants; more become one node
(``docs/notes/tape.md``), as the equations of contact forces do. The factors remain as unused nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from .derivatives import parts, solved
from .graph import WRITTEN_TERMS, Graph, Ids
from .orders import of_jax

if TYPE_CHECKING:
    from ..automaton.shapes import MaskMatrix

#: Reads a closed jaxpr into nodes (:mod:`.jaxpr`).
Read = Callable[[Graph, Any, list[Ids]], list[Ids]]

#: Most unknowns solved by determinants; for four, elimination needs fewer products.
BY_DETERMINANTS = 3

#: Largest matrix whose determinant is written out: it has 255 minors.
LARGEST_DETERMINANT = 8


def linear_solve(graph: Graph, params: Any, inputs: list[Ids], read: Read) -> list[Ids]:
    """The solution of ``A y = b``, where a jaxpr gives the product of ``A`` with a vector."""
    counts = params["const_lengths"]
    matvec, own = params["jaxprs"].matvec, inputs[: counts.matvec]
    rights = inputs[sum(counts) :]
    matrix = _matrix(graph, matvec, read, own, [r.shape for r in rights])
    found = _solved(graph, matrix, np.concatenate([r.reshape(-1) for r in rights]))
    ends = np.cumsum([r.size for r in rights])[:-1]
    return [f.reshape(r.shape) for f, r in zip(np.split(found, ends), rights, strict=True)]


def _matrix(
    graph: Graph, matvec: Any, read: Read, own: list[Ids], shapes: list[tuple[int, ...]]
) -> Ids:
    """The matrix of a linear function, from its values at the unit vectors.

    It is read in a graph of its own, with its matrices as inputs. That graph is not exact, so sums
    with 0 and products with 1 reduce to the elements that the unit vectors select.
    """
    alone, names = Graph(), [i for ids in own for i in ids.reshape(-1).tolist()]
    given = iter([alone.input(f"a{k}") for k in range(len(names))])
    inputs = [np.array([next(given) for _ in range(i.size)], int).reshape(i.shape) for i in own]
    sizes = [math.prod(shape) for shape in shapes]
    columns = []
    for unit in np.eye(sum(sizes)):
        vectors = np.array([alone.const(v) for v in unit.tolist()])
        pieces = np.split(vectors, np.cumsum(sizes)[:-1])
        vector = [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]
        results = read(alone, matvec, [*inputs, *vector])
        columns.append(np.concatenate([ids.reshape(-1) for ids in results]))
    known = dict(enumerate(names))
    translated = [[_there(graph, alone, known, i) for i in column] for column in columns]
    return np.array(translated).T


def _there(graph: Graph, alone: Graph, known: dict[int, int], number: int) -> int:
    """A node of the matrix's own graph, copied into the graph of the flow."""
    op, *arguments = alone.nodes[number]
    if op == "input":
        return known[int(arguments[0][1:])]
    if op == "const":
        return graph.const(arguments[0])
    return graph.node(op, *(_there(graph, alone, known, a) for a in arguments))


def _solved(graph: Graph, matrix: Ids, right: Ids) -> Ids:
    """Solve the system, each independent block separately."""
    found = np.zeros(len(right), dtype=np.int64)
    for group in _groups(np.vectorize(lambda i: graph.value(i) != 0)(matrix)):
        rows, values = matrix[np.ix_(group, group)].tolist(), right[group].tolist()
        found[group] = _together(graph, rows, values)
    return found


def _groups(linked: MaskMatrix) -> list[list[int]]:
    count, numbers = connected_components(linked, directed=False)
    return [np.flatnonzero(numbers == number).tolist() for number in range(count)]


def _together(graph: Graph, matrix: list[list[int]], right: list[int]) -> list[int]:
    n = len(right)
    if n > BY_DETERMINANTS:
        equations = solved(graph, matrix, right, [graph.const(1.0)] * n)
        return parts(graph, equations, n)
    whole = _determinant(graph, matrix)
    replaced = [
        [[*row[:j], b, *row[j + 1 :]] for row, b in zip(matrix, right, strict=True)]
        for j in range(n)
    ]
    return [graph.node("div", _determinant(graph, each), whole) for each in replaced]


def determinants(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``jnp.linalg.det`` and ``slogdet`` of a matrix, and their rates beside them; None where an
    equation is no such.

    JAX computes them by pivoted factors; products need no pivoting, hence no choices.
    """
    det = of_jax(equation, "det")
    if not (det or of_jax(equation, "slogdet")):
        return None
    matrix, rated, each = inputs[0], len(inputs) == 2, 1 if det else 2
    if len(inputs) > 2 or len(equation.outvars) != each * len(inputs):
        return None
    if matrix.ndim != 2 or not (BY_DETERMINANTS if det else 0) < len(matrix) <= LARGEST_DETERMINANT:
        return None
    value = _determinant(graph, matrix.tolist())
    size, sign = graph.node("log", graph.node("abs", value)), graph.node("sign", value)
    found = [value] if det else [sign, size]
    if rated:
        rate = _rate(graph, matrix, inputs[1])
        found += [rate] if det else [graph.const(0.0), graph.node("div", rate, value)]
    return [np.array(n) for n in found]


def _rate(graph: Graph, matrix: Ids, rates: Ids) -> int:
    """The rate of a determinant: those of its rows, one after the other."""
    rows = matrix.tolist()
    each = ([*rows[:i], rates[i].tolist(), *rows[i + 1 :]] for i in range(len(rows)))
    return graph.total([_determinant(graph, replaced) for replaced in each])


def _determinant(graph: Graph, matrix: list[list[int]]) -> int:
    """The determinant by minors of the last rows; larger minors share the smaller ones."""
    size = len(matrix)
    minors: dict[tuple[int, ...], int] = {(j,): number for j, number in enumerate(matrix[-1])}
    for row in reversed(matrix[:-1]):
        minors = {
            columns: _expanded(graph, row, columns, minors)
            for columns in combinations(range(size), len(next(iter(minors))) + 1)
        }
    return minors[tuple(range(size))]


def _expanded(
    graph: Graph, row: list[int], columns: tuple[int, ...], minors: dict[tuple[int, ...], int]
) -> int:
    """A minor, expanded along its first row."""
    rest = [minors[columns[:k] + columns[k + 1 :]] for k in range(len(columns))]
    pairs = [(row[j], minor) for j, minor in zip(columns, rest, strict=True)]
    if len(pairs) <= WRITTEN_TERMS:
        return graph.node("sub", graph.dot(pairs[::2]), graph.dot(pairs[1::2]))
    turned = [(graph.node("neg", number), minor) for number, minor in pairs[1::2]]
    return graph.dot([*pairs[::2], *turned])


def triangular_solve(graph: Graph, params: Any, a: Ids, b: Ids) -> Ids:
    """Solve ``A X = B`` or ``X A = B`` for triangular ``A`` by substitution."""
    if not params["left_side"]:
        turned = {**params, "left_side": True, "transpose_a": not params["transpose_a"]}
        return triangular_solve(graph, turned, a, b.swapaxes(-1, -2)).swapaxes(-1, -2)
    lower = bool(params["lower"])
    if params["transpose_a"]:
        a, lower = a.swapaxes(-1, -2), not lower
    result = np.zeros(b.shape, dtype=np.int64)
    for place in np.ndindex(b.shape[:-2]):
        for column in range(b.shape[-1]):
            at = (*place, slice(None), column)
            result[at] = _substituted(graph, a[place], b[at], lower, bool(params["unit_diagonal"]))
    return result


def _substituted(graph: Graph, a: Ids, b: Ids, lower: bool, unit: bool) -> list[int]:
    found: dict[int, int] = {}
    size = range(len(b))
    for i in size if lower else reversed(size):
        known = graph.dot([(int(a[i, j]), y) for j, y in found.items()])
        value = graph.node("sub", int(b[i]), known)
        found[i] = value if unit else graph.node("div", value, int(a[i, i]))
    return [found[i] for i in size]


def cholesky(graph: Graph, params: Any, a: Ids) -> Ids:
    """The Cholesky factor ``L`` of a matrix ``L L^T``, zero above the diagonal."""
    result = np.full(a.shape, graph.const(0.0))
    for place in np.ndindex(a.shape[:-2]):
        lower = result[place]
        for i in range(a.shape[-1]):
            for j in range(i + 1):
                pairs = [(int(lower[i, k]), int(lower[j, k])) for k in range(j)]
                left = graph.node("sub", int(a[(*place, i, j)]), graph.dot(pairs))
                root = int(lower[j, j])
                lower[i, j] = graph.node("sqrt", left) if i == j else graph.node("div", left, root)
    return result
