"""Polynomials of one variable, as arrays of coefficients."""

from __future__ import annotations

from .arrays import Floats

__all__ = ("power_value",)


def power_value(c: Floats, degree: int, s: float) -> float:
    """The value at ``s`` of the sum of ``c[k] s^k``."""
    value = c[degree]
    for k in range(degree - 1, -1, -1):
        value = value * s + c[k]
    return value
