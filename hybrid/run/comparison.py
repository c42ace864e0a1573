"""Error bounds of accumulations, measured by comparing a run with further, more accurate runs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..automaton.record import Record
from ..delay.history import unknown
from ..delay.pieces import Piece
from ..errors import HybridError
from ..lowering import Scene
from ..rules.guards import GUARD_ROUNDING, NEAR
from ..rules.sums import SUM_FLOOR
from ..rules.zeros import EPS
from ..solvers import Solver, own_rtol
from ..solvers.base import FINEST
from ..trajectory.log import Log
from ..trajectory.trajectory import Solution, Status
from ..zeno.accumulate import Tail
from ..zeno.cycle import CycleLimit
from . import Driver, Plan
from .options import chosen

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector
    from ..trajectory.accumulation import Accumulation

#: Tolerances of a run that is compared, against those of the run: of its own method, and of what
#: delays show it of the last flights before a limit, below which the record is at rest.
FINER = 1e-2

#: Relative change of the start of the third run, by which grown rounding is measured.
NUDGE = 8e-15

#: The most steps of the second run for each jump, and for each step of the first. It takes a tenth
#: of that where nothing acts briefly, and more steps than the first where the flow oscillates so
#: fast that both need one step for each oscillation.
SECOND_RUN_STEPS, STEPS_EACH, STEPS_MORE = 2000, 40, 2

#: The most jumps of the second run for each of the first, and beyond them: it sums by tighter
#: tolerances, of slow series more terms, and may never come to a sum that the first has found.
JUMPS_EACH, JUMPS_MORE = 4, 1000

#: A third run is made where the rounding of the time moves the states by more than this share of
#: them; where no force acts briefly it moves them by a few roundings.
TIME_BLUR = 1e-13


class Compared(NamedTuple):
    """What of an accumulation is compared between runs."""

    t: float
    edges: tuple[str, ...]
    state: Record
    since: float

    @classmethod
    def of(cls, point: Accumulation) -> Compared:
        """What is compared of an accumulation; ``since``: the first impact of its series."""
        return cls(point.t, point.edges, point.state, point._since)


@attrs.frozen(eq=False)
class FinishedRun:
    """What of a finished run is compared with others. Nothing else is kept, and nothing refers to
    the run.

    ``limits`` are its sums and cycles beside ``zeno``, ``jumps`` and ``steps`` their numbers;
    ``blurred`` and ``cut`` say what the check of its steps found.
    """

    scene: Scene
    plan: Plan
    history: Sequence[Piece] | None
    log: Log
    zeno: list[Compared]
    limits: list[Tail | CycleLimit | None]
    jumps: int
    steps: int
    exact: bool
    blurred: float
    cut: bool

    @classmethod
    def of(cls, driver: Driver) -> FinishedRun:
        """What a driver has left."""
        record, watched, plan = driver.record, driver.watchful, driver.asked
        zeno = [Compared.of(point) for point in record.zeno]
        found = record.log, zeno, record.tails, record.made, driver.steps
        plan = plan if plan.progress is None else attrs.evolve(plan, progress=None)
        seen = driver.solver.exact, watched.blurred, watched.cut
        return cls(driver.model, plan, driver.history, *found, *seen)

    def after(self, run: Solution) -> FinishedRun:
        """A run and this one, which went on where it ended, as one."""
        spec, jumps, sight = self.scene.spec, len(run.own_jumps), run.hindsight
        past = sight.history if sight else [unknown(spec, run.t0)] if spec.lags else None
        plan = attrs.evolve(self.plan, t0=run.t0, max_jumps=self.plan.max_jumps + jumps)
        zeno = [Compared.of(point) for point in run.zeno]
        return attrs.evolve(
            self,
            plan=plan,
            history=past,
            log=run.log.then(self.log, run.log.count),
            zeno=[*zeno, *self.zeno],
            limits=[*[None] * len(zeno), *self.limits],
            jumps=jumps + self.jumps,
            steps=self.steps + (run.stats.steps if run.stats else 0),
        )


def give_errors(
    driver: Driver,
    solver: str,
    method: Any,
    mode: str,
    x: StateVector,
    earlier: Solution | None = None,
) -> None:
    """Let each accumulation measure its error when it is asked for, by a second and a third run
    that all of them share.

    If the run continued an ``earlier`` one, these start where that one did.
    """
    if driver.record.zeno:
        made = FinishedRun.of(driver)
        while earlier is not None:
            made, mode, x = made.after(earlier), earlier.options["mode"], earlier.arcs[0].first
            earlier = earlier.hindsight.earlier if earlier.hindsight else None
        again, own = _Again(made, solver, method, mode, x), len(driver.record.zeno)
        for index, point in enumerate(driver.record.zeno, len(made.zeno) - own):
            point._errors = partial(again.errors, index)


class _Again:
    """The runs with which a run is compared, each made when it is first needed.

    Their steps are checked: each is shown to have seen all of the flow. The second run uses Taylor
    series, accurate to rounding; for a model without series, its own method at a hundredth of the
    tolerance. A run that was itself made to rounding is compared with DOP853 at its smallest
    tolerance, unless forces act so briefly that rounding matters to them. The third run repeats the
    second from a start moved by the rounding of such forces, and moves states by their last digit
    behind impacts of two contacts that alternate (:mod:`hybrid.rules.advance`): its distance from
    the second shows how much rounding grows. (A single run from the moved start would be moved
    towards the errors of the first run as often as away from them.) If no step of the second run
    had to be cut, the steps of the third are not checked.
    """

    def __init__(
        self, made: FinishedRun, solver: str, method: Any, mode: str, x: StateVector
    ) -> None:
        self.made, self.own = made, (solver, method)
        self.mode, self.x = mode, x
        self._runs: dict[tuple[str, bool], FinishedRun] = {}

    def __reduce__(self) -> Any:
        """Pickled without the runs: they are made again where they are needed."""
        return _Again, (self.made, *self.own, self.mode, self.x)

    def errors(self, index: int) -> tuple[float, Record]:
        """Bounds on the errors of an accumulation's time and state."""
        made = self.made
        parts, _ = made.log.apart()
        series = all(made.scene.field(part.mode).jets is not None for part in parts)
        name = "series" if series else "own"
        if made.exact and self._run(name, True).blurred <= TIME_BLUR:
            finest = self._run("finest")
            if _shows(finest, index, made.zeno[index]):
                return _errors(made, index, [(made, finest), (made, self._run(name, True))])
        second = self._run(name)
        return _errors(made, index, [(made, second), (second, self._run(name, True))])

    def _run(self, name: str, moved: bool = False) -> FinishedRun:
        """A run as far as it gets; what it does not reach has no bound."""
        if (name, moved) not in self._runs:
            made = self.made
            x = _nudged(made, self.mode, self.x) if moved else self.x
            plan = self._plan(name, moved)
            again = Driver(made.scene, self._solver(name), plan, made.history)
            with suppress(HybridError):
                again.run(self.mode, x)
            if again.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            self._runs[name, moved] = FinishedRun.of(again)
        return self._runs[name, moved]

    def _solver(self, name: str) -> Solver:
        plan = self.made.plan
        if name == "series":
            return chosen(attrs.evolve(plan, rtol=own_rtol("taylor")), "taylor", None)
        if name == "finest":
            # far from 0 forces are known to the rounding of the time: steps do not see less
            blur = EPS * max(abs(plan.t0), abs(plan.t1)) / (plan.t1 - plan.t0)
            plan = attrs.evolve(plan, rtol=max(FINEST, blur), atol=1e-4 * plan.atol)
            return chosen(plan, "scipy", "DOP853")
        finer = {"rtol": max(FINER * plan.rtol, 3e-14), "atol": FINER * plan.atol}
        return chosen(attrs.evolve(plan, **finer), *self.own)

    def _plan(self, name: str, moved: bool) -> Plan:
        made, alike = self.made, self._runs.get((name, False))
        plan = made.plan
        if made.scene.spec.lags:  # what delays see of the last flights before a limit
            plan = attrs.evolve(plan, rtol=FINER * plan.rtol, atol=FINER * plan.atol)
        return attrs.evolve(
            plan,
            dense=False,
            samples=None,
            accumulations=len(made.zeno),
            closing=1e-2,
            patience=4,
            watchful=SECOND_RUN_STEPS + STEPS_EACH * made.jumps + STEPS_MORE * made.steps,
            max_jumps=min(made.plan.max_jumps, JUMPS_EACH * made.jumps + JUMPS_MORE),
            trusted=alike is not None and not alike.cut,
            shaken=moved,
            zeno="rest" if made.plan.zeno == "raise" else made.plan.zeno,
        )


def _nudged(made: FinishedRun, mode: str, x: StateVector) -> StateVector:
    """The start moved by rounding, to show how rounding grows.

    A start on a guard is left where it is.
    """
    guards = made.scene.at(made.plan.t0).field(mode).guards
    values = [guard.value(made.plan.t0, x.tolist()) for guard in guards]
    if any(abs(value) <= NEAR * float(np.max(np.abs(x))) for value in values):
        return x
    flows = made.scene.spec.flows
    return np.append(x[:flows] * (1.0 + NUDGE * (-1.0) ** np.arange(flows)), x[flows:])


def _errors(
    made: FinishedRun, index: int, pairs: list[tuple[FinishedRun, FinishedRun]]
) -> tuple[float, Record]:
    """Bounds from the distances between runs; infinite where the runs do not show the same
    events."""
    point, record = made.zeno[index], made.scene.spec.record
    dimension = made.scene.spec.dimension
    if not all(_shows(run, index, point) for pair in pairs for run in pair):
        return float("inf"), record(np.full(dimension, np.inf))
    floor = 4 * SUM_FLOOR * np.sqrt(1.0 + made.jumps)
    t_error, x_error = floor * abs(point.t), floor * np.abs(_vector(point))
    x_error[made.scene.spec.flows :] = 0.0  # only jumps change it
    second = pairs[0][1].limits[_place(pairs[0][1], index, point)]
    extrapolated = [second] if isinstance(second, CycleLimit) else []  # from as few jumps
    for limit in [made.limits[index], *extrapolated]:
        if limit is not None:
            t_error, x_error = t_error + limit.t_error, x_error + limit.x_error
        if isinstance(limit, Tail):
            late = _late(made.scene, limit, point.since, made.log.first_end >= point.since)
            rates = limit.field.rhs(limit.t + limit.remaining, limit.x_inf.tolist())
            t_error, x_error = t_error + late, x_error + late * np.abs(rates)
    for pair in pairs:
        one, other = (run.zeno[_place(run, index, point)] for run in pair)
        t_error = t_error + 3 * abs(one.t - other.t)
        x_error = x_error + 3 * np.abs(_vector(one) - _vector(other))
    return float(t_error), record(x_error)


def _late(scene: Scene, tail: Tail, since: float, fresh: bool) -> float:
    """How much the limit of a sum moves by the rounding of the gap at the impacts ``since`` the
    first of the series; ``fresh``: whether that ends the first flight of the run.

    An impact at a gap of ``d`` instead of zero is ``d / u`` early, at the speed ``u``, and faster
    by ``d`` times the force over ``u``: the limit moves by ``(1 + r) / (1 - r)`` times ``d / u``.
    The impacts before it are faster by ``1 / r`` each, and move it by less; in low flights the gap
    is a coordinate of its own, and has no such rounding. Where a series begins so low, behind a
    knot or another jump, a gap of some more roundings counts as zero; speeds that are small against
    what lifts a body so high are hidden in it. No run shows that: all round a gap alike.
    """
    gap, r, x = tail.field.guards[tail.column], tail.r, tail.x.tolist()
    size, pull = float(scene.rounding(gap, tail.field)(tail.t, x)[0]), abs(gap.lie(tail.t, x)[2])
    low = (NEAR * pull * float(np.max(np.abs(tail.x[: scene.spec.flows])))) ** 0.5
    first = 0.5 * pull * (1.0 - r) * (tail.t + tail.remaining - since)
    hidden = (0.125 * pull * GUARD_ROUNDING * EPS * size) ** 0.5
    most = GUARD_ROUNDING / max(tail.v, first, hidden) if first < low and not fresh else 0.0
    early = max(1.0 / max(tail.v, min(low, first)), most)
    return EPS * size * early * r * (1.0 + r) / (1.0 - r) ** 2


def _shows(run: FinishedRun, index: int, point: Compared) -> bool:
    """Whether a run has reached the same accumulation."""
    place = _place(run, index, point)
    return place < len(run.zeno) and run.zeno[place].edges == point.edges


def _place(run: FinishedRun, index: int, point: Compared) -> int:
    """The place of an accumulation in another run: its own, or one beside it if rounding decides
    which of two limits comes first."""
    if index >= len(run.zeno):
        return index
    places = (index, index + 1, index - 1)
    known = (k for k in places if 0 <= k < len(run.zeno) and run.zeno[k].edges == point.edges)
    return next(known, index)


def _vector(point: Compared) -> Numbers:
    names = point.state.keys()
    return np.concatenate([np.ravel(point.state[name]) for name in names])
