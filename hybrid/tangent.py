"""A run as numbers, and their derivatives by its parameters, its start and its times.

A run is asked for by a row of numbers: the elements of the parameters in declared order, those of
the state at the start, the first and the last time. What it gives is another. The derivatives of
these by those are carried along the run by its first variation (:mod:`hybrid.variation`); where
there is none they are NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from .arcs import Arc
from .asked import Asked
from .errors import HybridError, OrbitError
from .replay import Plan, plan_of
from .run import Driver
from .scene import Scene, scene_with
from .trajectory import Status
from .variation import Course, Factor, Walk

#: Change of what decides which jump comes first, against the terms of which it is made, that is
#: rounding of them.
TIED = 1e-9

#: What the status of a run means, by its number.
REASONS = {
    1: ("reached_end", "the last time was reached"),
    2: ("max_jumps", "max_jumps was reached; raise it"),
    3: ("zeno_stopped", "jumps accumulate (zeno='stop'); zeno='rest' goes on at rest"),
    4: ("no_rest", "jumps accumulate, and nothing follows: rests=False, or no mode with limit_of="),
    7: ("max_steps", "max_steps was reached; raise it"),
    8: ("not_finite", "a flow, guard or reset is not finite, or the step became zero"),
    9: ("outside", "the start, or a reset, is outside the mode's domain"),
    10: ("undecided", "nothing decides what follows; hy.simulate says where and why"),
    11: ("jump_loop", "jumps follow each other with no time between them"),
    12: (
        "forgotten",
        "a lag looks further back than the record (raise segments), at the present or ahead, or "
        "where the history is not finite",
    ),
    13: ("failed", "the run failed; hy.simulate says why"),
}

NUMBERS = {name: number for number, (name, _) in REASONS.items()}


@attrs.frozen(eq=False)
class Layout:
    """Where things stand in the numbers that a run gives.

    Attributes
    ----------
    size, rows : int
        Elements of the state, and jumps for which there is room.
    outputs : tuple of str
        What is wanted beside the time at the end.
    """

    size: int
    rows: int
    outputs: tuple[str, ...]

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The parts, in order."""
        n, table = self.size, (self.rows, self.size)
        parts: dict[str, dict[str, tuple[int, ...]]] = {
            "final": {"final": (n,)},
            "jumps": {"times": (self.rows,), "before": table, "after": table},
            "zeno": {"t_inf": (), "x_inf": (n,), "ratio": (), "error": ()},
        }
        wanted = [parts[name] for name in parts if name in self.outputs]
        return {"t": (), **{name: shape for part in wanted for name, shape in part.items()}}

    @cached_property
    def places(self) -> dict[str, slice]:
        """By part where it begins and ends."""
        sizes = [int(np.prod(shape, dtype=int)) for shape in self.shapes.values()]
        ends = np.cumsum([0, *sizes]).tolist()
        return {name: slice(*ends[i : i + 2]) for i, name in enumerate(self.shapes)}

    @property
    def length(self) -> int:
        """How many numbers there are."""
        return max(place.stop for place in self.places.values())

    def views(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """The parts of an array, whose first axis are the numbers; to be written to."""
        return {
            name: numbers[place].reshape(self.shapes[name] + numbers.shape[1:])
            for name, place in self.places.items()
        }


@attrs.frozen(eq=False)
class Runs:
    """Runs of a class with the same options.

    Attributes
    ----------
    shapes : tuple of tuple
        Those of the parameters.
    edges : tuple of str
        Names to whose places the table of jumps refers.
    """

    cls: Any
    asked: Asked
    mode: str
    shapes: tuple[tuple[int, ...], ...]
    edges: tuple[str, ...]
    layout: Layout

    def values(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What a run gives; and the places of its edges, the count of its jumps, its status."""
        return self._flown(row, "jumps").numbers()

    def slopes(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, and behind it the derivatives: a column for each number of the row."""
        run = self._flown(row, "dense")
        return *run.numbers(), run.derivatives(len(row))

    def plan(self, row: np.ndarray) -> Plan:
        """The run as it can be flown again (:mod:`hybrid.replay`).

        Raises
        ------
        OrbitError
            Where it cannot.
        """
        run, steps = self._flown(row, "dense"), self.asked.max_steps
        if run.driver is None or run.status not in ("reached_end", "max_jumps"):
            why = dict(REASONS.values()).get(run.status, "the run failed")
            raise OrbitError(f"{run.scene.spec.model}: of this run there are no derivatives: {why}")
        touched = [jump.t for jump in run.driver.record.grazings]
        assert steps is not None
        ends = run.status == "reached_end"
        return plan_of(run.course, touched, ends, steps, self.layout.rows)

    def _flown(self, row: np.ndarray, save: str) -> _Run:
        n = self.layout.size
        *values, t0, t1 = row.tolist()
        x, count = row[-2 - n : -2].copy(), len(values) - n
        scene = scene_with(self.cls, self.shapes, tuple(values[:count]))
        driver, status = None, ""
        try:
            driver = attrs.evolve(self.asked, save=save).driver(scene, (t0, t1), x, None)
            driver.run(self.mode, x)
        except HybridError as fault:
            status = fault.status
        if driver is not None and driver.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if driver is not None and driver.status is not None:
            status = driver.status.name.lower()
        return _Run(self, scene, driver, status, t0, x)


@attrs.frozen(eq=False, slots=False)
class _Run:
    """A run; ``driver`` is None where it could not begin."""

    of: Runs
    scene: Scene
    driver: Driver | None
    status: str
    t0: float
    x: np.ndarray

    @cached_property
    def course(self) -> Course:
        assert self.driver is not None
        record = self.driver.record
        return Course(self.scene, *record.log.apart())

    @property
    def rows(self) -> list[int]:
        """The parts that end with the jumps for which there is room."""
        return sorted(self.course.jumps)[: self.of.layout.rows]

    # -- what it gives ----------------------------------------------------------------------

    def numbers(self) -> tuple[np.ndarray, np.ndarray]:
        layout, driver = self.of.layout, self.driver
        numbers, ints = np.full(layout.length, np.nan), np.full(layout.rows + 2, -1)
        views = layout.views(numbers)
        end = None if driver is None else driver.end
        views["t"][...], final = (self.t0, self.x) if end is None else end[:2]
        if "final" in views:
            views["final"][:] = final
        ints[-2:] = 0, NUMBERS.get(self.status, NUMBERS["failed"])
        if driver is not None and "times" in views:
            self._table(views, ints)
        if driver is not None and "t_inf" in views and driver.record.zeno:
            self._limit(views, driver)
        return numbers, ints

    def _table(self, views: dict[str, np.ndarray], ints: np.ndarray) -> None:
        table = [self.course.jumps[place] for place in self.rows]
        for k, jump in enumerate(table):
            views["times"][k], ints[k] = jump.t, self.of.edges.index(jump.edge)
            views["before"][k], views["after"][k] = jump.before, jump.after
        ints[-2] = len(table)

    def _limit(self, views: dict[str, np.ndarray], driver: Driver) -> None:
        point, tail = driver.record.zeno[0], driver.record.tails[0]
        views["t_inf"][...], views["ratio"][...] = point.t, point.ratio
        if tail is not None:
            views["x_inf"][:], views["error"][...] = tail.x_inf, tail.t_error

    # -- how that changes -------------------------------------------------------------------

    def derivatives(self, columns: int) -> np.ndarray:
        """Derivatives of the numbers by those of the row."""
        layout = self.of.layout
        found = np.full((layout.length, columns), np.nan)
        if self.driver is not None and self.course.parts:
            with suppress(HybridError), np.errstate(all="ignore"):
                self._follow(layout.views(found), columns)
        return found

    def _follow(self, views: dict[str, np.ndarray], columns: int) -> None:
        """Carry the changes along the run, as far as there is a first variation."""
        carried = _Carried(self, columns)
        places = {part: k for k, part in enumerate(self.rows)}
        for factor in carried.walk.factors():
            for moment in carried.through(factor):
                if moment.part in places and "times" in views:
                    k = places[moment.part]
                    views["times"][k] = moment.time
                    views["before"][k], views["after"][k] = moment.before, moment.after
                if moment.ratio is not None and "t_inf" in views and not carried.limits:
                    views["t_inf"][...], views["ratio"][...] = moment.time, moment.ratio
                    views["x_inf"][:] = moment.after
                carried.limits += moment.ratio is not None
        time, final = carried.end()
        views["t"][...] = time
        if "final" in views:
            views["final"][:] = final


@attrs.frozen(eq=False)
class _At:
    """A moment's derivatives by the numbers of the row."""

    part: int
    time: np.ndarray
    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray | None


class _Carried:
    """The change of the state at equal times on its way along a run.

    Attributes
    ----------
    state : array, shape (n, columns)
    limits : int
        Accumulations passed so far.
    """

    def __init__(self, run: _Run, columns: int) -> None:
        self.run, self.limits = run, 0
        self.size, count = len(run.x), columns - len(run.x) - 2
        self.walk = Walk(run.course, True)
        flow, brinks = self.walk.begin()
        self.state, self.given = np.eye(self.size, columns, count), np.eye(count, columns)
        time = np.eye(1, columns, columns - 2)
        moved = brinks @ np.vstack([time, self.state, self.given])
        self.state[:, -2] = -flow
        self.state[:, np.any(moved != 0.0, axis=0)] = np.nan
        self.last: _At | None = None
        assert run.driver is not None
        self.touched = [jump.t for jump in run.driver.record.grazings]

    def through(self, factor: Factor) -> Iterator[_At]:
        """Through a piece of the run; gives what happens at its end."""
        while self.touched and self.touched[0] <= factor.t:  # neighbours go another way
            self.state[:, :-1] = np.nan
            self.touched.pop(0)
        change = np.vstack([self.state, self.given])
        apart = self._apart(factor, change)
        self.state = factor.matrix @ change
        self.state[:, apart] = np.nan
        for number, moment in enumerate(factor.moments):
            ratio = None if moment.ratio is None else moment.ratio @ change
            time, before, after = (
                part @ change for part in (moment.time, moment.before, moment.after)
            )
            if number:
                time[apart], before[:, apart], after[:, apart] = np.nan, np.nan, np.nan
            self.last = _At(moment.part, time, before, after, ratio)
            yield self.last

    def _apart(self, factor: Factor, change: np.ndarray) -> np.ndarray:
        """The numbers whose change makes neighbours take another course at jumps together."""
        if factor.ties is None or not len(factor.ties):
            return np.zeros(change.shape[1], dtype=bool)
        moved, sizes = factor.ties @ change, np.abs(factor.ties) @ np.abs(change)
        found: np.ndarray = np.any(np.abs(moved) > TIED * sizes, axis=0)
        return found

    def end(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the time and the state at the end of the run."""
        run, part = self.run, self.run.course.parts[-1]
        if run.status == "reached_end":
            time = np.eye(1, self.state.shape[1], self.state.shape[1] - 1)[0]
            flow = np.array(run.scene.field(part.mode).rhs(part.t1, part.last.tolist()))
            return time, self.state + np.outer(flow, time)
        jumped = run.status == "max_jumps"
        summed = run.status in ("zeno_stopped", "no_rest") and not isinstance(part, Arc)
        if self.last is not None and (jumped or summed):
            return self.last.time, self.last.after
        nothing = np.full_like(self.state, np.nan)
        return nothing[0], nothing
