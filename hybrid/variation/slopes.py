"""Derivatives of a scene's functions, in the form the rules take (:class:`.Slopes`)."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from ..errors import TraceError
from ..lowering import Field, Guard, Kind
from ..lowering.automaton import Tables
from ..lowering.native import Native
from ..lowering.tape import Jets, Linked
from ..rules.arrays import Changes, Slopes
from ..rules.places import HARD, NONE, UNKNOWN
from ..rules.variation import GRADIENT, KINKED, RESET_SLOPES, REST_ROW
from .derivatives import Derivatives, Rows
from .series import POINTS, room_for

#: Number of runs after which programs are compiled: carrying perturbations along so many runs takes
#: as long as compiling, 0.3 s.
HOT_RUNS = 1000

#: Kinds of guards through whose jumps the rules carry perturbations.
CARRIED = (Kind.EDGE, Kind.CONTACT, Kind.RELEASE, Kind.SWITCH, Kind.LEAVE, Kind.CLOCK)


class SlopeTables:
    """The fields and guards whose derivatives have been requested, as rows of tables.

    ``parts`` lists the programs in order. All methods raise a :class:`TraceError` if an operation
    has no series or rule.
    """

    def __init__(self, of: Derivatives) -> None:
        self.of = of
        self.parts: list[Jets] = []
        self._programs, self._places, self._count = Linked(), list[np.ndarray](), 0
        self._fields: dict[str, int] = {}
        self._rows: list[list[int]] = []
        self._guards: list[list[int]] = []
        self._needs, self._read = np.zeros(3, dtype=int), 0
        self._slopes: Slopes | None = None

    @property
    def needs(self) -> tuple[int, ...]:
        """Sizes of the largest program, as in :attr:`.Tape.needs`."""
        return tuple(self._needs.tolist())

    @property
    def slopes(self) -> Slopes:
        """The tables."""
        owners = self._owners()
        if self._slopes is None:
            self._slopes = self._tables()
        return self._slopes._replace(of_fields=owners[0], of_guards=owners[1])

    def _tables(self) -> Slopes:
        none = np.zeros(0, dtype=np.int64)
        fields, guards = (
            np.array(self._rows, dtype=np.int64),
            np.array(self._guards, dtype=np.int64),
        )
        places = np.concatenate([np.zeros((0, 2), dtype=np.int64), *self._places])
        fields, guards = (each.reshape(-1, REST_ROW + 1) for each in (fields, guards))
        return Slopes(self._programs.programs(), places, fields, guards, none, none)

    def _owners(self) -> list[np.ndarray]:
        """Row numbers of an automaton's fields and guards."""
        return [np.zeros(0, dtype=np.int64)] * 2

    def room(self, directions: int = 0) -> Changes:
        """Work arrays, for so many directions in parameter space."""
        sizes = self.of.size, self.of.columns, directions, POINTS
        return room_for(self.needs, self._read, *sizes)

    def field(self, field: Field) -> int:
        """The number of a field's row, which is added if new."""
        if field.name not in self._fields:
            row = [*self._along(field, None), *self._onto(field), *[NONE] * (REST_ROW - 4)]
            if field.changes:
                row[KINKED] = self._values(self.of.of_watched(field))
            self._fields[field.name] = len(self._rows)
            self._rows.append(row)
            self._slopes = None
        return self._fields[field.name]

    def guard(self, field: Field, guard: Guard) -> int:
        """Add the row of a guard that fires; returns its number."""
        if guard.kind is Kind.CONTACT:
            return self.contact(field, guard)
        return self._add(
            [*[NONE] * GRADIENT, *self._jump(field, guard), *[NONE] * (REST_ROW - RESET_SLOPES)]
        )

    def contact(self, field: Field, guard: Guard) -> int:
        """Add the row of a contact whose impacts may be summed; returns its number."""
        of, scene = self.of, self.of.scene
        rest = NONE
        if scene.contact(guard.edge).rests:
            rest = self.field(scene.field(scene.name(field.mode, (*field.held, guard.edge))))
        row = [*self._along(field, guard), *self._onto(field), *self._jump(field, guard)]
        laws = of.of_speed(guard, field), of.of_law(guard.edge), of.of_watched(field)
        return self._add([*row, *map(self._values, laws), rest])

    def _add(self, row: list[int]) -> int:
        self._guards.append(row)
        self._slopes = None
        return len(self._guards) - 1

    def _jump(self, field: Field, guard: Guard) -> list[int]:
        """The programs of a guard's gradient and of its reset."""
        reset = self.of.of_reset(guard.edge, guard.kind)
        gradient = self._values(self.of.of_guard(guard, field))
        return [gradient, NONE if reset is None else self._values(reset)]

    def _along(self, field: Field, gap: Guard | None) -> list[int]:
        """The number of a flow's program, and the range of its rows in the table of places."""
        series = self.of.series(field, gap)
        if series is None:
            raise TraceError(f"mode {field.name}: its flow has no power series")
        first, self._count = self._count, self._count + len(series.places)
        self._places.append(series.places)
        return [self._program(series.jets), first, self._count]

    def _onto(self, field: Field) -> list[int]:
        """The number of the program of the projection onto the held contacts, and the number of
        these; or of the projection onto the sliding surface, and 0."""
        slides = self.of.scene.spec.sliding(field.mode)
        if slides is not None:
            return [self._values(self.of.of_surface(field.mode, slides.name)), 0]
        return [self._values(self.of.of_contacts(field)) if field.held else NONE, len(field.held)]

    def _values(self, rows: Rows) -> int:
        return self._program(self.of.values(rows))

    def _program(self, jets: Jets) -> int:
        self._needs = np.maximum(self._needs, jets.tape.needs)
        self._read = max(self._read, len(jets.output))
        self.parts.append(jets)
        return self._programs.add(jets)


class Owned(SlopeTables):
    """The derivatives of an automaton's fields and guards, made when the rules ask for them."""

    def __init__(self, of: Derivatives, automaton: Tables) -> None:
        super().__init__(of)
        self.automaton = automaton
        self._runs, self._native = 0, Native()
        self._known: tuple[int, ...] = ()
        self._rows_of: list[np.ndarray] = []
        self._of_fields: dict[int, int] = {}
        self._of_guards: dict[int, int] = {}

    def flown(self, runs: int) -> None:
        """Count runs with perturbations; past the threshold, continue compiling the programs."""
        self._runs += runs
        if self._runs > HOT_RUNS:
            self._native.go_on(self.slopes.programs)

    def add_field(self, number: int) -> None:
        """Add the automaton's field of this number; without power series Python handles it."""
        self._of_fields[number] = HARD
        with suppress(TraceError):
            self._of_fields[number] = self.field(self.automaton.fields[number])

    def add_guard(self, number: int) -> None:
        """Add the automaton's guard of this number; if its value may jump, Python handles it."""
        guard, mode = self.automaton.guards[number], self.automaton.modes[number]
        self._of_guards[number] = HARD
        if guard.kind in CARRIED and not guard.jumps:
            with suppress(TraceError):
                self._of_guards[number] = self.guard(self.of.scene.field(mode), guard)

    def _owners(self) -> list[np.ndarray]:
        of, automaton = (self._of_fields, self._of_guards), self.automaton
        counts = len(automaton.fields), len(automaton.guards)
        known = *counts, *map(len, of)
        if self._known != known:
            self._known = known
            self._rows_of = [
                np.array([rows.get(k, UNKNOWN) for k in range(count)], dtype=np.int64)
                for rows, count in zip(of, counts, strict=True)
            ]
        return self._rows_of
