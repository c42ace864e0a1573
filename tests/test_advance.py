"""The rules' own loop gives the run that the driver's rules give, one by one."""

from types import SimpleNamespace

import attrs
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid import gallery
from hybrid.lowering.scene import scene_of
from hybrid.rules.load import Library
from hybrid.rules.places import END, FULL, LOOK
from hybrid.run import machine
from hybrid.run.driver import Driver
from hybrid.trajectory.log import Flights

from .switched import Quadrants, Rings, StickSlip
from .systems import Oscillator, Pile, without_loop

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


class Soft(hy.Automaton):
    """A ball that loses more of its speed where it is fast."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.8 + 0.3 * jnp.sin(t)

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x, restitution=lambda self, t, s, u: 0.7 - 0.1 * abs(u)
    )


class Row(hy.Automaton):
    """Three equal balls between two walls, which may touch, and a line that makes them go on."""

    a = hy.state()
    u = hy.state()
    b = hy.state()
    v = hy.state()
    c = hy.state()
    w = hy.state()
    r = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.u, 0.0, s.v, 0.0, s.w, 0.0

    left = hy.contact(flight, gap=lambda self, t, s: s.b - s.a, restitution="r")
    right = hy.contact(flight, gap=lambda self, t, s: s.c - s.b, restitution="r")
    near = hy.contact(flight, gap=lambda self, t, s: s.a + 1.0, restitution="r")
    far = hy.contact(flight, gap=lambda self, t, s: 2.3 - s.c, restitution="r")


class Chain(hy.Automaton):
    """Three modes; the reset of the first edge leads onto the guard of the second."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def low(self, t, s):
        return 1.0 + 0.1 * jnp.cos(t), 0.0

    @hy.mode
    def high(self, t, s):
        return 2.0 + 0.1 * jnp.cos(t), 0.0

    @hy.edge(low, to=high, guard=lambda self, t, s: s.x - 1.0, crossing=hy.RISING)
    def up(self, t, s):
        return s.x + 1.0, s.n + 1.0

    @hy.edge(high, to=low, guard=lambda self, t, s: s.x - 2.0, crossing=hy.RISING)
    def back(self, t, s):
        return 0.25 * s.x, s.n + 10.0


class Hysteresis(hy.Automaton):
    """A body that rubs, and is pushed back hard beyond a place; what sticks is kicked in time."""

    x = hy.state()
    v = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def faster(self, t, s):
        return s.v, -s.x - 0.8 - 0.1 * s.v + 0.9 * jnp.sin(t), 0.0

    @hy.mode
    def slower(self, t, s):
        return s.v, -s.x + 0.8 - 0.1 * s.v + 0.9 * jnp.sin(t), 0.0

    @hy.mode
    def pushed(self, t, s):
        return s.v, -9.0 * s.x + 0.2 * jnp.cos(t), 1.0

    friction = hy.switching(faster, slower, surface=lambda self, t, s: s.v)

    @hy.edge(faster, to=pushed, guard=lambda self, t, s: s.x - 1.0, crossing=hy.RISING)
    def far(self, t, s):
        return s

    @hy.edge(pushed, to=slower, guard=lambda self, t, s: s.x - 0.5)
    def near(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(
        "slide(friction)",
        to=faster,
        guard=lambda self, t, s: jnp.sin(0.7 * t) - 0.9,
        crossing=hy.RISING,
    )
    def kick(self, t, s):
        return s.replace(v=1.6)


class Led(Quadrants):
    """Sliding along one half of a line, then along the other."""

    south = hy.switching("south_east", "south_west", surface=lambda self, t, s: s.x)

    @hy.edge("slide(north)", to="south_east", guard=lambda self, t, s: s.y)
    def past(self, t, s):
        return s


ROW = {"a": 0.0, "u": 2.0, "b": 0.0, "v": 0.7, "c": 0.0, "w": -0.1}

SCENES = {
    "row": (Row(), ROW, (0.0, 6.0)),
    "stick_slip": (StickSlip(), {"x": 0.0, "v": 0.0}, (0.0, 40.0)),
    "hysteresis": (Hysteresis(), {"x": 0.1, "v": 1.0, "n": 0.0}, (0.0, 40.0)),
    "led": (Led(), {"x": 0.5, "y": 1.0}, (0.0, 2.0)),
    "rings": (Rings(), {"x": 2.0, "y": 0.0}, (0.0, 10.0)),
    "chain": (Chain(), {"x": 0.5, "n": 0.0}, (0.0, 6.0)),
    "soft": (Soft(), {"x": 0.5, "v": 0.0}, (0.0, 3.0)),
    "duffing": (Duffing(), {"x": 0.3, "v": 0.0}, (0.0, 20.0)),
    "thermostat": (Thermostat(), {"T": 3.0, "spent": 0.0}, (0.0, 40.0)),
    "sections": (Sections(), {"x": 1.0, "v": 0.0, "seen": 0.0}, (0.0, 6.0)),
    **{
        name: (entry.cls(), entry.start, entry.until)
        for name, entry in ((name, gallery.find(name)) for name in gallery.names())
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
    without_loop(monkeypatch)
    slow = taylor(scene)
    same(run, slow, scene[2])
    t0, t1 = scene[2]
    at = np.sort(np.random.default_rng(0).uniform(t0, t1, 200))
    far = np.array([np.abs(slow.jumps.t - t).min(initial=1.0) > 1e-9 * (t1 - t0) for t in at])
    x, y = (np.stack([np.ravel(v) for v in r(at[far])]) for r in (run, slow))
    np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9 * (1 + np.abs(y).max()))


@pytest.mark.parametrize("name", ["stick_slip", "hysteresis", "dry_friction", "relay"])
def test_the_driver_judges_no_switching_and_flies_no_arc_that_slides(name, monkeypatch):
    """All of it is the loop's: crossing, sliding, its ends, edges that end it, and lanes."""
    model, start, span = SCENES[name]
    judged = []
    monkeypatch.setattr(Driver, "jump", lambda self, guard, *_: judged.append(guard.edge))
    monkeypatch.setattr(Driver, "flow_arc", lambda self: judged.append(self.entry.field.name))
    run = taylor(SCENES[name])
    lanes = hy.ensemble(model, {k: np.full(2, v) for k, v in start.items()}, span)
    assert any(arc.sliding for arc in run.arcs)
    assert judged == []
    assert lanes.jumps.values.tolist() == 2 * [len(run.jumps)]
    assert lanes["mode"].values.tolist() == 2 * [run.mode]
    assert all(np.array_equal(lanes[k].values, 2 * [getattr(run.final, k)]) for k in start)


def test_little_room_changes_nothing(scene, monkeypatch):
    """In arrays of one jump and two steps an arc goes on from call to call: jumps, steps and dense
    output are those of large arrays, to the last digit, though a limit may be seen earlier."""
    run = taylor(scene)
    monkeypatch.setattr(machine, "JUMPS_KEPT", 1)
    monkeypatch.setattr(machine, "STEPS_KEPT", 2)
    monkeypatch.setattr(machine, "ROOM_GROWTH", 1)
    other = taylor(scene)
    assert np.array_equal(run.jumps.t, other.jumps.t)
    assert np.array_equal(run.jumps.table.after, other.jumps.table.after)
    assert other.stats.steps == run.stats.steps
    assert other.stats.evaluations <= run.stats.evaluations
    at = np.linspace(*scene[2], 301)
    assert all(map(np.array_equal, run(at), other(at)))


@pytest.mark.parametrize("name", ["duffing", "thermostat", "sections", "hard_spring", "relay"])
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
    monkeypatch.setattr(machine, "MOST_ROOM", machine.STEPS_KEPT)
    run = hy.simulate(Oscillator(wall=-5.0), {"x": 1.0, "v": 0.0}, (0.0, 16000.0), solver="taylor")
    assert run.stats.steps > 10 * machine.MOST_ROOM
    assert run.stats.evaluations == run.stats.steps
    # a rounding of the state in each step, and of the time, grow to this
    assert run.final.x == pytest.approx(np.cos(16000.0), abs=1e-16 * run.stats.steps + 1e-12)


class Table(hy.Automaton):
    """A ball on a table that shakes: it chatters, comes to rest, and is thrown off, again and
    again."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)
    amplitude = hy.parameter(0.05)
    omega = hy.parameter(16.0)

    def table(self, t):
        return self.amplitude * jnp.sin(self.omega * t)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.8

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.table(t), restitution="r")


class Pushed(hy.Automaton):
    """Two balls on a floor, pushed apart, with a line that the first crosses and a lid."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    r = hy.parameter(0.5)
    lid = hy.parameter(3.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.8 + 0.3 * jnp.sin(t), s.w, -6.0 + 7.0 * jnp.sin(0.7 * t)

    low = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")
    other = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.6)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x - 0.4, crossing=hy.EITHER)
    def passes(self, t, s):
        return s.x, s.v, s.y, s.w

    @hy.edge(flight, to=flight, guard=lambda self, t, s: self.lid - s.x * s.x - 0.1 * s.v)
    def top(self, t, s):
        return s.x, -s.v, s.y, s.w


def drawn(seed):
    """A scene with sums, rests and releases, by chance."""
    rng = np.random.default_rng(seed)
    r, height = rng.uniform(0.2, 0.8), rng.uniform(0.1, 1.0)
    if seed % 2:
        model = Table(r=r, amplitude=rng.uniform(0.02, 0.08), omega=rng.uniform(8.0, 20.0))
        return model, {"x": height + 0.1, "v": rng.uniform(-1.0, 1.0)}, (0.0, 6.0)
    start = {"x": height, "v": 0.0, "y": rng.uniform(0.1, 1.0), "w": rng.uniform(0.0, 2.0)}
    return Pushed(r=r), start, (0.0, 10.0)


def calls(monkeypatch):
    """Counts what each call of the loop comes back with."""
    found, known = [], machine.unit

    def unit(name):
        rules = known(name)
        if name != "runs":
            return rules

        def go(*arguments):
            found.append(rules.go(*arguments))
            return found[-1]

        return SimpleNamespace(go=go)

    monkeypatch.setattr(machine, "unit", unit)
    return found


#: What lets a run end elsewhere than at its last time, or keeps other parts of it.
OPTIONS = [{}, {"zeno": "stop"}, {"save": "jumps"}, {"rtol": 1e-8}]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("seed", range(6))
def test_sums_rests_and_releases_are_those_of_the_rules_one_by_one(seed, options, monkeypatch):
    """With the loop and without it, wherever a run ends."""
    scene = drawn(seed)
    run = taylor(scene, **options)
    without_loop(monkeypatch)
    slow = taylor(scene, **options)
    assert run.status is slow.status
    assert list(run.jumps.edge) == list(slow.jumps.edge)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in slow.arcs]
    assert [point.edges for point in run.zeno] == [point.edges for point in slow.zeno]
    # a step at a tolerance of 1e-8 is as long as it wants to be, and ends elsewhere
    close = {"rtol": 0, "atol": 1e-5 if options.get("rtol") else 1e-9}
    np.testing.assert_allclose(run.jumps.t, slow.jumps.t, **close)
    np.testing.assert_allclose(run.jumps.table.after, slow.jumps.table.after, **close)
    for a, b in zip(run.zeno, slow.zeno, strict=True):
        assert (a.t_release is None) == (b.t_release is None)
        np.testing.assert_allclose([a.t, a.t_release or 0], [b.t, b.t_release or 0], **close)


@pytest.mark.parametrize("seed", [0, 1, 3])
@pytest.mark.parametrize("most", [1, 5, 6, 7, 8, 23])
def test_the_loop_counts_the_jumps_around_sums(most, seed):
    """Up to ``max_jumps``, those of the summed impacts not counted, a run is that without it."""
    scene = drawn(seed)
    run, whole = taylor(scene, max_jumps=most), taylor(scene)
    assert run.status is hy.Status.MAX_JUMPS
    flights = [len(part.jumps.t) for part in run.log.kept if isinstance(part, Flights)]
    assert sum(flights) + len(run.log.own) == most
    assert np.array_equal(run.jumps.t, whole.jumps.t[: len(run.jumps)])
    assert np.array_equal(run.jumps.table.after, whole.jumps.table.after[: len(run.jumps)])


@pytest.mark.parametrize("seed", range(4))
def test_states_at_times_are_those_of_dense_output(seed):
    """Over sums, rests and releases, to rounding; and of dense output in arrays of any size."""
    scene = drawn(seed)
    at = np.linspace(*scene[2], 77)
    run = taylor(scene)
    sampled = taylor(scene, save=at).samples
    whole = np.stack([np.ravel(state) for state in run(at)], axis=-1)
    np.testing.assert_allclose(whole, np.asarray(sampled).reshape(whole.shape), atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_little_room_changes_no_sum(seed, monkeypatch):
    """In arrays of one jump, two steps and one sum a run is the same to the last digit."""
    scene = drawn(seed)
    run = taylor(scene)
    for name, size in {"JUMPS_KEPT": 1, "STEPS_KEPT": 2, "SUMS_KEPT": 1, "ROOM_GROWTH": 1}.items():
        monkeypatch.setattr(machine, name, size)
    other = taylor(scene)
    assert len(run.zeno) > 1
    assert np.array_equal(run.jumps.t, other.jumps.t)
    assert np.array_equal(run.jumps.table.after, other.jumps.table.after)
    assert [point.t for point in run.zeno] == [point.t for point in other.zeno]
    assert [point.t_release for point in run.zeno] == [point.t_release for point in other.zeno]
    at = np.linspace(*scene[2], 301)
    assert all(map(np.array_equal, run(at), other(at)))


@pytest.mark.parametrize("seed", [1, 3])
def test_machine_code_and_python_sum_alike(seed, monkeypatch):
    """The sums, rests and releases of a table as plain Python, in which no index is below zero."""
    model, start, _ = drawn(seed)
    scene = model, start, (0.0, 1.5)
    run = taylor(scene, save="jumps")
    assert run.zeno
    monkeypatch.setenv("HYBRID_RULES", "checked")
    monkeypatch.setattr(machine, "unit", Library("hybrid.rules").unit)
    same(run, taylor(scene, save="jumps"), scene[2])


@pytest.mark.parametrize("seed", range(4))
def test_low_flights_are_those_of_the_rules_one_by_one(seed, monkeypatch):
    """Down to flights of 1e-18, with the loop and without it."""
    model, start, span = drawn(seed)
    scene = attrs.evolve(model, r=0.3), start, span
    run = taylor(scene, zeno="ignore", max_jumps=60)
    assert np.diff(run.jumps.t).min() < 1e-12
    without_loop(monkeypatch)
    same(run, taylor(scene, zeno="ignore", max_jumps=60), span)


def test_low_flights_are_flown_in_the_loop(monkeypatch):
    """It comes back at the last jump alone."""
    scene = SCENES["soft"]
    taylor(scene, zeno="ignore", max_jumps=60)
    found = calls(monkeypatch)
    taylor(scene, zeno="ignore", max_jumps=60)
    assert found == [FULL]


def test_a_low_flight_beyond_the_end_of_a_run_is_cut_off(monkeypatch):
    """It is left to the driver: the run ends in the middle of it, as without the loop."""
    model, start, span = SCENES["soft"]
    jumps = taylor((model, start, span), zeno="ignore", max_jumps=60).jumps.t
    place = int(np.argmax(np.diff(jumps) < 1e-5))
    scene = model, start, (0.0, 0.5 * (jumps[place] + jumps[place + 1]))
    found = calls(monkeypatch)
    run = taylor(scene, zeno="ignore")
    assert LOOK in found
    assert len(run.jumps) == place + 1
    without_loop(monkeypatch)
    slow = taylor(scene, zeno="ignore")
    same(run, slow, scene[2])
    assert run.final.v == pytest.approx(slow.final.v, abs=ROUNDING)


class Pressed(hy.Automaton):
    """A ball that a force a hundred thousand times as large presses down from a time on."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, jnp.where(t > 0.04 - 5e-5, -1e5, -1.0)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 1.0, restitution="r")


@pytest.mark.parametrize("way", [hy.simulate, hy.ensemble], ids=lambda way: way.__name__)
def test_a_flight_may_be_low_that_those_before_do_not_lead_one_to_expect(way):
    """The force decides that is there, and not that of the flight before: each flight takes half
    as long as the last."""
    start, options = {"x": 1.0, "v": 0.02}, {"solver": "taylor", "zeno": "ignore"}
    ends = [way(Pressed(), start, (0.0, 1.0), max_jumps=k, **options) for k in range(1, 8)]
    t = [float(end.t1 if way is hy.simulate else end.t[0]) for end in ends]
    flights = np.diff(t)
    assert flights[0] < 1e-5
    # a spacing of the time is 7e-18, the shortest flight 7e-8
    assert flights[1:] / flights[:-1] == pytest.approx(0.5, abs=1e-9)


def test_low_flights_as_plain_python_agree(monkeypatch):
    """No index is below zero."""
    scene = SCENES["soft"]
    run = taylor(scene, zeno="ignore", max_jumps=60)
    monkeypatch.setenv("HYBRID_RULES", "checked")
    monkeypatch.setattr(machine, "unit", Library("hybrid.rules").unit)
    same(run, taylor(scene, zeno="ignore", max_jumps=60), scene[2])


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("name", ["row", "chain"])
def test_jumps_before_any_flow_are_made_in_the_loop(name, solver, monkeypatch):
    """Impacts of bodies that touch, and a reset onto a guard: the driver makes no jump."""
    model, start, span = SCENES[name]
    expected = hy.simulate(model, start, span, solver=solver)
    monkeypatch.setattr(Driver, "jump", None)
    run = hy.simulate(model, start, span, solver=solver)
    assert np.count_nonzero(np.diff(run.jumps.t) == 0.0) >= 2
    assert np.array_equal(run.jumps.t, expected.jumps.t)


def test_balls_that_touch_hand_their_speeds_on():
    """Equal and elastic they swap speeds: the last of three leaves with the first one's."""
    run = taylor(SCENES["row"])
    assert list(run.jumps.edge[:3]) == ["left", "right", "left"]
    assert not run.jumps.t[:3].any()
    after = [run.jumps[2].after[name] for name in "uvw"]
    assert after == pytest.approx([-0.1, 0.7, 2.0], abs=1e-15)  # some roundings of the speeds


@pytest.mark.parametrize("name", ["soft", "hard_spring", "bead_on_table", "bouncing_ball"])
def test_a_whole_run_is_one_call(name, monkeypatch):
    """Flights, the sum, the rest: the loop comes back at the end, and for its tables once."""
    scene = SCENES[name]
    taylor(scene)
    found = calls(monkeypatch)
    run = taylor(scene)
    assert run.zeno
    assert found == [END]


def test_a_table_that_throws_off_is_one_call_for_as_many_sums_as_there_is_room_for(monkeypatch):
    """Sums, rests and releases, again and again."""
    scene = Table(amplitude=0.03, omega=20.0), {"x": 0.2, "v": 0.0}, (0.0, 6.0)
    taylor(scene, rtol=1e-8)
    found = calls(monkeypatch)
    run = taylor(scene, rtol=1e-8)
    assert len(run.zeno) > 10
    assert set(found) == {FULL, END}
    assert len(found) <= 2 + len(run.zeno) // machine.SUMS_KEPT


def draggy(force):
    """A ball that falls onto a floor under gravity and a force."""

    class Draggy(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode(initial=True)
        def flight(self, t, s):
            return s.v, force(t, s) - 9.8

        hit = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.6)

    return Draggy(), {"x": 1.0, "v": 0.0}, (0.0, 3.0)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    "force",
    [lambda t, s: -0.1 * jnp.abs(s.v) * s.v, lambda t, s: jnp.tanh(50.0 * (t - 0.3))],
    ids=["a drag with a corner", "a steep load"],
)
def test_a_sum_that_only_balls_decide_is_passed_in_the_loop(force, solver, monkeypatch):
    """The loop asks for the proof alone: the driver makes no jump, and the run is that of the rules
    one by one."""
    scene, asked, own = draggy(force), [], machine.proves
    with monkeypatch.context() as without:
        without.setattr(Driver, "jump", None)
        without.setattr(machine, "proves", lambda *given: asked.append(1) or own(*given))
        run = hy.simulate(*scene, solver=solver, rtol=1e-11)
    assert asked
    without_loop(monkeypatch)
    expected = hy.simulate(*scene, solver="taylor")
    # errors of a run at 1e-11, over impacts that damp them
    assert run.zeno[0].t == pytest.approx(expected.zeno[0].t, abs=1e-10)
    assert [arc.mode for arc in run.arcs[-1:]] == ["flight.rest(hit)"]
    assert run.zeno[0].verdict == expected.zeno[0].verdict == "certified"


class Fast(hy.Automaton):
    """An oscillator over a wall, in time of a small unit."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def swings(self, t, s):
        return s.v, -1e24 * s.x

    wall = hy.contact(swings, gap=lambda self, t, s: s.x + 0.5, restitution=1.0)


def test_the_loop_goes_on_by_a_lower_order_where_the_higher_has_no_numbers(monkeypatch):
    """After one look at where it stopped."""
    looked, look = [], Driver.look_again
    monkeypatch.setattr(Driver, "look_again", lambda self: looked.append(self.t) or look(self))
    run = hy.simulate(Fast(), {"x": 1.0, "v": 0.0}, (0.0, 100e-12), solver="taylor")
    due = 1e-12 * (2 / 3 + 4 / 3 * np.arange(24)) * np.pi
    assert looked == [0.0]
    assert run.jumps.t == pytest.approx(due, rel=1e-13)  # some hundred roundings, of as many steps


class Corner(hy.Automaton):
    """A puck in a corner, pressed there by a force that turns, and kicked now and then."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    n = hy.state()
    r = hy.parameter(0.5)
    q = hy.parameter(0.4)
    turn = hy.parameter(1.0)
    kick = hy.parameter(0.6)

    @hy.mode(initial=True)
    def slides(self, t, s):
        a, b = 5.0 * jnp.cos(self.turn * t), 5.0 * jnp.sin(self.turn * t + 0.4)
        return s.v, -a - 0.3 * s.v, s.w, -b - 0.3 * s.w, 1.0

    floor = hy.contact(slides, gap=lambda self, t, s: s.x, restitution="r")
    wall = hy.contact(slides, gap=lambda self, t, s: s.y, restitution="q")
    far = hy.contact(slides, gap=lambda self, t, s: 2.0 - s.y, restitution="q")

    @hy.edge(slides, to=slides, guard=lambda self, t, s: s.n - 1.3, crossing=hy.RISING)
    def kicks(self, t, s):
        return s.x, s.v, s.y, s.w + self.kick, 0.0


def together(seed):
    """A scene in which contacts are held, struck and released beside each other, by chance."""
    rng = np.random.default_rng(seed)
    if seed % 2:
        a, b = 0.0 if seed == 5 else rng.uniform(0.1, 0.7), rng.uniform(0.1, 0.6)
        start = {"x": 0.5, "y": 0.5 + rng.uniform(0.1, 0.6), "v": -1.0, "w": rng.uniform(-1, 1)}
        return Pile(a=a, b=b, size=rng.uniform(0.02, 0.1)), start, (0.0, 2.0)
    start = {"x": rng.uniform(0.1, 1), "v": 0.0, "y": rng.uniform(0.1, 1), "w": 0.5, "n": 0.0}
    return Corner(r=rng.uniform(0, 0.7), turn=rng.uniform(0.4, 2.0)), start, (0.0, 6.0)


@pytest.mark.parametrize("options", [{}, {"zeno": "stop"}], ids=str)
@pytest.mark.parametrize("seed", range(8))
def test_contacts_held_at_once_are_those_of_the_rules_one_by_one(seed, options, monkeypatch):
    """Impacts, resets and releases beside contacts at rest, with the loop and without it."""
    scene = together(seed)
    run = taylor(scene, **options)
    assert options or any(".rest(" in arc.mode for arc in run.arcs)
    without_loop(monkeypatch)
    slow = taylor(scene, **options)
    assert run.status is slow.status
    assert list(run.jumps.edge) == list(slow.jumps.edge)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in slow.arcs]
    assert [point.edges for point in run.zeno] == [point.edges for point in slow.zeno]
    # a rounding of a release, by which the load is small, grows along the flight that follows
    close = {"rtol": 0, "atol": 1e-8}
    np.testing.assert_allclose(run.jumps.t, slow.jumps.t, **close)
    np.testing.assert_allclose(run.jumps.table.after, slow.jumps.table.after, **close)
    for arc in run.arcs:  # a body is on what bears it, all along
        field = scene_of(scene[0]).field(arc.mode)
        for name in field.held:
            guard = scene_of(scene[0]).field(field.mode)
            guard = guard.guards[guard.column(name)]
            ends = (arc.t0, arc.first), (arc.t1, arc.last)
            assert max(abs(guard.value(t, x.tolist())) for t, x in ends) < 1e-14


@pytest.mark.parametrize("seed", range(4))
def test_the_driver_judges_no_impact_beside_contacts_held(seed, monkeypatch):
    """Nor a reset there, nor which contacts stay held, join those or leave them."""
    scene, known = together(2 * seed), Driver.jump
    seen = []

    def jump(self, guard, *rest):
        seen.append((guard.edge, self.entry.field.held))
        return known(self, guard, *rest)

    monkeypatch.setattr(Driver, "jump", jump)
    run = taylor(scene)
    assert sum(bool(arc.mode.partition(".")[2]) for arc in run.arcs) > 3
    assert not any(held for _, held in seen)


class Row(hy.Automaton):
    """Particles in a row, of which each has its restitution with the one before it."""

    x = hy.state(shape=(8,))
    v = hy.state(shape=(8,))
    r = hy.parameter(0.5)

    @hy.mode
    def free(self, t, s):
        return s.v, jnp.zeros(8)

    for i in range(1, 8):
        vars()[f"c{i}"] = hy.contact(
            free, gap=lambda self, t, s, i=i: s.x[i] - s.x[i - 1], restitution="r"
        )
    del i


def thrown(r):
    """The first is thrown at the others, which touch and are at rest."""
    start = {"x": np.array([-1.0] + [0.0] * 7), "v": np.array([1.0] + [0.0] * 7)}
    return Row(r=r), start, (0.0, 2.0)


@pytest.mark.parametrize("r", [0.5, 0.6, 0.9])
def test_impacts_at_one_instant_beside_contacts_held_are_those_of_the_rules(r, monkeypatch):
    """Bodies that touch and stay together bear nothing: no load of theirs is to be weighed."""
    known, judged = Driver.jump, []

    def jump(self, guard, *rest):
        judged.append((self.t, guard.edge))
        return known(self, guard, *rest)

    monkeypatch.setattr(Driver, "jump", jump)
    run = taylor(thrown(r))
    assert len(run.jumps) > 20
    assert len(judged) <= 1  # the first impact, at the end of an arc in which loads stay zero
    without_loop(monkeypatch)
    slow = taylor(thrown(r))
    assert len(judged) > 20
    assert list(run.jumps.edge) == list(slow.jumps.edge)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in slow.arcs]
    np.testing.assert_array_equal(run.jumps.table.after, slow.jumps.table.after)


def test_a_run_from_rest_is_flown_by_the_loop(monkeypatch):
    """What holds a body where the run starts is found there, as by the rules."""
    looked, look = [], Driver.look_again
    monkeypatch.setattr(Driver, "look_again", lambda self: looked.append(self.t) or look(self))
    scene = Table(amplitude=0.2, omega=10.0), {"x": 0.0, "v": 2.0}, (0.0, 3.0)
    run = taylor(scene)
    assert run.arcs[0].mode == "flight.rest(impact)"
    assert not looked
    without_loop(monkeypatch)
    slow = taylor(scene)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in slow.arcs]
    np.testing.assert_array_equal(run.arcs[0].first, slow.arcs[0].first)
    np.testing.assert_allclose(run.jumps.t, slow.jumps.t, rtol=0, atol=ROUNDING)


def cornered():
    """A class of its own of a body between a wall and a floor that move."""

    class Cornered(hy.Automaton):
        x, y, u, v = hy.state(), hy.state(), hy.state(), hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.u, s.v, -3.0 + 0.5 * jnp.sin(t), -9.8 - 0.3 * s.x

        wall = hy.contact(
            flight,
            gap=lambda self, t, s: s.x - 0.0731607202714988 * jnp.sin(t) - 0.05 * s.y,
            restitution=0.38855995986689573,
        )
        floor = hy.contact(
            flight,
            gap=lambda self, t, s: s.y - 0.07316 * jnp.sin(5.954515671459639 * t) - 0.1 * s.x,
            restitution=0.5198473814173438,
        )

    return Cornered


@pytest.mark.parametrize("speed", [-0.42, -0.2, 0.1, 0.5])
def test_the_first_run_of_a_class_is_as_any_other(speed):
    """Though it asks for what is not in the tables yet, in the middle of its jumps."""
    model, start = cornered()(), {"x": 0.66, "y": 0.64, "u": 0.59, "v": speed}
    first, other = (hy.simulate(model, start, (0.0, 4.0), solver="taylor") for _ in range(2))
    assert first.jumps.t.tolist() == other.jumps.t.tolist()
    assert first.final == other.final
