"""Bounds over a box in doubles, rounded outwards: a quick look before the balls.

What is not known here, or may leave its domain or the range of a double, is left to the balls of
:mod:`hybrid.bounds.balls`.
"""

from __future__ import annotations

import math

from .arrays import Bounds, Matrix

__all__ = ("at_points", "ranges")

#: A product and a sum are never one operation, as each is rounded outwards by itself.
EXACT = True

#: Operations: a row of the box, a number; and those on bounds.
INPUT, NUMBER, ADD_BOUNDS, SUB_BOUNDS, NEG_BOUNDS, MUL_BOUNDS, SQUARE_BOUNDS = range(7)
DIV_BOUNDS, SQRT_BOUNDS, EXP_BOUNDS, SIN_BOUNDS, COS_BOUNDS, ABS_BOUNDS = range(7, 13)

#: What a function of the C library may be off, against its size: several spacings, where the usual
#: ones are off by one.
LIBRARY_ERROR = 2.0**-50

#: A little more than half of a float's relative spacing, and the smallest float: a float less these
#: is the next lower one.
HALF_SPACING, LEAST = 2.0**-53 * (1.0 + 2.0**-52), 2.0**-1074

#: Beyond this the exponential is more than a double can be; a quarter of a turn.
LARGEST, QUARTER = 709.782712893384, 0.5 * math.pi

#: Beyond this angle a sine is only known to be none beyond 1: rounding could hide a turn of it.
TURNS = 1e4


def ranges(b: Bounds, program: int, box: Matrix, found: Matrix) -> int:
    """Bounds of a program's operations, a row for each, over a box of such rows; -1 where they say
    nothing, else 0."""
    first = b.index[program, 0]
    for k in range(first, b.index[program, 1]):
        op, one, other = b.ops[k, 0], b.ops[k, 1], b.ops[k, 2]
        if op == INPUT:
            low, high = box[one, 0], box[one, 1]
        elif op == NUMBER:
            low, high = b.numbers[one], b.numbers[one]
        else:
            c = found[other]
            low, high = bounds(op, found[one, 0], found[one, 1], c[0], c[1])
        if not (-math.inf < low <= high < math.inf):
            return -1
        found[k - first, 0], found[k - first, 1] = low, high
    return 0


def at_points(b: Bounds, program: int, points: Matrix, count: int, found: Matrix) -> None:
    """Values of a program's operations at points, but for rounding; NaN where there is none.

    ``points`` has the rows of a box and, like ``found``, a column for each point.
    """
    first = b.index[program, 0]
    for k in range(first, b.index[program, 1]):
        op, one, other, own = b.ops[k, 0], b.ops[k, 1], b.ops[k, 2], found[k - first]
        if op == INPUT:
            for i in range(count):
                own[i] = points[one, i]
        elif op == NUMBER:
            for i in range(count):
                own[i] = b.numbers[one]
        elif op == MUL_BOUNDS:
            for i in range(count):
                own[i] = found[one, i] * found[other, i]
        elif op == ADD_BOUNDS:
            for i in range(count):
                own[i] = found[one, i] + found[other, i]
        else:
            for i in range(count):
                own[i] = valued(op, found[one, i], found[other, i])


def valued(op: int, a: float, c: float) -> float:
    """An operation on numbers; NaN where it has no value."""
    if op == SUB_BOUNDS:
        return a - c
    if op == NEG_BOUNDS:
        return -a
    if op == SQUARE_BOUNDS:
        return a * a
    if op == ABS_BOUNDS:
        return abs(a)
    if op == DIV_BOUNDS and c != 0.0:
        return a / c
    if op == SQRT_BOUNDS and a >= 0.0:
        return math.sqrt(a)
    if op == EXP_BOUNDS and a < LARGEST:
        return math.exp(a)
    if op == SIN_BOUNDS and abs(a) <= TURNS:
        return math.sin(a)
    if op == COS_BOUNDS and abs(a) <= TURNS:
        return math.cos(a)
    return math.nan


def bounds(op: int, a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Bounds of an operation on ``[a, b]`` and ``[c, d]``; NaN where nothing is said."""
    if op == ADD_BOUNDS:
        return outwards(a + c, b + d)
    if op == SUB_BOUNDS:
        return outwards(a - d, b - c)
    if op == NEG_BOUNDS:
        return -b, -a
    if op == MUL_BOUNDS:
        return products(a * c, a * d, b * c, b * d)
    if op == SQUARE_BOUNDS:
        low, high = outwards(min(a * a, b * b), max(a * a, b * b))
        return (0.0 if a <= 0.0 <= b else low), high
    if op == ABS_BOUNDS:
        return (0.0 if a <= 0.0 <= b else min(abs(a), abs(b))), max(abs(a), abs(b))
    if op == DIV_BOUNDS and not c <= 0.0 <= d:
        return products(a / c, a / d, b / c, b / d)
    if op == SQRT_BOUNDS and a >= 0.0:
        return outwards(math.sqrt(a), math.sqrt(b))
    if op == EXP_BOUNDS and b < LARGEST:
        return outwards(math.exp(a) * (1.0 - LIBRARY_ERROR), math.exp(b) * (1.0 + LIBRARY_ERROR))
    if op in (SIN_BOUNDS, COS_BOUNDS) and not max(-a, b) <= TURNS:
        return -1.0, 1.0
    if op == SIN_BOUNDS:
        return wave(math.sin(a), math.sin(b), half_turns(a - QUARTER), half_turns(b - QUARTER))
    if op == COS_BOUNDS:
        return wave(math.cos(a), math.cos(b), half_turns(a), half_turns(b))
    return math.nan, math.nan


def outwards(low: float, high: float) -> tuple[float, float]:
    """Bounds that have been rounded, whatever way, moved on by one float each (two next to the
    smallest normal one), without a call (Rump, Zimmermann, Boldo and Melquiond, "Computing
    predecessor and successor in rounding to nearest", BIT 49, 2009)."""
    down, up = HALF_SPACING * abs(low) + LEAST, HALF_SPACING * abs(high) + LEAST
    return low - down, high + up


def products(p: float, q: float, r: float, s: float) -> tuple[float, float]:
    """Bounds of what is least and greatest at the corners of two intervals."""
    return outwards(min(min(p, q), min(r, s)), max(max(p, q), max(r, s)))


def half_turns(angle: float) -> int:
    """Half turns from a wave's greatest value on."""
    return math.floor(angle / math.pi)


def wave(one: float, other: float, before: int, after: int) -> tuple[float, float]:
    """Bounds of a sine with these values at the ends, and so many half turns from its greatest
    value on before each."""
    low, high = min(one, other), max(one, other)
    if after > before:
        low, high = (-1.0, high) if after % 2 == 1 else (low, 1.0)
    if after > before + 1:
        low, high = -1.0, 1.0
    return low - LIBRARY_ERROR, high + LIBRARY_ERROR
