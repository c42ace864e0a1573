"""``run.settles()``: rest, orbits, and neither."""

import math

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.dry_friction import DryFriction
from models.relay import Relay
from tests.oscillators import Lorenz, VanDerPol, bouncing, flight
from tests.systems import ForcedOscillator, Oscillator


class Damped(Oscillator):
    """A damped oscillator, far from its wall."""

    @hy.mode
    def flight(self, t, s):
        return s.v, -s.x - 0.4 * s.v


def test_a_ball_comes_to_rest():
    """Since ``t_inf``, held by a load of ``g``."""
    run = hy.simulate(BouncingBall(), [1.0, 0.0], (0.0, 10.0))
    found = run.settles()
    assert found.kind == "rest"
    assert found.distance == 0.0
    assert found.for_ever
    assert f"rests for ever in flight.rest(impact): since t = {run.zeno[0].t:.9g}" in found.reason
    assert "it is 9.81 and was never below 9.81" in found.reason


def test_a_body_sticks():
    """By dry friction: it slides on the surface of no speed."""
    found = hy.simulate(DryFriction(), [5.3, 0.0], (0.0, 30.0)).settles()
    assert found.kind == "rest"
    assert "slide(friction)" in found.reason


def test_rest_must_have_lasted():
    """A quarter of the run at least, where time matters: here it has only begun."""
    model = BeadOnTable(r=0.6, omega=3.5)
    begins = hy.simulate(model, [1.5, 0.0], (0.0, 9.0)).zeno[0].t
    found = hy.simulate(model, [1.5, 0.0], (0.0, begins + 0.05)).settles()
    assert found.kind == "none"
    assert not found.for_ever


def test_a_focus():
    """Moves in equal times shrink by ``exp(-0.2 time)``."""
    found = hy.simulate(Damped(wall=-9.0), [0.5, 0.0], (0.0, 100.0)).settles()
    assert found.kind == "rest"
    assert found.rate == pytest.approx(math.exp(-0.2 * 50 / 6), rel=0.05)
    late = hy.simulate(Damped(wall=-9.0), [0.5, 0.0], (0.0, 900.0)).settles()
    assert (late.kind, late.distance) == ("rest", 0.0)
    assert hy.simulate(Damped(wall=-9.0), [0.5, 0.0], (0.0, 20.0)).settles().kind == "none"


def test_an_impact_orbit_while_it_is_approached():
    """Shrinking by ``|m| = 0.8`` a turn: found before it is reached; sooner, there is nothing."""
    model, period, speed, since, _ = bouncing(0.8, 0.2, 5.0)
    start, t0 = flight(model, 1.003 * speed, since, 0.1), since + 0.1
    found = hy.simulate(model, start, (t0, t0 + 30 * period)).settles()
    assert (found.kind, found.jumps) == ("periodic", 1)
    assert found.period == pytest.approx(period, rel=1e-4)
    assert found.rate == pytest.approx(0.8, abs=0.05)  # it turns round as it shrinks
    assert "shrinks by" in found.reason
    few = hy.simulate(model, start, (t0, t0 + 5 * period)).settles()
    assert few.kind == "none"
    assert "fewer than" in few.reason
    late = hy.simulate(model, start, (t0, t0 + 150 * period)).settles()
    assert late.period == pytest.approx(period, rel=1e-9)


def test_orbits_of_every_kind():
    """A smooth cycle, sliding on and off, and complete chattering in each period."""
    smooth = hy.simulate(VanDerPol(), [0.5, 0.0], (0.0, 60.0)).settles()
    assert (smooth.kind, smooth.jumps) == ("periodic", 0)
    assert smooth.period == pytest.approx(6.66328685932, rel=1e-8)
    relay = hy.simulate(Relay(), [0.5], (0.0, 30.0)).settles()
    assert (relay.kind, relay.jumps) == ("periodic", 4)
    table = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0.0, 30.0)).settles()
    assert (table.kind, table.jumps) == ("periodic", math.inf)
    assert table.period == pytest.approx(2 * math.pi / 3.5, rel=1e-9)
    assert "the limit of impact" in table.reason


def test_an_orbit_of_two_impacts():
    """After a period doubling an orbit takes two turns of the table, with an impact in each."""
    model, period, speed, since, trace = bouncing(0.8, 0.43, 5.0)
    assert trace < -(1 + 0.8**2)  # a multiplier below -1
    start, t0 = flight(model, 1.01 * speed, since, 0.1), since + 0.1
    found = hy.simulate(model, start, (t0, t0 + 250 * period)).settles()
    assert (found.kind, found.jumps) == ("periodic", 2)
    assert found.period == pytest.approx(2 * period, rel=1e-6)


@pytest.mark.parametrize(
    ("model", "start", "until"),
    [(Lorenz(), [1.0, 1.0, 20.0], 60.0), (ForcedOscillator(), [-0.5, 0.0], 200.0)],
    ids=["flow", "impacts"],
)
def test_chaos_settles_to_nothing(model, start, until):
    """Whatever the end: no stretch of a chaotic run is taken for an orbit."""
    run = hy.simulate(model, start, (0.0, until))
    found = run.settles()
    assert found.kind == "none"
    assert found.distance > 1e-3
    assert "does not shrink" in found.reason
    kinds = {
        hy.simulate(model, start, (0.0, end)).settles().kind
        for end in np.linspace(0.4 * until, until, 12)
    }
    assert kinds == {"none"}
