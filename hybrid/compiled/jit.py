"""``jax.jit`` with the compiler's settings that suit these programs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import jax

from ..automaton.trace import wide

#: XLA's newer emitters take twice as long to compile these programs, which then run no faster.
WANTED = {"xla_cpu_use_fusion_emitters": False}


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiled in 64 bits when first called; arguments are numbers and arrays."""
    compiled = jax.jit(function, compiler_options=_options())

    def call(*arguments: Any) -> Any:
        with wide():
            return compiled(*arguments)

    return call


@cache
def _options() -> dict[str, Any] | None:
    """The settings, if this version of XLA knows them."""
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=WANTED)(0.0)
    except Exception:  # an unknown option is an error of the backend's own type
        return None
    return WANTED
