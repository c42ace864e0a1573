"""A claim of the paper, our numbers beside it, and the verdict."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from math import floor, isfinite, log10

import attrs

from hybrid.plot.figure import Figure


class Verdict(enum.Enum):
    """What became of a claim."""

    REPRODUCED = "reproduced"
    CORRECTED = "corrected"
    NOT_REPRODUCED = "not reproduced"


def verdict(holds: bool, mended: bool = False) -> Verdict:
    """The verdict on a claim that ``holds`` as printed, or does once it is ``mended``."""
    if holds:
        return Verdict.REPRODUCED
    return Verdict.CORRECTED if mended else Verdict.NOT_REPRODUCED


@attrs.frozen(kw_only=True)
class Number:
    """A number of ours, beside the paper's if it prints one.

    Attributes
    ----------
    what : str
        What it is.
    ours : float, int or str
        Computed in this run.
    error : float or None
        A bound on its error; None for counts and texts, and for floats known to rounding.
    paper : str
        As the paper prints it; empty if it does not.
    """

    what: str
    ours: float | int | str
    error: float | None = None
    paper: str = ""

    def __str__(self) -> str:
        return shown(self.ours, self.error)


def shown(value: float | int | str, error: float | None = None) -> str:
    """A number with the digits that are known: ``1.3296173838386 ± 2e-13``."""
    if isinstance(value, str | int):
        return str(value)
    if error is None or not isfinite(error) or not isfinite(value):
        return f"{value:.15g}"
    if error == 0.0 or value == 0.0:
        return f"{value:.15g} ± {error:.0e}" if error else f"{value:.15g}"
    places = min(-floor(log10(error)), 15 - floor(log10(abs(value))))
    size = floor(log10(abs(value)))
    if size < -4:
        return f"{value:.{max(size + places, 0)}e} ± {error:.0e}"
    return f"{value:.{max(places, 0)}f} ± {error:.0e}"


def rounds_to(value: float, printed: str) -> bool:
    """Whether a number rounds to what is printed, to the digits printed."""
    digits = printed.replace(",", ".").replace("−", "-")
    return f"{value:.{len(digits.partition('.')[2])}f}" == digits


def known(value: float | None) -> float:
    """A number that a certificate gives where it can; NaN where it gives none."""
    return float("nan") if value is None else value


@attrs.frozen(kw_only=True)
class Claim:
    """What the paper says, what was found, and how that was decided.

    Attributes
    ----------
    place : str
        Where in the paper: ``"Section 1, Example 1"``.
    says : str
        The claim in the paper's words, or close to them.
    verdict : Verdict
    found : str
        What we found, in a sentence or two.
    how : str
        How it was decided: what was computed, and what was compared with what.
    numbers : sequence of Number
    figures : sequence of Figure
    """

    place: str
    says: str
    verdict: Verdict
    found: str
    how: str
    numbers: Sequence[Number] = ()
    figures: Sequence[Figure] = ()


@attrs.frozen(kw_only=True)
class Section:
    """A section of the paper: its title, a sentence on the system, its claims."""

    name: str
    title: str
    about: str
    claims: Sequence[Claim]
