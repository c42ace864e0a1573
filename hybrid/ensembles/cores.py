"""How many cores lanes may use."""

from __future__ import annotations

import os


def cores() -> int:
    """Cores that this process may use.

    Those on which the system lets it run, on a cluster fewer than the machine has; and no more than
    ``OMP_NUM_THREADS``, which Dask sets for its workers, and Slurm's users for their jobs.
    """
    own = getattr(os, "sched_getaffinity", None)  # Linux alone has it
    count = len(own(0)) if own else os.cpu_count() or 1
    most = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(most)) if most.isdecimal() and int(most) > 0 else count
