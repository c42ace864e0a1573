"""Random lanes of eight models of the gallery: does each equal its run to the last bit?

    python benchmarks/lanes.py [--lanes 2000]

Time, state, number of jumps, first accumulation, status and reason are compared with those of
``hy.simulate`` (``tests/lanes.py``).
"""

from __future__ import annotations

import argparse
import time

from tests.lanes import NAMES, differences


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lanes", type=int, default=2000)
    each = parser.parse_args().lanes // len(NAMES)
    print(f"{'':16} {'lanes':>6} {'differ':>7} {'seconds':>8}")
    for name in NAMES:
        begun = time.perf_counter()
        found = list(differences(name, each, seed=7))
        print(f"{name:16} {each:6} {len(found):7} {time.perf_counter() - begun:8.1f}")
        for lane, what in found:
            print(f"  lane {lane}: {what}")


if __name__ == "__main__":
    main()
