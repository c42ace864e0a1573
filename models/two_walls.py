"""A body between two walls: two contacts in one mode, and no accumulation."""

import hybrid as hy


class TwoWalls(hy.Automaton):
    """A free body between walls at ``0`` and ``width``."""

    x = hy.state(unit="m", doc="position")
    v = hy.state(unit="m/s", doc="velocity")

    r: float = hy.parameter(0.8, between=(0, 1), doc="coefficient of restitution")
    width: float = hy.parameter(1.0, unit="m", positive=True)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, 0.0

    left = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")
    right = hy.contact(flight, gap=lambda self, t, s: self.width - s.x, restitution="r")


START = {"x": 0.25, "v": 1.0}
UNTIL = (0.0, 20.0)


def oracle(run):
    """The n-th crossing takes ``r^-n``: the gaps grow, so nothing accumulates."""
    r = float(run.parameters["r"])
    times, t, n = [], 0.75, 0
    while t < UNTIL[1]:
        times.append(t)
        n += 1
        t += r**-n
    yield "impacts", len(run.jumps), len(times), 0
    yield "last impact", run.jumps.t[-1], times[-1], 1e-12
    yield "accumulations", len(run.zeno), 0, 0
    yield "speed at the end", abs(run.final.v), r ** len(times), 1e-13
