"""The code blocks and commands of the README and of every page run as they stand, in order."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import jax
import pytest
import typer
from typer.testing import CliRunner

import hybrid as hy
from hybrid.cli import app

pytestmark = pytest.mark.pages

ROOT = Path(__file__).parent.parent
FILES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))]
PAGES = [str(path.relative_to(ROOT)) for path in FILES]

#: Commands that are only parsed: comparing compiles several solvers, as tests/test_compare.py does;
#: a report takes minutes, and paper/tests/test_whole.py makes one.
SLOW = ["hybrid compare coupled", "hybrid report"]

#: A block of Python, and the text that follows it with nothing between.
SHOWN = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)

NUMBER = r"-?\b\d+\.?\d*(?:e[-+]?\d+)?"


def blocks(page, *languages):
    text = (ROOT / page).read_text()
    return re.findall(rf"```(?:{'|'.join(languages)})\n(.*?)```", text, flags=re.DOTALL)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_code_blocks_run(page, capsys, tmp_path, monkeypatch):
    """Each block sees the names of those before it; what is shown right after it is printed."""
    monkeypatch.chdir(tmp_path)
    scope = {"__name__": "page"}
    wide = jax.config.jax_enable_x64
    try:
        for block, shown in SHOWN.findall((ROOT / page).read_text()):
            exec(compile(block, page, "exec"), scope)
            printed = capsys.readouterr().out
            if shown:
                agree(printed, shown)
    finally:
        jax.config.update("jax_enable_x64", wide)
    assert "run" not in scope or scope["run"].status.name == "REACHED_END"


@pytest.mark.parametrize("solver", ["scipy", "diffrax"])
def test_recipes_hold_with_each_solver(solver, capsys, monkeypatch):
    """What the cookbook prints is asked of the solvers that it does not name."""
    simulate, page = hy.simulate, (ROOT / "docs/cookbook.md").read_text()
    given = {"solver": solver, "rtol": 1e-10, "atol": 1e-12}
    monkeypatch.setattr(hy, "simulate", lambda *args, **own: simulate(*args, **given | own))
    scope = {"__name__": "page"}
    for block, shown in SHOWN.findall(page):
        exec(compile(block, "cookbook.md", "exec"), scope)
        if shown:
            agree(capsys.readouterr().out, shown)


def agree(printed, shown):
    """The same words, however the lines are broken; numbers but for sign, noise and last digits."""
    words, expected = (" ".join(re.sub(NUMBER, "#", text).split()) for text in (printed, shown))
    assert words == expected
    values, wanted = ([abs(float(n)) for n in re.findall(NUMBER, t)] for t in (printed, shown))
    assert values == pytest.approx(wanted, rel=1e-6, abs=1e-8)


def test_every_block_says_what_it_is():
    """Python that runs, commands, or text, or what another tool runs: nothing that looks like code
    of ours and is not run."""
    for page in PAGES:
        fences = re.findall(r"^```(.*)$", (ROOT / page).read_text(), re.M)
        others = {"matlab", "modelica", "julia"} if page == "docs/coming_from.md" else set()
        assert set(fences[::2]) <= {"python", "sh", "text", "toml"} | others, page
        assert set(fences[1::2]) <= {""}, page


def commands():
    """What the pages tell to type, without comments, line by line."""
    for page in PAGES:
        for block in blocks(page, "sh"):
            yield from (shlex.split(line, comments=True) for line in block.splitlines())


HYBRID = sorted({shlex.join(words) for words in commands() if words[:1] == ["hybrid"]})


@pytest.mark.parametrize("command", HYBRID)
def test_commands_run(command, tmp_path, monkeypatch):
    """Every ``hybrid`` command of the pages ends with the exit code of a success."""
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command)[1:]
    if command.startswith(tuple(SLOW)):
        typer.main.get_command(app).commands[words[0]].make_context(words[0], words[1:])
    else:
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output


def test_targets_of_make_exist():
    """``make NAME`` is a rule of the Makefile."""
    rules = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M)
    told = [words[1] for words in commands() if words[:1] == ["make"] and words[1:]]
    assert told
    assert set(told) <= set(rules)


def test_the_readmes_result_is_what_is_printed(capsys):
    """The digits shown are the digits computed (the bound may differ by rounding)."""
    scope = {"__name__": "page"}
    exec(blocks("README.md", "python")[0], scope)
    printed, shown = capsys.readouterr().out, blocks("README.md", "text")[0]
    bound = r"± \S+,"
    assert re.sub(bound, "", printed) == re.sub(bound, "", shown)


def test_links_lead_somewhere():
    """Every relative link of every page."""
    for path in FILES:
        prose = re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)#]+)\)", prose):
            if "://" not in link:
                assert (path.parent / link).exists(), f"{path.name}: {link}"


def test_pages_are_notebooks(tmp_path):
    """Their cells are the blocks of the page, which are run above; what is printed is left out."""
    subprocess.run([sys.executable, ROOT / "docs/notebooks.py", tmp_path], check=True)
    made = {path.stem: json.loads(path.read_text()) for path in tmp_path.glob("*.ipynb")}
    pages = {Path(p).stem: blocks(p, "python") for p in PAGES if re.fullmatch(r"docs/\w+\.md", p)}
    assert set(made) == {name for name, own in pages.items() if own}
    for name, book in made.items():
        cells = {kind: [] for kind in ("code", "markdown")}
        for cell in book["cells"]:
            cells[cell["cell_type"]].append("".join(cell["source"]))
        assert [cell + "\n" for cell in cells["code"]] == pages[name], name
        assert "```python" not in "".join(cells["markdown"]), name
        assert len({cell["id"] for cell in book["cells"]}) == len(book["cells"]), name
        prose = re.sub(r"```.*?```", "", "".join(cells["markdown"]), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)#]+)", prose):
            assert "://" in link or (tmp_path / link).exists(), f"{name}: {link}"


def test_a_notebook_shows_what_its_page_shows(tmp_path, capsys):
    """Cell after cell, as a kernel runs them."""
    subprocess.run([sys.executable, ROOT / "docs/notebooks.py", tmp_path], check=True)
    book, scope = json.loads((tmp_path / "discrete.ipynb").read_text()), {"__name__": "__main__"}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "discrete.ipynb", "exec"), scope)
    shown = [text for _, text in SHOWN.findall((ROOT / "docs/discrete.md").read_text())]
    agree(capsys.readouterr().out, "".join(shown))


def test_the_readme_is_short():
    """Eighty lines and a little: a stranger reads it."""
    assert len((ROOT / "README.md").read_text().splitlines()) <= 82


def test_the_pictures_can_be_drawn_again(tmp_path):
    """From the blocks of their page, by the script beside them; all are shown there."""
    script = ROOT / "docs" / "figures" / "zeno.py"
    subprocess.run([sys.executable, script, tmp_path], cwd=ROOT, check=True)
    drawn = sorted(path.name for path in tmp_path.iterdir())
    assert drawn == sorted(path.name for path in script.parent.glob("zeno_*.png"))
    shown = re.findall(r"\(figures/(.*?)\)", (ROOT / "docs" / "zeno.md").read_text())
    assert drawn == sorted(shown)
