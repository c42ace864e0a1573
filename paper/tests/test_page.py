"""The report's page, in a browser: what a reader sees and does."""

import numpy as np
import pytest

from hybrid.plot.figure import Cells, Curve, Figure, Panel, Slider, column, slid
from hybrid.plot.of_run import states_panel, zooms
from hybrid.simulation import simulate
from models.bouncing_ball import BouncingBall
from paper.claims import Claim, Number, Section, Verdict
from paper.page import write
from tests.browser import opened, overflow


def section():
    """A run that can be zoomed into, a slider, a map; signs that HTML would take for its own."""
    run = simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0))
    panels = column(states_panel(run, "x", points=4000), states_panel(run, "v", points=4000))
    ball = Figure(name="ball", title="A ball </script> & <b>", columns=panels, zooms=zooms(run))
    x = np.linspace(0.0, 1.0, 50)
    stops = [
        (f"{r:g}", column(Panel(curves=[Curve(x=x, y=np.minimum(x, r))]))) for r in (0.5, 0.3, 0.1)
    ]
    lines = slid(Slider(label="r", stops=stops), name="lines", title="Lines")
    kind = np.array([[0, 1], [1, 0]])
    notes = np.array([["a", "b"], ["c", "d"]])
    kinds = [("yes", "#2e8b57"), ("no", "#c44e52")]
    cells = Cells(x=np.arange(2.0), y=np.arange(2.0), kind=kind, kinds=kinds, notes=notes)
    squares = Figure(name="map", title="A map", columns=column(Panel(cells=cells, x="a", y="b")))
    claim = Claim(
        place="Section 0",
        says="x < y & z, with `code`",
        verdict=Verdict.CORRECTED,
        found="found",
        how="how",
        numbers=[Number(what="t_inf", ours=run.zeno[0].t, error=1e-12, paper="2.56")],
        figures=[ball, lines, squares],
    )
    return Section(name="test", title="0. A section", about="about", claims=[claim])


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write([section()], tmp_path_factory.mktemp("report"), "made by a test")


def drawn(tab, name):
    """The place of a figure, once it is drawn."""
    place = tab.locator(f"#plot-{name}")
    place.scroll_into_view_if_needed()
    place.locator(".main-svg").first.wait_for()
    return place


def path(place):
    """The first line that is drawn, as SVG has it."""
    return place.locator(".scatterlayer .js-line").first.get_attribute("d")


def test_the_page_opens_without_a_network_and_without_complaint(page):
    """All figures are drawn, nothing is asked for, nothing goes wrong."""
    with opened(page) as (tab, complaints):
        for name in ("ball", "lines", "map"):
            assert drawn(tab, name).locator(".xy").count() > 0
        assert not complaints
        assert tab.locator("h2").all_inner_texts() == ["All claims", "0. A section"]
        assert tab.locator("blockquote").inner_text() == "x < y & z, with code"
        assert "2.558633965586" in tab.locator("table.numbers").inner_text()


def test_the_slider_changes_the_curve(page):
    """At another value another line is drawn, on the same axes."""
    with opened(page) as (tab, complaints):
        place = drawn(tab, "lines")
        before = path(place)
        rail = place.locator(".slider-rail-touch-rect").bounding_box()
        tab.mouse.click(rail["x"] + rail["width"] - 2, rail["y"] + rail["height"] / 2)
        tab.wait_for_function("document.querySelector('#plot-lines').layout.sliders[0].active == 2")
        assert place.locator(".slider-label").first.text_content() == "r = 0.1"
        shown = "document.querySelector('#plot-lines')._fullData.filter(d => d.visible === true)"
        assert tab.evaluate(f"{shown}.length") == 1
        assert max(tab.evaluate(f"Array.from({shown}[0].y)")) == pytest.approx(0.1)
        assert path(place) != before
        assert not complaints


def test_the_menu_zooms_into_the_accumulation(page):
    """Both panels show the last hundredth of the way, at its own scale."""
    with opened(page) as (tab, complaints):
        place = drawn(tab, "ball")
        place.locator(".updatemenu-header").click()
        place.locator(".updatemenu-dropdown-button").nth(2).click()
        layout = "document.querySelector('#plot-ball').layout"
        tab.wait_for_function(f"{layout}.xaxis.range[0] > 2.5")
        low, high = tab.evaluate(f"{layout}.xaxis.range")
        assert low == pytest.approx(2.558634 * 0.99, abs=1e-3)
        assert high < 2.57
        assert tab.evaluate(f"{layout}.xaxis2.range") == [low, high]
        assert max(tab.evaluate(f"{layout}.yaxis.range")) < 1e-3
        assert not complaints


def test_an_impact_answers_the_pointer(page):
    """Its number, its time and the speeds on its two sides."""
    with opened(page) as (tab, _):
        place = drawn(tab, "ball")
        dot = place.locator(".points path").first.bounding_box()
        tab.mouse.move(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2, steps=4)
        place.locator(".hovertext").first.wait_for()
        assert "jump 1 at t = 0.45152364098" in place.locator(".hovertext").first.text_content()


def test_the_page_fits_a_phone(page):
    """Nothing is wider than the window, figures included."""
    with opened(page, width=390, height=844) as (tab, complaints):
        for name in ("ball", "lines", "map"):
            assert drawn(tab, name).bounding_box()["width"] <= 390
        assert overflow(tab) <= 0
        assert not complaints


def test_print_shows_the_still_figures(page):
    """On paper there are the pictures, not the empty places of what moves."""
    with opened(page) as (tab, _):
        tab.emulate_media(media="print")
        assert tab.locator("figure img").first.is_visible()
        assert not tab.locator("#plot-ball").is_visible()
        assert len(tab.pdf()) > 20_000


def test_without_scripts_the_page_is_whole(page):
    """Text, numbers and pictures are in the file itself."""
    text = page.read_text()
    body = text.partition("<main>")[2]
    assert body.count('src="data:image/png;base64,') == 3
    assert sorted(p.name for p in (page.parent / "figures").iterdir()) == [
        "ball.png",
        "lines.png",
        "map.png",
    ]
    assert "<script src" not in body
    assert "A ball &lt;/script&gt; &amp; &lt;b&gt;" in body
