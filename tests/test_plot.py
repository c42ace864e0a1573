"""Pictures show what the run holds."""

import numpy as np
import pytest

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.relay import Relay

from .browser import opened, overflow


def test_axes_impacts_accumulations_and_table(tmp_path):
    """One row a state; impacts as dots at their places; the table drawn under the bead."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 7))
    figure = run.plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 10_000
    height, speed, modes, phase, gaps = figure.axes
    assert (height.get_ylabel(), speed.get_ylabel()) == ("x [m]", "v [m/s]")
    dots = next(line for line in height.lines if line.get_marker() == ".")
    impacts = run.jumps.edge == "impact"
    np.testing.assert_array_equal(dots.get_xdata(), run.jumps.t[impacts])
    table = next(line for line in height.lines if line.get_zorder() == 0)
    np.testing.assert_allclose(table.get_ydata(), np.sin(3.5 * table.get_xdata()), atol=1e-12)
    assert gaps.get_yscale() == "log"
    assert (phase.get_xlabel(), phase.get_ylabel()) == ("x [m]", "v [m/s]")
    assert [label.get_text() for label in modes.get_yticklabels()] == [
        "flight.rest(impact)",
        "flight",
    ]


def test_a_loaded_run_and_shaped_states_can_be_drawn(tmp_path):
    """Without the model's functions; one row an element."""
    run = hy.simulate(BallOnCircle(), {"q": [0.15, 1.2], "p": [0, 0]}, (0, 4))
    assert len(run.plot().axes) == 7
    run.save(tmp_path / "run.nc")
    hy.load(tmp_path / "run.nc").plot(tmp_path / "again.png")


def test_a_run_without_jumps_has_no_panel_for_gaps_between_them():
    """No axes are empty; with one state there is one panel."""
    run = hy.simulate(BeadOnTable(), {"x": 1.9, "v": 0.0}, (0, 0.1))
    axes = run.plot().axes
    assert len(axes) == 3
    assert all(any(line.get_xdata().size for line in each.lines) for each in axes)
    assert len(hy.simulate(Relay(), {"x": 0.5}, (0, 0.1)).plot().axes) == 1


@pytest.mark.parametrize("save", ["jumps", np.linspace(0.0, 7.0, 50)])
def test_what_was_not_kept_is_not_drawn(save):
    """Dots at the ends of arcs and at the times asked for, and no chords between them."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 7), save=save)
    height, phase = run.plot().axes[0], run.plot().axes[3]
    drawn = [line for line in height.lines if line.get_zorder() != 0]
    lines = [line for line in drawn if line.get_linestyle() != "--"]
    assert len(lines) == 3  # the tail, which is known between its impacts; dots; jumps
    tail, kept, _ = lines
    assert tail.get_xdata()[0] > run.jumps.t[1]
    assert (kept.get_linestyle(), kept.get_marker()) == ("None", ".")
    assert set(kept.get_xdata()) >= {
        run.t0,
        run.t1,
        *(save if isinstance(save, np.ndarray) else ()),
    }
    assert any(line.get_marker() == "." and line.get_linestyle() == "None" for line in phase.lines)


def test_a_picture_measures_nothing(monkeypatch):
    """Four hundred accumulations are drawn as they are known: bounds cost a run each."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 730), solver="taylor")
    assert len(run.zeno) >= 400
    monkeypatch.setattr("hybrid.run.comparison.Driver", None)
    title = run.plot()._suptitle.get_text()
    assert "±" not in title
    assert not any(point.measured for point in run.zeno)
    assert len(repr(run).splitlines()) <= 12
    assert repr(run.zeno[3]).startswith(f"t_inf = {run.zeno[3].t!r}, state")


def test_words_about_many_accumulations_are_few(monkeypatch):
    """The first and the last, unless all are asked for."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 120), solver="taylor")
    monkeypatch.setattr("hybrid.trajectory.trajectory.explain", lambda point: f"at {point.t}")
    assert len(run.zeno) > 50
    assert len(run.explain().splitlines()) <= 40
    assert f"at {run.zeno[-1].t}" in run.explain()
    assert len(run.explain(whole=True).splitlines()) == len(run.zeno) + 2


@pytest.mark.long
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
        assert page.title().startswith("BeadOnTable: jumps accumulate at t = ")
        assert page.locator("meta[name=viewport]").count() == 1
        assert overflow(page) <= 0
        assert not complaints


def test_gaps_shrink_to_the_last_double():
    """The lengths of the arcs, not differences of times."""
    run = hy.simulate(BeadOnTable(r=0.5, omega=0.0), [1.0, 0.0], (0, 4))
    gaps = run.plot().axes[4].lines[0].get_ydata()
    np.testing.assert_allclose(gaps[1:] / gaps[:-1], 0.5, rtol=1e-9)


def test_gaps_that_hardly_differ_are_not_on_a_logarithmic_axis():
    """Whose ticks would be 6.25, 6.3, ... times ten to the 0."""
    from hybrid.plot.of_run import gaps_panel

    even = hy.simulate(BouncingBall(r=0.99), {"x": 1.0, "v": 0.0}, (0.0, 5.0))
    assert gaps_panel(even).log == ""
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0))
    assert gaps_panel(run).log == "y"
