"""The first variation along a run with delays.

A change ``d`` of the record is carried along an arc by ``d' = A d + sum of B_k d(t - lag_k)``, by
collocation at Chebyshev points; what it asks of the past it finds in its own earlier pieces. At a
jump the saltation matrix (:mod:`hybrid.variation`) takes part of what was seen as well. A jump that
comes later by ``s`` is a jump of the record that is seen later by ``s``, a lag after it ::

    d+ = d- + (f- - f+) s            f before and after what is seen has jumped

With ``memory="restart"`` what a flow sees after a jump is the state after it, whose change is
``d+ + f+ s``, and nothing else of the past. See ``docs/notes/orbits.md``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..arcs import Arc, JumpRow
from ..errors import OrbitError
from ..scene import Field, Guard, Scene
from ..segment import from_values, integrals, nodes
from ..trajectory import Trajectory
from ..variation import Derivatives, Factor

#: Degree of the collocation on a step.
DEGREE = 14

#: Steps are halved until their last coefficients are this small, relative; and most halvings.
RESOLVED, DEPTH = 1e-12, 6

#: Breaking points are followed through this many lags.
GENERATIONS = 6

#: Times nearer than this, relative, are one.
SAME = 1e-13

#: Where in a step, from its ends, its side of a breaking point is told.
INSIDE = 1e-6

#: A change of the flow below this, relative, is none.
NOTHING = 1e-9


@attrs.frozen(eq=False)
class Strand:
    """A change between two times: values at Chebyshev points, shape ``(degree + 1, n, m)``."""

    a: float
    b: float
    values: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        degree = len(self.values) - 1
        places = 2.0 * (times - self.a) / (self.b - self.a) - 1.0
        weights = chebyshev.chebvander(places, degree) @ from_values(degree)
        return np.tensordot(weights, self.values, 1)


@attrs.frozen(eq=False)
class Shift:
    """A jump of the record from ``before`` to ``after``, and the change of its time."""

    t: float
    before: np.ndarray
    after: np.ndarray
    row: np.ndarray

    def shows(self, elements: Iterable[int]) -> bool:
        """Whether any of some elements jumps."""
        return any(self.before[e] != self.after[e] for e in elements)


def descendants(times: Iterable[float], lags: Sequence[float], last: float) -> list[float]:
    """Breaking points up to a time: those given, and what follows through the lags."""
    found = now = set(times)
    for _ in range(GENERATIONS):
        now = {t + lag for t in now for lag in lags if lag > 0 and t + lag <= last}
        found = found | now
    return distinct(t for t in found if t <= last)


def distinct(times: Iterable[float]) -> list[float]:
    """Times in order, those that are nearly one once."""
    found: list[float] = []
    for t in sorted(times):
        if not found or t - found[-1] > SAME * max(1.0, abs(t)):
            found.append(t)
    return found


class Variation:
    """A change of a run's start and of its past, carried along the run.

    Attributes
    ----------
    now : array, shape (n, m)
        The change of the state, as a linear function of ``m`` numbers.
    strands, shifts
        That of the record, and of the times of its jumps.
    fresh : array, shape (n, m)
        With ``memory="restart"``: that of the state after the last jump.
    saltations : list of Factor
    """

    def __init__(
        self,
        run: Trajectory,
        now: np.ndarray,
        strands: Sequence[Strand],
        shifts: Sequence[Shift] = (),
        breaks: Iterable[float] = (),
    ) -> None:
        self.run, self.sight = run, run.hindsight
        self.scene: Scene = self.sight.scene
        self.size = run.spec.dimension
        self.now, self.strands, self.shifts = now, list(strands), list(shifts)
        self.fresh, self.saltations = now, list[Factor]()
        self._ends = [strand.b for strand in strands]
        self._known: dict[int, tuple[Scene, Derivatives]] = {}
        rows = [row.t for row in run.own_jumps.values()]
        self.breaks = descendants([run.t0, *rows, *breaks], self.sight.lags, run.t1)
        require_constant(self.scene)
        self._walk()

    @property
    def restarts(self) -> bool:
        """Whether the past is forgotten at jumps."""
        return bool(self.sight.memory == "restart")

    def _walk(self) -> None:
        run, group = self.run, list[tuple[int, JumpRow]]()
        for index, part in enumerate(run.parts):
            if not isinstance(part, Arc):
                raise OrbitError(
                    f"{run.spec.model}: the orbit passes an accumulation of impacts at "
                    f"t = {part.t1:.9g}; its first variation is known without delays only"
                )
            last = index + 1 == len(run.parts)
            if group and (last or part.length):
                self._jump(group, index)
                group = []
            if part.length:
                self._arc(index, part)
            if index in run.own_jumps:
                group.append((index, run.own_jumps[index]))
            elif not last:
                raise OrbitError(
                    f"{run.spec.model}: the orbit passes the limit of a cycle of several edges at "
                    f"t = {part.t1:.9g}, for which no first variation is known"
                )

    # -- along an arc ---------------------------------------------------------------------

    def _arc(self, index: int, arc: Arc) -> None:
        start, end = arc.t0 + arc.low, arc.t0 + (arc.low + arc.length)
        inner = [start + segment.end for segment in arc.segments]
        inner += [b for b in self.breaks if start < b < end]
        inner += [b for b, _ in self._seen_later() if start < b < end]
        room = SAME * max(1.0, abs(end))
        stops = [t for t in distinct(inner) if start + room < t < end - room]
        for a, b in zip([start, *stops], [*stops, end], strict=True):
            self._step(index, arc, a, b, DEPTH)
            self._pass(index, arc, b, end - room)

    def _step(self, index: int, arc: Arc, a: float, b: float, depth: int) -> None:
        """Carry the change over a step, or over its halves if it is not resolved."""
        values = self._collocated(index, arc, a, b)
        series = np.tensordot(from_values(DEGREE), values, 1)
        if depth and np.abs(series[-2:]).max() > RESOLVED * np.abs(series).max():
            middle = 0.5 * (a + b)
            self._step(index, arc, a, middle, depth - 1)
            self._step(index, arc, middle, b, depth - 1)
            return
        self.strands.append(Strand(a, b, values))
        self._ends.append(b)
        self.now = values[-1]

    def _collocated(self, index: int, arc: Arc, a: float, b: float) -> np.ndarray:
        """Values of the change at the Chebyshev points of a step."""
        size, count, points = self.size, DEGREE + 1, nodes(DEGREE)
        times = a + (b - a) * points
        rates = self._rates(index, arc, times, a, b)
        whole = (b - a) * integrals(DEGREE)
        unknown = np.zeros((count, size, count, size))
        unknown[range(count), :, range(count), :] = rates[:, :, :size]
        known = np.zeros((count, *self.now.shape))
        for k, lag in enumerate(self.sight.lags):
            seen = rates[:, :, size * (1 + k) : size * (2 + k)]
            own = (times - lag > a + SAME * max(1.0, abs(a))) | (lag == 0.0)
            within = chebyshev.chebvander(2.0 * (points - lag / (b - a)) - 1.0, DEGREE)
            places = np.where(own[:, None], within @ from_values(DEGREE), 0.0)
            unknown += seen[:, :, None, :] * places[:, None, :, None]
            if not own.all():
                old = self._looked_up(times[~own] - lag, a - lag, min(a, b - lag))
                known[~own] += seen[~own] @ old
        system = np.eye(count * size) - np.tensordot(whole, unknown, 1).reshape(count * size, -1)
        right = self.now + np.tensordot(whole, known, 1)
        return np.linalg.solve(system, right.reshape(count * size, -1)).reshape(right.shape)

    def _rates(self, index: int, arc: Arc, times: np.ndarray, a: float, b: float) -> np.ndarray:
        """Derivatives of the flow by the state and by what is seen, at times of a step."""
        states = arc.local((times - arc.t0) - arc.low)
        inside = np.clip(times, a + INSIDE * (b - a), b - INSIDE * (b - a))
        found = []
        for t, x, near in zip(times.tolist(), states, inside.tolist(), strict=True):
            of = self._through(index, near)[1]
            found.append(of.flow(self.scene.field(arc.mode))(t, x)[:, 1:])
        return np.array(found)

    def _through(self, index: int, t: float, side: str = "right") -> tuple[Scene, Derivatives]:
        """The scene at a time, and its derivatives."""
        scene = self.sight.at(index, t, side)
        if id(scene) not in self._known:
            self._known[id(scene)] = scene, Derivatives(scene)
        return self._known[id(scene)]

    def _looked_up(self, times: np.ndarray, low: float, high: float) -> np.ndarray:
        """The change at earlier times, from the strands between two times."""
        near = INSIDE * max(high - low, 0.0)
        inside = np.clip(times, low + near, high - near)
        which = np.array([min(bisect_left(self._ends, t), len(self._ends) - 1) for t in inside])
        found = np.empty((len(times), *self.now.shape))
        for place in np.unique(which).tolist():
            found[which == place] = self.strands[place](times[which == place])
        return found

    def at(self, times: np.ndarray, low: float, high: float) -> np.ndarray:
        """The change at some times, shape ``(k, n, m)``, on the smooth piece between two times."""
        return self._looked_up(times, low, high)

    # -- jumps that are seen ----------------------------------------------------------------

    def _seen_later(self) -> list[tuple[float, Shift]]:
        """When jumps of the record are seen, by the lags that show what jumps."""
        pairs = list(zip(self.sight.lags, self.scene.code.seen, strict=True))
        return [
            (shift.t + lag, shift)
            for shift in ([] if self.restarts else self.shifts)
            for lag, elements in pairs
            if lag > 0 and shift.shows(elements)
        ]

    def _pass(self, index: int, arc: Arc, t: float, end: float) -> None:
        """What is seen jumps at a time: earlier or later for the neighbours."""
        room = SAME * max(1.0, abs(t))
        shifts = [shift for b, shift in self._seen_later() if abs(b - t) <= room]
        if not shifts:
            return
        x = arc.local(np.array((t - arc.t0) - arc.low)).tolist()
        near = 1e-9 * max(arc.length, room)
        flows = [
            np.array(self._through(index, moment)[0].field(arc.mode).rhs(t, x))
            for moment in (t - near, t + near)
        ]
        change = flows[0] - flows[1]
        if np.abs(change).max() <= NOTHING * (np.abs(flows[0]).max() + np.abs(flows[1]).max()):
            return
        if len(shifts) > 1 or t >= end:
            raise OrbitError(
                f"{self.run.spec.model}, t = {t:.9g}: a jump is seen there just when another "
                "happens or is seen; which is first for a neighbour decides on its derivative"
            )
        self.now = self.now + np.outer(change, shifts[0].row)

    # -- jumps ------------------------------------------------------------------------------

    def _jump(self, group: Sequence[tuple[int, JumpRow]], after: int) -> None:
        """One jump, or several with no time between them."""
        size, (index, first), (_, last) = self.size, group[0], group[-1]
        parts, t = self.run.parts, first.t
        scene, of = self._through(index, t, "left")
        field = scene.field(parts[index].mode)
        guard = field.guards[field.column(first.edge)]
        before = np.array(field.rhs(t, first.before.tolist()))
        later = self.sight.at(after, t).field(parts[after].mode)
        flow = np.array(later.rhs(t, last.after.tolist()))
        gradient = of.guard(guard, field)(t, first.before)[0]
        rate = float(gradient[0] + gradient[1 : 1 + size] @ before)
        if rate == 0.0:
            raise OrbitError(
                f"{self.run.spec.model}, t = {t!r}: the guard of {first.edge} is reached without "
                "speed; a jump that grazes has no first variation"
            )
        changes = np.concatenate([self.now, *self._past(t)])
        row = -gradient[1:] @ changes / rate
        reset = self._reset(group)
        moves = reset[:, 1 : 1 + size] @ before + reset[:, 0]
        matrix = reset[:, 1 : 1 + size] - np.outer(moves - flow, gradient[1 : 1 + size]) / rate
        self.saltations.append(Factor(t, " ".join(jump.edge for _, jump in group), matrix))
        self.fresh = reset[:, 1:] @ changes + np.outer(moves, row)
        self.now = self.fresh - np.outer(flow, row)
        self.shifts.append(Shift(t, first.before, last.after, row))
        if self.restarts:
            self.strands = [Strand(t - 1.0, t, self.fresh[None])]
            self._ends = [t]

    def _past(self, t: float) -> list[np.ndarray]:
        """Changes of what each lag shows at a jump."""
        return [
            self._looked_up(np.array([t - lag]), t - lag, t - lag)[0] if lag > 0 else self.now
            for lag in self.sight.lags
        ]

    def _reset(self, group: Sequence[tuple[int, JumpRow]]) -> np.ndarray:
        """Derivatives of the resets of a group by time, state and what is seen."""
        size = self.size
        total = np.eye(size, 1 + size * (1 + len(self.sight.lags)), 1)
        for index, row in group:
            scene, of = self._through(index, row.t, "left")
            field = scene.field(self.run.parts[index].mode)
            kind = _kind(field, row.edge).kind
            each = of.reset(row.edge, kind)(row.t, row.before)
            total = each[:, 1 : 1 + size] @ total
            total[:, 0] += each[:, 0]
            total[:, 1 + size :] += each[:, 1 + size :]
        return total


def _kind(field: Field, edge: str) -> Guard:
    return field.guards[field.column(edge)]


def require_constant(scene: Scene) -> None:
    """Refuse lags that move."""
    for lag, moves in zip(scene.spec.lags, scene.code.moving, strict=True):
        if moves:
            raise OrbitError(
                f"{scene.spec.model}: the lag {lag.name} depends on time or state; first "
                "variations, and with them orbits, are known for constant lags"
            )
