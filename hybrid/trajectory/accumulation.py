"""Limit points of jumps, as a run reports them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from math import inf, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.record import Record
from ..lowering.scene import parted
from ..zeno.cycle import period

if TYPE_CHECKING:
    from ..zeno.enclose import Proof

#: What ``t`` may be off, against the time from the first impact of the series on: an error that is
#: no small part of it comes from another series than the one that happens.
THERE = 1e-3

#: Gaps that fall by less than this from one to the next are not said to shrink.
SHRINKS = 1.0 - 1e-9


@attrs.define(eq=False)
class Truncation:
    """What a truncated series leaves out (section 2 of the paper).

    Attributes
    ----------
    impacts : int
        Impacts permitted.
    t_inf : float
        Where the full series would have ended (NaN if it does not accumulate from here).
    gap : float
        ``t_inf`` minus the time of the last impact permitted.
    height : float
        Largest gap in what is left out.
    """

    impacts: int
    t_inf: float
    gap: float
    height: float


@attrs.define(eq=False, repr=False)
class Accumulation:
    """A limit point of jumps.

    Attributes
    ----------
    t : float
        When the jumps accumulate.
    state : Record
        The limit of the state.
    ratio : float
        Limit of the ratio of successive gaps in time.
    edges : tuple of str
        The cycle of edges.
    limits : tuple of (str, Record)
        Where resets move the state: the jumps of a turn in order, and the limit of the state after
        each; the last is ``state``. Empty where all are the same.
    mode : str or None
        The mode entered after it.
    t_release : float or None
        When that mode was left; None if it was not in this run.
    truncation : Truncation or None
        With ``zeno="truncate"``: the distance to the full solution.
    """

    t: float
    state: Record
    ratio: float
    edges: tuple[str, ...]
    _verdict: str = attrs.field(alias="verdict")
    mode: str | None
    j: int
    _enclosure: tuple[float, float] | None = attrs.field(default=None, alias="enclosure")
    t_release: float | None = None
    truncation: Truncation | None = None
    limits: tuple[tuple[str, Record], ...] = ()
    _errors: Any = attrs.field(default=None, alias="errors", repr=False)
    _proofs: Any = attrs.field(default=(), alias="proofs", repr=False)
    _since: float = attrs.field(default=inf, alias="since", repr=False)

    def held_by(self, contact: str) -> bool:
        """Whether it led to a rest that the release of a contact ends: the one whose impacts
        accumulate, or of those in a cycle of edges one that is held."""
        held = parted(self.mode or "")[1]
        return self.edges == (contact,) or (contact in self.edges and contact in held)

    @property
    def proofs(self) -> list[Proof]:
        """Proofs that the impacts accumulate: from an early one on, and narrower from later ones.

        They are looked for when this, ``verdict`` or ``enclosure`` is first read, and need
        python-flint (extra ``certify``). Empty where none succeeds.
        """
        if callable(self._proofs):
            self._proofs = self._proofs() if find_spec("flint") is not None else []
        found: list[Proof] = self._proofs
        return found

    @property
    def _judged(self) -> bool:
        """Whether the verdict is known already."""
        return not callable(self._proofs) and (self.measured or not self._proofs)

    @property
    def narrowest(self) -> Proof:
        """The proof with the narrowest bounds on ``t``."""
        return min(self.proofs, key=lambda proof: proof.high - proof.low)

    @property
    def verdict(self) -> str:
        """How the accumulation is known.

        ``"certified"`` where it is proved from an impact on that was flown, and the runs with
        which this one is compared show it at the same place (``t_error`` is small against the
        time from the first impact of the series on); ``"estimated"`` where the series was
        summed and seen to converge; ``"truncated"`` where ``zeno="truncate"`` cut it off.
        """
        return "certified" if self._proved else self._verdict

    @property
    def _proved(self) -> bool:
        """Whether there is a proof, of a series that happens where it was found."""
        return bool(self.proofs) and self.t_error <= THERE * (self.t - self._since)

    @property
    def enclosure(self) -> tuple[float, float] | None:
        """Bounds on ``t``: the narrowest proved from an impact on, made wider by ``t_error``.

        The proof takes the impact's state as it is given; what the integration before it has
        lost is measured, not proved, and is what ``t_error`` bounds.
        """
        if not self._proved:
            return self._enclosure
        low, high = self.narrowest.low - self.t_error, self.narrowest.high + self.t_error
        return nextafter(low, -inf), nextafter(high, inf)

    @property
    def _error(self) -> tuple[float, Record]:
        if callable(self._errors):
            self._errors = self._errors()
        found: tuple[float, Record] = self._errors
        return found

    @property
    def measured(self) -> bool:
        """Whether ``t_error`` is known already: to ask for it makes runs."""
        return not callable(self._errors)

    @property
    def t_error(self) -> float:
        """Bound on the error of ``t``: of the integration before, and of the closing.

        The first is measured when this is first read, by a second run in Taylor series
        accurate to rounding; infinite if that run does not show the same accumulations.
        """
        return self._error[0]

    @property
    def state_error(self) -> Record:
        """Bound on the error of ``state``, found as ``t_error`` is."""
        return self._error[1]

    def __repr__(self) -> str:
        """What is known; the bound and the verdict where they have been asked for."""
        if self.truncation is not None:
            return explain(self)
        bound = f" ± {self.t_error:.1g}" if self.measured else ""
        verdict = f" ({self.verdict})" if self._judged else ""
        went = f", then {self.mode}" if self.mode else ""
        return (
            f"t_inf = {self.t!r}{bound}{verdict}, state {self.state}, ratio {self.ratio:.6g}{went}"
        )


def unfinished(edges: Sequence[str], times: Sequence[float]) -> str:
    """What a run was doing when ``max_jumps`` was used up, in a sentence."""
    length = period(edges)
    if not length:
        return "The last jumps are no cycle."
    cycle, turns = ", ".join(edges[-length:]), np.array(times)[::-length][:3]
    last, before = turns[0] - turns[1], turns[1] - turns[2]
    text = f"The last jumps are a cycle of {cycle}, {last:.3g} long"
    if not 0 < last < SHRINKS * before:
        return f"{text}, and the one before it was no longer: they do not accumulate."
    ratio = last / before
    end = turns[0] + last * ratio / (1.0 - ratio)
    return (
        f"{text}, {ratio:.6g} times the one before it; if that goes on, they accumulate at about "
        f"t = {end:.9g}. What is done there is zeno='rest', 'stop', 'truncate' or 'raise'."
    )


def explain(point: Accumulation) -> str:
    """One accumulation in a sentence or two; also the message of ``zeno="raise"``."""
    cycle = ", ".join(point.edges)
    if point.truncation is not None:
        cut = point.truncation
        return (
            f"At t = {point.t!r} the series of {cycle} was cut off after {cut.impacts} impacts "
            f"(zeno='truncate') and the contact is held; in full it would have ended at "
            f"t_inf = {cut.t_inf!r}, {cut.gap:.3g} later, after rising {cut.height:.3g} at most."
        )
    chatters = len(point.edges) == 1 and point.ratio < 1.0
    how = "summed by the chatter map" if chatters else "found by sequence acceleration"
    how = f"was {how} ({point.verdict})"
    if point.verdict == "certified":
        first, best = point.proofs[0], point.narrowest
        how += (
            f". It is proved from the impact at t = {first.t:.9g} on: from its gap speed of "
            f"{first.speed:.4g} on the gap's acceleration stays between {-first.M:.6g} and "
            f"{-first.m:.6g}, so that speeds fall to {first.rho:.6g} at most from impact to "
            f"impact; and that t_inf lies between {best.low!r} and {best.high!r}, the error of the "
            "integration before apart"
        )
    then = f"The run went on in {point.mode}" if point.mode else "The run ended there"
    if point.t_release is not None:
        then += f" until it was released at t = {point.t_release!r}"
    counted = point.state.keys()[len(point.state) :]
    if counted:
        then += f", with {', '.join(counted)} as the last jump made has left it"
    pace = f"ratio {point.ratio:.6g}"
    if point.ratio == 1.0:
        pace = "gaps that fall like a power (ratio 1)"
    return (
        f"Jumps of {cycle} accumulate at t_inf = {point.t!r} with {pace}; the "
        f"limit {how}. {then} (zeno='rest' goes on at rest, 'stop' ends the "
        "run, 'truncate' cuts the series, 'raise' makes it an error)."
    )
