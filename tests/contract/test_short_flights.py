"""Flights of no length to speak of, near an accumulation: none is lost, none goes on unchanged."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import SOLVERS, later

WAYS = ["DOP853", "taylor", "ensemble", "as_function", *later("Dopri8")]

#: Of a few float operations at each of many impacts, and of solvers at 1e-10. (An implicit method
#: loses its tolerance divided by the speed, in the time of a slow flight.)
CLOSE = 1e-9


class Turns(hy.Automaton):
    """A ball with two edges on one guard that take turns, and one that ends the run."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)
    r1 = hy.parameter(0.5)
    r2 = hy.parameter(0.6)
    most = hy.parameter(30)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.v, -2.0

    last = hy.edge(
        fly,
        to=hy.TERMINATE,
        guard=lambda self, t, s: s.x,
        when=lambda self, t, s: s.n >= self.most,
    )

    @hy.edge(fly, guard=lambda self, t, s: s.x, when=lambda self, t, s: s.n % 2 == 0)
    def even(self, t, s):
        return s.replace(x=0.0, v=-self.r1 * s.v, n=s.n + 1)

    @hy.edge(fly, guard=lambda self, t, s: s.x, when=lambda self, t, s: s.n % 2 == 1)
    def odd(self, t, s):
        return s.replace(x=0.0, v=-self.r2 * s.v, n=s.n + 1)


@pytest.mark.parametrize(
    ("r1", "r2"), [(0.206443, 0.816867), (0.0980686, 0.122141), (0.544023, 0.184625), (0.86, 0.05)]
)
def test_edges_that_take_turns_on_one_guard_lose_no_impact(way, r1, r2):
    """Flight n takes the time v_n, from v_0 = 1: the last of them are shorter than the time can
    tell, and far lower than the rounding of heights seen before."""
    speeds = np.cumprod([1.0, *np.tile([r1, r2], 15)])
    run = way.run(Turns(r1=r1, r2=r2), {"x": 0.0, "v": 1.0}, (0.0, 50.0), rtol=1e-10)
    assert run.status == "terminated"
    assert abs(run.t - speeds.sum()) < CLOSE


@pytest.mark.parametrize("solver", ["DOP853", "taylor"])
def test_an_edge_with_a_condition_does_not_let_the_ball_through(solver):
    """The condition holds at every impact, and no mode says what follows their accumulation."""

    class Guarded(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode(initial=True)
        def fly(self, t, s):
            return s.v, -2.0

        @hy.edge(fly, guard=lambda self, t, s: s.x, when=lambda self, t, s: s.v < 1.0)
        def back(self, t, s):
            return s.replace(x=0.0, v=-0.8 * s.v)

    with pytest.raises(hy.JumpLoopError, match=r"t = (5\.0000|4\.9999).*no time to speak of"):
        hy.simulate(Guarded(), {"x": 0.0, "v": 1.0}, (0.0, 6.0), **SOLVERS[solver])


FLOORS = {
    "rises": lambda a, t: jnp.maximum(t - a.tc, 0.0),
    "drops": lambda a, t: jnp.where(t > a.tc, -0.1, 0.0),
    "sinks": lambda a, t: -jnp.where(t > a.tc, t - a.tc, 0.0),
}

G, R, LIMIT, END = 10.0, 0.8, 4.0, 4.05


def floored(floor):
    class Floored(hy.Automaton):
        x = hy.state()
        v = hy.state()
        tc = hy.parameter(3.999)

        @hy.mode
        def flight(self, t, s):
            return s.v, -G

        c = hy.contact(flight, gap=lambda self, t, s: s.x - FLOORS[floor](self, t), restitution=R)

    return Floored


MODELS = {floor: floored(floor) for floor in FLOORS}


def flown(floor, tc):
    """Height and speed at ``END``: impacts on the floor at rest to ``tc``, then what follows. The
    ball leaves the floor at speed 4, and each flight takes v / 5."""
    t, v = 0.0, 4.0
    while t + v / 5.0 <= tc:
        t, v = t + v / 5.0, R * v
    s = tc - t
    x, v, t = v * s - 5.0 * s * s, v - G * s, tc
    speed = {"rises": 1.0, "sinks": -1.0, "drops": 0.0}[floor]
    u, gap = v - speed, x + (0.1 if floor == "drops" else 0.0)
    while True:  # in the frame of the floor
        s = (u + np.sqrt(u * u + 2.0 * G * gap)) / G
        if t + s > END:
            s = END - t
            x = gap + u * s - 5.0 * s * s
            height = {"rises": END - tc, "sinks": tc - END, "drops": -0.1}[floor]
            return x + height, u - G * s + speed
        t, gap, u = t + s, 0.0, -R * (u - G * s)


@pytest.mark.parametrize("floor", list(FLOORS))
@pytest.mark.parametrize("before", [1e-2, 1e-3, 1.3e-4, 1e-5, 1.7e-7, 1e-8])
def test_a_floor_that_moves_shortly_before_the_limit_strikes_the_ball(way, floor, before):
    """A flight carries its gap as a coordinate of its own; where the floor begins to move in it,
    gap speed or gap change at once."""
    x, v = flown(floor, LIMIT - before)
    run = way.run(MODELS[floor](tc=LIMIT - before), {"x": 0.0, "v": 4.0}, (0.0, END), rtol=1e-10)
    assert abs(run.final.x - x) < 1e-8  # the corner is met to 1e-10 of the time, at slope 1
    assert abs(run.final.v - v) < 1e-7  # and the gap there to the root of what that leaves


class OnSignal(hy.Automaton):
    x = hy.state()
    v = hy.state()
    g = hy.parameter(9.81)
    r = hy.parameter(0.7)
    h = hy.signal()

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    c = hy.contact(flight, gap=lambda self, t, s: s.x - self.h(t), restitution="r")


@pytest.mark.parametrize("seed", range(12))
def test_a_floor_that_begins_to_move_at_a_knot_throws_the_body_off(seed):
    """The end of an arc at rest, its beginning and its length added, may lie beyond the knot by two
    roundings: what holds the body is that before it."""
    draw = np.random.default_rng(seed)
    g, r, w = draw.uniform(3.0, 15.0), draw.uniform(0.2, 0.9), draw.uniform(0.5, 4.0)
    limit = 2.0 * w / g / (1.0 - r)
    for _ in range(12):
        tc, k = limit + 10.0 ** draw.uniform(-4.0, 0.5), draw.uniform(0.3, 2.0)
        knots = [0.0, tc, tc + 2.0]
        model = OnSignal(g=g, r=r, h=(knots, [0.0, 0.0, 2.0 * k]))
        after = draw.uniform(0.0, 1.0) * 2.0 * r * k / g  # within the flight that follows
        for solver in ("taylor", "scipy"):
            run = hy.simulate(model, {"x": 0.0, "v": w}, (0.0, tc + after), solver=solver)
            expected = (1.0 + r) * k * after - 0.5 * g * after * after
            assert abs(run.final.x - expected) < 1e-7  # of SciPy's tolerance, 1e-8


class Faster(hy.Automaton):
    """A clock hand that goes twice as fast each time round: rounds accumulate at t = 2, and the
    speed has no limit."""

    c = hy.state()
    w = hy.state()
    q = hy.parameter(2.0)

    @hy.mode(initial=True)
    def turns(self, t, s):
        return s.w, 0.0

    @hy.edge(turns, guard=lambda self, t, s: 1.0 - s.c)
    def tick(self, t, s):
        return s.replace(c=0.0, w=self.q * s.w)


@pytest.mark.parametrize("q", [1.1, 2.0, 3.0])
def test_rounds_that_become_shorter_than_the_time_can_tell_are_not_passed(way, q):
    limit = q / (q - 1.0)
    run = way.run(Faster(q=q), {"c": 0.0, "w": 1.0}, (0.0, 1.05 * limit), max_jumps=5000)
    assert run.status != "reached_end"
    before = way.run(Faster(q=q), {"c": 0.0, "w": 1.0}, (0.0, 0.9 * limit))
    assert before.status == "reached_end"
    assert 0.0 <= before.final.c <= 1.0


class Shared(hy.Automaton):
    """An oscillator whose reset multiplies what its guard is made of."""

    x = hy.state()
    v = hy.state()
    share = hy.parameter(0.5)

    @hy.mode
    def swing(self, t, s):
        return s.v, -s.x

    @hy.edge(swing, to=swing, guard=lambda self, t, s: s.x, crossing=hy.RISING)
    def kick(self, t, s):
        return s.replace(x=self.share * s.x, v=0.9 * s.v)


@pytest.mark.parametrize("share", [-100.0, -0.5, 0.5, 1.0])
@pytest.mark.parametrize("x", [-1e-20, -4e-34, 0.0])
def test_a_guard_shorter_away_than_the_time_can_tell_is_not_set_off_by_sharing_it(way, share, x):
    """The event comes at once; of the state, which is off the guard still, a share is left."""
    run = way.run(Shared(share=share), [x, 1.0], (0.0, 14.0))
    assert run.jumps == 3
    assert abs(run.final.x - 0.9**3 * np.sin(14.0)) < 1e-6  # of SciPy's tolerance, 1e-8
