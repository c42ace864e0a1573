"""Clocks in arcs that are flown in Python: which one rings, and when.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..lowering import Field, Guard
from ..trajectory.clock import Instant
from .entry import Jumped, is_zero, just_left, signs_at_end
from .knots import let_go, pass_knot

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
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
    clock, t = due(driver, driver.field, driver.entry.x)
    if clock is None or driver.record.now.until(t) > 0:
        return False
    driver.renew()
    guards = (driver.entry.field.guards[index] for index in driver.entry.at_once)
    if any(_precedes(driver, guard, clock) for guard in guards):
        return False
    if clock.holds(t, driver.entry.x.tolist()):
        return True
    driver.spent |= {clock.edge}
    return at_once(driver)


def first(driver: Driver, t: float, x: StateVector) -> Guard | None:
    """Of the clocks that ring at the end of an arc the first whose condition holds; None where
    there is no such."""
    found = (clock for clock in driver.field.clocks if _rings_at(driver, clock, t, x))
    return next((clock for clock in found if clock.holds(t, x.tolist())), None)


def failing(driver: Driver, x: StateVector) -> set[str]:
    """The clocks that ring now, and whose conditions fail: their time is over."""
    t = driver.t
    found = (clock for clock in driver.field.clocks if clock.when is not None)
    return {
        clock.edge
        for clock in found
        if _rings_at(driver, clock, t, x) and not clock.holds(t, x.tolist())
    }


def _rings_at(driver: Driver, clock: Guard, t: float, x: StateVector) -> bool:
    """Whether a clock that has not rung there rings at a time."""
    assert clock.after is not None
    before = float(np.nextafter(t, -np.inf))
    rung = clock.edge in driver.spent and driver.record.now.until(t) <= 0
    return not rung and float(clock.after(before, x.tolist())) == t


def go_by(driver: Driver, t: float, x: StateVector) -> None:
    """Go on within an arc behind a time of clocks whose conditions fail, where the run is."""
    memory, entry = driver.record.memory, driver.entry
    driver.record.now = Instant(t)
    over = driver.spent | failing(driver, x)
    if memory is not None and memory.ends(t):
        memory.passed(t, x, entry.field)
    if memory is None and driver.scene.until <= t:
        pass_knot(driver, t, x)
    elif not (entry.field.leaps and let_go(driver, t, x)):
        signs, known = signs_at_end(entry, t, x, driver.reach(x)), driver.vanishing
        driver.enter(entry.field.mode, x, Jumped(known, entry.field.held, passing=signs))
    driver.spent |= over


def _precedes(driver: Driver, guard: Guard, clock: Guard) -> bool:
    """Whether a guard's edge is declared before a clock; the end of a window precedes all edges."""
    names = [edge.name for edge in driver.scene.spec.transitions]
    own = guard.edge.partition(".")[0]
    return own not in names or names.index(own) < names.index(clock.edge)


def rings(
    driver: Driver, t: float, fired: Guard | None, flown: Flown, x: StateVector
) -> tuple[Guard | None, Guard | None, bool]:
    """The clock that fires where an arc ends, which goes no further than the time at which one
    rings, at a state; else the guard that fires there: of those that are zero at one time that of
    the edge declared first (4). Then whether that time is the clock's."""
    field = driver.entry.field
    clock = first(driver, t, field.at_end(t, x))
    if fired is not None and _before(driver, fired, flown, t, x):
        return None, fired, False
    there = (g for g in field.guards if g is fired or _comes(driver, g, x, t))
    guard = next(there, None)
    if clock is None or (guard is not None and _precedes(driver, guard, clock)):
        return None, guard, True
    return clock, None, True


def _comes(driver: Driver, guard: Guard, x: StateVector, t: float) -> bool:
    """Whether a guard comes to zero where a clock rings."""
    return is_zero(driver, guard, Instant(t), x, t) and not just_left(driver, guard, x, t)


def _before(driver: Driver, fired: Guard, flown: Flown, t: float, x: StateVector) -> bool:
    """Whether a guard that fired is not zero any more where a clock rings; or it may be, as one
    that moves slowly is for long, but another fires between."""
    if not is_zero(driver, fired, Instant(t), x, t):
        return True
    end = driver.record.now.after(flown.length).t
    for guard in driver.entry.field.guards:
        crosses = guard.value(end, flown.x.tolist()) * guard.value(t, x.tolist()) < 0
        if crosses and guard is not fired and not is_zero(driver, guard, Instant(t), x, t):
            return True
    return False
