"""How a jump, or an accumulation of impacts, maps a change of the state at equal times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..rules.limits import DIFFERENCE_ROUNDING

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers


def cleared(matrix: Matrix, sizes: np.ndarray, relative: float) -> Matrix:
    """A matrix with entries at rounding level set to 0, so that a singular matrix stays so."""
    return np.where(np.abs(matrix) <= relative * sizes, 0.0, matrix)


@attrs.frozen(eq=False)
class Saltation:
    """The matrix ``own + shift time``, applied summand by summand.

    At a slow impact ``time``, which is the gradient of the gap over its speed, is large, and a
    change that has come along the run has a small product with it: the rounding of the whole
    matrix would exceed that.

    Attributes
    ----------
    own : array, shape (n, m)
    shift : array, shape (n,)
        How the state changes if the jump comes later.
    time : array, shape (m,)
        Variation of the time of the jump.
    """

    own: Matrix
    shift: Numbers
    time: Numbers

    def applied(self, change: Matrix) -> Matrix:
        """The product with a change, without what is rounding of its terms."""
        own, later = self.own @ change, np.outer(self.shift, self.time @ change)
        return cleared(own + later, np.abs(own) + np.abs(later), DIFFERENCE_ROUNDING)

    @property
    def matrix(self) -> Matrix:
        """The matrix."""
        return self.applied(np.eye(len(self.time)))
