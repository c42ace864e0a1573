"""Whether a sum of impacts has seen all of what lies between its start and its limit.

The curve of a tail is made of some flights. What acts between them (a pulse of force, a bump of the
table, a restitution that changes at some speed) is looked for here, before the sum is believed:

- the restitution at every impact of the tail, down to speed zero, against that of the flights;
- with python-flint the gap's acceleration and the restitution in boxes that hold the motion from
  the first impact to the limit, in ball arithmetic, which no pulse escapes however narrow it is.
  What the balls allow must be what is there at points of the tail, but for :data:`EXCESS`.
"""

from __future__ import annotations

from functools import cached_property
from importlib.util import find_spec
from itertools import pairwise
from math import exp, inf, log, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..scene.defect import EPS
from ..scene.python import needed
from ..scene.taylor import flat
from ..segment import from_values, nodes
from .accumulate import FLOOR, Tail, on_contact
from .flight import fly

if TYPE_CHECKING:
    from ..scene import Contact, Field

#: What the gap's acceleration, or the restitution, may be in a box beyond what it is at points,
#: against its size: balls overestimate by a little that shrinks with the box.
EXCESS = 0.02

#: How often a tail is halved, at most, and points in each part of it. Three or four halvings leave
#: one flight, five more a thirty-second of it, over which balls of position and speed are as small.
HALVINGS, POINTS = 9, 5

#: How much wider a box is than the points in it, on either side.
WIDER = 0.25

#: Slowest impacts that are asked for their restitution (as slow as a float can be, but for a
#: square), impacts of a tail that are asked one by one, and steps from there to the slowest.
SLOWEST, IMPACTS, STEPS = 1e-300, 400, 1500

#: Flights between which the restitution along a tail is interpolated.
DEGREE = 12

#: What the restitution may be off, in what that does to the limit, against the sum's own error.
CAUTION = 64.0

#: Least loss at the impacts of a sum, and what of a loss that fades is not told from none: some
#: hundred roundings of the restitution.
LOSS, LOST = 1e-12, 1e-13


def seen(tail: Tail, closing: float = 1.0) -> bool:
    """Whether nothing hides between the flights of a sum.

    ``closing``: tolerance of the sum against the run's; a closer look is taken for a closer sum.
    """
    return _damped(tail) and _bounded(tail, EXCESS * closing**0.5)


def _depends(field: Field, contact: str) -> bool:
    """Whether a contact's restitution is no constant."""
    code = field.code

    def look() -> bool:
        from ..scene.graph import Graph

        graph = Graph()
        law = code.closed("restitution", contact)
        (found,) = graph.outputs(law, code.inputs(graph, ["u"]))
        nodes_ = needed(graph, [int(found.reshape(()))])
        names = [graph.nodes[n][1] for n in nodes_ if graph.nodes[n][0] == "input"]
        return any(name[0] != "p" for name in names)

    return bool(code.once(("law depends", contact), look))


# ---------------------------------------------------------------------------------------
# the restitution at each impact


def _damped(tail: Tail) -> bool:
    """Whether the restitution along the tail is what the sum's flights have it, and below 1."""
    if not _depends(tail.field, tail.contact.name):
        return True
    series = _flown(tail)
    if series is None:
        return False
    speeds, laws = series
    t_inf, x_inf = tail.t + tail.remaining, tail.x_inf.tolist()
    allowed = CAUTION * max(tail.t_error, FLOOR * abs(t_inf)) * (1.0 - tail.r) / tail.remaining
    for w in (tail.r ** np.arange(min(tail.count, IMPACTS))).tolist():
        since, x, _ = tail.point(tail.r * w)
        place = 2.0 * w - 1.0
        bend, growth = (float(chebyshev.chebval(place, c)) for c in (tail.curve[:, -1], speeds))
        law = tail.contact.law(tail.t + since, x.tolist(), -tail.v * w * exp(bend + growth))
        expected = exp(float(chebyshev.chebval(place, laws)))
        if not law < 1.0 - LOSS or abs(law / expected - 1.0) * w > allowed:
            return False
    slow = tail.v * np.exp(np.linspace(0.0, log(SLOWEST / tail.v), STEPS))
    return all(tail.contact.law(t_inf, x_inf, -u) < 1.0 - LOSS for u in slow.tolist())


def _flown(tail: Tail) -> tuple[np.ndarray, np.ndarray] | None:
    """Logarithms of the growth of the speed in a flight, and of the restitution after it.

    Chebyshev coefficients in the place on the curve from which the flight begins.
    """
    rows = [[0.0, log(tail.r)]]
    for w in nodes(DEGREE)[1:].tolist():
        since, x, v = tail.point(w)
        flight = fly(tail.field, tail.column, tail.t + since, x.tolist(), v)
        if flight is None:
            return None
        law = tail.contact.law(tail.t + since + flight.time, flight.x, flight.u)
        if not law > 0:
            return None
        rows.append([log(-flight.u / v), log(law)])
    growth, laws = (from_values(DEGREE) @ np.array(rows)).T
    return growth, laws


def damps(contact: Contact, t: float, x: list[float], speed: float, ratio: float) -> bool:
    """Whether impacts slower than ``speed`` lose so much that their series has a sum.

    What is lost may fade with the speed, below :data:`LOST` where it is not told from nothing; it
    must not stop all at once. Where it fades, flights that have shortened by a constant ``ratio``
    will not go on to; and as ``dn = -dv / (v lost(v))`` impacts have a speed about ``v``, each for
    a time like ``v``, their times have a sum only if ``v / lost(v)`` falls with ``v``.
    """
    fades = 1.0 - contact.law(t, x, -0.0) < LOSS
    if fades and ratio < 1.0:
        return False
    fall = min((SLOWEST / speed) ** (1.0 / STEPS), 1.0) if speed > 0 else 1.0
    before, pace = 1.0, inf
    for k in range(STEPS + 1):
        u = speed * fall**k
        lost = 1.0 - contact.law(t, x, -u)
        if lost < -8.0 * EPS or (lost < LOST and before > LOST / fall**2):
            return False
        if fades and lost >= LOST:
            if u >= pace * lost:
                return False
            pace = u / lost
        before = lost
    return True


# ---------------------------------------------------------------------------------------
# boxes


@attrs.frozen(eq=False)
class _Stretch:
    """A stretch of a tail: the impacts from ``y(first)`` to ``y(last)``, ``first > last``.

    ``begin``, ``end``: the shares of each flight after them that it is about.
    """

    tail: Tail
    first: float
    last: float
    begin: float = 0.0
    end: float = 1.0

    @cached_property
    def points(self) -> list[tuple[float, list[float], float]]:
        """Times, states and gap speeds before impacts, at points of the flights."""
        tail, field, found = self.tail, self.tail.field, []
        for w in np.linspace(self.last, self.first, POINTS).tolist():
            since, x, _ = tail.point(w)
            later, landed, after = tail.point(tail.r * w)
            t, end, u = tail.t + since, tail.t + later, -after / tail.r
            before = on_contact(field, tail.contact, tail.column, end, landed.tolist(), u)
            ends = x, np.array(before)
            rates = np.array(field.rhs(t, x.tolist())), np.array(field.rhs(end, before))
            for share in (self.begin, 0.5 * (self.begin + self.end), self.end):
                state = _between(ends, rates, later - since, share)
                found.append((t + share * (end - t), state.tolist(), u))
        return found

    @cached_property
    def times(self) -> tuple[float, float]:
        """First and last time; a flight more than the stretch itself."""
        tail = self.tail
        ends = chebyshev.chebval(
            2.0 * np.array([self.first, tail.r * self.last]) - 1.0, tail.curve[:, 0]
        )
        return tail.t + float(ends[0]), tail.t + float(ends[1])

    def box(self) -> dict[str, Any]:
        """Bounds of parameters, time, states, and gap speeds before impacts."""
        states = np.array([x for _, x, _ in self.points])
        low, high = states.min(axis=0), states.max(axis=0)
        room = WIDER * (high - low)
        speeds = [u for _, _, u in self.points]
        inputs: dict[str, Any] = {
            f"p{i}": value for i, value in enumerate(flat(self.tail.field.parameters))
        }
        inputs |= {
            f"x{i}": (nextafter(a, -np.inf), nextafter(b, np.inf))
            for i, (a, b) in enumerate(
                zip((low - room).tolist(), (high + room).tolist(), strict=True)
            )
        }
        return inputs | {"t": self.times, "u": (min(speeds), max(speeds) if self.last else 0.0)}

    def halves(self) -> list[_Stretch]:
        """Two stretches of about half the time each; of a single flight, its two parts."""
        if self.last >= self.tail.r * self.first:
            middle = 0.5 * (self.begin + self.end)
            parts = [self.begin, middle, self.end]
            return [attrs.evolve(self, begin=a, end=b) for a, b in pairwise(parts)]
        middle = 0.5 * (self.first + self.last)
        ends = [self.first, middle, self.last]
        return [_Stretch(self.tail, a, b) for a, b in pairwise(ends)]


def _between(
    ends: tuple[np.ndarray, np.ndarray],
    rates: tuple[np.ndarray, np.ndarray],
    length: float,
    s: float,
) -> np.ndarray:
    """The cubic through two states with their rates, at a share of the time between them."""
    chord = ends[1] - ends[0]
    early, late = (length * rate - chord for rate in rates)
    return np.asarray(ends[0] + s * chord + s * (1.0 - s) * ((1.0 - s) * early - s * late))


def _bounded(tail: Tail, excess: float) -> bool:
    """Whether acceleration and restitution in boxes along the tail are what they are at points."""
    if find_spec("flint") is None or _cornered(tail):
        return True
    field, name = tail.field, tail.contact.name
    program = field.code.once(("narrow", field.name, name), lambda: _program(field, name))
    stretches = [(HALVINGS, _Stretch(tail, 1.0, 0.0))]
    while stretches:
        left, stretch = stretches.pop()
        if not _fits(program, stretch, excess):
            if not left:
                return False
            stretches += [(left - 1, half) for half in stretch.halves()]
    return True


def _cornered(tail: Tail) -> bool:
    """Whether the gap has a corner where the impacts are, as a distance ``|x|`` has at zero.

    Balls about such a place do not know the side on which the flights are.
    """
    t, x = tail.t + tail.remaining, tail.x_inf.tolist()
    zero = 64 * EPS * max(map(abs, x))
    return any(abs(k.value(t, x)) <= zero for k in tail.field.guards[tail.column].kinks)


def _fits(program: Any, stretch: _Stretch, excess: float) -> bool:
    from ..scene.balls import high, low

    tail = stretch.tail
    guard, law = tail.field.guards[tail.column], tail.contact.law
    push, loss = program.enclose(stretch.box())
    if not (push.defined and loss.defined):
        return False
    pushes = [guard.lie(t, x)[2] for t, x, _ in stretch.points]
    laws = [law(t, x, u) for t, x, u in stretch.points]
    least, most = low(push.value), high(push.value)
    room = max(pushes) - min(pushes) + excess * max(map(abs, pushes))
    near = min(pushes) - room <= least and most <= max(pushes) + room and most < 0
    room = max(laws) - min(laws) + excess
    least, most = low(loss.value), high(loss.value)
    return near and min(laws) - room <= least and most <= min(max(laws) + room, 1.0 - LOSS)


def _program(field: Field, contact: str) -> Any:
    """The gap's acceleration and the restitution, as balls."""
    from ..scene.fixed import FixedGraph
    from ..scene.interval import IntervalProgram

    code, graph = field.code, FixedGraph(exact=True)
    flow, gap = code.field_closed(field.mode, field.held), code.closed("gap", contact)
    inputs = code.inputs(graph)
    (lies,) = graph.outputs(code.lie_closed((contact, field.name), gap, flow), inputs)
    law = code.closed("restitution", contact)
    (found,) = graph.outputs(law, [*inputs, np.array(graph.input("u"))])
    return IntervalProgram(graph, [int(lies.reshape(-1)[2]), int(found.reshape(()))])
