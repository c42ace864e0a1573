"""The record of a run with delays, in pieces; where they do not join smoothly; windows on it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from math import ulp

import attrs
import numpy as np

from ..automaton.past import DEGREE
from ..clock import Instant
from ..scene import Field
from ..scene.windows import ROUNDING, TO_POWERS
from ..segment import Segment, from_values, integrals, nodes

#: Rounding of places at the ends of a piece.
INSIDE = 1e-12


@attrs.frozen(eq=False)
class Piece:
    """The record between two times.

    ``state(s, since)`` gives the states at ``s + since`` (an array), shape ``(len(since), n)``: in
    two parts, so that on a short window they do not drown in the rounding of the time. ``degree``
    is that of a polynomial, infinity where it is a function of the caller's. ``orders`` are those
    of a breaking point at the start of a piece of an earlier run.
    """

    start: float
    end: float
    state: Callable[[float, np.ndarray], np.ndarray]
    degree: float
    orders: np.ndarray | None = None


def piece_of(segment: Segment, t0: float, low: float, orders: np.ndarray | None = None) -> Piece:
    """A segment of an arc that starts at ``t0 + low``."""
    start, end = t0 + (low + segment.start), t0 + (low + segment.end)
    return Piece(start, end, partial(_on_segment, segment, t0, low), segment.degree, orders)


def _on_segment(segment: Segment, t0: float, low: float, s: float, since: np.ndarray) -> np.ndarray:
    middle, half = segment.start + 0.5 * segment.length, 0.5 * segment.length
    return chebyshev_sum(((((s - t0) - low) - middle) + since) / half, segment.coefficients)


def chebyshev_sum(places: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Chebyshev series at places, by their cosines: for a few places faster than a recurrence."""
    if np.abs(places).max() > 1.0 + INSIDE:
        return np.polynomial.chebyshev.chebvander(places, len(rows) - 1) @ rows
    angles = np.arccos(np.minimum(np.maximum(places, -1.0), 1.0))
    return np.cos(np.multiply.outer(angles, np.arange(len(rows)))) @ rows


def constant(x: np.ndarray, end: float) -> Piece:
    """The same state for all times before ``end``."""
    return Piece(-np.inf, end, partial(_always, x), 0)


def _always(x: np.ndarray, s: float, since: np.ndarray) -> np.ndarray:
    return np.broadcast_to(x, (len(since), len(x)))


def states(pieces: Sequence[Piece], s: float, since: np.ndarray) -> np.ndarray:
    """States at ``s + since`` from pieces in order; beyond them the outer ones go on."""
    if len(pieces) == 1:
        return pieces[0].state(s, since)
    starts = np.array([piece.start for piece in pieces[1:]]) - s
    which = np.searchsorted(starts, since, side="right")
    cuts = np.flatnonzero(np.diff(which)) + 1
    parts = np.split(since, cuts)
    firsts = which[[0, *cuts.tolist()]].tolist()
    return np.concatenate([pieces[i].state(s, p) for i, p in zip(firsts, parts, strict=True)])


def swept(field: Field, now: Instant, segment: Segment, count: int) -> Segment:
    """A segment brought nearer to the solution between its ends.

    Each sweep integrates the flow along it, which gains an order, and meets the end again.
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
    """The record: pieces in order of time, those no longer needed forgotten."""

    def __init__(self, pieces: Iterable[Piece] = ()) -> None:
        self._pieces = list(pieces)
        self._ends = [piece.end for piece in self._pieces]

    def add(self, piece: Piece) -> None:
        """Append a piece; one without length is left out."""
        if piece.end > piece.start:
            self._pieces.append(piece)
            self._ends.append(piece.end)

    def forget(self, before: float) -> None:
        """Drop what ends before a time, if that is the larger part."""
        count = bisect_left(self._ends, before)
        if count > 64 and 2 * count > len(self._pieces):
            del self._pieces[:count], self._ends[:count]

    def copy(self) -> Pieces:
        """One that grows by itself."""
        return Pieces(self._pieces)

    @property
    def last(self) -> Piece:
        """The latest piece."""
        return self._pieces[-1]

    def within(self, a: float, b: float, slack: float) -> list[Piece]:
        """Pieces that have a part between two times; the nearest if none has."""
        first = last = min(bisect_right(self._ends, a + slack), len(self._ends) - 1)
        while last < len(self._pieces) and self._pieces[last].start < b - slack:
            last += 1
        return self._pieces[first : max(last, first + 1)]


class Breaks:
    """Breaking points of the record: times in order, and the order of each element there.

    ``slack`` is the distance at which two times are one.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.orders: list[np.ndarray] = []

    def add(self, t: float, orders: np.ndarray) -> None:
        """A breaking point at the present time; those at one time are one."""
        if self.times and t <= self.times[-1] + slack_of(t):
            self.orders[-1] = np.minimum(self.orders[-1], orders)
        else:
            self.times.append(t)
            self.orders.append(orders)

    def forget(self, before: float) -> None:
        """Drop those before a time, if they are the larger part."""
        count = bisect_left(self.times, before)
        if count > 64 and 2 * count > len(self.times):
            del self.times[:count], self.orders[:count]

    def copy(self) -> Breaks:
        """One that grows by itself."""
        other = Breaks()
        other.times, other.orders = self.times.copy(), self.orders.copy()
        return other

    def after(self, s: float, slack: float) -> float:
        """The next after a time, infinity if there is none."""
        place = bisect_right(self.times, s + slack)
        return self.times[place] if place < len(self.times) else np.inf

    def until(self, s: float, slack: float) -> float:
        """The last up to a time, minus infinity if there is none."""
        place = bisect_right(self.times, s + slack)
        return self.times[place - 1] if place else -np.inf

    def before(self, s: float, slack: float) -> float:
        """The last before a time, minus infinity if there is none."""
        place = bisect_left(self.times, s - slack)
        return self.times[place - 1] if place else -np.inf

    def at(self, s: float, slack: float) -> np.ndarray | None:
        """Orders at a time, the least of those that are one; None if there is none."""
        first, last = bisect_left(self.times, s - slack), bisect_right(self.times, s + slack)
        return np.min(self.orders[first:last], axis=0) if first < last else None


def slack_of(*times: float) -> float:
    """Times nearer than this are one, if sums of such times are rounded."""
    return 8.0 * ulp(max(map(abs, times)))


@attrs.define(eq=False)
class Window:
    """A part of the record as one polynomial.

    ``values`` are the states at its nodes, ``guess`` says which of them are guessed; ``noise`` is
    what the rounding of times makes of them.
    """

    a: float
    b: float
    values: np.ndarray
    guess: np.ndarray
    noise: np.ndarray

    @property
    def since(self) -> np.ndarray:
        """Nodes, counted from the start."""
        return (self.b - self.a) * nodes(DEGREE)

    def shown(self, since: np.ndarray) -> np.ndarray:
        """What the polynomial shows at times counted from the start."""
        return chebyshev_sum(2.0 * since / (self.b - self.a) - 1.0, self.series)

    @property
    def series(self) -> np.ndarray:
        """Chebyshev coefficients, one row each."""
        return from_values(DEGREE) @ self.values

    def arrays(self) -> list[np.ndarray]:
        """Frame and coefficients, as the trace takes them; what is rounding is left out.

        (On a short window the derivatives of rounding are large.)
        """
        frame = np.array([0.5 * self.a + 0.5 * self.b, 0.5 * (self.b - self.a)])
        series = self.series
        noise = ROUNDING * np.abs(self.values).max(axis=0) + self.noise
        heard = np.maximum.accumulate(np.abs(series)[::-1] > noise, axis=0)[::-1]
        return [frame, TO_POWERS @ np.where(heard, series, 0.0)]
