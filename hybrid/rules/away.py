"""Guards that stay away from zero where their series have not converged.

The state may be known much further than a guard is: a ball over a table that shakes flies along a
parabola, and the table's series ends after a fraction of a turn. There the guard itself is bounded
over pieces of the step, in doubles rounded outwards, as its program makes it from the state.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Ints, Matrix, Now, Programs, Room
from .bounds import (
    ADD_BOUNDS,
    COS_BOUNDS,
    DIV_BOUNDS,
    EXP_BOUNDS,
    MUL_BOUNDS,
    NEG_BOUNDS,
    SIN_BOUNDS,
    SQRT_BOUNDS,
    SQUARE_BOUNDS,
    SUB_BOUNDS,
    bounds,
    outwards,
)
from .jets import OPS, OUTPUT
from .operations import (
    ADD,
    COPY,
    DIV,
    DOT,
    EXP,
    MUL,
    NEG,
    SCALE,
    SINE,
    SQRT,
    SQUARE,
    SUB,
    SUM_OF,
)
from .places import (
    ABSOLUTE,
    AFFINE,
    FIELD,
    GUARDS,
    GUARDS_END,
    RELATIVE,
    SERIES_END,
    USES,
    USES_END,
)

__all__ = ("away", "follow")

#: How a piece changes: the next is longer by the first, one that is undecided is cut to the second.
LONGER, CUT_TO = 2.0, 0.25


def away(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    program: int,
    t: float,
    near: float,
    far: float,
) -> float:
    """How far of a step from ``t``, of which ``room.c`` has the series, all guards stay away from
    zero behind the ends of their own (``now.zeros``), of which ``near`` is the first; at most
    ``far``. One that has changed its sign there has done so by its series: no more is asked.

    Away is what is further from zero than what the tolerances leave open of the states that a
    guard is made of.
    """
    piece = near
    while piece >= near and near < far:
        end = min(near + piece, far)
        if clear(a, run, now, room, program, t, near, end):
            piece *= LONGER
            near = end
        else:
            piece *= CUT_TO
    return near


def clear(
    a: AutomatonArrays,
    run: Floats,
    now: Now,
    room: Room,
    program: int,
    t: float,
    start: float,
    end: float,
) -> bool:
    """Whether the guards whose series end before a piece of the step does stay away from zero in
    it, on the side on which the step begins."""
    box, n, p = room.aside, now.end.shape[0], a.programs
    for i in range(n):
        along_piece(room.c[i], start, end, box[i])
    box[n, 0], box[n, 1] = bounds(ADD_BOUNDS, t, t, start, end)
    follow(p, program, box)
    first = a.fields[now.ints[FIELD], GUARDS]
    for g in range(first, a.fields[now.ints[FIELD], GUARDS_END]):
        if a.guards[g, AFFINE] == 0 and now.zeros[g - first, SERIES_END] < end:
            size = 0.0
            for k in range(a.guards[g, USES], a.guards[g, USES_END]):
                own = box[a.uses[k]]
                size = max(size, max(-own[0], own[1]))
            row = p.output[p.index[program, OUTPUT] + g - first]
            leaves = room.c[row, now.orders[g - first]]  # to this side
            least = run[ABSOLUTE] + run[RELATIVE] * size
            if not (box[row, 0] > least if leaves > 0.0 else box[row, 1] < -least):
                return False
    return True


def along_piece(c: Floats, start: float, end: float, found: Floats) -> None:
    """Bounds of a series over a piece of a step, behind its start, by Horner's rule."""
    last = c.shape[0] - 1
    while last > 0 and c[last] == 0.0:
        last -= 1
    low = high = c[last]
    for k in range(last - 1, -1, -1):
        least = low * (end if low < 0.0 else start)
        most = high * (start if high < 0.0 else end)
        low, high = outwards(least, most)
        low, high = outwards(low + c[k], high + c[k])
    found[0], found[1] = low, high


def follow(p: Programs, program: int, box: Matrix) -> None:
    """Bounds of all rows of a program, the lower in the first column of ``box`` and the upper in
    the second, from those of the states and the time; NaN where nothing is said."""
    for j in range(p.index[program, OPS], p.index[program, OPS + 1]):
        op, out, one, other = p.ops[j, 0], p.ops[j, 1], p.ops[j, 2], p.ops[j, 3]
        low, high = math.nan, math.nan
        if op == SUM_OF:
            low, high = total(p.more, one, other, 1, p.numbers, box)
        elif op == DOT:
            low, high = total(p.more, one, other, 2, p.numbers, box)
        elif op == SINE:
            low, high = made(SIN_BOUNDS, one, one, p.numbers, box)
            box[other, 0], box[other, 1] = made(COS_BOUNDS, one, one, p.numbers, box)
        elif op == COPY:
            low, high = of(one, p.numbers, box)
        elif on_bounds(op) >= 0:
            low, high = made(on_bounds(op), one, two(op, one, other), p.numbers, box)
        box[out, 0], box[out, 1] = low, high


def on_bounds(op: int) -> int:
    """The operation on bounds; -1 where there is none."""
    if op == ADD:
        return ADD_BOUNDS
    if op == SUB:
        return SUB_BOUNDS
    if op == NEG:
        return NEG_BOUNDS
    if op in (MUL, SCALE):
        return MUL_BOUNDS
    if op == SQUARE:
        return SQUARE_BOUNDS
    if op == DIV:
        return DIV_BOUNDS
    if op == SQRT:
        return SQRT_BOUNDS
    return EXP_BOUNDS if op == EXP else -1


def two(op: int, one: int, other: int) -> int:
    """The second argument of an operation; the first again where it has only one."""
    return other if op in (ADD, SUB, MUL, SCALE, DIV) else one


def total(
    more: Ints, first: int, count: int, factors: int, numbers: Floats, box: Matrix
) -> tuple[float, float]:
    """Bounds of a sum of many, or of products of many pairs."""
    low, high = 0.0, 0.0
    for i in range(first, first + factors * count, factors):
        least, most = of(more[i], numbers, box)
        if factors == 2:
            least, most = made(MUL_BOUNDS, more[i], more[i + 1], numbers, box)
        low, high = joined(ADD_BOUNDS, low, high, least, most)
    return low, high


def made(op: int, one: int, other: int, numbers: Floats, box: Matrix) -> tuple[float, float]:
    """Bounds of an operation on rows, or numbers."""
    a, b = of(one, numbers, box)
    c, d = of(other, numbers, box)
    return joined(op, a, b, c, d)


def joined(op: int, a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Bounds of an operation on two intervals; NaN where one is not known, or the result is not
    finite."""
    if math.isfinite(a) and math.isfinite(b) and math.isfinite(c) and math.isfinite(d):
        low, high = bounds(op, a, b, c, d)
        if math.isfinite(low) and math.isfinite(high):
            return low, high
    return math.nan, math.nan


def of(r: int, numbers: Floats, box: Matrix) -> tuple[float, float]:
    """Bounds of an argument: a row, or a number."""
    if r >= 0:
        return box[r, 0], box[r, 1]
    return numbers[-1 - r], numbers[-1 - r]
