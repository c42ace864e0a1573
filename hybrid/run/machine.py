"""Runs the compiled loop of the rules and answers what it asks for.

:mod:`hybrid.rules.advance` flies arcs and makes jumps until it needs something from outside: a step
of another solver, a field that is not in its tables, more room, or a decision that needs all the
rules. This module answers, records what the loop has left, and hands the rest to the driver.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..delay.memory import SUMS
from ..delay.windows import Links, Shown
from ..errors import FlowError
from ..lowering.lowered import ORDER
from ..rules import unit
from ..rules.arrays import Left, Now
from ..rules.calls import held
from ..rules.places import (
    ABSOLUTE,
    AT_REST,
    AT_START,
    BEGINS,
    BEYOND_BY,
    CURVE_ROWS,
    DRIVERS,
    DUE,
    END,
    ENDS_THERE,
    ENTERED,
    EXPANSIONS,
    FIELD,
    FIRED,
    FLIGHTS,
    FLOWING,
    FULL,
    GAP_SPEED,
    GOES_ON,
    GOES_ON_AT_REST,
    GUARD_POWER,
    HELD,
    HOLD,
    IMPACT_COUNT,
    JUMP,
    JUMPS_BEFORE,
    JUMPS_MADE,
    LACKING,
    LACKING_AT,
    LAND_ON,
    LAST_USED,
    LASTED,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    MAKE,
    MAX_STEP,
    NONE,
    PHASE,
    PROOF,
    REACHES,
    RISES,
    SERIES,
    SHOW,
    STEP,
    STEP_END,
    STEPS_LOST,
    STEPS_MADE,
    STRIKES,
    TAILS,
    TAU,
    TOLERANCES,
    TRIED,
    WALKS,
    WAS_LOW,
    WATCHED,
    T,
)
from ..trajectory.arcs import Table
from ..trajectory.clock import Instant
from ..trajectory.log import Flights, Steps
from ..trajectory.plan import PATIENCE
from ..trajectory.trajectory import Status
from ..zeno.narrow import bounded
from . import clocks, noting
from .accumulations import pass_sum
from .entry import Jumped
from .jumps import bounce
from .kept import KeptSteps
from .knots import Feed, pass_knot
from .limits import pass_limit
from .lookback import at_window, looked_back, passes
from .outside import Outside
from .proved import proves, tail_of
from .rooms import Rooms, left_for
from .standstill import standstill
from .watch import Watch
from .watched import Holding

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Field, Guard, Scene
    from .driver import Driver

#: Room for jumps and steps at first, the factor by which it grows after each call that has filled
#: it, and its limit: a run can be interrupted between calls. Room for sums.
JUMPS_KEPT, STEPS_KEPT, ROOM_GROWTH, MOST_ROOM = 64, 512, 4, 1 << 15
SUMS_KEPT = SUMS

#: The methods of :class:`Outside` that answer what the loop asks of another solver.
OUTSIDE_METHODS = {STEP: "step", SHOW: "show", LAND_ON: "land"}


class Machine:
    """The compiled loop of one run, with Taylor series or another solver's steps.

    ``fly`` continues from the driver's entry as far as the compiled rules can decide. It leaves the
    driver with a new entry, a jump done, or its status set.
    """

    now: Now
    floats: np.ndarray
    ints: np.ndarray
    rooms: Rooms

    def __init__(self, driver: Driver) -> None:
        scene, solver, plan = driver.scene, driver.solver, driver.plan
        self.driver, self.plan = driver, plan
        self.tables = scene.tables if solver.whole else scene.watched
        self.past = Shown(self.tables, plan.memory == "restart") if scene.spec.windows else None
        self.links: Links | None = None
        self.dense = plan.dense or plan.samples is not None
        moving = any(scene.code.moving)
        self.windowed = bool(scene.spec.lags) and not solver.whole
        self.feed: Feed | None = None
        self.dense = self.dense or self.windowed
        self.outside = None if solver.whole else Outside(driver, self.tables.fields, self.dense)
        self.watched = Holding(driver, self.tables)
        n, self.highest = scene.spec.dimension, solver.highest if solver.whole else ORDER
        self.order = self.highest
        series, steps = (PATIENCE, plan.patience), (plan.longest(0.0), plan.max_step)
        atol = [plan.atol] * n if isinstance(plan.atol, float) else plan.atol
        last = (0, *solver.loss(n)) if solver.whole else (solver.order, 0.0, *atol)
        ends = GOES_ON_AT_REST if plan.zeno == "rest" else ENDS_THERE
        summed = (plan.memory == "keep" or not scene.spec.lags) and not moving
        sums = ends if summed else DRIVERS, plan.closing
        last = (0.0, last[0], np.inf, plan.t1, plan.t1, float(plan.shaken), *last[1:])
        given = [plan.t1, plan.limit, plan.rtol, *series, *steps, *sums, *last]
        self.run = np.array(given, dtype=float)
        self.n = n
        self.needs: tuple[int, ...] = ()
        self.kept = KeptSteps(n, self.dense, self.outside is not None)
        self.size: tuple[int, ...] = (JUMPS_KEPT, STEPS_KEPT)

    def tolerate(self) -> None:
        """Take over the tolerances of the driver's plan, and what steps have lost of them."""
        plan = self.driver.plan
        self.run[ABSOLUTE], self.run[TOLERANCES:] = plan.limit, plan.atol
        if self.needs:
            self.rooms.run[:] = self.run
            self.floats[STEPS_LOST] = self.driver.losses.tolerances

    def takes(self) -> bool:
        """Whether the compiled loop can fly the arc that begins at the driver's entry.

        With another solver it cannot while the windows of the past are guesses.
        """
        entry, memory = self.driver.entry, self.driver.record.memory
        if self.windowed and memory is not None and memory.guessing:
            return False
        return max(entry.orders, default=0) <= RISES and self.may(entry.field)

    def may(self, field: Field) -> bool:
        """Whether the compiled loop can fly arcs of a field."""
        return self.plan.zeno != "truncate" and self.tables.plain(self.tables.number(field))

    def fly(self) -> None:
        """Go on until a decision needs all the rules, or the run ends."""
        self.order = min(self.highest, ORDER) if self.driver.wary else self.highest
        self._begin()
        self.passed = False
        self.kept.forget()
        try:
            self._go_on()
        finally:
            if self.driver.record.memory is not None:
                self.driver.record.memory.told = False

    def _go_on(self) -> None:
        driver = self.driver
        while True:
            left = self._left()
            self._watch(driver.wary)
            status = self._advance(left)
            driver.losses.tolerances = float(self.floats[STEPS_LOST])
            self._expanded()
            self._keep(left)
            ended = driver.status is not None or self.passed
            if self.feed is not None and not ended and self._knot(left, status):
                return
            if self.past is not None and not ended:
                if at_window(self, left, status):
                    return
                status = passes(self, left, status)
            if status == GOES_ON:
                if self.takes():
                    continue
                driver.watch = self._series()
                return
            stands = not ended and status in (END, JUMP)
            if stands:
                driver.watch = self._series()
                self._stand(left, status)
            status = self._report(status, left, ended or stands)
            if ended or stands or self._spent(status, left):
                return
            driver.watch = self._series()
            if status != FULL:
                self._tell_sides()
                self._lower()
                driver.look_again()
                return
            self.size = tuple(min(ROOM_GROWTH * size, MOST_ROOM) for size in self.size)
            if self.past is not None and not self.takes():
                return

    @property
    def _going(self) -> int:
        """Steps made so far of an arc in the middle of which the arrays were full; otherwise 0."""
        return int(self.ints[MADE]) if self.ints[PHASE] == WALKS else 0

    def _hold(self, left: Left) -> float:
        """Keep the steps of the arc that goes on; returns the local time reached in it."""
        if not self._going:
            return 0.0
        tau, first = float(self.floats[TAU]), not self.kept.count
        made = self.kept.hold(left, int(self.ints[JUMPS_MADE]))
        if self.outside is None:  # another solver's are counted as they are made
            if first:
                self.driver.watch_pace()
            self.driver.count_steps(tau, self.now.end, made)
        return tau

    def _report(self, status: int, left: Left, ended: bool) -> int:
        """Report progress, and the steps of an arc that goes on; returns the status, or ``LOOK``
        where their pace shows that the flow stands still: the driver ends the arc there."""
        driver, x = self.driver, self.now.end
        try:
            self.tell(0.0 if ended else self._hold(left), left)
        except FlowError:
            if standstill(driver.field, driver.t, x, driver.losses.allowed(x)) is None:
                raise
            self.ints[PHASE] = BEGINS
            return LOOK
        return status

    def _spent(self, status: int, left: Left) -> bool:
        """Whether the run has used up its steps; if so, records the arc as far as it was flown."""
        spent = status == FULL and self.driver.steps + self.kept.count >= self.plan.max_steps
        if spent and self._going:
            self._last(left)
        return spent

    def tell(self, tau: float, left: Left) -> None:
        """Report progress; if the user stops the run there, records the arc as far as it was
        flown."""
        try:
            if self.plan.progress is not None:
                self.plan.progress(self.driver.record.now.after(tau).t)
        except KeyboardInterrupt:
            if tau > 0.0:
                self._last(left)
            raise

    def _expanded(self) -> None:
        """Count the Taylor expansions of a call, which are the evaluations of Taylor steps."""
        solver, made = self.driver.solver, int(self.ints[EXPANSIONS])
        if self.outside is None:
            solver.evaluations = (solver.evaluations or 0) + made
            self.tables.flown(made, self.order)

    def _advance(self, left: Left) -> int:
        """Call the loop until it comes back for more than a step, a table or a check."""
        own, call = self.outside is None, self._call(left)
        try:  # what is not finite is reported, not warned of
            with nullcontext() if own else np.errstate(all="ignore"):
                while True:
                    status = call()
                    if status == MAKE:
                        self._make()
                        call = self._call(left)
                        continue
                    if status == HOLD:
                        self._hold_to_flow()
                        continue
                    if status == PROOF:
                        if self.driver.record.memory is None and proves(self, left):
                            continue
                        self.ints[PHASE] = BEGINS
                        return JUMP
                    if self.outside is None or status not in OUTSIDE_METHODS:
                        return status
                    make = getattr(self.outside, OUTSIDE_METHODS[status])
                    make(self.now, self.rooms.work[0], left)
        except KeyboardInterrupt:
            self._interrupted(self.now, left)
            raise
        except FlowError:  # the rules for the ends of a flow's domain are the driver's
            self.ints[PHASE] = BEGINS
            return LOOK

    def _watch(self, watched: bool) -> None:
        """Set whether the loop's steps are to be checked against the flow."""
        for run in (self.run, self.rooms.run):
            run[WATCHED], run[MAX_STEP] = watched, self.plan.max_step

    def _hold_to_flow(self) -> None:
        """Check what the loop has made against the flow. Behind a sum that is believed nothing is
        checked any more."""
        if self.ints[TAILS] and self.plan.watchful is None:
            self._watch(False)
            return
        room, sums, _ = self.rooms.work
        self.watched.hold(self.now, room, sums)
        for run in (self.run, self.rooms.run):
            run[MAX_STEP] = min(self.plan.max_step, self.watched.longest)

    def _call(self, left: Left) -> Callable[[], int]:
        """The call of the loop; with delays, of the rule that passes from window to window."""
        if self.feed is not None:
            return self._fed(left, self.feed)
        if self.past is not None and self.driver.record.memory is not None:
            return lambda: looked_back(self, left)
        rooms, go, automaton = self.rooms, unit("runs").go, self.tables.automaton
        if left is rooms.left:
            return rooms.call(go, automaton)
        room, sums, look = rooms.work
        return held(go, automaton, self.run, self.now, room, left, sums, look)

    def _fed(self, left: Left, feed: Feed) -> Callable[[], int]:
        """The call of the loop on the current pieces of the signals."""
        assert self.past is not None
        automaton, links = self.past.linked()
        (room, sums, look), given, rules = self.rooms.work, feed.arrays(links), unit("inputs")
        if links is not self.links:
            rules.feed(automaton, room, given)
            self.links = links
        return held(rules.through, automaton, self.run, self.now, room, left, sums, look, given)

    def _knot(self, left: Left, status: int) -> bool:
        """Whether the loop has stopped at or behind a knot of a signal where a guard must be
        examined; if so, this is done. The arc is recorded up to the last knot."""
        driver, feed, place = self.driver, self.feed, int(self.ints[JUMPS_MADE])
        assert feed is not None
        at_knot = status == END and feed.until < self.plan.t1
        if not (at_knot or (status == LOOK and feed.place[2] == place)):
            return False
        driver.watch = self._series()
        tau, x, t = float(self.floats[TAU]), self.now.end.copy(), feed.until
        if not at_knot:
            self.ints[STEPS_MADE] = feed.place[3]
            tau, x, t = float(feed.began[0]), feed.start.copy(), feed.since
        steps, made = self.kept.take_until(left, int(self.ints[STEPS_MADE]), place, tau)
        segments = steps.segments(np.array([tau])) if steps else []
        driver.steps += made
        driver.passed(tau)
        self._come_to_piece()
        entry = driver.entry
        x = driver.record.extend(entry.field, entry.x, x, tau, segments)
        driver.entry = attrs.evolve(entry, x=x)
        pass_knot(driver, max(t, driver.t), x)
        return True

    def _come_to_piece(self) -> None:
        """Let the entry's field read the piece of the signals on which the loop has stopped."""
        driver = self.driver
        if self.feed is not None:
            driver.scene = driver.model.at(self.feed.since)
            driver.entry = attrs.evolve(driver.entry, field=driver.field)

    def _make(self) -> None:
        """Complete the tables with what the loop has asked for, and make room for it."""
        with np.errstate(all="ignore"):
            self.tables.complete(int(self.ints[LACKING]), int(self.ints[LACKING_AT]), bounded)
        known = [noted.copy() for noted in self.now.noted]
        self._take()
        self._forget()
        for noted, was in zip(self.now.noted, known, strict=True):
            noted[: len(was)] = was

    def _take(self) -> None:
        """Work in arrays that are large enough for the tables as they are now."""
        tables, before = self.tables, self.needs
        needs = *tables.needs, tables.widest, len(tables.guards), self.order
        if needs == before:
            return
        try:
            rooms = tables.free[needs].pop()
        except (KeyError, IndexError):
            rooms = Rooms(tables, self.n, self.order, (JUMPS_KEPT, STEPS_KEPT), SUMS_KEPT)
        rooms.run[:] = self.run
        rooms.now.floats[:], rooms.now.ints[:], rooms.now.end[:] = 0.0, 0, 0.0
        rooms.now.ints[FLOWING] = self.driver.scene.spec.flows
        for own, was in zip(rooms.now[:5], self.now if before else (), strict=False):
            own[:] = was
        self.give_back()
        self.needs, self.rooms, self.now = needs, rooms, rooms.now
        self.floats, self.ints = rooms.now.floats, rooms.now.ints

    def _forget(self) -> None:
        """Clear what is known of guards."""
        for array in self.now[5:]:
            array[:] = 0

    def give_back(self) -> None:
        """Return the arrays, for other runs to use."""
        if self.needs:
            self.tables.free.setdefault(self.needs, []).append(self.rooms)
            self.needs = ()

    def _interrupted(self, now: Now, left: Left) -> None:
        """After an interrupt: record the arcs that have ended, and the steps of the current one."""
        self._keep(left)
        if self.driver.status is not None or self.passed:
            return
        if self.outside is None:
            if self.ints[PHASE] != HELD:
                return
            now.end[:] = self.rooms.work[0].c[: self.n, 0]  # a step has been made, and not seen
        elif self.ints[PHASE] == STRIKES:
            self._last(left)
            return
        if not self.ints[MADE]:
            return
        if self.outside is not None and self.floats[STEP_END] != self.floats[TAU]:
            self.outside.undo(now)
        self.ints[STEPS_MADE] += self.ints[MADE]
        self._last(left)

    def _series(self) -> Watch:
        """The current series of impacts."""
        edges, contact = [guard.edge for guard in self.tables.guards], int(self.ints[SERIES])
        counts = self.now.impacts[: len(edges)]
        return Watch(
            edges[contact] if contact >= 0 else None,
            int(self.ints[IMPACT_COUNT]),
            float(self.floats[TRIED]),
            {edges[g]: int(counts[g]) for g in np.flatnonzero(counts).tolist()},
        )

    def _begin(self) -> None:
        """Put the driver's entry into the loop's arrays."""
        driver, entry = self.driver, self.driver.entry
        now, guards = driver.record.now, entry.field.guards
        field = self.tables.number(entry.field)
        contact = driver.watch.contact
        edges: list[str | None] = [guard.edge for guard in guards]
        own = dict(zip(edges, self.tables.own(field), strict=True))
        self._take()
        floats, ints = self.floats, self.ints
        floats[T], floats[LOW], floats[TAU] = now.t, now.low, 0.0
        judged = int(entry.here is not None)
        looks_back = driver.record.memory is not None
        jumped = Jumped() if judged or looks_back else driver.came()
        if driver.scene.samples:
            t, goes_on = driver.t, self.outside is None and not driver.wary
            where = t, driver.scene.until > t, goes_on
            if self.feed is None or not self.feed.at(*where):
                first = t if where[1] else float(np.nextafter(t, -np.inf))
                self.feed = Feed(driver.model, first, self.plan.t1)
                self.feed.at(*where)
            self.links = None
        edge, power = next(iter(jumped.vanishing.items()), (jumped.used, 0))
        edge = driver.jumped.used if judged else edge
        ints[FIELD], ints[ENTERED], ints[PHASE] = field, judged, BEGINS
        ints[LAST_USED] = own.get(edge, AT_START if jumped.starting else NONE)
        floats[BEYOND_BY] = driver.jumped.beyond_by if judged else jumped.beyond_by
        ints[GUARD_POWER], ints[LASTED] = power, jumped.series
        ints[SERIES], ints[IMPACT_COUNT] = own.get(contact, -1), driver.watch.count
        floats[TRIED], floats[STEPS_LOST] = driver.watch.tried, driver.losses.tolerances
        ints[LOW_AHEAD] = ints[WAS_LOW] = 0
        x, _, seen = self.now[2:5]
        x[:], seen[:], ints[FLIGHTS] = entry.x, driver.seen, 1
        self._forget()
        self.now.orders[: len(entry.orders)] = entry.orders
        for name in driver.watch.impacts.keys() & own.keys():
            self.now.impacts[own[name]] = driver.watch.impacts[name]
        noted = driver.tied or driver.spent or driver.touched
        for g, guard in enumerate(self.tables.guards if noted else ()):
            self.now.tied[g] = driver.tied.get(guard.edge, 0)
            self.now.touched[g] = driver.touched.get(guard.edge, 0)
            self.now.spent[g] = guard.edge in driver.spent
        driver.tied, driver.touched = {}, {}

    def _left(self) -> Left:
        """The arrays that a call fills, with the counts set to zero."""
        n, (jumps, steps) = self.n, self.size
        if self.outside is not None:
            jumps = 1 if self.plan.progress is not None else jumps
        if self.windowed:
            jumps = 1
        memory = self.driver.record.memory
        if memory is not None:
            memory.begins(self._going, int(self.ints[JUMPS_MADE]), *self.floats[:2].tolist())
        if self.feed is not None:
            self.feed.begins(bool(self._going) and self.feed.place[2] == self.ints[JUMPS_MADE])
        jumps = min(jumps, self.plan.max_jumps - self.driver.record.made)
        steps = int(min(steps, max(self.plan.max_steps - self.driver.steps - self.kept.count, 1)))
        self.ints[JUMPS_MADE], self.ints[STEPS_MADE], self.ints[EXPANSIONS] = 0, -self._going, 0
        self.ints[TAILS] = 0
        rows = steps * n if self.dense or memory is not None else 0
        if not rows and (jumps, steps) == self.rooms.size:
            return self.rooms.left
        return left_for(n, jumps, steps, (rows, self.order + 1), SUMS_KEPT)

    # -- what a call left -------------------------------------------------------------------

    def _keep(self, left: Left) -> None:
        """Record the arcs that have ended with a jump."""
        driver, begin, made = self.driver, 0, int(self.ints[JUMPS_MADE])
        sums = list(map(int, left.sums[: self.ints[TAILS], JUMPS_BEFORE].tolist()))
        fired = left.fired[:made].tolist()
        fields = [*(self.tables.modes[g] for g in fired), self.tables.fields[self.ints[FIELD]].name]
        self._held(fields[0])
        while begin < made and driver.status is None and not self.passed:
            last = next((place for place in sums if place > begin), made)
            rung = np.flatnonzero(self.tables.rings[fired[begin:last]])
            t, low, _ = left.when[begin:last].T
            end = begin + noting.room(driver, t, low, rung)
            due = self._flown(left, begin, end)
            guard, after = self.tables.guards[fired[end - 1]], left.after[end - 1].copy()
            to = fields[end] if guard.kind == "switch" else guard.to
            driver.begin(driver.own.field(fields[end - 1]), after, Jumped)
            due = due and guard.kind not in ("release", "leave")
            if due and end not in sums and self._pass_limit(to):
                self.passed = True
                return
            before, vanishes = left.before[end - 1].copy(), self.ints[GUARD_POWER] > 0
            off = None if end < made or vanishes else abs(float(self.floats[BEYOND_BY]))
            driver.arrive(driver.own.field(to), after, guard, before, off)
            if end in sums:
                self._held(fields[end - 1])
                if driver.status is not None:  # behind the last jump nothing is summed
                    return
                self._summed(left, sums.index(end))
                if self.passed:
                    return
            self._held(fields[end])
            begin = end

    def _held(self, name: str) -> None:
        """Begin the next arc on the contacts that are held in it."""
        driver = self.driver
        if driver.entry.field.name != name:
            field = driver.own.field(name)
            driver.begin(field, field.along(driver.t, driver.entry.x), driver.came)

    def _pass_limit(self, mode: str) -> bool:
        """Whether the run has passed the limit of a cycle, judged with the past as it was then.

        ``mode``: the mode that the last jump leads to.
        """
        driver, memory = self.driver, self.driver.record.memory
        if memory is None:
            return pass_limit(driver, mode)
        with memory.as_at(driver.t, driver.entry.x) as then:
            scene, driver.scene = driver.scene, then.scene
            then.kept = pass_limit(driver, mode)
            driver.scene = driver.scene if then.kept else scene
        return then.kept

    def _summed(self, left: Left, place: int) -> None:
        """Record a sum of impacts and begin the rest that follows it.

        If that needs all the rules, the driver has begun it (``passed``).
        """
        driver = self.driver
        guard = self.tables.guards[left.fired[int(left.sums[place, JUMPS_BEFORE]) - 1]]
        entry, now, memory = driver.entry, driver.record.now, driver.record.memory
        seen = driver.scene
        if memory is not None and not self.windowed:
            seen = driver.model.through([memory.sights[place]])
        since = now.t, now.low, entry.x
        tail = tail_of(left, place, seen.field(entry.field.name), seen.contact(guard.edge), since)
        at_rest = left.curves[place * CURVE_ROWS + AT_REST, : self.n].copy()
        self.passed = bool(np.isnan(at_rest[0]))
        pass_sum(driver, tail, None if self.passed else at_rest)

    @property
    def present(self) -> Scene:
        """The scene at the present piece of the signals."""
        driver = self.driver
        return driver.scene if self.feed is None else driver.model.at(self.feed.since)

    @property
    def instant(self) -> Instant:
        """The time that the loop has reached."""
        t, low, tau = self.floats[[T, LOW, TAU]].tolist()
        return Instant(t, low).after(tau)

    def _flown(self, left: Left, begin: int, end: int) -> bool:
        """Record the arcs that end with some of the jumps; returns whether to look for a cycle."""
        driver, tables, now = self.driver, self.tables, self.driver.record.now
        fired, (t, low, lengths) = left.fired[begin:end], left.when[begin:end].T.copy()
        modes, edges = tables.named[:, fired]
        jumps = Table(t, low, edges, left.before[begin:end].copy(), left.after[begin:end].copy())
        steps, count = self.flown_in(left, begin, end)
        first = driver.entry.x
        onto = {}
        for k in np.flatnonzero(tables.constrained[fired]).tolist():
            onto[modes[k]] = driver.own.field(modes[k]).onto
        since = driver.record.j, modes, now.t, now.low
        flights = Flights(*since, first, lengths, jumps, steps, onto)
        driver.steps += count
        return noting.flown(driver, flights)

    def flown_in(self, left: Left, begin: int, end: int) -> tuple[Steps | None, int]:
        """The steps of some arcs, if they are kept, and their number; the first arc includes those
        held."""
        return self.kept.take(left, int(self.ints[STEPS_MADE]), begin, end)

    def _last(self, left: Left, goes_on: bool = False) -> StateVector:
        """Add the arc that no jump of the loop has ended, or what has been flown of one that goes
        on; returns the state at its end."""
        place, tau = int(self.ints[JUMPS_MADE]), float(self.floats[TAU])
        return self._arc(left, place, tau, self.now.end.copy(), goes_on)

    def _rings(self, due: float) -> bool:
        """Whether one of the clocks that ring where the arc ends fires."""
        self._come_to_piece()
        driver = self.driver
        end = driver.entry.field.at_end(due, self.now.end)
        return clocks.first(driver, due, end) is not None

    def _arc(
        self, left: Left, place: int, tau: float, end: StateVector, goes_on: bool = False
    ) -> StateVector:
        """Add an arc, or a part of one that goes on; returns the state at its end."""
        self._come_to_piece()
        driver, (steps, count) = self.driver, self.flown_in(left, place, place + 1)
        segments = [] if steps is None else steps.segments(np.array([tau]))
        driver.steps += count
        driver.passed(tau)
        keep = driver.record.extend if goes_on else driver.record.arc
        return keep(driver.entry.field, driver.entry.x, end, tau, segments)

    @property
    def fired(self) -> Guard:
        """The guard that fired last, in the driver's field."""
        field, guard = self.driver.entry.field, self.tables.guards[int(self.ints[FIRED])]
        return field.guard(guard.edge)

    @property
    def _jumped(self) -> bool:
        """Whether the guard that fired last has jumped over zero."""
        fired = int(self.ints[FIRED]) - self.tables.first(int(self.ints[FIELD]))
        return bool(self.now.zeros[fired, REACHES])

    def _stand(self, left: Left, status: int) -> None:
        """Handle the place at which the loop has stopped: the end of the run, or a jump."""
        driver, place = self.driver, int(self.ints[JUMPS_MADE])
        speed, due = float(self.floats[GAP_SPEED]), float(self.floats[DUE])
        if status == END:
            self._last(left)
            driver.status = Status.REACHED_END
        elif self.fired.kind == "clock" and not self._rings(due):
            x = self._last(left, goes_on=due < self.plan.t1)
            if due == self.plan.t1:
                driver.status = Status.REACHED_END
                return
            driver.spent |= self._over()
            driver.entry = attrs.evolve(driver.entry, x=x, field=driver.field)
            clocks.go_by(driver, due, x)
        else:
            before = self._last(left)
            self._tell_sides()
            if driver.record.memory is not None:
                driver.record.memory.told = False
            driver.entry = attrs.evolve(driver.entry, field=driver.field)
            if self.ints[WAS_LOW]:
                bounce(driver, self.fired, before, left.after[place].copy(), speed)
            elif self.fired.kind == "clock":
                clock = clocks.first(driver, due, before)
                driver.ring(clock or self.fired, due, before)
            else:
                driver.beyond_by = abs(float(self.floats[BEYOND_BY])) if self._jumped else 0.0
                driver.jump(self.fired, before, self._jumped)

    def _tell_sides(self) -> None:
        """Tell the driver which guards were zero when the last flight ended, and from which side
        they came."""
        now, driver = self.now, self.driver
        driver.tied, driver.touched = self._noted(now.tied), self._noted(now.touched)
        driver.spent |= self._over()

    def _noted(self, sides: np.ndarray) -> dict[str, int]:
        """By edge, what is noted of guards for the end of the last flight: a sign."""
        flights = int(self.ints[FLIGHTS])
        rows = np.flatnonzero((np.abs(sides) == flights) & (sides != 0)).tolist()
        return {self.tables.guards[g].edge: int(sides[g]) // flights for g in rows}

    def _over(self) -> set[str]:
        """The edges that have fired, or were passed over, at the time when the last flight
        ended."""
        rows = np.flatnonzero(self.now.spent == self.ints[FLIGHTS]).tolist()
        return {self.tables.guards[g].edge for g in rows}

    def _lower(self) -> None:
        """Continue with series of lower order if the highest coefficients overflow, as they do when
        the unit of time is small."""
        low, jets = self.driver.solver.order, self.driver.entry.field.jets
        if self.outside is None and jets is not None and self.order > low:
            here = self.driver.t, self.driver.entry.x.tolist()
            if not jets.finite(*here, self.order) and jets.finite(*here, low):
                self.highest = low
