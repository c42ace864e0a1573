"""A map that others than this process fly: the workers of a cluster, by what brings them there.

    python docs/examples/cluster.py dask map.zarr     Dask's workers, each a job of Slurm
    python docs/examples/cluster.py jobs map.zarr     an array of Slurm's jobs, one for each block
    mpiexec -n 9 python -m mpi4py.futures docs/examples/cluster.py mpi map.zarr

``pip install 'hybrid-automata[cluster]'`` brings what these import. With ``--here`` processes of
this machine stand in for Slurm's jobs. What is done is in the store: started again after anything
went wrong, by whichever way, the map goes on. A model of yours stands in a file that workers can
import.
"""

import sys
from contextlib import contextmanager

import numpy as np

import hybrid as hy
from hybrid.gallery import find

ASKED = {
    "model": find("bouncing_ball").cls(),
    "over": {"r": np.linspace(0.3, 0.9, 40), "x": np.linspace(0.5, 2.0, 40)},
    "start": {"v": 0.0},
    "t": (0.0, 20.0),
    "block": 800,
}


@contextmanager
def dask(here):
    """Twenty workers; other queues than Slurm's have classes of their own beside this one."""
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.local import LocalCluster
    from distributed import Client

    kind = LocalCluster if here else SLURMCluster
    with kind(cores=1, memory="2 GB", walltime="01:00:00") as cluster, Client(cluster) as client:
        cluster.scale(jobs=2 if here else 20)
        yield client.get_executor()


@contextmanager
def jobs(here):
    """Fifty jobs at once, of an hour at most; what they print and return is in ``jobs/``."""
    import submitit

    executor = submitit.AutoExecutor("jobs", cluster="local" if here else "slurm")
    executor.update_parameters(timeout_min=60, slurm_array_parallelism=50)
    yield executor


@contextmanager
def mpi(here):
    """All ranks but the first."""
    from mpi4py.futures import MPIPoolExecutor

    with MPIPoolExecutor() as pool:
        yield pool


def main(way, store, here=""):
    """Fly the map by one of these ways."""
    with {"dask": dask, "jobs": jobs, "mpi": mpi}[way](here == "--here") as executor:
        table = hy.sweep(**ASKED, executor=executor, store=store)
    print(f"{table.status.size} lanes, by {way}")


if __name__ == "__main__":
    main(*sys.argv[1:])
