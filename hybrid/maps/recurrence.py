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
FEWEST_RETURNS = 4

#: The part of the kept points that must lie beside earlier ones, and the share of them that does.
#: On a periodic orbit all do; on a chaotic attractor, of which a finite number of points is known,
#: most; on the way to one, none.
LAST_PART, HITS = 0.25, 0.5

#: The number of lanes that are on no attractor.
NOWHERE = -1


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
    size, range : array, shape (lanes, n)
        How large the states were; what they spanned in the second half of the time.
    """

    points: np.ndarray
    modes: np.ndarray
    ends: np.ndarray
    end_modes: np.ndarray
    rests: np.ndarray
    comes: np.ndarray
    size: np.ndarray
    range: np.ndarray

    def own(self, lane: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The points that a lane has, and their modes; what its states span, how large they are."""
        there = np.isfinite(self.points[lane]).all(axis=1)
        sizes = self.range[lane], self.size[lane]
        return self.points[lane][there], self.modes[lane][there], *sizes


@attrs.frozen(eq=False)
class Nearness:
    """What is one place: within a share of what is spanned, or, of how large the states were along
    the way, within a share that integration may have lost."""

    share: float
    rounding: float

    def widths(self, span: np.ndarray, size: np.ndarray) -> np.ndarray:
        """By coordinate how far points of one place lie apart at most."""
        found: np.ndarray = np.maximum(self.share * span, self.rounding * size)
        return np.where(found > 0, found, 1.0)

    def recurs(self, points: Matrix, modes: np.ndarray, span: np.ndarray, size: np.ndarray) -> bool:
        """Whether the last of some points in a row lie beside those of the first half."""
        if len(points) < FEWEST_RETURNS:
            return False
        half, width = len(points) // 2, self.widths(span, size)
        return bool(Cloud.of(points[:half], modes[:half], width).hit(points, modes))


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
        found: np.ndarray = self.beside(points, modes).sum(axis=-1) >= HITS * np.maximum(known, 1)
        return found


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
    labels = np.full(len(tails.ends), NOWHERE)
    own = [lane for lane in _where(tails.comes) if nearness.recurs(*tails.own(lane))]
    known = np.concatenate([tails.ends[tails.rests], *(tails.own(lane)[0] for lane in own)])
    if not len(known):
        return labels, []
    settled = tails.rests.copy()
    settled[own] = True
    width = nearness.widths(np.ptp(known, axis=0), tails.size[settled].max(axis=0))
    firsts = _at_rest(tails, width, labels)
    clouds = []
    for number in range(len(firsts)):
        here = labels == number
        clouds.append(Cloud.of(tails.ends[here], tails.end_modes[here], width))
        _join(tails, labels, clouds[-1], number)
    for lane in own:
        if labels[lane] != NOWHERE:
            continue
        points, modes = locate(lane)
        there = [number for number, cloud in enumerate(clouds) if cloud.hit(points, modes)]
        if there:
            labels[lane] = there[0]
        elif nearness.recurs(points, modes, *tails.own(lane)[2:]):
            labels[lane] = len(firsts)
            firsts.append(lane)
            clouds.append(Cloud.of(points, modes, width))
            _join(tails, labels, clouds[-1], labels[lane])
    return labels, firsts


def _join(tails: Tails, labels: np.ndarray, cloud: Cloud, number: int) -> None:
    """Number the lanes whose last points lie beside those of an attractor."""
    left = np.flatnonzero(tails.comes & (labels == NOWHERE))
    labels[left[cloud.hit(tails.points[left], tails.modes[left])]] = number


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
