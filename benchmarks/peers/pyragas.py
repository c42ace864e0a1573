"""What the peers share: the system, the hybrid loop, breaking points, rest and release.

The state is the height ``y = x1 - 2`` above the wall and the velocity ``v``, so that low flights do
not drown in rounding. All peers cut a chattering off below the same speed and add the flights that
are left as a geometric series.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

TAU, WALL = 1.0, 2.0

#: Speed after an impact below which the rest of a chattering is summed.
SLOW = 1e-7

#: Breaking points nearer than this are one.
NEAR = 1e-12

#: Samples of a lag among which the rise that ends a rest is sought.
SAMPLES = 100


class Case(NamedTuple):
    C: float
    r: float
    x0: float
    until: float


class Run(NamedTuple):
    impacts: list
    sticks: list
    lifts: list


def pull(y, v, delayed, C):
    """Acceleration; ``delayed`` is the height one lag ago."""
    return -((WALL + y) ** 3) - math.cos(v) + C * (delayed - y)


def chattering(speed, a, r):
    """How long impacts go on after one that leaves with ``speed``, if ``a`` stays."""
    return -2 * speed / (a * (1 - r))


def next_break(t, kinks, until):
    """The next time at which a kink of the past arrives after one lag or two, at most a lag away.

    Each lag makes the solution smoother by two derivatives: after two, no method here sees a kink.
    """
    late = min(t + TAU, until)
    for lag in (TAU, 2 * TAU):
        k = bisect_right(kinks, t + NEAR - lag)
        late = min([late, *(kink + lag for kink in kinks[k : k + 1])])
    return late


def released(height, begin, C):
    """When the past ``height`` lifts a bead at rest since ``begin``; infinity if never.

    After one lag of rest there is nothing left that could rise: the search ends there.
    """
    load = -pull(0.0, 0.0, 0.0, C) / C
    if load <= 0:
        return math.inf
    times = np.linspace(begin - TAU, begin, SAMPLES)
    above = np.array([height(s) > load for s in times])
    if not above.any():
        return math.inf
    k = int(above.argmax())
    return brentq(lambda s: height(s) - load, times[k - 1], times[k], xtol=1e-15) + TAU


def bounced(peer, case):
    """The run of a peer that can ``fly`` from a state, and keeps the ``height`` of the past.

    ``peer.fly(t, y, v, stop, first)`` gives time, height and velocity at the wall or at ``stop``,
    and whether it was the wall; ``peer.rest(t, upto)`` writes a rest into the past.
    """
    t, y, v, first, kinks, run = 0.0, case.x0 - WALL, 0.0, None, [0.0], Run([], [], [])
    while t < case.until:
        t, y, v, hit = peer.fly(t, y, v, next_break(t, kinks, case.until), first)
        first = None
        if not hit:
            continue
        run.impacts.append(t)
        kinks.append(t)
        y, v = 0.0, -case.r * v
        a = pull(y, v, peer.height(t - TAU), case.C)
        first = -v / a if a < 0 else None
        if v > SLOW or a >= 0:
            continue
        stick = t + chattering(v, a, case.r)
        lift = released(peer.height, stick, case.C)
        run.sticks.append(stick)
        if lift >= case.until:
            break
        run.lifts.append(lift)
        kinks += [stick, lift]
        peer.rest(t, lift)
        t, v, first = lift, 0.0, 1e-3
    return run
