"""Theorem 1 for Example 1: its conditions, their margins, and its conclusion in runs."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from hybrid.certificates import certify
from hybrid.plot.figure import Curve, Figure, Panel, column
from hybrid.simulation import simulate

from ..claims import Claim, Number, rounds_to, verdict
from ..runs import DOMAIN, FINE, Attained, Spring, force

#: Restitutions at which Theorem 1 is put to the test, and how many starts at each.
RATIOS, STARTS = (0.2, 0.5, 0.8, 0.95), 41


def claims(spring: Spring) -> list[Claim]:
    """The conditions, and what follows."""
    found = Attained.of(spring.model, spring.certificate)
    return [
        bounds(spring, found),
        strictness(spring, found),
        inequality(spring, found),
        all_starts(spring),
    ]


def bounds(spring: Spring, found: Attained) -> Claim:
    """The paper's bounds of the force."""
    most, least = found.most, found.least
    tight = rounds_to(most[0], "-7") and rounds_to(least[0], "-16.625")
    proved = spring.certificate
    return Claim(
        place="Section 1, Example 1",
        says="In the domain `2 <= x <= 2.5`, `|x'| < 7`: `f(x, x') <= -7`, `f(x, x') = f(x, -x')`, "
        "`f(x, x') >= -16.625`.",
        verdict=verdict(tight and proved.verdict == "certified"),
        found="All three hold, and both bounds are attained.",
        how="Branch and bound in interval arithmetic from the trace of the force; evenness by "
        "comparing normal forms of `f(x, v)` and `f(x, -v)`. The values are attained; the errors "
        "are what is left between them and the bounds that are proved.",
        numbers=[
            Number(
                what=f"largest f, at {_at(proved.m_at)}", ours=most[0], error=most[1], paper="-7"
            ),
            Number(
                what=f"least f, at {_at(proved.M_at)}",
                ours=least[0],
                error=least[1],
                paper="-16.625",
            ),
        ],
    )


def strictness(spring: Spring, found: Attained) -> Claim:
    """(C1) with the paper's m."""
    proved, at = spring.certificate, {"x": 2.0, "v": np.pi}
    value, (low, high) = force(spring.model, at), proved.m_range
    served = low < proved.m < high and proved.verdict == "certified"
    least, off = -found.least[0], found.least[1]
    smallest = least**2 * 2 * (DOMAIN["x"][1] - DOMAIN["x"][0]) / proved.right**2
    return Claim(
        place="Section 1, Example 1, condition (C1)",
        says="(C1): there is a positive `m` such that `f(u, v) < -m` for all `(u, v)` in `H`; used "
        "with `m = 7`.",
        verdict=verdict(value < -7, mended=served),
        found=f"f(2, pi) = {value:.15g} is not below -7: (C1), which is strict, fails with m = 7. "
        f"It holds, and with it the inequality, for every m between {smallest:.10g} and "
        f"{-found.most[0]:.10g}, both excluded.",
        how="The force at a point refutes m = 7. The range is the certificate's: above, m must be "
        "less than every |f|; below, `M sqrt(2 (h - phi) / m)` reaches `h_bar`.",
        numbers=[
            Number(what="`f(2, pi)`", ours=value, paper="< -7"),
            Number(what="m must be less than", ours=-found.most[0], error=found.most[1]),
            Number(what="m must be more than", ours=smallest, error=2 * smallest * off / least),
        ],
    )


def inequality(spring: Spring, found: Attained) -> Claim:
    """The inequality of Theorem 1 for Example 1."""
    proved, (left, error) = spring.certificate, found.left
    return Claim(
        place="Section 1, Example 1, inequality of Theorem 1",
        says="The condition `M sqrt(2 (h - phi) / m) < h_bar` is true since `16.625 sqrt(1/7)` ≈ "
        "6.28 < 7.",
        verdict=verdict(rounds_to(proved.left, "6.28") and proved.left < proved.right),
        found=f"{left:.10f} < 7 with m as close to 7 as (C1) allows, a margin of "
        f"{proved.margin:.10f}.",
        how="From bounds of the force proved by interval arithmetic; the error is the distance "
        "between the value with forces that are attained and that with the bounds.",
        numbers=[
            Number(what="`M sqrt(2 (h - phi) / m)`", ours=left, error=error, paper="6.28"),
            Number(what="`h_bar`", ours=proved.right, paper="7"),
            Number(what="margin", ours=proved.right - left, error=error),
        ],
    )


def all_starts(spring: Spring) -> Claim:
    """Theorem 1's conclusion on the whole set of starts, and in runs."""
    low, high = DOMAIN["x"]
    starts = low + (high - low) * np.linspace(0.02, 0.999, STARTS) ** 2
    curves, verdicts, proofs = [], [], []
    for r in RATIOS:
        model = attrs.evolve(spring.model, r=r)
        proofs.append(certify(model, DOMAIN))
        points = [_stopped(model, float(x)) for x in starts]
        verdicts += [point.verdict for point in points]
        notes = [f"x0 = {x:.6g}: t_inf = {p.t:.12g}" for x, p in zip(starts, points, strict=True)]
        curves.append(Curve(x=starts, y=[p.t for p in points], name=f"r = {r:g}", notes=notes))
    count = verdicts.count("certified")
    looks = ("line", "other", "dashed", "series")
    curves = [attrs.evolve(c, look=look) for c, look in zip(curves, looks, strict=True)]
    sets = [p.initial_set["x"] for p in proofs if p.verdict == "certified" and p.initial_set]
    return Claim(
        place="Abstract, Theorem 1, Conclusion",
        says="All solutions with initial value `(x0, 0)`, `phi < x0 < h`, are chattering; that is "
        "concluded exclusively by examination of the right-hand side, for infinitely many motions "
        "with initial values in an interval.",
        verdict=verdict(sets == [(low, high)] * len(RATIOS) and count == len(verdicts)),
        found=f"Proved for Example 1 from every start between {low:g} and {high:g} at rest, "
        f"without a run. In {len(verdicts)} runs, from {STARTS} starts with each of {len(RATIOS)} "
        f"values of r, the impacts accumulate; in {count} of them that is proved once more.",
        how="The certificate encloses f, and decides from the model's trace that it is even in x' "
        "and smooth enough. The runs are independent of it: each one's accumulation is proved from "
        "its own impacts, by bounds near them that need neither (C2) nor the box.",
        numbers=[
            Number(
                what=f"values of r with all starts between {low:g} and {high:g} proved to chatter",
                ours=f"{len(sets)} of {len(RATIOS)}",
            ),
            Number(what="runs proved to chatter", ours=f"{count} of {len(verdicts)}"),
        ],
        figures=[
            Figure(
                name="all-starts",
                title="Example 1: when the impacts accumulate, by start, for several r",
                columns=column(Panel(curves=curves, x="x(0)", y="t_inf", log="y")),
            )
        ],
    )


def _stopped(model: Any, x: float) -> Any:
    run = simulate(model, {"x": x, "v": 0.0}, (0.0, 30.0), zeno="stop", save="jumps", **FINE)
    return run.zeno[0]


def _at(point: dict[str, float]) -> str:
    return ", ".join(f"{'xv'[i]} = {value:.6g}" for i, value in enumerate(point.values()))
