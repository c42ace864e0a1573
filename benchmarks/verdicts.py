"""Truth against verdict: systems that accumulate and systems that only look like it.

    python benchmarks/verdicts.py [--solver scipy]

For each system of ``tests/test_truth.py`` one run at rtol 1e-9: whether an accumulation is there in
truth, what the run says, its error beside the bound it reports, and milliseconds of a second run.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import hybrid as hy
from tests.test_truth import DECOYS, ZENO


def timed(model, start, end, solver):
    """A second run, and its milliseconds."""
    span = end if isinstance(end, tuple) else (0, end)
    options = {"rtol": 1e-9, "atol": 1e-11, "solver": solver}
    hy.simulate(model, start, span, **options)
    begin = time.perf_counter()
    run = hy.simulate(model, start, span, **options)
    return run, 1e3 * (time.perf_counter() - begin)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--solver", default="scipy")
    solver = parser.parse_args().solver
    print(f"{'':26} {'truth':6} {'verdict':10} {'jumps':>6} {'error':>9} {'bound':>9} {'ms':>7}")
    wrong = 0
    for name, (model, start, end, exact) in ZENO.items():
        run, ms = timed(model, start, end, solver)
        if not run.zeno:
            wrong += 1
            print(f"{name:26} {'Zeno':6} {'MISSED':10}")
            continue
        point = run.zeno[0]
        figures = f"{abs(point.t - exact):9.1e} {point.t_error:9.1e} {ms:7.1f}"
        print(f"{name:26} {'Zeno':6} {point.verdict:10} {len(run.own_jumps):6} {figures}")
    for name, (model, start, end) in DECOYS.items():
        run, ms = timed(model, start, end, solver)
        wrong += bool(run.zeno)
        said = "FALSE" if run.zeno else "none"
        print(f"{name:26} {'none':6} {said:10} {len(run.own_jumps):6} {'':9} {'':9} {ms:7.1f}")
    print(f"{wrong} of {len(ZENO) + len(DECOYS)} wrong")


if __name__ == "__main__":
    main()
