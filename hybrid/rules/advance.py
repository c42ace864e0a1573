"""The loop of a run: arc after arc, jump after jump.

Whatever these rules cannot decide is returned as a status (see :mod:`.places`). Python answers and
calls again. Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arcs import arc, copied
from .arrays import AutomatonArrays, Floats, Left, Now, Room
from .clocks import after, passed, rung
from .contacts import asks, onto, still_held, twin, values
from .guards import row_of, so_far
from .hops import drowns, tells
from .jets import OUTPUT, afresh
from .places import (
    AT,
    BEGINS,
    CLOCK,
    CONTACT,
    DUE,
    EDGE,
    ENTERED,
    FIELD,
    FIELD_PROGRAM,
    FIRED,
    FIRST_SUMMED,
    FLIGHTS,
    FULL,
    GAP_SPEED,
    GUARD_POWER,
    GUARDS,
    GUARDS_END,
    HARD,
    HOPS,
    IMPACT_COUNT,
    JUMP,
    JUMPS_DUE,
    JUMPS_MADE,
    KIND,
    LAND,
    LANDED,
    LAST_USED,
    LASTED,
    LEAVE,
    LOW,
    LOW_AHEAD,
    MAKE,
    NONE,
    ONTO_GAPS,
    OWN,
    PHASE,
    PULL,
    PULLED,
    RATE,
    REACHES,
    RELEASE,
    RESET,
    REST,
    RISES,
    SERIES,
    SHAKEN,
    SPEED_FALL,
    STRIKES,
    SUM,
    SURFACE,
    SWITCH,
    TAU,
    TO,
    TRIED,
    UNKNOWN,
    URGENT,
    USES,
    USES_END,
    VALUE,
    WAS_LOW,
    T,
)
from .switches import CROSSES, SLIDES, follows
from .ties import pending, remembered
from .zeros import EPS

__all__ = ("advance",)

#: Roundings by which a state is moved behind an impact: of its own, and of the gap. Parts of the
#: golden ratio are on either side as often.
SHAKE, GOLDEN = 0.5, 0.618033988749895


def advance(a: AutomatonArrays, run: Floats, now: Now, room: Room, short: Room, left: Left) -> int:
    """Go on from ``now``; returns a status that says what is needed from outside
    (:mod:`.places`)."""
    status = LANDED
    while status == LANDED:
        if now.ints[PHASE] != STRIKES:
            if now.ints[JUMPS_MADE] >= min(run[JUMPS_DUE], left.fired.shape[0]):
                return FULL
            if now.ints[LOW_AHEAD] > 0:
                return HOPS
            status = arc(a, run, now, room, short, left)
        if status == LANDED:
            status = jump(a, run, now, room, left)
    return status


def jump(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Carry out the jump of the guard that fired and begin the next arc.

    Returns ``LANDED``; ``JUMP`` if the jump needs all the rules; ``SUM`` or ``MAKE`` if it is still
    to be made once these are answered.
    """
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    low_flight = now.ints[WAS_LOW] == 1
    # what has been asked for on the way is known: the state is in its place
    fits = low_flight or now.ints[PHASE] == STRIKES
    if a.guards[now.ints[FIRED], KIND] == CLOCK:
        t, low = now.floats[DUE], 0.0
        fits = fits or onto(a, now.ints[FIELD], t, now.end, room, now.end)
        if fits and not rung(a, now, room, t, now.end):
            return passed(a, run, now, room, t)
    guard, place = now.ints[FIRED], now.ints[JUMPS_MADE]
    kind, to = a.guards[guard, KIND], a.guards[guard, TO]
    before, behind = left.before[place], left.after[place]
    status, used, power = JUMP, a.guards[guard, OWN], 1
    made = to != NONE and (kind == RELEASE or a.guards[guard, RESET] >= 0)
    judged = surfaced(a, now, kind) and remembered(a, now, guard)
    if not fits and made and not judged and kind not in (SWITCH, LEAVE, CLOCK):
        fits = onto(a, now.ints[FIELD], t, now.end, room, now.end)
    if judged:
        status = JUMP
    elif kind in (SWITCH, LEAVE):
        status, to, used, power = on_surface(a, now, room, t, before, behind)
    elif made and fits and to == UNKNOWN:
        status = asks(now, guard, TO)
    elif made and fits:
        if kind == RELEASE:
            status, used = LANDED, a.guards[guard, REST]
            rises = now.floats[TAU] > 0.0 and not beyond(a, now, guard)
            power = RISES if rises else PULLED
            copied(now.end, before)
            copied(now.end, behind)
        elif kind in (EDGE, CLOCK):
            copied(now.end, before)
            late = kind == EDGE and beyond(a, now, guard) and now.floats[TAU] == 0.0
            if not late and values(a, a.guards[guard, RESET], t, now.end, room, behind):
                status, to = stays(a, now, room, t, behind, to)
                held = kind == EDGE and unchanged(a, now, room, t, before, behind)
                power = 1 if held and not beyond(a, now, guard) else 0
        elif to == now.ints[FIELD]:
            status, to = impact(a, run, now, room, t, before, behind)
            power = 1 if now.floats[GAP_SPEED] > 0.0 else PULLED
    now.ints[PHASE] = BEGINS if status in (LANDED, JUMP) else STRIKES
    if status != LANDED:
        return status
    added(now, left, guard, t, low)
    own = a.guards[guard, OWN]
    now.tied[own], now.touched[own], now.spent[own] = 0, 0, now.ints[FLIGHTS]
    watch(a, now, room, guard, to, t, before, behind)
    entered(a, now, to, used, power, t, low, behind)
    return LANDED


def surfaced(a: AutomatonArrays, now: Now, kind: int) -> bool:
    """Whether a jump leaves or enters a surface of a switching, where the same edges have other
    guards."""
    return kind in (SWITCH, LEAVE) or a.fields[now.ints[FIELD], SURFACE] >= 0


def on_surface(
    a: AutomatonArrays, now: Now, room: Room, t: float, before: Floats, behind: Floats
) -> tuple[int, int, int, int]:
    """The jump from the surface of a switching (8); the state does not change.

    Returns a status, the field that follows, the guard of the surface there, and the power of the
    time by which it vanishes.
    """
    guard = now.ints[FIRED]
    to, own, slides = a.guards[guard, TO], a.guards[guard, AT], a.guards[guard, REST]
    if own < UNKNOWN or (a.guards[guard, KIND] == SWITCH and beyond(a, now, guard)):
        return JUMP, to, own, 0
    if own == UNKNOWN or to == UNKNOWN:
        return asks(now, guard, AT if own == UNKNOWN else TO), to, own, 0
    fit = onto(a, now.ints[FIELD], t, now.end, room, before)
    copied(before, behind)
    if a.guards[guard, KIND] == LEAVE:
        return LANDED if fit else JUMP, to, own, 1 if beyond(a, now, guard) else 2
    what = follows(a, now, room, t, before)
    if what == CROSSES:
        return LANDED, to, own, 1
    if what == SLIDES and slides == UNKNOWN:
        return asks(now, guard, REST), to, own, 0
    if what != SLIDES or slides < 0 or a.fields[slides, SURFACE] < 0:
        return JUMP, to, own, 0
    fit = onto(a, slides, t, now.end, room, before)
    copied(before, behind)
    return LANDED if fit else JUMP, slides, NONE, 0


def entered(
    a: AutomatonArrays,
    now: Now,
    field: int,
    own: int,
    power: int,
    t: float,
    low: float,
    x: Floats,
) -> None:
    """Begin an arc in a field at a state. ``own`` is the guard that led there (``OWN``, or none);
    it vanishes there by a power of the time."""
    now.floats[T], now.floats[LOW] = t, low
    now.ints[FIELD], now.ints[LAST_USED], now.ints[GUARD_POWER] = field, own, power
    now.ints[ENTERED], now.ints[WAS_LOW] = 0, 0
    now.ints[LASTED], now.floats[TAU] = 1 if now.floats[TAU] > 0.0 else 0, 0.0
    if now.ints[LOW_AHEAD] == 1:
        now.ints[FIRED] = twin(a, field, own)
    copied(x, now.x)
    enlarged(now, now.x)


def stays(
    a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats, to: int
) -> tuple[int, int]:
    """The field after a jump that does not leave the mode: the one in which those contacts are held
    that the jump has left closed. Returns a status and the field."""
    if to != now.ints[FIELD] or a.fields[to, ONTO_GAPS] < 0:
        return LANDED, to
    field = still_held(a, now, room, t, x)
    return MAKE if field == UNKNOWN else JUMP if field < 0 else LANDED, field


def added(now: Now, left: Left, guard: int, t: float, low: float) -> None:
    """Record a jump."""
    place = now.ints[JUMPS_MADE]
    left.when[place, 0], left.when[place, 1], left.when[place, 2] = t, low, now.floats[TAU]
    left.fired[place], now.ints[JUMPS_MADE] = guard, place + 1


def enlarged(now: Now, x: Floats) -> None:
    """Update the largest absolute value of each state."""
    for i in range(now.x.shape[0]):
        now.seen[i] = max(now.seen[i], abs(x[i]))


def impact(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, t: float, before: Floats, behind: Floats
) -> tuple[int, int]:
    """The states before and after an impact. Returns a status and the field that follows.

    ``LANDED`` if an ordinary flight follows (7), or a low flight, which is noted; ``SUM`` if all
    impacts from here on are to be summed; ``JUMP`` or ``MAKE`` if something is missing.
    """
    guard, own = now.ints[FIRED], a.guards[now.ints[FIRED], OWN]
    if now.ints[WAS_LOW] == 0 and not struck(a, now, room, t, before, behind):
        return JUMP, HARD
    if run[SHAKEN] == 1.0 and now.ints[WAS_LOW] == 0 and alternates(a, now.ints[SERIES], own):
        shake(now.impacts[own], behind)
    speed = now.floats[GAP_SPEED]
    if not speed >= 0.0:
        return JUMP, HARD
    status, field = stays(a, now, room, t, behind, now.ints[FIELD])
    if status != LANDED or pending(a, now, guard):
        return status, field
    count = now.ints[IMPACT_COUNT] + 1 if own == now.ints[SERIES] else 1
    tried = now.floats[TRIED] if count > 1 else math.inf
    alike = speed > 0.0 and field == now.ints[FIELD]
    if alike and count >= run[FIRST_SUMMED] and speed < run[SPEED_FALL] * tried:
        return SUM, field
    flow, size = a.fields[field, FIELD_PROGRAM], so_far(now, behind)
    guard = twin(a, field, own)
    if count == 1 or not tells(speed, now.floats[PULL], size):
        if afresh(a.programs, flow, 2, t, behind, room.still, room.aside, room.work) < 0:
            return JUMP, HARD
        now.floats[PULL] = 2.0 * room.aside[row_of(a, flow, field, guard), 2]
    if not drowns(speed, now.floats[PULL], size):
        return LANDED, field
    if a.guards[guard, AT] < UNKNOWN:
        return JUMP, HARD
    if a.guards[guard, AT] == UNKNOWN:
        return asks(now, guard, AT), HARD
    now.ints[LOW_AHEAD] = 1
    return LANDED, field


def alternates(a: AutomatonArrays, before: int, guard: int) -> bool:
    """Whether an impact ends a series of another contact of the same bodies: some element of the
    state is in the gaps of both."""
    if before < 0 or before == guard:
        return False
    for k in range(a.guards[before, USES], a.guards[before, USES_END]):
        for j in range(a.guards[guard, USES], a.guards[guard, USES_END]):
            if a.uses[k] == a.uses[j]:
                return True
    return False


def shake(count: int, x: Floats) -> None:
    """Move a state by rounding, each element to either side as the number of an impact has it.

    Between blows of two contacts that come ever faster it grows: the gap of neither is known to
    more, and all runs round it alike. Those of one contact alone are bounded by themselves.
    """
    for i in range(x.shape[0]):
        side = 1.0 if (GOLDEN * (count + 1) * (i + 1)) % 1.0 < 0.5 else -1.0
        x[i] += side * SHAKE * EPS * x[i]


def struck(
    a: AutomatonArrays, now: Now, room: Room, t: float, before: Floats, behind: Floats
) -> bool:
    """Compute the states before and after an impact and the gap speed; returns whether all are
    finite."""
    guard, n = now.ints[FIRED], now.x.shape[0]
    if not values(a, a.guards[guard, LAND], t, now.end, room, before):
        return False
    program = a.guards[guard, RESET]
    if not values(a, program, t, before, room, behind):
        return False
    place = a.programs.index[program, OUTPUT] + n
    now.floats[GAP_SPEED] = room.aside[a.programs.output[place], 0]
    return True


def unchanged(
    a: AutomatonArrays, now: Now, room: Room, t: float, before: Floats, behind: Floats
) -> bool:
    """Whether a reset leaves the value of its guard unchanged."""
    field = now.ints[FIELD]
    program = a.fields[field, FIELD_PROGRAM]
    row = row_of(a, program, field, now.ints[FIRED])
    afresh(a.programs, program, 0, t, before, room.still, room.aside, room.work)
    here = room.aside[row, 0]
    afresh(a.programs, program, 0, t, behind, room.still, room.aside, room.work)
    return here == room.aside[row, 0]


def beyond(a: AutomatonArrays, now: Now, guard: int) -> bool:
    """Whether a guard that fired may not be zero: it jumped, or was urgent, before any flow."""
    place, urgent = guard - a.fields[now.ints[FIELD], GUARDS], a.guards[guard, URGENT] == 1
    return now.zeros[place, REACHES] == 1.0 or (urgent and now.orders[place] == 0)


def watch(
    a: AutomatonArrays,
    now: Now,
    room: Room,
    guard: int,
    to: int,
    t: float,
    before: Floats,
    behind: Floats,
) -> None:
    """Count the impacts of the current series: those of one contact with no other jump between."""
    own = a.guards[guard, OWN]
    interrupted(a, now, room, own, to, t, before, behind)
    if a.guards[guard, KIND] != CONTACT:
        now.ints[SERIES], now.floats[PULL] = -1, 0.0
        return
    now.impacts[own] += 1
    now.ints[IMPACT_COUNT] += 1
    if own != now.ints[SERIES]:
        now.ints[SERIES], now.ints[IMPACT_COUNT], now.floats[TRIED] = own, 1, math.inf


def interrupted(
    a: AutomatonArrays,
    now: Now,
    room: Room,
    own: int,
    to: int,
    t: float,
    before: Floats,
    behind: Floats,
) -> None:
    """Forget the impacts of other contacts whose gap or gap speed a jump, which leads to a field,
    has changed."""
    field, others = now.ints[FIELD], False
    program, first = a.fields[field, FIELD_PROGRAM], a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        others = others or (a.guards[g, OWN] != own and now.impacts[a.guards[g, OWN]] > 0)
    if not others:
        return
    afresh(a.programs, program, 1, t, before, room.still, room.aside, room.work)
    for g in range(first, a.fields[field, GUARDS_END]):
        for k in range(2):
            now.zeros[g - first, VALUE + k] = room.aside[row_of(a, program, field, g), k]
    program = a.fields[to, FIELD_PROGRAM]
    afresh(a.programs, program, 1, t, behind, room.still, room.aside, room.work)
    for g in range(first, a.fields[field, GUARDS_END]):
        other = a.guards[g, OWN]
        there = twin(a, to, other)
        alone = there >= 0
        if alone:
            row = row_of(a, program, to, there)
            gap, speed = room.aside[row, 0], room.aside[row, 1]
            alone = gap == now.zeros[g - first, VALUE] and speed == now.zeros[g - first, RATE]
        if other != own and not alone:
            now.impacts[other] = 0
