"""Attractors from recurrences: which lanes come back to where they, or others, have been.

A lane whose last points on a section lie beside points that it met before has found an attractor.
Others have found the same where their last points lie beside points of that one. Source: Datseris
and Wagemakers, *Effortless estimation of basins of attraction*, Chaos 32, 023104 (2022). They count
returns to the cells of a grid, whose marks all starts share; here points are compared by their
distances, so that no border of a cell parts what belongs together, and a lane depends on no other:
lanes may be flown anywhere, in any order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import attrs
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix

#: Points of which the last ones are compared with earlier ones: so many at least.
FEWEST_POINTS = 4

#: The part of the kept points that must lie beside earlier ones, and the share of them that does.
#: On a periodic orbit all do; on a chaotic attractor, of which a finite number of points is known,
#: most; on the way to one, none.
LAST_PART, HITS = 0.25, 0.5

#: The number of lanes that are on no attractor.
NONE = -1


@attrs.frozen(eq=False)
class Tails:
    """The ends of lanes.

    Attributes
    ----------
    points : array, shape (lanes, keep, n)
        Last points on the section, the newest at the end; NaN before them where there are fewer.
    modes : array, shape (lanes, keep)
        The number of the mode behind each.
    ends, end_modes : array, shapes (lanes, n) and (lanes,)
        Where lanes end.
    rests : array of bool, shape (lanes,)
        Lanes that are at rest there.
    comes : array of bool, shape (lanes,)
        Others, of which the points are looked at.
    size : array, shape (lanes, n)
        How large the states were.
    """

    points: np.ndarray
    modes: np.ndarray
    ends: np.ndarray
    end_modes: np.ndarray
    rests: np.ndarray
    comes: np.ndarray
    size: np.ndarray

    def known(self, lane: int) -> tuple[np.ndarray, np.ndarray]:
        """The points that a lane has, and their modes."""
        there = np.isfinite(self.points[lane]).all(axis=1)
        return self.points[lane][there], self.modes[lane][there]


@attrs.frozen(eq=False)
class Nearness:
    """What is one place: within a share of what points span, or, of how large the states were
    along the way, within a share that integration may have lost."""

    share: float
    rounding: float

    def widths(self, points: Matrix, size: Matrix) -> np.ndarray:
        """By coordinate how far points of one place lie apart at most."""
        span = np.ptp(points, axis=0)
        found: np.ndarray = np.maximum(self.share * span, self.rounding * size.max(axis=0))
        return np.where(found > 0, found, 1.0)

    def recurs(self, tails: Tails, lane: int) -> bool:
        """Whether the last points of a lane lie beside those of its first half."""
        points, modes = tails.known(lane)
        if len(points) < FEWEST_POINTS:
            return False
        width, half = self.widths(points, tails.size[lane : lane + 1]), len(points) // 2
        last = slice(-max(1, int(LAST_PART * len(points))), None)
        beside = Cloud.of(points[:half], modes[:half], width).beside(points[last], modes[last])
        return bool(beside.mean() >= HITS)


@attrs.frozen(eq=False)
class Cloud:
    """Points, each in its mode."""

    tree: cKDTree
    width: np.ndarray

    @classmethod
    def of(cls, points: Matrix, modes: np.ndarray, width: np.ndarray) -> Cloud:
        """Points with the widths by coordinate within which two are one place."""
        return cls(cKDTree(_placed(points, modes, width)), width)

    def beside(self, points: np.ndarray, modes: np.ndarray) -> np.ndarray:
        """Which points lie beside one of these, in its mode; none that is NaN does."""
        known = np.isfinite(points).all(axis=-1)
        found = np.zeros(known.shape, dtype=bool)
        asked = _placed(points[known], modes[known], self.width)
        far, _ = self.tree.query(asked, p=np.inf, distance_upper_bound=1.0)
        found[known] = np.isfinite(far)
        return found

    def hit(self, points: np.ndarray, modes: np.ndarray) -> np.ndarray:
        """Which lanes have most of their last points beside these; the last axes are points, and
        coordinates."""
        last = max(1, int(LAST_PART * points.shape[-2]))
        points, modes = points[..., -last:, :], modes[..., -last:]
        known = np.isfinite(points).all(axis=-1).sum(axis=-1)
        return self.beside(points, modes).sum(axis=-1) >= HITS * np.maximum(known, 1)


def _placed(points: Matrix, modes: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Points in widths; those of other modes lie apart."""
    return np.column_stack([points / width, 2.0 * modes])


def grouped(
    tails: Tails, nearness: Nearness, locate: Callable[[int], tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, list[int]]:
    """The number of the attractor of each lane, and a lane for each attractor.

    ``locate(lane)`` gives points, and their modes, that a lane meets when it goes on for as long
    as it was flown.
    """
    labels = np.full(len(tails.ends), NONE)
    own = np.array([bool(c) and nearness.recurs(tails, i) for i, c in enumerate(tails.comes)], bool)
    if not (own.any() or tails.rests.any()):
        return labels, []
    spanned = np.concatenate([tails.ends[tails.rests], *(tails.known(i)[0] for i in _where(own))])
    width = nearness.widths(spanned, tails.size[own | tails.rests])
    firsts = _at_rest(tails, width, labels)
    clouds: dict[int, Cloud] = {}
    for lane in _where(own):
        if labels[lane] == NONE:
            points, modes = locate(lane)
            there = [n for n, c in clouds.items() if c.hit(points, modes)]
            number = there[0] if there else len(firsts)
            if not there:
                clouds[number] = Cloud.of(points, modes, width)
                firsts.append(lane)
                left = tails.comes & (labels == NONE)
                labels[left] = np.where(
                    clouds[number].hit(tails.points[left], tails.modes[left]), number, NONE
                )
            labels[lane] = number
    return labels, firsts


def _at_rest(tails: Tails, width: np.ndarray, labels: np.ndarray) -> list[int]:
    """Number places of rest: those that lie beside each other, in a chain, are one."""
    lanes = np.flatnonzero(tails.rests)
    if not lanes.size:
        return []
    placed = _placed(tails.ends[lanes], tails.end_modes[lanes], width)
    _, some, bins = np.unique(
        np.floor(2.0 * placed), axis=0, return_index=True, return_inverse=True
    )
    pairs = cKDTree(placed[some]).query_pairs(1.0, p=np.inf, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(some), len(some)))
    _, parts = connected_components(links, directed=False)
    _, firsts, numbers = np.unique(parts[bins], return_index=True, return_inverse=True)
    labels[lanes] = numbers
    return [int(lane) for lane in lanes[firsts]]


def _where(mask: np.ndarray) -> list[int]:
    return [int(i) for i in np.flatnonzero(mask)]


__all__ = ["NONE", "Nearness", "Tails", "grouped"]
