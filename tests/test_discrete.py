"""Discrete variables: numbers that only jumps change."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

SOLVERS = ["taylor", "scipy", "diffrax"]
G, R = 9.81, 0.8
#: From height 1: the first fall, and a geometric series of flights.
FALL = (2.0 / G) ** 0.5
LIMIT = FALL * (1.0 + 2.0 * R / (1.0 - R))
START = {"x": 1.0, "v": 0.0}


class Ball(hy.Automaton):
    """A ball that bounces by a reset."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        _, v = s
        return v, -G

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x)
    def bounce(self, t, s):
        return s.replace(x=0.0, v=-R * s.v)

    @hy.mode(limit_of=("bounce",))
    def rest(self, t, s):
        return 0.0, 0.0


class Counting(Ball):
    """It counts its impacts, remembers the last speed and turns a flag."""

    count = hy.discrete(0, doc="impacts")
    far = hy.discrete(1e12)
    odd = hy.discrete(False)

    @hy.edge("flight", to="flight", guard=lambda self, t, s: s.x)
    def bounce(self, t, s):
        return s.replace(x=0.0, v=-R * s.v, count=s.count + 1, odd=~s.odd)


class Gears(hy.Automaton):
    """x' = gear until x = gear; then the next gear, whole numbers up to 3: t = 1, 2, 3."""

    gear = hy.discrete(1)
    fast = hy.discrete(False)
    held = hy.discrete(0.25)
    x = hy.state()

    @hy.mode(initial=True)
    def drive(self, t, s):
        return self.speed(t, s)

    @hy.output
    def speed(self, t, s):
        return jnp.where(s.fast, 2.0, 1.0) * s.gear * s.held * 4.0

    @hy.edge(drive, to=drive, guard=lambda self, t, s: s.gear - s.x)
    def shift(self, t, s):
        return s.replace(x=0.0, gear=s.gear % 3 + 1, fast=s.gear == 1)


@pytest.fixture(params=SOLVERS)
def solver(request):
    return request.param


def test_a_counter_changes_nothing_of_the_motion(solver):
    """t_inf, rest and verdict are those of a ball that does not count, to rounding."""
    counts, plain = (hy.simulate(m(), START, (0.0, 5.0), solver=solver) for m in (Counting, Ball))
    own, other = counts.zeno[0], plain.zeno[0]
    assert own.t == pytest.approx(other.t, rel=4e-15)  # steps to the same error, but for rounding
    assert abs(own.t - LIMIT) <= own.t_error
    assert own.t_error == pytest.approx(other.t_error, rel=0.5)
    assert (own.mode, own.verdict) == (other.mode, other.verdict) == ("rest", "estimated")
    assert len(counts.jumps) == len(plain.jumps)


def test_a_counter_keeps_what_the_last_jump_made_has_left(solver):
    """It has no limit: the accumulation says so by an error without bound, and in words."""
    run = hy.simulate(Counting(), START, (0.0, 5.0), solver=solver)
    point, made = run.zeno[0], run.jumps.after
    assert run.final.count == point.state.count == made.count[-1] == len(run.jumps)
    assert np.isinf(point.state_error.count)
    assert point.state_error.far == 0.0
    assert run.final.far == 1e12
    assert "count" in run.explain()


def test_records_show_it_as_it_was_declared(solver):
    run = hy.simulate(Counting(), START, (0.0, 2.0), solver=solver)
    count = len(run.jumps)
    assert run.final.count.dtype == np.int64
    assert run.final.odd.dtype == bool
    assert run.jumps.before.count.tolist() == list(range(count))
    assert run.jumps.after.odd.tolist() == [k % 2 == 0 for k in range(count)]
    times = 0.5 * (run.jumps.t[:-1] + run.jumps.t[1:])
    assert run(times).count.tolist() == list(range(1, count))
    assert run(float(run.jumps.t[0]), side="left").count == 0
    x, v = run(times)
    assert x.shape == v.shape == times.shape
    assert len(run.final) == 2


def test_it_is_seen_by_flows_guards_and_resets(solver):
    """Gear 1 at speed 1 for 1, gear 2 at speed 4 for 0.5, gear 3 at speed 3 for 1, and again."""
    run = hy.simulate(Gears(), {"x": 0.0}, (0.0, 5.2), solver=solver)
    assert run.jumps.t == pytest.approx([1.0, 1.5, 2.5, 3.5, 4.0, 5.0], rel=1e-8)  # of the solvers
    assert run.jumps.after.gear.tolist() == [2, 3, 1, 2, 3, 1]
    assert run.jumps.after.fast.tolist() == [True, False, False, True, False, False]
    assert run.final.x == pytest.approx(0.2, abs=1e-7)


def test_the_start_may_leave_it_out_and_may_give_it(solver):
    run = hy.simulate(Gears(), {"x": 0.0, "gear": 3}, (0.0, 0.5), solver=solver)
    assert run.final.x == pytest.approx(1.5, rel=1e-9)
    again = hy.simulate(Gears(), run.final, (0.0, 1.0), solver=solver)
    assert again.jumps.t[0] == pytest.approx(0.5, rel=1e-8)
    assert hy.simulate(Gears(), [0.0], (0.0, 0.5), solver=solver).final.gear == 1


def test_a_sequence_may_end_with_it():
    """A start in order has the states that flow, and then all discrete variables or none."""
    end = hy.simulate(Gears(), [0.0, 3, False, 0.25], (0.0, 0.5)).final
    assert end == hy.simulate(Gears(), {"x": 0.0, "gear": 3}, (0.0, 0.5)).final
    with jax.enable_x64(True):
        f = hy.as_function(Gears(), t=(0.0, 0.5), max_jumps=4)
        assert f(Gears(), [0.0, 3, 0, 0.25]).final.x == pytest.approx(1.5, rel=1e-15)
        given = jnp.array([0.0, 3.0, 0.0, 0.25])
        slope = jax.jacfwd(lambda start: f(Gears(), start).final.x)(given)
    assert slope == pytest.approx([1.0, 0.0, 0.0, 6.0], rel=1e-14)  # x = 4 gear held t; rounding
    with pytest.raises(hy.StartError, match="2 values for 1 state"):
        hy.simulate(Gears(), [0.0, 3], (0.0, 0.5))


def test_a_run_goes_on_with_it_and_outputs_see_it(solver):
    """Gear 3 at speed 3 from 1.5 on."""
    first = hy.simulate(Gears(), {"x": 0.0}, (0.0, 2.0), solver=solver)
    more = hy.simulate(Gears(), first, (first.t1, 3.0), solver=solver)
    assert (first + more).final.gear == 1
    assert first(np.array([0.5, 2.0])).speed.tolist() == [1.0, 3.0]
    assert len(first(1.0)) == 1


class Sampled(hy.Automaton):
    """x' = u, where u = -x / 2 is taken every 1: x halves from sample to sample."""

    x = hy.state()
    u = hy.discrete(-0.5)

    @hy.mode(initial=True)
    def go(self, t, s):
        return s.u

    @hy.edge(go, to=go, every=1.0)
    def sample(self, t, s):
        return s.replace(u=-0.5 * s.x)


def test_a_controller_holds_its_value(solver):
    """x = 2^-4 at 4, less half as much for half a time; with the steps' own error."""
    run = hy.simulate(Sampled(), {"x": 1.0}, (0.0, 4.5), solver=solver)
    assert run.final.x == pytest.approx(0.75 * 2.0**-4, rel=1e-9)
    assert run.final.u == pytest.approx(-(2.0**-5), rel=1e-9)


def test_files_and_tables_keep_it(tmp_path):
    run = hy.simulate(Counting(), START, (0.0, 5.0))
    run.save(tmp_path / "run.nc")
    loaded = hy.load(tmp_path / "run.nc")
    assert loaded.final.count.dtype == np.int64
    assert loaded.final == run.final
    assert loaded.zeno[0].state.count == run.zeno[0].state.count
    table = run.to_xarray()
    assert table["count"].dtype == np.int64
    assert int(table["count"][-1]) == run.final.count


def test_a_picture_has_its_steps():
    pytest.importorskip("matplotlib")
    run = hy.simulate(Counting(), START, (0.0, 2.0))
    axes = [axis for axis in run.plot().axes if axis.get_ylabel() == "count"]
    lines = [line for axis in axes for line in axis.lines]
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in lines])
    assert set(range(len(run.jumps) + 1)) <= set(drawn[np.isfinite(drawn)])


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_lanes_count(solver):
    """Each lane as its run, with starts of its own."""
    lanes = hy.ensemble(
        Counting(), {"x": [1.0, 0.5], "v": 0.0, "count": [0, 10]}, (0.0, 1.5), solver=solver
    )
    runs = [
        hy.simulate(Counting(), {"x": x, "v": 0.0, "count": c}, (0.0, 1.5), solver=solver)
        for x, c in ((1.0, 0), (0.5, 10))
    ]
    assert lanes["count"].dtype == np.int64
    assert lanes["odd"].dtype == bool
    assert lanes["count"].values.tolist() == [int(run.final.count) for run in runs]
    assert lanes["x"].values == pytest.approx([float(run.final.x) for run in runs], abs=1e-9)


def test_a_function_has_it_as_a_number():
    with jax.enable_x64(True):
        f = hy.as_function(Counting(), t=(0.0, 2.0), max_jumps=10)
        out = f(Counting(), START)
        assert float(out.final["count"]) == hy.simulate(Counting(), START, (0.0, 2.0)).final.count
        slope = jax.grad(lambda x: f(Counting(), {"x": x, "v": 0.0}).final["count"])(1.0)
    assert slope == 0.0


class Decoy(hy.Automaton):
    """A ball that loses nothing from the 40th impact on: its series has no end."""

    x = hy.state()
    v = hy.state()
    count = hy.discrete(0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -G

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x)
    def bounce(self, t, s):
        r = jnp.where(s.count < 40, R, 1.0)
        return s.replace(x=0.0, v=-r * s.v, count=s.count + 1)


def test_a_count_by_which_the_motion_goes_is_no_cause_of_a_limit(solver):
    """Jumps shrink for long, and do not accumulate; no limit is believed before."""
    run = hy.simulate(Decoy(), START, (0.0, 4.1), solver=solver, max_jumps=300)
    assert not run.zeno
    assert run.final.count == 300


class Delayed(hy.Automaton):
    """x' = -x(t - 1), and the sign turns at x = -0.5."""

    x = hy.state()
    turns = hy.discrete(0)

    @hy.mode(initial=True)
    def go(self, t, s, past):
        return -past(1.0).x

    @hy.edge(go, to=go, guard=lambda self, t, s: s.x + 0.5)
    def turn(self, t, s):
        return s.replace(x=0.5, turns=s.turns + 1)


def test_it_counts_beside_delays(solver):
    """From 1, with -1.25 for a rate until t = 1: -0.5 would be at 1.2; then the rate is
    -(1 - 1.25 (t - 1)), and x = -0.25 - u + 0.625 u^2 = -0.5 at u = t - 1."""
    run = hy.simulate(Delayed(), {"x": 1.0}, (0.0, 3.0), solver=solver, history={"x": 1.25})
    u = (1.0 - (1.0 - 4 * 0.625 * 0.25) ** 0.5) / (2 * 0.625)
    assert run.jumps.t[0] == pytest.approx(1.0 + u, rel=1e-7)  # of the solvers
    assert run.final.turns == len(run.jumps)


def declared(**body):
    return type(
        "Faulty",
        (hy.Automaton,),
        {"x": hy.state(), "n": hy.discrete(0), "__module__": __name__, **body},
    )


FLOW = hy.mode(initial=True)


@pytest.mark.parametrize(
    ("reset", "flow", "said"),
    [
        (lambda self, t, s: s.replace(n=s.n + 0.5), lambda self, t, s: 1.0, "edge e, reset: n:"),
        (lambda self, t, s: s.replace(n=s.n / 2), lambda self, t, s: 1.0, "a whole number is due"),
        (lambda self, t, s: s, lambda self, t, s: {"x": 1.0, "n": 0.0}, "only jumps change"),
        (lambda self, t, s: s, lambda self, t, s: s.replace(n=1), "only jumps change"),
        (lambda self, t, s: s, lambda self, t, s: (1.0, 0.0), "2 values for 1 state"),
        (lambda self, t, s: s, lambda self, t, s, past: past(1.0).n, "no state that flows"),
    ],
)
def test_wrong_use_is_refused_when_the_class_is_made(reset, flow, said):
    mode = hy.mode(initial=True)(flow)
    mode.name = "m"
    edge = hy.edge(mode, to=mode, guard=lambda self, t, s: s.x - 1.0)(reset)
    with pytest.raises(hy.DeclarationError, match=said):
        declared(m=mode, e=edge)


@pytest.mark.parametrize("default", [0.5 + 1j, "a", None, [1, 2], float("nan"), 2**60])
def test_a_default_is_a_number(default):
    with pytest.raises(hy.DeclarationError, match="discrete n: default="):
        declared(n=hy.discrete(default), m=hy.mode(initial=True)(lambda self, t, s: 1.0))


@pytest.mark.parametrize("start", [{"gear": 0.5}, {"fast": 2}, {"gear": 2.0**54}])
def test_a_start_is_of_its_kind(start):
    with pytest.raises(hy.StartError, match=r"start (gear|fast)"):
        hy.simulate(Gears(), {"x": 0.0, **start}, (0.0, 1.0))
    with pytest.raises(hy.StartError, match=r"start (gear|fast)"):
        hy.ensemble(Gears(), {"x": [0.0, 0.1], **start}, (0.0, 1.0))


class Doubling(hy.Automaton):
    """Too large soon."""

    x = hy.state()
    n = hy.discrete(2**52)

    @hy.mode(initial=True)
    def up(self, t, s):
        return 1.0

    @hy.edge(up, to=up, guard=lambda self, t, s: 1.0 - s.x)
    def double(self, t, s):
        return s.replace(x=0.0, n=2 * s.n)


def test_a_whole_number_beyond_doubles_is_an_error():
    assert hy.simulate(Doubling(), {"x": 0.0}, (0.0, 1.5)).final.n == 2**53
    with pytest.raises(hy.FlowError, match="exact to 2\\^53"):
        hy.simulate(Doubling(), {"x": 0.0}, (0.0, 2.5)).final.n  # noqa: B018


@pytest.mark.parametrize(
    "ask",
    [
        lambda: hy.certify(Counting(), {"x": (0.0, 1.0), "v": (-5.0, 5.0)}),
        lambda: hy.periodic_orbit(Counting(), START),
        lambda: hy.lyapunov(Counting(), START, (0.0, 1.0)),
        lambda: hy.simulate(Counting(), START, (0.0, 5.0)).settles(),
    ],
)
def test_what_takes_none_says_so(ask):
    with pytest.raises(hy.OptionError, match="takes no discrete variable yet, and Counting has co"):
        ask()
