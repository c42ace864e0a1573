"""A bead in a parabolic bowl: chattering and sliding in the plane, with known digits."""

import hybrid as hy


class Bowl(hy.Automaton):
    """A point mass above ``y = a x^2``, frictionless, under gravity."""

    x = hy.state(unit="m")
    y = hy.state(unit="m")
    vx = hy.state(unit="m/s")
    vy = hy.state(unit="m/s")

    g: float = hy.parameter(9.81, unit="m/s^2", positive=True)
    r: float = hy.parameter(0.7, between=(0, 1), doc="coefficient of restitution")
    a: float = hy.parameter(0.25, unit="1/m", positive=True)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.vx, s.vy, 0.0, -self.g

    impact = hy.contact(flight, gap=lambda self, t, s: s.y - self.a * s.x**2, restitution="r")


START = {"x": 1.0, "y": 2.0, "vx": 0.3, "vy": 0.0}
UNTIL = (0.0, 6.0)


def oracle(run):
    """Values computed with 40 digits; the first turning point of the sliding bead."""
    end = run.zeno[0]
    yield "t_inf", end.t, 2.5975570128394006869750, 1e-11
    yield "x_inf", end.state.x, 0.47128437247139950541, 1e-10
    yield "vx_inf", end.state.vx, 3.3361609257071010804, 1e-10
    turn = run(3.2767704394594523156786)
    yield "x at the turn", turn.x, 1.6177803263390996030, 1e-9
    yield "vx at the turn", turn.vx, 0.0, 1e-8
