"""How much a frame of perturbations grows along a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import OrbitError
from ..trajectory.arcs import Arc, Part
from .walk import Factor

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, StateVector

#: Relative growth of a direction, compared with the largest of the same piece, that counts as
#: rounding: some 50 roundings. Pieces are so short that directions grow apart by less than a
#: ratio whose logarithm this is, which leaves eight digits of each.
LOST_GROWTH, GROWN_APART = 1e-14, 18.0

#: The share of a run at its beginning that is a transient, unless one is given.
TRANSIENT = 0.1


def first_frame(size: int, count: int) -> Matrix:
    """Directions drawn at random, the same each time, orthonormal."""
    frame: Matrix = np.linalg.qr(np.random.default_rng(0).normal(size=(size, count)))[0]
    return frame


def largest(parts: Sequence[Part]) -> StateVector:
    """The largest absolute value of each element along a run, at ends and middles of steps."""
    ends = [part.last for part in parts]
    arcs = (part for part in parts if isinstance(part, Arc))
    inside = [s(s.start + 0.5 * s.length) for arc in arcs for s in arc.segments]
    sizes: np.ndarray = np.abs(np.array(ends + inside)).max(axis=0)
    return sizes


def grown(
    model: str, pieces: Iterable[Factor], frame: Matrix, sizes: StateVector
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """End times of the pieces of a run, logarithms of the frame's growth, and the final frame. It
    is measured in the sizes of the states, so that their units do not matter.

    Raises
    ------
    OrbitError
        If a direction that the flow does not lose is lost to rounding.
    """
    times, growth, units = [], [], np.where(sizes == 0.0, 1.0, sizes)
    for factor in pieces:
        matrix = factor.matrix * units / units[:, None]
        frame, upper = np.linalg.qr(matrix @ frame)
        lengths = np.abs(np.diag(upper))
        lost = lengths <= LOST_GROWTH * np.abs(matrix).max()
        if factor.smooth and lost.any():
            raise OrbitError(
                f"{model}, t = {factor.t:.9g}: within a step a direction shrinks beside "
                f"another by more than rounding leaves of it; ask for the first exponents only "
                f"(count={int(np.argmax(lost)) or 1}), or bound the steps (max_step=)"
            )
        lengths[lost] = 0.0
        with np.errstate(divide="ignore"):
            growth.append(np.log(lengths))
        times.append(factor.t)
    return np.array(times), np.array(growth), frame


__all__ = ["GROWN_APART", "TRANSIENT", "first_frame", "grown", "largest"]
