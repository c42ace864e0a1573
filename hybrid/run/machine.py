"""The Python side of the rules' own loop: arcs that are plain are flown as machine code.

:mod:`hybrid.rules.advance` goes on as far as nothing needs judgement. Steps that it cannot make
itself, those of another solver, are made here when it asks for them. What it leaves is kept, and
the driver judges what comes next.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..delay.memory import SUMS, Memory
from ..delay.windows import Links, Shown
from ..errors import FlowError
from ..lowering import released
from ..lowering.lowered import ORDER
from ..rules import unit
from ..rules.arrays import Left, Now
from ..rules.calls import held
from ..rules.places import (
    AT_LIMIT,
    AT_REST,
    AT_START,
    BEGAN,
    BEGINS,
    CURVE_ROWS,
    DRIVERS,
    DUE,
    END,
    ENDS_THERE,
    ENTERED,
    ERRORS,
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
    IN_ARC,
    JUMP,
    JUMPS_BEFORE,
    JUMPS_MADE,
    LACKING,
    LACKING_AT,
    LAND_ON,
    LAST_TIME,
    LAST_USED,
    LASTED,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    MAKE,
    MAX_STEP,
    NO_ROOM,
    NONE,
    PHASE,
    RISES,
    SERIES,
    SHOW,
    STEP,
    STEP_END,
    STEPS_DONE,
    STEPS_MADE,
    STRIKES,
    TAILS,
    TAU,
    TRIED,
    WALKS,
    WAS_LOW,
    WATCHED,
    WINDOW,
    T,
)
from ..segment import nodes, terms
from ..trajectory.arcs import Table
from ..trajectory.log import Flights, Steps
from ..trajectory.plan import PATIENCE
from ..trajectory.trajectory import Status
from ..zeno.accumulate import Tail
from ..zeno.narrow import bounded
from . import clocks
from .entry import Jumped
from .knots import Feed, pass_knot
from .limits import pass_limit
from .outside import Outside
from .rooms import Rooms, left_for
from .watch import Watch
from .watched import Holding

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Field, Guard
    from .driver import Driver

#: Jumps and steps for which there is room at first; how many times more there is after each call
#: that has filled it, and at most: the keyboard is heard between calls. Sums for which there is
#: room.
JUMPS_KEPT, STEPS_KEPT, ROOM_GROWTH, MOST_ROOM = 64, 512, 4, 1 << 15
SUMS_KEPT = SUMS

#: Steps as they are left: their arcs, when they begin and how long they are, and their series.
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]

#: What is asked for of another solver: methods of :class:`Outside`.
OUTSIDE_METHODS = {STEP: "step", SHOW: "show", LAND_ON: "land"}


class Machine:
    """Flies a driver's plain arcs by the rules' own loop: with Taylor series, or with another
    solver's steps.

    ``fly`` goes on from the driver's entry as far as nothing needs judgement, and leaves the
    driver with an entry, a jump done, or its status set.
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
        last = (0.0, last[0], np.inf, plan.t1, *last[1:])
        given = [plan.t1, plan.limit, plan.rtol, *series, *steps, *sums, *last]
        self.run = np.array(given, dtype=float)
        self.n = n
        self.needs: tuple[int, ...] = ()
        self.open: list[Rows] = []
        self.size: tuple[int, ...] = (JUMPS_KEPT, STEPS_KEPT)

    def takes(self) -> bool:
        """Whether the arc that begins at the driver's entry may be plain.

        Where what delays see is guessed another solver's is the driver's.
        """
        entry, memory = self.driver.entry, self.driver.record.memory
        if self.windowed and memory is not None and memory.guessing:
            return False
        return max(entry.orders, default=0) <= RISES and self.may(entry.field)

    def may(self, field: Field) -> bool:
        """Whether the arcs of a field may be plain."""
        return self.plan.zeno != "truncate" and self.tables.plain(self.tables.number(field))

    def fly(self) -> None:
        """Go on until something needs judgement, or the run ends."""
        self.order = min(self.highest, ORDER) if self.driver.wary else self.highest
        self._begin()
        self.passed, self.open, self.opened = False, [], 0
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
            self._expanded()
            self._keep(left)
            ended = driver.status is not None or self.passed
            if self.feed is not None and not ended and self._knot(left, status):
                return
            if self.past is not None and not ended:
                status = self._passes(left, status)
            if status == GOES_ON:
                if self.takes():
                    continue
                driver.watch = Watch(*self._series())
                return
            stands = not ended and status in (END, JUMP)
            if stands:
                driver.watch = Watch(*self._series())
                self._stand(left, status)
            self._tell(0.0 if ended or stands else self._hold(left), left)
            if ended or stands or self._spent(status, left):
                return
            driver.watch = Watch(*self._series())
            if status != FULL:
                driver.tied = self._tied()
                driver.spent |= self._over()
                self._lower()
                driver.look_again()
                return
            self.size = tuple(min(ROOM_GROWTH * size, MOST_ROOM) for size in self.size)
            if self.past is not None and not self.takes():
                return

    @property
    def _going(self) -> int:
        """Steps so far of the arc that the loop is in the middle of, its arrays being full."""
        return int(self.ints[MADE]) if self.ints[PHASE] == WALKS else 0

    def _hold(self, left: Left) -> float:
        """Keep the steps of the arc that goes on; returns the local time reached in it."""
        if not self._going:
            return 0.0
        rows, tau = left.owner == self.ints[JUMPS_MADE], float(self.floats[TAU])
        made = int(np.count_nonzero(rows))
        if self.outside is None:  # another solver's are counted as they are made
            if not self.opened:
                self.driver.watch_pace()
            self.driver.count_steps(tau, self.now.end, made)
        self.opened += made
        if self.dense:
            self.open.append(self._rows(left, rows, int(self.ints[JUMPS_MADE])))
        return tau

    def _spent(self, status: int, left: Left) -> bool:
        """Whether the run has made all its steps; keeps what has been flown of the arc."""
        spent = status == FULL and self.driver.steps + self.opened >= self.plan.max_steps
        if spent and self._going:
            self._last(left)
        return spent

    def _tell(self, tau: float, left: Left) -> None:
        """Say how far the run is; if it is stopped there, keep what has been flown of the arc."""
        try:
            if self.plan.progress is not None:
                self.plan.progress(self.driver.record.now.after(tau).t)
        except KeyboardInterrupt:
            if tau > 0.0:
                self._last(left)
            raise

    def _expanded(self) -> None:
        """Add the expansions of a call, which are what Taylor's steps evaluate."""
        solver, made = self.driver.solver, int(self.ints[EXPANSIONS])
        if self.outside is None:
            solver.evaluations = (solver.evaluations or 0) + made
            self.tables.flown(made, self.order)

    def _advance(self, left: Left) -> int:
        """Call the loop, and make the steps and the tables that it asks for."""
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
                    if self.outside is None or status not in OUTSIDE_METHODS:
                        return status
                    make = getattr(self.outside, OUTSIDE_METHODS[status])
                    make(self.now, self.rooms.work[0], left)
        except KeyboardInterrupt:
            self._interrupted(self.now, left)
            raise
        except FlowError:
            self._keep(left)
            raise

    def _watch(self, watched: bool) -> None:
        """Let the loop ask for what it makes to be held against the flow, or not."""
        for run in (self.run, self.rooms.run):
            run[WATCHED], run[MAX_STEP] = watched, self.plan.max_step

    def _hold_to_flow(self) -> None:
        """Hold what the loop has made against the flow; no more of it once it has gone over a sum,
        in which nothing hides."""
        if self.ints[TAILS] and self.plan.watchful is None:
            self._watch(False)
            return
        room, sums, _ = self.rooms.work
        self.watched.hold(self.now, room, sums)
        for run in (self.run, self.rooms.run):
            run[MAX_STEP] = min(self.plan.max_step, self.watched.longest)

    def _call(self, left: Left) -> Callable[[], int]:
        """What calls the loop: with delays, that which passes from window to window."""
        if self.feed is not None:
            return self._fed(left, self.feed)
        if self.past is not None and self.driver.record.memory is not None:
            return lambda: self._looked_back(left)
        rooms, go, automaton = self.rooms, unit("runs").go, self.tables.automaton
        if left is rooms.left:
            return rooms.call(go, automaton)
        room, sums, look = rooms.work
        return held(go, automaton, self.run, self.now, room, left, sums, look)

    def _fed(self, left: Left, feed: Feed) -> Callable[[], int]:
        """What calls the loop on the pieces of signals."""
        assert self.past is not None
        automaton, links = self.past.linked()
        (room, sums, look), given, rules = self.rooms.work, feed.arrays(links), unit("inputs")
        if links is not self.links:
            rules.feed(automaton, room, given)
            self.links = links
        return held(rules.through, automaton, self.run, self.now, room, left, sums, look, given)

    def _knot(self, left: Left, status: int) -> bool:
        """Whether the loop has come to a knot of signals that the driver is to look at, which it
        does; what is to be judged in an arc that has gone over knots is from the last of them on.
        """
        driver, feed, place = self.driver, self.feed, int(self.ints[JUMPS_MADE])
        assert feed is not None
        at_knot = status == END and feed.until < self.plan.t1
        if not (at_knot or (status == LOOK and feed.place[2] == place)):
            return False
        driver.watch = Watch(*self._series())
        tau, x, t = float(self.floats[TAU]), self.now.end.copy(), feed.until
        if not at_knot:
            self.ints[STEPS_MADE] = feed.place[3]
            tau, x, t = float(feed.began[0]), feed.start.copy(), feed.since
        steps, made = self._flown_in(left, place, place + 1)
        steps = steps and Steps(*(column[steps.start < tau] for column in steps))
        segments = steps.segments(np.array([tau])) if steps else []
        driver.steps += made
        driver.passed(tau)
        self._come_to_piece()
        entry = driver.entry
        x = driver.record.extend(entry.field, entry.x, x, tau, segments)
        driver.entry = attrs.evolve(entry, x=x)
        pass_knot(driver, t, x)
        return True

    def _come_to_piece(self) -> None:
        """Let the arc's field be on the piece of signals on which the loop has come to its end."""
        driver = self.driver
        if self.feed is not None:
            driver.scene = driver.model.at(self.feed.since)
            driver.entry = attrs.evolve(driver.entry, field=driver.field)

    def _looked_back(self, left: Left) -> int:
        """Call the loop with what flows look back on."""
        memory, now, (room, sums, look) = self.driver.record.memory, self.now, self.rooms.work
        assert self.past is not None
        assert memory is not None
        automaton, links = self.past.linked()
        past, shown = memory.past(links), memory.shown.tobytes()
        if not memory.bound or links is not self.links:
            unit("past").bound(automaton, now, room, past)
            self.links, memory.bound = links, True
        self.run[LAST_TIME] = memory.until
        if self.windowed:
            return int(unit("runs").go(automaton, self.run, now, room, left, sums, look))
        go = unit("past").look_back
        status = int(go(automaton, self.run, now, room, left, sums, look, past))
        if status == NO_ROOM:
            memory.make_room(self.driver.t)
            return self._looked_back(left)
        memory.told = True
        if memory.shown.tobytes() != shown:
            self.driver.scene, memory.bound = memory.read(), True
        return status

    def _passes(self, left: Left, status: int) -> int:
        """With delays: the status, ``GOES_ON`` where other windows of the past have been due.

        Where the present arc has gone on through windows, and is to be judged, what has been flown
        up to there is kept.
        """
        driver, memory, place = self.driver, self.driver.record.memory, int(self.ints[JUMPS_MADE])
        if memory is None:
            return status
        if self.windowed:
            return self._passes_window(left, status, memory)
        if status in (LOOK, WINDOW) and memory.ints[IN_ARC] == place:
            last = int(memory.ints[STEPS_DONE])
            tau, x = float(memory.floats[BEGAN]), memory.start
            first = int(left.owner[:last].searchsorted(place))
            driver.steps += self.opened + int(np.count_nonzero(left.spans[first:last, 0] < tau))
            steps = self._made([*self.open, self._rows(left, slice(first, last), place)])
            steps = steps and Steps(*(column[steps.start < tau] for column in steps))
            self.open, self.opened = [], 0
            self._through(tau, x, steps, memory.signs)
            memory.ints[IN_ARC] = -1
        if status == WINDOW:
            memory.told = False
            driver.scene = memory.look(driver.t, driver.entry.x)
        elif status == LOOK:
            memory.told = False
            memory.pieces.back_to(driver.t)
            if memory.ends(driver.t):
                memory.passed(driver.t, driver.entry.x, driver.entry.field)
                driver.look(driver.entry.x)
        return GOES_ON if status == WINDOW else status

    def _passes_window(self, left: Left, status: int, memory: Memory) -> int:
        """The same where the loop comes back at the end of each window: with other solvers' steps,
        and where a lag moves, whose window ends where a guard fires."""
        driver, place, fired = self.driver, int(self.ints[JUMPS_MADE]), None
        if status == FULL and place and self.plan.memory == "restart":
            guard = self.tables.guards[left.fired[0]]
            if guard.kind == "edge":  # through what is seen now it may not be zero
                self.ints[GUARD_POWER] = 0
        if status == JUMP and self._fired.kind == "window":
            fired = self._fired.edge
        if not fired and (status != END or memory.until >= self.plan.t1):
            return status
        steps, made = self._flown_in(left, place, place + 1)
        driver.steps += made
        before, tau, x = driver.field.guards, float(self.floats[TAU]), self.now.end.tolist()
        now = driver.record.now.after(tau)
        values = [1.0 if g.edge == fired else g.value(now.t, x) for g in before]
        self._through(tau, self.now.end, steps, np.sign(values))
        memory.passed(driver.t, driver.entry.x, driver.entry.field, fired)
        driver.look(driver.entry.x)
        self._tell(0.0, left)
        if driver.steps >= self.plan.max_steps:
            return FULL
        self.ints[ENTERED], self.now.orders[:] = 1, 0
        x = driver.entry.x.tolist()
        pairs = zip(driver.field.guards, values, strict=True)
        return GOES_ON if all(g.value(driver.t, x) * v > 0 for g, v in pairs) else LOOK

    def _through(self, tau: float, x: StateVector, steps: Steps | None, signs: np.ndarray) -> None:
        """Keep the present arc up to where it goes on through other windows of the past."""
        driver = self.driver
        segments = steps.segments(np.array([tau])) if steps and self.dense else []
        x = driver.record.extend(driver.entry.field, driver.entry.x, x.copy(), tau, segments)
        edges = [guard.edge for guard in driver.entry.field.guards]
        driver.go_on_through(dict(zip(edges, signs.tolist(), strict=False)), x)
        now = driver.record.now
        self.floats[T], self.floats[LOW], self.floats[TAU] = now.t, now.low, 0.0
        self.now.x[:], self.now.end[:], self.now.seen[:] = x, x, driver.seen
        if self.ints[PHASE] == WALKS:
            self.ints[MADE], self.ints[ENTERED] = 1, 0

    def _make(self) -> None:
        """Complete the tables, with room for what is new in them."""
        with np.errstate(all="ignore"):
            self.tables.complete(int(self.ints[LACKING]), int(self.ints[LACKING_AT]), bounded)
        tied, spent = self.now.tied.copy(), self.now.spent.copy()
        self._take()
        self._forget()
        self.now.tied[: len(tied)], self.now.spent[: len(spent)] = tied, spent

    def _take(self) -> None:
        """Work in arrays that are large enough for the tables as they are."""
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
        """Note nothing of guards."""
        for array in self.now[5:]:
            array[:] = 0

    def give_back(self) -> None:
        """Let other runs use the arrays."""
        if self.needs:
            self.tables.free.setdefault(self.needs, []).append(self.rooms)
            self.needs = ()

    def _interrupted(self, now: Now, left: Left) -> None:
        """Keep the arcs that have ended, and of the present one the steps that have been made."""
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
        elif self.floats[STEP_END] != self.floats[TAU]:
            self.outside.undo(now)
        if self.ints[MADE]:
            self.ints[STEPS_MADE] += self.ints[MADE]
            self._last(left)

    def _series(self) -> tuple[str | None, int, float]:
        """The series of impacts that goes on: the contact, how many, and the speed last tried."""
        guard, count = int(self.ints[SERIES]), int(self.ints[IMPACT_COUNT])
        contact = self.tables.guards[guard].edge if guard >= 0 else None
        return contact, count, float(self.floats[TRIED])

    def _begin(self) -> None:
        """The state of the driver's entry."""
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
            if self.feed is None or not self.feed.at(t, goes_on):
                self.feed = Feed(driver.model, t, self.plan.t1)
                self.feed.at(t, goes_on)
            self.links = None
        edge, power = next(iter(jumped.vanishing.items()), (jumped.used, 0))
        ints[FIELD], ints[ENTERED], ints[PHASE] = field, judged, BEGINS
        ints[LAST_USED] = own.get(edge, AT_START if jumped.starting else NONE)
        ints[GUARD_POWER], ints[LASTED] = power, jumped.series
        ints[SERIES], ints[IMPACT_COUNT] = own.get(contact, -1), driver.watch.count
        floats[TRIED] = driver.watch.tried
        ints[LOW_AHEAD] = ints[WAS_LOW] = 0
        x, _, seen = self.now[2:5]
        x[:], seen[:], ints[FLIGHTS] = entry.x, driver.seen, 1
        self._forget()
        self.now.orders[: len(entry.orders)] = entry.orders
        for g, guard in enumerate(self.tables.guards if driver.tied or driver.spent else ()):
            self.now.tied[g] = driver.tied.get(guard.edge, 0)
            self.now.spent[g] = guard.edge in driver.spent
        driver.tied = {}

    def _left(self) -> Left:
        """Arrays for what a call leaves, and the counts at zero."""
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
        steps = int(min(steps, max(self.plan.max_steps - self.driver.steps - self.opened, 1)))
        self.ints[JUMPS_MADE], self.ints[STEPS_MADE], self.ints[EXPANSIONS] = 0, -self._going, 0
        self.ints[TAILS] = 0
        rows = steps * n if self.dense or memory is not None else 0
        if not rows and (jumps, steps) == self.rooms.size:
            return self.rooms.left
        return left_for(n, jumps, steps, (rows, self.order + 1), SUMS_KEPT)

    # -- what a call left -------------------------------------------------------------------

    def _keep(self, left: Left) -> None:
        """Add the arcs that ended with a jump."""
        driver, begin, made = self.driver, 0, int(self.ints[JUMPS_MADE])
        sums = list(map(int, left.sums[: self.ints[TAILS], JUMPS_BEFORE].tolist()))
        fired = left.fired[:made].tolist()
        fields = [*(self.tables.modes[g] for g in fired), self.tables.fields[self.ints[FIELD]].name]
        self._held(fields[0])
        while begin < made and driver.status is None and not self.passed:
            last = next((place for place in sums if place > begin), made)
            rung = np.flatnonzero(self.tables.rings[fired[begin:last]])
            t, low, _ = left.when[begin:last].T
            end = begin + driver.room(t, low, rung)
            due = self._flown(left, begin, end)
            guard, after = self.tables.guards[fired[end - 1]], left.after[end - 1].copy()
            to = fields[end] if guard.kind == "switch" else guard.to
            driver.begin(driver.own.field(fields[end - 1]), after, Jumped)
            due = due and guard.kind not in ("release", "leave")
            if due and end not in sums and self._pass_limit(to):
                self.passed = True
                return
            driver.arrive(driver.own.field(to), after, guard, left.before[end - 1].copy())
            if end in sums:
                self._held(fields[end - 1])
                if driver.status is not None:  # behind the last jump nothing is summed
                    return
                self._summed(left, sums.index(end))
            self._held(fields[end])
            begin = end

    def _held(self, name: str) -> None:
        """Hold the contacts that are held in the arc that begins, on the state there."""
        driver = self.driver
        if driver.entry.field.name != name:
            field = driver.own.field(name)
            driver.begin(field, field.along(driver.t, driver.entry.x), driver.came)

    def _pass_limit(self, mode: str) -> bool:
        """Whether the run has gone over the limit of a cycle; of what it sees, only what was.

        ``mode``: where the last jump leads.
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
        """Add the impacts that were summed, and begin the rest after them."""
        driver, rows = self.driver, left.curves[place * CURVE_ROWS :][:CURVE_ROWS].copy()
        before, degree, v, r, remaining = left.sums[place].tolist()
        guard = self.tables.guards[left.fired[int(before) - 1]]
        entry, now, memory = driver.entry, driver.record.now, driver.record.memory
        seen = driver.scene
        if memory is not None and not self.windowed:
            seen = driver.model.through([memory.sights[place]])
        field, contact = seen.field(entry.field.name), seen.contact(guard.edge)
        column = field.column(guard.edge)
        errors, x_inf, at_rest = rows[ERRORS, :-1], rows[AT_LIMIT, :-2], rows[AT_REST, :-2]
        curve = r, rows[: int(degree) + 1], remaining, x_inf, float(errors[0]), errors[1:]
        driver.pass_sum(Tail(field, contact, column, now.t, now.low, entry.x, v, *curve), at_rest)

    def _flown(self, left: Left, begin: int, end: int) -> bool:
        """Add the arcs that end with some of the jumps; whether it is time to look for cycles."""
        driver, tables, now = self.driver, self.tables, self.driver.record.now
        fired, (t, low, lengths) = left.fired[begin:end], left.when[begin:end].T.copy()
        modes, edges = tables.named[:, fired]
        jumps = Table(t, low, edges, left.before[begin:end].copy(), left.after[begin:end].copy())
        steps, count = self._flown_in(left, begin, end)
        first = driver.entry.x
        onto = {}
        for k in np.flatnonzero(tables.constrained[fired]).tolist():
            onto[modes[k]] = driver.own.field(modes[k]).onto
            if tables.guards[fired[k]].kind == "release":
                driver.record.released(released(edges[k]), float(t[k]))
        since = driver.record.j, modes, now.t, now.low
        flights = Flights(*since, first, lengths, jumps, steps, onto)
        driver.steps += count
        return driver.flown(flights)

    def _flown_in(self, left: Left, begin: int, end: int) -> tuple[Steps | None, int]:
        """The steps of some of the arcs, if they are kept, and how many; the first has the held."""
        owner = left.owner[: max(int(self.ints[STEPS_MADE]), 0)]
        first, last = owner.searchsorted((begin, end)).tolist()
        count, held = self.opened + last - first, self.open
        self.open, self.opened = [], 0
        if not (self.dense and count):
            return None, count
        return self._made([*held, self._rows(left, slice(first, last), begin)]), count

    def _rows(self, left: Left, rows: slice | np.ndarray, begin: int) -> Rows:
        """Steps as they are left, those of arc ``begin`` being the first's."""
        series = left.series.reshape(-1, self.n, self.order + 1)[rows]
        return left.owner[rows] - begin, left.spans[rows], series

    def _made(self, parts: list[Rows]) -> Steps | None:
        """Steps of arcs in a row, of which only the last part holds more than the first arc, as
        states at the nodes of each."""
        owner, spans, series = map(np.concatenate, zip(*parts, strict=True))
        start, length = spans.T
        if self.outside is None:
            series = terms(series, length[:, None, None])
        else:  # a method's own degree
            used = np.flatnonzero(series.any(axis=(0, 1)))
            series = series[..., : max(used.max(initial=0), 1) + 1]
        degree = series.shape[2] - 1
        powers = nodes(degree)[:, None] ** np.arange(degree + 1)
        return Steps(owner, start, length, np.einsum("sik,jk->sji", series, powers))

    def _last(self, left: Left, goes_on: bool = False) -> StateVector:
        """Add the arc that no jump of the loop has ended, or what has been flown of one that goes
        on; returns the state at its end."""
        place, tau = int(self.ints[JUMPS_MADE]), float(self.floats[TAU])
        return self._arc(left, place, tau, self.now.end.copy(), goes_on)

    def _rings(self, due: float) -> bool:
        """Whether one of the clocks that ring where the arc ends fires."""
        self._come_to_piece()
        driver = self.driver
        end = driver.entry.field.along(due, self.now.end)
        return clocks.first(driver, due, end) is not None

    def _arc(
        self, left: Left, place: int, tau: float, end: StateVector, goes_on: bool = False
    ) -> StateVector:
        """Add an arc, or a part of one that goes on; returns the state at its end."""
        self._come_to_piece()
        driver, (steps, count) = self.driver, self._flown_in(left, place, place + 1)
        segments = [] if steps is None else steps.segments(np.array([tau]))
        driver.steps += count
        driver.passed(tau)
        keep = driver.record.extend if goes_on else driver.record.arc
        return keep(driver.entry.field, driver.entry.x, end, tau, segments)

    @property
    def _fired(self) -> Guard:
        """The guard that fired last, in the driver's field."""
        field, guard = self.driver.entry.field, self.tables.guards[int(self.ints[FIRED])]
        return field.guard(guard.edge)

    def _stand(self, left: Left, status: int) -> None:
        """Where the loop stopped: at the end, or at a jump to judge."""
        driver, place = self.driver, int(self.ints[JUMPS_MADE])
        speed, due = float(self.floats[GAP_SPEED]), float(self.floats[DUE])
        if status == END:
            self._last(left)
            driver.status = Status.REACHED_END
        elif self._fired.kind == "clock" and not self._rings(due):
            x = self._last(left, goes_on=due < self.plan.t1)
            if due == self.plan.t1:
                driver.status = Status.REACHED_END
                return
            driver.spent |= self._over()
            driver.entry = attrs.evolve(driver.entry, x=x)
            clocks.go_by(driver, due, x)
        else:
            driver.tied = self._tied()
            before = self._last(left)
            if self.feed is not None:
                driver.look(before)
            driver.spent |= self._over()
            if driver.record.memory is not None:
                driver.record.memory.told = False
            driver.entry = attrs.evolve(driver.entry, field=driver.field)
            if self.ints[WAS_LOW]:
                driver.bounce(self._fired, before, left.after[place].copy(), speed)
            elif self._fired.kind == "clock":
                clock = clocks.first(driver, due, before)
                driver.ring(clock or self._fired, due, before)
            else:
                driver.jump(self._fired, before)

    def _tied(self) -> dict[str, int]:
        """By edge the sign before its zero, of guards that were zero when the last flight ended."""
        tied, flights = self.now.tied, int(self.ints[FLIGHTS])
        rows = np.flatnonzero((np.abs(tied) == flights) & (tied != 0)).tolist()
        return {self.tables.guards[g].edge: int(tied[g]) // flights for g in rows}

    def _over(self) -> set[str]:
        """Edges that have been taken, or passed, at the time at which the last flight ended."""
        rows = np.flatnonzero(self.now.spent == self.ints[FLIGHTS]).tolist()
        return {self.tables.guards[g].edge for g in rows}

    def _lower(self) -> None:
        """Go on by series of the driver's order, if where the loop stopped only those are numbers:
        of time in a small unit the highest coefficients are beyond them."""
        low, jets = self.driver.solver.order, self.driver.entry.field.jets
        if self.outside is None and jets is not None and self.order > low:
            here = self.driver.t, self.driver.entry.x.tolist()
            if not jets.finite(*here, self.order) and jets.finite(*here, low):
                self.highest = low
