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


class Step(hy.Automaton):
    """``y`` jumps by ``size`` at 1/2, which ``z`` counts when a guard sees it a lag later.

    The guard is ``sign (y(t - tau) - 1/2)``: it jumps from one side of zero to the other.
    """

    y = hy.state()
    z = hy.state()
    tau = hy.parameter(1.0)
    at = hy.parameter(0.5)

    @hy.mode(initial=True)
    def flow(self, t, s):
        return 0.0, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s: self.at - t, crossing=hy.EITHER)
    def up(self, t, s):
        return s.replace(y=1.0 - s.y)


class Falling(Step):
    """Seen by a guard that falls."""

    @hy.edge("flow", to="seen", guard=lambda self, t, s, past: 0.5 - past(self.tau).y)
    def see(self, t, s):
        return s.replace(z=s.z + 1.0)

    @hy.mode
    def seen(self, t, s):
        return 0.0, 1.0


class Rising(Step):
    """Seen by a guard that rises."""

    @hy.mode
    def seen(self, t, s):
        return 0.0, 1.0

    @hy.edge(
        "flow",
        to=seen,
        guard=lambda self, t, s, past: past(self.tau).y - 0.5,
        crossing=hy.RISING,
    )
    def see(self, t, s):
        return s.replace(z=s.z + 1.0)


class Either(Step):
    """Seen by a guard that changes its sign."""

    @hy.mode
    def seen(self, t, s):
        return 0.0, 1.0

    @hy.edge(
        "flow",
        to=seen,
        guard=lambda self, t, s, past: past(self.tau).y - 0.5,
        crossing=hy.EITHER,
    )
    def see(self, t, s):
        return s.replace(z=s.z + 1.0)


class Touching(hy.Automaton):
    """``y`` falls to 1/2 at a breaking point, within rounding on either side of it."""

    y = hy.state()
    z = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return -0.5 * past(1.0).y, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s: s.y - 0.5, crossing=hy.EITHER)
    def through(self, t, s):
        return s.replace(z=s.z + 1.0)


class Echo(hy.Automaton):
    """A ball whose restitution is 0.5 and a tenth of its height a lag ago."""

    y = hy.state()
    v = hy.state()
    tau = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -1.0

    ground = hy.contact(
        flight,
        gap=lambda self, t, s: s.y,
        restitution=lambda self, t, s, u, past: 0.5 + 0.1 * past(self.tau).y,
    )


class Recalled(hy.Automaton):
    """A reset that puts the state back to where it was a lag ago."""

    y = hy.state()

    @hy.mode(initial=True)
    def line(self, t, s):
        return (1.0,)

    @hy.edge(line, to=line, guard=lambda self, t, s: 2.0 - s.y)
    def back(self, t, s, past):
        return s.replace(y=past(1.5).y)


class Lift(hy.Automaton):
    """A ball above a table whose height is what a weight was a lag ago."""

    w = hy.state()
    y = hy.state()
    v = hy.state()
    lag = hy.parameter(1.0)
    feels = hy.parameter(0.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return 0.1 + self.feels * s.y, s.v, -1.0

    table = hy.contact(
        "flight", gap=lambda self, t, s, past: s.y - past(self.lag).w, restitution=0.5
    )


class Ramps(hy.Automaton):
    """A ball above a floor whose height is what a weight was a lag ago, which clocks give other
    speeds."""

    y, v, w, u = hy.state(), hy.state(), hy.state(), hy.state()
    lag, r = hy.parameter(0.3), hy.parameter(0.5)
    first, second, third = hy.parameter(1.0), hy.parameter(2.0), hy.parameter(3.0)
    one, two, three = hy.parameter(0.0), hy.parameter(0.0), hy.parameter(0.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -4.0, s.u, 0.0

    floor = hy.contact(flight, gap=lambda self, t, s, past: s.y - past(self.lag).w, restitution="r")

    @hy.edge(flight, at=("first",))
    def turns(self, t, s):
        return s.replace(u=self.one)

    @hy.edge(flight, at=("second",))
    def turns_again(self, t, s):
        return s.replace(u=self.two)

    @hy.edge(flight, at=("third",))
    def turns_last(self, t, s):
        return s.replace(u=self.three)


class Held(hy.Automaton):
    """A body on the ground that a switch, thrown at 1/2, lifts a lag later."""

    u = hy.state()
    y = hy.state()
    v = hy.state()
    tau = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return 0.0, s.v, past(self.tau).u - 1.0

    @hy.edge(flight, to=flight, guard=lambda self, t, s: 0.5 - t, crossing=hy.EITHER)
    def on(self, t, s):
        return s.replace(u=3.0)

    ground = hy.contact("flight", gap=lambda self, t, s: s.y, restitution=0.5)


class Relay(hy.Automaton):
    """``y' = -sign(y(t - tau))``: each zero of ``y`` turns it around a lag later."""

    y = hy.state()
    tau = hy.parameter(1.0)

    @hy.mode(initial=True)
    def down(self, t, s):
        return (-1.0,)

    @hy.mode
    def up(self, t, s):
        return (1.0,)

    @hy.edge(down, to=up, guard=lambda self, t, s, past: past(self.tau).y)
    def low(self, t, s):
        return s

    @hy.edge(up, to=down, guard=lambda self, t, s, past: past(self.tau).y, crossing=hy.RISING)
    def high(self, t, s):
        return s


class Slider(hy.Automaton):
    """``x' = d(t - 1) - k sign x`` and ``d' = c``: it slides on ``x = 0`` until ``d`` is large."""

    x = hy.state()
    d = hy.state()

    @hy.mode(initial=True)
    def above(self, t, s, past):
        return past(1.0).d - 1.0, 1.0

    @hy.mode
    def below(self, t, s, past):
        return past(1.0).d + 1.0, 1.0

    zero = hy.switching(above, below, surface=lambda self, t, s: s.x)
