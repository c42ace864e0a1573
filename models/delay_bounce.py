"""A ball pushed up by where it was a second ago: it rests, is released, and rests again."""

import hybrid as hy


class DelayBounce(hy.Automaton):
    """``y'' = -g + k y(t - tau)`` over a floor at ``y = 0``, on which it lay until ``t = 0``."""

    y = hy.state(unit="m", doc="height")
    v = hy.state(unit="m/s", doc="velocity")

    g: float = hy.parameter(1.0, unit="m/s^2", positive=True)
    k: float = hy.parameter(38.0, unit="1/s^2", doc="gain of the delayed push")
    tau: float = hy.parameter(1.0, unit="s", positive=True, doc="lag of the push")
    r: float = hy.parameter(0.1, between=(0, 1), doc="coefficient of restitution")

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, -self.g + self.k * past(self.tau).y

    impact = hy.contact(flight, gap=lambda self, t, s: s.y, restitution="r")


START = {"y": 0.05, "v": 0.0}
HISTORY = {"y": 0.0, "v": 0.0}
UNTIL = (0.0, 4.0)


def oracle(run):
    """Roots with 30 digits; it is first released when the push sees it lifted, at ``tau``."""
    first, second, third = run.zeno[:3]
    yield "first impact", run.jumps.t[0], 0.31622776601683793320, 1e-12
    yield "first rest", first.t, 0.38650060290946858502, 1e-12
    yield "first release", first.t_release, 1.0, 1e-15
    yield "second rest", second.t, 1.71423059942680915973, 1e-10
    yield "second release", second.t_release, 2.28692730886153627957, 1e-10
    yield "third rest", third.t, 2.77836467875937725037, 1e-10
    yield "y at the end", run.final.y, 0.0, 0.0
