"""Entering a mode: which guards are zero at the start of an arc, and what follows (rules 2, 3)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..errors import DomainError, FlowError, StartError
from ..events import fires
from ..lowering import Field, Guard, Kink, Scene, released
from ..lowering.automaton import DIRECTIONS, NUMBERED
from ..lowering.local import near
from ..rules import unit
from ..rules.cuts import MOVES
from ..rules.entries import ARMED, BEYOND, FIRES, LEAVES, OUTSIDE, UNDECIDED
from ..rules.guards import GUARD_ROUNDING, NEAR, TIE
from ..rules.lengths import SHORTEST_STEP
from ..rules.zeros import EPS
from ..trajectory.clock import Instant

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector
    from .driver import Driver

#: What there is to do about a start, or a jump, outside a domain: of a contact or not, starting.
OUTSIDE_REMEDIES = {
    (False, True): (
        "start inside, or in another mode (mode=), or turn the guard's sign or crossing=, "
        "or declare the edge with urgent=True"
    ),
    (False, False): "mend the reset, or the guard's sign, or declare the edge with urgent=True",
    (True, True): "start where the gap is positive",
    (True, False): "let the reset lead to where the gap is positive",
}

#: The remedy for a start on a guard where no derivative decides.
STARTS_OFF = "; start off the guard"


@attrs.frozen(eq=False)
class Entry:
    """A state at the start of an arc.

    Attributes
    ----------
    here : object or None
        What is known of the guards there; None before the start has been examined.
    orders : list of int
        For each guard, the power of the local time by which it vanishes.
    at_once : list of int
        The guards that fire before any flow.
    signs : list of int
        For each guard, its sign just after the start.
    """

    field: Field
    x: StateVector
    here: _Here | None
    orders: list[int]
    at_once: list[int]
    signs: list[int] = attrs.Factory(list)

    @property
    def series(self) -> Any:
        """Taylor series of states and guards here; None where there is none."""
        return None if self.here is None else self.here.series


@attrs.define
class Jumped:
    """What a jump tells about the state after it.

    Attributes
    ----------
    vanishing : dict
        By edge: the least power of the local time by which its guard vanishes (2).
    held : tuple of str
        The contacts held closed; those found closed on entering are added.
    used : str or None
        The edge just taken: its guard is zero by construction and must first leave zero (2).
    set_off : bool
        The reset of that edge may have put its guard off zero.
    onwards : bool
        The reset of that edge has not reversed the motion of its guard.
    beyond_by : float
        The guard of that edge has jumped over zero: the state is beyond by rounding, by so much of
        the function that decides, and to jump back there is no crossing (1). It has the guard's
        sign; 0 if the guard has not jumped, or the reset has led back.
    starting : bool
        This is the start of the run; there was no jump.
    passing : dict or None
        There was no jump, but a window of the past or a signal has ended, and its values may have
        jumped. By edge, the sign of its guard before; a guard whose sign has changed fires (1). See
        :func:`signs_at_end`.
    tied : dict
        By edge, the sign before the jump of a guard that was zero at its time, too, and fires.
    close : frozenset of str
        Those of them whose guards are still zero, but for what a solver's steps have lost.
    touched : dict
        The same of those of edges and switchings that do not fire there: to leave zero again to
        that side is no crossing.
    spent : frozenset of str
        The edges taken at the time of the jump; one that bounds no domain is not taken twice.
    limit : frozenset of str
        The edges whose jumps have accumulated here.
    series : bool
        The jump was an impact of the same contact as the one before. Such series are summed,
        however slow they are.
    tried : tuple
        The sets of held contacts that have been tried on entering.
    """

    vanishing: dict[str, int] = attrs.Factory(dict)
    held: tuple[str, ...] = ()
    used: str | None = None
    set_off: bool = True
    onwards: bool = False
    beyond_by: float = 0.0
    starting: bool = False
    passing: dict[str, int] | None = None
    tied: dict[str, int] = attrs.Factory(dict)
    close: frozenset[str] = frozenset()
    touched: dict[str, int] = attrs.Factory(dict)
    spent: frozenset[str] = frozenset()
    limit: frozenset[str] = frozenset()
    series: bool = False
    tried: tuple[tuple[str, ...], ...] = ()

    def before(self, edge: str, order: int) -> int:
        """The sign of a guard before this time, at which it was zero and by a power of the time
        still is; 0 if unknown."""
        signs = {**self.touched, **self.tied} if order else self.tied
        if self.passing is not None and edge not in self.vanishing:
            signs = self.passing
        return int(signs.get(edge, 0))


def enter(
    scene: Scene,
    t: float,
    mode: str,
    x: StateVector,
    jumped: Jumped,
    seen: StateVector,
    off: StateVector,
) -> Entry:
    """Examine the start of an arc in a mode.

    Parameters
    ----------
    seen : array
        The largest absolute value of each state so far. The rounding of a guard is measured by it.
    off : array
        What each state may be off after a jump, by the tolerances.

    Raises
    ------
    StartError, DomainError
        The state is outside the mode's domain, or no derivative decides what a guard does.
    FlowError
        A guard is not finite.
    """
    name = scene.name(mode, jumped.held)
    field = _from_corners(scene, scene.field(name), t, x, jumped.vanishing)
    if jumped.starting:
        _require_on_surface(scene, field, t, x)
    x = _projected(scene, field, t, x, jumped.starting)
    here = _Here(scene, field, t, x, seen, 0.0 * off if jumped.starting else off)
    orders, at_once, signs = [], [], []
    for index, guard in enumerate(field.guards):
        order, sign = here.start_of(guard, index, jumped)
        if sign == 0 and here.stays(guard, jumped):
            order, sign = 0, -DIRECTIONS[guard.crossing] or 1
        if here.closed(guard, order, sign, jumped):
            more = _with(jumped, (*jumped.held, guard.edge))
            return enter(scene, t, mode, x, more, seen, off)
        if here.pulls(guard, sign, jumped):
            fewer = _with(jumped, tuple(c for c in jumped.held if c != released(guard.edge)))
            if fewer.held not in jumped.tried:
                return enter(scene, t, mode, x, fewer, seen, off)
        if here.fires(guard, order, sign, jumped):
            at_once.append(index)
        orders.append(order)
        signs.append(sign)
    return Entry(field, x, here, orders, at_once, signs)


def _with(jumped: Jumped, held: tuple[str, ...]) -> Jumped:
    """The same jump with other contacts held."""
    return attrs.evolve(jumped, held=held, tried=(*jumped.tried, jumped.held))


def _projected(scene: Scene, field: Field, t: float, x: StateVector, starting: bool) -> StateVector:
    """The state projected onto the held contacts, which must be fewer than the degrees of
    freedom."""
    there = field.along(t, x)
    if len(field.held) > 1 and np.isfinite(x).all() and not np.isfinite(there).all():
        raise (StartError if starting else DomainError)(
            f"{describe(scene, field, t, x)}: {', '.join(field.held)} are closed at once and "
            "depend on each other: what each of them bears is not known; leave out those that "
            "follow from others"
        ).by("undecided")
    return there


def _from_corners(
    scene: Scene, field: Field, t: float, x: StateVector, known: Collection[str]
) -> Field:
    """The field in which each gap with a corner at zero, that is zero here, has the formula of the
    side where it grows."""
    state, touching = x.tolist(), []
    for guard in field.guards:
        if guard.kind == "contact" and guard.kinks:
            noise = 64 * EPS * scene.rounding(guard, field)(t, state)[0]
            if guard.edge in known or abs(guard.value(t, state)) <= noise:
                touching.append(guard.edge)
    return scene.field(field.name, touching)


def signs_at_end(entry: Entry, t: float, x: StateVector, reach: float) -> dict[str, int]:
    """By edge, the sign of its guard at the end of a flight in which none has fired.

    A guard that is next to zero there, measured by the states seen, keeps the sign it had if it
    would have fired on the way to the other; what holds the state has held it to the end.
    """
    state, signs, near = x.tolist(), {}, NEAR * reach
    for index, guard in enumerate(entry.field.guards):
        value = guard.value(t, state)
        here = 1 if value > 0 else -1 if value < 0 else 0
        late = entry.signs and abs(value) <= near and (not here or fires(guard.crossing, here))
        signs[guard.edge] = entry.signs[index] if late else here
    return signs | holding(entry.field)


def holding(field: Field) -> dict[str, int]:
    """By edge, the sign that what holds the state has while it does."""
    held = (guard for guard in field.guards if guard.kind in ("release", "leave"))
    return {guard.edge: -DIRECTIONS[guard.crossing] for guard in held}


def expand(field: Field, t: float, x: StateVector) -> Any:
    """Taylor series of states and guards; None where there is none."""
    if field.jets is None:
        return None
    try:
        return field.expand(t, x.tolist(), [0] * field.kinks)
    except (ValueError, OverflowError, ZeroDivisionError):
        return None


def extent(
    scene: Scene, guard: Guard, field: Field, t: float, x: StateVector, seen: StateVector
) -> list[float]:
    """The sums of absolute terms of a guard and its first two derivatives: the larger of those at
    this state and at the largest states seen."""
    sizes = scene.rounding(guard, field)
    here = sizes(t, x.tolist())
    far = sizes(t, seen.tolist()) if len(seen) else here
    return [
        max(one, other) if isfinite(other) else one for one, other in zip(here, far, strict=True)
    ]


def zero_within(
    scene: Scene, guard: Guard, field: Field, t: float, x: StateVector, seen: StateVector
) -> float:
    """How far from zero the guard of an edge may be to be taken for zero where a mode is entered
    (:func:`hybrid.rules.ties.hidden_at`)."""
    here, rate = scene.rounding(guard, field)(t, x.tolist())[0], guard.lie(t, x.tolist())[1]
    far = extent(scene, guard, field, t, x, seen)[0]
    return GUARD_ROUNDING * EPS * (here + far) + TIE * EPS * abs(t) * abs(rate)


def moves_off(
    scene: Scene,
    guard: Guard,
    field: Field,
    t: float,
    x: StateVector,
    seen: StateVector,
    waits: int,
) -> bool:
    """Whether the guard of an edge comes to zero in its own time, or has left it
    (:func:`hybrid.rules.guards.moves_off`)."""
    value, rate, _ = guard.lie(t, x.tolist())
    size = scene.rounding(guard, field)(t, x.tolist())[0]
    fast = extent(scene, guard, field, t, x, seen)[1]
    return bool(unit("guards").moves_off(t, value, rate, waits, size, fast))


def heading(
    scene: Scene, t: float, mode: str, x: StateVector, edge: str, seen: StateVector
) -> tuple[int, int]:
    """The power of the time by which a guard that is zero vanishes along the flow of a mode, and
    the sign that it takes; sign 0 where no derivative decides."""
    field = scene.field(mode)
    here, index = _Here(scene, field, t, x, seen), field.column(edge)
    return here.decide(field.guards[index], index, 1)


class Place(NamedTuple):
    """Where a guard is asked whether it is off zero: the time, that at which the arc began that led
    there, and the largest states seen."""

    t: float
    since: float
    seen: StateVector


def opened(
    scene: Scene, mode: str, contact: str, place: Place, x: StateVector, lost: float = 0.0
) -> bool:
    """Whether the gap or gap speed of a contact that was held differs from zero by more than
    rounding, of the largest states seen, too, and than a share that may have been ``lost``."""
    gap, speed, noise = _off_zero(scene, scene.field(mode), contact, place, x, lost)
    return abs(gap) > noise[0] or abs(speed) > noise[1]


def departed(scene: Scene, guard: Guard, place: Place, x: StateVector, lost: float = 0.0) -> bool:
    """Whether the surface on which a state slid has jumped from it by more than that, so that it is
    now on the side to which a guard leads that ends sliding."""
    switching, _, _ = guard.edge.rpartition(".")
    return _beyond(scene, scene.field(guard.to), switching, guard, place, x, lost)


def jumped_over(scene: Scene, field: Field, guard: Guard, place: Place, x: StateVector) -> bool:
    """Whether a guard that has fired is beyond zero by more than rounding."""
    return _beyond(scene, field, guard.edge, guard, place, x, 0.0)


def _beyond(
    scene: Scene,
    field: Field,
    edge: str,
    fires: Guard,
    place: Place,
    x: StateVector,
    lost: float,
) -> bool:
    """Whether the guard of an edge is off zero in the direction in which another one fires."""
    value, _, noise = _off_zero(scene, field, edge, place, x, lost)
    return value * DIRECTIONS[fires.crossing] > noise[0]


def _off_zero(
    scene: Scene, field: Field, edge: str, place: Place, x: StateVector, lost: float
) -> tuple[float, float, tuple[float, float]]:
    """A guard and its rate where it was zero, and what rounding makes of each."""
    guard, share, t = field.guards[field.column(edge)], 64 * EPS + lost, place.t
    value, rate, _ = guard.lie(t, x.tolist())
    terms = scene.rounding(guard, field)(t, x.tolist())
    high, fast, _ = extent(scene, guard, field, t, x, place.seen)
    # the place at which it leaves zero is known no better
    late = 64 * float(np.spacing(max(abs(place.since), abs(t))))
    slower = share * fast + late * terms[2]
    return value, rate, (share * high + late * (terms[1] + late * terms[2]), slower)


class Departure(NamedTuple):
    """The way from where deciding functions are zero to where none is: how long it takes, the state
    there, and the way as powers of the share of that time, a row for each element of the state."""

    ahead: float
    x: StateVector
    powers: Matrix


def departure(
    field: Field, kinks: Sequence[Kink], t: float, x: StateVector, longest: float = 0.0
) -> Departure | None:
    """The way along the flow to the first state at which no deciding function is zero; None where
    none is zero, or none leaves zero within the ``longest`` time, or 2^27 roundings if that is
    more.

    At a kink a function has two formulas; the one on the side to which the flow goes counts, as the
    Taylor series of the flow tell. A deciding function that stays zero decides nothing.
    """
    left = [kink for kink in kinks if kink.value(t, x.tolist()) == 0.0]
    if not left:
        return None
    c, holds = _way(field, t, x)
    step, orders, found = _first_step(t, x, c[:, 1]), np.arange(c.shape[1]), None
    longest = min(holds, max(longest, 2.0**MOVES * step))
    while left and step <= longest:
        powers = c * step**orders
        there = x + powers[:, 1:].sum(axis=1)
        still = [kink for kink in left if kink.value(t + step, there.tolist()) == 0.0]
        if len(still) < len(left):
            found, left = Departure(step, there, powers), still
        step *= 2.0
    return found


def _way(field: Field, t: float, x: StateVector) -> tuple[Matrix, float]:
    """The coefficients of the flow's series at a state, and for how long they hold: half as long as
    their last terms are rounding. Where there is no series, a line for 2^27 roundings, by the flow
    a rounding later."""
    series = expand(field, t, x)
    if series is not None and np.isfinite(c := np.array(series[0])).all():
        return c, 0.5 * unit("lengths").step_length(c, len(x))
    flow = field.flow(t, x)
    step = _first_step(t, x, flow)
    later = field.flow(t + step, x + step * flow)
    return np.array([x, later]).T, step * 2.0**MOVES


def _first_step(t: float, x: StateVector, flow: Numbers) -> float:
    """The time in which the time, or an element of the state, changes by a rounding. It is no
    number next to the smallest, which are zero in threads of XLA's."""
    moves = (x != 0.0) & (flow != 0.0)
    times = np.abs(x[moves] / flow[moves])
    return max(
        float(np.spacing(abs(t))), EPS * float(times.min()) if times.size else 0.0, SHORTEST_STEP
    )


def beyond_kinks(
    field: Field, kinks: Sequence[Kink], t: float, x: StateVector
) -> tuple[float, np.ndarray]:
    """The first time and state along a flow at which no deciding function is zero
    (:func:`departure`), if that is a short time later."""
    way = departure(field, kinks, t, x)
    return (t, x) if way is None else (t + way.ahead, way.x)


def before_impact(
    scene: Scene, field: Field, guard: Guard, t: float, x: StateVector
) -> tuple[float, np.ndarray]:
    """The last time and state before an impact at which neither the gap nor a function that decides
    on its formula is zero to rounding."""
    noise = 64 * EPS * scene.rounding(guard, field)(t, x.tolist())[0]

    def zero(t: float, x: list[float]) -> bool:
        near = abs(guard.value(t, x)) <= noise
        return near or any(kink.value(t, x) == 0.0 for kink in guard.kinks)

    flow, uses = field.flow(t, x), list(guard.uses)
    step = _first_step(t, x[uses], flow[uses])
    for _ in range(MOVES):
        back, beside = t - step, x - step * flow
        if not zero(back, beside.tolist()):
            return back, beside
        step *= 2.0
    return t, x


def _require_on_surface(scene: Scene, field: Field, t: float, x: StateVector) -> None:
    """Refuse to start sliding off the surface."""
    switching = scene.spec.sliding(field.mode)
    if switching is None:
        return
    side = scene.field(switching.positive)
    index = side.column(switching.name)
    here = _Here(scene, side, t, x, np.zeros(0), expands=False)
    if here.start_of(side.guards[index], index, Jumped())[0] == 0:
        value = side.guards[index].value(t, x.tolist())
        raise StartError(
            f"{describe(scene, field, t, x)}: the run starts to slide off the surface: it is "
            f"{value:.6g} there and must be 0"
        )


def describe(scene: Scene, field: Field, t: float, x: StateVector) -> str:
    """Model, mode, time and state, for error messages."""
    return f"{scene.spec.model}, mode {field.name}, t = {t!r}, {scene.spec.record(x)}"


def is_zero(driver: Driver, guard: Guard, end: Instant, x: StateVector, t: float) -> bool:
    """Whether a guard that moves in its firing direction is zero at a time, and its condition
    holds. Zero is meant to spacings of the time, to the rounding of the guard, and to what the
    steps have lost. The gap of a series of impacts was zero where its flight began: how large the
    states have been before that does not matter."""
    seen = 0.0 * driver.seen if guard.edge in driver.watch.impacts else driver.seen
    value, rate, bend = guard.lie(end.t, x.tolist())
    size, _, _ = extent(driver.scene, guard, driver.entry.field, end.t, x, seen)
    noise = TIE * np.spacing(abs(t)) * abs(rate) + GUARD_ROUNDING * EPS * size
    moves = rate * (DIRECTIONS[guard.crossing] or rate) > 0
    moves = moves and guard.holds(end.t, x.tolist())
    way = end.t - driver.since
    if way > 0.0:
        lost = driver.losses.hide(driver.scene, driver.entry.field, guard, end.t, x, way)
        noise = max(noise, lost)
    moves = moves and not (guard.kind in ("edge", "switch") and turns_within(rate, bend, noise))
    return bool(moves and abs(value) + abs(rate * end.until(t)) <= noise)


def just_left(driver: Driver, guard: Guard, x: StateVector, t: float) -> bool:
    """Whether a guard that is zero at a time, but for rounding, was so where the last jump, its
    own, has led, and still moves as it did there: it does not come to zero, but has not gone
    far."""
    seen = driver.cycles.seen
    if not len(seen.t) or seen.edge[-1] != guard.edge:
        return False
    begun, after = Instant(float(seen.t[-1]), float(seen.low[-1])), seen.x[-1]
    onwards = guard.lie(begun.t, after.tolist())[1] * guard.lie(t, x.tolist())[1] > 0.0
    return bool(onwards) and is_zero(driver, guard, begun, after, t)


def turns_within(rate: float, bend: float, noise: float) -> bool:
    """Whether a guard that is zero turns back within its rounding, before or after: it touches."""
    return rate * rate <= 2.0 * abs(bend) * noise


def side_before(rate: float, bend: float, noise: float) -> int:
    """The sign that a guard had just before it was zero, to its rounding; 0 if unknown."""
    return int(np.sign(bend if turns_within(rate, bend, noise) else -rate))


@attrs.frozen(eq=False, slots=False)
class _Here:
    """A state in a field, and its guards there. ``expands``: whether their Taylor series may be
    used."""

    scene: Scene
    field: Field
    t: float
    x: StateVector
    seen: Numbers
    off: StateVector = attrs.Factory(lambda: np.zeros(0))
    expands: bool = True

    @cached_property
    def series(self) -> Any:
        """Taylor series of states and guards here; None where there is none."""
        return expand(self.field, self.t, self.x) if self.expands else None

    @cached_property
    def reach(self) -> float:
        """The largest absolute state component that the run has seen."""
        return float(np.max(self.seen, initial=0.0))

    def where(self) -> str:
        return describe(self.scene, self.field, self.t, self.x)

    def lost(self, guard: Guard) -> float:
        """What the states in a guard may be off by the tolerances, bounded so that loose tolerances
        do not hide a guard."""
        off = max((float(self.off[i]) for i in guard.uses if len(self.off)), default=0.0)
        return min(off, NEAR * max(self.reach, float(np.abs(self.x).max())))

    def closed(self, guard: Guard, order: int, sign: int, jumped: Jumped) -> bool:
        """Whether a contact is at rest: gap and gap speed are zero and the force pushes."""
        if guard.kind != "contact" or not self.scene.contact(guard.edge).rests:
            return False
        if order != 1:
            return order >= 2 and sign <= 0
        t, x = self.t, self.x.tolist()
        gap, speed, force = guard.lie(t, x)
        sizes = self.scene.rounding(guard, self.field)(t, x)
        fast = extent(self.scene, guard, self.field, self.t, self.x, self.seen)[1]
        series = jumped.series and guard.edge in jumped.vanishing
        given = gap, speed, force, sizes[0], fast, sizes[2], series
        return bool(unit("entries").at_rest(*given))

    def pulls(self, guard: Guard, sign: int, jumped: Jumped) -> bool:
        """Whether, at the start of a run, a contact found closed would have to pull because others
        found since bear the body without it."""
        found = jumped.starting and jumped.tried and guard.kind == "release"
        return bool(found and sign < 0 and released(guard.edge) not in jumped.tried[0])

    def stays(self, guard: Guard, jumped: Jumped) -> bool:
        """Whether a guard that stays zero never fires: the end of a window, the load of bodies that
        fall together, what holds on a surface at its limit, an event at its limit."""
        ends = guard.kind in ("release", "leave") or (
            not guard.bounds and guard.edge in jumped.limit
        )
        return guard.kind == "window" or (ends and self.series is not None)

    def fires(self, guard: Guard, order: int, sign: int, jumped: Jumped) -> bool:
        """Whether a guard fires at once; refuses a state outside the domain."""
        edge, passing = guard.edge, jumped.passing is not None
        if guard.kind == "window":
            return order > 0 and sign < 0
        if not guard.holds(self.t, self.x.tolist()):
            return False
        kind, crossing = NUMBERED[guard.kind], DIRECTIONS[guard.crossing]
        before = jumped.before(edge, order)
        own = guard.kind in ("release", "leave") and not (passing or jumped.starting)
        known = edge == jumped.used, edge in jumped.spent, own, passing, before, guard.urgent
        what = unit("entries").does(kind, crossing, guard.bounds, order, sign, False, *known)
        if what == UNDECIDED:
            raise StartError(
                f"{self.where()}: the guard of {edge} is zero and no derivative along "
                f"the flow decides which way it goes{STARTS_OFF}"
            ).by("undecided")
        set_off = order > 0 and edge == jumped.used and jumped.set_off
        may = set_off and edge not in jumped.vanishing and what in (ARMED, BEYOND)
        if may and self.is_off(guard):
            return True  # it is back in a time that rounding hides
        if what == OUTSIDE:
            self.refuse_outside(guard, jumped.starting)
        elif what == BEYOND and not jumped.onwards:
            self.refuse_beyond(guard)
        elif what == LEAVES and edge not in jumped.vanishing:
            self.require_way(guard, sign, jumped.starting)
        return bool(what == FIRES)

    def refuse_beyond(self, guard: Guard) -> NoReturn:
        """Refuse a flow that leaves the domain through the guard of the edge just taken."""
        raise DomainError(
            f"{self.where()}: the reset of {guard.edge} leaves its guard at zero, and the flow "
            f"leads out of {self.field.mode} from there; lead to a mode that stays there, or "
            "declare a contact, which rests"
        )

    def require_way(self, guard: Guard, sign: int, starting: bool) -> None:
        """Refuse to choose a mode where both flows lead away from the surface of a switching."""
        _, other = heading(self.scene, self.t, guard.to, self.x, guard.edge, self.seen)
        if other != -sign:
            return
        raise (StartError if starting else DomainError)(
            f"{self.where()}: on the surface of {guard.edge} the flows of {self.field.mode} and "
            f"{guard.to} both lead away from it: what follows is not unique; start beside it"
        ).by("undecided")

    def start_of(self, guard: Guard, index: int, jumped: Jumped) -> tuple[int, int]:
        least, (t, x) = jumped.vanishing.get(guard.edge, 0), self.beyond(guard)
        value, passing = guard.value(t, x.tolist()), {} if least else jumped.passing or {}
        if not isfinite(value):
            raise FlowError(f"{self.where()}: the guard of {guard.edge} is {value}")
        if guard.kind == "contact" and -self.lost(guard) <= value <= 0:
            least = max(least, 1)
        least = max(least, 1) if guard.edge in jumped.close else least
        if guard.kind == "contact" and guard.edge in jumped.spent:
            noise = GUARD_ROUNDING * EPS * max(self.reach, float(np.abs(x).max()))
            least = max(least, 1) if abs(value) <= noise else least
        beyond = (guard.bounds or guard.urgent) and value * DIRECTIONS[guard.crossing] > 0
        known = least or beyond or guard.edge in jumped.tied
        far = not known and unit("entries").far(value, max(self.reach, float(np.abs(x).max())))
        if far or value * passing.get(guard.edge, 0) > 0:
            return 0, 1 if value > 0 else -1
        out = self.outwards(guard, index, jumped)
        waits = (-DIRECTIONS[guard.crossing] or jumped.before(guard.edge, 1)) if out else 0
        order, sign = self.decide(guard, index, least, out, waits)
        side = 0 if guard.edge in jumped.tied else jumped.before(guard.edge, 1)
        if guard.crossing is Crossing.EITHER:
            slope = guard.lie(t, x.tolist())[1]
            order, sign = unit("entries").turned(value, slope, order, sign, side)
        return order, sign

    def shares(self, index: int, used: str | None) -> bool:
        """Whether a guard is that of the edge just used
        (:func:`hybrid.rules.entries.shares`)."""
        own = (i for i, guard in enumerate(self.field.guards) if guard.edge == used)
        if self.series is None or (other := next(own, None)) is None:
            return False
        c = (np.array(self.series[1][i], dtype=float) for i in (index, other))
        return bool(unit("entries").alike(*c))

    def outwards(self, guard: Guard, index: int, jumped: Jumped) -> int:
        """A sign that a rate which turns back within rounding does not give a guard
        (:func:`hybrid.rules.entries.start`)."""
        if guard.kind not in ("edge", "switch") or guard.edge == jumped.used:
            return 0
        if guard.kind == "edge" and self.shares(index, jumped.used):
            return 0
        if jumped.before(guard.edge, 1):
            return 1 if guard.lie(self.t, self.x.tolist())[1] > 0 else -1
        return DIRECTIONS[guard.crossing]

    def beyond(self, guard: Guard) -> tuple[float, np.ndarray]:
        """Time and state just beyond the kinks of a guard."""
        return beyond_kinks(self.field, guard.kinks, self.t, self.x)

    def decide(
        self, guard: Guard, index: int, least: int, out: int = 0, waits: int = 0
    ) -> tuple[int, int]:
        """The power of the time by which a guard vanishes, and the sign that it takes
        (:func:`hybrid.rules.entries.start`); ``waits``: the sign with which it waits, 0 if none."""
        t, state = self.beyond(guard)
        x, high, fast = state.tolist(), 0.0, float("inf")
        value, rate, bend = guard.lie(t, x)
        if self.series is None:
            states = np.zeros((0, 2))
            c = [0.0, rate, bend / 2, *(self.third(guard, index) if least > 2 else [])]
        else:
            states, c = np.array(self.series[0]), self.series[1][index]
        if guard.kind == "contact":
            high, fast, _ = extent(self.scene, guard, self.field, self.t, self.x, self.seen)
        elif guard.kind != "release":
            about = self.scene, guard, self.field, self.t, self.x, self.seen
            high = 0.0 if moves_off(*about, waits) else self.highest(guard)
        sizes = self.scene.rounding(guard, self.field)(t, x)
        given = np.array(c), states, len(states), value, rate, t, *sizes, high, fast, least, out
        order, sign = unit("entries").start(*given)
        return order, sign

    def highest(self, guard: Guard) -> float:
        """The sum of absolute terms of a guard at the largest states seen, or the largest of these
        if that is less."""
        if not len(self.seen):
            return 0.0
        high = max((float(self.seen[i]) for i in guard.uses), default=0.0)
        return min(high, extent(self.scene, guard, self.field, self.t, self.x, self.seen)[0])

    def is_off(self, guard: Guard) -> bool:
        """Whether the guard of an edge is off zero, on the side on which it waits."""
        value, x = guard.value(self.t, self.x.tolist()), self.x.tolist()
        size = float(self.scene.rounding(guard, self.field)(self.t, x)[0])
        given = value, DIRECTIONS[guard.crossing], size, self.highest(guard)
        return bool(guard.kind == "edge" and unit("entries").set_off(*given))

    def third(self, guard: Guard, index: int) -> list[float]:
        """The third Taylor coefficient of a contact's gap, where the whole flow has no series."""
        if guard.kind != "contact":
            return []
        local = near(self.field, guard.edge, self.t, self.x.tolist())
        series = None if local is None else expand(local, self.t, self.x)
        return [] if series is None else [series[1][index][3]]

    def refuse_outside(self, guard: Guard, starting: bool) -> NoReturn:
        """Refuse a state outside the mode's domain."""
        value = guard.value(self.t, self.x.tolist())
        side = "positive" if guard.crossing is Crossing.FALLING else "negative"
        what = "starts" if starting else "jumped"
        kind = StartError if starting else DomainError
        other = f"; there flows {guard.to}" if guard.kind == "switch" else ""
        if guard.kind == "release":
            raise kind(
                f"{self.where()}: cannot rest here, the contact would have to pull ({value:.6g})"
            )
        remedy = "" if other else f"; {OUTSIDE_REMEDIES[guard.kind == 'contact', starting]}"
        raise kind(
            f"{self.where()}: the run {what} outside the mode's domain: the guard of "
            f"{guard.edge} is {value:.6g} and must be {side}{other}{remedy}"
        )
