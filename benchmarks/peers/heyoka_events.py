"""heyoka's Taylor integrator with terminal events, whose callback turns the velocity.

Later runs use the machine code of the first.
"""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import heyoka
import numpy as np

from peers.oscillator import FUNCTIONS

SYMBOLS = SimpleNamespace(sin=heyoka.sin, cos=heyoka.cos, concatenate=np.concatenate)

#: More states are compiled compactly.
LARGE = 20


class Flights:
    """An integrator, the rows that it fills, and where a rest ends that it has to leave."""

    def __init__(self, task, tolerance, impacts, real=float):
        names = heyoka.make_vars(*(f"y{i}" for i in range(len(task.start))))
        self.task, self.left, self.count = task, None, 0
        self.rows = np.empty((impacts, 1 + len(names)), dtype=real)
        y = np.array(names, dtype=object)
        walls = [
            heyoka.t_event(
                gap,
                callback=self.strike(which),
                direction=heyoka.event_direction.negative,
                fp_type=real,
            )
            for which, gap in enumerate(task.gaps(SYMBOLS, heyoka.time, y))
        ]
        given = {} if tolerance is None else {"tol": real(tolerance)}
        if len(names) > LARGE:  # as its manual says of large systems
            given["compact_mode"] = True
        slopes = [heyoka.expression(e) for e in task.flow(SYMBOLS, heyoka.time, y)]
        flow, state = list(zip(names, slopes, strict=True)), np.array(task.start, dtype=real)
        self.made = heyoka.taylor_adaptive(flow, state, t_events=walls, fp_type=real, **given)

    def strike(self, which):
        def impact(ta, _):
            row, t, y = self.task.rebound(ta.time, ta.state, which)
            self.rows[self.count] = row
            self.count += 1
            if t != ta.time:
                self.left = t, y
                return False
            ta.state[:] = y
            return self.count < len(self.rows)

        return impact

    def begin(self, t, state):
        """Put the integrator somewhere."""
        self.made.time, self.made.state[:] = t, state
        self.made.reset_cooldowns()

    def fly(self, t, state, until):
        """The rows from a state on."""
        self.count, self.left = 0, (t, state)
        while self.left is not None and self.count < len(self.rows):
            (t, state), self.left = self.left, None
            if t < until:
                self.begin(t, state)
                self.made.propagate_until(until)
        found = self.rows[: self.count]
        return found[found[:, 0] <= until].copy()


def prepare(task, tolerance, real=float):
    """A call that makes the impacts; ``tolerance`` None: to rounding."""
    flights = Flights(task, tolerance, task.impacts, real)
    return lambda: flights.fly(real(task.begin), task.start, real(task.until))


#: A flight that is flown again ends at another time by what a step may lose, over the gap's speed
#: at its end; one that ends so much earlier besides has lost an impact.
EARLIER = 1e-2


def lost(task, rows, tolerance):
    """Flights that end earlier when they are flown again, and those that end earlier in a touch, no
    deeper than what a tolerance, relative and absolute, leaves open of the position there; flights
    that begin too slowly to tell are left out."""
    flights, early = Flights(task, None, 1), [0, 0]
    for (t, x, v), (end, *_) in pairwise(rows):
        off = x - task.wall(FUNCTIONS, t), v - task.wall_speed(FUNCTIONS, t)
        if off[0] <= 1e-9 and off[1] <= max(task.slow, 1e-9):
            continue
        again = flights.fly(t, (x, v), end + 1.0)
        if not len(again):
            continue
        open_ = (tolerance or 0.0) * (1.0 + abs(task.floor + again[0, 1]))
        speed = (again[0, 2] - task.wall_speed(FUNCTIONS, again[0, 0])) / task.r
        if again[0, 0] < end - EARLIER - open_ / speed:
            early[int(depth(task, *again[0]) <= open_)] += 1
    return tuple(early)


def depth(task, t, x, v):
    """How far beyond the wall a motion goes that touches it, from the state after the impact."""
    moves, near = task.wall_speed(FUNCTIONS, t), 1e-5
    later, sooner = (task.wall_speed(FUNCTIONS, t + s) for s in (near, -near))
    speed = (v - moves) / task.r
    pull = task.force(FUNCTIONS, t, x, moves - speed) - (later - sooner) / (2 * near)
    return speed**2 / (2.0 * abs(pull))
