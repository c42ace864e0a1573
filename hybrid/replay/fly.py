"""The run of a plan as a function that JAX can differentiate twice, in forward and reverse mode.

A step is a collocation at Gauss points. Its unknowns are the states at these points and, for a step
that ends with a jump, its length; the additional equation is then that the guard is zero. The
values are known from the run, and the implicit function theorem gives their derivatives. With ``J``
the derivative of the equations ``F = 0`` at the run's values ``u0``, one Newton step ``u - F(u) /
J`` from ``u0`` is correct to first order in everything that ``F`` depends on, and two are correct
to second order. Events are not detected here: the plan lists them.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from ..variation.arcs import gauss
from .itinerary import TOGETHER, Itinerary
from .laws import AT_END, AT_LENGTH, Laws, chosen

#: Highest order of correct derivatives.
DERIVATIVE_ORDERS = 2


class ReplayedRun:
    """The results of a run as a function of its start, for given parameters and last time."""

    def __init__(self, laws: Laws, plan: Itinerary, parameters: Any, t1: Any) -> None:
        self.laws, self.plan, self.parameters, self.t1 = laws, plan, parameters, t1
        self.end = list(laws.guards).index(AT_END)
        self.fixed = list(laws.guards).index(AT_LENGTH)

    def __call__(self, t0: Any, x: Any) -> tuple[tuple[Any, Any, Any], tuple[Any, Any]]:
        """Times, and states before and after the jump, at the ends of all steps, shapes (steps,)
        and (steps, n); the final time and state."""
        *steps, _ = self.plan
        chunks = [a.reshape(len(a) // TOGETHER, TOGETHER, *a.shape[1:]) for a in steps]
        blank = jnp.zeros(TOGETHER), *(jnp.zeros((TOGETHER, len(x))) for _ in range(2))

        def some(carry: Any, steps: Any) -> Any:
            fly = lambda: jax.lax.scan(self._step, carry, steps)  # noqa: E731
            return jax.lax.cond(steps[1][0], fly, lambda: (carry, blank))

        end, rows = jax.lax.scan(jax.checkpoint(some), (t0, x), chunks)
        return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), rows), end

    def _step(self, carry: Any, steps: Any) -> Any:
        plan = Itinerary._make([*steps, self.plan.jumps])
        flow, guard, reset, onto = plan.laws
        t, x = carry
        points, inner, weights, _ = gauss()
        p, n = self.parameters, len(x)
        x = at(plan.first, chosen(self.laws.onto, onto, p, plan.masks, t, x))

        def moved(u: Any) -> tuple[Any, Any, Any]:
            """Updated stage values, and time and state at the end."""
            states, length = u[:-1].reshape(-1, n), plan.lengths * (1.0 + u[-1])
            along = lambda c, z: chosen(  # noqa: E731
                self.laws.flows, flow, p, plan.masks, t + c * length, z
            )
            rates = length * jax.vmap(along)(jnp.asarray(points), states)
            return x + inner @ rates, t + length, x + weights @ rates

        def residual(u: Any) -> Any:
            there, end, last = moved(u)
            close = chosen(self.laws.guards, guard, p, plan.masks, end, last)
            close = jnp.where(guard == self.fixed, u[-1], close)
            close = jnp.where(guard == self.end, end - self.t1, close)
            return jnp.append((u[:-1] - there.reshape(-1)), close)

        known = jnp.append(plan.inner.reshape(-1), 0.0)
        _, end, last = moved(_implicit(residual, known))
        end, last = at(plan.ends, end), at(plan.before, last)
        after = at(plan.after, chosen(self.laws.resets, reset, p, plan.masks, end, last))
        keep = lambda new, old: jnp.where(plan.used, new, old)  # noqa: E731
        return (keep(end, t), keep(after, x)), (end, last, after)


def at(value: Any, found: Any) -> Any:
    """A number equal to ``value``, with the derivatives of ``found``."""
    return value + (found - stop_gradient(found))


def _implicit(residual: Any, known: Any) -> Any:
    """The known zero of a residual, with its derivatives by all inputs of the residual."""
    slopes = stop_gradient(jax.jacfwd(residual)(known))

    def better(found: Any, _: Any) -> tuple[Any, None]:
        off = residual(found)
        return found - jnp.linalg.solve(slopes, at(0.0, off)), None

    return jax.lax.scan(better, known, length=DERIVATIVE_ORDERS)[0]
