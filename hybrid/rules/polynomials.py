"""Polynomials of one variable: sums of powers, and Bernstein's form on [0, 1]."""

from __future__ import annotations

import math

from .arrays import Floats, Matrix


def power_value(c: Floats, low: int, degree: int, s: float) -> tuple[float, float]:
    """Value and slope at ``s`` of the sum of ``c[low + k] s^k``, up to ``c[degree]``."""
    value = c[degree]
    slope = 0.0
    for k in range(degree - 1, low - 1, -1):
        slope = slope * s + value
        value = value * s + c[k]
    return value, slope


def two_values(c: Floats, s: float, t: float) -> tuple[float, float, float, float]:
    """Values and slopes of the sum of ``c[k] s^k`` at two places, as :func:`power_value` gives
    them: neither sum waits for the other."""
    at_s = at_t = c[c.shape[0] - 1]
    slope_s = slope_t = 0.0
    for k in range(c.shape[0] - 2, -1, -1):
        slope_s = slope_s * s + at_s
        slope_t = slope_t * t + at_t
        at_s = at_s * s + c[k]
        at_t = at_t * t + c[k]
    return at_s, slope_s, at_t, slope_t


def power_size(c: Floats, low: int, degree: int, s: float) -> float:
    """The sum of the sizes of the terms ``c[k] s^k``, from ``c[low]`` up to ``c[degree]``."""
    size = 0.0
    for k in range(degree, low - 1, -1):
        size = size * s + abs(c[k])
    for _ in range(low):
        size *= s
    return size


def shift(c: Floats, s: float) -> None:
    """The same polynomial, by powers of the distance from ``s``."""
    degree = c.shape[0] - 1
    for i in range(degree):
        for k in range(degree - 1, i - 1, -1):
            c[k] += s * c[k + 1]


def power_bound(c: Floats, low: int, degree: int) -> float:
    """A bound on the zeros of the sum of ``c[low + k] s^k`` (Fujiwara's); ``c[degree]`` not 0."""
    largest = 0.0
    for k in range(low, degree):
        if c[k] != 0.0:
            ratio = abs(c[k]) / abs(c[degree])
            largest = max(largest, ratio ** (1.0 / (degree - k)))
    return 2.0 * largest


def from_powers(c: Floats, low: int, degree: int, h: float, work: Matrix, row: int) -> bool:
    """Bernstein coefficients on ``[0, h]`` of the sum of ``c[low + k] s^k``; whether finite.

    The first of them hold the lower powers only, so that a zero close to 0 keeps its digits
    however large the higher ones are.
    """
    n = degree - low
    power = 1.0
    binomial = 1.0
    fit = True
    for k in range(n + 1):
        value = c[low + k] * power / binomial if c[low + k] != 0.0 else 0.0
        fit = fit and math.isfinite(value)
        work[row, k] = value
        power *= h
        binomial = binomial * (n - k) / (k + 1.0)
    for i in range(1, n + 1):
        for j in range(n, i - 1, -1):
            work[row, j] += work[row, j - 1]
    return fit


def halve(work: Matrix, row: int, n: int) -> None:
    """De Casteljau: the right half stays in a row, the left one is put into the next."""
    work[row + 1, 0] = work[row, 0]
    for j in range(1, n + 1):
        for k in range(n - j + 1):
            work[row, k] = 0.5 * (work[row, k] + work[row, k + 1])
        work[row + 1, j] = work[row, 0]


def bernstein_value(work: Matrix, row: int, n: int, s: float, scratch: int) -> float:
    """The value at ``s``, by de Casteljau in another row."""
    for k in range(n + 1):
        work[scratch, k] = work[row, k]
    for j in range(1, n + 1):
        for k in range(n - j + 1):
            low = work[scratch, k]
            work[scratch, k] = low + s * (work[scratch, k + 1] - low)
    return work[scratch, 0]


def weigh(work: Matrix, row: int, n: int, scratch: int) -> int:
    """Coefficients times binomials, in another row: those of powers of ``s / (1 - s)``.

    What is zero at both ends is left out (a power of ``s``, and of ``1 - s``); the degree left.
    """
    low = 0
    while work[row, low] == 0.0:
        low += 1
    binomial = 1.0
    last = 0
    for k in range(n + 1):
        if k >= low:
            work[scratch, k - low] = binomial * work[row, k]
            if work[row, k] != 0.0:
                last = k - low
        binomial = binomial * (n - k) / (k + 1.0)
    return last


def newton(work: Matrix, scratch: int, n: int, s: float) -> tuple[float, float]:
    """The sign of a weighed polynomial at ``s``, and where Newton's step leads; NaN if nowhere.

    Horner's rule in ``s / (1 - s)``, or from the other end: every term has a weight below one.
    """
    near = 1.0 - s if s <= 0.5 else s
    u = (s if s <= 0.5 else 1.0 - s) / near
    value = 0.0
    slope = 0.0
    for k in range(n, -1, -1):
        slope = slope * u + value
        value = value * u + work[scratch, k if s <= 0.5 else n - k]
    slope -= n * near * value
    if slope == 0.0:
        return value, math.nan
    step = near * near * value / slope
    return value, s - step if s <= 0.5 else s + step
