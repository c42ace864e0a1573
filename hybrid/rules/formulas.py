"""How far functions keep the formulas with which they begin, along a polynomial of the state.

Another solver's step is such a polynomial. Its length says nothing of how far the series along it
converge, so it is looked at in parts.
"""

from __future__ import annotations

from .arrays import Programs, Room
from .checks import decided
from .kinks import count, expanded, first_change, holding, turn
from .lengths import SHORTEST_CUT
from .polynomials import shift

__all__ = ("keeps_formula",)

#: Most parts of another solver's step in which functions are expanded: such steps may be long
#: against the time in which a function changes.
EXPANDED_PARTS = 64


def keeps_formula(p: Programs, program: int, t: float, h: float, room: Room) -> bool:
    """Whether functions keep their formulas along a whole step; also False if it cannot be told.

    Parameters
    ----------
    program : int
        A program of values, without a flow.
    room : Room
        ``c`` has the polynomial of the state, by powers of the time since ``t``; it is overwritten.
    """
    n, done = room.there.shape[0], 0.0
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    for _ in range(EXPANDED_PARTS):
        for i in range(n):
            room.there[i] = room.c[i, 0]
        if expanded(p, program, t + done, room.there, room.sides, room.c, room.work) < 0:
            return False
        same, crossed = formula(p, program, t + done, h - done, room)
        if crossed >= 0 or not same > 0.0:
            return False
        if done + same >= h:
            return True
        turn(p, program, -1, t + done, same, room.c, room.sides)
        for i in range(n):
            shift(room.c[i], same)
        done += same
    return False


def formula(p: Programs, program: int, t: float, h: float, room: Room) -> tuple[float, int]:
    """How far series keep the formula with which they begin, and the kink that ends that, as
    :func:`.kinks.first_change` says; at 0 where what is watched does not follow its series."""
    shortest, crossed = SHORTEST_CUT * h, -1
    if count(p, program) == 0:
        return h, -1
    h = min(h, holding(p, program, room.c))
    while h > shortest:
        h, crossed = first_change(p, program, t, h, room.sides, room.c, room.rows, room.found)
        if decided(
            p, program, t, h, crossed >= 0, room.sides, room.c, room.aside, room.work, room.there
        ):
            return h, crossed
        h *= 0.5
    return 0.0, -1
