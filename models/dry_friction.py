"""Dry friction: a body on a spring crosses zero speed at each turn, until it sticks."""

import math

import hybrid as hy


class DryFriction(hy.Automaton):
    """``x'' = -x - mu sign(x' - belt)``: a unit mass on a unit spring, on a belt.

    To stick is to slide on the surface ``x' = belt``, while the spring pulls less than ``mu``.
    """

    x = hy.state(unit="m", doc="position")
    v = hy.state(unit="m/s", doc="velocity")

    mu: float = hy.parameter(1.0, unit="N", positive=True, doc="friction force")
    belt: float = hy.parameter(0.0, unit="m/s", doc="speed of the belt")

    @hy.mode
    def faster(self, t, s):
        return s.v, -s.x - self.mu

    @hy.mode(initial=True)
    def slower(self, t, s):
        return s.v, -s.x + self.mu

    friction = hy.switching(faster, slower, surface=lambda self, t, s: s.v - self.belt)


START = {"x": 5.3, "v": 0.0}
UNTIL = (0.0, 12.0)


def oracle(run):
    """Each half turn lasts pi and takes ``2 mu`` off the amplitude: 5.3, -3.3, 1.3, then stuck.

    The last turn leads from 1.3 to 0.7, where the spring pulls less than ``mu``.
    """
    yield "jumps", len(run.jumps), 3, 0.0
    yield "first turn", run.jumps.t[0], math.pi, 1e-12
    yield "x at the first turn", run.jumps.before.x[0], -3.3, 1e-12
    yield "second turn", run.jumps.t[1], 2 * math.pi, 1e-12
    yield "stuck", run.jumps.t[2], 3 * math.pi, 1e-12
    yield "x at the end", run.final.x, 0.7, 1e-12
    yield "v at the end", run.final.v, 0.0, 0.0
