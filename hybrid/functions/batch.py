"""Results and derivatives of many runs at once, for :func:`hybrid.as_function` under ``vmap``.

A run is given by a row of numbers: parameters, start, first and last time. Rows that do not need
the driver of a run are lanes that compiled code flies on all cores
(:mod:`hybrid.ensembles.threads`), with their derivatives (:mod:`hybrid.rules.changes`); the other
rows are run one after another.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import attrs
import numpy as np

from ..ensembles.threads import FIRST_LANES as FIRST
from ..ensembles.threads import LANE_SUMS, Abreast, FlownLanes, GivenLanes, abreast
from ..errors import HybridError
from ..lowering import Scene, scene_with
from ..lowering.tape import lent, room
from ..rules import unit
from ..rules.arrays import Left
from ..rules.changes import KNOWN, OF_FIELD, OF_GUARD
from ..rules.lanes import (
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
from ..run import Driver
from ..run.rooms import left_for
from ..variation import Derivatives, Owned
from .derivatives import REASON_NUMBERS, Runs

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Integers, Mask, Matrix

#: Fewest rows that are flown together: to prepare that takes as long as two or three runs.
FEWEST_ROWS = 4

Flies = TypeVar("Flies", bound=Abreast)


def values(runs: Runs, rows: Any) -> tuple[np.ndarray, np.ndarray]:
    """The results of runs.

    Parameters
    ----------
    rows : array, shape (..., numbers)

    Returns
    -------
    array of float, shape (..., length)
        The results in the order of :class:`.Layout`.
    array of int, shape (..., jumps + 2)
        The edge of each jump, as its index in ``runs.edges``; the number of jumps; the status.
    """
    rows = np.asarray(rows)
    flat = rows.reshape(-1, rows.shape[-1])
    numbers = np.full((len(flat), runs.layout.length), np.nan)
    ints = np.full((len(flat), runs.layout.rows + 2), -1)
    done = np.zeros(len(flat), dtype=bool)
    if len(flat) >= FEWEST_ROWS:
        _fly_together(runs, flat, numbers, ints, done)
    for k in np.flatnonzero(~done).tolist():
        numbers[k], ints[k] = runs.values(flat[k])
    shape = rows.shape[:-1]
    return numbers.reshape(*shape, -1), ints.reshape(*shape, -1)


def _fly_together(
    runs: Runs, rows: Matrix, numbers: Matrix, ints: IntegerMatrix, done: Mask
) -> None:
    """Fly the rows that do not need a driver; write their results, and mark them as done."""
    fit = np.flatnonzero(_valid(runs, rows))
    together = _flier(runs, rows[fit], Abreast) if len(fit) else None
    if together is None:
        return
    for flown in together.fly():
        which = fit[flown.lanes]
        numbers[which], ints[which] = _results(runs, together, flown)
        done[which] = True


def _valid(runs: Runs, rows: Matrix) -> Mask:
    """Which rows are finite, have a last time after the first, and parameters that the model takes:
    these have bounds, so it is asked about the least and the greatest first."""
    fit: np.ndarray = np.isfinite(rows).all(axis=1) & (rows[:, -1] > rows[:, -2])
    given = rows[fit, : -2 - runs.layout.size]
    bounded = len(given) > 1 and not runs.timed
    if not (bounded and all(map(runs.takes, (given.min(axis=0), given.max(axis=0))))):
        fit[fit] = [runs.takes(values) for values in given]
    return fit


def _lanes_of(runs: Runs, rows: Matrix) -> GivenLanes:
    """Parameters, times and starts of rows."""
    first = -2 - runs.layout.size
    return GivenLanes(rows[:, :first], rows[:, -2:], rows[:, first:-2])


def _flier(runs: Runs, rows: Matrix, flies: type[Flies]) -> Flies | None:
    """An instance of ``flies``, made with the first of the rows; None if they need a driver."""
    lanes, kept = _lanes_of(runs, rows), runs.layout.rows if "times" in runs.layout.places else 0
    scene = scene_with(runs.cls, runs.shapes, tuple(lanes.values[0].tolist()), runs.samples)
    try:
        asked = attrs.evolve(runs.asked, save="jumps")
        driver = asked.driver(scene, lanes.spans[0].tolist(), lanes.starts[0].copy(), runs.history)
    except HybridError:  # raised again when the row is run alone
        return None
    return abreast(scene, driver, runs.mode, lanes, kept, flies)


def _results(runs: Runs, together: Abreast, flown: FlownLanes) -> tuple[np.ndarray, np.ndarray]:
    """The results of lanes, as :func:`values` returns them."""
    layout, ends, told = runs.layout, flown.ends, flown.told
    numbers = np.full((layout.length, len(ends)), np.nan)
    ints = np.full((len(ends), layout.rows + 2), -1)
    views = layout.views(numbers)
    views["t"][...] = ends[:, AT_TIME]
    if "final" in views:
        views["final"][...] = together.final(flown).T
    ints[:, -2] = 0
    if "times" in views:
        places = {edge: place for place, edge in enumerate(runs.edges)}
        edges = np.array([*(places.get(g.edge, -1) for g in together.tables.guards), -1])
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
    ints[:, -1] = np.where(ended, REASON_NUMBERS["reached_end"], REASON_NUMBERS["max_jumps"])
    return numbers.T, ints


# ---------------------------------------------------------------------------------------
# derivatives


class Gradients:
    """The results of runs and their derivatives by the numbers of their rows, as a function."""

    def __init__(self, runs: Runs) -> None:
        self.runs = runs
        self._made: Changing | None = None

    def __call__(self, rows: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The results as :func:`values`, then the derivatives, shape ``(..., length, numbers)``."""
        rows, layout = np.asarray(rows), self.runs.layout
        flat = rows.reshape(-1, rows.shape[-1])
        numbers = np.full((len(flat), layout.length), np.nan)
        ints = np.full((len(flat), layout.rows + 2), -1)
        slopes = np.full((*numbers.shape, flat.shape[1]), np.nan)
        left = np.ones(len(flat), dtype=bool)
        fit = np.flatnonzero(_valid(self.runs, flat))
        together = self.together(flat[fit]) if len(fit) else None
        if together is not None:
            for flown, found in together.changes():
                which = fit[flown.lanes]
                numbers[which], ints[which] = _results(self.runs, together, flown)
                slopes[which], left[which] = found[:, self._sources], False
        slopes[:, self._sources < 0] = np.nan
        for k in np.flatnonzero(left).tolist():
            numbers[k], ints[k], slopes[k] = self.runs.slopes(flat[k])
        shape = rows.shape[:-1]
        return tuple(a.reshape(*shape, *a.shape[1:]) for a in (numbers, ints, slopes))  # type: ignore[return-value]

    def together(self, rows: Matrix) -> Changing | None:
        """The flier of rows, which keeps its tables between calls; None if rows need a driver."""
        if self._made is None:
            self._made = _flier(self.runs, rows, Changing)
        return None if self._made is None else self._made.of(_lanes_of(self.runs, rows))

    @cached_property
    def _sources(self) -> np.ndarray:
        """For each result, its row in the derivatives that the rule returns; -1 if it has none."""
        layout = self.runs.layout
        n, rows = layout.size, layout.rows
        first = 3 + 2 * n
        own, jumps = 1 + np.arange(n), first + np.arange(rows) * (1 + 2 * n)
        before = 1 + jumps[:, None] + np.arange(n)
        found = np.full(layout.length, -1)
        places = {"t": 0, "final": own, "times": jumps, "before": before, "after": before + n}
        places |= {"t_inf": n + 1, "x_inf": n + 1 + own, "ratio": 2 * n + 2}
        for name, view in layout.views(found).items():
            view[...] = places.get(name, -1)
        return found


class Changing(Abreast):
    """Flies lanes, and carries the derivatives by the numbers of their rows along.

    Attributes
    ----------
    asked : array of int, shape (lanes, 2)
        Status of the derivatives of each lane, and the field or guard that the rule lacks.
    found : array, shape (lanes, rows, numbers)
        The derivatives.
    """

    asked: np.ndarray
    found: np.ndarray

    def __init__(
        self, scene: Scene, driver: Driver, mode: str, lanes: GivenLanes, rows: int
    ) -> None:
        super().__init__(scene, driver, mode, lanes, rows)
        self.derived = Owned(Derivatives(scene, True), self.tables)
        self.derived.add_field(self.field)
        self.bends = any(scene.field(name).changes for name in scene.modes)

    def of(self, lanes: GivenLanes) -> Changing:
        """A copy for other lanes, which shares the tables."""
        other, (count, n), columns = copy(self), lanes.starts.shape, lanes.values.shape[1]
        other.given, other.stop = lanes, np.zeros(1, dtype=np.int64)
        other.asked = np.zeros((count, 2), dtype=np.int64)
        rows = 3 + 2 * n + self.rows * (1 + 2 * n)
        other.found = np.empty((count, rows, columns + n + 2))
        return other

    @property
    def _needs(self) -> tuple[Any, ...]:
        return *super()._needs, self.bends

    def _left(self, n: int) -> Left:
        """The work arrays; if formulas of the flow change, with room for the series of steps."""
        rows = self.most[1] * n if self.bends else 0
        return left_for(n, *self.most, (rows, self.loop.order + 1), LANE_SUMS)

    def changes(self) -> Iterator[tuple[FlownLanes, np.ndarray]]:
        """Yield results and derivatives of the lanes whose derivatives the rule can find."""
        everyone = np.arange(len(self.given.starts))
        for lanes in (everyone[:FIRST], everyone[FIRST:]):
            which = lanes
            while len(which) and self.derived.parts:
                for flown in self.complete(which):
                    known = flown.those(self.asked[flown.lanes, 0] == KNOWN)
                    yield known, self.found[known.lanes]
                self.derived.flown(len(which))
                which = self._asking(which)

    def _asking(self, lanes: Integers) -> Integers:
        """Add fields and guards whose derivatives are missing; returns the lanes that need them."""
        asked = self.asked[lanes]
        if (asked[:, 0] < OF_FIELD).all():
            return lanes[:0]
        for kind, add in ((OF_FIELD, self.derived.add_field), (OF_GUARD, self.derived.add_guard)):
            for number in set(asked[asked[:, 0] == kind, 1].tolist()):
                add(number)
        found: np.ndarray = lanes[(asked[:, 0] == OF_FIELD) | (asked[:, 0] == OF_GUARD)]
        return found

    def _lay_out(self) -> None:
        super()._lay_out()
        self.slopes, parts = self.derived.slopes, self.derived.parts
        key = "derivatives", len(parts)
        if key not in self.laid_out:
            self.laid_out[key] = self.steady(parts, ())
        self.own = self.laid_out[key]

    def _call(self, which: Integers, automaton: tuple[Any, ...], lanes: tuple[Any, ...]) -> int:
        fly: Any = unit("changes").flown
        asked, found = self.asked[which], self.found[which]
        parts, given, _, ops, more = self.own
        known = *map(id, self.slopes), len(self.derived.parts)
        with lent(self.laid_out, known, self._changing) as (_, slopes, numbers, still, changing):
            numbers[:, 0] = self.slopes.programs.numbers
            own = parts, given, ops, more, numbers, still, slopes, changing
            made = fly(*automaton, *own, *lanes, asked, found.reshape(-1, found.shape[2]))
        self.asked[which], self.found[which] = asked, found
        return made  # type: ignore[no-any-return]

    def _changing(self) -> tuple[Any, ...]:
        """The arrays to which a thread writes: the derivatives' programs, a copy of them with
        numbers of its own, these numbers, and work arrays."""
        programs, n = self.slopes.programs, self.scene.spec.dimension
        numbers = programs.numbers.copy()
        slopes = self.slopes._replace(programs=programs._replace(numbers=numbers))
        rooms = room(self.derived.needs, n, 1), self.derived.room()
        return self.slopes, slopes, numbers.reshape(-1, 1), *rooms
