"""Two guards that are zero at one time: the edge declared first fires, whatever the rounding."""

import functools

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


@functools.cache
def marked(crossing):
    """A class of balls with a mark in time, which is passed once."""

    class Marked(hy.Automaton):
        x = hy.state()
        v = hy.state()
        n = hy.state()
        mark = hy.parameter(9.0)
        r = hy.parameter(0.5)

        @hy.mode(initial=True)
        def fly(self, t, s):
            return s.v, -9.81, 0.0

        floor = hy.contact(fly, gap=lambda self, t, s: s.x, restitution="r")

        @hy.edge(fly, to=fly, guard=lambda self, t, s: t - self.mark, crossing=crossing)
        def passes(self, t, s):
            return s.replace(n=s.n + 1)

    return Marked


BALL = {"x": 1.0, "v": 0.0, "n": 0.0}
NEAR_BY = [-1000, -181, -128, -90, -30, -4, -1, 0, 1, 4, 30, 90, 128, 181, 1000]


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
@pytest.mark.parametrize("crossing", [hy.EITHER, hy.RISING])
def test_an_event_within_rounding_of_an_impact_is_met_once(solver, crossing):
    """In spacings of the time: what is no tie is not zero behind the impact; and a guard that has
    just passed zero is not met again there."""
    ball = marked(crossing)
    impact = hy.simulate(ball(), BALL, (0.0, 0.6), solver=solver).jumps.t[0]
    for spacings in NEAR_BY:
        mark = impact + spacings * np.spacing(impact)
        run = hy.simulate(ball(mark=mark), BALL, (0.0, 0.6), solver=solver)
        assert (run.final.n, len(run.jumps)) == (1.0, 2), spacings


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
def test_an_event_beside_an_impact_from_which_on_impacts_are_summed_is_met(solver):
    """It waits for the third impact, which is at its time but for what steps have lost."""
    ball = marked(hy.RISING)
    impact = hy.simulate(ball(), BALL, (0.0, 3.0), solver=solver).jumps.t[2]
    for early in np.logspace(-15, -9, 13):
        run = hy.simulate(ball(mark=impact - early), BALL, (0.0, 3.0), solver=solver)
        assert run.final.n == 1.0, early


FROM_LIMIT = [-2000, -700, -300, -220, -150, -100, -50, -40, -8, -1, 0, 1, 8, 40, 90, 300]


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
@pytest.mark.parametrize("crossing", [hy.EITHER, hy.RISING])
@pytest.mark.parametrize("r", [0.5, 0.9])
def test_an_event_within_rounding_of_a_limit_is_met_once(solver, crossing, r):
    """Its guard passes zero there, as nothing else has changed its sign; and does so once, though
    many impacts are still to come within rounding of that."""
    ball = marked(crossing)
    limit = hy.simulate(ball(r=r), BALL, (0.0, 10.0), solver=solver).zeno[0].t
    for spacings in FROM_LIMIT:
        mark = limit + spacings * np.spacing(limit)
        run = hy.simulate(ball(mark=mark, r=r), BALL, (0.0, 10.0), solver=solver)
        assert (run.final.n, run.mode) == (1.0, "fly.rest(floor)"), spacings
