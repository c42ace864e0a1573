"""A map on disk: a Zarr group whose arrays have a shard for each block, written once.

What the numbers depend on stands in the group's attributes; a block is there when its place in the
array ``_done`` has the time at which it was written, which is put down last.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import MAPS, StoreError, need
from .lanes import AskedLanes

if TYPE_CHECKING:
    import xarray

#: Parts of a shard that can be read alone.
SHARD_PARTS = 4

#: The array that says which blocks are there, and since when.
DONE = "_done"


class Store:
    """The tables of a map's blocks in a Zarr group.

    Raises
    ------
    StoreError
        If the group is that of another map, or none.
    """

    def __init__(self, path: Any, asked: AskedLanes) -> None:
        need("store=", MAPS)
        self.asked, self.path = asked, path
        self.group = _open(path, "a")
        key = asked.key
        own = self.group.attrs.get("hybrid")
        if own is None and any(True for _ in self.group.keys()):
            raise StoreError(f"{path} holds something else; give another store=")
        if own is not None and own["key"] != key:
            other = [name for name, said in key.items() if own["key"].get(name) != said]
            raise StoreError(
                f"{path} is a map with other {' and '.join(other)}, of {own['model']}; give "
                "another store=, or remove it"
            )
        if own is None:
            told = {"key": key, "model": asked.spec.model, "count": asked.count}
            told["block"] = asked.block
            self.group.attrs["hybrid"] = told
        if DONE not in self.group:
            over = {"shape": (asked.blocks,), "chunks": (1,), "dimension_names": ("block",)}
            self.group.create_array(DONE, dtype=float, **over)

    @property
    def missing(self) -> list[int]:
        """The blocks that are not there."""
        return [int(number) for number in np.flatnonzero(self.group[DONE][:] == 0)]

    def put(self, number: int, table: xarray.Dataset) -> None:
        """Write a block."""
        rows = self.asked.rows(number)
        for name, variable in {str(k): v for k, v in table.variables.items()}.items():
            if name not in self.group:
                self._create(name, variable)
            values = np.asarray(variable.values)
            values = values.astype(object) if values.dtype.kind == "U" else values
            if variable.dims[:1] == ("lane",):
                self.group[name][rows] = values
            else:
                self.group[name][...] = values
        if "attributes" not in self.group.attrs:
            self.group.attrs["attributes"] = json.dumps([table.attrs, [*table.coords]])
        self.group[DONE][number] = time()

    def _create(self, name: str, variable: Any) -> None:
        """The array of a variable: a shard for each block."""
        text, over = variable.dtype.kind == "U", variable.dims[:1] == ("lane",)
        shape = (self.asked.count, *variable.shape[1:]) if over else variable.shape
        block, parts = self.asked.block, SHARD_PARTS if self.asked.block % SHARD_PARTS == 0 else 1
        shards = {"chunks": (block // parts, *shape[1:]), "shards": (block, *shape[1:])}
        self.group.create_array(
            name,
            shape=shape,
            dtype=str if text else variable.dtype,
            dimension_names=variable.dims,
            attributes=dict(variable.attrs),
            **(shards if over else {}),
        )

    def table(self, rows: slice = slice(None)) -> xarray.Dataset:
        """All lanes, or some, of blocks none of which is missing."""
        import xarray

        attributes, coordinates = json.loads(self.group.attrs["attributes"])
        data = {}
        for name, array in self.group.arrays():
            if name != DONE:
                over = array.metadata.dimension_names[:1] == ("lane",)
                values = array[rows] if over else array[...]
                if values.dtype.kind in "OT":
                    values = values.astype(object).astype(str)
                data[name] = array.metadata.dimension_names, values, dict(array.attrs)
        own = {name: data.pop(name) for name in coordinates}
        return xarray.Dataset(data, coords=own, attrs=attributes)

    def opened(self) -> xarray.Dataset:
        """All lanes, when no block is missing, as columns that stay on disk."""
        import xarray

        attributes, coordinates = json.loads(self.group.attrs["attributes"])
        found = xarray.open_zarr(self.path, chunks=None, consolidated=False, drop_variables=[DONE])
        return found.set_coords(coordinates).assign_attrs(attributes)


def status(path: Any) -> dict[str, Any]:
    """How far a stored map is: its model, lanes and blocks, how many are done, lanes a second (0
    where too few blocks say), and how many lanes had each status and verdict.

    Raises
    ------
    StoreError
        If there is no map.
    """
    need("hybrid sweep --status", MAPS)
    groups = [path, *sorted(Path(path).glob("round*"))] if Path(path).is_dir() else [path]
    opened = (_open(each, "r") for each in groups)
    found = [own for own in opened if DONE in own and "hybrid" in own.attrs]  # one may be begun
    if not found:
        raise StoreError(f"{path} is no map that hybrid has stored")
    when = [group[DONE][:] for group in found]
    return {
        "model": found[0].attrs["hybrid"]["model"],
        "lanes": sum(int(group.attrs["hybrid"]["count"]) for group in found),
        "blocks": sum(len(each) for each in when),
        "done": sum(int(np.count_nonzero(each)) for each in when),
        "pace": _pace(found, np.concatenate(when)),
        "status": _counted(found, "status"),
        "verdict": _counted(found, "verdict"),
    }


def _pace(groups: list[Any], when: np.ndarray) -> float:
    """Lanes a second, from the first block written to the last; a pause between is in it."""
    there = when[when > 0]
    lasted = float(np.ptp(there)) if there.size > 1 else 0.0
    block = max(int(group.attrs["hybrid"]["block"]) for group in groups)
    return block * (there.size - 1) / lasted if lasted else 0.0


def _counted(groups: list[Any], name: str) -> dict[str, int]:
    """How many lanes of the blocks that are done have each value of a column of text."""
    found: Counter[str] = Counter()
    for group in groups:
        known, block = group.attrs["hybrid"], int(group.attrs["hybrid"]["block"])
        for number in np.flatnonzero(group[DONE][:]).tolist() if name in group else ():
            rows = slice(number * block, min((number + 1) * block, int(known["count"])))
            found.update(map(str, group[name][rows].tolist()))
    return dict(sorted(found.items()))


def _open(path: Any, mode: str) -> Any:
    import zarr

    try:
        return zarr.open_group(path, mode=mode)
    except (OSError, ValueError, KeyError) as fault:
        raise StoreError(f"cannot open {path}: {type(fault).__name__}: {fault}") from None
