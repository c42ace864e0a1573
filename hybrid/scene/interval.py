"""A reader of the trace: rigorous bounds of its results over a box, in ball arithmetic.

The graph is evaluated node by node on balls (:mod:`.balls`): whatever numbers the inputs
have within theirs, the result lies in the ball returned, rounding included. Constants and
parameters are the floats that they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import attrs

from ..errors import OptionError
from .graph import Graph
from .python import needed

#: Bits of the balls' midpoints: rounding stays far below a double's.
PRECISION = 96

#: Operations on twice the same node.
SAME = {"ge": True, "le": True, "eq": True, "gt": False, "lt": False, "ne": False}


class Undecided(Exception):
    """An expression is not defined on all of a box, as far as balls can tell."""


def require_flint() -> None:
    """Refuse with a remedy where python-flint is missing.

    Raises
    ------
    OptionError
    """
    try:
        import flint  # noqa: F401
    except ImportError:
        raise OptionError("proofs need python-flint: pip install hybrid[certify]") from None


def ball(bounds: Any) -> Any:
    """A number, a pair ``(low, high)`` or a ball, as a ball."""
    from flint import arb

    from .balls import span

    if isinstance(bounds, arb):
        return bounds
    if isinstance(bounds, Sequence):
        low, high = bounds
        return span(arb(float(low)), arb(float(high)))
    return arb(float(bounds))


@attrs.frozen
class Enclosure:
    """What is known of one root over a box.

    Attributes
    ----------
    value : arb, bool, None or Undefined
        See :mod:`.balls`.
    continuous : bool
        No switch, step or other jump of the expression lies in the box.
    """

    value: Any
    continuous: bool

    @property
    def defined(self) -> bool:
        from .balls import Undefined

        return not isinstance(self.value, Undefined)


class IntervalProgram:
    """Enclosures of some nodes of a graph.

    Parameters
    ----------
    graph : Graph
        Its inputs are named ``p0, p1, ..., t, x0, x1, ...`` (and extra names).
    roots : sequence of int
        The nodes to be enclosed.

    Notes
    -----
    Evaluation without subdivision: the enclosure of a root tends to its value as the box
    shrinks, and overestimates on wide boxes. :func:`.extrema.extrema` subdivides.
    """

    def __init__(self, graph: Graph, roots: Iterable[int]) -> None:
        require_flint()
        self._graph = graph
        self.roots = [int(root) for root in roots]
        self._order = needed(graph, self.roots)
        self._nodes = [graph.nodes[number] for number in self._order]
        self._place = {number: place for place, number in enumerate(self._order)}
        self.inputs = {node[1] for node in self._nodes if node[0] == "input"}

    def first(self) -> IntervalProgram:
        """The program of the first root alone."""
        return IntervalProgram(self._graph, self.roots[:1])

    def __len__(self) -> int:
        """The number of nodes."""
        return len(self._nodes)

    def __call__(self, parameters: Sequence[Any], t: Any, x: Sequence[Any], **extra: Any) -> Any:
        """A ball for each root.

        Parameters
        ----------
        parameters, x : sequence of float, ``(low, high)`` or arb
            Flattened parameters and the state.
        t : float, ``(low, high)`` or arb

        Returns
        -------
        list of arb

        Raises
        ------
        Undecided
            If a root is not defined on all of the box.
        """
        named = {f"p{i}": value for i, value in enumerate(parameters)}
        named.update({f"x{i}": value for i, value in enumerate(x)})
        results = self.enclose({**named, "t": t, **extra})
        for result in results:
            if not result.defined:
                raise Undecided(result.value.reason)
        return [result.value for result in results]

    def enclose(self, box: Mapping[str, Any]) -> list[Enclosure]:
        """An :class:`Enclosure` for each root, over bounds of the inputs by name."""
        from flint import ctx

        with ctx.workprec(PRECISION):
            values, jumps = self._evaluate({name: ball(box[name]) for name in self.inputs})
        places = [self._place[root] for root in self.roots]
        return [Enclosure(_finite(values[place]), not jumps[place]) for place in places]

    def _evaluate(self, inputs: Mapping[str, Any]) -> tuple[list[Any], list[bool]]:
        from .balls import number

        values: list[Any] = []
        jumps: list[bool] = []
        for op, *arguments in self._nodes:
            if op == "input":
                value, jump = inputs[arguments[0]], False
            elif op == "const":
                value, jump = number(arguments[0]), False
            else:
                places = [self._place[a] for a in arguments]
                given = [values[p] for p in places]
                value, jump = _apply(op, arguments, given, [jumps[p] for p in places])
            values.append(value)
            jumps.append(jump)
        return values, jumps


def _apply(op: str, nodes: list[int], args: list[Any], jumps: list[bool]) -> tuple[Any, bool]:
    from .balls import BALLS, JUMPS, LIMITS, Undefined, number

    if op == "select":
        return _select(args, jumps)
    for argument in args:
        argument = argument if op in LIMITS else _finite(argument)
        if isinstance(argument, Undefined):
            return argument, True
    if len(nodes) == 2 and nodes[0] == nodes[1]:
        if op in SAME:
            return SAME[op], False
        if op == "mul":
            return _finite(BALLS["square"](args[0])), jumps[0]
        if op == "sub":
            return number(0), jumps[0]
    value = BALLS[op](*args)
    jump = any(jumps) or (op in JUMPS and not isinstance(value, Undefined) and JUMPS[op](*args))
    return value if op in LIMITS else _finite(value), jump


def _select(args: list[Any], jumps: list[bool]) -> tuple[Any, bool]:
    """The branch taken; both where the test is not decided."""
    from .balls import Undefined, hull

    test, yes, no = args
    if isinstance(test, Undefined):
        return test, True
    if test is not None:
        return (yes, jumps[1]) if test else (no, jumps[2])
    for branch in (yes, no):
        if isinstance(branch, Undefined):
            return branch, True
    if isinstance(yes, bool | None) or isinstance(no, bool | None):
        return (yes if yes is no else None), True
    return hull(yes, no), True


def _finite(value: Any) -> Any:
    from .balls import Undefined

    if hasattr(value, "is_finite") and not value.is_finite():
        return Undefined("a value that may not be finite")
    return value
