"""One step along a flow by its Taylor series.

It is as long as the last two terms stay below rounding, or a tolerance, and as the polynomial
follows the flow: a force may be flat to rounding before it changes. It ends at a kink (``abs``,
``where``), beyond which the other branch is expanded (:mod:`.kinks`).
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .checks import ROUNDING_BESIDE, arrives, beside, follows, led, look, place
from .jets import KINKS
from .kinks import (
    KINK_ROW,
    NO_SERIES,
    NOT_FINITE,
    SIDE_BLUR,
    SWITCHES,
    ZERO_SPACINGS,
    count,
    crossed_to,
    expanded,
    first_change,
    holding,
    kink_row,
    states,
)
from .lengths import SHORTEST_CUT, SHORTEST_STEP, time_scale, tolerated_length
from .polynomials import power_value
from .stops import stop
from .weak import forget, weak_step
from .zeros import EPS

__all__ = ("step",)

#: Halvings in which the place is found where a flow ceases to be finite: each step towards it
#: leaves this power of two of the way.
BISECTIONS = 20

#: Status code besides those of :mod:`.kinks`: no step can be made.
NO_STEP = -3


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
    status, h, crossed = 0, 0.0, -1
    for _ in range(2 * count(p, program) + 1):
        status = _series(p, program, t, tau, x, crossed, sides, c, aside, work)
        if status == 0:
            status, h, crossed = _length(
                p, program, held, t, tau, most, loss, sides, c, aside, work, rows, found
            )
        if status < 0 or crossed < 0 or tau + h > tau:
            break
        side = crossed_to(c, kink_row(p, program, crossed), sides[crossed])
        begun(p, program, c, aside)
        if put_beyond(p, program, crossed, side, t, tau, 0.0, x, c, aside, end):
            x = end
            expanded(p, program, t, x, sides, c, work)
            begun(p, program, c, aside)
        sides[crossed] = side
    if status == 0 and (not h > SHORTEST_STEP or (tau + h == tau and h < most)):
        status = NO_STEP
    seen = status == 0 and crossed < 0
    if status < 0:
        h, crossed = weak_step(p, program, held, t, tau, x, most, sides, c, aside, work), -1
        if h == 0.0:
            h = stop(p, program, t, tau, x, most, sides, c, aside, work)
        if h == 0.0:
            return status, 0.0, -1
    if not arrives(p, program, t, h, seen, sides, c, aside, work, end):
        h, crossed = before_border(p, program, t, tau, h, sides, c, aside, work, end), -1
        if h == 0.0 or not follows(p, program, held, t, h, -1, sides, c, aside, work):
            return NOT_FINITE, 0.0, -1
    if crossed >= 0:
        side = crossed_to(c, kink_row(p, program, crossed), sides[crossed])
        put_beyond(p, program, crossed, side, t, tau, h, end, c, aside, end)
    return 0, h, crossed


def put_beyond(
    p: Programs,
    program: int,
    crossed: int,
    side: int,
    t: float,
    tau: float,
    h: float,
    x: Floats,
    c: Matrix,
    aside: Matrix,
    end: Floats,
) -> bool:
    """Write into ``end`` the state just beyond a kink on which a step has ended at ``x``, if by its
    value in ``aside`` it is still before it: the flow leads there in a time below rounding. Returns
    whether it was.

    Where the rate goes with a root of the distance that little is not nothing: there the formula
    beyond would be asked for a state at which it does not hold.
    """
    order, row = c.shape[1] - 1, kink_row(p, program, crossed)
    off, (_, rate) = aside[row, 0], power_value(c[row], 0, order, h)
    if not (side * off < 0.0 and side * rate > 0.0):
        return False
    more = (1.0 + ZERO_SPACINGS * EPS) * abs(off / rate)
    if more > SIDE_BLUR * max(abs(t), tau):
        return False
    for i in range(x.shape[0]):
        end[i] = x[i] + more * power_value(c[i], 0, order, h)[1]
    return True


def _series(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    x: Floats,
    turned: int,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> int:
    """The series with which a step begins, and a status as :func:`.kinks.expanded`; ``turned`` as
    :func:`forgotten` takes it."""
    status = expanded(p, program, t, x, sides, c, work)
    if status == NO_SERIES and turned < 0:  # the kink that ended the last step may be ahead
        forget(sides)
        status = expanded(p, program, t, x, sides, c, work)
    elif status == NO_SERIES:
        status = a_little_later(p, program, t, tau, x, sides, c, aside, work)
    if status == 0 and forgotten(p, program, t, tau, x, turned, sides, c, aside, work):
        status = expanded(p, program, t, x, sides, c, work)
    return status


def before_border(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
    end: Floats,
) -> float:
    """The length of a step that ends shortly before the flow ceases to be finite, as it does at its
    end, and the state there; 0 if that is no farther than rounding."""
    inside = 0.0
    for _ in range(BISECTIONS):
        middle = (tau + 0.5 * (inside + h)) - tau
        if arrives(p, program, t, middle, False, sides, c, aside, work, end):
            inside = middle
        else:
            h = middle
    if inside > 0.0:
        arrives(p, program, t, inside, False, sides, c, aside, work, end)
    return inside


def a_little_later(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> int:
    """Expand where the state is the first roundings of the time later at which there are series:
    rounding has put it before a kink that has been passed, where the formula beyond has no value.
    Returns a status as :func:`.kinks.expanded`."""
    first = place(p, program, work)
    point, most = work[first : first + x.shape[0]], ZERO_SPACINGS * EPS * max(abs(t), tau)
    later = EPS * max(tau, SHORTEST_STEP)
    while later <= 2.0 * most:
        led(p, program, t, x, later, point, sides, aside, work)
        if expanded(p, program, t + later, point, sides, c, work) == 0:
            return 0
        later *= 2.0
    return NO_SERIES


def begun(p: Programs, program: int, c: Matrix, aside: Matrix) -> None:
    """Put down the values of watched functions where a step begins."""
    for j in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        aside[p.kinks[j, KINK_ROW], 0] = c[p.kinks[j, KINK_ROW], 0]


def forgotten(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    x: Floats,
    turned: int,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Forget the sides of kinks that are not zero where a step begins, as another that is zero
    there has changed their own formula; returns whether there are any.

    ``turned``: the one that has turned there since the values in ``aside`` were put down, or -1.
    """
    first, found, known = p.index[program, KINKS], False, False
    for i in range(count(p, program)):
        known = known or sides[i] != 0
    if known and turned < 0:
        rounded(p, program, t, x, sides, c, aside, work)
    for i in range(count(p, program)):
        row = p.kinks[first + i, KINK_ROW]
        if sides[i] != 0:
            off = abs(c[row, 0] - aside[row, 0])
            stale = i != turned and off > 0.0
            if turned < 0:
                scale = max(abs(t), tau, time_scale(c[row]))
                moved = ZERO_SPACINGS * EPS * scale * abs(c[row, 1])
                stale = abs(c[row, 0]) > ROUNDING_BESIDE * off + moved
            if stale:
                sides[i], found = 0, True
    return found


def rounded(
    p: Programs,
    program: int,
    t: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> None:
    """Put down the values of watched functions beside the start of a step, each with the formula
    that it has at the start."""
    first, place_of = p.index[program, KINKS], place(p, program, work)
    point = work[place_of : place_of + states(p, program)]
    for i in range(point.shape[0]):
        point[i] = x[i]
    for i in range(count(p, program)):
        row = p.kinks[first + i, KINK_ROW]
        aside[row, 1] = sides[i]
        if sides[i] == 0 and c[row, 0] != 0.0 and p.kinks[first + i, SWITCHES] == 1:
            sides[i] = 1 if c[row, 0] > 0.0 else -1
    look(p, program, 0, beside(t, point), point, True, sides, aside, work)
    for i in range(count(p, program)):
        sides[i] = int(aside[p.kinks[first + i, KINK_ROW], 1])


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
        if crossed >= 0:
            scale = max(abs(t), time_scale(c[kink_row(p, program, crossed)]))
            if h <= SIDE_BLUR * scale:
                return 0, h, crossed
        rounded = (tau + h) - tau  # as the time will be
        h = rounded if 0.0 < rounded < min(most, tried) else h
        if follows(p, program, held, t, h, crossed, sides, c, aside, work):
            return 0, h, crossed
        h, tried = 0.5 * h, h
    return NO_STEP, 0.0, -1
