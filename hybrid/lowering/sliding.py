"""Laws derived from a surface and the flows on its two sides: the sliding field and its ends.

For a surface ``h(t, x)``, let ``f+`` and ``f-`` be the flows of its sides, and ``a = L_f- h`` and
``b = L_f+ h`` the rates of ``h``, its explicit time dependence included:

* sliding field (Filippov): ``(a f+ - b f-) / (a - b)``, along which the rate of ``h`` is zero;
* sliding ends where ``b`` rises to zero (to the positive side) or ``a`` falls to zero (to the
  negative side);
* projection (drift removal): onto ``h = 0`` along ``f+ - f-``.

The derivations are in ``docs/notes/sliding.md``.
"""

from __future__ import annotations

from typing import Any

import attrs

from ..automaton.trace import Traced
from .contact import lie


@attrs.frozen
class Sliding:
    """The derived functions of one switching, which JAX can trace."""

    surface: Traced
    positive: Traced
    negative: Traced

    def rate(self, side: str) -> Traced:
        """The rate of the surface function along one side's flow."""
        return lie(self.surface, self.positive if side == "positive" else self.negative)

    def field(self, parameters: Any, t: Any, x: Any) -> Any:
        """The sliding (Filippov) field."""
        a, b = (self.rate(side)(parameters, t, x) for side in ("negative", "positive"))
        up, down = self.positive(parameters, t, x), self.negative(parameters, t, x)
        return (a * up - b * down) / (a - b)

    def project(self, parameters: Any, t: Any, x: Any) -> Any:
        """The state projected onto the surface (two Newton steps)."""
        import jax

        across = self.positive(parameters, t, x) - self.negative(parameters, t, x)
        for _ in range(2):
            value, slope = jax.jvp(lambda x: self.surface(parameters, t, x), (x,), (across,))
            x = x - across * (value / slope)
        return x
