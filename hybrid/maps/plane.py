"""``hy.region``: a plane by what its lanes come to, and what is proved of them before they fly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.trace import instance
from ..certificates import certify
from ..errors import OptionError
from .grid import sweep
from .picture import drawn, kinds_of, region_figure

if TYPE_CHECKING:
    import xarray

Box = Mapping[str, tuple[float, float]]


@attrs.frozen(eq=False)
class Region:
    """A plane of lanes, by a column.

    Attributes
    ----------
    table : xarray.Dataset
        What :func:`hybrid.sweep` gives, and where a box was given ``certified``: of which lanes
        :func:`hybrid.certify` proves that their impacts accumulate.
    by : str
        The column.
    names : tuple of str
        The dimensions; with ``refine`` the coordinates.
    """

    table: xarray.Dataset
    by: str
    names: tuple[str, ...]

    def plot(self, path: Any = None) -> Any:
        """Draw the plane; the border of what is certified, if that was asked for, over it.

        Parameters
        ----------
        path : str or path, optional
            Also write the figure there; a page if it ends in .html.

        Returns
        -------
        The figure of matplotlib, or of plotly.

        Raises
        ------
        OptionError
            If what draws is missing.
        """
        known = kinds_of(self.table, self.by)
        proved = self.table["certified"].values if "certified" in self.table else None
        title = f"{self.table.attrs['model']}: {self.by}"
        figure = region_figure(self.table, self.by, self.names, known, title, proved)
        return drawn(figure, path, "region")


def region(
    model: Any,
    over: Mapping[str, Any],
    start: Any = None,
    t: Any = None,
    *,
    by: str = "verdict",
    box: Box | Callable[[Any], Box] | None = None,
    refine: Mapping[str, float] | None = None,
    **options: Any,
) -> Region:
    """A plane of parameters or starts by what becomes of each lane, and what is proved of it.

    Parameters
    ----------
    model, over, start, t, refine, options
        As :func:`hybrid.sweep` takes them; ``over`` has two names. ``refine`` goes by ``by``.
    by : str
        A column with few values: ``"verdict"`` (whether impacts accumulate), ``"mode"``,
        ``"status"``, or what is measured.
    box : dict, or callable ``(self)``
        The domain on which accumulation is to be proved, as :func:`hybrid.certify` takes it: once
        for each pair of parameters. A lane is certified where its start lies in the set that the
        certificate covers.

    Returns
    -------
    Region
        ``.table`` and ``.plot(path)``.

    Raises
    ------
    OptionError
        As :func:`hybrid.sweep` and :func:`hybrid.certify`; if there are other names than two; or if
        a column has too many values.

    Examples
    --------
    >>> hy.region(Ball(), {"r": r, "x": x}, {"v": 0.0}, (0.0, 9.0), box=BOX).plot("map.png")
    """
    if not isinstance(over, Mapping) or len(over) != 2:
        raise OptionError(f"{model.spec.model}: over={over!r}: two names; hy.sweep takes others")
    if refine is not None and box is not None:
        raise OptionError(f"{model.spec.model}: box= takes a grid: leave out refine=")
    table = sweep(model, over, start, t, refine=refine, by=by, **options)
    kinds_of(table, by)
    names = tuple(f"{name}_start" if name in model.spec.names else str(name) for name in over)
    if box is not None:
        told = {"long_name": "whether accumulation is proved"}
        table = table.assign(certified=(names, certified(model, over, start, box), told))
    return Region(table, by, names)


def certified(
    model: Any, over: Mapping[str, Any], start: Any, box: Box | Callable[[Any], Box]
) -> np.ndarray:
    """Of which lanes of a grid accumulation is proved."""
    values = [np.asarray(row, dtype=float) for row in over.values()]
    found = np.zeros([len(row) for row in values], dtype=bool)
    known: dict[tuple[float, ...], Any] = {}
    own = {name: getattr(model, name) for name in model.spec.given}
    for place in np.ndindex(found.shape):
        lane = {n: float(row[k]) for n, row, k in zip(over, values, place, strict=True)}
        given = {name: value for name, value in lane.items() if name in own}
        key = tuple(given.values())
        if key not in known:
            made = instance(type(model), [*own], [*(own | given).values()])
            proof = certify(made, dict(box(made) if callable(box) else box))
            begun = start(made) if callable(start) else dict(start or {})
            known[key] = proof.initial_set, begun
        covered, begun = known[key]
        found[place] = covered is not None and _inside(covered, begun | lane, model.spec.model)
    return found


def _inside(covered: Mapping[str, Any], begun: Mapping[str, Any], name: str) -> bool:
    """Whether a start lies in the set that a certificate covers.

    Raises
    ------
    OptionError
        If the set is one of gaps and their speeds.
    """
    if not set(covered) <= set(begun):
        raise OptionError(
            f"{name}: box= with {', '.join(covered)}: a start is told by its states; give "
            "bounds of position and velocity"
        )
    return all(_within(begun[state], bounds) for state, bounds in covered.items())


def _within(value: float, bounds: Any) -> bool:
    """Whether a value lies strictly between bounds, or is the one there is."""
    if isinstance(bounds, tuple):
        return bool(bounds[0] < value < bounds[1])
    return bool(value == bounds)
