"""Two guards that are zero at one time: the edge declared first fires, whatever the rounding."""

import numpy as np
import pytest

import hybrid as hy

from .ways import later

WAYS = ["DOP853", "Radau", "taylor", "Dopri8", "ensemble", "as_function"]


class Race(hy.Automaton):
    """Two points at constant speeds from given places, each with its own mark; who is first?"""

    x = hy.state()
    y = hy.state()
    a = hy.parameter(1.0)
    b = hy.parameter(1.0)
    mark = hy.parameter(1.0)
    goal = hy.parameter(1.0)

    @hy.mode(initial=True)
    def runs(self, t, s):
        return self.a, self.b

    @hy.mode
    def one(self, t, s):
        return 0.0, 0.0

    @hy.mode
    def two(self, t, s):
        return 0.0, 0.0

    @hy.edge(runs, to=one, guard=lambda self, t, s: self.mark - s.x)
    def first(self, t, s):
        return s

    @hy.edge(runs, to=two, guard=lambda self, t, s: s.y - self.goal, crossing=hy.RISING)
    def second(self, t, s):
        return s


def races(seed, count, t0):
    """Pairs of speeds, places and marks whose times are equal in exact arithmetic, but for the
    rounding of the marks."""
    draw = np.random.default_rng(seed)
    for _ in range(count):
        a, b = np.exp(draw.uniform(-2, 2, 2))
        x, y = draw.uniform(-2, 2, 2)
        after = draw.uniform(0.1, 3.0)
        yield {"a": a, "b": b, "mark": x + a * after, "goal": y + b * after}, [x, y], after


@pytest.mark.parametrize("t0", [1e6, *later(0.0, 1.0)])
def test_of_equal_times_the_edge_declared_first_wins(way, t0):
    """In 200 random pairs."""
    cases = list(races(3, 200, t0))
    parameters = {name: [case[0][name] for case in cases] for name in cases[0][0]}
    starts = [case[1] for case in cases]
    results = way.many(Race(), starts, (t0, t0 + 4.0), parameters, rtol=1e-9)
    if way.tells("mode"):
        assert [r.mode for r in results] == ["one"] * len(cases)
    else:
        assert [r.edges[0] for r in results] == ["first"] * len(cases)


@pytest.mark.parametrize("t0", [0.0, 1e3])
@pytest.mark.parametrize("apart", [1e-11, 1e-9])
def test_what_is_no_tie_fires_in_order(way, t0, apart):
    """The second is earlier by far more than rounding: it fires."""
    cases = list(races(4, 20, t0))
    parameters = {name: [case[0][name] for case in cases] for name in cases[0][0]}
    early = apart * max(1.0, t0)
    parameters["goal"] = [
        g - b * early for g, b in zip(parameters["goal"], parameters["b"], strict=True)
    ]
    results = way.many(Race(), [case[1] for case in cases], (t0, t0 + 4.0), parameters, rtol=1e-9)
    if way.tells("mode"):
        assert [r.mode for r in results] == ["two"] * len(cases)
    else:
        assert [r.edges[0] for r in results] == ["second"] * len(cases)
