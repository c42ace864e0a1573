"""Interchangeable solvers, chosen by a flag.

``scipy``
    SciPy's methods. DOP853 is the default: eighth order, and an impact's landing is a step
    of the method itself. Radau for stiff flows. BDF and LSODA restart at order one after
    each jump.
``diffrax``
    Diffrax's methods, some steps ahead in each call of a compiled program. Dopri8 is the default;
    Kvaerno5 for stiff flows.
``taylor``
    Taylor series made from the trace, for flows that are not stiff: accurate to rounding where
    no tolerance is given, and of a lower order where one is. To rounding, it is also what a
    run's error bounds are measured with.

A solver only flows (:mod:`.base`). A package of its own adds one by an entry point of the
group ``hybrid.solvers`` (``docs/extending.md``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from ..errors import OptionError
from .base import Solver, Stepper, owner_of

#: What makes a solver from a method and its tolerances: its class, as a rule.
Maker = Callable[..., Solver]

#: Entry points of this group are such callables.
GROUP = "hybrid.solvers"


@cache
def _scipy() -> Maker:
    from .scipy_backend import SciPySolver

    return SciPySolver


@cache
def _taylor() -> Maker:
    from .taylor_backend import TaylorSolver

    return TaylorSolver


def _diffrax() -> Maker:
    from .diffrax_objects import solver_of

    return solver_of


SOLVERS: dict[str, Callable[[], Maker]] = {
    "scipy": _scipy,
    "diffrax": _diffrax,
    "taylor": _taylor,
}


def maker(solver: str) -> Maker:
    """What makes the solver of that name.

    Raises
    ------
    OptionError
        If there is none.
    """
    if isinstance(solver, str) and solver in SOLVERS:
        return SOLVERS[solver]()
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
    """A solver and a method; where the method is now a solver of its own that one, with a warning
    to the caller of the caller."""
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
    """The solver of that name; ``controller`` is a step size controller of Diffrax.

    Raises
    ------
    OptionError
        If there is none, or it has no such method.
    """
    make = maker(solver)
    if controller is not None and solver != "diffrax":
        raise OptionError(f"solver={solver!r}: controller= is for solver='diffrax'")
    made = make(method, rtol, atol) if controller is None else make(method, rtol, atol, controller)
    if not isinstance(made, Solver):
        point = f"{make.__module__}:{getattr(make, '__qualname__', make)}"
        raise OptionError(
            f"solver={solver!r}: its entry point {point} made {made!r}, "
            "which is no hybrid.solvers.Solver"
        )
    made.max_step = max_step
    return made


def own_rtol(solver: str) -> float:
    """The relative tolerance of the solver of that name, where none is given.

    Raises
    ------
    OptionError
        If there is no such solver.
    """
    return float(getattr(maker(solver), "own_rtol", Solver.own_rtol))


def averages(solver: str) -> bool:
    """Whether the solver of that name weighs the mean error of a state."""
    return bool(getattr(maker(solver), "averages", False))


__all__ = ["SOLVERS", "Solver", "Stepper", "averages", "choose", "own_rtol", "renamed"]
