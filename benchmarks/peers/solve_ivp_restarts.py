"""``solve_ivp`` with a terminal event, begun anew at each impact."""

from __future__ import annotations

from scipy.integrate import solve_ivp

from peers.oscillator import ENDLESS, FUNCTIONS, LONGEST, rows_of


def prepare(task, tolerance, impacts):
    """A call that makes the impacts."""

    def flow(t, y):
        return y[1], task.force(FUNCTIONS, t, *y)

    def gap(t, y):
        return y[0] - task.wall(FUNCTIONS, t)

    gap.terminal, gap.direction = True, -1
    options = {"events": gap, "rtol": tolerance, "atol": tolerance, "max_step": LONGEST}

    def flights():
        t, y, first = task.begin, task.start, 1e-3
        while True:
            arc = solve_ivp(flow, (t, t + ENDLESS), y, "DOP853", first_step=first, **options)
            if not len(arc.t_events[0]):
                return
            t = arc.t_events[0][0]
            *y, speed = task.rebound(t, arc.y_events[0][0][1])
            first = task.first(speed)
            yield t, *y

    return lambda: rows_of(flights, impacts)
