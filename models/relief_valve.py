"""A pressure relief valve (Hős & Champneys 2012): it swings, strikes its seat, or rests on it."""

import jax.numpy as jnp

import hybrid as hy


class ReliefValve(hy.Automaton):
    """A valve on a vessel that is filled evenly; all numbers are without a unit."""

    y1 = hy.state(doc="lift")
    y2 = hy.state(doc="speed")
    y3 = hy.state(doc="pressure")

    q: float = hy.parameter(0.2, positive=True, doc="flow")
    r: float = hy.parameter(0.8, between=(0, 1), doc="coefficient of restitution")
    damping: float = hy.parameter(1.25, positive=True)
    spring: float = hy.parameter(10.0, positive=True, doc="force of the spring on the seat")
    filling: float = hy.parameter(20.0, positive=True)

    @hy.mode
    def open(self, t, s):
        force = s.y3 - (s.y1 + self.spring) - self.damping * s.y2
        return s.y2, force, self.filling * (self.q - s.y1 * jnp.sqrt(s.y3))

    seat = hy.contact(open, gap=lambda self, t, s: s.y1, restitution="r", rests=True)


START = {"y1": 2.0, "y2": 0.0, "y3": 12.0}
UNTIL = (0.0, 5.0)


def oracle(run):
    """On the seat pressure grows evenly, by ``filling q``, until it outweighs the spring."""
    first = run.zeno[0]
    yield "release", first.t_release, first.t + (10.0 - first.state.y3) / (20.0 * 0.2), 1e-10
    yield "pressure there", run(first.t_release).y3, 10.0, 1e-10
    yield "lift at t_inf", first.state.y1, 0.0, 1e-12
    yield "force at t_inf", run.force("seat", first.t), 10.0 - first.state.y3, 1e-10
