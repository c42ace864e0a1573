"""A point over a wall that may move, with Newton's law: what each peer flies, said once.

Force and wall are written for any tool that has sines and cosines of its own numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np

#: Longest step of a solver that looks for events at the ends of its steps only.
LONGEST = 0.1

#: A flight that lasts longer has fallen through the wall.
ENDLESS = 100.0

FUNCTIONS = SimpleNamespace(sin=math.sin, cos=math.cos)


@attrs.frozen
class Oscillator:
    """x'' = force(t, x, v) over a wall, with as many impacts as are asked for.

    ``by_hand``: the name and the numbers of the same flow in ``numba_taylor``. ``pull`` bounds the
    acceleration of the gap. Where ``slow`` is not zero, an impact that parts more slowly is
    followed by a fall from the start's height, as most peers know no rest. Positions are heights
    over a wall at rest, which is at ``floor`` in the models: so low flights do not drown in
    rounding.
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

    def rebound(self, t: float, v: float) -> tuple[float, float, float]:
        """Position and velocity after an impact, and the gap's speed."""
        moves = self.wall_speed(FUNCTIONS, t)
        speed = self.r * (moves - v)
        if speed < self.slow:
            return *self.start, self.slow
        return self.wall(FUNCTIONS, t), moves + speed, speed

    def first(self, speed: float) -> float:
        """A first step that passes no impact: a flight lasts longer than this."""
        return min(LONGEST, speed / self.pull)


def rows_of(flights: Callable[[], Any], impacts: int) -> np.ndarray:
    """Time, and position and velocity after it, of each impact, as far as they are made."""
    rows = np.empty((impacts, 3))
    count = 0
    for rows[count] in flights():
        count += 1
        if count == impacts:
            break
    return rows[:count]
