"""Maps whose processes are killed at random moments: are they, at the end, as if none had been?

For ``test_clusters.py`` and ``benchmarks/maps.py``. ``python -m tests.kills PATH [SCHEDULER]`` goes
on with a map, on a cluster of Dask if there is one.
"""

import os
import random
import subprocess
import sys
import time
from collections import Counter
from itertools import count as count_up
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import hybrid as hy

from .swept import Ball

ROOT = Path(__file__).parent.parent

MAP = {"r": np.linspace(0.3, 0.9, 40), "x": np.linspace(0.5, 2.0, 40)}

#: A process is killed so many seconds at most after a map is gone on with.
LATEST = 3.0


def stored(path, executor=None):
    """A map of 1,600 lanes in 100 blocks."""
    asked = {"store": path, "block": 16, "executor": executor}
    return hy.sweep(Ball(), MAP, {"v": 0.0}, (0.0, 9.0), **asked)


def started(folder, *command):
    """A process of Python, what it says in a file."""
    path = os.pathsep.join([str(ROOT), *sys.path])
    with (Path(folder) / "said.txt").open("a") as said:
        return subprocess.Popen(
            [sys.executable, *command], cwd=ROOT, env={**os.environ, "PYTHONPATH": path},
            stdout=said, stderr=said,
        )  # fmt: skip


class Cluster:
    """A scheduler and a worker of Dask, a process each."""

    def __init__(self, folder):
        self.folder, self.running, self.file = folder, {}, None

    def stand(self):
        """Start what does not run; a worker does not outlive its scheduler."""
        if not self._runs("scheduler"):
            self.end()
            self.file = Path(self.folder) / f"scheduler{time.monotonic_ns()}.json"
            own = "--port", "0", "--host", "127.0.0.1"
            self._start("scheduler", *own)
        if not self._runs("worker"):
            self._start("worker", "--no-nanny", "--nthreads", "1")

    def end(self):
        """Kill all."""
        for process in self.running.values():
            process.kill()
            process.wait()

    def _runs(self, what):
        return what in self.running and self.running[what].poll() is None

    def _start(self, what, *options):
        asked = f"distributed.cli.dask_{what}", "--scheduler-file", str(self.file), "--no-dashboard"
        self.running[what] = started(self.folder, "-m", *asked, *options)


def killed(count, targets=("writer",), seed=1):
    """Kill ``count`` processes in all; yields after each map how often which was, and whether the
    map is as one that ran through."""
    draw, made, numbers = random.Random(seed), Counter(), count_up()
    with TemporaryDirectory() as folder:
        whole, cluster = stored(None), Cluster(folder)
        try:
            while made.total() < count:
                path = Path(folder) / f"map{next(numbers)}.zarr"
                while not _ended(path, cluster, draw, targets, made, count):
                    pass
                yield dict(made), stored(path).identical(whole)
        finally:
            cluster.end()


def _ended(path, cluster, draw, targets, made, count):
    """Let a process go on with a map, and kill it or another one; whether it has come to its end,
    undisturbed or though another was killed."""
    if {*targets} - {"writer"}:
        cluster.stand()
    address = [] if cluster.file is None else [str(cluster.file)]
    writer, begun = started(path.parent, "-m", "tests.kills", str(path), *address), _begun(path)
    while not begun.exists() and writer.poll() is None:
        time.sleep(0.005)
    begun.unlink(missing_ok=True)
    target, after = draw.choice(targets), draw.uniform(0.0, LATEST)
    try:
        writer.wait(after if made.total() < count else None)
    except subprocess.TimeoutExpired:
        victim = writer if target == "writer" else cluster.running[target]
        victim.kill()
        victim.wait()
        made[target] += 1
        if target == "writer":
            return False
        cluster.stand()
        writer.wait(300)
    if writer.returncode:
        raise RuntimeError((path.parent / "said.txt").read_text())
    return True


def _begun(path):
    return path.with_suffix(".begun")


def main(path, scheduler=None):
    """Say that all is imported, and go on with a map."""
    executor = None
    if scheduler is not None:
        import distributed

        executor = distributed.Client(scheduler_file=scheduler).get_executor()
    _begun(Path(path)).touch()
    stored(path, executor)
    os._exit(0)  # a client whose scheduler is dead would wait for it


if __name__ == "__main__":
    main(*sys.argv[1:])
