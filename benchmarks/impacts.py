"""Impacts of a point over a wall, as many as a task asks for: hybrid beside the strongest peers.

    python benchmarks/impacts.py [ball example_1 table moon_holmes chaotic_table duffing]
                                 [--rtol 1e-9 ...] [--rounds 7]

Each tool makes the same impacts as its own idioms do best (``peers/``): ``solve_ivp`` and CVODE
begun anew at each, Diffrax nested in one compiled loop, heyoka with a callback, and Taylor's method
written out by hand in numba. The first call is timed alone; the others in turns, on one core, in
seconds of the process, of which the median counts; the ratio is that of ``hybrid, taylor``. Errors
are of the times of impacts, of the first ten or twenty where the motion is chaotic, against heyoka
in extended precision (without it: hybrid, to rounding). Whether an impact was lost is asked of each
flight on its own: flown again, to rounding, does it end earlier? Touches no deeper than the
tolerance are counted apart. Slow tools make fewer impacts. Ratios hold, milliseconds do not.
"""

from __future__ import annotations

import argparse
import importlib
import math
import statistics
import time

import attrs
import jax
import numpy as np

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.moon_holmes import MoonHolmes
from peers.oscillator import Oscillator

CHAOTIC, FEW = 10_000, 200

#: Impacts that are compared where the motion is chaotic: later ones say nothing.
COMPARED = {"chaotic_table": 10, "duffing": 20}


class Duffing(hy.Automaton):
    """x'' = -0.05 x' + x - x^3 + 4 cos t over a wall at -0.5."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -0.05 * s.v + s.x - s.x**3 + 4.0 * jax.numpy.cos(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x + 0.5, restitution=0.8)


def falling(f, t, x, v):
    return -9.8 + 0.0 * t


def shaken(amplitude, w):
    """A wall that shakes, its speed, and the rest of a task over it."""
    return {
        "wall": lambda f, t: amplitude * f.sin(w * t),
        "wall_speed": lambda f, t: amplitude * w * f.cos(w * t),
        "pull": 9.8 + amplitude * w**2,
        "by_hand": ("thrown", 9.8, amplitude, w),
    }


def beam(delta, gamma, w, floor):
    """Duffing's force, and the rest of a task under it."""

    def force(f, t, height, v):
        x = floor + height
        return -delta * v + x - x * x * x + gamma * f.cos(w * t)

    return {"force": force, "floor": floor, "by_hand": ("cubic", delta, gamma, w, floor)}


def spring(f, t, height, v):
    x = 2.0 + height
    return -f.cos(v) - x * x * x


TASKS = {
    "ball": (
        BouncingBall(g=9.8, r=0.95),
        Oscillator(falling, 0.95, (1.0, 0.0), 100, 9.8, ("thrown", 9.8, 0.0, 1.0)),
    ),
    "example_1": (
        HardSpring(r=0.8),
        Oscillator(
            spring, 0.8, (2.1 - 2.0, 0.0), 60, 10.0, ("hard spring", 2.0), floor=2.0
        ),
    ),
    "table": (
        BeadOnTable(),
        Oscillator(
            force=falling, r=0.9, start=(1.9, 0.0), impacts=80, begin=2 * math.pi / 0.29,
            **shaken(1.0, 0.29),
        ),
    ),
    "moon_holmes": (
        MoonHolmes(),
        Oscillator(r=0.9, start=(1.3 - 1.1, 0.0), impacts=80, pull=0.5, **beam(0.05, 0.05, 0.1,
        1.1)),
    ),
    "chaotic_table": (
        BeadOnTable(r=0.85, omega=7.0),
        Oscillator(
            force=falling, r=0.85, start=(5.0, 0.0), impacts=CHAOTIC, slow=1e-3, **shaken(1.0, 7.0)
        ),
    ),
    "duffing": (
        Duffing(),
        Oscillator(r=0.8, start=(1.0, 0.0), impacts=CHAOTIC, pull=6.0, **beam(0.05, 4.0, 1.0,
        -0.5)),
    ),
}  # fmt: skip

#: Rows of the table: a module of ``peers`` or a solver of ours, and whether it is slow.
PEERS = {
    "solve_ivp DOP853, begun anew": ("solve_ivp_restarts", True),
    "CVODE Adams, begun anew": ("cvode_roots", True),
    "diffeqsolve Tsit5, nested": ("diffeqsolve_nested", False),
    "heyoka, callback": ("heyoka_events", False),
    "numba, Taylor by hand": ("numba_taylor", False),
}
OURS = {"hybrid, scipy": ("scipy", True), "hybrid, diffrax": ("diffrax", True)}
FIRST = "hybrid, taylor"


def by_hybrid(solver, model, task, tolerance, impacts):
    """A call that makes the impacts."""
    start, until = {"x": task.floor + task.start[0], "v": 0.0}, (task.begin, task.until)
    options = {"solver": solver, "save": "jumps", "max_jumps": impacts, "rtol": tolerance}
    options |= {"zeno": "rest" if task.slow else "ignore"}

    def fly():
        jumps = hy.simulate(model, start, until, **options).jumps
        return np.column_stack([jumps.t, jumps.after.x - task.floor, jumps.after.v])

    return fly


def fliers(model, task, tolerance):
    """By name what each tool does, and the names of those that are not installed."""
    few = min(task.impacts, FEW)
    made = {FIRST: by_hybrid("taylor", model, task, tolerance, task.impacts)}
    for name, (solver, slow) in OURS.items():
        made[name] = by_hybrid(solver, model, task, tolerance, few if slow else task.impacts)
    missing = []
    for name, (module, slow) in PEERS.items():
        try:
            peer = importlib.import_module(f"peers.{module}")
        except ImportError as fault:
            missing.append(f"{name}: {fault.name} is not installed")
            continue
        made[name] = peer.prepare(task, tolerance, few if slow else task.impacts)
    return made, missing


def expected(model, task, count):
    """Times of the impacts that are compared."""
    steady = attrs.evolve(task, slow=0.0)
    try:
        from peers import heyoka_events
    except ImportError:
        return by_hybrid("taylor", model, steady, None, count)()[:, 0]
    return heyoka_events.prepare(steady, None, count, np.longdouble)()[:, 0]


def losses(task, rows, tolerance):
    """Impacts lost and touches passed, as text."""
    try:
        from peers import heyoka_events
    except ImportError:
        return "?"
    return "{}+{}".format(*heyoka_events.lost(task, rows, tolerance))


def timed(fly):
    begin = time.process_time()
    rows = fly()
    return time.process_time() - begin, rows


def table(name, tolerance, rounds):
    """Print one task at one tolerance."""
    model, task = TASKS[name]
    made, missing = fliers(model, task, tolerance)
    truth = expected(model, task, COMPARED.get(name, task.impacts))
    first, rows = {}, {}
    for tool, fly in made.items():
        first[tool], rows[tool] = timed(fly)
    rates = {tool: [] for tool in made}
    for _ in range(rounds):
        for tool, fly in made.items():
            seconds, _ = timed(fly)
            rates[tool].append(seconds / len(rows[tool]))
    print(f"\n{name}, {task.impacts} impacts, rtol {tolerance or 'to rounding'}")
    print(
        f"{'':30} {'impacts':>7} {'first, s':>8} {'impacts/s':>10} {'ratio':>8} {'error':>9} lost"
    )
    for tool in made:
        rate = statistics.median(rates[tool])
        ratio = statistics.median(np.divide(rates[FIRST], rates[tool]))
        error = np.abs(rows[tool][: len(truth), 0] - truth[: len(rows[tool])]).max()
        figures = f"{len(rows[tool]):7} {first[tool]:8.2f} {1 / rate:10.0f} {ratio:8.3f}"
        print(f"{tool:30} {figures} {error:9.1e} {losses(task, rows[tool], tolerance)}", flush=True)
    for line in missing:
        print(line)


def main():
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="*", default=[*TASKS], metavar="TASK")
    parser.add_argument("--rtol", nargs="+", default=["1e-9"], help="numbers, or 'least'")
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    for name in given.tasks or TASKS:
        for tolerance in given.rtol:
            table(name, None if tolerance == "least" else float(tolerance), given.rounds)


if __name__ == "__main__":
    main()
