"""Small systems with switchings, most of them with known solutions."""

import jax.numpy as jnp
import numpy as np

import hybrid as hy


class Planar(hy.Automaton):
    """Two flows in the plane on the two sides of ``y = 0``, as a subclass says."""

    x = hy.state()
    y = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0, -2.0

    @hy.mode
    def down(self, t, s):
        return -s.x, 1.0

    line = hy.switching(up, down, surface=lambda self, t, s: s.y)


class Apart(Planar):
    """Both flows lead away from the line."""

    @hy.mode(initial=True)
    def up(self, t, s):
        return 0.0, 1.0

    @hy.mode
    def down(self, t, s):
        return 0.0, -1.0


class Fold(Planar):
    """The upper flow touches the line from above at the origin, and sinks below it."""

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0, -s.x

    @hy.mode
    def down(self, t, s):
        return 0.0, 1.0


class TwoFold(Fold):
    """Both flows touch the line at the origin: no first derivative says how it slides."""

    @hy.mode
    def down(self, t, s):
        return 1.0, s.x


class Rings(Planar):
    """Spirals onto the unit circle: from outside at angular speed 1, from inside at 2."""

    @hy.mode(initial=True)
    def up(self, t, s):
        return -s.x - s.y, s.x - s.y

    @hy.mode
    def down(self, t, s):
        return s.x - 2 * s.y, 2 * s.x + s.y

    line = hy.switching("up", "down", surface=lambda self, t, s: s.x**2 + s.y**2 - 1)


class Pursuit(hy.Automaton):
    """``x' = -+1`` towards a target ``2 sin t``, which is faster than that at times."""

    x = hy.state()

    @hy.mode(initial=True)
    def above(self, t, s):
        return -1.0

    @hy.mode
    def below(self, t, s):
        return 1.0

    target = hy.switching(above, below, surface=lambda self, t, s: s.x - 2 * jnp.sin(t))


class Timed(hy.Automaton):
    """A relay that slides at once, with a clock; edges leave one of its modes, or sliding."""

    x = hy.state()
    clock = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return -1.0, 1.0

    @hy.mode
    def down(self, t, s):
        return 1.0, 1.0

    @hy.mode
    def off(self, t, s):
        return 3.0, 1.0

    relay = hy.switching(up, down, surface=lambda self, t, s: s.x)

    @hy.edge(down, to=off, guard=lambda self, t, s: 2.0 - s.clock)
    def alarm(self, t, s):
        return s


class Relieved(Timed):
    """An edge declared from the sliding mode itself comes before the alarm."""

    @hy.edge("slide(relay)", to="off", guard=lambda self, t, s: 1.5 - s.clock)
    def relief(self, t, s):
        return s.replace(x=s.x + 7.0)


class Quadrants(hy.Automaton):
    """Relays in ``x`` and ``y``, each side of each line a mode of its own."""

    x = hy.state()
    y = hy.state()

    @hy.mode(initial=True)
    def north_east(self, t, s):
        return -1.0, -1.0

    @hy.mode
    def north_west(self, t, s):
        return 1.0, -1.0

    @hy.mode
    def south_east(self, t, s):
        return -1.0, -2.0

    @hy.mode
    def south_west(self, t, s):
        return 1.0, -2.0

    north = hy.switching(north_east, north_west, surface=lambda self, t, s: s.x)
    east = hy.switching(north_east, south_east, surface=lambda self, t, s: s.y)


class StickSlip(hy.Automaton):
    """A body on a belt whose friction falls with the speed of slip, and a periodic force."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def slower(self, t, s):
        return s.v, 0.1 * jnp.sin(1.3 * t) - s.x + 1 / (1 + 3 * (0.5 - s.v))

    @hy.mode
    def faster(self, t, s):
        return s.v, 0.1 * jnp.sin(1.3 * t) - s.x - 1 / (1 + 3 * (s.v - 0.5))

    friction = hy.switching(faster, slower, surface=lambda self, t, s: s.v - 0.5)


class Drawn(hy.Automaton):
    """Two linear flows in space on the sides of a curved surface, numbers drawn at random."""

    q = hy.state(shape=(3,))
    A = hy.parameter(np.zeros((2, 3, 3)))
    b = hy.parameter(np.zeros((2, 3)))

    @hy.mode(initial=True)
    def up(self, t, s):
        return (self.A[0] @ s.q + self.b[0] + jnp.sin(t),)

    @hy.mode
    def down(self, t, s):
        return (self.A[1] @ s.q + self.b[1],)

    bent = hy.switching(up, down, surface=lambda self, t, s: s.q[0] + 0.3 * s.q[1] ** 2)
