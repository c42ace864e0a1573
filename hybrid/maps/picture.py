"""Pictures of maps: regions of a plane by a column, what is proved of them, points by density."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import HTML, PLOT, OptionError, need
from ..plot import is_page
from ..plot.figure import METHOD_COLORS, Cells, Curve, Figure, Panel, column

if TYPE_CHECKING:
    import xarray

    from ..automaton.shapes import Numbers

#: The colour of what is none of the kinds, and those of kinds beyond the colours of methods.
NONE_COLOR = "#d5d5d5"
MORE_COLORS = ("#8c564b", "#7f7f7f", "#bcbd22", "#393b79", "#ad494a")

#: Regions that colours tell apart.
MOST_KINDS = len(METHOD_COLORS) + len(MORE_COLORS)

#: What a panel of a plane is against others in height.
PLANE_SHARE = 2.0


def drawn(figure: Figure, path: Any, what: str) -> Any:
    """Draw a figure with matplotlib, or with plotly where the path ends in .html.

    Raises
    ------
    OptionError
        If what draws is missing.
    """
    if is_page(path):
        need(f"{what}.plot to .html", HTML)
        from ..plot.interactive import draw as draw_page

        return draw_page(figure, path)
    need(f"{what}.plot", PLOT)
    from ..plot.static import draw

    return draw(figure, path)


def axis(name: str, values: Any) -> str:
    """The name of an axis, with its unit."""
    unit, begins = values.attrs.get("units"), name.removesuffix("_start")
    name = name if begins == name else f"{begins} at the start"
    return f"{name} [{unit}]" if unit else name


def kinds_of(table: xarray.Dataset, by: str) -> dict[Any, str]:
    """The values of a column, and what each is called.

    Raises
    ------
    OptionError
        If there is no such column, of one value a lane, or it has too many values to tell apart.
    """
    columns = [str(n) for n in table if table[n].dims == table["status"].dims]
    if by not in columns:
        raise OptionError(f"by={by!r}: one value a lane is due: {', '.join(columns)}")
    found = np.unique(table[by].values).tolist()
    if len(found) > MOST_KINDS:
        raise OptionError(f"by={by!r}: {len(found)} values; {MOST_KINDS} can be told apart")
    return {value: _called(by, value) for value in found}


def _called(by: str, value: Any) -> str:
    if by == "verdict" and not value:
        return "no accumulation"
    return str(value) if isinstance(value, str) else f"{by} = {value}"


def region_figure(
    table: xarray.Dataset,
    by: str,
    axes: Sequence[str],
    known: Mapping[Any, str],
    title: str,
    proved: np.ndarray | None = None,
) -> Figure:
    """A plane, or a line, coloured by a column; ``known`` are its values and their names.

    ``proved`` is a mask over the table; its border is drawn.

    Raises
    ------
    OptionError
        If there are more axes than two.
    """
    if len(axes) > 2:
        raise OptionError(f"a picture has two axes, not {len(axes)}: {', '.join(axes)}")
    values = [np.asarray(table[name].values, dtype=float) for name in axes]
    kind = np.full(table[by].shape, -1)
    for number, value in enumerate(known):
        kind[table[by].values == value] = number
    colors = [NONE_COLOR if _is_none(v) else c for v, c in zip(known, _colors(), strict=False)]
    names = list(zip(known.values(), colors, strict=True))
    across = axis(axes[0], table[axes[0]])
    up = axis(axes[-1], table[axes[-1]])
    if table[by].dims == ("lane",):
        panel = Panel(curves=_dots(kind, values, names), x=across, y=up, share=PLANE_SHARE)
    elif len(axes) == 1:
        cells = Cells(x=values[0], y=np.arange(2.0), kind=np.stack([kind, kind]), kinds=names)
        panel = Panel(cells=cells, ticks=["", ""], x=across)
    else:
        curves = [] if proved is None else _borders(values, np.asarray(proved, dtype=bool))
        cells = Cells(x=values[0], y=values[1], kind=kind.T, kinds=names)
        panel = Panel(cells=cells, curves=curves, x=across, y=up, share=PLANE_SHARE)
    return Figure(name="region", title=title, columns=column(panel))


def _is_none(value: Any) -> bool:
    return value == "" or (isinstance(value, int) and value < 0)


def _colors() -> Iterator[str]:
    """Colours of kinds, over again when all are used."""
    while True:
        yield from (*METHOD_COLORS, *MORE_COLORS)


def _dots(kind: np.ndarray, values: Sequence[Numbers], names: Any) -> list[Curve]:
    """Lanes of a refined map, a dot each."""
    found = []
    for number, (name, _) in enumerate(names):
        here = kind == number
        look = f"method {number % len(METHOD_COLORS)} dot"
        found.append(Curve(x=values[0][here], y=values[1][here], name=name, look=look))
    return found


def _borders(values: Sequence[Numbers], inside: np.ndarray) -> list[Curve]:
    """The border of a mask, between cells; none where it has no points."""
    if not inside.any():
        return []
    x, y = map(_edges, values)
    rows: list[tuple[float, float]] = []
    padded = np.pad(inside, 1)
    for i, j in np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1]).tolist():
        rows += [(x[i], y[j]), (x[i], y[j + 1]), (np.nan, np.nan)]
    for i, j in np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1]).tolist():
        rows += [(x[i], y[j]), (x[i + 1], y[j]), (np.nan, np.nan)]
    border = np.array(rows).T
    return [Curve(x=border[0], y=border[1], look="proved", name="proved inside")]


def _edges(values: Numbers) -> np.ndarray:
    """Where cells about values begin and end."""
    if len(values) < 2:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = 0.5 * (values[1:] + values[:-1])
    first, last = 1.5 * values[0] - 0.5 * values[1], 1.5 * values[-1] - 0.5 * values[-2]
    return np.array([first, *middle, last])
