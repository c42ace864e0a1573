"""``hy.ensemble``: many runs of one model, over arrays of starts and parameters."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..automaton.base import require_model
from ..automaton.digest import digest
from ..automaton.markers import RISING, Crossing
from ..automaton.outputs import evaluated
from ..automaton.reals import short
from ..automaton.spec import Spec
from ..errors import TABLES, HybridError, OptionError, need
from ..lowering import Scene, scene_of
from ..rules.lanes import ENDED, LAST_JUMP, MADE_JUMPS, MADE_STEPS, MODE, OUTCOME, STATE, SUMMED
from ..run import Driver
from ..run.comparison import give_errors
from ..run.options import Asked, mode_of
from ..solvers import renamed
from ..trajectory.trajectory import Status
from .measures import MeasuredLane, Measures
from .processes import Shared, Unfit
from .starts import Lane, Lanes, attributes_of
from .threads import LANE_JUMPS, FlownLanes, GivenLanes, abreast

if TYPE_CHECKING:
    import xarray

    from ..automaton.shapes import StateVector

#: Meanings of the statuses of lanes that have failed; the lane's ``reason`` says where and why.
FAILED = {
    "outside": "the start, or a reset, is outside the mode's domain",
    "undecided": "nothing decides what follows from where the lane starts, or a jump has led",
    "not_finite": "a flow, guard or reset is not finite, or the solver gave up",
    "jump_loop": "jumps follow each other with no time between them",
    "forgotten": "a lag is negative, or looks where the history is not finite",
    "zeno_raised": "jumps accumulate, which zeno='raise' takes for an error",
    "refused": "an option cannot be used in this lane",
    "failed": "something else went wrong",
}

#: Time, error, ratio and verdict of the first accumulation, for a lane without accumulations.
NO_LIMIT = np.nan, np.nan, np.nan, ""

#: The status of a lane that compiled code has flown, by the outcome that the rule returns.
ENDS = {ENDED: Status.REACHED_END, LAST_JUMP: Status.MAX_JUMPS}

#: Meanings of all statuses of lanes.
STATUSES = {each.name.lower(): str(each) for each in Status} | FAILED


def ensemble(
    model: Any,
    start: Any,
    t: tuple[Any, Any],
    parameters: Mapping[str, Any] | None = None,
    *,
    solver: str | None = None,
    method: Any = None,
    controller: Any = None,
    rtol: float | None = None,
    atol: Any = None,
    max_step: float | None = None,
    first_step: float | None = None,
    zeno: str = "rest",
    max_jumps: int | None = None,
    max_steps: int = 1_000_000,
    mode: str | None = None,
    history: Any = None,
    memory: str = "keep",
    certify: bool = False,
    segments: int = 256,
    measure: Any = (),
    section: Any = None,
    crossing: Crossing = RISING,
    skip: int | None = 0,
    every: int = 1,
    keep: int = 32,
    save: Any = None,
    progress: Callable[[int], None] | None = None,
    seed: int = 0,
) -> xarray.Dataset:
    """Simulate one model for arrays of starts and parameters.

    Each element of the arrays is a *lane*: a run of :func:`hybrid.simulate`.

    Parameters
    ----------
    model : Automaton
        Its parameters are used where ``parameters`` gives no values.
    start : dict
        For each state one value for all lanes, or an array with the lanes as first axis.
    t : (t0, t1)
        First and last time; each a number or an array over the lanes.
    parameters : dict, optional
        Values by name, as in ``start``; for a signal its data, or a list of data, one for each
        lane.
    solver, method, controller, rtol, atol, max_step, first_step
        As for :func:`hybrid.simulate`, the same for all lanes. By default the solver is
        ``"taylor"``; with delays, and if a function of the model has no series, the default of
        :func:`hybrid.simulate`.
    zeno : "rest", "stop", "truncate", "raise" or "ignore"
        As for :func:`hybrid.simulate`. With ``"raise"`` a lane that accumulates fails, with the
        status ``"zeno_raised"``; with ``"ignore"`` it continues up to ``max_jumps``.
    max_jumps, max_steps : int
        A lane ends after this many computed jumps, or steps. The number of steps is checked at the
        end of each arc, and several times in a long arc.
    mode : str, optional
        Mode at the start, the same for all lanes; the model's initial mode if omitted.
    history : optional
        For delays, as for :func:`hybrid.simulate`; the values of a dict may be arrays over the
        lanes.
    memory : "keep" or "restart"
        As for :func:`hybrid.simulate`.
    certify : bool
        Whether to compute the verdict on the first accumulation of each lane, and the bound on its
        time, as for a run: by proofs and further runs, at some ten milliseconds for each lane.
    segments : int
        Has no effect: the whole past of a lane is kept.
    measure : sequence of str and callable
        Further columns. The name of an output: its value at the end of each lane and wherever
        states are kept. ``"stick"``: the fraction of time at rest on contacts or sliding.
        ``"period"``: the number of section points after which they repeat, to 1e-6 of their size; 0
        if they do not. ``"lyapunov"``: the largest Lyapunov exponent over the last nine tenths of
        the time, ``-inf`` if perturbations vanish in finite time, NaN if there is no first
        variation. A function of the Dataset of all lanes, which returns an array over the lanes;
        the column has the name of the function.
    section, crossing
        Keep the states of each lane on a section, as for :func:`hybrid.return_map`: the name of a
        jump, a surface ``(self, t, s)``, a period, or a function ``(self)`` that returns it.
    skip, every, keep : int
        Of the points on the section, skip the first ``skip`` (a transient), then keep one in every
        ``every``, and at most ``keep`` of them. With ``skip=None`` the last points are kept, and
        with them the mode after each, the size of each state, and how far the lane still moves.
    save : array, optional
        Times at which the states of each lane are kept.
    progress : callable ``(lanes)``, optional
        Called now and then with the number of lanes that have ended.
    seed : int
        Seed of the random numbers that resets and restitutions draw (``docs/chance.md``), from 0
        to 2^26 - 1; each lane has its own sequence.

    Returns
    -------
    xarray.Dataset
        Over ``lane``: time ``t``, ``mode`` and each state at the end; the numbers of ``jumps``
        computed one by one, ``steps`` and ``accumulations``; of the first accumulation ``t_inf``,
        ``ratio``, ``t_inf_error`` (a bound on the error of the sum, without the integration before
        it; with ``certify=True`` on both) and ``verdict`` (``"estimated"`` unless ``certify=True``;
        empty if nothing accumulates); ``status``, and ``reason``, a sentence. A lane that fails is
        a row with its reason, and the time and state after its last jump. With ``section``, over
        ``lane`` and ``hit``: times ``t_section`` and each state, ``x_section``, NaN where a lane
        has fewer; ``hits`` is the number of points met. With ``skip=None`` also ``mode_section``, a
        number for the mode of an arc; ``x_size`` and ``x_range``, bounds on the size of a state and
        on its span in the second half of the time; ``moves``, the largest change of a state over
        the last eighth of the time, relative to its size. With ``save``, over ``lane`` and
        ``time``: each state, ``x_saved``, NaN at times outside the lane. States, outputs and varied
        parameters have their units as attributes.

    Raises
    ------
    OptionError, StartError, ParameterError
        If the arguments cannot be used by any lane.

    Notes
    -----
    With the same options a lane equals its run to the last bit, whatever else is in the ensemble;
    with an explicit Runge-Kutta pair of SciPy or Diffrax, up to rounding.
    """
    need("hy.ensemble", TABLES)
    require_model(model)
    points = crossing, skip, every, keep
    measures = Measures.of(model.spec, measure, _Row._fields, save, section, points)
    if measures.anything and certify:
        raise OptionError(
            f"{model.spec.model}: certify=True flies lanes again, which keeps all of them: ask for "
            "section, save, stick and lyapunov in a call of their own"
        )
    scene = scene_of(model)
    solver, method = renamed(solver_for(scene, solver, method), method)
    options = {
        "solver": solver,
        "method": method,
        "controller": controller,
        "rtol": rtol,
        "atol": atol,
        "max_step": max_step,
        "first_step": first_step,
        "zeno": zeno,
        "max_jumps": max_jumps,
        "max_steps": max_steps,
        "memory": memory,
    }
    _require_options(model.spec, parameters, certify, progress)
    given = start, t, dict(parameters or {}), history, seed
    begins = mode_of(scene, mode)
    runs = _Runs(Lanes(model, *given), _asked(scene, options), begins, certify, measures)
    _require_names(runs.lanes, measures)
    if section is not None:  # raise the errors of an invalid section here, not in each lane
        measures.section_of(runs.lanes.lane(0), runs.lanes)

    def job() -> tuple[Any, ...]:
        own = model, given, options, begins, certify, measures.alone
        return _flier, digest(type(model)), *own

    runs.fly(scene, job, progress)
    return _dataset(scene.spec, runs.lanes, runs.rows, measures)


def _require_options(spec: Spec, parameters: Any, certify: Any, progress: Any) -> None:
    """Raise an :class:`OptionError` for options that no lane could use."""
    if not isinstance(parameters, Mapping | None):
        raise OptionError(
            f"{spec.model}: parameters={short(parameters)}: values by name, {{name: values}}"
        )
    if not isinstance(certify, bool):
        raise OptionError(f"{spec.model}: certify={certify!r}: True or False")
    if progress is not None and not callable(progress):
        raise OptionError(f"{spec.model}: progress={progress!r}: a function of a number, or None")


def _require_names(lanes: Lanes, measures: Measures) -> None:
    """Raise an :class:`OptionError` if a state or a varied parameter has the name of a column."""
    columns = {"lane", *_Row._fields} - {"x", "measured"}
    columns |= set(measures.coordinates())
    columns |= {"hits", "t_section"} if measures.section is not None else set()
    for name in (*lanes.spec.names, *lanes.varied):
        if name in columns - {"t0", "t1"}:
            raise OptionError(
                f"{lanes.spec.model}: {name!r} is a state or a parameter of it, and a column of "
                "the table of lanes; give it another name in the model"
            )


def _asked(scene: Scene, options: dict[str, Any]) -> Asked:
    return Asked(spec=scene.spec, save="jumps", **options)


def _flier(
    known: str,
    model: Any,
    given: Any,
    options: dict[str, Any],
    mode: str,
    certify: bool,
    measures: Measures,
) -> Callable[[int], _Ended]:
    """The function of a lane's number that flies the lane in another process.

    Raises :class:`Unfit` if the model's digest there differs from ``known``.
    """
    if digest(type(model)) != known:
        raise Unfit(f"{type(model).__name__} is another class there: its file has changed")
    lanes = Lanes(model, *given)
    measures = attrs.evolve(measures, spec=model.spec)
    runs = _Runs(lanes, _asked(scene_of(model), options), mode, certify, measures)
    return lambda i: runs.row(lanes.lane(i))


def solver_for(scene: Scene, solver: str | None, method: Any) -> str:
    """The solver of an ensemble: the one given, else ``"taylor"`` if all flows have power series
    and there are no delays, else ``"scipy"``."""
    if solver is not None:
        return solver
    series = method is None and not scene.spec.lags
    whole = series and all(scene.field(name).jets is not None for name in scene.modes)
    return "taylor" if whole else "scipy"


class _Row(NamedTuple):
    """The result of a lane: a row of the table of lanes."""

    t: float
    x: StateVector
    mode: str
    jumps: int
    steps: int
    accumulations: int
    t_inf: float
    t_inf_error: float
    ratio: float
    verdict: str
    status: str
    reason: str
    measured: Any


class _Rows:
    """The table of lanes, as columns; ``done`` marks the lanes that have ended."""

    def __init__(self, count: int, dimension: int, measured: int) -> None:
        self.done = np.zeros(count, dtype=bool)
        wide = {"x": (dimension,), "measured": (measured,)}
        whole, text = ("jumps", "steps", "accumulations"), ("mode", "verdict", "status", "reason")
        kinds = dict.fromkeys(whole, int) | dict.fromkeys(text, object)
        self.columns = {
            name: np.empty((count, *wide.get(name, ())), kinds.get(name, float))
            for name in _Row._fields
        }

    def put(self, where: Any, row: _Row) -> None:
        """Write the row of lane ``where``, or, for an array of lanes, a row of columns."""
        self.done[where] = True
        for name, value in zip(_Row._fields, row, strict=True):
            self.columns[name][where] = value


class _Ended(NamedTuple):
    """The result of a lane; ``refused`` is the error of an option that it cannot use."""

    row: _Row
    refused: OptionError | None


def _same(one: _Ended, other: _Ended) -> bool:
    """Whether two results of a lane agree to the last bit."""
    rows = [[np.asarray(value).tolist() for value in each.row] for each in (one, other)]
    return repr(rows[0]) == repr(rows[1])


@attrs.frozen(eq=False)
class _Runs:
    """The runs of an ensemble, and their results in ``rows``; ``refused`` lists the errors of lanes
    that cannot use an option."""

    lanes: Lanes
    asked: Asked
    mode: str
    certify: bool
    measures: Measures
    refused: list[OptionError] = attrs.Factory(list)
    rows: _Rows = attrs.field(init=False)

    @rows.default
    def _(self) -> _Rows:
        return _Rows(self.lanes.count, self.asked.spec.dimension, self.measures.size)

    def fly(self, scene: Scene, job: Callable[[], tuple[Any, ...]], progress: Any) -> None:
        """Fly all lanes, reporting progress; raises an :class:`OptionError` if no lane can use the
        options. ``job`` is that of :class:`.Shared`."""
        with closing(self.all(scene, job)) as flown:
            for _ in flown:
                if progress is not None:
                    progress(int(np.count_nonzero(self.rows.done)))
        if len(self.refused) == self.lanes.count:
            raise self.refused[0]

    def all(self, scene: Scene, job: Callable[[], tuple[Any, ...]]) -> Generator[None]:
        """Fly all lanes; yields whenever some have ended."""
        yield from self.plain(scene)
        yield from self.others(job)

    def plain(self, scene: Scene) -> Iterator[None]:
        """Fly the lanes that compiled code can fly alone, some at a time; with measures, only if
        these follow from the jumps."""
        lanes, rows = self.lanes, 0
        if self.measures.anything:
            if not self.measures.jumps_only:
                return
            rows = LANE_JUMPS
        try:
            driver = self.asked.driver(scene, lanes.t[0].tolist(), lanes.x[0], lanes.before(0))
        except HybridError:  # raised again for each lane that it concerns
            return
        given = GivenLanes(lanes.values, lanes.t, lanes.x)
        together = abreast(scene, driver, self.mode, given, rows)
        for flown in together.fly() if together else ():
            self._put(together, flown)
            yield

    def _put(self, together: Any, flown: FlownLanes) -> None:
        """Write the rows of lanes that compiled code has flown, except those with an accumulation
        to be certified, for which a run is needed."""
        for outcome, status in ENDS.items():
            fit = flown.told[:, OUTCOME] == outcome
            if self.certify:
                fit &= flown.told[:, SUMMED] == 0
            those = flown.those(fit)
            which, ends, told = those[:3]
            t, _, t_inf, error, ratio = ends[:, :STATE].T
            x, modes = together.final(those), told[:, MODE]
            names = np.array([together.mode(number) for number in modes], dtype=object)
            verdict = np.where(told[:, SUMMED] > 0, "estimated", "")
            counts = told[:, MADE_JUMPS], told[:, MADE_STEPS], told[:, SUMMED]
            said = verdict, status.name.lower(), str(status), self._measured(together, those)
            self.rows.put(which, _Row._make((t, x, names, *counts, t_inf, error, ratio, *said)))

    def _measured(self, together: Any, flown: FlownLanes) -> Any:
        """The measures of lanes, from their jumps; NaN without measures."""
        if not self.measures.anything:
            return np.nan
        edges = [guard.edge == self.measures.section for guard in together.tables.guards]
        fired = np.array([*edges, False])[flown.fired]  # -1 where there are no more
        return self.measures.of_jumps(fired, flown.when, flown.around[:, :, 1])

    def others(self, job: Callable[[], tuple[Any, ...]]) -> Iterator[None]:
        """Fly the lanes that are left, one by one, in this process and in others."""
        left = np.flatnonzero(~self.rows.done).tolist()
        shared = Shared(lambda i: self.row(self.lanes.lane(i)), left, job, _same)
        with closing(shared.answers()) as answers:
            for i, flown in answers:
                self.rows.put(i, flown.row)
                if flown.refused is not None:
                    self.refused.append(flown.refused)
                yield

    def row(self, lane: Lane) -> _Ended:
        """Fly a lane, with its measures."""
        if not self.measures.anything:
            return self._flown(lane, None)
        section = self.measures.section_of(lane, self.lanes)
        watched = MeasuredLane(self.measures, lane, section, self.asked.allowed[0])
        row, refused = self._flown(lane, watched)
        return _Ended(row._replace(measured=watched.end()), refused)

    def _flown(self, lane: Lane, watched: MeasuredLane | None) -> _Ended:
        """Fly a lane; ``watched`` takes the place of the log that would keep its trajectory."""
        driver, asked = None, self.asked
        try:
            if watched is not None and watched.dense:
                asked = attrs.evolve(asked, save="dense")
            driver = asked.driver(lane.scene, lane.t, lane.x, lane.history)
            driver.record.log = watched or driver.record.log
            self._fly(driver, lane.x)
        except HybridError as fault:
            refused = fault if isinstance(fault, OptionError) else None
            return _Ended(self._ended(lane, driver, fault.status, str(fault)), refused)
        if driver.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        assert driver.status is not None
        status = driver.status.name.lower(), str(driver.status)
        return _Ended(self._ended(lane, driver, *status), None)

    def _fly(self, driver: Driver, x: StateVector) -> None:
        try:
            driver.run(self.mode, x)
        finally:  # accumulations before a fault are reported as well
            give_errors(driver, self.asked.solver, self.asked.method, self.mode, x)
        self.asked.judge(driver)

    def _ended(self, lane: Lane, driver: Driver | None, status: str, reason: str) -> _Row:
        begun = lane.t[0], lane.x, self.mode
        if driver is None:
            return _Row._make((*begun, 0, 0, 0, *NO_LIMIT, status, reason, np.nan))
        end, limit = driver.end or begun, self._limit(driver)
        counts = driver.record.made, driver.steps, len(driver.record.zeno)
        return _Row._make((*end, *counts, *limit, status, reason, np.nan))

    def _limit(self, driver: Driver) -> tuple[float, float, float, str]:
        """Time, error, ratio and verdict of the first accumulation."""
        if not driver.record.zeno:
            return NO_LIMIT
        point, tail = driver.record.zeno[0], driver.record.tails[0]
        if not self.certify:
            return point.t, np.nan if tail is None else tail.t_error, point.ratio, point._verdict
        return point.t, point.t_error, point.ratio, point.verdict


def _dataset(spec: Spec, lanes: Lanes, rows: _Rows, measures: Measures) -> xarray.Dataset:
    import xarray

    columns = dict(rows.columns)
    numbers, x = columns.pop("measured"), columns.pop("x")
    made: dict[str, Any] = {
        name: ("lane", v.astype(str) if v.dtype == object else v) for name, v in columns.items()
    }
    record = spec.record(x)
    for state in spec.states:
        dims = "lane", *(f"{state.name}_{i}" for i in range(len(state.shape)))
        made[state.name] = dims, record[state.name], attributes_of(state)
    for output in (spec.output(name) for name in measures.outputs):
        v = evaluated(spec, output.name, [*lanes.parameters, *lanes.samples], columns["t"], x, True)
        dims = "lane", *(f"{output.name}_{i}" for i in range(v.ndim - 1))
        made[output.name] = dims, v, attributes_of(output)
    table = xarray.Dataset(
        made | measures.columns(lanes, numbers),
        coords=lanes.coordinates() | measures.coordinates(),
        attrs={"model": spec.model, **{f"status_{n}": said for n, said in STATUSES.items()}},
    )
    return table.assign({each.__name__: ("lane", _of(table, each)) for each in measures.functions})


def _of(table: xarray.Dataset, function: Callable[..., Any]) -> np.ndarray:
    """The column that a function computes from the table.

    Raises
    ------
    OptionError
        If it does not return one value for each lane.
    """
    column, lanes = np.asarray(function(table)), table.sizes["lane"]
    if column.shape != (lanes,):
        raise OptionError(
            f"{table.attrs['model']}: measure {function.__name__}: it gives an array of shape "
            f"{column.shape}, and {(lanes,)} is due, a value for each lane"
        )
    return column
