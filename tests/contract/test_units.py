"""Results do not depend on the unit of length: every threshold is relative to what a run has seen.

Each scene is run in units from 1e-15 to 1e12, with an absolute tolerance in the same units.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import later

WAYS = ["DOP853", "Radau", "taylor", "ensemble"]

UNITS = [1e-15, 1e-12, 1e-6, 1.0, 1e6, 1e9, 1e12]


class Kicked(hy.Automaton):
    """A ball at rest on a floor is kicked up at t = 4; g = 2, r = 1/2."""

    x = hy.state()
    v = hy.state()
    unit: float = hy.parameter(1.0)
    kick: float = hy.parameter(1e-3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0 * self.unit

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: 4.0 - t)
    def up(self, t, s):
        return s.replace(v=s.v + self.kick * self.unit)


class Sunk(Kicked):
    """It is put below the floor on its way down, by a thousandth of the height it fell from."""

    @hy.edge("flight", to="flight", guard=lambda self, t, s: 0.5 - t)
    def up(self, t, s):
        return s.replace(x=-1e-3 * self.unit)


class Pile(hy.Automaton):
    """A ball on another on a table that shakes."""

    low = hy.state()
    high = hy.state()
    v = hy.state()
    w = hy.state()
    unit: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, s.w, -9.8 * self.unit, -9.8 * self.unit

    table = hy.contact(
        flight, gap=lambda self, t, s: s.low - self.unit * jnp.sin(4.0 * t), restitution=0.5
    )
    between = hy.contact(flight, gap=lambda self, t, s: s.high - s.low, restitution=0.5)


def run(way, cls, start, until, unit, **numbers):
    start = dict(zip([s.name for s in cls.spec.states], unit * np.array(start), strict=True))
    return way.run(cls(unit=unit, **numbers), start, (0.0, until), rtol=1e-9, atol=1e-11 * unit)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize(("height", "kick"), [(1.0, 1e-3), (1e-6, 1e-3), (1.0, 1e-10)])
def test_a_ball_at_rest_that_is_kicked_flies(way, unit, height, kick):
    """At rest from ``3 sqrt(h)`` on, and again from ``4 + 2 kick``, slow beside its fall or not."""
    result = run(way, Kicked, [height, 0.0], 6.0, unit, kick=kick)
    found = [point.t for point in result.zeno]
    exact = [3 * height**0.5, 4 + 2 * kick]
    assert result.accumulations == 2
    assert found == pytest.approx(exact if way.tells("all zeno") else exact[:1], abs=1e-8)
    assert result.final.x == 0.0


@pytest.mark.parametrize("unit", UNITS)
def test_a_jump_below_the_floor_is_refused(way, unit):
    """However small the number is by which it is below."""
    result = way.run(Sunk(unit=unit), {"x": unit, "v": 0.0}, (0.0, 3.0), rtol=1e-9)
    assert result.status == "refused"


@cache
def pile(way, unit):
    """Two balls that come to rest on a table, and are thrown by it."""
    return run(way, Pile, [1.5, 2.0, 0.0, 0.0], 2.75, unit)


@pytest.mark.parametrize("unit", [1e-12, 1e6, 1e12, *later(1e-15, 1e-6, 1e9)])
def test_a_pile_comes_to_rest_and_flies_again(way, unit):
    """The first rests and the last states are those of the unit 1.

    (How many rests are listed before both balls rest is up to rounding.)
    """
    result, own = pile(way, unit), pile(way, 1.0)
    assert result.mode == own.mode == "flight"
    times = [[p.t for p in r.zeno[:2]] for r in (result, own)]
    np.testing.assert_allclose(*times, rtol=1e-8)
    states = [np.array(list(r.final)) for r in (result, own)]
    np.testing.assert_allclose(states[0] / unit, states[1], rtol=1e-6)


class Walls(hy.Automaton):
    """A body between two walls, whose guards are in a unit of their own."""

    x = hy.state()
    v = hy.state()
    unit = hy.parameter(1.0)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.v, -0.3 * jnp.sin(s.x)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.unit * (1.0 - s.x))
    def right(self, t, s):
        return s.replace(v=-s.v)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.unit * (1.0 + s.x))
    def left(self, t, s):
        return s.replace(v=-s.v)


class Room(hy.Automaton):
    """The same with both walls as one guard."""

    x = hy.state()
    v = hy.state()
    unit = hy.parameter(1.0)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.v, -0.3 * jnp.sin(s.x)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.unit * (1.0 - jnp.abs(s.x)))
    def wall(self, t, s):
        return s.replace(v=-s.v)


@pytest.mark.parametrize("model", [Walls, Room])
def test_a_guard_may_be_in_any_unit(way, model):
    """One that is far smaller than what the tolerances leave open of the states is no touch."""
    units = (1.0, 1e-10, 1e-20, 1e-60, 1e60)
    start, times = {"x": 0.0, "v": 1.3}, (0.0, 12.0)
    found = [way.run(model(unit=unit), start, times, rtol=1e-9, atol=1e-11) for unit in units]
    assert [each.jumps for each in found] == [8] * len(units)
    for each in found[1:]:  # errors of 1e-9 a step, in some tens of steps
        assert each.final.x == pytest.approx(found[0].final.x, abs=1e-6)
