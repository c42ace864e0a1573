"""How two runs of a model differ: jumps in order, states, accumulations."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..result import Trajectory
from ..trajectory.arcs import Arc, JumpRow

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers


def differences(a: Trajectory, b: Trajectory) -> dict[str, float]:
    """The largest difference of each quantity between two runs.

    Arcs and jumps are paired in order, starting anew at each accumulation. The times are those of
    jumps and of the end.
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
        "modes": float(sum(p.arc.mode != q.arc.mode for p, q in pairs) + (a.mode != b.mode)),
        "verdicts": _unequal([z.verdict for z in a.zeno], [z.verdict for z in b.zeno]),
        "times": max([abs(a.t1 - b.t1), *(abs(p.t - q.t) for p, q in jumps)]),
        "states": _states(a, b, [(p, q) for p, q in pairs if p.jump and q.jump]),
        "t_inf": _largest([z.t for z in a.zeno], [z.t for z in b.zeno]),
        "releases": _largest([z.t_release for z in a.zeno], [z.t_release for z in b.zeno]),
    }


class _Move(NamedTuple):
    """An arc, and the jump that ends it; None if it ended at a limit or with the run."""

    arc: Arc
    jump: JumpRow | None


def _stretches(run: Trajectory) -> list[list[_Move]]:
    """Groups of arcs between limits; a limit separates two arcs with the same ``j``."""
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
    """Number of jumps beyond those that two runs share in a stretch.

    Near an accumulation, jumps of its cycle do not count, since each run decides after how many
    turns to pass to the limit.
    """
    edges = [[step.jump.edge for step in steps if step.jump] for steps in stretch]
    return sum(edge not in cycle for edge in max(edges, key=len)[min(map(len, edges)) :])


def _states(a: Trajectory, b: Trajectory, jumped: list[tuple[_Move, _Move]]) -> float:
    """Largest difference of states in the middle of arcs, after jumps, and at the end."""
    largest = _gap(a.arcs[-1].last, b.arcs[-1].last)
    for steps in jumped:
        after = [step.jump.after for step in steps if step.jump]
        middle = [step.arc.local(0.5 * step.arc.length) for step in steps]
        largest = max(largest, _gap(*after), _gap(*middle))
    return largest


def _gap(a: Numbers, b: Numbers) -> float:
    return float(np.max(np.abs(a - b)))


def _unequal(a: list[Any], b: list[Any]) -> float:
    return float(sum(p != q for p, q in zip(a, b, strict=False)) + abs(len(a) - len(b)))


def _largest(a: list[Any], b: list[Any]) -> float:
    """The largest difference; infinite if a value is missing on one side."""
    pairs = list(zip(a, b, strict=False))
    if len(a) != len(b) or any((p is None) != (q is None) for p, q in pairs):
        return float("inf")
    return max((abs(p - q) for p, q in pairs if p is not None), default=0.0)
