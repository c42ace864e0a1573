"""Section 6 of the paper drawn: both memories from x1 = 3, and the map of the restarted system."""

from __future__ import annotations

import numpy as np

from hybrid.plot.figure import Curve, Figure, Panel
from hybrid.plot.of_run import states_panel

from .pyragas import CHATTERS, at_rest, border, first_speed, orbit, restarted, returned

#: Points a curve, about; how long the figures last.
POINTS, SHOWN = 2000, 8.0


def table_figure() -> Figure:
    """From x1 = 3 with both memories; the return map of the restarted system."""
    kept = states_panel(at_rest(3.0, SHOWN), "x1", points=POINTS)
    again = states_panel(restarted(3.0, SHOWN), "x1", points=POINTS)
    panels = [
        Panel(curves=panel.curves, y="x1", title=f"memory {what} at impacts")
        for panel, what in ((kept, "kept"), (again, "restarted"))
    ]
    return Figure(
        name="table-1",
        title="Pyragas control from x1 = 3, and the return map of the restarted system",
        columns=(tuple(panels), (map_panel(),)),
        zooms=[("whole run", (0.0, SHOWN)), ("the first two units", (0.0, 2.0))],
    )


def map_panel() -> Panel:
    """Speed after an impact over that after the one before, with two ways along it."""
    parts = (0.02, 1.95, 20), (2.0, 3.0, 60), (3.05, 9.0, 40)
    speeds = np.concatenate([np.linspace(*part) for part in parts])
    low, high = border().speed, float(orbit().start.x2)
    curves = [
        Curve(x=[0.0, 9.0], y=[0.0, 9.0], look="surface", name="equal speeds"),
        Curve(x=speeds, y=[returned(v) for v in speeds], name="return map"),
        *(_way(x0) for x0 in (CHATTERS, 3.0)),
        Curve(
            x=[low, high],
            y=[low, high],
            look="point",
            name="orbits: the lower repels, the upper attracts",
            notes=[f"repels, speed {low:.12g}", f"attracts, speed {high:.12g}"],
        ),
    ]
    return Panel(
        curves=curves, x="speed after an impact", y="speed after the next", square=True, title=""
    )


def _way(x0: float, count: int = 12) -> Curve:
    """Speeds after impacts from a start, one after the other."""
    speed = first_speed(x0)
    path = [(speed, 0.0)]
    for _ in range(count):
        after = returned(speed)
        path += [(speed, after), (after, after)]
        speed = after
    x, y = np.array(path).T
    return Curve(x=x, y=y, look="fall", name="from 2.1 and from 3")
