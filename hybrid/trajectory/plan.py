"""What a run was asked for, checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Impacts are summed anew only after their speed has fallen to this share.
PATIENCE = 0.6

#: Impacts of a series before they are summed for the first time.
PATIENT = 2


@attrs.frozen
class Plan:
    """The options of a run.

    Attributes
    ----------
    cap : int or None
        Impacts permitted in a series, with ``zeno="truncate"``.
    dense : bool
        Keep dense output.
    samples : array or None
        Times at which to keep the state.
    memory : "keep" or "restart"
        What delays see after a jump: what was, or the state after it.
    accumulations : int or None
        Stop at this accumulation (a second run, to measure errors).
    closing, patience : float, int
        Tolerance of a tail against the run's, and impacts before the first try at one.
    watchful : int or None
        Hold every step against the flow all along it, at most so many
        (:mod:`hybrid.solvers.watchful`).
    shaken : bool
        Move the states of such a run by what rounding does to forces that act briefly.
    trusted : bool
        Take its steps as they are: a run like it has been held against the flow.
    max_step, first_step : float
        The longest step, and the longest first one of an arc; infinite where they are not limited.
    max_steps : float
        Steps after which the run ends; looked at between arcs, and between calls of the rules' own
        loop.
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
        """Whether the caller bounds the steps."""
        return min(self.max_step, self.first_step) < np.inf

    def longest(self, tau: float) -> float:
        """The longest step from a local time of an arc."""
        return self.max_step if tau else min(self.max_step, self.first_step)
