"""Checks that a sum of impacts misses no effect between its sampled flights.

The curve of a tail is built from a few flights. Before the sum is accepted, these checks look for
effects between them (a force pulse, a bump of the table, a restitution that changes at some speed):

- The restitution at every impact of the tail, down to speed zero, is compared with that of the
  sampled flights.
- With python-flint, the gap's acceleration and the restitution are bounded in boxes that contain
  the motion from the first impact to the limit: in doubles rounded outwards and, if these do not
  decide, in ball arithmetic. The bounds must agree with the values at points of the tail up to
  :data:`EXCESS`. A pulse that is weaker, or that some point has hit, is brief compared with its
  flight and has large time derivatives. The time derivative of order :data:`RATES` of the gap's
  acceleration must therefore agree with its values at the points, up to the amount that bends a
  flight by the same excess. A formula that changes shows in no derivative: the function that
  decides on it must keep its sign, unless it is zero at the limit, as the velocity is, and changes
  its sign in every flight.
- The guards of other edges must not be zero in such boxes (:mod:`.others`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property, partial
from importlib.util import find_spec
from itertools import product
from math import exp, inf, log, nextafter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..errors import TraceError
from ..lowering.derivatives import along
from ..lowering.graph import needed
from ..lowering.jaxpr import read
from ..lowering.sides import choosers, on_zero, one_sided
from ..lowering.taylor import flat
from ..rules import unit
from ..rules.places import HARD, NONE
from ..rules.sights import (
    BOX_MARGIN,
    EXCESS,
    LAW_CAUTION,
    LAW_POINTS,
    RATES,
    SLOW_STEPS,
    SLOWEST,
    SPEED_ROW,
    STATE_ROWS,
    TAIL_HALVINGS,
    TIME_ROW,
    brief,
    half_way,
)
from ..rules.sums import LEAST_LOSS, SUM_FLOOR
from ..rules.zeros import EPS
from .accumulate import Tail

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers
    from ..lowering import Contact, Field

#: Deciding functions that have both signs in flights, at most, whose formulas are bounded apart.
BOTH_SIDES = 4

#: A loss below this counts as zero: a few hundred roundings of the restitution.
LOST = 1e-13


def seen(tail: Tail, closing: float = 1.0) -> bool:
    """Whether the checks find no effect that a sum of impacts misses.

    ``closing`` is the tolerance of the sum relative to the run's; a more accurate sum is checked
    more closely.
    """
    return law_error(tail) < inf and _bounded(tail, EXCESS * closing**0.5)


def _depends(field: Field, contact: str) -> bool:
    """Whether a contact's restitution is not constant."""
    code = field.code

    def look() -> bool:
        from ..lowering.graph import Graph

        graph = Graph()
        law = code.closed("restitution", contact)
        (found,) = read(graph, law, code.inputs(graph, ["u"]))
        nodes_ = needed(graph, [int(found.reshape(()))])
        names = [graph.nodes[n][1] for n in nodes_ if graph.nodes[n][0] == "input"]
        return any(name[0] != "p" for name in names)

    return bool(code.once(("law depends", contact), look))


# ---------------------------------------------------------------------------------------
# the restitution at each impact


def law_error(tail: Tail) -> float:
    """A bound on the error in the time of the limit, because the restitution at each impact differs
    a little from that interpolated between the flights of the sum. Infinite if it differs by more
    than the sum's own error allows, or is not below 1."""
    if not _depends(tail.field, tail.contact.name):
        return 0.0
    t_inf, later = tail.t + tail.remaining, tail.remaining / (1.0 - tail.r)
    most = LAW_CAUTION * max(tail.t_error, SUM_FLOOR * abs(t_inf)) / later
    about = tail.column, tail.field.project is not None, tail.curve, tail.t, tail.x, tail.v, tail.r
    rules, laws = unit("sights"), np.empty((2 * LAW_POINTS + 2, 2))
    with tail.programs() as (programs, room):
        off = rules.damped(programs, 0, 1, *about, tail.count, most, room, laws)
        fit = off < inf and rules.slows(programs, 1, t_inf, tail.x_inf, tail.v, room)
    return off * later if fit else inf


def damps(contact: Contact, t: float, x: list[float], speed: float, ratio: float) -> bool:
    """Whether impacts slower than ``speed`` lose enough speed for their times to have a sum.

    The loss ``lost(v) = 1 - r(v)`` may tend to zero with the speed, until it is below :data:`LOST`
    and counts as zero, but must not vanish abruptly. If it tends to zero, flights that have
    shortened by a constant ``ratio`` will not continue to do so. There are ``dn = -dv / (v
    lost(v))`` impacts near speed ``v``, each followed by a flight whose time is proportional to
    ``v``, so the times have a sum only if ``v / lost(v)`` falls with ``v``.
    """
    fades = 1.0 - contact.law(t, x, -0.0) < LEAST_LOSS
    if fades and ratio < 1.0:
        return False
    way = log(SLOWEST) - log(speed) if speed > 0 else 0.0
    fall = min(exp(way / SLOW_STEPS), 1.0)
    before, pace = 1.0, inf
    for k in range(SLOW_STEPS + 1):
        u = speed * fall**k
        lost = 1.0 - contact.law(t, x, -u)
        if lost < -8.0 * EPS or (lost < LOST and before > LOST / fall**2):
            return False
        if fades and lost >= LOST:
            if u >= pace * lost:
                return False
            pace = u / lost
        before = lost
    return True


# ---------------------------------------------------------------------------------------
# boxes


@attrs.frozen(eq=False, slots=False)
class Stretch:
    """A stretch of a tail: the flights after impacts ``first`` to ``last``.

    An infinite ``last`` is the limit. Of each flight, the stretch covers the part between the
    fractions ``begin`` and ``end`` of its duration.
    """

    tail: Tail
    first: float = 0.0
    last: float = inf
    begin: float = 0.0
    end: float = 1.0

    @cached_property
    def _shown(self) -> list[list[float]]:
        ends = self.tail.r**self.first, self.tail.r**self.last
        return self.tail.shown(*ends, self.begin, self.end).tolist()

    @cached_property
    def points(self) -> list[tuple[float, list[float], float]]:
        """Times, states, and gap speeds before impacts, at points of the flights."""
        return [(t, x, u) for t, *x, u, _, _ in self._shown[:-2]]

    def box(self) -> dict[str, Any]:
        """Bounds on time (within the flights), states, and gap speeds before impacts."""
        (early, *low, slow, leaves, _), (late, *high, fast, _, lands) = self._shown[-2:]
        rooms = [BOX_MARGIN * (b - a) for a, b in zip(low, high, strict=True)]
        ends = zip(low, high, rooms, strict=True)
        inputs = named("x", ((nextafter(a - s, -inf), nextafter(b + s, inf)) for a, b, s in ends))
        room = BOX_MARGIN * (late - early)
        times = max(early - room, leaves), min(late + room, lands)
        return inputs | {"t": times, "u": (slow, fast if self.last < inf else 0.0)}

    @property
    def longest(self) -> float:
        """Duration of the longest flight."""
        return max(lands - leaves for *_, leaves, lands in self._shown[:-2])

    def halves(self) -> list[Stretch]:
        """Two stretches of about half the duration; for a single flight, its two halves."""
        if self.first == self.last:
            middle = 0.5 * (self.begin + self.end)
            return [attrs.evolve(self, end=middle), attrs.evolve(self, begin=middle)]
        middle = half_way(self.first, self.last, self.tail.r)
        return [attrs.evolve(self, last=middle), attrs.evolve(self, first=middle + 1.0)]


def _bounded(tail: Tail, excess: float) -> bool:
    """Whether bounds on acceleration and restitution in boxes along the tail agree, up to
    ``excess``, with the values at points."""
    if find_spec("flint") is None:
        return True
    try:
        look, stretches = _look(tail), [(TAIL_HALVINGS, Stretch(tail))]
    except TraceError:  # an operation without ball arithmetic
        return True
    while stretches:
        left, stretch = stretches.pop()
        if not _fits(look, stretch, excess):
            if not left:
                return False
            stretches += [(left - 1, half) for half in stretch.halves()]
    return True


def _fits(look: _Look, stretch: Stretch, excess: float) -> bool:
    """Whether the bounds on a stretch agree with the values at its points."""
    box = look.given | stretch.box()
    if not look.keeps(box):
        return False
    values = np.array([look.at(*point) for point in stretch.points])
    low, high = values.min(axis=0).tolist(), values.max(axis=0).tolist()
    sizes = [*map(max, [-a for a in low[:-1]], high), 1.0]
    rooms = [b - a + excess * size for a, b, size in zip(low, high, sizes, strict=True)]
    least = [a - room for a, room in zip(low, rooms, strict=True)]
    most = [b + room for b, room in zip(high, rooms, strict=True)]
    most[0], most[-1] = min(most[0], nextafter(0.0, -inf)), min(most[-1], 1.0 - LEAST_LOSS)
    ranges = look.program.ranges(box)
    if ranges and all(map(_within, *zip(*ranges[:-1], strict=True), least, most)):
        rate: tuple[Any, Any] = ranges[-1]
    else:
        balls = look.enclose(box)
        if balls is None or not all(map(_within, balls[:-1], balls[:-1], least, most)):
            return False
        rate = (balls[-1], balls[-1])
    return _steady(look, stretch, *rate, excess, brief(excess * sizes[0], stretch.longest))


def _steady(
    look: _Look, stretch: Stretch, low: Any, high: Any, excess: float, small: float
) -> bool:
    """Whether the highest time derivative of the acceleration, between ``low`` and ``high``, is at
    most ``small``, or agrees with its values at the points up to an excess."""
    if _within(low, high, -small, small):
        return True
    rates = [look.rate(*point) for point in stretch.points]
    least, most = min(rates), max(rates)
    room = most - least + small + excess * max(-least, most)
    return _within(low, high, least - room, most + room)


def _within(low: Any, high: Any, least: float, most: float) -> bool:
    return bool(least <= low) and bool(high <= most)


@attrs.frozen(eq=False)
class _Look:
    """The functions that are bounded along a tail.

    These are the gap's acceleration, the accelerations of deciding functions, the restitution, and
    the highest time derivative of the gap's acceleration. Where gap or flow change their formula at
    the impacts, the formula that holds in the flights is used (for a distance ``|x|``, the one at
    zero), since balls around the impact contain both sides. The accelerations of the deciding
    functions must then also agree with their values at points, so that none of them changes sign in
    between.
    """

    program: Any
    sides: Callable[[], list[Any]]
    given: dict[str, float]
    keeps: Callable[[dict[str, Any]], bool]
    at: Callable[[float, list[float], float], list[float]]
    rate: Callable[[float, list[float], float], float]

    def enclose(self, box: dict[str, Any]) -> list[Any] | None:
        """Balls that contain the functions on a box, if need be formula by formula; None if one may
        be undefined there."""
        found = self.program.enclose(box)
        if all(each.defined for each in found):
            return [each.value for each in found]
        sides = [program.enclose(box) for program in self.sides()]
        if not sides or not all(each.defined for side in sides for each in side):
            return None
        from ..bounds.balls import hull

        return [hull(*(each.value for each in column)) for column in zip(*sides, strict=True)]


def bounded(field: Field, contact: Contact) -> tuple[bool, Any]:
    """Whether a contact's restitution is not constant, and the functions to bound along its tails.

    The second value is an :class:`.IntervalProgram`, the rows of a box that are its inputs, and the
    values of its other inputs. It is ``NONE`` if nothing can be bounded, ``HARD`` if deciding
    functions require ball arithmetic.
    """
    return _depends(field, contact.name), _ranged(field, contact)


def _ranged(field: Field, contact: Contact) -> Any:
    if find_spec("flint") is None:
        return NONE
    try:
        gap = _gap(field, contact)
        if gap.choosers:
            return HARD
        program = gap.program({}, *gap.guards(field, contact.name))
    except TraceError:
        return NONE
    rows = {f"x{i}": STATE_ROWS + i for i in range(len(gap.states))}
    return program, {"t": TIME_ROW, "u": SPEED_ROW, **rows}, parameters(field)


def _gap(field: Field, contact: Contact) -> _Gap:
    name = contact.name
    made = field.code.once(("gap", field.name, name), lambda: _Gap(field, name))
    return made  # type: ignore[no-any-return]


def _program(
    field: Field, contact: Contact, gap: _Gap, signs: dict[int, int], both: Sequence[int] = ()
) -> Any:
    key = ("narrow", field.name, contact.name, *signs.items(), *both)
    return field.code.once(key, lambda: gap.program(signs, both=both))


def parameters(field: Field) -> dict[str, Any]:
    return field.once("parameters by name", lambda: named("p", flat(field.parameters)))  # type: ignore[no-any-return]


def _look(tail: Tail) -> _Look:
    field, contact = tail.field, tail.contact
    gap = _gap(field, contact)
    signs, both = gap.signs(tail)
    program, given = _program(field, contact, gap, signs), parameters(field)
    lie, law = field.guards[tail.column].lie, contact.law

    def every(t: float, x: list[float], u: float) -> list[float]:
        point = {**given, **named("x", x), "t": t, "u": u}
        if ranges := program.ranges(point):
            return [0.5 * (low + high) for low, high in ranges]
        found = program.enclose(point)
        return [float(each.value.mid()) if each.defined else np.nan for each in found]

    def plain(t: float, x: list[float], u: float) -> list[float]:
        return [lie(t, x)[2], law(t, x, u)]

    def signed(t: float, x: list[float], u: float) -> list[float]:
        return every(t, x, u)[:-1]

    at = signed if signs else plain
    apart = [signs] if not both else _apart(gap, signs, both)

    def sides() -> list[Any]:
        return [_program(field, contact, gap, each, both) for each in apart] if both else []

    @cache
    def kept() -> list[Callable[[dict[str, Any]], bool]]:
        return [partial(_keeps, gap.sided(each), gap.ends(tail, each)) for each in apart]

    def keeps(box: dict[str, Any]) -> bool:
        return bool(apart) and all(each(box) for each in kept())

    return _Look(program, sides, given, keeps, at, lambda *point: every(*point)[-1])


def _apart(gap: _Gap, signs: dict[int, int], both: list[int]) -> list[dict[int, int]]:
    """The signs of the deciding functions in each part of the flights, in which those that have
    both signs have one; empty if these are too many."""
    if len(both) > BOTH_SIDES:
        return []
    ways = (dict(zip(both, way, strict=True)) for way in product((1, -1), repeat=len(both)))
    found = [signs | way for way in ways]
    return [{n: each[n] for n in gap.choosers if n in each} for each in found]


class _Gap:
    """The gap of a contact along a field, with the functions that decide on formulas."""

    def __init__(self, field: Field, contact: str) -> None:
        from ..bounds.exact import FixedGraph
        from ..bounds.interval import IntervalProgram

        code, self.graph = field.code, FixedGraph(exact=True)
        inputs = self.inputs = code.inputs(self.graph)
        self.time, self.states = int(inputs[-2]), [int(i) for i in inputs[-1]]
        flow = code.field_closed(field.mode, field.held)
        law, extra = code.closed("restitution", contact), np.array(self.graph.input("u"))
        self.flow = self._nodes(flow, inputs)
        (gap,) = self._nodes(code.closed("gap", contact), inputs)
        self.gap = on_zero(self.graph, len(self.states), gap, code.defaults())
        (self.law,) = self._nodes(law, [*inputs, extra])
        self.choosers = choosers(self.graph, [self.gap, *self.flow])
        self.deciding = IntervalProgram(self.graph, self.choosers) if self.choosers else None

    def _nodes(self, closed: Any, inputs: list[Any]) -> list[int]:
        (found,) = read(self.graph, closed, inputs)
        return [int(i) for i in found.reshape(-1)]

    def sided(self, signs: dict[int, int]) -> Any:
        """The deciding functions, with the formulas that hold in all flights; None if there are
        none."""
        from ..bounds.interval import IntervalProgram

        if not signs:
            return self.deciding
        nodes = one_sided(self.graph, self.choosers, signs)
        return IntervalProgram(self.graph, nodes[: len(self.choosers)])

    def signs(self, tail: Tail) -> tuple[dict[int, int], list[int]]:
        """By node, the sign in all flights of each deciding function that is zero at the limit; and
        the nodes of those that have both signs in flights."""
        if self.deciding is None:
            return {}, []
        flown = [(t, x) for t, x, _ in Stretch(tail).points]
        last, *others = (_signs(self.deciding, tail, *point) for point in [_limit(tail), *flown])
        ways = np.min(others, axis=0) + np.max(others, axis=0)  # +-1 if no two signs are opposite
        columns = zip(self.choosers, last, ways, strict=True)
        at_zero = [(n, way) for n, end, way in columns if end == 0.0]
        known = {n: int(way) for n, way in at_zero if abs(way) == 1.0}
        return known, [n for n, way in at_zero if abs(way) != 1.0]

    def ends(self, tail: Tail, signs: dict[int, int]) -> list[float]:
        """The signs of the deciding functions at the limit, with the formulas that hold in flights
        of given signs."""
        if self.deciding is None:
            return []
        return np.nan_to_num(_signs(self.sided(signs), tail, *_limit(tail))).tolist()

    def guards(self, field: Field, contact: str) -> list[int]:
        """The nodes of the guards other than the contact's; empty if one has no bounds."""
        from ..bounds.interval import IntervalProgram

        others = [guard for guard in field.guards if guard.edge != contact]
        try:
            found = [n for guard in others for n in self._nodes(guard.closed, self.inputs)]
            IntervalProgram(self.graph, found)
        except TraceError:
            return []
        return found

    def program(self, signs: dict[int, int], *others: int, both: Sequence[int] = ()) -> Any:
        """The program of the functions to bound, for given signs of the deciding functions that are
        zero at the limit; then the nodes ``others``. Those in ``both`` are not bounded themselves,
        as they have both signs."""
        from ..bounds.interval import IntervalProgram

        graph, count = self.graph, 1 + len(self.flow)
        nodes = one_sided(graph, [self.gap, *self.flow], signs)
        rates = dict(zip(self.states, nodes[1:count], strict=True)) | {self.time: graph.const(1.0)}

        def rate(node: int, times: int) -> int:
            return rate(along(graph, node, rates), times - 1) if times else node

        own = [n for n, chooser in zip(nodes[count:], signs, strict=True) if chooser not in both]
        roots = [rate(n, 2) for n in [nodes[0], *own]]
        return IntervalProgram(graph, [*roots, self.law, rate(roots[0], RATES), *others])


def _limit(tail: Tail) -> tuple[float, list[float]]:
    return tail.t + tail.remaining, tail.x_inf.tolist()


def _signs(deciding: Any, tail: Tail, t: float, x: list[float]) -> Numbers:
    """The signs of deciding functions at a point, 0 where rounding decides."""
    given = named("p", flat(tail.field.parameters)) | named("x", x) | {"t": t}
    found = [float(e.value.mid()) if e.defined else np.nan for e in deciding.enclose(given)]
    rounding = 64 * EPS * max(np.abs(tail.x_inf).max(), np.abs(tail.x).max())
    return np.where(np.abs(found) <= rounding, 0.0, np.sign(found))


def _keeps(deciding: Any, ends: list[float], box: dict[str, Any]) -> bool:
    """Whether each deciding function that is not zero at the limit keeps, all over a box, its
    sign at the limit. If it does not, the formula may change in some flights only, and sampled
    flights need not show that."""
    if deciding is None:
        return True
    return all(
        each.defined and bool(each.value * int(end) > 0)
        for each, end in zip(deciding.enclose(box), ends, strict=True)
        if end != 0.0
    )


def named(letter: str, values: Iterable[Any]) -> dict[str, Any]:
    """Values by the names of a graph's inputs: ``x0``, ``x1``, ..."""
    return {f"{letter}{i}": value for i, value in enumerate(values)}
