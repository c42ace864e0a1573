"""The first variation along one period of a model with delays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..errors import OrbitError
from ..lowering import Scene
from ..result import Trajectory
from ..trajectory.arcs import Arc
from ..variation import Carried, Course, PastVariation, Shift, Strand, Walk

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix


def carried(
    run: Trajectory,
    now: Matrix,
    strands: Sequence[Strand],
    shifts: Sequence[Shift] = (),
    breaks: Iterable[float] = (),
) -> tuple[Carried, PastVariation]:
    """Carry perturbations of a run's start and history along the run to its end.

    Parameters
    ----------
    now : array, shape (n, m)
        Variation of the state at the start, as a linear function of ``m`` numbers.
    strands, shifts
        Variation of the history, and of the times of its jumps.
    breaks : iterable of float
        Breaking points of the variation of the history.

    Raises
    ------
    OrbitError
        If there is no first variation, or the run passes an accumulation.
    """
    for part in run.parts:
        if not isinstance(part, Arc):
            raise OrbitError(
                f"{run.spec.model}: the orbit passes an accumulation of impacts at "
                f"t = {part.t1:.9g}; with delays its multipliers are not available"
            )
    walk = Walk(Course.of(None, run))
    size = max(np.abs(part.first).max() for part in run.arcs) or 1.0
    past = PastVariation(
        walk, np.zeros((0, now.shape[1])), np.full(now.shape[1], size), strands, shifts, breaks
    )
    found = Carried(walk, now, past.given)
    found.remember(past)
    for moment in found.moments():
        if found.none.any():
            raise OrbitError(
                f"{run.spec.model}, t = {run.parts[moment.part].t1!r}: two events happen at the "
                "same instant, but one after the other for neighbours: there is no first variation"
            )
    n = walk.size
    found.saltations = [attrs.evolve(f, matrix=f.matrix[:, :n]) for f in found.saltations]
    return found, past


def require_constant(scene: Scene) -> None:
    """Raise an :class:`OrbitError` if a lag depends on time or state."""
    for lag, moves in zip(scene.spec.lags, scene.code.moving, strict=True):
        if moves:
            raise OrbitError(
                f"{scene.spec.model}: the lag {lag.name} depends on time or state; orbits are "
                "known for constant lags"
            )
