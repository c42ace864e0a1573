"""Impacts of a point over a wall, as many as a task asks for.

Errors are of the times of impacts, of the first five or twenty where the motion is chaotic, against
heyoka in extended precision (without it: this package, to rounding). Whether an impact was lost is
asked of each flight of a chaotic motion on its own: flown again, to rounding, does it end earlier?
"""

from __future__ import annotations

import math
from functools import cache

import attrs
import jax.numpy as jnp
import numpy as np

import floors
import hybrid as hy
from measure import Task
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.moon_holmes import MoonHolmes
from peers.oscillator import Oscillator
from tasks import peers, tolerances

CHAOTIC, SOME, FEW = 10_000, 1_000, 100

#: Impacts that are compared where the motion is chaotic: later ones say nothing.
COMPARED = {"chaotic_table": 5, "duffing": 20}

#: Tolerances of what is chaotic: between two of the usual ones an error asked for may lie.
FINER = 1e-6, 1e-9, 1e-12, 1e-13, None

#: What flies as many impacts as are asked for; the others fly a few.
FAST = ("heyoka_events", "numba_taylor", "taylor")


class Duffing(hy.Automaton):
    """x'' = -0.05 x' + x - x^3 + 4 cos t over a wall at -0.5."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -0.05 * s.v + s.x - s.x**3 + 4.0 * jnp.cos(t)

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


def example_1(r, impacts):
    """Example 1 of the paper for any tool."""
    by_hand = "hard spring", 2.0
    return Oscillator(spring, r, (2.1 - 2.0, 0.0), impacts, 10.0, by_hand, floor=2.0)


#: Models, and the same motion for the peers.
MOTIONS = {
    "ball": (
        BouncingBall(g=9.8, r=0.95),
        Oscillator(falling, 0.95, (1.0, 0.0), 100, 9.8, ("thrown", 9.8, 0.0, 1.0)),
    ),
    "example_1": (HardSpring(r=0.8), example_1(0.8, 60)),
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

TITLES = {
    "ball": "A ball, 100 impacts",
    "example_1": "Example 1, 60 impacts",
    "table": "A bead on a table, 80 impacts",
    "moon_holmes": "A beam over an obstacle, 80 impacts",
    "chaotic_table": "A table that throws, chaotic, 10,000 impacts",
    "duffing": "Duffing's oscillator over a wall, chaotic, 10,000 impacts",
}


def by_hybrid(solver, model, motion, rtol):
    """A call that makes the impacts."""
    start = {"x": motion.floor + motion.start[0], "v": 0.0}
    options = {"solver": solver, "save": "jumps", **tolerances(solver, rtol)}
    options |= {"max_jumps": motion.impacts, "zeno": "rest" if motion.slow else "ignore"}

    def fly():
        jumps = hy.simulate(model, start, (motion.begin, motion.until), **options).jumps
        return np.column_stack([jumps.t, jumps.after.x - motion.floor, jumps.after.v])

    return fly


def ours(model, motions):
    """Ways of this package, by what each is to fly."""
    return {
        f"hybrid, {solver}": lambda rtol, s=solver: by_hybrid(s, model, motions[s], rtol)
        for solver in ("taylor", "scipy", "diffrax")
    }


def expected(model, motion, count):
    """Times of the impacts that are compared."""
    steady = attrs.evolve(motion, slow=0.0, impacts=count)
    try:
        from peers import heyoka_events
    except ImportError:
        return by_hybrid("taylor", model, steady, None)()[:, 0]
    return heyoka_events.prepare(steady, None, np.longdouble)()[:, 0]


def lost(motion, rows, rtol):
    """Impacts lost; 0 where heyoka is missing."""
    try:
        from peers import heyoka_events
    except ImportError:
        return 0
    return heyoka_events.lost(motion, rows, rtol)[0]


def floor_of(model, motion, rtol=1e-9):
    """Jets and zeros of a run."""
    start = {"x": motion.floor + motion.start[0], "v": 0.0}
    options = {"solver": "taylor", "save": "jumps", "rtol": rtol, "max_jumps": motion.impacts}
    zeno = "rest" if motion.slow else "ignore"
    run = hy.simulate(model, start, (motion.begin, motion.until), zeno=zeno, **options)
    one = floors.jet(model, list(start.values()), rtol)
    return [("jets", run.stats.steps, one), ("zeros", len(run.jumps), floors.root())]


def task(name, quick):
    """One of ``MOTIONS``."""
    model, motion = MOTIONS[name]
    chaotic = name in COMPARED
    whole = attrs.evolve(motion, impacts=300) if quick and chaotic else motion
    few = attrs.evolve(whole, impacts=min(whole.impacts, FEW))
    modules = "solve_ivp_restarts", "cvode_roots", "diffeqsolve_nested", "scipy", "diffrax", *FAST
    motions = {module: whole if module in FAST else few for module in modules}
    some = attrs.evolve(whole, impacts=min(whole.impacts, SOME))
    motions["diffeqsolve_nested"] = some
    truth = cache(lambda: expected(model, motion, COMPARED.get(name, motion.impacts)))

    def judge(rows, rtol):
        asked = min(len(truth()), COMPARED.get(name, few.impacts))
        if len(rows) < asked:
            return math.inf, len(rows), 0
        error = np.abs(rows[:asked, 0] - truth()[:asked]).max()
        return error, len(rows), lost(motion, rows, rtol) if chaotic else 0

    return Task(
        title=TITLES[name],
        text=f"`{model}`: the times of {f'the first {COMPARED[name]}' if chaotic else 'all'} "
        "impacts, against heyoka in extended precision.",
        unit="an impact",
        wanted=1e-10 if chaotic else 1e-9,
        ways=ours(model, motions) | peers(motions),
        judge=judge,
        **({"tolerances": FINER} if chaotic else {}),
        floor=lambda: floor_of(model, whole),
    )
