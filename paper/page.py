"""The page: one file of HTML with everything in it, and the pictures beside it."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from plotly.offline import get_plotlyjs

from hybrid.plot import interactive, static
from hybrid.plot.figure import Figure

from .claims import Claim, Section, Verdict

#: Classes by which the page colours verdicts.
BADGES = {
    Verdict.REPRODUCED: "good",
    Verdict.CORRECTED: "mended",
    Verdict.NOT_REPRODUCED: "bad",
}


def write(sections: Sequence[Section], folder: Path, made: str) -> Path:
    """Write ``index.html`` and ``figures/*.png`` into a folder.

    Parameters
    ----------
    sections : sequence of Section
    folder : Path
        Made if it is missing.
    made : str
        A line on how the page was made: versions, seconds.

    Returns
    -------
    Path
        The page.
    """
    pictures = folder / "figures"
    pictures.mkdir(parents=True, exist_ok=True)
    template = Template(_asset("page.html"))
    page = template.substitute(
        style=_asset("page.css"),
        script=_asset("page.js"),
        plotly=get_plotlyjs(),
        contents=_contents(sections),
        sections="\n".join(_section(section, pictures) for section in sections),
        made=escape(made),
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path


def _asset(name: str) -> str:
    return files(__package__).joinpath("assets", name).read_text(encoding="utf-8")


def anchor(claim: Claim) -> str:
    """The place of a claim on the page."""
    return re.sub(r"[^a-z0-9]+", "-", f"{claim.place} {claim.says[:40]}".lower()).strip("-")


def _contents(sections: Sequence[Section]) -> str:
    """The table of all claims: where, what, verdict."""
    rows = [
        f'<tr><td>{escape(claim.place)}</td><td><a href="#{anchor(claim)}">{_text(claim.says)}'
        f"</a></td><td>{_badge(claim)}</td><td>{_text(claim.found)}</td></tr>"
        for section in sections
        for claim in section.claims
    ]
    return _table(("place", "the paper says", "verdict", "we find"), rows, "contents")


def _section(section: Section, pictures: Path) -> str:
    claims = "\n".join(_claim(claim, pictures) for claim in section.claims)
    return (
        f'<section id="{section.name}"><h2>{escape(section.title)}</h2>'
        f"<p>{_text(section.about)}</p>\n{claims}</section>"
    )


def _claim(claim: Claim, pictures: Path) -> str:
    numbers = _numbers(claim) if claim.numbers else ""
    figures = "\n".join(_figure(figure, pictures) for figure in claim.figures)
    return (
        f'<article id="{anchor(claim)}"><header><h3>{escape(claim.place)}</h3>{_badge(claim)}'
        f"</header>\n<blockquote>{_text(claim.says)}</blockquote>\n"
        f"<p>{_text(claim.found)}</p>\n"
        f'<p class="how"><b>How decided.</b> {_text(claim.how)}</p>\n{numbers}\n{figures}</article>'
    )


def _numbers(claim: Claim) -> str:
    """Our numbers, and the paper's where it prints any."""
    head = ["", "ours"] + ["the paper's"] * any(number.paper for number in claim.numbers)
    rows = []
    for number in claim.numbers:
        cells = [_text(number.what), escape(str(number)), escape(number.paper)][: len(head)]
        rows.append(f"<tr><td>{cells[0]}</td>{_cells(cells[1:])}</tr>")
    return _table(head, rows, "numbers")


def _cells(texts: Iterable[str]) -> str:
    return "".join(f'<td class="number">{text}</td>' for text in texts)


def _table(head: Iterable[str], rows: Sequence[str], name: str) -> str:
    cells = "".join(f"<th>{escape(text)}</th>" for text in head)
    body = "\n".join(rows)
    return (
        f'<div class="wide"><table class="{name}"><thead><tr>{cells}</tr></thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def _figure(figure: Figure, pictures: Path) -> str:
    """The figure that moves; the still one is for print, and where scripts are off."""
    path = pictures / f"{figure.name}.png"
    static.draw(figure, path)
    still = base64.b64encode(path.read_bytes()).decode()
    drawn = interactive.draw(figure)
    data = f'{{"figure": {drawn.to_json()}, "config": {json.dumps(interactive.CONFIG)}}}'
    title = escape(figure.title)
    return (
        f'<figure><div class="plot" id="plot-{figure.name}" '
        f'style="min-height:{drawn.layout.height}px"></div>\n'
        f'<script type="application/json">{data.replace("</", "<" + chr(92) + "/")}</script>\n'
        f'<img alt="{title}" src="data:image/png;base64,{still}">\n'
        f"<figcaption>{title}</figcaption></figure>"
    )


def _badge(claim: Claim) -> str:
    return f'<span class="badge {BADGES[claim.verdict]}">{claim.verdict.value}</span>'


def _text(text: str) -> str:
    """Plain text; what stands between backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))
