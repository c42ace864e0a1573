"""Guards where their formula changes: which of them reach zero there, and the end of an arc beyond.

A guard may jump over zero at a kink, or have a corner there (1). It is looked at on both sides, so
far from the kink that rounding does not decide on the formula: what is a kink to one function is
next to a kink of another, as in a remainder. Numbers in brackets are the rules of
``docs/semantics.md``.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Now, Room
from .checks import along
from .clocks import after
from .guards import (
    GUARD_ROUNDING,
    JUMPS_WITHIN,
    TIE,
    TIED_IN_STEP,
    holds,
    row_of,
    series_of,
    sizes_of,
)
from .jets import KINKS, afresh
from .kinks import KINK_KIND, POINT, SWITCHES, crossed_to, kink_row
from .places import (
    BENDS,
    BEYOND_BY,
    BLUR,
    CONTACT,
    CROSSED,
    CROSSING,
    CUT,
    EVENT,
    FIELD,
    FIELD_PROGRAM,
    GUARD_POWER,
    GUARDS,
    GUARDS_END,
    HARD,
    KIND,
    LAST_USED,
    LEAVE,
    LOW,
    MADE,
    NONE,
    OWN,
    REACHES,
    RELEASE,
    WHEN,
    T,
)
from .polynomials import power_size, power_value
from .zeros import EPS

__all__ = ("with_cuts",)

#: A kink is a place if its function has one sign on either side of it within this share of the
#: step, or so many roundings of the time: far above rounding, far below what a step resolves.
WIDEST, LEAST_WIDE = 1e-4, 64.0

#: Guards are looked at so many times as far from a kink as its own function shows its sign: of
#: those that change beside it each has roundings of its own.
WIDER = 4.0

#: A state is beyond a kink by rounding alone as far as it was when the guard jumped there, or where
#: rounding or another kink at the same place have it otherwise, by so many times this.
ROUNDED = 64.0

#: How often a shift of the size of rounding is doubled in search of the place beyond a kink: its
#: function may be a difference of numbers that move at very different rates.
MOVES = 27


def with_cuts(
    a: AutomatonArrays, now: Now, room: Room, guard: int, s: float, h: float
) -> tuple[int, float, float]:
    """The first event of a step, or of a part of it, of which ``room.c`` has the series, where
    ``guard`` is the first that fires in it, at ``s``: one that fires at the kink at which it ends
    comes instead, if none is earlier. At 0 if that is not plain.

    If none fires where several kinks are at one place, the step is to go on beyond all of them, by
    the third number.
    """
    now.ints[CUT], program = 0, series_of(a, now)
    t = room.c[now.end.shape[0], 0]
    if now.ints[CROSSED] < 0 or not s > 0.0 or h - s > TIE * EPS * (abs(t) + h):
        return guard, s, 0.0
    if not any_bends(a, now):
        return guard, s, 0.0
    reach, several = beside_kinks(a, now, room, program, h)
    first = HARD if reach == 0.0 else at_kink(a, now, room, program, h, reach)
    if first == HARD:
        return -1, 0.0, 0.0
    if first != NONE:
        kink = now.ints[CROSSED]
        now.ints[CUT] = crossed_to(room.c, kink_row(a.programs, program, kink), room.sides[kink])
        return first, h, 0.0
    if guard >= 0 or not several:
        return guard, s, 0.0
    now.ints[CROSSED] = -1
    return guard, s, reach


def any_bends(a: AutomatonArrays, now: Now) -> bool:
    """Whether a guard of the field may change its formula."""
    field = now.ints[FIELD]
    for g in range(a.fields[field, GUARDS], a.fields[field, GUARDS_END]):
        if a.guards[g, BENDS] == 1:
            return True
    return False


def value_at(
    a: AutomatonArrays, now: Now, room: Room, program: int, row: int, t: float, s: float
) -> float:
    """The value of a row at a place of a step, by its formula there; leaves the state."""
    along(room.c, s, room.there)
    if afresh(a.programs, program, 0, t, room.there, room.still, room.aside, room.work) < 0:
        return math.nan
    return room.aside[row, 0]


def beside_kinks(
    a: AutomatonArrays, now: Now, room: Room, program: int, h: float
) -> tuple[float, bool]:
    """How far from the kink at ``h`` guards are looked at, and whether other kinks are there, too;
    0 if nothing changes its sign there.

    The function that seems to be zero there may jump back instead, where another is zero, as a
    remainder does: that one is the kink.
    """
    p, zero, several = a.programs, now.ints[CROSSED], False
    first, reach = p.index[program, KINKS], apart(a, now, room, program, zero, h, WIDEST)
    for k in range(p.index[program, KINKS + 1] - first):
        switches = p.kinks[first + k, SWITCHES] == 1 and p.kinks[first + k, KINK_KIND] != POINT
        own = apart(a, now, room, program, k, h, 0.0) if switches and k != zero else 0.0
        several = several or (own > 0.0 and reach > 0.0)
        now.ints[CROSSED] = k if own > 0.0 and reach == 0.0 else now.ints[CROSSED]
        reach = max(reach, own)
    return reach, several


def apart(
    a: AutomatonArrays, now: Now, room: Room, program: int, kink: int, h: float, share: float
) -> float:
    """How far from ``h`` the function of a kink has different signs on either side; 0 if it has
    not within a share of ``h``, or a few roundings. It has them further off, too: one that jumps
    back just beyond, as a remainder does, seems to cross zero by its rounding."""
    width = 2.0 * EPS * (abs(room.c[now.end.shape[0], 0]) + h)
    widest = max(share * h, LEAST_WIDE * width)
    while width < widest:
        if parts(a, now, room, program, kink, h, width) and parts(
            a, now, room, program, kink, h, 2.0 * WIDER * width
        ):
            return WIDER * width
        width *= 2.0
    return 0.0


def parts(
    a: AutomatonArrays, now: Now, room: Room, program: int, kink: int, h: float, width: float
) -> bool:
    """Whether the function of a kink has different signs so far before and behind ``h``."""
    row = kink_row(a.programs, program, kink)
    side = crossed_to(room.c, row, room.sides[kink])
    t = room.c[now.end.shape[0], 0] + h
    before = h <= width or value_at(a, now, room, program, row, t - width, h - width) * side < 0.0
    return before and value_at(a, now, room, program, row, t + width, h + width) * side > 0.0


def at_kink(a: AutomatonArrays, now: Now, room: Room, program: int, h: float, reach: float) -> int:
    """The guard declared first of those that fire at the kink; ``NONE``; ``HARD`` if that is not
    plain. The signs of others that jump over zero are those beyond."""
    field, fires = now.ints[FIELD], NONE
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, BENDS] == 1:
            what = over(a, now, room, program, g, h, reach)
            if what == HARD:
                return HARD
            if what != NONE and comes_back(a, now, room, program, g, h):
                now.signs[g - first] *= -1
            elif what != NONE:
                zero = now.zeros[g - first]
                zero[WHEN], zero[BLUR], zero[REACHES] = h, 0.0, 1.0
                fires = g if fires == NONE else fires
    return fires


def comes_back(
    a: AutomatonArrays, now: Now, room: Room, program: int, guard: int, h: float
) -> bool:
    """Whether a guard jumps back at the instant at which it has jumped, as its own reset has turned
    the flow and has left the state beyond: it is there by rounding alone, and has not crossed the
    kink (1)."""
    if a.guards[guard, OWN] != now.ints[LAST_USED] or now.ints[GUARD_POWER] > 0:
        return False
    c = room.c[kink_row(a.programs, program, now.ints[CROSSED])]
    off = now.floats[BEYOND_BY] * now.signs[guard - a.fields[now.ints[FIELD], GUARDS]]
    return now.ints[MADE] == 0 and power_size(c, 0, c.shape[0] - 1, h) <= ROUNDED * off


def over(
    a: AutomatonArrays, now: Now, room: Room, program: int, guard: int, h: float, reach: float
) -> int:
    """Whether a guard fires at a kink: itself, ``NONE``, or ``HARD``.

    One that is zero on a side, but for its rounding and for what it moves on the way, has reached
    zero (1); one that is smooth there would have, or touches, and is not judged here.
    """
    field, n = now.ints[FIELD], now.end.shape[0]
    place, row = guard - a.fields[field, GUARDS], row_of(a, program, field, guard)
    c, side, t, far = room.c[row], now.signs[place], room.c[n, 0], h + TIED_IN_STEP * h
    degree = c.shape[0] - 1
    before, _ = power_value(c, 0, degree, h)
    was, _ = power_value(c, 0, degree, h - reach)
    expected, _ = power_value(c, 0, degree, far)
    there = value_at(a, now, room, program, row, t + far, far)
    further = value_at(a, now, room, program, row, t + (h + 2.0 * reach), h + 2.0 * reach)
    beyond = value_at(a, now, room, program, row, t + (h + reach), h + reach)
    size, _, _ = sizes_of(a, room, guard, t + h, room.there)
    if not (math.isfinite(beyond) and math.isfinite(further) and size < math.inf):
        return HARD
    noise = GUARD_ROUNDING * EPS * max(size, power_size(c, 0, degree, h))
    least = min(abs(before) - abs(before - was), abs(beyond) - abs(further - beyond))
    if beyond * side > 0.0 and least > noise:
        return NONE
    smooth = abs(there - expected) <= noise and -beyond * side <= noise
    kind, crossing = a.guards[guard, KIND], a.guards[guard, CROSSING]
    lasts = kind in (RELEASE, LEAVE) and abs(beyond) <= noise  # it holds until it falls below
    if smooth or lasts or kind == CONTACT:
        return HARD
    if (crossing == 0 or side * crossing < 0) and holds(a, room, guard, t + h, room.there):
        return guard
    if abs(beyond) <= noise:
        return HARD
    now.signs[place] = 1 if beyond > 0.0 else -1
    return NONE


def straight(a: AutomatonArrays, now: Now, room: Room, program: int, t: float) -> float:
    """Let ``room.c`` be the straight line along the flow from ``now.end``; returns the time left to
    the zero of the kink there, infinite if there is none."""
    flow, n, c = a.fields[now.ints[FIELD], FIELD_PROGRAM], now.end.shape[0], room.c
    if afresh(a.programs, flow, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return math.inf
    for i in range(n):
        c[i, 0], c[i, 1] = now.end[i], room.aside[i, 1]
        for k in range(2, c.shape[1]):
            c[i, k] = 0.0
    if afresh(a.programs, program, 1, t, now.end, room.still, c, room.work) < 0:
        return math.inf
    row = kink_row(a.programs, program, now.ints[CROSSED])
    return -c[row, 0] / c[row, 1] if c[row, 1] != 0.0 else math.inf


def beyond_kink(
    a: AutomatonArrays, now: Now, room: Room, program: int, tau: float, s: float
) -> float:
    """How far behind ``s`` from the local time ``tau``, from which ``room.c`` has series, a guard
    has jumped; infinite if there is no such place. How far beyond the kink that is, is noted."""
    place = now.ints[EVENT] - a.fields[now.ints[FIELD], GUARDS]
    shift = further(a, now, room, program, tau, s)
    row = kink_row(a.programs, program, now.ints[CROSSED])
    off = value_then(a, now, room, program, row, tau, s + shift)
    now.floats[BEYOND_BY] = -now.signs[place] * abs(off)
    return shift


def further(a: AutomatonArrays, now: Now, room: Room, program: int, tau: float, s: float) -> float:
    """How much later the function of the kink has its new sign and, if possible, the guard is zero
    or beyond, too, as what follows reads them; infinite if that is nowhere."""
    row, guard = kink_row(a.programs, program, now.ints[CROSSED]), now.ints[EVENT]
    place = guard - a.fields[now.ints[FIELD], GUARDS]
    own = row_of(a, program, now.ints[FIELD], guard)
    spacing, shift, moves = EPS * (abs(now.floats[T]) + tau + s), 0.0, 0
    while not value_then(a, now, room, program, row, tau, s + shift) * now.ints[CUT] > 0.0:
        moves += 1
        if moves > MOVES:
            return math.inf
        shift = 2.0 * shift if shift > 0.0 else spacing
    size, _, _ = sizes_of(a, room, guard, now.floats[T] + tau + s, room.there)
    for k in range(JUMPS_WITHIN):
        value = value_then(a, now, room, program, own, tau, s + (shift + k * spacing))
        if value * now.signs[place] <= GUARD_ROUNDING * EPS * size:
            return shift + k * spacing
    return shift


def value_then(
    a: AutomatonArrays, now: Now, room: Room, program: int, row: int, tau: float, s: float
) -> float:
    """The value of a row so long behind a local time, at the time at which an arc would begin."""
    t, _ = after(now.floats[T], now.floats[LOW], tau + s)
    return value_at(a, now, room, program, row, t, s)
