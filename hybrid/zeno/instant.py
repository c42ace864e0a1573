"""Infinitely many impacts at one instant: a row of touching bodies that lose much at each.

No time passes and nothing moves; each impact changes the gap speeds ``u`` of the contacts that
touch, and of these the first declared whose ``u`` is negative is the next. With constant
restitution that is a map which is the same at any scale: where the speeds come round to what they
were, times a factor below 1, they do so for ever. Their limit is then known without the sequence:
impulses at the contacts struck in a turn have taken their speeds to zero.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

#: Most impacts that are made to see whether they come round: a tenth of a second of them.
MOST_IMPACTS = 1 << 16

#: How nearly speeds come round, and by how much they must shrink: the turn's map is made of a few
#: hundred products at most, and what is left of other directions falls from turn to turn.
SPEEDS_ALIKE, SPEEDS_FALL = 1e-10, 1.0 - 1e-6


@attrs.frozen(eq=False)
class Shrinking:
    """Impacts that come round for ever: contacts struck in a turn, and how much slower it is than
    the one before."""

    struck: tuple[int, ...]
    ratio: float


def shrinking(gain: np.ndarray, laws: Sequence[float], speeds: Sequence[float]) -> Shrinking | None:
    """Whether impacts at one instant never end; None where they end, or are not seen to come round.

    Parameters
    ----------
    gain : array, shape (n, n)
        ``gain[i, j]``: change of gap speed ``i`` by an impulse that changes gap speed ``j`` by 1.
    laws : sequence of float
        Restitutions.
    speeds : sequence of float
        Gap speeds.
    """
    count, u = len(speeds), list(speeds)
    felt = [
        [(i, float(gain[i, j]) * (1.0 + laws[j])) for i in range(count) if gain[i, j]]
        for j in range(count)
    ]
    seen: list[int] = []  # contacts struck since the speeds ``known`` of the last mark
    known, turn = list(u), 1
    for _ in range(MOST_IMPACTS):
        j = next((i for i in range(count) if u[i] < 0.0), None)
        if j is None:
            return None
        if seen and j == seen[0]:
            struck = sorted(set(seen))
            ratio = _ratio([known[i] for i in struck], [u[i] for i in struck])
            if ratio < SPEEDS_FALL and _stays(gain, struck, u):
                period = _period(seen)
                return Shrinking(tuple(struck), ratio ** (period / len(seen)))
        if len(seen) == turn:  # Brent's: the next mark holds twice as long
            seen, known, turn = [], list(u), 2 * turn
        seen.append(j)
        change = u[j]
        for i, share in felt[j]:
            u[i] -= share * change
    return None


def impulses(gain: np.ndarray, struck: Sequence[int], speeds: Sequence[float]) -> np.ndarray:
    """The changes of speed, one for each contact struck, that together leave these at rest."""
    among = gain[np.ix_(struck, struck)]
    wanted = -np.array(speeds)[list(struck)]
    return np.asarray(np.linalg.lstsq(among, wanted, rcond=None)[0])


def _ratio(before: list[float], now: list[float]) -> float:
    """By what speeds have shrunk that keep their direction; infinity where they do not."""
    first, last = max(map(abs, before)), max(map(abs, now))
    same = all(abs(a / first - b / last) <= SPEEDS_ALIKE for a, b in zip(before, now, strict=True))
    return last / first if same else float("inf")


def _stays(gain: np.ndarray, struck: list[int], speeds: list[float]) -> bool:
    """Whether no contact that comes before one of those struck is about to be struck as well."""
    left = np.array(speeds) + gain[:, struck] @ impulses(gain, struck, speeds)
    others = [i for i in range(struck[-1]) if i not in struck]
    return all(left[i] >= 0.0 for i in others)


def _period(seen: list[int]) -> int:
    """The shortest turn of which a sequence is made."""
    return next(
        p
        for p in range(1, len(seen) + 1)
        if len(seen) % p == 0 and seen[p:] == seen[: len(seen) - p]
    )
