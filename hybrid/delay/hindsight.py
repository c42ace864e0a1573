"""The model of a finished run, with the delayed terms that it had at any of its times.

Between two breaking points a model with delays is an ordinary model: a scene whose delayed terms
are windows on the record (:mod:`hybrid.delay.memory`). Here the windows are the pieces of the
record themselves, so one scene is valid as long as ``t - lag`` stays in the same piece for every
lag.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton.past import blank
from ..lowering import Scene
from ..lowering.taylor import flat
from ..rules.places import WINDOW_DEGREE
from ..segment import nodes
from ..trajectory.arcs import Arc, Part, arcs_of
from ..trajectory.log import Log
from .history import Before, until
from .pieces import Piece, constant, piece_of, window_on

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Matrix, Numbers
    from ..trajectory.trajectory import Solution

#: Half-width, relative to the longest lag, of the window on a piece whose degree is too high for a
#: window.
NARROW = 1e-2


class PastRecord:
    """The record as pieces in order of time."""

    def __init__(self, pieces: Iterable[Piece]) -> None:
        self.pieces = [piece for piece in pieces if piece.end > piece.start]
        self.ends = [piece.end for piece in self.pieces]
        self.starts = [piece.start for piece in self.pieces]

    def index(self, t: float, side: str = "right") -> int:
        """Index of the piece at time ``t``; where two pieces meet, of that on the given side."""
        found = (bisect_left if side == "left" else bisect_right)(self.ends, t)
        return min(found, len(self.pieces) - 1)

    def states(self, times: Numbers, low: float = -np.inf, high: float = np.inf) -> Matrix:
        """States at some times, shape ``(k, n)``, from the pieces between ``low`` and ``high``;
        outside, the outer ones are extrapolated."""
        first, last = self.index(low), self.index(high, "left")
        which = np.clip([self.index(t) for t in times.tolist()], first, max(first, last))
        pairs = zip(which.tolist(), times.tolist(), strict=True)
        return np.array([self.pieces[i].state(t, np.zeros(1))[0] for i, t in pairs])


class Hindsight:
    """The scenes of a run: its model with the delayed terms that it had at any time.

    Attributes
    ----------
    scene : Scene
        The scene with empty windows.
    history : sequence of Piece or None
        The record before the run; None for a model without delays.
    memory : "keep" or "restart"
        What delays see after a jump: the record, or the state after the jump.
    breaks : (array, array)
        Breaking points of the record, as far back as the lags reach from the run's end, and the
        order of each state element there.
    earlier : Solution or None
        The run that this one continues.
    """

    def __init__(
        self,
        scene: Scene,
        history: Sequence[Piece] | None,
        memory: str,
        log: Log,
        breaks: tuple[Numbers, IntegerMatrix] = (np.empty(0), np.empty((0, 0), dtype=int)),
        earlier: Solution | None = None,
    ) -> None:
        self.scene, self.history, self.memory, self._log = scene, history, memory, log
        self.breaks, self.earlier = breaks, earlier
        self._records: dict[int, PastRecord] = {}
        self._scenes: dict[tuple[int, ...], Scene] = {}

    def __reduce__(self) -> Any:
        """Pickle without cached values."""
        more = self.breaks, self.earlier
        return Hindsight, (self.scene, self.history, self.memory, self._log, *more)

    @cached_property
    def _parts(self) -> list[Part]:
        return self._log.apart()[0]

    @cached_property
    def lags(self) -> list[float]:
        """The lags; NaN for one that depends on time or state."""
        zero = np.zeros(self.scene.spec.dimension).tolist()
        pairs = zip(self._lags, self.scene.code.moving, strict=True)
        return [float("nan") if moves else float(lag(0.0, zero)) for lag, moves in pairs]

    @cached_property
    def longest(self) -> float:
        """The longest constant lag; 0 if there is none."""
        return max([lag for lag in self.lags if lag == lag], default=0.0)

    @cached_property
    def _lags(self) -> list[Callable[..., float]]:
        scene, spec = self.scene, self.scene.spec
        own = scene.parameters[: len(spec.parameters)]
        values = flat([*own, *blank(spec.lags, spec.dimension)])
        return [scene.code.lag(k).bind(values) for k in range(len(spec.lags))]

    def places(self, part: int, t: float) -> list[float]:
        """The time ``t - lag`` of each lag, at time ``t`` in part ``part`` of the run."""
        if not any(self.scene.code.moving):
            return [t - lag for lag in self.lags]
        arc = self._parts[part]
        if not isinstance(arc, Arc):
            arc = arc.arc_at(t)
        x = arc.local((t - arc.t0) - arc.low).tolist()
        return [t - float(lag(t, x)) for lag in self._lags]

    def record(self, part: int) -> PastRecord:
        """The record that delays see during part ``part`` of the run."""
        key = part if self.memory == "restart" and part else 0
        if key not in self._records:
            self._records[key] = PastRecord(self._seen(key))
        return self._records[key]

    def _seen(self, part: int) -> list[Piece]:
        if self.memory == "keep":
            flown = [piece for each in self._parts for piece in _pieces(each)]
            return [*(self.history or ()), *flown]
        if part:
            arc = next(arcs_of(self._parts[part]))
            return [constant(arc.first, arc.t0), *_pieces(self._parts[part])]
        flown = [piece for each in self._parts[:1] for piece in _pieces(each)]
        return [*(self.history or ()), *flown]

    def before(self, part: int, t: float) -> Before | None:
        """The history for a run that continues from time ``t`` in part ``part`` of this one; None
        without delays."""
        if self.history is None:
            return None
        return Before(self._needed(until(self.record(part).pieces, t), t))

    def _needed(self, pieces: Sequence[Piece], t: float) -> list[Piece]:
        """The pieces of a record that a run from time ``t`` may see."""
        since = -np.inf if any(self.scene.code.moving) else t - self.longest
        return [piece for piece in pieces if piece.end > since] or list(pieces[-1:])

    def forget(self, t: float) -> None:
        """Forget what a run that continues from time ``t`` does not need: the run before this one,
        and a history further back than the longest lag."""
        self.earlier = None
        if self.history is not None:
            self.history = self._needed(self.history, t)

    def at(self, part: int, t: float, side: str = "right") -> Scene:
        """The scene at time ``t`` in part ``part``; at a breaking point, on the given side."""
        if self.history is None:
            return self.scene.at(float(np.nextafter(t, -np.inf)) if side == "left" else t)
        record = self.record(part)
        places = self.places(part, t)
        which = [record.index(place, side) for place in places]
        plain = all(record.pieces[i].degree <= WINDOW_DEGREE for i in which)
        key = (part if self.memory == "restart" else 0, *which)
        if plain and key in self._scenes:
            return self._scenes[key]
        windows = [self._window(record.pieces[i], s) for i, s in zip(which, places, strict=True)]
        scene = self.scene.through([array for window in windows for array in window])
        if plain:
            self._scenes[key] = scene
        return scene

    def _window(self, piece: Piece, place: float) -> list[np.ndarray]:
        """A window on a piece; if its degree is too high or its length infinite, on a narrow part
        of the piece around ``place``."""
        a, b = piece.start, piece.end
        if piece.degree > WINDOW_DEGREE or not np.isfinite(a):
            width = NARROW * (self.longest or 1.0)
            b = min(b, place + width)
            a = max(a, b - 2.0 * width)
        values = piece.state(a, (b - a) * nodes(WINDOW_DEGREE))
        return window_on(a, b, values)


def _pieces(part: Part) -> Iterator[Piece]:
    return (piece_of(s, arc.t0, arc.low) for arc in arcs_of(part) for s in arc.segments)
