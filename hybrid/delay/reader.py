"""Windows read off the record, by Python: those that the rules do not read.

They are on a history that is a function, of a lag that moves, of what is guessed, or where the
record is rough; see ``docs/notes/delays.md``.
"""

from __future__ import annotations

from collections import deque
from math import isinf

import attrs
import numpy as np

from ..errors import FlowError, OptionError
from ..lowering import Scene
from ..rules.past import SHOWN_ROUNDING, WINDOW_SHARE
from ..rules.places import WINDOW_DEGREE
from ..rules.sums import SMALLEST_DIVISOR
from ..segment import nodes
from ..trajectory.plan import Plan
from .pieces import Breaks, Piece, Pieces, Window, slack_of, states

#: Longest window of a lag that depends on time or state, against the run, and what part of it may
#: lie behind, against the part ahead.
LONGEST_WINDOW, SIDE = 0.1, 0.25

#: How far the last piece of a record is taken to go on, against its length.
GOES_ON_FOR = 2.0

#: Places at which a record may be rough within a time this short against the run.
ROUGH, ROUGH_NEAR = 20, 1e-3


class Reader:
    """Reads windows off a record of ``pieces`` and ``breaks``.

    Attributes
    ----------
    frames : array, shape (lags, 3)
        For each lag where its window begins and ends, and how long the next may be.
    backwards : set of int
        Lags that look ever further back.
    """

    def __init__(
        self, scene: Scene, plan: Plan, pieces: Pieces, breaks: Breaks, frames: np.ndarray
    ) -> None:
        self.scene, self.plan = scene, plan
        self.moving, self.seen = scene.code.moving, scene.code.seen
        self.pieces, self.breaks, self.frames = pieces, breaks, frames
        self.backwards: set[int] = set()
        self._rough: deque[float] = deque(maxlen=ROUGH)

    def allowed(self, x: np.ndarray) -> np.ndarray:
        """What a window may differ from a state of the record."""
        size = np.abs(x)
        return WINDOW_SHARE * (self.plan.atol + self.plan.rtol * size) + SHOWN_ROUNDING * size

    def window(
        self, k: int, t: float, s: float, known: float, length: float, x: np.ndarray
    ) -> Window:
        """A window of a lag that looks at ``s`` from the present ``(t, x)``.

        What is ``known`` ends at that time, or never where what comes is guessed; a window of a
        constant lag serves for no more than ``length``.

        Raises
        ------
        FlowError
            Where the record is not finite, or rough everywhere.
        OptionError
            Where the caller's history cannot be asked.
        """
        slack = slack_of(t, s)
        a, b, pad = *self._ends(k, s, known, length, slack), 0.5 * slack if self.moving[k] else 0.0
        whole = b - a
        while True:
            pieces = self.pieces.within(a, min(b, t), slack)
            try:
                window = self._sampled(a - pad, b + pad, t, x, pieces)
            except (FlowError, OptionError):
                if not self.moving[k] or b - a <= 1e3 * slack:
                    raise
                a, b = self._nearer(a, s, b, slack)  # it need not look there
                continue
            exact = (
                len(pieces) == 1 and pieces[0].degree <= WINDOW_DEGREE and not window.guess.any()
            )
            fine = exact or self._resolved(k, window)
            if fine or b - a <= 1e3 * slack:
                self._note_rough(fine, s)
                if b - a < whole or whole >= self.frames[k, 2]:
                    self.frames[k, 2] = 2.0 * (b - a)
                return window
            if k in self.backwards:
                a = 0.5 * (a + b)
            else:
                b = self._shorter(s, b, t, pieces, slack)
                a = max(a, s - SIDE * (b - s))

    @staticmethod
    def _nearer(a: float, s: float, b: float, slack: float) -> tuple[float, float]:
        """Nearer ends on both sides of a place, that behind it first."""
        if s - a > 1e3 * slack:
            return s - 0.25 * (s - a), b
        return (s, b) if a < s else (a, s + 0.5 * (b - s))

    def _note_rough(self, fine: bool, s: float) -> None:
        """Refuse a record that is rough everywhere, not at some places only."""
        if fine:
            return
        self._rough.append(s)
        near = abs(self._rough[-1] - self._rough[0]) < ROUGH_NEAR * (self.plan.t1 - self.plan.t0)
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
        span, end = self.frames[k, 2], min(self.breaks.after(s, slack), known)
        if not self.moving[k]:
            return s, max(min(end, s + length, s + span), s + slack)
        span = min(span, LONGEST_WINDOW * (self.plan.t1 - self.plan.t0))
        if isinf(known):  # a guess need not go further than it is flown over
            span = min(span, 2.0 * length + 1e4 * slack)
        if k in self.backwards:
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

    def _sampled(self, a: float, b: float, t: float, x: np.ndarray, pieces: list[Piece]) -> Window:
        """A window: the record at its nodes; beyond the present, a guess."""
        since, slack = (b - a) * nodes(WINDOW_DEGREE), slack_of(t)
        here = t - a
        guess = since > (here + slack if here > slack else -1.0)
        with np.errstate(all="ignore"):
            values = np.empty((len(since), self.scene.spec.dimension))
            if not guess.all():
                values[~guess] = states(pieces, a, since[~guess])
            if guess.any():
                values[guess] = self._ahead(a, since[guess], x)
        if not np.isfinite(values).all():
            bad = a + float(since[~np.isfinite(values).all(axis=1)][0])
            raise FlowError(
                f"{self.scene.spec.model}, t = {t!r}: the record at {bad!r} is not finite; give a "
                "history that reaches back that far"
            ).by("forgotten")
        noise = 0.5 * slack_of(t, a) / (b - a) * (values.max(axis=0) - values.min(axis=0))
        return Window(a, b, values, guess, noise)

    def _ahead(self, s: float, since: np.ndarray, x: np.ndarray) -> np.ndarray:
        """A first guess at what comes: the last piece goes on, or the state stays as it is.

        Far beyond its end a polynomial leads nowhere: from there on it is a straight line.
        """
        last = self.pieces.last
        orders = self.breaks.at(last.end, slack_of(last.end))
        jumps = orders is not None and orders.min() == 0
        if jumps or last.rows is None:
            return np.broadcast_to(x, (len(since), len(x)))
        if s + float(since[-1]) <= last.end + GOES_ON_FOR * (last.end - last.start):
            return last.state(s, since)
        return x + np.multiply.outer((s - last.end) + since, last.slope)

    def _resolved(self, k: int, window: Window) -> bool:
        """Whether the polynomial is the record, as far as the run can tell."""
        seen = list(self.seen[k])
        rest = np.abs(window.series[-3:]).sum(axis=0)
        allowed = self.allowed(np.abs(window.values).max(axis=0)) + window.noise
        return bool(np.all(rest[seen] <= allowed[seen]))

    def corrected(self, k: int, window: Window, flown: list[Piece]) -> tuple[float, Window]:
        """A window with what was flown in place of guesses; how wrong they were, against what may
        be."""
        low, high = max(window.a, flown[0].start), min(window.b, flown[-1].end)
        if not window.guess.any() or not low < high:
            return 0.0, window
        since, seen = (low - window.a) + (high - low) * nodes(WINDOW_DEGREE), list(self.seen[k])
        there, values = states(flown, window.a, since), window.values.copy()
        change = np.abs(window.shown(since) - there)
        values[window.guess] = states(flown, window.a, window.since[window.guess])
        allowed = self.allowed(np.abs(there).max(axis=0)) + window.noise + SMALLEST_DIVISOR
        wrong = float(np.max((change / allowed)[:, seen], initial=0.0))
        return wrong, attrs.evolve(window, values=values)
