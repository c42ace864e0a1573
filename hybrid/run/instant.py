"""Impacts at one instant, of contacts that touch or are as good as closed: their maps, and the
limit if they never end.

See :mod:`hybrid.zeno.instant`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..lowering import Guard, Scene
from ..rules.guards import NEAR
from ..rules.zeros import EPS
from ..zeno.cycle import CycleLimit
from ..zeno.instant import Cascade, shrinking

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .cycles import Seen

#: Shares of the largest gap speed at which a restitution is compared: it must be constant.
SPEEDS = (1.0, 0.3, 1e-3, 1e-9, 0.0)

#: Restitutions that differ by no more than a few roundings are equal.
SAME_RESTITUTION = 64 * EPS

#: The time in which hidden flights end, relative to that of crossing a gap of rounding's size at
#: their first speed, over all turns.
HIDDEN_CAUTION = 8.0


@attrs.frozen(eq=False)
class Touching:
    """Contacts that touch at a time and state, and the effect of impacts there.

    Attributes
    ----------
    guards : list of Guard
    pushes : array, shape (contacts, states)
        For each contact, the change of the state that changes its gap speed by 1.
    gain : array, shape (contacts, contacts)
        The changes of all gap speeds by these.
    gaps, speeds, laws : list of float
        Gaps and gap speeds (zero where they are rounding) and restitutions.
    open : float
        The rounding of the gaps: lower flights may be hidden in the instant.
    """

    guards: list[Guard]
    pushes: np.ndarray
    gain: np.ndarray
    gaps: list[float]
    speeds: list[float]
    laws: list[float]
    open: float


def collapse(scene: Scene, mode: str, recent: Sequence[Seen], t_error: float) -> CycleLimit | None:
    """The limit of impacts that take no time and repeat with falling speed; None if there is none.

    ``recent``: the jumps that took no time; the last has led into the mode.
    """
    t, x = recent[-1].t, recent[-1].x
    if not all(scene.is_contact(seen.edge) for seen in recent):
        return None
    found = touching(scene, mode, t, x, t_error)
    if found is None:
        return None
    turn = shrinking(Cascade(found.gain, found.laws, found.gaps, found.speeds), t_error)
    if turn is None:
        return None
    x_inf = x + turn.changes @ found.pushes
    error = np.full(len(x), 64 * EPS * max(np.abs(seen.x).max() for seen in recent))
    edges = tuple(found.guards[i].edge for i in turn.struck)
    fast = float(np.abs(_speeds([found.guards[i] for i in turn.struck], t, recent[0].x)).max())
    late = HIDDEN_CAUTION * found.open / (fast * (1.0 - turn.ratio)) if fast else np.inf
    return CycleLimit(edges, 0.0, x_inf, turn.ratio, t_error + late, error, len(recent))


def touching(scene: Scene, mode: str, t: float, x: StateVector, instant: float) -> Touching | None:
    """The contacts of a mode that touch, or whose gaps are crossed within an instant.

    None if impacts do not change gap speeds by constant shares: another guard depends on what they
    change, or a restitution depends on the speed.
    """
    field, state = scene.field(mode), x.tolist()
    contacts = [guard for guard in field.guards if guard.kind == "contact"]
    reach = instant * np.abs(_speeds(contacts, t, x)).max(initial=0.0)
    low = {guard.edge: _rounding(scene, mode, guard, t, state) for guard in contacts}
    values = {guard.edge: guard.value(t, state) for guard in contacts}
    near = [name for name, gap in values.items() if abs(gap) <= max(low[name], reach)]
    gaps = [values[name] if values[name] > low[name] else 0.0 for name in near]
    guards = [guard for guard in scene.field(mode, near).guards if guard.edge in near]
    pushes = np.array([scene.contact(name).push(t, state) for name in near]).reshape(len(near), -1)
    noise = [64 * EPS * scene.rounding(guard, field)(t, state)[1] for guard in guards]
    now = _speeds(guards, t, x)
    speeds = np.where(np.abs(now) <= noise, 0.0, now)
    top = float(np.max(np.abs(speeds), initial=0.0))
    laws = [_law(scene, name, t, state, top) for name in near]
    changed = set(np.flatnonzero(np.any(pushes != 0.0, axis=0)).tolist())
    others = [guard for guard in field.guards if guard.kind != "contact"]
    if not top or None in laws or any(changed & set(guard.uses) for guard in others):
        return None
    size = max(top, float(np.abs(x[list(changed)]).max()))  # less would drown in rounding
    there, back = ([_speeds(guards, t, x + way * push) for push in pushes] for way in (size, -size))
    gain = (np.array(there) - np.array(back)).T / (2.0 * size)
    bends = np.abs(np.array(there) + np.array(back) - 2.0 * now).max()
    if bends > NEAR * size:
        return None
    known = [law for law in laws if law is not None]
    return Touching(guards, pushes, gain, gaps, speeds.tolist(), known, max(low[n] for n in near))


def _rounding(scene: Scene, mode: str, guard: Guard, t: float, x: list[float]) -> float:
    """The rounding of a gap."""
    return float(64 * EPS * scene.rounding(guard, scene.field(mode))(t, x)[0])


def _speeds(guards: Sequence[Guard], t: float, x: StateVector) -> np.ndarray:
    return np.array([guard.lie(t, x.tolist())[1] for guard in guards])


def _law(scene: Scene, name: str, t: float, x: list[float], top: float) -> float | None:
    """A contact's restitution; None where it depends on the speed, or on chance."""
    if name in scene.spec.chances:
        return None
    laws = [scene.contact(name).law(t, x, -share * top) for share in SPEEDS]
    return laws[-1] if max(laws) - min(laws) <= SAME_RESTITUTION else None
