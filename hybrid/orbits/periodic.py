"""``hy.periodic_orbit``: find an orbit, close it by Newton's method, describe it."""

from __future__ import annotations

import warnings
from collections import Counter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.polynomial import chebyshev

from ..automaton.base import COUNT_IN_RUN, require_model, require_no_discrete
from ..automaton.markers import RISING, Crossing
from ..automaton.record import Record
from ..errors import OptionError, OrbitError
from ..lowering import Scene, scene_of
from ..result import Trajectory
from ..run.options import Asked, chosen, mode_of, require_count, require_taken, time_of
from ..run.sections import section_of
from ..simulation import simulate
from ..solvers import renamed
from ..variation import Factor
from .delayed import require_constant
from .grazing import near_grazing, turning
from .remembering import HistoryShooting
from .restarting import RestartShooting
from .returns import with_tolerances
from .search import Search, depends_on_time, given
from .shooting import Guess, Shooting, Shot

if TYPE_CHECKING:
    from ..automaton.shapes import ComplexNumbers, Matrix, Numbers

#: Distance from the unit circle below which a multiplier counts as neither inside nor outside.
NEUTRAL = 1e-6

#: For the check of an orbit with finer tolerances: the factor by which they are finer, the finest
#: ``rtol`` of all methods, how many times the drift must exceed the change that they cause, and the
#: rounding of one turn.
FINER_BY, FINEST_RTOL, SURE, TURN_ROUNDING = 30.0, 3e-14, 10.0, 3e-13


@attrs.frozen
class Stick:
    """A phase at rest on contacts, or sliding: its mode, and the times of its start and end."""

    mode: str
    t0: float
    t1: float


@attrs.frozen(eq=False, repr=False)
class PeriodicOrbit:
    """A periodic orbit, its shape and its stability.

    Attributes
    ----------
    period : float
    extrema : dict of (float, float)
        Minimum and maximum of each coordinate, by name.
    jumps : float
        Jumps per period, releases and switchings included; ``inf`` where they accumulate.
    sticks : tuple of Stick
        Phases at rest on contacts, or sliding.
    saltations : tuple of Factor
        Saltation matrices of the jumps and accumulations: ``.t .edge .matrix``.
    monodromy : array, shape (n, n)
        The fundamental matrix over a period, from ``start``.
    multipliers : array of complex, shape (n,)
        Eigenvalues of ``monodromy``, largest first. In an autonomous model one of them is 1: that
        of a perturbation along the orbit.
    stable : bool
        Whether all multipliers but that one lie inside the unit circle, by more than 1e-6.
    start : Record
        The state at ``run.t0``, in the middle of an arc.
    run : Trajectory
        One period.
    residual : float
        Largest difference between the ends of ``run``, relative to the size of the orbit.
    autonomous : bool
        Whether the model does not depend on time.
    grazing : tuple of str
        Sentences about guards that are touched, or crossed at very low speed; the multipliers may
        then not describe nearby motion.
    errors : array or None
        With delays and ``memory="keep"``: the change of each multiplier when the history is
        resolved more finely. Otherwise None.
    """

    period: float
    extrema: dict[str, tuple[float, float]]
    jumps: float
    sticks: tuple[Stick, ...]
    saltations: tuple[Factor, ...]
    monodromy: Matrix
    multipliers: ComplexNumbers
    stable: bool
    start: Record
    run: Trajectory
    residual: float
    autonomous: bool
    grazing: tuple[str, ...]
    errors: Numbers | None = None

    def __str__(self) -> str:
        outside = bool(np.any(np.abs(self.multipliers) > 1.0 + NEUTRAL))
        kind = "stable" if self.stable else "unstable" if outside else "neutral"
        edges = Counter(row.edge for row in self.run.own_jumps.values())
        counted = ", ".join(f"{count} {edge}" for edge, count in edges.items()) or "none"
        if self.run.zeno:
            counted += f", and {len(self.run.zeno)} accumulation(s) of infinitely many"
        lines = [
            f"{self.run.spec.model}: {kind} periodic orbit of period {self.period:.12g}",
            f"  multipliers  {', '.join(map(_number, self.multipliers))}",
            f"  jumps        {counted}",
        ]
        lines += [f"  {stick.mode:12} for {stick.t1 - stick.t0:.9g}" for stick in self.sticks]
        lines += [f"  {name:12} {a:.12g} to {b:.12g}" for name, (a, b) in self.extrema.items()]
        lines += [f"  {sentence}" for sentence in self.grazing]
        if _besides(self.multipliers, self.autonomous):
            lines.append(
                f"  a multiplier is 1{' besides that along the orbit' * self.autonomous}: not "
                "distinguishable from a motion that drifts by "
                f"{self.residual:.2g} of its size a turn"
            )
        return "\n".join([*lines, f"  closed to     {self.residual:.2g} of its size"])

    __repr__ = __str__


def periodic_orbit(
    model: Any,
    guess: Any,
    *,
    section: Any = None,
    period: float | None = None,
    t: float = 0.0,
    mode: str | None = None,
    settle: int = 0,
    t_max: float = 1000.0,
    tol: float = 1e-9,
    crossing: Crossing = RISING,
    **options: Any,
) -> PeriodicOrbit:
    """Find a periodic orbit near a guess, stable or not, and describe it.

    Parameters
    ----------
    model : Automaton
        Autonomous, or periodic in time.
    guess : dict, record, sequence or Trajectory
        A state near the orbit, or a run that ends near it.
    section : str, callable or float, optional
        As for :func:`hybrid.return_map`; one return is one period, so give an edge that fires once
        per period. A plane through the guess, across the flow, if omitted.
    period : float, optional
        If the model depends on time: the period of the orbit, a multiple of that of the
        forcing. Otherwise an initial guess of the period, in place of a section.
    t, mode
        Time and mode of the guess, unless it is a run.
    settle : int
        Number of periods to simulate before Newton's method begins, to approach a stable orbit.
    t_max : float
        The longest time that a return may take. The search for a return begins with short times, so
        the unit of time does not matter.
    tol : float
        The largest difference between the ends of the orbit, relative to its size.
    crossing : RISING, FALLING or EITHER
        The direction in which a surface given as ``section`` is crossed.
    options
        As for :func:`hybrid.simulate`; by default ``rtol=1e-12, atol=1e-13``.

    Returns
    -------
    PeriodicOrbit

    Raises
    ------
    OptionError, StartError
        If an option or the guess cannot be used, or the model depends on time and no period is
        given.
    OrbitError
        If no orbit is found; the message says how far the search came. Also if there is a second
        multiplier of 1 and the run drifts by more than the error of the integration.

    Warns
    -----
    UserWarning
        If the orbit touches a guard, or crosses one at almost zero speed.

    Notes
    -----
    Newton's method starts from the guess, then from the states after 8 and 64 periods. Its matrix
    is the product of the fundamental matrices of the arcs and the saltation matrices of the jumps;
    accumulations of impacts have one too (``docs/notes/orbits.md``). Source: di Bernardo, Budd,
    Champneys & Kowalczyk, *Piecewise-smooth Dynamical Systems* (2008).

    Examples
    --------
    >>> orbit = hy.periodic_orbit(VanDerPol(), {"x": 2.0, "v": 0.0})
    >>> orbit.period
    6.66328685932...
    """
    require_model(model)
    scene = scene_of(model, by="hy.periodic_orbit")
    require_no_discrete(model, "hy.periodic_orbit", COUNT_IN_RUN)
    require_count("settle", settle, 0)
    t_max, tol = time_of("t_max", t_max, 0.0), time_of("tol", tol, 0.0)
    options = {**with_tolerances(options, 1e-12, 1e-13), "save": "dense"}
    timed = depends_on_time(scene)
    if period is None and isinstance(section, int | float):
        period = float(section)
    if period is None and timed:
        raise OptionError(
            f"{scene.spec.model} depends on time: give period=, that of the forcing or a multiple"
        )
    if period is not None:
        period = time_of("period", period, 0.0)
    shooting = shooting_of(scene, options)(model, timed, tol, options)
    first = given(scene, guess, t, mode)
    if section is not None:
        section_of(model, scene, section, crossing)
    _require_run(scene, first, options)
    search = Search(shooting, section, period, t_max, crossing)
    orbit = _describe(shooting, search.find(first, settle))
    for sentence in orbit.grazing:
        warnings.warn(f"{scene.spec.model}: {sentence}", stacklevel=2)
    return orbit


def _require_run(scene: Scene, guess: Guess, options: dict[str, Any]) -> None:
    """Raise the errors of options that no run could use. (The search would take these errors for
    signs of a bad guess.)"""
    mode_of(scene, guess.mode)
    own = {name: value for name, value in options.items() if name not in ("history", "seed")}
    solver, method = renamed(own.pop("solver", "scipy"), own.pop("method", None))
    require_taken(scene.spec.model, own, simulate)
    asked = Asked(spec=scene.spec, solver=solver, method=method, **own)
    chosen(asked.plan((guess.t, guess.t + 1.0)), solver, method, asked.controller, scene.spec)


def shooting_of(scene: Scene, options: dict[str, Any]) -> type[Shooting]:
    """The class whose unknowns suit the model: a state in an arc; with delays, a history, or with
    ``memory="restart"`` the state after a jump."""
    if not scene.spec.lags:
        return Shooting
    require_constant(scene)
    return RestartShooting if options.get("memory") == "restart" else HistoryShooting


def _describe(shooting: Shooting, turn: Shot) -> PeriodicOrbit:
    """The orbit of a closed turn, with its multipliers and shape."""
    scene, run, autonomous = shooting.scene, turn.run, not shooting.timed
    found = shooting.describe(turn)
    values = found.multipliers
    others = _others(values, autonomous)
    if _besides(values, autonomous) and not scene.spec.lags:
        _require_closed(shooting, turn)
    return PeriodicOrbit(
        period=turn.guess.period,
        extrema=extrema(run),
        jumps=float("inf") if run.zeno else len(run.own_jumps),
        sticks=tuple(Stick(a.mode, a.t0, a.t1) for a in run.parts if a.t1 > a.t0 and a.constrained),
        saltations=tuple(found.saltations),
        monodromy=found.matrix,
        multipliers=values,
        stable=bool(np.all(np.abs(others) < 1.0 - NEUTRAL)),
        start=scene.spec.record(turn.guess.x),
        run=run,
        residual=turn.residual,
        autonomous=autonomous,
        grazing=tuple(near_grazing(run)),
        errors=found.errors,
    )


def _others(multipliers: ComplexNumbers, autonomous: bool) -> ComplexNumbers:
    """The multipliers without that of a perturbation along the orbit."""
    if not autonomous:
        return multipliers
    return np.delete(multipliers, np.argmin(np.abs(multipliers - 1.0)))


def _besides(multipliers: ComplexNumbers, autonomous: bool) -> bool:
    """Whether a multiplier other than that along the orbit is 1: the orbit may not be isolated."""
    return bool(np.any(np.abs(_others(multipliers, autonomous) - 1.0) < NEUTRAL))


def _require_closed(shooting: Shooting, turn: Shot) -> None:
    """Raise an :class:`OrbitError` if a turn drifts by more than the integration error."""
    options = dict(shooting.options)
    rtol, atol = options["rtol"], np.asarray(options["atol"], dtype=float)
    options |= {"rtol": min(rtol, max(rtol / FINER_BY, FINEST_RTOL)), "atol": atol / FINER_BY}
    finer = type(shooting)(shooting.model, shooting.timed, shooting.tol, options).turn(turn.guess)
    miss, error = np.abs(finer.miss) / turn.scale, np.abs(finer.miss - turn.miss) / turn.scale
    if np.max(miss) > max(SURE * np.max(error), TURN_ROUNDING):
        raise OrbitError(
            f"{shooting.scene.spec.model}: the run of {turn.guess.period:.9g} from "
            f"{shooting.scene.spec.record(turn.guess.x)} is no periodic orbit: it drifts by "
            f"{np.max(miss):.2g} of its size a turn, which is more than the integration error, and "
            "with a multiplier within 1e-6 of 1 no nearby orbit closes better; give another guess"
        )


def extrema(run: Trajectory) -> dict[str, tuple[float, float]]:
    """Minimum and maximum of each state element along a run, by name."""
    low = np.min([np.minimum(arc.first, arc.last) for arc in run.arcs], axis=0)
    high = np.max([np.maximum(arc.first, arc.last) for arc in run.arcs], axis=0)
    for arc in run.arcs:
        for segment in arc.segments:
            for i, series in enumerate(segment.coefficients.T):
                turns = chebyshev.chebval([-1.0, *turning(series), 1.0], series)
                low[i], high[i] = min([low[i], *turns]), max([high[i], *turns])
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return dict(zip(run.spec.element_names, pairs, strict=True))


def _number(value: complex) -> str:
    return f"{value.real:.9g}" if not value.imag else f"{value.real:.9g}{value.imag:+.9g}i"
