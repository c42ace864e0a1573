"""Delays in compiled runs: a ring of segments, breaking points, and the windows on them.

The same windows as in :mod:`hybrid.run.memory` (where the rules are written out), as array code:
the record of a lane is a ring of its last segments, its breaking points another; windows are made
anew where they end, in one search, and hold for all the stages of the steps until then. Lags must
be constant along a run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient

from ..arrays import chebyshev
from ..automaton.past import DEGREE, blank
from ..automaton.trace import again
from ..events import EPS
from ..scene.windows import ROUNDING, SHARE, SMOOTH, TO_POWERS
from ..segment import apply, from_values, nodes
from ..solvers.diffrax_backend import Method
from .lane import Lane, Run, Step
from .system import System

#: Length of a window to try, against that of the last one.
LONGER = 4.0

#: Most halvings of a window.
HALVINGS = 40

#: How far a window's ends are moved inside to say to which segment they belong.
INSIDE = 1e-10


class Ring(NamedTuple):
    """The record of a lane: its last segments and breaking points, each row used in turn.

    It is large, so it is written to once a turn, and only read otherwise.

    Attributes
    ----------
    start, length, values
        Segments: where each starts and how long its step was, states at the method's nodes.
    breaks, orders
        Breaking points, and the order of each element there.
    """

    start: Any
    length: Any
    values: Any
    breaks: Any
    orders: Any


class Due(NamedTuple):
    """A segment and a breaking point to be written, where ``made`` and ``broke`` say so."""

    made: Any
    start: Any
    length: Any
    values: Any
    broke: Any
    at: Any
    orders: Any


class Memory(NamedTuple):
    """What delays see of a lane at present, and how its ring is to be read.

    Attributes
    ----------
    segments, met
        Segments and breaking points so far.
    first, constant
        What the history is a function of, besides time; whether that is what was, for ever.
    windows : tuple of arrays
    until
        How long the windows serve.
    ends, spans : array, shape (lags,)
        Where each window ends; the length to try next.
    full : bool
        Something was needed that the ring no longer holds.
    due : Due
    passing : bool
        The lane is to be entered anew where a window ended.
    """

    segments: Any
    met: Any
    first: Any
    constant: Any
    windows: Any
    until: Any
    ends: Any
    spans: Any
    full: Any
    due: Due
    passing: Any


class Past:
    """Delays of one system and method.

    Parameters
    ----------
    rows : int
        Room in the rings.
    restarts : bool
        After a jump the past is the state after it.
    history : callable ``(first, t)``, optional
        The states before the run; those of ``first`` if omitted.
    """

    def __init__(
        self,
        system: System,
        method: Method,
        rows: int,
        restarts: bool,
        history: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        self.code, self.spec = system.code, system.spec
        self.modes, self.method = system.modes, method
        self.rows, self.restarts, self.history = rows, restarts, history
        self.highest = method.order + 1
        self.lags = [again(self.code.closed("lag", lag.name)) for lag in self.spec.lags]
        self.seen = _mask(self.code.seen, self.spec.dimension)
        self.reach = self._reach()

    # -- the record -----------------------------------------------------------------------

    def ring(self, n: int) -> Ring:
        """A ring with nothing in it."""
        rows = self.rows
        return Ring(
            jnp.zeros(rows),
            jnp.ones(rows),
            jnp.zeros((rows, self.method.degree + 1, n)),
            jnp.zeros(rows),
            jnp.full((rows, n), SMOOTH),
        )

    def begin(self, run: Run, x: Any, first: Any) -> Memory:
        """Memory at the start of a run, with its first windows."""
        n, count = len(x), len(self.lags)
        zero, none = run.t0 * 0.0, jnp.array(False)
        values, smooth = jnp.zeros((self.method.degree + 1, n)), jnp.full(n, SMOOTH)
        memory = Memory(
            segments=jnp.array(0),
            met=jnp.array(0),
            first=first,
            constant=jnp.array(self.history is None),
            windows=tuple(jnp.asarray(w) for w in blank(self.spec.lags, n)),
            until=run.t0,
            ends=jnp.full(count, run.t0),
            spans=jnp.full(count, jnp.inf),
            full=none,
            due=Due(none, zero, zero, values, none, zero, smooth),
            passing=none,
        )
        orders = jnp.where(self._before(memory, run.t0) == x, 1, 0)
        memory = self._break(memory, run.t0, orders)
        return self.look(run, self.ring(n), memory, run.t0)

    def write(self, run: Run, ring: Ring, memory: Memory) -> tuple[Ring, Memory]:
        """Write what is due into the ring."""
        due = memory.due
        row, place = memory.segments % self.rows, memory.met % self.rows
        lost = due.broke & (memory.met >= self.rows)
        lost = lost & (ring.breaks[place] > due.at - self._lag_values(run).max())

        def put(column: Any, row: Any, new: Any, flag: Any) -> Any:
            return column.at[row].set(jnp.where(flag, new, column[row]))

        ring = Ring(
            put(ring.start, row, due.start, due.made),
            put(ring.length, row, due.length, due.made),
            put(ring.values, row, due.values, due.made),
            put(ring.breaks, place, due.at, due.broke),
            put(ring.orders, place, due.orders, due.broke),
        )
        none = jnp.zeros_like(due.made)
        return ring, memory._replace(
            segments=memory.segments + due.made,
            met=memory.met + due.broke,
            full=memory.full | lost,
            due=due._replace(made=none, broke=none),
        )

    def flown(self, lane: Lane, moved: Any, step: Step, memory: Memory) -> Memory:
        """With the step that a lane has made, if it has."""
        made = moved.tau > lane.going.tau
        return self._keep(memory, made, lane.now, step.length, step.values)

    @staticmethod
    def _keep(memory: Memory, made: Any, start: Any, length: Any, values: Any) -> Memory:
        due = memory.due._replace(made=made, start=start, length=length, values=values)
        return memory._replace(due=due)

    def jumped(self, run: Run, memory: Memory, t: Any, before: Any, after: Any) -> Memory:
        """After a jump."""
        if self.restarts:
            return self._restarted(run, memory, t, after)
        return self._break(memory, t, jnp.where(before == after, 1, 0))

    def limit(self, run: Run, memory: Memory, lane: Lane, t: Any, x: Any) -> Memory:
        """After an accumulation at ``t``: the way there, too low to be seen, is straight."""
        if self.restarts:
            return self._restarted(run, memory, t, x)
        share = jnp.asarray(nodes(self.method.degree))[:, None]
        straight = lane.going.x + share * (x - lane.going.x)
        memory = self._keep(memory, jnp.array(True), lane.now, t - lane.now, straight)
        return self._break(memory, t, jnp.ones(len(x), dtype=int))

    def _restarted(self, run: Run, memory: Memory, t: Any, x: Any) -> Memory:
        none = jnp.zeros_like(memory.segments)
        memory = memory._replace(segments=none, met=none, first=x, constant=jnp.array(True))
        memory = memory._replace(due=memory.due._replace(made=jnp.array(False)))
        memory = self._break(memory, t, jnp.ones(len(x), dtype=int))
        return self.look(run, self.ring(len(x)), memory, t)

    def _break(self, memory: Memory, t: Any, orders: Any) -> Memory:
        """With a breaking point at ``t``, if any order is low enough to matter."""
        due, matters = memory.due, orders.min() <= self.highest
        both = jnp.where(due.broke, jnp.minimum(due.orders, orders), orders)
        due = due._replace(
            broke=due.broke | matters,
            at=jnp.where(matters, t, due.at),
            orders=jnp.where(matters, both, due.orders),
        )
        return memory._replace(due=due)

    def _before(self, memory: Memory, t: Any) -> Any:
        """The state before the record begins."""
        if self.history is None:
            return memory.first
        return jnp.where(memory.constant, memory.first, self.history(memory.first, t))

    # -- windows --------------------------------------------------------------------------

    def passed(self, run: Run, ring: Ring, memory: Memory, mode: Any, held: Any, t: Any) -> Memory:
        """The windows' end is reached: note what follows from theirs, and look on."""
        lags, n = self._lag_values(run), self.spec.dimension
        slack = self._slack(lags, t)
        there = memory.ends + lags <= t + slack
        near = jnp.abs(self._breaks(ring, memory)[None] - memory.ends[:, None]) <= slack
        near = near & there[:, None]
        orders = jnp.where(near[:, :, None], ring.orders[None], SMOOTH).min(axis=1)
        carried = self._carried(mode, held.any().astype(int), orders)
        carried = jnp.where(near.any(), carried, jnp.full(n, SMOOTH))
        return self.look(run, ring, self._break(memory, t, carried), t)

    def _breaks(self, ring: Ring, memory: Memory) -> Any:
        """Breaking points; minus infinity in unused rows."""
        return jnp.where(jnp.arange(self.rows) < memory.met, ring.breaks, -jnp.inf)

    def look(self, run: Run, ring: Ring, memory: Memory, t: Any) -> Memory:
        """Windows from a time on."""
        until, windows, ends, spans = run.t1, [], [], []
        values, breaks = self._lag_values(run), self._breaks(ring, memory)
        slack = self._slack(values, t)
        for k in range(len(self.lags)):
            a = t - values[k]
            later = jnp.where(breaks > a + slack, breaks, jnp.inf).min()
            bound = jnp.minimum(later, t)
            far = jnp.minimum(bound, a + (until - t))
            record = stop_gradient((ring, memory))
            b = self._end(run, record, k, stop_gradient(a), stop_gradient(far))
            end = jnp.where(b == later, later + values[k], stop_gradient(b + values[k]))
            until = jnp.where(end < until, end, until)
            windows += self._window((ring, memory), stop_gradient(a), b)
            ends.append(b)
            spans.append(LONGER * (b - stop_gradient(a)))
        last = (memory.segments - self.rows) % self.rows
        wrapped = (memory.segments > self.rows) & (ring.start[last] > t - values.max())
        return memory._replace(
            windows=tuple(windows),
            until=until,
            ends=jnp.stack(ends),
            spans=jnp.stack(spans),
            full=memory.full | wrapped | ~(until > t) | ~(values >= 0).all(),
        )

    @staticmethod
    def _slack(lags: Any, t: Any) -> Any:
        """Times nearer than this are one."""
        return stop_gradient(8.0 * EPS * (jnp.abs(t) + lags.max()))

    def _lag_values(self, run: Run) -> Any:
        x = jnp.zeros(self.spec.dimension)
        parameters = (*run.parameters[: len(self.spec.parameters)], *blank(self.spec.lags, len(x)))
        return jnp.stack([lag(parameters, run.t0, x) for lag in self.lags])

    def _end(self, run: Run, record: Any, k: int, a: Any, b: Any) -> Any:
        """Where the window from ``a`` ends: at ``b``, or nearer so that it is resolved."""
        run = stop_gradient(run)
        b = jnp.minimum(b, a + record[1].spans[k])

        def coarse(carry: Any) -> Any:
            b, count = carry
            fine = self._resolved(run, self._sampled(record, a, b), k)
            return ~fine & (count < HALVINGS) & (b - a > 1e4 * EPS * (jnp.abs(a) + jnp.abs(b)))

        def shorter(carry: Any) -> Any:
            return a + 0.5 * (carry[0] - a), carry[1] + 1

        return jax.lax.while_loop(coarse, shorter, (b, jnp.array(0)))[0]

    def _resolved(self, run: Run, values: Any, k: int) -> Any:
        series = jnp.abs(apply(from_values(DEGREE), values))
        size = jnp.abs(values).max(axis=0)
        allowed = SHARE * (run.atol + run.rtol * size) + 2 * EPS * size
        return (~jnp.asarray(self.seen[k]) | (series[-3:].sum(axis=0) <= allowed)).all()

    def _window(self, record: Any, a: Any, b: Any) -> list[Any]:
        """Frame and coefficients, as the trace takes them; what is rounding is left out."""
        values = self._sampled(record, a, b)
        series = apply(from_values(DEGREE), values)
        noise = ROUNDING * jnp.abs(values).max(axis=0)
        loud = (jnp.abs(series) > noise)[::-1]
        heard = (jnp.cumsum(loud, axis=0) > 0)[::-1]
        frame = jnp.stack([0.5 * (a + b), 0.5 * (b - a)])
        return [frame, apply(TO_POWERS, jnp.where(heard, series, 0.0))]

    def _sampled(self, record: tuple[Ring, Memory], a: Any, b: Any) -> Any:
        """The record at a window's nodes; shape ``(DEGREE + 1, n)``."""
        ring, memory = record
        times = a + (b - a) * jnp.asarray(nodes(DEGREE))
        inside = times + INSIDE * (0.5 * (a + b) - times)
        start = jnp.where(jnp.arange(self.rows) < memory.segments, ring.start, jnp.inf)
        oldest = jnp.maximum(memory.segments - self.rows, 0)

        def at(t: Any, inner: Any) -> Any:
            began = (start <= inner).sum()
            row = (oldest + began - 1) % self.rows
            place = jnp.where(began > 0, (t - ring.start[row]) / ring.length[row], 0.0)
            weights = chebyshev(place, self.method.degree) @ from_values(self.method.degree)
            seen = (weights[:, None] * ring.values[row]).sum(axis=0)
            return jnp.where(began > 0, seen, self._before(memory, t))

        return jax.vmap(at)(times, inside)

    def unseen(self, run: Run, x: Any, way: Any, time: Any) -> Any:
        """Whether no lag can tell from ``x`` states so far from it for such a time."""
        way = way * jnp.minimum(1.0, time / self._lag_values(run).min())
        allowed = SHARE * (run.atol + run.rtol * jnp.abs(x)) + 2 * EPS * jnp.abs(x)
        return (~jnp.asarray(self.seen.any(axis=0)) | (way <= allowed)).all()

    # -- orders ---------------------------------------------------------------------------

    def _carried(self, mode: Any, rests: Any, seen: Any) -> Any:
        """Orders of the elements where lags see breaking points of orders ``seen`` (lags, n)."""
        states, past = self.reach
        uses, asks = jnp.asarray(states)[mode, rests], jnp.asarray(past)[mode, rests]
        own = 1 + jnp.where(asks, seen[None], SMOOTH).min(axis=(1, 2))
        for _ in range(self.spec.dimension):
            own = jnp.minimum(own, 1 + jnp.where(uses, own[None], SMOOTH).min(axis=1))
        return own

    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """What each element of the flow depends on: elements, and lags with elements.

        By mode, free (0) or along contacts (1).
        """
        n = self.spec.dimension
        states = np.zeros((len(self.modes), 2, n, n), dtype=bool)
        past = np.zeros((len(self.modes), 2, n, len(self.lags), n), dtype=bool)
        for number, mode in enumerate(self.modes):
            for rests, held in self._helds(mode):
                for i, (uses, asks) in enumerate(self.code.reach(mode, held)):
                    states[number, rests, i, sorted(uses - {i})] = True
                    for k, element in asks:
                        past[number, rests, i, k, element] = True
        return states, past

    def _helds(self, mode: str) -> list[tuple[int, tuple[str, ...]]]:
        """Contacts held in a mode: none, or one; if more can be, all that any flow depends on."""
        rests = [e.name for e in self.spec.leaving(mode) if getattr(e, "rests", False)]
        free = [(0, ())] if len(rests) < 2 else [(0, ()), (1, ())]
        return [*free, *((1, (name,)) for name in rests)]


def _mask(rows: Sequence[Sequence[int]], n: int) -> np.ndarray:
    mask = np.zeros((len(rows), n), dtype=bool)
    for k, elements in enumerate(rows):
        mask[k, list(elements)] = True
    return mask
