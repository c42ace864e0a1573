"""Example 1 of Akhmet & Çağ, *Analysis of Impact Chattering*."""

import jax.numpy as jnp

import hybrid as hy


class HardSpring(hy.Automaton):
    """A body pressed on a wall by ``-cos(x') - x^3``; every start above it chatters."""

    x = hy.state(doc="position")
    v = hy.state(doc="velocity")

    r: float = hy.parameter(0.8, between=(0, 1), doc="coefficient of restitution")
    wall: float = hy.parameter(2.0, doc="position of the wall")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -jnp.cos(s.v) - s.x**3

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.wall, restitution="r")


START = {"x": 2.1, "v": 0.0}
UNTIL = (0.0, 2.0)


def oracle(run):
    """Values computed with 40 digits by two methods."""
    yield "t_inf", run.zeno[0].t, 1.32961738383844857732, 1e-11
    yield "first impact", run.jumps.t[0], 0.14225533927073722722, 1e-11
    yield "first speed", run.jumps.before.v[0], -1.3558025632577745691, 1e-10
    yield "tenth impact", run.jumps.t[9], 1.16790719450350866854, 1e-10
    yield "x at the end", run.final.x, 2.0, 0.0
