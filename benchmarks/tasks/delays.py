"""Pyragas control over a wall, the past kept through the impacts, on [0, 20].

With ``C = -30`` the impacts accumulate before a lag has passed and the bead rests for ever; with
``C = 60`` it sticks and is lifted again and again, and the kinks of each chattering come back a lag
later. The peers know the wall and what a rest on it means, and leave out the time at rest.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import import_module

import floors
import hybrid as hy
from measure import Task
from models.hard_spring import HardSpring
from models.pyragas import Pyragas
from peers.pyragas import TAU, WALL, Case, Run
from tasks import tolerances

#: Cases, and what is known of them (30 digits, by two methods).
CASES = {
    "pyragas": (
        Case(C=-30.0, r=0.6, x0=3.0, until=20.0),
        Run(
            impacts=[
                0.26703257965945121873,
                0.54479232816045306409,
                0.69982771450556693429,
                0.78965115355383002525,
                0.84277850312174012984,
                0.87448304715764172822,
                0.89346816078230297079,
                0.90485106648861701117,
            ],
            sticks=[0.92191979269597509266],
            lifts=[],
        ),
    ),
    "pyragas_lifted": (
        Case(C=60.0, r=0.2, x0=2.5, until=20.0),
        Run(
            impacts=[],
            sticks=[2.4509407443760584503, 3.4891795178804350076, 4.5764099092186434596],
            lifts=[2.6595929927290970101, 3.8734418933157495811, 5.0778788827800776451],
        ),
    ),
}

#: Peers, by their modules.
PEERS = {
    "numba, method of steps by hand": "numba_steps",
    "solve_ivp DOP853, method of steps": "scipy_steps",
    "JiTCDDE, jumps by hand": "jitcdde_jumps",
}


def simulated(case, solver, rtol):
    """A call of this package."""
    model, start = Pyragas(C=case.C, tau=TAU, r=case.r, wall=WALL), {"x1": case.x0, "x2": 0.0}
    options = {"history": start, "save": "jumps", "solver": solver, **tolerances(solver, rtol)}

    def fly():
        run = hy.simulate(model, start, (0.0, case.until), **options)
        lifts = [point.t_release for point in run.zeno if point.t_release is not None]
        return Run(run.jumps.t, [point.t for point in run.zeno], lifts)

    return fly


@cache
def jitcdde_solver(case):
    return import_module("peers.jitcdde_jumps").compiled(case)


def peer(case, module, rtol):
    """A call of a peer."""
    given = {"numba_steps": 1e-14, "scipy_steps": 1e-13, "jitcdde_jumps": 1e-11}
    peer, rtol = import_module(f"peers.{module}"), rtol or given[module]
    if module == "jitcdde_jumps":
        return lambda: peer.solve(jitcdde_solver(case), case, rtol)
    return lambda: peer.solve(case, rtol)


def task(name, quick):
    case, known = CASES[name]

    def judge(run, rtol):
        off = [0.0]
        for found, expected in zip(run, known, strict=True):
            if len(found) < len(expected):
                return math.inf, 1, 0
            off += [abs(a - b) for a, b in zip(found, expected, strict=False)]
        return max(off), 1, 0

    ways = {
        f"hybrid, {solver}": lambda rtol, s=solver: simulated(case, s, rtol)
        for solver in ("taylor", "scipy", "diffrax")
    }
    for who, module in PEERS.items():
        ways[who] = lambda rtol, m=module: peer(case, m, rtol)
    return Task(
        title=f"Pyragas control with C = {case.C:g} on [0, {case.until:g}]",
        text=f"`Pyragas(C={case.C:g}, r={case.r:g})`: the first impacts, the rests and the "
        "releases that are known to 30 digits.",
        unit="a run",
        wanted=1e-7,
        ways=ways,
        judge=judge,
        tolerances=(1e-6, 1e-9),
        floor=lambda: floor_of(case),
    )


def floor_of(case, rtol=1e-6):
    """Jets of the flow without its past, and a zero for each impact; not what reads the past."""
    start, model = {"x1": case.x0, "x2": 0.0}, Pyragas(C=case.C, tau=TAU, r=case.r, wall=WALL)
    options = {"solver": "taylor", "save": "jumps", "rtol": rtol, "history": start}
    run = hy.simulate(model, start, (0.0, case.until), **options)
    one = floors.jet(HardSpring(), [2.1, 0.0], rtol)
    return [("jets", run.stats.evaluations, one), ("zeros", run.stats.steps, floors.root())]
