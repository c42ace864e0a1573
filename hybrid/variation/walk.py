"""The first variation along a run: fundamental matrices of arcs, saltation matrices of jumps.

A small change of the state is carried along an arc by ``d(Phi)/dt = Df Phi``, ``Phi = 1`` at
its start. Through a jump with guard ``g`` and reset ``R``, from the flow ``f-`` to ``f+``, it is
carried by the saltation matrix (all derivatives at the state before the jump) ::

    S = R_x + (f+ - R_x f- - R_t) g_x / (g_t + g_x f-)

which accounts for the neighbour's jumping a little earlier or later. Both are taken at equal
times. A change of parameters is carried along beside it. See ``docs/notes/orbits.md``; di
Bernardo, Budd, Champneys & Kowalczyk, *Piecewise-smooth Dynamical Systems* (2008), sections 2.5
and 6.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs
import numpy as np

from ..arcs import Arc, JumpRow, Part, TailPart
from ..errors import OrbitError
from ..rules.guards import NEAR
from ..scene import Field, Guard, Scene, scene_of
from ..trajectory import Trajectory
from .arcs import Piece, along, passing
from .derivatives import Derivatives
from .limit import ROUNDING, cleared, through

#: Change of a guard, against the terms of which it is made, that is rounding of them.
TIED = 1e-9

#: Kinds of jumps that leave the state and, where they begin, the flow as they are.
SMOOTH = ("release", "leave")


@attrs.frozen(eq=False)
class Course:
    """What a run has left: parts, the jumps that led from them, and tangencies of guards."""

    scene: Scene
    parts: Sequence[Part]
    jumps: Mapping[int, JumpRow]
    grazings: Sequence[float] = ()

    @classmethod
    def of(cls, model: Any, run: Trajectory) -> Course:
        """That of a trajectory."""
        return cls(scene_of(model), run.parts, run.own_jumps)


@attrs.frozen(eq=False)
class Moment:
    """How the time of a jump or of a limit, and the states there, change.

    The columns of its matrices are those of the change that the factor is applied to.

    Attributes
    ----------
    part : int
        The part of the run that it ends.
    time : array, shape (m,)
    before, after : array, shape (n, m)
        Of the states on its sides; of a limit both are that at it.
    ratio : array, shape (m,), or None
        Of a limit: that of its ratio.
    """

    part: int
    time: np.ndarray
    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray | None = None


@attrs.frozen(eq=False)
class Factor:
    """A matrix by which a piece of a run carries a small change of the state.

    Attributes
    ----------
    t : float
        Time at its end.
    edge : str or None
        Of a jump: its edge; of an accumulation: those that accumulate. None along an arc.
    matrix : array, shape (n, n)
        With parameters ``(n, n + q)``: behind the state's columns there are theirs.
    moments : tuple of Moment
        Of a jump, or several with no time between them, and of a limit.
    ties : array, shape (k, n + q)
        Numbers that must not change: where they do, neighbours take another course.
    """

    t: float
    edge: str | None
    matrix: np.ndarray
    moments: tuple[Moment, ...] = ()
    ties: np.ndarray | None = None


def factors(model: Any, run: Trajectory) -> Iterator[Factor]:
    """The first variation along a run, piece by piece, in order.

    Parameters
    ----------
    model : Automaton
        The model of the run.
    run : Trajectory
        With dense output.

    Yields
    ------
    Factor
        For each step of each arc, each jump and each accumulation of impacts.

    Raises
    ------
    OrbitError
        Where the run passes the limit of a cycle of several edges, for which no derivative is
        known; or where the neighbours of the run take another course. In a model with delays.
    """
    if run.spec.lags:
        raise OrbitError(
            f"{run.spec.model} looks into the past: a change of its state does not decide on what "
            "follows; hy.periodic_orbit gives the multipliers of its orbits"
        )
    if any(isinstance(part, Arc) and part.length and not part.segments for part in run.parts):
        raise OrbitError(f"{run.spec.model}: the first variation needs a run with save='dense'")
    for factor in Walk(Course.of(model, run)).factors():
        if factor.ties is not None and np.any(factor.ties):
            raise OrbitError(
                f"{run.spec.model}, t = {factor.t!r}: at {factor.edge} something else happens at "
                "the same instant, which neighbours have before it or after it: there is no first "
                "variation"
            )
        yield factor


#: A jump, and the place of the part that it ends.
Row = tuple[int, JumpRow]


class Walk:
    """A walk over the parts of a run; with columns for the elements of the parameters if they are
    asked for."""

    def __init__(self, course: Course, parameters: bool = False) -> None:
        self.course, self.scene = course, course.scene
        self.of = Derivatives(course.scene, parameters)
        self.size, self.model = self.of.size, course.scene.spec.model

    def begin(self) -> tuple[np.ndarray, np.ndarray]:
        """The flow at the start, and what must not change there by time, state and parameters."""
        part = self.course.parts[0]
        return self._flow(part, False), self._brinks(part, False)

    def factors(self) -> Iterator[Factor]:
        """Piece by piece, in order (:func:`factors`)."""
        group: list[Row] = []  # jumps with no time between them
        parts, jumps = self.course.parts, self.course.jumps
        yield from self.onto(parts[0])
        for index, part in enumerate(parts):
            last = index + 1 == len(parts)
            instant = isinstance(part, Arc) and not part.length
            if group and (last or not instant):
                yield self.jump(group, part)
                yield from self.onto(part)
                group = []
            if isinstance(part, Arc):
                yield from self.arc(part)
            else:
                yield self.limit(index, part)
            if index in jumps:
                group.append((index, jumps[index]))
            elif not last and isinstance(part, Arc):
                raise OrbitError(
                    f"{self.model}: the run passes the limit of a cycle of several edges at "
                    f"t = {part.t1!r}; its first variation is known for one contact only"
                )
        if group:
            yield self.jump(group, None)

    def onto(self, part: Part) -> Iterator[Factor]:
        """What begins at rest, or sliding, begins with its start's projection."""
        field = self.scene.field(part.mode)
        if isinstance(part, Arc) and field.project is not None:
            onto = self.of.project(field)(part.t0, part.first)[:, 1:]
            yield Factor(part.t0, None, cleared(onto, np.ones_like(onto), ROUNDING))

    def arc(self, arc: Arc) -> Iterator[Factor]:
        t = arc.t0 + arc.low
        for end, matrix in along(self.of, self.scene.field(arc.mode), t, arc.segments):
            yield Factor(t + end, None, matrix)

    def limit(self, index: int, part: TailPart) -> Factor:
        tail = part.tail
        matrix, time, state = through(self.of, tail)
        law = self.of.law(tail.contact.name)(part.t1, tail.x_inf)[0]
        ratio = law @ self._moved(time, state)
        moment = Moment(index, time, state, state, ratio)
        return Factor(part.t1, f"limit of {tail.contact.name}", matrix, (moment,))

    # -- jumps ------------------------------------------------------------------------------

    def jump(self, group: Sequence[Row], after: Part | None) -> Factor:
        """One jump, or several with no time between them."""
        (index, first), part = group[0], self.course.parts[group[0][0]]
        field, guard = self.fired(index, first)
        piece, before = self._piece(part, True), self._flow(part, True)
        jumped = piece if piece is not None and self._jumps(guard, field, piece) else None
        time = self._time(field, guard, first, before, jumped)
        moments, ties = self._moments(group, time, before)
        ties = np.vstack([ties, *self._sides(part, after, moments)])
        resets = np.eye(self.size, self.of.columns, 1)
        for place, row in group:
            resets = self._after(self._reset(place, row), resets)
        reset = resets[:, 1:]
        if guard.kind not in SMOOTH or jumped is not None or len(group) > 1:
            moves = resets[:, 1 : 1 + self.size] @ before + resets[:, 0]
            change = moves - (moves if after is None else self._flow(after, False))
            later = np.outer(change, time)
            reset = cleared(reset + later, np.abs(reset) + np.abs(later), ROUNDING)
        return Factor(first.t, " ".join(row.edge for _, row in group), reset, moments, ties)

    def _moments(
        self, group: Sequence[Row], time: np.ndarray, before: np.ndarray
    ) -> tuple[tuple[Moment, ...], np.ndarray]:
        """Times and states of jumps one after the other; what must not change for them."""
        state = np.eye(self.size, len(time)) + np.outer(before, time)
        moments, ties = [], [np.zeros((0, len(time)))]
        for number, (place, row) in enumerate(group):
            if number:
                ties.append(self._tie(place, row, time, state))
            after = self._reset(place, row) @ self._moved(time, state)
            moments.append(Moment(place, time, state, after))
            state = after
        return tuple(moments), np.vstack(ties)

    def _tie(self, place: int, row: JumpRow, time: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The change of a guard that is zero when the jump before leads to it: for neighbours it
        must be so too. One that is over its zero fires for neighbours as well."""
        field, guard = self.fired(place, row)
        x = row.before.tolist()
        size = self.scene.rounding(guard, field)(row.t, x)[0]
        if abs(guard.value(row.t, x)) > NEAR * size:
            return np.zeros((0, len(time)))
        gradient, moved = self.of.guard(guard, field)(row.t, row.before), self._moved(time, state)
        return cleared(gradient @ moved, np.abs(gradient) @ np.abs(moved), TIED)

    def fired(self, place: int, row: JumpRow) -> tuple[Field, Guard]:
        """The field and the guard of a jump."""
        field = self.scene.field(self.course.parts[place].mode)
        return field, field.guards[field.column(row.edge)]

    def _reset(self, place: int, row: JumpRow) -> np.ndarray:
        return self.of.reset(row.edge, self.fired(place, row)[1].kind)(row.t, row.before)

    def _after(self, reset: np.ndarray, earlier: np.ndarray) -> np.ndarray:
        """A reset after what came before it at the same time, by time, state and parameters."""
        found: np.ndarray = reset[:, 1 : 1 + self.size] @ earlier
        found[:, 0] += reset[:, 0]
        found[:, 1 + self.size :] += reset[:, 1 + self.size :]
        return found

    def _moved(self, time: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Changes of time, state and parameters, one below the other."""
        return np.vstack([time, state, np.eye(self.of.count, len(time), self.size)])

    def _time(
        self, field: Field, guard: Guard, row: JumpRow, flow: np.ndarray, jumped: Piece | None
    ) -> np.ndarray:
        """How the time changes at which a guard fires; of one that has jumped over its zero at the
        end of a piece, that at which its formula changes."""
        if jumped is not None:
            key = "guard", guard.edge, field.name
            kinks = self.of.kinks(key, field, lambda graph: graph.deciding(guard.edge))
            return passing(kinks, jumped, flow)
        gradient = self.of.guard(guard, field)(row.t, row.before)[0]
        rate = float(gradient[0] + gradient[1 : 1 + self.size] @ flow)
        if rate == 0.0:
            raise OrbitError(
                f"{self.model}, t = {row.t!r}: the guard of {row.edge} is reached without speed; "
                "a jump that grazes has no first variation"
            )
        return -gradient[1:] / rate

    def _jumps(self, guard: Guard, field: Field, piece: Piece) -> bool:
        """Whether a guard that fires at the end of a piece is not zero there, seen from it."""
        if not guard.jumps:
            return False
        taus = [piece.end - piece.beside, piece.end - 2.0 * piece.beside]
        near, far = (guard.value(piece.t + s, piece.segment(s).tolist()) for s in taus)
        x = piece.segment(piece.end)
        size = self.scene.rounding(guard, field)(piece.t + piece.end, x.tolist())[0]
        return bool(abs(2.0 * near - far) > NEAR * size)

    def _sides(self, part: Part, after: Part | None, moments: Sequence[Moment]) -> list[np.ndarray]:
        """What must not change for a jump at which flows jump as well: neighbours would have that
        before the jump, or after it."""
        first, last = moments[0], moments[-1]
        before = self._brinks(part, True)
        found = [before @ self._moved(first.time, first.before)]
        if after is not None:
            found.append(self._brinks(after, False) @ self._moved(last.time, last.after))
        return [cleared(rows, np.abs(rows).max(initial=0.0), TIED) for rows in found]

    def _brinks(self, part: Part, ends: bool) -> np.ndarray:
        """Derivatives of the functions that are zero at an end of an arc, and beyond which its flow
        is another."""
        field, piece = self.scene.field(part.mode), self._piece(part, ends)
        if piece is None or not field.changes:
            return np.zeros((0, self.of.columns))
        at = piece.end if ends else piece.start
        t, x = piece.t + at, piece.segment(at)
        found = self.of.kinks(("flow", field.name), field, lambda g: g.flow(bool(field.held)))(t, x)
        flow, size = piece.flow(field, ends)
        rates = found[:, 1] + found[:, 2 : 2 + self.size] @ flow
        near = np.abs(found[:, 0]) < piece.beside * np.abs(rates)
        beyond = (1.0 if ends else -1.0) * piece.beside
        beside, far = (
            np.array(field.rhs(t + s, (x + s * flow).tolist())) for s in (beyond, 2.0 * beyond)
        )
        other = 2.0 * beside - far
        return found[near, 1:] if np.any(np.abs(other - flow) > NEAR * size) else found[:0, 1:]

    def _flow(self, part: Part, ends: bool) -> np.ndarray:
        """The flow at an end of a part, as it is on its side."""
        field, piece = self.scene.field(part.mode), self._piece(part, ends)
        if piece is not None and field.changes:
            return piece.flow(field, ends)[0]
        if isinstance(part, TailPart):
            return np.array(field.rhs(part.t0, part.tail.x.tolist()))
        t, x = (part.t1, part.last) if ends else (part.t0, part.first)
        return np.array(field.rhs(t, x.tolist()))

    def _piece(self, part: Part, ends: bool) -> Piece | None:
        """The first or last step of an arc."""
        if not isinstance(part, Arc) or not part.segments:
            return None
        segment = part.segments[-1 if ends else 0]
        return Piece(part.t0 + part.low, segment, segment.start, segment.length)
