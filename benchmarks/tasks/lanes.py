"""Many beads of Example 1, each with a start and a restitution of its own.

Every tool has as many cores as it can use, and the tolerances of a step at which it keeps to the
error that is asked for; slow ones fly fewer lanes, and those that are far behind at one tolerance.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import attrs
import jax
import jax.numpy as jnp
import numpy as np

import floors
import hybrid as hy
from measure import Task
from models.hard_spring import HardSpring
from peers import solve_ivp_restarts
from tasks.impacts import example_1

WALL, IMPACTS, CHECKED, UNTIL = 2.0, 40, 20, 3.0
LANES, SOME, FEW, QUICK = 10_000, 2_000, 40, 500
CORES = os.cpu_count() or 1
TOLERANCES = 1e-9, 1e-10, 1e-11, 1e-12, 1e-13


def lanes(count):
    """Starts and restitutions."""
    draw = np.random.default_rng(1)
    return draw.uniform(2.05, 2.45, LANES)[:count], draw.uniform(0.5, 0.95, LANES)[:count]


# ---------------------------------------------------------------------------------------
# hybrid


def step(rtol):
    """The tolerances of a step."""
    return {"rtol": rtol, "atol": rtol}


def to_impacts(rtol, x, r):
    """Time of the last impact of each lane."""
    start, options = {"x": x, "v": 0.0}, {"zeno": "ignore", "max_jumps": IMPACTS, **step(rtol)}
    return hy.ensemble(HardSpring(), start, (0, 100), {"r": r}, **options).t.values


def to_rest(rtol, x, r):
    """Time of the limit of each lane, NaN where it is not before the end."""
    start, ends = {"x": x, "v": 0.0}, (0, UNTIL)
    return hy.ensemble(HardSpring(), start, ends, {"r": r}, **step(rtol)).t_inf.values


def exact(resting, x, r):
    """The same of one lane, by Taylor series to rounding."""
    options = {"solver": "taylor", "save": "jumps"}
    model, start = HardSpring(r=r), {"x": x, "v": 0.0}
    if resting:
        run = hy.simulate(model, start, (0, UNTIL), **options)
        return run.zeno[0].t if run.zeno else math.nan
    run = hy.simulate(model, start, (0, 100), zeno="ignore", max_jumps=IMPACTS, **options)
    return run.jumps.t[IMPACTS - 1]


# ---------------------------------------------------------------------------------------
# the peers


def restarted(rtol, lane):
    """Time of the last impact, by ``solve_ivp``."""
    x, r = lane
    motion = attrs.evolve(example_1(r, IMPACTS), start=(x - WALL, 0.0))
    return solve_ivp_restarts.prepare(motion, rtol)()[-1, 0]


def in_processes(rtol, x, r):
    """The same in a process a core, which are there before the time is taken."""
    pool = workers()
    return np.array(pool.map(partial(restarted, rtol), zip(x, r, strict=True), chunksize=4))


@cache
def workers():
    return multiprocessing.get_context("spawn").Pool(CORES)


def nested(rtol, x, r):
    """Time of the last impact, by ``diffeqsolve`` with an event for each flight."""
    import diffrax

    from peers.diffeqsolve_nested import options_of

    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([y[1], -jnp.cos(y[1]) - (WALL + y[0]) ** 3]))
    options = options_of(lambda t, y, *_, **__: y[0], rtol)

    def flight(carry, _):
        t, y, first = carry
        arc = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, 100.0, first, y, **options)
        v = -r * arc.ys[-1, 1]
        y = jnp.stack([0.0 * v, v])
        return (t + arc.ts[-1], y, 0.5 * v / (jnp.cos(v) + WALL**3)), None

    begin = (0.0 * x, jnp.stack([x - WALL, 0.0 * x]), 1e-3 + 0.0 * x)
    return jax.lax.scan(flight, begin, None, length=IMPACTS)[0][0]


@partial(jax.jit, static_argnums=0)
def mapped(rtol, x, r):
    return jax.vmap(partial(nested, rtol))(x, r)


def at_once(rtol, x, r):
    """All lanes in one map."""
    return np.asarray(mapped(rtol, x, r))


def in_threads(rtol, x, r):
    """The lanes in pieces of about a thousand, as many at a time as there are cores."""
    parts = max(1, len(x) // 1000)
    pieces = zip(np.array_split(x, parts), np.array_split(r, parts), strict=True)
    with ThreadPoolExecutor(CORES) as pool:
        return np.concatenate(list(pool.map(lambda piece: mapped(rtol, *piece), pieces)))


def by_hand(method, resting, rtol, x, r):
    """numba, in parallel."""
    from peers import numba_beads

    last, to_rest = numba_beads.loops(method)
    return to_rest(UNTIL, rtol, x, r) if resting else last(IMPACTS, rtol, x, r)


# ---------------------------------------------------------------------------------------
# tasks


def task(name, quick):
    count, resting = QUICK if quick else LANES, name == "lanes_to_rest"
    truth = cache(lambda: np.array([*map(partial(exact, resting), *lanes(CHECKED))]))

    def judge(times, rtol):
        found = np.asarray(times)[:CHECKED]
        if (np.isnan(found) != np.isnan(truth())).any():
            return math.inf, len(times), 0
        return np.nanmax(np.abs(found - truth())), len(times), 0

    def way(function, number=count):
        return lambda rtol: lambda: function(rtol, *lanes(number))

    ways = {"hybrid, ensemble": way(to_rest if resting else to_impacts)}
    for method in ("Dormand-Prince", "Taylor"):
        ways[f"numba, {method} by hand, all cores"] = way(partial(by_hand, method, resting))
    if not resting:
        ways["diffeqsolve Tsit5, vmap, in threads"] = way(in_threads, min(count, SOME))
        ways["diffeqsolve Tsit5, one vmap"] = way(at_once, min(count, SOME))
        ways["solve_ivp DOP853, a process a core"] = way(in_processes, FEW)
    aim = f"to rest by t = {UNTIL:g}" if resting else f"to {IMPACTS} impacts"
    what = "limit" if resting else "last impact"
    return Task(
        title=f"{count:,} beads {aim}",
        text=f"`HardSpring()` from random heights, with random r, on {CORES} cores: the time of "
        f"the {what}, in {CHECKED} lanes against Taylor series to rounding.",
        unit="a lane",
        wanted=1e-10,
        ways=ways,
        judge=judge,
        tolerances=TOLERANCES,
        clock=time.perf_counter,
        floor=None if resting else lambda: floor_of(count),
    )


def floor_of(count, rtol=TOLERANCES[1]):
    """Jets and zeros of the lanes, shared by the cores; counted in some of them as runs."""
    steps, options = [], {"solver": "taylor", "save": "jumps", "zeno": "ignore", **step(rtol)}
    for x, r in zip(*lanes(CHECKED), strict=True):
        start = {"x": x, "v": 0.0}
        run = hy.simulate(HardSpring(r=r), start, (0, 100), max_jumps=IMPACTS, **options)
        steps.append(run.stats.steps)
    one = floors.jet(HardSpring(), [2.1, 0.0], rtol)
    share = count / CORES
    return [
        ("jets", float(np.mean(steps)) * share, one),
        ("zeros", IMPACTS * share, floors.root()),
    ]
