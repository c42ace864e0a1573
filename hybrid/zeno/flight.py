"""One flight between two impacts of a contact, by Taylor series.

The gap is a coordinate of its own (:mod:`hybrid.rules.flights`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..events import room, series_zeros
from ..lowering.lowered import ORDER
from ..lowering.tape import lent
from ..lowering.tape import room as room_for
from ..lowering.taylor import polynomial
from ..rules import unit
from ..rules.arrays import Sums
from ..rules.flights import most_pieces
from ..rules.lengths import LAST_TERMS, LOW_ORDER
from ..rules.sums import (
    BRANCH,
    FIT,
    FORCE_SAMPLES,
    GRID,
    HIGH_ORDER,
    LAST_POINT,
    MOST_DEGREE,
    SUM_LINES,
)
from ..segment import Segment, from_powers, terms

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers
    from ..lowering import Field


#: Start, length, and the Taylor coefficients of each state element.
Piece = tuple[float, float, np.ndarray]

#: No guards are looked at.
NO_SIGNS = np.empty(0, dtype=np.int64)


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
    needs, free = field.jets.tape.needs, field.once("rooms for flights", dict[Any, Any])
    with lent(free, "flight", lambda: room_for_sums(needs, len(x))) as sums:
        status, time, u, pieces, crossed = unit("flights").fly(
            *(field.jets.alone, 0, column, field.project is not None, t),
            *(np.array(x, dtype=float), v, sums.c, sums.series, NO_SIGNS, 0.0, LAST_TERMS, sums),
        )
        if status < 0:
            return None
        made = pieces_of(pieces, sums.starts, sums.lengths, sums.series)
        branch = tuple(sums.branch[: len(sums.sides) + crossed].tolist())
        return Flight(time, sums.end.tolist(), u, made, branch)


def room_for_sums(needs: Sequence[int], n: int) -> Sums:
    """Work arrays for sums over ``n`` states, for programs within the sizes ``needs``."""
    work, points = room_for(needs, n, HIGH_ORDER), MOST_DEGREE + 1
    kinks = len(work.sides)
    most = most_pieces(kinks)
    return Sums(
        lines=np.zeros((SUM_LINES, n + 2)),
        small=np.zeros((FIT + FORCE_SAMPLES, points)),
        times=np.zeros(GRID + LAST_POINT + 1),
        ints=np.zeros(BRANCH + kinks + most, dtype=np.int64),
        high=work.c,
        low=np.empty((len(work.c), LOW_ORDER + 1)),
        short=work,
        starts=np.zeros(most),
        lengths=np.zeros(most),
        series=np.zeros((n * most, ORDER + 1)),
        branch=np.zeros(kinks + most, dtype=np.int64),
        end=np.zeros(n),
        c=np.empty((len(work.c), ORDER + 1)),
        aside=work.aside,
        work=work.work,
        rows=work.rows,
        found=work.found,
        sides=work.sides,
    )


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
