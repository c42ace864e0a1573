"""The lemma of complete chattering without symmetry, on balls (``docs/notes/certificates.md``).

While a gap's acceleration stays in ``[-M, -m]`` with ``m > 0``, a flight that leaves the
contact with gap speed ``v`` comes back with a speed in ``[v sqrt(m/M), v sqrt(M/m)]``. With
restitution ``r`` and ``rho = r sqrt(M/m) < 1`` the speeds contract, the flights' lengths
sum, and the sum is enclosed. Where the acceleration depends on the gap and evenly on its speed
alone, it comes back with the speed ``v`` itself, and ``rho = r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs


@attrs.frozen
class Chattering:
    """What the lemma says of a motion that leaves the contact with gap speed ``v``.

    Attributes
    ----------
    rho : arb
        Factor of the speeds, from above; the lemma speaks only where it is below 1.
    contracts : bool
        Whether ``rho < 1`` is shown.
    height, speed : arb
        Gap and absolute gap speed that the motion does not exceed: it stays in ``B(v)``.
    flight : (arb, arb)
        Bounds of the first flight's length.
    remaining : (arb, arb) or None
        Bounds of the time to the accumulation; None where ``rho < 1`` is not shown.
    """

    rho: Any
    contracts: bool
    height: Any
    speed: Any
    flight: tuple[Any, Any]
    remaining: tuple[Any, Any] | None


def chattering(v: Any, m: Any, M: Any, r: Any, even: bool = False) -> Chattering:
    """The lemma's numbers, every one rounded to its safe side.

    Parameters
    ----------
    v : float, ``(low, high)`` or arb
        Gap speed after the last impact, greater than 0.
    m, M : float or arb
        ``-M <= L_f^2 gap <= -m < 0`` on a box that holds ``B(v)`` and the remaining time;
        that it does is the caller's to check, with ``height``, ``speed``, ``remaining``.
    r : float, ``(low, high)`` or arb
        Restitution in that box.
    even : bool
        The acceleration depends on the gap and the square of its speed alone.

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
    """The exact ends of a number, a pair or a ball."""
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
        The box: gap and absolute gap speed at most these, for so long.

    Returns
    -------
    float
        Rounded down; 0 where ``rho < 1`` is not shown.
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
