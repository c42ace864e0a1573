"""A force that is not known, learnt from impacts: a network of Equinox in a flow.

A ball falls on a floor in an unknown force. What is measured: when it hits the floor and how fast,
five times, dropped from each of four heights. The weights of the network are one parameter.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

import hybrid as hy

HEIGHTS = np.array([0.6, 0.9, 1.2, 1.5])
OPTIONS = {"t": (0.0, 20.0), "max_jumps": 5, "max_steps": 512, "outputs": ("jumps",)}


class Truth(hy.Automaton):
    """What nature does: a force that bends with the height, and drag."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fly(self, t, s):
        return s.v, -1.0 + 0.3 * jnp.sin(3.0 * s.x) - 0.2 * s.v

    floor = hy.contact(fly, gap=lambda self, t, s: s.x, restitution=0.9)


def learner(width, key=0):
    """The class whose force is a network, and weights to begin with."""
    network = eqx.nn.MLP(2, "scalar", width, 2, jnp.tanh, key=jax.random.PRNGKey(key))
    arrays, rest = eqx.partition(network, eqx.is_inexact_array)
    begin, shaped = ravel_pytree(jax.tree.map(lambda a: 0.3 * a.astype(float), arrays))

    class Learner(hy.Automaton):
        """The same ball, in the force of the network."""

        x = hy.state()
        v = hy.state()
        weights = hy.parameter(np.zeros(len(begin)))

        def force(self, x, v):
            return eqx.combine(shaped(self.weights), rest)(jnp.stack([x, v]))

        @hy.mode
        def fly(self, t, s):
            return s.v, -1.0 + self.force(s.x, s.v)

        floor = hy.contact(fly, gap=lambda self, t, s: s.x, restitution=0.9)

    return Learner, begin


def impacts(cls):
    """Times and speeds of the impacts of drops, by model."""
    run = hy.as_function(cls(), **OPTIONS)

    def drop(model, x):
        table = run(model, {"x": x, "v": 0.0}).jumps
        return jnp.stack([table.t, table.before["v"]])

    return lambda model: jax.vmap(lambda x: drop(model, x))(HEIGHTS)


def loss_of(cls):
    """The mean square by which a learner's impacts are off, by its weights."""
    seen, found = impacts(Truth)(Truth()), impacts(cls)
    return jax.jit(lambda weights: jnp.mean((found(cls(weights=weights)) - seen) ** 2))
