"""The plan of a run for its replay: arrays of the steps of its arcs and of what ends each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..errors import OrbitError
from ..lowering import Field
from ..segment import Segment
from ..trajectory.arcs import Arc, JumpRow, Part, TailPart
from ..variation import Course, Walk
from ..variation.arcs import (
    COLLOCATION_HALVINGS,
    COLLOCATION_TOLERANCE,
    ArcPiece,
    collocate,
    gauss,
    pieces,
    sizes,
)
from ..variation.derivatives import Derivatives, MatrixFunction
from .laws import AT_END, AT_LENGTH, IDENTITY, Laws, laws_of

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector

#: Tolerated relative size of the last terms in the series of a step's time derivative; the error of
#: Gauss collocation at the end of a step is about the square of this.
SLOPE_RIPPLE = math.sqrt(COLLOCATION_TOLERANCE)

#: Steps are replayed in groups of this size; groups without a step of the run are skipped.
TOGETHER = 32


class Itinerary(NamedTuple):
    """The steps of a run in order; unused rows repeat the last one.

    Attributes
    ----------
    laws : array of int, shape (steps, 4)
        Numbers of the flow, of the guard that ends the step, of the reset, and of the projection at
        the start of the step.
    used : array of bool, shape (steps,)
        Which rows are steps of the run.
    lengths, ends : array, shape (steps,)
        Length of the step, and the time at its end.
    masks : array, shape (steps, contacts)
        Which contacts are held.
    inner : array, shape (steps, stages, n)
        States at the stages of the collocation.
    first, before, after : array, shape (steps, n)
        States at the start of the step, at its end, and after the jump.
    jumps : array of int, shape (rows,)
        For each row of the table of jumps, the step that ends with it; -1 if there is none.
    """

    laws: np.ndarray
    used: np.ndarray
    lengths: np.ndarray
    ends: np.ndarray
    masks: np.ndarray
    inner: np.ndarray
    first: np.ndarray
    before: np.ndarray
    after: np.ndarray
    jumps: np.ndarray


def blank(laws: Laws, room: int, rows: int) -> Itinerary:
    """A plan without steps, to be filled.

    Parameters
    ----------
    room : int
        Most steps.
    rows : int
        Rows of the table of jumps.
    """
    n, stages = laws.spec.dimension, len(gauss()[0])
    steps = -(-room // TOGETHER) * TOGETHER
    return Itinerary(
        np.zeros((steps, 4), int),
        np.zeros(steps, bool),
        np.zeros(steps),
        np.zeros(steps),
        np.zeros((steps, len(laws.contacts))),
        np.zeros((steps, stages, n)),
        np.zeros((steps, n)),
        np.zeros((steps, n)),
        np.zeros((steps, n)),
        np.full(rows, -1),
    )


def plan_of(
    course: Course, touched: Sequence[float], ends: bool, room: int, rows: int
) -> Itinerary:
    """The plan of a run for its replay.

    Parameters
    ----------
    course : Course
        The course of the run, with dense output.
    touched : sequence of float
        Times of tangencies.
    ends : bool
        Whether the run ends at its last time rather than by a jump.
    room, rows : int
        As for :func:`blank`.

    Raises
    ------
    OrbitError
        If the run cannot be replayed.
    """
    laws, model = laws_of(course.scene.code), course.scene.spec.model
    if touched:
        raise OrbitError(
            f"{model}: a guard is touched at t = {touched[0]!r}; beyond a tangency there are no "
            "derivatives"
        )
    plan, maker = blank(laws, room, rows), _Maker(course, laws)
    count = 0
    for count, step in enumerate(maker.steps(ends), start=1):
        if count > room:
            raise OrbitError(
                f"{model}: to fly the run again takes more than {room} steps; raise max_steps"
            )
        step.write(plan, count - 1)
    for part in plan[:-1]:
        part[count:] = part[max(count - 1, 0)]
    plan.used[:] = np.arange(len(plan.used)) < count
    steps = maker.jumps[:rows]
    plan.jumps[: len(steps)] = steps
    return plan


@attrs.frozen(eq=False)
class _Leg:
    """One step of a plan: see :class:`Itinerary`; ``end`` is the time at its end."""

    piece: ArcPiece
    mask: list[float]
    laws: list[int]
    first: StateVector
    before: StateVector
    after: StateVector
    end: float

    def write(self, plan: Itinerary, place: int) -> None:
        piece, points = self.piece, gauss()[0]
        plan.laws[place], plan.masks[place] = self.laws, self.mask
        plan.lengths[place], plan.ends[place] = piece.length, self.end
        plan.inner[place] = piece.segment(piece.start + piece.length * points)
        plan.first[place], plan.before[place] = self.first, self.before
        plan.after[place] = self.after


class _Maker:
    """Makes the steps of a plan from a course.

    Attributes
    ----------
    jumps : list of int
        Numbers of the steps made so far that end with a jump.
    """

    def __init__(self, course: Course, laws: Laws) -> None:
        self.course, self.scene, self.laws = course, course.scene, laws
        self.walk, self.of = Walk(course, True), Derivatives(course.scene)
        self.model, self.count = course.scene.spec.model, 0
        self.jumps: list[int] = []

    def steps(self, ends: bool) -> Iterator[_Leg]:
        """The steps in order; the last one ends at the run's last time if ``ends``.

        Raises
        ------
        OrbitError
            If the run cannot be replayed.
        """
        parts, jumps = self.course.parts, self.course.jumps
        self._smooth(parts[0].t0, self.walk.begin()[1])
        for index, part in enumerate(parts):
            last = index + 1 == len(parts)
            if isinstance(part, TailPart):
                raise OrbitError(
                    f"{self.model}: impacts of {part.tail.contact.name} accumulate at "
                    f"t = {part.t1!r}; through an accumulation there are first derivatives only: "
                    "take differences of these, or end the run before"
                )
            jump, after = jumps.get(index), None if last else parts[index + 1]
            if last and index and jump is None and not part.length:  # after the last jump
                return
            if jump is None and not last:
                raise OrbitError(
                    f"{self.model}: the run passes the limit of a cycle of several edges at "
                    f"t = {part.t1!r}, beyond which there are no derivatives"
                )
            if jump is not None:
                self._alone(index, jump, after)
            yield from self._arc(part, jump, ends and last)

    def _alone(self, index: int, jump: JumpRow, after: Part | None) -> None:
        """Raise if a jump coincides with another event, or its guard has a formula that changes."""
        if isinstance(after, Arc) and not after.length and index + 1 in self.course.jumps:
            raise OrbitError(
                f"{self.model}: at t = {jump.t!r} several jumps have no time between them; a run "
                "with such cannot be flown again"
            )
        if self.walk.fired(index, jump)[1].kinks:
            raise OrbitError(
                f"{self.model}: the guard of {jump.edge} has a formula that changes; a run with "
                "such a jump cannot be flown again"
            )
        ties = self.walk.jump([(index, jump)], None if after is None else index + 1).ties
        assert ties is not None
        self._smooth(jump.t, ties)

    def _smooth(self, t: float, ties: Matrix) -> None:
        """Raise an :class:`OrbitError` if a perturbation can break ties."""
        if np.any(ties):
            raise OrbitError(
                f"{self.model}, t = {t!r}: another event happens at the same instant, but "
                "before or after for neighbours: there are no derivatives"
            )

    def _arc(self, arc: Arc, jump: JumpRow | None, ends: bool) -> Iterator[_Leg]:
        """The steps of an arc, the last of which ends with ``jump``, if there is one."""
        field, t = self.scene.field(arc.mode), arc.t0 + arc.low
        found = [piece for segment in arc.segments for piece in self._pieces(field, t, segment)]
        if not found:
            raise OrbitError(
                f"{self.model}: the run stays at t = {arc.t0!r}; such cannot be flown again"
            )
        mask = [float(name in field.held) for name in self.laws.contacts]
        flow = _number(self.laws.flows, (field.mode, bool(field.held)))
        first, onto = arc.first, IDENTITY if field.project is None else field.mode
        for place, piece in enumerate(found):
            last = place + 1 == len(found)
            guard, reset, end = AT_LENGTH, IDENTITY, t + piece.end
            before = after = piece.segment(piece.end)
            if last:
                guard, end, before, after = (
                    AT_END if ends else AT_LENGTH,
                    arc.t1,
                    arc.last,
                    arc.last,
                )
            if last and jump is not None:
                guard, before, after = jump.edge, jump.before, jump.after
                reset = jump.edge if jump.edge in self.laws.resets else IDENTITY
                self.jumps.append(self.count)
            numbers = [
                flow,
                _number(self.laws.guards, guard),
                _number(self.laws.resets, reset),
                _number(self.laws.onto, onto),
            ]
            yield _Leg(piece, mask, numbers, first, before, after, end)
            self.count += 1
            first, onto = before, IDENTITY

    def _pieces(self, field: Field, t: float, segment: Segment) -> Iterator[ArcPiece]:
        """A step of the run, divided into parts short enough for the collocation."""
        if field.changes:
            raise OrbitError(
                f"{self.model}: the flow of {field.name} has a formula that changes; it cannot be "
                "flown again"
            )
        rate = self.of.flow(field)
        for piece in pieces(None, t, segment):
            yield from _resolved(rate, piece, self.of.units)


def _resolved(rate: MatrixFunction, piece: ArcPiece, units: Numbers) -> Iterator[ArcPiece]:
    """A piece, halved until the last terms of its series are small."""
    waiting, left = [piece], COLLOCATION_HALVINGS
    while waiting:
        piece = waiting.pop()
        matrix, ripple = collocate(rate, piece)
        if left and np.any(ripple > SLOPE_RIPPLE * sizes(piece, matrix, units)):
            waiting, left = waiting + piece.halves()[::-1], left - 1
        else:
            yield piece


def _number(laws: Mapping[Any, Any], key: Any) -> int:
    """The number of a function: its position in a dict of :class:`.Laws`."""
    return list(laws).index(key)
