"""``hy.bifurcation``: a sweep of points on a section, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..errors import PLOT, OptionError, need
from ..plot.figure import Curve, Figure, Panel, column
from .grid import sweep

if TYPE_CHECKING:
    import xarray


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
        """Draw the points, a column for each value of the parameter.

        Parameters
        ----------
        state : str
            A state, or an output that was measured.
        path : str or path, optional
            Also write the figure there.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OptionError
            If there is no such column, or matplotlib is missing.
        """
        need("bifurcation.plot", PLOT)
        from ..plot.static import draw

        known = [str(name).removesuffix("_section") for name in self.table if _drawable(self, name)]
        if state not in known:
            raise OptionError(f"{state!r}: there are points of {', '.join(known)}")
        points = self.table[f"{state}_section"]
        x, y = np.broadcast_arrays(self.table[self.name].values[:, None], points.values)
        curve = Curve(x=x.ravel(), y=y.ravel(), look="mark")
        ours = _axis(self.name, self.table[self.name]), _axis(state, points)
        panel = Panel(curves=[curve], x=ours[0], y=ours[1])
        title = f"{self.table.attrs['model']}: {state} on the section"
        return draw(Figure(name="bifurcation", title=title, columns=column(panel)), path)


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
    **options: Any,
) -> Bifurcation:
    """Points of a model on a section, over a parameter, once transients have died away.

    Parameters
    ----------
    model, over, start, t, options
        As :func:`hybrid.sweep` takes them; ``over`` has one name.
    section, skip, keep, measure
        As :func:`hybrid.ensemble` takes them.

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
    table = sweep(model, over, start, t, **asked, **options)
    return Bifurcation(table, str(next(iter(table.dims))))


def _drawable(found: Bifurcation, name: Any) -> bool:
    """Whether a column is a number at each point."""
    is_point = str(name).endswith("_section") and name != "t_section"
    return is_point and found.table[name].dims == (found.name, "hit")


def _axis(name: str, values: Any) -> str:
    unit = values.attrs.get("units")
    return f"{name} [{unit}]" if unit else name


__all__ = ["Bifurcation", "bifurcation"]
