"""``jax.jit`` with compiler options that suit these programs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from ..automaton.trace import wide

#: XLA options. The newer emitters take twice as long to compile these programs, without making them
#: faster. Calling the reduction library costs more than these small sums. Splitting a small program
#: across compiler threads costs more than it saves.
XLA_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_experimental_ynn_fusion_type": "",
    "xla_cpu_parallel_codegen_split_count": 1,
}


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function compiled in 64 bits when it is first called.

    Its arguments are pytrees of numbers and arrays. It is compiled once per set of shapes, for
    Python, numpy and JAX numbers alike.
    """
    import jax

    def strongly_typed(*arguments: Any) -> Any:
        return jax.tree.map(_strong, function(*arguments))

    compiled = jax.jit(strongly_typed, compiler_options=_options())

    def call(*arguments: Any) -> Any:
        with wide():
            return compiled(*jax.tree.map(_array, arguments))

    return call


def _strong(value: Any) -> Any:
    import jax

    return jax.lax.convert_element_type(value, value.dtype)


def _array(value: Any) -> Any:
    """An array with the same type wherever the number came from."""
    import numpy as np

    if hasattr(value, "weak_type"):
        return value.astype(value.dtype) if value.weak_type else value
    return np.asarray(value)


@cache
def _options() -> dict[str, Any]:
    """The options that this version of XLA knows."""
    return {name: value for name, value in XLA_OPTIONS.items() if _known(name, value)}


def _known(name: str, value: Any) -> bool:
    import jax

    try:
        jax.jit(lambda x: x + 1.0, compiler_options={name: value})(0.0)
    except Exception:  # the backend raises an error type of its own
        return False
    return True
