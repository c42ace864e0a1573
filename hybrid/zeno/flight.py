"""One flight between two impacts of a contact, from Taylor series.

The gap is carried as a coordinate of its own: it starts at exactly zero with the speed
that the impact gave it, and only its higher coefficients come from the state. So a flight
of height 1e-18 over a wall at 2 is as accurate as any other (``docs/notes/chatter.md``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..events import EPS, first_zero, series_zeros
from ..scene.taylor import polynomial, slope
from ..segment import Segment, from_powers
from ..solvers.kinks import crossed_to, first_change, holding, own_length
from ..solvers.taylor_backend import BEFORE, MIDDLE, MISSED, ROUNDING, beside, follows, step_length

if TYPE_CHECKING:
    from ..scene import Field, Guard

#: Most Taylor steps in a flight (kinks apart); a longer flight belongs to the solver. Over a wall
#: that shakes a step is a tenth of a turn, and low flights last a few turns.
PIECES = 32

#: Rounding of a gap's series, in spacings of its terms: as many as it has.
ROUNDED = 16.0


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
    time in which the forces or the gap change, and belongs to the solver.
    """
    if field.jets is None:
        return None
    start, gap, speed = 0.0, 0.0, v
    sides = [0] * field.kinks
    pieces: list[tuple[float, float, list[list[float]]]] = []
    while len(pieces) <= PIECES + 2 * field.kinks:
        try:
            series, values, watched = field.expand(t + start, x, sides)
        except (ValueError, OverflowError, ZeroDivisionError):
            return None
        if not pieces:
            branch = [
                1 if (side or c[0]) > 0 else -1 for side, c in zip(sides, watched, strict=True)
            ]
        g = values[column]
        g[0], g[1] = gap, speed
        reach = min(step_length(series), own_length(g, ROUNDING), holding(field.watched, watched))
        zero = zero_of(g, reach)
        length, crossed = reach if zero is None else zero, None
        if not 0 < length < float("inf"):
            return None
        if watched:
            length, crossed = first_change(field.watched, watched, t + start, length, sides)
        kink = crossed is not None
        if not follows(field, t + start, series, watched, length, kink):
            return None
        if not _gap_follows(field.guards[column], t + start, series, g, length, kink):
            return None
        pieces.append((start, length, series))
        x = [polynomial(c, length) for c in series]
        start, gap, speed = start + length, polynomial(g, length), slope(g, length)
        if length == zero:
            flight = Flight(start, x, speed, tuple(pieces), tuple(branch))
            return flight if speed < 0 else None
        after = [0] * field.kinks
        if crossed is not None:
            branch.append(crossed)
            after[crossed] = crossed_to(watched[crossed], sides[crossed])
        sides = after
    return None


def _gap_follows(
    guard: Guard, t: float, series: list[list[float]], g: list[float], h: float, kink: bool
) -> bool:
    """Whether a gap's series has the gap's acceleration along a flight, but for rounding.

    Its height says nothing of it: that is less than the rounding of the state. The series of a gap
    that is a sum of states are those of the states.
    """
    if guard.affine:
        return True
    forces = [k * (k - 1) * c for k, c in enumerate(g)][2:]
    for share in (MIDDLE, BEFORE if kink else 1.0):
        s = share * h
        x = [polynomial(c, s) for c in series]
        force, other = guard.lie(t + s, x)[2], guard.lie(*beside(t + s, x))[2]
        allowed = MISSED * EPS * polynomial([*map(abs, forces)], s) + 8 * abs(force - other)
        if abs(force - polynomial(forces, s)) > allowed:
            return False
    return True


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
    end = zero_of(gap, min(step_length(series), own_length(gap, ROUNDING)))
    if end is None:
        return None
    speeds = [k * c for k, c in enumerate(gap)][1:]
    tops = [s for s, direction in series_zeros(speeds, end, -1.0) if direction < 0]
    return max((polynomial(gap, s) for s in tops), default=None)


def zero_of(g: list[float], reach: float) -> float | None:
    """First zero in ``(0, reach]`` at which a gap's series falls, by more than rounding.

    The zero at the start, if the series begins with 0, is divided out.
    """
    return None if g[0] < 0 else first_zero(g, reach, 1 if g[0] == 0.0 else 0, -1, ROUNDED)
