"""Blocks of a map flown: in this process, in others beside it, or by an executor."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, as_completed
from contextlib import closing
from typing import TYPE_CHECKING, Any

import attrs

from ..automaton.digest import digest
from ..ensembles.processes import Shared
from ..errors import HybridError, OptionError
from .lanes import AskedLanes, flier

if TYPE_CHECKING:
    import xarray


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
    sent: dict[Future, int] = {}
    lost: list[int] = []
    why: BaseException | None = None
    try:
        for number in numbers:
            try:
                sent[executor.submit(AskedLanes.fly, asked.only(number))] = number
            except Exception as fault:  # it takes no more
                lost.append(number)
                why = fault
        for future in as_completed(sent):
            failed = future.exception()
            if failed is None:
                yield sent[future], future.result()
            elif isinstance(failed, HybridError):
                raise failed
            else:
                lost.append(sent[future])
                why = failed
    finally:
        for future in sent:
            future.cancel()
    if lost:
        said = f"{type(why).__name__}: {why}"
        warnings.warn(
            f"hybrid flies {len(lost)} blocks here that the executor has lost ({said})",
            stacklevel=2,
        )
    return sorted(lost)


Progress = Callable[[int, int], None]

__all__ = ["Progress", "flown", "followed"]
