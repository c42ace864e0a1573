"""Tape: a flow and functions along it, as arrays that a rule interprets.

Nothing is compiled or generated per model: the rule (:mod:`hybrid.rules.jets`) reads the operations
once for each order of the Taylor series. What is constant along the flow is computed once per set
of parameter values; these are not part of the tape. :mod:`.recorder` makes tapes; see
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
from ..rules.terms import TERMS_BESIDE
from ..rules.zeros import SPARE_ROWS

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Integers, Matrix, Numbers

#: For each operation, which of its columns refer to rows or numbers, and which to lists of these.
NAME_COLUMNS, LIST_COLUMNS = np.zeros((2, rule.INTEGRAL, 6), dtype=bool)
NAME_COLUMNS[:, 2:4] = True
NAME_COLUMNS[rule.SELECT, 4], NAME_COLUMNS[rule.FLOOR, 3] = True, False
NAME_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE], 2:4] = NAME_COLUMNS[rule.PICK, 2] = False
LIST_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE, rule.PICK], 2] = True
LIST_COLUMNS[rule.ATAN2, 4] = True

#: Kinds of watched functions, in the order of their numbers in the rules.
KINDS = ("kink", "step", "band", "pole", "point")


@attrs.frozen
class Watched:
    """A function that limits the validity of a step's series.

    Attributes
    ----------
    kind : "kink", "step", "band", "pole" or "point"
        kink: the formula switches at its zero. step: the formula switches at each whole number of
        the function; the nearest one is subtracted. band: the argument of a function that differs
        from a constant only between ``low`` and ``high``. pole: a quotient or power has a pole at
        its zero. point: a formula holds at its zero alone; it is not watched along the flow.
    node : int
        The function as a node of the graph (for a step, without the subtraction).
    """

    kind: str
    node: int
    low: float = -math.inf
    high: float = math.inf

    @property
    def code(self) -> int:
        """The number of the kind in the rules."""
        return KINDS.index(self.kind)

    @property
    def switches(self) -> bool:
        """Whether the flow changes its formula where the function passes zero."""
        return self.kind in ("kink", "step", "point")


@attrs.frozen(eq=False)
class Tape:
    """A flow and functions along it, as arrays (see :func:`hybrid.rules.jets.jets`).

    Attributes
    ----------
    size, rows
        Number of states, and of rows of coefficients.
    ops, more, flow, output, affine
        As the rule takes them; ``output`` lists the rows of the functions.
    timed : bool
        Whether the flow depends on the time itself.
    kinks, watched
        The watched functions as the rule takes them, and their descriptions.
    steady
        Operations on values that are constant along the flow.
    numbers
        Values that are constant along the flow; constants are filled in.
    given
        Places of parameters among the numbers, and the parameters' indices.
    room
        Length of the work array: it holds linear systems, then two states, their rates, and the
        sides of all kinks.
    """

    size: int
    rows: int
    ops: IntegerMatrix
    more: Integers
    flow: Integers
    output: Integers
    affine: Integers
    timed: bool
    kinks: IntegerMatrix
    watched: tuple[Watched, ...]
    steady: IntegerMatrix
    numbers: Numbers
    given: IntegerMatrix
    room: int

    @property
    def needs(self) -> tuple[int, int, int]:
        """Number of rows, number of kinks, and work array length, as :func:`room` takes them."""
        return self.rows, len(self.kinks), self.room

    def bind(self, parameters: Sequence[float], functions: Sequence[int] | None = None) -> Jets:
        """The tape for these (flattened) parameter values and for some of its functions."""
        numbers = self.numbers.copy()
        numbers[self.given[0]] = np.asarray(parameters, dtype=float)[self.given[1]]
        sides, work = np.zeros(len(self.kinks), dtype=np.int64), np.zeros(self.room)
        unit("jets").steady(self.steady, self.more, sides, numbers.reshape(-1, 1), work)
        chosen = np.arange(len(self.output)) if functions is None else ints([*functions])
        return Jets(self, numbers, self.output[chosen], self.affine[chosen])


@attrs.frozen(eq=False, slots=False)
class Jets:
    """A program: a tape with parameter values, for some of its functions."""

    tape: Tape
    numbers: Numbers
    output: Integers
    affine: Integers

    @cached_property
    def places(self) -> np.ndarray:
        """Indices of the functions that are watched along the series."""
        return ints([i for i, what in enumerate(self.tape.watched) if what.kind != "point"])

    @cached_property
    def watched(self) -> tuple[Watched, ...]:
        """The functions that are watched along the series."""
        return tuple(self.tape.watched[i] for i in self.places)

    @cached_property
    def alone(self) -> Programs:
        """This program as an array of one."""
        return linked([self])

    def room(self, order: int) -> Room:
        """Work arrays for this program alone."""
        return room(self.tape.needs, self.tape.size, order)

    def __call__(self, t: float, x: Sequence[float], sides: list[int], order: int) -> Any:
        """Taylor coefficients 0 to ``order`` of states, functions and watched functions.

        ``sides[i]`` is 0 if the branch of kink ``i`` follows from its value, or +1 / -1 if the sign
        from here on is given, because a step has just ended on the kink. It is updated in place: a
        kink that is zero here gets the sign that it is about to take.

        Raises
        ------
        ValueError
            If the series do not exist (``sqrt`` at 0, for instance).
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
        """Whether the Taylor coefficients of the states exist and are finite."""
        try:
            return bool(np.isfinite(self(t, x, [], order)[0]).all())
        except ValueError:
            return False

    def _watched(self, c: Matrix) -> list[list[float]]:
        """The series of the watched functions; 1 for an undefined one, on a branch not taken."""
        watched = c[self.tape.kinks[self.places, 0]]
        if np.isnan(watched).any():
            watched[np.isnan(watched).any(axis=1)] = np.eye(1, c.shape[1])[0]
        return watched.tolist()  # type: ignore[no-any-return]


def room(needs: Iterable[int], states: int, order: int) -> Room:
    """Work arrays for programs within the sizes ``needs`` (see :attr:`Tape.needs`)."""
    rows, kinks, beside = needs
    return Room(
        np.empty((rows, order + 1)),
        np.empty((rows, TERMS_BESIDE + 1)),
        np.empty(beside),
        np.empty((order + SPARE_ROWS, order + 5)),
        np.empty((2 * order + 4, 2)),
        np.zeros(kinks, dtype=np.int64),
        np.zeros(kinks, dtype=np.int64),
        np.empty(states),
    )


@contextmanager
def lent(free: dict[Any, list[Any]], needs: Any, make: Callable[[], Any]) -> Iterator[Any]:
    """Borrow work arrays that no other thread is using; they are made if all are in use."""
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
    """Concatenated programs, to which more can be added."""

    def __init__(self) -> None:
        self.count = 0
        self._ends = [0] * (len(Programs._fields) - 1)
        self._parts: list[list[np.ndarray]] = [[] for _ in Programs._fields]

    def add(self, part: Jets) -> int:
        """Append a program and return its number."""
        ops, more, numbers, kinks, bands, output, flow, *own = _arrays(part)
        ends, move = self._ends, partial(_moved, by=self._ends[2])
        named, listed = NAME_COLUMNS[ops[:, 0]], LIST_COLUMNS[ops[:, 0]]
        ops = np.where(named, move(ops), ops + ends[1] * listed)
        arrays = [ops, move(more), numbers, kinks, bands, output, move(flow), *own]
        self._ends = [end + len(array) for end, array in zip(ends, arrays, strict=True)]
        index = [place for i in (0, 3, 5, 6) for place in (ends[i], self._ends[i])]
        for column, array in zip(self._parts, [table([index], 8), *arrays], strict=True):
            column.append(array)
        self.count += 1
        return self.count - 1

    def programs(self) -> Programs:
        """All programs so far, as arrays."""
        self._parts = [[np.concatenate(column)] for column in self._parts]
        return Programs(*(column[0] for column in self._parts))


def linked(parts: Sequence[Jets]) -> Programs:
    """Several programs concatenated, with references to numbers and lists shifted."""
    together = Linked()
    for part in parts:
        together.add(part)
    return together.programs()


def _arrays(part: Jets) -> list[np.ndarray]:
    """The arrays of one program, in the order of :class:`.Programs` after the index."""
    tape = part.tape
    bands = np.array([(what.low, what.high) for what in tape.watched]).reshape(-1, 2)
    given = [tape.ops, tape.more, part.numbers, tape.kinks, bands]
    return [*given, part.output, tape.flow, part.affine, ints([tape.timed]), ints([0])]


def _moved(places: np.ndarray, by: int) -> np.ndarray:
    """References to numbers, which are negative, shifted by ``by``."""
    return np.where(places < 0, places - by, places)


def ints(values: Any) -> np.ndarray:
    """An array of 64-bit integers."""
    return np.array(values, dtype=np.int64)


def table(rows: Sequence[Sequence[int]], width: int) -> np.ndarray:
    """Rows padded with zeros to one width."""
    return ints([[*row, *[0] * (width - len(row))] for row in rows]).reshape(-1, width)
