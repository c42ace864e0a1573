"""What jumps at given times cost beside as many jumps at zeros of a guard.

    python benchmarks/inputs.py

A decay is held against, towards a set point, by what it was at the last sample, 100,000 samples,
by Taylor series: once with a clock, once with a phase as a state of its own whose guard and reset
do the same. Each is run in turns, the first call apart. Ratios hold, milliseconds do not.
"""

from __future__ import annotations

import time

import hybrid as hy

PERIOD, SAMPLES, ROUNDS = 0.1, 100_000, 3


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


def main() -> None:
    starts = {"x": 1.0, "u": 0.0}
    each = {"clock": (Clocked(), starts), "phase": (Phased(), starts | {"phase": PERIOD})}
    best = dict.fromkeys(each, float("inf"))
    for turn in range(ROUNDS + 1):
        for name, given in each.items():
            begin = time.process_time()
            made = run(*given)
            spent = time.process_time() - begin
            assert len(made.jumps) == SAMPLES
            if turn:
                best[name] = min(best[name], spent)
    last = run(*each["clock"]).jumps.t[-1]
    print(f"a clock   {best['clock']:.3f} s, off by {last - SAMPLES * PERIOD:.1e} at the last")
    print(f"a phase   {best['phase']:.3f} s; {best['clock'] / best['phase']:.2f} of it by a clock")


if __name__ == "__main__":
    main()
