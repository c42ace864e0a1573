"""What follows from a surface and the two flows on its sides: the sliding field and its ends.

For a surface ``h(t, x)``, the flows ``f+`` and ``f-`` of its two sides, and the rates
``a = L_f- h`` and ``b = L_f+ h`` (the surface's own motion included):

* sliding field (Filippov): ``(a f+ - b f-) / (a - b)``, along which the rate of ``h`` is zero;
* it ends where ``b`` rises to zero (into the positive side) or ``a`` falls to zero (into the
  negative side);
* projection: back onto ``h = 0`` along ``f+ - f-``, as more of one flow would (drift removal).

The derivations are in ``docs/notes/sliding.md``.
"""

from __future__ import annotations

from typing import Any

import attrs

from ..automaton.trace import Traced
from .contact import lie


@attrs.frozen
class Sliding:
    """The derived functions of one switching, ready to be traced."""

    surface: Traced
    positive: Traced
    negative: Traced

    def rate(self, side: str) -> Traced:
        """The rate of the surface function under the flow of a side."""
        return lie(self.surface, self.positive if side == "positive" else self.negative)

    def field(self, parameters: Any, t: Any, x: Any) -> Any:
        """The flow on the surface."""
        a, b = (self.rate(side)(parameters, t, x) for side in ("negative", "positive"))
        up, down = self.positive(parameters, t, x), self.negative(parameters, t, x)
        return (a * up - b * down) / (a - b)

    def project(self, parameters: Any, t: Any, x: Any) -> Any:
        """The state moved onto the surface (two Newton steps)."""
        import jax

        across = self.positive(parameters, t, x) - self.negative(parameters, t, x)
        for _ in range(2):
            value, slope = jax.jvp(lambda x: self.surface(parameters, t, x), (x,), (across,))
            x = x - across * (value / slope)
        return x
