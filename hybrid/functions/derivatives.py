"""The results of a run as numbers, and their derivatives by its parameters, start and times.

The inputs of a run are a row of numbers: the elements of the parameters in declared order, those of
the state at the start, the first and the last time. Its results are another row. The derivatives of
the results by the inputs are carried along the run by its first variation
(:mod:`hybrid.variation`); where there is none they are NaN.
"""

from __future__ import annotations

import math
import warnings
from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.base import require_values
from ..automaton.signals import Samples
from ..delay.hindsight import Hindsight
from ..delay.history import from_start
from ..errors import HybridError, OrbitError, ParameterError
from ..lowering import Scene, scene_with
from ..replay import Itinerary, blank, laws_of, plan_of
from ..run import Driver
from ..run.options import Asked
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Status
from ..variation import Carried, Course, PastVariation, Shift, Strand, Walk

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Matrix, Numbers, StateVector

#: Name and meaning of each status of a run, by its number.
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
        "a lag is negative, or looks where the history is not finite",
    ),
    13: ("failed", "the run failed; hy.simulate says why"),
    14: ("terminated", "an edge has led to hy.TERMINATE"),
}

#: Statuses of runs that end just after a jump.
BEHIND_A_JUMP = ("max_jumps", "terminated")

REASON_NUMBERS = {name: number for number, (name, _) in REASONS.items()}


@attrs.frozen(eq=False)
class Layout:
    """The order of the results of a run in a row of numbers.

    Attributes
    ----------
    size, rows : int
        Number of state elements, and most jumps in the table.
    outputs : tuple of str
        The results besides the final time: some of ``"final"``, ``"jumps"`` and ``"zeno"``.
    """

    size: int
    rows: int
    outputs: tuple[str, ...]

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the results, in order."""
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
        """The places of each result in the row."""
        sizes = [*map(math.prod, self.shapes.values())]
        ends = np.cumsum([0, *sizes]).tolist()
        return {name: slice(*ends[i : i + 2]) for i, name in enumerate(self.shapes)}

    @property
    def length(self) -> int:
        """The length of the row."""
        return max(place.stop for place in self.places.values())

    def views(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Writable views of an array by result; its first axis is that of the row."""
        return {
            name: numbers[place].reshape(self.shapes[name] + numbers.shape[1:])
            for name, place in self.places.items()
        }


@attrs.frozen(eq=False)
class Runs:
    """Runs of a class with the same options.

    Attributes
    ----------
    cls, asked, mode
        The model's class, the options, and the mode at the start.
    shapes : tuple of tuple
        Shapes of the parameters.
    edges : tuple of str
        Names of the edges; the table of jumps contains indices into it.
    history
        The history, for delays.
    samples
        The data of the signals.
    """

    cls: Any
    asked: Asked
    mode: str
    shapes: tuple[tuple[int, ...], ...]
    edges: tuple[str, ...]
    layout: Layout
    history: Any = None
    samples: tuple[Samples, ...] = ()

    def values(self, row: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """The results of a run: numbers and integers, as in :func:`.batch.values`."""
        return self._flown(row, "jumps").numbers()

    def slopes(self, row: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The results as :meth:`values`, then the derivatives, shape ``(length, len(row))``."""
        run = self._flown(row, "dense")
        return *run.numbers(), run.derivatives(len(row))

    def plan(self, row: Numbers) -> tuple[np.ndarray, ...]:
        """Whether a run can be replayed (:mod:`hybrid.replay`), and its plan; warns if not."""
        plan, fault = self._flown(row, "dense").planned()
        if fault is not None:
            warnings.warn(f"{fault}; second derivatives of this run are NaN", stacklevel=2)
        return np.array(fault is None), *plan

    def planned(self, row: Numbers) -> tuple[np.ndarray, ...]:
        """The results as :meth:`values`; whether the run can be replayed, and its plan."""
        run = self._flown(row, "dense")
        plan, fault = run.planned()
        return *run.numbers(), np.array(fault is None), *plan

    @property
    def timed(self) -> bool:
        """Whether parameters are the times of a clock, which are to increase."""
        return any(clock.times.at is not None for clock in self.cls.spec.clocks)

    def takes(self, values: Numbers) -> bool:
        """Whether the model takes parameters of these values."""
        scene = scene_with(self.cls, self.shapes, tuple(values.tolist()), self.samples)
        try:
            require_values(self.cls, scene.values[: len(self.shapes)])
        except ParameterError:
            return False
        return True

    @property
    def room(self) -> int:
        """Most steps of a replay."""
        assert self.asked.max_steps is not None
        return self.asked.max_steps

    def _flown(self, row: Numbers, save: str) -> _Run:
        n = self.layout.size
        *values, t0, t1 = row.tolist()
        x, count = row[-2 - n : -2].copy(), len(values) - n
        scene = scene_with(self.cls, self.shapes, tuple(values[:count]), self.samples)
        driver, status = None, ""
        try:
            require_values(self.cls, scene.values[: len(self.shapes)])
            driver = attrs.evolve(self.asked, save=save).driver(scene, (t0, t1), x, self.history)
            driver.run(self.mode, x)
        except HybridError as fault:
            status = fault.status
        if driver is not None and driver.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if driver is not None and driver.status is not None:
            status = driver.status.name.lower()
        return _Run(self, scene, driver, status, t0, x, row)


@attrs.frozen(eq=False, slots=False)
class _Run:
    """A run that has ended; ``driver`` is None if it could not begin."""

    of: Runs
    scene: Scene
    driver: Driver | None
    status: str
    t0: float
    x: StateVector
    row: Numbers

    @cached_property
    def course(self) -> Course:
        """The course of the run, for its first variation."""
        assert self.driver is not None
        driver, log, sight = self.driver, self.driver.record.log, None
        if driver.history is not None:
            sight = Hindsight(self.scene, driver.history, driver.plan.memory, log)
        return Course(self.scene, *log.apart(), sight)

    @property
    def rows(self) -> list[int]:
        """Indices of the parts that end with the jumps of the table, which are the first ones."""
        return sorted(self.course.jumps)[: self.of.layout.rows]

    # -- results ----------------------------------------------------------------------------

    def numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """The results: see :meth:`Runs.values`."""
        layout, driver = self.of.layout, self.driver
        numbers, ints = np.full(layout.length, np.nan), np.full(layout.rows + 2, -1)
        views = layout.views(numbers)
        end = None if driver is None else driver.end
        views["t"][...], final = (self.t0, self.x) if end is None else end[:2]
        if "final" in views:
            views["final"][:] = final
        ints[-2:] = 0, REASON_NUMBERS.get(self.status, REASON_NUMBERS["failed"])
        if driver is not None and "times" in views:
            self._table(views, ints)
        if driver is not None and "t_inf" in views and driver.record.zeno:
            self._limit(views, driver)
        return numbers, ints

    def _table(self, views: dict[str, np.ndarray], ints: Integers) -> None:
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

    def planned(self) -> tuple[Itinerary, HybridError | None]:
        """The plan of a replay and None; if there is none, a blank plan and the reason."""
        try:
            return self._plan(), None
        except HybridError as fault:
            return blank(laws_of(self.scene.code), self.of.room, self.of.layout.rows), fault

    def _plan(self) -> Itinerary:
        if self.driver is None or self.status not in ("reached_end", *BEHIND_A_JUMP):
            why = dict(REASONS.values()).get(self.status, "the run failed")
            raise OrbitError(
                f"{self.scene.spec.model}: of this run there are no derivatives: {why}"
            )
        touched = [jump.t for jump in self.driver.record.grazings]
        ends, layout = self.status == "reached_end", self.of.layout
        with np.errstate(all="ignore"):
            return plan_of(self.course, touched, ends, self.of.room, layout.rows)

    # -- derivatives ------------------------------------------------------------------------

    def derivatives(self, columns: int) -> Matrix:
        """Derivatives of the results by the row, shape ``(length, columns)``."""
        layout = self.of.layout
        found = np.full((layout.length, columns), np.nan)
        if self.driver is not None and self.course.parts:
            with suppress(HybridError), np.errstate(all="ignore"):
                self._carry(layout.views(found), columns)
        return found

    def _carry(self, views: dict[str, np.ndarray], columns: int) -> None:
        """Carry the perturbation along the run, as far as there is a first variation, and write the
        derivatives of the results on the way."""
        carried = self._at_start(columns)
        places = {part: k for k, part in enumerate(self.rows)}
        for moment in carried.moments():
            if moment.part in places and "times" in views and moment.ratio is None:
                k = places[moment.part]
                views["times"][k] = moment.time
                views["before"][k], views["after"][k] = moment.before, moment.after
            if moment.ratio is not None and "t_inf" in views and carried.limits == 1:
                views["t_inf"][...], views["ratio"][...] = moment.time, moment.ratio
                views["x_inf"][:] = moment.after
        time, final = self._at_end(carried)
        views["t"][...] = time
        if "final" in views:
            views["final"][:] = final

    def _at_start(self, columns: int) -> Carried:
        """The perturbation at the start of the run, by the numbers of the row."""
        assert self.driver is not None
        walk, size = Walk(self.course, True), len(self.x)
        count = columns - size - 2
        flow, brinks = walk.begin()
        state, given = np.eye(size, columns, count), np.eye(count, columns)
        state[:, -2] = -flow
        touched = [jump.t for jump in self.driver.record.grazings]
        carried = Carried(walk, state, given, touched)
        seen = np.zeros((0, columns))
        if self.course.sight:
            past = self._past(walk, given)
            carried.remember(past)
            seen = past.shown(0, *walk.moment(0, False), state)
        time, start = np.eye(1, columns, columns - 2), np.eye(size, columns, count)
        carried.none |= np.any(brinks @ np.vstack([time, start, seen, given]) != 0.0, axis=0)
        return carried

    def _past(self, walk: Walk, given: np.ndarray) -> PastVariation:
        """The variation of the history: that of the start where no history is given, else 0."""
        columns, size = given.shape[1], len(self.x)
        own = from_start(self.scene.spec, self.of.history)
        before = np.eye(size, columns, columns - 2 - size) * own[:, None]
        x = walk.course.sight.record(0).states(np.array([self.t0]), high=self.t0)[0]
        start = Shift(self.t0, x, self.x, np.eye(1, columns, columns - 2)[0])
        units = np.where(self.row == 0.0, 1.0, np.abs(self.row))
        return PastVariation(
            walk, given, units, [Strand(self.t0 - 1.0, self.t0, before[None])], [start]
        )

    def _at_end(self, carried: Carried) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the final time and state; NaN if the run failed or stopped elsewhere."""
        place, part, columns = len(self.course.parts) - 1, self.course.parts[-1], len(self.row)
        if self.status == "reached_end":
            time = np.eye(1, columns, columns - 1)[0]
            scene, _ = carried.walk.beside(place, True)
            flow = np.array(scene.field(part.mode).rhs(part.t1, part.last.tolist()))
            return time, carried.final() + np.outer(flow, time)
        jumped = self.status in BEHIND_A_JUMP
        summed = self.status in ("zeno_stopped", "no_rest") and not isinstance(part, Arc)
        if carried.last is not None and (jumped or summed):
            return carried.last.time, carried.last.after
        return np.full(columns, np.nan), np.full((len(self.x), columns), np.nan)
