"""``hy.basins``: to which attractor each start leads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.base import COUNT_IN_RUN, require_model, require_no_discrete
from ..ensembles import ensemble
from ..ensembles.measures import SAME_POINT, STILL_SHARE, number_of
from ..ensembles.runs import solver_for
from ..errors import OptionError
from ..lowering import scene_of
from ..simulation import simulate, whole
from ..trajectory.trajectory import Status
from .boundary import Dimension, dimension
from .grid import sweep
from .picture import drawn, region_figure
from .recurrence import NOWHERE, Nearness, Tails, grouped

if TYPE_CHECKING:
    import xarray

    from ..automaton.record import Record

#: Options of a sweep that an ensemble does not take; and of an ensemble that a run does not.
OF_GRID = ("executor", "store", "block", "progress", "measure")
OF_LANES = ("max_steps", "segments", "section", "crossing", "skip", "every", "keep", "save")

#: Points of an attractor that are looked for when it is found, as often as those of a lane.
MORE_POINTS = 10

#: A lane that met its section for the last time longer ago than so many times the longest of the
#: flights between its last points meets it no more.
LATE = 2.0


#: More than this share of the time is all of it, but for rounding.
ALWAYS = 1.0 - 1e-9


@attrs.frozen(eq=False)
class Attractor:
    """Where lanes of a map of basins end.

    Attributes
    ----------
    number : int
        Its number in the table.
    kind : "rest", "periodic" or "other"
        What :meth:`hybrid.Trajectory.settles` says of a run that leads there; ``"other"`` comes
        back to where it was and is neither: a chaotic attractor, say, or one of more than 16
        returns.
    reason : str
        A sentence with the evidence.
    period, jumps : float or None
        Of a periodic one; ``jumps`` is infinite where impacts accumulate in each period.
    stick : float
        The share of the time, in the second half of that run, at rest on contacts or sliding.
    mode, state : str, Record
        In which, and where, that run ends.
    start : dict
        The start, of those of the map, from which that run goes.
    share : float
        Of all lanes, those that end here.
    for_ever : bool
        Whether it is proved that nothing can end the rest.
    """

    number: int
    kind: str
    reason: str
    period: float | None
    jumps: float | None
    stick: float
    mode: str
    state: Record
    start: dict[str, Any]
    share: float
    for_ever: bool

    def __str__(self) -> str:
        return f"{self.number}: {self.what}: {self.share:.4g} of the starts"

    @property
    def what(self) -> str:
        """What it is, in a few words."""
        if self.kind == "rest":
            at = ", ".join(f"{name} = {_short(self.state[name])}" for name in self.state.keys())
            return f"rest in {self.mode}, {at}"
        if self.stick > ALWAYS:
            return f"{self.kind}, always in {self.mode}"
        sticks = f", at rest or sliding for {self.stick:.3g} of the time" if self.stick else ""
        if self.period is None or self.jumps is None:
            return self.kind + sticks
        counted = f"{self.jumps} jump{'s' * (self.jumps != 1)}"
        counted = "chattering" if self.jumps == float("inf") else counted
        return f"period {self.period:.9g}, {counted}{sticks}"


@attrs.frozen(eq=False, repr=False)
class Basins:
    """To which attractor each start of a map leads.

    Attributes
    ----------
    table : xarray.Dataset
        What :func:`hybrid.sweep` gives over the starts, and ``attractor``, the number of the one to
        which each leads; -1 where a lane has failed, or has found none in its time.
    attractors : list of Attractor
    names : tuple of str
        The states whose starts the map goes over.
    """

    table: xarray.Dataset
    attractors: list[Attractor]
    names: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{self.table.attrs['model']}: {self.labels.size} starts"]
        lines += [f"  {attractor}" for attractor in self.attractors]
        if self.none:
            lines.append(
                f"  none found, or failed: {self.none:.4g} of the starts (see status; else fly "
                "longer, keep more points, or give a section that orbits meet once a turn)"
            )
        return "\n".join(lines)

    __repr__ = __str__

    @property
    def labels(self) -> np.ndarray:
        """The number of the attractor, over the grid."""
        return np.asarray(self.table.attractor.values)

    @property
    def fractions(self) -> np.ndarray:
        """The share of the starts that leads to each attractor."""
        return np.array([attractor.share for attractor in self.attractors])

    @property
    def none(self) -> float:
        """The share of the starts that leads to none that was found."""
        return float(np.mean(self.labels == NOWHERE))

    def boundary(self) -> Dimension:
        """The dimension of the boundary between basins, with its standard error.

        Returns
        -------
        Dimension
            ``.value``, ``.error``, and ``.uncertainty``, the exponent by which the share of starts
            whose attractor is not certain falls with the uncertainty of the start.

        Raises
        ------
        OptionError
            If the starts are not evenly spaced, are too few, or all lead to one attractor.
        """
        for name, values in self.table.indexes.items():
            gaps = np.diff(values)
            if str(name).endswith("_start") and not np.allclose(gaps, gaps[:1], rtol=1e-6, atol=0):
                raise OptionError(f"boundary: the values of {name} are not evenly spaced")
        return dimension(self.labels, f"{self.table.attrs['model']}: boundary")

    def plot(self, path: Any = None) -> Any:
        """Draw the basins, over one state or two.

        Parameters
        ----------
        path : str or path, optional
            Also write the figure there; a page if it ends in .html.

        Returns
        -------
        The figure of matplotlib, or of plotly.

        Raises
        ------
        OptionError
            If the map goes over more than two states, or what draws is missing.
        """
        kinds = [f"{attractor.number}: {attractor.what}" for attractor in self.attractors]
        numbers = [*range(len(kinds)), NOWHERE] if self.none else [*range(len(kinds))]
        known = dict(zip(numbers, [*kinds, "none found, or failed"], strict=False))
        axes = [f"{name}_start" for name in self.names]
        title = f"{self.table.attrs['model']}: basins"
        return drawn(region_figure(self.table, "attractor", axes, known, title), path, "basins")


def basins(
    model: Any,
    over: Mapping[str, Any],
    start: Any = None,
    t: Any = None,
    *,
    section: Any,
    keep: int = 100,
    near: float = 0.01,
    **options: Any,
) -> Basins:
    """To which attractor each start leads: rest, or an orbit, whether it slides, chatters or not.

    Parameters
    ----------
    model, start, t, options
        As :func:`hybrid.sweep` takes them: ``executor``, ``store``, ``block``, ``progress`` too.
    over : dict
        Values at the start by the names of states.
    section : str, callable or float
        As :func:`hybrid.return_map` takes it: where returns are looked at. In a forced model the
        period of the forcing, which all lanes meet, at one phase; in others a surface, or a jump's
        name, that orbits meet once a turn. A lane that rests is known whatever it meets.
    keep : int
        How many points of each lane are looked at, the last ones. A chaotic attractor takes some
        hundreds.
    near : float
        Points are in one place within this share of what all of them span.

    Returns
    -------
    Basins
        ``.table``, ``.attractors``, ``.fractions``, ``.boundary()``, ``.plot(path)``.

    Raises
    ------
    OptionError
        As :func:`hybrid.sweep`; or if a parameter is among the names: attractors are compared at
        the same parameters, so each of its values takes a call of its own.

    Notes
    -----
    A lane has found an attractor where its last points lie beside those long before
    (:mod:`hybrid.maps.recurrence`, after Datseris and Wagemakers 2022), or where it has not moved
    in the last eighth of its time. From one start of each the model is run for twice as long: that
    run says what it is, and has the points that other lanes are compared with. A lane that has
    found none, or failed, has the number -1, and its ``status``. Attractors nearer to each other
    than ``near`` are one.

    Examples
    --------
    >>> found = hy.basins(DoubleWell(), {"x": x, "v": v}, t=(0.0, 200.0), section=2 * np.pi)
    >>> found.fractions, found.boundary()
    """
    require_model(model)
    require_no_discrete(model, "hy.basins", COUNT_IN_RUN)
    states = model.spec.names
    others = [name for name in over if name not in states] if isinstance(over, Mapping) else []
    if others:
        raise OptionError(
            f"{model.spec.model}: over {others[0]!r}: starts of {', '.join(states)}; attractors "
            "are of a model, so call hy.basins for each value of a parameter"
        )
    if not 0 < near < 1:
        raise OptionError(f"near={near!r}: a share, between 0 and 1")
    asked = {"section": section, "skip": None, "keep": keep}
    table = sweep(model, over, start, t, **asked, **options)
    flown = _Flown(model, table, tuple(map(str, over)), start, t, options | asked)
    labels, firsts = grouped(flown.tails(), Nearness(near, SAME_POINT), flown.located)
    told = {"long_name": "number of the attractor"}
    table = table.assign(attractor=(flown.dims, labels.reshape(flown.shape), told))
    shares = [float(np.mean(labels == number)) for number in range(len(firsts))]
    numbered = zip(range(len(firsts)), firsts, shares, strict=True)
    return Basins(table, [flown.attractor(*each) for each in numbered], flown.names)


def _short(value: Any) -> str:
    """A state in a few digits; what is next to nothing is 0."""
    return np.array2string(np.round(value, 6) + 0.0, precision=4)


@attrs.frozen(eq=False)
class _Flown:
    """The lanes of a map, and what is flown of them again."""

    model: Any
    table: xarray.Dataset
    names: tuple[str, ...]
    start: Any
    t: Any
    options: Mapping[str, Any]

    @property
    def dims(self) -> tuple[str, ...]:
        return tuple(f"{name}_start" for name in self.names)

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(self.table.sizes[name] for name in self.dims)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the lanes."""
        t0, t1 = self.t(self.model) if callable(self.t) else self.t
        return float(t0), float(t1)

    def column(self, name: str) -> np.ndarray:
        """A column of the table, the lanes as first axis."""
        values = self.table[name].values
        return values.reshape(-1, *values.shape[len(self.shape) :])

    def states(self, what: str, axes: int) -> np.ndarray:
        """The states as vectors, from columns that have so many axes before those of a state."""
        columns = [self.column(f"{name}{what}") for name in self.model.spec.names]
        return np.concatenate([c.reshape(*c.shape[:axes], -1) for c in columns], axis=axes)

    def tails(self) -> Tails:
        """The ends of the lanes."""
        (t0, t1), times = self.span, self.column("t_section")
        points, modes = self.states("_section", 2), self.column("mode_section")
        newest = np.argsort(np.isfinite(times), axis=1, kind="stable")  # those that are NaN first
        points = np.take_along_axis(points, newest[..., None], axis=1)
        modes, times = (np.take_along_axis(each, newest, axis=1) for each in (modes, times))
        gaps = np.nan_to_num(np.diff(times, axis=1)).max(axis=1, initial=0.0)
        since = t1 - np.where(np.isfinite(times[:, -1]), times[:, -1], t0)
        ceased = since > np.maximum(LATE * gaps, STILL_SHARE * (t1 - t0))
        held = np.array([str(mode).endswith(")") for mode in self.column("mode")])
        done = self.column("status") == Status.REACHED_END.name.lower()
        rests = done & ((self.column("moves") <= SAME_POINT) | (ceased & held))
        scene, ends = scene_of(self.model), (self.states("", 1), self.column("mode").tolist())
        numbers = np.array([number_of(scene, mode) for mode in ends[1]])
        sizes = self.states("_size", 1), self.states("_range", 1)
        return Tails(points, modes, ends[0], numbers, rests, done & ~rests & ~ceased, *sizes)

    def begun(self, lane: int) -> dict[str, Any]:
        """Where a lane starts."""
        start = self.start(self.model) if callable(self.start) else dict(self.start or {})
        place = np.unravel_index(lane, self.shape)
        rows = zip(self.names, self.dims, place, strict=True)
        return start | {name: float(self.table[dim].values[k]) for name, dim, k in rows}

    @property
    def longer(self) -> tuple[float, float]:
        """Twice the time of the lanes."""
        t0, t1 = self.span
        return t0, 2.0 * t1 - t0

    def located(self, lane: int) -> tuple[np.ndarray, np.ndarray]:
        """Points that a lane meets when it goes on for as long as it was flown, and the number of
        the mode behind each."""
        asked = {n: v for n, v in self.options.items() if n not in OF_GRID}
        asked["keep"] = MORE_POINTS * asked["keep"]
        own = ensemble(self.model, self.begun(lane), self.longer, **asked)
        late = own.t_section.values[0] > self.span[1]
        columns = [own[f"{name}_section"].values[0] for name in self.model.spec.names]
        points = np.concatenate([c.reshape(len(c), -1) for c in columns], axis=1)
        return points[late], own.mode_section.values[0][late]

    def attractor(self, number: int, lane: int, share: float) -> Attractor:
        """What the run from a start says of where it leads."""
        asked = {n: v for n, v in self.options.items() if n not in OF_GRID + OF_LANES}
        scene = scene_of(self.model)
        asked["solver"] = solver_for(scene, asked.get("solver"), asked.get("method"))
        start, (t0, t1) = self.begun(lane), self.longer
        run = whole(simulate(self.model, start, (t0, t1), **asked))
        found, middle = run.settles(), self.span[1]
        sticks = [p.t1 - max(p.t0, middle) for p in run.parts if p.constrained and p.t1 > middle]
        return Attractor(
            number=number,
            kind="other" if found.kind == "none" else found.kind,
            reason=found.reason,
            period=found.period,
            jumps=found.jumps,
            stick=sum(sticks) / (t1 - middle),
            mode=run.mode,
            state=run.final,
            start=start,
            share=share,
            for_ever=found.for_ever,
        )
