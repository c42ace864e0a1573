"""The loop of a run with delays: from window to window of the past.

:mod:`.runs` flies as far as the present windows are valid. Here what was flown is then added to the
record, in pieces with breaking points (:mod:`.flown`), and the next windows are read
(:mod:`.windows`, ``docs/notes/delays.md``). After a jump they are read again, as delayed values may
have changed. If a window was a guess that proves wrong, the flight is undone back to where the
guess began. Windows on functions of the caller's, and guesses in which something must be judged,
are left to :mod:`hybrid.delay.memory`, which has the same record.
"""

from __future__ import annotations

import math

from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Look, Now, PastArrays, Room, Sums
from .clocks import after, field_of
from .contacts import twin, values
from .flown import fits, recorded, walked
from .guards import GUARD_ROUNDING, row_of, sizes_of
from .guesses import SINCE_PLACE, TO_PLACE
from .jets import afresh, put_in
from .places import (
    AGAIN,
    AT,
    BEGAN,
    BEGINS,
    BEHIND,
    BREAK_ORDER,
    BREAKS,
    CONTACT,
    CROSSING,
    EDGE,
    END,
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FINAL,
    FIRED,
    FORGETS,
    FOUND,
    FULL,
    GOES_ON,
    GUARD_POWER,
    GUARDS,
    GUARDS_END,
    GUESSED,
    GUESSED_FROM,
    HOLD,
    HOLDS,
    IN_ARC,
    JUMP,
    JUMPS_DUE,
    JUMPS_MADE,
    KIND,
    LAGS,
    LAST_TIME,
    LAST_USED,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    MAKE,
    NEXT_TO_NOTHING,
    NO_ROOM,
    OFF,
    PHASE,
    PROOF,
    READS,
    RECORD_NOT_FINITE,
    SAME,
    SERVES_UNTIL,
    SHORTEST_LAG,
    STEPPED,
    STEPS_BEFORE,
    STEPS_DONE,
    STEPS_MADE,
    SWITCH,
    TAU,
    TIGHT,
    WALKS,
    WINDOW,
    WINDOW_END,
    T,
)
from .record import SMOOTH_ORDER, broken, corners, following, integrated, slack
from .runs import go
from .ties import FURTHEST_APART, rounding_there, since
from .windows import AT_THE_END, BACKWARDS, FIXED, MOVES_ON, confirmed, nearer_guess, read, stays
from .zeros import EPS

__all__ = ("bound", "ended", "fires_there", "jumped", "look_back")

#: The highest order of breaking points that are noted once the place of a lag has moved backwards:
#: each of them is then seen many times, and so are those that follow from it.
TURNING = 2


def look_back(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    left: Left,
    sums: Sums,
    look: Look,
    past: PastArrays,
) -> int:
    """Go on from ``now`` through windows; returns what the driver is asked for (:mod:`.places`)."""
    status = past.ints[AGAIN]
    past.ints[AGAIN] = GOES_ON
    if status == GOES_ON and past.ints[GUESSED] == 1 and time(now) == past.floats[GUESSED_FROM]:
        tried(now, past)
    while True:
        if status in (GOES_ON, HOLD):
            again = past.ints[BEHIND] != SAME or past.ints[GUESSED] == 1
            run[JUMPS_DUE] = now.ints[JUMPS_MADE] + 1.0 if again else math.inf
            status = go(a, run, now, room, left, sums, look)
        if status == PROOF:  # with delays Python judges the whole jump
            now.ints[PHASE], status = BEGINS, JUMP
        if status == HOLD:
            past.ints[AGAIN] = HOLD
            return HOLD
        if status == MAKE:
            return status
        found = judged(a, run, now, left, past, status) if past.ints[GUESSED] == 1 else HOLDS
        if found == HOLDS and not recorded(a, now, left, sums, past, status):
            found = NO_ROOM
        if found == NO_ROOM:
            past.ints[AGAIN] = status
            return NO_ROOM
        if found == NEXT_TO_NOTHING:
            now.ints[PHASE] = BEGINS
            return LOOK
        if found == HOLDS:
            found = due(a, run, now, room, left, past, status)
        if found == HOLDS:
            return status
        if found != FOUND:
            return WINDOW
        run[LAST_TIME] = past.floats[SERVES_UNTIL]
        bound(a, now, room, past)
        if past.ints[BEHIND] == FORGETS and now.ints[JUMPS_MADE] >= run[JUMPS_DUE]:
            parted(a, now, room)
        tried(now, past)
        status = GOES_ON


def parted(a: AutomatonArrays, now: Now, room: Room) -> None:
    """After an impact that forgets the past: note if what the gap sees of it now has moved the
    obstacle off the body, which then does not begin its flight there."""
    guard = twin(a, now.ints[FIELD], now.ints[LAST_USED])
    if guard < 0 or a.guards[guard, KIND] != CONTACT:
        return
    program, t = a.fields[now.ints[FIELD], FIELD_PROGRAM], time(now)
    if afresh(a.programs, program, 0, t, now.x, room.still, room.aside, room.work) < 0:
        return
    value = room.aside[row_of(a, program, now.ints[FIELD], guard), 0]
    size, high = sizes_of(a, room, guard, t, now.x)[0], sizes_of(a, room, guard, t, now.seen)[0]
    if value > GUARD_ROUNDING * EPS * (size + (high if high < math.inf else 0.0)):
        now.ints[GUARD_POWER], now.ints[LOW_AHEAD] = 0, 0


def time(now: Now) -> float:
    """The present time of the run."""
    t, _ = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    return t


def ends(a: AutomatonArrays, now: Now, status: int) -> bool:
    """Whether the loop has stopped where windows end: at their time, or at the guard by which a
    moving lag's place leaves its window."""
    return status == END or (status == JUMP and a.guards[now.ints[FIRED], KIND] == WINDOW_END)


def due(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, past: PastArrays, status: int
) -> int:
    """Read the windows that are due; ``HOLDS`` if none are, else the status of :func:`.read`."""
    if now.ints[JUMPS_MADE] >= run[JUMPS_DUE]:
        return behind(a, now, room, left, past)
    last = status == END and past.floats[SERVES_UNTIL] >= past.floats[FINAL]
    if last or not ends(a, now, status) or (status == END and fires_there(a, now, room, past)):
        return HOLDS
    t, fired = time(now), -1
    if status == JUMP:
        fired = a.guards[now.ints[FIRED], AT]
        now.ints[MADE] += 1
        if now.floats[TAU] > 0.0:  # guards have left zero
            for g in range(now.orders.shape[0]):
                now.orders[g] = 0
    goes_on(now, past)
    if not placed(a, now.ints[FIELD], t, now.end, room, past):
        return RECORD_NOT_FINITE
    ended(t, now.ints[FIELD], fired, past)
    return read(t, False, past)


def fires_there(a: AutomatonArrays, now: Now, room: Room, past: PastArrays) -> bool:
    """Whether a declared guard that is about to fire is zero where windows end: it fires before
    they are passed, and sees what was before (9). What is zero where an arc begins has been
    examined; and short windows end next to every event, which they leave alone."""
    field, t = now.ints[FIELD], time(now)
    furthest = FURTHEST_APART * (t - past.floats[GUESSED_FROM])
    if not now.floats[TAU] > 0.0:
        return False
    program, first = a.fields[field, FIELD_PROGRAM], a.fields[field, GUARDS]
    for g in range(first, a.fields[field, GUARDS_END]):
        if a.guards[g, KIND] not in (EDGE, CONTACT, SWITCH):
            continue
        if afresh(a.programs, program, 1, t, now.end, room.still, room.aside, room.work) < 0:
            return False
        row, before = row_of(a, program, field, g), now.signs[g - first]
        value, rate = room.aside[row, 0], room.aside[row, 1]
        noise = rounding_there(a, now, room, g, t, rate) + 2.0 * now.zeros[g - first, OFF]
        noise = min(noise, furthest * abs(rate))
        comes = rate * before < 0.0 and rate * a.guards[g, CROSSING] >= 0.0
        if comes and since(value, rate, before, t, noise) >= 0.0:
            return True
    return False


def placed(
    a: AutomatonArrays, field: int, t: float, x: Floats, room: Room, past: PastArrays
) -> bool:
    """Store the places to which the lags look back; returns whether all moving lags are numbers of
    at least 0."""
    copied(x, past.present)
    if a.fields[field, LAGS] < 0:
        return True
    fit = values(a, a.fields[field, LAGS], t, x, room, past.lags)
    for k in range(past.lags.shape[0]):
        fit = fit and past.lags[k] >= 0.0
    return fit


def behind(a: AutomatonArrays, now: Now, room: Room, left: Left, past: PastArrays) -> int:
    """Read the past again after a jump; returns the status of :func:`.read`."""
    place, t, until = now.ints[JUMPS_MADE] - 1, time(now), past.floats[SERVES_UNTIL]
    guard, forgets = left.fired[place], past.ints[BEHIND] == FORGETS
    past.ints[READS] = 0
    if not forgets and t < until < past.floats[FINAL] and until - t <= 2.0 * slack(t):
        field = field_of(a, guard)
        if placed(a, field, t, left.before[place], room, past):
            ended(t, field, -1, past)
    if not placed(a, now.ints[FIELD], t, now.x, room, past):
        return RECORD_NOT_FINITE
    if forgets and a.guards[guard, KIND] == EDGE:  # through what is seen now it may not be zero
        now.ints[GUARD_POWER] = 0
    return FOUND if not forgets and stays(t, past) else read(t, False, past)


# -- guesses --------------------------------------------------------------------------------


def judged(
    a: AutomatonArrays, run: Floats, now: Now, left: Left, past: PastArrays, status: int
) -> int:
    """Compare a guess with what was flown on it.

    Returns ``HOLDS``; the status of :func:`.confirmed` if another guess replaces it;
    ``NEXT_TO_NOTHING`` if the driver must fly on; or ``NO_ROOM``. If there was a jump, or something
    must be judged, shorter guesses are flown first, until none is needed; a lag that vanishes
    always needs one.
    """
    since, t = past.floats[GUESSED_FROM], time(now)
    jumped, vanishes = now.ints[JUMPS_MADE] >= run[JUMPS_DUE], past.floats[SHORTEST_LAG] <= slack(t)
    if ends(a, now, status) or (vanishes and (jumped or status == JUMP)):
        if not fits(now, left, past, status):
            return NO_ROOM
        walked(now, left, past, status)
        found = confirmed(since, t - since, past)
        if found != HOLDS:
            back(now, past)
        return found
    if status == FULL and not jumped and t == since:
        return HOLDS
    back(now, past)
    return NEXT_TO_NOTHING if vanishes and status == LOOK else nearer_guess(since, t, past)


def tried(now: Now, past: PastArrays) -> None:
    """Save the state from which guessed windows are flown."""
    copied(now.floats, past.floats_before)
    copied(now.x, past.before[0])
    copied(now.seen, past.before[1])
    copied(now.end, past.before[2])
    for k in range(now.ints.shape[0]):
        past.ints_before[k] = now.ints[k]
    for g in range(now.signs.shape[0]):
        past.signs[0, g], past.signs[1, g] = now.signs[g], now.orders[g]
    for g in range(now.tied.shape[0]):
        past.signs[2, g], past.signs[3, g] = now.tied[g], now.spent[g]
        past.signs[4, g], past.signs[5, g] = now.touched[g], now.impacts[g]
    past.floats[GUESSED_FROM], past.ints[STEPS_BEFORE] = time(now), past.ints[STEPS_DONE]


def back(now: Now, past: PastArrays) -> None:
    """Restore the state at which a guess began."""
    copied(past.floats_before, now.floats)
    copied(past.before[0], now.x)
    copied(past.before[1], now.seen)
    copied(past.before[2], now.end)
    for k in range(now.ints.shape[0]):
        if k != EXPANSIONS:
            now.ints[k] = past.ints_before[k]
    for g in range(now.signs.shape[0]):
        now.signs[g], now.orders[g] = past.signs[0, g], past.signs[1, g]
    for g in range(now.tied.shape[0]):
        now.tied[g], now.spent[g] = past.signs[2, g], past.signs[3, g]
        now.touched[g], now.impacts[g] = past.signs[4, g], past.signs[5, g]
    past.ints[STEPS_DONE] = past.ints[STEPS_BEFORE]


# -- the end of windows -------------------------------------------------------------------


def goes_on(now: Now, past: PastArrays) -> None:
    """Continue the arc where windows end. Of an arc that begins there no signs are known yet."""
    now.ints[PHASE] = WALKS
    now.ints[STEPS_MADE] -= now.ints[MADE]
    past.ints[IN_ARC], past.floats[BEGAN] = now.ints[JUMPS_MADE], now.floats[TAU]
    copied(now.end, past.start)
    for g in range(now.signs.shape[0]):
        past.signs[0, g] = now.signs[g] if now.ints[MADE] > 0 else 0


def ended(t: float, field: int, fired: int, past: PastArrays) -> None:
    """Note the breaking point that follows, in a field, from those at which windows end.

    ``fired``: twice the number of the moving lag that has reached the end of its window, plus one
    at its later end; -1 if none has.
    """
    n, any_met = past.own.shape[0], False
    for k in range(past.lags.shape[0]):
        met, end = meets(k, t, fired, past)
        for e in range(n):
            past.least[k, e] = SMOOTH_ORDER
        if met:
            apart = max(slack(t), slack(end))
            place = following(past, end - apart, False)
            while place < past.ints[BREAKS] and past.times[place] <= end + apart:
                any_met = True
                for e in range(n):
                    past.least[k, e] = min(past.least[k, e], past.orders[place, e])
                place += 1
    if any_met and carried(field, past) <= past.ints[BREAK_ORDER]:
        broken(past, t)
    few = past.ints[STEPPED] <= 2 and not any_met
    past.ints[TIGHT] = past.ints[TIGHT] + 1 if few else min(past.ints[TIGHT], 0)


def jumped(t: float, past: PastArrays) -> None:
    """Note the breaking point of a jump in the first field, by the first guard, of the tables."""
    corners(past, 0, 0)
    broken(past, t)


def meets(k: int, t: float, fired: int, past: PastArrays) -> tuple[bool, float]:
    """Whether a lag has reached the end of its window, and which one. A lag that has just turned
    backwards there goes on so, whichever other lag is there too."""
    here, apart, frame = t - past.lags[k], max(slack(t), slack(t - past.lags[k])), past.windows[k]
    if past.moves[k] == FIXED:
        return here >= frame[TO_PLACE] - apart, frame[TO_PLACE]
    late = here >= frame[TO_PLACE] - AT_THE_END * apart
    if late and past.moves[k] == BACKWARDS and fired // 2 != k:
        return False, frame[TO_PLACE]
    past.moves[k] = BACKWARDS if fired == 2 * k else MOVES_ON
    if past.moves[k] == BACKWARDS:
        past.ints[BREAK_ORDER] = min(past.ints[BREAK_ORDER], TURNING)
        return True, frame[SINCE_PLACE]
    return fired == 2 * k + 1 or late, frame[TO_PLACE]


def carried(field: int, past: PastArrays) -> int:
    """Find the orders of breaking points of all elements from those that the lags see (in
    ``past.least``); returns the least order seen."""
    n, own = past.own.shape[0], past.own
    for i in range(n):
        own[i] = SMOOTH_ORDER
        for k in range(past.lags.shape[0]):
            for e in range(n):
                if past.asks[field * n + i, k * n + e] == 1:
                    own[i] = min(own[i], past.least[k, e])
        own[i] += 1
    integrated(past, field)
    least = SMOOTH_ORDER
    for i in range(n):
        if past.heard[i] == 1:
            least = min(least, own[i])
    return least


def bound(a: AutomatonArrays, now: Now, room: Room, past: PastArrays) -> None:
    """Pass the windows to the programs, and compute what depends on them only."""
    put_in(
        a, room, past.shown, past.given, past.ranged, past.parts, past.ops, past.more, past.numbers
    )
    if now.ints[PHASE] == WALKS:
        inside(a, now, room)


def inside(a: AutomatonArrays, now: Now, room: Room) -> None:
    """Continue an arc in new windows; a place at one end of its window moves away from it."""
    field, t = now.ints[FIELD], time(now)
    first, last = a.fields[field, GUARDS], a.fields[field, GUARDS_END]
    for g in range(first, last if a.fields[field, LAGS] >= 0 else first):
        if a.guards[g, KIND] == WINDOW_END:
            program, place = a.fields[field, FIELD_PROGRAM], g - first
            afresh(a.programs, program, 0, t, now.end, room.still, room.aside, room.work)
            value = room.aside[row_of(a, program, field, g), 0]
            size, _, _ = sizes_of(a, room, g, t, now.end)
            leaves = size < math.inf and value <= GUARD_ROUNDING * EPS * size
            now.signs[place], now.orders[place] = 1, 1 if leaves else 0
            now.zeros[place, OFF] = abs(value) if leaves else 0.0
