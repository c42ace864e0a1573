"""The lemma of complete chattering, in ball arithmetic (``docs/notes/certificates.md``).

While a gap's acceleration stays in ``[-M, -m]`` with ``m > 0``, a flight that leaves the contact
with gap speed ``v`` returns with a speed in ``[v sqrt(m/M), v sqrt(M/m)]``. With restitution ``r``
and ``rho = r sqrt(M/m) < 1`` the speeds contract, the durations of the flights have a finite sum,
and the sum is enclosed. If the acceleration depends only on the gap and, evenly, on its speed, the
flight returns with speed ``v``, and ``rho = r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs


@attrs.frozen
class Chattering:
    """Conclusions of the lemma for a motion that leaves the contact with gap speed ``v``.

    Attributes
    ----------
    rho : arb
        Upper bound on the ratio of successive speeds; the lemma applies only if it is below 1.
    contracts : bool
        Whether ``rho < 1`` is shown.
    height, speed : arb
        Bounds on the gap and the absolute gap speed: the motion stays in ``B(v)``.
    flight : (arb, arb)
        Bounds on the duration of the first flight.
    remaining : (arb, arb) or None
        Bounds on the time to the accumulation; None if ``rho < 1`` is not shown.
    """

    rho: Any
    contracts: bool
    height: Any
    speed: Any
    flight: tuple[Any, Any]
    remaining: tuple[Any, Any] | None


def chattering(v: Any, m: Any, M: Any, r: Any, even: bool = False) -> Chattering:
    """Apply the lemma; each bound is rounded to the safe side.

    Parameters
    ----------
    v : float, ``(low, high)`` or arb
        Gap speed after the last impact, greater than 0.
    m, M : float or arb
        ``-M <= L_f^2 gap <= -m < 0`` on a box that contains ``B(v)`` and the remaining time; the
        caller must check containment, with ``height``, ``speed`` and ``remaining``.
    r : float, ``(low, high)`` or arb
        Restitution in that box.
    even : bool
        Whether the acceleration depends only on the gap and the square of its speed.

    Returns
    -------
    Chattering
    """
    from flint import arb, ctx

    from ..bounds.interval import PRECISION

    with ctx.workprec(PRECISION):
        (least, most), (weak, strong) = _ends(v), _ends(r)
        m, M = _ends(m)[0], _ends(M)[1]
        growth = arb(1) if even else (M / m).sqrt().upper()
        rho = (strong * growth).upper()
        contracts = bool(m > 0 and least > 0 and weak >= 0 and rho < 1)
        remaining = None
        if contracts:
            slow = 1 - (weak / growth).lower()
            remaining = (2 * least / (M * slow)).lower(), (2 * most / (m * (1 - rho))).upper()
        return Chattering(
            rho,
            contracts,
            (most**2 / (2 * m)).upper(),
            (most * growth).upper(),
            ((2 * least / M).lower(), (2 * most / m).upper()),
            remaining,
        )


def _ends(bounds: Any) -> tuple[Any, Any]:
    """The ends of a number, a pair or a ball, as exact balls."""
    from flint import arb

    if isinstance(bounds, Sequence):
        return arb(float(bounds[0])), arb(float(bounds[1]))
    bounds = arb(bounds)
    return bounds.lower(), bounds.upper()


def largest_speed(m: float, M: float, r: Any, height: float, speed: float, time: float) -> float:
    """The largest gap speed for which ``B(v)`` and the remaining time fit into a box.

    Parameters
    ----------
    m, M, r
        As in :func:`chattering`; ``rho < 1``.
    height, speed, time : float
        Size of the box: largest gap, largest absolute gap speed, and duration.

    Returns
    -------
    float
        Rounded down; 0 if ``rho < 1`` is not shown.
    """
    from flint import arb, ctx

    from ..bounds.balls import low
    from ..bounds.interval import PRECISION

    unit = chattering(1.0, m, M, r)
    if unit.remaining is None:
        return 0.0
    with ctx.workprec(PRECISION):
        bounds = [(2 * arb(m) * arb(height)).sqrt(), arb(speed) / unit.speed]
        if time < float("inf"):
            bounds.append(arb(time) / unit.remaining[1])
        return min(low(bound) for bound in bounds)
