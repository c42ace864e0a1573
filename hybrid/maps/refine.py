"""A map made finer where neighbours differ: cells are halved, and their new corners flown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise, product
from math import ceil, log2
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..errors import OptionError
from .lanes import joined

if TYPE_CHECKING:
    import xarray

    from ..automaton.spec import Spec

#: Halvings of a cell at most: beyond them its corners are neighbouring floats.
MOST_HALVINGS = 48

Corner = tuple[int, ...]


class _Cell(NamedTuple):
    """A box: its lowest and its highest corner."""

    low: Corner
    high: Corner

    def corners(self) -> Iterator[Corner]:
        """All corners; fewer where a side has no length."""
        return product(*(sorted({a, b}) for a, b in zip(self.low, self.high, strict=True)))

    def halves(self, longest: Corner) -> list[_Cell]:
        """The parts by halving each side that is longer; itself where none is."""
        sides = []
        for a, b, most in zip(self.low, self.high, longest, strict=True):
            sides.append([(a, b)] if b - a <= most else [(a, (a + b) // 2), ((a + b) // 2, b)])
        return [_Cell(*zip(*part, strict=True)) for part in product(*sides)]


@attrs.frozen(eq=False)
class Lattice:
    """A grid and all points that halving its cells may lead to, by whole numbers.

    ``size`` is what lies between neighbours of the grid. ``longest`` is, by axis, the side
    that need not be halved.
    """

    axes: Mapping[str, np.ndarray]
    size: int
    longest: Corner

    @classmethod
    def of(cls, spec: Spec, axes: Mapping[str, np.ndarray], widths: Any) -> Lattice:
        """The lattice for these widths by name."""
        if not isinstance(widths, Mapping) or not widths or not set(widths) <= set(axes):
            known = ", ".join(axes)
            raise OptionError(f"{spec.model}: refine={widths!r}: widths by name, of {known}")
        axes = {name: np.sort(values) for name, values in axes.items()}
        halvings = {}
        for name, width in widths.items():
            if not (isinstance(width, int | float) and width > 0):
                raise OptionError(f"{spec.model}: refine {name}={width!r}: a width greater than 0")
            gap = float(np.diff(axes[name]).max(initial=0.0))
            halvings[name] = max(0, ceil(log2(gap / width))) if gap else 0
            if halvings[name] > MOST_HALVINGS:
                raise OptionError(f"{spec.model}: refine {name}={width!r}: less than rounding")
        size = 1 << max(halvings.values())
        return cls(axes, size, tuple(size >> halvings.get(name, 0) for name in axes))

    def cells(self) -> list[_Cell]:
        """The cells of the grid."""
        sides = []
        for values in self.axes.values():
            steps = [i * self.size for i in range(len(values))]
            sides.append(list(pairwise(steps)) or [(0, 0)])
        return [_Cell(*zip(*box, strict=True)) for box in product(*sides)]

    def points(self, corners: list[Corner]) -> dict[str, np.ndarray]:
        """The values by name at some points."""
        known = zip(self.axes.items(), np.array(corners).T, strict=True)
        return {
            name: np.interp(column / self.size, np.arange(len(values)), values)
            for (name, values), column in known
        }


Fly = Callable[[Mapping[str, np.ndarray], int], "xarray.Dataset"]


def refined(lattice: Lattice, by: str, fly: Fly) -> xarray.Dataset:
    """Tables over ``lane`` of a grid and of what lies between neighbours that differ.

    ``fly(points, round)`` flies points; ``by`` is the column by which they differ.

    Raises
    ------
    OptionError
        If there is no such column.
    """
    cells, known = lattice.cells(), dict[Corner, Any]()
    tables: list[xarray.Dataset] = []
    while True:
        new = sorted({c for cell in cells for c in cell.corners()} - set(known))
        if not new:
            break
        table = fly(lattice.points(new), len(tables))
        if by not in table or table[by].dims != ("lane",):
            one = [name for name in table if table[name].dims == ("lane",)]
            raise OptionError(f"by={by!r}: one value a lane is due: {', '.join(map(str, one))}")
        known |= dict(zip(new, table[by].values.tolist(), strict=True))
        tables.append(table)
        cells = _halved(cells, known, lattice.longest)
    return joined(tables)


def _halved(cells: list[_Cell], known: Mapping[Corner, Any], longest: Corner) -> list[_Cell]:
    """The cells, those halved within which points differ."""
    places = np.array([*known])
    _, kinds = np.unique([repr(value) for value in known.values()], return_inverse=True)
    found = []
    for cell in cells:
        inside = np.all((places >= cell.low) & (places <= cell.high), axis=1)
        differ = np.ptp(kinds[inside]) > 0
        found += cell.halves(longest) if differ else [cell]
    return found
