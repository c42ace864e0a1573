"""Growth of a traced expression when some of its inputs are unbounded.

Each node has a range, whose ends may be infinite, and growth exponents. With ``s`` the size of the
*growing* inputs, the value is at most ``C (1 + s)^up`` and at least ``-C (1 + s)^down``, where
``C`` is bounded as long as all other inputs are. An operation that may leave its domain is
:class:`~.balls.Undefined`, as in ball arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import attrs

from ..lowering.graph import Graph, needed
from .balls import BALLS, Undefined, comparisons, high, low, span
from .interval import OF_ONE_NODE

#: Growth exponent assigned to logarithms, which grow more slowly than any power; it is below the
#: exponents of roots that models use.
SLOWLY = 0.125


@attrs.frozen
class Growth:
    """The range of a value, and the growth exponents of its ends.

    Attributes
    ----------
    low, high : float
        Bounds, rounded outward; may be infinite.
    up, down : float
        Exponents of growth upward and downward; ``inf`` if no power bounds it.
    least : float
        For large values of the growing input, the absolute value grows at least with this exponent;
        ``-inf`` if nothing is known.
    """

    low: float
    high: float
    up: float = 0.0
    down: float = 0.0
    least: float = -math.inf

    @property
    def positive(self) -> bool:
        """Whether the value is bounded below by a positive number."""
        return self.low > 0.0

    @property
    def size(self) -> float:
        """The growth exponent of the absolute value."""
        return max(self.up, self.down)

    @property
    def bounded(self) -> bool:
        """Whether both ends are finite."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def settled(self) -> Growth:
        """The same growth, with exponents tightened where the range implies it."""
        up = min(self.up, 0.0) if self.high < math.inf else self.up
        down = min(self.down, 0.0) if self.low > -math.inf else self.down
        away = self.low > 0.0 or self.high < 0.0
        return attrs.evolve(
            self, up=up, down=down, least=max(self.least, 0.0 if away else -math.inf)
        )


#: An input that is unbounded but does not count as growing: bounds on other states bound it in
#: finite time.
ANYTHING = Growth(-math.inf, math.inf)

#: One of several growing inputs; and the positive and the negative half of a single growing input.
GROWING = Growth(-math.inf, math.inf, 1.0, 1.0)
UPPER, LOWER = Growth(0.0, math.inf, 1.0, 0.0, 1.0), Growth(-math.inf, 0.0, 0.0, 1.0, 1.0)


def between(least: float, most: float) -> Growth:
    """The growth of an input between bounds."""
    return Growth(least, most).settled()


def growth(graph: Graph, root: int, inputs: Mapping[str, Growth]) -> Any:
    """The growth of a node of a graph.

    Returns
    -------
    Growth, bool, None or Undefined
        Truth values as in :mod:`.balls`; :class:`~.balls.Undefined` if the node may be undefined.
    """
    values: dict[int, Any] = {}
    for number in needed(graph, [root]):
        op, *arguments = graph.nodes[number]
        if op == "input":
            values[number] = inputs[arguments[0]]
        elif op == "const":
            values[number] = _constant(arguments[0])
        else:
            values[number] = _apply(op, arguments, [values[a] for a in arguments])
    return values[root]


def _constant(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    value = float(value)
    return between(value, value) if math.isfinite(value) else Undefined("a constant not finite")


def _apply(op: str, places: list[int], args: list[Any]) -> Any:
    same = len(places) == 2 and places[0] == places[1]
    if op == "select":
        return _select(*args)
    for argument in args:
        if isinstance(argument, Undefined):
            return argument
    if same and op in OF_ONE_NODE:
        return _constant(OF_ONE_NODE[op])
    if same and op == "mul":
        return _square(args[0])
    if op in GROWTH_TESTS:
        return GROWTH_TESTS[op](*args)
    found = GROWTH_RULES[op](*map(_number, args)) if op in GROWTH_RULES else _by_balls(op, args)
    return found.settled() if isinstance(found, Growth) else found


def _number(value: Any) -> Growth:
    """A value or truth value as a growth."""
    if isinstance(value, Growth):
        return value
    return between(0.0, 1.0) if value is None else between(float(value), float(value))


def _by_balls(op: str, args: list[Any]) -> Any:
    """An operation without a growth rule, evaluated on bounded arguments by balls."""
    if not all(isinstance(a, Growth) and a.bounded for a in args):
        return Undefined(f"{op} of what has no bounds")
    from flint import arb

    return _range(BALLS[op](*(span(arb(a.low), arb(a.high)) for a in args)))


def _range(ball: Any) -> Any:
    if isinstance(ball, Undefined | bool | None):
        return ball
    if not ball.is_finite():
        return Undefined("a value that may not be finite")
    return between(low(ball), high(ball))


# ---------------------------------------------------------------------------------------
# arithmetic


def _outward(least: float, most: float) -> tuple[float, float]:
    return math.nextafter(least, -math.inf), math.nextafter(most, math.inf)


def _neg(a: Growth) -> Growth:
    return Growth(-a.high, -a.low, a.down, a.up, a.least)


def _add(a: Growth, b: Growth) -> Growth:
    ends = _outward(a.low + b.low, a.high + b.high)
    above, under = a.low >= 0.0 and b.low >= 0.0, a.high <= 0.0 and b.high <= 0.0
    ends = max(ends[0], 0.0) if above else ends[0], min(ends[1], 0.0) if under else ends[1]
    least = max(a.least, b.least)
    if not (above or under or a.least > b.size or b.least > a.size):
        least = -math.inf
    return Growth(*ends, max(a.up, b.up), max(a.down, b.down), least)


def _times(a: float, b: float) -> float:
    """A product of range ends, in which zero times infinity is zero."""
    return 0.0 if a == 0.0 or b == 0.0 else a * b


def _mul(a: Growth, b: Growth) -> Growth:
    corners = [_times(p, q) for p in (a.low, a.high) for q in (b.low, b.high)]
    ends = _outward(min(corners), max(corners))
    if min(corners) >= 0.0:
        ends = (max(ends[0], 0.0), ends[1])
    if max(corners) <= 0.0:
        ends = (ends[0], min(ends[1], 0.0))
    above, below = (a.high > 0.0, b.high > 0.0), (a.low < 0.0, b.low < 0.0)
    up = [a.up + b.up] * all(above) + [a.down + b.down] * all(below)
    down = [a.up + b.down] * (above[0] and below[1]) + [a.down + b.up] * (below[0] and above[1])
    return Growth(*ends, max(up, default=0.0), max(down, default=0.0), _sum(a.least, b.least))


def _sum(a: float, b: float) -> float:
    """The sum of two ``least`` exponents; unknown if either is."""
    return -math.inf if -math.inf in (a, b) else a + b


def _square(a: Growth) -> Growth:
    size = _abs(a)
    return _mul(size, size).settled()


def _inverse(a: Growth) -> Any:
    if a.high < 0.0:
        found = _inverse(_neg(a))
        return _neg(found)
    if not a.positive:
        return Undefined("a division by what may be zero")
    ends = _outward(1.0 / a.high, 1.0 / a.low)
    falls = -a.least if a.least > 0.0 else 0.0
    return Growth(max(ends[0], 0.0), ends[1], falls, 0.0, -a.up)


def _div(a: Growth, b: Growth) -> Any:
    inverse = _inverse(b)
    return _mul(a, inverse) if isinstance(inverse, Growth) else inverse


def _abs(a: Growth) -> Growth:
    if a.low >= 0.0:
        return a
    if a.high <= 0.0:
        return _neg(a)
    return Growth(0.0, max(-a.low, a.high), a.size, 0.0, a.least)


def _max(a: Growth, b: Growth) -> Growth:
    return Growth(max(a.low, b.low), max(a.high, b.high), max(a.up, b.up), min(a.down, b.down))


def _rem(a: Growth, b: Growth) -> Any:
    size = _abs(b)
    if not size.positive:
        return Undefined("a division by what may be zero")
    down = -size.high if a.low < 0.0 else 0.0
    return Growth(down, size.high if a.high > 0.0 else 0.0, size.up, size.up)


def _pow(a: Growth, b: Growth) -> Any:
    if b.low != b.high:
        return _power_of_any(a, b)
    whole, exponent = b.low.is_integer(), b.low
    if exponent == 0.0:
        return between(1.0, 1.0)  # also for 0 ** 0
    if exponent < 0.0:
        found = _pow(a, between(-exponent, -exponent))
        return _inverse(found) if isinstance(found, Growth) else found
    if not whole and a.low < 0.0:
        return Undefined("a power of what may be negative")
    if whole and exponent % 2:
        upper, lower = (
            _power(_max(a, NO_GROWTH), exponent),
            _power(_max(_neg(a), NO_GROWTH), exponent),
        )
        return Growth(-lower.high, upper.high, upper.up, lower.up, a.least * exponent)
    return _power(_abs(a), exponent)


NO_GROWTH = Growth(0.0, 0.0)


def _power(a: Growth, exponent: float) -> Growth:
    """A power of a nonnegative value."""
    from flint import arb

    def end(value: float) -> Any:
        return arb(value) ** arb(exponent)

    least = max(low(end(a.low)), 0.0) if a.low > 0.0 else 0.0
    most = high(end(a.high)) if math.isfinite(a.high) and a.high > 0.0 else a.high
    known = a.least if a.least == -math.inf else a.least * exponent
    return Growth(least, most, a.up * exponent, 0.0, known)


def _power_of_any(a: Growth, b: Growth) -> Any:
    if not a.positive:
        return Undefined("a power of what may be negative")
    grows = a.size > 0.0 or b.size > 0.0
    return Growth(0.0, math.inf, math.inf if grows else 0.0)


# ---------------------------------------------------------------------------------------
# functions of one variable, tests, choices


def _within(least: float, most: float) -> Callable[..., Growth]:
    """The rule of a function with values between given bounds, tightened by balls if possible."""

    def rule(op: str, *args: Growth) -> Any:
        found = _by_balls(op, list(args))
        return found if isinstance(found, Growth) else Growth(least, most)

    return rule


def _rises(
    limits: tuple[float, float], share: float = 1.0, domain: float = -math.inf, open_: bool = False
) -> Callable[..., Any]:
    """The rule of a nondecreasing function with given limits at the ends of its domain; ``share``
    multiplies the exponents of its argument."""

    def rule(op: str, a: Growth) -> Any:
        if not (a.low > domain if open_ else a.low >= domain):
            return Undefined("a root, logarithm or inverse function outside its domain")
        from flint import arb

        least = limits[0] if a.low == -math.inf else low(BALLS[op](arb(a.low)))
        most = limits[1] if a.high == math.inf else high(BALLS[op](arb(a.high)))
        known = a.least * share if a.least > -math.inf and op in ("sqrt", "cbrt") else -math.inf
        up, down = (share * e if e > 0.0 else 0.0 for e in (a.up, a.down))
        return Growth(least, most, up, down, known)

    return rule


def _exponential(limits: tuple[float, float]) -> Callable[..., Any]:
    """The rule of a nondecreasing function that no power bounds."""
    plain = _rises(limits)

    def rule(op: str, a: Growth) -> Any:
        found: Growth = plain(op, a)
        up, down = (math.inf if e > 0.0 else 0.0 for e in (a.up, a.down))
        return attrs.evolve(found, up=up, down=down, least=-math.inf)

    return rule


_INF = math.inf
_NAMED: dict[str, Callable[..., Any]] = {
    **dict.fromkeys(("sin", "cos", "sign", "tanh", "erf"), _within(-1.0, 1.0)),
    **dict.fromkeys(("atan", "atan2"), _within(-3.2, 3.2)),
    "logistic": _within(0.0, 1.0),
    "erfc": _within(0.0, 2.0),
    **dict.fromkeys(("floor", "ceil", "round", "away", "trunc"), _rises((-_INF, _INF))),
    "sqrt": _rises((0.0, _INF), 0.5, 0.0),
    "cbrt": _rises((-_INF, _INF), 1.0 / 3.0),
    "asinh": _rises((-_INF, _INF), SLOWLY),
    "log": _rises((-_INF, _INF), SLOWLY, 0.0, open_=True),
    "log1p": _rises((-_INF, _INF), SLOWLY, -1.0, open_=True),
    "acosh": _rises((0.0, _INF), SLOWLY, 1.0),
    **dict.fromkeys(("exp", "exp2"), _exponential((0.0, _INF))),
    "expm1": _exponential((-1.0, _INF)),
    "sinh": _exponential((-_INF, _INF)),
    "cosh": lambda op, a: _exponential((1.0, _INF))(op, _abs(a)),
}

GROWTH_RULES: dict[str, Callable[..., Any]] = {
    "table": lambda *entries: Undefined("an entry of a table"),
    "neg": _neg,
    "add": _add,
    "sub": lambda a, b: _add(a, _neg(b)),
    "mul": _mul,
    "square": _square,
    "div": _div,
    "abs": _abs,
    "max": _max,
    "min": lambda a, b: _neg(_max(_neg(a), _neg(b))),
    "rem": _rem,
    "pow": _pow,
    "real": lambda a: a,
    **{op: (lambda *a, op=op, rule=rule: rule(op, *a)) for op, rule in _NAMED.items()},
}


def _greater(a: Any, b: Any) -> bool | None:
    a, b = _number(a), _number(b)
    return True if a.low > b.high else False if a.high <= b.low else None


def _equal(a: Any, b: Any) -> bool | None:
    a, b = _number(a), _number(b)
    if a.low > b.high or b.low > a.high:
        return False
    return True if a.low == a.high == b.low == b.high else None


GROWTH_TESTS: dict[str, Callable[..., Any]] = {
    **comparisons(_greater, _equal),
    "is_finite": lambda a: True,
    **{op: (lambda *a, op=op: _logic(op, *a)) for op in ("and", "or", "xor", "not")},
}


def _logic(op: str, *args: Any) -> Any:
    if any(isinstance(a, Growth) for a in args):
        return Undefined("a bitwise operation on numbers")
    return BALLS[op](*args)


def _select(test: Any, yes: Any, no: Any) -> Any:
    if isinstance(test, Undefined):
        return test
    if isinstance(test, Growth):
        return Undefined("a choice by a number")
    if test is not None:
        return yes if test else no
    for branch in (yes, no):
        if isinstance(branch, Undefined):
            return branch
    if not (isinstance(yes, Growth) or isinstance(no, Growth)):
        return yes if yes is no else None
    a, b = _number(yes), _number(no)
    ends = min(a.low, b.low), max(a.high, b.high)
    return Growth(*ends, max(a.up, b.up), max(a.down, b.down), min(a.least, b.least))
