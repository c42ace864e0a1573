"""The outer loop of a run: flow an arc, find the event that ends it, jump, repeat.

Most arcs and jumps are made by the compiled rules, through :class:`.Machine`. What they hand back
is decided here. Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..delay.memory import Memory
from ..delay.pieces import Piece, slack_of
from ..errors import FlowError, JumpLoopError, StartError
from ..lowering import Field, Guard, Scene, released
from ..lowering.scene import parted
from ..rules.contacts import CLOSED, STRAYS
from ..rules.guards import GUARD_ROUNDING, TIE
from ..rules.places import PULLED, RISES
from ..rules.ties import FURTHEST_APART
from ..rules.zeros import EPS
from ..solvers import Solver
from ..solvers.watchful import Watchful
from ..trajectory.arcs import TailPart
from ..trajectory.clock import Instant
from ..trajectory.log import Flights
from ..trajectory.plan import Plan
from ..trajectory.trajectory import Jump, Status
from . import clocks, jumps, switch
from .accumulations import settled
from .arc import ArcFlow, Flown
from .cycles import Cycles
from .entry import STARTS_OFF, Entry, Jumped, Place, describe, enter, extent, signs_at_end
from .knots import fires_at, let_go, pass_knot, taken, turned
from .losses import Losses
from .machine import Machine
from .pace import Pace
from .recorder import Recorder
from .watch import Watch

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector


#: Reasons for which a run ends right after a jump; its last arc then has no length.
LAST_JUMPS = (Status.MAX_JUMPS, Status.TERMINATED)


class Driver:
    """One run.

    ``mode`` names the mode after the last jump (at first, the initial mode) and its held contacts.
    """

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
        self.asked = plan
        self.watchful = Watchful(solver, plan.watchful, plan.shaken, plan.trusted)
        self.wary = plan.watchful is not None
        self.record = Recorder(plan, scene.contacts)
        self.status: Status | None = None
        self.watch = Watch()
        self.cycles = Cycles(scene.code.beside)
        self.seen = np.zeros(scene.spec.dimension)
        self.losses = Losses(plan, solver.whole, self.seen)
        self._hidden: list[tuple[float, StateVector]] = []
        self.steps = 0
        self.jumped, self.beyond_by = Jumped(), 0.0
        self.tied: dict[str, int] = {}
        self.touched: dict[str, int] = {}
        self.ringing = self.spent = frozenset(clock.name for clock in scene.spec.clocks)
        self.struck: set[str] = set()
        self.loop = Machine(self) if solver.whole or solver.asked else None

    @property
    def t(self) -> float:
        """The current time."""
        return self.record.now.t

    @property
    def end(self) -> tuple[float, np.ndarray, str] | None:
        """Time, state and mode that the run has reached, after its last jump; None at the start."""
        kept, own = self.record.log.kept, self.record.log.own
        last = kept[-1] if kept else None
        if isinstance(last, Flights):
            return last.t1, last.jumps.after[-1], self.mode
        jump = own.get(len(kept) - 1)
        if jump is not None:
            return jump.t, jump.after, self.mode
        return None if last is None else (last.t1, last.last, last.mode)

    @property
    def since(self) -> float:
        """The time up to which the run is recorded; at first its start."""
        return self.plan.t0 if self.end is None else self.end[0]

    @property
    def place(self) -> Place:
        """Where guards are asked whether they are off zero."""
        return Place(self.t, self.record.since, self.seen)

    def run(self, mode: str, x: StateVector, came: Callable[[], Jumped] | None = None) -> None:
        """Run from the start to the end.

        ``came`` says how the start was reached, where it continues another run.
        """
        if self.history is not None:
            order = self.solver.order
            known = self.scene, self.plan, order, self.history, x
            self.record.memory = Memory(*known, lambda: parted(self.mode)[0])
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
        finally:  # break reference cycles, so that a run is freed with its trajectory
            if self.loop is not None:
                self.loop.give_back()
            self.loop, self.came = None, Jumped

    def go_on(self) -> None:
        """Flow arc after arc until something ends the run."""
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
                carried, self.beyond_by = self.entry.orders[index] == 0, 0.0  # over zero
                self.jump(guard, self.entry.x, carried)
            else:
                self.flow()

    def enter(self, mode: str, x: StateVector, jumped: Jumped) -> None:
        """Begin an arc, unless the run has ended.

        The compiled loop examines the start itself where the last jump is all it needs to know.
        """
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
                settled(self, field, x, jumped)
            self._see(x)

    def _see(self, x: StateVector) -> None:
        """Add a state to the largest seen."""
        self.seen = self.losses.seen = np.maximum(self.seen, np.abs(x))

    def _lean(self, jumped: Jumped) -> bool:
        """Whether the compiled loop knows enough to examine the start of the next arc."""
        more = jumped.limit - self.scene.contacts or jumped.passing is not None
        bears = jumped.starting and jumped.held
        if self.loop is None or more or bears or len(jumped.vanishing) > 1:
            return False
        field, alone = self.own.field(self.mode), self.record.memory is None or jumped.starting
        alone = alone and self.record.now.until(min(self.plan.t1, self.scene.until)) > 0
        alone = alone and not (jumped.starting and field.project is not None)
        return alone and self.loop.may(field)

    def _entered(self, mode: str, x: StateVector, jumped: Jumped, seen: StateVector) -> Entry:
        jumped.tied, jumped.touched, jumped.spent = self.tied, self.touched, self.spent
        jumped.close = self._close(self.scene.field(self.scene.name(mode, jumped.held)), x)
        try:
            return enter(self.scene, self.t, mode, x, jumped, seen, self._off(x))
        except StartError as fault:
            if fault.status != "undecided":
                raise
            # what has happened at this time, or lately beside impacts that come to rest, and stays
            # zero, does not happen again
            lately, counts = self.cycles.latest, self.cycles.counts()
            past = self.spent | (lately if lately & self.scene.contacts else frozenset())
            if not counts:
                if past <= jumped.limit:
                    raise
                jumped = attrs.evolve(jumped, limit=jumped.limit | past)
                return enter(self.scene, self.t, mode, x, jumped, seen, self._off(x))
            names = ", ".join(self.scene.spec.element_names[i] for i in counts)
            raise JumpLoopError(
                f"{str(fault).removesuffix(STARTS_OFF)}; it has been so again and again, ever "
                f"sooner, and each time a reset has changed {names}, which has no limit: leave "
                "that out of the resets (run.jumps has what there is to count)"
            ) from None

    def _close(self, field: Field, x: StateVector) -> frozenset[str]:
        """Edges whose guards were zero with the one that has fired, and still are, but for what
        the solver's steps have lost."""
        hide, t, found = self.losses.hide, self.t, []
        for guard in field.guards if self.losses.tolerances else ():
            if guard.edge in self.tied:
                hides = hide(self.scene, field, guard, t, x, 0.0)
                if abs(guard.value(t, x.tolist())) <= hides:
                    found.append(guard.edge)
        return frozenset(found)

    def _off(self, x: StateVector) -> StateVector:
        """The error that the tolerances allow in each component of the state."""
        return self.plan.limit + self.plan.rtol * np.abs(x)

    def reach(self, x: StateVector) -> float:
        """The largest absolute state component so far, including those of ``x``."""
        return float(np.maximum(self.seen, np.abs(x))[: self.scene.spec.flows].max())

    def look(self, x: StateVector) -> None:
        """Advance the windows of the past and the pieces of signals to the current time, if due. At
        a knot the signals stay on the piece that leads there, until the run passes the knot."""
        memory = self.record.memory
        if self.scene.until < self.t:
            self.scene = self.model.at(float(np.nextafter(self.t, -np.inf)))
        if memory is not None and memory.due(self.t):
            self.scene = memory.look(self.t, x)

    @property
    def flies(self) -> Solver:
        """The solver that makes steps; where steps are watched, the one that also checks them."""
        return self.watchful if self.wary else self.solver

    @property
    def horizon(self) -> float:
        """The time until which the current flow is valid: the end of the run, of the windows of the
        past, or of the pieces of signals."""
        memory = self.record.memory
        return min(self.plan.t1, self.scene.until) if memory is None else memory.until

    def horizon_before(self, due: float) -> float:
        """The end of the next arc at the latest: the next ring of a clock, which is ``due``, or the
        horizon (:func:`hybrid.rules.clocks.last_ring`)."""
        until = self.horizon
        last = min(self.plan.t1, until + slack_of(until)) if until < self.plan.t1 else until
        return due if due <= last else until

    @property
    def known(self) -> float:
        """The time until which the windows of the past are known rather than guessed."""
        memory = self.record.memory
        return self.horizon if memory is None else memory.known

    def until(self, t: float, field: Field, x: StateVector) -> float:
        """The earlier of a time and the next ring of a clock."""
        return min(t, clocks.due(self, field, x)[1])

    def ring(self, clock: Guard, t: float, x: StateVector) -> None:
        """Carry out the jump of a clock at its exact time."""
        self.record.now = Instant(t)
        self.jump(clock, x)

    def flow(self) -> None:
        """Flow an arc and make the jump that ends it; the compiled loop makes many at once."""
        loop = self.loop if self._declared else None
        if loop is not None and loop.takes():
            loop.fly()
        else:
            self.look_again()

    @property
    def _declared(self) -> bool:
        """Whether the current field is the one its mode declares (see :meth:`.Scene.field`)."""
        field = self.entry.field
        return field is self.own.field(field.name) or field is self.field

    @property
    def own(self) -> Scene:
        """The scene whose fields name arcs: with delays the model itself, without its past."""
        return self.scene if self.record.memory is None else self.model

    @property
    def field(self) -> Field:
        """The current field, reading the past through the current windows."""
        return self.scene.field(self.entry.field.name)

    def begin(self, field: Field, x: StateVector, came: Callable[[], Jumped]) -> None:
        """Begin an arc without examining its start; :meth:`renew` does so when it is needed.

        With delays ``field`` is the model's own, without its past.
        """
        self.entry, self.came, self.mode = Entry(field, x, None, [], []), came, field.name

    def arrive(
        self,
        field: Field,
        x: StateVector,
        guard: Guard,
        before: StateVector,
        beyond_by: float | None = None,
    ) -> None:
        """Begin an arc after a jump that the compiled loop has made; ``beyond_by``: how far beyond
        zero the guard of an edge has jumped, if it is not zero where it has kept its value."""
        last = self.record.log.kept[-1]
        assert not isinstance(last, TailPart)
        lasted = (last.lengths[-1] if isinstance(last, Flights) else last.length) > 0

        def came() -> Jumped:
            if guard.kind == "contact":
                leaves = self.leaves(guard.edge, field.name, x)
                return Jumped(leaves, series=lasted and self.watch.count > 1)
            if guard.kind == "release":
                return Jumped({released(guard.edge): RISES if lasted else PULLED})
            if guard.kind in ("switch", "leave"):
                return Jumped(switch.vanishing(guard, field))
            own = [g for g in self.field.guards if g.edge == guard.edge]
            if not own:
                return Jumped(used=guard.edge)
            vanishes, self.beyond_by = beyond_by is None, beyond_by or 0.0
            come = jumps.came_by(self, own[0], before, x, carried=not vanishes)
            known = vanishes and not self.forgets
            return come if known else attrs.evolve(come, vanishing={})

        self.begin(field, x, came)

    def look_again(self) -> None:
        """Examine the start of the current arc with all the rules, then flow it here.

        It is not flown here if a guard fires at once, nor if the examination found guards at zero
        or contacts at rest: with that known, the compiled loop tries once more.
        """
        judged = self.entry.here is not None or self.record.memory is not None
        field = self.entry.field
        self.renew()
        told = any(self.entry.orders) or self.entry.field is not field
        tries = not judged and self.loop is not None and told
        if self.status is None and not (self.entry.at_once or tries):
            self.flow_arc()

    def renew(self) -> None:
        """Examine the start of the current arc with all the rules."""
        entry = self.entry
        if entry.here is not None or not (entry.field.guards or self.record.memory):
            return
        jumped, seen = self.came(), 0.0 * self.seen
        if not jumped.starting:  # what is held there is weighed
            jumped, seen = attrs.evolve(jumped, held=entry.field.held), self.seen
        self.jumped = jumped
        self.entry = self._entered(entry.field.mode, entry.x, jumped, seen)
        settled(self, entry.field, entry.x, jumped)

    def flow_arc(self) -> None:
        """Flow an arc step by step and carry out the jump that ends it."""
        field, clock, tied = self.entry.field, None, False
        _, due = clocks.due(self, field, self.entry.x)
        until = self.horizon_before(due)
        flown = self._flown(until)
        if flown is None:
            return
        fired = None if flown.fired is None else field.guards[flown.fired]
        if flown.stands:
            self.stand(flown)
            return
        at_clock = due == until and not flown.interrupted
        if at_clock:
            flown = self._gather(flown, due)
            x = self._up_to(flown, due)
            clock, fired, tied = clocks.rings(self, due, fired, flown, x)
            flown = attrs.evolve(flown, x=x) if clock is not None or tied else flown
        if at_clock and clock is None and fired is None and due < self.plan.t1:
            self._extend(flown)
            clocks.go_by(self, due, field.at_end(due, flown.x))
            return
        if clock is None and fired is not None and self._waits(fired, flown):
            fired = None
        if clock is None and self._passes(fired, flown):
            end = self._extend(flown)
            self.pass_window(fired, end if field.leans else flown.x)
            return
        x = self._end(flown)
        if clock is not None:
            self.ring(clock, due, x)
        elif fired is None:
            self.status = Status.INTERRUPTED if flown.interrupted else Status.REACHED_END
        else:
            self.record.now = Instant(due) if tied else self.record.now
            self.beyond_by = flown.beyond_by
            self.jump(fired, x, flown.carried)

    def _flown(self, until: float) -> Flown | None:
        """Flow an arc until a time at the latest; None if the windows of the past were guessed
        wrong, and the arc begins anew with others."""
        entry, now, memory, jumped = self.entry, self.record.now, self.record.memory, self.jumped
        self.losses.seen = self.seen
        known = (self.scene, self.flies, self.plan, entry, now, until, self.losses)
        flown = ArcFlow(*known, jumped.used if jumped.beyond_by else None, jumped.spent).run()
        self.steps += flown.steps
        if memory is not None:
            flown = attrs.evolve(flown, segments=memory.refined(entry.field, now, flown.segments))
            other = memory.confirm(now, flown.length, flown.segments)
            if other is not None:
                self.scene = other
                self.enter(entry.field.mode, entry.x, self.jumped)
                return None
        for tau, index, state in flown.grazes:
            record = self.scene.spec.record(state)
            edge = entry.field.guards[index].edge
            self.record.grazings.append(Jump(now.t + tau, self.record.j, edge, record, record))
        return flown

    def stand(self, flown: Flown) -> None:
        """Continue an arc at a standstill."""
        field, known = self.entry.field, self.vanishing
        signs = signs_at_end(self.entry, self.t + flown.length, flown.x, self.reach(flown.x))
        self._extend(flown)
        self.enter(field.mode, flown.x, Jumped(known, field.held, passing=signs))

    def _extend(self, flown: Flown) -> StateVector:
        """Record a part of an arc that goes on; returns the state at its end."""
        known = self.entry.field, self.entry.x, flown.x
        end = self.record.extend(*known, flown.length, flown.segments)
        self.passed(flown.length)
        return end

    def _end(self, flown: Flown) -> StateVector:
        """Record an arc, and what was zero where it ends; returns the state there."""
        known = self.entry.field, self.entry.x, flown.x
        x = self.record.arc(*known, flown.length, flown.segments, flown.carried)
        if self.plan.progress is not None:
            self.plan.progress(self.t)
        self.tied, self.touched = flown.tied, flown.touched
        self.passed(flown.length)
        self.spent |= flown.over
        return x

    def hides(self, until: float, off: StateVector) -> None:
        """Note by how much the state may be off up to a time, as rounding has brought a body to
        rest too soon."""
        self._hidden = [(end, own) for end, own in self._hidden if end >= self.t]
        self._hidden.append((until, off))

    def hidden(self) -> list[StateVector]:
        """By how much the state may be off now, for each body that has come to rest too soon."""
        return [off for until, off in self._hidden if self.t <= until]

    def _up_to(self, flown: Flown, due: float) -> StateVector:
        """The state in which a clock rings, after an arc that may end a little before, where a
        guard is zero but for rounding: by a step of the midpoint rule."""
        end, rhs, x = self.record.now.after(flown.length), self.field.rhs, flown.x
        left = end.until(due)
        if not left > 0.0:
            return x
        middle = x + 0.5 * left * np.array(rhs(end.t, x.tolist()))
        return x + left * np.array(rhs(end.t + 0.5 * left, middle.tolist()))

    def _gather(self, flown: Flown, due: float) -> Flown:
        """An arc that ends where a clock rings, with all guards that are zero there, but for what
        the steps have lost, at zero or beyond it."""
        field, edges = self.entry.field, self.entry.field.guards
        if flown.fired is not None:
            return flown
        near = self.losses.near(self.scene, field, due, flown.x, flown.length)
        _, x = self.losses.beyond(field, near, due, flown.x, 0.0)
        return attrs.evolve(flown, x=x, tied={edges[i].edge: -way for i, way in near.items()})

    def _waits(self, fired: Guard, flown: Flown) -> bool:
        """Whether what holds the state comes to zero just where windows of the past, or the piece
        of a signal, end (:func:`hybrid.rules.arcs.waits`)."""
        t, rounded = self.horizon, GUARD_ROUNDING * np.spacing(abs(self.horizon))
        held = fired.kind in ("release", "leave") and not flown.carried
        if not held or t >= self.plan.t1 or self.record.now.until(t) - flown.length > rounded:
            return False
        size, rate, _ = self.scene.rounding(fired, self.entry.field)(t, flown.x.tolist())
        hides = GUARD_ROUNDING * EPS * (size + abs(t) * rate)
        return abs(fired.value(t, flown.x.tolist())) <= hides

    def _passes(self, fired: Guard | None, flown: Flown) -> bool:
        """Whether an arc has only reached the end of a window of the past, and goes on."""
        if fired is not None:
            return fired.kind == "window"
        return self.horizon < self.plan.t1 and not flown.interrupted

    @property
    def vanishing(self) -> dict[str, int]:
        """By edge, the power by which its guard vanishes where the current arc has just begun."""
        came = self.came() if self.entry.here is None else self.jumped
        return came.vanishing if self.record.young else {}

    def passed(self, length: float) -> None:
        """After an arc of positive length, edges taken before it may fire again."""
        if length > 0:
            self.spent = frozenset()

    def go_on_through(self, signs: dict[str, int], x: StateVector) -> None:
        """Continue an arc of the compiled loop with the next windows of the past.

        ``signs``: by edge, the sign of its guard at the end of the last step.
        """
        field, self.spent = self.entry.field, frozenset()
        known = self.vanishing
        self.begin(field, x, lambda: Jumped(known, field.held, passing=signs))
        self._see(x)

    def pass_window(self, fired: Guard | None, x: StateVector) -> None:
        """Continue an arc with the next window of the past, or the next piece of the signals."""
        field, t, memory = self.entry.field, self.t, self.record.memory
        if self.plan.progress is not None:
            self.plan.progress(t)
        if memory is None:
            pass_knot(self, self.scene.until, x)
            return
        most = max(TIE * np.spacing(abs(t)), FURTHEST_APART * (t - memory.since))
        if fired is None and fires_at(self, taken(self, t, x), t, x, most):
            return
        signs = signs_at_end(self.entry, t, x, self.reach(x))
        memory.passed(t, x, field, fired.edge if fired else None)
        known = self.vanishing
        if field.leans:  # what is seen of the past, or its rate, may have jumped
            before = self.field
            self.look(x)
            loose = memory.loose | turned(before, self.field, t, x)
            if loose and let_go(self, t, x, STRAYS * self.losses.share, loose):
                return
        self.enter(field.mode, x, Jumped(known, field.held, passing=signs))

    def interrupt(self, edge: str, to: str, before: StateVector, after: StateVector) -> None:
        """End the series of impacts whose gap or gap speed a jump, which leads to a field, has
        changed."""
        if self.watch.impacts:
            here, there = self.entry.field, self.scene.field(to)
            self.watch.interrupted(edge, here, there, self.t, before, after)
        if edge not in self.scene.contacts:
            self.watch.contact = None

    def jump(self, guard: Guard, x: StateVector, carried: bool = False) -> None:
        """Carry out the jump of a guard that fired; ``carried``: it jumped over zero."""
        jumps.carry_out(self, guard, x, carried)

    def fly_on(self, field: Field, guard: Guard, x: StateVector) -> None:
        """Begin the flight after an impact that another run has recorded, however low it is."""
        contact = self.scene.contact(guard.edge)
        speed = guard.lie(self.t, x.tolist())[1]
        low = jumps.low_flight(self, contact, x, speed, field.name)
        if low is None:
            self.enter(field.mode, x, Jumped(self.leaves(guard.edge, field.name, x), field.held))
        else:
            jumps.bounce(self, guard, *low)

    def parted(self, contact: str, name: str, x: StateVector) -> bool:
        """Whether an impact that erases the past has moved the obstacle off the body, as its gap
        sees another past: the body does not begin its flight there, in a field, given by name."""
        if not self.forgets:
            return False
        field = self.scene.field(name)
        guard, t = field.guard(contact), self.t
        high = extent(self.scene, guard, field, t, x, self.seen)[0]
        return guard.value(t, x.tolist()) > 2.0 * GUARD_ROUNDING * EPS * high

    def leaves(self, contact: str, name: str, x: StateVector, power: int = 1) -> dict[str, int]:
        """The power of the time by which the gap vanishes where the flight behind an impact begins;
        empty if it does not."""
        return {} if self.parted(contact, name, x) else {contact: power}

    @property
    def forgets(self) -> bool:
        """Whether a jump erases the past, and so changes flows and guards at once."""
        return self.record.memory is not None and self.plan.memory == "restart"

    def watch_pace(self) -> None:
        """Begin to watch the step sizes of an arc that is flown many steps at a time."""
        self.pace = Pace(self.field, self.t, self.record.now.until(self.plan.t1), self.losses)

    def count_steps(self, tau: float, x: StateVector, count: int) -> None:
        """Count steps of that arc, up to a local time and state."""
        try:
            self.pace.steps(tau, x, count)
        except FlowError as fault:
            where = describe(self.scene, self.entry.field, self.t + tau, x)
            raise FlowError(f"{where}: {fault}") from None

    def where(self, x: StateVector) -> str:
        """Model, mode, time and state, for error messages."""
        return describe(self.scene, self.entry.field, self.t, x)

    def still_held(self, mode: str, x: StateVector) -> tuple[str, ...]:
        """The held contacts that a jump has left closed: their gap and gap speed are zero."""
        if mode != self.entry.field.mode:
            return ()
        held = self.entry.field.held
        return tuple(g.edge for g, _ in self._zero(mode, x) if g.edge in held)

    def carrier(self, mode: str, x: StateVector) -> Field:
        """The field of the contacts, or of the surface, on which a jump has left the state, that
        was held there before it; they may be of another mode, whose forces do not part them."""
        slid, there = self.entry.field, x.tolist()
        switching = self.scene.spec.sliding(slid.mode)
        if switching is not None and mode in (switching.positive, switching.negative):
            off = np.abs(slid.along(self.t, x) - x)
            return slid if np.all(off <= CLOSED * self.seen) else self.scene.field(mode)
        if mode == slid.mode:
            held = self.still_held(mode, x)
        else:
            zero = ((g, g.lie(self.t, there)[2], size) for g, size in self._zero(mode, x))
            held = tuple(g.edge for g, force, size in zero if force <= CLOSED * size)
        return self.scene.field(self.scene.name(mode, held))

    def _zero(self, mode: str, x: StateVector) -> Iterator[tuple[Guard, float]]:
        """The gaps of a mode that are zero behind a jump, as are their speeds, if any contacts were
        held before it; and the sizes of their accelerations."""
        field = self.scene.field(mode)
        for guard in field.guards if self.entry.field.held else ():
            gap, speed, _ = guard.lie(self.t, x.tolist())
            high, fast, size = extent(self.scene, guard, field, self.t, x, self.seen)
            closed = abs(gap) <= CLOSED * high and abs(speed) <= CLOSED * fast
            if guard.kind == "contact" and closed:
                yield guard, size

    def closed(self, mode: str, held: tuple[str, ...], x: StateVector) -> StateVector:
        """The state projected onto the held contacts, with gaps and gap speeds exactly zero."""
        return self.scene.field(self.scene.name(mode, held)).along(self.t, x)
