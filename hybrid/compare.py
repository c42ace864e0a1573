"""All solvers side by side on one run: what differs, and what of it the tolerance explains.

A difference is explained if it is no larger than what errors of the size of the tolerance,
made at each of some steps, grow to. How errors grow is measured: by a second reference run
from a start a little beside the first.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import attrs
import numpy as np

from .errors import HybridError
from .simulation import simulate
from .trajectory import Trajectory

#: What is run, by label; the first is the reference.
METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"solver": "taylor"},
    "scipy DOP853": {"solver": "scipy", "method": "DOP853"},
    "scipy RK45": {"solver": "scipy", "method": "RK45"},
    "scipy Radau": {"solver": "scipy", "method": "Radau"},
    "scipy LSODA": {"solver": "scipy", "method": "LSODA"},
    "diffrax Dopri8": {"solver": "diffrax", "method": "Dopri8"},
    "diffrax Tsit5": {"solver": "diffrax", "method": "Tsit5"},
    "diffrax Kvaerno5": {"solver": "diffrax", "method": "Kvaerno5"},
    "diffrax Taylor": {"solver": "diffrax", "method": "Taylor"},
}

#: Steps whose errors may add up, and the change of the start that measures their growth.
STEPS, BESIDE = 30, 1e-7

#: Quantities that must be the same, and those that may differ by an explained amount.
SAME = ("edges", "modes", "verdicts")
CLOSE = ("times", "states", "t_inf", "releases")


@attrs.frozen
class Difference:
    """One quantity of one method against the reference.

    Attributes
    ----------
    size : float
        The largest difference; for what must be the same, the number of entries that are not.
    allowed : float
        What the tolerance explains.
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
        A trajectory for each method, or the error it ended in.
    differences : list of Difference
    growth : dict
        By quantity: how much larger an error becomes.
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
    """Run a model with all solvers and methods, and compare.

    Parameters
    ----------
    methods : dict, optional
        Options of :func:`hybrid.simulate` by label; the first is the reference. All of the
        package's if omitted.
    options
        Handed to :func:`hybrid.simulate`.

    Returns
    -------
    Comparison
        Jumps are compared in order; states in the middle of each arc and after each jump.
    """
    chosen = dict(able(model) if methods is None else methods)
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
        for quantity, value in _differences(first, run).items():
            allowed = STEPS * (rtol * size + atol) * growth[quantity] if quantity in CLOSE else 0.0
            rows.append(Difference(label, quantity, value, allowed))
    return Comparison(reference, runs, rows, growth, rtol)


def able(model: Any) -> dict[str, dict[str, Any]]:
    """Those of ``METHODS`` that a model can be run with."""
    delayed = bool(model.spec.lags)
    return {k: c for k, c in METHODS.items() if not (delayed and c.get("method") == "Taylor")}


def _run(model: Any, start: Any, t: Any, options: Any) -> Trajectory | HybridError:
    try:
        return simulate(model, start, t, **options)
    except HybridError as fault:
        return fault


def _growth(model: Any, run: Trajectory, t: Any, options: Any) -> dict[str, float]:
    """By how much an error of the start grows, at least 1."""
    first = run.arcs[0].first
    for sign in (1.0, -1.0):
        x = first + sign * BESIDE * np.maximum(np.abs(first), 1.0)
        beside = _run(model, run.spec.record(x), t, {**options, "mode": run.arcs[0].mode})
        if not isinstance(beside, HybridError):
            found = _differences(run, beside)
            return {name: max(1.0, found[name] / BESIDE) for name in CLOSE}
    return dict.fromkeys(CLOSE, 1.0)


def _differences(a: Trajectory, b: Trajectory) -> dict[str, float]:
    """Each quantity's largest difference between two runs."""
    count = min(len(a.jumps), len(b.jumps))
    times = np.abs(a.jumps.t[:count] - b.jumps.t[:count])
    return {
        "edges": float(np.sum(a.jumps.edge[:count] != b.jumps.edge[:count])),
        "modes": _unequal(_rests(a), _rests(b)),
        "verdicts": _unequal([z.verdict for z in a.zeno], [z.verdict for z in b.zeno]),
        "times": float(times.max(initial=0.0)),
        "states": _states(a, b, count),
        "t_inf": _largest([z.t for z in a.zeno], [z.t for z in b.zeno]),
        "releases": _largest([z.t_release for z in a.zeno], [z.t_release for z in b.zeno]),
    }


def _rests(run: Trajectory) -> list[str]:
    """Modes in order, repetitions left out.

    Of arcs that lead to an accumulation only which modes they have: how many turns of a cycle, or
    impacts of a tail, are listed before its limit does not matter.
    """
    stretches: list[list[str]] = [[] for _ in range(len(run.zeno) + 1)]
    limits = [point.j for point in run.zeno]
    for arc in run.arcs:
        stretches[bisect_right(limits, arc.j)].append(arc.mode)
    *series, last = stretches
    modes = [name for stretch in series for name in sorted(set(stretch))]
    return modes + last[:1] + [new for old, new in pairwise(last) if new != old]


def _states(a: Trajectory, b: Trajectory, count: int) -> float:
    """States in the middle of the arcs and after the jumps, and at the end."""
    largest = _gap(a.arcs[-1].last, b.arcs[-1].last)
    for index in range(count):
        after = [np.concatenate([np.ravel(v) for v in r.jumps[index].after]) for r in (a, b)]
        middle = [r.arcs[index].local(0.5 * r.arcs[index].length) for r in (a, b)]
        largest = max(largest, _gap(*after), _gap(*middle))
    return largest


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(np.abs(a - b)))


def _unequal(a: list[Any], b: list[Any]) -> float:
    return float(sum(p != q for p, q in zip(a, b, strict=False)) + abs(len(a) - len(b)))


def _largest(a: list[Any], b: list[Any]) -> float:
    """The largest difference; infinite where one has what the other lacks."""
    pairs = list(zip(a, b, strict=False))
    if len(a) != len(b) or any((p is None) != (q is None) for p, q in pairs):
        return float("inf")
    return max((abs(p - q) for p, q in pairs if p is not None), default=0.0)
