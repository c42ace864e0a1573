"""Blocks of a map flown: in this process, in others beside it, or by an executor."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, Future, as_completed
from contextlib import closing, nullcontext
from time import sleep
from typing import TYPE_CHECKING, Any

import attrs

from ..automaton.digest import digest
from ..ensembles.processes import Shared
from ..errors import HybridError, OptionError
from .lanes import AskedLanes, flier

if TYPE_CHECKING:
    import xarray

#: Seconds after which it is asked whether an executor still takes work, and between two looks at
#: jobs that do not tell when they have ended.
PROBED_AFTER, PAUSE = 15.0, 0.1


def flown(
    asked: AskedLanes, numbers: Iterable[int], executor: Any = None
) -> Generator[tuple[int, xarray.Dataset]]:
    """Numbers of blocks, and their tables, in any order.

    Without an executor blocks whose lanes go one by one are shared with other processes where that
    pays, and those of an executor whose worker has died, or could not make them, are flown here.
    """
    lost: list[int] = list(numbers)
    if executor is not None:
        lost = yield from _by(executor, asked, lost)
    if asked.one_by_one:
        yield from _beside(asked, lost)
    else:
        yield from ((number, asked.only(number).fly()) for number in lost)


def followed(
    asked: AskedLanes, numbers: Iterable[int], executor: Any = None, before: Any = None
) -> Generator[tuple[int, xarray.Dataset]]:
    """As :func:`flown`, in order: each block follows the one before, the first of these
    ``before``."""
    for number in numbers:
        own = attrs.evolve(asked.only(number), before=before)
        ((_, before),) = flown(own, [0], executor)
        yield number, before


def _beside(asked: AskedLanes, numbers: Iterable[int]) -> Generator[tuple[int, xarray.Dataset]]:
    def job() -> tuple[Any, ...]:
        return flier, digest(type(asked.model)), asked

    def same(one: xarray.Dataset, other: xarray.Dataset) -> bool:
        return bool(one.equals(other))

    shared = Shared(lambda number: asked.only(number).fly(), numbers, job, same)
    with closing(shared.answers()) as answers:
        yield from answers


def _by(
    executor: Any, asked: AskedLanes, numbers: list[int]
) -> Generator[tuple[int, xarray.Dataset], None, list[int]]:
    """Let an executor fly blocks; returns those that it has lost."""
    if not callable(getattr(executor, "submit", None)):
        raise OptionError(f"executor={executor!r}: one of concurrent.futures, or like it")
    left: dict[Any, int] = {}
    lost: dict[int, BaseException] = {}
    try:
        with getattr(executor, "batch", nullcontext)():
            for number in numbers:
                try:
                    left[executor.submit(AskedLanes.fly, asked.only(number))] = number
                except Exception as fault:  # it takes no more
                    lost[number] = fault
        for future in _ended(executor, list(left)):
            failed, number = _fault(future), left.pop(future)
            if failed is None:
                yield number, future.result()
            elif isinstance(failed, HybridError):
                raise failed
            else:
                lost[number] = failed
    finally:
        for future in left:
            if not future.done():
                future.cancel()
    return _told_lost(lost, list(left.values()))


def _told_lost(failed: dict[int, BaseException], silent: list[int]) -> list[int]:
    """Warn of blocks that have failed, and of those of which nothing is heard; all of them."""
    lost = sorted([*failed, *silent])
    if lost:
        why = [f"{type(fault).__name__}: {fault}" for fault in failed.values()]
        said = why[-1] if why else "it takes no more"
        warnings.warn(
            f"hybrid flies {len(lost)} blocks here that the executor has lost ({said})",
            stacklevel=3,
        )
    return lost


def _ended(executor: Any, sent: list[Any]) -> Iterator[Any]:
    """What has been sent, as it ends; less than all of it where the executor is found dead."""
    futures = {each for each in sent if isinstance(each, Future)}
    jobs = [each for each in sent if not isinstance(each, Future)]
    while futures:
        try:
            for future in as_completed(set(futures), timeout=PROBED_AFTER):
                futures.discard(future)
                yield future
        except TimeoutError:
            if not _takes(executor):
                return
    while jobs:  # of submitit, which do not tell
        for job in [each for each in jobs if each.done()]:
            jobs.remove(job)
            yield job
        sleep(PAUSE if jobs else 0.0)


def _takes(executor: Any) -> bool:
    """Whether an executor still takes work. One of Dask whose scheduler has died does not, and what
    was about to be fetched from it then never ends."""
    try:
        executor.submit(int).cancel()
    except Exception:  # whatever it raises
        return False
    return True


def _fault(future: Any) -> BaseException | None:
    """Why there is no answer; None where there is one."""
    try:
        return future.exception()  # type: ignore[no-any-return]
    except CancelledError as fault:  # by its executor, whose scheduler has died
        return fault


Progress = Callable[[int, int], None]
