"""Taylor jets of a model that is a tape: its operations are read once for each order.

Rows, numbers and the operations on them are those of :mod:`.operations`.
"""

from __future__ import annotations

import math

from .arrays import AutomatonArrays, Floats, Ints, Matrix, Programs, Room, Table
from .operations import integrate, operate

__all__ = ("afresh", "jets", "steady", "values")

#: A product and a sum are never one operation: a program's own machine code gives the same bits.
EXACT = True

# Columns of the index of programs: where its operations, kinks, outputs and flow begin. Behind each
# is where they end.
OPS, KINKS, OUTPUT, FLOW = 0, 2, 4, 6


def jets(
    p: Programs,
    program: int,
    order: int,
    t: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
) -> int:
    """The coefficients of all rows up to an order, along the flow from ``(t, x)``.

    Of a program for values only the coefficients of the states from the first order on are given:
    the rows are expanded along any motion.

    Parameters
    ----------
    sides
        For each kink the sign that it has from here on, or 0 where its value tells. A kink that is
        zero here gets the sign that it is about to have.
    c, work
        What is written, and room for the equations of contact forces.

    Returns
    -------
    status : int
        0, or -1 where a coefficient of a state or of an output does not exist.
    """
    n = x.shape[0]
    for i in range(n):
        c[i, 0] = x[i]
    c[n, 0] = t
    for k in range(1, order + 1):
        c[n, k] = 1.0 if k == 1 else 0.0
    kinks = p.index[program, KINKS + 1] - p.index[program, KINKS]
    for _ in range(kinks + 1):
        if p.code[program] != 0:
            run_code(p.code[program], order, p.more, p.numbers, sides, c, work)
        else:
            _recur(p, program, order, sides, c, work)
        if kinks == 0 or not _decided(p, program, order, sides, c):
            break
    for i in range(n):
        if missing(c, i, order):
            return -1
    for i in range(p.index[program, OUTPUT], p.index[program, OUTPUT + 1]):
        if missing(c, p.output[i], order):
            return -1
    return 0


def afresh(
    p: Programs,
    program: int,
    order: int,
    t: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
) -> int:
    """As :func:`jets`, where nothing is known of any kink: ``sides`` is what another program, or
    another state, has left."""
    for i in range(sides.shape[0]):
        sides[i] = 0
    return jets(p, program, order, t, x, sides, c, work)


def values(
    p: Programs,
    program: int,
    t: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
    out: Floats,
) -> int:
    """The values of a program's outputs at ``(t, x)``, where every kink is decided by its value.

    Returns
    -------
    status : int
        As that of :func:`jets`.
    """
    status = afresh(p, program, 0, t, x, sides, c, work)
    first = p.index[program, OUTPUT]
    for i in range(p.index[program, OUTPUT + 1] - first):
        out[i] = c[p.output[first + i], 0]
    return status


def steady(ops: Table, more: Ints, sides: Ints, s: Matrix, work: Floats) -> int:
    """The numbers that do not move, from those that are given: the same operations, at order 0."""
    _read(ops, 0, ops.shape[0], more, work, sides, s, work, 0)
    return 0


def put_in(
    a: AutomatonArrays,
    room: Room,
    shown: Floats,
    given: Table,
    ranged: Table,
    parts: Table,
    ops: Table,
    more: Ints,
    numbers: Matrix,
) -> None:
    """Pass numbers to the programs, and compute what depends on them only."""
    for g in range(given.shape[0]):
        numbers[given[g, 0], 0] = shown[given[g, 1]]
    for g in range(ranged.shape[0]):
        a.bounds.numbers[ranged[g, 0]] = shown[ranged[g, 1]]
    for q in range(parts.shape[0]):
        part = parts[q]
        steady(
            ops[part[0] : part[1]],
            more[part[2] : part[3]],
            room.still,
            numbers[part[4] : part[5]],
            room.work,
        )
    for i in range(room.sides.shape[0]):
        room.sides[i] = 0


def run_code(
    address: int, order: int, more: Ints, s: Floats, sides: Ints, c: Matrix, work: Floats
) -> None:
    """Do as :func:`_recur` by a program's own machine code, which plain Python never has.

    The loader puts a call of the address in the place of this text.
    """


def _recur(p: Programs, program: int, order: int, sides: Ints, c: Matrix, work: Floats) -> None:
    """All rows, order by order: what the flow is at one gives the states at the next."""
    first, last = p.index[program, OPS], p.index[program, OPS + 1]
    flow = p.index[program, FLOW]
    for k in range(order + 1):
        _read(p.ops, first, last, p.more, p.numbers, sides, c, work, k)
        if k < order:
            for i in range(p.index[program, FLOW + 1] - flow):
                integrate(i, p.flow[flow + i], p.numbers, c, k)


def missing(c: Matrix, row: int, order: int) -> bool:
    """Whether one of the coefficients of a row does not exist, where those of the states do.

    Then none of those behind it exists: each of an operation's has all before it in it. Only a
    value may be missing alone, as that of ``log``, whose slope is known, and of ``floor``; a state
    that grows by such a value misses its coefficient of order 1.
    """
    last = math.isnan(c[row, order])
    return last or (order > 0 and (math.isnan(c[row, 0]) or math.isnan(c[row, 1])))


def _decided(p: Programs, program: int, order: int, sides: Ints, c: Matrix) -> bool:
    """Give the first kink that is zero here the sign of its first coefficient, if there is one.

    Only the first: what comes behind may depend on it.
    """
    first = p.index[program, KINKS]
    for i in range(p.index[program, KINKS + 1] - first):
        row = p.kinks[first + i, 0]
        if p.kinks[first + i, 1] == 1 and c[row, 0] == 0.0 and sides[i] == 0:
            k = 1
            while k < order and c[row, k] == 0.0:
                k += 1
            if k <= order and (c[row, k] > 0.0 or c[row, k] < 0.0):
                sides[i] = 1 if c[row, k] > 0.0 else -1
                return True
    return False


def _read(
    ops: Table,
    first: int,
    last: int,
    more: Ints,
    s: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
    k: int,
) -> None:
    """All operations of a program, at order ``k``."""
    for j in range(first, last):
        operate(
            ops[j, 0],
            ops[j, 1],
            ops[j, 2],
            ops[j, 3],
            ops[j, 4],
            ops[j, 5],
            more,
            s,
            sides,
            c,
            work,
            k,
        )
