"""The variation of the record of a run with delays.

A perturbation ``d`` of the record obeys, along an arc, ::

    d' = f_x d + f_p dp + sum of f_k d(t - lag_k)

which is solved by collocation at Gauss points; delayed values come from earlier pieces of ``d``.
(The delayed state depends on the lag, so ``f_x`` and ``f_p`` contain ``-f_k x'(t - lag_k)`` times
the variation of the lag.) If a jump of the record comes later by ``s``, the delayed term jumps
later by ``ds = s`` plus the growth of its lag. If the flow then jumps from ``f-`` to ``f+``, the
perturbation becomes ``d + (f- - f+) ds``.

With ``memory="restart"`` a flow sees only the state after the last jump and what follows. See
``docs/notes/gradients.md``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.legendre import leggauss

from ..errors import OrbitError
from ..rules.limits import KINK_SIDE, SAME_FLOW
from ..segment import from_values, nodes
from ..trajectory.arcs import Arc
from .arcs import COLLOCATION_TOLERANCE, ArcPiece, bend, middle, pieces, resolvable
from .derivatives import MatrixFunction
from .walk import Walk

if TYPE_CHECKING:
    from ..automaton.shapes import Matrices, Matrix, Numbers

#: Degree of the collocation on a step.
COLLOCATION_DEGREE = 14

#: Most halvings of a step.
DELAYED_HALVINGS = 6

#: Number of lags through which breaking points are followed.
GENERATIONS = 6

#: Relative difference below which times are equal; the second one applies to lags that depend on
#: time or state.
SAME_TIME, SAME_MOVING_TIME = 1e-13, 1e-11


@attrs.frozen(eq=False)
class Strand:
    """A perturbation from time ``a`` to ``b``: values at Chebyshev points, shape
    ``(degree + 1, n, m)``. A call returns it at given times, shape ``(k, n, m)``."""

    a: float
    b: float
    values: Matrices

    def __call__(self, times: Numbers) -> Matrices:
        degree = len(self.values) - 1
        places = 2.0 * (times - self.a) / (self.b - self.a) - 1.0
        weights = chebyshev.chebvander(places, degree) @ from_values(degree)
        return np.tensordot(weights, self.values, 1)


@attrs.frozen(eq=False)
class Shift:
    """A jump of the record; ``row``, of shape (m,), is the variation of its time ``t``."""

    t: float
    before: Numbers
    after: Numbers
    row: Numbers

    def shows(self, elements: Iterable[int]) -> bool:
        """Whether any of the given elements jumps."""
        return any(self.before[e] != self.after[e] for e in elements)


def descendants(times: Iterable[float], lags: Sequence[float], last: float) -> list[float]:
    """Breaking points until ``last``: given times, and their sums with 1 to 6 lags."""
    found = now = set(times)
    for _ in range(GENERATIONS):
        now = {t + lag for t in now for lag in lags if lag > 0 and t + lag <= last}
        found = found | now
    return distinct(t for t in found if t <= last)


def distinct(times: Iterable[float]) -> list[float]:
    """Times in order, nearly equal ones merged."""
    found: list[float] = []
    for t in sorted(times):
        if not found or t - found[-1] > SAME_TIME * max(1.0, abs(t)):
            found.append(t)
    return found


class PastVariation:
    """The variation of a run's record, as a linear function of ``m`` numbers.

    Attributes
    ----------
    given : array, shape (q, m)
        Variation of the parameters, if they have columns.
    units : array, shape (m,)
        Scale of each number.
    strands, shifts
        Variation of the record so far, and of the times of its jumps.
    fresh : array, shape (n, m)
        Variation of the state after the last jump.
    """

    def __init__(
        self,
        walk: Walk,
        given: Matrix,
        units: Numbers,
        strands: Sequence[Strand],
        shifts: Sequence[Shift] = (),
        breaks: Iterable[float] = (),
    ) -> None:
        self.walk, self.given, self.units = walk, given, units
        self.sight, self.size, self.end = walk.course.sight, walk.size, walk.course.parts[-1].t1
        self.strands, self.shifts = list(strands), list(shifts)
        self._ends = [strand.b for strand in strands]
        self.fresh = self.strands[-1].values[-1]
        self.breaks: list[float] = []
        self.broken([walk.course.parts[0].t0, *breaks])

    @property
    def restarts(self) -> bool:
        """Whether jumps erase the past."""
        return self.walk.restarts

    def broken(self, times: Iterable[float]) -> None:
        """Add breaking points of the record, and those that follow through the lags."""
        self.breaks = distinct([*self.breaks, *descendants(times, self.sight.lags, self.end)])

    def add(self, strand: Strand) -> None:
        """Append the next strand."""
        self.strands.append(strand)
        self._ends.append(strand.b)

    def jumped(self, shift: Shift, fresh: Matrix) -> None:
        """Record a jump, after which the variation of the state is ``fresh``."""
        self.fresh = fresh
        if self.restarts:
            self.shifts, self.strands = [], [Strand(shift.t - 1.0, shift.t, fresh[None])]
            self._ends = [shift.t]
        else:
            self.shifts.append(shift)
        self.broken([shift.t])

    # -- delayed terms ----------------------------------------------------------------------

    def at(self, times: Numbers, near: Numbers) -> Matrices:
        """The perturbation at some times, shape ``(k, n, m)``; each from the strand that covers the
        corresponding time in ``near``, which selects a side at a jump."""
        found = np.empty((len(times), *self.fresh.shape))
        which = np.array([min(bisect_left(self._ends, t), len(self._ends) - 1) for t in near])
        for place in np.unique(which).tolist():
            found[which == place] = self.strands[place](times[which == place])
        return found

    def within(self, times: Numbers, low: float, high: float) -> Matrices:
        """The perturbation at ``times``, from the strands between ``low`` and ``high`` only."""
        room = KINK_SIDE * max(high - low, 0.0)
        return self.at(times, np.clip(times, low + room, high - room))

    def shown(self, index: int, t: float, near: float, now: Matrix) -> Matrix:
        """The perturbations of the delayed states of all lags at ``t``, stacked; at a jump, on the
        side of the nearby time ``near``."""
        pairs = zip(self.sight.places(index, t), self.sight.places(index, near), strict=True)
        return np.vstack(
            [
                np.zeros((0, now.shape[1])),
                *(now if a >= t else self.at(np.array([a]), np.array([b]))[0] for a, b in pairs),
            ]
        )

    def changed(self, index: int, t: float, near: float, now: Matrix) -> Matrix:
        """The perturbations of the state, of the delayed states and of the parameters, stacked."""
        return np.vstack([now, self.shown(index, t, near, now), self.given])

    # -- jumps of delayed terms -------------------------------------------------------------

    def seen(self, index: int, t: float) -> Iterator[tuple[int, Shift]]:
        """The jumps of the record that a lag meets at time ``t``, each with the lag's number."""
        code = self.sight.scene.code
        for k, place in enumerate(self.sight.places(index, t)):
            room = (SAME_MOVING_TIME if code.moving[k] else SAME_TIME) * max(1.0, abs(t))
            for shift in self.shifts:
                if place < t and abs(shift.t - place) <= room and shift.shows(code.seen[k]):
                    yield k, shift

    def arrives(self, index: int, t: float) -> bool:
        """Whether a lag meets a jump of the record at time ``t``."""
        return next(self.seen(index, t), None) is not None

    def arrival(self, index: int, arc: Arc, piece: ArcPiece, now: Matrix) -> Numbers:
        """The variation, shape (m,), of the time at which a lag meets a jump at a piece's end.

        Raises
        ------
        OrbitError
            If lags meet several jumps there, and neighbouring runs meet them at different times.
        """
        t, near = piece.t + piece.end, piece.t + piece.inside(True)
        scene, of = self.walk.look(index, near)
        x, field = piece.segment(piece.end), scene.field(arc.mode)
        flow, change = np.array(field.rhs(t, x.tolist())), self.changed(index, t, near, now)
        rows = []
        for k, shift in self.seen(index, t):
            lag = of.lag(k, field)(t, x)[0]
            rate = 1.0 - lag[0] - lag[1 : 1 + self.size] @ flow
            rows.append((shift.row + lag[1:] @ change) / rate)
        apart = [np.abs(row - rows[0]) > SAME_FLOW * np.abs(rows[0]) for row in rows]
        if np.any(apart):
            raise OrbitError(
                f"{self.walk.model}, t = {t:.9g}: two jumps of the past are seen there; which is "
                "first differs between neighbours: there is no derivative"
            )
        return rows[0]

    def turned(self, index: int, arc: Arc, piece: ArcPiece) -> Numbers:
        """The jump ``f- - f+`` of the flow at the end of a piece where a lag meets a jump of the
        record; zeros if it is at rounding level."""
        t, x = piece.t + piece.end, piece.segment(piece.end).tolist()
        before, after = (
            np.array(self.walk.look(index, t + s)[0].field(arc.mode).rhs(t, x))
            for s in (-piece.beside, piece.beside)
        )
        change = before - after
        large = np.abs(change).max() > SAME_FLOW * (np.abs(before).max() + np.abs(after).max())
        return change if large else np.zeros(self.size)

    # -- along an arc -----------------------------------------------------------------------

    def along(self, index: int, arc: Arc, now: Matrix) -> Matrix:
        """Carry a perturbation along an arc, up to a jump of a delayed term at its end."""
        field, last = _Seeing(self.walk, index, arc), None
        kinks = field.kinks if field.changes else None
        largest = np.zeros(self.size)
        if kinks is not None and arc.segments:
            largest = np.max([middle(field, arc.t0 + arc.low, s) for s in arc.segments], axis=0)
        for piece in self._pieces(arc, kinks):
            if last is not None:
                now = self._passed(index, arc, field, last, piece, largest, now)
            now = self._step(
                index, arc, piece.t + piece.start, piece.t + piece.end, now, DELAYED_HALVINGS
            )
            last = piece
        return now

    def _pieces(self, arc: Arc, kinks: MatrixFunction | None) -> Iterator[ArcPiece]:
        """The steps of an arc, cut at breaking points and where a formula of the flow changes."""
        t = arc.t0 + arc.low
        stops = [*self.breaks, *(shift.t + g for shift in self.shifts for g in self.sight.lags)]
        for segment in arc.segments if kinks is None else resolvable(arc.segments):
            for piece in pieces(kinks, t, segment):
                room = SAME_TIME * max(1.0, abs(t + piece.end))
                inner = [s - t for s in stops if piece.start + room < s - t < piece.end - room]
                ends = [piece.start, *distinct(inner), piece.end]
                yield from (ArcPiece(t, segment, a, b - a) for a, b in pairwise(ends))

    def _passed(
        self,
        index: int,
        arc: Arc,
        field: _Seeing,
        before: ArcPiece,
        after: ArcPiece,
        largest: Numbers,
        now: Matrix,
    ) -> Matrix:
        """The perturbation after the jump of a delayed term, or the kink, between two pieces."""
        t = before.t + before.end
        if self.arrives(index, t):
            fall = self.turned(index, arc, before)
            if fall.any():
                now = now + np.outer(fall, self.arrival(index, arc, before, now))
        elif field.changes:
            turn = bend(field.kinks, field, before, after, largest)
            if turn is not None:
                now = turn @ self.changed(index, t, before.t + before.inside(True), now)
        return now

    def _step(self, index: int, arc: Arc, a: float, b: float, now: Matrix, depth: int) -> Matrix:
        """Carry the perturbation over a step, or over its halves if it is not resolved."""
        if not b > a:  # only rounding of the time
            return now
        values, states = self._collocated(index, arc, a, b, now)
        sizes = np.abs(np.tensordot(from_values(COLLOCATION_DEGREE), values, 1))
        least = np.abs(states).max() / self.units
        allowed = COLLOCATION_TOLERANCE * np.maximum(sizes.max(axis=(0, 1)), least)
        if depth and np.any(sizes[-2:].max(axis=(0, 1)) > allowed):
            middle = 0.5 * (a + b)
            now = self._step(index, arc, a, middle, now, depth - 1)
            return self._step(index, arc, middle, b, now, depth - 1)
        self.add(Strand(a, b, values))
        return values[-1]

    def _collocated(
        self, index: int, arc: Arc, a: float, b: float, now: Matrix
    ) -> tuple[np.ndarray, np.ndarray]:
        """The perturbation at a step's Chebyshev points, and states at its Gauss points."""
        size, (points, inner, whole) = self.size, _gauss()
        times, count = a + (b - a) * points, COLLOCATION_DEGREE + 1
        states = arc.local((times - arc.t0) - arc.low)
        places = np.array([self.sight.places(index, t) for t in times.tolist()])
        pairs, field = zip(times.tolist(), states, strict=True), self.walk.scene.field(arc.mode)
        looks = [(self.walk.look(index, t)[1], t, x) for t, x in pairs]
        rates = np.array([of.flow(field)(t, x)[:, 1:] for of, t, x in looks])
        unknown = rates[:, :, None, :size] * inner[:, None, :, None]
        known = rates[:, :, size * (1 + places.shape[1]) :] @ self.given
        for k, at in enumerate(places.T):
            seen = rates[:, :, size * (1 + k) : size * (2 + k)]
            own = at > a
            within = chebyshev.chebvander(2.0 * (at - a) / (b - a) - 1.0, COLLOCATION_DEGREE)
            weights = np.where(own[:, None], within @ from_values(COLLOCATION_DEGREE), 0.0)
            unknown += seen[:, :, None, :] * weights[:, None, :, None]
            if not own.all():
                known[~own] += seen[~own] @ self.at(at[~own], at[~own])
        system = (a - b) * np.tensordot(whole, unknown, 1).reshape(count * size, -1)
        right = now + (b - a) * np.tensordot(whole, known, 1)
        system[np.diag_indices(count * size)] += 1.0
        found = np.linalg.solve(system, right.reshape(count * size, -1)).reshape(right.shape)
        return found, states


@cache
def _gauss() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss points on [0, 1]; the matrix from values at Chebyshev points to values at Gauss points;
    and the matrix from values at Gauss points to integrals up to the Chebyshev points."""
    points = 0.5 + 0.5 * leggauss(COLLOCATION_DEGREE)[0]
    places = 2.0 * points - 1.0
    inner = chebyshev.chebvander(places, COLLOCATION_DEGREE) @ from_values(COLLOCATION_DEGREE)
    sums = [0.5 * chebyshev.chebint(row, lbnd=-1.0) for row in np.eye(COLLOCATION_DEGREE)]
    ends = np.array(
        [chebyshev.chebval(2.0 * nodes(COLLOCATION_DEGREE) - 1.0, row) for row in sums]
    ).T
    return points, inner, ends @ np.linalg.inv(chebyshev.chebvander(places, COLLOCATION_DEGREE - 1))


class _Seeing:
    """The flow of an arc, with the delayed terms that it had at each time."""

    def __init__(self, walk: Walk, index: int, arc: Arc) -> None:
        self.walk, self.index, self.arc = walk, index, arc
        self.changes = walk.scene.field(arc.mode).changes

    def rhs(self, t: float, x: list[float]) -> Any:
        """The flow."""
        return self.walk.look(self.index, t)[0].field(self.arc.mode).rhs(t, x)

    def kinks(self, t: float, x: np.ndarray) -> np.ndarray:
        """Value and derivatives of each deciding function of the flow."""
        of, field = self.walk.look(self.index, t)[1], self.walk.scene.field(self.arc.mode)
        return of.kinks(("flow", field.name), field, lambda g: g.flow(bool(field.held)))(t, x)
