"""Whether Theorem 1 applies to a contact: a fixed obstacle, forces of position and velocity."""

from __future__ import annotations

from typing import Any

import attrs

from ..bounds.extrema import Bounds, ScalarFunction
from ..bounds.interval import IntervalProgram
from ..lowering.graph import needed
from .question import TIME_NAME, Question
from .restitution import Restitution

#: A box that begins within this distance of the wall (relative to the wall's position, or 1) counts
#: as touching it.
TOUCH = 1e-9


@attrs.frozen(eq=False)
class Setting:
    """A contact to which the theorem applies.

    Attributes
    ----------
    acceleration : ScalarFunction
        The gap's acceleration in free flight.
    slope : arb
        ``b``.
    wall : arb
        ``phi``.
    near, far : float
        The wall's position (rounded outward) and the other end of the box.
    limit : arb
        The largest absolute gap speed of the box.
    """

    question: Question
    acceleration: ScalarFunction
    slope: Any
    wall: Any
    near: float
    far: float
    limit: Any

    def box(self, far: float, speed: float) -> dict[str, Bounds]:
        q = self.question
        x = (min(self.near, far), max(self.near, far))
        return {f"x{q.position}": x, f"x{q.velocity}": (-speed, speed)}

    @property
    def speed(self) -> float:
        """The largest absolute velocity of the box."""
        low, high = self.question.box[self.question.spec.element_names[self.question.velocity]]
        return min(-low, high)

    def room(self, far: float) -> Any:
        """The gap at a position, as a ball."""
        from flint import arb

        from ..bounds.balls import absolute

        return absolute(self.slope * (arb(far) - self.wall))

    def restitution(self) -> Restitution:
        """The restitution at the wall, at approaching velocities."""
        q, v = self.question, f"x{self.question.velocity}"
        law = q.law(q.on_contact, lambda p, t, x: q.laws.speed(p, t, q.on_contact(p, t, x)))
        inward = (-self.speed, 0.0) if self.slope > 0 else (0.0, self.speed)
        return Restitution.of(law, {v: inward}, v)


def setting_of(q: Question) -> Setting | str:
    """The setting, or a sentence that says why the theorem does not apply."""
    from ..bounds.balls import absolute, high, low

    if len(q.laws.pairing.positions) > 1:
        return "Theorem 1 is for a gap of one position; this gap depends on several"
    x, v = f"x{q.position}", f"x{q.velocity}"
    gap, speed, acceleration = (
        q.function(h) for h in (q.laws.gap, q.laws.speed, q.laws.acceleration)
    )
    names = ", ".join(q.labels[name] for name in sorted(gap.inputs - {x}))
    if TIME_NAME in gap.inputs:
        return "Theorem 1 is for a fixed obstacle; this gap depends on the time"
    if names:
        return f"Theorem 1 is for a gap of one position; this gap depends on {names} too"
    slope = constant_slope(gap, x)
    if slope is None or slope.contains(0):
        return "Theorem 1 is for a gap x - phi; this gap is not affine, as far as is known"
    if speed.inputs != {v} or constant_slope(speed, v) != slope or speed.at({v: 0.0}) != 0:
        return "Theorem 1 is for x' = v; here the position's derivative is another function"
    others = acceleration.inputs - {x, v}
    if others:
        names = ", ".join("the time" if n == TIME_NAME else q.labels[n] for n in sorted(others))
        return f"Theorem 1 is for forces of position and velocity; these depend on {names} too"
    wall = -gap.at({x: 0.0}) / slope
    _require_bounds(q)
    ends = q.box[q.labels[x]]
    near, far = (low(wall), ends[1]) if slope > 0 else (high(wall), ends[0])
    _require_touch(q, ends, near, slope > 0)
    setting = Setting(q, acceleration, slope, wall, near, far, None)
    return attrs.evolve(setting, limit=absolute(slope) * setting.speed)


def _require_bounds(q: Question) -> None:
    names = q.spec.element_names
    for place in (q.position, q.velocity):
        if names[place] not in q.box:
            q.refuse(f"box has no bounds for {names[place]!r}; add {names[place]!r}: (low, high)")
    low, high = q.box[names[q.velocity]]
    if not low < 0.0 < high:
        name = names[q.velocity]
        q.refuse(f"box {name}=({low}, {high}); speeds of both signs: {name!r}: (-c, c)")


def _require_touch(q: Question, ends: Bounds, near: float, below: bool) -> None:
    """Refuse a box that does not extend inward from the wall."""
    name, room = q.spec.element_names[q.position], TOUCH * max(1.0, abs(near))
    start, far = ends if below else ends[::-1]
    sign = 1.0 if below else -1.0
    if sign * (start - near) > room or sign * (far - near) <= 0.0:
        wanted = f"({near:.12g}, h)" if below else f"(h, {near:.12g})"
        q.refuse(
            f"box {name}=({ends[0]}, {ends[1]}) does not reach from the obstacle at "
            f"{near:.12g} inward; give {name!r}: {wanted}"
        )


def constant_slope(function: ScalarFunction, name: str) -> Any:
    """The derivative by an input in which the function is affine; None if it is not."""
    if name not in function.gradient or function.slopes is None or _may_step(function, name):
        return None
    root = function.slopes.roots[function.gradient.index(name)]
    program = IntervalProgram(function.slopes.graph, [root])
    if program.inputs:
        return None
    result = program.enclose({})[0]
    return result.value if result.defined else None


def _may_step(function: ScalarFunction, name: str) -> bool:
    """Whether an operation that can jump, and hides this in its slope, acts on an input."""
    from ..bounds.balls import JUMPS

    graph = function.value.graph
    order = needed(graph, function.value.roots)
    moved: set[int] = set()
    for number in order:
        op, *arguments = graph.nodes[number]
        if op == "input" and arguments[0] == name:
            moved.add(number)
        elif op not in ("input", "const") and moved & set(arguments):
            if op in JUMPS or op == "select":
                return True
            moved.add(number)
    return False
