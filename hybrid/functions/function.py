"""``hy.as_function``: a run as a pure function of model and start, for the user's own JAX."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jax.tree_util import register_pytree_node

from ..automaton import record
from ..automaton.base import require_model
from ..automaton.discrete import number
from ..automaton.reals import reals, short
from ..automaton.record import Record
from ..automaton.spec import Spec
from ..errors import OptionError, StartError
from ..lowering import Scene, scene_of
from ..replay.fly import at
from ..replay.function import Replay, when
from ..run.options import Asked, mode_of, require_count, times_of, values_of
from ..solvers import renamed
from .batch import Gradients, values
from .derivatives import REASON_NUMBERS, REASONS, Layout, Runs

OUTPUTS = ("final", "jumps", "zeno")

register_pytree_node(Record, record.parts, record.whole)

#: How accumulations may be passed.
ZENO_CHOICES = ("rest", "stop", "ignore")

#: Number of parameter elements above which first derivatives come from a replay, too: a gradient by
#: the weights of a network then takes 1.3 times as long as by the first variation with 205 weights,
#: and an eighth of the time with 697.
MANY_PARAMETERS = 256

#: A finite number whose square overflows.
OVERFLOWS_SQUARED = 1e300

#: The ``vmap_method`` of callbacks that take all rows at once.
ABREAST = "expand_dims"

__all__ = ["REASONS", "JumpTable", "Limit", "Outcome", "as_function"]


class JumpTable(NamedTuple):
    """Jumps in order, ``max_jumps`` rows; unused rows contain NaN, and -1 as edge.

    ``edge`` is an index into ``function.edges``; ``before`` and ``after`` are records of columns,
    ``after.v``; ``count`` is the number of jumps. Impacts of a summed series are left out.
    """

    t: Any
    edge: Any
    before: Record
    after: Record
    count: Any


class Limit(NamedTuple):
    """The first accumulation: its time, state and ratio; NaN if there is none.

    ``error`` bounds the error of the sum in ``t``, without that of the integration before it.
    """

    t: Any
    state: Record
    ratio: Any
    error: Any


class Outcome(NamedTuple):
    """The result of a function of :func:`as_function`; parts that are not in ``outputs`` are None.

    Attributes
    ----------
    t : number
        Time at which the run ended: the last time, if ``status`` is 1.
    final : Record
        The state at that time: ``final.x``.
    jumps : JumpTable
    zeno : Limit
    status : int
        1 if the last time was reached; ``hybrid.functions.REASONS`` explains the others.
    overflow : bool
        Whether the run stopped because ``max_jumps`` or ``max_steps`` was too small.
    """

    t: Any
    final: Any
    jumps: Any
    zeno: Any
    status: Any
    overflow: Any


#: ``(parameters, x, t0, t1) -> (results by name, integers)``; see :func:`.batch.values`.
Fly = Callable[[tuple[Any, ...], Any, Any, Any], tuple[dict[str, Any], Any]]


def as_function(
    model: Any,
    *,
    t: tuple[Any, Any],
    max_jumps: int,
    max_steps: int = 4096,
    solver: str | None = None,
    method: Any = None,
    controller: Any = None,
    rtol: float | None = None,
    atol: Any = None,
    max_step: float | None = None,
    first_step: float | None = None,
    zeno: str = "rest",
    mode: str | None = None,
    outputs: tuple[str, ...] = OUTPUTS,
    history: Any = None,
    memory: str = "keep",
    segments: int | None = None,
) -> Callable[[Any, Any], Outcome]:
    """A run as a pure function of (model, start), for ``jit``, ``vmap``, ``grad`` and ``scan``.

    The function is the run of :func:`hybrid.simulate`, called back from the JAX program. Its first
    derivatives come from the first variation of the run: through jumps, accumulations, rest,
    release, sliding and delays, in forward and reverse mode (``docs/notes/gradients.md``). Where
    there is no derivative (a tangency, the limit of a cycle of several edges) they are NaN. Second
    derivatives repeat the same arcs and jumps in JAX (:mod:`hybrid.replay`); there are none through
    an accumulation, a tangency or delays.

    Parameters
    ----------
    model : Automaton
        An instance of the class; the function takes any instance of it.
    t : (t0, t1)
        First and last time; may be traced.
    max_jumps, max_steps : int
        The most jumps that are computed one by one, and the most steps, counted at the end of each
        arc.
    solver, method, controller, rtol, atol, max_step, first_step, mode
        As for :func:`hybrid.simulate`. By default the solver is ``"taylor"``, or ``"scipy"`` if a
        function of the model has no series; if only a method is given, ``"diffrax"``.
    zeno : "rest", "stop" or "ignore"
        What to do when impacts accumulate: continue at rest, stop, or compute them one by one.
    outputs : tuple of "final", "jumps", "zeno"
        The parts to return.
    history, memory
        For delays, as for :func:`hybrid.simulate`. For derivatives, a given history is constant;
        states that it leaves out have the history of their start value, and vary with it.
    segments
        Has no effect: the whole past is kept.

    Returns
    -------
    callable ``(model, start) -> Outcome``
        ``start`` is a dict, record or sequence of the states. The attribute ``edges`` is the tuple
        of the names of the edges.

    Raises
    ------
    OptionError
        If an option cannot be used; when the function is called, if JAX works in 32 bits (set
        ``jax_enable_x64`` in your program).
    StartError
        When the function is called, if a state is missing or of another shape.

    Examples
    --------
    >>> fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=16)
    >>> jax.grad(lambda e: fall(BouncingBall(r=e), {"x": 1.0, "v": 0.0}).zeno.t)(0.7)
    Array(10.03385886, dtype=float64)
    """
    require_model(model)
    spec: Spec = model.spec
    _require_options(spec, t, max_jumps, zeno, outputs)
    steps: dict[str, Any] = {"solver": solver, "method": method, "controller": controller}
    steps |= {"rtol": rtol, "atol": atol, "max_step": max_step, "first_step": first_step}
    steps |= {"zeno": zeno, "mode": mode}
    runs = runs_of(model, outputs, max_jumps, max_steps, history, memory=memory, **steps)
    fly = _called(runs)

    def whole(parameters: tuple[Any, ...], start: tuple[Any, ...], t: tuple[Any, ...]) -> Outcome:
        return _outcome(spec, *fly(parameters, _vector(spec, start), *t))

    compiled = jax.jit(whole)  # else each operation would be dispatched on its own

    def function(model: Any, start: Any) -> Outcome:
        _require_wide()
        given = _parameters(spec, model, runs.samples), _values(spec, start), tuple(t)
        return compiled(*(tuple(map(_number, numbers)) for numbers in given))  # type: ignore[no-any-return]

    function.edges = runs.edges  # type: ignore[attr-defined]
    return function


def _require_options(spec: Spec, t: Any, max_jumps: Any, zeno: Any, outputs: Any) -> None:
    """Raise an :class:`OptionError` for options that :func:`hybrid.simulate` does not check."""
    unknown = [name for name in outputs if name not in OUTPUTS]
    if isinstance(outputs, str) or unknown:
        raise OptionError(
            f"{spec.model}: outputs={short(outputs)}: a tuple of some of {', '.join(OUTPUTS)}"
        )
    if zeno not in ZENO_CHOICES:
        raise OptionError(
            f"{spec.model}: zeno={zeno!r}: functions know 'rest', 'stop' and 'ignore' (impacts one "
            "by one); for 'truncate' and 'raise' use hy.simulate"
        )
    require_count("max_jumps", max_jumps, 0)
    if not (isinstance(t, tuple | list) and any(isinstance(end, jax.core.Tracer) for end in t)):
        times_of(t)


def _require_wide() -> None:
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise OptionError(
            "as_function works in 64 bits, and in your own JAX program that is your setting: "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )


def _number(value: Any) -> Any:
    """A value as an array of 64 bits."""
    traced = isinstance(value, jax.Array | list | tuple)
    return (jnp if traced else np).asarray(value, float)


def _parameters(spec: Spec, model: Any, samples: Sequence[Any]) -> tuple[Any, ...]:
    if getattr(type(model), "spec", None) is not spec:
        raise OptionError(f"the function was made for {spec.model}, not for {type(model).__name__}")
    for signal, known in zip(spec.signals, samples, strict=True):
        if getattr(model, signal.name) != known:
            raise OptionError(
                f"{spec.model}: the function was made with other data of {signal.name}; make one "
                "for each"
            )
    return tuple(getattr(model, p.name) for p in spec.parameters)


def _values(spec: Spec, start: Any) -> tuple[Any, ...]:
    """The start value of each state; checked as by ``hy.simulate``, unless one is traced."""
    if not any(isinstance(value, jax.core.Tracer) for value in jax.tree.leaves(start)):
        values = tuple(values_of(spec, start))
        for state, value in zip(spec.states, values, strict=True):
            _require_numbers(spec, state.name, value)
        return values
    try:
        return tuple(spec.values(start if isinstance(start, Mapping | Record) else tuple(start)))
    except (TypeError, ValueError) as fault:
        raise StartError(f"{spec.model}: start: {fault}") from None


def _require_numbers(spec: Spec, name: str, value: Any) -> None:
    try:
        reals(value)
    except ValueError:
        raise StartError(f"{spec.model}: start {name} = {short(value)} is no number") from None


def _vector(spec: Spec, start: tuple[Any, ...]) -> Any:
    parts = []
    for state, value in zip(spec.states, start, strict=True):
        if value.shape != state.shape:
            raise StartError(
                f"{spec.model}: start {state.name} has shape {value.shape}; {state.shape} is due"
            )
        parts.append(value.reshape(-1))
    return jnp.concatenate(parts)


def _outcome(spec: Spec, parts: dict[str, Any], ints: Any) -> Outcome:
    named = partial(spec.record, of=number)
    status, jumps, limit = ints[-1], None, None
    if "times" in parts:
        states = named(parts["before"]), named(parts["after"])
        jumps = JumpTable(parts["times"], ints[:-2], *states, ints[-2])
    if "t_inf" in parts:
        limit = Limit(parts["t_inf"], named(parts["x_inf"]), parts["ratio"], parts["error"])
    final = named(parts["final"]) if "final" in parts else None
    cut = (status == REASON_NUMBERS["max_jumps"]) | (status == REASON_NUMBERS["max_steps"])
    return Outcome(parts["t"], final, jumps, limit, status, cut)


# ---------------------------------------------------------------------------------------
# the run, called back


def runs_of(
    model: Any,
    outputs: tuple[str, ...],
    max_jumps: int,
    max_steps: int,
    history: Any = None,
    *,
    solver: str | None = None,
    method: Any = None,
    mode: Any = None,
    **steps: Any,
) -> Runs:
    """The runs of a model's class, with the options of :func:`as_function`."""
    scene = scene_of(model)
    series = all(scene.field(name).jets is not None for name in scene.modes)
    named = solver or ("diffrax" if method is not None else "taylor" if series else "scipy")
    named, method = renamed(named, method)
    bounds: dict[str, Any] = {"max_jumps": max_jumps + 1, "max_steps": max_steps}
    asked = Asked(spec=scene.spec, solver=named, method=method, **steps, **bounds)
    asked.driver(scene, _within(scene), np.zeros(scene.spec.dimension), history)  # checks options
    own = scene.code.shapes[: len(scene.spec.parameters)]
    layout = Layout(scene.spec.dimension, max_jumps, tuple(outputs))
    known = type(model), asked, mode_of(scene, mode), own, _edges(scene), layout
    return Runs(*known, history, scene.samples)


def _within(scene: Scene) -> tuple[float, float]:
    """Two times at which all signals have data."""
    first = max((each.times[0] for each in scene.samples), default=0.0)
    last = min((each.times[-1] for each in scene.samples), default=1.0)
    return (float(first), float(last)) if first < last else (0.0, 1.0)


def _edges(scene: Scene) -> tuple[str, ...]:
    """The names of all edges, contacts, switchings, releases and clocks."""
    slides = [switching.mode for switching in scene.spec.switchings if switching.slides]
    modes = [*(mode.name for mode in scene.spec.modes), *slides]
    watched = (name for m in modes for name in scene.code.mode(m).watched(True))
    return tuple(dict.fromkeys((*watched, *(clock.name for clock in scene.spec.clocks))))


def _called(runs: Runs) -> Fly:
    """The runs as a JAX function of arrays of parameters, start and times."""
    whole = _differentiable(runs)

    def fly(parameters: tuple[Any, ...], x: Any, t0: Any, t1: Any) -> tuple[dict[str, Any], Any]:
        shapes = tuple(p.shape for p in parameters)
        if shapes != runs.shapes:
            raise OptionError(f"parameters of shapes {shapes}; {runs.shapes} are due")
        row = jnp.concatenate([*(p.reshape(-1) for p in parameters), x, t0[None], t1[None]])
        numbers, ints = whole(row)
        return runs.layout.views(numbers), ints

    return fly


def _differentiable(runs: Runs) -> Callable[[Any], tuple[Any, Any]]:
    """The results of runs as a function of a row of numbers, with first and second derivatives."""
    length, ints, varied = runs.layout.length, runs.layout.rows + 2, Gradients(runs)
    given = jax.ShapeDtypeStruct((length,), float), jax.ShapeDtypeStruct((ints,), int)

    def whole(row: Any) -> Any:
        return jax.pure_callback(partial(values, runs), given, row, vmap_method=ABREAST)

    def first(row: Any) -> Any:
        slopes = jax.ShapeDtypeStruct((length, *row.shape), float)
        shapes = *given, slopes
        return jax.pure_callback(varied, shapes, row, vmap_method=ABREAST)

    def second(rows: Any, changes: Any) -> Any:
        numbers, whole_numbers, slopes = once(*rows)
        replay = _replay(runs)
        flies, plan = replay.plan(*rows)
        flown = jax.jacfwd(jax.jacfwd(partial(replay.fly, plan)))(*rows)
        bends = _along(jnp.where(flies, flown, jnp.nan), *changes)
        still = np.zeros(whole_numbers.shape, jax.dtypes.float0)
        return (numbers, whole_numbers, slopes), (_along(slopes, *changes), still, bends)

    once = jax.custom_jvp(first)
    once.defjvp(second)

    def rule(rows: Any, changes: Any) -> Any:
        numbers, whole_numbers, slopes = once(*rows)
        still = np.zeros(whole_numbers.shape, jax.dtypes.float0)
        return (numbers, whole_numbers), (_along(slopes, *changes), still)

    found = jax.custom_jvp(whole)
    found.defjvp(rule)
    many = (
        not (runs.asked.spec.lags or runs.samples)
        and sum(map(math.prod, runs.shapes)) > MANY_PARAMETERS
    )
    return _by_replay(runs, given, found) if many and _replay(runs).written else found


def _by_replay(runs: Runs, given: tuple[Any, ...], found: Any) -> Callable[[Any], tuple[Any, Any]]:
    """The function ``found``, with all derivatives from a replay if the run has one."""

    def by_replay(row: Any) -> Any:
        replay = _replay(runs)
        shapes = *given, jax.ShapeDtypeStruct((), bool), *replay.given
        call, held = partial(_each, runs.planned), stop_gradient(row)
        numbers, whole_numbers, flies, *plan = jax.pure_callback(
            call, shapes, held, vmap_method=ABREAST
        )
        nothing = _along(jnp.where(jnp.isnan(numbers), jnp.nan, 0.0)[:, None], row - held)
        flown = at(numbers, replay.fly(plan, row)) + nothing
        return when(~flies, lambda: found(row)[0], flown), whole_numbers

    return by_replay


def _replay(runs: Runs) -> Replay:
    """The replays of runs; raises an :class:`OptionError` with delays or signals."""
    if runs.asked.spec.lags:
        raise OptionError(
            f"{runs.asked.spec.model} looks into the past: its runs have first derivatives only, "
            "and a second one was asked for; take differences of the first"
        )
    if runs.samples:
        raise OptionError(
            f"{runs.asked.spec.model} has signals: its runs have first derivatives only, and a "
            "second one was asked for; take differences of the first"
        )
    layout, ask = runs.layout, partial(_each, runs.plan)
    return Replay(runs.cls, runs.shapes, layout.shapes, layout.rows, runs.room, ask)


def _each(call: Callable[[np.ndarray], tuple[np.ndarray, ...]], rows: Any) -> Any:
    """Call a function of one row for each of many; returns its results, stacked."""
    rows = np.asarray(rows)
    found = [call(row) for row in rows.reshape(-1, rows.shape[-1])]
    columns = zip(*found, strict=True)
    return tuple(np.array(c).reshape(rows.shape[:-1] + c[0].shape) for c in columns)


def _along(slopes: Any, change: Any) -> Any:
    """Directional derivatives ``slopes @ change``; NaN only where a NaN of ``slopes`` is used.

    In reverse mode the cotangent of an unused result is 0, and 0 times NaN is NaN, which would
    spoil the whole gradient. A NaN is therefore replaced by factors that map 0 to 0 and any other
    number to NaN, forward and transposed: first to infinity by overflow, then times 0.
    """
    none = jnp.isnan(slopes)
    far, known = jnp.where(none, OVERFLOWS_SQUARED, 1.0), jnp.where(none, 0.0, slopes)
    return jnp.sum(change * far * far * known * far * far, axis=-1)
