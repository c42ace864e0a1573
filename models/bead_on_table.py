"""Example 2 of Akhmet & Çağ, *Analysis of Impact Chattering*: Holmes' vibrating table."""

import math

import jax.numpy as jnp

import hybrid as hy


class BeadOnTable(hy.Automaton):
    """A bead on a sinusoidally vibrating table (Holmes 1982)."""

    x = hy.state(unit="m", doc="height")
    v = hy.state(unit="m/s", doc="velocity")

    g: float = hy.parameter(9.8, unit="m/s^2", positive=True)
    r: float = hy.parameter(0.9, between=(0, 1), doc="coefficient of restitution")
    amplitude: float = hy.parameter(1.0, unit="m")
    omega: float = hy.parameter(0.29, unit="rad/s")

    def table(self, t):
        return self.amplitude * jnp.sin(self.omega * t)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -self.g

    # One line: a moving gap, Newton's law in the frame of the table, and the resting mode
    # that follows from them (its field and its release are derived, not written).
    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.table(t), restitution="r")


START = {"x": 1.9, "v": 0.0}
UNTIL = (2 * math.pi / 0.29, 45.0)


def oracle(run):
    """Values computed with 40 digits; at rest the bead moves with the table."""
    yield "t_inf", run.zeno[0].t, 33.51986976147157350465, 1e-11
    yield "x_inf", run.zeno[0].state.x, -0.291681460838541997919, 1e-11
    yield "first impact", run.jumps.t[0], 22.2601061655724829628, 1e-10
    yield "twentieth impact", run.jumps.t[19], 32.0046880621876358777, 1e-10
    yield "x at the end", run.final.x, math.sin(0.29 * 45.0), 1e-14
