"""Events at one time, and limits at the time of another event, where the steps of a method have
lost more than rounding: a tie is a tie on every solver."""

import functools
import math

import numpy as np
import pytest

import hybrid as hy

from .contract.ways import spread

#: Methods with errors, and tolerances.
METHODS = [
    ("scipy", "DOP853", 1e-8),
    ("scipy", "DOP853", 1e-5),
    ("scipy", "Radau", 1e-9),
    ("diffrax", "Tsit5", 1e-8),
]

#: Declared orders: a wall, a clock, a guard on a state that counts the time, and one on another
#: oscillator.
ORDERS = ["wk", "kw", "wc", "cw", "yk", "cyk", "wkyc", "kcyw"]


@functools.cache
def swings(order):
    """Oscillators whose events come together after half a turn, declared in an order."""

    class Swings(hy.Automaton):
        """One has a wall in the middle, and is kicked; the other swings ``k`` times as fast."""

        x = hy.state()
        v = hy.state()
        c = hy.state()
        n = hy.state()
        y = hy.state()
        w = hy.state()
        k = hy.parameter(3.0)
        rate = hy.parameter(1.0)
        half = hy.parameter(math.pi)

        @hy.mode(initial=True)
        def f(self, t, s):
            w2 = self.rate**2
            return s.v, -w2 * s.x, self.rate, 0.0, s.w, -w2 * self.k**2 * s.y

        for name in order:
            if name == "w":
                wall = hy.contact(f, gap=lambda self, t, s: s.x, restitution=0.5)
            elif name == "k":

                @hy.edge(f, to=f, every="half", offset="half")
                def tick(self, t, s):
                    return s.replace(v=2.0 * s.v, n=2.0 * s.n + 1.0)

            elif name == "c":

                @hy.edge(f, to=f, guard=lambda self, t, s: math.pi - s.c)
                def turn(self, t, s):
                    return s.replace(c=0.0, v=1.5 * s.v, n=3.0 * s.n + 2.0)

            else:

                @hy.edge(f, to=f, guard=lambda self, t, s: s.y, crossing=hy.EITHER)
                def cross(self, t, s):
                    return s.replace(v=0.75 * s.v, n=5.0 * s.n + 3.0)

    return Swings


@pytest.mark.parametrize(
    ("order", "solver", "scale"), spread(ORDERS, METHODS, [(1.0, 1.0), (1e4, 1e-3)]), ids=str
)
def test_of_what_is_at_one_time_the_first_declared_fires(order, solver, scale):
    """As by Taylor series, which lose no more than rounding."""
    (by, method, rtol), (size, rate) = solver, scale
    model = swings(order)(rate=rate, half=math.pi / rate)
    start = {"x": 0.0, "v": size * rate, "c": 0.0, "n": 0.0, "y": 0.0, "w": size * rate}
    span = (0.0, 10.0 / rate)
    exact = hy.simulate(model, start, span, solver="taylor")
    atol = rtol * size
    run = hy.simulate(model, start, span, solver=by, method=method, rtol=rtol, atol=atol)
    assert list(run.jumps.edge) == list(exact.jumps.edge)
    assert run.final.n == exact.final.n
    # a hundred steps lose a tolerance each, which kicks double in three half turns
    allowed = 1e3 * rtol * size
    assert run.final.x == pytest.approx(exact.final.x, abs=allowed)
    assert run.final.v == pytest.approx(exact.final.v, abs=allowed * rate)


@pytest.mark.parametrize(
    ("order", "edges"),
    [
        ("wkc", ["wall", "tick", "turn"]),
        ("kcw", ["tick", "turn", "wall"]),
        ("ykcw", ["cross", "tick", "turn", "wall"]),
    ],
)
@pytest.mark.parametrize(("size", "rate"), [(1.0, 1.0), (1e-5, 1.0), (1e6, 1e5), (1e-6, 1e-4)])
def test_the_order_does_not_depend_on_units(order, edges, size, rate):
    """A state that is zero has the rounding of what it was: a wall, a clock, a guard on a state
    that counts the time, and on another motion, at each half turn, of which that one has three."""
    model = swings(order)(rate=rate, half=math.pi / rate)
    start = {"x": 0.0, "v": size * rate, "c": 0.0, "n": 0.0, "y": 0.0, "w": size * rate}
    run = hy.simulate(model, start, (0.0, 10.0 / rate), solver="taylor")
    turn = ["cross", "cross", *edges] if "cross" in edges else edges
    assert list(run.jumps.edge) == 3 * turn


@pytest.mark.parametrize(("by", "method", "rtol"), METHODS)
@pytest.mark.parametrize("apart", [1e-2, -1e-2])
def test_what_is_no_tie_fires_in_order(by, method, rtol, apart):
    """A clock that is off the wall by far more than the tolerances, on either side."""
    model = swings("wk")(half=math.pi + apart)
    start = {"x": 0.0, "v": 1.0, "c": 0.0, "n": 0.0, "y": 0.0, "w": 1.0}
    run = hy.simulate(model, start, (0.0, 4.0), solver=by, method=method, rtol=rtol)
    assert list(run.jumps.edge) == (["wall", "tick"] if apart > 0 else ["tick", "wall"])


class Falls(hy.Automaton):
    """A ball that falls through air."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)
    drag = hy.parameter(0.1)

    @hy.mode(initial=True)
    def f(self, t, s):
        return s.v, -1.0 - self.drag * s.v

    floor = hy.contact(f, gap=lambda self, t, s: s.x, restitution="r")


class Kicked(hy.Automaton):
    """The same, thrown up by a clock."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)
    drag = hy.parameter(0.1)
    period = hy.parameter(1.0)

    @hy.mode(initial=True)
    def f(self, t, s):
        return s.v, -1.0 - self.drag * s.v

    floor = hy.contact(f, gap=lambda self, t, s: s.x, restitution="r")

    @hy.edge(f, to=f, every="period", offset="period")
    def tick(self, t, s):
        return s.replace(v=s.v + 1.0)


class Fanned(hy.Automaton):
    """The same under a signal."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)
    drag = hy.parameter(0.1)
    fan = hy.signal()

    @hy.mode(initial=True)
    def f(self, t, s):
        return s.v, -1.0 - self.drag * s.v + self.fan(t)

    floor = hy.contact(f, gap=lambda self, t, s: s.x, restitution="r")


LIMITED = [("taylor", None), ("scipy", "DOP853"), ("scipy", "Radau"), ("diffrax", "Tsit5")]


@pytest.mark.parametrize(
    ("solver", "where", "ball"),
    spread(LIMITED, ["end", "clock", "knot"], [(0.5, 0.1), (0.8, 0.1), (0.5, 0.7), (0.8, 0.7)]),
    ids=str,
)
def test_a_limit_at_the_time_of_another_event_is_listed(solver, where, ball):
    """At the end of the run, at a clock's time and at a knot; its bound holds there, too."""
    (by, method), (r, drag) = solver, ball
    start, given = {"x": 1.0, "v": 0.0}, {"r": r, "drag": drag}
    limit = hy.simulate(Falls(**given), start, (0.0, 40.0), solver="taylor").zeno[0].t
    if where == "end":
        model, last = Falls(**given), limit
    elif where == "clock":
        model, last = Kicked(period=limit, **given), 1.2 * limit
    else:
        model = Fanned(fan=([0.0, limit, 2.0 * limit], [0.0, 0.0, 0.5]), **given)
        last = 1.2 * limit
    run = hy.simulate(model, start, (0.0, last), solver=by, method=method)
    (point, *_) = run.zeno
    assert abs(point.t - limit) <= point.t_error < 1e-6
    assert np.all(np.diff(run.jumps.t) >= 0.0)
    times = [jump.t for jump in run.jumps if jump.edge == "tick"]
    assert times == ([limit] if where == "clock" else [])


class Counting(hy.Automaton):
    """A ball, and an event at a time, declared after the contact, that throws it up."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    r: float = hy.parameter(0.5)
    at: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -14.2, 1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")

    @hy.edge(flight, guard=lambda self, t, s: self.at - s.y)
    def kick(self, t, s):
        return s.replace(y=s.y - 10.0, v=s.v + 1.0)


@pytest.mark.parametrize("solver", ["scipy", "diffrax", "taylor"])
@pytest.mark.parametrize("before", [1e-10, 1e-11, 4e-12, 2e-12, -2e-12, -1e-11])
@pytest.mark.parametrize("r", [0.5, 0.57, 0.7])
def test_events_of_a_polynomial_are_told_apart(r, before, solver):
    """A state near zero has not lost more for being small."""
    fall = math.sqrt(2 * 1.85 / 14.2)
    model = Counting(r=r, at=fall * (1.0 + 2.0 * r) - before)
    options = {"solver": solver, "rtol": 1e-10, "atol": 1e-12}
    run = hy.simulate(model, {"x": 1.85, "v": 0.0, "y": 0.0}, (0.0, 6.0), **options)
    edges = [row.edge for row in run.jumps]
    assert edges.index("kick") == (1 if before > 0.0 else 2)
