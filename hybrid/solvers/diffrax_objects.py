"""Diffrax's solvers and step size controllers as objects, the caller's own among them.

Each attempt at a step is the object's ``step`` and the controller's ``adapt_step_size``, compiled
once for a field; what they remember is carried from step to step, and begun anew at each jump.
"""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..automaton.trace import again, wide
from ..errors import FlowError, OptionError
from ..jit import jit
from ..scene import Field
from ..segment import Segment, interpolated, nodes
from .base import FINEST, Solver, Stepper
from .diffrax_backend import DiffraxSolver, gave_up
from .series import SHORTEST, TAYLOR

#: Degree at which dense output is sampled, of whatever form it is: none of Diffrax's has a higher.
DEGREE = 8

#: Most attempts at a step: each that is refused is cut to a fifth or more by Diffrax's controllers,
#: so that the smallest of floats is reached before.
ATTEMPTS = 200


class Memory(NamedTuple):
    """What a solver and a controller remember, and the end of the step that comes next."""

    solver: Any
    controller: Any
    end: Any


class ObjectSolver(Solver):
    """A Diffrax solver, with a step size controller.

    Parameters
    ----------
    method : diffrax.AbstractSolver
    controller : diffrax.AbstractStepSizeController, optional
        Diffrax's ``PIDController`` with the tolerances if omitted. It sees times from the start of
        each arc.
    """

    name = "diffrax"
    rejected: int

    def __init__(self, method: Any, rtol: float, atol: Any, controller: Any = None) -> None:
        self.rtol, self.atol, self.rejected = max(rtol, FINEST), atol, 0
        self.method = type(method).__name__
        self.object = _with_tolerances(method, self.rtol, float(np.min(atol)))
        self.controller = controller
        takes = self.object.term_structure
        if not (isinstance(takes, type) and issubclass(diffrax.ODETerm, takes)):
            raise OptionError(f"method={self.method}: it does not take one diffrax.ODETerm")
        self.order = int(self.object.order(diffrax.ODETerm(lambda t, y, args: y)))

    def begin(
        self,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        first = first_step or min(length, 1e-3)
        return ObjectStepper(self, field, t0, x0, length, min(first, length))

    @property
    def key(self) -> Any:
        """What tells objects apart: their values, or where these have none (arrays) themselves."""
        try:
            hash((self.object, self.controller))
        except TypeError:
            return id(self.object), id(self.controller)
        return self.object, self.controller


def solver_of(method: Any, rtol: float, atol: Any, controller: Any = None) -> Solver:
    """A method by name, or an object.

    Raises
    ------
    OptionError
        If the controller is none, or the method has none.
    """
    if isinstance(method, diffrax.AbstractSolver):
        return ObjectSolver(method, rtol, atol, _controller(controller))
    named = DiffraxSolver(method, rtol, atol)
    if controller is None:
        return named
    if named.method == TAYLOR:
        raise OptionError(f"method={TAYLOR!r}: its steps follow from the series; no controller=")
    return ObjectSolver(named.compiled.solver(rtol, atol), rtol, atol, _controller(controller))


def _controller(given: Any) -> Any:
    if given is not None and not isinstance(given, diffrax.AbstractStepSizeController):
        raise OptionError(f"controller={given!r}: a diffrax.AbstractStepSizeController, or None")
    return given


def _with_tolerances(method: Any, rtol: float, atol: float) -> Any:
    """An implicit method whose root finder asks for the tolerances of the steps gets ours."""
    finder = getattr(method, "root_finder", None)
    if finder is None or isinstance(getattr(finder, "rtol", 0.0), (int, float, jax.Array)):
        return method
    with wide():
        given = {"rtol": rtol, "atol": atol, "norm": diffrax.VeryChord(rtol=1.0, atol=1.0).norm}
        return replace(method, root_finder=replace(finder, **given))


class ObjectStepper(Stepper):
    """Steps along one arc, each attempt a call of a compiled function."""

    repeats = True

    def __init__(
        self,
        solver: ObjectSolver,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first: float,
    ) -> None:
        self.solver, self.field, self.tau, self.x = solver, field, 0.0, x0
        tolerances = solver.rtol, np.broadcast_to(solver.atol, x0.shape).astype(float)
        self.fixed = (*tolerances, field.parameters, t0)
        key = ("diffrax object", field.name, solver.key)
        self.made = field.code.once(key, lambda: Compiled(solver, field))
        self.memory = self.made.begin(*self.fixed, length, first, x0)

    def step(self, limit: float) -> None:
        self._before = self.tau, self.x, self.memory
        for _ in range(ATTEMPTS):
            wanted = float(self.memory.end)
            end = min(wanted, limit)
            x, kept, memory, values = self._attempt(end)
            if bool(kept):
                self._accept(end, x, memory, values)
                if end < wanted:  # cut short, not because it lost too much
                    longer = self.tau + max(float(memory.end) - end, wanted - self._before[0])
                    self.memory = memory._replace(end=longer)
                return
            self.solver.rejected += 1
            self.memory = self.memory._replace(controller=memory.controller, end=memory.end)
            if not float(memory.end) - self.tau > SHORTEST * max(self.tau, 1e-300):
                break
        raise FlowError(self._reason())

    def land(self, tau: float) -> Segment:
        """Step again from where the last step began, onto ``tau``, whatever it loses."""
        self.tau, self.x, self.memory = self._before
        x, _, memory, values = self._attempt(tau)
        self._accept(tau, x, memory, values)
        return self.segment()

    def segment(self) -> Segment:
        """The method's own interpolant, sampled."""
        start, values = self._last
        return interpolated(start, self.tau - start, values)

    def _attempt(self, end: float) -> Any:
        memory = self.memory
        given = self.tau, end, self.x, memory.solver, memory.controller
        try:
            return self.made.attempt(*self.fixed, *given)
        except RuntimeError as fault:
            raise OptionError(f"method={self.solver.method}: {fault}") from None

    def _accept(self, end: float, x: Any, memory: Memory, values: Any) -> None:
        self._last = self.tau, np.asarray(values)
        self.tau, self.x, self.memory = end, np.asarray(x), memory
        if not isfinite(self.x.sum()):
            raise FlowError(self._reason())

    def _reason(self) -> str:
        tau, x, _ = self._before
        return gave_up(self.field, self.fixed[-1] + tau, x)


class Compiled:
    """A method's beginning of an arc, and one attempt at a step, for a field."""

    def __init__(self, solver: ObjectSolver, field: Field) -> None:
        self.method, self.controller = solver.object, solver.controller
        self.flow = again(field.closed)
        self.begin, self.attempt = jit(self._begin), jit(self._attempt)

    def _parts(self, rtol: Any, atol: Any, parameters: Any, t0: Any) -> tuple[Any, Any, Any]:
        """The flow as Diffrax takes it, the controller, and the order of the error."""
        term = diffrax.ODETerm(lambda s, y, args: self.flow(parameters, t0 + s, y))
        controller = self.controller or diffrax.PIDController(rtol=rtol, atol=atol)
        return term, controller, self.method.error_order(term)

    def _begin(
        self, rtol: Any, atol: Any, parameters: Any, t0: Any, length: Any, h: Any, x: Any
    ) -> Memory:
        term, controller, order = self._parts(rtol, atol, parameters, t0)
        start = jnp.zeros_like(length)
        end, state = controller.init(term, start, length, x, h, None, self.method.func, order)
        return _arrays(Memory(self.method.init(term, start, end, x, None), state, end))

    def _attempt(
        self,
        rtol: Any,
        atol: Any,
        parameters: Any,
        t0: Any,
        tau: Any,
        end: Any,
        x: Any,
        memory: Any,
        state: Any,
    ) -> tuple[Any, Any, Memory, Any]:
        """The state at the end, whether it is kept, what is remembered, the states at the nodes."""
        term, controller, order = self._parts(rtol, atol, parameters, t0)
        y, error, dense, memory, _ = self.method.step(
            term, tau, end, x, None, memory, jnp.array(False)
        )
        if error is not None:
            error = jnp.where(jnp.all(jnp.isfinite(y + error)), error, jnp.inf)
        kept, begin, stop, _, state, _ = controller.adapt_step_size(
            tau, end, x, y, None, error, order, state
        )
        path = self.method.interpolation_cls(t0=tau, t1=end, **dense)
        values = jax.vmap(path.evaluate)(tau + (end - tau) * jnp.asarray(nodes(DEGREE)))
        values = jnp.concatenate([x[None], values[1:-1], y[None]])
        after = jnp.where(kept, end, tau) + (stop - begin)
        return _arrays((y, kept, Memory(memory, state, after), values))


def _arrays(tree: Any) -> Any:
    return jax.tree.map(jnp.asarray, tree)
