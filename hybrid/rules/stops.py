"""The end of a flow that comes to rest in finite time, as the level of a tank that runs empty.

Such is ``h' = -sqrt(max(h, 0))``: its series beside the place of rest reach no further than to it.
Once the rest of the way is within rounding of the time, the state goes on with the rate that it
has, to where there is none. A rate that turns there instead is that of another flow, which leads
back.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .checks import along, look, place, rate_of
from .kinks import ZERO_SPACINGS, states
from .weak import few_terms, forget
from .zeros import EPS

__all__ = ("stop",)


def stop(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    x: Floats,
    most: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> float:
    """The length of a step within rounding of the time behind which rates are zero that were not;
    0 if there is none. Arguments as :func:`.steps.step`."""
    first, n = place(p, program, work), states(p, program)
    point, h = work[first : first + n], (tau + ZERO_SPACINGS * EPS * max(abs(t), tau)) - tau
    for i in range(n):
        point[i] = x[i]
    forget(sides)
    if not 0.0 < h <= most or not few_terms(p, program, t, point, sides, c, work):
        return 0.0
    for row in range(c.shape[0]):
        c[row, 2] = 0.0
    along(c, h, point)
    look(p, program, 0, t + h, point, False, sides, aside, work)
    for row in range(n + 1, c.shape[0]):
        rise = (aside[row, 0] - c[row, 0]) / h
        c[row, 1] = rise if math.isfinite(rise) else 0.0
    forget(sides)
    return h if _rests(p, program, c, aside) else 0.0


def _rests(p: Programs, program: int, c: Matrix, aside: Matrix) -> bool:
    """Whether some rates have become zero, and none has turned."""
    found = False
    for i in range(states(p, program)):
        rate = rate_of(p, program, i, aside, 0)
        if not math.isfinite(rate) or rate * c[i, 1] < 0.0:
            return False
        found = found or (rate == 0.0 and c[i, 1] != 0.0)
    return found
