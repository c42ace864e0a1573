"""The loop of a run: flow an arc, find what ends it, jump, go on.

The rules are those of ``docs/semantics.md``; the numbers in comments are its rules.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import attrs
import numpy as np

from .automaton.markers import Crossing
from .automaton.record import Record
from .clock import Instant
from .errors import DomainError, FlowError, HybridError, JumpLoopError, StartError, ZenoError
from .events import EPS, fires, higher_noise, time_scale, vanishing_order, zeros
from .scene import Contact, Field, Guard, Scene, released
from .scene.scene import ORDER
from .segment import Segment, from_values, nodes
from .solvers import Solver, Stepper
from .solvers.taylor_backend import step_length
from .trajectory import (
    Accumulation,
    Arc,
    Jump,
    JumpRow,
    Part,
    Status,
    TailPart,
    Truncation,
    explain,
)
from .zeno.accumulate import Tail, close
from .zeno.flight import zero_of

#: Jumps at one time after which a run is taken to be caught in a loop.
LOOP = 100

#: A guard nearer to zero than this share of the state is looked at for rounding.
CLOSE = 1e-6

#: Gap and gap speed, relative to the state, below which a held contact stays closed.
CLOSED = 1e-12

#: Guards that are no polynomials are sampled in at least so many pieces over a run.
SHARES = 100

#: A step never spans more than this many time scales of a guard that is no polynomial.
REACH = 8.0

#: An arc's first step, against that at which the method's error reaches the tolerance.
SAFETY = 0.5

#: Impacts are summed anew only after their speed has fallen to this share.
PATIENCE = 0.6


@attrs.frozen
class Plan:
    """What a run was asked for, checked."""

    t0: float
    t1: float
    rtol: float
    atol: Any
    zeno: str
    max_jumps: int
    cap: int | None
    dense: bool
    samples: np.ndarray | None
    progress: Callable[[float], None] | None
    accumulations: int | None = None
    closing: float = 1.0
    patience: int = 2


@attrs.frozen
class Fired:
    """A guard that fires, and the local time."""

    index: int
    tau: float


class Watch:
    """A series of impacts of one contact, with no other jump between."""

    def __init__(self) -> None:
        self.contact: str | None = None
        self.count = 0
        self.tried = float("inf")

    def saw(self, edge: str) -> None:
        if edge != self.contact:
            self.contact, self.count, self.tried = edge, 0, float("inf")
        self.count += 1

    def reset(self) -> None:
        self.contact = None


class Driver:
    """One run."""

    def __init__(self, scene: Scene, solver: Solver, plan: Plan) -> None:
        self.scene, self.solver, self.plan = scene, solver, plan
        self.now = Instant(plan.t0)
        self.parts: list[Part] = []
        self.own_jumps: dict[int, JumpRow] = {}
        self.zeno: list[Accumulation] = []
        self.tails: list[Tail | None] = []
        self.grazings: list[Jump] = []
        self.sampled: list[np.ndarray] = []
        self.status: Status | None = None
        self.j = 0
        self.watch = Watch()
        self.recent: deque[tuple[float, str]] = deque(maxlen=LOOP)
        self.limit = float(np.max(plan.atol))
        self.extent = np.zeros(scene.spec.dimension)

    def run(self, mode: str, x: np.ndarray) -> None:
        """From the start to the end of the run."""
        base, _, rest = mode.partition(".rest(")
        self.enter(base, x, {}, (rest.removesuffix(")"),) if rest else (), starting=True)
        try:
            while self.status is None:
                self.advance()
        except KeyboardInterrupt:
            self.status = Status.INTERRUPTED

    def advance(self) -> None:
        """One arc and the jump that ends it."""
        if self.at_once:
            self.add_arc(0.0, self.x, [])
            self.jump(self.field.guards[self.at_once[0]], self.at_once[0])
            return
        fired = self.flow()
        if self.plan.progress is not None:
            self.plan.progress(self.now.t)
        if fired is None:
            self.status = Status.REACHED_END
        else:
            self.jump(self.field.guards[fired.index], fired.index)

    # -- entering a mode ----------------------------------------------------------------

    def enter(
        self,
        mode: str,
        x: np.ndarray,
        known: dict[str, int],
        held: tuple[str, ...] = (),
        used: str | None = None,
        starting: bool = False,
    ) -> None:
        """Set the mode and state; find which guards are zero here and what follows (3).

        Parameters
        ----------
        mode : str
            A mode as declared.
        known : dict
            By edge: the power of the local time by which its guard vanishes at least,
            because of the jump just made (2).
        held : tuple of str
            Contacts held closed; those found closed here are added.
        used : str, optional
            The edge just taken: zero by construction, it waits until it has left zero (2).
        """
        self.field, self.x = self.scene.field(self.scene.name(mode, held)), x
        if self.field.project is not None:
            self.x = x = np.array(self.field.project(self.now.t, x.tolist()))
        self.extent = np.maximum(self.extent, np.abs(x))
        self.orders = [0] * len(self.field.guards)
        self.at_once: list[int] = []
        self.series = self._jets(0.0, x)
        for index, guard in enumerate(self.field.guards):
            order, sign = self._start_of(guard, index, known.get(guard.edge, 0))
            if self._rests_here(guard, order, sign):
                self.enter(mode, x, known, (*held, guard.edge), used, starting)
                return
            if sign == 0:
                raise StartError(
                    f"{self._where()}: the guard of {guard.edge} is zero and no derivative along "
                    "the flow decides which way it goes; start off the guard"
                )
            if order == 0 and guard.kind == "release" and sign < 0 and not starting:
                self.at_once.append(index)
            elif order == 0:
                self._require_inside(guard, sign, starting)
            elif self._fires_at_once(guard, sign, used):
                self.at_once.append(index)
            self.orders[index] = order

    def _rests_here(self, guard: Guard, order: int, sign: int) -> bool:
        """Whether a contact is closed: gap and gap speed zero, and the load pushes."""
        closed = guard.kind == "contact" and order >= 2 and sign < 0
        return closed and self.scene.contact(guard.edge).rests

    def _fires_at_once(self, guard: Guard, sign: int, used: str | None) -> bool:
        if guard.crossing is Crossing.EITHER or (guard.kind == "edge" and guard.edge == used):
            return False
        return fires(guard.crossing, sign)

    def _start_of(self, guard: Guard, index: int, least: int) -> tuple[int, int]:
        t, x = self.now.t, self.x.tolist()
        value = guard.value(t, x)
        if not np.isfinite(value):
            raise FlowError(f"{self._where()}: the guard of {guard.edge} is {value}")
        if not least:
            if abs(value) > CLOSE * (1.0 + max(map(abs, x))):
                return 0, 1 if value > 0 else -1
            size = self.scene.rounding(guard, self.field)(t, x)[0]
            tick = 64 * EPS * abs(t) * abs(guard.lie(t, x)[1])
            reach = float(self.extent.max()) if self.parts else 0.0
            if abs(value) > 64 * EPS * (size + reach) + tick:
                return 0, 1 if value > 0 else -1
        return self._decide(guard, index, max(least, 1))

    def _decide(self, guard: Guard, index: int, least: int) -> tuple[int, int]:
        t, x = self.now.t, self.x.tolist()
        sizes = self.scene.rounding(guard, self.field)(t, x)
        if self.series is None:
            _, first, second = guard.lie(t, x)
            series = [0.0, first, second / 2]
        else:
            series = list(self.series[1][index])
        noise = [64 * EPS * size for size in sizes] + higher_noise(series, self._own_time(series))
        noise = [float("inf") if k < least else size for k, size in enumerate(noise)]
        return vanishing_order(guard, t, x, series, noise)

    def _own_time(self, series: Sequence[float]) -> float:
        """A time in which the terms of a guard's series are comparable."""
        own = time_scale(series, 0.0)
        if self.series is not None:
            own = min(own, step_length(self.series[0]))
        return own if isfinite(own) else 1.0

    def _require_inside(self, guard: Guard, sign: int, starting: bool) -> None:
        wanted = {Crossing.FALLING: 1, Crossing.RISING: -1}.get(guard.crossing)
        if wanted is None or sign == wanted:
            return
        value = guard.value(self.now.t, self.x.tolist())
        side = "positive" if wanted > 0 else "negative"
        what = "starts" if starting else "jumped"
        kind = StartError if starting else DomainError
        if guard.kind == "release":
            raise kind(
                f"{self._where()}: cannot rest here, the contact would have to pull ({value:.6g})"
            )
        raise kind(
            f"{self._where()}: the run {what} outside the mode's domain: the guard of "
            f"{guard.edge} is {value:.6g} and must be {side}"
        )

    def _where(self, tau: float = 0.0, x: np.ndarray | None = None) -> str:
        state = self.scene.spec.record(self.x if x is None else np.asarray(x))
        return f"{self.scene.spec.model}, mode {self.field.name}, t = {self.now.t + tau!r}, {state}"

    # -- flowing ------------------------------------------------------------------------

    def flow(self) -> Fired | None:
        """Flow until a guard fires or the run ends; adds the arc."""
        length = self.now.until(self.plan.t1)
        target = self._predict(length)
        stepper = self._begin(length, target)
        segments: list[Segment] = []
        self.ends: dict[Any, float] = {}
        fired = None
        while fired is None and stepper.tau < length:
            start, x = stepper.tau, stepper.x
            scales = self._scales(start, x)
            limit = target if target is not None and target > start else length
            limit = min(limit, length, start + REACH * min(scales, default=float("inf")))
            segment = self._step(stepper, limit)
            fired = self._first_event(segment, stepper, scales, target)
            if fired is not None:
                landed = self._land(stepper, segment, fired) if fired.tau > start else None
                if landed is None:
                    stepper.tau, stepper.x, fired = start, x, Fired(fired.index, start)
                    break
                segment, fired = landed, Fired(fired.index, landed.end)
            segments.append(segment)
            self.orders = [0] * len(self.orders)
        end = stepper.tau if fired is None else fired.tau
        self.add_arc(end, stepper.x, segments)
        return fired

    def _begin(self, length: float, target: float | None) -> Stepper:
        if not all(map(isfinite, self.field.rhs(self.now.t, self.x.tolist()))):
            raise FlowError(f"{self._where()}: the flow is not finite")
        first, sizes = self._first_step(length), None
        if target is not None:
            powers = target ** np.arange(1, ORDER + 1)
            sizes = np.abs(np.array(self.series[0])[:, 1:] * powers).max(axis=1)
            first = min(first or target, target)
        try:
            return self.solver.begin(self.field, self.now.t, self.x, length, first, sizes)
        except FlowError as fault:
            raise FlowError(f"{self._where()}: {fault}") from None
        except ValueError as fault:
            raise FlowError(f"{self._where()}: the flow is not finite ({fault})") from None

    def _step(self, stepper: Stepper, limit: float) -> Segment:
        tau, x = stepper.tau, stepper.x
        try:
            return stepper.step(limit)
        except FlowError as fault:
            raise FlowError(f"{self._where(tau, x)}: {fault}") from None

    def _jets(self, tau: float, x: np.ndarray) -> Any:
        """Taylor series of states and guards; None where there is none."""
        if self.field.jets is None:
            return None
        try:
            return self.field.expand(self.now.t + tau, x.tolist(), [0] * self.field.kinks)
        except (ValueError, OverflowError, ZeroDivisionError):
            return None

    def _first_step(self, length: float) -> float | None:
        """Where the first term that the method neglects reaches the tolerance."""
        if self.series is None:
            return None
        k = min(self.solver.order + 1, ORDER)
        first = length
        atol = np.broadcast_to(self.plan.atol, self.x.shape)
        for c, absolute in zip(self.series[0], atol.tolist(), strict=True):
            allowed = absolute + self.plan.rtol * abs(c[0])
            for power in (k - 1, k):
                if c[power]:
                    first = min(first, (allowed / abs(c[power])) ** (1.0 / power))
        return SAFETY * first if first > 0 and np.isfinite(first) else None

    def _predict(self, length: float) -> float | None:
        """The end of a short flight after an impact, from its Taylor series (2)."""
        if self.series is None:
            return None
        best = None
        for index, guard in enumerate(self.field.guards):
            if guard.kind == "contact" and self.orders[index] == 1:
                gap = [0.0, *self.series[1][index][1:]]
                zero = zero_of(gap, 4 * step_length(self.series[0]))
                if zero is not None and zero < length:
                    best = zero if best is None else min(best, zero)
        return best

    def _scales(self, tau: float, x: np.ndarray) -> list[float]:
        """Times over which guards that are no polynomials are smooth."""
        guards = self.field.guards
        if all(guard.affine for guard in guards):
            return []
        share = (self.plan.t1 - self.plan.t0) / SHARES
        series = self.series if tau == 0.0 else self._jets(tau, x)
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
                self._graze(index, tau, segment(tau))
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
        tolerance = self.limit + self.plan.rtol * max(
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
            near = self._near_end(guard, segment, stepper)
            if near is not None:
                return near
        return segment.start if self._sunk(guard, segment, stepper, tolerance) else None

    def _touches(self, guard: Guard, tau: float, segment: Segment, tolerance: float) -> bool:
        """Whether a crossing goes no deeper than the tolerance: a tangency (1)."""
        _, first, second = guard.lie(self.now.t + tau, segment(tau).tolist())
        return first * second <= 0 and first * first <= 2 * abs(second) * tolerance

    def _near_end(self, guard: Guard, segment: Segment, stepper: Stepper) -> float | None:
        """A step made onto a predicted impact ends within rounding of it, on either side."""
        t, x = self.now.t + segment.end, stepper.x.tolist()
        value, rate, _ = guard.lie(t, x)
        near = abs(value) <= -1e-6 * rate * segment.length
        return segment.end if near or abs(value) <= self._rounding(guard, t, x) else None

    def _rounding(self, guard: Guard, t: float, x: list[float]) -> float:
        """What rounding can make of a guard that is zero."""
        return 64 * EPS * float(self.scene.rounding(guard, self.field)(t, x)[0])

    def _sunk(self, guard: Guard, segment: Segment, stepper: Stepper, tolerance: float) -> bool:
        """Whether a contact's gap is negative with no zero seen: it began below rounding."""
        value = self.ends.get(guard.edge, 0.0)
        if guard.kind != "contact" or value >= -tolerance:
            return False
        return -value > self._rounding(guard, self.now.t + segment.end, stepper.x.tolist())

    def _land(self, stepper: Stepper, segment: Segment, fired: Fired) -> Segment | None:
        """End the step on the guard, to rounding (5); None if that is the step's start."""
        guard, tau = self.field.guards[fired.index], fired.tau
        small, least = 1e-6 * segment.length, segment.start + 1e-13 * segment.length
        last, shift = self.now.until(self.plan.t1), 0.0
        try:
            if segment.end - tau > small:
                if tau <= least:
                    return None
                segment = stepper.land(tau)
            for _ in range(4):
                t, x = self.now.t + stepper.tau, stepper.x.tolist()
                value, rate, _ = guard.lie(t, x)
                shift = -value / rate if rate else 0.0
                if abs(shift) <= small or abs(value) <= self._rounding(guard, t, x):
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

    def _graze(self, index: int, tau: float, x: np.ndarray) -> None:
        record = self.scene.spec.record(x)
        edge = self.field.guards[index].edge
        self.grazings.append(Jump(self.now.t + tau, self.j, edge, record, record))

    # -- recording ----------------------------------------------------------------------

    def add_arc(self, length: float, x: np.ndarray, segments: list[Segment]) -> None:
        """Add the arc from the current instant, and move to its end."""
        project = self.field.project
        if project is not None:
            x = np.array(project(self.now.t + length, x.tolist()))
            segments = [_projected(s, self.now.t, project) for s in segments]
        arc = Arc(
            self.field.name, self.j, self.now.t, self.now.low, length, self.x, x, segments, project
        )
        self._keep(arc)
        self.now = self.now.after(length)
        self.x = x

    def _keep(self, part: Part) -> None:
        """Keep a part: whole, or only its ends and the states asked for."""
        plan = self.plan
        if plan.samples is not None and isinstance(part, Arc):
            inside = plan.samples[(plan.samples >= part.t0) & (plan.samples < part.t1)]
            self.sampled.extend(part.local(inside - part.t0))
        elif plan.samples is not None and isinstance(part, TailPart):
            for t in plan.samples[(plan.samples >= part.t0) & (plan.samples < part.t1)]:
                arc = part.arc(part.place(float(t), "right"))
                self.sampled.append(arc.local((t - arc.t0) - arc.low))
        if isinstance(part, Arc) and not plan.dense:
            part = attrs.evolve(part, segments=())
        self.parts.append(part)

    def add_jump(self, edge: str, after: np.ndarray, before: np.ndarray) -> None:
        """Record a jump from the last arc; stop at ``max_jumps``, or in an endless loop (4)."""
        row = JumpRow(self.now.t, self.now.low, edge, before, after)
        self.own_jumps[len(self.parts) - 1] = row
        self.j += 1
        self.recent.append((self.now.t, edge))
        spent = self.now.t - self.recent[0][0]
        if len(self.recent) == LOOP and spent <= 4 * LOOP * np.spacing(abs(self.now.t)):
            cycle = " -> ".join(dict.fromkeys(name for _, name in self.recent))
            raise JumpLoopError(
                f"{self._where()}: {LOOP} jumps with no time to speak of between them: {cycle}; "
                "a reset must leave its guard, a contact needs rests=True; accumulations of "
                "edges other than one contact are not summed"
            )
        if len(self.own_jumps) >= self.plan.max_jumps:
            self.status = Status.MAX_JUMPS

    # -- jumping ------------------------------------------------------------------------

    def jump(self, guard: Guard, index: int) -> None:
        """Carry out the jump of a guard that fired."""
        if guard.kind == "contact":
            self._impact(guard, index)
        elif guard.kind == "release":
            self._release(guard)
        else:
            self._reset(guard)

    def _reset(self, guard: Guard) -> None:
        before = self.x
        after = np.array(self.scene.reset(guard.edge)(self.now.t, before.tolist()))
        self._require_finite(guard.edge, after)
        held = self._still_held(guard.to, after)
        t = self.now.t
        stays = guard.value(t, after.tolist()) == guard.value(t, before.tolist())
        known = {guard.edge: 1} if stays else {}
        self.watch.reset()
        self.add_jump(guard.edge, after, before)
        if self.status is None:
            self.enter(guard.to, after, known, held, used=guard.edge)

    def _still_held(self, mode: str, x: np.ndarray) -> tuple[str, ...]:
        """The contacts held at present that a jump has left closed: gap and speed zero."""
        if mode != self.field.mode:
            return ()
        size = CLOSED * (1.0 + float(np.max(np.abs(x))))
        held = []
        for guard in self.scene.field(mode).guards:
            if guard.edge in self.field.held:
                gap, speed, _ = guard.lie(self.now.t, x.tolist())
                if max(abs(gap), abs(speed)) <= size:
                    held.append(guard.edge)
        return tuple(held)

    def _require_finite(self, edge: str, after: np.ndarray) -> None:
        if not np.all(np.isfinite(after)):
            state = self.scene.spec.record(after)
            raise FlowError(f"{self._where()}: the reset of {edge} gives {state}")

    def _release(self, guard: Guard) -> None:
        contact = released(guard.edge)
        overdue = bool(self.at_once)
        for point in reversed(self.zeno):
            if point.edges == (contact,):
                if point.mode is not None and point.t_release is None:
                    point.t_release = self.now.t
                break
        self.watch.reset()
        self.add_jump(guard.edge, self.x, self.x)
        rest = tuple(name for name in self.field.held if name != contact)
        if self.status is None:
            self.enter(self.field.mode, self.x, {contact: 2 if overdue else 3}, rest)

    def _impact(self, guard: Guard, index: int) -> None:
        contact, t = self.scene.contact(guard.edge), self.now.t
        before = np.array(contact.land(t, self.x.tolist()))
        self._move_end(before)
        *after, speed = contact.impact(t, before.tolist())
        state = np.array(after)
        self._require_finite(guard.edge, state)
        if speed < 0:
            raise FlowError(
                f"{self._where()}: the restitution of {guard.edge} gives the speed {speed:.6g} "
                "after the impact; it must not be negative"
            )
        held = self._still_held(guard.to, state)
        self.watch.saw(guard.edge)
        self.add_jump(guard.edge, state, before)
        if self.status is None and not self._accumulate(contact, state, speed, guard.to, held):
            self.enter(guard.to, state, {guard.edge: 1 if speed > 0 else 2}, held)

    def _move_end(self, x: np.ndarray) -> None:
        """The last arc ends on the guard itself."""
        arc = self.parts[-1]
        assert isinstance(arc, Arc)
        self.parts[-1] = attrs.evolve(arc, last=x, segments=arc._segments)
        self.x = x

    # -- accumulating -------------------------------------------------------------------

    def _accumulate(
        self, contact: Contact, x: np.ndarray, v: float, mode: str, held: tuple[str, ...]
    ) -> bool:
        """Sum the impacts from here on, where that can be done; True if it was."""
        if self.plan.zeno == "truncate":
            return self._truncate(contact, x, v, mode, held)
        watch = self.watch
        if watch.count < self.plan.patience or not 0 < v <= PATIENCE * watch.tried:
            return False
        watch.tried = v
        tail = self.tail(contact, x, v, self.scene.field(self.scene.name(mode, held)))
        if tail is None or self.now.after(tail.remaining).until(self.plan.t1) < 0:
            return False
        self._pass_limit(tail)
        return True

    def tail(self, contact: Contact, x: np.ndarray, v: float, field: Field) -> Tail | None:
        """The sum of all impacts from here on; None where there is none (yet)."""
        column = _column(field, contact.name)
        now, plan = self.now, self.plan
        rtol, atol = plan.closing * plan.rtol, plan.closing * self.limit
        tail = close(field, contact, column, now.t, now.low, x, v, rtol, atol)
        return tail if tail is not None and self._clear(tail, field, column) else None

    def _clear(self, tail: Tail, field: Field, column: int) -> bool:
        """Whether no other guard changes sign along the tail, impacts and flights."""
        others = [guard for i, guard in enumerate(field.guards) if i != column]
        if not others:
            return True
        shares = 4 if all(guard.affine for guard in others) else SHARES
        since = np.unique([*np.linspace(0, tail.remaining, 2 * shares), *tail.times[:shares]])
        points = [(tail.t + s, tail.state(s)) for s in since[since < tail.remaining].tolist()]
        for guard in others:
            values = [guard.value(t, x) for t, x in points]
            if not (min(values) > 0 or max(values) < 0):
                return False
        return True

    def _pass_limit(self, tail: Tail) -> None:
        """Go over an accumulation point, into what follows it."""
        contact, part = tail.contact, TailPart(tail, self.j)
        self._keep(part)
        self.j += tail.count
        self.now, self.x = self.now.after(tail.remaining), tail.x_inf
        held = (*tail.field.held, contact.name)
        goes_on = contact.rests and self.plan.zeno == "rest"
        rest = self.scene.name(tail.field.mode, held) if goes_on else None
        record = self.scene.spec.record(tail.x_inf)
        point = Accumulation(self.now.t, record, tail.r, (contact.name,), "estimated", rest, self.j)
        self.zeno.append(point)
        self.tails.append(tail)
        self.watch.reset()
        if self.plan.zeno == "raise":
            raise ZenoError(f"{self.scene.spec.model}: {explain(point)}")
        if rest is None:
            self.status = Status.ZENO_STOPPED if self.plan.zeno == "stop" else Status.NO_REST
        elif len(self.zeno) == self.plan.accumulations:
            self.status = Status.ZENO_STOPPED
        else:
            self.enter(tail.field.mode, tail.x_inf, {}, held)

    def _truncate(
        self, contact: Contact, x: np.ndarray, v: float, mode: str, held: tuple[str, ...]
    ) -> bool:
        """Hold the contact after the permitted number of impacts (section 2 of the paper)."""
        t, ratio = self.now.t, contact.law(self.now.t, x.tolist(), -0.0)
        cap = self.plan.cap or permitted(ratio)
        field = self.scene.field(self.scene.name(mode, held))
        column = _column(field, contact.name)
        pushed = field.guards[column].lie(t, x.tolist())[2] < 0
        if self.watch.count < cap or not pushed or not contact.rests:
            return False
        cut = Truncation(cap, *self._left_out(contact, x, field, held))
        held = (*held, contact.name)
        self.field, self.x = field, x
        self.add_arc(0.0, x, [])
        after = self.scene.field(self.scene.name(mode, held))
        assert after.project is not None
        still = np.array(after.project(t, x.tolist()))
        record, edges = self.scene.spec.record(still), (contact.name,)
        point = Accumulation(t, record, ratio, edges, "truncated", after.name, self.j)
        point.truncation = cut
        self.zeno.append(point)
        self.tails.append(None)
        self.watch.reset()
        self.add_jump(f"{contact.name}.hold", still, x)
        if self.status is None:
            self.enter(mode, still, {}, held)
        return True

    def _left_out(
        self, contact: Contact, x: np.ndarray, field: Field, held: tuple[str, ...]
    ) -> tuple[float, float, float]:
        """``t_inf`` of the full series, its distance, and its greatest height."""
        plan = attrs.evolve(self.plan, zeno="stop", progress=None, dense=True, samples=None)
        full = Driver(self.scene, self.solver, plan)
        full.now, full.watch.contact, full.watch.count = self.now, contact.name, 1
        full.enter(field.mode, x, {contact.name: 1}, held)
        while full.status is None:
            full.advance()
        first = full.parts[0]
        arc = first.arc(0) if isinstance(first, TailPart) else first
        gap, taus = field.guards[_column(field, contact.name)].value, arc.length * nodes(64)
        states = zip(taus.tolist(), arc.local(taus).tolist(), strict=True)
        height = max(gap(arc.t0 + s, y) for s, y in states)
        if not full.zeno:
            return float("nan"), float("nan"), height
        t_inf = full.zeno[0].t
        return t_inf, t_inf - self.now.t - self.now.low, height


def _column(field: Field, edge: str) -> int:
    """Place of an edge's guard in a field."""
    return next(i for i, guard in enumerate(field.guards) if guard.edge == edge)


def permitted(r: float) -> int:
    """``[1/r]`` from the simplest fraction that rounds to ``r``, so that 1/93 gives 93."""
    from fractions import Fraction

    return int(1 / Fraction(r).limit_denominator(10**6)) if r > 1e-6 else 10**6


def _projected(segment: Segment, t0: float, project: Callable[..., Any]) -> Segment:
    """A segment of a resting arc, back on the surface at its nodes."""
    degree = segment.degree
    times = (t0 + segment.start + segment.length * nodes(degree)).tolist()
    states = segment.at(nodes(degree)).tolist()
    values = np.array([project(t, x) for t, x in zip(times, states, strict=True)])
    return Segment(segment.start, segment.length, from_values(degree) @ values)


__all__ = ["Driver", "HybridError", "Plan", "Record", "Sequence", "permitted"]
