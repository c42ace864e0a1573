"""``hy.ensemble``: many runs of one model at once, over arrays of starts and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from .automaton.spec import Spec
from .compiled.abreast import Abreast, status_of
from .compiled.ask import (
    REASONS,
    check_zeno,
    code_of,
    method_for,
    past_of,
    place,
)
from .compiled.lane import Run
from .compiled.lanes import Journey, Trip
from .compiled.past import Past
from .compiled.serial import Serial
from .compiled.turn import Turner
from .errors import OptionError, StartError
from .extras import TABLES, need
from .jit import jit
from .reals import reals
from .scene.scene import rest_name
from .solvers.base import FINEST, Solver, tolerances
from .solvers.series import TAYLOR

if TYPE_CHECKING:
    import xarray

#: Most lanes in one call, and places abreast (0: one lane after another): on a CPU if that is one
#: function of machine code, else on a CPU, and on other devices.
CHUNK = {"whole": (512, 0), "cpu": (8192, 256), "other": (1 << 17, 1 << 14)}

#: Rounds of turns between two looks from Python.
ROUNDS = 64


def ensemble(
    model: Any,
    start: Any,
    t: tuple[Any, Any],
    parameters: Mapping[str, Any] | None = None,
    *,
    solver: str = "diffrax",
    method: str | None = None,
    rtol: float | None = None,
    atol: Any = None,
    zeno: str = "rest",
    max_jumps: int | None = None,
    max_steps: int = 1_000_000,
    mode: str | None = None,
    history: Any = None,
    memory: str = "keep",
    segments: int = 256,
    progress: Callable[[int], None] | None = None,
) -> xarray.Dataset:
    """Simulate many lanes of one model: each has its own mode, verdict, rest and end.

    Parameters
    ----------
    model : Automaton
        Its parameters' values hold where ``parameters`` gives none.
    start : dict
        Each state's value: one for all lanes, or an array with the lanes as first axis.
    t : (t0, t1)
        First and last time; each a number or an array over the lanes.
    parameters : dict, optional
        Values by name, as ``start``.
    solver, method
        ``"diffrax"``, and one of its methods; if omitted Taylor, with delays and for large systems
        Dopri8.
    rtol, atol : float, optional
        Tolerances of a step, the same for all lanes: 1e-8 and 1e-10 if omitted; ``atol`` may be an
        array, one for each element of the state.
    zeno : "rest", "stop" or "ignore"
        What happens where impacts accumulate; ignored, they are simulated one by one, as many as
        ``max_jumps`` permits: without it a lane that accumulates goes on to ``max_steps``.
    max_jumps, max_steps : int
        A lane ends after so many computed jumps, or attempted steps.
    history : dict or callable, optional
        For delays: by state a number, an array over the lanes or a function of time, or one
        function of time that gives all states, written with ``jax.numpy``; the start, for ever,
        where there is none.
    memory : "keep" or "restart"
        As for :func:`hybrid.simulate`.
    segments : int
        Steps and breaking points that a lane remembers for its delays; a lane that needs more
        says so in its status.
    progress : callable ``(lanes)``, optional
        Called now and then with the number of lanes that have ended.

    Returns
    -------
    xarray.Dataset
        Over ``lane``: the time ``t`` and each state at the end, ``mode``, ``jumps`` computed,
        ``accumulations``, the first one's ``t_inf``, ``ratio`` and ``t_inf_error`` (a bound on the
        error of the sum, not of the integration before it; NaN where there is none), its
        ``verdict``, and ``status``: a lane that failed is a row with its reason. With
        ``"max_jumps"`` the state is that after the last jump.

    Raises
    ------
    OptionError, StartError, ParameterError
        If what is given cannot be used.

    Notes
    -----
    The rules are those of :func:`hybrid.simulate`, but for the finest distinctions: tangencies
    are not listed, impacts slower than the rounding of the state count as rest, and with
    ``zeno="ignore"`` the times of very slow impacts are rounding (``docs/semantics.md``). One
    program runs all lanes; on a CPU once in each core. Changing numbers, or the number of
    lanes within a power of two, does not compile anew.
    """
    need("hy.ensemble", TABLES)
    import xarray

    code = code_of(model)
    check_zeno(zeno)
    system, number, held = place(code, mode)
    bounds = np.iinfo(np.int64).max // 2 if max_jumps is None else max_jumps, max_steps
    allowed = tolerances(rtol, atol, code.spec.dimension, Solver.own_rtol)
    lanes = _Lanes(code.spec, model, start, t, dict(parameters or {}), allowed, bounds)
    if method is None and system.short_series:
        method = TAYLOR
    steps = method_for(system, solver, method)
    turner = Turner(system, steps, judged=False, sums=zeno != "ignore", many=True)
    cpu = jax.default_backend() == "cpu"
    most, places = CHUNK["other" if not cpu else "whole" if turner.whole else "cpu"]
    workers = (cpu_count() or 1) if cpu else 1
    each = min(most, -(-lanes.count // workers))
    size = _power_of_two(each)
    places = min(places, size)
    past, constants = past_of(system, steps, segments, history, memory)
    first = lanes.x if past is None else lanes.first(constants)
    make = lambda: _compiled(turner, zeno, places, past)  # noqa: E731
    if past is None or past.history is None:
        key = ("ensemble", steps, zeno, places, segments, memory)
        begin, advance = code.once(key, make)
    else:
        begin, advance = make()
    done = [0] * -(-lanes.count // each)

    def work(chunk: int) -> Any:
        count = min(each, lanes.count - chunk * each)
        run, x, before = lanes.chunk(chunk * each, size, first)
        starts = run, np.full(size, number), np.broadcast_to(held, (size, len(held))), x, before
        state = begin(starts, count)
        while True:
            state, left = advance(starts, count, state, ROUNDS)
            done[chunk] = count - int(left)
            if progress is not None:
                progress(sum(done))
            if not left:
                return jax.tree.map(lambda a: np.asarray(a)[:count], state.results)

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, range(len(done))))
    results = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    variables, attributes = _variables(code.spec, system, results)
    return xarray.Dataset(
        {name: (("lane", *dims), value) for name, (dims, value) in variables.items()},
        coords=lanes.coordinates(),
        attrs=attributes,
    )


def _power_of_two(number: int) -> int:
    return 1 << max(0, number - 1).bit_length()


def _compiled(turner: Turner, zeno: str, places: int, past: Past | None) -> tuple[Any, Any]:
    """The two programs of a chunk: begin, and go on for some rounds."""
    journey = Journey(turner, zeno, past=past)
    runner = Abreast(journey, places, _show) if places else Serial(journey, _show)

    def advance(starts: Any, count: Any, work: Any, rounds: Any) -> Any:
        work = runner.advance(starts, count, work, rounds)
        return work, runner.left(count, work)

    return jit(runner.begin), jit(advance, whole=not places)


def _show(trip: Trip) -> dict[str, Any]:
    """What is kept of a lane that has ended."""
    lane = trip.lane
    return {
        "t": lane.now,
        "x": lane.going.x,
        "mode": lane.mode,
        "held": lane.held,
        "jumps": lane.jumps,
        "steps": lane.going.steps,
        "accumulations": trip.sums,
        "t_inf": trip.t_inf,
        "t_inf_error": trip.error,
        "ratio": trip.ratio,
        "status": status_of(trip),
    }


class _Lanes:
    """What is asked of each lane, as arrays.

    Attributes
    ----------
    count : int
    x : array, shape (lanes, n)
    varied : dict
        What differs between lanes, by name.
    """

    def __init__(
        self,
        spec: Spec,
        model: Any,
        start: Any,
        t: Any,
        given: dict[str, Any],
        allowed: tuple[float, np.ndarray],
        bounds: tuple[int, int],
    ) -> None:
        self.spec = spec
        self.varied: dict[str, np.ndarray] = {}
        _check(model, given)
        states = self._states(start)
        parameters = [
            (self._array(p.name, given.get(p.name, getattr(model, p.name)), shape), shape)
            for p, shape in ((p, np.shape(p.default)) for p in spec.parameters)
        ]
        if not (isinstance(t, Sequence) and len(t) == 2):
            raise OptionError(f"t={t!r}: give (first, last) time")
        first, last = (self._array(name, v, ()) for name, v in zip(("t0", "t1"), t, strict=True))
        if not np.all(last > first):
            raise OptionError(f"t={t!r}: the first time before the last, in every lane")
        if not all(isinstance(b, int | np.integer) and b > 0 for b in bounds):
            raise OptionError("max_jumps, max_steps: whole numbers greater than 0")
        counts = {len(v) for v in self.varied.values()}
        if len(counts) > 1:
            each = ", ".join(f"{name}: {len(v)}" for name, v in self.varied.items())
            raise OptionError(f"{spec.model}: lanes differ in number ({each})")
        self.count = counts.pop() if counts else 1
        parts = [self._full(v, shape).reshape(self.count, -1) for v, shape in states]
        self.x = np.concatenate(parts, axis=1)
        self.run = Run(
            tuple(self._full(v, shape) for v, shape in parameters),
            self._full(first, ()),
            self._full(last, ()),
            self._full(np.array(max(allowed[0], FINEST)), ()),
            self._full(allowed[1], (spec.dimension,)),
            *(self._full(np.array(bound), ()) for bound in bounds),
        )

    def _states(self, start: Any) -> list[tuple[np.ndarray, tuple[int, ...]]]:
        spec = self.spec
        try:
            values = spec.values(start)
        except ValueError as fault:
            raise StartError(f"{spec.model}: start={start!r}: {fault}") from None
        pairs = zip(spec.states, values, strict=True)
        return [(self._array(f"{s.name}_start", v, s.shape), s.shape) for s, v in pairs]

    def _array(self, name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
        """A value for all lanes, or one for each."""
        where = f"{self.spec.model}: {name}"
        try:
            array = reals(value)
        except ValueError:
            raise StartError(f"{where} = {value!r} is no number") from None
        if not np.all(np.isfinite(array)):
            raise StartError(f"{where}: a value is not finite")
        own = array.ndim - len(shape)
        if own not in (0, 1) or array.shape[own:] != shape or array.size == 0:
            due = f"{shape} or (lanes, ...)" if shape else "one number, or one for each lane,"
            raise StartError(f"{where} has shape {array.shape}; {due} is due")
        if own:
            self.varied[name] = array
        return array

    def _full(self, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        return np.broadcast_to(array, (self.count, *shape))

    def first(self, constants: dict[str, Any]) -> np.ndarray:
        """The constants of a history, the start where there are none."""
        start = self.spec.record(self.x)
        given = {name: constants.get(name, start[name]) for name in self.spec.names}
        states = [
            (self._array(f"{s.name}_history", given[s.name], s.shape), s.shape)
            for s in self.spec.states
        ]
        return np.concatenate([self._full(v, s).reshape(self.count, -1) for v, s in states], axis=1)

    def chunk(self, start: int, size: int, first: np.ndarray) -> tuple[Run, np.ndarray, np.ndarray]:
        """Lanes from one on, with what was before; the last is repeated to fill up."""
        which = np.minimum(np.arange(start, start + size), self.count - 1)
        chosen: Run = jax.tree.map(lambda a: a[which], self.run)
        return chosen, self.x[which], first[which]

    def coordinates(self) -> dict[str, Any]:
        """The starts and parameters that vary."""
        return {
            name: (("lane", *(f"{name}_{i}" for i in range(v.ndim - 1))), v)
            for name, v in self.varied.items()
        }


def _check(model: Any, given: dict[str, Any]) -> None:
    """Let the model's own validators see the extremes of the parameters given."""
    import attrs

    unknown = [name for name in given if name not in {p.name for p in model.spec.parameters}]
    if unknown:
        known = ", ".join(p.name for p in model.spec.parameters) or "none"
        raise OptionError(f"parameters: {unknown[0]!r} is none of {model.spec.model}'s: {known}")
    for extreme in (np.min, np.max):
        ends = {k: extreme(v, axis=0) if np.ndim(v) else v for k, v in given.items()}
        attrs.evolve(model, **ends)


def _variables(spec: Spec, system: Any, results: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    record = spec.record(results.pop("x"))
    x = {
        s.name: (tuple(f"{s.name}_{i}" for i in range(len(s.shape))), record[s.name])
        for s in spec.states
    }
    modes, held, status = (results.pop(name) for name in ("mode", "held", "status"))
    names = [_mode_name(system, m, h) for m, h in zip(modes, held, strict=True)]
    verdict = np.where(results["accumulations"] > 0, "estimated", "")
    reasons = [REASONS[int(s)][0] for s in status]
    found = {
        **{name: ((), value) for name, value in results.items()},
        **x,
        "mode": ((), np.array(names)),
        "verdict": ((), verdict),
        "status": ((), np.array(reasons)),
    }
    return found, {"model": spec.model, **{f"status_{n}": text for n, text in REASONS.values()}}


def _mode_name(system: Any, mode: int, held: np.ndarray) -> str:
    name = system.modes[mode]
    edges = system.edges[name]
    return rest_name(name, tuple(e.name for e, h in zip(edges, held, strict=False) if h))


__all__ = ["ensemble"]
