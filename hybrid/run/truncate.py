"""At most N impacts, then held: section 2 of *Analysis of Impact Chattering*.

The paper lets the body fall under its flow alone after the last permitted impact; without a
contact force it would sink. Here the contact is held, and the distance to the full series
is measured by a run of its own.
"""

from __future__ import annotations

from fractions import Fraction
from math import fsum
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..lowering import Contact, Field
from ..segment import nodes
from ..trajectory.accumulation import Accumulation, Truncation
from ..trajectory.arcs import Arc, Part, TailPart
from ..zeno.flight import rise
from .entry import Jumped
from .noting import add_jump

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .driver import Driver

#: What is put to a contact's name for the jump that holds it.
HOLDING = ".hold"

#: Impacts of a sum whose speed is this share of the first or less lead to no higher flight: heights
#: fall like the square of the speeds, unless the force falls to a hundredth on the way.
FALLEN = 0.1


def permitted(r: float) -> int:
    """``[1/r]`` from the simplest fraction that rounds to ``r``, so that 1/93 gives 93; never
    less than the one impact that there has been."""
    return max(int(1 / Fraction(r).limit_denominator(10**6)), 1) if r > 1e-6 else 10**6


def hold(driver: Driver, contact: Contact, x: StateVector, field: Field) -> bool:
    """Hold the contact if its series has used up its impacts and the obstacle pushes."""
    t, record = driver.t, driver.record
    ratio = contact.law(t, x.tolist(), -0.0)
    cap = driver.plan.cap or permitted(ratio)
    pushed = field.guards[field.column(contact.name)].lie(t, x.tolist())[2] < 0
    if driver.watch.count < cap or not pushed or not contact.rests:
        return False
    cut = Truncation(cap, *_left_out(driver, contact, x, field))
    held = (*field.held, contact.name)
    after = driver.scene.field(driver.scene.name(field.mode, held))
    assert after.project is not None
    still = np.array(after.project(t, x.tolist()))
    record.arc(field, x, x, 0.0, [])
    state, edges = driver.scene.spec.record(still), (contact.name,)
    point = Accumulation(t, state, ratio, edges, "truncated", after.name, record.j)
    point.truncation = cut
    record.limit_point(point, None)
    driver.watch.over(edges)
    add_jump(driver, contact.name + HOLDING, x, still)
    driver.enter(field.mode, still, Jumped(held=held))
    return True


def _left_out(
    driver: Driver, contact: Contact, x: StateVector, field: Field
) -> tuple[float, float, float]:
    """``t_inf`` of the full series, the time from here to it, and its greatest height.

    The time is the sum of the flights, and the height is measured by a gap that is a coordinate of
    its own: both stay accurate below the spacing of floats around ``t`` and ``x``. A jump of
    another edge ends the series: what accumulates after it is not its limit.
    """
    plan = attrs.evolve(driver.plan, zeno="stop", progress=None, dense=True, samples=None)
    full = type(driver)(driver.model, driver.solver, plan)
    full.scene = driver.scene
    memory = driver.record.memory
    full.record.memory = memory.fork() if memory is not None else None
    full.record.now = driver.record.now
    full.watch.saw(contact.name)
    column = field.column(contact.name)
    full.fly_on(field, field.guards[column], x)
    full.go_on()
    parts, jumps = full.record.log.apart()
    others = [place for place, jump in jumps.items() if jump.edge != contact.name]
    series = parts[: min(others, default=len(parts)) + 1]
    height = max(_height(arc, field, column) for part in series for arc in _highest(part))
    if others or not full.record.zeno or full.record.zeno[0].edges != (contact.name,):
        return float("nan"), float("nan"), height
    lengths = [p.tail.remaining if isinstance(p, TailPart) else p.length for p in series]
    return full.record.zeno[0].t, fsum(lengths), height


def _highest(part: Part) -> list[Arc]:
    """The flights of a part among which the highest is."""
    if not isinstance(part, TailPart):
        return [part]
    lasts = part.tail.r ** np.arange(part.tail.count + 1)
    return [part.arc(n) for n in range(int(np.sum(lasts >= FALLEN)))]


def _height(arc: Arc, field: Field, column: int) -> float:
    """How far the gap opens on a flight."""
    guard, x = field.guards[column], arc.first.tolist()
    height = rise(field, column, arc.t0, x, guard.lie(arc.t0, x)[1])
    if height is not None:
        return height
    low, high = 0.0, arc.length
    for _ in range(4):  # each time 64 points around the highest
        at = low + (high - low) * nodes(64)
        states = zip(at.tolist(), arc.local(at).tolist(), strict=True)
        gaps = [guard.value(arc.t0 + s, y) for s, y in states]
        best = int(np.argmax(gaps))
        low, high = at[max(best - 1, 0)], at[min(best + 1, 64)]
    return max(gaps)
