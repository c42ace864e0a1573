"""A proof, from an impact on, that impacts accumulate; and when and where, between bounds.

In a box of time and state the gap's acceleration, the flow, the restitution and the change of
state at an impact are enclosed by ball arithmetic. The lemma (:mod:`.lemma`) then bounds the
remaining time and the sum of the impacts' speeds, these bound how far time and state go, and if
that is less far than the box reaches, no motion from the impact leaves it: the bounds are proved.
Other guards must have no zero in the box. See ``docs/notes/certificates.md``.

The impact's state is taken as it is given. What the integration before it has lost is not part
of the proof.
"""

from __future__ import annotations

from math import inf, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton import trace
from ..scene.graph import Graph
from ..scene.taylor import flat
from .lemma import Chattering, chattering

if TYPE_CHECKING:
    from ..scene import Field

#: Boxes that are tried, and how far a box reaches, against what is needed of it.
TRIES, WIDER = 12, 1.5


@attrs.frozen(eq=False)
class Proof:
    """Proved bounds of an accumulation, from an impact on.

    Attributes
    ----------
    t, speed : float
        The impact: its time and the gap's speed after it.
    m, M : float
        The gap's acceleration stays in ``[-M, -m]``.
    rho : float
        Speeds fall at least by this factor.
    low, high : float
        Bounds of the time of the accumulation.
    x_low, x_high : array
        Bounds of the state there.
    """

    t: float
    speed: float
    m: float
    M: float
    rho: float
    low: float
    high: float
    x_low: np.ndarray
    x_high: np.ndarray


@attrs.frozen(eq=False)
class _Box:
    """A box around an impact: for so long, so far in each element, up to such a gap speed."""

    time: float
    reach: np.ndarray
    speed: float

    def within(self, other: _Box) -> bool:
        """Whether another box reaches as far."""
        far = bool(np.all(self.reach <= other.reach))
        return far and self.time <= other.time and self.speed <= other.speed


def prove(field: Field, contact: str, t: float, x: np.ndarray, v: float) -> Proof | None:
    """Prove that the impacts of a contact accumulate; None where the proof does not succeed.

    Parameters
    ----------
    t, x, v
        Time, state and gap speed after an impact, taken as exact.

    Raises
    ------
    OptionError
        If python-flint is missing.
    """
    from ..scene.interval import Undecided

    box = _Box(0.0, np.zeros(len(x)), 2.0 * v)
    for _ in range(TRIES):
        try:
            bounds = _Bounds(field, contact, t, x, box)
        except Undecided:
            return None
        if not bounds.pushes:
            return None
        says = chattering(v, bounds.m, bounds.M, bounds.r)
        if not says.contracts:
            return None
        needed = bounds.needed(says)
        if needed.within(box):
            return None if bounds.others else _proof(t, x, v, bounds, says, needed)
        box = _Box(WIDER * needed.time, WIDER * needed.reach, WIDER * needed.speed)
    return None


def _proof(
    t: float, x: np.ndarray, v: float, bounds: _Bounds, says: Chattering, needed: _Box
) -> Proof:
    from flint import arb

    from ..scene.balls import high, low

    assert says.remaining is not None
    first, last = says.remaining
    return Proof(
        t,
        v,
        low(bounds.m),
        high(bounds.M),
        high(says.rho),
        low(arb(t) + first),
        high(arb(t) + last),
        np.array([nextafter(a - b, -inf) for a, b in zip(x, needed.reach, strict=True)]),
        np.array([nextafter(a + b, inf) for a, b in zip(x, needed.reach, strict=True)]),
    )


class _Bounds:
    """Enclosures over a box."""

    def __init__(self, field: Field, contact: str, t: float, x: np.ndarray, box: _Box) -> None:
        key = ("proof", field.name, contact)
        program = field.code.once(key, lambda: _program(field, contact))
        n = len(x)
        sides = [
            (nextafter(a - b, -inf), nextafter(a + b, inf))
            for a, b in zip(x.tolist(), box.reach.tolist(), strict=True)
        ]
        times = (t, nextafter(t + box.time, inf))
        values = program(flat(field.parameters), times, sides, u=(-box.speed, 0.0))
        force, self.r, *rest = values
        self.m, self.M = (-force).lower(), (-force).upper()
        self.flow, self.push, guards = rest[:n], rest[n : 2 * n], rest[2 * n :]
        self.others = any(bool(guard.contains(0)) for guard in guards)

    @property
    def pushes(self) -> bool:
        """Whether the gap is accelerated towards zero all over the box."""
        return bool(self.m > 0)

    def needed(self, says: Chattering) -> _Box:
        """How far the motion goes: along the flow, and by the impacts."""
        from ..scene.balls import high

        assert says.remaining is not None
        time = says.remaining[1]
        jumps = (1 + self.r.upper()) * says.speed / (1 - says.rho)
        reach = [
            high(time * abs(f).upper() + jumps * abs(p).upper())
            for f, p in zip(self.flow, self.push, strict=True)
        ]
        return _Box(high(time), np.array(reach), high(says.speed))


def _program(field: Field, contact: str) -> Any:
    """The gap's acceleration, the restitution, the flow, the push, and the other guards."""
    from ..scene.interval import IntervalProgram

    code = field.code
    flow, gap = code.field_closed(field.mode, field.held), code.closed("gap", contact)
    graph = Graph(exact=True)
    inputs = code.inputs(graph)
    lies = code.lie_closed((contact, field.name), gap, flow)
    push = trace.trace(code.spec, code.laws(contact).push, 0, code.shapes)
    edges = [e for e in code.spec.leaving(field.mode) if e.name not in (contact, *field.held)]
    others = [code.guard_closed(edge) for edge in edges]
    others += [code.load_closed(field.held, index) for index in range(len(field.held))]

    def nodes(closed: Any, *extra: Any) -> list[int]:
        (found,) = graph.outputs(closed, [*inputs, *extra])
        return [int(i) for i in found.reshape(-1)]

    law = nodes(code.closed("restitution", contact), np.array(graph.input("u")))
    guards = [node for closed in others for node in nodes(closed)]
    return IntervalProgram(graph, [nodes(lies)[2], *law, *nodes(flow), *nodes(push), *guards])
