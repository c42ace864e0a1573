"""One arc flown in Python: step until a guard fires or the run ends, and land on the guard (rules
1, 2, 4, 5)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import dropwhile
from math import isfinite
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..errors import DomainError, FlowError, OptionError
from ..events import SHARES, Cut, Zero, fires, zeros
from ..lowering import Guard, Kink, Scene, released
from ..lowering.automaton import DIRECTIONS
from ..lowering.lowered import ORDER
from ..rules import unit
from ..rules.arcs import FORESEEN_FAR, LANDINGS, SAFETY
from ..rules.cuts import MOVES, ROUNDED
from ..rules.guards import (
    GUARD_ROUNDING,
    JUMPS_WITHIN,
    TIE,
    TIED_IN_STEP,
    in_unit,
    shallow,
)
from ..rules.zeros import EPS
from ..segment import Segment, straight
from ..solvers import Solver, Stepper
from ..solvers.base import NO_FLOW_HERE
from ..trajectory.clock import Instant
from ..trajectory.plan import Plan
from ..zeno.flight import falls
from .border import leaving, within
from .entry import (
    Entry,
    Place,
    departed,
    describe,
    expand,
    heading,
    moves_off,
    opened,
    side_before,
    zero_within,
)
from .held import hidden_corner
from .kinked import begin, is_held
from .losses import MAY_HIDE, Losses
from .pace import Pace
from .standstill import standstill

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: A step spans at most this many time scales of a guard that is not a polynomial of the state.
REACH = 8.0

#: A guard that has touched zero and turns back by the fourth power of the time has left it, by more
#: than rounding, after this share of the arc.
SHOWN_BY = 1e-3

#: A kink that a landed step has elsewhere than dense output is as near as this share of the step:
#: far above what a solver's dense output is off.
KINK_MOVES = 1e-3

#: A step made onto a predicted event may miss it by this share of the arc.
AIMED = 1e-6


@attrs.frozen
class Fired:
    """A guard that fires, its local time and direction; ``cut``: the place where it jumps over
    zero, if it does."""

    index: int
    tau: float
    direction: int = -1
    cut: Cut | None = None


@attrs.frozen(eq=False)
class Flown:
    """An arc as flown.

    Attributes
    ----------
    fired : int or None
        The guard that ended it; None at the end of the run.
    grazes : list of (local time, guard, state)
        The tangencies on the way.
    interrupted : bool
        The user has interrupted the run; the arc goes as far as it was flown.
    carried : bool
        The guard that fired has not been zero: it jumped over zero.
    beyond_by : float
        How far beyond, by the function that decides.
    tied : dict
        By edge, the sign before its zero of each guard that is zero at the same time, and fires.
    touched : dict
        The same of the guards of other edges and switchings that are zero there.
    over : frozenset of str
        Edges whose guards are zero there and whose condition fails.
    steps : int
        The number of steps.
    stands : bool
        Whether the flow has come to a standstill (:mod:`.standstill`), and the arc goes on.
    """

    fired: int | None
    length: float
    x: StateVector
    segments: list[Segment]
    grazes: list[tuple[float, int, np.ndarray]]
    interrupted: bool = False
    carried: bool = False
    tied: dict[str, int] = attrs.Factory(dict)
    over: frozenset[str] = frozenset()
    steps: int = 0
    touched: dict[str, int] = attrs.Factory(dict)
    beyond_by: float = 0.0
    stands: bool = False


class ArcFlow:
    """Flows one arc from an entry, to the time ``until`` at most (default: the end of the run).

    ``carried``: the edge whose guard has just jumped over zero; ``spent``: the edges that have been
    taken where the arc begins (:class:`.Jumped`).
    """

    def __init__(
        self,
        scene: Scene,
        solver: Solver,
        plan: Plan,
        entry: Entry,
        now: Instant,
        until: float | None = None,
        losses: Losses | None = None,
        carried: str | None = None,
        spent: frozenset[str] = frozenset(),
    ) -> None:
        self.scene, self.solver, self.plan, self.now = scene, solver, plan, now
        self.losses = Losses(plan, solver.whole, entry.x) if losses is None else losses
        self.until = plan.t1 if until is None else until
        self.field, self.x, self.series = entry.field, entry.x, entry.series
        self.signs, self.carried, self.spent = entry.signs, carried, spent
        self.orders = self.entered = entry.orders
        kept = plan.dense or plan.samples is not None or bool(scene.spec.lags)
        self.wanted = kept or bool(self.field.guards)
        self.ends: dict[Any, float] = {}
        self.grazes: list[tuple[float, int, np.ndarray]] = []
        self.tied: dict[str, int] = {}
        self.over: frozenset[str] = frozenset()
        self.left: set[int] = set()
        self.predicted: set[int] = set()
        self.turning: dict[int, Zero] = {}
        self.touching: dict[int, Zero] = {}
        self.made, self.stands = 0, False

    def run(self) -> Flown:
        """Flow until a guard fires or the run ends."""
        with np.errstate(all="ignore"):  # what is not finite is reported, not warned of
            return self._run()

    def _run(self) -> Flown:
        length = self.now.until(self.until)
        if not length > 0.0:  # a jump at the last time: solvers take no step of no length
            return Flown(None, 0.0, self.x, [], [])
        self.pace = Pace(self.field, self.now.t, length, self.losses)
        target = self.predict(length)
        self._begin_guards()
        stepper = self._begin(length, target)
        if not self.wanted:
            return self._finish(stepper, length)
        segments: list[Segment] = []
        try:
            fired = self._steps(stepper, length, target, segments)
        except KeyboardInterrupt:
            if not segments:
                raise
            last = segments[-1]
            end = last.end, last(last.end)
            return Flown(None, *end, segments, self.grazes, True, steps=self.made)
        index, carried = (None, False) if fired is None else (fired.index, fired.cut is not None)
        made = stepper.tau, stepper.x, segments, self.grazes
        known = self.tied, self.over, self.made, self._touched(stepper)
        beyond_by = self._beyond_by(fired, stepper)
        return Flown(index, *made, False, carried, *known, beyond_by, self.stands)

    def _beyond_by(self, fired: Fired | None, stepper: Stepper) -> float:
        """How far beyond the place at which a guard has jumped the arc ends."""
        if fired is None or fired.cut is None:
            return 0.0
        return abs(fired.cut.kink.value(self.now.after(stepper.tau).t, stepper.x.tolist()))

    def _begin_guards(self) -> None:
        """Note the values of guards that are not zero at the start. Dense output is exact there
        only to the rounding of the whole step, in which a small value would lose its sign. At a
        kink that is the value behind it, but what holds the state is looked at on both sides."""
        t, x = self.now.t, self.x.tolist()
        for guard, order in zip(self.field.guards, self.orders, strict=True):
            holds = guard.kind in ("release", "leave")
            if not order and (holds or all(kink.value(t, x) for kink in guard.kinks)):
                self.ends[guard.edge] = guard.value(t, x)

    def _steps(
        self, stepper: Stepper, length: float, target: float | None, segments: list[Segment]
    ) -> Fired | None:
        """Append step after step to ``segments``; returns the guard that fires, or None."""
        fired = None
        while fired is None and stepper.tau < length:
            start, x = stepper.tau, stepper.x
            scales = self._scales(start, x)
            limit = target if target is not None and target > start else length
            limit = min(limit, length, start + REACH * min(scales, default=float("inf")))
            limit = min(limit, start + self.plan.longest(start))
            try:
                self._step(stepper, limit)
            except FlowError:
                fired = self._at_border(stepper, start, x)
                if fired is None and self._stands(stepper, start, x):
                    break
                if fired is None or not segments:
                    raise
                break
            segment = stepper.segment()
            self._lose(start, x, stepper)
            try:
                found = self._events(segment, stepper, scales, target)
            except FlowError as fault:
                raise FlowError(f"{self._where(start, x)}: {fault}") from None
            if found:
                fired, last = self._ended(found, stepper, segment, x)
                self._require_held(last)
                segments += [*last, *self._past(fired, stepper, segment, length)]
                break
            self._require_held([segment])
            segments.append(segment)
            self.orders = [0] * len(self.orders)
        return fired

    def _require_held(self, segments: list[Segment]) -> None:
        """Refuse a step over a corner of what holds the state that no formula shows."""
        if self.field.project is None or self.solver.whole:
            return
        for segment in segments:
            allowed = self.plan.limit + self.plan.rtol * np.abs(segment(segment.end))
            tau = hidden_corner(self.field, self.now.t, segment, allowed)
            if tau is not None:
                held = " or ".join(self.field.held)
                what = f"the gap of {held}" if held else "the surface on which the state slides"
                raise FlowError(
                    f"{self._where(tau, segment(tau))}: {what} has a corner or a jump there that "
                    "its formula does not show (as sqrt(1 - cos(t)) has one); write it with abs, "
                    "where or mod"
                )

    def _lose(self, start: float, x: StateVector, stepper: Stepper) -> None:
        """Note what a step has lost that began at ``x``."""
        if not self.losses.exact and self.field.guards:
            self.losses.note(self.field, self.now.t, start, x, stepper)

    def _ended(
        self, found: list[Fired], stepper: Stepper, segment: Segment, x: StateVector
    ) -> tuple[Fired, list[Segment]]:
        """End the step that began at ``x`` on the first of the guards that fire in it.

        Two zeros next to each other may be in the wrong order on the step's polynomial. If the
        other guard has already fired where the step ends, the step is ended on that one instead.
        """
        landed, first, length = None, found[0], segment.length
        for attempt in range(len(found)):
            landed = None
            if first.tau > segment.start:
                landed = self._land(stepper, segment, first, again=attempt > 0)
            if landed is None or not landed.length > 0.0:  # within rounding of the step's start
                landed, stepper.tau, stepper.x = None, segment.start, x
                break
            if not stepper.repeats:
                self._lose(segment.start, x, stepper)
            stepper.tau = landed.end
            ago, other = max(
                ((self._ago(each, first, stepper, length), each) for each in found),
                key=lambda pair: pair[0],
            )
            if not ago > 0.0:
                break
            first = attrs.evolve(other, tau=stepper.tau - ago)
        others = (each for each in found if each.index != first.index)
        tied = [each for each in others if self._ago(each, first, stepper, length) >= 0.0]
        near = self._gather(first.index, stepper)
        guards, known = self.field.guards, {first.index, *(each.index for each in tied)}
        more = [Fired(i, stepper.tau, d) for i, d in near.items() if i not in known]
        tied = [first, *tied, *more]
        self.tied = {guards[each.index].edge: -each.direction for each in tied}
        self.over |= self._passed(stepper)
        fired = min(tied, key=lambda each: each.index)  # the one declared first (4)
        return fired, [] if landed is None else [landed]

    def _gather(self, first: int, stepper: Stepper) -> dict[int, int]:
        """Go on from the zero of a guard to where all that are at one time with it, but for what
        the steps have lost, are beyond zero; returns those whose condition holds, and notes the
        others."""
        losses, field, t, x = self.losses, self.field, self.now.t + stepper.tau, stepper.x
        near = losses.near(self.scene, field, t, x, stepper.tau)
        if field.guards[first].kind not in MAY_HIDE or not near.keys() - {first}:
            return {}
        later, there = losses.beyond(field, near, t, x)
        length = self.now.until(self.until)
        stepper.tau, stepper.x = min(stepper.tau + later, length), there
        holds = {i: field.guards[i].holds(t, x.tolist()) for i in near if i != first}
        self.over |= {field.guards[i].edge for i, held in holds.items() if not held}
        return {i: near[i] for i, held in holds.items() if held}

    def _passed(self, stepper: Stepper) -> frozenset[str]:
        """Edges whose guards are zero where a step ends and whose condition fails there."""
        t, x, guards = self.now.t + stepper.tau, stepper.x.tolist(), self.field.guards
        fails = [index for index, guard in enumerate(guards) if not guard.holds(t, x)]
        return frozenset(
            guards[index].edge for index in fails if self._since(index, 0, t, x) == 0.0
        )

    def _touched(self, stepper: Stepper) -> dict[str, int]:
        """The signs that guards had before they are zero where the arc ends, and do not fire."""
        t, x, found = self.now.t + stepper.tau, stepper.x.tolist(), {}
        for index, guard in enumerate(self.field.guards):
            if guard.kind in ("edge", "switch") and guard.edge not in self.tied:
                value, rate, bend = guard.lie(t, x)
                about = self.scene, guard, self.field, t, stepper.x, self.losses.seen
                noise = max(zero_within(*about), self._rounding(index, t, x))
                if abs(value) <= noise:
                    inside = -DIRECTIONS[guard.crossing] if guard.bounds else 0
                    waits = self._inside(index) if self.signs else 0
                    stays = self.entered[index] == 1 and abs(rate) * stepper.tau <= 2.0 * noise
                    left = rate - 0.5 * bend * stepper.tau  # since it was zero, along a parabola
                    side = int(np.sign(left)) if stays else side_before(rate, bend, noise)
                    found[guard.edge] = inside or (waits if moves_off(*about, waits) else side)
        return found

    def _since(self, index: int, before: int, t: float, x: list[float]) -> float:
        """How long before a time a guard has fired (see :func:`hybrid.rules.ties.since`)."""
        value, rate, _ = self.field.guards[index].lie(t, x)
        since = unit("ties").since(value, rate, before, t, self._rounding(index, t, x))
        return float(since)

    def _ago(self, other: Fired, first: Fired, stepper: Stepper, length: float) -> float:
        """How long before the end of a step another guard has fired.

        0 if they fire at the same time (4), negative if it has not fired yet. This is judged at the
        event, in spacings of its time and in the rounding of the guard.
        """
        t, x, apart = self.now.t + stepper.tau, stepper.x.tolist(), other.tau - first.tau
        spacing = TIE * float(np.spacing(abs(t)))
        if other.index == first.index:
            return 0.0
        if apart > spacing + TIED_IN_STEP * length:
            return -1.0
        if other.cut is not None:
            return 0.0 if apart <= spacing + (other.cut.after - other.cut.before) * length else -1.0
        return self._since(other.index, -other.direction, t, x)

    def _where(self, tau: float = 0.0, x: StateVector | None = None) -> str:
        return describe(self.scene, self.field, self.now.t + tau, self.x if x is None else x)

    def _begin(self, length: float, target: float | None) -> Stepper:
        self.x = within(self.field, self.now.t, self.x)
        if not all(map(isfinite, self.field.rhs(self.now.t, self.x.tolist()))):
            raise FlowError(f"{self._where()}: {NO_FLOW_HERE}")
        first, sizes = self.first_step(length), None
        if target is not None and self.series is not None:
            powers = target ** np.arange(1, ORDER + 1)
            sizes = np.abs(np.array(self.series[0])[:, 1:] * powers).max(axis=1)
        if target is not None:
            first = min(first or target, target)
        try:
            return begin(self.solver, self.field, self.now.t, self.x, length, first, sizes)
        except FlowError as fault:
            raise FlowError(f"{self._where()}: {fault}") from None
        except OptionError:
            raise
        except ValueError as fault:
            raise FlowError(f"{self._where()}: the flow is not finite ({fault})") from None

    def _finish(self, stepper: Stepper, length: float) -> Flown:
        """Flow to the end, where no guard is watched and no dense output is kept."""
        try:
            while (most := self.plan.longest(stepper.tau)) < length - stepper.tau:
                stepper.step(stepper.tau + most)
                self._count(stepper, 1)
            while stepper.tau < length:
                self._count(stepper, stepper.finish(length))
        except FlowError as fault:
            if not self._stands(stepper, stepper.tau, stepper.x):
                raise FlowError(f"{self._where(stepper.tau, stepper.x)}: {fault}") from None
        end = stepper.tau, stepper.x
        return Flown(None, *end, [], [], steps=self.made, stands=self.stands)

    def _step(self, stepper: Stepper, limit: float) -> None:
        tau, x = stepper.tau, stepper.x
        try:
            stepper.step(limit)
            self._count(stepper, 1)
        except FlowError as fault:
            raise FlowError(f"{self._where(tau, x)}: {fault}") from None

    def _stands(self, stepper: Stepper, tau: float, x: StateVector) -> bool:
        """Whether the state has come to a standstill, but for what steps may lose, where no step
        can be made; the arc ends there, and its last state is that (:mod:`.standstill`)."""
        known = self.field, self.now.t + tau, x, self.losses.allowed(x)
        there = standstill(*known) if tau > 0.0 else None
        if there is not None:
            stepper.tau, stepper.x, self.stands = tau, there, True
        return there is not None

    def _at_border(self, stepper: Stepper, tau: float, x: StateVector) -> Fired | None:
        """The edge that fires where the flow ends, if there is one, as no step can be made from a
        state; it is moved to the edge's zero, unless rounding has put it beyond that already."""
        t = self.now.t + tau
        found = leaving(self.field, t, x)
        if found is None:
            for index in sorted(self.turning.keys() | self.touching.keys()):
                guard = self.field.guards[index]
                value, noise = guard.value(t, x.tolist()), self._noise_of(guard)
                if guard.kind == "edge" and abs(value) <= noise and guard.holds(t, x.tolist()):
                    self._no_grazes(index, tau, [])
                    return Fired(index, tau, -self._inside(index))
            return None
        index, direction, ahead = found
        stepper.tau = tau + ahead
        stepper.x = x + ahead * np.array(self.field.rhs(t, x.tolist()))
        return Fired(index, stepper.tau, direction)

    def _count(self, stepper: Stepper, steps: int) -> None:
        self.made += steps
        self.pace.steps(stepper.tau, stepper.x, steps)

    def first_step(self, length: float) -> float | None:
        """The first step: where the first term that the method neglects reaches the tolerance, or
        what the user asks for."""
        if self.plan.first_step < float("inf"):
            return min(self.plan.longest(0.0), length)
        if self.series is None:
            return None
        c, lags = np.array(self.series[0]), self.scene.spec.lags
        atol = np.broadcast_to(self.plan.atol, self.x.shape).astype(float)
        first = unit("arcs").first_step(c, len(c), self.solver.order, self.plan.rtol, atol)
        most = length if lags else SAFETY * length  # a window may be one step
        return min(most, first) if first > 0 else None

    def predict(self, length: float) -> float | None:
        """The end of a short flight onto a contact, or back onto a guard, from its Taylor series
        (2)."""
        if self.series is None:
            return self._expected(length)
        found = {}
        for index in filter(self._predicts, range(len(self.field.guards))):
            gap = [self._inside(index) * c for c in self.series[1][index]]
            gap[: self.entered[index]] = [0.0] * self.entered[index]
            zero = falls(self.series[0], gap, FORESEEN_FAR ** (1.0 / ORDER))
            if zero is not None and zero < length:
                found[index] = zero
        best = min(found.values(), default=float("inf"))
        self.predicted = {index for index, zero in found.items() if zero <= best * (1.0 + AIMED)}
        return best if found else None

    def _expected(self, length: float) -> float | None:
        """The length of a flight from a contact under a constant force, where the flow has no
        series: in a first step that is far longer, a method's polynomial hardly shows the gap."""
        for index, guard in enumerate(self.field.guards):
            if guard.kind == "contact" and self.entered[index] == 1:
                _, rate, bend = guard.lie(self.now.t, self.x.tolist())
                if rate > 0.0 > bend and -2.0 * rate < -bend * length:
                    return -2.0 * rate / bend
        return None

    def _predicts(self, index: int) -> bool:
        """Whether a guard's next zero is predicted from its series: that of a contact, or of a
        guard that starts at zero, to the side on which it waits. One that bounds nothing and has
        fired there does so by its slope alone."""
        guard, order = self.field.guards[index], self.entered[index]
        if guard.kind in ("edge", "switch"):
            either = guard.crossing is Crossing.EITHER
            waits = self.signs[index] == self._inside(index)
            thrown = order == 1 and not either and (guard.bounds or waits)
            return thrown or (order > 0 and waits and guard.edge not in self.spent)
        return guard.kind == "contact" and order <= 1

    def _inside(self, index: int) -> int:
        """The sign that a guard has where it waits for its zero."""
        return -DIRECTIONS[self.field.guards[index].crossing] or self.signs[index]

    def _scales(self, tau: float, x: StateVector) -> list[float]:
        """Times over which guards that are not polynomials of the state are smooth."""
        guards = self.field.guards
        if all(guard.affine for guard in guards):
            return []
        share, own_time = (self.plan.t1 - self.plan.t0) / SHARES, unit("entries").own_time
        series = self.series if tau == 0.0 else expand(self.field, self.now.t + tau, x)
        scales = []
        for index, guard in enumerate(guards):
            size = max((abs(float(x[i])) for i in guard.uses), default=0.0)
            own = (
                share if series is None else min(share, own_time(np.array(series[1][index]), size))
            )
            scales.append(float("inf") if guard.affine else own)
        return scales

    def _events(
        self, segment: Segment, stepper: Stepper, scales: list[float], target: float | None
    ) -> list[Fired]:
        """The guards that fire in a step, each at its first time, ordered by time (1)."""
        grazes: list[tuple[float, int]] = []
        found = []
        for index in range(len(self.field.guards)):
            fired = self._guard_event(index, segment, stepper, scales, target, grazes)
            if fired is not None:
                found.append(fired)
        found.sort(key=lambda each: each.tau)
        for tau, index in sorted(grazes):
            if not found or tau < found[0].tau:
                self.grazes.append((tau, index, segment(tau)))
        return found

    def _guard_event(
        self,
        index: int,
        segment: Segment,
        stepper: Stepper,
        scales: list[float],
        target: float | None,
        grazes: list[tuple[float, int]],
    ) -> Fired | None:
        guard = self.field.guards[index]
        tolerance = self._tolerance(guard, segment, stepper.tau, stepper.x)
        scale = scales[index] if scales else float("inf")
        order, t0 = self.orders[index], self.now.t
        noise, ends, many = self._leaving(index, stepper), dict(self.ends), len(grazes)

        def first() -> Fired | None:
            found = zeros(guard, segment, t0, order, scale, tolerance, self.ends, noise)
            if order > 1:  # it is on its side: a zero at which it would come there is rounding
                found = dropwhile(lambda zero: zero.direction == self.signs[index], found)
            return self._first_zero(index, found, segment, stepper.x, tolerance, grazes)

        fired = first()
        while fired is not None and (
            (finer := self._tolerance(guard, segment, fired.tau, segment(fired.tau)))
            < 0.5 * tolerance
        ):
            # the step ends there: what the state beyond may lose hides no earlier zero
            tolerance, self.ends, grazes[many:] = finer, dict(ends), []
            earlier = first()
            fired = earlier if earlier is not None and earlier.tau < fired.tau else fired
        fired = fired or self._last(index, segment, stepper.x)
        if fired is not None:
            return fired
        if target is not None and segment.end == target:
            near = self._near_end(index, segment, stepper)
            if near is not None:
                return near
        sunk = self._sunk(index, segment, stepper, tolerance)
        return Fired(index, segment.start) if sunk else None

    def _leaving(self, index: int, stepper: Stepper) -> float:
        """The value that a guard which was zero at the start must exceed to have left zero (2).

        The rounding of the time counts: far from t = 0 it moves the gap over a moving obstacle by
        more than a method of low order does in its first steps. After a release the gap leaves zero
        by a higher power, which is divided out, so its flight may be lower than rounding.
        """
        if self.entered[index] != 1 or index in self.left:
            return 0.0
        noise = self._rounding(index, self.now.t + stepper.tau, stepper.x.tolist())
        if self.ends.get(("largest", self.field.guards[index].edge), 0.0) > noise:
            self.left.add(index)
            return 0.0
        return noise

    def _first_zero(
        self,
        index: int,
        found: Iterable[Zero],
        segment: Segment,
        end: StateVector,
        tolerance: float,
        grazes: list[tuple[float, int]],
    ) -> Fired | None:
        """The first zero of a guard in a step at which it fires; tangencies are appended to
        ``grazes`` (1).

        ``end``: the state at the step's end. A crossing that seems to turn back within the
        tolerance counts as a crossing if the guard is deeper at the end; one that has not turned
        back there may do so in the next step.
        """
        guard, shallow, over = self.field.guards[index], self.turning.pop(index, None), None
        for zero in found:
            passes = fires(guard.crossing, zero.direction)
            if guard.edge == self.carried and self._at_start(zero):
                continue
            if zero.cut is not None:
                after = segment.start + zero.cut.after * segment.length
                if self._over(guard, zero, zero.cut, segment) and self._holds(
                    guard, after, segment, end
                ):
                    return Fired(index, zero.tau, zero.direction, zero.cut)
            elif zero.direction == 0:
                grazes.append((zero.tau, index))
                self.touching.setdefault(index, zero)
            elif shallow is not None and zero.direction != shallow.direction:  # the way back
                shallow, over = None, shallow
            elif not self._holds(guard, zero.tau, segment, end):
                continue
            elif (passes or not guard.jumps) and self._touches(guard, zero, segment):
                grazes.append((zero.tau, index))
                self.touching.setdefault(index, zero)
                shallow = zero
            elif passes:
                return Fired(index, zero.tau, zero.direction)
        if shallow is None:
            if over is not None:  # its way back may show again
                noise = self._rounding(index, self.now.t + segment.end, end.tolist())
                if abs(self.ends[guard.edge]) <= noise:
                    self.turning[index] = over
            return self._run_out(index, segment, end, grazes)
        deep, tau = self.ends[guard.edge] * shallow.direction, max(shallow.tau, segment.start)
        if 0.0 <= deep <= tolerance and self._stays(guard, shallow, segment, end):
            tau = self._came(guard, tau, segment)
            self._no_grazes(index, tau, grazes)
        elif deep <= tolerance:
            if abs(deep) <= tolerance:
                self.turning[index] = shallow
            return None
        if (shallow.tau, index) in grazes:
            grazes.remove((shallow.tau, index))
        if not fires(guard.crossing, shallow.direction):
            return None
        return Fired(index, tau, shallow.direction)

    def _run_out(
        self,
        index: int,
        segment: Segment,
        end: StateVector,
        grazes: list[tuple[float, int]],
    ) -> Fired | None:
        """An edge whose guard has touched zero, in this step or before, and stays there but for
        rounding: it may come to rest so close to zero that it is not seen to cross it (1)."""
        guard, touch = self.field.guards[index], self.touching.get(index)
        if touch is None or guard.kind != "edge":
            return None
        value, noise = self.ends[guard.edge], self._noise_of(guard)
        if abs(value) > noise:
            del self.touching[index]
            return None
        side = self._inside(index)
        begin = self._came(guard, max(touch.tau, segment.start), segment)
        if not (value * side >= 0.0 and self._rests(guard, begin, segment, end, noise)):
            return None
        if not self._holds(guard, begin, segment, end):
            return None
        self._no_grazes(index, begin, grazes)
        return Fired(index, begin, -side)

    def _no_grazes(self, index: int, tau: float, grazes: list[tuple[float, int]]) -> None:
        """Strike out where a guard seemed to touch zero that has come to stay there at a time."""
        since = min(tau, self.touching[index].tau if index in self.touching else tau)
        grazes[:] = [graze for graze in grazes if graze[1] != index]
        self.grazes = [graze for graze in self.grazes if graze[1] != index or graze[0] < since]

    def _came(self, guard: Guard, tau: float, segment: Segment) -> float:
        """When a guard that is zero at a time, and stays so, has come there. Where it is within
        rounding of zero all along a step, rounding decides where it is zero; it comes there, by a
        root, as soon as its value and its rate at the start say."""
        begin, noise = segment(segment.start), self._noise_of(guard)
        value, rate, _ = guard.lie(self.now.t + segment.start, begin.tolist())
        if abs(value) > noise or abs(rate) * (tau - segment.start) > noise:
            return tau
        return min(tau, segment.start + (2.0 * abs(value / rate) if rate else 0.0))

    def _noise_of(self, guard: Guard) -> float:
        """The rounding of a guard that has been as large as it was in this arc."""
        return GUARD_ROUNDING * EPS * self.ends.get(("largest", guard.edge), 0.0)

    def _rests(
        self, guard: Guard, begin: float, segment: Segment, end: StateVector, noise: float
    ) -> bool:
        """Whether a guard that has come to zero moves by no more than rounding to the end of a
        step, for so long that one that turns back would have shown it."""
        way, middle = segment.end - begin, 0.5 * (begin + segment.end)
        places = (middle, segment(middle).tolist()), (segment.end, end.tolist())
        rates = [guard.lie(self.now.t + tau, x)[1] for tau, x in places]
        bend = guard.lie(self.now.t + begin, segment(begin).tolist())[2]
        shows = way >= SHOWN_BY * begin or not 0.5 * abs(bend) * way * way <= noise
        return shows and all(abs(rate) * way <= noise for rate in rates)

    def _at_start(self, zero: Zero) -> bool:
        """Whether a zero is where the arc begins: a guard that has jumped comes back over the
        place at which it has, beyond which the state is by rounding."""
        return zero.tau <= ROUNDED * JUMPS_WITHIN * float(np.spacing(abs(self.now.t)))

    def _holds(self, guard: Guard, tau: float, segment: Segment, end: StateVector) -> bool:
        """Whether an edge's condition holds at a time within a step. Components that differ from
        the step's end only by rounding are taken as they are there."""
        if guard.when is None:
            return True
        x = segment(tau)
        x = np.where(np.abs(x - end) <= TIE * EPS * np.abs(end), end, x)
        return guard.holds(self.now.t + tau, x.tolist())

    def _over(self, guard: Guard, zero: Zero, cut: Cut, segment: Segment) -> bool:
        """Whether a guard fires where it changes its formula (1).

        A load that becomes zero holds until it falls below, and so does a surface to which a flow
        no longer leads back. If these do not change, the obstacle may have begun to move away, or
        the surface have jumped: that ends the contact, and sliding, as well.
        """
        if self.until == self.plan.t1 and zero.tau >= self.now.until(self.until):
            return False
        if guard.kind not in ("release", "leave"):
            return fires(guard.crossing, zero.direction)
        before = _before(cut, segment)
        x = segment(before)
        if self.field.project is not None:
            x = np.array(self.field.project(self.now.t + before, x.tolist()))
            if is_held(cut.kink, self.field, self.now.t + before, x, segment.length):
                return False
        after, there = self.now.t + zero.tau, segment(zero.tau)
        beyond = _outside(guard, guard.value(after, there.tolist()))
        noise = GUARD_ROUNDING * EPS * self._terms(guard, zero.tau, x)
        if abs(beyond) <= noise:
            _, sign = heading(self.scene, after, self.field.name, there, guard.edge, np.zeros(0))
            beyond = noise + _outside(guard, sign)
        return beyond > noise or self._moved(guard, after, x)

    def _moved(self, guard: Guard, t: float, x: StateVector) -> bool:
        """Whether what holds the state has moved away from it, the obstacle or the surface."""
        place = Place(t, self.now.t, self.losses.seen)
        if guard.kind == "leave":
            return departed(self.scene, guard, place, x)
        return opened(self.scene, self.field.mode, released(guard.edge), place, x)

    def _onto(self, cut: Cut | None, segment: Segment, tau: float, x: StateVector) -> StateVector:
        """The state on the contacts held, or on the surface on which it slides. At a cut of a step
        these may jump: there it is on them as they were just before, and has gone on from there."""
        back = 0.0 if cut is None else (cut.after - cut.before) * segment.length
        return self.field.along(self.now.t + tau, x, back)

    def _past(
        self, fired: Fired, stepper: Stepper, segment: Segment, length: float
    ) -> list[Segment]:
        """Move from just before a place at which a guard jumps to just after it, by a step of the
        size of rounding.

        What the flow does from there on belongs to the next arc. Returns a segment only where the
        arc would otherwise have none.
        """
        if fired.cut is None and not self.field.guards[fired.index].jumps:
            return []
        start = stepper.tau
        x = self._onto(fired.cut, segment, start, stepper.x)
        flow = self.field.flow(self.now.t + start, x)
        spacing = float(np.spacing(abs(self.now.t) + start))
        shift = self._beyond(fired.cut, start, x, flow, spacing, length - start)
        more = (shift + spacing * n for n in range(JUMPS_WITHIN))
        shift = next((s for s in more if self._carried(fired, start + s, x + s * flow)), shift)
        shift = min(shift, length - start)
        stepper.tau, stepper.x = start + shift, x + shift * flow
        if start > 0.0 or shift == 0.0:
            return []
        return [straight(start, shift, x, stepper.x)]

    def _beyond(
        self,
        cut: Cut | None,
        tau: float,
        x: StateVector,
        flow: np.ndarray,
        spacing: float,
        most: float,
    ) -> float:
        """The time from a state to the other side of a cut, to one spacing of the time: the step
        before may have ended many of them short of it."""
        near, far = 0.0, 0.0
        while self._before(cut, tau + far, x + far * flow) and far < most:
            near, far = far, 2.0 * far or spacing
        while far - near > spacing and near < (middle := 0.5 * (near + far)) < far:
            if self._before(cut, tau + middle, x + middle * flow):
                near = middle
            else:
                far = middle
        return far

    def _before(self, cut: Cut | None, tau: float, x: StateVector) -> bool:
        """Whether a deciding function does not yet have the sign that it takes behind a cut.

        Where its domain ends there is nothing beyond, so the state stays before it. The time is
        computed as the next arc does, since one spacing of floats may be on the other side.
        """
        if cut is None:  # the last step has ended there
            return False
        side = cut.kink.value(self.now.after(tau).t, x.tolist()) * cut.side
        return not side > 0 and cut.kink.change != "ends"

    def _carried(self, fired: Fired, tau: float, x: StateVector) -> bool:
        """Whether an edge's guard has jumped over zero, or is zero, and whether what holds the
        state has let it go, by their own values: the function that decides on them may be rounded
        differently, and the next arc evaluates them."""
        guard, t, at = self.field.guards[fired.index], self.now.after(tau).t, x.tolist()
        noise = self._rounding(fired.index, t, at)
        if guard.kind in ("release", "leave"):
            return _outside(guard, guard.value(t, at)) > noise or self._moved(guard, t, x)
        jumps = guard.kind == "edge" and guard.jumps
        return not jumps or guard.value(t, at) * fired.direction >= -noise

    def _ends(self, segment: Segment) -> float:
        """How far the end of a step is beyond the time just before the last time of the run."""
        within = JUMPS_WITHIN * float(np.spacing(abs(self.until)))
        return segment.end - (self.now.until(self.until) - within)

    def _last(self, index: int, segment: Segment, end: StateVector) -> Fired | None:
        """An edge whose guard jumps within rounding of the last time of the run; whether it has
        jumped there is decided by its values."""
        guard, late = self.field.guards[index], self._ends(segment)
        if guard.kind != "edge" or not guard.jumps or not 0.0 <= late < segment.end:
            return None
        tau = segment.end - late
        before = guard.value(self.now.t + tau, segment(tau).tolist())
        there, direction = guard.value(self.until, end.tolist()), -int(np.sign(before))
        if not (there * before < 0.0 and fires(guard.crossing, direction)):
            return None
        return (
            Fired(index, segment.end, direction) if guard.holds(self.until, end.tolist()) else None
        )

    def _touches(self, guard: Guard, zero: Zero, segment: Segment) -> bool:
        """Whether a crossing goes no deeper than the tolerance there, and so is a tangency (1)."""
        t, x = self.now.t + zero.tau, segment(zero.tau).tolist()
        _, first, second = guard.lie(t, x)
        begin, s = segment(segment.start), zero.tau - segment.start
        value, rate, bend = map(abs, guard.lie(self.now.t + segment.start, begin.tolist()))
        terms = value + rate * s + 0.5 * bend * s * s  # of its way, whose rounding the zero has
        left = self._tolerance(guard, segment, zero.tau, segment(zero.tau))
        tolerance = max(left, GUARD_ROUNDING * EPS * terms)
        return shallow(first, second, zero.direction, tolerance)

    def _stays(self, guard: Guard, zero: Zero, segment: Segment, end: StateVector) -> bool:
        """Whether a guard that has come to zero has no rate from then to the end of the step, as
        the level of a tank has none that has run empty: it does not turn back (1)."""
        middle = 0.5 * (max(zero.tau, segment.start) + segment.end)
        places = (middle, segment(middle).tolist()), (segment.end, end.tolist())
        return all(guard.lie(self.now.t + tau, x)[1] == 0.0 for tau, x in places)

    def _near_end(self, index: int, segment: Segment, stepper: Stepper) -> Fired | None:
        """A guard that fires next to the end of a step that was made onto a predicted event: the
        predicted one, or another that has crossed zero on the way (4)."""
        t, x, guard = self.now.t + segment.end, stepper.x.tolist(), self.field.guards[index]
        value, rate, _ = guard.lie(t, x)
        rounding = self._rounding(index, t, x)
        if index in self.predicted:
            inwards = self._inside(index)
            near = abs(value) <= max(rounding, -AIMED * inwards * rate * segment.length)
            return Fired(index, segment.end, -inwards) if near and guard.holds(t, x) else None
        direction, middle = int(np.sign(rate)), segment.start + 0.5 * segment.length
        if not guard.holds(t, x) or not (
            fires(guard.crossing, direction) and abs(value) <= AIMED * abs(rate) * segment.length
        ):
            return None
        before = guard.value(self.now.t + middle, segment(middle).tolist())
        return Fired(index, segment.end, direction) if before * direction < -rounding else None

    def _rounding(self, index: int, t: float, x: list[float]) -> float:
        """The rounding of a guard that is zero, including what it was off zero at the start of the
        arc."""
        size = float(self.scene.rounding(self.field.guards[index], self.field)(t, x)[0])
        left = self.series is not None and self.entered[index] == 1
        return GUARD_ROUNDING * EPS * size + (2.0 * abs(self.series[1][index][0]) if left else 0.0)

    def _sunk(self, index: int, segment: Segment, stepper: Stepper, tolerance: float) -> bool:
        """Whether a guard is outside the domain though no zero was seen: it started below rounding.

        Raises
        ------
        DomainError
            If it had been inside by more than that.
        """
        guard = self.field.guards[index]
        outside = _outside(guard, self.ends.get(guard.edge, 0.0))
        if outside <= tolerance or guard.kind not in ("contact", "edge", "switch", "release"):
            return False
        t, x = self.now.t + segment.end, stepper.x.tolist()
        if outside <= self._rounding(index, t, x):
            return False
        if (
            guard.jumps
            and _outside(guard, guard.value(self.until, x)) < 0.0
            and self._ends(segment) >= 0.0
        ):
            return False  # it is about to jump
        if guard.kind == "contact":
            return True
        inside = guard.bounds and bool(self.signs) and _outside(guard, self.signs[index]) < 0
        if inside and not self.orders[index]:
            raise DomainError(
                f"{self._where(segment.end, stepper.x)}: the run is outside the mode's domain: the "
                f"guard of {guard.edge} is {guard.value(t, x):.6g} and was not seen to reach zero; "
                "a guard must be continuous, and where flights become as low as the solver's error "
                "smaller tolerances may help"
            )
        return inside

    def _tolerance(self, guard: Guard, segment: Segment, tau: float, x: StateVector) -> float:
        """The error that the tolerances allow in a guard at a state of a step, in its own unit,
        which is told from the whole way there: its states may be zero at its end."""
        rtol, size, own = self.plan.rtol, self._size(guard, x), self._terms(guard, tau, x)
        left, unit = self.plan.limit + rtol * size, size
        for before in (segment.start, 0.5 * (segment.start + tau)):
            there = segment(before)
            unit = max(unit, self._size(guard, there))
            own = max(own, self._terms(guard, before, there))
        return in_unit(left, 0.0 if guard.kind == "release" else unit, own, rtol)

    def _terms(self, guard: Guard, tau: float, x: StateVector) -> float:
        """The sum of the terms of which a guard is made."""
        return float(self.scene.rounding(guard, self.field)(self.now.t + tau, x.tolist())[0])

    def _size(self, guard: Guard, x: StateVector) -> float:
        """The size of the largest of the states that a guard is made of."""
        return max((abs(float(x[i])) for i in guard.uses), default=0.0)

    def _land(
        self, stepper: Stepper, segment: Segment, fired: Fired, again: bool = False
    ) -> Segment | None:
        """End the step on the guard, to rounding (5); None if that is where the step starts. The
        state is on the contacts held, or on the surface on which it slides.

        ``again``: whether the step has been ended before.
        """
        tau, step = fired.tau, segment
        start, longest = segment.start, 1e-6 * segment.length
        small = 1e-6 * (tau - start)
        least = start + TIE * float(np.spacing(abs(self.now.t) + start))
        last, shift = self.now.until(self.until), 0.0
        least_tau, most_tau = segment.start - longest, segment.end + longest
        if fired.cut is not None:  # a deciding function that jumps there has its zero elsewhere
            around = KINK_MOVES * segment.length
            least_tau, most_tau = tau - around, tau + around
        smooth = fired.cut is None and not self.field.guards[fired.index].jumps
        nearest = float("inf"), stepper.tau
        try:
            if again or segment.end - tau > small:
                if tau <= least:
                    return None
                segment = stepper.land(tau)
            for _ in range(LANDINGS):
                t = self.now.t + stepper.tau
                x = self._onto(fired.cut, step, stepper.tau, stepper.x)
                value, shift, exact = self._missing(fired, t, x.tolist())
                if abs(shift) <= small or exact:
                    break
                if smooth and not value < nearest[0]:  # it is flat: rounding leads away
                    segment, shift = stepper.land(nearest[1]), 0.0
                    break
                nearest = value, stepper.tau
                if not least_tau <= stepper.tau + shift <= most_tau:
                    shift = 0.0  # the guard is flat here: its zero is where the step shows it
                    break
                tau = min(stepper.tau + shift, last)
                if tau <= least:
                    return None
                segment = stepper.land(tau)
        except FlowError as fault:
            raise FlowError(f"{self._where(tau)}: {fault}") from None
        if not abs(shift) <= small or stepper.tau + shift > last:
            return segment
        stepper.x = self._onto(fired.cut, step, stepper.tau, stepper.x)
        flow = np.array(self.field.rhs(self.now.t + stepper.tau, stepper.x.tolist()))
        if fired.cut is not None:
            shift = self._short_of(fired.cut, stepper, shift, flow)
        stepper.x = stepper.x + shift * flow
        stepper.tau += shift
        return segment.cut(stepper.tau - segment.start)

    def _short_of(self, cut: Cut, stepper: Stepper, shift: float, flow: np.ndarray) -> float:
        """A shift that ends just before the place where a guard jumps, up to which dense output
        belongs to this arc."""
        back = 2.0 * float(np.spacing(abs(self.now.t) + stepper.tau))
        for _ in range(MOVES):
            there = stepper.x + (shift - back) * flow
            if (
                cut.kink.value(self.now.t + stepper.tau + shift - back, there.tolist()) * cut.side
                < 0
            ):
                break
            back *= 2.0
        return shift - back

    def _missing(self, fired: Fired, t: float, x: list[float]) -> tuple[float, float, bool]:
        """The size of a guard that fires, or of what decides on its jump; the time left to its
        zero; and whether this is exactly it."""
        if fired.cut is None:
            value, rate, _ = self.field.guards[fired.index].lie(t, x)
            exact = abs(value) <= self._rounding(fired.index, t, x)
        else:
            value, rate = self._kink_rate(fired.cut.kink, t, x)
            exact = value == 0.0
        return abs(value), (-value / rate if rate else 0.0), exact

    def _kink_rate(self, kink: Kink, t: float, x: list[float]) -> tuple[float, float]:
        """A deciding function and its rate along the flow, by a small difference."""
        step = 1e-7 * (self.now.until(self.until) or 1.0)
        flow = self.field.rhs(t, x)
        value = kink.value(t, x)
        ahead = kink.value(t + step, [v + step * f for v, f in zip(x, flow, strict=True)])
        return value, (ahead - value) / step


def _before(cut: Cut, segment: Segment) -> float:
    """The local time just before a cut in a step, on which the step before may have ended."""
    return max(segment.start + cut.before * segment.length, 0.0)


def _outside(guard: Guard, value: float) -> float:
    """How far a guard is outside the domain; negative inside, and where it bounds no domain."""
    return {Crossing.FALLING: -value, Crossing.RISING: value}.get(guard.crossing, -float("inf"))
