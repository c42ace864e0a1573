"""``solve_ivp`` with a terminal event, the lowest gap, begun anew at each impact."""

from __future__ import annotations

from scipy.integrate import solve_ivp

from peers.oscillator import ENDLESS, FUNCTIONS, LONGEST, rows_of


def prepare(task, tolerance, method="DOP853"):
    """A call that makes the impacts."""

    def flow(t, y):
        return task.flow(FUNCTIONS, t, y)

    def gap(t, y):
        return min(task.gaps(FUNCTIONS, t, y))

    gap.terminal, gap.direction = True, -1
    options = {"events": gap, "rtol": tolerance, "atol": tolerance, "max_step": LONGEST}

    def flights():
        t, y, first = task.begin, task.start, 1e-3
        while True:
            arc = solve_ivp(flow, (t, t + ENDLESS), y, method, first_step=first, **options)
            if not len(arc.t_events[0]):
                return
            t, y = float(arc.t_events[0][0]), arc.y_events[0][0]
            gaps = task.gaps(FUNCTIONS, t, y)
            which = gaps.index(min(gaps))
            row, t, y = task.rebound(t, y, which)
            first = task.first(t, y, which)
            yield row

    return lambda: rows_of(flights, task)
