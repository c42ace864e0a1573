"""What the steps of a solver have lost, where arcs are flown in Python: what is near zero may then
be zero (:mod:`hybrid.rules.ties`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..events import fires
from ..lowering import Field, Guard, Scene
from ..rules.lengths import behind
from ..rules.ties import FURTHEST_APART, GATHERINGS, MOST_LOST, hidden_by, late_by
from ..solvers import Stepper
from ..trajectory.plan import Plan
from .entry import expand, turns_within

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: Guards that may hide; the others follow from the model, and fire in no declared order.
MAY_HIDE = ("edge", "contact", "switch")


class Losses:
    """What has been lost so far, in tolerances of the largest states.

    Attributes
    ----------
    exact : bool
        The solver's steps lose no more than rounding.
    tolerances : float
        The sum of what they have lost.
    seen : array
        The largest states that the run has seen.
    """

    def __init__(self, plan: Plan, exact: bool, seen: StateVector) -> None:
        self.plan, self.exact, self.seen = plan, exact, seen
        self.tolerances = 0.0

    @property
    def share(self) -> float:
        """What the tolerances allow, as a share of the largest of the states seen."""
        size = float(np.max(self.seen, initial=0.0))
        return self.plan.rtol + (self.plan.limit / size if size else 0.0)

    def allowed(self, x: StateVector) -> StateVector:
        """What the tolerances allow of a state, by the largest seen."""
        return self.plan.limit + self.plan.rtol * np.maximum(self.seen, np.abs(x))  # type: ignore[no-any-return]

    def note(self, field: Field, t: float, start: float, x: StateVector, stepper: Stepper) -> None:
        """Add what a step has lost that began at a local time, in a state: how far its end is from
        that of series of the flow; where there are none that have converged, a tolerance."""
        series, length, end = expand(field, t + start, x), stepper.tau - start, stepper.x
        allowed, lost = self.plan.atol + self.plan.rtol * np.maximum(self.seen, np.abs(end)), 1.0
        if series is not None:
            c = np.array(series[0])
            left = np.array([behind(row, length) for row in c])
            off = np.abs(c @ length ** np.arange(c.shape[1]) - end)
            if np.all(left <= allowed) and np.isfinite(off).all():
                lost = float(np.max(off / np.where(allowed > 0.0, allowed, np.inf)))
        self.tolerances = min(self.tolerances + lost, MOST_LOST)

    def hide(
        self, scene: Scene, field: Field, guard: Guard, t: float, x: StateVector, way: float
    ) -> float:
        """How far from zero a guard may be that steps show there, a time after the arc began;
        below zero where there is nothing to be hidden."""
        if not self.tolerances or guard.kind not in MAY_HIDE:
            return -1.0
        _, rate, _ = guard.lie(t, x.tolist())
        sizes, uses = scene.rounding(guard, field), list(guard.uses)
        moved = np.abs(field.flow(t, x)) * way
        size = np.max(np.maximum(np.maximum(self.seen, np.abs(x)), moved)[uses], initial=0.0)
        here, far = sizes(t, x.tolist())[0], sizes(t, self.seen.tolist())[0]
        own = max(here, far) if np.isfinite(far) else here
        if size == 0.0 or not np.isfinite(own):
            return -1.0
        share = self.plan.rtol + self.plan.limit / size
        return hidden_by(self.tolerances, float(share), float(own), rate, way)

    def late(self, error: float, t: float, remaining: float, way: float) -> float:
        """By how much the limit of a sum, so much later, may come too late: at a time it is off by
        an ``error``, and a ``way`` has led there (:func:`hybrid.rules.ties.late_by`)."""
        late = late_by(self.tolerances, self.share, error, t, way)
        return min(late, FURTHEST_APART * remaining)

    def near(
        self, scene: Scene, field: Field, t: float, x: StateVector, way: float
    ) -> dict[int, int]:
        """Guards that are about to fire, or just have, and of which what the steps have lost may
        hide that they do so there, with their directions (:func:`hybrid.rules.ties.near`)."""
        found = {}
        for index, guard in enumerate(field.guards if self.tolerances and way > 0.0 else ()):
            value, rate, bend = guard.lie(t, x.tolist())
            hides = self.hide(scene, field, guard, t, x, way)
            touches = guard.kind != "contact" and turns_within(rate, bend, hides)
            if abs(value) <= hides and fires(guard.crossing, int(np.sign(rate))) and not touches:
                found[index] = int(np.sign(rate))
        return found

    def beyond(
        self, field: Field, near: dict[int, int], t: float, x: StateVector, moves: float = 1.0
    ) -> tuple[float, StateVector]:
        """Where all of these guards are zero, or beyond it, and how much later that is.

        ``moves``: 1 if the time goes on with the state, 0 if it stays, as it is given.
        """
        later = 0.0
        for _ in range(GATHERINGS):
            there = [field.guards[index].lie(t + moves * later, x.tolist()) for index in near]
            step = max((-value / rate for value, rate, _ in there if value * rate < 0), default=0.0)
            if step <= np.spacing(abs(t)):
                break
            x = x + step * field.flow(t + moves * later, x)
            later += step
        return later, x
