"""The loop of a run: flow an arc, find what ends it, jump, go on.

The rules are those of ``docs/semantics.md``; numbers in brackets are its rules.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..automaton.markers import TERMINATE
from ..bounds.defect import follows
from ..delay.memory import Memory
from ..delay.pieces import Piece
from ..errors import FlowError, JumpLoopError, StartError
from ..lowering import Contact, Field, Guard, Scene, released
from ..lowering.scene import parted
from ..rules import unit
from ..rules.contacts import CLOSED
from ..rules.guards import GUARD_ROUNDING, NEAR
from ..rules.places import PULLED, RISES
from ..rules.zeros import EPS
from ..segment import Segment
from ..solvers import Solver
from ..solvers.watchful import Watchful
from ..trajectory.accumulation import Accumulation
from ..trajectory.arcs import Arc, TailPart
from ..trajectory.clock import Instant
from ..trajectory.log import Flights
from ..trajectory.plan import PATIENCE, Plan
from ..trajectory.trajectory import Jump, Status
from ..zeno.accumulate import Tail, clear, close, hop
from ..zeno.cycle import CycleLimit
from ..zeno.narrow import seen
from ..zeno.others import apart
from . import clocks, switch, truncate
from .arc import ArcFlow, Flown
from .cycles import Columns, Cycles
from .entry import (
    STARTS_OFF,
    Entry,
    Jumped,
    before_impact,
    beyond_kinks,
    describe,
    enter,
    extent,
    opened,
    signs_at_end,
)
from .knots import pass_knot
from .limits import pass_limit
from .machine import Machine
from .pace import Pace
from .recorder import Recorder
from .watch import Watch

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Numbers, StateVector


#: How runs end behind a jump, in an arc of no length.
LAST_JUMPS = (Status.MAX_JUMPS, Status.TERMINATED)


class Driver:
    """One run; ``mode`` is the one that the last jump, or the start, has led to."""

    entry: Entry
    mode: str
    loop: Machine | None
    came: Callable[[], Jumped]

    def __init__(
        self,
        scene: Scene,
        solver: Solver,
        plan: Plan,
        history: Sequence[Piece] | None = None,
    ) -> None:
        self.model, self.scene = scene, scene.at(plan.t0)
        self.solver, self.plan, self.history = solver, plan, history
        self.watchful = Watchful(solver, plan.watchful, plan.shaken, plan.trusted)
        self.wary = plan.watchful is not None
        self.record = Recorder(plan, scene.contacts)
        self.status: Status | None = None
        self.watch = Watch()
        self.cycles = Cycles(scene.code.beside)
        self.seen = np.zeros(scene.spec.dimension)
        self.steps = 0
        self.jumped = Jumped()
        self.tied: dict[str, int] = {}
        self._ringing = self.spent = frozenset(clock.name for clock in scene.spec.clocks)
        self._struck: set[str] = set()
        self.loop = Machine(self) if solver.whole or solver.asked else None

    @property
    def t(self) -> float:
        """The present time."""
        return self.record.now.t

    @property
    def end(self) -> tuple[float, np.ndarray, str] | None:
        """Time, state and mode to which the run has come, behind its last jump; None if it has not
        left its start."""
        kept, own = self.record.log.kept, self.record.log.own
        last = kept[-1] if kept else None
        if isinstance(last, Flights):
            return last.t1, last.jumps.after[-1], self.mode
        jump = own.get(len(kept) - 1)
        if jump is not None:
            return jump.t, jump.after, self.mode
        return None if last is None else (last.t1, last.last, last.mode)

    def run(self, mode: str, x: StateVector, came: Callable[[], Jumped] | None = None) -> None:
        """From the start to the end of the run; ``came``: what is known of a start that another run
        has led to."""
        if self.history is not None:
            order = self.solver.order
            self.record.memory = Memory(self.scene, self.plan, order, self.history, x)
        base, held = parted(mode)
        self.enter(base, x, came() if came else Jumped(held=held, starting=True))
        try:
            self.go_on()
            if self.status in LAST_JUMPS and self.end is not None:
                _, x, mode = self.end
                self.record.arc(self.own.field(mode), x, x, 0.0, [])
        except KeyboardInterrupt:
            self.status = Status.INTERRUPTED
            self.record.close(self.entry.field)
            after = self.end[1] if self.end is not None else self.entry.x
            if self.record.log.ends_with_jump and np.array_equal(after, self.entry.x):
                self.record.arc(self.entry.field, self.entry.x, self.entry.x, 0.0, [])
        finally:  # nothing refers to itself, so that what is kept of a run goes with the run
            if self.loop is not None:
                self.loop.give_back()
            self.loop, self.came = None, Jumped

    def go_on(self) -> None:
        """Arc after arc until something ends the run."""
        while self.status is None:
            if self.steps >= self.plan.max_steps:
                self.record.close(self.entry.field)
                self.status = Status.MAX_STEPS
            elif self.entry.field.clocks and clocks.at_once(self):
                self.record.arc(self.entry.field, self.entry.x, self.entry.x, 0.0, [])
                clock, t = clocks.due(self, self.entry.field, self.entry.x)
                assert clock is not None
                self.ring(clock, t, self.entry.x)
            elif self.entry.at_once:
                index = self.entry.at_once[0]
                guard = self.entry.field.guards[index]
                if guard.kind != "window":
                    self.record.arc(self.entry.field, self.entry.x, self.entry.x, 0.0, [])
                self.jump(guard, self.entry.x, self.entry.orders[index] == 0)  # carried over it
            else:
                self.flow()

    def enter(self, mode: str, x: StateVector, jumped: Jumped) -> None:
        """Begin an arc, unless the run has ended; the loop looks at its start first where all that
        need be known is the jump that led to it."""
        self.mode = self.scene.name(mode, jumped.held)
        if self.status is None:
            self.look(x)
            field, lean = self.own.field(self.mode), self._lean(jumped)
            there = field.along(self.t, x) if lean else x
            if lean and np.isfinite(there).all():
                self.begin(field, there, lambda: jumped)
            else:
                self.entry = self._entered(mode, x, jumped, self.seen)
                self.jumped = jumped
            self.seen = np.maximum(self.seen, np.abs(x))

    def _lean(self, jumped: Jumped) -> bool:
        """Whether the loop may look at the start of the present mode's arc, and knows enough."""
        more = jumped.limit - self.scene.contacts or jumped.passing is not None
        bears = jumped.starting and jumped.held
        if self.loop is None or more or bears or len(jumped.vanishing) > 1:
            return False
        field, alone = self.own.field(self.mode), self.record.memory is None or jumped.starting
        alone = alone and self.record.now.until(self.plan.t1) > 0
        alone = alone and not (jumped.starting and field.project is not None)
        return alone and self.loop.may(field)

    def _entered(self, mode: str, x: StateVector, jumped: Jumped, seen: StateVector) -> Entry:
        jumped.tied, jumped.spent = self.tied, self.spent
        try:
            return enter(self.scene, self.t, mode, x, jumped, seen, self._off(x))
        except StartError as fault:
            counts = self.cycles.counts() if fault.status == "undecided" else []
            if not counts:
                raise
            names = ", ".join(self.scene.spec.element_names[i] for i in counts)
            raise JumpLoopError(
                f"{str(fault).removesuffix(STARTS_OFF)}; it has been so again and again, ever "
                f"sooner, and each time a reset has changed {names}, which has no limit: leave "
                "that out of the resets (run.jumps has what there is to count)"
            ) from None

    def _off(self, x: StateVector) -> StateVector:
        """What each state may be off, by the tolerances."""
        return self.plan.limit + self.plan.rtol * np.abs(x)

    def reach(self, x: StateVector) -> float:
        """The size of the largest state that the run has seen, this one among them."""
        return float(np.maximum(self.seen, np.abs(x))[: self.scene.spec.flows].max())

    def look(self, x: StateVector) -> None:
        """Let delays see the past from here, where what they see has come to an end, and signals
        be on the piece that begins here."""
        memory = self.record.memory
        if self.scene.until <= self.t:
            self.scene = self.model.at(self.t)
        if memory is not None and memory.due(self.t):
            self.scene = memory.look(self.t, x)

    @property
    def flies(self) -> Solver:
        """What makes steps: the solver, or the one that watches it."""
        return self.watchful if self.wary else self.solver

    @property
    def horizon(self) -> float:
        """How far the present flows hold: to the end of the run, of what delays see, or of the
        pieces of signals."""
        memory = self.record.memory
        return min(self.plan.t1, self.scene.until) if memory is None else memory.until

    @property
    def known(self) -> float:
        """How far flights hold that are not flown again: what delays see there is no guess."""
        memory = self.record.memory
        return self.horizon if memory is None else memory.known

    def until(self, t: float, field: Field, x: StateVector) -> float:
        """A time, or that of a clock of a field that rings before it."""
        return min(t, clocks.due(self, field, x)[1])

    def ring(self, clock: Guard, t: float, x: StateVector) -> None:
        """Carry out the jump of a clock, at its time."""
        self.record.now = Instant(t)
        self.jump(clock, x)

    def flow(self) -> None:
        """Flow an arc, or as many as need no judgement, and carry out the jump that ends it."""
        loop = self.loop if self._declared else None
        if loop is not None and loop.takes():
            loop.fly()
        else:
            self.look_again()

    @property
    def _declared(self) -> bool:
        """Whether the present field is its mode's own (see :meth:`.Scene.field`)."""
        field = self.entry.field
        return field is self.own.field(field.name) or field is self.field

    @property
    def own(self) -> Scene:
        """What the fields of arcs are of: with delays the model, which sees nothing of the past."""
        return self.scene if self.record.memory is None else self.model

    @property
    def field(self) -> Field:
        """The present field; it looks back through the present windows."""
        return self.scene.field(self.entry.field.name)

    def begin(self, field: Field, x: StateVector, came: Callable[[], Jumped]) -> None:
        """Begin an arc at whose start nobody has looked (see :meth:`renew`).

        With delays the field is the model's own, which sees nothing of the past.
        """
        self.entry, self.came, self.mode = Entry(field, x, None, [], []), came, field.name

    def arrive(self, field: Field, x: StateVector, guard: Guard, before: StateVector) -> None:
        """Begin an arc after a jump that needed no judgement."""
        last = self.record.log.kept[-1]
        assert not isinstance(last, TailPart)
        lasted = (last.lengths[-1] if isinstance(last, Flights) else last.length) > 0

        def came() -> Jumped:
            if guard.kind == "contact":
                return Jumped({guard.edge: 1}, series=lasted and self.watch.count > 1)
            if guard.kind == "release":
                return Jumped({released(guard.edge): RISES if lasted else PULLED})
            if guard.kind in ("switch", "leave"):
                return Jumped(switch.vanishing(guard, field))
            own = [g for g in self.field.guards if g.edge == guard.edge and not self.forgets]
            return self._came_by(own[0], before, x) if own else Jumped(used=guard.edge)

        self.begin(field, x, came)

    def look_again(self) -> None:
        """Fly the present arc with all the rules, unless a guard fires before any flow; where some
        are zero at its start, or contacts held, and that is judged now, the loop tries once more.
        """
        judged = self.entry.here is not None or self.record.memory is not None
        field = self.entry.field
        self.renew()
        told = any(self.entry.orders) or self.entry.field is not field
        tries = not judged and self.loop is not None and told
        if not (self.entry.at_once or tries):
            self.flow_arc()

    def renew(self) -> None:
        """Look at the start of the present arc again, with all the rules."""
        entry = self.entry
        if entry.here is not None or not (entry.field.guards or self.record.memory):
            return
        jumped, seen = self.came(), 0.0 * self.seen
        if not jumped.starting:  # what is held there is weighed
            jumped, seen = attrs.evolve(jumped, held=entry.field.held), self.seen
        self.jumped = jumped
        self.entry = self._entered(entry.field.mode, entry.x, jumped, seen)

    def flow_arc(self) -> None:
        """Flow an arc and carry out the jump that ends it."""
        entry, now, memory = self.entry, self.record.now, self.record.memory
        (_, due), until = clocks.due(self, entry.field, entry.x), self.horizon
        flown = ArcFlow(self.scene, self.flies, self.plan, entry, now, min(due, until)).run()
        self.steps += flown.steps
        if memory is not None:
            flown = attrs.evolve(flown, segments=memory.refined(entry.field, now, flown.segments))
            other = memory.confirm(now, flown.length, flown.segments)
            if other is not None:
                self.scene = other
                self.enter(entry.field.mode, entry.x, self.jumped)
                return
        for tau, index, state in flown.grazes:
            record = self.scene.spec.record(state)
            edge = entry.field.guards[index].edge
            self.record.grazings.append(Jump(now.t + tau, self.record.j, edge, record, record))
        fired = None if flown.fired is None else entry.field.guards[flown.fired]
        at_clock = due <= until and not flown.interrupted
        clock, tied = None, False
        if at_clock:
            clock, fired, tied = clocks.rings(self, due, fired, flown)
        by = at_clock and clock is None and fired is None and due < self.plan.t1
        if by or (clock is None and self._passes(fired, flown)):
            self.record.extend(entry.field, entry.x, flown.x, flown.length, flown.segments)
            if by:
                self.passed(flown.length)
                clocks.go_by(self, due, entry.field.along(due, flown.x))
            else:
                self.pass_window(fired, flown.x)
            return
        x = self.record.arc(
            entry.field, entry.x, flown.x, flown.length, flown.segments, flown.carried
        )
        if self.plan.progress is not None:
            self.plan.progress(self.t)
        self.tied = flown.tied
        self.passed(flown.length)
        self.spent |= flown.over
        if clock is not None:
            self.ring(clock, due, x)
        elif fired is None:
            self.status = Status.INTERRUPTED if flown.interrupted else Status.REACHED_END
        else:
            self.record.now = Instant(due) if tied else self.record.now
            self.jump(fired, x, flown.carried)

    def _passes(self, fired: Guard | None, flown: Flown) -> bool:
        """Whether an arc has come to the end of what delays see, and goes on."""
        if fired is not None:
            return fired.kind == "window"
        return self.horizon < self.plan.t1 and not flown.interrupted

    def passed(self, length: float) -> None:
        """Note that an arc has been flown: edges taken before it may be taken again."""
        if length > 0:
            self.spent = frozenset()

    def go_on_through(self, signs: dict[str, int], x: StateVector) -> None:
        """Go on within an arc of the rules' own loop, on other windows of the past.

        ``signs``: by edge the sign of its guard at the end of the last step.
        """
        field, self.spent = self.entry.field, frozenset()
        known = self.came().vanishing if self.record.young else {}
        self.begin(field, x, lambda: Jumped(known, field.held, passing=signs))
        self.seen = np.maximum(self.seen, np.abs(x))

    def pass_window(self, fired: Guard | None, x: StateVector) -> None:
        """Go on within an arc, with another window of the past, or another piece of signals."""
        field, t, memory = self.entry.field, self.t, self.record.memory
        if self.plan.progress is not None:
            self.plan.progress(t)
        if memory is None:
            pass_knot(self, self.scene.until, x)
            return
        signs = signs_at_end(self.entry, t, x, self.reach(x))
        memory.passed(t, x, field, fired.edge if fired else None)
        known = self.jumped.vanishing if self.record.young else {}
        self.enter(field.mode, x, Jumped(known, field.held, passing=signs))

    # -- jumps --------------------------------------------------------------------------

    def jump(self, guard: Guard, x: StateVector, carried: bool = False) -> None:
        """Carry out the jump of a guard that fired; ``carried``: without having been zero."""
        self.tied = {edge: sign for edge, sign in self.tied.items() if edge != guard.edge}
        self.spent |= {guard.edge} | clocks.failing(self, x)
        if guard.kind == "contact":
            self._impact(guard, x)
        elif guard.kind == "release":
            self._release(guard, x, carried)
        elif guard.kind == "switch":
            switch.meet(self, guard, x)
        elif guard.kind == "leave":
            switch.leave(self, guard, x)
        elif guard.kind == "window":
            self.pass_window(guard, x)
        else:
            self._reset(guard, x, carried)

    def _reset(self, guard: Guard, before: StateVector, carried: bool) -> None:
        t = self.t
        after = np.array(self.scene.reset(guard.edge)(t, before.tolist()))
        self._require_finite(guard.edge, before, after)
        came = self._came_by(guard, before, after)
        if carried or self.forgets or self._has_jumped(guard, before):
            came.vanishing = {}
        came.held = self._still_held(guard.to, after)
        self.watch.reset()
        if guard.to == TERMINATE:
            self.add_jump(guard.edge, before, after)
            self.status, self.mode = Status.TERMINATED, self.entry.field.mode
            return
        if not (self.add_jump(guard.edge, before, after) and pass_limit(self, guard.to)):
            self.enter(guard.to, after, came)

    def _came_by(self, guard: Guard, before: StateVector, after: StateVector) -> Jumped:
        """What is known of a state from the reset that led to it: whether that leaves the guard
        where it is, and some of its motion, which it does not turn round."""
        here, there = (guard.lie(self.t, x.tolist()) for x in (before, after))
        onwards = here[1] * there[1] > 64 * EPS * here[1] * here[1]
        beyond = guard.urgent and self._has_jumped(guard, before)
        known = {guard.edge: 1} if here[0] == there[0] and not beyond else {}
        return Jumped(known, used=guard.edge, onwards=bool(onwards))

    def _has_jumped(self, guard: Guard, x: StateVector) -> bool:
        """Whether a guard that fired is not zero: it may jump up from zero there, as a saw does, or
        be urgent."""
        if not (guard.jumps or guard.urgent):
            return False
        size = self.scene.rounding(guard, self.entry.field)(self.t, x.tolist())[0]
        return bool(abs(guard.value(self.t, x.tolist())) > NEAR * size)

    @property
    def forgets(self) -> bool:
        """Whether a jump changes what delays see, and with it flows and guards at once."""
        return self.record.memory is not None and self.plan.memory == "restart"

    def _release(self, guard: Guard, x: StateVector, carried: bool) -> None:
        field = self.entry.field
        overdue = carried or bool(self.entry.at_once)  # the load is negative, not zero
        contact = released(guard.edge)
        self.record.released(contact, self.t)
        self.watch.reset()
        self.add_jump(guard.edge, x, x)
        known = {contact: PULLED if overdue or self.forgets else RISES}
        if carried and opened(self.scene, field.mode, contact, self.t, x):
            known = {}
        held = tuple(name for name in field.held if name != contact)
        self.enter(field.mode, x, Jumped(known, held))

    def _impact(self, guard: Guard, x: StateVector) -> None:
        contact = self.scene.contact(guard.edge)
        before = np.array(contact.land(self.t, x.tolist()))
        self.record.end_on(before)
        self._require_one_speed(guard, before)
        *state, speed = contact.impact(self.t, before.tolist())
        after = np.array(state)
        self._require_finite(guard.edge, before, after)
        if speed < 0:
            raise FlowError(
                f"{self.where(before)}: the restitution of {guard.edge} gives the speed "
                f"{speed:.6g} after the impact; it must not be negative"
            )
        self.bounce(guard, before, after, speed)

    def _require_one_speed(self, guard: Guard, x: StateVector) -> None:
        """Refuse a gap whose formula at zero is not that of the side from which it is reached.

        The first impact of a contact shows it. Where the gap has a corner at zero, as a distance
        has, that is asked again wherever a flight may have come from the other side.
        """
        field, t = self.entry.field, self.t
        there = self.scene.field(field.name, (guard.edge,))
        if not guard.kinks or (there is field and guard.edge in self._struck):
            return
        self._struck.add(guard.edge)
        back, beside = before_impact(self.scene, field, guard, t, x)
        came = guard.lie(back, beside.tolist())[1]
        _, here, bend = there.guards[field.column(guard.edge)].lie(t, x.tolist())
        if not abs(here - came) <= NEAR * abs(came) + 2.0 * abs(bend) * (t - back):
            raise FlowError(
                f"{self.where(x)}: the gap of {guard.edge} changes its formula where it is zero: "
                f"its speed there is {here:.6g}, and was {came:.6g} just before; write the formula "
                "that holds where the gap is positive"
            )

    def bounce(self, guard: Guard, before: StateVector, after: StateVector, speed: float) -> None:
        """Record an impact and those after low flights, then begin the next arc."""
        while True:
            held = self._still_held(guard.to, after)
            after = self._closed(guard.to, held, after)
            self.watch.saw(guard.edge)
            due = self.add_jump(guard.edge, before, after)
            self.mode = self.scene.name(guard.to, held)
            contact = self.scene.contact(guard.edge)
            if self.status is not None or self._accumulate(contact, after, speed, guard.to, held):
                return
            if due and pass_limit(self, guard.to):
                return
            hop = self.hop(contact, after, speed, self.scene.name(guard.to, held))
            if hop is None:
                break
            before, after, speed = hop
        known, last = {guard.edge: 1 if speed > 0 else 2}, self.record.log.kept[-1]
        series = self.watch.count > 1 and isinstance(last, Arc) and last.length > 0
        self.enter(guard.to, after, Jumped(known, held, series=series))

    def _require_series(self, contact: str, x: StateVector, field: Field) -> None:
        """Refuse to go on by impacts that have no sum because their flow has no series."""
        if field.jets is None and self.watch.count > 1:
            raise JumpLoopError(
                f"{self.where(x)}: the impacts of {contact} accumulate, and cannot be summed: "
                f"{field.refused}; near the contact it must be a smooth function of a few numbers"
            )

    def _require_apart(self, x: StateVector) -> None:
        """Refuse to go on where accumulations accumulate in turn: no sum of sums is made.

        Impacts go on until rounding holds the contact, or keeps it from that; an edge's guard that
        rounding hides is passed over.
        """
        impacts = self.scene.contacts.intersection(self.record.zeno[-1].edges)
        t = self.record.stalls() if impacts else self.record.heaps()
        if t is not None:
            edges = ", ".join(self.record.latest())
            raise JumpLoopError(
                f"{self.where(x)}: the accumulations of {edges} accumulate in turn, about at "
                f"t = {t:.8g}, and what is beyond is not known; end the run before that, or at "
                f"the first accumulation with zeno='stop'"
            )

    def hop(
        self, contact: Contact, x: StateVector, v: float, name: str
    ) -> tuple[np.ndarray, np.ndarray, float] | None:
        """A flight so low that the gap would drown in the rounding of the state (7).

        It is flown by its series, in which gap and gap speed are coordinates of their own.
        Returns the states before and after the next impact and the gap's speed; None where
        the flight is higher, or another guard comes near.
        """
        field, t, reach = self.scene.field(name, (contact.name,)), self.t, self.reach(x)
        column = field.column(contact.name)
        guard = field.guards[column]
        if field.hurried:
            return None
        there = beyond_kinks(field, (*guard.kinks, *field.changes), t, x)
        force = guard.lie(there[0], there[1].tolist())[2]
        if not unit("hops").drowns(v, force, reach):
            return None
        if unit("hops").drowns(v, force, NEAR * reach):  # a dozen digits of the gap are rounding
            self._require_series(contact.name, x, field)
        flown = hop(field, contact, column, t, x, v, GUARD_ROUNDING * EPS * reach)
        until = self.until(self.known, field, x)
        if flown is None or self.record.now.after(flown[0]).until(until) < 0:
            return None
        time, segments, before, after, speed = flown
        if self.wary and not follows(field, t, segments):
            return None
        self.record.arc(field, x, before, time, segments)
        self.entry = Entry(field, before, None, [], [])
        return before, after, speed

    def add_jump(self, edge: str, before: StateVector, after: StateVector) -> bool:
        """Record a jump, at ``max_jumps`` the last; whether it is time to look for cycles."""
        memory = self.record.memory
        if memory is not None and memory.ends(self.t):
            memory.passed(self.t, before, self.entry.field)
        now, field, last = self.record.now, self.entry.field, self.record.log.kept[-1]
        guard = next((guard for guard in field.guards if guard.edge == edge), None)
        clock = now.t - self.cycles.spent
        if isinstance(last, Arc) and guard is not None:
            clock = self.cycles.clock(self.scene, field, guard, last.t0, last.first, last.length)
        self.record.jump(edge, before, after, self.where, clock)
        self.look(after)
        if self.record.made >= self.plan.max_jumps:
            self.status = Status.MAX_JUMPS
        return self.note(Columns.of(edge, field.name, now.t, now.low, clock, after))

    def note(self, jumps: Columns) -> bool:
        """Note jumps; whether it is time to look for cycles. Behind a clock they begin anew."""
        if jumps.edge[-1] in self._ringing:
            self.cycles.forget()
            return False
        return self.cycles.saw(jumps)

    def room(self, t: Numbers, low: Numbers, rung: Integers) -> int:
        """Of jumps at these times, how many there are before the run has to be looked at.

        ``rung``: the places of those that clocks have made; no limit is before the last of them.
        """
        ignored = self.plan.zeno == "ignore"  # no limit is gone over, wherever it may be
        before = int(rung[-1]) + 1 if len(rung) else 0
        most = len(t) if ignored else before or self.cycles.room(t, low)
        return min(self.plan.max_jumps - self.record.made, most)

    def flown(self, flights: Flights) -> bool:
        """Record jumps that needed no judgement, no more than there was room for."""
        jumps = flights.jumps

        def where(k: int) -> str:
            field = self.scene.field(flights.modes[k])
            return describe(self.scene, field, float(jumps.t[k]), jumps.before[k])

        clocks = self._clocks(flights)
        self.record.flights(flights, where, clocks)
        lengths = flights.lengths.tolist()
        last = next((k for k in range(len(lengths) - 1, 0, -1) if lengths[k]), 0)
        self.passed(lengths[last])
        self.spent = self.spent.union(jumps.edge[last:])
        self.seen = np.maximum(self.seen, np.maximum.reduce(np.abs(jumps.after)))
        memory = self.record.memory
        if memory is not None and memory.ends(self.t):
            memory.passed(self.t, jumps.before[-1], self.own.field(flights.mode))
        self.look(jumps.after[-1])
        if self.record.made >= self.plan.max_jumps:
            self.status = Status.MAX_JUMPS
        times = jumps.t, jumps.low, clocks
        return self.note(Columns(jumps.edge, flights.modes, *times, jumps.after))

    def _clocks(self, flights: Flights) -> Numbers:
        """The time without idle flights, at each of some jumps."""
        if self.cycles.plain(flights.lengths):
            return flights.jumps.t - self.cycles.spent
        jumps, clocks = flights.jumps, []
        times, states = [flights.t, *jumps.t.tolist()], [flights.x, *jumps.after]
        lengths = flights.lengths.tolist()
        for mode, edge, *start in zip(
            flights.modes, jumps.edge, times, states, lengths, strict=False
        ):
            memory, scene = self.record.memory, self.scene.at(start[0])
            if memory is not None:
                with memory.as_at(*start[:2]) as then:
                    scene = then.scene
            field = scene.field(mode)
            guard = field.guard(edge)
            clocks.append(self.cycles.clock(scene, field, guard, *start))
        return np.array(clocks)

    def watch_pace(self) -> None:
        """Watch the steps of the arc that begins here, which is flown many steps at a time."""
        self.pace = Pace(self.field, self.t, self.record.now.until(self.plan.t1))

    def count_steps(self, tau: float, x: StateVector, count: int) -> None:
        """Count steps of that arc, which have led to a state."""
        try:
            self.pace.steps(tau, x, count)
        except FlowError as fault:
            where = describe(self.scene, self.entry.field, self.t + tau, x)
            raise FlowError(f"{where}: {fault}") from None

    def where(self, x: StateVector) -> str:
        """Model, mode, time and state, for messages."""
        return describe(self.scene, self.entry.field, self.t, x)

    def _still_held(self, mode: str, x: StateVector) -> tuple[str, ...]:
        """The contacts held at present that a jump has left closed: gap and speed zero."""
        if mode != self.entry.field.mode or not self.entry.field.held:
            return ()
        field, held = self.scene.field(mode), []
        for guard in field.guards:
            if guard.edge in self.entry.field.held:
                gap, speed, _ = guard.lie(self.t, x.tolist())
                high, fast, _ = extent(self.scene, guard, field, self.t, x, self.seen)
                if abs(gap) <= CLOSED * high and abs(speed) <= CLOSED * fast:
                    held.append(guard.edge)
        return tuple(held)

    def _closed(self, mode: str, held: tuple[str, ...], x: StateVector) -> StateVector:
        """The state with gap and speed of the contacts held at exactly zero."""
        return self.scene.field(self.scene.name(mode, held)).along(self.t, x)

    def _require_finite(self, edge: str, before: StateVector, after: StateVector) -> None:
        if not np.isfinite(after).all():
            state = self.scene.spec.record(after)
            raise FlowError(f"{self.where(before)}: the reset of {edge} gives {state}")

    # -- accumulations ------------------------------------------------------------------

    def _accumulate(
        self, contact: Contact, x: StateVector, v: float, mode: str, held: tuple[str, ...]
    ) -> bool:
        """Sum the impacts from here on, or cut them off; False if the run goes on as it was."""
        name, watch = self.scene.name(mode, held), self.watch
        field = self.scene.field(name, (contact.name,))
        if self.plan.zeno == "truncate":
            return truncate.hold(self, contact, x, field)
        if field.hurried or watch.count < self.plan.patience or not 0 < v <= PATIENCE * watch.tried:
            return False
        watch.tried = v
        tail, until = self.tail(contact, x, v, field), self.until(self.horizon, field, x)
        if tail is None or self.record.now.after(tail.remaining).until(until) < 0:
            return False
        memory = self.record.memory
        if memory is not None and not memory.stays(TailPart(tail, self.record.j)):
            return False
        self.pass_sum(tail)
        return True

    def tail(self, contact: Contact, x: StateVector, v: float, field: Field) -> Tail | None:
        """The sum of all impacts from here on; None where there is none (yet).

        Where something may hide on the way to the limit, steps are watched until a sum is found.
        """
        column, now, plan = field.column(contact.name), self.record.now, self.plan
        rtol, atol = plan.closing * plan.rtol, plan.closing * plan.limit
        tail = close(field, contact, column, now.t, now.low, x, v, rtol, atol)
        if tail is None or not (clear(tail, field, column) and apart(tail)):
            return None
        whole = seen(tail, plan.closing)
        self.wary |= not whole
        return tail if whole else None

    def pass_sum(self, tail: Tail, at_rest: StateVector | None = None) -> None:
        """Go over an accumulation point, into what follows it.

        ``at_rest``: the state there, on the contacts held, where nobody need look at it.
        """
        contact, record, part = tail.contact, self.record, TailPart(tail, self.record.j)
        record.keep(part)
        record.j += tail.count
        record.now = record.now.after(tail.remaining)
        self.tied, self.spent = {}, frozenset((contact.name,))
        held = (*tail.field.held, contact.name)
        after = (tail.field.mode, held) if contact.rests else None
        self.wary = self.plan.watchful is not None
        self._go_on_from(tail, (contact.name,), tail.r, after, at_rest)

    def pass_cycle(self, found: CycleLimit, x: StateVector, mode: str) -> None:
        """Go over the limit of a cycle, which the last jump led on towards from ``x`` in a mode.

        The part between them is kept as a straight line.
        """
        record, held = self.record, self._still_held(mode, x)
        straight = np.array([[0.5, 0.5], [-0.5, 0.5]]) @ np.array([x, found.x_inf])
        segments = [Segment(0.0, found.remaining, straight)] if found.remaining else []
        field = self.scene.field(self.scene.name(mode, held))
        record.arc(field, x, found.x_inf, found.remaining, segments)
        if not found.remaining:  # impacts at one instant may have opened others
            held = self._still_held(mode, found.x_inf)
        after = self._after(found.edges, held)
        if after is not None and not np.isfinite(self._closed(*after, found.x_inf)).all():
            after = None  # contacts that close on a body from both sides leave it no rest
        self._go_on_from(found, found.edges, found.ratio, after)

    def _after(
        self, cycle: tuple[str, ...], held: tuple[str, ...]
    ) -> tuple[str, tuple[str, ...]] | None:
        """What follows a cycle: the mode that its author names, or the rest of its contacts, beside
        which there may be events, which bound nothing."""
        spec = self.scene.spec
        named = spec.mode_after(cycle)
        if named is not None:
            return named.name, ()
        edges = [e for e in spec.transitions if e.name in cycle]
        contacts = [e for e in edges if getattr(e, "rests", False)]
        events = sum(not self.scene.code.bounds(e, self.scene.values) for e in edges)
        if len(contacts) + events < len(edges) or len({e.to for e in contacts}) != 1:
            return None
        return contacts[0].to, (*held, *(e.name for e in contacts))

    def _go_on_from(
        self,
        limit: Tail | CycleLimit,
        edges: tuple[str, ...],
        ratio: float,
        after: tuple[str, tuple[str, ...]] | None,
        at_rest: StateVector | None = None,
    ) -> None:
        """From an accumulation into what follows it: a mode, and the contacts held there."""
        record, zeno = self.record, self.plan.zeno
        rest = self.scene.name(*after) if after and zeno == "rest" else None
        state = self.scene.spec.record(limit.x_inf)
        point = Accumulation(self.t, state, ratio, edges, "estimated", rest, record.j)
        if isinstance(limit, Tail):
            point._proofs, point._since = limit.prove, self.cycles.first_of(limit.contact.name)
        else:
            named = ((edge, self.scene.spec.record(x)) for edge, x in limit.limits)
            point.limits = tuple(named)
        record.limit_point(point, limit)
        self._require_apart(limit.x_inf)
        self.watch.reset()
        self.cycles.forget()
        if rest is None:
            self.status = Status.NO_REST if zeno == "rest" else Status.ZENO_STOPPED
        elif len(record.zeno) == self.plan.accumulations:
            self.status = Status.ZENO_STOPPED
        if after and at_rest is not None:
            self.begin(self.own.field(self.scene.name(*after)), at_rest, Jumped)
            self.seen = np.maximum(self.seen, np.abs(limit.x_inf))
        elif after:
            self.enter(after[0], limit.x_inf, Jumped(held=after[1], limit=frozenset(edges)))
