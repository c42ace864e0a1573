"""The dimension of what parts regions of a map: how often neighbours differ, over how far apart."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import OptionError

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Neighbours are looked at up to this part of an axis: farther apart they say nothing of a border.
FARTHEST = 1 / 8

#: Parts of the first axis that are left out in turn, to see how much the result depends on them.
JACKKNIFE_PARTS = 8

#: Distances that a slope is taken from, at least.
FEWEST_DISTANCES = 3


class Dimension(NamedTuple):
    """A dimension with its standard error; and the exponent of uncertainty, what it lacks to that
    of the map."""

    value: float
    error: float
    uncertainty: float


def dimension(labels: np.ndarray, what: str) -> Dimension:
    """The dimension of the boundary between regions of a grid.

    Parameters
    ----------
    labels : array of int
        The region of each point, below 0 where it is not known; evenly spaced along each axis.
    what : str
        What the map is of, for errors.

    Raises
    ------
    OptionError
        If the grid is too small, or all points that are known are of one region.

    Notes
    -----
    Where the share of points that have another region a distance ``e`` away grows like ``e^a``, the
    dimension is that of the grid less ``a``. Points nearer to the ends of an axis than the longest
    distance are neighbours only. The slope is one by least squares over
    distances of 1, 2, 4, ... points. Its error has two parts: the spread when an eighth of the
    first axis is left out in turn (jackknife), and half of what the slopes of the shorter and the
    longer distances differ by. Source: McDonald, Grebogi, Ott and Yorke, *Fractal basin
    boundaries*, Physica D 17, 125 (1985).
    """
    steps = [1 << k for k in range(int(np.log2(max(1.0, FARTHEST * min(labels.shape)))) + 1)]
    if len(steps) < FEWEST_DISTANCES:
        least = int(2 ** (FEWEST_DISTANCES - 1) / FARTHEST)
        raise OptionError(f"{what}: {labels.shape} points are too few: {least} along each axis")
    counts = np.array(
        [_counts(labels, step, steps[-1]) for step in steps]
    )  # (steps, parts, [differ, all])
    if not np.all(counts[..., 0].sum(axis=1) > 0):
        raise OptionError(f"{what}: no boundary: neighbours do not differ")
    slope = _slope(steps, counts)
    without = [_slope(steps, np.delete(counts, part, axis=1)) for part in range(counts.shape[1])]
    jackknife = np.sqrt(
        (JACKKNIFE_PARTS - 1) * np.mean((np.array(without) - np.mean(without)) ** 2)
    )
    middle = len(steps) // 2
    short, long = slice(middle + 1), slice(middle, None)
    bend = _slope(steps[short], counts[short]) - _slope(steps[long], counts[long])
    error = float(np.hypot(jackknife, 0.5 * bend))
    return Dimension(labels.ndim - slope, error, slope)


def _counts(labels: np.ndarray, step: int, margin: int) -> np.ndarray:
    """In each part of the first axis, how many points, of those a margin away from the ends, have
    another region a step away along an axis, and how many have neighbours there that are known."""
    inner = labels[tuple(slice(margin, -margin) for _ in labels.shape)]
    differ, known = np.zeros(inner.shape, dtype=bool), inner >= 0
    for axis, sign in product(range(labels.ndim), (step, -step)):
        moved = np.roll(labels, sign, axis=axis)
        beside = moved[tuple(slice(margin, -margin) for _ in labels.shape)]
        differ |= beside != inner
        known &= beside >= 0
    parts = zip(
        np.array_split(differ & known, JACKKNIFE_PARTS),
        np.array_split(known, JACKKNIFE_PARTS),
        strict=True,
    )
    return np.array([[a.sum(), b.sum()] for a, b in parts], dtype=float)


def _slope(steps: list[int], counts: Numbers) -> float:
    """The slope of the logarithm of the share that differs."""
    differ, known = counts.sum(axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.log(differ / known)
    fit = np.isfinite(shares)
    return float(np.polyfit(np.log(np.array(steps)[fit]), shares[fit], 1)[0])
