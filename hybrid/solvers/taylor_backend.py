"""Taylor series of the flow, one a step, from its tape.

The step is as long as the last two terms stay below rounding (Jorba & Zou, *A software
package for the numerical integration of ODEs by means of high-order Taylor methods*,
Experimental Mathematics 14, 2005), and as the polynomial has the flow's direction: a force may be
flat to rounding before it changes. A step ends at a kink (``abs``, ``where``), on whose far side
the other branch is expanded (:mod:`.kinks`).
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from ..errors import FlowError, OptionError
from ..events import EPS
from ..scene import Field
from ..scene.lowered import ORDER
from ..scene.taylor import polynomial, polynomial_and_slope
from ..segment import Segment, from_powers
from .base import Pace, Solver, Stepper
from .kinks import crossed_to, first_change, holding, left_open

#: Size, relative to the state, to which the last terms of a step are held.
ROUNDING = 1e-16

#: Where, besides its end, the series of a step is held against the flow (at a kink just before
#: that), and how far it may be off, as a multiple of rounding.
MIDDLE, BEFORE, MISSED = 0.55, 1.0 - 1e-9, 256.0

#: Roundings by which elements of a state are moved to see what rounding does.
SHIFTS = (8, -8, 11, -11, 14, -14)

#: On so short a way to a kink, against the time, rounding decides on which side of it the flow is.
BLURRED = 32 * EPS

#: Numbers next to the smallest lose digits; what they may be off is less than this.
NOTHING = 1e-290

#: A step that is cut to less than this share of what its last terms allow cannot be made.
SHORT = 1e-12

#: What is said where it cannot.
NO_STEP = (
    "the Taylor series does not converge: the step became zero; where a flow that "
    "jumps (sign, where) leads back to the jump from both sides, declare hy.switching"
)


class TaylorSolver(Solver):
    """Taylor series of order 16; tolerances above rounding are not needed and not used."""

    name = method = "taylor"
    order = ORDER

    def __init__(self, method: str | None, rtol: float, atol: Any) -> None:
        if method not in (None, "taylor"):
            raise OptionError(f"method={method!r}: solver 'taylor' has one method; leave it out")

    def begin(
        self,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        if field.jets is None:
            raise OptionError(f"solver='taylor': {field.refused}")
        return TaylorStepper(field, t0, x0, length)


class TaylorStepper(Stepper):
    """Steps along one arc by Taylor series."""

    repeats = True

    def __init__(self, field: Field, t0: float, x0: np.ndarray, length: float) -> None:
        self.field, self.t0, self.length, self.pace = field, t0, length, Pace()
        self.tau, self.x = 0.0, x0
        self.sides = [0] * field.kinks

    def step(self, limit: float) -> None:
        for _ in range(2 * self.field.kinks + 1):
            series, watched = self._series()
            h, crossed = self._length_of_step(series, watched, limit - self.tau)
            if crossed is None or self.tau + h > self.tau:
                break
            self.sides[crossed] = crossed_to(watched[crossed], self.sides[crossed])
        if not h > 1e-300 or (self.tau + h == self.tau and self.tau + h < limit):
            raise FlowError(NO_STEP)
        self._last = (self.tau, series)
        sides = [0] * len(watched)
        if crossed is not None:
            sides[crossed] = crossed_to(watched[crossed], self.sides[crossed])
        self.sides = sides
        self._finish(h, limit if self.tau + h >= limit else self.tau + h)
        self.pace.step(self._last[0], self.tau, self.length)

    def _length_of_step(
        self, series: list[list[float]], watched: list[list[float]], most: float
    ) -> tuple[float, int | None]:
        """How long a step is, at most ``most``, and the kink that ends it."""
        field, t = self.field, self.t0 + self.tau
        h = longest = min(step_length(series), holding(field.watched, watched), most)
        while h > SHORT * longest:
            h, crossed = first_change(field.watched, watched, t, h, self.sides)
            blurred = crossed is not None and h <= BLURRED * abs(t)
            if blurred or follows(field, t, series, watched, h, crossed is not None):
                return h, crossed
            h *= 0.5
        raise FlowError(NO_STEP)

    def land(self, tau: float) -> Segment:
        """The same series, cut at ``tau``."""
        if tau < self.tau:
            self.sides = [0] * self.field.kinks  # those beyond a kink that the step ended at
        self.tau = self._last[0]
        self._finish(tau - self.tau, tau)
        return self.segment()

    def segment(self) -> Segment:
        """The last step's series, in Chebyshev form."""
        start, series = self._last
        powers = np.array(series) * (self._length ** np.arange(ORDER + 1))
        return Segment(start, self.tau - start, from_powers(ORDER) @ powers.T)

    def _series(self) -> tuple[list[list[float]], list[list[float]]]:
        try:
            series, _, watched = self.field.expand(self.t0 + self.tau, self.x.tolist(), self.sides)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise FlowError("the flow is not finite, or has no Taylor series") from None
        if not np.all(np.isfinite(np.array(series))):
            raise FlowError("the flow is not finite")
        return series, watched

    def _finish(self, h: float, end: float) -> None:
        self._length, self.tau = h, end
        self.x = np.array([polynomial(c, h) for c in self._last[1]])
        if not all(map(isfinite, self.field.rhs(self.t0 + end, self.x.tolist()))):
            raise FlowError("the flow is not finite")


def step_length(series: list[list[float]]) -> float:
    """Length at which the last two terms of every state fall to rounding."""
    smallest = 1e-3 * max([abs(c[0]) for c in series])
    length = float("inf")
    for c in series:
        own = ROUNDING * max(abs(c[0]), abs(c[1]), smallest)
        if own == 0.0:
            length = min(length, _from_zero(c))
            continue
        last, other = abs(c[ORDER]), abs(c[ORDER - 1])
        if last and last * length**ORDER > own:
            length = (own / last) ** (1.0 / ORDER)
        if other and other * length ** (ORDER - 1) > own:
            length = (own / other) ** (1.0 / (ORDER - 1))
    return length


def _from_zero(c: list[float]) -> float:
    """Length at which the last two terms fall to rounding, of a state that is zero and at rest."""
    length = float("inf")
    for last in (ORDER - 1, ORDER):
        if c[last]:
            shares = [(k, ROUNDING * abs(c[k] / c[last])) for k in range(2, ORDER - 1)]
            length = min(length, max(share ** (1.0 / (last - k)) for k, share in shares))
    return length


def follows(
    field: Field,
    t: float,
    series: list[list[float]],
    watched: list[list[float]],
    h: float,
    kink: bool,
) -> bool:
    """Whether the polynomials of a step have the flow's direction along it, but for rounding, and
    those of what is watched are its values.

    ``kink``: the step ends at a kink. On a surface forces cancel, and leave rounding of the size of
    nothing that is seen here: there they are taken to be of the order of one at least.
    """
    scale, fastest = 1e-3 * max([abs(c[0]) for c in series]), max([abs(c[1]) for c in series])
    if field.project is not None:
        fastest = max(fastest, 1.0)
    for share in (MIDDLE, BEFORE if kink else 1.0):
        s = share * h
        pairs = [polynomial_and_slope(c, s) for c in series]
        x = [value for value, _ in pairs]
        here, there = (t + s, x), beside(t + s, x)
        try:
            rates, others = field.rhs(*here), field.rhs(*there)
        except (ValueError, OverflowError, ZeroDivisionError):
            return True  # which is said where the step ends
        for c, (_, along), rate, other in zip(series, pairs, rates, others, strict=True):
            rounding = fastest + abs(2.0 * c[2] * s) + abs(3.0 * c[3] * s * s)
            rounding += max(abs(c[0]), abs(c[1]), scale) / h
            if abs(rate - along) > MISSED * EPS * rounding + 8 * abs(rate - other) + NOTHING:
                return False
        if field.deciding and not _decides(field, watched, s, field.deciding(*here), there):
            return False
    return True


def beside(t: float, x: list[float]) -> tuple[float, list[float]]:
    """A time and state next to another, no two elements moved alike: what changes there by
    rounding is not known better."""
    return t * (1.0 + 8 * EPS), [v * (1.0 + SHIFTS[i % 6] * EPS) for i, v in enumerate(x)]


def _decides(
    field: Field, watched: list[list[float]], s: float, values: Any, there: tuple[float, Any]
) -> bool:
    """Whether the series of what is watched have its values, but for rounding."""
    assert field.deciding is not None
    everything = zip(field.watched, watched, values, field.deciding(*there), strict=True)
    for what, c, value, other in everything:
        off, size = abs(value - polynomial(c, s)), polynomial([*map(abs, c)], s)
        if what.kind == "step":
            off, size = abs(off - round(off)), size + abs(value)
        if off > MISSED * EPS * size + 8 * (abs(value - other) + left_open(c, s)):
            return False
    return True
