"""Knots of signals: what follows one, and the pieces as the compiled loop takes them.

Numbers in brackets are the rules of ``docs/semantics.md``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..delay.windows import Links
from ..errors import DomainError
from ..lowering import Field, Guard, Scene
from ..lowering.mode import RELEASE_SUFFIX
from ..rules.arrays import InputArrays
from ..rules.guards import GUARD_ROUNDING, JUMPS_WITHIN, NEAR
from ..rules.zeros import EPS
from ..trajectory.clock import Instant
from .entry import Entry, Jumped, departed, extent, is_zero, just_left, opened, signs_at_end
from .noting import add_jump

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .driver import Driver

#: Pieces that the loop is given at a time.
PIECES_AHEAD = 4096

#: Guards of what a model declares; the others follow from it, and may jump.
DECLARED = ("edge", "contact", "switch")


def pass_knot(driver: Driver, t: float, x: StateVector) -> None:
    """Continue an arc behind a knot.

    A guard that is zero there fires first, from left values (4). A contact at rest opens if its gap
    or gap speed jumps there, and sliding ends where the surface does; one that jumps over the state
    is crossed; a guard that has jumped over zero fires (1).

    Raises
    ------
    DomainError
        If a gap jumps below zero.
    """
    entry, field, there = driver.entry, driver.entry.field, driver.model.at(t)
    known, spent = driver.vanishing, taken(driver, t, x)
    signs = _sides(entry, spent, t, x, driver.reach(x))
    driver.record.now = Instant(t)
    if driver.scene.until == t and fires_at(driver, spent, t, x):
        return
    driver.scene = there
    off = {guard.edge: guard for guard in _off(driver, there, t, x)}
    _require_within(driver, there, off, signs, t, x)
    over = next((guard for guard in off.values() if _is_over(guard, signs, t, x)), None)
    driver.cycles.forget()
    if over is not None:
        _leave(driver, over.edge, over.to, x)
        driver.enter(over.to, x, Jumped())
    elif not let_go(driver, t, x):
        known = {edge: power for edge, power in known.items() if edge not in off}
        driver.enter(field.mode, x, Jumped(known, field.held, passing=signs))


def taken(driver: Driver, t: float, x: StateVector) -> frozenset[str]:
    """The edges that have just been taken, and whose guards may still be zero, but for rounding.
    Those just left count as taken at this time."""
    guards = driver.entry.field.guards
    driver.spent = driver.spent.union(g.edge for g in guards if just_left(driver, g, x, t))
    return driver.spent.union(driver.vanishing)


def let_go(
    driver: Driver,
    t: float,
    x: StateVector,
    lost: float = 0.0,
    loose: frozenset[str] | None = None,
) -> bool:
    """Release the contacts at rest that are open at a time at which what holds the state may have
    jumped, and leave a surface that it slid on; returns whether there were any. ``lost``: the share
    of its terms that a gap may be off for other reasons; ``loose``: those that may have (default:
    all)."""
    field, scene = driver.entry.field, driver.scene
    names = frozenset(field.held) if loose is None else loose
    leaves = (guard for guard in field.guards if guard.kind == "leave")
    ends = (g for g in leaves if loose is None or g.edge.rpartition(".")[0] in names)
    known = driver.place._replace(t=t), x, lost
    gone = next((guard for guard in ends if departed(scene, guard, *known)), None)
    held = (contact for contact in field.held if contact in names)
    open_ = [contact for contact in held if opened(scene, field.mode, contact, *known)]
    for contact in open_:
        _leave(driver, f"{contact}{RELEASE_SUFFIX}", field.mode, x)
    if gone is not None:
        _leave(driver, gone.edge, gone.to, x)
        driver.enter(gone.to, x, Jumped())
    elif open_:
        driver.enter(field.mode, x, Jumped(held=tuple(c for c in field.held if c not in open_)))
    return gone is not None or bool(open_)


def turned(before: Field, behind: Field, t: float, x: StateVector) -> frozenset[str]:
    """What holds the state and changes its formula where windows of the past end, to the rounding
    of the time: no arc, up to there or from there, needs to show it.

    ``before``, ``behind``: the field with the windows that end and with those that begin.
    """
    late = JUMPS_WITHIN * float(np.spacing(abs(t)))
    old, new = _deciders(before, t, x, -late), _deciders(behind, t, x, late)
    signs = ((name, np.vstack((there, new[name]))) for name, there in old.items())
    return frozenset(name for name, each in signs if (each != each[0]).any())


def _deciders(field: Field, t: float, x: StateVector, tau: float) -> dict[str, np.ndarray]:
    """Of what holds the state, the signs of the functions that decide on its formula: at a time,
    and so long after it."""
    there, found = (x + tau * field.flow(t, x)).tolist(), {}
    for guard in field.guards:
        name = guard.edge.rpartition(".")[0]
        if guard.kind == "leave":
            guard = field.scene.field(guard.to).guard(name)
        elif guard.kind != "release":
            continue
        places = (t, x.tolist()), (t + tau, there)
        found[name] = np.sign([[kink.value(*place) for kink in guard.kinks] for place in places])
    return found


def _leave(driver: Driver, edge: str, to: str, x: StateVector) -> None:
    """Add a jump that does not change the state, after an arc of no length."""
    driver.record.arc(driver.entry.field, x, x, 0.0, [])
    driver.interrupt(edge, to, x, x)
    add_jump(driver, edge, x, x)


def fires_at(
    driver: Driver, spent: frozenset[str], t: float, x: StateVector, most: float = np.inf
) -> bool:
    """Carry out the jump of a guard that is zero before a knot, or where windows of the past end,
    but for rounding, if there is one: of several that of the edge declared first (4).

    ``spent``: edges just taken; ``most``: how far from there in time a guard may be zero.
    """
    entry, now = driver.entry, driver.record.now
    own = {}
    for index, guard in enumerate(entry.field.guards):
        value, rate, _ = guard.lie(t, x.tolist())
        if guard.kind in DECLARED and guard.edge not in spent and abs(value) <= abs(rate) * most:
            own[index] = guard
    if own and driver.losses.tolerances:
        near = driver.losses.near(driver.scene, entry.field, t, x, t - driver.since)
        near = {index: way for index, way in near.items() if index in own}
        x = driver.losses.beyond(entry.field, near, t, x, 0.0)[1]
    zero = [guard for guard in own.values() if is_zero(driver, guard, now, x, t)]
    if zero:
        driver.record.arc(entry.field, x, x, 0.0, [])
        driver.tied = {guard.edge: -1 if guard.lie(t, x.tolist())[1] > 0 else 1 for guard in zero}
        driver.jump(zero[0], x)
    return bool(zero)


def _sides(
    entry: Entry, spent: frozenset[str], t: float, x: StateVector, reach: float
) -> dict[str, int]:
    """By edge the sign of its guard before a knot; of one that is zero, as its edge may have just
    been taken, that to which it goes."""
    signs = signs_at_end(entry, t, x, reach)
    for guard in entry.field.guards:
        value, rate, _ = guard.lie(t, x.tolist())
        taken = guard.edge in spent and abs(value) <= NEAR * reach
        if taken or not signs[guard.edge]:
            signs[guard.edge] = int(np.sign(rate)) or signs[guard.edge]
    return signs


def _off(driver: Driver, there: Scene, t: float, x: StateVector) -> list[Guard]:
    """The guards of the mode that are off zero behind a knot, by more than rounding: that of the
    largest states seen, too, of which these are made."""
    behind, state = _watched(driver, there), x.tolist()
    sizes = (extent(there, guard, behind, t, x, driver.seen)[0] for guard in behind.guards)
    pairs = zip(behind.guards, sizes, strict=True)
    return [g for g, size in pairs if abs(g.value(t, state)) > GUARD_ROUNDING * EPS * size]


def _watched(driver: Driver, there: Scene) -> Field:
    """The field of the mode, without what is held; while sliding that of the positive side."""
    mode = driver.entry.field.mode
    switching = there.spec.sliding(mode)
    return there.field(mode if switching is None else switching.positive)


def _is_over(guard: Guard, signs: dict[str, int], t: float, x: StateVector) -> bool:
    """Whether a surface has jumped over the state."""
    return guard.kind == "switch" and guard.value(t, x.tolist()) * signs.get(guard.edge, 0) < 0


def _require_within(
    driver: Driver,
    there: Scene,
    off: dict[str, Guard],
    signs: dict[str, int],
    t: float,
    x: StateVector,
) -> None:
    """Refuse a gap that jumps below zero."""
    for edge, guard in off.items():
        value = guard.value(t, x.tolist())
        if guard.kind == "contact" and value < 0 and signs.get(edge, 1) > 0:
            names = ", ".join(signal.name for signal in there.spec.signals)
            raise DomainError(
                f"{driver.where(x)}: at this knot of the signals ({names}) the gap of "
                f"{edge} jumps to {value:.6g}, and the state does not; a gap must not "
                'jump so: kind="linear" or "cubic" joins its values'
            )


class Feed:
    """Consecutive pieces of the signals, as arrays for the compiled loop."""

    def __init__(self, scene: Scene, t: float, last: float) -> None:
        self.knots, self.last = scene.knots(t, last, PIECES_AHEAD), last
        self.pieces = np.ascontiguousarray(scene.pieces(self.knots[:-1]))
        self.place = np.array([0, 1, -1, 0], dtype=np.int64)
        self.began, self.start = np.zeros(1), np.zeros(scene.spec.dimension)
        self._made: tuple[Links, InputArrays] | None = None

    def at(self, t: float, behind: bool, goes_on: bool) -> bool:
        """Be at a time, if there is a piece for it; of a knot on that ``behind`` it, or on that
        which leads there. ``goes_on``: over knots, if all is plain."""
        place = int(np.searchsorted(self.knots[:-1], t, "right" if behind else "left")) - 1
        self.place[:] = max(place, 0), goes_on, -1, 0
        last = self.knots[-1]
        return place >= 0 and (t < last or (t == last and (not behind or t == self.last)))

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
