"""Perturbations of a run's start, parameters and history, carried along the run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from math import ulp
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..delay.pieces import window_on
from ..delay.windows import TO_POWERS
from ..errors import OrbitError
from ..rules.changes import TIED
from ..rules.limits import SAME_FLOW, USABLE
from ..rules.places import WINDOW_DEGREE
from ..segment import from_values, nodes
from ..trajectory.arcs import Arc, JumpRow
from .derivatives import Derivatives
from .limit import through
from .past import PastVariation, Shift, Strand
from .walk import Chatter, Course, DelayedArc, Factor, Moment, Walk

if TYPE_CHECKING:
    from ..automaton.shapes import Mask, Matrix

#: Flights of a series of impacts shorter than this, relative to the first, are recorded as one; the
#: second value applies if delays see jumps at the impacts.
SHORT_FLIGHT, SHORT_SEEN_FLIGHT = 1e-6, 1e-9

#: Between the two, so are those that are no longer than so many times the shortest of which the
#: time resolves the speed.
SPEED_RESOLVED = 4.0

#: Least length of a window, in spacings of the time.
WINDOW_SPACINGS = 64.0


class Carried:
    """The variation of the state, compared at equal times, as a linear function of ``m`` numbers.

    Attributes
    ----------
    state : array, shape (n, m)
    given : array, shape (q, m)
        Variation of the parameters, if the walk has columns for them.
    past : PastVariation or None
        Variation of the record; required before the start for a model with delays.
    none : array of bool, shape (n, m)
        Entries of ``state`` that have no derivative. A reset or a rest that does not depend on
        them ends this.
    last : Moment or None
        The last moment passed.
    limits : int
        Number of accumulations passed so far.
    """

    def __init__(
        self, walk: Walk, state: Matrix, given: Matrix, touched: Iterable[float] = ()
    ) -> None:
        self.walk, self.state, self.given = walk, state, given
        walk.incoming = lambda: self.state
        self.touched, self.limits = list(touched), 0
        self.none = np.zeros(state.shape, dtype=bool)
        self.past: PastVariation | None = None
        self.last: Moment | None = None
        self.saltations = list[Factor]()

    def remember(self, past: PastVariation) -> None:
        """Carry the variation of the record as well."""
        self.past = past
        self.walk.arrival = past.arrives

    def moments(self) -> Iterator[Moment]:
        """Carry the perturbation along the run; yields each jump and limit on the way."""
        for piece in self.walk.pieces():
            yield from self.through(piece)

    def final(self) -> Matrix:
        """The variation of the final state, shape ``(n, m)``; NaN where there is no derivative."""
        past, none, place = self.past, self.none, len(self.walk.course.parts) - 1
        part, piece = self.walk.course.parts[place], self.walk.piece(place, True)
        if past is not None and piece is not None and past.arrives(place, part.t1):
            assert isinstance(part, Arc)
            if past.turned(place, part, piece).any():  # the jump may come before or after the end
                none = none | (past.arrival(place, part, piece, self.state) != 0.0)
                none[:, -1] = True
        return self.state * np.where(none, np.nan, 1.0)

    def through(self, piece: Factor | DelayedArc | Chatter) -> Iterator[Moment]:
        """Carry the perturbation through a piece; yields the jumps or the limit at its end."""
        if isinstance(piece, DelayedArc):
            assert self.past is not None
            self._pass_tangencies(piece.arc.t1)
            self.state = self.past.along(piece.index, piece.arc, self.state)
        elif isinstance(piece, Chatter):
            yield from self._to_limit(piece)
        else:
            self._pass_tangencies(piece.t)
            yield from self._applied(piece, self._change(piece))

    def _pass_tangencies(self, t: float) -> None:
        """Drop the derivatives at a tangency up to ``t``: neighbours jump there, or do not."""
        while self.touched and self.touched[0] <= t:
            self.none[:, :-1] = True
            self.touched.pop(0)

    def _change(self, factor: Factor) -> Matrix:
        """The perturbation to which a factor is applied: state, delayed states, parameters."""
        if self.past is None:
            return np.vstack([self.state, self.given])
        index, ends = factor.part, bool(factor.moments)
        t, near = self.walk.moment(index, ends)
        change = self.past.changed(index, t, near, self.state)
        return np.vstack([change, self._arrival(factor, t)])

    def _arrival(self, factor: Factor, t: float) -> Matrix:
        """The variation, as a row, of the time at which a delayed term jumps; else zeros."""
        index, past, part = factor.part, self.past, self.walk.course.parts[factor.part]
        nothing = np.zeros((1, self.state.shape[1]))
        if past is None or not factor.moments or not past.arrives(index, t):
            return nothing
        piece = self.walk.piece(index, True)
        if not factor.waits or piece is None:
            raise OrbitError(
                f"{self.walk.model}, t = {t:.9g}: a jump is seen there just when another happens; "
                "which is first differs between neighbours: there is no derivative"
            )
        assert isinstance(part, Arc)
        return past.arrival(index, part, piece, self.state)[None]

    def _applied(self, factor: Factor, change: Matrix) -> Iterator[Moment]:
        broken = self._broken_ties(factor, change)
        self.state = factor.applied(change)
        for number, moment in enumerate(factor.moments):
            none = self.none | (broken if number else False)
            apply = partial(self._variation, none=none, change=change)
            ratio = None if moment.ratio is None else apply(moment.ratio)
            sides = apply(moment.before), apply(moment.after)
            self.last = Moment(moment.part, apply(moment.time), *sides, ratio)
            self.limits += moment.ratio is not None
            yield self.last
        self.none = self._undefined(factor.matrix, self.none) | broken
        if factor.edge is not None:
            self.saltations.append(factor)
        if self.past is not None and factor.moments:
            self._remembered(self.past, factor, change)

    def _variation(self, function: np.ndarray, none: Mask, change: Matrix) -> np.ndarray:
        """A linear function of the perturbation; NaN where it has no derivative."""
        return np.where(self._undefined(function, none), np.nan, function @ change)

    def _undefined(self, function: np.ndarray, none: Mask) -> Mask:
        """Where a linear function of the perturbation depends on an element without derivative.
        With delays, every element enters by way of the record."""
        if self.past is not None:
            return np.broadcast_to(none.any(axis=0), (*function.shape[:-1], none.shape[1]))
        found: np.ndarray = (function[..., : len(none)] != 0.0) @ none
        return found

    def _broken_ties(self, factor: Factor, change: Matrix) -> Mask:
        """Which of the ``m`` numbers change the order of simultaneous events."""
        if factor.ties is None or not len(factor.ties):
            return np.zeros(change.shape[1], dtype=bool)
        moved, sizes = factor.ties @ change, np.abs(factor.ties) @ np.abs(change)
        found: np.ndarray = np.any(np.abs(moved) > TIED * sizes, axis=0)
        return found

    def _remembered(self, past: PastVariation, factor: Factor, change: Matrix) -> None:
        """Add the jumps of a factor to the variation of the record."""
        first, last = factor.moments[0], factor.moments[-1]
        if first.ratio is not None:
            x = self.walk.course.parts[first.part].last
            before = after = x
        else:
            jumps = self.walk.course.jumps
            before, after = jumps[first.part].before, jumps[last.part].after
        past.jumped(Shift(factor.t, before, after, first.time @ change), last.after @ change)

    # -- accumulations in a model with delays -----------------------------------------------

    def _to_limit(self, chatter: Chatter) -> Iterator[Moment]:
        """Carry the perturbation through an accumulation, with that of the delayed terms."""
        past, part, tail = self.past, chatter.part, chatter.part.tail
        assert past is not None
        windows, rows = self._windows(past, chatter)
        scene = past.sight.scene.through(windows)
        name = tail.contact.name
        seeing = attrs.evolve(
            tail, field=scene.field(tail.field.name, (name,)), contact=scene.contact(name)
        )
        of, count = Derivatives(scene, True, True), self.state.shape[1]
        change = np.zeros((of.columns - 1 - of.size, count))
        change[-len(rows) :] = rows
        if len(self.given):
            change[-of.count : -len(rows)] = self.given
        factor = self.walk.limit(chatter.index, part, through(of, seeing, change, self.state))
        change = np.vstack([self.state, np.eye(count)])
        if past.restarts:
            self._require_same(past, factor.moments[0].after @ change, part.t1, tail.x_inf)
        else:
            self._flights(past, chatter)
            ends = np.stack([self.state, factor.applied(change)])
            past.add(Strand(past.strands[-1].b, part.t1, ends))
        yield from self._applied(factor, change)

    def _windows(
        self, past: PastVariation, chatter: Chatter
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """Windows on the record that each lag sees up to a limit, and the variation of their
        coefficients, one row for each."""
        part, sight = chatter.part, past.sight
        shapes, shown = sight.scene.code.shapes, part.tail.field.parameters
        own = len(shapes) - len(sight.scene.spec.windows)
        width = max(part.tail.remaining, WINDOW_SPACINGS * ulp(part.t1))
        windows, rows = list[np.ndarray](), list[np.ndarray]()
        for k, lag in enumerate(sight.lags):
            frame, powers = (np.asarray(each) for each in shown[own + 2 * k : own + 2 * k + 2])
            a, points = part.t0 - lag, width * nodes(WINDOW_DEGREE)
            if not a + width <= part.t0:
                raise OrbitError(
                    f"{self.walk.model}, t = {part.t0:.9g}: impacts accumulate within "
                    f"{part.tail.remaining:.3g}, and the lag {sight.scene.spec.lags[k].name} is "
                    "shorter, or depends on time or state: its derivative is not available"
                )
            places = ((a - frame[0]) + points) / frame[1]
            values = np.vander(places, WINDOW_DEGREE + 1, increasing=True) @ powers
            windows += window_on(a, a + width, values)
            moved = past.within(a + points, a, a + width)
            series = np.tensordot(TO_POWERS @ from_values(WINDOW_DEGREE), moved, 1)
            rows += [np.zeros((2, moved.shape[2])), series.reshape(-1, moved.shape[2])]
        return windows, np.vstack(rows)

    def _require_same(
        self, past: PastVariation, limit: np.ndarray, t: float, x: np.ndarray
    ) -> None:
        """Check that with restarts the state after each impact varies as the limit does.

        Raises
        ------
        OrbitError
            If it does not: the flights then see pasts whose variation is not known.
        """
        seen = sorted({e for each in past.sight.scene.code.seen for e in each})
        sizes = np.abs(past.fresh).max(axis=0) + np.abs(limit).max(axis=0)
        sizes += np.abs(x).max() / past.units
        if np.any(np.abs(past.fresh - limit)[seen] > SAME_FLOW * sizes):
            raise OrbitError(
                f"{self.walk.model}, t = {t:.9g}: each of the impacts that accumulate is seen by "
                'the flight after it (memory="restart"): its derivative is not available'
            )

    def _flights(self, past: PastVariation, chatter: Chatter) -> None:
        """Record the variation along the flights that precede a limit, one by one."""
        part, walk, before = chatter.part, self.walk, (self.saltations, self.none)
        seen = {e for each in past.sight.scene.code.seen for e in each}
        jump = part.jump(1) if part.tail.count else None
        shows = jump is not None and any(jump.before[e] != jump.after[e] for e in seen)
        arcs, jumps = [part.arc(0)], dict[int, JumpRow]()
        short = SHORT_FLIGHT * arcs[0].length
        resolved = min(SPEED_RESOLVED * ulp(part.t1) / USABLE, short)
        least = max(SHORT_SEEN_FLIGHT * arcs[0].length, resolved) if shows else short
        while len(arcs) < part.tail.count and arcs[-1].length > least:
            jumps[len(arcs) - 1] = part.jump(len(arcs))
            arcs.append(part.arc(len(arcs)))
        course = Course(walk.scene, arcs, jumps, _Within(past.sight, chatter.index))
        self.walk = past.walk = Walk(course, walk.parameters)
        self.saltations = []
        for piece in self.walk.pieces():
            if isinstance(piece, DelayedArc):
                self.state = past.along(piece.index, piece.arc, self.state)
            elif isinstance(piece, Factor):
                for _ in self._applied(piece, self._change(piece)):
                    pass
        self.walk = past.walk = walk
        self.saltations, self.none = before


@attrs.frozen(eq=False)
class _Within:
    """The view of the past within one part of a run, for the flights of that part."""

    whole: object
    index: int

    def __getattr__(self, name: str) -> object:
        return getattr(self.whole, name)

    def at(self, index: int, t: float, side: str = "right") -> object:
        return self.whole.at(self.index, t, side)  # type: ignore[attr-defined]

    def places(self, index: int, t: float) -> object:
        return self.whole.places(self.index, t)  # type: ignore[attr-defined]
