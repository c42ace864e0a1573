"""The graph of a mode: its flow, guards and contacts, with a mask of the held contacts.

The laws are those of :mod:`.contact`, made once per mode as nodes, for any set of held contacts.
The contact forces are the unknowns of one node of linear equations, and the mask is an input for
each contact, after the parameters. So the cost of a mode grows polynomially with its contacts, not
with the number of their subsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from enum import StrEnum
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.chance import DRAWS
from ..automaton.spec import ContactSpec, LeaveSpec
from .contact import Pairing
from .derivatives import along, gradient, parts, solved, times
from .graph import Graph, rebuilt
from .jaxpr import read
from .python import Program
from .recorder import tape
from .sides import choosers, on_zero, one_sided
from .tape import Tape

if TYPE_CHECKING:
    from .lowered import Lowered

Scalar = Callable[..., Any]

#: Suffix of the guard that is the load of a contact.
RELEASE_SUFFIX = ".release"


class Kind(StrEnum):
    """What a guard belongs to."""

    EDGE = "edge"
    CONTACT = "contact"
    RELEASE = "release"
    SWITCH = "switch"
    LEAVE = "leave"
    WINDOW = "window"
    CLOCK = "clock"


@attrs.frozen
class Normal:
    """A contact: its gap, the gap's rates along the free flow, and the effect of an impulse.

    Attributes
    ----------
    normal, push : list of node
        Gradient of the gap at its positions; direction of the impulse at their velocities.
    weight
        Change of the gap speed by a unit impulse.
    """

    pairing: Pairing
    gap: int
    speed: int
    acceleration: int
    normal: list[int]
    push: list[int]
    weight: int

    def way(self, of_speed: bool) -> dict[int, int]:
        """The impulse direction by velocity element, or the gap gradient by position element."""
        if of_speed:
            return dict(zip(self.pairing.velocities, self.push, strict=True))
        return dict(zip(self.pairing.positions, self.normal, strict=True))


class ModeGraph:
    """The graph of a mode or a sliding mode of a class."""

    def __init__(self, code: Lowered, mode: str) -> None:
        self.code, self.mode, self.spec = code, mode, code.spec
        self.kept: Hashable = mode
        self.graph = Graph(long=True)
        resting = [e for e in self.spec.leaving(mode) if isinstance(e, ContactSpec) and e.rests]
        self.resting = [edge.name for edge in resting]
        count = sum(map(math.prod, code.shapes))
        masks = [f"p{count + i}" for i in range(len(self.resting))]
        self.inputs = code.inputs(self.graph, masks)
        self.mask = [int(i) for i in self.inputs[len(code.shapes) + 2 :]]
        self.own = self.inputs[: len(code.shapes) + 2]
        self.t, self.x = int(self.own[-2]), [int(i) for i in self.own[-1]]
        self.closed = code.guards_closed(mode)
        self.derived = {e.name for e in self.spec.leaving(mode) if isinstance(e, LeaveSpec)}
        self._contacts: dict[str, Normal] = {}
        self._guards: dict[str, int] = {}

    def masked(self, held: Collection[str]) -> tuple[float, ...]:
        """The mask of held contacts, as numbers."""
        return tuple(float(name in held) for name in self.resting)

    def values(self, closed: Any, *extra: int) -> list[int]:
        """Nodes of a trace's result."""
        given = [np.array(i) for i in extra]
        (outputs,) = read(self.graph, closed, [*self.own, *given])
        return [int(i) for i in outputs.reshape(-1)]

    @cached_property
    def free(self) -> list[int]:
        """The flow without held contacts."""
        return self.values(self.code.field_closed(self.mode, ()))

    def rate(self, node: int, flow: Sequence[int]) -> int:
        """The Lie derivative of a node along a flow."""
        one = self.graph.const(1.0)
        return along(self.graph, node, {self.t: one, **dict(zip(self.x, flow, strict=True))})

    def slopes(self, i: int, j: int) -> Callable[..., Sequence[float]]:
        """The slope of a component of the free flow in an element, on either side of each function
        at whose zeros it changes its formula: a function of numbers, time and state."""
        graph, blank = self.graph, [0.0] * len(self.mask)
        slope = along(graph, self.free[i], {self.x[j]: graph.const(1.0)})
        nodes = [
            one_sided(graph, [slope], {decider: sign})[0]
            for decider in choosers(graph, [slope], flows=False)
            for sign in (1, -1)
        ]
        if not nodes:
            return lambda numbers, t, x: ()
        program = Program(graph, ["t", "x"], len(self.x), np.array(nodes))
        return lambda numbers, t, x: program.bind([*numbers, *blank])(t, x)

    # -- contacts -------------------------------------------------------------------------

    def contact(self, name: str) -> Normal:
        """The nodes of a contact."""
        if name not in self._contacts:
            self._contacts[name] = self._contact(name)
        return self._contacts[name]

    def _contact(self, name: str) -> Normal:
        graph, pairing = self.graph, self.code.pairing(name)
        numbers = [*self.code.defaults(), *(0.0 for _ in self.mask)]
        gap = on_zero(graph, len(self.x), self.guard(name), numbers)
        speed = self.rate(gap, self.free)
        normal = gradient(graph, gap, [self.x[i] for i in pairing.positions])
        push, mass = normal, self.code.mass_closed(name)
        if mass is not None:
            rows = np.array(self.values(mass)).reshape(len(normal), -1).tolist()
            push = [graph.dot([*zip(row, normal, strict=True)]) for row in rows]
        weight = graph.dot([*zip(normal, push, strict=True)])
        return Normal(pairing, gap, speed, self.rate(speed, self.free), normal, push, weight)

    def cornered(self, name: str) -> bool:
        """Whether a contact's gap has a corner at zero, as a distance does."""
        return self.contact(name).gap != self.guard(name)

    def impact(self, name: str) -> list[int]:
        """The state after an impact, followed by the gap speed after it."""
        state = self._pushed(self.contact(name), self.impulse(name))
        if name in self.spec.chances:
            place = self.spec.place(DRAWS)
            state[place] = self.graph.node("add", state[place], self.graph.const(1.0))
        return [*state, self._speed_after(name)]

    def _speed_after(self, name: str) -> int:
        contact = self.contact(name)
        (share,) = self.values(self.code.closed("restitution", name), contact.speed)
        return self.graph.node("mul", share, self.graph.node("abs", contact.speed))

    def impulse(self, name: str) -> int:
        """The impulse of an impact: the multiplier of the impulse direction."""
        contact = self.contact(name)
        change = self.graph.node("sub", self._speed_after(name), contact.speed)
        return self.graph.node("div", change, contact.weight)

    def _pushed(self, contact: Normal, size: int) -> list[int]:
        moved, graph = [*self.x], self.graph
        for place, push in zip(contact.pairing.velocities, contact.push, strict=True):
            moved[place] = graph.node("add", moved[place], times(graph, push, size))
        return moved

    def push(self, name: str) -> list[int]:
        """Change of the state that changes the gap speed by one."""
        contact, graph = self.contact(name), self.graph
        change = [graph.const(0.0)] * len(self.x)
        for place, push in zip(contact.pairing.velocities, contact.push, strict=True):
            change[place] = graph.node("div", push, contact.weight)
        return change

    def land(self, name: str) -> list[int]:
        """The state moved onto ``gap = 0`` along the gap's gradient."""
        contact, graph, moved = self.contact(name), self.graph, [*self.x]
        square = graph.dot([*zip(contact.normal, contact.normal, strict=True)])
        share = graph.node("div", contact.gap, square)
        for place, normal in zip(contact.pairing.positions, contact.normal, strict=True):
            moved[place] = graph.node("sub", moved[place], times(graph, normal, share))
        return moved

    def turn(self, name: str, held: bool) -> list[int]:
        """The change :meth:`push`, then gap speed and gap acceleration along the flow."""
        return [*self.push(name), *self.lie_on(name, held)[1:]]

    def law(self, name: str) -> list[int]:
        """The restitution coefficient; the impact speed is an extra state at the end."""
        speed = self.graph.input(f"x{len(self.x)}")
        return self.values(self.code.closed("restitution", name), speed)

    # -- contacts held --------------------------------------------------------------------

    @cached_property
    def forces(self) -> dict[str, int]:
        """Multipliers that make held contacts' gap accelerations zero; 0 for other contacts."""
        return self._shares("acceleration", True)

    def _shares(self, rate: str, of_speed: bool) -> dict[str, int]:
        """Multipliers of the contact directions, of velocities or positions, that cancel the given
        rate of all held gaps; 0 for other contacts."""
        matrix = self._matrix(of_speed)
        found: dict[str, int] = {}
        for group in self.groups(self.resting, of_speed):
            wanted = [self.graph.node("neg", getattr(self.contact(i), rate)) for i in group]
            rows = [[matrix[i, j] for j in group] for i in group]
            mask = [self.mask[self.resting.index(i)] for i in group]
            if len(group) == 1:
                alone = self.graph.node("div", wanted[0], rows[0][0])
                found[group[0]] = self._if_held(mask[0], alone)
            else:
                equations = solved(self.graph, rows, wanted, mask)
                found.update(zip(group, parts(self.graph, equations, len(group)), strict=True))
        return found

    def _matrix(self, of_speed: bool) -> dict[tuple[str, str], int]:
        """The change of the rate of each resting contact by a unit multiplier of each."""

        def make() -> dict[tuple[str, str], int]:
            contacts = {name: self.contact(name) for name in self.resting}
            ways = {name: contact.way(of_speed) for name, contact in contacts.items()}
            felt = {
                name: dict(zip(ways[name], contacts[name].normal, strict=True)) for name in ways
            }
            return {
                (i, j): self.graph.dot(
                    [(n, ways[j][k]) for k, n in felt[i].items() if k in ways[j]]
                )
                for i in self.resting
                for j in self.resting
            }

        return self.code.once(("matrix", self.kept, of_speed), make)  # type: ignore[no-any-return]

    def groups(self, names: Sequence[str], of_speed: bool = True) -> list[list[str]]:
        """Groups of resting contacts whose multipliers are coupled, each in declared order."""
        linked = {pair: self.graph.value(a) != 0 for pair, a in self._matrix(of_speed).items()}
        return _groups(names, linked)

    def _if_held(self, mask: int, value: int) -> int:
        """``value``, or 0 if its contact is not held; the only contact of a mode is always held."""
        if len(self.resting) == 1:
            return value
        return self.graph.node("select", mask, value, self.graph.const(0.0))

    @cached_property
    def along_contacts(self) -> list[int]:
        """The resting field of the held contacts."""
        return self._along_contacts(self.free, self.forces, True)

    def onto(self, of_speed: bool) -> list[int]:
        """The state after one Newton step to zero gaps, or gap speeds, of held contacts."""
        shares = self._shares("speed" if of_speed else "gap", of_speed)
        return self._along_contacts(self.x, shares, of_speed)

    def _along_contacts(
        self, start: Sequence[int], shares: Mapping[str, int], of_speed: bool
    ) -> list[int]:
        graph = self.graph
        changes: list[list[int]] = [[] for _ in start]
        for name, mask in zip(self.resting, self.mask, strict=True):
            for place, way in self.contact(name).way(of_speed).items():
                changes[place].append(self._if_held(mask, times(graph, shares[name], way)))
        pairs = zip(start, changes, strict=True)
        return [graph.node("add", f, graph.total(c)) for f, c in pairs]

    @cached_property
    def leans(self) -> bool:
        """Whether the resting set depends on the past."""
        of = [n for name in self.resting for n in self._place(name)]
        lags = bool(self.spec.lags)
        return lags and any(self.code.looks_back(self.graph, node) for node in of)

    def shown(self, name: str) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
        """The (lag, element) pairs that a contact's gap reads from the past, and its gap speed."""

        def make() -> tuple[set[tuple[int, int]], ...]:
            contact = self.contact(name)
            return tuple(self.code.looks_back(self.graph, n) for n in (contact.gap, contact.speed))

        return self.code.once(("shown", name), make)  # type: ignore[no-any-return]

    def _place(self, name: str) -> list[int]:
        contact = self.contact(name)
        return [contact.gap, contact.speed, *contact.normal, *contact.push]

    def flow(self, held: bool) -> list[int]:
        """The free flow or the resting field."""
        return self.along_contacts if held else self.free

    def guard(self, name: str) -> int:
        """The node of a guard: of an edge, of a window end, or the load of a contact."""
        if name not in self._guards:
            self._guards[name] = self._guard(name)
        return self._guards[name]

    def _guard(self, name: str) -> int:
        contact = name.removesuffix(RELEASE_SUFFIX)
        if contact != name:
            return times(self.graph, self.forces[contact], self.contact(contact).weight)
        (value,) = self.values(self.traced(name)())
        return value

    def traced(self, name: str) -> Callable[[], Any]:
        """A function that returns the trace of a guard, or of an unwatched clock."""
        return self.closed.get(name) or partial(self.code.closed, "guard", name)

    def deciding(self, name: str) -> list[int]:
        """Nodes whose change of formula matters for a guard. For a load these include the contact's
        gap, gap speed and free acceleration, and for the end of sliding the surface: these can end
        it, too."""
        if name in self.derived and (slides := self.spec.sliding(self.mode)) is not None:
            return [self.guard(name), *self.values(self.code.closed("surface", slides.name))]
        held = name.removesuffix(RELEASE_SUFFIX)
        if held == name:
            return [self.guard(name)]
        contact = self.contact(held)
        return [self.guard(name), contact.gap, contact.speed, contact.acceleration]

    # -- programs and tapes ---------------------------------------------------------------

    def program(self, key: Any, make: Callable[[], Sequence[int]]) -> Program:
        """Scalar code of some nodes; the mask follows the parameters."""
        return self.code.once(("mode", self.kept, key), lambda: self._program(make()))  # type: ignore[no-any-return]

    def _program(self, nodes: Sequence[int]) -> Program:
        return Program(self.graph, ["t", "x"], len(self.x), np.array(nodes))

    def lie(self, name: str, held: bool) -> list[int]:
        """A guard and its first two Lie derivatives along the flow."""
        return self._lie(self.guard(name), held)

    def lie_on(self, name: str, held: bool) -> list[int]:
        """The same of a gap, with the formula that holds where it is zero."""
        return self._lie(self.contact(name).gap, held)

    def _lie(self, node: int, held: bool) -> list[int]:
        first = self.rate(node, self.flow(held))
        return [node, first, self.rate(first, self.flow(held))]

    def sizes(self, name: str, held: bool) -> list[int]:
        """Sums of the absolute values of the terms of a guard and of its two Lie derivatives."""
        guard, moving = self.guard(name), [self.graph.const(1.0), *self.flow(held)]
        first = self.rate(guard, self.flow(held))
        inputs, zero = [self.t, *self.x], self.graph.const(0.0)
        slopes = zip(gradient(self.graph, first, inputs), moving, strict=True)
        # the rounding of a flow is that of its own terms
        made = [zero if slope == zero else self._terms(rate, inputs) for slope, rate in slopes]
        bend = self.graph.node("add", self._terms(first, moving), self._terms(first, made))
        return [self.size(guard), self._terms(guard, moving), bend]

    def size(self, node: int) -> int:
        """The sum of the absolute values of a node's terms, a constant offset included."""
        graph, zeros = self.graph, dict.fromkeys(self.x, self.graph.const(0.0))
        (offset,) = rebuilt(graph, [node], lambda n: zeros.get(graph.known(*n) or -1))
        known = graph.node("is_finite", offset)
        absolute = graph.node("select", known, graph.node("abs", offset), graph.const(0.0))
        return graph.node("add", self._terms(node, [self.t, *self.x]), absolute)

    def _terms(self, node: int, changes: Sequence[int]) -> int:
        graph = self.graph
        slopes = gradient(graph, node, [self.t, *self.x])
        pairs = zip(slopes, changes, strict=True)
        return graph.dot([(graph.node("abs", a), graph.node("abs", b)) for a, b in pairs])

    def tape(self, held: bool, touching: Collection[str] = ()) -> Tape:
        """The tape of the flow and of all guards, in the order of :meth:`watched`.

        Gaps of the contacts in ``touching`` have the formula that holds where they are zero.

        Raises
        ------
        TraceError
            If an operation has no recurrence.
        """
        guards = [
            self.contact(name).gap if name in touching else self.guard(name)
            for name in self.watched(held)
        ]
        where = f"{self.spec.model}, mode {self.mode}"
        return tape(self.graph, len(self.x), np.array(self.flow(held)), guards, where)

    def of_values(
        self, key: tuple[Any, ...], nodes: Callable[[], Sequence[int]], more: int = 0
    ) -> Tape:
        """The tape of functions without a flow, of the state and ``more`` numbers after it.

        Raises
        ------
        TraceError
            If an operation cannot be put on a tape.
        """
        where, size = f"{self.spec.model}, mode {self.mode}", len(self.x) + more
        make = lambda: tape(self.graph, size, np.array([]), nodes(), where)  # noqa: E731
        return self.code.once(("values", self.kept, *key), make)  # type: ignore[no-any-return]

    def along(self, held: bool, nodes: Sequence[int]) -> Tape:
        """The tape of the flow and of functions along it.

        Raises
        ------
        TraceError
            If an operation has no recurrence.
        """
        where, flow = f"{self.spec.model}, mode {self.mode}", np.array(self.flow(held))
        return tape(self.graph, len(self.x), flow, nodes, where)

    def contact_tapes(self, name: str, held: bool) -> list[Tape]:
        """Tapes for the values at a contact: :meth:`land`, :meth:`turn`, :meth:`law`."""
        return [
            self.of_values(("land", name), lambda: self.land(name)),
            self.of_values(("turn", name, held), lambda: self.turn(name, held)),
            self.of_values(("law", name), lambda: self.law(name), 1),
        ]

    def watched(self, held: bool) -> list[str]:
        """Names of the guards: those declared and, with contacts held, their loads."""
        return [*self.closed, *(f"{name}{RELEASE_SUFFIX}" for name in self.resting if held)]

    def projector(self) -> Callable[[Sequence[float]], Scalar]:
        """Of values of parameters and mask the function that projects a state onto zero gaps (two
        Newton steps) and zero gap speeds."""
        both = [self.program(("onto", k), partial(self.onto, k)) for k in (False, True)]
        uses = sorted({place for program in both for place in program.uses})
        known: dict[tuple[float, ...], Scalar] = {}  # of one lane: most differ in what is not used

        def projection(numbers: Sequence[float]) -> Scalar:
            own = tuple(numbers[place] for place in uses)
            if own not in known or 0.0 in own:  # of either sign
                gaps, speeds = (program.bind(numbers) for program in both)
                known.clear()
                known[own] = lambda t, x: speeds(t, gaps(t, gaps(t, x)))
            return known[own]

        return projection


def _groups(names: Sequence[str], linked: Mapping[tuple[str, str], bool]) -> list[list[str]]:
    """Groups of contacts whose forces are coupled, each in declared order."""
    groups: list[list[str]] = []
    for name in names:
        meets = [g for g in groups if any(linked[name, i] or linked[i, name] for i in g)]
        joined = {i for group in meets for i in group} | {name}
        groups = [group for group in groups if group not in meets]
        groups.append([i for i in names if i in joined])
    return groups
