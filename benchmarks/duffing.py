"""Duffing's oscillator with a wall, chaotic, for ten thousand impacts: hybrid beside heyoka.

    python benchmarks/duffing.py            (needs heyoka: pip install hybrid-automata[peers])

Both by Taylor series, on one core. heyoka's event has no cooldown, in which it would swallow
impacts; its later runs use the machine code of the first, and so do those of hybrid. Seconds are of
the process, the least of several runs in turns. The error is that of the first twenty impacts,
against heyoka in extended precision. Whether an impact was lost is asked of each flight on its
own: flown again from where it began, by heyoka to rounding, does it end earlier? Touches no deeper
than the tolerance, which are reported as grazing, are counted apart.
"""

from __future__ import annotations

import argparse
import math
import time
from itertools import pairwise

import heyoka
import jax.numpy as jnp
import numpy as np

import hybrid as hy

DAMPING, FORCE, WALL, R, START = 0.05, 4.0, -0.5, 0.8, 0.5
IMPACTS, COMPARED, ROUNDS, UNTIL = 10_000, 20, 7, 1e6
TOLERANCES = (None, *(10.0**-k for k in range(13, 2, -1)))

#: A flight that is flown again ends at another time by what a step may lose, over the gap's speed
#: at its end; one that ends so much earlier has lost an impact.
EARLIER = 1e-2


class Duffing(hy.Automaton):
    """x'' = -0.05 x' + x - x^3 + 4 cos t over a wall."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -DAMPING * s.v + s.x - s.x**3 + FORCE * jnp.cos(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - WALL, restitution=R)


def by_hybrid(tolerance):
    """What makes the run: a call that returns times, positions and velocities after impacts."""
    model, start = Duffing(), {"x": START, "v": 0.0}
    options = {"solver": "taylor", "save": "jumps", "max_jumps": IMPACTS, "rtol": tolerance}

    def fly():
        jumps = hy.simulate(model, start, (0.0, UNTIL), **options).jumps
        return np.column_stack([jumps.t, jumps.after.x, jumps.after.v])

    return fly


def integrator(tolerance, impacts, real=float):
    """An integrator of heyoka's, the list of impacts that it fills, and how many are in it."""
    x, v = heyoka.make_vars("x", "v")
    flow = -DAMPING * v + x - x**3 + FORCE * heyoka.cos(heyoka.time)
    found, count = np.empty((impacts, 3), dtype=real), [0]

    def impact(ta, _):
        ta.state[1] *= -R
        found[count[0]] = ta.time, *ta.state
        count[0] += 1
        return count[0] < impacts

    wall = heyoka.t_event(
        x - WALL,
        callback=impact,
        direction=heyoka.event_direction.negative,
        cooldown=real(0.0),
        fp_type=real,
    )
    given = {} if tolerance is None else {"tol": real(tolerance)}
    state = np.array([START, 0.0], dtype=real)
    made = heyoka.taylor_adaptive(
        [(x, v), (v, flow)], state, t_events=[wall], fp_type=real, **given
    )
    return made, found, count


def by_heyoka(tolerance, impacts=IMPACTS, real=float):
    """As :func:`by_hybrid`."""
    made, found, count = integrator(tolerance, impacts, real)

    def fly():
        made.time, made.state[:], count[0] = real(0.0), (START, 0.0), 0
        made.reset_cooldowns()
        made.propagate_until(real(UNTIL))
        return found[: count[0]].copy()

    return fly


def depth(t, x, v):
    """How far beyond the wall a motion goes that touches it, from the state after the impact."""
    speed = -v / R
    return speed**2 / (2.0 * abs(-DAMPING * speed + x - x**3 + FORCE * math.cos(t)))


def lost(rows, tolerance):
    """Flights that end earlier when they are flown again, and those with an earlier touch."""
    made, found, count = integrator(None, 1)
    early = [0, 0]
    for (t, x, v), (end, *_) in pairwise(rows):
        made.time, made.state[:], count[0] = t, (x, v), 0
        made.reset_cooldowns()
        made.propagate_until(end + 1.0)
        if count[0] == 1 and found[0, 0] < end - EARLIER:
            early[int(depth(*found[0]) <= (tolerance or 0.0))] += 1
    return "{}+{}".format(*early)


def timed(fly):
    begin = time.process_time()
    rows = fly()
    return time.process_time() - begin, rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    rounds = parser.parse_args().rounds
    exact = by_heyoka(None, COMPARED, np.longdouble)()[:, 0]
    print(f"{'rtol':>7} {'hybrid, ms':>11} {'heyoka, ms':>11} {'ratio':>6}", end="")
    print(f" {'errors of twenty':>17} {'impacts':>8} {'lost+touches':>13}")
    for tolerance in TOLERANCES:
        pair = by_hybrid(tolerance), by_heyoka(tolerance)
        for fly in pair:
            fly()
        least, rows = [math.inf, math.inf], [None, None]
        for _ in range(rounds):
            for k, fly in enumerate(pair):
                seconds, rows[k] = timed(fly)
                least[k] = min(least[k], seconds)
        errors = [float(np.abs(made[:COMPARED, 0] - exact).max()) for made in rows]
        name = "least" if tolerance is None else f"{tolerance:.0e}"
        print(f"{name:>7} {1e3 * least[0]:11.0f} {1e3 * least[1]:11.0f}", end="")
        print(f" {least[0] / least[1]:6.2f} {errors[0]:8.0e} {errors[1]:8.0e}", end="")
        missed = [lost(made, tolerance) for made in rows]
        print(f" {len(rows[0]):8} {missed[0]:>6} {missed[1]:>6}", flush=True)


if __name__ == "__main__":
    main()
