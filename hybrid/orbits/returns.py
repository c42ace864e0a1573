"""``hy.return_map``: the map from a state to the state at which its run next meets a section."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.base import require_model
from ..automaton.markers import RISING, TERMINATE, Crossing
from ..automaton.record import Record
from ..errors import OptionError, OrbitError
from ..lowering import scene_of
from ..lowering.scene import parted
from ..result import Trajectory
from ..run.options import require_count, require_taken, start_of, time_of
from ..run.sections import EdgeSection, Period, Return, Section, Surface, section_of
from ..simulation import simulate, whole
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Status
from ..variation.carried import WINDOW_SPACINGS
from .cut import behind, cut

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: Length of the first run in which a return is sought, relative to ``t_max``, and the factor by
#: which the next ones are longer. The time scale of a model is unknown; all these runs together are
#: only a few times longer than needed.
FIRST_WINDOW, WINDOW_GROWTH = 4.0**-20, 4.0

#: Length of the first run, relative to the last return time, if there was one.
MARGIN = 1.25


@attrs.frozen(eq=False)
class Point:
    """A point of a return map: time, state, mode, and the history of a model with delays; for a
    return, the run that ended there."""

    t: float
    state: Any
    mode: str | None
    history: Any = None
    run: Trajectory | None = None


class Iterates(Sequence[Record]):
    """Points of a return map, beginning with the start: a sequence of records.

    Attributes
    ----------
    t : array, shape (n + 1,)
        Times.
    states : array, shape (n + 1, dimension)
    modes : list of str
    """

    def __init__(self, spec: Any, points: Sequence[Point]) -> None:
        self._spec = spec
        self.t = np.array([point.t for point in points])
        self.states = np.array([point.state for point in points])
        self.modes = [point.mode for point in points]

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: Any) -> Any:
        return self._spec.record(self.states[index])

    def __getattr__(self, name: str) -> Any:
        """A coordinate of all points: ``iterates.x``."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._spec.record(self.states), name)


def with_tolerances(options: dict[str, Any], rtol: float, atol: float) -> dict[str, Any]:
    """Options of a run, with these tolerances as defaults."""
    given = {name: value for name, value in options.items() if value is not None}
    return {"rtol": rtol, "atol": atol, **given}


class ReturnMap:
    """The map from a state to the next return of its run to a section; see :func:`return_map`.

    ``P(state)`` is the state at the next return.
    """

    def __init__(
        self,
        model: Any,
        section: Any,
        mode: str | None,
        t_max: float,
        crossing: Crossing,
        options: dict[str, Any],
    ) -> None:
        self.model, self.mode, self.t_max = model, mode, t_max
        self.options = with_tolerances(options, 1e-11, 1e-12)
        self.scene = scene_of(model, by="hy.return_map")
        self.section: Section = section_of(model, self.scene, section, crossing)
        if mode is None and isinstance(self.section, EdgeSection):
            self.mode = _mode_after(self.scene.spec, self.section.name)
        self._took: float | None = None

    def __call__(self, state: Any, t: float = 0.0) -> Record:
        """The state at the next return of the run that starts from ``state`` at time ``t``.

        A model with delays starts with the ``history=`` of the map.
        """
        return self.run(state, t).final

    def time(self, state: Any, t: float = 0.0) -> float:
        """The time that the run from ``state`` takes to its next return."""
        run = self.run(state, t)
        return run.t1 - run.t0

    def run(self, state: Any, t: float = 0.0, history: Any = None) -> Trajectory:
        """The run from a state to its next return, where it ends.

        ``history`` replaces that of the map, for a model with delays.

        Raises
        ------
        OrbitError
            If the run does not return within ``t_max``.
        """
        return self._from(self._point(state, t, history))

    def _point(self, state: Any, t: float, history: Any = None) -> Point:
        given = self.options.get("history") if history is None else history
        return Point(time_of("t", t), self._vector(state), self.mode, given)

    def iterate(self, state: Any, n: int, t: float = 0.0) -> Iterates:
        """``n`` successive returns from a state at time ``t``.

        Returns
        -------
        Iterates
            ``n + 1`` states, beginning with the start, and their times ``.t``; ``.x`` is the array
            of the coordinate ``x``.
        """
        require_count("n", n, 0)
        points = [self._point(state, t)]
        points += self._points(points[0], n)
        return Iterates(self.scene.spec, points)

    def _points(self, point: Point, n: int) -> Iterator[Point]:
        first = point.t
        for made in range(n):
            run = self._from(point, self._due(first, made + 1))
            if made:
                self._require_flown(run)
            point = self._returning(run)
            yield point

    def _due(self, t: float, turns: int) -> float | None:
        """The time a number of periods after ``t``, as a product, which is that of a clock of this
        period to the last bit; None if the section is no period."""
        return t + turns * self.section.period if isinstance(self.section, Period) else None

    def _returning(self, run: Trajectory) -> Point:
        """The point at the end of a run. The next run continues this one: it must know what fires
        at the same instant still, and what has fired."""
        state = run.parts[-1].last
        if isinstance(self.section, EdgeSection) and _ends(self.scene.spec, self.section.name):
            return Point(run.t1, state, self.mode)
        run.hindsight.forget(run.t1)
        return Point(run.t1, state, run.mode, run=run)

    def _require_flown(self, run: Trajectory) -> None:
        """Refuse to go on from an impact that leaves a speed which drowns in the rounding of the
        state: the run from there rests, and passes over the impacts that follow."""
        name, first = str(getattr(self.section, "name", "")), run.parts[0]
        if not isinstance(first, Arc) or name not in parted(first.mode)[1]:
            return
        if self.scene.contact(name).law(run.t0, first.first.tolist(), -0.0) > 0.0:
            raise OrbitError(
                f"{run.spec.model}: the impacts of {name!r} accumulate, and about t = {run.t0:.9g} "
                f"the state no longer tells them from rest; ask for fewer returns, or for "
                f"those to '{name}.release'"
            )

    def _vector(self, state: Any) -> StateVector:
        if isinstance(state, np.ndarray) and state.shape == (self.scene.spec.dimension,):
            return state
        return start_of(self.scene.spec, state)

    def _from(self, point: Point, due: float | None = None) -> Trajectory:
        start = self.scene.spec.record(self._vector(point.state))
        if isinstance(self.section, Period):
            until = point.t + self.section.period if due is None else due
            return self._returned(self._simulate(start, point, until), self.section.period)
        run, (found,) = self._flown(start, point, 1)
        if point.run is None and isinstance(self.section, EdgeSection):
            event = behind(run, self.section.name)
            if event is not None:
                point = attrs.evolve(point, run=event)
                run, (found,) = self._flown(start, point, 1)
        run = self._land(cut(run, found), start, point)
        self._took = run.t1 - run.t0
        return run

    def _flown(self, start: Any, point: Point, count: int) -> tuple[Trajectory, list[Return]]:
        """A run that returns ``count`` times, and these returns; runs of growing length are
        tried."""
        assert not isinstance(self.section, Period)
        window = MARGIN * self._took if self._took else FIRST_WINDOW * self.t_max
        while True:
            window = min(max(window, WINDOW_SPACINGS * float(np.spacing(abs(point.t)))), self.t_max)
            run = self._simulate(start, point, point.t + window)
            found = list(islice(self.section.returns(run), count))
            if len(found) == count:
                return run, found
            if window == self.t_max or run.status is not Status.REACHED_END:
                self._returned(run, None)
            window *= WINDOW_GROWTH

    def lap(self, state: Any, t: float = 0.0) -> tuple[Trajectory, float]:
        """A run from a state to its second return, and the time between its first two returns.

        Both returns are then crossings, even if the state is on the section.
        """
        point = self._point(state, t)
        run, (first, second) = self._flown(self.scene.spec.record(point.state), point, 2)
        begun = cut(run, first).t1
        run = cut(run, second)
        return run, run.t1 - begun

    def _simulate(self, start: Any, point: Point, until: float) -> Trajectory:
        times = (point.t, until)
        if point.run is not None:
            options = {**self.options, "history": None}
            return whole(simulate(self.model, point.run, times, **options))
        options = {**self.options, "history": point.history}
        return whole(simulate(self.model, start, times, mode=point.mode, **options))

    def _land(self, run: Trajectory, start: Any, point: Point) -> Trajectory:
        """Repeat a run so that it ends on a surface, which is more accurate than dense output; not
        one that ends with a jump."""
        last = run.parts[-1]
        if not isinstance(self.section, Surface) or (isinstance(last, Arc) and not last.length):
            return run
        return self._simulate(start, point, run.t1)

    def _returned(self, run: Trajectory, period: float | None) -> Trajectory:
        """The run, if it lasted a given period; else raise an error that says why it did not."""
        if period is not None and run.status is Status.REACHED_END:
            return run
        why = f"it is in {run.mode} at t = {run.t1:.9g}, {run.final}"
        if run.status is not Status.REACHED_END:
            why = str(run.status)
        raise OrbitError(
            f"{run.spec.model}: the run from t = {run.t0:.9g} does not return to {self.section} "
            f"within t_max = {self.t_max:g}: {why}; give another section, or a greater t_max"
        )


def return_map(
    model: Any,
    section: Any,
    *,
    mode: str | None = None,
    t_max: float = 1000.0,
    crossing: Crossing = RISING,
    **options: Any,
) -> ReturnMap:
    """The return map (Poincaré map) of a section: from a state to the state at the next return.

    Parameters
    ----------
    model : Automaton
        Autonomous, or periodic in time.
    section : str, callable or float
        The name of an edge, contact, switching or release: the states just after its jumps. A
        surface ``(self, t, s)``: the states where it crosses zero along an arc. A period,
        or a function ``(self)`` that returns it: the states one period apart (stroboscopic map).
    mode : str, optional
        The mode of the states; if omitted, the mode after the edge, or the model's initial mode.
    t_max : float
        The longest time that a return may take.
    crossing : RISING, FALLING or EITHER
        The direction in which a surface is crossed.
    options
        As for :func:`hybrid.simulate`; by default ``rtol=1e-11, atol=1e-12``.

    Returns
    -------
    ReturnMap
        ``P(state, t=0.0)`` is the state at the next return, ``P.time(state)`` the time until then,
        ``P.run(state)`` the run in between, ``P.iterate(state, n)`` the start and ``n`` returns
        with their times. With delays, ``iterate`` keeps the past of the earlier returns.

    Raises
    ------
    OptionError
        If the section, ``t_max`` or another option cannot be used.
    OrbitError
        When the map is used, if the run does not return within ``t_max`` or ends before.
    StartError
        When the map is used, if the state is incomplete.

    Examples
    --------
    >>> P = hy.return_map(Table(), "impact")
    >>> P.iterate({"x": 0.0, "v": 3.0}, 100).v
    """
    require_model(model)
    t_max = time_of("t_max", t_max, 0.0)
    require_taken(model.spec.model, options, simulate)
    options.setdefault("save", "dense")
    if options["save"] != "dense":
        raise OptionError(f"save={options['save']!r}: a return is found on dense output")
    return ReturnMap(model, section, mode, t_max, crossing, options)


def _ends(spec: Any, edge: str) -> bool:
    """Whether an edge ends the run."""
    return any(e.to == TERMINATE for e in spec.transitions if e.name == edge)


def _mode_after(spec: Any, edge: str) -> str | None:
    """The mode that follows an edge; None if there are several."""
    name, _, what = edge.rpartition(".")
    of = name if what == "release" else edge
    modes = {e.to for e in spec.transitions if e.name == of}
    modes |= {end.to for switching in spec.switchings for end in switching.ends if end.name == edge}
    modes -= {TERMINATE}
    return next(iter(modes)) if len(modes) == 1 else None
