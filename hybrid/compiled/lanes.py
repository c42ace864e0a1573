"""A whole trajectory as a sequence of turns: :mod:`hybrid.function` makes a bounded number of
them, which can be differentiated."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..arrays import choose, when
from ..clock import Instant
from .lane import CLOSE, END, ENTER, FORGOTTEN, JUMP, NO_REST, RUNNING, ZENO, Lane, Run
from .past import Memory, Past, Ring
from .tail import Tails
from .turn import Turner


class Trip(NamedTuple):
    """A lane, and the first accumulation it passed.

    Attributes
    ----------
    t_inf, x_inf, error, ratio
        When and where (NaN if there was none), a bound on the error of the sum, the ratio.
    sums
        Accumulations passed so far.
    log : Log or None
        The jumps, where they are kept.
    memory, ring : Memory, Ring or None
        What delays see, in a model that has some, and the record.
    """

    lane: Lane
    t_inf: Any
    x_inf: Any
    error: Any
    ratio: Any
    sums: Any
    log: Any = None
    memory: Any = None
    ring: Any = None


class Log(NamedTuple):
    """Jumps in order; as many rows as there is room for.

    ``edge`` is the number of the edge among ``Journey.edges``, -1 in unused rows.
    """

    t: Any
    edge: Any
    before: Any
    after: Any


def empty_log(rows: int, x: Any) -> Log:
    """A log with nothing in it."""
    states = jnp.full((rows, len(x)), jnp.nan)
    return Log(jnp.full(rows, jnp.nan), jnp.full(rows, -1), states, states)


class Journey:
    """The loops for one system and method.

    Parameters
    ----------
    zeno : "rest", "stop" or "ignore"
        What happens where impacts accumulate; ignored, they are simulated one by one.
    carried : bool
        Let derivatives pass through sums.
    past : Past, optional
        The delays, in a model that has some.
    """

    def __init__(
        self, turner: Turner, zeno: str, carried: bool = False, past: Past | None = None
    ) -> None:
        self.turner, self.system, self.past = turner, turner.system, past
        self.tails, self.zeno, self.carried = Tails(turner.system), zeno, carried

    @property
    def edges(self) -> tuple[str, ...]:
        """Names of the edges, then of the releases of all contacts."""
        names = [edge.name for edges in self.system.edges.values() for edge in edges]
        return (*names, *(f"{name}.release" for name in names))

    def begin(self, run: Run, mode: Any, held: Any, x: Any, first: Any = None) -> Trip:
        """A trip at its start; ``first`` is what the history is a function of, besides time."""
        nothing = jnp.full_like(x[0], jnp.nan)
        lane = self.turner.begin(run, mode, held, x)
        trip = Trip(lane, nothing, jnp.full_like(x, jnp.nan), nothing, nothing, jnp.array(0))
        if self.past is None:
            return trip
        return trip._replace(memory=self.past.begin(run, x, first), ring=self.past.ring(len(x)))

    def seeing(self, run: Run, trip: Trip) -> Run:
        """The run as far, and with what, delays see at present."""
        if self.past is None:
            return run
        return run._replace(
            parameters=(*run.parameters, *trip.memory.windows), until=trip.memory.until
        )

    def turn(self, run: Run, trip: Trip) -> Trip:
        """One attempted step, then the jump it led to and the entry after it."""
        if self.past is not None:
            return self._turn_back(run, trip)
        going = trip.lane.going
        stays = (going.status != RUNNING) | (going.steps >= run.max_steps)
        flows = ~stays & (going.stage < JUMP)
        trip = when(flows, lambda: self._flow(run, trip), trip)
        going = trip.lane.going
        settles = (going.status == RUNNING) & (going.stage >= JUMP) & ~stays
        return when(settles, lambda: self._settle(run, trip), trip)

    def step(self, run: Run, trip: Trip) -> Trip:
        """A turn, then the sum of a series of impacts where one is due: for a single lane."""
        trip = self.turn(run, trip)
        if not self.turner.sums:
            return trip
        due = trip.lane.going.status == CLOSE
        return when(due, lambda: self.sum(run, trip), trip)

    def _turn_back(self, run: Run, trip: Trip) -> Trip:
        """A turn in a model with delays: where a window of the past ends, the next is made."""
        assert self.past is not None
        going = trip.lane.going
        stays = (going.status != RUNNING) | (going.steps >= run.max_steps)
        ring, memory = self.past.write(run, trip.ring, trip.memory)
        trip = trip._replace(memory=memory, ring=None)
        flows = ~stays & (going.stage < JUMP)
        trip = when(flows, lambda: self._flow(run, trip), trip)
        ring, memory = self.past.write(run, ring, trip.memory)
        trip = trip._replace(memory=memory)
        passes = (trip.lane.going.status == END) & (memory.until < run.t1)
        trip = when(passes, lambda: self._pass(run, ring, trip), trip)
        going = trip.lane.going
        settles = (going.status == RUNNING) & (going.stage >= JUMP) & ~stays
        return when(settles, lambda: self._settle(run, trip), trip)._replace(ring=ring)

    def _flow(self, run: Run, trip: Trip) -> Trip:
        lane, memory = trip.lane, trip.memory
        going, step = self.turner.flow(self.seeing(run, trip), lane)
        if self.past is not None:
            memory = self.past.flown(lane, going, step, memory)
        return trip._replace(lane=lane._replace(going=going), memory=memory)

    def _pass(self, run: Run, ring: Ring, trip: Trip) -> Trip:
        """Go on within an arc, with other windows of the past."""
        assert self.past is not None
        lane, memory = trip.lane, trip.memory
        now = Instant(lane.t, lane.low).after(lane.going.tau)
        memory = self.past.passed(run, ring, memory, lane.mode, lane.held, now.t)
        none = jnp.zeros_like(lane.going.tau)
        lane = lane._replace(
            t=now.t, low=now.low, orders=jnp.zeros_like(lane.orders), speed=none
        ).but(
            tau=none,
            slot=jnp.full_like(lane.going.slot, -1),
            stage=jnp.full_like(lane.going.stage, ENTER),
            status=self._remembers(memory, jnp.full_like(lane.going.status, RUNNING)),
        )
        return trip._replace(lane=lane, memory=memory._replace(passing=jnp.array(True)))

    def _known(self, after: Lane, released: Any) -> Any:
        """The powers by which guards vanish after a jump: one that restarts what delays see
        changes flows and guards at once."""
        assert self.past is not None
        if not self.past.restarts:
            return after.orders
        contact = self.system.pick(self.system.is_contact, after.mode)
        return jnp.where(contact, jnp.where(released, 2, after.orders), 0)

    @staticmethod
    def _remembers(memory: Memory, status: Any) -> Any:
        return jnp.where(memory.full & (status == RUNNING), FORGOTTEN, status)

    def _settle(self, run: Run, trip: Trip) -> Trip:
        """Jump where a guard has fired, and enter what follows."""
        if self.turner.watches:
            jumps = trip.lane.going.stage == JUMP
            trip = when(jumps, lambda: self._jump(run, trip), trip)
        lane = trip.lane
        moves = lane.going.status == RUNNING
        if self.past is None:
            return trip._replace(lane=choose(moves, self.turner.enter(run, lane), lane))
        memory = trip.memory
        entered = self.turner.enter(self.seeing(run, trip), lane, memory.passing)
        lane = choose(moves, self._low(run, trip, entered), lane)
        return trip._replace(lane=lane, memory=memory._replace(passing=jnp.array(False)))

    def _low(self, run: Run, trip: Trip, lane: Lane) -> Lane:
        """With delays, impacts are summed only where nothing they see can tell the flights."""
        if not self.turner.sums:
            return lane
        assert self.past is not None
        p, x, t = self.seeing(run, trip).parameters, lane.going.x, lane.t

        def flow(t: Any, x: Any) -> Any:
            return self.system.flow(p, lane.mode, lane.held, t, x)

        rate, bend = jax.jvp(flow, (t, x), (jnp.ones_like(t), flow(t, x)))
        lies, _ = self.system.lies(p, lane.mode, lane.held, t, x)
        fall = jnp.abs(jnp.where(self.system.only(lane.series), lies[2], 0.0).sum())
        length = 2.0 * lane.speed / fall
        way = jnp.abs(length * rate) + 0.5 * jnp.abs(length * length * bend)
        ratio = self.system.law(p, lane.mode, lane.series, t, x, jnp.array(-0.0))
        low = self.past.unseen(run, x, way, length / (1.0 - ratio))
        status = jnp.where((lane.going.status == CLOSE) & ~low, RUNNING, lane.going.status)
        return lane.but(status=status)

    def _jump(self, run: Run, trip: Trip) -> Trip:
        lane, log, memory = trip.lane, trip.log, trip.memory
        after, done = self.turner.jumped(self.seeing(run, trip), lane)
        if self.past is not None:
            memory = self.past.jumped(run, memory, after.t, done.before, done.after)
            after = after.but(status=self._remembers(memory, after.going.status))
            after = after._replace(orders=self._known(after, lane.held & ~done.held))
        if log is not None:
            slot, row = lane.going.slot, lane.jumps
            released = (lane.held & self.system.only(slot)).any()
            edge = self.system.number(lane.mode, slot) + released * (len(self.edges) // 2)
            log = Log(
                log.t.at[row].set(after.t + after.low, mode="drop"),
                log.edge.at[row].set(edge, mode="drop"),
                log.before.at[row].set(done.before, mode="drop"),
                log.after.at[row].set(done.after, mode="drop"),
            )
        return trip._replace(lane=after, log=log, memory=memory)

    # -- accumulations ------------------------------------------------------------------

    def sum(self, run: Run, trip: Trip) -> Trip:
        """Pass the accumulation, if the impacts from here on have one; else go on with them."""
        lane, memory = trip.lane, trip.memory
        slot, seeing = lane.series, self.seeing(run, trip)
        tail = self.tails.close(
            seeing, lane.mode, lane.held, slot, lane.t, lane.going.x, lane.speed, self.carried
        )
        found = tail.found & (lane.left(seeing.end) >= tail.remaining)
        end = Instant(lane.t, lane.low).after(tail.remaining)
        rests = self.system.pick(self.system.rests, lane.mode, slot)
        status = jnp.where(rests, RUNNING, NO_REST) if self.zeno == "rest" else ZENO
        rests = rests & (self.zeno == "rest")
        passed = lane._replace(
            t=end.t,
            low=end.low,
            held=lane.held | (rests & self.system.only(slot)),
            orders=jnp.zeros_like(lane.orders),
            series=jnp.full_like(lane.series, -1),
            count=jnp.zeros_like(lane.count),
            speed=jnp.zeros_like(lane.speed),
            tried=jnp.full_like(lane.tried, jnp.inf),
        ).but(
            x=tail.x_inf,
            slot=jnp.full_like(lane.going.slot, -1),
            stage=jnp.full_like(lane.going.stage, ENTER),
            status=jnp.broadcast_to(status, lane.going.status.shape),
        )
        onward = lane._replace(tried=lane.speed).but(
            status=jnp.full_like(lane.going.status, RUNNING)
        )
        if self.past is not None:
            if self.past.restarts:
                way = jnp.abs(tail.x_inf - lane.going.x)
                found = found & self.past.unseen(run, tail.x_inf, way, tail.remaining)
            limit = self.past.limit(run, memory, lane, end.t, tail.x_inf)
            memory = choose(found, limit, memory)
        first = found & (trip.sums == 0)
        return trip._replace(
            memory=memory,
            lane=choose(found, passed, onward),
            t_inf=jnp.where(first, end.t + end.low, trip.t_inf),
            x_inf=jnp.where(first, tail.x_inf, trip.x_inf),
            error=jnp.where(first, tail.t_error, trip.error),
            ratio=jnp.where(first, tail.ratio, trip.ratio),
            sums=trip.sums + found,
        )


def ended(run: Run, trip: Trip) -> Any:
    """Whether a lane stands still for good."""
    going = trip.lane.going
    over = (going.status == RUNNING) & (going.steps >= run.max_steps)
    return over | ((going.status != RUNNING) & (going.status != CLOSE))
