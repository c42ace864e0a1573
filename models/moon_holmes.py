"""The modified Moon-Holmes beam of Akhmet & Çağ, section 4: a beam with an obstacle."""

import jax.numpy as jnp

import hybrid as hy


class MoonHolmes(hy.Automaton):
    """Duffing's beam between two magnets, with an obstacle before the right one."""

    x = hy.state(doc="deflection")
    v = hy.state(doc="velocity")

    r: float = hy.parameter(0.9, between=(0, 1), doc="coefficient of restitution")
    obstacle: float = hy.parameter(1.1, doc="position of the obstacle")
    delta: float = hy.parameter(0.05, doc="damping")
    gamma: float = hy.parameter(0.05, doc="forcing amplitude")
    w: float = hy.parameter(0.1, doc="forcing frequency")

    @hy.mode(initial=True)
    def flight(self, t, s):
        force = -self.delta * s.v + s.x - s.x**3 + self.gamma * jnp.cos(self.w * t)
        return s.v, force

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.obstacle, restitution="r")


START = {"x": 1.3, "v": 0.0}
UNTIL = (0.0, 30.0)


def oracle(run):
    """Values computed with 40 digits, with and without forcing and damping."""
    forced = float(run.parameters["gamma"]) != 0.0
    t_inf = 21.51645294543465448714 if forced else 24.77135713301786487470
    first = 0.757155974288349449772 if forced else 0.725952116677725552318
    yield "t_inf", run.zeno[0].t, t_inf, 1e-11
    yield "first impact", run.jumps.t[0], first, 1e-10
    yield "x at the end", run.final.x, 1.1, 0.0
