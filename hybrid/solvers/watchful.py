"""Wraps a method so that each step is verified along all of the flow, and cut where it fails.

A method evaluates a flow at a few points per step, and so does its error estimate. Anything between
them, such as a force pulse lasting a thousandth of the step, is missed. Here the polynomial of each
step is compared with the flow along the whole step, in ball arithmetic
(:mod:`hybrid.bounds.defect`). Where it deviates, the step is repeated up to there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..bounds.defect import Defect, Sampled, defect_of
from ..errors import FlowError
from ..lowering import Field
from ..rules.zeros import EPS
from ..segment import Segment
from .base import Solver, Stepper

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: Most cuts of one step; about fifty isolate a pulse a millionth of the step long.
CUTS = 60

#: Growth of the step limit after a step that had to be cut.
GROWTH = 4.0

#: Least number of parts of half a step over which rounding is integrated, and most where rounding
#: grows towards the end; the last parts are then shorter than the rounding of any time.
PARTS, HALVINGS = 2, 64

#: Relative effect of rounding on a step without brief forces: a few roundings, amplified by the
#: growth of the flow over one step.
ORDINARY = 64 * EPS


class Watchful(Solver):
    """Another solver, whose steps are verified along the flow.

    Parameters
    ----------
    most : int, optional
            Largest total number of steps. If given, exceeding it, or a step that cannot be
        verified, raises a :class:`FlowError`. If omitted, steps continue unverified from there.
    shaken : bool
        Perturb the state after each step by the possible effect of rounding on the forces.
    trusted : bool
        Accept all steps without verifying them.

    Attributes
    ----------
    cut : bool
        Whether a step had to be cut.
    blurred : float
        Accumulated relative perturbation beyond ordinary rounding.
    """

    cuts = True

    def __init__(
        self,
        inner: Solver,
        most: int | None = None,
        shaken: bool = False,
        trusted: bool = False,
    ) -> None:
        self.inner, self.most, self.blind = inner, most, False
        self.trusted, self.cut = trusted, False
        self.shaken, self.blurred = shaken, 0.0
        self.name, self.method, self.order = inner.name, inner.method, inner.order

    def count(self) -> None:
        """Count a step against ``most``."""
        if self.most is not None:
            self.most -= 1
            if self.most < 0:
                self.give_up("too many steps")

    def give_up(self, why: str) -> None:
        """Stop verifying, or raise if ``most`` was given.

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
        x0: StateVector,
        length: float,
        first_step: float | None,
        sizes: StateVector | None = None,
    ) -> Stepper:
        stepper = self.inner.begin(field, t0, x0, length, first_step, sizes)
        defect = defect_of(field)
        if defect is None or not stepper.repeats:
            return stepper
        return WatchfulStepper(self, stepper, defect, field, t0)


class WatchfulStepper(Stepper):
    """The steps of another stepper, cut where they deviate from the flow.

    Attributes
    ----------
    longest : float
        Longest step to try next; reduced when a step had to be cut.
    """

    repeats = True

    def __init__(
        self,
        solver: Watchful,
        inner: Stepper,
        defect: Defect | Sampled,
        field: Field,
        t0: float,
    ) -> None:
        self.solver, self.inner, self.defect = solver, inner, defect
        self.field, self.t0 = field, t0
        self.longest = float("inf")

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
        self.inner.step(min(limit, self.inner.tau + self.longest))
        self.hold()

    def hold(self) -> None:
        """Cut the last step to the part that is verified along the flow."""
        inner = self.inner
        self.solver.count()
        for cut in range(0 if self.solver.blind else CUTS):
            segment = inner.segment()
            share = 1.0 if self.solver.trusted else self._share(segment)
            if share >= 1.0:
                self._blur(segment)
                self.longest = GROWTH * (segment.length if cut else self.longest)
                return
            start = segment.start
            end = start + share * segment.length + 8 * EPS * max(abs(self.t0), segment.end)
            if not start < end < segment.end:
                break
            self.solver.cut = True
            inner.land(end)
        self.solver.give_up("a step cannot be shown to have seen all of the flow")

    def _blur(self, segment: Segment) -> None:
        """Perturb the state, in a shaken run, by what rounding leaves uncertain of the flow.

        The perturbation always has the same sign, as errors of successive steps need not cancel.
        States that decide a change of formula are perturbed only by brief forces, and only in the
        direction of motion; otherwise the state would be moved back before the change.
        """
        solver = self.solver
        if not (solver.shaken and segment.length > 0.0):
            return
        sizes = np.abs(segment.coefficients).sum(axis=0)
        moved = self._left_open(segment, sizes, segment.start, 1.0)
        moved = moved + self._left_open(segment, sizes, segment.end, -1.0)
        shares = moved / np.maximum(sizes, 1e-3 * sizes.max() + 1e-300)
        solver.blurred += float(shares[shares > ORDINARY].sum())
        sides = np.ones_like(sizes)
        asked = list({i for kink in self.field.changes for i in kink.uses})
        way = np.sign(self.inner.x - segment(segment.start))
        sides[asked] = np.where(shares > ORDINARY, way, 0.0)[asked]
        self.inner.x = self.inner.x + sides * moved

    def _left_open(
        self, segment: Segment, sizes: StateVector, end: float, side: float
    ) -> StateVector:
        """The integral of the flow's rounding uncertainty over half a step, from one of its ends.

        The uncertainty is large where a force acts in a narrow zone. It is also large where the
        flow jumps at the end of the step, for the time during which rounding decides on the side.
        Parts are therefore halved towards the end until the rest matters no more than all before.
        """
        field, defect = self.field, self.defect

        def rates(tau: float) -> np.ndarray:
            return defect.left_open(field, self.t0 + tau, segment(tau), EPS * sizes)

        s, last, total = 0.5 * segment.length, rates(end), np.zeros_like(sizes)
        for part in range(HALVINGS):
            if part >= PARTS and np.all(s * last <= total):
                break
            s *= 0.5
            total += s * rates(end + side * s)
        return total + s * last

    def _share(self, segment: Segment) -> float:
        t = self.t0 + segment.start
        solver = self.solver.inner
        lost = solver.atol + solver.rtol * np.abs(segment.coefficients).sum(axis=0)
        return self.defect.share(self.field, t, segment.length, segment.coefficients, lost)

    def segment(self) -> Segment:
        return self.inner.segment()

    def powers(self) -> tuple[float, float, np.ndarray]:
        return self.inner.powers()

    def land(self, tau: float) -> Segment:
        return self.inner.land(tau)

    def arrive(self, tau: float) -> None:
        self.inner.arrive(tau)
