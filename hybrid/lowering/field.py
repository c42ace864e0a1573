"""What is flown in a mode, and what is watched there: fields, guards and contacts."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..errors import TraceError
from .derivatives import gradient
from .lowered import ORDER, Lowered
from .mode import Kind
from .tape import Jets

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

Scalar = Callable[..., Any]

#: Most states whose Jacobian is written out: for a thousand terms Python takes a tenth of a second.
WRITTEN = 32


@attrs.frozen(eq=False)
class Kink:
    """A function at whose zeros a guard changes its formula (``where``, ``abs``, ``floor``).

    Attributes
    ----------
    edge : object
        A name of its own, by which its signs are remembered along an arc.
    value : callable ``(t, x)``
    affine : bool
        Affine in ``t`` and ``x``.
    uses : tuple of int
        Elements of the state that it depends on.
    change : "jumps", "bends" or "ends"
        What the guard may do there; beyond an end it has no value.
    """

    edge: Any
    value: Scalar
    affine: bool
    uses: tuple[int, ...]
    change: str


@attrs.frozen(eq=False)
class Guard:
    """A guard watched in a field.

    Attributes
    ----------
    edge : str
        Name of the edge, contact or switching; ``"<contact>.release"`` for the end of a rest,
        ``"<switching>.positive"`` and ``"<switching>.negative"`` for those of sliding.
    kind : Kind
    to : str
        The mode it leads to.
    value : callable ``(t, x)``
        The guard.
    lie : callable ``(t, x)``
        The guard and its first two derivatives along the flow.
    affine : bool
        Affine in ``t`` and ``x``: a polynomial wherever the state is one.
    uses : tuple of int
        Elements of the state that the guard depends on.
    trace : callable
        Gives the guard's jaxpr.
    kinks : tuple of Kink
        Where it changes its formula; of a load also where its contact's gap and gap speed do.
    bounds : bool
        Whether it bounds its mode; an event that the flow passes does not.
    after : callable ``(t, x)``, optional
        Of a clock, whose guard is not watched: the first of its times behind ``t``.
    when : callable ``(t, x)`` or None
        Of an edge with a condition: greater than 0 where it holds.
    urgent : bool
        Whether an edge fires where its guard is beyond zero as the mode is entered.
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
        """Whether it may fire: its condition, if it has one, holds."""
        return self.when is None or bool(self.when(t, x) > 0.0)

    @property
    def closed(self) -> Any:
        """The guard's jaxpr."""
        return self.trace()

    @property
    def jumps(self) -> bool:
        """Whether it may change its sign without a zero."""
        return any(kink.change != "bends" for kink in self.kinks)


@attrs.frozen(eq=False, slots=False)
class Field:
    """What a solver flows in one mode (or resting mode), and what is watched there.

    Attributes
    ----------
    rhs : callable ``(t, x) -> tuple``
        Time derivatives.
    jets : Jets or None
        Taylor series of the states, of the guards in order, and of what is watched; None where
        the model uses something that has no Taylor series.
    refused : str
        Why there are no series, where there are none.
    held : tuple of str
        Contacts held closed here.
    trace, code, parameters
        What gives the flow's jaxpr, what else is made for the class, and the parameters' values.
    numbers : tuple of float
        The same as one list, and behind them the mask: which contacts are held.
    project : callable ``(t, x)`` or None
        Back onto the held contacts' gaps, or onto the surface on which the state slides.
    changes : tuple of Kink
        Where the flow changes its formula.
    scene, touching : Scene, frozenset of str
        Where it comes from: ``scene.field(name, touching)``.
    clocks : tuple of Guard
        What fires here at given times.
    graph : ModeGraph, optional
        What the series are made of, where it is not that of the mode (:mod:`.local`).
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
        """Pickled as what it comes from."""
        return self.scene.field, (self.name, self.touching)

    def onto(self, t: float, x: list[float], ends: bool = False) -> Any:
        """As ``project``, of a field that has one: an arc keeps this, which is pickled.

        ``ends``: at the end of a stretch, which at a knot of signals is on the piece before it.
        """
        assert self.project is not None
        if not self.scene.samples:
            return self.project(t, x)
        first, last, there = self._made.get("onto", (np.inf, -np.inf, None))
        within = float(np.nextafter(t, -np.inf)) if ends else t
        if not first <= within < last:  # the arc goes on over knots
            there = self.scene.projection(self.mode, self.held, self.scene.values_at(within))
            self._made["onto"] = (*self.scene.span(within), there)
        return there(t, x)

    def along(self, t: float, x: StateVector) -> np.ndarray:
        """A state on the contacts held, or on the surface; where there is neither, as it is."""
        return x if self.project is None else np.array(self.project(float(t), x.tolist()))

    @property
    def closed(self) -> Any:
        """The flow's jaxpr."""
        return self.trace()

    @property
    def hurried(self) -> bool:
        """Whether entering it may fire an edge at any time: a jump back into it is never idle."""
        return any(guard.urgent and guard.when is not None for guard in self.guards)

    def column(self, edge: str) -> int:
        """Place of an edge's guard among the guards."""
        return next(i for i, guard in enumerate(self.guards) if guard.edge == edge)

    def guard(self, edge: str) -> Guard:
        """The guard of an edge, or its clock."""
        return next(guard for guard in (*self.guards, *self.clocks) if guard.edge == edge)

    @property
    def leans(self) -> bool:
        """Whether where contacts are at rest, or the state slides, may depend on the past."""
        slides = self.project is not None and not self.held and bool(self.code.spec.lags)
        return slides or (bool(self.held) and self.code.mode(self.mode).leans)

    @cached_property
    def kinks(self) -> int:
        """Number of kinks, and of what else is watched along a series (see :mod:`.tape`)."""
        return len(self.jets.watched) if self.jets else 0

    @cached_property
    def jacobian(self) -> Scalar | None:
        """The derivatives of the flow by the state, row by row; None where there are none, or so
        many that differences of the flow cost less than to write them out."""
        graph, held = self.code.mode(self.mode), bool(self.held)
        if len(graph.x) > WRITTEN:
            return None
        rows = lambda: [gradient(graph.graph, f, graph.x) for f in graph.flow(held)]  # noqa: E731
        try:
            program = graph.program(("jacobian", held), lambda: [i for row in rows() for i in row])
        except TraceError:
            return None
        return program.bind(self.numbers)

    def expand(self, t: float, x: list[float], sides: list[int]) -> Any:
        """The series of states, guards and what is watched, as lists of coefficients.

        See :class:`.tape.Jets`.
        """
        assert self.jets is not None
        return self.jets(t, x, sides, ORDER)

    def at_contact(self, name: str) -> list[Jets]:
        """What happens at a contact of the mode, for values (:meth:`.ModeGraph.contact_tapes`)."""
        graph = self.graph or self.code.mode(self.mode)
        tapes = graph.contact_tapes(name, bool(self.held))
        return [tape.bind(self.numbers) for tape in tapes]

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What ``make`` returns, made only the first time."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    @cached_property
    def _made(self) -> dict[Any, Any]:
        return {}


@attrs.frozen(eq=False)
class Contact:
    """The derived laws of a contact (see :mod:`.contact`), as scalar functions.

    ``local``: a fixed obstacle before one position, and a flow that depends on that position
    and its velocity only: flights with one speed are alike, whenever they are.
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
        """Pickled as what it comes from."""
        return self.scene.contact, (self.name,)
