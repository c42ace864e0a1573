"""Jumps at the time of a knot: what is zero there fires first, then what is behind it holds."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .systems import without_loop

SOLVERS = ["taylor", "scipy", "diffrax"]

#: Flows are polynomials of second degree, which every solver flies to rounding.
CLOSE = 1e-9

FLAT = ([0.0, 1.0], [0.0, 0.0])


class Floor(hy.Automaton):
    """A ball on a floor that is put up or down."""

    x = hy.state()
    v = hy.state()
    floor = hy.signal(kind="previous", outside="hold")
    push = hy.signal(kind="previous", outside="hold")

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0 + self.push(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.floor(t), restitution=0.5)


class Road(hy.Automaton):
    """A bead on a road."""

    x = hy.state()
    v = hy.state()
    road = hy.signal(kind="linear", outside="hold")

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0 - 0.5 * s.v - 2.6 * s.x

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.road(t), restitution=0.5)


class Marked(hy.Automaton):
    """Motion past a mark, which is counted there or turned round."""

    x = hy.state()
    v = hy.state()
    mark = hy.signal(kind="previous", outside="hold")
    keeps: float = hy.parameter(1.0, doc="of the speed, behind the mark")

    @hy.mode
    def flight(self, t, s):
        return s.v, 0.0

    @hy.edge(flight, guard=lambda self, t, s: self.mark(t) - s.x)
    def passes(self, t, s):
        return s.replace(v=self.keeps * s.v)


class Sides(hy.Automaton):
    """Falls by one, and by two below a mark."""

    x = hy.state()
    mark = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def above(self, t, s):
        return (-1.0,)

    @hy.mode
    def below(self, t, s):
        return (-2.0,)

    side = hy.switching(above, below, surface=lambda self, t, s: s.x - self.mark(t))


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_an_impact_at_a_knot_is_on_the_floor_before_it(solver):
    """The floor falls by 1 as the ball strikes it, at 0.5: it rises from where the floor was."""
    model = Floor(floor=([0.0, 0.5], [0.0, -1.0]), push=FLAT)
    run = hy.simulate(model, {"x": 1.25, "v": 0.0}, (0.0, 0.7), solver=solver)
    assert run.jumps.edge.tolist() == ["impact"]
    assert np.allclose([run.jumps.t[0], *run.final], [0.5, 2.5 * 0.2 - 5 * 0.04, 0.5], atol=CLOSE)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_floor_that_rises_at_the_impact_is_refused(solver):
    """After the impact the ball would be below it."""
    model = Floor(floor=([0.0, 0.5], [0.0, 0.1]), push=FLAT)
    with pytest.raises(hy.DomainError, match="gap of impact jumps"):
        hy.simulate(model, {"x": 1.25, "v": 0.0}, (0.0, 0.7), solver=solver)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("to", "times"), [(-0.5, [0.5]), (1.5, [0.5, 1.5])])
def test_a_mark_that_moves_as_it_is_passed_is_passed_once(solver, to, times):
    """One that moves back has been passed already, one that moves on is passed again."""
    model = Marked(mark=([0.0, 0.5], [0.5, to]))
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 3.0), solver=solver)
    assert np.allclose(run.jumps.t, times, atol=CLOSE)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_wall_that_moves_off_as_it_is_struck_has_been_struck(solver):
    """It turns the motion round at 0.5, where it was."""
    model = Marked(mark=([0.0, 0.5], [0.5, 1.5]), keeps=-0.5)
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 0.8), solver=solver)
    assert np.allclose([*run.jumps.t, run.final.x], [0.5, 0.35], atol=CLOSE)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_wall_that_moves_over_what_strikes_it_is_refused(solver):
    """Behind the knot the state is out of the mode's domain."""
    model = Marked(mark=([0.0, 0.5], [0.5, -0.5]), keeps=-0.5)
    with pytest.raises(hy.DomainError):
        hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 0.8), solver=solver)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_surface_that_jumps_back_as_it_is_crossed_is_crossed_back(solver):
    """At 1 the state falls through zero, where the surface goes half a unit below it."""
    model = Sides(mark=([0.0, 1.0], [0.0, -0.5]))
    run = hy.simulate(model, {"x": 1.0}, (0.0, 2.0), solver=solver)
    assert np.allclose([*run.jumps.t, run.final.x], [1.0, 1.0, 1.5, -1.5], atol=CLOSE)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_run_goes_on_from_a_jump_at_a_knot(solver):
    """Cut at the impact, and at the knot, it is the run that is made in one."""
    model = Floor(floor=([0.0, 0.5], [0.0, -1.0]), push=FLAT)
    first = hy.simulate(model, {"x": 1.25, "v": 0.0}, (0.0, 0.5), solver=solver)
    second = hy.simulate(model, first, (0.5, 0.7), solver=solver)
    assert (first + second).jumps.edge.tolist() == ["impact"]
    assert np.allclose([*second.final], [0.3, 0.5], atol=CLOSE)


def test_lanes_take_the_jumps_of_knots_as_runs_do():
    """The same floor, under three balls of which one strikes it at the knot."""
    model = Floor(floor=([0.0, 0.5], [0.0, -1.0]), push=FLAT)
    start = {"x": np.array([1.25, 1.0, 2.0]), "v": np.zeros(3)}
    lanes = hy.ensemble(model, start, (0.0, 0.7))
    for i, x in enumerate(start["x"]):
        run = hy.simulate(model, {"x": x, "v": 0.0}, (0.0, 0.7), solver="taylor")
        assert int(lanes.jumps[i]) == len(run.jumps)
        assert abs(float(lanes.x[i]) - run.final.x) < CLOSE


class Passing(hy.Automaton):
    """A body that falls through a level, and a time, under a load that does not change."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)
    level: float = hy.parameter(-1e9)
    event: float = hy.parameter(9.0)
    load = hy.signal(outside="hold")

    @hy.mode
    def falls(self, t, s):
        return s.v, -10.0 * self.load(t)

    @hy.edge(falls, guard=lambda self, t, s: s.x - self.level)
    def kick(self, t, s):
        return s.replace(n=s.n + 1, v=s.v - 1.0)

    @hy.edge(falls, guard=lambda self, t, s: self.event - t)
    def tick(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("x0", [0.0, -500.0, 1e4])
@pytest.mark.parametrize("guard", ["level", "event"])
def test_an_event_a_few_roundings_before_a_knot_fires_once(solver, x0, guard):
    """It is still zero, but for rounding, at the knot."""
    for time in np.random.default_rng(3).uniform(1.0, 2.0, 8):
        for spacings in (-5, -1, 0, 1, 2, 5, 20, 100, 4000):
            knot = time + spacings * np.spacing(time)
            load = ([0.0, 0.1, knot, 9.0], [1.0] * 4)
            where = {"level": x0 - 5.0 * time * time} if guard == "level" else {"event": time}
            run = hy.simulate(
                Passing(load=load, **where), {"x": x0, "v": 0.0}, (0.0, 3.0), solver=solver
            )
            assert (run.final.n, len(run.jumps)) == (1, 1), (time, spacings)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_body_on_a_road_is_there_but_for_rounding_where_the_road_is_at_zero(solver, monkeypatch):
    """There both are zero, and their rounding is that of the heights that they come from. Where
    the slope ends the body is thrown off."""
    without_loop(monkeypatch)
    draw = np.random.default_rng(0)
    for _ in range(12):
        begin, end = draw.uniform(-1.0, 0.0), draw.uniform(1.0, 3.0)
        model = Road(road=([0.0, end], [begin, 0.0]))
        start = [begin, -begin / end]
        run = hy.simulate(
            model, start, (0.0, end + 0.01), mode="flight.rest(impact)", solver=solver
        )
        assert run.jumps.edge.tolist()[:1] == ["impact.release"]
        assert run.jumps.t[0] == end


class OnFloor(hy.Automaton):
    """Two bodies on each other and on a floor, pushed by a signal far too little to lift them."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    push = hy.signal(kind="linear", outside="hold")

    @hy.mode
    def flight(self, t, s):
        return s.v, -3.9 - 2.1 * s.x + self.push(t), s.w, -5.8 + 2.1 * jnp.sin(3.7 * t) - 5.9 * s.y

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.4)
    pair = hy.contact(
        flight, gap=lambda self, t, s: s.y - s.x, restitution=0.3, inverse_mass=[0.83, 1.93]
    )


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("solver", SOLVERS)
def test_bodies_at_rest_stay_there_at_knots(solver, own, monkeypatch):
    """What rounding has left of their fall does not open them: they lie at 0, where heights and
    speeds of 1e-19 are large beside themselves."""
    if not own:
        without_loop(monkeypatch)
    draw = np.random.default_rng(1)
    for _ in range(6):
        model = OnFloor(push=(np.linspace(0.0, 4.0, 40), draw.uniform(-0.3, 0.3, 40)))
        x, y = draw.uniform(0.2, 0.5), draw.uniform(0.6, 1.0)
        run = hy.simulate(model, [x, 0.0, y, 0.0], (0.0, 4.0), solver=solver)
        assert run.mode == "flight.rest(floor, pair)"
        assert not any("release" in edge for edge in run.jumps.edge)
