"""The limit of a cycle of jumps, by sequence acceleration.

A cycle of several edges has no impact map that could be summed: two tanks filled in turn, a block
that rocks from edge to edge, a contact that ceases to damp slow impacts. All that is known is the
sequence of times and states at which the cycle closes. The limit of this sequence is found in four
steps, each of which may reject it.

1. *Raabe's test.* Let ``a_k`` be the durations of successive cycles. Then ``q_k = 1 / (a_{k-1}/a_k
  - 1)`` grows by ``1/p`` per cycle if ``a_k`` falls like ``k^-p``, and is constant for a geometric
  series. Only sequences that grow by less than ``1/p`` with ``p`` clearly above 1 have a sum; the
  harmonic series is rejected.
2. *Acceleration* (:mod:`hybrid.rules.acceleration`). Wynn's epsilon algorithm (exact for sums of
  geometric sequences) and Levin's transformation (for power laws) give estimates from increasing
  numbers of terms.
3. *The pace.* What is left to the limit, and what each turn changes, must have fallen in the last
  turns as in those just before: a table of estimates may not see that the last terms of a sequence
  follow another law, as behind a corner of the flow. Then the turns before that are left out.
4. *The cause.* Shrinking gaps alone prove nothing. At the limit, the guard of each jump must be
  zero at the state after the previous jump, and the resets of a turn must lead back to its start;
  :mod:`hybrid.run.limits` checks this against the model.

A cycle that shrinks by a factor of eight or more per turn reaches rounding after a few turns, too
few for the first two steps. Each duration is then a small fraction of the previous one, so Aitken's
formula, which is exact for one geometric sequence, is used from three turns on. Its change from one
turn to the next bounds an error that keeps decreasing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np

from ..rules import unit
from ..rules.acceleration import (
    CYCLE_ROUNDING,
    ESTIMATE_CAUTION,
    LEAST_COLUMNS,
    LEAST_CYCLES,
    POWER_CYCLES,
    WORK_ROWS,
)
from ..rules.lanes import FAST_FALL, FEW_TURNS, LONGEST_CYCLE

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Smallest exponent ``p`` of a power law ``k^-p`` of durations.
RAABE = 1.1

#: Growth of Raabe's quantity above which durations are taken to fall like a power.
RAABE_GROWTH = 0.05

#: The most of that growth in one turn, in mean ones: where it is more, another law has begun, and
#: too few turns are known of it.
STEADY_GROWTH = 4.0

#: Largest remaining time to the limit, relative to the time since the first cycle.
LEFT_TO_LIMIT = 1e-3

#: Largest final distance of a state to the limit, relative to its largest distance. (A sequence
#: that only alternates in sign has a limit by acceleration, but none in truth.)
NEARER = 0.5

#: By how many times more than before the ratio of successive times left may change with a turn.
PACE_CHANGE = 4.0

#: Of so many turns before: more are of how it began, which says nothing of a change now.
PACE_TURNS = 2

#: By how many times what times and states are off what a turn changes may be off: it is made of two
#: of them, and the errors of the turns before have come through to both.
PACE_NOISE = 8.0

#: The most that this may leave open of a limit, relative to its size, by a clock, for the limit to
#: be taken although it is not as exact as was asked: more turns would hardly make it more so.
#: Without a clock it is not known how much of an error is rounding.
LEFT_OPEN = 1e-10


class Clock(NamedTuple):
    """What the turns of a cycle count if their durations ``a_k`` fall like a power: Raabe's
    ``1 / (a_{k-1} / a_k - 1)``, at each turn but the first, and what it is off.

    A turn that makes ``w (1 - a w^p + ...)`` of ``w`` has a power of ``w`` as its duration, times a
    series in ``w^p``. So are the clock, whose first term is one of ``w^-p``, and all that is left
    to the limit: a series in the clock. Their number also has the logarithm of ``w`` in it, which
    no series in the number follows.
    """

    read: Numbers
    off: Numbers

    @classmethod
    def of(cls, times: Numbers, spans: Numbers | None, blur: Numbers | float = 0.0) -> Clock:
        """That of turns which close at some times, known but for ``blur`` and rounding; ``spans``:
        their durations, if they are known better than by the times."""
        ends = np.broadcast_to(blur, times.shape)
        if spans is None:
            spans, ends = np.diff(times), ends + np.spacing(times[-1] - times[0])
        with np.errstate(divide="ignore"):
            read = 1.0 / (np.append(np.nan, spans[:-1] / spans[1:]) - 1.0)
        off = CYCLE_ROUNDING + (ends[1:] + ends[:-1]) / spans
        off[1:] += off[:-1]
        return cls(read, off * np.abs(read * (1.0 + read)))


@attrs.frozen(eq=False)
class CycleLimit:
    """Where a cycle of jumps accumulates.

    Attributes
    ----------
    edges : tuple of str
        The edges of one turn.
    remaining : float
        Time from the last jump to the limit.
    x_inf : array
        The state at the limit.
    ratio : float
        Limit of the ratio of successive durations; 1 if they fall like a power.
    t_error : float
    x_error : array
        Bounds on the error of the acceleration (not of the integration before it).
    turns : int
        Number of closings of the cycle that were used.
    limits : tuple of (edge, array)
        If resets move the state: each jump of a turn with the limit of the state after it; the last
        limit is ``x_inf``. Otherwise empty.
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
    """Length of the shortest cycle that the last edges repeat; 0 if there is none.

    The last turn must repeat ``turns`` turns before it.
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
    blur: Callable[[], Numbers] = lambda: np.zeros(1),
    spans: Numbers | None = None,
    lost: tuple[float, float] = (0.0, 0.0),
) -> CycleLimit | None:
    """The limit of a cycle; None if it does not accumulate, or not yet clearly enough.

    Parameters
    ----------
    times : array, shape (cycles + 1,)
        Times at which the cycle closed.
    states : array, shape (cycles + 1, n)
        States after those jumps.
    rtol, atol : float
        Accuracy of the jumps, and required accuracy of the limit.
    beside : sequence of int
        Indices of discrete state elements: see :func:`accelerated`.
    blur : callable
        Gives how far each of the times may be off, beside its own rounding.
    spans : array, shape (cycles,), optional
        The durations of the turns, if they are known better than by the times.
    lost : tuple of float
        What the steps between jumps may lose, relative and absolute.
    """
    durations = np.diff(times)
    if not (np.all(durations > 0) and np.all(np.diff(durations) < 0)):
        return None
    elapsed = float(durations.sum())
    found: CycleLimit | int | None = 0
    while isinstance(found, int):
        times, states = times[found:], states[found:]
        spans = None if spans is None else spans[found:]
        found = _limit(edges, times, states, elapsed, rtol, atol, beside, blur, spans, lost)
    return found


def _limit(
    edges: tuple[str, ...],
    times: Numbers,
    states: Matrix,
    elapsed: float,
    rtol: float,
    atol: float,
    beside: Sequence[int],
    blur: Callable[[], Numbers],
    spans: Numbers | None,
    lost: tuple[float, float],
) -> CycleLimit | int | None:
    """As :func:`limit`, by one law; where another has begun at some turn, the place of that turn.
    ``elapsed``: the time since the first of all turns."""
    durations, first, growth, most = np.diff(times), 0, 0.0, 0.0
    turns = _fast(durations)
    if turns >= FEW_TURNS:
        first = len(durations) - turns
        times, states = times[first:], states[first:]
    elif len(durations) >= LEAST_CYCLES:
        growth, most = _raabe(durations)
    else:
        return None
    power = growth > RAABE_GROWTH
    if not growth < 1.0 / RAABE or (power and most > STEADY_GROWTH * growth):
        return None
    clock = Clock.of(times, spans) if power else None
    if power and spans is not None:  # times before the last jump, as exact as durations are
        times = -np.append(np.cumsum(spans[::-1])[::-1], 0.0)
    columns, others = np.column_stack([times, states]), [1 + i for i in beside]
    for closely in False, True:
        now, error, scale, rounding = accelerated(columns, clock, others, closely)
        sizes = np.maximum(scale, scale[0])
        slack = max(rtol, 1e-13) * sizes + atol
        slack += np.minimum(2.0 * rounding, LEFT_OPEN * sizes)
        if not np.all(np.delete(error <= slack, others)):
            return None
    remaining = float(now[0] - times[-1])
    near = remaining <= LEFT_TO_LIMIT * elapsed or (power and len(times) >= POWER_CYCLES)
    if not (remaining > 0 and near and np.all(np.isfinite(now))):
        return None
    off, steps = np.abs(columns - now), np.abs(np.diff(columns, axis=0))
    blurred = blur()
    if power:
        clock = Clock.of(times, spans, blurred[-len(times) :])
        error = np.maximum(error, accelerated(columns, clock, others)[1])
    noise = _moving(columns, blurred)
    known = CYCLE_ROUNDING * len(columns) * scale + PACE_NOISE * noise
    for k in np.setdiff1d(np.arange(len(now)), others):
        # a speed that is zero at these jumps has left there what rounding leaves
        hides = float(max(lost[0], CYCLE_ROUNDING) * sizes[k] + lost[1]) / ESTIMATE_CAUTION
        pace = [
            _strays(off[:, k], error[k] + known[:, k], hides),
            _strays(steps[:, k], known[1:, k], hides),
        ]
        strays, odd = map(max, zip(*pace, strict=True))
        if strays:
            return first + int(strays)
        error[k] += ESTIMATE_CAUTION * odd
    if np.any((off[-1] > NEARER * off.max(axis=0) + error)[1:]):
        return None
    # a turn that is too short by its noise, at both ends, makes all that is left so, in proportion
    late = np.sum(noise[1:, 0] * (1.0 + 2.0 * off[1:, 0] / steps[:, 0]))
    error += late * steps[-1] / steps[-1, 0]
    ratio = 1.0 if power else float(durations[-1] / durations[-2])
    return CycleLimit(edges, remaining, now[1:], ratio, float(error[0]), error[1:], len(times))


def _moving(columns: Matrix, blur: Numbers) -> Matrix:
    """How far times, and states that move as they do, are off where times are off by ``blur``."""
    steps = np.abs(np.diff(columns, axis=0))
    rates = steps / steps[:, :1]
    return blur[-len(columns) :, None] * np.vstack([rates[:1], rates])  # type: ignore[no-any-return]


def accelerated(
    columns: Matrix, clock: Clock | None, beside: Sequence[int] = (), closely: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Limits of sequences (one per column), bounds on their errors, their sizes, and what of the
    errors is rounding by the clock.

    ``clock``: that of the turns, if their durations fall like a power. Columns in ``beside`` hold
    discrete variables on which nothing else depends. They keep their last value, with infinite
    error if they still change. ``closely``: whether what estimates agree on is tried on other
    sequences, too.
    """
    rows, room = np.ascontiguousarray(columns.T), max(LEAST_COLUMNS, len(columns) + 1)
    known = np.empty((2, 0)) if clock is None else np.array(clock)
    found, work = np.empty((len(rows), 3)), np.empty((WORK_ROWS, room))
    unit("acceleration").accelerated(rows, known, closely, work, found)
    now, error, noise = found.T
    scale, rounding = np.abs(now) + np.ptp(columns, axis=0), CYCLE_ROUNDING * len(columns)
    error += rounding * scale
    for k in beside:
        now[k], error[k] = columns[-1, k], np.inf if np.ptp(columns[-FEW_TURNS:, k]) else 0.0
    return now, error, scale, noise


def _strays(left: Numbers, known: Numbers, hides: float) -> tuple[int, float]:
    """The place from which on numbers fall in another way than before, in the last turns; 0 if
    there is none: their ratios change ever less, or as in the turns just before. Where another law
    has begun, estimates may still be those of the old.

    ``known``: how well the numbers are known; less than that tells nothing. ``hides``: what steps
    may lose of them: their ratios may change so much by that alone. Returns the most of it, too.
    """
    left = left[: int(np.argmax(np.append(left <= known, True)))]
    known = known[: len(left)]
    changes, off = np.abs(np.diff(left[1:] / left[:-1])), known[2:] / left[1:-1]
    if len(changes) < FEW_TURNS:
        return 0, 0.0
    late = max(1, len(changes) // 2, len(changes) - LEAST_CYCLES)
    before = [changes[max(0, k - PACE_TURNS) : k].max() for k in range(late, len(changes))]
    odd = np.flatnonzero(changes[late:] > PACE_CHANGE * np.array(before) + off[late:])
    lost = (changes * left[1:-1])[late + odd]
    strays = odd[lost > hides]
    place = late + int(strays[-1]) + 3 if len(strays) else 0
    return place, float(np.max(lost[lost <= hides], initial=0.0))


def _fast(durations: Numbers) -> int:
    """Length of the last run of durations, each of which is a small fraction of the one before."""
    slow = np.flatnonzero(durations[1:] > FAST_FALL * durations[:-1])
    return len(durations) - (int(slow[-1]) + 1 if len(slow) else 0)


def _raabe(durations: Numbers) -> tuple[float, float]:
    """Growth per cycle of ``1 / (a_{k-1}/a_k - 1)``, over the last half of the cycles: its mean,
    and the most."""
    own = 1.0 / (durations[:-1] / durations[1:] - 1.0)
    grown = np.diff(own[len(own) // 2 :])
    return float(grown.mean()), float(grown.max())
