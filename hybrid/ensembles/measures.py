"""What a lane is asked for besides its end: points on a section, states at times, time at rest.

A lane that is measured is looked at as it goes on, and no more of it is kept than is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.outputs import evaluated, require_outputs
from ..automaton.reals import reals
from ..automaton.spec import Spec
from ..automaton.trace import instance
from ..errors import OptionError
from ..rules.guards import TIE
from ..rules.zeros import EPS
from ..run.options import require_count
from ..run.sections import EdgeSection, Period, Section, Surface, section_of
from ..trajectory.arcs import Arc, Part
from ..trajectory.log import Flights, Log
from .starts import Lane, Lanes, told

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Measures by name that are no state or output of the model, and what they are.
NAMED = {
    "stick": "share of the time at rest on contacts or sliding",
    "period": "points of the section after which they repeat, 0 where they do not",
}

#: Points of a section are the same where they differ by this share at most of what the lane's
#: states come to: more than tolerances leave on a stable orbit, less than one of twice the period.
SAME_POINT = 1e-6


@attrs.frozen(eq=False)
class Measures:
    """What each lane is asked for, checked.

    Attributes
    ----------
    names : tuple of str
        Those of :data:`NAMED`.
    outputs : list of str
    functions : tuple of callable
        Of the Dataset of all lanes.
    section, crossing, skip, every, keep
        As :func:`hybrid.ensemble` takes them.
    times : array or None
    """

    spec: Any
    names: tuple[str, ...]
    outputs: list[str]
    functions: tuple[Callable[..., Any], ...]
    section: Any
    crossing: Crossing
    skip: int
    every: int
    keep: int
    times: Numbers | None

    @classmethod
    def of(
        cls, spec: Spec, measure: Any, taken: Sequence[str], save: Any, section: Any, points: Any
    ) -> Measures:
        """What a caller asks for.

        Raises
        ------
        OptionError
        """
        given = [measure] if callable(measure) else measure
        functions = tuple(m for m in given if callable(m)) if not isinstance(given, str) else ()
        told = given if isinstance(given, str) else [m for m in given if not callable(m)]
        own = {*spec.names, *(output.name for output in spec.outputs)}
        named = tuple(m for m in told if m in NAMED and m not in own) if functions or told else ()
        rest = told if isinstance(told, str) else [m for m in told if m not in named]
        outputs = require_outputs(spec, rest, taken)
        if "period" in named and section is None:
            raise OptionError(f"{spec.model}: measure 'period' counts points of a section=")
        for name, value, least in zip(
            ("skip", "every", "keep"), points[1:], (0, 1, 1), strict=True
        ):
            require_count(name, value, least)
        crossing, skip, every, keep = points
        counts = skip, every, keep, _times(spec, save)
        return cls(spec, named, outputs, functions, section, crossing, *counts)

    @property
    def alone(self) -> Measures:
        """What another process has to know of it, but for the model's spec."""
        return attrs.evolve(self, spec=None, functions=(), outputs=[])

    @property
    def anything(self) -> bool:
        """Whether lanes have to be looked at on their way."""
        return bool(self.shapes)

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """What is kept of each lane, by name."""
        shapes: dict[str, tuple[int, ...]] = {}
        if self.section is not None:
            shapes |= {"hits": (), "t": (self.keep,), "points": (self.keep, self.spec.dimension)}
        if self.times is not None:
            shapes["saved"] = (len(self.times), self.spec.dimension)
        return shapes | dict.fromkeys(self.names, ())

    @property
    def size(self) -> int:
        """How many numbers that is."""
        return sum(map(math.prod, self.shapes.values()))

    def views(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """By name what is kept; numbers are the last axis."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes.values()])
        parts, lead = np.split(numbers, ends, axis=-1), numbers.shape[:-1]
        pairs = zip(self.shapes.items(), parts, strict=False)
        return {name: part.reshape(lead + shape) for (name, shape), part in pairs}

    def section_of(self, lane: Lane, lanes: Lanes) -> Section | None:
        """The section of a lane."""
        if self.section is None:
            return None
        names = [parameter.name for parameter in self.spec.parameters]
        model = instance(lanes.cls, names, [v[lane.number] for v in lanes.parameters])
        return section_of(model, lane.scene, self.section, self.crossing)

    # -- the table ----------------------------------------------------------------------

    def columns(self, lanes: Lanes, numbers: np.ndarray) -> dict[str, Any]:
        """Variables of a Dataset, from what was kept of all lanes."""
        made: dict[str, Any] = {}
        views = self.views(numbers)
        if "hits" in views:
            made["hits"] = "lane", views["hits"], {"long_name": "points met on the section"}
            made["t_section"] = ("lane", "hit"), views["t"], {"long_name": "time"}
            made |= self._states(lanes, "section", "hit", views["t"], views["points"])
        if self.times is not None:
            made |= self._states(lanes, "saved", "time", self.times, views["saved"])
        for name in self.names:
            made[name] = "lane", views[name], {"long_name": NAMED[name], "units": "1"}
        return made

    def coordinates(self) -> dict[str, Any]:
        """The numbers of the points that are kept, and the times."""
        made: dict[str, Any] = {}
        if self.section is not None:
            numbers = self.skip + self.every * np.arange(self.keep)
            made["hit"] = "hit", numbers, {"long_name": "number of the point on the section"}
        if self.times is not None:
            made["time"] = "time", self.times
        return made

    def _states(
        self, lanes: Lanes, what: str, axis: str, t: np.ndarray, x: np.ndarray
    ) -> dict[str, Any]:
        """The states, and the outputs asked for, at points of lanes."""
        record, made = self.spec.record(x), {}
        for state in self.spec.states:
            dims = "lane", axis, *(f"{state.name}_{i}" for i in range(len(state.shape)))
            made[f"{state.name}_{what}"] = dims, record[state.name], told(state)
        count, points = x.shape[:2]
        rows, times = x.reshape(-1, x.shape[-1]), np.broadcast_to(t, (count, points)).reshape(-1)
        parameters = [np.repeat(values, points, axis=0) for values in lanes.parameters]
        for output in self.spec.outputs:
            if output.name in self.outputs:
                v = evaluated(self.spec, output.name, parameters, times, rows, True)
                v = v.reshape(count, points, *v.shape[1:])
                dims = "lane", axis, *(f"{output.name}_{i}" for i in range(v.ndim - 2))
                made[f"{output.name}_{what}"] = dims, v, told(output)
        return made


def _times(spec: Spec, save: Any) -> np.ndarray | None:
    if save is None:
        return None
    try:
        times = np.atleast_1d(reals(save))
    except ValueError:
        times = np.array([np.nan])
    if times.ndim != 1 or not times.size or not np.all(np.diff(times, prepend=-np.inf) > 0):
        raise OptionError(f"{spec.model}: save={save!r}: increasing times, the same for all lanes")
    return times


def _period(points: np.ndarray, size: StateVector) -> int:
    """After how many points they repeat; each must be seen to."""
    known = points[np.isfinite(points).all(axis=1)]
    for n in range(1, len(known) // 2 + 1):
        if np.all(np.abs(known[n:] - known[:-n]) <= SAME_POINT * size):
            return n
    return 0


class MeasuredLane(Log):
    """What is kept of a lane in place of its parts: what was asked for, and the last part.

    ``numbers`` is NaN where nothing was met.
    """

    def __init__(self, asked: Measures, lane: Lane, section: Section | None) -> None:
        super().__init__()
        self.asked, self.section, self.t0 = asked, section, lane.t[0]
        self.numbers = np.full(asked.size, np.nan)
        self.views = asked.views(self.numbers)
        self.met, self.stuck, self.size = 0, 0.0, 0.0 * lane.x
        strobes = self._strobes(lane.t[1])
        times = np.empty(0) if asked.times is None else asked.times
        self.due = {"points": strobes, "saved": times}

    @property
    def dense(self) -> bool:
        """Whether steps are looked at."""
        timed = any(map(len, self.due.values()))
        return isinstance(self.section, Surface) or timed or "period" in self.views

    def _strobes(self, t1: float) -> np.ndarray:
        """The times of a section in time that are kept."""
        if not isinstance(self.section, Period):
            return np.empty(0)
        numbers = self.asked.skip + self.asked.every * np.arange(self.asked.keep)
        times = self.t0 + (1 + numbers) * self.section.period
        times = np.where(np.abs(times - t1) <= TIE * np.spacing(abs(t1)), t1, times)
        return times[times <= t1]

    def add(self, part: Part | Flights) -> None:
        """Look at the part before, which has ended, and keep this one in its place."""
        self._look()
        self.kept, self.own = [part], {}

    def end(self) -> np.ndarray:
        """All that was asked for, when the run has ended."""
        self._look()
        t1 = self.kept[-1].t1 if self.kept else self.t0
        for name, times in self.due.items():
            for place in np.flatnonzero(times == t1).tolist() if self.kept else ():
                self.views[name][place] = self.kept[-1].last
        if isinstance(self.section, Period):
            self.met = int((t1 - self.t0) / self.section.period * (1.0 + TIE * EPS))
            times = self.due["points"]
            self.views["t"][: len(times)] = np.where(times <= t1, times, np.nan)
        if "stick" in self.views and t1 > self.t0:
            self.views["stick"][...] = self.stuck / (t1 - self.t0)
        if "hits" in self.views:
            self.views["hits"][...] = self.met
        if "period" in self.views:
            self.views["period"][...] = _period(self.views["points"], self.size)
        return self.numbers

    def _look(self) -> None:
        for part in self.kept:
            if "period" in self.views:
                for segment in (s for arc in _arcs(part) for s in arc.segments):
                    self.size = np.maximum(self.size, np.abs(segment.coefficients).sum(axis=0))
            if isinstance(part, Flights):
                constrained = np.array([name.endswith(")") for name in part.modes])
                self.stuck += float(part.lengths[constrained].sum())
            elif isinstance(part, Arc) and part.constrained:
                self.stuck += part.length
            for name, times in self.due.items():
                for k in np.flatnonzero((times >= part.t0) & (times < part.t1)).tolist():
                    self.views[name][k] = _at(part, float(times[k]))
            if isinstance(self.section, EdgeSection):
                self._jumps(part, self.section.name)
            elif isinstance(self.section, Surface):
                self._crossings(part, self.section)

    def _jumps(self, part: Part | Flights, edge: str) -> None:
        """Jumps of an edge."""
        row = self.own.get(0)
        if isinstance(part, Flights):
            for k in np.flatnonzero(part.jumps.edge == edge).tolist():
                self._meet(float(part.jumps.t[k]), part.jumps.after[k])
        elif isinstance(part, Arc) and row is not None and row.edge == edge:
            self._meet(row.t, row.after)

    def _crossings(self, part: Part | Flights, surface: Surface) -> None:
        """Crossings of a surface."""
        for arc in _arcs(part):
            for tau in surface.crossings(arc, starts=arc.t0 <= self.t0):
                self._meet(arc.t0 + (arc.low + tau), arc.local(tau))

    def _meet(self, t: float, x: StateVector) -> None:
        place, rest = divmod(self.met - self.asked.skip, self.asked.every)
        self.met += 1
        if rest == 0 and 0 <= place < self.asked.keep:
            self.views["t"][place], self.views["points"][place] = t, x


def _arcs(part: Part | Flights) -> Sequence[Arc]:
    """The arcs of a part, but for those within a sum of impacts."""
    return part.arcs if isinstance(part, Flights) else [part] if isinstance(part, Arc) else []


def _at(part: Part | Flights, t: float) -> np.ndarray:
    """The state of a part at a time."""
    arc = part if isinstance(part, Arc) else part.arc_at(t)
    return arc.local((t - arc.t0) - arc.low if t > arc.t0 else 0.0)


__all__ = ["MeasuredLane", "Measures"]
