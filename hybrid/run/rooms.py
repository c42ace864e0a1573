"""Arrays for the compiled loop: to work in, and for what a call leaves.

They are kept with the tables of the scene for the next run: to allocate and check them takes longer
than a step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..rules.arrays import AutomatonArrays, Left, Look, Now, Room, Sums
from ..rules.calls import held
from ..rules.lengths import short_order
from ..rules.places import CURVE_ROWS, FLOWING, REMAINING, STATE_FLOATS, STATE_INTS, TOLERANCES
from ..rules.sights import LAW_POINTS, OTHER_GUARDS, STATE_ROWS, TAIL_HALVINGS
from ..rules.sums import STRETCH_POINTS
from ..zeno.flight import room_for_sums

if TYPE_CHECKING:
    from ..lowering.automaton import Tables


def work_for(tables: Tables, n: int, order: int) -> tuple[Room, Sums, Look]:
    """Arrays for one run to work in."""
    *needs, bounds = tables.needs
    stretches, shown = np.zeros((TAIL_HALVINGS + 2, 5)), np.zeros((STRETCH_POINTS + 2, n + 4))
    rows = STATE_ROWS + n
    shapes = [(k, 2) for k in (rows, bounds, OTHER_GUARDS, OTHER_GUARDS)]
    shapes += [(rows, STRETCH_POINTS), (bounds, STRETCH_POINTS), (2 * LAW_POINTS + 2, 2)]
    look = Look(stretches, shown, *map(np.zeros, shapes))
    own = tables.room(order)
    short = own._replace(c=np.empty((len(own.c), short_order(order) + 1)))
    return own, room_for_sums(needs, n)._replace(short=short), look


def now_for(tables: Tables, n: int) -> Now:
    """The state of a run of ``n`` states."""
    floats, ints = np.zeros(STATE_FLOATS), np.zeros(STATE_INTS, dtype=np.int64)
    ints[FLOWING] = tables.scene.spec.flows
    return Now(floats, ints, *np.zeros((3, n)), *tables.watches())


def left_for(n: int, jumps: int, steps: int, expansions: tuple[int, int], sums: int) -> Left:
    """Arrays for so many jumps, steps, rows of expansions and sums of ``n`` states."""
    return Left(
        np.empty((jumps, 3)),
        np.empty(jumps, dtype=np.int64),
        np.empty((jumps, n)),
        np.empty((jumps, n)),
        np.empty(steps, dtype=np.int64),
        np.empty((steps, 2)),
        np.empty(expansions),
        np.empty((sums, REMAINING + 1)),
        np.empty((sums * CURVE_ROWS, n + 2)),
    )


class Rooms:
    """The work arrays of one run, and the prepared call of the loop on them.

    Attributes
    ----------
    run : array
        The numbers of the run, placed as in :mod:`hybrid.rules.places`.
    now : Now
    work : (Room, Sums, Look)
    left : Left
        What a call leaves, where no expansions are kept; it is copied from here.
    size : (jumps, steps)
        The number of these for which there is room.
    """

    def __init__(self, tables: Tables, n: int, order: int, size: tuple[int, int], sums: int):
        self.run, self.now = np.zeros(TOLERANCES + n), now_for(tables, n)
        self.work, self.size = work_for(tables, n, order), size
        self.left = left_for(n, *size, (0, order + 1), sums)
        self._of: tuple[Any, ...] = (None, None)

    def call(self, go: Callable[..., int], automaton: AutomatonArrays) -> Callable[[], int]:
        """The prepared call of a loop on these arrays."""
        if self._of[0] is not go or self._of[1] is not automaton:
            room, sums, look = self.work
            given = automaton, self.run, self.now, room, self.left, sums, look
            self._of, self._call = (go, automaton), held(go, *given)
        return self._call
