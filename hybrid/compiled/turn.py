"""One attempted step with its events, one jump, one entry: the pieces of a compiled run.

The rules are those of ``docs/semantics.md``, numbers in brackets its rules. All pieces are
pure functions of a :class:`.lane.Lane`; the loops around them (:mod:`.lanes`) decide for how long
and for how many lanes.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from ..arrays import any_lane, choose, when
from ..clock import Instant
from ..events import CAUGHT, EPS, SHARES, STRUCK
from ..solvers.diffrax_backend import Method
from ..solvers.series import SHORTEST, Ahead, Series
from .detect import Detector, Event, Rows, SeriesDetector
from .lane import (
    CLOSE,
    END,
    ENTER,
    FLOW,
    JUDGE,
    JUMP,
    LAND,
    LOOP,
    MAX_JUMPS,
    NOT_FINITE,
    OUTSIDE,
    RUNNING,
    UNDECIDED,
    Going,
    Lane,
    Run,
    Step,
)
from .system import Jumped, System

#: A first step after an impact, against the predicted flight.
AHEAD = 1.1

#: Attempts to step onto a guard.
LANDINGS = 4

#: Nearer than this many spacings of the time to a step's start, a guard fires there.
AT_ONCE = 4

#: Impacts are summed anew only after their speed has fallen to this share.
PATIENCE = 0.3


class Turner:
    """The pieces for one system and method.

    ``judged``: a lane stops where Python has to judge (an impact that may be summed, a guard
    about to touch); otherwise the compiled rules decide, without the finest distinctions.
    ``sums``: stop where a series of impacts may be summed. ``many``: for many lanes, whose steps
    are cheaper while none of them is held.
    """

    def __init__(
        self, system: System, method: Method, judged: bool, sums: bool, many: bool = False
    ) -> None:
        self.system, self.method, self.judged, self.many = system, method, judged, many
        self.sums = sums and bool(system.is_contact.any())
        self.watches = bool(system.spec.transitions)
        if isinstance(method, Series):
            self.detector: Detector = SeriesDetector(system, judged)
        else:
            self.detector = Detector(system, method, judged)

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
        landing, curved = going.stage == LAND, self.detector.curved(lane, free)
        wanted, last = self._length(run, lane, curved)
        kept, h, moved, refused, path = self._attempt(run, lane, held, wanted, last)
        step = Step(path.values(), going.tau, h)
        if not self.watches:
            return choose(kept, moved, refused), step
        rows = self.detector.rows(run, lane, held, path, h)
        moved = self._settled(run, lane, held, self._seen(moved, rows))
        looks = kept & ~landing
        event = self.detector.event(run, lane, rows, moved.x, h, curved, looks)
        result = self._decided(lane.now, going, kept, moved, refused, event, h)
        cut = event.fires & ~_at_once(lane.now, event, h) & self.method.dense
        aimed, there, length = self._cut(lane, moved, path, h, event, cut)
        landed = lambda: self._landed(run, aimed, held, there, length)  # noqa: E731
        return when(landing | cut, landed, result), step

    def _length(self, run: Run, lane: Lane, curved: Any) -> tuple[Any, Any]:
        """Length of the step to attempt, and whether it is the run's last."""
        going, left = lane.going, lane.left(run.end)
        landing, first = going.stage == LAND, going.tau == 0
        wanted = jnp.minimum(going.h, going.cap)
        wanted = jnp.minimum(wanted, jnp.where(first, lane.limit, jnp.inf))
        if curved is not None:
            wanted = jnp.where(curved, jnp.minimum(wanted, (run.t1 - run.t0) / SHARES), wanted)
        last = ~landing & (left <= wanted)
        h = jnp.where(last, left, stop_gradient(jnp.where(landing, going.reach, wanted)))
        return h, last | (h >= left)

    def _attempt(
        self, run: Run, lane: Lane, held: Any, h: Any, last: Any
    ) -> tuple[Any, Any, Going, Going, Any]:
        """A step: whether it is kept, its length, what follows if it is and if not, its path."""
        going, t0 = lane.going, lane.t + lane.low

        def step(held: Any) -> Any:
            def rate(s: Any, x: Any) -> Any:
                return self.system.flow(run.parameters, lane.mode, held, t0 + s, x)

            def values(s: Any, x: Any) -> Any:
                return self.system.guards(run.parameters, lane.mode, held, t0 + s, x)

            def expand(s: Any, x: Any) -> Ahead:
                p, mode = run.parameters, lane.mode
                series = self.system.series(p, mode, held, t0 + s, x)
                loads = held is not None and self.system.rests.any()
                seen = values if loads or not self.system.affine else None
                tolerance = self.detector.tolerance(run, lane)
                return Ahead(series, t0 + s, tolerance, seen)

            return self.method.attempt(rate, going.tau, h, going.x, run.rtol, run.atol, expand)

        if self.many and held is not None and self.system.rests.any():
            rests = any_lane(held.any())
            found = jax.lax.cond(rests, lambda: step(held), lambda: step(None))
        else:
            found = step(held)
        wanted, (x, kept, h, new, path) = h, found
        last = last & (h >= wanted)
        new = stop_gradient(jnp.where(kept & (h < going.h), jnp.maximum(new, going.h), new))
        failed = ~kept & (~(new > SHORTEST * going.tau) | (new < 1e-300))
        refused = going._replace(
            h=new,
            steps=going.steps + 1,
            status=jnp.where(failed, NOT_FINITE, going.status),
        )
        moved = refused._replace(
            tau=jnp.where(last, lane.left(run.end) + going.tau, going.tau + h),
            x=x,
            status=jnp.where(last, END, going.status),
        )
        return kept, h, moved, refused, path

    def _seen(self, moved: Going, rows: Rows) -> Going:
        """With what the guards were on the step."""
        moved = moved._replace(ends=rows.ends)
        if not self.judged:
            return moved
        return moved._replace(largest=jnp.maximum(moved.largest, rows.largest))

    def _decided(
        self, now: Any, going: Going, kept: Any, moved: Going, refused: Going, event: Event, h: Any
    ) -> Going:
        """After an attempt: gone on, refused, to be repeated onto a guard or shorter."""
        stays = ~kept | event.fires | event.halve | event.unsure
        result = choose(stays, refused, moved)
        aim = jnp.where(_at_once(now, event, h), JUMP, LAND)
        return result._replace(
            h=jnp.where(event.fires | event.halve, going.h, result.h),
            cap=jnp.where(event.halve | ~stays, event.cap, going.cap),
            reach=stop_gradient(jnp.where(event.fires, event.share, 0.0) * h),
            slot=jnp.where(event.fires, event.slot, going.slot),
            stage=jnp.where(event.fires, aim, going.stage),
            tries=jnp.where(event.fires, 0, going.tries),
            status=jnp.where(event.unsure, JUDGE, result.status),
        )

    def _cut(
        self, lane: Lane, moved: Going, path: Any, h: Any, event: Event, cut: Any
    ) -> tuple[Lane, Going, Any]:
        """The step cut where a guard fires, if the dense output is as good as a step."""
        if not self.method.dense:
            return lane, moved, h
        at = stop_gradient(jnp.where(cut, event.share, 0.5))
        inside = path.at(at)
        aimed = lane.but(
            slot=jnp.where(cut, event.slot, lane.going.slot),
            tries=jnp.where(cut, 0, lane.going.tries),
        )
        there = moved._replace(x=jnp.where(cut, inside, moved.x))
        return aimed, there, jnp.where(cut, at * h, h)

    def _settled(self, run: Run, lane: Lane, held: Any, going: Going) -> Going:
        """With the state back on the contacts held, or on the surface on which it slides."""
        if held is None or not self.system.projects:
            return going
        t = lane.t + (lane.low + going.tau)
        x = self.system.project(run.parameters, lane.mode, held, t, going.x)
        return going._replace(x=x)

    def _landed(self, run: Run, lane: Lane, held: Any, moved: Going, h: Any) -> Going:
        """After a step onto a guard: moved by the last rounding onto it, or sent again (5).

        The correction is Newton's, along the second-order curve of the flow. It carries the
        derivative of the time of the event; the length of the step that led here is a number
        like any other. A guard that is zero at the arc's start is zero where it is so again.
        """
        going, p = lane.going, run.parameters
        t = lane.now + h

        def flow(t: Any, x: Any) -> Any:
            return self.system.flow(p, lane.mode, held, t, x)

        rate = flow(t, moved.x)
        rate, bend = jax.jvp(flow, (t, moved.x), (jnp.ones_like(t), rate))
        bend = stop_gradient(bend)

        def on_curve(s: Any) -> Any:
            return moved.x + s * (rate + 0.5 * s * bend)

        zero = jnp.where((going.tau == 0) & (lane.orders > 0), stop_gradient(going.ends), 0.0)

        def guard(s: Any) -> Any:
            values = self.system.guards(p, lane.mode, held, t + s, on_curve(s)) - zero
            return jnp.where(self.system.only(going.slot), values, 0.0).sum()

        value, slope = jax.jvp(guard, (jnp.zeros_like(t),), (jnp.ones_like(t),))
        slope = stop_gradient(slope)
        steep = jnp.where(slope == 0, jnp.inf, slope)
        shift = jnp.maximum(-value / steep, -h)  # not before the step, however slow the gap
        noise = 8 * EPS * (1.0 + jnp.abs(moved.x).max()) / jnp.abs(steep)
        small = jnp.abs(shift) <= 1e-6 * h + noise
        again = ~small & (going.tries < LANDINGS) & (h + shift > 0)
        again = again & (h + shift <= lane.left(run.end))
        lost = ~small & ~again & self.judged
        reach = stop_gradient(h + shift)
        shift = jnp.where(small, jnp.maximum(shift - guard(shift) / steep, -h), 0.0)
        there = moved._replace(
            tau=going.tau + (h + shift),
            x=on_curve(shift),
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
        given_up = going._replace(
            stage=jnp.full_like(going.stage, FLOW),
            status=jnp.full_like(going.status, JUDGE),
            steps=moved.steps,
        )
        landed = self._settled(run, lane, held, there)
        return choose(lost, given_up, choose(again, more, landed))

    # -- jumps --------------------------------------------------------------------------

    def jumped(self, run: Run, lane: Lane) -> tuple[Lane, Jumped]:
        """The jump of the slot that fires; what it leads to is still to be entered."""
        going = lane.going
        now = Instant(lane.t, lane.low).after(going.tau)
        done = self.system.jump(run.parameters, lane.mode, going.slot, lane.held, now.t, going.x)
        fired = self.system.only(going.slot)
        contact = self.system.pick(self.system.is_contact, lane.mode, going.slot)
        release = contact & (lane.held & fired).any()
        impact = contact & ~release
        carried = (going.tau == 0) & (lane.orders == 0)  # over zero, by what delays see
        order = jnp.where(release, jnp.where(carried, 2, 3), 1)
        order = jnp.where(impact & ~(done.speed > 0), 2, order)
        same_mode = done.mode == lane.mode
        known = same_mode & (contact | (done.stays & ~carried))
        least = jnp.where(fired & known, order, 0)
        again = impact & (lane.series == going.slot)
        finite = jnp.isfinite(done.after).all() & jnp.isfinite(done.speed) & ~(done.speed < 0)
        stuck = jnp.where(going.tau > 4 * EPS * jnp.abs(lane.t), 0, lane.stuck + 1)
        status = jnp.where(lane.jumps + 1 >= run.max_jumps, MAX_JUMPS, going.status)
        status = jnp.where(stuck >= jnp.where(impact, STRUCK, CAUGHT), LOOP, status)
        after = lane._replace(
            t=now.t,
            low=now.low,
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
            slot=jnp.where(~contact & same_mode, going.slot, -1),
            stage=jnp.full_like(going.stage, ENTER),
            status=jnp.where(finite, jnp.where(done.sure, status, UNDECIDED), NOT_FINITE),
        )
        return after, done

    def enter(self, run: Run, lane: Lane, passing: Any = False) -> Lane:
        """Which guards are zero here, and what follows (2, 3).

        ``orders`` holds the powers known from the jump, ``slot`` the edge just used. A
        contact found closed is held, and the lane has to be entered again. ``passing``: there
        was no jump, but what delays see may have jumped, and guards with it (9).
        """
        lane = lane._replace(going=self._settled(run, lane, lane.held, lane.going))
        going, system = lane.going, self.system
        lies, rate, order, sign = self._signs(run, lane)
        starting = (lane.jumps == 0) & (lane.t == run.t0)
        contacts, rests = (system.pick(t, lane.mode) for t in (system.is_contact, system.rests))
        idle = (sign == 0) & rests  # no load, as of bodies that fall together
        slow = self._slow(lane, lies, order)
        closing = rests & ~lane.held & (idle | slow | ((order >= 2) & (sign < 0)))
        direction = system.pick(system.crossing, lane.mode)
        leaving = (direction != 0) & (sign == direction)
        late = (order == 0) & leaving
        bounds = system.pick(system.bounds, lane.mode)
        turned = (order == 0) & (sign * jnp.sign(going.ends) < 0)
        carried = (late & (bounds | turned)) | ((direction == 0) & turned)
        overdue = (late & lane.held & ~starting) | (carried & passing)
        used = system.only(going.slot)
        at_once = overdue | ((order > 0) & leaving & ~used)
        outside = late & ~overdue & bounds
        status = jnp.where(outside.any(), OUTSIDE, going.status)
        status = jnp.where(((sign == 0) & ~idle).any(), UNDECIDED, status)
        stage = jnp.where(at_once.any(), JUMP, FLOW)
        sums = (lane.speed > 0) & (lane.count >= 2) & (lane.speed <= PATIENCE * lane.tried)
        sums = sums & (stage == FLOW) & (status == RUNNING) & self.sums
        entered = lane._replace(
            orders=order, limit=flight_bound(lies, contacts & ~lane.held, order == 1)
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

    def _slow(self, lane: Lane, lies: Any, order: Any) -> Any:
        """Contacts left for a flight lower than rounding of the positions: at rest, but for a
        series of impacts, which is summed however slow they are."""
        series = self.system.only(lane.series) & (lane.count > 1)
        uses = self.system.pick(self.system.uses, lane.mode)
        height = 8 * EPS * jnp.where(uses, jnp.abs(lane.going.x), 0.0).max(axis=1)
        return (order == 1) & ~series & (lies[1] ** 2 <= -2.0 * height * lies[2])

    def _pull(self, run: Run, lane: Lane) -> Any:
        """What loads are as large as: they are accelerations, in any unit of time."""
        if not self.system.rests.any():
            return 0.0
        free = self.system.flow(run.parameters, lane.mode, None, lane.t, lane.going.x)
        return jnp.max(jnp.abs(free))

    def _signs(self, run: Run, lane: Lane) -> tuple[Any, Any, Any, Any]:
        """Guards with two derivatives; the flow; the power by which each vanishes; its sign."""
        t, x = lane.t, lane.going.x
        lies, flow = self.system.lies(run.parameters, lane.mode, lane.held, t, x)
        rate, uses = jnp.max(jnp.abs(flow)), self.system.pick(self.system.uses, lane.mode)
        own = jnp.where(uses, jnp.abs(x), 0.0).max(axis=1)
        tick = jnp.abs(t) * jnp.abs(lies)
        contacts = self.system.pick(self.system.is_contact, lane.mode) & ~lane.held
        size = jnp.where(lane.held, self._pull(run, lane), own)
        closed = contacts & ~(lies[0] > 0)  # no gap is outside by less than this
        first = jnp.where(closed, 1.0 + jnp.max(jnp.abs(x)), size)
        noise = 64 * EPS * jnp.stack([first + tick[1], size + rate + tick[2], size + rate])
        known = jnp.where(lane.held, 0, lane.orders)
        below = contacts & (lane.jumps > 0) & (lies[0] < 0)  # by less than solvers can tell
        sunk = jnp.where(below, self.detector.tolerance(run, lane), 0.0)
        noise = noise.at[0].set(jnp.maximum(noise[0], sunk))
        decides = (jnp.abs(lies) > noise) & (known <= jnp.arange(3)[:, None])
        order = jnp.where(decides[0], 0, jnp.where(decides[1], 1, jnp.where(decides[2], 2, 0)))
        order = jnp.where(known == 3, 3, order)
        value = jnp.where(order == 0, lies[0], jnp.where(order == 1, lies[1], lies[2]))
        sign = jnp.where(decides.any(axis=0), jnp.sign(value), 0.0)
        return lies, flow, order, jnp.where(known == 3, 1.0, sign)


def _at_once(now: Any, event: Event, h: Any) -> Any:
    """Whether a guard fires where a step of length ``h`` from a time starts."""
    return event.share * h <= AT_ONCE * EPS * jnp.abs(now)


def _first_step(run: Run, x: Any, rate: Any) -> Any:
    """Hairer, Norsett & Wanner, *Solving ODEs I*, II.4: the first guess."""
    scale = run.atol + run.rtol * jnp.abs(x)
    size, speed = jnp.max(jnp.abs(x) / scale), jnp.max(jnp.abs(rate) / scale)
    guess = 0.01 * size / jnp.where(speed > 0, speed, 1.0)
    guess = jnp.where((size > 1e-5) & (speed > 1e-5), guess, 1e-6)
    return stop_gradient(jnp.minimum(guess, run.t1 - run.t0))


def flight_bound(lies: Any, contacts: Any, leaving: Any) -> Any:
    """A bound on the first step: a little more than the flight predicted (2).

    ``contacts``: those open; ``leaving``: those just left, whose gap is zero.
    """
    gap, speed, force = jnp.where(leaving, 0.0, lies[0]), lies[1], lies[2]
    root = jnp.sqrt(jnp.maximum(speed**2 - 2.0 * gap * force, 0.0))
    rises = leaving | (speed > 0)
    length = jnp.where(rises, (speed + root) / -force, 2.0 * gap / (root - speed))
    falls = jnp.where(rises, (force < 0) & (speed > 0), (speed < 0) & (gap > 0))
    falls = falls & contacts & (speed**2 >= 2.0 * gap * force)
    return stop_gradient(AHEAD * jnp.min(jnp.where(falls, length, jnp.inf)))
