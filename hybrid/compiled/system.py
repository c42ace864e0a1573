"""A class's functions for compiled runs: one function of the mode's number and of the
contacts held, where :mod:`hybrid.scene` has one for each mode and set of contacts.

Every edge and contact of a mode has a *slot*, in declared order. A contact's slot is its gap
while it is open and its load while it is held, so that each slot fires where it falls to
zero: an impact, or a release.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.spec import ContactSpec, LeaveSpec, SideSpec
from ..automaton.trace import again
from ..errors import TraceError
from ..events import CLOSED, EPS
from ..scene.contact import ContactLaws, Held
from ..scene.lowered import Lowered, guard_shape
from ..solvers.series import Expansion, Jets, expansion

#: A guard's value in a slot that its mode does not have.
FAR = 1.0

#: Characters of a class's recurrences, written out, up to which they are short.
LONG = 40_000


class Jumped(NamedTuple):
    """A jump carried out.

    Attributes
    ----------
    before, after : array
        States; ``before`` lies on the contact's gap.
    mode, held
        Where it leads.
    speed : number
        The gap's speed after an impact; 1 for an edge.
    stays : bool
        The guard is the same after the jump as before it.
    sure : bool
        The rules of compiled lanes decide what follows.
    """

    before: Any
    after: Any
    mode: Any
    held: Any
    speed: Any
    stays: Any
    sure: Any


class System:
    """Functions of ``(parameters, mode, held, t, x)``.

    ``held`` is a mask over the slots, or None where no contact is known to be held. With
    ``slides`` the sliding modes of switchings are modes like others; without them a
    switching's jump is not carried out here.
    """

    def __init__(self, code: Lowered, slides: bool = False) -> None:
        self.code, self.spec = code, code.spec
        sliding = [switching.mode for switching in self.spec.switchings if switching.slides]
        self.modes = (*(mode.name for mode in self.spec.modes), *sliding[: None if slides else 0])
        self.edges = {mode: self.spec.leaving(mode) for mode in self.modes}
        self.width = max(1, *(len(edges) for edges in self.edges.values()))
        self.projects = bool(self.spec.switchings) or bool(self.rests.any())

    def table(self, entry: Callable[[Any], Any], empty: Any) -> np.ndarray:
        """A number for each mode and slot."""
        rows = [
            [entry(edge) for edge in edges] + [empty] * (self.width - len(edges))
            for edges in self.edges.values()
        ]
        return np.array(rows)

    @cached_property
    def crossing(self) -> np.ndarray:
        """-1 where a slot fires falling, +1 rising, 0 either way."""
        signs = {Crossing.FALLING: -1, Crossing.RISING: 1, Crossing.EITHER: 0}
        return self.table(lambda edge: signs[edge.crossing], -1)

    @cached_property
    def is_contact(self) -> np.ndarray:
        return self.table(lambda edge: isinstance(edge, ContactSpec), False)

    @cached_property
    def rests(self) -> np.ndarray:
        """Whether a slot is a contact that may be held."""
        return self.table(lambda edge: isinstance(edge, ContactSpec) and edge.rests, False)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Whether a slot's guard bounds its mode (3)."""
        return self.table(self.code.bounds, True)

    @cached_property
    def uses(self) -> np.ndarray:
        """Elements of the state that a guard is made of; shape ``(modes, width, n)``."""
        table = np.zeros((len(self.modes), self.width, self.spec.dimension), dtype=bool)
        for mode, edges in enumerate(self.edges.values()):
            for slot, edge in enumerate(edges):
                table[mode, slot, list(self._shape(edge)[1])] = True
        return table

    def _shape(self, edge: Any) -> tuple[bool, tuple[int, ...]]:
        """Whether a guard is affine, and the elements it is made of."""
        make = lambda: guard_shape(self.code, self.code.guard_closed(edge))  # noqa: E731
        shape: tuple[bool, tuple[int, ...]] = self.code.once(("guard shape", edge.name), make)
        return shape

    @cached_property
    def affine(self) -> bool:
        """Whether every guard but the loads is a polynomial wherever the state is one."""
        return all(self._shape(edge)[0] for edges in self.edges.values() for edge in edges)

    def pick(self, table: np.ndarray, mode: Any, slot: Any = None) -> Any:
        """A mode's row of a table, or one slot's entry; not looked up where all are equal."""
        if (table == table.flat[0]).all():
            return jnp.asarray(table[0] if slot is None else table.flat[0])
        row = jnp.asarray(table)[mode] if len(table) > 1 else jnp.asarray(table[0])
        return row if slot is None else row[slot]

    def only(self, slot: Any) -> Any:
        """Mask over the slots: this one."""
        return jnp.arange(self.width) == slot

    def number(self, mode: Any, slot: Any) -> Any:
        """The number of an edge among all, mode by mode."""
        first = np.cumsum([0, *map(len, self.edges.values())])[:-1]
        return self.pick(first[:, None], mode, 0) + slot

    # -- by mode ------------------------------------------------------------------------

    def flow(self, p: Any, mode: Any, held: Any, t: Any, x: Any) -> Any:
        """Time derivatives, along the contacts held."""
        return self._by_mode(self._flow, p, mode, held, t, x)

    def series(self, p: Any, mode: Any, held: Any, t: Any, x: Any) -> Any:
        """The states along the flow, as coefficients of the powers of time."""
        return self._by_mode(self._series, p, mode, held, t, x)

    def guards(self, p: Any, mode: Any, held: Any, t: Any, x: Any) -> Any:
        """Guards of all slots; shape ``(width,)``."""
        return self._by_mode(self._guards, p, mode, held, t, x)

    def lies(self, p: Any, mode: Any, held: Any, t: Any, x: Any) -> tuple[Any, Any]:
        """Guards and their first two derivatives along the flow; and the flow.

        Shape ``(3, width)``; the second derivative of a load is left out (0). The guards are
        differentiated along the second-order curve of the flow, which needs one derivative
        of the flow only.
        """

        def along(t: Any, x: Any) -> Any:
            return self.flow(p, mode, held, t, x)

        one = jnp.ones_like(t)
        rate = along(t, x)
        rate, bend = jax.jvp(along, (t, x), (one, rate))

        def on_curve(s: Any) -> Any:
            return self._by_mode(self._gaps, p, mode, t + s, x + s * rate + 0.5 * s * s * bend)

        def slope(s: Any) -> Any:
            return jax.jvp(on_curve, (s,), (one,))

        (value, first), (_, second) = jax.jvp(slope, (jnp.zeros_like(t),), (one,))
        lies = jnp.stack([value, first, second])
        if held is not None and self.rests.any():
            guards = lambda t, x: self.guards(p, mode, held, t, x)  # noqa: E731
            load, change = jax.jvp(guards, (t, x), (one, rate))
            of_loads = jnp.stack([load, change, jnp.zeros_like(load)])
            lies = jnp.where(held, of_loads, lies)
        return lies, rate

    def project(self, p: Any, mode: Any, held: Any, t: Any, x: Any) -> Any:
        """The state moved onto the contacts held, or onto the surface on which it slides."""

        def onto(name: str, p: Any, held: Any, t: Any, x: Any) -> Any:
            switching = self.spec.sliding(name)
            if switching is not None:
                return self.code.sliding(switching.name).project(p, t, x)
            return self._if_held(name, held, lambda h: h.project(p, t, x), lambda: x)

        return self._by_mode(onto, p, mode, held, t, x)

    def jump(self, p: Any, mode: Any, slot: Any, held: Any, t: Any, x: Any) -> Jumped:
        """Carry out the jump of a slot that fired."""
        branches = [
            self._jump_of(edge, name, i)
            for name, edges in self.edges.items()
            for i, edge in enumerate(edges)
        ]
        done = _switch(self.number(mode, slot), branches, p, held, t, x)
        return done._replace(held=self._still_held(p, mode, done, t))

    def touch(self, p: Any, mode: Any, slot: Any, t: Any, x: Any) -> tuple[Any, Any, Any]:
        """The state on a contact's gap, the change that adds one to the gap's speed, the speed."""

        def of(laws: ContactLaws, p: Any, t: Any, x: Any) -> Any:
            landed = laws.land(p, t, x)
            return landed, laws.push(p, t, landed), laws.speed(p, t, landed)

        return self._by_contact(of, p, mode, slot, t, x)

    def law(self, p: Any, mode: Any, slot: Any, t: Any, x: Any, u: Any) -> Any:
        """A contact's restitution at the gap speed ``u``."""
        return self._by_contact(lambda laws, p, *at: laws.law(p, *at), p, mode, slot, t, x, u)

    def _by_contact(self, function: Any, p: Any, mode: Any, slot: Any, *rest: Any) -> Any:
        branches: list[Any] = []
        places = np.zeros((len(self.modes), self.width), dtype=int)
        for number, edges in enumerate(self.edges.values()):
            for place, edge in enumerate(edges):
                if isinstance(edge, ContactSpec):
                    places[number, place] = len(branches)
                    laws = self.code.laws(edge.name)
                    branches.append(lambda p, *rest, laws=laws: function(laws, p, *rest))
        return _switch(self.pick(places, mode, slot), branches, p, *rest)

    # -- one mode -----------------------------------------------------------------------

    def _by_mode(self, function: Any, p: Any, mode: Any, *rest: Any) -> Any:
        branches = [lambda p, *rest, name=name: function(name, p, *rest) for name in self.modes]
        return _switch(mode, branches, p, *rest)

    def _resting(self, name: str) -> list[tuple[int, ContactLaws]]:
        """Slots and laws of the contacts of a mode that may be held."""
        pairs = enumerate(self.edges[name])
        return [
            (i, self.code.laws(e.name)) for i, e in pairs if isinstance(e, ContactSpec) and e.rests
        ]

    def _held(self, name: str, held: Any) -> Held:
        contacts = self._resting(name)
        mask = [held[slot] for slot, _ in contacts]
        flow = again(self.code.closed("flow", name))
        return Held(tuple(laws for _, laws in contacts), flow, mask)

    def _if_held(self, name: str, held: Any, then: Any, otherwise: Any) -> Any:
        if held is None or not self._resting(name):
            return otherwise()
        return jax.lax.cond(held.any(), lambda: then(self._held(name, held)), otherwise)

    def _flow(self, name: str, p: Any, held: Any, t: Any, x: Any) -> Any:
        free = again(self.code.field_closed(name, ()))
        return self._if_held(name, held, lambda h: h.rest(p, t, x), lambda: free(p, t, x))

    def _series(self, name: str, p: Any, held: Any, t: Any, x: Any) -> Any:
        def of(held: bool, *flags: Any) -> Jets:
            return self.expansion(name, held)(p, t, x, *flags).padded(self.kinks)

        def along(h: Held) -> Jets:
            return of(True, *(jnp.asarray(m, float) for m in h.mask))

        return self._if_held(name, held, along, lambda: of(False))

    def expansion(self, name: str, held: bool) -> Expansion:
        """The series of a mode's flow and guards; with contacts held, as so many flags say.

        Raises
        ------
        TraceError
            Where there is none.
        """
        contacts = tuple(laws for _, laws in self._resting(name))
        key = (self.modes, name, held)

        def by(flags: Any) -> Held:
            flow = again(self.code.closed("flow", name))
            return Held(contacts, flow, [flag > 0.5 for flag in flags])

        if not held:
            flow = lambda: self.code.field_closed(name, ())  # noqa: E731
            return expansion(self.code, key, flow, partial(self._gaps, name))
        rest = lambda p, t, x, *flags: by(flags).rest(p, t, x)  # noqa: E731
        flow = lambda: self.code.trace(rest, len(contacts))  # noqa: E731
        guards = lambda p, t, x, *flags: self._loads(name, by(flags), p, t, x)  # noqa: E731
        return expansion(self.code, key, flow, guards, len(contacts))

    def _expansions(self) -> Iterator[tuple[str, Callable[[], Expansion]]]:
        for name in self.modes:
            for held in (False, True)[: 1 + bool(self._resting(name))]:
                yield name, partial(self.expansion, name, held)

    @cached_property
    def no_series(self) -> str | None:
        """Why Taylor series cannot be used here, or None."""
        for name, make in self._expansions():
            try:
                make()
            except TraceError as fault:
                return f"mode {name}: {fault}"
        return None

    @cached_property
    def kinks(self) -> int:
        """Most kinks that end the series of a mode."""
        return max(make().program.kinks for _, make in self._expansions())

    @cached_property
    def short_series(self) -> bool:
        """Whether there are series, and short ones: others compile for longer than they save."""
        return self.no_series is None and sum(make().size for _, make in self._expansions()) <= LONG

    def _gaps(self, name: str, p: Any, t: Any, x: Any) -> Any:
        gaps = [again(self.code.guard_closed(edge))(p, t, x) for edge in self.edges[name]]
        gaps += [jnp.full_like(t, FAR)] * (self.width - len(gaps))
        return jnp.stack(gaps)

    def _guards(self, name: str, p: Any, held: Any, t: Any, x: Any) -> Any:
        loads = lambda h: self._loads(name, h, p, t, x)  # noqa: E731
        return self._if_held(name, held, loads, lambda: self._gaps(name, p, t, x))

    def _loads(self, name: str, h: Held, p: Any, t: Any, x: Any) -> Any:
        """Guards where contacts are held: their loads in place of their gaps."""
        values = self._gaps(name, p, t, x)
        multipliers, weights, _ = h.forces(p, t, x)
        contacts = zip(self._resting(name), h.mask, multipliers, weights, strict=True)
        for (slot, _), held, force, weight in contacts:
            values = jnp.where(held & self.only(slot), force * weight, values)
        return values

    def _jump_of(self, edge: Any, name: str, slot: int) -> Any:
        """The jump of one slot, as a function ``(p, held, t, x)``."""
        to = jnp.array(self.modes.index(edge.to))
        one, sure = jnp.array(1.0), jnp.array(True)
        if isinstance(edge, SideSpec):
            return self._side(edge, name)
        if isinstance(edge, LeaveSpec):
            return lambda p, held, t, x: Jumped(x, x, to, held, one, sure, sure)
        if not isinstance(edge, ContactSpec):
            reset, guard = again(self.code.closed("reset", edge.name)), self.code.guard_closed(edge)

            def by_reset(p: Any, held: Any, t: Any, x: Any) -> Any:
                after = reset(p, t, x)
                stays = again(guard)(p, t, after) == again(guard)(p, t, x)
                return Jumped(x, after, to, held, one, stays, sure)

            return by_reset
        laws = self.code.laws(edge.name)

        def impact(p: Any, held: Any, t: Any, x: Any) -> Any:
            before = laws.land(p, t, x)
            after = laws.impact(p, t, before)
            return Jumped(before, after[:-1], to, held, after[-1], sure, sure)

        def release(p: Any, held: Any, t: Any, x: Any) -> Any:
            return Jumped(x, x, to, held & ~self.only(slot), one, sure, sure)

        if not edge.rests:
            return impact
        return lambda p, held, t, x: jax.lax.cond(held[slot], release, impact, p, held, t, x)

    def _side(self, edge: SideSpec, name: str) -> Any:
        """The jump of a switching (8), decided by the first derivative along the other flow."""
        switching, sliding = self.spec.switching(edge.name), self.spec.sliding(name) is not None
        slide = switching.mode if switching.mode in self.modes else edge.to
        side, away = ("positive", 1) if edge.to == switching.positive else ("negative", -1)
        modes = self.modes.index(edge.to), self.modes.index(slide)
        back = "negative" if side == "positive" else "positive"
        rate, other = (self.code.sliding(edge.name).rate(name) for name in (side, back))

        def jump(p: Any, held: Any, t: Any, x: Any) -> Jumped:
            leads = away * rate(p, t, x)
            crosses = leads > 0
            small = 64 * EPS * jnp.abs(other(p, t, x))
            sure = (jnp.abs(leads) > small) & (crosses | (slide != edge.to)) & (not sliding)
            return Jumped(x, x, jnp.where(crosses, *modes), held, jnp.array(1.0), sure, sure)

        return jump

    def _still_held(self, p: Any, mode: Any, done: Jumped, t: Any) -> Any:
        """The contacts held that the jump has left closed: gap and speed zero."""
        if not self.rests.any():
            return done.held

        def closed() -> Any:
            lies, _ = self.lies(p, done.mode, jnp.zeros_like(done.held), t, done.after)
            small = CLOSED * (1.0 + jnp.max(jnp.abs(done.after)))
            left = (jnp.abs(lies[:2]) <= small).all(axis=0)
            return done.held & left & (mode == done.mode)

        return jax.lax.cond(done.held.any(), closed, lambda: done.held)


def _switch(index: Any, branches: Sequence[Any], *operands: Any) -> Any:
    if len(branches) == 1:
        return branches[0](*operands)
    return jax.lax.switch(index, branches, *operands)


def system_of(code: Lowered, slides: bool = False) -> System:
    """The system of a class, kept with its generated code."""
    slides = slides and bool(code.spec.switchings)
    made: System = code.once(("system", slides), lambda: System(code, slides))
    return made
