"""Return maps, the first variation, and periodic orbits."""

import math
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import hybrid as hy
from hybrid.variation import factors
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.relay import Relay
from models.two_tanks import TwoTanks
from tests.oscillators import Beside, Chain, VanDerPol, bouncing, flight
from tests.switched import Rings, StickSlip
from tests.systems import ForcedOscillator, Oscillator, Room, Thermostat

FINE = {"rtol": 1e-12, "atol": 1e-13}

#: Period of van der Pol's oscillator for mu = 1, from the literature.
VAN_DER_POL = 6.6632868593231301897


def variation(model, run):
    """The product of all factors."""
    matrix = np.eye(run.spec.dimension)
    for factor in factors(model, run):
        matrix = factor.matrix @ matrix
    return matrix


def differences(model, x, t, step):
    """The same from central differences of fourth order of the flow itself."""
    columns = []
    for unit in np.eye(len(x)):
        ends = {}
        for k in (-2, -1, 1, 2):
            final = hy.simulate(model, (x + k * step * unit).tolist(), t, **FINE).final
            ends[k] = np.array([float(v) for v in final])
        columns.append((8 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12 * step))
    return np.array(columns).T


# ---------------------------------------------------------------------------------------
# the first variation


@pytest.mark.parametrize(
    ("model", "x", "t"),
    [
        (BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0.0, 2.2)),  # moving contact
        (ForcedOscillator(), [-1.0, 0.3], (0.0, 9.0)),  # a time-dependent force
        (Thermostat(), [19.0], (0.0, 3.0)),  # edges between two modes
        (Chain(), [0.0, 0.5], (0.0, 2.0)),  # two jumps with no time between them
        (Room(), [1.0, 1.0, 1.0, 0.0], (0.0, 2.4)),  # an impact while another contact is held
        (StickSlip(), [0.3, 0.1], (0.0, 9.0)),  # onto a surface, along it, and off it again
    ],
    ids=["table", "forced", "thermostat", "chain", "room", "stick-slip"],
)
def test_the_variation_is_the_derivative_of_the_flow(model, x, t):
    """Against differences with a step of 1e-5, which 1e-12 in the flow makes 1e-7."""
    exact = variation(model, hy.simulate(model, x, t, **FINE))
    np.testing.assert_allclose(differences(model, np.array(x), t, 1e-5), exact, atol=2e-7)


@pytest.mark.parametrize("r", [0.3, 0.6])
def test_the_variation_passes_an_accumulation(r):
    """And the rest after it: two ranks are lost there, two go on. Differences as above."""
    model, x, t = Beside(r=r), np.array([1.0, 0.0, 0.3, -0.2]), (0.0, 9.0)
    run = hy.simulate(model, x.tolist(), t, **FINE)
    assert run.zeno
    assert run.mode == "flight.rest(floor)"
    exact = variation(model, run)
    np.testing.assert_allclose(differences(model, x, t, 1e-5), exact, atol=2e-7)
    assert np.linalg.matrix_rank(exact, tol=1e-9) == 2


def test_the_saltation_of_a_bouncing_ball():
    """``[[-r, 0], [(1 + r) g / v, -r]]`` with ``v`` the speed before the impact (known)."""
    g, r, v = 9.81, 0.7, -math.sqrt(2 * 9.81)
    run = hy.simulate(BouncingBall(), [1.0, 0.0], (0.0, 0.6), **FINE)
    (jump,) = (factor for factor in factors(BouncingBall(), run) if factor.edge)
    expected = [[-r, 0.0], [-(1 + r) * g / v, -r]]
    np.testing.assert_allclose(jump.matrix, expected, rtol=1e-12, atol=1e-15)


def test_no_variation_through_the_limit_of_a_cycle():
    """Two tanks: the series of a cycle of edges is extrapolated, not summed; so it is refused."""
    run = hy.simulate(TwoTanks(), [8.0, 8.0], (0.0, 30.0))
    assert run.zeno
    with pytest.raises(hy.OrbitError, match="limit of a cycle"):
        list(factors(TwoTanks(), run))


# ---------------------------------------------------------------------------------------
# return maps


def test_impacts_of_a_ball_as_a_map():
    """``v -> r v`` after ``2 v / g``, for every iterate."""
    P = hy.return_map(BouncingBall(), "impact")
    found = P.iterate({"x": 0.0, "v": 1.0}, 10)
    powers = 0.7 ** np.arange(11)
    np.testing.assert_allclose(found.v, powers, rtol=1e-12)
    np.testing.assert_allclose(np.diff(found.t), 2 / 9.81 * powers[:-1], rtol=1e-12)
    assert len(found) == 11
    assert found[3].x == 0.0
    assert P.run([0.0, 1.0]).jumps.edge.tolist() == ["impact"]


def test_a_surface_as_a_section():
    """Turning points of a harmonic oscillator, rising and falling ones."""
    free = Oscillator(wall=-2.0)
    top = hy.return_map(free, lambda self, t, s: s.v, crossing=hy.FALLING)
    either = hy.return_map(free, lambda self, t, s: s.v, crossing=hy.EITHER)
    assert top.time([1.0, 0.0]) == pytest.approx(2 * math.pi, abs=1e-11)  # rtol, over a turn
    assert either([1.0, 0.0]).x == pytest.approx(-1.0, abs=1e-11)


def test_a_stroboscopic_map():
    """A harmonic oscillator seen every ``pi / 2`` turns by a quarter."""
    P = hy.return_map(Oscillator(wall=-2.0), math.pi / 2)
    np.testing.assert_allclose(P.iterate([1.0, 0.0], 4).x, [1, 0, -1, 0, 1], atol=1e-10)


def test_a_map_through_accumulation_and_rest():
    """From release to release: the table lets go where ``A w^2 sin(w t) = g``, a period apart."""
    model = BeadOnTable(r=0.6, omega=3.5)
    found = hy.return_map(model, "impact.release").iterate([1.5, 0.0], 4)
    np.testing.assert_allclose(found.x[1:], 9.8 / 3.5**2, rtol=1e-11)  # sin = g / (A w^2)
    np.testing.assert_allclose(np.diff(found.t)[1:], 2 * math.pi / 3.5, rtol=1e-11)


class Ticking(hy.Automaton):
    """Two clocks that agree at every second tick, and an event that counts and kicks."""

    x = hy.state()
    v = hy.state()
    u = hy.state()
    n: int = hy.discrete(0)
    each: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def swing(self, t, s):
        return s.v, -s.x - 0.05 * s.v * jnp.minimum(s.n, 3) + s.u, 0.0

    @hy.edge(swing, every="each")
    def one(self, t, s):
        return s.replace(u=-0.2 * s.x)

    @hy.edge(swing, every=0.2)
    def other(self, t, s):
        return s.replace(v=0.99 * s.v)

    @hy.edge(swing, to=swing, guard=lambda self, t, s: s.x, crossing=hy.RISING)
    def up(self, t, s):
        return s.replace(n=s.n + 1, v=s.v + 0.2)


@pytest.mark.parametrize("section", ["one", "other", "up", 0.1])
def test_iterates_are_the_returns_of_one_run(section):
    """What fires at the instant of a return still fires behind it, what has fired does not again,
    discrete variables go on, and periods add up to the times of a clock. The steps of both end at
    every tick, so they differ by rounding."""
    start, n = {"x": 0.5, "v": 0.0, "u": 0.3, "n": 0}, 40
    found = hy.return_map(Ticking(), section, **FINE).iterate(start, n)
    run = hy.simulate(Ticking(), start, (0.0, found.t[-1]), **FINE)
    if section == 0.1:  # where both tick, the state is that behind both
        np.testing.assert_array_equal(found.t, 0.1 * np.arange(n + 1))
        expected = [run(t) for t in found.t[1:].tolist()]
    else:
        rows = [jump for jump in run.jumps if jump.edge == section]
        np.testing.assert_allclose(found.t[1:], [jump.t for jump in rows], rtol=1e-12)
        expected = [jump.after for jump in rows]
    for name in ("x", "v", "u", "n"):
        np.testing.assert_allclose(
            getattr(found, name)[1:], [getattr(row, name) for row in expected], atol=1e-11
        )


def test_a_state_on_an_event_has_met_it():
    """As a map from just after a jump to just after the next one: not at once, at no time."""
    run = hy.simulate(Ticking(), {"x": 0.5, "v": 0.0, "u": 0.3}, (0.0, 20.0), **FINE)
    first, second = [jump for jump in run.jumps if jump.edge == "up"][:2]
    back = hy.return_map(Ticking(), "up", **FINE).run(first.after, first.t)
    assert back.t1 == pytest.approx(second.t, rel=1e-12)
    assert back.final.v == pytest.approx(second.after.v, rel=1e-10)
    assert back.final.n == second.after.n == 2


def test_what_is_no_return():
    """Unknown sections; a ball that comes to rest; a run that its options end."""
    with pytest.raises(
        hy.OptionError, match=r"'wall': there are the jumps impact, impact\.release"
    ):
        hy.return_map(BouncingBall(), "wall")
    with pytest.raises(hy.OptionError, match="a period greater than 0"):
        hy.return_map(BouncingBall(), -1.0)
    with pytest.raises(hy.OptionError, match="section"):
        hy.return_map(BouncingBall(), lambda self, t, s: s.height)
    never = hy.return_map(BouncingBall(), "impact.release", t_max=5.0)
    with pytest.raises(hy.OrbitError, match=r"within t_max = 5: it is in flight.rest\(impact\)"):
        never([1.0, 0.0])
    with pytest.raises(hy.OrbitError, match="stopped at an accumulation"):
        hy.return_map(BouncingBall(), 4.0, zeno="stop")([1.0, 0.0])


# ---------------------------------------------------------------------------------------
# periodic orbits


def test_van_der_pols_period():
    """Twelve digits; the other multiplier is the exponential of the divergence's integral."""
    orbit = hy.periodic_orbit(VanDerPol(), {"x": 2.0, "v": 0.1})
    assert orbit.period == pytest.approx(VAN_DER_POL, rel=1e-12)
    t, weights = np.polynomial.legendre.leggauss(200)
    times = orbit.run.t0 + orbit.period * (0.5 + 0.5 * t)
    divergence = 0.5 * orbit.period * weights @ (1 - orbit.run(times).x ** 2)
    first, second = orbit.multipliers
    assert first == pytest.approx(1.0, abs=1e-10)
    assert second == pytest.approx(math.exp(divergence), rel=1e-8)  # quadrature
    assert orbit.stable
    assert orbit.jumps == 0
    assert orbit.extrema["x"] == pytest.approx((-2.00861986087, 2.00861986087), rel=1e-10)


def test_an_unstable_cycle():
    """Van der Pol's cycle with time reversed: no iteration would find it."""
    orbit = hy.periodic_orbit(VanDerPol(mu=-1.0), [2.0, 0.0])
    assert orbit.period == pytest.approx(VAN_DER_POL, rel=1e-12)
    assert not orbit.stable
    assert abs(orbit.multipliers[0]) > 1000


@pytest.mark.parametrize("sign", [1, -1], ids=["stable", "saddle"])
def test_a_ball_on_a_table(sign):
    """Both orbits of one impact a period, closed form: period, speed, phase, multipliers."""
    r = 0.8
    model, period, speed, since, trace = bouncing(r, 0.2, 5.0, sign)
    guess = flight(model, 1.01 * speed, since, 0.1)
    orbit = hy.periodic_orbit(model, guess, t=since + 0.1, period=period)
    assert orbit.jumps == 1
    assert orbit.run.jumps.t[0] % period == pytest.approx(since % period, abs=1e-11)
    assert orbit.extrema["v"] == pytest.approx((-speed, speed), rel=1e-11)
    assert np.sum(orbit.multipliers).real == pytest.approx(trace, rel=1e-10)
    assert np.prod(orbit.multipliers).real == pytest.approx(r**2, rel=1e-10)
    assert orbit.stable == (sign == 1)


def test_a_forced_impact_oscillator():
    """Against the flight in closed form: ``gamma cos w t + a cos + b sin``, closed by fsolve."""
    w, r = 2.8, 0.8
    period, gamma = 2 * math.pi / w, 1 / (1 - w**2)

    def closes(unknown):
        since, v = unknown
        a, b = -gamma * math.cos(w * since), v + gamma * w * math.sin(w * since)
        end = gamma * math.cos(w * since) + a * math.cos(period) + b * math.sin(period)
        arrives = -gamma * w * math.sin(w * since) - a * math.sin(period) + b * math.cos(period)
        return end, r * arrives + v

    since, v = fsolve(closes, [1.1, -0.6], xtol=1e-13)
    orbit = hy.periodic_orbit(ForcedOscillator(w=w, r=r), [-0.5, 0.0], period=period)
    (jump,) = orbit.run.jumps
    assert jump.after.v == pytest.approx(v, rel=1e-11)
    assert (jump.t - since) % period == pytest.approx(0.0, abs=1e-10) or (
        (since - jump.t) % period == pytest.approx(0.0, abs=1e-10)
    )
    assert np.prod(orbit.multipliers).real == pytest.approx(r**2, rel=1e-10)  # no damping
    assert not orbit.stable


def test_a_thermostats_cycle():
    """Two exponentials: ``2 log(3/2)``; an edge as the section."""
    orbit = hy.periodic_orbit(Thermostat(), [20.0], section="cold")
    assert orbit.period == pytest.approx(2 * math.log(1.5), rel=1e-12)
    assert orbit.extrema["T"] == pytest.approx((18.0, 22.0), rel=1e-12)
    assert orbit.jumps == 2


def test_an_orbit_that_chatters_and_sticks():
    """Complete chattering, rest, release in each period: nothing of a change is left."""
    model = BeadOnTable(r=0.3, omega=3.5)
    period = 2 * math.pi / 3.5
    orbit = hy.periodic_orbit(model, [1.5, 0.0], period=period, settle=3)
    assert orbit.jumps == math.inf
    (stick,) = orbit.sticks
    assert stick.mode == "flight.rest(impact)"
    released = math.asin(9.8 / 3.5**2) / 3.5  # A w^2 sin(w t) = g
    assert stick.t1 % period == pytest.approx(released, abs=1e-11)
    assert orbit.multipliers.tolist() == [0, 0]
    assert orbit.stable
    assert [factor.edge for factor in orbit.saltations][-1] == "impact.release"


def test_multipliers_through_chattering():
    """With an oscillator beside the ball two are not 0: against differences of a period's flow."""
    model, period = Beside(r=0.4, amplitude=4.0), 2 * math.pi
    orbit = hy.periodic_orbit(model, [4.0, 0.0, 0.0, 0.0], period=period, settle=20)
    assert orbit.residual < 1e-11
    assert orbit.jumps == math.inf
    assert orbit.run.parts[0].mode == "flight"
    x = np.array([float(v) for v in orbit.start])
    numeric = differences(model, x, (orbit.run.t0, orbit.run.t0 + period), 1e-5)
    np.testing.assert_allclose(orbit.monodromy, numeric, atol=1e-7 * np.abs(numeric).max())
    assert np.abs(orbit.multipliers[:2]) == pytest.approx([0.685, 0.685], abs=1e-3)
    assert np.all(np.abs(orbit.multipliers[2:]) < 1e-6)  # a double 0: the root of rounding


def test_sliding_orbits():
    """On the unit circle at the mean angular speed 3/2; a relay on and off its surface."""
    ring = hy.periodic_orbit(Rings(), [0.8, 0.1], mode="down", settle=1)
    assert ring.period == pytest.approx(2 * math.pi / 1.5, rel=1e-11)
    assert sorted(np.abs(ring.multipliers)) == pytest.approx([0, 1], abs=1e-9)
    assert {stick.mode for stick in ring.sticks} == {"slide(line)"}
    relay = hy.periodic_orbit(Relay(), [0.5], period=math.pi)
    assert len(relay.sticks) == 2
    assert relay.multipliers.tolist() == [0]


def test_a_multiple_of_the_period_is_taken_once():
    """A guess of twice the period gives the orbit, not twice the orbit."""
    orbit = hy.periodic_orbit(VanDerPol(), [2.0, 0.1], period=13.3)
    assert orbit.period == pytest.approx(VAN_DER_POL, rel=1e-12)


def test_a_run_as_guess():
    """Its last state, mode and time."""
    model, period, *_ = bouncing(0.8, 0.2, 5.0)
    run = hy.simulate(model, flight(model, 6.2, 0.16, 0.1), (0.26, 0.26 + 40 * period))
    assert hy.periodic_orbit(model, run, period=period).stable


def test_a_touch_is_warned_of():
    """A harmonic oscillator that just touches its wall: neutral, and grazing."""
    with pytest.warns(UserWarning, match="impact comes to .* of zero at"):
        orbit = hy.periodic_orbit(Oscillator(wall=-1.0), [0.8, -0.6], period=2 * math.pi)
    assert "neutral" in str(orbit)
    assert not orbit.stable


class Driven(hy.Automaton):
    """A damped oscillator driven at the frequency 2.8, in a unit of its own, above a wall."""

    x = hy.state()
    v = hy.state()
    unit: float = hy.parameter(1.0)
    wall: float = hy.parameter(-0.2)

    @hy.mode
    def flow(self, t, s):
        return s.v, -s.x - 0.2 * s.v + self.unit * jnp.cos(2.8 * t)

    impact = hy.contact(flow, gap=lambda self, t, s: s.x - self.wall, restitution=0.8)


@pytest.mark.parametrize(("unit", "inside"), [(1.0, 1e-9), (1e6, 0.0), (1e6, 1e-12), (1e-6, 0.0)])
def test_a_touch_from_beyond_is_warned_of(unit, inside):
    """Where rounding or the tolerances put the wall a little before the turn of the orbit, whose
    amplitude is known: the run passes it, and its multipliers are those without a wall."""
    response = 1.0 / (1.0 - 2.8**2 + 0.2j * 2.8)
    model = Driven(unit=unit, wall=-unit * abs(response) * (1.0 - inside))
    start = [unit * response.real, unit * (2.8j * response).real]
    with pytest.warns(UserWarning, match="impact comes to .* of zero at"):
        orbit = hy.periodic_orbit(model, start, period=2 * math.pi / 2.8)
    assert orbit.jumps == 0


class Apart(VanDerPol):
    """Van der Pol's oscillator, with a state that is 0 and stays so beside it."""

    z = hy.state()

    @hy.mode
    def flow(self, t, s):
        return s.v, (1.0 - s.x**2) * s.v - s.x, -s.z


def test_a_state_that_is_zero_and_stays_so_has_an_orbit():
    """The plane of its first return is across what moves."""
    orbit = hy.periodic_orbit(Apart(), [2.0, 0.1, 0.0])
    assert orbit.period == pytest.approx(VAN_DER_POL, rel=1e-11)
    assert np.sort(np.abs(orbit.multipliers))[1] == pytest.approx(math.exp(-VAN_DER_POL), rel=1e-7)


class Dragged(hy.Automaton):
    """A drag by the square of the speed: its formula changes where the body turns."""

    x = hy.state()
    v = hy.state()
    wall: float = hy.parameter(-5.0)

    @hy.mode
    def flow(self, t, s):
        return s.v, -s.x - 0.2 * s.v * jnp.abs(s.v) + jnp.cos(2.0 * t)

    impact = hy.contact(flow, gap=lambda self, t, s: s.x - self.wall, restitution=0.8)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_an_orbit_turns_where_its_flow_changes(solver):
    """Its extrema are where steps meet; half a period later the orbit is its own mirror image. A
    wall there is told once."""
    asked = {"period": math.pi, "solver": solver}
    orbit = hy.periodic_orbit(Dragged(), [0.3, 0.0], settle=30, **asked)
    low, high = orbit.extrema["x"]
    inside = orbit.run(np.linspace(orbit.run.t0, orbit.run.t1, 2001)).x
    assert low <= inside.min()
    assert low == pytest.approx(-high, rel=1e-10)  # the tolerances, 1e-12, over a turn
    with pytest.warns(UserWarning, match="impact comes to .* of zero at"):
        touching = hy.periodic_orbit(Dragged(wall=low), orbit.start, t=orbit.run.t0, **asked)
    assert len(touching.grazing) == 1


class Brushing(VanDerPol):
    """Its wall cuts a millionth off the cycle, whose least ``x`` is -2.00861986."""

    impact = hy.contact("flow", gap=lambda self, t, s: s.x + 2.008619, restitution=0.8)


def test_a_jump_that_nearly_grazes_is_warned_of():
    """The determinant still holds: ``r^2`` times the exponential of the divergence's integral."""
    with pytest.warns(UserWarning, match="near to grazing: its guard is reached at 0.0018"):
        orbit = hy.periodic_orbit(Brushing(), [2.0, 0.0])
    bare = 0.000859695  # without the wall, which moves the orbit by a thousandth
    assert orbit.multipliers[1] == pytest.approx(0.8**2 * bare, rel=0.01)
    assert orbit.jumps == 1


class Sampled(hy.Automaton):
    """Control of an unstable state, held between samples."""

    x = hy.state()
    u = hy.state()
    gain = hy.parameter(3.0)

    @hy.mode
    def held(self, t, s):
        return s.x + s.u + 1.0, 0.0

    @hy.edge(held, every=0.25)
    def sample(self, t, s):
        return s.replace(u=-self.gain * s.x)


class Swing(hy.Automaton):
    """Mathieu's equation: the length of a pendulum is shaken."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def swing(self, t, s):
        return s.v, -(0.25 + 0.3 * jnp.cos(t)) * s.x - 0.02 * s.v


@pytest.mark.parametrize("gain", [1.6, 8.0, 9.0])
def test_a_state_that_stays_tells_the_period_by_its_neighbours(gain):
    """It closes over any time. Per sample the multiplier is that of the exact solution."""
    model, x = Sampled(gain=gain), 1.0 / (gain - 1.0)
    rest = {"x": x, "u": -gain * x}
    for period in (0.3, 0.4, 0.7):
        with pytest.raises(hy.OptionError, match=r"carries nearby .* give the period"):
            hy.periodic_orbit(model, rest, t=0.1, period=period)
    exact = math.exp(0.25) - gain * (math.exp(0.25) - 1.0)
    for start in (rest, {"x": 1.0, "u": -1.0}):  # affine: one step of Newton's method is enough
        orbit = hy.periodic_orbit(model, start, t=0.1, period=0.25)
        assert orbit.multipliers[0] == pytest.approx(exact, abs=1e-9)
        assert orbit.stable == (abs(exact) < 1.0)


def test_a_pendulum_that_hangs_still_has_the_period_of_the_shaking():
    model = Swing()
    for period in (1.5, 5.0, math.pi):
        with pytest.raises(hy.OptionError, match=r"carries nearby .* give the period"):
            hy.periodic_orbit(model, {"x": 0.0, "v": 0.0}, period=period)
    orbit = hy.periodic_orbit(model, {"x": 0.0, "v": 0.0}, period=2.0 * math.pi)
    assert np.prod(orbit.multipliers) == pytest.approx(math.exp(-0.04 * math.pi), abs=1e-9)


def test_a_surface_may_be_crossed_either_way():
    """Upwards and downwards it is the same orbit, its start on either side."""
    surface, start = (lambda self, t, s: s.x - 0.5), {"x": 2.0, "v": 0.0}
    for crossing in (hy.RISING, hy.FALLING):
        orbit = hy.periodic_orbit(VanDerPol(), start, section=surface, crossing=crossing)
        assert orbit.period == pytest.approx(6.66328685932313, abs=1e-11)
    for call in (hy.periodic_orbit, hy.return_map):
        given = (VanDerPol(), start) if call is hy.periodic_orbit else (VanDerPol(),)
        with pytest.raises(hy.OptionError, match=r"crossing='up': give hy.RISING"):
            call(*given, section=surface, crossing="up")


def test_what_is_no_orbit():
    """A forced model without a period; a ball that comes to rest; an equilibrium."""
    with pytest.raises(hy.OptionError, match="depends on time: give period="):
        hy.periodic_orbit(BeadOnTable(), [1.5, 0.0])
    with pytest.raises(hy.OptionError, match=r"period=2\.0: .* does not close; give the period"):
        hy.periodic_orbit(ForcedOscillator(), [-0.5, 0.0], period=2.0)  # the forcing's is 2.24
    with pytest.raises(hy.OrbitError, match=r"no periodic orbit was found\. From the guess: "):
        hy.periodic_orbit(BouncingBall(), [1.0, 0.0], t_max=20.0)
    with pytest.raises(hy.OrbitError, match="is an equilibrium"):
        hy.periodic_orbit(VanDerPol(), [0.0, 0.0])
    with pytest.raises(hy.StartError, match="no value for v"):
        hy.periodic_orbit(VanDerPol(), {"x": 1.0})


class Pair(hy.Automaton):
    """Two oscillators that know nothing of each other, each before its wall."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()

    @hy.mode
    def swing(self, t, s):
        return s.u, s.w, -s.x, -s.y

    one = hy.contact(swing, gap=lambda self, t, s: s.x + 0.5, restitution=0.9)
    other = hy.contact(swing, gap=lambda self, t, s: s.y + 0.5, restitution=0.9)


def test_jumps_together_that_neighbours_have_apart_are_refused():
    """In step they strike at once; out of step each has the matrix that it has alone."""
    run = hy.simulate(Pair(), [1.0, 1.0, 0.0, 0.0], (0.0, 3.0), **FINE)
    with pytest.raises(hy.OrbitError, match="at the same instant"):
        list(factors(Pair(), run))
    apart = hy.simulate(Pair(), [1.0, 1.1, 0.0, 0.0], (0.0, 3.0), **FINE)
    exact = differences(Pair(), np.array([1.0, 1.1, 0.0, 0.0]), (0.0, 3.0), 1e-3)
    np.testing.assert_allclose(variation(Pair(), apart), exact, atol=1e-8)


def test_iterates_do_not_pass_over_impacts_that_drown_in_rounding():
    """On a table that moves, a state tells an impact from rest only for so long."""
    model, start = BeadOnTable(amplitude=0.32, omega=5.6, r=0.13), {"x": 1.0, "v": 0.0}
    impacts = hy.return_map(model, "impact", solver="taylor")
    run = hy.simulate(model, start, (0, 1), solver="taylor")
    np.testing.assert_allclose(impacts.iterate(start, 3).t[1:], run.jumps.t[:3], rtol=1e-12)
    with pytest.raises(hy.OrbitError, match=r"accumulate.*no longer tells them from rest"):
        impacts.iterate(start, 40)


def test_iterates_go_on_from_an_impact_that_leaves_no_speed():
    """With r = 0 a bead rests from the first impact on; the next is that after a release."""
    model, start = BeadOnTable(amplitude=0.32, omega=5.6, r=0.0), {"x": 1.0, "v": 0.0}
    found = hy.return_map(model, "impact", solver="taylor").iterate(start, 4)
    run = hy.simulate(model, start, (0, found.t[-1] + 0.1), solver="taylor")
    impacts = [jump.t for jump in run.jumps if jump.edge == "impact"]
    np.testing.assert_allclose(found.t[1:], impacts[:4], rtol=1e-12)


class Clocked(hy.Automaton):
    """A ball that comes to rest at t = 3, beside something that turns once in 2 pi."""

    x = hy.state()
    v = hy.state()
    angle = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0, 1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("at", [0.5, 1.5, 2.3, 2.7, 2.999, 3.5])
def test_a_surface_is_met_in_a_series_of_impacts_too(solver, at):
    """The series is summed from the second impact on, at t = 2; the next turn would come later."""
    turns = hy.return_map(Clocked(), lambda self, t, s: jnp.sin(s.angle - at), **solver)
    start = {"x": 1.0, "v": 0.0, "angle": 0.0}
    run = turns.run(start)
    assert run.t1 == pytest.approx(at, abs=1e-7)
    flown = hy.simulate(Clocked(), start, (0, run.t1), **solver)
    assert run.final.x == pytest.approx(flown.final.x, abs=1e-7)
    assert len(run.jumps) == len(flown.jumps)


class Passing(hy.Automaton):
    """A forced oscillator with an event on a line through its plane."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def swing(self, t, s):
        return s.v, -s.x - 0.1 * s.v + jnp.sin(0.7 * t)

    up = hy.edge(swing, to=swing, guard=lambda self, t, s: s.x - 0.1 * s.v, crossing=hy.RISING)


class Sticky(hy.Automaton):
    """Dry friction against what moves along: sliding begins from above, and ends below."""

    x = hy.state()
    v = hy.state()
    w = hy.state()

    def force(self, t, s):
        return 1.3 * jnp.sin(0.7 * t) - s.x

    @hy.mode(initial=True)
    def faster(self, t, s):
        return s.v, self.force(t, s) - 1.0, s.x - s.w

    @hy.mode
    def slower(self, t, s):
        return s.v, self.force(t, s) + 1.0, s.x - s.w

    slip = hy.switching(faster, slower, surface=lambda self, t, s: s.v - 0.3 * s.w)


def met(model, start, surface, crossing, solver):
    """The times at which a lane meets a surface, up to t = 40; a map must meet it there, too."""
    asked = {"crossing": crossing, **solver}
    given = dict(zip(model.spec.names, start, strict=True))
    lanes = hy.ensemble(model, given | {"x": start[:1]}, (0, 40), section=surface, keep=9, **asked)
    found = lanes.t_section.values[0, : int(lanes.hits.values[0])]
    back = hy.return_map(model, surface, t_max=60.0, **asked).iterate(start, len(found))
    np.testing.assert_allclose(back.t[1:], found, rtol=1e-7)
    return found


def test_a_surface_on_which_a_guard_lies_is_crossed_where_the_run_goes_over_it(solver):
    """An event on it is a crossing; sliding on it is none, but the end of sliding on its other side
    is one. The times are those of the jumps, to the tolerances."""
    line = {"surface": lambda self, t, s: s.x - 0.1 * s.v, "solver": solver}
    run = hy.simulate(Passing(), [0.5, 0.2], (0, 40), **solver)
    rising = met(Passing(), [0.5, 0.2], crossing=hy.RISING, **line)
    np.testing.assert_allclose(rising, run.jumps.t, rtol=1e-7)
    falling = met(Passing(), [0.5, 0.2], crossing=hy.FALLING, **line)
    assert np.all(np.diff(np.sort([*rising, *falling])) > 1.0)
    both = met(Passing(), [0.5, 0.2], crossing=hy.EITHER, **line)
    np.testing.assert_allclose(both, np.sort([*rising, *falling]), rtol=1e-7)

    slip = {"surface": lambda self, t, s: s.v - 0.3 * s.w, "solver": solver}
    run = hy.simulate(Sticky(), [0.5, 0.7, 0.1], (0, 40), **solver)
    slips = [arc for arc in run.arcs if arc.mode in ("faster", "slower") and arc.length]
    for mode, crossing in (("slower", hy.FALLING), ("faster", hy.RISING)):
        over = [b.t0 for a, b in pairwise(slips) if a.mode != b.mode and b.mode == mode]
        assert over
        found = met(Sticky(), [0.5, 0.7, 0.1], crossing=crossing, **slip)
        np.testing.assert_allclose(found, over, rtol=1e-7)


def test_a_body_does_not_cross_the_floor_from_which_it_bounces(solver):
    """Nor where it rests on it."""
    floor = {"section": lambda self, t, s: s.x, "crossing": hy.EITHER}
    back = hy.return_map(BouncingBall(), t_max=10.0, **floor, **solver)
    with pytest.raises(hy.OrbitError, match="does not return to the surface"):
        back([1.0, 0.0])
    lanes = hy.ensemble(BouncingBall(), {"x": [1.0], "v": 0.0}, (0, 4), keep=9, **floor, **solver)
    assert lanes.hits.values.tolist() == [0]


def test_a_surface_that_jumps_is_met_once_a_turn():
    """The run of a return ends on either side of the jump, by rounding."""
    start = {"x": 1.0, "v": 0.0, "angle": 0.0}
    turns = hy.return_map(Clocked(), lambda self, t, s: jnp.sign(jnp.sin(s.angle - 3.5)))
    found = turns.iterate(start, 3)
    np.testing.assert_allclose(found.t[1:], 3.5 + 2 * np.pi * np.arange(3), rtol=1e-11)


def test_lanes_meet_a_surface_in_a_series_of_impacts_too():
    """As a return map does."""
    start = {"x": [1.0, 1.2], "v": 0.0, "angle": 0.0}
    asked = {"section": lambda self, t, s: s.angle - 2.3, "keep": 2}
    lanes = hy.ensemble(Clocked(), start, (0, 8), solver="taylor", **asked)
    assert lanes.hits.values.tolist() == [1, 1]
    np.testing.assert_allclose(lanes.t_section.values[:, 0], 2.3, rtol=1e-12)


class RestsBesideIdle(hy.Automaton):
    """A body that rests on a moving table, and an oscillator about ``y = 1.5``."""

    x, v, y, u = hy.state(), hy.state(), hy.state(), hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0, s.u, 1.5 - s.y - 0.2 * s.u

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 0.5 * jnp.sin(t), restitution=0.5)


@pytest.mark.parametrize("settle", [0, 5, 40])
def test_an_element_that_is_zero_but_for_rounding_closes(settle):
    """Once the oscillator has settled its speed is the rounding of ``y``, and closes to none of
    its own size."""
    start = {"x": 1.0, "v": 0.0, "y": 1.6, "u": 0.0}
    orbit = hy.periodic_orbit(RestsBesideIdle(), start, t=0.3, period=2 * np.pi, settle=settle)
    exact = np.exp(2 * np.pi * (-0.1 - 1j * np.sqrt(0.99) * np.array([1, -1])))
    found = orbit.multipliers
    assert found[np.argsort(-found.imag)[[0, -1]]] == pytest.approx(exact, abs=1e-9)
    assert np.sort(np.abs(found))[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
