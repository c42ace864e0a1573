"""Writes graph nodes to a tape (:mod:`.tape`).

Each node is an operation. Where a model switches formula (``abs``, ``where``, ``max``, ``floor``),
the coefficients belong to the branch at the start of the step. The deciding function is returned as
a *kink*: the series holds up to its first zero. Also returned are the arguments of functions that
are flat to rounding almost everywhere (``exp``, ``tanh``), whose coefficients do not show a coming
pulse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..errors import TraceError
from ..rules import operations as rule
from .derivatives import degree, unknowns
from .foreign import in_words
from .graph import Graph, Ids, inputs_of, needed, rebuilt
from .tape import Tape, Watched, ints, table
from .taylor import SLOPES

#: Operations that the rule implements under the same name.
NUMBERED_OPS = {
    **{"add": rule.ADD, "sub": rule.SUB, "neg": rule.NEG, "div": rule.DIV, "gt": rule.GT},
    **{"ge": rule.GE, "lt": rule.LT, "le": rule.LE, "eq": rule.EQ, "ne": rule.NE},
    **{"and": rule.AND, "or": rule.OR, "xor": rule.XOR, "not": rule.NOT},
    **{"is_finite": rule.FINITE, "select": rule.SELECT, "nearest": rule.NEAREST},
    **{"floor": rule.FLOOR, "pow": rule.POW, "sqrt": rule.SQRT, "cbrt": rule.CBRT},
    **{name: getattr(rule, name.upper()) for name in SLOPES},
}

#: Comparisons: watched ones, and those that change only at a point.
ORDERED, EQUAL = ("gt", "ge", "lt", "le"), ("eq", "ne")

#: Functions computed in pairs: the operation, and the index in the pair.
PAIRS = {
    "sin": (rule.SINE, 0),
    "cos": (rule.SINE, 1),
    "sinh": (rule.SINH, 0),
    "cosh": (rule.SINH, 1),
}


def _choice(g: Graph, a: int, b: int, then: int, other: int) -> int:
    return g.node("select", g.node("ge", a, b), then, other)


def _size(g: Graph, a: int) -> int:
    return _choice(g, a, g.const(0.0), a, g.node("neg", a))


def _of_branches(op: str, g: Graph, a: int, *power: int) -> int:
    """A root or power; of a choice that may be a constant it is a choice of both: while it is 0 its
    power has a series, which that of what only becomes 0 has not."""
    kind, *parts = g.nodes[a]
    if kind == "select" and any(g.nodes[part][0] == "const" for part in parts[1:]):
        return g.node("select", parts[0], *(g.node(op, part, *power) for part in parts[1:]))
    return g.node(op, a, *power)


def _sign(g: Graph, a: int) -> int:
    """The sign of ``a``; 0 while ``a`` stays zero."""
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
    """The nearest integer; ties go to the even one, which matters for constants only."""
    raised = g.node("add", a, g.const(0.5))
    whole = g.node("floor", raised)
    if g.moves(a):
        return whole
    half = g.node("floor", g.node("mul", g.const(0.5), whole))
    odd = g.node("ne", g.node("mul", g.const(2.0), half), whole)
    down = g.node("and", g.node("eq", raised, whole), odd)
    less = g.node("select", down, g.const(1.0), g.const(0.0))
    return g.node("sub", whole, less)


#: The arguments for which a function differs from a constant by more than rounding: beyond,
#: ``tanh`` is constant; below, ``exp(a)`` is negligible beside any number that occurs with it
#: (``exp(-200)`` is 1e-87).
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

#: Operations with poles, away from which they may be negligible.
POLES = ("div", "pow")


#: Operations that are expressed by others.
MADE_OF_OTHERS: dict[str, Callable[..., int]] = {
    "abs": _size,
    "sign": _sign,
    "max": lambda g, a, b: _choice(g, a, b, a, b),
    "min": lambda g, a, b: _choice(g, a, b, b, a),
    "ceil": _ceil,
    "trunc": _trunc,
    "away": _away,
    "round": _round,
    "rem": lambda g, a, b: g.node("sub", a, g.node("mul", b, _trunc(g, g.node("div", a, b)))),
    "real": lambda g, a: a,
    **{op: partial(_of_branches, op) for op in ("pow", "sqrt", "cbrt")},
}


def tape(graph: Graph, size: int, flow: Ids, functions: Sequence[int], where: str) -> Tape:
    """The tape of a flow and of functions along it.

    Parameters
    ----------
    size : int
        Number of states.
    flow : list of node
        Empty if only values of the functions are needed.
    where : str
        Model and mode, for messages.

    Raises
    ------
    TraceError
        If an operation has no recurrence.
    """
    roots = rebuilt(graph, [*map(int, flow), *map(int, functions)], lambda n: _made(graph, n))
    return _Recorder(graph, size, roots[: len(flow)], roots[len(flow) :], where).tape()


def _made(graph: Graph, node: tuple[Any, ...]) -> int | None:
    return MADE_OF_OTHERS[node[0]](graph, *node[1:]) if node[0] in MADE_OF_OTHERS else None


def branches(graph: Graph, roots: Sequence[int]) -> dict[int, frozenset[tuple[int, int]]]:
    """For each node the choices on whose branches alone it is needed: the condition, and the place
    of the branch among what a ``select`` is made of."""
    found = dict.fromkeys(roots, frozenset[tuple[int, int]]())
    for number in reversed(needed(graph, roots)):
        op, *parts = graph.nodes[number]
        for place, part in enumerate(parts if op not in ("const", "input") else ()):
            own = found[number]
            if op == "select" and place > 0:
                own = own | {(parts[0], place)}
            found[part] = found.get(part, own) & own
    return found


class _Recorder:
    """Writes nodes into arrays; ``place[node]`` is a row, or ``-1 - i`` for number ``i``."""

    def __init__(
        self, graph: Graph, size: int, flow: list[int], functions: list[int], where: str
    ) -> None:
        self.graph, self.size, self.where = graph, size, where
        self.flow, self.functions = flow, functions
        self.slopes: dict[int, tuple[int, ...]] = {}
        self.watched: dict[Watched, int] = {}
        self.branches = branches(graph, [*flow, *functions])
        self._add()
        self.place: dict[int, int] = {}
        self.rows = size + 1
        self.ops: list[tuple[int, ...]] = []
        self.steady: list[tuple[int, ...]] = []
        self.more: list[int] = []
        self.tables: dict[tuple[int, bool], int] = {}
        self.numbers: list[float] = []
        self.given: list[tuple[int, int]] = []
        self.room = 1

    # -- further nodes of the recurrences -----------------------------------------------

    def _add(self) -> None:
        """Collect all nodes, with the slopes of functions and the watched functions."""
        graph, frontier, seen = self.graph, [*self.flow, *self.functions], set[int]()
        while frontier:
            new = [n for n in needed(graph, frontier) if n not in seen]
            seen.update(new)
            frontier = [root for number in new for root in self._besides(number)]
        roots = [*self.flow, *self.functions, *(n for s in self.slopes.values() for n in s)]
        self.nodes = needed(graph, [*roots, *map(self._root, self.watched)])

    def _root(self, what: Watched) -> int:
        """The node whose series is watched."""
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
        own = self.branches.get(number, frozenset())
        for node in needed(graph, self.slopes.get(number, ())):
            self.branches[node] = self.branches.get(node, own) & own
        what = self._seen(op, arguments)
        if what is not None and what.kind == "pole":
            what = Watched("pole", self._where_taken(number, what.node))
        if what is not None and graph.flows(what.node):
            self.watched.setdefault(what, len(self.watched))
            return [self._root(what), *self.slopes.get(number, ())]
        return [*self.slopes.get(number, ())]

    def _seen(self, op: str, arguments: list[int]) -> Watched | None:
        """What an operation requires to be watched; None if nothing."""
        if op in (*ORDERED, *EQUAL):
            difference = self.graph.node("sub", *arguments)
            return Watched("kink" if op in ORDERED else "point", difference)
        if op == "atan2":
            return Watched("kink", arguments[0])
        if op == "floor":
            return Watched("step", arguments[0])
        if op in BANDS:
            return Watched("band", arguments[0], *BANDS[op])
        return Watched("pole", self._divided(op, arguments)) if op in POLES else None

    def _where_taken(self, number: int, divided: int) -> int:
        """What an operation divides by, and 1 where it is on a branch that is not taken: there its
        pole is nothing to the flow."""
        graph, one = self.graph, self.graph.const(1.0)
        for condition, place in sorted(self.branches.get(number, ())):
            pair = (divided, one) if place == 1 else (one, divided)
            divided = graph.node("select", condition, *pair)
        return divided

    def _divided(self, op: str, arguments: list[int]) -> int:
        """What has a pole where it is zero; a power has none while its exponent is positive."""
        graph = self.graph
        if op == "pow":
            positive = graph.node("gt", arguments[1], graph.const(0.0))
            return graph.node("select", positive, graph.const(1.0), arguments[0])
        return arguments[1]

    def _side(self, op: str, arguments: list[int]) -> int:
        """Index of an operation's kink; -1 if it is constant along the flow."""
        what = self._seen(op, arguments)
        return -1 if what is None else self.watched.get(what, -1)

    # -- places ---------------------------------------------------------------------------

    def _put_places(self) -> None:
        """Give every node a place before any operation is written, as some use later nodes."""
        for number in self.nodes:
            op, *rest = self.graph.nodes[number]
            if op == "const":
                self.place[number] = self._new(False)
                self.numbers[-1] = float(rest[0])
            elif op == "input":
                self.place[number] = self._given(rest[0])
            elif op == "table":
                continue
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
        """The first of ``count`` new places: rows if they move, else numbers."""
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
        """Write all operations and return the tape."""
        self._put_places()
        for number in self.nodes:
            op = self.graph.nodes[number][0]
            if op not in ("const", "input", "part", "real", "table"):
                self._record(number)
        kinks = [
            (self.place[self._root(w)], w.switches, w.code, self.place[w.node], self._part(w.node))
            for w in self.watched
        ]
        output = [*map(self._row, self.functions)]
        return Tape(
            size=self.size,
            rows=self.rows,
            ops=table(self.ops, 6),
            more=ints(self.more),
            flow=ints([self.place[i] for i in self.flow]),
            output=ints(output),
            affine=ints([degree(self.graph, number) <= 1 for number in self.functions]),
            timed=any(name[0] not in "xp" for name in inputs_of(self.graph, self.flow)),
            kinks=table(kinks, 5),
            watched=tuple(self.watched),
            steady=table(self.steady, 6),
            numbers=np.array(self.numbers),
            given=table(self.given, 2).T,
            room=self.room + 4 * self.size + len(kinks),
        )

    def _part(self, number: int) -> int:
        """The row of a part of a sum or difference, to whose rounding it is known; else its own."""
        op, *parts = self.graph.nodes[number]
        rows = [self.place[part] for part in parts] if op in ("add", "sub") else []
        return next((row for row in rows if row >= 0), self.place[number])

    def _row(self, number: int) -> int:
        """The row of a requested function; a constant one is copied to a row."""
        place = self.place[number]
        if place >= 0:
            return place
        row = self._new(True)
        self.ops.append((rule.COPY, row, place))
        return row

    def _record(self, number: int) -> None:
        """Write an operation; an operation on constants treats numbers as rows."""
        op, *arguments = self.graph.nodes[number]
        moves = self.graph.moves(number)
        if op in ("pick", "knot"):
            return self._pick(number, *arguments)
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

    def _pick(self, number: int, table: int, place: int) -> None:
        """Write the reading of a table entry; the places of a table's entries are listed once."""
        moves, entries = self.graph.moves(number), self.graph.nodes[table][1:]
        names = [self.place[number], self.place[place], *(self.place[a] for a in entries)]
        out, index, *listed = names if moves else [-1 - name for name in names]
        key = table, moves
        if key not in self.tables:
            self.tables[key] = self._list(listed)
        written = self.ops if moves else self.steady
        written.append((rule.PICK, out, self.tables[key], index, len(listed)))

    def _besides_named(self, number: int, op: str, arguments: list[int]) -> list[int]:
        """What an operation of the rule takes besides its arguments."""
        if number in self.slopes:
            return [self.place[self.slopes[number][0]]]
        return [self._side(op, arguments)] if op in (*ORDERED, *EQUAL, "floor") else []

    def _list(self, places: Sequence[int]) -> int:
        """Append a list of arguments; returns where it begins."""
        self.more += places
        return len(self.more) - len(places)

    def _pair(
        self, op: str, number: int, argument: int, written: list[tuple[int, ...]], moves: bool
    ) -> None:
        """Write two functions as one operation, at the first of them."""
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
        """Whether a node is affine in time and independent of the state."""
        alone = all(name[0] != "x" for name in inputs_of(self.graph, [number]))
        return alone and degree(self.graph, number) <= 1

    def _refused(self, op: str, arguments: Sequence[int]) -> str:
        called = op == "foreign"
        words = self.graph.called_by(arguments[0]).words if called else None
        said, instead = words or in_words(op, self.graph.written_at.get(op, ""))
        return (
            f"{self.where}: {said} has no Taylor series; {instead}, or use solver='scipy' or "
            "solver='diffrax'"
        )


def _product(out: int, a: int, b: int) -> tuple[int, ...]:
    if a == b and a >= 0:
        return rule.SQUARE, out, a
    if a < 0 or b < 0:
        return rule.SCALE, out, max(a, b), min(a, b)
    return rule.MUL, out, a, b
