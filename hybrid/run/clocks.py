"""Clocks in arcs that are flown in Python: which one rings, and when.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..lowering import Field, Guard
from ..lowering.automaton import DIRECTIONS
from ..rules.guards import GUARD_ROUNDING, TIE
from ..rules.zeros import EPS

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..trajectory.clock import Instant
    from .arc import Flown
    from .driver import Driver


def due(driver: Driver, field: Field, x: StateVector) -> tuple[Guard | None, float]:
    """The clock of a field that rings first from now on, and its time. A clock that has rung at
    this time rings later."""
    now, found = driver.record.now, []
    for clock in field.clocks:
        assert clock.after is not None
        before = now.t if clock.edge in driver.spent else float(np.nextafter(now.t, -np.inf))
        t = float(clock.after(before, x.tolist()))
        found.append((clock, t if now.until(t) >= 0 else float(clock.after(now.t, x.tolist()))))
    first = min(found, key=lambda each: each[1], default=(None, np.inf))
    return first if first[1] < np.inf else (None, np.inf)


def at_once(driver: Driver) -> bool:
    """Whether a clock rings before any flow, and before any other guard that fires then (4)."""
    clock, t = due(driver, driver.entry.field, driver.entry.x)
    if clock is None or driver.record.now.until(t) > 0:
        return False
    driver.renew()
    guards = (driver.entry.field.guards[index] for index in driver.entry.at_once)
    return not any(_precedes(driver, guard, clock) for guard in guards)


def _precedes(driver: Driver, guard: Guard, clock: Guard) -> bool:
    """Whether a guard's edge is declared before a clock; the end of a window precedes all edges."""
    names = [edge.name for edge in driver.scene.spec.transitions]
    own = guard.edge.partition(".")[0]
    return own not in names or names.index(own) < names.index(clock.edge)


def rings(
    driver: Driver, clock: Guard, t: float, fired: Guard | None, flown: Flown
) -> tuple[bool, Guard | None]:
    """Whether a clock rings at the end of an arc, or else the guard that fires there. Of those that
    are zero at one time, the edge declared first fires (4)."""
    end = driver.record.now.after(flown.length)
    if fired is not None:
        tied = not _precedes(driver, fired, clock) and is_zero(driver, fired, end, flown.x, t)
        return tied, fired
    for guard in driver.entry.field.guards:
        if _precedes(driver, guard, clock) and is_zero(driver, guard, end, flown.x, t):
            return False, guard
    return True, None


def is_zero(driver: Driver, guard: Guard, end: Instant, x: StateVector, t: float) -> bool:
    """Whether a guard that moves in its firing direction is zero at a time, and its condition
    holds. Zero is meant to spacings of the time and to the rounding of the guard."""
    value, rate, _ = guard.lie(end.t, x.tolist())
    size = driver.scene.rounding(guard, driver.entry.field)(end.t, x.tolist())[0]
    noise = TIE * np.spacing(abs(t)) * abs(rate) + GUARD_ROUNDING * EPS * size
    moves = rate * (DIRECTIONS[guard.crossing] or rate) > 0
    moves = moves and guard.holds(end.t, x.tolist())
    return bool(moves and abs(value) + abs(rate * end.until(t)) <= noise)
