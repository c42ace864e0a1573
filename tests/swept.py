"""The map that tests fly in processes of their own too: little is imported there."""

import numpy as np

import hybrid as hy

G = 9.81


class Ball(hy.Automaton):
    """A ball dropped from height ``x`` on a floor."""

    x = hy.state(unit="m", doc="height")
    v = hy.state(unit="m/s")
    r: float = hy.parameter(0.7, unit="1", between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -G

    @hy.output(unit="J/kg")
    def energy(self, t, s):
        return G * s.x + s.v**2 / 2

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


R, X = np.linspace(0.3, 0.8, 4), np.linspace(0.5, 2.0, 5)
ASKED = {"over": {"r": R, "x": X}, "start": {"v": 0.0}, "t": (0.0, 20.0), "block": 3}
