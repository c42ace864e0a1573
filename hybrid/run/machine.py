"""The Python side of the rules' own loop: arcs that are plain are flown as machine code.

:mod:`hybrid.rules.advance` goes on as far as nothing needs judgement. Steps that it cannot make
itself, those of another solver, are made here when it asks for them. What it leaves is kept, and
the driver judges what comes next.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..log import Flights, Steps, Table, joined
from ..rules import unit
from ..rules.arrays import Left, Now, Room
from ..rules.places import (
    BEGINS,
    COUNT,
    END,
    ENTERED,
    EXPANSIONS,
    FIELD,
    FIRED,
    FULL,
    JUMP,
    JUMPS,
    LAND_ON,
    LANDS,
    LOW,
    MADE,
    NEXT,
    PHASE,
    SERIES,
    STEP,
    STEPS,
    TAU,
    TRIED,
    WALKS,
    T,
)
from ..scene.lowered import ORDER
from ..segment import nodes
from ..trajectory import Status
from .cycles import pass_limit
from .outside import Outside
from .plan import PATIENCE
from .watch import Watch

if TYPE_CHECKING:
    from .driver import Driver

#: Jumps and steps for which there is room at first; how many times more there is after each call
#: that has filled it, and at most: the keyboard is heard between calls.
JUMPS_KEPT, STEPS_KEPT, MORE, MOST = 64, 512, 4, 1 << 15

#: Steps in a call after which a run is left to compiled streaks, where the solver has such, the
#: present arc from its start: they take about as long as compiling one.
LONG = 2048


class Machine:
    """Flies a driver's plain arcs by the rules' own loop: with Taylor series, or with another
    solver's steps.

    ``fly`` goes on from the driver's entry as far as nothing needs judgement, and leaves the
    driver with an entry, a jump done, or its status set.
    """

    def __init__(self, driver: Driver) -> None:
        scene, solver, plan = driver.scene, driver.solver, driver.plan
        self.driver, self.plan = driver, plan
        self.tables = scene.tables if solver.whole else scene.watched
        self.dense = plan.dense or plan.samples is not None
        self.outside = None if solver.whole else Outside(driver, self.tables.fields, self.dense)
        n, self.order = scene.spec.dimension, solver.order if solver.whole else ORDER
        series, steps = (PATIENCE, plan.patience), (plan.longest(0.0), plan.max_step)
        atol = [plan.atol] * n if isinstance(plan.atol, float) else plan.atol
        last = (0, *solver.loss(n)) if solver.whole else (solver.order, 0.0, *atol)
        self.run = np.array([plan.t1, plan.limit, plan.rtol, *series, *steps, *last], dtype=float)
        self.floats, self.ints = np.zeros(8), np.zeros(13, dtype=np.int64)
        self.states = np.zeros((3, n))
        self.size: tuple[int, ...] = (JUMPS_KEPT, STEPS_KEPT)
        self.passed = False
        self.open: list[Steps] = []
        self.opened = 0

    def takes(self) -> bool:
        """Whether the arc that begins at the driver's entry may be plain."""
        entry = self.driver.entry
        number = self.tables.number(entry.field)
        plain = self.plan.zeno != "truncate" and max(entry.orders, default=0) <= 1
        return plain and self.tables.plain(number)

    def fly(self) -> None:
        """Go on until something needs judgement, or the run ends."""
        driver, now, room = self.driver, self._begin(), self.tables.room(self.order)
        self.passed, self.open, self.opened = False, [], 0
        while True:
            left = self._left()
            status = self._advance(now, room, left)
            self._expanded()
            self._keep(left)
            ended = driver.status is not None or self.passed
            self._tell(0.0 if ended else self._hold(left), left)
            if ended or self._spent(status, left):
                return
            driver.watch = Watch(*self._series())
            if status in (FULL, STEP) and driver.flyer is not self:
                driver.renew()
                return
            if status != FULL:
                self._stand(left, status)
                return
            self.size = tuple(min(MORE * size, MOST) for size in self.size)

    @property
    def _going(self) -> int:
        """Steps so far of the arc that the loop is in the middle of, its arrays being full."""
        return int(self.ints[MADE]) if self.ints[PHASE] == WALKS else 0

    def _hold(self, left: Left) -> float:
        """Keep the steps of the arc that goes on; returns the local time reached in it."""
        if not self._going:
            return 0.0
        rows, tau = left.owner == self.ints[JUMPS], float(self.floats[TAU])
        if not self.opened:
            self.driver.watch_pace()
        made = int(np.count_nonzero(rows))
        self.opened += made
        self.driver.count_steps(tau, self.states[1], made)
        if self.dense:
            self.open.append(self._made(left, rows, int(self.ints[JUMPS])))
        return tau

    def _spent(self, status: int, left: Left) -> bool:
        """Whether the run has made all its steps; keeps what has been flown of the arc."""
        spent = self.driver.steps + self.opened >= self.plan.max_steps
        if spent and status == FULL and self._going:
            self._arc(left, int(self.ints[JUMPS]))
        return spent and status == FULL

    def _tell(self, tau: float, left: Left) -> None:
        """Say how far the run is; if it is stopped there, keep what has been flown of the arc."""
        try:
            if self.plan.progress is not None:
                self.plan.progress(self.driver.t + tau)
        except KeyboardInterrupt:
            if tau > 0.0:
                self._arc(left, int(self.ints[JUMPS]))
            raise

    def _expanded(self) -> None:
        """Add the expansions of a call, which are what Taylor's steps evaluate."""
        solver, made = self.driver.solver, int(self.ints[EXPANSIONS])
        if self.outside is None:
            solver.evaluations = (solver.evaluations or 0) + made
            self.tables.flown(made)

    def _advance(self, now: Now, room: Room, left: Left) -> int:
        """Call the loop, and make the steps that it asks for."""
        advance, automaton = unit("advance").advance, self.tables.automaton
        try:
            with np.errstate(all="ignore"):  # what is not finite is reported, not warned of
                while True:
                    status: int = advance(automaton, self.run, now, room, left)
                    if status not in (STEP, LAND_ON):
                        return status
                    assert self.outside is not None
                    if self.driver.compiles and len(self.outside.arcs) > LONG:
                        self.driver.hot = True
                        return STEP
                    (self.outside.step if status == STEP else self.outside.land)(now, room)
        except KeyboardInterrupt:
            self._interrupted(now, left)
            raise

    def _interrupted(self, now: Now, left: Left) -> None:
        """Keep the arcs that have ended, and of the present one the steps that have been made."""
        self._keep(left)
        if self.driver.status is not None or self.passed or self.outside is None:
            return
        if self.ints[PHASE] == LANDS:
            self.outside.undo(now)
        elif self.ints[MADE]:
            self.floats[TAU] = self.floats[NEXT]
        if self.ints[MADE]:
            self._arc(left, int(self.ints[JUMPS]))

    def _series(self) -> tuple[str | None, int, float]:
        """The series of impacts that goes on: the contact, how many, and the speed last tried."""
        guard, count = int(self.ints[SERIES]), int(self.ints[COUNT])
        contact = self.tables.guards[guard].edge if guard >= 0 else None
        return contact, count, float(self.floats[TRIED])

    def _begin(self) -> Now:
        """The state of the driver's entry."""
        driver, entry = self.driver, self.driver.entry
        now, guards = driver.record.now, entry.field.guards
        field = self.tables.number(entry.field)
        first, contact = self.tables.first(field), driver.watch.contact
        series = [g for g, guard in enumerate(guards, first) if guard.edge == contact]
        floats, ints = self.floats, self.ints
        floats[T], floats[LOW], floats[TAU] = now.t, now.low, 0.0
        ints[FIELD], ints[FIRED], ints[ENTERED], ints[PHASE] = field, -1, 1, BEGINS
        ints[SERIES], ints[COUNT] = series[0] if series else -1, driver.watch.count
        floats[TRIED] = driver.watch.tried
        self.states[0], self.states[2] = entry.x, driver.seen
        orders = np.zeros(self.tables.widest, dtype=np.int64)
        orders[: len(entry.orders)] = entry.orders
        x, end, seen = self.states
        return Now(floats, ints, x, end, seen, orders, np.zeros(len(orders), dtype=np.int64))

    def _left(self) -> Left:
        """Arrays for what a call leaves, and the counts at zero."""
        n, (jumps, steps) = self.states.shape[1], self.size
        if self.outside is not None:
            self.outside.begin()
            jumps, steps = 1 if self.plan.progress is not None else jumps, 0
        jumps = min(jumps, self.plan.max_jumps - self.driver.record.made)
        self.ints[JUMPS], self.ints[STEPS], self.ints[EXPANSIONS] = 0, -self._going, 0
        return Left(
            np.empty((jumps, 3)),
            np.empty(jumps, dtype=np.int64),
            np.empty((jumps, n)),
            np.empty((jumps, n)),
            np.empty(steps, dtype=np.int64),
            np.empty((steps, 2)),
            np.empty((steps * n if self.dense else 0, self.order + 1)),
        )

    # -- what a call left -------------------------------------------------------------------

    def _keep(self, left: Left) -> None:
        """Add the arcs that ended with a jump."""
        driver, begin, made = self.driver, 0, int(self.ints[JUMPS])
        while begin < made and driver.status is None and not self.passed:
            end = begin + driver.room(left.when[begin:made, 0])
            self._flown(left, begin, end)
            begin = end

    def _flown(self, left: Left, begin: int, end: int) -> None:
        """Add the arcs that end with some of the jumps."""
        driver, tables, now = self.driver, self.tables, self.driver.record.now
        fired = left.fired[begin:end].tolist()
        edges = np.array([tables.guards[g].edge for g in fired], dtype=object)
        t, low, lengths = left.when[begin:end].T
        jumps = Table(t, low, edges, left.before[begin:end], left.after[begin:end])
        modes = [tables.modes[g] for g in fired]
        steps, count = self._flown_in(left, begin, end)
        first = driver.entry.x
        flights = Flights(driver.record.j, modes, now.t, now.low, first, lengths, jumps, steps)
        driver.steps += count
        due, guard = driver.flown(flights), tables.guards[fired[-1]]
        driver.arrive(driver.scene.field(guard.to), jumps.after[-1], guard, jumps.before[-1])
        self.passed = due and pass_limit(driver, guard.to)

    def _flown_in(self, left: Left, begin: int, end: int) -> tuple[Steps | None, int]:
        """The steps of some of the arcs, if they are kept, and how many; the first has the held."""
        if self.outside is not None:
            steps = self.outside.steps(begin, end) if self.dense else None
            return steps, self.outside.count(begin, end)
        owner = left.owner[: max(int(self.ints[STEPS]), 0)]
        rows = (owner >= begin) & (owner < end)
        count, held = self.opened + int(np.count_nonzero(rows)), self.open
        self.open, self.opened = [], 0
        return joined([*held, self._made(left, rows, begin)]) if self.dense else None, count

    def _made(self, left: Left, rows: np.ndarray, begin: int) -> Steps:
        """Steps as states at the nodes of each, those of arc ``begin`` being the first's."""
        n, count = self.states.shape[1], len(rows)
        start, length = left.spans[:count][rows].T
        series = left.series[: n * count].reshape(count, n, self.order + 1)[rows]
        powers = np.arange(self.order + 1)
        scaled = series * length[:, None, None] ** powers
        values = np.einsum("sik,jk->sji", scaled, nodes(self.order)[:, None] ** powers)
        return Steps(left.owner[:count][rows] - begin, start, length, values)

    def _arc(self, left: Left, made: int) -> np.ndarray:
        """Add an arc that no jump of the loop has ended; returns the state at its end."""
        driver, tau = self.driver, float(self.floats[TAU])
        (steps, count), end = self._flown_in(left, made, made + 1), self.states[1].copy()
        segments = [] if steps is None else steps.segments(np.array([tau]))
        driver.steps += count
        return driver.record.arc(driver.entry.field, driver.entry.x, end, tau, segments)

    def _stand(self, left: Left, status: int) -> None:
        """Where the loop stopped: at the end, at a jump to judge, or at an arc to fly anew."""
        driver = self.driver
        if status == END:
            self._arc(left, int(self.ints[JUMPS]))
            driver.status = Status.REACHED_END
        elif status == JUMP:
            guard = self.tables.guards[int(self.ints[FIRED])]
            driver.jump(guard, self._arc(left, int(self.ints[JUMPS])))
        else:
            driver.look_again()
