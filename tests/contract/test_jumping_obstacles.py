"""What holds a state may jump or have a corner: a floor that drops, a surface that moves away."""

import math

import attrs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import MECHANISMS

WAYS = MECHANISMS

#: Most steps lose rounding alone, as forces and speeds are constant between the jumps; those of
#: LSODA lose a few of its tolerances, 1e-8.
CLOSE = 1e-7

#: Phases and periods of saws. Where a saw drops is a rounded sum, quotient and product: for some
#: the floor has dropped before the function that tells of it, for some after.
SAWS = [(0.5, 1.0), (0.3, 0.7), (1.0, 2.3), (0.1, 1.1), (math.pi / 2, math.pi), (0.07, 0.61)]

G, R, SLOPE = 5.0, 0.3, 0.25

#: From a drop of the height 1 until the impacts have come to rest.
LASTS = math.sqrt(2.0 / G) * (1.0 + R) / (1.0 - R)


def body_on(floor):
    """A class of bodies that fall onto a floor, which is a function of the model and time."""

    class Body(hy.Automaton):
        x = hy.state()
        v = hy.state()
        phase = hy.parameter(0.5)
        period = hy.parameter(1.0)

        @hy.mode
        def fall(self, t, s):
            return s.v, -G

        land = hy.contact(fall, gap=lambda self, t, s: s.x - floor(self, t), restitution=R)

    return Body


def saw(model, t):
    """It rises slowly and drops at once."""
    return SLOPE * jnp.mod(t + model.phase, model.period)


OnASaw = body_on(saw)


@pytest.mark.parametrize(("phase", "period"), SAWS)
def test_a_floor_that_drops_leaves_the_body_at_each_drop(way, phase, period):
    """It falls the height of the drop, and comes to rest after a time that goes with its root."""
    start, t1 = {"x": SLOPE * phase, "v": SLOPE}, 4.5 * period - phase
    result = way.run(OnASaw(phase=phase, period=period), start, (0.0, t1), mode="fall.rest(land)")
    rests = [k * period - phase + LASTS * math.sqrt(SLOPE * period) for k in (1, 2, 3, 4)]
    expected = [t for t in rests if t < t1]
    if way.tells("accumulations"):
        assert result.accumulations == len(expected)
    told = [limit.t for limit in result.zeno]  # lanes and functions tell the first
    assert told == pytest.approx(expected[: len(told)], abs=CLOSE)


OnStairs = body_on(lambda model, t: -SLOPE * ((t + model.phase) // model.period))


@pytest.mark.parametrize(("phase", "period"), SAWS)
def test_stairs_that_go_down_leave_the_body_at_each_step(way, phase, period):
    """It falls the height of a step, and rests until the next if there is time."""
    model, end = OnStairs(phase=phase, period=2.0 * period), 4.5 * period - phase
    result = way.run(model, {"x": 0.0, "v": 0.0}, (0.0, end), mode="fall.rest(land)")
    rests = [2.0 * k * period - phase + LASTS * math.sqrt(SLOPE) for k in (1, 2)]
    expected = [t for k, t in enumerate(rests) if t < min(end, 2.0 * (k + 2) * period - phase)]
    if way.tells("accumulations"):
        assert result.accumulations == len(expected)
    told = [limit.t for limit in result.zeno]
    assert told == pytest.approx(expected[: len(told)], abs=CLOSE)


#: Waves with corners that none of the functions has of which they are made, and by parts.
QUARTER = 0.5 * math.pi
WAVES = {
    "asin": (lambda _, t: jnp.arcsin(jnp.sin(t)), lambda _, t: QUARTER - abs(_apart(t - QUARTER))),
    "acos": (lambda _, t: jnp.arccos(jnp.cos(t)), lambda _, t: abs(_apart(t))),
    "atan": (
        lambda _, t: 0.2 * jnp.arctan(jnp.tan(0.5 * t)),
        lambda _, t: 0.1 * _apart(t),
    ),
    "power": (lambda _, t: (jnp.sin(t) ** 2) ** 0.5, lambda _, t: abs(jnp.sin(t))),
    "root": (lambda _, t: jnp.sqrt(jnp.sin(t) ** 4) ** 0.5, lambda _, t: abs(jnp.sin(t))),
}


def _apart(t):
    """The distance of an angle to the nearest full turn, with its sign."""
    return jnp.mod(t + math.pi, 2.0 * math.pi) - math.pi


@pytest.mark.parametrize("wave", WAVES)
def test_a_corner_of_a_floor_is_seen_however_it_is_written(way, wave):
    """The body at rest is thrown off where the floor bends down, and struck where it bends up."""
    start, t, several = {"x": 1.7, "v": 0.0}, (0.1, 9.0), 2
    own, parts = (way.run(body_on(floor)(), start, t) for floor in WAVES[wave])
    if wave in ("asin", "acos") and way.name == "Dopri8":
        assert own.status == "not_finite"  # JAX gives Diffrax a slope that has no value there
        return
    if way.tells("accumulations"):
        assert own.accumulations == parts.accumulations >= several
    assert [limit.t for limit in own.zeno] == pytest.approx([z.t for z in parts.zeno], abs=CLOSE)
    assert np.allclose([own.final.x, own.final.v], [parts.final.x, parts.final.v], atol=CLOSE)


#: Triangular floors from the middle of a fall to their top: the period, the height, and where in
#: the period the body begins. At the first a step of Taylor's ends 3e-9 before the corner.
TOPS = [(0.5745709558098987, 0.012403211507765617, 0.6904844660533372), (1.0, 0.05, 0.5)]


@pytest.mark.parametrize(("period", "height", "begin"), TOPS)
def test_a_body_at_rest_is_thrown_off_at_the_top_of_a_triangle(way, period, height, begin):
    """It has been set down from a little above, rises with the side, and leaves at the corner. The
    time of the corner is known to its rounding, with any solver."""
    if not way.tells("edges"):
        pytest.skip("the release is found in the table of jumps")
    model = body_on(lambda m, t: height * abs(jnp.mod(t / m.period, 2.0) - 1.0))(period=period)
    start = {"x": height * (1.0 - begin) + 1e-3, "v": -height / period}
    result = way.run(model, start, (begin * period, 2.001 * period))
    assert result.edges[-1] == "land.release"
    assert result.times[-1] == pytest.approx(2.0 * period, rel=1e-14)


#: Floors with a corner and with a drop at 1 that none of their functions shows.
HIDDEN = {
    "corner": lambda _, t: jnp.sqrt(1.0 - jnp.cos(t - 1.0)),
    "drop": lambda _, t: -0.1 * jnp.arctan(1.0 / jnp.tan(t - 1.0)),
}


@pytest.mark.parametrize("hidden", HIDDEN)
def test_a_corner_that_no_formula_shows_is_not_gone_over_by_a_body_at_rest(way, hidden):
    """The run says at which time it is; a run that ends before knows nothing of it."""
    floor = HIDDEN[hidden]
    with jax.enable_x64(True):
        x, v = jax.value_and_grad(lambda t: floor(None, t))(0.2)
    model, start = body_on(floor)(), {"x": float(x), "v": float(v)}
    result = way.run(model, start, (0.2, 3.0), mode="fall.rest(land)")
    assert result.status == "not_finite"
    if way.tells("run"):
        assert "t = 1.0" in result.said or "t = 0.99" in result.said
    assert way.run(model, start, (0.2, 0.9), mode="fall.rest(land)").status == "reached_end"


class Follower(hy.Automaton):
    """Follows a saw at constant speed, slides on it, and counts what it has seen of a clock."""

    x = hy.state()
    seen = hy.state()
    phase = hy.parameter(0.3)
    period = hy.parameter(0.7)
    speed = hy.parameter(2.5)

    @hy.mode(initial=True)
    def above(self, t, s):
        return -self.speed, 0.0

    @hy.mode
    def below(self, t, s):
        return self.speed, 0.0

    side = hy.switching(
        above, below, surface=lambda self, t, s: s.x - jnp.mod(t + self.phase, self.period)
    )


@pytest.mark.parametrize(("phase", "period"), SAWS)
def test_a_surface_that_jumps_away_is_slid_on_no_longer(way, phase, period):
    """The state goes back to it from where it was; it slides again a period over 3.5 later."""
    model, last = Follower(phase=phase, period=period), 3
    drop = last * period - phase
    for later, x in ((0.2, 1.0 - 2.5 * 0.2), (0.6, 0.6)):
        end = drop + later * period
        result = way.run(model, {"x": phase, "seen": 0.0}, (0.0, end), mode="slide(side)")
        assert result.final.x == pytest.approx(x * period, abs=CLOSE)
        if way.tells("edges"):
            back = [] if later < 1.0 / 3.5 else ["side"]
            assert (
                list(result.edges)
                == ["side.positive", "side"] * (last - 1) + ["side.positive"] + back
            )


class Ticking(hy.Automaton):
    """A body at rest on a saw, a state that slides on one, and a clock that rings at its drops."""

    x = hy.state()
    v = hy.state()
    least = hy.parameter(-1.0)

    @hy.mode(initial=True)
    def fall(self, t, s):
        return s.v, -G

    @hy.mode
    def above(self, t, s):
        return -2.5, 0.0

    @hy.mode
    def below(self, t, s):
        return 2.5, 0.0

    land = hy.contact(fall, gap=lambda self, t, s: s.x - SLOPE * jnp.mod(t, 1.0), restitution=R)
    side = hy.switching(above, below, surface=lambda self, t, s: s.x - SLOPE * jnp.mod(t, 1.0))
    rings = hy.edge(fall, to=fall, every=1.0, when=lambda self, t, s: s.x > self.least)
    sounds = hy.edge(above, to=above, every=1.0, when=lambda self, t, s: s.x > self.least)


@pytest.mark.parametrize("later", [0.0, 0.1])
@pytest.mark.parametrize("least", [-1.0, 1.0])
@pytest.mark.parametrize("mode", ["fall.rest(land)", "slide(side)"])
def test_a_run_or_a_clock_may_end_an_arc_where_the_obstacle_jumps(way, mode, least, later):
    """The state stays where it was, whether the clock fires there or its condition fails; then it
    falls, or goes down to the surface."""
    start, end = {"x": 0.5 * SLOPE, "v": SLOPE if "rest" in mode else 0.0}, 3.0 + later
    result = way.run(Ticking(least=least), start, (0.5, end), mode=mode)
    falls = (
        SLOPE * later - 0.5 * G * later**2
        if "rest" in mode
        else SLOPE * (later - 1.0)
        if later
        else 0.0
    )
    assert result.final.x == pytest.approx(SLOPE + falls, abs=CLOSE)


class Reference(hy.Automaton):
    """Goes to a reference value that changes in steps, at constant speed, and stays there."""

    x = hy.state()
    fast = hy.parameter(2.0)
    reference = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def down(self, t, s):
        return (-self.fast,)

    @hy.mode
    def up(self, t, s):
        return (self.fast,)

    reach = hy.switching(down, up, surface=lambda self, t, s: s.x - self.reference(t))


def test_a_reference_in_steps_is_followed_by_sliding(way):
    """At a step of the signal the state leaves the surface to the side on which it then is."""
    model = Reference(reference=([0.0, 1.0, 2.0], [0.0, 1.0, -0.5]))
    for end, x in ((0.9, 0.0), (1.2, 0.4), (1.9, 1.0), (2.3, 0.4), (3.0, -0.5)):
        result = way.run(model, {"x": 0.0}, (0.0, end), mode="slide(reach)")
        assert result.final.x == pytest.approx(x, abs=CLOSE)
    if way.tells("edges"):
        assert list(result.edges) == ["reach.negative", "reach", "reach.positive", "reach"]


def test_derivatives_go_on_where_a_reference_steps():
    """The time of a step is the same for all; ``x = 1 - fast (t - 2)`` behind the second."""
    model = Reference(reference=([0.0, 1.0, 2.0], [0.0, 1.0, -0.5]))
    with jax.enable_x64(True):
        follow = hy.as_function(model, t=(0.0, 2.3), max_jumps=8, mode="slide(reach)")
        end = lambda fast: follow(attrs.evolve(model, fast=fast), {"x": 0.0}).final.x  # noqa: E731
        assert float(jax.jacfwd(end)(2.0)) == pytest.approx(-0.3, abs=CLOSE)


class Late(hy.Automaton):
    """A body on a platform, or a state that slides on a surface, whose height is that of a while
    ago; a clock changes it."""

    x = hy.state()
    v = hy.state()
    height = hy.state()
    step = hy.parameter(-0.3)

    @hy.mode(initial=True)
    def fall(self, t, s, past):
        return s.v, -G, 0.0 * s.height

    @hy.mode
    def above(self, t, s, past):
        return -1.0, 0.0, 0.0 * s.height

    @hy.mode
    def below(self, t, s, past):
        return 1.0, 0.0, 0.0 * s.height

    land = hy.contact(fall, gap=lambda self, t, s, past: s.x - past(0.5).height, restitution=R)
    side = hy.switching(above, below, surface=lambda self, t, s, past: s.x - past(0.5).height)

    @hy.edge(fall, to=fall, at=1.0)
    def changes(self, t, s):
        return s.x, s.v, s.height + self.step

    @hy.edge(above, to=above, at=1.0)
    def moves(self, t, s):
        return s.x, s.v, s.height + self.step


@pytest.mark.parametrize("mode", ["fall.rest(land)", "slide(side)"])
def test_what_jumps_a_while_ago_leaves_the_state_where_it_is(way, mode):
    """The platform drops half a second after the clock has rung, and so does the surface."""
    start = {"x": 0.0, "v": 0.0, "height": 0.0}
    for end, fallen in ((1.5, 0.0), (1.6, 0.5 * G * 0.01 if "rest" in mode else 0.1), (2.9, 0.3)):
        result = way.run(Late(), start, (0.0, end), mode=mode, history=start)
        assert result.final.x == pytest.approx(-fallen, abs=CLOSE)
    if "rest" in mode:
        assert result.t_inf == pytest.approx(1.5 + LASTS * math.sqrt(0.3), abs=CLOSE)


def test_a_platform_that_jumps_up_into_the_body_is_an_error(way):
    start = {"x": 0.0, "v": 0.0, "height": 0.0}
    options = {"mode": "fall.rest(land)", "history": start}
    assert way.run(Late(step=0.1), start, (0.0, 2.0), **options).status == "refused"


def on_a_lift(speed):
    """A body on a platform of which the flow gives the speed, by the model, time and state."""

    class Lift(hy.Automaton):
        x = hy.state()
        v = hy.state()
        y = hy.state()
        up = hy.discrete(1.0)
        planned = hy.signal(kind="previous", outside="hold")

        @hy.mode
        def ride(self, t, s):
            return s.v, -G, speed(self, t, s)

        land = hy.contact(ride, gap=lambda self, t, s: s.x - s.y, restitution=R)

        @hy.edge(ride, to=ride, at=1.0)
        def turns(self, t, s):
            return s.replace(up=-s.up)

    return Lift(planned=([0.0, 1.0], [0.5, -0.5]))


#: Speeds of a lift that goes up by a half and turns at 1.
SPEEDS = {
    "time": lambda _, t, s: jnp.where(t < 1.0, 0.5, -0.5),
    "wave": lambda _, t, s: 0.5 * jnp.sign(jnp.cos(0.5 * jnp.pi * t)),
    "clock": lambda _, t, s: 0.5 * s.up,
    "signal": lambda self, t, s: self.planned(t),
}

#: The body is thrown off at a relative speed of 1, which the first impact has as well.
AT_REST_AGAIN = 1.0 + 2.0 / G * (1.0 + R / (1.0 - R))


@pytest.mark.parametrize("turned", SPEEDS)
def test_a_lift_whose_speed_jumps_throws_the_body_off(way, turned):
    start = {"x": 0.0, "v": 0.5, "y": 0.0, "up": 1.0}
    result = way.run(on_a_lift(SPEEDS[turned]), start, (0.0, 1.9), mode="ride.rest(land)")
    assert result.t_inf == pytest.approx(AT_REST_AGAIN, abs=CLOSE)
    assert result.final.x == pytest.approx(0.5 - 0.5 * 0.9, abs=CLOSE)


class LateLift(hy.Automaton):
    """A lift that turns a while after it has passed a height."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    late: float = hy.parameter(0.5)
    height: float = hy.parameter(0.25)

    @hy.mode
    def ride(self, t, s, past):
        return s.v, -G, jnp.where(past(self.late).y > self.height, -0.5, 0.5)

    land = hy.contact(ride, gap=lambda self, t, s: s.x - s.y, restitution=R)


def test_a_lift_that_sees_where_it_was_throws_the_body_off_each_time_it_turns_down(way):
    """It is seen above a quarter from 1 to 2; where it turns up, at 2, the body is struck."""
    start = {"x": 0.0, "v": 0.5, "y": 0.0}
    result = way.run(LateLift(), start, (0.0, 2.9), mode="ride.rest(land)", history=start)
    struck = 2.0 + 2.0 * R / G / (1.0 - R)
    if way.tells("accumulations"):
        assert result.accumulations == 2
    expected = [AT_REST_AGAIN, struck][: len(result.zeno)]
    assert [limit.t for limit in result.zeno] == pytest.approx(expected, abs=CLOSE)
    assert result.final.x == pytest.approx(0.45, abs=CLOSE)


def test_a_lift_that_turns_where_windows_end_throws_the_body_off_whatever_the_last_digits(way):
    """It passes the height at ``late``, which is when the first window of the past ends, and turns
    when the second does: rounding puts that before its end, behind it, or in neither window."""
    for tau, y in (0.5, 3.3), (0.25, 0.1), (0.3, 3.3), (1 / 3, 3.3), (0.7, 0.1), (0.2288, 0.1):
        start = {"x": y, "v": 0.5, "y": y}
        model = LateLift(late=tau, height=y + 0.5 * tau)
        begin = {"mode": "ride.rest(land)", "history": start}
        result = way.run(model, start, (0.0, 2.0 * tau + 0.15), **begin)
        high = y + tau + 0.5 * 0.15 - 0.5 * G * 0.15**2
        assert result.status == "reached_end"
        assert result.final.x == pytest.approx(high, abs=CLOSE)


class Stepped(hy.Automaton):
    """A state that goes to a surface, and a body that falls onto a floor, which step at 1."""

    x = hy.state()
    y = hy.state()
    to = hy.parameter(0.5)

    @hy.mode(initial=True)
    def above(self, t, s):
        return -1.0, 1.0

    @hy.mode
    def below(self, t, s):
        return 1.0, 3.0

    @hy.mode
    def fall(self, t, s):
        return s.y, -1.0

    side = hy.switching(
        above, below, surface=lambda self, t, s: s.x - jnp.where(t < 1.0, 0.0, self.to)
    )
    land = hy.contact(
        fall, gap=lambda self, t, s: s.x - jnp.where(t < 1.0, 0.0, self.to), restitution=R
    )


def test_a_surface_that_steps_over_the_state_does_not_move_it(way):
    """The state crosses where it is, and comes to the surface from the other side later."""
    result = way.run(Stepped(), {"x": 1.2, "y": 0.0}, (0.0, 1.1), mode="above")
    assert (result.final.x, result.final.y) == pytest.approx((0.3, 1.3), abs=CLOSE)
    later = way.run(Stepped(), {"x": 1.2, "y": 0.0}, (0.0, 1.6), mode="above")
    assert later.final.x == pytest.approx(0.5, abs=CLOSE)
    if way.tells("edges"):
        assert list(later.edges) == ["side", "side"]


def test_a_floor_that_steps_up_over_a_body_in_flight_is_an_error(way):
    """As it is over one at rest: the body is at 0.1, and the floor then at 0.5."""
    start = {"x": 0.6, "y": 0.0}
    assert way.run(Stepped(), start, (0.0, 2.0), mode="fall").status == "refused"
    lower = way.run(Stepped(to=0.05), start, (0.0, 1.04), mode="fall")
    assert lower.final.x == pytest.approx(0.6 - 0.5 * 1.04**2, abs=CLOSE)
