"""The checked options of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: After a failed sum, the next one is tried when the impact speed has fallen to this fraction.
PATIENCE = 0.6

#: Impacts of a series before the first attempt at a sum.
PATIENT = 2


@attrs.frozen
class Plan:
    """The options of a run.

    Attributes
    ----------
    t0, t1, rtol, atol, zeno, max_jumps, progress
        As for :func:`hybrid.simulate`.
    cap : int or None
        With ``zeno="truncate"``: number of impacts after which a series is cut off.
    dense : bool
        Whether to keep dense output.
    samples : array or None
        Times at which to keep the state.
    memory : "keep" or "restart"
        What delays see after a jump: the recorded past, or the state after the jump.
    accumulations : int or None
        Number of accumulations after which to stop (in a second run, which measures errors).
    closing, patience : float, int
        Tolerance of a sum relative to the run's, and impacts before the first attempt at a sum.
    watchful : int or None
        Verify the defect of every step, for at most this many steps
        (:mod:`hybrid.solvers.watchful`).
    shaken : bool
        In a watchful run: perturb the states by the effect of rounding, on brief forces and on the
        gaps at impacts that alternate.
    trusted : bool
        In a watchful run: accept steps unverified, as those of a similar run have been verified.
    max_step, first_step : float
        Longest step, and longest first step of an arc; infinite if not limited.
    max_steps : float
        Number of steps after which the run ends; checked between arcs and between calls of the
        rules' loop.
    """

    t0: float
    t1: float
    rtol: float
    atol: Any
    zeno: str
    max_jumps: int
    cap: int | None
    dense: bool
    samples: Numbers | None
    progress: Callable[[float], None] | None
    memory: str = "keep"
    accumulations: int | None = None
    closing: float = 1.0
    patience: int = PATIENT
    watchful: int | None = None
    shaken: bool = False
    trusted: bool = False
    max_step: float = np.inf
    first_step: float = np.inf
    max_steps: float = np.inf

    @property
    def limit(self) -> float:
        """The largest absolute tolerance."""
        return self.atol if isinstance(self.atol, float) else float(np.max(self.atol))

    @property
    def bounded(self) -> bool:
        """Whether the caller limits the step length."""
        return min(self.max_step, self.first_step) < np.inf

    def longest(self, tau: float) -> float:
        """The longest step from local time ``tau`` of an arc."""
        return self.max_step if tau else min(self.max_step, self.first_step)
