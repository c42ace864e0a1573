"""Taylor coefficients of a flow as code written out order by order: what the tape is held against.

The same recurrences as those of :mod:`hybrid.lowering.recorder` (``docs/notes/tape.md``), written
another way. Where a model switches formula (``abs``, ``where``, ``max``), the coefficients belong
to the branch at the start. The function that decides is returned too, as a *kink*: the series holds
up to its first zero.
"""

import math

from hybrid.errors import TraceError
from hybrid.lowering.graph import Graph, needed
from hybrid.lowering.jaxpr import read
from hybrid.lowering.python import _fixed, _index, literal
from hybrid.lowering.taylor import SLOPES

#: Operations whose two or three cases meet at a kink.
KINKED = {"gt", "ge", "lt", "le"}
LOGIC = {"and", "or", "xor", "not", "eq", "ne", "is_finite"}


def written(code, flow, functions, order, operations):
    """The Taylor code of a flow, and of a vector along it; both are jaxprs."""
    graph = Graph()
    inputs = code.inputs(graph)
    (states,), (values,) = read(graph, flow, inputs), read(graph, functions, inputs)
    size, functions = code.spec.dimension, list(map(int, values))
    return TaylorProgram(graph, size, states, functions, order, operations)


class TaylorProgram:
    """Generated code for the Taylor coefficients of a flow and of functions along it.

    The bound function is ``jets(t, x)`` and returns ``(states, values, kinks)``: for each state,
    each function and each kink the list of its coefficients 0 .. ``order``. ``operations`` are
    functions by name. The branch is taken by value.
    """

    def __init__(self, graph, size, flow, functions, order, operations):
        self.order = order
        writer = _Writer(graph, size, [int(i) for i in flow], list(functions), order)
        self.source, self.kinks = writer.source(), len(writer.kinks)
        self._code = compile(self.source, "<hybrid: generated Taylor series>", "exec")
        self._operations = operations
        self._maker = None

    def bind(self, parameters):
        """The function for these values of the (flattened) parameters."""
        if self._maker is None:
            scope = {f"_{name}": call for name, call in self._operations.items()}
            scope.update(_inf=math.inf, _nan=math.nan)
            exec(self._code, scope)
            self._maker = scope["_make"]
        return self._maker(*parameters)


class _Writer:
    """Writes the recurrences. ``c[node]`` lists the names of a node's coefficients."""

    def __init__(self, graph, size, flow, functions, order):
        self.graph, self.size, self.flow, self.functions = graph, size, flow, functions
        self.order = order
        roots = [*flow, *functions]
        self.slope = self._add_slopes(roots)
        everything = [*roots, *self.slope.values()]
        self.nodes = needed(graph, everything)
        self.fixed = _fixed(graph, self.nodes)
        self.steady = self._steady()
        self.kinks = []
        self.c = {number: [] for number in self.nodes}
        self.partners = {}
        self.lines = []

    def _add_slopes(self, roots):
        slope = {}
        frontier = list(roots)
        while True:
            new = [n for n in needed(self.graph, frontier) if n not in slope]
            new = [n for n in new if self.graph.nodes[n][0] in SLOPES]
            if not new:
                return slope
            for number in new:
                op, argument = self.graph.nodes[number]
                slope[number] = SLOPES[op](self.graph, argument, number)
                frontier.append(slope[number])

    def _steady(self):
        """Nodes that are constant along the flow: all coefficients but the first vanish."""
        steady = set(self.fixed)
        moving = {"x", "t"}
        for number in self.nodes:
            node = self.graph.nodes[number]
            if node[0] == "const":
                steady.add(number)
            elif node[0] == "input":
                if node[1][0] not in moving:
                    steady.add(number)
            elif all(a in steady for a in node[1:]):
                steady.add(number)
        return steady

    # -- the generated function ---------------------------------------------------------

    def source(self):
        for number in self.nodes:
            node = self.graph.nodes[number]
            if node[0] == "input":
                self.c[number] = [node[1]]
        states = [[f"x{i}"] for i in range(self.size)]
        named = {n[1]: i for i, n in enumerate(self.graph.nodes) if n[0] == "input"}
        for k in range(self.order + 1):
            begun = len(self.lines)
            for number in self.nodes:
                self._coefficient(number, k)
            self._close_order(begun)
            if k == self.order:
                break
            for i, number in enumerate(self.flow):
                name = self._assign(f"{self._at(number, k)} * {1.0 / (k + 1)!r}", f"x{i}_{k + 1}")
                states[i].append(name)
                if f"x{i}" in named and named[f"x{i}"] in self.c:
                    self.c[named[f"x{i}"]].append(name)
        kinks = [self._kink_series(a, b) for a, b in self.kinks]
        result = [states, [self._series(n) for n in self.functions], kinks]
        parts = ["[" + ", ".join(f"[{', '.join(row)}]" for row in block) + "]" for block in result]
        inputs = [n[1] for n in self.graph.nodes if n[0] == "input" and n[1][0] == "p"]
        count = 1 + max(map(_index, inputs), default=-1)
        head = "".join(f"p{i}, " for i in range(count))
        unpack = "".join(f"x{i}, " for i in range(self.size)) + "= x"
        body = [unpack, *self.lines, f"return {', '.join(parts)}"]
        lines = [f"def _make({head}*_rest):", "    def jets(t, x):"]
        lines += [f"        {line}" for line in body]
        return "\n".join([*lines, "    return jets", ""])

    def _close_order(self, begun):
        """Each coefficient is computed once: XLA would write it out wherever it is used."""
        names = ", ".join(line.partition(" = ")[0] for line in self.lines[begun:])
        if names:
            self.lines.append(f"{names}, = _barrier(({names},))")

    def _series(self, number):
        return [self._at(number, k) for k in range(self.order + 1)]

    def _kink_series(self, a, b):
        return [f"{self._at(a, k)} - {self._at(b, k)}" for k in range(self.order + 1)]

    def _at(self, number, k):
        if k and number in self.steady:
            return "0.0"
        if self.graph.nodes[number][0] == "const":
            value = self.graph.value(number)
            return literal(float(value) if not isinstance(value, bool) else value)
        return self.c[number][k] if k < len(self.c[number]) else "0.0"

    def _assign(self, expression, name):
        if expression in ("0.0", "0.0 * 1.0") or expression.startswith("0.0 * "):
            return "0.0"
        self.lines.append(f"{name} = {expression}")
        return name

    def _coefficient(self, number, k):
        node = self.graph.nodes[number]
        if node[0] == "const" or (k and number in self.steady):
            return
        if node[0] == "input":
            if node[1] == "t" and k == 1:
                self.c[number].append("1.0")
            elif node[1] == "t" and k > 1:
                self.c[number].append("0.0")
            return
        expression = self._first(number, node) if k == 0 else self._next(number, node, k)
        self.c[number].append(self._assign(expression, f"n{number}_{k}"))

    # -- order 0 ------------------------------------------------------------------------

    def _first(self, number, node):
        op, arguments = node[0], [self._at(a, 0) for a in node[1:]]
        if op in KINKED and not all(a in self.steady for a in node[1:]):
            return self._side(node[1], node[2], op)
        if op in ("abs", "max", "min", "sign") and number not in self.steady:
            return self._choice(op, node)
        if op in ("floor", "ceil", "trunc", "rem", "round", "away") and number not in self.steady:
            raise TraceError(
                f"{op!r} of something that moves has no Taylor series in compiled runs; "
                "declare an edge where it jumps"
            )
        return f"_{op}({', '.join(arguments)})"

    def _side(self, a, b, op):
        """A comparison, whose sides meet at a kink."""
        if (a, b) not in self.kinks:
            self.kinks.append((a, b))
        return f"_{op}({self._at(a, 0)}, {self._at(b, 0)})"

    def _choice(self, op, node):
        """abs, sign, max and min by the sign of a difference, kept under its own name."""
        a = node[1]
        b = node[2] if op in ("max", "min") else self.graph.const(0.0)
        self.lines.append(f"{self._flag(node)} = {self._side(a, b, 'ge')}")
        return self._chosen(op, node, 0)

    def _flag(self, node):
        return f"side_{node[0]}_" + "_".join(map(str, node[1:]))

    def _chosen(self, op, node, k):
        flag, a = self._flag(node), self._at(node[1], k)
        if op == "sign":
            return self._if(flag, "1.0", "-1.0") if k == 0 else "0.0"
        if op == "abs":
            return self._if(flag, a, f"-{a}")
        b = self._at(node[2], k)
        return self._if(flag, a, b) if op == "max" else self._if(flag, b, a)

    @staticmethod
    def _if(flag, a, b):
        return f"_select({flag}, {a}, {b})"

    # -- order k ------------------------------------------------------------------------

    def _next(self, number, node, k):
        op, args = node[0], node[1:]
        if op in ("add", "sub"):
            return self._sum(op, self._at(args[0], k), self._at(args[1], k))
        if op == "neg":
            return self._negative(self._at(args[0], k))
        if op == "real":
            return self._at(args[0], k)
        if op == "mul":
            return self._product(args[0], args[1], k)
        if op == "div":
            return self._quotient(number, args[0], args[1], k)
        if op == "select":
            a, b = self._at(args[1], k), self._at(args[2], k)
            return a if a == b else self._if(self._at(args[0], 0), a, b)
        if op in ("abs", "max", "min", "sign"):
            return self._chosen(op, node, k)
        if op in ("sin", "cos", "sinh", "cosh"):
            return self._circular(op, args[0], k)
        if op in ("sqrt", "cbrt", "pow"):
            return self._power(number, op, args, k)
        if op in SLOPES:
            return self._chain(args[0], self.slope[number], k)
        if op in KINKED | LOGIC:
            return "0.0"
        raise TraceError(f"no Taylor series for the operation {op!r}")

    @staticmethod
    def _sum(op, a, b):
        if b == "0.0":
            return a
        if a == "0.0":
            return b if op == "add" else f"-{b}"
        return f"{a} {'+' if op == 'add' else '-'} {b}"

    @staticmethod
    def _negative(a):
        return a if a == "0.0" else f"-{a}"

    @staticmethod
    def _terms(terms):
        kept = [f"{a} * {b}" for a, b in terms if "0.0" not in (a, b)]
        return " + ".join(kept) or "0.0"

    def _product(self, a, b, k):
        if a == b:
            half = [(self._at(a, i), self._at(a, k - i)) for i in range((k + 1) // 2)]
            square = self._terms(half)
            double = f"2.0 * ({square})" if square != "0.0" else "0.0"
            middle = self._terms([(self._at(a, k // 2),) * 2]) if k % 2 == 0 else "0.0"
            return self._sum("add", double, middle)
        return self._terms([(self._at(a, i), self._at(b, k - i)) for i in range(k + 1)])

    def _quotient(self, y, a, b, k):
        rest = self._terms([(self._at(b, i), self._at(y, k - i)) for i in range(1, k + 1)])
        top = self._at(a, k)
        if rest == "0.0":
            return "0.0" if top == "0.0" else f"{top} / {self._at(b, 0)}"
        return f"({top} - ({rest})) / {self._at(b, 0)}"

    def _chain(self, a, slope, k):
        terms = [(self._at(a, i), self._at(slope, k - i), i / k) for i in range(1, k + 1)]
        kept = [f"{w!r} * {x} * {h}" for x, h, w in terms if "0.0" not in (x, h)]
        return " + ".join(kept) or "0.0"

    def _circular(self, op, a, k):
        """sin and cos (and the hyperbolic pair) need each other's coefficients."""
        pair = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}[op]
        name = f"{pair}_{a}"
        cached = self.partners.setdefault(name, [])
        if not cached:
            cached.append(self._assign(f"_{pair}({self._at(a, 0)})", f"{name}_0"))
        own = self.graph._known[(op, a)]
        partner = self.graph._known.get((pair, a))
        if partner in self.c:
            cached = self.c[partner]
        while len(cached) < k:
            m = len(cached)
            sign = -1.0 if pair == "cos" else 1.0
            cached.append(self._assign(self._weighted(a, self.c[own], m, sign), f"{name}_{m}"))
        return self._weighted(a, cached, k, -1.0 if op == "cos" else 1.0)

    def _weighted(self, a, other, k, sign):
        terms = [(self._at(a, i), other[k - i], sign * i / k) for i in range(1, k + 1)]
        kept = [f"{w!r} * {x} * {h}" for x, h, w in terms if "0.0" not in (x, h)]
        return " + ".join(kept) or "0.0"

    def _power(self, y, op, args, k):
        """y = a^p by ``a y' = p a' y``: y_k = sum_i (p i - (k - i)) a_i y_{k-i} / (k a_0)."""
        a = args[0]
        p = {"sqrt": "0.5", "cbrt": literal(1 / 3)}.get(op) or self._at(args[1], 0)
        terms = [
            f"({p} * {i} - {k - i}) * {self._at(a, i)} * {self._at(y, k - i)}"
            for i in range(1, k + 1)
            if "0.0" not in (self._at(a, i), self._at(y, k - i))
        ]
        return f"({' + '.join(terms)}) / ({k} * {self._at(a, 0)})" if terms else "0.0"
