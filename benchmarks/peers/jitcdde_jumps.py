"""JiTCDDE with jumps by hand: adaptive steps, the first zero of its cubic past, ``jump``, again.

A jump takes a ``WIDTH`` of time in JiTCDDE; the state given for its end is that of a flight as
long, so that the width costs no accuracy of the first order. Steps end on breaking points. The
method is Bogacki and Shampine's of order three, its past is a cubic between steps. A rest is
written into the past as two points.
"""

from __future__ import annotations

from bisect import bisect
from contextlib import chdir
from operator import itemgetter
from tempfile import TemporaryDirectory

import symengine
from chspy import Anchor, interpolate
from jitcdde import jitcdde, t, y
from scipy.optimize import brentq

from peers.pyragas import TAU, WALL, bounced, pull

WIDTH, SHORTEST = 1e-9, 1e-14


def compiled(case):
    """A solver of the free flight, its C compiled, out of reach of this project's build file."""
    delayed = y(0, t - TAU)
    field = [y(1), -((WALL + y(0)) ** 3) - symengine.cos(y(1)) + case.C * (delayed - y(0))]
    solver = jitcdde(field, delays=[0, TAU], max_delay=2 * TAU, verbose=False)
    with TemporaryDirectory() as elsewhere, chdir(elsewhere):
        solver.compile_C(simplify=False)
    return solver


class Flights:
    def __init__(self, solver, case, tolerance):
        self.solver, self.C, start = solver, case.C, case.x0 - WALL
        self.points = [(-2 * TAU, start, 0.0), (0.0, start, 0.0)]
        self.solver.purge_past()
        self.solver.constant_past([start, 0.0])
        self.solver.set_integration_parameters(
            rtol=tolerance, atol=tolerance, first_step=1e-2, min_step=SHORTEST
        )
        self.solver.integrate_blindly(WIDTH, WIDTH)  # the past's derivative does not fit

    def height(self, s):
        """Read from the points kept here: JiTCDDE copies all its past to show it."""
        k = min(bisect(self.points, s, key=itemgetter(0)), len(self.points) - 1)
        pair = [Anchor(at, (y,), (v,)) for at, y, v in self.points[k - 1 : k + 1]]
        return interpolate(s, 0, pair)

    def fly(self, t, y, v, stop, first):
        if y == 0 and v > 0:
            self.jump(t, v)
        solver, engine = self.solver, self.solver.DDE
        solver.dt = first or solver.dt
        while (begin := solver.t) < stop:
            if not solver.try_single_step(min(solver.dt, stop - begin)):
                continue
            engine.accept_step()
            t, (y, v) = solver.t, engine.get_current_state()
            if y < 0:
                t = brentq(lambda s: engine.get_recent_state(s)[0], begin, t, xtol=1e-16)
                y, v = engine.get_recent_state(t)
                self.points.append((t, 0.0, v))
                return t, y, v, True
            self.points.append((t, y, v))
        return t, y, v, False

    def jump(self, t, v):
        """Leave the wall with speed ``v``."""
        a = pull(0.0, v, self.height(t - TAU), self.C)
        after = WIDTH * v, v + WIDTH * a
        before = self.solver.DDE.get_recent_state(t + WIDTH)
        self.solver.jump(after - before, t, WIDTH)
        self.points.append((t + WIDTH, *after))

    def rest(self, t, upto):
        """Two more points; the past begins anew with the points of one lag."""
        self.points += [(t + WIDTH, 0.0, 0.0), (upto, 0.0, 0.0)]
        oldest = bisect(self.points, t - TAU, key=itemgetter(0)) - 1
        self.solver.purge_past()
        self.solver.add_past_points((at, (y, v), (v, 0.0)) for at, y, v in self.points[oldest:])
        self.solver.integrate_blindly(upto + WIDTH, WIDTH)


def solve(solver, case, tolerance):
    return bounced(Flights(solver, case, tolerance), case)
