"""What follows an accumulation point, of the impacts of one contact or of a cycle of jumps."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..automaton.chance import DRAWS
from ..errors import JumpLoopError
from ..lowering import Contact, Field, Guard
from ..rules import unit
from ..rules.entries import LIMIT_SPEED, POSITION_ROUNDING
from ..rules.guards import GUARD_ROUNDING
from ..rules.sums import LEAST_LOSS
from ..rules.zeros import EPS
from ..segment import straight
from ..trajectory.accumulation import Accumulation
from ..trajectory.arcs import TailPart
from ..trajectory.plan import PATIENCE
from ..trajectory.trajectory import Status
from ..zeno.accumulate import Tail, clear, close
from ..zeno.cycle import CycleLimit
from ..zeno.narrow import law_error, seen
from ..zeno.others import apart
from . import truncate
from .entry import Entry, Jumped, expand
from .growth import grown
from .tightening import tighten

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..automaton.shapes import StateVector
    from .driver import Driver

#: The length of a flight, relative to that of its series of impacts, from which on the series is at
#: its limit: as many flights again as a double has digits for would not show in the time.
LAST_FLIGHT = EPS * EPS

#: The share of the force onto a contact that must be left at the limit of impacts which rounding
#: has brought to rest: what is left of them then lasts at most twice as long as under that force.
LASTING_PULL = 0.5

#: The length of a flight, in roundings of the time, below which the steps of another solver do not
#: show where in it the flow changes its formula.
RESOLVED_TIMES = 64.0


def accumulate(driver: Driver, contact: Contact, x: StateVector, v: float, name: str) -> bool:
    """Sum all impacts from here on, or cut the series off; False if the run goes on unchanged.

    ``name``: the mode and its held contacts.
    """
    watch = driver.watch
    field = driver.scene.field(name, (contact.name,))
    if driver.plan.zeno == "truncate":
        return truncate.hold(driver, contact, x, field)
    if contact.name in driver.scene.spec.chances:
        return _settles(driver, contact, x, v, field)
    if watch.count < driver.plan.patience or not v > 0:
        return False
    tail, until = None, driver.until(driver.horizon, field, x)
    if v <= PATIENCE * watch.tried:
        watch.tried, tail = v, summed(driver, contact, x, v, field)
    if tail is None:
        return _settles(driver, contact, x, v, field)
    over = -driver.record.now.after(tail.remaining).until(until)
    if over > 0:
        way = driver.t - driver.plan.t0 + tail.remaining
        if over > driver.losses.late(tail.t_error, until, tail.remaining, way):
            return False
        tail = tail.within(driver.record.now.until(float(np.nextafter(until, -np.inf))))
    memory = driver.record.memory
    if memory is not None and not memory.stays(TailPart(tail, driver.record.j)):
        return False
    pass_sum(driver, tail)
    return True


def _settles(driver: Driver, contact: Contact, x: StateVector, v: float, field: Field) -> bool:
    """Pass the limit of impacts that have no sum, once it is reached but for rounding: of those
    whose restitution draws, or that the flow or its bounds do not allow to be summed."""
    t, spec, watch = driver.t, driver.scene.spec, driver.watch
    x_inf = x - v * np.array(contact.push(t, x.tolist()))
    drawn = contact.name in spec.chances
    least = _at_limit(driver, contact.name, x_inf, field, drawn)
    if watch.count < driver.plan.patience or not v <= least:
        return False
    error, left = 64 * EPS * np.abs(x), 0.0
    if drawn:
        error[spec.place(DRAWS)] = np.inf
    else:
        left = _remaining(driver, contact, x, v, field)
        if left == np.inf:
            return False
        left += grown(driver, contact, field) if driver.plan.closing < 1.0 else 0.0
    found = CycleLimit((contact.name,), 0.0, x_inf, np.nan, EPS * abs(t), error, watch.count)
    pass_cycle(driver, found, x, field.mode, left)
    return True


def _remaining(driver: Driver, contact: Contact, x: StateVector, v: float, field: Field) -> float:
    """How long impacts go on from a gap speed under the force that acts there; infinite if they
    lose no speed, or nothing pulls."""
    loss = 1.0 - contact.law(driver.t, x.tolist(), -v)
    pull = -field.guards[field.column(contact.name)].lie(driver.t, x.tolist())[2]
    return 2.0 * v / (pull * loss) if loss > LEAST_LOSS and pull > 0.0 else np.inf


def settled(driver: Driver, field: Field, x: StateVector, jumped: Jumped) -> None:
    """Pass the limit of impacts that rounding has brought to rest: contacts are held where an arc
    begins, after an impact, at a knot or after a jump that has left them alone, that was to be
    flown in a ``field`` without them."""
    watch, patience, t = driver.watch, driver.plan.patience, driver.t
    rests = [name for name in driver.entry.field.held if name not in field.held]
    long = [name for name in rests if watch.impacts.get(name, 0) >= patience]
    left = {name: _left_at_rest(driver, field, name, x, jumped) for name in long}
    edges = tuple(name for name, time in left.items() if time < np.inf)
    if not edges:
        watch.over(rests)
        return
    late, there = max(left[name] for name in edges), driver.entry.x
    errors, impacts = 64 * EPS * np.abs(there), sum(watch.impacts[name] for name in edges)
    driver.hides(t + late, late * np.abs(field.flow(t, x)))
    found = CycleLimit(edges, 0.0, there, np.nan, 64 * EPS * abs(t), errors, impacts)
    driver.touched = driver.touched | _beside(driver, field, x, jumped)
    driver.entry = Entry(field, x, None, [], [])  # up to the limit none of them is held
    pass_cycle(driver, found, x, field.mode, late)


def _left_at_rest(driver: Driver, field: Field, name: str, x: StateVector, jumped: Jumped) -> float:
    """How long the impacts of a contact that rounding has brought to rest may still go on; infinite
    if they may be no series that comes to a limit.

    The force that pulls must last until the limit: where it vanishes, flights may grow again.
    """
    t, gap = driver.t, field.guards[field.column(name)]
    passing, carried = jumped.passing is not None, driver.watch.carried(name)
    if not (passing or carried or (jumped.series and name in jumped.vanishing)):
        return np.inf
    height, speed, force = gap.lie(t, x.tolist())
    if passing or carried:  # within a flight; impacts tied with other jumps may be farther off
        off = GUARD_ROUNDING if carried else POSITION_ROUNDING
        rounding = off * EPS * driver.scene.rounding(gap, field)(t, x.tolist())[0]
        speed = np.sqrt(speed * speed + 2.0 * (abs(height) + rounding) * max(-force, 0.0))
    left = _remaining(driver, driver.scene.contact(name), x, max(float(speed), 0.0), field)
    if left == np.inf:
        return np.inf
    later = x + left * field.flow(t, x)
    return left if gap.lie(t + left, later.tolist())[2] <= LASTING_PULL * force else np.inf


def _beside(driver: Driver, field: Field, x: StateVector, jumped: Jumped) -> dict[str, int]:
    """By edge, the side of guards that are zero where a limit is passed: of one that is still to
    fire that from which it comes, of one that has fired that to which it goes."""
    over = {jumped.used, *jumped.vanishing, *driver.spent}
    still = {edge: side for edge, side in jumped.tied.items() if edge not in over}
    fired = (guard for guard in field.guards if guard.edge in jumped.vanishing)
    return still | {g.edge: int(np.sign(g.lie(driver.t, x.tolist())[1])) for g in fired}


def _at_limit(driver: Driver, name: str, x_inf: StateVector, field: Field, drawn: bool) -> float:
    """The speed up to which impacts that have no sum are at their limit, but for rounding.

    Where the flow has no series at the limit, flights cannot be told from rounding once the time
    does not resolve them for another solver.
    """
    t, gap = driver.t, field.guards[field.column(name)]
    pull = -gap.lie(t, x_inf.tolist())[2]
    if drawn or not pull > 0.0:
        return float(0.5 * LAST_FLIGHT * pull * (t - driver.cycles.first_of(name)))
    sizes = driver.scene.rounding(gap, field)
    spent = LIMIT_SPEED * sizes(t, driver.seen.tolist())[1]
    spent = max(spent, GUARD_ROUNDING * EPS * sizes(t, x_inf.tolist())[1])  # it is at rest (3)
    if driver.solver.whole or expand(field, t, x_inf) is not None:
        return float(spent)
    return float(max(spent, 0.5 * pull * RESOLVED_TIMES * np.spacing(abs(t))))


def summed(driver: Driver, contact: Contact, x: StateVector, v: float, field: Field) -> Tail | None:
    """The sum of all impacts from here on; None where there is none (yet)."""
    column, now, plan = field.column(contact.name), driver.record.now, driver.plan
    rtol, atol = plan.closing * plan.rtol, plan.closing * plan.limit
    tail = close(field, contact, column, now.t, now.low, x, v, rtol, atol)
    if tail is None or not clear(tail, field, column):
        return None
    return tail.later(law_error(tail)) if passes_nothing(driver, tail) else None


def passes_nothing(driver: Driver, tail: Tail) -> bool:
    """Whether a sum of impacts passes over no event, shown in ball arithmetic.

    Where something may hide on the way to its limit, the steps from here on are watched.
    """
    if not apart(tail):
        return False
    whole = seen(tail, driver.plan.closing)
    driver.wary |= not whole
    return whole


def pass_sum(driver: Driver, tail: Tail, at_rest: StateVector | None = None) -> None:
    """Pass the accumulation point of a sum of impacts.

    ``at_rest``: the state there, already projected onto the held contacts, if it is known.
    """
    contact, record, part = tail.contact, driver.record, TailPart(tail, driver.record.j)
    sides = _sides(driver, tail.field, tail.x)
    record.keep(part)
    record.j += tail.count
    record.now = record.now.after(tail.remaining)
    driver.spent = frozenset((contact.name,))
    held = (*tail.field.held, contact.name)
    after = (tail.field.mode, held) if contact.rests else None
    driver.wary = driver.plan.watchful is not None
    _go_on_from(driver, tail, tail.field, (contact.name,), tail.r, after, sides, at_rest)


def pass_cycle(
    driver: Driver,
    found: CycleLimit,
    x: StateVector,
    mode: str,
    late: float = 0.0,
    moved: StateVector | float = 0.0,
    means: Mapping[int, float] | None = None,
) -> None:
    """Pass the accumulation point of a cycle; ``x`` and ``mode`` are those after the last jump.

    The arc from there to the limit is recorded as a straight line, of which delays see the
    ``means`` of the elements that resets move all along. ``late``: by how much the limit may come
    later, as far as rounding hides it; ``moved``: how far from it the run goes on.
    """
    record, field, since = driver.record, driver.carrier(mode, x), driver.t
    segments = [straight(0.0, found.remaining, x, found.x_inf)] if found.remaining else []
    sides = _sides(driver, field, x)
    on_held = record.arc(field, x, found.x_inf, found.remaining, segments)
    moved = field.along(driver.t, on_held + moved) - on_held
    found = attrs.evolve(found, x_inf=on_held)
    if record.memory is not None and segments:
        record.memory.limit(since, driver.t, found.x_inf, means or {})
    held = driver.still_held(mode, on_held)  # impacts at one instant may have opened some
    after = after_cycle(driver, found.edges, held)
    if shut(driver, after, found.x_inf):
        after = None
    rest = driver.scene.field(driver.scene.name(*after)) if after else field
    unlike = _unlike(driver, field, found) if after else 0.0
    for time, there in ((late, rest), (unlike, field), (_disturbed(driver, found), field)):
        if time > 0.0:
            off = time * np.abs(there.rhs(driver.t, found.x_inf.tolist()))
            found = attrs.evolve(found, t_error=found.t_error + time, x_error=found.x_error + off)
    ends = found.edges, found.ratio, after, sides
    _go_on_from(driver, found, field, *ends, moved=moved)


def _disturbed(driver: Driver, found: CycleLimit) -> float:
    """How far off the limit of a cycle may be as other jumps come between those of its edges.

    There the state is rounded, and so are the guards: one within rounding of zero may fire at once.
    A guard that is off by ``d`` lands by ``d / u`` earlier or later, at the speed ``u``, and faster
    or slower by ``d`` times its acceleration over ``u``; what is left of the cycle, as many flights
    as it has edges and those after them, is longer or shorter as that speed is.
    """
    if driver.record.memory is not None:  # guards may have been others then
        return 0.0
    pairs, total = pairwise(driver.cycles.last(len(driver.cycles.seen.t))), 0.0
    for jump, following in (pair for pair in pairs if pair[0].edge not in found.edges):
        field, t, x = driver.scene.field(following.mode), jump.t, jump.x.tolist()
        for guard in (guard for guard in field.guards if guard.edge in found.edges):
            value, rate, bend = guard.lie(t, x)
            rounded = EPS * driver.scene.rounding(guard, field)(t, x)[0]
            off = GUARD_ROUNDING * rounded if abs(value) <= GUARD_ROUNDING * rounded else rounded
            speed, pull = (rate * rate + 2.0 * abs(bend * value)) ** 0.5, abs(bend)
            if speed > 0.0 and pull > 0.0:
                flight = 4.0 * speed / pull  # in another mode the force may be half as large
                left = max(driver.t - t, len(found.edges) * flight / (1.0 - found.ratio))
                longer = left * ((1.0 + 2.0 * pull * off / speed**2) ** 0.5 - 1.0)
                total += min(off / speed + longer, left)
    return total


def _unlike(driver: Driver, field: Field, found: CycleLimit) -> float:
    """How much longer the impacts of a contact may go on that has a gap speed where a cycle of
    several comes to its limit: of bodies that do not act on each other each has its own."""
    contacts = driver.scene.contacts.intersection(found.edges)
    if len(contacts) < 2:
        return 0.0
    speeds = {g.edge: g.lie(driver.t, found.x_inf.tolist())[1] for g in field.guards}
    left = [
        _remaining(driver, driver.scene.contact(name), found.x_inf, abs(speeds[name]), field)
        for name in contacts & speeds.keys()
    ]
    return max((time for time in left if time < np.inf), default=0.0)


def shut(driver: Driver, after: tuple[str, tuple[str, ...]] | None, x: StateVector) -> bool:
    """Whether the contacts held in what follows close on a body from both sides, and leave it no
    rest."""
    return after is not None and not bool(np.isfinite(driver.closed(*after, x)).all())


def after_cycle(
    driver: Driver, cycle: tuple[str, ...], held: tuple[str, ...]
) -> tuple[str, tuple[str, ...]] | None:
    """The mode and the held contacts after a cycle: the mode that the author names with
    ``limit_of``, or rest on the contacts of the cycle, if its other edges bound no domain."""
    spec = driver.scene.spec
    named = spec.mode_after(cycle)
    if named is not None:
        return named.name, ()
    edges = [e for e in spec.transitions if e.name in cycle]
    contacts = [e for e in edges if getattr(e, "rests", False)]
    events = sum(not driver.scene.code.bounds(e, driver.scene.values) for e in edges)
    if len(contacts) + events < len(edges) or len({e.to for e in contacts}) != 1:
        return None
    return contacts[0].to, (*held, *(e.name for e in contacts))


def _go_on_from(
    driver: Driver,
    limit: Tail | CycleLimit,
    field: Field,
    edges: tuple[str, ...],
    ratio: float,
    after: tuple[str, tuple[str, ...]] | None,
    sides: dict[str, int],
    at_rest: StateVector | None = None,
    moved: StateVector | float = 0.0,
) -> None:
    """Record an accumulation and begin what follows it: a mode and the contacts held there."""
    record, goes_on = driver.record, driver.plan.zeno in ("rest", "truncate")
    others = (g for g in field.guards if g.kind == "contact" and g.edge not in edges)
    off = [*driver.hidden(), *(_off_beside(driver, gap.edge, limit.x_inf) for gap in others)]
    if off:
        limit = attrs.evolve(limit, x_error=limit.x_error + sum(off))
    rest = driver.scene.name(*after) if after and goes_on else None
    state = driver.scene.spec.record(limit.x_inf)
    point = Accumulation(driver.t, state, ratio, edges, "estimated", rest, record.j)
    if isinstance(limit, Tail):
        point._proofs, point._since = limit.prove, _since(driver, limit)
    else:
        named = ((edge, driver.scene.spec.record(x)) for edge, x in limit.limits)
        point.limits = tuple(named)
    record.limit_point(point, limit)
    _require_apart(driver, limit.x_inf)
    driver.watch.over(edges)
    driver.touched, driver.tied = sides, _passed(driver, field, edges, limit.x_inf, sides)
    driver.cycles.forget()
    tighten(driver)
    if rest is None:
        driver.status = Status.NO_REST if goes_on else Status.ZENO_STOPPED
    elif len(record.zeno) == driver.plan.accumulations:
        driver.status = Status.ZENO_STOPPED
    if after and at_rest is not None:
        driver.begin(driver.own.field(driver.scene.name(*after)), at_rest, Jumped)
        driver.seen = np.maximum(driver.seen, np.abs(limit.x_inf))
    elif after:
        come = Jumped(held=after[1], limit=frozenset(edges))
        driver.enter(after[0], limit.x_inf + moved, come)


def _off_beside(driver: Driver, name: str, x_inf: StateVector) -> StateVector:
    """How far the state of a body that goes on with its impacts may be off at the limit of another:
    the rounding of its gap puts off an impact by more the slower it is, and those behind it by
    ``(1 + r) / (1 - r)`` times that, as in :func:`.comparison._late`. An impact that leaves it no
    speed has none behind it."""
    last = driver.cycles.last_of(name)
    if last is None:
        return np.zeros(len(x_inf))
    t, x, field = last.t, last.x.tolist(), driver.scene.field(last.mode)
    t = t if driver.record.memory is None else driver.t  # the windows of the past are those of now
    gap = field.guards[field.column(name)]
    size, fast, _ = driver.scene.rounding(gap, field)(t, x)
    _, speed, force = gap.lie(t, x)
    speed = abs(speed)
    if speed <= EPS * fast:
        return np.zeros(len(x_inf))
    low = unit("hops").drowns(speed, force, driver.reach(last.x))
    r = min(driver.scene.contact(name).law(t, x, -speed), 1.0 - LEAST_LOSS)
    time = (GUARD_ROUNDING if low else 1.0) * EPS * size / speed * (1.0 + r) / (1.0 - r) ** 2
    return time * np.abs(field.rhs(t, x))


def _since(driver: Driver, tail: Tail) -> float:
    """The first impact of a series, or the last knot, or ring of a clock that did not fire, before
    its sum: there gaps are rounded."""
    first, model = driver.cycles.first_of(tail.contact.name), driver.model
    knot = model.span(tail.t)[0] if model.samples else first
    clocks = (clock for clock in tail.field.clocks if clock.when is not None)
    return max(first, knot, *(_rung(clock, first, tail) for clock in clocks))


def _rung(clock: Guard, first: float, tail: Tail) -> float:
    """The last time before a sum, but after the first impact, at which a clock rings."""
    assert clock.after is not None
    x, back, latest = tail.x.tolist(), np.spacing(abs(tail.t)), first
    while latest == first and tail.t - back > first:
        back *= 2.0
        t = float(clock.after(max(tail.t - back, first), x))
        latest = t if t <= tail.t else first
    return latest


def _sides(driver: Driver, field: Field, x: StateVector) -> dict[str, int]:
    """By edge, the side on which its guard is where an accumulation begins to be passed: the state
    does not jump at the limit, so a guard that is zero there comes from that side. One that is
    urgent fires there, whatever was before."""
    t, state = driver.t, x.tolist()
    guards = [guard for guard in field.guards if guard.kind == "edge" and not guard.urgent]
    sides = {guard.edge: int(np.sign(guard.value(t, state))) for guard in guards}
    return sides | {edge: side for edge, side in driver.touched.items() if edge in sides}


def _passed(
    driver: Driver,
    field: Field,
    edges: tuple[str, ...],
    x_inf: StateVector,
    sides: dict[str, int],
) -> dict[str, int]:
    """Of the edges beside those that accumulate those whose guards are, at the limit, on the other
    side than where it begins to be passed: by rounding, and they fire."""
    t, x = driver.t, x_inf.tolist()
    others = (guard for guard in field.guards if guard.edge in sides and guard.edge not in edges)
    over = {guard.edge for guard in others if guard.value(t, x) * sides[guard.edge] < 0}
    return {edge: sides[edge] for edge in over}


def _require_apart(driver: Driver, x: StateVector) -> None:
    """Refuse to go on where accumulation points themselves accumulate: no sum of sums is made.

    Impacts count until rounding decides whether the contact rests; other edges count only while
    rounding does not hide their guards.
    """
    impacts = driver.scene.contacts.intersection(driver.record.zeno[-1].edges)
    t = driver.record.stalls() if impacts else driver.record.heaps()
    if t is not None:
        edges = ", ".join(driver.record.latest())
        raise JumpLoopError(
            f"{driver.where(x)}: the accumulations of {edges} accumulate in turn, about at "
            f"t = {t:.8g}, and what is beyond is not known; end the run before that, or at "
            f"the first accumulation with zeno='stop'"
        )
