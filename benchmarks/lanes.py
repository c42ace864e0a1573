"""Random lanes of eight models of the gallery: does each equal its run to the last bit?

    python benchmarks/lanes.py [--lanes 2000]

Time, state, number of jumps, first accumulation, status and reason are compared with those of
``hy.simulate``, then verdicts with ``certify=True``, and the events one by one: edges, times and
states before and after the first 64 jumps (``tests/lanes.py``).
"""

from __future__ import annotations

import argparse
import time

from tests.lanes import NAMES, differences, events_apart


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lanes", type=int, default=2000)
    each = parser.parse_args().lanes // len(NAMES)
    print(f"{'':16} {'lanes':>6} {'differ':>7} {'verdict':>8} {'events':>7} {'seconds':>8}")
    for name in NAMES:
        begun = time.perf_counter()
        found = list(differences(name, each, seed=7))
        certified = list(differences(name, each, seed=7, certify=True))
        apart = list(events_apart(name, each, seed=7))
        counts = f"{each:6} {len(found):7} {len(certified):8} {len(apart):7}"
        print(f"{name:16} {counts} {time.perf_counter() - begun:8.1f}", flush=True)
        for lane, what in found + certified:
            print(f"  lane {lane}: {what}")
        for lane in apart:
            print(f"  lane {lane}: its events")


if __name__ == "__main__":
    main()
