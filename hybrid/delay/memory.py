"""What a run with delays remembers, and until when its flows look through the same windows.

Between two breaking points of what they see, flows with delays are flows that depend on time: the
record at ``t - lag`` is smooth there, and is handed to them as a polynomial (a *window*). The
driver flies from window to window; everything else (guards, contacts, accumulations, rests) does
not know of delays. A window ends

* where what is seen does not join smoothly: a breaking point, hit exactly. Its order is tracked
  for each element of the state (0: it jumps, 1: its derivative does, ...), through each lag, until
  it is above that of the method;
* where one polynomial would not be as accurate as the run;
* where the record ends, if the lag is no shorter than a step. If it is, what will be seen is
  guessed, flown over, and guessed again until it is what was flown.

See ``docs/notes/delays.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from math import isfinite
from typing import Any

import attrs
import numpy as np

from ..automaton.past import blank
from ..errors import FlowError
from ..lowering import Field, Scene, window_edge
from ..lowering.taylor import flat
from ..rules import unit
from ..rules.arrays import PastArrays
from ..rules.past import BRIEF_FLIGHT, SMOOTH_ORDER, WINDOW_SHARE
from ..rules.places import (
    AGAIN,
    BREAK_ORDER,
    BREAKS,
    FINAL,
    FLIGHTS_DONE,
    GOES_ON,
    IN_ARC,
    RTOL,
    SERVES_UNTIL,
    SINCE,
    SINCE_LOW,
    STEPPED,
    STEPS_DONE,
    TIGHT,
    TIGHTEST,
    WINDOW_DEGREE,
)
from ..segment import Segment, from_powers, from_values, nodes
from ..trajectory.arcs import Arc, TailPart
from ..trajectory.clock import Instant
from ..trajectory.log import Flights
from ..trajectory.plan import Plan
from .pieces import (
    WIDTH,
    Breaks,
    Piece,
    Pieces,
    Window,
    constant,
    piece_of,
    slack_of,
    swept,
)
from .reader import Reader
from .windows import NO_LINKS, TO_POWERS, Links

#: Windows in a row that are one step long before longer ones are guessed.
TIGHT_WINDOWS = 3

#: Sums that a call of the rules' own loop makes at most.
SUMS = 8

#: Where the rules' own loop reads windows: of how many a guess costs as much, and how many in a row
#: are one step long before it is tried.
DEAR, OFTEN = 16, 64

#: Windows without a guess after one that was not worth it; after each more of these twice as many,
#: up to so many.
GUESS_REST, LONGEST_REST = 30, 1 << 16

#: Most guesses at a window before a shorter one is tried.
GUESSES = 12

#: Highest order of breaking points that are noted once a lag has turned back over its past: each
#: is seen many times, and those times are themselves seen many times.
TURNING = 2

#: First length of windows to guess where a lag vanishes, against that of the run.
VANISHING_WINDOW = 1e-4

#: Guesses at a window up to which the next is longer.
EASY = 2

#: Times between which times are one that a guess spans at least.
GUESS_SPAN = 100.0

#: Degree up to which dense output falls behind a method of higher order.
CUBIC = 3

#: From terms of powers of the fraction of a step to Chebyshev coefficients.
TURN = np.ascontiguousarray(from_powers(WIDTH - 1))

#: From values at the nodes of a window to Chebyshev coefficients, and from these to powers.
FROM_VALUES, TO_PLACES = map(np.ascontiguousarray, (from_values(WINDOW_DEGREE), TO_POWERS))


@attrs.define
class Then:
    """A scene as it looked back earlier; ``kept``: the run goes on from there."""

    scene: Scene
    kept: bool = False


class Memory:
    """The record of a run with delays, and the windows on it.

    Attributes
    ----------
    until : float
        The present windows serve until this time.
    shown : array
        Their numbers, as the trace takes them.
    bound : bool
        Whether the programs of the rules' own loop have them.
    told : bool
        The loop has remembered what is being kept.
    sights : array
        Of each sum that a call of the loop has made, the windows.
    """

    def __init__(
        self, scene: Scene, plan: Plan, order: int, history: Sequence[Piece], x: np.ndarray
    ) -> None:
        spec, code = scene.spec, scene.code
        self.scene, self.plan, self.order = scene, plan, order
        self.moving, self.seen = code.moving, code.seen
        self.all_seen = sorted({element for seen in self.seen for element in seen})
        hidden = flat([*scene.parameters[: len(spec.parameters)], *blank(spec.lags, len(x))])
        self._lags = [code.lag(k).bind(hidden) for k in range(len(spec.lags))]
        self.names = [lag.name for lag in spec.lags]
        self.floats, self.ints = np.zeros(6), np.zeros(12, dtype=np.int64)
        self.floats[[FINAL, RTOL, SERVES_UNTIL]] = plan.t1, plan.rtol, plan.t0
        self.ints[BREAK_ORDER], self.ints[AGAIN] = order + 1, GOES_ON
        self.ints[TIGHTEST], self.ints[IN_ARC] = TIGHT_WINDOWS, -1
        self.pieces, self.breaks = Pieces(self.ints, history, len(x)), Breaks(self.ints, len(x))
        for piece in history:
            if piece.orders is not None:
                self.breaks.add(piece.start, piece.orders)
        self.breaks.add(plan.t0, self._start(x))
        self.windows: list[Window] = []
        self._frames = np.tile([0.0, 0.0, np.inf], (len(self._lags), 1))
        self.reader = Reader(scene, plan, self.pieces, self.breaks, self._frames)
        self.shown, self.bound, self.told = np.array(hidden[-self._size :]), False, False
        self.sights = np.empty((SUMS, self._size))
        self._fixed = self._all_fixed(x)
        self._past: PastArrays | None = None
        self._made: tuple[Any, ...] = ()
        self._begun, self._joins = np.zeros(len(x)), False
        self._dear, self._rest, self._looks_back = 1, GUESS_REST, False
        self._from = plan.t0, x
        self._stride, self._shortest, self._guesses = 0.0, 0.0, 0
        self._wrong, self._most = np.inf, np.inf

    @property
    def start(self) -> np.ndarray:
        """The state where the rules' own loop has gone on through windows within an arc."""
        return self._begun

    @property
    def signs(self) -> np.ndarray:
        """The signs of the guards there."""
        return self.past().signs  # type: ignore[no-any-return]

    @property
    def _size(self) -> int:
        """Numbers of all windows."""
        return len(self._lags) * (2 + (WINDOW_DEGREE + 1) * self.scene.spec.dimension)

    def _all_fixed(self, x: np.ndarray) -> np.ndarray | None:
        """The lags, if all are constant and may be."""
        if any(self.moving):
            return None
        lags = np.array([lag(self.plan.t0, x.tolist()) for lag in self._lags], dtype=float)
        return lags if np.all(np.isfinite(lags) & (lags >= 0)) else None

    @property
    def until(self) -> float:
        """The present windows serve until this time."""
        return float(self.floats[SERVES_UNTIL])

    @until.setter
    def until(self, t: float) -> None:
        self.floats[SERVES_UNTIL] = t

    def due(self, t: float) -> bool:
        """Whether other windows are due at a time."""
        return not self.told and self.until <= t

    def _start(self, x: np.ndarray) -> np.ndarray:
        """Orders at the start: 0 where the history does not lead to it."""
        end = self.pieces.last.state(self.plan.t0, np.zeros(1))[0]
        return np.where(end == x, 1, 0)

    def fork(self) -> Memory:
        """The same, for a run that leaves this one here."""
        other = copy(self)
        other.floats, other.ints = self.floats.copy(), self.ints.copy()
        other.pieces, other.breaks = self.pieces.copy(other.ints), self.breaks.copy(other.ints)
        other._frames, other.shown = self._frames.copy(), self.shown.copy()
        other.reader = Reader(self.scene, self.plan, other.pieces, other.breaks, other._frames)
        other.reader.backwards = self.reader.backwards
        other.sights, other._begun = self.sights.copy(), self._begun.copy()
        other.bound, other.told, other._past = False, False, None
        return other

    def refined(self, field: Field, now: Instant, segments: Sequence[Segment]) -> list[Segment]:
        """Dense output as accurate as the steps, where a method's own is a cubic (if that).

        What is read off between the steps is flown by a lag later: its errors are not made good.
        """
        return [
            swept(field, now, segment, self.order - segment.degree)
            if segment.degree <= CUBIC < self.order
            else segment
            for segment in segments
        ]

    # -- what happens ---------------------------------------------------------------------

    def flown(self, now: Instant, segments: Sequence[Segment]) -> None:
        """Segments flown from an instant on (their starts are counted from it)."""
        if self.told:
            return
        self.ints[STEPPED] += len(segments)
        for segment in segments:
            self.pieces.add(piece_of(segment, now.t, now.low))

    def flights(self, flights: Flights) -> None:
        """Arcs in a row, and the jumps after them."""
        for arc, row in zip(flights.arcs, flights.rows(), strict=True):
            self.flown(Instant(arc.t0, arc.low), arc.segments)
            self.jumped(row.t, row.before, row.after)

    def jumped(self, t: float, before: np.ndarray, after: np.ndarray) -> None:
        """A jump; with ``memory="restart"`` all before it is forgotten."""
        if self.told:
            return
        if self.plan.memory == "restart":
            self._restart(t, after)
            return
        stays = before == after
        self.breaks.add(t, np.where(stays, 1, 0))
        if any(self.moving) or self.guessing:
            self.until, self._joins = t, True

    def _restart(self, t: float, x: np.ndarray) -> None:
        self.pieces.forget_all([constant(x, t)])
        self.ints[BREAKS] = 0
        self.breaks.add(t, np.ones(len(x), dtype=int))
        self.until = t

    def tail(self, part: TailPart) -> None:
        """Impacts up to their limit: one by one while they are seen, then the limit alone."""
        tail = part.tail
        if self.told:
            return
        if self.plan.memory == "restart":
            self._restart(part.t1, tail.x_inf)
            return
        for n in range(tail.count + 1):
            arc = part.arc(n)
            last = n == tail.count or arc.length <= BRIEF_FLIGHT * np.spacing(part.t1)
            if last or self._low(arc, tail.x_inf):
                break
            self.flown(Instant(arc.t0, arc.low), arc.segments)
            row = part.jump(n + 1)
            self.breaks.add(row.t, np.where(row.before == row.after, 1, 0))
        since = self.pieces.last.end
        ends = np.array([arc.first, tail.x_inf])
        straight = np.array([[0.5, 0.5], [-0.5, 0.5]]) @ ends
        self.pieces.add(piece_of(Segment(0.0, part.t1 - since, straight), since, 0.0))
        self.breaks.add(part.t1, np.ones(len(tail.x_inf), dtype=int))

    def _low(self, arc: Arc, x: np.ndarray) -> bool:
        """Whether nothing that is seen of a flight can be told from the limit."""
        there = np.concatenate([s(s.start + s.length * nodes(4)) for s in arc.segments])
        return self._near(there, x)

    def stays(self, part: TailPart) -> bool:
        """Whether impacts up to their limit see the past that is shown here.

        A lag that vanishes sees the impacts themselves, and after restarts all see the last.
        """
        limit = part.tail.x_inf
        if self.plan.memory == "restart":
            return self._near(part.tail.x, limit)
        return not self.guessing or self._low(part.arc(0), limit)

    def _near(self, there: np.ndarray, x: np.ndarray) -> bool:
        """Whether what is seen of some states cannot be told from a state."""
        seen = self.all_seen
        return bool(np.all(np.abs(there - x)[..., seen] <= self.reader.allowed(x)[seen]))

    # -- windows --------------------------------------------------------------------------

    @property
    def guessing(self) -> bool:
        """Whether a window shows what is not yet flown."""
        return any(window.guess.any() for window in self.windows)

    @property
    def known(self) -> float:
        """Until when the windows show what was flown."""
        return self._from[0] if self.guessing else self.until

    def look(self, t: float, x: np.ndarray) -> Scene:
        """The scene as it looks back from a time; ``until`` says for how long."""
        self._from, self._guesses, self._wrong = (t, x), 0, np.inf
        if self._goes_on(t, x):
            return self._scene()
        if self._fixed is not None and unit("past").read(t, self.past()):
            self._forget((t - self._fixed).tolist())
            return self.read()
        self.ints[STEPPED] = 0
        places = [self._place(k, t, x) for k in range(len(self._lags))]
        self._forget(places)
        stride = self._wanted(t, places)
        end = min(self.plan.t1, t + stride) if stride else self.plan.t1
        self.windows = []
        for k, s in enumerate(places):
            window = self.reader.window(k, t, s, np.inf if stride else t, end - t, x)
            if not self.moving[k]:
                end = min(end, window.b + (t - s))
            self.windows.append(window)
        self.until = min(self.plan.t1, max(end, t + slack_of(t)))
        return self._scene()

    def _goes_on(self, t: float, x: np.ndarray) -> bool:
        """Whether behind a jump lags look through the same windows, up to the jump.

        A guard that has fired is zero through these: through others only to the tolerance.
        """
        joins, self._joins = self._joins, False
        if not joins:
            return False
        places = [self._place(k, t, x) for k in range(len(self._lags))]
        windows, slack = [window.cut(t) for window in self.windows], slack_of(t)
        if not all(w.a + slack < s < w.b - slack for w, s in zip(windows, places, strict=True)):
            return False
        ends = [
            window.b + (t - s)
            for window, s, moves in zip(windows, places, self.moving, strict=True)
            if not moves
        ]
        self.windows, self.until = windows, min([self.plan.t1, *ends])
        self.ints[TIGHT], self._stride = 0, 0.0
        return True

    def _scene(self) -> Scene:
        arrays = [a.reshape(-1) for w in self.windows for a in w.arrays()]
        self.shown[:], self.bound = np.concatenate(arrays), False
        self._frames[:, :2] = [(window.a, window.b) for window in self.windows]
        return self.scene.through([self.shown])

    def read(self) -> Scene:
        """The scene as it looks back through windows that the rules have read off the record."""
        nothing, known = np.zeros((1, self.scene.spec.dimension)), np.zeros(1, dtype=bool)
        ends, self.bound = self._frames[:, :2].tolist(), False
        self.windows = [Window(a, b, nothing, known, nothing[0]) for a, b in ends]
        return self.scene.through([self.shown])

    def looped(self) -> None:
        """Be remembered by the rules' own loop."""
        self._dear, self.ints[TIGHTEST] = DEAR, OFTEN

    def begins(self, going: int, arc: int, t: float, low: float) -> None:
        """Begin a call of the rules' own loop, in the middle of an arc or before one."""
        within = going and self.ints[IN_ARC] == arc
        self.ints[STEPS_DONE : FLIGHTS_DONE + 1], self.ints[IN_ARC] = 0, 0 if within else -1
        self.ints[AGAIN], self.floats[SINCE], self.floats[SINCE_LOW] = GOES_ON, t, low

    def make_room(self, t: float) -> None:
        """Room for more pieces and breaking points than what is seen from a time on."""
        assert self._fixed is not None
        self._forget((t - self._fixed).tolist())
        self.pieces.grow()
        self.breaks.grow()

    @contextmanager
    def as_at(self, t: float, x: np.ndarray) -> Iterator[Then]:
        """What was to be seen at a time that the rules' own loop has gone beyond.

        Unless that is kept all is as before.
        """
        arrays = self.floats, self.ints, self._frames, self.shown
        were, others = [array.copy() for array in arrays], vars(self).copy()
        then = Then(self.scene)
        try:
            self.told, self._joins, self._looks_back = False, False, True
            self.pieces.back_to(t)
            self._frames[:, 2] = np.inf
            self.ints[BREAKS] = np.searchsorted(self.breaks.times, t + slack_of(t), side="right")
            then.scene, self._looks_back = self.look(t, x), False
            yield then
        finally:
            if not then.kept:
                for array, was in zip(arrays, were, strict=True):
                    array[:] = was
                vars(self).update(others)

    def past(self, links: Links | None = None) -> PastArrays:
        """The record and the windows as the rules take them; with the links given last."""
        links = links or (self._made[-1] if self._made else NO_LINKS)
        arrays = self.pieces.rows, self.breaks.arrays[0], links
        if self._past is None or any(a is not b for a, b in zip(arrays, self._made, strict=True)):
            self._past, self._made = self._as_arrays(links), arrays
        return self._past

    def _as_arrays(self, links: Links) -> PastArrays:
        n, pieces = self.scene.spec.dimension, self.pieces
        lags = np.zeros(0) if self._fixed is None else self._fixed
        seen = np.array([[int(e in s) for e in range(n)] for s in self.seen], dtype=np.int64)
        atol = np.broadcast_to(np.asarray(self.plan.atol, dtype=float), (n,)).copy()
        return PastArrays(
            *(self.floats, self.ints, lags, pieces.spans, pieces.degrees, pieces.rows),
            *(*self.breaks.arrays, self._frames, seen, seen.max(axis=0), links.uses, links.asks),
            *(atol, links.given, links.ranged, links.parts, links.ops, links.more, links.numbers),
            *(self.shown, self.sights, nodes(WINDOW_DEGREE).copy(), FROM_VALUES, TO_PLACES, TURN),
            *(np.zeros(n, dtype=np.int64), np.zeros((len(lags), n), dtype=np.int64)),
            *(np.zeros((2, WINDOW_DEGREE + 1)), self._begun, links.signs),
        )

    def _place(self, k: int, t: float, x: np.ndarray) -> float:
        """Where a lag looks."""
        lag = self._lags[k](t, x.tolist())
        if not (isfinite(lag) and lag >= 0):
            state = self.scene.spec.record(x)
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}, {state}: the lag {self.names[k]} is {lag!r}; "
                "it must be a number of at least 0"
            ).by("forgotten")
        return t - lag

    def _forget(self, places: list[float]) -> None:
        if not any(self.moving) and not self._looks_back:
            self.pieces.forget(min(places))
            self.breaks.forget(min(places))

    def _wanted(self, t: float, places: list[float]) -> float:
        """Length of windows to guess; 0 where the record reaches far enough."""
        slack, latest = slack_of(t), max(places)
        self._shortest = shortest = t - latest
        nothing = shortest <= slack
        if not nothing and self.breaks.after(latest, slack) <= t:
            self.ints[TIGHT], self._stride = 0, 0.0
            return 0.0
        if self._stride and self._stride <= shortest:
            self.ints[TIGHT], self._stride = 0, 0.0
        if (nothing or self.ints[TIGHT] >= self.ints[TIGHTEST]) and not self._stride:
            least = VANISHING_WINDOW * (self.plan.t1 - self.plan.t0) if nothing else 0.0
            self._stride = max((4.0 if self._dear == 1 else 8.0 * self._dear) * shortest, least)
        return self._stride

    # -- at the end of a window -------------------------------------------------------------

    def confirm(self, now: Instant, length: float, segments: Sequence[Segment]) -> Scene | None:
        """After a flight: None if its windows showed what was flown, else the scene to fly anew."""
        if not self.guessing or not segments:
            return None
        flown = [piece_of(segment, now.t, now.low) for segment in segments]
        corrected = [
            self.reader.corrected(k, window, flown) for k, window in enumerate(self.windows)
        ]
        before, self._wrong = self._wrong, max(wrong for wrong, _ in corrected)
        stuck = self._wrong > 0.5 * before
        if self._wrong <= 1.0 or (stuck and self._wrong <= 1.0 / WINDOW_SHARE):
            self._pays(length)
            return None
        self._guesses += 1
        t = self._from[0]
        if length < 0.9 * (self.until - t):
            self._stride = max(length, GUESS_SPAN * slack_of(t))  # an edge fired
        elif self._guesses <= GUESSES and not stuck:
            self.windows = [window for _, window in corrected]
            return self._scene()
        else:
            self._stride *= 0.25
            self._most = 2.0 * self._stride
            self._require_stride(t)
        return self.look(*self._from)

    def _pays(self, length: float) -> None:
        """Longer guesses next where they are easy, none for a while where they cost too much."""
        self._most *= 1.2
        self._stride = min((2.0 if self._guesses <= EASY else 1.0) * length, self._most)
        if length < (1 + self._guesses) * self._dear * self._shortest:
            self._stride, self.ints[TIGHT] = 0.0, -self._rest
            self._rest, self._most = min(2 * self._rest, LONGEST_REST), np.inf
        else:
            self._rest = GUESS_REST

    def _require_stride(self, t: float) -> None:
        """Refuse guesses at nothing, where there is nothing else."""
        if self._stride < GUESS_SPAN * slack_of(t) and self._shortest <= slack_of(t):
            state = self.scene.spec.record(self._from[1])
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}, {state}: a lag is next to nothing, and what "
                "is seen through it cannot be found; write the state itself where the lag is 0"
            )

    def ends(self, t: float) -> bool:
        """Whether the windows end within rounding of a time."""
        if self.told:
            return False
        return t < self.until < self.plan.t1 and self.until - t <= 2.0 * slack_of(t)

    def passed(self, t: float, x: np.ndarray, field: Field, fired: str | None = None) -> None:
        """The windows' end is reached: note the breaking point that follows from theirs.

        ``fired`` is the edge of the guard by which a lag that moves came to the end of its own.
        """
        self.reader.backwards = {
            k for k in range(len(self.windows)) if fired == window_edge(k, "a")
        }
        if self.reader.backwards:
            self.ints[BREAK_ORDER] = min(self.ints[BREAK_ORDER], TURNING)
        met = {}
        for k, window in enumerate(self.windows):
            end = self._met(k, window, t, x, fired)
            orders = None if end is None else self.breaks.at(end, slack_of(t, end))
            if orders is not None:
                met[k] = orders
        if met:
            orders = self._carried(field, met)
            if orders[self.all_seen].min(initial=SMOOTH_ORDER) <= self.ints[BREAK_ORDER]:
                self.breaks.add(t, orders)
        few, tight = self.ints[STEPPED] <= 2 and not met, int(self.ints[TIGHT])
        self.ints[TIGHT] = tight + 1 if few else min(tight, 0)
        self.until = t

    def _met(
        self, k: int, window: Window, t: float, x: np.ndarray, fired: str | None
    ) -> float | None:
        """The end of its window that a lag has come to; None if it is on its way."""
        if k in self.reader.backwards:
            return window.a
        here = self._place(k, t, x)
        slack = slack_of(t, here) * (1e2 if self.moving[k] else 1.0)
        ended = fired == window_edge(k, "b") or here >= window.b - slack
        return window.b if ended else None

    def _carried(self, field: Field, seen: dict[int, np.ndarray]) -> np.ndarray:
        """Orders of the elements where some lags see breaking points."""
        reach = field.code.reach(field.mode, field.held)
        own = [
            1 + min((int(seen[k][e]) for k, e in past if k in seen), default=SMOOTH_ORDER)
            for _, past in reach
        ]
        for _ in own:
            own = [
                min(order, 1 + min((own[j] for j in uses if j != i), default=SMOOTH_ORDER))
                for i, (order, (uses, _)) in enumerate(zip(own, reach, strict=True))
            ]
        return np.array(own)
