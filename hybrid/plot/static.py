"""Figures drawn with matplotlib."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

from ..automaton.reals import reals, short
from ..errors import OptionError
from . import require_writable
from .figure import DENSITY_COLORS, STYLES, Curve, Density, Figure, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawn

#: Inches: total width for one, two and more columns, height of a row, and height of everything
#: else. Number of rows above which rows are lower, and their height then.
COLUMN_WIDTHS, ROW_HEIGHT, MARGINS, MANY_ROWS, LOW_ROW = (8.0, 11.0, 14.0), 2.1, 0.8, 4, 1.45

#: Lines wider than this (in points) are bars, drawn without projecting ends.
BAR_WIDTH = 4.0

#: A logarithmic axis over less than this factor is widened by it, to both sides.
NARROW_LOG = 1.1

#: Inches of a column from which down letters are smaller, the least share of their size, and the
#: least inches of an entry in the legend.
USUAL_WIDTH, LEAST_SCALE, ENTRY_WIDTH = 3.5, 0.6, 1.5

#: Inches of an entry's mark and the room about it, and of a letter.
MARK_WIDTH, LETTER_WIDTH = 0.6, 0.075


def draw(figure: Figure, path: Any = None, size: tuple[float, float] | None = None) -> Drawn:
    """Draw a figure, of some inches, and write it to ``path`` if one is given."""
    require_writable(path)
    if size is not None:
        _require_size(size)
    import matplotlib as mpl
    from matplotlib.figure import Figure as Drawn

    size, count = size or _size(figure), len(figure.columns)
    scale = min(1.0, max(LEAST_SCALE, size[0] / (USUAL_WIDTH * count)))
    with mpl.rc_context({"font.size": 10.0 * scale}):
        drawn = Drawn(figsize=size, layout="constrained")
        widths = figure.widths or [1.7, *[1.0] * (count - 1)]
        parts = drawn.subfigures(1, count, width_ratios=widths, squeeze=False)[0]
        for part, panels in zip(parts, figure.columns, strict=True):
            _column(part, panels)
        handles = dict(_legend(drawn))
        if handles:
            labels, marks = list(handles), list(handles.values())
            widest = max(ENTRY_WIDTH, MARK_WIDTH + LETTER_WIDTH * max(map(len, labels)))
            fits = {
                "ncols": max(1, int(size[0] / (widest * scale))),
                "loc": "outside lower left",
            }
            drawn.legend(marks, labels, fontsize="small", frameon=False, **fits)
        drawn.suptitle(figure.title, fontsize="medium", wrap=True)
        if path is not None:
            drawn.savefig(path, dpi=150)
    return drawn


def _require_size(size: Any) -> None:
    """Refuse what is no width and height."""
    try:
        width, height = reals(size).tolist()
    except (TypeError, ValueError):
        width = height = 0.0
    if not (0 < width < inf and 0 < height < inf):
        raise OptionError(f"size={short(size)}: (width, height), in inches")


def draw_on(figure: Figure, axes: Any) -> Drawn:
    """Draw a figure's panels on existing axes, one each; returns the figure of the first axes.

    Raises
    ------
    OptionError
        If the numbers of axes and panels differ.
    """
    import numpy as np

    given = np.ravel(np.array(axes, dtype=object)).tolist()
    panels = [panel for column in figure.columns for panel in column]
    if len(given) != len(panels):
        names = ", ".join(panel.title or panel.y or "modes" for panel in panels)
        raise OptionError(f"ax: {len(given)} axes for {len(panels)} panels: {names}")
    for each, panel in zip(given, panels, strict=True):
        _panel(each, panel)
    return given[0].figure


def _size(figure: Figure) -> tuple[float, float]:
    """A readable size in inches."""
    rows = max(sum(panel.share for panel in column) for column in figure.columns)
    height = LOW_ROW if rows > MANY_ROWS else ROW_HEIGHT
    width = COLUMN_WIDTHS[min(len(figure.columns), len(COLUMN_WIDTHS)) - 1]
    return width, height * max(rows, 1.5) + MARGINS


def _column(part: Any, panels: tuple[Panel, ...]) -> None:
    """Draw panels in a column; neighbours with the same horizontal axis share it."""
    grid = part.add_gridspec(len(panels), 1, height_ratios=[panel.share for panel in panels])
    above: Axes | None = None
    for row, panel in enumerate(panels):
        follows = row > 0 and (panel.x, panel.log) == (panels[row - 1].x, panels[row - 1].log)
        axes = part.add_subplot(grid[row], sharex=above if follows else None)
        _panel(axes, panel)
        if follows and above is not None:
            above.tick_params(labelbottom=False)
            above.set_xlabel("")
        above = axes


def _panel(axes: Axes, panel: Panel) -> None:
    if panel.cells is not None:
        _cells(axes, panel.cells)
    if panel.density is not None:
        _density(axes, panel.density)
    for curve in panel.curves:
        _curve(axes, curve)
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log:
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        if high < NARROW_LOG * low:  # its ticks would all read the same
            axes.set_ylim(low / NARROW_LOG, high * NARROW_LOG)
    if panel.reverse:
        axes.invert_xaxis()
    if panel.square:
        axes.set_aspect("equal")
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    axes.set_title(panel.title, fontsize="small")
    if panel.ticks:
        axes.set_yticks(range(len(panel.ticks)), labels=panel.ticks, fontsize="x-small")
        axes.set_ylim(-0.6, len(panel.ticks) - 0.4)


def _curve(axes: Axes, curve: Curve) -> None:
    look = STYLES[curve.look]
    axes.plot(
        curve.x,
        curve.y,
        color=look.color,
        lw=look.width,
        ls=("--" if look.dash else "-") if look.width else "",
        marker="." if look.dot else "",
        ms=look.dot,
        solid_capstyle="butt" if look.width > BAR_WIDTH else "projecting",
        label=curve.name or "_",
        zorder=0 if curve.look == "surface" else 2,
    )


def _cells(axes: Axes, cells: Any) -> None:
    from matplotlib.colors import ListedColormap

    colors = ListedColormap([color for _, color in cells.kinds])
    axes.pcolormesh(
        cells.x, cells.y, cells.kind, cmap=colors, vmin=-0.5, vmax=len(cells.kinds) - 0.5
    )
    for name, color in cells.kinds:
        axes.plot([], [], "s", color=color, label=name)


def _density(axes: Axes, density: Density) -> None:
    """Cells with points, by the logarithm of how many."""
    from matplotlib.colors import LinearSegmentedColormap, LogNorm
    from numpy import ma

    colors = LinearSegmentedColormap.from_list("density", DENSITY_COLORS)
    count = ma.masked_equal(density.count, 0)
    norm = LogNorm(1, max(2, density.count.max(initial=0)))
    axes.pcolormesh(density.x, density.y, count, cmap=colors, norm=norm, rasterized=True)


def _legend(drawn: Drawn) -> Any:
    for axes in drawn.get_axes():
        handles, labels = axes.get_legend_handles_labels()
        yield from ((label, handle) for handle, label in zip(handles, labels, strict=True))
