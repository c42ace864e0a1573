"""Time in two floats, so that durations below the spacing of floats around ``t`` add up."""

from __future__ import annotations

import attrs


@attrs.frozen
class Instant:
    """The time ``t + low``, with ``|low|`` at most half a spacing of ``t``."""

    t: float
    low: float = 0.0

    def after(self, duration: float) -> Instant:
        """This instant plus a duration, in compensated arithmetic (two-sum, Knuth)."""
        total = self.t + duration
        back = total - self.t
        low = (self.t - (total - back)) + (duration - back) + self.low
        t = total + low
        return Instant(t, low - (t - total))

    def until(self, t: float) -> float:
        """Duration from this instant to ``t``."""
        return (t - self.t) - self.low
