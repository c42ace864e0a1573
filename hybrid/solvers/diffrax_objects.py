"""Diffrax's methods, by name or as objects, with an optional step size controller.

A call of a compiled program (:mod:`.diffrax_program`) costs as much as ten to a hundred small
steps, so each call makes several steps ahead, which are then handed out one by one.
"""

from __future__ import annotations

from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any

import diffrax
import jax.numpy as jnp
import numpy as np

from ..automaton.trace import wide
from ..errors import FlowError, OptionError
from ..lowering import Field
from ..segment import Segment, from_values, integrals, interpolated, nodes, to_powers
from .base import FINEST, NO_FLOW_HERE, Solver, Stepper, method_of
from .diffrax_program import (
    AHEAD,
    ASKED_LENGTH,
    ASKED_LIMIT,
    ASKED_RTOL,
    ASKED_STATE,
    ASKED_STEPS,
    ASKED_TAU,
    ASKED_TO,
    FORCED,
    INDEX,
    MADE_STATES,
    T0,
    StepProgram,
)
from .pairs import PairTables, lower

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Methods known by name, with the degree of their dense output in the fraction of the step; the
#: first is the default.
DEGREES = {
    "Dopri8": 8,
    "Tsit5": 4,
    "Dopri5": 4,
    "Bosh3": 3,
    "Heun": 3,
    "Midpoint": 3,
    "Ralston": 3,
    "Kvaerno3": 3,
    "Kvaerno4": 4,
    "Kvaerno5": 4,
}

#: Degree at which the dense output of other methods is sampled; none in Diffrax has a higher one.
OTHER_DEGREE = 8

#: Order to which the cubic through the states and slopes at both ends of a step is as exact as it.
CUBIC = 3

#: Picard sweeps that raise an interpolant to the order of its method.
SWEEPS = {"Dopri8": 2}


class DiffraxSolver(Solver):
    """A Diffrax method, with a step size controller.

    Parameters
    ----------
    method : diffrax.AbstractSolver
    controller : diffrax.AbstractStepSizeController, optional
        By default Diffrax's ``PIDController`` with the tolerances. Its times count from the start
        of each arc.

    Attributes
    ----------
    ahead : int
        Number of steps of the previous arc; as many are made ahead at the start of an arc.
    """

    name = "diffrax"
    averages = True
    rejected: int

    def __init__(self, method: Any, rtol: float, atol: Any, controller: Any = None) -> None:
        self.rtol, self.atol, self.rejected = max(rtol, FINEST), atol, 0
        self.method, self.object, self.controller = type(method).__name__, method, controller
        takes = method.term_structure
        if not (isinstance(takes, type) and issubclass(diffrax.ODETerm, takes)):
            raise OptionError(f"method={self.method}: it does not take one diffrax.ODETerm")
        try:
            self.order = _order(method)
        except TypeError:  # an object that holds arrays is not hashable
            self.order = _order.__wrapped__(method)
        self.ahead = 1
        self._programs: dict[Any, StepProgram] = {}

    def begin(
        self,
        field: Field,
        t0: float,
        x0: StateVector,
        length: float,
        first_step: float | None,
        sizes: StateVector | None = None,
    ) -> Stepper:
        first = first_step or min(length, 1e-3)
        return DiffraxStepper(self, field, t0, x0, length, min(first, length))

    def program(self, field: Field) -> StepProgram:
        """The program for a field, compiled once per class and mode, and once more for all of the
        mode's contacts at rest."""
        name, *_ = field.shared
        short = field.code, name
        if short not in self._programs:
            key = ("diffrax", name, self.key)
            degree = DEGREES[self.method] if self.known else OTHER_DEGREE
            sweeps = SWEEPS.get(self.method, 0) if self.known else 0
            halves = self.order > CUBIC and _is_hermite(self.object.interpolation_cls)
            given = degree, sweeps, halves
            made = field.code.once(
                key, lambda: StepProgram(self.object, self.controller, field, *given)
            )
            self._programs[short] = made
        return self._programs[short]

    @property
    def key(self) -> Any:
        """Identifies method and controller: by value, or by identity if they hold arrays."""
        try:
            hash((self.object, self.controller))
        except TypeError:
            return id(self.object), id(self.controller)
        return self.object, self.controller

    @property
    def known(self) -> bool:
        """Whether the method is one known by name, with its default settings."""
        return self.method in DEGREES and bool(self.object == _named(self.method))

    @property
    def tables(self) -> PairTables | None:  # type: ignore[override]
        explicit = isinstance(self.object, diffrax.AbstractERK)
        return _tables(self.method) if explicit and self.known and not self.controller else None


@cache
def _tables(name: str) -> PairTables:
    """The tables of an explicit method known by name.

    The dense output is evaluated with unit vectors as stages; Picard sweeps then add stages of
    their own.
    """
    method, degree = _named(name), DEGREES[name]
    table, s = method.tableau, nodes(degree)
    count, rows = table.num_stages, [[], *table.a_lower]
    fractions = [table.c1, *table.c]
    if not table.ssal:
        rows, fractions = [*rows, table.b_sol], [*fractions, 1.0]
    errors = lower([table.b_error], len(rows))[:1]
    with wide():
        start, end, units = jnp.zeros(count), jnp.array(table.b_sol), jnp.eye(count)
        path = method.interpolation_cls(t0=0.0, t1=1.0, y0=start, y1=end, k=units)
        values = np.array([path.evaluate(place) for place in s])
    for _ in range(SWEEPS.get(name, 0)):
        before, rates = len(rows), integrals(degree)
        rows, fractions = [*rows, *values], [*fractions, *s]
        values = np.hstack([np.zeros((len(s), before)), rates - np.outer(s, rates[-1])])
        values[:, :count] += np.outer(s, table.b_sol)
    values[0], values[-1] = 0.0, lower([table.b_sol], values.shape[1])[0]
    dense = np.zeros((len(rows), degree))
    dense[: values.shape[1]] = (to_powers(degree) @ from_values(degree) @ values)[1:].T
    own, order = diffrax.PIDController(1.0, 1.0), method.error_order(diffrax.ODETerm(_order))
    control = (
        *(own.safety, -own.icoeff / order, own.factormin, 1.0, own.factormax, own.factormax),
        *(0.0, 1.0, 1.0),
    )
    return PairTables(lower(rows, len(rows)), np.array(fractions), errors, dense, control)


def solver_of(method: Any, rtol: float, atol: Any, controller: Any = None) -> Solver:
    """A Diffrax solver from a method's name or object.

    Raises
    ------
    OptionError
        If the controller is not one, or there is no such method.
    """
    if controller is not None and not isinstance(controller, diffrax.AbstractStepSizeController):
        raise OptionError(
            f"controller={controller!r}: a diffrax.AbstractStepSizeController, or None"
        )
    if not isinstance(method, diffrax.AbstractSolver):
        method = _named(method_of(DiffraxSolver.name, method, DEGREES))
    return DiffraxSolver(method, rtol, atol, controller)


@cache
def _order(method: Any) -> int:
    """The order of a method, cached because computing it takes longer than a step."""
    return int(method.order(diffrax.ODETerm(lambda t, y, args: y)))


def _is_hermite(interpolant: Any) -> bool:
    """Whether a method's dense output is the cubic through the states and slopes at both ends."""
    cubic = diffrax.ThirdOrderHermitePolynomialInterpolation
    return interpolant is cubic or getattr(interpolant, "__self__", None) is cubic


@cache
def _named(name: str) -> Any:
    return getattr(diffrax, name)()


class DiffraxStepper(Stepper):
    """Steps along one arc, several of them ahead in each call of a compiled program.

    A step made ahead is used only if it is the one requested: it starts from the state that the
    previous step reached, and its limit is the same or it stays within both limits.
    """

    repeats = True

    def __init__(
        self,
        solver: DiffraxSolver,
        field: Field,
        t0: float,
        x0: StateVector,
        length: float,
        first: float,
    ) -> None:
        self.solver, self.field, self.tau, self.x = solver, field, 0.0, x0
        self.wanted, self.taken, self.t0 = first, 0, t0
        self.program = program = solver.program(field)
        self.memories, self.index, self.made, self.used = program.empty, -1, 0, 0
        self._end: np.ndarray | None = None
        self._powers: np.ndarray | None = None
        self.numbers = np.empty(ASKED_STATE + 2 * program.n + program.parameters)
        self.numbers[[T0, ASKED_LENGTH, ASKED_RTOL]] = t0, length, solver.rtol
        self.numbers[ASKED_STATE + program.n : -program.parameters or None] = solver.atol
        self.numbers[ASKED_STATE + 2 * program.n :] = program.flat(field.shared[2])
        self.ahead, solver.ahead = solver.ahead, 1

    def step(self, limit: float) -> None:
        if not self._is_made(limit):
            if self.x is not self._end:  # the method's memory belongs to another state
                self.index = -1
            self._make(limit, min(self.ahead, AHEAD, self.program.places))
            self.ahead *= 2
        self._take()
        self.taken += 1
        self.solver.ahead = self.taken

    def land(self, tau: float) -> Segment:
        self.arrive(tau)
        return self.segment()

    def arrive(self, tau: float) -> None:
        """Repeat the last step so that it ends at ``tau``, without error control."""
        longer = self.wanted - self.tau
        self.tau, self.x, self.index = self._before
        self._make(tau, 1, forced=True)
        self._take()
        self.wanted = tau + longer

    def finish(self, length: float) -> int:
        """Integrate with Diffrax's own loop, a bounded number of attempts per call."""
        left = np.asarray(self.program.whole(self._asked(length)))
        tau, h, steps, rejected = left[:4].tolist()
        if not (self.tau < tau and np.all(np.isfinite(left))):
            self.step(length)  # raises the error
            return 1
        self.tau, self.wanted, self.x = tau, tau + h, left[4:]
        self.solver.rejected += int(rejected)
        return int(steps)

    def segment(self) -> Segment:
        """The method's own interpolant, sampled."""
        start, values = self._last
        return interpolated(start, self.tau - start, values)

    def powers(self) -> tuple[float, float, np.ndarray]:
        if self._powers is None:
            degree = self.program.states - 1
            values = self.rows[: self.made, MADE_STATES:].reshape(self.made, degree + 1, -1)
            from_start = to_powers(degree) @ from_values(degree) @ (values - values[:, :1])
            from_start[:, 0] += values[:, 0]
            self._powers = from_start.transpose(0, 2, 1)
        start = self._last[0]
        return start, self.tau - start, self._powers[self.used - 1]

    def _is_made(self, limit: float) -> bool:
        """Whether the next step has been made ahead."""
        if self.used == self.made or self.x is not self._end:
            return False
        return bool(limit == self._limit or self.wanted <= min(limit, self._limit))

    def _make(self, limit: float, count: int, forced: bool = False) -> None:
        """Make at most ``count`` steps up to a limit."""
        n, numbers = self.program.n, self._asked(limit, count, forced)
        try:
            left, self.memories = self.program.run(numbers, self.memories)
        except RuntimeError as fault:
            raise OptionError(f"method={self.solver.method}: {fault}") from None
        left = np.asarray(left)
        self.made, self.used, self._limit, self._refused = int(left[0]), 0, limit, 0.0
        self.rows = left[2:].reshape(-1, MADE_STATES + n * self.program.states)
        self._powers = None
        if not self.made:
            self.solver.rejected += int(left[1])
            raise FlowError(self._reason(self.tau, self.x))

    def _asked(self, limit: float, count: int = 1, forced: bool = False) -> Numbers:
        """The numeric inputs of a program call."""
        numbers, n = self.numbers, self.program.n
        numbers[INDEX], numbers[ASKED_TAU], numbers[ASKED_TO] = self.index, self.tau, self.wanted
        numbers[ASKED_LIMIT], numbers[ASKED_STEPS], numbers[FORCED] = limit, count, forced
        numbers[ASKED_STATE : ASKED_STATE + n] = self.x
        return numbers

    def _take(self) -> None:
        """Advance to the end of the next step made."""
        row = self.rows[self.used]
        self._before = self.tau, self.x, self.used
        self._last = self.tau, row[MADE_STATES:].reshape(self.program.states, -1)
        self.tau, self.wanted, refused = row[:MADE_STATES].tolist()
        self.x = self._end = self._last[1][-1]
        self.used += 1
        self.index = self.used
        self.solver.rejected += int(refused - self._refused)
        self._refused = refused
        if self.used == self.made and not isfinite(self.x.sum()):  # no step can follow
            raise FlowError(self._reason(*self._before[:2]))

    def _reason(self, tau: float, x: StateVector) -> str:
        """Why no step from this state is possible."""
        if not np.all(np.isfinite(self.field.rhs(self.t0 + tau, x.tolist()))):
            return NO_FLOW_HERE
        return "the solver gave up: the step became too small, or the flow is not finite"
