"""The number of cores that the lanes of an ensemble may use."""

from __future__ import annotations

import os


def cores() -> int:
    """The number of cores that this process may use.

    These are the cores on which the system lets it run (on a cluster fewer than the machine has),
    but at most ``OMP_NUM_THREADS``, which Dask sets for its workers, and users of Slurm for their
    jobs.
    """
    own = getattr(os, "sched_getaffinity", None)  # exists on Linux only
    count = len(own(0)) if own else os.cpu_count() or 1
    most = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(most)) if most.isdecimal() and int(most) > 0 else count
