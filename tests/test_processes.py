"""Lanes in other processes: the same Dataset, errors as themselves, and nothing left running."""

import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from scipy.integrate import LSODA, RK45

import hybrid as hy
from hybrid import gallery
from hybrid.automaton.digest import digest
from hybrid.ensembles import processes
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.two_tanks import TwoTanks

from . import systems
from .contract.ways import later

COUNT = 24
X, R = np.linspace(2.05, 2.4, COUNT), np.linspace(0.5, 0.9, COUNT)
FALL = {"x": np.linspace(0.5, 1.5, COUNT), "v": 0.0}

#: Steps that are not made by machine code.
IMPLICIT = {"solver": "scipy", "method": "Radau"}
KVAERNO = {"solver": "diffrax", "method": "Kvaerno3"}


class Failing(RK45):
    """A method of a user's that fails in the last lanes, by no fault of the model."""

    def __init__(self, fun, t0, y0, *given, **options):
        super().__init__(fun, t0, y0, *given, **options)
        if y0[0] > X[-2]:
            raise RuntimeError(f"no steps from {y0[0]}")


@pytest.fixture
def crew(monkeypatch):
    """A process beside this one at once, which waits for it; blocks that are asked."""
    asked, ready = [], threading.Event()
    hire = processes.Shared._hire

    class Process(processes._Process):
        started = []

        def __init__(self, job):
            super().__init__(job)
            self.started.append(self.process)

        def answer(self):
            try:
                return super().answer()
            finally:
                ready.set()

        def ask(self, numbers):
            asked.extend(numbers)
            super().ask(numbers)

    def wait(self, *given):
        hire(self, *given)
        if self.running:
            ready.wait(60.0)

    monkeypatch.setattr(processes, "PAYS", 1e-9)
    monkeypatch.setattr(processes, "cores", lambda: 2)
    monkeypatch.setattr(processes, "_Process", Process)
    monkeypatch.setattr(processes.Shared, "_hire", wait)
    yield asked
    assert all(process.poll() is not None for process in Process.started)


def alone(monkeypatch, *given, **options):
    """The same ensemble in this process."""
    with monkeypatch.context() as here:
        here.setattr(processes, "PAYS", np.inf)
        return hy.ensemble(*given, **options)


def square(k):
    """An answer that says who gave it."""
    time.sleep(0.02)
    return k * k, os.getpid()


def squares():
    """What makes that in another process."""
    return square


@pytest.mark.long
def test_all_answer_together(crew, monkeypatch):
    """Each number once, by more than one process; two are started."""
    monkeypatch.setattr(processes, "cores", lambda: 3)
    shared = processes.Shared(square, range(200), lambda: (squares,), lambda a, b: a[0] == b[0])
    found = list(shared.answers())
    assert sorted((k, v) for k, (v, _) in found) == [(k, k * k) for k in range(200)]
    assert len({who for _, (_, who) in found}) > 1
    assert len(processes._Process.started) == 2


@pytest.mark.parametrize(("asked", "count"), [("1", 1), ("64", 3), ("", 3), ("2,1", 3), ("0", 3)])
def test_no_more_cores_are_used_than_the_process_may_use(monkeypatch, asked, count):
    """Those on which it is let run, and no more than OMP_NUM_THREADS, if that is a number."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert processes.cores() == count


def test_few_calls_are_made_here(monkeypatch):
    """No process is started where that takes longer than the calls."""
    monkeypatch.setattr(processes, "_Process", None)
    shared = processes.Shared(square, range(20), lambda: (squares,), lambda a, b: a[0] == b[0])
    assert len(dict(shared.answers())) == 20


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "start", "t", "options"),
    [
        (HardSpring(), {"x": X, "v": 0.0}, (0.0, 1.0), IMPLICIT),
        *later(
            (HardSpring(), {"x": X, "v": 0.0}, (0.0, 1.0), KVAERNO),
            (TwoTanks(), {"x1": 7.0 + R, "x2": 6.0}, (R, 30.0), {}),
        ),
        (systems.Thermostat(), {"T": 18.0 + 3.0 * R}, (0.0, 2.0), {"method": LSODA}),
    ],
    ids=["scipy", "diffrax", "cycles", "outside"],
)
def test_other_processes_give_the_same(crew, monkeypatch, model, start, t, options):
    """The Dataset to the last bit, and a part of the lanes was theirs; lanes fail there, too."""
    told = []
    lanes = hy.ensemble(model, start, t, **options, progress=told.append)
    assert crew
    assert lanes.identical(alone(monkeypatch, model, start, t, **options))
    assert told == sorted(told)
    assert told[-1] == COUNT


def test_a_model_is_known_on_a_terminal_too():
    """Where JAX prints in colours; a map that was begun there is gone on with by others."""
    pytest.importorskip("pty")
    ours, theirs = os.openpty()
    code = (
        "import sys; from hybrid.automaton.digest import digest; "
        "from models.bouncing_ball import BouncingBall; "
        "print(digest(BouncingBall), sys.stdout.isatty())"
    )
    path = os.pathsep.join(map(os.path.abspath, sys.path))
    env = {**os.environ, "PYTHONPATH": path}
    subprocess.run([sys.executable, "-c", code], stdout=theirs, check=True, env=env)
    assert os.read(ours, 1000).decode().split() == [digest(BouncingBall), "True"]
    os.close(ours)
    os.close(theirs)


def test_an_error_elsewhere_is_itself(crew):
    """With the lane's own text, and the place where it was raised."""
    with pytest.raises(RuntimeError, match=r"no steps from 2\.4") as caught:
        hy.ensemble(HardSpring(), {"x": X, "v": 0.0}, (0.0, 0.5), solver="scipy", method=Failing)
    assert crew
    assert "In another process" in caught.value.__notes__[0]


def test_what_cannot_be_sent_is_flown_here(crew, monkeypatch):
    """A class within a function has no name elsewhere; that is said, and the lanes are the same."""

    class Local(hy.Automaton):
        x = hy.state()

        @hy.mode
        def only(self, t, s):
            return -s.x

    given = Local(), {"x": X}, (0.0, 1.0)
    with pytest.warns(UserWarning, match="Local.*in a module"):
        lanes = hy.ensemble(*given, solver="scipy")
    assert not crew
    assert lanes.identical(alone(monkeypatch, *given, solver="scipy"))


MODEL = """
import hybrid as hy

class Falls(hy.Automaton):
    x = hy.state()

    @hy.mode
    def only(self, t, s):
        return -{rate} * s.x
"""


def test_a_module_may_have_been_imported_by_its_path(crew, monkeypatch):
    """As those of the gallery are: they are imported in the same way."""
    given = gallery.find("relay").cls(), {"x": X}, (0.0, 0.5)
    lanes = hy.ensemble(*given, **IMPLICIT)
    assert crew
    assert lanes.identical(alone(monkeypatch, *given, **IMPLICIT))


def test_a_file_that_has_changed_is_not_believed(crew, tmp_path, monkeypatch):
    """Another process would read the new text; its lanes are flown here, by the old."""
    file = tmp_path / "falls_beside.py"
    file.write_text(MODEL.format(rate=1.0))
    monkeypatch.syspath_prepend(tmp_path)
    model = importlib.import_module("falls_beside").Falls()
    file.write_text(MODEL.format(rate=20.0))
    with pytest.warns(UserWarning, match="Falls is another class there"):
        lanes = hy.ensemble(model, {"x": X}, (0.0, 1.0), solver="scipy")
    np.testing.assert_allclose(lanes.x, X * np.exp(-1.0), rtol=1e-6)  # the tolerance is 1e-8 a step


@pytest.mark.long
def test_another_answer_is_not_believed(crew):
    """A function that depends on its process: all calls are made here."""
    shared = processes.Shared(square, range(50), lambda: (squares,), lambda a, b: a == b)
    with pytest.warns(UserWarning, match="gives another answer"):
        found = list(shared.answers())
    assert {who for _, (_, who) in found} == {os.getpid()}
    assert sorted(k for k, _ in found) == list(range(50))


def test_a_process_that_dies_is_replaced_here(crew, monkeypatch):
    """What it was asked is flown here."""
    ask = processes._Process.ask

    def killed(process, numbers):
        ask(process, numbers)
        process.process.kill()

    monkeypatch.setattr(processes._Process, "ask", killed)
    given = BouncingBall(), FALL, (0.0, 1.0)
    with pytest.warns(UserWarning, match="another process has ended"):
        lanes = hy.ensemble(*given, **IMPLICIT)
    assert crew
    assert lanes.identical(alone(monkeypatch, *given, **IMPLICIT))


SCRIPT = """
import signal
import numpy as np
import hybrid as hy
from hybrid.ensembles import processes
from models.bouncing_ball import BouncingBall

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
processes.PAYS = 1e-9
processes.cores = lambda: 3
print("once", flush=True)
x = np.linspace(0.5, 1.5, 100_000)
told = lambda count: count == 50 and print([p.process.pid for p in PROCESSES], flush=True)
PROCESSES, start = [], processes._Process.__init__

def started(self, job):
    start(self, job)
    PROCESSES.append(self)

processes._Process.__init__ = started
try:
    fall, options = {"x": x, "v": 0.0}, {"solver": "scipy", "method": "Radau"}
    hy.ensemble(BouncingBall(), fall, (0.0, 3.0), **options, progress=told)
except KeyboardInterrupt:
    print([p.process.returncode for p in PROCESSES])
"""


def test_the_keyboard_ends_all_of_them(tmp_path):
    """Of a script that is not guarded by its name, and so would begin anew if it were imported.

    Pressed again where it is lost: while a library is told of a collection of garbage.
    """
    (tmp_path / "script.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
    )
    assert process.stdout.readline() == "once\n"
    assert len(eval(process.stdout.readline())) == 2
    said = None
    for _ in range(12):
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            said, _ = process.communicate(timeout=5.0)
            break
    assert said == f"{[-signal.SIGKILL] * 2}\n"
