"""Clocks with a condition: they fire where it holds; else their time is passed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .contract.ways import WAYS, spread
from .systems import without_loop

#: One of each mechanism.
SOME = ["DOP853", "Radau", "taylor", "Tsit5", "ensemble", "as_function"]

ways = pytest.mark.parametrize("way", [WAYS[name] for name in SOME], ids=SOME)

SOLVERS = ["taylor", "scipy", "diffrax"]

#: SciPy's and Diffrax's runs are made at 1e-8 a step, of some tens; Taylor's are rounding.
CLOSE = {"taylor": 1e-13, "scipy": 1e-6, "diffrax": 1e-6}


@pytest.fixture
def wide():
    """64 bits also on the thread on which JAX calls back."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


class Swing(hy.Automaton):
    """x = sin t, sampled where it is above 0 by one clock, and by another where it is not."""

    x = hy.state()
    n = hy.state()
    T: float = hy.parameter(0.5, positive=True)

    @hy.mode(initial=True)
    def swings(self, t, s):
        return jnp.cos(t), 0.0

    @hy.edge(swings, every="T", when=lambda self, t, s: s.x > 0.0)
    def above(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(swings, every="T", when=lambda self, t, s: s.x <= 0.0)
    def below(self, t, s):
        return s.replace(n=s.n + 100.0)


class Above(Swing):
    """The first of the two alone."""

    below = None


@ways
def test_of_two_clocks_whose_conditions_exclude_each_other_one_rings(way):
    result = way.run(Swing(), {"x": 0.0, "n": 0.0}, (0.0, 10.0))
    high = np.sin(0.5 * np.arange(1, 21)) > 0.0
    np.testing.assert_array_equal(result.times, 0.5 * np.arange(1, 21))
    assert result.final.n == high.sum() + 100 * (~high).sum()


@ways
def test_a_time_at_which_the_condition_fails_is_passed(way):
    times = 0.5 * np.arange(1, 21)
    result = way.run(Above(), {"x": 0.0, "n": 0.0}, (0.0, 10.0))
    np.testing.assert_array_equal(result.times, times[np.sin(times) > 0.0])
    assert result.final.x == pytest.approx(np.sin(10.0), abs=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_arc_goes_on_over_a_time_that_is_passed(solver):
    run = hy.simulate(Above(), {"x": 0.0, "n": 0.0}, (0.0, 10.0), solver=solver)
    assert len(run.arcs) == len(run.jumps) + 1
    t = np.linspace(3.1, 6.4, 50)  # within the arc from 3 to 6.5
    np.testing.assert_allclose(run(t).x, np.sin(t), atol=CLOSE[solver])
    assert [arc.t1 for arc in run.arcs if arc.t0 == 3.0] == [6.5]


class Guarded(hy.Automaton):
    """Falls to a guard, and is thrown up by a clock while it is low: watched beside guards."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def falls(self, t, s):
        return -1.0, 0.0

    @hy.mode
    def rises(self, t, s):
        return 2.0, 0.0

    @hy.edge(falls, to=rises, every=0.25, when=lambda self, t, s: s.x < 0.4)
    def turns(self, t, s):
        return s.replace(n=10.0 * s.n + 1.0)

    @hy.edge(falls, guard=lambda self, t, s: s.x - 0.75)
    def passes(self, t, s):
        return s.replace(x=s.x, n=10.0 * s.n + 2.0)

    @hy.edge(rises, to=falls, guard=lambda self, t, s: s.x - 1.0, crossing=hy.RISING)
    def back(self, t, s):
        return s.replace(n=10.0 * s.n + 3.0)


@ways
def test_a_clock_leads_to_another_mode_where_its_condition_holds(way):
    """At 0.5 x is 0.5, which is not below 0.4; at 0.75 it is, as the guard is at 0.25."""
    result = way.run(Guarded(), {"x": 1.0, "n": 0.0}, (0.0, 1.3))
    np.testing.assert_allclose(result.times, [0.25, 0.75, 1.125], atol=1e-9)
    assert result.final.n == 213.0
    assert result.final.x == pytest.approx(1.0 - 0.175, abs=1e-7)


class Tied(hy.Automaton):
    """A guard is zero when clocks ring; its reset changes what their conditions say."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def falls(self, t, s):
        return -1.0, 0.0

    @hy.edge(falls, at=1.0, when=lambda self, t, s: s.n > 0.0)
    def early(self, t, s):
        return s.replace(n=s.n + 10.0)

    @hy.edge(falls, guard=lambda self, t, s: s.x)
    def lands(self, t, s):
        return s.replace(x=3.0, n=s.n + 1.0)

    @hy.edge(falls, at=1.0, when=lambda self, t, s: s.n > 0.0)
    def late(self, t, s):
        return s.replace(n=s.n + 100.0)


@ways
def test_a_condition_is_read_before_the_first_jump_of_its_time(way):
    """As that of a guard: behind the jump of another edge at that time it is not read again."""
    assert way.run(Tied(), {"x": 1.0, "n": 0.0}, (0.0, 2.0)).final.n == 1.0
    assert way.run(Tied(), {"x": 1.0, "n": 5.0}, (0.0, 2.0)).final.n == 116.0
    assert way.run(Tied(), {"x": 2.5, "n": 0.0}, (0.0, 2.0)).final.n == 0.0


class Resting(hy.Automaton):
    """A ball that is thrown up again where a clock finds it on the floor."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -1.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, every=0.9, when=lambda self, t, s: (s.x == 0.0) & (s.v == 0.0))
    def kick(self, t, s):
        return s.replace(v=1.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_condition_sees_a_contact_at_rest_exactly(solver):
    """From 0.5 the ball is at rest at 3, and behind a kick four later: kicked at 3.6 and 8.1."""
    run = hy.simulate(Resting(), {"x": 0.5, "v": 0.0}, (0.0, 9.0), solver=solver)
    kicks = [t for t, edge in zip(run.jumps.t, run.jumps.edge, strict=True) if edge == "kick"]
    assert kicks == [4 * 0.9, 9 * 0.9]
    assert [point.t for point in run.zeno] == pytest.approx([3.0, 3.6 + 4.0], abs=CLOSE[solver])
    assert run.final.x == pytest.approx(0.9 - 0.405, abs=CLOSE[solver])


class Slides(hy.Automaton):
    """Slides on x = 0 until y is 1; a clock that is to wait for that ends the run."""

    x = hy.state()
    y = hy.state()

    @hy.mode(initial=True)
    def right(self, t, s):
        return -1.0, 0.5

    @hy.mode
    def left(self, t, s):
        return 1.0, 0.5

    rail = hy.switching(right, left, surface=lambda self, t, s: s.x)
    over = hy.edge(right, to=hy.TERMINATE, every=0.75, when=lambda self, t, s: s.y > 1.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_clock_waits_while_the_state_slides(solver):
    run = hy.simulate(Slides(), {"x": 0.5, "y": 0.0}, (0.0, 9.0), solver=solver)
    assert (run.status, run.t1, run.final.x) == (hy.Status.TERMINATED, 2.25, 0.0)


class Echo(hy.Automaton):
    """x' = -x(t - 1), x = 1 before 0; counted by a clock while it falls below 0.6."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return -past(1.0).x, 0.0

    @hy.edge(flow, every=0.25, when=lambda self, t, s: s.x < 0.6)
    def count(self, t, s):
        return s.replace(n=s.n + 1.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_clock_waits_in_a_run_with_delays(solver):
    """x = 1 - t up to 1, then 1 - t + (t - 1)^2 / 2: below 0.6 from 0.4 on."""
    history = {"x": 1.0, "n": 0.0}
    run = hy.simulate(
        Echo(), {"x": 1.0, "n": 0.0}, (0.0, 1.9), history=history, solver=solver, rtol=1e-10
    )
    assert run.jumps.t.tolist() == [0.5, 0.75, 1.0, 1.25, 1.5, 1.75]
    assert run.final.x == pytest.approx(1.0 - 1.9 + 0.9**2 / 2.0, abs=1e-8)


class Told(hy.Automaton):
    """Adds where a signal says so, whose knots are the times of the clock."""

    x = hy.state()
    gate = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def drifts(self, t, s):
        return self.gate(t)

    @hy.edge(drifts, every=0.5, when=lambda self, t, s: self.gate(t) > 0.0)
    def adds(self, t, s):
        return s.x + 10.0


class Sampled(hy.Automaton):
    """``x' = -2 x(t - 1)``, kicked by a clock while what it was before is above a level, with marks
    on what it was."""

    x = hy.state()
    kicks = hy.discrete(0)
    down = hy.discrete(0)
    up = hy.discrete(0)
    level: float = hy.parameter(0.1)

    @hy.mode
    def swings(self, t, s, past):
        return (-2.0 * past(1.0).x,)

    @hy.edge(swings, every=0.6, when=lambda self, t, s, past: past(0.7).x - self.level)
    def kick(self, t, s):
        return s.replace(x=s.x + 0.2, kicks=s.kicks + 1)

    @hy.edge(swings, guard=lambda self, t, s, past: past(0.4).x - 0.5)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)

    @hy.edge(swings, guard=lambda self, t, s, past: past(0.4).x - 0.5, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)


SIX = [WAYS[name] for name in ["DOP853", "RK45", "Radau", "taylor", "Tsit5", "ensemble"]]


@pytest.mark.parametrize(("way", "level"), spread(SIX, [-0.3, 0.1, 0.6]), ids=str)
def test_conditions_and_marks_see_the_past_where_a_clock_is_passed(way, level):
    """Each clock rings by what was, and each mark counts where the record passes it."""
    end = 6.0
    run = hy.simulate(Sampled(level=level), {"x": 1.0}, (0.0, end), solver="taylor")
    result = way.run(Sampled(level=level), {"x": 1.0}, (0.0, end), rtol=1e-9, atol=1e-11)
    rings = 0.6 * np.arange(1, 11)
    seen = np.where(rings > 0.7, run(np.maximum(rings - 0.7, 0.0), side="left").x, 1.0)
    kicked = [jump.t for jump in run.jumps if jump.edge == "kick"]
    np.testing.assert_allclose(kicked, rings[:9][seen[:9] > level], atol=1e-12)
    passed = np.diff(np.sign(run(np.linspace(0.0, end - 0.4, 20_001)).x - 0.5))
    assert run.final.down == np.count_nonzero(passed < 0) > 0
    assert run.final.up == np.count_nonzero(passed > 0)
    for name in ("kicks", "down", "up"):
        assert getattr(result.final, name) == getattr(run.final, name)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_condition_reads_a_signal_from_before_its_knot(solver):
    model = Told(gate=(np.arange(0.0, 2.5, 0.5), [1.0, 0.0, 0.0, 2.0, 0.0]))
    run = hy.simulate(model, {"x": 0.0}, (0.0, 2.4), solver=solver)
    assert run.jumps.t.tolist() == [0.5, 2.0]
    assert run.final.x == pytest.approx(21.5, abs=CLOSE[solver])


@pytest.mark.parametrize("model", [Swing, Above, Guarded, Tied, Resting, Slides])
def test_the_loop_and_the_driver_pass_the_same_times(model, monkeypatch):
    start = dict.fromkeys(model.spec.names[:1], 0.5) | {"n": 0, "v": 0.0, "y": 0.0}
    start = {name: start[name] for name in model.spec.names}
    runs = [hy.simulate(model(), start, (0.0, 9.0), solver="taylor")]
    without_loop(monkeypatch)
    runs.append(hy.simulate(model(), start, (0.0, 9.0), solver="taylor"))
    loop, driver = runs
    assert loop.jumps.edge.tolist() == driver.jumps.edge.tolist()
    assert [arc.mode for arc in loop.arcs] == [arc.mode for arc in driver.arcs]
    # where arcs are cut series are cut elsewhere: rounding
    np.testing.assert_allclose(loop.jumps.t, driver.jumps.t, atol=1e-12)
    np.testing.assert_allclose(np.array(loop.final), np.array(driver.final), atol=1e-12)


def test_a_run_that_goes_on_at_a_time_that_is_passed_is_the_whole():
    whole = hy.simulate(Above(), {"x": 0.0, "n": 0.0}, (0.0, 10.0), solver="taylor")
    for middle in (4.0, 5.0, 7.0):
        first = hy.simulate(Above(), {"x": 0.0, "n": 0.0}, (0.0, middle), solver="taylor")
        both = first + hy.simulate(Above(), first, (middle, 10.0), solver="taylor")
        assert both.jumps.t.tolist() == whole.jumps.t.tolist()
        assert both.final.n == whole.final.n


def test_a_condition_that_is_no_number_is_refused():
    with pytest.raises(hy.DeclarationError, match="edge tick, when: a value of shape"):

        class Wrong(hy.Automaton):
            x = hy.state(shape=(2,))

            @hy.mode(initial=True)
            def flow(self, t, s):
                return s.x

            tick = hy.edge(flow, every=1.0, when=lambda self, t, s: s.x)


def test_derivatives_go_over_times_that_are_passed(wide):
    """x = (sin t, its samples added) by the start: each sample doubles what the start has moved."""

    class Doubling(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def swings(self, t, s):
            return jnp.cos(t)

        @hy.edge(swings, every=1.0, when=lambda self, t, s: s.x > 0.0)
        def doubles(self, t, s):
            return 2.0 * s.x

    start = -0.8  # x is above 0 at 1, where it is doubled, and at 2, and then no more
    final = hy.as_function(Doubling(), t=(0.0, 4.5), max_jumps=8)
    run = hy.simulate(Doubling(), {"x": start}, (0.0, 4.5), solver="taylor")
    slope = jax.grad(lambda x: final(Doubling(), {"x": x}).final["x"])(start)
    assert run.jumps.t.tolist() == [1.0, 2.0]
    assert slope == pytest.approx(4.0, rel=1e-12)
