"""States beside those of a proof: whether they may end the motion before the impacts accumulate.

A proof bounds what the gap's acceleration depends on. The other states move along, and the motion
exists only as long as they all do: ``q' = q^2`` has no solution after ``1 / q(0)``. A state is
harmless

* if its rate is at most proportional to the state itself, for any initial value. This is read off
  the flow, with bounds for all other states (:mod:`hybrid.bounds.growth`);
* if it has bounds in the box, its rate is bounded there, and it starts far enough inside that it
  cannot leave them in time.

States that depend on each other cyclically are judged together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import attrs

from ..bounds.balls import Undefined
from ..bounds.extrema import Bounds, ScalarFunction, extrema
from ..bounds.growth import ANYTHING, GROWING, LOWER, UPPER, Growth, between, growth
from ..lowering.graph import inputs_of
from .question import TIME_NAME, Question, Traced
from .result import Fault

#: Accuracy of the rates of states that must stay within their bounds.
COARSE = 1e-6


@attrs.frozen(eq=False)
class Beside:
    """What was found about the states beside a proof.

    Attributes
    ----------
    drifts : dict of str to float
        Largest absolute rates, by name, of the states that must stay within the box; for time, the
        rate is 1.
    fault : tuple of str or None
        Verdict, reason and repair, if a state may end the motion.
    """

    drifts: dict[str, float]
    fault: Fault | None = None

    def inside(self, box: Mapping[str, Bounds], name: str, time: float) -> Bounds | None:
        """Initial values from which the box is not left within ``time``; None if there are none."""
        low, high = box[name]
        far = math.nextafter(self.drifts[name] * time, math.inf)
        start = low if name == TIME_NAME else math.nextafter(low + far, math.inf)
        end = math.nextafter(high - far, -math.inf)
        return (start, end) if start < end else None


def beside(q: Question, flow: Traced, bounds: Mapping[str, Bounds]) -> Beside:
    """Judge the states that a proof does not bound.

    Parameters
    ----------
    flow : callable
        The flow in the coordinates of the proof.
    bounds : mapping of str to (low, high)
        The inputs that the proof bounds.
    """
    rates, relied, known = _Rates.of(q, flow), list[str](), dict(bounds)
    offered = {name: q.box[label] for name, label in q.labels.items() if label in q.box}
    while True:
        bad = rates.first_fault(known) or rates.unbounded(relied, known)
        if bad is None:
            return _drifts(q, flow, relied, known)
        who, wanted, why = bad
        new = [name for name in wanted if name in offered and name not in known]
        if not new:
            return Beside({}, _fault(q, who, wanted, why))
        relied += new
        known |= {name: offered[name] for name in new}


def _drifts(q: Question, flow: Traced, relied: list[str], known: dict[str, Bounds]) -> Beside:
    """Bound the rates of the states that must stay within the box."""
    found = {}
    for name in relied:
        drift, why = (1.0, "") if name == TIME_NAME else fastest(q, _rate(q, flow, name), known)
        if not math.isfinite(drift):
            reason = f"the rate of {q.labels[name]} has no bounds on the box: {why}"
            repair = f"bounds of {q.labels[name]} within which its rate is bounded"
            return Beside({}, ("undecided", reason, repair))
        found[q.labels[name]] = drift
    return Beside(found)


def _rate(q: Question, flow: Traced, name: str) -> ScalarFunction:
    return q.function(lambda p, t, z: flow(p, t, z)[int(name[1:])])


def fastest(q: Question, rate: ScalarFunction, box: Mapping[str, Bounds]) -> tuple[float, str]:
    """The largest absolute rate of a state on a box, and the reason if it is infinite."""
    q.bounds(rate)
    least, most = extrema(rate, box, COARSE)
    return max(-least.low, most.high), most.reason or least.reason


def _fault(q: Question, who: list[str], wanted: list[str], why: str) -> Fault:
    names = ", ".join(q.labels[name] for name in who)
    reason = f"{names} may end the motion before the impacts accumulate: {why}"
    listed = ", ".join(f"{q.labels[name]!r}: (low, high)" for name in wanted)
    if listed:
        return "undecided", reason, f"add bounds within which it exists: {listed}"
    return "undecided", reason, f"other bounds, on which the flow of {names} is defined"


#: States, unbounded inputs on which they depend, and what is wrong with their rates.
Doubt = tuple[list[str], list[str], str]


@attrs.frozen(eq=False)
class _Rates:
    """The rates of all elements of the state, as nodes of a graph."""

    graph: Any
    roots: dict[str, int]
    inputs: dict[str, set[str]]

    @classmethod
    def of(cls, q: Question, flow: Traced) -> _Rates:
        program = q.rates(flow)
        roots = {f"x{i}": root for i, root in enumerate(program.roots)}
        return cls(
            program.graph, roots, {k: inputs_of(program.graph, [r]) for k, r in roots.items()}
        )

    def first_fault(self, known: Mapping[str, Bounds]) -> Doubt | None:
        """The first group of states that may end the motion; None if there is none."""
        for group in self.groups(set(self.roots) - set(known)):
            why = self.fault(group, known)
            if why is not None:
                inputs = set().union(*(self.inputs[name] for name in group)) - set(known)
                return group, sorted(inputs, key=lambda name: (name not in group, name)), why
        return None

    def unbounded(self, relied: Iterable[str], known: Mapping[str, Bounds]) -> Doubt | None:
        """A state that must stay within its bounds but depends on an unbounded input, or None."""
        for name in relied:
            inputs = sorted(self.inputs.get(name, set()) - set(known))
            if inputs:
                return (
                    [name],
                    inputs,
                    "its rate is bounded only if all that it depends on is bounded",
                )
        return None

    def groups(self, free: set[str]) -> list[list[str]]:
        """The free states in groups of cyclic dependence, causes before effects."""
        reach = {name: self.reached(name, free) for name in free}
        order = sorted(free, key=lambda name: (len(reach[name]), int(name[1:])))
        found: dict[frozenset[str], list[str]] = {}
        for name in order:
            circle = {other for other in reach[name] if name in reach[other]} | {name}
            found.setdefault(frozenset(circle), sorted(circle))
        return list(found.values())

    def reached(self, name: str, free: set[str]) -> set[str]:
        """The free states on which the rate of one depends, directly or indirectly."""
        found: set[str] = set()
        queue = [name]
        while queue:
            new = (self.inputs[queue.pop()] & free) - found
            found |= new
            queue += new
        return found

    def fault(self, group: list[str], known: Mapping[str, Bounds]) -> str | None:
        """Why a group may cease to exist in finite time; None if it cannot."""
        around = {name: between(*known[name]) for name in known}
        free = dict.fromkeys([*self.roots, TIME_NAME], ANYTHING) | around
        if len(group) == 1:
            return self.alone(group[0], free)
        why = self.together(group, free)
        return why if why is None or not self.oscillates(group, free) else None

    def alone(self, name: str, free: dict[str, Growth]) -> str | None:
        """For a single state: it must not escape upward if positive, nor downward if negative."""
        above = growth(self.graph, self.roots[name], free | {name: UPPER})
        below = growth(self.graph, self.roots[name], free | {name: LOWER})
        return _why(above, "up") or _why(below, "down")

    def together(self, group: list[str], free: dict[str, Growth]) -> str | None:
        """For cyclically dependent states: all rates must be at most proportional to the states."""
        grown = free | dict.fromkeys(group, GROWING)
        found = [growth(self.graph, self.roots[name], grown) for name in group]
        return next(
            (why for rate in found for end in GROWTH_ENDS if (why := _why(rate, end))), None
        )

    def oscillates(self, group: list[str], free: dict[str, Growth]) -> bool:
        """Whether a position and its velocity move in a potential from which they cannot escape.

        Forces that depend on the position alone must not push outward more than proportionally, and
        all others not along the velocity more than proportionally. The energy then grows at most
        exponentially.
        """
        for place, speed in (group, group[::-1]) if len(group) == 2 else ():
            if self.graph.nodes[self.roots[place]] == ("input", speed):
                terms = _terms(self.graph, self.roots[speed], 1)
                return all(self.holds(*term, place, speed, free) for term in terms)
        return False

    def holds(self, node: int, sign: int, place: str, speed: str, free: dict[str, Growth]) -> bool:
        """Whether a term of the force on a position cannot make it escape."""
        if inputs_of(self.graph, [node]) <= {place}:
            regions = [free | {place: half} for half in (UPPER, LOWER)]
        else:
            halves = [attrs.evolve(half, least=-math.inf) for half in (UPPER, LOWER)]
            regions = [free | {place: GROWING, speed: half} for half in halves]
        ends = GROWTH_ENDS if sign > 0 else GROWTH_ENDS[::-1]
        pairs = zip(regions, ends, strict=True)
        return not any(_why(growth(self.graph, node, region), end) for region, end in pairs)


#: The exponents of growth upward and downward.
GROWTH_ENDS = ("up", "down")


def _why(rate: Any, end: str) -> str | None:
    """What is wrong with a rate; None if it is defined and at most linear in this direction."""
    if isinstance(rate, Undefined):
        return f"its rate is not defined everywhere ({rate.reason})"
    if getattr(rate, end) > 1.0:
        return "its rate grows faster than in proportion to it"
    return None


def _terms(graph: Any, node: int, sign: int) -> list[tuple[int, int]]:
    """The terms of a sum, with their signs."""
    op, *arguments = graph.nodes[node]
    if op == "neg":
        return _terms(graph, arguments[0], -sign)
    if op in ("add", "sub"):
        second = sign if op == "add" else -sign
        return _terms(graph, arguments[0], sign) + _terms(graph, arguments[1], second)
    return [(node, sign)]
