"""Diffrax's Runge-Kutta methods, one compiled step at a time.

A step is Diffrax's own: its tables (or, of an implicit method, its ``step``), its step size
controller, its interpolant. :class:`Method` writes one attempt of it as a pure function of
arrays; here it is compiled alone, for one arc flown from Python, and :mod:`hybrid.compiled`
compiles it together with events and jumps. Parameters, start, time and tolerances are
arguments of what is compiled: changing a number does not compile again.
"""

from __future__ import annotations

from functools import cache
from math import isfinite
from typing import Any, NamedTuple

import attrs
import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..arrays import chebyshev
from ..automaton.trace import again
from ..errors import FlowError, OptionError, TraceError
from ..jit import jit
from ..scene import Field
from ..segment import Segment, apply, from_values, integrals, interpolated, nodes
from .base import FINEST, Solver, Stepper, method_of
from .series import ORDER, SHORTEST, TAYLOR, Ahead, Series, expansion

#: Degree of each method's dense output in the fraction of the step; the first is the default.
DEGREES = {
    "Dopri8": 8,
    "Tsit5": 4,
    "Dopri5": 4,
    "Bosh3": 3,
    "Heun": 3,
    "Midpoint": 3,
    "Ralston": 3,
    "Kvaerno3": 3,
    "Kvaerno4": 3,
    "Kvaerno5": 3,
    TAYLOR: ORDER,
}

#: Sweeps of Picard's iteration that raise an interpolant to the order of its method.
SWEEPS = {"Dopri8": 2}

#: Most attempts between two looks from Python.
ATTEMPTS = 100_000


class Sampled(NamedTuple):
    """A step as the states at ``nodes(degree)``, shape ``(degree + 1, n)``."""

    states: Any

    def at(self, share: Any) -> Any:
        """The state at a share of the step; one that stays the same stays so exactly."""
        degree, first = len(self.states) - 1, self.states[0]
        moved = jnp.asarray(from_values(degree)) @ (self.states - first)
        return first + chebyshev(share, degree) @ moved

    def values(self) -> Any:
        """The states at the nodes."""
        return self.states


@attrs.frozen
class Method:
    """A Diffrax method, as a pure function that attempts one step.

    ``scan`` is how Diffrax loops over an implicit method's stages: ``"bounded"`` can be
    differentiated both ways, None is faster.
    """

    name: str
    scan: str | None = None

    @property
    def degree(self) -> int:
        return DEGREES[self.name]

    @property
    def dense(self) -> bool:
        """Whether the dense output is as accurate as a step: events need not be stepped onto."""
        return self.name in SWEEPS

    @property
    def implicit(self) -> bool:
        return self.name.startswith("Kvaerno")

    @property
    def order(self) -> int:
        """Order of the method."""
        return _order(self)

    def solver(self, rtol: Any, atol: Any) -> Any:
        """Diffrax's solver; the tolerances are those of an implicit method's equations."""
        if not self.implicit:
            return getattr(diffrax, self.name)()
        roots = diffrax.VeryChord(rtol=rtol, atol=jnp.min(atol))
        return getattr(diffrax, self.name)(root_finder=roots, scan_kind=self.scan)

    def attempt(
        self, flow: Any, tau: Any, h: Any, x: Any, rtol: Any, atol: Any, expand: Any = None
    ) -> tuple[Any, Any, Any, Any, Any]:
        """One step of length ``h`` from local time ``tau``.

        Parameters
        ----------
        flow : callable ``(tau, x)``

        Returns
        -------
        x, kept, h, next_h, path
            The state at its end; whether the error is within the tolerances; its length; the
            length to try next; its dense output.
        """
        step = self._implicit if self.implicit else self._explicit
        end, error, values = step(flow, tau, h, x, rtol, atol)
        error = jnp.where(jnp.all(jnp.isfinite(end + error)), error, jnp.inf)
        control = diffrax.PIDController(rtol=rtol, atol=atol)
        state = (jnp.array(1.0), jnp.array(1.0), False)
        order = self.solver(rtol, atol).error_order(_TERM)
        kept, begin, stop, *_ = control.adapt_step_size(
            jnp.zeros_like(h), h, x, end, None, error, order, state
        )
        values = self._swept(flow, tau, h, x, end, values)
        values = jnp.concatenate([x[None], values[1:-1], end[None]])
        return end, kept, h, stop - begin, Sampled(values)

    def _explicit(
        self, flow: Any, tau: Any, h: Any, x: Any, rtol: Any, atol: Any
    ) -> tuple[Any, Any, Any]:
        """State, error, states at the nodes after a step with the numbers of Diffrax's table.

        Diffrax's own loop over the stages costs several times as much where the flow is small.
        """
        table = _table(self.name)

        def stage(i: Any, rates: Any) -> Any:
            y = x + (jnp.asarray(table.stages)[i][:, None] * rates).sum(axis=0)
            return rates.at[i].set(h * flow(tau + jnp.asarray(table.c)[i] * h, y))

        count = len(table.c)
        rates = jax.lax.fori_loop(0, count, stage, jnp.zeros((count, len(x))))
        end, error = x + apply(table.end[None], rates)[0], apply(table.error[None], rates)[0]
        moved = apply(table.nodes[:, 1:], jnp.concatenate([(end - x)[None], rates]))
        return end, error, x + moved

    def _implicit(
        self, flow: Any, tau: Any, h: Any, x: Any, rtol: Any, atol: Any
    ) -> tuple[Any, Any, Any]:
        """The same by Diffrax's own ``step``."""
        solver = self.solver(rtol, atol)
        term = diffrax.ODETerm(lambda t, y, args: flow(t, y))
        begins = (jnp.asarray(True), jnp.zeros_like(x)) if solver.tableau.fsal else None
        end, error, dense, *_ = solver.step(term, tau, tau + h, x, None, begins, jnp.array(False))
        path = solver.interpolation_cls(t0=jnp.zeros_like(h), t1=h, **dense)
        values = jax.vmap(lambda s: path.evaluate(s * h))(jnp.asarray(nodes(self.degree)))
        return end, error, values

    def _swept(self, flow: Any, tau: Any, h: Any, x: Any, end: Any, values: Any) -> Any:
        """The interpolant, brought nearer to the solution between the ends of the step.

        Each sweep integrates the flow along it, which gains an order, and meets the end again.
        """
        s = jnp.asarray(nodes(self.degree))
        for _ in range(SWEEPS.get(self.name, 0)):
            rates = jax.vmap(flow)(tau + h * s, values)
            values = x + h * apply(integrals(self.degree), rates)
            values = values + s[:, None] * (end - values[-1])
        return values


def compiled_method(name: str, scan: str | None = None) -> Any:
    """A method by name: one of Diffrax's, or Taylor series."""
    return Series() if name == TAYLOR else Method(name, scan)


def without_series(model: str, reason: Any) -> OptionError:
    """What is said where Taylor series are asked for and there are none."""
    others = ", ".join(name for name in DEGREES if name != TAYLOR)
    return OptionError(f"{model}: method={TAYLOR!r}: {reason}; use another method ({others})")


_TERM = diffrax.ODETerm(lambda t, y, args: y)


@cache
def _order(method: Method) -> int:
    return int(method.solver(1e-6, 1e-6).order(_TERM))


class _Table(NamedTuple):
    """Numbers of an explicit method.

    ``nodes`` gives the states at the nodes from those at both ends and the stages: the
    interpolant is linear in them, and Diffrax's own is asked for unit vectors.
    """

    c: np.ndarray
    stages: np.ndarray
    end: np.ndarray
    error: np.ndarray
    nodes: np.ndarray


@cache
def _table(name: str) -> _Table:
    own = getattr(diffrax, name).tableau
    stages = np.zeros((len(own.b_sol), len(own.b_sol)))
    for i, row in enumerate(own.a_lower):
        stages[i + 1, : i + 1] = row
    interpolant = Method(name).solver(1e-6, 1e-6).interpolation_cls

    def at_nodes(units: Any, points: Any, t0: Any, t1: Any) -> Any:
        ends = {"t0": t0, "t1": t1, "y0": units[0], "y1": units[1]}
        return jax.vmap(interpolant(k=units[2:], **ends).evaluate)(points)

    with jax.ensure_compile_time_eval():
        units, points = np.eye(2 + len(stages)), nodes(DEGREES[name])
        weights = np.asarray(jit(at_nodes)(units, points, 0.0, 1.0))
    c = np.concatenate([[0.0], own.c])
    return _Table(c, stages, np.array(own.b_sol), np.array(own.b_error), weights)


class DiffraxSolver(Solver):
    """One of Diffrax's methods: Dopri8 (default), Tsit5, Dopri5, Bosh3, Kvaerno5, ..."""

    name = "diffrax"

    def __init__(self, method: str | None, rtol: float, atol: Any) -> None:
        self.method = method_of(self.name, method, DEGREES)
        self.compiled = compiled_method(self.method)
        self.asked = self.method != TAYLOR and not self.compiled.implicit
        self.order = self.compiled.order
        self.rtol, self.atol = max(rtol, FINEST), atol
        self.rejected = 0

    def begin(
        self,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        return DiffraxStepper(self, field, t0, x0, first_step or min(length, 1e-3))


class DiffraxStepper(Stepper):
    """Steps along one arc, each a call of a compiled function."""

    repeats = True

    def __init__(
        self, solver: DiffraxSolver, field: Field, t0: float, x0: np.ndarray, first: float
    ) -> None:
        self.field, self.method, self.counts = field, solver.compiled, solver
        self.tau, self.x, self.h = 0.0, x0, first
        self.fixed = (field.parameters, t0)
        self.tolerances = (solver.rtol, np.broadcast_to(solver.atol, x0.shape).astype(float))
        key = ("diffrax", field.name, self.method)
        self._call = field.code.once(key, lambda: _compiled(self.method, field))

    def step(self, limit: float) -> None:
        self._before = (self.tau, self.x)
        self._towards(limit, False)

    def land(self, tau: float) -> Segment:
        """Step again from where the last step began, onto ``tau``, in one step."""
        self.tau, self.x = self._before
        h, self.h = self.h, tau - self.tau
        self._towards(tau, True)
        self.h = h
        return self.segment()

    def finish(self, length: float) -> int:
        """Diffrax's own loop, so many attempts at a time."""
        key = ("diffrax whole", self.field.name, self.method)
        whole = self.field.code.once(key, lambda: _whole(self.method, self.field))
        state = (self.tau, length, self.h, self.x)
        tau, x, h, steps, rejected = whole(*self.fixed, *state, *self.tolerances)
        self._count(rejected)
        if not (self.tau < float(tau) and np.all(np.isfinite(x))):
            self.step(length)  # which says what is wrong
            return 1
        self.tau, self.x, self.h = float(tau), np.asarray(x), float(h)
        return int(steps)

    def _count(self, rejected: Any) -> None:
        """Count attempts that failed, unless compiled streaks have left some out."""
        if self.counts.rejected is not None:
            self.counts.rejected += int(rejected)

    def segment(self) -> Segment:
        """The method's own interpolant."""
        start, values = self._last
        return interpolated(start, self.tau - start, values)

    def _towards(self, limit: float, force: bool) -> None:
        span, start = limit - self.tau, self.tau
        x, h, new, values, rejected = self._call(
            *self.fixed, start, self.h, span, self.x, *self.tolerances, force
        )
        self._count(rejected)
        self.x, h, self.h = np.asarray(x), float(h), float(new)
        self.tau = limit if h >= span else start + h
        self._last = (start, np.asarray(values))
        if not isfinite(self.x.sum()) or not self.tau > start:
            raise FlowError(self._reason())

    def _reason(self) -> str:
        tau, x = self._before
        return gave_up(self.field, self.fixed[1] + tau, x)


def gave_up(field: Field, t: float, x: np.ndarray) -> str:
    """Why there is no step from a state."""
    if not np.all(np.isfinite(field.rhs(t, x.tolist()))):
        return "the flow is not finite"
    return "the solver gave up: the step became too small, or the flow is not finite"


def _compiled(method: Method, field: Field) -> Any:
    """One kept step, with its refused attempts, as a compiled function."""
    motion = _motion(method, field)

    def step(
        parameters: Any,
        t0: Any,
        tau: Any,
        h: Any,
        span: Any,
        x: Any,
        rtol: Any,
        atol: Any,
        force: Any,
    ) -> Any:
        flow, expand = motion(parameters, t0)

        def attempt(h: Any) -> Any:
            taken = jnp.minimum(h, span)
            end, kept, taken, new, path = method.attempt(flow, tau, taken, x, rtol, atol, expand)
            wanted = jnp.where(kept & (taken < h), jnp.maximum(new, h), new)
            return end, taken, wanted, path.values(), kept

        def refused(carry: Any) -> Any:
            _, taken, _, _, kept, _ = carry
            return ~kept & ~force & (taken > SHORTEST * tau) & (taken > 1e-300)

        def again(carry: Any) -> Any:
            return *attempt(carry[2]), carry[-1] + 1

        last = jax.lax.while_loop(refused, again, (*attempt(h), 0))
        end, taken, new, values, kept, rejected = last
        taken = jnp.where(kept | force, taken, 0.0)
        return end, taken, new, values, rejected

    return jit(step)


def _motion(method: Any, field: Field) -> Any:
    """The flow in local time for given parameters and start, and what :meth:`Series.attempt` wants.

    Raises
    ------
    OptionError
        If the method needs the flow's series, and there is none.
    """
    traced = again(field.closed)
    series: Any = _series(field) if method.name == TAYLOR else None

    def motion(parameters: Any, t0: Any) -> tuple[Any, Any]:
        def flow(s: Any, y: Any) -> Any:
            return traced(parameters, t0 + s, y)

        def expand(s: Any, y: Any) -> Any:
            return Ahead(series(parameters, t0 + s, y), t0 + s, jnp.zeros(1), None)

        return flow, expand

    return motion


def _series(field: Field) -> Any:
    nothing = lambda p, t, x: jnp.zeros(1)  # noqa: E731
    try:
        return expansion(field.code, ("flow alone", field.name), lambda: field.closed, nothing)
    except TraceError as fault:
        raise without_series(field.code.spec.model, f"mode {field.name}: {fault}") from None


def _whole(method: Any, field: Field) -> Any:
    """Diffrax's own loop from a local time on, as far as so many attempts go."""
    if method.name == TAYLOR:
        return _all_steps(method, field)
    motion = _motion(method, field)

    def run(
        parameters: Any, t0: Any, tau: Any, end: Any, h: Any, x: Any, rtol: Any, atol: Any
    ) -> Any:
        flow, _ = motion(parameters, t0)
        term = diffrax.ODETerm(lambda s, y, args: flow(s, y))
        solution = diffrax.diffeqsolve(
            term,
            method.solver(rtol, atol),
            tau,
            end,
            h,
            x,
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
            max_steps=ATTEMPTS,
            throw=False,
        )
        reached, stats = solution.ts[-1], solution.stats
        counts = stats["num_accepted_steps"], stats["num_rejected_steps"]
        return reached, solution.ys[-1], (reached - tau) / stats["num_steps"], *counts

    return jit(run)


def _all_steps(method: Any, field: Field) -> Any:
    """The same for Taylor series."""
    motion = _motion(method, field)

    def run(
        parameters: Any, t0: Any, tau: Any, end: Any, h: Any, x: Any, rtol: Any, atol: Any
    ) -> Any:
        flow, expand = motion(parameters, t0)

        def goes_on(carry: Any) -> Any:
            tau, _, h, count, _ = carry
            return (tau < end) & (h > SHORTEST * tau) & (count < ATTEMPTS)

        def body(carry: Any) -> Any:
            tau, x, h, count, made = carry
            left = end - tau
            there, kept, taken, new, _ = method.attempt(
                flow, tau, jnp.minimum(h, left), x, rtol, atol, expand
            )
            after = jnp.where(taken >= left, end, tau + taken)
            moved = jnp.where(kept, after, tau), jnp.where(kept, there, x), new
            return *moved, count + 1, made + kept

        start = tau, x, end - tau, jnp.array(0), jnp.array(0)
        tau, x, h, count, made = jax.lax.while_loop(goes_on, body, start)
        return tau, x, h, made, count - made

    return jit(run, whole=field.code.scalar)
