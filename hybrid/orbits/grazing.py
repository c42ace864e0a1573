"""Guards that an orbit touches, or nearly: there its multipliers say little of what is near."""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..arcs import Arc
from ..scene import Field, Guard, Scene
from ..segment import Segment, from_values, nodes
from ..trajectory import Trajectory
from .variation import SMOOTH

#: A guard's rate at a jump, against its largest, below which the jump is said to graze; the
#: square of this is what a guard that turns back has come to, against its largest value.
GRAZES = 1e-3

#: Degree at which a guard is sampled along a step.
DEGREE = 16


@attrs.frozen(eq=False)
class Along:
    """A guard along the arcs of a mode: Chebyshev series, one a step, and its time scale."""

    field: Field
    guard: Guard
    series: list[tuple[float, Segment, np.ndarray]]

    @property
    def largest(self) -> float:
        """Its largest value, nearly."""
        return max(float(np.abs(series).sum()) for *_, series in self.series)

    @property
    def fastest(self) -> float:
        """Its largest rate, nearly."""
        slopes = [(s, chebyshev.chebder(series)) for _, s, series in self.series]
        return max(float(np.abs(slope).sum()) * 2.0 / s.length for s, slope in slopes)

    def nearest(self) -> Iterator[tuple[float, float]]:
        """Times and values where it comes near to zero and turns back."""
        bound = GRAZES**2 * self.largest
        for t, segment, series in self.series:
            points = turning(series)
            values = chebyshev.chebval(points, series)
            bends = chebyshev.chebval(points, chebyshev.chebder(series, 2))
            near = (values * bends > 0) & (np.abs(values) <= bound)
            for xi, value in zip(points[near].tolist(), values[near].tolist(), strict=True):
                yield t + segment.start + 0.5 * (xi + 1.0) * segment.length, value


def turning(series: np.ndarray) -> np.ndarray:
    """Where a Chebyshev series has zero slope, inside (-1, 1)."""
    slope = chebyshev.chebtrim(chebyshev.chebder(series), 1e-16 * float(np.abs(series).max()))
    if len(slope) < 2:
        return np.empty(0)
    roots = chebyshev.chebroots(slope)
    real = roots.real[np.abs(roots.imag) <= 1e-6]
    return real[np.abs(real) < 1.0]


def grazing(scene: Scene, run: Trajectory) -> list[str]:
    """Sentences on guards that a run touches, or reaches almost without speed."""
    found: list[str] = []
    summed = {edge for point in run.zeno for edge in point.edges}
    for along in _guards(scene, run):
        edge = along.guard.edge
        for t, value in along.nearest():
            near = f"comes to {abs(value):.2g} of zero at t = {t:.9g} and turns back"
            found.append(f"the guard of {edge} {near}")
        if along.guard.kind in SMOOTH or edge in summed:
            continue
        for index, row in run.own_jumps.items():
            if row.edge != edge or run.parts[index].mode != along.field.name:
                continue
            rate, fastest = abs(along.guard.lie(row.t, row.before.tolist())[1]), along.fastest
            if rate <= GRAZES * fastest:
                found.append(
                    f"{edge} at t = {row.t:.9g} is near to grazing: its guard is reached at "
                    f"{rate:.3g}, where it changes as fast as {fastest:.3g} along the orbit"
                )
    return found


def _guards(scene: Scene, run: Trajectory) -> Iterator[Along]:
    """Every guard along all arcs on which it is watched."""
    arcs = [part for part in run.parts if isinstance(part, Arc) and part.segments]
    for mode in dict.fromkeys(arc.mode for arc in arcs):
        field, alike = scene.field(mode), [arc for arc in arcs if arc.mode == mode]
        for guard in field.guards:
            steps = [(a.t0 + a.low, segment) for a in alike for segment in a.segments]
            yield Along(field, guard, [(t, s, _series(guard, t, s)) for t, s in steps])


def _series(guard: Guard, t: float, segment: Segment) -> np.ndarray:
    shares = nodes(DEGREE)
    times = (t + segment.start + segment.length * shares).tolist()
    states = segment.at(shares).tolist()
    values = [guard.value(when, x) for when, x in zip(times, states, strict=True)]
    series: np.ndarray = from_values(DEGREE) @ np.array(values)
    return series
