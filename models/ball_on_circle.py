"""A ball dropped on a circle: it chatters, slides down the side and leaves the circle."""

import jax.numpy as jnp
import numpy as np

import hybrid as hy


class BallOnCircle(hy.Automaton):
    """A point mass outside the unit circle, frictionless, under gravity."""

    q = hy.state(shape=(2,), doc="position")
    p = hy.state(shape=(2,), doc="velocity")

    g: float = hy.parameter(1.0, positive=True)
    e: float = hy.parameter(0.5, between=(0, 1), doc="coefficient of restitution")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.p, jnp.array([0.0, -1.0]) * self.g

    impact = hy.contact(flight, gap=lambda self, t, s: jnp.linalg.norm(s.q) - 1.0, restitution="e")


START = {"q": [0.15, 1.2], "p": [0.0, 0.0]}
UNTIL = (0.0, 4.0)


def oracle(run):
    """Height at which the circle is left, computed with 40 digits, and energy while sliding."""
    end = run.zeno[0]
    leaves = run(end.t_release)
    yield "height of release", leaves.q[1], 0.664320513532, 1e-11
    energy = float(0.5 * np.sum(end.state.p**2) + end.state.q[1])
    yield "energy at release", float(0.5 * np.sum(leaves.p**2) + leaves.q[1]), energy, 1e-10
