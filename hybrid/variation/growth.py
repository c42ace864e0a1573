"""Growth of an orthonormal frame of perturbations along a run, for Lyapunov exponents."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import OrbitError
from ..trajectory.arcs import Arc, Part
from .walk import Factor

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, StateVector

#: Growth of a direction relative to the largest entry of the same piece's matrix below which it
#: counts as rounding (some 50 roundings). And the largest logarithm of the ratio of growths within
#: a piece: longer pieces are divided, so that each direction keeps eight digits.
LOST_GROWTH, GROWN_APART = 1e-14, 18.0

#: Fraction of a run that is left out as a transient, unless a transient is given.
TRANSIENT = 0.1


def first_frame(size: int, count: int) -> Matrix:
    """Orthonormal random directions, shape ``(size, count)``; the same at every call."""
    frame: Matrix = np.linalg.qr(np.random.default_rng(0).normal(size=(size, count)))[0]
    return frame


def largest(parts: Sequence[Part]) -> StateVector:
    """The largest absolute value of each state element at ends of parts and middles of steps."""
    ends = [part.last for part in parts]
    arcs = (part for part in parts if isinstance(part, Arc))
    inside = [s(s.start + 0.5 * s.length) for arc in arcs for s in arc.segments]
    sizes: np.ndarray = np.abs(np.array(ends + inside)).max(axis=0)
    return sizes


def grown(
    model: str, pieces: Iterable[Factor], frame: Matrix, sizes: StateVector
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Carry a frame along a run, orthonormalising it after each piece.

    Parameters
    ----------
    model : str
        Name of the model, for messages.
    frame : array, shape (n, k)
        Orthonormal directions, in states divided by ``sizes``: units then do not matter.

    Returns
    -------
    times, growth, frame : array, shapes (pieces,), (pieces, k) and (n, k)
        End times of the pieces, logarithms of the growth of each direction, and the final frame.

    Raises
    ------
    OrbitError
        If along a smooth piece a direction shrinks below rounding relative to another.
    """
    times, growth, units = [], [], np.where(sizes == 0.0, 1.0, sizes)
    for factor in pieces:
        matrix = factor.matrix * units / units[:, None]
        frame, upper = np.linalg.qr(factor.applied(frame * units[:, None]) / units[:, None])
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
