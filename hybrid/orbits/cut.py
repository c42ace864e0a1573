"""Cut a run where it meets a section."""

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
        shorter = [*segments[:last], segments[last].cut(at.tau - segments[last].start)]
        t1, last_state = Instant(part.t0, part.low).after(at.tau).t, part.local(at.tau)
        kept.append(attrs.evolve(part, length=at.tau, t1=t1, last=last_state, segments=shorter))
    t1 = kept[-1].t1
    zeno = [point for point in run.zeno if point.t <= t1]
    grazings = [grazing for grazing in run.grazings if grazing.t <= t1]
    return attrs.evolve(
        run, log=Log(kept, jumps), zeno=zeno, grazings=grazings, status=Status.REACHED_END
    )
