"""Cut a run where it meets a section, or behind the event on which it starts."""

from __future__ import annotations

from bisect import bisect_right

import attrs

from ..result import Trajectory
from ..run.sections import Return
from ..trajectory.arcs import Arc, Part
from ..trajectory.clock import Instant
from ..trajectory.log import Log
from ..trajectory.trajectory import Status


def cut(run: Trajectory, at: Return) -> Trajectory:
    """The run up to a return; if the return is a jump, up to the state just after it."""
    part = run.parts[at.part]
    jump = run.own_jumps.get(at.part)
    kept: list[Part] = list(run.parts[: at.part])
    jumps = {index: row for index, row in run.own_jumps.items() if index < at.part}
    if isinstance(part, Arc) and at.tau >= part.length and jump is not None:
        after = run.parts[at.part + 1]
        end = Arc(after.mode, part.j + 1, jump.t, jump.low, 0.0, jump.t, jump.after, jump.after, ())
        kept, jumps[at.part] = [*kept, part, end], jump
    else:
        if not isinstance(part, Arc):
            kept += [part.arc(n) for n in range(at.flight)]
            jumps |= {at.part + n: part.jump(n + 1) for n in range(at.flight)}
            part = part.arc(at.flight)
        segments = part.segments
        last = bisect_right([segment.start for segment in segments], at.tau) - 1
        rest = at.tau - segments[last].start
        shorter = [*segments[:last], *([segments[last].cut(rest)] if rest else [])]
        t1, last_state = Instant(part.t0, part.low).after(at.tau).t, part.local(at.tau)
        kept.append(attrs.evolve(part, length=at.tau, t1=t1, last=last_state, segments=shorter))
    t1 = kept[-1].t1
    zeno = [point for point in run.zeno if point.t <= t1]
    grazings = [grazing for grazing in run.grazings if grazing.t <= t1]
    return attrs.evolve(
        run, log=Log(kept, jumps), zeno=zeno, grazings=grazings, status=Status.REACHED_END
    )


def behind(run: Trajectory, edge: str) -> Trajectory | None:
    """The run of no length that ends with the event ``edge``, for a run that starts on its guard;
    None for any other run.

    A state just after an event lies on its guard, and a run from there meets the event again. One
    that continues the run returned does not. Its state is the one given: the event is over.
    """
    first, row = run.parts[0], run.own_jumps.get(0)
    if row is None or row.edge != edge or not isinstance(first, Arc) or first.length:
        return None
    field = run.hindsight.at(0, run.t0).field(first.mode)
    if not any(guard.edge == edge and not guard.bounds for guard in field.guards):
        return None
    found = cut(run, Return(0, 0.0))
    last = found.parts[1]
    assert isinstance(last, Arc)
    last = attrs.evolve(last, first=row.before, last=row.before)
    log = Log([first, last], {0: attrs.evolve(row, after=row.before)})
    return attrs.evolve(found, log=log)
