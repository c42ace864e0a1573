"""Many lanes one after another: what suits a CPU, where a branch not taken costs nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..arrays import when
from .lanes import Journey, Trip, ended

#: Turns in a round.
TURNS = 4096


class Work(NamedTuple):
    """The lane on its way, its number, and what has become of those before it."""

    trip: Trip
    lane: Any
    results: Any


class Serial:
    """Runs lanes of one journey, with the face of :class:`.abreast.Abreast`."""

    def __init__(self, journey: Journey, show: Any) -> None:
        self.journey, self.show = journey, show

    def begin(self, starts: Any, count: Any) -> Work:
        """Before the first lane."""
        trip = self._fresh(starts, jnp.array(0))
        one = jax.eval_shape(lambda: self.show(trip))
        room = len(starts[-1])
        results = jax.tree.map(lambda a: jnp.zeros((room, *a.shape), a.dtype), one)
        return Work(trip, jnp.array(0), results)

    def left(self, count: Any, work: Work) -> Any:
        """How many lanes are not yet done."""
        return count - work.lane

    def advance(self, starts: Any, count: Any, work: Work, rounds: Any) -> Work:
        """At most so many rounds of turns."""

        def goes_on(carry: Any) -> Any:
            work, turns = carry
            return (work.lane < count) & (turns > 0)

        def body(carry: Any) -> Any:
            work, turns = carry
            run = jax.tree.map(lambda a: a[work.lane], starts[0])
            trip, turns = jax.lax.while_loop(
                lambda c: ~ended(run, c[0]) & (c[1] > 0),
                lambda c: (self.journey.step(run, c[0]), c[1] - 1),
                (work.trip, turns),
            )
            results = jax.tree.map(
                lambda all_, own: all_.at[work.lane].set(own), work.results, self.show(trip)
            )
            done = ended(run, trip)
            lane = work.lane + done
            trip = when(done, lambda: self._fresh(starts, lane), trip)
            return Work(trip, lane, results), turns

        return jax.lax.while_loop(goes_on, body, (work, rounds * TURNS))[0]

    def _fresh(self, starts: Any, lane: Any) -> Trip:
        own = jax.tree.map(lambda a: a[jnp.minimum(lane, len(a) - 1)], starts)
        return self.journey.begin(*own)
