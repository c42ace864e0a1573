"""A sweep over a pool of processes, one of which is killed by a block; for ``test_maps.py``."""

import multiprocessing
import os
import signal
import warnings
from concurrent.futures import ProcessPoolExecutor

import hybrid as hy
from tests.swept import ASKED, Ball


def deadly(table):
    """Kills the process that is not the main one."""
    if multiprocessing.parent_process() is not None and float(table.r.values[0]) > 0.5:
        os.kill(os.getpid(), signal.SIGKILL)
    return table.r


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    asked = {**ASKED, "measure": [deadly]}
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = hy.sweep(Ball(), **asked, executor=pool)
    print("identical" if found.identical(hy.sweep(Ball(), **asked)) else "different")
