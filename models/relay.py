"""A relay under a periodic force: Filippov sliding where the force is the weaker of the two."""

import math

import jax.numpy as jnp

import hybrid as hy


class Relay(hy.Automaton):
    """``x' = a sin(w t) - sign(x)``: sliding on ``x = 0`` while ``|a sin(w t)| < 1``."""

    x = hy.state()

    a: float = hy.parameter(1.3, doc="amplitude of the force")
    w: float = hy.parameter(2.0, unit="rad/s", positive=True)

    @hy.mode(initial=True)
    def up(self, t, s):
        return self.a * jnp.sin(self.w * t) - 1.0

    @hy.mode
    def down(self, t, s):
        return self.a * jnp.sin(self.w * t) + 1.0

    relay = hy.switching(up, down, surface=lambda self, t, s: s.x)


START = {"x": 0.5}
UNTIL = (0.0, 12.0)


def oracle(run):
    """Roots with 40 digits; sliding ends where ``a sin(w t)`` is -1 or 1, every half period."""
    a, w, t = float(run.parameters["a"]), float(run.parameters["w"]), run.jumps.t
    half, end = math.pi / w, (math.pi + math.asin(1 / a)) / w
    yield "first hit", t[0], 1.7559435423403977145, 1e-10
    yield "left downwards", t[1], end, 1e-10
    yield "second hit", t[2], 3.0678984063534199853, 1e-10
    yield "left upwards", t[3], end + half, 1e-10
    yield "last hit", t[12], 10.921880040327903081, 1e-10
    yield "left for the last time", t[13], end + 6 * half, 1e-10
    yield "x while sliding", run(1.9).x, 0.0, 0.0
