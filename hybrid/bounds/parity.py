"""Proofs that a traced expression is even or odd in some of its inputs.

Every expression has a normal form up to sign, ``(sign, term)``: arguments of sums, products and
maxima are sorted and signs are moved outward (``sin(-a) = -sin(a)``, ``cos(-a) = cos(a)``). The
expression is normalised with the inputs and with their negatives. Equal normal forms prove that it
is even, opposite ones that it is odd; any other outcome proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Literal

from ..lowering.graph import Graph, needed

Parity = Literal["even", "odd", "unknown"]

#: A sign, +1 or -1, and an index into the table of terms.
Signed = tuple[int, int]

ODD_FUNCTIONS = {
    *("sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "cbrt", "erf"),
    *("sign", "round", "away", "trunc"),
}
EVEN_FUNCTIONS = {"cos", "cosh", "abs", "is_finite"}

#: Commutative operations.
SYMMETRIC = {"eq", "ne", "and", "or", "xor"}

#: Tests that are equal to others with their arguments exchanged.
SWAPPED = {"lt": "gt", "le": "ge"}


def parity(graph: Graph, root: int, flipped: Collection[str]) -> Parity:
    """Whether a node is even or odd when all the flipped inputs change sign together.

    Parameters
    ----------
    flipped : collection of str
        Names of the inputs that change sign.

    Returns
    -------
    "even", "odd" or "unknown"
        The first two are proofs, in real arithmetic; ``"unknown"`` means that no proof was found.
        An expression that is identically zero counts as even.
    """
    forms = _Forms(graph)
    plain, turned = forms.of(root, frozenset()), forms.of(root, frozenset(flipped))
    if plain == turned:
        return "even"
    return "odd" if plain == (-turned[0], turned[1]) else "unknown"


class _Forms:
    """Normal forms of expressions, with a table of terms in which equal terms share an entry."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.terms: dict[Any, int] = {}
        self.zero = self.term("const", 0.0, "float")

    def of(self, root: int, flipped: frozenset[str]) -> Signed:
        """The normal form of a node, with the signs of the inputs ``flipped`` changed."""
        known: dict[int, Signed] = {}
        for number in needed(self.graph, [root]):
            op, *arguments = self.graph.nodes[number]
            if op == "input":
                sign = -1 if arguments[0] in flipped else 1
                known[number] = (sign, self.term("input", arguments[0]))
            elif op == "const":
                known[number] = self.constant(arguments[0])
            else:
                known[number] = self.signed(op, [known[a] for a in arguments])
        return known[root]

    def term(self, *key: Any) -> int:
        return self.terms.setdefault(key, len(self.terms))

    def constant(self, value: Any) -> Signed:
        if isinstance(value, bool):
            return 1, self.term("const", value, "bool")
        return (-1 if value < 0 else 1), self.term("const", abs(value), "float")

    def signed(self, op: str, args: list[Signed]) -> Signed:
        sign, term = self.rule(op)(op, args)
        return (1, term) if term == self.zero else (sign, term)

    def rule(self, op: str) -> Callable[[str, list[Signed]], Signed]:
        rules: dict[str, Callable[[str, list[Signed]], Signed]] = {
            "neg": lambda op, a: (-a[0][0], a[0][1]),
            "add": self.sum,
            "sub": lambda op, a: self.sum("add", [a[0], self.minus(a[1])]),
            "mul": self.product,
            "div": lambda op, a: (a[0][0] * a[1][0], self.term("div", a[0][1], a[1][1])),
            "max": self.larger,
            "min": self.smaller,
            "rem": lambda op, a: (a[0][0], self.term("rem", a[0][1], a[1][1])),
            "pow": self.power,
            "ceil": lambda op, a: self.ceiling(a[0]),
            "select": self.choice,
            **dict.fromkeys(ODD_FUNCTIONS, lambda op, a: (a[0][0], self.term(op, a[0][1]))),
            **dict.fromkeys(EVEN_FUNCTIONS, lambda op, a: (1, self.term(op, a[0][1]))),
            **dict.fromkeys(("gt", "ge", "lt", "le"), self.test),
        }
        return rules.get(op, self.opaque)

    def opaque(self, op: str, args: list[Signed]) -> Signed:
        if op in ("eq", "ne") and args[0][0] < 0:
            args = [self.minus(a) for a in args]
        return 1, self.term(op, *(sorted(args) if op in SYMMETRIC else args))

    def minus(self, a: Signed) -> Signed:
        return a if a[1] == self.zero else (-a[0], a[1])

    def sum(self, op: str, args: list[Signed]) -> Signed:
        first, second = sorted(args, key=lambda a: a[1])
        if self.zero in (first[1], second[1]):
            return second if first[1] == self.zero else first
        if first[1] == second[1] and first[0] != second[0]:
            return 1, self.zero
        return first[0], self.term("add", first[1], (first[0] * second[0], second[1]))

    def product(self, op: str, args: list[Signed]) -> Signed:
        (s, a), (r, b) = args
        if self.zero in (a, b):
            return 1, self.zero
        return s * r, self.term("mul", *sorted((a, b)))

    def larger(self, op: str, args: list[Signed]) -> Signed:
        return 1, self.term("max", *sorted(args))

    def smaller(self, op: str, args: list[Signed]) -> Signed:
        return self.minus(self.larger("max", [self.minus(a) for a in args]))

    def ceiling(self, argument: Signed) -> Signed:
        return -1, self.term("floor", self.minus(argument))

    def power(self, op: str, args: list[Signed]) -> Signed:
        (sign, base), exponent = args
        key = list(self.terms)[exponent[1]]
        if key[0] == "const" and float(key[1]).is_integer():
            return (sign if key[1] % 2 else 1), self.term("pow", base, exponent)
        return 1, self.term("pow", *args)

    def test(self, op: str, args: list[Signed]) -> Signed:
        if op in SWAPPED:
            op, args = SWAPPED[op], args[::-1]
        a, b = args
        if a[0] < 0:
            a, b = self.minus(b), self.minus(a)
        return 1, self.term(op, a, b)

    def choice(self, op: str, args: list[Signed]) -> Signed:
        test, yes, no = args
        if yes == no:
            return yes
        sign = no[0] if yes[1] == self.zero else yes[0]
        if sign < 0:
            yes, no = self.minus(yes), self.minus(no)
        return sign, self.term("select", test, yes, no)
