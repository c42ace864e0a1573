"""The zero of each guard in a step, as array code (compare :mod:`hybrid.events`).

The rule is the same: Bernstein coefficients, and Descartes' rule of signs. Where that rule
does not decide, :mod:`hybrid.events` halves the interval; a compiled lane halves its step.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from math import comb
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .arrays import when
from .events import bernstein_from_powers
from .segment import apply, nodes

#: Most of Newton's steps towards a zero, and the relative change after which none follows: it is a
#: first guess, the landing does the rest.
NEWTON, NEARLY = 8, 1e-8


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
        for i in range(k + 1):
            matrix[k, i] = (-1) ** (k - i) * comb(degree, k) * comb(k, i)
    return matrix


class Zeros(NamedTuple):
    """What is known of the zeros of polynomials in ``(0, 1]``; arrays of shape (polynomials,).

    Attributes
    ----------
    once, at_end, unclear
        It falls through its only zero; it falls to zero at the end; there may be several zeros.
    lowest, nearest
        Bounds from below on the polynomial, and on its size.
    """

    once: Any
    at_end: Any
    unclear: Any
    lowest: Any
    nearest: Any


def counted(b: Any) -> Zeros:
    """By Descartes' rule, from Bernstein coefficients."""
    count, first = _changes(b)
    at_end = (count == 0) & (first > 0) & (b[-1] == 0)
    return Zeros((count == 1) & (first > 0), at_end, count > 1, least(b), least(map(jnp.abs, b)))


def zeros(powers: Any) -> Zeros:
    """From coefficients of powers: at once if the curvature keeps its sign, else by Descartes."""
    start, end, degree = powers[0], powers.sum(axis=0), len(powers) - 1
    weights = np.array([[0.5 * k * (k - 1)] for k in range(3, degree + 1)])
    rest = (weights * jnp.abs(powers[3:])).sum(axis=0)
    hollow, hilly = powers[2] - rest >= 0, powers[2] + rest <= 0
    once = (start > 0) & (end < 0) & (hollow | hilly)
    none = (start > 0) & (end > 0) & hilly
    never = jnp.zeros_like(once)
    nearest = jnp.minimum(jnp.abs(start), jnp.abs(end))
    plain = Zeros(once, never, never, jnp.minimum(start, end), nearest)

    def by_descartes() -> Zeros:
        b = apply(bernstein_from_powers(degree), powers)
        return counted(jnp.concatenate([b[:-1], end[None]]))

    return when(~(once | none).all(), by_descartes, plain)


def least(rows: Iterable[Any]) -> Any:
    """The smallest entry of each column."""
    return reduce(jnp.minimum, rows)


def falling(found: Zeros, powers: Any) -> Any:
    """Where polynomials fall through their only zero, to some digits; infinity where there is none.

    ``powers``: sequence of degree + 1 arrays, shape (polynomials,).
    """
    return jnp.where(found.once, _newton(powers, found.once), jnp.where(found.at_end, 1.0, jnp.inf))


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


def _newton(powers: Any, wanted: Any) -> Any:
    """Zeros of polynomials that fall once in [0, 1]: Newton's steps within a bracket."""

    def far(carry: Any) -> Any:
        _, _, _, way, count = carry
        return (count < NEWTON) & (wanted & (way > NEARLY)).any()

    def closer(carry: Any) -> Any:
        left, right, s, _, count = carry
        value, rate, _ = horner(powers, s)
        left, right = jnp.where(value > 0, s, left), jnp.where(value > 0, right, s)
        new = s - value / jnp.where(rate < 0, rate, -1.0)
        inside = (rate < 0) & (new >= left) & (new <= right)
        new = jnp.where(inside, new, 0.5 * (left + right))
        return left, right, new, jnp.abs(new - s) / new, count + 1

    left, right = jnp.zeros_like(powers[0]), jnp.ones_like(powers[0])
    tangent = -powers[0] / jnp.where(powers[1] < 0, powers[1], -1.0)  # at the start
    first = jnp.where((powers[1] < 0) & (tangent < 1.0), tangent, 0.5)
    start = left, right, first, jnp.full_like(first, jnp.inf), jnp.array(0)
    return jax.lax.while_loop(far, closer, start)[2]


def horner(powers: Any, s: Any) -> tuple[Any, Any, Any]:
    """Polynomials and their first two derivatives."""
    value, first, half = powers[-1], jnp.zeros_like(s), jnp.zeros_like(s)
    for c in powers[-2::-1]:
        value, first, half = value * s + c, first * s + value, half * s + first
    return value, first, 2.0 * half


def shallow(powers: Any, order: Any, s: Any, tolerance: Any) -> Any:
    """Whether zeros ``s`` of polynomials ``s^order p(s)`` go no deeper than a tolerance."""
    found = jnp.isfinite(s)
    at = jnp.where(found, s, 0.5)
    _, first, second = horner(powers, at)
    power = jnp.where(order == 0, 1.0, jnp.where(order == 1, at, at * at))  # third order: bound
    second = 2 * order * first * power / at + power * second
    first = power * first
    return found & (first * second <= 0) & (first**2 <= 2 * jnp.abs(second) * tolerance)
