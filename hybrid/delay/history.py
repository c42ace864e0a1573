"""The history of a run: constants, functions of time, or an earlier run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.record import Record
from ..automaton.spec import Spec
from ..automaton.trace import wide
from ..errors import OptionError
from ..lowering.scene import parted
from ..rules.record import SHOWN_ROUNDING
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Solution
from .pieces import Piece, constant, piece_of, slack_of

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector


@attrs.frozen(eq=False)
class Before:
    """The record before a run that continues an earlier one (:meth:`.Hindsight.before`)."""

    pieces: list[Piece]


def pieces(
    spec: Spec, history: Any, t0: float, x: StateVector, memory: str = "keep"
) -> list[Piece]:
    """The record before ``t0``, as pieces in order of time, from the ``history=`` of a run.

    Parameters
    ----------
    history : None, mapping, record, sequence, callable or Solution
        None: the start state at all times. A mapping by state, or a sequence in declared order:
        numbers, arrays or functions of time; omitted states are constant at their start value. A
        callable: a function of time that returns all states. A trajectory: its record up to ``t0``,
        preceded by its own history.
    x : array
        The state at ``t0``.
    memory : "keep" or "restart"
        Whether delays see the whole of an earlier run, or only what follows its last jump.

    Raises
    ------
    OptionError
        If the history is invalid.
    """
    if history is None:
        return [constant(x, t0)]
    if isinstance(history, Before):
        return history.pieces
    if isinstance(history, Solution):
        return _of_run(spec, history, t0, memory)
    if callable(history):
        return [_of_function(spec, partial(_all_states, spec, history), t0)]
    return [_of_states(spec, history, t0, x)]


def from_start(spec: Spec, history: Any) -> np.ndarray:
    """For each state element, whether its history is constant at its start value."""
    if isinstance(history, Mapping | Record):
        given = set(history.keys())
        parts = [np.full(state.shape, state.name not in given).reshape(-1) for state in spec.states]
        return np.concatenate(parts)
    return np.full(spec.dimension, history is None)


def _of_states(spec: Spec, history: Any, t0: float, x: StateVector) -> Piece:
    """The piece of a history that is given by state."""
    if isinstance(history, Mapping | Record):
        given = {name: history[name] for name in history.keys()}
    else:
        try:
            given = dict(zip(spec.names, spec.values(history), strict=True))
        except ValueError as fault:
            raise OptionError(f"{spec.model}: history={history!r}: {fault}") from None
    unknown = [name for name in given if name not in spec.names]
    if unknown:
        known = ", ".join(spec.names)
        raise OptionError(f"{spec.model}: history of {unknown[0]!r}; the states are {known}")
    start = spec.record(x)
    complete = {name: given.get(name, start[name]) for name in spec.names}
    if not any(callable(value) for value in complete.values()):
        return constant(_vector(spec, complete, "history"), t0)

    return _of_function(spec, partial(_state_by_state, spec, complete), t0)


def _of_function(spec: Spec, state: Callable[[float], np.ndarray], t0: float) -> Piece:
    return Piece(-np.inf, t0, partial(_called, spec, state), np.inf)


def _all_states(spec: Spec, history: Callable[[float], Any], t: float) -> np.ndarray:
    return _vector(spec, history(t), "history(t)")


def _state_by_state(spec: Spec, given: Mapping[str, Any], t: float) -> Numbers:
    now = {name: v(t) if callable(v) else v for name, v in given.items()}
    return _vector(spec, now, f"history at t = {t!r}")


def _called(spec: Spec, state: Callable[[float], np.ndarray], s: float, since: Numbers) -> Matrix:
    """The states that a function of the caller returns at the times ``s + since``."""

    def at(t: float) -> np.ndarray:
        try:
            return state(t)
        except OptionError:
            raise
        except Exception as fault:  # any exception of the caller's code
            raise OptionError(
                f"{spec.model}: history at t = {t!r}: {type(fault).__name__}: {fault}; it is "
                "evaluated as far back as the lags reach"
            ) from fault

    with wide():  # so that functions of jax.numpy return 64 bits
        return np.array([at(t) for t in (s + since).tolist()])


def _of_run(spec: Spec, run: Solution, t0: float, memory: str) -> list[Piece]:
    """The pieces of an earlier run, which must reach ``t0``, preceded by those of its history."""
    if run.spec.names != spec.names:
        theirs, own = ", ".join(run.spec.names), ", ".join(spec.names)
        raise OptionError(f"{spec.model}: history: a run with the states {theirs}, not {own}")
    if not run.t0 <= t0 <= run.t1:
        raise OptionError(
            f"{spec.model}: history: a run from {run.t0!r} to {run.t1!r}; the run that it is the "
            f"history of starts at {t0!r}"
        )
    arcs = [arc for arc in run.arcs if arc.t0 < t0]
    if memory == "restart" and len(arcs) > 1:
        found, arcs = [constant(arcs[-1].first, arcs[-1].t0)], arcs[-1:]
    else:
        found = list(run.hindsight.history if run.hindsight else ()) or [unknown(spec, run.t0)]
    end, mode = found[-1].state(run.t0, np.zeros(1))[0], ""
    for arc in arcs:
        _require_dense(spec, arc)
        made = [piece_of(segment, arc.t0, arc.low) for segment in arc.segments]
        base = parted(arc.mode)[0]
        if made:
            rounded = SHOWN_ROUNDING * np.maximum(np.abs(end), np.abs(arc.first))
            joint = np.where(np.abs(end - arc.first) <= rounded, 1, 0)
            stays = base if base == mode and run.spec is spec else ""
            made[0] = attrs.evolve(made[0], orders=joint, mode=stays)
        found += made
        end, mode = arc.last, base
    return _broken(until(found, t0), run)


def _broken(pieces: list[Piece], run: Solution) -> list[Piece]:
    """The pieces, marked with the breaking points that an earlier run had within its arcs."""
    for t, orders in zip(*run.hindsight.breaks, strict=True) if run.hindsight else ():
        near = min(range(len(pieces)), key=lambda k: abs(pieces[k].start - t))
        piece = pieces[near]
        if piece.orders is None and abs(piece.start - t) <= slack_of(t):
            pieces[near] = attrs.evolve(piece, orders=orders)
    return pieces


def until(pieces: list[Piece], t: float) -> list[Piece]:
    """The part of a record before time ``t``."""
    return [attrs.evolve(p, end=min(p.end, t)) for p in pieces if p.start < t]


def unknown(spec: Spec, end: float) -> Piece:
    """The history of a run that was loaded without it: NaN at all times before ``end``."""
    return constant(np.full(spec.dimension, np.nan), end)


def _require_dense(spec: Spec, arc: Arc) -> None:
    if not arc.segments and arc.length > 0:
        raise OptionError(f"{spec.model}: history: a run without dense output; use save='dense'")


def _vector(spec: Spec, values: Any, what: str) -> Numbers:
    try:
        parts = [np.asarray(value, dtype=float) for value in spec.values(values)]
    except (ValueError, TypeError) as fault:
        raise OptionError(f"{spec.model}: {what} = {values!r}: {fault}") from None
    for state, part in zip(spec.states, parts, strict=True):
        if part.shape != state.shape:
            raise OptionError(
                f"{spec.model}: {what}: {state.name} has shape {part.shape}; {state.shape} is due"
            )
    return np.concatenate([part.reshape(-1) for part in parts])
