"""The record of a run with delays: its pieces, its breaking points, and windows on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import partial
from math import isfinite, ulp
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..lowering import Field
from ..rules.places import BREAKS, PIECES_KEPT, PIECES_KNOWN, WINDOW_DEGREE
from ..rules.record import BEGIN, UP_TO
from ..rules.windows import WINDOW_ROUNDING
from ..segment import Segment, from_values, integrals, nodes
from ..solvers.taylor_backend import HIGHEST
from ..trajectory.clock import Instant
from .windows import TO_POWERS

if TYPE_CHECKING:
    from ..automaton.shapes import (
        IntegerMatrix,
        Integers,
        Matrix,
        Numbers,
        StateVector,
        StateVectors,
    )

#: Tolerated excess of the local coordinate over 1 at the ends of a piece.
INSIDE = 1e-12

#: Initial capacity for pieces and breaking points; columns of a piece's row; and most coefficients
#: of a piece, which are those of steps of the highest order.
FIRST_ROOM, COLUMNS, WIDTH = 256, 6, HIGHEST + 1


#: The share of a function's change over a window that is one between neighbouring places, and that
#: is still there between neighbouring floats, if it jumps.
JUMP_SHARE = 0.5


@attrs.frozen(eq=False)
class Piece:
    """The record between the times ``start`` and ``end``.

    Attributes
    ----------
    state : callable ``(s, since)``
        The states at ``s + since`` (an array), shape ``(len(since), n)``. The time is split in two
        parts so that short windows are not lost in its rounding.
    degree : float
        The degree of the polynomial; infinity for a function of the caller.
    orders : array or None
        In a piece of an earlier run: the order of the breaking point at its start, for each state
        element.
    rows : array, shape (degree + 1, n), or None
        Chebyshev coefficients about the middle of the piece.
    frame : tuple
        The reference time in two floats, then the midpoint relative to it, and half the length.
    mode : str
        In a piece of an earlier run of the model: the mode in which the jump at its start stays, if
        it does.
    """

    start: float
    end: float
    state: Callable[[float, np.ndarray], np.ndarray]
    degree: float
    orders: np.ndarray | None = None
    rows: Matrix | None = None
    frame: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    mode: str = ""


def piece_of(segment: Segment, t0: float, low: float, orders: np.ndarray | None = None) -> Piece:
    """The piece of a segment, whose arc starts at ``t0 + low``."""
    start, end = t0 + (low + segment.start), t0 + (low + segment.end)
    frame = t0, low, segment.start + 0.5 * segment.length, 0.5 * segment.length
    return _polynomial(start, end, frame, segment.coefficients, orders)


def _polynomial(
    start: float,
    end: float,
    frame: tuple[float, ...],
    rows: Matrix,
    orders: np.ndarray | None = None,
) -> Piece:
    shown = partial(_shown, frame, rows)
    return Piece(start, end, shown, len(rows) - 1, orders, rows, frame)


def _shown(frame: tuple[float, ...], rows: Matrix, s: float, since: Numbers) -> Matrix:
    t0, low, middle, half = frame
    return chebyshev_sum(((((s - t0) - low) - middle) + since) / half, rows)


def chebyshev_sum(places: Numbers, rows: Matrix) -> Matrix:
    """Values of Chebyshev series at places, shape ``(len(places), n)``. Inside [-1, 1] they are
    sums of cosines, which for few places is faster than a recurrence."""
    if np.abs(places).max() > 1.0 + INSIDE:
        return np.polynomial.chebyshev.chebvander(places, len(rows) - 1) @ rows
    angles = np.arccos(np.minimum(np.maximum(places, -1.0), 1.0))
    return np.cos(np.multiply.outer(angles, np.arange(len(rows)))) @ rows


def constant(x: StateVector, end: float) -> Piece:
    """The piece with the constant state ``x`` at all times before ``end``."""
    return Piece(-np.inf, end, partial(_always, x), 0, rows=x[None])


def _always(x: StateVector, s: float, since: Numbers) -> StateVectors:
    return np.broadcast_to(x, (len(since), len(x)))


def _between(whole: Piece, first: float, last: float, s: float, since: Numbers) -> Matrix:
    """A function's states from one time to another, and no earlier or later ones."""
    return whole.state(0.0, np.clip(s + since, first, last))


def jump_of(piece: Piece, times: Numbers, values: Matrix) -> tuple[float, Integers]:
    """The place of a jump of a caller's function, of which the values at some times are given, as
    bisection shows: the first time behind it, infinite if there is none, and the order of the
    breaking point for each element.

    A function that is steep, but does not jump, is the less different the nearer the places.
    """
    none = np.inf, np.ones(values.shape[1], dtype=int)
    steps, spread = np.abs(np.diff(values, axis=0)), np.ptp(values, axis=0)
    shares = np.divide(steps, spread, out=np.zeros_like(steps), where=spread > 0.0)
    if not shares.max(initial=0.0) >= JUMP_SHARE:
        return none
    k, element = np.unravel_index(np.argmax(shares), shares.shape)
    low, high = times[k], times[k + 1]
    before, behind = values[k], values[k + 1]
    least = JUMP_SHARE * steps[k, element]
    while low < (middle := 0.5 * low + 0.5 * high) < high:
        there = piece.state(middle, np.zeros(1))[0]
        if abs(there[element] - before[element]) >= abs(behind[element] - there[element]):
            high, behind = middle, there
        else:
            low, before = middle, there
        if not abs(behind[element] - before[element]) >= least:
            return none
    jumps = np.abs(behind - before) > JUMP_SHARE * steps[k]
    return float(high), np.where(jumps, 0, 1)


def states(pieces: Sequence[Piece], s: float, since: Numbers) -> Matrix:
    """States at ``s + since``, shape ``(len(since), n)``, from pieces in order of time; the outer
    pieces are extrapolated."""
    if len(pieces) == 1:
        return pieces[0].state(s, since)
    starts = np.array([piece.start for piece in pieces[1:]]) - s
    which = np.searchsorted(starts, since, side="right")
    cuts = np.flatnonzero(np.diff(which)) + 1
    parts = np.split(since, cuts)
    firsts = which[[0, *cuts.tolist()]].tolist()
    return np.concatenate([pieces[i].state(s, p) for i, p in zip(firsts, parts, strict=True)])


def swept(field: Field, now: Instant, segment: Segment, count: int) -> Segment:
    """A segment made more accurate between its ends by ``count`` Picard iterations.

    Each of them integrates the flow along the segment, which raises the order by one. A linear term
    is then added so that the end of the step is met.
    """
    degree = segment.degree + count
    places, h = nodes(degree), segment.length
    times = (now.t + (now.low + segment.start) + h * places).tolist()
    values = segment.at(places)
    first, last = values[0], values[-1]
    for _ in range(count):
        states = zip(times, values.tolist(), strict=True)
        values = first + h * (integrals(degree) @ np.array([field.rhs(t, x) for t, x in states]))
        values += places[:, None] * (last - values[-1])
    return Segment(segment.start, h, from_values(degree) @ values)


class Pieces:
    """The record: pieces in order of time, without those no longer needed.

    They are stored in arrays to which the rules' loop appends; their number is in ``ints``.
    """

    def __init__(self, ints: Integers, pieces: Sequence[Piece], dimension: int) -> None:
        self.ints, self.dimension = ints, dimension
        self.spans = np.empty((FIRST_ROOM, COLUMNS))
        self.degrees = np.empty(FIRST_ROOM, dtype=np.int64)
        self.rows = np.empty((FIRST_ROOM * dimension, WIDTH))
        self._others: dict[int, Piece] = {}
        self.forget_all(pieces)

    def forget_all(self, pieces: Iterable[Piece]) -> None:
        """Replace all pieces."""
        self.ints[PIECES_KEPT], self._others = 0, {}
        for piece in pieces:
            self.add(piece)

    @property
    def count(self) -> int:
        """Number of pieces."""
        return int(self.ints[PIECES_KEPT])

    @property
    def full(self) -> bool:
        """Whether there is no room for another piece."""
        return self.count == len(self.degrees)

    @property
    def ends(self) -> Numbers:
        """End times of the pieces."""
        return self.spans[: self.count, UP_TO]

    def add(self, piece: Piece) -> None:
        """Append a piece, unless its length is zero."""
        if not piece.end > piece.start:
            return
        place, n = self.count, self.dimension
        if self.full:
            self.grow()
        self.spans[place] = (piece.start, piece.end, *piece.frame)
        self.degrees[place] = -1
        if piece.rows is None or len(piece.rows) > WIDTH:
            self._others[place] = piece
        else:
            self.degrees[place] = len(piece.rows) - 1
            self.rows[place * n : place * n + n, : len(piece.rows)] = piece.rows.T
        self.ints[PIECES_KEPT] += 1

    def grow(self) -> None:
        """Double the capacity."""
        held = self.spans, self.degrees, self.rows
        self.spans, self.degrees, self.rows = (np.concatenate([a, np.empty_like(a)]) for a in held)

    def split(self, place: int, t: float) -> None:
        """Divide the piece at index ``place``, a function of the caller's that jumps at ``t``. What
        it is at that one time, as ``sign`` is 0 there, belongs to neither part."""
        whole, aside = self._others.pop(place), 2.0 * ulp(t)
        if self.full:
            self.grow()
        kept, n = self.count, self.dimension
        for array, size in ((self.spans, 1), (self.degrees, 1), (self.rows, n)):
            array[(place + 1) * size : (kept + 1) * size] = array[place * size : kept * size].copy()
        self._others = {k + (k > place): piece for k, piece in self._others.items()}
        earlier = partial(_between, whole, -np.inf, t - aside)
        later = partial(_between, whole, t + aside, np.inf)
        self._others[place] = attrs.evolve(whole, end=t, state=earlier)
        self._others[place + 1] = attrs.evolve(whole, start=t, state=later)
        self.spans[place, UP_TO] = self.spans[place + 1, BEGIN] = t
        self.ints[PIECES_KEPT] += 1
        self.ints[PIECES_KNOWN] += 1

    def forget(self, before: float) -> None:
        """Drop pieces that end before a time, if they are the majority."""
        count, kept = int(np.searchsorted(self.ends, before)), self.count
        if count > 64 and 2 * count > kept:
            self._drop(count, kept)

    def _drop(self, count: int, kept: int) -> None:
        n = self.dimension
        for array, size in ((self.spans, 1), (self.degrees, 1), (self.rows, n)):
            array[: (kept - count) * size] = array[count * size : kept * size].copy()
        self._others = {k - count: p for k, p in self._others.items() if k >= count}
        self.ints[PIECES_KEPT] = kept - count
        self.ints[PIECES_KNOWN] -= count

    def back_to(self, t: float) -> None:
        """Drop pieces that begin at time ``t`` or later."""
        begins = self.spans[: self.count, 0]
        self.ints[PIECES_KEPT] = int(np.searchsorted(begins, t - 0.5 * slack_of(t)))

    def copy(self, ints: np.ndarray) -> Pieces:
        """An independent copy."""
        other = copy(self)
        other.ints, other._others = ints, dict(self._others)
        other.spans, other.degrees = self.spans.copy(), self.degrees.copy()
        other.rows = self.rows.copy()
        return other

    def piece(self, place: int) -> Piece:
        """The piece at index ``place``."""
        if self.degrees[place] < 0:
            return self._others[place]
        start, end, *frame = self.spans[place].tolist()
        n, degree = self.dimension, self.degrees[place]
        rows = self.rows[place * n : place * n + n, : degree + 1].T
        if not isfinite(start):
            return constant(rows[0], end)
        return _polynomial(start, end, tuple(frame), rows)

    @property
    def last(self) -> Piece:
        """The latest piece."""
        return self.piece(self.count - 1)


class Breaks:
    """Breaking points of the record: times in order, and the order of each state element there.

    They are stored in arrays to which the rules' loop appends.
    """

    def __init__(self, ints: Integers, dimension: int) -> None:
        self.ints = ints
        self._times = np.empty(FIRST_ROOM)
        self._orders = np.empty((FIRST_ROOM, dimension), dtype=np.int64)
        self.ints[BREAKS] = 0

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and orders, unused capacity included."""
        return self._times, self._orders

    @property
    def times(self) -> Numbers:
        """The times."""
        return self._times[: self.ints[BREAKS]]

    def add(self, t: float, orders: Integers) -> None:
        """Append a breaking point; points at the same time are merged."""
        place = int(self.ints[BREAKS])
        if place and t <= self._times[place - 1] + slack_of(t):
            self._orders[place - 1] = np.minimum(self._orders[place - 1], orders)
            return
        self.reserve()
        self._times[place], self._orders[place] = t, orders
        self.ints[BREAKS] += 1

    def insert(self, t: float, orders: Integers) -> None:
        """Add a breaking point in its place."""
        place, count = int(np.searchsorted(self.times, t)), int(self.ints[BREAKS])
        self.reserve()
        for array in self.arrays:
            array[place + 1 : count + 1] = array[place:count].copy()
        self._times[place], self._orders[place] = t, orders
        self.ints[BREAKS] += 1

    def reserve(self) -> None:
        """Have room for one more."""
        if self.ints[BREAKS] == len(self._times):
            self.grow()

    def grow(self) -> None:
        """Double the capacity."""
        self._times = np.concatenate([self._times, np.empty_like(self._times)])
        self._orders = np.concatenate([self._orders, np.empty_like(self._orders)])

    def known(self) -> tuple[Numbers, IntegerMatrix]:
        """Copies of the times and the orders."""
        return self.times.copy(), self._orders[: self.ints[BREAKS]].copy()

    def forget(self, before: float) -> None:
        """Drop points before a time, if they are the majority."""
        count, kept = int(np.searchsorted(self.times, before)), int(self.ints[BREAKS])
        if count > 64 and 2 * count > kept:
            for array in self.arrays:
                array[: kept - count] = array[count:kept].copy()
            self.ints[BREAKS] = kept - count

    def copy(self, ints: np.ndarray) -> Breaks:
        """An independent copy."""
        other = copy(self)
        other.ints, other._times, other._orders = ints, self._times.copy(), self._orders.copy()
        return other


def slack_of(*times: float) -> float:
    """Difference below which times are equal, up to the rounding of sums of them."""
    return 8.0 * ulp(max(map(abs, times)))


def window_on(a: float, b: float, values: Matrix) -> list[np.ndarray]:
    """The window from ``a`` to ``b`` with given states at its nodes.

    Returns its frame (midpoint, half-length) and its coefficients in powers of the local
    coordinate. Coefficients at rounding level are dropped, as their derivatives would be large on a
    short window.
    """
    frame = np.array([0.5 * a + 0.5 * b, 0.5 * (b - a)])
    series = from_values(WINDOW_DEGREE) @ values
    noise = WINDOW_ROUNDING * np.abs(values).max(axis=0)
    heard = np.maximum.accumulate(np.abs(series)[::-1] > noise, axis=0)[::-1]
    return [frame, TO_POWERS @ np.where(heard, series, 0.0)]
