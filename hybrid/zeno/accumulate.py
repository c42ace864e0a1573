"""The sum of infinitely many impacts as part of a run: see :mod:`hybrid.rules.sums`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from itertools import pairwise
from math import ceil, log, ulp
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..automaton.markers import Crossing
from ..bounds.defect import follows
from ..lowering.local import near, off
from ..lowering.lowered import ORDER
from ..lowering.tape import Tape, lent, linked, room
from ..lowering.taylor import polynomial
from ..rules import unit
from ..rules.arrays import Programs, Sums
from ..rules.flights import most_pieces
from ..rules.guards import GUARD_ROUNDING
from ..rules.lengths import LOW_ORDER
from ..rules.sums import (
    BRANCH,
    ERROR,
    FIT,
    FORCE_SAMPLES,
    GRID,
    HIGH_ORDER,
    LAST_POINT,
    MOST_DEGREE,
    ON_CURVE,
    STATE_THERE,
    STRETCH_POINTS,
    SUM_FLOOR,
    SUM_LINES,
    SUM_SHARE,
    TO_LIMIT,
)
from ..rules.zeros import EPS
from .flight import Flight, fly, pieces_of, segments

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Matrix, StateVector
    from ..lowering import Contact, Field
    from ..segment import Segment
    from .enclose import Proof

#: Impacts of a tail from which a proof is tried, and shares of all that are listed.
PROOF_IMPACTS, SHARES_LISTED = (0, 3, 10, 30, 60, 100, 160, 250, 400, 1000, 4000), (0.25, 0.5, 0.75)

#: Flights, and times, of a tail at which a flow is compared with what it is near a point; for what
#: is between them.
COMPARED, BETWEEN_CAUTION = 16, 4.0

#: Most impacts that are flown to find one from which a proof succeeds: half a second of them.
FLOWN_IMPACTS = 400


@attrs.frozen(eq=False)
class Tail:
    """Infinitely many impacts from one on, ``y(1)``, to their limit.

    Attributes
    ----------
    t, low : float
        Time of the impact ``y(1)``, in two floats.
    x : array
        State after it.
    v : float
        Gap speed after it.
    r : float
        Restitution at rest: the ratio of the series.
    curve : array, shape (degree + 1, 2 + n)
        Chebyshev coefficients in ``2 w - 1`` of time and state, relative to ``y(1)``, and
        of ``l``.
    remaining : float
        Time from ``y(1)`` to the accumulation point.
    x_inf : array
        State there.
    t_error : float
    x_error : array
        Bounds on the error of the closing (not of what came before it).
    """

    field: Field
    contact: Contact
    column: int
    t: float
    low: float
    x: StateVector
    v: float
    r: float
    curve: Matrix
    remaining: float
    x_inf: StateVector
    t_error: float
    x_error: StateVector

    def point(self, w: float) -> tuple[float, np.ndarray, float]:
        """Time since ``y(1)``, state and gap speed after the impact ``y(w)``."""
        chatter, x = _chatter(self.field, self.contact), np.empty(len(self.x))
        about = 1, self.curve, len(self.curve) - 1, self.t, self.x, self.v, w, 1.0
        with chatter.lent() as given:
            _, v = unit("sums").on_curve(chatter.programs, *about, given, x)
            return float(given.lines[ON_CURVE, 0]), x, v

    @cached_property
    def count(self) -> int:
        """Impacts after ``y(1)`` that a double can still tell from the limit."""
        resolution = max(ulp(self.t + self.remaining), 1e-300)
        share = min(max(resolution / self.remaining, 1e-300), 1.0)
        return max(0, ceil(log(share) / log(self.r)))

    @cached_property
    def times(self) -> np.ndarray:
        """Times from ``y(1)`` to each impact listed, the first being 0."""
        w = self.r ** np.arange(self.count + 1)
        times = chebyshev.chebval(2.0 * w - 1.0, self.curve[:, 0])
        times[0] = 0.0
        return np.maximum.accumulate(times)

    @cached_property
    def impacts(self) -> tuple[Matrix, Matrix]:
        """States before and after the impacts ``y(r)``, ``y(r^2)``, ... that are listed."""
        chatter, shape = _chatter(self.field, self.contact), (self.count, len(self.x))
        before, after = np.empty(shape), np.empty(shape)
        tail = self.curve, self.t, self.x, self.v, self.r
        with chatter.lent() as given:
            unit("sums").impacts(chatter.programs, 1, *tail, given, before, after)
        return before, after

    def state(self, since: float) -> list[float]:
        """State at a time after ``y(1)``."""
        n = max(int(np.searchsorted(self.times, since, side="right")) - 1, 0)
        flight = self.flight(n)
        if flight is None:
            return self.x_inf.tolist()
        s = min(max(since - float(self.times[n]), 0.0), flight.time)
        start, _, series = next(p for p in reversed(flight.pieces) if p[0] <= s)
        return [polynomial(c, s - start) for c in series.tolist()]

    def prove(self) -> list[Proof]:
        """Proofs in order of time: the first from an impact that was flown, narrower ones later.

        The tail's first impact was flown by the run. Where no box around it can be enclosed, the
        flights that follow are flown here one after the other, each held against the flow all
        along it, until one can. Without a proof from one of these there is none: what follows
        is known from the curve, which a proof must not rest on. Once the accumulation is proved,
        later impacts, from the curve, narrow the bounds down.
        """
        first, stage = self._flown_proof()
        if first is None:
            return []
        late = (int(share * self.count) for share in SHARES_LISTED)
        stages = sorted({*(n for n in PROOF_IMPACTS if n <= self.count), *late})
        points = [self.point(self.r**n) for n in stages if n > stage]
        found = [self._prove(self.t + since, x, v) for since, x, v in points if v > 0]
        within = [p for p in found if p is not None and first.low <= p.low <= p.high <= first.high]
        return [first, *within]

    def _flown_proof(self) -> tuple[Proof | None, int]:
        """The proof from the earliest impact flown from which there is one, and which."""
        t, x, v = self.t, self.x, self.v
        for n in range(FLOWN_IMPACTS + 1):
            if n in PROOF_IMPACTS:
                proof = self._prove(t, x, v)
                if proof is not None:
                    return proof, n
            flown = hop(self.field, self.contact, self.column, t, x, v, 0.0)
            if flown is None or not follows(self.field, t, flown[1]):
                break
            t, x, v = t + flown[0], *flown[3:]
            if not v > 0:
                break
        return None, 0

    def _prove(self, t: float, x: StateVector, v: float) -> Proof | None:
        from .enclose import prove

        return prove(self.field, self.contact.name, t, x, v)

    def shown(self, first: float, last: float, begin: float, end: float) -> Matrix:
        """Points of the flights from ``y(first)`` to ``y(last)``, between two shares of each.

        Rows are time, state, gap speed at the end of the flight, and the times at which this begins
        and ends; the last two are the least and the most of each column.
        """
        tail = self.curve, self.t, self.x, self.v, self.r
        out = np.empty((STRETCH_POINTS + 2, len(self.x) + 4))
        with self.programs() as (programs, given):
            given_to = first, last, begin, end, given, out
            points = unit("sums").shown(programs, 0, 1, *tail, *given_to)
        return out[[*range(points), -2, -1]]

    @contextmanager
    def programs(self) -> Iterator[tuple[Programs, Sums]]:
        """The flow, then what happens at the contact; and room for a sum."""
        chatter = _chatter(self.field, self.contact)
        with chatter.lent() as given:
            yield chatter.programs, given

    def flight(self, n: int) -> Flight | None:
        """The flight after impact ``n`` of the tail, from the curve."""
        since, x, v = self.point(self.r**n)
        return fly(self.field, self.column, self.t + since, x.tolist(), v)


def close(
    field: Field,
    contact: Contact,
    column: int,
    t: float,
    low: float,
    x: StateVector,
    v: float,
    rtol: float,
    atol: float,
) -> Tail | None:
    """Sum the impacts that follow an impact with speed ``v``; None where it cannot yet be done.

    None means that the series does not converge well enough from here: the impacts are too
    strong, or do not accumulate at all. The tolerances are of the result.
    """
    called = field.jets is None
    if called:
        local = near(field, contact.name, t, np.asarray(x, dtype=float).tolist())
        if local is None:
            return None
        field = local
    chatter = _chatter(field, contact)
    with chatter.lent() as given:
        start = t, np.array(x, dtype=float), v, rtol, atol
        about = column, field.project is not None, chatter.local
        degree, r = unit("sums").close(chatter.programs, 0, 1, *about, *start, given)
        if not degree:
            return None
        lines = given.lines.copy()
    remaining, error = float(lines[TO_LIMIT, 0]), lines[ERROR, :-1]
    x_inf = lines[STATE_THERE, : len(x)]
    found = r, lines[: degree + 1], remaining, x_inf, float(error[0]), error[1:]
    tail = Tail(field, contact, column, t, low, x, v, *found)
    return _compared(tail, rtol, atol) if called else tail


def clear(tail: Tail, field: Field, column: int) -> bool:
    """Whether no other guard of a field is reached along a tail, impacts and flights."""
    chatter, signs = _chatter(tail.field, tail.contact), _inside(field)
    of = chatter.programs, 0, 1, column, tail.field.project is not None
    rounding = GUARD_ROUNDING * EPS * float(np.max(np.abs(tail.x_inf)))
    curve = tail.curve, tail.t, tail.x, tail.v, tail.r, tail.remaining, tail.x_inf
    with chatter.lent() as given:
        return bool(unit("tails").clear(*of, signs, rounding, *curve, given))


def _inside(field: Field) -> Integers:
    """The signs that guards have inside the domain; 0 of those that bound nothing."""
    signs = {Crossing.FALLING: 1, Crossing.RISING: -1}
    return np.array([signs.get(g.crossing, 0) if g.bounds else 0 for g in field.guards])


def hop(
    field: Field,
    contact: Contact,
    column: int,
    t: float,
    x: StateVector,
    v: float,
    rounding: float,
) -> tuple[float, list[Segment], np.ndarray, np.ndarray, float] | None:
    """A flight from a contact by series, and the impact at its end (:mod:`hybrid.rules.hops`): its
    time and segments, the states before and after the impact, and the gap speed after it.

    None where the flight belongs to the solver.
    """
    if field.jets is None:
        return None
    chatter, before, after = _chatter(field, contact), np.empty(len(x)), np.empty(len(x))
    about = column, field.project is not None, t, np.array(x, dtype=float), v
    with chatter.lent() as given:
        status, time, speed, pieces = unit("hops").hop(
            chatter.programs, 0, 1, *about, rounding, _inside(field), before, after, given
        )
        if status < 0:
            return None
        made = pieces_of(pieces, given.starts, given.lengths, given.series)
    return time, segments(made), before, after, speed


def _compared(tail: Tail, rtol: float, atol: float) -> Tail | None:
    """A sum with the flow near a point, if the flow itself is that close to it all along the tail.

    A force off by a share of itself changes the times of all flights by as much.
    """
    mids = (0.5 * (a + b) for a, b in pairwise(tail.times[:COMPARED].tolist()))
    since = [*np.linspace(0.0, tail.remaining, COMPARED)[:-1].tolist(), *mids]
    found = [off(tail.field, tail.column, tail.t + s, tail.state(s)) for s in since]
    share = BETWEEN_CAUTION * max(force for _, force in found)
    rates = np.max([np.abs(tail.field.rhs(tail.t + s, tail.state(s))) for s in since], axis=0)
    change = np.max([rate for rate, _ in found], axis=0)
    t_error = share * tail.remaining
    x_error = tail.remaining * (BETWEEN_CAUTION * change + share * rates)
    sizes = np.abs(tail.x_inf) + np.abs(tail.x)
    allowed = max(SUM_SHARE * rtol, SUM_FLOOR) * (abs(tail.t) + tail.remaining)
    if not t_error <= allowed or not np.all(x_error <= SUM_SHARE * (rtol * sizes + atol)):
        return None
    return attrs.evolve(tail, t_error=tail.t_error + t_error, x_error=tail.x_error + x_error)


def _chatter(field: Field, contact: Contact) -> _Chatter:
    """The map of a contact in a field, made once."""
    return field.once(("sum", contact.name), lambda: _Chatter.of(field, contact))  # type: ignore[no-any-return]


@attrs.frozen(eq=False)
class _Chatter:
    """The map of a contact in a field as programs, and room for its sum.

    Attributes
    ----------
    tapes : list of Tape
        Those of the programs: the flow, and what happens at the contact.
    local : bool
        Whether all flights see the same forces.
    free : dict
        Room that no sum is using: threads share the programs, and not the room.
    """

    programs: Programs
    tapes: list[Tape]
    local: bool
    free: dict[Any, list[Any]]

    @classmethod
    def of(cls, field: Field, contact: Contact) -> _Chatter:
        """From the flow and what happens at the contact."""
        assert field.jets is not None
        parts = [field.jets, *field.at_contact(contact.name)]
        local = contact.local and not field.held
        return cls(linked(parts), [part.tape for part in parts], local, {})

    def lent(self) -> AbstractContextManager[Sums]:
        """Room for one sum."""
        return lent(self.free, "sum", self._new)

    def _new(self) -> Sums:
        needs = np.max([tape.needs for tape in self.tapes], axis=0)
        return room_for_sums(needs.tolist(), self.tapes[0].size)


def room_for_sums(needs: Sequence[int], n: int) -> Sums:
    """Room for the sums of ``n`` states by programs none of which needs more than this."""
    work, points = room(needs, n, HIGH_ORDER), MOST_DEGREE + 1
    kinks = len(work.sides)
    most = most_pieces(kinks)
    return Sums(
        lines=np.zeros((SUM_LINES, n + 2)),
        small=np.zeros((FIT + FORCE_SAMPLES, points)),
        times=np.zeros(GRID + LAST_POINT + 1),
        ints=np.zeros(BRANCH + kinks + most, dtype=np.int64),
        high=work.c,
        low=np.empty((len(work.c), LOW_ORDER + 1)),
        short=work,
        starts=np.zeros(most),
        lengths=np.zeros(most),
        series=np.zeros((n * most, ORDER + 1)),
        branch=np.zeros(kinks + most, dtype=np.int64),
        end=np.zeros(n),
        c=np.empty((len(work.c), ORDER + 1)),
        aside=work.aside,
        work=work.work,
        rows=work.rows,
        found=work.found,
        sides=work.sides,
    )
