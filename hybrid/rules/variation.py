"""The first variation along a flow, as power series beside that of the state.

It obeys ``M' = J M + P`` with ``M = (1, 0)`` at the start; the columns after those of the state
belong to parameters. ``J`` and ``P`` are functions of a program along its flow. There may be one
more row than state elements, for a number that depends on the state and on which nothing depends.
"""

from __future__ import annotations

from .arrays import Changes, Floats, Ints, Matrix, Programs, Table
from .checks import along
from .jets import KINKS, OUTPUT, jets
from .kinks import POINT, in_bands
from .lengths import FIRST_TERMS, LAST_TERMS, own_length, step_length
from .polynomials import power_value

__all__ = ("carried",)

#: Columns of the tables of derivatives. For a field, and for a contact with its gap after the
#: states: the program of ``J`` and ``P``, the range of its places, the program of the projection
#: onto held contacts (-1: none), and their number. For a guard also: its gradient, and the
#: derivatives of its jump (-1: no change); for a contact those of its gap speed, of its restitution
#: and of its watched functions, and the row of the field at rest (-1).
SLOPES_PROGRAM, SLOPES_FROM, SLOPES_UNTIL, ONTO, HELD_COUNT = range(5)
GRADIENT, RESET_SLOPES, SPEED_SLOPES, LAW_SLOPES, KINKED, REST_ROW = range(5, 11)

#: Most steps; a formula that needs more is not smooth.
VARIATION_STEPS = 10_000

#: Status codes: there is no series, or no end.
NO_SERIES, NO_END = -1, -2


def carried(
    p: Programs,
    program: int,
    places: Table,
    t: float,
    x: Floats,
    length: float,
    beside: float,
    inside: Floats,
    room: Changes,
    found: Matrix,
) -> int:
    """The matrix of a piece of an arc on which no formula changes.

    Parameters
    ----------
    t, x
        Start of the piece; ``x`` gets the state at its end.
    beside, inside
        A time within the piece, next to its start, and the state there, which decide the sides of
        kinks.
    places
        For each function of the program its place in ``(J, P)``; other entries are 0.
    found
        Gets the matrix, with the rows of ``J`` and the columns of ``(J, P)``.

    Returns
    -------
    status : int
        0, or why there is none.
    """
    unmoved(found)
    c, sides = room.c, room.sides
    begin, order = _sides(p, program, beside, inside, sides, c, room.work), c.shape[1] - 1
    done, steps = 0.0, 0
    while begin and done < length:
        if steps == VARIATION_STEPS:
            return NO_END
        if jets(p, program, order, t + done, x, sides, c, room.work) < 0:
            return NO_SERIES
        first = p.index[program, OUTPUT]
        _expand(p.output[first:], places, found.shape[0], found.shape[1], order, c, room)
        h = _step(c, x.shape[0], room.terms, found.shape[0] * found.shape[1], length - done)
        h = in_bands(
            p, program, h, c
        )  # where derivatives are flat to rounding, series show nothing
        if not done + h > done:
            return NO_SERIES
        along(c, h, x)
        _summed(room.terms, h, found.shape[0], found.shape[1], room.aside)
        composed(room.aside, found)
        done, steps = done + h, steps + 1
        for i in range(sides.shape[0]):
            sides[i] = 0
    return 0 if begin else NO_SERIES


def _step(c: Matrix, n: int, terms: Matrix, count: int, most: float) -> float:
    """A length, at most ``most``, at which the last two terms of all series are rounding. ``most``
    is tried first, as checking a length is cheaper than finding one."""
    h = most
    for i in range(n):
        if not small(c[i], FIRST_TERMS, h):
            h = min(h, step_length(c, n))
    for i in range(count):
        if not small(terms[i], terms.shape[1] - 2, h):
            h = min(h, own_length(terms[i], LAST_TERMS))
    return h


def small(c: Floats, measure: int, h: float) -> bool:
    """Whether the last two terms of a series are rounding relative to its first terms."""
    size, power, order = 0.0, 1.0, c.shape[0] - 1
    for k in range(order - 1):
        if k < measure:
            size = max(size, abs(c[k]) * power)
        power *= h
    return max(abs(c[order - 1]), abs(c[order]) * h) * power <= LAST_TERMS * size


def _sides(
    p: Programs, program: int, t: float, x: Floats, sides: Ints, c: Matrix, work: Floats
) -> bool:
    """Determine the sides of kinks at a state; returns whether there are any."""
    for i in range(sides.shape[0]):
        sides[i] = 0
    first, last = p.index[program, KINKS], p.index[program, KINKS + 1]
    if last > first:
        if jets(p, program, 0, t, x, sides, c, work) < 0:
            return False
        for i in range(first, last):
            value = c[p.kinks[i, 0], 0]
            if p.kinks[i, 1] == 1 and p.kinks[i, 2] != POINT and value != 0.0:
                sides[i - first] = 1 if value > 0.0 else -1
    return True


def unmoved(m: Matrix) -> None:
    """Write the unit matrix."""
    for i in range(m.shape[0]):
        for j in range(m.shape[1]):
            m[i, j] = 1.0 if i == j else 0.0


def _expand(
    output: Ints, places: Table, rows: int, columns: int, order: int, c: Matrix, room: Changes
) -> None:
    """Compute the series of the matrix from the start of a step, order by order, like the flow's.

    The numbers of an order are computed side by side, so that sums of products do not wait for each
    other.
    """
    orders, count = room.orders, rows * columns
    for i in range(count):
        orders[0, i] = 1.0 if i % columns == i // columns else 0.0
    for k in range(order):
        for i in range(count):
            orders[k + 1, i] = 0.0
        for f in range(places.shape[0]):
            slope, first, j = output[f], places[f, 0] * columns, places[f, 1]
            if j >= rows:
                orders[k + 1, first + j] += c[slope, k]
            else:
                for m in range(k + 1):
                    share = c[slope, m]
                    if share != 0.0:
                        for column in range(columns):
                            term = orders[k - m, j * columns + column]
                            orders[k + 1, first + column] += share * term
        for i in range(count):
            orders[k + 1, i] /= k + 1
    for i in range(count):
        for k in range(order + 1):
            room.terms[i, k] = orders[k, i]


def _summed(terms: Matrix, h: float, rows: int, columns: int, found: Matrix) -> None:
    """Compute the matrix of a step."""
    for i in range(rows):
        for j in range(columns):
            found[i, j], _ = power_value(terms[i * columns + j], 0, terms.shape[1] - 1, h)


def composed(later: Matrix, found: Matrix) -> None:
    """Replace a matrix by its product with the ``later`` one, which has room below."""
    rows, columns = found.shape
    for i in range(rows):
        for j in range(columns):
            total = later[i, j] if j >= rows else 0.0
            for k in range(rows):
                total += later[i, k] * found[k, j]
            later[rows + i, j] = total
    for i in range(rows):
        for j in range(columns):
            found[i, j] = later[rows + i, j]
