"""Accumulation, rest, release: the same on every solver."""

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall

from .. import systems

#: What a method reaches at rtol 1e-9 on a table: its order, restarted at each impact.
TIMES = {"DOP853": 1e-9, "RK45": 1e-9, "taylor": 1e-12}


def test_impacts_accumulate_and_the_ball_rests(solver):
    """t_inf is closed form; afterwards x is exactly 0."""
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), rtol=1e-9, **solver)
    assert run.zeno[0].t == pytest.approx(2.55863396558580846, rel=1e-6)
    assert abs(run.zeno[0].t - 2.55863396558580846) <= run.zeno[0].t_error
    assert run(3.0).x == 0.0
    assert run.mode == "flight.rest(impact)"


def test_table_throws_the_bead_off_where_its_acceleration_is_minus_g(solver):
    """Release where -omega^2 sin(omega t) = -g, whatever the solver."""
    model = BeadOnTable(r=0.3, omega=4.0)
    run = hy.simulate(model, {"x": 1.5, "v": 0.0}, (0, 5), rtol=1e-9, **solver)
    phase = np.arcsin(9.8 / 16.0)
    for point, k in zip(run.zeno[:2], (1, 2), strict=True):
        assert point.t_release == pytest.approx((2 * np.pi * k + phase) / 4.0, abs=1e-8)


@pytest.mark.parametrize(("case", "r", "omega"), [("A", 0.3, 4.0), ("B", 0.6, 3.5)])
def test_tables_a_and_b(accurate, reference, case, r, omega):
    """Every stick and lift time to 1e-9; the error inside its bound."""
    events = reference[f"table_released_{case}"]["events"]
    model = BeadOnTable(r=r, omega=omega)
    run = hy.simulate(model, {"x": 1.5, "v": 0.0}, (0, 6.8), **accurate)
    sticks = [float(e["t"]) for e in events if e["kind"] == "stick"]
    lifts = [float(e["t"]) for e in events if e["kind"] == "lift"]
    assert len(run.zeno) >= len(sticks)
    for point, stick in zip(run.zeno, sticks, strict=False):
        assert abs(point.t - stick) <= min(1e-9, point.t_error)
    for point, lift in zip(run.zeno, lifts, strict=False):
        assert point.t_release == pytest.approx(lift, abs=1e-9)


def test_quadratic_drag_with_its_kink(solver):
    """The flow's kink at each top of a flight is followed: against 16 digits (Taylor, 1e-13)."""
    run = hy.simulate(systems.Drag(), {"x": 1.0, "v": 0.0}, (0, 5), rtol=1e-9, **solver)
    assert run.zeno[0].t == pytest.approx(3.03185051506359, abs=1e-6)
    assert abs(run.zeno[0].t - 3.03185051506359) <= run.zeno[0].t_error


def test_a_force_that_is_flat_to_rounding_before_it_turns(accurate):
    """Small terms of a series prove nothing: against quadratures of each flight, 30 digits."""
    run = hy.simulate(systems.Rubbed(), {"x": 1.0, "v": 0.0}, (0, 3), **accurate)
    assert run.jumps.t[0] == pytest.approx(0.54228966404263324591, abs=1e-11)
    assert run.zeno[0].t == pytest.approx(1.8538083920074954531, abs=1e-11)
    assert abs(run.zeno[0].t - 1.8538083920074954531) <= run.zeno[0].t_error <= 1e-10


def test_resting_on_one_contact_and_striking_another(solver):
    """A ball at rest on the floor slides into the wall, and stays on the floor."""
    run = hy.simulate(systems.Room(), [0.0, 1.0, 1.0, 0.0], (0, 5), rtol=1e-9, **solver)
    strike = [jump for jump in run.jumps if jump.edge == "wall"]
    assert [jump.t for jump in strike] == pytest.approx([3.0], abs=1e-7)
    assert run.mode == "flight.rest(floor)"
    assert run.final.x == pytest.approx(2.0, abs=1e-6)
    assert run.final.y == 0.0


def test_two_bodies_rest_at_the_end_of_their_own_series(solver):
    """Two balls on two floors: both accumulate; then both contacts are held at once."""
    run = hy.simulate(systems.Pair(), [1.0, 0.9, 0.0, 0.0], (0, 3), rtol=1e-9, **solver)
    truth = [np.sqrt(2 * h / 10.0) * 3.0 for h in (0.9, 1.0)]
    assert [point.t for point in run.zeno] == pytest.approx(truth, abs=1e-5)
    assert run.mode == "flight.rest(first, second)"
    assert (run.final.x, run.final.y) == (0.0, 0.0)


def test_a_force_that_changes_inside_the_tail(accurate):
    """Gravity falls from 10 to 2 at t = 6, inside a tail that would have ended at 8.497."""
    run = hy.simulate(systems.Switching(), {"x": 1.0, "v": 0.0}, (0, 30), **accurate)
    assert run.zeno[0].t == pytest.approx(16.338222626746, abs=1e-6)
    assert abs(run.zeno[0].t - 16.338222626746) <= run.zeno[0].t_error + 1e-11


def test_a_ceiling_that_dips_into_the_tail(solver):
    """Another contact's gap is watched along the whole tail."""
    run = hy.simulate(systems.DippingCeiling(), {"x": 1.0, "v": 0.0}, (0, 12), **solver)
    assert "ceiling" in run.jumps.edge
    times = np.linspace(0, 12, 2000)
    gap = 2 - 1.99 * np.exp(-(((times - 3.0) / 0.2) ** 2)) - run(times).x
    assert gap.min() > -1e-6


@pytest.mark.parametrize("omega", [5.0, 150.0, 1e3, 1e4])
def test_release_at_any_frequency(omega):
    """A table of acceleration 1.5 g: rest ends where it falls faster than g, at each period."""
    model = BeadOnTable(r=0.3, omega=omega, amplitude=1.5 * 9.8 / omega**2)
    end = 20.0 / omega
    run = hy.simulate(model, {"x": 0.0, "v": model.amplitude * omega}, (0, end))
    releases = [jump.t * omega for jump in run.jumps if jump.edge == "impact.release"]
    phase = np.arcsin(1 / 1.5)
    np.testing.assert_allclose(releases, phase + 2 * np.pi * np.arange(len(releases)), rtol=1e-9)
    assert len(releases) >= 3


def test_a_body_set_at_rest_on_a_moving_table_does_not_sink():
    """Its gap speed is rounding: -1e-16. It rests until the table falls away."""
    model = BeadOnTable(r=0.5, omega=5.0, amplitude=1.0)
    start = {"x": -np.sin(np.pi / 2), "v": 5.0 * np.cos(-np.pi / 2)}
    run = hy.simulate(model, start, (-np.pi / 10, 0.5))
    times = np.linspace(-np.pi / 10, 0.5, 300)
    assert np.min(run(times).x - np.sin(5.0 * times)) >= -1e-12
