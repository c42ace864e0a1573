"""How the cost of a run grows: with impacts, states, modes, contacts, lags and lanes.

    python benchmarks/growth.py [impacts] [states] [modes] [contacts] [lags] [lanes]

Each size is run in turns with the others, by Taylor series at 1e-9: seconds of the process, the
least of several. The first run of a size, of which tracing is a part, is timed alone. A slope is
that of the line through the logarithms of the larger half of the sizes: at one, twice as much costs
twice as much. The bytes are what is kept of a jump. Slopes hold, milliseconds do not.
"""

from __future__ import annotations

import argparse
import gc
import math
import time
import tracemalloc

import jax.numpy as jnp
import numpy as np

import hybrid as hy
from tasks.impacts import Duffing

ROUNDS = 5

#: What is asked of the slopes.
ASKED = {"impacts": 1.05, "states": 1.2, "modes": 1.1, "contacts": 3.0}


def impacts(count):
    """So many chaotic impacts."""
    options = {"solver": "taylor", "save": "jumps", "max_jumps": count, "rtol": 1e-9}
    return lambda: hy.simulate(Duffing(), {"x": 0.5, "v": 0.0}, (0.0, 1e7), **options)


def states(count):
    """A chain of springs of so many states; its first mass strikes a wall."""

    def flow(self, t, s):
        q = jnp.pad(s.q, 1)
        return s.v, 2.0 * (q[2:] - 2.0 * q[1:-1] + q[:-2]) - s.q**3 - 0.1

    half = count // 2
    mode = hy.mode(flow)
    body = {"q": hy.state(shape=(half,)), "v": hy.state(shape=(half,)), "flow": mode}
    body["wall"] = hy.contact("flow", gap=lambda self, t, s: s.q[0] + 0.2, restitution=0.9)
    model = type("Chain", (hy.Automaton,), body)()
    start = {"q": 0.3 * np.cos(np.arange(half)), "v": np.zeros(half)}
    return lambda: hy.simulate(model, start, (0.0, 10.0), solver="taylor", save="jumps", rtol=1e-9)


def modes(count):
    """A clock that goes through so many modes, four jumps in each."""

    def flow(level):
        return lambda self, t, s: (level - s.x, 1.0)

    def guard(end):
        return lambda self, t, s: end - s.c

    body = {"x": hy.state(), "c": hy.state()}
    for i in range(count):
        body[f"m{i}"] = hy.mode(initial=i == 0)(flow(float(i % 3)))
    for i in range(count):
        end = 0.0 if i == count - 1 else 1.0
        edge = hy.edge(f"m{i}", to=f"m{(i + 1) % count}", guard=guard(i + 1.0))
        body[f"e{i}"] = edge(lambda self, t, s, end=end: s.replace(c=s.c * end))
    model = type("Rounds", (hy.Automaton,), body)()
    span = (0.0, 4.0 * count)
    return lambda: hy.simulate(model, [1.0, 0.0], span, solver="taylor", save="jumps", rtol=1e-9)


def contacts(count):
    """So many beads in a column over a floor, for a second."""

    def gap(i):
        return lambda self, t, s: s.q[i] - s.q[i - 1] if i else s.q[0]

    body = {"q": hy.state(shape=(count,)), "v": hy.state(shape=(count,))}
    body["falls"] = hy.mode(lambda self, t, s: (s.v, -9.81 + 0.0 * s.q))
    for i in range(count):
        body[f"c{i}"] = hy.contact("falls", gap=gap(i), restitution=0.9)
    model = type("Column", (hy.Automaton,), body)()
    start = {"q": 1.0 + np.arange(count), "v": np.zeros(count)}
    return lambda: hy.simulate(model, start, (0.0, 1.0), solver="taylor", save="jumps", rtol=1e-9)


def lags(count):
    """Feedback from so many moments of the past."""

    def flow(self, t, s, past):
        return -sum(past((k + 1.0) / count).y for k in range(count)) / count

    body = {"y": hy.state(), "flow": hy.mode(flow)}
    model, options = type("Lagged", (hy.Automaton,), body)(), {"history": {"y": 1.0}, "rtol": 1e-9}
    return lambda: hy.simulate(model, {"y": 1.0}, (0.0, 5.0), solver="taylor", **options)


def lanes(count):
    """So many lanes of forty impacts."""
    start, options = {"x": np.linspace(0.2, 0.8, count), "v": 0.0}, {"max_jumps": 40, "rtol": 1e-9}
    return lambda: hy.ensemble(Duffing(), start, (0.0, 1e4), **options)


TASKS = {
    impacts: (100, 1_000, 10_000, 100_000),
    states: (2, 8, 32, 128, 200),
    modes: (2, 8, 32, 128, 200),
    contacts: (1, 4, 8, 16, 32, 50),
    lags: (1, 4, 8, 16),
    lanes: (10, 100, 1_000, 10_000),
}


def seconds(call):
    """Seconds of the process that a call takes."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def slope(sizes, values):
    """Of the line through the logarithms of the larger half."""
    half = len(sizes) // 2
    return np.polyfit(np.log(sizes[half:]), np.log(values[half:]), 1)[0]


def bytes_per_jump(count):
    """What a run keeps of each jump."""
    gc.collect()
    tracemalloc.start()
    run = impacts(count)()
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return size / len(run.jumps)


def table(task):
    """Print one task."""
    sizes, name = TASKS[task], task.__name__
    calls = [task(size) for size in sizes]
    first, least = [seconds(call) for call in calls], [math.inf] * len(sizes)
    for _ in range(ROUNDS):
        least = [min(a, seconds(call)) for a, call in zip(least, calls, strict=True)]
    print(f"\n{name:10} {'first, s':>10} {'ms':>10}")
    for row in zip(sizes, first, least, strict=True):
        print(f"{row[0]:<10} {row[1]:10.2f} {1e3 * row[2]:10.2f}")
    asked = f" (asked {ASKED[name]})" if name in ASKED else ""
    print(f"slope {slope(sizes, least):.2f}, of the first run {slope(sizes, first):.2f}{asked}")
    if task is impacts:
        print(f"bytes kept of a jump: {bytes_per_jump(sizes[-1]):.0f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [task.__name__ for task in TASKS]
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(names))
    given = parser.parse_args().tasks or names
    for task in TASKS:
        if task.__name__ in given:
            table(task)


if __name__ == "__main__":
    main()
