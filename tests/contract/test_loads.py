"""A load that a contact bears at rest is a guard like any other: where it jumps, too."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import SOLVERS, later

WAYS = ["DOP853", "Radau", "LSODA", "taylor", "Dopri8", "ensemble", "as_function"]

#: Compiled lanes are held to what they are marked to miss; the other tests are not asked of them.
simulated = pytest.mark.parametrize("way", WAYS[:5], indirect=True)

#: Solvers integrate constant forces exactly; the flight begins within rounding of the release.
EXACT = 1e-9


class Switched(hy.Automaton):
    """A body on a floor, pressed down by 2, pushed by ``push`` while t is in (on, off)."""

    x = hy.state()
    v = hy.state()
    push = hy.parameter(5.0)
    on = hy.parameter(1.0)
    off = hy.parameter(1e6)

    @hy.mode
    def free(self, t, s):
        return s.v, jnp.where((t > self.on) & (t < self.off), self.push - 2.0, -2.0)

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


class Clocked(hy.Automaton):
    """The force is switched by a state that runs at its own pace, and by its sign."""

    x = hy.state()
    v = hy.state()
    c = hy.state()
    pace = hy.parameter(1.0)

    @hy.mode
    def free(self, t, s):
        return s.v, 2.0 * jnp.sign(s.c - 0.5) + 0.5, self.pace

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


class Square(hy.Automaton):
    """A force that is switched by the sign of a sine."""

    x = hy.state()
    v = hy.state()
    w = hy.parameter(2.0)

    @hy.mode
    def free(self, t, s):
        return s.v, jnp.where(jnp.sin(self.w * t) < -0.5, 3.0, -2.0)

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


class Stepped(hy.Automaton):
    """A force that grows by one at each whole number of time."""

    x = hy.state()
    v = hy.state()
    first = hy.parameter(-2.5)

    @hy.mode
    def free(self, t, s):
        return s.v, self.first + jnp.floor(t)

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


class Falling(hy.Automaton):
    """A floor that falls away from ``t = on``: with an acceleration, a speed, or all at once."""

    x = hy.state()
    v = hy.state()
    a = hy.parameter(100.0)
    speed = hy.parameter(0.0)
    drop = hy.parameter(0.0)
    on = hy.parameter(1.0)

    def floor(self, t):
        since = jnp.maximum(t - self.on, 0.0)
        return -0.5 * self.a * since**2 - self.speed * since - jnp.where(t > self.on, self.drop, 0)

    @hy.mode
    def free(self, t, s):
        return s.v, -2.0

    ground = hy.contact(free, gap=lambda self, t, s: s.x - self.floor(t), restitution=0.5)


REST = {"x": 0.0, "v": 0.0}


def on_time(result, edge, t):
    """The first jump is this one, at this time: to the spacing of floats."""
    assert result.edges[0] == edge
    assert result.times[0] == pytest.approx(t, abs=4e-15 * max(1.0, abs(t)))


@pytest.mark.parametrize("on", [1.0, 0.3, 1.7])
def test_a_force_that_is_switched_on_releases(way, on):
    """A body at rest flies from where the force upwards is switched on."""
    result = way.run(Switched(on=on), REST, (0.0, 2.0), rtol=1e-9)
    assert result.final.x == pytest.approx(1.5 * (2.0 - on) ** 2, abs=EXACT)
    assert result.final.v == pytest.approx(3.0 * (2.0 - on), abs=EXACT)
    if way.tells("edges"):
        assert len(result.edges) == 1
        on_time(result, "floor.release", on)


@pytest.mark.parametrize("name", ["DOP853", "taylor"])
def test_a_release_at_a_jump_of_the_load_lasts(name):
    """From rest after impacts, at random instants: times in two floats and in one may differ."""
    draw = np.random.default_rng(5)
    for _ in range(100):
        w = draw.uniform(0.5, 1.2)
        on = 7 * np.pi / 6 / w
        start = {"x": draw.uniform(0.1, 0.5), "v": 0.0}
        solver, rtol = SOLVERS[name], 10.0 ** draw.uniform(-12, -6)
        run = hy.simulate(Square(w=w), start, (0.0, on + 1.0), rtol=rtol, **solver)
        assert run.mode == "free"
        assert run.final.v == pytest.approx(3.0, abs=1e-5)  # 3 for one second, and the tolerance


@pytest.mark.parametrize("width", [0.1, 1e-3, 1e-6])
def test_a_pulse_of_the_load_is_not_missed(way, width):
    """However short the pulse, the body leaves at its start (4 < t < 4 + width)."""
    model = Switched(push=32.0, on=4.0, off=4.0 + width)
    result = way.run(model, REST, (0.0, 4.0 + 0.5 * width), rtol=1e-9)
    assert result.final.v == pytest.approx(15.0 * width, rel=1e-6)  # the ends' rounding, over width
    if way.tells("edges"):
        on_time(result, "floor.release", 4.0)


def test_a_pulse_does_not_depend_on_the_end_of_the_run(way):
    """The release is the same whether the run ends at 4.1, 5 or 4000."""
    model = Switched(push=32.0, on=4.0, off=4.1)
    runs = [way.run(model, REST, (0.0, t1), rtol=1e-9, max_jumps=3) for t1 in (4.1, 5.0, 4000.0)]
    assert all(run.jumps for run in runs)
    if way.tells("edges"):
        for run in runs:
            on_time(run, "floor.release", 4.0)


@pytest.mark.parametrize("pace", [1.0, 0.37, 1e-3])
def test_a_force_that_a_state_switches_releases(way, pace):
    """The force changes its sign where a clock reads 0.5."""
    t1 = 1.0 / pace
    result = way.run(Clocked(pace=pace), {**REST, "c": 0.0}, (0.0, t1), rtol=1e-9)
    flown = t1 - 0.5 / pace
    assert result.final.x == pytest.approx(1.25 * flown**2, rel=1e-8)  # the solvers' tolerance


@pytest.mark.parametrize("w", [2.0, 0.7, 11.0])
def test_a_square_wave_releases(way, w):
    """The first time at which the sine is below -0.5."""
    start = (np.pi + np.pi / 6) / w
    result = way.run(Square(w=w), REST, (0.0, start + 0.5 / w), rtol=1e-9)
    assert result.final.v == pytest.approx(1.5 / w, rel=1e-7)
    if way.tells("edges"):
        assert result.times[0] == pytest.approx(start, rel=1e-12)


@pytest.mark.parametrize("first", [-2.5, -4.5])
def test_a_force_in_steps_releases(way, first):
    """``floor(t)`` reaches a force upwards at a whole number of time."""
    start = np.ceil(-first)
    result = way.run(Stepped(first=first), REST, (0.0, start + 0.5), rtol=1e-9)
    assert result.final.v == pytest.approx(0.25, abs=EXACT)
    if way.tells("edges"):
        on_time(result, "floor.release", start)


FALLS = {"a": (100.0, 0.0, 0.0), "speed": (0.0, 3.0, 0.0), "drop": (0.0, 0.0, 5.0)}


@pytest.mark.parametrize("kind", FALLS)
def test_a_floor_that_falls_away_does_not_pull(way, kind):
    """From t = 1 the body falls freely, by 1 in a unit of time, and reaches the speed 2."""
    a, speed, drop = FALLS[kind]
    result = way.run(Falling(a=a, speed=speed, drop=drop), REST, (0.0, 2.0), rtol=1e-9)
    assert result.final.x == pytest.approx(-1.0, abs=EXACT)
    assert result.final.v == pytest.approx(-2.0, abs=EXACT)


@simulated
def test_a_floor_that_sinks_slower_than_the_body_falls_holds_it(way):
    """A floor that accelerates downwards by 1 < 2: the body stays on it."""
    result = way.run(Falling(a=1.0), REST, (0.0, 2.0), rtol=1e-9)
    assert result.final.x == pytest.approx(-0.5, abs=EXACT)
    assert result.jumps == 0


@simulated
def test_a_load_that_jumps_but_stays_a_load_releases_nothing(way):
    """A push of 1.9 against 2."""
    result = way.run(Switched(push=1.9), REST, (0.0, 3.0), rtol=1e-9)
    assert (result.jumps, result.final.x, result.final.v) == (0, 0.0, 0.0)


@simulated
def test_a_load_that_becomes_zero_releases_nothing(way):
    """A push of 2 against 2: nothing pulls, and nothing moves."""
    result = way.run(Switched(push=2.0), REST, (0.0, 3.0), rtol=1e-9)
    assert (result.final.x, result.final.v) == (0.0, 0.0)


class Ramped(hy.Automaton):
    """A body on a floor, pressed down by 2, from t = ``on`` pushed by ``slope`` times the time."""

    x = hy.state()
    v = hy.state()
    c = hy.state()
    on = hy.parameter(1.0)
    slope = hy.parameter(1.0)

    @hy.mode
    def free(self, t, s):
        return s.v, jnp.where(s.c > self.on, self.slope * (s.c - self.on), -2.0), 1.0

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize(("on", "slope"), [(1.0, 1.0), (0.3, 6.0), (1.0, -1.0), (1.0, 0.0)])
def test_a_load_that_jumps_to_zero_is_held_as_long_as_it_is_not_below(way, on, slope):
    """Where it goes on below zero the body flies, ``x = slope s^3 / 6``; else it stays."""
    result = way.run(Ramped(on=on, slope=slope), {**REST, "c": 0.0}, (0.0, 2.0), rtol=1e-9)
    assert result.final.x == pytest.approx(max(slope, 0.0) * (2.0 - on) ** 3 / 6, abs=1e-8)
    assert result.jumps == (slope > 0.0)


@pytest.mark.parametrize("spacings", [1, 2, 5, 30])
def test_a_load_may_jump_within_rounding_of_the_start(way, spacings):
    """The run starts at rest, some spacings of its time before the force is switched."""
    result = way.run(Switched(on=1.0 + spacings * 2.0**-52), REST, (1.0, 2.0), rtol=1e-9)
    assert result.final.v == pytest.approx(3.0, abs=EXACT)
    assert result.jumps == 1


@simulated
@pytest.mark.parametrize("start", [1.0, 1.0 + 2.0**-52, 1.5])
def test_a_start_at_or_after_the_switch_flies(way, start):
    """At the very time of the switch what follows it counts."""
    result = way.run(Switched(), REST, (start, 2.0), rtol=1e-9)
    assert result.final.v == pytest.approx(3.0 * (2.0 - start), abs=EXACT)
    assert result.jumps == 0


class Rising(hy.Automaton):
    """A body on a floor under a force ``c0 + c1 s + c2 s^2 + c3 s^3``, s the time from t = at."""

    x = hy.state()
    v = hy.state()
    c0 = hy.parameter(0.0)
    c1 = hy.parameter(0.0)
    c2 = hy.parameter(0.0)
    c3 = hy.parameter(0.0)
    at = hy.parameter(0.0)

    @hy.mode
    def free(self, t, s):
        since = t - self.at
        return s.v, self.c0 + since * (self.c1 + since * (self.c2 + since * self.c3))

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


@simulated
@pytest.mark.parametrize("power", [0, 1, 2, 3])
@pytest.mark.parametrize("at", [0.0, 3.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_start_at_the_instant_of_a_release_is_decided(way, power, at, sign):
    """By the first derivative of the load that does not vanish: it flies, or rests."""
    model = Rising(at=at, **{f"c{power}": float(sign)})
    result = way.run(model, REST, (at, at + 1.0), rtol=1e-9)
    flown = 1.0 / ((power + 1) * (power + 2)) if sign > 0 else 0.0
    assert result.final.x == pytest.approx(flown, abs=1e-8)
    assert result.jumps == 0


@simulated
def test_a_start_without_any_load_stays(way):
    """Nothing presses, nothing pulls: the body stays where it is."""
    result = way.run(Rising(), REST, (0.0, 1.0), rtol=1e-9)
    assert (result.final.x, result.final.v, result.jumps) == (0.0, 0.0, 0)


class Pulsed(hy.Automaton):
    """A smooth pulse of force, of height 1e6 and width ``w``, at t = 1.1."""

    x = hy.state()
    v = hy.state()
    w = hy.parameter(1e-6)

    @hy.mode
    def free(self, t, s):
        return s.v, -2.0 + 1e6 * jnp.exp(-(((t - 1.1) / self.w) ** 2))

    floor = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.5)


@simulated
@pytest.mark.parametrize("t1", [1.2, 3.0, 4.99, 5.0, 7.0])
def test_no_release_is_invented_at_the_last_time(way, t1):
    """A release is where the load is zero, or there is none: never at the end of the run."""
    result = way.run(Pulsed(), REST, (0.0, t1), rtol=1e-9)
    if way.tells("edges"):
        releases = [t for t, edge in zip(result.times, result.edges, strict=True) if t == t1]
        assert not releases
        if result.jumps:
            assert result.times[0] == pytest.approx(1.1 - 3.6e-6, abs=1e-7)


class Swept(hy.Automaton):
    """A body on a table that goes up and down, with a drag by the square of its speed."""

    x = hy.state()
    v = hy.state()
    height = hy.parameter(0.9)
    drag = hy.parameter(0.1)

    @hy.mode
    def free(self, t, s):
        return s.v, -1.0 - self.drag * s.v * jnp.abs(s.v)

    floor = hy.contact(free, gap=lambda self, t, s: s.x - self.height * jnp.sin(t), restitution=0.3)


@pytest.mark.parametrize("height", [0.8, 0.99, *later(0.9)])
def test_a_body_is_not_released_where_its_flow_changes_at_the_turn_of_its_floor(way, height):
    """A light load, 1 - height, at the top: the speeds of body and floor are zero there, and what
    time and state are off for rounding is all that is left of them."""
    start = {"x": height * np.sin(3.0), "v": height * np.cos(3.0)}
    result = way.run(Swept(height=height), start, (3.0, 40.0), rtol=1e-9)
    assert result.jumps == 0
    assert result.final.x == pytest.approx(height * np.sin(40.0), abs=EXACT)


class Pair(hy.Automaton):
    """Two bodies, each pressed onto its floor by a force that falls to zero at the same time."""

    x = hy.state()
    u = hy.state()
    y = hy.state()
    v = hy.state()
    a = hy.parameter(1.0)
    b = hy.parameter(1.0)
    pace = hy.parameter(1.0)
    since = hy.parameter(0.0)

    @hy.mode(initial=True)
    def free(self, t, s):
        ease = self.pace * (t - self.since)
        return s.u, -self.a + self.a * ease, s.v, -self.b + self.b * ease

    one = hy.contact(free, gap=lambda self, t, s: s.x, restitution=0.0)
    two = hy.contact(free, gap=lambda self, t, s: s.y, restitution=0.0)


@simulated
@pytest.mark.parametrize(
    ("a", "b", "pace", "since"),
    [
        (0.64726896098382, 2.2568160239458006, 0.6955472517956489, -7.3),
        (0.3, 2.9, 1.7, 100.0),
        (1.1, 0.7, 0.9, 0.0),
    ],
)
def test_two_bodies_whose_loads_end_together_both_leave(way, a, b, pace, since):
    """At that time each load is rounding of the forces of which it is made: neither is held again
    because of its sign."""
    model = Pair(a=a, b=b, pace=pace, since=since)
    span, free = (since, since + 3.0), 3.0 - 1.0 / pace
    rest = {"x": 0.0, "u": 0.0, "y": 0.0, "v": 0.0}
    result = way.run(model, rest, span, mode="free.rest(one, two)", rtol=1e-9)
    if way.tells("edges"):
        assert sorted(result.edges) == ["one.release", "two.release"]
    for value, force in ((result.final.x, a), (result.final.y, b)):
        assert value == pytest.approx(force * pace * free**3 / 6.0, rel=1e-8)
