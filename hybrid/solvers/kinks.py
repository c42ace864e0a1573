"""How far the series of a step hold, where the formula of the flow may change on the way.

A kink is a function with a series of its own, at whose zero another branch of the flow begins.
Its zeros are counted as those of a guard (:mod:`hybrid.events`), within the length over which its
own series has converged. A zero that rounding hides or blurs from afar, at the edges of a thin
zone, is approached first and looked for again from nearby.

A function that is flat to rounding (``exp`` of a large negative number) says nothing of the
pulse that its argument leads to. So the argument is watched as a kink is where the function is
flat, and changes by little in a step where it is not. A denominator changes by no more than itself:
so far there is no pole, not beside the axis of time either, where a quotient is a pulse.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..events import EPS, series_zeros
from ..scene.lowered import ORDER
from ..scene.tape import Watched
from ..scene.taylor import polynomial, slope

#: Size, relative to the largest, of the last terms of a kink's series over which it may be used:
#: what they leave open is counted as rounding is.
CONVERGED = 1e-3

#: By how much the argument of a step function may change in a step: the whole number next to it
#: is then the only one passed; and that of ``exp``: up to its order the last terms of its series
#: are as large as all that follow, and half of that leaves room for a square.
HALF, CHANGE = 0.5, ORDER / 2

#: Rounding of a kink's polynomial in Bernstein form, as a multiple of the sum of its terms.
BLURRED = 16 * EPS

#: Share of the way to a zero that is blurred which is made before it is looked for again.
APPROACH = 0.9

#: Share of the way to a zero on which it is asked whether another is hidden.
BEFORE = 0.999

#: A zero is as exact as the time is if it is off by no more than so many of its roundings.
EXACT = 16.0

#: Where a function comes near zero and rounding hides whether it passes, what is hidden is narrower
#: than 1e-7 of the way there: nearer than this share of the time nothing is left of it.
HIDDEN = 1e-9


def own_length(c: Sequence[float], share: float) -> float:
    """Length at which the last two terms fall to a share of the largest."""
    length = float("inf")
    for last in (ORDER - 1, ORDER):
        if c[last]:
            each = [(k, share * abs(c[k] / c[last])) for k in range(ORDER - 1) if c[k]]
            reach = max([size ** (1.0 / (last - k)) for k, size in each], default=length)
            length = min(length, reach)
    return length


def holding(watched: Sequence[Watched], series: Sequence[Sequence[float]]) -> float:
    """Length over which the series of what is watched have converged, and change by little."""
    length = float("inf")
    for what, c in zip(watched, series, strict=True):
        length = min(length, own_length(c, CONVERGED))
        if what.kind == "step":
            length = _changing(c, length, HALF)
        elif what.kind == "pole":
            length = _changing(c, length, abs(c[0]))
        elif what.kind == "band" and what.low - CHANGE < c[0] < what.high + CHANGE:
            length = _changing(c, length, CHANGE)
    return length


def _changing(c: Sequence[float], length: float, most: float) -> float:
    """The length, or the shorter one in which a series cannot change by more than ``most``."""
    sizes = [0.0, *map(abs, c[1:])]
    if not any(sizes):
        return length
    bound = min((most / v) ** (1.0 / k) for k, v in enumerate(sizes) if v)
    length = min(length, bound)
    while polynomial(sizes, length) > most:
        length *= 0.9
    return length


def first_change(
    watched: Sequence[Watched],
    series: Sequence[Sequence[float]],
    t: float,
    h: float,
    sides: Sequence[int],
) -> tuple[float, int | None]:
    """How far a step may go on the branch on which it begins, and the kink that ends it.

    None: no kink is reached there, though one may be near.
    """
    chosen = None
    for index, (what, c) in enumerate(zip(watched, series, strict=True)):
        if what.kind == "pole":
            continue
        level = _level(what, c[0])
        if level is None:
            continue
        p = [c[0] - level, *c[1:]] if level else c
        zero, reached = _first_zero(p, t, h, sides[index])
        if zero is not None and zero < h:
            h, chosen = zero, index if reached and what.switches else None
    return h, chosen


def _level(what: Watched, value: float) -> float | None:
    """The value at which what is watched changes something; None if it is not ahead."""
    if what.kind != "band":
        return 0.0
    if value <= what.low - CHANGE:
        return what.low
    return what.high if value >= what.high + CHANGE else None


def _first_zero(c: Sequence[float], t: float, h: float, side: int) -> tuple[float | None, bool]:
    """The first zero of a series in ``(0, h]`` at which it leaves its side, and whether it is that.

    With ``side`` known the series is zero at 0, and that zero is divided out. False: a point on the
    way to where rounding hides or blurs a zero.
    """
    p = c[1:] if side else c
    rest = polynomial([0.0, *map(abs, p[1:])], h)
    if abs(p[0]) > rest * (1.0 + BLURRED) + left_open(p, h) or not rest:
        return None, False
    own = side or (1 if p[0] > 0 else -1)
    zeros = _zeros(p, own, h)
    crossing = next((s for s, crosses in zeros if crosses), None)
    if crossing is not None and own * p[0] > 0:
        zeros = _zeros(p, own, BEFORE * crossing)
    hidden = next((s for s, _ in zeros if not _close(s, t)), crossing)
    if hidden is None:
        return None, False
    if hidden != crossing:
        return APPROACH * hidden, False
    off = EPS * polynomial([*map(abs, p)], crossing) + left_open(p, crossing)
    exact = off <= EXACT * EPS * max(abs(t), crossing) * abs(slope(p, crossing))
    return (crossing, True) if exact or _close(crossing, t) else (APPROACH * crossing, False)


def _close(s: float, t: float) -> bool:
    """Whether nothing is hidden at a distance of time."""
    return (1.0 - APPROACH) * s <= HIDDEN * max(abs(t), s)


def _zeros(p: Sequence[float], own: int, h: float) -> list[tuple[float, bool]]:
    """Where a series of sign ``own`` comes to zero in ``(0, h]``, and whether it crosses there.

    It does not where it comes so near that rounding hides what it does.
    """
    noise = BLURRED * polynomial([*map(abs, p)], h) + left_open(p, h)
    zeros = series_zeros([own * v for v in p], h, noise)
    return [(s, direction < 0) for s, direction in zeros if direction <= 0]


def left_open(c: Sequence[float], s: float) -> float:
    """What is left of a series behind its last terms, by their size: they fall."""
    return (abs(c[-2]) + abs(c[-1]) * s) * s ** (len(c) - 2)


def crossed_to(c: Sequence[float], side: int) -> int:
    """The side of a kink that follows a zero at which it has left its own."""
    return -side if side else (-1 if c[0] > 0 else 1)
