"""The first variation along a piece of an arc, by power series."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..lowering.tape import Jets
from ..rules import unit
from ..rules.arrays import Changes
from ..rules.limits import LIMIT_LINES, LIMIT_SMALL
from ..rules.limits import MOST_POINTS as POINTS
from ..solvers.taylor_backend import HIGHEST

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Matrix
    from .arcs import ArcPiece


def room_for(
    needs: Sequence[int], read: int, states: int, columns: int, along: int = 0, points: int = 0
) -> Changes:
    """Work arrays for carrying perturbations along arcs and through limits of impacts.

    Parameters
    ----------
    needs
        Sizes of the largest program, as in :attr:`.Tape.needs`.
    read : int
        Most numbers that a program returns.
    columns, along : int
        Number of columns for time, states and parameters; number of parameter directions, if any.
    points : int
        Number of points at which the limit of impacts is collocated; 0 if there are no limits.
    """
    rows, kinks, beside = needs
    own, wide = 1 + states, max(columns, 1 + states + along)
    narrow = 1 + states + along if along else columns
    squares, most = points * own, max(points, states)
    return Changes(
        c=np.empty((rows, HIGHEST + 1)),
        work=np.empty(beside),
        sides=np.zeros(kinks, dtype=np.int64),
        read=np.empty(max(read, wide)),
        orders=np.empty((HIGHEST + 1, own * columns)),
        terms=np.empty((own * columns, HIGHEST + 1)),
        aside=np.empty((2 * own, columns)),
        piece=np.empty((own, columns)),
        flight=np.empty((own, columns)),
        before=np.empty((own, columns)),
        after=np.empty((1 + own, columns)),
        lines=np.empty((LIMIT_LINES, wide)),
        maps=np.empty(((1 + points) * own, wide)),
        rest=np.empty((own, wide)),
        now=np.empty((own, narrow)),
        last=np.empty((own, narrow)),
        best=np.empty((own, narrow)),
        lower=np.empty((1 + points, 1 + points)),
        small=np.empty((LIMIT_SMALL, 1 + points)),
        equations=np.empty((max(squares, most), max(squares, most))),
        right=np.empty((squares, own)),
        shares=np.empty((most, max(own * (narrow - own), 1 + columns))),
        known=np.zeros(1 + points, dtype=np.int64),
        arc=np.empty((states, columns - 1)),
        state=np.empty((own, columns + 1)),
        moved=np.empty((own, columns + 1)),
        out=np.empty((2 * own, columns)),
    )


@attrs.frozen(eq=False, slots=False)
class Series:
    """The flow of a field and its derivatives, as a program (:mod:`hybrid.rules.variation`).

    Attributes
    ----------
    jets : Jets
        The program; its functions are the derivatives that are not identically zero.
    places : array of int, shape (k, 2)
        Row and column of each of these derivatives.
    shape : (int, int)
        Rows and columns of all derivatives; the parameters' columns follow those of the state.
    """

    jets: Jets
    places: IntegerMatrix
    shape: tuple[int, int]

    @cached_property
    def _room(self) -> Changes:
        """Work arrays."""
        rows, columns = self.shape
        return room_for(self.jets.tape.needs, len(self.places), rows, 1 + columns)

    def carried(self, piece: ArcPiece) -> Matrix | None:
        """The matrix of a piece without a kink inside; None if the series do not reach its end."""
        found, inside, start = np.empty(self.shape), piece.start, piece.first
        beside = start.copy()
        if len(self._room.sides):
            inside += piece.beside
            beside = piece.segment(inside)
        when = piece.t + piece.start, start, piece.length, piece.t + inside, beside
        program = self.jets.alone, 0, self.places
        status = unit("variation").carried(*program, *when, self._room, found)
        return found if status == 0 else None


__all__ = ["POINTS", "Series", "room_for"]
