"""Cycles of jumps in lanes, and in the way that has no Python to turn to: unknown there."""

import pytest

from .test_cycles import STEEP, Tanks, Wheel, stop_of
from .ways import misses

WAYS = ["ensemble", "as_function"]

UNKNOWN = "cycles of jumps are unknown to the array code"

NUMBERS = pytest.mark.parametrize("numbers", [{}, {"a": 0.4, "slope": 0.0, "g": 1.0}, STEEP])


@misses(UNKNOWN, "as_function", raises=ValueError)
@NUMBERS
def test_a_wheel_comes_to_stand_on_two_spokes(way, numbers):
    """Its resets move the state; the limit's time is listed."""
    model = Wheel(**numbers)
    exact = stop_of(model, 0.3)
    result = way.run(model, {"q": 0.0, "w": 0.3}, (0.0, exact + 1.0), rtol=1e-9, atol=1e-11)
    (point,) = result.zeno
    assert abs(point.t - exact) < 1e-5


@pytest.mark.parametrize("way", ["as_function"], indirect=True)
@NUMBERS
def test_no_wheel_falls_through_the_floor(way, numbers):
    """The function stops at jumps with no time between them, says that, in the mode's domain."""
    model = Wheel(**numbers)
    result = way.run(model, {"q": 0.0, "w": 0.3}, (0.0, 10.0), rtol=1e-9, atol=1e-11)
    assert result.status == "jump_loop"
    assert result.t == pytest.approx(stop_of(model, 0.3), abs=1e-6)
    assert abs(result.final.q - float(model.slope)) <= float(model.a) + 1e-8


@misses(UNKNOWN, "as_function", raises=ValueError)
@pytest.mark.parametrize("w", [1.01, 1.25, 1.8])
def test_two_tanks_run_down(way, w):
    """As the documented limit says."""
    (point,) = way.run(Tanks(w=w), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0)).zeno
    assert abs(point.t - 4.0 / (2.0 - w)) < 1e-9


@pytest.mark.parametrize("way", ["as_function"], indirect=True)
@pytest.mark.parametrize("w", [1.01, 1.25, 1.8])
def test_tanks_that_run_down_are_no_silent_end(way, w):
    """The function stops at jumps with no time between them, and says that."""
    result = way.run(Tanks(w=w), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0))
    assert result.status == "jump_loop"
    assert result.t == pytest.approx(4.0 / (2.0 - w), abs=1e-6)
