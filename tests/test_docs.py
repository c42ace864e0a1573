"""The code blocks of the README and of the documents run as they stand, in order."""

import re
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).parent.parent
PAGES = [
    "README.md",
    "docs/getting_started.md",
    "docs/choosing.md",
    "docs/zeno.md",
    "docs/sliding.md",
    "docs/certificates.md",
    "docs/delays.md",
    "docs/orbits.md",
    "docs/paper.md",
]


def blocks(page, language):
    text = (ROOT / page).read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES)
def test_code_blocks_run(page, capsys):
    """Each block sees the names of those before it."""
    scope = {"__name__": "page"}
    wide = jax.config.jax_enable_x64
    try:
        for block in blocks(page, "python"):
            exec(compile(block, page, "exec"), scope)
    finally:
        jax.config.update("jax_enable_x64", wide)
    if "run" in scope:
        assert scope["run"].status.name == "REACHED_END"


def test_the_readmes_result_is_what_is_printed(capsys):
    """The digits shown are the digits computed (the bound may differ by rounding)."""
    scope = {"__name__": "page"}
    exec(blocks("README.md", "python")[0], scope)
    printed, shown = capsys.readouterr().out, blocks("README.md", "text")[0]
    assert printed.split(" ± ")[0][:22] == shown.split(" ± ")[0][:22]
    assert printed.split("(certified)")[1].strip() == shown.split("(certified)")[1].strip()


def test_links_lead_somewhere():
    """Every relative link of every page."""
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")]:
        for link in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if "://" not in link:
                assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_readme_is_short():
    """Eighty lines and a little: a stranger reads it."""
    assert len((ROOT / "README.md").read_text().splitlines()) <= 82


def test_the_certificate_shown_is_what_is_printed(capsys):
    """Line by line; numbers are shown without their last digits, and those of -m's place."""
    scope = {"__name__": "page"}
    exec(blocks("docs/certificates.md", "python")[0], scope)
    printed = capsys.readouterr().out.strip().split("\n")
    shown = blocks("docs/certificates.md", "text")[0].strip().split("\n")
    assert len(printed) == len(shown)
    for line, expected in zip(printed, shown, strict=True):
        numbers = [re.findall(r"-?\d+\.?\d*", text) for text in (line, expected)]
        values, wanted = ([abs(float(n)) for n in found] for found in numbers)
        assert values == pytest.approx(wanted, rel=1e-6)
        assert re.sub(r"[-\d.]+", "", line) == re.sub(r"[-\d.]+", "", expected)
