"""The first variation along an arc: fundamental matrices of the variational equation.

They are computed by power series from the start of each step or, for a flow without series, by
collocation on dense output. A perturbation of the state obeys ``d' = f_x d + f_p dp``. At a *kink*,
where a formula of the flow changes, the flow may jump from ``f-`` to ``f+``. With ``k`` the
*deciding function*, whose sign selects the formula, the perturbation is then multiplied by the
saltation matrix ``1 + (f+ - f-) k_x / (k_t + k_x f-)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import attrs
import numpy as np
from numpy.polynomial import legendre

from ..errors import OrbitError
from ..lowering import Field
from ..rules.changes import MOST_ASIDE, TOLD_APART
from ..rules.limits import KINK_ROUNDING, KINK_SIDE, SAME_FLOW, SAME_KINK_TIME
from ..segment import Segment, nodes
from .derivatives import Derivatives, MatrixFunction

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Stages of the collocation; its order is twice that.
STAGES = 8

#: Relative error below which a step is no longer halved, and most halvings of a step. A corner of a
#: formula takes as many as a double has bits, so this allows for several.
COLLOCATION_TOLERANCE, COLLOCATION_HALVINGS = 1e-12, 200

#: Relative error up to which a step that is not resolved after all halvings is believed: corners
#: leave rounding. A root of what becomes zero leaves more, as its slope has no bound there.
UNRESOLVED = 1e-9

#: Most pieces into which a step is divided so that rounding in a fast-growing direction does not
#: hide a slow one.
MOST_PIECES = 1000

#: Fractions of a step at which the deciding functions and the size of the state are evaluated.
STEP_PLACES = nodes(8)

#: The fraction of a step at its start, as an array.
START = np.zeros(1)


class Flowing(Protocol):
    """Anything with a flow: a field, or a flow with delays that is evaluated anew at each time."""

    @property
    def rhs(self) -> Callable[..., Any]: ...


@attrs.frozen(eq=False)
class ArcPiece:
    """A part of a step, in the local time of an arc that begins at ``t``."""

    t: float
    segment: Segment
    start: float
    length: float

    @property
    def end(self) -> float:
        return self.start + self.length

    @property
    def first(self) -> Numbers:
        """The state at the start of the piece."""
        whole = self.start == self.segment.start
        state: np.ndarray = self.segment.at(START)[0] if whole else self.segment(self.start)
        return state

    @property
    def beside(self) -> float:
        """Distance in time from the ends of the piece at which one-sided values are evaluated."""
        share = max(KINK_SIDE, TOLD_APART * self.segment.end / self.length)
        return min(share, MOST_ASIDE) * self.length

    def inside(self, ends: bool) -> float:
        """The local time at distance ``beside`` from the end if ``ends``, else from the start."""
        return self.end - self.beside if ends else self.start + self.beside

    def halves(self) -> list[ArcPiece]:
        """The two halves of the piece."""
        half = 0.5 * self.length
        starts = self.start, self.start + half
        return [ArcPiece(self.t, self.segment, start, half) for start in starts]

    def flow(self, field: Flowing, ends: bool) -> tuple[np.ndarray, np.ndarray]:
        """The flow at the end (if ``ends``) or the start, as a limit from inside the piece; and the
        size of the flow near there, element by element."""
        end, way = (self.end, -1.0) if ends else (self.start, 1.0)
        taus = [end + way * s for s in (self.beside, 2.0 * self.beside, 0.5 * self.length)]
        near, far, middle = (
            np.array(field.rhs(self.t + tau, self.segment(tau).tolist())) for tau in taus
        )
        return 2.0 * near - far, np.maximum(np.abs(near), np.abs(middle))


def composed(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The matrix of ``first`` followed by ``second``, each of shape ``(n, n + q)``: the last ``q``
    columns belong to parameters."""
    size = len(first)
    found = second[:, :size] @ first
    found[:, size:] += second[:, size:]
    return found


def along(
    of: Derivatives,
    field: Field,
    t: float,
    segments: Sequence[Segment],
    apart: float = np.inf,
) -> Iterator[tuple[float, np.ndarray]]:
    """Carry perturbations along an arc, piece by piece.

    Parameters
    ----------
    of : Derivatives
    field : Field
    t : float
        Time at the start of the arc to which the segments belong.
    segments : sequence of Segment
        Empty if the arc has no length.
    apart : float
        Largest logarithm of the ratio of the fastest to the slowest growth within one matrix.

    Yields
    ------
    (float, array)
        Local end time of a piece, and the matrix of shape ``(n, n + q)`` that maps a perturbation
        at its start to one at its end.
    """
    series, rates = of.series(field), partial(of.flow, field)
    kinks, largest = None, np.zeros(of.size)
    if field.changes and segments:
        segments = resolvable(segments)
        largest = np.max([middle(field, t, segment) for segment in segments], axis=0)
        kinks = of.kinks(("flow", field.name), field, lambda g: g.flow(bool(field.held)))
    last: ArcPiece | None = None
    for segment in segments:
        whole = pieces(kinks, t, segment)
        for piece in whole if apart == np.inf else shorter(rates(), whole, apart):
            if kinks is not None and last is not None:
                turn = bend(kinks, field, last, piece, largest)
                if turn is not None:
                    yield piece.start, turn
            matrix = None if series is None else series.carried(piece)
            yield piece.end, _resolve(rates(), piece, of.units) if matrix is None else matrix
            last = piece


def shorter(rate: MatrixFunction, whole: Sequence[ArcPiece], apart: float) -> Iterator[ArcPiece]:
    """Divide pieces until the fastest and the slowest growth within each differ by a factor of at
    most ``exp(apart)``. A piece that would need more than :data:`MOST_PIECES` stays whole."""
    for piece in whole:
        tau, n = piece.start + 0.5 * piece.length, len(piece.first)
        rates = rate(piece.t + tau, piece.segment(tau))[:, 1 : 1 + n]
        growth = np.ptp(np.linalg.eigvals(rates).real) * piece.length
        count = max(int(np.ceil(growth / apart)), 1) if growth < MOST_PIECES * apart else 1
        ends = piece.start + piece.length * np.arange(count + 1) / count
        for a, b in pairwise([*ends[:-1].tolist(), piece.end]):
            yield ArcPiece(piece.t, piece.segment, a, b - a)


def _resolve(rate: MatrixFunction, piece: ArcPiece, units: np.ndarray) -> np.ndarray:
    """The matrix of a piece by collocation, halving the piece until it is resolved.

    Raises
    ------
    OrbitError
        If it cannot be resolved.
    """
    open_pieces, left, found = [(piece, *collocate(rate, piece))], COLLOCATION_HALVINGS, None
    while open_pieces:
        piece, once, ripple = open_pieces.pop()
        size = sizes(piece, once, units)
        allowed = COLLOCATION_TOLERANCE * size
        both, halves = once, list[tuple[ArcPiece, np.ndarray, np.ndarray]]()
        if left and np.any(ripple > allowed):
            halves = [(half, *collocate(rate, half)) for half in piece.halves()]
            both = composed(halves[1][1], halves[0][1])
        if np.any(np.abs(both - once) > allowed):
            left -= 1
            open_pieces += halves[::-1]
        elif not left and np.any(ripple > UNRESOLVED * size) and not _is_fast(rate, piece):
            raise _unbounded(piece)
        else:
            found = both if found is None else composed(both, found)
    assert found is not None
    return found


def _is_fast(rate: MatrixFunction, piece: ArcPiece) -> bool:
    """Whether perturbations change within a piece by as much as they are, so that there are too few
    halvings for a stiff flow, in which they fall to rounding."""
    tau, n = piece.start + 0.5 * piece.length, len(piece.first)
    rates = rate(piece.t + tau, piece.segment(tau))[:, 1 : 1 + n]
    return bool(np.abs(np.linalg.eigvals(rates)).max() * piece.length > 0.5)


def _unbounded(piece: ArcPiece) -> OrbitError:
    return OrbitError(
        f"t = {piece.t + piece.start:.9g}: the derivative of the flow has no bound there, as that "
        "of a root of what becomes zero, and the first variation cannot be followed through it"
    )


def sizes(piece: ArcPiece, matrix: Matrix, units: Numbers) -> Matrix:
    """The size against which the error of each entry of a piece's matrix is measured.

    State columns are scaled by their largest entry. Parameter columns are scaled by the
    larger of their own largest entry and the ratio of each state's size to the parameter's.
    """
    size, largest = len(matrix), np.abs(matrix).max(axis=0)
    rows = np.abs(piece.segment.at(STEP_PLACES)).max(axis=0)
    return np.hstack(
        [
            np.full((size, size), largest[:size].max()),
            np.maximum(largest[size:], rows[:, None] / units),
        ]
    )


def collocate(rate: MatrixFunction, piece: ArcPiece) -> tuple[np.ndarray, np.ndarray]:
    """The matrix of a piece by Gauss-Legendre collocation, and an estimate of its error: the size
    of the last terms of the Legendre series that is integrated. Both have the same shape.

    Raises
    ------
    OrbitError
        If the flow has no finite derivative at one of its points.
    """
    points, inner, weights, series = gauss()
    taus, whole = piece.start + piece.length * points, piece.length == piece.segment.length
    states = piece.segment.at(points) if whole else piece.segment(taus)
    pairs = zip((piece.t + taus).tolist(), states, strict=True)
    rates = np.array([rate(t, x) for t, x in pairs])[:, :, 1:]
    if not np.all(np.isfinite(rates)):
        raise _unbounded(piece)
    size, columns = rates.shape[1:]
    coupling = (-piece.length * inner)[:, None, :, None] * rates[:, :, None, :size]
    system = np.eye(STAGES * size) + coupling.reshape(STAGES * size, STAGES * size)
    slopes = np.linalg.solve(system, rates.reshape(STAGES * size, -1)).reshape(STAGES, -1)
    moved = (piece.length * (weights @ slopes)).reshape(size, columns)
    ripple = piece.length * np.abs(series[-2:] @ slopes).max(axis=0).reshape(size, columns)
    return np.eye(size, columns) + moved, ripple


@cache
def gauss() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Legendre collocation on [0, 1]: points, matrix of integrals to each point, weights of
    the integral to 1, and matrix from values to Legendre coefficients."""
    points, weights = legendre.leggauss(STAGES)
    values = np.linalg.inv(legendre.legvander(points, STAGES - 1))
    whole = [legendre.legint(row, lbnd=-1.0) for row in np.eye(STAGES)]
    inner = np.array([legendre.legval(points, row) for row in whole]).T @ values
    return 0.5 + 0.5 * points, 0.5 * inner, 0.5 * weights, values


# ---------------------------------------------------------------------------------------
# where a formula of the flow changes


def resolvable(segments: Sequence[Segment]) -> list[Segment]:
    """Merge steps too short to be evaluated on one side of a kink into the step before them.

    A method that closes in on a kink makes such steps.
    """
    kept: list[Segment] = []
    for segment in segments:
        if MOST_ASIDE * segment.length >= TOLD_APART * segment.end:
            kept.append(segment)
        elif kept:
            kept[-1] = kept[-1].cut(segment.end - kept[-1].start)
        elif segment.length > 0.0:
            kept.append(segment)
    return kept


def pieces(kinks: MatrixFunction | None, t: float, segment: Segment) -> list[ArcPiece]:
    """Cut a step where a formula of the flow changes inside it; None as ``kinks`` cuts nowhere."""
    if kinks is None:
        return [ArcPiece(t, segment, segment.start, segment.length)]
    known = kinks
    shares = STEP_PLACES.tolist()

    def values(share: float) -> np.ndarray:
        tau = segment.start + share * segment.length
        return known(t + tau, segment(tau))[:, 0]

    found, cuts = [values(share) for share in shares], [0.0, 1.0]
    for (a, low), (b, high) in pairwise(zip(shares, found, strict=True)):
        for k in np.flatnonzero(low * high < 0).tolist():
            at = _zero(values, k, a, b)
            if all(abs(at - cut) > KINK_SIDE for cut in cuts):
                cuts.append(at)
    ends = [segment.start + share * segment.length for share in sorted(cuts)[:-1]] + [segment.end]
    return [ArcPiece(t, segment, a, b - a) for a, b in pairwise(ends)]


def _zero(values: Callable[[float], np.ndarray], k: int, a: float, b: float) -> float:
    """A sign change of one component of ``values`` between ``a`` and ``b``, by bisection."""
    low = values(a)[k]
    while True:
        middle = 0.5 * (a + b)
        if not a < middle < b:
            return b
        a, b = (middle, b) if values(middle)[k] * low > 0 else (a, middle)


def middle(field: Flowing, t: float, segment: Segment) -> np.ndarray:
    """The absolute value of the flow in the middle of a step, element by element."""
    tau = segment.start + 0.5 * segment.length
    return np.abs(field.rhs(t + tau, segment(tau).tolist()))


def bend(
    kinks: MatrixFunction, field: Flowing, before: ArcPiece, after: ArcPiece, largest: np.ndarray
) -> np.ndarray | None:
    """The saltation matrix between two pieces of an arc, shape ``(n, n + q)``; None if the flow
    does not jump there. ``largest`` is the size of the flow along the arc."""
    there, here = before.flow(field, True), after.flow(field, False)
    jump = here[0] - there[0]
    if np.all(np.abs(jump) <= SAME_FLOW * np.maximum(largest, np.maximum(there[1], here[1]))):
        return None
    row = passing(kinks, before, there[0])
    return np.eye(len(jump), len(row)) - np.outer(jump, row)


def passing(kinks: MatrixFunction, piece: ArcPiece, flow: np.ndarray) -> np.ndarray:
    """The derivative of the time of the kink that ends a piece, by state and parameters.

    Raises
    ------
    OrbitError
        If there is no kink there, or several that neighbouring runs pass at different times.
    """
    t, found = piece.t + piece.end, kinks(piece.t + piece.end, piece.segment(piece.end))
    slopes, state = found[:, 2 : 2 + len(flow)], piece.segment(piece.end)
    rates, size = (
        found[:, 1] + slopes @ flow,
        np.abs(found[:, 1] * t) + np.abs(slopes * state).sum(1),
    )
    there = np.abs(found[:, 0]) < piece.beside * np.abs(rates) + KINK_ROUNDING * size
    rows = -found[there, 2:] / rates[there, None]
    if not len(rows) or np.any(np.abs(rows - rows[0]) > SAME_KINK_TIME * np.abs(rows[0])):
        raise OrbitError(
            f"t = {t!r}: a flow or a guard jumps there, at a time that does not depend smoothly on "
            "the state: there is no first variation"
        )
    first: np.ndarray = rows[0]
    return first
