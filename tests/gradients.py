"""Derivatives of runs against differences of runs: random scenes, and how they are compared."""

from __future__ import annotations

from collections import Counter

import attrs
import jax.numpy as jnp
import numpy as np

import hybrid as hy
from hybrid.functions.batch import Gradients
from hybrid.functions.function import OUTPUTS, runs_of
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.hard_spring import HardSpring
from models.pyragas import Pyragas
from models.relay import Relay
from tests import delayed
from tests.systems import Drag, ForcedOscillator


class Belt(hy.Automaton):
    """A body on a belt whose friction falls with the speed of slip, and a periodic force."""

    x = hy.state()
    v = hy.state()
    speed = hy.parameter(0.5)
    falls = hy.parameter(3.0)
    force = hy.parameter(0.1)
    w = hy.parameter(1.3)

    def pulled(self, t, s):
        return self.force * jnp.sin(self.w * t) - s.x

    @hy.mode(initial=True)
    def slower(self, t, s):
        return s.v, self.pulled(t, s) + 1 / (1 + self.falls * (self.speed - s.v))

    @hy.mode
    def faster(self, t, s):
        return s.v, self.pulled(t, s) - 1 / (1 + self.falls * (s.v - self.speed))

    friction = hy.switching(faster, slower, surface=lambda self, t, s: s.v - self.speed)


class Kicked(hy.Automaton):
    """Resets and guards that depend on time, state and parameters, two modes."""

    x = hy.state()
    y = hy.state()
    high = hy.parameter(1.0)
    low = hy.parameter(-0.5)
    kick = hy.parameter(np.array([0.3, 0.2]))

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0 + 0.3 * jnp.sin(t), s.x - 0.5 * s.y

    @hy.mode
    def down(self, t, s):
        return -0.7 - 0.2 * s.y, -s.x

    @hy.edge(up, to=down, guard=lambda self, t, s: self.high + 0.1 * jnp.sin(3 * t) - s.x)
    def over(self, t, s):
        return s.x - self.kick[0] * s.y**2, s.y + self.kick[1] * t

    @hy.edge(down, to=up, guard=lambda self, t, s: s.x - self.low * jnp.exp(-0.1 * s.y**2))
    def under(self, t, s):
        return s.x, self.kick[1] * s.x - s.y


class Gusts(hy.Automaton):
    """A ball in a force that is switched by the time and in a layer, and by its speed."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.6)
    begins = hy.parameter(0.7)
    top = hy.parameter(0.6)
    push = hy.parameter(4.0)

    @hy.mode
    def fly(self, t, s):
        wind = jnp.where(t > self.begins, self.push, 0.0)
        layer = jnp.where((s.x < self.top) & (s.v > 0.3), -2.0, 0.0)
        return s.v, wind + layer - 9.81

    impact = hy.contact(fly, gap=lambda self, t, s: s.x, restitution="r")


class Thrown(hy.Automaton):
    """A body that rests on a floor until a force is switched on, by time."""

    x = hy.state()
    v = hy.state()
    begins = hy.parameter(1.5)
    lift = hy.parameter(12.0)
    r = hy.parameter(0.3)

    @hy.mode
    def fly(self, t, s):
        return s.v, jnp.where(t > self.begins, self.lift, 0.0) - 9.81

    impact = hy.contact(fly, gap=lambda self, t, s: s.x, restitution="r")


class Pool(hy.Automaton):
    """A ball on a floor between two walls, and impacts whose law depends on the speed."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()
    soft = hy.parameter(0.05)
    r = hy.parameter(0.5)
    width = hy.parameter(3.0)
    drag = hy.parameter(0.1)

    @hy.mode
    def flight(self, t, s):
        return s.u, s.w, -self.drag * s.u, -9.81

    floor = hy.contact(
        flight,
        gap=lambda self, t, s: s.y + 0.05 * s.x**2,
        restitution=lambda self, t, s, u: self.r * jnp.exp(-self.soft * u**2),
    )
    wall = hy.contact(flight, gap=lambda self, t, s: self.width - s.x, restitution="r")
    back = hy.contact(flight, gap=lambda self, t, s: s.x + self.width, restitution="r")


class Powers(hy.Automaton):
    """Powers and quotients of parameters, and a mass that is one."""

    x = hy.state()
    v = hy.state()
    p = hy.parameter(1.5)
    m = hy.parameter(2.0)
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -((s.x + 1.0) ** self.p) / self.m - jnp.maximum(s.v, 0.0)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 0.1 * self.m, restitution="r")


class Rubbed(hy.Automaton):
    """A ball in the air of a constant drag: the force turns at the top of each flight."""

    x = hy.state()
    v = hy.state()
    c = hy.parameter(2.0)
    r = hy.parameter(0.7)

    @hy.mode
    def fly(self, t, s):
        return s.v, -9.81 - self.c * jnp.sign(s.v)

    impact = hy.contact(fly, gap=lambda self, t, s: s.x, restitution="r")


class Corner(hy.Automaton):
    """A body pressed into a corner that is not square, of a bent floor and a wall."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()
    a = hy.parameter(2.0)
    lean = hy.parameter(0.3)
    r = hy.parameter(0.5)
    bend = hy.parameter(0.1)

    @hy.mode
    def fly(self, t, s):
        return s.u, s.w, self.a * (1 + 0.2 * jnp.sin(3 * t)), -9.81

    floor = hy.contact(fly, gap=lambda self, t, s: s.y - self.bend * jnp.sin(s.x), restitution="r")
    wall = hy.contact(fly, gap=lambda self, t, s: 1.0 - s.x - self.lean * s.y, restitution="r")


class Heavy(hy.Automaton):
    """A body that is heavier one way than the other, on a bent floor."""

    q = hy.state(shape=(2,))
    p = hy.state(shape=(2,))
    m = hy.parameter(np.array([1.0, 0.4]))
    r = hy.parameter(0.6)

    @hy.mode
    def fly(self, t, s):
        return s.p, jnp.array([0.0, -9.81])

    hit = hy.contact(
        fly,
        gap=lambda self, t, s: s.q[1] - 0.2 * s.q[0] ** 2,
        restitution="r",
        inverse_mass=lambda self, t, s: self.m,
    )


class Sampled(hy.Automaton):
    """A cart on a rail, driven by what a controller has seen last, that strikes a wall."""

    x = hy.state()
    v = hy.state()
    u: float = hy.discrete(0.0)
    period = hy.parameter(0.31)
    gain = hy.parameter(1.5)
    wall = hy.parameter(0.8)
    r = hy.parameter(0.6)

    @hy.mode(initial=True)
    def drive(self, t, s):
        return s.v, s.u - 0.2 * s.v

    @hy.edge(drive, to=drive, every="period")
    def look(self, t, s):
        return s.replace(u=-self.gain * s.x - 0.5 * s.v)

    hit = hy.contact(drive, gap=lambda self, t, s: s.x + self.wall, restitution="r")


class Delayed(hy.Automaton):
    """Two lags, a history that need not lead to the start, and kicks that come back."""

    y = hy.state()
    z = hy.state()
    k = hy.parameter(1.0)
    tau = hy.parameter(0.7)
    low = hy.parameter(0.1)

    @hy.mode
    def flow(self, t, s, past):
        return jnp.sin(t) - self.k * past(self.tau).y, 0.2 * past(1.1).y * s.y - past(self.tau).z

    @hy.edge(flow, to=flow, guard=lambda self, t, s: s.y - self.low)
    def kick(self, t, s):
        return s.y + 0.5, s.z - s.y


class Controlled(hy.Automaton):
    """A forced spring before a wall, pulled to where it was, and braked as fast as it was."""

    x = hy.state()
    v = hy.state()
    C = hy.parameter(-2.0)
    D = hy.parameter(0.3)
    tau = hy.parameter(0.4)
    r = hy.parameter(0.7)
    wall = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s, past):
        seen = past(self.tau)
        pull = self.C * (s.x - seen.x) - self.D * seen.v
        return s.v, jnp.cos(2.0 * t) - 4.0 * s.x - s.x**3 + pull

    impact = hy.contact(flight, gap=lambda self, t, s: s.x + self.wall, restitution="r")


class Dropped(hy.Automaton):
    """A ball that the wind lifts where it was, and whose impacts remember how high it was."""

    y = hy.state()
    v = hy.state()
    k = hy.parameter(0.8)
    tau = hy.parameter(0.5)
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -9.81 + self.k * past(self.tau).y

    ground = hy.contact(
        flight,
        gap=lambda self, t, s: s.y,
        restitution=lambda self, t, s, u, past: self.r + 0.1 * past(self.tau).y,
    )


class Fading(hy.Automaton):
    """A lag that depends on the state and on the time, and a kick that is seen through it."""

    y = hy.state()
    z = hy.state()
    lag = hy.parameter(0.4)
    a = hy.parameter(0.1)
    at = hy.parameter(0.5)

    @hy.mode
    def flow(self, t, s, past):
        seen = past(self.lag + self.a * s.z**2 + 0.1 * jnp.sin(t))
        return -seen.y - 0.3 * s.z, seen.y - 0.5 * s.z

    @hy.edge(flow, to=flow, guard=lambda self, t, s: self.at - t)
    def kick(self, t, s):
        return s.y + 0.5 + 0.2 * s.z, s.z


class Sighted(hy.Automaton):
    """Guards, resets and formulas that look back, at what jumps and at what does not."""

    x = hy.state()
    u = hy.state()
    tau = hy.parameter(0.3)
    high = hy.parameter(1.0)
    low = hy.parameter(-0.5)
    gain = hy.parameter(0.6)

    @hy.mode(initial=True)
    def up(self, t, s, past):
        return 1.0 + 0.3 * jnp.sin(t) - 0.2 * past(self.tau).x, jnp.abs(past(self.tau).x) - s.u

    @hy.mode
    def down(self, t, s, past):
        return -0.7 - 0.2 * s.u, jnp.where(past(self.tau).u > 0.25, -s.x, -s.u)

    @hy.edge(up, to=down, guard=lambda self, t, s, past: self.high - past(self.tau).x)
    def over(self, t, s, past):
        return s.x - self.gain * past(self.tau).u, 0.5 * s.u - 0.3

    @hy.edge(down, to=up, guard=lambda self, t, s, past: past(0.2).x - self.low)
    def under(self, t, s):
        return s.x, 0.6 - s.u


class Echoed(hy.Automaton):
    """A jump that another follows when it is seen, and then a third."""

    y = hy.state()
    z = hy.state()
    tau = hy.parameter(0.6)
    at = hy.parameter(0.5)
    push = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flow(self, t, s):
        return -0.3 * s.y, 0.2 * s.y

    @hy.mode
    def seen(self, t, s):
        return -0.1 * s.y, 1.0 - s.z

    @hy.edge(flow, to=flow, guard=lambda self, t, s: self.at - t)
    def up(self, t, s):
        return s.y + self.push, s.z

    @hy.edge(flow, to=seen, guard=lambda self, t, s, past: 0.75 - past(self.tau).y)
    def see(self, t, s, past):
        return s.y, s.z + 0.5 * past(0.2).y


#: By name: the model, and for each number the range from which it is drawn (starts by state).
SCENES = {
    "table": (
        BeadOnTable,
        {"r": (0.2, 0.7), "omega": (3.0, 5.0), "amplitude": (0.7, 1.2), "x": (1.4, 2.0)},
        (0.0, 3.0),
    ),
    "spring": (HardSpring, {"r": (0.3, 0.8), "wall": (1.5, 2.0), "x": (2.1, 2.4)}, (0.0, 2.0)),
    "circle": (BallOnCircle, {"g": (0.8, 1.2), "e": (0.3, 0.6), "q": (0.1, 0.2)}, (0.0, 4.0)),
    "relay": (Relay, {"a": (1.1, 1.6), "w": (1.5, 2.5), "x": (0.2, 0.8)}, (0.0, 6.0)),
    "belt": (Belt, {"speed": (0.4, 0.6), "falls": (2.0, 4.0), "x": (0.0, 0.5)}, (0.0, 9.0)),
    "kicked": (Kicked, {"high": (0.8, 1.2), "low": (-0.7, -0.3), "y": (-0.3, 0.3)}, (0.0, 6.0)),
    "gusts": (Gusts, {"r": (0.5, 0.7), "begins": (0.3, 0.9), "x": (0.9, 1.2)}, (0.0, 2.0)),
    "thrown": (Thrown, {"begins": (1.5, 2.0), "lift": (11.0, 13.0), "x": (0.5, 1.0)}, (0.0, 3.0)),
    "pool": (Pool, {"r": (0.3, 0.6), "u": (2.0, 4.0), "y": (0.5, 1.0)}, (0.0, 2.0)),
    "rubbed": (Rubbed, {"r": (0.4, 0.7), "c": (1.0, 3.0), "v": (0.3, 1.0)}, (0.0, 2.0)),
    "corner": (Corner, {"r": (0.3, 0.5), "y": (0.5, 0.7), "lean": (0.1, 0.4)}, (0.0, 2.0)),
    "heavy": (Heavy, {"r": (0.4, 0.7), "p": (0.1, 0.3), "q": (0.4, 0.6)}, (0.0, 1.5)),
    "sampled": (
        Sampled,
        {"period": (0.29, 0.34), "gain": (1.0, 2.0), "wall": (0.2, 0.5), "x": (0.6, 1.0)},
        (0.0, 4.0),
    ),
    "delayed": (
        Delayed,
        {"k": (0.5, 1.5), "tau": (0.4, 0.9), "y": (0.5, 1.0)},
        (0.0, 4.1),
        {"history": {"y": 0.3, "z": jnp.cos}},
    ),
    "controlled": (
        Controlled,
        {"C": (-2.0, 1.0), "tau": (0.2, 0.5), "r": (0.6, 0.9), "x": (0.5, 1.0)},
        (0.0, 3.0),
    ),
    "restarted": (
        Controlled,
        {"C": (-2.0, 1.0), "tau": (0.2, 0.5), "r": (0.6, 0.9), "x": (0.5, 1.0)},
        (0.0, 3.0),
        {"memory": "restart"},
    ),
    "pyragas": (Pyragas, {"C": (10.0, 60.0), "r": (0.2, 0.4), "x1": (2.3, 2.6)}, (0.0, 3.3)),
    "pyragas again": (
        Pyragas,
        {"C": (-30.0, 10.0), "r": (0.4, 0.6), "x1": (2.3, 2.6)},
        (0.0, 3.3),
        {"memory": "restart"},
    ),
    "dropped": (Dropped, {"k": (0.5, 2.0), "r": (0.3, 0.5), "y": (0.6, 1.0)}, (0.0, 3.0)),
    "fading": (Fading, {"lag": (0.3, 0.5), "a": (0.0, 0.2), "y": (0.5, 1.0)}, (0.0, 2.7)),
    "sighted": (Sighted, {"tau": (0.2, 0.35), "x": (-0.4, -0.1), "u": (0.1, 0.4)}, (0.0, 5.0)),
    "held": (delayed.Held, {"tau": (0.8, 0.95), "y": (0.4, 0.6)}, (0.0, 3.1)),
    "slider": (delayed.Slider, {"x": (0.2, 0.4), "d": (0.0, 0.2)}, (0.0, 3.0)),
    "echoed": (Echoed, {"tau": (0.5, 0.7), "at": (0.4, 0.6), "y": (0.2, 0.4)}, (0.0, 2.0)),
    "powers": (Powers, {"p": (0.8, 2.5), "m": (1.5, 2.5), "x": (0.6, 1.2)}, (0.0, 2.5)),
    "drag": (Drag, {"r": (0.4, 0.8), "c": (0.1, 0.4), "x": (0.5, 1.5)}, (0.0, 2.0)),
    "forced": (ForcedOscillator, {"r": (0.6, 0.9), "w": (2.5, 3.0), "x": (-1.0, -0.5)}, (0.0, 9.0)),
}

#: Least of the step of a difference, against the size of the number.
STEP = 2e-4


@attrs.frozen
class Compared:
    """Derivatives of a scene's run against differences.

    Attributes
    ----------
    off : float
        The largest distance that the differences' own error does not explain, against the size of
        that derivative.
    judged : int
        Derivatives that were compared.
    left : Counter
        Those whose differences say too little, by what they are of and why.
    none : Counter
        Those that are NaN though the differences know one.
    """

    what: str
    off: float
    judged: int
    left: Counter
    none: Counter


def drawn(name, seed):
    """A scene's model, its row of numbers, and what runs it."""
    cls, ranges, (t0, t1), *_ = SCENES[name]
    draw = np.random.default_rng(seed)
    found = {key: draw.uniform(*ends) for key, ends in ranges.items()}
    model = cls(**{k: v for k, v in found.items() if k not in cls.spec.names})
    start = []
    for state in cls.spec.states:
        value = np.full(state.shape, found.get(state.name, 0.0))
        if name in ("circle", "heavy") and state.name == "q":
            value[1] += 1.05
        start.append(value.reshape(-1))
    given = [np.ravel(getattr(model, p.name)) for p in cls.spec.parameters]
    row = np.concatenate([*given, *start, [t0, t1]]).astype(float)
    return model, row


def compared(name, seed):
    """The derivatives of a scene's run against differences of fourth order."""
    model, row = drawn(name, seed)
    options = dict(*SCENES[name][3:])
    runs = runs_of(model, OUTPUTS, max_jumps=24, max_steps=4096, **options)
    numbers, ints, slopes = Gradients(runs)(row)
    of, by = names(model, runs.layout)
    off, judged, left, none, worst = 0.0, 0, Counter(), Counter(), ""
    for column in range(len(row)):
        step = STEP * max(1.0, abs(row[column]))
        pair = [differences(runs, row, column, s, ints) for s in (step, 0.5 * step)]
        if pair[0] is None or pair[1] is None:
            left[f"all by {by[column]}, runs beside take another course"] += len(numbers)
            continue
        known = np.isfinite(numbers) & (np.arange(len(numbers)) != runs.layout.length - 1)
        size = 1.0 + np.abs(pair[1])
        error = 3.0 * np.abs(pair[0] - pair[1])
        told = known & (error <= 1e-6 * size)
        for place in np.flatnonzero(known & ~told):
            left[f"{of[place]} by {by[column]}, two steps of differences disagree"] += 1
        for place in np.flatnonzero(told & np.isnan(slopes[:, column])):
            none[f"{of[place]} by {by[column]}"] += 1
        far = np.where(told, np.abs(slopes[:, column] - pair[1]) - error, 0.0) / size
        judged += int(np.sum(told))
        place = int(np.nanargmax(far))
        if far[place] > off:
            off, worst = float(far[place]), f"{of[place]} by {by[column]}"
    return Compared(worst, off, judged, left, none)


def names(model, layout):
    """What the numbers are called that a run gives, and those that it is given."""
    sizes = {name: place.stop - place.start for name, place in layout.places.items()}
    of = [name for name, size in sizes.items() for _ in range(size)]
    spec = model.spec
    given = [(p.name, np.size(getattr(model, p.name))) for p in spec.parameters]
    given += [(state.name, int(np.prod(state.shape))) for state in spec.states]
    return of, [name for name, size in [*given, ("t0", 1), ("t1", 1)] for _ in range(size)]


def carried(name, seed):
    """Whether machine code alone carries the derivatives of a scene's run, and how far they are
    from those that are carried along the run's record, against their size."""
    model, row = drawn(name, seed)
    options = dict(*SCENES[name][3:])
    runs = runs_of(model, OUTPUTS, max_jumps=24, max_steps=4096, **options)
    gradients = Gradients(runs)
    together = gradients.together(row[None])
    alone = together is not None and any(len(flown.lanes) for flown, _ in together.changes())
    (*_, slopes), (*_, others) = gradients(row), runs.slopes(row)
    known = np.isfinite(others)
    assert np.array_equal(known, np.isfinite(slopes))
    size = 1.0 + np.abs(others[known])
    return alone, float(np.max(np.abs(slopes[known] - others[known]) / size, initial=0.0))


def differences(runs, row, column, step, ints):
    """The derivative by one number; None where the runs beside take another course."""
    ends = {}
    for k in (-2, -1, 1, 2):
        moved = row.copy()
        moved[column] += k * step
        ends[k], other = runs.values(moved)
        if not np.array_equal(other, ints):
            return None
    return (8 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12 * step)
