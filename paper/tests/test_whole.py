"""The whole report, as the command writes it, in a browser."""

import math
import re

from typer.testing import CliRunner

import paper
from hybrid.cli import app
from paper.claims import Verdict
from tests.browser import opened, overflow


def digits(text):
    """Significant digits of a number, its error left out."""
    mantissa = text.partition(" ±")[0].partition("e")[0]
    return len(re.sub(r"\D", "", mantissa).lstrip("0"))


def test_the_whole_page(tmp_path, monkeypatch):
    """All sections: no claim without a verdict, a reason and its digits; every figure drawn,
    on a wide and a narrow screen, without a complaint; the slider over r changes the curve.
    """
    sections = []
    monkeypatch.setattr("hybrid.cli.commands._judged", lambda *told: sections.append(told[2]))
    done = CliRunner().invoke(app, ["report", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert tuple(section.name for section in sections) == paper.SECTIONS
    claims = [claim for section in sections for claim in section.claims]
    figures = [figure.name for claim in claims for figure in claim.figures]
    assert {claim.verdict for claim in claims} == set(Verdict)
    for claim in claims:
        assert claim.says
        assert claim.found
        assert claim.how
        assert "nan" not in f"{claim.found} {claim.how}".split()
    for number in [number for claim in claims for number in claim.numbers]:
        assert math.isfinite(number.error or 0.0), number
        if number.error and abs(number.ours) > 1e10 * number.error:
            assert digits(str(number)) >= 10, number
    assert len(figures) == len(set(figures))
    assert sorted(f"{name}.png" for name in figures) == sorted(
        path.name for path in (tmp_path / "figures").iterdir()
    )
    for width in (1280, 390):
        with opened(tmp_path / "index.html", width) as (page, complaints):
            assert page.locator("article").count() == len(claims)
            for name in figures:
                place = page.locator(f"#plot-{name}")
                place.scroll_into_view_if_needed()
                place.locator(".main-svg").first.wait_for()
                shown = place.locator(".scatterlayer .js-line, .points path, .hm image")
                assert shown.count() > 0, name
            assert overflow(page) <= 0
            assert not complaints
            slides(page)


def slides(page):
    """The slider over r, moved to its end, shows other curves."""
    place = page.locator("#plot-transient")
    place.scroll_into_view_if_needed()
    line = place.locator(".scatterlayer .js-line").first
    before = line.get_attribute("d")
    rail = place.locator(".slider-rail-touch-rect").bounding_box()
    page.mouse.click(rail["x"] + rail["width"] - 2, rail["y"] + rail["height"] / 2)
    slider = "document.querySelector('#plot-transient').layout.sliders[0]"
    page.wait_for_function(f"{slider}.active == {slider}.steps.length - 1")
    assert place.locator(".slider-label").first.text_content() == "r = 0.02"
    assert line.get_attribute("d") != before
