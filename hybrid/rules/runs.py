"""The loop of a run with sums of impacts and low flights.

What needs more than double precision to be believed of a sum, or all the rules, is left to Python,
as :mod:`.advance` says.
"""

from __future__ import annotations

import math

from .advance import added, advance, enlarged, entered
from .arcs import copied
from .arrays import AutomatonArrays, Floats, Left, Look, Now, Room, Sums
from .clocks import after, arc_end
from .contacts import asks, onto
from .entries import LIMIT_SPEED
from .guards import GUARD_ROUNDING, largest, sizes_of, so_far
from .hops import hop
from .jets import afresh
from .places import (
    ABSOLUTE,
    AT,
    AT_LIMIT,
    AT_REST,
    BEGINS,
    BOUNDS,
    CLOSING,
    CONSTRAINED,
    CROSSING,
    CURVE_DEGREE,
    CURVE_ROWS,
    DEPENDS,
    DRIVERS,
    ENDS_THERE,
    ERRORS,
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FIRED,
    FLIGHTS,
    FLOWING,
    FULL,
    GAP_SPEED,
    GOES_ON,
    GUARDS,
    GUARDS_END,
    HARD,
    HOLD,
    HOPS,
    JUMP,
    JUMPS_BEFORE,
    JUMPS_DUE,
    JUMPS_MADE,
    LAST_SPEED,
    LAST_TIME,
    LOCAL,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    METHOD_ORDER,
    NONE,
    OWN,
    PHASE,
    PLAIN,
    PROOF,
    PROVED,
    PULL,
    RATIO,
    RELATIVE,
    REMAINING,
    REST,
    REST_AFTER,
    SERIES,
    SIGHT,
    STEPS_LOST,
    STEPS_MADE,
    STRIKES,
    SUM,
    TAILS,
    TAU,
    TRIED,
    UNKNOWN,
    UNTIL,
    URGENT,
    WAS_LOW,
    WATCHED,
    T,
)
from .sights import EXCESS, LAW_CAUTION, damped, seen, slows
from .sums import (
    ERROR,
    STATE_THERE,
    SUM_FLOOR,
    close,
)
from .sums import TO_LIMIT as LIMITS
from .tails import clear, count
from .ties import FURTHEST_APART, keep_sides, late_by, note_sides, side_at
from .zeros import EPS

__all__ = ("go",)

#: If a sum would end after the run, it is tried again only once impacts are slower by this factor,
#: as the next piece of a signal may shorten it.
MUCH_LATER = 1e-3


def go(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look
) -> int:
    """Go on from ``now``; returns a status that says what is needed from outside
    (:mod:`.places`)."""
    status, run[UNTIL] = GOES_ON, arc_end(run, now)
    while status == GOES_ON:
        status = advance(a, run, now, room, sums.short, left)
        if status == SUM:
            status = accumulated(a, run, now, room, left, sums, look)
        elif status == HOPS:
            status = hopped(a, run, now, room, left, sums)
        if status == JUMP:
            now.ints[PHASE] = BEGINS
    return status


def accumulated(
    a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums, look: Look
) -> int:
    """Sum all impacts from the current one on, and pass their limit.

    Returns
    -------
    status : int
        ``GOES_ON`` after the limit, or at the impact if there is no sum; ``FULL`` after the limit;
        ``MAKE`` or ``PROOF``, to be called again; or ``JUMP``, and nothing has changed.
    """
    guard, place, field = now.ints[FIRED], now.ints[JUMPS_MADE], now.ints[FIELD]
    if run[REST_AFTER] == DRIVERS or run[JUMPS_DUE] < math.inf:
        return JUMP
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    if at == UNKNOWN:
        return asks(now, guard, AT)
    if at < 0:
        return JUMP
    held = a.fields[field, CONSTRAINED] == 1
    t, low = after(now.floats[T], now.floats[LOW], now.floats[TAU])
    x, v, column = left.after[place], now.floats[GAP_SPEED], guard - a.fields[field, GUARDS]
    _, fast, _ = sizes_of(a, room, guard, t, now.seen)
    spent = fast < math.inf and v <= LIMIT_SPEED * fast
    if spent:  # no sum was to be had, and the limit is reached
        return JUMP
    rtol, atol = run[CLOSING] * run[RELATIVE], run[CLOSING] * run[ABSOLUTE]
    local = a.guards[guard, LOCAL] == 1
    degree, r = close(a.programs, flow, at, column, held, local, t, x, v, rtol, atol, sums)
    if degree == 0:
        now.floats[TRIED] = v
        return GOES_ON
    if a.guards[guard, SIGHT] == UNKNOWN:
        return asks(now, guard, SIGHT)
    tail = now.ints[TAILS]
    put(tail, degree, r, v, place + 1, left, sums)
    if a.guards[guard, REST] < 0:
        return JUMP
    if not untouched(a, now, left, sums, flow, at, column, t, x):
        now.floats[TRIED] = v
        return GOES_ON
    proved, now.ints[PROVED] = now.ints[PROVED], 0
    if not kept_law(a, now, flow, at, guard, tail, t, x, left, sums, look) and proved == 0:
        return PROOF
    if proved == 0 and not believed(a, run, flow, at, guard, tail, t, x, left, sums, look):
        return PROOF
    end, rest = after(t, low, left.sums[tail, REMAINING])
    if (run[UNTIL] - end) - rest < 0.0 and not fits(run, now, left, tail, t, low, x):
        now.floats[TRIED] = v if (run[LAST_TIME] - end) - rest >= 0.0 else MUCH_LATER * v
        return GOES_ON
    return rests(a, run, now, room, left, t, low, proved)


def fits(run: Floats, now: Now, left: Left, tail: int, t: float, low: float, x: Floats) -> bool:
    """Whether a limit beyond the end of the arc may well be at it, for what a sum and the steps
    before may be off; its sum then ends there."""
    row, first = left.sums[tail], tail * CURVE_ROWS
    until = ((run[UNTIL] - t) - low) - EPS * abs(run[UNTIL])  # what is due there has not passed
    remaining, size = row[REMAINING], so_far(now, x)
    over, error = remaining - until, left.curves[first + ERRORS, 0]
    share = run[RELATIVE] + (run[ABSOLUTE] / size if size > 0.0 else 0.0)
    late = late_by(now.floats[STEPS_LOST], share, error, run[UNTIL], now.floats[TAU] + remaining)
    if not (until > 0.0 and over <= min(late, FURTHEST_APART * remaining)):
        return False
    for k in range(int(row[CURVE_DEGREE]) + 1):
        left.curves[first + k, 0] *= until / remaining
    row[REMAINING], left.curves[first + ERRORS, 0] = until, error + over
    return True


def put(tail: int, degree: int, r: float, v: float, jumps: int, left: Left, sums: Sums) -> None:
    """Record a sum."""
    row, first = left.sums[tail], tail * CURVE_ROWS
    row[JUMPS_BEFORE], row[CURVE_DEGREE], row[LAST_SPEED], row[RATIO] = jumps, degree, v, r
    row[REMAINING] = sums.lines[LIMITS, 0]
    for k in range(degree + 1):
        copied(sums.lines[k], left.curves[first + k])
    copied(sums.lines[ERROR], left.curves[first + ERRORS])
    copied(sums.lines[STATE_THERE], left.curves[first + AT_LIMIT])


def kept_law(
    a: AutomatonArrays,
    now: Now,
    flow: int,
    at: int,
    guard: int,
    tail: int,
    t: float,
    x: Floats,
    left: Left,
    sums: Sums,
    look: Look,
) -> bool:
    """Whether the restitution at each impact agrees with that of a sum's flights, within tolerance;
    the difference adds to the errors of the limit."""
    if a.guards[guard, DEPENDS] == 0:
        return True
    row, first, n = left.sums[tail], tail * CURVE_ROWS, x.shape[0]
    curve = left.curves[first : first + int(row[CURVE_DEGREE]) + 1]
    column, errors = guard - a.fields[now.ints[FIELD], GUARDS], left.curves[first + ERRORS]
    v, r, remaining, end = row[LAST_SPEED], row[RATIO], row[REMAINING], t + row[REMAINING]
    later, limit = remaining / (1.0 - r), left.curves[first + AT_LIMIT, :n]
    most = LAW_CAUTION * max(errors[0], SUM_FLOOR * abs(end)) / later
    impacts = count(t, r, remaining)
    p, laws = a.programs, look.laws
    off = damped(p, flow, at, column, False, curve, t, x, v, r, impacts, most, sums, laws)
    if not (off < math.inf and slows(p, at, end, limit, v, sums)):
        return False
    errors[0] += later * off
    if off > 0.0 and afresh(p, flow, 1, end, limit, sums.sides, sums.c, sums.work) == 0:
        for i in range(n):
            errors[i + 1] += later * off * abs(sums.c[i, 1])
    return True


def believed(
    a: AutomatonArrays,
    run: Floats,
    flow: int,
    at: int,
    guard: int,
    tail: int,
    t: float,
    x: Floats,
    left: Left,
    sums: Sums,
    look: Look,
) -> bool:
    """Whether no event hides between the flights of a sum, as far as bounds in double precision
    show."""
    sight, row, first = a.guards[guard, SIGHT], left.sums[tail], tail * CURVE_ROWS
    curve = left.curves[first : first + int(row[CURVE_DEGREE]) + 1]
    if sight == HARD:
        return False
    if sight == NONE:
        return True
    excess = EXCESS * run[CLOSING] ** 0.5
    return seen(a, flow, at, sight, curve, t, x, row[LAST_SPEED], row[RATIO], excess, sums, look)


def rests(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    left: Left,
    t: float,
    low: float,
    proved: int,
) -> int:
    """Begin the rest that follows a sum, or end the run there.

    Where all the rules are needed to begin the rest, a sum that Python has proved is left with NaN
    for the state at rest; otherwise the status is ``JUMP``.
    """
    guard, place, tail, n = now.ints[FIRED], now.ints[JUMPS_MADE], now.ints[TAILS], now.x.shape[0]
    field, first = a.guards[guard, REST], tail * CURVE_ROWS
    limit, x = left.curves[first + AT_LIMIT, :n], left.curves[first + AT_REST, :n]
    end, rest = after(t, low, left.sums[tail, REMAINING])
    plain = a.fields[field, PLAIN] != 0 and onto(a, field, end, limit, room, x)
    if not plain and proved == 0:
        return JUMP
    keep_sides(a, now, room, t, left.after[place], end, limit)
    added(now, left, guard, t, low)
    enlarged(now, left.after[place])
    now.ints[FLIGHTS] += 1
    own = a.guards[guard, OWN]
    now.spent[own], now.impacts[own] = now.ints[FLIGHTS], 0
    if plain:
        entered(a, now, field, own, 1, end, rest, x)
    else:
        x[0] = math.nan
    now.ints[SERIES], now.floats[PULL] = -1, 0.0
    now.ints[PHASE], now.ints[TAILS] = BEGINS, tail + 1
    last = run[REST_AFTER] == ENDS_THERE or tail + 1 == left.sums.shape[0]
    return GOES_ON if plain and not last else FULL


def hopped(a: AutomatonArrays, run: Floats, now: Now, room: Room, left: Left, sums: Sums) -> int:
    """Fly a low flight: its gap is comparable to the rounding of the state, so gap and gap speed
    are coordinates of their own in its series (7).

    Returns
    -------
    status : int
        ``GOES_ON`` to the impact at its end. ``GOES_ON``, too, if it is not low after all, goes
        beyond the end of the run, or another guard comes near: the arc then begins as any other.
        ``FULL`` or ``HOLD``, and it is still to be flown; ``LOOK`` if there is no room for it.
    """
    field, guard, place = now.ints[FIELD], now.ints[FIRED], now.ints[JUMPS_MADE]
    if begins_hidden(a, now):
        now.ints[LOW_AHEAD] = 0
        return GOES_ON
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    t, v, held = now.floats[T], now.floats[GAP_SPEED], a.fields[field, CONSTRAINED] == 1
    before, behind = left.before[place], left.after[place]
    rounding = GUARD_ROUNDING * EPS * so_far(now, now.x)
    status, time, speed, pieces = hop(
        a.programs, flow, at, guard - a.fields[field, GUARDS], held, t, now.x, v, rounding,
        now.signs[: domain(a, now)], before, behind, sums,
    )  # fmt: skip
    end, low = after(t, now.floats[LOW], time)
    if status < 0 or (run[UNTIL] - end) - low < 0.0:
        now.ints[LOW_AHEAD] = 0
        return GOES_ON
    if run[WATCHED] == 1.0 and now.ints[LOW_AHEAD] == 1:
        now.ints[MADE] = pieces
        return HOLD
    if now.ints[STEPS_MADE] + pieces > left.owner.shape[0]:
        return FULL if now.ints[STEPS_MADE] + now.ints[JUMPS_MADE] > 0 else LOOK
    copied(before, now.end)
    now.floats[TAU], now.floats[GAP_SPEED] = time, speed
    now.ints[LOW_AHEAD], now.ints[WAS_LOW], now.ints[PHASE] = 0, 1, STRIKES
    now.ints[FLIGHTS] += 1
    note_sides(a, now, room, end, guard)
    for piece in range(pieces):
        taken(now, left, sums, piece, run[METHOD_ORDER] > 0.0)
    now.ints[STEPS_MADE] += pieces
    now.ints[EXPANSIONS] += pieces
    return GOES_ON


def taken(now: Now, left: Left, sums: Sums, piece: int, shares: bool) -> None:
    """Record a piece of a flight as a step, by powers of the time, or with ``shares`` by powers of
    the share of the step."""
    place, n = now.ints[STEPS_MADE] + piece, now.x.shape[0]
    left.owner[place] = now.ints[JUMPS_MADE]
    left.spans[place, 0], left.spans[place, 1] = sums.starts[piece], sums.lengths[piece]
    if left.series.shape[0] > 0:
        for i in range(n):
            own, kept, power = sums.series[piece * n + i], left.series[place * n + i], 1.0
            for k in range(kept.shape[0]):
                kept[k] = own[k] * power if k < own.shape[0] else 0.0
                power *= sums.lengths[piece] if shares else 1.0


def untouched(
    a: AutomatonArrays,
    now: Now,
    left: Left,
    sums: Sums,
    flow: int,
    at: int,
    column: int,
    t: float,
    x: Floats,
) -> bool:
    """Whether no other guard is reached along the tail."""
    begin, n, row = now.ints[TAILS] * CURVE_ROWS, x.shape[0], left.sums[now.ints[TAILS]]
    curve = left.curves[begin : begin + int(row[CURVE_DEGREE]) + 1]
    limit, signs = left.curves[begin + AT_LIMIT, :n], now.signs[: domain(a, now)]
    rounding = GUARD_ROUNDING * EPS * largest(limit, now.ints[FLOWING])
    held = a.fields[now.ints[FIELD], CONSTRAINED] == 1
    return clear(
        a.programs, flow, at, column, held, signs, rounding, curve, t, x,
        row[LAST_SPEED], row[RATIO], row[REMAINING], limit, sums,
    )  # fmt: skip


def begins_hidden(a: AutomatonArrays, now: Now) -> bool:
    """Whether rounding does not tell a guard from zero where a flight begins: what it does there is
    for the rules of entering to say. Of all others it is known that they are not zero there."""
    first, last = a.fields[now.ints[FIELD], GUARDS], a.fields[now.ints[FIELD], GUARDS_END]
    for g in range(first, last):
        if side_at(now.touched[a.guards[g, OWN]], now.ints[FLIGHTS]) != 0:
            return True
        now.orders[g - first] = 0
    return False


def domain(a: AutomatonArrays, now: Now) -> int:
    """Write the sign that each guard must have for it not to fire on entering, 0 for those that may
    have either; returns how many there are."""
    first, last = a.fields[now.ints[FIELD], GUARDS], a.fields[now.ints[FIELD], GUARDS_END]
    for g in range(first, last):
        one_sided = max(a.guards[g, BOUNDS], a.guards[g, URGENT])
        now.signs[g - first] = -a.guards[g, CROSSING] * one_sided
    return last - first
