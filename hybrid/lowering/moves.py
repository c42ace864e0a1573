"""Data movement: with known positions, node numbers are rearranged at no run-time cost.

With a position that depends on the state, an entry of a table is picked: one operation for a table
of any length.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from .elements import MOST_CHOICES, choosing, constant, each, few, mapped, taken
from .graph import Graph, Ids

#: Primitives that only move data; JAX itself moves the node numbers where numpy is not
#: told how below.
DATA_MOVES = {"gather", "pad", "dynamic_slice", "dynamic_update_slice"}

#: What puts numbers into an array, and what becomes of an old and a new one; None: the new one.
COMBINED = {
    "scatter": None,
    "scatter-add": "add",
    "scatter-mul": "mul",
    "scatter-min": "min",
    "scatter-max": "max",
}

#: Of the inputs of a primitive, those that are moved, where it is not the first alone.
MOVED_INPUTS = {"pad": (0, 1), "dynamic_update_slice": (0, 1)}


def _places(name: str, inputs: list[Ids]) -> list[int]:
    """Nodes of the positions of a data movement."""
    moved = MOVED_INPUTS.get(name, (0,))
    return [i for k, ids in enumerate(inputs) if k not in moved for i in ids.reshape(-1).tolist()]


def placed(graph: Graph, name: str, inputs: list[Ids]) -> bool:
    """Whether all positions are known, or are one of a few."""
    return few([graph.leaves(i) for i in _places(name, inputs)])


def move(graph: Graph, equation: Any, inputs: list[Ids]) -> Ids:
    """Let JAX rearrange the node numbers."""
    import jax

    name = equation.primitive.name
    condition = choosing(graph, _places(name, inputs))
    if condition is not None:
        way = [[each(partial(taken, graph, condition, w), ids) for ids in inputs] for w in (1, 0)]
        cases = [move(graph, equation, taken) for taken in way]
        return mapped(graph, "select", [np.array(condition), *cases])
    operands: list[Any] = []
    for place, ids in enumerate(inputs):
        if place in MOVED_INPUTS.get(name, (0,)):
            operands.append(ids)
        else:
            operands.append(each(graph.value, ids))
    if name == "pad" and all(min(row) >= 0 == row[2] for row in equation.params["padding_config"]):
        widths = [row[:2] for row in equation.params["padding_config"]]
        return np.pad(operands[0], widths, constant_values=int(operands[1]))  # avoids a compilation
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        moved_ids = equation.primitive.bind(*operands, **equation.params)
    return np.asarray(moved_ids).astype(np.int64)


def picked(graph: Graph, equation: Any, inputs: list[Ids]) -> Ids | None:
    """``x[i]`` with varying positions; None for other equations."""
    if equation.primitive.name == "dynamic_slice":
        operand, *starts = inputs
        sizes = equation.params["slice_sizes"]
        places = np.arange(operand.size).reshape(operand.shape)[tuple(map(slice, sizes))]
        begins = dict(enumerate(starts))
    elif equation.primitive.name == "gather":
        numbers = equation.params["dimension_numbers"]
        if numbers.operand_batching_dims:
            return None
        (operand, indices), sizes = inputs, equation.params["slice_sizes"]
        places = _at_zero(equation, operand.shape, indices.shape)
        apart = [1 if d in numbers.offset_dims else n for d, n in enumerate(places.shape)]
        columns = np.moveaxis(indices, -1, 0)
        begins = {
            d: c.reshape(apart) for d, c in zip(numbers.start_index_map, columns, strict=True)
        }
    else:
        return None
    return _entries(graph, operand, sizes, places, begins, _filling(equation))


def _at_zero(equation: Any, shape: tuple[int, ...], indices: tuple[int, ...]) -> np.ndarray:
    """Flat operand indices of the entries that a gather reads with all positions 0."""
    import jax
    from jax.lax import GatherScatterMode

    places = np.arange(np.prod(shape, dtype=int)).reshape(shape)
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        params = {**equation.params, "fill_value": None, "mode": GatherScatterMode.CLIP}
        return np.asarray(equation.primitive.bind(places, np.zeros(indices, dtype=int), **params))


def _filling(equation: Any) -> float | None:
    """The value of entries beyond the end of a table; None if positions are clamped."""
    from jax.lax import GatherScatterMode

    if equation.params.get("mode") != GatherScatterMode.FILL_OR_DROP:
        return None
    given = equation.params["fill_value"]
    kind = equation.outvars[0].aval.dtype
    if given is None:
        given = np.nan if kind.kind == "f" else np.iinfo(kind).min if kind.kind == "i" else True
    return kind.type(given).item()  # type: ignore[no-any-return]


def _entries(
    graph: Graph,
    operand: Ids,
    sizes: Any,
    places: np.ndarray,
    begins: dict[int, Ids],
    filling: float | None,
) -> Ids:
    table = graph.node("table", *operand.reshape(-1).tolist())
    strides = [int(np.prod(operand.shape[d + 1 :], dtype=int)) for d in range(operand.ndim)]
    where, inside = constant(graph, places), constant(graph, True)
    for d, begin in begins.items():
        first, last = (constant(graph, n) for n in (0, operand.shape[d] - sizes[d]))
        kept = mapped(graph, "min", [mapped(graph, "max", [begin, first]), last])
        if filling is not None:
            inside = mapped(graph, "and", [inside, mapped(graph, "eq", [begin, kept])])
        steps = mapped(graph, "mul", [kept, constant(graph, strides[d])])
        where = mapped(graph, "add", [where, steps])
    entries = each(lambda place: graph.node("pick", table, place), where)
    if filling is None:
        return entries
    return mapped(graph, "select", [inside, entries, constant(graph, filling)])


def scattered(graph: Graph, equation: Any, inputs: list[Ids]) -> Ids | None:
    """``x.at[i].add(y)`` and its like; ``set``, too, at positions that move. None where positions
    move and are those of more than single entries, or many."""
    operand, indices, updates = inputs
    op = COMBINED[equation.primitive.name]
    if all(graph.value(i) is not None for i in indices.reshape(-1).tolist()):
        return _combined(graph, equation, inputs, op)
    condition = choosing(graph, indices.reshape(-1).tolist())
    if condition is not None:
        ways = [each(partial(taken, graph, condition, way), indices) for way in (1, 0)]
        yes, no = (scattered(graph, equation, [operand, way, updates]) for way in ways)
        if yes is None or no is None:
            return None
        return mapped(graph, "select", [np.array(condition), yes, no])
    numbers, entries = equation.params["dimension_numbers"], updates.reshape(-1)
    single = operand.ndim == 1 and not numbers.update_window_dims and indices.shape[-1:] == (1,)
    if not single or max(operand.size, entries.size) > MOST_CHOICES:
        return None
    result, places = operand.copy(), constant(graph, np.arange(operand.size))
    for where, value in zip(indices.reshape(-1), entries, strict=True):
        here = mapped(graph, "eq", [places, np.array(where)])
        new = np.array(value) if op is None else mapped(graph, op, [result, np.array(value)])
        result = mapped(graph, "select", [here, new, result])
    return result


def _combined(graph: Graph, equation: Any, inputs: list[Ids], op: str | None) -> Ids:
    """The same at known positions, of which some may be one: JAX tells which update comes to which,
    those of the least numbers first."""
    operand, indices, updates = inputs
    count, result = updates.size, operand.copy()
    left = np.arange(count).reshape(updates.shape)
    while True:
        landed = _landed(equation, operand.shape, each(graph.value, indices), left, count)
        found = landed < count
        if not found.any():
            return result
        new = updates.reshape(-1)[landed[found]]
        result[found] = new if op is None else mapped(graph, op, [result[found], new])
        left = np.where(np.isin(left, landed[found]), count, left)


def _landed(
    equation: Any, shape: tuple[int, ...], indices: Ids, numbers: np.ndarray, none: int
) -> np.ndarray:
    """The least number that comes to each entry; where none does, ``none``."""
    import jax

    dimensions, mode = (equation.params[name] for name in ("dimension_numbers", "mode"))
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        empty = np.full(shape, none)
        found = jax.lax.scatter_min(empty, indices, numbers, dimensions, mode=mode)
        return np.asarray(found)
