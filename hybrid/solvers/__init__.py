"""Interchangeable solvers, chosen by a flag.

``scipy``
    SciPy's methods. DOP853 is the default: eighth order, and an impact's landing is a step
    of the method itself. Radau for stiff flows. BDF and LSODA restart at order one after
    each jump.
``diffrax``
    Diffrax's methods, compiled: plain arcs, with their events and jumps, run as one program.
    Dopri8 is the default; Kvaerno5 for stiff flows.
``taylor``
    Taylor series of order 16 made from the trace: accurate to rounding whatever the
    tolerance, for flows that are not stiff. It is also what a run's error bounds are
    measured with.

A solver only flows (:mod:`.base`). A package of its own adds one by an entry point of the
group ``hybrid.solvers`` (``docs/extending.md``).
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from ..errors import OptionError
from .base import Solver, Stepper

#: Entry points of this group are callables ``(method, rtol, atol) -> Solver``.
GROUP = "hybrid.solvers"


def _scipy(method: str | None, rtol: float, atol: Any) -> Solver:
    from .scipy_backend import SciPySolver

    return SciPySolver(method, rtol, atol)


def _taylor(method: str | None, rtol: float, atol: Any) -> Solver:
    from .taylor_backend import TaylorSolver

    return TaylorSolver(method, rtol, atol)


def _diffrax(method: str | None, rtol: float, atol: Any) -> Solver:
    from .diffrax_backend import DiffraxSolver

    return DiffraxSolver(method, rtol, atol)


SOLVERS: dict[str, Callable[[str | None, float, Any], Solver]] = {
    "scipy": _scipy,
    "diffrax": _diffrax,
    "taylor": _taylor,
}


def choose(solver: str, method: str | None, rtol: float, atol: Any) -> Solver:
    """The solver of that name.

    Raises
    ------
    OptionError
        If there is none, or it has no such method.
    """
    if isinstance(solver, str) and solver in SOLVERS:
        return SOLVERS[solver](method, rtol, atol)
    plugged = {point.name: point for point in entry_points(group=GROUP)}
    if not isinstance(solver, str) or solver not in plugged:
        raise OptionError(f"solver={solver!r}: there are {', '.join([*SOLVERS, *plugged])}")
    made = plugged[solver].load()(method, rtol, atol)
    if not isinstance(made, Solver):
        raise OptionError(
            f"solver={solver!r}: its entry point {plugged[solver].value} made {made!r}, "
            "which is no hybrid.solvers.Solver"
        )
    return made


__all__ = ["SOLVERS", "Solver", "Stepper", "choose"]
