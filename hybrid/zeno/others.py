"""Bounds on the guards of other edges over boxes that contain a motion.

A sum of impacts, or the limit of a cycle, stands for infinitely many flights along which no guard
is watched. Bounds over boxes that contain all flights find any zero of a guard, however brief.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from ..bounds.exact import FixedGraph
from ..errors import TraceError
from ..lowering.jaxpr import read
from ..rules.zeros import EPS
from .accumulate import Tail
from .narrow import Stretch, named, parameters

if TYPE_CHECKING:
    from ..lowering import Field


#: How often a tail is halved, at most, in search of zeros of other guards: some four halvings lead
#: to single flights, and the others to 1/32 of a flight. (With seven halvings more, a pile of two
#: balls took twenty times as long: near a guard that is zero at the limit, many parts stay
#: undecided.)
OTHERS_HALVINGS = 9


def apart(tail: Tail) -> bool:
    """Whether bounds show that no other guard is zero between the first impact and the limit.

    A guard that is zero at the limit is not bounded in the last flights.
    """
    field, t_inf, x_inf = tail.field, tail.t + tail.remaining, tail.x_inf.tolist()
    others = [i for i in range(len(field.guards)) if i != tail.column]
    rounding = 64 * EPS * float(np.max(np.abs(tail.x_inf)))
    last = [i for i in others if abs(field.guards[i].value(t_inf, x_inf)) > rounding]
    stretches = [(OTHERS_HALVINGS, Stretch(tail))] if others else []
    while stretches:
        left, stretch = stretches.pop()
        ending = not left and stretch.last == inf
        if not excluded(field, last if ending else others, stretch.box()):
            if not left:
                return False
            stretches += [(left - 1, half) for half in stretch.halves()]
    return True


def excluded(field: Field, columns: Iterable[int], box: Mapping[str, Any]) -> bool:
    """Whether bounds exclude a zero of the given guards in a box of time and states.

    Guards without bounds are ignored.
    """
    looks = field.code.once(("bounded guards", field.name), lambda: _looks(field))
    whole = {**parameters(field), **box}
    return all(looks[i] is None or looks[i].excludes_zero(whole) for i in columns)


def hull(points: np.ndarray, wider: float) -> dict[str, Any]:
    """The bounding box of rows of time and state, widened on each side by a fraction."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = wider * (high - low)
    times, *states = zip((low - room).tolist(), (high + room).tolist(), strict=True)
    return {"t": times, **named("x", states)}


def _looks(field: Field) -> list[Any]:
    """The interval program of each guard of a field; None for a guard without bounds."""
    if find_spec("flint") is None:
        return [None] * len(field.guards)
    from ..bounds.interval import IntervalProgram

    graph = FixedGraph(exact=True)
    inputs = field.code.inputs(graph)
    looks: list[Any] = []
    for guard in field.guards:
        try:
            (found,) = read(graph, guard.closed, inputs)
            looks.append(IntervalProgram(graph, [int(found.reshape(()))]))
        except TraceError:
            looks.append(None)
    return looks
