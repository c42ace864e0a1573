"""Plots: figures as data (``figure``, ``of_run``), separate from the drawing.

A :class:`~.figure.Figure` consists of curves and cells in panels. ``static`` draws it with
matplotlib, ``interactive`` with plotly, with the same numbers and colours.
"""

from __future__ import annotations

from typing import Any


def is_page(path: Any) -> bool:
    """Whether a file name is that of an HTML page."""
    return str(path).lower().endswith(".html")
