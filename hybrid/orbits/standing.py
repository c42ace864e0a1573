"""Rest that nothing can end: what a run shows at its end, and what its model says of the rest.

Where the state does not change, neither flow nor guards depend on time, and all that delays see has
stood still for the longest lag, the next instant finds everything as this one did. If then no guard
is zero, and what holds the state pushes, nothing changes any more.
"""

from __future__ import annotations

import attrs
import numpy as np

from ..arcs import Arc
from ..hindsight import Hindsight, Record
from ..scene import Field
from ..segment import nodes
from ..trajectory import Trajectory

#: Differences below this, against the size of the run, are rounding.
ROUNDING = 1e-14

#: A guard nearer to zero than this, against the largest that it was, is not away from it.
AWAY = 1e-6

#: Places along a step at which loads are looked at.
LOOK = nodes(8)


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
    """

    since: float
    load: float | None
    least: float | None
    but: str | None


def standing(run: Trajectory) -> Standing | None:
    """How a run stands still at its end; None if it moves, or if its model is not known."""
    arc, sight = run.parts[-1], run.hindsight
    if sight is None or not isinstance(arc, Arc) or not arc.segments:
        return None
    part = len(run.parts) - 1
    field: Field = sight.at(part, arc.t1, "left").field(arc.mode)
    if not _motionless(run, arc, field):
        return None
    lag = sight.longest
    record = sight.record(part) if sight.lags else Record([])
    seen = sorted({element for each in field.code.seen for element in each})
    begun = arc.t0 if part or not sight.lags else -np.inf
    since = max(arc.t0, max(begun, _stands(record, arc, seen, _size(run))) + lag)
    loads = _loads(sight, part, arc)
    load, least = (min(loads[-1]), float(np.min(loads))) if loads else (None, None)
    return Standing(since, load, least, _but(run, arc, field, since, lag, loads))


def _size(run: Trajectory) -> np.ndarray:
    """Largest size of each element over the run."""
    states = [state for arc in run.arcs for state in (arc.first, arc.last)]
    return np.abs(states).max(axis=0)


def _motionless(run: Trajectory, arc: Arc, field: Field) -> bool:
    """Whether the flow is zero: what a contact holds to rounding, all else exactly."""
    rate = np.abs(field.rhs(arc.t1, arc.last.tolist()))
    held = np.zeros(len(rate), dtype=bool)
    for contact in field.held:
        pairs = field.code.pairing(contact)
        if len(pairs.positions) == 1:
            held[[*pairs.positions, *pairs.velocities]] = True
    terms = np.abs(np.array(arc.first)) + np.abs(field.rhs(arc.t0, arc.first.tolist()))
    allowed = ROUNDING * (1.0 + np.nan_to_num(terms) + _size(run)).max()
    return bool(np.all(rate <= np.where(held, allowed, 0.0)))


def _stands(record: Record, arc: Arc, seen: list[int], size: np.ndarray) -> float:
    """From when on the record shows the last state, in what is seen of it."""
    for piece in reversed(record.pieces):
        start = piece.start if np.isfinite(piece.start) else piece.end - 1.0
        states = piece.state(start, (piece.end - start) * LOOK)[:, seen]
        allowed = ROUNDING * size[seen]
        if np.any(np.abs(states - arc.last[seen]) > allowed):
            return piece.end
        if piece.degree > 64:
            return piece.end  # a function of the caller's may have been anything
    return -np.inf


def _loads(sight: Hindsight, part: int, arc: Arc) -> list[list[float]]:
    """Loads of the contacts held, along an arc."""
    found = []
    for segment in arc.segments:
        times = arc.t0 + arc.low + segment.start + segment.length * LOOK
        for t, x in zip(times.tolist(), segment.at(LOOK).tolist(), strict=True):
            field = sight.at(part, t).field(arc.mode)
            loads = [guard.value(t, x) for guard in field.guards if guard.kind == "release"]
            found += [loads] if loads else []
    return found


def _but(
    run: Trajectory, arc: Arc, field: Field, since: float, lag: float, loads: list[list[float]]
) -> str | None:
    """Why a run that stands still may move again; None if it cannot."""
    code, x = field.code, arc.last.tolist()
    if any(code.moving):
        return "a lag depends on time or state"
    if code.timed(field.closed):
        return f"the flow in {arc.mode} depends on time"
    for guard in field.guards:
        if code.timed(guard.closed):
            return f"the guard of {guard.edge} depends on time"
        near = AWAY * (np.max(loads) if guard.kind == "release" else 1.0 + np.abs(x).max())
        value = guard.value(arc.t1, x)
        if not (value > near if guard.kind == "release" else abs(value) > near):
            return f"the guard of {guard.edge} is {value:.6g} there, which is too near to zero"
    if since > arc.t1:
        return f"what is seen of the past changes until t = {since:.9g}, a lag of {lag:.6g} on"
    return None
