"""The command line: output, files, one clear line and exit code 2 on a fault."""

import csv
import json

import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid.cli import app
from models.bouncing_ball import BouncingBall

RUNNER = CliRunner()


def call(*arguments):
    return RUNNER.invoke(app, [str(a) for a in arguments])


def test_run_prints_draws_and_saves(tmp_path, folder):
    """The example of the README, by file."""
    result = call(
        *("run", folder / "bead_on_table.py", "--set", "r=0.8", "--until", 60),
        *("--solver", "scipy", "--method", "DOP853", "--rtol", 1e-9),
        *("--plot", tmp_path / "out.png", "--save", tmp_path / "out.nc"),
    )
    assert result.exit_code == 0, result.output
    assert "t_inf = 27.2679146866" in result.output
    assert (tmp_path / "out.png").exists()
    assert hy.load(tmp_path / "out.nc").zeno[0].t == pytest.approx(27.2679146866, abs=1e-9)


def test_run_writes_the_table_of_jumps_and_json(tmp_path):
    """All digits; what is printed is one document, or nothing."""
    out = tmp_path / "out.csv"
    result = call("run", "bouncing_ball", "--csv", out, "--json", "--oracle")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0))
    assert found["zeno"][0]["t"] == run.zeno[0].t
    assert (found["jumps"], found["status"]) == (len(run.jumps), "REACHED_END")
    assert found["oracle"][0]["exact"] == pytest.approx(2.558633965585808)
    rows = list(csv.DictReader(out.open()))
    assert list(rows[0]) == ["t", "j", "edge", "x_before", "v_before", "x_after", "v_after"]
    assert [float(row["t"]) for row in rows] == run.jumps.t.tolist()
    assert [float(row["v_after"]) for row in rows] == run.jumps.after.v.tolist()
    assert call("run", "bouncing_ball", "--quiet", "--csv", out).output == ""
    assert call("run", "bouncing_ball", "--csv", "-").output == out.read_text()
    assert "leave out --json" in call("run", "bouncing_ball", "--csv", "-", "--json").output
    refused = call("run", "bouncing_ball", "--csv", "no/x.csv").output
    assert "--csv no/x.csv: no such folder" in refused


def test_every_command_prints_json_or_nothing():
    """What is known of a model or a measurement, as one document; ``--quiet`` says nothing."""
    models = json.loads(call("list", "--json").stdout)
    assert "bouncing_ball" in models
    declared = json.loads(call("check", "two_walls", "--json").stdout)
    assert declared["states"] == ["x", "v"]
    short = "bench", "bouncing_ball", "--solvers", "taylor", "--rtol", "1e-6", "--repeats", 1
    measured = json.loads(call(*short, "--json").stdout)
    assert [timing["rtol"] for timing in measured["timings"]] == [1e-6]
    for command in (["list"], ["check", "two_walls"], short):
        quiet = call(*command, "-q")
        assert (quiet.exit_code, quiet.output) == (0, "")


def test_certify_prints_json():
    """The fields of the certificate, and the same exit codes."""
    box = "--box", "x=2:2.5", "--box", "v=-7:7"
    result = call("certify", "hard_spring", *box, "--json")
    found = json.loads(result.stdout)
    assert found["verdict"] == "certified"
    assert found["left"] < found["right"]
    quiet = call("certify", "hard_spring", *box, "-q")
    assert (quiet.exit_code, quiet.output) == (result.exit_code, "")


def test_a_model_by_name_with_its_oracle():
    """Exact values beside computed ones."""
    result = call("run", "bouncing_ball", "--oracle")
    assert result.exit_code == 0
    assert "2.55863396558581" in result.output


def test_steps_may_be_bounded(tmp_path):
    """From the command line as from Python."""
    out = tmp_path / "out.nc"
    result = call("run", "bouncing_ball", "--max-step", 0.01, "--first-step", 1e-4, "--save", out)
    assert result.exit_code == 0, result.output
    first, *others = (s.length for s in hy.load(out).parts[0].segments)
    assert (first, max(others)) == pytest.approx((1e-4, 0.01))
    assert "max_step=-1.0" in call("run", "bouncing_ball", "--max-step", -1).output


def test_list_names_every_model():
    """One line each."""
    result = call("list")
    assert result.exit_code == 0
    for name in ("bead_on_table", "ball_on_circle", "moon_holmes"):
        assert name in result.output


def test_check_reports_all_faults(tmp_path):
    """A class with faults: the list, exit code 2; one without: what it declares."""
    bad = tmp_path / "bad.py"
    bad.write_text(
        "import hybrid as hy\n"
        "class Bad(hy.Automaton):\n"
        "    x = hy.state()\n"
        "    @hy.mode\n"
        "    def one(self, t, s):\n"
        "        return s.y\n"
        "    hit = hy.contact(one, gap=lambda self, t, s: s.x, restitution='e')\n"
    )
    result = call("check", bad)
    assert result.exit_code == 2
    assert "Bad has 2 faults" in result.output
    assert "no state named 'y'" in result.output
    good = call("check", "two_walls")
    assert good.exit_code == 0
    assert "no faults" in good.output
    assert "lags tau." in call("check", "pyragas").output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "no_such_model"], "no model 'no_such_model' in the gallery: ball_on_circle"),
        (["run", "none.py"], "none.py: no such file"),
        (["run", "bouncing_ball", "--set", "e=0.5"], "has no parameter 'e'; there are: g, r"),
        (["run", "bouncing_ball", "--set", "r=2"], "must lie in [0, 1]"),
        (["run", "bouncing_ball", "--set", "r"], "--set r: write NAME=NUMBER"),
        (["run", "bouncing_ball", "--mode", "swim"], "mode='swim'; there are flight"),
        (["run", "bouncing_ball", "--method", "RK99"], "method='RK99'"),
        (["run", "bouncing_ball", "--solver", "mine"], "solver='mine'"),
        (["run", "bouncing_ball", "--start", "x=-1"], "outside the mode's domain"),
        (["run", "bouncing_ball", "--until", "-1"], "the first before the last"),
        (["run", "bouncing_ball", "--plot", "out.xyz"], "--plot out.xyz: end the name in .png"),
        (["run", "bouncing_ball", "--plot", "out"], "--plot out: end the name in .png, .pdf, .svg"),
        (["run", "bouncing_ball", "--plot", "no/out.html"], "--plot no/out.html: no such folder"),
        (["check", "none.py"], "none.py: no such file"),
        (["certify", "hard_spring"], "--box NAME=LOW:HIGH is needed"),
        (["certify", "hard_spring", "--box", "x=2"], "--box x=2: write NAME=LOW:HIGH"),
        (["certify", "hard_spring", "--box", "y=0:1"], "box has 'y', which is no state"),
        (["certify", "hard_spring", "--box", "x=2:2.5"], "box has no bounds for 'v'"),
    ],
)
def test_faults_are_one_line_and_exit_code_2(arguments, message):
    """No traceback."""
    result = call(*arguments)
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output
    assert result.stderr.count("\n") == 1


def test_a_fault_in_the_users_file_names_its_line(tmp_path):
    """Syntax errors, import errors and flows that give NaN."""
    broken = tmp_path / "broken.py"
    broken.write_text("import hybrid as hy\nx = (\n")
    assert "broken.py:2: SyntaxError" in call("run", broken).output
    missing = tmp_path / "missing.py"
    missing.write_text("import hybrid as hy\nimport nowhere_at_all\n")
    assert "missing.py:2: ModuleNotFoundError" in call("run", missing).output
    nan = tmp_path / "nan.py"
    nan.write_text(
        "import jax.numpy as jnp\nimport hybrid as hy\n"
        "class Nan(hy.Automaton):\n    x = hy.state()\n    @hy.mode\n"
        "    def f(self, t, s):\n        return jnp.log(s.x) * 1.0\n"
    )
    result = call("run", nan, "--start", "x=-1", "--until", "1")
    assert result.exit_code == 2
    assert "the flow is not finite" in result.output
    no_start = call("run", nan, "--until", "1")
    assert "no start for x; add --start x=NUMBER" in no_start.output


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("UNTIL = 3.0", "UNTIL = 3.0: a pair, (first, last) time"),
        ("START = 5", "START = 5: a dict, the states by name"),
        ("HISTORY = 5", "HISTORY = 5: a dict, the states by name"),
        ("HISTORY = {'x': 1.0}", "looks into the past"),
        ("def oracle(run): return None", "oracle(run) of Still: TypeError"),
        ("def oracle(run): yield 'x', 1 / 0, 0.0, 0.0", "oracle(run) of Still: ZeroDivisionError"),
    ],
)
def test_slips_in_a_models_file(tmp_path, line, message):
    """What the file says about its own run is checked too."""
    text = (
        "import hybrid as hy\nclass Still(hy.Automaton):\n    x = hy.state()\n    @hy.mode\n"
        "    def f(self, t, s):\n        return 0.0\nSTART = {'x': 0.0}\nUNTIL = (0.0, 1.0)\n"
    )
    path = tmp_path / "still.py"
    path.write_text(text + line + "\n")
    result = call("run", path, "--oracle")
    assert result.exit_code == 2
    assert message in result.output


def test_a_truncated_run_can_be_drawn(tmp_path):
    """With the distance to the full series in words."""
    result = call(
        *("run", "bouncing_ball", "--zeno", "truncate", "--max-jumps", 3),
        *("--plot", tmp_path / "cut.png"),
    )
    assert result.exit_code == 0
    assert "cut off after 3 impacts" in result.output
    assert call("run", "bouncing_ball", "--save", tmp_path / "no" / "x.nc").exit_code == 2


def test_certify_says_what_is_proved_by_its_exit_code():
    """0 certified, 1 refuted (with the repair), 3 undecided."""
    proved = call("certify", "hard_spring", "--box", "x=2:2.5", "--box", "v=-7:7")
    assert proved.exit_code == 0, proved.output
    assert "certified: HardSpring" in proved.output
    beam = ("certify", "moon_holmes", "--set", "delta=0", "--set", "gamma=0", "--box", "x=1.1:1.5")
    refuted = call(*beam, "--box", "v=-3:3")
    assert refuted.exit_code == 1
    assert "3.4893157889942" in refuted.output
    assert call(*beam, "--box", "v=-3.5:3.5").exit_code == 0
    table = ("certify", "bead_on_table", "--box")
    assert call(*table, "x=1:2", "--box", "v=-1:1").exit_code == 3
    relative = ("gap=0:1", "--box", "speed=0:1", "--box", "t=20:30", "--contact", "impact")
    assert call(*table, *relative).exit_code == 0


def test_what_was_before_is_the_files_or_given(tmp_path):
    """HISTORY of the file, changed state by state; memory restarted at impacts."""
    assert "t_inf = 0.3865006029" in call("run", "delay_bounce").output
    held = call("run", "delay_bounce", "--history", "y=0.05")
    assert "t_inf = 0.3865006029" not in held.output
    kept = call("run", "pyragas", "--until", 8)
    assert "flight.rest(impact)" in kept.output
    assert (
        "flight.rest(impact)"
        not in call("run", "pyragas", "--until", 8, "--memory", "restart").output
    )
    assert call("run", "pyragas", "--memory", "lose").exit_code == 2
    path = tmp_path / "echo.py"
    path.write_text(
        "import jax.numpy as jnp\nimport hybrid as hy\n"
        "class Echo(hy.Automaton):\n    y = hy.state()\n    @hy.mode\n"
        "    def f(self, t, s, past):\n        return -past(jnp.pi / 2).y\n"
        "START, UNTIL = {'y': 1.0}, (0.0, 2 * jnp.pi)\nHISTORY = {'y': jnp.cos}\n"
        "def oracle(run):\n    yield 'y', run.final.y, 1.0, 1e-8\n"
    )
    assert call("run", path, "--oracle").exit_code == 0


def test_its_versions():
    """Those of what computes, as in a run."""
    done = call("--version")
    assert done.exit_code == 0
    assert f"hybrid {hy.__version__}\n" in done.output
    assert "jax " in done.output


def test_a_run_tells_bounds_and_verdicts():
    """They are looked for, as nobody can ask the run afterwards."""
    line = next(row for row in call("run", "bouncing_ball").output.splitlines() if "t_inf" in row)
    assert "±" in line
    assert "(certified)" in line


def test_a_sweep_takes_the_options_of_a_run():
    """What to do at an accumulation, and by which steps."""
    asked = "sweep", "bouncing_ball", "--over", "r=[0.5,0.6]", "--solver", "scipy"
    done = call(*asked, "--method", "RK45", "--rtol", 1e-6, "--zeno", "stop")
    assert done.output == "BouncingBall: 2 lanes: 2 zeno_stopped\n"
    refused = call(*asked, "--zeno", "halt")
    assert refused.exit_code == 2
    assert "zeno='halt': one of 'rest', 'stop'" in refused.output
