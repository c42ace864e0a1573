"""How far along a step its polynomial provably follows the flow, in ball arithmetic.

The defect of a step's polynomial ``p`` is ``f(t, p(t)) - p'(t)``. A method and its error estimate
evaluate the flow at a few points only, so both can miss a force pulse between them. Here the defect
is bounded on the whole step, by power series of balls (:mod:`.series`) on pieces. Pieces are halved
until the bound is small or the defect at a point is shown to be large.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from math import comb, inf
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..errors import TraceError
from ..lowering.jaxpr import read
from ..rules.zeros import EPS
from ..segment import to_centred_powers

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector
    from ..lowering import Field
    from ..segment import Segment
    from .series import Bound

#: Most pieces of a step; about fifty halvings isolate a jump to rounding, so this allows for
#: several.
DEFECT_PIECES = 400

#: Fractions of a step at which its defect is sampled, and the tolerated factor above the median of
#: the samples. A Runge-Kutta defect has zeros and is at most about five times the median.
DEFECT_PLACES, ABOVE_MEDIAN = (np.arange(15) + 0.5) / 15, 32.0

#: Samples of a step for a flow without enclosure; each is a call of some ten microseconds. An
#: effect shorter than the distance between samples may be missed.
FLOW_SAMPLES = 256

#: Tolerated error of a step's polynomial between its ends, relative to the tolerance at its end.
#: Interpolants of one order less than the method have errors of some hundred tolerances at 1e-12.
LOOSE = 1e3

#: Rounding of the flow and of the polynomial's slope, relative to the rates and to the state over
#: the step length. A polynomial of degree 24 has slopes of up to 576 times its values.
SLOPE_ROUNDING = 1024 * EPS

#: Bits of a double's mantissa.
DOUBLE = 53


@attrs.frozen(eq=False)
class _StepPart:
    """A part of a step: midpoint and half-length in time, states in powers on ``[-1, 1]``."""

    middle: Any
    half: Any
    powers: Matrix

    def halves(self) -> tuple[_StepPart, _StepPart]:
        left, right = (matrix @ self.powers for matrix in _halving(len(self.powers) - 1))
        half = self.half / 2
        return _StepPart(self.middle - half, half, left), _StepPart(self.middle + half, half, right)


#: Bits of the bounds of a step. A state that leaves a kink by an acceleration is beyond it by the
#: square of the time, which for a rounding of the time is 106 bits below the state.
STEP_PRECISION = 160


class Defect:
    """Bounds on the defect of steps in a field; made once per class and mode."""

    def __init__(self, field: Field) -> None:
        from .exact import FixedGraph
        from .interval import IntervalProgram
        from .series import Balls

        code = field.code
        graph = FixedGraph(exact=True)
        closed = code.field_closed(field.mode, field.held)
        (found,) = read(graph, closed, code.inputs(graph))
        roots = [int(i) for i in found.reshape(-1)]
        self.balls = Balls(graph, roots)
        self.program = IntervalProgram(graph, roots)
        self.rounded = IntervalProgram(graph, roots, DOUBLE)

    def share(
        self, field: Field, t: float, length: float, coefficients: Matrix, lost: Any = 0.0
    ) -> float:
        """The fraction of a step up to which its polynomial provably follows the flow.

        What is within the rounding of the time from either end is not asked: a formula that
        changes there is on both its sides.

        Parameters
        ----------
        t, length : float
            Start and length of the step.
        coefficients : array, shape (degree + 1, n)
            Chebyshev coefficients of the states on it.
        lost : float or array
            Tolerated error of each state element from the step.
        """
        from .series import with_terms

        if length <= 64 * EPS * abs(t):
            return 1.0
        allowed = _allowed(field, t, length, coefficients, lost)
        blurred = 64 * EPS * max(length, abs(t)) / length
        reach = lambda: self._reach(field, t, length, coefficients, *allowed, blurred)  # noqa: E731
        share = float(with_terms(reach, STEP_PRECISION))
        return 1.0 if 1.0 - share <= blurred else share

    def left_open(self, field: Field, t: float, x: StateVector, off: StateVector) -> StateVector:
        """Uncertainty of the flow when time, states and operations are known to rounding only.

        Where a formula may change, both flows are included; an element that may be undefined has
        uncertainty 0.

        Parameters
        ----------
        off : array
            Uncertainty of each state element.

        Returns
        -------
        array, shape (n,)
        """
        from flint import arb, ctx

        pairs = enumerate(zip(x.tolist(), off.tolist(), strict=True))
        place = {f"x{i}": arb(value, radius) for i, (value, radius) in pairs}
        place["t"] = arb(t, 2.0 * float(np.spacing(abs(t))))
        with ctx.workprec(DOUBLE):
            rates = self._bound_to(field, series=False)(place)
        if not all(isinstance(rate, arb) and rate.is_finite() for rate in rates):
            found = self.rounded.enclose(_numbers(field) | place)
            rates = [f.value if f.defined else arb(0) for f in found]
        return np.array([2.0 * float(rate.rad()) for rate in rates])

    def _bound_to(self, field: Field, series: bool) -> Bound:
        """The flow with parameter values, at flint's present precision, for series or balls."""
        key = "balls", self, series
        found: Bound = field.once(key, lambda: self.balls.bind(field.numbers, series))
        return found

    def _reach(
        self,
        field: Field,
        t: float,
        length: float,
        coefficients: Matrix,
        rates: Numbers,
        speck: Numbers,
        blurred: float,
    ) -> float:
        from flint import arb

        half = arb(length) / 2
        whole = to_centred_powers(len(coefficients) - 1) @ coefficients
        start = arb(t)
        pieces = [_StepPart(start + half, half, whole)]
        for _ in range(DEFECT_PIECES):
            piece = pieces.pop()
            bound, least = self._bound(field, piece)
            inside, half = float(piece.middle - start), float(piece.half)
            small = bound <= np.maximum(rates, speck / (2.0 * half))
            at_end = min(inside, length - inside) + half <= blurred * length
            if not (at_end or np.all(small)):
                if np.any(least > rates) and half < 1e-3 * length:
                    return _share(piece, start, length)
                pieces += piece.halves()[::-1]
            elif not pieces:
                return 1.0
        return _share(pieces[-1], start, length)

    def _bound(self, field: Field, piece: _StepPart) -> tuple[np.ndarray, np.ndarray]:
        """Upper and lower bounds on the absolute defect of a piece, per state element."""
        from flint import arb

        from .series import TERMS

        n = piece.powers.shape[1]
        around = _spread(len(piece.powers) - 1) @ np.abs(piece.powers)
        flow = self._bound_to(field, series=True)
        wide: list[Any] = [_coefficients(v) for v in flow(_inputs(piece, around))]
        if any(w is None for w in wide):
            return self._plainly(field, piece, around), np.zeros(n)
        middle = flow(_inputs(piece, None))
        most, least = np.empty(n), np.empty(n)
        slopes = _slope(piece.powers) / float(piece.half)
        for i in range(n):
            own = _coefficients(middle[i])
            if own is None:
                return np.full(n, inf), np.zeros(n)
            slope = slopes[:, i].tolist()
            off = [abs(own[k] - slope[k]) for k in range(TERMS - 1)]
            last = abs(wide[i][TERMS - 1]) + sum(map(abs, map(arb, slope[TERMS - 1 :])))
            most[i] = sum(float(c.upper()) for c in off) + float(last.upper())
            least[i] = float(off[0].lower())
        return np.where(np.isfinite(most), most, inf), least

    def _plainly(self, field: Field, piece: _StepPart, around: Matrix) -> Numbers:
        """An upper bound on the defect from one box around the piece, where there is no series."""
        from flint import arb

        slopes = _slope(piece.powers) / float(piece.half)
        box = _numbers(field) | {"t": arb(piece.middle, piece.half)}
        for i in range(piece.powers.shape[1]):
            box[f"x{i}"] = arb(piece.powers[0, i], around[0, i])
        bounds = []
        for i, found in enumerate(self.program.enclose(box)):
            own = arb(slopes[0, i], float(np.abs(slopes[1:, i]).sum()))
            bounds.append(float(abs(found.value - own).upper()) if found.defined else inf)
        return np.array(bounds)


class Sampled:
    """The defect at samples of a step, for a flow with foreign calls, which has no enclosure."""

    def share(
        self, field: Field, t: float, length: float, coefficients: Matrix, lost: Any = 0.0
    ) -> float:
        """The fraction of a step up to which its polynomial follows the flow at the samples."""
        rates, _ = _allowed(field, t, length, coefficients, lost)
        slope = chebyshev.chebder(coefficients) * (2.0 / length)
        for k in range(1, FLOW_SAMPLES):
            place = 2.0 * k / FLOW_SAMPLES - 1.0
            x, way = (chebyshev.chebval(place, c) for c in (coefficients, slope))
            found = np.array(field.rhs(t + k * length / FLOW_SAMPLES, x.tolist()))
            if np.any(np.abs(found - way) > rates):
                return (k - 1) / FLOW_SAMPLES
        return 1.0

    def left_open(self, field: Field, t: float, x: StateVector, off: StateVector) -> StateVector:
        """Zeros: the effect of rounding on such a flow is not known."""
        return np.zeros_like(x)


def defect_of(field: Field) -> Defect | Sampled | None:
    """The defect bounds of a field, or None.

    None if states are projected onto a surface, which step polynomials leave; if an operation has
    no enclosure; or if python-flint is missing.
    """
    if field.project is not None:
        return None
    if field.jets is None:
        return Sampled()
    if find_spec("flint") is None:
        return None

    def make() -> Defect | None:
        try:
            return Defect(field)
        except TraceError:
            return None

    found: Defect | None = field.code.once(("defect", field.name), make)
    return found


def follows(field: Field, t: float, segments: Iterable[Segment]) -> bool:
    """Whether the segments of an arc from ``t`` provably follow the flow; True if there are no
    defect bounds."""
    defect = defect_of(field)
    return defect is None or all(
        defect.share(field, t + s.start, s.length, s.coefficients) >= 1.0 for s in segments
    )


def _share(piece: _StepPart, start: Any, length: float) -> float:
    """The fraction of a step at which a piece starts."""
    return max(0.0, float(piece.middle - piece.half - start) / length)


def _numbers(field: Field) -> dict[str, Any]:
    """The parameter values by the input names of a graph."""
    return {f"p{i}": value for i, value in enumerate(field.numbers)}


def _inputs(piece: _StepPart, around: Matrix | None) -> dict[str, Any]:
    """Time and states as series on a piece: about its middle, or, with the amounts ``around`` by
    which coefficients vary over the piece, about any point of it."""
    from flint import arb, arb_series

    from .series import TERMS

    first = piece.middle if around is None else arb(piece.middle, piece.half)
    inputs = {"t": arb_series([first, piece.half])}
    for i, column in enumerate(piece.powers[:TERMS].T.tolist()):
        if around is not None:
            column = [arb(c, r) for c, r in zip(column, around[:TERMS, i].tolist(), strict=True)]
        inputs[f"x{i}"] = arb_series(column)
    return inputs


def _coefficients(value: Any) -> list[Any] | None:
    """The coefficients of a result; None if one is not finite."""
    from flint import arb, arb_series

    from .series import TERMS

    if isinstance(value, arb):
        value = arb_series([value])
    if not isinstance(value, arb_series):
        return None
    found = [value[k] for k in range(TERMS)]
    return found if all(c.is_finite() for c in found) else None


def _slope(powers: Matrix) -> Matrix:
    """Coefficients of the derivatives of polynomials, padded to at least ``TERMS`` rows."""
    from .series import TERMS

    degree = len(powers) - 1
    slopes = np.zeros((max(degree, TERMS), powers.shape[1]))
    slopes[:degree] = powers[1:] * np.arange(1, degree + 1)[:, None]
    return slopes


def _allowed(
    field: Field, t: float, length: float, coefficients: Matrix, lost: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Tolerated defects of a step, and the tolerated integral of the defect over any part of it.

    The former follow from the median of the sampled defects, the tolerance and rounding; the latter
    is at rounding level.
    """
    n = coefficients.shape[1]
    degree = len(coefficients) - 1
    values, slopes = _sampling(degree)
    states, slopes = values @ coefficients, slopes @ coefficients * (2.0 / length)
    times = t + DEFECT_PLACES * length
    beside = states * (1.0 + (8 - 16 * (np.arange(n) % 2)) * EPS)
    rates = np.array([field.rhs(*at) for at in zip(times.tolist(), states.tolist(), strict=True)])
    moved = zip((times * (1.0 + 8 * EPS)).tolist(), beside.tolist(), strict=True)
    noise = np.abs(np.array([field.rhs(*at) for at in moved]) - rates).max(axis=0)
    off = np.sort(np.abs(rates - slopes), axis=0)[len(DEFECT_PLACES) // 2]
    size = np.maximum(np.abs(states).max(axis=0), 1e-3 * np.abs(states).max())
    typical = np.minimum(off, LOOSE * np.asarray(lost) / length)
    rounding = SLOPE_ROUNDING * (np.abs(rates).max() + size / length) + 8.0 * noise
    return ABOVE_MEDIAN * typical + rounding, 8.0 * EPS * size


@cache
def _sampling(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from Chebyshev coefficients to values and slopes (on ``[-1, 1]``) at the samples."""
    places = 2.0 * DEFECT_PLACES - 1.0
    slopes = chebyshev.chebder(np.eye(degree + 1))
    return chebyshev.chebvander(places, degree), chebyshev.chebval(places, slopes).T


@cache
def _halving(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from powers on ``[-1, 1]`` to powers on its two halves."""
    size = range(degree + 1)
    right = np.array([[comb(k, j) * 0.5**k if k >= j else 0.0 for k in size] for j in size])
    signs = (-1.0) ** (np.arange(degree + 1)[None, :] - np.arange(degree + 1)[:, None])
    return right * signs, right


@cache
def _spread(degree: int) -> np.ndarray:
    """Matrix from absolute coefficients on ``[-1, 1]`` about 0 to bounds on the changes of the
    coefficients when the polynomial is expanded about another point of ``[-1, 1]``."""
    size = range(degree + 1)
    return np.array([[float(comb(k, j)) if k > j else 0.0 for k in size] for j in size])
