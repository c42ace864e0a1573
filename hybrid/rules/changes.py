"""How whole runs change with their parameters, their start and their times.

A change is carried along the log that the loop of a run leaves (:class:`.Left`): along each arc by
power series, through each jump by its saltation, through each sum of impacts by its limit, as
``docs/notes/gradients.md`` says. What is beside that is told, and the run is left to Python.
"""

from __future__ import annotations

import math

from .advance import after
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
from .jets import values
from .lanes import ENDED, LAST_JUMP, MADE_JUMPS, OUTCOME, SUMMED, bound, lanes
from .limits import USABLE, limit
from .places import (
    AT,
    AT_LIMIT,
    AT_REST,
    CLOCKS_END,
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
    TAU,
    UNKNOWN,
)
from .slopes import onto_contacts, product, rates, reset
from .variation import (
    GRADIENT,
    HELD_COUNT,
    ONTO,
    RESET_SLOPES,
    SLOPES_FROM,
    SLOPES_PROGRAM,
    SLOPES_UNTIL,
    carried,
)

__all__ = ("flown",)

#: What becomes of the change of a run: it is known, or left to Python; or it asks for something of
#: a field, or of a guard.
KNOWN, LEFT_TO_PYTHON, OF_FIELD, OF_GUARD = 0, 1, 2, 3

# Rows of ``lines``: the start of an arc; the flow before a jump, and behind it; a gradient.
ARC_START, FLOW_BEFORE, FLOW_BEHIND, GRADIENT_ROW = 0, 1, 2, 3


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
        Of the programs of ``s`` what ``parts`` and the others are of those of ``a``.
    asked : Table
        Gets for each lane what becomes of its change, and of which field or guard that asks.
    found : Matrix
        Gets for each lane a row for the last time and the state there, for the time of the first
        accumulation, the state there and its ratio, and for the time of each of the first jumps
        and the states before it and after it; a column for each parameter, each element of the
        state at the start, and the first and the last time.
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
            bound(
                a, own_parts, own_given, ranged[:0], own_ops, own_more, own_numbers,
                parameters[lane], own_room,
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
    """Carry the changes along a run; as :func:`flown` puts them down."""
    n, tail = x.shape[0], 0
    for i in range(found.shape[0]):
        for k in range(found.shape[1]):
            found[i, k] = math.nan
    for j in range(jumps + int(ends)):
        field = flown_in(a, now, left, j, jumps)
        own = s.of_fields[field]
        if own < 0:
            return OF_FIELD if own == UNKNOWN else LEFT_TO_PYTHON, field
        row, length = s.fields[own], now.floats[TAU] if j == jumps else left.when[j, 2]
        if j == 0:
            begun(s, row, t, x, room)
        if not length > 0.0 or not carries(s, row, t, x, length, room):
            return LEFT_TO_PYTHON, field
        if j == jumps:
            ended(s, row, run[LAST_TIME], now.end, room, found)
            return KNOWN, 0
        guard, sums_up = left.fired[j], tail < tails and left.sums[tail, JUMPS_BEFORE] == j + 1
        own = s.of_guards[guard]
        if own < 0:
            return OF_GUARD if own == UNKNOWN else LEFT_TO_PYTHON, guard
        to = field if sums_up else flown_in(a, now, left, j + 1, jumps)
        if s.of_fields[to] < 0:
            return OF_FIELD if s.of_fields[to] == UNKNOWN else LEFT_TO_PYTHON, to
        later, smooth = s.fields[s.of_fields[to]], a.guards[guard, KIND] in (RELEASE, LEAVE)
        t, x, first = left.when[j, 0], left.after[j], 3 + 2 * n + j * (1 + 2 * n)
        if not jumped(
            s, s.guards[own], row, later, t, left.before[j], x, smooth, first, room, found
        ):
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


def flown_in(a: AutomatonArrays, now: Now, left: Left, arc: int, jumps: int) -> int:
    """The field of an arc: that in which the guard is watched that has ended it, or that in which
    the run has come to its end."""
    field = now.ints[FIELD]
    if arc < jumps:
        field, guard = 0, left.fired[arc]
        while not a.fields[field, GUARDS] <= guard < a.fields[field, CLOCKS_END]:
            field += 1
    return field


def put(change: Matrix, row: int, found: Matrix, place: int) -> None:
    """Put down a row of a change, if there is room for it."""
    if place < found.shape[0]:
        for k in range(found.shape[1]):
            found[place, k] = change[row, k]


def begun(s: Slopes, row: Ints, t: float, x: Floats, room: Changes) -> None:
    """The change at the start of a run."""
    n, state, flow = x.shape[0], room.state, room.lines[FLOW_BEHIND]
    first = state.shape[1] - n - 2
    rates(s, row[SLOPES_PROGRAM], t, x, room, flow)
    for i in range(n + 1):
        for k in range(state.shape[1]):
            state[i, k] = 1.0 if i > 0 and k == first + i - 1 else 0.0
    for i in range(n):
        state[1 + i, first + n] = -flow[i]


def carries(s: Slopes, row: Ints, t: float, x: Floats, length: float, room: Changes) -> bool:
    """Carry a change along an arc. On contacts it begins with its start's projection."""
    n, state, moved, arc = x.shape[0], room.state, room.moved, room.arc
    columns, begins = 1 + arc.shape[1], room.lines[ARC_START, :n]
    for k in range(state.shape[1]):
        state[0, k] = 0.0
    if not projected(s, row, t, x, columns, state, moved, room):
        return False
    for i in range(n):
        begins[i] = x[i]
    places = s.places[row[SLOPES_FROM] : row[SLOPES_UNTIL]]
    if carried(s.programs, row[SLOPES_PROGRAM], places, t, begins, length, t, x, room, arc) < 0:
        return False
    mapped(arc, 0, n, state, moved)
    for i in range(n):
        for k in range(state.shape[1]):
            state[1 + i, k] = moved[1 + i, k]
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
    """Project a change at equal times onto the contacts held in a field, or onto the surface on
    which it slides."""
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


def mapped(matrix: Matrix, first: int, n: int, state: Matrix, moved: Matrix) -> None:
    """What a matrix makes of a change at equal times; ``first`` is its first row."""
    for i in range(n):
        for k in range(state.shape[1]):
            moved[1 + i, k] = image(matrix, first + i, n, state, k)


def image(matrix: Matrix, row: int, n: int, state: Matrix, k: int) -> float:
    """An element of it, by a row of the matrix."""
    total = matrix[row, n + k] if k < state.shape[1] - n - 2 else 0.0
    for j in range(n):
        total += matrix[row, j] * state[1 + j, k]
    return total


def jumped(
    s: Slopes,
    own: Ints,
    row: Ints,
    later: Ints,
    t: float,
    before: Floats,
    behind: Floats,
    smooth: bool,
    first: int,
    room: Changes,
    found: Matrix,
) -> bool:
    """Carry a change through a jump from a field to another, put down from row ``first`` on.

    ``smooth``: the flow goes on as it was.
    """
    n, state, moved = before.shape[0], room.state, room.moved
    arrives, leaves = room.lines[FLOW_BEFORE], room.lines[FLOW_BEHIND]
    across = room.lines[GRADIENT_ROW]
    columns = 1 + room.arc.shape[1]
    rates(s, row[SLOPES_PROGRAM], t, before, room, arrives)
    rates(s, later[SLOPES_PROGRAM], t, behind, room, leaves)
    values(s.programs, own[GRADIENT], t, before, room.sides, room.c, room.work, across)
    rate = across[0]
    for i in range(n):
        rate += across[1 + i] * arrives[i]
    if rate == 0.0:
        return False
    for k in range(state.shape[1]):
        state[0, k] = 0.0
        state[0, k] = -product(across, state, 1 + n, columns, 0, k) / rate
        for i in range(n):
            state[1 + i, k] += arrives[i] * state[0, k]
    for i in range(1 + n):
        put(state, i, found, first + i)
    if own[RESET_SLOPES] >= 0:
        reset(s, own[RESET_SLOPES], t, before, 0, columns, state, moved, room)
    else:
        for i in range(1 + n):
            for k in range(state.shape[1]):
                moved[i, k] = state[i, k]
    for i in range(n):
        put(moved, 1 + i, found, first + 1 + n + i)
        flow = arrives[i] if smooth else leaves[i]
        for k in range(state.shape[1]):
            state[1 + i, k] = moved[1 + i, k] - flow * moved[0, k]
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
    """Carry a change through a sum of impacts."""
    n, row, first = x.shape[0], left.sums[tail], tail * CURVE_ROWS
    flow, at = a.fields[field, FIELD_PROGRAM], a.guards[guard, AT]
    column = guard - a.fields[field, GUARDS]
    held = a.fields[field, CONSTRAINED] == 1
    curve = left.curves[first : first + int(row[CURVE_DEGREE]) + 1]
    x_inf, out, state, moved = left.curves[first + AT_LIMIT, :n], room.out, room.state, room.moved
    none = room.maps[:0]
    usable = limit(
        a.programs, flow, at, column, held, s, contact, t, x, row[LAST_SPEED], row[RATIO],
        row[REMAINING], curve, x_inf, none, sums, room, out,
    )  # fmt: skip
    if not usable <= USABLE:
        return False
    if tail == 0:
        for i in range(n + 2):
            source = 2 * n + 1 if i == n + 1 else i
            for k in range(state.shape[1]):
                found[1 + n + i, k] = image(out, source, n, state, k)
    mapped(out, 1 + n, n, state, moved)
    for i in range(n):
        for k in range(state.shape[1]):
            state[1 + i, k] = moved[1 + i, k]
    return True


def ended(s: Slopes, row: Ints, t: float, x: Floats, room: Changes, found: Matrix) -> None:
    """The change of the last time, and of the state there."""
    n, flow, last = x.shape[0], room.lines[FLOW_BEFORE], found.shape[1] - 1
    rates(s, row[SLOPES_PROGRAM], t, x, room, flow)
    for k in range(found.shape[1]):
        found[0, k] = 1.0 if k == last else 0.0
        for i in range(n):
            found[1 + i, k] = room.state[1 + i, k] + (flow[i] if k == last else 0.0)
