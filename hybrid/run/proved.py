"""What Python answers when the compiled loop asks for the proof of a sum of impacts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..rules.places import (
    AT_LIMIT,
    CURVE_ROWS,
    ERRORS,
    FIELD,
    FIRED,
    JUMPS_MADE,
    PROVED,
    TAILS,
    TRIED,
)
from ..zeno.accumulate import Tail
from .accumulations import passes_nothing

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Contact, Field
    from ..rules.arrays import Left
    from .machine import Machine


def proves(machine: Machine, left: Left) -> bool:
    """Whether the loop can go on at a sum that bounds in double precision do not decide: it is
    proved, or is none yet. Where steps come to be watched, which are of another order, the driver
    begins them."""
    driver, seen, now = machine.driver, machine.present, machine.instant
    contact = machine.tables.guards[int(machine.ints[FIRED])].edge
    name = machine.tables.fields[int(machine.ints[FIELD])].name
    since = now.t, now.low, left.after[int(machine.ints[JUMPS_MADE])].copy()
    field = seen.field(name, (contact,))
    tail = tail_of(left, int(machine.ints[TAILS]), field, seen.contact(contact), since)
    wary = driver.wary
    if passes_nothing(driver, tail):
        machine.ints[PROVED] = 1
    else:
        machine.floats[TRIED] = tail.v
    return driver.wary == wary


def tail_of(
    left: Left, place: int, field: Field, contact: Contact, since: tuple[float, float, StateVector]
) -> Tail:
    """A sum of impacts; ``since``: time, in two floats, and state of its first impact."""
    rows = left.curves[place * CURVE_ROWS :][:CURVE_ROWS].copy()
    _, degree, v, r, remaining = left.sums[place].tolist()
    errors, x_inf = rows[ERRORS, :-1], rows[AT_LIMIT, :-2]
    curve = r, rows[: int(degree) + 1], remaining, x_inf, float(errors[0]), errors[1:]
    t, low, x = since
    return Tail(field, contact, field.column(contact.name), t, low, x, v, *curve)
