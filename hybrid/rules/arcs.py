"""A plain arc: steps from a jump to the first guard that fires, and onto it.

Plain is an arc whose start, events and end leave nothing to weigh (:mod:`.guards`): no guard next
to zero but the one just used, no two that fire next to each other, no tangency, no flight as low as
rounding. Where it is not, the status is ``LOOK``, and the driver flies the arc again with all the
rules of ``docs/semantics.md``. Numbers in brackets are its rules.

Taylor steps are made here. Those of another solver are asked for (``STEP``), and so are the
polynomial of one in which a guard may fire (``SHOW``) and the state on that guard (``LAND_ON``);
the arc goes on with the answer where it stood.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Ints, Left, Matrix, Now, Room
from .checks import along
from .clocks import beside, ended, wind
from .entries import starts
from .guards import (
    SMALL_SHIFT,
    TIE,
    begun,
    event_along,
    first_event,
    foreseen,
    goes_on,
    resolved,
    row_of,
)
from .jets import afresh, jets
from .kinks import turn
from .lengths import falls
from .places import (
    AIM,
    BEGINS,
    CONDITION,
    CONSTRAINED,
    CONTACT,
    CROSSED,
    CROSSING,
    DUE,
    EDGE,
    EVENT,
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FIRED,
    FIRST_LENGTH,
    FIRST_STEP,
    FULL,
    GOES_ON,
    GUARDS,
    GUARDS_END,
    HARD,
    HELD,
    HOLD,
    JOINED,
    JUMPS_MADE,
    KIND,
    LAND_ON,
    LANDED,
    LANDINGS_TRIED,
    LANDS,
    LAST_TIME,
    LOOK,
    LOOKS,
    LOW,
    MADE,
    MAKE,
    MAX_STEP,
    METHOD_ORDER,
    NONE,
    PHASE,
    PLAIN,
    RELATIVE,
    SEES,
    SHOW,
    STEP,
    STEP_END,
    STEP_LOSS,
    STEPS_MADE,
    SWITCH,
    TAU,
    TO_TAU,
    TOLERANCES,
    UNTIL,
    WALKS,
    WANTED,
    WATCHED,
    T,
)
from .steps import step
from .ties import latest, together
from .zeros import EPS

__all__ = ("first_step",)

#: Most steps onto a guard: Newton's method, from a zero of its series.
LANDINGS = 10

#: An arc's end is predicted as far as the last terms of its series are this many times rounding,
#: 1e-6: that is what a step that was made to end there may be off.
FORESEEN_FAR = 1e10

#: Steps that are to be held against the flow go so far at most, against the way to the expected end
#: of the arc: what they are does not depend then on the end of the run.
WATCHED_AHEAD = 1.5

#: An arc's first step, against that at which the method's error reaches the tolerance.
SAFETY = 0.5


def arc(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Fly the arc that begins at ``now`` to its end, which is put into ``now.end``.

    Returns
    -------
    status : int
        ``LANDED``, or ``END``; ``STEP``, ``SHOW``, ``LAND_ON`` or ``HOLD``, to be called again with
        the answer, or ``FULL``, with empty arrays, or ``MAKE``; or ``LOOK``, and nothing has
        changed but for contacts that have come to be held.
    """
    if a.fields[now.ints[FIELD], PLAIN] == 0:
        return LOOK
    status = GOES_ON
    while status == GOES_ON:
        run[UNTIL] = min(run[LAST_TIME], now.floats[DUE])
        phase = now.ints[PHASE]
        if phase == BEGINS:
            status = begins(a, run, now, room)
        elif phase == WALKS:
            status = walks(a, run, now, room, left)
        elif phase in (LOOKS, SEES, HELD):
            status = looks(a, run, now, room, left)
        else:
            status = lands(a, run, now, room, left)
    if status < STEP and status != FULL:
        now.ints[PHASE] = BEGINS
    return status


def begins(a: AutomatonArrays, run: Floats, now: Now, room: Room) -> int:
    """At the start of an arc. Another solver is told how to begin."""
    copied(now.x, now.end)
    wind(a, now, room, now.floats[T], now.floats[LOW])
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    now.floats[TAU], now.ints[MADE], now.ints[PHASE] = 0.0, 0, WALKS
    if run[METHOD_ORDER] == 0.0 and run[WATCHED] == 0.0:
        return GOES_ON
    program, order = a.fields[now.ints[FIELD], FIELD_PROGRAM], room.c.shape[1] - 1
    if jets(a.programs, program, order, now.floats[T], now.x, room.sides, room.c, room.work) < 0:
        return LOOK
    fires = starts(a, now, room)
    if fires != NONE:
        return at_once(now, fires)
    now.floats[AIM] = aim(a, now, room, True)
    n, absolute, order = now.x.shape[0], run[TOLERANCES:], int(run[METHOD_ORDER])
    if order > 0:
        now.floats[FIRST_LENGTH] = first_step(room.c, n, order, run[RELATIVE], absolute)
    return GOES_ON


def at_once(now: Now, guard: int) -> int:
    """End the arc where it begins: a guard fires before any flow. Where a contact has come to be
    held it begins anew."""
    if guard in (JOINED, WANTED):
        now.ints[PHASE] = BEGINS
        return GOES_ON if guard == JOINED else MAKE
    if guard < 0 or now.floats[DUE] <= now.floats[T]:  # a clock may ring before it
        return LOOK
    copied(now.x, now.end)
    now.ints[FIRED] = guard
    return LANDED


def walks(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Make a step, or ask for it."""
    tau, length = now.floats[TAU], (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    if tau >= length:
        status = ended(a, run, now, room, length)
        if status != LOOK:
            now.floats[TAU] = length
            now.ints[STEPS_MADE] += now.ints[MADE]
        return status
    if now.ints[STEPS_MADE] + now.ints[MADE] >= left.owner.shape[0]:
        return FULL
    now.ints[PHASE] = LOOKS
    longest = run[FIRST_STEP] if now.ints[MADE] == 0 else run[MAX_STEP]
    if run[METHOD_ORDER] > 0.0 or run[WATCHED] == 1.0:
        if now.ints[MADE] > 0:
            own = run[METHOD_ORDER] == 0.0  # whose sides of kinks are known
            now.floats[AIM] = aimed(a, now, room, room.still if own else room.sides)
        ahead = now.floats[AIM] - tau
        if run[METHOD_ORDER] == 0.0:
            longest = min(longest, WATCHED_AHEAD * ahead) if ahead > 0.0 else longest
        else:
            until = length if ahead <= 0.0 else min(length, now.floats[AIM])
            now.floats[TO_TAU] = min(until, tau + longest)
            return STEP
    field = now.ints[FIELD]
    status, made, crossed = step(
        a.programs,
        a.fields[field, FIELD_PROGRAM],
        a.fields[field, CONSTRAINED] == 1,
        now.floats[T] + tau,
        tau,
        now.end,
        min(length - tau, longest),
        run[STEP_LOSS:],
        room.sides,
        room.c,
        room.aside,
        room.work,
        room.rows,
        room.found,
        now.end,
    )
    now.ints[EXPANSIONS] += 1
    fires = NONE if now.ints[MADE] > 0 else HARD if status < 0 else starts(a, now, room)
    if fires != NONE or status < 0:
        return at_once(now, fires)
    h, shown = made, resolved(a, run, now, room, now.floats[T] + tau, made, crossed >= 0)
    if not shown > 0.0:
        return LOOK
    if shown < h:
        h, crossed = shown, -1
    end = length if tau + h >= length else tau + h
    if end - tau != made:
        along(room.c, end - tau, now.end)
    now.floats[STEP_END], now.ints[CROSSED] = end, crossed
    return GOES_ON


def looks(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Look for the first guard that fires in a step; go on to its end, or land on the guard."""
    tau, next_tau = now.floats[TAU], now.floats[STEP_END]
    h, starting = next_tau - tau, now.ints[MADE] == 0
    if now.ints[PHASE] == HELD and not next_tau < now.floats[TO_TAU]:
        now.ints[PHASE] = LANDS
        return passes(a, run, now, room, left) if now.ints[EVENT] < 0 else GOES_ON
    if run[METHOD_ORDER] == 0.0:
        if now.ints[PHASE] == HELD:  # it has been cut
            begun(a, now, room)
        guard, s = first_event(a, run, now, room, h, starting)
    elif now.ints[PHASE] == LOOKS:
        guard, s = -1, 0.0
        if now.floats[AIM] >= 0.0:
            guard, s = foreseen(a, run, now, room, h, starting)
        if s == 0.0:
            now.ints[PHASE] = SEES
            return SHOW
    else:
        guard, s = event_along(a, run, now, room, h, starting)
    if not s > 0.0 or (guard >= 0 and beside(now, tau + s)):
        return LOOK
    now.ints[EVENT], now.ints[LANDINGS_TRIED] = guard, 0
    if run[METHOD_ORDER] == 0.0:
        now.floats[TO_TAU] = next_tau if guard < 0 else tau + s
        if guard >= 0:
            along(room.c, s, now.end)
        if run[WATCHED] == 1.0 and now.ints[PHASE] == LOOKS:
            now.ints[PHASE] = HELD
            return HOLD
    if guard < 0:
        return passes(a, run, now, room, left)
    now.ints[PHASE] = LANDS
    if run[METHOD_ORDER] == 0.0:
        return GOES_ON
    if h - s > SMALL_SHIFT * s:
        now.floats[TO_TAU] = tau + s
        return LAND_ON if tau + s > beyond(now, tau) else LOOK
    now.floats[TO_TAU] = next_tau
    return GOES_ON


def beyond(now: Now, tau: float) -> float:
    """Times beyond this one are not, to rounding, that at which a step begins."""
    return tau + TIE * EPS * (abs(now.floats[T]) + tau)


def passes(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Go on to the end of a step in which no guard fires."""
    tau, next_tau = now.floats[TAU], now.floats[STEP_END]
    if run[METHOD_ORDER] == 0.0:
        kept(now, room, left, tau, next_tau - tau)
        program = a.fields[now.ints[FIELD], FIELD_PROGRAM]
        turn(a.programs, program, now.ints[CROSSED], room.c, room.sides)
        if now.ints[CROSSED] >= 0 and not beyond_kink(a, now, room, now.floats[T] + next_tau):
            return LOOK
    now.floats[TAU], now.ints[PHASE] = next_tau, WALKS
    now.ints[MADE] += 1
    for g in range(now.orders.shape[0]):
        now.orders[g] = 0
    return GOES_ON


def beyond_kink(a: AutomatonArrays, now: Now, room: Room, t: float) -> bool:
    """Whether a step that ends at a kink has left guards on their side of zero."""
    program = a.fields[now.ints[FIELD], FIELD_PROGRAM]
    fit = jets(a.programs, program, 0, t, now.end, room.sides, room.c, room.work) == 0
    return fit and goes_on(a, now, room, program, t, now.end)


def lands(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """The time at which a guard is zero, to rounding, and the state there (5): Newton's method.

    Where the step's series have put guards that are next to each other in the wrong order, that of
    the one that fired before.
    """
    tau, at, guard = now.floats[TAU], now.floats[TO_TAU], now.ints[EVENT]
    field = now.ints[FIELD]
    program = a.fields[field, FIELD_PROGRAM]
    row = row_of(a, program, field, guard)
    t, least = now.floats[T] + at, beyond(now, tau)
    length = (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    most = min(length, now.floats[STEP_END] + SMALL_SHIFT * (now.floats[STEP_END] - tau))
    if not least < at <= most or now.ints[LANDINGS_TRIED] == LANDINGS:
        return LOOK
    if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
        return LOOK
    rate = room.aside[row, 1]
    if rate == 0.0:
        return LOOK
    further = -room.aside[row, 0] / rate
    now.ints[LANDINGS_TRIED] += 1
    if abs(further) > SMALL_SHIFT * (at - tau):
        return again(run, now, room, at + further, least, most)
    if not least < at + further <= most:
        return LOOK
    for i in range(now.end.shape[0]):
        now.end[i] += further * room.aside[i, 1]
    other, ago = latest(a, now, room, now.floats[T] + at + further)
    if ago > 0.0:
        now.ints[EVENT] = other
        return again(run, now, room, at + further - ago, least, most)
    if run[METHOD_ORDER] == 0.0:
        kept(now, room, left, tau, at + further - tau)
    now.ints[FIRED] = together(a, now, room, now.floats[T] + at + further)
    now.floats[TAU] = at + further
    now.ints[STEPS_MADE] += now.ints[MADE] + 1
    return LANDED


def again(run: Floats, now: Now, room: Room, at: float, least: float, most: float) -> int:
    """End the step at another time."""
    now.floats[TO_TAU] = at
    if run[METHOD_ORDER] > 0.0:
        return LAND_ON if least < at <= most else LOOK
    along(room.c, at - now.floats[TAU], now.end)
    return GOES_ON


def first_step(c: Matrix, n: int, order: int, relative: float, absolute: Floats) -> float:
    """Where the first term that another method neglects reaches the tolerance, of ``n`` states."""
    first, power = math.inf, min(order + 1, c.shape[1] - 1)
    for i in range(n):
        allowed = absolute[i] + relative * abs(c[i, 0])
        for k in range(power - 1, power + 1):
            if c[i, k] != 0.0:
                first = min(first, (allowed / abs(c[i, k])) ** (1.0 / k))
    return SAFETY * first


def aimed(a: AutomatonArrays, now: Now, room: Room, sides: Ints) -> float:
    """Where an arc is expected to end, from series of the flow where a step begins; -1 without
    them. ``sides`` gets those of kinks."""
    program, order = a.fields[now.ints[FIELD], FIELD_PROGRAM], room.c.shape[1] - 1
    tau = now.floats[TAU]
    t = now.floats[T] + tau
    if afresh(a.programs, program, order, t, now.end, sides, room.c, room.work) < 0:
        return -1.0
    return tau + aim(a, now, room, False)


def aim(a: AutomatonArrays, now: Now, room: Room, starting: bool) -> float:
    """The end of a short flight from its series (2); at the start of an arc of one onto a contact,
    or back onto a guard."""
    field, best = now.ints[FIELD], math.inf
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        kind, crossing = a.guards[g, KIND], a.guards[g, CROSSING]
        order = now.orders[g - first] if starting else 0
        if a.guards[g, CONDITION] != NONE:
            continue
        back = kind in (EDGE, SWITCH) and order == 1
        if (kind == CONTACT and order <= 1) or (crossing != 0 and (back or not starting)):
            c = room.c[row_of(a, a.fields[field, FIELD_PROGRAM], field, g)]
            value = c[0]
            c[0] = 0.0 if order == 1 else value
            side = -1.0 if crossing > 0 else 1.0
            scaled(c, side)
            far = FORESEEN_FAR ** (1.0 / (c.shape[0] - 1))
            best = min(best, falls(room.c, now.x.shape[0], c, far, room.rows, room.found))
            scaled(c, side)
            c[0] = value
    return best


def scaled(c: Floats, factor: float) -> None:
    """A series times a number."""
    for k in range(c.shape[0]):
        c[k] *= factor


def copied(x: Floats, y: Floats) -> None:
    """Copy a state."""
    for i in range(x.shape[0]):
        y[i] = x[i]


def kept(now: Now, room: Room, left: Left, tau: float, h: float) -> None:
    """Keep a step: the arc it belongs to, where it begins, how long it is, and its series."""
    place = now.ints[STEPS_MADE] + now.ints[MADE]
    left.owner[place] = now.ints[JUMPS_MADE]
    left.spans[place, 0] = tau
    left.spans[place, 1] = h
    n = now.x.shape[0]
    if left.series.shape[0] > 0:
        for i in range(n):
            for k in range(room.c.shape[1]):
                left.series[place * n + i, k] = room.c[i, k]
