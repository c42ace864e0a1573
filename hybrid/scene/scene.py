"""A model made ready to run: scalar functions of its modes, guards and contacts.

What depends on the class alone (graphs, generated code) is made once for a class and kept;
what depends on the values of the parameters is bound once for a run, in microseconds.
Nothing is made for a mode that a run does not enter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.past import blank
from ..automaton.spec import (
    ContactSpec,
    EdgeSpec,
    LeaveSpec,
    SideSpec,
    Spec,
    SwitchingSpec,
    Transition,
)
from ..errors import TraceError
from .lowered import Lowered, deciders, guard_shape, lowered
from .python import Program
from .taylor import Watched, flat

Scalar = Callable[..., Any]


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
    kind : "edge", "contact", "release", "switch", "leave" or "window"
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
    closed
        The guard's jaxpr.
    kinks : tuple of Kink
        Where it changes its formula; of a load also where its contact's gap and gap speed do.
    bounds : bool
        Whether it bounds its mode; an event that the flow passes does not.
    """

    edge: str
    kind: str
    to: str
    crossing: Crossing
    value: Scalar
    lie: Scalar
    affine: bool
    uses: tuple[int, ...]
    closed: Any
    kinks: tuple[Kink, ...] = ()
    bounds: bool = True

    @property
    def jumps(self) -> bool:
        """Whether it may change its sign without a zero."""
        return any(kink.change != "bends" for kink in self.kinks)


@attrs.frozen(eq=False)
class Field:
    """What a solver flows in one mode (or resting mode), and what is watched there.

    Attributes
    ----------
    rhs : callable ``(t, x) -> tuple``
        Time derivatives.
    jets : callable ``(t, x, sides)`` or None
        Taylor coefficients of the states, of the guards in order, and of the kinks; None
        where the model uses something that has no Taylor series.
    kinks : int
        Number of kinks, and of what else is watched along a series (see :mod:`.taylor`).
    watched : tuple of Watched
        What they are.
    deciding : callable ``(t, x) -> tuple``, or None
        Their values; None where there are none.
    held : tuple of str
        Contacts held closed here.
    closed, code, parameters
        The flow's jaxpr, what else is generated for the class, and the parameters' values.
    project : callable ``(t, x)`` or None
        Back onto the held contacts' gaps, or onto the surface on which the state slides.
    changes : tuple of Kink
        Where the flow changes its formula.
    """

    name: str
    mode: str
    held: tuple[str, ...]
    rhs: Scalar
    jets: Scalar | None
    kinks: int
    watched: tuple[Watched, ...]
    deciding: Scalar | None
    guards: tuple[Guard, ...]
    closed: Any
    code: Lowered
    parameters: tuple[Any, ...]
    project: Scalar | None = None
    changes: tuple[Kink, ...] = ()

    def column(self, edge: str) -> int:
        """Place of an edge's guard among the guards."""
        return next(i for i, guard in enumerate(self.guards) if guard.edge == edge)

    def expand(self, t: float, x: list[float], sides: list[int]) -> Any:
        """``jets``, on the branch that the flow takes where a kink is zero here.

        ``sides`` is completed in place: the sign each such kink is about to have.
        """
        assert self.jets is not None
        result = self.jets(t, x, sides)
        for _ in range(self.kinks):
            undecided = False
            for index, c in enumerate(result[2]):
                if c[0] == 0.0 and not sides[index] and any(c) and self.watched[index].switches:
                    sides[index] = next(1 if v > 0 else -1 for v in c if v)
                    undecided = True
            if not undecided:
                break
            result = self.jets(t, x, sides)
        return result


@attrs.frozen(eq=False)
class Contact:
    """The derived laws of a contact (see :mod:`.contact`), as scalar functions.

    ``local``: a fixed obstacle before one position, whose forces depend on that position
    and its velocity only; all flights see the same forces, whenever they are.
    """

    name: str
    mode: str
    rests: bool
    impact: Scalar
    land: Scalar
    push: Scalar
    law: Scalar
    local: bool


class Scene:
    """A model with its parameters' values, ready for a driver.

    Fields and contacts are made when first asked for, and kept.
    """

    def __init__(
        self, cls: Any, shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]
    ) -> None:
        self.spec: Spec = cls.spec
        self.code = lowered(cls, shapes)
        self._made, self._values = (cls, shapes), values
        self._bound: dict[Any, Scalar] = {}
        self._fields: dict[str, Field] = {}
        self._contacts: dict[str, Contact] = {}

    @cached_property
    def parameters(self) -> tuple[Any, ...]:
        """Values of the parameters, then the windows of the past, as arrays."""
        return _arrays(self.code.shapes, self._values)

    def through(self, windows: Sequence[np.ndarray]) -> Scene:
        """The same model on other windows of the past."""
        shown = tuple(flat(windows))
        return Scene(*self._made, (*self._values[: len(self._values) - len(shown)], *shown))

    @cached_property
    def modes(self) -> tuple[str, ...]:
        """Modes in which a run may start: those declared, each contact's rest, each sliding."""
        rests = [
            rest_name(e.source, (e.name,))
            for e in self.spec.transitions
            if isinstance(e, ContactSpec) and e.rests
        ]
        slides = [switching.mode for switching in self.spec.switchings if switching.slides]
        return (*(mode.name for mode in self.spec.modes), *rests, *slides)

    def starts(self, name: str) -> bool:
        """Whether a run may start in an arc mode: one of ``modes``, or several contacts' rest."""
        mode, held = parted(name)
        return all(each in self.modes for each in (mode, *(rest_name(mode, (c,)) for c in held)))

    def name(self, mode: str, held: Iterable[str]) -> str:
        """The arc mode of a mode with contacts held, these in declared order."""
        order = [edge.name for edge in self.spec.leaving(mode) if edge.name in set(held)]
        return rest_name(mode, tuple(order))

    def field(self, name: str) -> Field:
        """The field of a mode, or of a resting mode ``"mode.rest(contact, ...)"``."""
        if name not in self._fields:
            self._fields[name] = self._make_field(name, *parted(name))
        return self._fields[name]

    def _make_field(self, name: str, mode: str, held: tuple[str, ...]) -> Field:
        code, switching = self.code, self.spec.sliding(mode)
        flow = code.field_closed(mode, held)
        edges = [edge for edge in self.spec.leaving(mode) if edge.name not in held]
        watched = [(edge, _kind(edge), code.guard_closed(edge)) for edge in edges]
        for index, contact in enumerate(held):
            load = code.load_closed(held, index)
            watched.append((_unwritten(f"{contact}.release", name, mode), "release", load))
        for number in [k for k, moves in enumerate(code.moving) if moves]:
            for side in ("a", "b"):
                closed = code.window_closed(number, side)
                watched.append(
                    (_unwritten(window_edge(number, side), mode, mode), "window", closed)
                )
        guards = [self._guard(*each, flow, name) for each in watched]
        closed = [guard.closed for guard in guards]
        derived = bool(held) or switching is not None
        program = code.program(("field", name), lambda: flow, exact=not derived)
        rhs = program.bind(self._values)
        taylor = code.taylor(name, flow, closed)
        jets = taylor.bind(self._values) if taylor else None
        ends = taylor.watched if taylor else ()
        deciding = taylor.deciding.bind(self._values) if taylor and ends else None
        project = self._projection(switching, held) if derived else None
        kinks = len(ends), ends, deciding
        made = (flow, code, self.parameters)
        changes = self._kinks(("flow", name), [flow])
        own = name, mode, held, rhs, jets
        return Field(*own, *kinks, tuple(guards), *made, project=project, changes=changes)

    @cached_property
    def guards_jump(self) -> bool:
        """Whether a guard that an author wrote may change its sign without a zero."""
        return any(
            guard.jumps for mode in self.spec.modes for guard in self.field(mode.name).guards
        )

    def _projection(self, switching: SwitchingSpec | None, held: tuple[str, ...]) -> Scalar:
        code = self.code
        program = code.project(held) if switching is None else code.onto(switching.name)
        return program.bind(self._values)

    def _guard(self, edge: Transition, kind: str, closed: Any, flow: Any, where: str) -> Guard:
        code, key = self.code, (edge.name, where)
        lie = code.lie_program(key, closed, flow)
        value = code.program(("guard", key), lambda: closed)
        affine, uses = code.once(("shape", key), lambda: guard_shape(code, closed))
        bound = value.bind(self._values), lie.bind(self._values)
        kinks = self._kinks(key, [closed, *self._moving_gap(edge.name, kind)])
        named = edge.name, kind, edge.to, edge.crossing
        bounds = kind != "edge" or code.bounds(edge)
        return Guard(*named, *bound, affine, uses, closed, kinks, bounds)

    def _moving_gap(self, edge: str, kind: str) -> list[Any]:
        """Gap, gap speed and free acceleration of a held contact, which end its rest too."""
        if kind != "release":
            return []
        name = released(edge)
        mode = self.code.contact_spec(name).source
        gap, flow = self.code.closed("gap", name), self.code.closed("flow", mode)
        return [self.code.lie_closed((name, mode), gap, flow)]

    def _kinks(self, key: Any, closeds: list[Any]) -> tuple[Kink, ...]:
        found = self.code.once(("kinks", key), lambda: deciders(self.code, closeds))
        return tuple(
            Kink((*key, number), self.bind(program), *shape)
            for number, (program, *shape) in enumerate(found)
        )

    def rounding(self, guard: Guard, field: Field) -> Scalar:
        """Sizes whose rounding the guard and its first two derivatives carry."""
        code = self.code
        flow = code.field_closed(field.mode, field.held)
        return self.bind(code.rounding_program((guard.edge, field.name), guard.closed, flow))

    def bind(self, program: Program) -> Scalar:
        """A program of the class's code as a function, for these values of the parameters."""
        if program not in self._bound:
            self._bound[program] = program.bind(self._values)
        return self._bound[program]

    def reset(self, edge: str) -> Scalar:
        """The reset of an edge (not of a contact)."""
        program = self.code.program(("reset", edge), lambda: self.code.closed("reset", edge))
        return self.bind(program)

    def is_contact(self, edge: str) -> bool:
        """Whether an edge's name is that of a contact."""
        return any(isinstance(e, ContactSpec) and e.name == edge for e in self.spec.transitions)

    def pairs(self, contact: str) -> list[tuple[int, int]]:
        """Places of a contact's positions and of their velocities."""
        pairing = self.code.pairing(contact)
        return list(zip(pairing.positions, pairing.velocities, strict=True))

    def contact(self, name: str) -> Contact:
        """The derived laws of a contact."""
        if name not in self._contacts:
            code, spec = self.code, self.code.contact_spec(name)
            laws = {
                what: code.law_program(name, what).bind(self._values)
                for what in ("impact", "land", "push")
            }
            law = code.program(("law", name), lambda: code.closed("restitution", name), ["u"])
            self._contacts[name] = Contact(
                name,
                spec.source,
                spec.rests,
                law=law.bind(self._values),
                local=code.local(name),
                **laws,
            )
        return self._contacts[name]


def _arrays(shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]) -> tuple[Any, ...]:
    """Flattened parameters in their shapes again."""
    ends = np.cumsum([int(np.prod(shape, dtype=int)) for shape in shapes])
    parts = np.split(np.array(values), ends[:-1]) if shapes else []
    return tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))


@lru_cache(maxsize=64)
def _scene(cls: Any, shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]) -> Scene:
    return Scene(cls, shapes, values)


def scene_of(model: Any) -> Scene:
    """The scene of a model; models of equal parameters share one."""
    cls: Any = type(model)
    windows = blank(cls.spec.lags, cls.spec.dimension)
    shapes = tuple(tuple(v.shape) for v in model.parameters)
    return _scene(cls, shapes, tuple(flat([*model.parameters, *windows])))


def rest_name(mode: str, held: tuple[str, ...]) -> str:
    """The arc mode of contacts at rest: ``"<mode>.rest(<contact>, ...)"``."""
    return f"{mode}.rest({', '.join(held)})" if held else mode


def parted(name: str) -> tuple[str, tuple[str, ...]]:
    """The mode of an arc mode, and the contacts held."""
    mode, _, rest = name.partition(".rest(")
    return mode, tuple(rest.removesuffix(")").split(", ")) if rest else ()


def window_edge(number: int, side: str) -> str:
    """Name of the guard by which a lag that moves comes to an end, a or b, of its window."""
    return f"past({number}).{side}"


def _unwritten(name: str, source: str, to: str) -> EdgeSpec:
    """An edge that no author has written: the end of a rest, or of a window."""

    def unused(*_: Any) -> None:
        raise TraceError(f"{name} has no function of its own")

    return EdgeSpec(name, source, to, unused, Crossing.FALLING, unused)


def _kind(edge: Transition) -> str:
    """The kind of a transition's guard."""
    kinds = {ContactSpec: "contact", SideSpec: "switch", LeaveSpec: "leave"}
    return kinds.get(type(edge), "edge")


def released(edge: str) -> str:
    """The contact that a release ends."""
    return edge.removesuffix(".release")
