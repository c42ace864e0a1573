"""Flights so low that the gap is comparable to the rounding of the state, and the impacts that end
them.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from .arrays import Floats, Ints, Programs, Sums
from .flights import fly
from .guards import NEAR
from .jets import values
from .lengths import LAST_TERMS
from .sums import KICK, ONTO_CONTACT, READ, restitution, turned

__all__ = ("drowns", "hop", "tells")

#: Status besides those of :mod:`.flights`: the speed after the impact is negative or no number.
NO_SPEED = -8

#: A flight clearly drowns, or clearly does not, if it also does with a speed this many times as
#: high, or as low: only a force a thousand times as large would decide otherwise.
BY_FAR = 32.0


def drowns(v: float, force: float, size: float) -> bool:
    """Whether a gap that opens with speed ``v`` against a force stays comparable to the rounding of
    states of a given size (7)."""
    return 0.0 < v * v <= -NEAR * force * size


def tells(v: float, force: float, size: float) -> bool:
    """Whether the force of the previous flight (0 if unknown) decides if one drowns: clearly yes,
    or clearly no."""
    high = not drowns(v / BY_FAR, force, size)
    return force < 0.0 and (high or drowns(v * BY_FAR, force, size))


def hop(
    p: Programs,
    flow: int,
    at: int,
    column: int,
    held: bool,
    t: float,
    x: Floats,
    v: float,
    rounding: float,
    signs: Ints,
    before: Floats,
    after: Floats,
    room: Sums,
) -> tuple[int, float, float, int]:
    """Fly from a contact by series in which gap and gap speed are coordinates of their own (7).

    Parameters
    ----------
    flow, at, column, held
        As :func:`.sums.close` takes them.
    signs, rounding
        As :func:`.flights.fly` takes them.
    before, after : Floats
        Get the states before and after the impact at the end.

    Returns
    -------
    status, time, speed, pieces
        0, or negative if the flight cannot be flown here; its duration; the gap speed after the
        impact; the number of pieces of it in ``room``.
    """
    status, time, u, pieces, _ = fly(
        p, flow, column, held, t, x, v, room.low, room.series, signs, rounding, LAST_TERMS, room
    )
    if status < 0 or pieces > 1:  # it is long, or has kinks on the way
        status, time, u, pieces, _ = fly(
            p, flow, column, held, t, x, v, room.c, room.series, signs, rounding, LAST_TERMS, room
        )
    if status < 0:
        return status, time, 0.0, 0
    end, read, n = t + time, room.lines[READ], x.shape[0]
    values(p, at + ONTO_CONTACT, end, room.end, room.sides, room.c, room.work, before)
    speed = restitution(p, at, end, before, u, room) * -u
    if not speed >= 0.0:
        return NO_SPEED, time, speed, pieces
    values(p, at + KICK, end, before, room.sides, room.c, room.work, read)
    for j in range(n):
        after[j] = before[j]
    turned(after, speed - read[n], read)
    return 0, time, speed, pieces
