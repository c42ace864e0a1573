"""Steps that end where the flow changes its formula, for methods that do not look for such places.

A method evaluates the flow at a few points of a step. A force that acts between two of them is
missed, and so is its effect on the error estimate. But the step's polynomial shows the zeros of the
functions that decide on the formula. A step that contains one is taken back and made again up to
shortly before it, where the method sees one formula only, and so the zero is located ever better.
The short remaining way is gone along a parabola, and the method starts anew beyond.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FlowError
from ..events import SHARES, Cut, among, blurs, cuts, moving
from ..lowering import Field, Kink
from ..lowering.lowered import ORDER
from ..rules import unit
from ..rules.cuts import MOVES
from ..rules.zeros import EPS
from ..segment import Segment, of_powers
from ..solvers import Solver, Stepper
from ..solvers.base import LEADS_BACK
from .entry import Departure, departure

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, StateVector
    from ..lowering.tape import Jets

#: The share of the way to a kink that is left before it is looked for again, and by how much more
#: is left each time that it is met before; and the share of a step that is gone along a parabola,
#: which beyond the kink is that of another formula: its error is the square of this.
SHORT_OF, SHORTER, PARABOLIC = 1e-4, 8.0, 1e-8

#: The most of a step in which nothing is seen of a deciding function.
BLURRED = 1e-6

#: A way that goes on beyond a kink for more than so many times the way to it is straight: the bend
#: of the way to it would be rounding.
STRAIGHT_BEYOND = 8.0

#: Most kinks that are passed with no step between: more than there are in any flow.
MOST_PASSES = 256

#: Half as far from a corner a flow has changed by half as much, from a root by 0.71, and from a
#: jump by as much; this near to it (1e-10 of the states), as rounding leaves 1e-4 of the change.
CORNER, NEAR_CORNER = 0.6, 1e-6

#: A deciding function of which a step leaves so much may be zero where it ends.
HAS_COME = 1e-6

#: What changes by so much of itself in a moment jumps there.
HAS_JUMPED = 1e-6

#: Times and states within so many roundings are not told apart.
SPACINGS = 16

#: How far time and states are moved off what holds the state, relative to them, and how much of a
#: deciding function that is zero there may be left when they are moved back; rounding leaves less.
ASIDE, HELD_SHARE = 1e-4, 1e-3

#: How much of the rounding of a deciding function the last coefficients of its polynomial may be.
NOISE = 1e4


def begin(
    solver: Solver,
    field: Field,
    t0: float,
    x0: StateVector,
    length: float,
    first_step: float | None,
    sizes: StateVector | None = None,
) -> Stepper:
    """A stepper for an arc, whose steps end where the flow changes its formula.

    An arc that starts at such a place starts beyond it: by rounding of the time, or by a step of
    its own (:func:`.entry.departure`). Deciding functions that are zero all along what holds the
    state, as a surface on which it slides, show no such place: rounding decides on their signs.
    """
    t, x, way = t0, x0, departure(field, field.changes, t0, x0, length)
    if way is not None and way.ahead <= SPACINGS * EPS * max(abs(t0), length):
        t, x = t0 + way.ahead, way.x
        way = None
    changes = [kink for kink in field.changes if kink.change != "ends"]
    if changes and field.project is not None and not solver.cuts:
        changes = [kink for kink in changes if not is_held(kink, field, t, x, length)]
    if solver.cuts or (way is None and not changes):
        return solver.begin(field, t, x, length, first_step, sizes)
    return KinkedStepper(solver, field, changes, (t, x, length, first_step, sizes), way)


def aside(x: StateVector) -> StateVector:
    """By how much states are moved off a place, each by another share."""
    moved: StateVector = np.where(x == 0.0, np.abs(x).max() or 1.0, x)
    return moved * np.linspace(ASIDE, 2.0 * ASIDE, len(x))


def is_held(kink: Kink, field: Field, t: float, x: StateVector, length: float) -> bool:
    """Whether a deciding function is zero wherever the state is held, as far as states beside this
    one show: those that are moved off, and back onto what holds the state."""
    assert field.project is not None
    moved = aside(x)
    here, then = abs(kink.value(t, x.tolist())), t + ASIDE * length
    for beside in ((x + moved).tolist(), (x - moved).tolist()):
        off, back = kink.value(then, beside), kink.value(then, list(field.project(then, beside)))
        if not max(here, abs(back)) < HELD_SHARE * abs(off):
            return False
    return True


class _Along:
    """Whether a flow keeps its formula along a polynomial of the state, by the compiled rule."""

    def __init__(self, values: Jets) -> None:
        self.program, self.room, self.rule = values.alone, values.room(ORDER), unit("formulas")

    def keeps_formula(self, t: float, start: float, length: float, powers: Matrix) -> bool:
        """Whether the flow keeps its formula along a step, of which the polynomial is given by
        powers of the share of its length; also False if it cannot be told."""
        count, c = powers.shape[1], self.room.c
        c[: len(powers), :count] = powers / length ** np.arange(count)
        c[: len(powers), count:] = 0.0
        return bool(self.rule.keeps_formula(self.program, 0, t + start, length, self.room))


class KinkedStepper(Stepper):
    """Steps of a solver, started anew where the flow changes its formula.

    Attributes
    ----------
    inner : Stepper
        The method, from ``offset`` to ``bound`` at most.
    first : float or None
        The length of the first step that is tried where it starts anew.
    passes : int
        The kinks passed since the last step of the method.
    """

    inner: Stepper
    _segment: Segment

    def __init__(
        self,
        solver: Solver,
        field: Field,
        changes: list[Kink],
        start: tuple[Any, ...],
        way: Departure | None = None,
    ) -> None:
        self.solver, self.field, self.changes = solver, field, changes
        self.t0, self.x, self.length, self.first, self.sizes = start
        self.tau, self.seen, self.passes = 0.0, 0.0, 0
        self.way = way
        self.along = None if field.values is None else _Along(field.values)
        self._begin(self.length)
        self.repeats = self.inner.repeats

    def _begin(self, bound: float) -> None:
        """Start the method here, up to a local time."""
        t, x, left = self.t0 + self.tau, self.x, bound - self.tau
        first = None if self.first is None else min(self.first, left)
        self.inner = self.solver.begin(self.field, t, x, left, first, self.sizes)
        self.inner.verifies = False
        self.offset, self.bound, self.passed = self.tau, bound, False
        self.signs = self._values(t, x)

    def _values(self, t: float, x: StateVector) -> dict[Any, float]:
        """The values of the deciding functions, by their keys."""
        state = x.tolist()
        return {kink.edge: kink.value(t, state) for kink in self.changes}

    def step(self, limit: float) -> None:
        if self.way is not None:
            self._depart(self.way, limit)
            return
        if self.passed or self.tau >= self.bound:
            self._begin(self.length)
        short = SHORT_OF
        while True:
            before, signs = (self.tau, self.x), dict(self.signs)
            self.inner.step(min(limit, self.bound) - self.offset)
            own = self.inner.segment()
            self._take(own, limit)
            self.first = own.length
            cut = self._first_cut(own) or self._next_to(own) or self._at_end(own, signs)
            settled = cut is not None and self._settled(cut, *before)
            if cut is None or settled:
                self.inner.verify()
                self.passes = MOST_PASSES - 1 if settled else 0  # it may cross from beside it
                self.signs = self._values(self.t0 + self.tau, self.x) if settled else self.signs
                return
            self.tau, self.x = before
            inside = cut.before > 0.0
            self.seen = self.seen or own.length
            ahead = (cut.before if inside else cut.after) * own.length
            if inside and ahead > max(PARABOLIC * self.seen, self._speck(cut.kink)):
                self._begin(self.tau + (1.0 - short) * ahead)
                short = min(SHORTER * short, 0.9)
            else:
                self._pass(cut, ahead)
                return

    def _settled(self, cut: Cut, tau: float, x: StateVector) -> bool:
        """Whether the state has come to rest on a corner of the flow, as that of ``abs(a - b)``
        where ``a`` and ``b`` level out: rounding then has it on either side in turn.

        The flow is the same there by both formulas, and steps need not end. That it has a corner,
        and no jump or root, is told by how it changes over the place from half as far.
        """
        if self.passes < MOST_PASSES:
            return False
        t, moved = self.t0 + tau, NEAR_CORNER * aside(x)
        sides = [cut.kink.value(t, (x + way * moved).tolist()) for way in (0.5, -0.5)]
        far, near = (
            np.abs(self.field.flow(t, x + way * moved) - self.field.flow(t, x - way * moved))
            for way in (1.0, 0.5)
        )
        return sides[0] * sides[1] < 0.0 and bool(np.all(near <= CORNER * far))

    def _depart(self, way: Departure, limit: float) -> None:
        """Go to where no deciding function is zero, as the first step."""
        self._segment = of_powers(0.0, way.ahead, way.powers)
        self.tau, self.x, self.passed, self.way = way.ahead, way.x, True, None
        if limit < way.ahead:
            self.land(limit)

    def segment(self) -> Segment:
        return self._segment

    def land(self, tau: float) -> Segment:
        if self.passed:
            self._segment = self._segment.cut(tau - self._segment.start)
            self.tau, self.x = tau, self._segment(tau)
        else:
            self._take(self.inner.land(tau - self.offset), tau)
        return self._segment

    def _take(self, own: Segment, limit: float) -> None:
        """Go to the end of a step of the method; a step made to a limit ends there."""
        start, tau, self.x = self.offset + own.start, self.inner.tau, self.inner.x
        ends = (end for end in (limit, self.bound) if tau == end - self.offset)
        self.tau = next(ends, self.offset + tau)
        self._segment = Segment(start, self.tau - start, own.coefficients)

    def _first_cut(self, own: Segment) -> Cut | None:
        """The first place in a step at which a deciding function changes its sign."""
        if self._keeps_formula(own):
            return None
        t, scale = self.t0 + self.offset, self.length / SHARES
        found, places = list[Cut](), list[Cut]()
        # one that jumps does so where others change, which come before
        for kink in moving(self.changes, own, t, self.signs):
            noise, others = self._noise(kink, own), [] if kink.affine else places
            new = [*islice(cuts(kink, own, t, scale, self.signs, noise, others), 1)]
            found, places = [*found, *new], among(places, new)
        return min(found, key=lambda cut: cut.before, default=None)

    def _keeps_formula(self, own: Segment) -> bool:
        """Whether the compiled rule shows that the flow keeps its formula along a step, at the end
        of which no deciding function has another sign."""
        since = self.t0 + self.offset
        if self.along is None or not self.along.keeps_formula(since, *self.inner.powers()):
            return False
        before, after = self.signs, self._values(since + own.end, own(own.end))
        if not all(before.get(edge, value) * value > 0.0 for edge, value in after.items()):
            return False
        self.signs = after
        return True

    def _next_to(self, own: Segment) -> Cut | None:
        """The place of the kink, where the method's own steps close in on it and become as short as
        the rounding of the time."""
        speck = SPACINGS * float(np.spacing(abs(self.t0) + self.tau))
        if own.length > speck:
            return None
        t, x = self.t0 + self.tau, self.x
        ahead = x + SPACINGS * speck * self.field.flow(t, x)
        for kink in self.changes:
            here = kink.value(t, x.tolist())
            if here * kink.value(t + SPACINGS * speck, ahead.tolist()) < 0.0:
                return Cut(kink, 1.0, 1.0, -int(np.sign(here)))
        return None

    def _at_end(self, own: Segment, before: dict[Any, float]) -> Cut | None:
        """The jump of the flow at which a step ends, to rounding: the method may have evaluated the
        flow there by either formula."""
        t, x = self.t0 + self.tau, self.x
        for kink in (kink for kink in self.changes if kink.change == "jumps"):
            was = before.get(kink.edge, 0.0)
            here = abs(kink.value(t, x.tolist())) <= HAS_COME * abs(was)
            if here and abs(was) > blurs(kink, t, x.tolist()):
                speck = self._speck(kink)
                later = x + speck * self.field.flow(t, x)
                short = speck <= SHORT_OF * own.length
                if short and kink.value(t + speck, later.tolist()) * was < 0.0:
                    return Cut(kink, 1.0, 1.0, -int(np.sign(was)))
        return None

    def _noise(self, kink: Kink, own: Segment) -> float:
        """The rounding of a deciding function."""
        if kink.affine:
            return 0.0
        return NOISE * blurs(kink, self.t0 + self.offset + own.end, self.x.tolist())

    def _speck(self, kink: Kink) -> float:
        """A time too short to see anything in, by the rounding of the time or of the deciding
        function. Where that hardly moves, as a speed may that turns, what bends its way counts."""
        x, flow = self.x.tolist(), self.field.rhs(self.t0 + self.tau, self.x.tolist())
        times = [abs(x[i] / flow[i]) for i in kink.uses if flow[i]]
        most = BLURRED * max(self.seen, self.first or 0.0)
        rounding = SPACINGS * EPS * min(times, default=0.0)
        return max(SPACINGS * EPS * (abs(self.t0) + self.tau), min(rounding, most))

    def _pass(self, cut: Cut, ahead: float) -> None:
        """Go on along a parabola until a deciding function has the sign beyond a kink, for some
        time: a step from the same place would meet the same kink. The parabola is that of the
        formula before the kink."""
        t, x = self.t0 + self.tau, self.x
        more = float(np.spacing(abs(self.t0) + self.tau + ahead))
        rate, bend = self._way(t, x, ahead, more)
        ahead = max(ahead, more)
        for _ in range(MOVES):
            there = x + ahead * (rate + ahead * bend)
            now = self.t0 + (self.tau + ahead)  # as the method has it that starts there
            later = self.field.flow(now, there)
            beyond = cut.kink.value(now, there.tolist()) * cut.side > 0
            if beyond and self._has_changed(cut.kink, rate, later, now, there):
                break
            bend = 0.5 * (later - rate) / ahead if np.isfinite(later).all() else bend
            ahead, more = ahead + more, 2.0 * more
        ahead = min(ahead, self.length - self.tau)
        start, self.tau = self.tau, self.tau + ahead
        powers = np.array([x, ahead * rate, ahead * ahead * bend]).T
        self._segment = of_powers(start, self.tau - start, powers)
        self.x = x + ahead * (rate + ahead * bend)
        self.first, self.seen = self.seen, 0.0
        self.passed, self.passes = True, self.passes + 1
        if self.passes > MOST_PASSES:
            raise FlowError(f"{self.passes} changes of the flow with no step between: {LEADS_BACK}")

    def _has_changed(
        self, kink: Kink, before: StateVector, flow: StateVector, t: float, x: StateVector
    ) -> bool:
        """Whether a flow has, beyond a kink at which it jumps, the formula that it has a little
        later: it may round its own deciding function elsewhere."""
        if kink.change != "jumps":
            return True
        speck = self._speck(kink)
        if speck > SHORT_OF * self.seen:  # a flight as short as rounding
            return True
        later = self.field.flow(t + speck, x + speck * flow)
        jumps = np.abs(later - before) > HAS_JUMPED * np.maximum(np.abs(later), np.abs(before))
        return bool(np.all(~jumps | (np.abs(later - flow) <= 0.5 * np.abs(later - before))))

    def _way(
        self, t: float, x: StateVector, ahead: float, more: float
    ) -> tuple[StateVector, StateVector]:
        """The first two powers of the way from a state, of which at least ``more`` is gone: by the
        flow there and half the way ahead, as a flow may leave a kink at rest."""
        flow, half = self.field.flow(t, x), 0.5 * ahead
        later = self.field.flow(t + half, x + half * flow)
        if STRAIGHT_BEYOND * ahead < more:
            return later, np.zeros_like(later)
        return flow, 0.5 * (later - flow) / half
