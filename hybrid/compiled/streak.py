"""A compiled streak of plain arcs: what :func:`hybrid.simulate` runs between two judgements.

Steps, events, landings, impacts and resets are made in one program, in chunks of so many
records. A lane stops (``JUDGE``) where a rule needs more than the plain case: a contact held or
closing, a guard close to zero after a jump, a touch, a series of impacts that may be summed.
There :mod:`hybrid.run` goes on with the same rules, written out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..arrays import choose, when
from ..jit import jit
from ..rules.guards import NEAR
from ..solvers.diffrax_backend import ATTEMPTS, Method
from .lane import FLOW, JUDGE, JUMP, RUNNING, Lane, Run, Step
from .system import System
from .turn import Turner, flight_bound

#: Records in a chunk.
ROWS = 128


class Watch(NamedTuple):
    """When a series of impacts may be summed: from so many on, slower than a share of the last."""

    patience: Any
    share: Any


class Record(NamedTuple):
    """A step kept, or a jump; a landing is both.

    Attributes
    ----------
    step : bool
        A step was made: ``values`` at the method's nodes, from ``start`` on, ``length`` long.
    jump : bool
        A jump ended the arc: of ``slot``, at local time ``tau`` and time ``t + low``, from
        ``before`` to ``after``.
    """

    step: Any
    values: Any
    start: Any
    length: Any
    jump: Any
    slot: Any
    tau: Any
    t: Any
    low: Any
    before: Any
    after: Any


class Streak:
    """The chunk program of a system and method.

    ``dense``: keep every step.
    """

    def __init__(self, system: System, method: Method, dense: bool) -> None:
        self.system, self.method, self.dense = system, method, dense
        self.turner = Turner(system, method, judged=True, sums=True)
        self.chunk = jit(self._chunk, whole=self.turner.whole)

    def begin(self, x: np.ndarray, start: dict[str, Any], going: dict[str, Any]) -> Lane:
        """A lane at the start of an arc; what is given replaces the entries at a run's start."""
        run = Run((), 0.0, 1.0, 0.0, 0.0, 0, 0)
        lane = self.turner.begin(run, 0, np.zeros(self.system.width, dtype=bool), x, np)
        return lane._replace(**start).but(stage=np.asarray(FLOW), **going)

    def _chunk(self, run: Run, watch: Watch, lane: Lane) -> tuple[Lane, Record]:
        until = run._replace(max_steps=lane.going.steps + ATTEMPTS)

        def one(lane: Lane, _: Any) -> tuple[Lane, Record]:
            return self._record(until, watch, lane)

        return jax.lax.scan(one, lane, length=ROWS)

    def _record(self, run: Run, watch: Watch, lane: Lane) -> tuple[Lane, Record]:
        """Go on to the next step kept (if every step is) or to the next jump."""
        going, n = lane.going, len(lane.going.x)
        degree = self.method.degree
        empty = Step(jnp.zeros((degree + 1, n)), going.tau, jnp.zeros_like(going.tau))
        start = going.tau

        def goes_on(carry: Any) -> Any:
            going = carry[0]
            moves = (going.status == RUNNING) & (going.stage < JUMP)
            moves = moves & (going.steps < run.max_steps)
            return moves & (going.tau == start) if self.dense else moves

        def body(carry: Any) -> Any:
            going, step = self.turner.flow(run, lane._replace(going=carry[0]), True)
            return going, step if self.dense else carry[1]

        going, step = jax.lax.while_loop(goes_on, body, (going, empty))
        made = going.tau > start
        lane = lane._replace(going=going)
        record = Record(
            made,
            step.values,
            step.start,
            step.length,
            jnp.array(False),
            going.slot,
            going.tau,
            lane.t,
            lane.low,
            going.x,
            going.x,
        )
        if not self.turner.watches:
            return lane, record
        jumps = (going.status == RUNNING) & (going.stage == JUMP)
        return when(jumps, lambda: self._jump(run, watch, lane, record), (lane, record))

    def _jump(self, run: Run, watch: Watch, lane: Lane, record: Record) -> tuple[Lane, Record]:
        """The jump, if what it leads to is plain."""
        after, done = self.turner.jumped(run, lane)
        x = after.going.x
        lies, _ = self.system.lies(run.parameters, after.mode, None, after.t, x)
        size = 1.0 + jnp.max(jnp.abs(x))
        sign = self.system.pick(self.system.crossing, after.mode)
        clear = (jnp.abs(lies[0]) > NEAR * size) & (lies[0] * sign <= 0)
        impact = after.series >= 0
        own = self.system.only(lane.going.slot) & impact
        fall = jnp.where(own, -lies[2], 0.0).sum()
        high = done.speed**2 > NEAR * jnp.abs(fall) * size
        rests = self.system.pick(self.system.is_contact, lane.mode, lane.going.slot)
        again = rests & (after.count >= watch.patience)
        again = again & (done.speed <= watch.share * after.tried)
        plain = (clear | own).all() & ~(impact & (~high | again))
        plain = plain & (after.going.status == RUNNING)
        contacts = self.system.pick(self.system.is_contact, after.mode)
        limit = flight_bound(lies, contacts, own)
        entered = after._replace(orders=jnp.where(own, 1, 0), limit=limit).but(
            ends=lies[0],
            largest=jnp.abs(lies[0]),
            stage=jnp.full_like(after.going.stage, FLOW),
        )
        judged = lane.but(status=jnp.full_like(lane.going.status, JUDGE))
        jumped = record._replace(
            jump=plain, t=after.t, low=after.low, before=done.before, after=done.after
        )
        return choose(plain, entered, judged), jumped
