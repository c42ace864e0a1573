"""What is held against the flow, step by step, is flown by the rules' own loop as the driver
would."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid import Status
from hybrid.run import comparison, watched
from hybrid.run.driver import Driver
from hybrid.run.machine import Machine
from hybrid.trajectory.log import Flights


class Ball(hy.Automaton):
    """A ball on a table that shakes, and a kick, which is as brief as one likes."""

    x = hy.state()
    v = hy.state()
    at = hy.parameter(2.9)
    width = hy.parameter(1e-3)
    kick = hy.parameter(0.4)
    shake = hy.parameter(0.0)
    r = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s):
        push = 0.5 * (1.0 - jnp.tanh((t - self.at) / self.width) ** 2)
        return s.v, -2.0 + self.kick / self.width * push

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.shake * jnp.sin(4.0 * t), restitution="r"
    )


class Smooth(hy.Automaton):
    """A ball on a table that shakes and throws it off again, under a force that is smooth."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.8 - 0.1 * s.v

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - 0.05 * jnp.sin(16.0 * t), restitution="r"
    )


class Tanks(hy.Automaton):
    """Two tanks and one stream of water, which is switched to the one that is empty."""

    a = hy.state()
    b = hy.state()

    @hy.mode(initial=True)
    def left(self, t, s):
        return 0.75 + 0.05 * jnp.sin(t) - 0.5, -0.5

    @hy.mode
    def right(self, t, s):
        return -0.5, 0.75 + 0.05 * jnp.sin(t) - 0.5

    @hy.edge(left, to=right, guard=lambda self, t, s: s.b)
    def fill_right(self, t, s):
        return s.a, s.b

    @hy.edge(right, to=left, guard=lambda self, t, s: s.a)
    def fill_left(self, t, s):
        return s.a, s.b

    @hy.mode(limit_of=("fill_right", "fill_left"))
    def empty(self, t, s):
        return 0.0, 0.0


#: Model, start, span. The kicks: one on the way to the limit, and one that is over before.
SCENES = {
    "kick": (Ball(width=1e-5), {"x": 0.0, "v": 1.0}, (0.0, 8.0)),
    "early": (Ball(at=0.4, kick=0.1), {"x": 0.0, "v": 1.0}, (0.0, 8.0)),
    "shaken": (Ball(shake=0.01), {"x": 0.5, "v": 1.0}, (0.0, 8.0)),
    "smooth": (Smooth(), {"x": 1.0, "v": 0.0}, (0.0, 3.0)),
    "tanks": (Tanks(), {"a": 0.5, "b": 1.0}, (0.0, 10.0)),
}


@pytest.fixture(params=SCENES)
def scene(request):
    return SCENES[request.param]


def jumps(driver):
    """Times and edges, in order."""
    log, found = driver.record.log, []
    for place, part in enumerate(log.kept):
        if isinstance(part, Flights):
            found += zip(part.jumps.t.tolist(), part.jumps.edge.tolist(), strict=True)
        if place in log.own:
            found.append((log.own[place].t, log.own[place].edge))
    return found


def flown(scene, monkeypatch, alone=False, **options):
    """A run, and those with which it is compared; arcs that the driver has flown, in all.

    ``alone``: the driver flies all of the latter; of Taylor's steps all of the former, too. (Where
    the steps of others, which nobody watches at first, pass over a kick, is theirs.)
    """
    made, arcs = [], []

    class Noted(Driver):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(self)

        def flow_arc(self):
            arcs.append(self.entry.field.name)
            super().flow_arc()

    with monkeypatch.context() as patch:
        patch.setattr(comparison, "Driver", Noted)
        one_by_one = lambda: patch.setattr(Machine, "takes", lambda self: False)  # noqa: E731
        if alone and "solver" in options:
            one_by_one()
        run = hy.simulate(*scene, **options)
        if alone:
            one_by_one()
        bounds = [point.t_error for point in run.zeno]
    return run, bounds, made, arcs


@pytest.mark.parametrize("options", [{"solver": "taylor"}, {"method": "DOP853"}], ids=str)
def test_runs_that_are_watched_are_those_of_the_driver(scene, options, monkeypatch):
    """Jumps, accumulations and their errors, and which steps had to be cut, with the loop and
    without it."""
    run, bounds, made, _ = flown(scene, monkeypatch, **options)
    slow, slow_bounds, others, arcs = flown(scene, monkeypatch, alone=True, **options)
    assert len(arcs) > 0
    assert len(run.zeno) > 0
    assert len(made) == len(others) > 1
    # rounding, which grows by as much as a ratio of 0.7 lets it; bounds are three times distances
    assert [point.t for point in run.zeno] == pytest.approx([p.t for p in slow.zeno], abs=1e-9)
    assert bounds == pytest.approx(slow_bounds, rel=9.0, abs=1e-12)
    for one, other in zip(made, others, strict=True):
        assert one.status is other.status
        assert one.watchful.cut == other.watchful.cut
        assert [edge for _, edge in jumps(one)] == [edge for _, edge in jumps(other)]
        t, expected = ([t for t, _ in jumps(driver)] for driver in (one, other))
        # a kick of 1e-5 is known to the rounding of its time, 5e-11 of it, and some runs are moved
        np.testing.assert_allclose(t, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["kick", "early", "smooth", "tanks"])
def test_the_loop_flies_what_is_watched(name, monkeypatch):
    """The driver flies no arc of the runs with which one by Taylor's steps is compared."""
    _, bounds, made, arcs = flown(SCENES[name], monkeypatch, solver="taylor", rtol=1e-9)
    assert all(np.isfinite(bounds))
    assert all(driver.wary for driver in made)
    assert arcs == []


def test_a_low_flight_that_has_not_seen_its_flow_is_flown_by_steps(monkeypatch):
    """Where balls do not show that the series of low flights follow the flow they are not used, and
    the impacts are those of steps as far as these tell the gap from rounding."""
    arcs, fly = [], Driver.flow_arc
    monkeypatch.setattr(Driver, "__init__", watching(Driver.__init__))
    monkeypatch.setattr(Driver, "flow_arc", lambda self: arcs.append(fly(self)))
    model, start, _ = SCENES["smooth"]
    scene = model, start, (0.0, 3.0)
    low = hy.simulate(*scene, solver="taylor", zeno="ignore", max_jumps=40)
    assert np.diff(low.jumps.t).min() < 1e-9
    assert arcs == []
    asked = []
    monkeypatch.setattr(watched, "follows", lambda *given: asked.append(given))
    stepped = hy.simulate(*scene, solver="taylor", zeno="ignore", max_jumps=22)
    assert len(asked) > 3
    assert np.any(stepped.jumps.t != low.jumps.t[:22])
    # rounding of the gap over a speed of 1e-5
    np.testing.assert_allclose(stepped.jumps.t, low.jumps.t[:22], rtol=0, atol=1e-11)


def test_the_keyboard_stops_a_run_that_is_watched(monkeypatch):
    """What has been held against the flow until then is there, in the middle of an arc."""
    hold, held = watched.Holding.hold, []

    def stop(self, *given):
        held.append(hold(self, *given))
        if len(held) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(watched.Holding, "hold", stop)
    monkeypatch.setattr(Driver, "__init__", watching(Driver.__init__))
    model, start, _ = SCENES["early"]
    run = hy.simulate(model, start, (0.0, 5.0), solver="taylor")
    assert run.status is Status.INTERRUPTED
    assert 0.0 < run.t1 < 1.0
    whole = hy.simulate(model, start, (0.0, run.t1), solver="taylor")
    assert run.final.x == pytest.approx(whole.final.x, abs=1e-13)


def watching(begin):
    """A driver that watches its steps from the beginning."""

    def made(self, *given):
        begin(self, *given)
        self.wary = True

    return made
