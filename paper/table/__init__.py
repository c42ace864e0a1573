"""Section 3 of the paper: a bead on a vibrating table, Example 2."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from hybrid.plot.figure import Curve, Figure, Panel, column
from hybrid.result import Trajectory

from ..claims import Claim, Number, Section, known, rounds_to, verdict
from ..runs import flight_figure, twice
from .bead import (
    FASTEST,
    HEIGHT,
    LOW,
    by_lemma,
    by_theorem,
    covered_from,
    fastest,
    held_still,
    impacts,
    model,
    printed,
    printed_again,
    table,
    turned,
)

#: What is told of the first impact.
FIRST = ("time", "relative velocity before", "relative velocity after")


def section() -> Section:
    """All claims of section 3."""
    return Section(
        name="table",
        title="3. A bead on a sinusoidally vibrating table",
        about="A bead under gravity over a table that moves as X(t) = X0 sin(omega t), with "
        "Newton's law of impact relative to the table. Here and in section 4 much rests on a lemma "
        "that the paper does not have, the lemma without (C2): let a body leave its obstacle with "
        "relative speed v, and let its relative acceleration stay between -M and -m < 0 up to the "
        "height v^2 / (2 m) and the speed v sqrt(M / m). Then it comes back, with a speed of at "
        "most v sqrt(M / m), after at most 2 v / m. So if r sqrt(M / m) < 1, the impacts "
        "accumulate. The obstacle may move, the force may depend on the time.",
        claims=[law(), flat(), force(), inequality(), example_2(), start(), domain(), contact()],
    )


# ---------------------------------------------------------------------------------------
# claims


def law() -> Claim:
    """The two ways in which the law of impact is written are one."""
    own = model()
    run = printed()
    _, before, after = impacts(run)
    worst = float(np.max(np.abs(after + own.r * before)))
    return Claim(
        place="Section 3, the model of the table",
        says="r = (X'+ - x'+) / (x'- - X'-) with X'- = X'+, so that the jump of x' is -(1 + r) "
        "(x' - X')",
        verdict=verdict(worst < 1e-12),
        found=f"Both are one law: at the {len(run.jumps)} impacts listed the velocity relative to "
        f"the table after an impact is -{own.r:g} times that before, to {worst:.0e}.",
        how="Solving the first for x'+ gives x'+ = X' - r (x'- - X'), which is the second. "
        "Relative velocities before and after each impact of the run were compared.",
        numbers=[Number(what="largest difference of a relative velocity", ours=f"{worst:.0e}")],
    )


def flat() -> Claim:
    """Theorem 1 near the top of the table's motion."""
    own, proof, asked = model(), by_lemma(), by_theorem()
    top, low = pi / (2 * own.omega), turned().zeno[0].t
    return Claim(
        place="Section 3, before Example 2, Figure 2",
        says="for small omega and t near pi / (2 omega) the graph of X is close to a horizontal "
        "line; consequently, if M sqrt(2 (h - X0/10) / m) < h_bar, there is chattering according "
        "to Theorem 1 for solutions near the point (pi / (2 omega), X0)",
        verdict=verdict(asked.verdict == "certified", proof.verdict == "certified"),
        found="The theorem does not apply: its wall does not move, and a table that is close to "
        "horizontal for a while moves all the same before the impacts have accumulated: from "
        f"height {HEIGHT:g} over its top at t = {top:.6f} they do so at t = {low:.6f}, where the "
        f"table is at {table(low)[0]:.6f}. The conclusion holds for the bead of Example 2, and at "
        "every phase: relative to the table its acceleration stays between -M and -m with "
        "r sqrt(M / m) < 1. (For other f, (C1) and a small enough omega keep it below zero too, so "
        "that slow impacts chatter; that was not computed.)",
        how=f"hy.certify was asked for Theorem 1 ({asked.verdict}: {asked.reason}), then for the "
        f"lemma without (C2) in relative coordinates over two periods ({proof.verdict}).",
        numbers=[
            Number(what="m, relative to the table", ours=known(proof.m)),
            Number(what="M, relative to the table", ours=known(proof.M)),
            Number(what="r sqrt(M / m), which must be below 1", ours=known(proof.left)),
            Number(what="margin", ours=known(proof.margin)),
            Number(what="proved for relative speeds up to", ours=fastest(proof)),
        ],
        figures=[table_figure()],
    )


def force() -> Claim:
    """|f| = g = M = m, and (C1) is strict."""
    own, proof = model(), held_still()
    low, high = proof.m_range or (np.nan, np.nan)
    return Claim(
        place="Section 3, Example 2",
        says="f(x, x') = -g < 0, |f(x, x')| = g = M = m",
        verdict=verdict(low < own.g < high, low < high),
        found="M = g, but (C1) wants f < -m, so that m = g is not allowed. Any m between "
        f"{low:.10g} and {high:.10g}, both excluded, is allowed by (C1) and by the inequality.",
        how="hy.certify, Theorem 1, for this bead over a floor at rest with the same h - phi: its "
        "m_range.",
        numbers=[
            Number(what="M", ours=known(proof.M), paper=f"{own.g:g}"),
            Number(what="m, least", ours=low),
            Number(what="m, largest", ours=high, paper=f"{own.g:g}"),
        ],
    )


def inequality() -> Claim:
    """M sqrt(2 (h - X0/10) / m) = sqrt(37.24) < 7."""
    proof = held_still()
    left = proof.left or np.nan
    return Claim(
        place="Section 3, Example 2",
        says="M sqrt(2 (h - X0/10) / m) = sqrt(37.24) < 7",
        verdict=verdict(rounds_to(left**2, "37.24") and left < FASTEST),
        found=f"{left:.10f}, whose square is {left**2:.10f}.",
        how="Computed by hy.certify with intervals, over a floor at rest: there the inequality "
        "means what Theorem 1 says.",
        numbers=[
            Number(what="left side", ours=left),
            Number(what="its square", ours=left**2, paper="37.24"),
            Number(what="margin to 7", ours=known(proof.margin)),
        ],
    )


def example_2() -> Claim:
    """The solution of Example 2 chatters, by the lemma and not by Theorem 1."""
    run, proof, asked = printed(), by_lemma(), by_theorem()
    point, first = run.zeno[0], covered_from(run)
    again = printed_again()
    least = min(p.t for p in point.proofs) if point.proofs else np.nan
    own = int(np.argmin(np.abs(run.jumps.t - least))) + 1
    return Claim(
        place="Section 3, Example 2, Figure 4",
        says="with x(2 pi / omega) = 1.9, x'(2 pi / omega) = 0, r = 0.9, omega = 0.29 the "
        "conditions of Theorem 1 are satisfied and consequently this solution is chattering",
        verdict=verdict(asked.verdict == "certified", point.verdict == "certified" and bool(first)),
        found=f"The solution chatters, and the impacts accumulate at t = {point.t:.10f}; but not "
        f"by Theorem 1, which is for a wall at rest. Relative to the table, from impact {first} "
        "on every motion of this speed is proved to chatter by the lemma without (C2), before any "
        f"run; during the run the impacts are proved to accumulate from impact {own} on, in a box "
        "around that impact.",
        how="Simulated with Taylor series to rounding; the error bound is measured against a "
        "second run. Speed and time of each impact were compared with what the certificate covers "
        f"(relative speed up to {fastest(proof):.10g}, at any phase of the table).",
        numbers=[
            Number(what="t_inf", ours=point.t, error=point.t_error),
            Number(what="table there", ours=point.state.x, error=point.state_error.x),
            Number(what="its velocity", ours=point.state.v, error=point.state_error.v),
            *(
                twice(f"first impact, {what}", one[0], other[0])
                for what, one, other in zip(FIRST, impacts(run), impacts(again), strict=True)
            ),
            Number(what="r sqrt(M / m) on the certificate's box", ours=known(proof.left)),
            Number(what="proof in the run, from the impact at t", ours=least),
        ],
        figures=[coordinates(run, "example-2", "Example 2: from x = 1.9 at t = 2 pi / omega")],
    )


def start() -> Claim:
    """Example 2 does not start where the argument was made."""
    own = model()
    here, there = printed(), turned()
    fast = table(here.t0)[1]
    near = abs(fast) < 0.1 * own.amplitude * own.omega
    points = [run.zeno[0] for run in (here, there)]
    speeds = [impacts(run)[1][0] for run in (here, there)]
    return Claim(
        place="Section 3, Example 2",
        says="(implied) Example 2, which starts at t = 2 pi / omega, is a case of the argument for "
        "times near pi / (2 omega), when the table is close to horizontal",
        verdict=verdict(near, all(p.verdict == "certified" for p in points)),
        found=f"At t = 2 pi / omega the table passes X = 0 with {fast:.10g}, its greatest speed, "
        "X0 omega; at pi / (2 omega) it stands still at X0. From height 1.9 the "
        f"impacts accumulate from both: {points[0].t - here.t0:.10f} after the first start, "
        f"{points[1].t - there.t0:.10f} after the second.",
        how="The table's velocity at both times; both runs, each with its proof.",
        numbers=[
            Number(what="table's speed at 2 pi / omega", ours=float(fast)),
            Number(what="t_inf from 2 pi / omega", ours=points[0].t, error=points[0].t_error),
            Number(what="first relative velocity", ours=speeds[0]),
            Number(what="t_inf from pi / (2 omega)", ours=points[1].t, error=points[1].t_error),
            Number(what="first relative velocity, second start", ours=speeds[1]),
        ],
        figures=[coordinates(there, "example-2-top", "From x = 1.9 at t = pi / (2 omega)")],
    )


def domain() -> Claim:
    """The motion leaves the domain of Example 2 at impact 21."""
    run = printed()
    t, x, again = run.jumps.t, run.jumps.before.x, printed_again().jumps
    out = np.flatnonzero(x < LOW)
    place = int(out[0]) if out.size else -1
    quickest = float(np.max(np.abs(run.jumps.before.v)))
    return Claim(
        place="Section 3, Example 2",
        says="consider the domain 0.1 <= x <= 2, |x'| < 7",
        verdict=verdict(not out.size, by_lemma().verdict == "certified"),
        found=f"The motion leaves it: at impact {place + 1}, t = {t[place]:.10f}, the table is at "
        f"{x[place]:.10f}, and it goes on down to -1. The greatest speed is {quickest:.6f}. "
        "Relative to the table the motion stays in gap <= 2, speed <= 7, as the certificate by the "
        "lemma proves. (With phi = X0 = 1, as the example sets it, the domain would begin at 1; "
        "the inequality has X0 / 10 in the place of phi.)",
        how="Heights at the impacts of the run; between impacts the bead is above the table. "
        "Errors are three times the distance to a run with another method (DOP853).",
        numbers=[
            Number(what="impact at which x < 0.1", ours=place + 1),
            twice("its time", t[place], again.t[place]),
            twice("its height", x[place], again.before.x[place], "at least 0.1"),
            Number(what="largest |x'| at an impact", ours=quickest, paper="below 7"),
        ],
    )


def contact() -> Claim:
    """After the accumulation the bead stays on the table for ever."""
    own, run, proof = model(), printed(), by_lemma()
    point = run.zeno[0]
    exact = own.g - own.amplitude * own.omega**2
    stays = (proof.m or 0.0) > 0.0 and point.t_release is None and ".rest(" in run.mode
    return Claim(
        place="Introduction, of impact chattering",
        says="the impacts end in a finite time with establishing a long contact between the bodies",
        verdict=verdict(stays),
        found="On this table the contact lasts for ever: its force on a unit of mass, g + X'', is "
        f"never below g - X0 omega^2 = {exact:.10g}. The run is at rest on the moving table at "
        f"its end, and moves as it does: x - X = {run.final.x - table(run.t1)[0]:.1g}.",
        how="g + X'' = -(acceleration of the gap), bounded over two periods of the table by "
        "hy.certify; the closed form beside it.",
        numbers=[
            Number(what="force per mass, at least (proved)", ours=known(proof.m)),
            Number(what="g - X0 omega^2", ours=exact),
            Number(what="largest X0 for which it holds at this omega", ours=own.g / own.omega**2),
            Number(what="largest omega at this X0", ours=sqrt(own.g / own.amplitude)),
        ],
    )


# ---------------------------------------------------------------------------------------
# figures


def coordinates(run: Trajectory, name: str, title: str) -> Figure:
    """Coordinates with the table, relative speeds at the impacts, gaps in time."""
    return flight_figure(run, name, title, speeds_panel(run))


def speeds_panel(run: Trajectory) -> Panel:
    """Relative speeds after the impacts, which the certificate speaks of."""
    after = impacts(run)[2]
    kept = after > 1e-10
    number = np.arange(1, len(after) + 1)[kept]
    bound = fastest(by_lemma())
    curves = [
        Curve(x=number, y=after[kept], look="series"),
        Curve(x=[1, len(number)], y=[bound] * 2, look="dashed", name="chatters below: proved"),
    ]
    return Panel(curves=curves, x="jump", log="y", title="speed relative to the table")


def table_figure() -> Figure:
    """The table over one period, and where the motions of this section take place on it."""
    own = model()
    period = 2 * pi / own.omega
    t = np.linspace(0.0, 1.6 * period, 1000)
    curves = [Curve(x=t, y=table(t)[0], look="surface", name="table")]
    for run, look, name in (
        (turned(), "other rest", "chattering from pi / (2 omega)"),
        (printed(), "rest", "chattering from 2 pi / omega"),
    ):
        t = np.linspace(run.t0, run.zeno[0].t, 400)
        curves.append(Curve(x=t, y=table(t)[0], look=look, name=name))
    curves.append(
        Curve(x=[0.25 * period], y=[own.amplitude], look="point", name="P of the paper's Figure 2")
    )
    curves.append(Curve(x=[0.0, 1.6 * period], y=[LOW] * 2, look="dashed", name="X0 / 10"))
    return Figure(
        name="table",
        title="Where the table is while the bead chatters",
        columns=column(Panel(curves=curves, y="X")),
        zooms=[("the paper's Figure 2", (0.0, 0.5 * period))],
    )
