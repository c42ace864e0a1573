"""What a solver must do: flow. Events, jumps and accumulations are not its business.

A :class:`Solver` holds a method and its tolerances. ``begin`` gives a :class:`Stepper` for
one arc, in the arc's local time ``tau`` (zero at its start): so a step near an accumulation
may be far shorter than the spacing of floats around ``t``.

Contract (held by ``tests/contract``)
-------------------------------------
* ``step(limit)`` makes one accepted step from ``tau``. It never passes the arc's
  ``length``; a method that can repeat a step stops at ``limit`` too.
* ``segment()`` is the last step's interpolant; its end is ``tau``, exactly. Where nobody
  watches a guard or keeps dense output it is not asked for, and costs nothing.
* ``land(tau)`` replaces the last step by one that ends at ``tau``, inside it, as
  accurately as the method can, and returns its segment. The arc ends there: ``step`` is
  not called again.
* ``finish(length)`` makes all steps to the end at once, where nobody looks at them.
* A flow that is not finite, or a step that cannot be made, raises
  :class:`~hybrid.errors.FlowError` with the time and state; the driver adds the mode.
"""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, Any

import numpy as np

from ..segment import Segment

if TYPE_CHECKING:
    from ..scene import Field


class Stepper(abc.ABC):
    """Steps along one arc."""

    tau: float
    x: np.ndarray

    @abc.abstractmethod
    def step(self, limit: float) -> None:
        """One accepted step, not beyond local time ``limit``."""

    def finish(self, length: float) -> None:
        """All steps to the end of the arc; nobody asks for their segments."""
        while self.tau < length:
            self.step(length)

    @abc.abstractmethod
    def segment(self) -> Segment:
        """The last step's interpolant."""

    @abc.abstractmethod
    def land(self, tau: float) -> Segment:
        """The last step again, ending at ``tau``; sets ``self.x``."""


class Solver(abc.ABC):
    """A method with its tolerances.

    Attributes
    ----------
    name, method : str
    order : int
        Order of the method; the driver chooses an arc's first step by it.
    compiled : object or None
        The method as a pure function (:class:`.diffrax_backend.Method`), where whole streaks
        of arcs can be compiled with it.
    """

    name: str
    method: str
    order: int
    compiled: Any = None

    @abc.abstractmethod
    def begin(
        self,
        field: Field,
        t0: float,
        x0: np.ndarray,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        """A stepper for an arc of at most ``length`` from ``(t0, x0)``.

        ``sizes`` is given for a short flight between impacts: how far each element will go
        from ``x0``. A method that starts at low order measures its error against them.
        """
