"""One frozen description of a model, made once when its class is defined."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from .markers import Crossing, Times
from .past import LagSpec, window_shapes
from .record import Record
from .signals import SignalSpec


@attrs.frozen
class StateSpec:
    """A coordinate: its place in the state vector is ``offset : offset + size``."""

    name: str
    unit: str
    doc: str
    shape: tuple[int, ...]
    offset: int

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
    """An output: its name, unit and description, and the method (not in a run from a file)."""

    name: str
    unit: str
    doc: str
    function: Any = None


@attrs.frozen(eq=False)
class ModeSpec:
    """A mode: its name and flow; the cycle of edges at whose limit it is entered."""

    name: str
    flow: Callable[..., Any]
    limit_of: tuple[str, ...] = ()


@attrs.frozen(eq=False)
class EdgeSpec:
    """An edge: where it leads from and to, its guard and reset, and when it may fire."""

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
    """An edge that fires at given times, whatever the state is.

    ``after(self, t, s)`` is the first of them behind ``t``, and the guard the way to the nearest.
    """

    after: Callable[..., Any]
    times: Times


@attrs.frozen(eq=False)
class ContactSpec:
    """A unilateral contact; an edge from its mode to itself with a derived reset.

    ``among``: the contacts that were declared with it, as one array of gaps.
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
        """What ends sliding, into the positive and into the negative side."""
        return (
            LeaveSpec(self.name, "positive", self.mode, self.positive, Crossing.RISING),
            LeaveSpec(self.name, "negative", self.mode, self.negative, Crossing.FALLING),
        )

    @property
    def mode(self) -> str:
        """The arc mode in which the state slides."""
        return f"slide({self.name})"

    @property
    def sides(self) -> tuple[SideSpec, SideSpec]:
        """The surface as it is watched from its two modes."""
        falling, rising = Crossing.FALLING, Crossing.RISING
        return (
            SideSpec(self.name, self.positive, self.negative, self.surface, falling),
            SideSpec(self.name, self.negative, self.positive, self.surface, rising),
        )


@attrs.frozen(eq=False)
class SideSpec:
    """A switching seen from one of its modes: its surface is a guard that leads across."""

    name: str
    source: str
    to: str
    guard: Callable[..., Any]
    crossing: Crossing


@attrs.frozen(eq=False)
class LeaveSpec:
    """The end of sliding into a side: its guard is the surface's rate under that side's flow."""

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
    """The description of a class."""
    spec: Spec = cls.spec
    return spec


@attrs.frozen(eq=False)
class Spec:
    """The whole model.

    ``transitions`` holds edges, contacts and the two sides of each switching, in declared order;
    ``lags`` what its functions ask of the past.
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
        """Pickled as that of its class; one of a run from a file has none."""
        return super().__reduce_ex__(protocol) if self.cls is None else (_of, (self.cls,))

    @property
    def windows(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of the pieces of signals, and of the windows of the past: they follow the
        parameters in every trace."""
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

    @property
    def element_names(self) -> tuple[str, ...]:
        """A name for each element of the state vector: ``x``, ``q[0]``, ``q[1]``."""
        return tuple(
            state.name + (str(list(index)) if index else "")
            for state in self.states
            for index in np.ndindex(state.shape)
        )

    def mode(self, name: str) -> ModeSpec:
        """The mode of that name."""
        return next(mode for mode in self.modes if mode.name == name)

    def output(self, name: str) -> OutputSpec:
        """The output of that name."""
        return next(output for output in self.outputs if output.name == name)

    def mode_after(self, cycle: tuple[str, ...]) -> ModeSpec | None:
        """The mode that its author has named for the limit of a cycle of edges."""
        return next((m for m in self.modes if m.limit_of and set(m.limit_of) == set(cycle)), None)

    def switching(self, name: str) -> SwitchingSpec:
        """The switching of that name."""
        return next(switching for switching in self.switchings if switching.name == name)

    def sliding(self, mode: str) -> SwitchingSpec | None:
        """The switching on whose surface an arc mode slides, if it does."""
        return next((switching for switching in self.switchings if switching.mode == mode), None)

    def leaving(self, mode: str) -> tuple[Transition, ...]:
        """What is watched in a mode, in declared order.

        Where the state slides: its own edges, those of both modes, what ends sliding.
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
        """Those that fire in a mode; while the state slides, those of both sides do."""
        switching = self.sliding(mode)
        sides = () if switching is None else (switching.positive, switching.negative)
        return tuple(clock for clock in self.clocks if clock.source in (mode, *sides))

    def record(self, vector: Any) -> Record:
        """The state vector (last axis the coordinates) as a record."""
        parts = []
        for state in self.states:
            part = vector[..., state.offset : state.offset + state.size]
            parts.append(part.reshape(part.shape[:-1] + state.shape))
        return Record(self.names, tuple(parts))

    def values(self, record: Any) -> list[Any]:
        """The fields of a record, mapping or sequence in declared order.

        Raises
        ------
        ValueError
            If a field is missing, unknown, or there are too many or too few.
        """
        if isinstance(record, (dict, Mapping, Record)):
            given = {name: record[name] for name in record.keys()}
            missing = [name for name in self.names if name not in given]
            unknown = [name for name in given if name not in self.names]
            if missing or unknown:
                raise ValueError(_difference(missing, unknown, self.names))
            return [given[name] for name in self.names]
        if len(self.states) == 1 and not isinstance(record, Sequence):
            return [record]
        try:
            values = list(record)
        except TypeError:
            what = "one value" if hasattr(record, "shape") else repr(record)
            due = f"{len(self.states)} states ({', '.join(self.names)})"
            raise ValueError(f"{what} for {due}") from None
        if len(values) != len(self.states):
            count = len(self.states)
            raise ValueError(f"{len(values)} values for {count} states ({', '.join(self.names)})")
        return values


def _difference(missing: list[str], unknown: list[str], names: tuple[str, ...]) -> str:
    parts = []
    if missing:
        parts.append("no value for " + ", ".join(missing))
    if unknown:
        parts.append("unknown state " + ", ".join(map(repr, unknown)))
    return "; ".join(parts) + f"; the states are {', '.join(names)}"
