"""A reader of the graph: a flow, and functions along it, as arrays that a rule interprets.

Nothing is compiled for a model, and nothing is written out: :mod:`hybrid.rules.jets` reads the
operations once for each order of the Taylor series. A node of the graph is an operation; what does
not move along the flow is computed once for the values of the parameters, which are no part of the
tape. See ``docs/notes/tape.md``.

Where a model switches formula (``abs``, ``where``, ``max``, ``floor``), the coefficients belong to
the branch at the start. The function that decides is returned too, as a *kink*: the series hold up
to its first zero. So are the arguments of functions that are flat to rounding almost everywhere
(``exp``, ``tanh``), whose coefficients show nothing of a pulse to come.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from typing import Any

import attrs
import numpy as np

from ..errors import TraceError
from ..rules import operations as rule
from ..rules import unit
from ..rules.arrays import Programs, Room
from ..rules.zeros import SPARE_ROWS
from .derivatives import degree, unknowns
from .graph import Graph, Ids, needed
from .taylor import SLOPES

#: Operations that the rule has under the same name.
NUMBERED_OPS = {
    **{"add": rule.ADD, "sub": rule.SUB, "neg": rule.NEG, "div": rule.DIV, "gt": rule.GT},
    **{"ge": rule.GE, "lt": rule.LT, "le": rule.LE, "eq": rule.EQ, "ne": rule.NE},
    **{"and": rule.AND, "or": rule.OR, "xor": rule.XOR, "not": rule.NOT},
    **{"is_finite": rule.FINITE, "select": rule.SELECT, "nearest": rule.NEAREST},
    **{"floor": rule.FLOOR, "pow": rule.POW, "sqrt": rule.SQRT, "cbrt": rule.CBRT},
    **{name: getattr(rule, name.upper()) for name in SLOPES},
}

#: Comparisons: those that are watched, and those that hold or fail at a point only.
ORDERED, EQUAL = ("gt", "ge", "lt", "le"), ("eq", "ne")

#: Of each operation's columns: which name rows or numbers, and which a list of such.
NAME_COLUMNS, LIST_COLUMNS = np.zeros((2, rule.LGAMMA + 1, 6), dtype=bool)
NAME_COLUMNS[:, 2:4] = True
NAME_COLUMNS[rule.SELECT, 4], NAME_COLUMNS[rule.FLOOR, 3] = True, False
NAME_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE], 2:4] = False
LIST_COLUMNS[[rule.SUM_OF, rule.DOT, rule.SOLVE], 2] = LIST_COLUMNS[rule.ATAN2, 4] = True

#: Pairs of functions that are made together: the operation, and the place in the pair.
PAIRS = {
    "sin": (rule.SINE, 0),
    "cos": (rule.SINE, 1),
    "sinh": (rule.SINH, 0),
    "cosh": (rule.SINH, 1),
}

#: What to write where an operation has no recurrence.
INSTEAD = {
    "lgamma": "write Stirling's series, or a polynomial fit of it, over the range that is used",
    "foreign": "write this part with arithmetic, jnp.where or a loop of fixed length",
}


def _choice(g: Graph, a: int, b: int, then: int, other: int) -> int:
    return g.node("select", g.node("ge", a, b), then, other)


def _size(g: Graph, a: int) -> int:
    return _choice(g, a, g.const(0.0), a, g.node("neg", a))


def _sign(g: Graph, a: int) -> int:
    """Where it stays zero it is zero."""
    zero = g.const(0.0)
    below = g.node("select", g.node("lt", a, zero), g.const(-1.0), a)
    return g.node("select", g.node("gt", a, zero), g.const(1.0), below)


def _ceil(g: Graph, a: int) -> int:
    return g.node("neg", g.node("floor", g.node("neg", a)))


def _trunc(g: Graph, a: int) -> int:
    return _choice(g, a, g.const(0.0), g.node("floor", a), _ceil(g, a))


def _away(g: Graph, a: int) -> int:
    whole = g.node("floor", g.node("add", _size(g, a), g.const(0.5)))
    return g.node("mul", _sign(g, a), whole)


def _round(g: Graph, a: int) -> int:
    """To the nearest; halfway to the even one, which counts where nothing moves only."""
    raised = g.node("add", a, g.const(0.5))
    whole = g.node("floor", raised)
    if g.moves(a):
        return whole
    half = g.node("floor", g.node("mul", g.const(0.5), whole))
    odd = g.node("ne", g.node("mul", g.const(2.0), half), whole)
    down = g.node("and", g.node("eq", raised, whole), odd)
    less = g.node("select", down, g.const(1.0), g.const(0.0))
    return g.node("sub", whole, less)


def _rem(g: Graph, a: int, b: int) -> int:
    return g.node("sub", a, g.node("mul", b, _trunc(g, g.node("div", a, b))))


#: Where, by its argument, a function is more than rounding: beyond, ``tanh`` is constant; below,
#: ``exp(a)`` is nothing beside any number that occurs with it (``exp(-200)`` is 1e-87).
BANDS = {
    "exp": (-200.0, math.inf),
    "exp2": (-300.0, math.inf),
    "expm1": (-40.0, math.inf),
    "logistic": (-200.0, 40.0),
    "tanh": (-20.0, 20.0),
    "erf": (-6.0, 6.0),
    "erfc": (-6.0, 15.0),
    "sinh": (-200.0, 200.0),
    "cosh": (-200.0, 200.0),
}

#: Operations with poles, far from which they may be next to nothing: which argument of theirs is
#: zero there.
POLES = {"div": 1, "pow": 0}


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


#: Operations made of others.
MADE_OF_OTHERS: dict[str, Callable[..., int]] = {
    "abs": _size,
    "sign": _sign,
    "max": lambda g, a, b: _choice(g, a, b, a, b),
    "min": lambda g, a, b: _choice(g, a, b, b, a),
    "ceil": _ceil,
    "trunc": _trunc,
    "away": _away,
    "round": _round,
    "rem": _rem,
    "real": lambda g, a: a,
}


def rebuilt(
    graph: Graph, roots: Sequence[int], change: Callable[[tuple[Any, ...]], int | None]
) -> list[int]:
    """The roots with some nodes replaced.

    ``change`` gets a node whose arguments are the new ones, and gives what stands for it, or None
    where it stays.
    """
    new: dict[int, int] = {}
    for number in needed(graph, roots):
        node = graph.nodes[number]
        if node[0] not in ("const", "input"):
            node = (node[0], *(new[a] for a in node[1:]))
        other = change(node)
        new[number] = graph.node(*node) if other is None else other
    return [new[root] for root in roots]


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
    ops: np.ndarray
    more: np.ndarray
    flow: np.ndarray
    output: np.ndarray
    affine: np.ndarray
    kinks: np.ndarray
    watched: tuple[Watched, ...]
    steady: np.ndarray
    numbers: np.ndarray
    given: np.ndarray
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
        chosen = np.arange(len(self.output)) if functions is None else _ints([*functions])
        return Jets(self, numbers, self.output[chosen], self.affine[chosen])


@attrs.frozen(eq=False, slots=False)
class Jets:
    """A tape with the values of the parameters, for some of its functions: a program."""

    tape: Tape
    numbers: np.ndarray
    output: np.ndarray
    affine: np.ndarray

    @cached_property
    def places(self) -> np.ndarray:
        """Which of all that is watched is watched along the series."""
        return _ints([i for i, what in enumerate(self.tape.watched) if what.kind != "point"])

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

    def _watched(self, c: np.ndarray) -> list[list[float]]:
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
        for column, array in zip(self._parts, [_table([index], 8), *arrays], strict=True):
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
    return [*given, part.output, tape.flow, part.affine, _ints([0])]


def _moved(places: np.ndarray, by: int) -> np.ndarray:
    """Places of numbers, which are below zero, counted on."""
    return np.where(places < 0, places - by, places)


def tape(graph: Graph, size: int, flow: Ids, functions: Sequence[int], where: str) -> Tape:
    """The tape of a flow, and of functions along it.

    Parameters
    ----------
    size : int
        Number of states.
    flow : list of node
        Empty for functions whose values alone are asked for.
    where : str
        Model and mode, for messages.

    Raises
    ------
    TraceError
        Where an operation has no recurrence.
    """
    roots = rebuilt(graph, [*map(int, flow), *map(int, functions)], lambda n: _made(graph, n))
    return _Recorder(graph, size, roots[: len(flow)], roots[len(flow) :], where).tape()


def _made(graph: Graph, node: tuple[Any, ...]) -> int | None:
    return MADE_OF_OTHERS[node[0]](graph, *node[1:]) if node[0] in MADE_OF_OTHERS else None


class _Recorder:
    """Puts the nodes into arrays. ``place[node]`` is a row, or ``-1 - i`` for a number."""

    def __init__(
        self, graph: Graph, size: int, flow: list[int], functions: list[int], where: str
    ) -> None:
        self.graph, self.size, self.where = graph, size, where
        self.flow, self.functions = flow, functions
        self.slopes: dict[int, tuple[int, ...]] = {}
        self.watched: dict[Watched, int] = {}
        self._add()
        self.place: dict[int, int] = {}
        self.rows = size + 1
        self.ops: list[tuple[int, ...]] = []
        self.steady: list[tuple[int, ...]] = []
        self.more: list[int] = []
        self.numbers: list[float] = []
        self.given: list[tuple[int, int]] = []
        self.room = 1

    # -- nodes that the recurrences need besides ----------------------------------------

    def _add(self) -> None:
        """Slopes of functions, and deciding functions, until no node is missing."""
        graph, frontier, seen = self.graph, [*self.flow, *self.functions], set[int]()
        while frontier:
            new = [n for n in needed(graph, frontier) if n not in seen]
            seen.update(new)
            frontier = [root for number in new for root in self._besides(number)]
        roots = [*self.flow, *self.functions, *(n for s in self.slopes.values() for n in s)]
        self.nodes = needed(graph, [*roots, *map(self._root, self.watched)])

    def _root(self, what: Watched) -> int:
        """The node whose series is that of what is watched."""
        return self.graph.node("nearest", what.node) if what.kind == "step" else what.node

    def _besides(self, number: int) -> list[int]:
        graph, (op, *arguments) = self.graph, self.graph.nodes[number]
        if op in ("const", "input") or not graph.moves(number):
            return []
        if op in SLOPES:
            self.slopes[number] = (SLOPES[op](graph, arguments[0], number),)
        elif op == "atan2":
            y, x = arguments
            square = graph.node("add", graph.node("mul", x, x), graph.node("mul", y, y))
            turn = graph.node("neg", graph.node("div", y, square))
            self.slopes[number] = graph.node("div", x, square), turn
        what = self._seen(op, arguments)
        if what is not None and graph.moves(what.node):
            self.watched.setdefault(what, len(self.watched))
            return [self._root(what), *self.slopes.get(number, ())]
        return [*self.slopes.get(number, ())]

    def _seen(self, op: str, arguments: list[int]) -> Watched | None:
        """What an operation asks to be watched."""
        if op in (*ORDERED, *EQUAL):
            difference = self.graph.node("sub", *arguments)
            return Watched("kink" if op in ORDERED else "point", difference)
        if op == "atan2":
            return Watched("kink", arguments[0])
        if op == "floor":
            return Watched("step", arguments[0])
        if op in BANDS:
            return Watched("band", arguments[0], *BANDS[op])
        return Watched("pole", arguments[POLES[op]]) if op in POLES else None

    def _side(self, op: str, arguments: list[int]) -> int:
        """The place of an operation's kink; -1 where nothing moves."""
        what = self._seen(op, arguments)
        return -1 if what is None else self.watched.get(what, -1)

    # -- places ---------------------------------------------------------------------------

    def _put_places(self) -> None:
        """A place for each node, before any operation: some are made of what comes later."""
        for number in self.nodes:
            op, *rest = self.graph.nodes[number]
            if op == "const":
                self.place[number] = self._new(False)
                self.numbers[-1] = float(rest[0])
            elif op == "input":
                self.place[number] = self._given(rest[0])
            elif op == "part":
                index = int(self.graph.value(rest[1]))
                self.place[number] = self._after(self.place[rest[0]], index)
            else:
                count = unknowns(len(rest)) if op == "solve" else 1
                self.place[number] = self._new(self.graph.moves(number), count)

    def _given(self, name: str) -> int:
        if name[0] != "p":
            return self.size if name == "t" else int(name[1:])
        self.given.append((len(self.numbers), int(name[1:])))
        return self._new(False)

    def _new(self, moves: bool, count: int = 1) -> int:
        """A place, or the first of several."""
        if moves:
            self.rows += count
            return self.rows - count
        self.numbers += [0.0] * count
        return count - 1 - len(self.numbers)

    @staticmethod
    def _after(place: int, count: int) -> int:
        return place + count if place >= 0 else place - count

    # -- operations -----------------------------------------------------------------------

    def tape(self) -> Tape:
        """The arrays."""
        self._put_places()
        for number in self.nodes:
            op = self.graph.nodes[number][0]
            if op not in ("const", "input", "part", "real"):
                self._record(number)
        kinks = [
            (self.place[self._root(w)], w.switches, w.code, self.place[w.node])
            for w in self.watched
        ]
        output = [*map(self._row, self.functions)]
        return Tape(
            size=self.size,
            rows=self.rows,
            ops=_table(self.ops, 6),
            more=_ints(self.more),
            flow=_ints([self.place[i] for i in self.flow]),
            output=_ints(output),
            affine=_ints([degree(self.graph, number) <= 1 for number in self.functions]),
            kinks=_table(kinks, 4),
            watched=tuple(self.watched),
            steady=_table(self.steady, 6),
            numbers=np.array(self.numbers),
            given=_table(self.given, 2).T,
            room=self.room + 4 * self.size + len(kinks),
        )

    def _row(self, number: int) -> int:
        """The row of what is asked for, also where it does not move."""
        place = self.place[number]
        if place >= 0:
            return place
        row = self._new(True)
        self.ops.append((rule.COPY, row, place))
        return row

    def _record(self, number: int) -> None:
        """Put down an operation; a steady one reads numbers as if they were rows."""
        op, *arguments = self.graph.nodes[number]
        moves = self.graph.moves(number)
        places = [self.place[number], *(self.place[a] for a in arguments)]
        out, *named = places if moves else [-1 - place for place in places]
        written = self.ops if moves else self.steady
        if op in PAIRS:
            self._pair(op, number, arguments[0], written, moves)
        elif op == "mul":
            written.append(_product(out, *named))
        elif op == "sum":
            written.append((rule.SUM_OF, out, self._list(named), len(named)))
        elif op == "dot":
            pairs = zip(named[::2], named[1::2], strict=True)
            flat = [place for pair in pairs for place in sorted(pair)]
            written.append((rule.DOT, out, self._list(flat), len(flat) // 2))
        elif op == "solve":
            n = unknowns(len(named))
            written.append((rule.SOLVE, out, self._list(named), n, self.room))
            self.room += n * n + 2 * n
        elif op in NUMBERED_OPS:
            written.append(
                (NUMBERED_OPS[op], out, *named, *self._besides_named(number, op, arguments))
            )
        elif op == "atan2":
            slopes = [self.place[i] for i in self.slopes.get(number, ())]
            kink = self._side(op, arguments)
            written.append((rule.ATAN2, out, *named, self._list(slopes), kink))
        elif op == "lgamma" and not (moves and self.flow):
            written.append((rule.LGAMMA, out, *named))
        else:
            raise TraceError(self._refused(op, arguments))

    def _besides_named(self, number: int, op: str, arguments: list[int]) -> list[int]:
        """What an operation of the rule takes besides its arguments."""
        if number in self.slopes:
            return [self.place[self.slopes[number][0]]]
        return [self._side(op, arguments)] if op in (*ORDERED, *EQUAL, "floor") else []

    def _list(self, places: Sequence[int]) -> int:
        """Where a list of arguments begins."""
        self.more += places
        return len(self.more) - len(places)

    def _pair(
        self, op: str, number: int, argument: int, written: list[tuple[int, ...]], moves: bool
    ) -> None:
        """Two functions as one operation, put down with the first of them."""
        code, second = PAIRS[op]
        twin = next(name for name, value in PAIRS.items() if value == (code, 1 - second))
        other = self.graph.known(twin, argument)
        if other is None or other not in self.place:
            places = [self.place[number], self._new(moves)]
        elif other < number:
            return
        else:
            places = [self.place[number], self.place[other]]
        first, last = reversed(places) if second else places
        names = [first, self.place[argument], last]
        clock = int(moves and self._is_clock(argument))
        written.append((code, *(names if moves else [-1 - place for place in names]), clock))

    def _is_clock(self, number: int) -> bool:
        """Whether a node is affine in time, and the state is not in it."""
        graph = self.graph
        inputs = (graph.nodes[n] for n in needed(graph, [number]))
        alone = all(name[0] != "x" for op, name, *_ in inputs if op == "input")
        return alone and degree(graph, number) <= 1

    def _refused(self, op: str, arguments: Sequence[int]) -> str:
        instead, what = INSTEAD.get(op, "use another function"), repr(op)
        if op == "foreign":
            what = f"the primitive {self.graph.name_of(arguments[0])!r}"
        return (
            f"{self.where}: {what} has no Taylor series; {instead}, or use solver='scipy' or "
            "solver='diffrax'"
        )


def _product(out: int, a: int, b: int) -> tuple[int, ...]:
    if a == b and a >= 0:
        return rule.SQUARE, out, a
    if a < 0 or b < 0:
        return rule.SCALE, out, max(a, b), min(a, b)
    return rule.MUL, out, a, b


def _ints(values: Any) -> np.ndarray:
    return np.array(values, dtype=np.int64)


def _table(rows: Sequence[Sequence[int]], width: int) -> np.ndarray:
    """Rows of one width, filled with zeros."""
    return _ints([[*row, *[0] * (width - len(row))] for row in rows]).reshape(-1, width)
