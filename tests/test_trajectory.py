"""The record of a run: times, sides, arcs, tables, options."""

import itertools
import math

import numpy as np
import pytest

import hybrid as hy
from hybrid.solvers.diffrax_objects import DiffraxStepper
from hybrid.solvers.scipy_backend import RungeKuttaStepper
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall

from . import systems


@pytest.fixture(scope="module")
def run():
    return hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), rtol=1e-10)


def test_both_sides_of_a_jump(run):
    """At an impact ``side`` picks the state; ``j`` picks the arc."""
    t = run.jumps.t[0]
    before, after = run(t, side="left"), run(t, side="right")
    assert before.v == run.jumps[0].before.v == run(t, 0).v
    assert after.v == run.jumps[0].after.v == run(t, 1).v
    assert after.v == pytest.approx(-0.7 * before.v, rel=1e-14)


def test_arrays_of_times_have_their_shape(run):
    """Fields of the record have the shape of the times; values equal those one by one."""
    times = np.linspace(0, 3, 12).reshape(3, 4)
    record = run(times)
    assert record.x.shape == (3, 4)
    for t, x in zip(times.ravel(), record.x.ravel(), strict=True):
        assert run(t).x == pytest.approx(float(x), abs=1e-15)


def test_columns_and_rows_of_the_jump_table(run):
    """``run.jumps.t`` is an array; ``run.jumps[3]`` a jump; slices work."""
    jumps = run.jumps
    assert jumps.t.shape == (len(jumps),) == jumps.before.v.shape
    assert jumps[3].t == jumps.t[3]
    assert [jump.j for jump in jumps[1:4]] == [1, 2, 3]
    assert jumps[-1].j == len(jumps) - 1
    assert set(jumps.edge) == {"impact"}
    assert "103 jumps" in repr(jumps)


def test_arcs_are_joined_by_jumps(run):
    """Each arc starts where its jump leads, at the time of that, and j counts them."""
    arcs = run.arcs
    assert [arc.j for arc in arcs[:-1]] == list(range(len(arcs) - 1))
    for jump, before, arc in zip(run.jumps, arcs[:-2], arcs[1:-1], strict=True):
        assert before.t1 == jump.t == arc.t0
        assert np.all(before.last == np.array([jump.before.x, jump.before.v]))
    assert arcs[-2].t1 == arcs[-1].t0 == run.zeno[0].t
    assert arcs[-1].mode == "flight.rest(impact)"


@pytest.mark.parametrize("solver", ["scipy", "taylor", "diffrax"])
def test_a_run_ends_at_the_very_time_asked_for(solver):
    """Where durations round, and where the last one is far longer than the last time is late."""
    rng = np.random.default_rng(7)
    for t0 in [0.0, *rng.uniform(-20, 5, 12)]:
        t1 = t0 + float(rng.uniform(4, 20))
        times = np.array([t0, 0.5 * (t0 + t1), t1])
        start = {"x": 1.0, "v": 0.0}
        run = hy.simulate(BouncingBall(), start, (t0, t1), solver=solver, save=times)
        assert run.t1 == run.arcs[-1].t1 == t1
        assert len(run(times).x) == 3


def test_the_trajectory_obeys_its_flow_guard_and_reset(run):
    """Residuals of the dense output: x' = v, v' = -g, gap >= 0."""
    times = np.linspace(0.01, 2.4, 200)
    h = 1e-5
    inside = [t for t in times if not np.any(np.abs(run.jumps.t - t) < 2 * h)]
    for t in inside:
        slope = (run(t + h).x - run(t - h).x) / (2 * h)
        assert slope == pytest.approx(float(run(t).v), abs=1e-8)
    assert np.all(run(np.linspace(0, 3, 999)).x >= -1e-12)


def test_times_outside_the_run_are_refused(run):
    """With the run's own times in the message."""
    with pytest.raises(hy.OptionError, match=r"outside the run \[0.0, 3.0\]"):
        run(3.5)
    with pytest.raises(hy.OptionError, match="side='middle'"):
        run(1.0, side="middle")
    with pytest.raises(hy.OptionError, match="has arcs 0 to"):
        run(1.0, 4000)


def test_saving_only_what_is_asked_for():
    """``save="jumps"`` keeps no dense output; an array keeps the states at its times."""
    lean = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), save="jumps")
    assert all(not arc.segments for arc in lean.arcs if "rest" in arc.mode)
    with pytest.raises(hy.OptionError, match="use save='dense'"):
        lean(0.2)
    times = np.linspace(0, 3, 31)
    sampled = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), save=times).to_xarray()
    dense = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3))(times)
    np.testing.assert_allclose(sampled.x.values, dense.x, atol=1e-14)
    np.testing.assert_array_equal(sampled.time.values, times)
    kept = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), save=[0.0, 1.0, 2.0])
    assert kept(1.0).x == kept.samples[1, 0]
    assert kept(3.0).x == 0.0
    with pytest.raises(hy.OptionError, match="at the times asked for"):
        kept(0.3)
    assert len(lean.to_xarray().time) >= 2 * len(lean.arcs)
    flying = hy.simulate(BouncingBall(r=1.0), [1.0, 0.0], (0, 1), save=[0.2, 1.0])
    assert flying.to_xarray().x.values[-1] == flying.final.x


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "euler"}, "solver='euler': there are scipy, diffrax, taylor"),
        ({"method": "RK99"}, "method='RK99': solver 'scipy' has DOP853, RK45"),
        ({"rtol": -1.0}, "rtol=-1.0: a number between 0 and 1"),
        ({"atol": [1e-9] * 3}, "one for each of the 2 elements"),
        ({"zeno": "maybe"}, "zeno='maybe': one of 'rest', 'stop'"),
        ({"max_jumps": 0}, "max_jumps=0: a whole number, 1 or more, or None"),
        ({"save": [3.0, 2.0]}, "increasing times within t"),
        ({"mode": "fly"}, r"mode='fly'; there are flight, flight.rest\(impact\)"),
        ({"history": {"x": 1.0}}, "looks into the past"),
        ({"memory": "lose"}, "memory='lose': 'keep' or 'restart'"),
    ],
)
def test_options_that_cannot_be_used(options, message):
    """One line with what can."""
    with pytest.raises(hy.OptionError, match=message):
        hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), **options)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"x": 1.0}, "no value for v; the states are x, v"),
        ({"x": 1.0, "v": 0.0, "w": 0.0}, "unknown state 'w'"),
        ([1.0], "one value for 2 states"),
        ({"x": "high", "v": 0.0}, "start x = 'high' is no number"),
        ({"x": float("nan"), "v": 0.0}, "is not finite"),
        ({"x": [1.0, 2.0], "v": 0.0}, r"has shape \(2,\); \(\) is due"),
    ],
)
def test_starts_that_cannot_be_used(start, message):
    """Names the model, the state and the value."""
    with pytest.raises(hy.StartError, match=message):
        hy.simulate(BouncingBall(), start, (0, 3))


def test_a_class_in_place_of_a_model():
    """A common slip, with its remedy."""
    with pytest.raises(hy.OptionError, match=r"give an instance of the model: BouncingBall\(\)"):
        hy.simulate(BouncingBall, [1.0, 0.0], (0, 3))


def test_zeno_stop_raise_and_max_jumps():
    """The caller's choice at an accumulation, and the sentences that go with it."""
    stopped = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), zeno="stop")
    assert stopped.status is hy.Status.ZENO_STOPPED
    assert stopped.t1 == stopped.zeno[0].t
    with pytest.raises(hy.ZenoError, match=r"accumulate at t_inf = 2\.5586.* ratio 0\.7"):
        hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3), zeno="raise")
    short = hy.simulate(BouncingBall(r=1.0), [1.0, 0.0], (0, 99), max_jumps=5)
    assert short.status is hy.Status.MAX_JUMPS
    assert len(short.jumps) == 5


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_run_of_so_many_jumps_ends_behind_the_last(solver):
    """In the state and the mode after it, as a lane does."""
    options = {"max_jumps": 3, "zeno": "ignore", "solver": solver}
    ball = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 9), **options)
    assert ball.final == ball.jumps[-1].after
    assert ball.final.v > 0.0
    lane = hy.ensemble(BouncingBall(), {"x": [1.0], "v": 0.0}, (0, 9), **options)
    # a lane by SciPy's tables sums its stages in another order: in each of four arcs some roundings
    # of each of twelve stages, others on other processors
    close = 0.0 if solver == "taylor" else 4e-14
    found, due = [lane.t.item(), lane.v.item()], [ball.t1, float(ball.final.v)]
    assert found == pytest.approx(due, rel=close, abs=0.0)
    assert lane.x.item() == pytest.approx(float(ball.final.x), rel=0.0, abs=close)
    heated = hy.simulate(systems.Thermostat(), {"T": 18.0}, (0, 9), max_jumps=1, solver=solver)
    assert heated.mode == "off"


def test_a_contact_that_does_not_rest_ends_the_run():
    """rests=False: the run ends at the accumulation and says why."""

    class NoRest(systems.LawBall):
        impact = hy.contact("flight", gap=lambda self, t, s: s.x, restitution=0.5, rests=False)

    run = hy.simulate(NoRest(), {"x": 1.0, "v": 0.0}, (0, 9))
    assert run.status is hy.Status.NO_REST
    assert run.t1 == pytest.approx(3.0, rel=1e-12)


def test_truncation_reports_its_distance(reference):
    """Section 2 of the paper: [1/r] impacts, then held; the gap to the full series."""
    from models.hard_spring import HardSpring

    for row in reference["section_2"]["rows"]:
        r = 1 / 3 if row["r"] == "1/3" else float(row["r"])
        run = hy.simulate(
            HardSpring(r=r), [2.1, 0.0], (0, 3), zeno="truncate", rtol=1e-12, atol=1e-12
        )
        cut = run.zeno[0].truncation
        assert cut.impacts == row["[1/r]"]
        assert run.zeno[0].t == pytest.approx(float(row["theta_[1/r]"]), abs=1e-11)
        assert cut.gap == pytest.approx(float(row["gap=theta_inf-theta_[1/r]"]), rel=1e-8)
        height = float(row["max_height_missed(after impact N)"])
        assert cut.height == pytest.approx(height, rel=1e-2)  # the largest of 65 samples
        assert run.final.x == 2.0
        assert "cut off after" in repr(run.zeno[0])
        run.to_xarray()


def test_a_series_cut_off_in_a_run_too_short_for_it_says_so():
    """The distance to its end is not known then, and no number stands for it."""
    from models.bouncing_ball import BouncingBall

    ball, start = BouncingBall(g=2.0, r=0.5), {"x": 1.0, "v": 0.0}  # t_inf = 3
    run = hy.simulate(ball, start, (0, 2.5), zeno="truncate")
    assert math.isnan(run.zeno[0].truncation.t_inf)
    assert "it would have gone on to another jump or to the end of the run" in run.explain()


def test_what_is_cut_off_may_rise_higher_later():
    """A table throws a bead higher than the first impact left out; all flights are looked at."""
    model, start, span = BeadOnTable(amplitude=0.2, omega=7.0, r=0.7), {"x": 1.0, "v": 0.0}, (0, 6)
    cut = hy.simulate(model, start, span, zeno="truncate", max_jumps=1, rtol=1e-12).zeno[0]
    full = hy.simulate(model, start, span, rtol=1e-12, zeno="stop")
    times = np.linspace(cut.t, full.t1, 4001)
    highest = (full(times).x - 0.2 * np.sin(7.0 * times)).max()
    assert math.isfinite(cut.truncation.t_inf)
    assert highest <= cut.truncation.height < 1.0001 * highest


class Corner(hy.Automaton):
    """A ball that strikes a wall while it bounces."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0, s.w, 0.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
    wall = hy.contact(flight, gap=lambda self, t, s: 1.0 - s.y, restitution=0.5)


@pytest.mark.parametrize(("w", "ends"), [(0.45, False), (0.05, True)])
def test_a_series_cut_off_ends_at_another_jump(w, ends):
    """Impacts that accumulate after that are another series (the floor's would, at t = 3)."""
    start = {"x": 1.0, "v": 0.0, "y": 0.0, "w": w}
    run = hy.simulate(Corner(), start, (0, 5), zeno="truncate", max_jumps=1)
    cut = run.zeno[0].truncation
    assert cut.t_inf == pytest.approx(3.0 if ends else math.nan, nan_ok=True)
    assert cut.height == pytest.approx(0.25)


def test_the_floor_of_one_over_r_is_exact():
    """1/r for r = 1/n rounds below n for some n; the cap is n all the same."""
    from hybrid.run.truncate import permitted

    assert all(permitted(1.0 / n) == n for n in range(1, 200))


def test_a_flow_that_is_not_finite_is_named(solver):
    """Model, mode, time and state, on every solver."""
    import jax.numpy as jnp

    class Root(hy.Automaton):
        x = hy.state()

        @hy.mode
        def grow(self, t, s):
            return jnp.sqrt(1.0 - s.x) + 1.0

    with pytest.raises(hy.FlowError, match=r"Root, mode grow, t = 0\.61.*not finite"):
        hy.simulate(Root(), {"x": 0.0}, (0, 3), **solver)


def test_zero_times_not_a_number_is_not_zero(solver):
    """As in IEEE arithmetic: 0 * sqrt(1 - x) is not finite for x > 1, so the run must stop."""
    import jax.numpy as jnp

    class Hidden(hy.Automaton):
        x = hy.state()
        k = hy.parameter(0.0)

        @hy.mode
        def grow(self, t, s):
            return jnp.sqrt(1.0 - s.x) * self.k + jnp.sqrt(1.0 - s.x) * 0.0 + 1.0

    with pytest.raises(hy.FlowError, match="not finite"):
        hy.simulate(Hidden(), {"x": 0.9}, (0, 3), **solver)


def test_an_interrupted_run_keeps_what_it_has():
    """Ctrl-C in the progress callback: status and arcs so far."""

    def stop(t):
        if t > 5.0:
            raise KeyboardInterrupt

    run = hy.simulate(BouncingBall(r=1.0), [1.0, 0.0], (0, 99), progress=stop)
    assert run.status is hy.Status.INTERRUPTED
    assert 5.0 < run.t1 < 7.0


@pytest.mark.parametrize("solver", ["scipy", "diffrax"])
def test_an_interrupted_arc_is_kept_as_far_as_it_was_flown(solver, monkeypatch):
    """Ctrl-C in the middle of an arc: the arc ends at the last step made, and can be read."""
    steps = itertools.count()

    def stop(*_):
        if next(steps) > 3:
            raise KeyboardInterrupt

    for stepper in (RungeKuttaStepper, DiffraxStepper):
        monkeypatch.setattr(stepper, "step", _then(stepper.step, stop))
    model = systems.Oscillator(wall=-5.0)
    run = hy.simulate(model, {"x": 1.0, "v": 0.0}, (0, 9999), solver=solver)
    assert run.status is hy.Status.INTERRUPTED
    assert 0.5 < run.t1 < 2000.0
    assert abs(run.final.x - math.cos(run.t1)) < 1e-5  # 1e-8 a step, and thousands of steps


def _then(first, second):
    def both(*arguments):
        first(*arguments)
        second()

    return both


@pytest.mark.parametrize("analysis", ["orbit", "lyapunov", "map"])
def test_an_interrupt_of_what_an_analysis_flies_goes_on_to_the_caller(analysis, monkeypatch):
    """What the run has until then is no motion to go on with."""
    model, start = systems.Oscillator(wall=-5.0), {"x": 1.0, "v": 0.0}
    steps = itertools.count()

    def stop(*_):
        if next(steps) > 30:
            raise KeyboardInterrupt

    monkeypatch.setattr(RungeKuttaStepper, "step", _then(RungeKuttaStepper.step, stop))
    call = {
        "orbit": lambda: hy.periodic_orbit(
            model, start, period=2.0 * math.pi, settle=50, solver="scipy"
        ),
        "lyapunov": lambda: hy.lyapunov(model, start, (0.0, 300.0), solver="scipy"),
        "map": lambda: hy.return_map(model, lambda self, t, s: s.x, solver="scipy").iterate(
            start, 50
        ),
    }[analysis]
    with pytest.raises(KeyboardInterrupt):
        call()


def test_explain_says_what_happened():
    """Contact, ratio, times, what came next."""
    run = hy.simulate(BeadOnTable(r=0.3, omega=4.0), {"x": 1.5, "v": 0.0}, (0, 3))
    text = run.explain()
    for part in ("impact", "ratio 0.3", "flight.rest(impact)", "released at t = 1.7356"):
        assert part in text


def test_reading_at_the_listed_times_of_a_tail():
    """At every well separated impact both sides are the ones listed; j picks the arc."""
    run = hy.simulate(BouncingBall(r=0.5), {"x": 1.0, "v": 0.0}, (0, 3))
    for jump in run.jumps[:30]:
        assert run(jump.t).v >= 0
        assert run(jump.t, side="left").v <= 0
    assert run(2.9, run.arcs[-1].j).x == 0.0
    sampled = hy.simulate(BouncingBall(r=0.5), [1.0, 0.0], (0, 3), save=run.jumps.t[:20])
    assert np.all(sampled.to_xarray().v.values > 0)


@pytest.mark.parametrize(("solver", "rtol"), [("taylor", 1e-3), ("taylor", 1e-6), ("scipy", 1e-8)])
def test_flights_of_a_sum_are_listed_as_they_are_made(solver, rtol):
    """The table turns by 1 to 3 rad in the first flight that is summed, which several series make:
    of free fall a series never ends, but that of the gap does. Each arc ends at the next jump, and
    is the parabola from the last, to the tolerance and to rounding."""
    draw = np.random.default_rng(3)
    for _ in range(20):
        omega = 10 ** draw.uniform(1.5, 2.5)
        push = 10 ** draw.uniform(-2.2, -0.8)
        table = BeadOnTable(r=draw.uniform(0.25, 0.5), amplitude=push * 9.8 / omega**2, omega=omega)
        start = {"x": draw.uniform(0.1, 1.0), "v": 0.0}
        run = hy.simulate(table, start, (draw.uniform(0.0, 1.0), 4.0), solver=solver, rtol=rtol)
        assert run.mode == "flight.rest(impact)"
        for jump, arc, after in zip(run.jumps[:8], run.arcs[1:9], run.arcs[2:10], strict=True):
            s, x, v = 0.5 * (after.t0 - arc.t0), jump.after.x, jump.after.v
            middle, off = run(arc.t0 + s), 1e-13 + rtol * s
            assert arc.t1 == after.t0
            assert middle.x == pytest.approx(x + v * s - 4.9 * s * s, abs=10 * off)
            assert middle.v == pytest.approx(v - 9.8 * s, abs=10 * off)


def test_the_listed_speeds_of_a_tail_keep_their_digits():
    """Down to the last impact listed, at 1e-15, speeds are r^n of the first, on both sides."""
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), solver="taylor")
    exact = math.sqrt(2 * 9.81) * 0.7 ** np.arange(len(run.jumps) + 1)
    np.testing.assert_allclose(run.jumps.before.v, -exact[:-1], rtol=1e-13)
    np.testing.assert_allclose(run.jumps.after.v, exact[1:], rtol=1e-13)
    assert exact[-1] < 1e-14


def test_a_sum_of_more_impacts_than_can_be_listed_is_counted_and_not_listed():
    """A ball that loses a billionth of its speed: 37 thousand million impacts before a double can
    tell them from the limit. A list of them was an error of numpy's."""
    run = hy.simulate(BouncingBall(r=1.0 - 1e-9), {"x": 1.0, "v": 0.0}, (0.0, 2e9), solver="taylor")
    assert "jumps listed" in repr(run)
    assert "jumps listed" in run.explain()
    with pytest.raises(
        hy.OptionError, match=r"contact impact, .* 3.6\d*e\+10 impacts of a sum .* run.final"
    ):
        run.jumps  # noqa: B018
    with pytest.raises(hy.OptionError, match="impacts of a sum"):
        run(1e8)
    assert run(1.9e9).x == 0.0
