"""Orbits of models with delays, and rests that nothing can end."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import lambertw

import hybrid as hy
from hybrid.orbits.remembering import HistoryShooting, framed, leaps, monodromy
from hybrid.orbits.shooting import Guess
from hybrid.variation import factors
from models.pyragas import Pyragas
from tests.contract.ways import later
from tests.oscillators import bouncing, flight


class Wright(hy.Automaton):
    """Wright's equation ``y' = -alpha y(t - 1) (1 + y)``."""

    y = hy.state()
    alpha = hy.parameter(2.0)

    @hy.mode
    def flow(self, t, s, past):
        return (-self.alpha * past(1.0).y * (1.0 + s.y),)


class Pressed(hy.Automaton):
    """A ball held down by a spring that remembers, and by a force that may change in time."""

    x = hy.state()
    v = hy.state()

    def force(self, t):
        return -9.0

    @hy.mode
    def flight(self, t, s, past):
        return s.v, self.force(t) + past(1.0).x - s.x

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5, rests=True)


class Changing(Pressed):
    """The same with a force that changes."""

    def force(self, t):
        return -9.0 + jnp.sin(t)


class Table(hy.Automaton):
    """A ball that bounces on a sinusoidal table, pulled to where it was and how fast."""

    x = hy.state()
    v = hy.state()
    gain = hy.parameter(0.1)
    tau = hy.parameter(0.17)
    amplitude = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s, past):
        seen = past(self.tau)
        return s.v, -9.8 - self.gain * (seen.x + 0.5 * seen.v)

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(5.0 * t),
        restitution=0.5,
    )


class Forgetful(hy.Automaton):
    """The same without a delay."""

    x = hy.state()
    v = hy.state()
    gain = hy.parameter(0.1)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.8 - self.gain * (s.x + 0.5 * s.v)

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - 0.5 * jnp.sin(5.0 * t), restitution=0.5
    )


class Linear(hy.Automaton):
    """``y' = a y + b y(t - 1)``: its solutions are those of ``z = a + b exp(-z)``."""

    y = hy.state()
    a = hy.parameter(-0.5)
    b = hy.parameter(-1.2)

    @hy.mode
    def flow(self, t, s, past):
        return (self.a * s.y + self.b * past(1.0).y,)


def bounced(model, memory=None):
    """The orbit of a ball on the table, from the closed form without a force."""
    ball, period, speed, since, _ = bouncing(0.5, 0.5, 5.0)
    options = {"period": period, "t": since + 0.1} | ({"memory": memory} if memory else {})
    return hy.periodic_orbit(model, flight(ball, speed, since, 0.1), **options)


def same(found, expected, digits):
    """Whether numbers agree to some digits of the largest, in any order."""
    found, expected = (np.sort_complex(np.asarray(v, dtype=complex)) for v in (found, expected))
    np.testing.assert_allclose(found, expected, atol=10.0**-digits * np.abs(expected).max())


# ---------------------------------------------------------------------------------------
# memory that restarts at jumps


def test_pyragas_orbit():
    """Period, extrema and multiplier from the reference, computed at 40 digits."""
    guess = {"x1": 2.0, "x2": 5.0}
    orbit = hy.periodic_orbit(Pyragas(), guess, section="impact", memory="restart")
    assert orbit.period == pytest.approx(1.2214862581453748723805954, rel=1e-11)
    assert orbit.extrema["x1"][1] == pytest.approx(4.9357161063328888, rel=1e-11)
    assert orbit.jumps == 1
    assert orbit.stable
    same(orbit.multipliers, [1.0, -0.578307906333], 10)
    assert orbit.run.jumps[0].before.x2 == pytest.approx(-9.5355595239380211, rel=1e-11)


@pytest.mark.parametrize("start", [2.5, 5.0, *later(3.0, 10.0, 100.0, 200.0)])
def test_runs_settle_on_pyragas_orbit(start):
    found = hy.simulate(Pyragas(), [start, 0.0], (0.0, 50.0), memory="restart").settles()
    assert (found.kind, found.jumps) == ("periodic", 1)
    assert found.period == pytest.approx(1.2214862581453749, rel=1e-7)


def test_a_run_from_below_the_boundary_rests():
    found = hy.simulate(Pyragas(), [2.1, 0.0], (0.0, 9.0), memory="restart").settles()
    assert (found.kind, found.for_ever) == ("rest", True)


def test_a_return_map_takes_the_past_along():
    """Step by step the same as one run, in both memories; on a surface too."""
    for memory in ("keep", "restart"):
        model, start = Pyragas(r=0.9), [5.0, 0.0]
        run = hy.simulate(model, start, (0.0, 2.5), memory=memory, rtol=1e-11, atol=1e-12)
        back = hy.return_map(model, "impact", memory=memory).iterate(start, 4)
        np.testing.assert_allclose(back.t[1:], run.jumps.t[:4], rtol=1e-9)
        np.testing.assert_allclose(back.x2[1:], run.jumps.after.x2[:4], rtol=1e-8)
        moments = hy.return_map(model, 0.3, memory=memory).iterate(start, 8)
        np.testing.assert_allclose(moments.x1[1:], run(moments.t[1:]).x1, rtol=1e-9)


def test_multipliers_of_a_forced_orbit_that_restarts():
    """Against differences of the map from one impact, and its time, to the next."""
    orbit = bounced(Table(), "restart")
    back = hy.return_map(Table(), "impact", memory="restart", rtol=1e-12, atol=1e-13)
    start, jump = orbit.run.jumps[-1].after, orbit.run.jumps[-1]

    def landed(t, v):
        run = back.run({"x": 0.5 * np.sin(5.0 * t), "v": v}, t)
        return np.array([run.t1, run.final.v])

    at, step = np.array([jump.t, float(start.v)]), 1e-5
    columns = [(landed(*(at + d)) - landed(*(at - d))) / (2 * step) for d in step * np.eye(2)]
    same(orbit.multipliers, np.linalg.eigvals(np.array(columns).T), 7)


class Kicked(hy.Automaton):
    """An oscillator that remembers its speed, and is kicked on where it rises through zero."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def swing(self, t, s, past):
        return s.v, -s.x - 0.1 * s.v + 0.2 * past(0.7).v

    @hy.edge(swing, to=swing, guard=lambda self, t, s: s.x, crossing=hy.RISING)
    def kick(self, t, s):
        return s.replace(v=0.7 * s.v + 0.2)


@pytest.mark.long
@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_an_event_is_met_once_a_turn(memory):
    """In iterates, and in an orbit, whose state after the event lies on its guard. With memory that
    restarts the map has one dimension, and its slope is a difference."""
    start, fine = [0.5, 0.2], {"memory": memory, "rtol": 1e-12, "atol": 1e-13}
    back = hy.return_map(Kicked(), "kick", **fine)
    found = back.iterate(start, 60)
    run = hy.simulate(Kicked(), start, (0.0, found.t[8] + 1.0), **fine)
    np.testing.assert_allclose(found.t[1:9], run.jumps.t, rtol=1e-10)
    orbit = hy.periodic_orbit(Kicked(), start, section="kick", memory=memory)
    assert orbit.jumps == 1
    assert orbit.period == pytest.approx(found.t[-1] - found.t[-2], rel=1e-4)  # 0.87**60
    assert orbit.run.jumps[0].after.v == pytest.approx(found.v[-1], rel=1e-3)
    if memory == "restart":
        v, h = float(orbit.run.jumps[0].after.v), 1e-4
        slope = (back([0.0, v + h]).v - back([0.0, v - h]).v) / (2 * h)
        same(orbit.multipliers, [1.0, slope], 7)


def test_without_a_jump_nothing_restarts():
    with pytest.raises(hy.OrbitError, match="nothing restarts"):
        hy.periodic_orbit(Wright(), [0.5], period=1.0, memory="restart", settle=1)


# ---------------------------------------------------------------------------------------
# memory that is kept


@pytest.fixture(scope="module")
def wright():
    return hy.periodic_orbit(Wright(), [0.5], settle=10)


def test_orbit_of_wrights_equation(wright):
    """One multiplier is 1; the others are the same from two sets of points."""
    same(wright.multipliers[:1], [1.0], 10)
    assert wright.errors[:2].max() < 1e-12
    assert wright.stable
    assert wright.residual < 1e-11


def test_wrights_multipliers_tell_how_a_run_settles(wright):
    """Its distance to the orbit shrinks by the second largest each turn, and stays in phase."""
    run = hy.simulate(Wright(), [0.5], (0.0, 60.0), rtol=1e-12, atol=1e-13)
    period, late = wright.period, 40.0
    peaks = [run(late + k * period).y - run(late + (k - 1) * period).y for k in (0, -1, -2, -3)]
    ratios = np.array(peaks[:2]) / np.array(peaks[1:3])
    np.testing.assert_allclose(ratios, wright.multipliers[1].real, rtol=1e-2)


@pytest.mark.parametrize("length", [0.4, 1.0, 2.5])
def test_multipliers_are_the_characteristic_roots(length):
    """``exp(z length)`` with ``z = a + W_k(b exp(-a))``; shorter than the lag as well."""
    model = Linear()
    run = hy.simulate(model, [0.0], (0.0, length))
    found = np.linalg.eigvals(monodromy(run, framed(run).finer())[0])
    roots = model.a + np.array([lambertw(model.b * np.exp(-model.a), k) for k in range(-4, 4)])
    for root in roots[np.argsort(-roots.real)][:6]:
        assert np.abs(found - np.exp(root * length)).min() < 1e-10


@pytest.mark.parametrize("tau", [0.17, 1.3])
def test_the_variation_of_a_history_is_the_derivative_of_the_flow(tau):
    """Of values and of the time of the jump that is remembered, against differences."""
    orbit = bounced(Table(tau=tau), "keep")
    run, frame = orbit.run, framed(orbit.run)
    assert len(frame.leaps) == (tau > orbit.period)
    matrix, _ = monodromy(run, frame)
    shooting = HistoryShooting(Table(tau=tau), True, 1e-9, {"rtol": 1e-11, "atol": 1e-12})
    turn = shooting.turn(Guess(run.t0, run.parts[0].first, None, orbit.period, _history(run)))
    size = len(matrix) - len(frame.leaps)
    step = np.zeros(len(matrix))
    wave = [np.stack([np.cos(points), np.sin(2 * points)], 1) for points in frame.points]
    step[:size] = np.reshape(wave, -1)
    step[size:] = 0.3

    def end(share):
        guess = shooting.changed(turn, share * step, 0.0)
        later = shooting.fly(guess, orbit.period)
        found = leaps(later.hindsight.record(0), later.t1 - tau, later.t1, [0, 1])
        states = frame.states(later.hindsight.record(0), orbit.period, found)
        return np.append(states, [leap.t for leap in found])

    difference, expected = (end(1e-4) - end(-1e-4)) / 2e-4, matrix @ step
    inside = np.ones((len(frame.pieces), frame.degree + 1, 2), dtype=bool)
    inside[:, [0, -1]] = False  # where a kink is on the other side of a point for a neighbour
    kept = np.append(inside, np.ones(len(frame.leaps), dtype=bool))
    np.testing.assert_allclose(difference[kept], expected[kept], atol=3e-6)


def _history(run):
    return run.hindsight.before(0, run.t0)


@pytest.mark.parametrize("memory", ["keep", *later("restart")])
def test_a_short_lag_is_none(memory):
    """A lag of 1e-8, and none: the same orbit and multipliers."""
    short, none = bounced(Table(tau=1e-8), memory), bounced(Forgetful())
    same(short.multipliers, none.multipliers, 7)
    np.testing.assert_allclose(short.extrema["x"], none.extrema["x"], atol=1e-7)


def test_chattering_seen_a_short_lag_later():
    """With a speed that does not tend to zero: flights near the limit are too short to be seen."""
    model, period = Table(gain=0.3, tau=0.01, amplitude=0.45), 2 * np.pi / 5.0
    start = {"x": 0.35859589539061, "v": 1.35931033808517}
    runs = [
        hy.simulate(model, start, (10.2375190340659883, 10.2375190340659883 + 2 * period), **fine)
        for fine in ({}, {"rtol": 1e-12, "atol": 1e-13})
    ]
    for run in runs:
        assert len(run.zeno) == 2
        assert run.zeno[1].t - run.zeno[0].t == pytest.approx(period, rel=1e-6)
    assert runs[0].final.v == pytest.approx(runs[1].final.v, rel=1e-7)


def test_no_gain_is_no_delay():
    """What is seen, but does not count, adds multipliers that are 0."""
    none = bounced(Forgetful(gain=0.0))
    for memory in ("keep", "restart"):
        same(bounced(Table(gain=0.0), memory).multipliers, none.multipliers, 10)


# ---------------------------------------------------------------------------------------
# what is not known is refused


class Later(Wright):
    """A lag that depends on time."""

    @hy.mode
    def flow(self, t, s, past):
        return (-past(1.0 + 0.1 * jnp.sin(t)).y,)


def test_what_is_not_known_is_refused():
    with pytest.raises(hy.OrbitError, match="depends on time or state"):
        hy.periodic_orbit(Later(), [0.5], period=2 * np.pi)
    with pytest.raises(hy.OrbitError, match="looks into the past"):
        hy.lyapunov(Wright(), [0.5], (0.0, 10.0))
    run = hy.simulate(Wright(), [0.5], (0.0, 1.0))
    with pytest.raises(hy.OrbitError, match="looks into the past"):
        list(factors(Wright(), run))
    with pytest.raises(hy.OptionError, match="longest lag is 0"):
        bounced(Table(tau=0.0), "keep")


# ---------------------------------------------------------------------------------------
# rest for ever


@pytest.mark.parametrize("start", [2.1, 2.5, 10.0, *later(3.0, 5.0, 100.0, 200.0)])
def test_control_that_remembers_ends_at_rest_for_ever(start):
    """A lag after the accumulation: the load is ``9 + 30 (past - 2)``, and there is no less."""
    run = hy.simulate(Pyragas(), [start, 0.0], (0.0, 4.0))
    found = run.settles()
    assert (found.kind, found.for_ever) == ("rest", True)
    since = f"since t = {run.zeno[0].t + 1.0:.9g} everything that the load depends on stands still"
    assert since in found.reason
    assert "it is 9 and was never below 9" in found.reason


def test_a_lag_must_have_passed():
    """Before, what comes out of the past may still lift it."""
    run = hy.simulate(Pyragas(), [2.5, 0.0], (0.0, 1.5))
    found = run.settles()
    assert (found.kind, found.for_ever) == ("rest", False)
    assert f"changes until t = {run.zeno[0].t + 1.0:.9g}" in found.reason


def test_rests_that_end_are_not_for_ever():
    """With C = 60 and r = 0.2 it is lifted four times; then it rests for ever."""
    model, start = Pyragas(C=60.0, r=0.2), [2.5, 0.0]
    whole = hy.simulate(model, start, (0.0, 20.0))
    releases = [point.t_release for point in whole.zeno]
    assert len(releases) == 5
    assert releases.pop() is None
    for point, release in zip(whole.zeno, releases, strict=False):
        run = hy.simulate(model, start, (0.0, 0.5 * (point.t + release)))
        assert run.mode == "flight.rest(impact)"
        assert not run.settles().for_ever
    assert whole.settles().for_ever
    assert "was never below 6.389" in whole.settles().reason


def test_time_may_end_a_rest():
    """A force that depends on it, but not one that depends on the past."""
    still = hy.simulate(Pressed(), [1.0, 0.0], (0.0, 9.0)).settles()
    assert (still.kind, still.for_ever) == ("rest", True)
    found = hy.simulate(Changing(), [1.0, 0.0], (0.0, 9.0)).settles()
    assert (found.kind, found.for_ever) == ("rest", False)
    assert "not known to be for ever: the flow in flight.rest(impact) depends on" in found.reason


def test_a_run_from_a_file_does_not_know_its_model(tmp_path):
    run = hy.simulate(Pyragas(), [2.5, 0.0], (0.0, 4.0))
    run.save(tmp_path / "run.nc")
    found = hy.load(tmp_path / "run.nc").settles()
    assert (found.kind, found.for_ever) == ("rest", False)
