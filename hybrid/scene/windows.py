"""Numbers of the windows through which delays look back: see :mod:`hybrid.run.memory`."""

from __future__ import annotations

import numpy as np

from ..automaton.past import DEGREE

#: What a window may differ from the record, against the tolerance of a step.
SHARE = 0.1

#: Rounding of a window's series, relative to what it shows.
ROUNDING = 1e-15

#: Order of an element that is smooth.
SMOOTH = 10**6


def _to_powers() -> np.ndarray:
    """From Chebyshev coefficients to those of powers of the place in the window."""
    columns = [np.polynomial.chebyshev.cheb2poly(row) for row in np.eye(DEGREE + 1)]
    return np.array([np.pad(column, (0, DEGREE + 1 - len(column))) for column in columns]).T


TO_POWERS = _to_powers()
