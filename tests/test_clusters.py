"""Maps that workers of a cluster fly, and what is left of them when its processes are killed."""

import os
import runpy
import shutil
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

import hybrid as hy
from hybrid.maps import workers

from .swept import ASKED, Ball

ROOT = Path(__file__).parent.parent
EXAMPLE = "docs/examples/cluster.py"

#: Open MPI refuses to start as root, in a container too, unless it is told twice.
AS_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}


def ranks():
    """What starts two ranks of MPI, the second of which works."""
    beside = Path(sys.executable).with_name("mpiexec")
    mpiexec = str(beside) if beside.exists() else shutil.which("mpiexec")
    return [mpiexec, "-n", "2", sys.executable, "-m", "mpi4py.futures"]


@pytest.mark.every_way
@pytest.mark.parametrize(
    ("how", "needs"), [("dask", "dask_jobqueue"), ("jobs", "submitit"), ("mpi", "mpi4py")]
)
def test_the_example(how, needs, tmp_path):
    """Each of its ways, without Slurm, writes the map that this process makes, all of it there."""
    pytest.importorskip(needs)
    start = ranks() if how == "mpi" else [sys.executable]
    if start[0] is None:
        pytest.skip("there is no mpiexec")
    path, store = os.pathsep.join([str(ROOT), *sys.path]), tmp_path / "map.zarr"
    done = subprocess.run(
        [*start, str(ROOT / EXAMPLE), how, str(store), "--here"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
        env={**os.environ, **AS_ROOT, "PYTHONPATH": path, "PYTHONWARNINGS": "error:hybrid flies"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"1600 lanes, by {how}"
    asked = runpy.run_path(str(ROOT / EXAMPLE))["ASKED"]
    there = hy.sweep(**asked, store=store, progress=pytest.fail)
    assert there.identical(hy.sweep(**asked))


class Job:
    """What an executor of jobs gives in place of a future."""

    def __init__(self, future):
        self.asked, self.future = 0, future

    def done(self):
        self.asked += 1
        return self.asked > 1 and self.future.done()

    def __getattr__(self, name):
        return getattr(self.future, name)


class Jobs:
    """Jobs that are sent as one array, as submitit does, and fail where they are told to."""

    def __init__(self, pool, fails=()):
        self.pool, self.fails, self.arrays = pool, fails, []

    @contextmanager
    def batch(self):
        self.arrays.append([])
        yield

    def submit(self, function, *args):
        self.arrays[-1].append(function)
        call = [].pop if len(self.arrays[-1]) in self.fails else function
        return Job(self.pool.submit(call, *() if call is not function else args))


def test_jobs_are_sent_as_one_array(monkeypatch):
    """And asked whether they have ended; those that fail are flown here."""
    monkeypatch.setattr(workers, "PAUSE", 0.001)
    table = hy.sweep(Ball(), **ASKED)
    with ThreadPoolExecutor(1) as pool:
        executor = Jobs(pool)
        assert table.identical(hy.sweep(Ball(), **ASKED, executor=executor))
        assert [len(array) for array in executor.arrays] == [7]
        with pytest.warns(UserWarning, match="1 blocks here.*pop from empty list"):
            assert table.identical(hy.sweep(Ball(), **ASKED, executor=Jobs(pool, fails=[3])))


class Dead(ThreadPoolExecutor):
    """As Dask's when the scheduler is killed: of what was sent some is cancelled, some never ends,
    and no more is taken."""

    sent = 0

    def submit(self, *asked):
        self.sent += 1
        if self.sent > 7:
            raise RuntimeError("the client is closed")
        future = Future()
        if self.sent == 1:
            future.cancel()
            future.set_running_or_notify_cancel()
        return super().submit(*asked) if self.sent > 3 else future


def test_a_dead_executor_loses_what_it_has_not_given(monkeypatch):
    """Three blocks are flown here, of which it does not say that they are lost."""
    monkeypatch.setattr(workers, "PROBED_AFTER", 0.1)
    with Dead(1) as pool, pytest.warns(UserWarning, match="3 blocks here"):
        assert hy.sweep(Ball(), **ASKED).identical(hy.sweep(Ball(), **ASKED, executor=pool))


@pytest.mark.every_way
@pytest.mark.parametrize("target", ["worker", "scheduler", "writer"])
def test_a_killed_process_of_a_cluster(target):
    """Killed at a random moment, and the map ends as one that ran through."""
    pytest.importorskip("distributed")
    pytest.importorskip("zarr")
    from .kills import killed

    for made, same in killed(1, [target], seed=3):
        assert made == {target: 1}
        assert same
