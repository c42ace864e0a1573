"""One attempted step with its events, one jump, one entry: the pieces of a compiled run.

The rules are those of ``docs/semantics.md``, numbers in brackets its rules. All pieces are
pure functions of a :class:`Lane`, one trajectory on its way; the loops around them
(:mod:`.lanes`, :mod:`.streak`) decide for how long and for how many lanes. What changes
within an arc is kept apart (:class:`Going`): the innermost loop should carry little.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient

from ..events import EPS, RESOLVED, SAMPLED
from ..segment import from_values, nodes
from ..solvers.diffrax_backend import SHORTEST, Method
from .batch import apply, choose, when
from .roots import bernstein, deflated, falling, to_powers
from .system import Jumped, System

#: What a lane does next: flow a step, step onto a guard, jump, enter a mode.
FLOW, LAND, JUMP, ENTER = range(4)

#: Why a lane stands still.
RUNNING, END, MAX_JUMPS, ZENO, NO_REST, CLOSE, JUDGE = range(7)
MAX_STEPS, NOT_FINITE, OUTSIDE, UNDECIDED, LOOP, SERIES = range(7, 13)

#: A guard nearer to zero than this share of the state is looked at more closely.
NEAR = 1e-6

#: A guard this many times its last coefficients from zero has no zero in a step.
AWAY = 20.0

#: Share of the step wanted, below which a guard that is still not resolved has a kink.
KINK = 1e-12

#: By how much dividing by the local time may blow up a guard's rounding.
DEFLATED = 200

#: Least degree at which loads are sampled.
LEAST = 6

#: Pieces of a run in which a guard that is no polynomial is sampled at least.
SHARES = 100

#: Growth, from step to step, of the bound that lets the guards be seen.
WIDER = 1.3

#: A first step after an impact, against the predicted flight.
AHEAD = 1.1

#: Attempts to step onto a guard.
LANDINGS = 4

#: Jumps with no time between them after which a lane is taken to be caught in a loop.
CAUGHT = 100

#: Impacts are summed anew only after their speed has fallen to this share.
PATIENCE = 0.3


class Going(NamedTuple):
    """What changes within an arc.

    Attributes
    ----------
    tau, x
        Local time in the arc, and the state there.
    h, reach, cap
        The step the controller wants; the length of a landing; a bound on the step, so that
        the guards can be seen.
    memory
        The solver's.
    ends, largest : array, shape (slots,)
        The guards here, and their largest size in this arc so far.
    slot, stage, tries
        The guard that fires, what comes next, and how often a landing was tried.
    steps, status
        Attempts so far, and why the lane stands still.
    """

    tau: Any
    x: Any
    h: Any
    reach: Any
    cap: Any
    memory: Any
    ends: Any
    largest: Any
    slot: Any
    stage: Any
    tries: Any
    steps: Any
    status: Any


class Lane(NamedTuple):
    """One trajectory on its way.

    Attributes
    ----------
    t, low
        Start of the present arc, in two floats.
    mode, held
        The mode's number, and the contacts held.
    orders, limit
        Powers of ``tau`` by which the guards vanish at the arc's start; a bound on the
        first step.
    jumps, stuck
        Jumps so far, and how many of them with no time between.
    series, count, tried, speed
        A series of impacts: the slot, how many, the speed of the last try to sum it, and
        the speed after the impact just made (0 after another jump).
    """

    t: Any
    low: Any
    mode: Any
    held: Any
    orders: Any
    limit: Any
    jumps: Any
    stuck: Any
    series: Any
    count: Any
    tried: Any
    speed: Any
    going: Going

    @property
    def now(self) -> Any:
        """The present time, rounded."""
        return self.t + (self.low + self.going.tau)

    def left(self, t: Any) -> Any:
        """Duration from here to ``t``."""
        return ((t - self.t) - self.low) - self.going.tau

    def but(self, **changes: Any) -> Lane:
        """The lane with some entries of ``going`` changed."""
        return self._replace(going=self.going._replace(**changes))


class Run(NamedTuple):
    """What is asked for: traced, so that no number compiles anew."""

    parameters: Any
    t0: Any
    t1: Any
    rtol: Any
    atol: Any
    max_jumps: Any
    max_steps: Any


class Event(NamedTuple):
    """What the guards say of a step.

    Attributes
    ----------
    fires, slot, share
        Whether one fires, which, and at which share of the step.
    halve
        The step must be shorter to tell.
    unsure
        Python has to judge.
    """

    fires: Any
    slot: Any
    share: Any
    halve: Any
    unsure: Any

    def but_halve(self, coarse: Any) -> Event:
        """The same, or to be halved whatever it says."""
        return Event(
            self.fires & ~coarse, self.slot, self.share, self.halve | coarse, self.unsure & ~coarse
        )


NOTHING = Event(False, 0, np.inf, False, False)


class Step(NamedTuple):
    """What an attempt shows a recorder: the states at the method's nodes."""

    values: Any
    start: Any
    length: Any


def later(t: Any, low: Any, duration: Any) -> tuple[Any, Any]:
    """A time in two floats plus a duration (compare :class:`hybrid.clock.Instant`)."""
    total = t + duration
    back = total - t
    rest = (t - (total - back)) + (duration - back) + low
    new = total + rest
    return new, rest - (new - total)


class Turner:
    """The pieces for one system and method.

    ``judged``: a lane stops where Python has to judge (an impact that may be summed, a guard
    about to touch); otherwise the compiled rules decide, without the finest distinctions.
    ``sums``: stop where a series of impacts may be summed.
    """

    def __init__(self, system: System, method: Method, judged: bool, sums: bool) -> None:
        self.system, self.method, self.judged = system, method, judged
        self.sums = sums and bool(system.is_contact.any())
        self.watches = bool(system.spec.transitions)
        loads = bool(system.rests.any()) and not judged
        self.degree = max(method.degree, LEAST if loads else 1) if system.affine else SAMPLED
        self.to_bernstein = bernstein(self.degree)
        spread = np.linalg.inv(from_values(self.degree))[:, : method.degree + 1]
        self.spread = spread @ from_values(method.degree)

    def begin(self, run: Run, mode: Any, held: Any, x: Any, xp: Any = jnp) -> Lane:
        """A lane at the start of a run, still to be entered.

        ``xp`` is the array namespace: numpy's makes a lane without compiling anything.
        """
        zero, width = xp.asarray(run.t0) * 0.0, self.system.width
        none, whole = xp.zeros(width), xp.asarray(0)
        going = Going(
            tau=zero,
            x=x,
            h=zero,
            reach=zero,
            cap=xp.asarray(xp.inf),
            memory=self.method.memory(x, xp),
            ends=none,
            largest=none,
            slot=xp.asarray(-1),
            stage=xp.asarray(ENTER),
            tries=whole,
            steps=whole,
            status=whole,
        )
        return Lane(
            t=run.t0 + zero,
            low=zero,
            mode=xp.asarray(mode),
            held=held,
            orders=xp.zeros(width, dtype=int),
            limit=xp.asarray(xp.inf),
            jumps=whole,
            stuck=whole,
            series=xp.asarray(-1),
            count=whole,
            tried=xp.asarray(xp.inf),
            speed=zero,
            going=going,
        )

    # -- steps --------------------------------------------------------------------------

    def flow(self, run: Run, lane: Lane, free: bool = False) -> tuple[Going, Step]:
        """One attempted step; a landing, or the rest of the run, at most.

        ``free``: no contact is held, which saves asking.
        """
        going, held = lane.going, None if free else lane.held
        landing, first = going.stage == LAND, going.tau == 0
        left = lane.left(run.t1)
        wanted = jnp.minimum(going.h, going.cap)
        wanted = jnp.minimum(wanted, jnp.where(first, lane.limit, jnp.inf))
        curved = self._curved(lane, free)
        if curved is not None:
            wanted = jnp.where(curved, jnp.minimum(wanted, (run.t1 - run.t0) / SHARES), wanted)
        last = ~landing & (left <= wanted)
        h = jnp.where(last, left, stop_gradient(jnp.where(landing, going.reach, wanted)))
        t0 = lane.t + lane.low

        def rate(s: Any, x: Any) -> Any:
            return self.system.flow(run.parameters, lane.mode, held, t0 + s, x)

        x, kept, new, values, memory = self.method.attempt(
            rate, going.tau, h, going.x, going.memory, run.rtol, run.atol
        )
        new = stop_gradient(jnp.where(kept & (h < going.h), jnp.maximum(new, going.h), new))
        last, steps = last | (h >= left), going.steps + 1
        moved = going._replace(
            tau=jnp.where(last, left + going.tau, going.tau + h),
            x=x,
            h=new,
            memory=memory,
            steps=steps,
            status=jnp.where(last, END, going.status),
        )
        step = Step(values, going.tau, h)
        failed = ~kept & (~(new > SHORTEST * going.tau) | (new < 1e-300))
        refused = going._replace(
            h=new, steps=steps, status=jnp.where(failed, NOT_FINITE, going.status)
        )
        if not self.watches:
            return choose(kept, moved, refused), step
        samples = self._samples(run, lane, held, values, h)
        moved = moved._replace(ends=samples[-1], cap=WIDER * going.cap)
        if self.judged:
            largest = jnp.maximum(going.largest, jnp.abs(samples).max(axis=0))
            moved = moved._replace(largest=largest)
        moved = self._settled(run, lane, held, moved)
        event = self._event(run, lane, samples, x, kept & ~landing, h)
        if curved is not None:
            coarse = kept & ~landing & curved & self._unresolved(run, lane, samples, moved, h)
            event = event.but_halve(coarse)
        stays = ~kept | event.fires | event.halve | event.unsure
        result = choose(stays, refused, moved)._replace(
            h=jnp.where(event.fires | event.halve, going.h, new),
            cap=jnp.where(event.halve, 0.5 * h, jnp.where(stays, going.cap, moved.cap)),
            reach=stop_gradient(jnp.where(event.fires, event.share, 0.0) * h),
            slot=jnp.where(event.fires, event.slot, going.slot),
            stage=jnp.where(event.fires, jnp.where(event.share <= 1e-13, JUMP, LAND), going.stage),
            tries=jnp.where(event.fires, 0, going.tries),
        )
        status = jnp.where(event.unsure, JUDGE, result.status)
        result = result._replace(status=status)
        cut = event.fires & (event.share > 1e-13) & self.method.dense
        there, share = moved, h
        if self.method.dense:
            at = stop_gradient(jnp.where(cut, event.share, 0.5))
            basis = _chebyshev(2.0 * at - 1.0, self.method.degree)
            inside = basis @ (jnp.asarray(from_values(self.method.degree)) @ values)
            there = moved._replace(x=jnp.where(cut, inside, moved.x))
            share = jnp.where(cut, at * h, h)
        aimed = lane.but(
            slot=jnp.where(cut, event.slot, going.slot), tries=jnp.where(cut, 0, going.tries)
        )
        landed = lambda: self._landed(run, aimed, held, there, share)  # noqa: E731
        return when(landing | cut, landed, result), step

    def _settled(self, run: Run, lane: Lane, held: Any, going: Going) -> Going:
        """With the state back on the contacts held."""
        if held is None or not self.system.rests.any():
            return going
        t = lane.t + (lane.low + going.tau)
        x = self.system.project(run.parameters, lane.mode, held, t, going.x)
        return going._replace(x=x)

    # -- events -------------------------------------------------------------------------

    def _samples(self, run: Run, lane: Lane, held: Any, values: Any, h: Any) -> Any:
        """Guards at the nodes of a step; shape ``(degree + 1, slots)``."""
        values = stop_gradient(values)
        if self.degree != self.method.degree:
            values = apply(self.spread, values)
        times = lane.now + h * jnp.asarray(nodes(self.degree))

        def at(t: Any, x: Any) -> Any:
            return self.system.guards(run.parameters, lane.mode, held, t, x)

        samples = stop_gradient(jax.vmap(at)(times, values))
        inside = lane.going.tau > 0
        first = jnp.where(inside, stop_gradient(lane.going.ends), samples[0])
        return jnp.concatenate([first[None], samples[1:]])

    def _coefficients(self, lane: Lane, samples: Any) -> Any:
        """Bernstein coefficients, one guard a row, turned so that it fires falling.

        Divided by the power of the local time by which a guard vanishes at the arc's start.
        """
        orders = jnp.where(lane.going.tau > 0, 0, lane.orders)
        values = deflated(samples, orders)
        b = apply(self.to_bernstein, values).T
        b = jnp.concatenate([values[:1].T, b[:, 1:-1], values[-1:].T], axis=1)
        return b * self._towards(lane, values)[:, None]

    def _towards(self, lane: Lane, values: Any) -> Any:
        """+1 where a slot fires falling, -1 where rising; either way: from where it starts."""
        sign = -self.system.pick(self.system.crossing, lane.mode)
        if (self.system.crossing != 0).all():
            return sign
        start = jnp.sign(jnp.where(values[0] == 0, values[1], values[0]))
        return jnp.where(sign == 0, start, sign)

    def _event(self, run: Run, lane: Lane, samples: Any, end: Any, kept: Any, h: Any) -> Event:
        """The first guard that fires in a kept step, or why the step must be shorter."""
        tolerance = self._tolerance(run, lane)
        noise = DEFLATED * self._noise(lane, samples, end, h)
        b = self._coefficients(lane, samples)
        least = tolerance if self.judged else 0.0
        near = kept & (jnp.min(b, axis=1) <= least).any()
        b = jnp.where(near, b, 1.0)
        nothing = Event(*(jnp.asarray(v) for v in NOTHING))
        first = lambda: self._first(run, lane, samples[-1], b, h, tolerance, noise)  # noqa: E731
        return when(near, first, nothing)

    def _noise(self, lane: Lane, samples: Any, end: Any, h: Any) -> Any:
        """What rounding of time and state makes of each guard."""
        way = jnp.abs(end - lane.going.x).max() + jnp.ptp(samples, axis=0)
        return 8 * EPS * (jnp.abs(lane.now) * way / h + jnp.abs(lane.going.x).max())

    def _tolerance(self, run: Run, lane: Lane) -> Any:
        """For each guard, what the tolerances leave open of the states it is made of."""
        uses = self.system.pick(self.system.uses, lane.mode)
        allowed = run.atol + run.rtol * jnp.abs(lane.going.x)
        return jnp.where(uses, allowed, 0.0).max(axis=1)

    def _curved(self, lane: Lane, free: bool) -> Any:
        """Whether a guard is watched that is no polynomial; None if there can be none."""
        if not self.system.affine:
            return jnp.array(True)
        return None if free or not self.system.rests.any() else lane.held.any()

    def _unresolved(self, run: Run, lane: Lane, samples: Any, moved: Going, h: Any) -> Any:
        """Whether a guard that is no polynomial is not yet one on this step.

        A guard that stays away from zero by more than it is unresolved need not be; what
        rounding of the time makes of a guard cannot be. On a long step the guard may be large
        beside what moves it: it is measured against the state, not against itself alone.
        """
        going = lane.going
        series = jnp.abs(apply(from_values(self.degree), samples))
        size = jnp.minimum(series.max(axis=0), 1.0 + jnp.abs(going.x).max())
        noise = 8 * self._noise(lane, samples, moved.x, h)
        last = series[-3:].max(axis=0)
        coarse = last > RESOLVED * size + 1e-3 * self._tolerance(run, lane) + noise
        far = (jnp.abs(samples) > AWAY * last).all(axis=0)
        one_side = (samples > 0).all(axis=0) | (samples < 0).all(axis=0)
        coarse = coarse & ~(far & one_side)
        coarse = coarse & lane.held if self.system.affine else coarse
        return coarse.any() & (h > KINK * jnp.minimum(going.h, lane.left(run.t1)))

    def _first(
        self, run: Run, lane: Lane, ends: Any, b: Any, h: Any, tolerance: Any, noise: Any
    ) -> Event:
        """The first guard that fires: earliest, then in declared order (1, 4)."""
        going = lane.going
        roots, unclear = falling(b)
        orders = jnp.where(going.tau > 0, 0, lane.orders)
        shallow = _shallow(b, orders, roots, tolerance)
        contacts = self.system.pick(self.system.is_contact, lane.mode) & ~lane.held
        sunk = contacts & (ends < -tolerance) & ~jnp.isfinite(roots) & ~unclear
        roots = jnp.where(sunk, 0.0, jnp.where(shallow, jnp.inf, roots))
        first = jnp.min(roots)
        tie = 4 * EPS * jnp.abs(lane.now) / jnp.maximum(h, 1e-300)
        unclear = unclear & (jnp.min(b, axis=1) < -(tolerance + noise))
        shortest = SHORTEST * (jnp.abs(lane.now) + going.tau) + 1e-12 * (run.t1 - run.t0)
        halve = unclear.any() & (h > shortest)
        unsure = jnp.zeros_like(halve)
        if self.judged:
            close = jnp.abs(b).min(axis=1) <= tolerance
            away = (going.largest > tolerance) & (going.tau > 0)
            doubt = shallow | (close & away & ~jnp.isfinite(roots)) | sunk
            unsure = doubt.any() & ~halve
        fires = jnp.isfinite(first) & ~halve & ~unsure
        return Event(fires, jnp.argmax(roots <= first + tie), first, halve, unsure)

    def _landed(self, run: Run, lane: Lane, held: Any, moved: Going, h: Any) -> Going:
        """After a step onto a guard: moved by the last rounding onto it, or sent again (5).

        The correction is Newton's. It carries the derivative of the time of the event; the
        length of the step that led here is a number like any other.
        """
        going, p = lane.going, run.parameters
        t = lane.now + h
        rate = self.system.flow(p, lane.mode, held, t, moved.x)

        def guard(t: Any, x: Any) -> Any:
            values = self.system.guards(p, lane.mode, held, t, x)
            return jnp.where(jnp.arange(self.system.width) == going.slot, values, 0.0).sum()

        value, slope = jax.jvp(guard, (t, moved.x), (jnp.ones_like(t), rate))
        slope = stop_gradient(slope)
        shift = -value / jnp.where(slope == 0, jnp.inf, slope)
        small = jnp.abs(shift) <= 1e-6 * h
        again = ~small & (going.tries < LANDINGS) & (h + shift > 0)
        again = again & (h + shift <= lane.left(run.t1))
        reach = stop_gradient(h + shift)
        shift = jnp.where(small, shift, 0.0)
        there = moved._replace(
            tau=going.tau + (h + shift),
            x=moved.x + shift * rate,
            h=going.h,
            slot=going.slot,
            stage=jnp.full_like(going.stage, JUMP),
            status=jnp.full_like(going.status, RUNNING),
        )
        more = going._replace(
            reach=reach,
            stage=jnp.full_like(going.stage, LAND),
            tries=going.tries + 1,
            steps=moved.steps,
        )
        return choose(again, more, self._settled(run, lane, held, there))

    # -- jumps --------------------------------------------------------------------------

    def jumped(self, run: Run, lane: Lane) -> tuple[Lane, Jumped]:
        """The jump of the slot that fires; what it leads to is still to be entered."""
        going = lane.going
        t, low = later(lane.t, lane.low, going.tau)
        done = self.system.jump(run.parameters, lane.mode, going.slot, lane.held, t, going.x)
        fired = jnp.arange(self.system.width) == going.slot
        contact = self.system.pick(self.system.is_contact, lane.mode, going.slot)
        release = contact & (lane.held & fired).any()
        impact = contact & ~release
        order = jnp.where(release, jnp.where(going.tau == 0, 2, 3), 1)
        order = jnp.where(impact & ~(done.speed > 0), 2, order)
        same_mode = done.mode == lane.mode
        known = same_mode & (contact | done.stays)
        least = jnp.where(fired & known, order, 0)
        again = impact & (lane.series == going.slot)
        finite = jnp.isfinite(done.after).all() & jnp.isfinite(done.speed) & ~(done.speed < 0)
        stuck = jnp.where(going.tau > 4 * EPS * jnp.abs(lane.t), 0, lane.stuck + 1)
        status = jnp.where(lane.jumps + 1 >= run.max_jumps, MAX_JUMPS, going.status)
        status = jnp.where(stuck >= CAUGHT, LOOP, status)
        after = lane._replace(
            t=t,
            low=low,
            mode=done.mode,
            held=done.held,
            orders=least,
            limit=jnp.full_like(lane.limit, jnp.inf),
            jumps=lane.jumps + 1,
            stuck=stuck,
            series=jnp.where(impact, going.slot, -1),
            count=jnp.where(again, lane.count + 1, jnp.where(impact, 1, 0)),
            tried=jnp.where(again, lane.tried, jnp.inf),
            speed=jnp.where(impact, done.speed, 0.0),
        )
        after = after.but(
            tau=jnp.zeros_like(going.tau),
            x=done.after,
            memory=self.method.memory(done.after),
            slot=jnp.where(~contact & same_mode, going.slot, -1),
            stage=jnp.full_like(going.stage, ENTER),
            status=jnp.where(finite, status, NOT_FINITE),
        )
        return after, done

    def enter(self, run: Run, lane: Lane) -> Lane:
        """Which guards are zero here, and what follows (2, 3).

        ``orders`` holds the powers known from the jump, ``slot`` the edge just used. A
        contact found closed is held, and the lane has to be entered again.
        """
        going = lane.going._replace(memory=self.method.memory(lane.going.x))
        lane = lane._replace(going=self._settled(run, lane, lane.held, going))
        going, system = lane.going, self.system
        lies, rate, order, sign = self._signs(run, lane)
        closing = system.pick(system.rests, lane.mode) & ~lane.held & (order >= 2) & (sign < 0)
        direction = system.pick(system.crossing, lane.mode)
        leaving = (direction != 0) & (sign == direction)
        starting = (lane.jumps == 0) & (lane.t == run.t0)
        overdue = (order == 0) & leaving & lane.held & ~starting
        used = jnp.arange(system.width) == going.slot
        at_once = overdue | ((order > 0) & leaving & ~used)
        outside = (order == 0) & leaving & ~overdue
        status = jnp.where(outside.any(), OUTSIDE, going.status)
        status = jnp.where((sign == 0).any(), UNDECIDED, status)
        stage = jnp.where(at_once.any(), JUMP, FLOW)
        sums = (lane.speed > 0) & (lane.count >= 2) & (lane.speed <= PATIENCE * lane.tried)
        sums = sums & (stage == FLOW) & (status == RUNNING) & self.sums
        open_contacts = system.pick(system.is_contact, lane.mode) & ~lane.held
        entered = lane._replace(
            orders=order, limit=flight_bound(lies, open_contacts & (order == 1))
        ).but(
            ends=lies[0],
            largest=jnp.abs(lies[0]),
            stage=stage,
            slot=jnp.argmax(at_once),
            h=jnp.where(going.h > 0, going.h, _first_step(run, going.x, rate)),
            status=jnp.where(sums, CLOSE, status),
        )
        if not system.rests.any():
            return entered
        return choose(closing.any(), lane._replace(held=lane.held | closing), entered)

    def _signs(self, run: Run, lane: Lane) -> tuple[Any, Any, Any, Any]:
        """Guards with two derivatives; the flow; the power by which each vanishes; its sign."""
        t, x = lane.t, lane.going.x
        lies, flow = self.system.lies(run.parameters, lane.mode, lane.held, t, x)
        rate, size = jnp.max(jnp.abs(flow)), 1.0 + jnp.max(jnp.abs(x))
        tick = jnp.abs(t) * jnp.abs(lies)
        last = jnp.broadcast_to(size + rate, tick[0].shape)
        noise = 64 * EPS * jnp.stack([size + tick[1], last + tick[2], last])
        known = jnp.where(lane.held, 0, lane.orders)
        decides = (jnp.abs(lies) > noise) & (known <= jnp.arange(3)[:, None])
        order = jnp.where(decides[0], 0, jnp.where(decides[1], 1, jnp.where(decides[2], 2, 0)))
        order = jnp.where(known == 3, 3, order)
        value = jnp.where(order == 0, lies[0], jnp.where(order == 1, lies[1], lies[2]))
        sign = jnp.where(decides.any(axis=0), jnp.sign(value), 0.0)
        return lies, flow, order, jnp.where(known == 3, 1.0, sign)


def _first_step(run: Run, x: Any, rate: Any) -> Any:
    """Hairer, Norsett & Wanner, *Solving ODEs I*, II.4: the first guess."""
    scale = run.atol + run.rtol * jnp.abs(x)
    size, speed = jnp.max(jnp.abs(x) / scale), jnp.max(jnp.abs(rate) / scale)
    guess = 0.01 * size / jnp.where(speed > 0, speed, 1.0)
    guess = jnp.where((size > 1e-5) & (speed > 1e-5), guess, 1e-6)
    return stop_gradient(jnp.minimum(guess, run.t1 - run.t0))


def flight_bound(lies: Any, leaving: Any) -> Any:
    """A bound on the first step: a little more than the flight predicted (2)."""
    falls = leaving & (lies[2] < 0) & (lies[1] > 0)
    length = 2.0 * lies[1] / jnp.where(falls, -lies[2], 1.0)
    return stop_gradient(AHEAD * jnp.min(jnp.where(falls, length, jnp.inf)))


def _chebyshev(x: Any, degree: int) -> Any:
    """Chebyshev polynomials at a point; shape ``(degree + 1,)``."""
    columns = [jnp.ones_like(x), x]
    for _ in range(degree - 1):
        columns.append(2.0 * x * columns[-1] - columns[-2])
    return jnp.stack(columns)


def _shallow(b: Any, order: Any, s: Any, tolerance: Any) -> Any:
    """Whether zeros of polynomials ``s^order b(s)`` go no deeper than a tolerance (1)."""
    found = jnp.isfinite(s)
    at = jnp.where(found, s, 0.5)
    powers = apply(to_powers(b.shape[1] - 1).T, b.T)
    first, second = _slopes(powers, at)
    power = jnp.where(order == 0, 1.0, jnp.where(order == 1, at, at * at))  # third order: bound
    second = 2 * order * first * power / at + power * second
    first = power * first
    return found & (first * second <= 0) & (first**2 <= 2 * jnp.abs(second) * tolerance)


def _slopes(powers: Any, s: Any) -> tuple[Any, Any]:
    """First and second derivatives of polynomials (Horner)."""
    value, first, half = powers[-1], jnp.zeros_like(s), jnp.zeros_like(s)
    for c in powers[-2::-1]:
        value, first, half = value * s + c, first * s + value, half * s + first
    return first, 2.0 * half
