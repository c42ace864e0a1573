"""Branches that are branches under ``vmap`` too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


@custom_vmap  # type: ignore[untyped-decorator]
def any_lane(condition: Any) -> Any:
    """Whether a condition holds in any lane: one number, however many lanes there are."""
    return condition


@any_lane.def_vmap  # type: ignore[untyped-decorator]
def _(size: int, batched: Any, condition: Any) -> tuple[Any, bool]:
    del size, batched
    return any_lane(jnp.any(condition, axis=0)), False


def when(condition: Any, then: Callable[[], Any], otherwise: Any) -> Any:
    """``then()`` where the condition holds, ``otherwise`` elsewhere.

    ``then`` is not computed at all where the condition holds in no lane.
    """
    return jax.lax.cond(
        any_lane(condition), lambda: choose(condition, then(), otherwise), lambda: otherwise
    )


def choose(condition: Any, yes: Any, no: Any) -> Any:
    """One or the other, entry by entry; both have been computed."""
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), yes, no)


def chebyshev(s: Any, degree: int) -> Any:
    """Chebyshev polynomials in ``2 s - 1``; shape ``s.shape + (degree + 1,)``."""
    x = 2.0 * jnp.asarray(s) - 1.0
    columns = [jnp.ones_like(x), x]
    for _ in range(degree - 1):
        columns.append(2.0 * x * columns[-1] - columns[-2])
    return jnp.stack(columns, axis=-1)
