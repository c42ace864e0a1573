"""The lemma without (C2), in coordinates relative to the contact, before a run.

For a gap ``g = b x + phi(t, others)`` whose speed is ``b' v + psi(...)`` with constant ``b`` and
``b'``, position and velocity are functions of gap, gap speed and the rest:

    x = (y - phi) / b,    v = (w - psi) / b'.

These are inserted into the traces, so the acceleration is bounded as a function of ``y``, ``w``,
time and the other states. For other gaps the acceleration is bounded over a box of all states, and
the answer says what that leaves open.
"""

from __future__ import annotations

import math
from typing import Any

import attrs

from ..bounds.extrema import Bounds, Extreme, ScalarFunction, continuous, extrema
from ..zeno.lemma import chattering, largest_speed
from .beside import Beside, beside, fastest
from .question import GAP_NAME, SPEED_NAME, TIME_NAME, Question, Traced, solved
from .restitution import Restitution
from .result import Certificate, Fault, shown
from .setting import constant_slope
from .theorem import COARSE, FINE, TRIALS, edges_fault

RELATIVE_LEMMA = "the lemma without (C2), relative to the contact"


def by_lemma(question: Question) -> Certificate:
    """The certificate by the lemma."""
    height, speed = _own_bounds(question)
    place, fault = _coordinates(question)
    q = question if fault is None else attrs.evolve(question, relative=False)
    setting = RelativeSetting(
        q,
        q.function(place(q.laws.acceleration)),
        _law(q, place),
        q.other_guards(place),
        () if fault else _motion(q, place),
        place,
        height,
        speed,
    )
    q.bounds(setting.acceleration, *setting.motion)
    law = setting.restitution()
    faults = [fault, law.fault(), edges_fault(setting.guards, setting.box())]
    faults.append(setting.regularity())
    return _answer(setting, law, next((f for f in faults if f), None))


def _motion(q: Question, place: Any) -> tuple[ScalarFunction, ...]:
    """Gap at position 0 and gap speed at velocity 0: the motion of the coordinate system."""

    def rest(h: Traced, k: int) -> ScalarFunction:
        return q.function(lambda p, t, z: h(p, t, place(_itself)(p, t, z).at[k].set(0.0)))

    return rest(q.laws.gap, q.position), rest(q.laws.speed, q.velocity)


def _law(q: Question, place: Any) -> ScalarFunction:
    """The restitution in the coordinates of the proof; at zero gap if these are relative."""
    if not q.relative:
        return q.law(_itself, q.laws.speed)
    state = place(_itself)
    return q.law(
        lambda p, t, z: state(p, t, z.at[q.position].set(0.0)), lambda p, t, z: z[q.velocity]
    )


def _own_bounds(q: Question) -> tuple[float, float]:
    """Bounds of the gap and of the absolute gap speed."""
    for name in (GAP_NAME, SPEED_NAME):
        if name not in q.box:
            q.refuse(f"box has no bounds for {name!r}; add {name!r}: (0, largest)")
        low, high = q.box[name]
        if low > 0.0 or high <= 0.0 or (name == GAP_NAME and low < 0.0):
            q.refuse(f"box {name}=({low}, {high}); a contact is at 0: give {name!r}: (0, largest)")
    return q.box[GAP_NAME][1], q.box[SPEED_NAME][1]


# ---------------------------------------------------------------------------------------
# coordinates


def _coordinates(q: Question) -> tuple[Any, Any]:
    """``place(h)``, which converts to relative coordinates; or what prevents it."""
    i, j = q.position, q.velocity
    gap, speed = q.function(q.laws.gap), q.function(q.laws.speed)
    unknown = _not_affine(q, constant_slope(gap, f"x{i}"), constant_slope(speed, f"x{j}"))
    if unknown:
        reason = (
            f"{unknown}, so the bounds are over the box of states; that the motion stays in it "
            "is not proved"
        )
        repair = "simulate it: the proofs along a run are run.zeno[i].proofs"
        return (lambda h: h), ("undecided", reason, repair)

    def state(parameters: Any, t: Any, z: Any) -> Any:
        x = solved(q.laws.gap, i, parameters, t, z, z[i])
        return solved(q.laws.speed, j, parameters, t, x, z[j])

    def place(h: Traced) -> Traced:
        return lambda p, t, z: h(p, t, state(p, t, z))

    return place, None


def _not_affine(q: Question, gap: Any, speed: Any) -> str | None:
    """What of gap and gap speed is not known to be affine, given their slopes; None if both are."""
    names = q.spec.element_names
    if len(q.laws.pairing.positions) > 1:
        listed = ", ".join(names[k] for k in q.laws.pairing.positions)
        return f"the gap depends on several positions ({listed})"
    for what, slope, place in (("gap", gap, q.position), ("gap's speed", speed, q.velocity)):
        if slope is None:
            return f"the {what} could not be shown to be affine in {names[place]}"
        if slope.contains(0):
            return f"the {what} may not depend on {names[place]}"
    return None


@attrs.frozen(eq=False)
class RelativeSetting:
    """A contact, and the functions that the proof needs, in relative coordinates.

    ``place`` converts a function of states to these coordinates.
    """

    question: Question
    acceleration: ScalarFunction
    law: ScalarFunction
    guards: dict[str, ScalarFunction]
    motion: tuple[ScalarFunction, ...]
    place: Any
    height: float
    speed: float

    def box(self) -> dict[str, Bounds]:
        """Bounds of all inputs."""
        q = self.question
        named = {name: q.box[label] for name, label in q.labels.items() if label in q.box}
        if q.relative:
            named[f"x{q.position}"] = (0.0, self.height)
            named[f"x{q.velocity}"] = (-self.speed, self.speed)
        return named

    def restitution(self) -> Restitution:
        """The restitution on the contact, at approaching gap speeds."""
        v = f"x{self.question.velocity}"
        box = self.box()
        return Restitution.of(self.law, box | ({v: (-self.speed, 0.0)} if v in box else {}), v)

    def smaller(self, scale: float, span: float) -> RelativeSetting:
        """The setting on a box with smaller gaps and speeds, and a shorter time."""
        q = self.question
        box = {
            **q.box,
            GAP_NAME: (0.0, scale**2 * self.height),
            SPEED_NAME: (0.0, scale * self.speed),
        }
        if TIME_NAME in box:
            first, last = box[TIME_NAME]
            box[TIME_NAME] = (first, first + span * (last - first))
        smaller = attrs.evolve(self, question=attrs.evolve(q, box=box))
        return attrs.evolve(smaller, height=box[GAP_NAME][1], speed=box[SPEED_NAME][1])

    def drifts(self) -> Beside:
        """The largest rates of the other states, of the proof and beside it."""
        q, flow = self.question, self.place(self.question.laws.flow)
        own, found = {q.position, q.velocity}, dict[int, float]()
        queue = [self.acceleration, self.law, *self.motion, *self.guards.values()]
        while queue:
            inputs = queue.pop().inputs
            for k in {int(n[1:]) for n in inputs if n.startswith("x")} - own - set(found):
                rate = q.function(lambda p, t, z, k=k: flow(p, t, z)[k])
                found[k], _ = fastest(q, rate, self.box())
                queue.append(rate)
        known = {f"x{k}" for k in own | set(found)} | {TIME_NAME}
        bounds = {name: ends for name, ends in self.box().items() if name in known}
        others = beside(q, flow, bounds)
        relied = {q.spec.element_names[k]: drift for k, drift in found.items()}
        return attrs.evolve(others, drifts={**relied, **others.drifts})

    def regularity(self) -> Any:
        """Check that gap and gap speed are continuous in time and the other states."""
        box = self.box()
        for function in self.motion:
            if not continuous(function, {name: box[name] for name in function.inputs}):
                reason = "gap and gap speed must be continuous in time; that could not be shown"
                return "undecided", reason, "a smaller box, without a switch of the gap's motion"
        return None


def _itself(p: Any, t: Any, x: Any) -> Any:
    return x


# ---------------------------------------------------------------------------------------
# answers


@attrs.frozen
class RelativeTrial:
    """The lemma on one box: extrema of the acceleration, and lower and upper bounds on ``rho``."""

    least: Extreme
    most: Extreme
    rho: tuple[float, float] | None


def _trial(setting: RelativeSetting, law: Restitution, tolerance: float) -> RelativeTrial:
    from ..bounds.balls import high, low

    least, most = extrema(setting.acceleration, setting.box(), tolerance)
    if most.high >= 0.0 or least.low == float("-inf"):
        return RelativeTrial(least, most, None)
    assert law.ends is not None
    above = chattering(1.0, -most.high, -least.low, law.ends[1].high).rho
    under = chattering(1.0, -most.low, -least.high, law.ends[1].low).rho
    return RelativeTrial(least, most, (math.nextafter(low(under), 0.0), high(above)))


def _answer(setting: RelativeSetting, law: Restitution, fault: Fault | None) -> Certificate:
    q = setting.question
    found: dict[str, Any] = {"right": 1.0}
    if law.ends is None:
        assert fault is not None
        return q.answer(RELATIVE_LEMMA, *fault, **found)
    found["restitution"] = law.bounds
    trial = _trial(setting, law, FINE)
    found.update(m_at=q.named(trial.most.at), M_at=q.named(trial.least.at))
    if trial.rho is not None:
        found.update(m=-trial.most.high, M=-trial.least.low)
        found.update(left=trial.rho[1], margin=1.0 - trial.rho[1])
    if fault is not None:
        return q.answer(RELATIVE_LEMMA, *fault, **found)
    if trial.rho is not None and trial.rho[1] < 1.0:
        starts = _starts(setting, law, trial)
        if not isinstance(starts, dict):
            return q.answer(RELATIVE_LEMMA, *starts, **found)
        reason = "the gap's acceleration and r sqrt(M / m) < 1 are proved on the box"
        return q.answer(RELATIVE_LEMMA, "certified", reason, **found, **starts)
    return _smaller(setting, law, trial, found)


def _starts(
    setting: RelativeSetting, law: Restitution, trial: RelativeTrial
) -> dict[str, Any] | Fault:
    """The largest initial speed, its times, and the initial set; or what prevents it."""
    from ..bounds.balls import high, low

    q, others = setting.question, setting.drifts()
    if others.fault is not None:
        return others.fault
    m, M = -trial.most.high, -trial.least.low
    time = _room(q, others.drifts)
    v = largest_speed(m, M, law.bounds, setting.height, setting.speed, time)
    if not v > 0.0:
        endless = [name for name, drift in others.drifts.items() if drift == math.inf]
        reason = "the box of times and other states leaves no room for the motion"
        reason += f": the rate of {endless[0]} has no bounds on it" if endless else ""
        return "undecided", reason, "a smaller box of it" if endless else "a wider box"
    remaining = chattering(v, m, M, law.bounds).remaining
    assert remaining is not None
    low_, high_ = low(remaining[0]), high(remaining[1])
    start: dict[str, Any] = {GAP_NAME: 0.0, SPEED_NAME: (0.0, v)}
    for name, (a, b) in q.box.items():
        if name == TIME_NAME:
            start[name] = (a, b - high_)
        elif name in others.drifts:
            start[name] = others.inside(q.box, name, high_)
    return {"initial_set": start, "remaining": (low_, high_)}


def _room(q: Question, drifts: dict[str, float]) -> float:
    """How long the motion may last, so that half the box's time is left for its start.

    The other states may drift by a quarter of their range to either side.
    """
    rooms = [0.5 * (b - a) for name, (a, b) in q.box.items() if name == TIME_NAME]
    for name, drift in drifts.items():
        a, b = q.box[name]
        rooms.append(0.25 * (b - a) / drift if drift > 0.0 else float("inf"))
    return min(rooms, default=float("inf"))


def _smaller(
    setting: RelativeSetting, law: Restitution, trial: RelativeTrial, found: dict[str, Any]
) -> Certificate:
    """The condition that fails, and a smaller box on which it holds."""
    q, repair = setting.question, "no smaller box was found on which the conditions hold"
    shares = [(0.5**k, 1.0) for k in range(1, TRIALS)]
    if TIME_NAME in setting.acceleration.inputs:
        shares += [(0.5**k, 0.5**k) for k in range(1, TRIALS)]
    for scale, span in shares:
        smaller = setting.smaller(scale, span)
        better = _trial(smaller, law, COARSE)
        if better.rho is not None and better.rho[1] < 1.0:
            starts = _starts(smaller, law, better)
            found.update(starts if isinstance(starts, dict) else {})
            repair = f"a smaller box: {shown(smaller.question.box)}"
            repair += "" if isinstance(starts, dict) else f" ({starts[2]})"
            break
    at = ", ".join(f"{q.labels[n]} = {value:.12g}" for n, value in trial.most.at.items())
    if trial.most.low >= 0.0:
        reason = f"the gap's acceleration is {trial.most.low:.12g} at {at}: it must be below 0"
        return q.answer(RELATIVE_LEMMA, "refuted", reason, repair, **found)
    if trial.rho is None:
        why = trial.most.reason or trial.least.reason or "the bounds are not close enough"
        reason = f"the gap's acceleration could not be shown to be below 0: {why}"
        return q.answer(RELATIVE_LEMMA, "undecided", reason, repair, **found)
    reason = f"r sqrt(M / m) = {trial.rho[1]:.12g} is not below 1"
    return q.answer(
        RELATIVE_LEMMA, "refuted" if trial.rho[0] >= 1.0 else "undecided", reason, repair, **found
    )
