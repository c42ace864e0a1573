"""Scenes with several attractors, whose basins are known (``test_basins.py``)."""

import jax.numpy as jnp

import hybrid as hy


class Wells(hy.Automaton):
    """A damped particle in two wells, with a wall on each side, struck with restitution."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    r: float = hy.parameter(0.7, between=(0, 1))
    damping: float = hy.parameter(0.3, unit="1/s")
    wall: float = hy.parameter(1.3, unit="m")

    @hy.mode
    def free(self, t, s):
        return s.v, s.x - s.x**3 - self.damping * s.v

    left = hy.contact(free, gap=lambda self, t, s: s.x + self.wall, restitution="r")
    right = hy.contact(free, gap=lambda self, t, s: self.wall - s.x, restitution="r")


class Floor(hy.Automaton):
    """A bead on a table that moves as ``G sin t``: it rests on it, or bounces for ever."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    G: float = hy.parameter(0.6, unit="m")
    e: float = hy.parameter(0.7, between=(0, 1))
    g: float = hy.parameter(1.0, unit="m/s^2")

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.G * jnp.sin(t), restitution="e")


class Belt(hy.Automaton):
    """A block on a belt, held by a spring; friction falls with the slip's speed."""

    x = hy.state()
    v = hy.state()
    belt: float = hy.parameter(0.2)
    damping: float = hy.parameter(1.3)

    @hy.mode(initial=True)
    def slow(self, t, s):
        return s.v, -s.x - self.damping * s.v + 1.0 / (1.0 + 3.0 * (self.belt - s.v))

    @hy.mode
    def fast(self, t, s):
        return s.v, -s.x - self.damping * s.v - 1.0 / (1.0 + 3.0 * (s.v - self.belt))

    friction = hy.switching(fast, slow, surface=lambda self, t, s: s.v - self.belt)


class Rooms(hy.Automaton):
    """What lies above zero goes to another room, where it is told by the same coordinate."""

    x = hy.state()

    @hy.mode(initial=True)
    def entry(self, t, s):
        return (jnp.sign(s.x),)

    @hy.mode
    def here(self, t, s):
        return (-s.x,)

    @hy.mode
    def there(self, t, s):
        return (-s.x,)

    @hy.edge(entry, to=there, guard=lambda self, t, s: 3.0 - s.x)
    def rises(self, t, s):
        return s

    @hy.edge(entry, to=here, guard=lambda self, t, s: s.x + 3.0)
    def falls(self, t, s):
        return s
