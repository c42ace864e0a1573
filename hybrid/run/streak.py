"""The Python side of a compiled streak: from entries to lanes, from records to arcs and jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import numpy as np

from ..automaton.markers import Crossing
from ..compiled.ask import require_series
from ..compiled.lane import END, JUDGE, JUMP, RUNNING, Lane, Run
from ..compiled.streak import Record, Streak, Watch
from ..compiled.system import system_of
from ..compiled.turn import AHEAD, PATIENCE
from ..log import Flights, Steps, Table, joined
from ..scene import Guard
from ..solvers.base import FINEST, Solver
from ..trajectory import Status
from .arc import ArcFlow
from .cycles import pass_limit

if TYPE_CHECKING:
    from .driver import Driver

#: Largest power of the local time by which a guard may vanish at the start of a streak.
ORDERS = 3


class Streaks:
    """Runs a driver's plain arcs compiled, where its solver can.

    ``fly`` goes on from the driver's entry as far as nothing needs judgement, and leaves the
    driver with an entry, a jump done, or its status set.
    """

    def __init__(self, driver: Driver, solver: Solver) -> None:
        self.driver, self.plan = driver, driver.plan
        dense = self.plan.dense or self.plan.samples is not None
        code = driver.scene.code
        method = solver.compiled
        system = system_of(code)
        require_series(system, method.name)
        key = ("streak", method, dense)
        self.streak: Streak = code.once(key, lambda: Streak(system, method, dense))
        self.system, self.dense = system, dense
        self.smooth = not driver.scene.guards_jump
        self.h: float | None = None
        self.open: list[Steps] = []
        self.passed = False

    def takes(self) -> bool:
        """Whether the arc that begins at the driver's entry is plain, and somebody watches it."""
        entry = self.driver.entry
        if not (self.dense or entry.field.guards):
            return False
        declared = self.smooth and entry.field.name in self.system.modes
        declared = declared and not _may_tie(entry.field.guards)
        plain = declared and max(entry.orders, default=0) <= ORDERS
        return plain and self.plan.zeno != "truncate"

    def fly(self) -> None:
        """Go on until something needs judgement, or the run ends."""
        lane = self._begin()
        try:
            lane, status = self._chunks(lane)
        except KeyboardInterrupt:
            steps = joined(self.open)
            if steps is not None and len(steps.arc):
                self._arc(steps.values[-1, -1], float(steps.start[-1] + steps.length[-1]))
            raise
        self.h = float(lane.going.h)
        if self.driver.status is None and not self.passed:
            self._stand(lane, status)

    def _chunks(self, lane: Lane) -> tuple[Lane, int]:
        """Chunk after chunk: each is computed while what the last one left is being kept."""
        self.driver.solver.rejected = None  # records have no row for those
        run, watch = self._asked()
        self.open, self.passed = [], False
        self.driver.watch_pace()
        following = self.streak.chunk(run, watch, lane)
        while True:
            lane, records = following
            status = int(lane.going.status)
            if status == RUNNING:
                following = self.streak.chunk(run, watch, lane)
            records = jax.tree.map(np.asarray, records)
            self._keep(records)
            self._count(lane, records)
            if self.plan.progress is not None:
                self.plan.progress(float(lane.now))
            if self.driver.status is not None or self.passed or status != RUNNING:
                return lane, status

    def _count(self, lane: Lane, records: Record) -> None:
        """Look at the pace of the arc that is going on."""
        if np.any(records.jump):
            self.driver.watch_pace()
        elif made := int(np.count_nonzero(records.step)):
            self.driver.count_steps(float(lane.going.tau), np.asarray(lane.going.x), made)

    def _asked(self) -> tuple[Run, Watch]:
        plan, driver = self.plan, self.driver
        atol = np.broadcast_to(plan.atol, driver.entry.x.shape).astype(float)
        bounds = np.int64(2**62), np.int64(2**62)
        rtol = max(plan.rtol, FINEST)
        run = Run(driver.scene.parameters, plan.t0, plan.t1, rtol, atol, *bounds)
        return run, Watch(plan.patience, PATIENCE)

    def _begin(self) -> Lane:
        """The lane of the driver's entry."""
        driver, entry, plan = self.driver, self.driver.entry, self.plan
        now, edges = driver.record.now, [guard.edge for guard in entry.field.guards]
        first = ArcFlow(driver.scene, driver.solver, plan, entry, now)
        length = now.until(plan.t1)
        flight = first.predict(length)
        h = self.h or first.first_step(length) or min(length, 1e-3)
        values = [guard.value(now.t, entry.x.tolist()) for guard in entry.field.guards]
        padded = np.zeros(self.system.width)
        padded[: len(values)] = values
        orders = np.zeros(self.system.width, dtype=int)
        orders[: len(values)] = entry.orders
        watch = driver.watch
        start = {
            "t": now.t,
            "low": now.low,
            "mode": self.system.modes.index(entry.field.mode),
            "orders": orders,
            "limit": np.inf if flight is None else AHEAD * flight,
            "series": edges.index(watch.contact) if watch.contact in edges else -1,
            "count": watch.count,
            "tried": watch.tried,
        }
        going = {"h": h, "ends": padded, "largest": np.abs(padded)}
        return self.streak.begin(entry.x, start, going)

    # -- what a chunk left ----------------------------------------------------------------

    def _keep(self, records: Record) -> None:
        """Add the arcs and jumps of a chunk, and the steps of the arc still going."""
        driver, begin = self.driver, 0
        driver.steps += int(np.count_nonzero(records.step))
        rows = np.flatnonzero(records.jump)
        while len(rows) and driver.status is None and not self.passed:
            count = driver.room(records.t[rows])
            self._flown(records, begin, rows[:count])
            begin, rows = rows[count - 1] + 1, rows[count:]
        if self.dense and driver.status is None and not self.passed:
            self.open.append(_steps(records, slice(begin, None)))

    def _flown(self, records: Record, begin: int, rows: np.ndarray) -> None:
        """Add the arcs that end with the jumps of some rows; the first has the steps from begin."""
        driver, now, first = self.driver, self.driver.record.now, self.driver.entry.x
        modes, guards = self._fired(records.slot[rows].tolist())
        if self.dense:
            self.open.append(_steps(records, slice(begin, rows[-1] + 1)))
        steps, self.open = joined(self.open), []
        edges = np.array([guard.edge for guard in guards], dtype=object)
        t, low, before, after, lengths = (column[rows] for column in _columns(records))
        jumps = Table(t, low, edges, before, after)
        flights = Flights(driver.record.j, modes, now.t, now.low, first, lengths, jumps, steps)
        due, to = driver.flown(flights), guards[-1].to
        driver.arrive(driver.scene.field(to), jumps.after[-1], guards[-1], jumps.before[-1])
        self.passed = due and pass_limit(driver, to)

    def _fired(self, slots: list[int]) -> tuple[list[str], list[Guard]]:
        """The modes left and the guards that fired, by their slots."""
        field, modes, guards = self.driver.entry.field, [], []
        for slot in slots:
            guard = field.guards[slot]
            modes.append(field.name)
            guards.append(guard)
            self.driver.watch.jumped(guard)
            field = self.driver.scene.field(guard.to)
        return modes, guards

    def _arc(self, last: np.ndarray, tau: float) -> None:
        """Add an arc that no jump ended."""
        driver = self.driver
        steps, self.open = joined(self.open), []
        segments = [] if steps is None else steps.segments(np.array([tau]))
        driver.record.arc(driver.entry.field, driver.entry.x, last, tau, segments)

    def _stand(self, lane: Lane, status: int) -> None:
        """Where the lane stopped: the end, a jump to judge, or an arc to fly anew.

        A jump after no flight is none: the guard was zero before, and what it did went unseen.
        """
        driver, going = self.driver, lane.going
        x, tau = np.asarray(going.x), float(going.tau)
        if status == END:
            self._require_inside(tau, x)
            self._arc(x, tau)
            driver.status = Status.REACHED_END
        elif status == JUDGE and int(going.stage) == JUMP and tau > 0:
            guard: Guard = driver.entry.field.guards[int(going.slot)]
            self._arc(x, tau)
            driver.watch.tried = float(lane.tried)
            driver.jump(guard, x)
        else:
            driver.look_again()

    def _require_inside(self, tau: float, x: np.ndarray) -> None:
        """Look at the end of the run at what no chunk was asked: is it inside the domain?"""
        driver = self.driver

        def arc() -> ArcFlow:
            return ArcFlow(driver.scene, driver.solver, self.plan, driver.entry, driver.record.now)

        if arc().outside(tau, x):
            driver.renew()
            arc().require_inside(tau, x)


def _may_tie(guards: tuple[Guard, ...]) -> bool:
    """Whether a guard that fires either way has others beside it: array code passes it in a tie."""
    return len(guards) > 1 and any(guard.crossing is Crossing.EITHER for guard in guards)


def _columns(records: Record) -> tuple[np.ndarray, ...]:
    return records.t, records.low, records.before, records.after, records.tau


def _steps(records: Record, rows: slice) -> Steps:
    """The steps in some rows, the first of which belongs to the first arc."""
    made, jumps = records.step[rows], records.jump[rows]
    columns = np.cumsum(jumps) - jumps, records.start[rows], records.length[rows]
    return Steps(*(column[made] for column in (*columns, records.values[rows])))
