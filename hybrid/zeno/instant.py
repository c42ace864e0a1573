"""Infinitely many impacts at one instant, in a group of touching bodies with large losses.

No time passes and the positions stay constant. Each impact changes the gap speeds ``u`` of the
touching contacts, and the next impact is at the first declared contact with negative ``u``. With
constant restitution this map is homogeneous of degree one. If the speeds return to a multiple of
themselves with a factor below 1, they do so forever. Their limit is then found directly: impulses
at the contacts struck in a turn bring the gap speeds of these contacts to zero.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

#: Most impacts made to detect a recurrence; they take a tenth of a second.
MOST_IMPACTS = 1 << 16

#: Tolerance with which the direction of the speeds must recur, and the factor by which they must
#: shrink. The map of a turn is a product of a few hundred factors at most, and components in other
#: directions decay from turn to turn.
SPEEDS_ALIKE, SPEEDS_FALL = 1e-10, 1.0 - 1e-6


@attrs.frozen(eq=False)
class Shrinking:
    """Impacts that recur forever: indices of the contacts struck in a turn, and the ratio of the
    gap speeds of successive turns."""

    struck: tuple[int, ...]
    ratio: float


def shrinking(gain: np.ndarray, laws: Sequence[float], speeds: Sequence[float]) -> Shrinking | None:
    """Find the recurring impacts at one instant; None if they end, or no recurrence is found.

    Parameters
    ----------
    gain : array, shape (n, n)
        ``gain[i, j]``: change of gap speed ``i`` by an impulse that changes gap speed ``j`` by 1.
    laws : sequence of float
        Restitution coefficients.
    speeds : sequence of float
        Gap speeds before the first of these impacts.
    """
    count, u = len(speeds), list(speeds)
    felt = [
        [(i, float(gain[i, j]) * (1.0 + laws[j])) for i in range(count) if gain[i, j]]
        for j in range(count)
    ]
    seen: list[int] = []  # contacts struck since the mark, whose speeds are known
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
        if len(seen) == turn:  # Brent's cycle detection: the next mark holds twice as long
            seen, known, turn = [], list(u), 2 * turn
        seen.append(j)
        change = u[j]
        for i, share in felt[j]:
            u[i] -= share * change
    return None


def impulses(gain: np.ndarray, struck: Sequence[int], speeds: Sequence[float]) -> np.ndarray:
    """The impulse at each struck contact, as its change of gap speed, that together bring the gap
    speeds of these contacts to zero."""
    among = gain[np.ix_(struck, struck)]
    wanted = -np.array(speeds)[list(struck)]
    return np.asarray(np.linalg.lstsq(among, wanted, rcond=None)[0])


def _ratio(before: list[float], now: list[float]) -> float:
    """The ratio of two speed vectors of the same direction; infinity if directions differ."""
    first, last = max(map(abs, before)), max(map(abs, now))
    same = all(abs(a / first - b / last) <= SPEEDS_ALIKE for a, b in zip(before, now, strict=True))
    return last / first if same else float("inf")


def _stays(gain: np.ndarray, struck: list[int], speeds: list[float]) -> bool:
    """Whether, at the limit, no other contact declared before the last struck one is struck."""
    left = np.array(speeds) + gain[:, struck] @ impulses(gain, struck, speeds)
    others = [i for i in range(struck[-1]) if i not in struck]
    return all(left[i] >= 0.0 for i in others)


def _period(seen: list[int]) -> int:
    """The shortest period of a sequence."""
    return next(
        p
        for p in range(1, len(seen) + 1)
        if len(seen) % p == 0 and seen[p:] == seen[: len(seen) - p]
    )
