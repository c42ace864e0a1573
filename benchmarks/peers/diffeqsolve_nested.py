"""Diffrax: a solve with an event for each flight, a block of flights in one compiled program."""

from __future__ import annotations

from functools import cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from peers.oscillator import ABOVE, ENDLESS, LONGEST

BLOCK = 500

#: A block of flights that takes no longer has lost its steps: they end at once.
STUCK = 1e-9


def options_of(gap, tolerance, longest=None):
    """Of a solve that ends where a gap is zero; a step that is missing is no error."""
    return {
        "event": diffrax.Event(gap, optimistix.Newton(rtol=1e-12, atol=1e-14), direction=False),
        "stepsize_controller": diffrax.PIDController(tolerance, tolerance, dtmax=longest),
        "adjoint": diffrax.ForwardMode(),
        "throw": False,
        "max_steps": 5_000,
    }


@cache
def blocks(task, method):
    """A compiled block of flights, of where they begin and a tolerance."""
    length, solver = min(BLOCK, task.impacts), getattr(diffrax, method)()
    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([*task.flow(jnp, t, y)]))
    after = several(task) if hasattr(task, "struck") else alone(task)

    def gap(t, y, *_, **__):
        return jnp.stack(task.gaps(jnp, t, y)).min()

    @jax.jit
    def block(carry, tolerance):
        options = options_of(gap, tolerance, LONGEST)

        def impact(carry, _):
            t, y, first = carry
            arc = diffrax.diffeqsolve(term, solver, t, t + ENDLESS, first, y, **options)
            row, t, y, speed = after(arc.ts[-1], arc.ys[-1])
            return (t, y, jnp.minimum(LONGEST, jnp.maximum(speed, 1e-7) / task.pull)), row

        return jax.lax.scan(impact, carry, None, length=length)

    return block, length


def prepare(task, tolerance, method="Tsit5"):
    """A call that makes the impacts."""
    block, length = blocks(task, method)

    def fly():
        carry = jnp.array(task.begin), jnp.array(task.start), jnp.array(1e-3)
        rows = []
        for _ in range(-(-task.impacts // length)):
            carry, found = block(carry, jnp.array(tolerance))
            rows.append(np.asarray(found))
            times = rows[-1][:, 0]
            if times[-1] - times[-2] >= ENDLESS or times[-1] - times[0] <= STUCK:
                break
            if times[-1] > task.until:
                break
        made = np.concatenate(rows)[: task.impacts]
        through = np.flatnonzero(np.diff(made[:, 0]) >= ENDLESS)
        made = made[: through[0] + 1] if len(through) else made
        return made[made[:, 0] <= task.until]

    return fly


def alone(task):
    """What follows an impact of a point: its row, time and state, the gap's speed."""

    def after(t, y):
        moves, wall = task.wall_speed(jnp, t), task.wall(jnp, t) + 0.0 * t
        speed = task.r * (moves - y[1])
        slow, y = speed < task.slow, jnp.stack([wall, moves + speed])
        row, end, held = jnp.stack([t, *y]), t, jnp.array(task.start)
        if task.rest:
            stick, end = task.rest(jnp, t, speed)
            at_rest = jnp.stack([stick, task.wall(jnp, stick), task.wall_speed(jnp, stick)])
            held = jnp.stack([task.wall(jnp, end) + ABOVE, task.wall_speed(jnp, end)])
            row = jnp.where(slow, at_rest, row)
            return row, jnp.where(slow, end, t), jnp.where(slow, held, y), speed
        y = jnp.where(slow, held, y)
        return jnp.stack([t, *y]), t, y, jnp.where(slow, task.slow, speed)

    return after


def several(task):
    """The same where there are several walls."""
    position, velocity = np.transpose(task.struck)

    def after(t, y):
        which = jnp.argmin(jnp.stack(task.gaps(jnp, t, y)))
        at = jnp.array(position)[which], jnp.array(velocity)[which]
        speed = -task.r * y[at[1]]
        y = y.at[at[0]].set(task.level).at[at[1]].set(speed)
        return jnp.concatenate([t[None], y]), t, y, speed

    return after
