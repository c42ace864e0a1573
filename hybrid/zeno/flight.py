"""One flight between two impacts of a contact, from Taylor series.

The gap is carried as a coordinate of its own: it starts at exactly zero with the speed
that the impact gave it, and only its higher coefficients come from the state. So a flight
of height 1e-18 over a wall at 2 is as accurate as any other (``docs/notes/chatter.md``).
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..scene.taylor import polynomial, polynomial_and_slope, slope
from ..segment import Segment, from_powers
from ..solvers.taylor_backend import first_kink, follows, step_length

if TYPE_CHECKING:
    from ..scene import Field

#: Most Taylor steps in a flight (kinks apart); a longer flight belongs to the solver.
PIECES = 8


@attrs.frozen
class Flight:
    """A flight: how long, where it ends, and with which gap speed (``u < 0``).

    ``pieces`` are ``(start, length, series of the states)``; one where the flight is short.
    ``branch`` says on which sides of its kinks it began and which it crossed, in order.
    """

    time: float
    x: list[float]
    u: float
    pieces: tuple[tuple[float, float, list[list[float]]], ...]
    branch: tuple[int, ...]

    def segments(self) -> list[Segment]:
        """The states along the flight."""
        return [_segment(*piece) for piece in self.pieces]


def _segment(start: float, length: float, series: list[list[float]]) -> Segment:
    powers = np.array(series)
    degree = powers.shape[1] - 1
    scaled = powers * length ** np.arange(degree + 1)
    return Segment(start, length, from_powers(degree) @ scaled.T)


def fly(field: Field, column: int, t: float, x: list[float], v: float) -> Flight | None:
    """The flight that leaves a contact with gap speed ``v > 0``.

    Returns None where a few series do not reach its end: the flight is long against the
    time in which the forces change, and belongs to the solver.
    """
    if field.jets is None:
        return None
    start, gap, speed = 0.0, 0.0, v
    sides = [0] * field.kinks
    pieces: list[tuple[float, float, list[list[float]]]] = []
    while len(pieces) <= PIECES + 2 * field.kinks:
        try:
            series, values, kinks = field.expand(t + start, x, sides)
        except (ValueError, OverflowError, ZeroDivisionError):
            return None
        if not pieces:
            branch = [1 if (side or c[0]) > 0 else -1 for side, c in zip(sides, kinks, strict=True)]
        g = values[column]
        g[0], g[1] = gap, speed
        reach = step_length(series)
        zero = zero_of(g, reach)
        length = reach if zero is None else zero
        length, crossed = first_kink(kinks, length, sides) if kinks else (length, None)
        if not 0 < length < float("inf"):
            return None
        if not follows(field, t + start, series, length, crossed is not None):
            return None
        pieces.append((start, length, series))
        x = [polynomial(c, length) for c in series]
        start, gap, speed = start + length, polynomial(g, length), slope(g, length)
        if length == zero:
            flight = Flight(start, x, speed, tuple(pieces), tuple(branch))
            return flight if speed < 0 else None
        sides = [0] * field.kinks
        if crossed is not None:
            branch.append(crossed)
            sides[crossed] = -1 if slope(kinks[crossed], length) < 0 else 1
    return None


def rise(field: Field, column: int, t: float, x: list[float], v: float) -> float | None:
    """How far the gap opens after it was left with speed ``v``; None where one series is too short.

    The gap is a coordinate of its own, as in :func:`fly`.
    """
    if field.jets is None or field.kinks:
        return None
    try:
        series, values, _ = field.expand(t, x, [])
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    gap = [0.0, v, *values[column][2:]]
    end = zero_of(gap, step_length(series))
    if end is None:
        return None
    speeds, s = [k * c for k, c in enumerate(gap)][1:], 0.5 * end
    for _ in range(6):
        speed, rate = polynomial_and_slope(speeds, s)
        s = min(max(s - speed / rate, 0.0), end) if rate < 0 else s
    return polynomial(gap, s)


def zero_of(g: list[float], reach: float) -> float | None:
    """First zero in ``(0, reach]`` of a gap's series that rises, then falls.

    A quadratic start and Newton's method; the zero at the start, if the series begins with
    0, is divided out.
    """
    c0, c1, c2 = g[0], g[1], g[2]
    if not c2 < 0 or c0 < 0:
        return None
    s = (-c1 - sqrt(max(c1 * c1 - 4.0 * c0 * c2, 0.0))) / (2.0 * c2)
    if not 0 < s <= 2.0 * reach:
        return None
    shifted = g[1:] if c0 == 0.0 else g
    for _ in range(12):
        value, rate = polynomial_and_slope(shifted, s)
        if not rate < 0:
            return None
        step = value / rate
        s -= step
        if abs(step) <= 4e-16 * s:
            break
        if not 0 < s < float("inf"):
            return None
    return s if s <= reach and abs(step) <= 1e-14 * s else None
