"""Pyragas control of Example 1 (Akhmet & Çağ, section 6): a force that remembers."""

import jax.numpy as jnp

import hybrid as hy


class Pyragas(hy.Automaton):
    """A hard spring over a wall, with the control ``C (x1(t - tau) - x1(t))``."""

    x1 = hy.state(doc="position")
    x2 = hy.state(doc="velocity")

    C: float = hy.parameter(-30.0, doc="gain of the control")
    tau: float = hy.parameter(1.0, positive=True, doc="lag of the control")
    r: float = hy.parameter(0.6, between=(0, 1), doc="coefficient of restitution")
    wall: float = hy.parameter(2.0, doc="position of the wall")

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        control = self.C * (past(self.tau).x1 - s.x1)
        return s.x2, -(s.x1**3) - jnp.cos(s.x2) + control

    impact = hy.contact(flight, gap=lambda self, t, s: s.x1 - self.wall, restitution="r")


START = {"x1": 3.0, "x2": 0.0}
UNTIL = (0.0, 5.0)


def oracle(run):
    """Values computed with 30 digits; at rest the wall's load is at least 9, so for ever."""
    t = run.jumps.t
    yield "first impact", t[0], 0.26703257965945121873, 1e-11
    yield "second impact", t[1], 0.54479232816045306409, 1e-11
    yield "eighth impact", t[7], 0.90485106648861701117, 1e-11
    yield "t_inf", run.zeno[0].t, 0.92191979269597509266, 1e-11
    yield "x1 at the end", run.final.x1, 2.0, 0.0
