"""A guard that jumps over zero fires there; one that has no value beyond is never passed."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import later, spread

WAYS = ["DOP853", "Radau", "LSODA", "taylor", "Dopri8", "ensemble", "as_function"]


class Flag(hy.Automaton):
    """A state that grows at a pace and is set back where a flag falls; ``low`` is the flag's value
    beyond."""

    x = hy.state()
    n = hy.state()
    at = hy.parameter(1.234)
    low = hy.parameter(-1.0)
    pace = hy.parameter(1.0)

    @hy.mode
    def on(self, t, s):
        return self.pace, 0.0

    @hy.edge(on, to=on, guard=lambda self, t, s: jnp.where(s.x < self.at, 1.0, self.low))
    def back(self, t, s):
        return s.replace(x=0.0, n=s.n + 1)


class Rising(hy.Automaton):
    """The same with a flag that rises, of the time's sine."""

    n = hy.state()
    w = hy.parameter(3.0)

    @hy.mode(initial=True)
    def low(self, t, s):
        return (0.0,)

    @hy.mode
    def high(self, t, s):
        return (0.0,)

    @hy.edge(
        low,
        to=high,
        guard=lambda self, t, s: jnp.sign(jnp.sin(self.w * t + 0.5) - 0.9) - 0.5,
        crossing=hy.RISING,
    )
    def up(self, t, s):
        return s.replace(n=s.n + 1)


class Root(hy.Automaton):
    """A tank that runs dry; its guard, the square root of the level, exists above zero only."""

    x = hy.state()
    n = hy.state()
    pace = hy.parameter(1.0)
    off = hy.parameter(0.0)

    @hy.mode
    def runs(self, t, s):
        return -self.pace, 0.0

    @hy.edge(runs, to=runs, guard=lambda self, t, s: jnp.sqrt(s.x) + self.off)
    def filled(self, t, s):
        return s.replace(x=1.0, n=s.n + 1)


class Logarithm(hy.Automaton):
    """A guard ``x log x``, zero at the end of where it exists; and ``log x`` that is not."""

    x = hy.state()
    n = hy.state()
    share = hy.parameter(1.0)

    @hy.mode
    def runs(self, t, s):
        return -1.0, 0.0

    @hy.edge(
        runs,
        to=runs,
        guard=lambda self, t, s: (self.share * s.x + 1 - self.share) * jnp.log(s.x),
        crossing=hy.RISING,
    )
    def filled(self, t, s):
        return s.replace(x=0.5, n=s.n + 1)


class Corner(hy.Automaton):
    """A ball over a floor that is written as a distance, g = 2."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    floor = hy.contact(flight, gap=lambda self, t, s: jnp.abs(s.x), restitution=0.5)


class Saw(hy.Automaton):
    """A guard that falls to zero at each whole number, and jumps back up."""

    x = hy.state()
    n = hy.state()

    @hy.mode
    def on(self, t, s):
        return 1.0, 0.0

    @hy.edge(on, to=on, guard=lambda self, t, s: 1.0 - jnp.mod(s.x, 1.0))
    def tick(self, t, s):
        return s.replace(n=s.n + 1)


class Ramp(hy.Automaton):
    """A level over a saw of time, under which it is low, and above which it is high."""

    level = hy.state()
    period: float = hy.parameter(1.0)

    def above(self, t, s):
        return s.level - self.period * (t / self.period - jnp.floor(t / self.period))

    @hy.mode(initial=True)
    def high(self, t, s):
        return 0.0

    @hy.mode
    def low(self, t, s):
        return 0.0

    falls = hy.edge(high, to=low, guard=above)
    wraps = hy.edge(low, to=high, guard=above, crossing=hy.RISING)


@pytest.mark.parametrize("turn", [1000, *later(0)])
def test_a_saw_of_time_wraps_where_its_own_rounding_has_it(way, turn):
    """At whole periods, to a few spacings of the time, by whatever formula it is told, and at the
    last time of a run as well; the mode behind the jump sees the saw as it is beyond it."""
    periods = [1.0, 0.1, 0.3, 400e-6, 0.4389616300445631, np.pi / 7]
    for period in periods:
        t, wraps = (turn + 0.1) * period, np.arange(turn + 1, turn + 13) * period
        result = way.run(Ramp(period=period), {"level": 0.25 * period}, (t, float(wraps[-1])))
        assert result.jumps in (23, 24)  # as the last time is rounded
        expected = np.sort([*wraps - 0.75 * period, *wraps])[: result.jumps]
        np.testing.assert_allclose(result.times, expected, rtol=1e-13, atol=1e-12 * period)


@pytest.mark.parametrize("since", [0.0, 1e6])
def test_a_saw_fires_at_each_tooth(way, since):
    """Where it fires it has jumped already, and is not zero when the next arc begins."""
    result = way.run(Saw(), {"x": 0.3, "n": 0.0}, (since, since + 5.0), rtol=1e-9)
    assert result.final.n == 5.0
    if way.tells("times"):
        np.testing.assert_allclose(result.times - since, np.arange(5) + 0.7, rtol=1e-9)


@pytest.mark.parametrize("at", [1.234, 0.3, 2.0])
@pytest.mark.parametrize("low", [-1.0, -1e-9, 0.0])
def test_a_flag_fires_where_it_falls(way, at, low):
    """Every time that x passes ``at``: below zero, or onto it, by however little."""
    result = way.run(Flag(at=at, low=low), {"x": 0.0, "n": 0.0}, (0.0, 3.1 * at), rtol=1e-9)
    assert result.final.n == 3.0
    assert result.final.x == pytest.approx(0.1 * at, abs=1e-9)
    if way.tells("times"):
        np.testing.assert_allclose(result.times, at * np.arange(1, 4), rtol=1e-12)


@pytest.mark.parametrize("pace", [1e-3, 1e3])
def test_a_flag_fires_whatever_the_units_of_time(way, pace):
    """The same motion, slower and faster."""
    result = way.run(Flag(pace=pace), {"x": 0.0, "n": 0.0}, (0.0, 3.0 / pace), rtol=1e-9)
    assert result.final.n == 2.0
    assert result.final.x == pytest.approx(3.0 - 2 * 1.234, rel=1e-9)


def test_a_flag_that_changes_and_stays_positive_does_not_fire(way):
    """From 1 to 0.5."""
    result = way.run(Flag(low=0.5), {"x": 0.0, "n": 0.0}, (0.0, 3.0), rtol=1e-9)
    assert (result.final.n, result.final.x) == (0.0, pytest.approx(3.0, abs=1e-12))


@pytest.mark.parametrize("w", [3.0, 0.9])
def test_a_sign_fires_where_it_rises(way, w):
    """The first time at which the sine is above 0.9."""
    result = way.run(Rising(w=w), {"n": 0.0}, (0.0, 3.0 / w), rtol=1e-9)
    assert result.final.n == 1.0
    if way.tells("times"):
        assert result.times[0] == pytest.approx((np.arcsin(0.9) - 0.5) / w, rel=1e-12)


@pytest.mark.parametrize("pace", [1.0, 0.21])
def test_a_root_fires_where_it_ends(way, pace):
    """The level reaches zero: there the guard is zero, and beyond it has no value."""
    result = way.run(Root(pace=pace), {"x": 1.0, "n": 0.0}, (0.0, 3.5 / pace), rtol=1e-9)
    assert result.final.n == 3.0
    assert result.final.x == pytest.approx(0.5, abs=1e-9)


def test_a_guard_that_ends_before_it_is_zero_is_refused(way):
    """``1 + sqrt(x)`` at x = 0: neither fired nor passed."""
    result = way.run(Root(off=1.0), {"x": 1.0, "n": 0.0}, (0.0, 3.5), rtol=1e-9)
    assert result.status == "not_finite"
    assert "not finite" in result.said


def test_a_logarithm_fires_where_its_product_ends(way):
    """``x log x`` rises to zero at x = 0."""
    result = way.run(Logarithm(), {"x": 0.5, "n": 0.0}, (0.0, 1.2), rtol=1e-9)
    assert result.final.n == 2.0
    assert result.final.x == pytest.approx(0.3, abs=1e-6)  # where x log x is rounding of 1


def test_a_logarithm_that_ends_is_refused(way):
    """``log x`` falls to minus infinity and ends."""
    result = way.run(Logarithm(share=0.0), {"x": 0.5, "n": 0.0}, (0.0, 1.2), rtol=1e-9)
    assert result.status == "not_finite"


@pytest.mark.parametrize("since", [0.0, 1e6])
def test_a_distance_is_a_gap(way, since):
    """From both sides ``|x|`` reaches zero at 0: the ball bounces, as over the gap ``x``; also far
    from ``t = 0``, where rounding of the time is a large share of a low flight."""
    result = way.run(Corner(), {"x": 1.0, "v": 0.0}, (since, since + 5.0), rtol=1e-9)
    assert result.final.x == pytest.approx(0.0, abs=1e-12)
    assert result.t_inf - since == pytest.approx(3.0, abs=1e-8)


class Root2(Corner):
    """The same over the root of a square."""

    floor = hy.contact("flight", gap=lambda self, t, s: jnp.sqrt(s.x**2), restitution=0.5)


class Shaken(Corner):
    """The same over a floor that moves."""

    floor = hy.contact(
        "flight", gap=lambda self, t, s: jnp.abs(s.x - 0.01 * jnp.sin(t)), restitution=0.5
    )


class Rubbed(Corner):
    """The same with friction in the air."""

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0 - 0.5 * jnp.sign(s.v)

    floor = hy.contact(flight, gap=lambda self, t, s: jnp.abs(s.x), restitution=0.5)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_the_root_of_a_square_is_a_distance(solver):
    """It comes to zero with a corner and turns back."""
    run = hy.simulate(Root2(), [1.0, 0.0], (0, 5), solver=solver)
    assert run.zeno[0].t == pytest.approx(3.0, abs=1e-8)
    assert run.mode == "flight.rest(floor)"


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(
    "gap", [lambda x: jnp.maximum(x, 2 * x), lambda x: jnp.where(x > 0, x, -3 * x)]
)
def test_a_gap_whose_two_sides_differ_where_it_is_zero_is_refused(gap, solver):
    """Its speed there is not that with which the body comes: the error says what to write."""

    class Uneven(Corner):
        floor = hy.contact("flight", gap=lambda self, t, s: gap(s.x), restitution=0.5)

    with pytest.raises(hy.FlowError, match="where the gap is positive"):
        hy.simulate(Uneven(), [1.0, 0.0], (0, 5), solver=solver)


@pytest.mark.parametrize(
    ("cls", "by"),
    spread([Shaken, Rubbed], ["scipy", "taylor"], of=2),
)
def test_a_distance_from_what_moves_or_with_friction_is_a_gap(cls, by):
    """As over the gap without its corner, which is never negative."""

    class Plain(cls):
        floor = hy.contact(
            "flight",
            gap=lambda self, t, s: s.x - (0.01 * jnp.sin(t) if cls is Shaken else 0.0),
            restitution=0.5,
        )

    given = {"solver": by, "max_jumps": 100}  # the plain gap takes a few, and a sum
    one, other = (hy.simulate(c(), [1.0, 0.0], (0, 5), **given) for c in (cls, Plain))
    assert one.zeno[0].t == pytest.approx(other.zeno[0].t, abs=1e-7)
    assert one.zeno[0].t_error < 1e-7


def over(gap, restitution=0.5):
    """A ball over a gap, with a state ``y`` that swings, g = 2."""

    class Ball(hy.Automaton):
        x = hy.state()
        v = hy.state()
        y = hy.state()
        z = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -2.0, s.z, -9.0 * s.y

        floor = hy.contact(flight, gap=gap, restitution=restitution)

    return Ball()


def as_over_the_plain_gap(distance, place, restitution, by):
    """The runs over ``distance(x - place)`` and over ``x - place`` show the same."""
    gaps = (lambda self, t, s: distance(s.x - place(t, s)), lambda self, t, s: s.x - place(t, s))
    start = [1.0, 0.0, 1.0, 0.3]
    one, other = (
        hy.simulate(over(gap, restitution), start, (0, 8), solver=by, max_jumps=200) for gap in gaps
    )
    assert one.mode == other.mode
    assert len(one.zeno) == len(other.zeno)
    for a, b in zip(one.zeno, other.zeno, strict=True):
        assert abs(a.t - b.t) <= a.t_error + b.t_error < 1e-7
    # within the solvers' error, which the plain run's own tolerance of 1e-9 grows to
    np.testing.assert_allclose(one.final.x, other.final.x, atol=1e-7)
    return one


LAWS = [0.5, 0.2, lambda self, t, s, u: 0.5 + 0.3 / (1 + u * u)]
PLACES = [
    lambda t, s: 0.001 * jnp.sin(30 * t),
    lambda t, s: 0.1 * jnp.sin(3 * t),
    lambda t, s: 0.1 * s.y,
    lambda t, s: 0.01 * jnp.sin(t) - 1000.1,
]


@pytest.mark.parametrize(("place", "restitution", "by"), spread(PLACES, LAWS, ["scipy", "taylor"]))
def test_a_distance_is_a_gap_however_its_place_moves(place, restitution, by):
    """Fast, far, by a state; with a restitution that depends on the speed."""
    as_over_the_plain_gap(jnp.abs, place, restitution, by)


DISTANCES = [
    jnp.abs,
    lambda u: jnp.sqrt(u**2),
    lambda u: jnp.maximum(u, -u),
    lambda u: jnp.where(u >= 0, u, -u),
    lambda u: jnp.where(u >= 0, u, -3 * u),
]


@pytest.mark.parametrize(("distance", "by"), spread(DISTANCES, ["scipy", "taylor"], of=2))
def test_a_contact_with_a_distance_is_released_as_another(distance, by):
    """It comes to rest on a floor that later falls away faster than the body, and again."""
    run = as_over_the_plain_gap(distance, lambda t, s: 0.5 * jnp.sin(2.2 * t), 0.5, by)
    assert len(run.zeno) == 2
    assert "floor.release" in run.jumps.edge


@pytest.mark.parametrize("by", ["scipy", "taylor"])
@pytest.mark.parametrize("place", [lambda t: 0.0, lambda t: 0.01 * jnp.sin(t)])
def test_a_distance_met_from_its_other_side_is_refused(place, by):
    """At once, and after impacts from the side whose formula it has at zero."""

    class Thrown(hy.Automaton):
        x = hy.state()
        v = hy.state()
        g = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -s.g, 0.0

        floor = hy.contact(flight, gap=lambda self, t, s: jnp.abs(s.x - place(t)), restitution=0.5)

        @hy.edge(flight, to=flight, guard=lambda self, t, s: 1.5 - t)
        def turn(self, t, s):
            return s.replace(x=-s.x, v=-s.v, g=-s.g)

    for start in ([-1.0, 0.0, -2.0], [1.0, 0.0, 2.0]):
        with pytest.raises(hy.FlowError, match="where the gap is positive"):
            hy.simulate(Thrown(), start, (0, 5), solver=by)


def test_a_truth_value_is_no_guard():
    """It is refused where the class is defined, in words that say what to write."""
    with pytest.raises(hy.DeclarationError, match="a number, not a truth value"):

        class Boolean(hy.Automaton):
            x = hy.state()

            @hy.mode
            def on(self, t, s):
                return (1.0,)

            @hy.edge(on, to=on, guard=lambda self, t, s: s.x < 1.0)
            def back(self, t, s):
                return s


class Whole(hy.Automaton):
    """A number that grows, and stops where its whole part has come to 2."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def grows(self, t, s):
        return 1.0, 0.0

    @hy.mode
    def stays(self, t, s):
        return 0.0, 0.0

    @hy.edge(grows, to=stays, guard=lambda self, t, s: jnp.floor(s.x) - 2.0, crossing=hy.RISING)
    def full(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_a_guard_that_jumps_onto_zero_fires_also_where_a_step_ends(way, start):
    """Steps end on whole numbers, and their last state has the guard's value beyond: zero."""
    until = np.array([2.5, 2.9, 3.4, 3.7])
    for result in way.many(Whole(), [[start, 0.0]] * len(until), (0.0, until)):
        assert result.final.n == 1.0
        assert result.final.x == pytest.approx(2.0, abs=1e-9)


class Braked(hy.Automaton):
    """A ball with g = 2 on a floor below which it would be heavier; of a fast impact half is left,
    of a slow one more."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -2.0 - jnp.where(s.x < 0.0, 1.0, 0.0)

    def law(self, t, s, u):
        return jnp.where(-u > 1.5, 0.5, 0.9)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=law)


def test_a_reset_has_its_own_formula_where_the_flow_changes_at_the_contact(way):
    """What the flow is about to do at the contact, where its own kink is zero, is nothing to it."""
    result = way.run(Braked(), {"x": 1.0, "v": 0.0}, (0.0, 3.8), rtol=1e-9)
    left = 3.8 - (1.0 + 1.0 + 0.9 + 0.81)
    assert result.final.x == pytest.approx(0.729 * left - left**2, abs=1e-8)
    if way.tells("times"):
        np.testing.assert_allclose(result.times, [1.0, 2.0, 2.9, 3.71], rtol=1e-8)


class Faint(hy.Automaton):
    """A guard with a corner away from zero, in a unit in which it is next to nothing."""

    x = hy.state()
    n = hy.state()
    k = hy.parameter(1.0)

    @hy.mode(initial=True)
    def on(self, t, s):
        return 1.0, 0.0

    @hy.edge(on, to=on, guard=lambda self, t, s: self.k * (1.0 - jnp.abs(s.x)))
    def back(self, t, s):
        return s.replace(x=-0.5, n=s.n + 1)


@pytest.mark.parametrize("k", [1.0, 1e-200])
def test_a_corner_is_no_zero_in_any_unit(way, k):
    """At |x| = 1 alone, not where x passes zero."""
    result = way.run(Faint(k=k), {"x": -0.5, "n": 0.0}, (0.0, 4.0), rtol=1e-9)
    assert (result.final.n, result.final.x) == (2.0, pytest.approx(0.5, abs=1e-8))


class Sawn(hy.Automaton):
    """A saw whose edge throws the state back to ``r`` of its way short of the tooth: the teeth
    close in on a point."""

    x = hy.state()
    n = hy.state()
    r = hy.parameter(0.5)

    @hy.mode(initial=True)
    def on(self, t, s):
        return 1.0, 0.0

    @hy.edge(on, to=on, guard=lambda self, t, s: 1.3 - jnp.mod(s.x, 1.3))
    def tick(self, t, s):
        return s.replace(x=1.3 - 0.4 * self.r**s.n, n=s.n + 1)


@pytest.mark.parametrize("since", [3.3, *later(0.0)])
def test_no_tooth_of_a_saw_is_passed_after_however_short_a_flight(way, since):
    """Each is as far as rounding of the saw from zero where it jumps, also of flights so short that
    the saw itself is small from end to end."""
    spans = 0.3 + 0.8 * (1.0 - 0.5 ** np.arange(1, 21))
    until = since + spans + 0.2 * 0.5 ** np.arange(1, 21)
    for count, result in enumerate(
        way.many(Sawn(), [[1.0, 0.0]] * len(until), (since, until)), start=2
    ):
        assert result.final.n == count


class Driven(hy.Automaton):
    """A driven state, with a saw of itself that never reaches zero (``p`` < 1), and a saw of time
    that it passes, which counts."""

    x = hy.state()
    v = hy.state()
    teeth = hy.discrete(0)
    passed = hy.discrete(0)
    p: float = hy.parameter(1.0)
    w: float = hy.parameter(1.0)
    back: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def on(self, t, s):
        return s.v, -0.3 * self.w * s.x + jnp.cos(self.w * t)

    @hy.edge(on, to=on, guard=lambda self, t, s: 1.0 - jnp.mod(s.x, self.p))
    def tooth(self, t, s):
        return s.replace(teeth=s.teeth + 1)

    @hy.edge(
        on,
        to=on,
        guard=lambda self, t, s: s.x - self.p * (t / self.p - jnp.floor(t / self.p)),
        crossing=hy.EITHER,
    )
    def passes(self, t, s):
        return s.replace(x=s.x - self.back, passed=s.passed + 1)


@pytest.mark.parametrize("way", ["DOP853", "taylor"], indirect=True)
@pytest.mark.parametrize(
    ("p", "w", "x", "v"),
    [
        (0.9802144832458515, 2.481969727450675, 0.025862643025213017, 1.861603308744421),
        (0.9192222463529294, 2.639227048368511, -0.04687149665129864, 1.8454311150722977),
        (0.8421380035922615, 2.1305789971054008, -0.03378714369874214, 0.5180301254996437),
        (0.6892815063348896, 1.465658949203789, -0.13528922379488065, 1.154084039797619),
        (0.4815476403351425, 1.0354070133454134, 0.24369523541222476, 0.3796400569259068),
    ],
)
def test_a_step_that_ends_on_a_jump_shows_no_zero_that_is_not_there(way, p, w, x, v):
    """There its last or first value is beyond, or before, the jump by rounding."""
    asked = {"rtol": 1e-10, "atol": 1e-12, "max_jumps": 200}
    run = way.run(Driven(p=p, w=w), {"x": x, "v": v}, (0.0, 6.0), **asked).run
    t = np.linspace(0.0, 6.0, 60_001)
    seen = run(t).x - p * (t / p - np.floor(t / p))
    assert run.final.teeth == 0
    assert run.final.passed == np.count_nonzero(np.diff(np.sign(seen)))


@pytest.mark.parametrize("way", ["DOP853", "taylor"], indirect=True)
@pytest.mark.parametrize(
    ("p", "w", "x", "v"),
    [
        (1.4215276269545352, 1.8756857811132988, -0.03954021726039919, 1.7676473867680946),
        (0.6778505091184815, 2.154563366443063, -0.21686599088530734, 1.9765773738033836),
        (1.013145501162707, 1.324065026469023, -0.037618497376493254, 1.5689421719626904),
    ],
)
def test_a_jump_over_zero_at_the_end_of_a_step_fires_there(way, p, w, x, v):
    """And nowhere before: each edge fires where its guard is zero, or jumps."""
    asked = {"rtol": 1e-10, "atol": 1e-12, "max_jumps": 200}
    run = way.run(Driven(p=p, w=w, back=1.5), {"x": x, "v": v}, (0.0, 6.0), **asked).run
    jumps = [jump for jump in run.jumps if jump.edge == "passes"]
    t = np.array([jump.t for jump in jumps])
    turns = t / p
    value = np.array([jump.before.x for jump in jumps]) - p * (turns - np.floor(turns))
    wraps = np.abs(turns - np.round(turns)) < 1e-9
    assert len(jumps) > 0
    assert np.all(wraps | (np.abs(value) < 1e-9))


#: Functions with the sign of ``x``.
SIGNED = {
    "x": lambda x: x,
    "sign": jnp.sign,
    "where": lambda x: jnp.where(x < 0.0, -2.0, 3.0),
    "floor": lambda x: jnp.floor(x) + 0.5,
}


@cache
def reflected(name):
    """An oscillator that loses speed where a function of its place changes its sign; ``back``: of
    its speed, what it has then."""

    class Reflected(hy.Automaton):
        x = hy.state()
        v = hy.state()
        back: float = hy.parameter(-0.6)

        @hy.mode(initial=True)
        def on(self, t, s):
            return s.v, -s.x

        @hy.edge(on, to=on, guard=lambda self, t, s: SIGNED[name](s.x), crossing=hy.EITHER)
        def hit(self, t, s):
            return s.replace(v=self.back * s.v)

    return Reflected


@pytest.mark.parametrize("back", [-0.6, pytest.param(-0.05, marks=pytest.mark.every_way), 0.6])
@pytest.mark.parametrize("name", SIGNED)
def test_a_guard_that_jumps_fires_as_often_as_one_that_is_smooth(way, name, back):
    """Once, also where its own reset turns the flow back: the state is beyond the jump by rounding
    alone. Between impacts there is half a period."""
    start, t1 = 2.0, 2.0 + 3.2 * np.pi
    model = reflected(name)(back=back)
    begin, tight = {"x": np.cos(0.1), "v": -np.sin(0.1)}, {"rtol": 1e-10, "atol": 1e-13}
    result = way.run(model, begin, (start, t1), **tight)
    times = start - 0.1 + np.pi * np.arange(0.5, 3.5)
    speed = -(back**3) * np.cos(0.7 * np.pi + 0.1)
    np.testing.assert_allclose(result.times, times, rtol=1e-8)
    assert result.final.v == pytest.approx(speed, rel=1e-6)
