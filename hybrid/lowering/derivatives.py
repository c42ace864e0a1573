"""Derivatives of graph nodes: directional derivatives and gradients.

They are nodes of the same graph, so subexpressions are shared with the functions and nothing is
traced again. Nonsmooth rules are those of JAX: the slope of ``abs`` at 0 is 1, and that of ``max``
at a tie is split evenly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ..errors import TraceError
from .graph import TIME_PLACE, WHOLE_VALUED, Graph, needed, states_in
from .taylor import SLOPES

#: Operations with zero derivative wherever it exists, or with rules of their own.
FLAT = WHOLE_VALUED | {
    "floor",
    "ceil",
    "round",
    "away",
    "sign",
    "const",
    "input",
    "part",
    "solve",
    "foreign",
    "table",
}


def _ratio(g: Graph, a: int, b: int) -> list[int]:
    y = g.node("div", a, b)
    return [g.node("div", g.const(1.0), b), g.node("neg", g.node("div", y, b))]


def _extreme(first: str, second: str) -> Callable[..., list[int]]:
    """The slopes of ``max`` or ``min``: by comparisons of the arguments, which bounds decide."""

    def slopes(g: Graph, a: int, b: int) -> list[int]:
        zero, one = g.const(0.0), g.const(1.0)
        is_a, is_b = g.node(first, a, b), g.node(second, a, b)
        share = g.node("select", is_b, g.const(0.5), one)
        other = g.node("select", is_a, g.const(0.5), one)
        return [g.node("select", is_a, share, zero), g.node("select", is_b, other, zero)]

    return slopes


def _size(g: Graph, a: int) -> list[int]:
    return [g.node("select", g.node("ge", a, g.const(0.0)), g.const(1.0), g.const(-1.0))]


def _power(g: Graph, a: int, p: int) -> list[int]:
    lower = g.node("pow", a, g.node("sub", p, g.const(1.0)))
    return [g.node("mul", p, lower), _by_exponent(g, a, p)]


def _by_exponent(g: Graph, a: int, p: int) -> int:
    """The slope ``a^p log a`` by the exponent; 0 where ``a`` is 0 or ``p`` is constant.

    A varying exponent is written as ``exp(p log a)`` instead.
    """
    zero, one = g.const(0.0), g.const(1.0)
    if g.value(p) is not None:
        return zero
    base = g.node("select", g.node("eq", a, zero), one, a)
    return g.node("mul", g.node("pow", a, p), g.node("log", base))


def _angle(g: Graph, y: int, x: int) -> list[int]:
    square = g.node("add", g.node("mul", x, x), g.node("mul", y, y))
    return [g.node("div", x, square), g.node("neg", g.node("div", y, square))]


#: The partial derivatives of an operation by its arguments.
LOCAL_SLOPES: dict[str, Callable[..., list[int]]] = {
    "add": lambda g, a, b: [g.const(1.0)] * 2,
    "sub": lambda g, a, b: [g.const(1.0), g.const(-1.0)],
    "neg": lambda g, a: [g.const(-1.0)],
    "real": lambda g, a: [g.const(1.0)],
    "mul": lambda g, a, b: [b, a],
    "div": _ratio,
    "sin": lambda g, a: [g.node("cos", a)],
    "cos": lambda g, a: [g.node("neg", g.node("sin", a))],
    "sinh": lambda g, a: [g.node("cosh", a)],
    "cosh": lambda g, a: [g.node("sinh", a)],
    "sqrt": lambda g, a: [g.node("div", g.const(0.5), g.node("sqrt", a))],
    "cbrt": lambda g, a: [g.node("div", g.node("cbrt", a), g.node("mul", g.const(3.0), a))],
    "pow": _power,
    "abs": _size,
    "max": _extreme("ge", "le"),
    "min": _extreme("le", "ge"),
    "atan2": _angle,
    "rem": lambda g, a, b: [
        g.const(1.0),
        g.node("neg", g.node("real", g.node("trunc", g.node("div", a, b)))),
    ],
    "sum": lambda g, *a: [g.const(1.0)] * len(a),
    "dot": lambda g, *a: [a[i ^ 1] for i in range(len(a))],
}


def times(g: Graph, a: int, b: int) -> int:
    """A product; factors -1 become ``neg``."""
    if g.value(a) == -1.0:
        return g.node("neg", b)
    return g.node("neg", a) if g.value(b) == -1.0 else g.node("mul", a, b)


def _slopes(g: Graph, number: int) -> list[int]:
    op, *arguments = g.nodes[number]
    if op in SLOPES:
        return [SLOPES[op](g, arguments[0], number)]
    if op not in LOCAL_SLOPES:
        raise TraceError(f"the derivative of {op!r} cannot be written as scalar code")
    return LOCAL_SLOPES[op](g, *arguments)


def along(g: Graph, root: int, rates: Mapping[int, int]) -> int:
    """The derivative of a node when the inputs change at ``rates``."""
    zero = g.const(0.0)
    tangents = dict(rates)
    for number in needed(g, [root]):
        if number not in tangents:
            tangents[number] = _tangent(g, number, tangents, zero)
    return tangents[root]


def _tangent(g: Graph, number: int, tangents: dict[int, int], zero: int) -> int:
    op, *arguments = g.nodes[number]
    if op == "part":
        change = tangents[arguments[0]]
        return zero if change == zero else g.node("part", change, arguments[1])
    if op in ("const", "input") or all(tangents[a] == zero for a in arguments):
        return zero
    if op == "select":
        return g.node("select", arguments[0], *(tangents[a] for a in arguments[1:]))
    if op == "table":
        return g.node("table", *(tangents[a] for a in arguments))
    if op in ("pick", "knot"):
        change = tangents[arguments[0]]
        return zero if change == zero else g.node("pick", change, arguments[1])
    if op == "solve":
        matrix, right, mask = equations(arguments)
        forces = parts(g, number, len(right))
        turns = [[tangents[a] for a in row] for row in matrix]
        moved = [g.dot([*zip(row, forces, strict=True)]) for row in turns]
        pairs = zip(right, moved, strict=True)
        return solved(g, matrix, [g.node("sub", tangents[b], m) for b, m in pairs], mask)
    if op == "foreign":
        return _rates(g, arguments, tangents)
    if op in FLAT:
        return zero
    slopes = zip(_slopes(g, number), arguments, strict=True)
    return g.total([times(g, slope, tangents[a]) for slope, a in slopes if tangents[a] != zero])


def _rates(g: Graph, arguments: Sequence[int], tangents: Mapping[int, int]) -> int:
    """The rates of a foreign call's results: another foreign call."""
    number, *own = arguments
    function = g.called_by(number)
    return g.called(function.rates, [*own, *(tangents[a] for a in own)])


def gradient(g: Graph, root: int, inputs: Sequence[int]) -> list[int]:
    """The partial derivatives of a node by the given inputs (reverse mode)."""
    zero, order = g.const(0.0), needed(g, [root])
    changes = _changing(g, order, inputs)
    adjoints: dict[int, list[int]] = {root: [g.const(1.0)]}
    shares: dict[int, dict[int, list[int]]] = {}
    for number in reversed(order):
        op, *arguments = g.nodes[number]
        if op == "solve":
            _backward(g, number, shares.get(number, {}), adjoints, changes)
            continue
        if op == "foreign":
            _through(g, arguments, shares.get(number, {}), adjoints, changes)
            continue
        size = g.total(adjoints.get(number, []))
        if size == zero or op in ("const", "input"):
            continue
        if op == "part":
            own = shares.setdefault(arguments[0], {})
            own.setdefault(int(g.value(arguments[1])), []).append(size)
        elif op in ("pick", "knot"):
            for i, entry in enumerate(g.nodes[arguments[0]][1:]):
                if entry in changes:
                    here = g.node("eq", arguments[1], g.const(i))
                    adjoints.setdefault(entry, []).append(g.node("select", here, size, zero))
        elif op == "select":
            which, a, b = arguments
            adjoints.setdefault(a, []).append(g.node("select", which, size, zero))
            adjoints.setdefault(b, []).append(g.node("select", which, zero, size))
        elif op not in FLAT:
            for slope, argument in zip(_slopes(g, number), arguments, strict=True):
                if argument in changes:
                    adjoints.setdefault(argument, []).append(times(g, slope, size))
    return [g.total(adjoints.get(i, [])) for i in inputs]


def _changing(g: Graph, order: Sequence[int], inputs: Sequence[int]) -> set[int]:
    """The nodes in ``order`` that depend on the given inputs."""
    found = set(inputs)
    for number in order:
        op, *arguments = g.nodes[number]
        if op not in ("const", "input") and not found.isdisjoint(arguments):
            found.add(number)
    return found


def _backward(
    g: Graph,
    number: int,
    shares: dict[int, list[int]],
    adjoints: dict[int, list[int]],
    changes: set[int],
) -> None:
    """Reverse rule of ``solve``: with ``A' m = s`` for the adjoints ``s`` of the unknowns."""
    matrix, right, mask = equations(g.nodes[number][1:])
    n = len(right)
    columns = [[row[i] for row in matrix] for i in range(n)]
    sizes = [g.total(shares.get(i, [])) for i in range(n)]
    if all(g.value(size) == 0 for size in sizes):
        return
    back = parts(g, solved(g, columns, sizes, mask), n)
    forces = parts(g, number, n)
    for i in range(n):
        adjoints.setdefault(right[i], []).append(back[i])
        for j in range(n):
            if matrix[i][j] in changes:
                change = g.node("neg", g.node("mul", back[i], forces[j]))
                adjoints.setdefault(matrix[i][j], []).append(change)


def _through(
    g: Graph,
    arguments: Sequence[int],
    shares: dict[int, list[int]],
    adjoints: dict[int, list[int]],
    changes: set[int],
) -> None:
    """Reverse rule of a foreign call, by the Jacobian of its results."""
    number, *own = arguments
    sizes = {i: g.total(share) for i, share in shares.items()}
    slopes = g.called(g.called_by(number).slopes, own)
    for place, argument in enumerate(own):
        if argument in changes:
            for i, size in sizes.items():
                slope = g.node("part", slopes, g.const(i * len(own) + place))
                adjoints.setdefault(argument, []).append(times(g, slope, size))


def solved(
    g: Graph, matrix: Sequence[Sequence[int]], right: Sequence[int], mask: Sequence[int]
) -> int:
    """The node of a linear system in the unknowns selected by ``mask``; the others are 0."""
    return g.node("solve", *(a for row in matrix for a in row), *right, *mask)


def parts(g: Graph, number: int, count: int) -> list[int]:
    """The nodes of the unknowns of a system."""
    return [g.node("part", number, g.const(i)) for i in range(count)]


def equations(arguments: Sequence[int]) -> tuple[list[list[int]], list[int], list[int]]:
    """Matrix, right-hand side and mask among the arguments of a ``solve`` node."""
    n = unknowns(len(arguments))
    matrix = [list(arguments[i * n : i * n + n]) for i in range(n)]
    return matrix, list(arguments[n * n : n * n + n]), list(arguments[n * n + n :])


def unknowns(count: int) -> int:
    """Number of unknowns of a ``solve`` node with ``count`` arguments."""
    n = 0
    while n * n + 2 * n < count:
        n += 1
    return n


def degree(graph: Graph, root: int) -> float:
    """Degree of a node as a polynomial in ``t`` and ``x``; infinite if it is not one."""
    found: dict[int, float] = {}
    for number in needed(graph, [root]):
        node = graph.nodes[number]
        below = [found[a] for a in node[1:]] if node[0] not in ("const", "input") else []
        if node[0] == "const" or (node[0] == "input" and node[1][0] == "p"):
            found[number] = 0
        elif node[0] == "input":
            found[number] = 1
        elif node[0] in ("add", "sub", "neg", "real", "sum"):
            found[number] = max(below)
        elif node[0] == "dot":
            found[number] = max(map(sum, zip(below[::2], below[1::2], strict=True)))
        elif node[0] == "select" and below[0] == 0:
            found[number] = max(below[1:])
        elif node[0] == "part":
            found[number] = below[0]
        elif node[0] == "solve" and max(below[: -2 * unknowns(len(below))]) == 0:
            found[number] = max(below)
        elif node[0] == "mul":
            found[number] = sum(below)
        elif node[0] == "div" and below[1] == 0:
            found[number] = below[0]
        else:
            found[number] = 0 if max(below) == 0 else float("inf")
    return found[root]


def node_shape(graph: Graph, root: int) -> tuple[bool, tuple[int, ...]]:
    """Whether a node is affine, and the elements of the state that it depends on."""
    return degree(graph, root) <= 1, tuple(sorted(states_in(graph, root) - {TIME_PLACE}))
