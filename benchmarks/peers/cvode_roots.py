"""CVODE with a root function for each gap, begun anew at each impact."""

from __future__ import annotations

import numpy as np
from sksundae.cvode import CVODE

from peers.oscillator import ENDLESS, FUNCTIONS, rows_of


def prepare(task, tolerance, method="Adams"):
    """A call that makes the impacts; ``method``: Adams where nothing is stiff, or BDF."""

    def flow(t, y, slope):
        slope[:] = task.flow(FUNCTIONS, t, y)

    def gap(t, y, events):
        events[:] = task.gaps(FUNCTIONS, t, y)

    count = len(task.gaps(FUNCTIONS, task.begin, task.start))
    gap.terminal, gap.direction = [True] * count, [-1] * count
    # low flights need a smaller absolute one; a smaller one still fails
    options = {"method": method, "rtol": tolerance, "atol": max(1e-3 * tolerance, 1e-15)}
    options["max_num_steps"] = 100_000

    def flights():
        t, y, first = task.begin, np.array(task.start), 1e-3
        while True:
            solver = CVODE(flow, eventsfn=gap, num_events=count, first_step=first, **options)
            arc = solver.solve(np.array([t, t + ENDLESS]), y)
            if arc.t_events is None or not len(arc.t_events):
                return
            which = int(np.flatnonzero(arc.i_events[-1])[0])
            row, t, y = task.rebound(float(arc.t_events[-1]), arc.y_events[-1], which)
            first, y = task.first(t, y, which), np.array(y)
            yield row

    return lambda: rows_of(flights, task)
