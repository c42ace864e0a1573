"""``hy.sweep``: a model over a grid of parameters and starts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton.base import require_model
from ..ensembles import ensemble
from ..errors import TABLES, OptionError, need
from ..run.options import require_taken
from .lanes import AskedLanes, block_of, dimension, joined, points_of
from .refine import Lattice, refined
from .store import Store
from .workers import Progress, flown, followed

if TYPE_CHECKING:
    import xarray


def sweep(
    model: Any,
    over: Mapping[str, Any],
    start: Any = None,
    t: Any = None,
    *,
    executor: Any = None,
    store: Any = None,
    block: int | None = None,
    refine: Mapping[str, float] | None = None,
    by: str = "verdict",
    follow: bool = False,
    progress: Progress | None = None,
    load: bool = True,
    **options: Any,
) -> xarray.Dataset:
    """Simulate a model over a grid of parameters and starts, in blocks.

    Parameters
    ----------
    model : Automaton
    over : dict
        Values by the names of parameters and states; a state's are those at the start.
    start : dict, or callable ``(self)``
        The other states at the start; a function gives them of the model with a lane's parameters.
    t : (t0, t1), or callable ``(self)``
        First and last time.
    executor : concurrent.futures.Executor, optional
        What flies blocks: a pool of threads or processes, Dask's ``Client.get_executor()``, one of
        submitit, to which they are jobs of one array. Without one they are flown here, where an
        ensemble has threads on all cores; blocks of lanes that go one by one (a ``section`` that is
        no jump's name, ``save``, ``certify``, ``"stick"``, ``"lyapunov"``) are shared with other
        processes where that pays. A block whose worker has died is flown again, here.
    store : path, optional
        A Zarr group into which each block is written once. Where it exists, what is there is not
        flown again (extra ``maps``).
    block : int, optional
        Lanes in a block.
    refine : dict, optional
        Widths by names in ``over``: cells of the grid within which lanes differ are halved until
        they are no wider.
    by : str
        The column by which they differ.
    follow : bool
        Over one parameter: each lane begins where the one before has ended, in the order of the
        values, at the same first time; so where time matters let lanes take whole periods. After a
        lane that has not come to its end the next one begins at ``start`` again.
    progress : callable ``(done, lanes)``, optional
        Called after each block; with ``refine`` of each round.
    load : bool
        With ``store`` and False the columns stay on disk until they are looked at, over ``lane``:
        for maps that do not fit into memory.
    options
        As :func:`hybrid.ensemble` takes them: ``measure``, ``section``, ``solver`` and the others.

    Returns
    -------
    xarray.Dataset
        What :func:`hybrid.ensemble` gives, over the names in ``over`` in place of ``lane``; the
        dimension of a state is ``x_start``. A lane that fails is a row with its reason. With
        ``refine`` over one name its values lie closer where lanes differ; over several the table
        stays one over ``lane``.

    Raises
    ------
    OptionError, StartError, ParameterError
        If what is given cannot be used.
    StoreError
        If the store is of another map.

    Examples
    --------
    >>> hy.sweep(Ball(), over={"r": r, "x": x}, start={"v": 0.0}, t=(0.0, 30.0)).t_inf.plot()
    """
    need("hy.sweep", TABLES)
    require_model(model)
    require_taken(model.spec.model, options, sweep, ensemble)
    axes = points_of(model.spec, over)
    if not load and (store is None or refine is not None):
        raise OptionError(f"{model.spec.model}: load=False takes store=, and no refine=")
    if follow and refine is not None:
        raise OptionError(f"{model.spec.model}: follow=True goes over a row of values: no refine=")

    def fly(points: Mapping[str, np.ndarray], turn: int = 0) -> xarray.Dataset:
        lanes = block_of(len(next(iter(points.values()))), block)
        place = store if store is None or not turn else Path(store) / f"round{turn}"
        begun = {} if start is None else start
        asked = AskedLanes(model, points, begun, t, options, lanes, follow)
        if follow:
            asked.require_followed()
        return lanes_of(asked, executor, place, progress, load)

    names = {name: dimension(model.spec, name) for name in axes}
    if refine is not None:
        table = refined(Lattice.of(model.spec, axes, refine), by, fly)
        (first, *others) = names.values()
        return table if others else table.swap_dims(lane=first).sortby(first)
    grid = [v.ravel() for v in np.meshgrid(*axes.values(), indexing="ij")]
    table = fly(dict(zip(axes, grid, strict=True)))
    if not load:
        return table
    return folded(table, {names[name]: values for name, values in axes.items()})


def lanes_of(
    asked: AskedLanes,
    executor: Any,
    store: Any,
    progress: Progress | None = None,
    load: bool = True,
) -> xarray.Dataset:
    """All lanes as a table over ``lane``, those that a store has from there."""
    kept = None if store is None else Store(store, asked)
    tables: dict[int, xarray.Dataset] = {}
    missing = list(range(asked.blocks)) if kept is None else kept.missing
    done = asked.blocks - len(missing)
    if asked.follow:
        before = kept.table(asked.rows(done - 1)) if kept is not None and done else None
        made = followed(asked, missing, executor, before)
    else:
        made = flown(asked, missing, executor)
    with closing(made) as blocks:
        for number, table in blocks:
            if kept is None:
                tables[number] = table
            else:
                kept.put(number, table)
            done += 1
            if progress is not None:
                progress(min(done * asked.block, asked.count), asked.count)
    if kept is not None:
        return kept.table() if load else kept.opened()
    return joined([tables[number] for number in range(asked.blocks)])


def folded(table: xarray.Dataset, axes: Mapping[str, np.ndarray]) -> xarray.Dataset:
    """A table over ``lane`` as one over a grid."""
    import xarray

    shape = tuple(map(len, axes.values()))
    data = {
        name: (
            (*axes, *variable.dims[1:]),
            variable.values.reshape(shape + variable.shape[1:]),
            variable.attrs,
        )
        for name, variable in table.data_vars.items()
    }
    coordinates: dict[Any, Any] = {
        name: (variable.dims, variable.values, variable.attrs)
        for name, variable in table.coords.items()
        if "lane" not in variable.dims
    }
    for name, values in axes.items():
        coordinates[name] = name, values, table.coords[name].attrs
    return xarray.Dataset(data, coords=coordinates, attrs=table.attrs)
