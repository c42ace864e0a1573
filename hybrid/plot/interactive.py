"""Figures drawn with plotly: zoomable, with hover texts and sliders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from . import require_writable
from .figure import DENSITY_COLORS, STYLES, Cells, Columns, Curve, Density, Figure, Panel

#: Heights in pixels: a panel, the space between two, and the margins above and below all (for an
#: axis label, and a legend of three lines on a phone).
PANEL, BETWEEN, TOP_MARGIN, BOTTOM_MARGIN = 230, 72, 34, 110

#: Height in pixels of a slider below, and of a menu above.
SLIDER, MENU = 84, 40

#: Plotly options shared by all pages.
CONFIG = {
    "responsive": True,
    "displaylogo": False,
    "modeBarButtonsToRemove": ["select2d", "lasso2d"],
}

#: A figure's page; without the viewport tag a phone would show it at desktop width.
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
</head>
<body style="font-family: sans-serif">
<h1 style="font-size: 1.1rem; margin: 0.5rem 1rem">{title}</h1>
{body}
</body>
</html>
"""


def draw(figure: Figure, path: Any = None) -> go.Figure:
    """An interactive figure; all panels are stacked in one column to fit a phone.

    Parameters
    ----------
    figure : Figure
    path : str or path, optional
        Also write it to this file, as an HTML page that needs no network.
    """
    require_writable(path)
    panels = _stacked(figure.columns)
    height = int(sum(panel.share for panel in panels) * PANEL)
    drawn = make_subplots(
        rows=len(panels),
        cols=1,
        row_heights=[panel.share for panel in panels],
        vertical_spacing=BETWEEN / (height + (len(panels) - 1) * BETWEEN) if panels[1:] else 0.0,
        subplot_titles=[panel.title for panel in panels],
    )
    stops = figure.slider.stops if figure.slider else [("", figure.columns)]
    counts = []
    for _, columns in stops:
        before = len(drawn.data)
        _add(drawn, _stacked(columns))
        counts.append(len(drawn.data) - before)
    for row, panel in enumerate(panels, start=1):
        _axes(drawn, row, panel, panels)
    below, above = BOTTOM_MARGIN, TOP_MARGIN
    if figure.slider is not None:
        below += SLIDER
        _slide(drawn, figure, counts)
    if len(figure.zooms) > 1:
        above += MENU
        drawn.update_layout(updatemenus=[_buttons(figure, panels)])
    drawn.update_layout(
        template="plotly_white",
        height=height + (len(panels) - 1) * BETWEEN + above + below,
        margin={"l": 64, "r": 16, "t": above, "b": below},
        legend={"orientation": "h", "yref": "container", "y": 0.0, "yanchor": "bottom"},
        font={"size": 13},
        hovermode="closest",
    )
    if path is not None:
        body = drawn.to_html(include_plotlyjs=True, config=CONFIG, full_html=False)
        page = PAGE.format(title=escape(figure.title), body=body)
        Path(path).write_text(page, encoding="utf-8")
    return drawn


def _stacked(columns: Columns) -> list[Panel]:
    return [panel for column in columns for panel in column]


def _add(drawn: go.Figure, panels: Sequence[Panel]) -> None:
    """Add the traces of panels; curves of the same name share a legend entry."""
    named: set[str] = set()
    for row, panel in enumerate(panels, start=1):
        traces = [
            *_cells(panel.cells),
            *_density(panel.density),
            *(_curve(curve) for curve in panel.curves),
        ]
        for trace in traces:
            trace.showlegend = bool(trace.name) and trace.name not in named
            trace.legendgroup = trace.name
            named.add(trace.name)
            drawn.add_trace(trace, row=row, col=1)


def _curve(curve: Curve) -> go.Scatter:
    look = STYLES[curve.look]
    mode = "+".join(["lines"] * bool(look.width) + ["markers"] * bool(look.dot))
    return go.Scatter(
        x=curve.x,
        y=curve.y,
        name=curve.name,
        mode=mode,
        line={
            "color": look.color,
            "width": 1.2 * look.width,
            "dash": "dash" if look.dash else None,
        },
        marker={"color": look.color, "size": 1.3 * look.dot},
        text=list(curve.notes) or None,
        hovertemplate="%{text}<extra></extra>"
        if curve.notes
        else "%{x:.12g}, %{y:.12g}<extra></extra>",
    )


def _cells(cells: Cells | None) -> Iterator[go.Heatmap | go.Scatter]:
    """A heat map, and a legend entry for each kind of cell."""
    if cells is None:
        return
    count = len(cells.kinds)
    edges = np.repeat(np.arange(count + 1) / count, 2)[1:-1]
    colors = [color for _, color in cells.kinds for _ in range(2)]
    yield go.Heatmap(
        x=cells.x,
        y=cells.y,
        z=cells.kind,
        zmin=-0.5,
        zmax=count - 0.5,
        colorscale=list(zip(edges.tolist(), colors, strict=True)),
        showscale=False,
        text=cells.notes,
        hovertemplate="%{text}<extra></extra>" if cells.notes is not None else None,
    )
    for name, color in cells.kinds:
        marker = {"color": color, "symbol": "square", "size": 11}
        yield go.Scatter(x=[None], y=[None], name=name, mode="markers", marker=marker)


def _density(density: Density | None) -> Iterator[go.Heatmap]:
    """Cells with points, by the logarithm of how many."""
    if density is None:
        return
    shares = np.linspace(0.0, 1.0, len(DENSITY_COLORS)).tolist()
    yield go.Heatmap(
        x=density.x,
        y=density.y,
        z=np.log10(np.where(density.count > 0, density.count, np.nan)),
        colorscale=list(zip(shares, DENSITY_COLORS, strict=True)),
        showscale=False,
        text=density.count,
        hovertemplate="%{text} points<extra></extra>",
    )


def _axes(drawn: go.Figure, row: int, panel: Panel, panels: Sequence[Panel]) -> None:
    """Set labels and scales, and link matching horizontal axes."""
    first = next(i for i, other in enumerate(panels, start=1) if _moves_with(other, panel))
    drawn.update_xaxes(
        title_text=panel.x,
        type="log" if "x" in panel.log else "linear",
        autorange="reversed" if panel.reverse else None,
        matches=f"x{first if first > 1 else ''}" if first < row else None,
        exponentformat="power",
        title_standoff=4,
        constrain="domain" if panel.square else None,
        row=row,
        col=1,
    )
    drawn.update_yaxes(
        title_text=panel.y,
        type="log" if "y" in panel.log else "linear",
        exponentformat="power",
        scaleanchor=f"x{row if row > 1 else ''}" if panel.square else None,
        constrain="domain" if panel.square else None,
        tickvals=list(range(len(panel.ticks))) or None,
        ticktext=list(panel.ticks) or None,
        row=row,
        col=1,
    )


def _moves_with(one: Panel, other: Panel) -> bool:
    return one.x == other.x and ("x" in one.log) == ("x" in other.log)


def _slide(drawn: go.Figure, figure: Figure, counts: Sequence[int]) -> None:
    """Add a slider that shows the traces of one stop at a time."""
    slider = figure.slider
    assert slider is not None
    owner = np.repeat(np.arange(len(counts)), counts)
    for place, trace in zip(owner.tolist(), drawn.data, strict=True):
        trace.visible = place == slider.start
    steps = [
        {"label": label, "method": "restyle", "args": [{"visible": (owner == place).tolist()}]}
        for place, (label, _) in enumerate(slider.stops)
    ]
    current = {"prefix": f"{slider.label} = "}
    drawn.update_layout(
        sliders=[
            {
                "active": slider.start,
                "currentvalue": current,
                "steps": steps,
                "pad": {"t": 50},
                "x": 0.0,
                "len": 1.0,
            }
        ]
    )


def _buttons(figure: Figure, panels: Sequence[Panel]) -> dict[str, Any]:
    """Buttons that zoom to a range of the first horizontal axis, and fit the vertical ones."""
    buttons = []
    for label, (low, high) in figure.zooms:
        ranges: dict[str, Any] = {"xaxis.range": [low, high]}
        for place, panel in enumerate(panels):
            moves = _moves_with(panel, panels[0]) and not panel.ticks
            span = panel.span(low, high) if moves else None
            if span is not None and "y" not in panel.log:
                ranges[f"yaxis{place + 1 if place else ''}.range"] = list(span)
        buttons.append({"label": label, "method": "relayout", "args": [ranges]})
    return {
        "buttons": buttons,
        "type": "dropdown",
        "direction": "down",
        "x": 0.0,
        "xanchor": "left",
        "y": 1.0,
        "yanchor": "bottom",
        "pad": {"b": 12},
    }
