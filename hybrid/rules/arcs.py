"""A plain arc: steps from a jump to the first guard that fires, and onto it.

Plain is an arc whose start, events and end leave nothing to weigh: no guard next to zero but the
one just used, no two that fire next to each other, no tangency, no flight as low as rounding. Where
it is not, the status is ``LOOK``, and the driver flies the arc again with all the rules of
``docs/semantics.md``. Numbers in brackets are its rules.

Taylor steps are made here. Those of another solver are asked for (``STEP``), and so is the state on
a guard that fires (``LAND``); the arc goes on with the answer where it stood.
"""

from __future__ import annotations

import math

from .arrays import Automaton, Floats, Left, Matrix, Now, Room
from .checks import MIDDLE, MISSED
from .jets import OUTPUT, jets
from .kinks import turn
from .lengths import ROUNDING, falls, own_length
from .polynomials import power_value, shift
from .steps import step
from .zeros import EPS, NEVER, series

#: Columns of the table of fields: its program, where its guards begin and end, whether its arcs may
#: be plain, whether contacts are held in it, and a program of its guards alone, for the steps of
#: other solvers.
PROGRAM, GUARDS, GUARDS_END, PLAIN, HELD, WATCH = 0, 1, 2, 3, 4, 5

#: Columns of the table of guards. ``TO`` is a field, -1 where it is not known yet; ``RESET``,
#: ``LAND`` and ``SIZES`` are programs, -1 where there is none; ``USES`` is where the elements of
#: the state begin that it is made of.
KIND, CROSSING, BOUNDS, AFFINE, TO, RESET, LAND, SIZES, USES, USES_END = range(10)

#: Kinds of guards whose jumps are made here.
EDGE, CONTACT = 0, 1

#: Places in the numbers of a run: last time, tolerances, series of impacts; the longest steps, the
#: first of an arc and the others; the order of another solver (0 where steps are made here), and
#: from the last one on its tolerance for each element.
LAST, ABSOLUTE, RELATIVE, SHARE, PATIENT, FIRST_STEP, MAX_STEP, ORDER, TOLERANCES = range(9)

#: Places in a state's floats: the time in two; the local time; the speed at which a sum was tried
#: last; the local time at which a step ends; where the solver is to step to, or to land; where the
#: arc is expected to end; the length of its first step.
T, LOW, TAU, TRIED, NEXT, TO_TAU, AIM, FIRST = range(8)

#: Places in a state's integers: the field and the guard last used; the series of impacts; whether
#: the driver has looked at the arc's start; jumps and steps kept, and expansions made; then what
#: comes next in the arc, its steps so far, the guard that fires, the kink at which the step ends,
#: and landings tried.
FIELD, FIRED, SERIES, COUNT, ENTERED, JUMPS, STEPS, EXPANSIONS = range(8)
PHASE, MADE, EVENT, CROSSED, TRIES = range(8, 13)

#: What comes next in an arc: its start; a step; to look at a step; to land.
BEGINS, WALKS, LOOKS, LANDS = 0, 1, 2, 3

#: Why a call comes back: the run is at its end; the arrays are full; an arc has to be looked at
#: with all the rules; a jump has; another solver is to make a step, or to land.
END, FULL, LOOK, JUMP, STEP, LAND_ON = 1, 2, 3, 4, 5, 6

#: A guard has fired, and the state is on it. The arc goes on.
LANDED, GOES_ON = 0, -1

#: A guard nearer to zero than this share of the state is looked at more closely.
NEAR = 1e-6

#: Rounding of a guard, in spacings of the terms that it is made of.
ROUNDED = 64.0

#: Events this near in time, in spacings of floats, are at one time; those looked at for that lie
#: this near in the step, as landing may move the first by as much.
TIE, BESIDE = 4.0, 1e-6

#: Most steps onto a guard: Newton's method, from a zero of its series.
LANDINGS = 10

#: A shift onto a guard that is so small beside the way to it is made along a straight line.
SMALL = 1e-6

#: An arc's end is predicted this many times as far as its series have converged: there their last
#: terms, of order 16, are 1e-6, which is what a step that was made to end there may be off.
FAR = 4.0

#: An arc's first step, against that at which the method's error reaches the tolerance.
SAFETY = 0.5

#: Most parts of another solver's step in which guards are expanded: such steps may be long against
#: the time in which a guard changes.
PARTS = 64


def arc(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Fly the arc that begins at ``now`` to its end, which is put into ``now.end``.

    Returns
    -------
    status : int
        ``LANDED``, or ``END``; ``STEP`` or ``LAND_ON``, to be called again with the answer; or
        ``FULL`` or ``LOOK``, and nothing has changed.
    """
    if a.fields[now.ints[FIELD], PLAIN] == 0:
        return LOOK
    status = GOES_ON
    while status == GOES_ON:
        phase = now.ints[PHASE]
        if phase == BEGINS:
            status = begins(a, run, now, room)
        elif phase == WALKS:
            status = walks(a, run, now, room, left)
        elif phase == LOOKS:
            status = looks(a, run, now, room, left)
        else:
            status = lands(a, run, now, room, left)
    if status < STEP:
        now.ints[PHASE] = BEGINS
    return status


def begins(a: Automaton, run: Floats, now: Now, room: Room) -> int:
    """At the start of an arc. Another solver is told how to begin."""
    copied(now.x, now.end)
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    now.floats[TAU], now.ints[MADE], now.ints[PHASE] = 0.0, 0, WALKS
    if run[ORDER] == 0.0:
        return GOES_ON
    program, order = a.fields[now.ints[FIELD], PROGRAM], room.c.shape[1] - 1
    if jets(a.programs, program, order, now.floats[T], now.x, room.sides, room.c, room.work) < 0:
        return LOOK
    if not starts(a, now, room):
        return LOOK
    now.floats[FIRST] = first_step(run, now, room)
    now.floats[AIM] = aim(a, now, room)
    return GOES_ON


def walks(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Make a step, or ask for it."""
    tau, length = now.floats[TAU], (run[LAST] - now.floats[T]) - now.floats[LOW]
    if tau >= length:
        now.floats[TAU] = length
        now.ints[STEPS] += now.ints[MADE]
        return END
    now.ints[PHASE] = LOOKS
    longest = run[FIRST_STEP] if now.ints[MADE] == 0 else run[MAX_STEP]
    if run[ORDER] > 0.0:
        until = length if now.floats[AIM] <= tau else min(length, now.floats[AIM])
        now.floats[TO_TAU] = min(until, tau + longest)
        return STEP
    if now.ints[STEPS] + now.ints[MADE] >= left.owner.shape[0]:
        return FULL
    field = now.ints[FIELD]
    status, h, crossed = step(
        a.programs,
        a.fields[field, PROGRAM],
        a.fields[field, HELD] == 1,
        now.floats[T] + tau,
        tau,
        now.end,
        min(length - tau, longest),
        room.sides,
        room.c,
        room.aside,
        room.work,
        room.rows,
        room.found,
        now.end,
    )
    now.ints[EXPANSIONS] += 1
    if status < 0 or (now.ints[MADE] == 0 and not starts(a, now, room)):
        return LOOK
    shown = resolved(a, run, now, room, now.floats[T] + tau, h)
    if not shown > 0.0:
        return LOOK
    if shown < h:
        h, crossed = shown, -1
    now.floats[NEXT], now.ints[CROSSED] = length if tau + h >= length else tau + h, crossed
    return GOES_ON


def looks(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Look for the first guard that fires in a step; go on to its end, or land on the guard."""
    tau, next_tau = now.floats[TAU], now.floats[NEXT]
    h, starting = next_tau - tau, now.ints[MADE] == 0
    if run[ORDER] == 0.0:
        guard, s = first_event(a, run, now, room, h, starting)
    else:
        guard, s = event_along(a, run, now, room, h, starting)
    if not s > 0.0:
        return LOOK
    now.ints[EVENT], now.ints[TRIES] = guard, 0
    if guard < 0:
        return passes(a, run, now, room, left)
    now.ints[PHASE] = LANDS
    if run[ORDER] == 0.0:
        now.floats[TO_TAU] = tau + s
        moved(room.c, s, now.end)
        return GOES_ON
    if h - s > SMALL * s:
        now.floats[TO_TAU] = tau + s
        return LAND_ON
    now.floats[TO_TAU] = next_tau
    return GOES_ON


def passes(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Go on to the end of a step in which no guard fires."""
    tau, next_tau = now.floats[TAU], now.floats[NEXT]
    if run[ORDER] == 0.0:
        kept(now, room, left, tau, next_tau - tau)
        moved(room.c, next_tau - tau, now.end)
        program = a.fields[now.ints[FIELD], PROGRAM]
        turn(a.programs, program, now.ints[CROSSED], room.c, room.sides)
    now.floats[TAU], now.ints[PHASE] = next_tau, WALKS
    now.ints[MADE] += 1
    return GOES_ON


def lands(a: Automaton, run: Floats, now: Now, room: Room, left: Left) -> int:
    """The time at which a guard is zero, to rounding, and the state there (5): Newton's method."""
    tau, at, guard = now.floats[TAU], now.floats[TO_TAU], now.ints[EVENT]
    field = now.ints[FIELD]
    program, row = a.fields[field, PROGRAM], row_of(a, a.fields[field, PROGRAM], field, guard)
    t, least = now.floats[T] + at, tau + TIE * EPS * (abs(now.floats[T]) + tau)
    length = (run[LAST] - now.floats[T]) - now.floats[LOW]
    most = min(length, now.floats[NEXT] + SMALL * (now.floats[NEXT] - tau))
    if not least < at <= most or now.ints[TRIES] == LANDINGS:
        return LOOK
    if jets(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return LOOK
    rate = room.aside[row, 1]
    if rate == 0.0:
        return LOOK
    further = -room.aside[row, 0] / rate
    now.ints[TRIES] += 1
    if abs(further) > SMALL * (at - tau):
        now.floats[TO_TAU] = at + further
        if run[ORDER] > 0.0:
            return LAND_ON if least < at + further <= most else LOOK
        moved(room.c, at + further - tau, now.end)
        return GOES_ON
    if not least < at + further <= most:
        return LOOK
    for i in range(now.end.shape[0]):
        now.end[i] += further * room.aside[i, 1]
    if run[ORDER] == 0.0:
        kept(now, room, left, tau, at + further - tau)
    now.floats[TAU], now.ints[FIRED] = at + further, guard
    now.ints[STEPS] += now.ints[MADE] + 1
    return LANDED


def first_step(run: Floats, now: Now, room: Room) -> float:
    """Where the first term that another method neglects reaches the tolerance."""
    most = room.c.shape[1] - 1
    power, first = min(int(run[ORDER]) + 1, most), math.inf
    for i in range(now.x.shape[0]):
        allowed = run[TOLERANCES + i] + run[RELATIVE] * abs(room.c[i, 0])
        for k in range(power - 1, power + 1):
            if room.c[i, k] != 0.0:
                first = min(first, (allowed / abs(room.c[i, k])) ** (1.0 / k))
    return SAFETY * first


def aim(a: Automaton, now: Now, room: Room) -> float:
    """The end of a short flight onto a contact, or back onto a guard, from its series (2)."""
    field, best = now.ints[FIELD], math.inf
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        kind, crossing, order = a.guards[g, KIND], a.guards[g, CROSSING], now.orders[g - first]
        if (kind == CONTACT and order <= 1) or (kind == EDGE and order == 1 and crossing != 0):
            c = room.c[row_of(a, a.fields[field, PROGRAM], field, g)]
            value = c[0]
            c[0] = 0.0 if order == 1 else value
            side = -1.0 if crossing > 0 else 1.0
            scaled(c, side)
            best = min(best, falls(room.c, now.x.shape[0], c, FAR, room.rows, room.found))
            scaled(c, side)
            c[0] = value
    return best


def scaled(c: Floats, factor: float) -> None:
    """A series times a number."""
    for k in range(c.shape[0]):
        c[k] *= factor


def event_along(
    a: Automaton, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """As :func:`first_event`, in a step of another solver, of which ``room.c`` has the polynomial.

    The guards' series along it need not converge at its end: they are expanded anew as often as
    they must be. The end of a step that was made to end on a guard is looked at a little beyond.
    """
    field, n = now.ints[FIELD], now.x.shape[0]
    t, length = now.floats[T] + now.floats[TAU], (run[LAST] - now.floats[T]) - now.floats[LOW]
    reach = h
    if now.floats[NEXT] == now.floats[AIM]:
        reach = min(h * (1.0 + SMALL), length - now.floats[TAU])
    done = 0.0
    for part in range(PARTS):
        if not expanded(a, field, t + done, n, room):
            return -1, 0.0
        shown = resolved(a, run, now, room, t + done, reach - done)
        if not shown > 0.0:
            return -1, 0.0
        guard, s = first_event(a, run, now, room, shown, starting and part == 0)
        if guard >= 0 or not s > 0.0:
            return guard, s if s == 0.0 else done + s
        if done + shown >= reach:
            return -1, math.inf if keeps(a, now, room, t + h) else 0.0
        for i in range(n):
            shift(room.c[i], shown)
        done += shown
    return -1, 0.0


def expanded(a: Automaton, field: int, t: float, n: int, room: Room) -> bool:
    """The guards' series, from those of the states."""
    for i in range(n):
        room.there[i] = room.c[i, 0]
    program, order = a.fields[field, WATCH], room.c.shape[1] - 1
    return jets(a.programs, program, order, t, room.there, room.still, room.c, room.work) == 0


def keeps(a: Automaton, now: Now, room: Room, t: float) -> bool:
    """Whether the guards have at the end of a step the signs that its polynomial gives them."""
    field = now.ints[FIELD]
    program, first = a.fields[field, PROGRAM], a.fields[field, GUARDS]
    if jets(a.programs, program, 0, t, now.end, room.still, room.aside, room.work) < 0:
        return False
    for g in range(first, a.fields[field, GUARDS_END]):
        value = room.aside[row_of(a, program, field, g), 0]
        if not value * now.signs[g - first] > 0.0:
            return False
    return True


def copied(x: Floats, y: Floats) -> None:
    """Copy a state."""
    for i in range(x.shape[0]):
        y[i] = x[i]


def moved(c: Matrix, s: float, x: Floats) -> None:
    """The states at a time after their expansion."""
    for i in range(x.shape[0]):
        x[i], _ = power_value(c[i], 0, c.shape[1] - 1, s)


def kept(now: Now, room: Room, left: Left, tau: float, h: float) -> None:
    """Keep a step: the arc it belongs to, where it begins, how long it is, and its series."""
    place = now.ints[STEPS] + now.ints[MADE]
    left.owner[place] = now.ints[JUMPS]
    left.spans[place, 0] = tau
    left.spans[place, 1] = h
    n = now.x.shape[0]
    if left.series.shape[0] > 0:
        for i in range(n):
            for k in range(room.c.shape[1]):
                left.series[place * n + i, k] = room.c[i, k]


def row_of(a: Automaton, program: int, field: int, guard: int) -> int:
    """The row of a guard in one of the programs of a field."""
    first = a.programs.index[program, OUTPUT]
    return a.programs.output[first + guard - a.fields[field, GUARDS]]


def series_of(a: Automaton, run: Floats, field: int) -> int:
    """The program that has made the guards' series along a step."""
    return a.fields[field, PROGRAM if run[ORDER] == 0.0 else WATCH]


def size_of(a: Automaton, guard: int, order: int, t: float, x: Floats, room: Room) -> float:
    """The sum of the terms of which a guard (0) or its rate (1) is made."""
    program = a.guards[guard, SIZES]
    if jets(a.programs, program, 0, t, x, room.still, room.aside, room.work) < 0:
        return math.inf
    return room.aside[a.programs.output[a.programs.index[program, OUTPUT] + order], 0]


def starts(a: Automaton, now: Now, room: Room) -> bool:
    """Whether the start of an arc leaves nothing to weigh (3); notes the guards' orders."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if now.ints[ENTERED] == 0:
            now.orders[g - first] = 1 if g == now.ints[FIRED] else 0
            fit = leaves(a, now, room, g) if g == now.ints[FIRED] else away(a, now, room, g)
            if not fit:
                return False
    return True


def leaves(a: Automaton, now: Now, room: Room, guard: int) -> bool:
    """Whether the guard just used, which is zero, leaves zero into the domain, by its rate."""
    field = now.ints[FIELD]
    rate = room.c[row_of(a, a.fields[field, PROGRAM], field, guard), 1]
    if not abs(rate) > ROUNDED * EPS * size_of(a, guard, 1, now.floats[T], now.x, room):
        return False
    return a.guards[guard, BOUNDS] == 0 or rate * a.guards[guard, CROSSING] <= 0.0


def away(a: Automaton, now: Now, room: Room, guard: int) -> bool:
    """Whether another guard is further from zero than rounding, and inside the domain."""
    t, field = now.floats[T], now.ints[FIELD]
    row = row_of(a, a.fields[field, PROGRAM], field, guard)
    value, rate = room.c[row, 0], room.c[row, 1]
    if not abs(value) > NEAR * max(largest(now.seen), largest(now.x)):
        noise = size_of(a, guard, 0, t, now.x, room) + abs(t) * abs(rate) + largest(now.seen)
        if not abs(value) > ROUNDED * EPS * noise:
            return False
    return a.guards[guard, BOUNDS] == 0 or value * a.guards[guard, CROSSING] <= 0.0


def largest(x: Floats) -> float:
    """The size of the largest element."""
    size = 0.0
    for i in range(x.shape[0]):
        size = max(size, abs(x[i]))
    return size


def resolved(a: Automaton, run: Floats, now: Now, room: Room, t: float, h: float) -> float:
    """How far of a step the guards' series have converged; -1 where they do not follow them."""
    field, program = now.ints[FIELD], series_of(a, run, now.ints[FIELD])
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, AFFINE] == 0:
            h = min(h, own_length(room.c[row_of(a, program, field, g)], ROUNDING))
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, AFFINE] == 0:
            for share in (MIDDLE, 1.0):
                if not follows(a, now, room, program, g, t, share * h):
                    return -1.0
    return h


def follows(
    a: Automaton, now: Now, room: Room, made_by: int, guard: int, t: float, s: float
) -> bool:
    """Whether the series of a guard gives its value at a later time, but for rounding."""
    field = now.ints[FIELD]
    program = a.fields[field, PROGRAM]
    moved(room.c, s, room.there)
    value, size = summed(room.c[row_of(a, made_by, field, guard)], s)
    size += size_of(a, guard, 0, t + s, room.there, room)
    if jets(a.programs, program, 0, t + s, room.there, room.still, room.aside, room.work) < 0:
        return False
    exact = room.aside[row_of(a, program, field, guard), 0]
    return abs(exact - value) <= MISSED * EPS * size


def summed(c: Floats, s: float) -> tuple[float, float]:
    """The value of a series, and the sum of its terms' sizes."""
    value = 0.0
    size = 0.0
    for k in range(c.shape[0] - 1, -1, -1):
        value = value * s + c[k]
        size = size * s + abs(c[k])
    return value, size


def first_event(
    a: Automaton, run: Floats, now: Now, room: Room, h: float, starting: bool
) -> tuple[int, float]:
    """The guard that fires first in a step (-1: none), and when (1); at 0 if that is not plain."""
    field = now.ints[FIELD]
    first = a.fields[field, GUARDS]
    fired, best, second = -1, math.inf, math.inf
    for g in range(first, a.fields[field, GUARDS_END]):
        s = zero_of(a, run, now, room, g, now.orders[g - first] if starting else 0, h, starting)
        if s < best:
            fired, best, second = g, s, best
        else:
            second = min(second, s)
    spacing = EPS * abs(now.floats[T])
    if second - best <= BESIDE * h + TIE * spacing:
        return fired, 0.0
    return fired, best


def zero_of(
    a: Automaton,
    run: Floats,
    now: Now,
    room: Room,
    guard: int,
    order: int,
    h: float,
    starting: bool,
) -> float:
    """When a guard fires in a step; infinite where it does not, 0 where it is not plain.

    It is not where the guard does not begin with the sign with which it ended the last step: there
    it is as near to zero as rounding.
    """
    field = now.ints[FIELD]
    place = guard - a.fields[field, GUARDS]
    c = room.c[row_of(a, series_of(a, run, field), field, guard)]
    crossing, tolerance = a.guards[guard, CROSSING], left_open(a, run, guard, now.end)
    if not starting and not c[0] * now.signs[place] > 0.0:
        return 0.0
    degree = c.shape[0] - 1
    count = series(c, degree, h, order, NEVER if order else tolerance, room.rows, room.found)
    if count < 0:
        return 0.0
    for k in range(count):
        s, direction = room.found[k, 0], room.found[k, 1]
        if direction == 0.0:
            return 0.0
        if crossing == 0 or direction * crossing > 0.0:
            left = order == 0 or has_left(a, now, room, c, guard, s)
            return s if left and not turns(c, s, tolerance) else 0.0
        if a.guards[guard, BOUNDS] == 1:
            return 0.0
    value, size = summed(c, h)
    now.signs[place] = 1 if value > 0.0 else -1
    return math.inf if abs(value) > ROUNDED * EPS * size else 0.0


def left_open(a: Automaton, run: Floats, guard: int, x: Floats) -> float:
    """What the tolerances leave open of a guard."""
    size = 0.0
    for k in range(a.guards[guard, USES], a.guards[guard, USES_END]):
        size = max(size, abs(x[a.uses[k]]))
    return run[ABSOLUTE] + run[RELATIVE] * size


def turns(c: Floats, s: float, tolerance: float) -> bool:
    """Whether a guard that crosses zero turns back before it is deeper than a tolerance."""
    slope = 0.0
    bend = 0.0
    for k in range(c.shape[0] - 1, 0, -1):
        bend = bend * s + k * (k - 1) * c[k] if k > 1 else bend
        slope = slope * s + k * c[k]
    return slope * bend <= 0.0 and slope * slope <= 2.0 * abs(bend) * tolerance


def has_left(a: Automaton, now: Now, room: Room, c: Floats, guard: int, s: float) -> bool:
    """Whether a guard that was zero has been larger than its rounding on the way (2)."""
    noise = ROUNDED * EPS * size_of(a, guard, 0, now.floats[T], now.x, room) + 2.0 * abs(c[0])
    for k in range(1, 4):
        value, _ = summed(c, 0.25 * k * s)
        if abs(value) > noise:
            return True
    return False
