"""Checks the steps of the compiled loop against the flow when it asks for that."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..bounds.defect import defect_of, follows
from ..errors import FlowError
from ..rules.arrays import Now, Room, Sums
from ..rules.places import CROSSED, FIELD, FIRED, LOW_AHEAD, MADE, STEP_END, TAU, TO_TAU, T
from ..segment import Segment, of_powers, terms
from ..solvers import Stepper
from ..solvers.watchful import WatchfulStepper
from ..zeno.flight import pieces_of, segments
from .entry import describe

if TYPE_CHECKING:
    from ..lowering.automaton import Tables
    from .driver import Driver


class LoopStepper(Stepper):
    """The step that the loop has just made, behind a solver's interface: a series that may be
    cut."""

    repeats = True

    def __init__(self, now: Now, room: Room) -> None:
        self.now, self.room = now, room

    @property
    def tau(self) -> float:  # type: ignore[override]
        """The end of the part of the step that is used: a guard may fire in it."""
        return float(min(self.now.floats[TO_TAU], self.now.floats[STEP_END]))

    @property
    def x(self) -> np.ndarray:  # type: ignore[override]
        """The state there."""
        return self.now.end

    @x.setter
    def x(self, value: np.ndarray) -> None:
        self.now.end[:] = value

    def step(self, limit: float) -> None:
        """Nothing: the loop has made the step."""

    def segment(self) -> Segment:
        found = self._terms(self.tau)
        start = float(self.now.floats[TAU])
        return of_powers(start, self.tau - start, found)

    def land(self, tau: float) -> Segment:
        self.now.floats[STEP_END], self.now.ints[CROSSED] = tau, -1
        self.x = self._terms(tau).sum(axis=1)
        return self.segment()

    def _terms(self, tau: float) -> np.ndarray:
        return terms(self.room.c[: len(self.now.x)], tau - float(self.now.floats[TAU]))


class Holding:
    """Cuts steps of the loop to the part shown to follow the flow, and checks low flights."""

    def __init__(self, driver: Driver, tables: Tables) -> None:
        self.driver, self.tables = driver, tables
        self.longest = np.inf

    def hold(self, now: Now, room: Room, sums: Sums) -> None:
        """Check what the loop has just made against the flow.

        Raises
        ------
        FlowError
            If the run has used up the steps that it may check.
        """
        name, t = self.tables.fields[now.ints[FIELD]].name, float(now.floats[T])
        scene = self.driver.scene
        if now.ints[LOW_AHEAD]:
            self._low_flight(now, sums, name, t)
            return
        field = scene.field(name)
        defect = defect_of(field)
        if defect is None:
            return
        stepper = WatchfulStepper(self.driver.watchful, LoopStepper(now, room), defect, field, t)
        stepper.longest = self.longest if now.ints[MADE] else np.inf
        try:
            stepper.hold()
        except FlowError as fault:
            where = describe(scene, field, t + float(now.floats[TAU]), now.end)
            raise FlowError(f"{where}: {fault}") from None
        self.longest = stepper.longest

    def _low_flight(self, now: Now, sums: Sums, name: str, t: float) -> None:
        """Have a low flight flown by ordinary steps if its series does not follow the flow."""
        contact = self.tables.guards[now.ints[FIRED]].edge
        field = self.driver.scene.field(name, (contact,))
        made = pieces_of(int(now.ints[MADE]), sums.starts, sums.lengths, sums.series)
        now.ints[LOW_AHEAD] = 2 if follows(field, t, segments(made)) else 0
