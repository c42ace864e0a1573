"""The solver interface: a solver integrates flows; events and jumps are handled elsewhere.

A :class:`Solver` holds a method and its tolerances. ``begin`` returns a :class:`Stepper` for one
arc, in the arc's local time ``tau``, which starts at zero. Near an accumulation a step may
therefore be far shorter than the spacing of floats around ``t``.

Contract (tested by ``tests/contract``)
---------------------------------------
* ``step(limit)`` makes one accepted step from ``tau``. It never passes the arc's ``length``; a
  method that can repeat a step stops at ``limit`` too.
* ``segment()`` is the last step's interpolant; it ends at ``tau`` exactly. If no guard is watched
  and no dense output kept, it is not called and costs nothing.
* ``land(tau)`` replaces the last step by one that ends at ``tau``, inside it, as accurately as the
  method can, and returns its segment. The arc ends there: ``step`` is not called again.
* ``finish(length)`` makes one or more steps towards the end of an arc in which nothing is watched,
  and returns their number.
* If the flow is not finite or a step is impossible, :class:`~hybrid.errors.FlowError` is raised
  with the time and state; the driver adds the mode.
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

#: Smallest relative tolerance of a step.
FINEST = 2.3e-14


#: What is said of a flow that has no value where the run leads.
NO_FLOW_HERE = (
    "the flow is not finite; declare an edge that leaves the mode before, or give the flow a value "
    "beyond (jnp.sqrt(jnp.maximum(s.x, 0.0)))"
)

#: What is said where steps get stuck at a jump of the flow.
LEADS_BACK = (
    "where a flow that jumps (sign, where) leads back to the jump from both sides, declare "
    "hy.switching; where it has a root there, as sign(x) * sqrt(abs(x)), and not all states come "
    "to rest for good, give it a finite slope, as x / sqrt(abs(x) + 1e-6)"
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
    """The named method, by default the first of ``known``.

    Raises
    ------
    OptionError
        If the solver has no such method.
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
    """Checked tolerances: ``rtol`` as a number, ``atol`` as a number or one per state element.

    ``rtol`` defaults to the solver's ``own``, and ``atol`` to a hundredth of ``own``.

    Raises
    ------
    OptionError
        If a tolerance is invalid.
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
        Whether :meth:`land` repeats the step, so that stepping may continue from there.
    tau : float
        Local time reached.
    x : array
        State there.
    verifies : bool
        Whether each step verifies itself; otherwise the caller does, once it keeps the step.
    """

    repeats, verifies = False, True
    tau: float
    x: StateVector

    @abc.abstractmethod
    def step(self, limit: float) -> None:
        """Make one accepted step, not beyond local time ``limit``."""

    def verify(self) -> None:  # noqa: B027
        """Raise a :class:`hybrid.FlowError` if the last step does not follow the flow, although the
        method's own error estimate is small."""

    def finish(self, length: float) -> int:
        """Make one or more steps towards ``length``, without segments; returns their number."""
        self.step(length)
        return 1

    @abc.abstractmethod
    def segment(self) -> Segment:
        """The last step's interpolant."""

    @abc.abstractmethod
    def land(self, tau: float) -> Segment:
        """Repeat the last step so that it ends at ``tau``; sets ``self.x``."""

    def arrive(self, tau: float) -> None:
        """Like :meth:`land`, without the segment."""
        self.land(tau)

    def powers(self) -> tuple[float, float, np.ndarray]:
        """The last step's interpolant: start, length, and coefficients in powers of the fraction of
        the step, one row per state element."""
        segment = self.segment()
        return segment.start, segment.length, (to_powers(segment.degree) @ segment.coefficients).T


class Solver(abc.ABC):
    """A method with its tolerances.

    Attributes
    ----------
    name, method : str
    order : int
        Order of the method; the driver uses it to choose an arc's first step.
    whole : bool
        Whether the rules' loop makes these steps, so that it can integrate whole arcs.
    highest : int
        Order of the steps that the loop then makes.
    rejected, evaluations : int or None
        Rejected steps and evaluations of the flow (:class:`hybrid.Stats`); None if not counted.
    max_step : float
        Longest step, for methods that cannot stop at the limit of a step; other steppers receive it
        as that limit.
    asked : bool
        Whether the loop may request steps from its steppers; they have :meth:`Stepper.powers`.
    rtol, atol
        Tolerances of a step; for a method without tolerances, rounding.
    exact : bool
        Whether its steps are accurate to rounding.
    cuts : bool
        Whether it finds formula changes of the flow itself and ends steps there.
    tables : PairTables or None
        Tables of an explicit Runge-Kutta pair, with which the loop makes its steps in lanes.
    own_rtol : float
        Default relative tolerance; the default absolute one is a hundredth of it. A class
        attribute, as it is read before a solver is made.
    """

    own_rtol = 1e-8

    #: Whether it controls the mean error over all elements of the state. A state that does not
    #: change then still counts in the mean, and the tolerances are tightened accordingly.
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
        """Tolerated loss per step of the rules' loop beyond rounding.

        Shape ``(1 + dimension,)``: a relative tolerance, then an absolute one per state element
        (:func:`hybrid.rules.lengths.tolerated_length`).
        """
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

        ``sizes`` is given for a short flight between impacts: the distance that each element will
        move from ``x0``. A method that starts at low order measures its error relative to these.
        """
