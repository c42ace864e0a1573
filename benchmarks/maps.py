"""Maps: how fast lanes come, what a block costs, that nothing is lost, and two figures.

    python benchmarks/maps.py bead [--amplitudes 40] [--starts 64]
    python benchmarks/maps.py valve [--values 960] [--to out/maps] [--store out/valve.zarr]
    python benchmarks/maps.py borders
    python benchmarks/maps.py kills [--count 50] [--targets writer,worker,scheduler]
    python benchmarks/maps.py memory [--side 1000]
    python benchmarks/maps.py blocks
    python benchmarks/maps.py dask

Each prints the error beside the time. ``bead``: a ball on a table that moves as G sin t, 300
impacts after 500, beside a loop by hand in numba over all cores. ``valve``: the pressure relief
valve of Hos and Champneys (2012) over its flow, 32 returns after 1,024. ``borders``: where orbits
of that ball with an impact a period exist, and are stable, by refinement, against closed forms.
``kills``: at random moments the process that writes a map is killed, or the worker or the scheduler
of Dask that fly it. ``memory``: of a map of side x
side lanes as it grows. Ratios hold, seconds do not.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import hybrid as hy
from models.relief_valve import START, ReliefValve

try:
    import numba
except ImportError:
    numba = None

SKIP, KEEP = 500, 300


class Table(hy.Automaton):
    """A ball on a table that moves as ``G sin t``."""

    x = hy.state()
    v = hy.state()
    G: float = hy.parameter(0.6)
    e: float = hy.parameter(0.7, between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.G * jnp.sin(t), restitution="e")


class Valve(ReliefValve):
    """The gallery's, which also turns where it stands highest."""

    @hy.edge("open", to="open", guard=lambda self, t, s: s.y2)
    def turn(self, t, s):
        return s


class Dropped(hy.Automaton):
    """A ball dropped from height ``x``."""

    x = hy.state()
    v = hy.state()
    r: float = hy.parameter(0.5, between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


def timed(function, *arguments):
    """Seconds by the clock and of all processors, and the result."""
    begin, used = time.perf_counter(), time.process_time()
    result = function(*arguments)
    return time.perf_counter() - begin, time.process_time() - used, result


# ---------------------------------------------------------------------------------------
# the bead, beside a loop by hand


def compiled(**options):
    """numba's decorator; without numba, none."""
    return numba.njit(error_model="numpy", **options) if numba else lambda function: function


@compiled()
def struck(G, e, v, impacts, skip, kept):
    """Impacts of one ball by hand: steps until it is below the table, then Newton's method. It
    stops where it is slower than 1e-6; returns how many impacts there were."""
    t, x, step = 0.0, 0.0, 0.02
    for n in range(impacts):
        a = 0.0
        b = step
        while x + v * b - 0.5 * b * b - G * math.sin(t + b) >= 0.0:
            a = b
            b += step
        tau = 0.5 * (a + b)
        for _ in range(60):
            gap = x + v * tau - 0.5 * tau * tau - G * math.sin(t + tau)
            rate = v - tau - G * math.cos(t + tau)
            if gap >= 0.0:
                a = tau
            else:
                b = tau
            new = tau - gap / rate
            if not a < new < b:
                new = 0.5 * (a + b)
            if abs(new - tau) <= 1e-15 * (1.0 + tau):
                break
            tau = new
        t += tau
        table = G * math.cos(t)
        v = table - e * (v - tau - table)
        x = G * math.sin(t)
        if n >= skip and n - skip < len(kept):
            kept[n - skip] = v
        if v - table < 1e-6:
            return n + 1
    return impacts


@compiled(parallel=True)
def by_hand(G, v, e, impacts, skip, kept):
    """All balls; how many impacts each had."""
    counts = np.zeros(len(G), dtype=np.int64)
    for i in numba.prange(len(G)):
        counts[i] = struck(G[i], e, v[i], impacts, skip, kept[i])
    return counts


def bead(amplitudes, starts):
    over = {"G": np.linspace(0.56, 1.2, amplitudes), "v": np.linspace(2.0, 6.0, starts)}
    asked = {"start": {"x": 0.0}, "t": (0.0, 1e5), "section": "impact", "skip": SKIP, "keep": KEEP}
    asked |= {"zeno": "stop", "max_jumps": SKIP + KEEP}
    few = {"G": over["G"][:2], "v": over["v"][:2]}
    hy.sweep(Table(), few, **asked)  # compiled
    seconds, used, table = timed(lambda: hy.sweep(Table(), over, **asked))
    lanes, impacts = table.jumps.size, int(table.jumps.sum())
    print(f"{lanes} lanes, {impacts} impacts, {os.cpu_count()} cores (x = 0 at t = 0, G, v vary)")
    row = "{:26} {:8.2f} s {:8.2f} s {:10.0f} {:12.0f}"
    print(f"{'':26} {'clock':>10} {'used':>10} {'lanes/s':>10} {'impacts/s':>12}")
    print(row.format("hybrid, hy.sweep", seconds, used, lanes / seconds, impacts / seconds))
    if numba is None:
        return
    G, v = (a.ravel() for a in np.meshgrid(over["G"], over["v"], indexing="ij"))
    kept = np.full((lanes, KEEP), np.nan)
    by_hand(G[:2], v[:2], 0.7, 10, 5, kept[:2].copy())
    seconds, used, counts = timed(by_hand, G, v, 0.7, SKIP + KEEP, SKIP, kept)
    own = int(counts.sum())
    print(row.format("numba by hand, prange", seconds, used, lanes / seconds, own / seconds))
    ours = table.v_section.values.reshape(lanes, KEEP)
    both = np.isfinite(ours).all(axis=1) & np.isfinite(kept).all(axis=1)
    apart = np.abs(ours - kept)[both].max(axis=1)
    same = np.mean(apart < 1e-9)
    print(
        f"{both.sum()} lanes have all {KEEP} speeds: the same to 1e-9 in {same:.1%} (the others "
        "have not come to an orbit, or to another one)"
    )


# ---------------------------------------------------------------------------------------
# the valve


def valve(values, to, store):
    asked = {"section": "turn", "skip": 1024, "keep": 32, "measure": ()}
    q = np.linspace(0.2, 10.0, values)
    hy.bifurcation(Valve(), {"q": q[-2:]}, START, (0.0, 5.0), **asked)  # compiled
    begin, used = time.perf_counter(), time.process_time()
    asked |= {"t": (0.0, 2800.0), "max_steps": 60_000, "store": store}
    found = hy.bifurcation(Valve(), {"q": q}, START, **asked)
    seconds, used = time.perf_counter() - begin, time.process_time() - used
    full = np.isfinite(found.table.t_section.values).all(axis=1)
    hits, jumps = int(found.table.hits.sum()), int(found.table.jumps.sum())
    sums, whole = int(found.table.accumulations.sum()), 30720 / values * used / 60
    print(
        f"{values} values of q: {seconds:.0f} s ({used:.0f} s of all processors), {hits} returns, "
        f"{jumps - hits} impacts, {sums} accumulations; {full.sum()} lanes have all 32 points; "
        f"for 30,720 values {whole:.0f} minutes of a processor"
    )
    names, counts = np.unique(found.table.status.values, return_counts=True)
    print(", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True)))
    to.mkdir(parents=True, exist_ok=True)
    found.plot("y1", to / "valve.png")
    print(f"picture: {to / 'valve.png'}")
    seated()


def seated():
    """At rest on the seat pressure grows by 20 q a unit of time, up to 10, the spring's force."""
    print("at rest on the seat, and released by pressure; exact: t_inf + (10 - pressure)/(20 q)")
    print(f"{'q':>6} {'t_inf':>13} {'pressure':>13} {'released at':>16} {'difference':>11}")
    for q in (0.05, 0.1, 0.2, 0.25):
        run = hy.simulate(Valve(q=q), START, (0.0, 40.0), solver="taylor")
        for point in run.zeno[:2]:
            exact = point.t + (10.0 - point.state.y3) / (20.0 * q)
            row = f"{q:6} {point.t:13.9f} {point.state.y3:13.9f} {point.t_release:16.12f}"
            print(f"{row} {point.t_release - exact:11.1e}")


# ---------------------------------------------------------------------------------------
# borders by refinement


def borders():
    from tests.test_bifurcations import border_of, bounds_of

    print(f"{'e':>4} {'border':>8} {'found between':>28} {'closed form':>14} {'lanes':>6} {'s':>6}")
    for e in (0.5, 0.8):
        for which, exact in zip(("exists", "stable"), bounds_of(e), strict=True):
            seconds, _, (low, high, lanes) = timed(border_of, e, which, 1e-6)
            between = f"{low:.10f} {high:.10f}"
            print(f"{e:4} {which:>8} {between:>28} {exact:14.10f} {lanes:6} {seconds:6.1f}")


# ---------------------------------------------------------------------------------------
# kills, memory, blocks, Dask


def kills(count, targets):
    """Kill processes at random moments, and say what becomes of their maps."""
    from tests.kills import killed

    begin = time.perf_counter()
    for made, same in killed(count, targets):
        told = ", ".join(f"{number} of the {name}" for name, number in sorted(made.items()))
        print(f"{time.perf_counter() - begin:5.0f} s: kills so far: {told}; the same: {same}")
        sys.stdout.flush()
        if not same:
            raise SystemExit("a map whose process was killed is another")


def resident():
    """MiB of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def memory(side):
    seen = []
    over = {"r": np.linspace(0.3, 0.6, side), "x": np.linspace(0.5, 1.0, side)}
    with tempfile.TemporaryDirectory() as folder:
        store = f"{folder}/map.zarr"

        def told(done, lanes):
            seen.append((done, resident()))

        asked = {"start": {"v": 0.0}, "t": (0.0, 5.0), "store": store, "load": False}
        seconds, used, table = timed(lambda: hy.sweep(Dropped(), over, progress=told, **asked))
        files = [path for path in Path(store).rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files) / 2**20
        first, middle, last = seen[0], seen[len(seen) // 2], seen[-1]
        print(f"{side * side} lanes: {seconds:.0f} s ({used:.0f} s of all processors)")
        print(
            f"MiB in memory after lanes: {first[1]:.0f} after {first[0]}, {middle[1]:.0f} after "
            f"{middle[0]}, {last[1]:.0f} after {last[0]}"
        )
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"the most at any time, what is compiled among it: {peak:.0f} MiB")
        print(
            f"{len(files)} files, {size:.0f} MiB; t_inf of the last: {table.t_inf[-1].item():.12f}"
        )


def blocks():
    """1,024 lanes in one block, and in more: process time, the least of three."""
    over = {"r": np.linspace(0.3, 0.6, 32), "x": np.linspace(0.5, 1.0, 32)}

    def used(block, kept):
        times = []
        for _ in range(3):
            with tempfile.TemporaryDirectory() as folder:
                asked = {"block": block, "store": f"{folder}/map.zarr" if kept else None}
                fly = partial(hy.sweep, Dropped(), over, {"v": 0.0}, (0.0, 5.0), **asked)
                times.append(timed(fly)[1])
        return min(times)

    used(1024, True)
    whole = used(1024, False)
    print(f"{'block':>6} {'blocks':>7} {'no store, ms a block':>22} {'store, ms a block':>19}")
    for block in (256, 64, 16):
        count = 1024 // block
        more = [(used(block, kept) - whole) / count * 1e3 for kept in (False, True)]
        print(f"{block:6} {count:7} {more[0]:22.1f} {more[1]:19.1f}")
    print(f"(process time over that of one block without a store, {whole * 1e3:.0f} ms in all)")


def dask():
    """Lanes that go one by one, on a local cluster of one worker and of two."""
    import distributed

    from tests.wells import Floor  # what a worker finds by its module

    over = {"G": np.linspace(0.6, 1.0, 16), "v": np.linspace(2.5, 3.5, 96)}
    asked = {"start": {"x": 0.0}, "t": (0.0, 600.0), "section": 2 * np.pi, "skip": 40, "keep": 8}
    first = None
    for workers in (1, 2):
        local = {"threads_per_worker": 1, "dashboard_address": None}
        with (
            distributed.LocalCluster(n_workers=workers, **local) as cluster,
            distributed.Client(cluster) as client,
        ):
            by = {"executor": client.get_executor()}
            few = {"G": over["G"], "v": over["v"][:1]}
            hy.sweep(Floor(), few, **asked, **by, block=1)  # all compile
            seconds, _, table = timed(partial(hy.sweep, Floor(), over, **asked, **by, block=8))
        first = first or (seconds, table)
        told = f"{first[0] / seconds:.2f} times, the same: {table.identical(first[1])}"
        print(f"{workers} workers: {seconds:.2f} s, {told}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=[
        "bead", "valve", "borders", "kills", "memory", "blocks", "dask"
    ])  # fmt: skip
    parser.add_argument("--amplitudes", type=int, default=40)
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--values", type=int, default=960)
    parser.add_argument("--to", type=Path, default=Path("out/maps"))
    parser.add_argument("--store", help="where the valve's blocks are kept: it can be gone on with")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--targets", default="writer,worker,scheduler")
    parser.add_argument("--side", type=int, default=1000)
    given = parser.parse_args()
    asked = {
        "bead": lambda: bead(given.amplitudes, given.starts),
        "valve": lambda: valve(given.values, given.to, given.store),
        "kills": lambda: kills(given.count, given.targets.split(",")),
        "memory": lambda: memory(given.side),
        "borders": borders,
        "blocks": blocks,
        "dask": dask,
    }
    asked[given.what]()


if __name__ == "__main__":
    import maps  # other processes find its models there

    maps.main()
