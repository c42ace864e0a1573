"""Taylor's method by hand, recurrences and all, in numba: about what a core can do.

Steps are of one order and as long as the last two terms allow (Jorba and Zou, 2005). A gap that its
first terms do not hold away from zero is looked at in sixteen places of the step; between two of
unlike sign Newton's method, kept between them, lands. Nothing else is looked at: a touch between
two places is lost.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from peers.oscillator import ABOVE

ORDER, PLACES, LONGEST = 20, 16, 1.0

compiled = numba.njit(error_model="numpy", fastmath={"contract"})


@compiled
def square(a, k):
    """The k-th coefficient of a square."""
    total = 0.0
    for j in range(k + 1):
        total += a[j] * a[k - j]
    return total


@compiled
def product(a, b, k):
    """The k-th coefficient of a product."""
    total = 0.0
    for j in range(k + 1):
        total += a[j] * b[k - j]
    return total


@compiled
def cubic(given, t, y, v, gap, work):
    """x'' = -delta x' + x - x^3 + gamma cos(w t), by the height of x over a floor."""
    delta, gamma, w, floor = given
    x, s = work[0], work[1]
    x[0] = floor + y[0]
    c, d = gamma * math.cos(w * t), -gamma * math.sin(w * t)
    for k in range(ORDER):
        s[k] = square(x, k)
        v[k + 1] = (-delta * v[k] + x[k] - product(x, s, k) + c) / (k + 1)
        y[k + 1] = x[k + 1] = v[k] / (k + 1)
        c, d = d * w / (k + 1), -c * w / (k + 1)
    gap[:] = y


@compiled
def hard_spring(given, t, y, v, gap, work):
    """x'' = -cos x' - x^3, by the height of x over a floor."""
    x, s, c, z = work[0], work[1], work[2], work[3]
    x[0], c[0], z[0] = given[0] + y[0], math.cos(v[0]), math.sin(v[0])
    for k in range(ORDER):
        s[k] = square(x, k)
        v[k + 1] = (-c[k] - product(x, s, k)) / (k + 1)
        y[k + 1] = x[k + 1] = v[k] / (k + 1)
        up = down = 0.0
        for j in range(1, k + 2):
            up += j * v[j] * c[k + 1 - j]
            down += j * v[j] * z[k + 1 - j]
        z[k + 1], c[k + 1] = up / (k + 1), -down / (k + 1)
    gap[:] = y


@compiled
def thrown(given, t, x, v, gap, work):
    """x'' = -g over a wall at a sin(w t)."""
    g, a, w = given
    x[2:], v[2:] = 0.0, 0.0
    v[1], x[1], x[2] = -g, v[0], -0.5 * g
    s, c = a * math.sin(w * t), a * math.cos(w * t)
    for k in range(ORDER + 1):
        gap[k] = x[k] - s
        s, c = c * w / (k + 1), -s * w / (k + 1)


@compiled
def value(a, h):
    total = a[ORDER]
    for k in range(ORDER - 1, -1, -1):
        total = total * h + a[k]
    return total


@compiled
def slope(a, h):
    total = ORDER * a[ORDER]
    for k in range(ORDER - 1, 0, -1):
        total = total * h + k * a[k]
    return total


@compiled
def length(x, v, gap, tolerance):
    """How long a step may be."""
    least = LONGEST
    for a in (x, v, gap):
        size = tolerance * max(1.0, abs(a[0]))
        for k in (ORDER - 1, ORDER):
            if a[k] != 0.0:
                least = min(least, (size / abs(a[k])) ** (1.0 / k))
    return least * math.exp(-0.7 / (ORDER - 1))


@compiled
def far(gap, h):
    """Whether the first terms hold the gap away from zero all through a step."""
    rest, power = 0.0, h
    for k in range(1, ORDER + 1):
        rest += abs(gap[k]) * power
        power *= h
    return gap[0] > rest


@compiled
def zero(gap, h, leaves):
    """The first zero of the gap in a step, its end if there is none."""
    before = 0.0
    for place in range(1, PLACES + 1):
        after = h * place / PLACES
        if value(gap, after) <= 0.0:
            return landed(gap, before, after, leaves and before == 0.0)
        before = after
    return math.inf


@compiled
def landed(gap, low, high, leaves):
    """Newton's method, kept between two places; ``leaves``: the gap is zero at the first."""
    tau = high
    for _ in range(60):
        if leaves:  # the zero at the start is divided out
            here, rate = value(gap, tau) / tau, slope(gap, tau) / tau
            rate -= here / tau
        else:
            here, rate = value(gap, tau), slope(gap, tau)
        if here > 0.0:
            low = tau
        else:
            high = tau
        following = tau - here / rate
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - tau) <= 4e-16 * tau:
            break
        tau = following
    return tau


@compiled
def flown(jet, given, wall, t, x0, v0, leaves, tolerance, x, v, gap, work):
    """Time and velocity at the end of a flight."""
    while True:
        x[0], v[0] = x0, v0
        jet(given, t, x, v, gap, work)
        if leaves:
            gap[0] = 0.0
        h = length(x, v, gap, tolerance)
        tau = math.inf if far(gap, h) else zero(gap, h, leaves)
        if tau < math.inf:
            return t + tau, value(v, tau)
        t, x0, v0, leaves = t + h, value(x, h), value(v, h), False


@compiled
def solved(jet, wall, rest, given, r, slow, t, x0, v0, tolerance, impacts, until):
    """Time, and position and velocity after it, of each impact; how many there are."""
    x, v, gap = np.zeros(ORDER + 1), np.zeros(ORDER + 1), np.zeros(ORDER + 1)
    work, rows, leaves, start = np.zeros((4, ORDER + 1)), np.empty((impacts, 3)), False, (x0, v0)
    for k in range(impacts):
        t, v0 = flown(jet, given, wall, t, x0, v0, leaves, tolerance, x, v, gap, work)
        if t > until:
            return rows, k
        height, moves = wall(given, t)
        speed = r * (moves - v0)
        leaves = speed >= slow
        x0, v0 = (height, moves + speed) if leaves else start
        rows[k] = t, x0, v0
        if not leaves:
            stick, end = rest(given, r, t, speed)
            if end > t:
                rows[k] = stick, *wall(given, stick)
                t, (x0, v0) = end, wall(given, end)
                x0 += ABOVE
    return rows, impacts


@compiled
def at_rest(given, t):
    """Position and velocity of a wall at rest."""
    return 0.0, 0.0


@compiled
def shaken(given, t):
    """Those of a wall at a sin(w t)."""
    _, a, w = given
    return a * math.sin(w * t), a * w * math.cos(w * t)


@compiled
def none(given, r, t, speed):
    """No rest."""
    return t, t


@compiled
def on_table(given, r, t, speed):
    """When a chattering on a shaken wall ends, and when the wall falls away."""
    g, a, w = given
    stick = t + 2 * speed / ((g - a * w * w * math.sin(w * t)) * (1 - r))
    angle, turn = math.asin(g / (a * w * w)), 2 * math.pi
    return stick, (angle + turn * math.ceil((w * stick - angle) / turn)) / w


#: Recurrences and wall by the name of the flow.
FLOWS = {
    "cubic": (cubic, at_rest),
    "hard spring": (hard_spring, at_rest),
    "thrown": (thrown, shaken),
}


def prepare(task, tolerance):
    """A call that makes the impacts."""
    name, *given = task.by_hand
    options = task.r, task.slow, task.begin, *task.start, tolerance or 1e-16, task.impacts
    rules = *FLOWS[name], on_table if task.rest else none

    def fly():
        rows, count = solved(*rules, tuple(given), *options, task.until)
        return rows[:count]

    return fly
