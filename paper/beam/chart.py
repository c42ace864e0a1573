"""The map of section 4: which beams still chatter, simulated, against what is proved of them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import attrs
import numpy as np

from hybrid.plot.figure import (
    IMPACT_COLOR,
    LINE_COLOR,
    OTHER_COLOR,
    Cells,
    Columns,
    Curve,
    Figure,
    Panel,
    Slider,
    slid,
)

from .proof import accumulates, beam, pushes_always
from .strikes import HELD, Lanes, fly

#: The border at which the force on the resting beam is zero at its strongest: phi^3 - phi.
NEAR_BORDER = (0.2309, 0.23099, 0.23101, 0.2311)

#: The map's axes and slices.
GAMMAS = np.sort(np.concatenate([np.linspace(0.0, 0.6, 31), NEAR_BORDER]))
DELTAS = np.linspace(0.0, 0.5, 16)
SLICES = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0)

#: Where the map is kept from one report to the next.
KEPT = Path(__file__).parents[2] / "out" / "maps" / "beam.zarr"

#: Flights in a row, each shorter than the one before, that make a series.
SERIES = 10

#: What the times of the simulation may be wrong by.
SLACK = 1e-5

#: Kinds of lanes; of the last two nothing can be proved.
REST, RELEASED, INCOMPLETE, NONE = range(4)
KINDS = (
    ("complete chattering, rest for ever", LINE_COLOR),
    ("complete chattering, then released", OTHER_COLOR),
    ("incomplete: a series that ends", IMPACT_COLOR),
    ("no such series", "#d5d5d5"),
)
PROVED = (*KINDS[:2], ("nothing proved", "#f0f0f0"))


@attrs.frozen(eq=False)
class Map:
    """Lanes with what was seen and what was proved of each.

    Attributes
    ----------
    lanes : Lanes
    seen : array of int
        ``REST``, ``RELEASED``, ``INCOMPLETE`` or ``NONE``.
    proved : array of int
        ``REST`` or ``RELEASED``; ``INCOMPLETE`` where nothing is proved.
    t, v : array
        The impact from which it is proved; NaN where it is not.
    low, high : array
        Bounds of the time at which the impacts accumulate.
    """

    lanes: Lanes
    seen: np.ndarray
    proved: np.ndarray
    t: np.ndarray
    v: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def certified(self) -> np.ndarray:
        """Lanes of which complete chattering is proved."""
        return self.proved < INCOMPLETE

    @property
    def complete(self) -> np.ndarray:
        """Lanes in which it was seen."""
        return self.seen < INCOMPLETE

    @property
    def disagree(self) -> np.ndarray:
        """Lanes of which something is proved that was not seen, or not at that time.

        A lane whose bounds lie beyond the time to which it was flown shows nothing either way.
        """
        held = self.lanes.held
        late = held > self.high + SLACK
        early = held + self.tail < self.low - SLACK
        other = ~self.complete & (self.high < self.lanes.end)
        kinds = self.complete & (self.seen != self.proved)
        return self.certified & (late | early | other | kinds)

    @property
    def unproved(self) -> np.ndarray:
        """Lanes in which complete chattering was seen, and nothing is proved."""
        return self.complete & ~self.certified

    @property
    def press(self) -> np.ndarray:
        """The force on the obstacle when the beam was held."""
        own, lanes = beam(), self.lanes
        drive = lanes.gamma * np.cos(lanes.w * lanes.held)
        return np.asarray(own.obstacle**3 - own.obstacle - drive)

    @property
    def tail(self) -> np.ndarray:
        """An estimate of what is left of the series when the beam is held, from above."""
        return np.asarray(2.0 * HELD / (self.press * (1.0 - beam().r)) * 2.0)

    @property
    def undecided(self) -> np.ndarray:
        """Lanes that were held too late to be seen through a period of the forcing."""
        return self.lanes.late


@cache
def whole() -> Map:
    """The map on its grid."""
    return compared(fly({"gamma": GAMMAS, "delta": DELTAS, "w": SLICES}, store=KEPT))


def compared(lanes: Lanes) -> Map:
    """Each lane's kind, as seen and as proved."""
    held = ~np.isnan(lanes.held)
    seen = np.where(lanes.longest >= SERIES, INCOMPLETE, NONE)
    seen = np.where(held, np.where(np.isnan(lanes.released), REST, RELEASED), seen)
    rows = np.array([proof(lanes, place) for place in range(len(lanes.gamma))])
    t, v, low, high = rows.T
    always = np.array([pushes_always(gamma) for gamma in lanes.gamma])
    proved = np.where(np.isnan(low), INCOMPLETE, np.where(always, REST, RELEASED))
    return Map(lanes, seen, proved, t, v, low, high)


def proof(lanes: Lanes, place: int) -> tuple[float, float, float, float]:
    """The earliest impact kept from which a lane is proved to chatter, and the bounds; or NaN."""
    parameters = lanes.delta[place], lanes.gamma[place], lanes.w[place]
    for t, v in zip(lanes.times[place].tolist(), lanes.speeds[place].tolist(), strict=True):
        if np.isnan(v) or v < HELD:
            continue
        bounds = accumulates(*parameters, t, v)
        if bounds is not None:
            return t, v, *bounds
    return np.nan, np.nan, np.nan, np.nan


def safe_gamma(found: Map, w: float) -> float:
    """The largest forcing of the grid up to which all beams of a slice rest for ever."""
    here = found.lanes.w == w
    bad = found.lanes.gamma[here & (found.seen != REST)]
    good = GAMMAS[: int(np.searchsorted(GAMMAS, np.min(bad, initial=np.inf)))]
    return float(good[-1]) if good.size else np.nan


# ---------------------------------------------------------------------------------------
# the figure


def map_figure() -> Figure:
    """Seen beside proved, over the frequency of the forcing."""
    stops = [(f"{w:g}", slice_at(w)) for w in SLICES]
    return slid(
        Slider(label="w", stops=stops, start=SLICES.index(1.0)),
        name="beam-map",
        title="The beam from (1.3, 0): what is simulated, and what is proved",
    )


def slice_at(w: float) -> Columns:
    """Both panels at a frequency."""
    found = whole()
    here = np.flatnonzero(found.lanes.w == w)
    shape = (len(GAMMAS), len(DELTAS))
    notes = np.array([note(found, int(place)) for place in here]).reshape(shape).T
    border = beam().obstacle ** 3 - beam().obstacle
    line = Curve(
        x=[border, border], y=[0.0, DELTAS[-1]], look="limit", name="gamma = phi^3 - phi = 0.231"
    )
    wrong = here[found.disagree[here]]
    marks = Curve(
        x=found.lanes.gamma[wrong], y=found.lanes.delta[wrong], look="impact", name="disagreement"
    )
    curves = [line, *([marks] if wrong.size else [])]
    panels = []
    for kinds, kind, title in (
        (KINDS, found.seen, "simulated, impact by impact"),
        (PROVED, found.proved, "proved, from an impact on"),
    ):
        values = kind[here].reshape(shape).T
        cells = Cells(x=GAMMAS, y=DELTAS, kind=values, kinds=kinds, notes=notes)
        panels.append(Panel(curves=curves, cells=cells, x="gamma", y="delta", title=title))
    return tuple((panel,) for panel in panels)


def note(found: Map, place: int) -> str:
    """What a cell says when it is hovered."""
    lanes = found.lanes
    head = (
        f"delta {lanes.delta[place]:.4g}, gamma {lanes.gamma[place]:.6g}, w {lanes.w[place]:g}<br>"
    )
    what = KINDS[found.seen[place]][0]
    if found.complete[place]:
        what += f"; impacts below {HELD:g} at t = {lanes.held[place]:.6f}"
    if found.certified[place]:
        what += (
            f"<br>proved from the impact at t = {found.t[place]:.6f} of speed "
            f"{found.v[place]:.3g}: they accumulate in [{found.low[place]:.6f}, "
            f"{found.high[place]:.6f}]"
        )
    else:
        what += f"<br>{lanes.count[place]} impacts; nothing proved"
    return head + what
