"""Example 2 of the paper: its runs, and what is certified of a bead on a moving table."""

from __future__ import annotations

from functools import cache
from math import pi
from typing import Any

import numpy as np

from hybrid import gallery
from hybrid.certificates import certify
from hybrid.certificates.result import Certificate
from hybrid.result import Trajectory
from hybrid.simulation import simulate

from ..runs import OTHER

#: Example 2 as printed: where it starts, and its domain.
HEIGHT, LOW, HIGH, FASTEST = 1.9, 0.1, 2.0, 7.0

#: How long a run lasts.
LASTS = 20.0


def model() -> Any:
    """The bead with the values of Example 2, which are the gallery's."""
    return gallery.find("bead_on_table").cls()


@cache
def flown(t0: float) -> Trajectory:
    """The run from rest at the printed height, at a time."""
    return simulate(model(), {"x": HEIGHT, "v": 0.0}, (t0, t0 + LASTS), solver="taylor")


def printed() -> Trajectory:
    """The run from where Example 2 starts: ``t = 2 pi / omega``."""
    return flown(2 * pi / model().omega)


@cache
def printed_again() -> Trajectory:
    """The same by another method, as far as its first impacts."""
    t0 = 2 * pi / model().omega
    return simulate(model(), {"x": HEIGHT, "v": 0.0}, (t0, t0 + 0.6 * LASTS), max_jumps=40, **OTHER)


def turned() -> Trajectory:
    """The run from where the table turns: ``t = pi / (2 omega)``."""
    return flown(pi / (2 * model().omega))


@cache
def by_theorem() -> Certificate:
    """Theorem 1 asked of the moving table, on the domain of Example 2."""
    return certify(model(), {"x": (LOW, HIGH), "v": (-FASTEST, FASTEST)})


@cache
def by_lemma() -> Certificate:
    """The lemma without (C2), relative to the table, over two of its periods."""
    periods = (0.0, 4 * pi / model().omega)
    return certify(model(), {"gap": (0.0, HIGH), "speed": (0.0, FASTEST), "t": periods})


@cache
def held_still() -> Certificate:
    """Theorem 1 for the same bead over a floor that does not move, with the paper's h - phi."""
    still = gallery.find("bead_on_table").cls(amplitude=0.0)
    return certify(still, {"x": (0.0, HIGH - LOW), "v": (-FASTEST, FASTEST)})


def table(t: Any) -> tuple[Any, Any]:
    """Position and velocity of the table."""
    own = model()
    phase, size = own.omega * np.asarray(t, dtype=float), own.amplitude
    return size * np.sin(phase), size * own.omega * np.cos(phase)


def impacts(run: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times of the impacts, and the bead's velocity relative to the table before and after."""
    moves = table(run.jumps.t)[1]
    return run.jumps.t, run.jumps.before.v - moves, run.jumps.after.v - moves


def covered_from(run: Trajectory) -> int:
    """The first impact whose speed and time the lemma's certificate covers; 0 for none."""
    proof = by_lemma().initial_set or {}
    (slow, fast), (first, last) = (proof.get(name, (0.0, -1.0)) for name in ("speed", "t"))
    t, _, after = impacts(run)
    period = 2 * pi / model().omega
    covers = (after > slow) & (after <= fast) & (last - first >= period)
    return int(np.argmax(covers)) + 1 if np.any(covers) and t.size else 0


def fastest(proof: Certificate) -> float:
    """The largest relative speed from which the certificate proves chattering."""
    return (proof.initial_set or {}).get("speed", (0.0, 0.0))[1]
