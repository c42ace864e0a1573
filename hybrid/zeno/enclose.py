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
from ..scene.fixed import FixedGraph, hides_derivatives
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
    from flint import ctx

    from ..scene.interval import PRECISION, require_flint

    require_flint()
    program = field.code.once(("proof", field.name, contact), lambda: _program(field, contact))
    if program is None:
        return None
    with ctx.workprec(PRECISION):
        return _prove(program, flat(field.parameters), float(t), x, float(v))


def _prove(program: Any, parameters: Any, t: float, x: np.ndarray, v: float) -> Proof | None:
    box = _Box(0.0, np.zeros(len(x)), 2.0 * v)
    for _ in range(TRIES):
        bounds = _Bounds(program, parameters, t, x, box)
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

    def __init__(self, program: Any, parameters: Any, t: float, x: np.ndarray, box: _Box) -> None:
        n, low, high = len(x), x - box.reach, x + box.reach
        inputs: dict[str, Any] = {f"p{i}": value for i, value in enumerate(parameters)}
        inputs |= {
            f"x{i}": (nextafter(a, -inf), nextafter(b, inf))
            for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True))
        }
        inputs |= {"t": (t, nextafter(t + box.time, inf)), "u": (-box.speed, 0.0)}
        found = program.enclose(inputs)
        gap, speed, *rest = found
        self.sound = all(e.defined for e in found) and gap.continuous and speed.continuous
        if not self.sound:
            return
        force, self.r, *values = [e.value for e in rest]
        self.m, self.M = (-force).lower(), (-force).upper()
        self.flow, self.push = values[:n], values[n : 2 * n]
        self.others = any(bool(guard.contains(0)) for guard in values[2 * n :])

    @property
    def pushes(self) -> bool:
        """Whether all is defined on the box, and the gap accelerated towards zero all over it."""
        return self.sound and bool(self.m > 0)

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
    """Gap, its two derivatives, restitution, flow, push, and the other guards, as balls.

    None where the flow or the gap holds a derivative back.
    """
    from ..scene.interval import IntervalProgram

    code = field.code
    flow, gap = code.field_closed(field.mode, field.held), code.closed("gap", contact)
    if hides_derivatives(flow) or hides_derivatives(gap):
        return None
    push = trace.trace(code.spec, code.laws(contact).push, 0, code.shapes)
    others = [guard.closed for guard in field.guards if guard.edge != contact]
    graph = FixedGraph(exact=True)
    inputs = code.inputs(graph)

    def nodes(closed: Any, *extra: Any) -> list[int]:
        (found,) = graph.outputs(closed, [*inputs, *extra])
        return [int(i) for i in found.reshape(-1)]

    lies = nodes(code.lie_closed((contact, field.name), gap, flow))
    law = nodes(code.closed("restitution", contact), np.array(graph.input("u")))
    guards = [node for closed in others for node in nodes(closed)]
    return IntervalProgram(graph, [*lies, *law, *nodes(flow), *nodes(push), *guards])
