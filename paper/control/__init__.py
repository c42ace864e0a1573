"""Section 6 of the paper: Pyragas control of Example 1, and Table 1."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from hybrid import gallery
from hybrid.certificates import certify
from hybrid.certificates.result import Certificate
from hybrid.simulation import simulate

from ..claims import Claim, Number, Section, known, rounds_to, verdict
from ..runs import twice
from . import loose
from .figures import table_figure
from .pyragas import (
    AMPLITUDE,
    CHATTERS,
    COARSER,
    EXACT,
    PERIOD,
    STARTS,
    Row,
    at_rest,
    border,
    drive,
    model,
    orbit,
    restarted,
    row,
)

#: Tolerances of the methods of low order that are tried: relative and absolute.
LOOSE = ((1e-2, 1e-4), (1e-3, 1e-6), (1e-4, 1e-6))


def section() -> Section:
    """All claims of section 6."""
    return Section(
        name="control",
        title="6. Pyragas control",
        about="x1'' = -x1^3 - cos x1' + C (x1(t - tau) - x1) over a wall at 2, with C = -30, tau "
        "= 1, r = 0.6. Memory kept: the equation as it is written. Memory restarted: after an "
        "impact the past is the state after it, as for a solver that is started again there.",
        claims=[
            uncontrolled(),
            controlled(),
            periods(),
            amplitudes(),
            lag(),
            chatters(),
            conditions(),
        ],
    )


# ---------------------------------------------------------------------------------------
# claims


@cache
def spring(far: float, fastest: float) -> Certificate:
    """Theorem 1 for the system without control, as far as a height."""
    wall = model().wall
    box = {"x": (wall, far), "v": (-fastest, fastest)}
    return certify(gallery.find("hard_spring").cls(r=model().r), box)


def uncontrolled() -> Claim:
    """Without control all starts chatter."""
    near, far = spring(2.5, 7.0), spring(201.0, 1e9)
    runs = [
        simulate(
            gallery.find("hard_spring").cls(r=model().r), {"x": x0, "v": 0.0}, (0.0, 3.0), **EXACT
        )
        for x0 in (CHATTERS, 3.0)
    ]
    points = [run.zeno[0] for run in runs]
    off = simulate(model(C=0.0), {"x1": 3.0, "x2": 0.0}, (0.0, 3.0), **EXACT).zeno[0]
    same = abs(off.t - points[1].t) <= off.t_error + points[1].t_error
    return Claim(
        place="Section 6, of Example 1",
        says="any solution of system (Example 1) which starts in a domain is chattering",
        verdict=verdict(
            near.verdict == "certified" and all(p.verdict == "certified" for p in points) and same
        ),
        found="Proved for every start between the wall and 2.5, where the domain of Example 1 "
        "ends, at r = 0.6. Table 1 starts from 2.5 to 200, outside it; Theorem 1 holds on a "
        f"larger domain as well ({far.verdict} up to x = 201, with |v| up to 1e9).",
        how="hy.certify, Theorem 1, at r = 0.6; runs with C = 0, through this model and through "
        "that of Example 1, have the same accumulation.",
        numbers=[
            Number(
                what=f"t_inf from {CHATTERS:g}, C = 0", ours=points[0].t, error=points[0].t_error
            ),
            Number(what="t_inf from 3, C = 0", ours=points[1].t, error=points[1].t_error),
            Number(what="margin up to 2.5", ours=known(near.margin)),
        ],
    )


def controlled() -> Claim:
    """The control makes the chattering solution periodic only where the memory is restarted."""
    rows = [row(x0) for x0 in STARTS]
    rests = [r for r in rows if r.certified and not r.released]
    waves = [r for r in rows if r.period is not None]
    kept, own = at_rest(3.0), model()
    load = own.wall**3 + float(np.cos(0.0))
    rests = rests if own.C <= 0.0 and kept.settles().for_ever else []
    return Claim(
        place="Introduction and Section 6, Figure 8",
        says="by Pyragas control the chattering solution is controlled to be periodic; for x1(0) "
        "= 3 the periodic orbit can be seen in the figure",
        verdict=verdict(not rests, len(waves) == len(rows)),
        found=f"With the memory kept, {len(rests)} of the {len(rows)} starts of Table 1 come to "
        "rest by complete chattering (proved), and for ever: on the wall the acceleration is "
        f"-{load:g} - 30 (x1(t - 1) - 2), never above -{load:g}, because x1 is never below 2: "
        f"this control only presses harder. With the memory restarted at impacts, {len(waves)} of "
        f"{len(rows)} come to one periodic orbit, with the period of Table 1: that table is of a "
        "system which forgets at impacts.",
        how="Each start was run with both memories, from a constant history with x2 = 0 (the "
        f"paper gives no history). Of the run from 3, run.settles() says: {kept.settles().reason}.",
        numbers=[
            Number(what=f"kept, from {r.x0:g}: at rest from t", ours=r.rests, error=r.error)
            for r in rows
        ],
        figures=[table_figure()],
    )


def periods() -> Claim:
    """T = 1.22."""
    rows, found = [row(x0) for x0 in STARTS], orbit()
    return Claim(
        place="Section 6, Table 1, first row",
        says="period T = 1.22 from x1(0) = 2.5, 3, 5, 10, 100, 200",
        verdict=verdict(_all(rows, lambda r: not r.certified), _all(rows, _has_period)),
        found=f"The orbit of the restarted system has T = {found.period:.12f}, and all six starts "
        "lead to it. With the memory kept all six come to rest, and have no period.",
        how=f"hy.periodic_orbit closes the orbit by Newton's method (to {found.residual:.0e} of "
        "its size); the runs come to it to six digits.",
        numbers=[
            twice("T", found.period, orbit(COARSER).period, PERIOD),
            *[
                Number(what=f"last period, from {r.x0:g}", ours=_digits(r.period), paper=PERIOD)
                for r in rows
            ],
        ],
    )


def amplitudes() -> Claim:
    """Amplitude 2.933."""
    rows, found = [row(x0) for x0 in STARTS], orbit()
    height = _height(found)
    coarse = {pair: loose.orbit(*pair) for pair in LOOSE}
    other = {pair: by_scipy(*pair) for pair in LOOSE}
    default = coarse[LOOSE[1]]
    explained = rounds_to(default[1], AMPLITUDE) and rounds_to(default[0], PERIOD)
    alike = _all(rows, lambda r: r.amplitude is not None and abs(r.amplitude - height) < 1e-5)
    return Claim(
        place="Section 6, Table 1, second row",
        says="amplitude 2.933 of x1 from all six starts",
        verdict=verdict(alike and rounds_to(height, AMPLITUDE), alike),
        found=f"The amplitude, max x1 - 2, is {height:.10f} (memory restarted), which rounds to "
        f"{height:.3f}. Which solver the paper used it does not say; the Bogacki-Shampine pair "
        "with tolerances 1e-3 and 1e-6, the defaults of a widely used solver of delay equations, "
        f"restarted at each impact, shows T = {default[0]:.4f} and amplitude {default[1]:.4f}, "
        f"{'as' if explained else 'not as'} printed.",
        how="The orbit closed to rounding; then flown with that pair and its usual step control, "
        "the largest value at a step's end taken; beside it the same pair with SciPy's step "
        "control, the largest value of the curve taken.",
        numbers=[
            twice("max x1 - 2", height, _height(orbit(COARSER)), AMPLITUDE),
            *[_reached(r) for r in rows],
            *[_tried("low order", pair, found[1]) for pair, found in coarse.items()],
            *[_tried("with SciPy's steps", pair, high) for pair, high in other.items()],
        ],
    )


def _height(found: Any) -> float:
    return float(found.extrema["x1"][1]) - float(model().wall)


def _reached(found: Row) -> Number:
    what = f"last amplitude, from {found.x0:g}"
    return Number(what=what, ours=_digits(found.amplitude), paper=AMPLITUDE)


def _tried(what: str, pair: tuple[float, float], amplitude: float) -> Number:
    rtol, atol = pair
    return Number(what=f"{what}, rtol {rtol:g}, atol {atol:g}", ours=f"{amplitude:.5f}")


def by_scipy(rtol: float, atol: float) -> float:
    """The amplitude that the restarted run shows with RK23 at these tolerances."""
    start = {"x1": 3.0, "x2": 0.0}
    options: dict[str, Any] = {"memory": "restart", "method": "RK23", "rtol": rtol, "atol": atol}
    run = simulate(model(), start, (0.0, 25.0), **options)
    arc = run.arcs[-2]
    return float(np.max(arc.local(np.linspace(0.0, arc.length, 2001))[:, 0])) - model().wall


def lag() -> Claim:
    """The period differs from the lag."""
    found, own = orbit(), model()
    control = drive(restarted(3.0))
    return Claim(
        place="Section 6, after Table 1",
        says="observe that the period is different from the delay term tau = 1",
        verdict=verdict(abs(found.period - own.tau) > 0.1),
        found=f"T - tau = {found.period - own.tau:.10f} on the orbit of the restarted system. So "
        "the control does not vanish on it, as Pyragas control does on an orbit of period tau: it "
        f"reaches {control:.5f}.",
        how="Period of the orbit closed by hy.periodic_orbit; the control along its flight.",
        numbers=[
            twice("T", found.period, orbit(COARSER).period, PERIOD),
            Number(what="largest control on the orbit", ours=f"{control:.5f}"),
        ],
    )


def chatters() -> Claim:
    """From 2.1 the chattering goes on."""
    found = row(CHATTERS)
    return Claim(
        place="Section 6, after Table 1",
        says="the chattering has not been decaying for the solution with x1(0) = 2.1",
        verdict=verdict(found.certified and found.chatters is not None),
        found=f"From {CHATTERS:g} the impacts accumulate with both memories: at t = "
        f"{found.rests:.10f} with the memory kept (proved), at t = {found.chatters or 0.0:.10f} "
        "with the memory restarted.",
        how="Both runs to their accumulation.",
        numbers=[
            Number(what="kept: t_inf", ours=found.rests, error=found.error),
            Number(what="restarted: t_inf", ours=known(found.chatters), error=found.again),
        ],
    )


def conditions() -> Claim:
    """Controllable starts, and stability of the orbit."""
    found, other = orbit(), orbit(COARSER)
    edge, beside = border(), border(COARSER)
    multiplier = float(found.multipliers[1].real)
    divides = CHATTERS < edge.start < min(STARTS)
    return Claim(
        place="Section 6, end",
        says="the control problem can be solved for the chattering, but conditions have to be "
        "determined for the controllable domain and the stability of the periodic motions",
        verdict=verdict(divides and abs(multiplier) < 1.0),
        found="For the restarted system both are numbers. The orbit is stable: its multiplier is "
        f"{multiplier:.9f}. Starts above {edge.start:.11f} lead to it, as far as tried; those "
        "below chatter. Between slow impacts, which lose 0.4 of their speed each, and the orbit "
        f"lies one that repels (multiplier {edge.multiplier:.6f}). With the memory kept no start "
        "tried is controllable.",
        how="The restarted system is a map from the speed after an impact to the next such speed; "
        "hy.periodic_orbit gives its fixed points with their multipliers. Errors are three times "
        "the distance to the same with a larger tolerance.",
        numbers=[
            twice("multiplier of the orbit", multiplier, float(other.multipliers[1].real)),
            twice("speed after its impact", found.start.x2, other.start.x2),
            twice("border between the starts", edge.start, beside.start),
            twice("speed of the orbit that repels", edge.speed, beside.speed),
            twice("its multiplier", edge.multiplier, beside.multiplier),
        ],
    )


def _all(rows: list[Row], holds: Callable[[Row], bool]) -> bool:
    return all(holds(r) for r in rows)


def _has_period(found: Row) -> bool:
    return found.period is not None and rounds_to(found.period, PERIOD)


def _digits(value: float | None) -> str:
    """As far as a run at these tolerances has come to its limit."""
    return "none" if value is None else f"{value:.6f}"
