"""From window to window of the past in the rules' own loop: the run of the driver's rules."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.delay import memory, pieces
from hybrid.rules.load import Library
from hybrid.rules.places import END, PAST_FLOATS, PAST_INTS
from hybrid.rules.windows import MOST_READS, stuck
from hybrid.run import lookback, machine
from models.delay_bounce import DelayBounce
from models.delay_jump import DelayJump
from models.pyragas import Pyragas

from .contract.ways import later
from .delayed import Ball, Kicked, Lagged, Relay
from .systems import without_loop
from .test_advance import same


class Room(hy.Automaton):
    """Two modes, two lags, and guards that see the past."""

    T = hy.state()
    water = hy.state()

    @hy.mode(initial=True)
    def on(self, t, s, past):
        return past(0.25).water - s.T - 15.0, 4.0 * (70.0 - s.water)

    @hy.mode
    def off(self, t, s, past):
        return past(0.25).water - s.T - 15.0, 4.0 * (15.0 - s.water)

    @hy.edge(on, to="off", guard=lambda self, t, s, past: 22.0 - past(0.1).T)
    def too_hot(self, t, s):
        return s

    @hy.edge(off, to=on, guard=lambda self, t, s, past: past(0.1).T - 18.0)
    def too_cold(self, t, s):
        return s


class Lean(hy.Automaton):
    """A ball over a floor that is where ``z`` was a while ago."""

    y = hy.state()
    v = hy.state()
    z = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, -1.0, 0.2 * jnp.cos(t)

    ground = hy.contact(flight, gap=lambda self, t, s, past: s.y - past(0.7).z, restitution=0.5)


class Drawn(hy.Automaton):
    """A mass whose spring pulls late, and the later the further out it is; it bounces at 0."""

    y = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        late = past(0.3 * s.y**2 / (1.0 + s.y**2))
        return s.v, -late.y - 0.1 * late.v

    @hy.edge(flow, to=flow, guard=lambda self, t, s: s.y)
    def back(self, t, s):
        return s.replace(v=-0.9 * s.v)

    @hy.edge(flow, to=flow, guard=lambda self, t, s: s.v, crossing=hy.EITHER)
    def turns(self, t, s):
        return s.replace(y=s.y + 0.01)


class Swaying(hy.Automaton):
    """``y' = -y(t - 1.6 + 1.5 sin 2t)``, which looks back over its past again and again."""

    y = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return -past(1.6 - 1.5 * jnp.sin(2.0 * t)).y

    @hy.edge(flow, to=flow, guard=lambda self, t, s: t - 1.0, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.replace(y=s.y + 1.0)


SCENES = {
    "pyragas": (Pyragas(), {"x1": 3.0, "x2": 0.0}, (0.0, 6.0), {}),
    "released": (Pyragas(C=60.0, r=0.2), {"x1": 2.5, "x2": 0.0}, (0.0, 6.0), {}),
    "restarted": (Pyragas(), {"x1": 3.0, "x2": 0.0}, (0.0, 6.0), {"memory": "restart"}),
    "chatters": (Pyragas(), {"x1": 2.1, "x2": 0.0}, (0.0, 2.0), {"memory": "restart"}),
    "bounce": (DelayBounce(), {"y": 0.05, "v": 0.0}, (0.0, 4.0), {"history": {"y": 0.0, "v": 0.0}}),
    "jump": (DelayJump(), {"y": 1.0}, (0.0, 3.0), {}),
    "room": (Room(), {"T": 15.0, "water": 15.0}, (0.0, 5.0), {}),
    "function": (Pyragas(), {"x1": 3.0, "x2": 0.0}, (0.0, 3.0), {"history": {"x1": jnp.cosh}}),
    "relay": (Relay(), {"y": 0.3}, (0.0, 4.0), {}),
    "short": (Lagged(tau=1e-2), {"y": 1.0}, (0.0, 4.0), {}),
    "drawn": (Drawn(), {"y": 1.0, "v": 0.0}, (0.0, 6.0), {}),
    "drawn anew": (Drawn(), {"y": 1.0, "v": 0.0}, (0.0, 6.0), {"memory": "restart"}),
    "swaying": (Swaying(), {"y": 1.0}, (0.0, 6.0), {}),
    "no lag": (Kicked(tau=0.0), {"y": 1.0}, (0.0, 4.0), {}),
    "hops": (Ball(g=1.0, k=-0.5, tau=1e-2, r=0.6), {"y": 1.0, "v": 0.0}, (0.0, 7.0), {}),
}

#: What is seen of the record may differ from it by a tenth of the tolerance (``SHARE``), and is
#: another record where steps are others; times of impacts move with it, the late ones most.
TOLERANCE = 1e-8


@pytest.fixture(params=SCENES)
def scene(request):
    return SCENES[request.param]


def flown(scene, **more):
    model, start, span, options = scene
    return hy.simulate(model, start, span, solver="taylor", **options, **{"rtol": 1e-11, **more})


def alike(run, other, t0, t1):
    """Jumps and accumulations, and what is between them."""
    assert list(run.jumps.edge)[:20] == list(other.jumps.edge)[:20]
    np.testing.assert_allclose(run.jumps.t[:20], other.jumps.t[:20], rtol=0, atol=TOLERANCE)
    assert [point.t for point in run.zeno] == pytest.approx(
        [point.t for point in other.zeno], abs=TOLERANCE
    )
    assert [arc.mode for arc in run.arcs][-1] == [arc.mode for arc in other.arcs][-1]
    at = np.random.default_rng(0).uniform(t0, t1, 200)
    events = np.array([*other.jumps.t, *(point.t for point in other.zeno), np.inf])
    at = at[[np.abs(events - t).min() > 1e-4 for t in at]]
    x, y = (np.stack([np.ravel(v) for v in each(at)]) for each in (run, other))
    np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-6)


def test_the_loop_gives_the_run_of_the_rules_one_by_one(scene, monkeypatch):
    """With the loop and without it."""
    run = flown(scene)
    without_loop(monkeypatch)
    alike(run, flown(scene), *scene[2])


def test_little_room_changes_nothing(scene, monkeypatch):
    """In arrays of one jump, two steps and few pieces the record is the same: what is seen, jumps
    and dense output, but for where steps end."""
    run = flown(scene)
    for module, name, size in (
        (machine, "JUMPS_KEPT", 1),
        (machine, "STEPS_KEPT", 2),
        (machine, "ROOM_GROWTH", 1),
        (machine, "SUMS_KEPT", 1),
        (pieces, "FIRST_ROOM", 2),
    ):
        monkeypatch.setattr(module, name, size)
    other = flown(scene)
    same(run, other, scene[2])
    alike(run, other, *scene[2])


@pytest.mark.parametrize("name", ["room", "no lag", *later("released", "hops", "drawn")])
def test_machine_code_and_python_agree(name, monkeypatch):
    """As plain Python that refuses indices below zero."""
    run = flown(SCENES[name])
    monkeypatch.setenv("HYBRID_RULES", "checked")
    for module in (machine, lookback, memory):
        monkeypatch.setattr(module, "unit", Library("hybrid.rules").unit)
    alike(run, flown(SCENES[name]), *SCENES[name][2])


@pytest.mark.parametrize("name", ["pyragas", "room", "short", "swaying", "no lag"])
def test_a_run_is_one_call(name, monkeypatch):
    """From its start to its end, through all windows, sums, rests and releases."""
    flown(SCENES[name])
    found, known = [], lookback.unit

    def unit(which):
        rules = known(which)

        def look_back(*arguments):
            found.append(rules.look_back(*arguments))
            return found[-1]

        return rules if which != "past" else SimpleNamespace(bound=rules.bound, look_back=look_back)

    monkeypatch.setattr(lookback, "unit", unit)
    flown(SCENES[name])
    assert found == [END]


def test_what_a_short_lag_sees_is_guessed_far_ahead():
    """Twenty thousand lags in a hundred steps; nothing happens that would make them shorter.

    y' = -y(t - lag) is solved by an exponential once the start is forgotten."""
    lag = 1e-3
    run = hy.simulate(Lagged(tau=lag), {"y": 1.0}, (0, 20), solver="taylor", rtol=1e-9, atol=1e-12)
    assert run.stats.steps < 200
    rate = 1.0
    for _ in range(50):
        rate = np.exp(rate * lag)  # contracts by a thousandth each time
    at = np.array([5.0, 10.0])
    assert np.log(run(at[0]).y / run(at[1]).y) / 5.0 == pytest.approx(rate, rel=1e-6)


@pytest.mark.each_method
def test_dense_output_at_rest_on_what_the_past_moves(solver):
    """It is that of its own time, not put where the last window shows the floor."""
    history = {"z": lambda t: 0.2 * jnp.sin(t)}
    start = {"y": 1.0, "v": 0.0, "z": 0.0}
    run = hy.simulate(Lean(), start, (0.0, 7.0), history=history, rtol=1e-9, **solver)
    at = np.linspace(run.zeno[0].t + 0.01, 7.0, 50)
    np.testing.assert_allclose(run(at).y, 0.2 * np.sin(at - 0.7), rtol=0, atol=1e-6)


def test_windows_from_one_time_come_to_an_end():
    """Windows are read from one time no more than a thousand times in a row, unless it jumps."""
    past = SimpleNamespace(ints=np.zeros(PAST_INTS, dtype=int), floats=np.zeros(PAST_FLOATS))
    assert not any(stuck(1.0, past) for _ in range(MOST_READS + 1))
    assert stuck(1.0, past)
    assert not stuck(2.0, past)
