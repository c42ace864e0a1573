"""The zero of each guard in a step, as array code (compare :mod:`hybrid.events`).

The rule is the same: Bernstein coefficients, and Descartes' rule of signs. Where that rule
does not decide, :mod:`hybrid.events` halves the interval; a compiled lane halves its step.
"""

from __future__ import annotations

from math import comb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..segment import apply, nodes

#: Newton steps towards a zero: it is a first guess, the landing does the rest.
NEWTON = 8


def to_start(degree: int) -> np.ndarray:
    """The value at 0 of a polynomial of lower degree, from its values at the other nodes."""
    points = nodes(degree)[1:]
    vander = np.polynomial.chebyshev.chebvander(2.0 * points - 1.0, degree - 1)
    return np.polynomial.chebyshev.chebvander(np.array([-1.0]), degree - 1)[0] @ np.linalg.inv(
        vander
    )


def deflated(values: Any, order: Any) -> Any:
    """Values at the nodes of ``p(s) / s^order`` (up to the third); ``p(0)`` is not looked at."""
    degree = len(values) - 1
    s = jnp.asarray(nodes(degree)[1:])[:, None]
    power = jnp.where(order == 0, 1.0, jnp.where(order == 1, s, s * s))
    power = jnp.where(order == 3, s * s * s, power)
    rest = values[1:] / power
    start = jnp.where(order == 0, values[0], apply(to_start(degree)[None], rest)[0])
    return jnp.concatenate([start[None], rest])


def to_powers(degree: int) -> np.ndarray:
    """Matrix from Bernstein coefficients to those of powers."""
    matrix = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        for i in range(k, degree + 1):
            matrix[k, i] = (-1) ** (i - k) * comb(degree, i) * comb(i, k)
    return matrix


def falling(b: Any) -> tuple[Any, Any]:
    """Where polynomials fall through zero in ``(0, 1]``, and where that is unclear.

    Parameters
    ----------
    b : array, shape (polynomials, degree + 1)
        Bernstein coefficients.

    Returns
    -------
    root : array, shape (polynomials,)
        The only zero, falling, to some digits; infinity where there is none.
    unclear : array of bool
        There may be several zeros.
    """
    count, first = _changes(b.T)
    once = (count == 1) & (first > 0)
    at_end = (count == 0) & (first > 0) & (b[:, -1] == 0)
    unclear = count > 1
    powers = apply(to_powers(b.shape[1] - 1).T, b.T)
    root = jnp.where(once, _newton(powers), jnp.where(at_end, 1.0, jnp.inf))
    return root, unclear


def _changes(b: Any) -> tuple[Any, Any]:
    """Sign changes in lists of coefficients, zeros left out, and the first sign."""
    before, count = jnp.sign(b[0]), jnp.zeros_like(b[0], dtype=int)
    first = before
    for value in b[1:]:
        sign = jnp.sign(value)
        count = count + (sign * before < 0)
        first = jnp.where(first == 0, sign, first)
        before = jnp.where(sign == 0, before, sign)
    return count, first


def _newton(powers: Any) -> Any:
    """Zeros of polynomials that fall once in [0, 1]: Newton's steps within a bracket."""

    def closer(_: Any, carry: Any) -> Any:
        left, right, s = carry
        value, rate, _ = horner(powers, s)
        left, right = jnp.where(value > 0, s, left), jnp.where(value > 0, right, s)
        new = s - value / jnp.where(rate < 0, rate, -1.0)
        inside = (rate < 0) & (new >= left) & (new <= right)
        return left, right, jnp.where(inside, new, 0.5 * (left + right))

    left, right = jnp.zeros_like(powers[0]), jnp.ones_like(powers[0])
    tangent = -powers[0] / jnp.where(powers[1] < 0, powers[1], -1.0)  # at the start
    first = jnp.where((powers[1] < 0) & (tangent < 1.0), tangent, 0.5)
    return jax.lax.fori_loop(0, NEWTON, closer, (left, right, first))[2]


def horner(powers: Any, s: Any) -> tuple[Any, Any, Any]:
    """Polynomials and their first two derivatives."""
    value, first, half = powers[-1], jnp.zeros_like(s), jnp.zeros_like(s)
    for c in powers[-2::-1]:
        value, first, half = value * s + c, first * s + value, half * s + first
    return value, first, 2.0 * half


def shallow(b: Any, order: Any, s: Any, tolerance: Any) -> Any:
    """Whether zeros ``s`` of polynomials ``s^order b(s)`` go no deeper than a tolerance."""
    found = jnp.isfinite(s)
    at = jnp.where(found, s, 0.5)
    _, first, second = horner(apply(to_powers(b.shape[1] - 1).T, b.T), at)
    power = jnp.where(order == 0, 1.0, jnp.where(order == 1, at, at * at))  # third order: bound
    second = 2 * order * first * power / at + power * second
    first = power * first
    return found & (first * second <= 0) & (first**2 <= 2 * jnp.abs(second) * tolerance)
