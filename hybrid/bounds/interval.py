"""Rigorous bounds on the results of a traced graph over a box, in ball arithmetic.

The graph is evaluated node by node on balls (:mod:`.balls`). For all numbers in the input balls,
the exact result lies in the returned ball. Constants and parameters are taken as exact floats.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from ..errors import PROOFS, TraceError, need
from ..lowering.graph import Graph, needed
from ..lowering.ranges import RANGES, Ranges
from ..rules import unit
from ..rules.arrays import Bounds

#: Bits of the balls' midpoints; rounding stays far below that of doubles.
PRECISION = 96

#: Results of operations whose two arguments are the same node.
OF_ONE_NODE = {"ge": True, "le": True, "eq": True, "gt": False, "lt": False, "ne": False, "sub": 0}


class Undecided(Exception):
    """An expression is not provably defined on all of a box."""


def require_flint() -> None:
    """Raise an :class:`.OptionError` that says what to install if python-flint is missing."""
    need("a proof", PROOFS)


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
    """The enclosure of one root over a box.

    Attributes
    ----------
    value : arb, bool, None or Undefined
        See :mod:`.balls`.
    continuous : bool
        Whether the expression provably has no switch, step or other jump in the box.
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
        The nodes to enclose.
    precision : int
        Bits of the balls' midpoints.

    Notes
    -----
    There is no subdivision: the enclosure of a root tends to its value as the box shrinks, but
    overestimates on wide boxes. :func:`.extrema.extrema` subdivides.
    """

    def __init__(self, graph: Graph, roots: Iterable[int], precision: int = PRECISION) -> None:
        require_flint()
        self.graph, self.precision = graph, precision
        self.roots = [int(root) for root in roots]
        order = needed(graph, self.roots)
        place = {number: place for place, number in enumerate(order)}
        self._steps = [_step(graph, graph.nodes[number], place) for number in order]
        self._places = [place[root] for root in self.roots]
        self.inputs = {step.given for step in self._steps if step.op == "input"}

    def __len__(self) -> int:
        """The number of nodes."""
        return len(self._steps)

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

        with ctx.workprec(self.precision):
            values, jumps = self._evaluate({name: ball(box[name]) for name in self.inputs})
        return [Enclosure(_finite(values[place]), not jumps[place]) for place in self._places]

    def ranges(self, box: Mapping[str, Any]) -> list[tuple[float, float]] | None:
        """Bounds on the roots by interval arithmetic in doubles, which is faster; None if a root
        may be undefined or an operation has no such bounds."""
        if self._ranges is None:
            return None
        given = [box[name] for name in sorted(self.inputs)]
        rows = np.array([v if isinstance(v, tuple) else (v, v) for v in given], dtype=float)
        found = np.zeros((len(self), 2))
        if unit("bounds").ranges(self._ranges, 0, rows.reshape(-1, 2), found):
            return None
        return [(low, high) for low, high in found[self._ranges.results].tolist()]

    def excludes_zero(self, box: Mapping[str, Any]) -> bool:
        """Whether every root is provably defined and nonzero on all of a box."""
        ranges = self.ranges(box)
        if ranges is not None and all(low > 0.0 or high < 0.0 for low, high in ranges):
            return True
        return all(e.defined and not e.value.contains(0) for e in self.enclose(box))

    @cached_property
    def _ranges(self) -> Bounds | None:
        own = Ranges()
        rows = {name: row for row, name in enumerate(sorted(self.inputs))}
        return None if self.ranged(own, rows, {}) is None else own.arrays()

    def ranged(
        self, among: Ranges, rows: Mapping[str, int], given: Mapping[str, float]
    ) -> int | None:
        """Add this program to those for bounds in doubles.

        ``rows`` maps inputs to rows of a box; the values of other inputs are in ``given``. Returns
        the number of the program; None if an operation has no such bounds.
        """
        return among.add(self._steps, self._places, rows, given)

    def _evaluate(self, inputs: Mapping[str, Any]) -> tuple[list[Any], list[bool]]:
        values: list[Any] = []
        jumps: list[bool] = []
        for step in self._steps:
            if step.op == "input":
                value, jump = inputs[step.given], False
            elif step.op == "const":
                value, jump = step.given, False
            elif step.op == "select":
                a, b, c = step.places
                value, jump = _select([values[a], values[b], values[c]], [jumps[b], jumps[c]])
            else:
                value, jump = _apply(step, [values[p] for p in step.places])
                jump = jump or any(jumps[p] for p in step.places)
            values.append(value)
            jumps.append(jump)
        return values, jumps


@attrs.frozen
class _Step:
    """A node prepared for evaluation.

    ``places`` are those of its arguments, ``rule`` evaluates it, ``jumps`` tests whether it may
    jump, and ``strict`` means that it needs finite arguments.
    """

    op: str
    places: tuple[int, ...] = ()
    given: Any = None
    rule: Any = None
    jumps: Any = None
    strict: bool = True
    range: int | None = None
    number: float = 0.0


def _step(graph: Graph, node: tuple[Any, ...], place: Mapping[int, int]) -> _Step:
    from .balls import BALLS, JUMPS, LIMITS, number

    op, *arguments = node
    if op == "input":
        return _Step(op, given=arguments[0])
    if op == "const":
        return _Step(op, given=number(arguments[0]), number=float(arguments[0]))
    if len(arguments) == 2 and arguments[0] == arguments[1]:
        if op in OF_ONE_NODE:
            result = number(OF_ONE_NODE[op])
            return _Step(op, (place[arguments[0]],), rule=lambda a: result)
        op, arguments = ("square", arguments[:1]) if op == "mul" else (op, arguments)
    if op not in BALLS and op != "select":
        what = f"the operation {op!r}"
        if op == "foreign":
            what = graph.called_by(arguments[0]).words[0]
        raise TraceError(f"nothing can be proved: there is no enclosure of {what}")
    places = tuple(place[a] for a in arguments)
    quick = RANGES.get(op)
    return _Step(op, places, None, BALLS.get(op), JUMPS.get(op), op not in LIMITS, quick)


def _apply(step: _Step, args: list[Any]) -> tuple[Any, bool]:
    if step.strict:
        args = [_finite(argument) for argument in args]
    for argument in args:
        if hasattr(argument, "reason"):
            return argument, True
    value = step.rule(*args)
    jump = step.jumps is not None and (hasattr(value, "reason") or step.jumps(*args))
    return value, jump


def _select(args: list[Any], jumps: list[bool]) -> tuple[Any, bool]:
    """The branch taken, or the hull of both if the test is undecided."""
    from .balls import Undefined, hull

    test, yes, no = args
    if isinstance(test, Undefined):
        return test, True
    if test is not None:
        return (yes, jumps[0]) if test else (no, jumps[1])
    for branch in (yes, no):
        if isinstance(branch, Undefined):
            return branch, True
    if isinstance(yes, bool | None) or isinstance(no, bool | None):
        return (yes if yes is no else None), True
    return hull(yes, no), True


def _finite(value: Any) -> Any:
    if value is None or value is True or value is False:
        return value
    if hasattr(value, "reason") or value.is_finite():
        return value
    from .balls import Undefined

    return Undefined("a value that may not be finite")
