"""Every operation of a graph in ball arithmetic (python-flint's ``arb``), rounded outward.

A value is one of: a ball that contains a real number; ``True``, ``False`` or ``None`` (a test that
is true at some points of the box and false at others); or :class:`Undefined` (an operation may
leave its domain or overflow, and nothing is claimed). Wide balls are evaluated at their ends,
because midpoint-radius arithmetic overestimates them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import attrs
from flint import arb, ctx


@attrs.frozen
class Undefined:
    """A value without an enclosure, and the reason."""

    reason: str


def ends(x: Any) -> tuple[Any, Any]:
    """The smallest and the largest number of a ball, as exact balls."""
    return (x, x) if x.is_exact() else (x.lower(), x.upper())


def span(least: Any, most: Any) -> Any:
    """The ball from one exact ball to another.

    A radius has few bits, so it is rounded up, and the midpoint is chosen so that the lower end
    stays exact (or the upper one, if it is 0). A square therefore stays nonnegative.
    """
    if least == most:
        return least
    precision, ctx.prec = ctx.prec, 29
    try:
        around = arb(0, ((most - least) / 2).upper())
    finally:
        ctx.prec = precision
    width = around + around.rad()
    return most - width if most == 0 else least + width


def hull(*balls: Any) -> Any:
    """A ball that contains all the given ones, with an exact lower end."""
    least, most = ends(balls[0])
    for ball in balls[1:]:
        a, b = ends(ball)
        least, most = least.min(a), most.max(b)
    return span(least, most)


def number(value: Any) -> Any:
    """A constant of a graph, or a bound, as one of the values of this module."""
    if isinstance(value, bool | arb):
        return value
    return Undefined("the constant nan") if value != value else arb(value)


def _fraction(x: Any) -> Fraction:
    mantissa, exponent = x.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def low(x: Any) -> float:
    """A float not above any number of the ball."""
    with ctx.workprec(53):
        value = float(x.lower())
    return value if arb(value) <= x else math.nextafter(value, -math.inf)


def high(x: Any) -> float:
    """A float not below any number of the ball."""
    with ctx.workprec(53):
        value = float(x.upper())
    return value if arb(value) >= x else math.nextafter(value, math.inf)


# ---------------------------------------------------------------------------------------
# arithmetic


def _add(a: Any, b: Any) -> Any:
    if a.is_exact() and b.is_exact():
        return a + b
    return hull(*(p + q for p, q in zip(ends(a), ends(b), strict=True)))


def _mul(a: Any, b: Any) -> Any:
    if a.is_exact() and b.is_exact():
        return a * b
    return hull(*(p * q for p in ends(a) for q in ends(b)))


def _div(a: Any, b: Any) -> Any:
    if b.contains(0):
        return Undefined("a division by what may be zero")
    if a.is_exact() and b.is_exact():
        return a / b
    return hull(*(p / q for p in ends(a) for q in ends(b)))


def absolute(a: Any) -> Any:
    """``|a|``."""
    least, most = ends(a)
    if least >= 0:
        return a
    return -a if most <= 0 else hull(arb(0), (-least).max(most))


def square(a: Any) -> Any:
    """``a * a``, never negative."""
    least, most = ends(absolute(a))
    return hull(least.max(0) * least.max(0), most * most)


def _max(a: Any, b: Any) -> Any:
    (p, q), (r, s) = ends(a), ends(b)
    return hull(p.max(r), q.max(s))


def _min(a: Any, b: Any) -> Any:
    return -_max(-a, -b)


def _sign(a: Any) -> Any:
    if a == 0:
        return arb(0)
    return arb(1) if a > 0 else arb(-1) if a < 0 else hull(arb(-1), arb(1))


def _pow(x: Any, y: Any) -> Any:
    whole = y.unique_fmpz() if y.is_exact() else None
    if whole is not None:
        return _whole_power(x, int(whole))
    least, most = ends(x)
    if least > 0:
        return rising(lambda v: v.exp())(_mul(y, rising(lambda v: v.log())(x)))
    if least >= 0 and y > 0:
        top = arb(0) if most == 0 else hull(*(most**e for e in ends(y)))
        return hull(arb(0), top)
    return Undefined("a power of what may be negative")


def _whole_power(x: Any, n: int) -> Any:
    if n < 0:
        return _div(arb(1), _whole_power(x, -n))
    least, most = ends(x if n % 2 else absolute(x))
    return hull(least**n, most**n)


def _rem(a: Any, b: Any) -> Any:
    quotient = _div(a, b)
    if isinstance(quotient, Undefined):
        return quotient
    whole = _stepwise(math.trunc)(quotient)
    if whole.is_exact():
        return a - whole * b
    most = ends(_min(absolute(a), absolute(b)))[1]
    least = -most if a.lower() < 0 else arb(0)
    return hull(least, most if a.upper() > 0 else arb(0))


# ---------------------------------------------------------------------------------------
# functions of one variable


def rising(function: Callable[[Any], Any], least: float | None = None, open_: bool = False) -> Any:
    """The operation on balls of a monotone function, from its values at the ends of a ball.

    ``least`` is the lower end of the domain, excluded if ``open_``.
    """

    def apply(x: Any) -> Any:
        a, b = ends(x)
        if least is not None and not (a > least if open_ else a >= least):
            return Undefined("a root, logarithm or inverse function outside its domain")
        return function(a) if x.is_exact() else hull(function(a), function(b))

    return apply


def _bounded(function: Callable[[Any], Any], open_: bool = False) -> Any:
    """The operation on balls of a monotone function on [-1, 1], or (-1, 1) if ``open_``."""
    inner = rising(function)

    def apply(x: Any) -> Any:
        a, b = ends(x)
        inside = (a > -1 and b < 1) if open_ else (a >= -1 and b <= 1)
        return inner(x) if inside else Undefined("an inverse function outside [-1, 1]")

    return apply


def _stepwise(function: Callable[[Fraction], int]) -> Any:
    """The operation on balls of a nondecreasing integer-valued function."""
    return rising(lambda v: arb(function(_fraction(v))))


def _entry(table: tuple[Any, ...], place: Any) -> Any:
    """The entry of a table at a place, clamped to its range: the hull of all that may be meant."""
    if not place.is_finite():
        return Undefined("a place in a table that may not be finite")
    first, last = (math.floor(_fraction(end)) for end in ends(place))
    least, most = (min(max(k, 0), len(table) - 1) for k in (first, last))
    return hull(*table[least : most + 1])


def _away(x: Fraction) -> int:
    size = math.floor(abs(x) + Fraction(1, 2))
    return size if x >= 0 else -size


def _tan(x: Any) -> Any:
    turns = ((x / arb.pi()) + arb(0.5)).floor().unique_fmpz()
    if turns is None:
        return Undefined("a tangent across its pole")
    return rising(lambda v: v.tan())(x)


def _lgamma(x: Any) -> Any:
    if not x > 0:
        return Undefined("lgamma of what may not be positive")
    if x < 1.46 or x > 1.47:
        return rising(lambda v: v.lgamma())(x)
    value = x.lgamma()
    return value if value.is_finite() else Undefined("lgamma of a ball that is too wide")


def _cbrt(x: Any) -> Any:
    if x == 0:
        return x
    return x.root(3) if x >= 0 else -((-x).root(3))


def _atan2(y: Any, x: Any) -> Any:
    if _cut(y, x):
        return hull(-arb.pi(), arb.pi())
    return hull(*(arb.atan2(b, a) for b in ends(y) for a in ends(x)))


def _cut(y: Any, x: Any) -> bool:
    """Whether the balls may contain the half-line on which ``atan2`` jumps, or the origin."""
    above, below = y.lower() > 0, y.upper() < 0
    return not (above or below or x.lower() > 0 or (y.lower() >= 0 and not x.contains(0)))


# ---------------------------------------------------------------------------------------
# tests


def _greater(a: Any, b: Any) -> bool | None:
    if isinstance(a, bool) or isinstance(b, bool):
        a, b = arb(int(a)), arb(int(b))
    return True if a > b else False if a <= b else None


def _equal(a: Any, b: Any) -> bool | None:
    if a is None or b is None:
        return None
    if isinstance(a, bool) or isinstance(b, bool):
        return bool(a == b)
    return True if a == b else None if a.overlaps(b) else False


def _not(a: Any) -> Any:
    if isinstance(a, arb):
        return Undefined("a bitwise operation on numbers")
    return None if a is None else not a


def comparisons(greater: Callable[..., Any], equal: Callable[..., Any]) -> dict[str, Any]:
    """All comparisons, by whether the first value is greater and whether both are equal."""
    return {
        "gt": greater,
        "ge": lambda a, b: _not(greater(b, a)),
        "lt": lambda a, b: greater(b, a),
        "le": lambda a, b: _not(greater(a, b)),
        "eq": equal,
        "ne": lambda a, b: _not(equal(a, b)),
    }


def _and(a: Any, b: Any) -> Any:
    if isinstance(a, arb) or isinstance(b, arb):
        return Undefined("a bitwise operation on numbers")
    if a is False or b is False:
        return False
    return None if a is None or b is None else True


def _xor(a: Any, b: Any) -> Any:
    if isinstance(a, arb) or isinstance(b, arb):
        return Undefined("a bitwise operation on numbers")
    return None if a is None or b is None else a != b


def _real(a: Any) -> Any:
    if isinstance(a, arb):
        return a
    return hull(arb(0), arb(1)) if a is None else arb(int(a))


#: All operations except ``select``, which :mod:`.interval` handles.
BALLS: dict[str, Callable[..., Any]] = {
    "add": _add,
    "sub": lambda a, b: _add(a, -b),
    "neg": lambda a: -a,
    "mul": _mul,
    "square": square,
    "div": _div,
    "pow": _pow,
    "rem": _rem,
    "abs": absolute,
    "sign": _sign,
    "max": _max,
    "min": _min,
    "sqrt": rising(lambda v: v.sqrt(), 0.0),
    "cbrt": rising(_cbrt),
    "exp": rising(lambda v: v.exp()),
    "exp2": rising(lambda v: arb(2) ** v),
    "expm1": rising(lambda v: v.expm1()),
    "log": rising(lambda v: v.log(), 0.0, open_=True),
    "log1p": rising(lambda v: v.log1p(), -1.0, open_=True),
    "logistic": rising(lambda v: 1 / (1 + (-v).exp())),
    "sin": lambda v: v.sin(),
    "cos": lambda v: v.cos(),
    "tan": _tan,
    "asin": _bounded(lambda v: v.asin()),
    "acos": _bounded(lambda v: v.acos()),
    "atan": rising(lambda v: v.atan()),
    "atan2": _atan2,
    "sinh": rising(lambda v: v.sinh()),
    "cosh": lambda v: rising(lambda w: w.cosh())(absolute(v)),
    "tanh": rising(lambda v: v.tanh()),
    "asinh": rising(lambda v: v.asinh()),
    "acosh": rising(lambda v: v.acosh(), 1.0),
    "atanh": _bounded(lambda v: v.atanh(), open_=True),
    "erf": rising(lambda v: v.erf()),
    "erfc": rising(lambda v: v.erfc()),
    "lgamma": _lgamma,
    "floor": _stepwise(math.floor),
    "ceil": _stepwise(math.ceil),
    "round": _stepwise(round),
    "away": _stepwise(_away),
    "trunc": lambda a: _stepwise(math.trunc)(a) if isinstance(a, arb) else _real(a),
    "real": _real,
    "table": lambda *entries: entries,
    "pick": _entry,
    "knot": _entry,
    "is_finite": lambda a: not isinstance(a, arb) or bool(a.is_finite()),
    **comparisons(_greater, _equal),
    "and": _and,
    "or": lambda a, b: _not(a) if isinstance(a, arb) else _not(_and(_not(a), _not(b))),
    "xor": _xor,
    "not": _not,
}

_steps = {
    n: lambda a, n=n: not (isinstance(a, arb) and BALLS[n](a).is_exact())
    for n in ("floor", "ceil", "round", "away", "trunc")
}

#: Operations that accept an infinite argument.
LIMITS = {"select", "max", "min", "is_finite", "gt", "ge", "lt", "le", "eq", "ne", "pick", "knot"}

#: Whether an operation may jump while its arguments vary over the balls.
JUMPS: dict[str, Callable[..., bool]] = {
    **_steps,
    "sign": lambda a: not (a > 0 or a < 0 or a == 0),
    "real": lambda a: a is None,
    "atan2": _cut,
    **dict.fromkeys(("pick", "knot"), lambda table, place: not place.is_exact()),
    "rem": lambda a, b: not _stepwise(math.trunc)(_div(a, b)).is_exact(),
    **{n: (lambda a, b, n=n: BALLS[n](a, b) is None) for n in ("gt", "ge", "lt", "le", "eq", "ne")},
}
