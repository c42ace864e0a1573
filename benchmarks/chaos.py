"""A bead thrown about by a shaking table, for ten thousand impacts, by hybrid and by other ways.

    python benchmarks/chaos.py

The flight between impacts is a parabola, so all the work is in finding the first zero of a gap that
is no polynomial. The motion is chaotic: only the first impacts can be compared, and the error is
that of the first ten, against ``solver="taylor"`` to rounding. Whether impacts were lost later on
is asked of each flight on its own: from where it began, is there an earlier zero of the exact gap?
(At 1e-3 some are: touches no deeper than the tolerance, which are listed as such.) Slow peers make
fewer impacts. The peers know no rest: where impacts accumulate they drop the bead anew; hybrid lets
it rest and be thrown off. Ratios hold, milliseconds do not.
"""

from __future__ import annotations

import math
import time
from functools import partial
from itertools import pairwise

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

import hybrid as hy
from hybrid.lowering import automaton, native
from hybrid.lowering.scene import scene_of
from models.bead_on_table import BeadOnTable

try:
    import numba
except ImportError:
    numba = None

G, R, AMPLITUDE, OMEGA, HEIGHT = 9.8, 0.85, 1.0, 7.0, 5.0
TOLERANCE, IMPACTS, BLOCK, COMPARED, ROUNDS, UNTIL = 1e-9, 10_000, 500, 10, 3, 60_000.0

#: No acceleration of the gap is greater: a flight that begins with gap speed w lasts 2 w / LARGEST.
LARGEST = G + AMPLITUDE * OMEGA**2

#: Longest step of a solver that looks for events at the ends of its steps.
LONGEST = 0.1

#: Impacts that part more slowly accumulate.
SLOW = 1e-3


def compiled(function):
    """Compiled by numba, if there is numba."""
    return numba.njit(function) if numba else function


@compiled
def table(t):
    return AMPLITUDE * math.sin(OMEGA * t)


@compiled
def table_speed(t):
    return AMPLITUDE * OMEGA * math.cos(OMEGA * t)


@compiled
def rebound(t, v):
    """Position and velocity after an impact, and the gap speed."""
    speed = R * (table_speed(t) - v)
    if speed < SLOW:
        return HEIGHT, 0.0, 1.0
    return table(t), table_speed(t) + speed, speed


# ---------------------------------------------------------------------------------------
# by hand: an exact flight, and steps too short to pass a zero


@compiled
def flight(t, x, v):
    """Duration of a flight: the gap's acceleration is bounded, so each step can reach no zero."""
    own, gap, speed = 0.0, x - table(t), v - table_speed(t)
    for _ in range(10_000):
        root = math.sqrt(speed * speed + 2 * LARGEST * max(gap, 0.0))
        step = (speed + root) / LARGEST if speed > 0 else 2 * gap / (root - speed)
        own += step
        gap = x + own * (v - 0.5 * G * own) - table(t + own)
        speed = v - G * own - table_speed(t + own)
        if gap <= 0.0 or step < 1e-14:
            break
    return own


@compiled
def by_hand(impacts):
    """Time, and position and velocity after it, of each impact."""
    rows, t, x, v = np.empty((impacts, 3)), 0.0, HEIGHT, 0.0
    for k in range(impacts):
        own = flight(t, x, v)
        t += own
        x, v, _ = rebound(t, v - G * own)
        rows[k] = t, x, v
    return rows


# ---------------------------------------------------------------------------------------
# SciPy: a restart loop


def gap(t, y):
    return y[0] - table(t)


gap.terminal, gap.direction = True, -1


def restarted(impacts):
    rows, t, y, first = np.empty((impacts, 3)), 0.0, (HEIGHT, 0.0), 1e-3
    options = {"events": gap, "rtol": TOLERANCE, "atol": TOLERANCE, "max_step": LONGEST}
    for k in range(impacts):
        arc = solve_ivp(
            lambda t, y: (y[1], -G), (t, t + 1000), y, "DOP853", first_step=first, **options
        )
        t = arc.t_events[0][0]
        *y, speed = rebound(t, arc.y_events[0][0][1])
        first, rows[k] = min(LONGEST, speed / LARGEST), (t, *y)
    return rows


# ---------------------------------------------------------------------------------------
# Diffrax: a solve with an event for each flight, a block of flights compiled


@jax.jit
def block(carry):
    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([y[1], -G + 0.0 * t]))
    options = {
        "event": diffrax.Event(
            lambda t, y, *_, **__: y[0] - AMPLITUDE * jnp.sin(OMEGA * t),
            optimistix.Newton(rtol=1e-12, atol=1e-9),
            direction=False,
        ),
        "stepsize_controller": diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE, dtmax=LONGEST),
        "adjoint": diffrax.ForwardMode(),
        "throw": False,
    }

    def impact(carry, _):
        t, y, first = carry
        arc = diffrax.diffeqsolve(term, diffrax.Tsit5(), t, t + 1000, first, y, **options)
        t = arc.ts[-1]
        rate = AMPLITUDE * OMEGA * jnp.cos(OMEGA * t)
        speed = R * (rate - arc.ys[-1, 1])
        after = jnp.stack([AMPLITUDE * jnp.sin(OMEGA * t), rate + speed])
        y = jnp.where(speed < SLOW, jnp.array([HEIGHT, 0.0]), after)
        first = jnp.where(speed < SLOW, 1e-3, jnp.minimum(LONGEST, speed / LARGEST))
        return (t, y, first), jnp.concatenate([t[None], y])

    return jax.lax.scan(impact, carry, None, length=BLOCK)


def in_blocks(impacts):
    carry, rows = (jnp.array(0.0), jnp.array([HEIGHT, 0.0]), jnp.array(1e-3)), []
    for _ in range(-(-impacts // BLOCK)):
        carry, found = block(carry)
        rows.append(np.asarray(found))
    return np.concatenate(rows)[:impacts]


# ---------------------------------------------------------------------------------------
# hybrid


MODEL = BeadOnTable(g=G, r=R, amplitude=AMPLITUDE, omega=OMEGA)


def simulated(solver, method, impacts, tolerance=TOLERANCE):
    options = {"solver": solver, "method": method, "rtol": tolerance, "atol": tolerance}
    start = {"x": HEIGHT, "v": 0.0}
    return hy.simulate(MODEL, start, (0, UNTIL), max_jumps=impacts, save="jumps", **options)


def by_taylor(coded, impacts, tolerance=TOLERANCE):
    """With the model's own machine code from the start, or never."""
    automaton.HOT_STEPS = math.inf
    simulated("taylor", None, 1)
    programs = scene_of(MODEL).tables.automaton.programs
    native.compile_all(programs)
    if not coded:
        programs.code[:] = 0
    return simulated("taylor", None, impacts, tolerance)


# ---------------------------------------------------------------------------------------
# the table


def rows_of(result):
    """Time, and position and velocity after it, of each jump."""
    if isinstance(result, np.ndarray):
        return result
    jumps = result.jumps
    return np.stack([jumps.t, jumps.after.x, jumps.after.v], axis=1)


def made(result):
    """Impacts computed."""
    return len(result if isinstance(result, np.ndarray) else result.own_jumps)


def lost(rows):
    """Flights whose exact gap has an earlier zero, those too slow to tell left out."""
    count, rows = 0, [(0.0, HEIGHT, 0.0), *rows]
    for (t, x, v), (end, *_) in pairwise(rows):
        if x - table(t) > 1e-9 or v - table_speed(t) > SLOW:
            count += t + flight(t, x, v) < end - 1e-3
    return count


def timed(function, impacts):
    begin = time.perf_counter()
    result = function(impacts)
    return time.perf_counter() - begin, result


def in_turns(peers):
    """First and best later seconds of each, in turns: a slow moment of the machine hits all."""
    first = [timed(*peer)[0] for peer in peers]
    return first, np.min([[timed(*peer)[0] for peer in peers] for _ in range(ROUNDS)], axis=0)


def main():
    jax.config.update("jax_enable_x64", True)
    peers = {
        "hybrid, diffrax, Tsit5": (partial(simulated, "diffrax", "Tsit5"), IMPACTS // 10),
        "hybrid, diffrax, Dopri8": (partial(simulated, "diffrax", "Dopri8"), IMPACTS // 10),
        "hybrid, taylor": (partial(by_taylor, False), IMPACTS),
        "hybrid, taylor, machine code": (partial(by_taylor, True), IMPACTS),
        **{
            f"hybrid, taylor, machine code, {tolerance or 'exact'}": (
                partial(by_taylor, True, tolerance=tolerance),
                IMPACTS,
            )
            for tolerance in (1e-3, 1e-6, 1e-12, None)
        },
        "hybrid, scipy, DOP853": (partial(simulated, "scipy", "DOP853"), IMPACTS // 10),
        "solve_ivp, DOP853, restart loop": (restarted, IMPACTS // 50),
        "Diffrax, Tsit5, a solve a flight": (in_blocks, IMPACTS),
        "numba, by hand, exact flight": (by_hand, IMPACTS),
    }
    if not numba:
        del peers["numba, by hand, exact flight"]
    expected = simulated("taylor", None, COMPARED, tolerance=None).jumps.t[:COMPARED]
    first, best = in_turns(peers.values())
    results = [function(impacts) for function, impacts in peers.values()]
    rates = [made(result) / seconds for result, seconds in zip(results, best, strict=True)]
    print(f"{'':36} {'impacts':>7} {'first, s':>8} {'impacts/s':>10} {'ratio':>8}", end="")
    print(f" {'error of ten':>14} {'lost':>5}")
    for k, name in enumerate(peers):
        rows = rows_of(results[k])
        error = np.abs(rows[:COMPARED, 0] - expected).max()
        figures = (
            f"{made(results[k]):7} {first[k]:8.1f} {rates[k]:10.0f} {rates[k] / rates[0]:8.3f}"
        )
        print(f"{name:36} {figures} {error:14.1e} {lost(rows):5}")
    if not numba:
        print("numba is not installed: its row is left out")


if __name__ == "__main__":
    main()
