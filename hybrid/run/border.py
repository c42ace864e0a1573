"""The border of a mode beyond which its flow has no values, as a root has none below zero.

An edge that leads over such a border, ``(-x)**1.5`` while ``x < 0``, is zero where the flow ends. A
solver's steps come as near as rounding to it, but not beyond, where an edge is usually seen to have
fired; and a state that a jump has put on it may be beyond by rounding.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from ..events import fires
from ..lowering import Field

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: Roundings of the time between the border and a state that is on it: the shortest step of SciPy's
#: methods is ten.
BORDER = 64.0


def leaving(field: Field, t: float, x: StateVector) -> tuple[int, int, float] | None:
    """The edge that fires where the flow ends: its index, its direction and the time left to it,
    which is rounding.

    None if the flow goes on, or ends where no edge leads over the border.
    """
    near = BORDER * float(np.spacing(abs(t)))
    flow = field.flow(t, x)
    ahead = x + 2.0 * near * flow
    if all(map(isfinite, field.rhs(t + 2.0 * near, ahead.tolist()))):
        return None
    for index, guard in enumerate(field.guards):
        value, rate, _ = guard.lie(t, x.tolist())
        if not isfinite(rate) or rate == 0.0:
            continue
        left, direction = -value / rate, int(np.sign(rate))
        at_zero = abs(left) <= near and fires(guard.crossing, direction)
        if at_zero and guard.holds(t, x.tolist()):
            return index, direction, left
    return None


def within(field: Field, t: float, x: StateVector) -> StateVector:
    """The state, or, if rounding has put it beyond the border of its mode, where it is a few
    roundings of the time later."""
    flow, spacing = field.flow(t, x), float(np.spacing(abs(t)))
    known, roundings, there = np.isfinite(flow), 1.0, x
    finite = known.all()
    while not finite and roundings <= BORDER:
        there = x + np.where(known, roundings * spacing * flow, 0.0)
        finite, roundings = np.isfinite(field.rhs(t, there.tolist())).all(), 2.0 * roundings
    return there
