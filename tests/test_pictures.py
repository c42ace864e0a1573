"""Small pictures, pictures for papers, drawings of automata, and moving ones."""

import xml.etree.ElementTree as ElementTree
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import hybrid as hy
from hybrid.automaton.picture import looks
from hybrid.plot.graph import graph
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.relay import Relay
from models.two_tanks import TwoTanks

from .systems import Thermostat


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


class Pendulum(hy.Automaton):
    """A pendulum beside a wall."""

    a = hy.state(unit="rad")
    w = hy.state(unit="rad/s")
    length = hy.parameter(2.0)

    @hy.mode
    def swing(self, t, s):
        return s.w, -9.81 * jnp.sin(s.a) / self.length

    wall = hy.contact(swing, gap=lambda self, t, s: s.a + 0.2, restitution=0.8)

    @hy.picture
    def look(self, t, s):
        bob = self.length * jnp.array([jnp.sin(s.a), -jnp.cos(s.a)])
        return [jnp.stack([jnp.zeros(2), bob]), bob[None]]


def test_a_model_that_says_what_it_looks_like_moves(tmp_path):
    """Frames over the whole run, in which something moves; a method that can still be called."""
    run = hy.simulate(Pendulum(length=1.5), {"a": 1.0, "w": 0.0}, (0.0, 2.0))
    run.animate(tmp_path / "run.gif", seconds=0.5, fps=10, size=(2.0, 2.0))
    with Image.open(tmp_path / "run.gif") as movie:
        assert (movie.n_frames, movie.size) == (5, (200, 200))
        frames = []
        for k in range(movie.n_frames):
            movie.seek(k)
            frames.append(np.asarray(movie.convert("L")))
    assert all(np.any(one != other) for one, other in pairwise(frames))
    times, states = np.array([0.0, 1.0]), np.array([[0.5, 0.0], [1.0, 0.0]])
    rod, bob = looks(run.spec, run.parameters, times, states)
    assert (rod.shape, bob.shape) == ((2, 2, 2), (2, 1, 2))
    np.testing.assert_allclose(bob[1, 0], [1.5 * np.sin(1.0), -1.5 * np.cos(1.0)], rtol=1e-15)
    assert len(Pendulum().look(0.0, run(1.0))) == 2


class Measured(hy.Automaton):
    """A body on a road that is measured, which counts."""

    x = hy.state()
    n = hy.discrete(0)
    road = hy.signal()

    @hy.mode(initial=True)
    def rides(self, t, s):
        return 1.0

    @hy.edge(rides, every=0.5, when=lambda self, t, s: self.road(t) > 0.5)
    def count(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(rides, at=(0.25, 0.75))
    def mark(self, t, s):
        return s

    @hy.picture
    def look(self, t, s):
        return [jnp.stack([s.x, self.road(t)])[None], jnp.stack([0.0, 1.0 * s.n])[None]]


def test_a_picture_reads_signals_and_discrete_variables(tmp_path):
    run = hy.simulate(Measured(road=([0.0, 2.0], [0.0, 2.0])), {"x": 0.0}, (0.0, 2.0))
    run.animate(tmp_path / "run.gif", seconds=0.5, fps=10, size=(2.0, 2.0))
    times = np.array([0.5, 1.75])
    body, count = looks(run.spec, run.parameters, times, run.states(times))
    np.testing.assert_allclose(body[:, 0], [[0.5, 0.5], [1.75, 1.75]], atol=1e-8)
    assert count[:, 0, 1].tolist() == [0.0, 2.0]


def test_an_axis_of_equal_gaps_has_labels_that_differ():
    """Of a clock, whose jumps are as far from each other."""
    run = hy.simulate(Measured(road=([0.0, 9.0], [1.0, 1.0])), {"x": 0.0}, (1.0, 9.0))
    figure = run.plot(["x"], panels=("gaps",))
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[-1]
    low, high = axes.get_ylim()
    assert low < 0.48 < 0.52 < high
    named = [each.get_text() for each in axes.get_yticklabels() if each.get_text()]
    assert len(named) == len(set(named))


class Shapeless(Pendulum):
    @hy.picture
    def look(self, t, s):
        return [jnp.array([s.a, s.w, s.a])]


@pytest.mark.parametrize(
    ("model", "path", "options", "said"),
    [
        (Shapeless(), "x.gif", {}, r"look gives an array of shape \(3,\); give a list"),
        (BouncingBall(), "x.gif", {}, "it has no method with @hy.picture"),
        (Pendulum(), "x.mp4", {}, "end the name in .gif"),
        (Pendulum(), "x.gif", {"fps": 0}, "two frames at least"),
    ],
)
def test_what_cannot_be_shown_moving_is_refused(model, path, options, said, tmp_path):
    """With a sentence."""
    run = hy.simulate(model, [1.0, 0.0], (0.0, 0.1))
    with pytest.raises(hy.OptionError, match=said):
        run.animate(tmp_path / path, **options)


GRAPHS = {
    "ball": (BouncingBall, ["flight", "flight.rest(impact)"], {("flight", "flight"): ["impact ↓"]}),
    "thermostat": (
        Thermostat,
        ["on", "off"],
        {("on", "off"): ["hot ↓"], ("off", "on"): ["cold ↓"]},
    ),
    "relay": (
        Relay,
        ["up", "slide(relay)", "down"],
        {("up", "down"): ["relay ↓"], ("down", "up"): ["relay ↑"]},
    ),
    "clocks": (
        Measured,
        ["rides"],
        {("rides", "rides"): ["count, every 0.5, when", "mark, at 0.25, 0.75"]},
    ),
    "tanks": (
        TwoTanks,
        ["fills_first", "fills_second", "shares"],
        {
            ("fills_first", "fills_second"): ["to_second ↓"],
            ("fills_second", "fills_first"): ["to_first ↓"],
            ("fills_first", "shares"): ["limit ∞"],
        },
    ),
}


@pytest.mark.parametrize("name", GRAPHS)
def test_an_automaton_as_boxes_and_arrows(name, tmp_path):
    """Every mode once, rests and sliding beside them; every edge with the way of its guard."""
    model, nodes, edges = GRAPHS[name]
    shown = graph(model.spec)
    assert [node.name for node in shown.nodes] == nodes
    labelled = [arrow for arrow in shown.arrows if arrow.labels]
    assert {(nodes[a.source], nodes[a.to]): list(a.labels) for a in labelled} == edges
    dashed = [node for node in shown.nodes if node.kind in ("rest", "slide")]
    assert len(shown.arrows) - len(labelled) == sum(1 + (n.kind == "slide") for n in dashed)
    figure = model.draw(tmp_path / "graph.png")
    assert (tmp_path / "graph.png").stat().st_size > 5_000
    assert set(nodes) <= {text.get_text() for text in figure.axes[0].texts}
    boxes = texts_apart(figure)
    assert len(boxes) == len(nodes) + len(labelled) + 2  # the model's name, and how to read arrows


def texts_apart(figure):
    """What the texts of a drawing cover: none of them another."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in figure.axes[0].texts]
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
    return boxes


def test_a_clock_is_drawn_with_its_times():
    """Not with a way in which a guard goes that it does not have."""

    class Sampled(hy.Automaton):
        x = hy.state()
        T: float = hy.parameter(0.5)

        @hy.mode
        def flow(self, t, s):
            return -s.x

        sample = hy.edge(flow, every="T")
        dose = hy.edge(flow, at=(1.0, 2.5))

    (arrow,) = graph(Sampled.spec).arrows
    assert arrow.labels == ("sample, every T", "dose, at 1.0, 2.5")
    assert "guards:" not in "".join(text.get_text() for text in Sampled.draw().axes[0].texts)


def test_twelve_modes_are_apart():
    """No box on another, no label on a box, nothing cut off, on one page."""
    body = {"x": hy.state()}
    for k in range(12):
        body[f"mode_{k}"] = hy.mode(initial=k == 0)(lambda self, t, s: 1.0)
    for k in range(12):
        edge = hy.edge(f"mode_{k}", to=f"mode_{(k + 1) % 12}", guard=lambda self, t, s: 1.0 - s.x)
        body[f"next_{k}"] = edge(lambda self, t, s: s)
    figure = type("Ring", (hy.Automaton,), body).draw()
    assert max(figure.get_size_inches()) < 12
    boxes = texts_apart(figure)
    assert len(boxes) == 12 + 12 + 2
    for box in boxes:
        assert figure.bbox.contains(box.x0, box.y0)
        assert figure.bbox.contains(box.x1, box.y1)
