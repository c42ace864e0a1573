"""Two leaking tanks and one hose (Johansson et al. 1999): the hose moves infinitely often."""

import hybrid as hy


class TwoTanks(hy.Automaton):
    """The hose goes to the tank that has fallen to its mark; both marks are reached at last."""

    x1 = hy.state(unit="m", doc="level of the first tank")
    x2 = hy.state(unit="m", doc="level of the second tank")

    w: float = hy.parameter(1.8, unit="m/s", doc="inflow")
    v1: float = hy.parameter(1.0, unit="m/s", doc="leak of the first tank")
    v2: float = hy.parameter(1.0, unit="m/s", doc="leak of the second tank")
    r1: float = hy.parameter(5.0, unit="m", doc="mark of the first tank")
    r2: float = hy.parameter(5.0, unit="m", doc="mark of the second tank")

    @hy.mode(initial=True)
    def fills_first(self, t, s):
        return self.w - self.v1, -self.v2

    @hy.mode
    def fills_second(self, t, s):
        return -self.v1, self.w - self.v2

    # Neither level can be kept: the model's author lets the inflow be shared from then on.
    @hy.mode(limit_of=("to_second", "to_first"))
    def shares(self, t, s):
        falls = 0.5 * (self.w - self.v1 - self.v2)
        return falls, falls

    @hy.edge(fills_first, to=fills_second, guard=lambda self, t, s: s.x2 - self.r2)
    def to_second(self, t, s):
        return s

    @hy.edge(fills_second, to=fills_first, guard=lambda self, t, s: s.x1 - self.r1)
    def to_first(self, t, s):
        return s


START = {"x1": 8.0, "x2": 6.0}
UNTIL = (0.0, 30.0)


def oracle(run):
    """The total level falls evenly; the hose's visits shrink by 0.8 each."""
    yield "t_inf", run.zeno[0].t, 20.0, 1e-11
    yield "ratio", run.zeno[0].ratio, 0.64, 1e-9
    yield "x1 at t_inf", run.zeno[0].state.x1, 5.0, 1e-11
    yield "twelfth switch", run.jumps.t[11], 18.36791242752, 1e-11
    yield "x2 at the end", run.final.x2, 4.0, 1e-11
