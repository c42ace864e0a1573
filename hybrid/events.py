"""Event location: crossings and tangencies of a guard along one step.

Along a step a guard is a function of one variable. It is sampled on the step's polynomial and
converted to Bernstein coefficients, whose zeros :mod:`hybrid.rules.zeros` finds. Two crossings
within one step are therefore both found. A guard that is zero at the start of the step by
construction (after a jump or a release) is divided by the power of the local time by which it
vanishes, so its next zero is found however close it is.

The semantics are in ``docs/semantics.md``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from functools import cache
from itertools import zip_longest
from math import comb
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from .automaton.markers import Crossing
from .errors import FlowError
from .lowering import Guard
from .rules import unit
from .rules.zeros import EPS, SPARE_ROWS, UNFIT, WORK_FULL
from .segment import Segment, from_values, nodes

if TYPE_CHECKING:
    from .automaton.shapes import Matrix, Numbers
    from .lowering import Kink

#: Degree at which a guard that is not a polynomial is sampled, piece by piece.
SAMPLED = 12

#: Least number of pieces per run in which such a guard is sampled.
SHARES = 100

#: Pieces are halved until the last coefficients are this small relative to the largest.
RESOLVED = 1e-6

#: Most initial pieces, and most successive halvings of one.
GUARD_PIECES, DEPTH = 4096, 12

#: Most halvings per step. Resolving a narrow feature takes DEPTH of them; a guard that is resolved
#: nowhere is dominated by rounding, and further halving shows no more.
GUARD_HALVINGS = 128

#: A deciding function crosses if it keeps its new sign within this fraction of the step around its
#: zero; otherwise it touches. Far above rounding, far below the resolution of a step.
WIDEST = 1e-4

#: Rounding of a deciding function that rests on zero: by how much of itself each number of which it
#: is made may be off, as a sum of some terms is.
MOVED_BY = 8.0 * EPS

#: The least length of a step, as a share of the time, along which a deciding function may rest.
RESTS_FOR = 1e-9

#: A guard that becomes undefined (``sqrt`` at 0) counts as zero there if it is this small relative
#: to its largest value. Rounding resolves places 1e-16 from the end, where even a fourth root is
#: 1e-4.
DOMAIN_END = 1e-4

#: Impacts at one time after which a run is taken to be in an infinite loop; bodies in contact may
#: strike each other many times while they slow down.
STRUCK = 10_000

#: Fractions of the interval from its start to a zero at which a guard is checked for having left
#: zero.
SHARES_OF_FLIGHT = np.array([0.25, 0.5, 0.75])


@attrs.frozen
class Cut:
    """A place along a step at which a guard changes its formula (see :class:`.field.Kink`).

    Attributes
    ----------
    before, after : float
        Fractions of the step just before and after it, as close as rounding permits; ``before`` is
        negative if the step begins on it.
    side : int
        Sign of the deciding function after it.
    """

    kink: Kink
    before: float
    after: float
    side: int


@attrs.frozen
class Zero:
    """A zero of a guard along a step.

    Attributes
    ----------
    tau : float
        Local time in the arc.
    direction : int
        ``-1`` falling, ``+1`` rising, ``0`` touching without crossing.
    cut : Cut or None
        Set if the guard jumps here, or becomes undefined, rather than passing through zero. With
        direction 0 it may not have changed sign.
    """

    tau: float
    direction: int
    cut: Cut | None = None


def zeros(
    guard: Guard,
    segment: Segment,
    t0: float,
    order: int,
    scale: float,
    tolerance: float,
    ends: dict[Any, float],
    noise: float = 0.0,
) -> Iterator[Zero]:
    """Zeros of a guard in ``(start, end]`` of a step, in order of time.

    Parameters
    ----------
    order : int
        Power of the local time by which the guard is known to vanish at the start.
    scale : float
        A time over which a non-polynomial guard is smooth.
    tolerance : float
        An extremum within this distance of zero is a tangency.
    ends : dict
        For each edge the guard's value at the end of the last step, from which this step continues
        so that no sign change is lost between steps; and its largest size so far in the arc, as it
        cannot touch zero before it has left it. Updated in place.
    noise : float
        Rounding of a guard that was zero at the start of the arc: it does not cross zero before it
        has exceeded this.
    """
    places: list[Cut] = []
    for kink in guard.kinks:
        places = among(places, cuts(kink, segment, t0, scale, ends, 0.0, places))
    yield from _between(guard, segment, t0, order, scale, tolerance, ends, places, noise)


def moving(
    kinks: Iterable[Kink], segment: Segment, t0: float, ends: dict[Any, float]
) -> Iterator[Kink]:
    """The deciding functions that have zeros along a step to be looked for.

    One that rests on zero has none: its signs are rounding. Where they choose the formula of
    another, that is looked at with the formula of one side. ``ends`` forgets it, as its signs may
    have been of the other side.
    """
    resting: list[Any] = []
    for kink in kinks:
        own = kink.beside(resting)
        if own is not kink:
            ends.pop(kink.edge, None)
        if rests(own, segment, t0):
            resting.append(kink.edge)
        else:
            yield own


def rests(kink: Kink, segment: Segment, t0: float) -> bool:
    """Whether a deciding function is nowhere along a step further from zero than by rounding; in a
    step so short that it may go through zero there, it does not rest."""
    if segment.length <= RESTS_FOR * abs(t0 + segment.end):
        return False
    places = [(t0 + tau, segment(tau).tolist()) for tau in (segment.end, segment.start)]
    blur = 0.0
    for t, x in places:
        blur = max(blur, blurs(kink, t, x))
        if not abs(kink.value(t, x)) <= blur:
            return False
    between = segment.start + segment.length * nodes(SAMPLED)[1:-1]
    return all(abs(kink.value(t0 + tau, segment(tau).tolist())) <= blur for tau in between.tolist())


def blurs(kink: Kink, t: float, x: list[float]) -> float:
    """What some roundings of the time and of the state make of a deciding function. Over a place at
    which it jumps they lead one way only."""
    here, total = kink.value(t, x), 0.0
    for i in (-1, *kink.uses):
        apart = []
        for share in (1.0 - MOVED_BY, 1.0 + MOVED_BY):
            there = [v * share if j == i else v for j, v in enumerate(x)]
            apart.append(abs(kink.value(t * share if i < 0 else t, there) - here))
        total += min(apart)
    return total


def cuts(
    kink: Kink,
    segment: Segment,
    t0: float,
    scale: float,
    ends: dict[Any, float],
    tolerance: float = 0.0,
    others: Sequence[Cut] = (),
) -> Iterator[Cut]:
    """Where a deciding function changes sign, from start to end of a step.

    ``others``: places at which its own formula may change.
    """
    first = kink.value(t0 + segment.start, segment(segment.start).tolist())
    if first == 0.0 and not ends.get(kink.edge):
        cut = _straddle(kink, segment, t0, 0.0, 0)
        if cut is not None:
            yield cut
    for zero in _between(kink, segment, t0, 0, scale, tolerance, ends, others):
        if zero.direction and zero.cut is None:
            share = (zero.tau - segment.start) / segment.length
            cut = _straddle(kink, segment, t0, share, zero.direction)
            if cut is not None:
                yield cut


def _straddle(kink: Kink, segment: Segment, t0: float, share: float, side: int) -> Cut | None:
    """The cut at a zero of a deciding function; None if its sign does not change.

    ``side`` 0: the zero is at the start of the arc, and its side is the sign just after.
    """

    def sign(fraction: float) -> float:
        tau = segment.start + fraction * segment.length
        value = kink.value(t0 + tau, segment(tau).tolist())
        return float(np.sign(value))

    width = _rounding(segment, t0)
    widest = max(WIDEST, 64 * width)
    while width < widest:
        before, after = share - width, share + width
        there = sign(after)
        left = before <= 0 or sign(before) == -side
        if left and there and (not side or there == side):
            # doubled: a deciding wave (of floor) has a rounded zero
            return Cut(kink, min(before - width, share), after + width, int(there))
        width *= 2.0
    return None


def _rounding(segment: Segment, t0: float) -> float:
    """The rounding of the time at the end of a step, as a fraction of the step."""
    return float(np.spacing(abs(t0) + segment.end)) / segment.length + EPS


def _wider(cut: Cut) -> Cut:
    """A cut at which a guard jumps, widened by rounding.

    ``floor(t / T)``, for example, changes near the zero of ``sin(pi t / T)``, up to the rounding of
    a quotient, a product and a sine.
    """
    width = 2.0 * (cut.after - cut.before) if cut.kink.change == "jumps" else 0.0
    return attrs.evolve(cut, before=cut.before - width, after=cut.after + width)


def among(places: Iterable[Cut], new: Iterable[Cut]) -> list[Cut]:
    """Old and new cuts in order; overlapping ones are merged into the first."""
    kept: list[Cut] = []
    for cut in sorted([*places, *map(_wider, new)], key=lambda cut: cut.before):
        if kept and cut.before <= kept[-1].after:
            kept[-1] = attrs.evolve(kept[-1], after=max(kept[-1].after, cut.after))
        else:
            kept.append(cut)
    return kept


def _between(
    guard: Guard | Kink,
    segment: Segment,
    t0: float,
    order: int,
    scale: float,
    tolerance: float,
    ends: dict[Any, float],
    cuts: Sequence[Cut],
    noise: float = 0.0,
) -> Iterator[Zero]:
    """Zeros between the cuts, and sign changes of a guard that jumps at them."""
    polynomial = guard.affine and segment.degree <= SAMPLED
    if polynomial:
        degree, pieces = max(segment.degree, order, 1), 1
    else:
        degree, pieces = SAMPLED, max(1, int(np.ceil(min(segment.length / scale, GUARD_PIECES))))
    depth = 0 if polynomial else DEPTH
    piece = _Piece(guard, segment, t0, degree, tolerance, ends, noise, not cuts)
    for cut, left, right in _spans(pieces, cuts):
        starts = left == 0.0 or (cut is not None and cut.before <= 0 and guard.edge not in ends)
        if cut is not None and not starts:
            yield Zero(segment.start + left * segment.length, piece.over(cut), cut)
        if left < right:
            for fraction, direction in piece.zeros(left, right, order if starts else 0, depth):
                yield Zero(segment.start + fraction * segment.length, direction)


def _spans(pieces: int, cuts: Sequence[Cut]) -> Iterator[tuple[Cut | None, float, float]]:
    """Parts of a step between piece ends and cuts, each with the cut before it, if any."""
    bounds = [k / pieces for k in range(1, pieces + 1)]
    left: float = 0.0
    pending: Cut | None = None
    for cut in [*cuts, None]:
        stop = 1.0 if cut is None else cut.before
        for right in [*(b for b in bounds if left < b < stop), stop]:
            if pending is not None or left < right:
                yield pending, left, right
            pending, left = None, max(left, right)
        if cut is not None:
            pending, left = cut, cut.after


@attrs.define
class _Piece:
    """A step along which a guard is sampled part by part; ``halvings`` counts those left."""

    guard: Guard | Kink
    segment: Segment
    t0: float
    degree: int
    tolerance: float
    ends: dict[Any, float]
    noise: float
    whole: bool
    halvings: int = GUARD_HALVINGS

    def over(self, cut: Cut) -> int:
        """The direction in which a guard passes zero at a cut; 0 if it does not.

        A corner on zero, and a guard that stays zero from there on, count as reaching zero. This is
        judged up to rounding, which includes the guard's change over the width of the cut.
        """
        edge, seen = self.guard.edge, ("largest", self.guard.edge)
        old, new = self.ends[edge], self.at(cut.after)
        if old == 0.0 and cut.before <= 0.0:  # the last step ended on the cut
            old = self.at(cut.before)
        self.ends[edge] = new
        largest = max(abs(old), self.ends.get(seen, 0.0))
        self.ends[seen] = max(largest, abs(new)) if np.isfinite(new) else largest
        if old == 0.0:
            return 0
        if np.isfinite(new) and np.sign(new) == np.sign(old):
            width = cut.after - cut.before
            moved = abs(new - self.at(cut.after + width))
            least = abs(new) - moved
            if cut.before > 0:
                moved = abs(old - self.at(cut.before - width))
            least = min(least, abs(old) - moved)  # for a step that begins beyond the cut
            return -int(np.sign(old)) if least <= 64 * EPS * largest else 0
        if not np.isfinite(new) and abs(old) > DOMAIN_END * largest:
            raise FlowError(f"the guard of {edge} ends before it is zero: beyond it is not finite")
        return -int(np.sign(old))

    def at(self, fraction: float) -> float:
        """The guard at a fraction of the step."""
        tau = self.segment.start + fraction * self.segment.length
        return self.guard.value(self.t0 + tau, self.segment(tau).tolist())

    def zeros(
        self, left: float, right: float, order: int, depth: int
    ) -> Iterator[tuple[float, int]]:
        """Zeros between two fractions of the step, halved until the guard is resolved."""
        width = right - left
        fractions = left + width * nodes(self.degree)
        values = self.sample(fractions)
        last = float(values[-1])
        jumps = isinstance(self.guard, Guard) and self.guard.jumps
        if jumps and not self.resolved(values):
            values = self.beside_jumps(left, right, values)
            last = float(values[-1]) if values[-1] * last < 0.0 else last
        if depth and self.halvings and not self.resolved(values):
            self.halvings -= 1
            middle = 0.5 * (left + right)
            yield from self.zeros(left, middle, order, depth - 1)
            yield from self.zeros(middle, right, 0, depth - 1)
            return
        edge, seen = self.guard.edge, ("largest", self.guard.edge)
        came = self.ends.get(edge, values[0])
        if not (jumps and came * values[0] > 0.0):  # over a jump on one side no polynomial leads
            values[0] = came
        bernstein = to_bernstein(self.degree) @ values
        bernstein[0], bernstein[-1] = values[0], values[-1]
        before = max(self.ends.get(seen, 0.0), abs(float(values[0])))
        away = before > self.tolerance
        self.ends[edge] = last
        self.ends[seen] = max(self.ends.get(seen, 0.0), float(np.abs(values).max()))
        rough = not (self.guard.affine or order or self.resolved(values))
        for root, direction in roots(bernstein, order, self.tolerance):
            if direction and before <= self.noise and not self.leaves(values, root):
                continue
            if direction and rough:
                yield self.refined(left + width * root, direction, fractions, values), direction
            elif direction or away:
                yield left + width * root, direction

    def beside_jumps(self, left: float, right: float, values: Numbers) -> Numbers:
        """The samples without jumps at the rounding of the time, over which no polynomial leads:
        from end to end of a part that is as short, and just before the end of the step where the
        guard jumps there, and not from zero. If it jumps over zero, the next step begins so."""
        short = 64 * _rounding(self.segment, self.t0)
        if right - left <= short:
            return values[0] + (values[-1] - values[0]) * nodes(self.degree)
        before, last = self.at(right - short), float(values[-1])
        largest = max(abs(last), self.ends.get(("largest", self.guard.edge), 0.0))
        clear = abs(before) > RESOLVED * largest + self.tolerance + self.noise
        if right == 1.0 and clear:
            values[-1] = before
        return values

    def leaves(self, values: Numbers, root: float) -> bool:
        """Whether a guard exceeds rounding somewhere before a zero of its polynomial."""
        series = from_values(self.degree) @ values
        between = chebyshev.chebval(2.0 * root * SHARES_OF_FLIGHT - 1.0, series)
        largest = max(np.abs(between).max(), np.abs(values[nodes(self.degree) < root]).max())
        return bool(largest > self.noise)

    def refined(self, root: float, direction: int, fractions: Numbers, values: Numbers) -> float:
        """A zero found by bisection of the guard itself, where its polynomial is too inaccurate."""
        changes = np.flatnonzero(direction * values[:-1] < 0)
        changes = changes[direction * values[changes + 1] > 0]
        if not len(changes):
            return root
        nearest = changes[np.argmin(np.abs(fractions[changes] - root))]
        low, high = fractions[nearest], fractions[nearest + 1]
        once = attrs.evolve(self, whole=False)
        while high - low > 2 * EPS * high:
            middle = 0.5 * (low + high)
            if middle in (low, high):
                break
            if direction * once.sample(np.array([middle]))[0] > 0:
                high = middle
            else:
                low = middle
        return float(high)

    def sample(self, fractions: Numbers) -> Numbers:
        start, length, value = self.segment.start, self.segment.length, self.guard.value
        if self.whole:  # its parts are the same in every step
            states = self.segment.at(fractions).tolist()
        else:
            states = self.segment(start + length * fractions).tolist()
        times = (self.t0 + start + length * fractions).tolist()
        values = np.array([value(t, x) for t, x in zip(times, states, strict=True)])
        if not np.all(np.isfinite(values)):
            raise FlowError(f"the guard of {self.guard.edge} is not finite")
        return values

    def resolved(self, values: Numbers) -> bool:
        series = np.abs(from_values(self.degree) @ values)
        allowed = RESOLVED * series.max() + 1e-3 * self.tolerance + self.noise
        return bool(series[-3:].max() <= allowed)


# ---------------------------------------------------------------------------------------
# polynomials in Bernstein form on [0, 1]


@cache
def to_bernstein(degree: int) -> np.ndarray:
    """Matrix from values at the nodes to Bernstein coefficients."""
    return bernstein_from_chebyshev(degree) @ from_values(degree)


@cache
def bernstein_from_chebyshev(degree: int) -> np.ndarray:
    """Matrix from Chebyshev to Bernstein coefficients on [0, 1], computed in exact fractions."""
    columns, before, now = [], [-1, 2], [1]
    for _ in range(degree + 1):
        shares = [Fraction(c, comb(degree, k)) for k, c in enumerate(now)]
        columns.append(
            [float(sum(comb(j, k) * c for k, c in enumerate(shares))) for j in range(degree + 1)]
        )
        doubled = [4 * high - 2 * low for high, low in zip([0, *now], [*now, 0], strict=True)]
        before, now = now, [p - q for p, q in zip_longest(doubled, before, fillvalue=0)]
    return np.array(columns).T


def roots(bernstein: Numbers, order: int, tolerance: float) -> Iterator[tuple[float, int]]:
    """Zeros in ``(0, 1]`` of a polynomial that vanishes at 0 to the given order.

    Yields ``(point, direction)`` in order; direction 0 is a tangency within ``tolerance``.
    """
    work, found = room(len(bernstein) - 1)
    b = np.ascontiguousarray(bernstein, dtype=float)
    count = unit("zeros").crossings(b, len(b) - 1, order, tolerance, work, found)
    for point, direction in _listed(found, count):
        yield point, int(direction)


def series_zeros(c: Sequence[float], reach: float, tolerance: float) -> list[tuple[float, int]]:
    """Zeros in ``(0, reach]`` of the sum of ``c[k] s^k``, in the form of :func:`roots`."""
    work, found = room(len(c) - 1)
    powers = np.array(c, dtype=float)
    count = unit("zeros").series(powers, len(c) - 1, reach, 0, tolerance, work, found)
    return [(point, int(direction)) for point, direction in _listed(found, count)]


def turning_points(series: Numbers) -> list[float]:
    """The extrema of a Chebyshev series in ``(0, 1)``."""
    work, found = room(len(series) - 1)
    b = bernstein_from_chebyshev(len(series) - 1) @ series
    count = unit("zeros").turns(b, len(b) - 1, work, found)
    return [point for point, _ in _listed(found, count)]


def room(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Work and result arrays for the rules on zeros."""
    return np.empty((degree + SPARE_ROWS, degree + 5)), np.empty((2 * degree + 4, 2))


def _listed(found: Matrix, count: int) -> list[list[float]]:
    if count in (UNFIT, WORK_FULL):
        raise FlowError("a polynomial whose zeros are sought is not finite")
    rows: list[list[float]] = found[: max(count, 0)].tolist()
    return rows


# ---------------------------------------------------------------------------------------
# guards at the start of an arc


def fires(crossing: Crossing, direction: int) -> bool:
    """Whether an edge fires on a crossing in this direction."""
    if crossing is Crossing.EITHER:
        return direction != 0
    return direction == (-1 if crossing is Crossing.FALLING else 1)
