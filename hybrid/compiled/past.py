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

from ..automaton.past import DEGREE, blank
from ..automaton.trace import again
from ..events import EPS
from ..scene.lowered import Lowered
from ..scene.windows import ROUNDING, SHARE, SMOOTH, TO_POWERS
from ..segment import apply, from_values, nodes
from ..solvers.diffrax_backend import Method
from .batch import chebyshev
from .lane import Lane, Run, Step
from .system import System

#: Length of a window to try, against that of the last one.
LONGER = 4.0

#: Most halvings of a window.
HALVINGS = 40

#: How far a window's ends are moved inside to say to which segment they belong.
INSIDE = 1e-10


class Memory(NamedTuple):
    """What a lane remembers.

    Attributes
    ----------
    start, length, values, count
        Rings of segments: where each starts and how long its step was, states at the method's
        nodes; and how many there have been.
    first, constant
        What the history is a function of, besides time; whether that is what was, for ever.
    breaks, orders, met
        Rings of breaking points and of the order of each element there; and how many.
    windows : tuple of arrays
    until
        How long the windows serve.
    ends, spans : array, shape (lags,)
        Where each window ends; the length to try next.
    full : bool
        Something was needed that the rings no longer hold.
    """

    start: Any
    length: Any
    values: Any
    count: Any
    first: Any
    constant: Any
    breaks: Any
    orders: Any
    met: Any
    windows: Any
    until: Any
    ends: Any
    spans: Any
    full: Any


class Past:
    """Delays of one system and method.

    Parameters
    ----------
    segments : int
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
        segments: int,
        restarts: bool,
        history: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        self.code, self.spec = system.code, system.spec
        self.modes, self.method = system.modes, method
        self.segments, self.restarts, self.history = segments, restarts, history
        self.highest = method.order + 1
        self.lags = [again(self.code.closed("lag", lag.name)) for lag in self.spec.lags]
        self.seen = _mask(self.code.seen, self.spec.dimension)
        self.reach = self._reach()

    # -- the record -----------------------------------------------------------------------

    def begin(self, run: Run, x: Any, first: Any) -> Memory:
        """Memory at the start of a run, with its first windows."""
        n, rows = len(x), self.segments
        memory = Memory(
            start=jnp.full(rows, jnp.inf),
            length=jnp.ones(rows),
            values=jnp.zeros((rows, self.method.degree + 1, n)),
            count=jnp.array(0),
            first=first,
            constant=jnp.array(self.history is None),
            breaks=jnp.full(rows, -jnp.inf),
            orders=jnp.full((rows, n), SMOOTH),
            met=jnp.array(0),
            windows=tuple(jnp.asarray(w) for w in blank(self.spec.lags, n)),
            until=run.t0,
            ends=jnp.full(len(self.lags), run.t0),
            spans=jnp.full(len(self.lags), jnp.inf),
            full=jnp.array(False),
        )
        before = self._before(memory, run.t0)
        memory = self._break(run, memory, run.t0, jnp.where(before == x, 1, 0))
        return self.look(run, memory, run.t0)

    def flown(self, lane: Lane, moved: Any, step: Step, memory: Memory) -> Memory:
        """With the step that a lane has made, if it has."""
        made = moved.tau > lane.going.tau
        return self._kept(memory, made, lane.now, step.length, step.values)

    def _kept(self, memory: Memory, made: Any, start: Any, length: Any, values: Any) -> Memory:
        row = memory.count % self.segments
        put = lambda ring, new: ring.at[row].set(jnp.where(made, new, ring[row]))  # noqa: E731
        return memory._replace(
            start=put(memory.start, start),
            length=put(memory.length, length),
            values=put(memory.values, values),
            count=memory.count + made,
        )

    def jumped(self, run: Run, memory: Memory, t: Any, before: Any, after: Any) -> Memory:
        """After a jump."""
        if self.restarts:
            return self._restarted(run, memory, t, after)
        return self._break(run, memory, t, jnp.where(before == after, 1, 0))

    def limit(self, run: Run, memory: Memory, lane: Lane, t: Any, x: Any) -> Memory:
        """After an accumulation at ``t``: the way there, too low to be seen, is straight."""
        if self.restarts:
            return self._restarted(run, memory, t, x)
        share = jnp.asarray(nodes(self.method.degree))[:, None]
        straight = lane.going.x + share * (x - lane.going.x)
        memory = self._kept(memory, True, lane.now, t - lane.now, straight)
        return self._break(run, memory, t, jnp.ones(len(x), dtype=int))

    def _restarted(self, run: Run, memory: Memory, t: Any, x: Any) -> Memory:
        memory = memory._replace(
            start=jnp.full_like(memory.start, jnp.inf),
            count=jnp.zeros_like(memory.count),
            first=x,
            constant=jnp.array(True),
            breaks=jnp.full_like(memory.breaks, -jnp.inf),
            met=jnp.zeros_like(memory.met),
        )
        memory = self._break(run, memory, t, jnp.ones(len(x), dtype=int))
        return self.look(run, memory, t)

    def _break(self, run: Run, memory: Memory, t: Any, orders: Any) -> Memory:
        """With a breaking point at ``t``, if any order is low enough to matter."""
        row, matters = memory.met % self.segments, orders.min() <= self.highest
        oldest = memory.breaks[row]
        lost = matters & (oldest > t - self._lag_values(run).max())
        return memory._replace(
            breaks=memory.breaks.at[row].set(jnp.where(matters, t, oldest)),
            orders=memory.orders.at[row].set(jnp.where(matters, orders, memory.orders[row])),
            met=memory.met + matters,
            full=memory.full | lost,
        )

    def _before(self, memory: Memory, t: Any) -> Any:
        """The state before the record begins."""
        if self.history is None:
            return memory.first
        return jnp.where(memory.constant, memory.first, self.history(memory.first, t))

    # -- windows --------------------------------------------------------------------------

    def passed(self, run: Run, memory: Memory, mode: Any, t: Any) -> Memory:
        """The windows' end is reached: note what follows from theirs, and look on."""
        lags, n = self._lag_values(run), self.spec.dimension
        slack = 8.0 * EPS * jnp.abs(t)
        there = memory.ends + lags <= t + slack
        near = jnp.abs(memory.breaks[None] - memory.ends[:, None]) <= slack
        near = near & there[:, None]
        orders = jnp.where(near[:, :, None], memory.orders[None], SMOOTH).min(axis=1)
        carried = self._carried(mode, orders)
        matters = near.any() & (carried.min() <= self.highest)
        memory = self._break(run, memory, t, jnp.where(matters, carried, jnp.full(n, SMOOTH)))
        return self.look(run, memory, t)

    def look(self, run: Run, memory: Memory, t: Any) -> Memory:
        """Windows from a time on."""
        slack = 8.0 * EPS * jnp.abs(t)
        until, windows, ends, spans = run.t1, [], [], []
        values = self._lag_values(run)
        for k in range(len(self.lags)):
            a = t - values[k]
            later = jnp.where(memory.breaks > a + slack, memory.breaks, jnp.inf).min()
            bound = jnp.minimum(later, t)
            far = jnp.minimum(bound, stop_gradient(a + (until - t)))
            b = self._end(run, memory, k, stop_gradient(a), stop_gradient(far))
            b = jnp.where(b == later, later, b)
            until = jnp.minimum(until, b + values[k])
            windows += self._window(memory, stop_gradient(a), stop_gradient(b))
            ends.append(stop_gradient(b))
            spans.append(LONGER * stop_gradient(b - a))
        oldest = memory.start[memory.count % self.segments]
        wrapped = (memory.count > self.segments) & (oldest > t - values.max())
        stuck = ~(until > t)
        return memory._replace(
            windows=tuple(windows),
            until=until,
            ends=jnp.stack(ends),
            spans=jnp.stack(spans),
            full=memory.full | wrapped | stuck,
        )

    def _lag_values(self, run: Run) -> Any:
        x = jnp.zeros(self.spec.dimension)
        parameters = (*run.parameters[: len(self.spec.parameters)], *blank(self.spec.lags, len(x)))
        return jnp.stack([lag(parameters, run.t0, x) for lag in self.lags])

    def _end(self, run: Run, memory: Memory, k: int, a: Any, b: Any) -> Any:
        """Where the window from ``a`` ends: at ``b``, or nearer so that it is resolved."""
        memory, run = stop_gradient((memory, run))
        b = jnp.minimum(b, a + memory.spans[k])

        def coarse(carry: Any) -> Any:
            b, count = carry
            fine = self._resolved(run, self._sampled(memory, a, b), k)
            return ~fine & (count < HALVINGS) & (b - a > 1e4 * EPS * (jnp.abs(a) + jnp.abs(b)))

        def shorter(carry: Any) -> Any:
            return a + 0.5 * (carry[0] - a), carry[1] + 1

        return jax.lax.while_loop(coarse, shorter, (b, jnp.array(0)))[0]

    def _resolved(self, run: Run, values: Any, k: int) -> Any:
        series = jnp.abs(apply(from_values(DEGREE), values))
        size = jnp.abs(values).max(axis=0)
        allowed = SHARE * (run.atol + run.rtol * size) + 2 * EPS * size
        return (~jnp.asarray(self.seen[k]) | (series[-3:].sum(axis=0) <= allowed)).all()

    def _window(self, memory: Memory, a: Any, b: Any) -> list[Any]:
        """Frame and coefficients, as the trace takes them; what is rounding is left out."""
        values = self._sampled(memory, a, b)
        series = apply(from_values(DEGREE), values)
        noise = ROUNDING * jnp.abs(values).max(axis=0)
        loud = (jnp.abs(series) > noise)[::-1]
        heard = (jnp.cumsum(loud, axis=0) > 0)[::-1]
        frame = jnp.stack([0.5 * (a + b), 0.5 * (b - a)])
        return [frame, apply(TO_POWERS, jnp.where(heard, series, 0.0))]

    def _sampled(self, memory: Memory, a: Any, b: Any) -> Any:
        """The record at a window's nodes; shape ``(DEGREE + 1, n)``."""
        times = a + (b - a) * jnp.asarray(nodes(DEGREE))
        inside = times + INSIDE * (0.5 * (a + b) - times)

        def at(t: Any, inner: Any) -> Any:
            began = memory.start <= inner
            last = memory.start == jnp.where(began, memory.start, -jnp.inf).max()
            row = jnp.argmax(jnp.where(last, memory.length, -jnp.inf))
            place = (t - memory.start[row]) / memory.length[row]
            series = apply(from_values(self.method.degree), memory.values[row])
            seen = chebyshev(jnp.where(began.any(), place, 0.0), self.method.degree) @ series
            return jnp.where(began.any(), seen, self._before(memory, t))

        return jax.vmap(at)(times, inside)

    def unseen(self, run: Run, x: Any, way: Any) -> Any:
        """Whether no lag can tell from ``x`` a state so far from it."""
        allowed = SHARE * (run.atol + run.rtol * jnp.abs(x)) + 2 * EPS * jnp.abs(x)
        return (~jnp.asarray(self.seen.any(axis=0)) | (way <= allowed)).all()

    # -- orders ---------------------------------------------------------------------------

    def _carried(self, mode: Any, seen: Any) -> Any:
        """Orders of the elements where lags see breaking points of orders ``seen`` (lags, n)."""
        states, past = self.reach
        uses, asks = jnp.asarray(states)[mode], jnp.asarray(past)[mode]
        own = 1 + jnp.where(asks, seen[None], SMOOTH).min(axis=(1, 2))
        for _ in range(self.spec.dimension):
            own = jnp.minimum(own, 1 + jnp.where(uses, own[None], SMOOTH).min(axis=1))
        return own

    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """By mode and element of the flow: the elements, and lags with elements, it depends on."""
        n = self.spec.dimension
        states = np.zeros((len(self.modes), n, n), dtype=bool)
        past = np.zeros((len(self.modes), n, len(self.lags), n), dtype=bool)
        for number, mode in enumerate(self.modes):
            for closed in self._flows(mode):
                for i, (uses, asks) in enumerate(self.code.reach(closed)):
                    states[number, i, sorted(uses - {i})] = True
                    for k, element in asks:
                        past[number, i, k, element] = True
        return states, past

    def _flows(self, mode: str) -> Sequence[Any]:
        """The flows of a mode: free, and with each of its contacts held."""
        rests = [e.name for e in self.spec.leaving(mode) if getattr(e, "rests", False)]
        helds = [(), *((name,) for name in rests)]
        return [self.code.field_closed(mode, held) for held in helds]


def _mask(rows: Sequence[Sequence[int]], n: int) -> np.ndarray:
    mask = np.zeros((len(rows), n), dtype=bool)
    for k, elements in enumerate(rows):
        mask[k, list(elements)] = True
    return mask
