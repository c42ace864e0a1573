"""Permanent rest: what a run shows at its end, and what its model implies.

Suppose the state does not change, flow, guards and held gaps do not depend on time, and everything
that delays see has been constant for the longest lag. Then the next instant equals this one. If in
addition no guard is zero, and the contacts that hold the state push, nothing ever changes.

A position held by a contact is constant because its gap, which is zero, depends only on it and on
constant values; its rate is rounding, whatever its size. All other rates must be exactly zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..delay.hindsight import Hindsight, PastRecord
from ..lowering import Field, Kind
from ..segment import nodes
from ..trajectory.arcs import Arc
from ..trajectory.trajectory import Solution

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Differences below this, relative to the largest value of an element in the run, are rounding.
CHANGE_ROUNDING = 1e-14

#: A guard closer to zero than this is not safely away from it, as integration errors may have
#: brought it there; relative to the terms of the guard, or for a load to its largest value.
AWAY = 1e-6

#: Number of parts of the last half of a run in which rates are compared, of times in each, and the
#: overall growth that is decisive by itself. Noise grows through all parts in one of 720 cases, and
#: never tenfold from the first to the last.
RATE_PARTS, TIMES, MUCH = 6, 4, 10.0

#: Degree at which a function of the state is sampled along a step to find its zeros.
SAMPLED_DEGREE = 16

#: Places along a step at which loads are evaluated.
LOAD_PLACES = nodes(8)


@attrs.frozen
class Standing:
    """How a run stands still at its end.

    Attributes
    ----------
    since : float
        Time since which everything that delays see is constant.
    load, least : float or None
        Smallest load of the held contacts, at the end and on the way there.
    but : str or None
        Why the rest may not be permanent.
    still : bool
        Whether the state is constant.
    doubtful : bool
        Whether what still moves grows, or might lift a held contact.
    """

    since: float
    load: float | None
    least: float | None
    but: str | None
    still: bool = True
    doubtful: bool = True


def standing(run: Solution) -> Standing | None:
    """How a run stands still at its end; None if its model or its last arc is not known."""
    arc, sight = run.parts[-1], run.hindsight
    if sight is None or not isinstance(arc, Arc) or not arc.segments:
        return None
    part = len(run.parts) - 1
    field: Field = sight.at(part, arc.t1, "left").field(arc.mode)
    moves = _moves(run, arc, field)
    if moves is not None:
        return Standing(arc.t1, None, None, moves[0], still=False, doubtful=moves[1])
    lag = sight.longest
    record = sight.record(part) if sight.lags else PastRecord([])
    seen = sorted({element for each in field.code.seen for element in each})
    begun = arc.t0 if part or not sight.lags else -np.inf
    since = max(arc.t0, max(begun, _stands(record, arc, seen, run.size)) + lag)
    loads = np.array(_loads(sight, part, arc))
    load, least = (float(loads[-1].min()), float(loads.min())) if loads.size else (None, None)
    return Standing(since, load, least, _but(run, arc, field, since, lag, loads))


def _moves(run: Solution, arc: Arc, field: Field) -> tuple[str, bool] | None:
    """What still moves, and whether it may end a rest; None if nothing moves."""
    for contact in field.held:
        if field.code.timed(field.code.closed("gap", contact)):
            return f"the gap of {contact}, which is held, depends on time", True
    free = [i for i in range(len(arc.last)) if i not in _held(field)]
    rate = np.abs(field.rhs(arc.t1, arc.last.tolist()))[free]
    if not np.any(rate != 0.0):
        return None
    names = [run.spec.element_names[i] for i, each in zip(free, rate, strict=True) if each != 0.0]
    grows = _grow(run, arc, free)
    said = "still grow" if any(grows) else "still change"
    if any(grows):
        names = [run.spec.element_names[i] for i, each in zip(free, grows, strict=True) if each]
    said = f"{', '.join(names)} {said}{'s' * (len(names) == 1)}"
    return said, bool(field.held) or any(grows)


def _held(field: Field) -> set[int]:
    """Indices of positions that a single contact holds, and of their velocities."""
    pairs = [field.code.pairing(contact) for contact in field.held]
    single = [pair for pair in pairs if len(pair.positions) == 1]
    return {int(place) for pair in single for place in (*pair.positions, *pair.velocities)}


def _grow(run: Solution, arc: Arc, places: list[int]) -> list[bool]:
    """Whether the rates of some elements grow throughout the last half of a run."""
    first = max(arc.t0, 0.5 * (run.t0 + run.t1))
    times = np.linspace(first, arc.t1, RATE_PARTS * TIMES)
    states = arc.local(np.clip((times - arc.t0) - arc.low, 0.0, arc.length))
    part = len(run.parts) - 1
    rates = [
        np.abs(run.hindsight.at(part, t).field(arc.mode).rhs(t, x.tolist()))[places]
        for t, x in zip(times.tolist(), states, strict=True)
    ]
    largest = np.array(rates).reshape(RATE_PARTS, TIMES, len(places)).max(axis=1)
    always = np.all(np.diff(largest, axis=0) > 0, axis=0)
    return [bool(each) for each in always | (largest[-1] > MUCH * largest[0])]


def _stands(record: PastRecord, arc: Arc, seen: list[int], size: Numbers) -> float:
    """The time since which the record equals the last state, in all elements that delays see."""
    for piece in reversed(record.pieces):
        start = piece.start if np.isfinite(piece.start) else piece.end - 1.0
        states = piece.state(start, (piece.end - start) * LOAD_PLACES)[:, seen]
        allowed = CHANGE_ROUNDING * size[seen]
        if np.any(np.abs(states - arc.last[seen]) > allowed):
            return piece.end
        if piece.degree > 64:
            return piece.end  # a function of the caller's may have been anything
    return -np.inf


def _loads(sight: Hindsight, part: int, arc: Arc) -> list[list[float]]:
    """Loads of the held contacts along an arc, one list per sampled time."""
    found = []
    for segment in arc.segments:
        times = arc.t0 + arc.low + segment.start + segment.length * LOAD_PLACES
        for t, x in zip(times.tolist(), segment.at(LOAD_PLACES).tolist(), strict=True):
            field = sight.at(part, t).field(arc.mode)
            loads = [guard.value(t, x) for guard in field.guards if guard.kind is Kind.RELEASE]
            found += [loads] if loads else []
    return found


def _but(
    run: Solution, arc: Arc, field: Field, since: float, lag: float, loads: np.ndarray
) -> str | None:
    """Why a run that stands still may move again; None if it cannot."""
    code, x = field.code, arc.last.tolist()
    if any(code.moving):
        return "a lag depends on time or state"
    if field.clocks:
        return f"{field.clocks[0].edge} fires at given times"
    if code.timed(field.closed):
        return f"the flow in {arc.mode} depends on time"
    largest = iter(loads.max(axis=0)) if loads.size else iter(())
    scene = run.hindsight.at(len(run.parts) - 1, arc.t1, "left")
    for guard in field.guards:
        if code.timed(guard.closed):
            return f"the guard of {guard.edge} depends on time"
        value, load = guard.value(arc.t1, x), guard.kind is Kind.RELEASE
        size = next(largest) if load else float(scene.rounding(guard, field)(arc.t1, x)[0])
        if not (value if load else abs(value)) > AWAY * size:
            return f"the guard of {guard.edge} is {value:.6g} there, which is too near to zero"
    if since > arc.t1:
        return f"what is seen of the past changes until t = {since:.9g}, a lag of {lag:.6g} on"
    return None
