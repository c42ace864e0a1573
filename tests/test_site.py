"""The documentation site: built strictly, whole by itself, every link followed."""

import fcntl
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import hybrid as hy

from .browser import opened, overflow

pytestmark = pytest.mark.pages

ROOT = Path(__file__).parent.parent

#: Pages elsewhere that ours may lead to.
OUTSIDE = ()

#: What is in the reference beside the public names.
MADE = (
    "Trajectory.__call__",
    "functions.Outcome",
    "orbits.exponents.Exponents",
    "orbits.periodic.PeriodicOrbit",
    "orbits.returns.ReturnMap.__call__",
    "result.settling.Settled",
    "solvers.base.Stepper.land",
    "trajectory.accumulation.Accumulation.verdict",
    "trajectory.arcs.Arc",
    "trajectory.trajectory.Jumps.gaps",
)


def build(folder, *options):
    """MkDocs, strictly, in a process of its own."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder, *options]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "NO_COLOR": "1"}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=quiet)


class Page(HTMLParser):
    """What a page loads, what it leads to, and what can be led to in it."""

    def __init__(self, path):
        super().__init__()
        self.loads, self.leads, self.ids = [], [], set()
        self.feed(path.read_text())

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        links = self.leads if tag == "a" else self.loads
        links += [given[name] for name in ("href", "src", "poster", "data") if given.get(name)]


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The one in the folder HYBRID_SITE, or one built once, by whichever worker asks first."""
    if built := os.environ.get("HYBRID_SITE"):
        return Path(built).resolve()
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with open(base / "site.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (base / "site.built").exists():
            done = build(base / "site")
            assert done.returncode == 0, done.stderr
            assert "WARNING" not in done.stderr
            (base / "site.built").touch()
    return base / "site"


@pytest.fixture(scope="session")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html")}


def test_every_page_is_there(site):
    """One for each Markdown file, and those made of files elsewhere."""
    pages = {f"{path.relative_to(site).with_suffix('')}" for path in site.rglob("*.html")}
    docs = ROOT / "docs"
    written = {f"{path.relative_to(docs).with_suffix('')}" for path in docs.rglob("*.md")}
    assert pages == written | {"index", "gallery", "contributing", "changelog", "404"}


def test_links_lead_to_what_is_there(site, pages):
    """A file of the site, and an id in it."""
    for path, page in pages.items():
        for link in page.loads + page.leads:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or path.name == "404.html":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.is_file(), f"{path.relative_to(site)}: {link}"
            anchor = unquote(parts.fragment)
            if anchor and target in pages and not anchor.startswith("__"):
                assert anchor in pages[target].ids, f"{path.relative_to(site)}: {link}"


def test_nothing_is_loaded_from_the_network(site, pages):
    """Neither by the pages nor by their styles; links that lead out are known."""
    away = re.compile(r"^(https?:)?//")
    for path, page in pages.items():
        assert not [link for link in page.loads if away.match(link)], path
        assert not [link for link in page.leads if away.match(link) and link not in OUTSIDE], path
    for path in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", path.read_text()), path


def test_every_public_name_is_in_the_reference(pages):
    """An entry for each name of ``hybrid.__all__``, and for what runs are made of."""
    ids = set().union(*(page.ids for page in pages.values()))
    assert {f"hybrid.{name}" for name in hy.__all__} <= ids
    assert {f"hybrid.{name}" for name in MADE} <= ids


def test_the_gallery_has_every_model(site, pages):
    """Its section, its picture."""
    (path,) = (path for path in pages if path.name == "gallery.html")
    names = {file.stem for file in ROOT.glob("models/[a-z]*.py")}
    assert names <= pages[path].ids
    for name in names:
        assert (site / "figures" / "gallery" / f"{name}.png").stat().st_size > 10_000


#: A page's search is loaded, so that leaving the page cuts nothing off.
LOADED = "!!document.querySelector('iframe')?.contentWindow.lunr"


@pytest.mark.parametrize("width", [1280, 390])
def test_pages_fit_and_nothing_fails(site, pages, width):
    """Opened as files, on a desk and on a phone: no sideways scrolling, pictures, no complaints."""
    with opened(site / "index.html", width) as (tab, complaints):
        for path in pages:
            if path.name == "404.html":  # for servers only: its links begin at their root
                continue
            tab.wait_for_function(LOADED)
            tab.goto(path.as_uri())
            assert overflow(tab) <= 0, path
            empty = "[...document.images].filter(i => !i.complete || !i.naturalWidth).length"
            assert tab.evaluate(empty) == 0, path
            assert complaints == [], path


def test_search_finds_without_a_server(site):
    """In pages opened as files, from any folder."""
    with opened(site / "notes" / "chatter.html") as (tab, complaints):
        tab.locator(".md-search__input").click()
        tab.keyboard.type("hysteresis")
        found = tab.locator(".md-search-result__link[href*='zeno.html']").first
        found.wait_for(state="attached")
        assert complaints == []


def test_a_name_that_is_not_there_fails_the_build(tmp_path):
    """Strictly: an entry of the reference, and a link, that lead nowhere."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "mkdocs.yml").write_text(
        f"site_name: x\nplugins: [mkdocstrings: {{handlers: {{python: {{paths: [{ROOT}]}}}}}}]\n"
    )
    for text, fault in [("::: hybrid.nothing\n", "hybrid.nothing"), ("[x](no.md)\n", "no.md")]:
        (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{text}")
        done = build(tmp_path / "out", "--config-file", tmp_path / "mkdocs.yml")
        assert done.returncode != 0
        assert fault in done.stderr
