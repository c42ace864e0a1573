"""Interchangeable solvers, chosen by a flag.

``scipy``
    SciPy's methods. DOP853 is the default: eighth order, and an impact's landing is a step
    of the method itself. Radau for stiff flows. BDF and LSODA restart at order one after
    each jump.
``taylor``
    Taylor series of order 16 made from the trace: accurate to rounding whatever the
    tolerance, for flows that are not stiff. It is also what a run's error bounds are
    measured with.

A solver only flows (:mod:`.base`); to add one, write those two classes and name it here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import OptionError
from .base import Solver, Stepper


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
    if solver not in SOLVERS:
        raise OptionError(f"solver={solver!r}: there are {', '.join(SOLVERS)}")
    return SOLVERS[solver](method, rtol, atol)


__all__ = ["SOLVERS", "Solver", "Stepper", "choose"]
