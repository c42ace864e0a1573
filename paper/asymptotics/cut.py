"""Runs of Example 1 that are cut off after ``[1/r]`` impacts, beside full ones."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from math import floor
from typing import Any

import attrs

from hybrid.simulation import simulate

from ..claims import Number
from ..runs import FINE, OTHER, START, twice, without_contact

#: Restitutions of the tables and of the slider.
RATIOS = ("0.8", "0.6", "0.5", "0.4", "1/3", "0.25", "0.2", "0.125", "0.1", "0.05", "0.02")

#: How long all runs are.
SPAN = (0.0, 2.0)

#: How long after the accumulation the reading without a contact is looked at.
LATE = 0.5


@attrs.frozen(eq=False)
class Case:
    """A restitution: the full run, and that cut off after ``[1/r]`` impacts by two methods.

    Attributes
    ----------
    label : str
        The restitution as text, exactly.
    """

    label: str
    model: Any
    full: Any
    run: Any
    again: Any

    @classmethod
    def made(cls, model: Any, label: str) -> Case:
        """The three runs."""
        model = attrs.evolve(model, r=float(Fraction(label)))
        runs = [truncated(model, **options) for options in (FINE, OTHER)]
        return cls(label, model, simulate(model, START, SPAN, **FINE), *runs)

    @property
    def impacts(self) -> int:
        """``[1/r]``, from the exact ratio."""
        return floor(1 / Fraction(self.label))

    @property
    def cuts(self) -> tuple[Any, Any]:
        """What is left out, by two methods."""
        return self.run.zeno[0].truncation, self.again.zeno[0].truncation

    @property
    def gap(self) -> float:
        """``theta_inf - theta_N``."""
        return float(self.cuts[0].gap)

    @property
    def speeds(self) -> tuple[float, float]:
        """The speed after the last permitted impact, by two methods."""
        one, other = (float(r.jumps.after.v[self.impacts - 1]) for r in (self.run, self.again))
        return one, other

    def number(self, what: str, name: str) -> Number:
        """A number of what is left out."""
        one, other = (getattr(cut, name) for cut in self.cuts)
        return twice(f"r = {self.label}: {what}", one, other)

    @cached_property
    def alone(self) -> tuple[Any, Any]:
        """Two runs without a contact after the last impact, to ``LATE`` after ``t_inf``."""
        pairs = zip(self.speeds, self.cuts, (FINE, OTHER), strict=True)
        wall = self.model.wall
        one, other = (
            without_contact(self.model, wall, v, cut.gap + LATE, **o) for v, cut, o in pairs
        )
        return one, other


def truncated(model: Any, impacts: int | None = None, **options: Any) -> Any:
    """A run that is cut off; after ``[1/r]`` impacts, if no number is given."""
    return simulate(model, START, SPAN, zeno="truncate", max_jumps=impacts, **(options or FINE))
