"""CVODE with a root function (Adams, as nothing is stiff), begun anew at each impact."""

from __future__ import annotations

import numpy as np
from sksundae.cvode import CVODE

from peers.oscillator import ENDLESS, FUNCTIONS, rows_of


def prepare(task, tolerance, impacts):
    """A call that makes the impacts."""

    def flow(t, y, slope):
        slope[0], slope[1] = y[1], task.force(FUNCTIONS, t, y[0], y[1])

    def gap(t, y, events):
        events[0] = y[0] - task.wall(FUNCTIONS, t)

    gap.terminal, gap.direction = [True], [-1]
    options = {"method": "Adams", "rtol": tolerance, "atol": tolerance, "max_num_steps": 100_000}

    def flights():
        t, y, first = task.begin, np.array(task.start), 1e-3
        while True:
            solver = CVODE(flow, eventsfn=gap, num_events=1, first_step=first, **options)
            arc = solver.solve(np.array([t, t + ENDLESS]), y)
            if arc.t_events is None or not len(arc.t_events):
                return
            t = float(arc.t_events[-1])
            *y, speed = task.rebound(t, float(arc.y_events[-1][1]))
            first, y = task.first(speed), np.array(y)
            yield t, *y

    return lambda: rows_of(flights, impacts)
