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
3. *The cause.* Shrinking gaps are a suspicion only. At the limit the guard of each jump must be
   zero where the jump before it leads, and the resets of a turn must lead back to where it began;
   :mod:`hybrid.run.limits` asks that of the model.

A cycle that shrinks to an eighth or less a turn is at rounding after a few turns, too few for the
first two steps. There each duration is a small part of the one before, so that Aitken's formula,
which is exact for one geometric sequence, is asked after three turns already; what it changes from
one turn to the next is an error that only grows smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..rules.lanes import FAST_FALL, FEW_TURNS, LONGEST_CYCLE

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Turns that show a cycle, and turns that do where durations fall like a power.
LEAST_CYCLES, POWER_CYCLES = 6, 48

#: Power of the cycle's number by which durations must fall, at least.
RAABE = 1.1

#: Growth of Raabe's quantity above which durations fall like a power.
RAABE_GROWTH = 0.05

#: Most terms of Levin's transformation, and how its places thin out towards the start.
TERMS, THIN = 12, 0.7

#: Largest share of the time since the first cycle that may be left to the limit.
LEFT_TO_LIMIT = 1e-3

#: Share of its largest distance to the limit at which a state must have arrived. (The sum of a
#: sequence that only changes sign has a value, but no limit.)
NEARER = 0.5

#: What is left, against what the last estimates changed.
ESTIMATE_CAUTION = 8.0

#: Rounding of times and states, relative.
CYCLE_ROUNDING = 4e-16


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
    turns : int
        Closings of the cycle that were used.
    limits : tuple of (edge, array)
        Where resets move the state: the jumps of a turn, and the limits of the states after them;
        the last is ``x_inf``.
    """

    edges: tuple[str, ...]
    remaining: float
    x_inf: Numbers
    ratio: float
    t_error: float
    x_error: Numbers
    turns: int
    limits: tuple[tuple[str, np.ndarray], ...] = ()


def period(edges: Sequence[str], turns: int = LEAST_CYCLES) -> int:
    """Edges in the shortest cycle of which the last ones are repetitions; 0 if there is none.

    The turns before the last, which it repeats, must be as many as ``turns``.
    """
    for length in range(1, LONGEST_CYCLE + 1):
        needed = length * (turns + 1)
        if len(edges) < needed:
            return 0
        last = list(edges[-needed:])
        if last[length:] == last[:-length]:
            return length
    return 0


def limit(
    edges: tuple[str, ...],
    times: Numbers,
    states: Matrix,
    rtol: float,
    atol: float,
    beside: Sequence[int] = (),
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
    beside
        See :func:`accelerated`.
    """
    durations = np.diff(times)
    if not (np.all(durations > 0) and np.all(np.diff(durations) < 0)):
        return None
    turns = _fast(durations)
    if turns >= FEW_TURNS:
        times, states, growth = times[-turns - 1 :], states[-turns - 1 :], 0.0
    elif len(durations) >= LEAST_CYCLES:
        growth = _raabe(durations)
    else:
        return None
    if not growth < 1.0 / RAABE:
        return None
    power = growth > RAABE_GROWTH
    columns = np.column_stack([times, states])
    now, error, scale = accelerated(columns, power, [1 + i for i in beside])
    elapsed, remaining = float(durations.sum()), float(now[0] - times[-1])
    slack = max(rtol, 1e-13) * np.maximum(scale, scale[0]) + atol
    settled = np.all(np.delete(error <= slack, [1 + i for i in beside]))
    near = remaining <= LEFT_TO_LIMIT * elapsed or (power and len(times) >= POWER_CYCLES)
    if not (remaining > 0 and settled and near and np.all(np.isfinite(now))):
        return None
    off = np.abs(states - now[1:])
    if np.any(off[-1] > NEARER * off.max(axis=0) + error[1:]):
        return None
    ratio = 1.0 if power else float(durations[-1] / durations[-2])
    return CycleLimit(edges, remaining, now[1:], ratio, float(error[0]), error[1:], len(times))


def accelerated(
    columns: Matrix, power: bool, beside: Sequence[int] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Limits of sequences, one a column; bounds on their errors; their sizes.

    Columns ``beside`` are of discrete variables by which nothing else goes: they stay as they are,
    and where they still change their error is infinite.
    """
    with np.errstate(all="ignore"):  # steps that vanish to rounding: no estimate is best there
        now, error = np.array([_accelerated(column, power) for column in columns.T]).T
    scale, rounding = np.abs(now) + np.ptp(columns, axis=0), CYCLE_ROUNDING * len(columns)
    error += rounding * scale
    for k in beside:
        now[k], error[k] = columns[-1, k], np.inf if np.ptp(columns[-FEW_TURNS:, k]) else 0.0
    return now, error, scale


def _fast(durations: Numbers) -> int:
    """How many of the last durations are each a small part of the one before."""
    slow = np.flatnonzero(durations[1:] > FAST_FALL * durations[:-1])
    return len(durations) - (int(slow[-1]) + 1 if len(slow) else 0)


def _raabe(durations: Numbers) -> float:
    """Growth of ``1 / (a_{k-1}/a_k - 1)`` a cycle, over the last half."""
    own = 1.0 / (durations[:-1] / durations[1:] - 1.0)
    half = len(own) // 2
    return float((own[-1] - own[half]) / (len(own) - 1 - half))


def _accelerated(sequence: Numbers, power: bool) -> tuple[float, float]:
    """The limit of a sequence, and a bound on its error."""
    if len(sequence) <= LEAST_CYCLES:
        before, now = _aitken(sequence[:-1]), _aitken(sequence)
        return now, ESTIMATE_CAUTION * abs(now - before)
    tables = [_levin(sequence)] if power else [_epsilon(sequence[-POWER_CYCLES:]), _levin(sequence)]
    best = (float(sequence[-1]), float("inf"))
    for estimates in tables:
        steps = np.abs(np.diff(estimates))
        for value, *two in zip(estimates[2:], steps, steps[1:], strict=False):
            if ESTIMATE_CAUTION * max(two) < best[1]:
                best = (value, ESTIMATE_CAUTION * float(max(two)))
    return best


def _aitken(sequence: np.ndarray) -> float:
    """Aitken's formula on the last three: the limit, if the steps are a geometric sequence."""
    before, last = np.diff(sequence[-3:])
    still = abs(last) <= CYCLE_ROUNDING * len(sequence) * abs(sequence[-1])
    return float(sequence[-1] + (0.0 if still else last * last / (before - last)))


def _epsilon(sequence: Numbers) -> list[float]:
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


def _levin(sequence: Numbers) -> list[float]:
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
