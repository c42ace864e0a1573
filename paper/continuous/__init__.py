"""Section 5 of the paper: an oscillator driven by a chattering ball."""

from __future__ import annotations

from math import exp, sqrt

import attrs
import numpy as np

from hybrid import gallery
from hybrid.plot.figure import Curve, Figure, Panel, column
from hybrid.plot.of_run import path, states_panel, zooms

from ..claims import Claim, Number, Section, verdict
from .oscillator import (
    DRIVE,
    LOOKS,
    C,
    K,
    Turn,
    chattering,
    error_of,
    extrema,
    flown,
    force,
    jerk,
    limit_state,
    nearest_miss,
    oscillates,
    peaks,
    pull,
    settled_from,
    stays_after,
)

#: How far the figures go, and points a curve, about.
SHOWN, POINTS = 25.0, 1500

#: Where the last figure ends: nearer to t_inf the error of the limit of x4' would show.
NEAR = 1e-3


def section() -> Section:
    """All claims of section 5."""
    return Section(
        name="continuous",
        title="5. Continuous chattering",
        about="A ball over a floor at x1 = 1; the square of its speed drives x3'' + 3 x3' + 2 x3.",
        claims=[unilateral(), stable(), oscillations(), acceleration()],
    )


# ---------------------------------------------------------------------------------------
# claims


def unilateral() -> Claim:
    """The ball chatters, and nothing comes back to it from the oscillator."""
    run, own = flown(), gallery.find("coupled").cls()
    point = run.zeno[0]
    first = sqrt(2.0 * (gallery.find("coupled").start["x1"] - 1.0) / own.g)
    exact = first * (1.0 + own.r) / (1.0 - own.r)
    count = 40
    times = first * (1.0 + 2.0 * own.r * (1.0 - own.r ** np.arange(count)) / (1.0 - own.r))
    worst = float(np.max(np.abs(run.jumps.t[:count] - times)))
    return Claim(
        place="Section 5, after Figure 7",
        says="the coupling is unilateral: the second equation does not influence the first; x1 "
        "and x2 chatter as before",
        verdict=verdict(abs(point.t - exact) <= point.t_error and worst < 1e-11),
        found=f"x1 and x2 are the ball's alone: its first {count} impacts are those of the ball's "
        f"closed form to {worst:.0e}, and they accumulate at t = {point.t:.12f}.",
        how="t_inf of the coupled run beside sqrt(2 h / g) (1 + r) / (1 - r), h = 5.",
        numbers=[
            Number(what="t_inf", ours=point.t, error=point.t_error),
            Number(what="closed form", ours=exact),
        ],
        figures=[coordinates()],
    )


def stable() -> Claim:
    """The oscillator has an asymptotically stable equilibrium."""
    run = flown()
    point = run.zeno[0]
    roots = np.sort(np.roots([1.0, C, K]))
    x3, x4 = float(point.state.x3), float(point.state.x4)
    left = run.t1 - point.t
    slow, fast = 2.0 * x3 + x4, -(x3 + x4)
    exact = slow * exp(-left) + fast * exp(-2.0 * left)
    return Claim(
        place="Section 5, the mass-spring-damper",
        says="if the characteristic equation has roots with negative real parts, the equilibrium "
        "is asymptotically stable; m = 1, c = 3, k = 2",
        verdict=verdict(
            bool(np.all(roots < 0)) and bool(abs(run.final.x3 - exact) < 1e-4 * abs(exact))
        ),
        found=f"The roots are {roots[1]:g} and {roots[0]:g}. After the accumulation the ball is "
        f"at rest and the oscillator is free: at t = {run.t1:g}, x3 = {run.final.x3:.10g}, where "
        f"the free motion from its state at t_inf gives {exact:.10g}.",
        how="Roots of s^2 + 3 s + 2; the run, carried on at rest on the floor, beside a exp(-s) + "
        "b exp(-2 s) from its state at t_inf.",
        numbers=[
            Number(what="x3 at t_inf", ours=x3, error=float(point.state_error.x3)),
            Number(what="x4 at t_inf", ours=x4, error=float(point.state_error.x4)),
            Number(what="x3 at t = 1", ours=float(run(1.0).x3)),
            Number(what="x4 at t = 1", ours=float(run(1.0).x4)),
            Number(what="x3 at t = 10", ours=float(run(10.0).x3)),
            Number(what="x4 at t = 10", ours=float(run(10.0).x4)),
        ],
    )


def oscillations() -> Claim:
    """x3 and x4 have finitely many extrema; only x4' oscillates for ever."""
    run = flown()
    point, counts = run.zeno[0], extrema(run)
    (third, again3), (fourth, again4) = counts["x3"], counts["x4"]
    limit, number = float(pull(limit_state(run))), settled_from(run)
    agreed = len(third) == again3 and len(fourth) == again4
    after = stays_after(limit_state(run))
    ends = agreed and number < len(run.jumps) and after
    return Claim(
        place="Section 5 and Conclusion, Figure 7",
        says="continuous chattering, understood as infinitely many oscillations in a finite time, "
        "appears in the second system when it is driven by a chattering solution",
        verdict=verdict(abs(limit) <= error_of(point, K, C), ends and oscillates(run)),
        found=f"x3 has {len(third)} extrema and x4 has {len(fourth)}, the last at t = "
        f"{third[-1].t:.6f} and {fourth[-1].t:.6f}; none follow, before the accumulation or after "
        "it. What oscillates infinitely often is the acceleration x4' (below).",
        how="Extrema of x3 are changes of sign of x4; those of x4 are changes of sign of x4', "
        f"within flights and where x4' jumps at impacts. Each flight was looked at {LOOKS} and "
        f"{2 * LOOKS} times, with the same counts; within a flight x4 and x4' are of the form a "
        "exp(-t) + b exp(-2 t) + a parabola, with at most four zeros, and where x4' turns without "
        f"reaching zero it stays {nearest_miss(run, force):.3g} away at least. No more can come: "
        f"x4' is at least p = -2 x3 - 3 x4, which tends to {limit:.10f}. From impact {number} on "
        "p is nearer to that limit than the limit is to zero, so that x4' > 0, and x4 rises to "
        f"{limit_state(run)[3]:.10f}: it stays below zero, and x3 falls. After t_inf both go on "
        "so: x4' and -x4 are there of the form a exp(-s) - b exp(-2 s) with a > b > 0.",
        numbers=[
            Number(what="extrema of x3", ours=len(third), paper="infinitely many"),
            Number(what="extrema of x4", ours=len(fourth), paper="infinitely many"),
            Number(what="of these at impacts", ours=sum(turn.jumps for turn in fourth)),
            Number(what="last extremum of x3 at t", ours=third[-1].t),
            Number(what="last extremum of x4 at t", ours=fourth[-1].t),
            Number(what="limit of x4'", ours=limit, error=error_of(point, K, C)),
            Number(what="x4' > 0 by the estimate from impact", ours=number),
        ],
        figures=[extrema_figure(third, fourth)],
    )


def acceleration() -> Claim:
    """x4' rises before and falls at every impact from some on."""
    run = flown()
    own, point = gallery.find("coupled").cls(), run.zeno[0]
    limit, rate = float(pull(limit_state(run))), float(jerk(limit_state(run)))
    error = error_of(point, C * K, C * C - K)
    return Claim(
        place="Section 5",
        says="by the argument of the periodicity theorem one can expect continuous chattering in "
        "a system with a stable equilibrium that is driven by a chattering solution",
        verdict=verdict(abs(limit) <= error_of(point, K, C), oscillates(run)),
        found="A bounded drive gives x4 a bounded derivative, which has a limit as the drive "
        "vanishes, so that x3 and x4 are monotone near t_inf unless that limit is zero. x4' does "
        f"oscillate infinitely often here: at every impact it falls by {DRIVE:g} (1 - r^2) v^2, "
        "and before every impact it rises, with a slope of at least (6 x3 + 7 x4) > 0 near t_inf: "
        f"the limit is {rate:.3e}. It is small because a drive that fell as the square of the "
        "time left would give 0, and what is left of the start decays as exp(-t); were it "
        "negative, x4' would in the end fall all the time.",
        how="On a flight x4' has the slope 6 x3 + 7 x4 - 60 x2^2 - 40 g x2, which before an "
        "impact at speed v is 6 x3 + 7 x4 + 40 g v - 60 v^2. Its limit was computed from the "
        "state at t_inf, with the error bounds of that; the slopes and falls at the impacts "
        "listed agree.",
        numbers=[
            Number(what="6 x3 + 7 x4 at t_inf", ours=rate, error=error),
            Number(what="40 g", ours=40.0 * own.g),
            Number(what="impacts listed, each with a rise and a fall", ours=peaks(run)),
        ],
        figures=[acceleration_figure()],
    )


# ---------------------------------------------------------------------------------------
# figures


def coordinates() -> Figure:
    """The paper's figure: all four coordinates."""
    run = flown()
    names = run.spec.element_names
    panels = [_until(states_panel(run, name, points=POINTS), SHOWN) for name in names]
    return Figure(
        name="coupled",
        title="The coordinates of the coupled system",
        columns=column(*panels),
        zooms=[("whole run", (0.0, SHOWN)), *zooms(run)[1:]],
    )


def extrema_figure(third: list[Turn], fourth: list[Turn]) -> Figure:
    """x3 and x4 with their extrema."""
    run = flown()
    panels = []
    for name, index, found in (("x3", 2, third), ("x4", 3, fourth)):
        dots = Curve(
            x=[turn.t for turn in found],
            y=[turn.state[index] for turn in found],
            look="point",
            name="extremum",
            notes=[f"extremum {n} at t = {turn.t:.12g}" for n, turn in enumerate(found, start=1)],
        )
        panel = Panel(curves=[*path(run, index, points=POINTS), dots], y=name)
        panels.append(_until(panel, SHOWN))
    return Figure(
        name="coupled-extrema",
        title=f"x3 and x4 have {len(third)} and {len(fourth)} extrema",
        columns=column(*panels),
        zooms=[("whole run", (0.0, SHOWN)), ("the last extrema", (16.0, 20.0))],
    )


def acceleration_figure() -> Figure:
    """x4' over time, and its distance to the limit over the time that is left."""
    run = flown()
    t_inf, limit = run.zeno[0].t, float(pull(limit_state(run)))
    over, scaled, jumps = [], [], []
    for arc in chattering(run):
        grid = np.linspace(0.0, arc.length, 24)
        values, left = force(arc.local(grid)), t_inf - (arc.t0 + (arc.low + grid))
        over.append((arc.t0 + grid, values))
        keep = left > NEAR
        scaled.append((left[keep], (values[keep] - limit) / left[keep] ** 2))
        jumps.append((arc.t0, values[0]))
    gap = np.array([np.nan])
    t, x = (np.concatenate([np.append(part[k], gap) for part in over]) for k in (0, 1))
    left, ratio = (np.concatenate([np.append(part[k], gap) for part in scaled]) for k in (0, 1))
    marks = np.array(jumps[1:]).T
    time = Panel(
        curves=[
            Curve(x=t, y=x, name="x4'"),
            Curve(x=marks[0], y=marks[1], look="impact", name="after an impact"),
            Curve(x=[0.0, t_inf], y=[0.0, 0.0], look="surface"),
        ],
        y="x4'",
    )
    near = Panel(
        curves=[Curve(x=left, y=ratio)],
        x="t_inf - t",
        y="(x4' - limit) / (t_inf - t)^2",
        log="x",
        reverse=True,
    )
    return Figure(
        name="coupled-acceleration",
        title="x4' rises before every impact and falls at it",
        columns=column(time, near),
        zooms=[("last 3", (t_inf - 3.0, t_inf))],
    )


def _until(panel: Panel, end: float) -> Panel:
    """A panel's curves as far as a time."""
    curves = []
    for curve in panel.curves:
        keep = ~(curve.x > end)
        notes = [n for n, k in zip(curve.notes, keep, strict=True) if k] if curve.notes else ()
        curves.append(attrs.evolve(curve, x=curve.x[keep], y=curve.y[keep], notes=notes))
    return attrs.evolve(panel, curves=curves)
