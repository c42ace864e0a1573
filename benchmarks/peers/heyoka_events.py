"""heyoka's Taylor integrator with a terminal event, whose callback turns the velocity.

Later runs use the machine code of the first.
"""

from __future__ import annotations

from itertools import pairwise

import heyoka
import numpy as np

from peers.oscillator import FUNCTIONS


def integrator(task, tolerance, impacts, real=float):
    """An integrator, the rows that it fills, and how many are filled."""
    x, v = heyoka.make_vars("x", "v")
    found, count = np.empty((impacts, 3), dtype=real), [0]
    functions = FUNCTIONS if real is float else np

    def impact(ta, _):
        moves = task.wall_speed(functions, ta.time)
        speed = real(task.r) * (moves - ta.state[1])
        above = abs(ta.state[0] - task.wall(functions, ta.time))  # by rounding
        ta.state[:] = task.wall(functions, ta.time) + above, moves + speed
        if speed < task.slow:
            ta.state[:] = task.start
        found[count[0]] = ta.time, *ta.state
        count[0] += 1
        return count[0] < impacts

    wall = heyoka.t_event(
        x - task.wall(heyoka, heyoka.time),
        callback=impact,
        direction=heyoka.event_direction.negative,
        fp_type=real,
    )
    given = {} if tolerance is None else {"tol": real(tolerance)}
    flow = [(x, v), (v, heyoka.expression(task.force(heyoka, heyoka.time, x, v)))]
    state, events = np.array(task.start, dtype=real), [wall]
    made = heyoka.taylor_adaptive(flow, state, t_events=events, fp_type=real, **given)
    return made, found, count


def begin(made, count, t, state):
    """Put an integrator somewhere."""
    made.time, made.state[:], count[0] = t, state, 0
    made.reset_cooldowns()


def prepare(task, tolerance, impacts, real=float):
    """A call that makes the impacts; ``tolerance`` None: to rounding."""
    made, found, count = integrator(task, tolerance, impacts, real)

    def fly():
        begin(made, count, real(task.begin), task.start)
        made.propagate_until(real(task.until))
        return found[: count[0]].copy()

    return fly


#: A flight that is flown again ends at another time by what a step may lose, over the gap's speed
#: at its end; one that ends so much earlier has lost an impact.
EARLIER = 1e-2


def lost(task, rows, tolerance):
    """Flights that end earlier when they are flown again, and those that end earlier in a touch, no
    deeper than the tolerance; flights that begin too slowly to tell are left out."""
    made, found, count = integrator(task, None, 1)
    early = [0, 0]
    for (t, x, v), (end, *_) in pairwise(rows):
        off = x - task.wall(FUNCTIONS, t), v - task.wall_speed(FUNCTIONS, t)
        if off[0] <= 1e-9 and off[1] <= max(task.slow, 1e-9):
            continue
        begin(made, count, t, (x, v))
        made.propagate_until(end + 1.0)
        if count[0] == 1 and found[0, 0] < end - EARLIER:
            early[int(depth(task, *found[0]) <= (tolerance or 0.0))] += 1
    return tuple(early)


def depth(task, t, x, v):
    """How far beyond the wall a motion goes that touches it, from the state after the impact."""
    moves, near = task.wall_speed(FUNCTIONS, t), 1e-5
    later, sooner = (task.wall_speed(FUNCTIONS, t + s) for s in (near, -near))
    speed = (v - moves) / task.r
    pull = task.force(FUNCTIONS, t, x, moves - speed) - (later - sooner) / (2 * near)
    return speed**2 / (2.0 * abs(pull))
