"""Section 1 of the paper: Theorem 1, its inequality (thetas), Example 1."""

from __future__ import annotations

from ..gallery import find
from ..pictures.figure import Figure, column
from ..pictures.of_run import approach_panel, gaps_panel, states_panel, zooms
from ..simulation import simulate
from .claims import Claim, Number, Section, verdict


def section() -> Section:
    """All claims of section 1."""
    return Section(
        name="existence",
        title="1. Existence of chattering",
        about="A body under a force f(x, v) over a fixed wall, with Newton's law of impact.",
        claims=[example_1()],
    )


def example_1() -> Claim:
    """The solution of Example 1 from (2.1, 0) chatters."""
    entry = find("hard_spring")
    run = simulate(entry.cls(), {"x": 2.1, "v": 0.0}, (0.0, 1.5), rtol=1e-12, atol=1e-12)
    point = run.zeno[0]
    drawn = Figure(
        name="example-1",
        title="Example 1 from x = 2.1, r = 0.8",
        columns=column(
            states_panel(run, "x"),
            states_panel(run, "v"),
            approach_panel(run, "v"),
            gaps_panel(run),
        ),
        zooms=zooms(run),
    )
    return Claim(
        place="Section 1, Example 1, Figure 1",
        says="with r = 0.8, x(0) = 2.1, x'(0) = 0, the solution is chattering",
        verdict=verdict(point.verdict == "certified"),
        found=f"The impacts accumulate at t = {point.t:.12f}.",
        how="Simulated to the accumulation, which is proved by interval arithmetic in that run.",
        numbers=[Number(what="t_inf", ours=point.t, error=point.t_error)],
        figures=[drawn],
    )
