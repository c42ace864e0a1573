"""A force that is not known, learnt from impacts: a network of Equinox in a flow.

A ball falls on a floor in an unknown force. What is measured: when it hits the floor and how fast,
five times, dropped from each of four heights. The force is a network of two layers, whose weights,
205 of them, are one parameter of the model. ``python docs/examples/neural_force.py`` fits them by
L-BFGS, with gradients that are those of the runs, and prints the loss, the time, and how far the
force is off where the ball has been.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

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


def off(cls, weights):
    """How far the force is off, root mean square, at heights and speeds that were seen."""
    x, v = (a.ravel() for a in np.meshgrid(np.linspace(0.1, 0.6, 9), np.linspace(-0.8, 0.8, 9)))
    found = jax.vmap(cls(weights=weights).force)(x, v)
    return float(np.sqrt(np.mean((found - 0.3 * np.sin(3.0 * x) + 0.2 * v) ** 2)))


def main(width=12, iterations=200):
    """Fit, and say how it went; returns loss and error of the force, before and after."""
    cls, weights = learner(width)
    both = jax.jit(jax.value_and_grad(loss_of(cls)))
    begin = time.perf_counter()
    before = float(both(weights)[0]), off(cls, weights)
    first = time.perf_counter() - begin
    print("{} weights, loss {:.1e}, force off by {:.3f}".format(len(weights), *before))

    def told(weights):
        value, slopes = both(weights)
        if not np.isfinite(value):  # the ball does not come back: there are no impacts to compare
            return 1e3, np.zeros(len(weights))
        return float(value), np.asarray(slopes, float)

    begin = time.perf_counter()
    fit = minimize(
        told,
        weights,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": iterations, "maxfun": 4 * iterations, "ftol": 0.0, "gtol": 1e-9},
    )
    took = time.perf_counter() - begin
    print(f"first gradient {first:.1f} s, {fit.nfev} more {took:.1f} s")
    after = float(fit.fun), off(cls, fit.x)
    print("loss {:.1e}, force off by {:.3f}".format(*after))
    return before, after


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*map(int, sys.argv[1:]))
