"""The first variation along a piece of an arc by power series, where the flow has them."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..rules import unit
from ..scene.tape import Jets
from ..solvers.taylor_backend import HIGHEST

if TYPE_CHECKING:
    from .arcs import Piece


@attrs.frozen(eq=False, slots=False)
class Series:
    """The flow of a field and its derivatives, as a program (:mod:`hybrid.rules.variation`).

    Attributes
    ----------
    jets : Jets
        The derivatives that are not always zero are its functions.
    places : array of int, shape (k, 2)
        Of each its row and its column.
    shape : (int, int)
        Rows and columns: of all derivatives, the columns of parameters behind those of the state.
    change : array, shape (columns - rows, m), optional
        Of directions, which then stand for the parameters.
    """

    jets: Jets
    places: np.ndarray
    shape: tuple[int, int]
    change: np.ndarray | None = None

    @cached_property
    def _room(self) -> tuple[np.ndarray, ...]:
        """Arrays to work in."""
        tape, (rows, columns) = self.jets.tape, self.shape
        return (
            np.zeros(len(tape.kinks), dtype=np.int64),
            np.empty((tape.rows, HIGHEST + 1)),
            np.empty(tape.room),
            np.empty((rows * columns, HIGHEST + 1)),
            np.empty((2 * rows, columns)),
        )

    def carried(self, piece: Piece) -> np.ndarray | None:
        """The matrix of a piece on which no formula changes; None where there are no series."""
        found, inside, start = np.empty(self.shape), piece.start, piece.first
        beside = start.copy()
        if len(self._room[0]):
            inside += piece.beside
            beside = piece.segment(inside)
        when = piece.t + piece.start, start, piece.length, piece.t + inside, beside
        status = unit("variation").carried(self.jets.alone, *when, self.places, *self._room, found)
        if status != 0:
            return None
        if self.change is None:
            return found
        own = self.shape[0]
        return np.hstack([found[:, :own], found[:, own:] @ self.change])
