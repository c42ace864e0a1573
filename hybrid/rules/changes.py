"""The derivatives of whole runs by their parameters, their start and their times.

A *change* is the first variation of time and state, one column per number that is varied. It is
carried along the log that the loop leaves (:class:`.Left`): along each arc by power series, through
each jump by its saltation matrix, through each sum of impacts by the derivative of its limit
(``docs/notes/gradients.md``). Runs for which this is not possible are left to Python, with a
status.
"""

from __future__ import annotations

import math

from .arrays import (
    AutomatonArrays,
    Changes,
    Floats,
    Ints,
    Left,
    Look,
    Matrix,
    Now,
    Pair,
    Room,
    Slopes,
    Sums,
    Table,
)
from .clocks import after, field_of
from .guards import NEAR
from .jets import afresh, put_in, values
from .kinks import count
from .lanes import ENDED, LAST_JUMP, MADE_JUMPS, OUTCOME, SUMMED, lanes
from .limits import KINK_SIDE, SAME_FLOW, SAME_KINK_TIME, USABLE, copied, limit, passed_at
from .places import (
    AT,
    AT_LIMIT,
    AT_REST,
    CONSTRAINED,
    CURVE_DEGREE,
    CURVE_ROWS,
    FIELD,
    FIELD_PROGRAM,
    GUARDS,
    JUMPS_BEFORE,
    KIND,
    LAST_SPEED,
    LAST_TIME,
    LEAVE,
    RATIO,
    RELEASE,
    REMAINING,
    STEPS_MADE,
    TAU,
    UNKNOWN,
)
from .polynomials import power_value
from .slopes import onto_contacts, product, rates, read, reset
from .variation import (
    GRADIENT,
    HELD_COUNT,
    KINKED,
    ONTO,
    RESET_SLOPES,
    SLOPES_FROM,
    SLOPES_PROGRAM,
    SLOPES_UNTIL,
    carried,
)

__all__ = ("flown",)

#: Outcomes: the change is known; the run is left to Python; derivatives of a field, or of a guard,
#: are needed.
KNOWN, LEFT_TO_PYTHON, OF_FIELD, OF_GUARD = 0, 1, 2, 3

#: A change of a guard below this share of its terms is rounding.
TIED = 1e-9

#: A guard's rate below this share of its terms may be what time rounds to, and is compared with
#: that after so many spacings of the time.
SLOW_RATE, MANY_SPACINGS = 1e-3, 1e6

#: Beside a kink the flow is read at this distance from the end of a piece: at least this share of
#: the time since the arc began, as nearer by rounding would decide the side; at most this share of
#: the piece.
TOLD_APART, MOST_ASIDE = 1e-10, 0.25

# Rows of ``lines``: the start of a piece of an arc, and a state next to it; the flow before and
# after a jump or a kink; a gradient; and flows beyond an end of an arc.
PIECE_START, PIECE_INSIDE, FLOW_BEFORE, FLOW_BEHIND, GRADIENT_ROW, NEAR_ROW, FAR_ROW = range(7)


def flown(
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
    own_parts: Table,
    own_given: Table,
    own_ops: Table,
    own_more: Ints,
    own_numbers: Matrix,
    own_room: Room,
    s: Slopes,
    changing: Changes,
    parameters: Matrix,
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
    asked: Table,
    found: Matrix,
) -> int:
    """Fly some lanes, as :func:`.lanes.lanes` does, and carry their changes.

    Parameters
    ----------
    own_parts, own_given, own_ops, own_more, own_numbers
        For the programs of ``s`` what ``parts`` and so on are for those of ``a``.
    asked : Table
        Gets for each lane the outcome, and the field or guard that is needed.
    found : Matrix
        Gets for each lane rows for the last time and the state there; for the time of the first
        accumulation, the state there and its ratio; and for the time of each of the first jumps and
        the states before and after it. Columns: the parameters, the elements of the state at the
        start, the first and the last time.
    """
    made, rows = 0, found.shape[0] // max(starts.shape[0], 1)
    for lane in range(starts.shape[0]):
        one, shown = lane + 1, 2 * when.shape[1]
        made += lanes(
            a, run, now, room, left, sums, look, pair, parts, given, ranged, ops, more, numbers,
            parameters[lane:one], spans[lane:one], starts[lane:one], field, watched, ends[lane:one],
            told[lane:one], when[lane:one], fired[lane:one],
            around[lane * shown : one * shown], stop,
        )  # fmt: skip
        asked[lane, 0], asked[lane, 1] = LEFT_TO_PYTHON, 0
        outcome = told[lane, OUTCOME]
        if outcome in (ENDED, LAST_JUMP):
            put_in(
                a, own_room, parameters[lane], own_given, ranged[:0], own_parts, own_ops, own_more,
                own_numbers,
            )  # fmt: skip
            asked[lane, 0], asked[lane, 1] = along(
                a, run, now, left, sums, s, changing, spans[lane, 0], starts[lane], field,
                told[lane, MADE_JUMPS], told[lane, SUMMED], outcome == ENDED,
                found[lane * rows : (lane + 1) * rows],
            )  # fmt: skip
    return made


def along(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    left: Left,
    sums: Sums,
    s: Slopes,
    room: Changes,
    t: float,
    x: Floats,
    field: int,
    jumps: int,
    tails: int,
    ends: bool,
    found: Matrix,
) -> tuple[int, int]:
    """Carry the changes along a run, and write them as :func:`flown` says; returns the outcome and
    what is needed."""
    n, tail, end, opens = x.shape[0], 0, 0, True
    for i in range(found.shape[0]):
        for k in range(found.shape[1]):
            found[i, k] = math.nan
    for j in range(jumps + int(ends)):
        field = flown_in(a, now, left, j, jumps)
        own = s.of_fields[field]
        if own < 0:
            return OF_FIELD if own == UNKNOWN else LEFT_TO_PYTHON, field
        row, length = s.fields[own], now.floats[TAU] if j == jumps else left.when[j, 2]
        begin, end = end, until(now, left, end, j)
        if opens:
            starts = j > 0 or begun(s, row, left, begin, end, t, x, room)
            if not length > 0.0 or not starts:
                return LEFT_TO_PYTHON, field
            if not carries(a, field, s, row, left, begin, end, t, x, length, sums, room):
                return LEFT_TO_PYTHON, field
        if j == jumps:
            there = ended(s, row, left, begin, end, run[LAST_TIME], now.end, room, found)
            return KNOWN if there else LEFT_TO_PYTHON, field
        guard, sums_up = left.fired[j], tail < tails and left.sums[tail, JUMPS_BEFORE] == j + 1
        own = s.of_guards[guard]
        if own < 0:
            return OF_GUARD if own == UNKNOWN else LEFT_TO_PYTHON, guard
        t, x, first = left.when[j, 0], left.after[j], 3 + 2 * n + j * (1 + 2 * n)
        before, line = left.before[j], s.guards[own]
        if opens and not arrives(s, line, row, left, begin, end, t, before, room):
            return LEFT_TO_PYTHON, guard
        if not opens and not together(s, line, t, before, room):
            return LEFT_TO_PYTHON, guard
        jumped(s, line, t, before, first, room, found)
        alone = opens
        opens = sums_up or j + 1 == jumps or left.when[j + 1, 2] > 0.0
        if not opens:
            copied(room.moved, room.state)
            continue
        smooth = alone and a.guards[guard, KIND] in (RELEASE, LEAVE)
        to = field if sums_up else flown_in(a, now, left, j + 1, jumps)
        if s.of_fields[to] < 0:
            return OF_FIELD if s.of_fields[to] == UNKNOWN else LEFT_TO_PYTHON, to
        row = s.fields[s.of_fields[to]]
        later = end if sums_up else until(now, left, end, j + 1)
        if not leaves(s, row, left, end, later, t, x, smooth, room):
            return LEFT_TO_PYTHON, guard
        if sums_up:
            if not accumulated(a, field, guard, s, own, t, x, left, tail, sums, room, found):
                return LEFT_TO_PYTHON, guard
            t, _ = after(t, left.when[j, 1], left.sums[tail, REMAINING])
            x = left.curves[tail * CURVE_ROWS + AT_REST, :n]
            tail += 1
    if not ends:  # at the last jump
        put(room.moved, 0, found, 0)
        for i in range(n):
            put(room.moved, 1 + i, found, 1 + i)
    return KNOWN, 0


def until(now: Now, left: Left, begins: int, arc: int) -> int:
    """The end of the steps of the arc whose first step is ``begins``."""
    end = begins
    while end < now.ints[STEPS_MADE] and left.owner[end] == arc:
        end += 1
    return end


def flown_in(a: AutomatonArrays, now: Now, left: Left, arc: int, jumps: int) -> int:
    """The field of an arc: the one that watches the guard that ended it, or the present one."""
    return field_of(a, left.fired[arc]) if arc < jumps else now.ints[FIELD]


def put(change: Matrix, row: int, found: Matrix, place: int) -> None:
    """Write a row of a change, if there is room for it."""
    if place < found.shape[0]:
        for k in range(found.shape[1]):
            found[place, k] = change[row, k]


def begun(
    s: Slopes,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    t: float,
    x: Floats,
    room: Changes,
) -> bool:
    """The change at the start of a run."""
    n, state, flow = x.shape[0], room.state, room.lines[FLOW_BEHIND]
    first = state.shape[1] - n - 2
    for i in range(n + 1):
        for k in range(state.shape[1]):
            state[i, k] = 1.0 if i > 0 and k == first + i - 1 else 0.0
    if not flow_at(s, row, left, begin, end, False, t, x, room, flow):
        return False
    for i in range(n):
        state[1 + i, first + n] = -flow[i]
    return True


def flow_at(
    s: Slopes,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    ends: bool,
    t: float,
    x: Floats,
    room: Changes,
    flow: Floats,
) -> bool:
    """Compute the flow at an end of an arc, with the formula that holds inside; returns whether it
    continues smoothly beyond. If not, neighbours change formula before the end, or not at all."""
    if row[KINKED] < 0 or end == begin:
        rates(s, row[SLOPES_PROGRAM], t, x, room, flow)
        return True
    step, n, beside = end - 1 if ends else begin, x.shape[0], room.lines[PIECE_INSIDE]
    length, series = left.spans[step, 1], left.series[step * n : (step + 1) * n]
    aside = apart(left, step)
    for i in range(n):
        _, flow[i] = power_value(series[i], 0, series.shape[1] - 1, length if ends else 0.0)
    for place in range(2):
        further = (1 + place) * (aside if ends else -aside)
        for i in range(n):
            beside[i] = x[i] + further * flow[i]
        rates(s, row[SLOPES_PROGRAM], t + further, beside[:n], room, room.lines[NEAR_ROW + place])
    for i in range(n):
        _, middle = power_value(series[i], 0, series.shape[1] - 1, 0.5 * length)
        beyond = 2.0 * room.lines[NEAR_ROW, i] - room.lines[FAR_ROW, i]
        if abs(beyond - flow[i]) > NEAR * max(abs(flow[i]), abs(middle)):
            return False
    return aside > 0.0


def apart(left: Left, step: int) -> float:
    """The distance from the end of a step at which the side of a kink is read; 0 if the step is too
    short."""
    length = left.spans[step, 1]
    aside = max(KINK_SIDE * length, TOLD_APART * (left.spans[step, 0] + length))
    return aside if aside <= MOST_ASIDE * length else 0.0


def carries(
    a: AutomatonArrays,
    field: int,
    s: Slopes,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    t: float,
    x: Floats,
    length: float,
    sums: Sums,
    room: Changes,
) -> bool:
    """Carry a change along an arc, after projecting it onto the held contacts; step by step where
    the flow may change its formula."""
    n, state, columns = x.shape[0], room.state, 1 + room.arc.shape[1]
    begins, inside = room.lines[PIECE_START, :n], room.lines[PIECE_INSIDE, :n]
    for k in range(state.shape[1]):
        state[0, k] = 0.0
    if not projected(s, row, t, x, columns, state, room.moved, room):
        return False
    if row[KINKED] < 0:
        for i in range(n):
            begins[i] = inside[i] = x[i]
        return passes(s, row, t, length, 0.0, n, room)
    for step in range(begin, end):
        aside, since = apart(left, step), left.spans[step, 0]
        for i in range(n):
            series = left.series[step * n + i]
            begins[i] = series[0]
            inside[i], _ = power_value(series, 0, series.shape[0] - 1, aside)
        if step > begin and not bent(a, field, s, row, left, step, t + since, sums, room):
            return False
        if not aside > 0.0 or not passes(s, row, t + since, left.spans[step, 1], aside, n, room):
            return False
    return end > begin


def passes(
    s: Slopes, row: Ints, t: float, length: float, aside: float, n: int, room: Changes
) -> bool:
    """Carry a change along a piece of an arc on which no formula changes."""
    begins, inside = room.lines[PIECE_START, :n], room.lines[PIECE_INSIDE, :n]
    places, state = s.places[row[SLOPES_FROM] : row[SLOPES_UNTIL]], room.state
    program, arc = row[SLOPES_PROGRAM], room.arc
    status = carried(s.programs, program, places, t, begins, length, t + aside, inside, room, arc)
    if status < 0:
        return False
    mapped(arc, n, state, room.moved)
    for i in range(n):
        for k in range(state.shape[1]):
            state[1 + i, k] = room.moved[1 + i, k]
    return True


def bent(
    a: AutomatonArrays,
    field: int,
    s: Slopes,
    row: Ints,
    left: Left,
    step: int,
    t: float,
    sums: Sums,
    room: Changes,
) -> bool:
    """Carry a change through the start of a step at which a kink may change the flow; returns
    whether the time of the change is a smooth function."""
    n, flow, jumps = room.state.shape[0] - 1, a.fields[field, FIELD_PROGRAM], False
    here, jump, x = room.lines[FLOW_BEFORE], room.lines[FLOW_BEHIND], room.lines[PIECE_START, :n]
    for i in range(n):
        before, later = left.series[(step - 1) * n + i], left.series[step * n + i, 1]
        _, here[i] = power_value(before, 0, before.shape[0] - 1, left.spans[step - 1, 1])
        jump[i] = later - here[i]
        jumps = jumps or abs(jump[i]) > SAME_FLOW * max(abs(later), abs(here[i]))
    if not jumps:
        return True
    afresh(a.programs, flow, 0, t, x, sums.sides, sums.aside, sums.work)
    read(s, row[KINKED], t, x, room)
    found = False
    for kink in range(count(a.programs, flow)):
        if passed_at(a.programs, flow, kink, t, x, here, left.spans[step - 1, 1], sums, room):
            if not turned(kink, here, found, room):
                return False
            found = True
    for k in range(room.state.shape[1]):
        for i in range(n):
            room.state[1 + i, k] -= jump[i] * room.moved[0, k]
    return found


def turned(kink: int, flow: Floats, known: bool, room: Changes) -> bool:
    """Compute how the time changes at which a kink is passed; returns whether it agrees with that
    of another kink, if ``known``."""
    state, columns, n = room.state, 1 + room.arc.shape[1], room.state.shape[0] - 1
    row = room.read[kink * columns : (kink + 1) * columns]
    rate = row[0]
    for i in range(n):
        rate += row[1 + i] * flow[i]
    for k in range(state.shape[1]):
        time = -product(row, state, 1 + n, columns, 0, k) / rate
        if known and abs(time - room.moved[0, k]) > SAME_KINK_TIME * abs(room.moved[0, k]):
            return False
        room.moved[0, k] = time
    return True


def projected(
    s: Slopes,
    row: Ints,
    t: float,
    x: Floats,
    columns: int,
    state: Matrix,
    moved: Matrix,
    room: Changes,
) -> bool:
    """Project a change at equal times onto the held contacts of a field, or onto its surface."""
    onto, held = row[ONTO], row[HELD_COUNT]
    if onto < 0:
        return True
    if held > 0:
        return onto_contacts(s, onto, held, t, x, 0, columns, state, room)
    reset(s, onto, t, x, 0, columns, state, moved, room)
    for i in range(1, 1 + x.shape[0]):
        for k in range(state.shape[1]):
            state[i, k] = moved[i, k]
    return True


def mapped(matrix: Matrix, n: int, state: Matrix, moved: Matrix) -> None:
    """Multiply a change at equal times by a matrix."""
    columns = state.shape[1]
    for i in range(n):
        row = matrix[i]
        for k in range(columns):
            total = row[n + k] if k < columns - n - 2 else 0.0
            for j in range(n):
                total += row[j] * state[1 + j, k]
            moved[1 + i, k] = total


def arrives(
    s: Slopes,
    own: Ints,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    t: float,
    before: Floats,
    room: Changes,
) -> bool:
    """Carry a change to the time at which a guard fires."""
    n, state, columns = before.shape[0], room.state, 1 + room.arc.shape[1]
    flow, across = room.lines[FLOW_BEFORE], room.lines[GRADIENT_ROW]
    if not flow_at(s, row, left, begin, end, True, t, before, room, flow):
        return False
    values(s.programs, own[GRADIENT], t, before, room.sides, room.c, room.work, across)
    rate, terms = across[0], abs(across[0])
    for i in range(n):
        rate += across[1 + i] * flow[i]
        terms += abs(across[1 + i] * flow[i])
    if rate == 0.0 or (
        abs(rate) < SLOW_RATE * terms and drowned(s, own, row, t, before, rate, room)
    ):
        return False
    for k in range(state.shape[1]):
        state[0, k] = 0.0
        state[0, k] = -product(across, state, 1 + n, columns, 0, k) / rate
        for i in range(n):
            state[1 + i, k] += flow[i] * state[0, k]
    return True


def drowned(
    s: Slopes, own: Ints, row: Ints, t: float, x: Floats, rate: float, room: Changes
) -> bool:
    """Whether a guard's rate is about what it changes by in a spacing of the time: when it is zero
    for neighbours is then rounding."""
    flow, across, n = room.lines[NEAR_ROW], room.lines[FAR_ROW], x.shape[0]
    later = t + MANY_SPACINGS * (math.nextafter(abs(t), math.inf) - abs(t))
    rates(s, row[SLOPES_PROGRAM], later, x, room, flow)
    values(s.programs, own[GRADIENT], later, x, room.sides, room.c, room.work, across)
    then = across[0]
    for i in range(n):
        then += across[1 + i] * flow[i]
    return abs(then - rate) > MANY_SPACINGS * USABLE * abs(rate)


def together(s: Slopes, own: Ints, t: float, before: Floats, room: Changes) -> bool:
    """Whether a guard that a jump has brought to zero is zero for neighbours too."""
    n, state, columns = before.shape[0], room.state, 1 + room.arc.shape[1]
    flow, across = room.lines[FLOW_BEFORE], room.lines[GRADIENT_ROW]
    values(s.programs, own[GRADIENT], t, before, room.sides, room.c, room.work, across)
    for k in range(state.shape[1]):
        size = abs(across[1 + n + k]) if k < columns - 1 - n else 0.0
        for i in range(1 + n):
            size += abs(across[i] * state[i, k])
        for i in range(n):  # of which a change that is rounding of others is made
            size += abs(across[1 + i] * flow[i] * state[0, k])
        if abs(product(across, state, 1 + n, columns, 0, k)) > TIED * size:
            return False
    return True


def jumped(
    s: Slopes, own: Ints, t: float, before: Floats, first: int, room: Changes, found: Matrix
) -> None:
    """Carry a change of time and state through a jump; write both sides from row ``first`` on."""
    n, state, moved = before.shape[0], room.state, room.moved
    if own[RESET_SLOPES] >= 0:
        reset(s, own[RESET_SLOPES], t, before, 0, 1 + room.arc.shape[1], state, moved, room)
    else:
        copied(state, moved)
    for i in range(1 + n):
        put(state, i, found, first + i)
    for i in range(1, 1 + n):
        put(moved, i, found, first + n + i)


def leaves(
    s: Slopes,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    t: float,
    x: Floats,
    smooth: bool,
    room: Changes,
) -> bool:
    """Turn a change of time and state after a jump into one of the state at equal times.

    ``smooth``: the flow after the jump is that before it.
    """
    n, state, moved = x.shape[0], room.state, room.moved
    flow = room.lines[FLOW_BEHIND]
    if not flow_at(s, row, left, begin, end, False, t, x, room, flow):
        return False
    if smooth:
        flow = room.lines[FLOW_BEFORE]
    for i in range(n):
        for k in range(state.shape[1]):
            state[1 + i, k] = moved[1 + i, k] - flow[i] * moved[0, k]
    return True


def accumulated(
    a: AutomatonArrays,
    field: int,
    guard: int,
    s: Slopes,
    contact: int,
    t: float,
    x: Floats,
    left: Left,
    tail: int,
    sums: Sums,
    room: Changes,
    found: Matrix,
) -> bool:
    """Carry a change through a sum of impacts, from ``moved``: that of its first impact."""
    n, row, first = x.shape[0], left.sums[tail], tail * CURVE_ROWS
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    column = guard - a.fields[field, GUARDS]
    held = a.fields[field, CONSTRAINED] == 1
    curve = left.curves[first : first + int(row[CURVE_DEGREE]) + 1]
    x_inf, out, state, moved = left.curves[first + AT_LIMIT, :n], room.out, room.state, room.moved
    none = room.maps[:0]
    usable = limit(
        a.programs, flow, at, column, held, s, contact, t, x, row[LAST_SPEED], row[RATIO],
        row[REMAINING], curve, x_inf, none, moved, sums, room, out,
    )  # fmt: skip
    if not usable <= USABLE:
        return False
    columns, last = 1 + room.arc.shape[1], moved.shape[1]
    if tail == 0:
        for i in range(n + 2):
            source = out[2 * n + 1 if i == n + 1 else i]
            for k in range(last):
                found[1 + n + i, k] = product(source, moved, 1 + n, columns, 0, k)
    for i in range(n):
        for k in range(last):
            state[1 + i, k] = product(out[1 + n + i], moved, 1 + n, columns, 0, k)
    return True


def ended(
    s: Slopes,
    row: Ints,
    left: Left,
    begin: int,
    end: int,
    t: float,
    x: Floats,
    room: Changes,
    found: Matrix,
) -> bool:
    """Write the change of the last time and of the state there."""
    n, flow, last = x.shape[0], room.lines[FLOW_BEFORE], found.shape[1] - 1
    if not flow_at(s, row, left, begin, end, True, t, x, room, flow):
        return False
    for k in range(found.shape[1]):
        found[0, k] = 1.0 if k == last else 0.0
        for i in range(n):
            found[1 + i, k] = room.state[1 + i, k] + (flow[i] if k == last else 0.0)
    return True
