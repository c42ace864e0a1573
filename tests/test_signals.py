"""Signals: data at knots, read at the present time, against closed forms with every solver."""

import math
import pickle
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import hybrid as hy
from hybrid.run import machine

from .contract.ways import later
from .systems import without_loop

SOLVERS = ["taylor", "scipy", "diffrax"]

#: The tolerance of SciPy's and Diffrax's runs is 1e-8 a step, of some tens; Taylor's is rounding.
CLOSE = {"taylor": 1e-13, "scipy": 1e-6, "diffrax": 1e-6}

TIMES = np.array([0.0, 0.5, 0.8, 1.7, 2.0, 3.0])
VALUES = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 1.0])


def driven(kind, outside="error"):
    """A sum of what a signal is."""

    class Driven(hy.Automaton):
        x = hy.state()
        force = hy.signal(kind=kind, outside=outside, doc="what moves it")

        @hy.mode(initial=True)
        def flow(self, t, s):
            return (self.force(t),)

        @hy.output
        def rate(self, t, s):
            return self.force(t)

    return Driven


def summed(kind, t):
    """The integral of the signal from 0 to a time, within its data."""
    if kind == "cubic":
        return CubicSpline(TIMES, VALUES).antiderivative()(t)
    grid = np.unique([*TIMES[t > TIMES], t])
    if kind == "linear":
        values = np.interp(grid, TIMES, VALUES)
        return np.trapezoid(values, grid)
    return np.sum(np.diff(grid) * VALUES[: len(grid) - 1])


@pytest.mark.parametrize("kind", ["previous", "linear", "cubic"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_flow_sees_the_signal_between_its_knots(solver, kind):
    """Its integral is that of the data, in the middle of pieces and at knots."""
    model = driven(kind)(force=(TIMES, VALUES))
    run = hy.simulate(model, {"x": 0.25}, (0.0, 3.0), solver=solver)
    for t in (0.3, 0.5, 0.61, 1.7, 2.9, 3.0):
        assert abs(run(t).x - 0.25 - summed(kind, t)) < CLOSE[solver], t
    assert len(run.arcs) == 1
    assert not len(run.jumps)


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_is_outside_the_data(solver):
    """Held, zero, or the same again and again, also far from the data; or the run is refused."""
    level = {"hold": 1.0 * 2.0 + 1.0 * 3.0, "zero": 0.0}
    inner = summed("linear", 3.0)
    for outside, beyond in level.items():
        model = driven("linear", outside)(force=(TIMES, VALUES))
        run = hy.simulate(model, {"x": 0.0}, (-2.0, 6.0), solver=solver)
        assert abs(run.final.x - inner - beyond) < CLOSE[solver], outside
    model = driven("linear", "periodic")(force=(TIMES, VALUES))
    run = hy.simulate(model, {"x": 0.0}, (-3000.0, -2990.5), solver=solver)
    expected = 3 * inner + summed("linear", 0.5)
    # knots at t = -3000 are rounded to 5e-13, and the signal is 3 at most
    assert abs(run.final.x - expected) < CLOSE[solver] + 1e-11
    with pytest.raises(hy.OptionError, match=r"the signal force has data from 0.0 to 3.0"):
        hy.simulate(driven("linear")(force=(TIMES, VALUES)), {"x": 0.0}, (0.0, 3.5), solver=solver)


def test_a_signal_is_a_function_of_the_model():
    """At times, as arrays, with what is outside; an output reads it at the times of a run."""
    model = driven("linear", "periodic")(force=(TIMES, VALUES))
    t = np.linspace(-7.0, 8.0, 301)
    assert np.allclose(model.force(t), np.interp(np.mod(t, 3.0), TIMES, VALUES), atol=1e-12)
    assert model.force(0.25) == -0.5
    run = hy.simulate(model, {"x": 0.0}, (0.0, 7.0), solver="taylor")
    times = np.linspace(0.0, 7.0, 50)
    assert np.allclose(run(times).rate, model.force(times), atol=1e-12)
    cubic = driven("cubic")(force=(TIMES, VALUES))
    t = np.linspace(0.0, 3.0, 50)
    assert np.allclose(cubic.force(t), CubicSpline(TIMES, VALUES)(t), atol=1e-13)


class Follower(hy.Automaton):
    """Grows until it reaches a threshold that is given, and falls back by one."""

    x = hy.state()
    threshold = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def grow(self, t, s):
        return (1.0,)

    @hy.edge(grow, guard=lambda self, t, s: self.threshold(t) - s.x)
    def back(self, t, s):
        return (s.x - 1.0,)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_guard_that_jumps_over_zero_at_a_knot_fires_there(solver):
    """At the knot, to the last bit; between the knots where it is zero."""
    model = Follower(threshold=([0.0, 0.75, 1.4], [1.5, 0.5, 1.125]))
    run = hy.simulate(model, {"x": 0.0}, (0.0, 2.5), solver=solver)
    # 0.75 > 0.5 at the knot; 0.4 < 0.5 at the next; -0.25 + (t - 0.75) is 1.125 at 2.125
    assert run.jumps.t[0] == 0.75
    assert np.allclose(run.jumps.t, [0.75, 2.125], atol=CLOSE[solver])
    assert np.allclose(run.final.x, 0.5, atol=CLOSE[solver])


def road(kind="linear", outside="hold"):
    """A bead above a road that is given."""

    class Bead(hy.Automaton):
        x = hy.state(unit="m")
        v = hy.state(unit="m/s")
        r = hy.parameter(0.5)
        floor = hy.signal(unit="m", kind=kind, outside=outside)

        @hy.mode(initial=True)
        def flight(self, t, s):
            return s.v, -10.0

        impact = hy.contact(
            flight, gap=lambda self, t, s: s.x - self.floor(t), restitution="r", rests=True
        )

        @hy.output
        def height(self, t, s):
            return s.x - self.floor(t)

    return Bead


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bead_falls_on_a_road_that_rises(solver):
    """The first impact is the zero of a parabola; what is lost is lost in the frame of the road."""
    model = road()(floor=([0.0, 0.2, 2.0], [0.0, 0.0, 3.6]))
    run = hy.simulate(model, {"x": 1.0, "v": 0.0}, (0.0, 0.6), solver=solver)
    t = (-2.0 + np.sqrt(4.0 + 20.0 * 1.4)) / 10.0  # 1 - 5 t^2 = 2 (t - 0.2)
    assert abs(run.jumps.t[0] - t) < CLOSE[solver]
    assert abs(run.jumps[0].after.v - (2.0 + 0.5 * (10.0 * t + 2.0))) < 10 * CLOSE[solver]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bead_at_rest_leaves_a_road_that_bends_down_and_rests_again(solver):
    """It rides up a ramp, leaves it where that ends, and its impacts have a limit: all at times
    that are known."""
    model = road()(floor=([0.0, 1.0, 3.0, 4.0], [0.0, 2.0, 2.0, 2.0]))
    start = {"x": 0.0, "v": 2.0}
    run = hy.simulate(model, start, (0.0, 3.5), solver=solver, mode="flight.rest(impact)")
    assert abs(run(0.4).x - 0.8) < 1e-15
    release = run.jumps[0]
    assert (release.t, release.edge) == (1.0, "impact.release")
    # 2 m/s up from a level road: a flight of 0.4 s, each next half as long
    assert abs(run.jumps.t[1] - 1.4) < CLOSE[solver]
    assert len(run.zeno) == 1
    assert abs(run.zeno[0].t - 1.8) < CLOSE[solver]
    assert abs(run.zeno[0].t - 1.8) <= run.zeno[0].t_error < 1e-6
    assert run.arcs[-1].mode == "flight.rest(impact)"
    assert abs(run(3.2).x - 2.0) < CLOSE[solver]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bead_at_rest_is_struck_by_a_road_that_bends_up(solver):
    """At the knot there is an impact with the speed of the road."""
    model = road()(floor=([0.0, 1.0, 5.0], [0.0, 0.0, 8.0]))
    start = {"x": 0.0, "v": 0.0}
    run = hy.simulate(model, start, (0.0, 1.2), solver=solver, mode="flight.rest(impact)")
    assert [jump.edge for jump in run.jumps][:2] == ["impact.release", "impact"]
    assert run.jumps.t[1] == 1.0
    assert abs(run.jumps[1].after.v - 3.0) < 1e-12  # 2 + 0.5 * 2, by arithmetic


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bead_at_rest_rides_on_a_spline_until_that_falls_faster(solver, monkeypatch):
    """It is where the road is; by Taylor's steps the driver sees no knot until it leaves the road,
    where the spline's second derivative is that of the fall."""
    times = np.linspace(0.0, 2.0, 81)
    spline = CubicSpline(times, 0.2 * np.sin(8.0 * times))
    model = road("cubic")(floor=(times, spline(times)))
    start = {"x": 0.0, "v": float(spline(0.0, 1))}
    seen, pass_knot = [], machine.pass_knot
    monkeypatch.setattr(machine, "pass_knot", lambda *own: [seen.append(own), pass_knot(*own)])
    leaves = spline.derivative(2).solve(-10.0)[0]
    for last in (0.99 * leaves, leaves):
        run = hy.simulate(model, start, (0.0, last), solver=solver, mode="flight.rest(impact)")
        assert not (seen and solver == "taylor" and last < leaves)
    t = np.linspace(0.0, 0.999 * leaves, 60)
    assert np.abs(run(t).x - spline(t)).max() < 1e-13
    assert np.abs(run(t).v - spline(t, 1)).max() < 1e-12
    run = hy.simulate(model, start, (0.0, 0.5), solver=solver, mode="flight.rest(impact)")
    assert run.jumps[0].edge == "impact.release"
    assert abs(run.jumps.t[0] - leaves) < 1e-12


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_limit_is_not_summed_over_a_knot(solver):
    """Impacts that would come to rest behind a knot are flown to it; what follows is right."""
    free = 2.0 * np.sqrt(0.2) / 2  # of a fall from 1 m, at 10 m/s^2
    limit = free + 2.0 * free * 0.5 / (1.0 - 0.5)  # 3 free
    for knot in (limit - 1e-3, limit - 1e-6, limit + 1e-9):
        model = road()(floor=([0.0, knot, knot + 4.0], [0.0, 0.0, 4.0]))
        run = hy.simulate(model, {"x": 1.0, "v": 0.0}, (0.0, knot + 1.5), solver=solver)
        assert abs(run.final.x - 1.5) < 1e-6, knot  # rides on the ramp in the end
        assert abs(run.final.v - 1.0) < 1e-6, knot
        assert (run.zeno[0].t < knot) == (knot > limit)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("height", "r", "knot"),
    [(10.0, 0.3, 1e-6), (1.0, 0.8, 1e-6), (1.0, 0.7, 2.2e-6), (100.0, 0.3, 6e-6), (1.0, 0.5, 1e-5)],
)
def test_a_limit_behind_a_knot_is_known_to_the_rounding_there(solver, height, r, knot):
    """Shortly before the limit of a ball on a shelf a knot changes nothing, but for the height: low
    flights are known by their gap, and behind a knot by the rounding of the position."""
    fall = np.sqrt(0.2)
    limit = fall * (1.0 + r) / (1.0 - r)
    model = road()(r=r, floor=([0.0, limit - knot, 50.0], [height] * 3))
    run = hy.simulate(model, {"x": 1.0 + height, "v": 0.0}, (0.0, 9.0), solver=solver, rtol=1e-12)
    (point,) = run.zeno
    assert abs(point.t - limit) <= point.t_error <= 1e-6
    assert point.enclosure is None or point.enclosure[0] <= limit <= point.enclosure[1]


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_limit_behind_a_knot_at_zero_is_known_as_if_there_were_none(solver):
    """The ball has been at 4.6, whose rounding is far more than the gap is at the knot."""
    draw = np.random.default_rng(2)
    for _ in range(60):
        r, top = draw.uniform(0.1, 0.9), draw.uniform(0.5, 5.0)
        limit = np.sqrt(0.2 * top) * (1.0 + r) / (1.0 - r)
        knot = limit - 10 ** draw.uniform(-12.0, -6.0)
        model = road()(r=r, floor=([0.0, knot, 90.0], [0.0] * 3))
        run = hy.simulate(model, {"x": top, "v": 0.0}, (0.0, limit + 1.0), solver=solver)
        (point,) = run.zeno
        assert abs(point.t - limit) <= point.t_error < 1e-6, (r, top, knot)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("r", [0.3, 0.8])
def test_impacts_that_a_knot_brings_to_rest_are_listed(solver, r):
    """The flight that a knot interrupts may be lower than the rounding of the position."""
    limit = np.sqrt(0.2) * (1.0 + r) / (1.0 - r)
    for before in (1e-9, 1e-10, 1e-12, 0.0, -1e-13):
        knot = limit - before
        model = road()(
            r=r, floor=([0.0, knot, knot + 9.0], 0.3 + 0.5 * np.array([0, knot, knot + 9]))
        )
        run = hy.simulate(model, {"x": 1.3, "v": 0.5}, (0.0, 6.0), solver=solver, rtol=1e-12)
        (point,) = run.zeno
        assert abs(point.t - limit) <= point.t_error <= 1e-6, before
        assert run.mode == "flight.rest(impact)"


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_gap_must_not_jump_below_zero(solver):
    """A floor that jumps up through the bead is an error that names it; one that falls is none."""
    model = road("previous")(floor=([0.0, 0.1, 1.0], [0.0, 0.99, 0.0]))
    with pytest.raises(hy.DomainError, match=r"the gap of impact jumps to -0.04"):
        hy.simulate(model, {"x": 1.0, "v": 0.0}, (0.0, 0.5), solver=solver)
    model = road("previous")(floor=([0.0, 0.1, 1.0], [0.0, -1.0, 0.0]))
    start = {"x": 0.0, "v": 0.0}
    run = hy.simulate(model, start, (0.0, 0.6), solver=solver, mode="flight.rest(impact)")
    assert run.jumps.t[0] == 0.1
    assert run.jumps[0].edge == "impact.release"
    assert abs(run.jumps.t[1] - 0.1 - np.sqrt(0.2)) < CLOSE[solver]


class Pushed(hy.Automaton):
    """A bead on a floor, pushed by a force."""

    x = hy.state()
    v = hy.state()
    force = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -10.0 + self.force(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5, rests=True)


class Relay(hy.Automaton):
    """Falls above what it is to follow, and rises below."""

    x = hy.state()
    ref = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def down(self, t, s):
        return (-1.0,)

    @hy.mode
    def up(self, t, s):
        return (0.5,)

    across = hy.switching(down, up, surface=lambda self, t, s: s.x - self.ref(t))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_load_that_jumps_below_zero_opens_its_contact(solver):
    """At the knot, with the acceleration behind it: rule 8."""
    model = Pushed(force=([0.0, 1.0, 2.0], [0.0, 20.0, 0.0]))
    start = {"x": 0.0, "v": 0.0}
    run = hy.simulate(model, start, (0.0, 2.5), solver=solver, mode="flight.rest(impact)")
    assert [(jump.t, jump.edge) for jump in run.jumps] == [(1.0, "impact.release")]
    assert abs(run.final.x - 8.75) < CLOSE[solver]  # 5 + 10 / 2 - 5 / 4


class Borne(hy.Automaton):
    """A weight on a floor, lifted by a force."""

    x = hy.state()
    v = hy.state()
    weight = hy.parameter(1.0)
    force = hy.signal(outside="hold")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -self.weight + self.force(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


class Driven(hy.Automaton):
    """Friction at its limit: it slides along zero while the force is less than the friction."""

    v = hy.state()
    friction = hy.parameter(1.0)
    force = hy.signal(outside="hold")

    @hy.mode(initial=True)
    def forth(self, t, s):
        return (self.force(t) - self.friction,)

    @hy.mode
    def back(self, t, s):
        return (self.force(t) + self.friction,)

    turn = hy.switching(forth, back, surface=lambda self, t, s: s.v)


@pytest.mark.parametrize("looped", [True, *later(False)])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("size", [1.0, *later(3.7, 1e3)])
@pytest.mark.parametrize("since", [0.0, *later(-7.3)])
@pytest.mark.parametrize("model", [Borne, Driven])
def test_what_holds_a_state_may_touch_zero_at_a_knot(
    monkeypatch, model, since, size, solver, looped
):
    """A contact lets go, and sliding ends, where what holds is less than zero, not where it is
    zero: a force that comes to the weight, stays there or goes back, lifts nothing."""
    if not looped:
        without_loop(monkeypatch)
    start = {"x": 0.0, "v": 0.0} if model is Borne else {"v": 0.0}
    other = "weight" if model is Borne else "friction"
    times = since + np.array([0.0, 0.3, 0.9, 1.3, 2.0])
    touches = [0, 1, 0, 1, 0], [0, 1, 1, 0.9, 1], [0.9, 1, 0.5, 1, 1]
    for forces in (*touches, [0, 1, 1, 1, 1.5], [0.2, 0.1, 0.7, 1, 1.5]):
        made = model(**{other: size}, force=(times, size * np.array(forces)))
        run = hy.simulate(made, start, (since, since + 1.9), solver=solver)
        ends = [jump for jump in run.jumps if jump.t > since]
        lifted = forces[-1] > 1
        assert [abs(jump.t - since - 1.3) < 1e-12 for jump in ends] == [True] * lifted, run.jumps
        assert (run.final.v > 1e-3 * size) == lifted


@pytest.mark.parametrize("looped", [True, *later(False)])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("model", [Borne, Driven])
def test_what_holds_a_state_may_be_less_than_zero_by_rounding_at_a_knot(
    monkeypatch, model, solver, looped
):
    """It lets go there if it falls on, and holds if it rises again."""
    if not looped:
        without_loop(monkeypatch)
    start = {"x": 0.0, "v": 0.0} if model is Borne else {"v": 0.0}
    other = "weight" if model is Borne else "friction"
    for most in (0.3, 0.1 + 0.2, np.nextafter(0.3, 0.0), 0.3 + 3e-16, 0.3 + 1e-15):
        for last, speed in ((1.0, 0.35), (0.0, 0.0)):
            made = model(**{other: 0.3}, force=([0.0, 1.0, 2.0], [0.0, most, last]))
            run = hy.simulate(made, start, (0.0, 2.0), solver=solver)
            assert run.final.v == pytest.approx(speed, abs=1e-7)
            assert len([jump for jump in run.jumps if jump.t > 0.0]) == (speed > 0.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_surface_that_jumps_over_the_state_is_crossed_at_the_knot(solver):
    """One that jumps away from a state that slides on it ends that, at the knot."""
    model = Relay(ref=([0.0, 0.5, 2.0], [0.0, 1.0, 0.0]))
    run = hy.simulate(model, {"x": 1.0}, (0.0, 0.9), solver=solver)
    assert [(jump.t, jump.edge) for jump in run.jumps] == [(0.5, "across")]
    assert abs(run.final.x - 0.7) < CLOSE[solver]
    run = hy.simulate(model, {"x": 1.0}, (0.0, 2.9), solver=solver)
    ends = [(0.5, "across"), (1.5, "across"), (2.0, "across.positive")]
    assert [(jump.t, jump.edge) for jump in run.jumps] == [(pytest.approx(t), e) for t, e in ends]
    assert abs(run.final.x - 0.1) < CLOSE[solver]


@pytest.mark.parametrize("solver", SOLVERS)
def test_knots_may_be_next_to_each_other_and_to_the_start(solver):
    """Of two signals knots that are a spacing of floats apart, and runs that begin there."""

    class Two(hy.Automaton):
        x = hy.state()
        a = hy.signal(outside="hold")
        b = hy.signal(kind="cubic", outside="hold")

        @hy.mode(initial=True)
        def flow(self, t, s):
            return (self.a(t) + self.b(t),)

    times, others = [0.0, 0.3, 1.0, 1.0 + 1e-9, 2.0], np.array([0.0, 0.1 + 0.2, 0.7, 1.5, 2.0])
    model = Two(a=(times, np.ones(5)), b=(others, 2.0 * others))
    for t0 in (np.nextafter(0.3, 0), 0.3, np.nextafter(1.0, 0), -1.0):
        run = hy.simulate(model, {"x": 0.0}, (float(t0), 2.5), solver=solver)
        exact = (2.5 - t0) + (4.0 - max(t0, 0.0) ** 2) + 0.5 * 4.0
        assert abs(run.final.x - exact) < CLOSE[solver], t0


def test_runs_by_the_loop_are_those_of_the_driver(monkeypatch):
    """Over many knots within flights, of which the driver sees none; and the dense output."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.01, 0.1, 200))
    model = road("cubic")(floor=(times - times[0], 0.02 * rng.standard_normal(200)))
    given = model, {"x": 1.0, "v": 0.0}, (0.0, 4.0)
    seen = []
    monkeypatch.setattr(machine, "pass_knot", lambda *which: seen.append(which))
    run = hy.simulate(*given, solver="taylor")
    assert not seen
    monkeypatch.undo()
    without_loop(monkeypatch)
    same = hy.simulate(*given, solver="taylor")
    # what is off at the start is, at the last jump, 1e9 times that: here the first twelve, 1e3
    assert np.allclose(run.jumps.t[:12], same.jumps.t[:12], rtol=0, atol=1e-12)
    t = np.linspace(0.0, float(run.jumps.t[11]), 100)
    assert np.allclose(run(t).x, same(t).x, rtol=0, atol=1e-12)
    assert (run.jumps.t[11] - run.jumps.t[0]) > 10 * np.mean(np.diff(times))


@pytest.mark.parametrize("solver", SOLVERS)
def test_vectors_and_series_of_pandas_and_xarray(solver):
    """Values may be arrays; data are taken from a series over the time."""
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")

    class Moved(hy.Automaton):
        q = hy.state(shape=(2,))
        wind = hy.signal(shape=(2,))

        @hy.mode(initial=True)
        def flow(self, t, s):
            return (self.wind(t),)

    data = np.column_stack([VALUES, -2.0 * VALUES])
    frames = [
        (TIMES, data),
        pandas.DataFrame(data, index=TIMES),
        xarray.DataArray(data, dims=("time", "way"), coords={"time": TIMES}),
    ]
    for given in frames:
        run = hy.simulate(Moved(wind=given), {"q": [0.0, 1.0]}, (0.0, 2.5), solver=solver)
        s = summed("linear", 2.5)
        assert np.allclose(run.final.q, [s, 1.0 - 2.0 * s], rtol=0, atol=CLOSE[solver])


@pytest.mark.parametrize("solver", SOLVERS)
def test_lanes_equal_their_runs(solver):
    """With the signal of the model, and with one for each lane; outputs are those of the lane."""
    model = driven("linear")(force=(TIMES, VALUES))
    starts = np.array([0.0, 1.0, 2.0])
    same = hy.ensemble(model, {"x": starts}, (0.0, 2.5), solver=solver, measure=["rate"])
    s = summed("linear", 2.5)
    assert np.allclose(same.x, starts + s, rtol=0, atol=CLOSE[solver])
    assert np.allclose(same.rate, model.force(2.5), rtol=0, atol=1e-13)
    data = [(TIMES, VALUES), (TIMES, -3.0 * VALUES), ([0.0, 3.0], [1.0, 1.0])]
    own = hy.ensemble(
        model,
        {"x": starts},
        (0.0, 2.5),
        parameters={"force": data},
        solver=solver,
        measure=["rate"],
    )
    assert np.allclose(own.x, [s, 1.0 - 3.0 * s, 4.5], rtol=0, atol=CLOSE[solver])
    rate = model.force(2.5)
    assert np.allclose(own.rate, [rate, -3.0 * rate, 1.0], rtol=0, atol=1e-13)
    run = hy.simulate(type(model)(force=data[1]), {"x": 1.0}, (0.0, 2.5), solver=solver)
    assert own.x[1] == run.final.x
    with pytest.raises(hy.OptionError, match="lanes differ in number"):
        hy.ensemble(model, {"x": starts}, (0.0, 2.5), parameters={"force": data[:2]})
    wrong = [data[0], ([0, 2, 1], [1, 2, 3]), data[2]]
    with pytest.raises(hy.ParameterError, match=r"force, lane 1: 1.0 behind 2.0"):
        hy.ensemble(model, {"x": starts}, (0.0, 2.5), parameters={"force": wrong})


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_is_kept_of_lanes_is_that_of_their_runs(solver):
    """States and outputs at times, points on a section, time at rest; each lane on its own road."""
    roads = [(TIMES, 0.1 * VALUES), (TIMES, 0.05 * VALUES)]
    model, span, times = road()(floor=roads[0]), (0.0, 3.0), [0.4, 1.7, 2.9]
    start = {"x": np.array([1.0, 1.0]), "v": 0.0}
    kept = {"save": times, "section": "impact", "skip": 0, "keep": 3}
    lanes = hy.ensemble(
        model, start, span, {"floor": roads}, solver=solver, measure=["stick", "height"], **kept
    )
    for i, data in enumerate(roads):
        run = hy.simulate(road()(floor=data), {"x": 1.0, "v": 0.0}, span, solver=solver)
        np.testing.assert_array_equal(lanes["x_saved"][i], run(times).x)
        np.testing.assert_allclose(lanes["height_saved"][i], run(times).height, atol=1e-15)
        struck = run.jumps.edge == "impact"
        np.testing.assert_array_equal(lanes["t_section"][i], run.jumps.t[struck][:3])
        rests = sum(arc.t1 - arc.t0 for arc in run.arcs if arc.mode.endswith("rest(impact)"))
        assert lanes["stick"][i] == pytest.approx(rests / 3.0, rel=1e-12)
    with pytest.raises(hy.OptionError, match="a surface: it reads the signal floor"):
        hy.ensemble(model, start, span, section=lambda self, t, s: s.x - self.floor(t), skip=0)


@pytest.mark.parametrize("kind", ["linear", "previous", "cubic"])
def test_exponents_are_those_of_each_piece(kind):
    """``x' = force x`` grows by the integral of the force, from a tenth of the run on."""

    class Grown(hy.Automaton):
        x = hy.state()
        force = hy.signal(kind=kind)

        @hy.mode
        def flow(self, t, s):
            return (self.force(t) * s.x,)

    model, span = Grown(force=(TIMES, VALUES)), (0.0, 2.5)
    exact = (summed(kind, 2.5) - summed(kind, 0.25)) / 2.25
    found = hy.lyapunov(model, [1.0], span, solver="taylor")
    assert found.exponents == pytest.approx([exact], rel=1e-12)


def test_a_map_over_a_signal_names_the_remedy():
    """Its data are no number that could be a coordinate."""
    model = road()(floor=(TIMES, VALUES))
    with pytest.raises(hy.OptionError, match=r"'floor': a signal.*hy.ensemble.*parameters="):
        hy.sweep(model, {"floor": [1.0, 2.0]}, {"x": 1.0, "v": 0.0}, (0.0, 1.0))


RAMP = [0.0, 1.0, 3.0, 4.0], [0.0, 2.0, 2.0, 1.0]


@pytest.mark.parametrize("solver", ["taylor", *later("scipy", "diffrax")])
def test_a_function_of_a_model_with_signals_is_its_run(solver):
    """Its values; and its derivatives by restitution and start, over knots, impacts, an
    accumulation and a release at a knot, against differences."""
    made, span = road(), (0.0, 3.6)
    with jax.enable_x64(True):
        for end, mode in ((0.6, None), (1.3, None), (span[1], "flight.rest(impact)")):
            f = hy.as_function(
                made(floor=RAMP), t=(0.0, end), max_jumps=200, solver=solver, mode=mode
            )

            def numbers(p, f=f):
                found = f(made(floor=RAMP, r=p[0]), {"x": p[1], "v": p[2]})
                return jnp.array([*found.final, found.zeno.t])

            p = np.array([0.5, 1.0, 0.3] if mode is None else [0.5, 0.0, 2.0])
            own = {"x": p[1], "v": p[2]}
            run = hy.simulate(made(floor=RAMP), own, (0.0, end), solver=solver, mode=mode)
            found, slopes = numbers(p), jax.jacfwd(numbers)(p)
            np.testing.assert_allclose(found[:2], [*run.final], atol=CLOSE[solver])
            known = np.isfinite(found)
            assert known[2] == bool(run.zeno)
            varied = [0] if mode else [0, 1, 2]  # at rest the start lies on the road
            for i in varied:
                step = 1e-5 * np.eye(3)[i]
                far = (numbers(p + step) - numbers(p - step)) / 2e-5
                # what is left of the third order, and of the solver's error, which changes over
                # 2e-5 by so little that divided by it some ten times the error are left
                np.testing.assert_allclose(
                    slopes[known, i], far[known], atol=1e-5 + 10 * CLOSE[solver]
                )


class TwoInputs(hy.Automaton):
    """A rate and a load, both data."""

    x = hy.state()
    rate = hy.signal()
    load = hy.signal(kind="previous")

    @hy.mode
    def flow(self, t, s):
        return self.rate(t) * s.x + self.load(t)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_function_of_a_model_with_two_signals_has_derivatives(solver):
    """By the start: what the rate has made of it, whatever the load."""
    times = [0.0, 1.0, 2.0]
    model = TwoInputs(rate=(times, [0.1, 0.3, 0.2]), load=(times, [1.0, 0.5, 0.2]))
    with jax.enable_x64(True):
        f = hy.as_function(model, t=(0.0, 1.5), max_jumps=1, solver=solver)
        slope = jax.grad(lambda x: f(model, {"x": x}).final.x)(1.0)
    assert slope == pytest.approx(math.exp(0.2 + 0.5 * (0.3 + 0.25) / 2), rel=10 * CLOSE[solver])


class Lifted(hy.Automaton):
    """A ball under a force that is data, and held outside them."""

    x = hy.state()
    v = hy.state()
    force = hy.signal(kind="previous", outside="hold")

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0 + self.force(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("end", [1.5, 2.5])
def test_a_function_has_derivatives_where_a_signal_holds_its_first_value(end):
    """An impact before the first of the data lies on no knot."""
    values = [2.0, 1.0, 3.0]
    slopes = []
    with jax.enable_x64(True):
        for first in (1.2, 0.0):
            model = Lifted(force=([first, 2.0, 3.0], values))
            f = hy.as_function(model, t=(0.0, end), max_jumps=100)
            slope = jax.grad(lambda x, m=model, f=f: f(m, {"x": x, "v": 0.0}).final.x)
            slopes.append(float(slope(3.0)))
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-12)
    assert slopes[0] != 0.0


def test_a_function_has_the_data_that_it_was_made_with():
    """Others are refused; so is a second derivative, with a sentence."""
    made = road()
    with jax.enable_x64(True):
        f = hy.as_function(made(floor=RAMP), t=(0.0, 0.3), max_jumps=4)
        with pytest.raises(hy.OptionError, match="made with other data of floor"):
            f(made(floor=(TIMES, VALUES)), {"x": 1.0, "v": 0.0})
        with pytest.raises(hy.OptionError, match="has signals: its runs have first derivatives"):
            jax.hessian(lambda x: f(made(floor=RAMP), {"x": x, "v": 0.0}).final.x)(1.0)


def test_wrong_data_are_refused():
    """With the name of the signal, the value, and what is due."""
    model = driven("linear")
    cases = {
        "no data for the signal force": {},
        "values of shape \\(3,\\) where \\(2,\\)": {"force": ([0, 1], [1, 2, 3])},
        "1.0 behind 2.0; give increasing": {"force": ([0, 2, 1], [1, 2, 3])},
        "must be finite": {"force": ([0, 1], [1, np.nan])},
        "times of shape": {"force": ([0], [1])},
        "dates": {"force": (np.array(["2020-01-01", "2021-01-01"], dtype="M8[s]"), [1, 2])},
        "3.0 is no pair; give \\(times, values\\)": {"force": 3.0},
    }
    for said, given in cases.items():
        with pytest.raises(hy.ParameterError, match=said):
            model(**given)
    with pytest.raises(hy.ParameterError, match=r"begins with 1.0 and ends with 2.0"):
        driven("linear", "periodic")(force=([0, 1], [1, 2]))


def test_wrong_declarations_are_refused():
    """Together, when the class is made."""
    with pytest.raises(hy.DeclarationError) as told:

        class Wrong(hy.Automaton):
            x = hy.state()
            a = hy.signal(kind="quadratic")
            b = hy.signal(outside="nothing")
            c = hy.signal()

            @hy.mode(initial=True)
            def flow(self, t, s):
                return (self.c(s.x),)

    assert "signal a: kind='quadratic'" in str(told.value)
    assert "signal b: outside='nothing'" in str(told.value)
    assert "a signal is read at the present time, self.c(t)" in str(told.value)
    with pytest.raises(hy.DeclarationError, match="looks into the past can have no signal"):

        class Both(hy.Automaton):
            x = hy.state()
            c = hy.signal()

            @hy.mode(initial=True)
            def flow(self, t, s, past):
                return (self.c(t) - past(1.0).x,)


def test_who_knows_no_signals_says_so():
    """Orbits and proofs, with a remedy."""
    model = road()(floor=(TIMES, VALUES))
    ways = {
        "hy.periodic_orbit": lambda: hy.periodic_orbit(model, {"x": 1.0, "v": 0.0}, period=1.0),
        "hy.certify": lambda: hy.certify(model, box={"x": (-1, 1), "v": (-1, 1)}),
    }
    for name, ask in ways.items():
        with pytest.raises(hy.HybridError, match=f"{name} takes no model with signals yet"):
            ask()


def test_models_with_signals_are_values():
    """Equal by their data, changed by evolve, pickled, and a run goes on where another ended."""
    import attrs

    model = road()(floor=(TIMES, VALUES))
    assert model == road_of(model)
    assert attrs.evolve(model, r=0.25).floor is model.floor
    again = pickle.loads(pickle.dumps(model.floor))
    assert again == model.floor
    plain = driven("linear")(force=(TIMES, VALUES))
    first = hy.simulate(plain, {"x": 0.0}, (0.0, 1.0), solver="taylor")
    more = hy.simulate(plain, first, (1.0, 2.5), solver="taylor")
    assert abs((first + more).final.x - summed("linear", 2.5)) < 1e-13
    assert "force" not in first.to_xarray().attrs


def road_of(model):
    """The same class with equal data."""
    return type(model)(floor=(TIMES.copy(), VALUES.copy()))


@cache
def timed(crossing):
    """A class of timers that read a held signal whenever they are due."""

    class Timed(hy.Automaton):
        since = hy.state()
        seen = hy.state()
        force = hy.signal(kind="previous", outside="hold")

        @hy.mode(initial=True)
        def flow(self, t, s):
            return 1.0, 0.0

        @hy.edge(flow, guard=lambda self, t, s: s.since - 0.1, crossing=crossing)
        def ring(self, t, s):
            return 0.0 * s.since, self.force(t)

    return Timed


@pytest.mark.parametrize("looped", [True, *later(False)])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("crossing", [hy.RISING, hy.EITHER])
def test_a_guard_that_is_zero_at_each_knot_fires_once_there(monkeypatch, crossing, solver, looped):
    """Knots are decimal numbers, the timer adds up its period: it fires before the knot, with the
    value that the signal had, however rounding orders the two; and once."""
    if not looped:
        without_loop(monkeypatch)
    times = [float(f"{k / 10:.1f}") for k in range(42)]
    model = timed(crossing)(force=(times, np.arange(42.0)))
    run = hy.simulate(model, [0.0, 0.0], (0.0, 4.05), solver=solver)
    assert run.jumps.t == pytest.approx(0.1 * np.arange(1, 41), rel=1e-13)
    assert run.jumps.after.seen.tolist() == np.arange(0.0, 40.0).tolist()


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_crossing_at_a_knot_is_lost(solver):
    """A wave that is zero at each knot, and each crossing of which is an event."""

    class Wave(hy.Automaton):
        count = hy.state()
        force = hy.signal(kind="linear", outside="hold")

        @hy.mode(initial=True)
        def flow(self, t, s):
            return 0.0 * s.count

        @hy.edge(flow, guard=lambda self, t, s: jnp.sin(10 * jnp.pi * t), crossing=hy.EITHER)
        def passes(self, t, s):
            return s.count + 1.0

    times = [float(f"{k / 10:.1f}") for k in range(32)]
    model = Wave(force=(times, np.arange(32.0)))
    run = hy.simulate(model, [0.0], (0.05, 3.05), solver=solver)
    assert run.jumps.t == pytest.approx(0.1 * np.arange(1, 31), rel=1e-13)
