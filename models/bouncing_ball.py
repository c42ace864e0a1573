"""A ball dropped on a floor: the impacts accumulate at a time known in closed form."""

import math

import hybrid as hy


class BouncingBall(hy.Automaton):
    """A ball over a floor at ``x = 0``, with Newton's law of impact."""

    x = hy.state(unit="m", doc="height")
    v = hy.state(unit="m/s", doc="velocity")

    g: float = hy.parameter(9.81, unit="m/s^2", positive=True)
    r: float = hy.parameter(0.7, between=(0, 1), doc="coefficient of restitution")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -self.g

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


START = {"x": 1.0, "v": 0.0}
UNTIL = (0.0, 3.0)


def oracle(run):
    """``t_inf = sqrt(2 h / g) (1 + r) / (1 - r)``; afterwards the ball lies on the floor."""
    g, r, h = (float(v) for v in (run.parameters["g"], run.parameters["r"], START["x"]))
    drop = math.sqrt(2 * h / g)
    yield "t_inf", run.zeno[0].t, drop * (1 + r) / (1 - r), 1e-12
    yield "first impact", run.jumps.t[0], drop, 1e-12
    yield "fifth impact", run.jumps.t[4], drop * (1 + 2 * sum(r**n for n in range(1, 5))), 1e-12
    yield "x at the end", run.final.x, 0.0, 0.0
