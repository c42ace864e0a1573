"""Detects arcs whose steps never reach the end: ever shorter, or back and forth over a
discontinuity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import FlowError
from ..lowering import Field, Kink
from ..rules.pairs import COUNTED, FEW_STEPS, ROWS, STEPS_LEFT, SWING_SHARE
from ..solvers.base import LEADS_BACK
from .losses import Losses
from .standstill import standstill

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector


#: What is said where a run does not go on at the standstill.
STANDS = "the flow comes to a standstill there"

#: Twice as many steps as before that cover more than so many times the way grow longer.
GROWS = 4.0


class Pace:
    """Watches the steps of an arc.

    Five kinds are detected. Steps beside a state at which the flow comes to a standstill. Steps
    that become ever shorter, as under a force ``sin(1/x)`` near 0: the time covered by steps 512 to
    1023, 1024 to 2047, and so on grows if steps are of one length, and stays the same if the n-th
    is as short as 1/n; if it falls like a geometric series, the sum of all steps is finite. Steps
    no longer than the spacing of floats at their time. Steps that have shrunk and stay so short
    that the end is 1e12 of them away, as where a flow jumps ever sooner until tolerances hide it.
    And steps that go back and forth over a discontinuity to which the flow leads from both sides:
    there they stay as short as the tolerances allow.
    """

    def __init__(self, field: Field, t0: float, length: float, losses: Losses) -> None:
        self.field, self.t0, self.length, self.losses = field, t0, length, losses
        self.count, self.due, self.falls = 0, COUNTED, 0
        self.begun, self.gone, self.end = (0, 0.0), 0.0, 0.0

    def steps(self, end: float, x: StateVector, count: int = 1) -> None:
        """Count steps; the last has ended at a local time in a state.

        Raises
        ------
        FlowError
            If the steps will not reach the end of the arc.
        """
        last, self.end, self.count = (end - self.end) / count, end, self.count + count
        if self.count < self.due:
            return
        made, gone = self.count - self.begun[0], end - self.begun[1]
        self.falls = self.falls + 1 if self.due > COUNTED and gone < SWING_SHARE * self.gone else 0
        grows = self.due == COUNTED or gone > GROWS * self.gone
        self.begun, self.gone, self.due = (self.count, end), gone, 2 * self.count
        left, mean = self.length - end, gone / made
        many = left > STEPS_LEFT * mean > 0.0
        if many and self._stands(end, x):
            raise FlowError(f"after {self.count} steps the last are of {mean:.3g}: {STANDS}")
        if many and any(self._leads_back(k, end, x, mean) for k in self._jumps()):
            raise FlowError(f"after {self.count} steps the last are of {mean:.3g}: {LEADS_BACK}")
        # the time itself tells no shorter ones apart
        stuck = mean <= FEW_STEPS * np.spacing(abs(end)) or (
            left > STEPS_LEFT**2 * mean and not grows
        )
        if (stuck or self.falls >= ROWS) and left > STEPS_LEFT * last:
            raise FlowError(
                f"the steps become ever shorter: {self.count} in this arc, the last of "
                f"{last:.3g} with {left:.3g} to go; the flow swings faster and "
                "faster towards a time, or a state, that it cannot pass"
            )

    def _stands(self, tau: float, x: StateVector) -> bool:
        return standstill(self.field, self.t0 + tau, x, self.losses.allowed(x)) is not None

    def _jumps(self) -> list[Kink]:
        return [kink for kink in self.field.changes if kink.change == "jumps"]

    def _leads_back(self, kink: Kink, tau: float, x: StateVector, h: float) -> bool:
        """Whether a state is next to a discontinuity to which the flow leads from both sides."""
        t, flow = self.t0 + tau, self.field.flow(self.t0 + tau, x)
        value, rate = self._moves(kink, t, x, flow, h)
        if not abs(value) <= FEW_STEPS * h * abs(rate):
            return False
        zero = -value / rate if rate else 0.0
        beside = [(t + zero + s, x + (zero + s) * flow) for s in (-h, h)]
        sides = [np.sign(self._moves(kink, *there, self.field.flow(*there), h)) for there in beside]
        return all(side == -way != 0.0 for side, way in sides) and sides[0][0] != sides[1][0]

    def _moves(
        self, kink: Kink, t: float, x: StateVector, flow: np.ndarray, h: float
    ) -> tuple[float, float]:
        """A deciding function, and its rate along a flow."""
        value, ahead = kink.value(t, x.tolist()), kink.value(t + h, (x + h * flow).tolist())
        return value, (ahead - value) / h
