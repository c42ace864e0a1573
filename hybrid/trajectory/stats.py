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

    Flights shorter than rounding and summed series of impacts take no steps. The additional runs
    that measure errors on demand are not counted.

    Attributes
    ----------
    steps : int
        Accepted steps, including those of arcs that are repeated because of delays.
    rejected : int or None
        Steps that exceeded the tolerances and were repeated with a shorter length. None if it is
        not known: for SciPy's Radau, BDF and LSODA, for arcs that run as one compiled program with
        ``solver="diffrax"``, and for plug-ins that do not count. 0 with Taylor series, where the
        length of a step follows from its coefficients.
    evaluations : int or None
        Evaluations of the flow, including those for Jacobian matrices by differences; with Taylor
        series its expansions, one for each step. None if it is not known: for
        ``solver="diffrax"``, and for plug-ins that do not count.
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
