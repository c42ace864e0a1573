"""The first variation through an accumulation of impacts.

Let ``F`` take time and state after an impact to those after the next, and ``L`` to those of
their limit: ``L = L o F``. Along the curve ``y(w)`` of impacts (:mod:`hybrid.rules.sums`) the
derivative ``G(w) = DL(y(w))`` satisfies ::

    G(w) = G(r w) DF(y(w)),        G(0) known,

linear equations for its values at a few points of [0, 1], in which ``DF`` is the variation
along one flight and one impact. See ``docs/notes/orbits.md``.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from ..errors import OrbitError
from ..segment import from_values, nodes
from ..zeno.accumulate import Tail
from ..zeno.flight import fly
from .derivatives import Derivatives
from .variation import ROUNDING, cleared, transition

#: Degrees that are tried.
DEGREES = (3, 4, 6, 8, 10, 12, 14, 16)

#: Change from degree to degree, relative, at which a derivative is taken as it is; and at most.
SETTLED, USABLE = 1e-11, 1e-6


def through(derivatives: Derivatives, tail: Tail) -> np.ndarray:
    """From a change of the state after the tail's first impact to one at its limit, equal times.

    Returns
    -------
    array, shape (n, n)
        It has lost two ranks: gap and gap speed are zero at rest.

    Raises
    ------
    OrbitError
        Where the impacts of the tail do not depend smoothly on its start.
    """
    limits = _Limits(derivatives, tail)
    best = before = limits.carried(DEGREES[0])
    least = np.inf
    for degree in DEGREES[1:]:
        found = limits.carried(degree)
        change = float(np.abs(found - before).max() / max(np.abs(found).max(), 1e-300))
        if change < least:
            best, least = found, change
        if least <= SETTLED:
            break
        before = found
    if not least <= USABLE:
        raise OrbitError(
            f"mode {tail.field.name}, t = {tail.t!r}: the derivative of the limit of the impacts "
            f"of {tail.contact.name} is not resolved (it changes by {least:.2g} of its size)"
        )
    return best


class _Limits:
    """``DL`` along the curve of a tail, in time and state on the contact."""

    def __init__(self, derivatives: Derivatives, tail: Tail) -> None:
        self.of, self.tail, self.size = derivatives, tail, derivatives.size
        self.guard = tail.field.guards[tail.column]
        self._maps: dict[float, np.ndarray] = {}

    def carried(self, degree: int) -> np.ndarray:
        """From a change after the first impact to one at the limit, both at equal times."""
        tail, whole = self.tail, self.derivative(degree)
        enters = self.event(tail.t, tail.x, tail.v)
        later = np.outer(self.drift(tail.t + tail.remaining, tail.x_inf), whole[0])
        sizes = (np.abs(whole[1:]) + np.abs(later)) @ np.abs(enters)
        return cleared((whole[1:] - later) @ enters, sizes, ROUNDING)

    def derivative(self, degree: int) -> np.ndarray:
        """``G(1)``, from values at ``degree + 1`` points; shape ``(1 + n, 1 + n)``."""
        points = nodes(degree)
        columns = 1 + self.size
        lower = chebyshev.chebvander(2 * self.tail.r * points - 1, degree) @ from_values(degree)
        system = np.zeros((degree, columns, degree, columns))
        known, start = np.zeros((degree, columns, columns)), self.at_rest()
        for k, w in enumerate(points[1:].tolist()):
            step = self.step(w).T
            system[k, :, k, :] += np.eye(columns)
            system[k] -= lower[k + 1, 1:][None, :, None] * step[:, None, :]
            known[k] = lower[k + 1, 0] * step @ start.T
        found = np.linalg.solve(
            system.reshape(degree * columns, -1), known.reshape(degree * columns, -1)
        )
        return found.reshape(degree, columns, columns)[-1].T

    def step(self, w: float) -> np.ndarray:
        """``DF`` at an impact of the curve, on the contact; shape ``(1 + n, 1 + n)``."""
        if w not in self._maps:
            self._maps[w] = self._step(w)
        return self._maps[w]

    def _step(self, w: float) -> np.ndarray:
        tail, field, of = self.tail, self.tail.field, self.of
        since, x, v = tail.point(w)
        t = tail.t + since
        flight = fly(field, tail.column, t, x.tolist(), v)
        if flight is None:
            raise OrbitError(f"mode {field.name}, t = {t!r}: a flight of the tail cannot be flown")
        end, landed = t + flight.time, np.array(flight.x)
        start, arrives = field.rhs(t, x.tolist()), field.rhs(end, flight.x)
        on = self.onto(t, x)
        still = np.column_stack([-np.array(start), np.eye(self.size)]) @ on
        carried = transition(self._with_gap, t, flight.segments())[:, : self.size] @ still
        moved, gap = carried[:-1], carried[-1] - v * on[0]
        time = -gap / flight.u
        before = np.vstack([time, moved + np.outer(arrives, time)])
        after = of.reset(tail.contact.name, "contact")(end, landed) @ before
        return self.onto(end, landed) @ np.vstack([time, after])

    def _with_gap(self, t: float, x: np.ndarray) -> np.ndarray:
        """Derivatives of the flow, and of the gap's speed: the gap is a coordinate of its own.

        So that its change is not lost in the rounding of the state's, however low the flight.
        """
        flow = self.of.flow(self.tail.field)(t, x)
        speed = self.of.speed(self.guard, self.tail.field)(t, x)
        return np.pad(np.vstack([flow, speed]), ((0, 0), (0, 1)))

    def onto(self, t: float, x: np.ndarray) -> np.ndarray:
        """A change of time and state, less what leads off the gap."""
        gradient = self.of.guard(self.guard, self.tail.field)(t, x)[0]
        normal = np.array([0.0, *gradient[1:]])
        return np.eye(1 + self.size) - np.outer(normal, gradient) / (normal @ normal)

    def at_rest(self) -> np.ndarray:
        """``G(0)``: a speed of ``u`` is gone after ``2 u / (a (1 - r))``."""
        tail = self.tail
        t, x = tail.t + tail.remaining, tail.x_inf
        fall = -self.guard.lie(t, x.tolist())[2]
        speed = self.of.speed(self.guard, tail.field)(t, x)[0]
        lasts = 2.0 / (fall * (1.0 - tail.r))
        push = np.array(tail.contact.push(t, x.tolist()))
        gone = np.array([lasts, *(lasts * self.drift(t, x) - push)])
        return (np.eye(1 + self.size) + np.outer(gone, speed)) @ self.onto(t, x)

    def drift(self, t: float, x: np.ndarray) -> np.ndarray:
        """The flow while the contact is held."""
        fall = -self.guard.lie(t, x.tolist())[2]
        free = np.array(self.tail.field.rhs(t, x.tolist()))
        held: np.ndarray = free + fall * np.array(self.tail.contact.push(t, x.tolist()))
        return held

    def event(self, t: float, x: np.ndarray, v: float) -> np.ndarray:
        """From a change at equal times to one of time and state on the contact."""
        gradient = self.of.guard(self.guard, self.tail.field)(t, x)[0, 1:]
        time = -gradient / v
        start = np.array(self.tail.field.rhs(t, x.tolist()))
        return np.vstack([time, np.eye(self.size) + np.outer(start, time)])
