"""``hy.simulate``: check what is asked, run, hand over the trajectory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from math import isfinite
from time import perf_counter
from typing import Any

import attrs
import numpy as np

from .accumulation import Accumulation, explain
from .automaton.base import require_model
from .automaton.markers import name_of
from .automaton.record import Record
from .automaton.spec import Spec
from .errors import HybridError, OptionError, StartError, ZenoError
from .hindsight import Hindsight
from .histories import pieces
from .reals import real, reals
from .rules.guards import NEAR
from .rules.sums import FLOOR
from .run import Driver, Plan
from .run.pieces import Piece
from .scene import Scene, scene_of
from .solvers import Solver, choose, own_rtol
from .solvers.base import FINEST, tolerances
from .stats import Stats, versions
from .trajectory import Status, Trajectory
from .zeno.cycle import CycleLimit

#: Relative change of the start of the third run, by which grown rounding is measured.
NUDGE = 8e-15

#: Steps of the second run, and for each jump, beside as many as the first made one by one: it takes
#: a tenth of that where nothing acts briefly.
STEPS, STEPS_EACH = 2000, 40

#: Rounding of the time in a run, against the states, from which on it is measured by a third run:
#: where no force acts briefly it is some roundings.
BLURRED = 1e-13

#: Jumps after which a run stops if it is given no ``max_jumps``.
MAX_JUMPS = 1_000_000

ZENO = ("rest", "stop", "truncate", "raise")


def simulate(
    model: Any,
    start: Any,
    t: tuple[float, float],
    *,
    solver: str = "scipy",
    method: Any = None,
    controller: Any = None,
    rtol: float | None = None,
    atol: Any = None,
    max_step: float | None = None,
    first_step: float | None = None,
    zeno: str = "rest",
    max_jumps: int | None = None,
    save: Any = "dense",
    history: Any = None,
    memory: str = "keep",
    mode: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Simulate a hybrid automaton.

    Parameters
    ----------
    model : Automaton
    start : dict, record or sequence
        The states at ``t[0]``, by name or in declared order.
    t : (t0, t1)
        First and last time.
    solver : "scipy", "diffrax" or "taylor"
        Or the name of a solver that is plugged in (``docs/extending.md``).
    method : str, class or object, optional
        A method of the solver. SciPy's are DOP853 (default), RK45, RK23, Radau, BDF, LSODA, or a
        subclass of ``scipy.integrate.OdeSolver``; Diffrax's Dopri8 (default), Tsit5, Dopri5, Bosh3,
        Heun, Midpoint, Ralston, and Kvaerno3, Kvaerno4, Kvaerno5 for stiff flows, and Taylor
        (series; no delays), or any ``diffrax.AbstractSolver`` of one ``ODETerm``.
    controller : diffrax.AbstractStepSizeController, optional
        With ``solver="diffrax"``: what chooses the steps, in times from the start of each arc;
        Diffrax's ``PIDController`` with the tolerances if omitted. Steps of an object, or with a
        controller, are made one by one; long runs of a method by name are compiled as a whole.
    rtol, atol : float, optional
        Tolerances of the solver for each step, in shares of each element of the state and in its
        own unit; ``atol`` may be an array, one for each element. Each solver's own if omitted:
        1e-8 and 1e-10; of "taylor", whose steps are then accurate to rounding, 1e-14 and 1e-16
        where the model looks into no past.
        ``run.options`` says which they were.
    max_step : float, optional
        The longest step, in time; as long as the tolerances allow if omitted. It is for what is so
        brief that steps pass over it. Plain arcs are then not compiled with ``solver="diffrax"``.
    first_step : float, optional
        The first step that is tried wherever the solver starts: at ``t[0]``, after each jump, and
        with delays where a jump, or the start, arrives. It is made shorter where the tolerances
        or the next jump ask for that. Chosen from the flow's series if omitted.
    zeno : "rest", "stop", "truncate" or "raise"
        What happens where jumps accumulate: go on in the resting mode; end the run; permit
        at most ``max_jumps`` (or ``[1/r]``) impacts, then hold the contact; raise.
    max_jumps : int, optional
        The run stops (with that status) after this many computed jumps; a million if
        omitted. With ``zeno="truncate"`` the number of impacts of a series.
    save : "dense", "jumps" or array of times
        Keep dense output; only jumps and the ends of arcs; or the states at these times.
    history : optional
        What was before ``t[0]``, for flows that look into the past (``docs/delays.md``): by state
        a number or a function of time, a function of time that gives all states, or an earlier
        run. The start, for ever, if omitted.
    memory : "keep" or "restart"
        What such flows see after a jump: the past as it was, or the state after the jump, for
        ever (what an integrator does that is started again there).
    mode : str, optional
        Mode at the start; the model's initial mode if omitted.
    progress : callable ``(t)``, optional
        Called with the time reached, after each arc, or after some that are flown in a row.

    Returns
    -------
    Trajectory

    Raises
    ------
    OptionError
        If an option cannot be used; the message lists what can.
    StartError
        If the start is incomplete, not finite, outside the mode's domain, or undecidable.
    FlowError
        If a flow, guard or reset is not finite, or the solver gives up.
    DomainError, JumpLoopError
        If a reset leaves the domain, or jumps follow each other at one time for ever.
    ZenoError
        With ``zeno="raise"``, at an accumulation.

    Examples
    --------
    >>> run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0))
    >>> run.zeno[0].t
    2.5586339655858...
    """
    begun = perf_counter()
    require_model(model)
    scene = scene_of(model)
    spec = scene.spec
    own = finest = own_rtol(solver)
    if spec.lags:  # a history of the caller's may be off by far more than rounding
        own = max(own, Solver.own_rtol)
    allowed = tolerances(rtol, atol, spec.dimension, own)
    steps = {"max_step": max_step, "first_step": first_step}
    plan = _plan(t, allowed, zeno, max_jumps, save, progress, memory, steps)
    made = attrs.evolve(plan, rtol=finest) if finest < plan.rtol <= own else plan
    x = _start(spec, start)
    past = _past(spec, history, plan, x)
    begins = spec.initial if mode is None else name_of(mode)
    if not isinstance(begins, str) or not scene.starts(begins):
        raise OptionError(f"{spec.model}: mode={mode!r}; there are {', '.join(scene.modes)}")
    driver = Driver(scene, _chosen(made, solver, method, controller), plan, past)
    driver.run(begins, x)
    _give_errors(driver, solver, method, begins, x)
    if zeno == "raise" and driver.record.zeno:
        raise ZenoError(f"{spec.model}: {explain(driver.record.zeno[0])}")
    options = {
        "solver": driver.solver.name,
        "method": driver.solver.method,
        "rtol": plan.rtol,
        "atol": plan.atol,
        "max_step": max_step,
        "first_step": first_step,
        "zeno": zeno,
        "max_jumps": max_jumps,
        "save": save if isinstance(save, str) else "times",
        "memory": memory,
        "mode": begins,
    }
    if controller is not None:
        options["controller"] = type(controller).__name__
    counts = driver.steps, driver.solver.rejected, driver.solver.evaluations
    run = _trajectory(model, scene, driver, plan, options)
    run.stats = Stats(*counts, perf_counter() - begun)
    return run


def _trajectory(
    model: Any, scene: Scene, driver: Driver, plan: Plan, options: dict[str, Any]
) -> Trajectory:
    spec = scene.spec
    samples = None
    if plan.samples is not None:
        if plan.samples.size and plan.samples[-1] == driver.record.now.t:
            driver.record.sampled.append(driver.record.log.kept[-1].last)
        samples = np.array(driver.record.sampled).reshape(-1, spec.dimension)
        options["times"] = plan.samples[: len(samples)]
    assert driver.status is not None
    parameters = {p.name: getattr(model, p.name) for p in spec.parameters}
    guards = scene.guards
    contacts = [name for name, guard in guards.items() if guard.kind == "contact"]
    return Trajectory(
        spec,
        parameters,
        driver.record.log,
        driver.record.zeno,
        driver.record.grazings,
        driver.status,
        options,
        samples,
        dict(guards),
        [pair for name in contacts for pair in scene.pairs(name)],
        Hindsight(scene, driver.history, plan.memory, driver.record.log),
        versions=versions(),
    )


def _give_errors(driver: Driver, solver: str, method: Any, mode: str, x: np.ndarray) -> None:
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
    towards the errors of the first as often as away from them.)
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
        moved = self._run(name, True)
        if driver.solver.exact and moved.watchful.blurred <= BLURRED:
            finest = self._run("finest")
            if _shows(finest, index, driver.record.zeno[index]):
                return _errors(driver, index, [(driver, finest), (driver, moved)])
        second = self._run(name)
        return _errors(driver, index, [(driver, second), (second, moved)])

    def _run(self, name: str, moved: bool = False) -> Driver:
        """A run, as far as it gets: what it does not get to has no bound."""
        if (name, moved) not in self._made:
            driver, x = self.driver, self.x
            again = Driver(driver.model, self._solver(name), self._plan(moved), driver.history)
            with suppress(HybridError):
                again.run(self.mode, _nudged(driver, self.mode, x) if moved else x)
            if again.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            self._made[name, moved] = again
        return self._made[name, moved]

    def _solver(self, name: str) -> Solver:
        plan = self.driver.plan
        if name == "series":
            return _chosen(attrs.evolve(plan, rtol=own_rtol("taylor")), "taylor", None)
        if name == "finest":
            plan = attrs.evolve(plan, rtol=FINEST, atol=1e-4 * plan.atol)
            return _chosen(plan, "scipy", "DOP853")
        finer = {"rtol": max(1e-2 * plan.rtol, 3e-14), "atol": 1e-2 * plan.atol}
        return _chosen(attrs.evolve(plan, **finer), *self.own)

    def _plan(self, moved: bool) -> Plan:
        driver = self.driver
        return attrs.evolve(
            driver.plan,
            dense=False,
            samples=None,
            progress=None,
            accumulations=len(driver.record.zeno),
            closing=1e-2,
            patience=4,
            watchful=STEPS + STEPS_EACH * driver.record.made + driver.steps,
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


# ---------------------------------------------------------------------------------------
# what the caller gives


def _plan(
    t: Any,
    allowed: tuple[float, np.ndarray],
    zeno: str,
    max_jumps: int | None,
    save: Any,
    progress: Any,
    memory: str,
    steps: dict[str, Any],
) -> Plan:
    t0, t1 = _times(t)
    rtol, atol = allowed
    if zeno not in ZENO:
        raise OptionError(f"zeno={zeno!r}: one of {', '.join(map(repr, ZENO))}")
    if max_jumps is not None and not _is_count(max_jumps):
        raise OptionError(f"max_jumps={max_jumps!r}: a whole number greater than 0, or None")
    if progress is not None and not callable(progress):
        raise OptionError(f"progress={progress!r}: a function of the time reached, or None")
    dense, samples = _saving(save, t0, t1)
    cap = max_jumps if zeno == "truncate" else None
    limit = MAX_JUMPS if max_jumps is None or zeno == "truncate" else max_jumps
    plain = float(atol) if atol.shape == () else atol
    given = t0, t1, rtol, plain, zeno, limit, cap, dense, samples, progress
    longest, first = (_longest(*each, t0, t1) for each in steps.items())
    return Plan(*given, _memory(memory), max_step=longest, first_step=first)


def _chosen(plan: Plan, solver: str, method: Any, controller: Any = None) -> Solver:
    return choose(solver, method, plan.rtol, plan.atol, plan.max_step, controller)


def _longest(name: str, value: Any, t0: float, t1: float) -> float:
    """The length to which the caller bounds steps; infinite where he does not."""
    if value is None:
        return float("inf")
    try:
        length = real(value)
    except ValueError:
        length = 0.0
    if not 0 < length < float("inf"):
        raise OptionError(f"{name}={value!r}: a finite time greater than 0, or None")
    least = float(np.spacing(max(abs(t0), abs(t1))))
    if length < least:
        raise OptionError(f"{name}={value!r}: times here are {least:.2g} apart; give a longer one")
    return length


def _is_count(value: Any) -> bool:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return whole and bool(value > 0)


def _times(t: Any) -> tuple[float, float]:
    try:
        t0, t1 = (real(v) for v in t)
    except (TypeError, ValueError):
        raise OptionError(f"t={t!r}: give (first, last) time") from None
    if not (isfinite(t0) and isfinite(t1) and t1 > t0):
        raise OptionError(f"t={t!r}: two finite times, the first before the last")
    return t0, t1


def _saving(save: Any, t0: float, t1: float) -> tuple[bool, np.ndarray | None]:
    if isinstance(save, str):
        if save not in ("dense", "jumps"):
            raise OptionError(f"save={save!r}: 'dense', 'jumps' or an array of times")
        return save == "dense", None
    try:
        times = np.atleast_1d(reals(save))
    except ValueError:
        raise OptionError(f"save={save!r}: 'dense', 'jumps' or an array of times") from None
    ordered = times.ndim == 1 and np.all(np.diff(times) > 0)
    if not ordered or not times.size or not (times[0] >= t0 and times[-1] <= t1):
        raise OptionError(f"save: increasing times within t = ({t0}, {t1})")
    return False, times


def _start(spec: Spec, start: Any) -> np.ndarray:
    if isinstance(start, Mapping | Record) and not isinstance(start, dict):
        start = {name: start[name] for name in start.keys()}
    try:
        if isinstance(start, bytes | set | frozenset):
            raise ValueError("give the states by name, or in order")
        values = spec.values(start)
    except ValueError as fault:
        raise StartError(f"{spec.model}: start={start!r}: {fault}") from None
    parts = []
    for state, value in zip(spec.states, values, strict=True):
        try:
            array = reals(value)
        except ValueError:
            raise StartError(f"{spec.model}: start {state.name} = {value!r} is no number") from None
        if array.shape != state.shape:
            raise StartError(
                f"{spec.model}: start {state.name} has shape {array.shape}; {state.shape} is due"
            )
        if not np.isfinite(array).all():
            raise StartError(f"{spec.model}: start {state.name} = {value!r} is not finite")
        parts.append(array.reshape(-1))
    return np.concatenate(parts)


def _memory(memory: str) -> str:
    if memory not in ("keep", "restart"):
        raise OptionError(f"memory={memory!r}: 'keep' or 'restart'")
    return memory


def _past(spec: Spec, history: Any, plan: Plan, x: np.ndarray) -> list[Piece] | None:
    """The record before the run; None for a model without delays."""
    if spec.lags:
        return pieces(spec, history, plan.t0, x, plan.memory)
    if history is not None:
        raise OptionError(
            f"{spec.model}: history={history!r}, but no flow looks into the past; leave it out"
        )
    return None
