"""Cycles of jumps that accumulate: watched as a run goes on, and passed like a chattering tail."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..clock import Instant
from ..scene import Guard, Scene
from ..zeno.cycle import LEAST, LONGEST, CycleLimit, limit, period

if TYPE_CHECKING:
    from .driver import Driver

#: Jumps in the windows that are compared, and by how much the later must be shorter.
WINDOW, SHORTER = 12, 0.97

#: Most jumps that are remembered.
MOST = 1 << 14

#: What guards, and what resets change, may be at the limit, against their size in the cycle.
ZERO = 1e-6

#: Points on the way to the limit at which flows are looked at, and how straight they must be.
SAMPLES, SMOOTH = 64, 1e-2


class Seen(NamedTuple):
    """A jump out of a mode, when (in two floats), and the state after it."""

    edge: str
    mode: str
    t: float
    low: float
    x: np.ndarray

    @property
    def now(self) -> Instant:
        return Instant(self.t, self.low)


class Cycles:
    """The jumps of a run since its last accumulation."""

    def __init__(self) -> None:
        self.seen: list[Seen] = []
        self.next = 2 * WINDOW

    @property
    def room(self) -> int:
        """Jumps until it may be time to look for a limit."""
        return self.next - len(self.seen)

    def saw(self, jumps: list[Seen]) -> bool:
        """Note jumps, no more than there is room for; whether it is time to look for a limit."""
        seen = self.seen
        seen += jumps
        if len(seen) < self.next:
            return False
        if len(seen) > MOST:
            del seen[: MOST // 2]
        self.next = len(seen) + max(4, len(seen) // 8)
        middle = seen[-WINDOW - 1]
        return _between(middle, seen[-1]) < SHORTER * _between(seen[-2 * WINDOW], middle)

    def forget(self) -> None:
        """Start anew, after an accumulation."""
        self.seen.clear()
        self.next = 2 * WINDOW

    def limit(self, rtol: float, atol: float) -> tuple[CycleLimit | None, list[Seen]]:
        """Where the last jumps accumulate, if they do, and the jumps of the first cycle."""
        length = period([seen.edge for seen in self.seen[-LONGEST * (LEAST + 1) :]])
        if not length:
            return None, []
        turns = self._turns(length)
        times = np.array([_between(turns[0], turn) for turn in turns])
        states = np.array([turn.x for turn in turns])
        edges = _canonical([seen.edge for seen in self.seen[-length:]])
        found = limit(edges, times, states, rtol, atol)
        return found, self.seen[-length * len(turns) :][: length + 1]

    def _turns(self, length: int) -> list[Seen]:
        """Every so many jumps one, as far back as each turn was longer than the next."""
        turns, shortest = self.seen[-1:], 0.0
        for earlier in self.seen[-1 - length :: -length]:
            duration = _between(earlier, turns[-1])
            if earlier.edge != turns[0].edge or (len(turns) > 1 and not duration > shortest):
                break
            turns.append(earlier)
            shortest = duration
        return turns[::-1]


def _between(first: Seen, last: Seen) -> float:
    return (last.t - first.t) + (last.low - first.low)


def _canonical(edges: list[str]) -> tuple[str, ...]:
    """A cycle, from the same edge on whichever comes last."""
    return min(tuple(edges[k:] + edges[:k]) for k in range(len(edges)))


def persists(scene: Scene, first: list[Seen], found: CycleLimit, now: Seen, rtol: float) -> bool:
    """Whether the cause of a cycle is there at its limit.

    Every guard of the cycle is zero there, every reset leaves the state where it is, no other
    guard of its modes has changed sign on the way, and the flows there change no faster than
    along a straight line.
    """
    t, x = now.now.after(found.remaining).t, found.x_inf
    if not all(_steady(scene, seen.mode, now, t, x) for seen in first):
        return False
    states = np.array([seen.x for seen in first])
    slack = ZERO * np.ptp(states, axis=0) + 10 * found.x_error + 10 * rtol * np.abs(x)
    for seen in first:
        fired = None
        for guard in scene.field(seen.mode).guards:
            fired = guard if guard.edge == seen.edge else fired
            here = guard.value(t, x.tolist())
            if guard.edge not in found.edges:
                if not here * guard.value(now.t, now.x.tolist()) > 0:
                    return False
            elif abs(here) > _allowed(guard, t, x, slack, first):
                return False
        if fired is None or np.any(np.abs(_after(scene, fired, t, x) - x) > slack):
            return False
    return True


def _steady(scene: Scene, mode: str, now: Seen, t: float, x: np.ndarray) -> bool:
    """Whether a mode's flow changes along the way to the limit as a straight line does."""
    rhs, shares = scene.field(mode).rhs, np.linspace(0.0, 1.0, SAMPLES)
    states = now.x + shares[:, None] * (x - now.x)
    times = now.t + shares * (t - now.t)
    rates = np.array([rhs(s, y) for s, y in zip(times.tolist(), states.tolist(), strict=True)])
    straight = rates[0] + shares[:, None] * (rates[-1] - rates[0])
    return bool(np.abs(rates - straight).max() <= SMOOTH * np.abs(rates).max())


def _allowed(guard: Guard, t: float, x: np.ndarray, slack: np.ndarray, first: list[Seen]) -> float:
    """What a guard may be at the limit: little against its size, or what the slack makes of it."""
    size = max(abs(guard.value(seen.t, seen.x.tolist())) for seen in first)
    here = guard.value(t, x.tolist())
    moved = [guard.value(t, (x + step).tolist()) - here for step in np.diag(slack)]
    return ZERO * size + sum(map(abs, moved))


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
    plan = driver.plan
    if plan.zeno == "truncate" or driver.status is not None:
        return False
    found, first = driver.cycles.limit(plan.closing * plan.rtol, plan.closing * plan.limit)
    if found is None or driver.record.now.after(found.remaining).until(driver.known) < 0:
        return False
    last = driver.cycles.seen[-1]
    if _summed(driver.scene, found, last):
        return False
    if not persists(driver.scene, first, found, last, plan.rtol):
        return False
    driver.pass_cycle(found, last.x, mode)
    return True


def _summed(scene: Scene, found: CycleLimit, last: Seen) -> bool:
    """Whether a cycle is left to the chatter map: impacts of one contact that damps them all."""
    if len(found.edges) > 1 or not scene.is_contact(last.edge):
        return False
    contact = scene.contact(last.edge)
    return contact.law(last.t, last.x.tolist(), -0.0) < 1.0 - 1e-12
