"""Ingredients of Taylor series: slopes of elementary functions, polynomial evaluation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .graph import Graph

#: For y = phi(a) with y' = slope(a, y) a': the slope as a graph expression.
SLOPES: dict[str, Callable[[Graph, int, int], int]] = {
    "exp": lambda g, a, y: y,
    "exp2": lambda g, a, y: g.node("mul", g.const(math.log(2.0)), y),
    "expm1": lambda g, a, y: g.node("add", y, g.const(1.0)),
    "log": lambda g, a, y: g.node("div", g.const(1.0), a),
    "log1p": lambda g, a, y: g.node("div", g.const(1.0), g.node("add", g.const(1.0), a)),
    "tan": lambda g, a, y: g.node("add", g.const(1.0), g.node("mul", y, y)),
    "tanh": lambda g, a, y: g.node("sub", g.const(1.0), g.node("mul", y, y)),
    "logistic": lambda g, a, y: g.node("mul", y, g.node("sub", g.const(1.0), y)),
    "asin": lambda g, a, y: g.node("div", g.const(1.0), _root(g, a, "sub")),
    "acos": lambda g, a, y: g.node("div", g.const(-1.0), _root(g, a, "sub")),
    "asinh": lambda g, a, y: g.node("div", g.const(1.0), _root(g, a, "add")),
    "acosh": lambda g, a, y: g.node(
        "div", g.const(1.0), g.node("sqrt", g.node("sub", g.node("mul", a, a), g.const(1.0)))
    ),
    "atan": lambda g, a, y: g.node("div", g.const(1.0), _one(g, a, "add")),
    "atanh": lambda g, a, y: g.node("div", g.const(1.0), _one(g, a, "sub")),
    "erf": lambda g, a, y: _bell(g, a, 2.0),
    "erfc": lambda g, a, y: _bell(g, a, -2.0),
}


def _one(g: Graph, a: int, sign: str) -> int:
    return g.node(sign, g.const(1.0), g.node("mul", a, a))


def _root(g: Graph, a: int, sign: str) -> int:
    return g.node("sqrt", _one(g, a, sign))


def _bell(g: Graph, a: int, factor: float) -> int:
    power = g.node("exp", g.node("neg", g.node("mul", a, a)))
    return g.node("mul", g.const(factor / math.sqrt(math.pi)), power)


def polynomial(coefficients: Sequence[float], s: float) -> float:
    """The value of ``sum_k c_k s^k`` (Horner's rule)."""
    value = 0.0
    for c in reversed(coefficients):
        value = value * s + c
    return value


def flat(parameters: Sequence[Any]) -> list[float]:
    """All elements of the parameters as one list of floats."""
    return [v for p in parameters for v in np.asarray(p, dtype=float).ravel().tolist()]
