"""Section 4, the map: for which damping and forcing the beam with the obstacle chatters.

At each point (delta, gamma, w) a *run* passes accumulations by their sums, proves them, rests and
is released. *Brute force*, with another solver, sums and proves nothing: it makes impact after
impact until they are slower than ``SLOW``. It starts twice: from the paper's start, and from the
impact from which the run is proved to chatter. The second is the test of the proof, which speaks of
that impact; before it, motions at high frequencies can be chaotic, and no two solvers agree.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import attrs
import numpy as np

from ..ensembles import ensemble
from ..gallery import find
from ..simulation import simulate
from ..trajectory import Trajectory

START = {"x": 1.3, "v": 0.0}

DELTAS = np.arange(6) / 10.0
GAMMAS = np.array([*np.arange(9) / 40.0, 0.23, 0.232, 0.24, 0.25, *np.arange(11, 25) / 40.0])
FREQUENCIES = (0.1, 0.5, 1.0, 2.0, 4.0)

#: How long a run is: time for the first series, and periods of the forcing after it.
FIRST, PERIODS = 40.0, 2.0

#: Impacts that brute force makes, and the speed below which they are seen to accumulate: at
#: slower ones the rounding of the position begins to show.
BRUTE, SLOW = 600, 1e-6

#: How far brute force may be from the proved time: its last impacts are rounding.
NEAR = 1e-3

#: A series is incomplete chattering if so many impacts in a row are each slower than the last.
IN_A_ROW = 10

RESTS, RELEASED, INCOMPLETE, NONE = range(4)
KINDS = (
    ("chatters completely, rests for ever", "#2e8b57"),
    ("chatters completely, is released again", "#e0a83e"),
    ("chatters incompletely", "#6d9ac4"),
    ("does not chatter", "#c9ced4"),
)


@attrs.frozen(kw_only=True)
class Point:
    """One point of the map.

    Attributes
    ----------
    kind : int
        Index into ``KINDS``, from the run.
    t_inf : float
        The run's first accumulation; NaN if there is none.
    since, speed : float
        The impact from which it is proved, and the speed after it; NaN if it is not.
    enclosure : (float, float)
        Where the accumulation is proved to be, from that impact.
    seen : bool
        Whether brute force from the start came below ``SLOW``.
    followed : float
        The time to which brute force from that impact came with speeds below ``SLOW``; NaN if
        they do not fall below it.
    """

    delta: float
    gamma: float
    w: float
    kind: int
    t_inf: float = np.nan
    since: float = np.nan
    speed: float = np.nan
    enclosure: tuple[float, float] = (np.nan, np.nan)
    seen: bool = False
    followed: float = np.nan

    @property
    def chatters(self) -> bool:
        """Whether the run has an accumulation."""
        return self.kind in (RESTS, RELEASED)

    @property
    def certified(self) -> bool:
        """Whether complete chattering is proved."""
        return bool(np.isfinite(self.since))

    @property
    def confirmed(self) -> bool:
        """Whether what is certified is seen, when the proof says."""
        low, high = self.enclosure
        return low - NEAR < self.followed < high + NEAR

    def __str__(self) -> str:
        text = f"delta = {self.delta:g}, gamma = {self.gamma:g}, w = {self.w:g}<br>"
        text += KINDS[self.kind][0]
        if self.chatters:
            text += f"<br>first accumulation at t = {self.t_inf:.9g}"
        if self.certified:
            text += f"<br>proved from the impact at t = {self.since:.6g} on"
        return text


@cache
def points() -> tuple[Point, ...]:
    """The whole map: w slowest, then gamma, then delta."""
    grid = [(d, g, w) for w in FREQUENCIES for g in GAMMAS.tolist() for d in DELTAS.tolist()]
    found = [_point(*place) for place in grid]
    delta, gamma, w = np.array(grid).T
    seen, _ = _brute(delta, gamma, w, 0.0, START["x"], START["v"])
    proved = [i for i, point in enumerate(found) if point.certified]
    impacts = np.array([(found[i].since, found[i].speed) for i in proved]).T
    wall = beam()().obstacle
    slow, times = _brute(delta[proved], gamma[proved], w[proved], impacts[0], wall, impacts[1])
    followed = dict(zip(proved, np.where(slow, times, np.nan).tolist(), strict=True))
    return tuple(
        attrs.evolve(point, seen=bool(seen[i]), followed=followed.get(i, np.nan))
        for i, point in enumerate(found)
    )


def horizon(w: Any) -> Any:
    """The last time of a run."""
    return FIRST + PERIODS * 2.0 * np.pi / w


@cache
def beam() -> Any:
    return find("moon_holmes").cls


def _brute(delta: Any, gamma: Any, w: Any, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
    """Impact after impact, in compiled lanes: whether they become slow, and the last time."""
    lanes = ensemble(
        beam()(),
        {"x": x, "v": v},
        (t, horizon(w)),
        {"delta": delta, "gamma": gamma, "w": w},
        zeno="ignore",
        max_jumps=BRUTE,
        rtol=1e-9,
        atol=1e-11,
    )
    slow = (lanes.status == "max_jumps") & (np.abs(lanes.v) < SLOW)
    return slow.values, lanes.t.values


def run_of(
    delta: float, gamma: float, w: float, rtol: float = 1e-9, atol: float = 1e-11
) -> Trajectory:
    """The run at one point."""
    model = beam()(delta=delta, gamma=gamma, w=w)
    options: dict[str, Any] = {"solver": "taylor", "save": "jumps", "rtol": rtol, "atol": atol}
    return simulate(model, START, (0.0, float(horizon(w))), **options)


def _point(delta: float, gamma: float, w: float) -> Point:
    run = run_of(delta, gamma, w)
    point = Point(delta=delta, gamma=gamma, w=w, kind=kind_of(run))
    if not run.zeno:
        return point
    point, proofs = attrs.evolve(point, t_inf=run.zeno[0].t), run.zeno[0].proofs
    if not proofs:
        return point
    first = proofs[0]
    bounds = (first.low, first.high)
    return attrs.evolve(point, since=first.t, speed=first.speed, enclosure=bounds)


def kind_of(run: Trajectory) -> int:
    """What a run does, by its accumulations, their releases, and the speeds of its impacts."""
    if run.zeno:
        return RESTS if run.zeno[-1].t_release is None and len(run.zeno) == 1 else RELEASED
    speeds = np.asarray(run.jumps.after.v)
    return INCOMPLETE if _longest(speeds) >= IN_A_ROW else NONE


def _longest(speeds: np.ndarray) -> int:
    """Most impacts in a row that are each slower than the last, before a faster one."""
    longest = count = 0
    for slower in (np.diff(speeds) < 0).tolist():
        count = count + 1 if slower else 0
        longest = max(longest, count)
    return longest
