"""The sum of infinitely many impacts, as array code (compare :mod:`hybrid.rules.sums`).

The curve ``y(w)`` and its equations are the same (``docs/notes/chatter.md``). The flights are
not expanded in Taylor series but collocated, all at once: on Chebyshev points of each flight
the states are iterated (Picard) together with the curve. The gap is a coordinate of its own
here too: with the gap's acceleration ``a(s)`` along a flight of length ``theta`` that starts
with gap speed ``v``::

    0 = v + theta * integral of (1 - s) a(s),    u = v + theta * integral of a(s)

so that no digit is lost to the size of the state, and no zero is sought.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.chebyshev import chebvander

from ..arrays import chebyshev, when
from ..events import EPS
from ..rules.sums import CAUTION, FLOOR, PROBES, ROUNDING, SAMPLES, SMOOTH
from ..scene.python import solve
from ..segment import from_values, integrals, nodes
from .lane import Run
from .system import System

#: Degree of the curve, and of each flight: low, for another impact costs less than a point.
DEGREE, FLIGHT = 6, 6

#: Sweeps after which the change must have fallen to this, or the impacts are too strong yet.
TRIAL, HOPE = 5, 1e-4

#: Sweeps that show roughly where a flight goes.
ROUGH = 8

#: Most sweeps, and sweeps through which derivatives are carried.
SWEEPS, CARRIED = 40, 14


#: Integrals along a flight: to each node, to its end, and of ``(1 - s) a`` to its end.
_RUNNING = integrals(FLIGHT)
_WHOLE, _TWICE = _RUNNING[-1], _RUNNING[-1] @ _RUNNING
_TO_CURVE = from_values(DEGREE)

#: Where flights begin: the points of the curve, then those at which it is put to the test.
_W = np.concatenate([nodes(DEGREE)[1:], PROBES])
_AT = chebvander(2.0 * _W - 1.0, DEGREE) @ _TO_CURVE


class Tail(NamedTuple):
    """A sum, if there is one (``found``)."""

    found: Any
    remaining: Any
    x_inf: Any
    t_error: Any
    x_error: Any
    ratio: Any


class _Curve(NamedTuple):
    """A curve and the flights from it.

    Attributes
    ----------
    offsets : array, shape (points + 1, 1 + n)
        Time and state at the points of the curve, less those at its start.
    bend : array, shape (points + 1,)
        ``l``: the logarithm of the gap's speed over ``v w``.
    flights, lengths : array, shape (flights, nodes, n), (flights,)
        States along each flight, and its length.
    forces, guards : array, shape (flights, nodes), (flights, nodes, slots)
        The gap's acceleration along each flight, and all guards.
    ratio
        Restitution at the limit.
    """

    offsets: Any
    bend: Any
    flights: Any
    lengths: Any
    forces: Any
    guards: Any
    ratio: Any


class Tails:
    """Sums series of impacts of a system."""

    def __init__(self, system: System) -> None:
        self.system = system

    def close(
        self, run: Run, mode: Any, held: Any, slot: Any, t: Any, x: Any, v: Any, carried: bool
    ) -> Tail:
        """Sum the impacts that follow an impact with gap speed ``v``.

        ``carried``: let derivatives pass, at the cost of some sweeps more.
        """
        of = _Series(self.system, run, mode, held, slot, t, x, v)
        fixed = _Series(self.system, *jax.lax.stop_gradient((run, mode, held, slot, t, x, v)))
        curve, change = fixed.solve()
        found, t_error, x_error = fixed.judge(curve, change)
        if carried:
            curve, _ = jax.lax.scan(lambda c, _: (of.sweep(c), None), curve, length=CARRIED)
        return of.limit(curve, found, t_error, x_error)


class _Series:
    """One series: from an impact on."""

    def __init__(
        self, system: System, run: Run, mode: Any, held: Any, slot: Any, t: Any, x: Any, v: Any
    ) -> None:
        self.system, self.run, self.p = system, run, run.parameters
        self.mode, self.held, self.slot = mode, held, slot
        self.t, self.x, self.v = t, x, v
        ticks = 8 * EPS * jnp.abs(t) * jnp.abs(self._lies(t, x)[1])
        self.noise = jnp.concatenate([jnp.zeros(1), ticks])  # rounding of the time, in states

    # -- the iteration ------------------------------------------------------------------

    def solve(self) -> tuple[_Curve, Any]:
        """Sweep until nothing changes; the curve, and what the last sweep changed (time)."""
        share = jnp.maximum(1e-4 * self.run.rtol, 4e-16)

        def goes_on(carry: Any) -> Any:
            curve, change, count = carry
            enough = share + 4e-16 / (1.0 - curve.ratio)
            hopeless = (count >= TRIAL) & (change > HOPE)
            return (count < SWEEPS) & (change > enough) & jnp.isfinite(change) & ~hopeless

        def body(carry: Any) -> Any:
            curve, _, count = carry
            new = self.sweep(curve)
            moved = jnp.abs(new.offsets - curve.offsets).max(axis=0) - self.noise
            change = jnp.maximum(jnp.max(moved / self.scale(new)), 0.0)
            return new, jnp.where(count < 3, 1.0, change), count + 1

        curve, change, _ = jax.lax.while_loop(
            goes_on, body, (self.guess(), jnp.array(1.0), jnp.array(0))
        )
        return curve, change

    def guess(self) -> _Curve:
        """All flights at their start, and all from the same place."""
        size, n, many = DEGREE + 1, len(self.x), len(_W)
        return _Curve(
            jnp.zeros((size, 1 + n)),
            jnp.zeros(size),
            jnp.broadcast_to(self.x, (many, FLIGHT + 1, n)),
            jnp.zeros(many),
            jnp.zeros((many, FLIGHT + 1)),
            jnp.zeros((many, FLIGHT + 1, self.system.width)),
            self._law(self.t, self.x, jnp.array(-0.0)),
        )

    def sweep(self, curve: _Curve) -> _Curve:
        """All flights once more, then the curve through them."""
        starts = jnp.asarray(_AT) @ jnp.column_stack([curve.offsets, curve.bend])
        speeds = self.v * jnp.asarray(_W) * jnp.exp(starts[:, -1])
        steps, flights, lengths, forces, guards = jax.vmap(self._flight)(
            starts[:, :-1], speeds, curve.flights, curve.lengths, curve.ratio * speeds
        )
        matrix = (_differences(curve.ratio) @ jnp.asarray(_TO_CURVE))[1:, :-1]
        values = jnp.stack(solve(list(map(list, matrix)), list(steps[:DEGREE])))
        values = jnp.concatenate([values, jnp.zeros_like(values[:1])])
        end = self._onto(values[0, 0], self.x + values[0, 1:-1], 0.0)
        ratio = self._law(self.t + values[0, 0], end, jnp.array(-0.0))
        return _Curve(values[:, :-1], values[:, -1], flights, lengths, forces, guards, ratio)

    def _flight(
        self, offset: Any, v: Any, states: Any, length: Any, expected: Any
    ) -> tuple[Any, Any, Any, Any, Any]:
        """One flight: the step it makes along the curve, its states, length, forces, guards."""
        start = self._onto(offset[0], self.x + offset[1:], v)
        times = self.t + offset[0] + length * jnp.asarray(nodes(FLIGHT))
        lies, rates = jax.vmap(self._lies)(times, states)
        a = lies[:, 2, self.slot]
        length = -v / (jnp.asarray(_TWICE) @ a)
        states = start + length * (jnp.asarray(_RUNNING) @ rates)
        u = v + length * (jnp.asarray(_WHOLE) @ a)
        end = self.t + offset[0] + length
        after = self._law(end, states[-1], u) * -u
        landed, push, _ = self._touch(end, states[-1])
        moved = landed + push * (after - u)
        bend = jnp.log(after / expected)
        step = jnp.concatenate([length[None], moved - start, bend[None]])
        return step, states, length, a, lies[:, 0]

    def _onto(self, since: Any, x: Any, v: Any) -> Any:
        """A state moved to gap 0 and gap speed ``v``."""
        landed, push, speed = self._touch(self.t + since, x)
        return landed + push * (v - speed)

    def _lies(self, t: Any, x: Any) -> tuple[Any, Any]:
        return self.system.lies(self.p, self.mode, self.held, t, x)

    def _touch(self, t: Any, x: Any) -> tuple[Any, Any, Any]:
        return self.system.touch(self.p, self.mode, self.slot, t, x)

    def _law(self, t: Any, x: Any, u: Any) -> Any:
        return self.system.law(self.p, self.mode, self.slot, t, x, u)

    # -- what it is worth ---------------------------------------------------------------

    def scale(self, curve: _Curve) -> Any:
        """Size of time and of each element of the state, over the tail."""
        size = jnp.abs(curve.offsets[0]) + jnp.abs(jnp.concatenate([self.t[None], self.x]))
        return size + EPS * size.max()

    def judge(self, curve: _Curve, change: Any) -> tuple[Any, Any, Any]:
        """Whether the curve is one, far down and between its points; bounds on its error."""
        run, size = self.run, self.scale(curve)
        remaining, r = curve.offsets[0, 0], curve.ratio
        spectrum = jnp.abs(curve.forces @ jnp.asarray(from_values(FLIGHT)).T)
        blur = jnp.max(_next(spectrum.T) / jnp.abs(curve.forces).min(axis=1))
        left = _next(jnp.abs(jnp.asarray(_TO_CURVE) @ curve.offsets))
        left = CAUTION * (left + change * size + blur * jnp.abs(curve.offsets[0]))
        rounding = ROUNDING / (1.0 - r) * size.at[0].set(remaining) + self.noise
        floor = 1e-3 * jnp.max(run.atol) * (jnp.arange(len(size)) > 0)  # for states, not time
        allowed = CAUTION * jnp.maximum(1e-3 * run.rtol, FLOOR) * size + rounding + floor
        allowed = allowed + CAUTION * self.noise
        sane = (r > 0) & (r < 1.0 - 1e-12) & (remaining > 0) & (curve.lengths > 0).all()
        sane = sane & (left <= allowed).all() & (curve.forces < 0).all()
        found = when(
            sane, lambda: self._holds(curve, allowed[0]) & self._clear(curve), jnp.array(False)
        )
        error = left + rounding + FLOOR * size
        return found, error[0], error[1:]

    def _clear(self, curve: _Curve) -> Any:
        """Whether no other guard is reached along the tail: impacts and flights."""
        if self.system.width == 1:
            return jnp.array(True)
        w = self._even(jnp.asarray(_TO_CURVE) @ curve.offsets)
        series = jnp.asarray(_TO_CURVE) @ jnp.column_stack([curve.offsets, curve.bend])
        starts = chebyshev(w, DEGREE) @ series
        speeds = self.v * w * jnp.exp(starts[:, -1])
        states = jnp.broadcast_to(self.x, (SAMPLES, FLIGHT + 1, len(self.x)))

        def again(_: Any, carry: Any) -> Any:
            states, lengths, _ = carry
            flown = jax.vmap(self._flight)(starts[:, :-1], speeds, states, lengths, speeds)
            return flown[1], flown[2], flown[4]

        guards = jnp.zeros((SAMPLES, FLIGHT + 1, self.system.width))
        start = (states, jnp.zeros(SAMPLES), guards)
        guards = jax.lax.fori_loop(0, ROUGH, again, start)[2]
        values = jnp.concatenate([guards, curve.guards]).reshape(-1, self.system.width)
        own = self.system.only(self.slot)
        remaining, x_inf = self._end(curve)
        end = self.system.guards(self.p, self.mode, self.held, self.t + remaining, x_inf)
        rounding = 64 * EPS * jnp.max(jnp.abs(x_inf))
        above = (values > 0).all(axis=0) & (end > -rounding)
        below = (values < 0).all(axis=0) & (end < rounding)
        crossing = self.system.pick(self.system.crossing, self.mode)
        passed = ~self.system.pick(self.system.bounds, self.mode)
        inside = (above & ((crossing <= 0) | passed)) | (below & ((crossing >= 0) | passed))
        return (own | inside).all()

    def _holds(self, curve: _Curve, allowed: Any) -> Any:
        """Flights at other points fulfil the equation; forces along the tail are smooth."""
        series = jnp.asarray(_TO_CURVE) @ curve.offsets
        w, lengths = jnp.asarray(PROBES), curve.lengths[DEGREE:]
        here, there = ((chebyshev(p, DEGREE) @ series)[:, 0] for p in (w, curve.ratio * w))
        missing = jnp.abs(lengths - (there - here))
        return (missing <= allowed + CAUTION * ROUNDING * lengths).all() & self._smooth(series)

    def _even(self, series: Any) -> Any:
        """Points on the curve at equal steps of time, the limit left out."""
        grid = jnp.linspace(0.0, 1.0, 4 * SAMPLES)
        since = (chebyshev(grid, DEGREE) @ series)[:, 0]
        times = jnp.linspace(0.0, since[0], SAMPLES + 1)[:-1]
        return jnp.interp(times, since[::-1], grid[::-1])

    def _smooth(self, series: Any) -> Any:
        """Whether forces vary along the tail as a polynomial of its degree does."""

        def force(y: Any) -> Any:
            state = self._onto(y[0], self.x + y[1:], 0.0)
            return self._lies(self.t + y[0], state)[0][2, self.slot]

        w = jnp.concatenate([jnp.asarray(nodes(DEGREE)), self._even(series)])
        push = jax.vmap(force)(chebyshev(w, DEGREE) @ series)
        own = jnp.asarray(_TO_CURVE) @ push[: DEGREE + 1]
        return jnp.max(jnp.abs(push - chebyshev(w, DEGREE) @ own)) <= SMOOTH * jnp.max(
            jnp.abs(push)
        )

    def _end(self, curve: _Curve) -> tuple[Any, Any]:
        """The time that remains to the limit, and the state there."""
        remaining = curve.offsets[0, 0]
        return remaining, self._onto(remaining, self.x + curve.offsets[0, 1:], 0.0)

    def limit(self, curve: _Curve, found: Any, t_error: Any, x_error: Any) -> Tail:
        """The limit point."""
        remaining, x_inf = self._end(curve)
        return Tail(found, remaining, x_inf, t_error, x_error, curve.ratio)


def _next(spectrum: Any) -> Any:
    """What the first coefficients left out would be, from how the last four fall."""
    last = spectrum[-2:].max(axis=0)
    before = jnp.maximum(spectrum[-4:-2].max(axis=0), 1e-300)
    return last * jnp.minimum(last / before, 1.0)


def _differences(r: Any) -> Any:
    """``T_k(2 r w - 1) - T_k(2 w - 1)`` at the points, accurate for ``r`` close to 1."""
    w = nodes(DEGREE)
    a, b, step = 2.0 * r * w - 1.0, 2.0 * w - 1.0, 2.0 * (r - 1.0) * w
    columns, values = [jnp.zeros_like(w), step], [jnp.ones_like(w), b]
    for k in range(1, DEGREE):
        columns.append(2.0 * (a * columns[k] + step * values[k]) - columns[k - 1])
        values.append(2.0 * b * values[k] - values[k - 1])
    return jnp.stack(columns, axis=1)
