"""What a trace asks for that cannot be written as scalar code: compiled by JAX, and called.

A loop of a length that depends on the state, a factorisation, a sort: a node of the graph calls
it for numbers, and its results are parts of that node. Its derivatives are functions of the same
kind. There is no Taylor series of it, no enclosure, and nothing is known of where it switches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from .jit import jit


class Foreign:
    """A function of numbers, compiled when it is first called.

    Parameters
    ----------
    name : str
        The primitive, for messages.
    function : callable
        Of an array of numbers, which gives another.
    """

    def __init__(self, name: str, function: Callable[[Any], Any]) -> None:
        self.name, self.function = name, function
        self._call = jit(function)

    def __call__(self, *numbers: float) -> list[float]:
        return np.asarray(self._call(np.array(numbers, dtype=float))).tolist()  # type: ignore[no-any-return]

    @cached_property
    def rates(self) -> Foreign:
        """Its results' rates; of its arguments, then their rates."""
        import jax
        import jax.numpy as jnp

        def rates(both: Any) -> Any:
            return jax.jvp(self.function, *((part,) for part in jnp.split(both, 2)))[1]

        return Foreign(self.name, rates)

    @cached_property
    def slopes(self) -> Foreign:
        """The derivatives of its results by its arguments, result by result."""
        import jax

        return Foreign(self.name, lambda numbers: jax.jacfwd(self.function)(numbers).reshape(-1))


def of_primitive(equation: Any, values: Sequence[Any]) -> Foreign:
    """The function of an equation of a trace.

    Parameters
    ----------
    values
        Of all inputs, element by element: their values, and None where they are arguments.
    """
    import jax.numpy as jnp

    primitive, avals = equation.primitive, [atom.aval for atom in equation.invars]
    ends = np.cumsum([0, *(aval.size for aval in avals)]).tolist()
    places = np.flatnonzero([value is None for value in values])
    whole = [0 if value is None else value for value in values]
    parts = [whole[a:b] for a, b in pairwise(ends)]
    owns = [places[(places >= a) & (places < b)] - a for a, b in pairwise(ends)]
    shares = np.cumsum([0, *map(len, owns)]).tolist()

    def function(numbers: Any) -> Any:
        inputs = []
        for aval, part, own, (a, b) in zip(avals, parts, owns, pairwise(shares), strict=True):
            array = jnp.asarray(np.array(part, aval.dtype))
            array = array.at[own].set(numbers[a:b].astype(aval.dtype))
            inputs.append(array.reshape(aval.shape))
        results = primitive.bind(*inputs, **equation.params)
        results = results if primitive.multiple_results else [results]
        return jnp.concatenate([jnp.ravel(result).astype(float) for result in results])

    return Foreign(primitive.name, function)
