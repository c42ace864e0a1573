"""Local model of a mode: foreign functions replaced by second-degree Taylor polynomials.

Impacts are summed from Taylor series, and a flow with a foreign call has none. About a point, the
function is replaced by its value, gradient and Hessian, which are inputs like the parameters. The
flow's tape is made once and given other numbers at each point. The caller checks how far the local
model is from the flow.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..errors import TraceError
from .graph import needed
from .mode import ModeGraph
from .python import Program

if TYPE_CHECKING:
    from .field import Field
    from .foreign import Foreign
    from .lowered import Lowered

#: Most arguments of a replaced function; the Hessian has about half their square entries.
MOST_ARGUMENTS = 12


class LocalGraph(ModeGraph):
    """The graph of a mode with foreign calls replaced by local polynomials."""

    def __init__(self, code: Lowered, mode: str) -> None:
        super().__init__(code, mode)
        self.kept = "near", mode
        self.first = sum(map(math.prod, code.shapes)) + len(self.mask)
        self.given = 0
        self.calls: list[tuple[Foreign, list[int], list[int]]] = []

    @cached_property
    def free(self) -> list[int]:
        """The flow without held contacts, with polynomials in place of foreign calls."""
        graph, roots = self.graph, self.values(self.code.field_closed(self.mode, ()))
        new: dict[int, int] = {}
        places: dict[int, dict[int, int]] = {}
        for number in needed(graph, roots):
            op, *arguments = graph.nodes[number]
            if op in ("const", "input"):
                new[number] = number
            elif op == "foreign":
                new[number], own = number, arguments[1:]
                places[number] = self._polynomials(number, own, [new[a] for a in own], roots)
            elif op == "part" and arguments[0] in places:
                new[number] = places[arguments[0]][int(graph.value(arguments[1]))]
            else:
                new[number] = graph.node(op, *(new[a] for a in arguments))
        return [new[root] for root in roots]

    def _polynomials(
        self, number: int, own: list[int], near: list[int], roots: list[int]
    ) -> dict[int, int]:
        """The polynomial of each result that the flow needs of a foreign call."""
        graph, size = self.graph, len(own)
        if size > MOST_ARGUMENTS:
            raise TraceError(f"a function of more than {MOST_ARGUMENTS} numbers is called")
        parts = [graph.nodes[n] for n in needed(graph, roots) if graph.nodes[n][0] == "part"]
        results = sorted({int(graph.value(i)) for _, call, i in parts if call == number})
        self.calls.append((graph.called_by(graph.nodes[number][1]), own, results))
        off = [graph.node("sub", a, c) for a, c in zip(near, self._numbers(size), strict=True)]
        pairs = [(i, j) for i in range(size) for j in range(i, size)]
        terms = [*off, *(graph.node("mul", off[i], off[j]) for i, j in pairs)]
        found = {}
        for result in results:
            value, *factors = self._numbers(1 + len(terms))
            change = graph.dot([*zip(factors, terms, strict=True)])
            found[result] = graph.node("add", value, change)
        return found

    def _numbers(self, count: int) -> list[int]:
        """New inputs, after the parameters and the mask."""
        begin = self.first + self.given
        self.given += count
        return [self.graph.input(f"p{begin + i}") for i in range(count)]

    @cached_property
    def _arguments(self) -> Program:
        nodes = [a for _, own, _ in self.calls for a in own]
        return Program(self.graph, ["t", "x"], len(self.x), np.array(nodes))

    def about(self, t: float, x: list[float], numbers: tuple[float, ...]) -> list[float]:
        """The coefficients of the polynomials about a point, in the order of their inputs."""
        unused = [0.0] * self.given
        values, found = list(self._arguments.bind([*numbers, *unused])(t, x)), list[float]()
        for function, own, results in self.calls:
            here, values = values[: len(own)], values[len(own) :]
            found += [*here, *_polynomial(function, here, results)]
        return found


def _polynomial(function: Foreign, here: list[float], results: list[int]) -> list[float]:
    """Per result: value, gradient, and Hessian entries ``i <= j``, the diagonal ones halved."""
    size, found = len(here), list[float]()
    value, slopes = function(*here), function.slopes(*here)
    bends = np.reshape(function.slopes.slopes(*here), (-1, size, size))
    share = np.triu(np.ones((size, size))) - 0.5 * np.eye(size)
    for i in results:
        curved = (bends[i] * share)[np.triu_indices(size)].tolist()
        found += [value[i], *slopes[i * size : i * size + size], *curved]
    return found


def near(field: Field, contact: str, t: float, x: list[float]) -> Field | None:
    """The local model of a field about an impact; None if it has no Taylor series."""
    code, held = field.code, bool(field.held)
    graph = code.near(field.mode)
    try:
        touching = frozenset([contact] if graph.cornered(contact) else [])
        tape = code.once(("near", field.mode, held, touching), lambda: graph.tape(held, touching))
    except TraceError:
        return None
    numbers = (*field.numbers, *graph.about(t, x, field.numbers))
    order = graph.watched(held)
    jets = tape.bind(numbers, [order.index(guard.edge) for guard in field.guards])
    return attrs.evolve(field, jets=jets, numbers=numbers, graph=graph)


def off(field: Field, column: int, t: float, x: list[float]) -> tuple[Any, float]:
    """Error of a local model at a point.

    Returns the absolute error of each rate, and the relative error of the gap's acceleration.
    """
    graph, held = field.graph, bool(field.held)
    name, guard = field.guards[column].edge, field.guards[column]
    flow = graph.program(("flow", held), lambda: graph.flow(held)).bind(field.numbers)
    lie = graph.program(("lie", name, held), lambda: graph.lie_on(name, held)).bind(field.numbers)
    force = guard.lie(t, x)[2]
    rates = np.abs(np.subtract(flow(t, x), field.rhs(t, x)))
    return rates, abs(lie(t, x)[2] - force) / abs(force) if force else float("inf")
