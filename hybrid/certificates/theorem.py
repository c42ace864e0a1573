"""Theorem 1 of Akhmet and Çağ: a fixed obstacle, forces even in the velocity.

For a gap ``g = b (x - phi)`` and ``x' = v`` the theorem is applied in the gap's own coordinates, in
which the acceleration is ``a = L_f^2 g``. This is the paper's ``f`` if ``b`` is 1, and also covers
an obstacle above the body (``b < 0``).
"""

from __future__ import annotations

import math
from typing import Any

import attrs

from ..bounds.extrema import Bounds, Extreme, ScalarFunction, continuous, extrema
from ..bounds.parity import parity
from .beside import beside
from .question import Question
from .restitution import Restitution
from .result import Certificate, Fault
from .setting import Setting, setting_of

THEOREM = "Theorem 1 (fixed obstacle, (C1), (C2))"

#: The remedy where the theorem does not apply.
BY_LEMMA = (
    'ask without (C2), in relative coordinates: box={"gap": (0, y), "speed": (0, w), ...} '
    "with bounds of t and of other states that the gap's acceleration depends on"
)

#: Accuracy of the extrema in the answer, and in trials in search of a repair.
FINE, COARSE = 1e-13, 1e-6

#: Bisections in search of a repair.
TRIALS = 20


@attrs.frozen
class Trial:
    """The numbers of the theorem on one box.

    ``left`` bounds ``M sqrt(2 (h - phi) / m)`` from below and above; None if (C1) fails.
    """

    least: Extreme
    most: Extreme
    left: tuple[float, float] | None
    limit: tuple[float, float]

    @property
    def m(self) -> float:
        return _below(self.most.high)

    @property
    def M(self) -> float:
        return -self.least.low

    @property
    def holds(self) -> bool:
        return self.left is not None and self.left[1] < self.limit[0]


def by_theorem(question: Question) -> Certificate:
    """The certificate by Theorem 1."""
    setting = setting_of(question)
    if isinstance(setting, str):
        return question.answer(THEOREM, "undecided", setting, repair=BY_LEMMA)
    trial = _trial(setting, setting.far, setting.speed, FINE)
    found: dict[str, Any] = _numbers(question, trial)
    box = setting.box(setting.far, setting.speed)
    law = setting.restitution()
    found["restitution"] = law.bounds
    faults = [
        law.fault(),
        _parity(setting),
        edges_fault(question.other_guards(lambda h: h), box),
        _regularity(setting),
    ]
    bad = next((fault for fault in faults if fault), None)
    if bad:
        return question.answer(THEOREM, *bad, **found)
    if trial.holds:
        return _certified(setting, trial, law, found)
    return _refused(setting, trial, law, found)


# ---------------------------------------------------------------------------------------
# the conditions


def _trial(setting: Setting, far: float, speed: float, tolerance: float) -> Trial:
    from flint import arb, ctx

    from ..bounds.balls import absolute, high, low
    from ..bounds.interval import PRECISION

    least, most = extrema(setting.acceleration, setting.box(far, speed), tolerance)
    with ctx.workprec(PRECISION):
        limit = absolute(setting.slope) * arb(speed)
        left = None
        if most.high < 0.0 and least.low > float("-inf"):
            room = 2 * setting.room(far)
            above = -arb(least.low) * (room / arb(_below(most.high))).sqrt()
            under = -arb(least.high) * (room / -arb(most.low)).sqrt()
            left = low(under), high(above)
    return Trial(least, most, left, (low(limit), high(limit)))


def _below(high: float) -> float:
    """``m``: the float below what was proved, because (C1) is strict."""
    return math.nextafter(-high, 0.0)


def _parity(setting: Setting) -> Fault | None:
    """(C2): None if evenness is proved, else the fault, with a counterexample if one is found."""
    function, q = setting.acceleration, setting.question
    v = f"x{q.velocity}"
    (root,) = function.value.roots
    if v not in function.inputs or parity(function.value.graph, root, {v}) == "even":
        return None
    box = setting.box(setting.far, setting.speed)
    for i, j in ((i, j) for i in range(5) for j in range(5)):
        (a, b), (_, c) = box[f"x{q.position}"], box[v]
        point = {f"x{q.position}": a + (b - a) * i / 4, v: c * (j + 0.9) / 5}
        here, there = function.at(point), function.at({**point, v: -point[v]})
        if here is not None and there is not None and not here.overlaps(there):
            at = ", ".join(f"{q.labels[n]} = {value:.12g}" for n, value in point.items())
            reason = f"(C2) fails: the force is not even in the velocity, for instance at {at}"
            return "refuted", reason, BY_LEMMA
    reason = "(C2) could not be decided: no proof that the force is even in the velocity"
    return "undecided", reason, BY_LEMMA


def edges_fault(guards: dict[str, ScalarFunction], box: dict[str, Bounds]) -> Fault | None:
    """The fault if another edge may be taken inside the box."""
    for name, guard in guards.items():
        bounded = False
        if guard.inputs <= set(box):
            least, most = extrema(guard, box, COARSE)
            bounded = least.low > 0.0 or most.high < 0.0
        if not bounded:
            reason = f"the motion may leave by {name}, whose guard may be zero on the box"
            return "undecided", reason, "choose a box on which that guard keeps its sign"
    return None


def _regularity(setting: Setting) -> Fault | None:
    function, box = setting.acceleration, setting.box(setting.far, setting.speed)
    if continuous(function, {name: box[name] for name in function.inputs}):
        return None
    reason = (
        "the theorem wants a force that is continuous and locally Lipschitz on the box; "
        "that could not be shown (a switch, a step, or an infinite slope)"
    )
    return "undecided", reason, BY_LEMMA


# ---------------------------------------------------------------------------------------
# answers


def _numbers(q: Question, trial: Trial) -> dict[str, Any]:
    found: dict[str, Any] = {
        "m_at": q.named(trial.most.at),
        "M_at": q.named(trial.least.at),
        "right": trial.limit[0],
    }
    if trial.left is not None:
        found.update(m=trial.m, M=trial.M, left=trial.left[1])
        found["margin"] = trial.limit[0] - trial.left[1]
    return found


def _certified(
    setting: Setting, trial: Trial, law: Restitution, found: dict[str, Any]
) -> Certificate:
    from flint import arb, ctx

    from ..bounds.balls import high
    from ..bounds.interval import PRECISION

    q = setting.question
    start = _starts(setting, setting.far, trial, law)
    if not isinstance(start, dict):
        return q.answer(THEOREM, *start, **found)
    with ctx.workprec(PRECISION):
        room = 2 * setting.room(setting.far)
        smallest = high(arb(trial.M) ** 2 * room / arb(trial.limit[0]) ** 2)
    reason = "(C1), (C2) and the inequality hold on the box"
    largest = -trial.most.high
    return q.answer(
        THEOREM, "certified", reason, m_range=(smallest, largest), initial_set=start, **found
    )


def _starts(setting: Setting, far: float, trial: Trial, law: Restitution) -> dict[str, Any] | Fault:
    """The initial set: heights, and the other states that must not end the motion; or a fault."""
    q = setting.question
    names = q.spec.element_names
    bounds = (min(setting.near, far), max(setting.near, far))
    start: dict[str, Any] = {names[q.position]: bounds, names[q.velocity]: 0.0}
    others = beside(q, q.laws.flow, setting.box(far, setting.speed))
    if others.fault is not None:
        return others.fault
    time = _longest(setting, far, trial, law) if others.drifts else 0.0
    for name, drift in others.drifts.items():
        inside = others.inside(q.box, name, time)
        if inside is None:
            reason = f"{name} may leave its bounds, at a rate of {drift:.6g}, in the {time:.6g} "
            reason += "that the motion may last; nothing is known outside of them"
            return "undecided", reason, f"other bounds of {name}, or a smaller height"
        start[name] = inside
    return start


def _longest(setting: Setting, far: float, trial: Trial, law: Restitution) -> float:
    """The longest time from the height to the accumulation: the fall, and all flights.

    A flight returns with the speed with which it left, and lasts at most ``2 v / m``.
    """
    from flint import arb, ctx

    from ..bounds.balls import high
    from ..bounds.interval import PRECISION

    assert law.ends is not None
    with ctx.workprec(PRECISION):
        room, m, r = 2 * setting.room(far), arb(trial.m), arb(law.ends[1].high)
        speed = (arb(trial.M) * room).sqrt()
        return high((room / m).sqrt() + 2 * r * speed / (m * (1 - r)))


def _refused(
    setting: Setting, trial: Trial, law: Restitution, found: dict[str, Any]
) -> Certificate:
    q = setting.question
    far, speed = _largest_height(setting), None
    position, velocity = (q.spec.element_names[i] for i in (q.position, q.velocity))
    repairs = []
    if trial.left is not None:
        speed = _smallest_speed(setting, trial)
    if speed is not None:
        repairs.append(f"|{velocity}| up to more than {speed!r}")
    if far is not None:
        repairs.append(f"{position} only as far as {far!r}")
        start = _starts(setting, far, _trial(setting, far, setting.speed, COARSE), law)
        if isinstance(start, dict):
            found["initial_set"] = start
        else:
            repairs[-1] += f" (and {start[2]})"
    repair = ", or ".join(repairs) or "no smaller box was found on which the conditions hold"
    return q.answer(THEOREM, *_failure(setting, trial), repair=repair, **found)


def _failure(setting: Setting, trial: Trial) -> tuple[str, str]:
    """The verdict and the condition that fails."""
    q = setting.question
    at = ", ".join(f"{q.labels[n]} = {value:.12g}" for n, value in trial.most.at.items())
    if trial.most.low >= 0.0:
        return "refuted", f"(C1) fails: the gap's acceleration is {trial.most.low:.12g} at {at}"
    if trial.left is None:
        why = trial.most.reason or trial.least.reason or "the bounds are not close enough"
        return "undecided", f"(C1) could not be decided on the box: {why}"
    if trial.left[0] >= trial.limit[1]:
        reason = (
            f"the inequality fails: M sqrt(2 (h - phi) / m) = {trial.left[1]!r} is not below "
            f"{trial.limit[0]!r} (the least |force| is {-trial.most.high:.12g}, at {at})"
        )
        return "refuted", reason
    return "undecided", "the inequality could not be decided: both sides are equal to rounding"


def _smallest_speed(setting: Setting, trial: Trial) -> float | None:
    """A speed beyond which the inequality holds at this height; None if none was found."""
    from flint import arb

    from ..bounds.balls import absolute, high

    assert trial.left is not None
    scale = absolute(setting.slope)
    left = high(arb(trial.left[1]) / scale)
    if f"x{setting.question.velocity}" not in setting.acceleration.inputs:
        return left
    for _ in range(TRIALS):
        wider = _trial(setting, setting.far, left * (1.0 + COARSE), COARSE)
        if wider.left is None:
            return None
        if wider.holds:
            return left * (1.0 + COARSE)
        left = high(arb(wider.left[1]) / scale)
    return None


def _largest_height(setting: Setting) -> float | None:
    """The position up to which the conditions hold with this box's speeds, by bisection."""
    good, bad = None, 1.0
    for _ in range(TRIALS):
        share = 0.5 * ((good or 0.0) + bad)
        far = setting.near + share * (setting.far - setting.near)
        if far != setting.near and _trial(setting, far, setting.speed, COARSE).holds:
            good = share
        else:
            bad = share
    return None if good is None else setting.near + good * (setting.far - setting.near)
