"""Bounds over a box in doubles, rounded outwards: a quick look before the balls of :mod:`.balls`.

What is not known here, or may leave its domain or the range of a double, is left to the balls.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, floor, inf, nextafter, pi, sin, sqrt

Range = tuple[float, float]

#: What a function of the C library may be off, against its size: several spacings, where the usual
#: ones are off by one.
OFF = 2.0**-50

#: Beyond this angle its rounding could hide a turn of the sine.
TURNS = 1e4


def unknown(*arguments: Range) -> None:
    """Nothing is said."""


def _outwards(low: float, high: float) -> Range:
    return nextafter(low, -inf), nextafter(high, inf)


def _mul(a: Range, b: Range) -> Range:
    products = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    return _outwards(min(products), max(products))


def _square(a: Range) -> Range:
    ends = a[0] * a[0], a[1] * a[1]
    low, high = _outwards(min(ends), max(ends))
    return (0.0 if a[0] <= 0.0 <= a[1] else low), high


def _div(a: Range, b: Range) -> Range | None:
    if b[0] <= 0.0 <= b[1]:
        return None
    quotients = a[0] / b[0], a[0] / b[1], a[1] / b[0], a[1] / b[1]
    return _outwards(min(quotients), max(quotients))


def _wave(function: Callable[[float], float], top: float) -> Callable[[Range], Range | None]:
    """A sine that is greatest at ``top``, and every turn from there; least half a turn on."""

    def apply(a: Range) -> Range | None:
        if max(-a[0], a[1]) > TURNS:
            return None
        before, after = (floor((end - top) / pi) for end in a)
        ends = [function(a[0]), function(a[1])]
        if after > before:
            ends += [-1.0 if after % 2 else 1.0]
        if after > before + 1:
            ends += [-1.0, 1.0]
        return min(ends) - OFF, max(ends) + OFF

    return apply


def _exp(a: Range) -> Range:
    return _outwards(exp(a[0]) * (1.0 - OFF), exp(a[1]) * (1.0 + OFF))


#: Operations on bounds; None where nothing is said.
RANGES: dict[str, Callable[..., Range | None]] = {
    "add": lambda a, b: _outwards(a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: _outwards(a[0] - b[1], a[1] - b[0]),
    "neg": lambda a: (-a[1], -a[0]),
    "mul": _mul,
    "square": _square,
    "div": _div,
    "sqrt": lambda a: _outwards(sqrt(a[0]), sqrt(a[1])) if a[0] >= 0.0 else None,
    "exp": _exp,
    "sin": _wave(sin, 0.5 * pi),
    "cos": _wave(cos, 0.0),
}
