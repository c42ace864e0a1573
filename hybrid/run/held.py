"""Whether the state has stayed on what holds it: contacts at rest, or a surface on which it slides.

The flow there keeps gaps and surfaces at zero as far as formulas tell how these move. A corner or a
jump that none of them shows, as ``sqrt(1 - cos(t))`` has one, would be passed without a word: the
projection moves the state back onto the obstacle, whatever that has done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..rules.contacts import STRAYS
from ..rules.zeros import EPS

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Field
    from ..segment import Segment

#: Places in a part of a step, and their weights (Gauss' rule, exact to degree 9).
GAUSS_PLACES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)

#: A part of a step is looked at no closer than this share of the step, or so many spacings of the
#: time: what still moves the state there is a jump.
CLOSEST, CLOSEST_SPACINGS = 1e-9, 64.0


def hidden_corner(field: Field, t: float, segment: Segment, allowed: StateVector) -> float | None:
    """The local time in a step at which what holds the state has a corner or a jump that the flow
    does not follow; None if there is none.

    ``t``: the time from which local times count; ``allowed``: what steps may lose.
    """
    least = max(
        CLOSEST * segment.length, CLOSEST_SPACINGS * float(np.spacing(abs(t) + segment.end))
    )
    parts = [(segment.start, segment.end)]
    while parts:
        begin, end = parts.pop()
        off, rounding = _off(field, t, segment, begin, end)
        if (off <= STRAYS * (allowed + rounding)).all():
            continue
        middle = 0.5 * (begin + end)
        if end - begin <= least:
            return middle
        parts += [(middle, end), (begin, middle)]
    return None


def _off(
    field: Field, t: float, segment: Segment, begin: float, end: float
) -> tuple[StateVector, StateVector]:
    """How far the state on what holds it goes otherwise, in a part of a step, than the flow; and
    the rounding of what that is the difference of, that of the time included."""
    middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
    first = field.along(t + begin, segment(begin))
    last = field.at_end(t + end, segment(end))
    rates = np.array([_rate(field, t + tau, segment(tau)) for tau in middle + half * GAUSS_PLACES])
    moved = last - first - half * (GAUSS_WEIGHTS @ rates)
    late = np.spacing(abs(t) + end) * np.abs(rates).max(axis=0)
    return np.abs(moved), EPS * (np.abs(first) + np.abs(last)) + late


def _rate(field: Field, t: float, x: StateVector) -> StateVector:
    return field.flow(t, field.along(t, x))
