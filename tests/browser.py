"""The system's Chromium, driven by Playwright; where it is missing its tests are skipped."""

import os
import shutil
from contextlib import contextmanager

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: No sandbox (containers), no talk with servers of its own.
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync"]

#: What a request fails by whose page is left before it is answered; a file that is not there fails
#: by another name.
CUT_OFF = "net::ERR_ABORTED"


@contextmanager
def opened(path, width=1280, height=900):
    """A local page in a browser without a network, and what it complained of."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None and os.environ.get("HYBRID_BROWSER") != "required":
        pytest.skip(f"no browser: {', '.join(NAMES)}")
    from playwright.sync_api import sync_playwright

    complaints = []
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=FLAGS)
        context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
        page = context.new_page()
        page.on("console", lambda m: m.type in ("error", "warning") and complaints.append(m.text))
        page.on("pageerror", lambda fault: complaints.append(str(fault)))
        page.on("requestfailed", lambda r: r.failure != CUT_OFF and complaints.append(r.url[:200]))
        page.goto(path.as_uri())
        yield page, complaints
        browser.close()


def overflow(page):
    """Pixels by which the page is wider than its window."""
    return page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
