"""Every rule of docs/semantics.md, on every way in."""

import numpy as np
import pytest
from scipy.optimize import brentq

from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.relay import Relay

from .. import systems, test_conditions
from .ways import COMPILED, SOLVERS, SOLVERS_AND_COMPILED

WAYS = SOLVERS_AND_COMPILED

#: BDF and LSODA keep about this many digits at rtol 1e-9 (low order, restarted at jumps).
LOOSE = {"BDF": 2e-7, "LSODA": 2e-7, "RK23": 1e-7}


def tolerance(way, tight=1e-8):
    return LOOSE.get(way.name, tight)


@pytest.mark.each_method
def test_edges_fire_at_the_zero_of_their_guard(way):
    """Rule 1: a thermostat switches at the times its exponentials give."""
    result = way.run(systems.Thermostat(), {"T": 20.0}, (0, 3), rtol=1e-9)
    heat, cool = np.log(12 / 8), np.log(12 / 8)
    times = np.log(10 / 8) + np.cumsum([0, cool, heat, cool, heat])
    if way.tells("edges"):
        assert result.edges[:5] == ["hot", "cold", "hot", "cold", "hot"]
    np.testing.assert_allclose(result.times[:5], times, atol=10 * tolerance(way))


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-5])
@pytest.mark.each_method
def test_two_crossings_in_one_step_are_both_found(way, width):
    """Rule 1: the step spans both zeros; each edge counts its own.

    The guard's depth between them is width^2 / 4, which must exceed the tolerance.
    """
    tight = {"rtol": 1e-12, "atol": 1e-12}
    for model in (systems.FallingCounter, systems.RisingCounter):
        result = way.run(model(width=width), {"x": 0.0, "n": 0.0}, (0, 1), **tight)
        assert result.final.n == 1
        assert result.times[0] == pytest.approx(0.5, abs=1e-9)
    both = way.run(systems.Counter(width=width), [0.0, 0.0], (0, 1), **tight)
    np.testing.assert_allclose(both.times, [0.5, 0.5 + width], atol=1e-9)


@pytest.mark.parametrize("way", ["DOP853", "RK45", "RK23", "Radau", "taylor"], indirect=True)
def test_a_tangency_is_reported_and_resets_nothing(way):
    """Rule 1: a body thrown up from -1 touches 0; one-step methods are exact on parabolas.

    BDF and LSODA are not: their error over the arc hides the touch (docs/semantics.md).
    """
    run = way.run(systems.Ceiling(), {"x": -1.0, "v": 2.0}, (0, 1.8)).run
    assert len(run.jumps) == 0
    assert [graze.edge for graze in run.grazings] == ["impact"]
    assert run.grazings[0].t == pytest.approx(1.0, abs=1e-3)  # a maximum: sqrt of the error


@pytest.mark.parametrize("way", ["DOP853", "RK45", "Radau", "taylor", "Tsit5"], indirect=True)
@pytest.mark.parametrize("speed", [6.140625, 12.28125, 24.5625, 26.171875])
def test_a_tangency_where_the_state_is_zero(way, speed):
    """Rule 1: what the tolerances leave open there is told from the whole way, not the state
    alone. Of throws whose height is exact, those after which DOP853 ends a step at x = 0."""
    run = way.run(systems.Ceiling(), {"x": -(speed**2) / 4, "v": speed}, (0, speed)).run
    assert len(run.jumps) == 0
    assert run.final.v == pytest.approx(-speed, rel=1e-7)  # of the order of each method's rtol


@pytest.mark.parametrize("way", ["DOP853", "RK45", "Radau", "Tsit5", "Dopri8"], indirect=True)
def test_a_tangency_of_a_curved_arc(way):
    """Rule 1: cos t touches -1 at pi, within one step's tolerance for these methods."""
    run = way.run(systems.Oscillator(), {"x": 1.0, "v": 0.0}, (0, 5)).run
    assert len(run.jumps) == 0
    assert [graze.edge for graze in run.grazings] == ["impact"]
    assert run.grazings[0].t == pytest.approx(np.pi, abs=1e-4)  # a minimum: sqrt of the error


@pytest.mark.parametrize("way", ["ensemble", *COMPILED], indirect=True)
def test_lanes_pass_over_tangencies(way):
    """Rule 1: cos t touches -1 at pi, and nothing happens."""
    result = way.run(systems.Oscillator(), {"x": 1.0, "v": 0.0}, (0, 5))
    assert result.jumps == 0
    assert result.final.x == pytest.approx(np.cos(5), abs=1e-6)


def test_a_wall_just_out_of_reach_is_not_a_tangency(way):
    """Rule 1: a miss by 1e-3 is no event at all."""
    result = way.run(systems.Oscillator(wall=-1.001), {"x": 1.0, "v": 0.0}, (0, 5))
    assert result.jumps == 0
    if way.tells("run"):
        assert len(result.run.grazings) == 0


def test_a_short_flight_is_never_lost(way):
    """Rule 2: launched from the floor, the landing is found at 2 v / g."""
    speeds = np.logspace(-8, 1, 37)
    ends = 2 * speeds / 9.81
    starts = [{"x": 0.0, "v": speed} for speed in speeds]
    results = way.many(BouncingBall(), starts, (0, 1.2 * ends))
    lost = [speed for speed, result in zip(speeds, results, strict=True) if not result.jumps]
    assert not lost
    np.testing.assert_allclose([result.times[0] for result in results], ends, rtol=1e-7)


def test_a_guard_about_to_fall_fires_at_once(way):
    """Rule 3: a start on the wall with inward speed is an impact at t0."""
    result = way.run(systems.Oscillator(wall=0.0), {"x": 0.0, "v": -1.0}, (0, 1))
    assert result.times[0] == 0.0
    assert result.after.v[0] == 0.5


def test_a_guard_about_to_grow_is_armed(way):
    """Rule 3: a start on the wall with outward speed flies half a period."""
    result = way.run(systems.Oscillator(wall=0.0), {"x": 0.0, "v": 1.0}, (0, 4), rtol=1e-9)
    assert result.times[0] == pytest.approx(np.pi, abs=10 * tolerance(way))


def test_a_contact_closed_at_the_start_rests(way):
    """Rule 3: gap 0, gap speed 0, pushed: the run begins in the resting mode, without a jump."""
    result = way.run(BouncingBall(), {"x": 0.0, "v": 0.0}, (0, 1))
    assert (result.jumps, result.final.x) == (0, 0.0)
    if way.tells("mode"):
        assert result.mode == "flight.rest(impact)"
    if way.tells("run"):
        assert [arc.mode for arc in result.run.arcs] == ["flight.rest(impact)"]


def test_a_start_outside_the_domain_is_refused(way):
    """Rule 3."""
    result = way.run(systems.Oscillator(), {"x": -2.0, "v": 0.0}, (0, 1))
    assert result.status == "refused"
    if way.tells("run"):
        assert "guard of impact is -1" in result.said


def test_simultaneous_edges_fire_in_declared_order(way):
    """Rule 4: into the corner; both contacts fire at t = 1."""
    result = way.run(systems.Corner(), [1.0, 1.0, -1.0, -1.0], (0, 2))
    if way.tells("edges"):
        assert result.edges == ["left", "floor"]
    np.testing.assert_allclose(result.times, [1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(result.after.u, [0.5, 0.5], atol=1e-12)  # the left wall's impact
    np.testing.assert_allclose(result.after.w, [-1.0, 0.5], atol=1e-12)  # came first
    assert result.final.u == pytest.approx(0.5, abs=1e-12)  # straight lines: rounding of a step
    assert result.final.w == pytest.approx(0.5, abs=1e-12)


def test_an_endless_loop_of_jumps_is_an_error(way):
    """Rule 4: it names the cycle."""
    result = way.run(systems.Loop(), {"x": 0.0}, (0, 2))
    assert result.status == "jump_loop"
    if way.tells("run"):
        assert "over -> under" in result.said or "under -> over" in result.said


@pytest.mark.each_method
def test_jumps_land_on_the_guard(way):
    """Rule 5: over a wall at 2, x is exactly 2.0 at every impact."""
    result = way.run(HardSpring(), {"x": 2.1, "v": 0.0}, (0, 1.1))
    assert result.jumps > 5
    assert np.all(result.after.x == 2.0)
    if way.tells("before"):
        assert np.all(result.before.x == 2.0)
        np.testing.assert_allclose(result.after.v, -0.8 * result.before.v, rtol=1e-12)


@pytest.mark.parametrize("way", SOLVERS, indirect=True)
def test_gaps_below_the_spacing_of_floats_are_gaps(way):
    """Rule 7: near t = 10 the flights of a tail shrink by r each, far below 1e-15."""
    run = way.run(BouncingBall(r=0.5), {"x": 1.0, "v": 0.0}, (10.0, 13.0)).run
    lengths = np.array([arc.length for arc in run.arcs[1:-1]])
    np.testing.assert_allclose(lengths[1:] / lengths[:-1], 0.5, rtol=1e-6)
    assert lengths[-1] < 1e-14


@pytest.mark.parametrize("way", ["ensemble", *COMPILED], indirect=True)
def test_lanes_sum_a_tail_far_from_zero(way):
    """Rule 7: near t = 10 the sum of flights far below 1e-15 is right to rounding."""
    result = way.run(BouncingBall(r=0.5), {"x": 1.0, "v": 0.0}, (10.0, 13.0))
    exact = 10.0 + 3 * np.sqrt(2 / 9.81)
    assert result.t_inf == pytest.approx(exact, abs=1e-9)  # of the fall before it, at 1e-8 a step
    assert result.final.x == 0.0


def test_a_relay_slides_where_both_flows_lead_to_its_surface(way):
    """Rule 8: x stays on 0 until the force is 1; the relay crosses 0 where it is stronger."""
    result = way.run(Relay(a=1.5, w=1.0), {"x": -1.0}, (1.0, 5.0), mode="down", rtol=1e-9)
    times = hit_and_end(1.5)
    if way.tells("edges"):
        assert result.edges == ["relay", "relay", "relay.negative"]
    np.testing.assert_allclose(result.times, times, atol=10 * tolerance(way))
    middle = 0.5 * (times[1] + times[2])
    assert way.run(Relay(a=1.5, w=1.0), {"x": -1.0}, (1.0, middle), mode="down").final.x == 0.0


def hit_and_end(a):
    """Zeros of ``x = c - a cos t + t`` below, of ``c - a cos t - t`` above, and of the force's."""
    below = brentq(lambda t: -1.0 + a * (np.cos(1.0) - np.cos(t)) + (t - 1.0), 1.0, 2.0)
    above = brentq(lambda t: a * (np.cos(below) - np.cos(t)) - (t - below), below + 0.5, 4.0)
    return [below, above, np.pi + np.arcsin(1 / a)]


def test_a_zero_at_which_a_condition_fails_is_passed(way):
    """Rule 4: of the zeros of sin t up to 19 those count at which the cosine is below 0."""
    start = {"x": 0.0, "y": 1.0, "n": 0.0}
    result = way.run(test_conditions.Clock(), start, (0.0, 19.0), rtol=1e-9)
    assert (result.final.n, result.jumps) == (3, 3)
    np.testing.assert_allclose(result.times, np.pi * np.array([1, 3, 5]), atol=100 * tolerance(way))


def test_of_complementary_conditions_one_holds(way):
    """Rule 4: one of two edges on a guard fires, read from left values, whatever the reset does."""
    result = way.run(test_conditions.Fork(), {"x": 0.0, "n": 0.0}, (0.0, 4.5))
    assert (result.final.n, result.jumps) == (11.0, 4)
    result = way.run(test_conditions.Toggle(), {"x": 0.0, "n": 0.0}, (0.0, 3.0))
    assert (result.final.n, result.jumps) == (2.0, 1)


def test_an_urgent_edge_fires_beyond_its_zero(way):
    """Rule 3: from 3.5 at once to 2.5, 1.5 and 0.5, then at each zero."""
    result = way.run(test_conditions.Rush(), {"x": 3.5, "n": 0.0}, (0.0, 2.0))
    np.testing.assert_allclose(result.times, [0.0, 0.0, 0.0, 0.5, 1.5], rtol=1e-12)


def test_an_edge_to_terminate_ends_the_run(way):
    """Rule 10: at the zero of its guard, in the state that its reset gives."""
    result = way.run(test_conditions.Shot(), test_conditions.START, (0.0, 100.0), rtol=1e-9)
    assert (result.status, result.jumps) == ("terminated", 1)
    assert result.t == pytest.approx(test_conditions.HIT, abs=tolerance(way))
    assert result.final.v == pytest.approx(-0.5 * np.sqrt(13.0), abs=tolerance(way, 1e-7))
