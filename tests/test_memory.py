"""What a run with delays remembers: hard lags, rounding, histories, and what is refused."""

import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.delay.memory import Memory
from hybrid.delay.pieces import Breaks
from hybrid.rules import record
from hybrid.rules.places import BREAKS
from hybrid.run import driver
from models.bouncing_ball import BouncingBall
from models.pyragas import Pyragas

from . import delayed
from .delay_truth import unit_lag

TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def moving(law):
    """The model of a lag ``law(t, y)``."""

    class Made(hy.Automaton):
        y = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s, past):
            return (-past(law(t, s.y)).y,)

    return Made()


def agree(model, start, until, within, **options):
    """DOP853 and Taylor series agree, which step differently and so look differently."""
    one = hy.simulate(model, start, (0, until), **TIGHT, **options)
    other = hy.simulate(model, start, (0, until), solver="taylor", **TIGHT, **options)
    for name in one.final.keys():
        np.testing.assert_allclose(one.final[name], other.final[name], atol=within)
    return one


# ---------------------------------------------------------------------------------------
# breaking points


def breaks_of(dimension):
    """No breaking points yet."""
    return Breaks(np.zeros(BREAKS + 1, dtype=np.int64), dimension)


def test_breaking_points_within_rounding_are_one():
    breaks = breaks_of(2)
    breaks.add(1.0, np.array([1, 2]))
    breaks.add(1.0 + 4e-16, np.array([2, 0]))
    assert breaks.times.tolist() == [1.0]
    assert breaks.arrays[1][0].tolist() == [1, 0]


def test_breaking_points_are_told_apart_as_well_as_the_present_time_is():
    """Seen from t = 1000 times are known to 1e-13: two that are nearer are passed together."""
    breaks = breaks_of(1)
    breaks.add(0.0, np.array([1]))
    breaks.add(1e-14, np.array([0]))
    breaks.add(1.0, np.array([3]))
    seen = SimpleNamespace(ints=breaks.ints, times=breaks.times)
    assert record.next_break(seen, -1e-14, 1e-12) == 1.0
    assert record.last_break(seen, -1e-12, there=True) == -math.inf


@pytest.mark.parametrize("lag", [10.0, 1000.0, 1e5])
@pytest.mark.parametrize("at", [0.5, 1e-3, 1e-5])
def test_an_early_jump_arrives_after_a_long_lag(lag, at):
    """t - lag is rounded as t is: a run must not wait for a jump that is within rounding.

    Two lags by hand: 1 - t and the jump, then its integral.
    """
    run = hy.simulate(delayed.Kicked(tau=lag, at=at), {"y": 1.0}, (0, 1.5 * lag), **TIGHT)
    s = 0.5 * lag
    exact = 3 - lag - (s - s * s / 2 + 2 * (s - at))
    assert run.final.y == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize("lag", [1e10, 1e300])
def test_a_lag_longer_than_the_run_shows_the_history(lag):
    run = hy.simulate(delayed.Lagged(tau=lag), {"y": 1.0}, (0, 5), **TIGHT)
    assert run.final.y == pytest.approx(-4.0, abs=1e-13)


@pytest.mark.parametrize(("t0", "within"), [(-3.0, 1e-14), (1e3, 1e-11), (1e6, 1e-8)])
@pytest.mark.parametrize("tau", [1.0, 0.1])
def test_the_start_may_be_any_time(t0, within, tau):
    """Times are rounded to 1e-16 t0, seen at a rate of 1 / tau."""
    run = hy.simulate(delayed.Lagged(tau=tau, k=1 / tau), {"y": 1.0}, (t0, t0 + 5 * tau), **TIGHT)
    assert run.final.y == pytest.approx(float(unit_lag(5)), abs=within)
    assert len(run.arcs[0].segments) < 50


LAGS = [(0.3, 0.1), (0.3, 0.3), (1 / 3, 1 / 7), (1.0, math.sqrt(2)), (1.0, 1 + 1e-13), (1.0, 1e-3)]


class Two(hy.Automaton):
    y = hy.state()
    a = hy.parameter(0.3)
    b = hy.parameter(0.1)

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return (-past(self.a).y - 0.5 * past(self.b).y + 0.2 * past(self.a + self.b).y,)


@pytest.mark.parametrize(("a", "b"), LAGS)
def test_several_lags(a, b):
    """Commensurate ones, whose breaking points coincide within rounding; equal; far apart."""
    agree(Two(a=a, b=b), {"y": 1.0}, 6, 1e-11)


# ---------------------------------------------------------------------------------------
# short and vanishing lags


@pytest.mark.parametrize("tau", [0.0, 1e-300, 1e-15, 1e-12])
@pytest.mark.parametrize("t0", [0.0, 1.0])
def test_lags_below_rounding(tau, t0):
    """y' = -y in the limit; 1e-10 is the tolerance, 1e-12 the lag's own effect."""
    run = hy.simulate(delayed.Lagged(tau=tau), {"y": 1.0}, (t0, t0 + 5), **TIGHT)
    assert run.final.y == pytest.approx(math.exp(-5), abs=1e-11)


def test_a_jump_where_a_lag_vanishes():
    """What is guessed after a jump is where the state is, not where it was."""
    run = hy.simulate(delayed.Kicked(tau=0.0), {"y": 1.0}, (0, 5), **TIGHT)
    assert run.final.y == pytest.approx(math.exp(-5) + 2 * math.exp(-4.5), abs=1e-11)


def test_a_short_lag_costs_little():
    """Lags of 1e-4 for 5: a step spans hundreds of them."""
    run = hy.simulate(delayed.Lagged(tau=1e-4), {"y": 1.0}, (0, 5), **TIGHT)
    assert len(run.arcs[0].segments) < 200


@pytest.mark.parametrize(
    "law",
    [
        lambda t, y: 2.0 * t,
        lambda t, y: t,
        lambda t, y: 0.9 * t,
        lambda t, y: abs(1 - t),
        lambda t, y: (1 - t) ** 2,
        lambda t, y: abs(y),
        lambda t, y: 1.2 + 1.2 * np.sin(1.0) * y**2,
    ],
    ids=["place goes back", "place stays", "slow", "vanishes", "touches 0", "state", "square"],
)
def test_lags_that_move(law):
    agree(moving(law), {"y": 1.0}, 3, 1e-10, history={"y": lambda t: 1 + math.sin(t)})


class Swinging(hy.Automaton):
    """The place swings over the same breaking points again and again."""

    y = hy.state()
    z = hy.state()
    w = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return -past(0.6 + 0.5 * s.z).y, 4.0 * s.w, -4.0 * s.z


def test_a_place_that_swings():
    agree(Swinging(), {"y": 1.0, "z": 0.0, "w": 1.0}, 3, 1e-9)


def test_a_lag_that_becomes_negative_is_refused():
    with pytest.raises(hy.FlowError, match=r"the lag .* is -.*at least 0"):
        hy.simulate(moving(lambda t, y: 1.0 - t), {"y": 1.0}, (0, 3))


# ---------------------------------------------------------------------------------------
# states and modes


class Turned(hy.Automaton):
    q = hy.state(shape=(3,))

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return (-past(1.0).q[::-1] + 0.5 * past(0.5).q,)


def test_states_that_are_arrays():
    history = {"q": lambda t: np.array([1.0, 2.0 + t, math.cos(t)])}
    agree(Turned(), {"q": [1.0, 2.0, 1.0]}, 4, 1e-8, history=history)


class Late(hy.Automaton):
    """Only the second mode looks back, with a short lag."""

    y = hy.state()

    @hy.mode(initial=True)
    def free(self, t, s):
        return (-s.y,)

    @hy.mode
    def late(self, t, s, past):
        return (-past(0.01).y,)

    @hy.edge(free, to=late, guard=lambda self, t, s: 9.9 - t)
    def go(self, t, s):
        return s


def test_a_mode_that_does_not_look_back():
    run = agree(Late(), {"y": 1.0}, 10, 1e-12)
    assert run(9.9).y == pytest.approx(math.exp(-9.9), abs=1e-11)


def test_cost_grows_with_time_and_not_faster():
    """Ten times as long, ten times the segments; what is not needed is forgotten."""
    model, history = delayed.Lagged(tau=math.pi / 2), {"y": math.cos}
    short, long = [
        hy.simulate(model, {"y": 1.0}, (0, until), history=history, rtol=1e-6, solver="taylor")
        for until in (100, 1000)
    ]
    assert len(long.arcs[0].segments) < 11 * len(short.arcs[0].segments)


# ---------------------------------------------------------------------------------------
# histories


class Bouncing(hy.Automaton):
    """A ball on a spring that is held back by what it did, with a lag that swings."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        held = 0.98 * past(0.51 * (1.0 + 0.3 * jnp.sin(t))).x - 0.18 * past(0.37).v
        return s.v, 1.42 * jnp.cos(1.94 * t) - 1.68 * s.x - 0.48 * s.v - 0.29 + held

    floor = hy.contact(flight, gap=lambda self, t, s: s.x + 0.4, restitution=0.7)

    @hy.edge(flight, guard=lambda self, t, s, past: past(0.25).x - 0.023, crossing=hy.EITHER)
    def mark(self, t, s):
        return s.replace(v=0.8 * s.v, n=s.n + 1)


@pytest.mark.long
def test_there_is_room_for_every_breaking_point():
    """More than a record has at first room for, many of which the driver adds; nothing forgets
    them, as a lag moves."""
    agree(Bouncing(), {"x": 0.08, "v": -0.19}, 6.0, 1e-7)


def test_a_jump_in_a_history_is_found():
    """3 before -0.37, then 1: y' = -3 for 0.63, then -1."""
    history = {"y": lambda t: 1.0 if t > -0.37 else 3.0}
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 1), history=history, **TIGHT)
    assert run.final.y == pytest.approx(1 - 3 * 0.63 - 0.37, abs=1e-12)


def test_a_kink_in_a_history_is_found():
    """|t + 0.37| from -1 to 0: two triangles."""
    run = hy.simulate(
        delayed.Lagged(), {"y": 1.0}, (0, 1), history={"y": lambda t: abs(t + 0.37)}, **TIGHT
    )
    assert run.final.y == pytest.approx(1 - (0.63**2 + 0.37**2) / 2, abs=1e-11)


def test_a_history_is_not_asked_for_what_comes():
    """Its square root ends at the start."""
    history = {"y": lambda t: math.sqrt(-t)}
    run = hy.simulate(delayed.Lagged(tau=1e-4), {"y": 0.0}, (0, 1e-4), history=history, **TIGHT)
    assert run.final.y == pytest.approx(-2 / 3 * 1e-6, abs=1e-11)


def test_a_history_need_not_lead_to_the_start():
    """Then the start is a jump, whose echo is a kink."""
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 2), history={"y": 5.0}, **TIGHT)
    assert run(1.0).y == pytest.approx(-4.0, abs=1e-12)
    assert run.final.y == pytest.approx(-4.0 + 1.5, abs=1e-12)  # 1 - 5 s from 0 to 1


# ---------------------------------------------------------------------------------------
# what is refused

RUN = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 3))
BARE = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 3), save="jumps")


@pytest.mark.parametrize(
    ("history", "words"),
    [
        ({"z": 1.0}, "history of 'z'; the states are y"),
        ({"y": [1.0, 2.0]}, r"shape \(2,\); \(\) is due"),
        ({"y": lambda t: [1.0, 2.0]}, r"history at t = .*shape \(2,\)"),
        ("before", "history='before'"),
        (lambda t: {"y": "one"}, "history"),
        ({"y": lambda t: math.log(-t)}, "history at t = .*as far back as the lags reach"),
        (RUN, "from 0.0 to 3.0; .* starts at 5.0"),
    ],
)
def test_histories_that_are_refused(history, words):
    with pytest.raises(hy.OptionError, match=f"Lagged: .*{words}"):
        hy.simulate(delayed.Lagged(), {"y": 1.0}, (5, 8), history=history)


def test_a_history_without_dense_output_is_refused():
    with pytest.raises(hy.OptionError, match="save='dense'"):
        hy.simulate(delayed.Lagged(), {"y": 1.0}, (2, 3), history=BARE)


def test_a_history_of_another_model_is_refused():
    with pytest.raises(hy.OptionError, match="the states y, not x1, x2"):
        hy.simulate(Pyragas(), [3.0, 0.0], (2, 3), history=RUN)


@pytest.mark.parametrize(
    "history", [{"y": math.nan}, {"y": lambda t: 1.0 if t > -0.5 else math.nan}]
)
def test_a_history_that_is_too_short_is_refused(history):
    with pytest.raises(hy.FlowError, match="not finite; give a history that reaches back"):
        hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 1), history=history)


def test_a_rough_history_is_refused():
    """32 bits are rough at tolerances of 64; the remedy is named."""
    history = {"y": lambda t: np.float32(math.cos(t))}
    with pytest.raises(hy.FlowError, match=r"rough.*32 bits"):
        hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 1), history=history, **TIGHT)


def test_a_history_for_a_model_without_delays_is_refused():
    with pytest.raises(hy.OptionError, match=r"BouncingBall: history.*leave it out"):
        hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 1), history={"x": 1.0})


def test_a_negative_lag_is_refused():
    with pytest.raises(hy.FlowError, match=r"Lagged.*the lag tau is -1.0"):
        hy.simulate(delayed.Lagged(tau=-1.0), {"y": 1.0}, (0, 1))


def flow(body):
    """A class whose flow is ``body(past)``."""

    class Made(hy.Automaton):
        y = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s, past):
            return (body(s, past),)

    return Made


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (lambda s, past: past(np.array([1.0, 2.0])).y, r"shape \(2,\); one number is due"),
        (lambda s, past: past("1").y, "'1'; one number is due"),
        (lambda s, past: past.y, r"past\.y: past is a function, write past\(lag\)\.y"),
        (lambda s, past: past.z, r"past has no 'z'; write past\(lag\), and a state of it"),
        (lambda s, past: past(-1.0).y, "at least 0"),
        (lambda s, past: past(math.nan).y, "at least 0"),
        (lambda s, past: past(past(1.0).y).y, r"depends on past\(...\)"),
    ],
    ids=["array", "text", "no lag", "no state", "negative", "not a number", "nested"],
)
def test_lags_that_are_refused_when_a_class_is_defined(body, words):
    with pytest.raises(hy.DeclarationError, match=words):
        flow(body)


def test_a_past_under_another_name_is_refused():
    with pytest.raises(hy.DeclarationError, match="and past after them for delays"):

        class Made(hy.Automaton):
            y = hy.state()

            @hy.mode(initial=True)
            def flow(self, t, s, before):
                return (before(1.0).y,)


def test_a_proof_before_a_run_is_refused():
    pytest.importorskip("flint")
    with pytest.raises(hy.OptionError, match="Ball looks into the past"):
        hy.certify(delayed.Ball(), {"y": (0.0, 1.0), "v": (-1.0, 1.0)})


def test_a_look_back_leaves_the_record_as_it_was_whatever_happens_in_it(monkeypatch):
    """An error inside it, too: who catches that may go on with the run."""
    made = []
    monkeypatch.setattr(driver, "Memory", lambda *given: made.append(Memory(*given)) or made[-1])
    hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 3.0))
    memory = made[0]

    def kept():
        arrays = memory.floats, memory.ints, memory.shown, memory.pieces.ends, memory.breaks.times
        return [array.tolist() for array in arrays], memory.told

    def look():
        with memory.as_at(2.5, np.array([0.0])):
            assert kept() != before
            raise ZeroDivisionError

    before = kept()
    with pytest.raises(ZeroDivisionError):
        look()
    assert kept() == before


class Swung(hy.Automaton):
    """``y'' = -y - 0.2 y'(t - 1 - sin(t) / 2)``, pushed on where ``y`` is 0.1."""

    y = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def swings(self, t, s, past):
        return s.v, -s.y - 0.2 * past(1.0 + 0.5 * jnp.sin(t)).v

    @hy.edge(swings, to=swings, guard=lambda self, t, s: s.y - 0.1, crossing=hy.EITHER)
    def push(self, t, s):
        return s.replace(v=1.1 * s.v)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_an_edge_that_waits_for_either_sign_fires_at_zeros_only(solver):
    """Windows end between a jump and the next zero, in whose steps that zero is seen ahead."""
    run = hy.simulate(Swung(), {"y": 1.0, "v": 0.0}, (0.0, 20.0), solver=solver, **TIGHT)
    assert len(run.jumps) == 7
    # landed on to the spacing of times, at speeds of about 1
    np.testing.assert_allclose([jump.before.y for jump in run.jumps], 0.1, atol=1e-13)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_an_interrupted_run_keeps_the_arc_that_goes_on_through_windows(solver):
    """It was stopped beyond 2, without a jump since the start: the rules' own loop tells how far it
    is when so many steps have filled its arrays."""

    def stop(t):
        if t > 2.0:
            raise KeyboardInterrupt

    model, start = moving(lambda t, y: 1.0 + 0.2 * t), {"y": 1.0}
    options = {"solver": solver, "max_step": 5e-3, **TIGHT}
    run = hy.simulate(model, start, (0.0, 6.0), progress=stop, **options)
    whole = hy.simulate(model, start, (0.0, 6.0), **options)
    assert 2.0 < run.t1 < 6.0
    assert len(run.arcs) == 1
    assert run.final.y == pytest.approx(whole(run.t1).y, abs=1e-9)


@pytest.mark.parametrize("tau", [1.0, 0.01])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_run_that_is_interrupted_where_it_ends_keeps_its_last_arc(solver, tau):
    """A call of the rules' own loop may have flown all of it; its last time is told."""

    def stop(t):
        if t >= 3.0:
            raise KeyboardInterrupt

    run = hy.simulate(delayed.Lagged(tau=tau), {"y": 1.0}, (0, 3), solver=solver, progress=stop)
    assert run.status is hy.Status.INTERRUPTED
    assert run.t1 == 3.0
    assert len(run.arcs) == 1


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_kicked_run_that_is_interrupted_keeps_the_arc_after_the_kick(solver):
    """The arcs before it are kept anyway. A call of the rules' own loop flies through many."""

    def stop(t):
        if t > 2.0:
            raise KeyboardInterrupt

    asked = {"start": {"y": 1.0, "v": 0.0}, "solver": solver, **TIGHT}
    run = hy.simulate(Swung(), t=(0.0, 30.0), progress=stop, **asked)
    whole = hy.simulate(Swung(), t=(0.0, 30.0), **asked)
    assert len(run.jumps) > 0
    assert run.t1 > max(2.0, run.jumps[-1].t)
    assert len(run.arcs) == len(run.jumps) + 1
    assert run.final.y == pytest.approx(whole(run.t1).y, abs=1e-9)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_run_out_of_steps_keeps_the_arc_that_goes_on_through_windows(solver):
    """It has come somewhere, and is there what the whole run is."""
    model = moving(lambda t, y: 1.0 + 0.2 * t)
    lanes = hy.ensemble(model, {"y": [1.0]}, (0.0, 6.0), solver=solver, max_steps=3, **TIGHT)
    whole = hy.simulate(model, {"y": 1.0}, (0.0, 6.0), solver=solver, **TIGHT)
    assert lanes.status.item() == "max_steps"
    assert 0.0 < lanes.t.item() < 6.0
    assert lanes.y.item() == pytest.approx(whole(lanes.t.item()).y, abs=1e-9)
