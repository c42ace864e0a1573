"""Sliding, stiffness, many states and walls, and no edge at all."""

from __future__ import annotations

import math
import time
from functools import cache, partial
from importlib import import_module

import jax.numpy as jnp
import numpy as np

import floors
import hybrid as hy
from measure import Task
from models.relay import Relay
from peers.oscillator import Bodies
from tasks import peers, tolerances


def task(name, quick):
    return {"relay": relay, "stiff": stiff, "chain": chain, "no_edge": no_edge}[name](quick)


# ---------------------------------------------------------------------------------------
# a relay that slides

#: The first hit and the second, with 40 digits; each later one is half a turn after the one before.
HITS = 1.7559435423403977145, 3.0678984063534199853
TURNS = 50


def relay(quick):
    """A forced relay: twice a turn it slides, and is left."""
    a, w, half = 1.3, 2.0, math.pi / 2.0
    until = 12.0 if quick else TURNS * 2 * half
    leaves = (math.pi + math.asin(1 / a)) / w + half * np.arange(4 * TURNS)
    hits = np.array([HITS[0], *(HITS[1] + half * np.arange(4 * TURNS - 1))])
    exact = np.column_stack([hits, leaves]).ravel()
    exact = exact[exact < until]

    def ours(solver, rtol):
        options = {"solver": solver, "save": "jumps", **tolerances(solver, rtol)}
        return lambda: hy.simulate(Relay(a=a, w=w), {"x": 0.5}, (0.0, until), **options).jumps.t

    def peer(function, finest, rtol):
        made = getattr(import_module("peers.relays"), function)
        return made(a, w, 0.5, until, finest if rtol is None else rtol)

    def judge(times, rtol):
        same = len(times) == len(exact)
        return (np.abs(times - exact).max() if same else math.inf), len(exact), 0

    ways = {f"hybrid, {s}": partial(ours, s) for s in ("taylor", "scipy", "diffrax")}
    ways |= {
        "solve_ivp DOP853, three flows": partial(peer, "by_solve_ivp", 1e-13),
        "CVODE Adams, three flows": partial(peer, "by_cvode", 1e-14),
        "heyoka, three integrators": partial(peer, "by_heyoka", None),
    }
    return Task(
        title=f"A relay that slides, to t = {until:.4g}",
        text=f"`Relay()`: the times of all {len(exact)} hits and ends of sliding, against 40 "
        "digits. Peers are told what slides, and when it ends.",
        unit="a change",
        wanted=1e-9,
        ways=ways,
        judge=judge,
        floor=lambda: floor_of(Relay(a=a, w=w), {"x": 0.5}, until),
    )


def floor_of(model, start, until, rtol=1e-9):
    """Jets and zeros of a run by Taylor series."""
    options = {"solver": "taylor", "save": "jumps", "rtol": rtol}
    run = hy.simulate(model, start, (0.0, until), **options)
    size = np.concatenate([np.ravel(value) for value in start.values()])
    one = floors.jet(model, size, rtol)
    return [("jets", run.stats.steps, one), ("zeros", len(run.jumps), floors.root())]


# ---------------------------------------------------------------------------------------
# a stiff impact oscillator

RATE, SHORT = 1e6, 10.0


class Stiff(hy.Automaton):
    """An oscillator over a wall, pushed by a force that follows its demand within a microsecond."""

    x = hy.state()
    v = hy.state()
    f = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, s.f - s.x - 0.1 * s.v, RATE * (jnp.cos(1.7 * t) - 0.3 * s.x - s.f - s.f**3)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x + 0.5, restitution=0.8)


def stiff_flow(f, t, y):
    x, v, push = y[0], y[1], y[2]
    demand = f.cos(1.7 * t) - 0.3 * x
    return v, push - x - 0.1 * v, RATE * (demand - push - push * push * push)


#: Times of all impacts, by heyoka to rounding; Radau at 1e-11 agrees to 5e-13.
STIFF_IMPACTS = (
    2.109115346186739,
    6.081006545897737,
    9.754729887690534,
)

STIFF = {
    "scipy:Radau": ("scipy", "Radau"),
    "scipy:BDF": ("scipy", "BDF"),
    "scipy:LSODA": ("scipy", "LSODA"),
    "diffrax:Kvaerno5": ("diffrax", "Kvaerno5"),
}


def stiff(quick):
    """Implicit methods on a force that is a million times as fast."""
    exact = np.array(STIFF_IMPACTS)
    start = np.array([1.0, 0.0, 0.3])
    motion = Bodies(stiff_flow, [(0, 1)], -0.5, 0.8, start, 50, 3.0, until=SHORT)

    def ours(solver, method, rtol):
        given = {"solver": solver, "method": method, "save": "jumps"}
        options = given | tolerances(solver, rtol)
        return lambda: hy.simulate(Stiff(), start, (0.0, SHORT), **options).jumps.t

    def judge(found, rtol):
        times = found[:, 0] if found.ndim == 2 else found
        same = len(times) == len(exact)
        return (np.abs(times - exact).max() if same else math.inf), len(exact), 0

    ways = {f"hybrid, {name}": partial(ours, *own) for name, own in STIFF.items()}
    modules = {"solve_ivp_restarts": "Radau", "cvode_roots": "BDF"}
    modules["diffeqsolve_nested"] = "Kvaerno5"
    others = peers(dict.fromkeys(modules, motion), modules)
    return Task(
        title=f"A stiff impact oscillator, to t = {SHORT:g}",
        text=f"`Stiff()`, one of whose rates is {RATE:g}: the times of all {len(exact)} impacts, "
        "against heyoka to rounding.",
        unit="an impact",
        wanted=1e-5,
        ways=ways | others,
        judge=judge,
        tolerances=(1e-4, 1e-6),
        floor=lambda: stiff_floor(start),
    )


def stiff_floor(start, rtol=1e-6):
    """Evaluations of the flow with Radau, as Python makes them; not the linear algebra."""
    run = hy.simulate(
        Stiff(), start, (0.0, SHORT), method="Radau", save="jumps", **tolerances("scipy", rtol)
    )
    one = floors.least(lambda: stiff_flow(math, 0.3, start.tolist()))
    return [("evaluations", run.stats.evaluations, one)]


# ---------------------------------------------------------------------------------------
# a chain of masses, many of them over walls

MASSES, WALLS, END = 100, 20, 8.0
STRUCK = range(2, MASSES, MASSES // WALLS)


class Chain(hy.Automaton):
    """Springs between neighbours; every fifth mass is over a wall."""

    q = hy.state(shape=(MASSES,))
    v = hy.state(shape=(MASSES,))

    @hy.mode(initial=True)
    def flow(self, t, s):
        q = jnp.pad(s.q, 1)
        return s.v, 2.0 * (q[2:] - 2.0 * q[1:-1] + q[:-2]) - s.q**3 - 0.1

    for _k in STRUCK:
        locals()[f"wall{_k}"] = hy.contact(
            flow, gap=lambda self, t, s, k=_k: s.q[k] + 0.2, restitution=0.9
        )
    del _k


def chain_flow(f, t, y):
    none = [0.0 * y[0]]
    q = f.concatenate([none, y[:MASSES], none]) if f is not jnp else jnp.pad(y[:MASSES], 1)
    force = 2.0 * (q[2:] - 2.0 * q[1:-1] + q[:-2]) - q[1:-1] * q[1:-1] * q[1:-1] - 0.1
    return f.concatenate([y[MASSES:], force])


def chain(quick):
    """Two hundred states and twenty walls."""
    y = np.concatenate([0.3 + 0.3 * np.cos(np.arange(MASSES)), np.zeros(MASSES)])
    until = 4.0 if quick else END
    walls = [(k, MASSES + k) for k in STRUCK]
    motion = Bodies(chain_flow, walls, -0.2, 0.9, y, 400, 10.0, until=until)
    start = {"q": y[:MASSES], "v": y[MASSES:]}
    truth = cache(lambda: chain_truth(motion, start, until))

    def ours(solver, rtol):
        options = {"solver": solver, "save": "jumps", **tolerances(solver, rtol)}
        return lambda: hy.simulate(Chain(), start, (0.0, until), **options).jumps.t

    def judge(found, rtol):
        times = found[:, 0] if found.ndim == 2 else found
        same = len(times) == len(truth())
        return (np.abs(times - truth()).max() if same else math.inf), len(times), 0

    ways = {f"hybrid, {s}": partial(ours, s) for s in ("taylor", "scipy", "diffrax")}
    modules = "solve_ivp_restarts", "cvode_roots", "diffeqsolve_nested", "heyoka_events"
    return Task(
        title=f"A chain of {2 * MASSES} states and {WALLS} walls, to t = {until:g}",
        text="`Chain()`: the times of all impacts, against heyoka to rounding, or Taylor series.",
        unit="an impact",
        wanted=1e-8,
        ways=ways | peers(dict.fromkeys(modules, motion)),
        judge=judge,
        tolerances=(1e-6, 1e-9, 1e-12),
        floor=lambda: floor_of(Chain(), start, until),
    )


def chain_truth(motion, start, until):
    try:
        from peers import heyoka_events
    except ImportError:
        return hy.simulate(Chain(), start, (0.0, until), solver="taylor", save="jumps").jumps.t
    return heyoka_events.prepare(motion, None)()[:, 0]


# ---------------------------------------------------------------------------------------
# no edge

POINT, SIZES, RTOL, ATOL = (1.0, 1.0, 1.0), (10.0, 28.0, 8.0 / 3.0), 1e-8, 1e-10
EARLY, LATE = 5.0, 50.0

#: The state at the earlier time, by heyoka in extended precision.
LORENZ = -6.512113699419599, -6.974042788417074, 23.924129572103373


def lorenz(x, y, z, sigma=SIZES[0], rho=SIZES[1], beta=SIZES[2]):
    return sigma * (y - x), x * (rho - z) - y, x * y - beta * z


class Lorenz(hy.Automaton):
    """Lorenz' system: one mode, no edge."""

    x = hy.state()
    y = hy.state()
    z = hy.state()

    sigma: float = hy.parameter(SIZES[0])
    rho: float = hy.parameter(SIZES[1])
    beta: float = hy.parameter(SIZES[2])

    @hy.mode(initial=True)
    def flow(self, t, s):
        return lorenz(s.x, s.y, s.z, self.sigma, self.rho, self.beta)


def no_edge(quick):
    """What a model without an edge costs more than its solver bare."""

    def judge(run, rtol):
        return np.abs(run(EARLY) - np.array(LORENZ)).max(), 1, 0

    def ours(solver, method, rtol):
        given = {"solver": solver, "method": method, "rtol": rtol, "atol": ATOL, "save": "jumps"}
        model = Lorenz()
        return lambda until: np.array(list(hy.simulate(model, POINT, (0, until), **given).final))

    def late(make):
        """A call that goes on to the later time, and returns what can go to another."""

        def prepared(rtol):
            run = make(rtol)

            def call():
                run(LATE)
                return run

            return call

        return prepared

    makes = {
        "hybrid, diffrax, Tsit5": partial(ours, "diffrax", "Tsit5"),
        "hybrid, scipy, RK45": partial(ours, "scipy", "RK45"),
        "hybrid, taylor": partial(ours, "taylor", None),
        "diffeqsolve Tsit5 alone": diffrax_alone,
        "solve_ivp RK45 alone": scipy_alone,
        "heyoka alone": heyoka_alone,
    }
    return Task(
        title=f"No edge: Lorenz' system to t = {LATE:g}",
        text=f"What a run costs beside its solver alone, at rtol {RTOL:g}; the error is that of "
        f"the state at t = {EARLY:g}, as the system is chaotic.",
        unit="a run",
        wanted=1e-3,
        ways={who: late(make) for who, make in makes.items()},
        judge=judge,
        tolerances=(RTOL,),
        clock=time.process_time,
    )


def diffrax_alone(rtol):
    """``diffeqsolve``; arrays are handed on, so that later calls do not compile again."""
    import diffrax
    import jax

    @jax.jit
    def solve(until, start, sizes, rtol, atol):
        flow = diffrax.ODETerm(lambda t, y, p: jnp.stack(lorenz(*y, *p)))
        options = {"stepsize_controller": diffrax.PIDController(rtol=rtol, atol=atol)}
        options |= {"max_steps": 1_000_000, "saveat": diffrax.SaveAt(t1=True)}
        method = diffrax.Tsit5()
        return diffrax.diffeqsolve(flow, method, 0.0, until, None, start, sizes, **options).ys[-1]

    asked = [np.array(value) for value in (POINT, SIZES, rtol, ATOL)]
    return lambda until: np.asarray(solve(np.array(until), *asked))


def scipy_alone(rtol):
    from scipy.integrate import solve_ivp

    def run(until):
        arc = solve_ivp(lambda t, y: lorenz(*y), (0, until), POINT, "RK45", rtol=rtol, atol=ATOL)
        return arc.y[:, -1]

    return run


def heyoka_alone(rtol):
    import heyoka

    y = heyoka.make_vars("x", "y", "z")
    made = heyoka.taylor_adaptive(list(zip(y, lorenz(*y), strict=True)), [*POINT], tol=rtol)

    def run(until):
        made.time, made.state[:] = 0.0, POINT
        made.propagate_until(until)
        return made.state.copy()

    return run
