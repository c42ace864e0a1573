"""The record of a run in progress: parts and jumps, one at a time or many at once.

A call of the rules' loop leaves thousands of arcs as a few arrays. They are converted to
:class:`Arc` and :class:`JumpRow` only on request; the table of jumps needs arrays anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..lowering.scene import parted
from ..segment import Segment, from_values, nodes, projected
from .arcs import Arc, JumpRow, Part, Table, TailPart

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector


class Steps(NamedTuple):
    """Steps of a solver as columns.

    Attributes
    ----------
    arc : array of int
        Index of the arc to which each step belongs, counted from the first of these arcs.
    start, length : array
        Start in the local time of the arc, and length.
    values : array, shape (steps, degree + 1, n)
        States at :func:`hybrid.segment.nodes`.
    """

    arc: np.ndarray
    start: np.ndarray
    length: np.ndarray
    values: np.ndarray

    def segments(self, lengths: Numbers) -> list[Segment]:
        """The steps as polynomials; the last one of each arc is cut where the arc ends."""
        degree = self.values.shape[1] - 1
        first = self.values[:, :1]
        coefficients = np.einsum("ij,kjn->kin", from_values(degree), self.values - first)
        last = np.append(self.arc[1:] != self.arc[:-1], True)
        kept = np.where(last, lengths[self.arc] - self.start, self.length)
        short = kept != self.length
        points = (kept / self.length)[short, None] * nodes(degree)
        to_values = chebyshev.chebvander(2.0 * points - 1.0, degree)
        coefficients[short] = from_values(degree) @ to_values @ coefficients[short]
        coefficients[:, 0] += first[:, 0]  # last: constant states stay exact
        columns = self.start.tolist(), kept.tolist(), coefficients
        return [Segment(*row) for row in zip(*columns, strict=True)]


@attrs.frozen(eq=False)
class Flights:
    """Consecutive arcs, each ended by a jump.

    Attributes
    ----------
    j : int
        Number of jumps before the first arc.
    modes : array of str
        The mode of each arc.
    t, low : float
        Start of the first arc, in two floats.
    x : array, shape (n,)
        State at the start of the first arc.
    lengths : array, shape (arcs,)
        Durations.
    jumps : Table
        The jump after each arc.
    steps : Steps or None
        The dense output, if it is kept.
    onto : dict
        Projections onto the held contacts or the sliding surface, by mode.
    """

    j: int
    modes: np.ndarray
    t: float
    low: float
    x: StateVector
    lengths: Numbers
    jumps: Table
    steps: Steps | None
    onto: Mapping[str, Callable[..., Any]] = attrs.Factory(dict)

    @property
    def mode(self) -> str:
        return self.modes[-1]  # type: ignore[no-any-return]

    @property
    def t0(self) -> float:
        return self.t

    @property
    def t1(self) -> float:
        return float(self.jumps.t[-1])

    @property
    def last(self) -> np.ndarray:
        return self.jumps.before[-1]

    @cached_property
    def arcs(self) -> list[Arc]:
        """The arcs one by one."""
        count = len(self.modes)
        if self.steps is None:
            segments, stops = [], [0] * (count + 1)
        else:
            segments = self.steps.segments(self.lengths)
            stops = np.searchsorted(self.steps.arc, np.arange(count + 1)).tolist()
        columns = zip(
            self.modes,
            range(self.j, self.j + count),
            [self.t, *self.jumps.t[:-1].tolist()],
            [self.low, *self.jumps.low[:-1].tolist()],
            self.lengths.tolist(),
            self.jumps.t.tolist(),
            [self.x, *map(self._began, self.modes[1:], self.jumps.t, self.jumps.after)],
            self.jumps.before,
            (segments[a:b] for a, b in pairwise(stops)),
            strict=True,
        )
        return [self._kept(Arc(*row)) for row in columns]

    def _began(self, mode: str, t: float, x: StateVector) -> StateVector:
        """The state at the start of an arc; projected, if the mode holds contacts."""
        return np.array(self.onto[mode](t, x.tolist())) if parted(mode)[1] else x

    def _kept(self, arc: Arc) -> Arc:
        """An arc, projected onto the held contacts or the sliding surface of its mode."""
        onto = self.onto.get(arc.mode)
        if onto is None:
            return arc
        segments = [projected(segment, arc.t0, onto) for segment in arc.segments]
        return attrs.evolve(arc, segments=segments, project=onto)

    def later(self) -> Flights:
        """All arcs except the first."""
        jumps, steps = self.jumps, self.steps
        if steps is not None:
            kept = steps.arc > 0
            arc, *others = (column[kept] for column in steps)
            steps = Steps(arc - 1, *others)
        t, low = float(jumps.t[0]), float(jumps.low[0])
        rest = Table(*(column[1:] for column in jumps))
        start = self.j + 1, self.modes[1:], t, low, jumps.after[0]
        return Flights(*start, self.lengths[1:], rest, steps, self.onto)

    def rows(self) -> Iterator[JumpRow]:
        """The jumps one by one."""
        jumps = self.jumps
        columns = jumps.t.tolist(), jumps.low.tolist(), jumps.edge, jumps.before, jumps.after
        return (JumpRow(*row) for row in zip(*columns, strict=True))

    def arc_at(self, t: float) -> Arc:
        """The arc at time ``t``; the later one where two meet."""
        return self.arcs[int(np.searchsorted(self.jumps.t[:-1], t, side="right"))]


class Log:
    """Parts in order of time, and the jumps between them.

    ``kept`` holds parts, and groups of arcs as :class:`Flights`. ``own`` maps the index in ``kept``
    of a part to the jump that ends it.
    """

    def __init__(
        self, parts: Iterable[Part | Flights] = (), jumps: Mapping[int, JumpRow] | None = None
    ) -> None:
        self.kept: list[Part | Flights] = list(parts)
        self.own: dict[int, JumpRow] = dict(jumps or {})

    @property
    def ends_with_jump(self) -> bool:
        """Whether the log is empty or ends with a jump."""
        last = self.kept[-1] if self.kept else None
        return last is None or isinstance(last, Flights) or len(self.kept) - 1 in self.own

    @property
    def count(self) -> int:
        """Number of jumps, those of chattering tails included; none of them is made for it."""
        flown = sum(len(part.modes) for part in self.kept if isinstance(part, Flights))
        summed = sum(part.tail.count for part in self.kept if isinstance(part, TailPart))
        return len(self.own) + flown + summed

    def add(self, part: Part | Flights) -> None:
        """Append a part or a group of arcs."""
        self.kept.append(part)

    def jump(self, row: JumpRow) -> None:
        """Append a jump that ends the last part."""
        self.own[len(self.kept) - 1] = row

    def then(self, other: Log, j: int) -> Log:
        """This log joined with ``other``, which continues it after ``j`` jumps.

        If the mode continues without a jump, the last arc and the first arc of ``other`` become
        one.
        """
        kept, own, jumps = list(self.kept), dict(self.own), dict(other.own)
        more = [attrs.evolve(part, j=part.j + j) for part in other.kept]
        first, last = more[0], kept[-1]
        if isinstance(first, Flights):  # only its first arc may have been cut
            row, later = next(first.rows()), len(first.modes) > 1
            jumps = {0: row, **{k + later: each for k, each in jumps.items()}}
            more[:1], first = [first.arcs[0], *[first.later()] * later], first.arcs[0]
        whole = last.mode == first.mode and not self.ends_with_jump
        if whole and isinstance(last, Arc) and isinstance(first, Arc):
            kept, more[0] = kept[:-1], last.then(first)
        own.update({len(kept) + k: row for k, row in jumps.items()})
        return Log([*kept, *more], own)

    @property
    def first_end(self) -> float:
        """When the first arc ends."""
        first = self.kept[0]
        return float(first.jumps.t[0]) if isinstance(first, Flights) else first.t1

    def apart(self) -> tuple[list[Part], dict[int, JumpRow]]:
        """All parts one by one, and the jumps by the index of the part that they end."""
        parts: list[Part] = []
        jumps: dict[int, JumpRow] = {}
        for place, part in enumerate(self.kept):
            if isinstance(part, Flights):
                jumps.update(enumerate(part.rows(), len(parts)))
                parts.extend(part.arcs)
            else:
                parts.append(part)
                if place in self.own:
                    jumps[len(parts) - 1] = self.own[place]
        return parts, jumps

    def table(self, dimension: int) -> Table:
        """All jumps, those of chattering tails included."""
        tables: list[Table] = []
        rows: list[JumpRow] = []
        for place, part in enumerate(self.kept):
            if isinstance(part, Flights | TailPart):
                tables += [Table.of(rows, dimension), part.jumps]
                rows = []
            if place in self.own:
                rows.append(self.own[place])
        tables.append(Table.of(rows, dimension))
        return Table(*map(np.concatenate, zip(*tables, strict=True)))
