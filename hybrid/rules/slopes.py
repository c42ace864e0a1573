"""How functions of an automaton map a change of time, state and parameters.

A change is a matrix with rows for time and the elements of the state. Those for the parameters are
not stored: their columns are those of the unit matrix.
"""

from __future__ import annotations

from .arrays import Changes, Floats, Matrix, Slopes
from .jets import afresh, values
from .linear import solve

__all__ = ("onto_contacts", "rates", "reset")


def product(row: Floats, change: Matrix, size: int, columns: int, first: int, k: int) -> float:
    """An entry of a row of derivatives times a change; column ``first`` belongs to the first
    parameter."""
    total = 0.0
    for i in range(size):
        total += row[i] * change[i, k]
    if 0 <= k - first < columns - size:
        total += row[size + k - first]
    return total


def rates(s: Slopes, program: int, t: float, x: Floats, room: Changes, out: Floats) -> None:
    """The flow at a state."""
    afresh(s.programs, program, 1, t, x, room.sides, room.c, room.work)
    for j in range(x.shape[0]):
        out[j] = room.c[j, 1]


def read(s: Slopes, program: int, t: float, x: Floats, room: Changes) -> None:
    """Evaluate a program."""
    values(s.programs, program, t, x, room.sides, room.c, room.work, room.read)


def reset(
    s: Slopes,
    program: int,
    t: float,
    x: Floats,
    first: int,
    columns: int,
    before: Matrix,
    after: Matrix,
    room: Changes,
) -> None:
    """The change of time and state after a jump, from that before it.

    ``columns``: number of columns of the derivatives; ``first``: column of the first parameter in
    the change.
    """
    n = x.shape[0]
    read(s, program, t, x, room)
    for k in range(before.shape[1]):
        after[0, k] = before[0, k]
        for i in range(n):
            row = room.read[i * columns : (i + 1) * columns]
            after[1 + i, k] = product(row, before, 1 + n, columns, first, k)


def onto_contacts(
    s: Slopes,
    program: int,
    held: int,
    t: float,
    x: Floats,
    first: int,
    columns: int,
    change: Matrix,
    room: Changes,
) -> bool:
    """Project a change of time and state onto held contacts: remove the changes of the gaps along
    their gradients, then those of the gap speeds along the impulses."""
    n = x.shape[0]
    read(s, program, t, x, room)
    for place in range(2):
        for i in range(held):
            off = (2 * i + place) * (columns + n)
            row = room.read[off : off + columns]
            for j in range(held):
                push = (2 * j + place) * (columns + n) + columns
                total = 0.0
                for e in range(n):
                    total += row[1 + e] * room.read[push + e]
                room.equations[i, j] = total
            for k in range(change.shape[1]):
                room.shares[i, k] = product(row, change, 1 + n, columns, first, k)
        if not solve(room.equations, held, room.shares, change.shape[1]):
            return False
        for j in range(held):
            push = (2 * j + place) * (columns + n) + columns
            for e in range(n):
                for k in range(change.shape[1]):
                    change[1 + e, k] -= room.read[push + e] * room.shares[j, k]
    return True
