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

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from math import isfinite

import attrs
import numpy as np

from ..arcs import Arc, TailPart
from ..automaton.past import DEGREE, blank
from ..clock import Instant
from ..errors import FlowError
from ..scene import Field, Scene, window_edge
from ..scene.taylor import flat
from ..segment import Segment, from_values, nodes
from .plan import Plan

#: What a window may differ from the record, against the tolerance of a step.
SHARE = 0.1

#: Windows in a row that are one step long before longer ones are guessed.
TIGHT = 3

#: Most guesses at a window before a shorter one is tried.
GUESSES = 12

#: Rounding of a window's series, relative to what it shows.
ROUNDING = 1e-15

#: A flight as short as this many spacings of the time is no longer a piece of its own.
BRIEF = 1e4

#: Order of an element that is smooth.
SMOOTH = 10**6


@attrs.frozen(eq=False)
class Piece:
    """The record between two times: ``state(times)`` has shape ``(len(times), n)``.

    ``degree`` is that of a polynomial, infinity where it is a function of the caller's.
    """

    start: float
    end: float
    state: Callable[[np.ndarray], np.ndarray]
    degree: float


def piece_of(segment: Segment, t0: float, low: float) -> Piece:
    """A segment of an arc that starts at ``t0 + low``."""
    start, end = t0 + (low + segment.start), t0 + (low + segment.end)
    return Piece(start, end, lambda s: segment((s - t0) - low), segment.degree)


def constant(x: np.ndarray, end: float) -> Piece:
    """The same state for all times before ``end``."""
    return Piece(-np.inf, end, lambda s: np.broadcast_to(x, (len(s), len(x))), 0)


class Pieces:
    """The record: pieces in order of time, those no longer needed forgotten."""

    def __init__(self) -> None:
        self._pieces: list[Piece] = []
        self._ends: list[float] = []

    def add(self, piece: Piece) -> None:
        """Append a piece; one without length is left out."""
        if piece.end > piece.start:
            self._pieces.append(piece)
            self._ends.append(piece.end)

    def forget(self, before: float) -> None:
        """Drop what ends before a time, if that is the larger part."""
        count = bisect_left(self._ends, before)
        if count > 64 and 2 * count > len(self._pieces):
            del self._pieces[:count], self._ends[:count]

    def clear(self) -> None:
        """Forget all."""
        self._pieces.clear()
        self._ends.clear()

    @property
    def first(self) -> float:
        """Where the record begins."""
        return self._pieces[0].start

    @property
    def last(self) -> Piece:
        """The latest piece."""
        return self._pieces[-1]

    def within(self, a: float, b: float) -> list[Piece]:
        """Pieces that have a part between two times."""
        slack = _slack(a, b)
        first = bisect_right(self._ends, a + slack)
        last = first
        while last < len(self._pieces) and self._pieces[last].start < b - slack:
            last += 1
        return self._pieces[first:last]


class Breaks:
    """Breaking points of the record: times in order, and the order of each element there."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.orders: list[np.ndarray] = []

    def add(self, t: float, orders: np.ndarray) -> None:
        """A breaking point at the present time; those at one time are one."""
        if self.times and t <= self.times[-1] + _slack(t, t):
            self.orders[-1] = np.minimum(self.orders[-1], orders)
        else:
            self.times.append(t)
            self.orders.append(orders)

    def forget(self, before: float) -> None:
        """Drop those before a time, if they are the larger part."""
        count = bisect_left(self.times, before)
        if count > 64 and 2 * count > len(self.times):
            del self.times[:count], self.orders[:count]

    def after(self, s: float) -> float:
        """The next after a time, infinity if there is none."""
        place = bisect_right(self.times, s + _slack(s, s))
        return self.times[place] if place < len(self.times) else np.inf

    def until(self, s: float) -> float:
        """The last up to a time, minus infinity if there is none."""
        place = bisect_right(self.times, s + _slack(s, s))
        return self.times[place - 1] if place else -np.inf

    def before(self, s: float) -> float:
        """The last before a time, minus infinity if there is none."""
        place = bisect_left(self.times, s - _slack(s, s))
        return self.times[place - 1] if place else -np.inf

    def at(self, s: float) -> np.ndarray | None:
        """Orders at a time; None where there is no breaking point."""
        place = bisect_left(self.times, s - _slack(s, s))
        near = place < len(self.times) and self.times[place] <= s + _slack(s, s)
        return self.orders[place] if near else None


def _slack(a: float, b: float) -> float:
    """Times nearer than this are one."""
    sizes = [abs(v) for v in (a, b) if isfinite(v)]
    return 8.0 * float(np.spacing(max(sizes, default=0.0)))


@attrs.define(eq=False)
class Window:
    """A part of the record as one polynomial.

    ``guessed`` is the time from which it is a guess; ``values`` are the states at its nodes.
    """

    a: float
    b: float
    values: np.ndarray
    guessed: float

    @property
    def times(self) -> np.ndarray:
        return self.a + (self.b - self.a) * nodes(DEGREE)

    def arrays(self) -> list[np.ndarray]:
        """Frame and coefficients, as the trace takes them; what is rounding is left out.

        (On a short window the derivatives of rounding are large.)
        """
        frame = np.array([0.5 * (self.a + self.b), 0.5 * (self.b - self.a)])
        series = from_values(DEGREE) @ self.values
        noise = ROUNDING * np.abs(self.values).max(axis=0)
        heard = np.maximum.accumulate(np.abs(series)[::-1] > noise, axis=0)[::-1]
        return [frame, _TO_POWERS @ np.where(heard, series, 0.0)]


def _to_powers() -> np.ndarray:
    """From Chebyshev coefficients to those of powers of the place in the window."""
    columns = [np.polynomial.chebyshev.cheb2poly(row) for row in np.eye(DEGREE + 1)]
    return np.array([np.pad(column, (0, DEGREE + 1 - len(column))) for column in columns]).T


_TO_POWERS = _to_powers()


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
        self.scene, self.plan, self.highest = scene, plan, order + 1
        self.moving, self.seen = code.moving, code.seen
        hidden = flat([*scene.parameters[: len(spec.parameters)], *blank(spec.lags, len(x))])
        self._lags = [code.lag(k).bind(hidden) for k in range(len(spec.lags))]
        self.names = [lag.name for lag in spec.lags]
        self.pieces, self.breaks = Pieces(), Breaks()
        for piece in history:
            self.pieces.add(piece)
        self.breaks.add(plan.t0, self._start(x))
        self.windows: list[Window] = []
        self.until = plan.t0
        self._spans = [np.inf] * len(self._lags)
        self._stride, self._tight, self._guesses = 0.0, 0, 0
        self._backwards: set[int] = set()

    def _start(self, x: np.ndarray) -> np.ndarray:
        """Orders at the start: 0 where the history does not lead to it."""
        end = self.pieces.last.state(np.array([self.plan.t0]))[0]
        return np.where(end == x, 1, 0)

    # -- what happens ---------------------------------------------------------------------

    def flown(self, now: Instant, segments: Sequence[Segment]) -> None:
        """Segments flown from an instant on (their starts are counted from it)."""
        for segment in segments:
            self.pieces.add(piece_of(segment, now.t, now.low))

    def jumped(self, t: float, before: np.ndarray, after: np.ndarray) -> None:
        """A jump; with ``memory="restart"`` all before it is forgotten."""
        if self.plan.memory == "restart":
            self._restart(t, after)
        else:
            self.breaks.add(t, np.where(before == after, 1, 0))
        if self.plan.memory == "restart" or any(self.moving) or self.guessing:
            self.until = t

    def _restart(self, t: float, x: np.ndarray) -> None:
        self.pieces.clear()
        self.pieces.add(constant(x, t))
        self.breaks = Breaks()
        self.breaks.add(t, np.ones(len(x), dtype=int))
        self.until = t

    def tail(self, part: TailPart) -> None:
        """Impacts up to their limit: one by one while they are seen, then the limit alone."""
        tail = part.tail
        if self.plan.memory == "restart":
            self._restart(part.t1, tail.x_inf)
            return
        for n in range(tail.count):
            arc = part.arc(n)
            if arc.length <= BRIEF * np.spacing(part.t1) or self._low(arc, tail.x_inf):
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
        states = np.concatenate([s(s.start + s.length * nodes(4)) for s in arc.segments])
        return bool(
            np.all(np.abs(states - x)[:, self._all_seen] <= self._allowed(x)[self._all_seen])
        )

    def stays(self, before: np.ndarray, limit: np.ndarray) -> bool:
        """Whether restarts between here and a limit show the same past."""
        if self.plan.memory == "keep":
            return True
        seen = self._all_seen
        return bool(np.all(np.abs(before - limit)[seen] <= self._allowed(limit)[seen]))

    @property
    def _all_seen(self) -> list[int]:
        return sorted({element for seen in self.seen for element in seen})

    def _allowed(self, x: np.ndarray) -> np.ndarray:
        size = np.abs(x)
        return SHARE * (self.plan.atol + self.plan.rtol * size) + 4e-16 * size

    # -- windows --------------------------------------------------------------------------

    @property
    def guessing(self) -> bool:
        """Whether a window shows what is not yet flown."""
        return any(window.b > window.guessed for window in self.windows)

    def look(self, t: float, x: np.ndarray) -> Scene:
        """The scene as it looks back from a time; ``until`` says for how long."""
        places = [self._place(k, t, x) for k in range(len(self._lags))]
        self._forget(t)
        stride = self._wanted(t, places)
        end = min(self.plan.t1, t + stride) if stride else self.plan.t1
        self._from, self._steps, self._guesses = (t, x), 0, 0
        self.windows = []
        for k, s in enumerate(places):
            window = self._window(k, t, s, np.inf if stride else t, end - t)
            if not self.moving[k]:
                end = min(end, self._reaches(k, window, t, x))
            self.windows.append(window)
        self.until = end
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
            )
        return t - lag

    def _reaches(self, k: int, window: Window, t: float, x: np.ndarray) -> float:
        """When a constant lag comes to the end of its window."""
        return min(self.plan.t1, window.b + self._lags[k](t, x.tolist()))

    def _forget(self, t: float) -> None:
        if any(self.moving) or not self.windows:
            return
        oldest = min(window.a for window in self.windows)
        self.pieces.forget(oldest)
        self.breaks.forget(oldest)

    def _wanted(self, t: float, places: list[float]) -> float:
        """Length of windows to guess; 0 where the record reaches far enough."""
        shortest = t - max(places)
        nothing = shortest <= _slack(t, t)
        if self.breaks.after(max(places)) <= t and not nothing:
            self._tight, self._stride = 0, 0.0
            return 0.0
        if nothing or self._tight >= TIGHT:
            least = 1e-4 * (self.plan.t1 - self.plan.t0) if nothing else 0.0
            self._stride = max(self._stride, 2.0 * shortest, least)
        if self._stride and self._stride <= shortest:
            self._stride, self._tight = 0.0, 0
        return self._stride

    def _window(self, k: int, t: float, s: float, known: float, length: float) -> Window:
        """A window of a lag that looks at ``s``."""
        a, b = s, min(self.breaks.after(s), known, s + length)
        if self.moving[k]:
            a, b = self._around(k, s, min(self.breaks.after(s), known, s + 2.0 * length))
        while True:
            b = min(b, s + self._spans[k]) if b > s else b
            pieces = self.pieces.within(a, min(b, t))
            window = Window(a, b, self._sampled(a, b, t, pieces), t)
            exact = len(pieces) == 1 and pieces[0].degree <= DEGREE and b <= t
            if exact or self._resolved(k, window) or b - a <= 1e3 * _slack(a, b):
                self._spans[k] = 2.0 * (b - s) if b > s else np.inf
                return window
            b = self._shorter(s, b, pieces)
            a = max(a, s - 0.25 * (b - s)) if a < s else a

    def _around(self, k: int, s: float, b: float) -> tuple[float, float]:
        """Both ends of a window of a lag that depends on time or state."""
        if k in self._backwards:
            b = min(s + _slack(s, s), b)
            return max(self.breaks.before(s), s - min(self._spans[k], self._share)), b
        b = min(b, s + min(self._spans[k], self._share))
        return min(s, max(self.breaks.until(s), s - 0.25 * (b - s))), b

    @property
    def _share(self) -> float:
        return 0.1 * (self.plan.t1 - self.plan.t0)

    @staticmethod
    def _shorter(s: float, b: float, pieces: list[Piece]) -> float:
        """A nearer end: that of a piece, else the middle."""
        ends = [p.end for p in pieces if s + _slack(s, b) < p.end < b - _slack(s, b)]
        return ends[len(ends) // 2] if ends else 0.5 * (s + b)

    def _sampled(self, a: float, b: float, t: float, pieces: list[Piece]) -> np.ndarray:
        """The record at a window's nodes; beyond the present, its last piece goes on."""
        times = a + (b - a) * nodes(DEGREE)
        pieces = pieces or [self.pieces.last]
        values = np.empty((len(times), self.scene.spec.dimension))
        starts = np.array([piece.start for piece in pieces[1:]])
        which = np.searchsorted(starts, times, side="right")
        for index in np.unique(which).tolist():
            chosen = which == index
            values[chosen] = pieces[index].state(times[chosen])
        if not np.all(np.isfinite(values)):
            bad = times[~np.isfinite(values).all(axis=1)][0]
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}: the record at {bad!r} is not finite; give a "
                "history that reaches back that far"
            )
        return values

    def _resolved(self, k: int, window: Window) -> bool:
        """Whether the polynomial is the record, as far as the run can tell."""
        seen = list(self.seen[k])
        series = np.abs(from_values(DEGREE) @ window.values)[:, seen]
        allowed = self._allowed(np.abs(window.values).max(axis=0))[seen]
        return bool(np.all(series[-3:].sum(axis=0) <= allowed))

    # -- at the end of a window -------------------------------------------------------------

    def confirm(self, now: Instant, length: float, segments: Sequence[Segment]) -> Scene | None:
        """After a flight: None if its windows showed what was flown, else the scene to fly anew."""
        self._steps += len(segments)
        if not self.guessing or not segments:
            return None
        end = now.t + (now.low + length)
        flown = [piece_of(segment, now.t, now.low) for segment in segments]
        right = [self._corrected(k, window, flown, end) for k, window in enumerate(self.windows)]
        if all(right):
            if self._guesses <= 4:
                self._stride *= 1.5
            return None
        self._guesses += 1
        if self._guesses <= GUESSES:
            return self._scene()
        self._stride *= 0.25
        return self.look(*self._from)

    def _corrected(self, k: int, window: Window, flown: list[Piece], end: float) -> bool:
        """Put what was flown into a guessed window; whether it was there already."""
        times = window.times
        new = times > window.guessed
        if not new.any():
            return True
        starts = np.array([piece.start for piece in flown[1:]])
        which = np.searchsorted(starts, times, side="right")
        values = window.values.copy()
        for index in np.unique(which[new]).tolist():
            chosen = new & (which == index)
            values[chosen] = flown[index].state(times[chosen])
        seen = list(self.seen[k])
        matters = new & (times <= end + _slack(end, end))
        change = np.abs(values - window.values)[matters][:, seen]
        window.values = values
        allowed = self._allowed(np.abs(values).max(axis=0))[seen]
        return bool(np.all(change <= allowed))

    def passed(self, t: float, field: Field, fired: str | None = None) -> None:
        """The windows' end is reached: note the breaking point that follows from theirs.

        ``fired`` is the edge of the guard by which a lag that moves came to the end of its own.
        """
        self._backwards = set()
        met = {}
        for k, window in enumerate(self.windows):
            end = self._met(k, window, t, fired)
            orders = None if end is None else self.breaks.at(end)
            if orders is not None:
                met[k] = orders
        if met:
            orders = self._carried(field, met)
            if orders[self._all_seen].min() <= self.highest:
                self.breaks.add(t, orders)
        self._tight = self._tight + 1 if self._steps <= 2 and not met else 0
        self.until = t

    def _met(self, k: int, window: Window, t: float, fired: str | None) -> float | None:
        """The end of its window that a lag has come to; None if it is on its way."""
        if not self.moving[k]:
            return (
                window.b
                if window.b + self._lags[k](t, self._from[1].tolist()) <= t + _slack(t, t)
                else None
            )
        if fired == window_edge(k, "b"):
            return window.b
        if fired == window_edge(k, "a"):
            self._backwards = {k}
            return window.a
        return None

    def _carried(self, field: Field, seen: dict[int, np.ndarray]) -> np.ndarray:
        """Orders of the elements where some lags see breaking points."""
        reach = field.code.once(("reach", field.name), lambda: _reach(field))
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


def _reach(field: Field) -> list[tuple[set[int], set[tuple[int, int]]]]:
    """For each element's derivative: elements, and lags with elements, that it depends on."""
    code = field.code
    states = [uses - {-1} for uses in code.dependencies(field.closed)]
    return list(zip(states, code.asked(field.closed), strict=True))
