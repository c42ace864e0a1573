"""Newton's method for orbits of models with delays whose record is kept through jumps.

The record over the longest lag determines the future. The unknowns are its values at Chebyshev
points of the pieces between its breaking points, and the times of the jumps that delays see. A
Newton step changes them. The changed record is no solution of the model; after simulating for at
least the longest lag, the record is one, with its breaking points in the right places.

The multipliers are computed on a second, finer set of points as well, which estimates their errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..delay.hindsight import Hindsight, PastRecord
from ..delay.history import Before
from ..delay.pieces import Piece, constant
from ..errors import OptionError, OrbitError
from ..result import Trajectory
from ..segment import from_values, nodes
from ..trajectory.arcs import Arc
from ..trajectory.log import Log
from ..variation import Carried, Shift, Strand, descendants, distinct
from .delayed import carried
from .shooting import SHORTEST_ARC, Description, Guess, Shooting, Shot

if TYPE_CHECKING:
    from ..automaton.shapes import ComplexNumbers, Matrices, Matrix, Numbers, StateVector

#: Degree of the polynomial on each piece of the record, with the normal and the finer points.
RECORD_DEGREE, FINE_DEGREE = 18, 26

#: Pieces are halved until their last coefficients are this small (relative); and most halvings.
RECORD_TOLERANCE, RECORD_HALVINGS = 1e-9, 4

#: Relative difference of adjacent pieces, where they meet, above which the record jumps there.
RECORD_JUMP = 1e-10

#: Distance from the ends of a piece, relative to its length, that decides on which side of a
#: breaking point the record is evaluated.
RECORD_SIDE = 1e-7

#: Multipliers that differ by more than this between the two sets of points are not reported.
KNOWN_MULTIPLIER = 1e-5

#: Largest absolute value of a multiplier that may be left out of the report.
HIDDEN_MULTIPLIER = 0.5


@attrs.frozen(eq=False)
class Leap:
    """A jump of the record in an element that delays see."""

    t: float
    before: StateVector
    after: StateVector


def leaps(record: PastRecord, low: float, high: float, seen: Sequence[int]) -> list[Leap]:
    """The jumps of the record between two times, in the elements ``seen``."""
    found = []
    for earlier, later in pairwise(record.pieces):
        t = later.start
        if low < t < high:
            before, after = (piece.state(t, np.zeros(1))[0] for piece in (earlier, later))
            size = np.maximum(np.abs(before), np.abs(after)) + 1.0
            if np.any((np.abs(before - after) > RECORD_JUMP * size)[list(seen)]):
                found.append(Leap(t, before, after))
    return found


@attrs.frozen(eq=False)
class Frame:
    """The pieces of a record before a given time, and the points on them.

    Attributes
    ----------
    pieces : list of (float, float)
        Start and end of each piece, in order; the last one ends at the given time.
    leaps : list of Leap
        Jumps that delays see; each is at the end of a piece.
    degree : int
        Degree of the polynomial on each piece.
    """

    pieces: list[tuple[float, float]]
    leaps: list[Leap]
    degree: int

    @property
    def points(self) -> list[np.ndarray]:
        """Times of the Chebyshev points, an array for each piece."""
        return [a + (b - a) * nodes(self.degree) for a, b in self.pieces]

    def bounds(self, later: float, ends: Sequence[Leap]) -> list[tuple[float, float]]:
        """The pieces shifted by ``later``; times of jumps move to those in ``ends``."""
        moved = {leap.t: end.t for leap, end in zip(self.leaps, ends, strict=True)}
        return [(moved.get(a, a + later), moved.get(b, b + later)) for a, b in self.pieces]

    def states(self, record: PastRecord, later: float, ends: Sequence[Leap]) -> Matrices:
        """A record's states at the points shifted by ``later``, shape ``(pieces, degree + 1, n)``;
        each from the shifted piece of :meth:`bounds`."""
        found = []
        for times, (a, b) in zip(self.points, self.bounds(later, ends), strict=True):
            room = RECORD_SIDE * (b - a)
            found.append(record.states(times + later, a + room, b - room))
        return np.array(found)

    def slopes(self, states: Matrices) -> Matrices:
        """Time derivatives at the points of the polynomials through values there."""
        vander = chebyshev.chebvander(2.0 * nodes(self.degree) - 1.0, self.degree - 1)
        matrix = vander @ chebyshev.chebder(from_values(self.degree))
        lengths = np.array([b - a for a, b in self.pieces])
        slopes: np.ndarray = 2.0 * np.tensordot(states, matrix, (1, 1)).transpose(0, 2, 1)
        return slopes / lengths[:, None, None]

    def finer(self) -> Frame:
        """The same pieces with more points."""
        return attrs.evolve(self, degree=FINE_DEGREE)


def framed(run: Trajectory) -> Frame:
    """The pieces of the record before a run that is one period of an orbit."""
    sight, period = run.hindsight, run.t1 - run.t0
    record, lag = sight.record(0), sight.longest
    low, high = run.t0 - lag, run.t0
    turns = range(1, 2 + ceil(lag / period))
    jumps = [row.t - k * period for row in run.own_jumps.values() for k in turns]
    seen = leaps(record, low, high, _seen(run))
    exact = [low, high, *(leap.t for leap in seen)]
    room = 1e-6 * min(lag, period)
    breaks = [b for b in descendants(jumps, sight.lags, high) if low < b < high]
    breaks = [b for b in breaks if all(abs(b - t) > room for t in exact)]
    ends = distinct([*exact, *breaks])
    pieces = [
        half for piece in pairwise(ends) for half in _resolved(record, piece, RECORD_HALVINGS)
    ]
    return Frame(pieces, seen, RECORD_DEGREE)


def _seen(run: Trajectory) -> list[int]:
    return sorted({element for each in run.hindsight.scene.code.seen for element in each})


def _resolved(
    record: PastRecord, piece: tuple[float, float], depth: int
) -> list[tuple[float, float]]:
    """A piece, halved until the polynomial on each part resolves the record."""
    a, b = piece
    room = RECORD_SIDE * (b - a)
    states = record.states(a + (b - a) * nodes(RECORD_DEGREE), a + room, b - room)
    series = np.abs(from_values(RECORD_DEGREE) @ states)
    if not depth or np.all(series[-2:] <= RECORD_TOLERANCE * (series.max(axis=0) + 1e-300)):
        return [piece]
    halves = (a, 0.5 * (a + b)), (0.5 * (a + b), b)
    return [part for half in halves for part in _resolved(record, half, depth - 1)]


def monodromy(run: Trajectory, frame: Frame) -> tuple[np.ndarray, Carried]:
    """The matrix that maps a perturbation of the record over one period.

    Returns
    -------
    array, shape (m, m)
        Rows and columns belong to the values at the points of the frame, then to its jump times.
    Carried
        The perturbation at the end of the run.
    """
    count, size, each = len(frame.pieces), run.spec.dimension, frame.degree + 1
    total = count * each * size + len(frame.leaps)
    values = np.eye(count * each * size, total).reshape(count, each, size, total)
    strands = [Strand(a, b, v) for (a, b), v in zip(frame.pieces, values, strict=True)]
    rows = np.eye(total)[count * each * size :]
    shifts = [
        Shift(leap.t, leap.before, leap.after, row)
        for leap, row in zip(frame.leaps, rows, strict=True)
    ]
    breaks = [a for a, _ in frame.pieces]
    found, past = carried(run, strands[-1].values[-1], strands, shifts, breaks)
    later, ends = run.t1 - run.t0, _ends(run, frame)
    lookups = zip(frame.points, frame.bounds(later, ends), strict=True)
    states = [past.within(times + later, a, b) for times, (a, b) in lookups]
    moves = [_row(past.shifts, leap.t) for leap in ends]
    return np.concatenate([np.reshape(states, (-1, total)), *moves]), found


def _ends(run: Trajectory, frame: Frame) -> list[Leap]:
    """The jumps of the record one period later.

    Raises
    ------
    OrbitError
        If their number has changed.
    """
    sight = run.hindsight
    found = leaps(sight.record(0), run.t1 - sight.longest, run.t1, _seen(run))
    if len(found) != len(frame.leaps):
        raise OrbitError(
            f"{run.spec.model}: {len(frame.leaps)} jumps are remembered at t = {run.t0:.9g}, and "
            f"{len(found)} at t = {run.t1:.9g}"
        )
    return found


def _row(shifts: Iterable[Shift], t: float) -> Matrix:
    """The variation of the time of the jump at ``t``, as a row."""
    return min(shifts, key=lambda shift: abs(shift.t - t)).row[None]


@attrs.frozen(eq=False)
class Remembering(Shot):
    """A turn, and the pieces of the record before it."""

    frame: Frame


class HistoryShooting(Shooting):
    """Newton's method on records over the longest lag."""

    def __init__(self, model: Any, timed: bool, tol: float, options: dict[str, Any]) -> None:
        super().__init__(model, timed, tol, options)
        self.lag = Hindsight(self.scene, [], "keep", Log()).longest
        if not self.lag > 0.0:
            raise OptionError(
                f"{self.scene.spec.model}: the longest lag is {self.lag:g}: there is no history "
                "to find; use the state itself in place of past(0)"
            )

    def _covering(self, period: float) -> int:
        """Number of turns that cover the longest lag."""
        return max(1, ceil(self.lag / period))

    def centred(self, guess: Guess) -> Guess:
        """The same turn, started in the middle of its longest arc with a simulated record."""
        run = self.fly(guess, (1 + self._covering(guess.period)) * guess.period)
        since = run.t1 - guess.period
        arcs = [(i, arc) for i, arc in enumerate(run.parts) if isinstance(arc, Arc)]
        spans = {i: (max(arc.t0, since), arc.t1) for i, arc in arcs if arc.t1 > since}
        long = [i for i, (a, b) in spans.items() if b - a > SHORTEST_ARC * guess.period]
        plain = [i for i in long if not run.parts[i].constrained]
        index = max(plain or long, key=lambda i: spans[i][1] - spans[i][0])
        arc, t = run.parts[index], 0.5 * sum(spans[index])
        assert isinstance(arc, Arc)
        x, mode = arc.local(np.array((t - arc.t0) - arc.low)), arc.mode
        return Guess(t, x, mode, guess.period, run.hindsight.before(index, t))

    def turn(self, guess: Guess) -> Remembering:
        """The run of one period from a guess, and how its record differs at the two ends."""
        run = self.fly(guess, guess.period)
        frame, record = framed(run), run.hindsight.record(0)
        ends = _ends(run, frame)
        states = frame.states(record, 0.0, frame.leaps)
        misses = frame.states(record, guess.period, ends) - states
        pairs = zip(frame.leaps, ends, strict=True)
        late = [end.t - leap.t - guess.period for leap, end in pairs]
        size = np.maximum(self._scale(run), np.abs(states).max(axis=(0, 1)))
        scale = np.append(np.broadcast_to(size, states.shape), np.full(len(late), guess.period))
        miss = np.append(misses, late)
        residual = float(np.max(np.abs(miss) / scale)) + self._apart(run)
        return Remembering(guess, run, miss, scale, residual, frame)

    def _measure(self, turn: Shot) -> Numbers:
        return turn.scale

    def _step(self, turn: Shot) -> tuple[np.ndarray, float]:
        """Newton step: changes of the record and of the period."""
        assert isinstance(turn, Remembering)
        run, frame, scale, size = turn.run, turn.frame, turn.scale, len(turn.guess.x)
        matrix = monodromy(run, frame)[0] - np.eye(len(scale))
        system, right = matrix * scale / scale[:, None], -turn.miss / scale
        if not self.timed:
            period, ends = turn.guess.period, _ends(run, frame)
            states = frame.states(run.hindsight.record(0), period, ends)
            moving = np.append(frame.slopes(states), np.full(len(ends), -1.0)) / scale
            start = np.zeros(len(scale) + 1)
            last = slice(states.size - size, states.size)
            flow = self.flow(attrs.evolve(turn.guess, mode=run.parts[0].mode)) / scale[last]
            start[last] = flow / np.linalg.norm(flow)
            system = np.vstack([np.column_stack([system, moving * period]), start])
            right = np.append(right, 0.0)
        found = np.linalg.lstsq(system, right, rcond=1e-12)[0]
        stretch = 0.0 if self.timed else float(found[-1]) * turn.guess.period
        return found[: len(scale)] * scale, stretch

    def moved(self, turn: Shot, step: Numbers, stretch: float) -> Guess:
        """The guess at the end of a run from the changed record, over the longest lag or more."""
        changed = self.changed(turn, step, stretch)
        length = self._covering(changed.period) * changed.period
        return self.after(self.fly(changed, length), changed.period)

    def changed(self, turn: Shot, step: Numbers, stretch: float) -> Guess:
        """The guess of a turn, with record and period changed by a step."""
        assert isinstance(turn, Remembering)
        frame, guess = turn.frame, turn.guess
        states = frame.states(turn.run.hindsight.record(0), 0.0, frame.leaps)
        states = states + step[: states.size].reshape(states.shape)
        late = zip(frame.leaps, step[states.size :].tolist(), strict=True)
        ends = [attrs.evolve(leap, t=leap.t + later) for leap, later in late]
        pieces = [
            _piece(a, b, frame.degree, points, values)
            for points, values, (a, b) in zip(
                frame.points, states, frame.bounds(0.0, ends), strict=True
            )
        ]
        pieces.insert(0, constant(states[0, 0], pieces[0].start))
        period, last = guess.period + stretch, states[-1, -1]
        return attrs.evolve(guess, x=last, period=period, history=Before(pieces))

    def describe(self, turn: Shot) -> Description:
        """The leading multipliers, as far as the two sets of points agree.

        Raises
        ------
        OrbitError
            If they disagree on a multiplier larger than :data:`HIDDEN_MULTIPLIER`.
        """
        assert isinstance(turn, Remembering)
        matrix, found = monodromy(turn.run, turn.frame)
        values = _sorted(monodromy(turn.run, turn.frame.finer())[0])
        others = _sorted(matrix)[: len(values)]
        errors = np.array([np.abs(others - value).min() for value in values])
        known = int(np.argmax(np.append(errors, np.inf) > KNOWN_MULTIPLIER))
        known -= int(0 < known < len(values) and values[known - 1].imag > 0)
        if known == 0 or np.abs(values[min(known, len(values) - 1)]) > HIDDEN_MULTIPLIER:
            raise OrbitError(
                f"{turn.run.spec.model}: the multipliers of the orbit of period "
                f"{turn.guess.period:.9g} are not resolved beyond the {known} largest"
            )
        lasting = np.abs(values[:known]) > KNOWN_MULTIPLIER
        return Description(
            matrix, found.saltations, values[:known][lasting], errors[:known][lasting]
        )

    def apart(self, turn: Shot, other: Shot) -> float:
        """How far the multipliers over two turns are apart, by more than their errors, relative to
        the larger of them and 1."""
        one, two = self.describe(turn), self.describe(other)
        known = zip(one.multipliers, one.errors, strict=True)  # type: ignore[arg-type]
        least = [np.abs(two.multipliers - m).min() - KNOWN_MULTIPLIER - e for m, e in known]
        return float(max(least, default=0.0))


def _piece(a: float, b: float, degree: int, points: Numbers, values: Matrix) -> Piece:
    """A piece of a record from ``a`` to ``b``, with given values at the points, which may extend
    beyond its ends or end before them."""
    strand = Strand(float(points[0]), float(points[-1]), values[:, :, None])
    return Piece(a, b, lambda s, since: strand(s + since)[:, :, 0], degree)


def _sorted(matrix: Matrix) -> ComplexNumbers:
    """Eigenvalues, largest first; of a complex pair, the one in the upper half-plane first."""
    values = np.linalg.eigvals(matrix).astype(complex)
    return values[np.lexsort((-values.imag, -np.round(np.abs(values), 9)))]
