"""``hy.as_function``: a run as a pure function of model and start, inside the user's own JAX."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .arrays import when
from .automaton.spec import Spec
from .compiled.ask import check_zeno, code_of, method_for, past_of, place
from .compiled.lane import MAX_JUMPS, MAX_STEPS, RUNNING, Run
from .compiled.lanes import Journey, Trip, empty_log, ended
from .compiled.turn import Turner
from .errors import OptionError
from .solvers.base import FINEST, Solver, tolerances

#: Turns between two looks at whether all is done; also what a reverse pass recomputes at once.
BLOCK = 32

OUTPUTS = ("final", "jumps", "zeno")


class JumpTable(NamedTuple):
    """Jumps in order, ``max_jumps`` rows; unused rows hold NaN, and -1 as edge.

    ``edge`` is a place in ``function.edges``; ``before`` and ``after`` are dicts of columns.
    """

    t: Any
    edge: Any
    before: dict[str, Any]
    after: dict[str, Any]
    count: Any


class Limit(NamedTuple):
    """The first accumulation: NaN where there is none.

    ``error`` bounds the error of the sum, not that of the integration before it.
    """

    t: Any
    state: dict[str, Any]
    ratio: Any
    error: Any


class Outcome(NamedTuple):
    """What a function of :func:`as_function` returns; parts not asked for are None.

    Attributes
    ----------
    t : number
        Where the run ended: the last time, unless ``status`` says otherwise.
    final : dict
        The state there.
    jumps : JumpTable
    zeno : Limit
    status : int
        1 at the last time; the other numbers are in ``hybrid.compiled.ask.REASONS``.
    overflow : bool
        ``max_jumps`` or ``max_steps`` was too small: the run was cut.
    """

    t: Any
    final: Any
    jumps: Any
    zeno: Any
    status: Any
    overflow: Any


def as_function(
    model: Any,
    *,
    t: tuple[Any, Any],
    max_jumps: int,
    max_steps: int = 4096,
    solver: str = "diffrax",
    method: str | None = None,
    rtol: float | None = None,
    atol: Any = None,
    zeno: str = "rest",
    mode: str | None = None,
    outputs: tuple[str, ...] = OUTPUTS,
    history: Any = None,
    memory: str = "keep",
    segments: int = 256,
) -> Callable[[Any, Any], Outcome]:
    """A run as a pure function of (model, start), for ``jit``, ``vmap``, ``grad`` and ``scan``.

    Derivatives pass through jumps, accumulations and releases in forward and reverse mode
    (``docs/notes/gradients.md``). The loops are bounded, so that they can; a run that needs
    more says so in its result.

    Parameters
    ----------
    model : Automaton
        One of the class; the function takes any other of it.
    t : (t0, t1)
        First and last time; may be traced.
    max_jumps, max_steps : int
        Bounds on the jumps that are computed one by one, and on attempted steps. Memory in
        reverse mode grows with both.
    method, rtol, atol, mode
        As for :func:`hybrid.simulate` with ``solver="diffrax"``: Dopri8 if no method is named, and
        the tolerances 1e-8 and 1e-10.
    zeno : "rest", "stop" or "ignore"
        What happens where impacts accumulate; ignored, they are computed one by one.
    outputs : tuple of "final", "jumps", "zeno"
        What to return.
    history, memory, segments
        For delays, as for :func:`hybrid.ensemble`; a function of time is traced.

    Returns
    -------
    callable ``(model, start) -> Outcome``
        ``start`` is a dict (or sequence) of the states. The attribute ``edges`` names the edges.

    Raises
    ------
    OptionError
        If an option cannot be used, or JAX works in 32 bits: in a program of your own that
        is your setting to make.

    Examples
    --------
    >>> fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=16)
    >>> jax.grad(lambda e: fall(BouncingBall(r=e), {"x": 1.0, "v": 0.0}).zeno.t)(0.7)
    Array(10.03385886, dtype=float64)
    """
    code = code_of(model)
    check_zeno(zeno)
    unknown = [name for name in outputs if name not in OUTPUTS]
    if unknown:
        raise OptionError(f"outputs: {unknown[0]!r} is none of {', '.join(OUTPUTS)}")
    allowed = tolerances(rtol, atol, code.spec.dimension, Solver.own_rtol)
    system, number, held = place(code, mode)
    steps = method_for(system, solver, method, "bounded")
    past, constants = past_of(system, steps, segments, history, memory)
    turner = Turner(system, steps, judged=False, sums=zeno != "ignore")
    journey = Journey(turner, zeno, carried=True, past=past)

    def function(model: Any, start: Any) -> Outcome:
        _require_wide()
        run = _run(code.spec, model, t, allowed, max_jumps, max_steps)
        x = _vector(code.spec, start)
        first = _first(code.spec, constants, x)
        trip = journey.begin(run, number, jnp.asarray(held), x, first)
        if "jumps" in outputs:
            trip = trip._replace(log=empty_log(max_jumps, x))
        return _outcome(code.spec, _bounded(journey, run, trip, max_steps + 2 * max_jumps), outputs)

    function.edges = journey.edges  # type: ignore[attr-defined]
    return function


def _require_wide() -> None:
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise OptionError(
            "as_function works in 64 bits, and in your own JAX program that is your setting: "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )


def _run(spec: Spec, model: Any, t: Any, allowed: Any, max_jumps: int, max_steps: int) -> Run:
    if getattr(type(model), "spec", None) is not spec:
        raise OptionError(f"the function was made for {spec.model}, not for {type(model).__name__}")
    parameters = tuple(jnp.asarray(getattr(model, p.name), float) for p in spec.parameters)
    rtol = jnp.asarray(max(allowed[0], FINEST))
    atol = jnp.broadcast_to(jnp.asarray(allowed[1]), spec.dimension)
    first, last = (jnp.asarray(v, float) for v in t)
    return Run(parameters, first, last, rtol, atol, max_jumps + 1, max_steps)


def _vector(spec: Spec, start: Any) -> Any:
    values = spec.values(start if isinstance(start, Mapping) else tuple(start))
    parts = []
    for state, value in zip(spec.states, values, strict=True):
        array = jnp.asarray(value, float)
        if array.shape != state.shape:
            raise OptionError(
                f"{spec.model}: start {state.name} has shape {array.shape}; {state.shape} is due"
            )
        parts.append(array.reshape(-1))
    return jnp.concatenate(parts)


def _first(spec: Spec, constants: Any, x: Any) -> Any:
    """The constants of a history, the start where there are none."""
    if not constants:
        return x
    start = spec.record(x)
    return _vector(spec, {name: constants.get(name, start[name]) for name in spec.names})


def _bounded(journey: Journey, run: Run, trip: Trip, turns: int) -> Trip:
    """So many turns at least, in blocks that are skipped once all is done."""

    def one(trip: Trip, _: Any) -> tuple[Trip, None]:
        return journey.step(run, trip), None

    def block(trip: Trip) -> Trip:
        return jax.lax.scan(one, trip, length=BLOCK)[0]

    def blocks(trip: Trip, _: Any) -> tuple[Trip, None]:
        return when(~ended(run, trip), lambda: jax.checkpoint(block)(trip), trip), None

    return jax.lax.scan(blocks, trip, length=-(-turns // BLOCK))[0]


def _outcome(spec: Spec, trip: Trip, outputs: tuple[str, ...]) -> Outcome:
    lane, going = trip.lane, trip.lane.going
    status = jnp.where(going.status == RUNNING, MAX_STEPS, going.status)

    def named(vector: Any) -> dict[str, Any]:
        record = spec.record(vector)
        return {name: record[name] for name in record.keys()}

    jumps, log = None, trip.log
    if log is not None:
        count = jnp.minimum(lane.jumps, len(log.t))
        jumps = JumpTable(log.t, log.edge, named(log.before), named(log.after), count)
    limit = Limit(trip.t_inf, named(trip.x_inf), trip.ratio, trip.error)
    return Outcome(
        lane.t + (lane.low + going.tau),
        named(going.x) if "final" in outputs else None,
        jumps,
        limit if "zeno" in outputs else None,
        status,
        (status == MAX_JUMPS) | (status == MAX_STEPS),
    )
