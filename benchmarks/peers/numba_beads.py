"""Ten thousand beads of Example 1 in numba, on all cores: Dormand and Prince's method by hand, and
Taylor's.

Heights are over the wall, so that low flights do not drown in rounding.
"""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np

from peers import numba_taylor
from peers.numba_taylor import ORDER, at_rest, hard_spring

WALL, SLOW = 2.0, 1e-5


def compiled(**options):
    """numba's decorator."""
    return numba.njit(error_model="numpy", **options)


@compiled()
def pull(y, v):
    return -math.cos(v) - (WALL + y) ** 3


@compiled()
def attempt(y, v, a, h, tolerance):
    """One step of the fifth order: the state after it, its acceleration, and its error."""
    v2 = v + h * a / 5
    a2 = pull(y + h * v / 5, v2)
    v3 = v + h * (3 / 40 * a + 9 / 40 * a2)
    a3 = pull(y + h * (3 / 40 * v + 9 / 40 * v2), v3)
    v4 = v + h * (44 / 45 * a - 56 / 15 * a2 + 32 / 9 * a3)
    a4 = pull(y + h * (44 / 45 * v - 56 / 15 * v2 + 32 / 9 * v3), v4)
    b1, b2, b3, b4 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
    v5 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4)
    a5 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4), v5)
    b1, b2, b3, b4, b5 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
    v6 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4 + b5 * a5)
    a6 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4 + b5 * v5), v6)
    b1, b3, b4, b5, b6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
    y1 = y + h * (b1 * v + b3 * v3 + b4 * v4 + b5 * v5 + b6 * v6)
    v1 = v + h * (b1 * a + b3 * a3 + b4 * a4 + b5 * a5 + b6 * a6)
    a1 = pull(y1, v1)
    e1, e3, e4 = 71 / 57600, -71 / 16695, 71 / 1920
    e5, e6, e7 = -17253 / 339200, 22 / 525, -1 / 40
    ey = h * (e1 * v + e3 * v3 + e4 * v4 + e5 * v5 + e6 * v6 + e7 * v1)
    ev = h * (e1 * a + e3 * a3 + e4 * a4 + e5 * a5 + e6 * a6 + e7 * a1)
    ey /= tolerance * (1 + max(abs(y), abs(y1)))
    ev /= tolerance * (1 + max(abs(v), abs(v1)))
    return y1, v1, a1, math.sqrt(0.5 * (ey * ey + ev * ev))


@compiled()
def in_pairs(y, v, tolerance, room):
    """Duration of a flight, and the velocity at its end, by Dormand and Prince's pair."""
    t, a = 0.0, pull(y, v)
    h = 1e-3 if y > 0.0 else 2.1 * v / (math.cos(v) + WALL**3)
    while True:
        y1, v1, a1, error = attempt(y, v, a, h, tolerance)
        if error <= 1 and y1 <= 0:
            break
        if error <= 1:
            t, y, v, a = t + h, y1, v1, a1
        h *= min(10.0, max(0.2, 0.9 * error**-0.2)) if error > 0 else 10.0
    for _ in range(20):  # Newton's method; the height is concave, so it comes from the right
        shift = -y1 / v1
        if abs(shift) <= 1e-14 * h:
            break
        h += shift
        y1, v1, a1, error = attempt(y, v, a, h, tolerance)
    return t + h, v1


@compiled()
def in_series(y, v, tolerance, room):
    """The same by Taylor's method."""
    return numba_taylor.flown(
        hard_spring, (WALL,), at_rest, 0.0, y, v, y == 0.0, tolerance,
        room[0], room[1], room[2], room[3:],
    )  # fmt: skip


#: What flies, by its name.
METHODS = {"Dormand-Prince": in_pairs, "Taylor": in_series}


@cache
def loops(method):
    """The loops over all lanes by a method: to a number of impacts, and to rest."""
    flown = METHODS[method]

    @compiled(parallel=True)
    def last(impacts, tolerance, x, r):
        """Time of the last impact of each lane."""
        times = np.zeros(len(x))
        for i in numba.prange(len(x)):
            room = np.zeros((7, ORDER + 1))
            t, v = flown(x[i] - WALL, 0.0, tolerance, room)
            for _ in range(impacts - 1):
                own, v = flown(0.0, -r[i] * v, tolerance, room)
                t += own
            times[i] = t
        return times

    @compiled(parallel=True)
    def to_rest(until, tolerance, x, r):
        """When the impacts of each lane accumulate; NaN where not before ``until``.

        Impacts slower than ``SLOW`` are added as a geometric series.
        """
        times = np.zeros(len(x))
        for i in numba.prange(len(x)):
            room = np.zeros((7, ORDER + 1))
            t, v = flown(x[i] - WALL, 0.0, tolerance, room)
            while t < until:
                v *= -r[i]
                if v < SLOW:
                    t += 2 * v / ((math.cos(v) + WALL**3) * (1 - r[i]))
                    break
                own, v = flown(0.0, v, tolerance, room)
                t += own
            times[i] = t if t < until else math.nan
        return times

    return last, to_rest
