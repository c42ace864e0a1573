"""The certificate of the map of section 4: complete chattering of the beam, from an impact on.

The lemma without (C2) on a box that starts as the impact itself and is made wider until what the
lemma says of the motion fits into it, all in ball arithmetic.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from ... import gallery
from ...zeno.lemma import chattering

#: Boxes that are tried, and how far one reaches, against what the last one asked for.
TRIES, WIDER = 20, 1.3


def accumulates(
    delta: float, gamma: float, w: float, t: float, v: float
) -> tuple[float, float] | None:
    """Bounds of the time at which the impacts accumulate; None where that is not proved.

    Parameters
    ----------
    delta, gamma, w : float
        Damping, amplitude and frequency of the forcing.
    t, v : float
        An impact: its time, and the speed after it.
    """
    from flint import arb, ctx

    from ...scene.balls import high, low
    from ...scene.interval import PRECISION

    own = beam()
    with ctx.workprec(PRECISION):
        wall, time, height, speed = arb(own.obstacle), arb(0), arb(0), arb(v)
        nearest = wall - wall**3
        for _ in range(TRIES):
            # x - x^3 falls with x beyond the obstacle, so that its bounds are at the ends
            farthest = (wall + height) - (wall + height) ** 3
            drive = gamma * (arb(w) * arb(t).union(arb(t) + time)).cos()
            damping = arb(delta) * speed
            m = -(nearest + drive + damping).upper()
            M = -(farthest + drive - damping).lower()
            if not m > 0:
                return None
            says = chattering(v, m, M, own.r)
            if says.remaining is None:
                return None
            least, most = says.remaining
            if says.height <= height and says.speed <= speed and most <= time:
                return low(arb(t) + least), high(arb(t) + most)
            time, height, speed = (WIDER * a for a in (most, says.height, says.speed))
    return None


def pushes_always(gamma: float) -> bool:
    """Whether the force presses the resting beam on the obstacle at all phases: proved."""
    from flint import arb, ctx

    from ...scene.interval import PRECISION

    with ctx.workprec(PRECISION):
        wall = arb(beam().obstacle)
        return bool(wall - wall**3 + abs(arb(gamma)) < 0)


@cache
def beam() -> Any:
    """The beam of the gallery, read once."""
    return gallery.known("moon_holmes").cls()
