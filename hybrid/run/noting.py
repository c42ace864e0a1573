"""Records jumps, and tells when it is time to look for a cycle of them that accumulates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..rules.lanes import FEW_TURNS
from ..trajectory.arcs import Arc
from ..trajectory.log import Flights
from ..trajectory.trajectory import Status
from .cycles import Columns
from .entry import describe

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Numbers, StateVector
    from .driver import Driver


def add_jump(driver: Driver, edge: str, before: StateVector, after: StateVector) -> bool:
    """Record a jump; returns whether to look for a cycle. Ends the run at ``max_jumps``."""
    memory = driver.record.memory
    if memory is not None and memory.ends(driver.t):
        memory.passed(driver.t, before, driver.entry.field)
    now, field, last = driver.record.now, driver.entry.field, driver.record.log.kept[-1]
    guard = next((guard for guard in field.guards if guard.edge == edge), None)
    clock = now.t - driver.cycles.spent
    if isinstance(last, Arc) and guard is not None:
        clock = driver.cycles.clock(driver.scene, field, guard, last.t0, last.first, last.length)
    driver.record.jump(edge, before, after, driver.where, clock)
    driver.look(after)
    if driver.record.made >= driver.plan.max_jumps:
        driver.status = Status.MAX_JUMPS
    return note(driver, Columns.of(edge, field.name, now.t, now.low, clock, after))


def note(driver: Driver, jumps: Columns) -> bool:
    """Add jumps to the search for cycles; returns whether to look. A clock starts it anew."""
    if jumps.edge[-1] in driver.ringing:
        driver.cycles.forget()
        return False
    return driver.cycles.saw(jumps)


def room(driver: Driver, t: Numbers, low: Numbers, rung: Integers) -> int:
    """How many jumps at these times may be recorded before a cycle has to be looked for.

    ``rung``: the places of those made by clocks, behind each of which the search begins anew.
    """
    most, begins, ends = len(t), np.append(0, rung + 1), np.append(rung, len(t))
    seen = np.append(len(driver.cycles.seen.t), np.zeros(len(rung), dtype=int))
    cycles = np.flatnonzero((ends > begins) & (seen + ends - begins > FEW_TURNS))
    if len(cycles) and driver.plan.zeno != "ignore":  # by that no limit is passed anywhere
        first, last = int(begins[cycles[0]]), int(ends[cycles[0]])
        most = first or driver.cycles.room(t[:last], low[:last])
    return min(driver.plan.max_jumps - driver.record.made, most)


def flown(driver: Driver, flights: Flights) -> bool:
    """Record jumps of the compiled loop, no more than :func:`room` allows; returns whether to look
    for a cycle."""
    jumps = flights.jumps

    def where(k: int) -> str:
        field = driver.scene.field(flights.modes[k])
        return describe(driver.scene, field, float(jumps.t[k]), jumps.before[k])

    clocks = _clocks(driver, flights)
    driver.record.flights(flights, where, clocks)
    lengths = flights.lengths.tolist()
    last = next((k for k in range(len(lengths) - 1, 0, -1) if lengths[k]), 0)
    driver.passed(lengths[last])
    driver.touched = {}
    driver.spent = driver.spent.union(jumps.edge[last:])
    driver.seen = np.maximum(driver.seen, np.maximum.reduce(np.abs(jumps.after)))
    memory = driver.record.memory
    if memory is not None and memory.ends(driver.t):
        memory.passed(driver.t, jumps.before[-1], driver.own.field(flights.mode))
    driver.look(jumps.after[-1])
    if driver.record.made >= driver.plan.max_jumps:
        driver.status = Status.MAX_JUMPS
    times = jumps.t, jumps.low, clocks
    return note(driver, Columns(jumps.edge, flights.modes, *times, jumps.after))


def _clocks(driver: Driver, flights: Flights) -> Numbers:
    """The time of each jump, less that spent in idle flights (see :func:`.cycles.idle`)."""
    if driver.cycles.plain(flights.lengths):
        return flights.jumps.t - driver.cycles.spent
    jumps, clocks = flights.jumps, []
    times, states = [flights.t, *jumps.t.tolist()], [flights.x, *jumps.after]
    lengths = flights.lengths.tolist()
    for mode, edge, *start in zip(flights.modes, jumps.edge, times, states, lengths, strict=False):
        memory, scene = driver.record.memory, driver.scene.at(start[0])
        if memory is not None:
            with memory.as_at(*start[:2]) as then:
                scene = then.scene
        field = scene.field(mode)
        guard = field.guard(edge)
        clocks.append(driver.cycles.clock(scene, field, guard, *start))
    return np.array(clocks)
