"""Steps of an outside solver, made when the compiled loop asks for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import FlowError, OptionError
from ..lowering import Field
from ..lowering.lowered import ORDER
from ..rules.arcs import SAFETY
from ..rules.arrays import Left, Now, Room
from ..rules.places import (
    AIM,
    DUE,
    FIELD,
    FIRST_LENGTH,
    JUMPS_MADE,
    LOW,
    MADE,
    STEP_END,
    STEPS_LOST,
    STEPS_MADE,
    TAU,
    TO_TAU,
    T,
)
from ..segment import to_powers
from ..solvers import Stepper
from ..trajectory.clock import Instant
from .entry import describe
from .kinked import begin
from .pace import Pace

if TYPE_CHECKING:
    from .driver import Driver

#: Powers of the time in a step's polynomial: no method has more.
POWERS = np.arange(ORDER + 1)


class Outside:
    """Makes steps and writes them into the arrays of the loop; with ``dense``, their polynomials
    too."""

    stepper: Stepper
    pace: Pace
    field: Field
    since: Instant

    def __init__(self, driver: Driver, fields: list[Field], dense: bool) -> None:
        self.driver, self.fields, self.dense = driver, fields, dense

    def step(self, now: Now, room: Room, left: Left) -> None:
        """Make a step; at the start of an arc, begin it."""
        try:
            if not now.ints[MADE]:
                self._begin_arc(now, room)
            self.stepper.step(float(now.floats[TO_TAU]))
            self.pace.steps(self.stepper.tau, self.stepper.x)
        except (FlowError, ValueError) as fault:
            raise self._told(now, fault) from None
        self._ends(now, left)

    def land(self, now: Now, room: Room, left: Left) -> None:
        """End the last step at the zero of a guard."""
        stepper = self.stepper
        known = None if stepper.repeats else stepper.powers()
        try:
            stepper.arrive(float(now.floats[TO_TAU]))
        except (FlowError, ValueError) as fault:
            raise self._told(now, fault) from None
        if known is not None:
            start, _, powers = known
            losses = self.driver.losses
            losses.tolerances = float(now.floats[STEPS_LOST])
            losses.note(self.field, self.since.t, start, powers[:, 0], stepper)
            now.floats[STEPS_LOST] = losses.tolerances
        self._ends(now, left)
        now.floats[TO_TAU] = self.stepper.tau

    def undo(self, now: Now) -> None:
        """Take back the last step, which may be beyond a guard."""
        now.end[:] = self.stepper.powers()[2][:, 0]

    def _begin_arc(self, now: Now, room: Room) -> None:
        plan, seen = self.driver.plan, bool(self.driver.scene.spec.windows)
        until = self.driver.horizon_before(float(now.floats[DUE]))
        length = (until - float(now.floats[T])) - float(now.floats[LOW])
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
        self.pace = Pace(self.field, t, length, self.driver.losses)

    def show(self, now: Now, room: Room, left: Left) -> None:
        """Give the loop the polynomial of the last step."""
        _, length, powers = self.stepper.powers()
        n, count = powers.shape
        room.c[:n, :count] = powers / length ** POWERS[:count]
        room.c[:n, count:] = 0.0

    def _ends(self, now: Now, left: Left) -> None:
        """Write the end of the last step into the arrays of the loop."""
        now.end[:], now.floats[STEP_END] = self.stepper.x, self.stepper.tau
        place, n = int(now.ints[STEPS_MADE] + now.ints[MADE]), len(now.x)
        left.owner[place] = now.ints[JUMPS_MADE]
        if self.dense:
            start, length, powers = self._last
            left.spans[place], rows = (start, length), left.series[place * n : place * n + n]
            rows[:, : powers.shape[1]], rows[:, powers.shape[1] :] = powers, 0.0

    @property
    def _last(self) -> tuple[float, float, np.ndarray]:
        """The polynomial of the last step, as delays read it."""
        memory = self.driver.record.memory
        if memory is None:
            return self.stepper.powers()
        segment = memory.refined(self.field, self.since, [self.stepper.segment()])[0]
        powers = (to_powers(segment.degree) @ segment.coefficients).T
        return segment.start, segment.length, powers

    def _told(self, now: Now, fault: Exception) -> Exception:
        """The error for a step that cannot be made, with the place where it begins."""
        if isinstance(fault, OptionError):
            return fault
        field, t = self.fields[now.ints[FIELD]], float(now.floats[T] + now.floats[TAU])
        where, about = describe(self.driver.scene, field, t, now.end), str(fault)
        if not isinstance(fault, FlowError):  # SciPy's linear algebra meets inf or nan
            about = f"the flow is not finite ({fault})"
        return FlowError(f"{where}: {about}")
