"""The pages of this folder as notebooks: ``python docs/notebooks.py`` writes them to out/notebooks.

A block of Python is a cell; what a page shows as its output is left out, and comes when the cell
is run. Links between pages lead to their notebooks.
"""

import json
import os
import re
import sys
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "out" / "notebooks"

#: A block of Python, and the text after it that it prints.
CODE = re.compile(r"```python\n(.*?)```\n(?:\n```text\n.*?```\n)?", re.DOTALL)

LINK = re.compile(r"\]\(([^)#\s:]+)(#[^)\s]*)?\)")


def pages():
    """The pages with Python in them."""
    return [page for page in sorted((ROOT / "docs").glob("*.md")) if CODE.search(page.read_text())]


def notebook(page, folder=FOLDER):
    """A page as a notebook of format 4.5, to lie in a folder."""
    cells, parts = [], CODE.split(page.read_text())
    for place, part in enumerate(parts):
        if not part.strip():
            continue
        source = part.strip("\n")
        cell = {
            "cell_type": "code" if place % 2 else "markdown",
            "id": sha256(f"{place} {part}".encode()).hexdigest()[:8],
            "metadata": {},
            "source": (source if place % 2 else linked(source, folder)).splitlines(keepends=True),
        }
        cells.append({**cell, "execution_count": None, "outputs": []} if place % 2 else cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def linked(text, folder):
    """Links to pages that are notebooks, as links to these; others as links to the files."""
    names = {page.name for page in pages()}

    def there(link):
        name, anchor = link[1], link[2] or ""
        if name in names:
            return f"]({name.removesuffix('.md')}.ipynb{anchor})"
        return f"]({os.path.relpath(ROOT / 'docs' / name, folder)}{anchor})"

    return LINK.sub(there, text)


def write(folder=FOLDER):
    """Write all notebooks to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in pages():
        text = json.dumps(notebook(page, folder), indent=1, ensure_ascii=False)
        (folder / f"{page.stem}.ipynb").write_text(text + "\n")


if __name__ == "__main__":
    write(*map(Path, sys.argv[1:2]))
