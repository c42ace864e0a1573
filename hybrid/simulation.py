"""``hy.simulate``: check what is asked, run, hand over the trajectory."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from .automaton.base import require_model
from .delay.hindsight import Hindsight
from .lowering import Scene, scene_of
from .result import Trajectory
from .run import Driver
from .run.comparison import give_errors
from .run.onward import onward, require_end
from .run.options import Asked, mode_of, start_of
from .solvers import renamed
from .trajectory import Status
from .trajectory.stats import Stats, versions


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
    seed: int = 0,
) -> Trajectory:
    """Simulate a hybrid automaton.

    Parameters
    ----------
    model : Automaton
        An instance, ``Model(r=0.5)``.
    start : dict, record, sequence or Trajectory
        The states at ``t[0]``, by name or in declared order. If it is a run, continue where that
        ended, at ``t[0] = run.t1``, in the same mode, with the same contacts at rest and the same
        history (``docs/runs.md``); ``run + more`` then joins the two.
    t : (t0, t1)
        First and last time.
    solver : "scipy", "diffrax" or "taylor"
        What integrates the flows; also the name of a plug-in (``docs/extending.md``).
    method : str, class or object, optional
        A method of the solver. SciPy: DOP853 (default), RK45, RK23, Radau, BDF, LSODA, or a
        subclass of ``scipy.integrate.OdeSolver``. Diffrax: Dopri8 (default), Tsit5, Dopri5, Bosh3,
        Heun, Midpoint, Ralston, for stiff flows Kvaerno3, Kvaerno4, Kvaerno5, or any
        ``diffrax.AbstractSolver`` of one ``ODETerm``.
    controller : diffrax.AbstractStepSizeController, optional
        The step size controller of ``solver="diffrax"``; its times count from the start of each
        arc. Diffrax's ``PIDController`` with the tolerances if omitted.
    rtol, atol : float, optional
        Relative and absolute tolerance of each step, not of the run; ``atol`` may be an array, one
        number for each element of the state, in its unit. By default 1e-8 and 1e-10; for "taylor"
        without delays 1e-14 and 1e-16, with which steps are accurate to rounding. ``run.options``
        holds the values used.
    max_step : float, optional
        The longest step, in the unit of time; bounded by the tolerances only, if omitted. Give one
        if a force acts so briefly that a step may pass over it.
    first_step : float, optional
        The first step tried wherever the solver starts: at ``t[0]``, after each jump, and
        with delays at each breaking point. Shorter if the tolerances or the next jump require it.
        Chosen from the series of the flow if omitted.
    zeno : "rest", "stop", "truncate", "raise" or "ignore"
        What to do where jumps accumulate: continue in the resting mode; end the run; allow
        at most ``max_jumps`` (or ``[1/r]``) impacts and then hold the contact; raise an error;
        simulate the jumps one by one, up to ``max_jumps``.
    max_jumps : int, optional
        The run stops, with the status ``MAX_JUMPS``, after this many computed jumps; a million if
        omitted. With ``zeno="truncate"`` the number of impacts of a series.
    save : "dense", "jumps" or array of times
        Keep dense output; only jumps and the ends of arcs; or the states at these times.
    history : optional
        The states before ``t[0]``, for models with delays (``docs/delays.md``): a dict with a
        number or a function of time for each state, a function of time that returns all states, or
        an earlier run. Constant and equal to the start if omitted.
    memory : "keep" or "restart"
        What delayed terms see after a jump: the past as it was, or the state after the jump as a
        constant past (as if the integrator were restarted there).
    mode : str, optional
        Mode at the start; the model's initial mode if omitted.
    progress : callable ``(t)``, optional
        Called with the time reached, after each arc or after several arcs.
    seed : int
        Seed of the random numbers that resets and restitutions draw (``docs/chance.md``), 0 to
        2^26 - 1. A run that is continued keeps its sequence.

    Returns
    -------
    Trajectory

    Raises
    ------
    OptionError
        If an option cannot be used; the message lists the choices.
    StartError
        If the start is incomplete, not finite, outside the domain of the mode, or on a guard where
        no derivative decides what follows.
    ParameterError
        If a parameter has another shape than its default.
    DeclarationError
        If something that the model's functions use has changed since the class was defined.
    FlowError
        If a flow, guard or reset is not finite, or the solver gives up.
    DomainError
        If a reset leads out of the domain of its target mode.
    JumpLoopError
        If jumps follow each other without end at one time.
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
    solver, method = renamed(solver, method)
    scene = scene_of(model)
    earlier = start if isinstance(start, Trajectory) else None
    if earlier is not None:
        given = {"mode": mode, "history": history}
        require_end(earlier, scene.spec, _parameters(model, scene), t, given)
        start, mode = earlier.final, earlier.mode
        forgets = memory == "restart" and earlier.arcs[-1].t0 == earlier.t1  # just behind a jump
        history = earlier if scene.spec.lags and not forgets else None
    kept: dict[str, Any] = {"max_step": max_step, "first_step": first_step, "zeno": zeno}
    kept |= {"max_jumps": max_jumps, "memory": memory}
    steps: dict[str, Any] = {"solver": solver, "method": method, "controller": controller}
    steps |= {"rtol": rtol, "atol": atol}
    asked = Asked(spec=scene.spec, save=save, progress=progress, **steps, **kept)
    x = start_of(scene.spec, start, seed)
    driver, begins = asked.driver(scene, t, x, history), mode_of(scene, mode)
    driver.run(begins, x, None if earlier is None else onward(driver, earlier))
    give_errors(driver, solver, method, begins, x, earlier)
    asked.judge(driver)
    plan = driver.asked
    options = {
        "solver": driver.solver.name,
        "method": driver.solver.method,
        "rtol": plan.rtol,
        "atol": plan.atol,
        **kept,
        "save": save if isinstance(save, str) else "times",
        "mode": begins,
    }
    if controller is not None:
        options["controller"] = type(controller).__name__
    counts = driver.steps, driver.solver.rejected, driver.solver.evaluations
    run = _trajectory(model, scene, driver, options, earlier)
    run.stats = Stats(*counts, perf_counter() - begun)
    return run


def whole(run: Trajectory) -> Trajectory:
    """A run for what needs all of it: an interrupt goes on to the caller."""
    if run.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return run


def _parameters(model: Any, scene: Scene) -> dict[str, Any]:
    return {name: getattr(model, name) for name in scene.spec.given}


def _trajectory(
    model: Any,
    scene: Scene,
    driver: Driver,
    options: dict[str, Any],
    earlier: Trajectory | None,
) -> Trajectory:
    spec, plan, memory = scene.spec, driver.plan, driver.record.memory
    samples = None
    if plan.samples is not None:
        if plan.samples.size and plan.samples[-1] == driver.record.now.t:
            driver.record.sampled.append(driver.record.log.kept[-1].last)
        samples = np.array(driver.record.sampled).reshape(-1, spec.dimension)
        options["times"] = plan.samples[: len(samples)]
    assert driver.status is not None
    breaks = (memory.breaks.known(),) if memory else ()
    sight = Hindsight(scene, driver.history, plan.memory, driver.record.log, *breaks)
    sight.earlier = earlier
    return Trajectory(
        spec,
        _parameters(model, scene),
        driver.record.log,
        driver.record.zeno,
        driver.record.grazings,
        driver.status,
        options,
        samples,
        list(scene.paired),
        sight,
        versions=versions(),
    )
