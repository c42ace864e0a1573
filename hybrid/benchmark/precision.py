"""Speed against error on a user's model: each solver at several tolerances, interleaved."""

from __future__ import annotations

import json
import os
import platform
import time
import tracemalloc
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from math import inf, isfinite, nan
from timeit import timeit
from typing import Any, Protocol

import attrs
import numpy as np

from ..automaton.reals import reals
from ..errors import PLOT, HybridError, OptionError, need
from ..plot.figure import Curve, Figure, Panel, column, looks_of_method
from ..result import Trajectory
from ..run.options import require_count
from ..simulation import simulate, whole
from ..solvers.base import FINEST
from ..trajectory.stats import versions
from .differences import differences

#: Default solvers and tolerances.
TIMED_SOLVERS = ("taylor", "scipy:DOP853", "scipy:LSODA", "diffrax:Dopri8", "diffrax:Tsit5")
TIMED_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)

#: Ratio of absolute to relative tolerances, as in the solvers' defaults.
ABSOLUTE_SHARE = 1e-2

#: Least duration of one timing, in seconds, to average over clock and scheduler; calls are repeated
#: accordingly.
LEAST_TIMING = 5e-3

#: Runs to compare with if the model has no exact values; a method is not compared with itself.
REFERENCES: dict[str, dict[str, Any]] = {
    "taylor": {"solver": "taylor"},
    "scipy:DOP853": {"solver": "scipy", "method": "DOP853", "rtol": FINEST, "atol": 1e-2 * FINEST},
}

#: Yields rows of name, computed value, exact value for a run.
Oracle = Callable[[Trajectory], Iterable[Sequence[Any]]]


@attrs.frozen(eq=False, kw_only=True)
class Timing:
    """One solver at one tolerance.

    Attributes
    ----------
    solver : str
        ``"solver:method"``.
    rtol : float
    error : float
        Relative error (see :func:`bench`); infinite if the jumps differ from the exact ones, NaN if
        the run failed.
    seconds : float
        Median duration of a call; ``low`` and ``high`` are the quartiles.
    first : float
        Duration of the first call of this solver, compilation included; NaN except at its first
        tolerance.
    steps, evaluations : int or None
        As in ``run.stats``.
    memory : int
        Peak memory of a call in bytes.
    reason : str
        Why there are no numbers; empty if there are.
    """

    solver: str
    rtol: float
    error: float = nan
    seconds: float = nan
    low: float = nan
    high: float = nan
    first: float = nan
    steps: int | None = None
    evaluations: int | None = None
    memory: int = 0
    reason: str = ""


@attrs.frozen(eq=False)
class Bench:
    """Speed against error of some solvers on one run.

    Attributes
    ----------
    model : str
        The model with its parameters.
    timings : list of Timing
    against : str
        What errors are measured against.
    resolution : float
        Errors below this are indistinguishable from 0, as two reference runs differ by it; 0 with
        exact values.
    versions, machine : dict
        Versions of the packages, and the machine.
    """

    model: str
    timings: list[Timing]
    against: str
    resolution: float
    versions: dict[str, str]
    machine: dict[str, Any]

    @property
    def front(self) -> list[Timing]:
        """The Pareto front: timings not beaten in both time and error, fastest first."""
        told = [(max(t.error, self.resolution), t.seconds, t) for t in self.timings]
        found: list[Timing] = []
        for error, _, timing in sorted(
            (row for row in told if isfinite(row[0]) and isfinite(row[1])), key=lambda row: row[1]
        ):
            if not found or error < max(found[-1].error, self.resolution):
                found.append(timing)
        return found

    @property
    def advice(self) -> str:
        """A sentence: which solver to use for which error."""
        if not isfinite(self.resolution):
            return (
                "The runs taken for exact differ in their jumps: no error is known; end it sooner."
            )
        front = self.front
        if not front:
            return "No solver has finished this run with the jumps of the reference."
        last = [a for a, b in pairwise(front) if a.solver != b.solver] + front[-1:]
        parts = [
            f"down to {self._error(timing)} take {timing.solver} "
            f"(rtol={timing.rtol:g}: {_time(timing.seconds)})"
            for timing in last
        ]
        return f"For errors {', '.join(parts)}."

    def _error(self, timing: Timing) -> str:
        known = max(timing.error, self.resolution)
        return f"{known:.0e}" if known else "0"

    def __str__(self) -> str:
        """A table, what errors are measured against, and the advice."""
        head = (
            f"{'':18}{'rtol':>8}{'error':>10}{'time':>10}{'quartiles':>20}{'first call':>12}"
            f"{'steps':>9}{'flow':>9}{'memory':>10}"
        )
        rows = [self._row(timing) for timing in self.timings]
        return "\n".join([self.model, head, *rows, f"Errors against {self.against}.", self.advice])

    def _row(self, timing: Timing) -> str:
        start = f"{timing.solver:18}{timing.rtol:>8.0e}"
        if timing.reason:
            return f"{start}  {timing.reason}"
        counts = (
            "-" if count is None else f"{count:,}" for count in (timing.steps, timing.evaluations)
        )
        steps, evaluations = counts
        first = _time(timing.first) if isfinite(timing.first) else ""
        return (
            f"{start}{timing.error:>10.1e}{_time(timing.seconds):>10}"
            f"{_time(timing.low) + ' - ' + _time(timing.high):>20}{first:>12}"
            f"{steps:>9}{evaluations:>9}{timing.memory / 1024:>7.0f} KiB"
        )

    def to_dict(self) -> dict[str, Any]:
        """All numbers by name, with versions and machine, in a JSON-compatible form."""
        fields = {
            "model": self.model,
            "against": self.against,
            "resolution": self.resolution,
            "advice": self.advice,
            "versions": self.versions,
            "machine": self.machine,
            "timings": [_plain(attrs.asdict(timing)) for timing in self.timings],
        }
        plain: dict[str, Any] = _plain(fields)
        return plain

    def save(self, path: Any) -> None:
        """Write :meth:`to_dict` as JSON."""
        with open(path, "w", encoding="utf-8") as file:
            json.dump(self.to_dict(), file, indent=1, allow_nan=False)

    def plot(self, path: Any = None) -> Any:
        """Plot time against error, one line per solver, with quartiles as bars.

        Parameters
        ----------
        path : str or path, optional
            Also write the figure to this file.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OptionError
            If matplotlib is missing.
        """
        need("bench.plot", PLOT)
        from ..plot.static import draw

        curves: list[Curve] = []
        for number, solver in enumerate(dict.fromkeys(t.solver for t in self.timings)):
            own = [t for t in self.timings if t.solver == solver and isfinite(t.error)]
            if own:
                curves += _drawn(own, number, self.resolution)
        panel = Panel(curves=curves, x="relative error", y="seconds", log="xy", reverse=True)
        return draw(Figure(name="bench", title=self.model, columns=column(panel)), path)


def bench(
    model: Any,
    start: Any,
    t: tuple[float, float],
    *,
    solvers: Sequence[str] = TIMED_SOLVERS,
    rtol: Sequence[float] = TIMED_TOLERANCES,
    oracle: Oracle | None = None,
    repeats: int = 7,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Bench:
    """Time several solvers at several tolerances on one run, and measure their errors.

    Parameters
    ----------
    model, start, t
        As in :func:`hybrid.simulate`.
    solvers : sequence of str
        ``"scipy:DOP853"``, ``"taylor"``: a solver, optionally with a method after a colon.
    rtol : sequence of float
        Relative tolerances; the absolute ones are a hundredth of each, unless ``atol`` is given.
    oracle : callable, optional
        Returns rows ``(name, computed, exact)`` for a run, as in a gallery file. The error is the
        largest difference in a row, relative to the exact value unless that is 0. Without an
        oracle, a run is compared with one of another method at rounding accuracy (Taylor series, or
        DOP853 for these). The error is then the largest difference of a state relative to the
        largest state, or of the time of a jump, limit or release relative to the length of the run.
    repeats : int
        Rounds of timings. Each round times every solver at every tolerance, so that other load on
        the machine affects all of them.
    progress : callable, optional
        Receives a line of text at each first call.
    options
        Passed to :func:`hybrid.simulate`.

    Returns
    -------
    Bench
        ``print(found)`` shows a table that ends with advice; ``found.plot(path)`` plots it,
        ``found.save(path)`` writes it as JSON.

    Raises
    ------
    OptionError
        If there is nothing to time.
    """
    solvers = [solvers] if isinstance(solvers, str) else solvers
    rtol = np.atleast_1d(reals(rtol)).tolist()
    require_count("repeats", repeats, 0)
    if not solvers or not rtol or repeats < 1:
        raise OptionError(
            f"bench: solvers={list(solvers)}, rtol={list(rtol)}, repeats={repeats}: "
            "at least one of each is needed"
        )
    runners = [_Runner(model, start, t, name, float(r), options) for name in solvers for r in rtol]
    judge = _Exact(oracle) if oracle else _Tighter(model, start, t, options)
    for before, runner in zip([None, *runners], runners, strict=False):
        if progress is not None:
            progress(f"{runner.solver} at rtol={runner.rtol:g}")
        runner.begin(judge, before is None or before.solver != runner.solver)
    for _ in range(repeats):
        for runner in runners:
            runner.time()
    timings = [runner.timing() for runner in runners]
    return Bench(str(model), timings, judge.name, judge.resolution, versions(), machine())


class _Judge(Protocol):
    """Measures the error of a run."""

    @property
    def name(self) -> str: ...
    @property
    def resolution(self) -> float: ...
    def error(self, run: Trajectory, solver: str) -> float: ...


class _Exact:
    """Compares with exact values."""

    name, resolution = "exact values", 0.0

    def __init__(self, oracle: Oracle) -> None:
        self.oracle = oracle

    def error(self, run: Trajectory, solver: str) -> float:
        try:
            rows = [
                (np.asarray(a, float), np.asarray(b, float)) for _, a, b, *_ in self.oracle(run)
            ]
        except IndexError:  # a jump or limit that the oracle uses is missing
            return inf
        except Exception as fault:  # any exception of the user's function, in one line
            raise OptionError(f"oracle: {type(fault).__name__}: {fault}") from fault
        if not rows:
            raise OptionError("oracle: it yields no rows (name, computed, exact)")
        return float(
            np.max([np.max(np.abs(a - b) / np.where(b == 0, 1.0, np.abs(b))) for a, b in rows])
        )


class _Tighter:
    """Compares with a run of another method at rounding accuracy."""

    def __init__(self, model: Any, start: Any, t: Any, options: Mapping[str, Any]) -> None:
        self.length = abs(t[1] - t[0])
        self.runs: dict[str, Trajectory] = {}
        fault: HybridError | None = None
        for name, choice in REFERENCES.items():
            try:
                self.runs[name] = whole(simulate(model, start, t, **{**options, **choice}))
            except HybridError as failed:
                fault = failed
        if not self.runs:
            assert fault is not None
            raise fault
        self.resolution = self._between(*self.runs.values()) if len(self.runs) > 1 else 0.0

    @property
    def name(self) -> str:
        runs = " and ".join(f"a run of {name} to rounding" for name in self.runs)
        apart = f", which differ by {self.resolution:.0e}" if len(self.runs) > 1 else ""
        return runs + apart

    def error(self, run: Trajectory, solver: str) -> float:
        others = [exact for name, exact in self.runs.items() if name != solver]
        return self._between((others or list(self.runs.values()))[0], run)

    def _between(self, exact: Trajectory, run: Trajectory) -> float:
        found = differences(exact, run)
        if found["edges"] or found["modes"]:
            return inf
        size = max(float(np.max(np.abs(arc.first))) for arc in exact.arcs) or 1.0
        times = [found[what] / self.length for what in ("times", "t_inf", "releases")]
        return float(np.max([found["states"] / size, *times]))


class _Runner:
    """Runs and times one solver at one tolerance."""

    def __init__(
        self, model: Any, start: Any, t: Any, solver: str, rtol: float, options: Mapping[str, Any]
    ) -> None:
        name, _, method = solver.partition(":")
        own = {"rtol": rtol, "atol": ABSOLUTE_SHARE * rtol, **options}
        self.arguments, self.solver, self.rtol = (model, start, t), solver, rtol
        self.options = {**own, "solver": name, "method": method or None}
        self.found: dict[str, Any] = {}
        self.samples: list[float] = []
        self.calls, self.reason = 1, ""

    def _run(self) -> Trajectory:
        return whole(simulate(*self.arguments, **self.options))

    def begin(self, judge: _Judge, first: bool) -> None:
        """Make the first call, measure error and memory, and choose the calls per timing."""
        begun = time.perf_counter()
        try:
            run = self._run()
        except OptionError:
            raise
        except HybridError as fault:
            self.reason = str(fault)
            return
        taken = time.perf_counter() - begun
        stats = run.stats
        self.found["error"] = judge.error(run, self.solver)
        self.found["first"] = taken if first else nan
        if stats is not None:
            self.found.update(steps=stats.steps, evaluations=stats.evaluations)
        del run
        self.found["memory"] = self._most()
        self.calls = max(1, round(LEAST_TIMING / self._seconds(1)))

    def _most(self) -> int:
        """Peak memory of a call in bytes."""
        tracemalloc.start()
        try:
            self._run()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def _seconds(self, calls: int) -> float:
        """Mean duration of some calls; garbage collection is off meanwhile."""
        return timeit(self._run, number=calls) / calls

    def time(self) -> None:
        """Take one more timing."""
        if not self.reason:
            self.samples.append(self._seconds(self.calls))

    def timing(self) -> Timing:
        """The collected results."""
        if self.reason:
            return Timing(solver=self.solver, rtol=self.rtol, reason=self.reason)
        low, middle, high = np.percentile(self.samples, (25, 50, 75)).tolist()
        return Timing(
            solver=self.solver, rtol=self.rtol, seconds=middle, low=low, high=high, **self.found
        )


def machine() -> dict[str, Any]:
    """The machine on which the numbers were measured."""
    return {
        "system": platform.system(),
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
    }


def _drawn(own: Sequence[Timing], number: int, resolution: float) -> list[Curve]:
    """A solver's line, and its bars."""
    x = [max(timing.error, resolution, np.finfo(float).eps) for timing in own]
    bars = [
        (e, v) for e, timing in zip(x, own, strict=True) for v in (timing.low, timing.high, nan)
    ]
    notes = [f"{t.solver} at rtol={t.rtol:g}: {_time(t.seconds)}" for t in own]
    look, bar = looks_of_method(number)
    return [
        Curve(x=x, y=[t.seconds for t in own], name=own[0].solver, look=look, notes=notes),
        Curve(x=[e for e, _ in bars], y=[v for _, v in bars], look=bar),
    ]


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """A row with non-finite floats replaced by None, for JSON."""
    return {
        key: None if isinstance(value, float) and not isfinite(value) else value
        for key, value in row.items()
    }


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
