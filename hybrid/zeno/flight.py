"""One flight between two impacts of a contact, by Taylor series.

The gap is a coordinate of its own (:mod:`hybrid.rules.flights`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..events import room, series_zeros
from ..lowering.lowered import ORDER
from ..lowering.taylor import polynomial
from ..rules import unit
from ..rules.flights import most_pieces
from ..rules.lengths import LAST_TERMS
from ..segment import Segment, from_powers, terms

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers
    from ..lowering import Field


#: Start, length, and the Taylor coefficients of each state element.
Piece = tuple[float, float, np.ndarray]


@attrs.frozen(eq=False)
class Flight:
    """A flight: its duration, final state and final gap speed (``u < 0``).

    ``pieces`` are ``(start, length, series of the states)``; a short flight has one. ``branch``
    holds the signs of the deciding functions at the start, then the numbers of those that change
    their sign, in order.
    """

    time: float
    x: list[float]
    u: float
    pieces: tuple[Piece, ...]
    branch: tuple[int, ...]

    def segments(self) -> list[Segment]:
        """The states along the flight as polynomials in local time."""
        return segments(self.pieces)


def segments(pieces: Sequence[Piece]) -> list[Segment]:
    """The states along the pieces of a flight as polynomials in local time."""
    powers = from_powers(ORDER)
    return [Segment(start, length, powers @ terms(c, length).T) for start, length, c in pieces]


def fly(field: Field, column: int, t: float, x: list[float], v: float) -> Flight | None:
    """The flight that leaves a contact with gap speed ``v > 0``.

    Returns None if the flow has no Taylor series, or a few of them do not reach the end of the
    flight: it is then long compared with the time scale of forces or gap, and the solver must
    integrate it. ``column`` is the index of the gap among the field's guards.
    """
    if field.jets is None:
        return None
    work, size = field.jets.room(ORDER), len(x)
    kinks = len(work.sides)
    most = most_pieces(kinks)
    starts, lengths, end = np.empty(most), np.empty(most), np.empty(size)
    series, branch = np.empty((most * size, ORDER + 1)), np.empty(kinks + most, dtype=np.int64)
    status, time, u, pieces, crossed = unit("flights").fly(
        *(field.jets.alone, 0, column, field.project is not None, t, np.array(x, dtype=float), v),
        *(starts, lengths, series, branch, end, *work[:6], np.empty(0, dtype=np.int64), 0.0),
        LAST_TERMS,
    )
    if status < 0:
        return None
    made = pieces_of(pieces, starts, lengths, series)
    return Flight(time, end.tolist(), u, made, tuple(branch[: kinks + crossed].tolist()))


def pieces_of(count: int, starts: Numbers, lengths: Numbers, series: Matrix) -> tuple[Piece, ...]:
    """The pieces of a flight, from the arrays that the rule has filled."""
    parts = np.split(series[: count * (len(series) // len(starts))].copy(), count)
    return tuple(zip(starts[:count].tolist(), lengths[:count].tolist(), parts, strict=True))


def rise(field: Field, column: int, t: float, x: list[float], v: float) -> float | None:
    """The largest gap of the flight that leaves a contact with gap speed ``v``.

    None if one Taylor series does not reach the end of the flight. The gap is a coordinate of its
    own, as in :func:`fly`.
    """
    if field.jets is None or field.kinks:
        return None
    try:
        series, values, _ = field.expand(t, x, [])
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    gap = [0.0, v, *values[column][2:]]
    end = falls(series, gap)
    if end is None:
        return None
    speeds = [k * c for k, c in enumerate(gap)][1:]
    tops = [s for s, direction in series_zeros(speeds, end, -1.0) if direction < 0]
    return max((polynomial(gap, s) for s in tops), default=None)


def falls(series: list[list[float]], gap: list[float], far: float = 1.0) -> float | None:
    """The first time at which a gap falls to zero; None if there is none.

    The search extends to ``far`` times the length over which the series of states and gap are
    exact.
    """
    c = np.array(series)
    zero = unit("lengths").falls(c, len(c), np.array(gap), far, *room(ORDER))
    return zero if zero < float("inf") else None
