"""What inputs cost: jumps at given times beside as many jumps at zeros of a guard; a road that is
measured beside one that is a formula.

    python benchmarks/inputs.py

A decay is held against, towards a set point, by what it was at the last sample, 100,000 samples,
by Taylor series: once with a clock, once with a phase as a state of its own whose guard and reset
do the same. A bead bounces on a road for 100 s, by Taylor series: once a sum of sines, once their
values at 100,000 times, joined by a spline; and once the formula by steps no longer than from one
of these times to the next. Each is run in turns, the first call apart. Ratios
hold, milliseconds do not.
"""

from __future__ import annotations

import time

import jax.numpy as jnp
import numpy as np

import hybrid as hy

PERIOD, SAMPLES, ROUNDS = 0.1, 100_000, 3
KNOTS, LAST = 100_000, 100.0


class Clocked(hy.Automaton):
    """Sampled by a clock."""

    x = hy.state()
    u = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s):
        return s.u - s.x, 0.0

    @hy.edge(flow, every=PERIOD)
    def sample(self, t, s):
        return s.x, 1.0 - 0.5 * s.x


class Phased(hy.Automaton):
    """Sampled where a phase, which is a state, is at its end."""

    x = hy.state()
    u = hy.state()
    phase = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s):
        return s.u - s.x, 0.0, -1.0

    @hy.edge(flow, guard=lambda self, t, s: s.phase)
    def sample(self, t, s):
        return s.x, 1.0 - 0.5 * s.x, PERIOD


def run(model, start):
    return hy.simulate(
        model, start, (0.0, (SAMPLES + 0.5) * PERIOD), solver="taylor", save="jumps", zeno="ignore"
    )


class OnFormula(hy.Automaton):
    """A bead on a road that is a formula."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.7)

    def road(self, t):
        return 0.02 * jnp.sin(9.0 * t) + 0.01 * jnp.sin(23.0 * t)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.81

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.road(t), restitution="r")


class Measured(OnFormula):
    """The same road at many times."""

    road = hy.signal(kind="cubic")


def measured():
    t = np.linspace(0.0, LAST, KNOTS + 1)
    return Measured(road=(t, 0.02 * np.sin(9.0 * t) + 0.01 * np.sin(23.0 * t)))


def ride(model, **options):
    return hy.simulate(
        model, {"x": 0.2, "v": 0.0}, (0.0, LAST), solver="taylor", save="jumps", **options
    )


def best_of(each, rounds=ROUNDS):
    """The least time of the process of some calls, made in turns, and what they return."""
    best, made = dict.fromkeys(each, float("inf")), {}
    for turn in range(rounds + 1):
        for name, call in each.items():
            begin = time.process_time()
            made[name] = call()
            if turn:
                best[name] = min(best[name], time.process_time() - begin)
    return best, made


def clocks() -> None:
    starts = {"x": 1.0, "u": 0.0}
    best, made = best_of(
        {
            "clock": lambda: run(Clocked(), starts),
            "phase": lambda: run(Phased(), starts | {"phase": PERIOD}),
        }
    )
    assert all(len(each.jumps) == SAMPLES for each in made.values())
    last = made["clock"].jumps.t[-1]
    print(f"a clock   {best['clock']:.3f} s, off by {last - SAMPLES * PERIOD:.1e} at the last")
    print(f"a phase   {best['phase']:.3f} s; {best['clock'] / best['phase']:.2f} of it by a clock")


def roads() -> None:
    spline = measured()
    best, made = best_of(
        {
            "formula": lambda: ride(OnFormula()),
            "short steps": lambda: ride(OnFormula(), max_step=LAST / KNOTS),
            "spline": lambda: ride(spline),
        }
    )
    for name, spent in best.items():
        own = made[name]
        print(
            f"{name:12s} {spent:8.3f} s, {own.stats.steps:7d} steps, {len(own.jumps):5d} impacts; "
            f"{spent / best['formula']:7.1f} times the formula, "
            f"{spent / best['short steps']:5.2f} times its short steps, "
            f"{1e6 * spent / KNOTS:.2f} microseconds a knot"
        )


def main() -> None:
    clocks()
    roads()


if __name__ == "__main__":
    main()
