"""Fixtures: every rule is held on every solver."""

import contextlib
import ctypes
import gc
import json
import os
import resource
import signal
from collections import defaultdict
from importlib.metadata import EntryPoint
from pathlib import Path
from zlib import crc32

import jax
import pytest

from hybrid import solvers
from hybrid.lowering.jit import XLA_OPTIONS
from hybrid.rules import unit
from hybrid.rules.load import cache_folder

from .contract.ways import MECHANISMS, SOLVERS, WAYS

#: Those that reach rounding.
ACCURATE = ["DOP853", "taylor", "Dopri8"]

#: Second methods of a mechanism.
SECOND = [name for name in SOLVERS if name not in MECHANISMS]

#: Ways that take longer than the others, and which deal says what third of the tests meets each:
#: Diffrax's programs are traced anew for each class, and implicit steps are made in Python.
COSTLY = {"Dopri8": 0, "diffrax": 0, "Radau": 1}

#: Marks of what ``make test`` leaves to others.
LEFT_OUT = {"pages", "every_way", "long"}

#: Of so many points of a scan one stays, and one at least of each.
DEAL = 8

#: Bytes of memory from which on a worker gives back what it no longer needs: two workers of the
#: suite then fit where there are 8 GB.
ENOUGH = 2 << 30


@pytest.fixture(autouse=True, scope="module")
def _memory_is_given_back():
    """Compiled programs of a module's classes, some 100 MB for each, do not pile up."""
    yield
    if _resident() > ENOUGH:
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # where the C library is another
            ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture
def keyboard():
    """Interrupts, as at a prompt: what a shell starts in its background ignores them."""
    was = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, was)


def _resident():
    """Bytes of memory that this process holds; 0 where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0
    return pages * resource.getpagesize()


@pytest.fixture(autouse=True, scope="session")
def _classic_is_plugged_in():
    """The solver of docs/extending.md, as if a package had declared it."""
    found = solvers.entry_points
    point = EntryPoint("classic", "tests.plugged:Classic", solvers.GROUP)
    solvers.entry_points = lambda group: [*found(group=group), point]
    yield
    solvers.entry_points = found


@pytest.fixture(autouse=True, scope="session")
def _rules_are_compiled():
    """So that no test finds the line in its output that says that they are being compiled."""
    for name in ("zeros", "runs"):  # and what is needed together with them
        unit(name)


def pytest_configure(config):
    """What XLA compiles is kept, from test to test and from run to run, as the rules are.

    What calls back cannot be kept. It is compiled as the package compiles its own programs, in a
    third of the time; but for what ``make test`` leaves out, which has XLA's settings as a user has
    them.
    """
    if not config.getoption("markexpr").startswith("every_way"):
        flags = (f"--{name}={value}" for name, value in XLA_OPTIONS.items())
        os.environ["XLA_FLAGS"] = " ".join((os.environ.get("XLA_FLAGS", ""), *flags))
    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def pytest_collection():
    """While classes are made little is garbage, and it takes a third of the time to look."""
    gc.disable()


def pytest_collection_finish():
    """What is there before the first test stays: no collection of garbage looks through it."""
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def pytest_addoption(parser):
    """A choice of ways in, for a run of a part of the contract."""
    parser.addoption("--ways", help="only tests on these ways in, such as DOP853,taylor")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Those that are chosen. Two tests in three leave each costly way to ``-m every_way``, where
    they are met by one that is not; and of a whole folder scans are dealt."""
    met = defaultdict(set)
    for item in items:
        if not any(item.iter_markers("every_way")):
            met[item.nodeid.partition("[")[0]].add(_way_of(item))
    for item in items:
        test, way = item.nodeid.partition("[")[0], _way_of(item)
        leaves = way in COSTLY and met[test] - COSTLY.keys() and not _dealt(test, COSTLY[way])
        if leaves and not any(item.iter_markers("each_method")):
            item.add_marker(pytest.mark.every_way)
    if all(Path(arg).is_dir() for arg in config.args):  # no file, and no test, is asked for
        _deal(items)
    if chosen := config.getoption("--ways"):
        others = [item for item in items if _way_of(item) not in chosen.split(",")]
        items[:] = [item for item in items if item not in others]
        config.hook.pytest_deselected(items=others)


def _deal(items):
    """Leave most points of each scan to ``-m every_way``: those of the highest hashes of names."""
    scans = defaultdict(list)
    for item in items:
        if hasattr(item, "callspec") and not LEFT_OUT & {mark.name for mark in item.iter_markers()}:
            scans[item.nodeid.partition("[")[0]].append(item)
    for points in scans.values():
        points.sort(key=lambda item: crc32(item.nodeid.encode()))
        for item in points[-(-len(points) // DEAL) :]:
            item.add_marker(pytest.mark.every_way)


def _dealt(test, deal):
    """Whether a test is of the third that is dealt to a way."""
    return crc32(test.encode()) // 3**deal % 3 == 0


def _way_of(item):
    """The way in that a test takes, if one."""
    params = item.callspec.params if hasattr(item, "callspec") else {}
    return next((params[name] for name in ("way", "solver", "accurate") if name in params), None)


def pytest_generate_tests(metafunc):
    """Each solver for the fixtures below, but for those in the test module's ``WITHOUT``.

    ``way`` has those of the module's ``WAYS``, or one of each mechanism.
    """
    marks = metafunc.definition.iter_markers("parametrize")
    own = [name for mark in marks for name in _names(mark.args[0])]
    own += vars(metafunc.module)
    for fixture, names in (("solver", SOLVERS), ("accurate", ACCURATE)):
        if fixture in metafunc.fixturenames and fixture not in own:
            able = [name for name in names if name not in getattr(metafunc.module, "WITHOUT", ())]
            metafunc.parametrize(fixture, _marked(metafunc, able), indirect=True)
    if "way" in metafunc.fixturenames and "way" not in own:
        chosen = getattr(metafunc.module, "WAYS", MECHANISMS)
        metafunc.parametrize("way", _marked(metafunc, chosen), indirect=True)


def _names(argnames):
    """The names of a scan, one or several."""
    return argnames.replace(",", " ").split() if isinstance(argnames, str) else argnames


def _marked(metafunc, names):
    """Second methods of a mechanism are left to ``-m every_way``, but by tests of each method."""
    if any(metafunc.definition.iter_markers("each_method")):
        return list(names)
    more = pytest.mark.every_way
    return [pytest.param(n, marks=more) if n in SECOND else n for n in names]


@pytest.fixture
def solver(request):
    """Options that choose a solver; a new backend is one line above."""
    return SOLVERS[request.param]


@pytest.fixture
def way(request):
    """A way in: ``way.run(model, start, t, ...)`` (:mod:`tests.contract.ways`)."""
    return WAYS[request.param]


@pytest.fixture
def accurate(request):
    """Options of the solvers that reach rounding, with tolerances to match."""
    return {**SOLVERS[request.param], "rtol": 1e-12, "atol": 1e-12}


@pytest.fixture(scope="session")
def reference():
    """Reference values, computed with 40 digits or more by two methods."""
    return json.loads((Path(__file__).parent / "reference.json").read_text())


@pytest.fixture(scope="session")
def folder():
    """The folder of the models."""
    return Path(__file__).parent.parent / "models"
