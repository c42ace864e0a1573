"""After the last impact permitted: what holds the bead, and where runs differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from hybrid.plot.figure import Columns, Curve, Figure, Panel, Slider, slid
from hybrid.plot.of_run import path

from ..claims import Claim, Number, verdict
from ..runs import ZERO, apart
from .cut import LATE, RATIOS, SPAN, Case, truncated


def stays(cases: Sequence[Case]) -> Claim:
    """Whether the bead stays on the wall."""
    few = [case for case in cases if case.impacts <= 4]
    places = [_places(case) for case in few]
    wall = few[0].model.wall
    holds = all(abs(at - wall) < ZERO for (at, _), _ in places)
    held = max(_off(case) for case in cases)
    return Claim(
        place="Section 2",
        says="For time `t > theta_[1/r]` the system is only governed by `x'' = f(x, x')`. "
        "Condition (C1) implies that on the interval `[theta_[1/r], theta_inf]` the bead stays on "
        "the position `x = phi`.",
        verdict=verdict(holds, mended=held == 0.0),
        found="Under that equation it does not: it leaves the wall with the speed of its last "
        "impact, rises, falls, and goes on through the wall, since f < 0 and nothing holds it; for "
        f"r = {few[0].label} it is at {places[0][0][0]:.10f} when the impacts of the full system "
        f"accumulate, at {places[0][1][0]:.10f} after {LATE:g} more. What the paper "
        "concludes is true of the contact held: its force balances f, and the bead stays at phi.",
        how="The state after the last permitted impact is simulated on without the contact; and "
        "the run with the contact held is read at 200 times from there on. (C1) is the sign of f, "
        "and only says that the bead, once lifted, comes down.",
        numbers=[
            row
            for case, (first, second) in zip(few, places, strict=True)
            for row in (
                Number(what=f"r = {case.label}: x at `theta_inf`", ours=first[0], error=first[1]),
                Number(what=f"and {LATE:g} later", ours=second[0], error=second[1]),
            )
        ]
        + [Number(what="contact held: largest `|x - phi|`, for all r", ours=held)],
        figures=[pictures(cases)],
    )


def _off(case: Case) -> float:
    """How far the bead ever is from the wall, with the contact held."""
    times = np.linspace(case.run.zeno[0].t, SPAN[1], 200)
    return float(np.max(np.abs(case.run(times).x - case.model.wall)))


def _places(case: Case) -> list[tuple[float, float]]:
    """Places without a contact, with their errors: at ``theta_inf``, and later."""
    one, other = case.alone
    first, second = case.cuts
    pairs = (one(first.gap).x, other(second.gap).x), (one.final.x, other.final.x)
    return [(float(a), apart(a, b)) for a, b in pairs]


def pictures(cases: Sequence[Case]) -> Figure:
    """The three readings, with r to slide."""
    stops = [(case.label, _columns(case)) for case in cases]
    title = "Example 1: all impacts; at most [1/r], then held; at most [1/r], then no contact"
    slider = Slider(label="r", stops=stops, start=RATIOS.index("0.5"))
    return slid(slider, name="transient", title=title)


def _columns(case: Case) -> Columns:
    return (
        (_state(case, 0, "x"), _state(case, 1, "v")),
        (_left(case),),
    )


def _state(case: Case, index: int, name: str) -> Panel:
    """An element of the state over time, as a share of ``t_inf``."""
    t_inf, end = case.cuts[0].t_inf, 1.25
    curves = path(case.run, index, look="other", name="at most [1/r], held", points=600)
    since, tau = case.run.zeno[0].t, np.linspace(0.0, min(case.gap + LATE, 2.0 * t_inf), 400)
    x, v = case.alone[0](tau)
    shown = np.where(x > case.model.wall - 0.05, (x, v)[index], np.nan)
    free = Curve(x=since + tau, y=shown, look="dashed", name="at most [1/r], no contact")
    curves += [free, *path(case.full, index, name="all impacts", points=600)]
    panel = []
    for curve in curves:
        x = np.minimum(curve.x, end * t_inf) if curve.look.endswith("rest") else curve.x
        inside = ~(x > end * t_inf)
        panel.append(attrs.evolve(curve, x=x[inside] / t_inf, y=curve.y[inside]))
    return Panel(curves=panel, x="t / theta_inf", y=name)


def _left(case: Case) -> Panel:
    """The time that is left after each impact, to ``theta_inf``."""
    more = truncated(case.model, case.impacts + 10)
    curves = [
        Curve(x=n, y=left, look=look, name=name)
        for run, look, name in (
            (more, "other series", "all impacts, in order"),
            (case.run, "series", "permitted"),
        )
        for n, left in [_remaining(run)]
    ]
    return Panel(curves=curves, x="impact i", y="theta_inf - theta_i", log="y")


def _remaining(run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the impacts of a run that is cut off, and the time left after each."""
    flights = [arc.length for arc in run.arcs if arc.mode == "flight" and arc.j > 0]
    lengths = [*(length for length in flights if length > 0.0), run.zeno[0].truncation.gap]
    return np.arange(1, len(lengths) + 1), np.cumsum(lengths[::-1])[::-1]


def coincide(cases: Sequence[Case]) -> Claim:
    """The full run and that cut off, before the last impact and after the accumulation."""
    before = max(_differ(case) for case in cases)
    after = max(
        float(np.max(np.abs(np.subtract(case.full(t), case.run(t)))))
        for case in cases
        for t in [np.linspace(case.cuts[0].t_inf + 1e-12, SPAN[1], 50)]
    )
    least = min(case.cuts[0].height for case in cases)
    return Claim(
        place="Section 2",
        says="Solutions of the last system and of the full system with identical initial data "
        "coincide on `[0, theta_[1/r])`. They are different only in `[theta_[1/r], theta_inf]`.",
        verdict=verdict(before < ZERO and after == 0.0 and least > 0.0),
        found="They do: up to the last permitted impact the runs agree to rounding, and from "
        "`theta_inf` on, where the contact is held in both, exactly.",
        how="States and lengths of flights compared, flight by flight at 33 points, as many as "
        f"doubles tell apart, for r = {', '.join(RATIOS)}; the full runs are summed from an early "
        "impact on, the others simulated impact by impact.",
        numbers=[
            Number(
                what="largest difference before `theta_[1/r]`", ours=f"{max(before, 1e-16):.0e}"
            ),
            Number(what="largest difference after `theta_inf`", ours=after),
        ],
    )


def _differ(case: Case) -> float:
    """The largest difference of states and of lengths, over the flights of both runs."""
    shares, worst = np.linspace(0.0, 1.0, 33), 0.0
    arcs = [[a for a in run.arcs if a.mode == "flight"] for run in (case.full, case.run)]
    for one, other in list(zip(*arcs, strict=False))[: case.impacts]:
        states = one.local(shares * one.length) - other.local(shares * other.length)
        worst = max(worst, float(np.max(np.abs(states))), abs(one.length - other.length))
    return worst
