"""Delayed feedback with impacts, by hybrid and by other ways; what a look-up in a long past costs.

    python benchmarks/delays.py

The Pyragas system ``x1'' = -x1^3 - cos x1' + C (x1(t - 1) - x1(t))`` above a wall at 2, the past
kept through the impacts. With ``C = -30`` the impacts accumulate before a lag has passed and the
bead rests for ever; with ``C = 60`` it sticks and is lifted again and again, and the kinks of each
chattering come back a lag later. Errors are the largest over the first impacts, the stick times and
the lift times, against 30 digits computed by two other methods.

``peers/`` has the others: a method of steps written for this system in numba, one around
``solve_ivp``, and JiTCDDE with jumps by hand. They know the wall and what a rest on it means; they
leave out the time at rest, which hybrid flies. Tolerances are those of a step (rtol = atol),
``first`` includes compilation. Ratios hold, milliseconds do not.
"""

from __future__ import annotations

import math
import timeit
from functools import cache, partial
from time import process_time

import jax
import jax.numpy as jnp
import numpy as np

import hybrid as hy
from models.pyragas import Pyragas
from peers import scipy_steps
from peers.pyragas import TAU, WALL, Case, Run

try:
    from peers import numba_steps
except ImportError:
    numba_steps = None

try:
    from peers import jitcdde_jumps
except ImportError:
    jitcdde_jumps = None

TOLERANCES, ROUNDS, ENOUGH = (1e-6, 1e-9), 7, 0.05

#: A run of the second table, which is repeated ten and a hundred times as long.
SHORT = 30.0

#: Cases, and what is known of them.
CASES = {
    Case(C=-30.0, r=0.6, x0=3.0, until=20.0): Run(
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
    Case(C=60.0, r=0.2, x0=2.5, until=20.0): Run(
        impacts=[],
        sticks=[2.4509407443760584503, 3.4891795178804350076, 4.5764099092186434596],
        lifts=[2.6595929927290970101, 3.8734418933157495811, 5.0778788827800776451],
    ),
}


# ---------------------------------------------------------------------------------------
# hybrid


def simulated(solver, case, tolerance):
    model = Pyragas(C=case.C, tau=TAU, r=case.r, wall=WALL)
    start = {"x1": case.x0, "x2": 0.0}
    options = {"history": start, "rtol": tolerance, "atol": tolerance, "save": "jumps"}
    run = hy.simulate(model, start, (0.0, case.until), solver=solver, **options)
    lifts = [point.t_release for point in run.zeno if point.t_release is not None]
    return Run(run.jumps.t, [point.t for point in run.zeno], lifts)


class Echo(hy.Automaton):
    """``y' = -y(t - pi / 2)``, which the cosine solves."""

    y = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return (-past(math.pi / 2).y,)


def echoed(solver, until):
    """The last value of a long run without a jump."""
    options = {"history": {"y": jnp.cos}, "rtol": 1e-8, "atol": 1e-8, "save": "jumps"}
    return hy.simulate(Echo(), {"y": 1.0}, (0.0, until), solver=solver, **options).final.y


# ---------------------------------------------------------------------------------------
# the peers


@cache
def jitcdde_solver(case):
    return jitcdde_jumps.compiled(case)


def jumped(case, tolerance):
    return jitcdde_jumps.solve(jitcdde_solver(case), case, tolerance)


def peers():
    """The functions of a case and a tolerance, by name."""
    yield "hybrid, taylor", partial(simulated, "taylor")
    yield "hybrid, diffrax", partial(simulated, "diffrax")
    yield "hybrid, scipy", partial(simulated, "scipy")
    if numba_steps:
        yield "numba, by hand, Dormand-Prince 5(4)", numba_steps.solve
    yield "solve_ivp, DOP853, method of steps", scipy_steps.solve
    if jitcdde_jumps:
        yield "JiTCDDE, Bogacki-Shampine, jumps", jumped


# ---------------------------------------------------------------------------------------
# tables


def first_and_best(function):
    """Seconds of a first call and of the fastest of some later calls, short ones repeated.

    They are the process's own, so that other work on the machine counts less.
    """
    first = timeit.timeit(function, number=1)
    number = 1 + int(ENOUGH / timeit.timeit(function, number=1))
    repeat = partial(timeit.repeat, timer=process_time, number=number, repeat=ROUNDS)
    return first, min(repeat(function)) / number


def error(found, expected):
    """Largest error of the times that are known; infinite if there are fewer of them."""
    if not expected:
        return "-"
    if len(found) < len(expected):
        return "inf"
    return f"{max(abs(a - b) for a, b in zip(found, expected, strict=False)):.1e}"


def impacts_table(case, expected):
    title = f"C = {case.C:g}, r = {case.r:g}, x1 = {case.x0:g}, to t = {case.until:g}"
    print(f"{title:38} {'tol.':>6} {'first, s':>8} {'ms':>8} {'ratio':>8}", end="")
    print(f" {'impacts':>7} {'error of 8':>10} {'of sticks':>9} {'of lifts':>9}")
    base = None
    for name, peer in peers():
        for tolerance in TOLERANCES:
            first, best = first_and_best(partial(peer, case, tolerance))
            run, base = peer(case, tolerance), base or best
            figures = f"{first:8.2f} {1e3 * best:8.2f} {best / base:8.3f} {len(run.impacts):7}"
            wrong = [error(*pair) for pair in zip(run, expected, strict=True)]
            errors = f"{wrong[0]:>10} {wrong[1]:>9} {wrong[2]:>9}"
            print(f"{name:38} {tolerance:6.0e} {figures} {errors}")
    print()


def look_up_table():
    """Cost of a unit of time early and late in a run: what is added from a run to a longer one."""
    spans = SHORT * np.array([1, 10, 100])
    title = "y' = -y(t - pi / 2), per unit of t"
    print(f"{title:38} {'early, us':>10} {'late, us':>10} {'ratio':>8} {'error at the end':>17}")
    for solver in ("taylor", "diffrax", "scipy"):
        seconds = [first_and_best(partial(echoed, solver, until))[1] for until in spans]
        early, late = np.diff(seconds) / np.diff(spans)
        wrong = abs(echoed(solver, spans[-1]) - math.cos(spans[-1]))
        print(f"{'hybrid, ' + solver:38} {1e6 * early:10.1f} {1e6 * late:10.1f}", end="")
        print(f" {late / early:8.2f} {wrong:17.1e}")


def main():
    jax.config.update("jax_enable_x64", True)
    for case, expected in CASES.items():
        impacts_table(case, expected)
    look_up_table()
    for module, name in ((numba_steps, "numba"), (jitcdde_jumps, "JiTCDDE")):
        if not module:
            print(f"{name} is not installed: its rows are left out")


if __name__ == "__main__":
    main()
