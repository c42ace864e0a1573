"""Guards that an orbit touches or nearly touches, where its multipliers may be misleading."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..events import turning_points
from ..lowering import Field, Guard
from ..result import Trajectory
from ..result.standing import SAMPLED_DEGREE
from ..segment import from_values, nodes
from ..trajectory.arcs import Arc
from ..variation.walk import SMOOTH_KINDS

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: A jump is nearly grazing if the guard's rate is below this fraction of its largest rate. A guard
#: without a jump is nearly touched if it turns back at a value below the square of this fraction of
#: its largest value.
GRAZES = 1e-3


@attrs.frozen(eq=False)
class Step:
    """A guard along a step of an arc: its Chebyshev series, and its values at some times."""

    start: float
    length: float
    series: Numbers
    times: Numbers
    values: Numbers


@attrs.frozen(eq=False)
class Along:
    """A guard along the arcs of a mode, each a list of steps."""

    field: Field
    guard: Guard
    arcs: list[list[Step]]

    @property
    def largest(self) -> float:
        """The largest absolute value of the guard at the sampled points."""
        return max(float(np.abs(step.values).max()) for arc in self.arcs for step in arc)

    @property
    def fastest(self) -> float:
        """An upper bound on the guard's rate."""
        steps = [step for arc in self.arcs for step in arc]
        return max(2.0 / s.length * np.abs(chebyshev.chebder(s.series)).sum() for s in steps)

    def nearest(self) -> Iterator[tuple[float, float]]:
        """Time and value of each point at which the guard turns back near zero.

        This is the extremum nearest to zero between two points at which the guard is far from zero.
        At a kink between two steps the guard may turn back without an extremum inside either step:
        it does if it has the same sign before and after.
        """
        bound = GRAZES**2 * self.largest
        for arc in self.arcs:
            times, values = (
                np.concatenate([getattr(step, of) for step in arc]) for of in ("times", "values")
            )
            far = np.abs(values) > bound
            times, values = times[far], values[far]
            found: dict[int, list[tuple[float, float]]] = {}
            for step in arc:
                for t, value in _turned(step, bound):
                    found.setdefault(int(np.searchsorted(times, t)), []).append((t, value))
                if abs(value := float(step.values[0])) <= bound:
                    after = int(np.searchsorted(times, step.start))
                    if values[after - 1 : after + 1].prod() > 0.0:
                        found.setdefault(after, []).append((step.start, value))
            for after, near in found.items():
                if 0 < after < len(times):
                    yield min(near, key=lambda one: abs(one[1]))


def _turned(step: Step, bound: float) -> Iterator[tuple[float, float]]:
    """Time and value of the extrema of a guard inside a step at which it is nearly zero."""
    points = turning(step.series)
    values = chebyshev.chebval(points, step.series)
    bends = chebyshev.chebval(points, chebyshev.chebder(step.series, 2))
    near = (bends != 0.0) & (np.abs(values) <= bound)
    for xi, value in zip(points[near].tolist(), values[near].tolist(), strict=True):
        yield step.start + 0.5 * (xi + 1.0) * step.length, value


def turning(series: Numbers) -> Numbers:
    """The places of the extrema of a Chebyshev series inside (-1, 1)."""
    return 2.0 * np.array(turning_points(series)) - 1.0


def near_grazing(run: Trajectory) -> list[str]:
    """Sentences about guards that a run nearly touches, or crosses at very low speed."""
    found: list[str] = []
    summed = {edge for point in run.zeno for edge in point.edges}
    for along in _guards(run):
        edge = along.guard.edge
        for t, value in along.nearest():
            near = f"comes to {abs(value):.2g} of zero at t = {t:.9g} and turns back"
            found.append(f"the guard of {edge} {near}")
        if along.guard.kind in SMOOTH_KINDS or edge in summed:
            continue
        for index, row in run.own_jumps.items():
            if row.edge != edge or run.parts[index].mode != along.field.name:
                continue
            field = run.hindsight.at(index, row.t, "left").field(along.field.name)
            guard = field.guards[field.column(edge)]
            rate, fastest = abs(guard.lie(row.t, row.before.tolist())[1]), along.fastest
            if rate <= GRAZES * fastest:
                found.append(
                    f"{edge} at t = {row.t:.9g} is near to grazing: its guard is reached at "
                    f"{rate:.3g}, where it changes as fast as {fastest:.3g} along the orbit"
                )
    return found


def _guards(run: Trajectory) -> Iterator[Along]:
    """Each guard along all arcs of each mode in which it is watched."""
    parts = enumerate(run.parts)
    arcs = [(i, part) for i, part in parts if isinstance(part, Arc) and part.segments]
    for mode in dict.fromkeys(arc.mode for _, arc in arcs):
        field = run.hindsight.scene.field(mode)
        alike = [(i, arc) for i, arc in arcs if arc.mode == mode]
        for guard in field.guards:
            yield Along(field, guard, [_steps(run, guard, i, arc) for i, arc in alike])


def _steps(run: Trajectory, guard: Guard, index: int, arc: Arc) -> list[Step]:
    shares, found = nodes(SAMPLED_DEGREE), []
    looks = any(run.hindsight.scene.code.asked(guard.closed))
    for segment in arc.segments:
        start = arc.t0 + arc.low + segment.start
        times, states = start + segment.length * shares, segment.at(shares)
        pairs = zip(times.tolist(), states.tolist(), strict=True)
        value = _looking(run, guard, index, arc.mode) if looks else guard.value
        values = np.array([value(t, x) for t, x in pairs])
        found.append(
            Step(start, segment.length, from_values(SAMPLED_DEGREE) @ values, times, values)
        )
    return found


def _looking(run: Trajectory, guard: Guard, index: int, mode: str) -> Callable[..., float]:
    """A function ``(t, x) -> value`` of a guard that depends on the past."""

    def value(t: float, x: list[float]) -> float:
        field = run.hindsight.at(index, t).field(mode)
        return float(field.guards[field.column(guard.edge)].value(t, x))

    return value
