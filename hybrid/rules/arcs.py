"""One arc: steps from a jump to the first guard that fires, ending on it.

These rules fly an arc if its start, its steps and its end are clear cut (:mod:`.guards`): for
example, no guard but the one just used is next to zero, none is tangent to zero, and each series of
a guard has converged. Otherwise the status is ``LOOK``, and Python flies the arc with all the rules
of ``docs/semantics.md``. Numbers in brackets are those rules.

Taylor steps are made here. An outside solver is asked for a step (``STEP``), for its polynomial
where a guard may fire in it (``SHOW``), and to end it on that guard (``LAND_ON``); the arc
continues with the answer.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Ints, Left, Matrix, Now, Room
from .checks import along
from .clocks import arc_end, beside, close, ended, wind
from .contacts import onto, strays
from .cuts import beyond_kink, straight, with_cuts
from .dense import event_along, foreseen
from .entries import starts
from .guards import SMALL_SHIFT, TIE, begun, first_event, hidden, resolved, row_of
from .jets import afresh, jets
from .kinks import turn
from .lengths import SHORT_SHARE, STEP_FURTHER, falls
from .places import (
    AIM,
    BEGINS,
    CONDITION,
    CONSTRAINED,
    CONTACT,
    CROSSED,
    CROSSING,
    CUT,
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
    GAP_SPEED,
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
    LEAVE,
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
    PULL,
    RELATIVE,
    RELEASE,
    RUN_END,
    SEES,
    SERIES_REACH,
    SHORT,
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
    WATCH,
    WATCHED,
    T,
)
from .steps import step
from .ties import gathered, latest, lose, together
from .weak import few_terms
from .zeros import EPS

__all__ = ("first_step",)

#: Most iterations of Newton's method from the zero of a guard's series to its own.
LANDINGS = 10

#: The end of an arc is predicted as far as the last terms of its series are this many roundings,
#: which is 1e-6 of it: so much may a step miss that is made to end there.
FORESEEN_FAR = 1e10

#: The longest step that is checked against the flow, relative to the way to the expected end of the
#: arc, so that the steps do not depend on the end of the run.
WATCHED_AHEAD = 1.5

#: The first step of an arc, relative to the one at which the method's error reaches the tolerance.
SAFETY = 0.5


def arc(a: AutomatonArrays, run: Floats, now: Now, room: Room, short: Room, left: Left) -> int:
    """Fly the arc that begins at ``now``; its end is written to ``now.end``. Where a short flight
    is expected, ``short`` has the room for its series.

    Returns
    -------
    status : int
        ``LANDED`` or ``END``; or what is needed before it can go on: ``STEP``, ``SHOW``,
        ``LAND_ON``, ``HOLD``, ``MAKE``, or ``FULL``, with empty arrays; or ``LOOK``, and nothing
        has changed but that contacts may have come to be held.
    """
    if a.fields[now.ints[FIELD], PLAIN] == 0:
        return LOOK
    status = GOES_ON
    while status == GOES_ON:
        run[UNTIL] = arc_end(run, now)
        phase, own = now.ints[PHASE], short if now.ints[SHORT] == 1 else room
        if phase == BEGINS:
            status = begins(a, run, now, room)
        elif phase == WALKS:
            status = walks(a, run, now, own, left)
        elif phase in (LOOKS, SEES, HELD):
            status = looks(a, run, now, own, left)
        else:
            status = lands(a, run, now, own, left)
    if status < STEP and status != FULL:
        now.ints[PHASE] = BEGINS
    return status


def begins(a: AutomatonArrays, run: Floats, now: Now, room: Room) -> int:
    """Start an arc; an outside solver is told its first step and expected end. An arc that begins
    at its end makes no step that would show whether a guard fires at once: it is looked at here."""
    copied(now.x, now.end)
    wind(a, now, room, now.floats[T], now.floats[LOW])
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0
    now.floats[TAU], now.ints[MADE], now.ints[PHASE] = 0.0, 0, WALKS
    now.ints[SHORT] = 0
    stands = (run[UNTIL] - now.floats[T]) - now.floats[LOW] <= 0.0
    if run[METHOD_ORDER] == 0.0 and run[WATCHED] == 0.0 and not stands:
        now.ints[SHORT] = int(0.0 < expected(now) <= SHORT_SHARE * now.floats[SERIES_REACH])
        return GOES_ON
    program, order = a.fields[now.ints[FIELD], FIELD_PROGRAM], room.c.shape[1] - 1
    t, p = now.floats[T], a.programs
    if jets(p, program, order, t, now.x, room.sides, room.c, room.work) < 0:
        own = run[METHOD_ORDER] == 0.0
        if not (own and few_terms(p, program, t, now.x, room.sides, room.c, room.work)):
            return LOOK
    fires = starts(a, run, now, room)
    if fires != NONE:
        return at_once(now, fires)
    now.floats[AIM] = aim(a, now, room, True, run[WATCHED] == 1.0)
    n, absolute, order = now.x.shape[0], run[TOLERANCES:], int(run[METHOD_ORDER])
    if order > 0:
        now.floats[FIRST_LENGTH] = first_step(room.c, n, order, run[RELATIVE], absolute)
    return GOES_ON


def expected(now: Now) -> float:
    """How long a flight is that begins at a contact, as far as it is known, else 0."""
    pull = now.floats[PULL]
    return -2.0 * now.floats[GAP_SPEED] / pull if pull < 0.0 else 0.0


def at_once(now: Now, guard: int) -> int:
    """End the arc where it begins, as a guard fires before any flow. If a contact has come to be
    held, the arc begins anew."""
    if guard in (JOINED, WANTED):
        now.ints[PHASE] = BEGINS
        return GOES_ON if guard == JOINED else MAKE
    if guard < 0 or now.floats[DUE] <= now.floats[T]:  # a clock may ring before it
        return LOOK
    copied(now.x, now.end)
    now.ints[FIRED] = guard
    return LANDED


def walks(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Make a step, or ask for one."""
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
    ahead = STEP_FURTHER * expected(now)
    if now.ints[MADE] == 0 and run[WATCHED] == 0.0 and 0.0 < ahead < now.floats[SERIES_REACH]:
        longest = min(longest, ahead)
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
    if now.ints[SHORT] == 0 and made < longest:
        now.floats[SERIES_REACH] = made
    fires = NONE if now.ints[MADE] > 0 else HARD if status < 0 else starts(a, run, now, room)
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
    """Find the first guard that fires in a step; go on to the end of the step, or land on the
    guard."""
    tau, next_tau = now.floats[TAU], now.floats[STEP_END]
    h, starting = next_tau - tau, now.ints[MADE] == 0
    if now.ints[PHASE] == HELD and not next_tau < now.floats[TO_TAU]:
        now.ints[PHASE] = LANDS
        return passes(a, run, now, room, left) if now.ints[EVENT] < 0 else GOES_ON
    if run[METHOD_ORDER] == 0.0:
        if now.ints[PHASE] == HELD:  # it has been cut
            begun(a, now, room)
        guard, s = first_event(a, run, now, room, h, starting)
        guard, s, further = with_cuts(a, now, room, guard, s, h)
        if further > 0.0:
            next_tau += further
            now.floats[STEP_END] = next_tau
            along(room.c, next_tau - tau, now.end)
    elif now.ints[PHASE] == LOOKS:
        if strays(a, run, now, room, now.floats[T] + next_tau):
            return LOOK
        guard, s, now.ints[CUT] = -1, 0.0, 0
        lose(run, now, room, h, now.floats[AIM] >= 0.0)
        if now.floats[AIM] >= 0.0:
            guard, s = foreseen(a, run, now, room, h, starting)
        if s == 0.0:
            now.ints[PHASE] = SEES
            return SHOW
    else:
        guard, s = event_along(a, run, now, room, h, starting)
    if not s > 0.0 or (guard >= 0 and beside(now, tau + s)):
        return LOOK
    if guard >= 0 and waits(a, run, now, room, guard):
        guard = NONE
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


def waits(a: AutomatonArrays, run: Floats, now: Now, room: Room, guard: int) -> bool:
    """Whether what holds the state comes to zero just where windows of the past, or the piece of a
    signal, end: it holds until it is less than zero, which is for what follows to show."""
    kind, field = a.guards[guard, KIND], now.ints[FIELD]
    length = (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    inside = run[LAST_TIME] >= run[RUN_END] or now.floats[STEP_END] < length
    if inside or kind not in (RELEASE, LEAVE):
        return False
    t, program = now.floats[T] + length, a.fields[field, FIELD_PROGRAM]
    if afresh(a.programs, program, 0, t, now.end, room.still, room.aside, room.work) < 0:
        return False
    value = room.aside[row_of(a, program, field, guard), 0]
    return abs(value) <= hidden(a, now, room, guard)


def beyond(now: Now, tau: float) -> float:
    """The time from which on times differ, by more than rounding, from the start of a step."""
    return tau + TIE * EPS * (abs(now.floats[T]) + tau)


def passes(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Go on to the end of a step in which no guard fires."""
    tau, next_tau = now.floats[TAU], now.floats[STEP_END]
    if run[METHOD_ORDER] == 0.0:
        kept(now, room, left, tau, next_tau - tau)
        program = a.fields[now.ints[FIELD], FIELD_PROGRAM]
        t, h = now.floats[T] + tau, next_tau - tau
        turn(a.programs, program, now.ints[CROSSED], t, h, room.c, room.sides)
    now.floats[TAU], now.ints[PHASE], now.ints[SHORT] = next_tau, WALKS, 0
    now.ints[MADE] += 1
    for g in range(now.orders.shape[0]):
        now.orders[g] = 0
    return GOES_ON


def lands(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """Find the zero of a guard to rounding, and the state there, by Newton's method (5): the state
    on the contacts held, or on the surface on which it slides, where its jump begins.

    If another guard has fired before, which the series of the step have put in the wrong order, the
    arc ends on that one.
    """
    tau, at, guard = now.floats[TAU], now.floats[TO_TAU], now.ints[EVENT]
    field = now.ints[FIELD]
    program = a.fields[field, FIELD_PROGRAM]
    if now.ints[CUT] != 0:
        return lands_beyond(a, run, now, room, left)
    row = row_of(a, program, field, guard)
    t, least = now.floats[T] + at, beyond(now, tau)
    length = (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    most = min(length, now.floats[STEP_END] + SMALL_SHIFT * (now.floats[STEP_END] - tau))
    if not least < at <= most or now.ints[LANDINGS_TRIED] == LANDINGS:
        return LOOK
    if a.fields[field, CONSTRAINED] == 1 and not onto(a, field, t, now.end, room, now.end):
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
    return closes(a, run, now, room, at + further, length)


def lands_beyond(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left) -> int:
    """End an arc just beyond the kink at which a guard jumps (1, 5): what is behind the jump has
    the formula from there on. Another solver's step is first made to end at the kink, and the rest
    of the way is straight."""
    tau, at = now.floats[TAU], now.floats[TO_TAU]
    own, length = run[METHOD_ORDER] == 0.0, (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    least = beyond(now, 0.0 if own else tau)
    most = min(length, now.floats[STEP_END] + SMALL_SHIFT * (now.floats[STEP_END] - tau))
    since, s, field = tau, at - tau, now.ints[FIELD]
    program = a.fields[field, FIELD_PROGRAM if own else WATCH]
    if not own:
        since, s = at, straight(a, now, room, program, now.floats[T] + at)
        now.ints[LANDINGS_TRIED] += 1
        if now.ints[LANDINGS_TRIED] > LANDINGS or not abs(s) < math.inf:
            return LOOK
        if abs(s) > SMALL_SHIFT * (at - tau):
            return again(run, now, room, at + s, least, most)
    s += beyond_kink(a, now, room, program, since, s)
    if not least < since + s < length:
        return LOOK
    if own:
        kept(now, room, left, tau, s)
    along(room.c, s, now.end)
    return closes(a, run, now, room, since + s, length)


def closes(a: AutomatonArrays, run: Floats, now: Now, room: Room, tau: float, length: float) -> int:
    """End an arc at a local time, on the guard declared first of those that fire there (4)."""
    if close(a, run, now, room, now.floats[T] + tau):
        return LOOK
    tau += gathered(a, run, now, room, now.floats[T] + tau, length - tau)
    now.ints[FIRED] = together(a, run, now, room, now.floats[T] + tau)
    now.floats[TAU] = tau
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
    """The step at which the first term that an outside method neglects reaches the tolerance, for
    ``n`` states."""
    first, power = math.inf, min(order + 1, c.shape[1] - 1)
    for i in range(n):
        allowed = absolute[i] + relative * abs(c[i, 0])
        for k in range(power - 1, power + 1):
            if c[i, k] != 0.0:
                first = min(first, (allowed / abs(c[i, k])) ** (1.0 / k))
    return SAFETY * first


def aimed(a: AutomatonArrays, now: Now, room: Room, sides: Ints) -> float:
    """The expected end of an arc, by series of the flow from the start of a step; -1 without them.
    ``sides`` gets the sides of kinks."""
    program, order = a.fields[now.ints[FIELD], FIELD_PROGRAM], room.c.shape[1] - 1
    tau = now.floats[TAU]
    t = now.floats[T] + tau
    if afresh(a.programs, program, order, t, now.end, sides, room.c, room.work) < 0:
        return -1.0
    return tau + aim(a, now, room, False, False)


def aim(a: AutomatonArrays, now: Now, room: Room, starting: bool, watched: bool) -> float:
    """The end of a short flight by its series (2). At the start of an arc only flights onto a
    contact, or back onto a guard, are considered; where steps are watched also flights onto an edge
    or a surface, as what is beyond it would be shown in vain."""
    field, best = now.ints[FIELD], math.inf
    first = a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        kind, crossing = a.guards[g, KIND], a.guards[g, CROSSING]
        order = now.orders[g - first] if starting else 0
        if a.guards[g, CONDITION] != NONE:
            continue
        onto = watched and order == 0
        back = kind in (EDGE, SWITCH) and (order == 1 or onto)
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
    """Multiply a series by a number."""
    for k in range(c.shape[0]):
        c[k] *= factor


def copied(x: Floats, y: Floats) -> None:
    """Copy a state."""
    for i in range(x.shape[0]):
        y[i] = x[i]


def kept(now: Now, room: Room, left: Left, tau: float, h: float) -> None:
    """Record a step: its arc, start, length and series."""
    place = now.ints[STEPS_MADE] + now.ints[MADE]
    left.owner[place] = now.ints[JUMPS_MADE]
    left.spans[place, 0] = tau
    left.spans[place, 1] = h
    n = now.x.shape[0]
    if left.series.shape[0] > 0:
        for i in range(n):
            for k in range(left.series.shape[1]):
                left.series[place * n + i, k] = room.c[i, k] if k < room.c.shape[1] else 0.0
