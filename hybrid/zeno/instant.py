"""Infinitely many impacts at one instant, in a group of touching bodies with large losses.

Each impact changes the gap speeds ``u`` of the contacts, in proportion to the speed of the one that
is struck. Between two impacts gaps change by ``u`` times the time, which is less than can be told
from zero: forces do nothing. The next impact is at the contact whose gap closes first, and of those
that are closed at the first declared one. With constant restitution this map is the same at every
scale. If nothing moves and the speeds return to a multiple of themselves, with a factor below 1,
they do so forever. Otherwise, impacts are followed until their speeds have decayed to nothing.

Either way the limit does not depend on the sequence: impulses at the contacts that are struck over
and over bring their speeds to zero, and there is one such state.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from ..rules.zeros import EPS

#: Most impacts made to detect a recurrence; they take some tenths of a second.
MOST_IMPACTS = 1 << 14

#: How closely speeds must recur, and the factor by which they must shrink. The map of a turn is a
#: product of a few hundred factors at most, and components in other directions decay from turn to
#: turn.
SPEEDS_ALIKE, SPEEDS_FALL = 1e-10, 1.0 - 1e-6

#: Speeds are the same within this share of the largest, and those of the contacts struck, which may
#: be tiny, of their own: the rounding of the impacts of a turn.
SPEEDS_SAME = 64.0 * EPS

#: Speeds have decayed to nothing at this share of the first: so late that a slow approach to a
#: recurrence is found before, and still far from where numbers end.
DECAYED = 1e-150


@attrs.frozen(eq=False)
class Shrinking:
    """Impacts at one instant that never end.

    Attributes
    ----------
    struck : list of int
        The contacts that are struck over and over, and stay closed.
    ratio : float
        The ratio of speeds per turn; per impact where no turn recurs.
    changes : array, shape (n,)
        By how much the own impacts of each contact change its gap speed.
    """

    struck: list[int]
    ratio: float
    changes: np.ndarray


class Motion(NamedTuple):
    """Gaps, gap speeds, and the time elapsed."""

    gaps: list[float]
    speeds: list[float]
    elapsed: float


class Cascade:
    """Impacts of touching bodies, one after another, in the order in which their gaps close.

    Parameters
    ----------
    gain : array, shape (n, n)
        ``gain[i, j]``: change of gap speed ``i`` by an impulse that changes gap speed ``j`` by 1.
    laws : sequence of float
        Restitution coefficients.
    gaps, speeds : sequence of float
        Gaps (0 where they are rounding) and gap speeds.

    Attributes
    ----------
    changes : array, shape (n,)
        By how much the own impacts of each contact have changed its gap speed so far.
    """

    def __init__(
        self,
        gain: np.ndarray,
        laws: Sequence[float],
        gaps: Sequence[float],
        speeds: Sequence[float],
    ) -> None:
        self.gaps, self.speeds, self.elapsed = list(gaps), list(speeds), 0.0
        self.least, self.changes = DECAYED * max(map(abs, speeds)), np.zeros(len(laws))
        self._laws, self._gain, self._at_rest = laws, gain, set[int]()
        self._inverses: dict[tuple[int, ...], np.ndarray] = {}
        self._felt = [[(i, g) for i, g in enumerate(own) if g] for own in gain.T.tolist()]

    def next(self) -> tuple[int, float] | None:
        """The contact that is struck next, and how long that takes; None if there is none with a
        speed that has not decayed."""
        found: tuple[int, float] | None = None
        for i, (gap, speed) in enumerate(zip(self.gaps, self.speeds, strict=True)):
            if speed < -self.least and (found is None or gap < -speed * found[1]):
                found = i, gap / -speed
        return found

    def now(self) -> Motion:
        """How things are."""
        return Motion(list(self.gaps), list(self.speeds), self.elapsed)

    def go_on(self, wait: float) -> None:
        """Let time pass without an impact."""
        if wait > 0.0:
            self.gaps = [gap + wait * u for gap, u in zip(self.gaps, self.speeds, strict=True)]
            self.elapsed += wait

    def strike(self, j: int, wait: float) -> None:
        """Go on to an impact, and past it. A speed after it that has decayed counts as zero: the
        contact stays closed."""
        self.go_on(wait)
        after = -self._laws[j] * self.speeds[j]
        change = (after if after > self.least else 0.0) - self.speeds[j]
        for i, share in self._felt[j]:
            self.speeds[i] += share * change
        if after > self.least:
            self._at_rest.discard(j)
        else:
            self._at_rest.add(j)
            self.speeds[j] = 0.0
        self.gaps[j] = 0.0
        self.changes[j] += change

    def rest(self, struck: list[int]) -> None:
        """Bring contacts to rest, by impulses of their own."""
        changes, u = self._impulses(struck)
        self.changes[struck] += changes
        u[struck] = 0.0
        self.speeds = u.tolist()
        self._at_rest.update(struck)
        for i in struck:
            self.gaps[i] = 0.0

    def stay(self, struck: list[int], wait: float) -> bool:
        """Whether no other contact is struck before some come to rest, which takes a time. Of those
        closed at once the first declared is struck."""
        _, u = self._impulses(struck)
        left = np.array(self.gaps) + np.minimum(u, self.speeds) * wait
        others = [i for i in range(len(u)) if i not in struck]
        return all(left[i] > 0.0 or u[i] >= 0.0 or i > struck[-1] for i in others)

    def stands(self, group: Sequence[int]) -> bool:
        """Whether contacts are closed and have no speed."""
        return not any(self.gaps[i] or self.speeds[i] for i in group)

    def closed(self) -> list[int]:
        """The contacts that have come to rest by infinitely many impacts, and stay so, with those
        that lose all of their speed at once; none if there are only such."""
        small = len(self._at_rest) * self.least
        stay = [i for i in self._at_rest if not self.gaps[i] and abs(self.speeds[i]) <= small]
        return sorted(stay) if any(self._laws[i] > 0.0 for i in stay) else []

    def _impulses(self, struck: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """The changes of speed, one per struck contact, that together bring these contacts to
        rest; and all speeds after these."""
        speeds, group = np.array(self.speeds), tuple(struck)
        if group not in self._inverses:
            self._inverses[group] = np.linalg.pinv(self._gain[np.ix_(struck, struck)])
        changes = -self._inverses[group] @ speeds[struck]
        return changes, speeds + self._gain[:, struck] @ changes


def shrinking(impacts: Cascade, instant: float) -> Shrinking | None:
    """The impacts at one instant that never end; None if they do, or it cannot be told.

    Contacts whose impacts recur forever are brought to rest. Another that is struck next may set
    off more, which may recur as well; if it opens those again, these are the first to rest alone.

    Parameters
    ----------
    impacts : Cascade
    instant : float
        The time within which they must happen.
    """
    turns, groups, first, ratio = Recurrence(impacts), Groups(), None, 0.0
    for count in range(MOST_IMPACTS):
        found = impacts.next()
        if found is None or impacts.elapsed + found[1] > instant:
            closed = impacts.closed()
            if not closed or (first is not None and not set(first.struck) <= set(closed)):
                break
            impacts.rest(closed)
            return Shrinking(closed, ratio or DECAYED ** (1.0 / count), impacts.changes)
        recurring = turns.recurring(found[0])
        if turns.stands:
            break
        if recurring is not None:
            struck, ratio, rest = recurring
            impacts.go_on(rest)
            impacts.rest(struck)
            first = first or Shrinking(struck, ratio, impacts.changes.copy())
            groups.add(struck)
            turns = Recurrence(impacts)
            continue
        turns.add(found[0], groups.strike(impacts, *found))
    return first


class Recurrence:
    """Finds impacts that recur, by Brent's method: each mark holds twice as long as the last.

    ``stands``: they do so in no time, and all speeds are what they were, but for rounding.
    """

    def __init__(self, impacts: Cascade) -> None:
        self._impacts, self._turn, self.stands = impacts, 1, False
        self._set_mark()

    def _set_mark(self) -> None:
        self._seen: list[int] = []  # the contacts struck since
        self._mark = self._impacts.now()

    def add(self, struck: int, others: Sequence[int]) -> None:
        """Note an impact, and those that come of it."""
        self._seen += [struck, *others]
        if len(self._seen) > self._turn:
            self._turn *= 2
            self._set_mark()

    def recurring(self, following: int) -> tuple[list[int], float, float] | None:
        """The contacts whose impacts recur, with falling speed; the ratio of speeds per turn; and
        how long they take. None if they do not.

        Parameters
        ----------
        following : int
            The contact that is struck next.
        """
        if not self._seen or following != self._seen[0]:
            return None
        struck = sorted(set(self._seen))
        now = self._impacts.now()
        fall, rest = _recurs(self._mark, now, struck)
        self.stands = abs(fall - 1.0) <= SPEEDS_SAME and _same(self._mark, now)
        if not (fall < SPEEDS_FALL and self._impacts.stay(struck, rest)):
            return None
        return struck, fall ** (_period(self._seen) / len(self._seen)), rest


class Groups:
    """Groups of contacts that have come to rest together by impacts without end.

    Whether one does so once more after an impact beside it depends on that contact only: at rest
    it has no speeds of its own, and impacts are the same at every scale.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], set[int]] = {}
        self._tried: tuple[tuple[int, ...], int] | None = None

    def add(self, struck: list[int]) -> None:
        """Note a group that has come to rest."""
        known = self._known.setdefault(tuple(struck), set())
        if self._tried is not None and self._tried[0] == tuple(struck):
            known.add(self._tried[1])
        self._tried = None

    def strike(self, impacts: Cascade, j: int, wait: float) -> tuple[int, ...]:
        """Make an impact; beside a group of which it is known that it comes to rest again, those of
        that group, too. Returns the group."""
        if self._tried is not None and j not in self._tried[0]:
            self._tried = None
        beside = [group for group in self._known if j not in group and impacts.stands(group)]
        group = max(beside, key=len, default=())
        impacts.strike(j, wait)
        if not group:
            return ()
        if j in self._known[group] and impacts.stay(list(group), 0.0):
            impacts.rest(list(group))
            return group
        self._tried = group, j
        return ()


def _same(before: Motion, now: Motion) -> bool:
    """Whether no time has passed, and no speed is another, but for rounding. (Speeds that fall by
    ever so little do so over twice as many impacts as clearly.)"""
    least = SPEEDS_SAME * max(map(abs, before.speeds))
    pairs = zip(before.speeds, now.speeds, strict=True)
    return now.elapsed == before.elapsed and all(abs(a - b) <= least for a, b in pairs)


def _recurs(before: Motion, now: Motion, struck: list[int]) -> tuple[float, float]:
    """The ratio of the speeds of some contacts after a turn, infinity if these and their gaps do
    not recur; and how long all turns that follow take."""
    fall = _ratio([before.speeds[i] for i in struck], [now.speeds[i] for i in struck])
    lower = _ratio([before.gaps[i] for i in struck], [now.gaps[i] for i in struck])
    length = now.elapsed - before.elapsed
    if length == 0.0:
        return fall, 0.0
    return (fall, length * lower / (fall - lower)) if lower < fall else (np.inf, 0.0)


def _ratio(before: list[float], now: list[float]) -> float:
    """The ratio of two vectors of the same direction, 0 for zeros; infinity if directions
    differ."""
    first, last = max(map(abs, before)), max(map(abs, now))
    if not (first and last):
        return np.inf if last else 0.0
    same = all(abs(a / first - b / last) <= SPEEDS_ALIKE for a, b in zip(before, now, strict=True))
    return last / first if same else np.inf


def _period(seen: list[int]) -> int:
    """The shortest period of a sequence."""
    return next(
        p
        for p in range(1, len(seen) + 1)
        if len(seen) % p == 0 and seen[p:] == seen[: len(seen) - p]
    )
