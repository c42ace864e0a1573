"""The options of ``hy.simulate``, and what a run keeps of them."""

import math

import numpy as np
import pytest

import hybrid as hy
from hybrid.solvers import Solver
from models.bouncing_ball import BouncingBall

from .contract.test_cycles import Line, collapses

START, SPAN = {"x": 1.0, "v": 0.0}, (0.0, 3.0)


@pytest.mark.parametrize(
    ("options", "meant"),
    [
        ({}, (1e-8, 1e-10)),
        ({"method": "RK45"}, (1e-8, 1e-10)),
        ({"solver": "taylor"}, (1e-14, 1e-16)),
        ({"solver": "classic"}, (1e-8, 1e-10)),
        ({"solver": "taylor", "rtol": 1e-6}, (1e-6, 1e-16)),
        ({"rtol": 1e-6}, (1e-6, 1e-10)),
        ({"atol": 1e-3}, (1e-8, 1e-3)),
    ],
)
def test_a_solver_has_its_own_tolerances_where_none_are_given(options, meant):
    """``run.options`` has the numbers, never None."""
    run = hy.simulate(BouncingBall(), START, SPAN, **options)
    assert (run.options["rtol"], run.options["atol"]) == meant


def test_a_plugged_in_solver_declares_its_own(monkeypatch):
    """By an attribute of its class."""
    from .plugged import Classic

    monkeypatch.setattr(Classic, "own_rtol", 1e-5)
    run = hy.simulate(BouncingBall(), START, SPAN, solver="classic")
    assert (run.options["rtol"], run.options["atol"]) == (1e-5, 1e-5 / 100)
    assert Solver.own_rtol == 1e-8


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("value", [0, 0.0, -1e-8, 1.0, math.inf, math.nan, "1e-8"])
def test_a_relative_tolerance_that_is_none_is_refused(solver, value):
    """The value is named."""
    with pytest.raises(hy.OptionError, match=r"rtol=.*a number between 0 and 1"):
        hy.simulate(BouncingBall(), START, SPAN, solver=solver, rtol=value)


@pytest.mark.parametrize("rtol", [1e-9, 1e-11, 1e-13])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_collapse_whose_gaps_drown_is_seen_at_any_tolerance(solver, rtol):
    """Rounding hides it before it is known to the tolerance; the bound says how well it is."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    start = {"x": np.array(x), "v": np.array(v)}
    run = hy.simulate(Line(r=0.05), start, (0.0, 3.0), solver=solver, rtol=rtol, atol=rtol)
    (point,) = run.zeno
    assert abs(point.t - collapses(0.05, x, v)[0]) <= point.t_error < 1e-9


def test_tolerances_that_are_none_are_the_defaults_of_maps_and_orbits():
    """A caller who hands on what it was given."""
    given = {"t_max": 5.0, "rtol": None, "atol": None}
    state = {"x": 0.0, "v": 3.0}
    default = hy.return_map(BouncingBall(), "impact", t_max=5.0)(state)
    assert hy.return_map(BouncingBall(), "impact", **given)(state).v == default.v
