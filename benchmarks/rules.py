"""What the rules cost: compiled once, loaded, called.

    python benchmarks/rules.py

Seconds to compile each unit, with what it calls, into an empty cache and to load it in another
process (from starting Python; and of that what numba's import takes); to compile what a run of any
solver needs, and all rules, with the time of processors beside that of the clock, as callees are
compiled beside each other; then microseconds a call, as machine code, as plain
Python, and of numpy's eigenvalue solver, with the largest error against the exact zeros.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from math import comb
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from hybrid.rules import load
from hybrid.rules.zeros import SPARE_ROWS

ROOT = Path(__file__).parent.parent

#: Zeros of the polynomials that are searched; the first degree is that of the steps of SciPy's
#: DOP853, the last that of Taylor series.
CASES = [
    ("none, far", 7, [-3.0, 4.0]),
    ("none, near", 12, [-0.01, 1.02]),
    ("one", 7, [0.3]),
    ("one", 16, [0.3]),
    ("three", 12, [0.2, 0.5, 0.7]),
    ("close pair", 12, [0.3, 0.300001, 0.8]),
    ("next to zero", 16, [1e-12, 0.7]),
]


def started(code, folder):
    """Seconds that a process takes."""
    begin = time.perf_counter()
    env = {**os.environ, "HYBRID_CACHE": folder, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], env=env, check=True, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begin


def processors():
    """Seconds that processors have spent for processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def cold(what, code):
    """Compile into an empty cache; say what that took."""
    spent = processors()
    with tempfile.TemporaryDirectory() as folder:
        clock = started(code, folder)
    print(f"{what}, cold: {clock:.1f} s, of processors {processors() - spent:.1f} s", flush=True)


def best(call, share=0.2):
    """Microseconds of a call: the least mean of five repeats."""
    count, spent = 1, 0.0
    while spent < share / 5:
        count, begin = 2 * count, time.perf_counter()
        for _ in range(count):
            call()
        spent = time.perf_counter() - begin
    return 1e6 * min([spent / count, *(repeated(call, count) for _ in range(4))])


def repeated(call, count):
    begin = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - begin) / count


def with_zeros(roots, degree):
    """Coefficients in powers and in Bernstein's form; what is not asked for lies at 3."""
    powers = np.polynomial.polynomial.polyfromroots([*roots, *[3.0] * (degree - len(roots))])
    rows = [
        [comb(i, k) / comb(degree, k) if k <= i else 0.0 for k in range(degree + 1)]
        for i in range(degree + 1)
    ]
    return powers, np.array(rows) @ powers


def eigenvalues(powers):
    found = np.polynomial.polynomial.polyroots(powers)
    real = np.sort(found.real[np.abs(found.imag) < 1e-9])
    return real[(real > 0) & (real <= 1)]


def error(found, roots):
    exact = [r for r in roots if 0 < r <= 1]
    if len(found) != len(exact):
        return f"{len(found)} of {len(exact)}"
    return f"{max(abs(np.array(found) - exact), default=0.0):.0e}"


def main():
    code = "from hybrid.rules import unit; unit({!r})"
    bare = min(started("import numba", ".") for _ in range(3))
    print(f"import numba: {bare:.2f} s")
    library = load.Library("hybrid.rules")
    for name in sorted(n for n, text in library.sources.items() if "__all__" in text):
        with tempfile.TemporaryDirectory() as folder:
            cold = started(code.format(name), folder)
            warm = min(started(code.format(name), folder) for _ in range(3))
        print(f"{name}: compiled in {cold:.1f} s, loaded in {warm:.2f} s")

    cold("zeros and jets", "from hybrid.rules import unit; unit('zeros'), unit('jets')")
    cold("everything", "from hybrid.rules import library; assert library.build()")

    rules = library.unit("zeros").crossings
    os.environ["HYBRID_RULES"] = "python"
    plain = load.Library("hybrid.rules").unit("zeros").crossings
    print(f"\n{'zeros':14} {'degree':>6} {'rules, us':>10} {'error':>8} {'plain':>8} {'numpy':>8}")
    for name, n, roots in CASES:
        powers, b = with_zeros(roots, n)
        work, found = np.empty((n + SPARE_ROWS, n + 5)), np.empty((2 * n + 4, 2))
        arguments = b, n, 0, 0.0, work, found
        off = error(found[: rules(*arguments), 0], roots)
        off_too = error(eigenvalues(powers), roots)
        times = [best(lambda r=r, a=arguments: r(*a)) for r in (rules, plain)]
        times.append(best(lambda c=powers: eigenvalues(c)))
        print(
            f"{name:14} {n:6} {times[0]:10.2f} {off:>8} {times[1]:8.0f} {times[2]:8.0f} {off_too}"
        )


if __name__ == "__main__":
    main()
