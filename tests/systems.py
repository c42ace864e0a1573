"""Small systems with known solutions, shared by the tests."""

import math

import jax.numpy as jnp

import hybrid as hy
from hybrid.solvers.taylor_backend import TaylorSolver


def without_loop(monkeypatch):
    """From here on the driver judges runs by Taylor's steps, arc by arc and jump by jump."""
    for flag in ("whole", "asked"):
        monkeypatch.setattr(TaylorSolver, flag, False)


class Thermostat(hy.Automaton):
    """Heats towards 30 until 22, cools towards 10 until 18: exponentials."""

    T = hy.state()

    @hy.mode(initial=True)
    def on(self, t, s):
        return 30.0 - s.T

    @hy.mode
    def off(self, t, s):
        return 10.0 - s.T

    @hy.edge(on, to="off", guard=lambda self, t, s: 22.0 - s.T)
    def hot(self, t, s):
        return s

    @hy.edge(off, to=on, guard=lambda self, t, s: s.T - 18.0)
    def cold(self, t, s):
        return s


class Counter(hy.Automaton):
    """A line ``x = t`` that counts zeros of ``(x - a)(x - a - width)`` in a direction."""

    x = hy.state()
    n = hy.state()
    a = hy.parameter(0.5)
    width = hy.parameter(1e-5)

    @hy.mode
    def line(self, t, s):
        return 1.0, 0.0

    @hy.edge(
        line,
        to=line,
        guard=lambda self, t, s: (s.x - self.a) * (s.x - self.a - self.width),
        crossing=hy.EITHER,
    )
    def zero(self, t, s):
        return s.replace(n=s.n + 1)


class FallingCounter(Counter):
    @hy.edge(
        "line", to="line", guard=lambda self, t, s: (s.x - self.a) * (s.x - self.a - self.width)
    )
    def zero(self, t, s):
        return s.replace(n=s.n + 1)


class RisingCounter(Counter):
    @hy.edge(
        "line",
        to="line",
        guard=lambda self, t, s: -(s.x - self.a) * (s.x - self.a - self.width),
        crossing=hy.RISING,
    )
    def zero(self, t, s):
        return s.replace(n=s.n + 1)


class Oscillator(hy.Automaton):
    """``x = cos t`` above a wall."""

    x = hy.state()
    v = hy.state()
    wall = hy.parameter(-1.0)
    r = hy.parameter(0.5, between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -s.x

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.wall, restitution="r")


class Corner(hy.Automaton):
    """A free body in the corner of two walls."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.u, s.w, 0.0, 0.0

    left = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)


class Room(hy.Automaton):
    """A ball on a floor between two walls, under gravity."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.u, s.w, 0.0, -9.81

    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)
    wall = hy.contact(flight, gap=lambda self, t, s: 3.0 - s.x, restitution=0.5)


class Loop(hy.Automaton):
    """Two modes that push back onto their common border: no flow between the jumps."""

    x = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0

    @hy.mode
    def down(self, t, s):
        return -1.0

    @hy.edge(up, to=down, guard=lambda self, t, s: 1.0 - s.x)
    def over(self, t, s):
        return s

    @hy.edge(down, to=up, guard=lambda self, t, s: s.x - 1.0)
    def under(self, t, s):
        return s


class Rubbed(hy.Automaton):
    """A ball that rubs along a wall: the force turns within a thousandth of the speed."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.8 - 3.0 * jnp.tanh(s.v / 1e-3)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.8)


class Drag(hy.Automaton):
    """A ball with quadratic drag: the flow has a kink at the top of each flight."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.8)
    c = hy.parameter(0.3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81 - self.c * s.v * jnp.abs(s.v)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


class WeakeningGravity(hy.Automaton):
    """Gravity ``1 - t``: impacts accumulate, or escape, on the two sides of a threshold."""

    y = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, t - 1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.y, restitution="r")


class LawBall(hy.Automaton):
    """A ball, g = 2, whose restitution depends on the speed as a subclass says."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=1.0)


class HarmonicBall(LawBall):
    """``v+ = |v| / (1 + |v|)``: the gaps shrink like 1/n; no accumulation."""

    impact = hy.contact(
        "flight", gap=lambda self, t, s: s.x, restitution=lambda self, t, s, u: 1 / (1 - u)
    )


class ForcedOscillator(hy.Automaton):
    """Budd and Dux: ``x'' + x = cos(w t)`` below a wall at ``sigma``."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.8)
    w = hy.parameter(2.8)
    sigma = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -s.x + jnp.cos(self.w * t)

    impact = hy.contact(flight, gap=lambda self, t, s: self.sigma - s.x, restitution="r")


class Ceiling(hy.Automaton):
    """A body thrown up under a ceiling at 0, gravity 2."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(flight, gap=lambda self, t, s: -s.x, restitution=0.5)


class Pair(hy.Automaton):
    """Two balls over two floors, gravity 10."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.u, s.w, -10.0, -10.0

    first = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
    second = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)


class Switching(hy.Automaton):
    """A ball whose gravity falls from 10 to 2 at t = 6."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -jnp.where(t < 6.0, 10.0, 2.0)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.9)


class DippingCeiling(hy.Automaton):
    """A ball under a ceiling that comes down for a moment at ``t = c``."""

    x = hy.state()
    v = hy.state()
    c = hy.parameter(3.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.9)
    ceiling = hy.contact(
        flight,
        gap=lambda self, t, s: 2 - 1.99 * jnp.exp(-(((t - self.c) / 0.2) ** 2)) - s.x,
        restitution=0.9,
    )


class Metered(Thermostat):
    """A thermostat beside a meter whose reading is large."""

    E = hy.state()

    @hy.mode(initial=True)
    def on(self, t, s):
        return 30.0 - s.T, 0.0

    @hy.mode
    def off(self, t, s):
        return 10.0 - s.T, 0.0


class BareTanks(hy.Automaton):
    """Two tanks whose author names no mode for the limit."""

    x1 = hy.state()
    x2 = hy.state()

    @hy.mode(initial=True)
    def first(self, t, s):
        return 0.8 + 0.0 * s.x1, -1.0 + 0.0 * s.x2

    @hy.mode
    def second(self, t, s):
        return -1.0 + 0.0 * s.x1, 0.8 + 0.0 * s.x2

    @hy.edge(first, to=second, guard=lambda self, t, s: s.x2 - 5.0)
    def to_second(self, t, s):
        return s

    @hy.edge(second, to=first, guard=lambda self, t, s: s.x1 - 5.0)
    def to_first(self, t, s):
        return s


class Stacked(hy.Automaton):
    """Two equal beads, one above the other, over a floor."""

    a: float = hy.parameter(0.8)
    b: float = hy.parameter(0.3)
    x = hy.state()
    y = hy.state()
    v = hy.state()
    w = hy.state()

    @hy.mode
    def falls(self, t, s):
        return s.v, s.w, -9.81, -9.81

    floor = hy.contact(falls, gap=lambda self, t, s: s.x, restitution="a")
    between = hy.contact(falls, gap=lambda self, t, s: s.y - s.x, restitution="b")


class Pile(Stacked):
    """The same over a table that shakes."""

    size: float = hy.parameter(0.1)
    omega: float = hy.parameter(12.0)

    floor = hy.contact(
        "falls",
        gap=lambda self, t, s: s.x - self.size * jnp.sin(self.omega * t),
        restitution="a",
    )


#: a, b, size, omega and the height of the upper bead: thrown up and at rest again, many times.
PILES = [
    (0.277, 0.409, 0.268, 9.531, 1.102),
    (0.739, 0.377, 0.211, 2.179, 1.040),
    (0.403, 0.750, 0.228, 7.319, 1.189),
]


def stacked(a, b, x, y, v, w, slow=1e-10):
    """When both rest, by exact flights, collisions and sums, until all is slower than ``slow``."""
    gap, u, t, g = y - x, w - v, 0.0, 9.81  # u: speed of the gap between them
    while t == 0.0 or max(abs(v), abs(u)) > slow:
        rests = x == v == 0
        floor = math.inf if rests else (v + math.sqrt(v * v + 2 * g * x)) / g
        if rests:
            meet = (u + math.sqrt(u * u + 2 * g * gap)) / g
        else:
            meet = -gap / u if u < 0 else math.inf
        s = min(floor, meet)
        t, gap = t + s, gap + u * s - (0.5 * g * s * s if rests else 0.0)
        u -= g * s if rests else 0.0
        if not rests:
            x, v = x + v * s - 0.5 * g * s * s, v - g * s
        if meet < floor:
            v, u, gap = v + 0.5 * (1 + b) * u, -b * u, 0.0
            continue
        v, u, x = -a * v, u + (1 + a) * v, 0.0
        total = 2 * v / (g * (1 - a))
        there = gap + (u + v) * total - 0.5 * g * total * total
        if min(gap, there) > v * v / (2 * g):  # the lower bead comes to rest before they meet
            t, gap, u, v = t + total, there, u + v - g * total, 0.0
    return t


class PutBack(hy.Automaton):
    """A ball whose author writes its impacts as jumps, which put it onto the floor, and loses no
    speed."""

    y = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -98.1

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.y)
    def impact(self, t, s):
        return s.replace(y=0.0, v=-s.v)


class Shelf(hy.Automaton):
    """A ball on a shelf, an event and clocks that only count."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)
    r: float = hy.parameter(0.5)
    event: float = hy.parameter(1.0)
    ring: float = hy.parameter(2.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -8.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 20.0, restitution="r")

    @hy.edge(flight, guard=lambda self, t, s: self.event - t)
    def tick(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flight, at="ring")
    def tock(self, t, s):
        return s.replace(n=s.n + 1)
