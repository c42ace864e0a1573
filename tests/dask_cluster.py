"""A sweep on a local cluster of Dask: are the lanes those of one process? For ``test_maps.py``."""

import distributed

import hybrid as hy
from tests.swept import ASKED, Ball


def main():
    table = hy.sweep(Ball(), **ASKED)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        shared = hy.sweep(Ball(), **ASKED, executor=client.get_executor())
    print("identical" if table.identical(shared) else "different")


if __name__ == "__main__":
    main()
