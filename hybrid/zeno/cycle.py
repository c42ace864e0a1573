"""Where a cycle of jumps accumulates, by sequence acceleration.

Cycles of edges have no chatter map to be summed: two tanks filled by turns, a block that rocks
from edge to edge, a contact that forgets to damp slow impacts. What is known of them is the
sequence of the times and states at which a cycle closes. Its limit is found in three steps, each
of which may say no.

1. *Raabe's test.* With ``a_k`` the durations of successive cycles, ``q_k = 1 / (a_{k-1}/a_k - 1)``
   grows by ``1/p`` a cycle where ``a_k`` falls like ``k^-p``, and stays where it falls like a
   geometric series. Only sequences that grow by less than ``1/p`` with ``p`` clearly above 1 have a
   sum: the harmonic one is turned away.
2. *Acceleration.* Wynn's epsilon algorithm (exact for sums of geometric sequences) and Levin's
   transformation (for those that fall like powers) give estimates from fewer and more terms. What
   changes between the last ones bounds the error. Weniger, *Nonlinear sequence transformations*,
   Computer Physics Reports 10 (1989).
3. *The cause.* Shrinking gaps are a suspicion only. At the limit every guard of the cycle must be
   zero and every reset must leave the state where it is; :mod:`hybrid.run.driver` asks that of the
   model.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

#: Cycles that show a cycle; cycles that do where durations fall like a power; longest period.
LEAST, MOST, LONGEST = 6, 48, 8

#: Power of the cycle's number by which durations must fall, at least.
RAABE = 1.1

#: Growth of Raabe's quantity above which durations fall like a power.
POWER = 0.05

#: Most terms of Levin's transformation, and how its places thin out towards the start.
TERMS, THIN = 12, 0.7

#: Largest share of the time since the first cycle that may be left to the limit.
LEFT = 1e-3

#: What is left, against what the last estimates changed.
CAUTION = 8.0

#: Rounding of times and states, relative.
ROUNDING = 4e-16


@attrs.frozen(eq=False)
class CycleLimit:
    """Where a cycle of jumps accumulates.

    Attributes
    ----------
    edges : tuple of str
    remaining : float
        Time from the last jump to the limit.
    x_inf : array
        The state there.
    ratio : float
        Limit of the ratio of successive durations: 1 where they fall like a power.
    t_error : float
    x_error : array
        Bounds on the error of the acceleration (not of what came before it).
    """

    edges: tuple[str, ...]
    remaining: float
    x_inf: np.ndarray
    ratio: float
    t_error: float
    x_error: np.ndarray


def period(edges: Sequence[str]) -> int:
    """Edges in the shortest cycle of which the last ones are repetitions; 0 if there is none."""
    for length in range(1, LONGEST + 1):
        needed = length * (LEAST + 1)
        if len(edges) < needed:
            return 0
        last = list(edges[-needed:])
        if last[length:] == last[:-length]:
            return length
    return 0


def limit(
    edges: tuple[str, ...], times: np.ndarray, states: np.ndarray, rtol: float, atol: float
) -> CycleLimit | None:
    """The limit of a cycle; None where it does not accumulate, or not well enough yet.

    Parameters
    ----------
    times : array, shape (cycles + 1,)
        When the cycle closed, from the first time on.
    states : array, shape (cycles + 1, n)
        States after those jumps.
    rtol, atol : float
        What the jumps are known to: the limit need not be known better.
    """
    durations = np.diff(times)
    if len(durations) < LEAST or not (np.all(durations > 0) and np.all(np.diff(durations) < 0)):
        return None
    growth = _raabe(durations)
    if not growth < 1.0 / RAABE:
        return None
    power = growth > POWER
    columns = np.column_stack([times, states])
    with np.errstate(all="ignore"):  # steps that vanish to rounding: no estimate is best there
        now, error = np.array([_accelerated(column, power) for column in columns.T]).T
    elapsed, remaining = float(times[-1]), float(now[0] - times[-1])
    scale = np.abs(now) + np.ptp(columns, axis=0)
    error = error + ROUNDING * len(times) * scale
    settled = np.all(error <= max(rtol, 1e-13) * np.maximum(scale, scale[0]) + atol)
    near = remaining <= LEFT * elapsed or (power and len(times) >= MOST)
    if not (remaining > 0 and settled and near):
        return None
    ratio = 1.0 if power else float(durations[-1] / durations[-2])
    return CycleLimit(edges, remaining, now[1:], ratio, float(error[0]), error[1:])


def _raabe(durations: np.ndarray) -> float:
    """Growth of ``1 / (a_{k-1}/a_k - 1)`` a cycle, over the last half."""
    own = 1.0 / (durations[:-1] / durations[1:] - 1.0)
    half = len(own) // 2
    return float((own[-1] - own[half]) / (len(own) - 1 - half))


def _accelerated(sequence: np.ndarray, power: bool) -> tuple[float, float]:
    """The limit of a sequence, and a bound on its error."""
    tables = [_levin(sequence)] if power else [_epsilon(sequence[-MOST:]), _levin(sequence)]
    best = (float(sequence[-1]), float("inf"))
    for estimates in tables:
        steps = np.abs(np.diff(estimates))
        for value, *two in zip(estimates[2:], steps, steps[1:], strict=False):
            if CAUTION * max(two) < best[1]:
                best = (value, CAUTION * float(max(two)))
    return best


def _epsilon(sequence: np.ndarray) -> list[float]:
    """Wynn's epsilon algorithm: the last entry of each even column."""
    before, now, estimates = np.zeros(len(sequence) + 1), sequence, [float(sequence[-1])]
    for column in range(1, len(sequence)):
        steps = np.diff(now)
        if np.any(steps == 0.0):
            return [*estimates, *[float(now[-1])] * 2] if column % 2 else estimates
        before, now = now, before[1:-1] + 1.0 / steps
        if column % 2 == 0:
            estimates.append(float(now[-1]))
    return estimates


def _levin(sequence: np.ndarray) -> list[float]:
    """Levin's transformation, from few terms to many, at places that thin out geometrically.

    The remainder is ``k a_k`` times a polynomial in ``1/k``. (At successive places, as in the
    u-transform, it would be the same but for rounding, which this keeps small.)
    """
    count = np.arange(1, len(sequence))
    terms = np.diff(sequence)
    if np.any(terms == 0.0):
        return [float(sequence[-1])] * 3
    estimates = []
    for k in range(1, TERMS + 1):
        place = np.unique(np.round(count[-1] * THIN ** np.arange(k + 1)).astype(int))
        if len(place) <= k:
            break
        powers = (place[-1] / place)[:, None] ** np.arange(k)
        rows = np.column_stack([np.ones(k + 1), (place * terms[place - 1])[:, None] * powers])
        try:
            estimates.append(float(np.linalg.solve(rows, sequence[place])[0]))
        except np.linalg.LinAlgError:  # terms that do not thin out: no limit to be seen
            return []
    return estimates
