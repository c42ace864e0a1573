"""Random scenes whose accumulation is known, for the bounds on its error."""

import math

import attrs
import jax.numpy as jnp
import mpmath as mp
import numpy as np

import hybrid as hy
from models.hard_spring import HardSpring


class Falling(hy.Automaton):
    """A ball over a floor that moves steadily."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(9.81)
    r: float = hy.parameter(0.7)
    floor: float = hy.parameter(0.0)
    rate: float = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.floor - self.rate * t, restitution="r"
    )


class Switched(hy.Automaton):
    """A ball whose weight changes at a time."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(9.81)
    later: float = hy.parameter(5.0)
    at: float = hy.parameter(0.5)
    r: float = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s):
        return s.v, -jnp.where(t < self.at, self.g, self.later)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


@attrs.frozen
class Known:
    """A scene: what to simulate, from when to when, in which unit of length, and ``t_inf``."""

    what: str
    model: object
    start: list
    t0: float
    unit: float
    exact: float

    def run(self, solver, rtol):
        """A run past the accumulation."""
        end = self.exact + 0.1 * (self.exact - self.t0)
        span, atol = (self.t0, end), 1e-2 * rtol * self.unit
        return hy.simulate(self.model, self.start, span, solver=solver, rtol=rtol, atol=atol)


def scenes(count, seed=0):
    """So many scenes: balls, moving floors, switched weights, hard springs."""
    draw = np.random.default_rng(seed)
    makers = [ball, ball, floor, floor, switched, spring]
    return [makers[k % len(makers)](draw) for k in range(count)]


def _restitution(draw):
    return float(draw.choice([draw.uniform(0.02, 0.9), 1.0 - 10 ** draw.uniform(-2.5, -1.0)]))


def ball(draw):
    """Any restitution, weight, height, unit and time."""
    unit, tick = 10 ** draw.uniform(-6, 6), 10 ** draw.uniform(-3, 3)
    g, h = draw.uniform(0.5, 20) * unit / tick**2, draw.uniform(0.1, 5) * unit
    r, t0 = _restitution(draw), float(draw.choice([0.0, 1.0, -1e3, 1e5])) * tick
    exact = mp.mpf(t0) + mp.sqrt(2 * mp.mpf(h) / g) * (1 + mp.mpf(r)) / (1 - mp.mpf(r))
    return Known("ball", Falling(g=g, r=r), [h, 0.0], t0, unit, float(exact))


def floor(draw):
    """In the frame of a steady floor the ball is one over a fixed floor, thrown."""
    unit = 10 ** draw.uniform(-6, 6)
    g, h, rate = (draw.uniform(a, b) * unit for a, b in ((1, 20), (0.1, 3), (-3, 3)))
    v, r, t0 = draw.uniform(-2, 4) * unit, _restitution(draw), float(draw.choice([0.0, 7.0, 1e3]))
    place = -rate * t0
    u, gap = mp.mpf(v) - mp.mpf(rate), mp.mpf(h) - mp.mpf(place) - mp.mpf(rate) * mp.mpf(t0)
    fast = mp.sqrt(u * u + 2 * mp.mpf(g) * gap)
    exact = mp.mpf(t0) + (u + fast) / g + 2 * mp.mpf(r) * fast / g / (1 - mp.mpf(r))
    model = Falling(g=g, r=r, floor=place, rate=rate)
    return Known("floor", model, [h, v], t0, unit, float(exact))


def switched(draw):
    """Parabolas before and after."""
    unit = 10 ** draw.uniform(-3, 3)
    g, later, h = (draw.uniform(a, b) * unit for a, b in ((1, 20), (1, 20), (0.1, 3)))
    r = draw.uniform(0.1, 0.9)
    end = math.sqrt(2 * h / g) * (1 + r) / (1 - r)
    at = draw.uniform(0.02, 0.95) * end
    t, x, u = mp.mpf(0), mp.mpf(h), mp.mpf(0)
    while True:
        flight = (u + mp.sqrt(u * u + 2 * mp.mpf(g) * x)) / mp.mpf(g)
        if t + flight > at:
            break
        t, x, u = t + flight, mp.mpf(0), -mp.mpf(r) * (u - g * flight)
    s = mp.mpf(at) - t
    x, u = x + u * s - mp.mpf(g) * s * s / 2, u - mp.mpf(g) * s
    fast = mp.sqrt(u * u + 2 * mp.mpf(later) * x)
    exact = mp.mpf(at) + (u + fast) / later + 2 * mp.mpf(r) * fast / later / (1 - mp.mpf(r))
    model = Switched(g=g, later=later, at=at, r=r)
    return Known("switched", model, [h, 0.0], 0.0, unit, float(exact))


def spring(draw):
    """Example 1 of the paper from any height, in series of 30 digits."""
    r, x = draw.uniform(0.2, 0.9), 2.0 + draw.uniform(0.005, 0.1)
    return Known("spring", HardSpring(r=r), [x, 0.0], 0.0, 1.0, float(_sprung(x, r)))


def _series(x, v, order=30):
    """Taylor coefficients of ``x'' = -cos x' - x^3``."""
    xs, vs, c, s, square = [x], [v], [mp.cos(v)], [mp.sin(v)], []
    for k in range(order):
        square.append(mp.fsum(xs[i] * xs[k - i] for i in range(k + 1)))
        cube = mp.fsum(square[i] * xs[k - i] for i in range(k + 1))
        xs.append(vs[k] / (k + 1))
        vs.append((-c[k] - cube) / (k + 1))
        pairs = [(i * vs[i], k + 1 - i) for i in range(1, k + 2)]
        new = mp.fsum(a * c[j] for a, j in pairs), -mp.fsum(a * s[j] for a, j in pairs)
        s.append(new[0] / (k + 1))
        c.append(new[1] / (k + 1))
    return xs, vs


def _value(powers, s):
    value = mp.mpf(0)
    for c in reversed(powers):
        value = value * s + c
    return value


def _sprung(x, r):
    with mp.workdps(30):
        t, x, v, r, rises = mp.mpf(0), mp.mpf(x), mp.mpf(0), mp.mpf(r), False
        while x > 2 or abs(v) > mp.mpf(10) ** -13:
            xs, vs = _series(x, v)
            h = mp.mpf("0.05") * min(abs(c) ** (-mp.mpf(1) / k) for k, c in enumerate(vs) if k > 27)
            gap = xs[1:] if rises else [xs[0] - 2, *xs[1:]]
            s = -2 * v / vs[1] if rises else h
            slope = [k * c for k, c in enumerate(gap)][1:]
            if rises or _value(gap, h) <= 0:
                for _ in range(30):
                    s -= _value(gap, s) / _value(slope, s)
            if (rises and s <= h) or (not rises and _value(gap, h) <= 0):
                t, x, v, rises = t + s, mp.mpf(2), -r * _value(vs, s), True
            else:
                t, x, v = t + h, _value(xs, h), _value(vs, h)
                rises = False
        return t + 2 * v / 9 / (1 - r)
