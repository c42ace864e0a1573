"""The compiled loop with delays: windows of the past, and how arcs go on from one to the next."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..rules import unit
from ..rules.places import (
    BEGAN,
    END,
    ENTERED,
    FULL,
    GOES_ON,
    GUARD_POWER,
    IN_ARC,
    JUMP,
    JUMPS_MADE,
    LAST_TIME,
    LOOK,
    LOW,
    LOW_AHEAD,
    MADE,
    NO_ROOM,
    PHASE,
    STEPS_DONE,
    TAU,
    WALKS,
    WINDOW,
    T,
)
from .entry import holding

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..delay.memory import Memory
    from ..rules.arrays import Left
    from ..trajectory.log import Steps
    from .machine import Machine


def looked_back(machine: Machine, left: Left) -> int:
    """Call the loop with the record of the past."""
    memory, now, (room, sums, look) = machine.driver.record.memory, machine.now, machine.rooms.work
    assert machine.past is not None
    assert memory is not None
    automaton, links = machine.past.linked()
    past, shown = memory.past(links), memory.shown.tobytes()
    if not memory.bound or links is not machine.links:
        unit("past").bound(automaton, now, room, past)
        machine.links, memory.bound = links, True
    machine.run[LAST_TIME] = memory.until
    if machine.windowed:
        return int(unit("runs").go(automaton, machine.run, now, room, left, sums, look))
    go = unit("past").look_back
    status = int(go(automaton, machine.run, now, room, left, sums, look, past))
    if status == NO_ROOM:
        memory.make_room(machine.driver.t)
        return looked_back(machine, left)
    memory.told = True
    if memory.shown.tobytes() != shown:
        machine.driver.scene, memory.bound = memory.read(), True
    return status


def at_window(machine: Machine, left: Left, status: int) -> bool:
    """Whether the loop has stopped where windows of the past end and a guard is zero; if so, the
    arc is recorded up to there, and the guard fires before they are passed (9)."""
    driver, memory = machine.driver, machine.driver.record.memory
    if status != END or memory is None or memory.until >= machine.plan.t1:
        return False
    assert machine.past is not None
    (automaton, links), room = machine.past.linked(), machine.rooms.work[0]
    if not unit("past").fires_there(automaton, machine.now, room, memory.past(links)):
        return False
    place, tau = int(machine.ints[JUMPS_MADE]), float(machine.floats[TAU])
    steps, made = machine.flown_in(left, place, place + 1)
    segments = steps.segments(np.array([tau])) if steps and machine.dense else []
    driver.steps += made
    driver.passed(tau)
    entry, end = driver.entry, machine.now.end.copy()
    x = driver.record.extend(entry.field, entry.x, end, tau, segments)
    memory.told = False
    driver.entry = attrs.evolve(driver.entry, field=driver.field, x=x)
    driver.pass_window(None, x)
    return True


def passes(machine: Machine, left: Left, status: int) -> int:
    """With delays: pass to the next windows of the past; returns the status, ``GOES_ON`` if the
    loop is to be called again.

    If an arc that has passed windows must be examined, it is recorded up to the last of them.
    """
    driver, place = machine.driver, int(machine.ints[JUMPS_MADE])
    memory = driver.record.memory
    if memory is None:
        return status
    if machine.windowed:
        return _passes_window(machine, left, status, memory)
    if status in (LOOK, WINDOW) and memory.ints[IN_ARC] == place:
        last, tau, x = int(memory.ints[STEPS_DONE]), float(memory.floats[BEGAN]), memory.start
        steps, made = machine.kept.take_until(left, last, place, tau)
        driver.steps += made
        edges = (guard.edge for guard in driver.entry.field.guards)
        _through(machine, tau, x, steps, dict(zip(edges, memory.signs.tolist(), strict=False)))
        memory.ints[IN_ARC] = -1
    if status == WINDOW:
        memory.told = False
        driver.scene = memory.look(driver.t, driver.entry.x)
    elif status == LOOK:
        memory.told = False
        memory.pieces.back_to(driver.t)
        if memory.ends(driver.t):
            memory.passed(driver.t, driver.entry.x, driver.entry.field)
            driver.look(driver.entry.x)
    return GOES_ON if status == WINDOW else status


def _passes_window(machine: Machine, left: Left, status: int, memory: Memory) -> int:
    """The same where the loop comes back at the end of each window: with another solver's
    steps, and for lags that move, whose windows end where a guard fires."""
    driver, place, fired = machine.driver, int(machine.ints[JUMPS_MADE]), None
    if status == FULL and place and machine.plan.memory == "restart":
        guard = machine.tables.guards[left.fired[0]]
        here = guard.edge, driver.entry.field.name, driver.entry.x
        off = guard.kind == "contact" and driver.parted(*here)
        if guard.kind == "edge" or off:  # through what is seen now it may not be zero
            machine.ints[GUARD_POWER] = machine.ints[LOW_AHEAD] = 0
    if status == JUMP and machine.fired.kind == "window":
        fired = machine.fired.edge
    if not fired and (status != END or memory.until >= machine.plan.t1):
        return status
    steps, made = machine.flown_in(left, place, place + 1)
    driver.steps += made
    before, tau, x = driver.field.guards, float(machine.floats[TAU]), machine.now.end.tolist()
    now = driver.record.now.after(tau)
    signs = {g.edge: 1 if g.edge == fired else int(np.sign(g.value(now.t, x))) for g in before}
    signs |= holding(driver.entry.field)
    _through(machine, tau, machine.now.end, steps, signs)
    memory.passed(driver.t, driver.entry.x, driver.entry.field, fired)
    driver.look(driver.entry.x)
    machine.tell(0.0, left)
    if driver.steps >= machine.plan.max_steps:
        return FULL
    machine.ints[ENTERED], machine.now.orders[:] = 1, 0
    x = driver.entry.x.tolist()
    kept = (g.value(driver.t, x) * signs[g.edge] > 0 for g in driver.field.guards)
    return GOES_ON if all(kept) else LOOK


def _through(
    machine: Machine, tau: float, x: StateVector, steps: Steps | None, signs: dict[str, int]
) -> None:
    """Record the current arc up to the place where the next windows of the past begin."""
    driver = machine.driver
    segments = steps.segments(np.array([tau])) if steps and machine.dense else []
    x = driver.record.extend(driver.entry.field, driver.entry.x, x.copy(), tau, segments)
    driver.go_on_through(signs, x)
    now = driver.record.now
    machine.floats[T], machine.floats[LOW], machine.floats[TAU] = now.t, now.low, 0.0
    machine.now.x[:], machine.now.end[:], machine.now.seen[:] = x, x, driver.seen
    if machine.ints[PHASE] == WALKS:
        machine.ints[MADE], machine.ints[ENTERED] = 1, 0
