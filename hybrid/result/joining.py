"""Joins two runs, the second of which continues the first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import attrs
import numpy as np

from ..delay.hindsight import Hindsight
from ..errors import OptionError
from ..lowering.scene import parted
from ..rules.zeros import EPS
from ..trajectory.accumulation import Accumulation
from ..trajectory.log import Log
from ..trajectory.stats import Stats
from ..trajectory.trajectory import Solution

Kind = TypeVar("Kind", bound=Solution)


def join(run: Kind, more: Kind) -> Kind:
    """A run joined with one that continues it: see :meth:`hybrid.Trajectory.__add__`."""
    _require_fit(run, more)
    before = run.log.count
    log = run.log.then(more.log, before)
    options, samples = _options(run, more), None
    if run.samples is not None and more.samples is not None:
        times, later = (each.options["times"] for each in (run, more))
        twice = int(times[-1:].tolist() == later[:1].tolist())
        options["times"] = np.concatenate([times, later[twice:]])
        samples = np.concatenate([run.samples, more.samples[twice:]])
    return attrs.evolve(
        run,
        log=log,
        zeno=[*_released(run.zeno, more), *(attrs.evolve(p, j=p.j + before) for p in more.zeno)],
        grazings=[*run.grazings, *(attrs.evolve(g, j=g.j + before) for g in more.grazings)],
        status=more.status,
        options=options,
        samples=samples,
        hindsight=_hindsight(run.hindsight, more.hindsight, log),
        stats=_stats(run.stats, more.stats),
        versions=more.versions,
    )


def _require_fit(run: Solution, more: Solution) -> None:
    """Refuse a second run that does not begin as the first ended."""
    first, why = more.arcs[0], run.differs(more.spec, more.parameters)
    moved = np.abs(first.first - run.log.kept[-1].last)
    saves = [each.options["save"] for each in (run, more)]
    memories = {each.options["memory"] for each in (run, more)}
    if why:
        why += " in the other"
    elif more.t0 != run.t1:
        why = f"it ended at t = {run.t1!r}, and the other begins at {more.t0!r}"
    elif parted(first.mode)[0] != parted(run.mode)[0] and not run.zeno:
        why = f"it ended in {run.mode}, and the other begins in {first.mode}"
    elif np.any(moved > _lost(run, first.mode) * np.maximum(run.size, more.size)):
        state = more.spec.record(first.first)
        why = f"it ended at {run.final}, and the other begins at {state}"
    elif saves[0] != saves[1]:
        why = f"it was made with save={saves[0]!r}, and the other with {saves[1]!r}"
    elif len(memories) > 1 and run.hindsight and run.hindsight.history is not None:
        why = "one remembers with memory='keep', the other with 'restart'"
    if why:
        raise OptionError(f"{run.spec.model}: the runs do not fit: {why}")


def _lost(run: Solution, mode: str) -> float:
    """The share of a state that going on may change: rounding, of which flights lower than that are
    part where contacts have been found at rest. Their heights are the squares of their speeds.
    """
    more_held = set(parted(mode)[1]) - set(parted(run.mode)[1])
    return float(np.sqrt(64 * EPS)) if more_held else 64 * EPS


def _options(run: Solution, more: Solution) -> dict[str, Any]:
    kept = {"mode": run.options["mode"]}
    for name in ("rtol", "atol"):
        kept[name] = np.maximum(run.options[name], more.options[name])
        kept[name] = kept[name] if np.ndim(kept[name]) else float(kept[name])
    return {**more.options, **kept}


def _released(points: Sequence[Accumulation], more: Solution) -> list[Accumulation]:
    """The accumulations of a run, with the release times of rests that ended in the next run."""
    return [attrs.evolve(point, t_release=_left(point, more)) for point in points]


def _left(point: Accumulation, more: Solution) -> float | None:
    """When what followed an accumulation was left, in its run or in the next."""
    if point.mode is None or point.t_release is not None:
        return point.t_release
    return next((part.t0 for part in more.parts if not point.stays(part.mode)), None)


def _stats(one: Stats | None, other: Stats | None) -> Stats | None:
    if one is None or other is None:
        return None
    return Stats(
        one.steps + other.steps,
        _sum(one.rejected, other.rejected),
        _sum(one.evaluations, other.evaluations),
        one.seconds + other.seconds,
    )


def _sum(one: int | None, other: int | None) -> int | None:
    return None if one is None or other is None else one + other


def _hindsight(one: Hindsight | None, other: Hindsight | None, log: Log) -> Hindsight | None:
    if one is None or other is None:
        return None
    given = one.scene, one.history, one.memory, log, other.breaks, one.earlier
    return Hindsight(*given)
