"""A flow, and functions along it, as arrays that a rule interprets (:mod:`hybrid.rules.jets`).

Nothing is compiled for a model, and nothing is written out: the rule reads the operations once for
each order of the Taylor series. What does not move along the flow is computed once for the values
of the parameters, which are no part of the tape. How one is made is in :mod:`.recorder`; see
``docs/notes/tape.md``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..rules import operations as rule
from ..rules import unit
from ..rules.arrays import Programs, Room
from ..rules.zeros import SPARE_ROWS

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Integers, Matrix, Numbers

#: Of each operation's columns: which name rows or numbers, and which a list of such.
NAME_COLUMNS, LIST_COLUMNS = np.zeros((2, rule.INTEGRAL, 6), dtype=bool)
NAME_COLUMNS[:, 2:4] = True
NAME_COLUMNS[rule.SELECT, 4], NAME_COLUMNS[rule.FLOOR, 3] = True, False
NAME_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE], 2:4] = NAME_COLUMNS[rule.PICK, 2] = False
LIST_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE, rule.PICK], 2] = True
LIST_COLUMNS[rule.ATAN2, 4] = True

#: Kinds of what is watched, in the order of their numbers in a rule.
KINDS = ("kink", "step", "band", "pole", "point")


@attrs.frozen
class Watched:
    """What ends the series of a step besides their own last terms.

    Attributes
    ----------
    kind : "kink", "step", "band", "pole" or "point"
        A function at whose zero the formula switches; one that does so at each of its whole
        numbers, of which the nearest is taken off; the argument of a function that is more than
        rounding between ``low`` and ``high`` only; what a quotient or power has a pole at; a
        function at whose zero alone a formula holds, which is not watched along the flow.
    node : int
        The function (of steps without what is taken off) is a node of the graph.
    """

    kind: str
    node: int
    low: float = -math.inf
    high: float = math.inf

    @property
    def code(self) -> int:
        """The kind, as a rule has it."""
        return KINDS.index(self.kind)

    @property
    def switches(self) -> bool:
        """Whether the formula of the flow is another where it passes zero."""
        return self.kind in ("kink", "step", "point")


@attrs.frozen(eq=False)
class Tape:
    """A flow and functions along it, as arrays (see :func:`hybrid.rules.jets.jets`).

    Attributes
    ----------
    size, rows
        Number of states, and of rows of coefficients.
    ops, more, flow, output, affine
        As the rule takes them; ``output`` are the functions.
    kinks, watched
        What decides and what else is watched, as the rule takes it; what it is.
    steady
        The operations on what does not move.
    numbers
        What does not move: constants at their places.
    given
        Places of parameters among them, and their numbers.
    room
        Length of the array in which equations are solved, and behind them two states, their rates
        and the sides of all kinks are put aside.
    """

    size: int
    rows: int
    ops: IntegerMatrix
    more: Integers
    flow: Integers
    output: Integers
    affine: Integers
    kinks: IntegerMatrix
    watched: tuple[Watched, ...]
    steady: IntegerMatrix
    numbers: Numbers
    given: IntegerMatrix
    room: int

    @property
    def needs(self) -> tuple[int, int, int]:
        """Rows, kinks, and the length of the array beside them, for :func:`room`."""
        return self.rows, len(self.kinks), self.room

    def bind(self, parameters: Sequence[float], functions: Sequence[int] | None = None) -> Jets:
        """The tape for these values of the (flattened) parameters, for some of its functions."""
        numbers = self.numbers.copy()
        numbers[self.given[0]] = np.asarray(parameters, dtype=float)[self.given[1]]
        sides, work = np.zeros(len(self.kinks), dtype=np.int64), np.zeros(self.room)
        unit("jets").steady(self.steady, self.more, sides, numbers.reshape(-1, 1), work)
        chosen = np.arange(len(self.output)) if functions is None else ints([*functions])
        return Jets(self, numbers, self.output[chosen], self.affine[chosen])


@attrs.frozen(eq=False, slots=False)
class Jets:
    """A tape with the values of the parameters, for some of its functions: a program."""

    tape: Tape
    numbers: Numbers
    output: Integers
    affine: Integers

    @cached_property
    def places(self) -> np.ndarray:
        """Which of all that is watched is watched along the series."""
        return ints([i for i, what in enumerate(self.tape.watched) if what.kind != "point"])

    @cached_property
    def watched(self) -> tuple[Watched, ...]:
        """What is watched along the series."""
        return tuple(self.tape.watched[i] for i in self.places)

    @cached_property
    def alone(self) -> Programs:
        """This program, and no other."""
        return linked([self])

    def room(self, order: int) -> Room:
        """Arrays to work in, for this program alone."""
        return room(self.tape.needs, self.tape.size, order)

    def __call__(self, t: float, x: Sequence[float], sides: list[int], order: int) -> Any:
        """Coefficients 0 .. ``order`` of the states, of the functions, and of what is watched.

        ``sides[i]`` is 0 (the branch of kink ``i`` is taken by value) or +1 / -1 (the sign that it
        has from here on: a step has just ended on it). It is completed in place: a kink that is
        zero here gets the sign that it is about to have.

        Raises
        ------
        ValueError
            Where the series do not exist (``sqrt`` at 0, for instance).
        """
        tape = self.tape
        all_sides = np.zeros(len(tape.kinks), dtype=np.int64)
        if sides:
            all_sides[self.places] = sides
        c = np.empty((tape.rows, order + 1))
        start, work = np.array(x, dtype=float), np.empty(tape.room)
        if unit("jets").jets(self.alone, 0, order, float(t), start, all_sides, c, work):
            raise ValueError("there is no Taylor series here")
        sides[:] = all_sides[self.places].tolist() if sides else []
        watched = self._watched(c) if sides else []
        return c[: tape.size].tolist(), c[self.output].tolist(), watched

    def finite(self, t: float, x: Sequence[float], order: int) -> bool:
        """Whether the coefficients of the states are there, and numbers."""
        try:
            return bool(np.isfinite(self(t, x, [], order)[0]).all())
        except ValueError:
            return False

    def _watched(self, c: Matrix) -> list[list[float]]:
        """The series of what is watched; on a branch that is not taken nothing happens."""
        watched = c[self.tape.kinks[self.places, 0]]
        if np.isnan(watched).any():
            watched[np.isnan(watched).any(axis=1)] = np.eye(1, c.shape[1])[0]
        return watched.tolist()  # type: ignore[no-any-return]


def room(needs: Iterable[int], states: int, order: int) -> Room:
    """Arrays to work in for programs, none of which needs more than :attr:`Tape.needs` says."""
    rows, kinks, beside = needs
    return Room(
        np.empty((rows, order + 1)),
        np.empty((rows, 3)),
        np.empty(beside),
        np.empty((order + SPARE_ROWS, order + 5)),
        np.empty((2 * order + 4, 2)),
        np.zeros(kinks, dtype=np.int64),
        np.zeros(kinks, dtype=np.int64),
        np.empty(states),
    )


@contextmanager
def lent(free: dict[Any, list[Any]], needs: Any, make: Callable[[], Any]) -> Iterator[Any]:
    """Arrays to work in, such as nobody is using: threads share what they are for, and not them."""
    unused = free.setdefault(needs, [])
    try:
        rooms = unused.pop()
    except IndexError:
        rooms = make()
    try:
        yield rooms
    finally:
        unused.append(rooms)


class Linked:
    """Programs one behind the other, to which more are added."""

    def __init__(self) -> None:
        self.count = 0
        self._ends = [0] * (len(Programs._fields) - 1)
        self._parts: list[list[np.ndarray]] = [[] for _ in Programs._fields]

    def add(self, part: Jets) -> int:
        """Put a program behind the others, whose number is returned."""
        ops, more, numbers, kinks, bands, output, flow, affine, code = _arrays(part)
        ends, move = self._ends, partial(_moved, by=self._ends[2])
        named, listed = NAME_COLUMNS[ops[:, 0]], LIST_COLUMNS[ops[:, 0]]
        ops = np.where(named, move(ops), ops + ends[1] * listed)
        arrays = [ops, move(more), numbers, kinks, bands, output, move(flow), affine, code]
        self._ends = [end + len(array) for end, array in zip(ends, arrays, strict=True)]
        index = [place for i in (0, 3, 5, 6) for place in (ends[i], self._ends[i])]
        for column, array in zip(self._parts, [table([index], 8), *arrays], strict=True):
            column.append(array)
        self.count += 1
        return self.count - 1

    def programs(self) -> Programs:
        """All so far; what was joined before is joined to what came after it."""
        self._parts = [[np.concatenate(column)] for column in self._parts]
        return Programs(*(column[0] for column in self._parts))


def linked(parts: Sequence[Jets]) -> Programs:
    """Programs one behind the other: places of numbers and of lists are counted on."""
    together = Linked()
    for part in parts:
        together.add(part)
    return together.programs()


def _arrays(part: Jets) -> list[np.ndarray]:
    """The arrays of a program alone, in the order of :class:`.Programs`."""
    tape = part.tape
    bands = np.array([(what.low, what.high) for what in tape.watched]).reshape(-1, 2)
    given = [tape.ops, tape.more, part.numbers, tape.kinks, bands]
    return [*given, part.output, tape.flow, part.affine, ints([0])]


def _moved(places: np.ndarray, by: int) -> np.ndarray:
    """Places of numbers, which are below zero, counted on."""
    return np.where(places < 0, places - by, places)


def ints(values: Any) -> np.ndarray:
    """Whole numbers as an array."""
    return np.array(values, dtype=np.int64)


def table(rows: Sequence[Sequence[int]], width: int) -> np.ndarray:
    """Rows of one width, filled with zeros."""
    return ints([[*row, *[0] * (width - len(row))] for row in rows]).reshape(-1, width)
