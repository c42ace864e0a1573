"""Introduction and section 1 of the paper; the theorem and its proof have files of their own."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from hybrid import gallery
from hybrid.lowering import scene_of
from hybrid.orbits.search import depends_on_time
from hybrid.plot.figure import Figure, column
from hybrid.plot.of_run import approach_panel, gaps_panel, states_panel, zooms
from hybrid.simulation import simulate

from ..claims import Claim, Number, Section, verdict
from ..runs import FINE, POINTS, ZERO, Spring, twice
from . import proof, theorem


def section() -> Section:
    """All claims of the introduction and of section 1."""
    spring = Spring.made()
    return Section(
        name="existence",
        title="Introduction and 1. Existence of chattering",
        about="A body under a force `f(x, x')` over a fixed wall, with Newton's law of impact. "
        "Theorem 1 tells from the force alone that all motions from rest chatter; Example 1 is "
        "`x'' = -cos x' - x^3` over a wall at 2.",
        claims=[
            ball(),
            autonomous(),
            *theorem.claims(spring),
            example_1(spring),
            *proof.claims(spring),
        ],
    )


# ---------------------------------------------------------------------------------------
# the introduction


def ball() -> Claim:
    """A ball over a floor."""
    entry = gallery.find("bouncing_ball")
    model, height = entry.cls(), entry.start["x"]
    run = simulate(model, entry.start, entry.until, **FINE)
    point, impacts = run.zeno[0], run.jumps
    exact = sqrt(2 * height / model.g) * (1 + model.r) / (1 - model.r)
    speeds = sqrt(2 * height * model.g) * model.r ** np.arange(1, len(impacts) + 1)
    off = float(np.max(np.abs(impacts.after.v / speeds - 1)))
    rests = run.mode == "flight.rest(impact)" and run.final.x == 0.0
    agrees = abs(point.t - exact) <= point.t_error and off < ZERO
    return Claim(
        place="Introduction",
        says="A body falling on a fixed horizontal base bounces with `r` times its speed, "
        "`0 < r < 1`. The process cannot end in a finite number of collisions; it ends in a finite "
        "time with establishing a long contact.",
        verdict=verdict(agrees and rests and point.verdict == "certified"),
        found=f"Dropped from {height:g} m with r = {model.r:g}, it meets the floor infinitely "
        f"often until t = {point.t:.12f}, and lies there from then on.",
        how="Simulated through the accumulation, which is proved in that run by interval "
        "arithmetic, and compared with closed forms: `sqrt(2 h / g) (1 + r) / (1 - r)`, and "
        f"`r^n sqrt(2 g h)`, never zero, after the n-th of {len(impacts)} impacts that doubles "
        "tell apart. (The paper's H wants a base above 0; its proof never uses that.)",
        numbers=[
            Number(what="`t_inf`", ours=point.t, error=point.t_error),
            Number(what="`t_inf`, closed form", ours=exact),
            Number(what="speeds: largest relative error", ours=f"{max(off, 1e-16):.0e}"),
            Number(what="at the end of the run", ours="at rest" if rests else run.mode),
        ],
        figures=[
            Figure(
                name="ball",
                title=f"A ball from {height:g} m, r = {model.r:g}",
                columns=column(
                    states_panel(run, "x", points=POINTS), states_panel(run, "v", points=POINTS)
                ),
                zooms=zooms(run),
            )
        ],
    )


#: The paper's systems, in its order.
SYSTEMS = {
    "Example 1": "hard_spring",
    "the bead on the vibrating table (section 3)": "bead_on_table",
    "the forced beam (section 4)": "moon_holmes",
    "the coupled system (section 5)": "coupled",
    "the controlled system (section 6)": "pyragas",
}


def autonomous() -> Claim:
    """Which systems depend on time, read off the traces of their functions."""
    kinds = {name: _dependence(gallery.find(file).cls()) for name, file in SYSTEMS.items()}
    own = [name for name, kind in kinds.items() if kind == "neither"]
    timed = [name for name, kind in kinds.items() if kind == "the time"]
    return Claim(
        place="Introduction",
        says="The systems under investigation in this paper are autonomous.",
        verdict=verdict(len(own) == len(kinds), mended=bool(own)),
        found=f"True of {_listed(own)}, and of all systems that Theorem 1 speaks of. The equations "
        f"of {_listed(timed)} contain the time; the controlled system remembers its past.",
        how="Read off the traces of all functions of each model: whether a result depends on t, or "
        "on a past state.",
        numbers=[Number(what=f"{name}: depends on", ours=kind) for name, kind in kinds.items()],
    )


def _dependence(model: Any) -> str:
    if model.spec.lags:
        return "its past"
    return "the time" if depends_on_time(scene_of(model)) else "neither"


def _listed(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


# ---------------------------------------------------------------------------------------
# Example 1


def example_1(spring: Spring) -> Claim:
    """The solution of Example 1 from (2.1, 0) chatters."""
    run, again = spring.run, spring.again
    point = run.zeno[0]
    low, high = point.enclosure
    first = [
        number
        for n in range(3)
        for number in (
            twice(f"impact {n + 1}: time", run.jumps.t[n], again.jumps.t[n]),
            twice(f"impact {n + 1}: speed", -run.jumps.before.v[n], -again.jumps.before.v[n]),
        )
    ]
    slow = [
        Number(what=f"impacts until one leaves with less than {speed:.0e}", ours=_first(run, speed))
        for speed in (1e-3, 1e-6, 1e-9, 1e-12)
    ]
    return Claim(
        place="Section 1, Example 1, Figure 1",
        says="If we choose `r = 0.8`, `x(0) = 2.1`, `x'(0) = 0`, the solution is chattering.",
        verdict=verdict(point.verdict == "certified" and low <= point.t <= high),
        found=f"The impacts accumulate at t = {point.t:.12f}, where x = {float(point.state.x):g}, "
        f"x' = {float(point.state.v):g}.",
        how="Simulated to the accumulation: the tail of impacts is summed, and proved by interval "
        f"arithmetic to accumulate, from the impact at t = {point.proofs[0].t:.6f} on. The bounds "
        "of `t_inf` are those of that proof from a later impact, made wider by the error of the "
        "run up to there, which is measured. Errors of impacts are three times the distance to a "
        "run with another method (DOP853), and rounding; for `t_inf` the error of the sum is "
        "added.",
        numbers=[
            Number(what="`t_inf`", ours=point.t, error=point.t_error),
            Number(what="`t_inf`: lower bound", ours=low),
            Number(what="`t_inf`: upper bound", ours=high),
            *first,
            *slow,
        ],
        figures=[
            Figure(
                name="example-1",
                title="Example 1 from x = 2.1, r = 0.8",
                columns=column(
                    states_panel(run, "x", points=POINTS),
                    states_panel(run, "v", points=POINTS),
                    approach_panel(run, "v", points=POINTS),
                    gaps_panel(run),
                ),
                zooms=zooms(run),
            )
        ],
    )


def _first(run: Any, speed: float) -> int:
    """Number of the first impact after which the speed is lower."""
    return int(np.argmax(run.jumps.after.v < speed)) + 1
