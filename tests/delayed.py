"""Small systems with delays, shared by the tests."""

import jax.numpy as jnp

import hybrid as hy


def scalar(truth):
    """The scalar equation of a ``Truth`` as a model."""

    class Equation(hy.Automaton):
        y = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s, past):
            return (truth.field(jnp, t, s.y, lambda lag: past(lag).y),)

    return Equation()


class Lagged(hy.Automaton):
    """``y' = -k y(t - tau)``."""

    y = hy.state()
    k = hy.parameter(1.0)
    tau = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return (-self.k * past(self.tau).y,)


class Kicked(Lagged):
    """The same, raised by ``kick`` at the time ``at``."""

    at = hy.parameter(0.5)
    kick = hy.parameter(2.0)

    @hy.edge("flow", to="flow", guard=lambda self, t, s: self.at - t)
    def raised(self, t, s):
        return s.replace(y=s.y + self.kick)


class Pyragas(hy.Automaton):
    """A bead above a wall, driven by what it did a lag ago."""

    x = hy.state()
    v = hy.state()
    C = hy.parameter(-30.0)
    tau = hy.parameter(1.0)
    r = hy.parameter(0.6)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, -(s.x**3) - jnp.cos(s.v) + self.C * (past(self.tau).x - s.x)

    wall = hy.contact("flight", gap=lambda self, t, s: s.x - 2.0, restitution="r")


class Ball(hy.Automaton):
    """``y'' = -g + k y(t - tau)`` above the ground."""

    y = hy.state()
    v = hy.state()
    g = hy.parameter(1.0)
    k = hy.parameter(38.0)
    tau = hy.parameter(1.0)
    r = hy.parameter(0.1)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, -self.g + self.k * past(self.tau).y

    ground = hy.contact("flight", gap=lambda self, t, s: s.y, restitution="r")
