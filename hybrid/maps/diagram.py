"""``hy.bifurcation``: a sweep of points on a section, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..errors import OptionError
from ..plot.figure import Curve, Density, Figure, Panel, column
from .grid import sweep
from .picture import axis, drawn

if TYPE_CHECKING:
    import xarray

#: More points than these are drawn as how many there are in a cell; and cells along each axis, at
#: most: about as many as a picture has dots.
MOST_DOTS, CELLS = 20_000, (1000, 400)


@attrs.frozen(eq=False)
class Bifurcation:
    """Points on a section over a parameter.

    Attributes
    ----------
    table : xarray.Dataset
        What :func:`hybrid.sweep` gives: ``x_section`` over the parameter and ``hit``, and with
        them ``period``, how each lane ended, and what else was asked for.
    name : str
        The parameter.
    """

    table: xarray.Dataset
    name: str

    def plot(self, state: str, path: Any = None) -> Any:
        """Draw the points, a column for each value of the parameter; many as their density.

        Parameters
        ----------
        state : str
            A state, or an output that was measured.
        path : str or path, optional
            Also write the figure there; a page if it ends in .html.

        Returns
        -------
        The figure of matplotlib, or of plotly.

        Raises
        ------
        OptionError
            If there is no such column, or what draws is missing.
        """
        known = [str(name).removesuffix("_section") for name in self.table if _drawable(self, name)]
        if state not in known:
            raise OptionError(
                f"{self.table.attrs['model']}: {state!r}: there are points of {', '.join(known)}"
            )
        points = self.table[f"{state}_section"]
        values = np.broadcast_to(self.table[self.name].values[:, None], points.shape)
        known_points = np.isfinite(points.values)
        shown = _shown(values[known_points], points.values[known_points])
        across, up = axis(self.name, self.table[self.name]), axis(state, points)
        panel = attrs.evolve(shown, x=across, y=up)
        title = f"{self.table.attrs['model']}: {state} on the section"
        figure = Figure(name="bifurcation", title=title, columns=column(panel))
        return drawn(figure, path, "bifurcation")


def _shown(x: np.ndarray, y: np.ndarray) -> Panel:
    """Points as dots, or as their density."""
    if x.size <= MOST_DOTS:
        return Panel(curves=[Curve(x=x, y=y, look="mark")], share=2.0)
    each = min(CELLS[0], np.unique(x).size), CELLS[1]
    count, across, up = np.histogram2d(x, y, bins=each)
    return Panel(density=Density(x=across, y=up, count=count.T), share=2.0)


def bifurcation(
    model: Any,
    over: Mapping[str, Any],
    start: Any = None,
    t: Any = None,
    *,
    section: Any,
    skip: int = 100,
    keep: int = 50,
    measure: Any = ("period",),
    follow: bool = False,
    **options: Any,
) -> Bifurcation:
    """Points of a model on a section, over a parameter, once transients have died away.

    Parameters
    ----------
    model, over, start, t, options
        As :func:`hybrid.sweep` takes them; ``over`` has one name.
    section, skip, keep, measure
        As :func:`hybrid.ensemble` takes them.
    follow : bool
        Whether each value begins where the one before has ended, so that an attractor is followed
        as long as there is one; values that fall follow it down. Else each begins at ``start``.

    Returns
    -------
    Bifurcation
        ``.table``, and ``.plot("x", path)``.

    Raises
    ------
    OptionError
        As :func:`hybrid.sweep`, or if there are other names than one.

    Examples
    --------
    >>> hy.bifurcation(Table(), {"G": G}, START, (0.0, 900.0), section="impact").plot("v")
    """
    if not isinstance(over, Mapping) or len(over) != 1:
        raise OptionError(f"{model.spec.model}: over={over!r}: one parameter; hy.sweep takes more")
    asked = {"section": section, "skip": skip, "keep": keep, "measure": measure}
    table = sweep(model, over, start, t, follow=follow, **asked, **options)
    return Bifurcation(table, str(next(iter(table.dims))))


def _drawable(found: Bifurcation, name: Any) -> bool:
    """Whether a column is a number at each point."""
    is_point = str(name).endswith("_section") and name != "t_section"
    return is_point and found.table[name].dims == (found.name, "hit")
