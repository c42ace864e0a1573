"""Explicit Runge-Kutta pairs as the rules' loop takes them (:mod:`hybrid.rules.pairs`).

The tables are read from the library that has the method. Its dense output is evaluated for a step
of length one whose stages are unit vectors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..rules.arrays import Pair
from ..rules.pairs import PACE_PLACES, STEP_STATES

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix


class PairTables(NamedTuple):
    """A pair: first arrays and first control numbers of :class:`hybrid.rules.arrays.Pair`."""

    matrix: np.ndarray
    fractions: np.ndarray
    errors: np.ndarray
    dense: np.ndarray
    control: tuple[float, ...]

    def pair(self, n: int, rtol: float, atol: Any) -> Pair:
        """The pair for ``n`` states, with work arrays."""
        control = np.array([*self.control, rtol, *np.broadcast_to(atol, n)])
        going, states = np.zeros(PACE_PLACES), np.zeros((STEP_STATES, n))
        rates = np.zeros((len(self.matrix), n))
        matrix, fractions, errors, dense = map(np.ascontiguousarray, self[:4])
        return Pair(matrix, fractions, errors, dense, control, going, states, rates)


#: Stands for a solver whose steps are not Runge-Kutta steps.
NO_TABLES = PairTables(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), ())


def lower(rows: Any, count: int) -> Matrix:
    """A ``count`` by ``count`` matrix from shorter rows, padded with zeros."""
    matrix = np.zeros((count, count))
    for s, row in enumerate(rows):
        matrix[s, : len(row)] = row
    return matrix
