"""Limits of two bodies that do not act on each other, close to each other in time.

The impacts of one come between those of the other. Over a floor that is not at zero the last
flights are lower than the rounding of the position, and the limit is known to that only.
"""

import itertools

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import hybrid as hy

GRAVITY = 8.0


class TwoBalls(hy.Automaton):
    """Two balls beside each other, on floors of their own."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    r: float = hy.parameter(0.5)
    q: float = hy.parameter(0.5)
    floor: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -GRAVITY, s.w, -GRAVITY

    one = hy.contact(flight, gap=lambda self, t, s: s.x - self.floor, restitution="r")
    two = hy.contact(flight, gap=lambda self, t, s: s.y - 2.0, restitution="q")


def limit(height, r):
    """When a ball that falls from a height comes to rest, in 40 digits."""
    with mpmath.workdps(40):
        height, r = mpmath.mpf(height), mpmath.mpf(r)
        return mpmath.sqrt(2 * height / GRAVITY) * (1 + r) / (1 - r)


def fallen(start, floor, r, t):
    """Position and speed of such a ball at a time."""
    with mpmath.workdps(40):
        height = mpmath.mpf(start) - mpmath.mpf(floor)
        begun, v = -mpmath.sqrt(2 * height / GRAVITY), mpmath.sqrt(2 * height * GRAVITY)
        while v > 1e-25:
            s = t - begun
            if s < 2 * v / GRAVITY:
                return floor + v * s - GRAVITY * s**2 / 2, v - GRAVITY * s
            begun, v = begun + 2 * v / GRAVITY, mpmath.mpf(r) * v
        return mpmath.mpf(floor), mpmath.mpf(0)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("later", [1e-3, -1e-5, 1e-6, -1e-7, 1e-8, -1e-10, 1e-11, -1e-13])
@pytest.mark.parametrize(
    ("r", "q", "floor"), [(0.61, 0.68, 1.0), (0.5, 0.25, 1.0), (0.3, 0.8, 0.0)]
)
def test_both_limits_are_listed(r, q, floor, later, solver):
    """Each within its bound; where a position hides both they may be one accumulation."""
    first = float(limit(1.0, r)) + later
    y = 2.0 + 0.5 * GRAVITY * (first * (1.0 - q) / (1.0 + q)) ** 2
    limits = {"one": limit(1.0, r), "two": limit(mpmath.mpf(y) - 2, q)}
    start = {"x": 1.0 + floor, "v": 0.0, "y": y, "w": 0.0}
    run = hy.simulate(TwoBalls(r=r, q=q, floor=floor), start, (0.0, 4.0), solver=solver)
    balls = (1.0 + floor, floor, r), (y, 2.0, q)
    for name, exact in limits.items():
        (point,) = (point for point in run.zeno if name in point.edges)
        there = [number for ball in balls for number in fallen(*ball, exact)]
        for state, own in zip("xvyw", there, strict=True):
            off = abs(own - mpmath.mpf(float(point.state[state])))
            assert off <= float(point.state_error[state]) + 1e-15  # positions are rounded to that
        assert abs(mpmath.mpf(point.t) - exact) <= point.t_error
        # what rounding hides of a height of 4 lasts for about 1e-6; next to 1e-12 the runs that are
        # compared may see the two in another order, and there is no bound
        assert point.t_error < 1e-5 or abs(later) < 1e-9
    assert np.allclose(run.arcs[-1].last, [floor, 0.0, 2.0, 0.0], rtol=0.0, atol=1e-12)
    assert run.mode == "flight.rest(one, two)"


class Shaken(hy.Automaton):
    """A ball on a table that moves up and down."""

    x = hy.state()
    v = hy.state()
    r: float = hy.parameter(0.4)
    high: float = hy.parameter(0.02)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.8

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.high * jnp.sin(4.0 * t), restitution="r"
    )


def test_no_impact_is_listed_behind_the_limit():
    """Not by a spacing: times are rounded once, from two floats."""
    for r, high in np.random.default_rng(1).uniform([0.05, 0.01], [0.5, 0.05], (100, 2)).tolist():
        run = hy.simulate(Shaken(r=r, high=high), {"x": 1.0, "v": 0.0}, (0.0, 1.5), solver="taylor")
        assert all(arc.t0 <= arc.t1 for arc in run.arcs)
        limit = run.zeno[0].t
        assert not np.any((limit < run.jumps.t) & (run.jumps.t < limit + 1e-12))


def switched(crossing):
    """A body that two edges throw back in turn, as its weight changes, beside a ball."""

    class Switched(hy.Automaton):
        x = hy.state()
        v = hy.state()
        y = hy.state()
        w = hy.state()
        r: float = hy.parameter(0.6)
        floor: float = hy.parameter(0.0)

        @hy.mode(initial=True)
        def light(self, t, s):
            return s.v, -6.0, s.w, -4.0

        @hy.mode
        def heavy(self, t, s):
            return s.v, -9.0, s.w, -4.0

        @hy.mode(limit_of=("up", "down"))
        def rest(self, t, s):
            return 0.0 * s.v, 0.0, s.w, -4.0

        one = hy.contact(light, gap=lambda self, t, s: s.y, restitution=0.5)
        two = hy.contact(heavy, gap=lambda self, t, s: s.y, restitution=0.5)
        three = hy.contact(rest, gap=lambda self, t, s: s.y, restitution=0.5)

        @hy.edge(light, to=heavy, guard=lambda self, t, s: s.x - self.floor, crossing=crossing)
        def up(self, t, s):
            return s.replace(v=-self.r * s.v)

        @hy.edge(heavy, to=light, guard=lambda self, t, s: s.x - self.floor, crossing=crossing)
        def down(self, t, s):
            return s.replace(v=-0.3 * s.v)

    return Switched


def both_limits(model, x, later, solver):
    """The accumulations of the body and the ball, with their times: that of the ball is later by a
    share."""
    u, ratio = np.sqrt(12.0 * x), 0.3 * model.r
    limit = u / 6.0 + (2.0 * model.r * u / 9.0 + 2.0 * ratio * u / 6.0) / (1.0 - ratio)
    y = 2.0 * (limit * (1.0 + later) / 3.0) ** 2
    start = {"x": model.floor + x, "v": 0.0, "y": y, "w": 0.0}
    run = hy.simulate(model, start, (0.0, limit + 0.1), solver=solver)
    (own,) = (point for point in run.zeno if "up" in point.edges)
    (ball,) = (point for point in run.zeno if "up" not in point.edges)
    return (own, limit), (ball, limit * (1.0 + later))


#: How much later the ball comes to rest, as a share; restitution and height of the body.
CLOSE = (1e-6, 1e-7, 1e-8, -1e-8, 3e-9)
BODIES = np.random.default_rng(3).uniform([0.3, 0.1], [0.9, 1.0], (2, 2)).tolist()


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("crossing", [hy.FALLING, hy.EITHER])
def test_low_flights_between_edges_end_at_their_own_time(crossing, solver):
    """The flights of the body are lower than the rounding of the largest states seen when the ball
    strikes: its guards are not zero there."""
    for later, (r, x) in itertools.product(CLOSE, BODIES):
        for point, exact in both_limits(switched(crossing)(r=r), x, later, solver):
            assert abs(point.t - exact) <= point.t_error + 1e-15  # the limit is rounded to that
            assert point.t_error < 1e-8  # the order of impacts may not be known to the last


@pytest.mark.long
def test_a_cycle_over_a_floor_off_zero_is_known_to_the_rounding_of_its_guards():
    """The ball strikes while the body is within rounding of its floor at 1: the edge then fires."""
    for later, (r, x) in itertools.product(CLOSE, BODIES):
        for point, exact in both_limits(switched(hy.FALLING)(r=r, floor=1.0), x, later, "taylor"):
            assert abs(point.t - exact) <= point.t_error + 1e-15
            assert point.t_error < 4e-6  # flights as low as the rounding of 1 take 1e-7


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("r", "x", "floor", "later"),
    [
        (0.8822425386318329, 0.12424907024623252, 1.0, 5.7634173148486e-9),
        (0.6238745625131576, 0.17080278277146188, 0.5, 8.4460356923358e-9),
    ],
)
def test_an_edge_without_a_side_does_not_throw_back_what_still_rises(r, x, floor, later, solver):
    """The ball strikes while the body rises within rounding of its floor: thrown back there, it
    would fall through."""
    model = switched(hy.EITHER)(r=r, floor=floor)
    for point, exact in both_limits(model, x, later, solver):
        assert abs(point.t - exact) <= point.t_error + 1e-15
        assert point.t_error < 4e-6


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("crossing", "r", "x", "later"),
    [
        (hy.FALLING, 0.6104502571058271, 0.5714156062678885, -3.9643790234733e-8),
        (hy.EITHER, 0.728042607999152, 0.24656927986620558, -2.342567205940312e-7),
    ],
)
def test_low_flights_carry_nothing_else_through_its_guard(crossing, r, x, later, solver):
    """Those of the ball begin where the body is within rounding of its floor, and falls. What its
    limit leaves open of the ball's height, 1e-20, puts off the next impact by 1e-13."""
    (body, own), (ball, its) = both_limits(switched(crossing)(r=r, floor=3.0), x, later, solver)
    assert abs(body.t - own) <= body.t_error < 1e-5
    assert abs(ball.t - its) <= ball.t_error + 1e-12  # inf where they may come in another order
