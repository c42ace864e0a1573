"""Knots of signals: what follows one, and the pieces as the compiled loop takes them.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..delay.windows import Links
from ..errors import DomainError
from ..lowering import Scene
from ..lowering.mode import RELEASE_SUFFIX
from ..rules.arrays import InputArrays
from ..rules.guards import GUARD_ROUNDING
from ..rules.zeros import EPS
from ..trajectory.clock import Instant
from .entry import Jumped, opened, signs_at_end
from .noting import add_jump

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .driver import Driver

#: Pieces that the loop is given at a time.
PIECES_AHEAD = 4096


def pass_knot(driver: Driver, t: float, x: StateVector) -> None:
    """Continue an arc behind a knot.

    A contact at rest opens if its gap or gap speed jumps there; a surface that jumps over the state
    is crossed; a guard that has jumped over zero fires (1).

    Raises
    ------
    DomainError
        If a gap jumps below zero, or a surface jumps away from a state that slides on it.
    """
    entry, field, there = driver.entry, driver.entry.field, driver.model.at(t)
    came = driver.came() if entry.here is None else driver.jumped
    known = came.vanishing if driver.record.young else {}
    signs = signs_at_end(entry, t, x, driver.reach(x))
    driver.record.now = Instant(t)
    off = _jumped(driver, there, t, x, signs)
    open_ = [c for c in field.held if opened(there, field.mode, c, t, x)]
    for edge in (*off, *(f"{contact}{RELEASE_SUFFIX}" for contact in open_)):
        driver.record.arc(field, x, x, 0.0, [])
        driver.watch.reset()
        if edge not in off:
            driver.record.released(edge.removesuffix(RELEASE_SUFFIX), t)
        add_jump(driver, edge, x, x)
    driver.look(x)
    driver.cycles.forget()
    if off:
        driver.enter(field.guard(off[0]).to, x, Jumped())
    elif open_:
        driver.enter(field.mode, x, Jumped(held=tuple(c for c in field.held if c not in open_)))
    else:
        driver.enter(field.mode, x, Jumped(known, field.held, passing=signs))


def _jumped(
    driver: Driver, there: Scene, t: float, x: StateVector, signs: dict[str, int]
) -> list[str]:
    """The surfaces that have jumped over the state; at most one may."""
    field, found = driver.entry.field, []
    behind = there.field(field.mode)
    switching = there.spec.sliding(field.mode)
    if switching is not None:
        behind = there.field(switching.positive)
    for guard in behind.guards:
        value = guard.value(t, x.tolist())
        size = float(there.rounding(guard, behind)(t, x.tolist())[0])
        off = abs(value) > GUARD_ROUNDING * EPS * size
        slides = switching is not None and guard.edge == switching.name
        below = guard.kind == "contact" and value < 0 and signs.get(guard.edge, 1) > 0
        if off and (slides or below):
            names = ", ".join(signal.name for signal in there.spec.signals)
            what = "surface" if slides else "gap"
            raise DomainError(
                f"{driver.where(x)}: at this knot of the signals ({names}) the {what} of "
                f"{guard.edge} jumps to {value:.6g}, and the state does not; a {what} must not "
                'jump so: kind="linear" or "cubic" joins its values'
            )
        if off and guard.kind == "switch" and not slides and value * signs[guard.edge] < 0:
            found.append(guard.edge)
    return found[:1]


class Feed:
    """Consecutive pieces of the signals, as arrays for the compiled loop."""

    def __init__(self, scene: Scene, t: float, last: float) -> None:
        self.knots, self.last = scene.knots(t, last, PIECES_AHEAD), last
        self.pieces = np.ascontiguousarray(scene.pieces(self.knots[:-1]))
        self.place = np.array([0, 1, -1, 0], dtype=np.int64)
        self.began, self.start = np.zeros(1), np.zeros(scene.spec.dimension)
        self._made: tuple[Links, InputArrays] | None = None

    def at(self, t: float, goes_on: bool) -> bool:
        """Move to the piece at a time, if there is one; ``goes_on``: the loop may pass knots by
        itself."""
        place = int(np.searchsorted(self.knots[:-1], t, "right")) - 1
        self.place[:] = max(place, 0), goes_on, -1, 0
        return place >= 0 and (t < self.knots[-1] or t == self.last)

    def begins(self, within: bool) -> None:
        """Prepare for a call of the loop; ``within``: it continues the same arc."""
        self.place[2:] = 0 if within else -1, 0

    @property
    def since(self) -> float:
        """The time at which the current piece begins."""
        return float(self.knots[self.place[0]])

    @property
    def until(self) -> float:
        """The time at which the current piece ends."""
        return float(self.knots[self.place[0] + 1])

    def arrays(self, links: Links) -> InputArrays:
        """The pieces, and where in the inputs they belong."""
        if self._made is None or self._made[0] is not links:
            own = self.knots, self.pieces, self.place, self.began, self.start
            given = links.given, links.ranged, links.parts, links.ops, links.more, links.numbers
            self._made = links, InputArrays(*own, *given)
        return self._made[1]
