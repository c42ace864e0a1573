"""Cycles of jumps in lanes and functions: each is a run, with the same limits."""

import pytest

from .test_cycles import STEEP, Clocked, Tanks, Wheel, stop_of

WAYS = ["ensemble", "as_function"]

NUMBERS = pytest.mark.parametrize("numbers", [{}, {"a": 0.4, "slope": 0.0, "g": 1.0}, STEEP])


@NUMBERS
def test_a_wheel_comes_to_stand_on_two_spokes(way, numbers):
    """Its resets move the state; the limit's time is listed."""
    model = Wheel(**numbers)
    exact = stop_of(model, 0.3)
    result = way.run(model, {"q": 0.0, "w": 0.3}, (0.0, exact + 1.0), rtol=1e-9, atol=1e-11)
    (point,) = result.zeno
    assert abs(point.t - exact) < 1e-5


@pytest.mark.parametrize("w", [1.01, 1.25, 1.8])
def test_two_tanks_run_down(way, w):
    """As the documented limit says."""
    (point,) = way.run(Tanks(w=w), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0)).zeno
    assert abs(point.t - 4.0 / (2.0 - w)) < 1e-9


@pytest.mark.parametrize("way", ["ensemble"], indirect=True)
@pytest.mark.parametrize("period", [1.5, 21.0])
def test_a_clock_that_rings_behind_the_limit_does_not_hide_it(way, period):
    (point,) = way.run(Clocked(period=period), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0)).zeno
    assert abs(point.t - 20.0) < 1e-9
