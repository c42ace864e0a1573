"""Example 1 to its accumulation: the SciPy backend against a restart loop of ``solve_ivp``.

    python benchmarks/example_1.py

The loop stops at each impact (a terminal event), applies the reset and starts again, with a
first step small enough not to lose the next impact; 60 impacts leave it about 2e-6 before
the accumulation. Errors are against 40 digits; times are the best of several runs in this
process, and only their ratios mean anything.
"""

from __future__ import annotations

import timeit
from math import cos

from scipy.integrate import solve_ivp

import hybrid as hy
from models.hard_spring import HardSpring

T_INF = 1.32961738383844857732
R, IMPACTS = 0.8, 60


def flow(t, y):
    return (y[1], -cos(y[1]) - y[0] ** 3)


def wall(t, y):
    return y[0] - 2.0


wall.terminal, wall.direction = True, -1


def restart_loop(method, rtol):
    """Time of the sixtieth impact."""
    t, y, first = 0.0, [2.1, 0.0], None
    for _ in range(IMPACTS):
        arc = solve_ivp(
            flow, (t, t + 10), y, method, events=wall, rtol=rtol, atol=1e-10, first_step=first
        )
        t, v = arc.t_events[0][0], arc.y_events[0][0][1]
        y, first = [2.0, -R * v], min(1e-3, -0.02 * R * v)
    return t


def best(functions, rounds=15, number=4):
    """Best time of each, measured in turns so that a slow moment of the machine hits all."""
    seconds = [float("inf")] * len(functions)
    for _ in range(rounds):
        for k, function in enumerate(functions):
            seconds[k] = min(seconds[k], timeit.timeit(function, number=number) / number)
    return seconds


def accumulation(rtol):
    """The accumulation time by this package."""
    start = {"x": 2.1, "v": 0.0}
    run = hy.simulate(HardSpring(r=R), start, (0, 2), rtol=rtol, zeno="stop", save="jumps")
    return run.zeno[0].t


def main():
    rows = {
        f"`solve_ivp` RK45, {IMPACTS} impacts": lambda: restart_loop("RK45", 1e-9),
        f"`solve_ivp` DOP853, {IMPACTS} impacts": lambda: restart_loop("DOP853", 1e-9),
        "hybrid, DOP853, rtol 1e-9": lambda: accumulation(1e-9),
        "hybrid, DOP853, rtol 1e-12": lambda: accumulation(1e-12),
    }
    errors = [abs(function() - T_INF) for function in rows.values()]
    seconds = best(list(rows.values()))
    print(f"{'':32} {'error of t_inf':>15} {'ms':>8} {'times faster':>13}")
    for name, error, own in zip(rows, errors, seconds, strict=True):
        print(f"{name:32} {error:15.1e} {1e3 * own:8.2f} {seconds[0] / own:13.1f}")


if __name__ == "__main__":
    main()
