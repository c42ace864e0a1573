"""Every rule of docs/semantics.md, on every solver."""

import numpy as np
import pytest
from scipy.optimize import brentq

import hybrid as hy

from .. import systems
from ..conftest import SOLVERS

#: BDF and LSODA keep about this many digits at rtol 1e-9 (low order, restarted at jumps).
LOOSE = {"BDF": 2e-7, "LSODA": 2e-7, "RK23": 1e-7}


def tolerance(solver, tight=1e-8):
    return LOOSE.get(solver.get("method"), tight)


def test_edges_fire_at_the_zero_of_their_guard(solver):
    """Rule 1: a thermostat switches at the times its exponentials give."""
    run = hy.simulate(systems.Thermostat(), {"T": 20.0}, (0, 3), rtol=1e-9, **solver)
    heat, cool = np.log(12 / 8), np.log(12 / 8)
    times = np.log(10 / 8) + np.cumsum([0, cool, heat, cool, heat])
    assert run.jumps.edge[:5].tolist() == ["hot", "cold", "hot", "cold", "hot"]
    np.testing.assert_allclose(run.jumps.t[:5], times, atol=10 * tolerance(solver))


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-5])
def test_two_crossings_in_one_step_are_both_found(solver, width):
    """Rule 1: the step spans both zeros; each edge counts its own.

    The guard's depth between them is width^2 / 4, which must exceed the tolerance.
    """
    tight = {"rtol": 1e-12, "atol": 1e-12, **solver}
    for model in (systems.FallingCounter, systems.RisingCounter):
        run = hy.simulate(model(width=width), {"x": 0.0, "n": 0.0}, (0, 1), **tight)
        assert run.final.n == 1
        assert run.jumps.t[0] == pytest.approx(0.5, abs=1e-9)
    both = hy.simulate(systems.Counter(width=width), [0.0, 0.0], (0, 1), **tight)
    np.testing.assert_allclose(both.jumps.t, [0.5, 0.5 + width], atol=1e-9)


@pytest.mark.parametrize("name", ["DOP853", "RK45", "RK23", "Radau", "taylor"])
def test_a_tangency_is_reported_and_resets_nothing(name):
    """Rule 1: a body thrown up from -1 touches 0; one-step methods are exact on parabolas.

    BDF and LSODA are not: their error over the arc hides the touch (docs/semantics.md).
    """
    run = hy.simulate(systems.Ceiling(), {"x": -1.0, "v": 2.0}, (0, 1.8), **SOLVERS[name])
    assert len(run.jumps) == 0
    assert [graze.edge for graze in run.grazings] == ["impact"]
    assert run.grazings[0].t == pytest.approx(1.0, abs=1e-3)  # a maximum: sqrt of the error


@pytest.mark.parametrize("name", ["DOP853", "RK45", "Radau", "Tsit5", "Dopri8"])
def test_a_tangency_of_a_curved_arc(name):
    """Rule 1: cos t touches -1 at pi, within one step's tolerance for these methods."""
    run = hy.simulate(systems.Oscillator(), {"x": 1.0, "v": 0.0}, (0, 5), **SOLVERS[name])
    assert len(run.jumps) == 0
    assert [graze.edge for graze in run.grazings] == ["impact"]
    assert run.grazings[0].t == pytest.approx(np.pi, abs=1e-4)  # a minimum: sqrt of the error


def test_a_wall_just_out_of_reach_is_not_a_tangency(solver):
    """Rule 1: a miss by 1e-3 is no event at all."""
    run = hy.simulate(systems.Oscillator(wall=-1.001), {"x": 1.0, "v": 0.0}, (0, 5), **solver)
    assert (len(run.jumps), len(run.grazings)) == (0, 0)


@pytest.mark.parametrize("speed", np.logspace(-8, 1, 37))
def test_a_short_flight_is_never_lost(solver, speed):
    """Rule 2: launched from the floor, the landing is found at 2 v / g."""
    from models.bouncing_ball import BouncingBall

    end = 2 * speed / 9.81
    run = hy.simulate(BouncingBall(), {"x": 0.0, "v": speed}, (0, 1.2 * end), **solver)
    assert run.jumps.t[0] == pytest.approx(end, rel=1e-7)


def test_a_guard_about_to_fall_fires_at_once(solver):
    """Rule 3: a start on the wall with inward speed is an impact at t0."""
    run = hy.simulate(systems.Oscillator(wall=0.0), {"x": 0.0, "v": -1.0}, (0, 1), **solver)
    assert run.jumps[0].t == 0.0
    assert run.jumps[0].after.v == 0.5


def test_a_guard_about_to_grow_is_armed(solver):
    """Rule 3: a start on the wall with outward speed flies half a period."""
    run = hy.simulate(
        systems.Oscillator(wall=0.0), {"x": 0.0, "v": 1.0}, (0, 4), rtol=1e-9, **solver
    )
    assert run.jumps.t[0] == pytest.approx(np.pi, abs=10 * tolerance(solver))


def test_a_contact_closed_at_the_start_rests(solver):
    """Rule 3: gap 0, gap speed 0, pushed: the run begins in the resting mode, without a jump."""
    from models.bouncing_ball import BouncingBall

    run = hy.simulate(BouncingBall(), {"x": 0.0, "v": 0.0}, (0, 1), **solver)
    assert [arc.mode for arc in run.arcs] == ["flight.rest(impact)"]
    assert run.final.x == 0.0


def test_a_start_outside_the_domain_is_refused(solver):
    """Rule 3."""
    with pytest.raises(hy.StartError, match="guard of impact is -1"):
        hy.simulate(systems.Oscillator(), {"x": -2.0, "v": 0.0}, (0, 1), **solver)


def test_simultaneous_edges_fire_in_declared_order(solver):
    """Rule 4: into the corner; both contacts fire at t = 1."""
    run = hy.simulate(systems.Corner(), [1.0, 1.0, -1.0, -1.0], (0, 2), **solver)
    assert run.jumps.edge.tolist() == ["left", "floor"]
    np.testing.assert_allclose(run.jumps.t, 1.0, atol=1e-9)
    assert run.final.u == pytest.approx(0.5, abs=1e-12)  # straight lines: rounding of a step
    assert run.final.w == pytest.approx(0.5, abs=1e-12)


def test_an_endless_loop_of_jumps_is_an_error(solver):
    """Rule 4: it names the cycle."""
    with pytest.raises(hy.JumpLoopError, match=r"over -> under|under -> over"):
        hy.simulate(systems.Loop(), {"x": 0.0}, (0, 2), **solver)


def test_jumps_land_on_the_guard(solver):
    """Rule 5: over a wall at 2, x is exactly 2.0 at every impact."""
    from models.hard_spring import HardSpring

    run = hy.simulate(HardSpring(), {"x": 2.1, "v": 0.0}, (0, 1.1), **solver)
    assert len(run.jumps) > 5
    assert np.all(run.jumps.before.x == 2.0)
    np.testing.assert_allclose(run.jumps.after.v, -0.8 * run.jumps.before.v, rtol=1e-12)


def test_gaps_below_the_spacing_of_floats_are_gaps(solver):
    """Rule 7: near t = 10 the flights of a tail shrink by r each, far below 1e-15."""
    from models.bouncing_ball import BouncingBall

    run = hy.simulate(BouncingBall(r=0.5), {"x": 1.0, "v": 0.0}, (10.0, 13.0), **solver)
    lengths = np.array([arc.length for arc in run.arcs[1:-1]])
    np.testing.assert_allclose(lengths[1:] / lengths[:-1], 0.5, rtol=1e-6)
    assert lengths[-1] < 1e-14


def test_a_relay_slides_where_both_flows_lead_to_its_surface(solver):
    """Rule 8: x stays on 0 until the force is 1; the relay crosses 0 where it is stronger."""
    from models.relay import Relay

    run = hy.simulate(
        Relay(a=1.5, w=1.0), {"x": -1.0}, (1.0, 5.0), mode="down", rtol=1e-9, **solver
    )
    times = hit_and_end(1.5)
    assert run.jumps.edge.tolist() == ["relay", "relay", "relay.negative"]
    np.testing.assert_allclose(run.jumps.t, times, atol=10 * tolerance(solver))
    mid = 0.5 * (run.jumps.t[1] + run.jumps.t[2])
    assert run(mid).x == 0.0


def hit_and_end(a):
    """Zeros of ``x = c - a cos t + t`` below, of ``c - a cos t - t`` above, and of the force's."""
    below = brentq(lambda t: -1.0 + a * (np.cos(1.0) - np.cos(t)) + (t - 1.0), 1.0, 2.0)
    above = brentq(lambda t: a * (np.cos(below) - np.cos(t)) - (t - below), below + 0.5, 4.0)
    return [below, above, np.pi + np.arcsin(1 / a)]
