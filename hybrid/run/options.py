"""Checks what a run is asked for: its options, start, times and history."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import cached_property
from inspect import Parameter, signature
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.chance import STREAM, has_stream, stream
from ..automaton.discrete import misfit
from ..automaton.markers import name_of
from ..automaton.reals import real, reals, short
from ..automaton.record import Record
from ..automaton.spec import Spec
from ..delay.history import pieces
from ..delay.pieces import Piece
from ..errors import OptionError, StartError, ZenoError
from ..lowering import Scene
from ..solvers import Solver, averages, choose, own_rtol
from ..solvers.base import FINEST, tolerances
from ..trajectory.accumulation import explain
from ..trajectory.plan import PATIENT
from ..trajectory.trajectory import Solution
from . import Driver, Plan

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Jumps after which a run stops if it is given no ``max_jumps``.
MAX_JUMPS = 1_000_000

ZENO = ("rest", "stop", "truncate", "raise", "ignore")


@attrs.frozen(eq=False, kw_only=True, slots=False)
class Asked:
    """The options of :func:`hybrid.simulate` but for times and history, for runs of one class."""

    spec: Spec
    solver: str
    method: Any = None
    controller: Any = None
    rtol: float | None = None
    atol: Any = None
    max_step: float | None = None
    first_step: float | None = None
    zeno: str = "rest"
    max_jumps: int | None = None
    max_steps: int | None = None
    save: Any = "dense"
    memory: str = "keep"
    progress: Callable[[float], None] | None = None

    @cached_property
    def _own(self) -> tuple[float, float]:
        """The solver's own tolerance, and the one that is taken in its place."""
        finest = own_rtol(self.solver)
        # a history of the caller's may be off by far more than rounding
        return finest, max(finest, Solver.own_rtol) if self.spec.lags else finest

    @cached_property
    def allowed(self) -> tuple[float, np.ndarray]:
        """The tolerances of a run, relative and absolute."""
        finest, own = self._own
        rtol, atol = tolerances(self.rtol, self.atol, self.spec.flows, own)
        if rtol < (least := min(finest, FINEST)):
            warnings.warn(
                f"{self.spec.model}: rtol={rtol!r} is finer than steps in double precision can be; "
                f"they keep to {least:g}",
                stacklevel=2,
            )
        if atol.shape and self.spec.discrete:
            atol = np.append(atol, [atol.max()] * len(self.spec.discrete))
        return rtol, atol

    def plan(self, t: Any) -> Plan:
        """The options of one run.

        Raises
        ------
        OptionError
            If one of them cannot be used.
        """
        rtol, atol = self.allowed
        t0, t1 = times_of(t)
        if self.zeno not in ZENO:
            raise OptionError(f"zeno={self.zeno!r}: one of {', '.join(map(repr, ZENO))}")
        for name, count in (("max_jumps", self.max_jumps), ("max_steps", self.max_steps)):
            if count is not None:
                require_count(name, count, 1, ", or None")
        if self.progress is not None and not callable(self.progress):
            raise OptionError(f"progress={self.progress!r}: a function of the time, or None")
        drawn = [contact for contact in self.spec.contacts if contact in self.spec.chances]
        if self.zeno == "truncate" and drawn:
            raise OptionError(
                f"{self.spec.model}: zeno='truncate' compares with a sum, and the impacts of "
                f"{drawn[0]}, whose restitution draws, have none; use zeno='rest' or 'ignore'"
            )
        dense, samples = _saving(self.save, t0, t1)
        cap = self.max_jumps if self.zeno == "truncate" else None
        limit = MAX_JUMPS if self.max_jumps is None or self.zeno == "truncate" else self.max_jumps
        plain = float(atol) if atol.shape == () else atol
        given = t0, t1, rtol, plain, self.zeno, limit, cap, dense, samples, self.progress
        return Plan(
            *given,
            _memory(self.memory),
            patience=sys.maxsize if self.zeno == "ignore" else PATIENT,
            max_step=_longest("max_step", self.max_step, t0, t1),
            first_step=_longest("first_step", self.first_step, t0, t1),
            max_steps=np.inf if self.max_steps is None else self.max_steps,
        )

    def driver(self, scene: Scene, t: Any, x: StateVector, history: Any) -> Driver:
        """A run that has not begun."""
        plan = self.plan(t)
        for samples in scene.samples:
            samples.require(self.spec.model, plan.t0, plan.t1)
        past = _past(self.spec, history, plan, x)
        finest, own = self._own
        made = attrs.evolve(plan, rtol=finest) if finest < plan.rtol <= own else plan
        solver = chosen(made, self.solver, self.method, self.controller, self.spec)
        return Driver(scene, solver, plan, past)

    def judge(self, driver: Driver) -> None:
        """Raise an error if jumps have accumulated and the user asked for that.

        Raises
        ------
        ZenoError
            With ``zeno="raise"``.
        """
        if self.zeno == "raise" and driver.record.zeno:
            raise ZenoError(f"{self.spec.model}: {explain(driver.record.zeno[0])}")


def chosen(
    plan: Plan, solver: str, method: Any, controller: Any = None, spec: Spec | None = None
) -> Solver:
    """The solver of a plan. Discrete variables do not enter its step size control."""
    share = 1.0
    if spec is not None and spec.discrete and averages(solver):
        share = sqrt(spec.flows / spec.dimension)
    rtol, atol = share * plan.rtol, share * plan.atol
    return choose(solver, method, rtol, atol, plan.max_step, controller)


def mode_of(scene: Scene, mode: Any) -> str:
    """The mode in which runs begin.

    Raises
    ------
    OptionError
        If there is none of that name.
    """
    begins = scene.spec.initial if mode is None else name_of(mode)
    if not isinstance(begins, str) or not scene.starts(begins):
        raise OptionError(f"{scene.spec.model}: mode={mode!r}; there are {', '.join(scene.modes)}")
    return begins


def start_of(spec: Spec, start: Any, seed: int = 0, what: str = "start") -> Numbers:
    """The state at the start, or at ``what`` it is called; a run is lane 0.

    Raises
    ------
    StartError
        If it is none.
    """
    x: list[float] = []
    for state, value in zip(spec.states, values_of(spec, start, seed, what), strict=True):
        given = f"{spec.model}: {what} {state.name}"
        try:
            array = reals(value)
        except ValueError:
            raise StartError(f"{given} = {short(value)} is no number") from None
        if array.shape != state.shape:
            raise StartError(f"{given} has shape {array.shape}; {state.shape} is due")
        wrong = misfit(state.kind, array)
        if wrong:
            raise StartError(f"{given} = {short(value)} {wrong}")
        numbers = array.ravel().tolist()
        if not all(map(isfinite, numbers)):
            raise StartError(f"{given} = {short(value)} is not finite")
        x += numbers
    return np.array(x)


def values_of(spec: Spec, start: Any, seed: int = 0, what: str = "start") -> Any:
    """What is given for each state, in declared order."""
    own, number = has_stream(start), None
    if seed != 0 and (own or not spec.chances):
        why = "the start has a stream" if own else "nothing of it takes draw"
        raise OptionError(f"{spec.model}: seed={seed!r}, but {why}; leave seed out")
    if spec.chances and not own:
        number = stream(spec.model, seed)
    if not isinstance(start, dict) and isinstance(start, Mapping | Record):
        start = {name: start[name] for name in start.keys()}
    if isinstance(start, Solution):
        raise StartError(f"{spec.model}: only hy.simulate goes on from a run; give run.final here")
    try:
        if isinstance(start, bytes | set | frozenset):
            raise ValueError("give the states by name, or in order")
        values = spec.values(start)
    except ValueError as fault:
        raise StartError(f"{spec.model}: {what}={short(start)}: {fault}") from None
    if number is not None:
        values[spec.names.index(STREAM)] = number
    return values


def _longest(name: str, value: Any, t0: float, t1: float) -> float:
    """The bound on step lengths that the user gives; infinite if he gives none."""
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


def require_taken(model: str, options: Iterable[str], *takers: Callable[..., Any]) -> None:
    """Refuse options that none of the functions takes which they are passed on to; the first of
    them is named.
    """
    parameters = (each for taker in takers for each in signature(taker).parameters.values())
    known = [each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY]
    for name in options:
        if name not in known:
            near = "".join(f"; is {n}= meant?" for n in get_close_matches(name, known, 1))
            raise OptionError(f"{model}: {name}= is no option of hy.{takers[0].__name__}{near}")


def require_count(name: str, value: Any, least: int, otherwise: str = "") -> None:
    """Refuse what is no whole number, or less than the least."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (whole and value >= least):
        raise OptionError(f"{name}={short(value)}: a whole number, {least} or more{otherwise}")


def time_of(name: str, value: Any, least: float = -np.inf) -> float:
    """A finite time that is greater than the least.

    Raises
    ------
    OptionError
        If it is none.
    """
    try:
        time = real(value)
    except ValueError:
        time = np.nan
    if not (isfinite(time) and time > least):
        more = f" greater than {least:g}" if isfinite(least) else ""
        raise OptionError(f"{name}={short(value)}: a finite time{more}")
    return time


def times_of(t: Any) -> tuple[float, float]:
    """First and last time of a run.

    Raises
    ------
    OptionError
        If they are no times, or not in this order.
    """
    try:
        t0, t1 = (real(v) for v in t)
    except (TypeError, ValueError):
        raise OptionError(
            f"t={short(t)}: give (first, last) time; times at which states are wanted go to save="
        ) from None
    if not (isfinite(t0) and isfinite(t1) and t1 > t0):
        raise OptionError(f"t={t!r}: two finite times, the first before the last")
    return t0, t1


def _saving(save: Any, t0: float, t1: float) -> tuple[bool, np.ndarray | None]:
    if isinstance(save, str):
        if save not in ("dense", "jumps"):
            raise OptionError(f"save={save!r}: 'dense', 'jumps' or an array of times")
        return save == "dense", None
    try:
        if isinstance(save, bool):
            raise ValueError("a flag")
        times = np.atleast_1d(reals(save))
    except ValueError:
        raise OptionError(f"save={short(save)}: 'dense', 'jumps' or an array of times") from None
    ordered = times.ndim == 1 and np.all(np.diff(times) > 0)
    if not ordered or not times.size or not (times[0] >= t0 and times[-1] <= t1):
        raise OptionError(f"save={short(save)}: increasing times within t = ({t0}, {t1})")
    return False, times


def _memory(memory: str) -> str:
    if memory not in ("keep", "restart"):
        raise OptionError(f"memory={memory!r}: 'keep' or 'restart'")
    return memory


def _past(spec: Spec, history: Any, plan: Plan, x: StateVector) -> list[Piece] | None:
    """The record before the run; None for a model without delays."""
    if spec.lags:
        return pieces(spec, history, plan.t0, x, plan.memory)
    if history is not None:
        raise OptionError(
            f"{spec.model}: history={history!r}, but no flow looks into the past; leave it out"
        )
    return None
