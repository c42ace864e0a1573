"""Interchangeable solvers, chosen by name.

``scipy``
    SciPy's methods. DOP853 is the default: eighth order, and it lands on an impact with a step of
    the method itself. Use Radau for stiff flows. BDF and LSODA restart at order one after each
    jump.
``diffrax``
    Diffrax's methods, several steps per call of a compiled program. Dopri8 is the default; use
    Kvaerno5 for stiff flows.
``taylor``
    Taylor series made from the trace, for flows that are not stiff: accurate to rounding if no
    tolerance is given, of a lower order otherwise. At rounding level it also measures the error
    bounds of runs.

A solver only integrates flows (:mod:`.base`). Another package can add one by an entry point of the
group ``hybrid.solvers`` (``docs/extending.md``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from ..errors import OptionError
from .base import Solver, Stepper, owner_of

#: Makes a solver from a method and its tolerances; usually the solver's class.
Maker = Callable[..., Solver]

#: The entry point group of such callables.
GROUP = "hybrid.solvers"


#: Where the makers of these solvers are; they are imported when they are asked for.
SOLVERS = {
    "scipy": "hybrid.solvers.scipy_backend:SciPySolver",
    "diffrax": "hybrid.solvers.diffrax_objects:solver_of",
    "taylor": "hybrid.solvers.taylor_backend:TaylorSolver",
}


@cache
def _own(solver: str) -> Maker:
    made: Maker = EntryPoint(solver, SOLVERS[solver], GROUP).load()
    return made


def maker(solver: str) -> Maker:
    """The maker of the solver with this name.

    Raises
    ------
    OptionError
        If there is no such solver.
    """
    if isinstance(solver, str) and solver in SOLVERS:
        return _own(solver)
    plugged = {point.name: point for point in entry_points(group=GROUP)}
    if not isinstance(solver, str) or solver not in plugged:
        owner = owner_of(solver)
        known, said = ", ".join([*SOLVERS, *plugged]), ""
        if owner is not None:
            said = f"; {solver} is a method: solver={owner!r}, method={solver!r}"
        raise OptionError(f"solver={solver!r}: there are {known}{said}")
    made: Maker = plugged[solver].load()
    return made


def renamed(solver: str, method: Any) -> tuple[str, Any]:
    """The current solver and method for deprecated names, with a warning at the caller's caller."""
    if solver != "diffrax" or not isinstance(method, str) or method != "Taylor":
        return solver, method
    text = "solver='diffrax', method='Taylor' is now solver='taylor'"
    warnings.warn(text, FutureWarning, stacklevel=3)
    return "taylor", None


def choose(
    solver: str,
    method: Any,
    rtol: float,
    atol: Any,
    max_step: float = float("inf"),
    controller: Any = None,
) -> Solver:
    """The solver with this name; ``controller`` is a step size controller of Diffrax.

    Raises
    ------
    OptionError
        If there is no such solver, or it has no such method.
    """
    make = maker(solver)
    if controller is not None and solver != "diffrax":
        raise OptionError(f"solver={solver!r}: controller= is for solver='diffrax'")
    made = make(method, rtol, atol) if controller is None else make(method, rtol, atol, controller)
    if not isinstance(made, Solver):
        point = f"{make.__module__}:{getattr(make, '__qualname__', make)}"
        raise OptionError(
            f"solver={solver!r}: its entry point {point} made {made!r}, "
            "which is not a hybrid.solvers.Solver"
        )
    made.max_step = max_step
    return made


def own_rtol(solver: str) -> float:
    """The default relative tolerance of a solver.

    Raises
    ------
    OptionError
        If there is no such solver.
    """
    return float(getattr(maker(solver), "own_rtol", Solver.own_rtol))


def averages(solver: str) -> bool:
    """Whether a solver controls the mean error over the elements of the state."""
    return bool(getattr(maker(solver), "averages", False))


__all__ = ["SOLVERS", "Solver", "Stepper", "averages", "choose", "own_rtol", "renamed"]
