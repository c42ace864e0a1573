"""Derivatives of four hundred random scenes against differences of their runs.

Every number that a run gives (times and states of jumps, limits, the end) by every number that it
is given (parameters, start, first and last time), one line a model: the largest distance that the
error of the differences does not explain, how many were compared, and how many have no derivative
though the differences know one. ``python -m benchmarks.gradients [scenes a model]``
"""

import sys

from tests.gradients import SCENES, compared

#: Scenes of each of the models.
COUNT = 17


def main(count):
    for name in SCENES:
        found = [compared(name, seed) for seed in range(count)]
        worst = max(found, key=lambda each: each.off)
        sums = [sum(getattr(each, what) for each in found) for what in ("judged", "left", "none")]
        text = "{} compared, {} not told by differences, {} without a derivative".format(*sums)
        print(f"{name:14} {worst.off:8.1e}  {text}; {worst.what}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT)
