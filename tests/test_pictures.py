"""Small pictures, pictures for papers, drawings of automata, and moving ones."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall


def test_a_notebook_shows_words_and_a_small_picture():
    """Whole SVG of some kilobytes, with a curve for each state, however many jumps there are."""
    ball = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3))
    long = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 120), solver="taylor")
    for run in (ball, long, ball + hy.simulate(BouncingBall(), ball, (3.0, 4.0))):
        page = run._repr_html_()
        assert len(page) < 20_000
        words, svg = page.split("\n<svg", 1)
        assert "accumulation at" in words
        root = ElementTree.fromstring(f"<svg{svg}")
        said = [each.text for each in root if each.tag.endswith("text")]
        assert {"x", "v", "t", f"{run.t1:.6g}"} <= set(said)
        assert sum(each.tag.endswith("path") for each in root) >= 4


def test_the_table_of_jumps_as_a_frame():
    """A row a jump, a column an element of the state before and after."""
    run = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 3))
    frame = run.jumps.to_pandas()
    assert list(frame.columns) == ["t", "j", "edge", "x_before", "v_before", "x_after", "v_after"]
    np.testing.assert_array_equal(frame.t, run.jumps.t)
    np.testing.assert_array_equal(frame.v_after, run.jumps.after.v)
    assert set(frame.edge) == {"impact"}
    empty = hy.simulate(BouncingBall(), [1.0, 0.0], (0, 0.1)).jumps.to_pandas()
    assert empty.shape == (0, 7)


class Masses(hy.Automaton):
    """Six free masses, of which the first meets a wall."""

    q = hy.state(unit="m", shape=(6,))
    p = hy.state(unit="m/s", shape=(6,))

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.p, -0.5 + 0.0 * s.q

    wall = hy.contact(flight, gap=lambda self, t, s: s.q[0] + 0.4, restitution=0.6)

    @hy.output(unit="J")
    def energy(self, t, s):
        return 0.5 * (s.p @ s.p)


def masses():
    return hy.simulate(Masses(), {"q": [0.1] * 6, "p": [0.0] * 6}, (0.0, 6.0), solver="taylor")


def labels_overlap(figure):
    """Pairs of axes whose tight boxes overlap: a label of one lies on the other."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [axes.get_tightbbox(canvas.get_renderer()) for axes in figure.axes]
    shown = figure.bbox.padded(1.0)
    cut = [
        box
        for box in boxes
        if not (shown.contains(box.x0, box.y0) and shown.contains(box.x1, box.y1))
    ]
    pairs = [(a, b) for k, a in enumerate(boxes) for b in boxes[:k]]
    return cut + [1 for a, b in pairs if a.padded(-1.0).overlaps(b.padded(-1.0))]


def test_twelve_states_are_one_readable_page():
    """Two columns of six, a strip of modes below each, units on every axis, no label on another."""
    figure = masses().plot()
    assert len(figure.axes) == 12 + 2 + 2
    width, height = figure.get_size_inches()
    assert (width, height) < (15, 11)
    assert not labels_overlap(figure)
    for axes in figure.axes:
        assert axes.get_ylabel() or axes.get_yticklabels()
    assert {axes.get_ylabel() for axes in figure.axes} >= {"q[3] [m]", "p[5] [m/s]"}


def test_the_strip_of_modes_shows_when_the_run_is_in_which():
    """A bar from the start to the end of each arc, in the row of its mode; none where it is one."""
    run = masses()
    (strip,) = run.plot(panels="modes").axes
    assert [each.get_text() for each in strip.get_yticklabels()] == ["flight.rest(wall)", "flight"]
    bars = [line.get_xdata() for line in strip.lines if line.get_linestyle() == "-"]
    assert (bars[0][0], bars[0][-1]) == (run.zeno[0].t, 6.0)
    assert (bars[1][0], bars[1][-1]) == (0.0, run.zeno[0].t)
    still = hy.simulate(Masses(), {"q": [1.0] * 6, "p": [0.0] * 6}, (0, 1))
    assert len(still.plot().axes) == 12 + 1


def test_panels_are_chosen_and_drawn_where_asked():
    """On axes of the caller's, in the size asked for, with outputs as with states."""
    from matplotlib.figure import Figure

    run = masses()
    mine = Figure()
    axes = mine.subplots(2, 2)
    assert run.plot(["q[0]", "energy"], panels=("time", "modes", "phase"), ax=axes) is mine
    assert [each.get_ylabel() for each in axes.flat] == ["q[0] [m]", "energy [J]", "", "energy [J]"]
    assert axes[1, 1].get_xlabel() == "q[0] [m]"
    small = run.plot(["energy"], panels=("time", "modes"), size=(3.4, 2.6))
    assert small.get_size_inches().tolist() == [3.4, 2.6]
    assert not labels_overlap(small)
    with pytest.raises(hy.OptionError, match="ax: 4 axes for 1 panels: energy"):
        run.plot(["energy"], ax=axes)
    with pytest.raises(hy.OptionError, match="panels: 'tiem'; there are: time, phase, gaps, modes"):
        run.plot(panels=("tiem",))
