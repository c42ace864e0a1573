"""Derivatives of a model's flows, guards and resets, as programs.

They are nodes of the mode's own graph (:mod:`hybrid.lowering.derivatives`), made once per class and
evaluated like any other program. The columns are time, then the elements of the state; with delays,
then the elements of the delayed state of each lag; then, on request, those of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np

from ..errors import TraceError
from ..lowering import Field, Guard, Kind, Scene
from ..lowering.derivatives import gradient
from ..lowering.mode import ModeGraph
from ..lowering.sides import deciding
from ..lowering.tape import Jets, Tape
from .series import Series

MatrixFunction = Callable[[float, np.ndarray], np.ndarray]


@attrs.frozen(eq=False)
class Rows:
    """Nodes of a mode's graph as the rows of a matrix.

    Attributes
    ----------
    key
        A unique key.
    mode, held
        The mode, and the held contacts.
    nodes : callable
        Returns the nodes, given the mode's graph.
    columns : int
    """

    key: Any
    mode: str
    held: Sequence[str]
    nodes: Callable[[ModeGraph], list[int]]
    columns: int


class Derivatives:
    """The derivatives of one scene, made on first use.

    Attributes
    ----------
    size, count : int
        Number of state elements, and of parameter elements if these have columns; with
        ``windows``, the coefficients of the windows on the past count as parameters.
    units : array, shape (count,)
        Absolute values of the parameters; 1 for a zero.
    """

    def __init__(self, scene: Scene, parameters: bool = False, windows: bool = False) -> None:
        self.scene, self.size, self.windows = scene, scene.spec.dimension, windows
        own = len(scene.code.shapes) - (0 if windows else len(scene.spec.windows))
        sizes = [*map(math.prod, scene.code.shapes[:own])]
        self.count = sum(sizes) if parameters else 0
        self.columns = 1 + self.size * (1 + len(scene.spec.lags)) + self.count
        values = np.abs([v for p in scene.parameters[:own] for v in np.ravel(p)][: self.count])
        self.units = np.where(values > 0.0, values, 1.0)
        self._made: dict[Any, MatrixFunction] = {}
        self._series: dict[Any, Series | None] = {}

    def flow(self, field: Field) -> MatrixFunction:
        """``(t, x) -> (n, columns)``: derivatives of the flow, also at rest and while sliding."""
        held = bool(field.held)
        flow = self._slopes(("flow", field.name), field.mode, field.held, lambda g: g.flow(held))
        return self.matrix(flow)

    def guard(self, guard: Guard, field: Field) -> MatrixFunction:
        """``(t, x) -> (1, columns)``: derivatives of a guard."""
        return self.matrix(self.of_guard(guard, field))

    def of_guard(self, guard: Guard, field: Field) -> Rows:
        """The derivatives of a guard, as a row."""
        key = "guard", guard.edge, field.name
        return self._slopes(key, field.mode, field.held, lambda g: [_node(g, guard)])

    def of_speed(self, guard: Guard, field: Field) -> Rows:
        """The derivatives of a guard's rate along the flow, as a row."""
        held = bool(field.held)
        rate = lambda g: [g.rate(_node(g, guard), g.flow(held))]  # noqa: E731
        return self._slopes(("rate", guard.edge, field.name), field.mode, field.held, rate)

    def lag(self, number: int, field: Field) -> MatrixFunction:
        """``(t, x) -> (1, columns)``: derivatives of a lag."""
        code, name = self.scene.code, self.scene.spec.lags[number].name
        nodes = lambda g: g.values(code.closed("lag", name))  # noqa: E731
        return self.matrix(self._slopes(("lag", number, field.mode), field.mode, (), nodes))

    def series(self, field: Field, gap: Guard | None = None) -> Series | None:
        """Power series of the flow and of its derivatives, without the time column.

        None if there is no power series. A gap, if given, is an extra coordinate after the state,
        on which nothing depends.
        """
        key = field.name, gap and gap.edge
        if key not in self._series:
            moving = self.scene.spec.lags and not self.windows
            self._series[key] = None if moving else self._expanded(field, gap)
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
        """The tape of a flow and of its nonzero derivatives, and their (row, column) places; a gap
        has no column of derivatives."""
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

    def of_law(self, contact: str) -> Rows:
        """The derivatives of the restitution at rest, as a row."""
        code, mode = self.scene.code, self.scene.contact(contact).mode
        closed = lambda: code.closed("restitution", contact)  # noqa: E731
        at_rest = lambda g: g.values(closed(), g.graph.const(-0.0))  # noqa: E731
        return self._slopes(("law", contact), mode, (), at_rest)

    def reset(self, edge: str, kind: Kind) -> MatrixFunction:
        """``(t, x) -> (n, columns)``: derivatives of the state after a jump."""
        rows = self.of_reset(edge, kind)
        if rows is not None:
            return self.matrix(rows)
        same = np.eye(self.size, self.columns, 1)
        return lambda t, x: same

    def of_reset(self, edge: str, kind: Kind) -> Rows | None:
        """The derivatives of the state after a jump, as rows; None if the state does not change."""
        code = self.scene.code
        if kind is Kind.CONTACT:
            mode = self.scene.contact(edge).mode
            return self._slopes(("impact", edge), mode, (), lambda g: g.impact(edge)[:-1])
        if kind in (Kind.EDGE, Kind.CLOCK):
            mode = next(e.source for e in self.scene.spec.transitions if e.name == edge)
            after = lambda g: g.values(code.closed("reset", edge))  # noqa: E731
            return self._slopes(("reset", edge), mode, (), after)
        return None

    def kinks(
        self, key: Any, field: Field, roots: Callable[[ModeGraph], list[int]]
    ) -> MatrixFunction:
        """``(t, x) -> (k, 1 + columns)``: value and derivatives of each function whose sign decides
        on a formula in ``roots``."""

        def rows(graph: ModeGraph) -> list[int]:
            inputs, found = self._inputs(graph), deciding(graph.graph, roots(graph))
            return [i for node in found for i in (node, *gradient(graph.graph, node, inputs))]

        key = "kinks", *key
        return self.matrix(Rows(key, field.mode, field.held, rows, 1 + self.columns))

    def of_watched(self, field: Field) -> Rows:
        """The derivatives of a field's watched functions as rows; 0 where no formula changes."""
        assert field.jets is not None
        watched = field.jets.tape.watched
        own = [what.node for what in watched if what.switches]

        def rows(graph: ModeGraph) -> list[int]:
            inputs, zero = self._inputs(graph), graph.graph.const(0.0)
            found = {node: gradient(graph.graph, node, inputs) for node in own}
            nothing = [zero] * len(inputs)
            return [i for what in watched for i in found.get(what.node, nothing)]

        key = "watched", field.name, *(what.node for what in watched)
        return Rows(key, field.mode, field.held, rows, self.columns)

    def project(self, field: Field) -> MatrixFunction:
        """``(t, x) -> (n, columns)``: derivatives of the projection onto the held contacts, or the
        sliding surface, at a state on it."""
        switching = self.scene.spec.sliding(field.mode)
        if switching is not None:
            return self.matrix(self.of_surface(field.mode, switching.name))
        gaps, speeds = (
            self._slopes(("onto", of_speed, field.name), field.mode, field.held, moved)
            for of_speed, moved in (
                (False, lambda g: g.onto(False)),
                (True, lambda g: g.onto(True)),
            )
        )
        first, second = self.matrix(gaps), self.matrix(speeds)
        return lambda t, x: after(second(t, x), first(t, x))

    def of_surface(self, mode: str, switching: str) -> Rows:
        """The derivatives of the projection onto the surface on which a mode slides, as rows."""
        onto = lambda g: g.values(self.scene.code.onto_closed(switching))  # noqa: E731
        return self._slopes(("onto", mode), mode, (), onto)

    def of_contacts(self, field: Field) -> Rows:
        """For the gap, then the gap speed, of each held contact: its derivatives, and the direction
        in which the projection removes it."""
        size = self.size

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
        return Rows(key, field.mode, field.held, rows, self.columns + size)

    # -- programs -------------------------------------------------------------------------

    def _slopes(
        self,
        key: Any,
        mode: str,
        held: Sequence[str],
        nodes: Callable[[ModeGraph], Sequence[int]],
    ) -> Rows:
        """The derivatives of some nodes of a mode's graph."""

        def rows(graph: ModeGraph) -> list[int]:
            inputs = self._inputs(graph)
            return [i for node in nodes(graph) for i in gradient(graph.graph, node, inputs)]

        return Rows(("slopes", *key), mode, held, rows, self.columns)

    def matrix(self, rows: Rows) -> MatrixFunction:
        """A function ``(t, x) -> matrix`` that evaluates rows, as scalar code."""
        if rows.key not in self._made:
            graph = self.scene.code.mode(rows.mode)
            program = graph.program((*rows.key, self.count), lambda: rows.nodes(graph))
            call = program.bind(self.scene.numbers(rows.mode, tuple(rows.held)))
            shape = -1, rows.columns
            self._made[rows.key] = lambda t, x: np.array(call(t, x.tolist())).reshape(shape)
        return self._made[rows.key]

    def values(self, rows: Rows) -> Jets:
        """A program on a tape that evaluates rows, one after the other.

        Raises
        ------
        TraceError
            If an operation cannot be put on a tape.
        """
        graph = self.scene.code.mode(rows.mode)
        tape = graph.of_values((*rows.key, self.count), lambda: rows.nodes(graph))
        return tape.bind(self.scene.numbers(rows.mode, tuple(rows.held)))

    def _inputs(self, graph: ModeGraph) -> list[int]:
        """The node of each column; for a delayed state, that of its window's constant term."""
        shapes = self.scene.code.shapes
        first = len(shapes) - 2 * len(self.scene.spec.lags)  # each has a frame, and coefficients
        shown = [graph.inputs[place][0] for place in range(first + 1, len(shapes), 2)]
        parameters = [i for ids in graph.inputs[: len(shapes)] for i in np.reshape(ids, -1)]
        inputs = [graph.t, *graph.x, *(i for row in shown for i in row)]
        return [int(i) for i in [*inputs, *parameters[: self.count]]]


def after(later: np.ndarray, earlier: np.ndarray) -> np.ndarray:
    """The derivatives of ``earlier`` followed by ``later`` at the same time, all of shape
    ``(n, columns)``: time, state, and others."""
    end = 1 + len(later)
    found: np.ndarray = later[:, 1:end] @ earlier
    found[:, 0] += later[:, 0]
    found[:, end:] += later[:, end:]
    return found


def _node(graph: ModeGraph, guard: Guard) -> int:
    """The node of a guard; for a gap, the formula that holds where the gap is zero."""
    return graph.contact(guard.edge).gap if guard.kind is Kind.CONTACT else graph.guard(guard.edge)
