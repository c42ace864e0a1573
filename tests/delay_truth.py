"""Delay equations with closed forms: what the tests of delays compare with.

A ``Truth`` is a scalar equation ``y' = field(m, t, y, past)`` with its solution. ``past(lag)`` is
``y(t - lag)``; ``m`` is the module whose functions are called, ``math`` here and ``jax.numpy`` in a
model, and so in ``history(m, t)``, the solution before ``span[0]``. ``breaks`` are the times at
which a derivative of the solution jumps, with the order of the first that does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import count
from typing import NamedTuple

ROOT_2 = math.sqrt(2)


class Truth(NamedTuple):
    field: Callable
    value: Callable
    span: tuple[float, float]
    breaks: dict[float, int] = {}
    history: Callable = lambda m, t: 1.0


# ---------------------------------------------------------------------------------------
# y' = -y(t - 1): polynomials


def answer(t):
    """What ``y' = -y(t - 1)`` makes of a unit jump at time zero out of nothing, exactly.

    ``K(t) = sum over k <= t of (-1)^k (t - k)^k / k!``: a step, then a corner, smoother each lag.
    """
    t = Fraction(t)
    return sum(
        ((k - t) ** k / Fraction(math.factorial(k)) for k in range(math.floor(t) + 1)), Fraction(0)
    )


def unit_lag(t):
    """``y' = -y(t - 1)`` with ``y = 1`` for ``t <= 0``, exactly at a rational time."""
    return answer(Fraction(t) + 1) if t > 0 else Fraction(1)


def unit_lag_kicked(t, at=Fraction(1, 2), kick=2):
    """The same with ``y`` raised by ``kick`` at the time ``at``; the value after it there."""
    return unit_lag(t) + kick * answer(Fraction(t) - at)


UNIT_LAG = Truth(
    field=lambda m, t, y, past: -past(1.0),
    value=lambda t: float(unit_lag(t)),
    span=(0.0, 10.0),
    breaks={float(k): k + 1 for k in range(10)},
)

# ---------------------------------------------------------------------------------------
# exponentials and waves: smooth solutions, no breaking point

WAVE = Truth(
    field=lambda m, t, y, past: -past(math.pi / 2),
    value=math.cos,
    span=(0.0, 20.0),
    history=lambda m, t: m.cos(t),
)


def two_lags(first=1.0, second=ROOT_2, decay=0.1, omega=2.0):
    """``y' = b y(t - first) + c y(t - second)``, solved by ``exp(-decay t) cos(omega t)``.

    ``z = b exp(-z first) + c exp(-z second)`` for ``z = -decay + i omega``: two real equations.
    """
    z = complex(-decay, omega)
    p, q = (
        math.exp(decay * lag) * complex(math.cos(omega * lag), -math.sin(omega * lag))
        for lag in (first, second)
    )
    area = p.real * q.imag - p.imag * q.real
    b = (z.real * q.imag - z.imag * q.real) / area
    c = (p.real * z.imag - p.imag * z.real) / area
    return Truth(
        field=lambda m, t, y, past: b * past(first) + c * past(second),
        value=lambda t: math.exp(-decay * t) * math.cos(omega * t),
        span=(0.0, 10.0),
        history=lambda m, t: m.exp(-decay * t) * m.cos(omega * t),
    )


TWO_LAGS = two_lags()


def short_lag(lag):
    """``y' = -y(t - lag)`` on its slowest root, ``exp(z t)`` with ``z = -exp(-z lag)``."""
    z = -1.0
    for _ in range(50):
        pull = math.exp(-z * lag)
        z -= (z + pull) / (1 - lag * pull)
    return Truth(
        field=lambda m, t, y, past: -past(lag),
        value=lambda t: math.exp(z * t),
        span=(0.0, 1.0),
        history=lambda m, t: m.exp(z * t),
    )


# ---------------------------------------------------------------------------------------
# lags that depend on the time


def pantograph(t):
    """``y' = -y(t / 2)``, ``y(0) = 1``: the sum of ``(-t)^n / (n! 2^(n (n - 1) / 2))``."""
    total, term = 0.0, 1.0
    for n in count(1):
        total += term
        term *= -t / (n * 2.0 ** (n - 1))
        if abs(term) < 1e-18:
            return total


#: The lag vanishes at the start and grows for ever.
PANTOGRAPH = Truth(field=lambda m, t, y, past: -past(t / 2), value=pantograph, span=(0.0, 10.0))


def at(polynomial, t):
    """The value of a polynomial given by its coefficients, the constant one first."""
    return sum(c * t**k for k, c in enumerate(polynomial))


def halving(t):
    """``y' = -y(t / 2)`` with ``y = 1`` for ``t <= 1``, exactly: a polynomial an octave."""
    begin, piece = Fraction(1), [Fraction(1)]
    while t > begin:
        rise = [Fraction(0), *(-c / (2**k * (k + 1)) for k, c in enumerate(piece))]
        piece = [at(piece, begin) - at(rise, begin), *rise[1:]]
        begin *= 2
    return at(piece, Fraction(t))


#: The lag grows, and with it the distance of the breaking points.
HALVING = Truth(
    field=lambda m, t, y, past: -past(t / 2),
    value=lambda t: float(halving(t)),
    span=(1.0, 20.0),
    breaks={1.0: 1, 2.0: 2, 4.0: 3, 8.0: 4, 16.0: 5},
)

# ---------------------------------------------------------------------------------------
# lags that depend on the state: breaking points are where the solution has a certain value


def feldstein(t):
    """Feldstein and Neves' ``y' = y(y - sqrt 2 + 1) / (2 sqrt t)``, ``y = 1`` for ``t <= 1``."""
    if t <= 1:
        return 1.0
    if t <= 2:
        return math.sqrt(t)
    return t / 4 + 0.5 + (1 - 1 / ROOT_2) * math.sqrt(t)


#: It breaks where ``y = sqrt 2``, and where ``y = 1 + sqrt 2``: there this form ends.
FELDSTEIN = Truth(
    field=lambda m, t, y, past: past(t - (y - ROOT_2 + 1)) / (2 * m.sqrt(t)),
    value=feldstein,
    span=(1.0, (3 * ROOT_2 - 2) ** 2),
    breaks={1.0: 1, 2.0: 2},
)


def neves(t):
    """Neves' ``y' = y y(ln y) / t``, ``y = 1`` for ``t <= 1``."""
    if t <= 1:
        return 1.0
    if t <= math.e:
        return t
    if t <= math.e**2:
        return math.exp(t / math.e)
    return (math.e / (3 - math.log(t))) ** math.e


#: It breaks where ``y = e`` and where ``y = e^e``.
NEVES = Truth(
    field=lambda m, t, y, past: y * past(t - m.log(y)) / t,
    value=neves,
    span=(1.0, 10.0),
    breaks={1.0: 1, math.e: 2, math.e**2: 3},
)

TRUTHS = {
    "unit lag": UNIT_LAG,
    "wave": WAVE,
    "two lags": TWO_LAGS,
    "short lag, 1e-3": short_lag(1e-3),
    "short lag, 1e-6": short_lag(1e-6),
    "pantograph": PANTOGRAPH,
    "halving": HALVING,
    "Feldstein": FELDSTEIN,
    "Neves": NEVES,
}
