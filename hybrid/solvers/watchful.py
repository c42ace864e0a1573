"""Any method, with each step cut until it is shown to have seen all of the flow.

A method looks at a flow at a few points a step, and so does its estimate of the error. What is
between them (a pulse of force of a thousandth of the step) is passed over. Here the polynomial of
each step is held against the flow along all of it, in ball arithmetic (:mod:`hybrid.scene.defect`);
where it fails the step is made again, up to there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import FlowError
from ..scene import Field
from ..scene.defect import EPS, Defect, defect_of
from ..segment import Segment
from .base import Solver, Stepper

#: Times a step is cut: some fifty find a pulse that is a millionth of a step.
CUTS = 60

#: The next step, against one that had to be cut.
GROWTH = 4.0

#: A state that turns on its way moves by rounding in this share of the step.
TURN = float(np.sqrt(EPS))

#: Roundings by which the end of a step that ends where forces jump may be off.
OFF = 32.0


class Watchful(Solver):
    """Another solver, whose steps are held against the flow.

    Parameters
    ----------
    most : int, optional
        Steps in all. With this a step that cannot be shown to have seen all of its flow, and one
        step too many, is a :class:`FlowError`. Without, steps go on unwatched from there.
    shaken : bool
        Move the state after each step by what the rounding of the time, and of where the step ends,
        may have done to it.

    Attributes
    ----------
    blurred : float
        What that is in all, against the states' sizes.
    """

    def __init__(self, inner: Solver, most: int | None = None, shaken: bool = False) -> None:
        self.inner, self.most, self.blind = inner, most, False
        self.shaken, self.blurred = shaken, 0.0
        self.name, self.method, self.order = inner.name, inner.method, inner.order

    def count(self) -> None:
        """One step more."""
        if self.most is not None:
            self.most -= 1
            if self.most < 0:
                self.give_up("too many steps")

    def give_up(self, why: str) -> None:
        """Watch no more, or raise.

        Raises
        ------
        FlowError
        """
        self.blind = True
        if self.most is not None:
            raise FlowError(why)

    def begin(
        self,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        stepper = self.inner.begin(field, t0, x0, length, first_step, sizes)
        defect = defect_of(field)
        if defect is None or not stepper.repeats:
            return stepper
        return WatchfulStepper(self, stepper, defect, field, t0)


class WatchfulStepper(Stepper):
    """The steps of another stepper, cut where they leave the flow."""

    repeats = True

    def __init__(
        self, solver: Watchful, inner: Stepper, defect: Defect, field: Field, t0: float
    ) -> None:
        self.solver, self.inner, self.defect = solver, inner, defect
        self.field, self.t0 = field, t0
        self._longest = float("inf")

    @property
    def tau(self) -> float:  # type: ignore[override]
        """The local time reached."""
        return self.inner.tau

    @tau.setter
    def tau(self, value: float) -> None:
        self.inner.tau = value

    @property
    def x(self) -> Any:  # type: ignore[override]
        """The state there."""
        return self.inner.x

    @x.setter
    def x(self, value: np.ndarray) -> None:
        self.inner.x = value

    def step(self, limit: float) -> None:
        inner, start = self.inner, self.inner.tau
        inner.step(min(limit, start + self._longest))
        self.solver.count()
        for cut in range(0 if self.solver.blind else CUTS):
            segment = inner.segment()
            share = self._share(segment)
            if share >= 1.0:
                self._blur(segment)
                self._longest = GROWTH * (segment.length if cut else self._longest)
                return
            end = start + share * segment.length + 8 * EPS * max(abs(self.t0), segment.end)
            if not start < end < segment.end:
                break
            inner.land(end)
        self.solver.give_up("a step cannot be shown to have seen all of the flow")

    def _blur(self, segment: Segment) -> None:
        """Add up what rounding does to forces.

        Those that depend on the time are known at times a spacing of floats away; where they act
        briefly, or jump at an end of the step, that shows. Always to the same side: what is lost
        in a step need not be won back in the next.
        """
        solver = self.solver
        if solver.most is None:
            return
        t, rhs = self.t0 + segment.end, self.field.rhs
        x, spacing = segment(segment.start + 0.5 * segment.length), 2.0 * float(np.spacing(abs(t)))
        late, early = rhs(t + spacing, x.tolist()), rhs(t - segment.length - spacing, x.tolist())
        moved = spacing * np.abs(np.subtract(late, early)) + self._beyond(segment)
        size = np.maximum(np.abs(x), np.abs(self.inner.x)) + 1e-300
        solver.blurred += float(np.max(moved / size))
        if solver.shaken:
            self.inner.x = self.inner.x + moved

    def _beyond(self, segment: Segment) -> np.ndarray:
        """What comes of it that the place at which a step ends is rounded.

        The flow gets there that much earlier or later: forces that jump there act on the way.
        """
        t, x, rhs = self.t0 + segment.end, self.inner.x, self.field.rhs
        rates = np.array(rhs(t, x.tolist()))
        with np.errstate(divide="ignore", invalid="ignore"):
            late = float(np.nanmax(2 * EPS * np.abs(x) / np.abs(rates), initial=0.0))
        late = min(late, TURN * segment.length)
        way = OFF * (late + float(np.spacing(abs(t)))) * rates
        jump = np.abs(np.subtract(rhs(t, (x + way).tolist()), rhs(t, (x - way).tolist())))
        return late * np.where(np.isfinite(jump), jump, 0.0)  # a flow may end there

    def _share(self, segment: Segment) -> float:
        t = self.t0 + segment.start
        solver = self.solver.inner
        lost = solver.atol + solver.rtol * np.abs(segment.coefficients).sum(axis=0)
        return self.defect.share(self.field, t, segment.length, segment.coefficients, lost)

    def segment(self) -> Segment:
        return self.inner.segment()

    def land(self, tau: float) -> Segment:
        return self.inner.land(tau)
