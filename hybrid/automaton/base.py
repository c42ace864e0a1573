"""``hy.Automaton``: from a class body to one frozen spec, checked when it is defined."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import attrs
import numpy as np

from ..errors import DeclarationError, OptionError, ParameterError, TraceError
from . import trace
from .builder import Builder
from .markers import Contact, Edge, Mode, State, Switching, is_parameter
from .spec import ContactSpec, EdgeSpec, Spec

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
        builder = Builder(cls, markers)
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
    return isinstance(value, State | Mode | Edge | Contact | Switching) or is_parameter(value)


def _make_attrs(cls: type, markers: dict[str, Any]) -> None:
    """Make the class a frozen attrs class whose fields are its parameters."""
    fields = {name: value for name, value in markers.items() if is_parameter(value)}
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
