"""An automaton as the arrays that the rules' loop takes (:mod:`hybrid.rules.advance`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton.markers import TERMINATE, Crossing
from ..errors import TraceError
from ..rules import library
from ..rules.arrays import AutomatonArrays, Room
from ..rules.places import (
    AT,
    CHANGES,
    CLOCK,
    CONSTRAINED,
    CONTACT,
    DEPENDS,
    EDGE,
    GUARD_COLUMNS,
    GUARDS,
    GUARDS_END,
    HARD,
    LEAVE,
    LOCAL,
    NONE,
    OWN,
    PLAIN,
    RELEASE,
    REST,
    SIGHT,
    SWITCH,
    TO,
    UNKNOWN,
    WINDOW_END,
    ZERO_COLUMNS,
)
from .lowered import window_ends
from .mode import RELEASE_SUFFIX, Kind
from .native import Native, recall
from .ranges import Ranges
from .tape import Jets, Linked, room

if TYPE_CHECKING:
    from .field import Contact, Field, Guard
    from .scene import Scene

    Sight = Callable[[Field, Contact], Any]

#: Number of steps after which programs are compiled: for a small flow that many steps take about as
#: long as compiling, 0.1 s. After HOT_ORDER_STEPS steps of one order, code specialised to that
#: order is compiled, which takes three times as long.
HOT_STEPS, HOT_ORDER_STEPS = 1 << 16, 1 << 18

Nodes = Callable[[], Sequence[int]]

#: Numbers of the kinds of guards in the rules.
NUMBERED = {
    Kind.EDGE: EDGE,
    Kind.CONTACT: CONTACT,
    Kind.RELEASE: RELEASE,
    Kind.SWITCH: SWITCH,
    Kind.LEAVE: LEAVE,
    Kind.WINDOW: WINDOW_END,
}

#: The direction of zero crossing in which a guard fires; 0 is either.
DIRECTIONS = {Crossing.FALLING: -1, Crossing.RISING: 1, Crossing.EITHER: 0}


class Tables:
    """The fields of a scene requested so far, as rows of tables.

    ``fields`` are in the order of their numbers, and ``numbers`` maps names to numbers. ``guards``
    lists the guards of all fields; for each of them ``modes`` holds the field in which it is
    watched and ``_leads`` the field to which it leads. ``widest`` is the largest number of guards
    of a field, and ``parts`` lists the programs in order. ``others`` is true if another solver
    makes the steps.
    """

    def __init__(self, scene: Scene, others: bool = False) -> None:
        self.scene, self.others = scene, others
        self.numbers: dict[str, int] = {}
        self.fields: list[Field] = []
        self.guards: list[Guard] = []
        self.modes: list[str] = []
        self._leads: list[str] = []
        self._programs = Linked()
        self.bounds = Ranges()
        self.parts: list[Jets] = []
        self._most = np.zeros(3, dtype=int)  # maximum of the programs' sizes
        self.widest = 0
        self.links: Any = None  # of delays, see :class:`.windows.Shown`
        self._fields: list[list[int]] = []
        self._rows: list[list[int]] = []
        self._uses: list[int] = []
        self._made: AutomatonArrays | None = None
        self.named: np.ndarray  # two rows: the field and the edge of each guard, by name
        self.rings: np.ndarray  # whether a guard is a clock
        self.constrained: np.ndarray  # whether the guard's field is a resting or sliding one
        self.free: dict[tuple[int, ...], list[Any]] = {}  # work arrays not used by a run
        self._steps: Counter[int] = Counter()  # steps made, by order
        self._recalled, self._order, self._native = 0, 0, Native()

    def plain(self, number: int) -> bool:
        """Whether the rules' loop can integrate the arcs of a field."""
        return bool(self._fields[number][PLAIN])

    def first(self, number: int) -> int:
        """The number of a field's first guard."""
        return self._fields[number][GUARDS]

    def own(self, number: int) -> list[int]:
        """The numbers of the corresponding guards of the mode without held contacts."""
        first, last = self._fields[number][GUARDS : GUARDS_END + 1]
        return [row[OWN] for row in self._rows[first:last]]

    def number(self, field: Field) -> int:
        """The number of a field, which is added if new."""
        if field.name not in self.numbers:
            self._add(field)
        return self.numbers[field.name]

    @property
    def automaton(self) -> AutomatonArrays:
        """The arrays of all fields requested so far."""
        if self._made is None:
            fields, uses = (np.array(rows, dtype=np.int64) for rows in (self._fields, self._uses))
            guards = np.array(self._rows, dtype=np.int64).reshape(-1, GUARD_COLUMNS)
            programs = self._programs.programs()
            recall(programs, self._recalled, self._order)
            self._recalled = len(programs.code)
            names = [*self.modes, *(guard.edge for guard in self.guards)]
            self.named = np.array(names, dtype=object).reshape(2, -1)
            self.rings = np.array([guard.kind is Kind.CLOCK for guard in self.guards], dtype=bool)
            self.constrained = fields[[self.numbers[m] for m in self.modes], CONSTRAINED] > 0
            self._made = AutomatonArrays(programs, fields, guards, uses, self.bounds.arrays())
        if library.how() != "machine":  # plain Python calls no machine code
            self._made.programs.code[:] = 0
        return self._made

    def flown(self, steps: int, order: int) -> None:
        """Count steps made at an order; past the thresholds, continue compiling the programs."""
        self._steps[order] += steps
        if self._steps.total() > HOT_STEPS:
            written = order if self._steps[order] > HOT_ORDER_STEPS else 0
            self._native.go_on(self.automaton.programs, written)

    @property
    def needs(self) -> tuple[int, ...]:
        """Sizes of the largest program, as :func:`.tape.room` takes them, then the largest number
        of bounded quantities."""
        return (*self._most.tolist(), self.bounds.most)

    def room(self, order: int) -> Room:
        """Work arrays for one run."""
        self._order = order
        return room(self._most, self.scene.spec.dimension, order)

    def watches(self) -> tuple[np.ndarray, ...]:
        """Arrays for a run's guard data: see :class:`.rules.arrays.Now`, from ``orders`` on."""
        own = np.zeros((2, self.widest), dtype=np.int64)
        all_ = np.zeros((4, len(self.guards)), dtype=np.int64)
        return (*own, np.zeros((self.widest, ZERO_COLUMNS)), *all_)

    def complete(self, number: int, column: int, sight: Sight) -> None:
        """Fill in what the loop has requested of a guard.

        This is the field that it leads to, the programs at its contact, its resting field, or what
        bounds need. ``sight`` gives what is bounded at a contact of a field; see
        :func:`hybrid.zeno.narrow.bounded`.
        """
        row, guard = self._rows[number], self.guards[number]
        field = self.fields[self.numbers[self.modes[number]]]
        if column == TO:
            self.number(self.scene.field(self._leads[number]))
        elif guard.kind in (Kind.SWITCH, Kind.LEAVE):
            row[column] = self._beyond(guard) if column == AT else self._slides(guard)
        elif column == AT:
            local = self.scene.contact(guard.edge).local and not field.held
            row[AT], row[LOCAL] = self._at(field, guard.edge), local
        else:
            row[REST] = self._rest(field, guard)
        if column == SIGHT:
            row[DEPENDS], found = sight(field, self.scene.contact(guard.edge))
            if not isinstance(found, int):
                program, *given = found
                among = program.ranged(self.bounds, *given)
                found = HARD if among is None else among
            row[SIGHT] = found
        self._made = None

    def _beyond(self, guard: Guard) -> int:
        """The number of the surface's guard in the mode that the guard leads to."""
        name = guard.edge.rpartition(".")[0] if guard.kind is Kind.LEAVE else guard.edge
        to = self.scene.field(guard.to)
        number = self.number(to)
        return self.first(number) + to.column(name) if self.plain(number) else HARD

    def _slides(self, guard: Guard) -> int:
        """The number of the sliding field of a surface; ``NONE`` if it does not slide."""
        switching = self.scene.spec.switching(guard.edge)
        return self.number(self.scene.field(switching.mode)) if switching.slides else NONE

    def _at(self, field: Field, contact: str) -> int:
        """The number of the first program of a contact; ``HARD`` if there is none."""
        try:
            parts = field.at_contact(contact)
        except TraceError:
            return HARD
        first, *_ = [self._program(part) for part in parts]
        return first

    def _rest(self, field: Field, guard: Guard) -> int:
        """The number of the field with this contact at rest too; ``NONE`` if it does not rest."""
        scene = self.scene
        if not scene.contact(guard.edge).rests:
            return NONE
        return self.number(scene.field(scene.name(field.mode, (*field.held, guard.edge))))

    def _add(self, field: Field) -> None:
        base = self.number(self.scene.field(field.mode)) if field.held else len(self.fields)
        jets, first = field.jets, len(self._rows)
        plain = not field.leans and jets is not None
        plain = plain and all(self._may(field, guard) for guard in field.guards)
        plain = plain and (not field.held or self.plain(base))
        watch = self._watch(field) if plain and self.others else -1
        plain = plain and (not self.others or watch >= 0)
        surface = self._surface(field) if plain else -1
        onto = [self._onto(field, k) if plain and field.held else -1 for k in (False, True)]
        lags = self._lags(field) if plain else -1
        times = [self._times(field, clock) for clock in field.clocks if plain]
        plain = plain and HARD not in (surface, lags, *times) and (not field.held or min(onto) >= 0)
        watched = (*field.guards, *field.clocks) if plain else ()
        whens = [self._when(field, guard) for guard in watched]
        plain = plain and -1 not in whens
        program = self._program(jets) if plain and jets else -1
        guards, clocks = (field.guards, field.clocks) if plain else ((), ())
        self._rows += [
            [*self._row(field, guard, base), when, int(guard.urgent)]
            for guard, when in zip(guards, whens, strict=False)
        ]
        self._rows += [self._clock(field, *each, base) for each in enumerate(times) if plain]
        self.numbers[field.name] = len(self.fields)  # known now: a fault of its contacts has shown
        self.fields.append(field)
        self._leads += [self._lead(field, guard) for guard in (*guards, *clocks)]
        self.guards += (*guards, *clocks)
        self.modes += [field.name] * len((*guards, *clocks))
        self.widest = max(self.widest, len(guards))
        how = CHANGES if plain and self.others and field.changes else int(plain)
        known = [program, first, first + len(guards), how, int(field.project is not None)]
        joins = int(not self.scene.spec.lags)
        rings = first + len(guards) + len(clocks)
        self._fields.append([*known, watch, surface, joins, base, *onto, lags, rings])
        for row, lead in zip(self._rows, self._leads, strict=True):
            row[TO] = self.numbers.get(lead, row[TO])
        self._made = None

    def _may(self, field: Field, guard: Guard) -> bool:
        """Whether the loop can watch a guard: if its formula changes, it must stay defined; and a
        load changes it by a force, not as its contact is moved away, which ends it, too, and a flow
        to a surface not as that jumps."""
        if not guard.kinks:
            return True
        if self.scene.spec.lags or any(kink.change == "ends" for kink in guard.kinks):
            return False
        if guard.kind is Kind.LEAVE:
            return not field.leaps
        if guard.kind is not Kind.RELEASE:
            return True
        return not self.scene.moved_by(field, guard.edge.removesuffix(RELEASE_SUFFIX))

    def _lead(self, field: Field, guard: Guard) -> str:
        """Name of the field to which a guard leads; a jump within the mode keeps all contacts held.

        Empty where Python decides what stays held (see :data:`.places.JOINS`) and for an edge that
        ends the run.
        """
        if guard.kind is Kind.RELEASE:
            if len(field.held) > 1 and self.scene.spec.lags:
                return ""
            released = guard.edge.removesuffix(RELEASE_SUFFIX)
            return self.scene.name(field.mode, tuple(c for c in field.held if c != released))
        if guard.to == TERMINATE:
            return ""
        return field.name if guard.to == field.mode else guard.to

    def _onto(self, field: Field, of_speed: bool) -> int:
        """The number of the program that projects a state along the held contacts."""
        graph = self.scene.code.mode(field.mode)
        return self._of_values(field, ("onto", of_speed), lambda: graph.onto(of_speed))

    def _row(self, field: Field, guard: Guard, base: int) -> list[int]:
        """A guard's row up to its condition; for its columns see :mod:`hybrid.rules.places`."""
        code, uses = self.scene.code, len(self._uses)
        self._uses += guard.uses
        graph, name = code.mode(field.mode), guard.edge
        programs, held, corner = [-1, -1], bool(field.held), guard.kind is Kind.CONTACT
        slides = field.project is not None and not held
        lags, bends = bool(self.scene.spec.lags), bool(guard.kinks)
        # Python decides these: what stays held after a jump that delays see, and gaps with a corner
        judged = (held and lags) or (bends and corner)
        if guard.kind is Kind.CONTACT and not judged:
            programs = [
                self._of_values(field, ("impact", name), lambda: graph.impact(name)),
                self._of_values(field, ("land", name), lambda: graph.land(name)),
            ]
        elif guard.kind is Kind.EDGE and not (judged or (slides and self._again(guard))):
            # an edge that is watched behind it, too, is judged
            programs[0] = self._law(field, "reset", guard.edge)
        sizes = self._of_values(field, ("sizes", name, held), lambda: graph.sizes(name, held))
        kind, crossing = NUMBERED[guard.kind], DIRECTIONS[guard.crossing]
        to = UNKNOWN if self._lead(field, guard) else NONE
        shape = [int(guard.bounds), int(guard.affine), to, *programs, sizes, uses, len(self._uses)]
        kinked = any(other.kinks for other in field.guards)
        judged = guard.kind is Kind.SWITCH and (slides or lags)  # Python decides this one too
        drawn = name in self.scene.spec.chances  # whose impacts have no map of their own
        at = HARD if judged or kinked or drawn else UNKNOWN
        if guard.kind is Kind.WINDOW:
            at = window_ends(self.scene.spec).index(name)
        own, rest = len(self._rows) + field.column(name), UNKNOWN
        if held:
            free = self.first(base) + self.fields[base].column(name.removesuffix(RELEASE_SUFFIX))
            own, rest = (own, free) if guard.kind is Kind.RELEASE else (free, UNKNOWN)
        return [kind, crossing, *shape, int(bends), at, 0, UNKNOWN, rest, 0, own]

    def _when(self, field: Field, guard: Guard) -> int:
        """The number of the program of an edge's condition; ``NONE`` if it has none, -1 if the
        condition has no program."""
        return NONE if guard.when is None else self._law(field, "when", guard.edge)

    def _again(self, guard: Guard) -> bool:
        """Whether an edge is also watched in the mode to which it leads."""
        spec = self.scene.spec
        edges = (*spec.leaving(guard.to), *spec.ringing(guard.to))
        return any(edge.name == guard.edge for edge in edges)

    def _times(self, field: Field, clock: Guard) -> int:
        """The number of the program of a clock's times; ``HARD`` if there is none."""
        number = self._law(field, "clock", clock.edge)
        return HARD if number < 0 else number

    def _clock(self, field: Field, place: int, times: int, base: int) -> list[int]:
        """The row of a clock in the table of guards."""
        clock, slides = field.clocks[place], field.project is not None and not field.held
        judged = self._again(clock) if slides else bool(field.held and self.scene.spec.lags)
        program = -1 if judged else self._law(field, "reset", clock.edge)
        own = (self._fields[base][GUARDS_END] if field.held else len(self._rows)) + place
        to, uses = UNKNOWN if self._lead(field, clock) else NONE, [len(self._uses)] * 2
        shape, when = [0, 0, 1, to, program, -1, -1, *uses, 0], self._when(field, clock)
        return [CLOCK, *shape, times, 0, UNKNOWN, NONE, 0, own, when, 0]

    def _law(self, field: Field, *what: str) -> int:
        """The number of the program of a law of an edge, as its reset; -1 if it has no program."""
        code = self.scene.code
        return self._of_values(
            field, what, lambda: code.mode(field.mode).values(code.closed(*what))
        )

    def _surface(self, field: Field) -> int:
        """The number of the program that projects onto the sliding surface; -1 if the field does
        not slide, ``HARD`` if there is no program."""
        code, switching = self.scene.code, self.scene.spec.sliding(field.mode)
        if switching is None:
            return -1
        onto = lambda: code.mode(field.mode).values(code.onto_closed(switching.name))  # noqa: E731
        number = self._of_values(field, ("onto surface",), onto)
        return HARD if number < 0 else number

    def _lags(self, field: Field) -> int:
        """The number of the program of state- or time-dependent lags; -1 if there are none,
        ``HARD`` if there is no program."""
        code, names = self.scene.code, [lag.name for lag in self.scene.spec.lags]
        if not any(code.moving):
            return -1
        values = code.mode(field.mode).values
        each = lambda: [node for name in names for node in values(code.closed("lag", name))]  # noqa: E731
        number = self._of_values(field, ("lags",), each)
        return HARD if number < 0 else number

    def _watch(self, field: Field) -> int:
        """The number of the program of a field's guards.

        -1 if there is no such program, or if nothing is watched (another solver then needs no
        loop).
        """
        if not field.guards:
            return -1
        graph, edges = self.scene.code.mode(field.mode), [guard.edge for guard in field.guards]
        return self._of_values(field, ("guards", *edges), lambda: list(map(graph.guard, edges)))

    def _of_values(self, field: Field, key: tuple[object, ...], nodes: Nodes) -> int:
        """The number of a program that computes values only; -1 if an operation has no program."""
        try:
            found = self.scene.code.mode(field.mode).of_values(key, nodes)
        except TraceError:
            return -1
        return self._program(found.bind(self.scene.numbers(field.mode, field.held)))

    def _program(self, part: Jets) -> int:
        self._most = np.maximum(self._most, part.tape.needs)
        self.parts.append(part)
        return self._programs.add(part)
