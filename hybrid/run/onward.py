"""Runs that continue another run: what the new driver must know of the earlier one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.spec import Spec
from ..errors import OptionError
from ..lowering import Field, Scene
from ..lowering.automaton import DIRECTIONS
from ..rules.guards import GUARD_ROUNDING, TIE
from ..rules.zeros import EPS
from ..trajectory.arcs import Arc, JumpRow
from ..trajectory.clock import Instant
from ..trajectory.trajectory import Solution, Status
from .cycles import Columns
from .driver import Driver
from .entry import Entry, Jumped, side_before, signs_at_end
from .noting import note
from .truncate import HOLDING

if TYPE_CHECKING:
    from collections.abc import Callable

#: Jumps of the earlier run that are searched for cycles.
RECALLED = 256

#: The ends of a run that can be continued from.
OPEN_ENDS = Status.REACHED_END, Status.MAX_JUMPS, Status.INTERRUPTED


def require_end(run: Solution, spec: Spec, parameters: dict[str, Any], t: Any, given: Any) -> None:
    """Refuse to continue a run of another model, or one that did not end in a state to continue
    from.

    ``given`` are options that the earlier run determines.
    """
    why, (first, _) = run.differs(spec, parameters), t
    known = [name for name, value in given.items() if value is not None]
    if why:
        why += "; start from run.final, in mode=run.mode, to change the model"
    elif run.status not in OPEN_ENDS:
        why = f"the run has ended for good. {run.status}"
    elif first != run.t1:
        why = f"the run ended at t = {run.t1!r}; write t=(run.t1, ...), not {t!r}"
    elif known:
        why = f"{known[0]} is the run's own; leave it out, or start from run.final"
    elif run.log.ends_with_jump:
        why = "the run was interrupted in the middle of a jump; start it again"
    if why:
        raise OptionError(f"{spec.model}: the start is a run, which cannot go on: {why}")


def onward(driver: Driver, run: Solution) -> Callable[[], Jumped]:
    """Tell a driver about the earlier run; returns a function that says what is known of the
    start."""
    arc = run.parts[-1]
    assert isinstance(arc, Arc)
    if run.status is not Status.REACHED_END:
        driver.record.now = Instant(arc.t0, arc.low).after(arc.length)
    driver.seen = run.size
    driver.came = Jumped
    since = run.zeno[-1].t if run.zeno else -np.inf
    for place in sorted(run.own_jumps)[-RECALLED:]:
        part, row = run.parts[place], run.own_jumps[place]
        if isinstance(part, Arc) and part.t0 >= since and not row.edge.endswith(HOLDING):
            _recall(driver, run, place, part, row)
    return partial(_came, driver, run, arc)


def _recall(driver: Driver, run: Solution, place: int, arc: Arc, row: JumpRow) -> None:
    """Note a jump of the earlier run: it may belong to a series of impacts or a cycle."""
    scene = _scenes(driver, run)(place, arc.t1, "left")
    field, cycles = scene.field(arc.mode), driver.cycles
    guard = field.guard(row.edge)
    clock = cycles.clock(scene, field, guard, arc.t0, arc.first, arc.length)
    note(driver, Columns.of(row.edge, arc.mode, row.t, row.low, clock, row.after))
    there = scene.field(run.parts[place + 1].mode)
    driver.watch.interrupted(row.edge, field, there, row.t, row.before, row.after)
    if row.edge in driver.scene.contacts:
        driver.watch.saw(row.edge)
    else:
        driver.watch.contact = None
    driver.spent = frozenset((row.edge,)) | (frozenset() if arc.length else driver.spent)


def _came(driver: Driver, run: Solution, arc: Arc) -> Jumped:
    """What is known of a state at which a run ended within an arc."""
    driver.look(arc.last)
    if driver.scene.samples:  # on the piece that leads there
        driver.scene = driver.model.at(float(np.nextafter(driver.t, -np.inf)))
    row = run.own_jumps.get(len(run.parts) - 2)
    row = None if row and row.edge.endswith(HOLDING) else row  # as after an accumulation
    young = arc.length <= TIE * np.spacing(abs(arc.t0))
    driver.spent = (driver.spent if young and row else frozenset()) | _just_fired(driver, run)
    jumped = _after(driver, arc, run.parts[-2], row) if young and row else Jumped()
    if not arc.length:
        flown = next((part for part in reversed(run.parts) if part.t1 > part.t0), None)
        driver.tied = _tied(driver, flown) if row and isinstance(flown, Arc) else {}
        return attrs.evolve(jumped, held=arc.held, starting=not row)
    place = len(run.parts) - 1
    scenes = _scenes(driver, run)
    end = Entry(scenes(place, arc.t1, "left").field(arc.mode), arc.first, None, [], [])
    middle = 0.5 * arc.length if arc.segments else 0.0
    t, x = arc.t0 + (arc.low + middle), arc.local(middle)
    end.signs.extend(_signs(scenes(place, t, "left").field(arc.mode), t, x))
    signs = signs_at_end(end, arc.t1, arc.last, float(run.size.max()))
    signs = {g.edge: signs[g.edge] for g in end.field.guards if g.kind != "window"}
    return attrs.evolve(jumped, held=arc.held, passing=signs)


def _just_fired(driver: Driver, run: Solution) -> frozenset[str]:
    """The events and clocks that have fired where a run ended, but for the rounding of their
    guards, be it before an accumulation."""
    near = GUARD_ROUNDING * np.spacing(abs(driver.t))
    rows = takewhile(lambda row: driver.t - row.t <= near, reversed(run.own_jumps.values()))
    return frozenset(row.edge for row in rows) - driver.scene.contacts


def _scenes(driver: Driver, run: Solution) -> Callable[..., Scene]:
    """The scene at a time of a part of a run; of one from a file, which has seen no past, that of
    the model given."""
    if run.hindsight:
        return run.hindsight.at
    before = lambda t: float(np.nextafter(t, -np.inf))  # noqa: E731
    return lambda _, t, side="right": driver.model.at(before(t) if side == "left" else t)


def _signs(field: Field, t: float, x: Any) -> list[int]:
    """The sign of each guard within an arc; for one that is zero there, or looks at a past that is
    not at hand, its sign inside the domain."""
    values = [(guard, guard.value(t, x.tolist())) for guard in field.guards]
    return [int(np.sign(v)) if abs(v) > 0.0 else -DIRECTIONS[guard.crossing] for guard, v in values]


def _after(driver: Driver, arc: Arc, before: Any, row: JumpRow) -> Jumped:
    """What is known from the jump that the last arc began with."""
    scene, kept = driver.scene, driver.record.log.kept
    left = scene.field(before.mode)
    guard = left.guard(row.edge)
    kept.append(before)
    driver.arrive(scene.field(arc.mode), arc.first, guard, row.before)
    jumped = driver.came()
    kept.clear()
    return jumped


def _tied(driver: Driver, arc: Arc) -> dict[str, int]:
    """By edge, the sign of each guard that has reached zero at the end of an arc without firing."""
    found, t, x, field = {}, arc.t1, arc.last.tolist(), driver.scene.field(arc.mode)
    for guard in field.guards:
        size = driver.scene.rounding(guard, field)(t, x)[0]
        value, rate, bend = guard.lie(t, x)
        noise = GUARD_ROUNDING * EPS * size
        if guard.edge not in driver.spent and abs(value) <= noise and rate:
            found[guard.edge] = side_before(rate, bend, noise)
    return found
