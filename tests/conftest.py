"""Fixtures: every rule is held on every solver."""

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from hybrid import solvers

SOLVERS = {
    "DOP853": {"solver": "scipy", "method": "DOP853"},
    "RK45": {"solver": "scipy", "method": "RK45"},
    "RK23": {"solver": "scipy", "method": "RK23"},
    "Radau": {"solver": "scipy", "method": "Radau"},
    "BDF": {"solver": "scipy", "method": "BDF"},
    "LSODA": {"solver": "scipy", "method": "LSODA"},
    "taylor": {"solver": "taylor"},
    "Tsit5": {"solver": "diffrax", "method": "Tsit5"},
    "Dopri8": {"solver": "diffrax", "method": "Dopri8"},
    "Kvaerno5": {"solver": "diffrax", "method": "Kvaerno5"},
    "Taylor": {"solver": "diffrax", "method": "Taylor"},
    "classic": {"solver": "classic"},
}

#: Those that reach rounding.
ACCURATE = ["DOP853", "taylor", "Dopri8", "Taylor"]


@pytest.fixture(autouse=True, scope="session")
def _classic_is_plugged_in():
    """The solver of docs/extending.md, as if a package had declared it."""
    found = solvers.entry_points
    point = EntryPoint("classic", "tests.plugged:Classic", solvers.GROUP)
    solvers.entry_points = lambda group: [*found(group=group), point]
    yield
    solvers.entry_points = found


def pytest_generate_tests(metafunc):
    """Each solver for the fixtures below, but for those in the test module's ``WITHOUT``."""
    own = [mark.args[0] for mark in metafunc.definition.iter_markers("parametrize")]
    own += vars(metafunc.module)
    for fixture, names in (("solver", SOLVERS), ("accurate", ACCURATE)):
        if fixture in metafunc.fixturenames and fixture not in own:
            able = [name for name in names if name not in getattr(metafunc.module, "WITHOUT", ())]
            metafunc.parametrize(fixture, able, indirect=True)


@pytest.fixture
def solver(request):
    """Options that choose a solver; a new backend is one line above."""
    return SOLVERS[request.param]


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
