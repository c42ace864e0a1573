"""Figures of a run: states over time, phase portrait, gaps between jumps, approach to a limit."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..automaton.outputs import require_outputs
from ..errors import OptionError
from ..lowering import Kind
from ..trajectory.accumulation import Accumulation
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Solution, counted
from .figure import Curve, Figure, Panel

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Most and fewest points per arc, and most points per run; the arcs of a long run get fewer.
ARC_POINTS, LEAST_POINTS, ALL_POINTS = 200, 17, 20000

#: Smallest remaining time to an accumulation that is shown, relative to the whole; closer, doubles
#: show nothing.
NEAREST_TO_LIMIT = 1e-12

#: Most jumps in a phase portrait. In a run with more, flights too short to be seen are omitted,
#: except before the first accumulation, where one may zoom in.
FALLS = 2000

#: The panels of a run, and most panels per column.
PANELS, MOST_ROWS = ("time", "phase", "gaps", "modes"), 6


def figure(
    run: Solution, chosen: Sequence[str] | None = None, shown: Sequence[str] | None = None
) -> Figure:
    """A run as one figure.

    ``time``: each chosen state and output over time (by default all states), with impacts marked,
    accumulations as lines, resting arcs thicker, and the obstacle if a gap is the distance of one
    coordinate to it. ``modes``: below these, the mode over time, if there are several. Beside them,
    ``phase``: the first contact's position and velocity, or the first two chosen names; and
    ``gaps``: the times between jumps by number on a logarithmic axis, where a chattering series is
    a straight line. By default all panels are shown, or only ``time`` if names are chosen. Without
    dense output, dots show the recorded states: the ends of arcs, and the requested times.

    Raises
    ------
    OptionError
        If there is no such state, output or panel.
    """
    kinds = _kinds(run, chosen, shown)
    drawn = _sampled(run, ALL_POINTS)
    names = run.spec.element_names if chosen is None else chosen
    wanted = "time" in kinds or ("phase" in kinds and chosen is not None)
    columns = [each for name in names for each in _columns(run, name, drawn)] if wanted else []
    over_time = [_over_time(run, column) for column in columns] if "time" in kinds else []
    strip = [panel for panel in [modes_panel(run)] if "modes" in kinds and panel.curves]
    parts = -(-len(over_time) // MOST_ROWS) or 1
    rows = -(-len(over_time) // parts)
    times = [(*over_time[k * rows : (k + 1) * rows], *strip) for k in range(parts)]
    pair = columns[:2] if chosen is not None else _pair(run, drawn)
    aside = [_phase(run, *pair)] if "phase" in kinds and len(pair) == 2 else []
    aside += [p for p in [gaps_panel(run)] if "gaps" in kinds and p.curves[0].x.size]
    found = tuple(column for column in (*times, tuple(aside)) if column)
    return Figure(
        name="run",
        title=title(run),
        columns=found,
        widths=tuple(1.7 if column[0].x == "t" else 1.0 for column in found),
        zooms=zooms(run),
    )


def _kinds(
    run: Solution, chosen: Sequence[str] | None, shown: Sequence[str] | None
) -> Sequence[str]:
    """The requested kinds of panels.

    Raises
    ------
    OptionError
        If one is unknown.
    """
    kinds = PANELS if shown is None and chosen is None else shown or ("time",)
    kinds = (kinds,) if isinstance(kinds, str) else kinds
    unknown = [kind for kind in kinds if kind not in PANELS]
    if unknown:
        there = ", ".join(PANELS)
        raise OptionError(f"{run.spec.model}: panels: {unknown[0]!r}; there are: {there}")
    return kinds


def states_panel(
    run: Solution, name: str, *, look: str = "line", points: int = ALL_POINTS
) -> Panel:
    """One state element over time, with impacts, rests, limits and the obstacle."""
    index = run.spec.element_names.index(name)
    return _over_time(run, _element(run, index, _sampled(run, points)), look)


def path(
    run: Solution, index: int, *, look: str = "line", name: str = "", points: int = ALL_POINTS
) -> list[Curve]:
    """One element over time: a curve for the flights, and a thicker one for the rests."""
    return _path(run, _along_element(_sampled(run, points), index), look, name)


def phase_panel(run: Solution, *, points: int = ALL_POINTS) -> Panel:
    """Velocity over position of the first contact, or else the first two elements."""
    return _phase(run, *_pair(run, _sampled(run, points)))


def modes_panel(run: Solution) -> Panel:
    """The mode over time, a row per mode in order of appearance; no curves if only one."""
    names = list(dict.fromkeys(part.mode for part in run.parts))[::-1]
    curves = []
    for row, name in enumerate(names if len(names) > 1 else ()):
        spans = [(part.t0, part.t1) for part in run.parts if part.mode == name]
        x, y = _joined([(np.array(span), np.full(2, float(row))) for span in spans])
        curves.append(Curve(x=x, y=y, look="held" if name.endswith(")") else "mode"))
    limits = [np.array([point.t, point.t]) for point in run.zeno]
    high = np.array([-0.5, len(names) - 0.5])
    curves += [Curve(x=t, y=high, look="limit", name="accumulation") for t in limits if curves]
    return Panel(curves=curves, ticks=names, share=0.2 + 0.14 * len(names))


def gaps_panel(run: Solution) -> Panel:
    """Time between jumps, by number; on a logarithmic axis if they differ by a factor of ten."""
    pairs = _gaps(run)
    title = "time between jumps" if pairs else "fewer than two jumps"
    notes = [f"{gap:.12g} after jump {number}" for number, gap in pairs]
    x, y = np.array(pairs).reshape(-1, 2).T
    curve = Curve(x=x, y=y, look="series", notes=notes)
    log = "y" if len(y) and y.max() > 10.0 * y.min() else ""
    return Panel(curves=[curve], x="jump", y="time to the next", log=log, title=title)


def _gaps(run: Solution) -> list[tuple[int, float]]:
    """Number of each jump and time to the next, at full resolution except in long runs."""
    if len(run.jumps) > FALLS:
        return [(j, gap) for j, gap in enumerate(run.jumps.gaps.tolist(), 1) if gap > 0.0]
    return [
        (arc.j, arc.length)
        for arc, after in pairwise(run.arcs)
        if arc.j > 0 and after.j > arc.j and arc.length > 0.0
    ]


def approach_panel(run: Solution, name: str, place: int = 0, *, points: int = ALL_POINTS) -> Panel:
    """An element that vanishes in the limit, over the remaining time on a logarithmic axis.

    The impacts, which cluster in time, are evenly spaced on it.
    """
    point, index = run.zeno[place], run.spec.element_names.index(name)
    since = run.zeno[place - 1].t if place else run.t0
    arcs = [a for a in run.arcs if since <= a.t0 and a.t1 <= point.t and not a.constrained]
    ends = np.cumsum([a.length for a in arcs][::-1])[::-1]
    count, parts = _count(len(arcs), points), []
    for arc, end in zip(arcs, ends, strict=True):
        grid = np.linspace(0.0, 1.0, count) * arc.length
        left = np.where(end - grid > NEAREST_TO_LIMIT * ends[0], end - grid, np.nan)
        parts.append((left, arc.local(grid)[:, index] / left))
    x, y = _joined(parts)
    label = f"{name} / (t_inf - t)"
    return Panel(curves=[Curve(x=x, y=y)], x="t_inf - t", y=label, log="x", reverse=True)


def zooms(run: Solution, place: int = 0) -> list[tuple[str, tuple[float, float]]]:
    """Zoom ranges: the whole run, then closer and closer to an accumulation."""
    whole = [("whole run", (run.t0, run.t1))]
    if not run.zeno:
        return whole
    t, since = run.zeno[place].t, run.zeno[place - 1].t if place else run.t0
    near = [10.0**-k * (t - since) for k in range(1, 8) if 10.0**-k * (t - since) > 1e-7 * abs(t)]
    return whole + [(f"last {_power(d)}", (t - d, t + 0.1 * d)) for d in near]


def title(run: Solution) -> str:
    """How many jumps, and where they accumulate; with a bound, if it has been asked for."""
    if not run.zeno:
        return f"{run.spec.model}: {counted(len(run.jumps), 'jump')}"
    more = f" (first of {len(run.zeno)})" if len(run.zeno) > 1 else ""
    return f"{run.spec.model}: jumps accumulate at {_time(run.zeno[0])}{more}"


def _time(point: Accumulation) -> str:
    """With as many digits as a picture has room for, or as are known."""
    return f"t = {point.t:.15g} ± {point.t_error:.0e}" if point.measured else f"t = {point.t:.6g}"


# ---------------------------------------------------------------------------------------


def _power(value: float) -> str:
    return f"{value / 10 ** np.floor(log10(value)):.2g}e{int(np.floor(log10(value)))}"


def _count(arcs: int, points: int) -> int:
    return int(np.clip(points // max(arcs, 1), LEAST_POINTS, ARC_POINTS))


class _Drawn(NamedTuple):
    """Times and states to draw: along each flight and each rest; and single states where no dense
    output was kept."""

    flights: list[tuple[np.ndarray, np.ndarray]]
    rests: list[tuple[np.ndarray, np.ndarray]]
    dots: list[tuple[np.ndarray, np.ndarray]]


def _sampled(run: Solution, points: int) -> _Drawn:
    """The whole run, with about ``points`` points."""
    seen = _seen(run)
    dense = [arc for arc in seen if arc.segments]
    flights = [arc for arc in dense if not arc.constrained]
    rests = [arc for arc in dense if arc.constrained]
    return _Drawn(_along(flights, points), _along(rests, points), _kept(run, seen))


def _seen(run: Solution) -> list[Arc]:
    """The arcs to draw; in a long run, of tails after the first, only visible ones."""
    least, arcs = (run.t1 - run.t0) / ALL_POINTS if len(run.jumps) > FALLS else 0.0, []
    for part in run.parts:
        if isinstance(part, Arc):
            arcs.append(part)
            continue
        first = part.t1 == run.zeno[0].t
        lengths = np.append(np.diff(part.tail.times), 0.0)
        shown = len(lengths) if first else np.count_nonzero(lengths >= least)
        arcs += [part.arc(n) for n in range(shown)]
    return arcs


def _kept(run: Solution, arcs: Sequence[Arc]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The ends of arcs without dense output, and the requested states."""
    bare = [arc for arc in arcs if not arc.segments and arc.length > 0.0]
    kept = [(np.array([arc.t0, arc.t1]), np.array([arc.first, arc.last])) for arc in bare]
    return kept if run.samples is None else [*kept, (run.options["times"], run.samples)]


def _along(arcs: Sequence[Arc], points: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times and states along each arc; long arcs get more points."""
    sizes = np.sqrt([arc.length for arc in arcs])
    counts = np.clip(points * sizes / max(np.sum(sizes), 1e-300), LEAST_POINTS, ARC_POINTS).astype(
        int
    )
    sampled = []
    for arc, count in zip(arcs, counts.tolist(), strict=True):
        grid = np.linspace(0.0, 1.0, count) * arc.length
        sampled.append((arc.t0 + (arc.low + grid), arc.local(grid)))
    return sampled


class _Column(NamedTuple):
    """A quantity over time: its name and axis label, its values along what is drawn, before and
    after jumps and at limits, and its index in the state (None for an output)."""

    name: str
    axis: str
    drawn: _Drawn
    before: Numbers
    after: Numbers
    limits: Numbers
    place: int | None = None


def _columns(run: Solution, name: str, drawn: _Drawn) -> list[_Column]:
    """The columns of a state or an output, one per element, or that of one element."""
    elements = run.spec.element_names
    if name in elements:
        return [_element(run, elements.index(name), drawn)]
    whole, outputs = name.partition("[")[0], {output.name for output in run.spec.outputs}
    own = _columns(run, whole, drawn) if whole in outputs - {name} else []
    if found := [column for column in own if column.name == name]:
        return found
    if not require_outputs(run.spec, [name]):
        places = [k for k, each in enumerate(elements) if each.startswith(f"{name}[")]
        return [_element(run, k, drawn) for k in places]
    unit = run.spec.output(name).unit
    parts = (*drawn.flights, *drawn.rests, *drawn.dots)
    t, x = (np.concatenate(column) for column in zip(*parts, strict=True))
    values = run.observed(t, x)[name]
    ends = np.cumsum([len(times) for times, _ in parts])
    rows = np.split(_rows(values), ends[:-1])
    given = iter(zip((times for times, _ in parts), rows, strict=True))
    seen = _Drawn(*([next(given) for _ in part] for part in drawn))
    limits = np.array([point.t for point in run.zeno]), _limit_states(run)
    sides = run.jumps.before[name], run.jumps.after[name], run.observed(*limits)[name]
    columns = []
    for place, index in enumerate(np.ndindex(values.shape[1:])):
        label = name + (str(list(index)) if index else "")
        before, after, at = (_rows(side)[:, place] for side in sides)
        over_time = _along_element(seen, place)
        columns.append(_Column(label, _axis(label, unit), over_time, before, after, at))
    return columns


def _element(run: Solution, index: int, drawn: _Drawn) -> _Column:
    """An element of the state as a column."""
    name, axis = run.spec.element_names[index], _axis(*_named(run, index))
    before, after = (side[:, index] for side in (run.jumps.table.before, run.jumps.table.after))
    limits = _limit_states(run)[:, index]
    return _Column(name, axis, _along_element(drawn, index), before, after, limits, index)


def _along_element(drawn: _Drawn, index: int) -> _Drawn:
    return _Drawn(*([(t, x[:, index]) for t, x in part] for part in drawn))


def _limit_states(run: Solution) -> Matrix:
    states = [run.spec.vector(point.state) for point in run.zeno]
    return np.array(states).reshape(-1, run.spec.dimension)


def _over_time(run: Solution, column: _Column, look: str = "line") -> Panel:
    curves = [] if column.place is None else _obstacle(run, column.place)
    curves += _path(run, column.drawn, look)
    curves += _impacts(run, column.name, column.before, column.after)
    return Panel(curves=[*curves, *_limits(run, curves)], y=column.axis)


def _path(run: Solution, drawn: _Drawn, look: str, name: str = "") -> list[Curve]:
    still = look if look not in ("line", "other") else "rest" if look == "line" else "other rest"
    flying, resting, kept = map(_joined, drawn)
    curves = [Curve(x=flying[0], y=flying[1], look=look, name=name)] if flying[0].size else []
    if resting[0].size:
        curves.append(Curve(x=resting[0], y=resting[1], look=still, name=_staying(run)))
    return [*curves, Curve(x=kept[0], y=kept[1], look="mark")] if kept[0].size else curves


def _pair(run: Solution, drawn: _Drawn) -> list[_Column]:
    """Position and velocity of the first contact, else the first two elements if any."""
    count = len(run.spec.element_names)
    pair = (run.pairs or [(0, 1)])[0]
    return [_element(run, index, drawn) for index in pair] if count > 1 else []


def _phase(run: Solution, one: _Column, other: _Column) -> Panel:
    curves = []
    for look, a, b in zip(("line", "rest", "mark"), one.drawn, other.drawn, strict=True):
        x, y = _joined([(u, v) for (_, u), (_, v) in zip(a, b, strict=True)])
        curves.append(Curve(x=x, y=y, look=look))
    if 0 < len(run.jumps) < FALLS:
        sides = (np.array(pair) for pair in ((one.before, one.after), (other.before, other.after)))
        x, y = _joined(list(zip(*(side.T for side in sides), strict=True)))
        curves.append(Curve(x=x, y=y, look="fall"))
    curves += [
        Curve(x=[x], y=[y], look="point") for x, y in zip(one.limits, other.limits, strict=True)
    ]
    return Panel(curves=curves, x=one.axis, y=other.axis, title="phase portrait")


def _joined(parts: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a curve joined by NaN."""
    gap = np.full(1, np.nan)
    x, y = ([np.concatenate([part[k], gap]) for part in parts] for k in (0, 1))
    empty = [np.empty(0)]
    return np.concatenate(x or empty)[:-1], np.concatenate(y or empty)[:-1]


def _staying(run: Solution) -> str:
    return "at rest" if any(part.held for part in run.parts) else "sliding"


def _impacts(run: Solution, name: str, before: Numbers, after: Numbers) -> list[Curve]:
    """Jumps, at the values after them; releases are omitted, as nothing jumps there."""
    shown = np.array([not str(edge).endswith(".release") for edge in run.jumps.edge], dtype=bool)
    if not np.any(shown):
        return []
    t, before, after = (a[shown] for a in (run.jumps.t, before, after))
    notes = [
        f"jump {number} at t = {when:.15g}<br>{name}: {b:.12g} → {a:.12g}"
        for number, when, b, a in zip(np.flatnonzero(shown) + 1, t, before, after, strict=True)
    ]
    return [Curve(x=t, y=after, look="impact", name="jump", notes=notes)]


def _limits(run: Solution, curves: Sequence[Curve]) -> list[Curve]:
    """Accumulations as vertical lines over the range of the curves."""
    values = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in curves])
    ends = [values.min(), values.max()] if values.size else [0.0, 1.0]
    return [
        Curve(
            x=[point.t, point.t],
            y=ends,
            look="limit",
            name="accumulation",
            notes=[f"accumulation at {_time(point)}"] * 2,
        )
        for point in run.zeno
    ]


def _rows(column: Any) -> Matrix:
    """A column of arrays as rows of numbers."""
    values = np.asarray(column, dtype=float)
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def _obstacle(run: Solution, index: int) -> list[Curve]:
    """The obstacle ``x - gap(t, x)``, if a gap has slope 1 or -1 in this coordinate alone."""
    times = np.linspace(run.t0, run.t1, 600)
    state = run.spec.vector(run.final)
    curves = []
    for edge, guard in run.surfaces.items():
        if guard.uses != (index,) or guard.kind is not Kind.CONTACT:
            continue
        moved, x = state.copy(), state.tolist()
        moved[index] += 1.0
        slope = guard.value(run.t1, moved.tolist()) - guard.value(run.t1, x)
        scenes = run.hindsight.scene.through_time(times.tolist())
        there = zip(times.tolist(), scenes, strict=True)
        values = np.array([scene.guards[edge].value(t, x) for t, scene in there])
        if abs(abs(slope) - 1.0) < 1e-12:
            place = state[index] - slope * values
            curves.append(Curve(x=times, y=place, look="surface", name="obstacle"))
    return curves


def _named(run: Solution, index: int) -> tuple[str, str]:
    """The name and the unit of a state element."""
    owners = [state for state in run.spec.states if state.offset <= index]
    return run.spec.element_names[index], owners[-1].unit


def _axis(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
