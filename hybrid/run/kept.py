"""The steps that the loop leaves in its arrays, as pieces of dense output."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..segment import nodes, terms
from ..trajectory.log import Steps

if TYPE_CHECKING:
    from ..rules.arrays import Left

#: Steps as they are left: their arcs, when they begin and how long they are, and their series.
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]


class KeptSteps:
    """Turns the loop's steps into dense output, arc by arc.

    An arc may take more steps than the arrays hold. Those of the arc that is still open are held
    until it ends.

    Parameters
    ----------
    n : int
        The dimension of the state.
    dense : bool
        Whether dense output is kept; otherwise steps are only counted.
    shares : bool
        Whether a step's polynomial is one in shares of the step, as other solvers' are; otherwise
        it is a Taylor series in the time.

    Attributes
    ----------
    count : int
        Steps held of the open arc.
    """

    def __init__(self, n: int, dense: bool, shares: bool) -> None:
        self.n, self.dense, self.shares = n, dense, shares
        self.forget()

    def forget(self) -> None:
        """Hold nothing."""
        self.held: list[Rows] = []
        self.count = 0

    def hold(self, left: Left, arc: int) -> int:
        """Hold the steps of an arc that goes on; returns how many there are in the arrays."""
        rows = left.owner == arc
        made = int(np.count_nonzero(rows))
        self.count += made
        if self.dense:
            self.held.append(self._rows(left, rows, arc))
        return made

    def take(self, left: Left, made: int, begin: int, end: int) -> tuple[Steps | None, int]:
        """The steps of the arcs from ``begin`` to ``end``, if they are kept, and how many; ``made``
        are in the arrays. The first arc has those held."""
        first, last = left.owner[: max(made, 0)].searchsorted((begin, end)).tolist()
        count, held = self.count + last - first, self.held
        self.forget()
        if not (self.dense and count):
            return None, count
        return self._joined([*held, self._rows(left, slice(first, last), begin)]), count

    def take_until(self, left: Left, made: int, arc: int, tau: float) -> tuple[Steps | None, int]:
        """The steps of an arc that begin before a local time, and how many."""
        first, before = int(left.owner[: max(made, 0)].searchsorted(arc)), self.count
        steps, _ = self.take(left, made, arc, arc + 1)
        count = before + int(np.count_nonzero(left.spans[first : max(made, 0), 0] < tau))
        return steps and Steps(*(column[steps.start < tau] for column in steps)), count

    def _rows(self, left: Left, rows: slice | np.ndarray, begin: int) -> Rows:
        """Steps as they are left, those of arc ``begin`` being the first's."""
        series = left.series.reshape(-1, self.n, left.series.shape[1])[rows]
        return left.owner[rows] - begin, left.spans[rows], series

    def _joined(self, parts: list[Rows]) -> Steps:
        """Steps of arcs in a row, of which only the last part holds more than the first arc, as
        states at the nodes of each."""
        owner, spans, series = map(np.concatenate, zip(*parts, strict=True))
        start, length = spans.T
        if not self.shares:
            series = terms(series, length[:, None, None])
        else:  # a method's own degree
            used = np.flatnonzero(series.any(axis=(0, 1)))
            series = series[..., : max(used.max(initial=0), 1) + 1]
        degree = series.shape[2] - 1
        powers = nodes(degree)[:, None] ** np.arange(degree + 1)
        return Steps(owner, start, length, np.einsum("sik,jk->sji", series, powers))
