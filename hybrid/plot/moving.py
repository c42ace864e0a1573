"""Animations of runs, for models that declare their picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..automaton.picture import looks
from ..errors import OptionError
from ..trajectory.trajectory import Solution
from . import require_writable
from .figure import METHOD_COLORS

#: Resolution of a frame, in dots per inch.
FRAME_DPI = 100


def animate(run: Solution, path: Any, seconds: float, fps: int, size: tuple[float, float]) -> None:
    """Write an animation: see :meth:`hybrid.Trajectory.animate`."""
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    if Path(path).suffix.lower() != ".gif":
        raise OptionError(f"{path}: end the name in .gif")
    require_writable(path)
    if not (0 < seconds < np.inf and 0 < fps < np.inf and round(seconds * fps) > 1):
        raise OptionError(f"seconds={seconds!r}, fps={fps!r}: two frames at least")
    times = np.linspace(run.t0, run.t1, round(seconds * fps))
    lines = looks(run.spec, run.parameters, times, run.states(times))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot(aspect="equal")
    seen = np.concatenate([line.reshape(-1, 2) for line in lines])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    margin = 0.06 * (np.max(high - low) or 1.0)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    drawn = [
        axes.plot([], [], marker="o" if line.shape[1] == 1 else "", lw=2, color=color)[0]
        for line, color in zip(lines, METHOD_COLORS * len(lines), strict=False)
    ]
    title = axes.set_title(run.spec.model, fontsize=9, family="monospace")
    digits = max(0, 2 - int(np.floor(np.log10(run.t1 - run.t0))))
    writer = PillowWriter(fps=fps)
    with writer.saving(figure, str(path), FRAME_DPI):
        for k, t in enumerate(times.tolist()):
            for one, line in zip(drawn, lines, strict=True):
                one.set_data(*line[k].T)
            title.set_text(f"{run.spec.model}, t = {t:.{digits}f}")
            writer.grab_frame()
