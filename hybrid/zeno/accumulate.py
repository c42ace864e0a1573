"""The sum of infinitely many impacts: the chatter map, closed.

Let ``F`` take the state after an impact (with gap speed ``v``) to the state after the next.
Near a point of rest the impacts that tend to it lie on a curve ``y(w)``, on which the map
is multiplication: ``F(y(w)) = y(r w)`` with ``r`` the restitution at rest, ``y(0)`` the
point of rest, and the impacts at hand ``y(1), y(r), y(r^2), ...``. The curve is analytic
where flow, gap and restitution are. With ``D(w) = F(y(w)) - y(w)`` for time and state, and
``E(w) = log(v'/(r v))`` for the gap speed, the curve solves two linear equations::

    y(r w) - y(w) = D(w),    log v = log w + l(w),    l(r w) - l(w) = E(w).

The curve is held by its values at a few points of ``[0, 1]``. ``D`` and ``E`` there are
computed by one Taylor flight each; the equations are solved, which moves the curve; and so
on by turns, each of which gains an order and takes one point more. Where moving the curve
changes nothing (a fixed wall, forces that depend on nothing but the gap and the speed
squared), the points are doubled instead and the old ones kept. What the last turn changed
bounds what is left. This is the map of Nordmark & Piiroinen (Nonlinear Dynamics 58,
2009) to any order; see ``docs/notes/chatter.md``.
"""

from __future__ import annotations

from functools import cached_property
from math import exp, log
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..scene.defect import follows
from ..scene.taylor import polynomial
from ..segment import from_values, nodes
from .flight import Flight, fly

if TYPE_CHECKING:
    from ..scene import Contact, Field
    from .enclose import Proof

#: Most points on the curve.
DEGREE = 16

#: Rounding floor of an accumulation, relative.
FLOOR = 4e-15

#: Logarithms of the speed's ratio below which the forces are taken to be even in the speed.
IDLE = 1e-13

#: Points off the nodes at which a curve is put to the test.
PROBES = (0.3, 0.1, 0.03, 0.01, 1e-3)

#: Times along a tail at which the forces are looked at, and how smooth they must be.
SAMPLES, SMOOTH = 64, 1e-5

#: What is left after a turn, against what the turn changed: it shrinks, but not evenly.
CAUTION = 8.0

#: Impacts of a tail from which a proof is tried, and shares of all that are listed.
STAGES, SHARES_LISTED = (0, 3, 10, 30, 60, 100, 160, 250, 400, 1000, 4000), (0.25, 0.5, 0.75)

#: Most impacts that are flown to find one from which a proof succeeds: half a second of them.
FLOWN = 400

#: Rounding of one flight, relative, as seen in the change from turn to turn.
ROUNDING = 3e-15


@attrs.frozen(eq=False)
class Tail:
    """Infinitely many impacts from one on, ``y(1)``, to their limit.

    Attributes
    ----------
    t, low : float
        Time of the impact ``y(1)``, in two floats.
    x : array
        State after it.
    v : float
        Gap speed after it.
    r : float
        Restitution at rest: the ratio of the series.
    curve : array, shape (degree + 1, 2 + n)
        Chebyshev coefficients in ``2 w - 1`` of time and state, relative to ``y(1)``, and
        of ``l``.
    remaining : float
        Time from ``y(1)`` to the accumulation point.
    x_inf : array
        State there.
    t_error : float
    x_error : array
        Bounds on the error of the closing (not of what came before it).
    """

    field: Field
    contact: Contact
    column: int
    t: float
    low: float
    x: np.ndarray
    v: float
    r: float
    curve: np.ndarray
    remaining: float
    x_inf: np.ndarray
    t_error: float
    x_error: np.ndarray

    def point(self, w: float) -> tuple[float, np.ndarray, float]:
        """Time since ``y(1)``, state and gap speed after the impact ``y(w)``."""
        offset = chebyshev.chebval(2.0 * w - 1.0, self.curve)
        since, x, v = float(offset[0]), self.x + offset[1:-1], self.v * w * exp(float(offset[-1]))
        moved = on_contact(self.field, self.contact, self.column, self.t + since, x.tolist(), v)
        return since, np.array(moved), v

    @cached_property
    def count(self) -> int:
        """Impacts after ``y(1)`` that a double can still tell from the limit."""
        resolution = max(np.spacing(abs(self.t + self.remaining)), 1e-300)
        share = min(max(resolution / self.remaining, 1e-300), 1.0)
        return max(0, int(np.ceil(log(share) / log(self.r))))

    @cached_property
    def times(self) -> np.ndarray:
        """Times from ``y(1)`` to each impact listed, the first being 0."""
        w = self.r ** np.arange(self.count + 1)
        times = chebyshev.chebval(2.0 * w - 1.0, self.curve[:, 0])
        times[0] = 0.0
        return np.maximum.accumulate(times)

    def before(self, n: int) -> np.ndarray:
        """State before the impact ``y(r^n)``, from the one after it."""
        since, x, v = self.point(self.r**n)
        t, after, speed = self.t + since, x.tolist(), -v / self.r
        for _ in range(3):  # the restitution may depend on the speed before the impact
            speed = -v / self.contact.law(t, after, speed)
        return x - (v - speed) * np.array(self.contact.push(t, after))

    def state(self, since: float) -> list[float]:
        """State at a time after ``y(1)``."""
        n = max(int(np.searchsorted(self.times, since, side="right")) - 1, 0)
        flight = self.flight(n)
        if flight is None:
            return self.x_inf.tolist()
        s = min(max(since - float(self.times[n]), 0.0), flight.time)
        start, _, series = next(p for p in reversed(flight.pieces) if p[0] <= s)
        return [polynomial(c, s - start) for c in series.tolist()]

    def prove(self) -> list[Proof]:
        """Proofs in order of time: the first from an impact that was flown, narrower ones later.

        The tail's first impact was flown by the run. Where no box around it can be enclosed, the
        flights that follow are flown here one after the other, each held against the flow all
        along it, until one can. Without a proof from one of these there is none: what follows
        is known from the curve, which a proof must not rest on. Once the accumulation is proved,
        later impacts, from the curve, narrow the bounds down.
        """
        first, stage = self._flown_proof()
        if first is None:
            return []
        late = (int(share * self.count) for share in SHARES_LISTED)
        stages = sorted({*(n for n in STAGES if n <= self.count), *late})
        points = [self.point(self.r**n) for n in stages if n > stage]
        found = [self._prove(self.t + since, x, v) for since, x, v in points if v > 0]
        within = [p for p in found if p is not None and first.low <= p.low <= p.high <= first.high]
        return [first, *within]

    def _flown_proof(self) -> tuple[Proof | None, int]:
        """The proof from the earliest impact flown from which there is one, and which."""
        t, x, v = self.t, self.x.tolist(), self.v
        for n in range(FLOWN + 1):
            if n in STAGES:
                proof = self._prove(t, np.array(x), v)
                if proof is not None:
                    return proof, n
            flight = fly(self.field, self.column, t, x, v)
            if flight is None or not follows(self.field, t, flight.segments()):
                break
            t += flight.time
            v, moved = _impact(self.contact, t, flight)
            if not v > 0:
                break
            x = on_contact(self.field, self.contact, self.column, t, moved.tolist(), v)
        return None, 0

    def _prove(self, t: float, x: np.ndarray, v: float) -> Proof | None:
        from .enclose import prove

        return prove(self.field, self.contact.name, t, x, v)

    def flight(self, n: int) -> Flight | None:
        """The flight after impact ``n`` of the tail, from the curve."""
        since, x, v = self.point(self.r**n)
        return fly(self.field, self.column, self.t + since, x.tolist(), v)


def close(
    field: Field,
    contact: Contact,
    column: int,
    t: float,
    low: float,
    x: np.ndarray,
    v: float,
    rtol: float,
    atol: float,
) -> Tail | None:
    """Sum the impacts that follow an impact with speed ``v``; None where it cannot yet be done.

    None means that the series does not converge well enough from here: the impacts are too
    strong, or do not accumulate at all. The tolerances are of the result.
    """
    guess = _Curve(field, contact, column, t, x, v)
    share = max(1e-3 * rtol, FLOOR)
    degree, before = 1, None
    history: list[float] = []
    while degree <= DEGREE:
        if not guess.improve(degree):
            return None
        if before is not None:
            change, rounding = np.abs(guess.limit - before), guess.rounding()
            allowed = share * guess.scale() + rounding + 1e-3 * atol * (np.arange(1 + len(x)) > 0)
            worst = float(np.max(change / np.maximum(allowed, 1e-300)))
            if guess.steady and history:
                left = min(1.0, worst / history[-1])  # doubling squares what is left, or better
                change, worst = left * change, left * worst
            if worst <= 1.0:
                error = CAUTION * change + FLOOR * guess.scale() + rounding
                return guess.tail(low, error) if guess.holds(allowed[0]) else None
            history.append(worst)
            if not guess.steady and not _hopeful(history, DEGREE - degree):
                return None
        before = guess.limit
        degree = 2 * degree if guess.steady else degree + 1
    return None


def _hopeful(history: list[float], left: int) -> bool:
    """Whether the changes shrink fast enough (over two turns: odd orders may vanish)."""
    if len(history) < 3 or not history[-3] > 0:
        return True
    rate = (history[-1] / history[-3]) ** 0.5
    return history[-1] * rate**left < 1.0


class _Curve:
    """The curve ``y(w)`` while it is improved."""

    def __init__(
        self, field: Field, contact: Contact, column: int, t: float, x: np.ndarray, v: float
    ) -> None:
        self.field, self.contact, self.column = field, contact, column
        self.t, self.x, self.v = t, x, v
        self.curve = np.zeros((1, 2 + len(x)))
        self.limit = np.zeros(1 + len(x))
        self.steady = contact.local and not field.held
        self._known: dict[float, list[float]] = {}
        self._branch: tuple[int, ...] | None = None
        self.r = contact.law(t, x.tolist(), -0.0)

    def improve(self, degree: int) -> bool:
        """One turn with that many points; False where a flight is not to be had."""
        if not 0.0 < self.r < 1.0 - 1e-12:
            return False
        steps = []
        for w in nodes(degree)[:0:-1].tolist():
            step = self._look_up(w, degree)
            if step is None:
                return False
            steps.append(step)
        equations = (shift(self.r, degree) @ from_values(degree))[1:, :-1]
        values = np.linalg.solve(equations, np.array(steps[::-1]))
        values = np.concatenate([values, np.zeros((1, values.shape[1]))])
        if not np.all(np.isfinite(values)) or not values[0, 0] > 0:
            return False
        self.curve, self.limit = from_values(degree) @ values, values[0, :-1]
        t_inf, x_inf = self.t + self.limit[0], (self.x + self.limit[1:]).tolist()
        self.r = self.contact.law(t_inf, x_inf, -0.0)
        return self.field.guards[self.column].lie(t_inf, x_inf)[2] < 0

    def _look_up(self, w: float, degree: int) -> list[float] | None:
        """``D`` and ``E`` at a point; known ones are kept while the curve's place is idle."""
        key = round(w, 12)
        if key in self._known and (self.steady or w == 1.0):
            return self._known[key]
        step = self._step(w)
        if step is not None:
            self._known[key] = step
            self.steady = self.steady and abs(step[-1]) <= IDLE
        return step

    def holds(self, allowed: float) -> bool:
        """Whether the curve is one between its points too, and far down towards its limit.

        Flights at other points must be on the same branch and fulfil the equation; and the
        gap's acceleration at rest must be smooth along the curve, in steps of time.
        """
        for w in PROBES:
            step = self._step(w)
            if step is None:
                return False
            here, there = chebyshev.chebval(2.0 * np.array([w, self.r * w]) - 1.0, self.curve[:, 0])
            if abs(step[0] - (there - here)) > allowed + CAUTION * ROUNDING * step[0]:
                return False
        return self.steady or self._smooth()

    def _smooth(self) -> bool:
        """Whether forces vary along the tail as a polynomial of its degree does."""
        grid = np.linspace(0.0, 1.0, 4 * SAMPLES)
        offsets = chebyshev.chebval(2.0 * grid - 1.0, self.curve[:, 0])
        since = np.linspace(0.0, self.limit[0], SAMPLES)
        w = np.interp(since, offsets[::-1], grid[::-1])
        states = self.x + chebyshev.chebval(2.0 * w - 1.0, self.curve[:, 1:-1]).T
        times = self.t + chebyshev.chebval(2.0 * w - 1.0, self.curve[:, 0])
        guard = self.field.guards[self.column]
        pairs = zip(times.tolist(), states.tolist(), strict=True)
        push = np.array([guard.lie(t, self._on_contact(t, x, 0.0))[2] for t, x in pairs])
        basis = chebyshev.chebvander(2.0 * w - 1.0, min(len(self.curve) + 2, DEGREE))
        fitted = basis @ np.linalg.lstsq(basis, push, rcond=None)[0]
        return bool(np.max(np.abs(push - fitted)) <= SMOOTH * np.max(np.abs(push)))

    def _step(self, w: float) -> list[float] | None:
        """``D`` and ``E`` at one point of the curve, by one flight and impact."""
        offset = np.asarray(chebyshev.chebval(2.0 * w - 1.0, self.curve))
        v = self.v * w * exp(float(offset[-1]))
        t = self.t + float(offset[0])
        x = self._on_contact(t, (self.x + offset[1:-1]).tolist(), v)
        flight = fly(self.field, self.column, t, x, v)
        if flight is None or flight.branch != (self._branch or flight.branch):
            return None
        self._branch = flight.branch
        after, moved = _impact(self.contact, t + flight.time, flight)
        if not after > 0:
            return None
        return [flight.time, *(moved - np.array(x)), log(after / (self.r * v))]

    def _on_contact(self, t: float, x: list[float], v: float) -> list[float]:
        return on_contact(self.field, self.contact, self.column, t, x, v)

    def scale(self) -> np.ndarray:
        """Size of time and of each element of the state, over the tail."""
        return np.abs(self.limit) + np.abs(np.array([self.t, *self.x]))

    def rounding(self) -> np.ndarray:
        """Rounding of one flight, added up over the ``1 / (1 - r)`` flights that count."""
        size = self.scale()
        size[0] = self.limit[0]
        return ROUNDING / (1.0 - self.r) * size

    def tail(self, low: float, error: np.ndarray) -> Tail:
        return Tail(
            self.field,
            self.contact,
            self.column,
            self.t,
            low,
            self.x,
            self.v,
            self.r,
            self.curve,
            float(self.limit[0]),
            np.array(
                self._on_contact(self.t + self.limit[0], (self.x + self.limit[1:]).tolist(), 0.0)
            ),
            float(error[0]),
            error[1:],
        )


def _impact(contact: Contact, t: float, flight: Flight) -> tuple[float, np.ndarray]:
    """Gap speed and state after the impact that ends a flight."""
    after = contact.law(t, flight.x, flight.u) * -flight.u
    landed = contact.land(t, flight.x)
    push = np.array(contact.push(t, landed))
    return after, np.array(landed) + push * (after - flight.u)


def on_contact(
    field: Field, contact: Contact, column: int, t: float, x: list[float], v: float
) -> list[float]:
    """A state moved to gap 0 and gap speed ``v``."""
    x = contact.land(t, x)
    missing = v - field.guards[column].lie(t, x)[1]
    return [p + missing * q for p, q in zip(x, contact.push(t, x), strict=True)]


def shift(r: Any, degree: int, xp: Any = np) -> Any:
    """``T_k(2 r w - 1) - T_k(2 w - 1)`` at the nodes, accurate for ``r`` close to 1.

    ``xp`` is the array namespace.
    """
    w = nodes(degree)
    a, b, step = 2.0 * r * w - 1.0, 2.0 * w - 1.0, 2.0 * (r - 1.0) * w
    columns, values = [xp.zeros_like(w), step], [xp.ones_like(w), b]
    for k in range(1, degree):
        columns.append(2.0 * (a * columns[k] + step * values[k]) - columns[k - 1])
        values.append(2.0 * b * values[k] - values[k - 1])
    return xp.stack(columns[: degree + 1], axis=1)
