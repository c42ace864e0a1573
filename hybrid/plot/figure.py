"""A figure as data: curves and cells in panels, panels in columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

LINE_COLOR, OTHER_COLOR, IMPACT_COLOR = "#1f5a96", "#d07c1a", "#c44e52"
LIMIT_COLOR, SURFACE_COLOR = "#2e8b57", "#8c8c8c"

#: Colours of a density, from few points to many.
DENSITY_COLORS = ("#c6d7ea", "#6f9bc8", "#1f5a96", "#0b1f3a")

#: Colours of the methods in a comparison, distinguishable by the colour-blind (Okabe and Ito,
#: 2008).
METHOD_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")


@attrs.frozen(kw_only=True)
class Style:
    """How a curve is drawn: a line of some width, dots of some size, or both."""

    color: str
    width: float = 0.0
    dash: bool = False
    dot: float = 0.0


#: Looks of curves, named after what they show.
STYLES = {
    "line": Style(color=LINE_COLOR, width=1.1),
    "rest": Style(color=LINE_COLOR, width=2.6),
    "other": Style(color=OTHER_COLOR, width=1.1),
    "other rest": Style(color=OTHER_COLOR, width=2.6),
    "dashed": Style(color=OTHER_COLOR, width=1.3, dash=True),
    "impact": Style(color=IMPACT_COLOR, dot=4.0),
    "fall": Style(color=IMPACT_COLOR, width=0.8, dash=True),
    "series": Style(color=IMPACT_COLOR, width=0.8, dot=4.0),
    "other series": Style(color=OTHER_COLOR, width=0.8, dot=4.0),
    "limit": Style(color=LIMIT_COLOR, width=1.2, dash=True),
    "mark": Style(color="#1c2733", dot=2.5),
    "mode": Style(color=LINE_COLOR, width=5.0),
    "held": Style(color=OTHER_COLOR, width=5.0),
    "point": Style(color=LIMIT_COLOR, dot=7.0),
    "surface": Style(color=SURFACE_COLOR, width=1.3),
    **{f"method {i}": Style(color=c, width=1.3, dot=6.0) for i, c in enumerate(METHOD_COLORS)},
    **{
        f"method {i} dashed": Style(color=c, width=1.3, dash=True, dot=6.0)
        for i, c in enumerate(METHOD_COLORS)
    },
    "proved": Style(color="#000000", width=1.8),
    **{f"method {i} dot": Style(color=c, dot=3.0) for i, c in enumerate(METHOD_COLORS)},
    **{f"method {i} bar": Style(color=c, width=0.9) for i, c in enumerate(METHOD_COLORS)},
}


def looks_of_method(number: int) -> tuple[str, str]:
    """The looks of a method's curve and of its bars; once the colours are used up, lines come
    dashed."""
    rounds, color = divmod(number, len(METHOD_COLORS))
    own = f"method {color}"
    return f"{own} dashed" if rounds % 2 else own, f"{own} bar"


def _floats(values: Any) -> np.ndarray:
    return np.asarray(values, dtype=float)


@attrs.frozen(kw_only=True, eq=False)
class Curve:
    """Points drawn as a line, dots or both; NaN interrupts the line.

    Attributes
    ----------
    x, y : array, shape (n,)
    name : str
        Name in the legend; empty if it has no entry. Curves of the same name share one.
    look : str
        A key of ``STYLES``.
    notes : sequence of str
        Hover texts, one per point; or empty.
    """

    x: np.ndarray = attrs.field(converter=_floats)
    y: np.ndarray = attrs.field(converter=_floats)
    name: str = ""
    look: str = attrs.field(default="line", validator=attrs.validators.in_(STYLES))
    notes: Sequence[str] = ()


@attrs.frozen(kw_only=True, eq=False)
class Cells:
    """A map: each cell of a grid belongs to one kind.

    Attributes
    ----------
    x, y : array
        Centres of the cells, shapes (n,) and (m,).
    kind : array of int, shape (m, n)
        Index into ``kinds``.
    kinds : sequence of (str, str)
        Name and colour of each kind.
    notes : array of str, shape (m, n), or None
        Hover texts of the cells.
    """

    x: np.ndarray
    y: np.ndarray
    kind: np.ndarray
    kinds: Sequence[tuple[str, str]]
    notes: np.ndarray | None = None


@attrs.frozen(kw_only=True, eq=False)
class Density:
    """How many points lie in each cell of a grid.

    Attributes
    ----------
    x, y : array
        Edges of the cells, shapes (n + 1,) and (m + 1,).
    count : array, shape (m, n)
    """

    x: np.ndarray
    y: np.ndarray
    count: np.ndarray


@attrs.frozen(kw_only=True, eq=False)
class Panel:
    """Axes with curves, over cells or a density if there are any.

    Attributes
    ----------
    x, y : str
        Axis labels; panels of a column with the same ``x`` zoom together.
    log : str
        Logarithmic axes: ``""``, ``"x"``, ``"y"`` or ``"xy"``.
    title : str
    reverse : bool
        Whether the horizontal axis runs from right to left.
    square : bool
        Whether both axes have the same scale.
    ticks : sequence of str
        Labels of 0, 1, 2 ... on the vertical axis; numbers if empty.
    share : float
        Height relative to other panels.
    """

    curves: Sequence[Curve] = ()
    cells: Cells | None = None
    density: Density | None = None
    x: str = "t"
    y: str = ""
    log: str = ""
    title: str = ""
    reverse: bool = False
    square: bool = False
    ticks: Sequence[str] = ()
    share: float = 1.0

    def span(self, low: float, high: float) -> tuple[float, float] | None:
        """Vertical bounds of the curves over a horizontal range, with a margin, or None."""
        parts = [c.y[(c.x >= low) & (c.x <= high)] for c in self.curves if c.look != "limit"]
        values = np.concatenate([np.empty(0), *parts])
        values = values[np.isfinite(values)]
        if not values.size:
            return None
        margin = 0.05 * (values.max() - values.min()) or 1e-12
        return float(values.min() - margin), float(values.max() + margin)


Columns = tuple[tuple[Panel, ...], ...]


@attrs.frozen(kw_only=True, eq=False)
class Slider:
    """How a figure changes with a value.

    Attributes
    ----------
    label : str
        The value's name.
    stops : sequence of (str, columns)
        The value as text, and the panels for it; all stops have the same axes.
    start : int
        The stop shown first, and in print.
    """

    label: str
    stops: Sequence[tuple[str, Columns]]
    start: int = 0


@attrs.frozen(kw_only=True, eq=False)
class Figure:
    """A figure: panels in columns, side by side.

    Attributes
    ----------
    name : str
        A short name, for files and links.
    title : str
    columns : tuple of tuples of Panel
        Columns from left to right, each from top to bottom; with a slider, those of its start.
    widths : sequence of float
        Relative widths of the columns; if empty, the first is the widest.
    zooms : sequence of (str, (low, high))
        Labels and ends of interesting ranges of the horizontal axis.
    slider : Slider or None
    """

    name: str = ""
    title: str = ""
    columns: Columns = ()
    widths: Sequence[float] = ()
    zooms: Sequence[tuple[str, tuple[float, float]]] = ()
    slider: Slider | None = None


def column(*panels: Panel) -> Columns:
    """Panels in one column, as the columns of a figure."""
    return (panels,)


def slid(slider: Slider, **rest: object) -> Figure:
    """A figure with a slider, at its start."""
    return Figure(columns=slider.stops[slider.start][1], slider=slider, **rest)  # type: ignore[arg-type]
