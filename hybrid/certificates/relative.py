"""The lemma without (C2), asked in coordinates relative to the contact, before a run.

For a gap ``g = b x + phi(t, others)`` whose speed is ``b' v + psi(...)`` with constant ``b``
and ``b'``, position and velocity are functions of gap, gap speed and the rest:

    x = (y - phi) / b,    v = (w - psi) / b'.

They are put into the traces, so the acceleration is bounded as a function of ``y``, ``w``,
the time and the other states. For other gaps the acceleration is bounded over a box of all
states, and the answer says what that leaves open.
"""

from __future__ import annotations

import math
from typing import Any

import attrs

from ..scene.extrema import Bounds, Extreme, ScalarFunction, continuous, extrema
from ..zeno.lemma import chattering, largest_speed
from .question import GAP, SPEED, TIME, Question, Traced
from .result import Certificate, shown
from .setting import constant_slope
from .theorem import COARSE, FINE, TRIALS, edges_fault, restitution_bounds, restitution_fault

STATEMENT = "the lemma without (C2), relative to the contact"


def by_lemma(question: Question) -> Certificate:
    """The certificate by the lemma."""
    height, speed = _own_bounds(question)
    place, fault = _coordinates(question)
    q = question if fault is None else attrs.evolve(question, relative=False)
    setting = Setting(
        q,
        q.function(place(q.laws.acceleration)),
        q.law(place(_itself)),
        q.other_guards(place),
        () if fault else _motion(q, place),
        place,
        height,
        speed,
    )
    q.bounds(setting.acceleration, *setting.motion)
    law = restitution_bounds(setting.law, setting.box())
    faults = [fault, restitution_fault(law), edges_fault(setting.guards, setting.box())]
    faults.append(setting.regularity())
    return _answer(setting, law, next((f for f in faults if f), None))


def _motion(q: Question, place: Any) -> tuple[ScalarFunction, ...]:
    """Gap and gap speed at position 0 and velocity 0: what moves the coordinates."""

    def rest(h: Traced, k: int) -> ScalarFunction:
        return q.function(lambda p, t, z: h(p, t, place(_itself)(p, t, z).at[k].set(0.0)))

    return rest(q.laws.gap, q.position), rest(q.laws.speed, q.velocity)


def _own_bounds(q: Question) -> tuple[float, float]:
    """Bounds of the gap and of the absolute gap speed."""
    for name in (GAP, SPEED):
        if name not in q.box:
            q.refuse(f"box has no bounds for {name!r}; add {name!r}: (0, largest)")
        low, high = q.box[name]
        if low > 0.0 or high <= 0.0 or (name == GAP and low < 0.0):
            q.refuse(f"box {name}=({low}, {high}); a contact is at 0: give {name!r}: (0, largest)")
    return q.box[GAP][1], q.box[SPEED][1]


# ---------------------------------------------------------------------------------------
# coordinates


def _coordinates(q: Question) -> tuple[Any, Any]:
    """``place(h)``: a function of states as one of relative coordinates; or what prevents it."""
    i, j = q.position, q.velocity
    gap, speed = q.function(q.laws.gap), q.function(q.laws.speed)
    slopes = constant_slope(gap, f"x{i}"), constant_slope(speed, f"x{j}")
    single = len(q.laws.pairing.positions) == 1
    if not single or any(b is None or b.contains(0) for b in slopes):
        reason = (
            "the gap is not affine in one position, so the bounds are over the box of states; "
            "that the motion stays in it is not proved"
        )
        return (lambda h: h), ("undecided", reason, "prove it along a run instead")

    def state(parameters: Any, t: Any, z: Any) -> Any:
        import jax
        import jax.numpy as jnp

        def solved(h: Traced, k: int, x: Any) -> Any:
            base = x.at[k].set(0.0)
            along = jnp.zeros_like(x).at[k].set(1.0)
            value, slope = jax.jvp(lambda x: h(parameters, t, x), (base,), (along,))
            return base.at[k].set((z[k] - value) / slope)

        return solved(q.laws.speed, j, solved(q.laws.gap, i, z))

    def place(h: Traced) -> Traced:
        return lambda p, t, z: h(p, t, state(p, t, z))

    return place, None


@attrs.frozen(eq=False)
class Setting:
    """A contact, and what the proof needs as functions of relative coordinates.

    ``place`` turns a function of states into one of these coordinates.
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
        return {**named, "u": (-self.speed, 0.0)}

    def smaller(self, scale: float, span: float) -> Setting:
        """The same on a box with smaller gaps and speeds, and a shorter time."""
        q = self.question
        box = {**q.box, GAP: (0.0, scale**2 * self.height), SPEED: (0.0, scale * self.speed)}
        if TIME in box:
            first, last = box[TIME]
            box[TIME] = (first, first + span * (last - first))
        smaller = attrs.evolve(self, question=attrs.evolve(q, box=box))
        return attrs.evolve(smaller, height=box[GAP][1], speed=box[SPEED][1])

    def drifts(self) -> dict[str, float]:
        """The largest rates of the other states on which the proof depends."""
        q = self.question
        own, found = {q.position, q.velocity}, dict[int, float]()
        queue = [self.acceleration, self.law, *self.motion, *self.guards.values()]
        while queue:
            inputs = queue.pop().inputs
            for k in {int(n[1:]) for n in inputs if n.startswith("x")} - own - set(found):
                rate = self.rate(k)
                q.bounds(rate)
                least, most = extrema(rate, self.box(), COARSE)
                found[k] = max(-least.low, most.high)
                queue.append(rate)
        return {q.spec.element_names[k]: drift for k, drift in found.items()}

    def rate(self, k: int) -> ScalarFunction:
        """The derivative of a state along the flow."""
        flow = self.place(self.question.laws.flow)
        return self.question.function(lambda p, t, z: flow(p, t, z)[k])

    def regularity(self) -> Any:
        """Gap and gap speed, as functions of time and the rest, must not jump."""
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
class Trial:
    """The lemma on one box: the acceleration's extrema, and ``rho`` from below and above."""

    least: Extreme
    most: Extreme
    rho: tuple[float, float] | None


def _trial(setting: Setting, law: Any, tolerance: float) -> Trial:
    from ..scene.balls import high, low

    least, most = extrema(setting.acceleration, setting.box(), tolerance)
    if most.high >= 0.0 or least.low == float("-inf"):
        return Trial(least, most, None)
    above = chattering(1.0, -most.high, -least.low, law[1].high).rho
    under = chattering(1.0, -most.low, -least.high, law[1].low).rho
    return Trial(least, most, (math.nextafter(low(under), 0.0), high(above)))


def _answer(setting: Setting, law: Any, fault: Any) -> Certificate:
    q = setting.question
    found: dict[str, Any] = {"right": 1.0}
    if law is None:
        return q.answer(STATEMENT, *fault, **found)
    found["restitution"] = (law[0].low, law[1].high)
    trial = _trial(setting, law, FINE)
    found.update(m_at=q.named(trial.most.at), M_at=q.named(trial.least.at))
    if trial.rho is not None:
        found.update(m=-trial.most.high, M=-trial.least.low)
        found.update(left=trial.rho[1], margin=1.0 - trial.rho[1])
    if fault is not None:
        return q.answer(STATEMENT, *fault, **found)
    if trial.rho is not None and trial.rho[1] < 1.0:
        found.update(_starts(setting, law, trial))
        if found["initial_set"] is None:
            reason = "the box of times and other states leaves no room for the motion"
            return q.answer(STATEMENT, "undecided", reason, "a wider box", **found)
        reason = "the gap's acceleration and r sqrt(M / m) < 1 are proved on the box"
        return q.answer(STATEMENT, "certified", reason, **found)
    return _smaller(setting, law, trial, found)


def _starts(setting: Setting, law: Any, trial: Trial) -> dict[str, Any]:
    """The largest speed, its times, and what they leave of the box."""
    from ..scene.balls import high, low

    q, r = setting.question, (law[0].low, law[1].high)
    m, M, drifts = -trial.most.high, -trial.least.low, setting.drifts()
    time = _room(q, drifts)
    v = largest_speed(m, M, r, setting.height, setting.speed, time)
    if not v > 0.0:
        return {"initial_set": None}
    remaining = chattering(v, m, M, r).remaining
    assert remaining is not None
    low_, high_ = low(remaining[0]), high(remaining[1])
    start: dict[str, Any] = {GAP: 0.0, SPEED: (0.0, v)}
    for name, (a, b) in q.box.items():
        if name == TIME:
            start[name] = (a, b - high_)
        elif name in drifts:
            start[name] = (a + drifts[name] * high_, b - drifts[name] * high_)
    return {"initial_set": start, "remaining": (low_, high_)}


def _room(q: Question, drifts: dict[str, float]) -> float:
    """How long the motion may last: half the time of the box is left for its start.

    The other states, too, may drift by a quarter of their bounds to either side.
    """
    rooms = [0.5 * (b - a) for name, (a, b) in q.box.items() if name == TIME]
    for name, drift in drifts.items():
        a, b = q.box[name]
        rooms.append(0.25 * (b - a) / drift if drift > 0.0 else float("inf"))
    return min(rooms, default=float("inf"))


def _smaller(setting: Setting, law: Any, trial: Trial, found: dict[str, Any]) -> Certificate:
    """The condition that fails, and a smaller box on which it holds."""
    q, repair = setting.question, "no smaller box was found on which the conditions hold"
    shares = [(0.5**k, 1.0) for k in range(1, TRIALS)]
    if TIME in setting.acceleration.inputs:
        shares += [(0.5**k, 0.5**k) for k in range(1, TRIALS)]
    for scale, span in shares:
        smaller = setting.smaller(scale, span)
        better = _trial(smaller, law, COARSE)
        if better.rho is not None and better.rho[1] < 1.0:
            found.update(_starts(smaller, law, better))
            repair = f"a smaller box: {shown(smaller.question.box)}"
            break
    at = ", ".join(f"{q.labels[n]} = {value:.12g}" for n, value in trial.most.at.items())
    if trial.most.low >= 0.0:
        reason = f"the gap's acceleration is {trial.most.low:.12g} at {at}: it must be below 0"
        return q.answer(STATEMENT, "refuted", reason, repair, **found)
    if trial.rho is None:
        why = trial.most.reason or trial.least.reason or "the bounds are not close enough"
        reason = f"the gap's acceleration could not be shown to be below 0: {why}"
        return q.answer(STATEMENT, "undecided", reason, repair, **found)
    reason = f"r sqrt(M / m) = {trial.rho[1]:.12g} is not below 1"
    return q.answer(
        STATEMENT, "refuted" if trial.rho[0] >= 1.0 else "undecided", reason, repair, **found
    )
