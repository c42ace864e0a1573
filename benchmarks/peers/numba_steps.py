"""Method of steps by hand: Dormand and Prince's pair, its interpolant as the past, numba.

A step never reaches over a breaking point nor over a lag, so that the past of all its stages is
known: a row a piece, found by a pointer that only follows the time. The interpolant tells about
where a flight ends; Newton's method repeats the step until it ends on the wall.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from peers import pyragas
from peers.pyragas import NEAR, SLOW, TAU, WALL, Run

compiled = numba.njit(error_model="numpy")
pull, chattering = compiled(pyragas.pull), compiled(pyragas.chattering)

#: Columns of a piece of the past: its start, its width, the coefficients of its interpolant.
COLUMNS = 7

IMPACT, STICK, LIFT = 0.0, 1.0, 2.0


@compiled
def height(piece, theta):
    """The interpolant at a fraction of its step (Hairer, Nørsett and Wanner's form)."""
    left = 1 - theta
    inner = piece[4] + theta * (piece[5] + left * piece[6])
    return piece[2] + theta * (piece[3] + left * inner)


@compiled
def slope(piece, theta):
    """Derivative of the interpolant by the fraction."""
    d, a, b, c = piece[3], piece[4], piece[5], piece[6]
    left = 1 - theta
    return (
        d
        + (1 - 2 * theta) * a
        + theta * (2 - 3 * theta) * b
        + 2 * theta * left * (left - theta) * c
    )


@compiled
def look_up(past, count, k, s):
    """Height at the time ``s`` and the number of the piece it lies in, sought from piece ``k``."""
    while past[k, 0] > s and k > 0:
        k -= 1
    while k + 1 < count and past[k + 1, 0] <= s:
        k += 1
    return height(past[k], (s - past[k, 0]) / past[k, 1]), k


@compiled
def attempt(t, y, v, a, h, C, tolerance, past, count, k):
    """One step: the state after it, its acceleration, its error and its piece of the past."""
    s = t - TAU
    z2, k = look_up(past, count, k, s + h / 5)
    v2 = v + h * a / 5
    a2 = pull(y + h * v / 5, v2, z2, C)
    z3, k = look_up(past, count, k, s + 3 * h / 10)
    v3 = v + h * (3 / 40 * a + 9 / 40 * a2)
    a3 = pull(y + h * (3 / 40 * v + 9 / 40 * v2), v3, z3, C)
    z4, k = look_up(past, count, k, s + 4 * h / 5)
    v4 = v + h * (44 / 45 * a - 56 / 15 * a2 + 32 / 9 * a3)
    a4 = pull(y + h * (44 / 45 * v - 56 / 15 * v2 + 32 / 9 * v3), v4, z4, C)
    z5, k = look_up(past, count, k, s + 8 * h / 9)
    b1, b2, b3, b4 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
    v5 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4)
    a5 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4), v5, z5, C)
    z6, k = look_up(past, count, k, s + h)
    b1, b2, b3, b4, b5 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
    v6 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4 + b5 * a5)
    a6 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4 + b5 * v5), v6, z6, C)
    b1, b3, b4, b5, b6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
    rise = h * (b1 * v + b3 * v3 + b4 * v4 + b5 * v5 + b6 * v6)
    y1, v1 = y + rise, v + h * (b1 * a + b3 * a3 + b4 * a4 + b5 * a5 + b6 * a6)
    a1 = pull(y1, v1, z6, C)
    e1, e3, e4 = 71 / 57600, -71 / 16695, 71 / 1920
    e5, e6, e7 = -17253 / 339200, 22 / 525, -1 / 40
    ey = h * (e1 * v + e3 * v3 + e4 * v4 + e5 * v5 + e6 * v6 + e7 * v1)
    ev = h * (e1 * a + e3 * a3 + e4 * a4 + e5 * a5 + e6 * a6 + e7 * a1)
    ey /= tolerance * (1 + max(abs(y), abs(y1)))
    ev /= tolerance * (1 + max(abs(v), abs(v1)))
    d1, d3, d4 = -12715105075 / 11282082432, 87487479700 / 32700410799, -10690763975 / 1880347072
    d5, d6, d7 = 701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423
    bend = h * v - rise
    last = h * (d1 * v + d3 * v3 + d4 * v4 + d5 * v5 + d6 * v6 + d7 * v1)
    piece = (t, h, y, rise, bend, rise - h * v1 - bend, last)
    return y1, v1, a1, math.sqrt(0.5 * (ey * ey + ev * ev)), piece, k


@compiled
def fraction(piece, low, high):
    """Where the interpolant is zero, between a fraction where it is above and one where below."""
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if height(piece, middle) > 0 else (low, middle)
    return high


@compiled
def dip(piece, v, v1):
    """Fraction of the step at which the height is smallest, one if that is its end."""
    if v >= 0 or v1 <= 0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(piece, middle) < 0 else (low, middle)
    return high


@compiled
def next_break(t, kinks, made, first, second, until):
    """As in ``pyragas``, with a pointer for each number of lags."""
    while first < made and kinks[first] + TAU <= t + NEAR:
        first += 1
    while second < made and kinks[second] + 2 * TAU <= t + NEAR:
        second += 1
    late = min(t + TAU, until)
    if first < made:
        late = min(late, kinks[first] + TAU)
    if second < made:
        late = min(late, kinks[second] + 2 * TAU)
    return late, first, second


@compiled
def landed(t, y, v, a, end, C, tolerance, past, count, k):
    """The step of about ``end`` that ends on the wall: length, last velocity, piece."""
    for _ in range(10):
        y1, v1, _, _, piece, k = attempt(t, y, v, a, end, C, tolerance, past, count, k)
        shift = -y1 / v1
        end += shift
        if abs(shift) <= 1e-13 * end:
            break
    return end, v1, piece


@compiled
def reached(piece, part, load):
    """Fraction, at most ``part``, at which the height of a piece rises to ``load``."""
    low, high = 0.0, part
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if height(piece, middle) < load else (low, middle)
    return high


@compiled
def released(past, count, C, begin):
    """When the height one lag ago lifts a bead at rest since ``begin``; infinity if never.

    Without a computed past there is nothing to rise: a rest ends within one lag or not at all.
    """
    load = -pull(0.0, 0.0, 0.0, C) / C
    _, k = look_up(past, count, 0, begin - TAU)
    while load > 0 and k < count - 1:
        width = past[k, 1]
        used = (past[k + 1, 0] - past[k, 0]) / width
        for part in (used / 4, used / 2, 3 * used / 4, used):
            if past[k, 0] + part * width > begin - TAU and height(past[k], part) > load:
                return past[k, 0] + reached(past[k], part, load) * width + TAU
        k += 1
    return math.inf


@compiled
def solved(C, r, x0, until, tolerance, room):
    """Impacts, stick times and lift times; ``room`` is the number of pieces kept."""
    past, kinks = np.zeros((room, COLUMNS)), np.zeros(room)
    events = np.zeros((room, 2))
    t, y, v, h, y0 = 0.0, x0 - WALL, 0.0, 0.01, x0 - WALL
    past[0, :3] = -2 * TAU, 2 * TAU, y0
    count, k, kinked, happened, first, second = 1, 0, 1, 0, 0, 0
    a = pull(y, v, y0, C)
    while t < until and count < room - 2:
        stop, first, second = next_break(t, kinks, kinked, first, second, until)
        lands = t + 1.01 * h >= stop
        own = stop - t if lands else h
        y1, v1, a1, error, piece, k = attempt(t, y, v, a, own, C, tolerance, past, count, k)
        factor = min(5.0, max(0.2, 0.9 * error**-0.2)) if error > 0 else 5.0
        if error > 1:
            h = own * factor
            continue
        lowest = dip(piece, v, v1)
        if height(piece, lowest) >= 0:
            h = max(h, own * factor) if lands and factor >= 1 else own * factor
            t, y, v, a = stop if lands else t + own, y1, v1, a1
            past[count] = piece
            count += 1
            continue
        end = own * fraction(piece, 0.0, lowest)
        end, v1, past[count] = landed(t, y, v, a, end, C, tolerance, past, count, k)
        count += 1
        t, y, v = t + end, 0.0, -r * v1
        events[happened], kinks[kinked] = (t, IMPACT), t
        happened, kinked = happened + 1, kinked + 1
        z, k = look_up(past, count, k, t - TAU)
        a = pull(y, v, z, C)
        h = min(h, -2.1 * v / a) if a < 0 else h
        if v > SLOW or a >= 0:
            continue
        stick = t + chattering(v, a, r)
        past[count, :2] = t, TAU
        t = released(past, count + 1, C, stick)
        events[happened], events[happened + 1] = (stick, STICK), (t, LIFT)
        kinks[kinked], kinks[kinked + 1] = stick, t
        count, happened, kinked = count + 1, happened + 2, kinked + 2
        y, v, a, h = 0.0, 0.0, 0.0, 1e-3
    return events[:happened]


def solve(case, tolerance, room=100_000):
    events = solved(*case, tolerance, room)
    of_kind = (events[events[:, 1] == kind, 0] for kind in (IMPACT, STICK, LIFT))
    return Run(*(times[times < case.until] for times in of_kind))
