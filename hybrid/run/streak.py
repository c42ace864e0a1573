"""The Python side of a compiled streak: from entries to lanes, from records to arcs and jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..compiled.lane import END, JUDGE, JUMP, RUNNING, Lane, Run
from ..compiled.streak import Streak, Watch
from ..compiled.system import system_of
from ..compiled.turn import AHEAD
from ..scene import Guard
from ..segment import Segment, from_values
from ..solvers.base import FINEST, Solver
from ..trajectory import Status
from .arc import ArcFlow
from .cycles import pass_limit
from .plan import PATIENCE

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
        key = ("streak", method, dense)
        self.streak: Streak = code.once(key, lambda: Streak(system, method, dense))
        self.degree = method.degree
        self.system, self.dense = system, dense
        self.h: float | None = None
        self.passed = False

    def takes(self) -> bool:
        """Whether the arc that begins at the driver's entry is plain, and somebody watches it."""
        entry = self.driver.entry
        if not (self.dense or entry.field.guards):
            return False
        declared = entry.field.name in self.system.modes
        plain = declared and max(entry.orders, default=0) <= ORDERS
        return plain and self.plan.zeno != "truncate"

    def fly(self) -> None:
        """Go on until something needs judgement, or the run ends."""
        lane = self._begin()
        try:
            lane, status = self._chunks(lane)
        except KeyboardInterrupt:
            if self.segments:
                last = self.segments[-1]
                self._arc(last(last.end), last.end)
            raise
        self.h = float(lane.going.h)
        if self.driver.status is None and not self.passed:
            self._stand(lane, status)

    def _chunks(self, lane: Lane) -> tuple[Lane, int]:
        """Chunk after chunk: each is computed while what the last one left is being kept."""
        run, watch = self._asked()
        self.segments: list[Segment] = []
        self.passed = False
        following = self.streak.chunk(run, watch, lane)
        while True:
            lane, records = following
            status = int(lane.going.status)
            if status == RUNNING:
                following = self.streak.chunk(run, watch, lane)
            self._keep(jax.tree.map(np.asarray, records))
            if self.plan.progress is not None:
                self.plan.progress(float(lane.now))
            if self.driver.status is not None or self.passed or status != RUNNING:
                return lane, status

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

    def _keep(self, records: Any) -> None:
        """Add the arcs and jumps of a chunk, and the segments of the arc still going."""
        driver, jumps = self.driver, records.jump.tolist()
        driver.reach = max(
            driver.reach, float(np.max(np.abs(records.after[records.jump]), initial=0))
        )
        if self.dense:
            coefficients = np.einsum("ij,kjn->kin", from_values(self.degree), records.values)
            steps = [c.tolist() for c in (records.step, records.start, records.length)]
        slots, taus = records.slot.tolist(), records.tau.tolist()
        for row, jump in enumerate(jumps):
            if driver.status is not None or self.passed:
                break
            if self.dense and steps[0][row]:
                segment = Segment(steps[1][row], steps[2][row], coefficients[row])
                self.segments.append(segment)
            if jump:
                self._jumped(slots[row], taus[row], records.before[row], records.after[row])

    def _jumped(self, slot: int, tau: float, before: np.ndarray, after: np.ndarray) -> None:
        """An arc and the jump that ended it."""
        driver = self.driver
        guard = driver.entry.field.guards[slot]
        self._arc(before, tau)
        if guard.kind == "contact":
            driver.watch.saw(guard.edge)
        else:
            driver.watch.reset()
        due = driver.add_jump(guard.edge, before, after)
        self.passed = due and pass_limit(driver, guard.to)
        if not self.passed:
            driver.arrive(driver.scene.field(guard.to), after, guard)

    def _arc(self, last: np.ndarray, tau: float) -> None:
        driver = self.driver
        segments, self.segments = self.segments, []
        if segments:
            segments[-1] = segments[-1].cut(tau - segments[-1].start)
        driver.record.arc(driver.entry.field, driver.entry.x, last, tau, segments)

    def _stand(self, lane: Lane, status: int) -> None:
        """Where the lane stopped: the end, a jump to judge, or an arc to fly anew."""
        driver, going = self.driver, lane.going
        x, tau = np.asarray(going.x), float(going.tau)
        if status == END:
            self._arc(x, tau)
            driver.status = Status.REACHED_END
        elif status == JUDGE and int(going.stage) == JUMP:
            guard: Guard = driver.entry.field.guards[int(going.slot)]
            self._arc(x, tau)
            driver.watch.tried = float(lane.tried)
            driver.jump(guard, x)
        else:
            driver.renew()
            driver.flow_arc()
