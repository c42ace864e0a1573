"""``run.settles()``: whether a run has reached rest or a periodic orbit, with the evidence."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..automaton.base import COUNT_IN_RUN, require_no_discrete
from ..events import bernstein_from_chebyshev, roots
from ..lowering import Kind
from ..segment import nodes
from ..solvers import Solver
from ..solvers.taylor_backend import TaylorSolver
from ..trajectory.arcs import Arc
from ..trajectory.log import Log
from ..trajectory.trajectory import Solution
from .standing import RATE_PARTS, SAMPLED_DEGREE, Standing, standing

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Three successive turns closer than this many times ``rtol`` are a closed orbit.
CLOSED_RTOLS = 10.0

#: Changes below this many times ``atol`` count as none.
STILL_ATOLS = 100.0

#: Longest orbit searched for, in returns.
LONGEST_ORBIT = 16

#: Least number of turns, and largest total distance that the remaining turns may cover, relative to
#: the size of the orbit.
SHRINKING, REMAINING_DISTANCE = 5, 1e-3

#: Distances must have fallen by at least the first factor, and are examined back to the second. In
#: a slow passage or a beat they also fall by a large factor, but not at an even rate.
LEAST_FALL, LOOKED_AT_FALL = 10.0, 1e4

#: The (logarithmic) fall is even if neither half takes more than this factor times the turns of the
#: other, plus this number. Distances like 1/k^2, those of the slowest passage, give a ratio of 3.2
#: over a factor of 100 and of 1.8 over 10.
EVEN_RATIO, EVEN_TURNS = 1.4, 2.0

#: Distances are compared by the maximum of this many, as complex multipliers make them oscillate.
WAVE = 3

#: Fraction of the run for which a closed orbit must have been closed, unless it was approached
#: evenly.
SETTLED_SHARE = 0.25

#: Distances within this ratio count as similar.
ALIKE = 10.0

#: Fractions of a step at which the state is sampled.
STEP_SHARES = (0.0, 0.25, 0.5, 0.75)

#: Largest Newton correction, on the Chebyshev series, of a zero found in Bernstein form, which has
#: lost some digits of the highest terms.
NEWTON_MOVE = 1e-6

#: Number of last turns from which the rate of approach is taken.
MEAN_TURNS = 12

#: Most digits of a period that are shown.
DIGITS = 12


@attrs.frozen
class Settled:
    """What a run has settled to.

    Attributes
    ----------
    kind : "rest", "periodic" or "none"
    reason : str
        A sentence with the evidence.
    period : float or None
    jumps : float or None
        Jumps per period; ``inf`` where they accumulate.
    distance : float or None
        Distance between the last two turns (at rest: how far the state still moves), relative to
        the size of the orbit.
    rate : float or None
        Factor by which that distance changes per turn; None if it has been rounding all along.
    for_ever : bool
        Whether nothing can end the rest (see :mod:`.standing`).
    """

    kind: str
    reason: str
    period: float | None = None
    jumps: float | None = None
    distance: float | None = None
    rate: float | None = None
    for_ever: bool = False

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}"


@attrs.frozen(eq=False)
class Returns:
    """Times and states at which a run returns to some event or level."""

    to: str
    t: Numbers
    x: Matrix


@attrs.frozen(eq=False)
class Turns:
    """The last turns of a run, each of ``length`` returns, and the distances between them."""

    returns: Returns
    length: int
    distances: Numbers

    @property
    def period(self) -> float:
        return float(self.returns.t[-1] - self.returns.t[-1 - self.length])


def settles(run: Solution) -> Settled:
    """See :meth:`hybrid.Trajectory.settles`."""
    require_no_discrete(run, "run.settles", COUNT_IN_RUN)
    tol = CLOSED_RTOLS * max(_tolerances(run)[0], 1e-13)
    scale = _scale(run)
    stands = standing(run)
    if stands is not None and stands.but is None:
        return _for_ever(run, stands)
    found = _held(run, scale, tol) or _still(run, scale, tol) or _turning(run, scale, tol)
    but = _doubt(found, stands)
    return attrs.evolve(found, reason=f"{found.reason}; {but}") if but else found


def _tolerances(run: Solution) -> tuple[float, np.ndarray]:
    """The tolerances within which the caller means states to be equal: those of the run.

    The default tolerances of Taylor series only state their accuracy; the defaults of the other
    solvers are used instead.
    """
    usual = Solver.own_rtol, Solver.own_rtol / 100
    rtol, atol = (run.options.get(name, u) for name, u in zip(("rtol", "atol"), usual, strict=True))
    if run.options.get("solver") == "taylor":
        own = TaylorSolver.own_rtol
        rtol = usual[0] if rtol <= own else rtol
        atol = usual[1] if np.all(np.asarray(atol) <= own / 100) else atol
    return float(rtol), np.asarray(atol, dtype=float)


def _doubt(found: Settled, stands: Standing | None) -> str | None:
    """A clause saying that a rest may not last; None if it does not apply."""
    if found.kind == "periodic" or (stands is None and found.kind == "none"):
        return None
    if stands is None:
        return "not known to be for ever: its model is not at hand"
    if stands.still or (found.kind == "rest" and stands.doubtful):
        return f"not known to be for ever: {stands.but}"
    return None


def _turning(run: Solution, scale: Numbers, tol: float) -> Settled:
    """The result for an orbit, or for neither rest nor orbit."""
    tried = [turns for returns in _returns(run) for turns in _turns(returns, scale)]
    for turns in tried:
        if _settled(turns, run, tol):
            shortest = _shortest(turns, tried)
            if shortest is turns or _settled(shortest, run, tol):
                return _periodic(run, shortest, tol)
    return _none(run, tried)


# ---------------------------------------------------------------------------------------
# rest


def _scale(run: Solution) -> Numbers:
    """Size of each state element over the last half of a run."""
    states = _states(run, 0.5 * (run.t0 + run.t1))[1]
    size: np.ndarray = np.abs(states).max(axis=0)
    return np.where(size > 0, size, 1.0)


def _states(run: Solution, since: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a run from a time on: at the ends of arcs and within their steps."""
    times, states = [], []
    for arc in run.arcs:
        if arc.t1 >= since:
            inside = [s.start + share * s.length for s in arc.segments for share in STEP_SHARES]
            tau = np.array([0.0, *inside, arc.length])
            tau = tau[arc.t0 + tau >= since]
            times.append(arc.t0 + tau)
            states.append(arc.local(tau))
    return np.concatenate(times), np.concatenate(states)


def _moves(run: Solution, states: Matrix, scale: Numbers) -> float:
    """Spread of the states beyond the absolute tolerance, relative to their size.

    The tolerance is ignored if all states are below it: ``atol`` is then meant for other units.
    """
    slack = STILL_ATOLS * _tolerances(run)[1]
    slack = slack if np.any(run.size > slack) else 0.0 * slack
    return float(np.max(np.maximum(np.ptp(states, axis=0) - slack, 0.0) / scale))


def _for_ever(run: Solution, stands: Standing) -> Settled:
    lag = run.hindsight.longest
    still = f"since t = {stands.since:.9g} everything that"
    if stands.load is None:
        said = f"{still} the flow and the guards depend on stands still"
    else:
        said = (
            f"{still} the load depends on stands still; it is {stands.load:.6g} and was never "
            f"below {stands.least:.6g}"
        )
    why = "neither flow nor guards depend on time"
    why += f", and the longest lag, {lag:.6g}, has passed" if lag else ""
    said = f"rests for ever in {run.mode}: {said} ({why})"
    return Settled("rest", said, None, 0, 0.0, None, for_ever=True)


def _held(run: Solution, scale: Numbers, tol: float) -> Settled | None:
    """Rest on contacts or a surface over at least the last quarter of the run, or None."""
    arc = run.parts[-1]
    whole = run.t1 - run.t0
    if not isinstance(arc, Arc) or not arc.constrained or arc.length < 0.25 * whole:
        return None
    times, states = _states(attrs.evolve(run, log=Log([arc])), arc.t0)
    moved = _moves(run, states, scale)
    if moved > tol:
        return None
    said = f"rests in {arc.mode} since t = {arc.t0:.9g}, for {arc.length:.6g}"
    loads = _loads(run, times, states)
    if loads:
        early, late = min(loads[: len(loads) // 2 + 1]), min(loads[len(loads) // 2 :])
        if not 2.0 * late > early:
            return None
        said += f": the load stays at {min(loads):.6g} or more"
    changes = (
        "does not change"
        if not np.any(np.ptp(states, axis=0))
        else ("changes by no more than the tolerances tell")
    )
    return Settled("rest", f"{said}; the state {changes}", distance=moved)


def _loads(run: Solution, times: Numbers, states: Matrix) -> list[float]:
    """The loads of the contacts held at the end, at the given times; empty if not known."""
    if run.hindsight is None:
        return []
    found = []
    for t, x in zip(times.tolist(), states.tolist(), strict=True):
        field = run.hindsight.at(len(run.parts) - 1, t).field(run.mode)
        found += [g.value(t, x) for g in field.guards if g.kind is Kind.RELEASE]
    return found


def _still(run: Solution, scale: Numbers, tol: float) -> Settled | None:
    """Convergence to a point, without a jump, over the last half of the run, or None."""
    middle = 0.5 * (run.t0 + run.t1)
    if len(run.jumps) and run.jumps.t[-1] > middle:
        return None
    times, states = _states(run, middle)
    part = np.minimum(
        ((times - middle) / (run.t1 - middle) * RATE_PARTS).astype(int), RATE_PARTS - 1
    )
    if len(np.unique(part)) < RATE_PARTS:
        states = np.array([np.concatenate([np.ravel(v) for v in run(t)]) for t in _even(run)])
        part = np.repeat(np.arange(RATE_PARTS), len(states) // RATE_PARTS)
    moves = np.array([_moves(run, states[part == k], scale) for k in range(RATE_PARTS)])
    each, (first, last) = (run.t1 - middle) / RATE_PARTS, (float(moves[0]), float(moves[-1]))
    said = f"tends to a point: the moves in times of {each:.6g}"
    if np.all(moves <= tol):
        said += " are no more than the tolerances tell"
    elif _falls(moves) and _beyond(moves) <= REMAINING_DISTANCE:
        said += f" fall from {first:.3g} to {last:.3g} of its size"
    else:
        return None
    return Settled("rest", said, None, 0, last, _rate(moves, tol))


def _even(run: Solution) -> np.ndarray:
    """Evenly spaced times in the last half of a run."""
    return np.linspace(0.5 * (run.t0 + run.t1), run.t1, 16 * RATE_PARTS)


# ---------------------------------------------------------------------------------------
# returns and turns


def _returns(run: Solution) -> list[Returns]:
    """Returns of a run to limits of jumps, to jumps of each edge, and to a level; rarest first."""
    found = []
    for edges in {point.edges for point in run.zeno}:
        points = [p for p in run.zeno if p.edges == edges]
        states = [np.concatenate([np.ravel(v) for v in p.state]) for p in points]
        name = f"the limit of {', '.join(edges)}"
        found.append(Returns(name, np.array([p.t for p in points]), np.array(states)))
    rows = run.own_jumps.values()
    for edge in dict.fromkeys(row.edge for row in rows):
        chosen = [row for row in rows if row.edge == edge]
        after = np.array([row.after for row in chosen])
        found.append(Returns(edge, np.array([row.t for row in chosen]), after))
    found.append(_crossings(run))
    late = [r for r in found if len(r.t) > SHRINKING and r.t[-1] > run.t1 - _longest(r.t)]
    return sorted(late, key=lambda returns: len(returns.t))


def _longest(times: Numbers) -> float:
    """Twice the longest recent time between returns: after a longer pause they have ceased."""
    return 2.0 * float(np.max(np.diff(times[-LONGEST_ORBIT:])))


def _crossings(run: Solution) -> Returns:
    """Upward crossings of the mid-level of the coordinate with the largest relative variation."""
    states = _states(run, 0.5 * (run.t0 + run.t1))[1]
    spread, size = np.ptp(states, axis=0), np.abs(states).max(axis=0)
    i = int(np.argmax(spread / np.where(size > 0, size, 1.0)))
    level, name = 0.5 * (states[:, i].min() + states[:, i].max()), run.spec.element_names[i]
    times, points = [], []
    for arc in run.arcs:
        for segment in arc.segments:
            above = segment.at(nodes(SAMPLED_DEGREE))[:, i] > level
            if above.any() and not above.all():
                for xi in _rising(segment.coefficients[:, i], level):
                    tau = segment.start + 0.5 * (xi + 1.0) * segment.length
                    times.append(arc.t0 + tau)
                    points.append(segment(tau))
    shape = (len(times), run.spec.dimension)
    return Returns(f"{name} = {level:.6g}", np.array(times), np.array(points).reshape(shape))


def _rising(series: Numbers, level: float) -> list[float]:
    """Where a Chebyshev series rises through a level, in (-1, 1]."""
    series = chebyshev.chebsub(series, [level])
    b = bernstein_from_chebyshev(len(series) - 1) @ series
    xi = np.array([2.0 * s - 1.0 for s, direction in roots(b, 0, 0.0) if direction > 0])
    steps = chebyshev.chebval(xi, series) / chebyshev.chebval(xi, chebyshev.chebder(series))
    near = np.abs(steps) <= NEWTON_MOVE
    return np.where(near, np.minimum(xi - steps, 1.0), xi).tolist()


def _turns(returns: Returns, scale: Numbers) -> Iterator[Turns]:
    """Turns of 1, 2, ... returns, each with the distances between successive turns."""
    t, x = returns.t, returns.x / scale
    for length in range(1, LONGEST_ORBIT + 1):
        if len(t) < (SHRINKING + 1) * length + 1:
            return
        lasts = t[length:] - t[:-length]
        apart = np.abs(x[length:] - x[:-length]).max(axis=1)
        if not np.all(lasts > 0):
            continue
        later = np.abs(lasts[length:] - lasts[:-length]) / lasts[length:]
        each = np.maximum(apart[length:], later)
        count = len(each) // length
        yield Turns(returns, length, each[-count * length :].reshape(count, length).max(axis=1))


def _settled(turns: Turns, run: Solution, tol: float) -> bool:
    """Whether turns have reached an orbit, or approach one at a conclusive rate."""
    distances = _highest(turns.distances, WAVE)
    if distances[-1] > tol:
        return _falls(distances) and _beyond(distances) <= REMAINING_DISTANCE
    arrived = int(np.flatnonzero(np.append(True, distances[:-1] > tol))[-1])
    closed = (len(distances) - arrived + WAVE) * turns.period
    return closed >= SETTLED_SHARE * (run.t1 - run.t0) or _falls(distances[: arrived + 1])


def _highest(values: Numbers, count: int) -> Numbers:
    """The running maximum over ``count`` values."""
    if len(values) < count:
        return values[-1:]
    highest: np.ndarray = np.lib.stride_tricks.sliding_window_view(values, count).max(axis=1)
    return highest


def _falls(distances: Numbers) -> bool:
    """Whether distances fall by a large factor at an even rate.

    A passage near an almost closed orbit becomes slower and slower; a beat approaches its turning
    point faster and faster.
    """
    last = float(distances[-1])
    if last > distances.min() or not distances.max() >= LEAST_FALL * last:
        return False
    top = min(float(distances.max()), LOOKED_AT_FALL * last)
    start = int(np.flatnonzero(distances >= top)[-1])
    half = int(np.flatnonzero(distances >= np.sqrt(top * last))[-1])
    before, after = half - start, len(distances) - 1 - half
    return after <= EVEN_RATIO * before + EVEN_TURNS and before <= EVEN_RATIO * after + EVEN_TURNS


def _beyond(distances: Numbers) -> float:
    """Total distance that future turns will cover at the recent rate."""
    last = float(distances[-1])
    start = int(np.flatnonzero(distances >= LEAST_FALL * last)[-1])
    if not last:
        return 0.0
    rate = (last / float(distances[start])) ** (1.0 / (len(distances) - 1 - start))
    return last / (1.0 - rate)


def _shortest(turns: Turns, tried: list[Turns]) -> Turns:
    """The shortest orbit that closes about as well; it may rotate while it shrinks."""
    return next(
        shorter
        for shorter in tried
        if shorter.returns is turns.returns
        and turns.length % shorter.length == 0
        and shorter.distances[-1] <= ALIKE * turns.distances[-1]
    )


def _rate(distances: Numbers, tol: float) -> float | None:
    """Mean ratio of successive distances, as far as they exceed rounding; None if none do."""
    recent = distances[-MEAN_TURNS:]
    ratios = [after / before for before, after in pairwise(recent) if after > 1e-2 * tol]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


def _periodic(run: Solution, turns: Turns, tol: float) -> Settled:
    last, first = turns.returns.t[-1], turns.returns.t[-1 - turns.length]
    inside = (run.jumps.t > first) & (run.jumps.t <= last)
    limits = [point for point in run.zeno if first < point.t <= last]
    jumps = float("inf") if limits else int(np.sum(inside))
    distances, rate = turns.distances, _rate(turns.distances, tol)
    counted = "infinitely many jumps" if limits else f"{jumps} jump{'s' * (jumps != 1)}"
    how = f"the last turns are {distances[-3:].max():.3g} of its size apart at most"
    far = float(distances[-3:].max())
    if rate is not None and far > tol:
        how = f"the distance between turns shrinks by {rate:.3g} each turn, to {distances[-1]:.3g}"
        far = _beyond(_highest(distances, WAVE))
    digits = int(np.clip(-np.log10(max(far, 10.0**-DIGITS)), 1, DIGITS))
    said = f"periodic with {counted} a period, T = {turns.period:.{digits}g}"
    said += f" (returns to {turns.returns.to})"
    return Settled("periodic", f"{said}; {how}", turns.period, jumps, float(distances[-1]), rate)


def _none(run: Solution, tried: list[Turns]) -> Settled:
    if not tried:
        few = f"fewer than {SHRINKING + 2} returns to anything in t = {run.t0:.6g} to {run.t1:.6g}"
        return Settled("none", f"neither at rest nor long enough to show a period: {few}")
    best = min(tried, key=lambda turns: float(turns.distances[-SHRINKING:].max()))
    distance = float(best.distances[-SHRINKING:].max())
    falls = np.all(np.diff(best.distances[-SHRINKING:]) < 0)
    how = "shrinks too slowly to tell" if falls else "does not shrink"
    return Settled(
        "none",
        f"not at rest, and no orbit of up to {LONGEST_ORBIT} returns closes: the nearest, of "
        f"{best.length} return{'s' * (best.length > 1)} to {best.returns.to}, is {distance:.3g} of "
        f"its size apart from turn to turn, and {how}",
        distance=distance,
    )
