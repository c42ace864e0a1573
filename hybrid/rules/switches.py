"""On the surface of a switching: cross it, or slide along it (8).

Each of the two flows leads to the side given by the first derivative of the surface function along
it that does not vanish.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .entries import start
from .guards import row_of, sizes_of
from .jets import afresh
from .places import AT, CROSSING, FIELD, FIELD_PROGRAM, FIRED, TO

__all__ = ("follows", "goes")

#: What follows when a flow has reached the surface: the other mode; sliding; nothing decides.
CROSSES, SLIDES, UNSETTLED = range(3)


def follows(a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats) -> int:
    """What follows at a state on the surface whose guard has fired."""
    guard = now.ints[FIRED]
    order, _ = heads(a, room, now.ints[FIELD], guard, t, x)
    other, sign = heads(a, room, a.guards[guard, TO], a.guards[guard, AT], t, x)
    return goes(order, other, sign, a.guards[guard, CROSSING])


def goes(order: int, other: int, sign: int, crossing: int) -> int:
    """What follows when a flow has reached the surface.

    Parameters
    ----------
    order, other : int
        The powers of the time by which the surface function vanishes along the flow that has
        reached it, and along that of the other mode.
    sign : int
        The sign that it takes along the latter; 0 if no derivative decides.
    crossing : int
        The sign that it has on the other side.
    """
    if sign == crossing:
        return CROSSES
    return UNSETTLED if sign == 0 or order > 1 < other else SLIDES


def heads(
    a: AutomatonArrays, room: Room, field: int, guard: int, t: float, x: Floats
) -> tuple[int, int]:
    """The power of the time by which a guard that is zero vanishes along a field, and the sign that
    it takes; sign 0 if nothing decides."""
    program, order = a.fields[field, FIELD_PROGRAM], room.c.shape[1] - 1
    size, rate, bend = sizes_of(a, room, guard, t, x)
    fit = afresh(a.programs, program, order, t, x, room.sides, room.c, room.work) == 0
    if not fit or not size < math.inf:
        return 0, 0
    c = room.c[row_of(a, program, field, guard)]
    n, value, slope = x.shape[0], c[0], c[1]
    return start(c, room.c, n, value, slope, t, size, rate, bend, 0.0, math.inf, 1, 0)
