"""A trace as scalar arithmetic: one node per element, common subexpressions shared.

A jaxpr works on arrays, but scalar code needs an expression for each element. Here an array is a
numpy array of node numbers. Moving data (slicing, reshaping, stacking, gathering) moves node
numbers and costs nothing at run time; arithmetic makes nodes, and constants are folded
(:mod:`.jaxpr`). The readers (:mod:`.python`, :mod:`.taylor`) see only a list of nodes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import numpy as np

from .arithmetic import LONG, OPERATIONS, entry
from .foreign import Foreign

Ids = np.ndarray

#: Operations whose results are booleans or integers.
WHOLE_VALUED = {"gt", "ge", "lt", "le", "eq", "ne", "and", "or", "xor", "not", "is_finite", "trunc"}

#: Inverse trigonometric functions, and what each of them is the inverse of.
INVERSES = {"asin": "sin", "acos": "cos", "atan": "tan"}

#: Stands for time among indices into the state vector.
TIME_PLACE = -1

#: Sums of up to this many terms are written out.
WRITTEN_TERMS = 3


class Graph:
    """Nodes ``(op, *arguments)``, ordered so that arguments come first.

    ``("const", value)`` and ``("input", name)`` are leaves; other arguments are node numbers. Equal
    nodes are one node.

    With ``exact``, ``0 * x`` is kept, as it is not 0 where ``x`` is not finite; without it the
    graph shows true dependence. With ``long``, a sum of many terms is one node, ``("sum", ...)``,
    and so is a sum of products, ``("dot", a, b, a, b, ...)``: a matrix-vector product has one node
    per row.

    ``still`` names the inputs that only jumps change; set it before any node is made.

    What cannot be written as scalar code is called: ``("foreign", number, *arguments)`` with its
    number in ``foreign``, whose results are its parts; ``line`` is the author's that is read, and
    ``written_at`` the first with an operation of which there is no series.
    """

    def __init__(self, exact: bool = False, long: bool = False) -> None:
        self.exact, self.long = exact, long
        self.nodes: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._moving: list[bool] = []
        self._flowing: list[bool] = []
        self.still: frozenset[str] = frozenset()
        self._leaves: list[int] = []
        self.foreign: list[Foreign] = []
        self.line = ""
        self.written_at: dict[str, str] = {}

    def node(self, *key: Any) -> int:
        """The number of a node, which is made if new; constants are folded."""
        key = self._simplify(key)
        if len(key) == 1:
            return int(key[0])
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
            self._moving.append(self._moves(self._moving, frozenset(), *key))
            self._flowing.append(self._moves(self._flowing, self.still, *key))
            self._leaves.append(self._count(*key))
        return self._known[key]

    def const(self, value: Any) -> int:
        """The node of a constant; types and signs of zero are kept apart."""
        value = value.item() if hasattr(value, "item") else value
        tag = repr(value)
        return self.node("const", value, tag)

    def value(self, number: int) -> Any:
        """The value of a constant node, or None."""
        node = self.nodes[number]
        return node[1] if node[0] == "const" else None

    def input(self, name: str) -> int:
        """The node of an input."""
        return self.node("input", name)

    def total(self, terms: Sequence[int]) -> int:
        """The node of a sum."""
        kept = [i for i in terms if self.exact or self.value(i) != 0]
        if self.long and len(kept) > WRITTEN_TERMS:
            return self.node("sum", *kept)
        return reduce(partial(self.node, "add"), kept or [self.const(0.0)])

    def dot(self, pairs: Sequence[tuple[int, int]]) -> int:
        """The node of a sum of products."""
        kept = [p for p in pairs if self.exact or 0 not in map(self.value, p)]
        if self.long and len(kept) > WRITTEN_TERMS:
            return self.node("dot", *itertools.chain.from_iterable(kept))
        return self.total([self.node("mul", *pair) for pair in kept])

    def moves(self, number: int) -> bool:
        """Whether a node depends on time or state."""
        return self._moving[number]

    def flows(self, number: int) -> bool:
        """Whether a node may change between jumps."""
        return self._flowing[number]

    def leaves(self, number: int) -> int:
        """Number of known integers or booleans among which a node chooses; 0 if none."""
        return self._leaves[number]

    def called(self, function: Foreign, arguments: Sequence[int]) -> int:
        """The node of a foreign call; its parts are the results."""
        if function not in self.foreign:
            self.foreign.append(function)
        number = self.const(self.foreign.index(function))
        return self.node("foreign", number, *arguments)

    def called_by(self, number: int) -> Foreign:
        """The function of a foreign call, given its number node."""
        return self.foreign[int(self.value(number))]

    def known(self, *key: Any) -> int | None:
        """The number of this node, if it exists."""
        return self._known.get(key)

    @staticmethod
    def _moves(known: list[bool], still: frozenset[str], op: str, *arguments: Any) -> bool:
        if op == "input":
            return not arguments[0].startswith("p") and arguments[0] not in still
        return op != "const" and any(known[a] for a in arguments)

    def _count(self, op: str, *arguments: Any) -> int:
        if op == "const":
            return int(isinstance(arguments[0], bool | int))
        if op != "select" or not all(self._leaves[a] for a in arguments[1:]):
            return 0
        return sum(self._leaves[a] for a in arguments[1:])

    def _simplify(self, key: tuple[Any, ...]) -> tuple[Any, ...]:
        op, arguments = key[0], key[1:]
        if op in ("const", "input"):
            return key
        if op == "pick" and (place := self.value(arguments[1])) is not None:
            return (entry(self.nodes[arguments[0]][1:], place),)
        if op == "table":
            return key
        values = [self.value(a) for a in arguments]
        if all(v is not None for v in values):
            folded = fold(op, values)
            if folded is not None:
                return ("const", folded, repr(folded))
        if op == "sqrt" and (size := self.squared(arguments[0])) is not None:
            return self._simplify(("abs", size))
        if op == "abs" and self.squared(arguments[0]) is not None:
            return (arguments[0],)
        if op in INVERSES and (angle := self.nodes[arguments[0]])[0] == INVERSES[op]:
            return (self._folded(op, angle[1]),)
        if op == "select" and self._same(*arguments):
            return (arguments[2],)
        if op == "eq":  # with a maximum, as slopes ask: of one argument, bounds do not decide it
            for a, b in (arguments, arguments[::-1]):
                inner, *rest = self.nodes[b]
                if inner in ("max", "min") and a in rest:
                    other = rest[0] if rest[1] == a else rest[1]
                    return self._simplify(("ge" if inner == "max" else "le", a, other))
        return _identity(op, arguments, values, self.exact) or key

    def squared(self, number: int) -> int | None:
        """The node of which this one is the square; None if it is none. Roots of squares are read
        as absolute values, which show that they have a corner at zero."""
        op, *factors = self.nodes[number]
        return factors[0] if op == "mul" and factors[0] == factors[1] else None

    def _folded(self, op: str, angle: int) -> int:
        """An inverse trigonometric function of its own function: the angle, folded. So it shows the
        corners and jumps that it has where neither of the two has any."""
        half, turn = self.const(0.5 * math.pi), self.const(math.pi * (1 if op == "atan" else 2))
        if op == "asin":
            angle = self.node("sub", angle, half)
        turns = self.node("add", self.node("div", angle, turn), self.const(0.5))
        whole = self.node("mul", turn, self.node("floor", turns))
        rest = self.node("sub", angle, whole)
        size = rest if op == "atan" else self.node("abs", rest)
        return self.node("sub", half, size) if op == "asin" else size

    def _same(self, test: int, yes: int, no: int) -> bool:
        """Whether a choice is its second case either way: ``0 if a == 0 else a``, and ``nan if
        a != a else a``."""
        op, *sides = self.nodes[test]
        if op == "eq":
            return sorted(sides) == sorted((yes, no))
        value = self.value(yes)
        return op == "ne" and sides == [no, no] and isinstance(value, float) and math.isnan(value)


def needed(graph: Graph, roots: Sequence[int]) -> list[int]:
    """The nodes on which the roots depend, arguments first."""
    seen: set[int] = set()
    stack = list(roots)
    while stack:
        number = stack.pop()
        if number not in seen:
            seen.add(number)
            node = graph.nodes[number]
            if node[0] not in ("const", "input"):
                stack.extend(node[1:])
    return sorted(seen)


def rebuilt(
    graph: Graph, roots: Sequence[int], change: Callable[[tuple[Any, ...]], int | None]
) -> list[int]:
    """The roots with some nodes replaced.

    ``change`` receives a node with its new arguments and returns the replacement, or None to keep
    the node.
    """
    new: dict[int, int] = {}
    for number in needed(graph, roots):
        node = graph.nodes[number]
        if node[0] not in ("const", "input"):
            node = (node[0], *(new[a] for a in node[1:]))
        other = change(node)
        new[number] = graph.node(*node) if other is None else other
    return [new[root] for root in roots]


def inputs_of(graph: Graph, roots: Sequence[int]) -> set[str]:
    """Names of the inputs on which the roots depend."""
    nodes = (graph.nodes[number] for number in needed(graph, roots))
    return {node[1] for node in nodes if node[0] == "input"}


def states_in(graph: Graph, root: int) -> set[int]:
    """The elements of the state on which a node depends; :data:`TIME_PLACE` stands for time."""
    names = inputs_of(graph, [root])
    places = {int(name[1:]) for name in names if name.startswith("x")}
    return places | ({TIME_PLACE} if "t" in names else set())


def _identity(
    op: str, args: tuple[Any, ...], values: list[Any], exact: bool
) -> tuple[Any, ...] | None:
    """``x + 0``, ``x * 1``, ``x - 0``, ``x / 1``, ``max(x, -inf)``, and a choice already made."""
    if op == "select" and args[1] == args[2]:
        return (args[1],)
    if op == "select":
        return (args[1] if values[0] else args[2],) if values[0] is not None else None
    if op == "add" and values[0] == 0:
        return (args[1],)
    if op in ("add", "sub") and values[1] == 0:
        return (args[0],)
    if op == "sub" and values[0] == 0:
        return ("neg", args[1])
    if op == "mul" and values[0] == 1:
        return (args[1],)
    if op in ("max", "min"):  # where nothing is larger, or smaller
        least = -math.inf if op == "max" else math.inf
        return next(((args[1 - k],) for k in (0, 1) if values[k] == least), None)
    if op in ("mul", "div") and values[1] == 1:
        return (args[0],)
    if op == "mul" and not exact and 0 in [v for v in values if v is not None]:
        return ("const", 0.0, "0.0")
    return None


def fold(op: str, values: Sequence[Any]) -> Any:
    """The value of an operation on constants; None if it is not a finite number."""
    if op in ("solve", "part", "foreign", "table", "pick", "knot", "wave"):
        return None
    try:
        result = (OPERATIONS.get(op) or LONG[op])(*values)
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    if isinstance(result, bool | int):
        return result
    return float(result) if math.isfinite(result) else None
