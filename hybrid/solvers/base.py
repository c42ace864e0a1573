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
* ``finish(length)`` makes one step or many towards the end, where nobody looks at them, and
  returns how many.
* A flow that is not finite, or a step that cannot be made, raises
  :class:`~hybrid.errors.FlowError` with the time and state; the driver adds the mode.
"""

from __future__ import annotations

import abc
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton.reals import real, reals
from ..errors import OptionError
from ..segment import Segment, to_powers

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Field
    from .pairs import PairTables

#: No step can be held to less, relative to the state.
FINEST = 2.3e-14


#: What is said of a flow that has no value where the run leads.
NO_FLOW_HERE = (
    "the flow is not finite; declare an edge that leaves the mode before, or give the flow a value "
    "beyond (jnp.sqrt(jnp.maximum(s.x, 0.0)))"
)

#: What is said where steps get stuck at a jump of the flow.
LEADS_BACK = (
    "where a flow that jumps (sign, where) leads back to the jump from both sides, declare "
    "hy.switching"
)


#: The methods of the solvers that have several.
METHOD_NAMES = {
    "scipy": ("DOP853", "RK45", "RK23", "Radau", "BDF", "LSODA"),
    "diffrax": (
        *("Dopri8", "Tsit5", "Dopri5", "Bosh3", "Heun", "Midpoint", "Ralston"),
        *("Kvaerno3", "Kvaerno4", "Kvaerno5"),
    ),
}


def method_of(solver: str, method: str | None, known: Iterable[str]) -> str:
    """The method named, or the first that a solver has.

    Raises
    ------
    OptionError
        If it has no such method.
    """
    names = list(known)
    if method is not None and method not in names:
        owner, said = owner_of(method), ""
        if method == "taylor":
            said = "; write solver='taylor'"
        elif owner is not None:
            said = f"; {method} is one of solver={owner!r}"
        raise OptionError(f"method={method!r}: solver {solver!r} has {', '.join(names)}{said}")
    return method or names[0]


def owner_of(method: Any) -> str | None:
    """The solver that has a method of that name."""
    owners = (owner for owner, names in METHOD_NAMES.items() if method in names)
    return next(owners, None) if isinstance(method, str) else None


#: What stands for ``atol=0``: a state that is 0 has no relative error, and methods divide by it.
LEAST_ATOL = float(np.finfo(float).tiny)


def tolerances(rtol: Any, atol: Any, dimension: int, own: float) -> tuple[float, np.ndarray]:
    """Tolerances of a step: a number, and a number or one for each element of the state.

    Where none is given ``rtol`` is the solver's ``own``, and ``atol`` a hundredth of that.

    Raises
    ------
    OptionError
        If they are not that.
    """
    if rtol is None and atol is None:
        return own, np.array(own / 100)
    try:
        relative = own if rtol is None else real(rtol)
    except ValueError:
        relative = 0.0
    if not 0 < relative < 1:
        raise OptionError(f"rtol={rtol!r}: a number between 0 and 1")
    try:
        absolute = np.array(own / 100) if atol is None else reals(atol)
    except ValueError:
        absolute = np.array(-1.0)
    if absolute.shape not in ((), (dimension,)) or not np.all(absolute >= 0):
        raise OptionError(
            f"atol={atol!r}: a number, or one for each of the {dimension} elements of the state"
        )
    return relative, np.maximum(absolute, LEAST_ATOL)


class Stepper(abc.ABC):
    """Steps along one arc.

    Attributes
    ----------
    repeats : bool
        Whether :meth:`land` makes the step anew, so that steps may go on from there.
    """

    repeats = False
    tau: float
    x: StateVector

    @abc.abstractmethod
    def step(self, limit: float) -> None:
        """One accepted step, not beyond local time ``limit``."""

    def finish(self, length: float) -> int:
        """As many steps at once as suit it, and how many; nobody asks for their segments."""
        self.step(length)
        return 1

    @abc.abstractmethod
    def segment(self) -> Segment:
        """The last step's interpolant."""

    @abc.abstractmethod
    def land(self, tau: float) -> Segment:
        """The last step again, ending at ``tau``; sets ``self.x``."""

    def arrive(self, tau: float) -> None:
        """As :meth:`land`, where nobody asks for the segment."""
        self.land(tau)

    def powers(self) -> tuple[float, float, np.ndarray]:
        """The last step's interpolant: where it begins, how long it is, and its coefficients by
        powers of the fraction of the step, a row for each element of the state."""
        segment = self.segment()
        return segment.start, segment.length, (to_powers(segment.degree) @ segment.coefficients).T


class Solver(abc.ABC):
    """A method with its tolerances.

    Attributes
    ----------
    name, method : str
    order : int
        Order of the method; the driver chooses an arc's first step by it.
    whole : bool
        Whether the rules' own loop makes these steps, so that it can fly whole arcs.
    highest : int
        The order of the steps that it then makes.
    rejected, evaluations : int or None
        Attempts at a step that failed, and evaluations of the flow (:class:`hybrid.Stats`), of one
        that counts them.
    max_step : float
        The longest step. Those that can stop at the limit of a step are given one: it is for those
        that cannot.
    asked : bool
        Whether that loop may ask its steppers for steps: they have :meth:`Stepper.powers`.
    rtol, atol
        What a step may lose; rounding, of a method that knows no tolerances.
    exact : bool
        Whether its steps are accurate to rounding.
    cuts : bool
        Whether it looks itself for the places at which a flow changes its formula, and ends steps
        there.
    tables : PairTables or None
        Of an explicit Runge-Kutta pair, with which that loop makes its steps in lanes.
    own_rtol : float
        The relative tolerance where the caller gives none; the absolute one is then a hundredth
        of it. Of the class, for it is asked before one is made.
    """

    own_rtol = 1e-8

    #: Whether it holds the mean error of all elements of the state to the tolerances: one that
    #: rests then counts among them, and they are tightened by as much.
    averages = False

    name: str
    method: str
    order: int
    whole: bool = False
    highest: int
    rejected: int | None = None
    evaluations: int | None = None
    max_step: float = float("inf")
    asked: bool = True
    exact: bool = False
    cuts: bool = False
    tables: PairTables | None = None
    rtol: float = FINEST
    atol: Any = 0.0

    def loss(self, dimension: int) -> np.ndarray:
        """What a step of the rules' own may lose beyond rounding: a share of each element of the
        state, and a number for each (:func:`hybrid.rules.lengths.tolerated_length`)."""
        return np.zeros(1 + dimension)

    @abc.abstractmethod
    def begin(
        self,
        field: Field,
        t0: float,
        x0: StateVector,
        length: float,
        first_step: float | None,
        sizes: np.ndarray | None = None,
    ) -> Stepper:
        """A stepper for an arc of at most ``length`` from ``(t0, x0)``.

        ``sizes`` is given for a short flight between impacts: how far each element will go
        from ``x0``. A method that starts at low order measures its error against them.
        """
