"""Limit points of jumps, as a run reports them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from math import inf, isnan, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.chance import DRAWS
from ..automaton.record import Record
from ..lowering.scene import parted
from ..zeno.cycle import period

if TYPE_CHECKING:
    from ..zeno.enclose import Proof

#: Largest ``t_error`` of a certified accumulation, relative to the time from the first impact of
#: the series to the limit. A larger error would allow for a different series.
THERE = 1e-3

#: Ratio of successive durations of a cycle up to which they count as shrinking.
SHRINKS = 1.0 - 1e-9


@attrs.define(eq=False)
class Truncation:
    """The part of a series that ``zeno="truncate"`` leaves out (section 2 of the paper).

    Attributes
    ----------
    impacts : int
        Impacts permitted.
    t_inf : float
        End of the full series (NaN if it does not accumulate within the run, with no other jump
        before).
    gap : float
        ``t_inf`` minus the time of the last permitted impact.
    height : float
        Largest gap in the omitted part.
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
        Time at which the jumps accumulate.
    state : Record
        The limit of the state.
    ratio : float
        Limit of the ratio of successive gaps in time; NaN if the restitution draws random numbers.
    edges : tuple of str
        The edges of one turn of the cycle; for impacts of one contact, the contact.
    limits : tuple of (str, Record)
        If resets move the state: the jumps of a turn in order, each with the limit of the state
        after it; the last limit is ``state``. Otherwise empty.
    mode : str or None
        The mode entered after the accumulation; None if the run ended there.
    t_release : float or None
        Time at which that mode was left; None if it was not left in this run.
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

    def stays(self, mode: str) -> bool:
        """Whether an arc in a mode belongs to what followed this accumulation: it is that mode, and
        of the cycle's contacts it holds all that were held then."""
        (base, held), (own, then) = parted(mode), parted(self.mode or "")
        return base == own and set(then) & set(self.edges) <= set(held)

    @property
    def proofs(self) -> list[Proof]:
        """Proofs that the impacts accumulate, with increasingly narrow bounds; empty if none
        succeeds.

        They start from successive impacts. They are computed when this, ``verdict`` or
        ``enclosure`` is first read, and need python-flint (extra ``certify``).
        """
        if callable(self._proofs):
            self._proofs = self._proofs() if find_spec("flint") is not None else []
        found: list[Proof] = self._proofs
        return found

    @property
    def _judged(self) -> bool:
        """Whether the verdict is known without further computation."""
        return not callable(self._proofs) and (self.measured or not self._proofs)

    @property
    def narrowest(self) -> Proof:
        """The proof with the narrowest bounds on ``t``.

        Raises
        ------
        ValueError
            If there is none: nothing was proved, or the run comes from a file, which keeps the
            ``enclosure`` alone.
        """
        if not self.proofs:
            raise ValueError(
                "this accumulation has no proofs: it was not certified, or comes from a file, "
                "which keeps its enclosure alone"
            )
        return min(self.proofs, key=lambda proof: proof.high - proof.low)

    @property
    def verdict(self) -> str:
        """How the accumulation is known.

        ``"certified"`` if it is proved from an integrated impact on, and the comparison runs
        accumulate at the same time (``t_error`` is small relative to the time since the first
        impact of the series); ``"estimated"`` if the series was summed and converged numerically;
        ``"truncated"`` if ``zeno="truncate"`` cut it off.
        """
        return "certified" if self._proved else self._verdict

    @property
    def _proved(self) -> bool:
        """Whether there is a proof, and the comparison runs confirm the series."""
        return bool(self.proofs) and self.t_error <= THERE * (self.t - self._since)

    @property
    def enclosure(self) -> tuple[float, float] | None:
        """Bounds on ``t``: the narrowest proved ones, widened by ``t_error``.

        The proof takes the state at the impact as exact. The error of the integration before it is
        measured rather than proved, and ``t_error`` bounds it.
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
        """Whether ``t_error`` is known without further runs."""
        return not callable(self._errors)

    @property
    def t_error(self) -> float:
        """Bound on the error of ``t``, from the integration and from the summation.

        The error of the integration is measured when this is first read, by a second run with
        Taylor series accurate to rounding; it is infinite if that run has other accumulations.
        """
        return self._error[0]

    @property
    def state_error(self) -> Record:
        """Bound on the error of ``state``, found as ``t_error`` is."""
        return self._error[1]

    def __repr__(self) -> str:
        """The accumulation in one line; bound and verdict only if they have been computed."""
        if self.truncation is not None:
            return explain(self)
        bound = f" ± {self.t_error:.1g}" if self.measured else ""
        verdict = f" ({self.verdict})" if self._judged else ""
        went = f", then {self.mode}" if self.mode else ""
        return (
            f"t_inf = {self.t!r}{bound}{verdict}, state {self.state}, ratio {self.ratio:.6g}{went}"
        )


def unfinished(edges: Sequence[str], times: Sequence[float]) -> str:
    """A sentence on the last jumps of a run that stopped at ``max_jumps``."""
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
        return _explain_truncation(point, point.truncation)
    chatters = len(point.edges) == 1 and point.ratio < 1.0
    how = "summed by the chatter map" if chatters else "found by sequence acceleration"
    if isnan(point.ratio):
        how = "reached by computing all impacts down to rounding"
    how = f"was {how} ({point.verdict})"
    if point.verdict == "certified" and point.proofs:  # a file keeps none
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
    elif isnan(point.ratio):
        drawn = DRAWS in point.state.keys()
        pace = "gaps that fall at random" if drawn else "gaps that fall by no one ratio"
    return (
        f"Jumps of {cycle} accumulate at t_inf = {point.t!r} with {pace}; the "
        f"limit {how}. {then} (zeno='rest' goes on at rest, 'stop' ends the "
        "run, 'truncate' cuts the series, 'raise' makes it an error)."
    )


def _explain_truncation(point: Accumulation, cut: Truncation) -> str:
    ended = f"have ended at t_inf = {cut.t_inf!r}, {cut.gap:.3g} later"
    if isnan(cut.t_inf):
        ended = "have gone on to another jump or to the end of the run"
    return (
        f"At t = {point.t!r} the series of {', '.join(point.edges)} was cut off after "
        f"{cut.impacts} impacts (zeno='truncate') and the contact is held; in full it would "
        f"{ended}, after rising {cut.height:.3g} at most."
    )
