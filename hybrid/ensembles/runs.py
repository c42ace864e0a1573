"""``hy.ensemble``: many runs of one model, over arrays of starts and parameters."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..automaton.base import require_model
from ..automaton.digest import digest
from ..automaton.outputs import evaluated, require_outputs
from ..automaton.spec import Spec
from ..errors import TABLES, HybridError, OptionError, need
from ..lowering import Scene, scene_of
from ..rules.lanes import ENDED, LAST_JUMP, MADE_JUMPS, MADE_STEPS, MODE, OUTCOME, STATE, SUMMED
from ..run import Driver
from ..run.comparison import give_errors
from ..run.options import Asked, mode_of
from ..solvers import renamed
from ..trajectory.trajectory import Status
from .processes import Shared, Unfit
from .starts import Lane, Lanes
from .threads import FlownLanes, GivenLanes, abreast

if TYPE_CHECKING:
    import xarray

    from ..automaton.shapes import StateVector

#: What the status of a lane that has failed means; its ``reason`` says where and why.
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

#: Of a lane in which nothing accumulates: time, error, ratio, verdict.
NO_LIMIT = np.nan, np.nan, np.nan, ""

#: How lanes end that are flown by machine code alone.
ENDS = {ENDED: Status.REACHED_END, LAST_JUMP: Status.MAX_JUMPS}

#: What each status of a lane means.
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
    measure: Sequence[str] = (),
    progress: Callable[[int], None] | None = None,
) -> xarray.Dataset:
    """Simulate many lanes of one model: each is a run of :func:`hybrid.simulate`.

    Parameters
    ----------
    model : Automaton
        Its parameters' values hold where ``parameters`` gives none.
    start : dict
        Each state's value: one for all lanes, or an array with the lanes as first axis.
    t : (t0, t1)
        First and last time; each a number or an array over the lanes.
    parameters : dict, optional
        Values by name, as ``start``.
    solver, method, controller, rtol, atol, max_step, first_step
        As for :func:`hybrid.simulate`, the same for all lanes. If no solver and no method is named
        it is ``"taylor"``; with delays, and where a function of the model has no series, that of
        :func:`hybrid.simulate`.
    zeno : "rest", "stop", "truncate", "raise" or "ignore"
        As for :func:`hybrid.simulate`; with ``"ignore"`` a lane that accumulates goes on to
        ``max_jumps``.
    max_jumps, max_steps : int
        A lane ends after so many computed jumps, or steps. Steps are counted where an arc ends, and
        in a long one now and then.
    mode : str, optional
        Mode at the start, the same for all lanes; the model's initial mode if omitted.
    history : optional
        For delays, as for :func:`hybrid.simulate`; the values of a dict may be arrays over the
        lanes.
    memory : "keep" or "restart"
        As for :func:`hybrid.simulate`.
    certify : bool
        Whether the verdict on each lane's first accumulation, and the bound on its time, are those
        of its run, which take proofs and further runs: some ten milliseconds a lane.
    segments : int
        Without effect: a lane remembers all that its delays see.
    measure : sequence of str
        Outputs of the model to work out at the end of each lane, a column each.
    progress : callable ``(lanes)``, optional
        Called with the number of lanes that have ended.

    Returns
    -------
    xarray.Dataset
        Over ``lane``: the time ``t`` and each state at the end, ``mode``, ``jumps`` computed one by
        one, ``steps``, ``accumulations``, the first one's ``t_inf``, ``ratio`` and ``t_inf_error``
        (a bound on the error of the sum, not of the integration before it; with ``certify=True`` on
        both), its ``verdict`` (``"estimated"`` unless ``certify=True``, as nothing is proved then;
        empty where there is none), ``status``, and its ``reason``, a sentence. A lane that fails is
        a row with its reason, and the time and state that its last jump led to. With
        ``"max_jumps"`` the state is that after the last jump.

    Raises
    ------
    OptionError, StartError, ParameterError
        If what is given cannot be used by any lane.

    Notes
    -----
    With the same options a lane equals its run to the last bit, whatever else is in the ensemble;
    with an explicit Runge-Kutta pair of SciPy or Diffrax but for rounding.
    """
    need("hy.ensemble", TABLES)
    require_model(model)
    require_outputs(model.spec, measure, _Row._fields)
    scene = scene_of(model)
    solver, method = renamed(_solver(scene, solver, method), method)
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
    given = start, t, dict(parameters or {}), history
    runs = _Runs(Lanes(model, *given), _asked(scene, options), mode_of(scene, mode), certify)

    def job() -> tuple[Any, ...]:
        return _flier, digest(type(model)), model, given, options, runs.mode, certify

    with closing(runs.all(scene, job)) as flown:
        for _ in flown:
            if progress is not None:
                progress(int(np.count_nonzero(runs.rows.done)))
    if len(runs.refused) == runs.lanes.count:
        raise runs.refused[0]
    return _dataset(scene.spec, runs.lanes, runs.rows, measure)


def _asked(scene: Scene, options: dict[str, Any]) -> Asked:
    return Asked(spec=scene.spec, save="jumps", **options)


def _flier(
    known: str, model: Any, given: Any, options: dict[str, Any], mode: str, certify: bool
) -> Callable[[int], _Ended]:
    """What flies a lane, by its number, in another process; ``known`` is the model's digest."""
    if digest(type(model)) != known:
        raise Unfit(f"{type(model).__name__} is another class there: its file has changed")
    lanes = Lanes(model, *given)
    runs = _Runs(lanes, _asked(scene_of(model), options), mode, certify)
    return lambda i: runs.row(lanes.lane(i))


def _solver(scene: Scene, solver: str | None, method: Any) -> str:
    """The solver named; else Taylor series, where the model has them."""
    if solver is not None:
        return solver
    series = method is None and not scene.spec.lags
    whole = series and all(scene.field(name).jets is not None for name in scene.modes)
    return "taylor" if whole else "scipy"


class _Row(NamedTuple):
    """What is kept of a lane that has ended."""

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


class _Rows:
    """The rows of all lanes, as columns; ``done`` says which are there."""

    def __init__(self, count: int, dimension: int) -> None:
        self.done = np.zeros(count, dtype=bool)
        whole, text = ("jumps", "steps", "accumulations"), ("mode", "verdict", "status", "reason")
        kinds = dict.fromkeys(whole, int) | dict.fromkeys(text, object)
        self.columns = {
            name: np.empty((count, dimension) if name == "x" else count, kinds.get(name, float))
            for name in _Row._fields
        }

    def put(self, where: Any, row: _Row) -> None:
        """Put a row, or columns of some."""
        self.done[where] = True
        for name, value in zip(_Row._fields, row, strict=True):
            self.columns[name][where] = value


class _Ended(NamedTuple):
    """What became of a lane; ``refused`` says why it cannot use the options."""

    row: _Row
    refused: OptionError | None


def _same(one: _Ended, other: _Ended) -> bool:
    """Whether a lane is the same to the last bit."""
    rows = [[np.asarray(value).tolist() for value in each.row] for each in (one, other)]
    return repr(rows[0]) == repr(rows[1])


@attrs.frozen(eq=False)
class _Runs:
    """The runs of an ensemble; ``refused`` says why some cannot use the options."""

    lanes: Lanes
    asked: Asked
    mode: str
    certify: bool
    refused: list[OptionError] = attrs.Factory(list)
    rows: _Rows = attrs.field(init=False)

    @rows.default
    def _(self) -> _Rows:
        return _Rows(self.lanes.count, self.asked.spec.dimension)

    def all(self, scene: Scene, job: Callable[[], tuple[Any, ...]]) -> Generator[None]:
        """Fly all lanes; ``job`` says what flies one in another process."""
        yield from self.plain(scene)
        yield from self.others(job)

    def plain(self, scene: Scene) -> Iterator[None]:
        """Fly lanes that need no judgement, some at a time."""
        lanes = self.lanes
        try:
            driver = self.asked.driver(scene, lanes.t[0].tolist(), lanes.x[0], lanes.before(0))
        except HybridError:  # it is the lanes' own
            return
        given = GivenLanes(lanes.values, lanes.t, lanes.x)
        together = abreast(scene, driver, self.mode, given)
        for flown in together.fly() if together else ():
            self._put(together, flown)
            yield

    def _put(self, together: Any, flown: FlownLanes) -> None:
        """Put down lanes that machine code has flown; one to be certified needs its run."""
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
            said = verdict, status.name.lower(), str(status)
            self.rows.put(which, _Row._make((t, x, names, *counts, t_inf, error, ratio, *said)))

    def others(self, job: Callable[[], tuple[Any, ...]]) -> Iterator[None]:
        """Fly the lanes that are left, one by one, here and in other processes."""
        left = np.flatnonzero(~self.rows.done).tolist()
        shared = Shared(lambda i: self.row(self.lanes.lane(i)), left, job, _same)
        with closing(shared.answers()) as answers:
            for i, flown in answers:
                self.rows.put(i, flown.row)
                if flown.refused is not None:
                    self.refused.append(flown.refused)
                yield

    def row(self, lane: Lane) -> _Ended:
        """Fly a lane."""
        driver = None
        try:
            driver = self.asked.driver(lane.scene, lane.t, lane.x, lane.history)
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
        finally:  # what accumulates before a fault is told, too
            give_errors(driver, self.asked.solver, self.asked.method, self.mode, x)
        self.asked.judge(driver)

    def _ended(self, lane: Lane, driver: Driver | None, status: str, reason: str) -> _Row:
        begun = lane.t[0], lane.x, self.mode
        if driver is None:
            return _Row._make((*begun, 0, 0, 0, *NO_LIMIT, status, reason))
        end, limit = driver.end or begun, self._limit(driver)
        counts = driver.record.made, driver.steps, len(driver.record.zeno)
        return _Row._make((*end, *counts, *limit, status, reason))

    def _limit(self, driver: Driver) -> tuple[float, float, float, str]:
        """Time, error, ratio and verdict of the first accumulation."""
        if not driver.record.zeno:
            return NO_LIMIT
        point, tail = driver.record.zeno[0], driver.record.tails[0]
        if not self.certify:
            return point.t, np.nan if tail is None else tail.t_error, point.ratio, point._verdict
        return point.t, point.t_error, point.ratio, point.verdict


def _dataset(spec: Spec, lanes: Lanes, rows: _Rows, measure: Sequence[str]) -> xarray.Dataset:
    import xarray

    outputs = {
        name: evaluated(spec, name, lanes.parameters, rows.columns["t"], rows.columns["x"], True)
        for name in require_outputs(spec, measure)
    }
    text = {name: v.astype(str) for name, v in rows.columns.items() if v.dtype == object}
    columns = rows.columns | text
    record = spec.record(columns.pop("x"))
    states = {
        s.name: (("lane", *(f"{s.name}_{i}" for i in range(len(s.shape)))), record[s.name])
        for s in spec.states
    }
    measured = {
        name: (("lane", *(f"{name}_{i}" for i in range(values.ndim - 1))), values)
        for name, values in outputs.items()
    }
    return xarray.Dataset(
        {name: ("lane", values) for name, values in columns.items()} | states | measured,
        coords=lanes.coordinates(),
        attrs={"model": spec.model, **{f"status_{n}": said for n, said in STATUSES.items()}},
    )


__all__ = ["ensemble"]
