"""Derivatives of four hundred random scenes against differences of their runs.

Impacts, sums, rests, releases, sliding, clocks, forces that begin at once, delays. Every number
that a run gives (times and states of jumps, limits, the end) by every number that it is given
(parameters, start, first and last time), one line a model: the largest distance that the error of
the differences does not explain, of what, and how many were compared. Below it each exception by
name: what differences do not tell, and what has no derivative though they know one.
``python -m benchmarks.gradients [scenes a model]``
"""

import sys
from collections import Counter

from tests.gradients import SCENES, compared

#: Scenes of each of the models.
COUNT = 17


def main(count):
    for name in SCENES:
        found = [compared(name, seed) for seed in range(count)]
        worst = max(found, key=lambda each: each.off)
        judged = sum(each.judged for each in found)
        print(f"{name:14} {worst.off:8.1e}  {judged} compared; {worst.what}", flush=True)
        for text in ("left", "none"):
            for what, many in sum((getattr(each, text) for each in found), Counter()).items():
                why = what if text == "left" else f"{what}: no derivative"
                print(f"    {many:6} of {why}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT)
