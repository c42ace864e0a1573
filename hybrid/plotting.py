"""Pictures of a run: states over time, phase portrait, gaps between impacts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Points an arc, at most; an arc of a long run gets fewer.
POINTS = 200

LINE, IMPACT, LIMIT, SURFACE = "#1f5a96", "#c44e52", "#2e8b57", "#8c8c8c"


def plot(run: Trajectory, path: Any = None) -> Figure:
    """Draw a run on one figure.

    Left: each element of the state over time, impacts marked, accumulations as lines,
    resting arcs thicker, and the obstacle where a gap is the distance of one coordinate to
    it. Right: the phase portrait of the first contact's position and velocity, and the
    gaps between jumps against their number on a logarithmic axis, where a chattering
    series is a straight line.
    """
    from matplotlib.figure import Figure

    names = run.spec.element_names
    rows = max(2, len(names)) if len(names) > 1 else 1
    figure = Figure(figsize=(11, 2.1 * max(rows, 1.5) + 0.8), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.7, 1))
    curves = _curves(run)
    shared: Axes | None = None
    for index, name in enumerate(names):
        axes = figure.add_subplot(grid[index, 0], sharex=shared)
        shared = shared or axes
        _series(axes, run, curves, index)
        _surface(axes, run, index)
        unit = _unit(run, index)
        axes.set_ylabel(f"{name} [{unit}]" if unit else name)
        if index + 1 < len(names):
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("t")
    half = rows // 2 if len(names) > 1 else 0
    if half:
        _phase(figure.add_subplot(grid[:half, 1]), run, curves)
    _gaps(figure.add_subplot(grid[half:, 1]), run)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", ncols=4, fontsize=8, frameon=False)
    figure.suptitle(_title(run), fontsize=10)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _curves(run: Trajectory) -> list[tuple[bool, np.ndarray, np.ndarray]]:
    """For each arc: whether it rests, its times, its states."""
    arcs = run.arcs
    count = int(np.clip(20000 // max(len(arcs), 1), 9, POINTS))
    curves = []
    for arc in arcs:
        grid = np.linspace(0.0, 1.0, count if arc.segments else 2) * arc.length
        curves.append((_stays(arc.mode), arc.t0 + (arc.low + grid), arc.local(grid)))
    return curves


def _stays(mode: str) -> bool:
    """Whether an arc stays on a surface: at rest on a contact, or sliding."""
    return ".rest(" in mode or mode.startswith("slide(")


def _staying(run: Trajectory) -> str:
    return "at rest" if any(".rest(" in arc.mode for arc in run.arcs) else "sliding"


def _series(axes: Axes, run: Trajectory, curves: Any, index: int) -> None:
    gap = np.full(1, np.nan)
    flying = [c for c in curves if not c[0]]
    if flying:
        times = np.concatenate([np.concatenate([t, gap]) for _, t, _ in flying])
        values = np.concatenate([np.concatenate([x[:, index], gap]) for _, _, x in flying])
        axes.plot(times, values, color=LINE, lw=1)
    for resting, t, x in curves:
        if resting:
            label = None if axes.get_legend_handles_labels()[0] else _staying(run)
            style: dict[str, Any] = {"color": LINE, "lw": 2.4, "label": label}
            axes.plot(t, x[:, index], **style)
    shown = _impacts(run)
    if np.any(shown):
        after = _elements(run, run.jumps.after)[shown, index]
        axes.plot(run.jumps.t[shown], after, ".", color=IMPACT, ms=4, label="jump")
    for number, point in enumerate(run.zeno):
        label = None if number else "accumulation"
        axes.axvline(point.t, color=LIMIT, lw=1, ls="--", label=label)


def _impacts(run: Trajectory) -> np.ndarray:
    """Which jumps are drawn: not releases, where nothing jumps."""
    return np.array([not str(edge).endswith(".release") for edge in run.jumps.edge], dtype=bool)


def _elements(run: Trajectory, record: Any) -> np.ndarray:
    parts = [np.asarray(v) for v in record]
    return np.concatenate([p.reshape(len(p), -1) for p in parts], axis=1)


def _surface(axes: Axes, run: Trajectory, index: int) -> None:
    """The obstacle, where a gap grows as fast as this coordinate: ``x - gap(t, x)``."""
    times = np.linspace(run.t0, run.t1, 600)
    state = np.concatenate([np.ravel(v) for v in run.final])
    for guard in run.surfaces.values():
        if guard.uses != (index,) or guard.kind != "contact":
            continue
        values = np.array([guard.value(t, state.tolist()) for t in times.tolist()])
        moved = state.copy()
        moved[index] += 1.0
        slope = guard.value(run.t1, moved.tolist()) - guard.value(run.t1, state.tolist())
        if abs(abs(slope) - 1.0) < 1e-12:
            axes.plot(
                times,
                state[index] - slope * values,
                color=SURFACE,
                lw=1.2,
                zorder=0,
                label="obstacle",
            )


def _phase(axes: Axes, run: Trajectory, curves: Any) -> None:
    names = run.spec.element_names
    pairs = run.pairs or [(0, min(1, len(names) - 1))]
    i, k = pairs[0]
    for resting, _, x in curves:
        axes.plot(x[:, i], x[:, k], color=LINE, lw=2.4 if resting else 0.9)
    for jump in run.jumps if len(run.jumps) < 2000 else []:
        before, after = (
            np.concatenate([np.ravel(v) for v in r]) for r in (jump.before, jump.after)
        )
        axes.plot([before[i], after[i]], [before[k], after[k]], color=IMPACT, lw=0.7, ls=":")
    for point in run.zeno:
        state = np.concatenate([np.ravel(v) for v in point.state])
        axes.plot(state[i], state[k], "o", color=LIMIT, ms=5)
    axes.set_xlabel(names[i])
    axes.set_ylabel(names[k])
    axes.set_title("phase portrait", fontsize=9)


def _gaps(axes: Axes, run: Trajectory) -> None:
    gaps = run.jumps.gaps
    shown = gaps > 0
    axes.set_title("time between jumps", fontsize=9)
    axes.set_xlabel("jump")
    if np.any(shown):
        axes.semilogy(
            np.arange(1, len(gaps) + 1)[shown], gaps[shown], ".-", color=IMPACT, lw=0.7, ms=4
        )
    else:
        axes.text(0.5, 0.5, "fewer than two jumps", ha="center", transform=axes.transAxes)


def _unit(run: Trajectory, index: int) -> str:
    for state in run.spec.states:
        if state.offset <= index < state.offset + state.size:
            return state.unit
    return ""


def _title(run: Trajectory) -> str:
    head = f"{run.spec.model}: {len(run.jumps)} jumps listed"
    if not run.zeno:
        return head
    first = run.zeno[0]
    more = f" (first of {len(run.zeno)})" if len(run.zeno) > 1 else ""
    return f"{head}, accumulating at t = {first.t:.12g} ± {first.t_error:.0e}{more}"
