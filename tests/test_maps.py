"""Sweeps: a grid in blocks, over executors, into a store (``docs/maps.md``)."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import hybrid as hy
from hybrid.cli import app
from hybrid.ensembles import processes
from models.bouncing_ball import UNTIL, BouncingBall

from .swept import ASKED, Ball, G, R, X

REST = {"v": 0.0}, UNTIL


@pytest.fixture(scope="module")
def table():
    return hy.sweep(Ball(), **ASKED)


def test_a_grid(table):
    """``t_inf = sqrt(2 x / g) (1 + r) / (1 - r)`` over both axes."""
    exact = np.sqrt(2 * X / G) * ((1 + R) / (1 - R))[:, None]
    assert table.t_inf.dims == ("r", "x_start")
    np.testing.assert_allclose(table.t_inf, exact, rtol=1e-13)  # rounding of a few impacts
    assert table.r.values.tolist() == R.tolist()
    assert table.r.attrs["units"] == "1"
    assert table.x_start.attrs["units"] == "m"


def test_blocks_have_no_say(table):
    """One block, or one for each lane, gives the same."""
    for block in (1, 100):
        assert table.identical(hy.sweep(Ball(), **{**ASKED, "block": block}))


def test_points_on_a_section():
    """What lanes are asked for has the axes of the grid before its own."""
    table = hy.sweep(Ball(), **ASKED, section="impact", keep=2, measure=["stick"])
    speed = np.sqrt(2 * G * X)[None, :, None] * (R[:, None] ** [1, 2])[:, None, :]
    np.testing.assert_allclose(table.v_section, speed, rtol=1e-13)
    assert table.stick.dims == ("r", "x_start")


def test_times_of_each_lane():
    """Times may follow from the parameters of a lane."""
    table = hy.sweep(
        Ball(), {"r": R}, {"x": 1.0, "v": 0.0}, lambda self: (0.0, 1.0 + self.r), block=3
    )
    assert table.t.values.tolist() == (1.0 + R).tolist()


@pytest.mark.parametrize("workers", [1, 3])
def test_an_executor(table, workers):
    """Any executor gives what this process does."""
    with ThreadPoolExecutor(workers) as pool:
        assert table.identical(hy.sweep(Ball(), **ASKED, executor=pool))


class Dying(ThreadPoolExecutor):
    """Loses two blocks, as a pool does whose worker is killed."""

    lost = 2

    def submit(self, *asked):
        if not self.lost:
            return super().submit(*asked)
        self.lost -= 1
        future = Future()
        future.set_exception(OSError("a worker was killed"))
        return future


def test_a_worker_that_dies_costs_its_block(table):
    """Which is flown again, and told."""
    with Dying(1) as pool, pytest.warns(UserWarning, match="2 blocks here.*a worker was killed"):
        assert table.identical(hy.sweep(Ball(), **ASKED, executor=pool))


@pytest.mark.long
def test_a_killed_process():
    """A process of a pool that kills itself costs its blocks."""
    assert said_by("killed_pool.py") == "identical"


def said_by(script):
    """What a script beside this file prints."""
    root = Path(__file__).parent.parent
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name(script))],
        cwd=root, capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_failing_lane_is_a_row():
    """With its reason; its neighbours are as they were."""
    table = hy.sweep(Ball(), {"x": [-1.0, 1.0]}, {"v": 0.0}, (0.0, 20.0))
    assert table.status.values.tolist() == ["outside", "reached_end"]
    assert "must be positive" in str(table.reason.values[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"over": {}}, "values by name"),
        ({"over": {"q": [1.0]}}, "over 'q': a parameter or a state: r, x, v"),
        ({"over": {"r": [0.5, 0.5]}}, "a value occurs twice"),
        ({"over": {"r": "half"}}, "numbers in a row"),
        ({"block": 0}, "a number of lanes"),
        ({"executor": 3}, "one of concurrent.futures"),
    ],
)
def test_what_cannot_be_swept(change, said):
    """Wrong use is one clear error."""
    with pytest.raises(hy.OptionError, match=said):
        hy.sweep(Ball(), **{**ASKED, **change})


@pytest.mark.long
def test_dask():
    """A real local cluster, by the executor of its client, as it is. Not in this process: a client
    that has been here leaves it with other last bits than a fresh process has."""
    pytest.importorskip("distributed")
    assert said_by("dask_cluster.py") == "identical"


# ---------------------------------------------------------------------------------------
# the store


def test_a_store_resumes(table, tmp_path):
    """What is there is not flown again, and the end is the same to the last bit."""
    pytest.importorskip("zarr")
    from hybrid.maps.store import status

    path, told = tmp_path / "map.zarr", []

    def stop(done, lanes):
        told.append((done, lanes))
        if done >= 9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hy.sweep(Ball(), **ASKED, store=path, progress=stop)
    assert told == [(3, 20), (6, 20), (9, 20)]
    found = status(path)
    assert found.pop("pace") > 0
    assert found == {
        "model": "Ball", "lanes": 20, "blocks": 7, "done": 3,
        "status": {"reached_end": 9}, "verdict": {"estimated": 9},
    }  # fmt: skip
    told.clear()
    again = hy.sweep(Ball(), **ASKED, store=path, progress=lambda *n: told.append(n))
    assert told[0] == (12, 20)
    assert table.identical(again)
    assert table.identical(hy.sweep(Ball(), **ASKED, store=path, progress=pytest.fail))


def test_a_store_of_another_map(tmp_path):
    """Is refused, and says what differs."""
    pytest.importorskip("zarr")
    path = tmp_path / "map.zarr"
    hy.sweep(Ball(), **ASKED, store=path)
    for change, said in (
        ({"t": (0.0, 21.0)}, "other values"),
        ({"max_jumps": 3}, "other options"),
        ({"over": {"r": R + 0.01, "x": X}}, "other values"),
    ):
        with pytest.raises(hy.StoreError, match=said):
            hy.sweep(Ball(), **{**ASKED, **change}, store=path)
    with pytest.raises(hy.StoreError, match="other model"):
        hy.sweep(BouncingBall(), **{**ASKED, "over": {"r": R, "x": X}}, store=path)


LEVEL = 0.1


def above(self, t, s):
    """A surface that depends on a number of the module."""
    return s.x - LEVEL


def test_what_a_function_reads_is_part_of_a_map(tmp_path, monkeypatch):
    """A store is refused where a number has changed that a section sees."""
    pytest.importorskip("zarr")
    asked = {**ASKED, "section": above, "keep": 2, "store": tmp_path / "map.zarr"}
    table = hy.sweep(Ball(), **asked)
    assert table.identical(hy.sweep(Ball(), **asked))
    monkeypatch.setitem(globals(), "LEVEL", 0.2)
    with pytest.raises(hy.StoreError, match="other options"):
        hy.sweep(Ball(), **asked)


class Driven(hy.Automaton):
    """Follows a signal."""

    x = hy.state()
    k: float = hy.parameter(1.0)
    road = hy.signal()

    @hy.mode
    def only(self, t, s):
        return (self.k * (self.road(t) - s.x),)


def test_a_signal_is_part_of_a_map(tmp_path):
    """A model with other data is another, and functions of the model see its signals."""
    pytest.importorskip("zarr")
    asked = {"over": {"k": [0.0, 1.0]}, "t": (0.0, 1.0), "store": tmp_path / "map.zarr"}
    asked["start"] = lambda self: {"x": self.road(0.0) + 3.0}
    one, other = (Driven(road=([0.0, 1.0], [0.0, end])) for end in (1.0, 2.0))
    table = hy.sweep(one, **asked)
    assert table.x.values[0] == 3.0
    assert table.identical(hy.sweep(one, **asked))
    with pytest.raises(hy.StoreError, match="other model"):
        hy.sweep(other, **asked)


@pytest.mark.long
def test_other_processes_give_the_same(monkeypatch):
    """Blocks of lanes that go one by one, shared with another process."""
    asked = {**ASKED, "section": "impact", "keep": 2, "measure": ["stick", "energy"], "block": 10}
    alone = hy.sweep(Ball(), **asked)
    answers, real = [], processes._Process.answer
    monkeypatch.setattr(processes, "PAYS", 1e-9)
    monkeypatch.setattr(processes, "cores", lambda: 2)
    monkeypatch.setattr(processes._Process, "answer", lambda p: answers.append(1) or real(p))

    def waiting(shared, number, answer, hire=processes.Shared._hire):
        hire(shared, number, answer)
        for _ in range(12000 if shared.crew and not answers else 0):
            time.sleep(0.01)
            if answers:
                break

    monkeypatch.setattr(processes.Shared, "_hire", waiting)
    assert alone.identical(hy.sweep(Ball(), **asked))
    assert answers


@pytest.mark.long
def test_a_killed_sweep_goes_on(table, tmp_path):
    """Killed without notice between or within blocks, twice, and started again."""
    pytest.importorskip("zarr")
    from hybrid.maps.store import status

    path, root = tmp_path / "map.zarr", Path(__file__).parent.parent
    code = (
        "import time, hybrid as hy\n"
        "from tests.swept import ASKED, Ball\n"
        f"hy.sweep(Ball(), **ASKED, store={str(path)!r}, progress=lambda *_: time.sleep(0.2))"
    )
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    for least in (1, 4):
        process = subprocess.Popen([sys.executable, "-c", code], cwd=root, env=env)
        try:
            for _ in range(3000):
                time.sleep(0.02)
                if process.poll() is not None or (path.exists() and _done(status, path) >= least):
                    break
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert least <= status(path)["done"] < 7
    assert table.identical(hy.sweep(Ball(), **ASKED, store=path))


def test_a_large_map_stays_on_disk(table, tmp_path):
    """Over its lanes, until it is looked at; with the same numbers."""
    pytest.importorskip("zarr")
    path = tmp_path / "map.zarr"
    left = hy.sweep(Ball(), **ASKED, store=path, load=False)
    assert left.t_inf.dims == ("lane",)
    for name in ("t_inf", "verdict", "x"):
        assert left[name].values.tolist() == table[name].values.ravel().tolist()
    with pytest.raises(hy.OptionError, match="load=False takes store="):
        hy.sweep(Ball(), **ASKED, load=False)


def _done(status, path):
    try:
        return status(path)["done"]
    except hy.StoreError:
        return 0


def test_the_command(tmp_path):
    """``hybrid sweep`` says what became of the lanes, and how far a stored map is."""
    pytest.importorskip("zarr")
    path, file = tmp_path / "map.zarr", tmp_path / "map.nc"
    asked = ["--over", "r=0.3:0.9:7", "--over", "x=[0.5,1.0]", "--store", str(path)]
    call = CliRunner().invoke
    done = call(app, ["sweep", "bouncing_ball", *asked, "--save", str(file)])
    assert done.stdout == "BouncingBall: 14 lanes: 14 reached_end\n", done.output
    done = call(app, ["sweep", "--status", str(path)])
    assert done.stdout == (
        "BouncingBall: 1 of 1 blocks are done, 14 lanes in all\n"
        "  status: 14 reached_end\n  verdict: 3 none, 11 estimated\n"
    )
    own = hy.sweep(BouncingBall(), {"r": np.linspace(0.3, 0.9, 7), "x": [0.5, 1.0]}, *REST)
    assert xarray.load_dataset(file).t_inf.equals(own.t_inf)
    done = call(app, ["sweep", "bouncing_ball", "--over", "r=1:2"])
    assert done.exit_code == 2
    assert "NAME=FROM:TO:COUNT" in done.stderr
    done = call(app, ["sweep", "--status", str(tmp_path / "none")])
    assert done.exit_code == 2
