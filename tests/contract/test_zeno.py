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


def test_resting_on_one_contact_and_striking_another(solver):
    """A ball at rest on the floor slides into the wall, and stays on the floor."""
    run = hy.simulate(systems.Room(), [0.0, 1.0, 1.0, 0.0], (0, 5), rtol=1e-9, **solver)
    strike = [jump for jump in run.jumps if jump.edge == "wall"]
    assert [jump.t for jump in strike] == pytest.approx([3.0], abs=1e-7)
    assert run.mode == "flight.rest(floor)"
    assert run.final.x == pytest.approx(2.0, abs=1e-6)
    assert run.final.y == 0.0
