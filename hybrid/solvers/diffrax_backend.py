"""Diffrax's Runge-Kutta methods as pure functions, for :mod:`hybrid.compiled`.

A step is Diffrax's own: its tables (or, of an implicit method, its ``step``), its step size
controller, its interpolant. :class:`Method` writes one attempt of it as a function of arrays, which
is compiled together with events and jumps.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import attrs
import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..arrays import chebyshev
from ..errors import OptionError
from ..jit import jit
from ..segment import apply, from_values, integrals, nodes
from . import diffrax_objects
from .diffrax_objects import SWEEPS
from .series import ORDER, TAYLOR, Series

#: Degree of each method's dense output in the fraction of the step; the first is the default.
DEGREES = {**diffrax_objects.DEGREES, TAYLOR: ORDER}


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
