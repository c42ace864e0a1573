"""Every rule of delays, on every solver."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.pyragas import Pyragas

from .. import delayed
from ..delay_truth import unit_lag, unit_lag_kicked
from .ways import later

#: Tolerances at which every solver keeps about eight digits.
TIGHT = {"rtol": 1e-9, "atol": 1e-11}

#: BDF and LSODA restart at order one at each breaking point, RK23 is of order 3.
LOOSE = {"BDF": 1e-6, "LSODA": 1e-6, "RK23": 1e-7}


def tolerance(solver, tight=1e-8):
    return LOOSE.get(solver.get("method"), tight)


def ends_of_segments(run):
    return np.array([arc.t0 + arc.low + s.end for arc in run.arcs for s in arc.segments])


@pytest.mark.each_method
def test_a_smooth_past_gives_the_exact_polynomials(solver):
    """y' = -y(t - 1), y = 1 before: a polynomial between whole times."""
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 4), **TIGHT, **solver)
    for t in (0.5, 1.0, 2.25, 4.0):
        assert run(t).y == pytest.approx(float(unit_lag(t)), abs=tolerance(solver))


@pytest.mark.each_method
def test_breaking_points_are_ends_of_segments(solver):
    """The start echoes at 1, 2, ... with an order more each time: steps end there."""
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 2.5), **TIGHT, **solver)
    ends = ends_of_segments(run)
    for t in (1.0, 2.0):
        assert np.abs(ends - t).min() <= 1e-15  # times of order one, to rounding


@pytest.mark.each_method
def test_a_jump_echoes_as_a_kink_a_lag_later(solver):
    """Raised at 1/2: the derivative jumps at 3/2, and there is the end of a step."""
    run = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 3), **TIGHT, **solver)
    assert run.jumps.t.tolist() == pytest.approx([0.5], abs=1e-15)
    assert np.abs(ends_of_segments(run) - 1.5).min() <= 2e-15
    assert run.final.y == pytest.approx(float(unit_lag_kicked(3)), abs=tolerance(solver))


def test_an_echo_is_no_jump(solver):
    """At a breaking point an arc goes on: one arc before the jump, one after it."""
    run = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 3), **solver)
    assert len(run.arcs) == 2


def test_a_restart_forgets(solver):
    """memory="restart": after the jump to 5/2 the state was always that: y' = -5/2 for a lag."""
    run = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 1.4), memory="restart", **TIGHT, **solver)
    assert run.final.y == pytest.approx(2.5 - 2.5 * 0.9, abs=tolerance(solver))


@pytest.mark.parametrize(
    "history",
    [{"y": 3.0}, {"y": lambda t: 3.0}, lambda t: {"y": 3.0}, lambda t: [3.0], [3.0]],
    ids=["number", "function", "function of all", "function, in order", "in order"],
)
def test_a_history_is_given_in_many_ways(history):
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 1), history=history)
    assert run.final.y == pytest.approx(-2.0, abs=1e-9)


def test_states_left_out_of_a_history_are_as_at_the_start():
    run = hy.simulate(delayed.Ball(k=1.0), {"y": 2.0, "v": 0.0}, (0, 1), history={"v": 9.0})
    assert run.final.y == pytest.approx(2.5, abs=1e-9)  # y'' = -1 + 2


@pytest.mark.parametrize("at", [0.3, 0.5 + 1e-9, 1.5, 1.7])
def test_a_run_goes_on_from_an_earlier_one(solver, at):
    """Split before a jump, right after it, at its echo and behind that: as if not split."""
    model = delayed.Kicked()
    options = {**TIGHT, **solver}
    first = hy.simulate(model, {"y": 1.0}, (0, at), **options)
    then = model if at < 0.5 else delayed.Lagged()
    second = hy.simulate(then, first.final, (at, 4), history=first, **options)
    assert second.final.y == pytest.approx(float(unit_lag_kicked(4)), abs=tolerance(solver))


def test_what_was_before_an_earlier_run_is_seen(solver):
    """Split after 0.3 of a lag of pi/2: the cosine of the first run's history is still needed."""
    model, history = delayed.Lagged(tau=np.pi / 2), {"y": jnp.cos}
    first = hy.simulate(model, {"y": 1.0}, (0, 0.3), history=history, **TIGHT, **solver)
    second = hy.simulate(model, first.final, (0.3, 3), history=first, **TIGHT, **solver)
    assert second.final.y == pytest.approx(np.cos(3), abs=10 * tolerance(solver))


@pytest.fixture(scope="module")
def lifted():
    """The Pyragas system that sticks and lifts."""
    return Pyragas(C=60.0, r=0.2)


@pytest.mark.parametrize("where", ["after an impact", "in the tail", "at rest", "after the lift"])
def test_a_run_is_split_anywhere(accurate, lifted, where):
    """The times of what follows are those of the run that was not split."""
    whole = hy.simulate(lifted, [2.5, 0.0], (0, 5), **accurate)
    point = whole.zeno[0]
    t = {
        "after an impact": float(whole.jumps.t[2]) + 1e-9,
        "in the tail": point.t - 1e-6,
        "at rest": point.t + 0.05,
        "after the lift": point.t_release + 1e-3,
    }[where]
    first = hy.simulate(lifted, [2.5, 0.0], (0, t), **accurate)
    second = hy.simulate(lifted, first.final, (t, 5), mode=first.mode, history=first, **accurate)
    assert second.zeno[-1].t == pytest.approx(whole.zeno[-1].t, abs=1e-10)
    assert second.zeno[-1].t_release == whole.zeno[-1].t_release  # both none


def test_lags_are_parameters(solver):
    """y' = -k y(t - tau): time in units of the lag."""
    model = delayed.Lagged(tau=0.25, k=4.0)
    run = hy.simulate(model, {"y": 1.0}, (0, 1), **TIGHT, **solver)
    assert run.final.y == pytest.approx(float(unit_lag(4)), abs=4 * tolerance(solver))


@pytest.mark.parametrize("model", [delayed.Falling, delayed.Rising, delayed.Either])
def test_a_guard_that_jumps_through_zero_fires_where_the_jump_arrives(solver, model):
    """y jumps at 1/2; a guard that sees it a lag of 1 later fires at 3/2, not after it."""
    run = hy.simulate(model(), {"y": 0.0, "z": 0.0}, (0, 3), **solver)
    assert run.jumps.edge.tolist() == ["up", "see"]
    assert run.jumps.t[1] == pytest.approx(1.5, abs=1e-15)
    assert run.final.z == pytest.approx(2.5, abs=1e-12)  # counted once, then 1.5 of slope one


@pytest.mark.parametrize("model", [delayed.Falling, delayed.Rising])
def test_a_guard_that_jumps_the_other_way_does_not_fire(model):
    """The guard is outside before the jump; inside after it: no edge, and no error."""
    with pytest.raises(hy.StartError, match="outside"):
        hy.simulate(model(), {"y": 1.0, "z": 0.0}, (0, 3))


def test_a_crossing_at_a_breaking_point_is_one_crossing(solver):
    """y falls through 1/2 at the time at which its derivative kinks: neither missed nor double."""
    run = hy.simulate(delayed.Touching(), {"y": 1.0, "z": 0.0}, (0, 1.9), **TIGHT, **solver)
    assert run.final.z == 1.0
    assert run.jumps.t[0] == pytest.approx(1.0, abs=10 * tolerance(solver))


def test_a_reset_sees_the_past(solver):
    """y = t until 2, then back to what was 1.5 ago, 1/2; again when it is 2, at 3.5."""
    run = hy.simulate(delayed.Recalled(), {"y": 0.0}, (0, 3), **solver)
    assert run.jumps.t.tolist() == pytest.approx([2.0], abs=1e-9)
    assert run.jumps.after.y[0] == pytest.approx(0.5, abs=1e-9)


def test_a_restitution_sees_the_past(solver):
    """From a height of 1 at rest: at sqrt 2 the ball was at 1 - (sqrt 2 - 1)^2 / 2 a lag ago."""
    run = hy.simulate(delayed.Echo(), {"y": 1.0, "v": 0.0}, (0, 1.5), **TIGHT, **solver)
    share = 0.5 + 0.1 * (1 - (np.sqrt(2) - 1) ** 2 / 2)
    assert run.jumps.after.v[0] == pytest.approx(share * np.sqrt(2), abs=tolerance(solver))


def test_a_gap_sees_the_past(solver):
    """The table rises as w did a lag ago: at rest on it, a ball is where w was."""
    start = {"w": 0.0, "y": 0.5, "v": 0.0}
    run = hy.simulate(delayed.Lift(), start, (0, 6), history={"w": 0.0}, **TIGHT, **solver)
    assert run.mode == "flight.rest(table)"
    assert run.final.y == pytest.approx(0.5, abs=tolerance(solver))  # w(5) = 0.5


def test_a_rest_ends_where_a_jump_arrives(solver):
    """The switch is thrown at 1/2 and pulls at 3/2, exactly: then 2 upwards."""
    start = {"u": 0.0, "y": 0.0, "v": 0.0}
    run = hy.simulate(delayed.Held(), start, (0, 2.5), **TIGHT, **solver)
    assert run.jumps.edge.tolist() == ["on", "ground.release"]
    assert run.jumps.t[1] == pytest.approx(1.5, abs=1e-15)
    assert run.final.y == pytest.approx(1.0, abs=tolerance(solver))


def test_an_accumulation_arrives_as_one_breaking_point(solver):
    """Impacts accumulate at t_inf; at t_inf + tau one step ends, not infinitely many."""
    run = hy.simulate(delayed.Ball(g=1.0, k=-0.5, tau=0.7, r=0.6), [1.0, 0.0], (0, 6.5), **solver)
    arrival = run.zeno[0].t + 0.7
    ends = ends_of_segments(run)
    assert np.abs(ends - arrival).min() <= 1e-14
    assert (ends > arrival - 0.1).sum() < 100


def test_two_modes_see_one_past(solver):
    """A relay with a delay: y turns a lag after each zero; a triangle of period 4 tau."""
    run = hy.simulate(delayed.Relay(), {"y": 0.5}, (0, 10), **solver)
    assert run.jumps.t.tolist() == pytest.approx([1.5, 3.5, 5.5, 7.5, 9.5], abs=1e-9)


def test_sliding_with_delays(solver):
    """The delayed drive is t - 1: from x = 0 it slides until the drive is 1, at t = 2."""
    start, history = {"x": 0.25, "d": 0.0}, {"d": lambda t: t}
    run = hy.simulate(delayed.Slider(), start, (0, 3), history=history, **TIGHT, **solver)
    assert run.jumps.edge.tolist() == ["zero", "zero.positive"]
    assert run.jumps.t[0] == pytest.approx(2 - np.sqrt(3.5), abs=tolerance(solver))
    assert run.jumps.t[1] == pytest.approx(2.0, abs=tolerance(solver))
    assert run.final.x == pytest.approx(0.5, abs=10 * tolerance(solver))


def test_what_is_saved_does_not_change_a_run(solver):
    """save: times or jumps only; the same numbers."""
    options = {**TIGHT, **solver}
    whole = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 3), **options)
    times = np.linspace(0.1, 2.9, 8)
    some = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 3), save=times, **options)
    ends = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 3), save="jumps", **options)
    np.testing.assert_allclose(some(times).y, whole(times).y, atol=1e-14)
    assert ends.final.y == some.final.y == whole.final.y


def test_max_jumps_stops_a_run_with_delays(solver):
    run = hy.simulate(delayed.Relay(), {"y": 0.5}, (0, 10), max_jumps=3, **solver)
    assert run.status is hy.Status.MAX_JUMPS
    assert len(run.jumps) == 3


BALL = delayed.Ball(g=1.0, k=-0.5, tau=0.7, r=0.6)


def test_a_run_with_delays_stops_at_an_accumulation(solver):
    run = hy.simulate(BALL, [1.0, 0.0], (0, 9), zeno="stop", **TIGHT, **solver)
    assert run.status is hy.Status.ZENO_STOPPED
    assert run.zeno[0].t == pytest.approx(5.537590124945491, abs=100 * tolerance(solver))


def test_a_run_with_delays_raises_at_an_accumulation():
    with pytest.raises(hy.ZenoError, match="Ball"):
        hy.simulate(BALL, [1.0, 0.0], (0, 9), zeno="raise")


def test_a_cut_series_with_delays_knows_what_it_leaves_out(accurate):
    """zeno="truncate": the full series, flown aside, sees the same past."""
    run = hy.simulate(BALL, [1.0, 0.0], (0, 9), zeno="truncate", max_jumps=4, **accurate)
    assert run.zeno[0].truncation.t_inf == pytest.approx(5.537590124945491, abs=1e-9)


@pytest.mark.parametrize("tau", [1e-13, *later(0.0, 1e-9)])
def test_rest_depends_smoothly_on_a_vanishing_lag(accurate, tau):
    """Lags below flights, steps and rounding: the rest is later by 2.33544 tau.

    The slope is that at tau = 1e-4; 2e-11 is what low flights lose in many short windows.
    """
    model = delayed.Ball(g=1.0, k=-0.5, tau=tau, r=0.6)
    run = hy.simulate(model, [1.0, 0.0], (0, 7), **accurate)
    assert run.zeno[0].t == pytest.approx(5.634175171119029 + 2.33544 * tau, abs=2e-11)
