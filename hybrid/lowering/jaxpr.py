"""Reads a jaxpr into a graph: arithmetic makes nodes, data movement permutes their numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..automaton.trace import line_of
from ..errors import TraceError
from .elements import constant, distributed, each, mapped, quotient, unsigned
from .foreign import in_words, of_primitive
from .graph import WHOLE_VALUED, Graph, Ids, needed
from .matrices import cholesky, determinants, linear_solve, triangular_solve
from .moves import COMBINED, DATA_MOVES, move, picked, placed, scattered
from .orders import in_order, largest, of_jax, searched

#: Elementwise primitives that become a node of the same name.
ELEMENTWISE = {
    *("add", "sub", "mul", "div", "neg", "sqrt", "exp", "log", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp2", "expm1", "log1p", "logistic", "cbrt", "erf", "erfc", "lgamma", "rem"),
    *("abs", "sign", "floor", "ceil", "max", "min", "gt", "ge", "lt", "le", "eq", "ne"),
    *("and", "or", "xor", "not", "is_finite"),
}

#: Primitives equivalent to others on numbers; total-order comparisons also order -0.0, 0.0 and NaN.
OTHER_NAMES = {"add_any": "add", "lt_to": "lt", "le_to": "le"}

#: Of these there is no series, and no derivative.
UNSERIED = ("lgamma",)

#: Logic of flags, where other operations are such too; of whole numbers it is bit by bit.
BITWISE = {"and", "or", "xor", "not"}
OF_FLAGS = {"max": "or", "min": "and", "add": "or", "mul": "and"}

#: Integer types wide enough for the values that occur; narrower ones may wrap round.
WHOLE_KINDS = (np.int64, np.int32, np.uint64, np.uint32)
BITS = "bits"

#: Operations whose unsigned result may stem from a negative value, and non-elementwise operations
#: that may wrap round.
BELOW_ZERO = {"sub", "neg", "convert_element_type"}
WRAPPING = {"convert_element_type", "integer_pow", "square", "reduce_sum", "cumsum", "dot_general"}


#: Whole exponents up to this are written out as products.
WRITTEN_POWER = 64

#: Terms of the polynomial that is ``sin(a) / a`` where ``a`` is less than 1, to rounding.
SINC_TERMS = 10


def read(graph: Graph, closed: Any, inputs: Sequence[Ids]) -> list[Ids]:
    """Node numbers of a closed jaxpr's results, given those of its inputs."""
    return _evaluate(graph, closed.jaxpr, closed.consts, inputs)


def require_written(closed: Any, derived: bool = False) -> set[int]:
    """Refuse a function that calls others: what only a flow may.

    ``derived``: one whose derivatives are needed. Returns the places of the inputs that the result
    depends on, counted by elements.

    Raises
    ------
    TraceError
        Names the author's line and what to write instead.
    """
    graph, inputs, count = Graph(exact=True), [], 0
    for var in closed.jaxpr.invars:
        names = range(count, count := count + var.aval.size)
        inputs.append(np.array([graph.input(f"x{i}") for i in names], dtype=np.int64))
    roots = [i for ids in read(graph, closed, inputs) for i in ids.reshape(-1).tolist()]
    used = set()
    for op, *arguments in map(graph.nodes.__getitem__, needed(graph, roots)):
        if op in UNSERIED and derived:
            said, instead = in_words(op, graph.written_at[op])
            raise TraceError(f"{said} has no derivative, which is asked for here; {instead}")
        if op == "foreign":
            said, instead = graph.called_by(arguments[0]).words
            raise TraceError(
                f"{said} cannot be written out, as only in a flow it need not be; {instead}"
            )
        if op == "input":
            used.add(int(arguments[0][1:]))
    return used


def _evaluate(graph: Graph, jaxpr: Any, consts: Sequence[Any], inputs: Sequence[Ids]) -> list[Ids]:
    held: dict[Any, Ids] = {}

    def read(atom: Any) -> Ids:
        return constant(graph, atom.val) if hasattr(atom, "val") else held[atom]

    for var, value in zip(jaxpr.constvars, consts, strict=True):
        held[var] = constant(graph, value)
    for var, ids in zip(jaxpr.invars, inputs, strict=True):
        held[var] = np.asarray(ids).reshape(var.aval.shape)
    outer = graph.line
    for equation in jaxpr.eqns:
        graph.line = outer or line_of(equation)
        results = _apply(graph, equation, [read(atom) for atom in equation.invars])
        for var, ids in zip(equation.outvars, results, strict=True):
            held[var] = np.asarray(ids).reshape(var.aval.shape)
    graph.line = outer
    return [read(atom) for atom in jaxpr.outvars]


def _apply(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids]:
    name = _name(equation)
    kind = equation.outvars[0].aval.dtype
    if name in BELOW_ZERO and kind in (np.uint64, np.uint32):
        (made,) = _written(graph, equation, inputs, name)
        wraps = partial(distributed, graph, partial(unsigned, graph, 8 * kind.itemsize))
        return [each(wraps, made)]
    return _written(graph, equation, inputs, name)


def _written(graph: Graph, equation: Any, inputs: list[Ids], name: str) -> list[Ids]:
    params = equation.params
    inner = params.get("jaxpr") or params.get("call_jaxpr")
    if name in ("div", "rem") and np.issubdtype(equation.outvars[0].aval.dtype, np.integer):
        return [each(partial(quotient, graph, name), *inputs)]
    if name in ELEMENTWISE:
        if name in UNSERIED:
            graph.written_at.setdefault(name, graph.line)
        return [mapped(graph, name, inputs)]
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
    if name in ("argmax", "argmin"):
        return [largest(graph, equation, *inputs)]
    if name == "sort" and (rows := in_order(graph, equation, inputs)) is not None:
        return rows
    for make in (searched, determinants, sinc, copysign, signbit, divided):
        if (found := make(graph, equation, inputs)) is not None:
            return found
    if inner is not None and name not in ("while", "scan"):
        closed_consts = getattr(inner, "consts", [])
        return _evaluate(graph, getattr(inner, "jaxpr", inner), closed_consts, inputs)
    if name in DATA_MOVES and placed(graph, name, inputs):
        return [move(graph, equation, inputs)]
    if (entries := picked(graph, equation, inputs)) is not None:
        return [entries]
    if name in COMBINED and (combined := scattered(graph, equation, inputs)) is not None:
        return [combined]
    if name == "custom_linear_solve":
        return linear_solve(graph, params, inputs, read)
    return _called(graph, equation, inputs)


def _name(equation: Any) -> str:
    """The operation of an equation; :data:`BITS` if it acts on bits or may wrap round."""
    name = OTHER_NAMES.get(equation.primitive.name, equation.primitive.name)
    if name in ELEMENTWISE or name in WRAPPING:
        kind = equation.outvars[0].aval.dtype
        if kind.kind == "b":
            return OF_FLAGS.get(name, name)
        if kind.kind in "iu" and (name in BITWISE or kind not in WHOLE_KINDS):
            return BITS
    return str(name)


def _called(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids]:
    """The results of an operation without scalar code, as a foreign call."""
    avals = [var.aval for var in equation.outvars]
    nodes = [i for ids in inputs for i in ids.reshape(-1).tolist()]
    values = [graph.value(i) for i in nodes]
    function = of_primitive(equation, graph.line, values)
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


def _typed(graph: Graph, numbers: Ids, kind: Any) -> Ids:
    """Numbers converted to booleans or integers where ``kind`` is such a type."""
    if kind.kind == "b":
        return mapped(graph, "ne", [numbers, constant(graph, 0.0)])
    return mapped(graph, "trunc", [numbers]) if np.issubdtype(kind, np.integer) else numbers


def _integer_pow(graph: Graph, params: Any, x: Ids) -> Ids:
    power = abs(params["y"])
    if power == 0:
        return np.full(x.shape, graph.const(1.0))
    result: Ids | None = None
    square = x
    while power:
        if power & 1:
            result = square if result is None else mapped(graph, "mul", [result, square])
        power >>= 1
        if power:
            square = mapped(graph, "mul", [square, square])
    assert result is not None
    return result if params["y"] > 0 else mapped(graph, "div", [constant(graph, 1.0), result])


def _power(graph: Graph, params: Any, x: Ids, y: Ids) -> Ids:
    """``x^y``: a product where the exponent is whole, which has a series at 0, too; by
    ``exp(y log x)`` where it moves, so that it has one at all."""

    def power(base: int, exponent: int) -> int:
        value, inner = graph.value(exponent), graph.squared(base)
        if value is not None and value == round(value) and abs(value) <= WRITTEN_POWER:
            return int(_integer_pow(graph, {"y": round(value)}, np.array(base)))
        if inner is not None and not graph.moves(exponent):
            twice = graph.node("mul", graph.const(2.0), exponent)
            return power(graph.node("abs", inner), twice)
        if not graph.moves(exponent):
            return graph.node("pow", base, exponent)
        return graph.node("exp", graph.node("mul", exponent, graph.node("log", base)))

    return each(power, x, y)


def copysign(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``copysign``, of which JAX looks at a bit; None where an equation is no such. The sign of 0
    is taken for plus."""
    if not of_jax(equation, "copysign") or len(equation.outvars) != 1:
        return None
    size = mapped(graph, "abs", [inputs[0]])
    plus = mapped(graph, "ge", [inputs[1], constant(graph, 0.0)])
    return [mapped(graph, "select", [plus, size, mapped(graph, "neg", [size])])]


def signbit(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``signbit``, also a bit, as in JAX's ``gamma``; None where an equation is no such. The sign
    of 0 is taken for plus."""
    if not of_jax(equation, "signbit") or len(equation.outvars) != 1:
        return None
    return [mapped(graph, "lt", [inputs[0], constant(graph, 0.0)])]


def sinc(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``sin(pi x) / (pi x)``, near 0 as a polynomial; None if the equation is another one, or also
    asks for the derivative."""
    if not of_jax(equation, "sinc") or len(equation.outvars) != 1:
        return None
    angle = mapped(graph, "mul", [constant(graph, math.pi), inputs[0]])
    one, square = constant(graph, 1.0), mapped(graph, "mul", [angle, angle])
    near, series = mapped(graph, "lt", [square, one]), constant(graph, 0.0)
    for k in reversed(range(SINC_TERMS)):
        term = constant(graph, (-1.0) ** k / math.factorial(2 * k + 1))
        series = mapped(graph, "add", [mapped(graph, "mul", [series, square]), term])
    apart = mapped(graph, "select", [near, one, angle])
    ratio = mapped(graph, "div", [mapped(graph, "sin", [angle]), apart])
    return [mapped(graph, "select", [near, series, ratio])]


def divided(graph: Graph, equation: Any, inputs: list[Ids]) -> list[Ids] | None:
    """``mod`` and ``floor_divide`` by ``floor`` alone; None where an equation is neither, is of
    integers, or is differentiated, with rates among its inputs. As JAX writes them they ask for the
    sign of a remainder, which only touches zero."""
    name = next((n for n in ("remainder", "floor_divide") if of_jax(equation, n)), None)
    alone = len(inputs) == 2 and len(equation.outvars) == 1
    if name is None or not alone or equation.outvars[0].aval.dtype.kind != "f":
        return None
    x, y = inputs
    whole = mapped(graph, "floor", [mapped(graph, "div", [x, y])])
    if name == "floor_divide":
        return [whole]
    return [mapped(graph, "sub", [x, mapped(graph, "mul", [y, whole])])]


def _select(graph: Graph, params: Any, which: Ids, *cases: Ids) -> Ids:
    chosen = cases[0]
    for index, case in enumerate(cases[1:], start=1):
        test = which if len(cases) == 2 else mapped(graph, "ge", [which, constant(graph, index)])
        chosen = mapped(graph, "select", [test, case, chosen])
    return chosen


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
            total = mapped(graph, op, [total, rows[..., column]])
        return total

    return rule


def _cumulate(op: str) -> Callable[..., Ids]:
    def rule(graph: Graph, params: Any, x: Ids) -> Ids:
        parts = list(np.moveaxis(x, params["axis"], 0))
        if params.get("reverse"):
            parts.reverse()
        for index in range(1, len(parts)):
            parts[index] = mapped(graph, op, [parts[index - 1], parts[index]])
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
    products = mapped(graph, "mul", [left, right])
    total = _reduce("add", 0.0)(graph, {"axes": (products.ndim - 1,)}, products)
    return total.reshape(shape)


def _rows(node: Callable[[Any], int], rows: Ids, inner: int = 1) -> Ids:
    """One node per list along the last axis (with ``inner=2``, along the last two axes)."""
    shape = rows.shape[: rows.ndim - inner]
    lists = rows.reshape(-1, *rows.shape[rows.ndim - inner :]).tolist()
    return np.array([node(row) for row in lists], dtype=np.int64).reshape(shape)


def _scan(graph: Graph, params: Any, inputs: list[Ids]) -> list[Ids]:
    """A loop of fixed length, unrolled."""
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
    """All branches, followed by an elementwise choice."""
    which, operands = inputs[0], inputs[1:]
    cases = [read(graph, branch, operands) for branch in params["branches"]]
    if len(cases) == 2:
        which = mapped(graph, "ne", [which, constant(graph, 0)])
    return [_select(graph, {}, which, *results) for results in zip(*cases, strict=True)]


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
    return constant(graph, np.broadcast_to(line, shape))


def _convert(graph: Graph, params: Any, x: Ids) -> Ids:
    kind = np.dtype(params["new_dtype"])
    if kind.kind in "iu":
        return mapped(graph, "trunc", [x])
    if kind.kind == "b":
        return mapped(graph, "ne", [x, constant(graph, 0)])
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


#: Maps a primitive to the rule for its single result.
PRIMITIVES: dict[str, Callable[..., Ids]] = {
    "integer_pow": _integer_pow,
    "pow": _power,
    "square": lambda g, p, x: mapped(g, "mul", [x, x]),
    "rsqrt": lambda g, p, x: mapped(g, "div", [constant(g, 1.0), mapped(g, "sqrt", [x])]),
    "round": lambda g, p, x: mapped(g, "round" if int(p["rounding_method"]) else "away", [x]),
    "select_n": _select,
    "clamp": lambda g, _, low, x, high: mapped(g, "min", [mapped(g, "max", [x, low]), high]),
    "reduce_sum": _reduce("add", 0.0),
    "reduce_prod": _reduce("mul", 1.0),
    "reduce_max": _reduce("max", -math.inf),
    "reduce_min": _reduce("min", math.inf),
    "reduce_and": _reduce("and", True),
    "reduce_or": _reduce("or", False),
    "cumsum": _cumulate("add"),
    "cumprod": _cumulate("mul"),
    "cummax": _cumulate("max"),
    "cummin": _cumulate("min"),
    "dot_general": _dot,
    "convert_element_type": _convert,
    "broadcast_in_dim": _broadcast,
    "reshape": lambda g, p, x: x.reshape(p["new_sizes"]),
    "tile": lambda g, p, x: np.tile(x, p["reps"]),
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
