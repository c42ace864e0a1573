"""Edges that fire at given times: exactly then, with every solver, beside guards and sums."""

import pickle

import attrs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.functions.function import REASONS

from .contract.ways import WAYS
from .systems import Shelf, without_loop

SOLVERS = ["taylor", "scipy", "diffrax"]

#: One of each mechanism.
SOME = ["DOP853", "Radau", "taylor", "Tsit5", "ensemble", "as_function"]

ways = pytest.mark.parametrize("way", [WAYS[name] for name in SOME], ids=SOME)

#: The tolerance of SciPy's and Diffrax's runs is 1e-8 a step, of some tens; Taylor's is rounding.
CLOSE = {"taylor": 1e-13, "scipy": 1e-6, "diffrax": 1e-6}


class Sampled(hy.Automaton):
    """A decay that is held against by what it was when it was sampled last."""

    x = hy.state()
    u = hy.state()
    period = hy.parameter(0.1)
    offset = hy.parameter(0.0)
    gain = hy.parameter(0.5)

    @hy.mode(initial=True)
    def flow(self, t, s):
        return s.u - s.x, 0.0

    @hy.edge(flow, every="period", offset="offset")
    def sample(self, t, s):
        return s.x, -self.gain * s.x


class Relay(hy.Automaton):
    """Counts with two clocks that ring at the same times, one in each of two modes."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0, 0.0

    @hy.mode
    def down(self, t, s):
        return -1.0, 0.0

    @hy.edge(up, to=down, at=(1.0, 2.0, 3.0))
    def turn(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(down, to=up, at=(2.0, 2.5))
    def back(self, t, s):
        return s.replace(n=10.0 * s.n)


def marked(first):
    """A point that reaches its mark when a clock rings; the guard declared first, or last."""

    class Tied(hy.Automaton):
        x = hy.state()
        n = hy.state()
        speed = hy.parameter(0.3)

        @hy.mode(initial=True)
        def fly(self, t, s):
            return self.speed, 0.0

        @hy.mode
        def beyond(self, t, s):
            return self.speed, 0.0

        guard = {"to": beyond, "guard": lambda self, t, s: 0.3 * 0.7 - s.x}
        times = {"to": fly, "every": 0.7}

        @hy.edge(fly, **(guard if first else times))
        def one(self, t, s):
            return s.replace(n=2.0 * s.n + 1.0)

        @hy.edge(fly, **(times if first else guard))
        def other(self, t, s):
            return s.replace(n=3.0 * s.n)

    return Tied


class Kicked(hy.Automaton):
    """A ball that comes to rest, and is thrown up again at given times."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -1.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")

    @hy.edge(flight, at=(2.25, 10.0, 20.0))
    def kick(self, t, s):
        return s.replace(v=s.v + 1.0)


def sampled(x, periods, gain=0.5, period=0.1):
    """The state after so many samples, of a decay that begins with nothing held against it."""
    u = 0.0
    for _ in range(periods):
        x = u + (x - u) * np.exp(-period)
        u = -gain * x
    return x, u


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_clock_rings_at_the_multiples_of_its_period(solver):
    run = hy.simulate(Sampled(), {"x": 1.0, "u": 0.0}, (0.0, 1.0), solver=solver)
    assert run.jumps.t.tolist() == [k * 0.1 for k in range(1, 11)]  # products, to the last bit
    assert not run.zeno
    assert tuple(run.final) == pytest.approx(sampled(1.0, 10), abs=CLOSE[solver])
    middle = sampled(1.0, 3)
    held = middle[1] + (middle[0] - middle[1]) * np.exp(-0.05)
    assert run(0.35).x == pytest.approx(held, abs=CLOSE[solver])


@pytest.mark.parametrize("method", ["RK45", "Radau", "BDF", "LSODA"])
def test_a_clock_may_ring_at_the_last_time(method):
    run = hy.simulate(Sampled(), {"x": 1.0, "u": 0.0}, (0.0, 1.0), solver="scipy", method=method)
    assert run.jumps.t[-1] == run.t1 == 1.0
    assert run.final.u == -0.5 * run.jumps[-1].before.x


def test_an_offset_moves_all_times_and_the_first_time_of_a_run_is_none():
    run = hy.simulate(Sampled(offset=0.05), {"x": 1.0, "u": 0.0}, (0.05, 0.4), solver="taylor")
    assert run.jumps.t.tolist() == [k * 0.1 + 0.05 for k in range(1, 4)]
    late = hy.simulate(Sampled(offset=7.25), {"x": 1.0, "u": 0.0}, (-0.3, 0.1), solver="taylor")
    assert late.jumps.t.tolist() == [k * 0.1 + 7.25 for k in range(-75, -71)]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_time_that_is_reached_by_a_jump_is_neither_lost_nor_doubled(solver):
    run = hy.simulate(Relay(), {"x": 0.0, "n": 1.0}, (0.0, 4.0), solver=solver)
    assert list(zip(run.jumps.t.tolist(), run.jumps.edge, strict=True)) == [
        (1.0, "turn"), (2.0, "back"), (2.0, "turn"), (2.5, "back"), (3.0, "turn"),
    ]  # fmt: skip
    assert run.final.n == ((1 + 1) * 10 + 1) * 10 + 1
    assert run.final.x == pytest.approx(0.0 + 1 - 1 - 0.5 + 0.5 - 1, abs=CLOSE[solver])


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("shift", [-2, 0, 2])
def test_of_a_clock_and_a_guard_at_one_time_the_first_declared_fires(solver, first, shift):
    speed = 0.3 * (1.0 + shift * 2.0**-52)  # the mark is met some spacings early or late
    run = hy.simulate(marked(first)(speed=speed), {"x": 0.0, "n": 1.0}, (0.0, 1.0), solver=solver)
    assert run.jumps.edge[0] == "one"
    assert run.jumps.t[0] == pytest.approx(0.7, rel=1e-15)  # spacings
    assert run.final.n == (3.0 if first else 9.0)  # behind the guard there is no clock


@pytest.mark.parametrize("solver", SOLVERS)
def test_between_impacts_at_rest_and_after_it_clocks_ring(solver):
    run = hy.simulate(Kicked(), {"x": 0.5, "v": 0.0}, (0.0, 22.0), solver=solver)
    kicks = [k for k, edge in enumerate(run.jumps.edge) if edge == "kick"]
    assert run.jumps.t[kicks].tolist() == [2.25, 10.0, 20.0]
    # behind impacts at 1 and 2 the ball is as high as it gets, 1/32, when it gets the speed 1; it
    # falls with w, and flights take 2 r w (1 + r + ...); from rest at 10 and 20 it leaves with 1
    w = np.sqrt(1.0 + 2.0 / 32.0)
    ends = [point.t for point in run.zeno]
    assert ends == pytest.approx([2.25 + 1.0 + w + 2.0 * w, 10.0 + 4.0], abs=CLOSE[solver])
    assert run(21.0).x == pytest.approx(0.5, abs=CLOSE[solver])


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_clock_may_end_a_rest(solver):
    """In a run that goes on, too."""
    model, start = Kicked(), {"x": 0.5, "v": 0.0}
    run = hy.simulate(model, start, (0.0, 12.0), solver=solver)
    assert [point.t_release for point in run.zeno] == [10.0]
    first = hy.simulate(model, start, (0.0, 9.0), solver=solver)
    more = hy.simulate(model, first.final, (9.0, 12.0), mode=first.mode, solver=solver)
    assert [point.t_release for point in (first + more).zeno] == [10.0]


def test_clocks_are_no_accumulation():
    times = tuple(2.0 - 0.5**k for k in range(40))

    class Zeno(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s):
            return 1.0

        @hy.edge(flow, at=times)
        def mark(self, t, s):
            return 0.5 * s.x

    run = hy.simulate(Zeno(), {"x": 0.0}, (0.0, 3.0), solver="taylor")
    assert run.jumps.t.tolist() == list(times)
    assert not run.zeno
    assert run.status is hy.Status.REACHED_END


class Both(hy.Automaton):
    """Two clocks that ring together at every second time of one, and a guard behind them."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def falls(self, t, s):
        return -1.0, 0.0

    @hy.edge(falls, every=0.5)
    def lifts(self, t, s):
        return s.replace(x=0.0, n=10.0 * s.n + 1.0)

    @hy.edge(falls, every=1.0)
    def counts(self, t, s):
        return s.replace(n=10.0 * s.n + 2.0)

    @hy.edge(falls, guard=lambda self, t, s: s.x)
    def lands(self, t, s):
        return s.replace(x=5.0, n=10.0 * s.n + 3.0)


@ways
def test_clocks_of_one_time_all_ring_before_what_is_declared_behind_them(way):
    """A guard that the first of them leaves at zero fires at once, and last."""
    result = way.run(Both(), {"x": 5.0, "n": 0.0}, (0.0, 2.25))
    assert list(result.times) == [0.5, 0.5, 1.0, 1.0, 1.0, 1.5, 1.5, 2.0, 2.0, 2.0]
    assert result.final.n == 13_123_13_123


@pytest.mark.parametrize("solver", SOLVERS)
def test_of_clocks_that_ring_together_none_is_lost(solver):
    class Pair(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def stays(self, t, s):
            return 0.0

        more = hy.edge(stays, every=0.5)(lambda self, t, s: s.x + 1.0)
        double = hy.edge(stays, every=0.25)(lambda self, t, s: 2.0 * s.x)

    run = hy.simulate(Pair(), {"x": 0.0}, (0.0, 1.1), solver=solver)
    assert run.jumps.edge.tolist() == ["double", "more", "double"] * 2
    assert run.final.x == 10.0


@pytest.mark.parametrize("model", [Sampled, Kicked, Relay])
def test_the_loop_and_the_driver_ring_alike(model, monkeypatch):
    start = {"x": 0.5, **dict.fromkeys(model.spec.names[1:], 0.0)}
    by_loop = hy.simulate(model(), start, (0.0, 12.0), solver="taylor")
    without_loop(monkeypatch)
    by_driver = hy.simulate(model(), start, (0.0, 12.0), solver="taylor")
    assert by_loop.jumps.edge.tolist() == by_driver.jumps.edge.tolist()
    assert by_loop.jumps.t == pytest.approx(by_driver.jumps.t, abs=1e-12)
    assert np.array(by_loop.final) == pytest.approx(np.array(by_driver.final), abs=1e-12)


@pytest.mark.parametrize("model", [Sampled, Kicked, Relay])
def test_a_run_that_goes_on_at_a_clocks_time_neither_loses_nor_doubles_it(model):
    start = {"x": 0.5, **dict.fromkeys(model.spec.names[1:], 0.0)}
    whole = hy.simulate(model(), start, (0.0, 22.0), solver="taylor")
    for middle in (2.0, 10.0, 10.3):
        first = hy.simulate(model(), start, (0.0, middle), solver="taylor")
        both = first + hy.simulate(model(), first, (middle, 22.0), solver="taylor")
        clocks = [own.jumps.t[own.jumps.edge != "floor"].tolist() for own in (whole, both)]
        assert clocks[0] == clocks[1]
        # where arcs are cut, series are cut elsewhere: rounding
        assert np.array(both.final) == pytest.approx(np.array(whole.final), abs=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_lanes_have_periods_of_their_own(solver):
    periods = [0.1, 0.25, 0.3]
    lanes = hy.ensemble(
        Sampled(), {"x": 1.0, "u": 0.0}, (0.0, 1.0), parameters={"period": periods}, solver=solver
    )
    assert lanes.jumps.values.tolist() == [10, 4, 3]
    for k, period in enumerate(periods):
        alone = hy.simulate(Sampled(period=period), {"x": 1.0, "u": 0.0}, (0.0, 1.0), solver=solver)
        assert float(lanes.x[k]) == pytest.approx(alone.final.x, abs=CLOSE[solver])


def test_derivatives_by_the_period_and_by_the_start_are_those_of_differences():
    fly = hy.as_function(Sampled(), t=(0.0, 0.95), solver="taylor", max_jumps=20)

    def last(period, x):
        return fly(Sampled(period=period), {"x": x, "u": 0.0}).final["x"]

    h = 1e-5  # h * h times a sixth of the third derivative, some tens: moments are multiples of it
    with jax.enable_x64(True):
        by_period, by_x = jax.jacfwd(last, (0, 1))(0.3, 1.0)
        moved = (last(0.3 + h, 1.0) - last(0.3 - h, 1.0)) / (2 * h)
        assert float(by_period) == pytest.approx(float(moved), abs=1e-9)
        assert float(by_x) == pytest.approx(
            float(last(0.3, 1.0)), rel=1e-12
        )  # the run is linear in it


def test_a_clock_beside_a_delay():
    class Late(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s, past):
            return past(1.0).x

        @hy.edge(flow, at=0.5)
        def jump(self, t, s):
            return s.x + 1.0

    for solver in SOLVERS:
        run = hy.simulate(Late(), {"x": 0.0}, (0.0, 2.0), solver=solver, history={"x": 0.0})
        assert run.jumps.t.tolist() == [0.5]
        assert run.final.x == pytest.approx(1.0 + 0.5, abs=CLOSE[solver])  # 1 is seen from 1.5 on


def test_a_run_with_clocks_is_pickled_and_saved(tmp_path):
    run = hy.simulate(Sampled(), {"x": 1.0, "u": 0.0}, (0.0, 0.5), solver="taylor")
    again = pickle.loads(pickle.dumps(run))
    run.save(tmp_path / "run.nc")
    for other in (again, hy.load(tmp_path / "run.nc")):
        assert other.jumps.t.tolist() == run.jumps.t.tolist()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"every": -0.5}, "a period is one number above 0"),
        ({"every": "hours"}, "'hours' is no parameter"),
        ({"at": (1.0, 1.0)}, "give increasing times"),
        ({"at": ()}, "give one time at least"),
        ({"at": 1.0, "every": 1.0}, "together with every="),
        ({"at": 1.0, "guard": lambda self, t, s: s.x}, "guard= together with at="),
        ({"at": float("nan")}, "is no time"),
        ({"at": 1.0, "urgent": True}, "urgent= together with at="),
        ({}, "give a guard, or the times"),
    ],
)
def test_what_makes_no_clock_is_refused(given, said):
    with pytest.raises(hy.DeclarationError, match=said) as fault:

        class Wrong(hy.Automaton):
            x = hy.state()

            @hy.mode(initial=True)
            def flow(self, t, s):
                return 1.0

            tick = hy.edge(flow, **given)

    assert len(fault.value.faults) == 1
    assert "edge tick" in str(fault.value)


def test_a_parameter_that_is_no_period_is_refused():
    with pytest.raises(hy.ParameterError, match=r"Sampled, edge sample: every='period' is \[-1"):
        Sampled(period=-1.0)
    assert attrs.evolve(Sampled(), period=2.0).period == 2.0
    assert jnp.ndim(jax.tree_util.tree_leaves(Sampled())[0]) == 0


def test_a_proof_before_the_run_has_no_clock():
    with pytest.raises(hy.HybridError, match="Kicked, edge kick, fires at given times"):
        hy.certify(Kicked(), {"x": (0.0, 1.0), "v": (-2.0, 2.0)})


def test_a_clock_may_end_the_run():
    class Alarm(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s):
            return 1.0

        over = hy.edge(flow, to=hy.TERMINATE, at=0.75)

    run = hy.simulate(Alarm(), {"x": 0.0}, (0.0, 2.0), solver="taylor")
    assert run.status is hy.Status.TERMINATED
    assert (run.t1, run.final.x) == (0.75, 0.75)


@pytest.mark.parametrize("method", ["DOP853", "Radau", "BDF", "LSODA", "RK23"])
def test_a_clock_may_ring_at_the_last_time_of_a_run(method):
    """Behind it is an arc of no length, for which a method of SciPy has no step."""
    run = hy.simulate(Sampled(), {"x": 1.0, "u": 0.0}, (0.0, 0.1), method=method)
    assert (run.jumps.t.tolist(), run.t1) == ([0.1], 0.1)
    assert run.final.u == -0.5 * run.final.x


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_what_fires_behind_a_jump_at_the_last_time_fires(solver):
    """In the mode that the jump leads to, before the run ends: an urgent edge, another clock."""

    class Chain(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def off(self, t, s):
            return 1.0

        @hy.mode
        def on(self, t, s):
            return -1.0

        @hy.edge(off, every=1.0)
        def tick(self, t, s):
            return s.replace(x=s.x + 5.0)

        go = hy.edge(off, to=on, guard=lambda self, t, s: 3.5 - s.x, urgent=True)
        tock = hy.edge(on, at=1.0)

    run = hy.simulate(Chain(), {"x": 0.0}, (0.0, 1.0), solver=solver)
    assert list(run.jumps.edge) == ["tick", "go", "tock"]
    assert (run.mode, run.jumps.t.tolist()) == ("on", [1.0] * 3)
    lanes = hy.ensemble(Chain(), {"x": [0.0, 0.0]}, (0.0, 1.0), solver=solver)
    assert lanes["mode"].values.tolist() == ["on"] * 2
    assert lanes["jumps"].values.tolist() == [3] * 2


class Delayed(hy.Automaton):
    """A clock that counts its rings, and at each reads what the count was some rings before."""

    count = hy.state()
    seen = hy.state()
    period = hy.parameter(0.1)
    lag = hy.parameter(0.3)

    @hy.mode(initial=True)
    def flow(self, t, s):
        return 0.0, 0.0

    @hy.edge(flow, every="period")
    def ring(self, t, s, past):
        return s.replace(count=s.count + 1.0, seen=past(self.lag).count)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("period", [0.1, 0.125, 1 / 3, 0.07])
def test_a_ring_sees_the_record_before_the_ring_a_lag_ago(solver, period):
    """The lag is three periods, in exact arithmetic: which side of that ring is seen does not
    depend on the rounding of their times."""
    model = Delayed(period=period, lag=3 * period)
    run = hy.simulate(model, [0.0, 0.0], (0.0, 40.5 * period), solver=solver)
    assert run.jumps.after.seen == pytest.approx([0.0, 0.0, 0.0, *np.arange(0.0, 37.0)], abs=1e-12)


class Held(hy.Automaton):
    """A clock that reads a held signal where it changes."""

    seen = hy.state()
    force = hy.signal(kind="previous", outside="hold")

    @hy.mode(initial=True)
    def flow(self, t, s):
        return 0.0 * s.seen

    @hy.edge(flow, every=0.1)
    def ring(self, t, s):
        return self.force(t)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("looped", [True, False])
def test_a_ring_at_a_knot_sees_the_signal_before_it(solver, looped, monkeypatch):
    """The times of the data are decimal numbers, those of the clock multiples of its period."""
    times = [float(f"{k / 10:.1f}") for k in range(42)]
    model = Held(force=(times, np.arange(42.0)))
    if not looped:
        without_loop(monkeypatch)
    run = hy.simulate(model, [0.0], (0.0, 4.05), solver=solver)
    assert run.jumps.t.tolist() == [k * 0.1 for k in range(1, 41)]
    assert run.jumps.after.seen.tolist() == np.arange(0.0, 40.0).tolist()


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_clock_behind_the_end_of_a_run_does_not_ring(solver):
    """However little."""
    run = hy.simulate(Delayed(), [0.0, 0.0], (0.0, np.nextafter(0.3, 0.0)), solver=solver)
    assert run.final.count == 2.0


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("looped", [True, False])
@pytest.mark.parametrize("r", [0.3, 0.8])
@pytest.mark.parametrize(
    ("event", "ring"),
    [
        (1e-5, np.inf),
        (1e-7, np.inf),
        (1e-9, np.inf),
        (1e-12, np.inf),
        (np.inf, 1e-5),
        (np.inf, 1e-7),
        (np.inf, 1e-9),
        (np.inf, 1e-12),
        (1e-10, 1e-7),  # the height hides where an impact is, between these
        (1e-7, 1e-10),
        (1e-10, 1.1e-10),
    ],
)
def test_a_jump_shortly_before_a_limit_leaves_it_listed(
    solver, looped, r, event, ring, monkeypatch
):
    """The flights behind it are lower than the rounding of the position, and the ball rests."""
    if not looped:
        without_loop(monkeypatch)
    limit = 0.5 * (1.0 + r) / (1.0 - r)
    model = Shelf(r=r, event=max(limit - event, -1.0), ring=max(limit - ring, -1.0))
    run = hy.simulate(model, {"x": 21.0, "v": 0.0}, (0.0, 5.0), solver=solver, rtol=1e-12)
    (point,) = run.zeno
    assert abs(point.t - limit) <= point.t_error <= 1e-4
    assert run.final.n == np.isfinite([event, ring]).sum()
    assert run.mode == "flight.rest(impact)"


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_an_event_fires_once_a_few_roundings_before_a_clock(solver):
    """It is still zero, but for rounding, when the clock rings."""
    for spacings in (1, 3, 10, 30, 60, 100):
        ring = 1.25 + spacings * np.spacing(1.25)
        model = Shelf(r=0.9, event=1.25, ring=ring)
        run = hy.simulate(model, {"x": 21.0, "v": 0.0}, (0.0, 2.0), solver=solver)
        assert [row.edge for row in run.jumps if row.edge != "impact"] == ["tick", "tock"]


class Timed(hy.Automaton):
    """A ball on a shelf with a record of the time, an event, and a clock declared first."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    rings = hy.discrete(0)
    events = hy.discrete(0)
    r: float = hy.parameter(0.5)
    h: float = hy.parameter(1.0)
    ring: float = hy.parameter(9.0)
    event: float = hy.parameter(9.0)
    least: float = hy.parameter(-1.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -10.0, 1.0

    @hy.edge(flight, at="ring", when=lambda self, t, s: s.y > self.least)
    def tock(self, t, s):
        return s.replace(rings=s.rings + 1)

    @hy.edge(flight, guard=lambda self, t, s: self.event - t)
    def tick(self, t, s):
        return s.replace(events=s.events + 1)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.h, restitution="r")


def dropped(**values):
    model = Timed(**values)
    return model, {"x": model.h + 0.8, "v": 0.0, "y": 0.0}


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("early", [1e-6, 1e-8, 1e-10, 1e-12])
def test_an_event_shortly_before_a_clock_shortly_before_a_limit_fires(solver, early):
    """The clock is declared first, and the ball rests from it on."""
    ring = 1.2 - early
    for spacings in (-2, 0, 1, 2, 4):
        model, start = dropped(ring=ring, event=ring - spacings * np.spacing(ring))
        run = hy.simulate(model, start, (0.0, 2.0), solver=solver)
        assert (run.final.rings, run.final.events, len(run.zeno)) == (1, 1, 1), spacings


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_clock_rings_in_the_state_of_its_time(solver):
    """Where a slow impact shortly before cannot be told from it by the gap."""
    x0, r = -3.7 + 1.9742157668520586, 0.5899072010435598
    model = Timed(h=-3.7, r=r, event=2.436137627068065, ring=2.4361379022329173)
    run = hy.simulate(model, {"x": x0, "v": 0.0, "y": 0.0}, (0.0, 2.5), solver=solver)
    off = [abs(row.after.y - row.t) for row in run.jumps]
    assert max([*off, abs(run.final.y - 2.5)]) < 1e-13  # y is a sum of a few times


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("h", [0.0, 1.0, 20.0, -500.0])
@pytest.mark.parametrize("early", [1e-3, 1e-5, 1e-6, 1e-8])
def test_a_clock_that_does_not_fire_shortly_before_a_limit_is_in_its_bound(solver, h, early):
    """The arc ends there, and the gap is rounded."""
    ratio = 0.5
    limit = 0.4 * (1.0 + ratio) / (1.0 - ratio)  # x - h is 0.8, to the rounding of h
    model, start = dropped(h=h, ring=limit - early, least=9.0)
    run = hy.simulate(model, start, (0.0, 2.0), solver=solver, rtol=1e-12)
    (point,) = run.zeno
    fall = start["x"] - h
    exact = np.sqrt(fall / 5.0) * (1.0 + ratio) / (1.0 - ratio)
    assert abs(point.t - exact) <= point.t_error < 1e-4
    assert run.final.rings == 0


class Counting(hy.Automaton):
    """Counts by a period and at two times."""

    n = hy.discrete(0)
    period: float = hy.parameter(0.4)
    first: float = hy.parameter(0.5)
    second: float = hy.parameter(1.5)
    share: float = hy.parameter(0.5, between=(0, 1))
    x = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s):
        return self.share

    @hy.edge(flow, every="period")
    def tick(self, t, s):
        return s.replace(n=s.n + 10)

    @hy.edge(flow, at=("first", "second"))
    def bell(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.parametrize(
    "given",
    [{"period": 0.0}, {"period": np.nan}, {"first": np.nan}, {"first": 2.0}, {"share": 2.0}],
    ids=str,
)
def test_parameters_that_are_traced_are_refused_as_others(given):
    """A function cannot raise under jit: its status says that the run failed. Their clocks did not
    ring, without a word."""
    count = hy.as_function(Counting(), t=(0.0, 4.0), max_jumps=100)

    def status(value):
        return count(Counting(**dict.fromkeys(given, value)), {"x": 1.0}).status

    (name,), (value,) = given, given.values()
    with jax.enable_x64(True):
        assert REASONS[int(jax.jit(status)(value))][0] == "failed"
        fits = getattr(Counting(), name)
        many = jax.vmap(status)(jnp.array([fits, value, fits, fits, value]))
    refused = [lane for lane, k in enumerate(many.tolist()) if REASONS[k][0] == "failed"]
    assert refused == [1, 4]
    with pytest.raises(hy.ParameterError):
        hy.simulate(Counting(**given), {"x": 1.0}, (0.0, 4.0))


def test_the_times_of_a_clock_increase_in_every_lane():
    """They were compared at the least and the greatest of all lanes alone."""
    given = {"first": np.array([0.5, 2.0, 0.1]), "second": np.array([1.0, 1.5, 3.0])}
    with pytest.raises(hy.ParameterError, match=r"at=.* has 1.5 after 2.0"):
        hy.ensemble(Counting(), {"x": 1.0}, (0.0, 4.0), given)
    given["first"][1] = 1.2
    lanes = hy.ensemble(Counting(), {"x": 1.0}, (0.0, 4.0), given)
    assert lanes.n.values.tolist() == [102] * 3


def decay(crossing):
    """A decay to a little below zero, sampled by a clock on its way; an edge ends it at zero."""

    class Decay(hy.Automaton):
        x = hy.state()
        n = hy.state()
        below: float = hy.parameter(1e-15)

        @hy.mode(initial=True)
        def falls(self, t, s):
            return -s.x - self.below, 0.0

        @hy.mode
        def ended(self, t, s):
            return 0.0 * s.x, 0.0

        @hy.edge(falls, every=0.25)
        def sample(self, t, s):
            return s.x, s.n + 1.0

        @hy.edge(falls, to=ended, guard=lambda self, t, s: s.x, crossing=crossing)
        def ends(self, t, s):
            return s

    return Decay


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("below", [1e-13, 1e-15])
@pytest.mark.parametrize("crossing", [hy.FALLING, hy.EITHER])
def test_a_ring_before_a_slow_zero_does_not_put_it_off(crossing, below, solver):
    """When it rings the state is 1e-14 of what it has been, for seconds before it is zero."""
    exact = np.log1p(1.0 / below)
    given = {"solver": solver} | ({} if solver == "taylor" else {"rtol": 1e-10, "atol": 1e-20})
    run = hy.simulate(decay(crossing)(below=below), {"x": 1.0, "n": 0.0}, (0, 50), **given)
    assert run.mode == "ended"
    assert run.final.n == exact // 0.25
    assert abs(run.jumps.t[-1] - exact) < 1e-8  # 1e-10 a step, of some hundreds
