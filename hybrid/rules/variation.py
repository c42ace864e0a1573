"""The first variation along a flow, as power series beside that of the state.

A change of the state obeys ``M' = J M + P`` from ``M = (1, 0)``; the columns beyond the state's are
those of parameters. ``J`` and ``P`` are functions of a program, along its flow. There may be a row
more than the state has: a number that depends on the state, and on which nothing depends.
"""

from __future__ import annotations

from .arrays import Floats, Ints, Matrix, Programs, Table
from .checks import along
from .jets import KINKS, OUTPUT, jets
from .kinks import POINT
from .lengths import own_length, step_length
from .polynomials import power_value

__all__ = ("carried",)

#: Size of the last terms of a series, relative to its largest, at the end of a step.
ROUNDING = 1e-16

#: Most steps: a formula that needs more is not one that is smooth.
MOST = 10_000

#: Status codes: there is no series, or no end.
NO_SERIES, NO_END = -1, -2


def carried(
    p: Programs,
    t: float,
    x: Floats,
    length: float,
    beside: float,
    inside: Floats,
    places: Table,
    sides: Ints,
    c: Matrix,
    work: Floats,
    terms: Matrix,
    aside: Matrix,
    found: Matrix,
) -> int:
    """The matrix of a piece of an arc on which no formula changes.

    Parameters
    ----------
    p
        One program.
    t, x
        Where the piece begins; ``x`` gets its end.
    beside, inside
        A time within the piece, next to its start, and the state there: on which side of its kinks
        the piece is.
    places
        For each function of the program its place in ``(J, P)``; where there is none, 0 stands.
    sides, c, work
        As :func:`.jets.jets` takes them.
    terms, aside
        To work in: a row for each number of ``found``, as long as those of ``c``; and two matrices
        like ``found``, one below the other.
    found
        Gets the matrix, of as many rows as ``J`` and as many columns as ``(J, P)``.

    Returns
    -------
    status : int
        0, or why there is none.
    """
    _unmoved(found)
    begin, order = _sides(p, beside, inside, sides, c, work), c.shape[1] - 1
    done, steps = 0.0, 0
    while begin and done < length:
        if steps == MOST:
            return NO_END
        if jets(p, 0, order, t + done, x, sides, c, work) < 0:
            return NO_SERIES
        _expand(p, places, found.shape[0], found.shape[1], order, c, terms)
        h = min(length - done, step_length(c, x.shape[0]))
        for i in range(terms.shape[0]):
            h = min(h, own_length(terms[i], ROUNDING))
        if not done + h > done:
            return NO_SERIES
        along(c, h, x)
        _compose(terms, h, aside, found)
        done, steps = done + h, steps + 1
        for i in range(sides.shape[0]):
            sides[i] = 0
    return 0 if begin else NO_SERIES


def _sides(p: Programs, t: float, x: Floats, sides: Ints, c: Matrix, work: Floats) -> bool:
    """The sides of kinks at a state; whether there are any."""
    for i in range(sides.shape[0]):
        sides[i] = 0
    if sides.shape[0] > 0:
        if jets(p, 0, 0, t, x, sides, c, work) < 0:
            return False
        for i in range(p.index[0, KINKS], p.index[0, KINKS + 1]):
            value = c[p.kinks[i, 0], 0]
            if p.kinks[i, 1] == 1 and p.kinks[i, 2] != POINT and value != 0.0:
                sides[i - p.index[0, KINKS]] = 1 if value > 0.0 else -1
    return True


def _unmoved(m: Matrix) -> None:
    for i in range(m.shape[0]):
        for j in range(m.shape[1]):
            m[i, j] = 1.0 if i == j else 0.0


def _expand(
    p: Programs, places: Table, rows: int, columns: int, order: int, c: Matrix, terms: Matrix
) -> None:
    """The series of the matrix from the start of a step: order by order, as the flow's."""
    for i in range(rows):
        for j in range(columns):
            terms[i * columns + j, 0] = 1.0 if i == j else 0.0
    first = p.index[0, OUTPUT]
    for k in range(order):
        for i in range(rows * columns):
            terms[i, k + 1] = 0.0
        for f in range(places.shape[0]):
            slope, i, j = p.output[first + f], places[f, 0], places[f, 1]
            if j >= rows:
                terms[i * columns + j, k + 1] += c[slope, k]
            else:
                for column in range(columns):
                    total = 0.0
                    for m in range(k + 1):
                        total += c[slope, m] * terms[j * columns + column, k - m]
                    terms[i * columns + column, k + 1] += total
        for i in range(rows * columns):
            terms[i, k + 1] /= k + 1


def _compose(terms: Matrix, h: float, aside: Matrix, found: Matrix) -> None:
    """The matrix of a step behind that of those before."""
    (rows, columns), last = found.shape, terms.shape[1] - 1
    for i in range(rows):
        for j in range(columns):
            aside[i, j], _ = power_value(terms[i * columns + j], 0, last, h)
    for i in range(rows):
        for j in range(columns):
            total = aside[i, j] if j >= rows else 0.0
            for k in range(rows):
                total += aside[i, k] * found[k, j]
            aside[rows + i, j] = total
    for i in range(rows):
        for j in range(columns):
            found[i, j] = aside[rows + i, j]
