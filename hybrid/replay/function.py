"""What a run gives, as a function that JAX derives: its plan is asked for, then flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient

from ..errors import OptionError
from ..scene.lowered import lowered
from .fly import ORDERS, Flight
from .laws import laws_of
from .plan import Plan, blank


class Replay:
    """Runs of a class, flown again.

    Parameters
    ----------
    cls : type
    shapes : sequence of tuple
        Those of the parameters.
    parts : dict
        The shapes of what a run gives, by name, in order.
    rows, room : int
        Of the table of jumps; most steps.
    ask : callable
        Gives the plan of the run of a row of numbers; of rows, an array of each.
    """

    def __init__(
        self,
        cls: Any,
        shapes: tuple[tuple[int, ...], ...],
        parts: Mapping[str, tuple[int, ...]],
        rows: int,
        room: int,
        ask: Callable[[Any], tuple[Any, ...]],
    ) -> None:
        self.laws = laws_of(lowered(cls, shapes))
        self.shapes, self.parts, self.ask = shapes, parts, ask
        shape = lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype)  # noqa: E731
        self.given = tuple(map(shape, blank(self.laws, room, rows)))

    def planned(self, row: Any) -> Callable[[Any], Any]:
        """The run of a row of numbers, as a function of such a row that has derivatives there."""
        plan = jax.pure_callback(
            self.ask, self.given, stop_gradient(row), vmap_method="expand_dims"
        )
        return partial(self._flown, Plan(*plan))

    def _flown(self, plan: Plan, row: Any) -> Any:
        row, n = bounded(ORDERS, row), self.laws.spec.dimension
        ends = np.cumsum([0, *(int(np.prod(shape, dtype=int)) for shape in self.shapes)]).tolist()
        pairs = zip(pairwise(ends), self.shapes, strict=True)
        parameters = tuple(row[a:b].reshape(shape) for (a, b), shape in pairs)
        flight = Flight(self.laws, plan, parameters, row[-1])
        (times, before, after), (t, x) = flight(row[-2], row[-2 - n : -2])
        found = {"t": t, "final": x}
        for name, states in (("times", times), ("before", before), ("after", after)):
            unused = (plan.jumps < 0).reshape(-1, *[1] * (states.ndim - 1))
            found[name] = jnp.where(unused, jnp.nan, states[plan.jumps])
        numbers = [found.get(name, jnp.full(shape, jnp.nan)) for name, shape in self.parts.items()]
        return jnp.concatenate([part.reshape(-1) for part in numbers])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def bounded(orders: int, row: Any) -> Any:
    """A row of numbers by which may be derived so many times."""
    return row


@bounded.defjvp  # type: ignore[untyped-decorator]
def _(orders: int, rows: Any, changes: Any) -> Any:
    if not orders:
        raise OptionError(
            "as_function has first and second derivatives, and a third one was asked for; take "
            "differences of the second"
        )
    return bounded(orders - 1, *rows), changes[0]
