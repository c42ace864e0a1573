"""SciPy's own ``OdeSolver`` classes, driven step by step.

Runge-Kutta solvers are copied and restarted by setting their state, which takes a microsecond; a
constructor takes as long as a step. Implicit and multistep solvers remember past steps and are
constructed anew for each arc. BDF and LSODA restart at order one after each jump, so prefer a
Runge-Kutta method if there are many jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cache
from importlib import import_module
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import BDF, DOP853, LSODA, RK23, RK45, OdeSolver, Radau

from ..errors import FlowError, OptionError
from ..lowering import Field
from ..rules.zeros import EPS
from ..segment import Segment, interpolated, nodes, of_powers
from .base import FINEST, NO_FLOW_HERE, Solver, Stepper, method_of
from .pairs import PairTables, lower

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

METHODS: dict[str, Any] = {
    "DOP853": DOP853,
    "RK45": RK45,
    "RK23": RK23,
    "Radau": Radau,
    "BDF": BDF,
    "LSODA": LSODA,
}
ORDERS = {"DOP853": 8, "RK45": 5, "RK23": 3, "Radau": 5, "BDF": 2, "LSODA": 2}

#: Classes that can be restarted and whose rejected steps are counted.
RUNGE_KUTTA = (DOP853, RK45, RK23)

#: Their shortest step, in spacings of the time.
SCIPY_SPACINGS = 10.0

#: Degree of the dense output of methods whose interpolant is sampled.
SAMPLED_DEGREES = {"Radau": 3, "BDF": 5, "LSODA": 12}

#: The same for a user's class, and its assumed order for the choice of an arc's first step.
OTHER_DEGREE, LOWEST = 8, 1

#: The share of a step over which its last slope is told, and how many tolerances are near its end.
SLOPE_PART, NEARBY = 1e-3, 1e3

#: What is told of a step that does not follow the flow.
MISLED = (
    "the method's step does not follow the flow: a slope of it that is infinite nearby, as that of "
    "sqrt(x) at x = 0, misleads its Newton iteration; use an explicit method, or solver='taylor'"
)


class SciPySolver(Solver):
    """One of SciPy's methods: DOP853 (default), RK45, RK23, Radau, BDF, LSODA.

    A user's class is constructed and stepped as ``scipy.integrate.solve_ivp`` does it.
    """

    name = "scipy"
    averages = True
    evaluations: int

    def __init__(self, method: Any, rtol: float, atol: Any) -> None:
        if isinstance(method, type) and issubclass(method, OdeSolver):
            self.method, self.cls = method.__name__, method
        else:
            self.method = method_of(self.name, method, METHODS)
            self.cls = METHODS[self.method]
        self.order = ORDERS[self.method] if self.cls in METHODS.values() else LOWEST
        self.rtol, self.atol = max(rtol, FINEST), atol
        self.evaluations = 0
        self.rejected = 0 if self.cls in RUNGE_KUTTA else None
        self._kept: dict[int, Any] = {}

    @property
    def tables(self) -> PairTables | None:  # type: ignore[override]
        return _tables(self.cls) if self.cls in RUNGE_KUTTA else None

    def begin(
        self,
        field: Field,
        t0: float,
        x0: StateVector,
        length: float,
        first_step: float | None,
        sizes: StateVector | None = None,
    ) -> Stepper:
        rhs = field.rhs

        def rates(tau: float, x: np.ndarray) -> Sequence[float]:
            self.evaluations += 1
            return rhs(t0 + tau, x.tolist())

        if self.cls not in RUNGE_KUTTA:
            flow = lambda tau, x: np.array(rates(tau, x), dtype=float)  # noqa: E731
            return self._sampled(flow, _jacobian(field, t0), x0, length, first_step, sizes)
        solver = self._kept.pop(len(x0), None)
        if solver is None and first_step is None:
            solver = self._construct(rates, x0, length, None, self.atol)
        else:
            solver = solver or self._copied(len(x0))
            solver.atol = self.atol
            _restart(solver, rates, x0, length, first_step)
        self._kept[len(x0)] = solver
        return RungeKuttaStepper(solver, self)

    def _copied(self, n: int) -> Any:
        """A Runge-Kutta solver that has not begun."""
        solver = copy(_pattern(self.cls, n))
        solver.rtol, solver.atol, solver.max_step = self.rtol, self.atol, self.max_step
        solver.K = np.empty_like(solver.K)
        if isinstance(solver, DOP853):
            solver.K_extended = np.empty_like(solver.K_extended)
            solver.K = solver.K_extended[: len(solver.K)]
        return solver

    def _sampled(
        self,
        flow: Any,
        slopes: Any,
        x0: StateVector,
        length: float,
        first: float | None,
        sizes: StateVector | None,
    ) -> Stepper:
        """A stepper of an implicit or multistep method.

        A short flight is integrated as the displacement from ``x0``, with tolerances relative to
        its extent; at order one, the absolute tolerances would swallow it.
        """
        known = self.cls in METHODS.values()
        kept = self.rtol if known else None
        degree = SAMPLED_DEGREES[self.method] if known else OTHER_DEGREE
        given = {"jac": slopes} if known and slopes is not None else {}
        if sizes is None:
            solver = self._construct(flow, x0, length, first, self.atol, **given)
            return SampledStepper(solver, degree, np.zeros_like(x0), kept, self.atol)

        def moved(tau: float, way: np.ndarray) -> Any:
            return flow(tau, x0 + way)

        if given:
            given["jac"] = lambda tau, way: slopes(tau, x0 + way)
        atol = np.minimum(self.atol, self.rtol * np.maximum(sizes, 1e-300))
        first = min(first or length, 1e-2 * length)
        solver = self._construct(moved, np.zeros_like(x0), length, first, atol, **given)
        return SampledStepper(solver, degree, x0, kept, atol)

    def _construct(
        self,
        flow: Any,
        x0: StateVector,
        length: float,
        first: float | None,
        atol: Any,
        **given: Any,
    ) -> Any:
        options = {"rtol": self.rtol, "atol": atol, "first_step": first, **given}
        if self.max_step < np.inf:
            options["max_step"] = self.max_step
        try:
            return self.cls(flow, 0.0, x0, length, **options)
        except TypeError as fault:
            raise OptionError(
                f"method={self.method}: it is constructed as by scipy.integrate.solve_ivp, from "
                f"(fun, t0, y0, t_bound) and {', '.join(options)}: {fault}"
            ) from None


@cache
def _pattern(cls: Any, n: int) -> Any:
    """A Runge-Kutta solver for ``n`` numbers, to be copied."""
    return cls(lambda t, y: y, 0.0, np.zeros(n), 1.0, first_step=1.0)


@cache
def _tables(cls: Any) -> PairTables:
    """The tables of a Runge-Kutta class; dense output is read with unit vectors as stages."""
    count, extra = cls.n_stages, getattr(cls, "A_EXTRA", ())
    units = np.eye(count + 1 + len(extra))
    matrix = lower([*cls.A, cls.B, *extra], len(units))
    fractions = np.array([*cls.C, 1.0, *getattr(cls, "C_EXTRA", ())])
    errors = np.array([cls.E5, cls.E3] if cls is DOP853 else [cls.E])
    solver, more = copy(_pattern(cls, len(units))), iter(units[count + 1 :])
    solver.K, solver.K_extended, solver.fun = units[: count + 1], units, lambda t, y: next(more)
    solver.t_old, solver.t, solver.h_previous = 0.0, 1.0, 1.0
    solver.y_old, solver.y, solver.f = 0.0 * units[0], matrix[count], units[count]
    dense = RungeKuttaStepper(solver, None).powers()[2][:, 1:]
    own, power = import_module(cls.__module__), -1.0 / (cls.error_estimator_order + 1)
    control = own.SAFETY, power, own.MIN_FACTOR, 0.0, own.MAX_FACTOR, 1.0, SCIPY_SPACINGS, 0.0, 0.0
    return PairTables(matrix, fractions, errors, dense, control)


def _jacobian(field: Field, t0: float) -> Any:
    """The flow's Jacobian in local time; None if it is not written out."""
    slopes = field.jacobian
    if slopes is None:
        return None

    def jacobian(tau: float, x: np.ndarray) -> np.ndarray:
        t = t0 + tau
        matrix = np.array(slopes(t, x.tolist())).reshape(len(x), len(x))
        for column in np.flatnonzero(~np.isfinite(matrix).all(axis=0)):
            matrix[:, column] = _difference(field, t, x, int(column))
        return matrix

    return jacobian


def _difference(field: Field, t: float, x: StateVector, column: int) -> StateVector:
    """A column of the Jacobian by a difference: the slope of a formula that is not taken, 0 times
    infinity, may make that written out not a number where the flow is one."""
    moved = x.copy()
    moved[column] += EPS**0.5 * float(abs(x[column]) or np.abs(x).max() or 1.0)
    here, beside = (np.array(field.rhs(t, y.tolist())) for y in (x, moved))
    return (beside - here) / (moved[column] - x[column])


def _restart(solver: Any, flow: Any, x0: StateVector, length: float, first: float | None) -> None:
    """Put a Runge-Kutta solver at the start of a new arc."""

    solver.fun = flow
    solver.t, solver.t_old, solver.y = 0.0, None, x0
    solver.f = flow(0.0, x0)
    solver.t_bound, solver.status = length, "running"
    if first is None:
        first = min(length, 1e-3)
    solver.h_abs = min(first, length)


class _OdeStepper(Stepper):
    """Base of the SciPy steppers: makes steps and explains failures."""

    def __init__(self, solver: Any) -> None:
        self.solver = solver
        self.tau, self.x = 0.0, solver.y

    def _advance(self) -> None:
        solver = self.solver
        try:
            message = solver.step()
        except ValueError as fault:  # the implicit methods' linear algebra meets inf or nan
            raise FlowError(f"the flow or its Jacobian is not finite ({fault})") from None
        self.tau, self.x = float(solver.t), solver.y
        if solver.status == "failed" or not isfinite(sum(solver.y.tolist())):
            raise FlowError(self._reason(message or ""))

    def _reason(self, message: str) -> str:
        solver = self.solver
        rate = np.asarray(solver.fun(solver.t, solver.y))
        if not np.all(np.isfinite(rate)) or not np.all(np.isfinite(solver.y)):
            return NO_FLOW_HERE
        probe = np.asarray(solver.fun(solver.t + 1e-9, solver.y + 1e-9 * rate))
        if not np.all(np.isfinite(probe)):
            return NO_FLOW_HERE
        return f"the solver gave up: {message}"


class RungeKuttaStepper(_OdeStepper):
    """DOP853, RK45, RK23: reads the interpolant's coefficients directly."""

    repeats = True
    _made: tuple[float, float, np.ndarray] | None = None

    def __init__(self, solver: Any, counts: Any) -> None:
        super().__init__(solver)
        self.counts = counts

    def step(self, limit: float) -> None:
        self._before = (self.solver.t, self.solver.y, self.solver.f)
        self._towards(limit)

    def land(self, tau: float) -> Segment:
        self.arrive(tau)
        return self.segment()

    def arrive(self, tau: float) -> None:
        """Repeat the last step so that it ends at ``tau``."""
        solver, (start, length, powers) = self.solver, self.powers()
        solver.t, solver.y, solver.f = self._before
        solver.h_abs = tau - solver.t
        self._towards(tau)
        if self.tau < tau:  # rejected, though a longer step was accepted: use its interpolant
            share = (tau - start) / length
            self._made = start, tau - start, powers * share ** np.arange(powers.shape[1])
            self.tau, self.x = tau, self._made[2].sum(axis=1)
            solver.t, solver.y, solver.f = tau, self.x, solver.fun(tau, self.x)

    def _towards(self, limit: float) -> None:
        self.solver.t_bound, self.solver.status = limit, "running"
        self._made = None
        before = self.counts.evaluations
        self._advance()
        attempts = (self.counts.evaluations - before) // self.solver.n_stages
        self.counts.rejected += attempts - 1

    def powers(self) -> tuple[float, float, np.ndarray]:
        """The method's own interpolant."""
        if self._made is None:
            dense = self.solver.dense_output()
            if isinstance(self.solver, DOP853):
                powers = dense.F.T @ _DOP853_BASIS
            else:
                powers = np.empty((len(dense.y_old), dense.Q.shape[1] + 1))
                np.multiply(dense.h, dense.Q, out=powers[:, 1:])
            powers[:, 0] = dense.y_old
            self._made = float(dense.t_old), float(dense.h), powers
        return self._made

    def segment(self) -> Segment:
        """The interpolant as a segment."""
        start, length, powers = self.powers()
        return of_powers(start, length, powers)


def follows(solver: Any, rtol: float, atol: Any) -> bool:
    """Whether the last step of a method ends with the slope that the flow has near there.

    An implicit method's Newton iteration, and its error estimate, are divided by the slope of the
    flow where the step began. Next to a state where that is infinite, as of ``sqrt(x)`` at 0, they
    take a step for solved that does not move. A stiff flow may have another rate at the end of a
    good step, but not everywhere within what the tolerances allow.
    """
    t, x, dense = solver.t, solver.y, solver.dense_output()
    length = t - dense.t_old
    back = SLOPE_PART * length
    slope, rate = (x - dense(t - back)) / back, np.asarray(solver.fun(t, x))
    near, off = NEARBY * (atol + rtol * np.abs(x)), np.abs(rate - slope)
    rates = np.abs([rate, slope, (x - dense(dense.t_old)) / length])
    odd = (off > 0.5 * rates.max(axis=0)) & (off * length > near)
    if not odd.any():
        return True
    beside = [solver.fun(t, x + side) for side in (*np.diag(near), *-np.diag(near))]
    least, most = np.nanmin([rate, *beside], axis=0), np.nanmax([rate, *beside], axis=0)
    return bool(np.all(~odd | ((least <= slope) & (slope <= most))))


class SampledStepper(_OdeStepper):
    """Radau, BDF, LSODA and users' classes: samples the interpolant, which is a polynomial.

    ``rtol`` is None for a user's class: the slope at the end of its interpolant may be any.
    """

    _whole: Segment | None = None
    _last: Segment | None = None

    def __init__(
        self, solver: Any, degree: int, origin: Numbers, rtol: float | None, atol: Any
    ) -> None:
        super().__init__(solver)
        self.degree, self.origin = degree, origin
        self.rtol, self.atol = rtol, atol
        self.x = solver.y + origin

    def step(self, limit: float) -> None:
        self._advance()
        self.x = self.solver.y + self.origin
        self._whole = self._last = None
        if self.verifies:
            self.verify()

    def verify(self) -> None:
        if self.rtol is not None and not follows(self.solver, self.rtol, self.atol):
            raise FlowError(MISLED)

    def segment(self) -> Segment:
        """The method's own interpolant, sampled."""
        if self._last is None:
            dense = self.solver.dense_output()
            start, length = float(dense.t_old), float(dense.t - dense.t_old)
            values = dense(start + length * nodes(self.degree)).T + self.origin
            self._whole = self._last = interpolated(start, length, values)
        return self._last

    def land(self, tau: float) -> Segment:
        """The interpolant up to ``tau``: these methods cannot repeat a step."""
        whole = self._whole or self.segment()
        self.tau, self.x = tau, whole(tau)
        self._last = whole.cut(tau - whole.start)
        return self._last


def _dop853_basis() -> np.ndarray:
    """Coefficients of DOP853's nested basis in powers of the fraction, one row per term."""
    x, one_minus = np.polynomial.Polynomial([0, 1]), np.polynomial.Polynomial([1, -1])
    rows, factor = [], x
    for index in range(7):
        rows.append(np.pad(factor.coef, (0, 8 - len(factor.coef))))
        factor = factor * (one_minus if index % 2 == 0 else x)
    return np.array(rows)


_DOP853_BASIS = _dop853_basis()
