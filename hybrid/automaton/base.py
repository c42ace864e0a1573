"""``hy.Automaton``: turns a class body into one frozen spec, checked at class definition."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from ..errors import PLOT, DeclarationError, OptionError, ParameterError, need
from . import outputs, refusals, signals, trace
from .body import AutomatonMeta, given_twice, kind_of
from .builder import Builder
from .captured import Captured, captured, takes
from .chance import DRAWS, counted
from .clocks import require_clocks
from .markers import State, is_parameter
from .past import Asking, Lags, Past, plain
from .spec import ClockSpec, ContactSpec, EdgeSpec, Spec

#: What to do where discrete variables are not taken.
COUNT_IN_RUN = "leave them out of the model, and count in run.jumps"

#: The kind of declaration that each kind of traced function belongs to.
OWNERS = {
    "flow": "mode",
    "guard": "edge",
    "reset": "edge",
    "clock": "edge",
    "when": "edge",
    "gap": "contact",
    "restitution": "contact",
    "surface": "switching",
    "output": "output",
}

#: The kinds of which only values are needed: a function without a derivative may be in these.
VALUES_ONLY = ("reset", "restitution", "when", "clock")


class Automaton(metaclass=AutomatonMeta):
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
    _captured: ClassVar[tuple[tuple[str, Captured], ...]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        markers = _collect(cls)
        builder = Builder(cls, markers)
        builder.names()
        builder.faults += given_twice(vars(cls))
        builder.faults += outputs.faults(markers, _inherited(cls))
        _make_attrs(cls, markers)
        traced = _Traced(cls, builder.build(), builder.untraceable)
        traced.all()
        cls.spec, cls.traces = traced.spec, traced.traces
        cls._captured = tuple(_captured(cls, cls.spec))
        builder.check_defaults()
        if builder.faults or traced.faults:
            raise DeclarationError(cls.__name__, builder.faults + traced.faults)
        _register_pytree(cls)

    def __init__(self, **parameters: Any) -> None:
        raise TypeError("hy.Automaton is a base class: define a subclass with modes and edges")

    @property
    def parameters(self) -> tuple[np.ndarray, ...]:
        """Parameter values as float64 arrays, in declared order."""
        return tuple(np.asarray(getattr(self, p.name), dtype=float) for p in self.spec.parameters)

    @property
    def samples(self) -> tuple[signals.Samples, ...]:
        """The data of the signals, in declared order."""
        return tuple(getattr(self, signal.name) for signal in self.spec.signals)

    @classmethod
    def draw(cls, path: Any = None) -> Any:
        """Draw the automaton: modes as boxes, edges as arrows labelled with their crossing.

        The resting modes of contacts and the sliding modes of switchings are dashed.

        Parameters
        ----------
        path : str or path, optional
            Also write the figure to this file.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OptionError
            If matplotlib is missing.
        """
        need("Model.draw", PLOT)
        from ..plot.graph import draw, graph

        return draw(graph(cls.spec), path)


def _collect(cls: type) -> dict[str, Any]:
    """Markers of the class and its bases, by name; a subclass overrides in place."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        if base in (object, Automaton):
            continue
        for name, value in vars(base).get("_hybrid_markers", vars(base)).items():
            if kind_of(value):
                found[name] = value
            elif name in found and base is cls:
                del found[name]
    return found


def _inherited(cls: type) -> dict[str, Any]:
    """Markers of the bases, by name."""
    bases = [vars(base).get("_hybrid_markers", {}) for base in reversed(cls.__mro__[1:])]
    return {name: marker for markers in bases for name, marker in markers.items()}


def _make_attrs(cls: type, markers: dict[str, Any]) -> None:
    """Make the class a frozen attrs class whose fields are its parameters and signals."""
    known, _ = signals.declared(markers)
    given = [spec.name for spec in known]
    fields = {n: value for n, value in markers.items() if is_parameter(value) or n in given}
    cls._hybrid_markers = dict(markers)  # type: ignore[attr-defined]
    if "__init__" in vars(cls):
        delattr(cls, "__init__")  # a fault that Builder.names has reported
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
            raise ParameterError(refusals.unknown_parameter(cls, unknown[0], fields))
        generated(self, **parameters | signals.taken(cls.__name__, known, parameters))
        require_clocks(self, cls.spec)  # type: ignore[attr-defined]

    __init__.__doc__ = f"Parameters of {cls.__name__}: {', '.join(fields)}."
    cls.__init__ = __init__  # type: ignore[misc]
    cls.__setattr__ = refusals.unchanging  # type: ignore[assignment]


def require_values(cls: Any, values: Sequence[Any]) -> None:
    """Refuse numbers for the parameters of a class as its constructor does.

    Raises
    ------
    ParameterError
        If a parameter, or the times of a clock, cannot have them.
    """
    names = [parameter.name for parameter in cls.spec.parameters]
    model, fields = trace.instance(cls, names, values), attrs.fields_dict(cls)
    for name, value in zip(names, values, strict=True):
        check = fields[name].validator
        if check is not None:
            check(model, fields[name], value)
    require_clocks(model, cls.spec)


class _Traced:
    """Traces the functions of a class; ``faults`` collects one sentence per failure."""

    def __init__(self, cls: type, spec: Spec, skipped: list[Any]) -> None:
        self.cls, self.spec, self.skipped = cls, spec, skipped
        self.traces: dict[tuple[str, str], Any] = {}
        self.faults: list[str] = []

    def all(self) -> None:
        """Find the lags that the functions ask for, then trace every function."""
        functions = list(_functions(self.spec)) if self.spec.states else []
        functions = [f for f in functions if not any(f[2] is other for other in self.skipped)]
        lags = Lags(self.spec)
        if self.spec.signals and any(takes(f[2], "past") for f in functions):
            self.faults.append(
                f"signal {self.spec.signals[0].name}: a model that looks into the past can have no "
                "signal yet: write it as a function of t"
            )
            return
        for each in functions:
            if takes(each[2], "past"):
                self._guarded(self._ask, lags, each)
        functions = [f for f in functions if not takes(f[2], "past") or f[:2] in lags.numbers]
        self.spec = attrs.evolve(self.spec, lags=tuple(lags.found))
        for each in functions:
            self._guarded(self._add, lags, each)

    def _guarded(self, make: Callable[..., None], lags: Lags, each: Any) -> None:
        label = _label(*each[:2])
        try:
            make(lags, *each)
        except Exception as fault:  # whatever the author's code raises is a fault to report
            said = f"{label}: {refusals.reason(fault)}"
            if said not in self.faults:
                self.faults.append(said)

    def _ask(
        self, lags: Lags, kind: str, owner: str, function: Any, whole: bool, extra: int
    ) -> None:
        """Record which lags a function asks for."""
        notes: list[Asking] = []

        def past(*given: Any) -> Asking:
            notes.append(Asking(*given))
            return notes[-1]

        call = trace.caller(self.cls, self.spec, function, past=past)
        where = f"{OWNERS[kind]} {owner}"

        def listens(parameters: Any, t: Any, x: Any, *more: Any) -> Any:
            call(parameters, t, x, *more)
            lags.note((kind, owner), where, notes[-1].lags, parameters)
            return t

        trace.trace(self.spec, listens, extra)

    def _add(
        self, lags: Lags, kind: str, owner: str, function: Any, whole: bool, extra: int
    ) -> None:
        numbers = lags.numbers.get((kind, owner), [])
        call = trace.caller(self.cls, self.spec, function, numbers)
        others = {"output": outputs.numbers, "when": trace.condition}
        shaped = others.get(kind, trace.scalar)
        call = trace.vector(self.spec, call, kind == "flow") if whole else shaped(call)
        if takes(function, "draw"):
            call = counted(self.spec.place(DRAWS), call)
        closed = trace.trace(self.spec, call, extra)
        trace.require_wide(self.cls, closed, function)
        trace.require_repeatable(self.cls, self.spec, call, extra, closed, function)
        if kind == "output":  # no other reader needs the trace of an output
            return
        trace.require_real(closed)
        if kind != "flow":
            used = require_written(closed, kind not in VALUES_ONLY)
            if kind in ("guard", "surface"):
                self._require_moving(kind, owner, used)
        self.traces[kind, owner] = closed
        for place, number in enumerate(numbers):
            name = self.spec.lags[number].name
            if ("lag", name) not in self.traces:
                self.traces["lag", name] = self._plain_lag(name, function, numbers, place, extra)

    def _require_moving(self, kind: str, owner: str, used: set[int]) -> None:
        """Refuse a guard that no flow changes: ``used`` are the inputs that it depends on."""
        first = sum(math.prod(np.shape(parameter.default)) for parameter in self.spec.parameters)
        flows = range(first, first + sum(map(math.prod, self.spec.windows)) + 1 + self.spec.flows)
        urgent = any(e.name == owner and getattr(e, "urgent", False) for e in self.spec.transitions)
        if urgent or used.intersection(flows):
            return
        what = "parameters and discrete variables alone" if used else "nothing"
        raise ValueError(
            f"it depends on {what}, so that no flow leads it to zero; "
            + (
                "urgent=True fires where it is beyond zero when the mode is entered"
                if kind == "guard"
                else "make it depend on t or on a state"
            )
        )

    def _plain_lag(
        self, name: str, function: Any, numbers: list[int], place: int, extra: int
    ) -> Any:
        """The trace of a lag.

        Raises
        ------
        ValueError
            If the lag itself depends on the past or on an impact speed.
        """
        lag = self._lag(function, numbers, place)
        if not plain(trace.trace(self.spec, lag, extra), len(self.spec.parameters), extra):
            raise ValueError(
                f"past(lag): the lag ({name}) depends on past(...), or on the speed of an impact; "
                "it may depend on parameters, t and s"
            )
        closed = trace.trace(self.spec, lambda *given: lag(*given, *[-1.0] * extra))
        require_written(closed)
        return closed

    def _lag(self, function: Any, numbers: list[int], place: int) -> Callable[..., Any]:
        """The lag passed in call number ``place`` of ``past``, as a function."""
        made: list[Past] = []

        def past(*given: Any) -> Past:
            made.append(Past(*given))
            return made[-1]

        call = trace.caller(self.cls, self.spec, function, numbers, past)

        def lag(parameters: Any, t: Any, x: Any, *more: Any) -> Any:
            call(parameters, t, x, *more)
            return made[-1].lags[place]

        return trace.scalar(lag)


def require_written(closed: Any, derived: bool = False) -> set[int]:
    """See :func:`hybrid.lowering.jaxpr.require_written`."""
    from ..lowering import jaxpr

    return jaxpr.require_written(closed, derived)


def _label(kind: str, owner: str) -> str:
    """The name of a function in messages."""
    return f"{OWNERS[kind]} {owner}" + ("" if kind in ("flow", "output") else f", {kind}")


def _captured(cls: type, spec: Spec) -> Iterator[tuple[str, Captured]]:
    """What each function of a class reads besides its arguments, with the function's label."""
    for kind, owner, function, *_ in _functions(spec):
        yield from ((_label(kind, owner), found) for found in captured(cls, function))


def _functions(spec: Spec) -> Iterator[tuple[str, str, Any, bool, int]]:
    """Yield kind, owner, function, whether it returns a whole state, number of extra arguments."""
    for mode in spec.modes:
        yield "flow", mode.name, mode.flow, True, 0
    for edge in spec.transitions:
        if isinstance(edge, ContactSpec):
            yield "gap", edge.name, edge.guard, False, 0
            yield "restitution", edge.name, edge.restitution, False, 1
        elif isinstance(edge, EdgeSpec):
            yield "guard", edge.name, edge.guard, False, 0
            yield "reset", edge.name, edge.reset, True, 0
            if edge.when is not None:
                yield "when", edge.name, edge.when, False, 0
        if isinstance(edge, ClockSpec):
            yield "clock", edge.name, edge.after, False, 0
    for switching in spec.switchings:
        yield "surface", switching.name, switching.surface, False, 0
    for output in spec.outputs:
        if not takes(output.function, "past"):  # a fault that outputs.faults reports
            yield "output", output.name, output.function, False, 0


def _register_pytree(cls: type) -> None:
    """Register the model as a pytree; unflattening skips the validators."""
    import jax

    names = [parameter.name for parameter in cls.spec.parameters]  # type: ignore[attr-defined]

    given = [signal.name for signal in cls.spec.signals]  # type: ignore[attr-defined]

    def flatten(model: Any) -> tuple[list[Any], tuple[Any, ...]]:
        return [getattr(model, n) for n in names], tuple(getattr(model, n) for n in given)

    def unflatten(data: tuple[Any, ...], leaves: Any) -> Any:
        return trace.instance(cls, [*names, *given], [*leaves, *data])

    jax.tree_util.register_pytree_node(cls, flatten, unflatten)


def require_no_discrete(model: Any, what: str, instead: str) -> None:
    """Refuse a model with discrete variables."""
    if getattr(model, "spec", None) and model.spec.discrete:
        if model.spec.chances:
            instead = f"{model.spec.chances[0]} draws random numbers; let it draw none for this"
        raise OptionError(
            f"{what} takes no discrete variable yet, and {model.spec.model} has "
            f"{', '.join(state.name for state in model.spec.discrete)}: {instead}"
        )


def require_model(model: Any) -> None:
    """Refuse anything but a model instance, and a model whose captured values have changed.

    Raises
    ------
    OptionError
        If ``model`` is not an instance of a model.
    DeclarationError
        If a global, a closure variable or a class attribute that its functions read has changed
        since the class was made.
    """
    if not hasattr(model, "spec"):
        what = "an instance: write Model()" if isinstance(model, type) else repr(type(model))
        raise OptionError(f"model must be an instance of a subclass of hy.Automaton, not {what}")
    if isinstance(model, type):
        raise OptionError(f"give an instance of the model: {model.__name__}()")
    faults = []
    for label, found in type(model)._captured:
        change = found.change()
        if change is not None:
            faults.append(
                f"{label}: {change}; functions are read once: make it a hy.parameter, or make "
                "the class again"
            )
    if faults:
        raise DeclarationError(type(model).__name__, list(dict.fromkeys(faults)))
