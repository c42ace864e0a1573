"""Rigorous extrema of an expression on a box, by branch and bound.

A sub-box is bounded by interval evaluation and, if the gradient has been traced, by the mean value
form. If the gradient's sign proves that the expression is monotone in a coordinate, the sub-box
shrinks to a face. The best value at a point bounds the extremum from the other side. Both bounds
hold whenever the search stops.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import attrs

from .interval import Enclosure, IntervalProgram

Bounds = tuple[float, float]
Box = dict[str, Bounds]

#: Most divisions of sub-boxes, times the number of nodes of the graph.
EFFORT = 60_000


class ScalarFunction:
    """An expression of named inputs, with its gradient if that could be traced.

    Parameters
    ----------
    value : IntervalProgram
        Its root is the expression.
    slopes : IntervalProgram, optional
        Its roots are the partial derivatives, valid only where the expression is defined.
    gradient : sequence of str
        The inputs of these partial derivatives, in order.
    """

    def __init__(
        self,
        value: IntervalProgram,
        slopes: IntervalProgram | None = None,
        gradient: Sequence[str] = (),
    ) -> None:
        self.value, self.slopes, self.gradient = value, slopes, list(gradient)
        self.inputs = value.inputs

    def __len__(self) -> int:
        return len(self.value) + (len(self.slopes) if self.slopes else 0)

    def enclose(self, box: Mapping[str, Any]) -> tuple[Enclosure, dict[str, Any]]:
        """The enclosure over a box, and the enclosures of the slopes that are defined."""
        (value,) = self.value.enclose(box)
        if self.slopes is None or not value.defined:
            return value, {}
        named = zip(self.gradient, self.slopes.enclose(box), strict=True)
        return value, {name: slope.value for name, slope in named if slope.defined}

    def at(self, point: Mapping[str, Any]) -> Any:
        """The value at a point as a small ball; None if it is not defined."""
        value = self.value.enclose(point)[0]
        return value.value if value.defined else None


@attrs.frozen
class Extreme:
    """The infimum or supremum of an expression on a box lies in ``[low, high]``.

    Attributes
    ----------
    at : dict
        The best point found: the value there is the bound from inside. Contains only coordinates on
        which the expression depends.
    reason : str
        Why a bound is infinite; else empty.
    """

    low: float
    high: float
    at: dict[str, float]
    reason: str = ""


def extrema(
    function: ScalarFunction, box: Mapping[str, Bounds], tolerance: float = 1e-12
) -> tuple[Extreme, Extreme]:
    """Infimum and supremum of an expression on a box.

    Parameters
    ----------
    function : ScalarFunction
    box : mapping of str to (low, high)
        Bounds of every input of the expression; others are ignored.
    tolerance : float
        The search stops when the bounds are this close, relative to max(1, |value|).

    Returns
    -------
    (Extreme, Extreme)
        Infimum, supremum; bounds that could not be shown are infinite.
    """
    most = supremum(function, box, tolerance)
    least = supremum(function, box, tolerance, sign=-1)
    return Extreme(-least.high, -least.low, least.at, least.reason), most


def supremum(
    function: ScalarFunction,
    box: Mapping[str, Bounds],
    tolerance: float = 1e-12,
    sign: int = 1,
    effort: int = EFFORT,
) -> Extreme:
    """The supremum of ``sign`` times an expression on a box; see :func:`extrema`.

    ``effort`` is the most divisions of sub-boxes, times the number of nodes.
    """
    search = _Search(function, sign)
    whole = {name: box[name] for name in sorted(function.inputs)}
    search.add(whole)
    for _ in range(max(50, effort // len(function))):
        if not search.open or search.closed(tolerance):
            break
        search.divide()
    top = -search.open[0][0] if search.open else search.best
    return Extreme(search.best, max(top, search.best), search.at, search.reason)


def continuous(function: ScalarFunction, box: Mapping[str, Bounds], effort: int = 200) -> bool:
    """Whether an expression is proved continuous on a box, with a bounded gradient.

    Together these make it Lipschitz continuous there.
    """
    queue = [{name: box[name] for name in function.inputs}]
    for part in itertools.islice(_popped(queue), effort):
        value, slopes = function.enclose(part)
        if not value.defined or not value.continuous or not set(part) <= set(slopes):
            queue.extend(_halves(part))
    return not queue


def _popped(queue: list[Box]) -> Iterable[Box]:
    while queue:
        yield queue.pop(0)


class _Search:
    """The search: open sub-boxes ordered by upper bound, and the best value at a point."""

    def __init__(self, function: ScalarFunction, sign: int) -> None:
        self.function, self.sign = function, sign
        self.open: list[tuple[float, int, Box]] = []
        self.best, self.at = float("-inf"), dict[str, float]()
        self.reason = ""
        self._count = itertools.count()

    def closed(self, tolerance: float) -> bool:
        """Whether the bounds of the supremum agree up to a tolerance."""
        top = -self.open[0][0]
        return top - self.best <= tolerance * max(1.0, abs(self.best))

    def divide(self) -> None:
        """Halve the sub-box with the largest upper bound."""
        _, _, part = heapq.heappop(self.open)
        for half in _halves(part):
            self.add(half)

    def add(self, part: Box) -> None:
        """Bound a sub-box, and keep it if it may exceed the best value."""
        top, part, slopes = self.bound(part)
        point = {name: _middle(bounds) for name, bounds in part.items()}
        value = self.sample(point)
        if value is not None and slopes is not None:
            top = min(top, self.mean_value(value, part, point, slopes))
        if top > self.best:
            heapq.heappush(self.open, (-top, next(self._count), part))

    def sample(self, point: dict[str, float]) -> Any:
        """The value at a point as a ball, recorded if it is the best; None if undefined."""
        from .balls import low

        value = self.function.at(point)
        if value is not None and low(self.sign * value) > self.best:
            self.best, self.at = low(self.sign * value), point
        return value

    def bound(self, part: Box) -> tuple[float, Box, dict[str, Any] | None]:
        """An upper bound on a sub-box, the face on which it is attained, and the slopes there."""
        from .balls import high

        value, slopes = self.function.enclose(part)
        if not value.defined:
            self.reason = value.value.reason
            return float("inf"), part, None
        top = high(self.sign * value.value)
        if not value.continuous:
            return top, part, None
        face = {name: self.face(part[name], slopes.get(name)) for name in part}
        if face != part:
            return self.bound(face)
        return top, part, slopes if all(name in slopes for name in part) else None

    def face(self, bounds: Bounds, slope: Any) -> Bounds:
        """The bounds of a coordinate, reduced to the better end if the slope has one sign."""
        if slope is None or bounds[0] == bounds[1] or not (slope >= 0 or slope <= 0):
            return bounds
        end = bounds[1] if (slope >= 0) == (self.sign > 0) else bounds[0]
        return (end, end)

    def mean_value(self, value: Any, part: Box, point: dict[str, float], slopes: Any) -> float:
        """An upper bound on a sub-box by the mean value form about a point."""
        from flint import ctx

        from .balls import BALLS, high
        from .interval import PRECISION, ball

        with ctx.workprec(PRECISION):
            for name, bounds in part.items():
                away = ball(bounds) - ball(point[name])
                value = BALLS["add"](value, BALLS["mul"](slopes[name], away))
            return high(self.sign * value)


def _middle(bounds: Bounds) -> float:
    return min(max(0.5 * bounds[0] + 0.5 * bounds[1], bounds[0]), bounds[1])


def _halves(part: Box) -> list[Box]:
    """The two halves of a box, across its widest side that can be divided."""
    wide = [name for name, (a, b) in part.items() if a < _middle((a, b)) < b]
    if not wide:
        return [part]
    name = max(wide, key=lambda n: part[n][1] - part[n][0])
    (a, b), middle = part[name], _middle(part[name])
    return [{**part, name: (a, middle)}, {**part, name: (middle, b)}]
