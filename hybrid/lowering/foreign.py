"""Foreign functions: operations of a trace without scalar code, compiled by JAX and called.

Examples are a loop whose length depends on the state, eigenvalues, and a sort of many numbers. A
graph node calls the function on numbers, and its results are parts of that node. Its derivatives
are foreign functions too. It has no Taylor series and no enclosure, and where it switches is
unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from .jit import jit

#: For primitives, by name: a description for the author, and what to write instead.
IN_WORDS = {
    "while": (
        "a loop that ends by a condition",
        "write a loop of fixed length, jax.lax.fori_loop(0, 20, ...), in which jnp.where keeps "
        "what is done",
    ),
    "sort top_k": (
        "a sort of more than 12 numbers, or by several keys",
        "sort fewer, or ask for jnp.max, jnp.min or jnp.argmax, which are written out",
    ),
    "eig eigh svd": (
        "eigenvalues or singular values",
        "write the roots of the characteristic polynomial, or a fixed number of iterations",
    ),
    "qr geqrf householder_product lu schur hessenberg tridiagonal": (
        "a factorisation",
        "use jnp.linalg.solve, inv, cholesky or det (up to 8 x 8), which are written out",
    ),
    "fft": ("a Fourier transform", "multiply by a matrix of cosines and one of sines"),
    "conv_general_dilated": ("a convolution", "multiply by a matrix"),
    "scatter scatter-add scatter-mul scatter-min scatter-max dynamic_update_slice": (
        "an entry set at a position made from the state",
        "write jnp.where(jnp.arange(n) == i, new, old)",
    ),
    "lgamma": (
        "the logarithm of the gamma function",
        "write Stirling's series, or a polynomial fit of it, over the range that is used",
    ),
    "pure_callback io_callback": (
        "a call of Python",
        "write this part with jax.numpy",
    ),
    "bessel_i0e bessel_i1e digamma erf_inv igamma igammac polygamma regularized_incomplete_beta "
    "zeta": (
        "a special function",
        "read it from a table, jnp.interp(x, knots, values), or write a polynomial fit",
    ),
}

#: The same for all other primitives.
OTHER = "this function", "write this part with arithmetic, jnp.where or a loop of fixed length"


class Foreign:
    """A function of numbers, compiled when it is first called.

    Parameters
    ----------
    name : str
        The primitive, for messages.
    line : str
        The author's line, for messages.
    function : callable
        Maps an array of numbers to an array of numbers.
    """

    def __init__(self, name: str, line: str, function: Callable[[Any], Any]) -> None:
        self.name, self.line, self.function = name, line, function
        self._call = jit(function)

    @property
    def words(self) -> tuple[str, str]:
        """What it is, and where it is written; what to write instead."""
        return in_words(self.name, self.line)

    def __call__(self, *numbers: float) -> list[float]:
        return np.asarray(self._call(np.array(numbers, dtype=float))).tolist()  # type: ignore[no-any-return]

    @cached_property
    def rates(self) -> Foreign:
        """The directional derivative: a function of the arguments, then their rates."""
        import jax
        import jax.numpy as jnp

        def rates(both: Any) -> Any:
            return jax.jvp(self.function, *((part,) for part in jnp.split(both, 2)))[1]

        return Foreign(self.name, self.line, rates)

    @cached_property
    def slopes(self) -> Foreign:
        """The Jacobian of the results by the arguments, row by row."""
        import jax

        def slopes(numbers: Any) -> Any:
            return jax.jacfwd(self.function)(numbers).reshape(-1)

        return Foreign(self.name, self.line, slopes)


def in_words(name: str, line: str) -> tuple[str, str]:
    """What a primitive is, with the author's line, and what to write instead."""
    known = (said for names, said in IN_WORDS.items() if name in names.split())
    what, instead = next(known, OTHER)
    return f"{what} ({line}the primitive {name!r})", instead


def of_primitive(equation: Any, line: str, values: Sequence[Any]) -> Foreign:
    """The function that an equation of a trace computes.

    Parameters
    ----------
    line : str
        The author's line.
    values
        For every element of all inputs: its value if constant, None if it is an argument.
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

    return Foreign(primitive.name, line, function)
