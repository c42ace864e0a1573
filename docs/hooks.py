"""What the site has beyond the pages of this folder.

Some of its pages are files that lie elsewhere in the repository; links to and from them lead to the
pages. The gallery has a section for each model, with what ``hybrid run NAME --oracle`` draws and
prints.
"""

import ast
import os
import re
from hashlib import sha256
from pathlib import Path

from mkdocs.structure.files import File
from typer.testing import CliRunner

from hybrid import gallery
from hybrid.cli import app

ROOT = Path(__file__).parent.parent

#: Files outside docs/ that are pages.
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "models/README.md": "gallery.md",
}

LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")

#: A model's name in the table of the gallery.
ROW = r"(?<=\n)\| `(\w+)` \|"

#: Runs of the gallery are kept here until the package or the models change.
KEPT = ROOT / "out" / "gallery"


def on_files(files, config):
    """Add the pages, and the pictures of the gallery."""
    for path, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / path).read_text()))
    sources = [*ROOT.glob("hybrid/**/*.py"), *ROOT.glob("models/*.py")]
    digest = sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()[:16]
    table = (ROOT / "models/README.md").read_text()
    sections = [re.sub(ROW, r"| [`\1`](#\1) |", table)]
    for name in re.findall(ROW, table):
        picture, printed = flown(name, digest)
        uri = f"figures/gallery/{name}.png"
        files.append(File.generated(config, uri, abs_src_path=str(picture)))
        sections.append(section(name, uri, printed.read_text()))
    files.get_file_from_path("gallery.md").content_string = "\n".join(sections)
    return files


def flown(name, digest):
    """A model's picture, and what its run prints: those kept, or new ones."""
    picture, printed = (KEPT / f"{name}-{digest}{ending}" for ending in (".png", ".txt"))
    if not printed.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        for old in KEPT.glob(f"{name}-*"):
            old.unlink(missing_ok=True)
        draft = KEPT / f"{os.getpid()}.png"
        done = CliRunner().invoke(app, ["run", name, "--oracle", "--plot", str(draft)])
        if done.exit_code:
            raise RuntimeError(f"hybrid run {name}: {done.output}")
        draft.replace(picture)
        draft.write_text(done.output.partition("picture: ")[0])
        draft.replace(printed)
    return picture, printed


def section(name, picture, printed):
    """One model: what it is, its run, its file."""
    source = (gallery.folder() / f"{name}.py").read_text()
    indented = "".join(f"    {line}".rstrip() + "\n" for line in source.splitlines())
    return (
        f"## {name}\n\n{ast.get_docstring(ast.parse(source))}\n\n![{name}]({picture})\n\n"
        f"```sh\nhybrid run {name} --oracle\n```\n\n```text\n{printed}```\n\n"
        f'??? note "models/{name}.py"\n\n    ```python\n{indented}    ```\n'
    )


def on_page_markdown(markdown, page, config, files):
    """Links between files of the repository, as links between pages."""
    here = page.file.src_uri
    source = next((path for path, uri in PAGES.items() if uri == here), f"docs/{here}")

    def to_page(link):
        path = os.path.normpath(os.path.join(os.path.dirname(source), link[1]))
        if not (ROOT / path).is_file():
            return link[0]
        anchor = link[2] or ""
        if path.startswith("docs/"):
            uri = path.removeprefix("docs/")
        elif path.startswith("models/") and path.endswith(".py"):
            uri, anchor = PAGES["models/README.md"], f"#{Path(path).stem}"
        else:
            uri = PAGES.get(path, link[1])
        return f"]({os.path.relpath(uri, os.path.dirname(here) or '.')}{anchor})"

    return LINK.sub(to_page, markdown)
