"""An edge back into its own mode that leaves its guard where it is bounds nothing."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import later

WAYS = ["DOP853", "Radau", "taylor", "Dopri8", "ensemble", "as_function"]

PHASES = [0.0, 0.4, 1.0, 2.0, np.pi, 4.0, 5.0, 6.2]


class Circle(hy.Automaton):
    """A point on a circle that counts how often x passes 0.3: rising, falling, and both."""

    x = hy.state()
    v = hy.state()
    up = hy.state()
    down = hy.state()
    both = hy.state()
    level = hy.parameter(0.3)

    @hy.mode
    def turns(self, t, s):
        return s.v, -s.x, 0.0, 0.0, 0.0

    @hy.edge(turns, to=turns, guard=lambda self, t, s: s.x - self.level, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)

    @hy.edge(turns, to=turns, guard=lambda self, t, s: s.x - self.level)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)

    @hy.edge(turns, to=turns, guard=lambda self, t, s: s.x - self.level, crossing=hy.EITHER)
    def passes(self, t, s):
        return s.replace(both=s.both + 1)


class Clock(hy.Automaton):
    """A pendulum that is pushed on where it passes 0 upwards, between walls, with an alarm."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    push = hy.parameter(0.5)
    wall = hy.parameter(4.0)
    alarm = hy.parameter(5.0)

    @hy.mode
    def swings(self, t, s):
        return s.v, -s.x, 0.0

    @hy.edge(swings, to=swings, guard=lambda self, t, s: s.x, crossing=hy.RISING)
    def pushed(self, t, s):
        return s.replace(v=s.v + self.push)

    @hy.edge(swings, to=swings, guard=lambda self, t, s: self.wall - s.x)
    def struck(self, t, s):
        return s.replace(v=-0.5 * s.v)

    @hy.edge(swings, to=swings, guard=lambda self, t, s: self.alarm - t)
    def rings(self, t, s):
        return s.replace(n=s.n + 1)


def passages(phase, t1, level=0.3):
    """How often ``cos(t + phase)`` passes a level, rising and falling, on (0, t1]."""
    times = np.linspace(0.0, t1, 200_001)
    signs = np.sign(np.cos(times + phase) - level)
    return int(np.sum(np.diff(signs) > 0)), int(np.sum(np.diff(signs) < 0))


def test_events_are_passed_and_fire_at_every_crossing(way):
    """From every phase of the circle, inside and beyond, each counts its own crossings."""
    starts = [[np.cos(p), -np.sin(p), 0.0, 0.0, 0.0] for p in PHASES]
    for phase, result in zip(
        PHASES, way.many(Circle(), starts, (0.0, 20.0), rtol=1e-9), strict=True
    ):
        up, down = passages(phase, 20.0)
        assert (result.final.up, result.final.down, result.final.both) == (up, down, up + down)
        assert result.final.x == pytest.approx(np.cos(20.0 + phase), abs=1e-6)


@pytest.mark.parametrize("level", [0.9999, -0.95, *later(0.9, 0.99)])
def test_events_that_return_soon_are_counted_once(way, level):
    """The end of a short arc is predicted for one of the three that fire there."""
    starts = [[np.cos(p), -np.sin(p), 0.0, 0.0, 0.0] for p in PHASES]
    results = way.many(Circle(), starts, (0.0, 20.0), {"level": [level] * len(starts)}, rtol=1e-9)
    for phase, result in zip(PHASES, results, strict=True):
        up, down = passages(phase, 20.0, level)
        assert (result.final.up, result.final.down, result.final.both) == (up, down, up + down)


class Low(hy.Automaton):
    """A ball, and how often it rises through a level."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    level = hy.parameter(0.5)
    r = hy.parameter(0.5)

    @hy.mode
    def flies(self, t, s):
        return s.v, -10.0, 0.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.x - self.level, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(n=s.n + 1)

    floor = hy.contact(flies, gap=lambda self, t, s: s.x, restitution="r")


@pytest.mark.parametrize("r", [0.3, 0.7, *later(0.5)])
def test_an_event_in_low_flights_is_counted(way, r):
    """A hundredth below the apex of each flight, down to levels of 1e-7 where a deeper passage is
    no touch within the tolerances: neither a low flight nor a sum of impacts passes over it."""
    flights = [k for k in range(2, 26) if r ** (2 * k) > 1e-7]
    levels = [0.99 * r ** (2 * k) for k in flights]
    given = {"level": levels, "r": [r] * len(levels)}
    results = way.many(Low(), [[1.0, 0.0, 0.0]] * len(levels), (0.0, 4.0), given, rtol=1e-9)
    for k, result in zip(flights, results, strict=True):
        assert result.final.n == k
        assert result.final.x == 0.0
        # the sum of a geometric series
        assert result.t_inf == pytest.approx(np.sqrt(0.2) * (1 + r) / (1 - r), rel=1e-9)


def test_a_kick_onwards_is_an_event(way):
    """Begun beyond the guard and after the alarm: pushed at each passage upwards."""
    result = way.run(Clock(), [1.0, 0.0, 0.0], (6.0, 6.0 + 4 * np.pi), rtol=1e-9)
    assert result.final.n == 0.0
    # two passages, at the speeds 1 and 1.5: amplitude 2 afterwards, a quarter turn after 0
    assert np.hypot(result.final.x, result.final.v) == pytest.approx(2.0, abs=1e-6)


def test_an_alarm_rings_once(way):
    """A guard of time alone fires at its time and is passed."""
    result = way.run(Clock(push=0.0), [1.0, 0.0, 0.0], (0.0, 20.0), rtol=1e-9)
    assert result.final.n == 1.0
    assert result.final.x == pytest.approx(np.cos(20.0), abs=1e-6)


class Wheel(hy.Automaton):
    """A wheel whose angle is taken back by a turn, or set to zero, and a hand that is set onto its
    mark: the guard is zero before and after, and not by the same formula."""

    angle = hy.state()
    x = hy.state()
    v = hy.state()
    turns = hy.state()
    swings = hy.state()

    @hy.mode
    def rolls(self, t, s):
        return 1.0, s.v, -s.x, 0.0, 0.0

    @hy.edge(rolls, to=rolls, guard=lambda self, t, s: jnp.sin(0.5 * s.angle))
    def turn(self, t, s):
        return s.replace(angle=s.angle - 4 * jnp.pi, turns=s.turns + 1)

    @hy.edge(rolls, to=rolls, guard=lambda self, t, s: s.x - 0.3)
    def swing(self, t, s):
        return s.replace(x=0.3, swings=s.swings + 1)


def test_a_reset_that_leaves_the_guard_at_zero_bounds_nothing(way):
    """Begun beyond both guards: the sine falls through zero at 3 pi and not again; the hand falls
    to 0.3 at acos(0.3) + acos(-0.9), and each turn later."""
    start = [3 * np.pi, -0.9, np.sqrt(0.19), 0.0, 0.0]
    result = way.run(Wheel(), start, (0.0, 18.0), rtol=1e-9)
    assert (result.final.turns, result.final.swings) == (1.0, 3.0)
    first = np.arccos(0.3) + np.arccos(-0.9)
    if way.tells("edges"):
        assert result.edges == ["swing", "turn", "swing", "swing"]
    times = [first, 3 * np.pi, first + 2 * np.pi, first + 4 * np.pi]
    np.testing.assert_allclose(result.times, times, atol=1e-6)  # global errors of the methods


def test_a_wall_written_as_an_edge_still_bounds(way):
    """Its reset leaves the guard where it is, but turns the motion round."""
    result = way.run(Clock(wall=0.5), [1.0, 0.0, 0.0], (0.0, 1.0), rtol=1e-9)
    assert result.status == "refused"


class Tossed(hy.Automaton):
    """A ball over a floor, watched by an event at a height; tossed beyond it by another edge."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    high = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0, 0.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: self.high - s.x)
    def seen(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: jnp.sin(t - 4.0), crossing=hy.RISING)
    def tossed(self, t, s):
        return s.replace(x=s.x + 1.0)


def test_a_jump_may_lead_beyond_an_event_and_impacts_accumulate_under_it(way):
    """From 1 beyond 0.5 onto the floor, at rest at 3; lifted beyond at 4, at rest again at 7."""
    result = way.run(Tossed(), [1.0, 0.0, 0.0], (0.0, 8.0), rtol=1e-9)
    assert result.final.n == 0.0
    assert result.final.x == pytest.approx(0.0, abs=1e-9)
    assert result.t_inf == pytest.approx(3.0, abs=1e-8)
    if way.tells("all zeno"):
        np.testing.assert_allclose([point.t for point in result.zeno], [3.0, 7.0], atol=1e-8)


class Burst(hy.Automaton):
    """Three events next to each other, of a state and of time, and a number that is large."""

    x = hy.state()
    n = hy.state()
    large = hy.state()
    first = hy.parameter(1e-14)
    apart = hy.parameter(2e-15)
    of_time = hy.parameter(0.0)

    def passed(self, t, s, k):
        place = self.of_time * t + (1.0 - self.of_time) * s.x
        return self.first + k * self.apart - place

    @hy.mode
    def runs(self, t, s):
        return 1.0, 0.0, 0.0

    @hy.edge(runs, to=runs, guard=lambda self, t, s: self.passed(t, s, 0))
    def one(self, t, s):
        return s.replace(n=10 * s.n + 1)

    @hy.edge(runs, to=runs, guard=lambda self, t, s: self.passed(t, s, 1))
    def two(self, t, s):
        return s.replace(n=10 * s.n + 2)

    @hy.edge(runs, to=runs, guard=lambda self, t, s: self.passed(t, s, 2))
    def three(self, t, s):
        return s.replace(n=10 * s.n + 3)


@pytest.mark.parametrize("way", WAYS[:5], indirect=True)
@pytest.mark.parametrize("of_time", [0.0, 1.0])
@pytest.mark.parametrize(("first", "apart"), [(1e-14, 2e-15), (1e-15, 1e-15), (3e-17, 1e-18)])
def test_events_next_to_each_other_fire_once_each_at_their_times(way, first, apart, of_time):
    """However near to each other: what is far from zero beside them has no part in it."""
    model = Burst(first=first, apart=apart, of_time=of_time)
    result = way.run(model, [0.0, 0.0, 1e3], (0.0, 1.0), rtol=1e-9)
    assert result.final.n == 123.0
    if way.tells("times"):
        # what is read off a step of length one is known to the rounding of one
        atol = 1e-16 if way.name in ("Radau", "Dopri8") else 0.0
        np.testing.assert_allclose(result.times, first + apart * np.arange(3), 1e-12, atol)


class Wall(hy.Automaton):
    """A ball over a floor that is written as an edge; ``less`` is what a bounce loses of the speed
    beside a share."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)
    less = hy.parameter(0.0)

    @hy.mode
    def flies(self, t, s):
        return s.v, -2.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.x)
    def hit(self, t, s):
        return s.replace(v=-self.r * s.v - self.less)


def test_a_wall_whose_reset_leaves_no_speed_is_not_fallen_through(way):
    """What is beyond is out of the mode; nothing says what follows."""
    result = way.run(Wall(r=0.0), [1.0, 0.0], (0.0, 4.0))
    assert result.status == "refused"


def test_a_wall_that_only_slows_what_comes_is_passed(way):
    """With a quarter of the speed, onwards."""
    result = way.run(Wall(r=0.5, less=1.5), [1.0, 0.0], (0.0, 2.0), rtol=1e-9)
    assert result.final.x == pytest.approx(-1.5, rel=1e-6)


class Peaks(hy.Automaton):
    """A ball over a floor that pushes it up from 6 to 7; of its peaks are kept the last height, the
    sum of heights, or their number."""

    x = hy.state()
    v = hy.state()
    last = hy.state()
    total = hy.state()
    n = hy.state()
    count = hy.parameter(0.0)

    @hy.mode
    def flies(self, t, s):
        return s.v, jnp.where((t > 6.0) & (t < 7.0), 3.0, -2.0), 0.0, 0.0, 0.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.v)
    def peak(self, t, s):
        return s.replace(last=s.x, total=s.total + s.x, n=s.n + self.count)

    floor = hy.contact(flies, gap=lambda self, t, s: s.x, restitution=0.5)


def test_a_contact_rests_whose_flights_are_seen_by_an_event(way):
    """From the floor with 2: peaks of 1, 1/4, 1/16, ...; at rest at 4; thrown up, a peak at 8.5."""
    result = way.run(Peaks(), [0.0, 2.0, 0.0, 0.0, 0.0], (0.0, 5.0))
    assert result.t_inf == pytest.approx(4.0, rel=1e-7)
    assert result.final.total == pytest.approx(4.0 / 3.0, rel=1e-7)
    assert abs(result.final.last) <= 1e-12
    result = way.run(Peaks(), [0.0, 2.0, 0.0, 0.0, 0.0], (0.0, 8.6))
    assert result.final.last == pytest.approx(3.75, rel=1e-6)


def test_a_count_that_has_no_limit_is_named(way):
    result = way.run(Peaks(count=1.0), [0.0, 2.0, 0.0, 0.0, 0.0], (0.0, 5.0))
    assert result.status == "jump_loop"
    if way.tells("run"):
        assert "each time a reset has changed n," in result.said


class Top(hy.Automaton):
    """A ball on its way up to a mark, which is counted, as is the top of its flight."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    tops = hy.state()
    mark = hy.parameter(0.25)

    @hy.mode
    def flies(self, t, s):
        return s.v, -8.0, 0.0, 0.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.x - self.mark, crossing=hy.EITHER)
    def passes(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.v)
    def turns(self, t, s):
        return s.replace(tops=s.tops + 1)


@pytest.mark.parametrize("length", [0.4375, 0.5, 0.7, 1.0])
def test_a_mark_that_is_touched_is_not_passed(way, length):
    """The top of the flight is at the mark, which is then no crossing, there and back: however
    steps lie about it. A mark a thousandth lower is passed twice."""
    starts, given = [[0.0, 2.0, 0.0, 0.0]] * 2, {"mark": [0.25, 0.249]}
    touched, passed = way.many(Top(), starts, (0.0, length), given, rtol=1e-9)
    assert (touched.final.n, touched.final.tops) == (0, 1)
    assert (passed.final.n, passed.final.tops) == (2, 1)
