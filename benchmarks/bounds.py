"""The bound on an accumulation's time against its error, on 500 random scenes with a known answer.

    python benchmarks/bounds.py [--scenes 500] [--seed 0]

Each with ``scipy`` and ``taylor`` at rtol 1e-6, 1e-9 and 1e-12. Prints each exception, and at the
end by kind how many there were, the largest share of the bound that was used, and how many bounds
are infinite.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import hybrid as hy
from tests.scenes import scenes


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    shares, wrong, endless = defaultdict(list), defaultdict(int), defaultdict(int)
    for number, scene in enumerate(scenes(options.scenes, options.seed)):
        for solver in ("scipy", "taylor"):
            for rtol in (1e-6, 1e-9, 1e-12):
                what = f"{number} {scene.what} {solver} {rtol:.0e} {scene.model} {scene.start}"
                try:
                    zeno = scene.run(solver, rtol).zeno
                    error = abs(zeno[0].t - scene.exact) if zeno else math.nan
                    bound = zeno[0].t_error if zeno else math.nan
                except hy.HybridError as fault:
                    error = bound = math.nan
                    what = f"{what}: {fault}"
                shares[scene.what].append(error / bound)
                endless[scene.what] += bound == math.inf
                if not error <= bound:
                    wrong[scene.what] += 1
                    print(f"{what}: error {error:.3g}, bound {bound:.3g}", flush=True)
    for kind, used in shares.items():
        print(
            f"{kind:9} {len(used):5} runs, {wrong[kind]} exceptions, {endless[kind]} infinite, "
            f"at most {max(used):.3g} of the bound"
        )


if __name__ == "__main__":
    main()
