"""The jumps that the compiled loop hands back: resets, releases, impacts and low flights.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign
from typing import TYPE_CHECKING

import numpy as np

from ..automaton.chance import DRAWS
from ..automaton.markers import TERMINATE
from ..bounds.defect import follows
from ..errors import DomainError, FlowError, JumpLoopError
from ..lowering import Contact, Field, Guard, released
from ..rules import unit
from ..rules.guards import GUARD_ROUNDING, NEAR
from ..rules.places import PULLED, RISES
from ..rules.zeros import EPS
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Status
from ..zeno.accumulate import hop
from . import clocks, switch
from .accumulations import accumulate
from .entry import (
    Entry,
    Jumped,
    before_impact,
    beyond_kinks,
    extent,
    jumped_over,
    opened,
    zero_within,
)
from .limits import pass_limit
from .noting import add_jump

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .driver import Driver


def carry_out(driver: Driver, guard: Guard, x: StateVector, carried: bool = False) -> None:
    """Carry out the jump of a guard that fired; ``carried``: it jumped over zero."""
    for signs in (driver.tied, driver.touched):
        signs.pop(guard.edge, None)
    driver.spent |= {guard.edge} | clocks.failing(driver, x)
    memory = driver.record.memory
    if memory is not None and guard.kind in ("edge", "contact") and memory.misses(driver.t, x):
        driver.scene = memory.look(driver.t, x)
    if guard.kind == "contact":
        _impact(driver, guard, x, carried)
    elif guard.kind == "release":
        _release(driver, guard, x, carried)
    elif guard.kind == "switch":
        switch.meet(driver, guard, x, carried)
    elif guard.kind == "leave":
        switch.leave(driver, guard, x, carried)
    elif guard.kind == "window":
        driver.pass_window(guard, x)
    else:
        _reset(driver, guard, x, carried)


def _reset(driver: Driver, guard: Guard, before: StateVector, carried: bool) -> None:
    t = driver.t
    after = np.array(driver.scene.reset(guard.edge)(t, before.tolist()))
    _require_finite(driver, guard.edge, before, after)
    came = came_by(driver, guard, before, after, carried)
    back = came.set_off and is_back(driver, guard, before)
    off = back or has_jumped(driver, guard, before)
    if carried or driver.forgets or off:
        came.vanishing = {}
    if came.used is None:
        driver.spent -= {guard.edge}
    came.held = driver.still_held(guard.to, after)
    if guard.to == TERMINATE:
        add_jump(driver, guard.edge, before, after)
        driver.status, driver.mode = Status.TERMINATED, driver.entry.field.mode
        return
    driver.interrupt(guard.edge, driver.scene.name(guard.to, came.held), before, after)
    if not (add_jump(driver, guard.edge, before, after) and pass_limit(driver, guard.to)):
        driver.enter(guard.to, after, came)


def came_by(
    driver: Driver, guard: Guard, before: StateVector, after: StateVector, carried: bool
) -> Jumped:
    """What a reset tells about the state after it: whether its guard has kept its value, whether
    the guard still moves in the same direction, and whether it has been ``carried`` over zero and
    still is beyond. An urgent edge that has fired beyond zero is none that was just used: where its
    reset leads the guard to zero, it has come there."""
    here, there = (guard.lie(driver.t, x.tolist()) for x in (before, after))
    onwards = here[1] * there[1] > 64 * EPS * here[1] * here[1]
    beyond = guard.urgent and has_jumped(driver, guard, before)
    known = {guard.edge: 1} if here[0] == there[0] and not beyond else {}
    off = driver.beyond_by if carried and here[0] * there[0] > 0 else 0.0
    used, set_off = None if beyond else guard.edge, puts_off(driver, guard, before, here, there[0])
    beyond_by = copysign(off, there[0])
    return Jumped(known, used=used, set_off=set_off, onwards=bool(onwards), beyond_by=beyond_by)


def is_back(driver: Driver, guard: Guard, x: StateVector) -> bool:
    """Whether a guard that fires before any flow is off zero: it comes there in a time that
    rounding hides."""
    if not driver.entry.at_once:
        return False
    size = extent(driver.scene, guard, driver.entry.field, driver.t, x, driver.seen)[0]
    return bool(abs(guard.value(driver.t, x.tolist())) > NEAR * size)


def puts_off(
    driver: Driver, guard: Guard, x: StateVector, here: Sequence[float], after: float
) -> bool:
    """Whether the reset of a guard, which has value and rate ``here`` and is ``after`` behind it,
    puts it off zero by more than it was: from where it is zero, too, the short way on along the
    flow. A reset that leaves the guard as it is, or shares what is left of it, does not."""
    t, value, rate = driver.t, here[0], here[1]
    if NEAR * abs(after) > abs(value) or not rate:
        return True
    there = x - value / rate * driver.entry.field.flow(t, x)
    again = driver.scene.reset(guard.edge)(t, there.tolist())
    return bool(abs(guard.value(t, list(again))) > NEAR * abs(value))


def has_jumped(driver: Driver, guard: Guard, x: StateVector) -> bool:
    """Whether a guard that fired is off zero: it jumps up there, as a saw does, or is urgent."""
    if not (guard.jumps or guard.urgent):
        return False
    size = driver.scene.rounding(guard, driver.entry.field)(driver.t, x.tolist())[0]
    return bool(abs(guard.value(driver.t, x.tolist())) > NEAR * size)


def _release(driver: Driver, guard: Guard, x: StateVector, carried: bool) -> None:
    field = driver.entry.field
    contact = released(guard.edge)
    held = tuple(name for name in field.held if name != contact)
    driver.interrupt(guard.edge, driver.scene.name(field.mode, held), x, x)
    add_jump(driver, guard.edge, x, x)
    pulled = carried or (driver.forgets and not _bears_nothing(driver, guard, x))
    known = {contact: PULLED if pulled else RISES}  # the load is negative, not zero
    if carried and opened(driver.scene, field.mode, contact, driver.place, x):
        known = {}
    driver.enter(field.mode, x, Jumped(known, held))


def _bears_nothing(driver: Driver, guard: Guard, x: StateVector) -> bool:
    """Whether the load of a release is still zero, to its rounding, through the past that begins
    anew behind it."""
    driver.look(x)
    field = driver.scene.field(driver.entry.field.name)
    load, state = field.guard(guard.edge), x.tolist()
    size = float(driver.scene.rounding(load, field)(driver.t, state)[0])
    return abs(load.value(driver.t, state)) <= GUARD_ROUNDING * EPS * size


def _impact(driver: Driver, guard: Guard, x: StateVector, carried: bool) -> None:
    if carried and jumped_over(driver.scene, driver.entry.field, guard, driver.place, x):
        gap = guard.value(driver.t, x.tolist())
        raise DomainError(
            f"{driver.where(x)}: the gap of {guard.edge} jumps to {gap:.6g}, and the state does "
            "not; a gap must not jump below zero"
        )
    contact = driver.scene.contact(guard.edge)
    before = np.array(contact.land(driver.t, x.tolist()))
    driver.record.end_on(before)
    _require_one_speed(driver, guard, before)
    *state, speed = contact.impact(driver.t, before.tolist())
    after = np.array(state)
    _require_finite(driver, guard.edge, before, after)
    if speed < 0:
        raise FlowError(
            f"{driver.where(before)}: the restitution of {guard.edge} gives the speed "
            f"{speed:.6g} after the impact; it must not be negative"
        )
    bounce(driver, guard, before, after, speed)


def _require_one_speed(driver: Driver, guard: Guard, x: StateVector) -> None:
    """Refuse a gap whose formula at zero differs from the one on the side it is reached from.

    The first impact of a contact shows it. A gap with a corner at zero, as a distance has, is
    checked again wherever a flight may have come from the other side.
    """
    field, t = driver.entry.field, driver.t
    there = driver.scene.field(field.name, (guard.edge,))
    if not guard.kinks or (there is field and guard.edge in driver.struck):
        return
    driver.struck.add(guard.edge)
    back, beside = before_impact(driver.scene, field, guard, t, x)
    came = guard.lie(back, beside.tolist())[1]
    _, here, bend = there.guards[field.column(guard.edge)].lie(t, x.tolist())
    if not abs(here - came) <= NEAR * abs(came) + 2.0 * abs(bend) * (t - back):
        raise FlowError(
            f"{driver.where(x)}: the gap of {guard.edge} changes its formula where it is zero: "
            f"its speed there is {here:.6g}, and was {came:.6g} just before; write the formula "
            "that holds where the gap is positive"
        )


def bounce(
    driver: Driver, guard: Guard, before: StateVector, after: StateVector, speed: float
) -> None:
    """Record an impact, and the impacts after low flights, then begin the next arc."""
    while True:
        held = driver.still_held(guard.to, after)
        after = driver.closed(guard.to, held, after)
        mode = driver.scene.name(guard.to, held)
        driver.interrupt(guard.edge, mode, before, after)
        driver.watch.saw(guard.edge)
        due = add_jump(driver, guard.edge, before, after)
        driver.mode = mode
        contact = driver.scene.contact(guard.edge)
        if driver.status is not None:
            return
        if driver.tied:  # another edge fires at this time
            break
        if accumulate(driver, contact, after, speed, driver.mode):
            return
        if due and pass_limit(driver, guard.to):
            return
        low = low_flight(driver, contact, after, speed, driver.mode)
        if low is None:
            break
        before, after, speed = low
        driver.touched = _near_zero(driver, before)
    last = driver.record.log.kept[-1]
    known = driver.leaves(guard.edge, driver.mode, after, 1 if speed > 0 else 2)
    series = driver.watch.count > 1 and isinstance(last, Arc) and last.length > 0
    driver.enter(guard.to, after, Jumped(known, held, series=series))


def _near_zero(driver: Driver, x: StateVector) -> dict[str, int]:
    """By edge, the sign of its guard at the end of a low flight, if it is zero but for rounding: a
    flight in which none comes nearer to zero."""
    found, scene, field, t = dict[str, int](), driver.scene, driver.entry.field, driver.t
    near = NEAR * driver.reach(x)
    for guard in (guard for guard in field.guards if guard.kind in ("edge", "switch")):
        value = guard.value(t, x.tolist())
        if abs(value) <= near and abs(value) <= zero_within(scene, guard, field, t, x, driver.seen):
            found[guard.edge] = int(np.sign(value))
    return found


def _require_series(driver: Driver, contact: str, x: StateVector, field: Field) -> None:
    """Refuse a series of impacts that cannot be summed because the flow has no Taylor series."""
    if field.jets is None and driver.watch.count > 1:
        raise JumpLoopError(
            f"{driver.where(x)}: the impacts of {contact} accumulate, and cannot be summed: "
            f"{field.refused}; near the contact it must be a smooth function of a few numbers"
        )


def low_flight(
    driver: Driver, contact: Contact, x: StateVector, v: float, name: str
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Fly so low that the gap is comparable to the rounding of the state (7).

    The flight follows its Taylor series, in which gap and gap speed are coordinates of their own.
    Returns the states before and after the next impact and the gap speed after it; None where the
    flight is higher, or begins off the obstacle, or another guard comes near zero.
    """
    if driver.parted(contact.name, name, x):
        return None
    field, t, reach = driver.scene.field(name, (contact.name,)), driver.t, driver.reach(x)
    column = field.column(contact.name)
    guard = field.guards[column]
    there = beyond_kinks(field, (*guard.kinks, *field.changes), t, x)
    force = guard.lie(there[0], there[1].tolist())[2]
    if not unit("hops").drowns(v, force, reach):
        return None
    if unit("hops").drowns(v, force, NEAR * reach):  # a dozen digits of the gap are rounding
        _require_series(driver, contact.name, x, field)
    flown = hop(field, contact, column, t, x, v, GUARD_ROUNDING * EPS * reach)
    until = driver.until(driver.known, field, x)
    if flown is None or driver.record.now.after(flown[0]).until(until) < 0:
        return None
    time, segments, before, after, speed = flown
    if contact.name in driver.scene.spec.chances:
        after[driver.scene.spec.place(DRAWS)] += 1.0
    if driver.wary and not follows(field, t, segments):
        return None
    driver.record.arc(field, x, before, time, segments)
    driver.entry = Entry(field, before, None, [], [])
    return before, after, speed


def _require_finite(driver: Driver, edge: str, before: StateVector, after: StateVector) -> None:
    if not np.isfinite(after).all():
        state = driver.scene.spec.record(after)
        raise FlowError(f"{driver.where(before)}: the reset of {edge} gives {state}")
