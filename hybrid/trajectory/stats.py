"""What a run has cost, and what it was made with."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import attrs

#: Packages whose versions have a say in the numbers of a run.
USED = ("numpy", "scipy", "jax", "diffrax", "numba", "python-flint")


@attrs.frozen
class Stats:
    """What a run has cost.

    Steps are the solver's. Flights that are lower than rounding, and series of impacts that are
    summed, have none; the runs that measure errors, which are made when these are asked for, are
    not counted.

    Attributes
    ----------
    steps : int
        Steps that were accepted, those of arcs among them that delays let be flown again.
    rejected : int or None
        Attempts at a step that were made again, shorter: they lost more than the tolerances allow.
        None where it cannot be known: SciPy's Radau, BDF and LSODA do not tell, nor do arcs that
        run as one compiled program with ``solver="diffrax"``, nor solvers that are plugged in and
        do not count. 0 with Taylor series, whose length is known before a step is made.
    evaluations : int or None
        Evaluations of the flow, for Jacobian matrices by differences too; with Taylor series
        expansions of it, one for each step that is tried. None where it cannot be known:
        ``solver="diffrax"``, and solvers that are plugged in and do not count.
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
    """Versions of this package, of Python, and of what computes, as far as it is installed."""
    from .. import __version__

    found = {"hybrid": __version__, "python": platform.python_version()}
    for name in USED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
