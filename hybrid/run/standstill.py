"""States at which a flow comes to stand still in finite time.

Friction that goes with a root of the speed, or two vessels that level out, are at rest after a
finite time, where the flow has no Taylor series and steps become ever shorter. There the run goes
on at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..lowering import Field, Kink
from ..lowering.lowered import ORDER
from ..rules import unit

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: Steps of Newton's method onto the zeros of all deciding functions, and onto one by an element:
#: each makes that smaller by the digits of a slope, until it is no more than the smallest float.
STEPS_TOGETHER, STEPS_ALONE = 6, 32

#: A difference for slopes, relative to the state; a power of two, which leaves them most digits.
DIFFERENCE = 2.0**-10


def standstill(field: Field, t: float, x: StateVector, allowed: StateVector) -> StateVector | None:
    """A state as near as ``allowed`` at which all that the deciding functions next to zero decide
    on is zero, and the flow, which leads back to it from beside it; None if there is none."""
    if field.jets is None or field.project is not None or field.leans:
        return None
    there = _onto([k for k in field.changes if _is_near(k, t, x, allowed)], t, x)
    if there is None or not np.all(np.abs(there - x) <= allowed) or np.any(field.flow(t, there)):
        return None
    c, aside, work, _, _, sides, _, _ = field.jets.room(ORDER)
    stands = unit("weak").stands(field.jets.alone, 0, t, there, sides, c, aside, work)
    return there if stands else None


def _is_near(kink: Kink, t: float, x: StateVector, allowed: StateVector) -> bool:
    """Whether a deciding function is zero somewhere as near as ``allowed``, by its slopes."""
    value, slopes = kink.value(t, x.tolist()), _slopes(kink, t, x)
    return bool(np.isfinite(slopes).all() and abs(value) <= np.abs(slopes) @ allowed)


def _slopes(kink: Kink, t: float, x: StateVector) -> StateVector:
    """The derivatives of a deciding function by the state, as differences."""
    found = np.zeros(len(x))
    for i in kink.uses:
        by = np.zeros(len(x))
        by[i] = DIFFERENCE * (np.abs(x).max() or 1.0)
        ahead, behind = (kink.value(t, (x + way * by).tolist()) for way in (1.0, -1.0))
        found[i] = (ahead - behind) / (2.0 * by[i])
    return found


def _onto(kinks: list[Kink], t: float, x: StateVector) -> StateVector | None:
    """The state moved onto the zeros of deciding functions, to the last bit: by the shortest way,
    then by one element of each; None if they do not all become zero, or there are none."""
    slopes = np.array([_slopes(kink, t, x) for kink in kinks])
    for _ in range(STEPS_TOGETHER if kinks else 0):
        values = np.array([kink.value(t, x.tolist()) for kink in kinks])
        x = x - np.linalg.lstsq(slopes, values)[0]
    for kink, own in zip(kinks, slopes, strict=True):
        i = int(np.argmax(np.abs(own)))
        for _ in range(STEPS_ALONE):
            if own[i] and (value := kink.value(t, x.tolist())):
                x = x.copy()
                x[i] -= value / own[i]
    return x if kinks and not any(kink.value(t, x.tolist()) for kink in kinks) else None
