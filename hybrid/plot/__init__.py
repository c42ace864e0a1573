"""Plots: figures as data (``figure``, ``of_run``), separate from the drawing.

A :class:`~.figure.Figure` consists of curves and cells in panels. ``static`` draws it with
matplotlib, ``interactive`` with plotly, with the same numbers and colours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import OptionError


def is_page(path: Any) -> bool:
    """Whether a file name is that of an HTML page."""
    return str(path).lower().endswith(".html")


def require_writable(path: Any, what: str = "") -> None:
    """Refuse the name of a picture that could not be written; None is none.

    Raises
    ------
    OptionError
        If its end names no format, or there is no such folder.
    """
    if path is None:
        return
    if not isinstance(path, str | Path):
        raise OptionError(f"{what}{path!r}: the name of a picture: run.png")
    if not _drawable(str(path)):
        raise OptionError(f"{what}{path}: end the name in .png, .pdf, .svg or .html")
    if not Path(path).resolve().parent.is_dir():
        raise OptionError(f"{what}{path}: no such folder")


def _drawable(path: str) -> bool:
    """Whether the end of a picture's name says in which format it is drawn."""
    if is_page(path):
        return True
    from matplotlib.backend_bases import FigureCanvasBase

    return Path(path).suffix.lower()[1:] in FigureCanvasBase.get_supported_filetypes()
