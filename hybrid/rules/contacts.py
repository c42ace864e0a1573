"""Held contacts: the projection onto them, which of them a jump leaves closed, and which join them.

A field with held contacts leads to those with one contact fewer through their loads, and to those
with one more through the gaps. A set that is missing in the tables is asked for.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .guards import row_of, sizes_of
from .jets import OUTPUT, afresh
from .places import (
    ABSOLUTE,
    BASE,
    CONSTRAINED,
    FIELD,
    FIELD_PROGRAM,
    GUARDS,
    GUARDS_END,
    HARD,
    JOINED,
    JOINS,
    KIND,
    LACKING,
    LACKING_AT,
    MADE,
    MAKE,
    NONE,
    ONTO_GAPS,
    ONTO_SPEEDS,
    OWN,
    PLAIN,
    RELATIVE,
    RELEASE,
    REST,
    SURFACE,
    TO,
    TOLERANCES,
    UNKNOWN,
    USES,
    USES_END,
    WANTED,
    T,
)

#: A step of another solver may leave what holds the state by so many of its tolerances: methods
#: keep an estimate of their error within one, and are off by a few.
STRAYS = 64.0

#: A held contact stays closed if gap and gap speed are below this share of the sums of their
#: absolute terms, at the largest states seen.
CLOSED = 1e-12


def values(
    a: AutomatonArrays, program: int, t: float, x: Floats, room: Room, written: Floats
) -> bool:
    """Evaluate a program at a state; returns whether the result is finite."""
    if afresh(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return False
    first = a.programs.index[program, OUTPUT]
    fit = True
    for i in range(written.shape[0]):
        written[i] = room.aside[a.programs.output[first + i], 0]
        fit = fit and math.isfinite(written[i])
    return fit


def onto(a: AutomatonArrays, field: int, t: float, x: Floats, room: Room, written: Floats) -> bool:
    """Project a state onto the held contacts of a field, or onto the surface on which it slides;
    returns whether the result is finite."""
    surface = a.fields[field, SURFACE]
    gaps, speeds = a.fields[field, ONTO_GAPS], a.fields[field, ONTO_SPEEDS]
    if surface >= 0:
        return values(a, surface, t, x, room, written)
    for i in range(x.shape[0]):
        written[i] = x[i]
    if gaps < 0:
        return True
    fit = values(a, gaps, t, written, room, written) and values(a, gaps, t, written, room, written)
    return fit and values(a, speeds, t, written, room, written)


def asks(now: Now, guard: int, column: int) -> int:
    """Ask for a missing entry of the table of guards."""
    now.ints[LACKING], now.ints[LACKING_AT] = guard, column
    return MAKE


def twin(a: AutomatonArrays, field: int, own: int) -> int:
    """The guard of an edge or contact in another field of the same mode; ``HARD`` if there is
    none."""
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if a.guards[g, OWN] == own:
            return g
    return HARD


def still_held(a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats) -> int:
    """The field in which those contacts stay held that a jump has left closed; the state is
    projected onto them. ``UNKNOWN`` if it is missing, ``HARD`` if Python must decide."""
    field = now.ints[FIELD]
    g = a.fields[field, GUARDS]
    while g < a.fields[field, GUARDS_END]:
        if a.guards[g, KIND] == RELEASE and not closed(a, now, room, a.guards[g, REST], t, x):
            if a.guards[g, TO] == UNKNOWN:
                asks(now, g, TO)
                return UNKNOWN
            field = a.guards[g, TO]
            if a.fields[field, PLAIN] == 0:
                return HARD
            g = a.fields[field, GUARDS]
        else:
            g += 1
    return field if onto(a, field, t, x, room, x) else HARD


def closed(a: AutomatonArrays, now: Now, room: Room, guard: int, t: float, x: Floats) -> bool:
    """Whether gap and gap speed of a contact are zero."""
    field = a.fields[now.ints[FIELD], BASE]
    program = a.fields[field, FIELD_PROGRAM]
    high, fast, _ = sizes_of(a, room, guard, t, x)
    far, faster, _ = sizes_of(a, room, guard, t, now.seen)
    high = max(high, far) if far < math.inf else high
    fast = max(fast, faster) if faster < math.inf else fast
    if afresh(a.programs, program, 1, t, x, room.still, room.aside, room.work) < 0:
        return False
    row = row_of(a, program, field, guard)
    return abs(room.aside[row, 0]) <= CLOSED * high and abs(room.aside[row, 1]) <= CLOSED * fast


def strays(a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float) -> bool:
    """Whether other solvers' steps have left what holds the state by more than they may have lost,
    where one ends: it may have a corner or a jump that no formula tells."""
    field, most = now.ints[FIELD], STRAYS * (now.ints[MADE] + 1)
    if a.fields[field, CONSTRAINED] == 0:
        return False
    if a.fields[field, SURFACE] >= 0:
        if not onto(a, field, t, now.end, room, room.there):
            return True
        for i in range(now.end.shape[0]):
            allowed = run[TOLERANCES + i] + run[RELATIVE] * abs(now.end[i])
            if not abs(room.there[i] - now.end[i]) <= most * allowed:
                return True
        return False
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if a.guards[g, KIND] == RELEASE and opens(a, run, now, room, a.guards[g, REST], t, most):
            return True
    return False


def opens(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int, t: float, most: float
) -> bool:
    """Whether the gap of a contact held, or its speed, is off zero by more than ``most``
    tolerances where a step ends. A speed that is less has moved the gap all along the arc."""
    field, size = a.fields[now.ints[FIELD], BASE], 0.0
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        size = max(size, max(now.seen[a.uses[k]], abs(now.end[a.uses[k]])))
    high, fast, _ = sizes_of(a, room, guard, t, now.end)
    program = a.fields[field, FIELD_PROGRAM]
    if size == 0.0 or not high < math.inf:
        return False
    if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return True
    row, share = row_of(a, program, field, guard), run[RELATIVE] + run[ABSOLUTE] / size
    gap, speed = abs(room.aside[row, 0]), abs(room.aside[row, 1])
    moved = (t - now.floats[T]) * speed
    return not (speed <= most * share * fast and gap <= most * share * high + moved)


def joined(a: AutomatonArrays, now: Now, room: Room, guard: int) -> int:
    """Hold another contact at the start of an arc: returns ``JOINED``; ``WANTED`` if the field is
    missing; ``HARD`` if Python must decide, and nothing has changed."""
    if a.fields[now.ints[FIELD], JOINS] == 0:
        return HARD
    rest = a.guards[guard, REST]
    if rest == UNKNOWN:
        asks(now, guard, REST)
        return WANTED
    if rest == NONE or a.fields[rest, PLAIN] == 0:
        return HARD
    if not onto(a, rest, now.floats[T], now.x, room, room.there):
        return HARD
    for i in range(now.x.shape[0]):
        now.x[i] = room.there[i]
    now.ints[FIELD] = rest
    return JOINED
