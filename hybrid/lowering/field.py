"""Fields, guards and contacts: what is integrated and watched in a mode."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..errors import TraceError
from ..rules.guards import JUMPS_WITHIN
from .derivatives import gradient
from .lowered import ORDER, Lowered
from .mode import Kind
from .tape import Jets

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

Scalar = Callable[..., Any]

#: Spacings of the time by which the end of a stretch may lie beyond the knot at which it ends: the
#: sum of a beginning, known to more than a number shows, and of a length is rounded twice.
ROUNDED_TWICE = 2.0

#: Largest number of states for which the Jacobian is written out; a thousand terms take 0.1 s in
#: Python.
WRITTEN = 32


@attrs.frozen(eq=False)
class Kink:
    """A function at whose zeros a guard changes its formula (``where``, ``abs``, ``floor``).

    Attributes
    ----------
    edge : object
        A unique key, by which its sign is remembered along an arc.
    value : callable ``(t, x)``
    affine : bool
        Whether it is affine in ``t`` and ``x``.
    uses : tuple of int
        Elements of the state that it depends on.
    change : "jumps", "bends" or "ends"
        What the guard may do there; beyond an end it is undefined.
    under : dict
        The keys of others at whose zeros its own formula changes, with their places among all.
    besides : callable ``(places)`` or None
        Its value with the formula of the positive side of those at some places.
    """

    edge: Any
    value: Scalar
    affine: bool
    uses: tuple[int, ...]
    change: str
    under: dict[Any, int] = attrs.Factory(dict)
    besides: Callable[[tuple[int, ...]], Scalar] | None = None

    def beside(self, edges: Iterable[Any]) -> Kink:
        """The same with the formula of the positive side of others; itself if none changes it."""
        places = tuple(sorted(self.under[edge] for edge in edges if edge in self.under))
        if not places or self.besides is None:
            return self
        return attrs.evolve(self, edge=(self.edge, places), value=self.besides(places))


@attrs.frozen(eq=False)
class Guard:
    """A guard watched in a field.

    Attributes
    ----------
    edge : str
        Name of the edge, contact or switching; ``"<contact>.release"`` for the end of a rest,
        ``"<switching>.positive"`` and ``"<switching>.negative"`` for the ends of sliding.
    kind : Kind
    to : str
        The mode it leads to.
    value : callable ``(t, x)``
        The guard.
    lie : callable ``(t, x)``
        The guard and its first two Lie derivatives along the flow.
    affine : bool
        Whether it is affine in ``t`` and ``x``, so that it is a polynomial where the state is.
    uses : tuple of int
        Elements of the state that the guard depends on.
    trace : callable
        Returns the guard's jaxpr.
    kinks : tuple of Kink
        Where it changes its formula; for a load also where the contact's gap and gap speed do.
    bounds : bool
        Whether it bounds its mode; the flow passes through an event that does not.
    after : callable ``(t, x)``, optional
        For a clock, whose guard is not watched: the first firing time after ``t``.
    when : callable ``(t, x)`` or None
        For an edge with a condition: positive where the condition holds.
    urgent : bool
        Whether the edge fires if its guard is beyond zero when the mode is entered.
    """

    edge: str
    kind: Kind
    to: str
    crossing: Crossing
    value: Scalar
    lie: Scalar
    affine: bool
    uses: tuple[int, ...]
    trace: Callable[[], Any]
    kinks: tuple[Kink, ...] = ()
    bounds: bool = True
    after: Scalar | None = None
    when: Scalar | None = None
    urgent: bool = False

    def holds(self, t: float, x: list[float]) -> bool:
        """Whether it may fire here: true without a condition."""
        return self.when is None or bool(self.when(t, x) > 0.0)

    @property
    def closed(self) -> Any:
        """The guard's jaxpr."""
        return self.trace()

    @property
    def jumps(self) -> bool:
        """Whether its sign may change without a zero."""
        return any(kink.change != "bends" for kink in self.kinks)


@attrs.frozen(eq=False, slots=False)
class Field:
    """What a solver integrates in a mode (resting and sliding modes included) and what is watched.

    Attributes
    ----------
    rhs : callable ``(t, x) -> tuple``
        Time derivatives of the states.
    jets : Jets or None
        Taylor series of the states, the guards in order, and the watched functions; None if the
        model uses an operation without a Taylor series.
    refused : str
        Why there are no series.
    held : tuple of str
        Contacts held closed here.
    trace, code, parameters
        A function that returns the flow's jaxpr, the generated code of the class, and the parameter
        values.
    numbers : tuple of float
        The parameter values as one list, then the mask of the held contacts.
    project : callable ``(t, x)`` or None
        Projection onto the held contacts' gaps, or onto the sliding surface.
    changes : tuple of Kink
        Where the flow changes its formula.
    scene, touching : Scene, frozenset of str
        Its origin: ``scene.field(name, touching)``.
    clocks : tuple of Guard
        Edges that fire here at given times.
    graph : ModeGraph, optional
        The graph behind the series, if it is not that of the mode (:mod:`.local`).
    """

    name: str
    mode: str
    held: tuple[str, ...]
    rhs: Scalar
    jets: Jets | None
    guards: tuple[Guard, ...]
    trace: Callable[[], Any]
    code: Lowered
    parameters: tuple[Any, ...]
    numbers: tuple[float, ...]
    project: Scalar | None = None
    refused: str = ""
    changes: tuple[Kink, ...] = ()
    scene: Any = None
    clocks: tuple[Guard, ...] = ()
    touching: frozenset[str] = frozenset()
    graph: Any = None

    def __reduce__(self) -> Any:
        """Pickle by origin."""
        return self.scene.field, (self.name, self.touching)

    def flow(self, t: float, x: StateVector) -> np.ndarray:
        """The time derivatives of the states."""
        return np.array(self.rhs(t, x.tolist()))

    def onto(self, t: float, x: list[float], ends: bool = False) -> Any:
        """As ``project``, of a field that has one: an arc keeps this, which is pickled.

        ``ends``: at the end of a stretch. At a knot of signals that is on the piece before it, and
        where the gap or the surface jumps as it was just before, and as the flow has gone on since.
        """
        assert self.project is not None
        within = t - ROUNDED_TWICE * float(np.spacing(abs(t))) if ends else t
        project = self._projection(within) if self.scene.samples else self.project
        if not (ends and self.leaps):
            return project(t, x)
        back = JUMPS_WITHIN * float(np.spacing(abs(t)))
        return tuple(self._since(project, t, x, back).tolist())

    def _since(self, project: Scalar, t: float, x: list[float], back: float) -> np.ndarray:
        """The state on what holds it as that was so long before, and as the flow has gone on."""
        flow = back * np.array(self.rhs(t - back, list(project(t - back, x))))
        return np.array(project(t - back, (x - flow).tolist())) + flow

    def _projection(self, t: float) -> Scalar:
        """The projection with the piece of the signals of a time, over whose knots arcs may go."""
        first, last, there = self._made.get("onto", (np.inf, -np.inf, None))
        if not first <= t < last:
            there = self.scene.projection(self.mode, self.held, self.scene.values_at(t))
            self._made["onto"] = (*self.scene.span(t), there)
        return there

    def along(self, t: float, x: StateVector, back: float = 0.0) -> np.ndarray:
        """The state on the held contacts or the surface, if there are any. With ``back`` as these
        were so long before, and as the flow has gone on since."""
        if self.project is None:
            return x
        if back:
            return self._since(self.project, float(t), x.tolist(), back)
        return np.array(self.project(float(t), x.tolist()))

    def at_end(self, t: float, x: StateVector) -> np.ndarray:
        """The same at the end of a stretch (see :meth:`onto`)."""
        return x if self.project is None else np.array(self.onto(float(t), x.tolist(), True))

    @cached_property
    def leaps(self) -> bool:
        """Whether the gap of a contact held here or its speed, or the surface on which the state
        slides, may jump."""
        ends = (guard for guard in self.guards if guard.kind is Kind.LEAVE)
        owners = (self.scene.field(g.to).guard(g.edge.rpartition(".")[0]) for g in ends)
        moves = any(self.scene.moved_by(self, contact) for contact in self.held)
        return moves or any(guard.jumps for guard in owners)

    @property
    def closed(self) -> Any:
        """The flow's jaxpr."""
        return self.trace()

    @property
    def shared(self) -> tuple[str, Any, tuple[Any, ...]]:
        """A flow that serves all resting fields of the mode: its name, its jaxpr, and the
        parameters with which it is this field's."""
        return self.once("shared", self._shared)  # type: ignore[no-any-return]

    def _shared(self) -> tuple[str, Any, tuple[Any, ...]]:
        mask = self.code.mode(self.mode).masked(self.held) if self.held else ()
        if len(mask) < 2:
            return self.name, self.closed, self.parameters
        given = *self.parameters, np.array(mask)
        return f"{self.mode}.rest", self.code.any_rest_closed(self.mode), given

    @property
    def hurried(self) -> bool:
        """Whether an urgent edge with a condition is watched, which may fire on any entry.

        A jump back into this field is then never without effect.
        """
        return any(guard.urgent and guard.when is not None for guard in self.guards)

    def column(self, edge: str) -> int:
        """Index of an edge's guard among the guards."""
        return next(i for i, guard in enumerate(self.guards) if guard.edge == edge)

    def guard(self, edge: str) -> Guard:
        """The guard or clock of an edge."""
        return next(guard for guard in (*self.guards, *self.clocks) if guard.edge == edge)

    @property
    def leans(self) -> bool:
        """Whether the resting set or the sliding surface may depend on the past."""
        slides = self.project is not None and not self.held and bool(self.code.spec.lags)
        return slides or (bool(self.held) and self.code.mode(self.mode).leans)

    @cached_property
    def kinks(self) -> int:
        """Number of kinks and other functions watched along a series (see :mod:`.tape`)."""
        return len(self.jets.watched) if self.jets else 0

    @cached_property
    def jacobian(self) -> Scalar | None:
        """The Jacobian of the flow by the state, row by row; None if it has no code, or if it is so
        large that finite differences are cheaper than writing it out."""
        graph, held = self.code.mode(self.mode), bool(self.held)
        if len(graph.x) > WRITTEN:
            return None
        rows = lambda: [gradient(graph.graph, f, graph.x) for f in graph.flow(held)]  # noqa: E731
        try:
            program = graph.program(("jacobian", held), lambda: [i for row in rows() for i in row])
        except TraceError:
            return None
        return program.bind(self.numbers)

    @cached_property
    def values(self) -> Jets | None:
        """The flow as a program of values, along a polynomial of the state that is given; None if
        an operation has none."""
        graph, held = self.code.mode(self.mode), bool(self.held)
        try:
            found = graph.of_values(("flow", held), lambda: graph.flow(held))
        except TraceError:
            return None
        return found.bind(self.numbers)

    def expand(self, t: float, x: list[float], sides: list[int]) -> Any:
        """Taylor coefficients of the states, the guards and the watched functions.

        See :class:`.tape.Jets`.
        """
        assert self.jets is not None
        return self.jets(t, x, sides, ORDER)

    def at_contact(self, name: str) -> list[Jets]:
        """Programs for the values at a contact of the mode (:meth:`.ModeGraph.contact_tapes`)."""
        graph = self.graph or self.code.mode(self.mode)
        tapes = graph.contact_tapes(name, bool(self.held))
        return [tape.bind(self.numbers) for tape in tapes]

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """The result of ``make``, cached under ``key``."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    @cached_property
    def _made(self) -> dict[Any, Any]:
        return {}


@attrs.frozen(eq=False)
class Contact:
    """The derived laws of a contact (see :mod:`.contact`) as scalar functions.

    ``local``: the obstacle is fixed and faces one position, and the flow depends on that position
    and its velocity only. Flights that start at the same speed are then identical at all times.
    """

    name: str
    mode: str
    rests: bool
    impact: Scalar
    land: Scalar
    push: Scalar
    law: Scalar
    local: bool
    scene: Any

    def __reduce__(self) -> Any:
        """Pickle by origin."""
        return self.scene.contact, (self.name,)
