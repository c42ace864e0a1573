"""The parts of a trajectory: arcs, and chattering tails that stand for infinitely many arcs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..errors import OptionError
from ..lowering.scene import parted
from ..segment import Segment, straight
from ..zeno.accumulate import Tail
from .clock import Instant

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector


class _Moded:
    """Properties of a part that follow from the name of its mode."""

    mode: str

    @property
    def held(self) -> tuple[str, ...]:
        """The contacts at rest; empty if there are none."""
        return self.flown_in[1]

    @property
    def flown_in(self) -> tuple[str, tuple[str, ...]]:
        """The declared mode, and the contacts at rest."""
        return parted(self.mode)

    @property
    def sliding(self) -> str | None:
        """The switching on whose surface the state slides; None if it does not slide."""
        mode = parted(self.mode)[0]
        return mode.removeprefix("slide(").removesuffix(")") if mode.endswith(")") else None

    @property
    def constrained(self) -> bool:
        """Whether the state stays on a surface: at rest on contacts, or sliding."""
        return self.mode.endswith(")")


@attrs.frozen(eq=False)
class Arc(_Moded):
    """A piece of the trajectory between two jumps.

    Attributes
    ----------
    mode : str
        The mode; ``"<mode>.rest(<contact>)"`` at rest, ``"slide(<switching>)"`` while sliding.
        ``held`` and ``sliding`` give the contacts and the switching.
    j : int
        Number of jumps before the arc.
    t0 : float
        Start time.
    low : float
        Rounding error of ``t0``: the arc starts at ``t0 + low`` (compensated sum).
    length : float
        Duration; exact where ``t1 - t0`` would round to zero.
    t1 : float
        End time: that of the next jump, or the run's last time.
    first, last : array
        States at the start and at the end.
    segments : sequence of Segment
        Dense output in local time; empty if none was kept.
    project : callable or None
        At rest or sliding: the projection ``(t, x)`` of interpolated states.
    """

    mode: str
    j: int
    t0: float
    low: float
    length: float
    t1: float
    first: Numbers
    last: Numbers
    segments: Sequence[Segment]
    project: Callable[..., Any] | None = None

    def ending(self, x: StateVector) -> Arc:
        """The same arc with the final state ``x``."""
        row = self.mode, self.j, self.t0, self.low, self.length, self.t1, self.first, x
        return Arc(*row, self.segments, self.project)

    def then(self, other: Arc) -> Arc:
        """This arc joined with ``other``, which continues it in the same mode."""
        since = (other.t0 - self.t0) + (other.low - self.low)
        segments = [*self.segments, *(segment.later(since) for segment in other.segments)]
        length = since + other.length
        ends = length, other.t1, self.first, other.last
        return Arc(self.mode, self.j, self.t0, self.low, *ends, segments, other.project)

    def local(self, tau: Any) -> np.ndarray:
        """States at local times in the arc, shape ``tau.shape + (n,)``."""
        tau = np.asarray(tau, dtype=float)
        flat = np.clip(np.atleast_1d(tau).reshape(-1), 0.0, self.length)
        states = np.empty((len(flat), len(self.first)))
        if not len(flat):
            return states.reshape((*tau.shape, len(self.first)))
        segments = self.segments
        if not segments:
            return self._ends(flat).reshape((*tau.shape, len(self.first)))
        starts = [segment.start for segment in segments]
        which = np.clip(np.searchsorted(starts, flat, side="right") - 1, 0, None)
        for index in np.unique(which):
            chosen = which == index
            states[chosen] = segments[index](flat[chosen])
        if self.project is not None:
            rows = zip((self.t0 + flat).tolist(), states.tolist(), strict=True)
            states = np.array([self.project(t, x) for t, x in rows])
        states[flat == 0.0] = self.first
        states[flat == self.length] = self.last
        return states.reshape((*tau.shape, len(self.first)))

    def _ends(self, tau: Numbers) -> Matrix:
        """The states at the two ends, for an arc without dense output."""
        if np.any((tau > 0) & (tau < self.length)):
            raise OptionError(
                "no dense output was kept (save='jumps', or times): there are the states at "
                "jumps, at the ends and at the times asked for; use save='dense' for all"
            )
        return np.where((tau == 0.0)[:, None], self.first, self.last)


@attrs.frozen(eq=False)
class JumpRow:
    """A jump as stored: states as vectors, the time in two floats."""

    t: float
    low: float
    edge: str
    before: StateVector
    after: StateVector


class Table(NamedTuple):
    """Jumps as columns: time in two floats, edge, states before and after."""

    t: np.ndarray
    low: np.ndarray
    edge: np.ndarray
    before: StateVector
    after: StateVector

    @classmethod
    def of(cls, rows: list[JumpRow], dimension: int) -> Table:
        """The table of single jumps."""
        names, shape = np.array([row.edge for row in rows], dtype=object), (len(rows), dimension)
        t, low = (np.array([getattr(row, name) for row in rows], float) for name in ("t", "low"))
        states = (np.array([getattr(r, side) for r in rows], float) for side in ("before", "after"))
        return cls(t, low, names, *(x.reshape(shape) for x in states))


@attrs.frozen(eq=False)
class TailPart(_Moded):
    """A chattering tail in a trajectory: ``tail.count + 1`` arcs, from number ``j`` on."""

    tail: Tail
    j: int

    @property
    def mode(self) -> str:  # type: ignore[override]  # read only, as attributes of a frozen class
        return self.tail.field.name

    @property
    def t0(self) -> float:
        return self.tail.t

    @property
    def t1(self) -> float:
        return Instant(self.tail.t, self.tail.low).after(self.tail.remaining).t

    @property
    def last(self) -> Numbers:
        return self.tail.x_inf

    def arc(self, n: int) -> Arc:
        """The arc after the tail's impact ``n``, which ends where the next is listed, or the limit
        is."""
        tail, flight, (times, lows) = self.tail, self.tail.flight(n), self.times
        x = tail.point(tail.r**n)[1] if n else tail.x
        if n == tail.count:
            until, t1, end = tail.remaining, self.t1, tail.x_inf
        else:
            until, t1, end = tail.times[n + 1], float(times[n + 1]), tail.impacts[0][n]
        if flight is None:  # a line
            length = float(until - tail.times[n])
            segments = [straight(0.0, length, x, end)]
        else:  # its own length, which has its digits where times have none
            length, segments = flight.time, flight.segments()
        began = float(times[n]), float(lows[n])
        return Arc(self.mode, self.j + n, *began, length, t1, x, end, segments)

    def jump(self, n: int) -> JumpRow:
        """The tail's impact ``n`` (1, 2, ...)."""
        t, low, edge, before, after = (column[n - 1] for column in self.jumps)
        return JumpRow(float(t), float(low), edge, before, after)

    @cached_property
    def jumps(self) -> Table:
        """All listed impacts of the tail."""
        t, low = self.times[:, 1:]
        names = np.full(len(t), self.tail.contact.name, dtype=object)
        return Table(t, low, names, *self.tail.impacts)

    @cached_property
    def times(self) -> Numbers:
        """The times of the impacts in two floats, one row each; first that of the impact from which
        they are summed."""
        begin = Instant(self.tail.t, self.tail.low)
        listed = (begin.after(since) for since in self.tail.times.tolist())
        return np.array([[now.t, now.low] for now in listed]).T

    def arc_at(self, t: float, side: str = "right") -> Arc:
        """The arc of the tail that covers time ``t``, by the listed impact times."""
        return self.arc(max(int(np.searchsorted(self.times[0], t, side=side)) - 1, 0))  # type: ignore[call-overload]


Part = Arc | TailPart


def arcs_of(part: Part) -> Iterator[Arc]:
    """The arc that a part is, or the listed flights of a sum of impacts."""
    return iter([part]) if isinstance(part, Arc) else map(part.arc, range(part.tail.count + 1))
