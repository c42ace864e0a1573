"""Edges that end a run, edges with a condition, and urgent ones, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering.jit import jit

from .contract.ways import WAYS

#: One of each mechanism.
SOME = ["DOP853", "Radau", "taylor", "Tsit5", "ensemble", "as_function"]

ways = pytest.mark.parametrize("way", [WAYS[name] for name in SOME], ids=SOME)


class Shot(hy.Automaton):
    """Ends on the ground: t = (v + sqrt(v^2 + 2 g y)) / g."""

    y = hy.state()
    v = hy.state()
    g: float = hy.parameter(2.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -self.g

    @hy.edge(flight, to=hy.TERMINATE, guard=lambda self, t, s: s.y)
    def ground(self, t, s):
        return s.replace(v=0.5 * s.v)


START = {"y": 3.0, "v": 1.0}
HIT = (1.0 + np.sqrt(13.0)) / 2.0


@ways
def test_a_run_ends_at_the_zero_of_a_guard(way):
    """At the exact time, with the state that the reset gives; the jump is recorded."""
    result = way.run(Shot(), START, (0.0, 100.0), rtol=1e-9)
    assert (result.status, result.jumps) == ("terminated", 1)
    assert result.t == pytest.approx(HIT, rel=1e-9)  # a parabola: methods are exact
    assert result.final.v == pytest.approx(-0.5 * np.sqrt(13.0), rel=1e-8)
    assert result.times[0] == result.t
    assert "hy.TERMINATE" in result.said


def test_the_sentence_names_the_edge_and_survives_a_file(tmp_path):
    """What is printed, explained and loaded says which edge has ended the run."""
    run = hy.simulate(Shot(), START, (0.0, 100.0))
    assert run.status is hy.Status.TERMINATED
    assert [arc.mode for arc in run.arcs] == ["flight", "flight"]
    assert run.t1 == run.jumps.t[-1]
    run.save(tmp_path / "run.nc")
    for each in (run, hy.load(tmp_path / "run.nc")):
        assert each.status is hy.Status.TERMINATED
        assert "the edge ground" in each.explain()
        assert "the edge ground" in repr(each)


def test_lanes_end_each_at_its_own_time():
    """Some come to the ground and some to the last time, which their status says."""
    v = np.array([0.0, 1.0, 2.0, 8.0])
    lanes = hy.ensemble(Shot(), {"y": 3.0, "v": v}, (0.0, 5.0))
    assert lanes.status.values.tolist() == ["terminated"] * 3 + ["reached_end"]
    exact = (v + np.sqrt(v**2 + 12.0)) / 2.0
    np.testing.assert_allclose(lanes.t.values, np.minimum(exact, 5.0), rtol=1e-14)


@pytest.fixture
def wide():
    """64 bits also on the thread on which JAX calls back."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def test_derivatives_of_the_time_of_the_end(wide):
    """First and second: those of (v + sqrt(v^2 + 2 g y)) / g."""
    end = hy.as_function(Shot(), t=(0.0, 100.0), max_jumps=4)
    time = lambda v: end(Shot(), {"y": 3.0, "v": v}).t  # noqa: E731
    first, second = jit(jax.grad(time))(1.0), jit(jax.grad(jax.grad(time)))(1.0)
    assert first == pytest.approx((1.0 + 1.0 / np.sqrt(13.0)) / 2.0, rel=1e-13)
    assert second == pytest.approx(6.0 / 13.0**1.5, rel=1e-12)


class Seen(Shot):
    """Its acceleration is the speed it had, a lag ago: the speed goes on as it was."""

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return past(1.0).v, -self.g


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_run_with_delays_ends(solver):
    """y' = v(t - 1) with v = 1 before: y = 3 + t, then 3 + 1 + s - s^2, s = t - 1."""
    run = hy.simulate(Seen(), START, (0.0, 9.0), history={"y": 3.0, "v": 1.0}, solver=solver)
    assert run.status is hy.Status.TERMINATED
    assert run.t1 == pytest.approx(1.0 + (1.0 + np.sqrt(17.0)) / 2.0, rel=1e-8)


def test_a_map_beyond_the_end_says_so():
    """A run that has ended does not return; to the edge that ends it there is a map."""
    assert hy.return_map(Shot(), "ground")(START).v == pytest.approx(-0.5 * np.sqrt(13.0))
    with pytest.raises(hy.OrbitError, match="TERMINATE"):
        hy.return_map(Shot(), lambda self, t, s: s.y + 1.0)(START)


def test_a_run_may_not_end_on_its_way_to_no_mode():
    """What is no mode is refused as before."""
    with pytest.raises(hy.DeclarationError, match="is no mode"):

        class Wrong(Shot):
            wrong = hy.edge("flight", to="TERMINATE", guard=lambda self, t, s: s.v)


class Clock(hy.Automaton):
    """A rotation, x = sin t, with conditions on zeros of x: where it falls y = cos t is below 0."""

    x = hy.state()
    y = hy.state()
    n = hy.state()
    level: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def turn(self, t, s):
        return s.y, -s.x, 0.0

    @hy.edge(
        turn,
        to=turn,
        guard=lambda self, t, s: s.x,
        crossing=hy.EITHER,
        when=lambda self, t, s: s.y < self.level,
    )
    def zero(self, t, s):
        return s.replace(n=s.n + 1)


@ways
@pytest.mark.parametrize(("level", "count"), [(0.0, 3), (2.0, 6), (-2.0, 0)])
def test_a_zero_is_passed_where_the_condition_fails(way, level, count):
    """Zeros of sin t up to 19: at pi, 3 pi, 5 pi the cosine is below 0; all six, or none, are
    counted where the level says so."""
    result = way.run(Clock(level=level), {"x": 0.0, "y": 1.0, "n": 0.0}, (0.0, 19.0), rtol=1e-9)
    assert (result.status, result.final.n, result.jumps) == ("reached_end", count, count)
    if count == 3:
        # global errors of the methods at this tolerance
        np.testing.assert_allclose(result.times, np.pi * np.array([1, 3, 5]), atol=1e-6)


class Fork(hy.Automaton):
    """Two edges on one guard: of a count that is even one fires, of an odd one the other."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0, 0.0

    @hy.edge(
        up,
        to=up,
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n == 2.0,
    )
    def last(self, t, s):
        return s.replace(x=0.0 * s.x, n=10.0)

    @hy.edge(
        up,
        to=up,
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n != 2.0,
    )
    def more(self, t, s):
        return s.replace(x=0.0 * s.x, n=s.n + 1)


@ways
def test_of_two_edges_with_complementary_conditions_one_fires(way):
    """The count is exact on every solver: 0, 1, 2, then 10, 11."""
    result = way.run(Fork(), {"x": 0.0, "n": 0.0}, (0.0, 4.5))
    if way.tells("edges"):
        assert result.edges == ["more", "more", "last", "more"]
    np.testing.assert_allclose(result.times, [1.0, 2.0, 3.0, 4.0], rtol=1e-12)
    assert (result.final.n, result.jumps) == (11.0, 4)


class Toggle(Fork):
    """The reset makes the other's condition true, and leaves the guard at its zero."""

    @hy.edge(
        "up",
        to="up",
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n == 2.0,
    )
    def last(self, t, s):
        return s.replace(n=0.0)

    @hy.edge(
        "up",
        to="up",
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n != 2.0,
    )
    def more(self, t, s):
        return s.replace(n=2.0)


@ways
@pytest.mark.parametrize(("n", "edge", "then"), [(0.0, "more", 2.0), (2.0, "last", 0.0)])
def test_the_condition_is_read_before_the_jump(way, n, edge, then):
    """Exactly one of the two fires, and not the other as well because the reset has changed it."""
    result = way.run(Toggle(), {"x": 0.0, "n": n}, (0.0, 3.0))
    assert (result.jumps, result.final.n) == (1, then)
    if way.tells("edges"):
        assert result.edges == [edge]


class Rush(hy.Automaton):
    """A counter in a tank that is emptied at once as often as it must be."""

    x = hy.state()
    n = hy.state()
    limit: float = hy.parameter(1.0)

    @hy.mode(initial=True)
    def fill(self, t, s):
        return 1.0, 0.0

    @hy.edge(
        fill,
        to=fill,
        guard=lambda self, t, s: s.x - self.limit,
        crossing=hy.RISING,
        urgent=True,
    )
    def spill(self, t, s):
        return s.replace(x=s.x - 1.0, n=s.n + 1)


@ways
def test_an_urgent_edge_fires_beyond_zero_as_often_as_it_must(way):
    """From 3.5 it spills at once to 2.5, 1.5 and 0.5, and then at 0.5, 1.5, ..."""
    result = way.run(Rush(), {"x": 3.5, "n": 0.0}, (0.0, 2.0))
    np.testing.assert_allclose(result.times, [0.0, 0.0, 0.0, 0.5, 1.5], rtol=1e-12)
    assert result.final.n == 5
    assert result.final.x == pytest.approx(0.5, abs=1e-12)


class Tired(hy.Automaton):
    """A ball that bounces under a weaker force once its energy is below a bound."""

    x = hy.state()
    v = hy.state()
    least: float = hy.parameter(1.0)

    @hy.mode(initial=True)
    def strong(self, t, s):
        return s.v, -8.0

    @hy.mode
    def weak(self, t, s):
        return s.v, -4.0

    hard = hy.contact(strong, gap=lambda self, t, s: s.x, restitution=0.5)
    soft = hy.contact(weak, gap=lambda self, t, s: s.x, restitution=0.5)
    tires = hy.edge(
        strong, to=weak, guard=lambda self, t, s: s.v**2 / 2 + 8.0 * s.x - self.least, urgent=True
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("impacts", [3, 10, 20, 22, 24, 31, 40])
@pytest.mark.parametrize("share", [0.9999, 0.9, 0.3])
def test_an_urgent_edge_fires_when_a_quantity_kept_by_the_flow_falls_below_a_bound(
    share, impacts, solver
):
    """That is told by what the quantity is, not by how large its terms have been before."""
    least = share * 8.0 * 0.25 ** (impacts - 1)  # from a height of one, whose energy is 8
    run = hy.simulate(Tired(least=least), {"x": 1.0, "v": 0.0}, (0.0, 4.0), solver=solver)
    assert [row.edge for row in run.jumps].index("tires") == impacts
    # falls for 0.5, flies for 0.5, 0.25, ..., and then twice as long as it would have
    switched = 1.5 - 0.5 ** (impacts - 1)
    (point,) = run.zeno
    assert abs(point.t - (switched + 2.0 * 0.5 ** (impacts - 1))) <= point.t_error < 1e-9


@ways
@pytest.mark.parametrize("full", [2, 3])
def test_an_urgent_edge_whose_own_jumps_lead_to_zero_fires_there(way, full):
    """From whole buckets it spills to 1, where it is full again, and to 0; then at 1 and 2."""
    result = way.run(Rush(), {"x": float(full), "n": 0.0}, (0.0, 2.5))
    np.testing.assert_allclose(result.times, [0.0] * full + [1.0, 2.0], rtol=1e-12)
    assert result.final.n == full + 2
    assert result.final.x == pytest.approx(0.5, abs=1e-12)  # steps of a line: rounding


class Loop(Rush):
    """Its reset leaves it beyond for ever."""

    @hy.edge("fill", to="fill", guard=lambda self, t, s: s.x - 1.0, crossing=hy.RISING, urgent=True)
    def spill(self, t, s):
        return s.replace(n=s.n + 1)


@ways
def test_an_endless_chain_of_urgent_edges_is_an_error(way):
    """That names the edge."""
    result = way.run(Loop(), {"x": 2.0, "n": 0.0}, (0.0, 2.0))
    assert result.status == "jump_loop"
    if way.tells("run") or way.name == "ensemble":
        assert "spill" in result.said


class Door(hy.Automaton):
    """Urgent with a condition: fires beyond zero on entering only if that holds there."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def walk(self, t, s):
        return 1.0, 0.0

    @hy.mode
    def out(self, t, s):
        return 0.0, 0.0

    @hy.edge(walk, to=walk, guard=lambda self, t, s: s.x - 2.0, crossing=hy.RISING)
    def tick(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(
        walk,
        to=out,
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n > 0.0,
        urgent=True,
    )
    def leave(self, t, s):
        return s.replace(n=-s.n)


@ways
def test_an_urgent_edge_waits_for_its_condition_until_the_mode_is_entered(way):
    """At 1 the condition fails; the tick at 2 makes it true and enters the mode again: it fires.

    A start beyond zero with the condition false is none of the errors.
    """
    for x in (0.0, 1.5):
        result = way.run(Door(), {"x": x, "n": 0.0}, (0.0, 3.0))
        np.testing.assert_allclose(result.times, [2.0 - x, 2.0 - x], rtol=1e-12)
        assert (result.final.n, result.final.x) == (-1.0, pytest.approx(2.0, rel=1e-12))
    result = way.run(Door(), {"x": 1.5, "n": 1.0}, (0.0, 3.0))
    assert (result.jumps, result.final.n, result.final.x) == (1, -1.0, 1.5)


def test_what_cannot_be_meant_is_refused():
    """Together, when the class is made."""
    with pytest.raises(hy.DeclarationError) as fault:

        class Wrong(Rush):
            both = hy.edge(
                "fill",
                to="fill",
                guard=lambda self, t, s: s.x,
                crossing=hy.EITHER,
                urgent=True,
                when=lambda s: s.x,
            )
            maybe = hy.edge("fill", to="fill", guard=lambda self, t, s: s.x, urgent="yes")

    for said in ("edge both, when", "no side beyond", "urgent='yes'"):
        assert said in str(fault.value)


class Buck(hy.Automaton):
    """A DC-DC buck converter: the switch is open while the voltage is above a ramp.

    The ramp falls back at once: an urgent edge opens the switch there. (The one-periodic orbit of
    di Bernardo and others, 1998, at E = 20.)
    """

    V = hy.state(unit="V")
    I = hy.state(unit="A")  # noqa: E741
    p = hy.state(unit="s", doc="time since the ramp began")

    E: float = hy.parameter(20.0)
    T: float = hy.parameter(400e-6)
    R: float = hy.parameter(22.0)
    C: float = hy.parameter(47e-6)
    L: float = hy.parameter(20e-3)

    def off(self, s):
        return s.V - 11.75238 - 1309.524 * s.p

    @hy.mode(initial=True)
    def open(self, t, s):
        return (s.I - s.V / self.R) / self.C, -s.V / self.L, 1.0

    @hy.mode
    def closed(self, t, s):
        return (s.I - s.V / self.R) / self.C, (self.E - s.V) / self.L, 1.0

    @hy.edge(open, to=open, guard=lambda self, t, s: s.p - self.T, crossing=hy.RISING)
    def again(self, t, s):
        return s.replace(p=0.0 * s.p)

    @hy.edge(closed, to=closed, guard=lambda self, t, s: s.p - self.T, crossing=hy.RISING)
    def anew(self, t, s):
        return s.replace(p=0.0 * s.p)

    close = hy.edge(open, to=closed, guard=lambda self, t, s: self.off(s), urgent=True)
    opens = hy.edge(
        closed, to=open, guard=lambda self, t, s: self.off(s), crossing=hy.RISING, urgent=True
    )


@ways
def test_a_buck_converter_comes_back_after_a_period(way):
    """Its orbit of period T, known to 15 digits; ten periods, in each of which it closes, and opens
    at once as the ramp falls back."""
    start = {"V": 11.9695106409271, "I": 0.591571897102699, "p": 0.0}
    result = way.run(Buck(), start, (0.0, 9.9 * 400e-6), rtol=1e-11, atol=1e-12)
    assert result.jumps == 28
    if way.tells("edges"):
        assert result.edges == ["close", "anew", "opens"] * 9 + ["close"]
    fall = [1 + 3 * k for k in range(9)]
    np.testing.assert_allclose(result.times[fall], 400e-6 * np.arange(1, 10), rtol=1e-9)
    # the methods' errors of ten periods; the orbit itself is stable
    np.testing.assert_allclose(result.after.V[fall], start["V"], rtol=1e-8)
    np.testing.assert_allclose(result.after.I[fall], start["I"], rtol=1e-8)


class Walker(hy.Automaton):
    """The simplest walker: the swing leg passes the ground at mid-stance, and strikes it later.

    Garcia, Chatterjee, Ruina and Coleman (1998).
    """

    stance = hy.state()
    rate = hy.state()
    swing = hy.state()
    swing_rate = hy.state()
    slope: float = hy.parameter(0.009)

    @hy.mode
    def step(self, t, s):
        falls = jnp.sin(s.stance - self.slope)
        pulls = s.rate**2 * jnp.sin(s.swing) - jnp.cos(s.stance - self.slope) * jnp.sin(s.swing)
        return s.rate, falls, s.swing_rate, falls + pulls

    @hy.edge(
        step,
        to=step,
        guard=lambda self, t, s: s.swing - 2.0 * s.stance,
        crossing=hy.EITHER,
        when=lambda self, t, s: s.stance < -0.05,
    )
    def strike(self, t, s):
        c = jnp.cos(2.0 * s.stance)
        return -s.stance, c * s.rate, -2.0 * s.stance, c * (1.0 - c) * s.rate


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_the_simplest_walker_walks(solver):
    """Its gait on a slope of 0.009: the period and the angle are known to 12 and 7 digits."""
    start = {"stance": 0.2, "rate": -0.2, "swing": 0.4, "swing_rate": -0.016}
    orbit = hy.periodic_orbit(Walker(), start, section="strike", solver=solver)
    assert orbit.period == pytest.approx(3.882463752851, abs=1e-11)
    assert abs(orbit.run.jumps.after.stance[-1]) == pytest.approx(0.2003109, abs=5e-8)
    assert orbit.stable


class Fading(hy.Automaton):
    """A ball that is caught at once behind the first impact that leaves it slow."""

    x = hy.state()
    v = hy.state()
    slow: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, 0.0 * s.x - 1.0

    @hy.mode
    def caught(self, t, s):
        return 0.0, 0.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
    catch = hy.edge(
        flight,
        to=caught,
        guard=lambda self, t, s: s.x - 100.0,
        when=lambda self, t, s: jnp.abs(s.v) < self.slow,
        urgent=True,
    )


@ways
def test_impacts_are_not_summed_over_an_urgent_edge(way):
    """Speeds 1, 1/2, ..., 1/16 < 0.1: caught behind the fifth impact, far from the limit."""
    result = way.run(Fading(), {"x": 0.0, "v": 2.0}, (0.0, 20.0))
    assert (result.status, result.accumulations or 0) == ("reached_end", 0)
    assert result.jumps == 6
    assert result.final.v == pytest.approx(1.0 / 16.0, rel=1e-8)  # the methods' tolerance
    # flights of 2 v: 4 + 2 + 1 + 1/2 + 1/4
    np.testing.assert_allclose(result.times[-2:], [7.75, 7.75], rtol=1e-7)


class Guarded(hy.Automaton):
    """A ball beside an urgent edge whose guard lies beyond, or not, while the ball is slow."""

    x = hy.state()
    v = hy.state()
    level: float = hy.parameter(100.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, 0.0 * s.x - 1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
    over = hy.edge(
        flight,
        to=hy.TERMINATE,
        guard=lambda self, t, s: s.x - self.level,
        crossing=hy.RISING,
        when=lambda self, t, s: 0.1 - jnp.abs(s.v),
        urgent=True,
    )


@ways
def test_impacts_are_summed_where_an_urgent_edge_is_far(way):
    """A condition decides on nothing while the guard is inside. Flights of 4, 2, 1, ... to 8."""
    result = way.run(Guarded(), {"x": 0.0, "v": 2.0}, (0.0, 20.0))
    (point,) = result.zeno
    assert point.t == pytest.approx(8.0, abs=1e-7)  # the methods' tolerance
    below = way.run(Guarded(level=-1.0), {"x": 0.0, "v": 2.0}, (0.0, 20.0))
    assert (below.status, below.accumulations or 0) == ("terminated", 0)


class Wall(hy.Automaton):
    """The same by a wall that is an edge: it stops to be one for slow balls."""

    x = hy.state()
    v = hy.state()
    slow: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, 0.0 * s.x - 1.0

    @hy.edge(
        flight,
        to=flight,
        guard=lambda self, t, s: s.x,
        when=lambda self, t, s: s.v < -self.slow,
    )
    def bounce(self, t, s):
        return s.replace(v=-0.5 * s.v)


@ways
def test_a_cycle_with_a_condition_is_not_taken_to_its_limit(way):
    """It falls through the wall with the first speed below the threshold: the limit of the impacts
    before is not reached."""
    slow = 1.5 * 2.0**-12
    result = way.run(Wall(slow=slow), {"x": 0.0, "v": 1.0}, (0.0, 6.0), rtol=1e-10, atol=1e-12)
    assert result.jumps == 12
    fallen = 6.0 - 4.0 + 2.0 * 2.0**-12  # 2 (1 + 1/2 + ...) with what is left of it
    assert result.final.x == pytest.approx(-0.5 * fallen**2 - 2.0**-12 * fallen, rel=1e-6)


def test_derivatives_pass_through_a_chain(wide):
    """Both jumps at the time of the first: dt = 1 / (rate); the state behind both is linear."""

    class Chain(Rush):
        @hy.edge("fill", to="fill", guard=lambda self, t, s: s.n - 0.5, urgent=True)
        def back(self, t, s):
            return s.replace(x=0.5 * s.x + 0.6, n=1.0 + s.n)

        @hy.edge("fill", to="fill", guard=lambda self, t, s: s.x - self.limit, crossing=hy.RISING)
        def spill(self, t, s):
            return s.replace(x=s.x - 2.0 * self.limit, n=0.0 * s.n)

    end = hy.as_function(Chain(), t=(0.0, 2.0), max_jumps=8)
    run = end(Chain(), {"x": 0.25, "n": 1.0})
    assert int(run.jumps.count) == 4
    # spills at 0.75 and 1.65, each time to -1 and on to 0.1
    assert float(run.final["x"]) == pytest.approx(0.45, rel=1e-14)
    slope = jax.grad(lambda x: end(Chain(), {"x": x, "n": 1.0}).final["x"])(0.25)
    assert float(slope) == pytest.approx(1.0, rel=1e-14)


class Lagged(Clock):
    """The condition is read from the past: y(t - pi) = -y(t), and the history is a rotation."""

    @hy.edge(
        "turn",
        to="turn",
        guard=lambda self, t, s: s.x,
        crossing=hy.EITHER,
        when=lambda self, t, s, past: past(np.pi).y > 0.0,
    )
    def zero(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_condition_may_look_into_the_past(solver):
    """Where cos t < 0 the cosine was above 0 half a turn ago: at pi, 3 pi and 5 pi."""
    history = {"x": jnp.sin, "y": jnp.cos, "n": 0.0}
    start = {"x": 0.0, "y": 1.0, "n": 0.0}
    run = hy.simulate(Lagged(), start, (0.0, 19.0), history=history, solver=solver)
    np.testing.assert_allclose(run.jumps.t, np.pi * np.array([1, 3, 5]), atol=1e-6)


class Beat(hy.Automaton):
    """A guard that is zero where a clock rings, at which its condition fails every other time."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0, 0.0

    @hy.edge(
        up,
        to=up,
        guard=lambda self, t, s: s.x - 1.0,
        crossing=hy.RISING,
        when=lambda self, t, s: s.n >= 1.0,
    )
    def first(self, t, s):
        return s.replace(n=s.n - 5.0)

    @hy.edge(up, every=1.0)
    def beat(self, t, s):
        return 0.0 * s.x, s.n + 3.0


@ways
def test_a_clock_rings_beside_a_guard_whose_condition_fails(way):
    """It is read before the clock's jump; where it holds, the edge declared first fires first."""
    result = way.run(Beat(), {"x": 0.0, "n": 0.0}, (0.0, 3.5))
    np.testing.assert_allclose(result.times, [1.0, 2.0, 2.0, 3.0, 3.0], rtol=1e-15)
    assert result.final.n == -1.0
    if way.tells("edges"):
        assert result.edges == ["beat", "first", "beat", "first", "beat"]


class Tossed(hy.Automaton):
    """Leaves a table and falls back: ``x`` is ``table + v t + a t^2 / 2 - t^3``."""

    x = hy.state()
    v = hy.state()
    a = hy.state()
    table: float = hy.parameter(0.0)
    deepest: float = hy.parameter(-1.0, doc="how far below the table it is still noticed")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, s.a, -6.0

    @hy.edge(
        flight,
        to=hy.TERMINATE,
        guard=lambda self, t, s: s.x - self.table,
        when=lambda self, t, s: s.x > self.table + self.deepest,
    )
    def back(self, t, s):
        return s


class TossedEitherWay(Tossed):
    back = hy.edge(
        Tossed.flight,
        to=hy.TERMINATE,
        guard=lambda self, t, s: s.x - self.table,
        crossing=hy.EITHER,
    )


@ways
@pytest.mark.parametrize("cls", [Tossed, TossedEitherWay])
@pytest.mark.parametrize("table", [0.0, 500.0])
def test_an_event_that_comes_back_from_where_rounding_hides_it_fires(way, cls, table):
    """A guard that bounds nothing is zero at the start, rises and falls again before it is larger
    than its rounding: the zero at which it falls counts as any other does."""
    for back in (1e-6, 1e-16, 1e-32):
        for v, a in ((back**2, 0.0), (0.0, 2.0 * back)):
            start = {"x": table, "v": v, "a": a}
            result = way.run(cls(table=table), start, (0.0, 1.0), rtol=1e-9)
            assert (result.status, result.jumps) == ("terminated", 1)
            # by the series of the guard, onto which a step is made to a few millionths of itself
            assert result.t == pytest.approx(back, rel=1e-5)


@ways
def test_an_event_that_comes_back_at_once_has_its_condition(way):
    """Where the condition fails, such a zero is passed as any other is."""
    start = {"x": 0.0, "v": 1e-32, "a": 0.0}
    result = way.run(Tossed(deepest=1.0), start, (0.0, 1.0), rtol=1e-9)
    assert (result.status, result.jumps) == ("reached_end", 0)


def test_a_proof_before_the_run_has_no_urgent_edge():
    """It may fire behind any impact."""
    with pytest.raises(hy.OptionError, match="Fading, contact impact: edge catch is urgent"):
        hy.certify(Fading(), {"x": (0.0, 1.0), "v": (-2.0, 2.0)})
