"""Small pictures, pictures for papers, drawings of automata, and moving ones."""

import xml.etree.ElementTree as ElementTree

import numpy as np

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
