"""A force that is constant along each flight: a counterexample to a step of Akhmet & Çağ."""

import math

import hybrid as hy


class SteadyPush(hy.Automaton):
    """A body pressed on a wall by ``(1 + v^2) / (1 - 2 (x - wall))``.

    Along a flight that leaves the wall with speed ``v`` the force stays ``1 + v^2``. All conditions
    of the paper's Theorem 1 hold on ``0 <= x - wall <= 0.08``, ``|v| <= 1``; but each interval
    between impacts is ``r (1 + v^2) / (1 + r^2 v^2)`` of the one before, more than ``r M_i / m_i``.
    """

    x = hy.state(doc="position")
    v = hy.state(doc="velocity")

    r: float = hy.parameter(0.8, between=(0, 1), doc="coefficient of restitution")
    wall: float = hy.parameter(1.0, doc="position of the wall")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -(1.0 + s.v**2) / (1.0 - 2.0 * (s.x - self.wall))

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.wall, restitution="r")


START = {"x": 1.07, "v": 0.0}
UNTIL = (0.0, 4.0)


def oracle(run):
    """Flights of ``2 v / (1 + v^2)``, with ``v = r^n w`` after the ``n``-th impact."""
    r, height = float(run.parameters["r"]), START["x"] - float(run.parameters["wall"])
    w = math.sqrt(2 * height / (1 - 2 * height))
    drop = w * (1 - 2 * height)
    speeds = [w * r**n for n in range(1, 400)]
    flights = [2 * v / (1 + v**2) for v in speeds]
    yield "t_inf", run.zeno[0].t, drop + math.fsum(flights), 1e-12
    yield "first impact", run.jumps.t[0], drop, 1e-12
    yield "speed before it", run.jumps.before.v[0], -w, 1e-12
    yield "fifth impact", run.jumps.t[4], drop + math.fsum(flights[:4]), 1e-12
    yield "x at the end", run.final.x, float(run.parameters["wall"]), 0.0
