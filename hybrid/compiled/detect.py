"""What the guards say of a step: which fires first, or why the step must be shorter.

A guard is sampled along a step's dense output; where it is no polynomial, in several pieces.
Each piece of each guard is a *row*: a polynomial of its own. The rules are those of
:mod:`hybrid.events` and ``docs/semantics.md``, numbers in brackets its rules.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from numpy.polynomial.chebyshev import chebvander

from ..arrays import when
from ..events import EPS, RESOLVED, SAMPLED, to_bernstein
from ..roots import Zeros, counted, deflated, falling, shallow, to_powers, zeros
from ..segment import apply, from_values, nodes
from ..solvers.diffrax_backend import Method
from ..solvers.series import SHORTEST
from .lane import Lane, Run
from .system import System

#: A guard this many times its last coefficients from zero has no zero in a step.
AWAY = 20.0

#: Share of the step wanted, below which a guard that is still not resolved has a kink.
KINK = 1e-12

#: By how much dividing by the local time may blow up a guard's rounding.
DEFLATED = 200

#: Least degree at which loads are sampled.
LEAST = 6

#: Growth, from step to step, of the bound that lets the guards be seen: without knowledge,
#: and at most.
WIDER, LEAP = 1.3, 4.0

#: Share of the length at which a guard is just resolved that is tried.
SAFETY = 0.9

#: Roundings of a guard at its largest along a step that its polynomial carries: the matrices that
#: make it, of degree 8 or so, make rounding that much larger.
SEEN = 128

#: Pieces of a step in which a guard that is no polynomial is sampled.
PIECES = 8


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
    cap
        Length of a step on which the guards can be seen.
    """

    fires: Any
    slot: Any
    share: Any
    halve: Any
    unsure: Any
    cap: Any


class Rows(NamedTuple):
    """The guards along a step: polynomials of its share, a row for each piece of each guard.

    Attributes
    ----------
    zeros : Zeros
        What is known of each row's; a row is divided by the power of the local time by which the
        guard vanishes at the arc's start, and turned so that it fires falling.
    powers : callable
        Gives the rows' coefficients of powers.
    ends, largest, spread : array, shape (slots,)
        Each guard at the step's end, its largest size, and how far it moves.
    columns : array, shape (degree + 1, rows), or None
        Values at the nodes, of a guard that may have to be seen better.
    """

    zeros: Zeros
    powers: Callable[[], Any]
    ends: Any
    largest: Any
    spread: Any
    columns: Any = None


NOTHING = Event(False, 0, np.inf, False, False, np.inf)


class Detector:
    """Looks for events in the steps of one system and method.

    ``judged``: say where Python has to judge (a guard about to touch); otherwise the compiled
    rules decide, without the finest distinctions.
    """

    def __init__(self, system: System, method: Method, judged: bool) -> None:
        self.system, self.judged = system, judged
        loads = bool(system.rests.any()) and not judged
        self.degree = max(method.degree, LEAST if loads else 1) if system.affine else SAMPLED
        self.pieces = 1 if system.affine else PIECES
        parts = np.arange(self.pieces)[:, None]
        self.shares = ((parts + nodes(self.degree)) / self.pieces).ravel()
        self.starts = np.repeat(parts.ravel() / self.pieces, system.width)
        at_shares = chebvander(2.0 * self.shares - 1.0, method.degree)
        self.spread = at_shares @ from_values(method.degree)

    def curved(self, lane: Lane, free: bool) -> Any:
        """Whether a guard is watched that is no polynomial; None if there can be none."""
        if not self.system.affine:
            return jnp.array(True)
        return None if free or not self.system.rests.any() else lane.held.any()

    def rows(self, run: Run, lane: Lane, held: Any, path: Any, h: Any) -> Rows:
        """The guards along a step."""
        samples = self._samples(run, lane, held, path, h)
        columns = jnp.moveaxis(samples, 1, 0).reshape(self.degree + 1, -1)
        largest, spread = jnp.abs(samples).max(axis=(0, 1)), jnp.ptp(samples, axis=(0, 1))
        b = self._coefficients(lane, columns)
        powers = lambda: apply(to_powers(self.degree), b)  # noqa: E731
        return Rows(counted(b), powers, samples[-1, -1], largest, spread, columns)

    def _samples(self, run: Run, lane: Lane, held: Any, path: Any, h: Any) -> Any:
        """Guards at the nodes of each piece of a step; shape ``(pieces, degree + 1, slots)``."""
        values = stop_gradient(path.values())
        if len(self.shares) != len(values):
            values = apply(self.spread, values)
        times = lane.now + h * jnp.asarray(self.shares)

        def at(t: Any, x: Any) -> Any:
            return self.system.guards(run.parameters, lane.mode, held, t, x)

        samples = stop_gradient(jax.vmap(at)(times, values))
        samples = samples.reshape(self.pieces, self.degree + 1, -1)
        inside = lane.going.tau > 0
        first = jnp.where(inside, stop_gradient(lane.going.ends), samples[0, 0])
        starts = jnp.concatenate([first[None], samples[:-1, -1]])
        return jnp.concatenate([starts[:, None], samples[:, 1:]], axis=1)

    def event(
        self, run: Run, lane: Lane, rows: Rows, end: Any, h: Any, curved: Any, looks: Any
    ) -> Event:
        """The first guard that fires in a step of length ``h`` to the state ``end``.

        ``looks``: whether anybody wants to know.
        """
        tolerance, noise = self.tolerance(run, lane), self._noise(lane, rows, end, h)
        # loads are accelerations: in units of time in which they are small, states measure nothing
        tolerance = jnp.where(lane.held, jnp.minimum(tolerance, run.rtol * rows.largest), tolerance)
        noise = jnp.where(lane.held, jnp.minimum(noise, SEEN * EPS * rows.largest), noise)
        close = jnp.tile(tolerance, self.pieces) if self.judged else 0.0
        near = looks & (rows.zeros.lowest <= close).any()

        def first() -> Event:
            return self._first(run, lane, rows, h, tolerance, noise)

        event = when(near, first, Event(*(jnp.asarray(v) for v in NOTHING)))
        event = event._replace(cap=jnp.where(event.halve, 0.5 * h, WIDER * lane.going.cap))
        if curved is None:
            return event
        coarse, gain = self._resolution(lane, rows.columns, 1e-3 * tolerance + 8 * noise)
        coarse = (coarse & (self.starts <= event.share)).any() & curved & looks
        coarse = coarse & (h > KINK * jnp.minimum(lane.going.h, lane.left(run.t1)))
        fine, wider = ~coarse, jnp.maximum(lane.going.cap, jnp.clip(gain, 1.0, LEAP) * h)
        cap = jnp.where(coarse, jnp.clip(gain, 0.1, 0.9) * h, wider)
        return Event(
            event.fires & fine,
            event.slot,
            event.share,
            event.halve | coarse,
            event.unsure & fine,
            jnp.where(curved & ~event.halve, cap, event.cap),
        )

    # -- one row for each slot of each piece ------------------------------------------------

    def _orders(self, lane: Lane) -> Any:
        """Powers of the local time by which a row vanishes at its start."""
        first = jnp.where(lane.going.tau > 0, 0, lane.orders)
        return jnp.concatenate([first] + [jnp.zeros_like(first)] * (self.pieces - 1))

    def _coefficients(self, lane: Lane, columns: Any) -> Any:
        """Bernstein coefficients of each row, turned so that it fires falling.

        Divided by the power of the local time by which a guard vanishes at the arc's start.
        """
        values = deflated(columns, self._orders(lane))
        b = apply(to_bernstein(self.degree), values)
        b = jnp.concatenate([values[:1], b[1:-1], values[-1:]])
        return b * self._towards(lane, *values[:2])

    def _towards(self, lane: Lane, start: Any, following: Any) -> Any:
        """+1 where a row fires falling, -1 where rising; either way: from where it starts."""
        sign = jnp.tile(-self.system.pick(self.system.crossing, lane.mode), self.pieces)
        if (self.system.crossing != 0).all():
            return sign
        return jnp.where(sign == 0, jnp.sign(jnp.where(start == 0, following, start)), sign)

    def _noise(self, lane: Lane, rows: Rows, end: Any, h: Any) -> Any:
        """What rounding of time and state makes of each guard."""
        way = jnp.abs(end - lane.going.x).max() + rows.spread
        return 8 * EPS * (jnp.abs(lane.now) * way / h + jnp.abs(lane.going.x).max())

    def tolerance(self, run: Run, lane: Lane) -> Any:
        """For each guard, what the tolerances leave open of the states it is made of."""
        uses = self.system.pick(self.system.uses, lane.mode)
        allowed = run.atol + run.rtol * jnp.abs(lane.going.x)
        return jnp.where(uses, allowed, 0.0).max(axis=1)

    def _resolution(self, lane: Lane, columns: Any, noise: Any) -> tuple[Any, Any]:
        """Which rows are not yet polynomials, and the step at which all would be, as a share.

        A guard that stays away from zero by more than it is unresolved need not be one; what
        rounding makes of a guard (``noise``) cannot be. On a long step the guard may be large
        beside what moves it: it is measured against the state, not against itself alone.
        """
        series = jnp.abs(apply(from_values(self.degree), columns))
        size = jnp.minimum(series.max(axis=0), 1.0 + jnp.abs(lane.going.x).max())
        last = series[-3:].max(axis=0)
        allowed = RESOLVED * size + jnp.tile(noise, self.pieces)
        far = (jnp.abs(columns) > AWAY * last).all(axis=0)
        one_side = (columns > 0).all(axis=0) | (columns < 0).all(axis=0)
        matters = ~(far & one_side)
        if self.system.affine:
            matters = matters & lane.held
        ratio = jnp.where(matters & (last > 0), allowed / jnp.where(last > 0, last, 1.0), jnp.inf)
        return ratio < 1.0, SAFETY * jnp.min(ratio) ** (1.0 / (self.degree - 2))

    def _first(self, run: Run, lane: Lane, rows: Rows, h: Any, tolerance: Any, noise: Any) -> Event:
        """The first guard that fires: earliest, then in declared order (1, 4).

        What is unclear in pieces after that does not matter.
        """
        going, slots = lane.going, (self.pieces, -1)
        allowed = jnp.tile(tolerance, self.pieces)
        powers, unclear = rows.powers(), rows.zeros.unclear
        roots = falling(rows.zeros, powers)
        touches = shallow(powers, self._orders(lane), roots, allowed)
        shares = jnp.where(touches, jnp.inf, self.starts + roots / self.pieces)
        quiet = ~(jnp.isfinite(roots) | unclear).reshape(slots).any(axis=0)
        sunk = self._sunk(lane, rows.ends, tolerance) & quiet
        by_slot = jnp.where(sunk, 0.0, shares.reshape(slots).min(axis=0))
        first = jnp.min(by_slot)
        before = self.starts <= first
        tied = by_slot <= first + self._tie(lane, rows, noise, by_slot, h)
        deep = rows.zeros.lowest < -jnp.tile(tolerance + DEFLATED * noise, self.pieces)
        shortest = SHORTEST * (jnp.abs(lane.now) + going.tau) + 1e-12 * (run.t1 - run.t0)
        halve = (unclear & deep & before).any() & (h > shortest)
        unsure = jnp.zeros_like(halve)
        if self.judged:
            away = jnp.tile((going.largest > tolerance) & (going.tau > 0), self.pieces)
            grazes = away & (rows.zeros.nearest <= allowed) & ~jnp.isfinite(roots)
            unsure = (((touches | grazes) & before).any() | sunk.any()) & ~halve
        fires = jnp.isfinite(first) & ~halve & ~unsure
        return Event(fires, jnp.argmax(tied), first, halve, unsure, jnp.asarray(jnp.inf))

    def _sunk(self, lane: Lane, ends: Any, tolerance: Any) -> Any:
        """Which guards are outside at a step's end, and so were zero in it: those of contacts, and
        of edges that bound and were zero where the arc began."""
        pick, mode = self.system.pick, lane.mode
        inside = -pick(self.system.crossing, mode)
        began = (lane.orders > 0) & (lane.going.tau == 0) & pick(self.system.bounds, mode)
        return (
            ~lane.held & (pick(self.system.is_contact, mode) | began) & (inside * ends < -tolerance)
        )

    def _tie(self, lane: Lane, rows: Rows, noise: Any, by_slot: Any, h: Any) -> Any:
        """For each slot the share of the step within which its zero and the first are at one time.

        Four spacings of the event's time, and what rounding makes of both guards, at the rate at
        which they move along the step.
        """
        first = jnp.min(by_slot)
        at = jnp.abs(lane.now + jnp.where(jnp.isfinite(first), first, 0.0) * h)
        size = noise + SEEN * EPS * (rows.spread + rows.largest)
        width = size / jnp.maximum(rows.spread, 1e-300)
        return 4 * EPS * at / jnp.maximum(h, 1e-300) + width + width[jnp.argmin(by_slot)]


class SeriesDetector(Detector):
    """The same for a method whose path carries the guards as polynomials."""

    def __init__(self, system: System, judged: bool) -> None:
        self.system, self.judged = system, judged
        self.pieces, self.starts = 1, np.zeros(system.width)

    def curved(self, lane: Lane, free: bool) -> Any:
        """Never: the step is as long as the guards' own series hold."""
        return None

    def rows(self, run: Run, lane: Lane, held: Any, path: Any, h: Any) -> Rows:
        """The guards along a step."""
        powers = stop_gradient(path.guards)
        before = stop_gradient(lane.going.ends)
        lost = (lane.going.tau > 0) & (before * powers[0] <= 0)  # a sign, where two steps meet
        powers = powers.at[0].set(jnp.where(lost, before, powers[0]))
        halfway = (0.5 ** np.arange(len(powers))[:, None] * powers).sum(axis=0)
        orders = self._orders(lane)
        powers = _shifted(powers, orders)
        ends, sizes = powers.sum(axis=0), jnp.abs(powers)
        spread = sizes[1:].sum(axis=0) + jnp.where(orders > 0, sizes[0], 0.0)
        largest = jnp.maximum(jnp.abs(halfway), jnp.abs(ends))
        powers = powers * self._towards(lane, *powers[:2])
        return Rows(zeros(powers), lambda: powers, ends, largest, spread)


def _shifted(powers: Any, orders: Any) -> Any:
    """Coefficients of polynomials divided by a power (up to the third); those below are zero."""
    count, padded = len(powers), jnp.concatenate([powers, jnp.zeros_like(powers[:3])])
    first, second, third = (padded[k : k + count] for k in (1, 2, 3))
    by_more = jnp.where(orders == 2, second, third)
    return jnp.where(orders == 0, powers, jnp.where(orders == 1, first, by_more))
