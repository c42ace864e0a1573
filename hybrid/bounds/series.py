"""Every operation of a graph on power series of balls, to bound functions along a curve.

If the first coefficient of a series is a ball, the others contain the Taylor coefficients at every
point of that ball. With the expansion about its middle they bound the function on the whole ball,
as accurately as its smoothness permits (Taylor's theorem). So no pulse can be missed, however
narrow it is. Where a function is not analytic on the whole piece (an undecided test, a root near
zero), the result is :class:`.balls.Undefined`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from flint import arb, arb_series, ctx

from ..lowering.graph import Graph, needed
from .balls import BALLS, Undefined
from .interval import OF_ONE_NODE

#: Terms of the series. With twelve, a piece as long as a tenth of the radius of convergence is
#: resolved to a relative 1e-12; with more, the higher cost outweighs the smaller number of pieces.
TERMS = 12

#: Step functions; each is constant on a piece where its enclosure is a single number.
STEP_FUNCTIONS = {"floor", "ceil", "round", "away", "trunc", "sign"}

#: Tests, and logical operations.
TESTS = {"gt", "ge", "lt", "le", "eq", "ne"}
LOGIC = {"and", "or", "xor", "not", "is_finite"}

#: Entries of tables, at places that tests have decided.
ENTRIES = {"pick", "knot"}


class Balls:
    """Some nodes of a graph, prepared for repeated evaluation.

    Parameters
    ----------
    graph : Graph
    roots : sequence of int
    """

    def __init__(self, graph: Graph, roots: Sequence[int]) -> None:
        order = needed(graph, roots)
        place = {number: place for place, number in enumerate(order)}
        self.nodes = [_placed(graph.nodes[number], place) for number in order]
        self.roots = [place[root] for root in roots]

    def bind(self, numbers: Sequence[float], series: bool) -> Bound:
        """The nodes with parameter values, for evaluation on series or on balls."""
        return Bound(self, numbers, series)


class Bound:
    """Nodes with parameter values; those that depend on parameters only are computed once.

    For evaluation on series, numbers in sums and products are converted to series in advance: flint
    would convert them each time, at more than the cost of the sum.
    """

    def __init__(self, balls: Balls, numbers: Sequence[float], series: bool) -> None:
        self.roots, self.inputs = balls.roots, list[tuple[int, str]]()
        self.values = values = [None] * len(balls.nodes)
        self.steps = list[tuple[int, str, Any, list[int]]]()
        fixed = set[int]()
        for place, (op, given) in enumerate(balls.nodes):
            if op == "const":
                values[place] = _constant(given[0])
            elif op == "input" and given[0].startswith("p"):
                values[place] = arb(numbers[int(given[0][1:])])
            elif op == "input":
                self.inputs.append((place, given[0]))
                continue
            elif fixed.issuperset(given):
                values[place] = _apply(op, [values[p] for p in given])
            else:
                self.steps.append((place, op, ARITHMETIC.get(op), given))
                continue
            fixed.add(place)
        if series:
            self._make_series(fixed)

    def _make_series(self, fixed: set[int]) -> None:
        numbers = [place for place in fixed if isinstance(self.values[place], arb)]
        own = {place: len(self.values) + k for k, place in enumerate(numbers)}
        self.values += [_series(self.values[place]) for place in numbers]
        self.steps = [
            (place, op, plain, [own.get(p, p) for p in given] if plain else given)
            for place, op, plain, given in self.steps
        ]

    def __call__(self, inputs: Mapping[str, Any]) -> list[Any]:
        """Values of the roots: ``arb_series``, numbers, truth values or ``Undefined``."""
        values = self.values.copy()
        for place, name in self.inputs:
            values[place] = inputs[name]
        for place, op, plain, given in self.steps:
            arguments = [values[p] for p in given]
            if plain is not None:
                try:
                    values[place] = plain(*arguments)
                    continue
                except TypeError:  # one is Undefined
                    pass
            values[place] = _apply(op, arguments)
        return [values[root] for root in self.roots]


def _placed(node: tuple[Any, ...], place: Mapping[int, int]) -> tuple[str, list[Any]]:
    """An operation with the places of its arguments, or with the data of an input or constant. A
    test of a node against itself has one place."""
    op, *given = node
    given = given[:1] if op in TESTS and given[0] == given[1] else given
    return op, given if op in ("input", "const") else [place[a] for a in given]


#: Operations that flint applies to balls and series alike, without loss for narrow balls.
ARITHMETIC = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "neg": operator.neg}


def _constant(value: Any) -> Any:
    return value if isinstance(value, bool) else arb(value)


def _apply(op: str, args: list[Any]) -> Any:
    if op == "select":
        test, yes, no = args
        if test is None or isinstance(test, Undefined):
            return Undefined("a test that is not decided")
        return yes if test else no
    bad = next((a for a in args if isinstance(a, Undefined)), None)
    if bad is not None:
        return bad
    if op in TESTS and len(args) == 1:
        return OF_ONE_NODE[op]
    if op in ENTRIES and _first(args[1]).is_exact():
        return BALLS[op](args[0], _first(args[1]))
    if op in TESTS or op in LOGIC or op in STEP_FUNCTIONS or op == "real":
        return _whole(op, [_first(a) for a in args])
    if not any(isinstance(a, arb_series) for a in args):
        return BALLS[op](*args)
    rule = SERIES_RULES.get(op)
    if rule is None:
        return Undefined(f"{op} has no series of balls")
    try:
        return rule(*args)
    except (ValueError, ZeroDivisionError):
        return Undefined(f"{op} outside its domain")


def _first(value: Any) -> Any:
    return value[0] if isinstance(value, arb_series) else value


def _whole(op: str, firsts: list[Any]) -> Any:
    value = BALLS[op](*firsts)
    if isinstance(value, arb) and not value.is_exact():
        return Undefined(f"{op} that is not one number")
    return Undefined(f"{op} that is not decided") if value is None and op == "real" else value


def _series(value: Any) -> Any:
    return value if isinstance(value, arb_series) else arb_series([value])


def _signed(a: Any) -> Any:
    if a[0] >= 0:
        return a
    return -a if a[0] <= 0 else Undefined("a value whose sign is not decided")


def _larger(a: Any, b: Any) -> Any:
    first, second = _first(a), _first(b)
    if first >= second:
        return a
    return b if second >= first else Undefined("a maximum that is not decided")


def _smaller(a: Any, b: Any) -> Any:
    first, second = _first(a), _first(b)
    if first <= second:
        return a
    return b if second <= first else Undefined("a minimum that is not decided")


def _power(a: Any, b: Any) -> Any:
    whole = b.unique_fmpz() if isinstance(b, arb) and b.is_exact() else None
    if whole is not None:
        power = _whole_power(_series(a), abs(int(whole)))
        return power if whole >= 0 else _divide(arb(1), power)
    if not _first(a) > 0:
        return Undefined("a power of what may not be positive")
    return (_series(b) * _series(a).log()).exp()


def _whole_power(a: Any, n: int) -> Any:
    result = arb_series([1])
    for digit in bin(n)[2:]:
        result = result * result
        result = result * a if digit == "1" else result
    return result


def _divide(a: Any, b: Any) -> Any:
    if _first(b).contains(0):
        return Undefined("a division by what may be zero")
    return _series(a) / _series(b)


def _positive(function: Callable[[Any], Any]) -> Any:
    return lambda a: function(a) if a[0] > 0 else Undefined("a root or logarithm near zero")


def _remainder(a: Any, b: Any) -> Any:
    quotient = BALLS["div"](_first(a), _first(b))
    whole = quotient if isinstance(quotient, Undefined) else BALLS["trunc"](quotient)
    if isinstance(whole, Undefined) or not whole.is_exact():
        return Undefined("a remainder across a step")
    return _series(a) - whole * _series(b)


def _tanh(a: Any) -> Any:
    if a[0] < 0:
        return -_tanh(-a)
    falls = (a * -2).exp()
    return (1 - falls) / (1 + falls)


SERIES_RULES: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: _series(a) + _series(b),
    "sub": lambda a, b: _series(a) - _series(b),
    "neg": lambda a: -a,
    "mul": lambda a, b: _series(a) * _series(b),
    "square": lambda a: a * a,
    "div": _divide,
    "pow": _power,
    "rem": _remainder,
    "abs": _signed,
    "max": _larger,
    "min": _smaller,
    "sqrt": _positive(lambda a: a.sqrt()),
    "cbrt": _positive(lambda a: (a.log() / 3).exp()),
    "exp": lambda a: a.exp(),
    "exp2": lambda a: (a * arb(2).log()).exp(),
    "expm1": lambda a: a.exp() - 1,
    "log": _positive(lambda a: a.log()),
    "log1p": lambda a: _positive(lambda b: b.log())(1 + a),
    "logistic": lambda a: 1 / (1 + (-a).exp()),
    "sin": lambda a: a.sin(),
    "cos": lambda a: a.cos(),
    "tan": lambda a: _divide(a.sin(), a.cos()),
    "asin": lambda a: a.asin(),
    "acos": lambda a: a.acos(),
    "atan": lambda a: a.atan(),
    "sinh": lambda a: (a.exp() - (-a).exp()) / 2,
    "cosh": lambda a: (a.exp() + (-a).exp()) / 2,
    "tanh": _tanh,
    "asinh": lambda a: (a + (a * a + 1).sqrt()).log(),
    "erf": lambda a: a.erf(),
    "erfc": lambda a: a.erfc(),
}


def with_terms(function: Callable[[], Any], precision: int, terms: int = TERMS) -> Any:
    """Evaluate ``function`` with flint set to a precision and to a number of terms of series."""
    before = ctx.cap
    ctx.cap = terms
    try:
        with ctx.workprec(precision):
            return function()
    finally:
        ctx.cap = before
