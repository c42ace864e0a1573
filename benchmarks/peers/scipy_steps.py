"""Method of steps around ``solve_ivp``: an arc ends at an impact or at a breaking point.

The dense outputs of the arcs are the past, found by a pointer that only follows the time.
"""

from __future__ import annotations

from scipy.integrate import solve_ivp

from peers.pyragas import TAU, WALL, bounced, pull


def wall(t, y):
    return y[0]


wall.terminal, wall.direction = True, -1


class Flights:
    def __init__(self, case, tolerance):
        self.C, self.tolerance = case.C, tolerance
        self.starts, self.heights, self.k = [-2 * TAU], [lambda s: (case.x0 - WALL, 0.0)], 0

    def height(self, s):
        while self.k > 0 and self.starts[self.k] > s:
            self.k -= 1
        while self.k + 1 < len(self.starts) and self.starts[self.k + 1] <= s:
            self.k += 1
        return self.heights[self.k](s)[0]

    def keep(self, start, height):
        self.starts.append(start)
        self.heights.append(height)

    def flow(self, t, y):
        return y[1], pull(*y, self.height(t - TAU), self.C)

    def fly(self, t, y, v, stop, first):
        first = first and min(first, stop - t)
        options = {"rtol": self.tolerance, "atol": self.tolerance, "first_step": first}
        options |= {"events": wall, "dense_output": True}
        arc = solve_ivp(self.flow, (t, stop), (y, v), "DOP853", **options)
        self.keep(t, arc.sol)
        return arc.t[-1], *arc.y[:, -1], arc.status == 1

    def rest(self, t, upto):
        self.keep(t, lambda s: (0.0, 0.0))


def solve(case, tolerance):
    return bounced(Flights(case, tolerance), case)
