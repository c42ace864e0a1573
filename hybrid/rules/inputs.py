"""Signals in the loop of a run: from knot to knot, each piece a polynomial in time.

The numbers of a piece are among those of the programs, so that between knots a signal needs no
code. At a knot the next piece is put in, and the arc continues if every guard keeps its sign and
the held contacts stay closed. Otherwise the driver treats the knot.
"""

from __future__ import annotations

from .arcs import copied
from .arrays import (
    AutomatonArrays,
    Floats,
    InputArrays,
    Left,
    Look,
    Now,
    Room,
    Sums,
)
from .clocks import after
from .contacts import closed, onto
from .guards import GUARD_ROUNDING, row_of, sizes_of
from .jets import afresh, put_in
from .places import (
    CONSTRAINED,
    END,
    FIELD,
    FIELD_PROGRAM,
    GUARDS,
    GUARDS_END,
    JUMPS_MADE,
    KIND,
    LAST_TIME,
    LOW,
    MADE,
    PHASE,
    RELEASE,
    REST,
    STEPS_MADE,
    SURFACE,
    TAU,
    WALKS,
    T,
)
from .runs import go
from .ties import ago
from .zeros import EPS

__all__ = ("feed", "through")


def through(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    left: Left,
    sums: Sums,
    look: Look,
    inputs: InputArrays,
) -> int:
    """Go on from ``now`` over the known knots; returns what the driver is asked for.

    ``END`` at a knot that must be looked at, or at the last known one, which is ``LAST_TIME``.
    """
    while True:
        place = inputs.place[0]
        run[LAST_TIME] = inputs.knots[place + 1]
        status = go(a, run, now, room, left, sums, look)
        last = place + 2 >= inputs.knots.shape[0] or inputs.place[1] == 0
        if status != END or last or now.ints[MADE] == 0 or not apart(a, now, room):
            return status
        inputs.place[0] = place + 1
        feed(a, room, inputs)
        if not as_before(a, now, room):
            inputs.place[0] = place
            feed(a, room, inputs)
            return status
        goes_on(now, inputs)


def apart(a: AutomatonArrays, now: Now, room: Room) -> bool:
    """Whether no declared guard is zero where an arc has reached a knot."""
    t, _ = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    for g in range(a.fields[now.ints[FIELD], GUARDS], a.fields[now.ints[FIELD], GUARDS_END]):
        if a.guards[g, KIND] != RELEASE and ago(a, now, room, g, t) == 0.0:
            return False
    return True


def goes_on(now: Now, inputs: InputArrays) -> None:
    """Continue the arc over a knot, and note the place: anything to be judged lies after it."""
    inputs.place[2], inputs.place[3] = now.ints[JUMPS_MADE], now.ints[STEPS_MADE]
    inputs.began[0] = now.floats[TAU]
    copied(now.end, inputs.start)
    now.ints[PHASE] = WALKS
    now.ints[STEPS_MADE] -= now.ints[MADE]


def feed(a: AutomatonArrays, room: Room, inputs: InputArrays) -> None:
    """Pass the numbers of the present piece to the programs."""
    put_in(
        a, room, inputs.pieces[inputs.place[0]], inputs.given, inputs.ranged, inputs.parts,
        inputs.ops, inputs.more, inputs.numbers,
    )  # fmt: skip


def as_before(a: AutomatonArrays, now: Now, room: Room) -> bool:
    """Whether each guard has the same sign after a knot as before it."""
    field = now.ints[FIELD]
    program, first, last = (
        a.fields[field, FIELD_PROGRAM],
        a.fields[field, GUARDS],
        a.fields[field, GUARDS_END],
    )
    t, _ = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    for g in range(first, last):
        if afresh(a.programs, program, 0, t, now.end, room.still, room.aside, room.work) < 0:
            return False
        value = room.aside[row_of(a, program, field, g), 0]
        size, _, _ = sizes_of(a, room, g, t, now.end)
        if not value * now.signs[g - first] > GUARD_ROUNDING * EPS * size:
            return False
    return a.fields[field, CONSTRAINED] == 0 or on_contacts(a, now, room, field, t)


def on_contacts(a: AutomatonArrays, now: Now, room: Room, field: int, t: float) -> bool:
    """Whether the held contacts are closed after a knot too; moves the state onto them."""
    if a.fields[field, SURFACE] >= 0:
        return False
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if a.guards[g, KIND] == RELEASE and not closed(a, now, room, a.guards[g, REST], t, now.end):
            return False
    return onto(a, field, t, now.end, room, now.end)
