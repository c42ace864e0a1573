"""How far along a step its polynomial is known to follow the flow, in ball arithmetic.

With ``p`` a step's polynomial the defect is ``f(t, p(t)) - p'(t)``. A method looks at it at some
points only, and so does its estimate of the error: a pulse of force between two of them is passed
over by the step and by what measures the step. Here the defect is bounded on all of the step, by
power series of balls (:mod:`.ballseries`) on pieces that are halved until the bound is small
or a point shows that it is not.
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
from .taylor import flat

if TYPE_CHECKING:
    from ..segment import Segment
    from .scene import Field

EPS = float(np.finfo(float).eps)

#: Most pieces of a step: some fifty halvings find a jump to rounding, a few times over.
PIECES = 400

#: Where the defect of a step is sampled, and how far it may be above the median of the samples:
#: that of a Runge-Kutta method has zeros among them and is about five times the median at most.
POINTS, ABOVE = (np.arange(15) + 0.5) / 15, 32.0

#: Points of a step at which a flow is asked that nothing encloses: each is a call, some ten
#: microseconds. What acts for less than a part between two of them may be passed over.
SAMPLES = 256

#: How far a step's polynomial may be off between its ends, against the tolerance at its end: those
#: of an order less by one are, at a tolerance of 1e-12, off by some hundred times that.
LOOSE = 1e3

#: Rounding of the flow and of a polynomial's slope, in units of rounding of the rates and of the
#: state over the step: a polynomial of degree 16 has slopes of up to 256 times its values.
ROUNDING = 1024 * EPS

#: Bits of a double.
DOUBLE = 53


@attrs.frozen(eq=False)
class _Piece:
    """A part of a step: its middle and half length in time, powers of ``[-1, 1]`` of the states."""

    middle: Any
    half: Any
    powers: np.ndarray

    def halves(self) -> tuple[_Piece, _Piece]:
        left, right = (matrix @ self.powers for matrix in _halving(len(self.powers) - 1))
        half = self.half / 2
        return _Piece(self.middle - half, half, left), _Piece(self.middle + half, half, right)


class Defect:
    """Bounds on the defect of steps in a field; made once for a class and a mode."""

    def __init__(self, field: Field) -> None:
        from .fixed import FixedGraph
        from .interval import IntervalProgram

        code = field.code
        graph = FixedGraph(exact=True)
        closed = code.field_closed(field.mode, field.held)
        (found,) = graph.outputs(closed, code.inputs(graph))
        self.graph, self.roots = graph, [int(i) for i in found.reshape(-1)]
        self.program = IntervalProgram(graph, self.roots)
        self.rounded = IntervalProgram(graph, self.roots, DOUBLE)

    def share(
        self, field: Field, t: float, length: float, coefficients: np.ndarray, lost: Any = 0.0
    ) -> float:
        """The share of a step up to which its polynomial is shown to follow the flow.

        1 where nothing is left but what the rounding of the time may be.

        Parameters
        ----------
        t, length : float
            The step.
        coefficients : array, shape (degree + 1, n)
            Chebyshev coefficients of the states on it.
        lost : float or array
            What the method may lose of each state in the step.
        """
        from .ballseries import with_terms
        from .interval import PRECISION

        rates, speck = _allowed(field, t, length, coefficients, lost)
        given = {f"p{i}": value for i, value in enumerate(flat(field.parameters))}
        reach = lambda: self._reach(given, t, length, coefficients, rates, speck)  # noqa: E731
        share = float(with_terms(reach, PRECISION))
        return 1.0 if (1.0 - share) * length <= 64 * EPS * max(length, abs(t)) else share

    def left_open(self, field: Field, t: float, x: np.ndarray, off: np.ndarray) -> np.ndarray:
        """How far apart rates may be where time and states are known to their rounding only.

        That of the operations included. Where a formula may change, the rates of both are meant;
        where one ends, nothing is.

        Parameters
        ----------
        off : array
            By how much each state may be off.
        """
        from flint import arb

        box: dict[str, Any] = {f"p{i}": value for i, value in enumerate(flat(field.parameters))}
        box["t"] = arb(t, 2.0 * float(np.spacing(abs(t))))
        pairs = enumerate(zip(x.tolist(), off.tolist(), strict=True))
        box |= {f"x{i}": arb(value, radius) for i, (value, radius) in pairs}
        found = self.rounded.enclose(box)
        return np.array([2.0 * float(f.value.rad()) if f.defined else 0.0 for f in found])

    def _reach(
        self,
        given: dict[str, Any],
        t: float,
        length: float,
        coefficients: np.ndarray,
        rates: np.ndarray,
        speck: np.ndarray,
    ) -> float:
        from flint import arb

        given = {name: arb(value) for name, value in given.items()}
        half = arb(length) / 2
        whole = _to_powers(len(coefficients) - 1) @ coefficients
        start = arb(t)
        pieces = [_Piece(start + half, half, whole)]
        for _ in range(PIECES):
            piece = pieces.pop()
            bound, least = self._bound(given, piece)
            small = bound <= np.maximum(rates, speck / (2.0 * float(piece.half)))
            if not np.all(small):
                if np.any(least > rates) and float(piece.half) < 1e-3 * length:
                    return _share(piece, start, length)
                pieces += piece.halves()[::-1]
            elif not pieces:
                return 1.0
        return _share(pieces[-1], start, length)

    def _bound(self, given: dict[str, Any], piece: _Piece) -> tuple[np.ndarray, np.ndarray]:
        """An upper bound on the defect of a piece, and a lower one, each element's own."""
        from .ballseries import TERMS, evaluate

        n = piece.powers.shape[1]
        around = _spread(len(piece.powers) - 1) @ np.abs(piece.powers)
        wide = evaluate(self.graph, self.roots, _inputs(given, piece, around))
        wide = [_coefficients(v) for v in wide]
        if any(w is None for w in wide):
            return self._plainly(given, piece, around), np.zeros(n)
        middle = evaluate(self.graph, self.roots, _inputs(given, piece, None))
        most, least, half = np.empty(n), np.empty(n), float(piece.half)
        for i in range(n):
            own = _coefficients(middle[i])
            if own is None:
                return np.full(n, inf), np.zeros(n)
            slope = _slope(piece.powers[:, i]) / half
            off = [abs(own[k] - slope[k]) for k in range(TERMS - 1)]
            last = abs(wide[i][TERMS - 1]) + _beyond(slope, TERMS - 1)
            most[i] = sum(float(c.upper()) for c in off) + float(last.upper())
            least[i] = float(off[0].lower())
        return np.where(np.isfinite(most), most, inf), least

    def _plainly(self, given: dict[str, Any], piece: _Piece, around: np.ndarray) -> np.ndarray:
        """The same where the flow is no series on the piece: from its bounds on a box."""
        from flint import arb

        half = float(piece.half)
        box = {**given, "t": arb(piece.middle, piece.half)}
        for i in range(piece.powers.shape[1]):
            box[f"x{i}"] = arb(piece.powers[0, i], around[0, i])
        bounds = []
        for i, found in enumerate(self.program.enclose(box)):
            slope = _slope(piece.powers[:, i]) / half
            own = arb(slope[0], float(np.abs(slope[1:]).sum()))
            bounds.append(float(abs(found.value - own).upper()) if found.defined else inf)
        return np.array(bounds)


class Sampled:
    """The same of a flow that calls functions, which nothing encloses: at points of a step only."""

    def share(
        self, field: Field, t: float, length: float, coefficients: np.ndarray, lost: Any = 0.0
    ) -> float:
        """The share of a step up to which its polynomial follows the flow at points."""
        rates, _ = _allowed(field, t, length, coefficients, lost)
        slope = chebyshev.chebder(coefficients) * (2.0 / length)
        for k in range(1, SAMPLES):
            place = 2.0 * k / SAMPLES - 1.0
            x, way = (chebyshev.chebval(place, c) for c in (coefficients, slope))
            found = np.array(field.rhs(t + k * length / SAMPLES, x.tolist()))
            if np.any(np.abs(found - way) > rates):
                return (k - 1) / SAMPLES
        return 1.0

    def left_open(self, field: Field, t: float, x: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Nothing is known of the rounding of such a flow."""
        return np.zeros_like(x)


def defect_of(field: Field) -> Defect | Sampled | None:
    """The bounds of a field; None where there are none.

    There are none of a flow that is kept on a surface (which no polynomial of a step is), and
    without python-flint.
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
    """Whether all segments of an arc that begins at ``t`` follow the flow, where it can be told."""
    defect = defect_of(field)
    return defect is None or all(
        defect.share(field, t + s.start, s.length, s.coefficients) >= 1.0 for s in segments
    )


def _share(piece: _Piece, start: Any, length: float) -> float:
    return max(0.0, float(piece.middle - piece.half - start) / length)


def _inputs(given: dict[str, Any], piece: _Piece, around: np.ndarray | None) -> dict[str, Any]:
    """Time and states as series on a piece: about its middle, or with balls about all of it."""
    from flint import arb, arb_series

    from .ballseries import TERMS

    first = piece.middle if around is None else arb(piece.middle, piece.half)
    inputs = {**given, "t": arb_series([first, piece.half])}
    for i, column in enumerate(piece.powers[:TERMS].T.tolist()):
        if around is not None:
            column = [arb(c, r) for c, r in zip(column, around[:TERMS, i].tolist(), strict=True)]
        inputs[f"x{i}"] = arb_series(column)
    return inputs


def _coefficients(value: Any) -> list[Any] | None:
    """The coefficients of a result, all of them; None where one is not a finite number."""
    from flint import arb, arb_series

    from .ballseries import TERMS

    if isinstance(value, arb):
        value = arb_series([value])
    if not isinstance(value, arb_series):
        return None
    found = [value[k] for k in range(TERMS)]
    return found if all(c.is_finite() for c in found) else None


def _slope(powers: np.ndarray) -> np.ndarray:
    """Coefficients of a derivative; enough of them."""
    from .ballseries import TERMS

    own = powers[1:] * np.arange(1, len(powers))
    return np.pad(own, (0, max(0, TERMS - len(own))))


def _beyond(slope: np.ndarray, first: int) -> Any:
    """All that a polynomial's coefficients from one on can add up to."""
    from flint import arb

    return arb(float(np.abs(slope[first:]).sum()))


def _allowed(
    field: Field, t: float, length: float, coefficients: np.ndarray, lost: Any
) -> tuple[np.ndarray, np.ndarray]:
    """What a defect may be: of the order of what it is at most samples, and of the tolerance.

    Or rounding. And how much of the state a part of the step may leave open, whatever the defect
    there: rounding.
    """
    n = coefficients.shape[1]
    degree = len(coefficients) - 1
    vander = chebyshev.chebvander(2.0 * POINTS - 1.0, degree)
    states = vander @ coefficients
    slopes = _slopes(degree) @ coefficients * (2.0 / length)
    off, noise, fastest = np.empty((len(POINTS), n)), np.zeros(n), 0.0
    for k, (share, x) in enumerate(zip(POINTS.tolist(), states.tolist(), strict=True)):
        s = t + share * length
        rates = np.array(field.rhs(s, x))
        beside = [v * (1.0 + (8 - 16 * (i % 2)) * EPS) for i, v in enumerate(x)]
        moved = np.array(field.rhs(s * (1.0 + 8 * EPS), beside))
        noise = np.maximum(noise, np.abs(moved - rates))
        off[k], fastest = np.abs(rates - slopes[k]), max(fastest, float(np.abs(rates).max()))
    size = np.maximum(np.abs(states).max(axis=0), 1e-3 * np.abs(states).max())
    typical = np.minimum(np.median(off, axis=0), LOOSE * np.asarray(lost) / length)
    rounding = ROUNDING * (fastest + size / length) + 8.0 * noise
    return ABOVE * typical + rounding, 8.0 * EPS * size


@cache
def _slopes(degree: int) -> np.ndarray:
    """Matrix from Chebyshev coefficients to slopes at the samples, by the fraction of a half."""
    columns = [
        chebyshev.chebval(2.0 * POINTS - 1.0, chebyshev.chebder(np.eye(degree + 1)[k]))
        for k in range(degree + 1)
    ]
    return np.array(columns).T


@cache
def _to_powers(degree: int) -> np.ndarray:
    """Matrix from Chebyshev coefficients to those of powers."""
    columns = [
        np.pad(own, (0, degree + 1 - len(own)))
        for own in (chebyshev.cheb2poly(np.eye(degree + 1)[k][: k + 1]) for k in range(degree + 1))
    ]
    return np.array(columns).T


@cache
def _halving(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from powers on ``[-1, 1]`` to powers on its halves."""
    size = range(degree + 1)
    right = np.array([[comb(k, j) * 0.5**k if k >= j else 0.0 for k in size] for j in size])
    signs = (-1.0) ** (np.arange(degree + 1)[None, :] - np.arange(degree + 1)[:, None])
    return right * signs, right


@cache
def _spread(degree: int) -> np.ndarray:
    """Matrix from sizes of coefficients to how far each moves as the place runs over the piece."""
    size = range(degree + 1)
    return np.array([[float(comb(k, j)) if k > j else 0.0 for k in size] for j in size])
