"""Turns the markers of a class body into a spec and a list of faults."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import ParameterError
from .captured import takes
from .chance import DOCS
from .clocks import clock, faults
from .discrete import Discrete
from .markers import (
    TERMINATE,
    ContactMarker,
    Crossing,
    EdgeMarker,
    Mode,
    State,
    Switching,
    is_number,
    is_parameter,
    name_of,
)
from .outputs import Output
from .reals import reals
from .refusals import misplaced
from .signals import declared, placeholder
from .spec import (
    ContactSpec,
    EdgeSpec,
    ModeSpec,
    OutputSpec,
    ParameterSpec,
    Spec,
    StateSpec,
    SwitchingSpec,
    Transition,
)
from .vectors import elements, length

#: Attribute names that records and models use themselves.
RECORDS = ("keys", "replace")
MODELS = ("draw", "parameters", "samples", "spec", "traces")


def _unguarded(self: Any, t: Any, s: Any) -> Any:
    """Placeholder guard of an edge that has none."""
    return t


class Builder:
    """Turns the markers of one class into a spec and a list of faults."""

    def __init__(self, cls: type, markers: dict[str, Any]) -> None:
        self.cls, self.markers = cls, markers
        self.faults: list[str] = []
        self.untraceable: list[Any] = []

    def of(self, kind: type) -> list[Any]:
        return [marker for marker in self.markers.values() if isinstance(marker, kind)]

    @property
    def drawing(self) -> bool:
        """Whether a reset or a restitution draws random numbers."""
        laws = [marker.restitution for marker in self.of(ContactMarker)]
        laws += [marker.reset for marker in self.of(EdgeMarker)]
        return any(takes(law, "draw") for law in laws)

    def build(self) -> Spec:
        states, offset = [], 0
        for marker in sorted(self.of(State), key=lambda marker: isinstance(marker, Discrete)):
            row = marker.name, marker.unit, marker.doc, self.shape(marker), offset
            states.append(StateSpec(*row, *self.discrete(marker)))
            offset += states[-1].size
        if self.drawing:
            for name, doc in DOCS.items():
                states.append(StateSpec(name, "", doc, (), offset, "int", 0))
                offset += 1
        parameters = tuple(
            ParameterSpec(name, m._default, m.metadata["unit"], m.metadata["doc"])
            for name, m in self.markers.items()
            if is_parameter(m)
        )
        given, faults = declared(self.markers)
        self.faults += faults
        if all(state.kind for state in states):
            self.faults.append("no state: declare one, x = hy.state()")
        transitions: list[Transition] = []
        switchings = []
        for m in self.markers.values():
            if isinstance(m, EdgeMarker):
                transitions.append(self.edge(m))
            elif isinstance(m, ContactMarker):
                transitions += self.contacts(m, (states, parameters, given))
            elif isinstance(m, Switching):
                switchings.append(self.switching(m))
                transitions += switchings[-1].sides
        modes = tuple(self.mode(marker, transitions) for marker in self.of(Mode))
        return Spec(
            self.cls.__name__,
            tuple(states),
            parameters,
            modes,
            tuple(transitions),
            self.initial(),
            tuple(switchings),
            outputs=tuple(self.output(marker) for marker in self.of(Output)),
            signals=given,
            cls=self.cls,
        )

    def names(self) -> None:
        """Report names that clash with those of a model or a record."""
        if "__init__" in vars(self.cls):
            self.faults.append(
                "it has an __init__ of its own: declare what it needs, r = hy.parameter(0.5)"
            )
        for name, marker in self.markers.items():
            taken = {State: RECORDS, Output: (*RECORDS, *MODELS)}.get(type(marker), MODELS)
            taken += tuple(DOCS) if self.drawing else ()
            if name in taken or name.startswith("_"):
                self.faults.append(f"{name}: a name in use here; choose another")
            unit = getattr(marker, "unit", "")
            if not isinstance(unit, str):
                self.faults.append(
                    f"{name}: unit={unit!r}; give text. A state's value at the start is for "
                    "hy.simulate(model, start, t)"
                )

    def discrete(self, marker: State) -> tuple[Any, ...]:
        """Kind and default of a discrete variable; empty for a state."""
        if not isinstance(marker, Discrete):
            return ()
        if not marker.kind:
            self.faults.append(
                f"discrete {marker.name}: default={marker.default!r}; give a whole number up to "
                "2^53, a finite real number, True or False"
            )
            return "int", 0
        return marker.kind, marker.default

    def shape(self, marker: State) -> tuple[int, ...]:
        """The shape of a state."""
        given = marker.shape
        whole = isinstance(given, tuple | list) and all(
            isinstance(n, int) and not isinstance(n, bool) and n > 0 for n in given
        )
        if not whole:
            self.faults.append(
                f"state {marker.name}: shape={given!r}; give whole numbers greater than 0: (3,)"
            )
        return tuple(given) if whole else ()

    def check_defaults(self) -> None:
        """Report defaults that the model's own validators refuse."""
        try:
            self.cls(**{each.name: placeholder(each) for each in declared(self.markers)[0]})
        except ParameterError as fault:
            self.faults.append(f"default of {fault}")

    def initial(self) -> str:
        modes = self.of(Mode)
        chosen = [marker.name for marker in modes if marker.initial]
        if len(modes) == 1:
            return modes[0].name
        if not modes:
            self.faults.append("no mode: write one, @hy.mode(initial=True) over its flow")
        elif len(chosen) != 1:
            which = " and ".join(chosen) or "none"
            self.faults.append(f"one mode must be initial=True; marked: {which}")
        return chosen[0] if chosen else ""

    def mode(self, marker: Mode, transitions: Sequence[Transition]) -> ModeSpec:
        self.signature(f"mode {marker.name}", marker.flow, ("t", "s"))
        edges = list(dict.fromkeys(edge.name for edge in transitions))
        unknown = [name for name in marker.limit_of if name not in edges]
        if unknown:
            known = ", ".join(edges) or "none"
            self.faults.append(
                f"mode {marker.name}: limit_of={marker.limit_of!r}: {unknown[0]!r} is no edge; "
                f"there are: {known}"
            )
        return ModeSpec(marker.name, marker.flow, marker.limit_of)

    def output(self, marker: Output) -> OutputSpec:
        self.signature(f"output {marker.name}", marker.function, ("t", "s"))
        return OutputSpec(marker.name, marker.unit, marker.doc, marker.function)

    def edge(self, marker: EdgeMarker) -> EdgeSpec:
        where = f"edge {marker.name}"
        if getattr(marker.source, "__name__", "") == marker.name:
            self.faults.append(f"{where}: write @hy.edge(source, to=mode, guard=...) over it")
            return EdgeSpec(marker.name, "", "", _unguarded, Crossing.FALLING, marker.reset)
        source, to = (
            self.target(where, "source", marker.source, self.slides()),
            self.target(where, "to", marker.to, [TERMINATE]),
        )
        self.signature(f"{where}, reset", marker.reset, ("t", "s"), draw=True)
        if marker.times is not None:
            return self.clock(where, marker, source, to)
        if marker.guard is None:
            self.faults.append(
                f"{where}: give a guard, or the times at which it fires, at= or every="
            )
            return EdgeSpec(marker.name, source, to, _unguarded, marker.crossing, marker.reset)
        self.signature(f"{where}, guard", marker.guard, ("t", "s"))
        if not isinstance(marker.crossing, Crossing):
            self.faults.append(
                f"{where}: crossing={marker.crossing!r}; use hy.FALLING, hy.RISING or hy.EITHER"
            )
        if marker.when is not None:
            self.signature(f"{where}, when", marker.when, ("t", "s"))
        if not isinstance(marker.urgent, bool):
            self.faults.append(f"{where}: urgent={marker.urgent!r}; give True or False")
        elif marker.urgent and marker.crossing is Crossing.EITHER:
            self.faults.append(
                f"{where}: urgent=True with crossing=hy.EITHER, whose guard has no side beyond "
                "zero; give hy.FALLING or hy.RISING"
            )
        made = marker.guard, marker.crossing, marker.reset
        urgent = marker.urgent is True
        return EdgeSpec(marker.name, source, to, *made, when=marker.when, urgent=urgent)

    def contacts(
        self,
        marker: ContactMarker,
        declared: tuple[Sequence[StateSpec], tuple[ParameterSpec, ...], Any],
    ) -> list[ContactSpec]:
        """The contacts of a marker: one, or one per element where the gap is an array."""
        contact = self.contact(marker, declared[1])
        count = length(self.cls, *declared, contact.guard)
        if count == 0:
            self.faults.append(f"contact {marker.name}: a gap of no element; give one or more")
        return elements(contact, count) if count else [contact]

    def clock(self, where: str, marker: EdgeMarker, source: str, to: str) -> EdgeSpec:
        """The edge as a clock; the plain edge if its times have faults."""
        assert marker.times is not None
        own = EdgeSpec(
            marker.name, source, to, _unguarded, marker.crossing, marker.reset, when=marker.when
        )
        parameters = [name for name, m in self.markers.items() if is_parameter(m)]
        found = list(faults(marker.times, parameters))
        if marker.guard is not None:
            found.append("guard= together with at= or every=; give one of them")
        if marker.when is not None:
            self.signature(f"{where}, when", marker.when, ("t", "s"))
        if marker.urgent is not False:
            found.append(
                "urgent= together with at= or every=: its times are never beyond zero; leave it out"
            )
        self.faults += [f"{where}: {fault}" for fault in found]
        return own if found else clock(own, marker.times)

    def contact(self, marker: ContactMarker, parameters: tuple[ParameterSpec, ...]) -> ContactSpec:
        where = f"contact {marker.name}"
        source = self.target(where, "mode", marker.mode)
        self.signature(f"{where}, gap", marker.gap, ("t", "s"))
        law = self.restitution(where, marker.restitution, [p.name for p in parameters])
        self.inverse_mass(where, marker.inverse_mass)
        return ContactSpec(marker.name, source, marker.gap, law, marker.rests, marker.inverse_mass)

    def switching(self, marker: Switching) -> SwitchingSpec:
        where = f"switching {marker.name}"
        positive = self.target(where, "positive", marker.positive)
        negative = self.target(where, "negative", marker.negative)
        if positive == negative:
            self.faults.append(
                f"{where}: positive and negative are both {positive!r}; give two modes"
            )
        self.alone(where, marker, {positive, negative})
        if not isinstance(marker.slides, bool):
            self.faults.append(f"{where}: slides={marker.slides!r}; give True or False")
        self.signature(f"{where}, surface", marker.surface, ("t", "s"))
        return SwitchingSpec(
            marker.name, positive, negative, marker.surface, marker.slides is not False
        )

    def alone(self, where: str, marker: Switching, modes: set[str]) -> None:
        """Report modes of a switching that have a contact or belong to another switching."""
        for contact in self.of(ContactMarker):
            source = name_of(contact.mode)
            if source in modes:
                self.faults.append(
                    f"{where}: mode {source} has the contact {contact.name}; a mode with a "
                    "switching can have no contact yet: write its impact as an edge with a reset"
                )
        for other in self.of(Switching)[: self.of(Switching).index(marker)]:
            if {str(name_of(side)) for side in (other.positive, other.negative)} == modes:
                self.faults.append(
                    f"{where}: its modes are already those of the switching {other.name}; give "
                    "each side of each surface a mode of its own"
                )

    def slides(self) -> list[str]:
        """Names of the sliding arc modes."""
        return [f"slide({marker.name})" for marker in self.of(Switching) if marker.slides]

    def restitution(self, where: str, given: Any, names: list[str]) -> Callable[..., Any]:
        if isinstance(given, str):
            if given not in names:
                known = ", ".join(names) or "none"
                self.faults.append(
                    f"{where}: restitution={given!r} is no parameter; there are: {known}"
                )
                return lambda self, t, s, u: 1.0
            return lambda self, t, s, u: getattr(self, given)
        if callable(given):
            self.signature(f"{where}, restitution", given, ("t", "s", "u"), draw=True)
            return given
        if not is_number(given) or not 0 <= float(given) <= 1:
            names = [f'"{name}"' for name, marker in self.markers.items() if marker is given]
            said = (
                f"is the parameter itself; give its name, {names[0]}"
                if names
                else (
                    f"= {given!r}; give a parameter's name, a number from 0 to 1 or a function "
                    "(self, t, s, u)"
                )
            )
            self.faults.append(f"{where}: restitution {said}")
            return lambda self, t, s, u: 1.0
        return lambda self, t, s, u: given

    def inverse_mass(self, where: str, given: Any) -> None:
        if given is None:
            return
        if callable(given):
            self.signature(f"{where}, inverse_mass", given, ("t", "s"))
            return
        try:
            mass = reals(given)
        except ValueError:
            mass = np.array(np.nan)
        if not _is_mass(mass):
            self.faults.append(
                f"{where}: inverse_mass={given!r}; give a number greater than 0, a diagonal of "
                "such numbers, a symmetric positive definite matrix or a function (self, t, s)"
            )

    def target(self, where: str, what: str, given: Any, more: Sequence[str] = ()) -> str:
        name = name_of(given)
        modes = [marker.name for marker in self.of(Mode)] + list(more)
        if name not in modes:
            known = ", ".join(modes) or "none"
            told = f"{name!r} is no mode of this class; there are: {known}"
            if what == "to" and name in self.slides():
                told += (
                    "; name one of the two modes: where both flows lead to the surface the run "
                    "slides again at once"
                )
            if inspect.isfunction(name):
                told = f"{name.__name__} is no mode: write @hy.mode over it"
            self.faults.append(f"{where}: {what}={told}")
        return str(name)

    def signature(
        self, where: str, function: Any, arguments: tuple[str, ...], draw: bool = False
    ) -> None:
        wanted = f"(self, {', '.join(arguments)})"
        past = {"past": None} if takes(function, "past") else {}
        if draw and takes(function, "draw"):
            past["draw"] = None
        if not callable(function):
            self.faults.append(f"{where}: {function!r} is not a function {wanted}")
            self.untraceable.append(function)
            return
        try:
            inspect.signature(function).bind(None, *arguments, **past)
            if misplaced(function, arguments):
                raise TypeError("another order")
        except TypeError:
            given = inspect.signature(function)
            chance = ", draw for random numbers" if draw else ""
            self.faults.append(
                f"{where}: takes {given} where {wanted} is due, and past after them for "
                f"delays{chance}"
            )
            self.untraceable.append(function)


def _is_mass(given: np.ndarray) -> bool:
    """Whether numbers are an inverse mass: one, a diagonal, or a symmetric matrix, positive."""
    if given.ndim > 2 or not np.all(np.isfinite(given)):
        return False
    if given.ndim < 2:
        return bool(np.all(given > 0))
    square = given.shape[0] == given.shape[1] and np.allclose(given, given.T, rtol=1e-12, atol=0.0)
    return bool(square and np.all(np.linalg.eigvalsh(given) > 0))
