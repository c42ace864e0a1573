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
from .arcs import along, whole
from .derivatives import Derivatives, Directed

#: Degrees that are tried.
DEGREES = (3, 4, 6, 8, 10, 12, 14, 16)

#: Change from degree to degree, relative, at which a derivative is taken as it is; and at most.
SETTLED, USABLE = 1e-11, 1e-6

#: What is left of a difference, relative, that is rounding.
ROUNDING = 1e-14


def cleared(matrix: np.ndarray, sizes: np.ndarray, relative: float) -> np.ndarray:
    """A matrix with 0 for what is rounding of the terms it is made of: a lost rank stays lost."""
    return np.where(np.abs(matrix) <= relative * sizes, 0.0, matrix)


def through(
    derivatives: Derivatives | Directed, tail: Tail
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From a change of the state after the tail's first impact to one at its limit, equal times.

    Returns
    -------
    matrix : array, shape (n, n + q)
        It has lost two ranks: gap and gap speed are zero at rest. The last ``q`` columns are those
        of the parameters.
    time, state : array, shapes (n + q,) and (n, n + q)
        Of the time of the limit, and of the state there.

    Raises
    ------
    OrbitError
        Where the impacts of the tail do not depend smoothly on its start.
    """
    limits = _Limits(derivatives, tail)
    best = before = limits.derivative(DEGREES[0])
    least = np.inf
    for degree in DEGREES[1:]:
        found = limits.derivative(degree)
        change = _change(found, before, 1 + derivatives.size)
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
    return limits.carried(best)


def _change(found: np.ndarray, before: np.ndarray, own: int) -> float:
    """What has changed: against the largest in time and state, for a parameter against its own."""
    sizes = np.abs(found).max(axis=0)
    sizes[:own] = sizes[:own].max()
    return float(np.max(np.abs(found - before).max(axis=0) / np.maximum(sizes, 1e-300)))


class _Limits:
    """``DL`` along the curve of a tail, in time and state on the contact, and parameters.

    A change of all of them, a column, is mapped by ``DF`` to another, whose parameters are the
    same.
    """

    def __init__(self, derivatives: Derivatives | Directed, tail: Tail) -> None:
        self.of, self.tail, self.size = derivatives, tail, derivatives.size
        self.columns = derivatives.columns
        self.guard = tail.field.guards[tail.column]
        self._maps: dict[float, np.ndarray] = {}

    def carried(self, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """From a change after the first impact to one at the limit; both at equal times, and when
        and where the limit is."""
        tail = self.tail
        enters = self.event(tail.t, tail.x, tail.v)
        time, state = limit[0] @ enters, limit[1:] @ enters
        later = np.outer(self.drift(tail.t + tail.remaining, tail.x_inf), limit[0])
        sizes = (np.abs(limit[1:]) + np.abs(later)) @ np.abs(enters)
        return cleared((limit[1:] - later) @ enters, sizes, ROUNDING), time, state

    def derivative(self, degree: int) -> np.ndarray:
        """``G(1)``, from values at ``degree + 1`` points; shape ``(1 + n, columns)``."""
        points, rows = nodes(degree), 1 + self.size
        columns = self.columns
        lower = chebyshev.chebvander(2 * self.tail.r * points - 1, degree) @ from_values(degree)
        system = np.zeros((degree, columns, degree, columns))
        known, start = np.zeros((degree, columns, rows)), self.at_rest()
        for k, w in enumerate(points[1:].tolist()):
            step = self.step(w).T
            system[k, :, k, :] += np.eye(columns)
            system[k] -= lower[k + 1, 1:][None, :, None] * step[:, None, :]
            known[k] = lower[k + 1, 0] * step @ start.T
        found = np.linalg.solve(
            system.reshape(degree * columns, -1), known.reshape(degree * columns, -1)
        )
        return found.reshape(degree, columns, rows)[-1].T

    def step(self, w: float) -> np.ndarray:
        """``DF`` at an impact of the curve, on the contact; shape ``(columns, columns)``."""
        if w not in self._maps:
            self._maps[w] = self._step(w)
        return self._maps[w]

    def _step(self, w: float) -> np.ndarray:
        tail, field, of, n = self.tail, self.tail.field, self.of, self.size
        since, x, v = tail.point(w)
        t = tail.t + since
        flight = fly(field, tail.column, t, x.tolist(), v)
        if flight is None:
            raise OrbitError(f"mode {field.name}, t = {t!r}: a flight of the tail cannot be flown")
        end, landed = t + flight.time, np.array(flight.x)
        start, arrives = np.array(field.rhs(t, x.tolist())), field.rhs(end, flight.x)
        on = self.onto(t, x)
        still = on[1:].copy()
        still[:n] -= np.outer(start, on[0])
        # the gap is a coordinate of its own: its change must not be lost in the rounding of the
        # state's, however low the flight
        carried = whole(along(of, field, t, flight.segments(), self.guard))
        changed = carried[:, :n] @ still[:n] + carried[:, n + 1 :] @ still[n:]
        moved, gap = changed[:-1], changed[-1] - v * on[0]
        time = -gap / flight.u
        before = np.vstack([time, moved + np.outer(arrives, time), on[1 + n :]])
        after = of.reset(tail.contact.name, "contact")(end, landed) @ before
        if field.project is not None:
            after = of.project(field)(end, landed) @ np.vstack([time, after, on[1 + n :]])
        return self.onto(end, landed) @ np.vstack([time, after, on[1 + n :]])

    def onto(self, t: float, x: np.ndarray) -> np.ndarray:
        """A change of time, state and parameters, less what leads off the gap."""
        gradient = self.of.guard(self.guard, self.tail.field)(t, x)[0]
        normal = np.zeros(self.columns)
        normal[1 : 1 + self.size] = gradient[1 : 1 + self.size]
        return np.eye(self.columns) - np.outer(normal, gradient) / (normal @ normal)

    def at_rest(self) -> np.ndarray:
        """``G(0)``: a speed of ``u`` is gone after ``2 u / (a (1 - r))``."""
        tail = self.tail
        t, x = tail.t + tail.remaining, tail.x_inf
        fall = -self.guard.lie(t, x.tolist())[2]
        speed = self.of.speed(self.guard, tail.field)(t, x)[0]
        lasts = 2.0 / (fall * (1.0 - tail.r))
        push = np.array(tail.contact.push(t, x.tolist()))
        gone = np.array([lasts, *(lasts * self.drift(t, x) - push)])
        same = np.eye(1 + self.size, self.columns)
        return (same + np.outer(gone, speed)) @ self.onto(t, x)

    def drift(self, t: float, x: np.ndarray) -> np.ndarray:
        """The flow while the contact is held."""
        tail, scene = self.tail, self.of.scene
        if tail.contact.rests:
            held = scene.name(tail.field.mode, (*tail.field.held, tail.contact.name))
            return np.array(scene.field(held).rhs(t, x.tolist()))
        fall = -self.guard.lie(t, x.tolist())[2]
        free = np.array(self.tail.field.rhs(t, x.tolist()))
        along_contact: np.ndarray = free + fall * np.array(self.tail.contact.push(t, x.tolist()))
        return along_contact

    def event(self, t: float, x: np.ndarray, v: float) -> np.ndarray:
        """From a change at equal times to one of time, state and parameters on the contact."""
        gradient = self.of.guard(self.guard, self.tail.field)(t, x)[0, 1:]
        time = -gradient / v
        start = np.array(self.tail.field.rhs(t, x.tolist()))
        changes = np.eye(self.columns - 1)
        changes[: self.size] += np.outer(start, time)
        return np.vstack([time, changes])
