"""The coupled system of Akhmet & Çağ, section 5: chattering drives a damped oscillator."""

import hybrid as hy


class Coupled(hy.Automaton):
    """A ball over a floor at ``x1 = 1``; the square of its speed drives an oscillator."""

    x1 = hy.state(doc="height of the ball")
    x2 = hy.state(doc="its velocity")
    x3 = hy.state(doc="oscillator")
    x4 = hy.state(doc="its velocity")

    g: float = hy.parameter(9.8, positive=True)
    r: float = hy.parameter(0.9, between=(0, 1), doc="coefficient of restitution")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.x2, -self.g, s.x4, -2 * s.x3 - 3 * s.x4 + 20 * s.x2**2

    impact = hy.contact(flight, gap=lambda self, t, s: s.x1 - 1.0, restitution="r")


START = {"x1": 6.0, "x2": 0.0, "x3": 10.0, "x4": -1000.0}
UNTIL = (0.0, 25.0)


def oracle(run):
    """Values computed with 40 digits."""
    end = run.zeno[0]
    yield "t_inf", end.t, 19.192898346492004233737, 1e-11
    yield "x3 at t = 1", run(1.0).x3, -134.19758013775831818, 1e-9
    yield "x4 at t = 1", run(1.0).x4, 415.42764672329033856, 1e-9
    yield "x3 at t = 10", run(10.0).x3, 107.22960362862488103, 1e-9
    yield "x4 at t = 10", run(10.0).x4, -28.198812352293717061, 1e-9
    yield "x3 at t_inf", end.state.x3, 3.1319870106304709135, 1e-9
    yield "x4 at t_inf", end.state.x4, -2.6845592096926250622, 1e-9
