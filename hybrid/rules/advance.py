"""The loop of a run: arc after arc and jump after jump, as far as they are plain.

What is not is left to the driver, which goes on and calls again.
"""

from __future__ import annotations

import math

from .arcs import arc, copied
from .arrays import Automaton, Floats, Left, Now, Room
from .guards import NEAR, largest, row_of
from .jets import OUTPUT, jets
from .places import (
    CONTACT,
    COUNT,
    EDGE,
    ENTERED,
    FIELD,
    FIRED,
    FULL,
    JUMP,
    JUMPS,
    KIND,
    LAND,
    LANDED,
    LOW,
    PATIENT,
    PROGRAM,
    RESET,
    SERIES,
    SHARE,
    TAU,
    TO,
    TRIED,
    T,
)

__all__ = ("advance",)


def advance(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Go on from ``now``; returns what the driver is asked for (see :mod:`.places`)."""
    status = LANDED
    while status == LANDED:
        if now.ints[JUMPS] == left.fired.shape[0]:
            return FULL
        status = arc(a, run, now, room, left)
        if status == LANDED:
            status = jump(a, run, now, room, left)
    return status


def jump(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Carry out the jump of the guard that fired, and begin the next arc; ``JUMP`` if not plain."""
    guard, place = now.ints[FIRED], now.ints[JUMPS]
    kind, to = a.guards[guard, KIND], a.guards[guard, TO]
    if to < 0 or a.guards[guard, RESET] < 0:
        return JUMP
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    if kind == CONTACT:
        fit = to == now.ints[FIELD] and impact(
            a, run, now, room, t, left.before[place], left.after[place]
        )
    elif kind == EDGE:
        copied(now.end, left.before[place])
        fit = values(a, a.guards[guard, RESET], t, now.end, room, left.after[place])
    else:
        fit = False
    if not fit:
        return JUMP
    stays = kind == CONTACT or unchanged(a, now, room, t, left.before[place], left.after[place])
    left.when[place, 0], left.when[place, 1], left.when[place, 2] = t, low, now.floats[TAU]
    left.fired[place] = guard
    watch(now, guard, kind)
    now.floats[T], now.floats[LOW], now.ints[JUMPS] = t, low, place + 1
    now.ints[FIRED] = guard if stays and to == now.ints[FIELD] else -1
    now.ints[FIELD], now.ints[ENTERED] = to, 0
    copied(left.after[place], now.x)
    for i in range(now.x.shape[0]):
        now.seen[i] = max(now.seen[i], abs(now.x[i]))
    return LANDED


def after(t: float, low: float, duration: float) -> tuple[float, float]:
    """A time in two floats plus a duration, without rounding (two-sum, Knuth)."""
    total = t + duration
    back = total - t
    low = (t - (total - back)) + (duration - back) + low
    now = total + low
    return now, low - (now - total)


def values(a: Automaton, program: int, t: float, x: Floats, room: Room, written: Floats) -> bool:
    """The state that a program gives; whether it is finite."""
    if jets(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return False
    first = a.programs.index[program, OUTPUT]
    fit = True
    for i in range(written.shape[0]):
        written[i] = room.aside[a.programs.output[first + i], 0]
        fit = fit and math.isfinite(written[i])
    return fit


def impact(
    a: Automaton, run: Floats, now: Now, room: Room, t: float, before: Floats, behind: Floats
) -> bool:
    """The states before and after an impact; whether the next flight is one like others (7).

    It is not where impacts may be summed from here, or where it is so low that the gap would drown
    in the rounding of the state.
    """
    guard, n = now.ints[FIRED], now.x.shape[0]
    if not values(a, a.guards[guard, LAND], t, now.end, room, before):
        return False
    program = a.guards[guard, RESET]
    if not values(a, program, t, before, room, behind):
        return False
    speed = room.aside[a.programs.output[a.programs.index[program, OUTPUT] + n], 0]
    count = now.ints[COUNT] + 1 if guard == now.ints[SERIES] else 1
    tried = now.floats[TRIED] if count > 1 else math.inf
    if not speed > 0.0 or (count >= run[PATIENT] and speed <= run[SHARE] * tried):
        return False
    flow = a.fields[now.ints[FIELD], PROGRAM]
    if jets(a.programs, flow, 2, t, behind, room.still, room.aside, room.work) < 0:
        return False
    fall = -2.0 * room.aside[row_of(a, flow, now.ints[FIELD], guard), 2]
    return speed * speed > NEAR * fall * max(largest(now.seen), largest(behind))


def unchanged(a: Automaton, now: Now, room: Room, t: float, before: Floats, behind: Floats) -> bool:
    """Whether a reset leaves its guard where it is."""
    field = now.ints[FIELD]
    program = a.fields[field, PROGRAM]
    row = row_of(a, program, field, now.ints[FIRED])
    jets(a.programs, program, 0, t, before, room.still, room.aside, room.work)
    here = room.aside[row, 0]
    jets(a.programs, program, 0, t, behind, room.still, room.aside, room.work)
    return here == room.aside[row, 0]


def watch(now: Now, guard: int, kind: int) -> None:
    """Count the impacts of a series: of one contact, with no other jump between."""
    if kind != CONTACT:
        now.ints[SERIES] = -1
    elif guard == now.ints[SERIES]:
        now.ints[COUNT] += 1
    else:
        now.ints[SERIES], now.ints[COUNT], now.floats[TRIED] = guard, 1, math.inf
