"""Ensembles: each lane is what a run of its own would be."""

import logging
import signal
import threading
import time

import jax
import numpy as np
import pytest

import hybrid as hy
from hybrid.ensembles import runs, threads
from hybrid.lowering.jit import jit
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring

from . import systems
from .contract.ways import spread
from .lanes import NAMES, differences, events_apart

TIGHT = {"rtol": 1e-11, "atol": 1e-12}


def alone(model, start, t, **options):
    """A run of one lane by the solver that is accurate to rounding."""
    return hy.simulate(model, start, t, solver="taylor", **options)


def test_lanes_reach_the_closed_form():
    """Balls of all restitutions: t_inf to 1e-12, and at rest on the floor afterwards."""
    r = np.linspace(0.3, 0.95, 300)
    exact = np.sqrt(2 / 9.81) * (1 + r) / (1 - r)
    lanes = hy.ensemble(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 30), {"r": r}, **TIGHT)
    np.testing.assert_allclose(lanes.t_inf, exact, rtol=1e-12)
    assert np.all(lanes.x == 0.0)
    assert set(lanes["mode"].values) == {"flight.rest(impact)"}
    assert set(lanes.verdict.values) == {"estimated"}


def test_lanes_are_runs_of_their_own():
    """A hard spring with starts and restitutions drawn at random: against single runs."""
    rng = np.random.default_rng(3)
    x, r = rng.uniform(2.05, 2.45, 40), rng.uniform(0.5, 0.95, 40)
    lanes = hy.ensemble(HardSpring(), {"x": x, "v": 0.0}, (0, 1.0), {"r": r}, **TIGHT)
    for i in range(0, 40, 5):
        run = alone(HardSpring(r=r[i]), {"x": x[i], "v": 0.0}, (0, 1.0))
        assert lanes["mode"].values[i] == run.mode
        assert float(lanes.x[i]) == pytest.approx(run.final.x, abs=1e-9)
        assert np.isnan(lanes.t_inf[i]) == (not run.zeno)
        if run.zeno:
            assert float(lanes.t_inf[i]) == pytest.approx(run.zeno[0].t, abs=1e-10)


def test_lanes_of_mixed_fate():
    """Tables of different frequency: rest, release, another series; each lane its own."""
    omega = np.array([0.5, 3.5, 4.0, 4.5, 6.0])
    model, start = BeadOnTable(r=0.3), {"x": 1.5, "v": 0.0}
    lanes = hy.ensemble(model, start, (0, 6.8), {"omega": omega}, **TIGHT)
    for i, w in enumerate(omega):
        run = alone(BeadOnTable(r=0.3, omega=w), start, (0, 6.8))
        assert (lanes["mode"].values[i], int(lanes.accumulations[i])) == (run.mode, len(run.zeno))
        assert float(lanes.x[i]) == pytest.approx(run.final.x, abs=1e-7)


def test_arrays_as_states():
    """Balls on a circle: some chatter, slide and leave, some bounce off."""
    q = np.stack([np.linspace(0.05, 0.4, 12), np.full(12, 1.2)], axis=1)
    lanes = hy.ensemble(BallOnCircle(), {"q": q, "p": [0.0, 0.0]}, (0, 4), **TIGHT)
    for i in range(12):
        run = alone(BallOnCircle(), {"q": q[i], "p": [0, 0]}, (0, 4))
        np.testing.assert_allclose(lanes.q[i], run.final.q, atol=1e-7)
        assert int(lanes.accumulations[i]) == len(run.zeno)


def test_modes_and_edges():
    """Thermostats from many starts: the exponentials give every temperature."""
    T = np.linspace(18.5, 21.5, 7)
    lanes = hy.ensemble(systems.Thermostat(), {"T": T}, (0, 2.0), **TIGHT)
    for i, start in enumerate(T):
        run = alone(systems.Thermostat(), {"T": start}, (0, 2.0))
        assert lanes["mode"].values[i] == run.mode
        assert float(lanes["T"][i]) == pytest.approx(run.final.T, abs=1e-9)
        assert int(lanes.jumps[i]) == len(run.jumps)


def test_two_contacts_of_one_mode():
    """Into the corner; both contacts fire at t = 1."""
    lanes = hy.ensemble(systems.Corner(), [1.0, 1.0, -1.0, -1.0], (0, 2))
    assert [float(lanes.u[0]), float(lanes.w[0])] == pytest.approx([0.5, 0.5], abs=1e-14)
    assert int(lanes.jumps[0]) == 2


def test_a_long_lane_does_not_hold_up_the_others():
    """One makes three hundred impacts; results are in order."""
    r = np.full(40, 0.5)
    r[7] = 0.99
    lanes = hy.ensemble(
        BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 100), {"r": r}, zeno="ignore", max_jumps=300
    )
    ended = lanes.status.values == "max_jumps"
    assert ended[7]
    first = np.sqrt(2 / 9.81)
    flight = 2 * 0.99 * np.sqrt(2 * 9.81) / 9.81
    assert float(lanes.t[7]) == pytest.approx(
        first + flight * (1 - 0.99**299) / (1 - 0.99), abs=1e-6
    )
    assert np.unique(lanes.x.values[np.arange(40) != 7]).size == 1


def test_a_failed_lane_is_a_row_with_its_reason():
    """Outside the domain; too many steps; the others go on."""
    x = np.array([1.0, -1.0, 1.0])
    lanes = hy.ensemble(BouncingBall(), {"x": x, "v": 0.0}, (0, 3))
    assert lanes.status.values.tolist() == ["reached_end", "outside", "reached_end"]
    assert "guard of impact is -1 and must be positive" in str(lanes.reason.values[1])
    short = hy.ensemble(BouncingBall(), {"x": x, "v": 0.0}, (0, 3), max_steps=1)
    assert short.status.values.tolist() == ["max_steps", "outside", "max_steps"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"parameters": {"e": [0.5]}}, "BouncingBall: parameters: it has no 'e'; there are: g, r"),
        ({"parameters": {"r": [0.5, 1.5]}}, r"BouncingBall.r = .*1.5.*\[0, 1\]"),
        ({"parameters": {"r": [0.5, 0.6], "g": [9.0, 9.1, 9.2]}}, "lanes differ in number"),
        ({"zeno": "often"}, "'rest', 'stop', 'truncate', 'raise', 'ignore'"),
        ({"solver": "euler"}, "solver='euler': there are"),
        ({"solver": "diffrax", "method": "Euler"}, "solver 'diffrax' has"),
        ({"memory": "lose"}, "memory='lose'"),
        ({"max_steps": 0}, "max_steps=0: a whole number, 1 or more"),
        ({"mode": "air"}, r"mode='air'; there are flight, flight.rest\(impact\)"),
        ({"start": {"x": 1.0}}, "no value for v"),
        ({"start": {"x": [[1.0]], "v": 0.0}}, r"x_start has shape \(1, 1\)"),
        ({"max_jumps": 0}, "max_jumps=0: a whole number, 1 or more"),
        ({"t": (0.0, [3.0, 0.0])}, r"BouncingBall, lane 1: t=\(0.0, 0.0\): give the first time"),
    ],
)
def test_what_cannot_be_asked(given, message):
    """Each error names what was given and what would do."""
    asked = {"start": {"x": 1.0, "v": 0.0}, "t": (0, 3), **given}
    with pytest.raises(hy.HybridError, match=message):
        hy.ensemble(BouncingBall(), **asked)


def compilations(run):
    """What JAX compiles in a run."""
    seen, handler = [], logging.Handler()
    handler.emit = lambda record: seen.append(record.getMessage())
    logging.getLogger("jax").addHandler(handler)
    try:
        with jax.log_compiles(True):
            run()
    finally:
        logging.getLogger("jax").removeHandler(handler)
    return [line for line in seen if line.startswith("Compiling")]


def test_simulate_does_not_compile_anew_either():
    """A second model of the class, another start, other times and tolerances."""
    options = {"solver": "diffrax", "method": "Tsit5"}
    hy.simulate(HardSpring(r=0.8), {"x": 2.1, "v": 0.0}, (0, 2), **options)
    other = {"start": [2.2, 0.1], "t": (1.0, 4.0), "rtol": 1e-7, "atol": 1e-9, **options}
    assert compilations(lambda: hy.simulate(HardSpring(r=0.7), **other)) == []


def test_the_compile_watch_sees_compilation():
    """The tests above can fail."""
    assert compilations(lambda: jit(lambda x: x * 3.25)(1.0))


def test_a_ceiling_that_dips_into_the_tail():
    """Other contacts' gaps are watched along the flights that are summed."""
    c = np.array([0.8, 1.2, 1.4, 1.5])
    lanes = hy.ensemble(systems.DippingCeiling(), {"x": 0.1, "v": 0.0}, (0, 6), {"c": c}, **TIGHT)
    for i, value in enumerate(c):
        run = alone(systems.DippingCeiling(c=value), {"x": 0.1, "v": 0.0}, (0, 6))
        assert float(lanes.t_inf[i]) == pytest.approx(run.zeno[0].t, abs=1e-8)


def test_a_large_state_hides_no_guard_of_others():
    """A guard's tolerance is that of the states it is made of."""
    lanes = hy.ensemble(systems.Metered(), {"T": 20.0, "E": 1e9}, (0, 10))
    run = alone(systems.Metered(), {"T": 20.0, "E": 1e9}, (0, 10))
    assert int(lanes.jumps[0]) == len(run.jumps) == 25
    assert float(lanes["T"][0]) == pytest.approx(run.final.T, abs=1e-6)


def test_far_from_the_origin_of_time():
    """At t = 1e6 a float's spacing moves the table by more than the smallest gaps."""
    t0 = np.array([0.0, 1e5, 1e6])
    model = BeadOnTable(r=0.1, amplitude=0.02, omega=25.0)
    lanes = hy.ensemble(model, {"x": 0.1, "v": 0.0}, (t0, t0 + 3), max_steps=5000)
    assert set(lanes.status.values) == {"reached_end"}
    assert np.all(lanes.accumulations > 5)


def test_any_solver_gives_the_same():
    """Beads that rest, are thrown off, and are cut off: to the tolerances."""
    omega, start = np.array([0.5, 3.5, 4.0, 4.5, 6.0]), {"x": 1.5, "v": 0.0}
    for max_jumps in (None, 7):
        options = {**TIGHT, "max_jumps": max_jumps}
        one, *others = (
            hy.ensemble(BeadOnTable(r=0.3), start, (0, 6.8), {"omega": omega}, **options, **way)
            for way in ({}, {"solver": "scipy"}, {"solver": "diffrax", "method": "Tsit5"})
        )
        for lanes in others:
            for name in ("mode", "status", "accumulations"):
                assert lanes[name].values.tolist() == one[name].values.tolist()
            np.testing.assert_allclose(lanes.t_inf, one.t_inf, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_a_lane_equals_its_run_to_the_last_bit(name):
    """Time, state, jumps, accumulation, status and reason, of random lanes."""
    assert not list(differences(name, 10 if name == "delay_bounce" else 60))


@pytest.mark.parametrize("name", NAMES)
def test_the_events_of_a_lane_are_those_of_its_run(name):
    """Which edges jump, when, from which state to which."""
    assert not list(events_apart(name, 4 if name == "delay_bounce" else 25))


ASKED = [
    *({"zeno": "stop"}, {"zeno": "truncate"}, {"zeno": "raise"}, {"max_jumps": 3}),
    *({"zeno": "ignore", "max_jumps": 25}, {"rtol": 1e-9}, {"certify": True}),
]


@pytest.mark.parametrize(("name", "options"), spread(NAMES[:4], ASKED), ids=str)
def test_a_lane_equals_its_run_whatever_is_asked(name, options):
    """The options of a run are those of a lane; certified lanes have the verdict of their run."""
    assert not list(differences(name, 12, seed=1, **options))


def test_sums_that_begin_with_long_flights_need_no_driver(monkeypatch):
    """The third rate of a smooth force is what it is at points, in parts of a flight that are
    small enough."""
    monkeypatch.setattr(runs._Runs, "others", lambda *_: iter(()))
    x = [2.2193, 2.3654, 2.3501, 2.4496, 2.4435, 2.3158]
    r = [0.8491, 0.9264, 0.9102, 0.9387, 0.9425, 0.9439]
    start, tolerances = {"x": x, "v": 0.0}, {"rtol": 1e-9, "atol": 1e-9}
    lanes = hy.ensemble(HardSpring(), start, (0, 3), {"r": r}, **tolerances)
    assert set(lanes.status.values) == {"reached_end"}


def test_lanes_that_need_no_judgement_need_no_driver(monkeypatch):
    """Impacts before any sum, and flights to the end: machine code alone, on every thread."""
    monkeypatch.setattr(runs._Runs, "others", lambda *_: iter(()))
    x = np.linspace(1.2, 2.5, 700)
    lanes = hy.ensemble(BouncingBall(), {"x": x, "v": 0.0}, (0, 9), zeno="ignore", max_jumps=5)
    fall = np.sqrt(2 * x / 9.81)
    exact = fall * (1 + 2 * sum(0.7**k for k in range(1, 5)))
    np.testing.assert_allclose(lanes.t, exact, rtol=1e-14)
    assert set(lanes.status.values) == {"max_jumps"}
    ended = hy.ensemble(BouncingBall(), {"x": x, "v": 0.0}, (0, 0.1))
    np.testing.assert_allclose(ended.x, x - 0.5 * 9.81 * 0.01, rtol=1e-15)


@pytest.mark.parametrize(
    ("model", "start", "until"),
    [
        (BeadOnTable(r=0.8, omega=7.0), {"x": 1.5 + 0.1 * np.arange(5), "v": 0.0}, 300.0),
        (systems.Thermostat(), {"T": np.linspace(18.5, 21.5, 5)}, 60.0),
        (systems.PutBack(), {"y": 1.0 + 0.1 * np.arange(5), "v": 0.0}, 9.0),
    ],
    ids=["impacts", "cycles that do not shrink", "a reset onto its guard"],
)
def test_many_jumps_need_no_driver(monkeypatch, model, start, until):
    """Where nothing can accumulate, as one contact's impacts are summed, or turns are as long as
    those before; and after a reset that says that its guard is zero. Lanes equal their runs."""
    monkeypatch.setattr(runs._Runs, "others", lambda *_: iter(()))
    lanes = hy.ensemble(model, start, (0.0, until))
    first = next(iter(start))
    assert set(lanes.status.values) == {"reached_end"}
    assert lanes.jumps.min() > 24  # the driver looks for the first time at the 24th
    for i, value in enumerate(start[first]):
        run = alone(model, {**start, first: value}, (0.0, until), save="jumps")
        assert int(lanes.jumps[i]) == len(run.jumps)
        assert [float(lanes[name][i]) for name in model.spec.names] == list(run.final)


@pytest.mark.parametrize(("block", "count"), [(1, 3), (7, 1), (1000, 2)])
def test_lanes_do_not_depend_on_blocks_or_threads(monkeypatch, block, count):
    """To the last bit."""
    r, start, t = np.linspace(0.1, 0.9, 50), {"x": 1.5, "v": 0.0}, (0.0, 4.0)
    usual = hy.ensemble(BeadOnTable(omega=3.0), start, t, {"r": r})
    monkeypatch.setattr(threads, "BLOCK_LANES", block)
    monkeypatch.setattr(threads, "cores", lambda: count)
    assert usual.identical(hy.ensemble(BeadOnTable(omega=3.0), start, t, {"r": r}))


def test_lanes_do_not_depend_on_their_neighbours():
    """Alone, in another order, and among others: to the last bit."""
    r = np.linspace(0.3, 0.9, 7)
    start, t = {"x": 1.5, "v": 0.0}, (0.0, 9.0)
    lanes = hy.ensemble(BeadOnTable(omega=3.0), start, t, {"r": r})
    back = hy.ensemble(BeadOnTable(omega=3.0), start, t, {"r": r[::-1]})
    for name in ("t", "x", "v", "t_inf", "jumps", "steps"):
        np.testing.assert_array_equal(lanes[name], back[name].values[::-1])
    for i, value in enumerate(r):
        one = hy.ensemble(BeadOnTable(omega=3.0, r=value), start, t)
        assert float(one.x[0]) == float(lanes.x[i])


def test_lags_of_every_kind():
    """Lanes with a lag that depends on the state, and with an earlier run as their history."""

    class Moving(hy.Automaton):
        y = hy.state()
        k: float = hy.parameter(0.1)

        @hy.mode(initial=True)
        def only(self, t, s, past):
            return -past(1.0 + self.k * s.y**2).y

    k, until = np.array([0.0, 0.1, 0.3]), (0.0, 3.0)
    lanes = hy.ensemble(Moving(), {"y": 1.0}, until, {"k": k})
    for i, value in enumerate(k):
        first = hy.simulate(Moving(k=value), {"y": 1.0}, until)
        assert float(lanes.y[i]) == first.final.y
    on = hy.ensemble(Moving(), {"y": first.final.y}, (3.0, 4.0), {"k": k[2:]}, history=first)
    then = hy.simulate(Moving(k=k[2]), {"y": first.final.y}, (3.0, 4.0), history=first)
    assert float(on.y[0]) == then.final.y


def test_an_option_that_some_lanes_cannot_use_is_their_reason():
    """Of a step that is too long for times far out; if no lane can use it, it is an error."""
    t0 = np.array([0.0, 1e9])
    asked = {"start": {"x": 1.0, "v": 0.0}, "max_step": 1e-8}
    lanes = hy.ensemble(BouncingBall(), t=(t0, t0 + 1e-6), **asked)
    assert lanes.status.values.tolist() == ["reached_end", "refused"]
    assert "apart; give a longer one" in str(lanes.reason.values[1])
    with pytest.raises(hy.OptionError, match="apart; give a longer one"):
        hy.ensemble(BouncingBall(), t=(t0[1:], t0[1:] + 1e-6), **asked)


def test_progress_is_told():
    """The number of lanes that have ended, up to all of them."""
    told = []
    hy.ensemble(BouncingBall(), {"x": np.ones(5), "v": 0.0}, (0, 3), progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 5


def test_the_keyboard_ends_an_ensemble(keyboard):
    """Promptly, in the midst of a lane or between two.

    Pressed once; again after two seconds, as Python loses an interrupt that arrives while a library
    is told of a collection of garbage.
    """
    x = np.linspace(1.0, 2.0, 100_000)
    hy.ensemble(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3))
    main, ended = threading.main_thread().ident, threading.Event()

    def press():
        while not ended.wait(0.5 if time.monotonic() - begun < 0.5 else 2.0):
            signal.pthread_kill(main, signal.SIGINT)

    begun = time.monotonic()
    presses = threading.Thread(target=press)
    presses.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            hy.ensemble(BouncingBall(), {"x": x, "v": 0.0}, (0, 3))
    finally:
        ended.set()
        presses.join()
    assert time.monotonic() - begun < 5.0  # 100,000 lanes would take minutes


@pytest.mark.long
def test_stacked_beads_come_to_rest():
    """Two contacts that close together, again and again: both are at rest when they should be."""
    random, count = np.random.default_rng(5), 16
    a, b = random.uniform(0.0, 0.9, (2, count))
    y, v, w = random.uniform(1.001, 1.4, count), *random.uniform(-2.0, 2.0, (2, count))
    start, numbers = {"x": 1.0, "y": y, "v": v, "w": w}, {"a": a, "b": b}
    exact = np.array([systems.stacked(*case) for case in zip(a, b, y / y, y, v, w, strict=True)])

    def modes(ends):
        lanes = hy.ensemble(systems.Stacked(), start, (0.0, ends), numbers, rtol=1e-10, atol=1e-12)
        return set(lanes["mode"].values)

    assert modes(exact + 1e-6) == {"falls.rest(floor, between)"}
    assert modes(exact - 1e-6) <= {"falls", "falls.rest(floor)"}


@pytest.mark.long
def test_a_pile_on_a_shaking_table():
    """Two beads thrown up together, in contact, and at rest again: as runs of their own."""
    columns = dict(zip(("a", "b", "size", "omega", "y"), np.array(systems.PILES).T, strict=True))
    start, until = {"x": 1.0, "y": columns.pop("y"), "v": 0.0, "w": 0.0}, (0.0, 5.0)
    lanes = hy.ensemble(systems.Pile(), start, until, columns, rtol=1e-11, atol=1e-12)
    for i, (a, b, size, omega, y) in enumerate(systems.PILES):
        model = systems.Pile(a=a, b=b, size=size, omega=omega)
        run = hy.simulate(model, {**start, "y": y}, until, solver="taylor")
        assert lanes["mode"].values[i] == run.mode
        assert float(lanes.x[i]) == pytest.approx(run.final.x, abs=1e-6)
        assert float(lanes.y[i]) == pytest.approx(run.final.y, abs=1e-6)
