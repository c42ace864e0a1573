"""Lyapunov exponents of flows with jumps."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.relay import Relay
from tests.contract.ways import later
from tests.oscillators import Baker, Linear, Lorenz, bouncing, flight
from tests.systems import ForcedOscillator


def test_a_linear_system():
    """Its eigenvalues: after a time of 30 the frame has turned to e^-30 of them."""
    found = hy.lyapunov(Linear(), [1.0, 1.0], (0.0, 40.0), transient=30.0)
    np.testing.assert_allclose(found.exponents, [0.3, -0.7], rtol=0, atol=1e-11)
    assert np.all(found.error < 1e-11)


def test_a_map_as_a_flow_with_jumps():
    """The baker's map in thirds: log 3 and -log 3 for every unit of time, 0 along the run."""
    found = hy.lyapunov(Baker(), [0.31415, 0.2, 0.0], (0.0, 60.5), transient=20.5)
    np.testing.assert_allclose(found.exponents, [math.log(3), 0, -math.log(3)], rtol=0, atol=1e-9)


def test_a_stable_impact_orbit():
    """On an orbit with a complex pair of multipliers each exponent is ``log|m| / T``.

    The sum is exact over whole periods; each of the two turns round with the frame, so that its
    mean over 200 periods is right to about 1/200.
    """
    model, period, speed, since, _ = bouncing(0.8, 0.2, 5.0)
    orbit = hy.periodic_orbit(model, flight(model, speed, since, 0.1), t=since + 0.1, period=period)
    span = (orbit.run.t0, orbit.run.t0 + 220 * period)
    found = hy.lyapunov(model, orbit.start, span, transient=20 * period, rtol=1e-10)
    expected = np.log(np.abs(orbit.multipliers)) / period
    assert found.sum == pytest.approx(expected.sum(), rel=1e-9)
    np.testing.assert_allclose(found.exponents, expected, rtol=0.05)


def test_a_saddle_of_impacts():
    """Real multipliers: both exponents, to the rounding that the unstable one lets grow."""
    model, period, speed, since, _ = bouncing(0.8, 0.2, 5.0, -1)
    orbit = hy.periodic_orbit(model, flight(model, speed, since, 0.1), t=since + 0.1, period=period)
    span = (orbit.run.t0, orbit.run.t0 + 14 * period)
    found = hy.lyapunov(model, orbit.start, span, transient=8 * period, rtol=1e-12, atol=1e-13)
    expected = np.log(np.abs(orbit.multipliers)) / period
    np.testing.assert_allclose(found.exponents, expected, rtol=1e-4)


def test_lorenz():
    """0.9056, 0, -14.572 (Viswanath 1998; Sprott 2003), within three standard errors."""
    found = hy.lyapunov(Lorenz(), [1.0, 1.0, 20.0], (0.0, 160.0), transient=10.0, rtol=1e-7)
    assert np.all(np.abs(found.exponents - [0.9056, 0.0, -14.5723]) <= 3 * found.error)
    assert np.all(found.error < 0.1)
    assert found.sum == pytest.approx(-10 - 1 - 8 / 3, rel=1e-10)  # the divergence
    assert len(found.times) == len(found.running)
    assert found.running[-1] == pytest.approx(found.exponents)


def test_the_sum_is_that_of_divergence_and_jumps():
    """No damping, and each impact has the determinant ``r^2``: chaos, but a known sum."""
    found = hy.lyapunov(ForcedOscillator(), [-0.5, 0.0], (0.0, 150.0))
    expected = 2 * math.log(0.8) * len(found.run.jumps) / (found.run.t1 - found.run.t0)
    assert found.sum == pytest.approx(expected, rel=1e-9)
    assert found.exponents[0] > 3 * found.error[0] > 0


def test_directions_are_lost_for_good():
    """Sliding takes one, an accumulation of impacts and the rest after it take two."""
    slides = hy.lyapunov(Relay(), [0.5], (0.0, 12.0))
    assert slides.exponents.tolist() == [-math.inf]
    rests = hy.lyapunov(BeadOnTable(r=0.3, omega=3.5), [1.5, 0.0], (0.0, 12.0))
    assert rests.exponents.tolist() == [-math.inf, -math.inf]


class Beside(hy.Automaton):
    """A bead on a shaking table, and a coordinate of its own that decays at the rate 0.3."""

    x = hy.state()
    v = hy.state()
    q = hy.state()
    r = hy.parameter(0.7)
    amplitude = hy.parameter(0.1)
    omega = hy.parameter(0.3)

    @hy.mode(initial=True)
    def f(self, t, s):
        return s.v, -9.8, -0.3 * s.q

    table = hy.contact(
        f, gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(self.omega * t), restitution="r"
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("r", "omega", "amplitude"),
    [(0.7, 0.3, 0.1), (0.7, 1.0, 0.1), (0.85, 0.5, 0.02), (0.5, 0.1, 1.0), (0.3, 2.0, 0.5)],
)
def test_a_rest_on_a_moving_table_loses_two_directions(r, omega, amplitude, solver):
    """What the matrix of the limit has off zero is its error, and no direction: -inf, not -13."""
    given, start = {"r": r, "omega": omega, "amplitude": amplitude}, [amplitude + 0.6, 0.0]
    options = {"transient": 0.0, "solver": solver}
    rests = hy.lyapunov(BeadOnTable(**given), start, (0.0, 20.0), **options)
    assert len(rests.run.zeno) == 1
    assert rests.exponents.tolist() == [-math.inf, -math.inf]
    beside = hy.lyapunov(Beside(**given), [*start, 1.0], (0.0, 20.0), **options)
    # a direction at random has some share of its own, of which a hundredth counts log(100) / 20
    assert beside.exponents[0] == pytest.approx(-0.3, abs=0.25)
    assert beside.exponents[1:].tolist() == [-math.inf, -math.inf]


def test_the_largest_alone():
    """``count`` of them, from the largest on."""
    found = hy.lyapunov(Linear(), [1.0, 1.0], (0.0, 60.0), count=1, transient=40.0)
    assert found.exponents == pytest.approx([0.3], abs=1e-12)
    assert "0.3" in str(found)


class Damped(hy.Automaton):
    """An oscillator whose elements are in units of their own: eigenvalues -0.05 +- i."""

    x = hy.state()
    v = hy.state()
    unit: float = hy.parameter(1.0)

    @hy.mode
    def f(self, t, s):
        return self.unit * s.v, -s.x / self.unit - 0.1 * s.v


@pytest.mark.parametrize("unit", [1e12, 1e-12])
def test_units_do_not_matter(unit):
    """They are as in units of 1, to rounding; no direction is lost beside large numbers."""
    span = (0.0, 100.0)
    plain = hy.lyapunov(Damped(), [1.0, 0.0], span, solver="taylor")
    found = hy.lyapunov(Damped(unit=unit), [unit, 0.0], span, solver="taylor")
    assert found.sum == pytest.approx(-0.1, rel=1e-12)
    np.testing.assert_allclose(found.exponents, plain.exponents, rtol=1e-9)


class Stiff(hy.Automaton):
    """``y`` follows ``x`` at a rate of its own; ``x`` grows at the mean rate 0.1."""

    x = hy.state()
    y = hy.state()
    rate: float = hy.parameter(1e3)

    @hy.mode
    def f(self, t, s):
        return (0.1 + 0.3 * jnp.cos(t)) * s.x, -self.rate * (s.y - s.x)


@pytest.mark.parametrize("method", ["Radau", *later("LSODA")])
def test_what_shrinks_fast_is_not_lost(method):
    """Within a long step of an implicit method it falls below rounding, and is followed in parts;
    the exact exponents are 0.1 and minus the rate."""
    span, options = (0.0, 4 * math.pi), {"transient": 2 * math.pi, "method": method}
    found = hy.lyapunov(Stiff(), [1.0, 1.0], span, **options)
    np.testing.assert_allclose(found.exponents, [0.1, -1e3], rtol=1e-8)
    stiffer, span, options = Stiff(rate=1e7), (0.0, 0.15), {"transient": 0.05, "method": method}
    with pytest.raises(hy.OrbitError, match="count=1"):
        hy.lyapunov(stiffer, [1.0, 1.0], span, **options)
    alone = hy.lyapunov(stiffer, [1.0, 1.0], span, count=1, **options)
    mean = 0.1 + 3.0 * (math.sin(0.15) - math.sin(0.05))
    assert alone.exponents == pytest.approx([mean], rel=1e-6)


class Forgetful(hy.Automaton):
    """``y`` is set to 1 whenever the clock rings."""

    x = hy.state()
    y = hy.state()

    @hy.mode
    def f(self, t, s):
        return 0.3 * s.x, -0.7 * s.y + 0.1 * s.x

    @hy.edge(f, every=1.0)
    def tick(self, t, s):
        return 0.8 * s.x, 1.0


def test_a_coordinate_that_a_reset_forgets():
    """Its direction is lost, which is no number with an error; the other loses a share."""
    found = hy.lyapunov(Forgetful(), [1.0, 1.0], (0.0, 60.5), transient=20.5)
    assert found.exponents[0] == pytest.approx(0.3 + math.log(0.8), rel=1e-9)
    assert found.exponents[1] == -math.inf
    assert "-inf over" in str(found)


def test_a_series_that_is_cut_off_has_none():
    """A sentence says so; in a lane it is NaN, beside the other columns."""
    start, options = {"x": 1.0, "v": 0.0}, {"zeno": "truncate", "max_jumps": 5}
    with pytest.raises(hy.OrbitError, match=r"impact\.hold cuts a series off.*zeno='rest'"):
        hy.lyapunov(BouncingBall(), start, (0.0, 9.0), **options)
    lane = hy.ensemble(BouncingBall(), start, (0.0, 9.0), measure=["lyapunov"], **options)
    assert np.isnan(lane.lyapunov.values[0])


def test_what_cannot_be_asked():
    """Counts, transients, and runs that end."""
    with pytest.raises(hy.OptionError, match="count=3: a whole number from 1 to 2"):
        hy.lyapunov(Linear(), [1.0, 1.0], (0.0, 1.0), count=3)
    with pytest.raises(hy.OptionError, match=r"transient=2\.0: a time shorter"):
        hy.lyapunov(Linear(), [1.0, 1.0], (0.0, 1.0), transient=2.0)
    with pytest.raises(hy.OptionError, match="first, last"):
        hy.lyapunov(Linear(), [1.0, 1.0], 5.0)
    with pytest.raises(hy.OrbitError, match="stopped at an accumulation"):
        hy.lyapunov(BeadOnTable(r=0.3, omega=3.5), [1.5, 0.0], (0.0, 12.0), zeno="stop")
