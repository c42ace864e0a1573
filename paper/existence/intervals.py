"""The inequality for intervals in the proof of Theorem 1: a counterexample, and its mending."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.certificates import certify
from hybrid.lowering import scene_of
from hybrid.plot.figure import Curve, Figure, Panel, column
from hybrid.segment import nodes
from hybrid.simulation import simulate
from hybrid.zeno.flight import rise

from ..claims import Claim, Number, verdict
from ..runs import FINE, OTHER, ZERO, Attained, Spring, twice

#: Flights that are looked at.
COUNT = 40

#: The domain on which the counterexample fulfils the conditions of Theorem 1.
SMALL = {"x": (1.0, 1.08), "v": (-1.0, 1.0)}

#: The speed with which it also leaves the wall, in a run of its own.
SPEED = 0.4


@attrs.frozen(eq=False)
class Flight:
    """A flight between two impacts, and the force along it.

    Attributes
    ----------
    length, height : float
        The height above the wall is a coordinate of its own: it keeps its digits.
    x, v, f : array
        Position, velocity and force at Chebyshev points, of which one lies half-way.
    """

    length: float
    height: float
    x: np.ndarray
    v: np.ndarray
    f: np.ndarray

    @property
    def largest(self) -> float:
        """``M_i``."""
        return float(np.max(np.abs(self.f)))

    @property
    def least(self) -> float:
        """``m_i``."""
        return float(np.min(np.abs(self.f)))


def flights(model: Any, run: Any, count: int = COUNT) -> list[Flight]:
    """The first flights between impacts."""
    field = scene_of(model).field("flight")
    place, found = field.column("impact"), []
    for arc in [arc for arc in run.arcs if arc.mode == "flight" and arc.j > 0][:count]:
        x, v = arc.local(arc.length * nodes(32)).T
        f = np.array([field.rhs(0.0, list(pair))[1] for pair in zip(x, v, strict=True)])
        height = rise(field, place, arc.t0, arc.first.tolist(), float(v[0]))
        height = float(np.max(x) - model.wall) if height is None else height
        found.append(Flight(arc.length, height, x, v, f))
    return found


@attrs.frozen(eq=False)
class Ratios:
    """Ratios of successive intervals, and the paper's bound on them and ours.

    Attributes
    ----------
    found : array
        ``(theta_{i+2} - theta_{i+1}) / (theta_{i+1} - theta_i)``.
    printed : array
        ``r M_i / m_i``.
    mended : array
        ``r M_i / m_{i+1}``.
    """

    found: np.ndarray
    printed: np.ndarray
    mended: np.ndarray

    @classmethod
    def of(cls, seen: Sequence[Flight], r: float) -> Ratios:
        """Of successive flights."""
        length, least, largest = np.array([(f.length, f.least, f.largest) for f in seen]).T
        found, bound = length[1:] / length[:-1], r * largest[:-1]
        return cls(found, bound / least[:-1], bound / least[1:])


def intervals(spring: Spring, seen: Sequence[Flight], again: Sequence[Flight]) -> Claim:
    """The ratio of successive intervals, where the force stays constant along each flight."""
    entry = gallery.find("steady_push")
    push = entry.cls()
    proved = certify(push, SMALL)
    run, other = (simulate(push, entry.start, entry.until, **o) for o in (FINE, OTHER))
    steady = [Ratios.of(flights(push, one), push.r) for one in (run, other)]
    springs = [Ratios.of(one, spring.model.r) for one in (seen, again)]
    pairs = (steady[0], springs[0])
    printed = all(np.all(one.found < one.printed) for one in pairs)
    mended = all(np.all(one.found <= one.mended * (1 + ZERO)) for one in pairs)
    exact, fast = (shrinks(push.r, v) for v in (float(run.jumps.after.v[0]), SPEED))
    agrees = abs(steady[0].found[0] - exact) < ZERO and proved.verdict == "certified"
    attained = Attained.of(push, proved).left
    launched = [_leaving(push, options) for options in (FINE, OTHER)]
    return Claim(
        place="Section 1, proof of Theorem 1, inequality for intervals",
        says="`(theta_{i+2} - theta_{i+1}) / (theta_{i+1} - theta_i) < r M_i / m_i`, where `M_i` "
        "and `m_i` are the largest and the least `|f|` on `[theta_i, theta_{i+1}]`.",
        verdict=verdict(printed, mended=mended and agrees),
        found="Not in general. The force `f = -(1 + v^2) / (1 - 2 (x - 1))` over a wall at 1 "
        f"fulfils all conditions of the theorem with h = {SMALL['x'][1]:g}, h_bar = "
        f"{SMALL['v'][1]:g}, and is constant along each flight, so `M_i = m_i`; but from rest at "
        f"{entry.start['x']:g} with r = {push.r:g} the first ratio is {steady[0].found[0]:.10f}. "
        "Corrected: `<= r M_i / m_{i+1}`, with the least force on the interval that follows, as "
        "the mean value theorem gives it. Its limit is the same r, so the theorem stands. (Under "
        "a constant force both sides are equal: `<` cannot be had.)",
        how="Along a flight that leaves the wall with speed v, `d(v^2) = 2 f dx` keeps `1 + v^2` "
        "in proportion to `1 - 2 (x - 1)`: f stays `-(1 + v^2)`, the flight lasts "
        "`2 v / (1 + v^2)`, and the ratio is `r (1 + v^2) / (1 + r^2 v^2) > r`. The conditions are "
        f"proved by the certificate; the ratios are simulated, {COUNT} flights of each system. For "
        "Example 1 the printed inequality holds too.",
        numbers=[
            Number(
                what="`M sqrt(2 (h - phi) / m)`, less than `h_bar`",
                ours=attained[0],
                error=attained[1],
            ),
            _pair("first ratio", steady, "found", paper=f"< {push.r:g}"),
            Number(what="first ratio, closed form", ours=exact),
            _pair("`r M_1 / m_1`", steady, "printed"),
            _pair("`r M_1 / m_2`", steady, "mended"),
            twice(f"ratio after leaving the wall with speed {SPEED:g}", launched[0], launched[1]),
            Number(what="that ratio, closed form", ours=fast),
            _pair("Example 1: first ratio", springs, "found"),
            _pair("Example 1: `r M_1 / m_1`", springs, "printed"),
            _pair("Example 1: `r M_1 / m_2`", springs, "mended"),
        ],
        figures=[
            Figure(
                name="intervals",
                title="Ratios of successive intervals, and what bounds them",
                columns=column(
                    _panel(steady[0], f"f = -(1 + v²) / (1 - 2 (x - 1)), r = {push.r:g}"),
                    _panel(springs[0], f"Example 1, r = {spring.model.r:g}"),
                ),
            )
        ],
    )


def _pair(what: str, ratios: Sequence[Ratios], name: str, paper: str = "") -> Number:
    """The first of some ratios, as found by two methods."""
    one, other = (getattr(found, name)[0] for found in ratios)
    return twice(what, one, other, paper)


def shrinks(r: float, v: float) -> float:
    """The ratio of the flights with speeds ``v`` and ``r v`` under the steady push."""
    return r * (1 + v**2) / (1 + (r * v) ** 2)


def _leaving(push: Any, options: Any) -> float:
    """The first ratio of a run that leaves the wall."""
    start = {"x": push.wall, "v": SPEED}
    first, second, *_ = simulate(push, start, (0.0, 2.0), max_jumps=3, **options).arcs
    return float(second.length / first.length)


def _panel(ratios: Ratios, title: str) -> Panel:
    number = np.arange(1, len(ratios.found) + 1)
    return Panel(
        curves=[
            Curve(x=number, y=ratios.found, look="series", name="ratio of successive intervals"),
            Curve(x=number, y=ratios.printed, look="dashed", name="r M_i / m_i, as printed"),
            Curve(x=number, y=ratios.mended, look="line", name="r M_i / m_(i+1), corrected"),
        ],
        x="interval i",
        y="ratio",
        title=title,
    )
