"""Diffrax: a solve with an event for each flight, a block of flights in one compiled program."""

from __future__ import annotations

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from peers.oscillator import ENDLESS, LONGEST

BLOCK = 500

#: A block of flights that takes no longer has lost its steps: they end at once.
STUCK = 1e-9


def prepare(task, tolerance, impacts):
    """A call that makes the impacts."""
    length = min(BLOCK, impacts)
    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([y[1], task.force(jnp, t, y[0], y[1])]))
    options = {
        "event": diffrax.Event(
            lambda t, y, *_, **__: y[0] - task.wall(jnp, t),
            optimistix.Newton(rtol=1e-12, atol=1e-12),
            direction=False,
        ),
        "stepsize_controller": diffrax.PIDController(rtol=tolerance, atol=tolerance, dtmax=LONGEST),
        "adjoint": diffrax.ForwardMode(),
        "throw": False,
        "max_steps": 5_000,
    }

    def impact(carry, _):
        t, y, first = carry
        arc = diffrax.diffeqsolve(term, diffrax.Tsit5(), t, t + ENDLESS, first, y, **options)
        t, moves = arc.ts[-1], task.wall_speed(jnp, arc.ts[-1])
        speed = task.r * (moves - arc.ys[-1, 1])
        after = jnp.stack([task.wall(jnp, t) + 0.0 * t, moves + speed])
        slow = speed < task.slow
        y = jnp.where(slow, jnp.array(task.start), after)
        return (t, y, jnp.minimum(LONGEST, jnp.where(slow, task.slow, speed) / task.pull)), (
            jnp.concatenate([t[None], y])
        )

    @jax.jit
    def block(carry):
        return jax.lax.scan(impact, carry, None, length=length)

    def fly():
        carry = jnp.array(task.begin), jnp.array(task.start), jnp.array(1e-3)
        rows = []
        for _ in range(-(-impacts // length)):
            carry, found = block(carry)
            rows.append(np.asarray(found))
            times = rows[-1][:, 0]
            if times[-1] - times[-2] >= ENDLESS or times[-1] - times[0] <= STUCK:
                break
        made = np.concatenate(rows)[:impacts]
        through = np.flatnonzero(np.diff(made[:, 0]) >= ENDLESS)
        return made[: through[0] + 1] if len(through) else made

    return fly
