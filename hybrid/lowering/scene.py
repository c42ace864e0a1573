"""A model made ready to run: scalar functions of its modes, guards and contacts.

Graphs and generated code depend on the class alone and are cached on it. Parameter values are bound
once per run, in microseconds. Nothing is made for a mode that a run does not enter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import cached_property, lru_cache, partial
from typing import Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.past import blank
from ..automaton.signals import Samples
from ..automaton.signals import blank as no_signal
from ..automaton.spec import (
    ContactSpec,
    EdgeSpec,
    LeaveSpec,
    SideSpec,
    Spec,
    Transition,
)
from ..errors import OptionError, ParameterError, TraceError
from .automaton import Tables
from .derivatives import node_shape
from .field import Contact, Field, Guard, Kink, Scalar
from .lowered import lowered
from .mode import RELEASE_SUFFIX, Kind, ModeGraph
from .python import Program
from .sides import above, deciders
from .tape import Jets, Tape
from .taylor import flat


class Scene:
    """A model with its parameter values, ready for a driver.

    Fields and contacts are made on first use and cached.
    """

    def __init__(
        self,
        cls: Any,
        shapes: tuple[tuple[int, ...], ...],
        values: tuple[float, ...],
        samples: tuple[Samples, ...] = (),
    ) -> None:
        self.spec: Spec = cls.spec
        self.code = lowered(cls, shapes)
        self._made, self.values, self.samples, self.until = (cls, shapes), values, samples, math.inf
        self._bound: dict[Any, Scalar] = {}
        self._fields: dict[str, Field] = {}
        self._contacts: dict[str, Contact] = {}
        self._names: dict[tuple[str, frozenset[str]], str] = {}

    def __reduce__(self) -> Any:
        """Pickle the class and the numbers; derived objects are made again."""
        return Scene, (*self._made, self.values, self.samples)

    @cached_property
    def parameters(self) -> tuple[Any, ...]:
        """Parameter values, then the signal pieces and the windows of the past."""
        return _arrays(self.code.shapes, self.values)

    def through(self, windows: Sequence[np.ndarray]) -> Scene:
        """The same model with other windows of the past."""
        shown = tuple(flat(windows))
        return Scene(*self._made, (*self.values[: len(self.values) - len(shown)], *shown))

    def at(self, t: float) -> Scene:
        """The same model with the signal pieces at time ``t``; ``until`` is the next knot."""
        if not self.samples:
            return self
        there = Scene(*self._made, self.values_at(t), self.samples)
        there.until = float(self.knots(t, math.inf, 1)[1])
        return there

    def through_time(self, times: Iterable[float]) -> Iterator[Scene]:
        """The same model at each of some increasing times."""
        here, since = self, math.inf
        for t in times:
            if self.samples and not since <= t < here.until:
                here, since = self.at(t), t
            yield here

    def values_at(self, t: float) -> tuple[float, ...]:
        """The numeric values, with the signal pieces at time ``t``."""
        if not self.samples:
            return self.values
        row = self.pieces(np.array([t]))[0].tolist()
        return (*self.values[: len(self.values) - len(row)], *row)

    def span(self, t: float) -> tuple[float, float]:
        """The time interval around ``t`` on which the signal pieces do not change."""
        begun = (float(each.pieces(np.array([t]))[0, 0]) for each in self.samples)
        return max((s for s in begun if s <= t), default=-math.inf), float(
            self.knots(t, math.inf, 1)[1]
        )

    def pieces(self, times: np.ndarray) -> np.ndarray:
        """The numbers of the signal pieces at some times, one row per time."""
        return np.concatenate([each.pieces(times) for each in self.samples], axis=1)

    def knots(self, t: float, last: float, count: int) -> np.ndarray:
        """Ends of successive signal pieces: ``t``, up to ``count`` knots after it, and the next
        knot or ``last``."""
        found = [each.knots(t, last, count + 1) for each in self.samples]
        all_ = np.unique(np.concatenate(found))[: count + 1]
        full = [each[-1] for each in found if len(each) == count + 1]
        all_ = all_[all_ <= min(full, default=last)]
        return np.array([t, *all_, *([last] if len(all_) <= count else [])])

    @cached_property
    def modes(self) -> tuple[str, ...]:
        """Modes in which a run may start: declared, resting with one contact, and sliding modes."""
        rests = [
            rest_name(e.source, (e.name,))
            for e in self.spec.transitions
            if isinstance(e, ContactSpec) and e.rests
        ]
        slides = [switching.mode for switching in self.spec.switchings if switching.slides]
        return (*(mode.name for mode in self.spec.modes), *rests, *slides)

    def starts(self, name: str) -> bool:
        """Whether a run may start in an arc mode; resting modes with several contacts included."""
        if name in self.modes:
            return True
        mode, held = parted(name)
        return all(each in self.modes for each in (mode, *(rest_name(mode, (c,)) for c in held)))

    def name(self, mode: str, held: Collection[str]) -> str:
        """The arc mode with the contacts ``held``, which it names in declared order."""
        if not held:
            return mode
        key = mode, frozenset(held)
        if key not in self._names:
            order = (edge.name for edge in self.spec.leaving(mode) if edge.name in key[1])
            self._names[key] = rest_name(mode, tuple(order))
        return self._names[key]

    def field(self, name: str, touching: Collection[str] = ()) -> Field:
        """The field of a mode or of a resting mode ``"mode.rest(contact, ...)"``.

        ``touching`` names contacts at which a flight begins. If such a gap has a corner at zero, as
        a distance does, it uses the formula that holds at zero throughout: rounding decides on
        which side of the corner the state lies, so the side means nothing.
        """
        if name not in self._fields:
            self._fields[name] = self._make_field(name, *parted(name))
        field = self._fields[name]
        if not touching:
            return field
        graph = self.code.mode(field.mode)
        corners = frozenset(contact for contact in touching if graph.cornered(contact))
        return field.once(corners, lambda: self._touching(field, corners)) if corners else field  # type: ignore[no-any-return]

    def _make_field(self, name: str, mode: str, held: tuple[str, ...]) -> Field:
        code, switching = self.code, self.spec.sliding(mode)
        numbers = self.numbers(mode, held)
        if held or switching is not None:
            along = code.mode(mode)
            rhs = along.program(("flow", bool(held)), lambda: along.flow(bool(held))).bind(numbers)
            project = self.projection(mode, held, self.values)
        else:
            closed = lambda: code.closed("flow", mode)  # noqa: E731
            program = code.program(("field", mode), closed, exact=True)
            rhs, project = program.bind(self.values), None
        edges = [edge for edge in self.spec.leaving(mode) if edge.name not in held]
        watched: list[tuple[Transition, Kind]] = [(edge, _kind(edge)) for edge in edges]
        watched += [(_unwritten(f"{c}{RELEASE_SUFFIX}", name, mode), Kind.RELEASE) for c in held]
        windows = list(code.guards_closed(mode))[len(self.spec.leaving(mode)) :]
        watched += [(_unwritten(window, mode, mode), Kind.WINDOW) for window in windows]
        guards = tuple(self._guard(*each, mode, held) for each in watched)
        series = self._series(mode, held, [guard.edge for guard in guards])
        trace = lambda: code.field_closed(mode, held)  # noqa: E731
        jets, refused = (series, "") if isinstance(series, Jets) else (None, series)
        changes = self._kinks(mode, held, "flow", lambda g: g.flow(bool(held)))
        clocks = tuple(self._clock(edge, mode, held) for edge in self.spec.ringing(mode))
        made = trace, code, self.parameters, numbers, project, refused, changes, self, clocks
        return Field(name, mode, held, rhs, jets, guards, *made)

    def _touching(self, field: Field, corners: frozenset[str]) -> Field:
        guards = tuple(
            self._on_zero(field, guard) if guard.edge in corners else guard
            for guard in field.guards
        )
        series = self._series(field.mode, field.held, [guard.edge for guard in guards], corners)
        jets = series if isinstance(series, Jets) else None
        return attrs.evolve(field, jets=jets, guards=guards, touching=corners)

    def _on_zero(self, field: Field, guard: Guard) -> Guard:
        """The guard of a contact, with the formula that its gap has at zero."""
        name, mode, held = guard.edge, field.mode, bool(field.held)
        graph = self.code.mode(mode)
        gap = graph.program(("gap on", name), lambda: [graph.contact(name).gap])
        lie = graph.program(("lie on", name, held), lambda: graph.lie_on(name, held))
        first, rates = gap.bind(field.numbers), lie.bind(field.numbers)
        affine, _ = node_shape(graph.graph, graph.contact(name).gap)
        kinks = self._kinks(mode, field.held, f"{name} on", lambda g: [g.contact(name).gap])
        value = lambda t, x: first(t, x)[0]  # noqa: E731
        return attrs.evolve(guard, value=value, lie=rates, affine=affine, kinks=kinks)

    @cached_property
    def tables(self) -> Tables:
        """The fields as arrays for the rules' loop, which makes its own Taylor steps."""
        return Tables(self)

    @cached_property
    def watched(self) -> Tables:
        """The same, with steps made by another solver."""
        return Tables(self, others=True)

    def _kinks(
        self,
        mode: str,
        held: tuple[str, ...],
        what: str,
        nodes: Callable[[ModeGraph], list[int]],
    ) -> tuple[Kink, ...]:
        """Where some nodes of a mode's graph change their formula."""
        key, graph = (what, mode, bool(held)), self.code.mode(mode)
        make = lambda: deciders(graph.graph, len(graph.x), nodes(graph))  # noqa: E731
        found, numbers = self.code.once(("kinks", key), make), self.numbers(mode, held)

        def besides(place: int, others: tuple[int, ...]) -> Scalar:
            one = lambda: above(graph.graph, len(graph.x), found[place], others)  # noqa: E731
            return self.bind(self.code.once(("kinks", key, place, others), one), numbers)

        return tuple(
            Kink(
                (*key, place),
                self.bind(kink.program, numbers),
                kink.affine,
                kink.elements,
                kink.change,
                {(*key, other): other for other in kink.under},
                partial(besides, place),
            )
            for place, kink in enumerate(found)
        )

    def moved_by(self, field: Field, contact: str) -> tuple[Kink, ...]:
        """Where the gap of a contact, or its speed, changes its formula: there the contact may be
        moved away from a body at rest."""
        nodes = lambda g: [g.contact(contact).gap, g.contact(contact).speed]  # noqa: E731
        return self._kinks(field.mode, field.held, f"{contact} moves", nodes)

    def numbers(self, mode: str, held: tuple[str, ...]) -> tuple[float, ...]:
        """The parameter values, then the mask of a mode's held contacts."""
        return (*self.values, *self.code.mode(mode).masked(held))

    def _series(
        self,
        mode: str,
        held: tuple[str, ...],
        guards: list[str],
        touching: frozenset[str] = frozenset(),
    ) -> Jets | str:
        """The series of the flow and of some guards; a message if there are none."""
        tape = self.code.tape(mode, bool(held), touching)
        if not isinstance(tape, Tape):
            return str(tape)
        order = self.code.mode(mode).watched(bool(held))
        return tape.bind(self.numbers(mode, held), [order.index(guard) for guard in guards])

    def projection(self, mode: str, held: tuple[str, ...], values: tuple[float, ...]) -> Scalar:
        """The projection onto a sliding surface or held contacts, for given parameter values."""
        return self.projector(mode, held)(values)

    def projector(self, mode: str, held: tuple[str, ...]) -> Callable[[tuple[float, ...]], Scalar]:
        """The same for the values that come."""
        switching, graph = self.spec.sliding(mode), self.code.mode(mode)
        if switching is not None:
            return self.code.onto(switching.name).bind
        project, mask = graph.projector(), graph.masked(held)
        return lambda values: project((*values, *mask))

    def _guard(self, edge: Transition, kind: Kind, mode: str, held: tuple[str, ...]) -> Guard:
        code, graph, name = self.code, self.code.mode(mode), edge.name
        numbers = self.numbers(mode, held)
        if kind is Kind.RELEASE:
            value = graph.program(("load", name), lambda: [graph.guard(name)])
            place = held.index(released(name))
            trace = lambda: code.load_closed(held, place)  # noqa: E731
            first = value.bind(numbers)
            here = lambda t, x: first(t, x)[0]  # noqa: E731
        else:
            trace = graph.traced(name)
            here = code.program(("guard", name, mode), trace).bind(self.values)
        lie = graph.program(("lie", name, bool(held)), lambda: graph.lie(name, bool(held)))
        shape = lambda: node_shape(graph.graph, graph.guard(name))  # noqa: E731
        affine, uses = code.once(("shape", name, mode), shape)
        kinks = self._kinks(mode, held, name, lambda g: g.deciding(name))
        bounds = kind is not Kind.EDGE or code.bounds(edge, self.values)
        when, urgent = None, False
        if isinstance(edge, EdgeSpec) and kind in (Kind.EDGE, Kind.CLOCK):
            urgent = edge.urgent
            if edge.when is not None:
                closed = lambda: code.closed("when", name)  # noqa: E731
                when = code.program(("when", name), closed).bind(self.values)
        made = here, lie.bind(numbers), affine, uses, trace, kinks, bounds
        return Guard(name, kind, edge.to, edge.crossing, *made, when=when, urgent=urgent)

    def _clock(self, edge: Transition, mode: str, held: tuple[str, ...]) -> Guard:
        """The edge as a clock, with its guard unwatched."""
        guard, key = self._guard(edge, Kind.CLOCK, mode, held), ("clock", edge.name)
        after = self.code.program(key, lambda: self.code.closed(*key)).bind(self.values)
        return attrs.evolve(guard, kinks=(), bounds=False, after=after)

    def rounding(self, guard: Guard, field: Field) -> Scalar:
        """Sizes whose rounding the guard and its first two Lie derivatives carry."""
        graph, held = self.code.mode(field.mode), bool(field.held)
        program = graph.program(("sizes", guard.edge, held), lambda: graph.sizes(guard.edge, held))
        return self.bind(program, self.numbers(field.mode, field.held))

    def bind(self, program: Program, numbers: tuple[float, ...] | None = None) -> Scalar:
        """A program of the class as a function for the current parameter values, cached.

        ``numbers`` are the values followed by a mode's mask.
        """
        given = self.values if numbers is None else numbers
        key = program, given[len(self.values) :]
        if key not in self._bound:
            self._bound[key] = program.bind(given)
        return self._bound[key]

    def reset(self, edge: str) -> Scalar:
        """The reset of an edge (not of a contact)."""
        closed = lambda: self.code.closed("reset", edge)  # noqa: E731
        return self.bind(self.code.program(("reset", edge), closed))

    def is_contact(self, edge: str) -> bool:
        """Whether this is the name of a contact."""
        return edge in self.contacts

    @cached_property
    def contacts(self) -> frozenset[str]:
        """Names of the contacts."""
        return frozenset(self.spec.contacts)

    @cached_property
    def conditional(self) -> frozenset[str]:
        """Names of the edges with a condition."""
        edges = (e for e in self.spec.transitions if isinstance(e, EdgeSpec))
        return frozenset(e.name for e in edges if e.when is not None)

    @cached_property
    def paired(self) -> list[tuple[int, int]]:
        """(position, velocity) index pairs of all contacts."""
        contacts = [name for name, guard in self.guards.items() if guard.kind is Kind.CONTACT]
        pairings = [self.code.pairing(name) for name in contacts]
        return [pair for p in pairings for pair in zip(p.positions, p.velocities, strict=True)]

    @cached_property
    def guards(self) -> dict[str, Guard]:
        """The guards of all modes by edge name, without window ends."""
        watched = (guard for mode in self.spec.modes for guard in self.field(mode.name).guards)
        return {guard.edge: guard for guard in watched if guard.kind is not Kind.WINDOW}

    def contact(self, name: str) -> Contact:
        """The derived laws of a contact."""
        if name not in self._contacts:
            code, spec = self.code, self.code.contact_spec(name)
            graph = code.mode(spec.source)
            numbers = self.numbers(spec.source, ())
            laws = {
                make.__name__: graph.program((make.__name__, name), partial(make, name)).bind(
                    numbers
                )
                for make in (graph.impact, graph.land, graph.push)
            }
            law = code.program(("law", name), lambda: code.closed("restitution", name), ["u"])
            self._contacts[name] = Contact(
                name,
                spec.source,
                spec.rests,
                law=law.bind(self.values),
                local=code.local(name),
                scene=self,
                **laws,
            )
        return self._contacts[name]


def _arrays(shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]) -> tuple[Any, ...]:
    """Flattened parameters in their original shapes."""
    ends = np.cumsum([*map(math.prod, shapes)])
    parts = np.split(np.array(values), ends[:-1]) if shapes else []
    return tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))


@lru_cache(maxsize=64)
def _scene(
    cls: Any,
    shapes: tuple[tuple[int, ...], ...],
    values: tuple[float, ...],
    samples: tuple[Samples, ...],
) -> Scene:
    windows = blank(cls.spec.lags, cls.spec.dimension) if cls.spec.lags else []
    shown = flat([*no_signal(cls.spec.signals), *windows])
    return Scene(cls, shapes, (*values, *shown), samples)


def scene_of(model: Any, by: str = "") -> Scene:
    """The scene of a model; models with equal parameters and signals share one.

    Raises
    ------
    OptionError
        If it has signals, and is asked for ``by`` what cannot have any.
    ParameterError
        If a parameter is of another shape than its default, with which the class was traced.
    """
    _require_no_signal(model.spec, by)
    parameters = model.parameters
    shapes = tuple(v.shape for v in parameters)
    for spec, shape in zip(model.spec.parameters, shapes, strict=True):
        if shape != np.shape(spec.default):
            raise ParameterError(
                f"{model.spec.model}.{spec.name} has shape {shape}; {np.shape(spec.default)} is "
                "due, that of its default; for many values use hy.ensemble or hy.sweep"
            )
    return scene_with(type(model), shapes, tuple(flat(parameters)), model.samples)


def _require_no_signal(spec: Spec, by: str) -> None:
    """Refuse a model with signals if the caller named in ``by`` does not support them."""
    if spec.signals and by:
        raise OptionError(
            f"{spec.model}: {by} takes no model with signals yet ({spec.signals[0].name}); "
            "hy.simulate does; for this, write it as a function of t"
        )


def scene_with(
    cls: Any,
    shapes: tuple[tuple[int, ...], ...],
    values: tuple[float, ...],
    samples: tuple[Samples, ...] = (),
) -> Scene:
    """The scene of a class, given flattened parameters and signal data."""
    return _scene(cls, shapes, tuple(values), samples)


def rest_name(mode: str, held: tuple[str, ...]) -> str:
    """The resting mode of held contacts: ``"<mode>.rest(<contact>, ...)"``."""
    return f"{mode}.rest({', '.join(held)})" if held else mode


def parted(name: str) -> tuple[str, tuple[str, ...]]:
    """The mode and the held contacts in the name of an arc mode."""
    mode, _, rest = name.partition(".rest(")
    return mode, tuple(rest.removesuffix(")").split(", ")) if rest else ()


def _unwritten(name: str, source: str, to: str) -> EdgeSpec:
    """An edge that no author declares: the end of a rest or of a window."""

    def unused(*_: Any) -> None:
        raise TraceError(f"{name} has no function of its own")

    return EdgeSpec(name, source, to, unused, Crossing.FALLING, unused)


def _kind(edge: Transition) -> Kind:
    """The kind of a transition's guard."""
    kinds = {ContactSpec: Kind.CONTACT, SideSpec: Kind.SWITCH, LeaveSpec: Kind.LEAVE}
    return kinds.get(type(edge), Kind.EDGE)


def released(edge: str) -> str:
    """The contact whose rest a release ends."""
    return edge.removesuffix(".release")


__all__ = [
    "Contact",
    "Field",
    "Guard",
    "Kink",
    "Scene",
    "parted",
    "released",
    "rest_name",
    "scene_of",
    "scene_with",
]
