"""Rest that nothing can end: what a run shows at its end, and what its model says of the rest.

Where the state does not change, neither flow nor guards nor the gaps that are held depend on time,
and all that delays see has stood still for the longest lag, the next instant finds everything as
this one did. If then no guard is zero, and what holds the state pushes, nothing changes any more.

A position that a contact holds stands still because its gap, which is zero, depends on it and on
what stands still: its rate is rounding, whatever its size. All other rates must be zero.
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

#: Differences below this, against the size of an element along the run, are rounding.
CHANGE_ROUNDING = 1e-14

#: A guard nearer to zero than this, against the terms it is made of (a load: against the largest
#: that it was), is not away from it: what integration loses may have brought it there.
AWAY = 1e-6

#: Parts of the last half of a run in which the rates of what moves are compared, and times in each.
#: Noise grows in all of them once in 720 times, and by no power of ten from the first to the last.
RATE_PARTS, TIMES, MUCH = 6, 4, 10.0

#: Degree at which a function of the state is sampled along a step to find its zeros.
SAMPLED_DEGREE = 16

#: Places along a step at which loads are looked at.
LOAD_PLACES = nodes(8)


@attrs.frozen
class Standing:
    """How a run stands still at its end.

    Attributes
    ----------
    since : float
        From when on everything that is seen stands still.
    load, least : float or None
        Of the contacts that are held: the smallest load at the end, and on the way there.
    but : str or None
        Why that may not be for ever.
    still : bool
        Whether it stands still.
    doubtful : bool
        Whether what moves grows, or might lift what a contact holds.
    """

    since: float
    load: float | None
    least: float | None
    but: str | None
    still: bool = True
    doubtful: bool = True


def standing(run: Solution) -> Standing | None:
    """How a run stands still at its end; None if its model, or how it ended, is not known."""
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
    """What moves, and whether that may end a rest; None where nothing does."""
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
    """Places of positions that a contact alone holds, and of their velocities."""
    pairs = [field.code.pairing(contact) for contact in field.held]
    single = [pair for pair in pairs if len(pair.positions) == 1]
    return {int(place) for pair in single for place in (*pair.positions, *pair.velocities)}


def _grow(run: Solution, arc: Arc, places: list[int]) -> list[bool]:
    """Whether the rates of some elements grow all through the last half of a run."""
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
    """From when on the record shows the last state, in what is seen of it."""
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
    """Loads of the contacts held, along an arc."""
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
