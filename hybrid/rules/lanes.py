"""Whole runs one after another, each with numbers of its own, as far as nothing needs judgement.

A lane goes through the loop of a run (:mod:`.advance`) as the driver would take it through: from a
start that leaves nothing to weigh to its last time, or to as many jumps as are permitted. What
needs the driver, a look for cycles among it, is told, and the lane is left to it.
"""

from __future__ import annotations

import math

from .arcs import copied
from .arrays import (
    AutomatonArrays,
    Floats,
    Ints,
    Left,
    Look,
    Matrix,
    Now,
    Pair,
    Room,
    Sums,
    Table,
)
from .clocks import after
from .jets import put_in
from .pairs import answers
from .places import (
    AT,
    AT_LIMIT,
    AT_START,
    BEGINS,
    CLOCK,
    CONTACT,
    END,
    ENTERED,
    ERRORS,
    EXPANSIONS,
    FIELD,
    FLIGHTS,
    FULL,
    GUARD_POWER,
    IMPACT_COUNT,
    JUMPS_BEFORE,
    JUMPS_MADE,
    KIND,
    LACKING,
    LACKING_AT,
    LAST_TIME,
    LAST_USED,
    LOW,
    LOW_AHEAD,
    MADE,
    MAKE,
    METHOD_ORDER,
    PHASE,
    PULL,
    RATIO,
    REMAINING,
    RUN_END,
    SERIES,
    SERIES_REACH,
    SHORT,
    STEPS_LOST,
    STEPS_MADE,
    TAILS,
    TAU,
    TO,
    TRIED,
    WAS_LOW,
    T,
)
from .runs import go
from .sums import restitution
from .zeros import EPS

__all__ = ("lanes",)

#: What becomes of a lane: it is left to the driver; it has come to its end; to its last jump; or it
#: asks for something of the guard that stands in the place of its mode, in the column that stands
#: in that of its sums.
LEFT, ENDED, LAST_JUMP, ASKS = 0, 1, 2, 3

#: Columns of what is told of a lane, in whole numbers; then in others: its time, that by which the
#: state is known, the first accumulation, and where the state begins; behind it is that at this
#: accumulation.
OUTCOME, MODE, MADE_JUMPS, MADE_STEPS, SUMMED, TOLD = range(6)
AT_TIME, FLOWN_TO, T_INF, T_ERROR, RATIO_OF, STATE = range(6)

#: The driver looks for a limit of cycles now and then, and whenever two turns of so few jumps at
#: most are shorter than a share of the one before (what such a sequence hides behind its first
#: ratio falls faster still, and shows at once after so many turns), or so many jumps take no time:
#: a few turns of the longest cycle.
LONGEST_CYCLE, FAST_FALL, FEW_TURNS = 8, 0.125, 3
STILL_JUMPS = FEW_TURNS * LONGEST_CYCLE

#: Flights longer than this share of the longest are taken to have left their guard: a flight lower
#: than rounding is shorter than the square root of rounding, and so much shorter.
IDLE_FLIGHT = 1e-3

#: It looks first when it has seen two windows of so many jumps, and then if the second is shorter
#: by this factor; a window, and the wait from look to look, is this part of the jumps seen, so that
#: looking stays cheap, and a wait so many jumps at least.
LEAST_WINDOW, WINDOW_FALL, WINDOW_PART, LEAST_WAIT = 12, 0.97, 8, 4

#: Lanes ask the driver a little more often than it would look, so that rounding does not decide.
SOONER = 1.0 + 1e-9

#: It goes over none where as many jumps as this were impacts of one contact, with a restitution
#: below this where they are slow: those are summed.
SUMMED_IMPACTS, DAMPED = 4, 1.0 - 2e-12

#: So many jumps in so many spacings of the time, and the driver says that they follow each other
#: with no time between them; twice as many are left to it.
CAUGHT, CAUGHT_SPACINGS = 100, 800.0


def lanes(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    left: Left,
    sums: Sums,
    look: Look,
    pair: Pair,
    parts: Table,
    given: Table,
    ranged: Table,
    ops: Table,
    more: Ints,
    numbers: Matrix,
    values: Matrix,
    spans: Matrix,
    starts: Matrix,
    field: int,
    watched: bool,
    ends: Matrix,
    told: Table,
    when: Matrix,
    fired: Table,
    around: Matrix,
    stop: Ints,
) -> int:
    """Fly some lanes; returns the steps made. Those that are not begun when ``stop`` is set are
    left.

    ``pair`` makes steps where they are not of Taylor series.
    ``parts`` has a row for each program: where its ``ops``, its list of arguments in ``more`` and
    its ``numbers``, which are those that ``a`` has, begin and end. ``given`` are places of
    parameters among these and their columns in ``values``, and ``ranged`` those of the bounds.
    ``watched``: whether the driver would look for cycles. ``when`` and ``fired`` have a column, and
    ``around`` two rows, before and after, for each of the first jumps of a lane.
    """
    made = 0
    for lane in range(starts.shape[0]):
        if stop[0] != 0:
            return made
        put_in(a, room, values[lane], given, ranged, parts, ops, more, numbers)
        run[LAST_TIME] = run[RUN_END] = spans[lane, 1]
        begun(a, now, spans[lane, 0], starts[lane], field)
        status = go(a, run, now, room, left, sums, look)
        while run[METHOD_ORDER] > 0.0 and answers(status, a, run, now, room, pair):
            status = go(a, run, now, room, left, sums, look)
        made += now.ints[EXPANSIONS]
        outcome = LEFT
        if status == END:
            outcome = ENDED
        elif status == MAKE:
            outcome = ASKS
        elif status == FULL and now.ints[JUMPS_MADE] == left.fired.shape[0]:
            outcome = LAST_JUMP
        jumps, tails = now.ints[JUMPS_MADE], now.ints[TAILS]
        if outcome == LAST_JUMP and tails > 0 and left.sums[tails - 1, JUMPS_BEFORE] == jumps:
            tails -= 1  # behind the last jump nothing is summed
        if stuck(left, jumps) or (watched and looks(a, left, jumps, tails, sums)):
            outcome = LEFT
        told[lane, OUTCOME], told[lane, MADE_JUMPS], told[lane, SUMMED] = outcome, jumps, tails
        told[lane, MADE_STEPS] = now.ints[STEPS_MADE]
        if outcome != LEFT:
            shown(a, run, now, left, outcome, tails, ends[lane], told[lane])
            listed(left, jumps, lane, when, fired, around)
    return made


def shown(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    left: Left,
    outcome: int,
    tails: int,
    end: Floats,
    told: Ints,
) -> None:
    """Tell where a lane has come to, and its first accumulation."""
    last, n = now.ints[JUMPS_MADE] - 1, now.x.shape[0]
    told[MODE] = now.ints[FIELD]
    if outcome == ASKS:
        told[MODE], told[SUMMED] = now.ints[LACKING], now.ints[LACKING_AT]
    elif outcome == ENDED:
        end[AT_TIME], end[FLOWN_TO] = run[LAST_TIME], now.floats[T] + now.floats[TAU]
        copied(now.end, end[STATE : STATE + n])
    else:
        summed = tails < now.ints[TAILS]  # behind that jump
        told[MODE] = a.guards[left.fired[last], TO] if summed else now.ints[FIELD]
        end[AT_TIME] = end[FLOWN_TO] = left.when[last, 0]
        copied(left.after[last], end[STATE : STATE + n])
    end[T_INF] = end[T_ERROR] = end[RATIO_OF] = math.nan
    if tails > 0:
        copied(left.curves[AT_LIMIT, :n], end[STATE + n :])
        jump = int(left.sums[0, JUMPS_BEFORE]) - 1
        end[T_INF], _ = after(left.when[jump, 0], left.when[jump, 1], left.sums[0, REMAINING])
        end[T_ERROR], end[RATIO_OF] = left.curves[ERRORS, 0], left.sums[0, RATIO]


def listed(left: Left, jumps: int, lane: int, when: Matrix, fired: Table, around: Matrix) -> None:
    """Keep the first jumps of a lane."""
    rows = when.shape[1]
    for j in range(min(jumps, rows)):
        when[lane, j], fired[lane, j] = left.when[j, 0], left.fired[j]
        place = 2 * (lane * rows + j)
        copied(left.before[j], around[place])
        copied(left.after[j], around[place + 1])


def begun(a: AutomatonArrays, now: Now, t: float, x: Floats, field: int) -> None:
    """A state at the start of a run."""
    now.floats[T], now.floats[LOW], now.floats[TAU], now.floats[TRIED] = t, 0.0, 0.0, math.inf
    now.ints[FIELD], now.ints[LAST_USED], now.ints[SERIES], now.ints[IMPACT_COUNT] = (
        field,
        AT_START,
        -1,
        0,
    )
    now.ints[ENTERED], now.ints[PHASE], now.ints[MADE], now.ints[GUARD_POWER] = 0, BEGINS, 0, 1
    now.ints[JUMPS_MADE], now.ints[STEPS_MADE], now.ints[EXPANSIONS], now.ints[TAILS] = 0, 0, 0, 0
    now.ints[LOW_AHEAD], now.ints[WAS_LOW], now.ints[SHORT] = 0, 0, 0
    now.floats[PULL], now.floats[SERIES_REACH], now.floats[STEPS_LOST] = 0.0, 0.0, 0.0
    now.ints[FLIGHTS] += 1  # what was tied, or spent, is so no more
    copied(x, now.x)
    for i in range(x.shape[0]):
        now.seen[i] = abs(x[i])
    for g in range(now.signs.shape[0]):
        now.signs[g] = 0
    for g in range(now.spent.shape[0]):
        now.impacts[g] = 0
        now.spent[g] = now.ints[FLIGHTS] if a.guards[g, KIND] == CLOCK else 0


def looks(a: AutomatonArrays, left: Left, jumps: int, tails: int, sums: Sums) -> bool:
    """Whether the driver would look for a limit of cycles, or might, and not leave it to a sum; it
    begins anew behind each sum, and behind each ring of a clock."""
    tail, first, due, still, longest = 0, 0, 2 * LEAST_WINDOW, 0, 0.0
    for j in range(jumps):
        longest = max(longest, left.when[j, 2])
    for j in range(jumps):
        rings = a.guards[left.fired[j], KIND] == CLOCK
        summed = tail < tails and left.sums[tail, JUMPS_BEFORE] == j
        if rings or summed:
            first, due, still = j, 2 * LEAST_WINDOW, 0
            tail += int(summed)
        if rings:
            first = j + 1
            continue
        still = still + 1 if idle(left, j, longest) else 1
        look = still >= STILL_JUMPS
        if j - first + 1 == due:
            due += max(LEAST_WAIT, due // WINDOW_PART)
            look = look or shrinks(left, first, j)
        for length in range(1, LONGEST_CYCLE + 1):
            look = look or (j - first >= 3 * length and falls(left, j, length))
        if look and not damps(a, left, first, j, sums):
            return True
    return False


def idle(left: Left, j: int, longest: float) -> bool:
    """Whether the flight before a jump took next to no time, against the longest of the lane."""
    spacings = CAUGHT_SPACINGS * EPS * abs(left.when[j, 0])
    return left.when[j, 2] <= max(IDLE_FLIGHT * longest, spacings)


def shrinks(left: Left, first: int, j: int) -> bool:
    """Whether the last jumps took less time than as many before."""
    window = max(LEAST_WINDOW, (j - first) // WINDOW_PART)
    middle, begin = j - window, max(first, j - 2 * window)
    return between(left, middle, j) < SOONER * WINDOW_FALL * between(left, begin, middle)


def damps(a: AutomatonArrays, left: Left, first: int, j: int, sums: Sums) -> bool:
    """Whether the last jumps were impacts of one contact that damps slow ones."""
    guard = left.fired[j]
    for k in range(SUMMED_IMPACTS):
        if j - k < first or left.fired[j - k] != guard:
            return False
    at = a.guards[guard, AT]
    if a.guards[guard, KIND] != CONTACT or at < 0:
        return False
    return restitution(a.programs, at, left.when[j, 0], left.after[j], -0.0, sums) < DAMPED


def between(left: Left, first: int, last: int) -> float:
    """The time from a jump to another."""
    return (left.when[last, 0] - left.when[first, 0]) + (left.when[last, 1] - left.when[first, 1])


def falls(left: Left, j: int, length: int) -> bool:
    """Whether the last two turns of a cycle were far shorter than those before."""
    last = left.when[j, 0] - left.when[j - length, 0]
    before = left.when[j - length, 0] - left.when[j - 2 * length, 0]
    first = left.when[j - 2 * length, 0] - left.when[j - 3 * length, 0]
    return last <= SOONER * FAST_FALL * before and before <= SOONER * FAST_FALL * first


def stuck(left: Left, jumps: int) -> bool:
    """Whether jumps follow each other with next to no time between them."""
    for j in range(CAUGHT - 1, jumps):
        t = left.when[j, 0]
        if t - left.when[j - CAUGHT + 1, 0] <= CAUGHT_SPACINGS * EPS * abs(t):
            return True
    return False
