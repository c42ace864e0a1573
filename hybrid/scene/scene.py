"""A model made ready to run: scalar functions of its modes, guards and contacts.

What depends on the class alone (graphs, generated code) is made once for a class and kept;
what depends on the values of the parameters is bound once for a run, in microseconds.
Nothing is made for a mode that a run does not enter.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any

import attrs
import numpy as np

from ..automaton import trace
from ..automaton.markers import Crossing
from ..automaton.spec import ContactSpec, EdgeSpec, Spec
from ..errors import TraceError
from . import contact as contacts
from .graph import Graph
from .python import Program, needed
from .taylor import TaylorProgram, flat

#: Order of the Taylor series of flows and gaps.
ORDER = 16

#: Stands for the time among places in the state vector.
TIME = -1

Scalar = Callable[..., Any]


@attrs.frozen(eq=False)
class Guard:
    """A guard watched in a field.

    Attributes
    ----------
    edge : str
        Name of the edge or contact; ``"<contact>.release"`` for the end of a rest.
    kind : "edge", "contact" or "release"
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
    """

    edge: str
    kind: str
    to: str
    crossing: Crossing
    value: Scalar
    lie: Scalar
    affine: bool
    uses: tuple[int, ...]


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
        Number of kinks (see :mod:`.taylor`).
    held : tuple of str
        Contacts held closed here.
    project : callable ``(t, x)`` or None
        Back onto the held contacts' gaps.
    """

    name: str
    mode: str
    held: tuple[str, ...]
    rhs: Scalar
    jets: Scalar | None
    kinks: int
    guards: tuple[Guard, ...]
    project: Scalar | None = None

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
                if c[0] == 0.0 and not sides[index]:
                    sides[index] = next((1 if v > 0 else -1 for v in c[1:] if v), 1)
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


class Lowered:
    """Generated code of one class, for one set of parameter shapes."""

    def __init__(self, cls: Any, shapes: tuple[tuple[int, ...], ...]) -> None:
        self.cls, self.spec, self.shapes = cls, cls.spec, shapes
        self._programs: dict[Any, Any] = {}

    def _trace(self, call: Any, extra: int = 0) -> Any:
        return trace.trace(self.spec, call, extra, self.shapes)

    def closed(self, kind: str, name: str) -> Any:
        """The class's own trace, or one for these shapes where they are not the defaults'."""
        closed = self.cls.traces[kind, name]
        given = tuple(tuple(v.aval.shape) for v in closed.jaxpr.invars[: len(self.shapes)])
        if given == self.shapes:
            return closed
        raise TraceError(
            f"{self.spec.model}: parameters of shapes {self.shapes} where the defaults "
            f"have {given}; give arrays of the defaults' shapes"
        )

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What ``make`` returns, made only the first time."""
        if key not in self._programs:
            self._programs[key] = make()
        return self._programs[key]

    # -- graphs -------------------------------------------------------------------------

    def inputs(self, graph: Graph, extra: Sequence[str] = ()) -> list[np.ndarray]:
        """Node numbers of parameters, ``t``, ``x`` and the extra inputs."""
        count, arrays = 0, []
        for shape in self.shapes:
            size = int(np.prod(shape, dtype=int))
            ids = [graph.input(f"p{count + i}") for i in range(size)]
            arrays.append(np.array(ids, dtype=np.int64).reshape(shape))
            count += size
        arrays.append(np.array(graph.input("t")))
        states = [graph.input(f"x{i}") for i in range(self.spec.dimension)]
        return [
            *arrays,
            np.array(states, dtype=np.int64),
            *(np.array(graph.input(e)) for e in extra),
        ]

    def program(self, key: Any, closed: Callable[[], Any], extra: Sequence[str] = ()) -> Program:
        """Scalar code of a closed jaxpr."""

        def make() -> Program:
            graph = Graph()
            (outputs,) = graph.outputs(closed(), self.inputs(graph, extra))
            return Program(graph, ["t", "x", *extra], self.spec.dimension, outputs)

        return self.once(key, make)

    def dependencies(self, closed: Any, extra: Sequence[str] = ()) -> list[set[int]]:
        """For each element of a result, the elements of ``x`` it depends on; -1 is time."""
        graph = Graph()
        (outputs,) = graph.outputs(closed, self.inputs(graph, extra))
        return [_states_in(graph, int(i)) for i in outputs.reshape(-1)]

    def local(self, name: str) -> bool:
        """See :class:`Contact`."""
        contact, pairing = self.contact_spec(name), self.pairing(name)
        own = {*pairing.positions, *pairing.velocities}
        flows = self.dependencies(self.closed("flow", contact.source))
        (gap,) = self.dependencies(self.closed("gap", name))
        (law,) = self.dependencies(self.closed("restitution", name), ["u"])
        used = set().union(gap, law, *(flows[i] for i in own))
        return len(own) == 2 and used <= own and not callable(contact.inverse_mass)

    # -- modes --------------------------------------------------------------------------

    def flow(self, mode: str) -> Program:
        return self.program(("flow", mode), lambda: self.closed("flow", mode))

    def held(self, names: tuple[str, ...]) -> contacts.Held:
        """The laws of contacts held at once."""
        flow = trace.again(self.closed("flow", self.contact_spec(names[0]).source))
        return contacts.Held(tuple(self.laws(name) for name in names), flow)

    def rest_closed(self, names: tuple[str, ...]) -> Any:
        """The jaxpr of the flow while contacts are held."""
        return self.once(("rest closed", names), lambda: self._trace(self.held(names).rest))

    def load_closed(self, names: tuple[str, ...], index: int) -> Any:
        """The jaxpr of the load of one of the contacts held."""
        key = ("load closed", names, index)
        return self.once(key, lambda: self._trace(self.held(names).load(index)))

    def project(self, names: tuple[str, ...]) -> Program:
        """Projection onto the gaps of the contacts held."""
        closed = lambda: self._trace(self.held(names).project)  # noqa: E731
        return self.program(("project", names), closed)

    def field_closed(self, mode: str, held: tuple[str, ...]) -> Any:
        """The jaxpr of the flow of a mode, or of it with contacts held."""
        return self.rest_closed(held) if held else self.closed("flow", mode)

    def taylor(self, key: Any, flow: Any, functions: Sequence[Any]) -> TaylorProgram | None:
        """Taylor code of a flow and of functions along it; None where there is none."""

        def make() -> TaylorProgram | None:
            graph = Graph()
            inputs = self.inputs(graph)
            (states,) = graph.outputs(flow, inputs)
            values = [int(graph.outputs(f, inputs)[0].reshape(())) for f in functions]
            try:
                return TaylorProgram(graph, self.spec.dimension, states, values, ORDER)
            except TraceError:
                return None

        return self.once(("taylor", key), make)

    # -- guards and contacts ------------------------------------------------------------

    def guard_closed(self, edge: EdgeSpec | ContactSpec) -> Any:
        return self.closed("gap" if isinstance(edge, ContactSpec) else "guard", edge.name)

    def lie_program(self, key: Any, guard: Any, flow: Any) -> Program:
        """The guard and its first two derivatives along the flow."""

        def triple(parameters: Any, t: Any, x: Any) -> Any:
            import jax.numpy as jnp

            g, f = trace.again(guard), trace.again(flow)
            first = contacts.lie(g, f)
            parts = [h(parameters, t, x) for h in (g, first, contacts.lie(first, f))]
            return jnp.stack(parts)

        return self.program(("lie", key), lambda: self._trace(triple))

    def rounding_program(self, key: Any, guard: Any, flow: Any) -> Program:
        """Sums of the absolute terms of which the guard and its derivatives are made."""

        def sizes(parameters: Any, t: Any, x: Any) -> Any:
            import jax
            import jax.numpy as jnp

            g, f = trace.again(guard), trace.again(flow)
            first = contacts.lie(g, f)

            def terms(h: Any, rates: Any) -> Any:
                by_t, by_x = jax.grad(h, argnums=(1, 2))(parameters, t, x)
                return jnp.abs(by_t) * rates[0] + jnp.abs(by_x) @ rates[1]

            moving = (1.0, jnp.abs(f(parameters, t, x)))
            here = (jnp.abs(t), jnp.abs(x))
            offset = jnp.abs(g(parameters, t, jnp.zeros_like(x)))
            size = terms(g, here) + jnp.where(jnp.isfinite(offset), offset, 0.0)
            return jnp.stack([size, terms(g, moving), terms(first, moving)])

        return self.program(("rounding", key), lambda: self._trace(sizes))

    def pairing(self, name: str) -> contacts.Pairing:
        """Positions of a contact's gap and their velocities."""

        def make() -> contacts.Pairing:
            contact = self.contact_spec(name)
            flow = self.closed("flow", contact.source)
            (gap,) = self.dependencies(self.closed("gap", name))
            gap, flows = gap - {TIME}, [d - {TIME} for d in self.dependencies(flow)]
            return contacts.pair(self.spec, contact, gap, flows, self._unit(contact.source))

        return self.once(("pairing", name), make)

    def _unit(self, mode: str) -> Callable[[int, int], bool]:
        """Whether a component of the flow has slope one in an element, at random points."""
        rhs = self.flow(mode).bind(flat([p.default for p in self.spec.parameters]))
        draw = random.Random(0)

        def unit(i: int, j: int) -> bool:
            for _ in range(3):
                x = [draw.uniform(0.5, 1.5) for _ in range(self.spec.dimension)]
                moved = [v + (k == j) for k, v in enumerate(x)]
                if not abs(rhs(0.3, moved)[i] - rhs(0.3, x)[i] - 1.0) < 1e-9:
                    return False
            return True

        return unit

    def contact_spec(self, name: str) -> ContactSpec:
        return next(e for e in self.spec.transitions if e.name == name)

    def laws(self, name: str) -> contacts.ContactLaws:
        def make() -> contacts.ContactLaws:
            return contacts.laws(self.cls, self.spec, self.contact_spec(name), self.pairing(name))

        return self.once(("laws", name), make)

    def law_program(self, name: str, what: str) -> Program:
        def closed() -> Any:
            return self._trace(getattr(self.laws(name), what))

        return self.program((what, name), closed)


def _states_in(graph: Graph, root: int) -> set[int]:
    names = [n[1] for n in (graph.nodes[i] for i in needed(graph, [root])) if n[0] == "input"]
    places = {int(name[1:]) for name in names if name.startswith("x")}
    return places | ({TIME} if "t" in names else set())


def _degree(graph: Graph, root: int) -> float:
    """Degree of a polynomial in ``t`` and ``x``; infinite where it is none."""
    degree: dict[int, float] = {}
    for number in needed(graph, [root]):
        node = graph.nodes[number]
        below = [degree[a] for a in node[1:]] if node[0] not in ("const", "input") else []
        if node[0] == "const" or (node[0] == "input" and node[1][0] == "p"):
            degree[number] = 0
        elif node[0] == "input":
            degree[number] = 1
        elif node[0] in ("add", "sub", "neg", "real"):
            degree[number] = max(below)
        elif node[0] == "mul":
            degree[number] = sum(below)
        elif node[0] == "div" and below[1] == 0:
            degree[number] = below[0]
        else:
            degree[number] = 0 if max(below) == 0 else float("inf")
    return degree[root]


def lowered(cls: Any, shapes: tuple[tuple[int, ...], ...]) -> Lowered:
    """The generated code of a class, kept on the class."""
    store = cls.__dict__.get("_hybrid_lowered")
    if store is None:
        store = {}
        cls._hybrid_lowered = store
    if shapes not in store:
        store[shapes] = Lowered(cls, shapes)
    return store[shapes]


class Scene:
    """A model with its parameters' values, ready for a driver.

    Fields and contacts are made when first asked for, and kept.
    """

    def __init__(
        self, cls: Any, shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]
    ) -> None:
        self.spec: Spec = cls.spec
        self.code = lowered(cls, shapes)
        self._values = values
        self._bound: dict[Any, Scalar] = {}
        self._fields: dict[str, Field] = {}
        self._contacts: dict[str, Contact] = {}

    @cached_property
    def modes(self) -> tuple[str, ...]:
        """Modes in which a run may start: those declared, and each contact's rest."""
        rests = [
            rest_name(e.source, (e.name,))
            for e in self.spec.transitions
            if isinstance(e, ContactSpec) and e.rests
        ]
        return (*(mode.name for mode in self.spec.modes), *rests)

    def name(self, mode: str, held: Iterable[str]) -> str:
        """The arc mode of a mode with contacts held, these in declared order."""
        order = [edge.name for edge in self.spec.leaving(mode) if edge.name in set(held)]
        return rest_name(mode, tuple(order))

    def field(self, name: str) -> Field:
        """The field of a mode, or of a resting mode ``"mode.rest(contact, ...)"``."""
        if name not in self._fields:
            mode, _, rest = name.partition(".rest(")
            held = tuple(rest.removesuffix(")").split(", ")) if rest else ()
            self._fields[name] = self._make_field(name, mode, held)
        return self._fields[name]

    def _make_field(self, name: str, mode: str, held: tuple[str, ...]) -> Field:
        code = self.code
        flow = code.field_closed(mode, held)
        edges: list[Any] = [edge for edge in self.spec.leaving(mode) if edge.name not in held]
        closed = [code.guard_closed(edge) for edge in edges]
        for index, contact in enumerate(held):
            closed.append(code.load_closed(held, index))
            edges.append(_release(contact, name, mode))
        guards = [self._guard(e, g, flow, name) for e, g in zip(edges, closed, strict=True)]
        rhs = code.program(("field", name), lambda: flow).bind(self._values)
        taylor = code.taylor(name, flow, closed)
        jets = taylor.bind(self._values) if taylor else None
        kinks = taylor.kinks if taylor else 0
        project = code.project(held).bind(self._values) if held else None
        return Field(name, mode, held, rhs, jets, kinks, tuple(guards), project)

    def _guard(self, edge: Any, closed: Any, flow: Any, where: str) -> Guard:
        code, key = self.code, (edge.name, where)
        kind = "contact" if isinstance(edge, ContactSpec) else "edge"
        kind = "release" if edge.name.endswith(".release") else kind
        lie = code.lie_program(key, closed, flow)
        value = code.program(("guard", key), lambda: closed)
        affine, uses = code.once(("shape", key), lambda: _shape(code, closed))
        bound = value.bind(self._values), lie.bind(self._values)
        return Guard(edge.name, kind, edge.to, edge.crossing, *bound, affine, uses)

    def rounding(self, guard: Guard, field: Field) -> Scalar:
        """Sizes whose rounding the guard and its first two derivatives carry."""
        code = self.code
        flow = code.field_closed(field.mode, field.held)
        if guard.kind == "release":
            closed = code.load_closed(field.held, field.held.index(released(guard.edge)))
        else:
            edge = next(e for e in self.spec.transitions if e.name == guard.edge)
            closed = code.guard_closed(edge)
        return self._bind(code.rounding_program((guard.edge, field.name), closed, flow))

    def _bind(self, program: Program) -> Scalar:
        if program not in self._bound:
            self._bound[program] = program.bind(self._values)
        return self._bound[program]

    def reset(self, edge: str) -> Scalar:
        """The reset of an edge (not of a contact)."""
        program = self.code.program(("reset", edge), lambda: self.code.closed("reset", edge))
        return self._bind(program)

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


@lru_cache(maxsize=64)
def _scene(cls: Any, shapes: tuple[tuple[int, ...], ...], values: tuple[float, ...]) -> Scene:
    return Scene(cls, shapes, values)


def scene_of(model: Any) -> Scene:
    """The scene of a model; models of equal parameters share one."""
    values = model.parameters
    cls: Any = type(model)
    return _scene(cls, tuple(tuple(v.shape) for v in values), tuple(flat(values)))


def rest_name(mode: str, held: tuple[str, ...]) -> str:
    """The arc mode of contacts at rest: ``"<mode>.rest(<contact>, ...)"``."""
    return f"{mode}.rest({', '.join(held)})" if held else mode


def _release(contact: str, source: str, mode: str) -> EdgeSpec:
    """The edge that ends the rest of a contact (its guard is the load)."""

    def unused(*_: Any) -> None:
        raise TraceError("a release has its load as guard")

    return EdgeSpec(f"{contact}.release", source, mode, unused, Crossing.FALLING, unused)


def released(edge: str) -> str:
    """The contact that a release ends."""
    return edge.removesuffix(".release")


def _shape(code: Lowered, closed: Any) -> tuple[bool, tuple[int, ...]]:
    graph = Graph()
    (output,) = graph.outputs(closed, code.inputs(graph))
    root = int(output.reshape(()))
    return _degree(graph, root) <= 1, tuple(sorted(_states_in(graph, root) - {TIME}))


__all__ = ["Contact", "ContactSpec", "Field", "Guard", "Scene", "Spec", "rest_name"]
