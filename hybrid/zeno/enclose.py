"""Proves that the impacts following a given one accumulate, with bounds on time and state.

Ball arithmetic encloses the gap's acceleration, the flow, the restitution and the change of state
at an impact over a box of time and state. The lemma (:mod:`.lemma`) then bounds the remaining time
and the sum of the impact speeds, and these bound how far time and state move. If they move by less
than the size of the box, no motion from the impact leaves the box, and the bounds are proved.
Other guards must have no zero in the box. See ``docs/notes/certificates.md``.

The state at the impact is taken as exact: errors of the integration before it are not part of the
proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton import trace
from ..bounds.exact import FixedGraph, hides_derivatives
from ..bounds.parity import parity
from ..errors import TraceError
from ..lowering.derivatives import along, gradient
from ..lowering.graph import TIME_PLACE, inputs_of, states_in
from ..lowering.jaxpr import read
from ..lowering.taylor import flat
from .lemma import Chattering, chattering

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector
    from ..lowering import Field

#: Most boxes tried, and the size of a box relative to that which the bounds on the previous one
#: require.
BOX_TRIES, BOX_REACH = 12, 1.5


@attrs.frozen(eq=False)
class Proof:
    """Proved bounds on an accumulation, from one impact on.

    Attributes
    ----------
    t, speed : float
        Time of the impact, and gap speed after it.
    m, M : float
        The gap's acceleration stays in ``[-M, -m]``.
    rho : float
        Upper bound on the ratio of successive speeds.
    low, high : float
        Bounds on the time of the accumulation.
    x_low, x_high : array
        Bounds on the state at the accumulation.
    """

    t: float
    speed: float
    m: float
    M: float
    rho: float
    low: float
    high: float
    x_low: Numbers
    x_high: Numbers


@attrs.frozen(eq=False)
class _Box:
    """A box around an impact: duration, half-width per state element, largest gap speed."""

    time: float
    reach: Numbers
    speed: float

    def within(self, other: _Box) -> bool:
        """Whether the other box contains this one."""
        far = bool(np.all(self.reach <= other.reach))
        return far and self.time <= other.time and self.speed <= other.speed


def prove(field: Field, contact: str, t: float, x: StateVector, v: float) -> Proof | None:
    """Prove that the impacts of a contact accumulate.

    Parameters
    ----------
    t, x, v
        Time, state and gap speed after an impact, taken as exact.

    Returns
    -------
    Proof or None
        None if the proof fails.

    Raises
    ------
    OptionError
        If python-flint is missing.
    """
    from flint import ctx

    from ..bounds.interval import PRECISION, require_flint

    require_flint()
    question = field.code.once(("proof", field.name, contact), lambda: _question(field, contact))
    if question is None:
        return None
    with ctx.workprec(PRECISION):
        return _prove(question, flat(field.parameters), float(t), x, float(v))


def _prove(
    question: _Question, parameters: Any, t: float, x: StateVector, v: float
) -> Proof | None:
    box = _Box(0.0, np.zeros(len(x)), 2.0 * v)
    for _ in range(BOX_TRIES):
        bounds = _Bounds(question, parameters, t, x, box)
        if not bounds.pushes:
            return None
        says = chattering(v, bounds.m, bounds.M, bounds.r, bounds.even)
        if not says.contracts:
            return None
        needed = bounds.needed(says)
        if needed.within(box):
            return None if bounds.others else _proof(t, x, v, bounds, says, needed)
        box = _Box(BOX_REACH * needed.time, BOX_REACH * needed.reach, BOX_REACH * needed.speed)
    return None


def _proof(
    t: float, x: StateVector, v: float, bounds: _Bounds, says: Chattering, needed: _Box
) -> Proof:
    from flint import arb

    from ..bounds.balls import high, low

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


@attrs.frozen(eq=False)
class _Question:
    """The functions of a contact that a proof encloses.

    Attributes
    ----------
    program : IntervalProgram
        Its roots: the gap and its two Lie derivatives, the restitution, the flow, the change of
        state per change of gap speed, the slopes of gap and gap speed, the other guards.
    pair : (int, int) or None
        The one position and one velocity on which, with time, the gap and its speed depend.
    even : bool
        Whether the gap's acceleration depends on that pair only, not on time, and is even in the
        velocity.
    """

    program: Any
    pair: tuple[int, int] | None
    even: bool


class _Bounds:
    """Enclosures of the functions of a contact over a box."""

    def __init__(
        self, question: _Question, parameters: Any, t: float, x: StateVector, box: _Box
    ) -> None:
        n, low, high = len(x), x - box.reach, x + box.reach
        inputs: dict[str, Any] = {f"p{i}": value for i, value in enumerate(parameters)}
        inputs |= {
            f"x{i}": (nextafter(a, -inf), nextafter(b, inf))
            for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True))
        }
        inputs |= {"t": (t, nextafter(t + box.time, inf)), "u": (-box.speed, 0.0)}
        found = question.program.enclose(inputs)
        self.pair, count = question.pair, GAP_SLOPES if question.pair else 0
        slopes = found[4 + 2 * n : 4 + 2 * n + count]
        del found[4 + 2 * n : 4 + 2 * n + count]
        gap, speed, *rest = found
        self.sound = all(e.defined for e in found) and gap.continuous and speed.continuous
        if not self.sound:
            return
        self.slopes = [e.value for e in slopes] if all(e.defined for e in slopes) else []
        force, self.r, *values = [e.value for e in rest]
        self.m, self.M = (-force).lower(), (-force).upper()
        self.flow, self.push = values[:n], values[n : 2 * n]
        one_way = bool(self.slopes) and bool(abs(self.slopes[1]).lower() > 0)
        self.even = question.even and one_way
        self.others = any(bool(guard.contains(0)) for guard in values[2 * n :])

    @property
    def pushes(self) -> bool:
        """Whether all functions are defined, and the gap's acceleration negative, on the box."""
        return self.sound and bool(self.m > 0)

    def needed(self, says: Chattering) -> _Box:
        """The box that contains the motion: the reach of the flow plus that of the impacts."""
        from ..bounds.balls import high

        assert says.remaining is not None
        time = says.remaining[1]
        jumps = (1 + self.r.upper()) * says.speed / (1 - says.rho)
        reach = [
            time * abs(f).upper() + jumps * abs(p).upper()
            for f, p in zip(self.flow, self.push, strict=True)
        ]
        for place, near in self._near(says, time):
            reach[place] = min(reach[place], near)
        return _Box(high(time), np.array([high(far) for far in reach]), high(says.speed))

    def _near(self, says: Chattering, time: Any) -> Iterator[tuple[int, Any]]:
        """Bounds on the changes of position and velocity, from those of gap and gap speed; pairs of
        state index and bound."""
        if not self.slopes:
            return
        assert self.pair is not None
        gap_t, gap_x, speed_t, speed_x, speed_v = self.slopes
        if not (abs(gap_x).lower() > 0 and abs(speed_v).lower() > 0):
            return
        far = (says.height + time * abs(gap_t).upper()) / abs(gap_x).lower()
        yield self.pair[0], far
        turn = 2 * says.speed + time * abs(speed_t).upper() + far * abs(speed_x).upper()
        yield self.pair[1], turn / abs(speed_v).lower()


#: Number of derivatives of gap and gap speed by time, position and velocity.
GAP_SLOPES = 5


def _question(field: Field, contact: str) -> _Question | None:
    """The functions of a contact as a program of ball arithmetic.

    None if the flow or the gap hides a derivative, or an operation has no ball arithmetic.
    """
    from ..bounds.interval import IntervalProgram

    code = field.code
    flow, gap = code.field_closed(field.mode, field.held), code.closed("gap", contact)
    if hides_derivatives(flow) or hides_derivatives(gap):
        return None
    push = trace.trace(code.spec, code.laws(contact).push, 0, code.shapes)
    others = [guard.closed for guard in field.guards if guard.edge != contact]
    graph = FixedGraph(exact=True)
    inputs = code.inputs(graph)

    def nodes(closed: Any, *extra: Any) -> list[int]:
        (found,) = read(graph, closed, [*inputs, *extra])
        return [int(i) for i in found.reshape(-1)]

    (height,), rates = nodes(gap), nodes(flow)
    time, states = int(inputs[-2]), [int(i) for i in inputs[-1]]
    moving = {time: graph.const(1.0), **dict(zip(states, rates, strict=True))}
    speed = along(graph, height, moving)
    lies = [height, speed, along(graph, speed, moving)]
    law = nodes(code.closed("restitution", contact), np.array(graph.input("u")))
    pair = _pair(field, contact, graph, lies)
    slopes = _slopes(graph, lies, [time, *(states[i] for i in pair)]) if pair else []
    guards = [node for closed in others for node in nodes(closed)]
    roots = [*lies, *law, *rates, *nodes(push), *slopes, *guards]
    try:
        return _Question(IntervalProgram(graph, roots), pair, _even(graph, lies, pair))
    except TraceError:
        return None


def _even(graph: FixedGraph, lies: list[int], pair: tuple[int, int] | None) -> bool:
    """Whether the gap's acceleration depends on the pair only, and evenly on the velocity."""
    if pair is None:
        return False
    names = {name for name in inputs_of(graph, lies) if name[0] != "p"}
    position, velocity = (f"x{i}" for i in pair)
    if not names <= {position, velocity}:
        return False
    odd = parity(graph, lies[1], {velocity}) == "odd"
    return odd and parity(graph, lies[2], {velocity}) == "even"


def _pair(field: Field, contact: str, graph: FixedGraph, lies: list[int]) -> Any:
    """The one position and velocity on which, with time, gap and gap speed depend; or None."""
    pairing = field.code.pairing(contact)
    if len(pairing.positions) != 1:
        return None
    i, k = int(pairing.positions[0]), int(pairing.velocities[0])
    for root, own in ((lies[0], {i}), (lies[1], {i, k})):
        if not states_in(graph, root) - {TIME_PLACE} <= own:
            return None
    return i, k


def _slopes(graph: FixedGraph, lies: list[int], by: list[int]) -> list[int]:
    """Derivatives of the gap by time and position, and of its speed by time and the pair."""
    height, speed, _ = lies
    return [*gradient(graph, height, by)[:2], *gradient(graph, speed, by)]
