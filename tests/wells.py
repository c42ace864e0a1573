"""Scenes with several attractors, whose basins are known (``test_basins.py``)."""

import jax.numpy as jnp

import hybrid as hy


class Wells(hy.Automaton):
    """A damped particle in two wells, with a wall on each side, struck with restitution."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    r: float = hy.parameter(0.7, between=(0, 1))
    damping: float = hy.parameter(0.3, unit="1/s")
    wall: float = hy.parameter(1.3, unit="m")

    @hy.mode
    def free(self, t, s):
        return s.v, s.x - s.x**3 - self.damping * s.v

    left = hy.contact(free, gap=lambda self, t, s: s.x + self.wall, restitution="r")
    right = hy.contact(free, gap=lambda self, t, s: self.wall - s.x, restitution="r")


class Floor(hy.Automaton):
    """A bead on a table that moves as ``G sin t``: it rests on it, or bounces for ever."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    G: float = hy.parameter(0.6, unit="m")
    e: float = hy.parameter(0.7, between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.G * jnp.sin(t), restitution="e")
