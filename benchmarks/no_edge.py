"""What the hybrid machinery costs a model without a single edge: Lorenz' system, solvers bare.

    python benchmarks/no_edge.py

The same method and tolerance with and without hybrid, from a first call (which compiles) and at
best later. Compiled functions are given arrays, so that later calls do not compile again. The
system is chaotic: unless both make the very same steps, the states part long before the end, so
they are compared at an earlier time too. Ratios hold, milliseconds do not.
"""

from __future__ import annotations

import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import hybrid as hy

START, PARAMETERS = (1.0, 1.0, 1.0), (10.0, 28.0, 8.0 / 3.0)
RTOL, ATOL, EARLY, UNTIL, ROUNDS = 1e-8, 1e-10, 5.0, 50.0, 7


def lorenz(x, y, z, sigma, rho, beta):
    return sigma * (y - x), x * (rho - z) - y, x * y - beta * z


class Lorenz(hy.Automaton):
    """Lorenz' system: one mode, no edge."""

    x = hy.state()
    y = hy.state()
    z = hy.state()

    sigma: float = hy.parameter(PARAMETERS[0])
    rho: float = hy.parameter(PARAMETERS[1])
    beta: float = hy.parameter(PARAMETERS[2])

    @hy.mode(initial=True)
    def flow(self, t, s):
        return lorenz(s.x, s.y, s.z, self.sigma, self.rho, self.beta)


def simulated(solver, method):
    """By hybrid: a function of the last time."""
    model = Lorenz()

    def run(until):
        options = {"solver": solver, "method": method, "rtol": RTOL, "atol": ATOL}
        return np.array(list(hy.simulate(model, START, (0, until), save="jumps", **options).final))

    return run


def diffrax_alone(rates=lorenz):
    @jax.jit
    def solve(until, start, parameters, rtol, atol):
        flow = diffrax.ODETerm(lambda t, y, p: jnp.stack(rates(*y, *p)))
        control = diffrax.PIDController(rtol=rtol, atol=atol)
        options = {"stepsize_controller": control, "max_steps": 1_000_000}
        ends, method = diffrax.SaveAt(t1=True), diffrax.Tsit5()
        arc = diffrax.diffeqsolve(
            flow, method, 0.0, until, None, start, parameters, saveat=ends, **options
        )
        return arc.ys[-1]

    asked = [np.array(value) for value in (START, PARAMETERS, RTOL, ATOL)]
    return lambda until: np.asarray(solve(np.array(until), *asked))


def scipy_alone(until):
    def flow(t, y):
        return lorenz(*y, *PARAMETERS)

    return solve_ivp(flow, (0, until), START, "RK45", rtol=RTOL, atol=ATOL).y[:, -1]


def timed(function):
    begin = time.perf_counter()
    function(UNTIL)
    return 1e3 * (time.perf_counter() - begin)


def compare(name, alone, by_hybrid):
    """Measure two in turns, so that a slow moment of the machine hits both, and print them."""
    first = timed(alone), timed(by_hybrid)
    pairs = [(timed(alone), timed(by_hybrid)) for _ in range(ROUNDS)]
    best = np.min(pairs, axis=0)
    differences = [np.abs(by_hybrid(t) - alone(t)).max() for t in (EARLY, UNTIL)]
    print(f"{name + ', alone':24} {first[0]:10.1f} {best[0]:9.2f} {1:7.2f}")
    figures = f"{first[1]:10.1f} {best[1]:9.2f} {best[1] / best[0]:7.2f}"
    print(f"{name + ', in hybrid':24} {figures} {differences[0]:10.1e} {differences[1]:10.1e}")


def main():
    jax.config.update("jax_enable_x64", True)
    diffrax_alone(lambda x, y, z, *_: (-x, -y, -z))(1.0)  # what only the first solve of all pays
    print(f"{'':24} {'first, ms':>10} {'best, ms':>9} {'ratio':>7}", end="")
    print(f" {f'apart at {EARLY:g}':>10} {f'at {UNTIL:g}':>10}")
    compare("Diffrax, Tsit5", diffrax_alone(), simulated("diffrax", "Tsit5"))
    compare("SciPy, RK45", scipy_alone, simulated("scipy", "RK45"))


if __name__ == "__main__":
    main()
