"""Cycles of jumps that accumulate: watched as a run goes on, and passed like a chattering tail."""

from __future__ import annotations

from itertools import pairwise, takewhile
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np

from ..lowering import Field, Guard, Scene
from ..rules.lanes import (
    FAST_FALL,
    FEW_TURNS,
    IDLE_FLIGHT,
    LEAST_WAIT,
    LEAST_WINDOW,
    LONGEST_CYCLE,
    STILL_JUMPS,
    WINDOW_FALL,
    WINDOW_PART,
)
from ..rules.sights import BOX_MARGIN
from ..rules.zeros import EPS
from ..trajectory.clock import Instant
from ..zeno.cycle import CycleLimit, accelerated, limit, period
from ..zeno.narrow import damps
from ..zeno.others import excluded, hull
from .instant import collapse

if TYPE_CHECKING:
    from ..trajectory.plan import Plan
    from .driver import Driver

#: Most jumps that are remembered.
REMEMBERED_JUMPS = 1 << 14

#: What guards, and what resets change, may be at the limit, against their size in the cycle.
ZERO = 1e-6

#: Spacings of floats by which a jump may be late or early, and still be said to be at one time.
TICKS = 4

#: Where so small a share of the longest flight is left, the way over a guard may be its square,
#: 1e-12 of the state: rounding knows the last flights to 2e-4 then, and the limit to ``DROWNED``.
#: Later turns show less of it: it is taken as it is known there, whatever the tolerances.
DROWNING, DROWNED = 1e-6, EPS / 1e-6

#: Points on the way to the limit at which flows are looked at, and how straight they must be.
SAMPLES, STRAIGHTNESS = 64, 1e-2

#: Steps of the midpoint rule along the last flight of a jump.
FLIGHT = 8


class Seen(NamedTuple):
    """A jump out of a mode, when (in two floats), and the state after it.

    ``clock`` is the time without flights that never left their guard (:func:`idle`).
    """

    edge: str
    mode: str
    t: float
    low: float
    clock: float
    x: np.ndarray

    @property
    def now(self) -> Instant:
        return Instant(self.t, self.low)


def idle(scene: Scene, field: Field, guard: Guard, t: float, x: np.ndarray, s: float) -> bool:
    """Whether a flight of length ``s`` stayed within rounding of the guard that ended it.

    What ends it is then rounding too, and its length says nothing. (In the low flights of a
    contact the gap is a coordinate of its own.)
    """
    if guard.kind not in ("edge", "switch"):
        return False
    value, rate, bend = guard.lie(t, x.tolist())
    height = abs(value) + abs(rate) * s + 0.5 * abs(bend) * s * s
    return bool(height <= 64 * EPS * scene.rounding(guard, field)(t, x.tolist())[0])


@attrs.frozen(eq=False)
class Turn:
    """The last turn of a cycle, and where its jumps lead at the limit.

    Attributes
    ----------
    seen : list of Seen
        The jumps, with the last one of the turn before.
    first : list of Seen
        Those of the first turn that was looked at: the sizes that the cycle began with.
    limits, errors : list of array
        The limits of the states after these jumps, and bounds on their errors.
    """

    seen: list[Seen]
    first: list[Seen]
    limits: list[np.ndarray]
    errors: list[np.ndarray]

    def slack(self, k: int, rtol: float) -> np.ndarray:
        """What a state next to the k-th limit may be off it."""
        moved = np.ptp(np.array([seen.x for seen in self.first]), axis=0)
        return ZERO * moved + 10 * self.errors[k] + 10 * rtol * np.abs(self.limits[k])

    def stays(self, rtol: float) -> bool:
        """Whether no reset moves the state at the limit."""
        slack, last = self.slack(-1, rtol), self.limits[-1]
        return all(np.all(np.abs(x - last) <= slack) for x in self.limits)


class Cycles:
    """The jumps of a run since its last accumulation.

    Attributes
    ----------
    longest : float
        The longest flight of the run.
    spent : float
        Time spent in flights that never left their guard.
    """

    def __init__(self) -> None:
        self.seen: list[Seen] = []
        self.next = 2 * LEAST_WINDOW
        self.stands = self.asked = False
        self.longest = self.spent = 0.0

    def clock(
        self, scene: Scene, field: Field, guard: Guard, t: float, x: np.ndarray, s: float
    ) -> float:
        """The time without idle flights, after one more flight, of length ``s``."""
        if s > IDLE_FLIGHT * self.longest:
            self.longest = max(s, self.longest)
        elif s > 0 and idle(scene, field, guard, t, x, s):
            self.spent += s
        return t + s - self.spent

    def plain(self, lengths: np.ndarray) -> bool:
        """Whether no flight of several in a row is so short that it may be idle; noted if so."""
        longest = self.longest
        for length in lengths.tolist():
            if not length > IDLE_FLIGHT * longest:
                return False
            longest = max(longest, length)
        self.longest = longest
        return True

    def room(self, times: np.ndarray) -> int:
        """Of jumps at these times, how many there are before it may be time to look for a limit."""
        if self.asked:
            return min(len(times), 1)
        count = min(len(times), self.next - len(self.seen))
        known = [seen.t for seen in self.seen[-STILL_JUMPS:]]
        if len(known) + count <= FEW_TURNS:  # not one turn more than there must be
            return count
        together = np.concatenate([known, times[:count]])
        number = np.arange(len(together))
        short = np.diff(together, prepend=-np.inf) <= IDLE_FLIGHT * self.longest
        run = number - np.maximum.accumulate(np.where(short, -1, number))
        looks = (run > 0) & (run % STILL_JUMPS == 0)
        for length in range(1, LONGEST_CYCLE + 1):
            turns = together[length:] - together[:-length]
            if len(turns) > 2 * length:
                falls = turns[length:] <= FAST_FALL * turns[:-length]
                looks[FEW_TURNS * length :] |= falls[length:] & falls[:-length]
        found = np.flatnonzero(looks[len(known) :])
        return int(found[0]) + 1 if len(found) else count

    def saw(self, jumps: list[Seen]) -> bool:
        """Note jumps, no more than there is room for; whether it is time to look for a limit."""
        seen = self.seen
        seen += jumps
        due = self._falls() or self._stops() or self.asked
        self.asked = False
        if len(seen) < self.next:
            return due
        if len(seen) > REMEMBERED_JUMPS:
            del seen[: REMEMBERED_JUMPS // 2]
        window = max(LEAST_WINDOW, (len(seen) - 1) // WINDOW_PART)
        self.next = len(seen) + max(LEAST_WAIT, len(seen) // WINDOW_PART)
        first, middle = seen[max(0, len(seen) - 1 - 2 * window)], seen[-window - 1]
        return due or _between(middle, seen[-1]) < WINDOW_FALL * _between(first, middle)

    def _falls(self) -> bool:
        """Whether the last turns of a cycle fall so fast that there will not be many."""
        seen = self.seen
        for length in range(1, min(LONGEST_CYCLE, (len(seen) - 1) // FEW_TURNS) + 1):
            last = seen[-1 : -2 - FEW_TURNS * length : -length]
            if all(jump.edge == last[0].edge for jump in last):
                turns = [_between(b, a) for a, b in pairwise(last)]
                if all(0 < a <= FAST_FALL * b for a, b in pairwise(turns)):
                    return True
        return False

    def _stops(self) -> bool:
        """Whether some jumps have taken no time: said once, while they do."""
        stood, self.stands = self.stands, False
        if len(self.seen) >= STILL_JUMPS:
            first, last = self.seen[-STILL_JUMPS], self.seen[-1]
            self.stands = last.clock - first.clock <= _tick(STILL_JUMPS, last.t)
        return self.stands and not stood

    def first_of(self, edge: str) -> float:
        """When the last jumps, all of this edge, began."""
        return min(seen.t for seen in takewhile(lambda seen: seen.edge == edge, self.seen[::-1]))

    def again(self) -> None:
        """Look for a limit at the next jump again."""
        self.asked, self.stands = True, False

    def forget(self) -> None:
        """Start anew, after an accumulation."""
        self.seen.clear()
        self.next, self.stands = 2 * LEAST_WINDOW, False

    @property
    def period(self) -> int:
        """Jumps in a turn of the edges, as far as the last few turns show; 0 for none."""
        return period(
            [seen.edge for seen in self.seen[-LONGEST_CYCLE * (FEW_TURNS + 1) :]], FEW_TURNS
        )

    def counts(self) -> list[int]:
        """The elements of the state that a turn of the last jumps changes by no less than the turn
        before did, as a count does."""
        length = self.period
        if not length:
            return []
        turns = np.abs(np.diff(_columns(self._closings(length)[-FEW_TURNS:])[1], axis=0))
        return np.flatnonzero((turns[-1] > 0) & (turns[-1] >= WINDOW_FALL * turns[-2])).tolist()  # type: ignore[no-any-return]

    def limit(self, rtol: float, atol: float) -> tuple[CycleLimit, Turn] | None:
        """Where the last jumps accumulate, if they do, and the turn that leads there.

        The states may come round after several turns of the edges: a reset may change a sign.
        """
        shortest = self.period
        for length in range(shortest, LONGEST_CYCLE + 1, shortest) if shortest else ():
            times, states = _columns(_shrinking(self._closings(length)))
            found = limit(self._cycle(shortest), times, states, rtol, atol)
            turn = None if found is None else self._turn(length, found)
            if found is not None and turn is not None:
                return attrs.evolve(found, ratio=found.ratio ** (shortest / length)), turn
        return None

    def reached(self, rtol: float, atol: float) -> tuple[CycleLimit, Turn] | None:
        """The limit at which the last jumps stand, if they do: no time passes, states come round.

        Its ratio is that of the last turns that took time; 0 where these had not been seen to
        shrink.
        """
        shortest, now = self.period, self.seen[-1]
        for length in range(shortest, LONGEST_CYCLE + 1, shortest) if shortest else ():
            closings = self._closings(length)
            if len(closings) > FEW_TURNS:
                turn = self._standing(length)
                slack = [rtol * np.abs(x) + atol for x in turn.limits]
                if all(np.all(e <= s) for e, s in zip(turn.errors, slack, strict=True)):
                    times = np.diff([seen.clock for seen in closings])
                    times = times[times > _tick(length, now.t)]
                    shrinks = len(times) > 1 and times[-1] < WINDOW_FALL * times[-2]
                    ratio = (times[-1] / times[-2]) ** (shortest / length) if shrinks else 0.0
                    error = _between(self.seen[-STILL_JUMPS:][0], now) + _tick(STILL_JUMPS, now.t)
                    last = float(ratio), error, turn.errors[-1], FEW_TURNS + 1
                    return CycleLimit(self._cycle(shortest), 0.0, now.x, *last), turn
        return None

    def _cycle(self, length: int) -> tuple[str, ...]:
        """The edges of a turn, from the same one on whichever comes last."""
        edges = [seen.edge for seen in self.seen[-length:]]
        return min(tuple(edges[k:] + edges[:k]) for k in range(length))

    def _closings(self, length: int, back: int = 0) -> list[Seen]:
        """Every so many jumps one, as far back as they are the same, up to some jumps ago."""
        last, closings = self.seen[-1 - back], []
        for seen in self.seen[-1 - back :: -length]:
            if (seen.edge, seen.mode) != (last.edge, last.mode):
                break
            closings.append(seen)
        return closings[::-1]

    def _turn(self, length: int, found: CycleLimit) -> Turn | None:
        """The last turn of a cycle whose limit was found, with each jump's own limit."""
        limits, errors = [found.x_inf], [found.x_error]
        for back in range(length - 1, 0, -1):
            closings = self._closings(length, back)[-found.turns :]
            if len(closings) <= FEW_TURNS:
                return None
            x_inf, error, _ = accelerated(_columns(closings)[1], found.ratio == 1.0)
            limits.append(x_inf)
            errors.append(error)
        first = self.seen[-1 - length * (found.turns - 1) :][: length + 1]
        last = self.seen[-1 - length :]
        return Turn(last, first, [*limits, found.x_inf], [*errors, found.x_error])

    def _standing(self, length: int) -> Turn:
        """The last turn of a cycle that stands, with what each jump's states still move."""
        last = self.seen[-1 - length :]
        phases = [self._closings(length, back)[-FEW_TURNS:] for back in range(length, -1, -1)]
        errors = [np.ptp(_columns(phase)[1], axis=0) for phase in phases]
        return Turn(last, last, [seen.x for seen in last], errors)


def _tick(count: int, t: float) -> float:
    """What rounding makes of the time of so many jumps."""
    return TICKS * count * float(np.spacing(abs(t)))


def _between(first: Seen, last: Seen) -> float:
    return (last.t - first.t) + (last.low - first.low)


def _columns(turns: list[Seen]) -> tuple[np.ndarray, np.ndarray]:
    """Times since the first, and states."""
    times = [_between(turns[0], turn) for turn in turns]
    return np.array(times), np.array([turn.x for turn in turns])


def _shrinking(closings: list[Seen]) -> list[Seen]:
    """The last closings, as far back as each turn was longer than the next."""
    turns = np.diff(_columns(closings)[0])
    longer = np.flatnonzero(~(turns[:-1] > turns[1:]))
    return closings[int(longer[-1]) + 1 if len(longer) else 0 :]


def persists(scene: Scene, turn: Turn, t: float, cycle: tuple[str, ...], rtol: float) -> bool:
    """Whether the cause of a cycle is there at its limit.

    For each jump of a turn, at the limit of the state that the one before leads to: its guard is
    zero, its reset leads to the limit after it, no other guard of the mode has changed sign on the
    way or may be zero there, and the flow there changes no faster than along a straight line.
    """
    for k, jump in enumerate(turn.seen[1:]):
        field, x, slack = scene.field(jump.mode), turn.limits[k], turn.slack(k, rtol)
        fired = next((guard for guard in field.guards if guard.edge == jump.edge), None)
        if fired is None or not _steady(field, turn.seen[k], t, x):
            return False
        if not _alone(field, turn, k, t, cycle, slack):
            return False
        off = np.abs(_after(scene, fired, t, x) - turn.limits[k + 1])
        if np.any(off > slack + turn.slack(k + 1, rtol)):
            return False
    return True


def _alone(
    field: Field, turn: Turn, k: int, t: float, cycle: tuple[str, ...], slack: np.ndarray
) -> bool:
    """Whether no guard but those of the cycle is zero from the last flight before a jump on."""
    now, jump, x, others = turn.seen[k], turn.seen[k + 1], turn.limits[k], []
    known = 10 * turn.errors[k] + 64 * EPS * np.abs(x)
    for column, guard in enumerate(field.guards):
        here, before = guard.value(t, x.tolist()), guard.value(now.t, now.x.tolist())
        ours = guard.edge in cycle and abs(here) <= _allowed(guard, t, x, slack, turn.first)
        if not ours and (guard.edge == jump.edge or here * before <= 0):
            return False
        if not ours and abs(here) > _moved(guard, t, x, known):
            others.append(column)
    way = _way(field, now, _between(now, jump), t, x)
    return not others or t <= now.t or excluded(field, others, hull(way, BOX_MARGIN))


def _way(field: Field, now: Seen, length: float, t: float, x: np.ndarray) -> np.ndarray:
    """Times and states along the flight after a jump, and at the limit at last."""
    step, state, rows = length / FLIGHT, now.x, [[now.t, *now.x]]
    for k in range(FLIGHT):
        begin = now.t + k * step
        rate = np.array(field.rhs(begin, state.tolist()))
        middle = (state + 0.5 * step * rate).tolist()
        state = state + step * np.array(field.rhs(begin + 0.5 * step, middle))
        rows.append([begin + step, *state])
    return np.array([*rows, [t, *x]])


def _steady(field: Field, now: Seen, t: float, x: np.ndarray) -> bool:
    """Whether a mode's flow changes along the way to the limit as a straight line does."""
    rhs, shares = field.rhs, np.linspace(0.0, 1.0, SAMPLES)
    states = now.x + shares[:, None] * (x - now.x)
    times = now.t + shares * (t - now.t)
    rates = np.array([rhs(s, y) for s, y in zip(times.tolist(), states.tolist(), strict=True)])
    straight = rates[0] + shares[:, None] * (rates[-1] - rates[0])
    return bool(np.abs(rates - straight).max() <= STRAIGHTNESS * np.abs(rates).max())


def _allowed(guard: Guard, t: float, x: np.ndarray, slack: np.ndarray, first: list[Seen]) -> float:
    """What a guard may be at the limit: little against its size, or what the slack makes of it."""
    size, length = 0.0, _between(first[0], first[-1])
    for seen in first:
        value, rate, _ = guard.lie(seen.t, seen.x.tolist())
        size = max(size, abs(value), abs(rate) * length)
    return ZERO * size + _moved(guard, t, x, slack)


def _moved(guard: Guard, t: float, x: np.ndarray, slack: np.ndarray) -> float:
    """What the slack of a state makes of a guard."""
    here = guard.value(t, x.tolist())
    return sum(abs(guard.value(t, (x + step).tolist()) - here) for step in np.diag(slack))


def _after(scene: Scene, guard: Guard, t: float, x: np.ndarray) -> np.ndarray:
    """The state after a jump."""
    if guard.kind == "contact":
        contact = scene.contact(guard.edge)
        return np.array(contact.impact(t, list(contact.land(t, x.tolist())))[:-1])
    if guard.kind == "edge":
        return np.array(scene.reset(guard.edge)(t, x.tolist()))
    return x


def pass_limit(driver: Driver, mode: str) -> bool:
    """Go over the limit of a cycle, if the last jumps have one; False if they have none.

    ``mode`` is where the last jump leads.
    """
    plan, cycles = driver.plan, driver.cycles
    passes = plan.zeno in ("truncate", "ignore") or driver.status is not None
    if passes or _summed(driver.scene, cycles):
        return False
    slower = _at_once(driver, mode) if cycles.stands else None
    if slower is not None:
        driver.pass_cycle(slower, cycles.seen[-1].x, mode)
        return True
    sought = _sought(cycles, plan)
    if sought is None or driver.record.now.after(sought[0].remaining).until(driver.known) < 0:
        return False
    found, turn = sought
    if not _tire(driver, found):
        return False
    after = driver.scene.spec.mode_after(found.edges)
    if found.ratio == 0.0 and after is None:
        return False
    t = driver.record.now.after(found.remaining).t
    if not persists(driver.scene, turn, t, found.edges, plan.rtol):
        return False
    if not turn.stays(plan.rtol):
        if cycles.seen[-1].edge != (after.limit_of if after else found.edges)[-1]:
            cycles.again()
            return False
        found = attrs.evolve(found, limits=_named(turn))
    driver.pass_cycle(found, cycles.seen[-1].x, mode)
    return True


def _at_once(driver: Driver, mode: str) -> CycleLimit | None:
    """The limit of impacts that stand, and slow down for ever at one instant."""
    if driver.record.memory is not None:  # what delays see may change with each of them
        return None
    recent = driver.cycles.seen[-STILL_JUMPS:]
    spent = _between(recent[0], recent[-1]) + _tick(STILL_JUMPS, recent[-1].t)
    return collapse(driver.scene, mode, recent, spent)


def _sought(cycles: Cycles, plan: Plan) -> tuple[CycleLimit, Turn] | None:
    """The limit of the last jumps, as well as it is wanted, or as the little time left shows it."""
    rtol, atol = plan.closing * plan.rtol, plan.closing * plan.limit
    if cycles.stands:
        return cycles.reached(rtol, atol)
    own = [(plan.rtol, plan.limit, rtol)] if plan.closing < 1.0 else []
    for *known, left in [(rtol, atol, np.inf), *own, (DROWNED, 0.0, DROWNING)]:
        sought = cycles.limit(*known)
        if sought is not None and sought[0].remaining <= left * cycles.longest:
            return sought
    return None


def _named(turn: Turn) -> tuple[tuple[str, np.ndarray], ...]:
    """The jumps of a turn, and the limits of the states after them."""
    edges = [seen.edge for seen in turn.seen[1:]]
    return tuple(zip(edges, turn.limits[1:], strict=True))


def _summed(scene: Scene, cycles: Cycles) -> bool:
    """Whether a cycle is left to the chatter map: impacts of one contact that damps them all."""
    last = cycles.seen[-1]
    if cycles.period != 1 or not scene.is_contact(last.edge):
        return False
    return scene.contact(last.edge).law(last.t, last.x.tolist(), -0.0) < 1.0 - 1e-12


def _tire(driver: Driver, found: CycleLimit) -> bool:
    """Whether each contact of a cycle damps slow impacts as well, down to rest."""
    scene, turn = driver.scene, driver.cycles.seen[-len(found.edges) :]
    for seen in turn:
        if scene.is_contact(seen.edge):
            guard = scene.field(seen.mode).guards[scene.field(seen.mode).column(seen.edge)]
            speed = abs(guard.lie(seen.t, seen.x.tolist())[1])
            contact, x = scene.contact(seen.edge), seen.x.tolist()
            if not damps(contact, seen.t, x, speed, found.ratio):
                return False
    return True
