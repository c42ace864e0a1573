"""The cost of a run, and the versions of the packages used."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import attrs

#: Packages whose versions affect the numbers of a run.
USED = ("numpy", "scipy", "jax", "diffrax", "numba", "python-flint")


@attrs.frozen
class Stats:
    """The cost of a run.

    Steps are the solver's. Flights below rounding and summed series of impacts need none. Runs that
    measure errors are made on request and not counted.

    Attributes
    ----------
    steps : int
        Accepted steps, including those of arcs that delays require to be repeated.
    rejected : int or None
            Steps that were repeated with a shorter length because their error exceeded the
        tolerances. None if unknown: SciPy's Radau, BDF and LSODA, arcs that run as one compiled
        program with ``solver="diffrax"``, and plugged-in solvers that do not count. 0 with Taylor
        series, whose step length is known in advance.
    evaluations : int or None
            Evaluations of the flow, including those for finite-difference Jacobians; with Taylor
        series, expansions of the flow, one per step tried. None if unknown: ``solver="diffrax"``,
        and plugged-in solvers that do not count.
    seconds : float
        Wall time in :func:`hybrid.simulate`, compilation included, in seconds.
    """

    steps: int
    rejected: int | None
    evaluations: int | None
    seconds: float

    def __str__(self) -> str:
        rejected, evaluations = (
            "not counted" if count is None else f"{count:,}"
            for count in (self.rejected, self.evaluations)
        )
        return (
            f"{self.steps:,} steps, rejected: {rejected}; evaluations of the flow: {evaluations}; "
            f"{self.seconds:.3g} s"
        )


@cache
def versions() -> dict[str, str]:
    """Versions of this package, of Python, and of the installed numerical packages."""
    from .. import __version__

    found = {"hybrid": __version__, "python": platform.python_version()}
    for name in USED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
