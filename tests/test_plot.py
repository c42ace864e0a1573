"""Pictures show what the run holds."""

import numpy as np

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable

from .browser import opened, overflow


def test_axes_impacts_accumulations_and_table(tmp_path):
    """One row a state; impacts as dots at their places; the table drawn under the bead."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 7))
    figure = run.plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 10_000
    height, speed, phase, gaps = figure.axes
    assert (height.get_ylabel(), speed.get_ylabel()) == ("x [m]", "v [m/s]")
    dots = next(line for line in height.lines if line.get_marker() == ".")
    impacts = run.jumps.edge == "impact"
    np.testing.assert_array_equal(dots.get_xdata(), run.jumps.t[impacts])
    table = next(line for line in height.lines if line.get_zorder() == 0)
    np.testing.assert_allclose(table.get_ydata(), np.sin(3.5 * table.get_xdata()), atol=1e-12)
    assert gaps.get_yscale() == "log"
    assert phase.get_xlabel() == "x"


def test_a_loaded_run_and_shaped_states_can_be_drawn(tmp_path):
    """Without the model's functions; one row an element."""
    run = hy.simulate(BallOnCircle(), {"q": [0.15, 1.2], "p": [0, 0]}, (0, 4))
    assert len(run.plot().axes) == 6
    run.save(tmp_path / "run.nc")
    hy.load(tmp_path / "run.nc").plot(tmp_path / "again.png")


def test_a_run_without_jumps_can_be_drawn():
    """Nothing to put on the logarithmic axis."""
    run = hy.simulate(BeadOnTable(), {"x": 1.9, "v": 0.0}, (0, 0.1))
    assert len(run.plot().axes) == 4


def test_a_page_that_zooms(tmp_path):
    """The same curves, in one file that asks nothing of a network."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 7))
    figure = run.plot(tmp_path / "run.html")
    dots = next(trace for trace in figure.data if trace.name == "jump")
    impacts = run.jumps.edge == "impact"
    np.testing.assert_array_equal(dots.x, run.jumps.t[impacts])
    assert f"t = {run.jumps.t[0]:.15g}" in dots.text[0]
    assert "<script src" not in (tmp_path / "run.html").read_text()
    with opened(tmp_path / "run.html", width=390) as (page, complaints):
        page.locator(".main-svg").first.wait_for()
        assert page.title() == page.locator("h1").inner_text()
        assert page.title().startswith(f"BeadOnTable: {len(run.jumps)} jumps listed, accumulating")
        assert page.locator("meta[name=viewport]").count() == 1
        assert overflow(page) <= 0
        assert not complaints


def test_gaps_shrink_to_the_last_double():
    """The lengths of the arcs, not differences of times."""
    run = hy.simulate(BeadOnTable(r=0.5, omega=0.0), [1.0, 0.0], (0, 4))
    gaps = run.plot().axes[3].lines[0].get_ydata()
    np.testing.assert_allclose(gaps[1:] / gaps[:-1], 0.5, rtol=1e-9)
