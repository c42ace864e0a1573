"""Section 4, the map: its claims and its figure."""

from __future__ import annotations

import numpy as np

from ..pictures.figure import Cells, Columns, Curve, Figure, Panel, Slider, column, slid
from .beam_points import (
    BRUTE,
    DELTAS,
    FIRST,
    FREQUENCIES,
    GAMMAS,
    IN_A_ROW,
    KINDS,
    NEAR,
    PERIODS,
    RELEASED,
    RESTS,
    SLOW,
    Point,
    beam,
    kind_of,
    points,
    run_of,
)
from .claims import Claim, Number, verdict

#: To what the border is known: ten digits. A force that pulls by less than the tolerance of its
#: run, at its greatest, touches zero as far as that run can tell.
WIDTH = 1e-11

#: Forcing up to which the paper's "sufficiently small" is held to its word.
SMALL = 0.1


def map_claims() -> list[Claim]:
    """What the map says of the paper's "sufficiently small", and its border."""
    return [weak_forcing(), border()]


def weak_forcing() -> Claim:
    """Whether small damping and forcing keep the chattering."""
    found = points()
    certified = [point for point in found if point.certified]
    missed = [point for point in certified if not point.confirmed]
    weak = [point for point in found if point.gamma <= SMALL]
    holds = all(p.kind == RESTS and p.certified and p.confirmed and p.seen for p in weak)
    strange = [point for point in found if point.chatters and not point.certified]
    apart = [point for point in found if point.chatters != point.seen]
    early = [p for p in found if p.kind == RESTS and p.gamma > _wall_force()]
    late = [p for p in found if p.kind == RELEASED and p.gamma < _wall_force()]
    return Claim(
        place="Section 4, the perturbed system: a map",
        says="for sufficiently small δ and γ ... the solutions are chattering as well",
        verdict=verdict(holds and not missed),
        found=(
            f"All {len(weak)} points of the map with γ up to {SMALL:g} chatter completely, are "
            f"certified and rest for ever, with δ up to {DELTAS[-1]:g} and w from "
            f"{FREQUENCIES[0]:g} to {FREQUENCIES[-1]:g}. Of all {len(found)} points "
            f"{len(certified)} are certified; certified but not seen: {len(missed)}."
        ),
        how=(
            "At each point a run from (1.3, 0) with Taylor series passes accumulations, proves "
            f"them and goes on to t = {FIRST:g} and {PERIODS:g} periods of the forcing more. "
            f"Brute force (compiled Dormand-Prince 8, {BRUTE} impacts, nothing summed or proved) "
            "starts at (1.3, 0) and, as the test of the proof, at the impact from which it is "
            f"proved: there its speeds must fall below {SLOW:g} at the time enclosed, to {NEAR:g}. "
            f"Incomplete: at least {IN_A_ROW} impacts in a row, each slower than the last, then a "
            "faster one, and no accumulation. Seen by the run but not certified: "
            f"{_listed(strange)}. Run and brute force from the start differ (motions that are "
            f"chaotic before they chatter): {_listed(apart)}. Resting to the end though γ is above "
            f"the border: {_listed(early)}; released below it: {_listed(late)}."
        ),
        numbers=_counts(found),
        figures=[_map()],
    )


def _listed(found: list[Point]) -> str:
    names = [f"({p.delta:g}, {p.gamma:g}, {p.w:g})" for p in found]
    return f"{len(names)}: (δ, γ, w) = {', '.join(names)}" if names else "none"


def _counts(found: tuple[Point, ...]) -> list[Number]:
    counts = [Number(what="points", ours=len(found))]
    for kind, (name, _) in enumerate(KINDS):
        counts.append(Number(what=name, ours=sum(point.kind == kind for point in found)))
    for name in ("certified", "confirmed"):
        counts.append(Number(what=name, ours=sum(getattr(point, name) for point in found)))
    return counts


def _map() -> Figure:
    """The map, a slice for each frequency."""
    shape = (len(FREQUENCIES), len(GAMMAS), len(DELTAS))
    cube = np.array(points(), dtype=object).reshape(shape)
    stops = [(f"{w:g}", _slice(cube[i].T)) for i, w in enumerate(FREQUENCIES)]
    title = "Chattering of the beam with obstacle from (1.3, 0), over forcing and damping"
    return slid(
        Slider(label="w", stops=stops, start=FREQUENCIES.index(2.0)), name="beam-map", title=title
    )


def _slice(points: np.ndarray) -> Columns:
    """One frequency: cells by what the run does, dots where it is certified."""
    kind, notes = (np.vectorize(f, otypes=[t])(points) for f, t in ((_kind, int), (str, object)))
    gamma, delta = np.meshgrid(GAMMAS, DELTAS)
    sure = np.vectorize(lambda p: p.certified, otypes=[bool])(points)
    curves = [
        Curve(x=[_wall_force()] * 2, y=[DELTAS[0], DELTAS[-1]], look="fall", name="|f(φ)|"),
        Curve(x=gamma[sure], y=delta[sure], look="mark", name="certified", notes=notes[sure]),
    ]
    cells = Cells(x=GAMMAS, y=DELTAS, kind=kind, kinds=KINDS, notes=notes)
    return column(Panel(curves=curves, cells=cells, x="γ", y="δ"))


def _kind(point: Point) -> int:
    return point.kind


def _wall_force() -> float:
    """The unforced force towards the wall, at it."""
    wall = float(beam()().obstacle)
    return wall**3 - wall


def border() -> Claim:
    """The forcing from which on a rest is ended, bisected by runs."""
    pairs = [(0.05, 0.1), (0.3, 0.5)]
    borders = [_bisected(delta, w) for delta, w in pairs]
    numbers = [
        Number(what=f"border at δ = {d:g}, w = {w:g}, by runs", ours=border, error=WIDTH)
        for (d, w), border in zip(pairs, borders, strict=True)
    ]
    exact = _wall_force()
    holds = all(abs(border - exact) <= WIDTH for border in borders)
    return Claim(
        place="Section 4, the perturbed system: how small is small",
        says="for sufficiently small δ and γ",
        verdict=verdict(False, mended=holds),
        found=(
            f"At the wall the force is -{exact:.12g} + γ cos(wt) once the beam rests, whatever δ. "
            f"Below γ = φ³ - φ = {exact:.12g} it never pulls: a beam that rests, rests for ever, "
            "and every slow enough impact chatters completely. Above, it lets go in each period "
            "when γ cos(wt) passes that number, and chatters anew. The paper gives no bound."
        ),
        how=(
            "Bisected between 0.2 and 0.26 by whether the run from (1.3, 0) is released, down to "
            f"{WIDTH:g}, and compared with φ³ - φ for φ = 1.1."
        ),
        numbers=[*numbers, Number(what="φ³ - φ", ours=exact)],
    )


def _bisected(delta: float, w: float) -> float:
    low, high = 0.2, 0.26
    while high - low > WIDTH / 4.0:
        middle = 0.5 * (low + high)
        if kind_of(run_of(delta, middle, w, rtol=1e-12, atol=1e-13)) == RELEASED:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)
