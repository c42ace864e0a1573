"""A forced relay, x' = a sin(w t) - sign(x), with sliding by hand: three flows and their ends.

A flow ends where x is zero, or, while it slides (side 0), where the force is no longer the weaker.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from peers.oscillator import ABOVE

#: More changes than any run here has.
MOST = 10_000


def rate(f, a, w, side, t):
    """The flow on a side of the surface, or on it."""
    return a * f.sin(w * t) - side if side else 0.0


def excess(f, a, w, t):
    """What the relay has over the force: negative where nothing slides."""
    return 1.0 - (a * f.sin(w * t)) ** 2


def switched(fly, a, w, x, until):
    """The times at which the flow changes; ``fly(side, t, x)`` goes on to the end of a flow."""
    t, side, times = 0.0, 1, []
    while len(times) < MOST:
        t, x = fly(side, t, x)
        if not t < until:
            break
        times.append(t)
        if side == 0:
            side = int(math.copysign(1.0, math.sin(w * t)))
            x = side * ABOVE
        else:
            # a force that is the stronger lets the body cross
            side, x = (0 if excess(math, a, w, t) > 0.0 else -side), 0.0
    return np.array(times)


def by_solve_ivp(a, w, x, until, tolerance):
    """``solve_ivp`` with a terminal event, begun anew at each change."""
    from scipy.integrate import solve_ivp

    def force_ends(t, y):
        return excess(math, a, w, t)

    def surface(t, y):
        return y[0]

    force_ends.terminal = surface.terminal = True
    force_ends.direction = -1

    def fly(side, t, x):
        surface.direction = -side
        event = surface if side else force_ends
        arc = solve_ivp(
            lambda t, y: (rate(math, a, w, side, t),), (t, until), (x,), "DOP853", events=event,
            rtol=tolerance, atol=tolerance, first_step=1e-3, max_step=0.1,
        )  # fmt: skip
        return float(arc.t[-1]), float(arc.y[0, -1])

    return lambda: switched(fly, a, w, x, until)


def by_heyoka(a, w, x, until, tolerance):
    """Three of heyoka's integrators with terminal events."""
    import heyoka

    f = SimpleNamespace(sin=heyoka.sin)
    y, given = heyoka.make_vars("x"), {} if tolerance is None else {"tol": tolerance}
    y = y[0] if isinstance(y, (list, tuple)) else y
    fall = heyoka.event_direction.negative

    def integrator(side):
        gap = y * float(side) if side else excess(f, a, w, heyoka.time)
        flow = heyoka.expression(rate(f, a, w, side, heyoka.time))
        event = heyoka.t_event(gap, callback=lambda ta, d: False, direction=fall)
        return heyoka.taylor_adaptive([(y, flow)], [x], t_events=[event], **given)

    made = {side: integrator(side) for side in (1, 0, -1)}

    def fly(side, t, x):
        ta = made[side]
        ta.time, ta.state[:] = t, x
        ta.reset_cooldowns()
        ta.propagate_until(until)
        return float(ta.time), float(ta.state[0])

    return lambda: switched(fly, a, w, x, until)


def by_cvode(a, w, x, until, tolerance):
    """CVODE with a root function, begun anew at each change."""
    from sksundae.cvode import CVODE

    def solver(side):
        def flow(t, y, slope):
            slope[0] = rate(math, a, w, side, t)

        def gap(t, y, events):
            events[0] = side * y[0] if side else excess(math, a, w, t)

        gap.terminal, gap.direction = [True], [-1]
        options = {"method": "Adams", "rtol": tolerance, "atol": tolerance, "first_step": 1e-3}
        return CVODE(flow, eventsfn=gap, num_events=1, max_step=0.1, **options)

    def fly(side, t, x):
        arc = solver(side).solve(np.array([t, until]), np.array([x]))
        if arc.t_events is None or not len(arc.t_events):
            return until, x
        return float(arc.t_events[-1]), float(arc.y_events[-1][0])

    return lambda: switched(fly, a, w, x, until)
