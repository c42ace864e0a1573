"""The restitution at the possible impacts: on the contact, at approaching speeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs

from ..bounds.extrema import Bounds, Extreme, ScalarFunction, extrema
from .result import Fault

#: Fractions of the box's largest speed at which to test what the restitution at rest suggests.
HINT_SPEEDS = tuple(0.5**k for k in (1, 4, 10, 30, 100, 300, 900))


@attrs.frozen(eq=False)
class Restitution:
    """Bounds of the restitution over the impacts of a box.

    Attributes
    ----------
    law : ScalarFunction
        The restitution at an impact.
    box : dict
        Bounds of its inputs; the velocity is approaching, with 0 as one end.
    velocity : str
        The input that is this velocity.
    ends : (Extreme, Extreme) or None
        Infimum and supremum; None if the law depends on inputs that the box does not bound.
    """

    law: ScalarFunction
    box: dict[str, Bounds]
    velocity: str
    ends: tuple[Extreme, Extreme] | None

    @classmethod
    def of(cls, law: ScalarFunction, box: dict[str, Bounds], velocity: str) -> Restitution:
        """The restitution on a box."""
        known = law.inputs <= set(box)
        return cls(law, box, velocity, extrema(law, box) if known else None)

    @property
    def bounds(self) -> Bounds | None:
        """The proved bounds."""
        return self.ends and (self.ends[0].low, self.ends[1].high)

    def fault(self) -> Fault | None:
        """The fault unless the restitution is strictly between 0 and 1; only impacts refute."""
        if self.ends is None:
            reason = "the restitution depends on the time or on states without bounds here"
            return "undecided", reason, "a restitution of the contact's own position and speed"
        least, most = self.ends
        if least.low > 0.0 and most.high < 1.0:
            return None
        wrong = (most.low >= 1.0 and self.happens(most, lambda r: bool(r >= 1))) or (
            least.high <= 0.0 and self.happens(least, lambda r: bool(r <= 0))
        )
        reason = (
            "the restitution must lie strictly between 0 and 1; at the impacts of the box it lies "
            f"in [{least.low!r}, {most.high!r}]"
        )
        verdict = "refuted" if wrong else "undecided"
        return verdict, reason, "choose a restitution strictly between 0 and 1"

    def happens(self, extreme: Extreme, wrong: Callable[[Any], bool]) -> bool:
        """Whether an impact has this value; at zero speed there is none, so try nearby ones."""
        if extreme.at.get(self.velocity, 1.0) != 0.0:
            return True
        low, high = self.box[self.velocity]
        points = [{**extreme.at, self.velocity: share * (low + high)} for share in HINT_SPEEDS]
        values = [self.law.at(point) for point in points]
        return any(value is not None and wrong(value) for value in values)
