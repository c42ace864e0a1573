"""Speed against error: what is timed, what errors are measured against, and what is advised."""

import json
import math

import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid.benchmark import precision
from hybrid.benchmark.precision import Bench, Timing
from hybrid.cli import app
from models import bouncing_ball, hard_spring

BALL = bouncing_ball.BouncingBall(), bouncing_ball.START, bouncing_ball.UNTIL
WALL = hard_spring.HardSpring(), hard_spring.START, hard_spring.UNTIL


def bench(*run, **options):
    return hy.bench(*run, **{"repeats": 1, **options})


def test_errors_are_those_of_exact_values():
    """At 1e-11 smaller than at 1e-3 by orders; every number of a row is there."""
    options = {"solvers": ["scipy:RK45"], "oracle": hard_spring.oracle}
    found = bench(*WALL, rtol=[1e-3, 1e-11], **options)
    loose, tight = found.timings
    assert tight.error < 1e-9  # a hundred times the tolerance, as errors of steps add up
    assert loose.error > 1e-6  # a thousandth of it, as some steps are better than asked
    assert found.resolution == 0.0
    for timing in found.timings:
        assert 0.0 < timing.low <= timing.seconds <= timing.high
        assert timing.steps > 0
        assert timing.evaluations > 0
        assert timing.memory > 1000
    assert loose.first > 0.0
    assert math.isnan(tight.first)  # nothing is compiled for a tolerance


class Spring(hy.Automaton):
    """A body that falls on a nonlinear spring."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -1.0 - s.x**3

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.7)


DROP = Spring(), {"x": 1.0, "v": 0.0}, (0.0, 20.0)


def test_without_exact_values_a_run_of_another_method_is_taken():
    """Taylor series are not measured against themselves, and the runs' distance is said."""
    found = bench(*DROP, solvers=["taylor", "scipy:DOP853"], rtol=[1e-5, 1e-9])
    assert "taylor" in found.against
    assert "DOP853" in found.against
    assert 0.0 < found.resolution < 1e-11
    errors = {(t.solver, t.rtol): t.error for t in found.timings}
    for solver in ("taylor", "scipy:DOP853"):
        assert 0.0 < errors[solver, 1e-9] < errors[solver, 1e-5] < 1e-3


def test_a_run_with_other_jumps_has_no_small_error():
    """It is another run, however close its states may be; so is one that ends before."""
    whole = hy.simulate(*DROP, solver="taylor")
    part = hy.simulate(*DROP, solver="taylor", zeno="stop")
    judge = precision._Tighter(*DROP, {})
    assert judge.error(whole, "scipy:RK45") < 1e-12
    assert judge.error(part, "scipy:RK45") == math.inf


def test_an_oracle_that_misses_a_jump_is_an_infinite_error():
    """A limit that a run has not come to is not close to one."""
    found = bench(
        *BALL,
        solvers=["taylor"],
        rtol=[1e-9],
        zeno="stop",
        oracle=lambda run: [("", run.zeno[1].t, 1)],
    )
    assert found.timings[0].error == math.inf
    assert "No solver" in found.advice


def test_what_fails_is_a_row_with_its_reason(monkeypatch):
    """The others are timed."""
    simulate = precision.simulate

    def refused(*arguments, **options):
        if options.get("method") == "RK23":
            raise hy.FlowError("Spring, mode flight: the flow is not finite")
        return simulate(*arguments, **options)

    monkeypatch.setattr(precision, "simulate", refused)
    found = bench(*DROP, solvers=["scipy:RK23", "taylor"], rtol=[1e-6])
    failed, timed = found.timings
    assert failed.reason == "Spring, mode flight: the flow is not finite"
    assert failed.reason in str(found)
    assert timed.error < 1e-4


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"solvers": []}, "at least one"),
        ({"rtol": []}, "at least one"),
        ({"repeats": 0}, "at least one"),
        ({"solvers": ["scipy:RK46"]}, "RK46"),
        ({"solvers": ["matlab"]}, "matlab"),
        ({"oracle": lambda run: 1 / 0}, "ZeroDivisionError"),
        ({"oracle": lambda run: []}, "no rows"),
    ],
)
def test_what_cannot_be_timed_is_refused(options, what):
    """By a sentence that names it."""
    with pytest.raises(hy.OptionError, match=what):
        bench(*BALL, **{"solvers": ["taylor"], "rtol": [1e-6], **options})


def timing(solver, rtol, error, seconds):
    return Timing(solver=solver, rtol=rtol, error=error, seconds=seconds, low=seconds, high=seconds)


def made(resolution=0.0):
    rows = [
        timing("a", 1e-3, 1e-2, 1e-3),
        timing("a", 1e-6, 1e-5, 2e-3),
        timing("a", 1e-9, 1e-8, 8e-3),
        timing("b", 1e-3, 1e-4, 3e-3),
        timing("b", 1e-6, 1e-9, 4e-3),
        timing("b", 1e-9, 1e-15, 5e-3),
        timing("c", 1e-9, math.inf, 1e-6),
    ]
    return Bench("M()", rows, "x", resolution, {}, {})


def test_the_advice_is_the_fastest_for_each_error():
    """A solver that another beats in both is not named, nor one on another course."""
    assert [(t.solver, t.rtol) for t in made().front] == [
        ("a", 1e-3),
        ("a", 1e-6),
        ("b", 1e-6),
        ("b", 1e-9),
    ]
    assert made().advice == (
        "For errors down to 1e-05 take a (rtol=1e-06: 2 ms), "
        "down to 1e-15 take b (rtol=1e-09: 5 ms)."
    )


def test_errors_below_the_resolution_are_not_told_apart():
    """Of two that are that small the faster is named, and that more is not known."""
    assert [t.rtol for t in made(1e-8).front] == [1e-3, 1e-6, 1e-6]
    assert "down to 1e-08 take b (rtol=1e-06: 4 ms)" in made(1e-8).advice


def test_the_command_writes_table_figure_and_numbers(tmp_path):
    """One tolerance for each power of ten; what JSON cannot say is null."""
    arguments = ["--solvers", "scipy:DOP853,taylor", "--rtol", "1e-5..1e-7", "--repeats", "2"]
    done = CliRunner().invoke(app, ["bench", "bouncing_ball", *arguments, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "bouncing_ball.txt").read_text() in done.output
    assert "exact values" in done.output
    numbers = json.loads((tmp_path / "bouncing_ball.json").read_text())
    assert [t["rtol"] for t in numbers["timings"]] == [1e-5, 1e-6, 1e-7] * 2
    assert numbers["timings"][1]["first"] is None
    assert numbers["versions"]["hybrid"] == hy.__version__
    assert numbers["machine"]["cores"] > 0
    assert (tmp_path / "bouncing_ball.png").stat().st_size > 10_000


def test_the_file_s_exact_values_hold_for_its_own_run_only():
    """With another start errors are measured by another run."""
    arguments = ["--solvers", "taylor", "--rtol", "1e-6", "--repeats", "1", "--start", "x=2.5"]
    done = CliRunner().invoke(app, ["bench", "bouncing_ball", *arguments])
    assert done.exit_code == 0, done.output
    assert "a run of scipy:DOP853 to rounding" in done.output


def test_an_error_that_is_no_number_is_not_hidden_by_another():
    """Wherever it stands among the rows."""
    for rows in ([("a", 1.0, 1.0), ("b", math.nan, 1.0)], [("b", math.nan, 1.0), ("a", 1.0, 1.0)]):
        judge = precision._Exact(lambda run, rows=rows: rows)
        assert math.isnan(judge.error(None, "taylor"))


def test_where_the_exact_runs_differ_nothing_is_advised(tmp_path):
    """No error is known there, which JSON has as null."""
    assert "no error is known" in made(math.inf).advice
    made(math.inf).save(tmp_path / "bench.json")
    assert json.loads((tmp_path / "bench.json").read_text())["resolution"] is None


def test_a_first_time_of_zero_is_another_run():
    """The file's exact values do not hold for it."""
    arguments = ["--solvers", "taylor", "--rtol", "1e-6", "--repeats", "1", "--from", "0"]
    done = CliRunner().invoke(app, ["bench", "bouncing_ball", *arguments])
    assert done.exit_code == 0, done.output
    assert "a run of scipy:DOP853 to rounding" in done.output


@pytest.mark.parametrize("text", ["fast", "1e-4..", "1e-4,,1e-8", "0..1e-3", "1e-4..3e-8"])
def test_a_wrong_tolerance_is_one_line(text):
    """With what to write instead."""
    done = CliRunner().invoke(app, ["bench", "bouncing_ball", "--rtol", text])
    assert done.exit_code == 2
    assert "--rtol" in done.output
    assert "1e-4..1e-12" in done.output
