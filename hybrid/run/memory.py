"""What a run with delays remembers, and the windows through which its flows look back.

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

from collections import deque
from collections.abc import Sequence
from copy import copy
from math import isfinite, isinf

import numpy as np

from ..arcs import Arc, TailPart
from ..automaton.past import DEGREE, blank
from ..clock import Instant
from ..errors import FlowError
from ..scene import Field, Scene, window_edge
from ..scene.taylor import flat
from ..scene.windows import SHARE, SMOOTH
from ..segment import Segment, nodes
from .pieces import Breaks, Piece, Pieces, Window, constant, piece_of, slack_of, states, swept
from .plan import Plan

#: Windows in a row that are one step long before longer ones are guessed.
TIGHT = 3

#: Windows without a guess after one that was not worth it.
REST = 30

#: Most guesses at a window before a shorter one is tried.
GUESSES = 12

#: Longest window of a lag that depends on time or state, against the run, and what part of it may
#: lie behind, against the part ahead.
MOST, SIDE = 0.1, 0.25

#: Highest order of breaking points that are noted once a lag has turned back over its past: each
#: is seen many times, and those times are themselves seen many times.
TURNING = 2

#: First length of windows to guess where a lag vanishes, against that of the run.
LEAST = 1e-4

#: How far the last piece is taken to go on, against its length.
FAR = 2.0

#: Guesses at a window up to which the next is longer.
EASY = 2

#: Times between which times are one that a guess spans at least.
LITTLE = 100.0

#: Places at which a record may be rough within a time this short against the run.
ROUGH, NEAR = 20, 1e-3

#: Keeps ratios finite.
TINY = 1e-300

#: Degree up to which dense output falls behind a method of higher order.
CUBIC = 3

#: A flight as short as this many spacings of the time is no longer a piece of its own.
BRIEF = 1e4


class Memory:
    """The record of a run with delays, and the windows on it.

    Attributes
    ----------
    until : float
        The present windows serve until this time.
    """

    def __init__(
        self, scene: Scene, plan: Plan, order: int, history: Sequence[Piece], x: np.ndarray
    ) -> None:
        spec, code = scene.spec, scene.code
        self.scene, self.plan, self.order, self.highest = scene, plan, order, order + 1
        self.moving, self.seen = code.moving, code.seen
        self.all_seen = sorted({element for seen in self.seen for element in seen})
        hidden = flat([*scene.parameters[: len(spec.parameters)], *blank(spec.lags, len(x))])
        self._lags = [code.lag(k).bind(hidden) for k in range(len(spec.lags))]
        self.names = [lag.name for lag in spec.lags]
        self.pieces, self.breaks = Pieces(history), Breaks()
        for piece in history:
            if piece.orders is not None:
                self.breaks.add(piece.start, piece.orders)
        self.breaks.add(plan.t0, self._start(x))
        self.windows: list[Window] = []
        self.until = plan.t0
        self._joined = False
        self._spans = [np.inf] * len(self._lags)
        self._stride, self._shortest, self._tight, self._guesses = 0.0, 0.0, 0, 0
        self._backwards: set[int] = set()
        self._wrong, self._most = np.inf, np.inf
        self._rough: deque[float] = deque(maxlen=ROUGH)

    def _start(self, x: np.ndarray) -> np.ndarray:
        """Orders at the start: 0 where the history does not lead to it."""
        end = self.pieces.last.state(self.plan.t0, np.zeros(1))[0]
        return np.where(end == x, 1, 0)

    def fork(self) -> Memory:
        """The same, for a run that leaves this one here."""
        other = copy(self)
        other.pieces, other.breaks = self.pieces.copy(), self.breaks.copy()
        other._spans = self._spans.copy()
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
        for segment in segments:
            self.pieces.add(piece_of(segment, now.t, now.low))
            self._joined = True

    def jumped(self, t: float, before: np.ndarray, after: np.ndarray) -> None:
        """A jump; with ``memory="restart"`` all before it is forgotten."""
        if self.plan.memory == "restart":
            self._restart(t, after)
            return
        stays = before == after
        self.breaks.add(t, np.where(stays, 1, 0))
        self._joined = self._joined and bool(stays.all())
        if any(self.moving) or self.guessing:
            self.until = t

    def _restart(self, t: float, x: np.ndarray) -> None:
        self.pieces, self.breaks = Pieces([constant(x, t)]), Breaks()
        self.breaks.add(t, np.ones(len(x), dtype=int))
        self.until, self._joined = t, True

    def tail(self, part: TailPart) -> None:
        """Impacts up to their limit: one by one while they are seen, then the limit alone."""
        tail = part.tail
        if self.plan.memory == "restart":
            self._restart(part.t1, tail.x_inf)
            return
        for n in range(tail.count + 1):
            arc = part.arc(n)
            last = n == tail.count or arc.length <= BRIEF * np.spacing(part.t1)
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
        self._joined = True

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
        return bool(np.all(np.abs(there - x)[..., seen] <= self._allowed(x)[seen]))

    def _allowed(self, x: np.ndarray) -> np.ndarray:
        size = np.abs(x)
        return SHARE * (self.plan.atol + self.plan.rtol * size) + 4e-16 * size

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
        self._from, self._steps, self._guesses, self._wrong = (t, x), 0, 0, np.inf
        places = [self._place(k, t, x) for k in range(len(self._lags))]
        self._forget(places)
        stride = self._wanted(t, places)
        end = min(self.plan.t1, t + stride) if stride else self.plan.t1
        self.windows = []
        for k, s in enumerate(places):
            window = self._window(k, t, s, np.inf if stride else t, end - t)
            if not self.moving[k]:
                end = min(end, window.b + (t - s))
            self.windows.append(window)
        self.until = min(self.plan.t1, max(end, t + slack_of(t)))
        return self._scene()

    def _scene(self) -> Scene:
        return self.scene.through([array for w in self.windows for array in w.arrays()])

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
        if not any(self.moving):
            self.pieces.forget(min(places))
            self.breaks.forget(min(places))

    def _wanted(self, t: float, places: list[float]) -> float:
        """Length of windows to guess; 0 where the record reaches far enough."""
        slack, latest = slack_of(t), max(places)
        self._shortest = shortest = t - latest
        nothing = shortest <= slack
        if not nothing and self.breaks.after(latest, slack) <= t:
            self._tight, self._stride = 0, 0.0
            return 0.0
        if self._stride and self._stride <= shortest:
            self._tight, self._stride = 0, 0.0
        if (nothing or self._tight >= TIGHT) and not self._stride:
            least = LEAST * (self.plan.t1 - self.plan.t0) if nothing else 0.0
            self._stride = max(4.0 * shortest, least)
        return self._stride

    def _window(self, k: int, t: float, s: float, known: float, length: float) -> Window:
        """A window of a lag that looks at ``s``."""
        slack = slack_of(t, s)
        a, b, pad = *self._ends(k, s, known, length, slack), 0.5 * slack if self.moving[k] else 0.0
        whole = b - a
        while True:
            pieces = self.pieces.within(a, min(b, t), slack)
            window = self._sampled(a - pad, b + pad, t, pieces)
            exact = len(pieces) == 1 and pieces[0].degree <= DEGREE and not window.guess.any()
            fine = exact or self._resolved(k, window)
            if fine or b - a <= 1e3 * slack:
                self._note_rough(fine, s)
                if b - a < whole or whole >= self._spans[k]:
                    self._spans[k] = 2.0 * (b - a)
                return window
            if k in self._backwards:
                a = 0.5 * (a + b)
            else:
                b = self._shorter(s, b, t, pieces, slack)
                a = max(a, s - SIDE * (b - s))

    def _note_rough(self, fine: bool, s: float) -> None:
        """Refuse a record that is rough everywhere, not at some places only."""
        if fine:
            return
        self._rough.append(s)
        near = abs(self._rough[-1] - self._rough[0]) < NEAR * (self.plan.t1 - self.plan.t0)
        if len(self._rough) == ROUGH and near:
            raise FlowError(
                f"{self.scene.spec.model}: the record at {s!r} is rough: no polynomial shows it to "
                "rtol and atol (a history in 32 bits, or of measured numbers?); give a smooth one, "
                "or larger tolerances"
            )

    def _ends(
        self, k: int, s: float, known: float, length: float, slack: float
    ) -> tuple[float, float]:
        """Both ends of a window, if it is resolved: where there is room, more than is needed."""
        span, end = self._spans[k], min(self.breaks.after(s, slack), known)
        if not self.moving[k]:
            return s, max(min(end, s + length, s + span), s + slack)
        span = min(span, MOST * (self.plan.t1 - self.plan.t0))
        if isinf(known):  # a guess need not go further than it is flown over
            span = min(span, 2.0 * length + 1e4 * slack)
        if k in self._backwards:
            return max(self.breaks.before(s, slack), s - span), min(s + slack, end)
        b = min(end, s + span)
        return min(s, max(self.breaks.until(s, slack), s - SIDE * (b - s))), b

    @staticmethod
    def _shorter(s: float, b: float, t: float, pieces: list[Piece], slack: float) -> float:
        """A nearer end: half as far in what is guessed, that of a piece, the middle."""
        if b - t > 0.25 * (t - s):
            return t + 0.5 * (b - t)
        ends = [p.end for p in pieces if s + slack < p.end < b - slack]
        return ends[len(ends) // 2] if ends else 0.5 * (s + b)

    def _sampled(self, a: float, b: float, t: float, pieces: list[Piece]) -> Window:
        """A window: the record at its nodes; beyond the present, a guess."""
        since, slack = (b - a) * nodes(DEGREE), slack_of(t)
        here = t - a
        guess = since > (here + slack if here > slack else -1.0)
        with np.errstate(all="ignore"):
            values = np.empty((len(since), self.scene.spec.dimension))
            if not guess.all():
                values[~guess] = states(pieces, a, since[~guess])
            if guess.any():
                values[guess] = self._ahead(a, since[guess])
        if not np.isfinite(values).all():
            bad = a + float(since[~np.isfinite(values).all(axis=1)][0])
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}: the record at {bad!r} is not finite; give a "
                "history that reaches back that far"
            ).by("forgotten")
        noise = 0.5 * slack_of(t, a) / (b - a) * (values.max(axis=0) - values.min(axis=0))
        return Window(a, b, values, guess, noise)

    def _ahead(self, s: float, since: np.ndarray) -> np.ndarray:
        """A first guess at what comes: the last piece goes on, or the state stays as it is.

        (Far beyond its end a polynomial leads nowhere.)
        """
        x, last = self._from[1], self.pieces.last
        far = s + float(since[-1]) > last.end + FAR * (last.end - last.start)
        if far or not self._joined:
            return np.broadcast_to(x, (len(since), len(x)))
        return last.state(s, since)

    def _resolved(self, k: int, window: Window) -> bool:
        """Whether the polynomial is the record, as far as the run can tell."""
        seen = list(self.seen[k])
        rest = np.abs(window.series[-3:]).sum(axis=0)
        allowed = self._allowed(np.abs(window.values).max(axis=0)) + window.noise
        return bool(np.all(rest[seen] <= allowed[seen]))

    # -- at the end of a window -------------------------------------------------------------

    def confirm(self, now: Instant, length: float, segments: Sequence[Segment]) -> Scene | None:
        """After a flight: None if its windows showed what was flown, else the scene to fly anew."""
        self._steps += len(segments)
        if not self.guessing or not segments:
            return None
        flown = [piece_of(segment, now.t, now.low) for segment in segments]
        before, self._wrong = self._wrong, self._correct(flown)
        stuck = self._wrong > 0.5 * before
        if self._wrong <= 1.0 or (stuck and self._wrong <= 1.0 / SHARE):
            self._pays(length)
            return None
        self._guesses += 1
        t = self._from[0]
        if length < 0.9 * (self.until - t):
            self._stride = max(length, LITTLE * slack_of(t))  # an edge fired
        elif self._guesses <= GUESSES and not stuck:
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
        if length < (1 + self._guesses) * self._shortest:
            self._stride, self._tight = 0.0, -REST

    def _require_stride(self, t: float) -> None:
        """Refuse guesses at nothing, where there is nothing else."""
        if self._stride < LITTLE * slack_of(t) and self._shortest <= slack_of(t):
            state = self.scene.spec.record(self._from[1])
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}, {state}: a lag is next to nothing, and what "
                "is seen through it cannot be found; write the state itself where the lag is 0"
            )

    def _correct(self, flown: list[Piece]) -> float:
        """Put what was flown into the guessed windows; how wrong they were, against what may be."""
        return max(self._corrected(k, window, flown) for k, window in enumerate(self.windows))

    def _corrected(self, k: int, window: Window, flown: list[Piece]) -> float:
        low, high = max(window.a, flown[0].start), min(window.b, flown[-1].end)
        if not window.guess.any() or not low < high:
            return 0.0
        since, seen = (low - window.a) + (high - low) * nodes(DEGREE), list(self.seen[k])
        there = states(flown, window.a, since)
        change = np.abs(window.shown(since) - there)
        window.values[window.guess] = states(flown, window.a, window.since[window.guess])
        allowed = self._allowed(np.abs(there).max(axis=0)) + window.noise + TINY
        return float(np.max((change / allowed)[:, seen], initial=0.0))

    def ends(self, t: float) -> bool:
        """Whether the windows end within rounding of a time."""
        return t < self.until < self.plan.t1 and self.until - t <= 2.0 * slack_of(t)

    def passed(self, t: float, x: np.ndarray, field: Field, fired: str | None = None) -> None:
        """The windows' end is reached: note the breaking point that follows from theirs.

        ``fired`` is the edge of the guard by which a lag that moves came to the end of its own.
        """
        self._backwards = {k for k in range(len(self.windows)) if fired == window_edge(k, "a")}
        if self._backwards:
            self.highest = min(self.highest, TURNING)
        met = {}
        for k, window in enumerate(self.windows):
            end = self._met(k, window, t, x, fired)
            orders = None if end is None else self.breaks.at(end, slack_of(t, end))
            if orders is not None:
                met[k] = orders
        if met:
            orders = self._carried(field, met)
            if orders[self.all_seen].min(initial=SMOOTH) <= self.highest:
                self.breaks.add(t, orders)
        self._tight = self._tight + 1 if self._steps <= 2 and not met else min(self._tight, 0)
        self.until = t

    def _met(
        self, k: int, window: Window, t: float, x: np.ndarray, fired: str | None
    ) -> float | None:
        """The end of its window that a lag has come to; None if it is on its way."""
        if k in self._backwards:
            return window.a
        here = self._place(k, t, x)
        slack = slack_of(t, here) * (1e2 if self.moving[k] else 1.0)
        ended = fired == window_edge(k, "b") or here >= window.b - slack
        return window.b if ended else None

    def _carried(self, field: Field, seen: dict[int, np.ndarray]) -> np.ndarray:
        """Orders of the elements where some lags see breaking points."""
        reach = field.code.reach(field.mode, field.held)
        own = [
            1 + min((int(seen[k][e]) for k, e in past if k in seen), default=SMOOTH)
            for _, past in reach
        ]
        for _ in own:
            own = [
                min(order, 1 + min((own[j] for j in uses if j != i), default=SMOOTH))
                for i, (order, (uses, _)) in enumerate(zip(own, reach, strict=True))
            ]
        return np.array(own)
