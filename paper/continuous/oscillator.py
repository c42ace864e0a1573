"""Section 5 of the paper: the driven oscillator's run, its extrema, what its acceleration does."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.result import Trajectory
from hybrid.simulation import simulate
from hybrid.trajectory.arcs import Arc

#: Damping, stiffness and drive of the oscillator, as printed.
C, K, DRIVE = 3.0, 2.0, 20.0

#: Last time of the run.
END = 40.0

#: Places at which a flight is looked at for changes of sign; a second look takes twice as many.
LOOKS = 64


@cache
def flown() -> Trajectory:
    """The run from the printed start, to where the oscillator has come to its equilibrium."""
    entry = gallery.find("coupled")
    return simulate(entry.cls(), entry.start, (0.0, END), solver="taylor", rtol=1e-14, atol=1e-14)


def pull(states: np.ndarray) -> np.ndarray:
    """The part of x4' that is continuous: -2 x3 - 3 x4."""
    return -K * states[..., 2] - C * states[..., 3]


def jerk(states: np.ndarray) -> np.ndarray:
    """Its derivative along the flow, 6 x3 + 7 x4 - 60 x2^2."""
    own = C * K * states[..., 2] + (C * C - K) * states[..., 3]
    return own - C * DRIVE * states[..., 1] ** 2


def force(states: np.ndarray) -> np.ndarray:
    """x4' itself."""
    return pull(states) + DRIVE * states[..., 1] ** 2


def chattering(run: Trajectory) -> list[Arc]:
    """The flights before the accumulation."""
    return [arc for arc in run.arcs if ".rest(" not in arc.mode]


@attrs.frozen
class Turn:
    """A change of sign: its time, the state there, and whether it happens at an impact."""

    t: float
    state: np.ndarray
    jumps: bool


def turns(run: Trajectory, of: Any, looks: int = LOOKS) -> list[Turn]:
    """Where a function of the state changes sign before the accumulation, impacts included."""
    found, before = [], 0.0
    for arc in chattering(run):
        grid = np.linspace(0.0, arc.length, looks + 1)
        values = of(arc.local(grid))
        if before * values[0] < 0.0:
            found.append(Turn(arc.t0, arc.first, True))
        for i, k in pairwise(np.flatnonzero(values)):  # a look may be exactly at a zero
            if values[i] * values[k] > 0.0:
                continue
            place = _root(arc, of, grid[i], grid[k])
            found.append(Turn(arc.t0 + place, arc.local(place), False))
        before = float(values[-1]) or before
    return found


def _root(arc: Arc, of: Any, low: float, high: float) -> float:
    from scipy.optimize import brentq

    ends = [float(of(arc.local(s))) for s in (low, high)]
    if ends[0] * ends[1] >= 0.0:  # one look is at the zero, and rounds to either side of it
        return float((low, high)[int(np.argmin(np.abs(ends)))])
    return float(brentq(lambda s: float(of(arc.local(s))), low, high, xtol=1e-14))


def nearest_miss(run: Trajectory, of: Any) -> float:
    """The least absolute value at which a function of the state turns without reaching zero."""
    return min(_misses(run, of), default=np.inf)


def _misses(run: Trajectory, of: Any) -> Iterator[float]:
    for arc in chattering(run):
        values = of(arc.local(np.linspace(0.0, arc.length, 2 * LOOKS + 1)))
        inner, size = values[1:-1], np.abs(values)
        turns_ = (inner - values[:-2]) * (values[2:] - inner) <= 0.0
        apart = (values[:-2] * inner > 0.0) & (inner * values[2:] > 0.0)
        towards = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])
        yield from size[1:-1][turns_ & apart & towards]


def settled_from(run: Trajectory) -> int:
    """The first impact from which x4' is bounded away from zero by an estimate.

    x4' is at least p = -2 x3 - 3 x4, since the drive is never negative, and p differs from its
    limit by at most the time that is left times the largest |p'|, where
    |p'| <= |6 x3 + 7 x4| + 60 v^2 and v is the speed after the impact.
    """
    point, limit = run.zeno[0], float(pull(limit_state(run)))
    arcs = chattering(run)[1:]
    largest = 0.0
    first = len(arcs)
    for number, arc in reversed(list(enumerate(arcs, start=1))):
        rates = jerk(arc.local(np.linspace(0.0, arc.length, 9)))
        speed = float(arc.first[1])
        largest = max(largest, float(np.max(np.abs(rates)))) + C * DRIVE * speed**2
        if limit - (point.t - arc.t0) * largest <= 0.0:
            break
        largest -= C * DRIVE * speed**2
        first = number
    return first


def stays_after(state: np.ndarray) -> bool:
    """Whether x4 < 0 < x4' from a state on, the ball being at rest.

    With ``x3 = p exp(-s) + q exp(-2 s)``: ``-x4 = p exp(-s) + 2 q exp(-2 s)`` and
    ``x4' = p exp(-s) + 4 q exp(-2 s)``, positive at all ``s >= 0`` if ``p > -4 q > 0``.
    """
    p, q = 2.0 * state[2] + state[3], -state[2] - state[3]
    return bool(p > -4.0 * q > 0.0)


def limit_state(run: Trajectory) -> np.ndarray:
    return np.array(list(run.zeno[0].state))


def extrema(run: Trajectory) -> dict[str, tuple[list[Turn], int]]:
    """Extrema of x3 and x4, each with the count of a second, finer look."""
    found = {"x3": lambda s: s[..., 3], "x4": force}
    return {
        name: (turns(run, of), len(turns(run, of, 2 * LOOKS - 1))) for name, of in found.items()
    }


def oscillates(run: Trajectory) -> bool:
    """Whether x4' rises before and falls at every impact near the limit."""
    error = error_of(run.zeno[0], C * K, C * C - K)
    return float(jerk(limit_state(run))) > error and peaks(run) > 100


def peaks(run: Trajectory) -> int:
    """Impacts at the end of the list before which x4' rises, and at which it falls."""
    own = gallery.find("coupled").cls()
    x2, x3, x4 = (np.asarray(getattr(run.jumps.before, n)) for n in ("x2", "x3", "x4"))
    states = np.stack([x2, x2, x3, x4], axis=-1)
    rises = jerk(states) - 2.0 * DRIVE * own.g * x2 > 0.0
    falls = x2**2 > run.jumps.after.x2**2
    shown = rises & falls
    return int(len(shown) - 1 - np.max(np.flatnonzero(~shown), initial=-1))


def error_of(point: Any, a: float, b: float) -> float:
    """Bound on the error of ``a x3 + b x4`` at the limit."""
    return abs(a) * float(point.state_error.x3) + abs(b) * float(point.state_error.x4)
