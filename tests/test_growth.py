"""Ranges of expressions with inputs that grow without bounds hold all values."""

import random
from contextlib import suppress

import numpy as np
import pytest

from hybrid.bounds.exact import FixedGraph
from hybrid.bounds.growth import GROWING, LOWER, UPPER, Growth, between, growth
from hybrid.lowering.python import Program

ONE = [
    "neg",
    "abs",
    "sin",
    "cos",
    "sqrt",
    "exp",
    "tanh",
    "atan",
    "log",
    "log1p",
    "asinh",
    "cbrt",
    "sign",
    "floor",
    "round",
    "cosh",
    "sinh",
]
TWO = ["add", "sub", "mul", "div", "max", "min", "rem", "atan2"]
POWERS = (2.0, 3.0, -1.0, 0.5, -2.0, 1.5, 0.0)


def expression(graph, draw):
    """A random node of two inputs, and of a few constants."""
    nodes = [graph.input("x0"), graph.input("x1"), *map(graph.const, (0.5, -2.0, 3.0))]
    for _ in range(draw.randint(2, 7)):
        a, b, kind = draw.choice(nodes), draw.choice(nodes), draw.random()
        if kind < 0.45:
            nodes.append(graph.node(draw.choice(ONE), a))
        elif kind < 0.85:
            nodes.append(graph.node(draw.choice(TWO), a, b))
        else:
            nodes.append(graph.node("pow", a, graph.const(draw.choice(POWERS))))
    return nodes[-1]


@pytest.mark.parametrize(("region", "sign"), [(UPPER, 1.0), (LOWER, -1.0), (GROWING, -1.0)])
def test_ranges_hold_the_values_of_random_expressions(region, sign):
    """As far as doubles tell, on the way to where the input is large."""
    draw, told = random.Random(0), 0
    for _ in range(1000):
        graph = FixedGraph(exact=True)
        root = expression(graph, draw)
        found = growth(graph, root, {"x0": region, "x1": between(-1.0, 2.0)})
        values = Program(graph, ["t", "x"], 2, np.array(root)).bind([])
        for size in (0.0, 0.3, 2.5, 1e3, 1e5) if isinstance(found, Growth) else ():
            for other in (-1.0, 0.0, 0.7, 2.0):
                with suppress(ZeroDivisionError):  # of constants alone
                    value, told = values(0.0, [sign * size, other]), told + 1
                    room = 1e-9 * (1.0 + abs(value))  # some roundings
                    assert np.isnan(value) or found.low - room <= value <= found.high + room
    assert told > 5000


def test_a_power_to_the_zero_is_one():
    """Of what is zero, too."""
    graph = FixedGraph(exact=True)
    power = graph.node("pow", graph.input("x0"), graph.const(0.0))
    found = growth(graph, power, {"x0": between(0.0, 0.0)})
    assert (found.low, found.high) == (1.0, 1.0)
