"""Pictures: what is drawn (``figure``, ``of_run``) apart from what draws it.

A :class:`~.figure.Figure` is curves and cells in panels, and nothing else. ``static`` draws it
with matplotlib, ``interactive`` with plotly; both show the same numbers in the same colours.
"""

from __future__ import annotations

from typing import Any


def is_page(path: Any) -> bool:
    """Whether a picture of this name is a page of HTML."""
    return str(path).lower().endswith(".html")
