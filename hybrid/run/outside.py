"""Another solver's steps, made when the rules' own loop asks for them."""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FlowError, OptionError
from ..lowering import Field
from ..lowering.lowered import ORDER
from ..rules.arcs import SAFETY
from ..rules.arrays import Now, Room, Sums
from ..rules.places import (
    AIM,
    FIELD,
    FIRST_LENGTH,
    JUMPS_MADE,
    LOW,
    MADE,
    STEP_END,
    TAU,
    TO_TAU,
    T,
)
from ..segment import nodes, terms, to_powers
from ..solvers import Stepper
from ..trajectory.clock import Instant
from ..trajectory.log import Steps
from .entry import describe
from .kinked import begin
from .pace import Pace

if TYPE_CHECKING:
    from .driver import Driver

#: Powers of the time in a step's polynomial: no method has more.
POWERS = np.arange(ORDER + 1)


class Outside:
    """Makes steps, and keeps those of the arcs that a call of the loop has flown.

    Attributes
    ----------
    arcs : list of int
        For each step its arc, as counted by the loop.
    made : list of (start, length, coefficients, state)
        If dense output is kept, for each step the polynomial by powers of its fraction, and the
        state at its end.
    """

    stepper: Stepper
    pace: Pace
    field: Field
    since: Instant

    def __init__(self, driver: Driver, fields: list[Field], dense: bool) -> None:
        self.driver, self.fields, self.dense = driver, fields, dense
        self.begin()

    def begin(self) -> None:
        """Forget the steps so far."""
        self.arcs: list[int] = []
        self.made: list[tuple[float, float, np.ndarray, np.ndarray]] = []

    def step(self, now: Now, room: Room) -> None:
        """Make a step; at the start of an arc, begin it."""
        try:
            if not now.ints[MADE]:
                self._begin_arc(now, room)
            self.stepper.step(float(now.floats[TO_TAU]))
            self.pace.steps(self.stepper.tau, self.stepper.x)
        except (FlowError, ValueError) as fault:
            raise self._told(now, fault) from None
        if self.dense:
            self.made.append(self._last)
        self._ends(now)
        self.arcs.append(int(now.ints[JUMPS_MADE]))

    def land(self, now: Now, room: Room) -> None:
        """End the last step where a guard is zero."""
        try:
            self.stepper.arrive(float(now.floats[TO_TAU]))
        except (FlowError, ValueError) as fault:
            raise self._told(now, fault) from None
        if self.dense:
            self.made[-1] = self._last
        self._ends(now)
        now.floats[TO_TAU] = self.stepper.tau

    def flown(self, now: Now, sums: Sums) -> None:
        """Keep the pieces of a low flight as steps."""
        n, pieces = len(now.x), int(now.ints[MADE])
        self.arcs += [int(now.ints[JUMPS_MADE])] * pieces
        for piece in range(pieces if self.dense else 0):
            start, length = float(sums.starts[piece]), float(sums.lengths[piece])
            scaled = terms(sums.series[piece * n : piece * n + n], length)
            self.made.append((start, length, scaled, scaled.sum(axis=1)))

    def undo(self, now: Now) -> None:
        """Take back the last step, which may be beyond a guard."""
        now.end[:] = self.stepper.powers()[2][:, 0]
        self.arcs.pop()
        if self.dense:
            self.made.pop()

    def _begin_arc(self, now: Now, room: Room) -> None:
        plan, seen = self.driver.plan, self.driver.record.memory is not None
        length = (self.driver.horizon - float(now.floats[T])) - float(now.floats[LOW])
        first, aim, sizes = float(now.floats[FIRST_LENGTH]), float(now.floats[AIM]), None
        first = min(first, length if seen else SAFETY * length)  # a window may be one step
        if plan.first_step < np.inf:
            first = min(plan.longest(0.0), length)
        if aim < length:
            series = room.c[: len(now.x), 1:]
            sizes = np.abs(series * aim ** np.arange(1, series.shape[1] + 1)).max(axis=1)
            first = min(first or aim, aim)
        t, x, field = float(now.floats[T]), now.x.copy(), self.fields[now.ints[FIELD]]
        self.field = self.driver.scene.field(field.name) if seen else field
        self.since = Instant(t, float(now.floats[LOW]))
        self.stepper = begin(self.driver.flies, self.field, t, x, length, first or None, sizes)
        self.pace = Pace(self.field, t, length)

    def show(self, now: Now, room: Room) -> None:
        """Tell the loop the polynomial of the last step."""
        _, length, powers = self.stepper.powers()
        n, count = powers.shape
        room.c[:n, :count] = powers / length ** POWERS[:count]
        room.c[:n, count:] = 0.0

    def _ends(self, now: Now) -> None:
        """Tell the loop where the last step ends."""
        now.end[:], now.floats[STEP_END] = self.stepper.x, self.stepper.tau

    @property
    def _last(self) -> tuple[float, float, np.ndarray, np.ndarray]:
        """The last step, as it is kept; as delays are to see it."""
        memory = self.driver.record.memory
        if memory is None:
            return (*self.stepper.powers(), self.stepper.x)
        segment = memory.refined(self.field, self.since, [self.stepper.segment()])[0]
        powers = (to_powers(segment.degree) @ segment.coefficients).T
        return segment.start, segment.length, powers, self.stepper.x

    def _told(self, now: Now, fault: Exception) -> Exception:
        """A fault that says where the step begins that cannot be made."""
        if isinstance(fault, OptionError):
            return fault
        field, t = self.fields[now.ints[FIELD]], float(now.floats[T] + now.floats[TAU])
        where, about = describe(self.driver.scene, field, t, now.end), str(fault)
        if not isinstance(fault, FlowError):  # SciPy's linear algebra meets inf or nan
            about = f"the flow is not finite ({fault})"
        return FlowError(f"{where}: {about}")

    def count(self, begin: int, end: int) -> int:
        """How many steps some of the arcs have."""
        return bisect_left(self.arcs, end) - bisect_left(self.arcs, begin)

    def steps(self, begin: int, end: int) -> Steps:
        """The steps of some of the arcs."""
        first = bisect_left(self.arcs, begin)
        chosen = slice(first, first + self.count(begin, end))
        start, length, powers, ends = zip(*self.made[chosen], strict=True)
        degree = max(own.shape[1] for own in powers) - 1
        series = np.array([np.pad(own, ((0, 0), (0, degree + 1 - own.shape[1]))) for own in powers])
        at_nodes = nodes(degree)[:, None] ** np.arange(degree + 1)
        values = np.einsum("sik,jk->sji", series, at_nodes)
        values[:, -1] = ends
        arcs = np.array(self.arcs[chosen]) - begin
        return Steps(arcs, np.array(start), np.array(length), values)
