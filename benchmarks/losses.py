"""Impacts lost of ten thousand, in chaotic motions, by tolerance: this package beside its peers.

    python benchmarks/losses.py [--quick]

Each flight of what is printed is flown again on its own, by heyoka to rounding: does it end earlier
than it did? Behind a plus are touches that were passed, no deeper than what the tolerance, absolute
and relative, leaves open of the position. heyoka makes the flights again, so it is needed.
"""

from __future__ import annotations

import argparse
import sys

import attrs
import jax

TOLERANCES = [10.0**-k for k in range(3, 14)]


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    try:
        from peers import heyoka_events
    except ImportError:
        sys.exit("heyoka is not installed")
    from tasks import prepared
    from tasks.impacts import COMPARED, MOTIONS, TITLES, by_hybrid

    peers = {"heyoka": "heyoka_events", "numba by hand": "numba_taylor"}
    for name in COMPARED:
        model, motion = MOTIONS[name]
        motion = attrs.evolve(motion, impacts=300) if quick else motion
        ways = {"hybrid, taylor": lambda rtol: by_hybrid("taylor", model, motion, rtol)}  # noqa: B023
        for who, module in peers.items():
            ways[who] = lambda rtol, m=module: prepared(m, motion, None, None, rtol)  # noqa: B023
        print(f"{TITLES[name]}\n{'rtol':10}" + "".join(f"{who:>16}" for who in ways))
        for rtol in TOLERANCES[::4] if quick else TOLERANCES:
            cells = [heyoka_events.lost(motion, make(rtol)(), rtol) for make in ways.values()]
            told = "".join(f"{f'{lost}+{touches}':>16}" for lost, touches in cells)
            print(f"{rtol:<10.0e}{told}", flush=True)
        print()


if __name__ == "__main__":
    main()
