"""The certificate of the map of section 4: complete chattering of the beam, from an impact on."""

from __future__ import annotations

from functools import cache
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.lowering import scene_of
from hybrid.zeno.enclose import prove


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
    own = attrs.evolve(beam(), delta=delta, gamma=gamma, w=w)
    found = prove(scene_of(own).field("flight"), "impact", t, np.array([own.obstacle, v]), v)
    return (found.low, found.high) if found else None


def pushes_always(gamma: float) -> bool:
    """Whether the force presses the resting beam on the obstacle at all phases: proved."""
    from flint import arb, ctx

    from hybrid.bounds.interval import PRECISION

    with ctx.workprec(PRECISION):
        wall = arb(beam().obstacle)
        return bool(wall - wall**3 + abs(arb(gamma)) < 0)


@cache
def beam() -> Any:
    """The beam of the gallery, read once."""
    return gallery.find("moon_holmes").cls()
