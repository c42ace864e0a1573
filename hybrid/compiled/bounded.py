"""Runs of models with delays as pure functions: every turn in array code, and bounded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..arrays import when
from ..automaton.spec import Spec
from ..errors import OptionError
from ..solvers.base import FINEST, Solver, tolerances
from .ask import check_zeno, code_of, method_for, past_of, place
from .lane import MAX_STEPS, RUNNING, Run
from .lanes import Journey, Trip, empty_log, ended
from .turn import Turner

#: Turns between two looks at whether all is done; also what a reverse pass recomputes at once.
BLOCK = 32


def bounded(
    model: Any,
    outputs: tuple[str, ...],
    max_jumps: int,
    max_steps: int,
    *,
    solver: str | None,
    method: str | None,
    rtol: float | None,
    atol: Any,
    zeno: str,
    mode: str | None,
    history: Any,
    memory: str,
    segments: int,
) -> tuple[Callable[..., Any], Any]:
    """``(parameters, x, t0, t1) -> (parts of what comes out by name, edges and count and status)``;
    and the names of the edges.

    Raises
    ------
    OptionError
        If an option cannot be used.
    """
    code = code_of(model)
    check_zeno(zeno)
    relative, absolute = tolerances(rtol, atol, code.spec.dimension, Solver.own_rtol)
    system, number, held = place(code, mode)
    steps = method_for(system, solver or "diffrax", method, "bounded")
    past, constants = past_of(system, steps, segments, history, memory)
    turner = Turner(system, steps, judged=False, sums=zeno != "ignore")
    journey = Journey(turner, zeno, carried=True, past=past)

    def fly(parameters: tuple[Any, ...], x: Any, t0: Any, t1: Any) -> tuple[dict[str, Any], Any]:
        atols = jnp.broadcast_to(jnp.asarray(absolute), code.spec.dimension)
        allowed = jnp.asarray(max(relative, FINEST)), atols
        run = Run(parameters, t0, t1, *allowed, max_jumps + 1, max_steps)
        first = _first(code.spec, constants, x)
        trip = journey.begin(run, number, jnp.asarray(held), x, first)
        trip = trip._replace(log=empty_log(max_jumps, x))
        return _parts(_bounded(journey, run, trip, max_steps + 2 * max_jumps), outputs)

    return fly, journey.edges


def _first(spec: Spec, constants: Any, x: Any) -> Any:
    """The constants of a history, the start where there are none."""
    if not constants:
        return x
    start = spec.record(x)
    values = [constants.get(name, start[name]) for name in spec.names]
    for state, value in zip(spec.states, values, strict=True):
        if jnp.shape(value) != state.shape:
            raise OptionError(
                f"{spec.model}: the history of {state.name} has shape {jnp.shape(value)}; "
                f"{state.shape} is due"
            )
    return jnp.concatenate([jnp.asarray(value, float).reshape(-1) for value in values])


def _bounded(journey: Journey, run: Run, trip: Trip, turns: int) -> Trip:
    """So many turns at least, in blocks that are skipped once all is done."""

    def one(trip: Trip, _: Any) -> tuple[Trip, None]:
        return journey.step(run, trip), None

    def block(trip: Trip) -> Trip:
        return jax.lax.scan(one, trip, length=BLOCK)[0]

    def blocks(trip: Trip, _: Any) -> tuple[Trip, None]:
        return when(~ended(run, trip), lambda: jax.checkpoint(block)(trip), trip), None

    return jax.lax.scan(blocks, trip, length=-(-turns // BLOCK))[0]


def _parts(trip: Trip, outputs: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    lane, going, log = trip.lane, trip.lane.going, trip.log
    status = jnp.where(going.status == RUNNING, MAX_STEPS, going.status)
    parts = {
        "final": {"final": going.x},
        "jumps": {"times": log.t, "before": log.before, "after": log.after},
        "zeno": {
            "t_inf": trip.t_inf,
            "x_inf": trip.x_inf,
            "ratio": trip.ratio,
            "error": trip.error,
        },
    }
    found = {"t": lane.t + (lane.low + going.tau)}
    for name in outputs:
        found |= parts[name]
    count = jnp.minimum(lane.jumps, len(log.t))
    return found, jnp.concatenate([log.edge, jnp.stack([count, status])])
