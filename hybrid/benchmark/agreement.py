"""All solvers on one run: how they differ, and which differences the tolerance explains.

A difference is explained if it is no larger than what errors of the size of the tolerance, made at
each of some steps, grow to. Error growth is measured by a second reference run from a slightly
perturbed start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from ..errors import HybridError
from ..result import Trajectory
from ..simulation import simulate, whole
from .differences import differences

#: Options of each method, by label; the first is the reference.
COMPARED_METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"solver": "taylor"},
    "scipy DOP853": {"solver": "scipy", "method": "DOP853"},
    "scipy RK45": {"solver": "scipy", "method": "RK45"},
    "scipy Radau": {"solver": "scipy", "method": "Radau"},
    "scipy LSODA": {"solver": "scipy", "method": "LSODA"},
    "diffrax Dopri8": {"solver": "diffrax", "method": "Dopri8"},
    "diffrax Tsit5": {"solver": "diffrax", "method": "Tsit5"},
    "diffrax Kvaerno5": {"solver": "diffrax", "method": "Kvaerno5"},
}

#: Number of steps whose errors may add up, and the relative perturbation of the start that measures
#: error growth.
ERROR_STEPS, GROWTH_PROBE = 30, 1e-7

#: Quantities that must agree, and those that may differ by an explained amount.
SAME_QUANTITIES = ("edges", "modes", "verdicts")
CLOSE_QUANTITIES = ("times", "states", "t_inf", "releases")


@attrs.frozen
class Difference:
    """One quantity of one method compared with the reference.

    Attributes
    ----------
    size : float
        The largest difference; for quantities that must agree, the number of entries that do not.
    allowed : float
        The difference that the tolerance explains.
    """

    method: str
    quantity: str
    size: float
    allowed: float

    @property
    def explained(self) -> bool:
        return self.size <= self.allowed


@attrs.frozen(eq=False)
class Comparison:
    """All methods on one run.

    Attributes
    ----------
    reference : str
    runs : dict
        A trajectory for each method, or the error that it raised.
    differences : list of Difference
    growth : dict
        Growth factor of errors, by quantity.
    """

    reference: str
    runs: dict[str, Trajectory | HybridError]
    differences: list[Difference]
    growth: dict[str, float]
    rtol: float

    @property
    def explained(self) -> bool:
        """Whether every method ran and every difference is explained."""
        failed = any(isinstance(run, HybridError) for run in self.runs.values())
        return not failed and all(d.explained for d in self.differences)

    def worst(self, quantity: str) -> Difference | None:
        """The largest difference in a quantity; None if every other method failed."""
        own = [d for d in self.differences if d.quantity == quantity]
        return max(own, key=lambda d: (not d.explained, d.size), default=None)


def compare(
    model: Any,
    start: Any,
    t: tuple[float, float],
    *,
    rtol: float = 1e-9,
    atol: float = 1e-11,
    methods: Mapping[str, Mapping[str, Any]] | None = None,
    **options: Any,
) -> Comparison:
    """Run a model with all solvers and methods, and compare the results.

    Parameters
    ----------
    rtol, atol : float
        Tolerances of a step, the same for all methods; they determine which differences are
        explained.
    methods : dict, optional
        Options of :func:`hybrid.simulate` by label; the first is the reference. By default all
        methods of the package.
    options
        Passed to :func:`hybrid.simulate`.

    Returns
    -------
    Comparison
        Jumps are compared in order; states in the middle of each arc and after each jump.
    """
    chosen = dict(COMPARED_METHODS if methods is None else methods)
    options = {"rtol": rtol, "atol": atol, **options}
    runs = {label: _run(model, start, t, {**options, **choice}) for label, choice in chosen.items()}
    reference, first = next(iter(runs.items()))
    if isinstance(first, HybridError):
        raise first
    growth = _growth(model, first, t, {**options, **chosen[reference]})
    size = max(1.0, *(float(np.max(np.abs(arc.first))) for arc in first.arcs))
    rows = []
    for label, run in runs.items():
        if label == reference or isinstance(run, HybridError):
            continue
        for quantity, value in differences(first, run).items():
            error = ERROR_STEPS * (rtol * size + atol)
            allowed = error * growth[quantity] if quantity in CLOSE_QUANTITIES else 0.0
            rows.append(Difference(label, quantity, value, allowed))
    return Comparison(reference, runs, rows, growth, rtol)


def _run(model: Any, start: Any, t: Any, options: Any) -> Trajectory | HybridError:
    try:
        return whole(simulate(model, start, t, **options))
    except HybridError as fault:
        return fault


def _growth(model: Any, run: Trajectory, t: Any, options: Any) -> dict[str, float]:
    """Growth factors of an error of the start, at least 1."""
    first = run.arcs[0].first
    for sign in (1.0, -1.0):
        x = first + sign * GROWTH_PROBE * np.maximum(np.abs(first), 1.0)
        beside = _run(model, run.spec.record(x), t, {**options, "mode": run.arcs[0].mode})
        if not isinstance(beside, HybridError):
            found = differences(run, beside)
            return {name: max(1.0, found[name] / GROWTH_PROBE) for name in CLOSE_QUANTITIES}
    return dict.fromkeys(CLOSE_QUANTITIES, 1.0)
