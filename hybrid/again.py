"""The runs with which a run is compared: what its accumulations may be off."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import attrs
import numpy as np

from .accumulation import Accumulation
from .asked import chosen
from .automaton.record import Record
from .errors import HybridError
from .events import EPS
from .rules.guards import NEAR
from .rules.sums import FLOOR
from .run import Driver, Plan
from .solvers import Solver, own_rtol
from .solvers.base import FINEST
from .trajectory import Status
from .zeno.cycle import CycleLimit

#: Relative change of the start of the third run, by which grown rounding is measured.
NUDGE = 8e-15

#: Steps of the second run, for each jump, and for each step that the first made one by one: it
#: takes a tenth of that where nothing acts briefly, and more steps than the first where the flow
#: swings so fast that both need one for a swing.
STEPS, STEPS_EACH, STEPS_MORE = 2000, 40, 2

#: Rounding of the time in a run, against the states, from which on it is measured by a third run:
#: where no force acts briefly it is some roundings.
BLURRED = 1e-13


def give_errors(driver: Driver, solver: str, method: Any, mode: str, x: np.ndarray) -> None:
    """Let each accumulation measure its error when asked: by a second and a third run for all."""
    again = _Again(driver, solver, method, mode, x)
    for index, point in enumerate(driver.record.zeno):
        point._errors = lambda index=index: again.errors(index)


class _Again:
    """The runs with which a run is compared, each made once, when it is first needed.

    They are watched: each step is shown to have seen all of the flow. The second run uses Taylor
    series, accurate to rounding; a model without them its own method at a hundredth of its
    tolerance; and a run that was itself made to rounding is compared with DOP853 at its smallest
    tolerance, unless forces act so briefly that rounding matters to them. The third run is the
    same from beside the start, moved by what rounding does to such forces: how far it goes
    from the run that is not moved shows what rounding grows to. (One run for both would be moved
    towards the errors of the first as often as away from them.) Where that one has been watched and
    no step of it had to be cut, this one needs no watch: what it steps over is a difference.
    """

    def __init__(self, driver: Driver, solver: str, method: Any, mode: str, x: np.ndarray) -> None:
        self.driver, self.own = driver, (solver, method)
        self.mode, self.x = mode, x
        self._made: dict[tuple[str, bool], Driver] = {}

    def errors(self, index: int) -> tuple[float, Record]:
        """Bounds on the errors of an accumulation's time and state."""
        driver = self.driver
        parts, _ = driver.record.log.apart()
        series = all(driver.scene.field(part.mode).jets is not None for part in parts)
        name = "series" if series else "own"
        if driver.solver.exact and self._run(name, True).watchful.blurred <= BLURRED:
            finest = self._run("finest")
            if _shows(finest, index, driver.record.zeno[index]):
                pairs = [(driver, finest), (driver, self._run(name, True))]
                return _errors(driver, index, pairs)
        second = self._run(name)
        pairs = [(driver, second), (second, self._run(name, True))]
        return _errors(driver, index, pairs)

    def _run(self, name: str, moved: bool = False) -> Driver:
        """A run, as far as it gets: what it does not get to has no bound."""
        if (name, moved) not in self._made:
            driver, x = self.driver, self.x
            again = Driver(
                driver.model, self._solver(name), self._plan(name, moved), driver.history
            )
            with suppress(HybridError):
                again.run(self.mode, _nudged(driver, self.mode, x) if moved else x)
            if again.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            self._made[name, moved] = again
        return self._made[name, moved]

    def _solver(self, name: str) -> Solver:
        plan = self.driver.plan
        if name == "series":
            return chosen(attrs.evolve(plan, rtol=own_rtol("taylor")), "taylor", None)
        if name == "finest":
            # far from 0 forces are known to the rounding of the time: steps do not see less
            blur = EPS * max(abs(plan.t0), abs(plan.t1)) / (plan.t1 - plan.t0)
            plan = attrs.evolve(plan, rtol=max(FINEST, blur), atol=1e-4 * plan.atol)
            return chosen(plan, "scipy", "DOP853")
        finer = {"rtol": max(1e-2 * plan.rtol, 3e-14), "atol": 1e-2 * plan.atol}
        return chosen(attrs.evolve(plan, **finer), *self.own)

    def _plan(self, name: str, moved: bool) -> Plan:
        driver, alike = self.driver, self._made.get((name, False))
        return attrs.evolve(
            driver.plan,
            dense=False,
            samples=None,
            progress=None,
            accumulations=len(driver.record.zeno),
            closing=1e-2,
            patience=4,
            watchful=STEPS + STEPS_EACH * driver.record.made + STEPS_MORE * driver.steps,
            trusted=alike is not None and not alike.watchful.cut,
            shaken=moved,
            zeno="rest" if driver.plan.zeno == "raise" else driver.plan.zeno,
        )


def _nudged(driver: Driver, mode: str, x: np.ndarray) -> np.ndarray:
    """The start moved by rounding, so that what rounding grows to is seen as well.

    A start on a guard is left where it is.
    """
    guards = driver.scene.field(mode).guards
    values = [guard.value(driver.plan.t0, x.tolist()) for guard in guards]
    if any(abs(value) <= NEAR * float(np.max(np.abs(x))) for value in values):
        return x
    return x * (1.0 + NUDGE * (-1.0) ** np.arange(len(x)))


def _errors(driver: Driver, index: int, pairs: list[tuple[Driver, Driver]]) -> tuple[float, Record]:
    """Bounds from the distances between runs; infinite where they do not show the same."""
    point, record = driver.record.zeno[index], driver.scene.spec.record
    dimension = driver.scene.spec.dimension
    if not all(_shows(run, index, point) for pair in pairs for run in pair):
        return float("inf"), record(np.full(dimension, np.inf))
    floor = 4 * FLOOR * np.sqrt(1.0 + driver.record.made)
    t_error, x_error = floor * abs(point.t), floor * np.abs(_vector(point))
    second = pairs[0][1].record.tails[index]
    extrapolated = [second] if isinstance(second, CycleLimit) else []  # from as few jumps
    for limit in [driver.record.tails[index], *extrapolated]:
        if limit is not None:
            t_error, x_error = t_error + limit.t_error, x_error + limit.x_error
    for pair in pairs:
        one, other = (run.record.zeno[index] for run in pair)
        t_error = t_error + 3 * abs(one.t - other.t)
        x_error = x_error + 3 * np.abs(_vector(one) - _vector(other))
    return float(t_error), record(x_error)


def _shows(run: Driver, index: int, point: Accumulation) -> bool:
    """Whether a run has come to the same accumulation."""
    zeno = run.record.zeno
    return index < len(zeno) and zeno[index].edges == point.edges


def _vector(point: Accumulation) -> np.ndarray:
    return np.concatenate([np.ravel(value) for value in point.state])
