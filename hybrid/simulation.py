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
    start : dict, record, sequence or Trajectory
        The states at ``t[0]``, by name or in declared order. A run: go on where it ended, at
        ``t[0] = run.t1``, in its mode, with what it holds, slides on and remembers
        (``docs/runs.md``); ``run + more`` then joins them.
    t : (t0, t1)
        First and last time.
    solver : "scipy", "diffrax" or "taylor"
        Or the name of a solver that is plugged in (``docs/extending.md``).
    method : str, class or object, optional
        A method of the solver. SciPy's are DOP853 (default), RK45, RK23, Radau, BDF, LSODA, or a
        subclass of ``scipy.integrate.OdeSolver``; Diffrax's Dopri8 (default), Tsit5, Dopri5, Bosh3,
        Heun, Midpoint, Ralston, and Kvaerno3, Kvaerno4, Kvaerno5 for stiff flows, or any
        ``diffrax.AbstractSolver`` of one ``ODETerm``.
    controller : diffrax.AbstractStepSizeController, optional
        With ``solver="diffrax"``: what chooses the steps, in times from the start of each arc;
        Diffrax's ``PIDController`` with the tolerances if omitted.
    rtol, atol : float, optional
        Tolerances of the solver for each step, in shares of each element of the state and in its
        own unit; ``atol`` may be an array, one for each element. Each solver's own if omitted:
        1e-8 and 1e-10; of "taylor", whose steps are then accurate to rounding, 1e-14 and 1e-16
        where the model looks into no past.
        ``run.options`` says which they were.
    max_step : float, optional
        The longest step, in time; as long as the tolerances allow if omitted. It is for what is so
        brief that steps pass over it.
    first_step : float, optional
        The first step that is tried wherever the solver starts: at ``t[0]``, after each jump, and
        with delays where a jump, or the start, arrives. It is made shorter where the tolerances
        or the next jump ask for that. Chosen from the flow's series if omitted.
    zeno : "rest", "stop", "truncate", "raise" or "ignore"
        What happens where jumps accumulate: go on in the resting mode; end the run; permit
        at most ``max_jumps`` (or ``[1/r]``) impacts, then hold the contact; raise; simulate jumps
        one by one, as many as ``max_jumps`` permits.
    max_jumps : int, optional
        The run stops (with that status) behind this many computed jumps, in the state after the
        last; a million if omitted. With ``zeno="truncate"`` the number of impacts of a series.
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
    seed : int
        Which random numbers resets draw (``docs/chance.md``), 0 to 2^26 - 1. A run that goes on
        draws on from its own.

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
    plan = driver.plan
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
