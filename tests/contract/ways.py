"""Every way in: ``hy.simulate`` on each mechanism, ``hy.ensemble`` and ``hy.as_function``.

A test over the fixture ``way`` runs once for each way of its module's ``WAYS`` (``MECHANISMS`` if
it names none)::

    WAYS = ways.ALL

    def test_a_ball_bounces(way):
        result = way.run(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), rtol=1e-9)
        assert result.t_inf == pytest.approx(2.5586, abs=1e-4)
        if way.tells("edges"):
            assert result.edges[0] == "impact"

A result has the same fields whatever the way; one that the way cannot tell is None, and
``way.tells(name)`` says so beforehand. Compiling costs seconds for a new class, method or ``zeno``,
and nothing for other numbers (but for tolerances, of ``as_function``): take parameters in place of
new classes, and ``way.many`` for many cases of one class (one call of an ensemble).
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property, partial
from itertools import product
from typing import Any

import attrs
import jax
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton.record import Record
from hybrid.functions.function import REASONS
from hybrid.lowering.jit import jit

#: Options of ``hy.simulate`` that choose a solver; a new backend is one line here.
SOLVERS = {
    "DOP853": {"solver": "scipy", "method": "DOP853"},
    "RK45": {"solver": "scipy", "method": "RK45"},
    "RK23": {"solver": "scipy", "method": "RK23"},
    "Radau": {"solver": "scipy", "method": "Radau"},
    "BDF": {"solver": "scipy", "method": "BDF"},
    "LSODA": {"solver": "scipy", "method": "LSODA"},
    "taylor": {"solver": "taylor"},
    "Tsit5": {"solver": "diffrax", "method": "Tsit5"},
    "Dopri8": {"solver": "diffrax", "method": "Dopri8"},
    "Kvaerno5": {"solver": "diffrax", "method": "Kvaerno5"},
    "classic": {"solver": "classic"},
}

#: Names of ``hy.ensemble`` that are ``"refused"`` here: a start, or a state after a jump, that is
#: out of the mode's domain or does not say what follows.
REFUSED = ("outside", "undecided")

#: What ``hy.simulate`` raises where a lane is a row with its reason. Wrong options stay errors.
ERRORS = (hy.StartError, hy.DomainError, hy.FlowError, hy.JumpLoopError, hy.ZenoError)


@attrs.frozen
class Limit:
    """An accumulation as a function tells it, in the words of ``run.zeno``.

    ``t_error`` bounds the error of the sum only, not that of the integration before it.
    """

    t: float
    t_error: float
    ratio: float
    state: Any = None


@attrs.frozen(eq=False)
class LaneLimit:
    """An accumulation as a lane tells it; its bound and verdict are looked for when asked for."""

    t: float
    ratio: float
    certified: Callable[[], Any]

    t_error = property(lambda self: float(self.certified().t_inf_error))
    verdict = property(lambda self: str(self.certified().verdict.values))


@attrs.frozen(eq=False, kw_only=True, slots=False)
class Result:
    """What came out, the same from every way; None where the way cannot tell.

    Attributes
    ----------
    status : str
        One of the names of ``hy.ensemble``, or ``"refused"``, ``"zeno_raised"``.
    said : str
        The sentence that went with it.
    t : float
        Where it ended.
    final : record
        The state there, by attribute.
    mode : str
    jumps : int
        Listed by ``simulate``, computed one by one elsewhere: the same number only where nothing
        accumulates.
    accumulations : int
    zeno : list
        ``hy.simulate`` has all of them, the others the first.
    times, edges, before, after
        The table of jumps: arrays, a list of names, and records of columns. It is made when it is
        first asked for.
    run : Trajectory
        Of ``hy.simulate``, for what only it has.
    """

    status: str
    said: str = ""
    t: float | None = None
    final: Any = None
    mode: str | None = None
    jumps: int | None = None
    accumulations: int | None = None
    zeno: Sequence[Any] = ()
    run: Any = None
    table: Callable[[], Sequence[Any]] = lambda: (None,) * 4

    @cached_property
    def _columns(self) -> Sequence[Any]:
        return self.table()

    times = property(lambda self: self._columns[0])
    edges = property(lambda self: self._columns[1])
    before = property(lambda self: self._columns[2])
    after = property(lambda self: self._columns[3])

    @property
    def t_inf(self) -> float:
        """When jumps first accumulate; NaN if they do not."""
        return float(self.zeno[0].t) if self.zeno else math.nan

    @property
    def t_error(self) -> float:
        """The bound given with it."""
        return float(self.zeno[0].t_error) if self.zeno else math.nan


class Way(abc.ABC):
    """A way in.

    Attributes
    ----------
    name : str
    told : frozenset
        The fields of a result that it fills, and ``"bound"``: that ``t_error`` bounds the whole
        error; ``"all zeno"``: that every accumulation is listed; ``"limit"``: the state at one.
    """

    told: frozenset[str]

    def __init__(self, name: str, **options: Any) -> None:
        self.name, self.options = name, options

    def tells(self, *fields: str) -> bool:
        """Whether all these are among what it can tell."""
        return self.told.issuperset(fields)

    def run(self, model: Any, start: Any, t: tuple[float, float], **options: Any) -> Result:
        """One run; options as for ``hy.simulate``, the way's own defaults else."""
        return self.many(model, [start], t, **options)[0]

    @abc.abstractmethod
    def many(
        self,
        model: Any,
        starts: Sequence[Any],
        t: tuple[Any, Any],
        parameters: Mapping[str, Sequence[Any]] | None = None,
        **options: Any,
    ) -> list[Result]:
        """One run for each start, with its own parameters and, if arrays, its own times."""

    def __repr__(self) -> str:
        return self.name


def _cases(model: Any, starts: Sequence[Any], t: Any, parameters: Any) -> Any:
    """Model, start and times of each run."""
    given = parameters or {}
    firsts, lasts = (np.broadcast_to(np.asarray(end, float), len(starts)) for end in t)
    for i, start in enumerate(starts):
        own = attrs.evolve(model, **{name: values[i] for name, values in given.items()})
        yield own, start, (float(firsts[i]), float(lasts[i]))


#: What every way tells, and what a table of jumps does.
COMMON = frozenset({"status", "t", "final", "jumps", "zeno"})
TABLE = frozenset({"times", "edges", "before", "after"})


def _named(status: str) -> str:
    return "refused" if status in REFUSED else status


class Simulate(Way):
    """``hy.simulate`` with a solver."""

    told = COMMON | TABLE | {"mode", "accumulations", "run", "verdict", "bound", "limit"}
    told |= {"all zeno"}

    def many(self, model, starts, t, parameters=None, **options):
        return [self._one(*case, **options) for case in _cases(model, starts, t, parameters)]

    def _one(self, model: Any, start: Any, t: Any, **options: Any) -> Result:
        try:
            run = hy.simulate(model, start, t, **{**self.options, **options})
        except ERRORS as error:
            return Result(status=_named(error.status), said=str(error))
        return Result(
            status=run.status.name.lower(),
            said=str(run.status),
            t=run.t1,
            final=run.final,
            mode=run.mode,
            jumps=len(run.jumps),
            accumulations=len(run.zeno),
            zeno=run.zeno,
            run=run,
            table=lambda: (
                run.jumps.t,
                run.jumps.edge.tolist(),
                run.jumps.before,
                run.jumps.after,
            ),
        )


class Ensemble(Way):
    """``hy.ensemble``: each run is a lane.

    The table of jumps is found by ensembles that end after 1, 2, 3, ... jumps, and cannot tell the
    states before them nor the edges.
    """

    told = COMMON | {"mode", "accumulations", "verdict", "bound", "times", "after"}

    def many(self, model, starts, t, parameters=None, **options):
        rows = zip(*(model.spec.values(start) for start in starts), strict=True)
        columns = dict(zip(model.spec.names, map(_floats, rows), strict=True))
        given = {name: _floats(values) for name, values in (parameters or {}).items()}
        ends = [np.broadcast_to(_floats(end), len(starts)) for end in t]

        def of(which: slice, **more: Any) -> Any:
            own = [{name: v[which] for name, v in each.items()} for each in (columns, given)]
            until = tuple(end[which] for end in ends)
            return hy.ensemble(model, own[0], until, own[1], **{**self.options, **options, **more})

        lanes = of(slice(None))
        return [
            self._lane(model, lanes.isel(lane=i), partial(of, slice(i, i + 1)))
            for i in range(len(starts))
        ]

    def _lane(self, model: Any, lane: Any, again: Any) -> Result:
        """``again`` flies the lane alone, with further options."""
        certified = cache(lambda: again(certify=True).isel(lane=0))
        limit = LaneLimit(float(lane["t_inf"]), float(lane["ratio"]), certified)
        return Result(
            status=_named(str(lane.status.values)),
            said=str(lane.reason.values),
            t=float(lane["t"]),
            final=_record(model, {name: lane[name].values for name in model.spec.names}),
            mode=str(lane["mode"].values),
            jumps=int(lane.jumps),
            accumulations=int(lane.accumulations),
            zeno=[] if np.isnan(limit.t) else [limit],
            table=lambda: self._table(model, again, int(lane.jumps)),
        )

    def _table(self, model: Any, again: Any, jumps: int) -> Sequence[Any]:
        ends = [again(max_jumps=1 + n).isel(lane=0) for n in range(jumps)]
        states = {name: np.array([end[name].values for end in ends]) for name in model.spec.names}
        return np.array([float(end["t"]) for end in ends]), None, None, _record(model, states)


def _floats(values: Any) -> np.ndarray:
    return np.array(values, float)


class AsFunction(Way):
    """``hy.as_function``."""

    told = COMMON | TABLE | {"limit"}

    def many(self, model, starts, t, parameters=None, **options):
        given = {"max_jumps": 256, **self.options, **options}
        with jax.enable_x64(True):
            function, edges = self._function(model, given)
            cases = list(_cases(model, starts, t, parameters))
            found = [function(own.parameters, own.spec.values(x), ends) for own, x, ends in cases]
            return [self._outcome(model, out, edges) for out in found]

    def _function(self, model: Any, options: dict[str, Any]) -> tuple[Any, Any]:
        """One for all numbers of a class, compiled once, and the names of its edges."""
        shapes = tuple(value.shape for value in model.parameters)
        key = type(model), shapes, str(options)
        if "history" in options or key not in self._functions:
            self._functions[key] = self._compiled(model, options)
        return self._functions[key]

    def _compiled(self, model: Any, options: dict[str, Any]) -> tuple[Any, Any]:
        names = [parameter.name for parameter in model.spec.parameters]

        @jit  # with settings of XLA that halve the time it takes
        def function(parameters: Any, start: Any, t: Any) -> Any:
            own = attrs.evolve(model, **dict(zip(names, parameters, strict=True)))
            return hy.as_function(model, t=t, **options)(own, start)

        return function, hy.as_function(model, t=(0.0, 1.0), **options).edges

    @cached_property
    def _functions(self) -> dict[Any, Any]:
        return {}

    def _outcome(self, model: Any, out: Any, edges: Any) -> Result:
        status, said = REASONS[int(out.status)]
        count = int(out.jumps.count)
        zeno = []
        if not np.isnan(out.zeno.t):
            numbers = (float(v) for v in (out.zeno.t, out.zeno.error, out.zeno.ratio))
            zeno.append(Limit(*numbers, state=_record(model, out.zeno.state)))
        return Result(
            status=_named(status),
            said=said,
            t=float(out.t),
            final=_record(model, out.final),
            jumps=count,
            zeno=zeno,
            table=lambda: (
                np.asarray(out.jumps.t)[:count],
                [edges[i] for i in np.asarray(out.jumps.edge)[:count]],
                _record(model, out.jumps.before, count),
                _record(model, out.jumps.after, count),
            ),
        )


def _record(model: Any, values: Mapping[str, Any], count: int | None = None) -> Record:
    """Numbers, or the first rows of columns, by state."""
    rows = ... if count is None else slice(count)
    names = model.spec.names
    return Record(names, tuple(np.asarray(values[name])[rows] for name in names))


#: All ways, by name.
WAYS: dict[str, Way] = {
    **{name: Simulate(name, **given) for name, given in SOLVERS.items()},
    "ensemble": Ensemble("ensemble"),
    "as_function": AsFunction("as_function"),
}

ALL = list(WAYS)

#: One method of each mechanism: explicit, implicit and multistep steps, Taylor series, steps made
#: some ahead, lanes, pure functions. The other methods reach the run by the same code, and differ
#: by their order, their interpolants and the times at which they ask for a flow: what depends on
#: those is marked ``each_method``, and all else on them ``every_way``.
MECHANISMS = ["DOP853", "Radau", "LSODA", "taylor", "Dopri8", "ensemble", "as_function"]


def later(*cases: Any) -> list[Any]:
    """Ways, or points of a scan, that are left to ``-m every_way``."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.every_way)
        for case in cases
    ]


def spread(*scans: Sequence[Any], of: int = 3) -> list[Any]:
    """Every combination of points of scans: one in three now, the others left to ``every_way``.

    Each point of a scan is met now, beside a third of those of another that has three or more; or
    one in ``of``, likewise.
    """
    chosen = []
    for places in product(*(range(len(scan)) for scan in scans)):
        point = tuple(scan[i] for scan, i in zip(scans, places, strict=True))
        chosen += later(point) if sum(places) % of else [point]
    return chosen


#: Those of them that reach rounding.
ACCURATE = ["DOP853", "taylor", "Dopri8", "ensemble", "as_function"]

#: The way that has numbers for what is words elsewhere.
COMPILED = ["as_function"]

#: Every solver, lanes, and this.
SOLVERS_AND_COMPILED = [*SOLVERS, "ensemble", *COMPILED]
