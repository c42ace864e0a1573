"""The sum of a series of infinitely many impacts within a run: see :mod:`hybrid.rules.sums`."""

from __future__ import annotations

from collections.abc import Iterator
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
from ..errors import OptionError
from ..lowering.local import near, off
from ..lowering.tape import Tape, lent, linked
from ..lowering.taylor import polynomial
from ..rules import unit
from ..rules.arrays import Programs, Sums
from ..rules.guards import GUARD_ROUNDING
from ..rules.sums import (
    ERROR,
    ON_CURVE,
    STATE_THERE,
    STRETCH_POINTS,
    SUM_FLOOR,
    SUM_SHARE,
    TO_LIMIT,
)
from ..rules.zeros import EPS
from .flight import Flight, fly, pieces_of, room_for_sums, segments

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Matrix, StateVector
    from ..lowering import Contact, Field
    from ..segment import Segment
    from .enclose import Proof

#: Most impacts of a sum that are listed: with their states some ten gigabytes.
MOST_LISTED = 100_000_000

#: Impacts of a tail from which a proof is tried: by number, and as fractions of the listed impacts.
PROOF_IMPACTS, SHARES_LISTED = (0, 3, 10, 30, 60, 100, 160, 250, 400, 1000, 4000), (0.25, 0.5, 0.75)

#: Number of flights, and of times along the tail, at which a flow is compared with its local model;
#: and a safety factor for the times between.
COMPARED, BETWEEN_CAUTION = 16, 4.0

#: Most impacts integrated to find one from which a proof succeeds; they take half a second.
FLOWN_IMPACTS = 400


@attrs.frozen(eq=False)
class Tail:
    """Infinitely many impacts, from ``y(1)`` to their limit ``y(0)``.

    The points of a curve ``y(w)`` are times and states after impacts; impact ``n`` is ``y(r**n)``.

    Attributes
    ----------
    field, contact, column
        The flow between impacts, the contact, and the index of its gap among the field's guards.
    t, low : float
        Time of the impact ``y(1)``, in two floats.
    x : array
        State after the impact ``y(1)``.
    v : float
        Gap speed after the impact ``y(1)``.
    r : float
        Restitution at rest, which is the limit of the ratio of successive flight times.
    curve : array, shape (degree + 1, 2 + n)
        Chebyshev coefficients in ``2 w - 1`` of time and state, relative to ``y(1)``, and of ``l``:
        the gap speed after the impact is ``v w exp(l(w))``.
    remaining : float
        Time from ``y(1)`` to the accumulation point.
    x_inf : array
        State at the accumulation point.
    t_error : float
    x_error : array
        Bounds on the error of the summation (not of the integration before it).
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

    def later(self, off: float) -> Tail:
        """The same sum with the error bound of its limit increased by the time ``off``."""
        if not off:
            return self
        x_error = off * np.abs(self.field.rhs(self.t + self.remaining, self.x_inf.tolist()))
        return attrs.evolve(self, t_error=self.t_error + off, x_error=self.x_error + x_error)

    def within(self, remaining: float) -> Tail:
        """The same sum scaled to end ``remaining`` after ``y(1)``, with a larger error bound."""
        curve = self.curve.copy()
        curve[:, 0] *= remaining / self.remaining
        error = self.t_error + self.remaining - remaining
        return attrs.evolve(self, curve=curve, remaining=remaining, t_error=error)

    @cached_property
    def count(self) -> int:
        """Number of impacts after ``y(1)`` that a double can tell from the limit."""
        resolution = max(ulp(self.t + self.remaining), 1e-300)
        share = min(max(resolution / self.remaining, 1e-300), 1.0)
        return max(0, ceil(log(share) / log(self.r)))

    @cached_property
    def times(self) -> np.ndarray:
        """Times from ``y(1)`` to each listed impact; the first is 0.

        Raises
        ------
        OptionError
            If they are more than :data:`MOST_LISTED`.
        """
        if self.count > MOST_LISTED:
            raise OptionError(
                f"contact {self.contact.name}, t = {self.t!r}: {self.count:.3g} impacts of a sum "
                f"can be told from its limit, and no more than {MOST_LISTED:.0g} are listed: "
                "run.final, run.zeno and times behind the limit need no list; for single "
                "impacts, end the run before the limit"
            )
        w = self.r ** np.arange(self.count + 1)
        times = chebyshev.chebval(2.0 * w - 1.0, self.curve[:, 0])
        times[0] = 0.0
        return np.maximum.accumulate(times)

    @cached_property
    def impacts(self) -> tuple[Matrix, Matrix]:
        """States before and after the listed impacts ``y(r)``, ``y(r^2)``, ..."""
        chatter, shape = _chatter(self.field, self.contact), (self.count, len(self.x))
        before, after = np.empty(shape), np.empty(shape)
        tail = self.curve, self.t, self.x, self.v, self.r
        with chatter.lent() as given:
            unit("sums").impacts(chatter.programs, 1, *tail, given, before, after)
        return before, after

    def state(self, since: float) -> list[float]:
        """The state at the time ``since`` after ``y(1)``; the limit if the flight has no series."""
        n = max(int(np.searchsorted(self.times, since, side="right")) - 1, 0)
        flight = self.flight(n)
        if flight is None:
            return self.x_inf.tolist()
        s = min(max(since - float(self.times[n]), 0.0), flight.time)
        start, _, series = next(p for p in reversed(flight.pieces) if p[0] <= s)
        return [polynomial(c, s - start) for c in series.tolist()]

    def prove(self) -> list[Proof]:
        """Proofs of the accumulation, in order of time; empty if none succeeds.

        The first proof must start from an integrated impact, because the curve is not proved. The
        run has integrated up to the tail's first impact. If the proof from there fails, the next
        flights are integrated here one by one, each verified along the flow, until a proof
        succeeds. Once the accumulation is proved, proofs from later impacts on the curve narrow the
        bounds.
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
        """A proof from the earliest integrated impact that yields one, and that impact's number."""
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
        """Points of the flights from ``y(first)`` to ``y(last)``, between two fractions of each.

        Each row holds time, state, gap speed at the end of the flight, and the times at which the
        flight begins and ends. The last two rows are the minimum and the maximum of each column.
        """
        tail = self.curve, self.t, self.x, self.v, self.r
        out = np.empty((STRETCH_POINTS + 2, len(self.x) + 4))
        with self.programs() as (programs, given):
            given_to = first, last, begin, end, given, out
            points = unit("sums").shown(programs, 0, 1, *tail, *given_to)
        return out[[*range(points), -2, -1]]

    @contextmanager
    def programs(self) -> Iterator[tuple[Programs, Sums]]:
        """The programs of the flow and of the contact, with work arrays for a sum."""
        chatter = _chatter(self.field, self.contact)
        with chatter.lent() as given:
            yield chatter.programs, given

    def flight(self, n: int) -> Flight | None:
        """The flight after impact ``n``, which starts on the curve; None as for :func:`.fly`."""
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
    """Sum the impacts that follow an impact at ``t + low``.

    Parameters
    ----------
    column : int
        Index of the contact's gap among the guards of the field.
    x, v : array, float
        State and gap speed after the impact.
    rtol, atol : float
        Tolerances of the limit.

    Returns
    -------
    Tail or None
        None if the series does not converge well enough from here: the impacts are still too
        strong, or do not accumulate.
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
    """Whether no guard of a field, except that in ``column``, reaches zero along a tail."""
    chatter, signs = _chatter(tail.field, tail.contact), _inside(field)
    of = chatter.programs, 0, 1, column, tail.field.project is not None
    rounding = GUARD_ROUNDING * EPS * float(np.max(np.abs(tail.x_inf)))
    curve = tail.curve, tail.t, tail.x, tail.v, tail.r, tail.remaining, tail.x_inf
    with chatter.lent() as given:
        return bool(unit("tails").clear(*of, signs, rounding, *curve, given))


def _inside(field: Field) -> Integers:
    """The sign that each guard must have so as not to fire on entering; 0 if it may have any."""
    signs, guards = {Crossing.FALLING: 1, Crossing.RISING: -1}, field.guards
    return np.array([signs.get(g.crossing, 0) if g.bounds or g.urgent else 0 for g in guards])


def hop(
    field: Field,
    contact: Contact,
    column: int,
    t: float,
    x: StateVector,
    v: float,
    rounding: float,
) -> tuple[float, list[Segment], np.ndarray, np.ndarray, float] | None:
    """A flight from a contact by Taylor series, and its impact (:mod:`hybrid.rules.hops`).

    Returns the flight's time and segments, the states before and after the impact, and the gap
    speed after it. None if the solver must integrate the flight.
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
    """A sum of the local model with larger error bounds; None if the flow is not close enough to
    the model all along the tail.

    A relative error of the force changes the times of all flights by the same fraction.
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
    """The impact map of a contact in a field, cached."""
    return field.once(("sum", contact.name), lambda: _Chatter.of(field, contact))  # type: ignore[no-any-return]


@attrs.frozen(eq=False)
class _Chatter:
    """The impact map of a contact in a field as programs, with work arrays for its sum.

    Attributes
    ----------
    tapes : list of Tape
        The tapes of the programs: the flow, then those of the contact.
    local : bool
        Whether all flights experience the same forces.
    free : dict
        Work arrays not in use: threads share the programs but not these.
    """

    programs: Programs
    tapes: list[Tape]
    local: bool
    free: dict[Any, list[Any]]

    @classmethod
    def of(cls, field: Field, contact: Contact) -> _Chatter:
        """The impact map made of the flow and of the laws of the contact."""
        assert field.jets is not None
        parts = [field.jets, *field.at_contact(contact.name)]
        local = contact.local and not field.held
        return cls(linked(parts), [part.tape for part in parts], local, {})

    def lent(self) -> AbstractContextManager[Sums]:
        """Borrow work arrays for one sum."""
        return lent(self.free, "sum", self._new)

    def _new(self) -> Sums:
        needs = np.max([tape.needs for tape in self.tapes], axis=0)
        return room_for_sums(needs.tolist(), self.tapes[0].size)
