"""Clocks: edges that fire at given times (4). An arc ends there as it does at the end of a run.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Now, Room
from .guards import TIE, TIED_IN_STEP, holds
from .jets import OUTPUT, afresh
from .places import (
    AT,
    BEGINS,
    CLOCKS_END,
    DUE,
    END,
    EVENT,
    FIELD,
    FIRED,
    FLIGHTS,
    GUARDS,
    GUARDS_END,
    JOINS,
    JUMP,
    LANDED,
    LAST_TIME,
    LOOK,
    LOW,
    MADE,
    METHOD_ORDER,
    NONE,
    OWN,
    PHASE,
    RINGS,
    RUN_END,
    STEP_END,
    STEPS_LOST,
    STEPS_MADE,
    TAU,
    WALKS,
    WATCHED,
    T,
)
from .record import slack
from .ties import ago, hidden_of, near, note_sides
from .zeros import EPS


def after(t: float, low: float, duration: float) -> tuple[float, float]:
    """A time in two floats plus a duration, without rounding (two-sum, Knuth)."""
    total = t + duration
    back = total - t
    low = (t - (total - back)) + (duration - back) + low
    now = total + low
    return now, low - (now - total)


def field_of(a: AutomatonArrays, guard: int) -> int:
    """The field in which a guard, or a clock, is watched."""
    field = 0
    while not a.fields[field, GUARDS] <= guard < a.fields[field, CLOCKS_END]:
        field += 1
    return field


def arc_end(run: Floats, now: Now) -> float:
    """The latest end of an arc: the next ring of a clock, or else the end of the run, of the
    windows of the past or of the piece of a signal."""
    due = now.floats[DUE]
    return due if due <= last_ring(run) else max(run[LAST_TIME], now.floats[T])


def last_ring(run: Floats) -> float:
    """The latest time at which a clock rings before windows, or a piece, end: a ring that only the
    rounding of these times has behind their end is there, and sees what was before."""
    last = run[LAST_TIME]
    return last if last >= run[RUN_END] else min(run[RUN_END], last + slack(last))


def wind(a: AutomatonArrays, now: Now, room: Room, t: float, low: float) -> None:
    """Find the clock that rings first from a time on, and when."""
    field = now.ints[FIELD]
    now.floats[DUE] = math.inf
    for g in range(a.fields[field, GUARDS_END], a.fields[field, CLOCKS_END]):
        spent = now.spent[a.guards[g, OWN]] == now.ints[FLIGHTS]
        due = behind(a, now, room, g, t if spent else math.nextafter(t, -math.inf))
        if (due - t) - low < 0.0:
            due = behind(a, now, room, g, t)
        if due < now.floats[DUE]:
            now.floats[DUE], now.ints[RINGS] = due, g


def rung(a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats) -> bool:
    """Whether a clock fires at a time at which some ring: the first whose condition holds. Those
    whose conditions fail are passed, whatever that one's reset makes of them."""
    field, fires = now.ints[FIELD], NONE
    for g in range(a.fields[field, GUARDS_END], a.fields[field, CLOCKS_END]):
        own = a.guards[g, OWN]
        if now.spent[own] == now.ints[FLIGHTS]:
            continue
        if behind(a, now, room, g, math.nextafter(t, -math.inf)) != t:
            continue
        if not holds(a, room, g, t, x):
            now.spent[own] = now.ints[FLIGHTS]
        elif fires == NONE:
            fires = g
    now.ints[FIRED] = now.ints[RINGS] if fires == NONE else fires
    return fires != NONE


def passed(a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float) -> int:
    """Go on within an arc, over a time of clocks whose conditions fail."""
    plain = run[METHOD_ORDER] == 0.0 and run[WATCHED] == 0.0 and a.fields[now.ints[FIELD], JOINS]
    if not plain:
        now.ints[PHASE] = BEGINS
        return JUMP
    wind(a, now, room, t, 0.0)
    now.ints[STEPS_MADE] -= now.ints[MADE]
    now.ints[PHASE] = WALKS
    return LANDED


def behind(a: AutomatonArrays, now: Now, room: Room, clock: int, t: float) -> float:
    """The first of a clock's times after another; infinite if there is none."""
    program = a.guards[clock, AT]
    if afresh(a.programs, program, 0, t, now.x, room.still, room.aside, room.work) < 0:
        return math.inf
    due = room.aside[a.programs.output[a.programs.index[program, OUTPUT]], 0]
    return due if due > t else math.inf


def beside(now: Now, tau: float) -> bool:
    """Whether a clock rings next to a local time of the last step."""
    left = ((now.floats[DUE] - now.floats[T]) - now.floats[LOW]) - tau
    length = now.floats[STEP_END] - now.floats[TAU]
    return left <= TIED_IN_STEP * length + TIE * EPS * abs(now.floats[T])


def close(a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float) -> bool:
    """Whether a clock rings so soon behind a guard's zero that what another solver's steps have
    lost may hide that they are at one time."""
    left = now.floats[DUE] - t
    if now.floats[STEPS_LOST] == 0.0 or not left < math.inf:
        return False
    way = (t - now.floats[T]) - now.floats[LOW]
    _, rate, hides = hidden_of(a, run, now, room, now.ints[EVENT], t, way)
    return abs(rate) * left <= hides


def ended(a: AutomatonArrays, run: Floats, now: Now, room: Room, length: float) -> int:
    """End an arc at its last time: ``END``, or ``LANDED`` if a clock rings; ``LOOK`` if a guard is
    zero there, too, or may fire before any flow."""
    if now.floats[DUE] > last_ring(run):
        return END
    first, last = a.fields[now.ints[FIELD], GUARDS], a.fields[now.ints[FIELD], GUARDS_END]
    if now.ints[MADE] == 0 and first < last:
        return LOOK
    t = now.floats[T] + length
    for g in range(first, last):
        if ago(a, now, room, g, t) == 0.0 or near(a, run, now, room, g, t):
            return LOOK
    now.ints[FIRED] = now.ints[RINGS]
    if length > 0.0:
        now.ints[FLIGHTS] += 1
        note_sides(a, now, room, t, NONE)
    return LANDED
