"""One arc: step until a guard fires or the run ends, and land on the guard (rules 1, 2, 4, 5)."""

from __future__ import annotations

from math import isfinite
from typing import Any

import attrs
import numpy as np

from ..clock import Instant
from ..errors import FlowError, OptionError
from ..events import EPS, SHARES, fires, time_scale, zeros
from ..scene import Guard, Scene
from ..scene.lowered import ORDER
from ..segment import Segment
from ..solvers import Solver, Stepper
from ..solvers.kinks import own_length
from ..solvers.taylor_backend import ROUNDING, step_length
from ..zeno.flight import zero_of
from .entry import Entry, describe, expand
from .plan import Plan

#: A step never spans more than this many time scales of a guard that is no polynomial.
REACH = 8.0

#: A flight's end is predicted this many times as far as its series have converged: there their last
#: terms, of order 16, are 1e-6, which is what a step that was made to end there may be off.
FAR = 4

#: An arc's first step, against that at which the method's error reaches the tolerance.
SAFETY = 0.5


@attrs.frozen
class Fired:
    """A guard that fires, and the local time."""

    index: int
    tau: float


@attrs.frozen(eq=False)
class Flown:
    """An arc as flown.

    Attributes
    ----------
    fired : int or None
        The guard that ended it; None at the end of the run.
    grazes : list of (local time, guard, state)
        Tangencies on the way.
    interrupted : bool
        By the keyboard: the arc goes as far as it was flown.
    """

    fired: int | None
    length: float
    x: np.ndarray
    segments: list[Segment]
    grazes: list[tuple[float, int, np.ndarray]]
    interrupted: bool = False


class ArcFlow:
    """Flows one arc from an entry, to ``until`` at most (the end of the run)."""

    def __init__(
        self,
        scene: Scene,
        solver: Solver,
        plan: Plan,
        entry: Entry,
        now: Instant,
        until: float | None = None,
    ) -> None:
        self.scene, self.solver, self.plan, self.now = scene, solver, plan, now
        self.until = plan.t1 if until is None else until
        self.field, self.x, self.series = entry.field, entry.x, entry.series
        self.orders = self.entered = entry.orders
        kept = plan.dense or plan.samples is not None or bool(scene.spec.lags)
        self.wanted = kept or bool(self.field.guards)
        self.ends: dict[Any, float] = {}
        self.grazes: list[tuple[float, int, np.ndarray]] = []

    def run(self) -> Flown:
        """Flow until a guard fires or the run ends."""
        with np.errstate(all="ignore"):  # what is not finite is reported, not warned of
            return self._run()

    def _run(self) -> Flown:
        length = self.now.until(self.until)
        target = self.predict(length)
        stepper = self._begin(length, target)
        if not self.wanted:
            return self._finish(stepper, length)
        segments: list[Segment] = []
        try:
            fired = self._steps(stepper, length, target, segments)
        except KeyboardInterrupt:
            if not segments:
                raise
            last = segments[-1]
            return Flown(None, last.end, last(last.end), segments, self.grazes, True)
        return Flown(fired, stepper.tau, stepper.x, segments, self.grazes)

    def _steps(
        self, stepper: Stepper, length: float, target: float | None, segments: list[Segment]
    ) -> int | None:
        """Add step after step to ``segments``; the guard that fires, None if none does."""
        fired = None
        while fired is None and stepper.tau < length:
            start, x = stepper.tau, stepper.x
            scales = self._scales(start, x)
            limit = target if target is not None and target > start else length
            limit = min(limit, length, start + REACH * min(scales, default=float("inf")))
            self._step(stepper, limit)
            segment = stepper.segment()
            try:
                fired = self._first_event(segment, stepper, scales, target)
            except FlowError as fault:
                raise FlowError(f"{self._where(start, x)}: {fault}") from None
            if fired is not None:
                landed = self._land(stepper, segment, fired) if fired.tau > start else None
                if landed is None:
                    stepper.tau, stepper.x = start, x
                    break
                segment = landed
                stepper.tau = landed.end
            segments.append(segment)
            self.orders = [0] * len(self.orders)
        return None if fired is None else fired.index

    def _where(self, tau: float = 0.0, x: np.ndarray | None = None) -> str:
        return describe(self.scene, self.field, self.now.t + tau, self.x if x is None else x)

    def _begin(self, length: float, target: float | None) -> Stepper:
        if not all(map(isfinite, self.field.rhs(self.now.t, self.x.tolist()))):
            raise FlowError(f"{self._where()}: the flow is not finite")
        first, sizes = self.first_step(length), None
        if target is not None:
            powers = target ** np.arange(1, ORDER + 1)
            sizes = np.abs(np.array(self.series[0])[:, 1:] * powers).max(axis=1)
            first = min(first or target, target)
        try:
            return self.solver.begin(self.field, self.now.t, self.x, length, first, sizes)
        except FlowError as fault:
            raise FlowError(f"{self._where()}: {fault}") from None
        except OptionError:
            raise
        except ValueError as fault:
            raise FlowError(f"{self._where()}: the flow is not finite ({fault})") from None

    def _finish(self, stepper: Stepper, length: float) -> Flown:
        """To the end, where nothing is watched and nothing kept."""
        try:
            stepper.finish(length)
        except FlowError as fault:
            raise FlowError(f"{self._where(stepper.tau, stepper.x)}: {fault}") from None
        return Flown(None, stepper.tau, stepper.x, [], [])

    def _step(self, stepper: Stepper, limit: float) -> None:
        tau, x = stepper.tau, stepper.x
        try:
            stepper.step(limit)
        except FlowError as fault:
            raise FlowError(f"{self._where(tau, x)}: {fault}") from None

    def first_step(self, length: float) -> float | None:
        """Where the first term that the method neglects reaches the tolerance."""
        if self.series is None:
            return None
        k = min(self.solver.order + 1, ORDER)
        first = float("inf")
        atol = np.broadcast_to(self.plan.atol, self.x.shape)
        for c, absolute in zip(self.series[0], atol.tolist(), strict=True):
            allowed = absolute + self.plan.rtol * abs(c[0])
            for power in (k - 1, k):
                if c[power]:
                    first = min(first, (allowed / abs(c[power])) ** (1.0 / power))
        most = length / SAFETY if self.scene.spec.lags else length  # a window may be one step
        return SAFETY * min(most, first) if first > 0 else None

    def predict(self, length: float) -> float | None:
        """The end of a short flight onto a contact, from its Taylor series (2)."""
        if self.series is None:
            return None
        best = None
        for index, guard in enumerate(self.field.guards):
            if guard.kind == "contact" and self.orders[index] <= 1:
                gap = [0.0 if self.orders[index] else self.series[1][index][0]]
                gap += self.series[1][index][1:]
                zero = zero_of(
                    gap, FAR * min(step_length(self.series[0]), own_length(gap, ROUNDING))
                )
                if zero is not None and zero < length:
                    best = zero if best is None else min(best, zero)
        return best

    def _scales(self, tau: float, x: np.ndarray) -> list[float]:
        """Times over which guards that are no polynomials are smooth."""
        guards = self.field.guards
        if all(guard.affine for guard in guards):
            return []
        share = (self.plan.t1 - self.plan.t0) / SHARES
        series = self.series if tau == 0.0 else expand(self.field, self.now.t + tau, x)
        scales = []
        for index, guard in enumerate(guards):
            size = max((abs(float(x[i])) for i in guard.uses), default=0.0)
            own = share if series is None else min(share, time_scale(series[1][index], size))
            scales.append(float("inf") if guard.affine else own)
        return scales

    def _first_event(
        self, segment: Segment, stepper: Stepper, scales: list[float], target: float | None
    ) -> Fired | None:
        """The first guard that fires in a step: earliest, then in declared order (1, 4)."""
        best: Fired | None = None
        grazes: list[tuple[float, int]] = []
        for index in range(len(self.field.guards)):
            tau = self._guard_event(index, segment, stepper, scales, target, grazes)
            if tau is None:
                continue
            tie = 4 * np.spacing(self.now.t + tau)
            if best is None or tau < best.tau - tie:
                best = Fired(index, tau)
        for tau, index in sorted(grazes):
            if best is None or tau < best.tau:
                self.grazes.append((tau, index, segment(tau)))
        return best

    def _guard_event(
        self,
        index: int,
        segment: Segment,
        stepper: Stepper,
        scales: list[float],
        target: float | None,
        grazes: list[tuple[float, int]],
    ) -> float | None:
        guard = self.field.guards[index]
        tolerance = self.plan.limit + self.plan.rtol * max(
            (abs(float(stepper.x[i])) for i in guard.uses), default=0.0
        )
        scale = scales[index] if scales else float("inf")
        order, t0 = self.orders[index], self.now.t
        for zero in zeros(guard, segment, t0, order, scale, tolerance, self.ends):
            if zero.direction == 0:
                grazes.append((zero.tau, index))
            elif fires(guard.crossing, zero.direction):
                if self._touches(guard, zero.tau, segment, tolerance):
                    grazes.append((zero.tau, index))
                else:
                    return zero.tau
        if target is not None and segment.end == target and guard.kind == "contact":
            near = self._near_end(index, segment, stepper)
            if near is not None:
                return near
        return segment.start if self._sunk(index, segment, stepper, tolerance) else None

    def _touches(self, guard: Guard, tau: float, segment: Segment, tolerance: float) -> bool:
        """Whether a crossing goes no deeper than the tolerance: a tangency (1)."""
        _, first, second = guard.lie(self.now.t + tau, segment(tau).tolist())
        return first * second <= 0 and first * first <= 2 * abs(second) * tolerance

    def _near_end(self, index: int, segment: Segment, stepper: Stepper) -> float | None:
        """A step made onto a predicted impact ends within rounding of it, on either side."""
        t, x = self.now.t + segment.end, stepper.x.tolist()
        value, rate, _ = self.field.guards[index].lie(t, x)
        near = abs(value) <= -1e-6 * rate * segment.length
        return segment.end if near or abs(value) <= self._rounding(index, t, x) else None

    def _rounding(self, index: int, t: float, x: list[float]) -> float:
        """What rounding can make of a guard that is zero, and did where the arc left it."""
        size = float(self.scene.rounding(self.field.guards[index], self.field)(t, x)[0])
        left = self.series is not None and self.entered[index] == 1
        return 64 * EPS * size + (2.0 * abs(self.series[1][index][0]) if left else 0.0)

    def _sunk(self, index: int, segment: Segment, stepper: Stepper, tolerance: float) -> bool:
        """Whether a contact's gap is negative with no zero seen: it began below rounding."""
        guard = self.field.guards[index]
        value = self.ends.get(guard.edge, 0.0)
        if guard.kind != "contact" or value >= -tolerance:
            return False
        return -value > self._rounding(index, self.now.t + segment.end, stepper.x.tolist())

    def _land(self, stepper: Stepper, segment: Segment, fired: Fired) -> Segment | None:
        """End the step on the guard, to rounding (5); None if that is the step's start."""
        guard, tau = self.field.guards[fired.index], fired.tau
        small, least = 1e-6 * segment.length, segment.start + 1e-13 * segment.length
        last, shift = self.now.until(self.until), 0.0
        try:
            if segment.end - tau > small:
                if tau <= least:
                    return None
                segment = stepper.land(tau)
            for _ in range(4):
                t, x = self.now.t + stepper.tau, stepper.x.tolist()
                value, rate, _ = guard.lie(t, x)
                shift = -value / rate if rate else 0.0
                if abs(shift) <= small or abs(value) <= self._rounding(fired.index, t, x):
                    break
                tau = min(stepper.tau + shift, last)
                if tau <= least:
                    return None
                segment = stepper.land(tau)
        except FlowError as fault:
            raise FlowError(f"{self._where(tau)}: {fault}") from None
        if not abs(shift) <= small or stepper.tau + shift > last:
            return segment
        flow = np.array(self.field.rhs(self.now.t + stepper.tau, stepper.x.tolist()))
        stepper.x = stepper.x + shift * flow
        stepper.tau += shift
        return segment.cut(stepper.tau - segment.start)
