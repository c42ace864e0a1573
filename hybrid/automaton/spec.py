"""The frozen description of a model, made once when its class is defined."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from .captured import takes
from .chance import DOCS
from .discrete import typed
from .markers import Crossing, Times
from .past import LagSpec, window_shapes
from .record import Record
from .signals import SignalSpec

#: Where the jump of an edge, or of a contact, is written.
LAWS = ("reset", "restitution")


@attrs.frozen
class StateSpec:
    """A coordinate; it occupies ``offset : offset + size`` of the state vector.

    ``kind`` (``"int"``, ``"float"`` or ``"bool"``) and ``default`` are set for discrete variables
    only.
    """

    name: str
    unit: str
    doc: str
    shape: tuple[int, ...]
    offset: int
    kind: str = ""
    default: Any = None

    @property
    def size(self) -> int:
        return math.prod(self.shape)


@attrs.frozen
class ParameterSpec:
    """A parameter: its default, unit and description."""

    name: str
    default: Any
    unit: str
    doc: str


@attrs.frozen(eq=False)
class OutputSpec:
    """An output: name, unit, description and method (None if the run was loaded from a file)."""

    name: str
    unit: str
    doc: str
    function: Any = None


@attrs.frozen(eq=False)
class ModeSpec:
    """A mode: its name, its flow, and the cycle of edges at whose limit it is entered."""

    name: str
    flow: Callable[..., Any]
    limit_of: tuple[str, ...] = ()


@attrs.frozen(eq=False)
class EdgeSpec:
    """An edge: source, target, guard, reset, and the condition under which it may fire."""

    name: str
    source: str
    to: str
    guard: Callable[..., Any]
    crossing: Crossing
    reset: Callable[..., Any]
    when: Callable[..., Any] | None = attrs.field(default=None, kw_only=True)
    urgent: bool = attrs.field(default=False, kw_only=True)


@attrs.frozen(eq=False)
class ClockSpec(EdgeSpec):
    """An edge that fires at given times, whatever the state.

    ``after(self, t, s)`` is the first firing time after ``t``; the guard is the signed distance to
    the nearest one.
    """

    after: Callable[..., Any]
    times: Times


@attrs.frozen(eq=False)
class ContactSpec:
    """A unilateral contact: an edge from its mode to itself, with a derived reset.

    ``among`` names all contacts that were declared with it as one array of gaps.
    """

    name: str
    source: str
    guard: Callable[..., Any]
    restitution: Callable[..., Any]
    rests: bool
    inverse_mass: Any
    among: tuple[str, ...] = ()

    crossing = Crossing.FALLING

    @property
    def to(self) -> str:
        return self.source


@attrs.frozen(eq=False)
class SwitchingSpec:
    """Two modes on the two sides of a surface."""

    name: str
    positive: str
    negative: str
    surface: Callable[..., Any]
    slides: bool

    @property
    def ends(self) -> tuple[LeaveSpec, LeaveSpec]:
        """The two edges that end sliding, to the positive and to the negative side."""
        return (
            LeaveSpec(self.name, "positive", self.mode, self.positive, Crossing.RISING),
            LeaveSpec(self.name, "negative", self.mode, self.negative, Crossing.FALLING),
        )

    @property
    def mode(self) -> str:
        """The sliding arc mode."""
        return f"slide({self.name})"

    @property
    def sides(self) -> tuple[SideSpec, SideSpec]:
        """The surface as a guard of each of the two modes."""
        falling, rising = Crossing.FALLING, Crossing.RISING
        return (
            SideSpec(self.name, self.positive, self.negative, self.surface, falling),
            SideSpec(self.name, self.negative, self.positive, self.surface, rising),
        )


@attrs.frozen(eq=False)
class SideSpec:
    """A switching seen from one of its modes: its surface is the guard that leads across."""

    name: str
    source: str
    to: str
    guard: Callable[..., Any]
    crossing: Crossing


@attrs.frozen(eq=False)
class LeaveSpec:
    """The end of sliding to one side; the guard is the surface's rate along that side's flow."""

    switching: str
    side: str
    source: str
    to: str
    crossing: Crossing

    @property
    def name(self) -> str:
        return f"{self.switching}.{self.side}"


Transition = EdgeSpec | ContactSpec | SideSpec | LeaveSpec


def _of(cls: Any) -> Spec:
    """The spec of a class (unpickles a spec)."""
    spec: Spec = cls.spec
    return spec


@attrs.frozen(eq=False)
class Spec:
    """The whole model.

    ``states`` holds the flowing states in declared order, then the discrete variables.
    ``transitions`` holds edges, contacts and the two sides of each switching, in declared order.
    ``lags`` holds the lags that its functions ask for.
    """

    model: str
    states: tuple[StateSpec, ...]
    parameters: tuple[ParameterSpec, ...]
    modes: tuple[ModeSpec, ...]
    transitions: tuple[Transition, ...]
    initial: str
    switchings: tuple[SwitchingSpec, ...] = ()
    lags: tuple[LagSpec, ...] = ()
    outputs: tuple[OutputSpec, ...] = ()
    signals: tuple[SignalSpec, ...] = ()
    cls: Any = attrs.field(default=None, eq=False, repr=False)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle a reference to the class; a spec loaded from a file is pickled whole."""
        return super().__reduce_ex__(protocol) if self.cls is None else (_of, (self.cls,))

    @property
    def windows(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of signal pieces and delay windows, which follow the parameters in traces."""
        pieces = tuple((signal.size,) for signal in self.signals)
        return (*pieces, *window_shapes(self.lags, self.dimension))

    @cached_property
    def given(self) -> tuple[str, ...]:
        """Names of the parameters, then of the signals."""
        return (*(p.name for p in self.parameters), *(signal.name for signal in self.signals))

    @cached_property
    def dimension(self) -> int:
        """Length of the state vector."""
        return sum(state.size for state in self.states)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(state.name for state in self.states)

    @cached_property
    def flowing(self) -> tuple[StateSpec, ...]:
        """The states that flow."""
        return tuple(state for state in self.states if not state.kind)

    @cached_property
    def discrete(self) -> tuple[StateSpec, ...]:
        """The discrete variables."""
        return self.states[len(self.flowing) :]

    @cached_property
    def flows(self) -> int:
        """Number of flowing elements; the elements of the state vector after them only jump."""
        return sum(state.size for state in self.flowing)

    @cached_property
    def chances(self) -> tuple[str, ...]:
        """The edges whose resets, and the contacts whose restitutions, draw random numbers."""
        laws = ((e.name, getattr(e, law, None)) for e in self.transitions for law in LAWS)
        return tuple(name for name, law in laws if takes(law, "draw"))

    @cached_property
    def contacts(self) -> tuple[str, ...]:
        """Names of the contacts."""
        return tuple(edge.name for edge in self.transitions if isinstance(edge, ContactSpec))

    def place(self, name: str) -> int:
        """The index at which a state begins in the state vector."""
        return self.states[self.names.index(name)].offset

    @property
    def element_names(self) -> tuple[str, ...]:
        """A name per element of the state vector: ``x``, ``q[0]``, ``q[1]``."""
        return tuple(
            state.name + (str(list(index)) if index else "")
            for state in self.states
            for index in np.ndindex(state.shape)
        )

    def output(self, name: str) -> OutputSpec:
        """The output with this name."""
        return next(output for output in self.outputs if output.name == name)

    def mode_after(self, cycle: tuple[str, ...]) -> ModeSpec | None:
        """The mode declared as the limit of a cycle of edges, if any."""
        return next((m for m in self.modes if m.limit_of and set(m.limit_of) == set(cycle)), None)

    def switching(self, name: str) -> SwitchingSpec:
        """The switching with this name."""
        return next(switching for switching in self.switchings if switching.name == name)

    def sliding(self, mode: str) -> SwitchingSpec | None:
        """The switching whose sliding mode this is, if any."""
        return next((switching for switching in self.switchings if switching.mode == mode), None)

    def leaving(self, mode: str) -> tuple[Transition, ...]:
        """The transitions watched in a mode, in declared order.

        In a sliding mode: its own edges, those of both sides, then the two that end sliding.
        """
        watched = [edge for edge in self.transitions if not isinstance(edge, ClockSpec)]
        own = tuple(edge for edge in watched if edge.source == mode)
        switching = self.sliding(mode)
        if switching is None:
            return own
        modes = (switching.positive, switching.negative)
        others = [e for e in watched if e.source in modes and e.name != switching.name]
        return (*own, *others, *switching.ends)

    @cached_property
    def clocks(self) -> tuple[ClockSpec, ...]:
        """The edges that fire at given times."""
        return tuple(edge for edge in self.transitions if isinstance(edge, ClockSpec))

    def ringing(self, mode: str) -> tuple[ClockSpec, ...]:
        """The clocks of a mode; in a sliding mode, those of both sides too."""
        switching = self.sliding(mode)
        sides = () if switching is None else (switching.positive, switching.negative)
        return tuple(clock for clock in self.clocks if clock.source in (mode, *sides))

    def record(self, vector: Any, of: Callable[..., Any] = typed) -> Record:
        """The state vector (coordinates on the last axis) as a record of all states.

        It unpacks to the flowing ones. ``of(name, kind, values)`` converts the values of a discrete
        variable.
        """
        parts = []
        for state in self.states:
            part = vector[..., state.offset : state.offset + state.size]
            part = part.reshape(part.shape[:-1] + state.shape)
            parts.append(of(state.name, state.kind, part) if state.kind else part)
        return Record(self.names, tuple(parts), unpacked=len(self.flowing))

    def vector(self, record: Record) -> Any:
        """A record, also of columns, as the state vector."""
        parts = [np.asarray(record[name], dtype=float) for name in self.names]
        lead = parts[0].shape[: parts[0].ndim - len(self.states[0].shape)]
        return np.concatenate([part.reshape((*lead, -1)) for part in parts], axis=-1)

    def values(self, record: Any, held: Any = None) -> list[Any]:
        """The fields of a record, mapping or sequence, in the order of the state vector.

        Discrete variables may be omitted; they then come from the record ``held``, or are their
        defaults. A sequence has none, or, without ``held``, all that are declared.

        Raises
        ------
        ValueError
            If a field is missing or unknown, or a sequence has the wrong length.
        """
        others = {s.name: s.default if held is None else held[s.name] for s in self.discrete}
        if isinstance(record, (dict, Mapping, Record)):
            given = others | {name: record[name] for name in record.keys()}
            missing = [name for name in self.names if name not in given]
            unknown = [name for name in given if name not in self.names]
            if missing or unknown:
                raise ValueError(_difference(missing, unknown, self.names))
            return [given[name] for name in self.names]
        names = tuple(state.name for state in self.flowing)
        if len(names) == 1 and not isinstance(record, Sequence):
            return [record, *others.values()]
        try:
            values = list(record)
        except TypeError:
            what = "one value" if hasattr(record, "shape") else repr(record)
            raise ValueError(f"{what} for {_listed(names)}") from None
        declared = [name for name in others if held is None and name not in DOCS]
        if len(values) == len(names) + len(declared):
            return [*values, *list(others.values())[len(declared) :]]
        if len(values) != len(names):
            count = "one value" if len(values) == 1 else f"{len(values)} values"
            raise ValueError(f"{count} for {_listed(names)}")
        return [*values, *others.values()]

    def require_rates(self, record: Any) -> None:
        """Refuse a flow's result that gives rates of discrete variables."""
        changed: tuple[str, ...] = ()
        if isinstance(record, Record):
            changed = record.changed
        elif isinstance(record, Mapping):
            changed = tuple(record)
        found = [state.name for state in self.discrete if state.name in changed]
        if found:
            raise ValueError(
                f"{found[0]}: only jumps change a discrete variable; leave it out of what the "
                "flow returns"
            )


def _listed(names: tuple[str, ...]) -> str:
    """How many states are due, and which."""
    return f"{len(names)} {'state' if len(names) == 1 else 'states'} ({', '.join(names)})"


def _difference(missing: list[str], unknown: list[str], names: tuple[str, ...]) -> str:
    parts = []
    if missing:
        parts.append("no value for " + ", ".join(missing))
    if unknown:
        parts.append("unknown state " + ", ".join(map(repr, unknown)))
    return "; ".join(parts) + f"; the states are {', '.join(names)}"
