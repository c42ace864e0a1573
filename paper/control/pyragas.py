"""Section 6 of the paper computed: its system with the memory kept at impacts, and restarted.

Kept: the delay equation as it is written. Restarted: after an impact the past is the state
after it, which is what a solver sees that is started there again and given no history.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.orbits import ReturnMap, periodic_orbit, return_map
from hybrid.result import Trajectory
from hybrid.simulation import simulate
from hybrid.trajectory.arcs import Arc

#: The starts of Table 1, and the one of which the paper says that it chatters.
STARTS, CHATTERS = (2.5, 3.0, 5.0, 10.0, 100.0, 200.0), 2.1

#: What Table 1 prints for all its starts.
PERIOD, AMPLITUDE = "1.22", "2.933"

#: Tolerances: where digits are shown, and where a run only has to come near an orbit.
EXACT: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12}
NEAR = 1e-10

#: A tolerance whose distance to ``EXACT`` tells how accurate that is.
COARSER = 1e-11


def model(**parameters: float) -> Any:
    """The controlled system; C = -30, tau = 1 and r = 0.6 where nothing else is given."""
    return gallery.find("pyragas").cls(**parameters)


@cache
def at_rest(x0: float, until: float = 5.0, **parameters: float) -> Trajectory:
    """The run from a constant history, its memory kept."""
    return simulate(model(**parameters), {"x1": x0, "x2": 0.0}, (0.0, until), **EXACT)


@cache
def restarted(x0: float, until: float = 40.0, tol: float = NEAR) -> Trajectory:
    """The run from a constant history, its memory restarted at impacts."""
    start = {"x1": x0, "x2": 0.0}
    return simulate(model(), start, (0.0, until), memory="restart", rtol=tol, atol=tol)


def top(arc: Arc) -> float:
    """The height at which a flight turns."""
    from scipy.optimize import brentq

    turn = brentq(lambda s: float(arc.local(s)[1]), 0.0, arc.length, xtol=1e-15)
    return float(arc.local(turn)[0])


# ---------------------------------------------------------------------------------------
# the restarted system is a map of one number: from the speed after an impact to the next


@cache
def returns(tol: float = EXACT["rtol"]) -> ReturnMap:
    """The return map to the impact."""
    return return_map(model(), "impact", memory="restart", t_max=20.0, rtol=tol, atol=tol)


def returned(v: float, tol: float = EXACT["rtol"]) -> float:
    """The speed after the impact that follows one left with speed ``v``."""
    return float(returns(tol)({"x1": model().wall, "x2": v}).x2)


def first_speed(x0: float, tol: float = EXACT["rtol"]) -> float:
    """Speed after the first impact from a height."""
    return float(returns(tol)({"x1": x0, "x2": 0.0}).x2)


@attrs.frozen
class Border:
    """What divides the starts that chatter from those that do not.

    Attributes
    ----------
    speed : float
        Speed after its impact of the orbit that repels.
    multiplier : float
        Of that orbit.
    start : float
        Height from which the motion comes to it.
    """

    speed: float
    multiplier: float
    start: float


@cache
def orbit(tol: float = EXACT["rtol"]) -> Any:
    """The orbit that Table 1 shows, with its multipliers."""
    return _closed(5.7, tol)


@cache
def border(tol: float = EXACT["rtol"]) -> Border:
    """The orbit that repels, and the height from which it is reached."""
    from scipy.optimize import brentq

    speed = brentq(lambda v: returned(v, tol) - v, 2.0, 2.2, xtol=1e-13)
    multiplier = _closed(speed, tol).multipliers[0].real
    start = brentq(lambda x0: first_speed(x0, tol) - speed, 2.38, 2.39, xtol=1e-14)
    return Border(float(speed), float(multiplier), float(start))


def _closed(speed: float, tol: float) -> Any:
    guess = {"x1": model().wall, "x2": speed}
    return periodic_orbit(model(), guess, section="impact", memory="restart", rtol=tol, atol=tol)


# ---------------------------------------------------------------------------------------
# the table


@attrs.frozen(kw_only=True)
class Row:
    """A start of the table, with both memories.

    Attributes
    ----------
    x0 : float
    rests, error : float
        Memory kept: when the impacts accumulate, and a bound on that.
    certified, released : bool
        Whether that is proved, and whether the run shows a release after it.
    period, amplitude : float or None
        Memory restarted: of the orbit that the run comes to; None where it comes to rest.
    chatters, again : float or None
        Memory restarted: when the impacts accumulate, and a bound on its error; None where they
        do not.
    """

    x0: float
    rests: float
    error: float
    certified: bool
    released: bool
    period: float | None = None
    amplitude: float | None = None
    chatters: float | None = None
    again: float | None = None


@cache
def row(x0: float) -> Row:
    """What becomes of a start."""
    kept, again = at_rest(x0), restarted(x0)
    point = kept.zeno[0]
    found: dict[str, Any] = {
        "x0": x0,
        "rests": point.t,
        "error": point.t_error,
        "certified": point.verdict == "certified",
        "released": point.t_release is not None,
    }
    if again.zeno:
        ends = restarted(x0, again.zeno[0].t + 1.0, EXACT["rtol"]).zeno[0]
        return Row(**found, chatters=ends.t, again=ends.t_error)
    height = top(again.arcs[-2]) - model().wall
    return Row(**found, period=float(again.jumps.gaps[-1]), amplitude=height)


def drive(run: Trajectory) -> float:
    """The largest control in the last flight that a run of the restarted system ends before."""
    own, arc = model(), run.arcs[-2]
    s = np.linspace(0.0, arc.length, 401)
    past = np.where(s > own.tau, arc.local(np.maximum(s - own.tau, 0.0))[:, 0], own.wall)
    return float(np.max(np.abs(own.C * (past - arc.local(s)[:, 0]))))
