"""One step along a flow by its Taylor series.

It is as long as the last two terms stay below rounding, or a tolerance, and as the polynomial
follows the flow: a force may be flat to rounding before it changes. It ends at a kink (``abs``,
``where``), beyond which the other branch is expanded (:mod:`.kinks`).
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .checks import arrives, follows
from .jets import KINKS
from .kinks import (
    KINK_ROW,
    NOT_FINITE,
    SIDE_BLUR,
    count,
    crossed_to,
    expanded,
    first_change,
    holding,
    states,
)
from .lengths import SHORTEST_CUT, tolerated_length

__all__ = ("step",)

#: Status code besides those of :mod:`.kinks`: no step can be made.
NO_STEP = -3

#: No step is shorter: numbers next to the smallest have too few digits.
SHORTEST_STEP = 1e-300


def step(
    p: Programs,
    program: int,
    held: bool,
    t: float,
    tau: float,
    x: Floats,
    most: float,
    loss: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
    rows: Matrix,
    found: Matrix,
    end: Floats,
) -> tuple[int, float, int]:
    """A step from ``(t, x)``, no longer than ``most``.

    Parameters
    ----------
    held : bool
        As :func:`.checks.follows` takes it.
    tau
        The time since the arc began, to which a step adds something.
    loss
        As :func:`.lengths.tolerated_length` takes it.
    sides
        As :func:`.jets.jets` takes them; they are left as the step began with them, for
        :func:`.kinks.turn`.
    c
        Gets the series: as many rows as the program has, and a column for each coefficient.
    aside, work
        To work in: as many rows as ``c``, and two columns; room for equations, and behind it a
        place for each element of the state and each kink.
    rows, found
        As :mod:`.zeros` takes them.
    end
        Gets the state at the end of the step; it may be ``x``.

    Returns
    -------
    status, length, kink
        0, or why there is no step; its length; the kink that it ends on, or -1.
    """
    h = 0.0
    crossed = -1
    for _ in range(2 * count(p, program) + 1):
        status = expanded(p, program, t, x, sides, c, work)
        if status == 0:
            status, h, crossed = _length(
                p, program, held, t, tau, most, loss, sides, c, aside, work, rows, found
            )
        if status < 0:
            return status, 0.0, -1
        if crossed < 0 or tau + h > tau:
            break
        row = p.kinks[p.index[program, KINKS] + crossed, KINK_ROW]
        sides[crossed] = crossed_to(c, row, sides[crossed])
    if not h > SHORTEST_STEP or (tau + h == tau and h < most):
        return NO_STEP, 0.0, -1
    if not arrives(p, program, t, h, crossed < 0, sides, c, aside, work, end):
        return NOT_FINITE, 0.0, -1
    return 0, h, crossed


def _length(
    p: Programs,
    program: int,
    held: bool,
    t: float,
    tau: float,
    most: float,
    loss: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
    rows: Matrix,
    found: Matrix,
) -> tuple[int, float, int]:
    """The status of a step, its length, at most ``most``, and the kink that ends it."""
    longest, crossed = tolerated_length(c, states(p, program), loss, most), -1
    watched = count(p, program) > 0
    if watched:
        longest = min(longest, holding(p, program, c))
    h, tried, least = longest, math.inf, SHORTEST_CUT * longest
    while h > least:
        if watched:
            h, crossed = first_change(p, program, t, h, sides, c, rows, found)
        if tried == math.inf:  # a kink may be far nearer than the series reaches
            least = SHORTEST_CUT * h
        if math.isnan(h):
            return NOT_FINITE, h, -1
        if h == 0.0:
            return NO_STEP, h, -1
        if crossed >= 0 and h <= SIDE_BLUR * abs(t):
            return 0, h, crossed
        rounded = (tau + h) - tau  # as the time will be
        h = rounded if 0.0 < rounded < min(most, tried) else h
        if follows(p, program, held, t, h, crossed >= 0, sides, c, aside, work):
            return 0, h, crossed
        h, tried = 0.5 * h, h
    return NO_STEP, 0.0, -1
