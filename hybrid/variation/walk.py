"""The first variation along a run: fundamental matrices of arcs, saltation matrices of jumps.

A small perturbation of the state is carried along an arc by ``d(Phi)/dt = Df Phi``, with ``Phi =
1`` at its start. Through a jump with guard ``g`` and reset ``R``, from the flow ``f-`` to ``f+``,
it is carried by the saltation matrix (all derivatives at the state before the jump) ::

    S = R_x + (f+ - R_x f- - R_t) g_x / (g_t + g_x f-)

which accounts for the neighbouring run jumping a little earlier or later. The two runs are compared
at equal times. Perturbations of parameters have further columns. See ``docs/notes/orbits.md``; di
Bernardo, Budd, Champneys & Kowalczyk, *Piecewise-smooth Dynamical Systems* (2008), sections 2.5
and 6.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import groupby
from math import ulp
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..errors import OrbitError
from ..lowering import Field, Guard, Kind, Scene, scene_of
from ..rules.changes import MANY_SPACINGS, SLOW_RATE, TIED
from ..rules.guards import NEAR
from ..rules.limits import DIFFERENCE_ROUNDING, USABLE
from ..segment import Segment
from ..trajectory.arcs import Arc, JumpRow, Part, TailPart
from ..trajectory.trajectory import Solution
from .arcs import ArcPiece, along, passing, resolvable
from .derivatives import Derivatives
from .derivatives import after as after_reset
from .limit import LimitVariation, through
from .saltation import Saltation, cleared

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector

#: A guard whose delayed term jumps has fired because of this jump, if the guard's value before it
#: exceeds this fraction of its jump.
SEEN = 1e-6

#: Messages: why there is no first variation.
CYCLE = (
    "the run passes the limit of a cycle of several edges; its first variation is known for one "
    "contact only"
)
TIES = (
    "another event happens at the same instant, but before or after it for neighbours: there is no "
    "first variation"
)

SEES_RATES = (
    "depends on the past, and what follows on how fast that changes: there the first variation is "
    "not known"
)

#: Kinds of jumps at which state and flow are continuous, unless the jump erases the past.
SMOOTH_KINDS = (Kind.RELEASE, Kind.LEAVE)


@attrs.frozen(eq=False)
class Course:
    """The course of a run: its parts, its jumps by the index of the part that they end, and its
    view of the past (a :class:`.Hindsight`; None without delays)."""

    scene: Scene
    parts: Sequence[Part]
    jumps: Mapping[int, JumpRow]
    sight: Any = None

    @classmethod
    def of(cls, model: Any, run: Solution) -> Course:
        """The course of a trajectory."""
        sight = run.hindsight if run.spec.lags else None
        return cls(
            sight.scene if sight else scene_of(model),
            run.parts,
            run.own_jumps,
            sight,
        )


@attrs.frozen(eq=False)
class Moment:
    """The variation of the time of a jump or a limit, and of the states there.

    The columns of its matrices are those of the perturbation to which the factor is applied.

    Attributes
    ----------
    part : int
        The part of the run that the jump or the limit ends.
    time : array, shape (m,)
    before, after : array, shape (n, m)
        Variation of the states before and after a jump; for a limit, both of the limit state.
    ratio : array, shape (m,), or None
        For a limit: variation of its ratio.
    """

    part: int
    time: Numbers
    before: Matrix
    after: Matrix
    ratio: Numbers | None = None


@attrs.frozen(eq=False)
class Factor:
    """The matrix by which one piece of a run maps a small perturbation of the state.

    Attributes
    ----------
    t : float
        Time at the end of the piece.
    edge : str or None
        For a jump, its edge; for an accumulation, the edges that accumulate; None along an arc.
    matrix : array, shape (n, n)
        With parameters ``(n, n + q)``: their columns follow those of the state. With delays,
        the columns of the delayed states are between them, and the last column belongs to the time
        at which a delayed term jumps.
    moments : tuple of Moment
        One for a jump or a limit, several for simultaneous jumps; empty along an arc.
    ties : array, shape (k, n + q)
        Linear functions of the perturbation that must be zero; otherwise neighbouring runs pass
        simultaneous events in another order.
    waits : bool
        Whether the guard fires because a delayed term of it jumps.
    part : int
        Index of the part of the run that the piece ends, if it has moments; otherwise of the part
        that it begins.
    smooth : bool
        Whether the piece is part of an arc, so that its matrix is nonsingular.
    saltation : Saltation or None
        The matrix of a jump, or of an accumulation, in its summands.
    """

    t: float
    edge: str | None
    matrix: Matrix
    moments: tuple[Moment, ...] = ()
    ties: Matrix | None = None
    waits: bool = False
    part: int = 0
    smooth: bool = False
    saltation: Saltation | None = None

    def applied(self, change: Matrix) -> Matrix:
        """A change of the state, and of what follows it in the columns, after the piece."""
        return self.matrix @ change if self.saltation is None else self.saltation.applied(change)


@attrs.frozen(eq=False)
class DelayedArc:
    """An arc of a run with delays: its variation depends on that of the record."""

    index: int
    arc: Arc


@attrs.frozen(eq=False)
class Chatter:
    """An accumulation of impacts in a run with delays."""

    index: int
    part: TailPart


def factors(model: Any, run: Solution, apart: float = np.inf) -> Iterator[Factor]:
    """The first variation along a run, piece by piece, in order.

    Parameters
    ----------
    model : Automaton
        The model of the run.
    run : Solution
        With dense output.
    apart : float
        As :func:`.arcs.along` takes it.

    Yields
    ------
    Factor
        For each step of each arc, each jump and each accumulation of impacts.

    Raises
    ------
    OrbitError
        If the run passes the limit of a cycle of several edges, for which no derivative is
        known; if neighbouring runs pass simultaneous events in another order; and for a model with
        delays.
    """
    if run.spec.lags:
        raise OrbitError(
            f"{run.spec.model} looks into the past: a change of its state does not decide on what "
            "follows; hy.periodic_orbit gives the multipliers of its orbits"
        )
    if any(isinstance(part, Arc) and part.length and not part.segments for part in run.parts):
        raise OrbitError(f"{run.spec.model}: the first variation needs a run with save='dense'")
    yield from factors_of(Course.of(model, run), apart)


def factors_of(course: Course, apart: float = np.inf) -> Iterator[Factor]:
    """The first variation along the course of a run without delays: see :func:`factors`."""
    for factor in Walk(course, apart=apart).pieces():
        assert isinstance(factor, Factor)
        if factor.ties is not None and np.any(factor.ties):
            where = f"{course.scene.spec.model}, t = {factor.t!r}"
            tied = CYCLE if factor.edge is None else f"at {factor.edge} {TIES}"
            raise OrbitError(f"{where}: {tied}")
        yield factor


#: A jump, with the index of the part that it ends.
Row = tuple[int, JumpRow]


#: The scene at a moment, and its derivatives.
Look = tuple[Scene, Derivatives]


class Walk:
    """The first variation along a course; with columns for the parameters, if ``parameters``."""

    def __init__(self, course: Course, parameters: bool = False, apart: float = np.inf) -> None:
        self.course, self.scene, self.parameters = course, course.scene, parameters
        self.apart = apart
        self.of = Derivatives(course.scene, parameters)
        self.size, self.model = self.of.size, course.scene.spec.model
        self._known: dict[int, Look] = {}
        self._since, self._there = np.inf, course.scene
        #: Whether a delayed term jumps at time ``t`` in part ``index``.
        self.arrival: Callable[[int, float], bool] = lambda index, t: False
        #: The change of the state that is carried along, if one is.
        self.incoming: Callable[[], Matrix | None] = lambda: None

    @cached_property
    def columns(self) -> int:
        """Number of columns of matrices that are applied to a perturbation."""
        return self.of.columns - 1 + bool(self.course.sight)

    def begin(self) -> tuple[np.ndarray, np.ndarray]:
        """The flow at the start, and the derivatives of deciding functions that are zero there; of
        these a perturbation must not change the sign."""
        return self._flow(0, False), self._brinks(0, False)

    def pieces(self) -> Iterator[Factor | DelayedArc | Chatter]:
        """The pieces of the run in order (see :func:`factors`)."""
        group: list[Row] = []  # simultaneous jumps
        parts, jumps = self.course.parts, self.course.jumps
        yield from self.onto(0)
        for index, part in enumerate(parts):
            last = index + 1 == len(parts)
            instant = isinstance(part, Arc) and not part.length
            if group and (last or not instant):
                yield self._resolved(partial(self.jump, group, index), group[0][0], False)
                yield from self.onto(index)
                group = []
            if isinstance(part, Arc):
                yield from self.arc(index, part)
            elif self.course.sight:
                yield Chatter(index, part)
            else:  # its matrix leaves errors in gap and gap speed, which the projection removes
                yield self._resolved(partial(self.limit, index, part), index, True)
                yield from () if last else self.onto(index + 1)
            if index in jumps:
                group.append((index, jumps[index]))
            elif not last and isinstance(part, Arc):
                yield from self._at_limit(group, index)
                yield from self.onto(index + 1)
                group = []
        if group:
            yield self._resolved(partial(self.jump, group, None), group[0][0], False)

    def _at_limit(self, group: Sequence[Row], index: int) -> Iterator[Factor]:
        """The factors of the jumps at a limit that no sum has led to, and of the limit."""
        if group and self._stays(*group[-1]):
            yield self._resolved(partial(self.rests, group, index), index, True)
            return
        if group:
            yield self._resolved(partial(self.jump, group, index), group[0][0], False)
        yield self.unknown(index, True)

    def _stays(self, place: int, row: JumpRow) -> bool:
        """Whether a jump is a perfectly plastic impact: the contact rests from there on."""
        scene, x = self.beside(place, True)[0], row.before.tolist()
        guards = scene.field(self.course.parts[place].mode).guards
        hit = [g for g in guards if (g.edge, g.kind) == (row.edge, Kind.CONTACT)]
        if not hit or self.course.sight:
            return False
        return bool(scene.contact(row.edge).law(row.t, x, hit[0].lie(row.t, x)[1]) == 0.0)

    def rests(self, group: Sequence[Row], index: int) -> Factor:
        """The factor of a perfectly plastic impact, and of the limit that it is at once. What gives
        the contact a speed behind it, as the restitution does, has another limit."""
        factor, (place, row) = self.jump(group, index + 1), group[-1]
        last, (field, guard) = factor.moments[-1], self.fired(place, row)
        of, nothing = self.beside(place, True)[1], np.full(len(factor.moments[-1].time), np.nan)
        gradient = of.matrix(of.of_speed(guard, field))(row.t, row.after)
        moved = self._moved(last.time, last.after)
        tie = cleared(gradient @ moved, np.abs(gradient) @ np.abs(moved), TIED)
        limit = Moment(index, last.time, last.after, last.after, nothing)
        known = [tie] if factor.ties is None else [factor.ties, tie]
        return attrs.evolve(factor, moments=(*factor.moments, limit), ties=np.vstack(known))

    def _resolved(self, make: Callable[[], Factor], index: int, limit: bool) -> Factor:
        """The factor of a jump or a limit; by parameters, one that there is none of is unknown."""
        try:
            return make()
        except OrbitError:
            if not self.parameters or self.course.sight:
                raise
            return self.unknown(index, limit)

    def unknown(self, index: int, limit: bool) -> Factor:
        """The factor of a jump or a limit through which no derivative is known: ties on every
        number."""
        part = self.course.parts[index]
        if self.course.sight:
            raise OrbitError(f"{self.model}, t = {part.t1!r}: {CYCLE}")
        every, none = np.eye(self.size, self.columns), np.full((self.size, self.columns), np.nan)
        moment = Moment(index, none[0], none, none, none[0] if limit else None)
        return Factor(part.t1, None, every, (moment,), ties=every, part=index)

    def onto(self, index: int) -> Iterator[Factor]:
        """The factor of the projection at the start of part ``index``, if it rests or slides."""
        part, (scene, of) = self.course.parts[index], self.beside(index, False)
        field = scene.field(part.mode)
        if isinstance(part, Arc) and field.project is not None:
            onto = self._widened(of.project(field)(part.t0, part.first)[:, 1:])
            yield Factor(
                part.t0, None, cleared(onto, np.ones_like(onto), DIFFERENCE_ROUNDING), part=index
            )

    def arc(self, index: int, arc: Arc) -> Iterator[Factor | DelayedArc]:
        """The factors of an arc; with delays, the arc as one piece."""
        if self.course.sight:
            self._require_values(arc)
            yield DelayedArc(index, arc)
            return
        t = arc.t0 + arc.low
        for segments in self._by_piece(t, arc.segments):
            scene, of = self.look(index, t + segments[0].start + 0.5 * segments[0].length)
            for end, matrix in along(of, scene.field(arc.mode), t, segments, self.apart):
                yield Factor(t + end, None, matrix, smooth=True)

    def _require_values(self, arc: Arc) -> None:
        """Refuse an arc at rest or sliding whose flow depends on how fast the past changes: only
        the variation of what is seen is carried, not that of its rate."""
        switching = self.scene.spec.sliding(arc.mode)
        found = [name for name in self.scene.field(arc.mode).held if self._sees_rates(name)]
        if switching is not None and any(self._asked("surface", switching.name)):
            found.append(switching.name)
        if found:
            raise OrbitError(f"{self.model}, t = {arc.t0!r}: {found[0]} {SEES_RATES}")

    def _sees_rates(self, contact: str) -> bool:
        """Whether the acceleration of a contact's gap depends on how fast the past changes: where
        the gap looks back, or the rate of a position that it is made of."""
        mode = self.scene.contact(contact).mode
        places = self.scene.code.mode(mode).contact(contact).pairing.positions
        rates = self._asked("flow", mode)
        return any(self._asked("gap", contact)) or any(rates[i] for i in places)

    def _asked(self, kind: str, name: str) -> list[set[tuple[int, int]]]:
        """What each element of a function's result reads from the past."""
        code = self.scene.code
        found: list[set[tuple[int, int]]] = code.once(
            ("asked", kind, name), lambda: code.asked(code.closed(kind, name))
        )
        return found

    def _by_piece(self, t: float, segments: Sequence[Segment]) -> Iterator[Sequence[Segment]]:
        """The steps of an arc that begins at ``t``, grouped by the pieces of the signals."""
        if not self.scene.samples:
            yield from [segments] if segments else []
            return
        middles = (t + each.start + 0.5 * each.length for each in segments)
        pieces = [self.scene.span(middle)[0] for middle in middles]
        for _, group in groupby(zip(pieces, segments, strict=True), lambda pair: pair[0]):
            yield [segment for _, segment in group]

    def limit(self, index: int, part: TailPart, found: LimitVariation | None = None) -> Factor:
        """The factor of an accumulation, from ``found`` if these derivatives are known already."""
        of = self.beside(index, False)[1]
        found = found or through(of, part.tail, incoming=self.incoming())
        moment = Moment(index, found.time, found.state, found.state, found.ratio)
        name = f"limit of {part.tail.contact.name}"
        saltation = found.saltation
        return Factor(part.t1, name, saltation.matrix, (moment,), part=index, saltation=saltation)

    # -- the scene at a time ----------------------------------------------------------------

    def look(self, index: int, t: float, side: str = "right") -> Look:
        """The scene at time ``t`` in part ``index``, and its derivatives."""
        if self.scene.samples:
            scene = self._on_piece(float(np.nextafter(t, -np.inf)) if side == "left" else t)
        elif self.course.sight:
            scene = self.course.sight.at(index, t, side)
        else:
            return self.scene, self.of
        if id(scene) not in self._known:
            self._known[id(scene)] = scene, Derivatives(scene, self.parameters)
        return self._known[id(scene)]

    @property
    def restarts(self) -> bool:
        """Whether a jump erases the past, so that the flow jumps with the delayed terms."""
        return self.course.sight is not None and self.course.sight.memory == "restart"

    def _on_piece(self, t: float) -> Scene:
        """The scene with the pieces of the signals that hold at time ``t``."""
        if not self._since <= t < self._there.until:
            self._since, self._there = self.scene.span(t)[0], self.scene.at(t)
        return self._there

    def beside(self, index: int, ends: bool) -> Look:
        """The scene just inside the end of a part (if ``ends``) or its start; and derivatives."""
        return self.look(index, self.moment(index, ends)[1], "left" if ends else "right")

    def moment(self, index: int, ends: bool) -> tuple[float, float]:
        """The time at which a part begins or ends, and a nearby time inside it."""
        part, piece = self.course.parts[index], self.piece(index, ends)
        t = part.t1 if ends else part.t0
        return t, t if piece is None else piece.t + piece.inside(ends)

    # -- jumps ------------------------------------------------------------------------------

    def jump(self, group: Sequence[Row], after: int | None) -> Factor:
        """The factor of one jump or of simultaneous jumps; ``after`` is the part that follows."""
        index, first = group[0]
        field, guard = self.fired(index, first)
        for place, row in group:
            self._require_seen(place, row)
        piece, before = self.piece(index, True), self._flow(index, True)
        waits = self._waits(index, guard, first)
        jumped = piece if piece is not None and self._jumps(index, guard, field, piece) else None
        if self._on_knot(index, guard, first, len(group)):
            time = np.zeros(self.columns)
        elif waits:
            time = np.eye(1, self.columns, self.columns - 1)[0]
        else:
            time = self._time(index, field, guard, first, before, jumped)
        moments, ties = self._moments(group, time, before)
        ties = np.vstack([ties, *self._sides(index, after, moments)])
        resets = np.eye(self.size, self.of.columns, 1)
        for place, row in group:
            resets = after_reset(self._reset(place, row), resets)
        reset = self._widened(resets[:, 1:])
        smooth, saltation = guard.kind in SMOOTH_KINDS and not self.restarts, None
        if not smooth or jumped is not None or waits or len(group) > 1:
            moves = resets[:, 1 : 1 + self.size] @ before + resets[:, 0]
            change = moves - (moves if after is None else self._flow(after, False))
            saltation = Saltation(reset, change, time)
            reset = saltation.matrix
        edges = " ".join(row.edge for _, row in group)
        return Factor(first.t, edges, reset, moments, ties, waits, index, saltation=saltation)

    def _require_seen(self, place: int, row: JumpRow) -> None:
        """Refuse an impact whose gap looks back: its speed depends on how fast the past changes."""
        if self.course.sight is None or self.fired(place, row)[1].kind is not Kind.CONTACT:
            return
        if any(self._asked("gap", row.edge)):
            raise OrbitError(f"{self.model}, t = {row.t!r}: {row.edge} {SEES_RATES}")

    def _on_knot(self, index: int, guard: Guard, row: JumpRow, count: int) -> bool:
        """Whether a knot of a signal releases a contact, or ends sliding, at a time that is the
        same for all neighbouring runs.

        Raises
        ------
        OrbitError
            If something else jumps at a knot: neighbouring runs jump on either side of it.
        """
        if not self.scene.samples or self.scene.span(row.t)[0] != row.t or guard.kind is Kind.CLOCK:
            return False
        if guard.kind in (Kind.RELEASE, Kind.LEAVE) and count == 1:
            return True
        raise OrbitError(
            f"{self.model}, t = {row.t!r}: {guard.edge} fires at a knot of a signal, and for "
            "neighbours before or behind it: there is no first variation"
        )

    def _waits(self, index: int, guard: Guard, row: JumpRow) -> bool:
        """Whether a guard fires because a delayed term of it jumps."""
        if not self.arrival(index, row.t):
            return False
        piece, x = self.piece(index, True), row.before.tolist()
        beyond = row.t + (0.0 if piece is None else piece.beside)
        scene = self.look(index, beyond)[0]
        field = scene.field(self.course.parts[index].mode)
        later = field.guard(guard.edge).value(row.t, x)
        return bool(abs(guard.value(row.t, x)) > SEEN * abs(guard.value(row.t, x) - later))

    def _widened(self, matrix: Matrix) -> Matrix:
        """A matrix; with delays, a 0 column is added for the time at which a delayed term jumps."""
        missing = self.columns - matrix.shape[1]
        return np.pad(matrix, ((0, 0), (0, missing))) if missing else matrix

    def _moments(
        self, group: Sequence[Row], time: Numbers, before: Numbers
    ) -> tuple[tuple[Moment, ...], np.ndarray]:
        """The moments of successive jumps at one time, and the ties that keep them at one time."""
        state = np.eye(self.size, len(time)) + np.outer(before, time)
        moments, ties = [], [np.zeros((0, len(time)))]
        for number, (place, row) in enumerate(group):
            if number:
                ties.append(self._tie(place, row, time, state))
            after = self._reset(place, row) @ self._moved(time, state)
            moments.append(Moment(place, time, state, after))
            state = after
        return tuple(moments), np.vstack(ties)

    def _tie(self, place: int, row: JumpRow, time: Numbers, state: Matrix) -> Matrix:
        """The variation of a guard that is zero after the preceding jump: it must stay zero in
        neighbouring runs. Empty for a guard beyond its zero, which fires in these as well."""
        field, guard = self.fired(place, row)
        of = self.beside(place, True)[1]
        if self._beyond(place, field, guard, row):
            return np.zeros((0, len(time)))
        gradient, moved = of.guard(guard, field)(row.t, row.before), self._moved(time, state)
        return cleared(gradient @ moved, np.abs(gradient) @ np.abs(moved), TIED)

    def _beyond(self, place: int, field: Field, guard: Guard, row: JumpRow) -> bool:
        """Whether a guard fires at a value beyond zero, by more than rounding."""
        x, scene = row.before.tolist(), self.beside(place, True)[0]
        size = scene.rounding(guard, field)(row.t, x)[0]
        return bool(abs(guard.value(row.t, x)) > NEAR * size)

    def fired(self, place: int, row: JumpRow) -> tuple[Field, Guard]:
        """The field and the guard of a jump.

        Raises
        ------
        OrbitError
            If no guard fired: ``zeno='truncate'`` has put the contact to rest.
        """
        field = self.beside(place, True)[0].field(self.course.parts[place].mode)
        if row.edge not in (guard.edge for guard in (*field.guards, *field.clocks)):
            raise OrbitError(
                f"{self.model}, t = {row.t!r}: {row.edge} cuts a series off and has no first "
                "variation; use zeno='rest'"
            )
        return field, field.guard(row.edge)

    def _reset(self, place: int, row: JumpRow) -> Matrix:
        """The derivatives of the state after a jump, at the state before it."""
        kind, of = self.fired(place, row)[1].kind, self.beside(place, True)[1]
        return of.reset(row.edge, kind)(row.t, row.before)

    def _moved(self, time: Numbers, state: Matrix) -> Matrix:
        """The perturbations of time, state, delayed states and parameters, stacked."""
        others = self.of.columns - 1 - self.size
        return np.vstack([time, state, np.eye(others, len(time), self.size)])

    def _time(
        self,
        index: int,
        field: Field,
        guard: Guard,
        row: JumpRow,
        flow: StateVector,
        jumped: ArcPiece | None,
    ) -> Numbers:
        """The variation of the time at which a guard fires. If the guard's value jumps over zero at
        the end of the piece ``jumped``, this is the time at which its formula changes."""
        of = self.beside(index, True)[1]
        if jumped is not None:
            key = "guard", guard.edge, field.name
            kinks = of.kinks(key, field, lambda graph: graph.deciding(guard.edge))
            return self._widened(passing(kinks, jumped, flow)[None])[0]
        if guard.urgent and self._beyond(index, field, guard, row):
            raise OrbitError(
                f"{self.model}, t = {row.t!r}: {row.edge} fires beyond its zero where the run "
                "begins, or goes on from an accumulation: there is no first variation"
            )
        gradient = of.guard(guard, field)(row.t, row.before)[0]
        rate = float(gradient[0] + gradient[1 : 1 + self.size] @ flow)
        if rate == 0.0:
            raise OrbitError(
                f"{self.model}, t = {row.t!r}: the guard of {row.edge} is reached at zero rate; "
                "a grazing jump has no first variation"
            )
        terms = abs(gradient[0]) + np.abs(gradient[1 : 1 + self.size]) @ np.abs(flow)
        if abs(rate) < SLOW_RATE * terms and self._drowned(of, field, guard, row, rate):
            raise OrbitError(
                f"{self.model}, t = {row.t!r}: the guard of {row.edge} is reached so slowly that "
                "rounding of the time hides its rate, and the first variation; let time begin "
                "nearer to 0"
            )
        return self._widened(-gradient[None, 1:] / rate)[0]

    def _drowned(
        self, of: Derivatives, field: Field, guard: Guard, row: JumpRow, rate: float
    ) -> bool:
        """Whether a guard's rate is about what it changes by in a spacing of the time."""
        later = row.t + MANY_SPACINGS * ulp(row.t)
        gradient = of.guard(guard, field)(later, row.before)[0]
        flow = np.array(field.rhs(later, row.before.tolist()))
        then = float(gradient[0] + gradient[1 : 1 + self.size] @ flow)
        return abs(then - rate) > MANY_SPACINGS * USABLE * abs(rate)

    def _jumps(self, index: int, guard: Guard, field: Field, piece: ArcPiece) -> bool:
        """Whether a guard jumps over zero at the end of a piece: its limit there is not zero."""
        if not guard.jumps:
            return False
        taus = [piece.end - piece.beside, piece.end - 2.0 * piece.beside]
        near, far = (guard.value(piece.t + s, piece.segment(s).tolist()) for s in taus)
        x = piece.segment(piece.end)
        scene = self.beside(index, True)[0]
        size = scene.rounding(guard, field)(piece.t + piece.end, x.tolist())[0]
        return bool(abs(2.0 * near - far) > NEAR * size)

    def _sides(self, index: int, after: int | None, moments: Sequence[Moment]) -> list[np.ndarray]:
        """Ties of a jump that coincides with a kink of the flow before or after it: neighbouring
        runs pass the kink on either side of the jump."""
        first, last = moments[0], moments[-1]
        before = self._brinks(index, True)
        found = [before @ self._moved(first.time, first.before)]
        if after is not None:
            found.append(self._brinks(after, False) @ self._moved(last.time, last.after))
        return [cleared(rows, np.abs(rows).max(initial=0.0), TIED) for rows in found]

    def _brinks(self, index: int, ends: bool) -> Matrix:
        """Derivatives of the deciding functions that are zero at the end (if ``ends``) or the start
        of an arc, if the flow jumps at their zero; one row each."""
        (scene, of), piece = self.beside(index, ends), self.piece(index, ends)
        field = scene.field(self.course.parts[index].mode)
        if piece is None or not field.changes:
            return np.zeros((0, self.of.columns))
        at = piece.end if ends else piece.start
        t, x = piece.t + at, piece.segment(at)
        found = of.kinks(("flow", field.name), field, lambda g: g.flow(bool(field.held)))(t, x)
        flow, size = piece.flow(field, ends)
        rates = found[:, 1] + found[:, 2 : 2 + self.size] @ flow
        near = np.abs(found[:, 0]) < piece.beside * np.abs(rates)
        beyond = (1.0 if ends else -1.0) * piece.beside
        beside, far = (field.flow(t + s, x + s * flow) for s in (beyond, 2.0 * beyond))
        other = 2.0 * beside - far
        return found[near, 1:] if np.any(np.abs(other - flow) > NEAR * size) else found[:0, 1:]

    def _flow(self, index: int, ends: bool) -> Numbers:
        """The flow at the end of a part (if ``ends``) or at its start, as a limit from inside."""
        part, piece = self.course.parts[index], self.piece(index, ends)
        field = self.beside(index, ends)[0].field(part.mode)
        if piece is not None and field.changes:
            return piece.flow(field, ends)[0]
        if isinstance(part, TailPart):
            return field.flow(part.t0, part.tail.x)
        t, x = (part.t1, part.last) if ends else (part.t0, part.first)
        return field.flow(t, x)

    def piece(self, index: int, ends: bool) -> ArcPiece | None:
        """The last step of an arc if ``ends``, otherwise the first."""
        part = self.course.parts[index]
        if not isinstance(part, Arc) or not part.segments:
            return None
        changes = self.of.scene.field(part.mode).changes
        segments = resolvable(part.segments) if changes else part.segments
        segment = segments[-1 if ends else 0]
        return ArcPiece(part.t0 + part.low, segment, segment.start, segment.length)
