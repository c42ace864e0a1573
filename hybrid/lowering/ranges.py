"""Programs for interval bounds in doubles (:mod:`hybrid.rules.bounds`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..rules import bounds as rule
from ..rules.arrays import Bounds

#: Operations on bounds, with their numbers in the rule.
RANGES = {
    name: int(getattr(rule, f"{name.upper()}_BOUNDS"))
    for name in ("add", "sub", "neg", "mul", "div", "square", "sqrt", "exp", "sin", "cos", "abs")
}

#: Those of which the bounds are the same, to the last bit, in either order: each is made once.
COMMUTE = (rule.ADD_BOUNDS, rule.MUL_BOUNDS)


class Ranges:
    """Concatenated programs for bounds, to which more can be added."""

    def __init__(self) -> None:
        self._index: list[list[int]] = []
        self._ops: list[list[int]] = []
        self._numbers: list[float] = []
        self._results: list[int] = []
        self.most = 1
        self.given: list[tuple[int, int]] = []  # (place in the numbers, parameter index)

    def add(
        self, steps: Sequence[Any], results: Sequence[int], rows: Mapping[str, int], given: Any
    ) -> int | None:
        """Add a program; its inputs are rows of a box or values in ``given``.

        Returns its number, or None if an operation has no bounds.
        """
        ops: list[list[int]] = []
        known: dict[tuple[int, ...], int] = {}
        place: list[int] = []  # of each step, among the operations
        for step in steps:
            op = self._op(step, rows, given, place)
            if op is None:
                return None
            own = (op[0], *sorted(op[1:])) if op[0] in COMMUTE else tuple(op)
            if own not in known:
                known[own] = len(ops)
                ops.append(op)
            place.append(known[own])
        first = len(self._ops)
        self._index.append([first, first + len(ops), len(self._results), len(results)])
        self._ops += ops
        self._results += [place[result] for result in results]
        self.most = max(self.most, len(ops))
        return len(self._index) - 1

    def _op(
        self, step: Any, rows: Mapping[str, int], given: Any, place: Sequence[int]
    ) -> list[int] | None:
        if step.op == "input" and step.given in rows:
            return [rule.INPUT, rows[step.given], 0]
        if step.op in ("input", "const"):
            if step.op == "input":
                self.given.append((len(self._numbers), int(step.given[1:])))
            self._numbers.append(float(given[step.given] if step.op == "input" else step.number))
            return [rule.NUMBER, len(self._numbers) - 1, 0]
        if step.range is None:
            return None
        places = [place[each] for each in step.places]
        return [step.range, *places, *[0] * (2 - len(places))]

    def arrays(self) -> Bounds:
        """All programs so far, as arrays."""
        index = np.array(self._index, dtype=np.int64).reshape(-1, 4)
        ops = np.array(self._ops, dtype=np.int64).reshape(-1, 3)
        results = np.array(self._results, dtype=np.int64)
        return Bounds(index, ops, np.array(self._numbers, dtype=float), results)
