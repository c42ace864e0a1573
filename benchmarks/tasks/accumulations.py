"""Impacts that accumulate: to the limit, and on.

The peers know no limit: they make as many impacts as leave flights below rounding, and add those
that are left as a geometric series; where a bead rests and is released, they are told when.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.integrate import DOP853

import floors
import hybrid as hy
from measure import Task
from models.bead_on_table import BeadOnTable
from models.hard_spring import HardSpring
from peers.oscillator import FUNCTIONS, Oscillator
from tasks import peers, tolerances
from tasks.impacts import example_1, falling, shaken

#: Example 1: restitution, its limit (40 digits), the impacts of a peer, the end of a run.
LIMITS = {
    "example_1_and_on": (0.8, 1.32961738383844857732, 60, 5.0),
    "slow_accumulation": (0.99, 29.41721026630354652924, 1_000, 40.0),
}

#: The table that throws: its first rest, its second, the time from each to the next (40 digits).
FIRST, SECOND, PERIOD = 1.52191223348706820812, 2.91557097101071664299, math.pi / 2
PERIODS, THROWN, SLOW = 50, {"r": 0.3, "omega": 4.0}, 1e-5


def task(name, quick):
    return thrown(5 if quick else PERIODS) if name == "thrown" else limit(name)


# ---------------------------------------------------------------------------------------
# to the limit


def limit(name):
    """Example 1 to its limit, and on to the end."""
    r, exact, impacts, until = LIMITS[name]
    model, motion = HardSpring(r=r), example_1(r, impacts)

    def ours(solver, rtol):
        options = {"solver": solver, "save": "jumps", **tolerances(solver, rtol)}
        start = {"x": 2.1, "v": 0.0}
        return lambda: hy.simulate(model, start, (0.0, until), **options).zeno[0].t

    def summed(make, rtol):
        fly = make(rtol)
        return lambda: limit_of(fly())

    def limit_of(rows):
        if len(rows) < impacts:
            return math.inf
        t, y, v = rows[-1]
        return t - 2 * v / (motion.force(FUNCTIONS, t, y, v) * (1 - r))

    ways = {f"hybrid, {s}": lambda rtol, s=s: ours(s, rtol) for s in ("taylor", "scipy", "diffrax")}
    modules = "solve_ivp_restarts", "cvode_roots", "diffeqsolve_nested", "heyoka_events"
    others = peers(dict.fromkeys([*modules, "numba_taylor"], motion))
    for who, make in others.items():
        ways[who] = partial(summed, make)
    ways["the steps of hybrid, scipy, bare"] = lambda rtol: bare(model, until, rtol)
    return Task(
        title=f"Example 1 with r = {r:g}, to its limit and on to t = {until:g}",
        text=f"`{model}`: the time of the limit, against 40 digits. Peers make {impacts:,} impacts "
        "and add the rest as a geometric series. The last row is what the steps of the run with "
        "SciPy cost alone: its error is that run's.",
        unit="a run",
        wanted=1e-9,
        ways=ways,
        judge=lambda t, rtol: (abs(t - exact), 1, 0),
        floor=lambda: floor_of(model, until),
    )


def bare(model, until, rtol):
    """As many steps of SciPy's DOP853 as the run makes, along the flow, and nothing else."""
    options = tolerances("scipy", rtol)
    run = hy.simulate(model, {"x": 2.1, "v": 0.0}, (0.0, until), save="jumps", **options)

    def flow(t, y):
        return (y[1], -math.cos(y[1]) - y[0] ** 3)

    def steps():
        solver = DOP853(flow, 0.0, [2.1, 0.0], 1e9, first_step=1e-2, **options)
        for _ in range(run.stats.steps):
            solver.step()
        return run.zeno[0].t

    return steps


def floor_of(model, until, rtol=1e-9):
    """Jets of the flights that are flown, and a zero each; what sums the rest is not in it."""
    start = {"x": 2.1, "v": 0.0}
    run = hy.simulate(model, start, (0.0, until), solver="taylor", save="jumps", rtol=rtol)
    steps = run.stats.steps
    one = floors.jet(model, list(start.values()), rtol)
    return [("jets before the sum", steps, one), ("zeros", steps, floors.root())]


# ---------------------------------------------------------------------------------------
# chatter, rest, release


def on_table(f, t, speed):
    """When a chattering on the table ends, and when the table falls away: for any tool."""
    r, w, g = THROWN["r"], THROWN["omega"], 9.8
    stick = t + 2 * speed / ((g - w * w * f.sin(w * t)) * (1 - r))
    angle, turn = math.asin(g / w**2), 2 * math.pi
    return stick, (angle + turn * f.ceil((w * stick - angle) / turn)) / w


def thrown(periods):
    """A bead that is thrown once a turn of its table, and chatters until it rests."""
    model, until = BeadOnTable(**THROWN), periods * PERIOD
    motion = Oscillator(
        force=falling, r=THROWN["r"], start=(1.5, 0.0), impacts=40 * periods, until=until,
        slow=SLOW, rest=on_table, **shaken(1.0, THROWN["omega"]),
    )  # fmt: skip
    exact = np.array([FIRST, *(SECOND + PERIOD * np.arange(periods - 1))])

    def ours(solver, rtol):
        options = {"solver": solver, "save": "jumps", **tolerances(solver, rtol)}
        start = {"x": 1.5, "v": 0.0}
        return lambda: hy.simulate(model, start, (0.0, until), **options).zeno

    def judge(found, rtol):
        if isinstance(found, np.ndarray):
            moves = motion.wall_speed(np, found[:, 0])
            times = found[found[:, 2] - moves < 0.5 * motion.slow, 0]
        else:
            times = np.array([point.t for point in found])
        same = len(times) == len(exact)
        return (np.abs(times - exact).max() if same else math.inf), periods, 0

    ways = {f"hybrid, {s}": lambda rtol, s=s: ours(s, rtol) for s in ("taylor", "scipy", "diffrax")}
    modules = "solve_ivp_restarts", "cvode_roots", "diffeqsolve_nested", "heyoka_events"
    return Task(
        title=f"Chatter, rest, release: {periods} turns of a table that throws",
        text=f"`{model}`: the times of all {periods} rests, against 40 digits. Peers are told when "
        "a rest ends, and add impacts slower than 1e-5 as a geometric series.",
        unit="a turn",
        wanted=1e-9,
        ways=ways | peers(dict.fromkeys([*modules, "numba_taylor"], motion)),
        judge=judge,
        floor=lambda: thrown_floor(model, until),
    )


def thrown_floor(model, until, rtol=1e-9):
    start = {"x": 1.5, "v": 0.0}
    run = hy.simulate(model, start, (0.0, until), solver="taylor", save="jumps", rtol=rtol)
    one = floors.jet(model, list(start.values()), rtol)
    return [
        ("jets of steps", run.stats.steps, one),
        ("zeros", len(run.jumps), floors.root()),
    ]
