"""Figures drawn with matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .figure import STYLES, Curve, Figure, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawn

#: Inches: width of one column and of several, height of a row.
COLUMN_WIDTH, COLUMNS_WIDTH, ROW_HEIGHT = 8.0, 11.0, 2.1


def draw(figure: Figure, path: Any = None) -> Drawn:
    """Draw a figure, and write it to ``path`` if one is given."""
    from matplotlib.figure import Figure as Drawn

    rows = max(len(column) for column in figure.columns)
    size = (
        COLUMNS_WIDTH if len(figure.columns) > 1 else COLUMN_WIDTH,
        ROW_HEIGHT * max(rows, 1.5) + 0.8,
    )
    drawn = Drawn(figsize=size, layout="constrained")
    widths = [1.7, *[1.0] * (len(figure.columns) - 1)]
    parts = drawn.subfigures(1, len(figure.columns), width_ratios=widths, squeeze=False)[0]
    for part, panels in zip(parts, figure.columns, strict=True):
        _column(part, panels)
    handles = dict(_legend(drawn))
    if handles:
        labels, marks = list(handles), list(handles.values())
        drawn.legend(marks, labels, loc="outside lower left", ncols=4, fontsize=8, frameon=False)
    drawn.suptitle(figure.title, fontsize=10)
    if path is not None:
        drawn.savefig(path, dpi=150)
    return drawn


def _column(part: Any, panels: tuple[Panel, ...]) -> None:
    """Panels below each other; those with the same first axis share it."""
    above: Axes | None = None
    for row, panel in enumerate(panels):
        follows = row > 0 and (panel.x, panel.log) == (panels[row - 1].x, panels[row - 1].log)
        axes = part.add_subplot(len(panels), 1, row + 1, sharex=above if follows else None)
        _panel(axes, panel)
        if follows and above is not None:
            above.tick_params(labelbottom=False)
            above.set_xlabel("")
        above = axes


def _panel(axes: Axes, panel: Panel) -> None:
    if panel.cells is not None:
        _cells(axes, panel.cells)
    for curve in panel.curves:
        _curve(axes, curve)
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log:
        axes.set_yscale("log")
    if panel.reverse:
        axes.invert_xaxis()
    if panel.square:
        axes.set_aspect("equal")
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    axes.set_title(panel.title, fontsize=9)


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


def _legend(drawn: Drawn) -> Any:
    for axes in drawn.get_axes():
        handles, labels = axes.get_legend_handles_labels()
        yield from ((label, handle) for handle, label in zip(handles, labels, strict=True))
