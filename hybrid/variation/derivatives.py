"""Derivatives of a model's flows, guards and resets, as scalar code.

Each is made of nodes of its mode's own graph (:mod:`hybrid.scene.derivatives`), once for a class,
and read like any other program: nothing is traced again. Columns are time first, then the elements
of the state; in a model with delays then what each lag shows of them; then, where they are asked
for, the elements of the parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np

from ..errors import TraceError
from ..scene import Field, Guard, Scene
from ..scene.derivatives import gradient
from ..scene.lowered import deciding
from ..scene.mode import ModeGraph
from ..scene.tape import Tape
from .series import Series

Matrix = Callable[[float, np.ndarray], np.ndarray]


class Derivatives:
    """The derivatives of one scene, made when first asked for.

    Attributes
    ----------
    size, count : int
        Elements of the state, and of the parameters if there are columns for them; with
        ``windows`` those of the windows of the past are among these.
    units : array, shape (count,)
        The sizes of the parameters; 1 where one is 0.
    """

    def __init__(self, scene: Scene, parameters: bool = False, windows: bool = False) -> None:
        self.scene, self.size = scene, scene.spec.dimension
        own = len(scene.code.shapes) - (0 if windows else len(scene.spec.windows))
        sizes = [int(np.prod(shape, dtype=int)) for shape in scene.code.shapes[:own]]
        self.count = sum(sizes) if parameters else 0
        self.columns = 1 + self.size * (1 + len(scene.spec.lags)) + self.count
        values = np.abs([v for p in scene.parameters[:own] for v in np.ravel(p)][: self.count])
        self.units = np.where(values > 0.0, values, 1.0)
        self._made: dict[Any, Matrix] = {}
        self._series: dict[Any, Series | None] = {}

    def flow(self, field: Field) -> Matrix:
        """``(t, x) -> (n, columns)``: of the flow of a mode, at rest and sliding as well."""
        held = bool(field.held)
        return self._slopes(("flow", field.name), field.mode, field.held, lambda g: g.flow(held))

    def guard(self, guard: Guard, field: Field) -> Matrix:
        """``(t, x) -> (1, columns)``: of a guard."""
        key = "guard", guard.edge, field.name
        return self._slopes(key, field.mode, field.held, lambda g: [_node(g, guard)])

    def speed(self, guard: Guard, field: Field) -> Matrix:
        """``(t, x) -> (1, columns)``: of a guard's rate along the flow."""
        held = bool(field.held)
        rate = lambda g: [g.rate(_node(g, guard), g.flow(held))]  # noqa: E731
        return self._slopes(("rate", guard.edge, field.name), field.mode, field.held, rate)

    def flow_with_gap(self, guard: Guard, field: Field) -> Matrix:
        """``(t, x) -> (n + 1, columns + 1)``: of the flow, and of a gap's speed: the gap is a
        coordinate behind the state, on which nothing depends."""
        held, place = bool(field.held), 1 + self.size

        def rows(graph: ModeGraph) -> list[int]:
            inputs, flow = self._inputs(graph), graph.flow(held)
            slopes = [
                gradient(graph.graph, node, inputs)
                for node in (*flow, graph.rate(_node(graph, guard), flow))
            ]
            zero = graph.graph.const(0.0)
            return [i for row in slopes for i in (*row[:place], zero, *row[place:])]

        key = "with gap", guard.edge, field.name
        return self._program(key, field.mode, field.held, rows, self.columns + 1)

    def lag(self, number: int, field: Field) -> Matrix:
        """``(t, x) -> (1, columns)``: of a lag."""
        code, name = self.scene.code, self.scene.spec.lags[number].name
        nodes = lambda g: g.values(code.closed("lag", name))  # noqa: E731
        return self._slopes(("lag", number, field.mode), field.mode, (), nodes)

    def series(self, field: Field, gap: Guard | None = None) -> Series | None:
        """The derivatives of :meth:`flow`, or of :meth:`flow_with_gap`, but for those by time, and
        the flow itself, in power series; None where there are none."""
        key = field.name, gap and gap.edge
        if key not in self._series:
            self._series[key] = None if self.scene.spec.lags else self._expanded(field, gap)
        return self._series[key]

    def _expanded(self, field: Field, gap: Guard | None) -> Series | None:
        graph, more = self.scene.code.mode(field.mode), int(gap is not None)
        key = "series", graph.kept, field.name, gap and gap.edge, self.count
        tape, places = self.scene.code.once(key, lambda: self._sparse(graph, field, gap))
        if tape is None:
            return None
        jets = tape.bind(self.scene.numbers(field.mode, tuple(field.held)))
        return Series(jets, places, (self.size + more, self.columns - 1 + more))

    def _sparse(
        self, graph: ModeGraph, field: Field, gap: Guard | None
    ) -> tuple[Tape | None, np.ndarray]:
        """The tape of a flow and of those of its derivatives that are not zero, and their places;
        nothing is derived by a gap."""
        held, zero, inputs = bool(field.held), graph.graph.const(0.0), self._inputs(graph)[1:]
        more = [] if gap is None else [graph.rate(_node(graph, gap), graph.flow(held))]
        slopes = [gradient(graph.graph, node, inputs) for node in (*graph.flow(held), *more)]
        found = [(i, j) for i, row in enumerate(slopes) for j, n in enumerate(row) if n != zero]
        places = [(i, j + len(more) * (j >= self.size)) for i, j in found]
        try:
            tape = graph.along(held, [slopes[i][j] for i, j in found])
        except TraceError:
            tape = None
        return tape, np.array(places, dtype=np.int64).reshape(-1, 2)

    def law(self, contact: str) -> Matrix:
        """``(t, x) -> (1, columns)``: of the restitution at rest."""
        code, mode = self.scene.code, self.scene.contact(contact).mode
        closed = lambda: code.closed("restitution", contact)  # noqa: E731
        at_rest = lambda g: g.values(closed(), g.graph.const(-0.0))  # noqa: E731
        return self._slopes(("law", contact), mode, (), at_rest)

    def reset(self, edge: str, kind: str) -> Matrix:
        """``(t, x) -> (n, columns)``: of what a jump does to the state."""
        code = self.scene.code
        if kind == "contact":
            mode = self.scene.contact(edge).mode
            return self._slopes(("impact", edge), mode, (), lambda g: g.impact(edge)[:-1])
        if kind == "edge":
            mode = next(e.source for e in self.scene.spec.transitions if e.name == edge)
            after = lambda g: g.values(code.closed("reset", edge))  # noqa: E731
            return self._slopes(("reset", edge), mode, (), after)
        same = np.eye(self.size, self.columns, 1)
        return lambda t, x: same

    def kinks(self, key: Any, field: Field, roots: Callable[[ModeGraph], list[int]]) -> Matrix:
        """``(t, x) -> (k, 1 + columns)``: functions at whose zeros nodes change their formula,
        and their derivatives."""

        def rows(graph: ModeGraph) -> list[int]:
            inputs, found = self._inputs(graph), deciding(graph.graph, roots(graph))
            return [i for node in found for i in (node, *gradient(graph.graph, node, inputs))]

        return self._program(("kinks", *key), field.mode, field.held, rows, 1 + self.columns)

    def project(self, field: Field) -> Matrix:
        """``(t, x) -> (n, columns)``: of the way back onto the contacts held, or the surface, at
        a state that is there."""
        if self.scene.spec.sliding(field.mode) is not None:
            return self._onto_surface(field)
        return self._onto_contacts(field)

    def _onto_contacts(self, field: Field) -> Matrix:
        """Gaps are taken away along their gradients, then gap speeds along impulses."""
        size, count, held = self.size, self.columns, len(field.held)

        def rows(graph: ModeGraph) -> list[int]:
            inputs, found = self._inputs(graph), list[int]()
            for name in field.held:
                contact = graph.contact(name)
                for node, places, moves in (
                    (contact.gap, contact.pairing.positions, contact.normal),
                    (contact.speed, contact.pairing.velocities, contact.push),
                ):
                    found += gradient(graph.graph, node, inputs)
                    along = dict(zip(places, moves, strict=True))
                    found += [along.get(i, graph.graph.const(0.0)) for i in range(size)]
            return found

        key = "onto", field.name
        known = self._program(key, field.mode, field.held, rows, count + size)

        def onto(t: float, x: np.ndarray) -> np.ndarray:
            moved, values = np.eye(count), known(t, x).reshape(held, 2, count + size)
            for place in range(2):
                off, along = values[:, place, :count], values[:, place, count:]
                shares = np.linalg.solve(off[:, 1 : 1 + size] @ along.T, off @ moved)
                moved[1 : 1 + size] -= along.T @ shares
            return moved[1 : 1 + size]

        return onto

    def _onto_surface(self, field: Field) -> Matrix:
        """The surface function is taken away along the difference of the two flows."""
        code, size, switching = self.scene.code, self.size, self.scene.spec.sliding(field.mode)
        assert switching is not None
        sides = switching.positive, switching.negative

        def rows(graph: ModeGraph) -> list[int]:
            (surface,) = graph.values(code.closed("surface", switching.name))
            flows = [graph.values(code.closed("flow", side)) for side in sides]
            across = [graph.graph.node("sub", *pair) for pair in zip(*flows, strict=True)]
            return [*gradient(graph.graph, surface, self._inputs(graph)), *across]

        known = self._program(("onto", field.name), field.mode, (), rows, self.columns + size)

        def onto(t: float, x: np.ndarray) -> np.ndarray:
            (row,) = known(t, x)
            off, across = row[: self.columns], row[self.columns :]
            share = off / (off[1 : 1 + size] @ across)
            moved: np.ndarray = np.eye(size, self.columns, 1) - np.outer(across, share)
            return moved

        return onto

    # -- how they are made ----------------------------------------------------------------

    def _slopes(
        self,
        key: Any,
        mode: str,
        held: Sequence[str],
        nodes: Callable[[ModeGraph], Sequence[int]],
    ) -> Matrix:
        """The derivatives of some nodes of a mode's graph."""

        def rows(graph: ModeGraph) -> list[int]:
            inputs = self._inputs(graph)
            return [i for node in nodes(graph) for i in gradient(graph.graph, node, inputs)]

        return self._program(("slopes", *key), mode, held, rows, self.columns)

    def _program(
        self,
        key: Any,
        mode: str,
        held: Sequence[str],
        nodes: Callable[[ModeGraph], list[int]],
        columns: int,
    ) -> Matrix:
        """Some nodes of a mode's graph as a matrix."""
        if key not in self._made:
            graph = self.scene.code.mode(mode)
            program = graph.program((*key, self.count), lambda: nodes(graph))
            call = program.bind(self.scene.numbers(mode, tuple(held)))
            self._made[key] = lambda t, x: np.array(call(t, x.tolist())).reshape(-1, columns)
        return self._made[key]

    def _inputs(self, graph: ModeGraph) -> list[int]:
        """The nodes by which is derived; the first row of a window is a change of what is seen."""
        shapes, windows = self.scene.code.shapes, len(self.scene.spec.windows)
        own = len(shapes) - windows
        shown = [graph.inputs[place][0] for place in range(own + 1, len(shapes), 2)]
        parameters = [i for ids in graph.inputs[: len(shapes)] for i in np.reshape(ids, -1)]
        inputs = [graph.t, *graph.x, *(i for row in shown for i in row)]
        return [int(i) for i in [*inputs, *parameters[: self.count]]]


class Directed:
    """Derivatives along directions: columns for time and state, then one for each of ``m``.

    ``change``, of shape ``(columns - 1 - size, m)``, is that of all else; ``units`` are what the
    directions are measured by.
    """

    def __init__(self, of: Derivatives, change: np.ndarray, units: np.ndarray) -> None:
        self.of, self.change, self.units = of, change, units
        self.scene, self.size, self.columns = of.scene, of.size, 1 + of.size + change.shape[1]

    def _turned(self, made: Matrix, more: int = 0) -> Matrix:
        own = 1 + self.size + more

        def turned(t: float, x: np.ndarray) -> np.ndarray:
            found = made(t, x)
            return np.hstack([found[:, :own], found[:, own:] @ self.change])

        return turned

    def flow(self, field: Field) -> Matrix:
        return self._turned(self.of.flow(field))

    def guard(self, guard: Guard, field: Field) -> Matrix:
        return self._turned(self.of.guard(guard, field))

    def speed(self, guard: Guard, field: Field) -> Matrix:
        return self._turned(self.of.speed(guard, field))

    def flow_with_gap(self, guard: Guard, field: Field) -> Matrix:
        return self._turned(self.of.flow_with_gap(guard, field), 1)

    def series(self, field: Field, gap: Guard | None = None) -> Series | None:
        made = self.of.series(field, gap)
        return None if made is None else attrs.evolve(made, change=self.change)

    def law(self, contact: str) -> Matrix:
        return self._turned(self.of.law(contact))

    def reset(self, edge: str, kind: str) -> Matrix:
        return self._turned(self.of.reset(edge, kind))

    def kinks(self, key: Any, field: Field, roots: Callable[[ModeGraph], list[int]]) -> Matrix:
        return self._turned(self.of.kinks(key, field, roots), 1)

    def project(self, field: Field) -> Matrix:
        return self._turned(self.of.project(field))


def _node(graph: ModeGraph, guard: Guard) -> int:
    """The node of a guard; of a gap with the formula that it has where it is zero."""
    return graph.contact(guard.edge).gap if guard.kind == "contact" else graph.guard(guard.edge)
