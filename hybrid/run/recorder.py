"""Collects what a run leaves: arcs, jumps, grazings, samples and the time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile
from math import ulp
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..delay.memory import Memory
from ..errors import JumpLoopError
from ..events import STRUCK
from ..lowering import Field
from ..rules.guards import TIE
from ..rules.lanes import CAUGHT
from ..segment import Segment, projected
from ..trajectory.accumulation import Accumulation
from ..trajectory.arcs import Arc, JumpRow, Part, TailPart
from ..trajectory.clock import Instant
from ..trajectory.log import Flights, Log
from ..trajectory.plan import Plan
from ..trajectory.trajectory import Jump
from ..zeno.accumulate import Tail
from ..zeno.cycle import CycleLimit

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Accumulations of one cycle accumulate in turn if so many intervals between them have shrunk, the
#: last to so small a share of the first.
HEAP, VANISHING = 8, 1e-5

#: Accumulations of impacts stall if so many take so small a share of the time so far, and no less,
#: up to this factor, than as many before: states are known to 1e-16, and times to its square root.
STALLED, STALL, STALL_FALL = 50, 1e-9, 0.9

#: What to do where jumps follow each other with no time between them; and where these are impacts
#: of several contacts.
ENDLESS = (
    "a reset must leave its guard, a contact needs rests=True, and a cycle of edges has a limit "
    "only where its resets lead back to where it began, which those that draw do not"
)
COLLAPSE = (
    "bodies that collapse onto each other strike in no order that repeats, and where that leads is "
    "not known: join those that stay together to one body, or let them bounce more"
)


class Recorder:
    """Grows as the run goes on; ``now`` and ``j`` are its hybrid time, ``made`` the number of its
    jumps.

    ``impacts``: the names of the contacts.
    """

    def __init__(self, plan: Plan, impacts: frozenset[str]) -> None:
        self.plan = plan
        self.now = Instant(plan.t0)
        self.j = self.made = 0
        self.log = Log()
        self.zeno: list[Accumulation] = []
        self.tails: list[Tail | CycleLimit | None] = []
        self._lasting: list[Accumulation] = []
        self.grazings: list[Jump] = []
        self.sampled: list[np.ndarray] = []
        self.memory: Memory | None = None
        self._begun: tuple[Instant, np.ndarray] | None = None
        self._open: list[Segment] = []
        self._impacts, self._stuck = impacts, CAUGHT - 1
        self._clocks, self._edges = np.empty(0), np.empty(0, dtype=object)  # of the last jumps

    def arc(
        self,
        field: Field,
        first: Numbers,
        last: Numbers,
        length: float,
        segments: Any,
        carried: bool = False,
    ) -> Numbers:
        """Add an arc and move to its end; returns the state there, on the held contacts.

        ``carried``: the arc ends where a guard has jumped over zero; the motion of the contacts
        beyond is not part of it.
        """
        held, segments = self._flown(field, last, length, segments)
        last = last if carried else held
        now, end = self.now, self._end(length)
        project = None if field.project is None else field.onto
        if self.memory is not None and field.leans:
            project = None  # its place was another then
        if self._begun is not None:
            (now, first), self._begun = self._begun, None
            segments, self._open = [*self._open, *_later(segments, now, self.now)], []
            length = (end.t - now.t) + (end.low - now.low)
        row = field.name, self.j, now.t, now.low, length, end.t, first, last, segments, project
        self.keep(Arc(*row))
        self.now = end
        return last

    def _end(self, length: float) -> Instant:
        """The end of an arc: exactly the run's last time, if it was to flow so far."""
        last = self.plan.t1
        return Instant(last) if length == self.now.until(last) else self.now.after(length)

    @property
    def young(self) -> bool:
        """Whether an arc that is still open began at this time, up to rounding."""
        if self._begun is None:
            return False
        return self._begun[0].until(self.now.t) <= TIE * ulp(self.now.t)

    def extend(
        self, field: Field, first: Numbers, last: Numbers, length: float, segments: Any
    ) -> Numbers:
        """Move on within an open arc, to the end of a window of the past."""
        last, segments = self._flown(field, last, length, segments)
        if self._begun is None:
            self._begun = self.now, first
        self._open += _later(segments, self._begun[0], self.now)
        self.now, self._reached = self.now.after(length), last
        return last

    @property
    def since(self) -> float:
        """The time at which the open arc began, or the last one."""
        if self._begun is not None:
            return self._begun[0].t
        return self.log.kept[-1].t0 if self.log.kept else self.now.t

    def close(self, field: Field) -> None:
        """End an open arc that has gone on through windows of the past."""
        if self._begun is not None:
            self.arc(field, self._begun[1], self._reached, 0.0, [])

    def _flown(
        self, field: Field, last: Numbers, length: float, segments: Any
    ) -> tuple[np.ndarray, Any]:
        """The end and the segments of a flight, on the held contacts and as recorded for delays."""
        kept = self.plan.dense or self.plan.samples is not None
        if not (kept or (self.memory is not None and not self.memory.told)):
            segments = ()
        if field.project is not None:
            last = field.at_end(self.now.t + length, last) if length > 0.0 else last
            segments = [projected(s, self.now.t, field.onto) for s in segments]
        if self.memory is not None:
            self.memory.flown(self.now, segments)
        return last, segments if kept else ()

    def keep(self, part: Part) -> None:
        """Keep a part: whole, or only its ends and the samples asked for."""
        plan = self.plan
        self._began([part.mode], [part.t0])
        self._sample(part)
        if isinstance(part, TailPart) and self.memory is not None:
            self.memory.tail(part)
        if isinstance(part, Arc) and part.segments and not plan.dense:
            part = attrs.evolve(part, segments=())
        self.log.add(part)

    def flights(self, flights: Flights, where: Callable[[int], str], clocks: Numbers) -> None:
        """Add consecutive arcs and the jumps after them, and move to the last; see :meth:`jump`."""
        jumps = flights.jumps
        if self.memory is not None:
            self.memory.flights(flights)
        self._keep_flights(flights)
        self.now = Instant(float(jumps.t[-1]), float(jumps.low[-1]))
        self.j += len(jumps.t)
        self.made += len(jumps.t)
        self._count(clocks, jumps.edge, where)

    def _keep_flights(self, flights: Flights) -> None:
        """Keep consecutive arcs; the first may have begun in an earlier window of the past."""
        if self._begun is not None:
            arc, row = flights.arcs[0], next(flights.rows())
            (begun, x), self._begun = self._begun, None
            now = Instant(arc.t0, arc.low)
            segments = [*self._open, *_later(arc.segments, begun, now)]
            length, self._open = (row.t - begun.t) + (row.low - begun.low), []
            ends = length, row.t, x, arc.last
            since = arc.mode, arc.j, begun.t, begun.low
            self.keep(Arc(*since, *ends, segments, arc.project))
            self.log.jump(row)
            if len(flights.modes) == 1:
                return
            flights = flights.later()
        self._sample(flights)
        if self._lasting:
            self._began(flights.modes.tolist(), [flights.t, *flights.jumps.t[:-1]])
        if flights.steps is not None and not self.plan.dense:
            flights = attrs.evolve(flights, steps=None)
        self.log.add(flights)

    def _sample(self, part: Part | Flights) -> None:
        """The states of a part at the sample times."""
        if self.plan.samples is None:
            return
        samples = self.plan.samples
        for t in samples[(samples >= part.t0) & (samples < part.t1)].tolist():
            arc = part if isinstance(part, Arc) else part.arc_at(t)
            self.sampled.append(arc.local((t - arc.t0) - arc.low))

    def end_on(self, x: StateVector) -> None:
        """Let the last arc end exactly on the guard."""
        arc = self.log.kept[-1]
        assert isinstance(arc, Arc)
        self.log.kept[-1] = arc.ending(x)

    def jump(
        self,
        edge: str,
        before: StateVector,
        after: StateVector,
        where: Callable[..., str],
        clock: float,
    ) -> None:
        """Add a jump after the last arc. ``where(state)`` describes the place, for messages.

        ``clock`` is the time less idle flights.

        Raises
        ------
        JumpLoopError
            If too many jumps follow each other with no time between them (4).
        """
        now = self.now
        if self.memory is not None:
            arc = self.log.kept[-1]
            mode = arc.mode if isinstance(arc, Arc) else ""
            self.memory.jumped(now.t, before, after, (edge, mode))
        self.log.jump(JumpRow(now.t, now.low, edge, before, after))
        self.j += 1
        self.made += 1
        one = np.array([clock]), np.array([edge], dtype=object)
        self._count(*one, lambda _: where(before))

    def _count(self, clocks: Numbers, edges: np.ndarray, where: Callable[[int], str]) -> None:
        """Count consecutive jumps with no time between them; refuse too many."""
        new, clocks = len(clocks), np.concatenate([self._clocks, clocks])
        edges = np.concatenate([self._edges, edges])
        self._clocks, self._edges = clocks[1 - CAUGHT :], edges[1 - CAUGHT :]
        if len(clocks) < CAUGHT:
            return
        last = clocks[CAUGHT - 1 :]
        caught = last - clocks[: 1 - CAUGHT] <= 4 * CAUGHT * np.spacing(abs(last))
        if not caught.any():
            self._stuck = CAUGHT - 1
            return
        for k, stuck in enumerate(caught.tolist()):
            self._stuck = self._stuck + 1 if stuck else CAUGHT - 1
            among = dict.fromkeys(edges[k : k + CAUGHT].tolist())
            impacts = self._impacts.issuperset(among)
            if self._stuck >= (STRUCK if impacts else CAUGHT):
                remedy = COLLAPSE if impacts and len(among) > 1 else ENDLESS
                raise JumpLoopError(
                    f"{where(new - len(caught) + k)}: {self._stuck} jumps with no time to speak of "
                    f"between them: {' -> '.join(among)}; {remedy}"
                )

    def limit_point(self, point: Accumulation, tail: Tail | CycleLimit | None) -> None:
        """Add an accumulation, and the tail that was summed."""
        self.zeno.append(point)
        self.tails.append(tail)
        self._lasting += [point] if point.mode is not None else []

    def heaps(self) -> float | None:
        """The approximate time at which accumulations of one cycle accumulate in turn; None if they
        do not.

        Heights go with the square of times, so rounding leaves the last flights 1e-7 of the
        longest.
        """
        edges = self.zeno[-1].edges
        alike = takewhile(lambda point: point.edges == edges, reversed(self.zeno))
        gaps = -np.diff([point.t for point in alike])
        grow = np.flatnonzero(gaps[1:] <= gaps[:-1])
        gaps = gaps[: grow[0] + 1] if len(grow) else gaps
        if len(gaps) < HEAP or gaps[0] > VANISHING * gaps[-1]:
            return None
        return float(self.zeno[-1].t + gaps[0] * gaps[0] / (gaps[1] - gaps[0]))

    def stalls(self) -> float | None:
        """The time at which accumulations follow each other with almost no time between them,
        without coming closer: rounding keeps the bodies from rest. None if they do not."""
        last = [point.t for point in self.zeno[-2 * STALLED - 1 :]]
        if len(last) <= 2 * STALLED:
            return None
        early, late = last[STALLED] - last[0], last[-1] - last[STALLED]
        still = late <= STALL * (last[-1] - self.plan.t0) and late >= STALL_FALL * early
        return last[-1] if still else None

    def latest(self) -> list[str]:
        """The edges of the accumulations that currently follow each other."""
        points = self.zeno[-HEAP:]
        return list(dict.fromkeys(edge for point in points for edge in point.edges))

    def _began(self, modes: Sequence[str], starts: Sequence[float]) -> None:
        """Note the modes and starts of arcs: what followed an accumulation was left where the first
        begins that does not belong to it."""
        for point in self._lasting:
            others = {mode for mode in dict.fromkeys(modes) if not point.stays(mode)}
            if others:
                arcs = zip(modes, starts, strict=True)
                point.t_release = float(next(t for mode, t in arcs if mode in others))
        self._lasting = [point for point in self._lasting if point.t_release is None]


def _later(segments: Any, begun: Instant, now: Instant) -> list[Segment]:
    """Segments with local times counted from an earlier instant."""
    since = (now.t - begun.t) + (now.low - begun.low)
    return [segment.later(since) for segment in segments]
