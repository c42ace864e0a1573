"""Cycles of jumps that accumulate: when to look for a limit, and where it is.

:mod:`.limits` decides whether the run passes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import accumulate, pairwise, takewhile
from math import ulp
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..lowering import Field, Guard, Scene
from ..rules.entries import POSITION_ROUNDING
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
from ..rules.zeros import EPS
from ..trajectory.clock import Instant
from ..zeno.cycle import Clock, CycleLimit, accelerated, limit, period

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Numbers, StateVector

#: Most jumps that are remembered.
REMEMBERED_JUMPS = 1 << 14

#: The least change of a counter in a turn, relative to its largest; a speed is some 1e-5 of the
#: first where rounding of the position ends the flights.
LEAST_COUNT = 1e-3

#: The largest value at the limit of guards, and of what resets change, relative to the first turn,
#: beside what is not known of the states there. (Turns may shrink to a length that is small against
#: the first, and not zero.)
ZERO = 1e-12

#: Jumps within so many spacings of floats are at one time.
TICKS = 4

#: For cycles of one jump, two, and so on: the places of the last jumps of some turns, latest first.
LAST_TURNS = -1 - np.outer(np.arange(1, LONGEST_CYCLE + 1), np.arange(FEW_TURNS + 1))


class Seen(NamedTuple):
    """A jump: its edge, the mode that it left, its time in two floats, and the state after it.

    ``clock`` is the time less that spent in idle flights (:func:`idle`).
    """

    edge: str
    mode: str
    t: float
    low: float
    clock: float
    x: StateVector

    def until(self, last: Seen) -> float:
        """The time from here to another."""
        return (last.t - self.t) + (last.low - self.low)


class Columns(NamedTuple):
    """Jumps as columns: see :class:`Seen`."""

    edge: Any
    mode: Any
    t: Any
    low: Any
    clock: Any
    x: Any

    @classmethod
    def of(cls, *jump: Any) -> Columns:
        """One jump."""
        kinds = object, object, float, float, float, float
        return cls(*[np.array([own], kind) for own, kind in zip(jump, kinds, strict=True)])

    def put(self, begin: int, others: Columns) -> None:
        """Put others in their places."""
        for column, own in zip(self, others, strict=True):
            column[begin : begin + len(own)] = own

    def part(self, places: slice) -> Columns:
        """Some of them; they are not copied."""
        return Columns(*[column[places] for column in self])

    def rows(self) -> list[Seen]:
        """One by one."""
        t, low, clock = self.t.tolist(), self.low.tolist(), self.clock.tolist()
        rows = zip(self.edge, self.mode, t, low, clock, self.x.copy(), strict=True)
        return [Seen(*row) for row in rows]

    def since(self, places: Integers) -> Numbers:
        """The times of some since the first of them."""
        t, low = self.t[places], self.low[places]
        return (t - t[0]) + (low - low[0])  # type: ignore[no-any-return]

    def spans(self, places: Integers) -> Numbers:
        """The durations from each of some to the next."""
        return np.diff(self.t[places]) + np.diff(self.low[places])


NO_JUMPS = Columns.of("", "", 0.0, 0.0, 0.0, [0.0]).part(slice(0))


def idle(scene: Scene, field: Field, guard: Guard, t: float, x: StateVector, s: float) -> bool:
    """Whether a flight of length ``s`` stayed within rounding of the guard that ended it.

    Such a flight is ended by rounding, and its length means nothing. (In low flights onto a contact
    the gap is a coordinate of its own.)
    """
    if guard.kind not in ("edge", "switch"):
        return False
    value, rate, bend = guard.lie(t, x.tolist())
    height = abs(value) + abs(rate) * s + 0.5 * abs(bend) * s * s
    return bool(height <= 64 * EPS * scene.rounding(guard, field)(t, x.tolist())[0])


def blurs(scene: Scene, seen: Columns, closings: Integers, length: int) -> Numbers:
    """How far the rounding of guards may put off the times of jumps that close turns.

    A guard is zero to the rounding of its terms. How fast it comes there is told by the parabola
    from where its flight began.
    """
    first = max(int(closings[0]) - length, 0)
    last = seen.part(slice(first, int(closings[-1]) + 1)).rows()
    off = np.zeros(len(last))
    for k, (now, jump) in enumerate(pairwise(last)):
        field, s = scene.field(jump.mode), now.until(jump)
        guard = next((guard for guard in field.guards if guard.edge == jump.edge), None)
        if guard is not None and s > 0.0:
            value, rate, _ = guard.lie(now.t, now.x.tolist())
            size = scene.rounding(guard, field)(now.t, now.x.tolist())[0]
            rounding, speed = EPS * size, abs(2.0 * value / s + rate)
            off[k + 1] = rounding / speed if rounding < s * speed else s
    ends = np.cumsum(off)[closings - first]
    return np.diff(ends, prepend=0.0)


@attrs.frozen(eq=False)
class Turn:
    """The last turn of a cycle, and the limits of its jumps.

    Attributes
    ----------
    seen : list of Seen
        The jumps of the turn, preceded by the last one of the turn before.
    first : list of Seen
        The jumps of the first turn looked at; they give the sizes with which the cycle began.
    limits, errors : list of array
        The limits of the states after these jumps, and bounds on their errors.
    moved : array
        How far the states have moved in that first turn. At the jumps alone one that is zero at
        each of them, but for rounding, has not.
    """

    seen: list[Seen]
    first: list[Seen]
    limits: list[np.ndarray]
    errors: list[np.ndarray]
    moved: Numbers

    def slack(self, k: int, rtol: float) -> Numbers:
        """How far a state near the k-th limit may be from it."""
        return ZERO * self.moved + 10 * self.errors[k] + 10 * rtol * np.abs(self.limits[k])

    def known(self, k: int) -> Numbers:
        """How well the k-th limit is known."""
        return 10 * self.errors[k] + 64 * EPS * np.abs(self.limits[k])

    def stays(self, rtol: float) -> bool:
        """Whether no reset moves the state at the limit."""
        slack, last = self.slack(-1, rtol), self.limits[-1]
        return all(np.all(np.abs(x - last) <= slack) for x in self.limits)


class Ahead(NamedTuple):
    """A limit that is known, to which the run flies on: when it is, the limit and the last turn as
    they were found, and how many jumps the run had made."""

    t: Instant
    found: CycleLimit
    turn: Turn
    made: int


class Cycles:
    """The jumps of a run since its last accumulation.

    Attributes
    ----------
    seen : Columns
        The jumps remembered.
    longest : float
        The longest flight of the run.
    spent : float
        The time spent in idle flights.
    standing : int
        How many jumps there must be before those that take no time are looked at once more.
    beside : sequence of int
        Elements of the state on which nothing else depends; they need not have a limit.
    ahead : Ahead or None
        The limit to which the run flies on.
    """

    def __init__(self, beside: Sequence[int] = ()) -> None:
        self.beside = beside
        self.ahead: Ahead | None = None
        self.longest = self.spent = 0.0
        self.asked = self.stands = False
        self.next, self.standing = 2 * LEAST_WINDOW, 0
        self.seen = self._room = NO_JUMPS
        self.before = frozenset[str]()

    def clock(
        self, scene: Scene, field: Field, guard: Guard, t: float, x: StateVector, s: float
    ) -> float:
        """The time less idle flights, after one more flight, of length ``s``."""
        if s > IDLE_FLIGHT * self.longest:
            self.longest = max(s, self.longest)
        elif s > 0 and idle(scene, field, guard, t, x, s):
            self.spent += s
        return t + s - self.spent

    def plain(self, lengths: Numbers) -> bool:
        """Whether none of several flights in a row is short enough to be idle; if so, they are
        noted."""
        known = lengths.tolist()
        longest = max(self.longest, *known)
        if not min(known) > IDLE_FLIGHT * longest:
            before = accumulate(known, max, initial=self.longest)
            if not all(s > IDLE_FLIGHT * most for s, most in zip(known, before, strict=False)):
                return False
        self.longest = longest
        return True

    def room(self, t: Numbers, low: Numbers) -> int:
        """How many of the jumps at these times may be noted before it is time to look for a
        limit."""
        if self.asked:
            return min(len(t), 1)
        kept, known = len(self.seen.t), self.seen.t[-STILL_JUMPS:]
        if self.next <= kept + len(t):
            self._wait(np.append(self.seen.t, t), np.append(self.seen.low, low))
        count = min(len(t), self.wait)
        if len(known) + count <= FEW_TURNS:  # not one turn more than there must be
            return count
        together = np.append(known, t[:count])
        looks, gaps = np.zeros(len(together), dtype=bool), together[1:] - together[:-1]
        short = gaps <= IDLE_FLIGHT * np.maximum(self.longest, np.maximum.accumulate(gaps))
        if short.any():
            number = np.arange(1, len(together))
            run = number - np.maximum.accumulate(np.where(short, 0, number))
            looks[1:] = (run > 0) & (run % STILL_JUMPS == 0)
        for length in range(1, min(LONGEST_CYCLE, (len(together) - 1) // FEW_TURNS) + 1):
            turns = together[length:] - together[:-length]
            falls = turns[length:] <= FAST_FALL * turns[:-length]
            looks[FEW_TURNS * length :] |= falls[length:] & falls[:-length]
        found = np.flatnonzero(looks[len(known) :])
        return int(found[0]) + 1 if len(found) else count

    def _wait(self, t: Numbers, low: Numbers) -> None:
        """Wait longer where the windows of the known jumps do not shrink."""
        while self.next <= min(len(t), REMEMBERED_JUMPS) and not _shrinks(t, low, self.next):
            self.next += max(LEAST_WAIT, self.next // WINDOW_PART)

    def saw(self, jumps: Columns) -> bool:
        """Note jumps, no more than there is room for; returns whether to look for a limit."""
        self._note(jumps)
        due = self._falls() or self._stops() or self.asked
        self.asked = False
        if len(self.seen.t) < self.next:
            return due
        if len(self.seen.t) > REMEMBERED_JUMPS:
            self.seen, self._room = self.seen.part(slice(REMEMBERED_JUMPS // 2, None)), NO_JUMPS
        self.next = count = len(self.seen.t)
        self.next += max(LEAST_WAIT, count // WINDOW_PART)
        return due or _shrinks(self.seen.t, self.seen.low, count)

    def _note(self, jumps: Columns) -> None:
        """Append jumps; the arrays double when they are full."""
        begin = len(self.seen.t)
        end = begin + len(jumps.t)
        if not begin:
            self.seen, self._room = jumps, NO_JUMPS
            return
        if end > len(self._room.t):
            shapes = [(2 * end, *own.shape[1:]) for own in jumps]
            self._room = Columns(*map(np.empty, shapes, [own.dtype for own in jumps]))
            self._room.put(0, self.seen)
        self._room.put(begin, jumps)
        self.seen = self._room.part(slice(end))

    def _falls(self) -> bool:
        """Whether the last turns of a cycle shrink so fast that few will follow."""
        lengths = min(LONGEST_CYCLE, (len(self.seen.t) - 1) // FEW_TURNS)
        if not lengths:
            return False
        places = LAST_TURNS[:lengths]
        t, low = self.seen.t[places], self.seen.low[places]
        turns = (t[:, :-1] - t[:, 1:]) + (low[:, :-1] - low[:, 1:])
        last, before = turns[:, :-1], turns[:, 1:]
        fast = ((last > 0) & (last <= FAST_FALL * before)).all(axis=1)
        edges = [self.seen.edge[own].tolist() for own in places[fast]]
        return any(own.count(own[0]) == len(own) for own in edges)

    def _stops(self) -> bool:
        """Whether the last jumps have taken no time; true when it begins, and whenever there are
        twice as many, as the states may take a while to come round."""
        stood, self.stands, clock = self.stands, False, self.seen.clock
        if len(clock) >= STILL_JUMPS:
            spent = clock[-1] - clock[-STILL_JUMPS]
            self.stands = bool(spent <= _tick(STILL_JUMPS, self.seen.t[-1]))
        due = self.stands and not (stood and len(clock) < self.standing)
        self.standing = 2 * len(clock) if due else self.standing
        return due

    def first_of(self, edge: str) -> float:
        """The time of the first of the last jumps that are all of this edge."""
        count = sum(1 for _ in takewhile(edge.__eq__, reversed(self.seen.edge.tolist())))
        return float(self.seen.t[-count])

    def last_of(self, edge: str) -> Seen | None:
        """The last of the jumps of an edge that are remembered."""
        places = np.flatnonzero(self.seen.edge == edge)
        return self.seen.part(slice(places[-1], places[-1] + 1)).rows()[0] if len(places) else None

    @property
    def latest(self) -> frozenset[str]:
        """The edges of the last jumps, as many as a cycle may have; where there are none yet, of
        those before the last accumulation."""
        return frozenset(self.seen.edge[-LONGEST_CYCLE:].tolist()) or self.before

    @property
    def wait(self) -> int:
        """How many more jumps there may be before it is looked for a limit again."""
        return self.next - len(self.seen.t)

    def again(self) -> None:
        """Look for a limit again at the next jump."""
        self.asked, self.stands = True, False

    def fly_to(self, now: Instant, found: CycleLimit, turn: Turn, made: int) -> None:
        """Fly on to a limit, and look again at the next jump."""
        if self.ahead is None:
            self.ahead = Ahead(now.after(found.remaining), found, turn, made)
        self.again()

    def known(self, now: Instant, made: int) -> tuple[CycleLimit, Turn] | None:
        """The limit to which the run flies on, if its jumps still lead there, and a turn ends
        here."""
        if self.ahead is None:
            return None
        at, found, turn, before = self.ahead
        remaining = now.until(at.t) + at.low
        if not remaining > 0.0 or self.period != len(found.edges):
            self.ahead = None
        elif (made - before) % (len(turn.seen) - 1):
            self.again()
        else:
            return attrs.evolve(found, remaining=remaining), turn
        return None

    def forget(self) -> None:
        """Start anew, after an accumulation."""
        self.before, self.seen, self.ahead = self.latest, NO_JUMPS, None
        self.next, self.stands, self.standing = 2 * LEAST_WINDOW, False, 0

    @property
    def period(self) -> int:
        """The number of jumps in a turn, by the edges of the last few turns; 0 for none."""
        edges = self.seen.edge[-LONGEST_CYCLE * (FEW_TURNS + 1) :]
        return period(edges.tolist(), FEW_TURNS)

    def counts(self) -> list[int]:
        """The elements of the state that the last turn changed by no less than the turn before, as
        a counter does, and not by what rounding leaves of what has come to rest."""
        length = self.period
        if not length:
            return []
        x = self.seen.x[self._closings(length)]
        turns, rounding = np.abs(np.diff(x, axis=0)), 64 * EPS * np.abs(x).max(axis=0)
        last = turns[-1] > np.maximum(LEAST_COUNT * turns.max(axis=0), rounding)
        counts = last & (turns[-1] >= WINDOW_FALL * turns[-2])
        return np.setdiff1d(np.flatnonzero(counts), self.beside).tolist()  # type: ignore[no-any-return]

    def limit(
        self, scene: Scene, rtol: float, atol: float, lost: tuple[float, float]
    ) -> tuple[CycleLimit, Turn] | None:
        """The limit at which the last jumps accumulate, and the last turn; None if they do not.

        The states may come round after several turns of the edges: a reset may change a sign.
        ``lost``: what steps may lose, relative and absolute.
        """
        shortest = self.period
        for length in range(shortest, LONGEST_CYCLE + 1, shortest) if shortest else ():
            closings = self._shrinking(length)
            times, states = self.seen.since(closings), self.seen.x[closings]
            blur = partial(blurs, scene, self.seen, closings, length)
            ends = rtol, atol, self.beside, blur, self.seen.spans(closings), lost
            found = limit(self._cycle(shortest), times, states, *ends)
            turn = None if found is None else self._turn(scene, length, found)
            if found is not None and turn is not None:
                return attrs.evolve(found, ratio=found.ratio ** (shortest / length)), turn
        return None

    def reached(
        self, rtol: float, atol: float, largest: StateVector
    ) -> tuple[CycleLimit, Turn] | None:
        """The limit at which the last jumps stand still, if they do: no time passes and the states
        come round. They have the rounding of the ``largest`` states seen.

        Its ratio is that of the last turns that took time; 0 if these were not seen to shrink. If
        they were, rounding may have made them stand still before they did: the last of them may be
        short of all that they come to.
        """
        shortest, t = self.period, float(self.seen.t[-1])
        for length in range(shortest, LONGEST_CYCLE + 1, shortest) if shortest else ():
            closings = self._closings(length)
            if len(closings) > FEW_TURNS:
                turn = self._standing(length)
                slack = [rtol * np.abs(x) + atol for x in turn.limits]
                known = [e <= s for e, s in zip(turn.errors, slack, strict=True)]
                if np.delete(known, self.beside, axis=1).all():
                    rounding = POSITION_ROUNDING * EPS * largest
                    turn = attrs.evolve(turn, errors=[np.maximum(e, rounding) for e in turn.errors])
                    times = np.diff(self.seen.clock[closings])
                    times = times[times > _tick(length, t)]
                    ratio, short = _shortened(times)
                    last = ratio ** (shortest / length), self.still + short, turn.errors[-1]
                    place = self._cycle(shortest), 0.0, turn.limits[-1]
                    return CycleLimit(*place, *last, FEW_TURNS + 1), turn
        return None

    @property
    def still(self) -> float:
        """The time taken by the last jumps, where these are taken to stand still."""
        first = max(0, len(self.seen.t) - STILL_JUMPS)
        spent = _between(self.seen.t, self.seen.low, first, -1)
        return spent + _tick(STILL_JUMPS, float(self.seen.t[-1]))

    def last(self, count: int, before: int = 0) -> list[Seen]:
        """The last jumps as rows; ``before``: those before the last few."""
        end = len(self.seen.t) - before
        return self.seen.part(slice(max(0, end - count), end)).rows()

    def _cycle(self, length: int) -> tuple[str, ...]:
        """The edges of a turn, beginning with the same edge whichever jump is last."""
        edges = self.seen.edge[-length:].tolist()
        return min(tuple(edges[k:] + edges[:k]) for k in range(length))

    def _closings(self, length: int, back: int = 0) -> Integers:
        """The places of every ``length``-th jump, as far back as their edges and modes agree, from
        ``back`` jumps ago on."""
        places = np.arange(len(self.seen.t) - 1 - back, -1, -length)
        edges, modes = self.seen.edge[places], self.seen.mode[places]
        other = np.flatnonzero((edges != edges[0]) | (modes != modes[0]))
        return places[: other[0] if len(other) else None][::-1]

    def _shrinking(self, length: int) -> Integers:
        """The last closings, as far back as each turn was longer than the next."""
        closings = self._closings(length)
        turns = np.diff(self.seen.since(closings))
        longer = np.flatnonzero(~(turns[:-1] > turns[1:]))
        return closings[int(longer[-1]) + 1 if len(longer) else 0 :]

    def _turn(self, scene: Scene, length: int, found: CycleLimit) -> Turn | None:
        """The last turn of a cycle whose limit was found, with the limit after each of its
        jumps."""
        limits, errors = [found.x_inf], [found.x_error]
        for back in range(length - 1, 0, -1):
            closings = self._closings(length, back)[-found.turns :]
            if len(closings) <= FEW_TURNS:
                return None
            seen = self.seen.x[closings]
            times, spans = self.seen.since(closings), self.seen.spans(closings)
            clock = Clock.of(times, spans) if found.ratio == 1.0 else None
            x_inf, error, *_ = accelerated(seen, clock, self.beside)
            limits.append(x_inf)
            errors.append(error)
        first = self.last(length + 1, length * (found.turns - 2))
        limits, errors = [*limits, found.x_inf], [*errors, found.x_error]
        return Turn(self.last(length + 1), first, limits, errors, moves(scene, first))

    def _standing(self, length: int) -> Turn:
        """The last turn of a cycle that stands still, with how much the states after each jump
        still move."""
        last = self.last(length + 1)
        phases = [self._closings(length, back)[-FEW_TURNS:] for back in range(length, -1, -1)]
        errors = [np.ptp(self.seen.x[phase], axis=0) for phase in phases]
        for error in errors:
            error[self.beside] = np.where(error[self.beside], np.inf, 0.0)
        moved = np.ptp(np.array([seen.x for seen in last]), axis=0)
        return Turn(last, last, [seen.x for seen in last], errors, moved)


def moves(scene: Scene, turn: list[Seen]) -> Numbers:
    """How far states move in a turn: from jump to jump, or by their rates there in all its time."""
    rates = [scene.field(seen.mode).flow(seen.t, seen.x) for seen in turn]
    fastest = np.nan_to_num(np.abs(rates), posinf=0.0).max(axis=0)
    return np.maximum(  # type: ignore[no-any-return]
        np.ptp(np.array([seen.x for seen in turn]), axis=0), fastest * turn[0].until(turn[-1])
    )


def _shrinks(t: Numbers, low: Numbers, count: int) -> bool:
    """Whether the last window of jumps took less time than the one before."""
    window = max(LEAST_WINDOW, (count - 1) // WINDOW_PART)
    first, middle = max(0, count - 1 - 2 * window), count - 1 - window
    return _between(t, low, middle, count - 1) < WINDOW_FALL * _between(t, low, first, middle)


def _between(t: Numbers, low: Numbers, first: int, last: int) -> float:
    return float((t[last] - t[first]) + (low[last] - low[first]))


def _shortened(turns: Numbers) -> tuple[float, float]:
    """The ratio of the durations of turns that shrink until they are rounded to nothing, and how
    much more than they have taken they may come to; zeros where they were not seen to shrink. The
    last of them may be cut short by that.
    """
    falls = turns[1:] / turns[:-1]
    if not len(falls) or not falls[-1] < WINDOW_FALL:
        return 0.0, 0.0
    ratio = float(min(falls[-2:].max(), WINDOW_FALL))
    return ratio, float(turns[-2]) * ratio / (1.0 - ratio)


def _tick(count: int, t: float) -> float:
    """The rounding of the time over so many jumps."""
    return TICKS * count * ulp(t)
