"""Bodies over walls with Newton's law: what each peer flies, said once.

A flow, its gaps and a rebound are written for any tool that has sines and cosines of its own
numbers. A row of what is found is the time of an impact and the state after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np

#: Longest step of a solver that looks for events at the ends of its steps only.
LONGEST = 0.1

#: A flight that lasts longer has fallen through the wall.
ENDLESS = 100.0

FUNCTIONS = SimpleNamespace(
    sin=math.sin, cos=math.cos, arcsin=math.asin, ceil=math.ceil, concatenate=np.concatenate
)

#: A rest's end is left this far above the wall, so that rounding is no impact.
ABOVE = 1e-13


@attrs.frozen(eq=False)
class Oscillator:
    """x'' = force(t, x, v) over a wall, with as many impacts as are asked for.

    ``by_hand``: the name and the numbers of the same flow in ``numba_taylor``. ``pull`` bounds the
    acceleration of the gap. Where ``slow`` is not zero, what follows an impact that parts more
    slowly is as ``rest`` says: when the impacts end, and when the rest does; without it a fall from
    the start's height, as most peers know no rest. Positions are heights over a wall at rest, which
    is at ``floor`` in the models: so low flights do not drown in rounding.
    """

    force: Callable[[Any, Any, Any, Any], Any]
    r: float
    start: tuple[float, float]
    impacts: int
    pull: float
    by_hand: tuple[Any, ...]
    wall: Callable[[Any, Any], Any] = lambda f, t: 0.0
    wall_speed: Callable[[Any, Any], Any] = lambda f, t: 0.0
    begin: float = 0.0
    until: float = 1e6
    slow: float = 0.0
    floor: float = 0.0
    rest: Callable[[Any, Any, Any], tuple[Any, Any]] | None = None

    def flow(self, f: Any, t: Any, y: Any) -> tuple[Any, Any]:
        return y[1], self.force(f, t, y[0], y[1])

    def gaps(self, f: Any, t: Any, y: Any) -> tuple[Any]:
        return (y[0] - self.wall(f, t),)

    def rebound(self, t: Any, y: Any, which: int = 0) -> tuple[Any, float, Any]:
        """The row of an impact, the time at which the motion goes on, and its state there."""
        f = FUNCTIONS if isinstance(t, float) else np
        moves = self.wall_speed(f, t)
        speed = self.r * (moves - y[1])
        if speed >= self.slow or not self.slow:
            # by rounding a state may lie under the wall
            after = self.wall(f, t) + abs(y[0] - self.wall(f, t)), moves + speed
            return (t, *after), t, after
        if self.rest is None:
            return (t, *self.start), t, self.start
        stick, end = self.rest(f, t, speed)
        row = stick, self.wall(f, stick), self.wall_speed(f, stick)
        return row, end, (self.wall(f, end) + ABOVE, self.wall_speed(f, end))

    def first(self, t: float, y: Any, which: int = 0) -> float:
        """A first step that passes no impact: a flight lasts longer than this."""
        speed = y[1] - self.wall_speed(FUNCTIONS, t)
        return min(LONGEST, max(speed, self.slow or 1e-7) / self.pull)


@attrs.frozen(eq=False)
class Bodies:
    """Many states and walls at rest: ``struck`` are the position and the speed of each wall's body.

    ``level``: where the walls are. ``by_hand``, ``pull``, ``begin``, ``until`` as above.
    """

    flow: Callable[[Any, Any, Any], Any]
    struck: Sequence[tuple[int, int]]
    level: float
    r: float
    start: Any
    impacts: int
    pull: float
    begin: float = 0.0
    until: float = 1e6
    slow: float = 0.0

    def gaps(self, f: Any, t: Any, y: Any) -> list[Any]:
        return [y[position] - self.level for position, _ in self.struck]

    def rebound(self, t: Any, y: Any, which: int = 0) -> tuple[Any, float, Any]:
        """As above."""
        position, speed = self.struck[which]
        after = np.array(y)
        after[position] = self.level + abs(y[position] - self.level)
        after[speed] = -self.r * y[speed]
        return (t, *after), t, after

    def first(self, t: float, y: Any, which: int = 0) -> float:
        """As above."""
        return min(LONGEST, max(abs(y[self.struck[which][1]]), 1e-7) / self.pull)


def rows_of(flights: Callable[[], Any], task: Any) -> np.ndarray:
    """The rows of all impacts, as far as they are made and end in time."""
    rows = np.empty((task.impacts, 1 + len(task.start)))
    count = 0
    for row in flights():
        if row[0] > task.until:
            break
        rows[count] = row
        count += 1
        if count == task.impacts:
            break
    return rows[:count]
