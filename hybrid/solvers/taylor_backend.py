"""Taylor series of the flow, one a step, from the generated recurrences.

The step is as long as the last two terms stay below rounding (Jorba & Zou, *A software
package for the numerical integration of ODEs by means of high-order Taylor methods*,
Experimental Mathematics 14, 2005), and as the polynomial has the flow's direction: a force may be
flat to rounding before it changes. A step ends at a kink (``abs``, ``where``), on whose far side
the other branch is expanded.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from ..errors import FlowError, OptionError
from ..events import EPS
from ..scene import Field
from ..scene.lowered import ORDER
from ..scene.taylor import polynomial, polynomial_and_slope, slope
from ..segment import Segment, from_powers
from .base import Solver, Stepper

#: Size, relative to the state, to which the last terms of a step are held.
ROUNDING = 1e-16

#: Where, besides its end, the series of a step is held against the flow (at a kink just before
#: that), and how far it may be off, as a multiple of rounding.
MIDDLE, BEFORE, MISSED = 0.55, 1.0 - 1e-9, 256.0

#: A step that is cut to less than this share of what its last terms allow cannot be made.
SHORT = 1e-12


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
            raise OptionError(
                f"solver='taylor': mode {field.name} uses a function that has no Taylor "
                "series; use solver='scipy'"
            )
        return TaylorStepper(field, t0, x0)


class TaylorStepper(Stepper):
    """Steps along one arc by Taylor series."""

    def __init__(self, field: Field, t0: float, x0: np.ndarray) -> None:
        self.field, self.t0 = field, t0
        self.tau, self.x = 0.0, x0
        self.sides = [0] * field.kinks

    def step(self, limit: float) -> None:
        series, kinks = self._series()
        h = min(step_length(series), limit - self.tau)
        h, crossed = first_kink(kinks, h, self.sides)
        longest = h
        t = self.t0 + self.tau
        while h > SHORT * longest and not follows(self.field, t, series, h, crossed is not None):
            h, crossed = 0.5 * h, None
        if (
            h <= SHORT * longest
            or not h > 1e-300
            or (self.tau + h == self.tau and self.tau + h < limit)
        ):
            raise FlowError(
                "the Taylor series does not converge: the step became zero; where a flow that "
                "jumps (sign, where) leads back to the jump from both sides, declare hy.switching"
            )
        self._last = (self.tau, series)
        sides = [0] * len(kinks)
        if crossed is not None:
            sides[crossed] = -1 if slope(kinks[crossed], h) < 0 else 1
        self.sides = sides
        self._finish(h, limit if self.tau + h >= limit else self.tau + h)

    def land(self, tau: float) -> Segment:
        """The same series, cut at ``tau``."""
        self.tau = self._last[0]
        self._finish(tau - self.tau, tau)
        return self.segment()

    def segment(self) -> Segment:
        """The last step's series, in Chebyshev form."""
        start, series = self._last
        powers = np.array(series) * (self._length ** np.arange(ORDER + 1))
        return Segment(start, self.tau - start, from_powers(ORDER) @ powers.T)

    def _series(self) -> tuple[list[list[float]], list[list[float]]]:
        assert self.field.jets is not None
        try:
            series, _, kinks = self.field.expand(self.t0 + self.tau, self.x.tolist(), self.sides)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise FlowError("the flow is not finite, or has no Taylor series") from None
        if not np.all(np.isfinite(np.array(series))):
            raise FlowError("the flow is not finite")
        return series, kinks

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


def follows(field: Field, t: float, series: list[list[float]], h: float, kink: bool) -> bool:
    """Whether the polynomials of a step have the flow's direction along it, but for rounding.

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
        beside = [v * (1.0 + (8 - 16 * (i % 2)) * EPS) for i, v in enumerate(x)]
        try:
            rates = field.rhs(t + s, x)
            others = field.rhs((t + s) * (1.0 + 8 * EPS), beside)
        except (ValueError, OverflowError, ZeroDivisionError):
            return True  # which is said where the step ends
        for c, (_, along), rate, other in zip(series, pairs, rates, others, strict=True):
            rounding = fastest + abs(2.0 * c[2] * s) + abs(3.0 * c[3] * s * s)
            rounding += max(abs(c[0]), abs(c[1]), scale) / h
            if abs(rate - along) > MISSED * EPS * rounding + 8 * abs(rate - other):
                return False
    return True


def first_kink(kinks: list[list[float]], h: float, sides: list[int]) -> tuple[float, int | None]:
    """The first zero of a kink within a step, and which; ``(h, None)`` if there is none."""
    chosen = None
    for index, c in enumerate(kinks):
        root = _first_zero(c, h, bool(sides[index]))
        if root is not None and root < h:
            h, chosen = root, index
    return h, chosen


def _first_zero(c: list[float], h: float, on_zero: bool) -> float | None:
    """First sign change of a series in ``(0, h)``; the zero at 0 is left out if known."""
    c = c[1:] if on_zero else c
    if not any(c):
        return None
    pieces = 16
    left, at_left = 0.0, polynomial(c, 0.0)
    for piece in range(1, pieces + 1):
        right = h * piece / pieces
        at_right = polynomial(c, right)
        if at_right == 0.0:
            return right
        if at_left * at_right < 0:
            return _bisect_newton(c, left, right)
        left, at_left = right, at_right
    return None


def _bisect_newton(c: list[float], left: float, right: float) -> float:
    """The zero of a series between two points of opposite sign."""
    rising = polynomial(c, right) > 0
    s = 0.5 * (left + right)
    for _ in range(100):
        value = polynomial(c, s)
        if value == 0 or right - left <= 4e-16 * right:
            break
        if (value > 0) == rising:
            right = s
        else:
            left = s
        rate = slope(c, s)
        new = s - value / rate if rate else left
        new = new if left < new < right else 0.5 * (left + right)
        if abs(new - s) <= 2e-16 * abs(s):
            return new
        s = new
    return s
