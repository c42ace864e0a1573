"""The orbit of Table 1 as a method of low order computes it.

The restarted system flown by the Bogacki-Shampine pair with the step control of well-known solvers
(Shampine and Reichelt 1997, Shampine and Thompson 2001): an error of each step that is, in the
worst component, below ``rtol`` of the solution's size. With the default tolerances of those
solvers, 1e-3 and 1e-6, the largest value at a step's end is what a plot of the steps shows.
"""

from __future__ import annotations

from math import cos

import numpy as np

from .pyragas import model

#: Bogacki and Shampine's pair: places, weights, weights of the result, of the error.
PLACES = (0.5, 0.75)
FIRST, SECOND = 0.5, 0.75
RESULT = np.array([2.0, 3.0, 4.0]) / 9.0
ERROR = np.array([-5.0 / 72.0, 1.0 / 12.0, 1.0 / 9.0, -1.0 / 8.0])

#: Flights flown before one is taken for the orbit's.
TURNS = 40


class Flight:
    """A flight from the wall with speed ``v``, the past being the wall."""

    def __init__(self, v: float, rtol: float, atol: float) -> None:
        self.own, self.rtol, self.floor = model(), rtol, atol / rtol
        self.t, self.y = [0.0], [np.array([self.own.wall, v])]
        self.slopes = [self.rate(0.0, self.y[0])]
        self._fly()

    @property
    def top(self) -> float:
        """The largest height at a step's end."""
        return max(float(y[0]) for y in self.y)

    def rate(self, t: float, y: np.ndarray) -> np.ndarray:
        """The controlled system's right side."""
        own = self.own
        control = own.C * (self.past(t - own.tau) - y[0])
        return np.array([y[1], -(y[0] ** 3) - cos(y[1]) + control])

    def past(self, t: float) -> float:
        """The height at an earlier time: the wall before the flight, then cubic pieces."""
        if t <= 0.0:
            return float(self.own.wall)
        k = min(max(int(np.searchsorted(self.t, t)) - 1, 0), len(self.t) - 2)
        return float(self.piece(k, (t - self.t[k]) / (self.t[k + 1] - self.t[k]))[0])

    def piece(self, k: int, s: float) -> np.ndarray:
        """The cubic with the values and slopes at both ends of a step."""
        h = self.t[k + 1] - self.t[k]
        ends = (1 + 2 * s) * (1 - s) ** 2 * self.y[k] + s * s * (3 - 2 * s) * self.y[k + 1]
        slopes = (1 - s) * self.slopes[k] - s * self.slopes[k + 1]
        found: np.ndarray = ends + s * (1 - s) * h * slopes
        return found

    def _fly(self) -> None:
        size = np.maximum(np.abs(self.y[0]), self.floor)
        h = 0.8 * self.rtol ** (1 / 3) / float(np.max(np.abs(self.slopes[0]) / size))
        while self.y[-1][0] >= self.own.wall:
            h = self._step(h)
        self._land()

    def _step(self, h: float) -> float:
        """One accepted step; the size for the next."""
        failed = False
        while True:
            end, slope, error = self._try(h)
            if error <= self.rtol:
                break
            h *= 0.5 if failed else max(0.5, 0.8 * (self.rtol / error) ** (1 / 3))
            failed = True
        self.t.append(self.t[-1] + h)
        self.y.append(end)
        self.slopes.append(slope)
        if failed:
            return h
        return h / max(0.2, 1.25 * (error / self.rtol) ** (1 / 3))

    def _try(self, h: float) -> tuple[np.ndarray, np.ndarray, float]:
        t, y, first = self.t[-1], self.y[-1], self.slopes[-1]
        second = self.rate(t + PLACES[0] * h, y + h * FIRST * first)
        third = self.rate(t + PLACES[1] * h, y + h * SECOND * second)
        end = y + h * (RESULT[0] * first + RESULT[1] * second + RESULT[2] * third)
        slope = self.rate(t + h, end)
        size = np.maximum(np.maximum(np.abs(y), np.abs(end)), self.floor)
        wrong = h * (np.stack([first, second, third, slope]).T @ ERROR)
        return end, slope, float(np.max(np.abs(wrong) / size))

    def _land(self) -> None:
        from scipy.optimize import brentq

        k = len(self.t) - 2
        s = brentq(lambda s: float(self.piece(k, s)[0]) - self.own.wall, 1e-9, 1.0)
        self.period = float((1 - s) * self.t[k] + s * self.t[k + 1])
        self.speed = float(-self.own.r * self.piece(k, s)[1])


def orbit(rtol: float = 1e-3, atol: float = 1e-6) -> tuple[float, float]:
    """Period and amplitude of the orbit, as this method shows them."""
    speed = 5.7
    for _ in range(TURNS):
        flight = Flight(speed, rtol, atol)
        speed = flight.speed
    return flight.period, flight.top - flight.own.wall
