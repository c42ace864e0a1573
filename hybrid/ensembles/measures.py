"""Measures of a lane besides its final state: points on a section, states at times, time at rest.

They are computed while the lane runs, so that its trajectory need not be kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.outputs import evaluated, require_outputs
from ..automaton.reals import reals
from ..automaton.spec import Spec
from ..automaton.trace import instance
from ..errors import OptionError, OrbitError
from ..lowering import Scene
from ..lowering.scene import parted, rest_name
from ..rules.guards import TIE
from ..rules.zeros import EPS
from ..run.options import require_count
from ..run.sections import EdgeSection, Period, Section, Sides, Surface, section_of
from ..trajectory.arcs import Arc, Part, arcs_of
from ..trajectory.log import Flights, Log
from ..variation import GROWN_APART, TRANSIENT, Course, factors_of, first_frame, grown, largest
from .starts import Lane, Lanes, attributes_of

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector

#: Measures by name, other than states and outputs of the model, and their descriptions.
NAMED = {
    "stick": "share of the time at rest on contacts or sliding",
    "period": "points of the section after which they repeat, 0 where they do not",
    "lyapunov": "largest Lyapunov exponent over the last nine tenths of the time",
}

#: Description of the variable ``moves``.
STILL_MOVES = "largest change of a state over the last eighth of the time, against its size"

#: Fraction of a lane's time, at its end, over which ``moves`` is measured.
STILL_SHARE = 0.125

#: Points of a section are equal if they differ by at most this fraction of the largest states of
#: the lane. Tolerances cause smaller differences on a stable orbit; an orbit of twice the period
#: has larger ones.
SAME_POINT = 1e-6


@attrs.frozen(eq=False)
class Measures:
    """The measures of each lane, checked.

    Attributes
    ----------
    names : tuple of str
        Names from :data:`NAMED`.
    outputs : list of str
        Outputs of the model.
    functions : tuple of callable
        Functions of the Dataset of all lanes.
    section, crossing, skip, every, keep
        As for :func:`hybrid.ensemble`.
    times : array or None
        Times at which states are kept.
    """

    spec: Any
    names: tuple[str, ...]
    outputs: list[str]
    functions: tuple[Callable[..., Any], ...]
    section: Any
    crossing: Crossing
    skip: int | None
    every: int
    keep: int
    times: Numbers | None

    @classmethod
    def of(
        cls, spec: Spec, measure: Any, taken: Sequence[str], save: Any, section: Any, points: Any
    ) -> Measures:
        """Check the arguments of :func:`hybrid.ensemble`; ``points`` are crossing, skip, every and
        keep, and ``taken`` are names that outputs must not have."""
        given = [measure] if callable(measure) else measure
        functions = tuple(m for m in given if callable(m)) if not isinstance(given, str) else ()
        names = given if isinstance(given, str) else [m for m in given if not callable(m)]
        own = {*spec.names, *(output.name for output in spec.outputs)}
        named = tuple(m for m in names if m in NAMED and m not in own) if functions or names else ()
        rest = names if isinstance(names, str) else [m for m in names if m not in named]
        outputs = require_outputs(spec, rest, taken, NAMED)
        if "period" in named and section is None:
            raise OptionError(f"{spec.model}: measure 'period' counts points of a section=")
        if "lyapunov" in named and (spec.lags or spec.discrete):
            these = ", ".join(state.name for state in spec.discrete)
            why = "looks into the past" if spec.lags else f"has discrete variables ({these})"
            raise OptionError(
                f"{spec.model} {why}: measure 'lyapunov' is known for models of continuous states "
                "without delays; leave it out"
            )
        for name, value, least in zip(
            ("skip", "every", "keep"), points[1:], (0, 1, 1), strict=True
        ):
            if not (name == "skip" and value is None):
                require_count(name, value, least)
        crossing, skip, every, keep = points
        counts = skip, every, keep, _times(spec, save)
        return cls(spec, named, outputs, functions, section, crossing, *counts)

    @property
    def alone(self) -> Measures:
        """The measures as sent to another process, which has its own spec of the model."""
        return attrs.evolve(self, spec=None, functions=(), outputs=[])

    @property
    def anything(self) -> bool:
        """Whether a lane must be measured while it runs."""
        return bool(self.shapes)

    @property
    def jumps_only(self) -> bool:
        """Whether the table of a lane's jumps suffices for its measures."""
        return isinstance(self.section, str) and set(self.shapes) == {"hits", "t", "points"}

    def of_jumps(self, fired: Matrix, when: Matrix, after: np.ndarray) -> Matrix:
        """The measures of lanes, computed from their jumps.

        Parameters
        ----------
        fired : array of bool, shape (lanes, jumps)
            Which jumps are jumps of the section.
        when, after : arrays, shapes (lanes, jumps) and (lanes, jumps, n)
            Times of the jumps, and states after them.

        Returns
        -------
        array, shape (lanes, size)
            NaN for points that a lane does not have.
        """
        assert self.skip is not None
        numbers = np.full((len(fired), self.size), np.nan)
        views = self.views(numbers)
        views["hits"][...] = fired.sum(axis=1)
        place, rest = np.divmod(np.cumsum(fired, axis=1) - 1 - self.skip, self.every)
        lanes, jumps = np.nonzero(fired & (rest == 0) & (place >= 0) & (place < self.keep))
        where = lanes, place[lanes, jumps]
        views["t"][where], views["points"][where] = when[lanes, jumps], after[lanes, jumps]
        return numbers

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the measures of one lane, by name."""
        shapes: dict[str, tuple[int, ...]] = {}
        if self.section is not None:
            shapes |= {"hits": (), "t": (self.keep,), "points": (self.keep, self.spec.dimension)}
        if self.section is not None and self.skip is None:
            shapes |= {"modes": (self.keep,), "moves": ()}
            shapes |= dict.fromkeys(("size", "range"), (self.spec.dimension,))
        if self.times is not None:
            shapes["saved"] = (len(self.times), self.spec.dimension)
        return shapes | dict.fromkeys(self.names, ())

    @property
    def size(self) -> int:
        """The number of numbers of all measures of one lane."""
        return sum(map(math.prod, self.shapes.values()))

    def views(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Views by name of an array of measures, whose last axis has the length ``size``."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes.values()])
        parts, lead = np.split(numbers, ends, axis=-1), numbers.shape[:-1]
        pairs = zip(self.shapes.items(), parts, strict=False)
        return {name: part.reshape(lead + shape) for (name, shape), part in pairs}

    def section_of(self, lane: Lane, lanes: Lanes) -> Section | None:
        """The section of a lane, with the lane's parameters; None without a section."""
        if self.section is None:
            return None
        own = *(v[lane.number] for v in lanes.parameters), *lane.scene.samples
        model = instance(lanes.cls, self.spec.given, own)
        return section_of(model, lane.scene, self.section, self.crossing)

    # -- the table ----------------------------------------------------------------------

    def columns(self, lanes: Lanes, numbers: np.ndarray) -> dict[str, Any]:
        """Variables of a Dataset, from the measures of all lanes, shape ``(lanes, size)``."""
        made: dict[str, Any] = {}
        views = self.views(numbers)
        if "hits" in views:
            made["hits"] = "lane", views["hits"], {"long_name": "points met on the section"}
            made["t_section"] = ("lane", "hit"), views["t"], {"long_name": "time"}
            made |= self._states(lanes, "section", "hit", views["t"], views["points"])
        if "modes" in views:
            made["mode_section"] = (
                ("lane", "hit"),
                views["modes"],
                {"long_name": "number of a mode"},
            )
            made["moves"] = "lane", views["moves"], {"long_name": STILL_MOVES, "units": "1"}
            for what in ("size", "range"):
                made |= self._vectors(what, views[what])
        if self.times is not None:
            made |= self._states(lanes, "saved", "time", self.times, views["saved"])
        for name in self.names:
            units = {} if name == "lyapunov" else {"units": "1"}  # one over the unit of time
            made[name] = "lane", views[name], {"long_name": NAMED[name]} | units
        return made

    def coordinates(self) -> dict[str, Any]:
        """Coordinates of a Dataset: the numbers of the points that are kept, and the times."""
        made: dict[str, Any] = {}
        if self.section is not None:
            first = -self.every * self.keep if self.skip is None else self.skip
            numbers = first + self.every * np.arange(self.keep)
            made["hit"] = "hit", numbers, {"long_name": "number of the point on the section"}
        if self.times is not None:
            made["time"] = "time", self.times
        return made

    def _vectors(self, what: str, values: np.ndarray) -> dict[str, Any]:
        """Variables of a Dataset with a number for each state element: ``x_<what>``, ..."""
        record = self.spec.record(values)
        return {
            f"{s.name}_{what}": (
                ("lane", *(f"{s.name}_{i}" for i in range(len(s.shape)))),
                record[s.name],
                attributes_of(s),
            )
            for s in self.spec.states
        }

    def _states(
        self, lanes: Lanes, what: str, axis: str, t: np.ndarray, x: np.ndarray
    ) -> dict[str, Any]:
        """Variables of a Dataset with states and requested outputs at points of all lanes, where
        ``x`` has the shape (lanes, points, n)."""
        record, made = self.spec.record(x), {}
        for state in self.spec.states:
            dims = "lane", axis, *(f"{state.name}_{i}" for i in range(len(state.shape)))
            made[f"{state.name}_{what}"] = dims, record[state.name], attributes_of(state)
        count, points = x.shape[:2]
        rows, times = x.reshape(-1, x.shape[-1]), np.broadcast_to(t, (count, points)).reshape(-1)
        given: list[Any] = [np.repeat(values, points, axis=0) for values in lanes.parameters]
        given += [each.repeated(points) for each in lanes.samples]
        for output in self.spec.outputs:
            if output.name in self.outputs:
                v = evaluated(self.spec, output.name, given, times, rows, True)
                v = v.reshape(count, points, *v.shape[1:])
                dims = "lane", axis, *(f"{output.name}_{i}" for i in range(v.ndim - 2))
                made[f"{output.name}_{what}"] = dims, v, attributes_of(output)
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
    """The number of points after which the points repeat; 0 if they do not. Each number up to half
    of the points is tried, and all points must repeat."""
    known = points[np.isfinite(points).all(axis=1)]
    for n in range(1, len(known) // 2 + 1):
        if np.all(np.abs(known[n:] - known[:-n]) <= SAME_POINT * size):
            return n
    return 0


class MeasuredLane(Log):
    """A log that keeps the measures of a lane and its last part, in place of all its parts.

    ``numbers`` holds the measures; NaN for points that the lane does not reach.
    """

    def __init__(self, asked: Measures, lane: Lane, section: Section | None, rtol: float) -> None:
        super().__init__()
        self.asked, self.section, self.t0 = asked, section, lane.t[0]
        self.numbers = np.full(asked.size, np.nan)
        self.views = asked.views(self.numbers)
        self.met, self.stuck, self.size = 0, 0.0, 0.0 * lane.x
        self.middle = 0.5 * (lane.t[0] + lane.t[1])
        self.low, self.high = np.inf + self.size, -np.inf + self.size
        self.scene, self.whole = lane.scene, Log()
        self.sides = Sides(section, self.t0, rtol) if isinstance(section, Surface) else None
        strobes = self._strobes(lane.t[1])
        times = np.empty(0) if asked.times is None else asked.times
        self.due = {"points": strobes, "saved": times}

    @property
    def dense(self) -> bool:
        """Whether the measures need dense output."""
        timed = any(map(len, self.due.values()))
        return isinstance(self.section, Surface) or timed or self.sized or self.varied

    @property
    def varied(self) -> bool:
        """Whether the Lyapunov exponent is measured, for which the whole lane is kept."""
        return "lyapunov" in self.views

    @property
    def sized(self) -> bool:
        """Whether the sizes of the states are measured."""
        return "period" in self.views or "size" in self.views

    def _strobes(self, t1: float) -> np.ndarray:
        """The times of the stroboscopic section at which states are kept; empty for others."""
        if not isinstance(self.section, Period):
            return np.empty(0)
        skip, every, keep = self.asked.skip, self.asked.every, self.asked.keep
        if skip is None:  # the lane's end is not known yet: all states, later ones replace others
            numbers = np.arange(0, self._periods(t1), every)
        else:
            numbers = skip + every * np.arange(keep)
        times = self.t0 + (1 + numbers) * self.section.period
        times = np.where(np.abs(times - t1) <= TIE * np.spacing(abs(t1)), t1, times)
        return times[times <= t1]

    def _periods(self, t1: float) -> int:
        """The number of whole periods from the start to time ``t1``, up to rounding."""
        assert isinstance(self.section, Period)
        return int((t1 - self.t0) / self.section.period * (1.0 + TIE * EPS))

    def add(self, part: Part | Flights) -> None:
        """Measure the previous part, which has ended, and replace it by this one."""
        self._measure_kept(part)
        self.kept, self.own = [part], {}

    def end(self) -> np.ndarray:
        """All measures as an array, shape ``(size,)``; to be called when the run has ended."""
        self._measure_kept()
        t1 = self.kept[-1].t1 if self.kept else self.t0
        for name, times in self.due.items():
            for k in np.flatnonzero(times == t1).tolist() if self.kept else ():
                self._keep_timed(name, k, self.kept[-1].last, self.kept[-1].mode)
        if isinstance(self.section, Period):
            self.met = self._periods(t1)
        if "modes" in self.views:
            self._sort_last_points()
        if "moves" in self.views:
            self.views["size"][...] = self.size
            self.views["range"][...] = np.maximum(self.high - self.low, 0.0)
            self.views["moves"][...] = self._moves(t1)
        if "stick" in self.views and t1 > self.t0:
            self.views["stick"][...] = self.stuck / (t1 - self.t0)
        if "hits" in self.views:
            self.views["hits"][...] = self.met
        if "period" in self.views:
            self.views["period"][...] = _period(self.views["points"], self.size)
        if self.varied:
            self.views["lyapunov"][...] = self._largest()
        return self.numbers

    def _largest(self) -> float:
        """The largest Lyapunov exponent; NaN if there is no first variation."""
        course = Course(self.scene, *self.whole.apart())
        if not course.parts:  # the lane could not begin
            return np.nan
        try:
            pieces, frame = factors_of(course, GROWN_APART), first_frame(len(self.size), 1)
            model, sizes = self.scene.spec.model, largest(course.parts)
            times, growth, _ = grown(model, pieces, frame, sizes)
        except OrbitError:
            return np.nan
        if not times.size or times[-1] <= self.t0:
            return np.nan
        passed = times[times >= self.t0 + TRANSIENT * (times[-1] - self.t0)][0]
        since = passed if passed < times[-1] else self.t0
        onto = [t for t, end in self._constrained(course.parts) if t <= since < end]
        since, kept = (onto[0], times >= onto[0]) if onto else (since, times > since)
        return float(growth[kept].sum() / (times[-1] - since))

    def _constrained(self, parts: Sequence[Part]) -> Iterator[tuple[float, float]]:
        """First and last times of the arcs at rest or sliding, which start with a projection."""
        for part in parts:
            if isinstance(part, Arc) and self.scene.field(part.mode).project is not None:
                yield part.t0, part.t1

    def _sort_last_points(self) -> None:
        """Sort the last points by time; they were written to a ring buffer."""
        kept = -(-self.met // self.asked.every)
        if kept > self.asked.keep:
            for name in ("t", "points", "modes"):
                view = self.views[name]
                view[...] = np.roll(view, -(kept % self.asked.keep), axis=0)

    def _moves(self, t1: float) -> float:
        """The largest change of a state element over the last eighth of the time, relative to its
        size; infinite if the lane has jumped in this time."""
        part = self.kept[-1] if self.kept else None
        since = t1 - STILL_SHARE * (t1 - self.t0)
        if not isinstance(part, Arc) or part.t0 > since:
            return np.inf
        states = np.array([_at(part, t) for t in np.linspace(since, t1, 9).tolist()])
        far = np.abs(states - part.last).max(axis=0)
        return float((far / np.where(self.size > 0, self.size, 1.0)).max())

    def _keep_timed(self, name: str, k: int, x: StateVector, mode: str) -> None:
        """Keep the state at the ``k``-th requested time, of the section or to be saved."""
        if name == "points":
            k, t = k % self.asked.keep, float(self.due[name][k])
            self.views["t"][k] = t
        self._keep_state(name, k, x, mode)

    def _keep_state(self, name: str, place: int, x: StateVector, mode: str) -> None:
        """Keep a state; for a point on a section, also the mode after it."""
        self.views[name][place] = x
        if name == "points" and "modes" in self.views:
            self.views["modes"][place] = number_of(self.scene, mode)

    def _measure_kept(self, then: Part | Flights | None = None) -> None:
        """Measure the part that is kept; ``then`` is the part after it."""
        if self.varied:
            self.whole.kept += self.kept
            self.whole.own |= {len(self.whole.kept) - 1: row for row in self.own.values()}
        for part in self.kept:
            if self.sized:
                self._measure_sizes(part)
            if isinstance(part, Flights):
                constrained = np.array([name.endswith(")") for name in part.modes])
                self.stuck += float(part.lengths[constrained].sum())
            elif isinstance(part, Arc) and part.constrained:
                self.stuck += part.length
            for name, times in self.due.items():
                for k in range(*np.searchsorted(times, (part.t0, part.t1)).tolist()):
                    t = float(times[k])
                    self._keep_timed(name, k, _at(part, t), _mode_at(part, t))
            if isinstance(self.section, EdgeSection):
                self._jumps(part, self.section.name, then)
            elif self.sides is not None:
                self._crossings(part, self.sides)

    def _measure_sizes(self, part: Part | Flights) -> None:
        """Update bounds on the sizes of the states, and on their ranges in the second half."""
        for arc in _arcs(part):
            for segment in arc.segments:
                size = np.abs(segment.coefficients)
                self.size = np.maximum(self.size, size.sum(axis=0))
                if arc.t0 + segment.start >= self.middle:
                    around = size[1:].sum(axis=0)
                    self.low = np.minimum(self.low, segment.coefficients[0] - around)
                    self.high = np.maximum(self.high, segment.coefficients[0] + around)

    def _jumps(self, part: Part | Flights, edge: str, then: Part | Flights | None) -> None:
        """Keep the points of a section that are jumps of ``edge``; ``then`` is the next part."""
        row, behind = self.own.get(0), _first_mode(then) or part.mode
        if isinstance(part, Flights):
            modes = [*part.modes[1:].tolist(), behind]
            for k in np.flatnonzero(part.jumps.edge == edge).tolist():
                self._keep_point(float(part.jumps.t[k]), part.jumps.after[k], modes[k])
        elif isinstance(part, Arc) and row is not None and row.edge == edge:
            self._keep_point(row.t, row.after, behind)

    def _crossings(self, part: Part | Flights, sides: Sides) -> None:
        """Keep the points at which a part crosses a surface."""
        for arc in part.arcs if isinstance(part, Flights) else arcs_of(part):
            for tau in sides.crossings(arc):
                self._keep_point(arc.t0 + (arc.low + tau), arc.local(tau), arc.mode)

    def _keep_point(self, t: float, x: StateVector, mode: str) -> None:
        """Count a point on the section, and keep it if skip, every and keep say so."""
        skip, keep = self.asked.skip, self.asked.keep
        place, rest = divmod(self.met - (skip or 0), self.asked.every)
        self.met += 1
        place = place % keep if skip is None else place
        if rest == 0 and 0 <= place < keep:
            self.views["t"][place] = t
            self._keep_state("points", place, x, mode)


def _arcs(part: Part | Flights) -> Sequence[Arc]:
    """The arcs of a part; none for a sum of impacts."""
    return part.arcs if isinstance(part, Flights) else [part] if isinstance(part, Arc) else []


def _first_mode(part: Part | Flights | None) -> str | None:
    """The mode in which a part begins; None without a part."""
    return None if part is None else part.modes[0] if isinstance(part, Flights) else part.mode


def _mode_at(part: Part | Flights, t: float) -> str:
    """The mode of a part at a time."""
    return part.arc_at(t).mode if isinstance(part, Flights) else part.mode


def number_of(scene: Scene, mode: str) -> int:
    """A number for the mode of an arc, unique among all modes and sets of held contacts."""
    if mode in scene.modes:
        return scene.modes.index(mode)
    own, held = parted(mode)
    return len(scene.modes) + sum(1 << scene.modes.index(rest_name(own, (c,))) for c in held)


def _at(part: Part | Flights, t: float) -> np.ndarray:
    """The state of a part at a time."""
    arc = part if isinstance(part, Arc) else part.arc_at(t)
    return arc.local((t - arc.t0) - arc.low if t > arc.t0 else 0.0)
