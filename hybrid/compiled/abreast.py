"""Many lanes abreast: a fixed number of places, refilled as lanes end.

One program runs all places in step, so the cost of a turn is shared. A place whose lane has
ended is given the next one, so that one long lane does not hold up the others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..arrays import choose
from .lane import CLOSE, MAX_STEPS, RUNNING, Run
from .lanes import Journey, Trip, ended

#: Turns between two looks at who has ended.
TURNS = 16


class Work(NamedTuple):
    """Places, the lane each one has (``count`` if none), the next lane, results."""

    trips: Trip
    lane: Any
    following: Any
    results: Any


class Abreast:
    """Runs lanes of one journey in ``places`` places.

    ``starts`` are the lanes' own ``(run, mode, held, x, first)``, lanes as first axis; the
    first ``count`` of them are run. ``show`` picks what is kept of a trip that has ended.
    """

    def __init__(self, journey: Journey, places: int, show: Any) -> None:
        self.journey, self.places, self.show = journey, places, show

    def begin(self, starts: Any, count: Any) -> Work:
        """The first lanes in their places."""
        room = len(starts[-1])
        lane = jnp.broadcast_to(count, self.places)
        trips = self._fresh(starts, jnp.zeros(self.places, dtype=int))
        one = jax.eval_shape(lambda: self.show(jax.tree.map(lambda a: a[0], trips)))
        results = jax.tree.map(lambda a: jnp.zeros((room, *a.shape), a.dtype), one)
        return self._refill(starts, count, Work(trips, lane, jnp.array(0), results))

    def advance(self, starts: Any, count: Any, work: Work, rounds: Any) -> Work:
        """At most so many rounds of turns."""

        def goes_on(carry: Any) -> Any:
            work, done = carry
            return (done < rounds) & (work.lane < count).any()

        def body(carry: Any) -> Any:
            work, done = carry
            runs = self._runs(starts, work.lane)
            turn = jax.vmap(self.journey.turn)
            trips = jax.lax.fori_loop(0, TURNS, lambda _, trips: turn(runs, trips), work.trips)
            work = work._replace(trips=trips)
            if self.journey.turner.sums:
                work = self._sum(runs, work, work.lane < count)
            return self._refill(starts, count, work), done + 1

        return jax.lax.while_loop(goes_on, body, (work, jnp.array(0)))[0]

    def left(self, count: Any, work: Work) -> Any:
        """How many lanes are not yet done."""
        return (work.lane < count).sum() + count - work.following

    def _runs(self, starts: Any, lane: Any) -> Run:
        """What is asked of the lane in each place."""
        which = jnp.minimum(lane, len(starts[-1]) - 1)
        runs: Run = jax.tree.map(lambda a: a[which], starts[0])
        return runs

    def _fresh(self, starts: Any, lane: Any) -> Trip:
        which = jnp.minimum(lane, len(starts[-1]) - 1)
        own = jax.tree.map(lambda a: a[which], starts)
        trips: Trip = jax.vmap(self.journey.begin)(*own)
        return trips

    def _refill(self, starts: Any, count: Any, work: Work) -> Work:
        """Keep what has ended; give its place to the next lanes."""
        done = jax.vmap(ended)(self._runs(starts, work.lane), work.trips)
        kept = jax.vmap(self.show)(work.trips)
        target = jnp.where(done & (work.lane < count), work.lane, len(starts[-1]))
        results = jax.tree.map(
            lambda all_, own: all_.at[target].set(own, mode="drop"), work.results, kept
        )
        free = done | (work.lane >= count)
        lane = jnp.where(free, work.following + jnp.cumsum(free) - 1, work.lane)
        lane = jnp.minimum(lane, count)
        fresh = self._fresh(starts, lane)._replace(ring=work.trips.ring)
        trips = jax.vmap(choose)(free, fresh, work.trips)
        return Work(trips, lane, jnp.minimum(work.following + free.sum(), count), results)

    def _sum(self, runs: Run, work: Work, taken: Any) -> Work:
        """Sum the series that are due, an eighth of the places at a time."""
        some = max(1, self.places // 8)
        due = (work.trips.lane.going.status == CLOSE) & taken

        ring, trips = work.trips.ring, work.trips._replace(ring=None)

        def goes_on(carry: Any) -> Any:
            return carry[1].any()

        def body(carry: Any) -> Any:
            trips, due = carry
            which = jnp.argsort(~due)[:some]
            chosen = jax.tree.map(lambda a: a[which], (runs, trips))
            summed = jax.vmap(self.journey.sum)(*chosen)
            summed = jax.vmap(choose)(due[which], summed, chosen[1])
            trips = jax.tree.map(lambda a, b: a.at[which].set(b), trips, summed)
            return trips, due.at[which].set(False)

        trips, _ = jax.lax.while_loop(goes_on, body, (trips, due))
        return work._replace(trips=trips._replace(ring=ring))


def status_of(trip: Trip) -> Any:
    """Why a lane ended."""
    status = trip.lane.going.status
    return jnp.where(status == RUNNING, MAX_STEPS, status)
