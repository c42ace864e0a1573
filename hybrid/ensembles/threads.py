"""Lanes integrated by compiled code alone, in threads that run in parallel (no interpreter lock).

:mod:`hybrid.rules.lanes` can integrate a lane if the driver of a run would leave all of it to the
rules' loop. The result then equals that of the run to the last bit (with an explicit Runge-Kutta
pair, whose steps are made here from its tables, up to rounding). Other lanes are left to the
driver. To *fly* a lane means to integrate it through its jumps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..lowering import Scene
from ..lowering.tape import Jets, lent
from ..rules import unit
from ..rules.arrays import AutomatonArrays, Left
from ..rules.lanes import ASKS, ENDED, FLOWN_TO, LAST_JUMP, LEFT, MODE, OUTCOME, STATE, SUMMED, TOLD
from ..run import Driver
from ..run.rooms import left_for, now_for, work_for
from ..solvers.pairs import NO_TABLES
from ..zeno.narrow import bounded
from .cores import cores

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Mask, Matrix, StateVectors
    from ..lowering.python import Scalar

#: Most and fewest lanes in a call, between which progress is reported; and calls for each thread,
#: within these bounds, so that all threads end at about the same time.
BLOCK_LANES, LEAST_LANES, CALLS_EACH = 256, 8, 4

#: Most jumps that are kept in a call; they take some megabytes.
BLOCK_JUMPS = 2**17

#: Lanes that are flown first, to find which fields and guards the tables must contain.
FIRST_LANES = 16

#: Most jumps, steps and sums of a lane that is flown here. They take some tenths of a second, for
#: which a keyboard interrupt has to wait.
LANE_JUMPS, LANE_STEPS, LANE_SUMS = 8192, 65536, 64


class FlownLanes(NamedTuple):
    """Results of some lanes, with one row for each.

    Attributes
    ----------
    lanes : array of int, shape (k,)
        Numbers of the lanes.
    ends, told : arrays
        Numbers and integers that the rule returns; columns as in :mod:`hybrid.rules.lanes`.
    when, fired, around : arrays, shapes (k, jumps), (k, jumps) and (k, jumps, 2, n)
        Time and guard of the first jumps, and the states before and after them; -1 for a guard, and
        NaN, where there are fewer.
    """

    lanes: np.ndarray
    ends: np.ndarray
    told: np.ndarray
    when: np.ndarray
    fired: np.ndarray
    around: np.ndarray

    def those(self, fit: Mask) -> FlownLanes:
        """The results of the lanes that a mask selects."""
        return self if fit.all() else FlownLanes(*(column[fit] for column in self))


class GivenLanes(NamedTuple):
    """Parameters, first and last times, and starts, with a row for each lane."""

    values: np.ndarray
    spans: np.ndarray
    starts: np.ndarray


def abreast(
    scene: Scene,
    driver: Driver,
    mode: str,
    lanes: GivenLanes,
    rows: int = 0,
    flies: type[Any] | None = None,
) -> Any:
    """An :class:`Abreast` for the lanes of an ensemble; None if the options or the model require
    the driver.

    Parameters
    ----------
    driver : Driver
        The run of one of the lanes, not yet begun.
    rows : int
        How many jumps of each lane are kept.
    flies : type, optional
        The subclass of :class:`Abreast` to make.
    """
    plan, loop, solver = driver.plan, driver.loop, driver.solver
    if loop is None or plan.bounded or plan.zeno == "truncate" or scene.samples:
        return None
    if not solver.whole and (solver.tables is None or flies is not None or scene.spec.lags):
        return None
    declared = mode in [each.name for each in scene.spec.modes]
    plain = declared and loop.may(scene.field(mode)) and _alike(scene, lanes.values)
    return (flies or Abreast)(scene, driver, mode, lanes, rows) if plain else None


def _alike(scene: Scene, values: Matrix) -> bool:
    """Whether, with the parameters of each lane, the same guards bound the domains of the modes."""
    code, edges = scene.code, scene.spec.transitions
    kicks = [edge for edge in edges if code.kicks(edge)]
    own = [code.bounds(edge, scene.values) for edge in kicks]
    return not kicks or all([code.bounds(e, row) for e in kicks] == own for row in values.tolist())


class Abreast:
    """Flies the lanes of an ensemble in threads of compiled code."""

    def __init__(
        self, scene: Scene, driver: Driver, mode: str, lanes: GivenLanes, rows: int
    ) -> None:
        assert driver.loop is not None
        self.rows = rows
        self.scene, self.tables, self.given = scene, driver.loop.tables, lanes
        self.loop, self.solver, plan = driver.loop, driver.solver, driver.plan
        self.field = self.tables.number(scene.field(mode))
        self.watched = plan.zeno != "ignore"
        self.most = min(plan.max_jumps, LANE_JUMPS), int(min(plan.max_steps - 1, LANE_STEPS))
        self.stop, self.steps = np.zeros(1, dtype=np.int64), 0
        self.laid_out: dict[Any, Any] = {}
        self.whole = plan.max_jumps <= LANE_JUMPS  # else a lane with more is left to the driver

    def fly(self) -> Iterator[FlownLanes]:
        """Yield the results of lanes, in any order; lanes that need the driver are left out."""
        few, rest = np.split(np.arange(len(self.given.starts)), [FIRST_LANES])
        yield from self.complete(few)
        to_come = self.steps * len(rest) // FIRST_LANES
        self.tables.flown(to_come, self.loop.order)
        yield from self.complete(rest)

    def mode(self, number: int) -> str:
        """The mode of field ``number``."""
        return self.tables.fields[number].name

    def final(self, flown: FlownLanes) -> StateVectors:
        """The final states of lanes, shape ``(k, n)``; at rest or sliding, projected."""
        n = self.given.starts.shape[1]
        until, x = flown.ends[:, FLOWN_TO].tolist(), flown.ends[:, STATE : STATE + n].copy()
        ended, number = flown.told[:, OUTCOME] == ENDED, flown.told[:, MODE]
        for mode in np.unique(number[ended]).tolist():
            which = np.flatnonzero(ended & (number == mode)).tolist()
            lanes = flown.lanes[which].tolist()
            for k, onto in zip(which, self.onto(mode, lanes), strict=False):
                x[k] = onto(until[k], x[k].tolist())
        return x

    def onto(self, number: int, lanes: list[int]) -> Iterator[Scalar]:
        """For each lane, the projection ``(t, x)`` onto the held contacts or the sliding surface of
        field ``number``; empty if the field has neither."""
        field = self.tables.fields[number]
        if field.project is None:
            return iter(())
        onto = self.scene.projector(field.mode, field.held)
        return (onto(tuple(values)) for values in self.given.values[lanes].tolist())

    def complete(self, which: Integers) -> Iterator[FlownLanes]:
        """Fly lanes; those that need a field or guard that the tables lack are repeated with it."""
        while len(which):
            self._lay_out()
            asking = []
            for flown in self._in_threads(which):
                outcome = flown.told[:, OUTCOME]
                asks = outcome == ASKS
                if asks.any():
                    asking.append(flown.those(asks))
                yield flown.those((outcome == ENDED) | (outcome == LAST_JUMP))
            which = np.concatenate([which[:0], *(asks.lanes for asks in asking)])
            rows = [row for asks in asking for row in asks.told[:, [MODE, SUMMED]].tolist()]
            for guard, column in sorted(set(map(tuple, rows))):
                self.tables.complete(guard, column, bounded)

    def _lay_out(self) -> None:
        """Lay out the programs, into which the parameters of each lane are inserted."""
        parts, bounded = self.tables.parts, self.tables.bounds.given
        key = len(parts), len(bounded)
        if key not in self.laid_out:
            self.laid_out[key] = self.steady(parts, bounded)
        self.programs = self.laid_out[key]

    def steady(self, parts: Sequence[Jets], bounded: Any) -> tuple[np.ndarray, ...]:
        """The parts of the programs that do not depend on time and state, concatenated.

        Returns where each begins and ends in these arrays, the places of parameters in the programs
        and in the bounds, and two arrays of operations.
        """
        ends, rows, given = np.zeros(3, dtype=np.int64), [], []
        columns = self.given.values.shape[1]
        for part in parts:
            tape = part.tape
            given.append(tape.given.T[tape.given[1] < columns] + np.array([ends[2], 0]))
            sizes = [len(tape.steady), len(tape.more), len(part.numbers)]
            rows.append(np.column_stack([ends, ends + sizes]).reshape(-1))
            ends = ends + sizes
        return (
            np.array(rows, dtype=np.int64),
            np.ascontiguousarray(np.concatenate(given)),
            np.array(bounded, dtype=np.int64).reshape(-1, 2),
            np.concatenate([part.tape.steady for part in parts]),
            np.concatenate([part.tape.more for part in parts]),
        )

    def _in_threads(self, which: Integers) -> Iterator[FlownLanes]:
        """Fly lanes in blocks, in as many threads as there are cores."""
        threads = cores()
        most = min(BLOCK_LANES, BLOCK_JUMPS // max(1, self.rows))
        size = max(LEAST_LANES, min(most, len(which) // (CALLS_EACH * threads)))
        automaton = self.tables.automaton
        if len(which) <= size:
            flown, steps = self._block(automaton, which)
            self.tables.flown(steps, self.loop.order)
            yield flown
            return
        blocks = np.split(which, range(size, len(which), size))
        # unlike a condition, on which as_completed waits, this may be interrupted at any time
        pool, ended = ThreadPoolExecutor(threads), SimpleQueue[Future[tuple[FlownLanes, int]]]()
        try:
            for block in blocks:
                pool.submit(self._block, automaton, block).add_done_callback(ended.put)
            for _ in blocks:
                flown, steps = ended.get().result()
                self.tables.flown(steps, self.loop.order)
                self.steps += steps
                yield flown
        finally:
            self.stop[0] = 1
            pool.shutdown(cancel_futures=True)
            self.stop[0] = 0

    def _block(self, automaton: AutomatonArrays, which: Integers) -> tuple[FlownLanes, int]:
        """Fly a block of lanes in own work arrays; returns the results and the number of steps."""
        asked = [np.ascontiguousarray(rows[which]) for rows in self.given]
        count, n = asked[-1].shape
        ends, told = np.empty((count, STATE + 2 * n)), np.zeros((count, TOLD), dtype=np.int64)
        when, around = (
            np.full((count, self.rows), np.nan),
            np.full((count * self.rows * 2, n), np.nan),
        )
        fired = np.full(when.shape, -1)
        lanes = *asked, self.field, self.watched, ends, told, when, fired, around, self.stop
        with (
            lent(self.laid_out, ("own", id(automaton)), lambda: self._own(automaton)) as given,
            lent(self.tables.free, self._needs, lambda: self._rooms(n)) as rooms,
        ):
            _, own, numbers, run, now, pair = given
            numbers[:, 0] = automaton.programs.numbers
            own.bounds.numbers[:], run[:] = automaton.bounds.numbers, self.loop.run
            flown = own, run, now, *rooms, pair, *self.programs, numbers
            steps = self._call(which, flown, lanes)
        if not self.whole:
            told[told[:, OUTCOME] == LAST_JUMP, OUTCOME] = LEFT
        around = around.reshape(count, self.rows, 2, n)
        return FlownLanes(which, ends, told, when, fired, around), steps

    def _call(self, which: Integers, automaton: tuple[Any, ...], lanes: tuple[Any, ...]) -> int:
        """Call the rule that flies lanes; returns the number of steps."""
        fly: Any = unit("lanes").lanes
        return fly(*automaton, *lanes)  # type: ignore[no-any-return]

    @property
    def _needs(self) -> tuple[Any, ...]:
        """Key of the work arrays: the sizes on which they depend."""
        return "lanes", *self.tables.needs, self.loop.order, *self.most

    def _own(self, automaton: AutomatonArrays) -> tuple[Any, ...]:
        """The arrays to which a thread writes: the automaton, a copy of it with numbers of its own,
        these numbers, the state of the run, and the tables of a Runge-Kutta pair."""
        solver, n = self.solver, self.scene.spec.dimension
        numbers, ranged = automaton.programs.numbers.copy(), automaton.bounds.numbers.copy()
        own = automaton._replace(
            programs=automaton.programs._replace(numbers=numbers),
            bounds=automaton.bounds._replace(numbers=ranged),
        )
        pair = (solver.tables or NO_TABLES).pair(n, solver.rtol, solver.atol)
        run = self.loop.run.copy()
        return automaton, own, numbers.reshape(-1, 1), run, now_for(self.tables, n), pair

    def _rooms(self, n: int) -> tuple[Any, ...]:
        room, sums, look = work_for(self.tables, n, self.loop.order)
        return room, self._left(n), sums, look

    def _left(self, n: int) -> Left:
        """Arrays for the jumps, steps and sums of one lane after another."""
        return left_for(n, *self.most, (0, self.loop.order + 1), LANE_SUMS)
