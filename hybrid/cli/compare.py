"""All solvers side by side on one run: what differs, and what of it the tolerance explains.

A difference is explained if it is no larger than what errors of the size of the tolerance,
made at each of some steps, grow to. How errors grow is measured: by a second reference run
from a start a little beside the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import zip_longest
from typing import Any, NamedTuple

import attrs
import numpy as np

from ..errors import HybridError
from ..simulation import simulate
from ..trajectory.arcs import Arc, JumpRow
from ..trajectory.trajectory import Trajectory

#: What is run, by label; the first is the reference.
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

#: Steps whose errors may add up, and the relative change of the start that measures their growth.
ERROR_STEPS, GROWTH_PROBE = 30, 1e-7

#: Quantities that must be the same, and those that may differ by an explained amount.
SAME_QUANTITIES = ("edges", "modes", "verdicts")
CLOSE_QUANTITIES = ("times", "states", "t_inf", "releases")


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
    rtol, atol : float
        Tolerances of a step, the same for all: what they explain of a difference is measured by
        them.
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
        for quantity, value in _differences(first, run).items():
            error = ERROR_STEPS * (rtol * size + atol)
            allowed = error * growth[quantity] if quantity in CLOSE_QUANTITIES else 0.0
            rows.append(Difference(label, quantity, value, allowed))
    return Comparison(reference, runs, rows, growth, rtol)


def _run(model: Any, start: Any, t: Any, options: Any) -> Trajectory | HybridError:
    try:
        return simulate(model, start, t, **options)
    except HybridError as fault:
        return fault


def _growth(model: Any, run: Trajectory, t: Any, options: Any) -> dict[str, float]:
    """By how much an error of the start grows, at least 1."""
    first = run.arcs[0].first
    for sign in (1.0, -1.0):
        x = first + sign * GROWTH_PROBE * np.maximum(np.abs(first), 1.0)
        beside = _run(model, run.spec.record(x), t, {**options, "mode": run.arcs[0].mode})
        if not isinstance(beside, HybridError):
            found = _differences(run, beside)
            return {name: max(1.0, found[name] / GROWTH_PROBE) for name in CLOSE_QUANTITIES}
    return dict.fromkeys(CLOSE_QUANTITIES, 1.0)


def _differences(a: Trajectory, b: Trajectory) -> dict[str, float]:
    """Each quantity's largest difference between two runs.

    Arcs and jumps are paired in order, from the start and from each accumulation on.
    """
    empty: list[_Move] = []
    stretches = list(zip_longest(_stretches(a), _stretches(b), fillvalue=empty))
    pairs = [pair for ours, theirs in stretches for pair in zip(ours, theirs, strict=False)]
    jumps = [(p.jump, q.jump) for p, q in pairs if p.jump and q.jump]
    cycles = [set(p.edges) & set(q.edges) for p, q in zip(a.zeno, b.zeno, strict=False)]
    cycles += [set()] * (len(stretches) - len(cycles))
    left = [_left(*each) for each in zip(stretches, cycles, strict=False)]
    return {
        "edges": float(sum(left) + sum(p.edge != q.edge for p, q in jumps)),
        "modes": float(sum(p.arc.mode != q.arc.mode for p, q in pairs)),
        "verdicts": _unequal([z.verdict for z in a.zeno], [z.verdict for z in b.zeno]),
        "times": max([abs(p.t - q.t) for p, q in jumps], default=0.0),
        "states": _states(a, b, [(p, q) for p, q in pairs if p.jump and q.jump]),
        "t_inf": _largest([z.t for z in a.zeno], [z.t for z in b.zeno]),
        "releases": _largest([z.t_release for z in a.zeno], [z.t_release for z in b.zeno]),
    }


class _Move(NamedTuple):
    """An arc, and the jump after it; None where it led to a limit, or to the end of the run."""

    arc: Arc
    jump: JumpRow | None


def _stretches(run: Trajectory) -> list[list[_Move]]:
    """Arcs from one limit to the next, which lies between two arcs of the same ``j``."""
    table = run.jumps.table
    found: list[list[_Move]] = [[]]
    for arc, after in zip_longest(run.arcs, run.arcs[1:]):
        limit = after is not None and after.j == arc.j
        jumped = not limit and arc.j < len(table.t)
        row = JumpRow(*(column[arc.j] for column in table)) if jumped else None
        found[-1].append(_Move(arc, row))
        found += [[]] if limit else []
    return found


def _left(stretch: tuple[list[_Move], list[_Move]], cycle: set[str]) -> int:
    """Jumps beyond those that two runs share in a stretch.

    On the way to an accumulation those of its cycle do not count: how many turns a run goes through
    before it goes over to the limit is its own affair.
    """
    edges = [[step.jump.edge for step in steps if step.jump] for steps in stretch]
    return sum(edge not in cycle for edge in max(edges, key=len)[min(map(len, edges)) :])


def _states(a: Trajectory, b: Trajectory, jumped: list[tuple[_Move, _Move]]) -> float:
    """States in the middle of the arcs and after the jumps, and at the end."""
    largest = _gap(a.arcs[-1].last, b.arcs[-1].last)
    for steps in jumped:
        after = [step.jump.after for step in steps if step.jump]
        middle = [step.arc.local(0.5 * step.arc.length) for step in steps]
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
