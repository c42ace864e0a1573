"""Figures of a run: states over time, phase portrait, gaps between jumps, the way to a limit."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..automaton.outputs import require_outputs
from ..lowering import Kind
from ..trajectory.accumulation import Accumulation
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Solution
from .figure import Curve, Figure, Panel

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Points drawn of an arc, at most and at least, and of a run; arcs of a long run get fewer.
ARC_POINTS, LEAST_POINTS, ALL_POINTS = 200, 17, 20000

#: How near to an accumulation arcs are shown, of the time to it: beyond, doubles tell no more.
NEAREST_TO_LIMIT = 1e-12

#: Jumps that a phase portrait shows, at most; in a run of more, flights that are too short to be
#: seen are left out, but for those before the first accumulation, which one may zoom into.
FALLS = 2000


def figure(run: Solution, chosen: Sequence[str] | None = None) -> Figure:
    """A run on one figure; of the states and outputs chosen, one above the other, if some are.

    Left: each element of the state over time, impacts marked, accumulations as lines,
    resting arcs thicker, and the obstacle where a gap is the distance of one coordinate to
    it. Right: the phase portrait of the first contact's position and velocity, and the
    gaps between jumps against their number on a logarithmic axis, where a chattering
    series is a straight line. Where no dense output was kept there are dots at what was: the ends
    of arcs, and the times asked for.
    """
    names, drawn = run.spec.element_names, _sampled(run, ALL_POINTS)
    if chosen is not None:
        panels = tuple(panel for name in chosen for panel in _panels(run, name, drawn))
        return Figure(name="run", title=title(run), columns=(panels,), zooms=zooms(run))
    states = tuple(_states(run, name, drawn) for name in names)
    phase = (_phase(run, drawn),) if len(names) > 1 else ()
    aside = (*phase, *(panel for panel in [gaps_panel(run)] if panel.curves[0].x.size))
    columns = tuple(column for column in (states, aside) if column)
    return Figure(name="run", title=title(run), columns=columns, zooms=zooms(run))


def states_panel(
    run: Solution, name: str, *, look: str = "line", points: int = ALL_POINTS
) -> Panel:
    """One element of the state over time, with impacts, rests, limits and the obstacle."""
    return _states(run, name, _sampled(run, points), look)


def path(
    run: Solution, index: int, *, look: str = "line", name: str = "", points: int = ALL_POINTS
) -> list[Curve]:
    """One element over time: a curve for the flights, a thicker one for the rests."""
    return _path(run, index, _sampled(run, points), look, name)


def phase_panel(run: Solution, *, points: int = ALL_POINTS) -> Panel:
    """Velocity over position of the first contact (else the first two elements)."""
    return _phase(run, _sampled(run, points))


def gaps_panel(run: Solution) -> Panel:
    """Time between jumps, by number, on a logarithmic axis."""
    pairs = _gaps(run)
    title = "time between jumps" if pairs else "fewer than two jumps"
    notes = [f"{gap:.12g} after jump {number}" for number, gap in pairs]
    x, y = np.array(pairs).reshape(-1, 2).T
    curve = Curve(x=x, y=y, look="series", notes=notes)
    return Panel(curves=[curve], x="jump", y="", log="y", title=title)


def _gaps(run: Solution) -> list[tuple[int, float]]:
    """Jumps by number, and the time to the next: down to the last double, but in long runs."""
    if len(run.jumps) > FALLS:
        return [(j, gap) for j, gap in enumerate(run.jumps.gaps.tolist(), 1) if gap > 0.0]
    return [
        (arc.j, arc.length)
        for arc, after in pairwise(run.arcs)
        if arc.j > 0 and after.j > arc.j and arc.length > 0.0
    ]


def approach_panel(run: Solution, name: str, place: int = 0, *, points: int = ALL_POINTS) -> Panel:
    """An element that vanishes in the limit, over the time that is left, on a logarithmic axis.

    The impacts, which crowd together over time, are equally far apart on it.
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
    """The whole run, and nearer and nearer to an accumulation."""
    whole = [("whole run", (run.t0, run.t1))]
    if not run.zeno:
        return whole
    t, since = run.zeno[place].t, run.zeno[place - 1].t if place else run.t0
    near = [10.0**-k * (t - since) for k in range(1, 8) if 10.0**-k * (t - since) > 1e-7 * abs(t)]
    return whole + [(f"last {_power(d)}", (t - d, t + 0.1 * d)) for d in near]


def title(run: Solution) -> str:
    """How many jumps, and where they accumulate; with a bound, if it has been asked for."""
    head = f"{run.spec.model}: {len(run.jumps)} jumps listed"
    if not run.zeno:
        return head
    first = run.zeno[0]
    more = f" (first of {len(run.zeno)})" if len(run.zeno) > 1 else ""
    return f"{head}, accumulating at {_time(first)}{more}"


def _time(point: Accumulation) -> str:
    bound = f" ± {point.t_error:.0e}" if point.measured else ""
    return f"t = {point.t:.15g}{bound}"


# ---------------------------------------------------------------------------------------


def _power(value: float) -> str:
    return f"{value / 10 ** np.floor(log10(value)):.2g}e{int(np.floor(log10(value)))}"


def _count(arcs: int, points: int) -> int:
    return int(np.clip(points // max(arcs, 1), LEAST_POINTS, ARC_POINTS))


class _Drawn(NamedTuple):
    """What is drawn of a run: of each flight and each rest the times and the states; and single
    states, where nothing between them was kept."""

    flights: list[tuple[np.ndarray, np.ndarray]]
    rests: list[tuple[np.ndarray, np.ndarray]]
    dots: list[tuple[np.ndarray, np.ndarray]]


def _sampled(run: Solution, points: int) -> _Drawn:
    """The whole run, with about so many points."""
    seen = _seen(run)
    dense = [arc for arc in seen if arc.segments]
    flights = [arc for arc in dense if not arc.constrained]
    rests = [arc for arc in dense if arc.constrained]
    return _Drawn(_along(flights, points), _along(rests, points), _kept(run, seen))


def _seen(run: Solution) -> list[Arc]:
    """The arcs; in a long run those of the first tail, and of the others what can be seen."""
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
    """The ends of arcs without dense output, and the states that were asked for."""
    bare = [arc for arc in arcs if not arc.segments and arc.length > 0.0]
    kept = [(np.array([arc.t0, arc.t1]), np.array([arc.first, arc.last])) for arc in bare]
    return kept if run.samples is None else [*kept, (run.options["times"], run.samples)]


def _along(arcs: Sequence[Arc], points: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times and states of each arc; long arcs have more points."""
    sizes = np.sqrt([arc.length for arc in arcs])
    counts = np.clip(points * sizes / max(np.sum(sizes), 1e-300), LEAST_POINTS, ARC_POINTS).astype(
        int
    )
    sampled = []
    for arc, count in zip(arcs, counts.tolist(), strict=True):
        grid = np.linspace(0.0, 1.0, count) * arc.length
        sampled.append((arc.t0 + (arc.low + grid), arc.local(grid)))
    return sampled


def _states(run: Solution, name: str, drawn: _Drawn, look: str = "line") -> Panel:
    index = run.spec.element_names.index(name)
    curves = [*_obstacle(run, index), *_path(run, index, drawn, look)]
    sides = (_elements(side)[:, index] for side in (run.jumps.before, run.jumps.after))
    curves += [*_impacts(run, name, *sides), *_limits(run, curves)]
    unit = _unit(run, index)
    return Panel(curves=curves, y=f"{name} [{unit}]" if unit else name)


def _panels(run: Solution, name: str, drawn: _Drawn) -> list[Panel]:
    """A state or an output over time, a panel for each of its elements."""
    if name in run.spec.element_names:
        return [_states(run, name, drawn)]
    if not require_outputs(run.spec, [name]):
        own = [each for each in run.spec.element_names if each.startswith(f"{name}[")]
        return [_states(run, each, drawn) for each in own]
    unit = run.spec.output(name).unit
    parts = (*drawn.flights, *drawn.rests, *drawn.dots)
    t, x = (np.concatenate(column) for column in zip(*parts, strict=True))
    values = run.observed(t, x)[name]
    ends = np.cumsum([len(times) for times, _ in parts])
    rows = np.split(values.reshape(len(t), -1), ends[:-1])
    given = iter(zip((times for times, _ in parts), rows, strict=True))
    seen = _Drawn(*([next(given) for _ in part] for part in drawn))
    sides = [_rows(side[name]) for side in (run.jumps.before, run.jumps.after)]
    panels = []
    for place, index in enumerate(np.ndindex(values.shape[1:])):
        label = name + (str(list(index)) if index else "")
        curves = _path(run, place, seen, "line")
        curves += _impacts(run, label, *(side[:, place] for side in sides))
        curves += _limits(run, curves)
        panels.append(Panel(curves=curves, y=f"{label} [{unit}]" if unit else label))
    return panels


def _path(run: Solution, index: int, drawn: _Drawn, look: str, name: str = "") -> list[Curve]:
    still = look if look not in ("line", "other") else "rest" if look == "line" else "other rest"
    flying = _joined([(t, x[:, index]) for t, x in drawn.flights])
    resting = _joined([(t, x[:, index]) for t, x in drawn.rests])
    curves = [Curve(x=flying[0], y=flying[1], look=look, name=name)] if flying[0].size else []
    if resting[0].size:
        curves.append(Curve(x=resting[0], y=resting[1], look=still, name=_staying(run)))
    kept = _joined([(t, x[:, index]) for t, x in drawn.dots])
    return [*curves, Curve(x=kept[0], y=kept[1], look="mark")] if kept[0].size else curves


def _phase(run: Solution, drawn: _Drawn) -> Panel:
    names = run.spec.element_names
    i, k = (run.pairs or [(0, min(1, len(names) - 1))])[0]
    curves = []
    for look, arcs in zip(("line", "rest", "mark"), drawn, strict=True):
        x, y = _joined([(s[:, i], s[:, k]) for _, s in arcs])
        curves.append(Curve(x=x, y=y, look=look))
    if 0 < len(run.jumps) < FALLS:
        before, after = (_elements(r)[:, [i, k]] for r in (run.jumps.before, run.jumps.after))
        pairs = zip(before, after, strict=True)
        x, y = _joined([np.array(pair).T for pair in pairs])
        curves.append(Curve(x=x, y=y, look="fall"))
    for point in run.zeno:
        state = np.concatenate([np.ravel(v) for v in point.state])
        curves.append(Curve(x=[state[i]], y=[state[k]], look="point"))
    return Panel(curves=curves, x=names[i], y=names[k], title="phase portrait")


def _joined(parts: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a curve as one, interrupted between them."""
    gap = np.full(1, np.nan)
    x, y = ([np.concatenate([part[k], gap]) for part in parts] for k in (0, 1))
    empty = [np.empty(0)]
    return np.concatenate(x or empty)[:-1], np.concatenate(y or empty)[:-1]


def _staying(run: Solution) -> str:
    return "at rest" if any(part.held for part in run.parts) else "sliding"


def _impacts(run: Solution, name: str, before: Numbers, after: Numbers) -> list[Curve]:
    """Jumps at their places after them; not releases, where nothing jumps."""
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
    """Accumulations, as lines as high as what is drawn."""
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


def _elements(record: object) -> Matrix:
    """The columns of a record of jumps, one an element."""
    return np.concatenate([_rows(v) for v in record], axis=1)  # type: ignore[attr-defined]


def _rows(column: Any) -> Matrix:
    """A column of arrays as rows of numbers."""
    values = np.asarray(column, dtype=float)
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def _obstacle(run: Solution, index: int) -> list[Curve]:
    """The obstacle, where a gap grows as fast as this coordinate: ``x - gap(t, x)``."""
    times = np.linspace(run.t0, run.t1, 600)
    state = np.concatenate([np.ravel(v) for v in run.final])
    curves = []
    for guard in run.surfaces.values():
        if guard.uses != (index,) or guard.kind is not Kind.CONTACT:
            continue
        values = np.array([guard.value(t, state.tolist()) for t in times.tolist()])
        moved = state.copy()
        moved[index] += 1.0
        slope = guard.value(run.t1, moved.tolist()) - guard.value(run.t1, state.tolist())
        if abs(abs(slope) - 1.0) < 1e-12:
            place = state[index] - slope * values
            curves.append(Curve(x=times, y=place, look="surface", name="obstacle"))
    return curves


def _unit(run: Solution, index: int) -> str:
    for state in run.spec.states:
        if state.offset <= index < state.offset + state.size:
            return state.unit
    return ""
