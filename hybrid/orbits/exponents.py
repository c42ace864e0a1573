"""``hy.lyapunov``: mean rates of separation of neighbouring trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.base import COUNT_IN_RUN, require_model, require_no_discrete
from ..errors import OptionError, OrbitError
from ..result import Trajectory
from ..run.options import require_taken, time_of, times_of
from ..simulation import simulate, whole
from ..trajectory.trajectory import Status
from ..variation import GROWN_APART, TRANSIENT, factors, first_frame, grown, largest

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Number of consecutive parts of a run whose mean rates give the standard error.
BATCHES = 20

#: Number of running estimates that are returned, spaced evenly over the run.
RUNNING_ESTIMATES = 200


@attrs.frozen(eq=False, repr=False)
class Exponents:
    """Lyapunov exponents of a run, and their convergence.

    Attributes
    ----------
    exponents : array, shape (count,)
        Mean rates of separation, in one over the unit of time, largest first; ``-inf`` for
        directions that are lost permanently (at rest, while sliding, through an accumulation).
    error : array, shape (count,)
        Standard error of each exponent, from the mean rates in twenty consecutive parts of the run.
        NaN for the exponent ``-inf``, or if the run is too short to be divided.
    sum : float
        Sum of the exponents.
    times : array, shape (k,)
    running : array, shape (k, count)
        Estimates from the time between the end of the transient and each of ``times``.
    run : Trajectory
        The run after the transient.
    """

    exponents: Numbers
    error: Numbers
    times: Numbers
    running: Matrix
    run: Trajectory

    @property
    def sum(self) -> float:
        return float(np.sum(self.exponents))

    def __str__(self) -> str:
        pairs = zip(self.exponents, self.error, strict=True)
        values = ", ".join(
            f"{value:.6g}" + (f" ± {error:.1g}" if np.isfinite(error) else "")
            for value, error in pairs
        )
        return f"{self.run.spec.model}: {values} over t = {self.run.t0:.6g} to {self.run.t1:.6g}"

    __repr__ = __str__


def lyapunov(
    model: Any,
    start: Any,
    t: tuple[float, float],
    *,
    count: int | None = None,
    transient: float | None = None,
    **options: Any,
) -> Exponents:
    """Lyapunov exponents of a hybrid flow.

    Parameters
    ----------
    model : Automaton
    start, t
        As for :func:`hybrid.simulate`.
    count : int, optional
        Number of exponents, from the largest on; all if omitted.
    transient : float, optional
        Duration at the beginning that is left out of the averages; a tenth of the run if omitted.
    options
        As for :func:`hybrid.simulate`.

    Returns
    -------
    Exponents

    Raises
    ------
    OptionError
        If ``t``, ``count``, ``transient`` or another option cannot be used.
    OrbitError
        If the run ends early, grazes a guard, or passes the limit of a cycle of several edges; for
        a model with delays, which has infinitely many exponents.

    Notes
    -----
    An orthonormal frame is propagated along the run by the first variation of its steps and the
    saltation matrices of its jumps, and orthonormalized after each of them; the logarithms
    of its growth factors are summed. Sources: Benettin, Galgani, Giorgilli & Strelcyn, Meccanica 15
    (1980); Müller, Chaos, Solitons & Fractals 5 (1995) for systems with jumps.

    In an autonomous model one exponent is 0: that of a perturbation along the run.

    Examples
    --------
    >>> hy.lyapunov(Lorenz(), [1.0, 1.0, 20.0], (0.0, 1000.0)).exponents
    array([ 0.90..., 0.00..., -14.57...])
    """
    require_model(model)
    require_no_discrete(model, "hy.lyapunov", COUNT_IN_RUN)
    if model.spec.lags:
        raise OrbitError(
            f"{model.spec.model} looks into the past: its exponents are those of its history, of "
            "which there are infinitely many; they are not computed"
        )
    require_taken(model.spec.model, options, simulate)
    size = model.spec.dimension
    count = size if count is None else count
    if not (isinstance(count, int | np.integer) and 1 <= count <= size):
        raise OptionError(f"count={count!r}: a whole number from 1 to {size}")
    first, last = times_of(t)
    usual = TRANSIENT * (last - first)
    begin = first + (usual if transient is None else time_of("transient", transient))
    if not first <= begin < last:
        raise OptionError(f"transient={transient!r}: a time shorter than the run, {t!r}")
    frame, options = first_frame(size, int(count)), {**options, "save": "dense"}
    before = None
    if begin > first:
        before = _run(model, start, (first, begin), options)
        start, options["mode"] = before.final, before.mode
    run = _run(model, start, (begin, last), options)
    sizes = largest(run.parts)
    if before is not None:
        frame = grown(model.spec.model, factors(model, before, GROWN_APART), frame, sizes)[2]
    times, growth, _ = grown(model.spec.model, factors(model, run, GROWN_APART), frame, sizes)
    return _exponents(times, growth, run)


def _run(model: Any, start: Any, t: tuple[float, float], options: dict[str, Any]) -> Trajectory:
    """Simulate a run; raise an :class:`OrbitError` if it ends before its last time."""
    run = whole(simulate(model, start, t, **options))
    if run.status is not Status.REACHED_END:
        raise OrbitError(f"{run.spec.model}: the run ended at t = {run.t1:.9g}: {run.status}")
    return run


def _exponents(times: Numbers, growth: Matrix, run: Trajectory) -> Exponents:
    total, spans = np.cumsum(growth, axis=0), times - run.t0
    at = np.unique(np.linspace(np.argmax(spans > 0), len(times) - 1, RUNNING_ESTIMATES).astype(int))
    running = total[at] / spans[at, None]
    order = np.argsort(-running[-1], kind="stable")
    error = _error(times, total, run.t0)
    return Exponents(running[-1][order], error[order], times[at], running[:, order], run)


def _error(times: Numbers, total: Matrix, first: float) -> Numbers:
    """Standard error of the mean rates of growth, from those of parts of the run."""
    ends = np.linspace(first, times[-1], BATCHES + 1)[1:]
    index = np.unique(np.searchsorted(times, ends - 1e-12 * (times[-1] - first)))
    if len(index) < 3:
        return np.full(total.shape[1], np.nan)
    start = np.zeros((1, total.shape[1]))
    with np.errstate(invalid="ignore"):
        gained = np.diff(np.concatenate([start, total[index]]), axis=0)
        lasted = np.diff(np.append(first, times[index]))
        mean = total[-1] / (times[-1] - first)
        spread = ((gained - mean * lasted[:, None]) ** 2).sum(axis=0)
        parts = len(index)
        error: np.ndarray = np.sqrt(spread * parts / (parts - 1)) / (times[-1] - first)
    return error
