"""Lengths and times in any unit: the same motion, from 1e-15 to 1e12, on every way in."""

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall

from .test_sliding import Sides

WAYS = ["DOP853", "Radau", "taylor", "Dopri8", "ensemble", "as_function"]

LENGTHS = [1e-15, 1e12]
TIMES = [1e-12, 1e-3, 1.0, 1e12]

in_units_of_length = pytest.mark.parametrize("unit", LENGTHS)


def tight(unit):
    """Tolerances of a step in a unit of length; those of times are shares of them."""
    return {"rtol": 1e-9, "atol": 1e-11 * unit}


class Ball(hy.Automaton):
    """A ball with drag over a floor at ``h``, in air that thins out above it."""

    x = hy.state()
    v = hy.state()
    h = hy.parameter(0.5)
    g = hy.parameter(2.0)
    k = hy.parameter(0.3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g - self.k * s.v / (1.0 + (s.x / self.h) ** 2)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x - self.h, restitution=0.6)


@in_units_of_length
def test_impacts_accumulate_at_the_same_time(way, unit):
    """Against rounding in the unit 1."""
    exact = hy.simulate(Ball(), [1.5, 0.0], (0.0, 8.0), solver="taylor").zeno[0].t
    units = np.array(TIMES)
    asked = {"h": np.full(4, 0.5 * unit), "g": 2.0 * unit / units**2, "k": 0.3 / units}
    results = way.many(Ball(), [[1.5 * unit, 0.0]] * 4, (0.0, 8.0 * units), asked, **tight(unit))
    for time, result in zip(TIMES, results, strict=True):
        assert result.status == "reached_end"
        assert result.t_inf / time == pytest.approx(exact, rel=1e-6)
        assert result.final.x == 0.5 * unit
        assert result.final.v == 0.0


@pytest.mark.parametrize("height", [1e-9, 1e-13, 1e-14, 1e-15, 1e-18])
@pytest.mark.parametrize("g", [9.81, 1e-9])
def test_a_fall_from_next_to_nothing_is_a_fall(way, height, g):
    """With tolerances that are far larger; times are those of parabolas."""
    fall = np.sqrt(2 * height / g)
    exact = fall * (1 + 0.7) / (1 - 0.7)
    result = way.run(BouncingBall(g=g), {"x": height, "v": 0.0}, (0.0, 1.5 * exact))
    assert result.times[0] == pytest.approx(fall, rel=1e-9)
    assert result.t_inf == pytest.approx(exact, rel=1e-9)
    assert result.final.x == 0.0


@in_units_of_length
def test_a_table_throws_off_what_rests_on_it(way, unit):
    """Where it falls faster than the body would, in every unit."""
    units = np.array(TIMES)
    asked = {
        "g": 9.8 * unit / units**2,
        "omega": 4.0 / units,
        "amplitude": np.full(4, unit),
        "r": np.full(4, 0.3),
    }
    starts = [{"x": 1.5 * unit, "v": 0.0}] * 4
    results = way.many(BeadOnTable(), starts, (0.0, 2.5 * units), asked, **tight(unit))
    due = (2 * np.pi + np.arcsin(9.8 / 16.0)) / 4.0
    for time, result in zip(TIMES, results, strict=True):
        assert result.status == "reached_end"
        assert np.abs(result.times / time - due).min() <= 1e-7


class Swing(hy.Automaton):
    """``x = cos(w t)``, counted where it falls through ``level`` and where it rises."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    w = hy.parameter(1.0)
    level = hy.parameter(0.3)

    @hy.mode
    def swings(self, t, s):
        return s.v, -self.w * self.w * s.x, 0.0

    @hy.edge(swings, to=swings, guard=lambda self, t, s: s.x - self.level)
    def falls(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(swings, to=swings, guard=lambda self, t, s: s.x - self.level, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(n=s.n + 10.0)


@in_units_of_length
def test_events_fire_once_at_each_crossing(way, unit):
    """Two periods: twice down, twice up."""
    units = np.array(TIMES)
    asked = {"w": 1.0 / units, "level": np.full(4, 0.3 * unit)}
    results = way.many(
        Swing(), [[unit, 0.0, 0.0]] * 4, (0.0, 4 * np.pi * units), asked, **tight(unit)
    )
    for time, result in zip(TIMES, results, strict=True):
        assert result.status == "reached_end"
        assert result.final.n == 22.0
        assert result.times[0] / time == pytest.approx(np.arccos(0.3), rel=1e-7)


@pytest.mark.parametrize("time", [1e-18, 1e-12, 1e-10, 1e10, 1e12, 1e14, 1e18])
def test_steps_to_rounding_know_any_unit_of_time(time):
    """The highest coefficients are no numbers there, or next to nothing, which is no last term."""
    swing, start = Swing(w=1.0 / time, level=0.3), {"x": 1.0, "v": 0.0, "n": 0.0}
    run = hy.simulate(swing, start, (0.0, 100.0 * time), solver="taylor")
    turns = 2 * np.pi * np.arange(17)[:, None] + [-np.arccos(0.3), np.arccos(0.3)]
    due = turns[(turns > 0.0) & (turns < 100.0)]
    assert len(run.jumps) == len(due)
    # a step with no last terms is held against the flow alone, to 256 roundings
    assert run.jumps.t / time == pytest.approx(due, rel=1e-12)


@in_units_of_length
def test_sliding_begins_and_ends_at_the_same_times(way, unit):
    """From 1/4 it slides until the flow above turns upwards, at 2."""
    units = np.array(TIMES)
    rates = unit / units
    asked = {"p": -rates, "n": rates, "pt": 0.5 * rates / units, "at": 9.0 * units}
    starts = [{"y": 0.25 * unit, "x": 0.0}] * 4
    results = way.many(Sides(), starts, (0.0, 4.0 * units), asked, **tight(unit))
    for time, result in zip(TIMES, results, strict=True):
        assert result.status == "reached_end"
        assert result.times[1] / time == pytest.approx(2.0, abs=1e-6)
        assert result.final.y / unit == pytest.approx(1.0, abs=1e-6)


class Scaled(hy.Automaton):
    """A crossing of ``1 - x**2 / 2`` on a line, the guard in any unit."""

    x = hy.state()
    unit = hy.parameter(1.0)

    @hy.mode(initial=True)
    def before(self, t, s):
        return 1.0

    @hy.mode
    def behind(self, t, s):
        return 0.0

    cross = hy.edge(before, to=behind, guard=lambda self, t, s: self.unit * (1.0 - 0.5 * s.x**2))


@pytest.mark.parametrize("unit", [1e-250, 1e-200, 1e-160, 1e160, 1e250])
def test_a_guard_may_have_any_unit(way, unit):
    """Squares of its derivatives are no numbers there: a crossing is not taken for a touch."""
    result = way.run(Scaled(unit=unit), {"x": 0.0}, (0.0, 3.0))
    assert result.jumps == 1
    assert result.final.x == pytest.approx(np.sqrt(2.0), rel=1e-7)  # the ways' own tolerances
