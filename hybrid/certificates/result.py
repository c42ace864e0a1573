"""The answer to :func:`hybrid.certify`."""

from __future__ import annotations

from typing import Any

import attrs

Bounds = tuple[float, float]

#: What prevents a proof: verdict, reason, repair.
Fault = tuple[str, str, str]


@attrs.frozen(kw_only=True)
class Certificate:
    """What was proved, with the numbers on which it rests; each bound is rounded outward.

    Attributes
    ----------
    verdict : "certified", "refuted" or "undecided"
    statement : str
        The statement in question: Theorem 1, or the lemma without (C2).
    m, M : float or None
        ``-M <= a < -m`` on the box, where ``a`` is the gap's acceleration in free flight (the
        force, if the gap is ``x - phi``). Theorem 1 demands the strict ``a < -m``, so its ``m`` is
        the float below what was proved.
    m_at, M_at : dict
        Points at which the acceleration comes closest to ``-m`` and ``-M``.
    left, right, margin : float or None
        Theorem 1: ``M sqrt(2 (h - phi) / m)``, the largest speed of the box, and their difference.
        Lemma: ``rho = r sqrt(M / m)``, 1, and their difference.
    m_range : (float, float) or None
        Theorem 1: every ``m`` strictly between these is valid.
    restitution : (float, float) or None
        Bounds of the restitution on the box.
    remaining : (float, float) or None
        Lemma: bounds of the time to the accumulation, for a motion that leaves the contact with gap
        speed ``initial_set["speed"][1]``; they are proportional to that speed.
    reason : str
        The reason; if refuted, the condition that fails and where.
    repair : str
        The remedy; empty if certified.
    initial_set : dict or None
        Initial data from which all motions are proved to chatter. Theorem 1: positions strictly
        between these bounds, with velocity 0. This is the whole box or, if that failed, the part up
        to the largest height found for which all conditions hold (by bisection, each trial a
        proof). Lemma: gap 0 and gap speeds from 0 (excluded) up to a bound, leaving the contact, at
        times and with other states within these bounds; the motion then stays in the box. The speed
        is the largest for which it takes at most half the box's time.
    """

    model: str
    contact: str
    box: dict[str, Bounds]
    statement: str
    verdict: str
    reason: str
    repair: str = ""
    m: float | None = None
    M: float | None = None
    m_at: dict[str, float] = attrs.field(factory=dict)
    M_at: dict[str, float] = attrs.field(factory=dict)
    left: float | None = None
    right: float | None = None
    margin: float | None = None
    m_range: Bounds | None = None
    restitution: Bounds | None = None
    remaining: Bounds | None = None
    initial_set: dict[str, Any] | None = None

    def __str__(self) -> str:
        lines = [
            f"{self.verdict}: {self.model}, contact {self.contact}, {self.statement}, "
            f"on {shown(self.box)}",
            f"  {self.reason}",
        ]
        if self.m is not None and self.M is not None:
            lines.append(
                f"  acceleration of the gap < -m = {-self.m!r} (closest at {shown(self.m_at)}), "
                f">= -M = {-self.M!r} (at {shown(self.M_at)})"
            )
        if self.left is not None:
            lines.append(f"  left {self.left!r}, right {self.right!r}, margin {self.margin:.6g}")
        if self.m_range is not None:
            lines.append(f"  any m strictly between {self.m_range[0]!r} and {self.m_range[1]!r}")
        if self.remaining is not None:
            low, high = self.remaining
            lines.append(f"  time to the accumulation between {low!r} and {high!r}")
        if self.initial_set is not None:
            lines.append(f"  proved to chatter from {shown(self.initial_set)}")
        if self.repair:
            lines.append(f"  repair: {self.repair}")
        return "\n".join(lines)


def shown(bounds: dict[str, Any]) -> str:
    """Names with their values or bounds, as text."""
    parts = []
    for name, value in bounds.items():
        if isinstance(value, tuple):
            parts.append(f"{name} in ({value[0]:.12g}, {value[1]:.12g})")
        else:
            parts.append(f"{name} = {value:.12g}")
    return ", ".join(parts) or "any point"
