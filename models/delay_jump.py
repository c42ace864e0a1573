"""A delay equation whose state is made to jump: the jump comes back a lag later as a corner."""

import hybrid as hy


class DelayJump(hy.Automaton):
    """``y' = -y(t - 1)``, with ``y`` raised by 2 at ``t = 1/2``."""

    y = hy.state()

    lag: float = hy.parameter(1.0, positive=True)
    at: float = hy.parameter(0.5, doc="time of the jump")
    height: float = hy.parameter(2.0, doc="height of the jump")

    @hy.mode(initial=True)
    def decay(self, t, s, past):
        return -past(self.lag).y

    @hy.edge(decay, to=decay, guard=lambda self, t, s: t - self.at, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.y + self.height


START = {"y": 1.0}
UNTIL = (0.0, 10.0)


def oracle(run):
    """Polynomials between breaking points (method of steps), and 40 digits for the last."""
    yield "time of the jump", run.jumps.t[0], 0.5, 0.0
    yield "y before it", run(0.5, side="left").y, 0.5, 1e-12
    yield "y after it", run(0.5).y, 2.5, 1e-12
    yield "y at 1", run(1.0).y, 2.0, 1e-12
    yield "y at 3/2", run(1.5).y, 13 / 8, 1e-12
    yield "y at 3", run(3.0).y, -11 / 12, 1e-12
    yield "y at 5", run(5.0).y, 277 / 960, 1e-12
    yield "y at 10", run(10.0).y, 0.09445695934262014, 1e-12
