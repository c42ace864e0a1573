"""Whether the cause of a cycle of jumps is still there at its limit, so that the run may pass
it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..lowering import Field, Guard, Kink, Scene
from ..rules.flown import BRIEF_FLIGHT
from ..rules.guards import GUARD_ROUNDING
from ..rules.lanes import STILL_JUMPS
from ..rules.sights import BOX_MARGIN
from ..rules.zeros import EPS
from ..zeno.cycle import LEFT_TO_LIMIT, CycleLimit
from ..zeno.narrow import damps
from ..zeno.others import excluded, hull
from .accumulations import after_cycle, pass_cycle, shut
from .cycles import ZERO, Cycles, Seen, Turn
from .instant import collapse
from .tightening import tighten

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector
    from .driver import Driver

    Law = Callable[[float, StateVector], Numbers]

#: Once so small a share of the longest flight is left, flights may rise by its square only, 1e-12
#: of the state. Rounding then leaves the last flights an accuracy of 2e-4, and the limit one of
#: ``DROWNED``. Later turns are known less well, so the limit is taken here, whatever the
#: tolerances.
DROWNING, DROWNED = 1e-6, EPS / 1e-6

#: What is less than so many times its error at a limit may be zero.
SURELY = 16.0

#: Points on the way to the limit at which the flow is sampled, and how linear it must be.
SAMPLES, STRAIGHTNESS = 64, 1e-2

#: How often the way to the limit is halved where flow, guard and reset are sampled, from
#: ``LATE_FROM`` times its length on; and by how many times more than on the way so far they may
#: change with one halving.
LATE_HALVINGS, LATE_FROM, LATE_CHANGE = 60, 16.0, 4.0

#: Steps of the midpoint rule along the last flight of a jump.
FLIGHT = 8


def persists(scene: Scene, turn: Turn, t: float, found: CycleLimit, rtol: float) -> bool:
    """Whether the cause of a cycle is there at its limit.

    For each jump of a turn, at the limit of the state that the jump before leads to: its guard is
    zero, its reset leads to the limit after it, no other guard of the mode has changed sign on the
    way or may be zero there, the flow varies there no more than linearly, and flow, guard and reset
    keep their laws.
    """
    for k, jump in enumerate(turn.seen[1:]):
        field, x, slack = scene.field(jump.mode), turn.limits[k], turn.slack(k, rtol)
        fired = next((guard for guard in field.guards if guard.edge == jump.edge), None)
        if fired is None or not _steady(field, turn.seen[k], t, x):
            return False
        if not (
            _alone(scene, field, turn, k, t, found.edges) and _keeps_formula(field, turn, k, t)
        ):
            return False
        if not _keeps_law(scene, field, fired, turn, k, t, found.t_error):
            return False
        off = np.abs(_after(scene, fired, t, x) - turn.limits[k + 1])
        if np.any(off > slack + turn.slack(k + 1, rtol)):
            return False
    return True


def _keeps_law(
    scene: Scene, field: Field, guard: Guard, turn: Turn, k: int, t: float, t_error: float
) -> bool:
    """Whether flow, guard and reset do at all states on the way to the limit what they have done so
    far.

    Of what each makes of their distance to the limit, the change with a halving of that falls where
    it follows a power of the distance. If it grows, as where another formula begins at some speed,
    the jumps seen so far do not tell of those that come.
    """
    now, x, limit, known = turn.seen[k], turn.limits[k], turn.limits[k + 1], turn.known(k)
    *_, (begin, *came), _ = _way(field, now, now.until(turn.seen[k + 1]), t, x)
    way, share = np.array(came) - x, LATE_FROM * 0.5 ** np.arange(LATE_HALVINGS)[:, None]
    points = list(zip((t + share[:, 0] * (begin - t)).tolist(), x + share * way, strict=True))
    late = t + 10 * t_error + 64 * EPS * abs(t)

    sure = np.all((share * np.abs(way) > known) | (np.abs(way) <= known), axis=1)

    def reset(t: float, x: StateVector) -> Numbers:
        return _after(scene, guard, t, x)

    def sampled(law: Law, known: Numbers) -> tuple[Matrix, Numbers]:
        """What a law gives on the way, and how well that is known at the limit. The law may be
        undefined on the far side of the limit: there what it gave last is repeated."""
        given = np.array([law(s, y) for s, y in points])
        end = int(np.argmin(np.append(np.isfinite(given).all(axis=1), False)))
        if end and not sure[end:].any():
            given[end:] = given[end - 1]
        s, y = points[max(end - 1, 0)]
        return given, _moved(law, s, y, known) + np.abs(law(late, y) - law(s, y))

    rates, drift = sampled(field.flow, 64 * EPS * np.abs(x))
    values, shift = sampled(_value(guard), known)
    made, change = sampled(reset, known)
    noise = 64 * EPS * np.abs(rates).max(axis=0) + drift
    return (
        _settles(rates, np.where(sure[:, None], noise, np.inf))
        and _settles(values / share, shift / share)
        and _settles((made - limit) / share, (turn.known(k + 1) + change) / share)
    )


def _keeps_formula(field: Field, turn: Turn, k: int, t: float) -> bool:
    """Whether nothing that decides on a formula of the flow changes sign from the last flight
    before a jump to the limit."""
    now, x, known = turn.seen[k], turn.limits[k], turn.known(k)
    for kink in field.changes:
        here, before = kink.value(t, x.tolist()), kink.value(now.t, now.x.tolist())
        if here * before < 0.0 and abs(here) > _shifted(kink, t, x, known):
            return False
    return True


def _settles(laws: Matrix, off: Matrix) -> bool:
    """Whether what is made of a distance changes ever less as that is halved; ``off``: how well it
    is known."""
    changes = np.abs(np.diff(laws, axis=0))
    so_far = np.maximum.accumulate(changes, axis=0)[:-1]
    return bool(np.all(changes[1:] <= LATE_CHANGE * so_far + off[2:]))


def _alone(
    scene: Scene, field: Field, turn: Turn, k: int, t: float, cycle: tuple[str, ...]
) -> bool:
    """Whether no guard outside the cycle is zero from the last flight before a jump to the limit,
    where its own are. Jumps land on those, whatever the tolerances: they are zero as far as the
    limit is known."""
    now, jump, x, others = turn.seen[k], turn.seen[k + 1], turn.limits[k], []
    known, points = turn.known(k), [(t, x), (now.t, now.x)]
    for column, guard in enumerate(field.guards):
        if _bears_nothing(scene, field, guard, points):
            continue
        here, before = guard.value(t, x.tolist()), guard.value(now.t, now.x.tolist())
        own = guard.edge in cycle or _follows(field, guard, cycle, points)
        ours = own and abs(here) <= _allowed(guard, t, x, known, turn.first)
        if not ours and (guard.edge == jump.edge or here * before <= 0):
            return False
        if not ours and abs(here) > _shifted(guard, t, x, known):
            others.append(column)
    way = _way(field, now, now.until(jump), t, x)
    return not others or t <= now.t or excluded(field, others, hull(way, BOX_MARGIN))


def _bears_nothing(
    scene: Scene, field: Field, guard: Guard, points: list[tuple[float, StateVector]]
) -> bool:
    """Whether a guard is the load of a held contact that bears nothing, for good: bodies that fall
    together."""
    if guard.kind != "release":
        return False
    sizes = scene.rounding(guard, field)
    pairs = (zip(guard.lie(t, x.tolist()), sizes(t, x.tolist()), strict=True) for t, x in points)
    return all(abs(own) <= GUARD_ROUNDING * EPS * size for pair in pairs for own, size in pair)


def _follows(
    field: Field, guard: Guard, cycle: tuple[str, ...], points: list[tuple[float, StateVector]]
) -> bool:
    """Whether a guard is that of an edge of the cycle declared before its own, as of the two modes
    on the sides of a surface: that one fires whenever it does."""
    lies = [guard.lie(t, x.tolist()) for t, x in points]
    before = field.guards[: field.column(guard.edge)]
    return any(
        other.edge in cycle
        and other.crossing == guard.crossing
        and [other.lie(t, x.tolist()) for t, x in points] == lies
        for other in before
    )


def _way(field: Field, now: Seen, length: float, t: float, x: StateVector) -> Matrix:
    """Times and states along the flight after a jump, ending with the limit."""
    step, state, rows = length / FLIGHT, now.x, [[now.t, *now.x]]
    for k in range(FLIGHT):
        begin = now.t + k * step
        rate = np.array(field.rhs(begin, state.tolist()))
        middle = (state + 0.5 * step * rate).tolist()
        state = state + step * np.array(field.rhs(begin + 0.5 * step, middle))
        rows.append([begin + step, *state])
    return np.array([*rows, [t, *x]])


def _steady(field: Field, now: Seen, t: float, x: StateVector) -> bool:
    """Whether a mode's flow varies linearly along the way to the limit."""
    rhs, shares = field.rhs, np.linspace(0.0, 1.0, SAMPLES)
    states = now.x + shares[:, None] * (x - now.x)
    times = now.t + shares * (t - now.t)
    rates = np.array([rhs(s, y) for s, y in zip(times.tolist(), states.tolist(), strict=True)])
    straight = rates[0] + shares[:, None] * (rates[-1] - rates[0])
    return bool(np.abs(rates - straight).max() <= STRAIGHTNESS * np.abs(rates).max())


def _allowed(
    guard: Guard, t: float, x: StateVector, known: StateVector, first: list[Seen]
) -> float:
    """The largest value of a guard that counts as zero at the limit: small against its size in the
    cycle, or within what is not known of the state."""
    size, length = 0.0, first[0].until(first[-1])
    for seen in first:
        value, rate, _ = guard.lie(seen.t, seen.x.tolist())
        size = max(size, abs(value), abs(rate) * length)
    return ZERO * size + _shifted(guard, t, x, known)


def _shifted(guard: Guard | Kink, t: float, x: StateVector, slack: StateVector) -> float:
    """How much a guard changes over the slack of a state, or what decides on a formula."""
    (moved,) = _moved(_value(guard), t, x, slack)
    return float(moved)


def _value(guard: Guard | Kink) -> Law:
    return lambda t, x: np.array([guard.value(t, x.tolist())])


def _moved(law: Law, t: float, x: StateVector, slack: StateVector) -> Numbers:
    """How much what a law gives changes over the slack of a state, on the side where it changes
    more; it may be undefined on the other."""
    steps, here = np.diag(slack), law(t, x)
    change = [[np.abs(law(t, x + side) - here) for side in (step, -step)] for step in steps]
    return np.sum(np.fmax.reduce(change, axis=1), axis=0)  # type: ignore[no-any-return]


def _after(scene: Scene, guard: Guard, t: float, x: StateVector) -> StateVector:
    """The state after a jump."""
    if guard.kind == "contact":
        contact = scene.contact(guard.edge)
        return np.array(contact.impact(t, list(contact.land(t, x.tolist())))[:-1])
    if guard.kind == "edge":
        return np.array(scene.reset(guard.edge)(t, x.tolist()))
    return x


def pass_limit(driver: Driver, mode: str) -> bool:
    """Pass the limit of a cycle if the last jumps have one; returns whether they do.

    ``mode``: the mode that the last jump leads to.
    """
    plan, cycles = driver.plan, driver.cycles
    passes = plan.zeno == "ignore" or driver.status is not None
    passes = passes or driver.scene.field(mode).hurried
    if passes or _summed(driver.scene, cycles):
        return False
    slower = _at_once(driver, mode) if cycles.stands else None
    if slower is not None:
        pass_cycle(driver, slower, cycles.seen.x[-1].copy(), mode)
        return True
    sought = _sought(driver)
    known = driver.until(driver.known, driver.scene.field(mode), cycles.seen.x[-1])
    if sought is None:
        tighten(driver)
        return False
    found, turn = sought
    over = -driver.record.now.after(found.remaining).until(known)
    if over > 0:
        way = driver.t - plan.t0 + found.remaining
        if over > driver.losses.late(found.t_error, known, found.remaining, way):
            return False
        soon = driver.record.now.until(float(np.nextafter(known, -np.inf)))
        found = attrs.evolve(found, remaining=soon, t_error=found.t_error + over)
    if driver.scene.conditional.intersection(found.edges):  # which may fail before the limit
        return False
    if _shown(driver, found):
        cycles.fly_to(driver.record.now, found, turn, driver.record.made)
        return False
    cycles.ahead = None
    if not _tire(driver, found, turn):
        return False
    after = driver.scene.spec.mode_after(found.edges)
    if found.ratio == 0.0 and after is None:
        held = driver.still_held(mode, cycles.seen.x[-1])
        if not shut(driver, after_cycle(driver, found.edges, held), found.x_inf):
            return False
    t = driver.record.now.after(found.remaining).t
    if not persists(driver.scene, turn, t, found, plan.rtol):
        return False
    if not turn.stays(plan.rtol):
        if cycles.seen.edge[-1] != (after.limit_of if after else found.edges)[-1]:
            cycles.again()
            return False
        found = attrs.evolve(found, limits=_named(turn))
    moved = _uncertain(driver.scene, turn, found) if plan.shaken else 0.0
    means = _means(turn, plan.rtol) if found.remaining else None
    pass_cycle(driver, found, cycles.seen.x[-1].copy(), mode, moved=moved, means=means)
    return True


def _means(turn: Turn, rtol: float) -> dict[int, float]:
    """Of the elements of the state that resets still move at the limit, the means over a turn: they
    are what comes after the jumps, each for the share of the time of the flight behind it."""
    limits, slack = np.array(turn.limits[:-1]), turn.slack(-1, rtol)
    moves = np.flatnonzero(np.ptp(limits, axis=0) > slack).tolist()
    times = [now.until(jump) for now, jump in pairwise(turn.seen)]
    means = np.average(limits, axis=0, weights=times)
    return {i: float(means[i]) for i in moves}


def _uncertain(scene: Scene, turn: Turn, found: CycleLimit) -> Numbers:
    """What is not known of the state at the limit of a cycle: a run with which another is compared
    is moved by it, as it would else go on with the same error.

    Not of what the guards of the cycle, and their rates, are made of, as these are zero there or
    come to rest; nor of what may be zero for all that is known of it.
    """
    x, off, own = found.x_inf, found.x_error.copy(), set[int]()
    for jump in turn.seen[1:]:
        field = scene.field(jump.mode)
        uses, reach = field.guard(jump.edge).uses, field.code.reach(field.mode, field.held)
        own = own.union(uses, *(reach[i][0] for i in uses))
    off[[*own, *range(scene.spec.flows, len(x))]] = 0.0
    off[np.abs(x) <= SURELY * off] = 0.0
    return off * (-1.0) ** np.arange(len(x))


def _at_once(driver: Driver, mode: str) -> CycleLimit | None:
    """The limit of impacts at one instant that never end, if the last jumps are such."""
    if driver.record.memory is not None:  # what delays see may change with each of them
        return None
    cycles = driver.cycles
    if cycles.standing != 2 * len(cycles.seen.t):  # it takes as long as many jumps
        return None
    return collapse(driver.scene, mode, cycles.last(STILL_JUMPS), cycles.still)


def _shown(driver: Driver, found: CycleLimit) -> bool:
    """Whether delays can tell the last turn from the straight line that leads on to its limit, and
    the jumps that follow are not yet lost in rounding. Turns that fall like a power of their number
    are too many to be made."""
    memory, cycles = driver.record.memory, driver.cycles
    if memory is None or driver.plan.memory == "restart" or found.ratio == 1.0:
        return False
    since = cycles.last(len(found.edges) + 1)[0].t
    short = max(DROWNING * cycles.longest, BRIEF_FLIGHT * np.spacing(abs(driver.t)))
    return bool(found.remaining > short) and not memory.nears(since, found.x_inf)


def _sought(driver: Driver) -> tuple[CycleLimit, Turn] | None:
    """The limit of the last jumps, if it is known to the accuracy wanted, or as well as rounding
    will ever show it."""
    cycles, plan = driver.cycles, driver.asked
    rtol, atol = plan.closing * plan.rtol, plan.closing * plan.limit
    ahead = cycles.known(driver.record.now, driver.record.made)
    if ahead is not None or cycles.ahead is not None:
        return ahead
    if cycles.stands:
        return cycles.reached(rtol, atol, driver.seen)
    own = [(plan.rtol, plan.limit, rtol)] if plan.closing < 1.0 else []
    lost = (0.0, 0.0) if driver.losses.exact else (plan.rtol, plan.limit)
    for wanted, least, left in [(rtol, atol, np.inf), *own, (DROWNED, 0.0, DROWNING)]:
        sought = cycles.limit(driver.scene, wanted, least, lost)
        if sought is not None and sought[0].remaining <= left * cycles.longest:
            return sought
    sought = cycles.limit(driver.scene, LEFT_TO_LIMIT, 0.0, lost) if _drowns(driver) else None
    return sought if sought is not None and _tells(sought[1], cycles.beside) else None


def _tells(turn: Turn, beside: Sequence[int]) -> bool:
    """Whether each state has a limit at each of the jumps, known better than the last turn has
    changed it, to what counts as zero. Two cycles side by side look like one for a while, but what
    the jumps of one find of the other has no limit."""
    changed = np.ptp([seen.x for seen in turn.seen], axis=0)
    zero = ZERO * np.abs([seen.x for seen in turn.first]).max(axis=0)
    known = np.max(turn.errors, axis=0) <= changed + zero
    return bool(np.delete(known, beside).all())


def _drowns(driver: Driver) -> bool:
    """Whether rounding will hide the side on which the guard of an edge is at a jump, before it is
    looked for a limit again, if it falls on as in the last turn: of ``x - 3`` the rounding is that
    of 3, however low the flights are."""
    cycles, scene, length = driver.cycles, driver.scene, driver.cycles.period
    if length == 0:
        return False
    jumps, turns = cycles.last(2 * length), 1.0 + cycles.wait / length
    turn = jumps[length:]
    edges = {jump.edge for jump in turn}
    for before, jump, later in zip(jumps, turn, [*turn[1:], turn[0]], strict=False):
        field = scene.field(later.mode)
        for guard in field.guards:
            if guard.edge not in edges or guard.edge == jump.edge or guard.kind == "contact":
                continue
            t, x = jump.t, jump.x.tolist()
            value, last = abs(guard.value(t, x)), abs(guard.value(before.t, before.x.tolist()))
            # of its terms, less what they come to: that falls with it; twice, as of those seen
            terms = scene.rounding(guard, field)(t, x)[0] - value
            hides = 2.0 * GUARD_ROUNDING * EPS * terms
            falls = value < last and hides < last  # and is not zero at each of these jumps
            if falls and value * (value / last) ** turns <= hides:
                return True
    return False


def _named(turn: Turn) -> tuple[tuple[str, np.ndarray], ...]:
    """The jumps of a turn, and the limits of the states after them."""
    edges = [seen.edge for seen in turn.seen[1:]]
    return tuple(zip(edges, turn.limits[1:], strict=True))


def _summed(scene: Scene, cycles: Cycles) -> bool:
    """Whether the last jumps are impacts of one contact that damps them all: these are summed as a
    series instead."""
    (last,) = cycles.last(1)
    if cycles.period != 1 or not scene.is_contact(last.edge):
        return False
    return scene.contact(last.edge).law(last.t, last.x.tolist(), -0.0) < 1.0 - 1e-12


def _tire(driver: Driver, found: CycleLimit, cycle: Turn) -> bool:
    """Whether each contact of a cycle damps slow impacts, too, down to rest; or none at all, where
    other jumps of the turn do."""
    scene, turn = driver.scene, driver.cycles.last(len(found.edges))
    for seen in turn:
        if scene.is_contact(seen.edge):
            guard = scene.field(seen.mode).guard(seen.edge)
            speed = abs(guard.lie(seen.t, seen.x.tolist())[1])
            contact, x = scene.contact(seen.edge), seen.x.tolist()
            elastic = all(_elastic(scene, past) for past in cycle.first if past.edge == seen.edge)
            if not elastic and not damps(contact, seen.t, x, speed, found.ratio):
                return False
    return True


def _elastic(scene: Scene, seen: Seen) -> bool:
    """Whether neither an impact seen nor those slower by far lose any speed."""
    guard, x = scene.field(seen.mode).guard(seen.edge), seen.x.tolist()
    law, speed = scene.contact(seen.edge).law, abs(guard.lie(seen.t, x)[1])
    return law(seen.t, x, -speed) == law(seen.t, x, -0.0) == 1.0
