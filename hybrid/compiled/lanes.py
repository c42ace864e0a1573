"""A whole trajectory as a sequence of turns, each the same program for every lane.

:mod:`.abreast` makes turns of many lanes at once; :mod:`hybrid.function` a bounded number of
turns that can be differentiated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from ..clock import Instant
from .batch import choose, when
from .lane import CLOSE, ENTER, JUMP, NO_REST, RUNNING, ZENO, Lane, Run
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
    """

    lane: Lane
    t_inf: Any
    x_inf: Any
    error: Any
    ratio: Any
    sums: Any
    log: Any = None


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
    """

    def __init__(self, turner: Turner, zeno: str, carried: bool = False) -> None:
        self.turner, self.system = turner, turner.system
        self.tails, self.zeno, self.carried = Tails(turner.system), zeno, carried

    @property
    def edges(self) -> tuple[str, ...]:
        """Names of the edges, then of the releases of all contacts."""
        names = [edge.name for edges in self.system.edges.values() for edge in edges]
        return (*names, *(f"{name}.release" for name in names))

    def begin(self, run: Run, mode: Any, held: Any, x: Any) -> Trip:
        """A trip at its start."""
        nothing = jnp.full_like(x[0], jnp.nan)
        lane = self.turner.begin(run, mode, held, x)
        return Trip(lane, nothing, jnp.full_like(x, jnp.nan), nothing, nothing, jnp.array(0))

    def turn(self, run: Run, trip: Trip) -> Trip:
        """One attempted step, then the jump it led to and the entry after it."""
        lane = trip.lane
        stays = (lane.going.status != RUNNING) | (lane.going.steps >= run.max_steps)
        flows = ~stays & (lane.going.stage < JUMP)
        lane = when(flows, lambda: lane._replace(going=self.turner.flow(run, lane)[0]), lane)
        trip = trip._replace(lane=lane)
        settles = (lane.going.status == RUNNING) & (lane.going.stage >= JUMP) & ~stays
        return when(settles, lambda: self._settle(run, trip), trip)

    def _settle(self, run: Run, trip: Trip) -> Trip:
        """Jump where a guard has fired, and enter what follows."""
        if self.turner.watches:
            jumps = trip.lane.going.stage == JUMP
            trip = when(jumps, lambda: self._jump(run, trip), trip)
        lane = trip.lane
        moves = lane.going.status == RUNNING
        return trip._replace(lane=choose(moves, self.turner.enter(run, lane), lane))

    def _jump(self, run: Run, trip: Trip) -> Trip:
        lane, log = trip.lane, trip.log
        after, done = self.turner.jumped(run, lane)
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
        return trip._replace(lane=after, log=log)

    # -- accumulations ------------------------------------------------------------------

    def sum(self, run: Run, trip: Trip) -> Trip:
        """Pass the accumulation, if the impacts from here on have one; else go on with them."""
        lane = trip.lane
        slot = lane.series
        tail = self.tails.close(
            run, lane.mode, lane.held, slot, lane.t, lane.going.x, lane.speed, self.carried
        )
        found = tail.found & (lane.left(run.t1) >= tail.remaining)
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
        first = found & (trip.sums == 0)
        return trip._replace(
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
