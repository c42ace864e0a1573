"""The windows on the past as inputs of programs: see :mod:`hybrid.delay.memory`."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..lowering.scene import parted, released
from ..rules.places import KIND, NONE, RELEASE, TO, WINDOW_DEGREE
from ..segment import to_centred_powers

if TYPE_CHECKING:
    from ..automaton.shapes import IntegerMatrix, Mask
    from ..lowering import Field
    from ..lowering.automaton import Tables
    from ..lowering.lowered import Lowered
    from ..rules.arrays import AutomatonArrays


#: Matrix from Chebyshev coefficients to powers of the window's local coordinate.
TO_POWERS = to_centred_powers(WINDOW_DEGREE)


class Links(NamedTuple):
    """Where programs read the windows' numbers; see :class:`hybrid.rules.arrays.PastArrays`."""

    uses: np.ndarray
    asks: np.ndarray
    bent: np.ndarray
    given: np.ndarray
    ranged: np.ndarray
    parts: np.ndarray
    ops: np.ndarray
    more: np.ndarray
    numbers: np.ndarray
    signs: np.ndarray


def _table(rows: Any, width: int) -> IntegerMatrix:
    return np.array(rows, dtype=np.int64).reshape(-1, width)


#: For an automaton without programs.
NO_PROGRAMS = np.zeros(0, dtype=np.int64)
EMPTY_TABLES = [_table([], width) for width in (1, 1, 1, 2, 2, 6, 6)]
NO_LINKS = Links(*EMPTY_TABLES, NO_PROGRAMS, np.zeros((0, 1)), _table([], 1))  # type: ignore[call-arg]


class Shown:
    """The programs of the rules' loop for one run, with a copy of their numbers.

    The coefficients of windows are among these numbers; nothing else changes from one window to the
    next. With ``restarts``, a jump changes the delayed states, so the loop leaves releases to
    Python.
    """

    def __init__(self, tables: Tables, restarts: bool) -> None:
        self.restarts = restarts
        spec = tables.scene.spec
        self.tables, self.count = tables, sum(map(prod, spec.windows))
        self.first = len(tables.scene.values) - self.count
        self._of: AutomatonArrays | None = None
        self._links = NO_LINKS

    def linked(self) -> tuple[AutomatonArrays, Links]:
        """The automaton's arrays, and where its programs read the windows."""
        known = self.tables.automaton
        if known is not self._of:
            programs, bounds = known.programs, known.bounds
            own = programs._replace(numbers=programs.numbers.copy())
            ranged = bounds._replace(numbers=bounds.numbers.copy())
            guards = known.guards.copy()
            if self.restarts:
                guards[guards[:, KIND] == RELEASE, TO] = NONE
            signs = np.zeros((6, len(guards)), dtype=np.int64)
            if self._of is not None:
                signs[:, : self._links.signs.shape[1]] = self._links.signs
            self._of = known
            self._own = known._replace(programs=own, guards=guards, bounds=ranged)
            self._links = self._found(known)._replace(
                numbers=own.numbers.reshape(-1, 1), signs=signs
            )
        return self._own, self._links

    def _found(self, known: AutomatonArrays) -> Links:
        """Where the shared programs read the windows, cached on the tables."""
        if self.tables.links is None or self.tables.links[0] is not known:
            self.tables.links = known, self._find()
        return self.tables.links[1]  # type: ignore[no-any-return]

    def _find(self) -> Links:
        ends, given, parts = np.zeros(3, dtype=np.int64), [], []
        tapes = []
        for part in self.tables.parts:
            tape = part.tape
            own = self._windows(tape.given.T)
            given.append(own + np.array([ends[2], 0]))
            after = ends + np.array([len(tape.steady), len(tape.more), len(part.numbers)])
            if len(own) and len(tape.steady):
                parts.append(np.column_stack([ends, after]).reshape(-1))
                tapes.append(tape)
            else:
                after[:2] = ends[:2]
            ends = after
        return Links(
            *reach(self.tables.fields),
            self._bent(),
            np.ascontiguousarray(np.concatenate([_table([], 2), *given])),
            np.ascontiguousarray(self._windows(_table(self.tables.bounds.given, 2))),
            _table(parts, 6),
            np.concatenate([_table([], 6), *(tape.steady for tape in tapes)]),
            np.concatenate([NO_PROGRAMS, *(tape.more for tape in tapes)]),
            NO_LINKS.numbers,
            NO_PROGRAMS,
        )

    def _bent(self) -> IntegerMatrix:
        """For each guard the elements whose derivatives a jump by it changes by itself."""
        tables, code = self.tables, self.tables.scene.code
        jumps = zip(tables.guards, tables.modes, strict=True)
        rows = [bent(code, guard.edge, mode) for guard, mode in jumps]
        return _table(rows, code.spec.dimension)

    def _windows(self, given: IntegerMatrix) -> IntegerMatrix:
        """The entries of ``given`` that refer to windows, renumbered from the first window."""
        among = (given[:, 1] >= self.first) & (given[:, 1] < self.first + self.count)
        return given[among] - [0, self.first]


def bent(code: Lowered, edge: str, mode: str) -> Mask:
    """The elements whose derivatives a jump changes, apart from what it does to the state: those
    that contacts push, as it may bring one to rest or release it; all, if it leaves the mode."""
    base, name = parted(mode)[0], released(edge)
    jump = next((jump for jump in code.spec.transitions if jump.name == name), None)
    stays = jump is not None and jump.source == jump.to == base
    return code.pushed(base) if stays else np.ones(code.spec.dimension, dtype=bool)


def reach(fields: Sequence[Field]) -> tuple[np.ndarray, np.ndarray]:
    """On what the derivative of each state element depends, field by field.

    Returns two tables of 0 and 1, with a row for each field and element: on which present elements,
    shape ``(rows, n)``, and on which delayed ones, by lag and element, shape ``(rows, lags * n)``.
    """
    spec, uses, asks = fields[0].code.spec, [], []
    n, lags = spec.dimension, len(spec.lags)
    if not lags:
        return EMPTY_TABLES[0], EMPTY_TABLES[1]
    for field in fields:
        for used, asked in field.code.reach(field.mode, field.held):
            uses.append([int(j in used) for j in range(n)])
            asks.append([int((k, e) in asked) for k in range(lags) for e in range(n)])
    return _table(uses, n), _table(asks, lags * n)
