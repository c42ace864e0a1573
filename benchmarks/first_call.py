"""A user's first call: seconds to the first result of each model of the gallery, by solver.

Each is a process of its own: defining the class and its first run (tracing, reading, for
Diffrax compiling), then a second run of it with another tolerance. With
``--cache FOLDER`` JAX keeps compiled programs there; run it twice to see what that saves.

Run with ``python benchmarks/first_call.py``. Ratios hold, seconds do not.
"""

import argparse
import os
import subprocess
import sys

CHILD = """
import sys, time
import hybrid as hy
from hybrid import gallery
import jax, scipy.integrate, diffrax
name, solver = sys.argv[1:]
begun = time.perf_counter()
entry = gallery.find(name)
model = entry.cls()
made = time.perf_counter()
hy.simulate(model, entry.start, entry.until, history=entry.history, solver=solver, rtol=1e-9)
first = time.perf_counter()
hy.simulate(model, entry.start, entry.until, history=entry.history, solver=solver, rtol=1e-8)
last = time.perf_counter()
print(made - begun, first - made, last - first)
"""


def measure(name, solver, environment):
    """Seconds to define the class, of the first run, of the second."""
    command = [sys.executable, "-c", CHILD, name, solver]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return [float(value) for value in done.stdout.split()]


def main():
    """Print the table."""
    from hybrid import gallery

    parser = argparse.ArgumentParser()
    parser.add_argument("--cache", help="a folder for JAX's persistent cache")
    given = parser.parse_args()
    environment = dict(os.environ)
    if given.cache:
        environment["JAX_COMPILATION_CACHE_DIR"] = given.cache
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    print(f"{'model':16} {'solver':9} {'class':>7} {'first run':>10} {'second':>9}")
    for name in gallery.names():
        for solver in ("scipy", "diffrax"):
            made, first, second = measure(name, solver, environment)
            print(f"{name:16} {solver:9} {made:7.2f} {first:10.2f} {second:9.4f}")


if __name__ == "__main__":
    main()
