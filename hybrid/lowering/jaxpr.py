"""A jaxpr read into a graph: arithmetic becomes nodes, and moving data moves their numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..errors import TraceError
from .foreign import of_primitive
from .graph import WHOLE_VALUED, Graph, Ids
from .matrices import cholesky, linear_solve, triangular_solve

#: Elementwise primitives that become a node of the same name.
ELEMENTWISE = {
    *("add", "sub", "mul", "div", "neg", "sqrt", "exp", "log", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp2", "expm1", "log1p", "logistic", "cbrt", "erf", "erfc", "lgamma", "rem"),
    *("abs", "sign", "floor", "ceil", "max", "min", "gt", "ge", "lt", "le", "eq", "ne"),
    *("and", "or", "xor", "not", "is_finite"),
}

#: Primitives that are such on numbers: those that order -0.0, 0.0 and NaN as well among them.
OTHER_NAMES = {"add_any": "add", "lt_to": "lt", "le_to": "le"}

#: Logic of flags, where other operations are such too; of whole numbers it is bit by bit.
BITWISE = {"and", "or", "xor", "not"}
OF_FLAGS = {"max": "or", "min": "and", "add": "or", "mul": "and"}

#: Whole numbers with room for all that occur; what is made of others may wrap round.
WHOLE_KINDS = (np.int64, np.int32, np.uint64, np.uint32)
BITS = "bits"

#: Where those without a sign may come from below zero.
BELOW_ZERO = {"sub", "neg", "convert_element_type"}
WRAPPING = {"convert_element_type", "integer_pow", "square", "reduce_sum", "cumsum", "dot_general"}

#: Most whole numbers among which a choice is written out, as that of a place in a table; of two
#: together as many as of each. Places are found by halves, in steps that share their conditions.
MOST_CHOICES = 64

#: Primitives that only move data; JAX itself moves the node numbers where numpy is not
#: told how below.
DATA_MOVES = {"gather", "pad", "dynamic_slice", "dynamic_update_slice", "scatter"}


def read(graph: Graph, closed: Any, inputs: Sequence[Ids]) -> list[Ids]:
    """Node numbers of a closed jaxpr's results, given those of its inputs."""
    return _evaluate(graph, closed.jaxpr, closed.consts, inputs)


def _evaluate(graph: Graph, jaxpr: Any, consts: Sequence[Any], inputs: Sequence[Ids]) -> list[Ids]:
    held: dict[Any, Ids] = {}

    def read(atom: Any) -> Ids:
        return _constant(graph, atom.val) if hasattr(atom, "val") else held[atom]

    for var, value in zip(jaxpr.constvars, consts, strict=True):
        held[var] = _constant(graph, value)
    for var, ids in zip(jaxpr.invars, inputs, strict=True):
        held[var] = np.asarray(ids).reshape(var.aval.shape)
    for equation in jaxpr.eqns:
        results = _apply(graph, equation, [read(atom) for atom in equation.invars])
        for var, ids in zip(equation.outvars, results, strict=True):
            held[var] = np.asarray(ids).reshape(var.aval.shape)
    return [read(atom) for atom in jaxpr.outvars]


def _constant(graph: Graph, value: Any) -> Ids:
    array = np.asarray(value)
    flat = [graph.const(element) for element in array.reshape(-1)]
    return np.array(flat, dtype=np.int64).reshape(array.shape)


def _apply(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids]:
    name = _name(equation)
    kind = equation.outvars[0].aval.dtype
    if name in BELOW_ZERO and kind in (np.uint64, np.uint32):
        (made,) = _written(graph, equation, inputs, name)
        wraps = partial(_node, graph, partial(_unsigned, graph, 8 * kind.itemsize))
        return [_each(wraps, made)]
    return _written(graph, equation, inputs, name)


def _written(graph: Graph, equation: Any, inputs: list[Ids], name: str) -> list[Ids]:
    params = equation.params
    inner = params.get("jaxpr") or params.get("call_jaxpr")
    if name in ("div", "rem") and np.issubdtype(equation.outvars[0].aval.dtype, np.integer):
        return [_each(partial(_whole, graph, name), *inputs)]
    if name in ELEMENTWISE:
        return [_map(graph, name, inputs)]
    if name in PRIMITIVES:
        return [PRIMITIVES[name](graph, params, *inputs)]
    if name == "scan":
        return _scan(graph, params, inputs)
    if name == "cond":
        return _cond(graph, params, inputs)
    if name == "split":
        bounds = np.cumsum(params["sizes"])[:-1]
        return list(np.split(inputs[0], bounds, axis=params["axis"]))
    if name == "unstack":
        return list(np.moveaxis(inputs[0], params["axis"], 0))
    if inner is not None and name not in ("while", "scan"):
        closed_consts = getattr(inner, "consts", [])
        return _evaluate(graph, getattr(inner, "jaxpr", inner), closed_consts, inputs)
    if name in DATA_MOVES and _placed(graph, name, inputs):
        return [_move(graph, equation, inputs)]
    if name == "scatter-add" and _placed(graph, name, inputs):
        return [_scatter_add(graph, equation, inputs)]
    if name == "custom_linear_solve":
        return linear_solve(graph, params, inputs, read)
    return _called(graph, equation, inputs)


def _name(equation: Any) -> str:
    """What an equation does; :data:`BITS` where its whole numbers are bits, or may wrap round."""
    name = OTHER_NAMES.get(equation.primitive.name, equation.primitive.name)
    if name in ELEMENTWISE or name in WRAPPING:
        kind = equation.outvars[0].aval.dtype
        if kind.kind == "b":
            return OF_FLAGS.get(name, name)
        if kind.kind in "iu" and (name in BITWISE or kind not in WHOLE_KINDS):
            return BITS
    return str(name)


def _called(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids]:
    """The results of what cannot be written out."""
    avals = [var.aval for var in equation.outvars]
    if not all(_is_real(atom.aval) for atom in (*equation.invars, *equation.outvars)):
        raise TraceError(
            f"the primitive {equation.primitive.name!r} of what is no real number (a random key, a "
            "complex number) cannot be written as scalar code; write this part with arithmetic"
        )
    nodes = [i for ids in inputs for i in ids.reshape(-1).tolist()]
    values = [graph.value(i) for i in nodes]
    function = of_primitive(equation, values)
    arguments = [i for i, value in zip(nodes, values, strict=True) if value is None]
    count = sum(math.prod(aval.shape) for aval in avals)
    if arguments:
        call = graph.called(function, arguments)
        found = [graph.node("part", call, graph.const(i)) for i in range(count)]
    else:
        found = [graph.const(value) for value in function()]
    ends = np.cumsum([math.prod(aval.shape) for aval in avals])[:-1]
    pieces = zip(np.split(np.array(found, dtype=np.int64), ends), avals, strict=True)
    return [_typed(graph, ids.reshape(aval.shape), aval.dtype) for ids, aval in pieces]


def _is_real(aval: Any) -> bool:
    kind = getattr(aval, "dtype", None)
    return isinstance(kind, np.dtype) and kind.kind in "fiub"


def _typed(graph: Graph, numbers: Ids, kind: Any) -> Ids:
    """Numbers as flags, or as whole numbers, where they stand for such."""
    if kind.kind == "b":
        return _map(graph, "ne", [numbers, _constant(graph, 0.0)])
    return _map(graph, "trunc", [numbers]) if np.issubdtype(kind, np.integer) else numbers


def _map(graph: Graph, op: str, inputs: list[Ids]) -> Ids:
    return _each(partial(_node, graph, partial(graph.node, op)), *inputs)


def _each(make: Callable[..., int], *inputs: Ids) -> Ids:
    """What is made of each element."""
    arrays = np.broadcast_arrays(*inputs)
    rows = zip(*(a.reshape(-1).tolist() for a in arrays), strict=True)
    return np.array([make(*row) for row in rows], dtype=np.int64).reshape(arrays[0].shape)


def _whole(graph: Graph, op: str, *arguments: int) -> int:
    """A quotient of whole numbers, or what is left of it."""

    def make(a: int, b: int) -> int:
        x, y = graph.value(a), graph.value(b)
        if x is None or not y:
            return graph.node("trunc", graph.node(op, a, b))
        quotient = abs(x) // abs(y) * (1 if x * y >= 0 else -1)
        return graph.const(quotient if op == "div" else x - y * quotient)

    return _node(graph, make, *arguments)


def _unsigned(graph: Graph, bits: int, value: int) -> int:
    """A whole number without a sign: below zero it begins again from above."""
    if (known := graph.value(value)) is not None:
        return value if known >= 0 else graph.const(known + 2**bits)
    below = graph.node("lt", value, graph.const(0.0))
    return graph.node("select", below, graph.node("add", value, graph.const(2.0**bits)), value)


def _node(graph: Graph, make: Callable[..., int], *arguments: int) -> int:
    """What is made of some nodes; of choices among whole numbers a choice among the results."""
    condition = _choosing(graph, arguments)
    if condition is None:
        return make(*arguments)
    cases = [[_taken(graph, condition, way, a) for a in arguments] for way in (1, 0)]
    yes, no = (_node(graph, make, *case) for case in cases)
    return yes if yes == no else graph.node("select", condition, yes, no)


def _choosing(graph: Graph, numbers: Sequence[int]) -> int | None:
    """The first condition of choices among whole numbers; None where they are no such, or many."""
    counts = [graph.leaves(number) for number in numbers]
    if not _few(counts):
        return None
    several = (n for n, count in zip(numbers, counts, strict=True) if count > 1)
    return next((graph.nodes[n][1] for n in several), None)


def _few(counts: Sequence[int]) -> bool:
    """Whether there are choices among whole numbers only, not too many of them together."""
    return 0 < math.prod(counts) <= MOST_CHOICES**2 and max(counts, default=1) <= MOST_CHOICES


def _taken(graph: Graph, condition: int, way: int, number: int) -> int:
    """A choice where a condition holds (1), or does not (0)."""
    if graph.leaves(number) <= 1:
        return number
    _, which, *cases = graph.nodes[number]
    yes, no = (_taken(graph, condition, way, case) for case in cases)
    if which == condition:
        return yes if way else no
    return yes if yes == no else graph.node("select", which, yes, no)


def _integer_pow(graph: Graph, params: Any, x: Ids) -> Ids:
    power = abs(params["y"])
    if power == 0:
        return np.full(x.shape, graph.const(1.0))
    result: Ids | None = None
    square = x
    while power:
        if power & 1:
            result = square if result is None else _map(graph, "mul", [result, square])
        power >>= 1
        if power:
            square = _map(graph, "mul", [square, square])
    assert result is not None
    return result if params["y"] > 0 else _map(graph, "div", [_constant(graph, 1.0), result])


def _power(graph: Graph, params: Any, x: Ids, y: Ids) -> Ids:
    """``x^y``; by ``exp(y log x)`` where the exponent moves, so that it has a series."""
    if not any(graph.moves(int(i)) for i in y.reshape(-1)):
        return _map(graph, "pow", [x, y])
    return _map(graph, "exp", [_map(graph, "mul", [y, _map(graph, "log", [x])])])


def _select(graph: Graph, params: Any, which: Ids, *cases: Ids) -> Ids:
    chosen = cases[0]
    for index, case in enumerate(cases[1:], start=1):
        test = which if len(cases) == 2 else _map(graph, "ge", [which, _constant(graph, index)])
        chosen = _map(graph, "select", [test, case, chosen])
    return chosen


def _clamp(graph: Graph, params: Any, low: Ids, x: Ids, high: Ids) -> Ids:
    return _map(graph, "min", [_map(graph, "max", [x, low]), high])


def _reduce(op: str, start: float | bool) -> Callable[..., Ids]:
    def rule(graph: Graph, params: Any, x: Ids) -> Ids:
        axes = params["axes"]
        kept = [a for a in range(x.ndim) if a not in axes]
        rows = x.transpose([*kept, *axes]).reshape([x.shape[a] for a in kept] + [-1])
        if op == "add" and graph.long:
            return _rows(graph.total, rows)
        total = (
            np.full(rows.shape[:-1], graph.const(start)) if rows.shape[-1] == 0 else rows[..., 0]
        )
        for column in range(1, rows.shape[-1]):
            total = _map(graph, op, [total, rows[..., column]])
        return total

    return rule


def _cumulate(op: str) -> Callable[..., Ids]:
    def rule(graph: Graph, params: Any, x: Ids) -> Ids:
        parts = list(np.moveaxis(x, params["axis"], 0))
        if params.get("reverse"):
            parts.reverse()
        for index in range(1, len(parts)):
            parts[index] = _map(graph, op, [parts[index - 1], parts[index]])
        if params.get("reverse"):
            parts.reverse()
        return np.moveaxis(np.stack(parts), 0, params["axis"])

    return rule


def _dot(graph: Graph, params: Any, a: Ids, b: Ids) -> Ids:
    (ca, cb), (ba, bb) = params["dimension_numbers"]
    fa = [i for i in range(a.ndim) if i not in (*ca, *ba)]
    fb = [i for i in range(b.ndim) if i not in (*cb, *bb)]
    batch = [a.shape[i] for i in ba]
    shape = batch + [a.shape[i] for i in fa] + [b.shape[i] for i in fb]
    left = a.transpose([*ba, *fa, *ca]).reshape([*batch, math.prod(a.shape[i] for i in fa), 1, -1])
    right = b.transpose([*bb, *fb, *cb]).reshape([*batch, 1, math.prod(b.shape[i] for i in fb), -1])
    if graph.long:
        pairs = np.stack(np.broadcast_arrays(left, right), axis=-1)
        return _rows(graph.dot, pairs, 2).reshape(shape)
    products = _map(graph, "mul", [left, right])
    total = _reduce("add", 0.0)(graph, {"axes": (products.ndim - 1,)}, products)
    return total.reshape(shape)


def _rows(node: Callable[[Any], int], rows: Ids, inner: int = 1) -> Ids:
    """One node for each list along the last axis (with ``inner`` 2, along the last two)."""
    shape = rows.shape[: rows.ndim - inner]
    lists = rows.reshape(-1, *rows.shape[rows.ndim - inner :]).tolist()
    return np.array([node(row) for row in lists], dtype=np.int64).reshape(shape)


def _scan(graph: Graph, params: Any, inputs: list[Ids]) -> list[Ids]:
    """A loop of fixed length, written out."""
    nc, nk = params["num_consts"], params["num_carry"]
    consts, carry, xs = inputs[:nc], inputs[nc : nc + nk], inputs[nc + nk :]
    order = range(params["length"])
    rows: list[list[Ids]] = []
    for index in reversed(order) if params["reverse"] else order:
        results = read(graph, params["jaxpr"], [*consts, *carry, *(x[index] for x in xs)])
        carry = results[:nk]
        rows.append(results[nk:])
    if params["reverse"]:
        rows.reverse()
    stacked = [np.stack(column) for column in zip(*rows, strict=True)]
    return [*carry, *stacked]


def _cond(graph: Graph, params: Any, inputs: list[Ids]) -> list[Ids]:
    """All branches, then a choice for each element."""
    which, operands = inputs[0], inputs[1:]
    cases = [read(graph, branch, operands) for branch in params["branches"]]
    if len(cases) == 2:
        which = _map(graph, "ne", [which, _constant(graph, 0)])
    return [_select(graph, {}, which, *results) for results in zip(*cases, strict=True)]


#: Of the inputs of a primitive, those that are moved, where it is not the first alone.
MOVED_INPUTS = {
    "pad": (0, 1),
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
    "scatter-add": (0, 2),
}


def _places(name: str, inputs: list[Ids]) -> list[int]:
    """Nodes of the positions that a primitive moves numbers from or to."""
    moved = MOVED_INPUTS.get(name, (0,))
    return [i for k, ids in enumerate(inputs) if k not in moved for i in ids.reshape(-1).tolist()]


def _placed(graph: Graph, name: str, inputs: list[Ids]) -> bool:
    """Whether all positions are known, or are one of a few."""
    counts = [graph.leaves(i) for i in _places(name, inputs)]
    return _few(counts) and (name != "scatter-add" or max(counts, default=1) == 1)


def _move(graph: Graph, equation: Any, inputs: list[Ids]) -> Ids:
    """Let JAX move the node numbers."""
    import jax

    name = equation.primitive.name
    condition = _choosing(graph, _places(name, inputs))
    if condition is not None:
        way = [[_each(partial(_taken, graph, condition, w), ids) for ids in inputs] for w in (1, 0)]
        cases = [_move(graph, equation, taken) for taken in way]
        return _map(graph, "select", [np.array(condition), *cases])
    operands: list[Any] = []
    for place, ids in enumerate(inputs):
        if place in MOVED_INPUTS.get(name, (0,)):
            operands.append(ids.astype(float) if name.startswith("scatter") else ids)
        else:
            operands.append(_each(graph.value, ids))
    if name == "pad" and all(min(row) >= 0 == row[2] for row in equation.params["padding_config"]):
        widths = [row[:2] for row in equation.params["padding_config"]]
        return np.pad(operands[0], widths, constant_values=int(operands[1]))  # spares a compilation
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        moved_ids = equation.primitive.bind(*operands, **equation.params)
    return np.asarray(moved_ids).astype(np.int64)


def _scatter_add(graph: Graph, equation: Any, inputs: list[Ids]) -> Ids:
    """``x.at[i].add(y)``, one summand a place: let JAX put the summands' places over zeros."""
    operand, indices, updates = inputs
    zeros, places = np.zeros(operand.shape), np.arange(1, updates.size + 1).reshape(updates.shape)
    counts = _move(graph, equation, [zeros, indices, np.ones(updates.shape)])
    if counts.max(initial=0) > 1:
        raise TraceError("x.at[...].add(...) with a repeated position; add the summands first")
    landed = _move(graph, equation, [zeros, indices, places])
    summands = np.concatenate([[graph.const(0.0)], updates.reshape(-1)])
    return _map(graph, "add", [operand, summands[landed]])


def _broadcast(graph: Graph, params: Any, x: Ids) -> Ids:
    shape = [1] * len(params["shape"])
    for axis, place in enumerate(params["broadcast_dimensions"]):
        shape[place] = x.shape[axis]
    return np.broadcast_to(x.reshape(shape), params["shape"])


def _slice(graph: Graph, params: Any, x: Ids) -> Ids:
    strides = params["strides"] or (1,) * x.ndim
    bounds = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return x[tuple(itertools.starmap(slice, bounds))]


def _iota(graph: Graph, params: Any) -> Ids:
    shape, axis = params["shape"], params["dimension"]
    line = np.arange(shape[axis]).reshape([-1 if a == axis else 1 for a in range(len(shape))])
    return _constant(graph, np.broadcast_to(line, shape))


def _convert(graph: Graph, params: Any, x: Ids) -> Ids:
    kind = np.dtype(params["new_dtype"])
    if kind.kind in "iu":
        return _map(graph, "trunc", [x])
    if kind.kind == "b":
        return _map(graph, "ne", [x, _constant(graph, 0)])
    flat = [
        graph.node("real", int(i))
        if graph.nodes[i][0] in WHOLE_VALUED or _is_whole(graph.value(i))
        else i
        for i in x.reshape(-1)
    ]
    return np.array(flat, dtype=np.int64).reshape(x.shape)


def _is_whole(value: Any) -> bool:
    return isinstance(value, bool | int)


def _same(graph: Graph, params: Any, x: Ids) -> Ids:
    return x


#: Primitive name to the rule that gives its single result.
PRIMITIVES: dict[str, Callable[..., Ids]] = {
    "integer_pow": _integer_pow,
    "pow": _power,
    "square": lambda g, p, x: _map(g, "mul", [x, x]),
    "rsqrt": lambda g, p, x: _map(g, "div", [_constant(g, 1.0), _map(g, "sqrt", [x])]),
    "round": lambda g, p, x: _map(g, "round" if int(p["rounding_method"]) else "away", [x]),
    "select_n": _select,
    "clamp": _clamp,
    "reduce_sum": _reduce("add", 0.0),
    "reduce_prod": _reduce("mul", 1.0),
    "reduce_max": _reduce("max", -math.inf),
    "reduce_min": _reduce("min", math.inf),
    "reduce_and": _reduce("and", True),
    "reduce_or": _reduce("or", False),
    "cumsum": _cumulate("add"),
    "cumprod": _cumulate("mul"),
    "dot_general": _dot,
    "convert_element_type": _convert,
    "broadcast_in_dim": _broadcast,
    "reshape": lambda g, p, x: x.reshape(p["new_sizes"]),
    "squeeze": lambda g, p, x: np.squeeze(x, axis=tuple(p["dimensions"])),
    "expand_dims": lambda g, p, x: np.expand_dims(x, tuple(p["dimensions"])),
    "transpose": lambda g, p, x: x.transpose(p["permutation"]),
    "rev": lambda g, p, x: np.flip(x, tuple(p["dimensions"])),
    "slice": _slice,
    "concatenate": lambda g, p, *xs: np.concatenate(xs, axis=p["dimension"]),
    "stack": lambda g, p, *xs: np.stack(xs, axis=p["axis"]),
    "iota": _iota,
    "triangular_solve": triangular_solve,
    "cholesky": cholesky,
    "copy": _same,
    "copy_p": _same,
    "stop_gradient": _same,
    "reduce_precision": _same,
    "optimization_barrier": _same,
}
