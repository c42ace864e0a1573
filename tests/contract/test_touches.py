"""Guards that touch zero, or cross it without a slope: how near to zero is zero."""

import math
from functools import cache

import jax.numpy as jnp
import pytest

import hybrid as hy

WAYS = ["DOP853", "Radau", "taylor", "Tsit5", "Dopri8", "ensemble"]


@cache
def flat(power: int) -> hy.Automaton:
    """``x = (t - 1)^power``, which crosses zero at 1 with no slope."""

    class Flat(hy.Automaton):
        x = hy.state()
        n = hy.discrete(0)

        @hy.mode
        def flows(self, t, s):
            return power * (t - 1.0) ** (power - 1)

        @hy.edge(flows, guard=lambda self, t, s: s.x, crossing=hy.RISING)
        def passed(self, t, s):
            return s.replace(n=s.n + 1)

    return Flat()


class Waves(hy.Automaton):
    """A clock of two waves, one of which comes down to zero and one of which crosses it."""

    x = hy.state()
    tone = hy.parameter(2.0)
    n = hy.discrete(0)
    crossed = hy.discrete(0)

    @hy.mode
    def flows(self, t, s):
        return 0.0 * s.x

    @hy.edge(flows, guard=lambda self, t, s: 1 - jnp.cos(self.tone * t), crossing=hy.EITHER)
    def squared(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flows, guard=lambda self, t, s: 1 - jnp.cos(self.tone * t), crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flows, guard=lambda self, t, s: 1 - jnp.cos(self.tone * t))
    def falls(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flows, guard=lambda self, t, s: jnp.sin(self.tone * t), crossing=hy.RISING)
    def crosses(self, t, s):
        return s.replace(crossed=s.crossed + 1)


class Top(hy.Automaton):
    """A throw whose highest point is marked, with a ceiling that it just reaches there."""

    x = hy.state()
    v = hy.state()
    g = hy.parameter(2.0)
    ceiling = hy.parameter(0.25)

    @hy.mode
    def flies(self, t, s):
        return s.v, -self.g

    top = hy.edge(flies, guard=lambda self, t, s: s.v)
    meets = hy.edge(flies, to=hy.TERMINATE, guard=lambda self, t, s: self.ceiling - s.x)


@pytest.mark.parametrize("power", [3, 5, 7])
def test_a_guard_without_a_slope_fires_where_it_is_zero(way, power):
    """To what its rounding allows: ``(t - 1)^power`` is lost in that of x, of size 1, and of what a
    step may lose, before."""
    result = way.run(flat(power), {"x": -1.0}, (0.0, 2.0), rtol=1e-10)
    assert result.final.n == 1
    if result.times is not None:
        assert abs(result.times[0] - 1.0) ** power < 1e-9


@pytest.mark.parametrize("tone", [1.0, 2.0, 7.0])
def test_a_guard_of_time_that_touches_zero_is_not_passed(way, tone):
    """Within the rounding of its own terms, which no tolerance of states knows."""
    result = way.run(Waves(tone=tone), {"x": 0.0}, (1.0, 20.0))
    assert result.final.n == 0
    turns = math.floor(20.0 * tone / (2 * math.pi)) - math.floor(tone / (2 * math.pi))
    assert result.final.crossed == turns


@pytest.mark.parametrize("ceiling", [0.25, 0.15, 0.3, 1.0])
@pytest.mark.parametrize("g", [2.0, 9.81, 1.7])
def test_a_touch_beside_another_event_is_none(way, ceiling, g):
    """What rounding leaves of the speed at the top leads nowhere: it turns back."""
    start = {"x": 0.0, "v": math.sqrt(2.0 * g * ceiling)}
    result = way.run(Top(g=g, ceiling=ceiling), start, (0.0, 1.0 + start["v"] / g))
    assert result.status != "terminated"
    higher = way.run(Top(g=g, ceiling=ceiling * (1 - 1e-6)), start, (0.0, 1.0 + start["v"] / g))
    assert higher.status == "terminated"


class Marks(hy.Automaton):
    """A throw: its top is marked, by the speed and by a clock, and a mark is passed up and down."""

    x = hy.state()
    v = hy.state()
    g = hy.parameter(2.0)
    mark = hy.parameter(0.25)
    beside = hy.parameter(1.0)
    up = hy.discrete(0)
    down = hy.discrete(0)
    tops = hy.discrete(0)

    @hy.mode
    def flies(self, t, s):
        return s.v, -self.g

    rings = hy.edge(flies, at="beside")

    @hy.edge(flies, guard=lambda self, t, s: s.v)
    def top(self, t, s):
        return s.replace(tops=s.tops + 1)

    @hy.edge(flies, guard=lambda self, t, s: s.x - self.mark, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)

    @hy.edge(flies, guard=lambda self, t, s: s.x - self.mark)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)


@pytest.mark.parametrize("late", [0.0, 0.1])
@pytest.mark.parametrize("mark", [0.25, 0.15, 0.3])
@pytest.mark.parametrize("g", [2.0, 9.81, 1.7])
def test_a_mark_at_the_top_is_passed_neither_way(way, mark, g, late):
    """Whichever event is beside the touch; a mark a millionth lower is passed both ways."""
    start = {"x": 0.0, "v": math.sqrt(2.0 * g * mark)}
    model = Marks(g=g, mark=mark, beside=start["v"] / g + late)
    until = 0.2 + 1.5 * start["v"] / g
    touched = way.run(model, start, (0.0, until)).final
    assert (touched.tops, touched.up, touched.down) == (1, 0, 0)
    higher = {"x": 1e-6 * mark, "v": start["v"]}
    passed = way.run(model, higher, (0.0, until)).final
    assert (passed.tops, passed.up, passed.down) == (1, 1, 1)


class Layers(hy.Automaton):
    """A throw into another layer, in which the body is heavier, whose top is counted."""

    x = hy.state()
    v = hy.state()
    g = hy.parameter(2.0)
    level = hy.parameter(0.25)
    more = hy.parameter(0.3)
    tops = hy.discrete(0)

    below = hy.mode(lambda self, t, s: (s.v, -self.g), initial=True)
    above = hy.mode(lambda self, t, s: (s.v, -self.g - self.more))
    surface = hy.switching(above, below, surface=lambda self, t, s: s.x - self.level)

    @hy.edge(below, guard=lambda self, t, s: s.v)
    def top(self, t, s):
        return s.replace(tops=s.tops + 1)

    @hy.edge(above, guard=lambda self, t, s: s.v)
    def higher(self, t, s):
        return s.replace(tops=s.tops + 1)


@pytest.mark.parametrize("more", [0.3, -0.3, 5.0])
@pytest.mark.parametrize(("g", "level"), [(2.0, 0.25), (9.81, 0.15), (3.3, 0.05), (7.3, 0.61)])
def test_a_layer_that_is_just_reached_is_not_entered(way, g, level, more):
    """The top of the throw is on its surface: it is counted once, and the body stays below."""
    start, model = {"x": 0.0, "v": math.sqrt(2.0 * g * level)}, Layers(g=g, level=level, more=more)
    result = way.run(model, start, (0.0, 2.0 * start["v"] / g))
    assert (result.final.tops, result.mode) == (1, "below")
    assert abs(result.final.x) < 1e-13
