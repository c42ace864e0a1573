"""A solver of another package is found by its entry point, and held to the same rules."""

from importlib.metadata import EntryPoint

import pytest

import hybrid as hy
from hybrid import solvers
from models.bouncing_ball import BouncingBall


@pytest.fixture
def plugged(monkeypatch):
    """Entry points as an installed package would declare them."""
    points = [
        EntryPoint("classic", "tests.plugged:Classic", solvers.GROUP),
        EntryPoint("wrong", "builtins:print", solvers.GROUP),
    ]
    monkeypatch.setattr(solvers, "entry_points", lambda group: points)


def test_a_plugged_solver_runs_by_its_flag(plugged):
    """Accumulation, rest and the second run for the error included."""
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), solver="classic", rtol=1e-9)
    assert abs(run.zeno[0].t - 2.55863396558580846) <= min(1e-9, run.zeno[0].t_error)


def test_an_unknown_solver_is_told_of_those_plugged_in(plugged):
    with pytest.raises(hy.OptionError, match="scipy, diffrax, taylor, classic, wrong"):
        hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), solver="euler")


def test_an_entry_point_that_makes_no_solver_is_named(plugged):
    with pytest.raises(hy.OptionError, match=r"builtins:print made None"):
        hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), solver="wrong")
