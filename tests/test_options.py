"""The options of ``hy.simulate``, and what a run keeps of them."""

import gc
import json
import math
import warnings

import h5py
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hybrid as hy
from hybrid.solvers import Solver
from hybrid.solvers.base import FINEST
from models.bouncing_ball import BouncingBall

from .contract.test_cycles import Line, collapses
from .contract.ways import later
from .test_advance import SCENES

START, SPAN = {"x": 1.0, "v": 0.0}, (0.0, 3.0)


@pytest.mark.parametrize(
    ("options", "meant"),
    [
        ({}, (1e-8, 1e-10)),
        ({"method": "RK45"}, (1e-8, 1e-10)),
        ({"solver": "taylor"}, (1e-14, 1e-16)),
        ({"solver": "classic"}, (1e-8, 1e-10)),
        ({"solver": "taylor", "rtol": 1e-6}, (1e-6, 1e-16)),
        ({"rtol": 1e-6}, (1e-6, 1e-10)),
        ({"atol": 1e-3}, (1e-8, 1e-3)),
    ],
)
def test_a_solver_has_its_own_tolerances_where_none_are_given(options, meant):
    """``run.options`` has the numbers, never None."""
    run = hy.simulate(BouncingBall(), START, SPAN, **options)
    assert (run.options["rtol"], run.options["atol"]) == meant


def test_a_plugged_in_solver_declares_its_own(monkeypatch):
    """By an attribute of its class."""
    from .plugged import Classic

    monkeypatch.setattr(Classic, "own_rtol", 1e-5)
    run = hy.simulate(BouncingBall(), START, SPAN, solver="classic")
    assert (run.options["rtol"], run.options["atol"]) == (1e-5, 1e-5 / 100)
    assert Solver.own_rtol == 1e-8


class Delayed(hy.Automaton):
    """Wright's equation."""

    y = hy.state()

    @hy.mode
    def flow(self, t, s, past):
        return -1.5 * past(1.0).y * (1.0 + s.y)


def test_a_history_that_is_off_by_rounding_is_no_fault():
    """The time's, at t = 1000, is 1e-13, and fifty times that in the history."""
    history = lambda t: np.cos(50.0 * t)  # noqa: E731
    start = {"y": float(history(1000.0))}
    run = hy.simulate(Delayed(), start, (1000.0, 1002.0), history=history, solver="taylor")
    assert run.options["rtol"] == 1e-8
    other = hy.simulate(Delayed(), start, (1000.0, 1002.0), history=history, rtol=1e-10)
    # a run at 1e-8 beside one at 1e-10, over two delays
    assert run.final.y == pytest.approx(other.final.y, abs=1e-8)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("value", [0, 0.0, -1e-8, 1.0, math.inf, math.nan, "1e-8"])
def test_a_relative_tolerance_that_is_none_is_refused(solver, value):
    """The value is named."""
    with pytest.raises(hy.OptionError, match=r"rtol=.*a number between 0 and 1"):
        hy.simulate(BouncingBall(), START, SPAN, solver=solver, rtol=value)


@pytest.mark.parametrize("rtol", [1e-9, 1e-11, 1e-13])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_collapse_whose_gaps_drown_is_seen_at_any_tolerance(solver, rtol):
    """Rounding hides it before it is known to the tolerance; the bound says how well it is."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    start = {"x": np.array(x), "v": np.array(v)}
    run = hy.simulate(Line(r=0.05), start, (0.0, 3.0), solver=solver, rtol=rtol, atol=rtol)
    (point,) = run.zeno
    assert abs(point.t - collapses(0.05, x, v)[0]) <= point.t_error < 1e-9


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_tolerance_that_no_step_can_meet_is_told(solver):
    """Of 1e-16, with what is kept to; the finest that is kept to is no cause for a word."""
    least = {"taylor": 1e-14}.get(solver, FINEST)
    for options in ({"rtol": least}, {"rtol": 1e-16}):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            hy.simulate(BouncingBall(), START, (0.0, 0.1), solver=solver, **options)
        said = [str(each.message) for each in told if "double precision" in str(each.message)]
        assert len(said) == (options["rtol"] < least)
    words = "BouncingBall: rtol=1e-16 is finer than steps in double precision can be; they keep to"
    assert said == [f"{words} {least:g}"]


def test_tolerances_that_are_none_are_the_defaults_of_maps_and_orbits():
    """A caller who hands on what it was given."""
    given = {"t_max": 5.0, "rtol": None, "atol": None}
    state = {"x": 0.0, "v": 3.0}
    default = hy.return_map(BouncingBall(), "impact", t_max=5.0)(state)
    assert hy.return_map(BouncingBall(), "impact", **given)(state).v == default.v


class Gust(hy.Automaton):
    """A body that a gust of one width in ``at`` pushes against a wall."""

    x = hy.state()
    v = hy.state()
    width: float = hy.parameter(0.01)

    @hy.mode
    def flight(self, t, s):
        gust = jnp.exp(-(((t - 5.0) / self.width) ** 2)) / self.width
        return s.v, -gust

    wall = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


LOW = [{"method": "RK45"}, {"method": "Radau"}, {"method": "LSODA"}, {"method": "BDF"}]
WAYS = [{}, *LOW, {"solver": "taylor"}, {"solver": "classic"}, {"solver": "diffrax"}]


def lengths(run):
    """Of all steps."""
    return np.array([s.length for arc in run.parts for s in arc.segments])


@pytest.mark.parametrize("options", WAYS, ids=str)
def test_no_step_is_longer_than_max_step(options):
    """But for what landing on a guard adds, a millionth of the step."""
    run = hy.simulate(Gust(), {"x": 1.0, "v": 0.0}, (0.0, 9.0), max_step=0.05, **options)
    assert np.all(lengths(run) <= 0.05 * (1 + 1e-6))
    assert len(lengths(run)) >= 180


@pytest.mark.parametrize("options", WAYS, ids=str)
def test_steps_are_bounded_where_nobody_looks_at_them(options):
    """No guard, no dense output: a pulse is seen that is a thousandth of the run."""
    run = hy.simulate(Free(), {"x": 1.0}, (0.0, 9.0), save="jumps", max_step=0.01, **options)
    # BDF and LSODA, of low order after the pulse begins, lose most
    assert run.final.x == pytest.approx(1.0 + math.sqrt(math.pi) * 0.01, abs=1e-5)
    assert run.t1 == 9.0


class Free(hy.Automaton):
    """A state that moves in a pulse only."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return jnp.exp(-(((t - 5.0) / 0.01) ** 2))


@pytest.mark.parametrize("options", [{}, {"method": "LSODA"}, {"solver": "classic"}], ids=str)
def test_max_step_shows_a_gust_that_is_stepped_over(options):
    """A hundredth of a second in ten, which steps pass over without a sign."""
    start, span = {"x": 1.0, "v": 0.0}, (0.0, 5.5)
    assert hy.simulate(Gust(), start, span, **options).final.x == 1.0
    run = hy.simulate(Gust(), start, span, max_step=0.01, **options)
    # from the middle of the gust on, at the speed that its area gives; LSODA loses 1e-6 a step
    assert run.final.x == pytest.approx(1.0 - math.sqrt(math.pi) * 0.5, abs=1e-5)


@pytest.mark.parametrize("options", WAYS, ids=str)
def test_the_first_step_holds_after_each_jump(options):
    """Each arc is begun with it, or with less."""
    run = hy.simulate(Gust(width=1.0), {"x": 1.0, "v": 0.0}, (0.0, 9.0), first_step=1e-3, **options)
    firsts = [arc.segments[0].length for arc in run.parts if arc.segments]
    assert len(firsts) > 1
    assert max(firsts) <= 1e-3 * (1 + 1e-6)
    assert max(lengths(run)) > 1e-2


@pytest.mark.parametrize("name", ["max_step", "first_step"])
@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan, "0.1", [0.1]])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_step_that_is_no_length_is_refused(solver, name, value):
    """The option and the value are named."""
    with pytest.raises(hy.OptionError, match=rf"{name}=.*a finite time greater than 0"):
        hy.simulate(BouncingBall(), START, SPAN, solver=solver, **{name: value})


def test_a_step_below_the_spacing_of_times_is_refused():
    """It would never come to the end."""
    with pytest.raises(hy.OptionError, match="times here are"):
        hy.simulate(BouncingBall(), START, (1e6, 1e6 + 1), max_step=1e-12)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_an_accumulation_is_found_and_bounded_with_short_steps(solver):
    """The runs that measure its error included."""
    run = hy.simulate(BouncingBall(), START, SPAN, solver=solver, max_step=1e-2)
    assert abs(run.zeno[0].t - 2.5586339655858085) <= run.zeno[0].t_error < 1e-9


COUNTED = [{}, {"method": "RK45"}, {"method": "RK23"}]


class Fast(hy.Automaton):
    """A swing whose steps are rejected now and then."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flow(self, t, s):
        return s.v, -s.x * (1.0 + 50.0 * jnp.sin(t) ** 8)


@pytest.mark.parametrize("options", COUNTED, ids=str)
def test_steps_and_evaluations_are_those_of_scipy(options):
    """``solve_ivp``'s own count, from the same first step."""
    method = {"method": "DOP853", **options}["method"]
    span, first = (0.0, 20.0), 1e-3
    run = hy.simulate(
        Fast(), [1.0, 0.0], span, save="jumps", first_step=first, rtol=1e-6, atol=1e-9, **options
    )
    flow = lambda t, x: [x[1], -x[0] * (1.0 + 50.0 * math.sin(t) ** 8)]  # noqa: E731
    bare = solve_ivp(flow, span, [1.0, 0.0], method, first_step=first, rtol=1e-6, atol=1e-9)
    assert run.stats.steps == len(bare.t) - 1
    assert run.stats.rejected > 0
    # SciPy asks for the flow once more where it starts
    assert abs(run.stats.evaluations - bare.nfev) <= 1


@pytest.mark.parametrize("options", WAYS, ids=str)
def test_the_steps_are_those_of_the_dense_output(options):
    """What cannot be known is None, and never a guess."""
    run = hy.simulate(Gust(width=1.0), {"x": 1.0, "v": 0.0}, (0.0, 9.0), **options)
    stats = run.stats
    assert stats.steps == len(lengths(run)) > 10
    solver = options.get("solver", "scipy")
    silent = solver in ("diffrax", "classic")
    assert (stats.rejected is None) == (solver == "classic" or options in LOW[1:])
    assert (stats.evaluations is None) == silent
    assert stats.evaluations is None or stats.evaluations >= stats.steps
    assert 0.0 < stats.seconds < 600.0
    assert str(stats).count("\n") == 0
    assert f"{stats.steps:,} steps" in str(stats)


@pytest.mark.parametrize("options", WAYS, ids=str)
def test_steps_are_counted_where_nothing_is_kept(options):
    """As many as with dense output."""
    kept, bare = (
        hy.simulate(Free(), {"x": 1.0}, (0.0, 9.0), save=save, max_step=0.1, **options).stats
        for save in ("dense", "jumps")
    )
    # a step that ends within rounding of the end of the run may leave one more
    assert abs(bare.steps - kept.steps) <= 1
    assert kept.steps >= 90


@pytest.mark.parametrize("method", ["Tsit5", *later("Kvaerno5")])
def test_what_a_long_run_rejects_is_counted(method):
    """With Diffrax: in a hundred arcs, and no step that is made twice."""
    model, start, _ = SCENES["duffing"]
    options = {"solver": "diffrax", "method": method, "max_jumps": 300}
    run = hy.simulate(model, start, (0.0, 300.0), **options)
    assert len(run.arcs) > 100
    assert 0 < run.stats.rejected < run.stats.steps == len(lengths(run))


def test_taylor_of_diffrax_is_the_solver_taylor():
    """The same run, with a warning that names it."""
    ball, start, span = BouncingBall(), START, SPAN
    with pytest.warns(FutureWarning, match="solver='taylor'") as told:
        old = hy.simulate(ball, start, span, solver="diffrax", method="Taylor")
    assert [warning.filename for warning in told] == [__file__]
    new = hy.simulate(ball, start, span, solver="taylor")
    assert old.options == new.options
    assert old.jumps.t.tolist() == new.jumps.t.tolist()


def test_expansions_of_the_rules_own_loop_are_counted():
    """One for each step, and for the few that are tried and flown anew."""
    run = hy.simulate(Gust(width=3.0), {"x": 1.0, "v": 0.0}, (0.0, 9.0), solver="taylor")
    assert run.stats.steps <= run.stats.evaluations <= 2 * run.stats.steps
    assert run.stats.rejected == 0


def test_a_run_keeps_what_it_was_made_with(tmp_path):
    """Options, versions and cost, in the file as well."""
    asked = {"max_step": 0.1, "first_step": 1e-3, "max_jumps": 9, "zeno": "stop", "memory": "keep"}
    run = hy.simulate(BouncingBall(), START, SPAN, **asked)
    rest = {"solver": "scipy", "method": "DOP853", "rtol": 1e-8, "atol": 1e-10}
    assert run.options == {**asked, **rest, "save": "dense", "mode": "flight"}
    assert run.versions["numpy"] == np.__version__
    assert run.versions["hybrid"] == hy.__version__
    assert {"python", "scipy", "jax", "diffrax", "numba"} <= set(run.versions)
    run.save(tmp_path / "run.nc")
    again = hy.load(tmp_path / "run.nc")
    assert again.options == run.options
    assert again.versions == run.versions
    assert again.stats == run.stats


@pytest.mark.parametrize("options", [{}, {"atol": [1e-9, 1e-7]}, {"solver": "taylor"}], ids=str)
def test_the_options_of_a_run_make_it_again(tmp_path, options):
    """As they are kept, and as they are read from its file."""
    run = hy.simulate(BouncingBall(), START, SPAN, max_step=0.1, **options)
    run.save(tmp_path / "run.nc")
    for known in (run.options, hy.load(tmp_path / "run.nc").options):
        again = hy.simulate(BouncingBall(), START, SPAN, **known)
        assert again.final == run.final
        assert np.all(again.jumps.t == run.jumps.t)


def test_a_file_that_does_not_say_what_it_was_made_with_is_read(tmp_path):
    """As they once were."""
    run = hy.simulate(BouncingBall(), START, SPAN)
    run.save(tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc", "r+") as file:
        meta = json.loads(file.attrs["meta"])
        del meta["stats"], meta["versions"], meta["options"]["max_step"]
        file.attrs["meta"] = json.dumps(meta)
    older = hy.load(tmp_path / "run.nc")
    assert (older.stats, older.versions) == (None, {})
    assert older.zeno[0].t == run.zeno[0].t


@pytest.mark.parametrize("stats", [[], {}, {"steps": "many"}, 7])
def test_a_file_whose_cost_is_damaged_is_refused(tmp_path, stats):
    """With the package's own error."""
    hy.simulate(BouncingBall(), START, SPAN).save(tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc", "r+") as file:
        meta = json.loads(file.attrs["meta"])
        file.attrs["meta"] = json.dumps({**meta, "stats": stats})
    with pytest.raises(hy.StoreError, match="cannot read"):
        hy.load(tmp_path / "run.nc")


def test_a_run_leaves_no_circles_behind():
    """What is kept of it is freed with it, without a pass of the garbage collector."""

    def run():
        return hy.simulate(BouncingBall(), START, SPAN, solver="taylor").zeno[0]

    run()
    gc.collect()
    gc.disable()
    try:
        run()
        assert gc.collect() == 0
    finally:
        gc.enable()
