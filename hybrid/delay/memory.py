"""The record of a run with delays, and the windows from which its flows take delayed states.

Between two breaking points of the delayed terms, a flow with delays is an ordinary time-dependent
flow: the record at ``t - lag`` is smooth there and is passed to it as a polynomial, a *window*. The
driver integrates from window to window; guards, contacts, accumulations and rests are treated as
without delays. A window ends

* at a breaking point, where the record at ``t - lag`` is not smooth. Steps end exactly there. The
  order of the breaking point (0: the state jumps, 1: its derivative jumps, ...) is tracked for each
  state element through each lag, until it exceeds the order of the method;
* where one polynomial would not be as accurate as the run;
* where the record ends, if the lag is at least as long as a step. If it is shorter, the unknown
  part of the record is extrapolated, the step is made, and both are repeated until they agree.

See ``docs/notes/delays.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from math import isfinite
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.past import blank
from ..errors import FlowError, OptionError
from ..lowering import Field, Scene, window_ends
from ..lowering.taylor import flat
from ..rules import unit
from ..rules.arrays import PastArrays
from ..rules.flown import BRIEF_FLIGHT
from ..rules.guesses import GUESS_REST, LONGEST
from ..rules.places import (
    AGAIN,
    ANEW,
    ASKED,
    ASKED_FROM,
    ASKED_UNTIL,
    ASKED_UP_TO,
    ASKING,
    ASKS_VALUES,
    BEHIND,
    BREAK_ORDER,
    BREAKS,
    FINAL,
    FLIGHTS_DONE,
    FORGETS,
    GOES_ON,
    GUESSED,
    GUESSED_FROM,
    HOLDS,
    IN_ARC,
    MOST,
    NEXT_TO_NOTHING,
    PAST_FLOATS,
    PAST_INTS,
    PIECES_KEPT,
    PIECES_KNOWN,
    READS,
    RECORD_NOT_FINITE,
    REST_OF_GUESSES,
    ROUGH,
    RTOL,
    SAME,
    SERVES_UNTIL,
    SINCE,
    SINCE_LOW,
    STARTED,
    STATE_FLOATS,
    STATE_INTS,
    STEPPED,
    STEPS_DONE,
    WINDOW_DEGREE,
)
from ..rules.record import SHOWN_ROUNDING, WINDOW_SHARE
from ..rules.windows import AT_THE_END, FIXED, MOVES_ON, ROUGH_MOST, ROUGH_NEAR
from ..segment import Segment, from_powers, from_values, nodes, straight
from ..trajectory.arcs import Arc, TailPart
from ..trajectory.clock import Instant
from ..trajectory.log import Flights
from ..trajectory.plan import Plan
from .pieces import (
    WIDTH,
    Breaks,
    Piece,
    Pieces,
    constant,
    jump_of,
    piece_of,
    slack_of,
    states,
    swept,
)
from .windows import NO_LINKS, TO_POWERS, Links, bent, reach

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Mask, Numbers, StateVector

#: Most sums of impacts in one call of the rules' loop.
SUMS = 8

#: Largest degree of dense output that is refined if the method is of higher order.
CUBIC = 3

#: The length of a window, in slacks of the time, that is no time to speak of; and how many of them
#: in a row show that a lag goes no way from where it looks.
BRIEF_WINDOW, MOST_TURNS = 8.0, 100

#: Matrix from coefficients in powers of the fraction of a step to Chebyshev coefficients.
TURN = np.ascontiguousarray(from_powers(WIDTH - 1))

#: Matrices from values at a window's nodes to Chebyshev coefficients, and from these to powers.
FROM_VALUES, TO_PLACES = map(np.ascontiguousarray, (from_values(WINDOW_DEGREE), TO_POWERS))


@attrs.define
class Then:
    """The scene of a run at an earlier time; if ``kept`` is set, the run continues from there."""

    scene: Scene
    kept: bool = False


class Memory:
    """The record of a run with delays, and the windows on it.

    ``mode`` says in which mode the run is, for messages.

    Attributes
    ----------
    until : float
        Time up to which the present windows are valid.
    shown : array
        Frames and coefficients of the windows, as inputs of the programs.
    bound : bool
        Whether the programs of the rules' loop hold these numbers.
    told : bool
        Whether the rules' loop has already recorded the arcs and jumps now being added.
    loose : frozenset of str
        What holds the state and may let it go where windows ended last (:meth:`_loose`).
    sights : array
        The ``shown`` of the windows at each sum of impacts in a call of the loop.
    """

    def __init__(
        self,
        scene: Scene,
        plan: Plan,
        order: int,
        history: Sequence[Piece],
        x: StateVector,
        mode: Callable[[], str],
    ) -> None:
        spec, code = scene.spec, scene.code
        self.scene, self.plan, self.order, self._mode = scene, plan, order, mode
        self.moving, self.seen = code.moving, code.seen
        self.all_seen = sorted({element for seen in self.seen for element in seen})
        hidden = flat([*scene.parameters[: len(spec.parameters)], *blank(spec.lags, len(x))])
        self._lags = [code.lag(k).bind(hidden) for k in range(len(spec.lags))]
        self.names = [lag.name for lag in spec.lags]
        self.floats, self.ints = np.zeros(PAST_FLOATS), np.zeros(PAST_INTS, dtype=np.int64)
        self.floats[[FINAL, RTOL, SERVES_UNTIL]] = plan.t1, plan.rtol, plan.t0
        self.floats[[STARTED, MOST]] = plan.t0, np.inf
        self.ints[BREAK_ORDER], self.ints[AGAIN] = order + 1, GOES_ON
        self.ints[REST_OF_GUESSES], self.ints[IN_ARC], self.ints[ASKING] = GUESS_REST, -1, -1
        behind = ANEW if any(self.moving) else SAME
        self.ints[BEHIND] = FORGETS if plan.memory == "restart" else behind
        self.pieces, self.breaks = Pieces(self.ints, history, len(x)), Breaks(self.ints, len(x))
        self._frames = np.tile([0.0, 0.0, np.inf, 0.0], (len(self._lags), 1))
        self.shown, self.bound, self.told = np.array(hidden[-self._size :]), False, False
        self.sights = np.empty((SUMS, self._size))
        self._fixed = self._all_fixed(x)
        self._now = np.zeros(len(self._lags)) if self._fixed is None else self._fixed
        self._moves = np.array([MOVES_ON if moves else FIXED for moves in self.moving])
        self._supplied = np.zeros((len(x), WINDOW_DEGREE + 1))
        self._present = np.array(x, dtype=float)
        self._past: PastArrays | None = None
        self._made: tuple[Any, ...] = ()
        ints = np.zeros(STATE_INTS, dtype=np.int64)
        self._before = np.zeros(STATE_FLOATS), ints, np.zeros((3, len(x)))
        self._begun, self._joins = np.zeros(len(x)), False
        self._looks_back, self._reach = False, dict[Any, Any]()
        self._turned, self.loose = (-np.inf, 0), frozenset[str]()
        for piece in history:
            if piece.orders is not None:
                self._break(piece.start, piece.orders, piece.mode, code.pushed(piece.mode))
        self.breaks.add(plan.t0, self._start(x))

    @property
    def start(self) -> StateVector:
        """The state from which the rules' loop continued through windows within an arc."""
        return self._begun

    @property
    def signs(self) -> Integers:
        """The signs of the guards at the state ``start``."""
        return self.past().signs[0]  # type: ignore[no-any-return]

    @property
    def _size(self) -> int:
        """Number of values of all windows."""
        return len(self._lags) * (2 + (WINDOW_DEGREE + 1) * self.scene.spec.dimension)

    def _all_fixed(self, x: StateVector) -> Numbers | None:
        """The lags, if all of them are constant, finite and not negative; otherwise None."""
        if any(self.moving):
            return None
        lags = np.array([lag(self.plan.t0, x.tolist()) for lag in self._lags], dtype=float)
        return lags if np.all(np.isfinite(lags) & (lags >= 0)) else None

    @property
    def until(self) -> float:
        """Time up to which the present windows are valid."""
        return float(self.floats[SERVES_UNTIL])

    @until.setter
    def until(self, t: float) -> None:
        self.floats[SERVES_UNTIL] = t

    @property
    def since(self) -> float:
        """Time from which on the present windows are."""
        return float(self.floats[GUESSED_FROM])

    def due(self, t: float) -> bool:
        """Whether new windows are needed at time ``t``."""
        return not self.told and self.until <= t

    def _start(self, x: StateVector) -> Integers:
        """The order of the breaking point at the start for each state element: 0 where the history
        does not end in the start state, else 1."""
        end = self.pieces.last.state(self.plan.t0, np.zeros(1))[0]
        return np.where(end == x, 1, 0)

    def fork(self) -> Memory:
        """A copy, for a run that branches off here."""
        other = copy(self)
        other.floats, other.ints = self.floats.copy(), self.ints.copy()
        other.pieces, other.breaks = self.pieces.copy(other.ints), self.breaks.copy(other.ints)
        other._frames, other.shown = self._frames.copy(), self.shown.copy()
        other._now, other._moves = self._now.copy(), self._moves.copy()
        other._supplied, other._present = self._supplied.copy(), self._present.copy()
        other.sights, other._begun = self.sights.copy(), self._begun.copy()
        other._before = tuple(array.copy() for array in self._before)  # type: ignore[assignment]
        other.bound, other.told, other._past = False, False, None
        return other

    def refined(self, field: Field, now: Instant, segments: Sequence[Segment]) -> list[Segment]:
        """The segments, refined to the order of the method if their degree is 3 or less.

        Values between the steps enter the flow one lag later, where errors cannot be corrected.
        """
        return [
            swept(field, now, segment, self.order - segment.degree)
            if segment.degree <= CUBIC < self.order
            else segment
            for segment in segments
        ]

    # -- recording ------------------------------------------------------------------------

    def flown(self, now: Instant, segments: Sequence[Segment]) -> None:
        """Record segments, whose local time begins at an instant."""
        if self.told:
            return
        self.ints[STEPPED] += len(segments)
        for segment in segments:
            self.pieces.add(piece_of(segment, now.t, now.low))

    def flights(self, flights: Flights) -> None:
        """Record consecutive arcs and the jumps after them."""
        for arc, row in zip(flights.arcs, flights.rows(), strict=True):
            self.flown(Instant(arc.t0, arc.low), arc.segments)
            self.jumped(row.t, row.before, row.after, (row.edge, arc.mode))

    def jumped(
        self, t: float, before: StateVector, after: StateVector, jump: tuple[str, str]
    ) -> None:
        """Record a jump, given with the mode before it; with ``memory="restart"`` everything before
        it is forgotten."""
        if self.told:
            return
        self.ints[READS] = 0
        if self.plan.memory == "restart":
            self._restart(t, after)
            return
        edge, mode = jump
        self._break(t, np.where(before == after, 1, 0), mode, bent(self.scene.code, edge, mode))
        if any(self.moving) or self.guessing:
            self.until, self._joins = t, True

    def _restart(self, t: float, x: StateVector) -> None:
        self.pieces.forget_all([constant(x, t)])
        self.ints[BREAKS] = 0
        self.breaks.add(t, np.ones(len(x), dtype=int))
        self.until = t

    def tail(self, part: TailPart) -> None:
        """Record impacts of a tail until delays cannot tell them from the limit; then the limit.

        They tell them by how high they are and, where a guard, a gap or a formula looks at them, by
        how long they take.
        """
        tail = part.tail
        if self.told:
            return
        if self.plan.memory == "restart":
            self._restart(part.t1, tail.x_inf)
            return
        mode = tail.field.name
        row = bent(self.scene.code, tail.contact.name, mode)
        for n in range(tail.count + 1):
            arc = part.arc(n)
            last = n == tail.count or arc.length <= BRIEF_FLIGHT * np.spacing(abs(part.t1))
            brief = part.t1 - arc.t0 <= self.plan.rtol * (part.t1 - self.plan.t0)
            if last or (brief and self._low(arc, tail.x_inf)):
                break
            self.flown(Instant(arc.t0, arc.low), arc.segments)
            hit = part.jump(n + 1)
            self._break(hit.t, np.where(hit.before == hit.after, 1, 0), mode, row)
        since = self.pieces.last.end
        last_piece = straight(0.0, part.t1 - since, arc.first, tail.x_inf)
        self.pieces.add(piece_of(last_piece, since, 0.0))
        self._break(part.t1, np.ones(len(tail.x_inf), dtype=int), mode, row)

    def limit(self, since: float, t: float, x_inf: StateVector, means: Mapping[int, float]) -> None:
        """Record the limit of a cycle, to which the last piece leads: of elements that resets move
        all along that piece shows their means, and they jump at both its ends. There is none if
        rounding hides the time from the last jump on, ``since``."""
        if self.told:
            return
        if self.plan.memory == "restart":
            self._restart(t, x_inf)
            return
        last, orders = self.pieces.last, np.ones(len(x_inf), dtype=int)
        orders[[*means]] = 0
        self.breaks.add(since, orders)
        self.breaks.add(t, orders)
        if last.rows is not None and last.start >= since:
            last.rows[:, [*means]] = 0.0
            last.rows[0, [*means]] = [*means.values()]

    def _break(self, t: float, orders: Integers, mode: str, changes: Mask) -> None:
        """Record the breaking point of a jump, if lags see it: of order 0 in what it changes.

        ``mode``, ``changes``: the mode before it, empty if it is not known, and what it bends
        (:func:`.windows.bent`).
        """
        if not mode:
            self.breaks.add(t, orders)
            return
        self.breaks.reserve()
        past = self._within(self.scene.field(mode))
        past.own[:] = orders
        unit("past").jumped(t, past._replace(bent=changes[None].astype(np.int64)))

    def _within(self, field: Field) -> PastArrays:
        """The arrays of the rules, with a table of what a field looks at."""
        key = field.mode, field.held
        if key not in self._reach:
            self._reach[key] = reach([field])
        uses, asks = self._reach[key]
        return self.past()._replace(uses=uses, asks=asks)

    def _low(self, arc: Arc, x: StateVector) -> bool:
        """Whether delays cannot tell the states along a flight from the limit ``x``."""
        there = np.concatenate([s(s.start + s.length * nodes(4)) for s in arc.segments])
        return self._near(there, x)

    def nears(self, since: float, x: StateVector) -> bool:
        """Whether delays cannot tell the states since a time from the limit ``x``."""
        first = int(np.searchsorted(self.pieces.ends, since, side="right"))
        recent = (self.pieces.piece(place) for place in range(first, self.pieces.count))
        spans = ((piece, piece.start, piece.end - piece.start) for piece in recent)
        there = [piece.state(start, length * nodes(4)) for piece, start, length in spans]
        return self._near(np.concatenate(there), x)

    def stays(self, part: TailPart) -> bool:
        """Whether the present windows are valid for the flights of a tail up to the limit.

        They are not if a very short lag sees the impacts of the tail, or if the past restarts at
        each impact and the states after the impacts differ from the limit.
        """
        limit = part.tail.x_inf
        if self.plan.memory == "restart":
            return self._near(part.tail.x, limit)
        return not self.guessing or self._low(part.arc(0), limit)

    def _near(self, there: np.ndarray, x: StateVector) -> bool:
        """Whether the elements of states that delays see equal those of ``x``, up to tolerance."""
        seen = self.all_seen
        size = np.abs(x)
        allowed = WINDOW_SHARE * (self.plan.atol + self.plan.rtol * size) + SHOWN_ROUNDING * size
        return bool(np.all(np.abs(there - x)[..., seen] <= allowed[seen]))

    # -- windows --------------------------------------------------------------------------

    @property
    def guessing(self) -> bool:
        """Whether a window contains extrapolated values."""
        return bool(self.ints[GUESSED])

    @property
    def known(self) -> float:
        """Time up to which the windows contain recorded values only."""
        return float(self.floats[GUESSED_FROM]) if self.guessing else self.until

    def look(self, t: float, x: StateVector) -> Scene:
        """The scene with windows from time ``t`` on; ``until`` says how long they are valid.

        After a jump the lags keep their windows where possible.

        Raises
        ------
        FlowError
            If the record is not finite, or not smooth anywhere.
        OptionError
            If the caller's history cannot be evaluated.
        """
        joins, self._joins = self._joins, False
        self.floats[GUESSED_FROM] = t
        self._looks(t, x)
        if not (joins and unit("windows").stays(t, self.past())):
            if not self._looks_back:
                self._forget(t)
            self.ints[ASKING] = -1
            self._found(self._read())
        return self.read()

    def misses(self, t: float, x: StateVector) -> bool:
        """Whether a lag looks outside its present window, as it has jumped."""
        if not any(self.moving):
            return False
        places = np.array([self._place(k, t, x) for k in range(len(self._lags))])
        since, to = self._frames[:, :LONGEST].T
        apart = AT_THE_END * np.array([slack_of(t, place) for place in places])
        return bool(np.any((places < since - apart) | (places > to + apart)))

    def _looks(self, t: float, x: StateVector) -> None:
        """Store the state, and the time ``t - lag`` of each lag."""
        self._present[:] = x
        if self._fixed is None:
            self._now[:] = [t - self._place(k, t, x) for k in range(len(self._lags))]

    def _read(self) -> int:
        """Compute windows, or continue after values were supplied; returns the rule's status."""
        if self.pieces.full:
            self.pieces.grow()
        return int(unit("windows").read(self.floats[GUESSED_FROM], False, self.past()))

    def _found(self, status: int) -> None:
        """Complete the windows, evaluating the caller's history where the rule requests it.

        Raises
        ------
        FlowError, OptionError
            As :meth:`look`.
        """
        fault = None
        while status == ASKS_VALUES:
            fault = self._supply_values()
            status = self._read()
        t, bad = self.floats[[GUESSED_FROM, ASKED_FROM]].tolist()
        x, model = self._present, self.scene.spec.model
        if status == RECORD_NOT_FINITE:
            raise fault or FlowError(
                f"{model}, t = {t!r}: the record at {bad!r} is not finite; give a "
                "history that reaches back that far"
            ).by("forgotten")
        if status == ROUGH:
            raise FlowError(
                f"{model}: the record at {bad!r} is rough: no polynomial shows it to "
                "rtol and atol (a history in 32 bits, or of measured numbers?); give a smooth one, "
                "or larger tolerances"
            )
        if status == NEXT_TO_NOTHING:
            shortest = int(np.argmin(self._now))
            raise FlowError(
                f"{model}, mode {self._mode()}, t = {t!r}, {self.scene.spec.record(x)}: the lag "
                f"{self.names[shortest]} is {float(self._now[shortest])!r}, and the state seen "
                "through it cannot be found; where it is 0 write the present state, s.x for "
                "past(lag).x, or keep it longer"
            )

    def _supply_values(self) -> OptionError | None:
        """Supply the requested values of the caller's history; returns its error, if any."""
        a, b = self.floats[[ASKED_FROM, ASKED_UNTIL]].tolist()
        pieces = [self.pieces.piece(k) for k in range(*self.ints[[ASKED, ASKED_UP_TO]].tolist())]
        since = (b - a) * nodes(WINDOW_DEGREE)
        try:
            with np.errstate(all="ignore"):
                self._supplied[:] = states(pieces, a, since).T
                if self._splits(pieces, a + since):
                    self.ints[ASKING] = -1
        except OptionError as fault:
            self._supplied[:] = np.nan
            return fault
        return None

    def _splits(self, pieces: list[Piece], times: Numbers) -> bool:
        """Whether the caller's history jumps between times at which it has been asked for; if so,
        that is a breaking point, and the windows are read anew."""
        for place, piece in enumerate(pieces, int(self.ints[ASKED])):
            inside = (times > piece.start) & (times < piece.end)
            if isfinite(piece.degree) or np.count_nonzero(inside) < 2:
                continue
            t, orders = jump_of(piece, times[inside], self._supplied.T[inside])
            near = np.abs(self.breaks.times - t) < ROUGH_NEAR * (self.plan.t1 - self.plan.t0)
            if isfinite(t) and np.count_nonzero(near) < ROUGH_MOST:
                self.ints[PIECES_KEPT] = self.ints[PIECES_KNOWN]
                self.pieces.split(place, t)
                self.breaks.insert(t, orders)
                return True
        return False

    def read(self) -> Scene:
        """The scene with the windows just computed."""
        self.bound = False
        return self.scene.through([self.shown])

    def begins(self, going: int, arc: int, t: float, low: float) -> None:
        """Prepare a call of the rules' loop from ``t + low``: within arc number ``arc``, if the
        loop was in it and goes on, else at its start."""
        within = going and self.ints[IN_ARC] == arc
        self.ints[STEPS_DONE : FLIGHTS_DONE + 1], self.ints[IN_ARC] = 0, 0 if within else -1
        self.ints[AGAIN], self.floats[SINCE], self.floats[SINCE_LOW] = GOES_ON, t, low

    def make_room(self, t: float) -> None:
        """Double the capacity, after dropping pieces that no lag sees from time ``t`` on."""
        self._forget(t)
        self.pieces.grow()
        self.breaks.grow()

    def _forget(self, t: float) -> None:
        """If all lags are constant, drop pieces that none of them sees from time ``t`` on."""
        if not any(self.moving):
            self.pieces.forget(t - self._now.max())
            self.breaks.forget(t - self._now.max())

    @contextmanager
    def as_at(self, t: float, x: StateVector) -> Iterator[Then]:
        """The record and the windows at an earlier time, which the rules' loop has passed.

        On exit the present ones are restored, unless the :class:`Then` is marked as kept.
        """
        were, then = vars(self).copy(), Then(self.scene)
        try:
            vars(self).update(vars(self.fork()))
            self._joins, self._looks_back = False, True
            self._frames[:, LONGEST] = np.inf
            if self.plan.memory == "restart" and t > self.plan.t0:
                self._restart(t, x)
            else:
                self.pieces.back_to(t)
                times = self.breaks.times
                self.ints[BREAKS] = np.searchsorted(times, t + slack_of(t), side="right")
            then.scene, self._looks_back = self.look(t, x), False
            yield then
        finally:
            if not then.kept:
                vars(self).update(were)

    def past(self, links: Links | None = None) -> PastArrays:
        """The record and the windows as arrays of the rules, with ``links`` or the last ones."""
        links = links or (self._made[-1] if self._made else NO_LINKS)
        arrays = self.pieces.rows, self.breaks.arrays[0], links
        if self._past is None or any(a is not b for a, b in zip(arrays, self._made, strict=True)):
            self._past, self._made = self._as_arrays(links), arrays
        return self._past

    def _as_arrays(self, links: Links) -> PastArrays:
        n, pieces = self.scene.spec.dimension, self.pieces
        seen = np.array([[int(e in s) for e in range(n)] for s in self.seen], dtype=np.int64)
        atol = np.broadcast_to(np.asarray(self.plan.atol, dtype=float), (n,)).copy()
        return PastArrays(
            *(self.floats, self.ints, self._now, self._moves),
            *(pieces.spans, pieces.degrees, pieces.rows),
            *(*self.breaks.arrays, self._frames, seen, seen.max(axis=0), links.uses, links.asks),
            *(links.bent, atol, links.given, links.ranged, links.parts, links.ops),
            *(links.more, links.numbers),
            *(self.shown, self.sights, nodes(WINDOW_DEGREE).copy(), FROM_VALUES, TO_PLACES, TURN),
            *(np.zeros(n, dtype=np.int64), np.zeros((len(self._now), n), dtype=np.int64)),
            *(np.zeros((2, WINDOW_DEGREE + 1)), self._supplied, self._present),
            *(self._begun, links.signs, *self._before),
        )

    def _place(self, k: int, t: float, x: StateVector) -> float:
        """The time ``t - lag`` for lag number ``k``."""
        lag = self._lags[k](t, x.tolist())
        if not (isfinite(lag) and lag >= 0):
            state = self.scene.spec.record(x)
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}, {state}: the lag {self.names[k]} is {lag!r}; "
                "it must be a number of at least 0"
            ).by("forgotten")
        return t - lag

    # -- at the end of a window -------------------------------------------------------------

    def confirm(self, now: Instant, length: float, segments: Sequence[Segment]) -> Scene | None:
        """Check extrapolated windows after a flight: None if they agree with the flight, else the
        scene with which to repeat it."""
        if not self.guessing or not segments:
            return None
        for segment in segments:
            self.pieces.add(piece_of(segment, now.t, now.low))
        if self.pieces.full:
            self.pieces.grow()
        status = unit("windows").confirmed(self.floats[GUESSED_FROM], length, self.past())
        if status == HOLDS:
            self.ints[PIECES_KEPT] = self.ints[PIECES_KNOWN]
            return None
        self._found(status)
        return self.read()

    def ends(self, t: float) -> bool:
        """Whether the windows end within rounding of time ``t``."""
        if self.told:
            return False
        return t < self.until < self.plan.t1 and self.until - t <= 2.0 * slack_of(t)

    def passed(self, t: float, x: StateVector, field: Field, fired: str | None = None) -> None:
        """Record the breaking point at the end of the windows, which the run has reached.

        ``fired`` is the edge of the guard that detects that a varying lag leaves its window.
        """
        ends = window_ends(self.scene.spec)
        if fired:
            self._require_way(t, self.names[ends.index(fired) // 2])
        self._looks(t, x)
        self.breaks.reserve()
        past = self._within(field)
        unit("past").ended(t, 0, ends.index(fired) if fired else -1, past)
        self.loose = frozenset(self._loose(field, past.least))
        self.until = t

    def _loose(self, field: Field, orders: Integers) -> Iterator[str]:
        """What holds the state in a field and may let it go where lags meet breaking points: the
        contacts whose gap or gap speed jumps there, and the surface that does.

        Windows may end there for other reasons, and be so short that rates in them are rounding.
        """
        code = self.scene.code
        for name in field.held:
            gap, speed = code.mode(field.mode).shown(name)
            if any(orders[p] <= 1 for p in gap) or any(orders[p] <= 0 for p in speed):
                yield name
        sliding = self.scene.spec.sliding(field.mode)
        if sliding is not None:
            key, surface = ("shown", sliding.name), code.closed("surface", sliding.name)
            (seen,) = code.once(key, lambda: code.asked(surface))
            if any(orders[p] <= 0 for p in seen):
                yield sliding.name

    def _require_way(self, t: float, lag: str) -> None:
        """Refuse a moving lag whose place is led back to one breaking point from both sides.

        Raises
        ------
        FlowError
            If its windows have ended so many times with no time to speak of between them.
        """
        brief = t - self._turned[0] <= BRIEF_WINDOW * slack_of(t)
        self._turned = t, self._turned[1] + 1 if brief else 0
        if self._turned[1] > MOST_TURNS:
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}: the lag {lag} looks at a jump of the record, "
                "and the flows before it and behind it both lead there: what follows is not "
                "unique; make the history join the start, or the lag independent of what sees "
                "that jump"
            ).by("undecided")
