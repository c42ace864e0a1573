"""The rules' own loop gives the run that the driver's rules give, one by one."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid import gallery
from hybrid.rules.load import Library
from hybrid.run import machine
from hybrid.solvers.taylor_backend import TaylorSolver

from .systems import Oscillator

#: What two ways to the same jumps may differ by: rounding, grown along the run.
ROUNDING = 1e-11


class Duffing(hy.Automaton):
    """A driven double well with a wall: chaos."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.8)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -0.05 * s.v + s.x - s.x**3 + 4.0 * jnp.cos(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x + 0.5, restitution="r")


class Thermostat(hy.Automaton):
    """Two modes that switch at two temperatures, and a count of the time that heating takes."""

    T = hy.state()
    spent = hy.state()

    @hy.mode(initial=True)
    def on(self, t, s):
        return 3.0 - 0.5 * s.T + 0.3 * jnp.sin(t), 1.0

    @hy.mode
    def off(self, t, s):
        return -0.5 * s.T + 0.3 * jnp.sin(t), 0.0

    @hy.edge(on, to=off, guard=lambda self, t, s: s.T - 4.0, crossing=hy.RISING)
    def warm(self, t, s):
        return s.T, s.spent

    @hy.edge(off, to=on, guard=lambda self, t, s: s.T - 2.0)
    def cold(self, t, s):
        return s.T, 0.5 * s.spent


class Sections(hy.Automaton):
    """A ball on a floor, written by hand, with an event that bounds nothing."""

    x = hy.state()
    v = hy.state()
    seen = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.8 + 0.2 * jnp.cos(3.0 * t), 0.0

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x)
    def floor(self, t, s):
        return s.x, -1.0 * s.v, s.seen

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x - 0.4, crossing=hy.EITHER)
    def passes(self, t, s):
        return s.x, s.v, s.seen + 1.0


SCENES = {
    "duffing": (Duffing(), {"x": 0.3, "v": 0.0}, (0.0, 20.0)),
    "thermostat": (Thermostat(), {"T": 3.0, "spent": 0.0}, (0.0, 40.0)),
    "sections": (Sections(), {"x": 1.0, "v": 0.0, "seen": 0.0}, (0.0, 6.0)),
    **{
        name: (entry.cls(), entry.start, entry.until)
        for name, entry in ((name, gallery.known(name)) for name in gallery.names())
        if not entry.cls.spec.lags
    },
}


@pytest.fixture(params=SCENES)
def scene(request):
    return SCENES[request.param]


def taylor(scene, **options):
    model, start, span = scene
    return hy.simulate(model, start, span, solver="taylor", **options)


def same(one, other, span):
    """Jumps, accumulations, and arcs.

    A cycle of edges may be seen to accumulate some turns earlier: its jumps are compared up to
    there, and nothing but the accumulation behind.
    """
    cycle = any(len(point.edges) > 1 for point in one.zeno)
    count = min(len(one.jumps), len(other.jumps)) if cycle else None
    kept = slice(0, count)
    assert list(one.jumps.edge[kept]) == list(other.jumps.edge[kept])
    assert cycle or [arc.mode for arc in one.arcs] == [arc.mode for arc in other.arcs]
    scale = ROUNDING * (abs(span[0]) + abs(span[1]))
    np.testing.assert_allclose(one.jumps.t[kept], other.jumps.t[kept], rtol=0, atol=scale)
    for side in ("before", "after"):
        x, y = (getattr(run.jumps.table, side)[kept] for run in (one, other))
        np.testing.assert_allclose(x, y, rtol=0, atol=ROUNDING * (1 + np.abs(y).max(initial=0)))
    assert [point.edges for point in one.zeno] == [point.edges for point in other.zeno]
    for a, b in zip(one.zeno, other.zeno, strict=True):
        assert a.t == pytest.approx(b.t, abs=scale)


def test_the_loop_gives_the_run_of_the_rules_one_by_one(scene, monkeypatch):
    """Jumps, modes, accumulations and dense output, with the loop and without it."""
    run = taylor(scene)
    monkeypatch.setattr(TaylorSolver, "whole", False)
    slow = taylor(scene)
    same(run, slow, scene[2])
    t0, t1 = scene[2]
    at = np.sort(np.random.default_rng(0).uniform(t0, t1, 200))
    far = np.array([np.abs(slow.jumps.t - t).min(initial=1.0) > 1e-9 * (t1 - t0) for t in at])
    x, y = (np.stack([np.ravel(v) for v in r(at[far])]) for r in (run, slow))
    np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9 * (1 + np.abs(y).max()))


def test_little_room_changes_nothing(scene, monkeypatch):
    """In arrays of one jump and two steps an arc goes on from call to call: jumps, steps and dense
    output are those of large arrays, to the last digit, though a limit may be seen earlier."""
    run = taylor(scene)
    monkeypatch.setattr(machine, "JUMPS_KEPT", 1)
    monkeypatch.setattr(machine, "STEPS_KEPT", 2)
    monkeypatch.setattr(machine, "MORE", 1)
    other = taylor(scene)
    assert np.array_equal(run.jumps.t, other.jumps.t)
    assert np.array_equal(run.jumps.table.after, other.jumps.table.after)
    assert other.stats.steps == run.stats.steps
    assert other.stats.evaluations <= run.stats.evaluations
    at = np.linspace(*scene[2], 301)
    assert all(map(np.array_equal, run(at), other(at)))


@pytest.mark.parametrize("name", ["duffing", "thermostat", "sections", "hard_spring"])
def test_machine_code_and_python_agree(name, monkeypatch):
    """The loop as plain Python, in which no index is below zero, gives the same run."""
    run = taylor(SCENES[name], save="jumps")
    monkeypatch.setenv("HYBRID_RULES", "checked")
    monkeypatch.setattr(machine, "unit", Library("hybrid.rules").unit)
    same(run, taylor(SCENES[name], save="jumps"), SCENES[name][2])


@pytest.mark.parametrize("most", [1, 7, 100])
def test_the_loop_stops_at_the_last_jump_permitted(most):
    """At ``max_jumps``, in the first call or a later one, and not beyond."""
    model, start, _ = SCENES["duffing"]
    run = taylor((model, start, (0.0, 300.0)), max_jumps=most)
    assert run.status is hy.Status.MAX_JUMPS
    assert len(run.jumps) == most


def test_progress_is_told():
    """With times that go on, up to the last jump, however many jumps a call makes."""
    told = []
    model, start, _ = SCENES["duffing"]
    run = hy.simulate(model, start, (0.0, 300.0), solver="taylor", progress=told.append)
    assert told == sorted(told)
    assert told[0] < 200.0 < run.jumps.t[-1] <= told[-1]


def test_the_keyboard_stops_the_loop():
    """What was flown until then is there, up to the middle of an arc."""
    told = []

    def stop(t):
        told.append(t)
        raise KeyboardInterrupt

    model, start, _ = SCENES["duffing"]
    run = hy.simulate(model, start, (0.0, 3000.0), solver="taylor", progress=stop)
    assert run.status is hy.Status.INTERRUPTED
    assert 1 <= len(run.jumps) <= machine.JUMPS_KEPT
    assert run.t1 == told[0] >= run.jumps.t[-1]
    whole = hy.simulate(model, start, (0.0, run.t1), solver="taylor")
    assert run.final.x == pytest.approx(whole.final.x, rel=1e-9)  # its last step is a shorter one


def test_an_arc_may_have_more_steps_than_the_arrays_ever_hold(monkeypatch):
    """Far from its start a swing is still a cosine, and each step is made once."""
    monkeypatch.setattr(machine, "MOST", machine.STEPS_KEPT)
    run = hy.simulate(Oscillator(wall=-5.0), {"x": 1.0, "v": 0.0}, (0.0, 5000.0), solver="taylor")
    assert run.stats.steps > 10 * machine.MOST
    assert run.stats.evaluations == run.stats.steps
    # a rounding of the state in each step, and of the time, grow to this
    assert run.final.x == pytest.approx(np.cos(5000.0), abs=1e-16 * run.stats.steps + 1e-12)
