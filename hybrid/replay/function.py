"""The results of a run as a function that JAX can differentiate twice, by replay of its plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.lax import stop_gradient

from ..errors import OptionError
from ..lowering.lowered import lowered
from .fly import DERIVATIVE_ORDERS, ReplayedRun
from .itinerary import Itinerary, blank
from .laws import Laws, laws_of


class Replay:
    """Replays of the runs of a class with the same options.

    Parameters
    ----------
    cls : type
    shapes : sequence of tuple
        Shapes of the parameters.
    parts : dict
        Names and shapes of a run's results, in order.
    rows, room : int
        Rows of the table of jumps; most steps.
    ask : callable
        Returns, for a row of numbers (parameters, start, first and last time), whether the run can
        be replayed, and its plan; for several rows, stacked arrays of these.
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
        self.code, self.shapes, self.parts, self.ask = lowered(cls, shapes), shapes, parts, ask
        self.rows, self.room = rows, room
        self.ends = np.cumsum([0, *map(math.prod, shapes)]).tolist()

    @cached_property
    def laws(self) -> Laws:
        """The functions of the class."""
        return laws_of(self.code)

    @cached_property
    def written(self) -> bool:
        """Whether no flow has loops or foreign calls, which lack reverse-mode derivatives."""
        modes = [self.code.mode(mode.name) for mode in self.code.spec.modes]
        return all(mode.free and not mode.graph.foreign for mode in modes)

    @cached_property
    def given(self) -> tuple[Any, ...]:
        """Shapes and types of the arrays of a plan."""
        plan = blank(self.laws, self.room, self.rows)
        return tuple(jax.ShapeDtypeStruct(part.shape, part.dtype) for part in plan)

    def plan(self, row: Any) -> tuple[Any, Any]:
        """Whether the run for a row of numbers can be replayed, and its plan, by a callback."""
        held, shapes = stop_gradient(row), (jax.ShapeDtypeStruct((), bool), *self.given)
        flies, *plan = jax.pure_callback(self.ask, shapes, held, vmap_method="expand_dims")
        return flies, plan

    def fly(self, plan: Any, row: Any) -> Any:
        """The results of a run as one array, in the order of ``parts``; ``plan`` must be that of
        ``row``. NaN for results that a replay does not give."""
        plan = Itinerary._make(plan)
        row, n = bounded(DERIVATIVE_ORDERS, row), self.code.spec.dimension
        pairs = zip(pairwise(self.ends), self.shapes, strict=True)
        parameters = tuple(row[a:b].reshape(shape) for (a, b), shape in pairs)
        flight = ReplayedRun(self.laws, plan, parameters, row[-1])
        (times, before, after), (t, x) = flight(row[-2], row[-2 - n : -2])
        found = {"t": t, "final": x}
        for name, states in (("times", times), ("before", before), ("after", after)):
            unused = (plan.jumps < 0).reshape(-1, *[1] * (states.ndim - 1))
            found[name] = jnp.where(unused, jnp.nan, states[plan.jumps])
        numbers = [found.get(name, jnp.full(shape, jnp.nan)) for name, shape in self.parts.items()]
        return jnp.concatenate([part.reshape(-1) for part in numbers])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def bounded(orders: int, row: Any) -> Any:
    """The row itself; a derivative of higher order than ``orders`` is an :class:`OptionError`."""
    return row


@bounded.defjvp  # type: ignore[untyped-decorator]
def _(orders: int, rows: Any, changes: Any) -> Any:
    if not orders:
        raise OptionError(
            "as_function has first and second derivatives, and a third one was asked for; take "
            "differences of the second"
        )
    return bounded(orders - 1, *rows), changes[0]


@custom_vmap  # type: ignore[untyped-decorator]
def any_lane(condition: Any) -> Any:
    """Whether a condition holds in any lane; under ``vmap`` this is one value for all lanes."""
    return condition


@any_lane.def_vmap  # type: ignore[untyped-decorator]
def _(size: int, batched: Any, condition: Any) -> tuple[Any, bool]:
    del size, batched
    return any_lane(jnp.any(condition, axis=0)), False


def when(condition: Any, then: Callable[[], Any], otherwise: Any) -> Any:
    """``then()`` where the condition holds, ``otherwise`` elsewhere.

    ``then`` is not evaluated if the condition holds in no lane.
    """
    return jax.lax.cond(
        any_lane(condition),
        lambda: jnp.where(condition, then(), otherwise),
        lambda: otherwise,
    )
