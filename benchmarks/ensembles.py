"""Many beads of Example 1, each to its fortieth impact: one call of hybrid against other ways.

    python benchmarks/ensembles.py [--lanes 10000]

Every lane has its own start and restitution; every peer has the same tolerances of a step
(rtol = atol = 1e-9) and as many cores as it can use. The peers fly the height above the wall, so
that low flights do not drown in rounding, and choose the first step of each flight so that no
impact is lost. Slow peers fly fewer lanes. Errors are the largest over twenty lanes, against
``solver="taylor"``. The second table lets the impacts accumulate and the beads rest. Ratios hold,
milliseconds do not.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

import hybrid as hy
from models.hard_spring import HardSpring

try:
    import numba
except ImportError:
    numba = None

WALL, TOLERANCE, IMPACTS, EARLY, CHECKED = 2.0, 1e-9, 40, 10, 20
CORES, ROUNDS = os.cpu_count() or 1, 3


def lanes(count):
    """Starts and restitutions."""
    draw = np.random.default_rng(1)
    return draw.uniform(2.05, 2.45, count), draw.uniform(0.5, 0.95, count)


def timed(function, *arguments):
    begin = time.perf_counter()
    result = function(*arguments)
    return time.perf_counter() - begin, result


# ---------------------------------------------------------------------------------------
# hybrid


def ensemble(impacts, x, r):
    start, tolerances = {"x": x, "v": 0.0}, {"rtol": TOLERANCE, "atol": TOLERANCE}
    options = {"zeno": "ignore", "max_jumps": impacts, **tolerances}
    return hy.ensemble(HardSpring(), start, (0, 100), {"r": r}, **options).t.values


def resting(x, r):
    start, options = {"x": x, "v": 0.0}, {"rtol": TOLERANCE, "atol": TOLERANCE}
    return hy.ensemble(HardSpring(), start, (0, 3), {"r": r}, **options)


def exact(impacts, x, r):
    """Time of the last impact of one lane, by Taylor series."""
    options = {"solver": "taylor", "zeno": "truncate", "max_jumps": impacts}
    run = hy.simulate(HardSpring(r=r), {"x": x, "v": 0.0}, (0, 100), **options)
    return run.jumps.t[impacts - 1]


def accumulation(x, r):
    """Time at which one lane's impacts accumulate, by Taylor series; NaN if not before 3."""
    run = hy.simulate(HardSpring(r=r), {"x": x, "v": 0.0}, (0, 3), solver="taylor", save="jumps")
    return run.zeno[0].t if run.zeno else math.nan


# ---------------------------------------------------------------------------------------
# SciPy: a restart loop in each process


def flow(t, y):
    return (y[1], -math.cos(y[1]) - (WALL + y[0]) ** 3)


def height(t, y):
    return y[0]


height.terminal, height.direction = True, -1


def restarted(impacts, lane):
    """Time of the last impact."""
    t, y, first, r = 0.0, (lane[0] - WALL, 0.0), 1e-3, lane[1]
    for _ in range(impacts):
        options = {"rtol": TOLERANCE, "atol": TOLERANCE, "first_step": first}
        arc = solve_ivp(flow, (0, 100), y, "DOP853", events=height, **options)
        v = -r * arc.y_events[0][0][1]
        t, y = t + arc.t_events[0][0], (0.0, v)
        first = 0.5 * v / (math.cos(v) + WALL**3)
    return t


def in_processes(impacts, x, r, pool):
    return np.array(pool.map(partial(restarted, impacts), zip(x, r, strict=True), chunksize=4))


# ---------------------------------------------------------------------------------------
# Diffrax: a solve with an event for each flight, mapped over the lanes


def solve(x, r, impacts):
    """Time of the last impact of one lane."""
    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([y[1], -jnp.cos(y[1]) - (WALL + y[0]) ** 3]))
    root_finder = optimistix.Newton(rtol=1e-12, atol=1e-14)
    options = {
        "event": diffrax.Event(lambda t, y, *_, **__: y[0], root_finder, direction=False),
        "stepsize_controller": diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE),
        "adjoint": diffrax.ForwardMode(),
        "throw": False,
    }

    def flight(carry, _):
        t, v, y, first = carry
        arc = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, 100.0, first, y, **options)
        v = -r * arc.ys[-1, 1]
        y = jnp.stack([0.0 * v, v])
        return (t + arc.ts[-1], v, y, 0.5 * v / (jnp.cos(v) + WALL**3)), None

    begin = (0.0 * x, 0.0 * x, jnp.stack([x - WALL, 0.0 * x]), 1e-3 + 0.0 * x)
    return jax.lax.scan(flight, begin, None, length=impacts)[0][0]


@partial(jax.jit, static_argnums=0)
def mapped(impacts, x, r):
    return jax.vmap(partial(solve, impacts=impacts))(x, r)


def in_threads(impacts, x, r):
    """The lanes in pieces of about a thousand, as many at a time as there are cores."""
    parts = max(1, len(x) // 1000)
    pieces = zip(np.array_split(x, parts), np.array_split(r, parts), strict=True)
    with ThreadPoolExecutor(CORES) as pool:
        times = list(pool.map(lambda piece: mapped(impacts, *piece), pieces))
    return np.concatenate(times)


def at_once(impacts, x, r):
    """All lanes in one map."""
    return np.asarray(mapped(impacts, x, r))


# ---------------------------------------------------------------------------------------
# numba: Dormand & Prince's method by hand, the lanes in parallel


def compiled(**options):
    """numba's decorator; without numba, none."""
    return numba.njit(error_model="numpy", **options) if numba else lambda function: function


@compiled()
def pull(y, v):
    return -math.cos(v) - (WALL + y) ** 3


@compiled()
def attempt(y, v, a, h):
    """One step of the fifth order: the state after it, its acceleration, and its error."""
    v2 = v + h * a / 5
    a2 = pull(y + h * v / 5, v2)
    v3 = v + h * (3 / 40 * a + 9 / 40 * a2)
    a3 = pull(y + h * (3 / 40 * v + 9 / 40 * v2), v3)
    v4 = v + h * (44 / 45 * a - 56 / 15 * a2 + 32 / 9 * a3)
    a4 = pull(y + h * (44 / 45 * v - 56 / 15 * v2 + 32 / 9 * v3), v4)
    b1, b2, b3, b4 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
    v5 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4)
    a5 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4), v5)
    b1, b2, b3, b4, b5 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
    v6 = v + h * (b1 * a + b2 * a2 + b3 * a3 + b4 * a4 + b5 * a5)
    a6 = pull(y + h * (b1 * v + b2 * v2 + b3 * v3 + b4 * v4 + b5 * v5), v6)
    b1, b3, b4, b5, b6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
    y1 = y + h * (b1 * v + b3 * v3 + b4 * v4 + b5 * v5 + b6 * v6)
    v1 = v + h * (b1 * a + b3 * a3 + b4 * a4 + b5 * a5 + b6 * a6)
    a1 = pull(y1, v1)
    e1, e3, e4 = 71 / 57600, -71 / 16695, 71 / 1920
    e5, e6, e7 = -17253 / 339200, 22 / 525, -1 / 40
    ey = h * (e1 * v + e3 * v3 + e4 * v4 + e5 * v5 + e6 * v6 + e7 * v1)
    ev = h * (e1 * a + e3 * a3 + e4 * a4 + e5 * a5 + e6 * a6 + e7 * a1)
    ey /= TOLERANCE * (1 + max(abs(y), abs(y1)))
    ev /= TOLERANCE * (1 + max(abs(v), abs(v1)))
    return y1, v1, a1, math.sqrt(0.5 * (ey * ey + ev * ev))


@compiled()
def flown(y, v, h):
    """Duration of a flight, and the velocity at its end."""
    t, a = 0.0, pull(y, v)
    while True:
        y1, v1, a1, error = attempt(y, v, a, h)
        if error <= 1 and y1 <= 0:
            break
        if error <= 1:
            t, y, v, a = t + h, y1, v1, a1
        h *= min(10.0, max(0.2, 0.9 * error**-0.2)) if error > 0 else 10.0
    for _ in range(20):  # Newton's method; the height is concave, so it comes from the right
        shift = -y1 / v1
        if abs(shift) <= 1e-14 * h:
            break
        h += shift
        y1, v1, a1, error = attempt(y, v, a, h)
    return t + h, v1


@compiled(parallel=True)
def by_hand(impacts, x, r):
    """Time of the last impact of each lane."""
    times = np.zeros(len(x))
    for i in numba.prange(len(x)):
        t, v = flown(x[i] - WALL, 0.0, 1e-3)
        for _ in range(impacts - 1):
            v *= -r[i]
            own, v = flown(0.0, v, 2.1 * v / (math.cos(v) + WALL**3))
            t += own
        times[i] = t
    return times


# ---------------------------------------------------------------------------------------
# tables


def in_turns(peers):
    """First and best later seconds of each, in turns: a slow moment of the machine hits all."""
    first = [timed(*peer)[0] for peer in peers]
    return first, np.min([[timed(*peer)[0] for peer in peers] for _ in range(ROUNDS)], axis=0)


def impacts_table(x, r):
    few, checked = (x[: 2 * CHECKED], r[: 2 * CHECKED]), (x[:CHECKED], r[:CHECKED])
    with multiprocessing.get_context("spawn").Pool(CORES) as pool:
        peers = {
            "hybrid, ensemble": (ensemble, IMPACTS, x, r),
            "Diffrax, vmap of solves in threads, Tsit5": (in_threads, IMPACTS, x, r),
            "Diffrax, one vmap of solves, Tsit5": (at_once, IMPACTS, x, r),
            "solve_ivp, a process a core, DOP853": (
                partial(in_processes, pool=pool),
                IMPACTS,
                *few,
            ),
            "numba, by hand, Dormand-Prince 5(4)": (by_hand, IMPACTS, x, r),
        }
        if not numba:
            del peers["numba, by hand, Dormand-Prince 5(4)"]
        first, best = in_turns(peers.values())
        found = [[peer[0](n, *checked) for peer in peers.values()] for n in (EARLY, IMPACTS)]
    expected = [[exact(n, *lane) for lane in zip(*checked, strict=True)] for n in (EARLY, IMPACTS)]
    errors = np.abs(np.array(found) - np.array(expected)[:, None]).max(axis=2)
    rates = [len(peer[2]) / seconds for peer, seconds in zip(peers.values(), best, strict=True)]
    print(
        f"{'to the 40th impact':41} {'lanes':>6} {'first, s':>8} {'lanes/s':>9} {'ratio':>8}",
        end="",
    )
    print(f" {'error 10th':>10} {'error 40th':>10}")
    for k, (name, peer) in enumerate(peers.items()):
        figures = f"{len(peer[2]):6} {first[k]:8.1f} {rates[k]:9.0f} {rates[k] / rates[0]:8.3f}"
        print(f"{name:41} {figures} {errors[0, k]:10.1e} {errors[1, k]:10.1e}")
    if not numba:
        print("numba is not installed: its row is left out")


def rests_table(x, r):
    (begun,), (seconds,) = in_turns([(resting, x, r)])
    lanes = zip(x[:CHECKED], r[:CHECKED], strict=True)
    expected = np.array([accumulation(*lane) for lane in lanes])
    print(
        f"\n{'to t = 3, resting':41} {'lanes':>6} {'first, s':>8} {'lanes/s':>9} {'rest':>8}",
        end="",
    )
    print(f" {'error of t_inf':>21}")
    data = resting(x, r)
    found, share = data.t_inf[:CHECKED].values, np.isfinite(data.t_inf.values).mean()
    if (np.isnan(expected) != np.isnan(found)).any():
        print("hybrid disagrees with its Taylor series on which lanes accumulate")
    figures = f"{len(x):6} {begun:8.1f} {len(x) / seconds:9.0f} {share:8.1%}"
    print(f"{'hybrid, ensemble':41} {figures} {np.nanmax(np.abs(found - expected)):21.1e}")


def main():
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lanes", type=int, default=10_000)
    x, r = lanes(parser.parse_args().lanes)
    impacts_table(x, r)
    rests_table(x, r)


if __name__ == "__main__":
    main()
