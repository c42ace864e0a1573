"""The generated code of one class, shared by all runs and parameter values."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from math import isfinite, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton import trace
from ..automaton.markers import Crossing
from ..automaton.past import blank
from ..automaton.signals import blank as no_signal
from ..automaton.spec import ContactSpec, EdgeSpec, LeaveSpec, SideSpec, Spec, Transition
from ..errors import TraceError
from ..rules.places import WINDOW_DEGREE
from ..rules.zeros import EPS
from . import contact as contacts
from .graph import TIME_PLACE, Graph, inputs_of, states_in
from .jaxpr import read
from .mode import ModeGraph
from .python import Program
from .sliding import Sliding
from .tape import Tape
from .taylor import flat

if TYPE_CHECKING:
    from ..automaton.shapes import Mask
    from .local import LocalGraph

#: Order of the Taylor series of flows and gaps.
ORDER = 16

#: Number of random points at which to check whether a reset reverses a guard's motion. A reversal
#: on half of all points is missed once in a million.
RESET_SAMPLES = 20

#: Number of random points, of parameters, time and state, at which a contact's velocity is checked
#: to be the derivative of its position. A factor that depends on them shows at the second; one that
#: holds in half of all states is missed once in 128. The first has positive states, and the default
#: parameters: there the flow must have a value.
VELOCITY_SAMPLES = 8

#: How far from one a slope may be by rounding at these points, relative to the flow there.
VELOCITY_ROUNDING = 1e-9

#: Most secant steps to a zero of a guard, and the residual that counts as zero, relative to the
#: initial values: some thousand times the rounding of a reset's arithmetic.
SECANTS, AT_ZERO = 60, 1e-12

#: For each component of a flow: the elements, and the (lag, element) pairs, that it depends on.
Reach = list[tuple[set[int], set[tuple[int, int]]]]


class Lowered:
    """Generated code of one class, for one set of parameter shapes."""

    def __init__(self, cls: Any, shapes: tuple[tuple[int, ...], ...]) -> None:
        self.cls, self.spec, self.shapes = cls, cls.spec, (*shapes, *cls.spec.windows)
        self._own_shapes = self.shapes[: len(shapes) + len(cls.spec.signals)]
        self._programs: dict[Any, Any] = {}

    def trace(self, call: Any, extra: int = 0) -> Any:
        return trace.trace(self.spec, call, extra, self.shapes)

    def closed(self, kind: str, name: str) -> Any:
        """The class's own trace of a function."""
        return self.cls.traces[kind, name]

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """The result of ``make``, cached under ``key``."""
        if key not in self._programs:
            self._programs[key] = make()
        return self._programs[key]

    # -- graphs -------------------------------------------------------------------------

    def inputs(self, graph: Graph, extra: Sequence[str] = ()) -> list[np.ndarray]:
        """Node numbers of parameters, ``t``, ``x`` and the extra inputs."""
        places = range(self.spec.flows, self.spec.dimension)
        graph.still = frozenset(f"x{i}" for i in places)
        count, arrays = 0, []
        for shape in self.shapes:
            size = prod(shape)
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

    def program(
        self,
        key: Any,
        closed: Callable[[], Any],
        extra: Sequence[str] = (),
        exact: bool = False,
    ) -> Program:
        """Scalar code of a closed jaxpr; use ``exact`` for functions of the author."""

        def make() -> Program:
            graph = Graph(exact)
            try:
                (outputs,) = read(graph, closed(), self.inputs(graph, extra))
            except TraceError as fault:
                what = " ".join(map(str, key))
                raise TraceError(f"{self.spec.model}, {what}: {fault}") from None
            return Program(graph, ["t", "x", *extra], self.spec.dimension, outputs)

        return self.once(key, make)

    def dependencies(self, closed: Any, extra: Sequence[str] = ()) -> list[set[int]]:
        """The elements of ``x`` that each element of a result depends on; -1 stands for time."""
        graph = Graph()
        (outputs,) = read(graph, closed, self.inputs(graph, extra))
        return [states_in(graph, int(i)) for i in outputs.reshape(-1)]

    def local(self, name: str) -> bool:
        """See :class:`.field.Contact`."""
        return bool(self.once(("local", name), lambda: self._local(name)))

    def _local(self, name: str) -> bool:
        contact, pairing = self.contact_spec(name), self.pairing(name)
        own = {*pairing.positions, *pairing.velocities}
        flows = self.dependencies(self.closed("flow", contact.source))
        (gap,) = self.dependencies(self.closed("gap", name))
        (law,) = self.dependencies(self.closed("restitution", name), ["u"])
        used = set().union(gap, law, *flows)
        return len(own) == 2 and used <= own and not callable(contact.inverse_mass)

    # -- modes --------------------------------------------------------------------------

    def flow(self, mode: str) -> Program:
        return self.program(("flow", mode), lambda: self.closed("flow", mode), exact=True)

    def held(self, names: tuple[str, ...], mask: Any = None) -> contacts.Held:
        """The laws of contacts held at the same time, or of those that a mask selects."""
        flow = trace.again(self.closed("flow", self.contact_spec(names[0]).source))
        groups = self.mode(self.contact_spec(names[0]).source).groups(names)
        laws = tuple(self.laws(name) for name in names)
        places = tuple(tuple(map(names.index, group)) for group in groups)
        return contacts.Held(laws, flow, mask, places)

    def any_rest_closed(self, mode: str) -> Any:
        """The jaxpr of the resting field of any of a mode's contacts; the mask of those held
        follows the parameters."""
        names = tuple(self.mode(mode).resting)

        def rest(parameters: Any, t: Any, x: Any) -> Any:
            *own, mask = parameters
            return self.held(names, mask > 0.5).rest(own, t, x)

        shapes = *self.shapes, (len(names),)
        return self.once(("any rest", mode), lambda: trace.trace(self.spec, rest, 0, shapes))

    def rest_closed(self, names: tuple[str, ...]) -> Any:
        """The jaxpr of the resting field."""
        return self.once(("rest closed", names), lambda: self.trace(self.held(names).rest))

    def load_closed(self, names: tuple[str, ...], index: int) -> Any:
        """The jaxpr of the load of contact number ``index`` among those held."""
        groups = self.mode(self.contact_spec(names[0]).source).groups(names)
        own = next(tuple(group) for group in groups if names[index] in group)
        place = own.index(names[index])
        key = ("load closed", own, place)
        return self.once(key, lambda: self.trace(self.held(own).load(place)))

    def sliding(self, name: str) -> Sliding:
        """The laws of sliding on a switching's surface."""
        switching = self.spec.switching(name)
        modes = switching.positive, switching.negative
        flows = [trace.again(self.closed("flow", mode)) for mode in modes]
        return Sliding(trace.again(self.closed("surface", name)), *flows)

    def rate_closed(self, name: str, side: str) -> Any:
        """The jaxpr of the rate of a switching surface along one side's flow."""
        key = ("rate closed", name, side)
        return self.once(key, lambda: self.trace(self.sliding(name).rate(side)))

    def onto(self, name: str) -> Program:
        """Projection onto a switching surface."""
        return self.program(("onto", name), lambda: self.onto_closed(name))

    def onto_closed(self, name: str) -> Any:
        """The jaxpr of the projection onto a switching surface."""
        key = "onto closed", name
        return self.once(key, lambda: self.trace(self.sliding(name).project))

    def field_closed(self, mode: str, held: tuple[str, ...]) -> Any:
        """The jaxpr of a mode's flow, of its resting field, or of the sliding field."""
        switching = self.spec.sliding(mode)
        if switching is not None:
            key, name = ("slide closed", mode), switching.name
            return self.once(key, lambda: self.trace(self.sliding(name).field))
        return self.rest_closed(held) if held else self.closed("flow", mode)

    def mode(self, name: str) -> ModeGraph:
        """The graph of a mode or a sliding mode."""
        return self.once(("mode", name), lambda: ModeGraph(self, name))  # type: ignore[no-any-return]

    def near(self, name: str) -> LocalGraph:
        """The graph of a mode's local model (:mod:`.local`)."""
        from .local import LocalGraph

        return self.once(("near", name), lambda: LocalGraph(self, name))  # type: ignore[no-any-return]

    def tape(
        self, mode: str, held: bool, touching: frozenset[str] = frozenset()
    ) -> Tape | TraceError:
        """The tape of a mode (:meth:`.ModeGraph.tape`), or the error if there is none."""

        def make() -> Tape | TraceError:
            try:
                return self.mode(mode).tape(held, touching)
            except TraceError as fault:
                return fault

        return self.once(("tape", mode, held, touching), make)  # type: ignore[no-any-return]

    # -- the past -----------------------------------------------------------------------

    def lag(self, number: int) -> Program:
        """A lag as scalar code."""
        name = self.spec.lags[number].name
        return self.program(("lag", name), lambda: self.closed("lag", name))

    @cached_property
    def moving(self) -> tuple[bool, ...]:
        """For each lag, whether it depends on time or state."""
        return tuple(
            bool(self.dependencies(self.closed("lag", lag.name))[0]) for lag in self.spec.lags
        )

    def window_closed(self, number: int, side: str) -> Any:
        """The jaxpr of a window guard: the distance of ``t - lag`` from one end of its window."""

        def inside(parameters: Any, t: Any, x: Any) -> Any:
            lag = trace.again(self.closed("lag", self.spec.lags[number].name))
            frame = parameters[len(self._own_shapes) + 2 * number]
            place = (t - lag(parameters, t, x) - frame[0]) / frame[1]
            return 1.0 - place if side == "b" else 1.0 + place

        return self.once(("window", number, side), lambda: self.trace(inside))

    def asked(self, closed: Any, extra: Sequence[str] = ()) -> list[set[tuple[int, int]]]:
        """The (lag, element) pairs that each element of a result reads from the past.

        Exact dependence: a function that is called reads also what it multiplies by 0.
        """
        graph, first = Graph(exact=True), sum(map(prod, self._own_shapes))
        (outputs,) = read(graph, closed, self.inputs(graph, extra))
        return [self._past_in(graph, int(i), first) for i in outputs.reshape(-1)]

    def timed(self, closed: Any, extra: Sequence[str] = ()) -> bool:
        """Whether a function depends on time, directly or through signals; the past at constant
        lags does not count."""
        graph = Graph()
        inputs = self.inputs(graph, extra)
        rows = inputs[len(self._own_shapes) + 1 : len(self.shapes) : 2]
        for ids in rows if not any(self.moving) else ():
            ids[1:] = graph.const(0.0)  # a constant window
        (outputs,) = read(graph, closed, inputs)
        signals = inputs[len(self.spec.parameters) : len(self._own_shapes)]
        moves = {"t", *(graph.nodes[int(i)][1] for ids in signals for i in ids)}
        return not moves.isdisjoint(inputs_of(graph, outputs.reshape(-1).tolist()))

    def reach(self, mode: str, held: tuple[str, ...]) -> Reach:
        """What each component of a flow depends on: elements, and (lag, element) pairs."""
        return self.once(("reach", mode, held), lambda: self._reach(mode, held))

    def _reach(self, mode: str, held: tuple[str, ...]) -> Reach:
        flow = self.field_closed(mode, held)
        states = [uses - {TIME_PLACE} for uses in self.dependencies(flow)]
        pairs = list(zip(states, self.asked(flow), strict=True))
        return [self._felt(i, *pair, flow) for i, pair in enumerate(pairs)] if held else pairs

    def _felt(
        self, i: int, uses: set[int], asks: set[tuple[int, int]], flow: Any
    ) -> tuple[set[int], set[tuple[int, int]]]:
        """The true dependence of one component of a resting field, as in :meth:`reach`.

        Contact forces cancel some dependences, which neither trace nor graph shows. They are found
        by perturbing random points.
        """
        rhs = self.program(("felt", id(flow)), lambda: flow)
        first = self.spec.dimension + sum(map(prod, self._own_shapes))
        size = 2 + (WINDOW_DEGREE + 1) * self.spec.dimension
        draw = random.Random(0)

        def moves(place: int) -> bool:
            for _ in range(3):
                x = [draw.uniform(0.5, 1.5) for _ in range(self.spec.dimension)]
                values = [*x, *((v or 0.7) * draw.uniform(0.7, 1.3) for v in self.defaults())]
                both = [values, [v + (k == place) for k, v in enumerate(values)]]
                here, there = (rhs.bind(v[len(x) :])(0.3, v[: len(x)])[i] for v in both)
                if not abs(there - here) <= 1e-9 * (1.0 + abs(here)):
                    return True
            return False

        return (
            {j for j in uses if moves(j)},
            {(k, e) for k, e in asks if moves(first + k * size + 2 + e)},
        )

    def defaults(self) -> list[float]:
        """The parameters' defaults, followed by signals and windows of constant value 1."""
        shown = blank(self.spec.lags, self.spec.dimension, 1.0)
        own = (p.default for p in self.spec.parameters)
        return flat([*own, *no_signal(self.spec.signals, 1.0), *shown])

    def looks_back(self, graph: Graph, root: int) -> set[tuple[int, int]]:
        """The (lag, element) pairs that a node reads from the past."""
        return self._past_in(graph, root, sum(map(prod, self._own_shapes)))

    def _past_in(self, graph: Graph, root: int, first: int) -> set[tuple[int, int]]:
        found, size = set(), 2 + (WINDOW_DEGREE + 1) * self.spec.dimension
        for name in inputs_of(graph, [root]):
            place = int(name[1:]) - first if name[0] == "p" else -1
            number, rest = divmod(place, size)
            if place >= 0 and rest >= 2:
                found.add((number, (rest - 2) % self.spec.dimension))
        return found

    @cached_property
    def seen(self) -> tuple[tuple[int, ...], ...]:
        """For each lag, the elements of the state that some function reads."""
        extra = {"restitution": ["u"]}
        parts = [self.asked(c, extra.get(kind, [])) for (kind, _), c in self.cls.traces.items()]
        pairs = {pair for part in parts for element in part for pair in element}
        return tuple(
            tuple(sorted(e for number, e in pairs if number == k))
            for k in range(len(self.spec.lags))
        )

    def pushed(self, mode: str) -> Mask:
        """The elements that contacts of a mode push: velocities of what their gaps are between."""
        found = np.zeros(self.spec.dimension, dtype=bool)
        for edge in self.spec.transitions:
            if isinstance(edge, ContactSpec) and edge.source == mode:
                found[list(self.pairing(edge.name).velocities)] = True
        return found

    @cached_property
    def beside(self) -> list[int]:
        """Discrete elements on which no flow, guard or state depends, not even through resets. They
        may count freely."""
        used: set[int] = set()
        rows: list[tuple[int, set[int]]] = []
        for (kind, _), closed in self.cls.traces.items():
            if kind == "output":
                continue
            found = self.dependencies(closed, ["u"] if kind == "restitution" else [])
            used.update(*(found[: self.spec.flows] if kind == "reset" else found))
            rows += enumerate(found) if kind == "reset" else []
        if any(callable(getattr(e, "inverse_mass", None)) for e in self.spec.transitions):
            return []
        for _ in self.spec.discrete:
            used.update(*(found for place, found in rows if place in used))
        return [i for i in range(self.spec.flows, self.spec.dimension) if i not in used]

    # -- guards and contacts ------------------------------------------------------------

    def guard_closed(self, edge: Transition) -> Any:
        if isinstance(edge, LeaveSpec):
            return self.rate_closed(edge.switching, edge.side)
        if isinstance(edge, SideSpec):
            return self.closed("surface", edge.name)
        return self.closed("gap" if isinstance(edge, ContactSpec) else "guard", edge.name)

    def bounds(self, edge: Transition, parameters: Sequence[float]) -> bool:
        """Whether a guard bounds its mode, for given parameter values.

        A guard with a condition does not. Nor does the guard of an edge that leads back into its
        mode, if the reset leaves the guard at zero and does not reverse its motion: the flow then
        passes through zero. Identical expressions before and after the reset are taken as equal.
        Otherwise random points decide whether the guard stays at zero and, if the reset changes its
        rate (a kick), whether it reverses it. Values of windows after the parameters are ignored.
        """
        if isinstance(edge, EdgeSpec) and edge.when is not None:
            return False
        stays, kicked = self._kick(edge)
        return not stays or (kicked is not None and self._turns(edge.crossing, kicked, parameters))

    def kicks(self, edge: Transition) -> bool:
        """Whether the parameter values may decide if a guard bounds its mode."""
        return self._kick(edge)[1] is not None

    def _kick(self, edge: Transition) -> tuple[bool, Program | None]:
        if not isinstance(edge, EdgeSpec) or edge.to != edge.source:
            return False, None
        return self.once(("stays", edge.name), lambda: self._stays(edge))  # type: ignore[no-any-return]

    def _stays(self, edge: EdgeSpec) -> tuple[bool, Program | None]:
        """Whether a reset leaves its guard at zero, and, if it may change the guard's rate, a
        program of guard and rate, each before and after the reset."""
        reset = trace.again(self.closed("reset", edge.name))
        guard = trace.again(self.closed("guard", edge.name))
        rate = contacts.lie(guard, trace.again(self.closed("flow", edge.source)))

        def pairs(parameters: Any, t: Any, x: Any) -> Any:
            import jax.numpy as jnp

            after = reset(parameters, t, x)
            both = [(h(parameters, t, x), h(parameters, t, after)) for h in (guard, rate)]
            return jnp.array(both)

        closed, graph = self.trace(pairs), Graph()
        ((here, there), (before, after)), *_ = read(graph, closed, self.inputs(graph))
        if here == there and before == after:
            return True, None
        kick = self.program(("kick", edge.name), lambda: closed)
        stays = here == there or self._stays_zero(kick)
        return stays, kick if stays else None

    def _stays_zero(self, kick: Program) -> bool:
        """Whether a reset leaves its guard at zero for any parameters, tested at zeros that the
        secant method finds from random points."""
        draw, own = random.Random(0), sum(map(prod, self._own_shapes))
        places = range(1 + self.spec.dimension)

        def there() -> bool:
            values = self.defaults()
            values[:own] = [(v or 0.7) * draw.uniform(0.7, 1.3) for v in values[:own]]
            start, end = ([draw.uniform(0.0, 1.5) for _ in places] for _ in range(2))

            def at(s: float) -> Sequence[float]:
                t, *x = ((1.0 - s) * a + s * b for a, b in zip(start, end, strict=True))
                return kick.bind(values)(t, x)  # type: ignore[no-any-return]

            s, last, (value, after, *_), before = 1.0, 0.0, at(1.0), at(0.0)[0]
            size = max(abs(value), abs(before))
            for _ in range(SECANTS):
                if value == before or abs(value) <= EPS * size:
                    break
                s, last = s - value * (s - last) / (value - before), s
                before, (value, after, *_) = value, at(s)
            return size > 0.0 and all(abs(v) <= AT_ZERO * size for v in (value, after))

        return all(there() for _ in range(RESET_SAMPLES))

    def _turns(self, crossing: Crossing, kicked: Program, parameters: Sequence[float]) -> bool:
        """Whether a reset reverses its guard's motion at one of a few random points."""
        own = sum(map(prod, self._own_shapes))
        pairs = kicked.bind([*parameters[:own], *self.defaults()[own:]])
        direction = {Crossing.FALLING: -1, Crossing.RISING: 1}.get(crossing, 0)
        draw = random.Random(0)
        for _ in range(RESET_SAMPLES):
            x = [draw.uniform(-1.5, 1.5) for _ in range(self.spec.dimension)]
            *_, before, after = pairs(draw.uniform(0.0, 1.5), x)
            towards = before * direction > 0 or (not direction and before)
            if towards and not before * after > 0:
                return True
        return False

    def guards_closed(self, mode: str) -> dict[str, Callable[[], Any]]:
        """The jaxprs of a mode's guards, by name: those of its edges and of the window ends."""
        edges = {e.name: partial(self.guard_closed, e) for e in self.spec.leaving(mode)}
        moving = [k for k, moves in enumerate(self.moving) if moves]
        windows = {(k, side): partial(self.window_closed, k, side) for k in moving for side in "ab"}
        return edges | {window_edge(*key): closed for key, closed in windows.items()}

    def mass_closed(self, name: str) -> Any:
        """The jaxpr of a contact's inverse mass matrix; None if it is not declared."""
        if self.contact_spec(name).inverse_mass is None:
            return None
        return self.once(("mass", name), lambda: self.trace(self.laws(name).mass))

    def pairing(self, name: str) -> contacts.Pairing:
        """The positions in a contact's gap and their velocities."""

        def make() -> contacts.Pairing:
            contact = self.contact_spec(name)
            flow = self.closed("flow", contact.source)
            (gap,) = self.dependencies(self.closed("gap", name))
            still = {TIME_PLACE, *range(self.spec.flows, self.spec.dimension)}
            gap, flows = gap - still, [d - still for d in self.dependencies(flow)]
            return contacts.pair(self.spec, contact, gap, flows, self._unit(contact.source))

        return self.once(("pairing", name), make)

    def _unit(self, mode: str) -> Callable[[int, int], bool]:
        """A test whether a component of the flow has slope one in an element: at random points, of
        the parameters, too, beginning with their defaults, and on either side of each function at
        whose zeros the slope changes its formula. Where it has no value nothing is told.
        """
        flow, own, defaults = self.flow(mode), sum(map(prod, self._own_shapes)), self.defaults()
        draw, places = random.Random(0), []
        for k in range(VELOCITY_SAMPLES):
            moved = [p + draw.uniform(0.1, 0.3) * (abs(p) or 1.0) for p in defaults[:own]]
            numbers = [*moved, *defaults[own:]] if k else defaults
            reach = (0.5, 1.5) if k == 0 else (-3.0, 3.0)
            x = [draw.uniform(*reach) for _ in range(self.spec.dimension)]
            places.append((numbers, flow.bind(numbers), draw.uniform(0.0, 3.0), x))

        def unit(i: int, j: int) -> bool:
            for k, (_, rhs, t, x) in enumerate(places):
                one, other = (rhs(t, [*x[:j], v, *x[j + 1 :]])[i] for v in (x[j], x[j] + 1.0))
                off = abs(other - one - 1.0) / max(1.0, abs(one))
                if not (off < VELOCITY_ROUNDING or (k and not isfinite(off))):
                    return False
            sides = self.mode(mode).slopes(i, j)
            found = (slope for numbers, _, t, x in places for slope in sides(numbers, t, x))
            return not any(abs(slope - 1.0) >= VELOCITY_ROUNDING for slope in found)

        return unit

    def contact_spec(self, name: str) -> ContactSpec:
        return next(e for e in self.spec.transitions if e.name == name)

    def laws(self, name: str) -> contacts.ContactLaws:
        def make() -> contacts.ContactLaws:
            contact = self.contact_spec(name)
            pairings = [self.pairing(other) for other in contact.among or (name,)]
            together = sorted({place for pairing in pairings for place in pairing.positions})
            return contacts.laws(self.cls, self.spec, contact, self.pairing(name), together)

        return self.once(("laws", name), make)


def window_edge(number: int, side: str) -> str:
    """Name of the guard at end ``"a"`` or ``"b"`` of the window of a varying lag."""
    return f"past({number}).{side}"


def window_ends(spec: Spec) -> list[str]:
    """Names of the window guards of all lags, in the order of their numbers."""
    return [window_edge(number, side) for number in range(len(spec.lags)) for side in "ab"]


def lowered(cls: Any, shapes: tuple[tuple[int, ...], ...]) -> Lowered:
    """The generated code of a class, cached on the class."""
    store = cls.__dict__.get("_hybrid_lowered")
    if store is None:
        store = {}
        cls._hybrid_lowered = store
    if shapes not in store:
        store[shapes] = Lowered(cls, shapes)
    return store[shapes]
