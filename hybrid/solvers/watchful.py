"""Any method, with each step cut until it is shown to have seen all of the flow.

A method looks at a flow at a few points a step, and so does its estimate of the error. What is
between them (a pulse of force of a thousandth of the step) is passed over. Here the polynomial of
each step is held against the flow along all of it, in ball arithmetic
(:mod:`hybrid.bounds.defect`); where it fails the step is made again, up to there.
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

#: Times a step is cut: some fifty find a pulse that is a millionth of a step.
CUTS = 60

#: The next step, against one that had to be cut.
GROWTH = 4.0

#: Parts of half a step in which the flow's rounding is looked at, and most where it grows towards
#: the end: they are then shorter than the rounding of any time.
PARTS, HALVINGS = 2, 64

#: What rounding leaves open of a step, against its states, where no force acts briefly: a few
#: roundings, and as many more as the flow's exponent in a step of a series may be.
ORDINARY = 64 * EPS


class Watchful(Solver):
    """Another solver, whose steps are held against the flow.

    Parameters
    ----------
    most : int, optional
        Steps in all. With this a step that cannot be shown to have seen all of its flow, and one
        step too many, is a :class:`FlowError`. Without, steps go on unwatched from there.
    shaken : bool
        Move the state after each step by what rounding may have done to the forces.
    trusted : bool
        Take the steps as they are.

    Attributes
    ----------
    cut : bool
        Whether a step had to be cut.
    blurred : float
        What that is in all, against the states' sizes.
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
    """The steps of another stepper, cut where they leave the flow.

    Attributes
    ----------
    longest : float
        The longest step that is tried next: one that had to be cut was longer than the flow can be
        seen by.
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
        """Cut the last step to what it is shown to have seen of the flow."""
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
        """Add up what rounding leaves open of the flow, in the run that is to be moved by it.

        Always to the same side: what is lost in a step need not be won back in the next. What
        forces ask for to change their formula is moved only where it is brief forces that move it,
        and on its way: it would else be asked again from before the place of change.
        """
        solver = self.solver
        if not solver.shaken:
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
        """The integral of what rounding leaves open, over the half of a step at one of its ends.

        It is large where a force acts in a narrow zone, and where the flow jumps at the end of the
        step: there for the time in which rounding decides on the side. So parts are halved towards
        the end, until what is left matters no more than all before.
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
