"""Taylor series of the flow from its tape, one per step (rules in :mod:`hybrid.rules.steps`).

A step is as long as its series meets the tolerance, or is exact to rounding, and is checked against
the flow. It ends at a kink (``abs``, ``where``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FlowError, OptionError
from ..lowering import Field
from ..lowering.lowered import ORDER
from ..rules import unit
from ..rules.kinks import NO_SERIES, NOT_FINITE
from ..rules.steps import NO_STEP
from ..segment import Segment, from_powers, terms
from . import base
from .base import LEADS_BACK, Solver, Stepper

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Why a step is impossible, by status.
REFUSED = {
    NO_SERIES: "the flow is not finite, or has no Taylor series; solver='scipy' needs none",
    NOT_FINITE: base.NO_FLOW_HERE,
    NO_STEP: f"the Taylor series does not converge: the step became zero; {LEADS_BACK}",
}


#: Order of the steps that the loop makes at rounding level (measured, ``docs/notes/loop.md``). The
#: driver makes few steps, of a lower order: in steps of 1e-10 the last coefficients would overflow
#: a double. Where they do, the loop lowers the order too.
HIGHEST = 28

#: Tolerances up to this ask for series that are exact to rounding.
LEAST_TOLERANCE = 1e-14

#: Checking a step against the flow, kinks and guards has a cost of its own. It therefore pays to
#: multiply the order that is optimal for the series alone by this factor (measured,
#: ``docs/notes/loop.md``).
ORDER_FACTOR = 1.65


def order_at(rtol: float) -> int:
    """The cheapest order for a tolerance.

    If only the terms of the series had a cost, the k-th being k times that of the first, it would
    be the order at which the radius of convergence is e^2 steps (Jorba & Zou).
    """
    if rtol <= LEAST_TOLERANCE:
        return HIGHEST
    return min(HIGHEST, math.ceil(ORDER_FACTOR * (1.0 - 0.5 * math.log(rtol))))


class TaylorSolver(Solver):
    """Taylor series of an order that follows from the tolerance; exact to rounding by default."""

    name = method = "taylor"
    whole = cuts = True
    evaluations: int

    #: Each step loses a few roundings, so quantities compared with the tolerances are known to this
    #: accuracy.
    own_rtol = LEAST_TOLERANCE

    def __init__(self, method: str | None, rtol: float, atol: Any) -> None:
        if method not in (None, "taylor"):
            raise OptionError(f"method={method!r}: solver 'taylor' has one method; leave it out")
        self.rejected = self.evaluations = 0
        self.exact = rtol <= self.own_rtol
        self.highest = order_at(rtol)
        self.order = min(self.highest, ORDER)
        if not self.exact:
            self.rtol, self.atol = rtol, atol

    def loss(self, dimension: int) -> Numbers:
        loss = np.zeros(1 + dimension)
        if not self.exact:
            loss[0], loss[1:] = self.rtol, self.atol
        return loss

    def begin(
        self,
        field: Field,
        t0: float,
        x0: StateVector,
        length: float,
        first_step: float | None,
        sizes: StateVector | None = None,
    ) -> Stepper:
        if field.jets is None:
            raise OptionError(f"solver='taylor': {field.refused}")
        return TaylorStepper(self, field, t0, x0, length)


class TaylorStepper(Stepper):
    """Steps along one arc by Taylor series."""

    repeats = True

    def __init__(
        self, solver: TaylorSolver, field: Field, t0: float, x0: StateVector, length: float
    ) -> None:
        assert field.jets is not None
        self.solver, self.rhs = solver, field.rhs
        self.jets, self.held = field.jets, field.project is not None
        self.t0, self.length = t0, length
        self.tau, self.x = 0.0, x0
        self.order, self.loss = solver.order, solver.loss(len(x0))
        self.room = field.jets.room(self.order)

    def step(self, limit: float) -> None:
        programs, start = self.jets.alone, self.tau
        *arrays, sides, _, _ = self.room
        x, end = np.array(self.x, dtype=float), np.empty(len(self.x))
        status, h, crossed = unit("steps").step(
            *(programs, 0, self.held, self.t0 + start, start, x, limit - start, self.loss, sides),
            *(*arrays, end),
        )
        self.solver.evaluations += 1
        if status < 0:
            raise FlowError(REFUSED[status])
        if len(sides):
            unit("kinks").turn(programs, 0, crossed, self.t0 + start, h, self.room.c, sides)
        self.tau = limit if start + h >= limit else start + h
        self._start, self._made = start, self.tau - start
        if self._made != h:  # the time was rounded: move the state to the rounded time
            flow = self.rhs(self.t0 + self.tau, end.tolist())
            end += (self._made - h) * np.array(flow)
        self.x = end

    def land(self, tau: float) -> Segment:
        """The same series, cut at ``tau``."""
        c, aside, work, _, _, sides, _, _ = self.room
        if tau < self.tau:
            sides[:] = 0  # drop the sides beyond a kink at which the step ended
        self._made, t, end = tau - self._start, self.t0 + self._start, np.empty(len(self.x))
        where = self.jets.alone, 0, t, self._made, False
        if not unit("checks").arrives(*where, sides, c, aside, work, end):
            raise FlowError(REFUSED[NOT_FINITE])
        self.tau, self.x = tau, end
        return self.segment()

    def segment(self) -> Segment:
        """The last step's series in Chebyshev form."""
        series = self.room.c[: len(self.x)]
        values = from_powers(self.order) @ terms(series, self._made).T
        return Segment(self._start, self.tau - self._start, values)
