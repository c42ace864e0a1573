"""Table 1 of the paper as docs/delays.md tells it: ``benchmarks/table_1.py`` and the page agree."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

#: With 30 digits, by two other methods.
AT_REST = {
    2.1: 0.51205106810409627928,
    3.0: 0.92191979269597509266,
    100.0: 0.89950413093673869326,
}
PERIOD, TOP, SPEED = 1.22148625814537487238, 4.93571610633288880777, 5.72133571436281266266
MULTIPLIER, BORDER = -0.578307906333, 2.3848776227496940476


@pytest.fixture(scope="module")
def table():
    """The script, as a module."""
    spec = importlib.util.spec_from_file_location("table_1", ROOT / "benchmarks" / "table_1.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def shown():
    """The rows of the page's table by start."""
    found = re.findall(r"^\| ([\d.]+) \| (.+?) \| (.+?) \| (.+?) \|$", page(), re.MULTILINE)
    return {float(row[0]): row[1:] for row in found}


def page():
    return (ROOT / "docs" / "delays.md").read_text()


@pytest.mark.parametrize("x0", [2.1, 2.5, 3.0, 5.0, 10.0, 100.0])
def test_with_its_memory_the_system_comes_to_rest(table, shown, x0):
    """Certified, as the page says; and to 2e-11 where digits are known."""
    found = table.row(x0)
    assert (found.certified, found.released) == (True, False)
    assert f"{found.rests:.9f}" == shown[x0][0]
    assert x0 not in AT_REST or abs(found.rests - AT_REST[x0]) <= 2e-11


@pytest.mark.parametrize("x0", [2.5, 10.0])
def test_without_it_the_papers_orbit_appears(table, shown, x0):
    """Period and amplitude."""
    found = table.row(x0)
    assert f"{found.period:.6f}, {found.amplitude:.6f}" == shown[x0][1]
    assert shown[x0][2] == f"{table.PERIOD}, {table.AMPLITUDE}"


def test_the_orbit_its_multiplier_and_the_border(table):
    """To the digits known."""
    orbit = table.orbit()
    assert orbit.start.x2 == pytest.approx(SPEED, abs=1e-11)
    assert orbit.period == pytest.approx(PERIOD, abs=1e-12)
    assert orbit.extrema["x1"][1] == pytest.approx(TOP, abs=1e-11)
    assert orbit.multipliers[1].real == pytest.approx(MULTIPLIER, abs=1e-10)
    assert (orbit.jumps, orbit.stable) == (1, True)
    assert table.border().start == pytest.approx(BORDER, abs=1e-11)


def test_released_by_the_past(table):
    """The rests and releases that the page lists, and no more of them."""
    run = table.released()
    times = [t for point in run.zeno for t in (point.t, point.t_release) if t is not None]
    assert len(times) == 9
    assert all(f"{t:.9f}" in page() for t in times)
    assert run.zeno[-1].t_release is None
    last_hop = max(run(6.4 + 0.001 * k).x1 for k in range(200))
    assert f"{last_hop:.4f}" in page()
