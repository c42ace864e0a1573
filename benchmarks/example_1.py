"""Example 1 through its accumulation and rest to t = 5, against loops that start again.

    python benchmarks/example_1.py

The loops stop at each impact, apply the reset and start again, with a first step small enough not
to lose the next impact: sixty impacts leave them about 2e-6 before the accumulation. One is written
around ``solve_ivp``, one is nested ``diffeqsolve`` in one compiled program. Errors are against 40
digits. Times are taken in turns, as medians of seven, and the ratio is the median of each turn's
own: only ratios mean anything. The last row is what the steps of the run with SciPy cost alone.
"""

from __future__ import annotations

import statistics
import time
from math import cos

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import DOP853, solve_ivp

import hybrid as hy
from models.hard_spring import HardSpring

T_INF = 1.32961738383844857732
R, IMPACTS, LAST = 0.8, 60, 5.0
START = {"x": 2.1, "v": 0.0}

#: Turns, and calls in each, of which the fastest counts.
TURNS, CALLS = 7, 5


def flow(t, y):
    return (y[1], -cos(y[1]) - y[0] ** 3)


def wall(t, y):
    return y[0] - 2.0


wall.terminal, wall.direction = True, -1


def restart_loop():
    """Time of the sixtieth impact."""
    t, y, first = 0.0, [2.1, 0.0], None
    for _ in range(IMPACTS):
        arc = solve_ivp(
            flow, (t, LAST), y, "DOP853", events=wall, rtol=1e-9, atol=1e-12, first_step=first
        )
        t, v = arc.t[-1], -R * arc.y[1, -1]
        y, first = [2.0, v], min(1e-3, 0.1 * v)
    return t


@jax.jit
def nested(start):
    """The same by ``diffeqsolve``."""
    term = diffrax.ODETerm(lambda t, y, args: jnp.stack([y[1], -jnp.cos(y[1]) - y[0] ** 3]))
    event = diffrax.Event(
        lambda t, y, args, **kwargs: y[0] - 2.0, optimistix.Newton(1e-12, 1e-12), direction=False
    )

    def flight(_, carry):
        t, y, first = carry
        arc = diffrax.diffeqsolve(
            term,
            diffrax.Tsit5(),
            t,
            LAST,
            first,
            y,
            stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-12),
            event=event,
            max_steps=10_000,
        )
        v = -R * arc.ys[-1, 1]
        return arc.ts[-1], jnp.stack([2.0, v]), jnp.minimum(1e-3, 0.1 * v)

    return jax.lax.fori_loop(0, IMPACTS, flight, (jnp.array(0.0), start, jnp.array(1e-3)))[0]


def ours(**options):
    """A run of this package."""
    return hy.simulate(HardSpring(r=R), START, (0.0, LAST), save="jumps", **options)


def bare(steps):
    """So many steps of SciPy's DOP853 along the flow, and nothing else."""
    solver = DOP853(flow, 0.0, [2.1, 0.0], 1e9, rtol=1e-8, atol=1e-10, first_step=1e-2)
    for _ in range(steps):
        solver.step()
    return np.nan


def fastest(function):
    """Seconds of the fastest of some calls."""
    seconds = []
    for _ in range(CALLS):
        begin = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def main():
    jax.config.update("jax_enable_x64", True)
    start = jnp.array([2.1, 0.0])
    chosen = {
        "taylor": {"solver": "taylor"},
        "scipy": {},
        "diffrax": {"solver": "diffrax"},
        "diffrax, Dopri8()": {"solver": "diffrax", "method": diffrax.Dopri8()},
    }
    rows = {
        f"solve_ivp DOP853, {IMPACTS} impacts": restart_loop,
        f"diffeqsolve Tsit5, {IMPACTS} impacts": lambda: float(nested(start)),
        **{f"hybrid, {k}": lambda o=o: ours(**o).zeno[0].t for k, o in chosen.items()},
        "steps of hybrid, scipy, alone": lambda: bare(ours().stats.steps),
    }
    errors = [abs(function() - T_INF) for function in rows.values()]
    steps = ours().stats.steps
    rows["steps of hybrid, scipy, alone"] = lambda: bare(steps)
    turns = np.array([[fastest(f) for f in rows.values()] for _ in range(TURNS)])
    print(f"{'':32} {'error of t_inf':>15} {'ms':>8} {'times faster':>13}")
    for name, error, own in zip(rows, errors, turns.T, strict=True):
        ratio = statistics.median(turns[:, 0] / own)
        print(f"{name:32} {error:15.1e} {1e3 * statistics.median(own):8.2f} {ratio:13.1f}")


if __name__ == "__main__":
    main()
