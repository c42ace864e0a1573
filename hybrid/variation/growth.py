"""How much a frame of perturbations grows along a run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from .walk import Factor

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix

#: Relative growth of a direction, compared with the largest of the same piece, that counts as
#: rounding: some 50 roundings.
LOST_GROWTH = 1e-14

#: The share of a run at its beginning that is a transient, unless one is given.
TRANSIENT = 0.1


def first_frame(size: int, count: int) -> Matrix:
    """Directions drawn at random, the same each time, orthonormal."""
    frame: Matrix = np.linalg.qr(np.random.default_rng(0).normal(size=(size, count)))[0]
    return frame


def grown(pieces: Iterable[Factor], frame: Matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """End times of the pieces of a run, logarithms of the frame's growth, and the final frame."""
    times, growth = [], []
    for factor in pieces:
        frame, upper = np.linalg.qr(factor.matrix @ frame)
        sizes = np.abs(np.diag(upper))
        sizes[sizes <= LOST_GROWTH * np.abs(factor.matrix).max()] = 0.0
        with np.errstate(divide="ignore"):
            growth.append(np.log(sizes))
        times.append(factor.t)
    return np.array(times), np.array(growth), frame


__all__ = ["TRANSIENT", "first_frame", "grown"]
