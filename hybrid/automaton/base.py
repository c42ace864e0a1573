"""``hy.Automaton``: from a class body to one frozen spec, checked when it is defined."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from ..errors import DeclarationError, OptionError, ParameterError, TraceError
from . import trace
from .markers import Contact, Crossing, Edge, Mode, State, Switching, is_number
from .spec import (
    ContactSpec,
    EdgeSpec,
    ModeSpec,
    ParameterSpec,
    Spec,
    StateSpec,
    SwitchingSpec,
    Transition,
)

#: What to say where JAX could not trace an author's code.
REMEDIES = {
    "TracerBoolConversionError": "a choice by value: write jnp.where(condition, a, b) for `if`",
    "TracerArrayConversionError": "a numpy function of a state: use the one of jax.numpy",
    "ConcretizationTypeError": "a math function of a state: use the one of jax.numpy",
    "TracerIntegerConversionError": "an index by value: write jnp.where, or index by a constant",
}

#: What each kind of traced function belongs to.
OWNERS = {
    "flow": "mode",
    "guard": "edge",
    "reset": "edge",
    "gap": "contact",
    "restitution": "contact",
    "surface": "switching",
}


class Automaton:
    """Base class of a hybrid automaton; a model is a subclass.

    ``Model(**parameters)`` makes a model with these parameter values; ``attrs.evolve``
    changes some of them. Models are frozen, compare by value and are JAX pytrees whose
    leaves are the parameters.

    Raises
    ------
    DeclarationError
        When the subclass is defined: all its faults together.
    ParameterError
        When a model is made with an unknown parameter or a value outside its bounds.
    """

    spec: ClassVar[Spec]
    traces: ClassVar[Mapping[tuple[str, str], Any]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        markers = _collect(cls)
        _make_attrs(cls, markers)
        builder = _Builder(cls, markers)
        cls.spec = builder.build()
        cls.traces, faults = _trace_all(cls, cls.spec, builder.untraceable)
        builder.check_defaults()
        if builder.faults or faults:
            raise DeclarationError(cls.__name__, builder.faults + faults)
        _register_pytree(cls)

    def __init__(self, **parameters: Any) -> None:
        raise TypeError("hy.Automaton is a base class: define a subclass with modes and edges")

    @property
    def parameters(self) -> tuple[np.ndarray, ...]:
        """Values of the parameters, as arrays of 64 bits, in declared order."""
        return tuple(np.asarray(getattr(self, p.name), dtype=float) for p in self.spec.parameters)


def _collect(cls: type) -> dict[str, Any]:
    """Markers of the class and its bases by name; a subclass overrides in place."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        if base in (object, Automaton):
            continue
        for name, value in vars(base).get("_hybrid_markers", vars(base)).items():
            if _is_marker(value):
                found[name] = value
            elif name in found and base is cls:
                del found[name]
    return found


def _is_marker(value: Any) -> bool:
    return isinstance(value, State | Mode | Edge | Contact | Switching) or _is_parameter(value)


def _is_parameter(value: Any) -> bool:
    return getattr(value, "metadata", {}).get("hybrid") == "parameter"


def _make_attrs(cls: type, markers: dict[str, Any]) -> None:
    """Make the class a frozen attrs class whose fields are its parameters."""
    fields = {name: value for name, value in markers.items() if _is_parameter(value)}
    cls._hybrid_markers = dict(markers)  # type: ignore[attr-defined]
    for name in list(vars(cls)):
        if isinstance(vars(cls)[name], State) or name in fields:
            delattr(cls, name)
    attrs.frozen(cls, these=fields, slots=False, kw_only=True)
    generated = vars(cls)["__init__"]

    def __init__(self: Any, *values: Any, **parameters: Any) -> None:
        if values:
            raise ParameterError(f"{cls.__name__}: give parameters by name, {cls.__name__}(r=0.5)")
        unknown = [name for name in parameters if name not in fields]
        if unknown:
            raise ParameterError(
                f"{cls.__name__} has no parameter {unknown[0]!r}; "
                f"there are: {', '.join(fields) or 'none'}"
            )
        generated(self, **parameters)

    __init__.__doc__ = f"Parameters of {cls.__name__}: {', '.join(fields)}."
    cls.__init__ = __init__  # type: ignore[misc]


class _Builder:
    """Turns the markers of one class into a spec and a list of faults."""

    def __init__(self, cls: type, markers: dict[str, Any]) -> None:
        self.cls, self.markers = cls, markers
        self.faults: list[str] = []
        self.untraceable: list[Any] = []

    def of(self, kind: type) -> list[Any]:
        return [marker for marker in self.markers.values() if isinstance(marker, kind)]

    def build(self) -> Spec:
        states, offset = [], 0
        for marker in self.of(State):
            states.append(StateSpec(marker.name, marker.unit, marker.doc, marker.shape, offset))
            offset += states[-1].size
        parameters = tuple(
            ParameterSpec(name, m._default, m.metadata["unit"], m.metadata["doc"])
            for name, m in self.markers.items()
            if _is_parameter(m)
        )
        if not states:
            self.faults.append("no state: declare one, x = hy.state()")
        modes = tuple(self.mode(marker) for marker in self.of(Mode))
        transitions: list[Transition] = []
        switchings = []
        for m in self.markers.values():
            if isinstance(m, Edge):
                transitions.append(self.edge(m))
            elif isinstance(m, Contact):
                transitions.append(self.contact(m, parameters))
            elif isinstance(m, Switching):
                switchings.append(self.switching(m))
                transitions += switchings[-1].sides
        return Spec(
            self.cls.__name__,
            tuple(states),
            parameters,
            modes,
            tuple(transitions),
            self.initial(),
            tuple(switchings),
        )

    def check_defaults(self) -> None:
        """Each default must be a value that the model could be given."""
        try:
            self.cls()
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

    def mode(self, marker: Mode) -> ModeSpec:
        self.signature(f"mode {marker.name}", marker.flow, ("t", "s"))
        return ModeSpec(marker.name, marker.flow)

    def edge(self, marker: Edge) -> EdgeSpec:
        where = f"edge {marker.name}"
        source, to = (
            self.target(where, "source", marker.source, self.slides()),
            self.target(where, "to", marker.to),
        )
        self.signature(f"{where}, reset", marker.reset, ("t", "s"))
        self.signature(f"{where}, guard", marker.guard, ("t", "s"))
        if not isinstance(marker.crossing, Crossing):
            self.faults.append(
                f"{where}: crossing={marker.crossing!r}; use hy.FALLING, hy.RISING or hy.EITHER"
            )
        return EdgeSpec(marker.name, source, to, marker.guard, marker.crossing, marker.reset)

    def contact(self, marker: Contact, parameters: tuple[ParameterSpec, ...]) -> ContactSpec:
        where = f"contact {marker.name}"
        source = self.target(where, "mode", marker.mode)
        self.signature(f"{where}, gap", marker.gap, ("t", "s"))
        law = self.restitution(where, marker.restitution, [p.name for p in parameters])
        return ContactSpec(marker.name, source, marker.gap, law, marker.rests, marker.inverse_mass)

    def switching(self, marker: Switching) -> SwitchingSpec:
        where = f"switching {marker.name}"
        positive = self.target(where, "positive", marker.positive)
        negative = self.target(where, "negative", marker.negative)
        if positive == negative:
            self.faults.append(
                f"{where}: positive and negative are both {positive!r}; give two modes"
            )
        for contact in self.of(Contact):
            source = getattr(contact.mode, "name", contact.mode)
            if source in (positive, negative):
                self.faults.append(
                    f"{where}: mode {source} has the contact {contact.name}; a mode with a "
                    "switching can have no contact yet: write its impact as an edge with a reset"
                )
        if not isinstance(marker.slides, bool):
            self.faults.append(f"{where}: slides={marker.slides!r}; give True or False")
        self.signature(f"{where}, surface", marker.surface, ("t", "s"))
        return SwitchingSpec(
            marker.name, positive, negative, marker.surface, marker.slides is not False
        )

    def slides(self) -> list[str]:
        """Arc modes in which the state slides on a surface."""
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
            self.signature(f"{where}, restitution", given, ("t", "s", "u"))
            return given
        if not is_number(given) or not 0 <= float(given) <= 1:
            self.faults.append(
                f"{where}: restitution={given!r}; give a parameter's name, "
                "a number from 0 to 1 or a function (self, t, s, u)"
            )
            return lambda self, t, s, u: 1.0
        return lambda self, t, s, u: given

    def target(self, where: str, what: str, given: Any, more: Sequence[str] = ()) -> str:
        name = given.name if isinstance(given, Mode) else given
        modes = [marker.name for marker in self.of(Mode)] + list(more)
        if name not in modes:
            known = ", ".join(modes) or "none"
            self.faults.append(
                f"{where}: {what}={name!r} is no mode of this class; there are: {known}"
            )
        return str(name)

    def signature(self, where: str, function: Any, arguments: tuple[str, ...]) -> None:
        wanted = f"(self, {', '.join(arguments)})"
        if not callable(function):
            self.faults.append(f"{where}: {function!r} is not a function {wanted}")
            self.untraceable.append(function)
            return
        try:
            inspect.signature(function).bind(None, *arguments)
        except TypeError:
            given = inspect.signature(function)
            late = "past" in given.parameters
            why = "; flows that look into the past cannot be simulated yet" if late else ""
            self.faults.append(f"{where}: takes {given} where {wanted} is due{why}")
            self.untraceable.append(function)


def _trace_all(
    cls: type, spec: Spec, skipped: list[Any]
) -> tuple[dict[tuple[str, str], Any], list[str]]:
    """Trace every function of the model; faults are sentences."""
    traces: dict[tuple[str, str], Any] = {}
    faults: list[str] = []

    def add(
        kind: str, owner: str, function: Callable[..., Any], whole: bool, extra: int = 0
    ) -> None:
        if not spec.states or any(function is other for other in skipped):
            return
        call = trace.caller(cls, spec, function)
        call = trace.vector(spec, call) if whole else trace.scalar(call)
        label = f"{OWNERS[kind]} {owner}" + ("" if kind == "flow" else f", {kind}")
        try:
            closed = trace.trace(spec, call, extra)
            trace.require_wide(closed, function)
            traces[kind, owner] = closed
        except Exception as fault:  # whatever the author's code raises is a fault to report
            reason = REMEDIES.get(type(fault).__name__) or str(fault).split("\n")[0]
            named = isinstance(fault, ValueError | TraceError)
            faults.append(
                f"{label}: {reason}" if named else f"{label}: {type(fault).__name__}: {reason}"
            )

    for mode in spec.modes:
        add("flow", mode.name, mode.flow, True)
    for edge in spec.transitions:
        if isinstance(edge, ContactSpec):
            add("gap", edge.name, edge.guard, False)
            add("restitution", edge.name, edge.restitution, False, 1)
        elif isinstance(edge, EdgeSpec):
            add("guard", edge.name, edge.guard, False)
            add("reset", edge.name, edge.reset, True)
    for switching in spec.switchings:
        add("surface", switching.name, switching.surface, False)
    return traces, faults


def _register_pytree(cls: type) -> None:
    """Make the model a pytree; it is rebuilt without validators."""
    import jax

    names = [parameter.name for parameter in cls.spec.parameters]  # type: ignore[attr-defined]

    def flatten(model: Any) -> tuple[list[Any], None]:
        return [getattr(model, name) for name in names], None

    def unflatten(_: None, leaves: Any) -> Any:
        return trace.instance(cls, names, leaves)

    jax.tree_util.register_pytree_node(cls, flatten, unflatten)


def require_model(model: Any) -> None:
    """Refuse what is no instance of a model.

    Raises
    ------
    OptionError
    """
    if not hasattr(model, "spec"):
        what = "an instance: write Model()" if isinstance(model, type) else repr(type(model))
        raise OptionError(f"model must be an instance of a subclass of hy.Automaton, not {what}")
    if isinstance(model, type):
        raise OptionError(f"give an instance of the model: {model.__name__}()")
