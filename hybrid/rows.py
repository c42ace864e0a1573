"""Many runs as rows of numbers, at once: what :func:`hybrid.as_function` gives under ``vmap``.

A row in which nothing needs judgement is a lane that machine code flies alone, on all cores
(:mod:`.abreast`); the others are run one after another.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from .abreast import Abreast, Flown, Given, abreast
from .errors import HybridError
from .rules.lanes import (
    AT_TIME,
    ENDED,
    MADE_JUMPS,
    OUTCOME,
    RATIO_OF,
    STATE,
    SUMMED,
    T_ERROR,
    T_INF,
)
from .scene import scene_with
from .tangent import NUMBERS, Runs

#: Rows from which on they are flown together: to begin takes as long as two or three runs.
FEW = 4


def values(runs: Runs, rows: Any) -> tuple[np.ndarray, np.ndarray]:
    """What runs give: numbers; and the places of their edges, the counts of jumps, the statuses.

    Parameters
    ----------
    rows : array, shape (..., numbers)
    """
    rows = np.asarray(rows)
    flat = rows.reshape(-1, rows.shape[-1])
    numbers = np.full((len(flat), runs.layout.length), np.nan)
    ints = np.full((len(flat), runs.layout.rows + 2), -1)
    done = np.zeros(len(flat), dtype=bool)
    if len(flat) >= FEW:
        _together(runs, flat, numbers, ints, done)
    for k in np.flatnonzero(~done).tolist():
        numbers[k], ints[k] = runs.values(flat[k])
    shape = rows.shape[:-1]
    return numbers.reshape(*shape, -1), ints.reshape(*shape, -1)


def _together(
    runs: Runs, rows: np.ndarray, numbers: np.ndarray, ints: np.ndarray, done: np.ndarray
) -> None:
    """Fly those that need no judgement, and put down what they give."""
    n, kept = runs.layout.size, runs.layout.rows if "times" in runs.layout.places else 0
    fit = np.flatnonzero(np.isfinite(rows).all(axis=1) & (rows[:, -1] > rows[:, -2]))
    if not len(fit):
        return
    parameters, starts, spans = np.split(rows[fit], (-2 - n, -2), axis=1)
    scene = scene_with(runs.cls, runs.shapes, tuple(parameters[0].tolist()))
    try:
        asked = attrs.evolve(runs.asked, save="jumps")
        driver = asked.driver(scene, spans[0].tolist(), starts[0].copy(), runs.history)
    except HybridError:  # it is the rows' own
        return
    together = abreast(scene, driver, runs.mode, Given(parameters, spans, starts), kept)
    if together is None:
        return
    places = {edge: place for place, edge in enumerate(runs.edges)}
    for flown in together.fly():
        edges = np.array([*(places.get(g.edge, -1) for g in together.tables.guards), -1])
        which = fit[flown.lanes]
        numbers[which], ints[which] = _given(runs, together, flown, edges)
        done[which] = True


def _given(
    runs: Runs, together: Abreast, flown: Flown, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What some lanes give, as :meth:`hybrid.tangent.Runs.values` does for one."""
    layout, ends, told = runs.layout, flown.ends, flown.told
    numbers = np.full((layout.length, len(ends)), np.nan)
    ints = np.full((len(ends), layout.rows + 2), -1)
    views = layout.views(numbers)
    views["t"][...] = ends[:, AT_TIME]
    if "final" in views:
        views["final"][...] = together.final(flown).T
    ints[:, -2] = 0
    if "times" in views:
        views["times"][...] = flown.when.T
        views["before"][...], views["after"][...] = flown.around.transpose(2, 1, 3, 0)
        ints[:, :-2] = edges[flown.fired]
        ints[:, -2] = np.minimum(told[:, MADE_JUMPS], layout.rows)
    if "t_inf" in views:
        summed = told[:, SUMMED] > 0
        views["t_inf"][...], views["ratio"][...] = ends[:, T_INF], ends[:, RATIO_OF]
        views["error"][...] = ends[:, T_ERROR]
        views["x_inf"][:, summed] = ends[summed, STATE + layout.size :].T
    ended = told[:, OUTCOME] == ENDED
    ints[:, -1] = np.where(ended, NUMBERS["reached_end"], NUMBERS["max_jumps"])
    return numbers.T, ints
