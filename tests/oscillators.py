"""Oscillators and maps with known orbits or exponents, shared by the tests."""

import jax.numpy as jnp
import numpy as np

import hybrid as hy
from models.bead_on_table import BeadOnTable


class VanDerPol(hy.Automaton):
    """``x'' = mu (1 - x^2) x' - x``."""

    x = hy.state()
    v = hy.state()
    mu = hy.parameter(1.0)

    @hy.mode
    def flow(self, t, s):
        return s.v, self.mu * (1 - s.x**2) * s.v - s.x


class Linear(hy.Automaton):
    """A triangular linear flow: its exponents are 0.3 and -0.7."""

    x = hy.state()
    y = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 0.3 * s.x + s.y, -0.7 * s.y


class Lorenz(hy.Automaton):
    """Lorenz (1963), with the usual numbers."""

    x = hy.state()
    y = hy.state()
    z = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 10.0 * (s.y - s.x), s.x * (28.0 - s.z) - s.y, s.x * s.y - 8.0 / 3.0 * s.z


class Baker(hy.Automaton):
    """The baker's map in thirds, once in each unit of a clock."""

    x = hy.state()
    y = hy.state()
    clock = hy.state()

    @hy.mode
    def hold(self, t, s):
        return 0.0 * s.x, 0.0 * s.y, 1.0

    @hy.edge(hold, to=hold, guard=lambda self, t, s: 1.0 - s.clock)
    def tick(self, t, s):
        third = jnp.floor(3 * s.x)
        return 3 * s.x - third, (s.y + third) / 3, 0.0


class Chain(hy.Automaton):
    """A reset leads onto the guard of another edge, which fires at once."""

    x = hy.state()
    y = hy.state()

    @hy.mode(initial=True)
    def first(self, t, s):
        return 1.0 + 0.2 * s.y, -0.3 * s.y + 0.1 * t

    @hy.mode
    def second(self, t, s):
        return 2.0 - 0.1 * s.x, 0.5 * s.x

    @hy.edge(first, to=second, guard=lambda self, t, s: 1.0 - s.x - 0.1 * s.y)
    def one(self, t, s):
        y = 1.5 * s.y + 0.2 * t
        return 2.0 + 0.2 * y - 0.04 * t, y

    @hy.edge(second, to=first, guard=lambda self, t, s: 2.0 + 0.2 * s.y - 0.04 * t - s.x)
    def two(self, t, s):
        return 0.1 * s.y, 0.4 * s.y + 0.2 * s.x


class Beside(hy.Automaton):
    """A bouncing ball beside a damped oscillator: each acts on the other, on the floor and on
    the restitution. With a force of period 2 pi."""

    x = hy.state()
    v = hy.state()
    z = hy.state()
    w = hy.state()
    r = hy.parameter(0.6)
    amplitude = hy.parameter(0.2)

    @hy.mode
    def flight(self, t, s):
        fall = -2.0 - 0.3 * s.z * s.x + 0.2 * s.w
        return s.v, fall, s.w, -2.0 * s.z - 0.1 * s.w + 0.4 * s.v**2 + 0.3 * s.x

    floor = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(t) + 0.1 * s.z,
        restitution=lambda self, t, s, u: self.r * (1 + 0.1 * s.z),
    )


def bouncing(r, amplitude, omega, sign=1, g=9.8):
    """A ball that bounces on a sinusoidal table once a period, in closed form.

    The launch speed ``g T / 2`` is the landing speed, so the table moves at ``(1 - r) / (1 + r)``
    times that when it is met; ``sign`` chooses between the two phases at which it does. The two
    multipliers have the product ``r^2`` and the sum returned.

    Returns
    -------
    model, period, speed, time of an impact, sum of the multipliers
    """
    period = 2 * np.pi / omega
    speed = g * period / 2
    phase = sign * np.arccos(speed * (1 - r) / (1 + r) / (amplitude * omega))
    trace = 1 + r**2 - (1 + r) ** 2 * amplitude * omega**2 * np.sin(phase) / g
    model = BeadOnTable(g=g, r=r, amplitude=amplitude, omega=omega)
    return model, period, speed, phase / omega, trace


def flight(model, speed, since, wait):
    """The state of that ball a while after its impact at a time."""
    height = model.amplitude * np.sin(model.omega * since)
    return {"x": height + speed * wait - model.g * wait**2 / 2, "v": speed - model.g * wait}
