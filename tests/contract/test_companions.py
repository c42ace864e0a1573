"""A state that is nothing but large (a pressure in Pa) changes nothing of what the others do.

What is rounding of a gap, or of its speed, is told by the states that it is made of: a gap of 1e-6
beside a state of 1e8 is a gap, and a speed of 1e-14 in a long unit of time is a speed.
"""

import numpy as np
import pytest

import hybrid as hy

WAYS = ["DOP853", "Radau", "taylor", "Dopri8", "ensemble", "as_function"]

SIZES = [0.0, 1e5, 1e8, 1e13, 1e15]

beside = pytest.mark.parametrize("size", SIZES)


class Kicked(hy.Automaton):
    """A ball over a floor; after the time ``due`` it is put to ``put`` with the speed ``kick``."""

    x = hy.state()
    v = hy.state()
    clock = hy.state()
    p = hy.state()
    due = hy.parameter(5.0)
    put = hy.parameter(0.0)
    kick = hy.parameter(0.5)
    unit = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0 / self.unit**2, 1.0 / self.unit, 0.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: self.due - s.clock)
    def strikes(self, t, s):
        return s.replace(x=self.put, v=self.kick, clock=0.0)


def fallen(size, height=1.0):
    return {"x": height, "v": 0.0, "clock": 0.0, "p": size}


@beside
@pytest.mark.parametrize("kick", [0.5, 1e-6])
def test_a_body_at_rest_is_struck_off_the_floor(way, size, kick):
    """It rests at 3; a quarter of the speed later it is half as fast, on a parabola."""
    result = way.run(Kicked(kick=kick), fallen(size), (0.0, 5.0 + 0.25 * kick))
    assert result.t_inf == pytest.approx(3.0, rel=1e-9)
    assert result.final.x == pytest.approx(0.1875 * kick**2, rel=1e-6)  # 5 is known to 1e-14
    assert result.final.v == pytest.approx(0.5 * kick, rel=1e-6)


@pytest.mark.parametrize("unit", [1e-14, 1e14])
def test_a_body_at_rest_is_struck_in_any_unit_of_time(way, unit):
    result = way.run(Kicked(kick=0.5 / unit, unit=unit), fallen(0.0), (0.0, 5.125 * unit))
    assert result.t_inf == pytest.approx(3.0 * unit, rel=1e-9)
    assert result.final.x == pytest.approx(0.046875, rel=1e-9)


@pytest.mark.parametrize("unit", [1e-30, 1e14, 1e20, 1e40])
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_the_error_of_a_limit_is_measured_in_any_unit_of_time(solver, unit):
    """The runs that measure it come to the limit, too; 3 is exact."""
    model = Kicked(unit=unit, due=1e3)
    (limit,) = hy.simulate(model, fallen(0.0), (0.0, 4.0 * unit), solver=solver).zeno
    assert abs(limit.t - 3.0 * unit) <= limit.t_error <= 1e-10 * unit


class Remembered(hy.Automaton):
    """The same ball, beside a state that sees its past."""

    x = hy.state()
    v = hy.state()
    q = hy.state()
    unit = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -2.0 / self.unit**2, -past(0.5 * self.unit).q / self.unit

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("unit", [1e-10, 1e10, 1e14])
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_impacts_accumulate_beside_a_delay_in_any_unit_of_time(solver, unit):
    start = {"x": 1.0, "v": 0.0, "q": 1.0}
    run = hy.simulate(Remembered(unit=unit), start, (0.0, 4.0 * unit), solver=solver)
    (limit,) = run.zeno
    # three times what fifty impacts, each rounded to 1e-15, are apart in two runs is 1e-13
    assert abs(limit.t - 3.0 * unit) <= limit.t_error <= 1e-11 * unit


@beside
@pytest.mark.parametrize("height", [0.05, 1e-6])
def test_a_body_let_go_above_the_floor_falls(way, size, height):
    """From 5 it has not come to the floor; let go it has fallen a quarter of the way."""
    model = Kicked(due=1.6, put=height, kick=0.0)
    result = way.run(model, fallen(size, 5.0), (0.0, 1.6 + 0.5 * height**0.5))
    assert result.final.x == pytest.approx(0.75 * height, rel=1e-6)
    assert result.final.v == pytest.approx(-(height**0.5), rel=1e-6)


@beside
def test_a_body_put_below_the_floor_is_refused(way, size):
    """By far more than the tolerances of its place."""
    model = Kicked(due=1.6, put=-1e-4, kick=0.0)
    assert way.run(model, fallen(size, 5.0), (0.0, 2.0)).status == "refused"


class Belt(hy.Automaton):
    """A body on a belt: dry friction, and a spring."""

    x = hy.state()
    v = hy.state()
    p = hy.state()

    @hy.mode(initial=True)
    def slower(self, t, s):
        return s.v, 0.6 - s.x, 0.0

    @hy.mode
    def faster(self, t, s):
        return s.v, -0.6 - s.x, 0.0

    belt = hy.switching(faster, slower, surface=lambda self, t, s: s.v - 0.1)


@beside
def test_a_body_that_sticks_to_a_belt_leaves_it(way, size):
    """Where the spring is stretched to 0.6; it then swings about 0.6 with the belt's speed."""
    result = way.run(Belt(), {"x": 0.0, "v": 0.1, "p": size}, (0.0, 6.0 + np.pi / 2))
    assert result.final.x == pytest.approx(0.7, abs=1e-6)
    if way.tells("mode"):
        assert result.mode == "slower"
