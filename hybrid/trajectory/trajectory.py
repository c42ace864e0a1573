"""The trajectory of a run in hybrid time: arcs joined by jumps, and limit points of jumps.

A trajectory is a list of arcs; between two of them lies a jump or an accumulation of jumps. A
chattering tail has infinitely many arcs. They are made from its curve on request, as far as their
times differ from the limit in double precision.
"""

from __future__ import annotations

import enum
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.outputs import observed
from ..automaton.reals import reals, short
from ..automaton.record import Record
from ..automaton.spec import Spec
from ..errors import FRAMES, OptionError, need
from .accumulation import Accumulation, explain, unfinished
from .arcs import Arc, JumpRow, Part, Table, TailPart, arcs_of
from .forces import force, impulses
from .log import Log
from .stats import Stats

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Most accumulations that ``repr`` lists, and that ``explain`` explains by default.
LISTED, EXPLAINED = 9, 36


class Status(enum.Enum):
    """How a run ended; the value is a sentence with the remedy."""

    REACHED_END = "The run reached its last time."
    ZENO_STOPPED = (
        "The run stopped at an accumulation of jumps, as zeno='stop' asks; "
        "zeno='rest' goes on in the resting mode."
    )
    NO_REST = (
        "The run stopped at an accumulation of jumps that nothing follows: to go on, declare "
        "the contact with rests=True, or a mode with limit_of= the edges of the cycle."
    )
    TERMINATED = "The run ended at an edge that leads to hy.TERMINATE: at its last jump."
    MAX_JUMPS = "The run stopped at max_jumps; give a larger max_jumps to go on."
    MAX_STEPS = "The run stopped at max_steps; give a larger max_steps to go on."
    INTERRUPTED = "The run was interrupted; what was computed until then is kept."

    def __str__(self) -> str:
        return self.value


@attrs.frozen(eq=False)
class Jump:
    """A jump: at time ``t``, from arc ``j`` to arc ``j + 1``, by the named edge.

    ``before`` and ``after`` are the states on its two sides.
    """

    t: float
    j: int
    edge: str
    before: Record
    after: Record


class Jumps(Sequence[Jump]):
    """The table of jumps: a sequence of :class:`Jump`, and columns ``t, j, edge``.

    ``before`` and ``after`` are records of columns: ``run.jumps.before.v``.
    """

    def __init__(
        self,
        table: Table,
        observed: Callable[[Any, Any], Record],
        impulses: Callable[[Table], Numbers],
    ) -> None:
        self.table, self._observed, self._impulses = table, observed, impulses

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, str):
            raise OptionError(
                f"jumps[{index!r}]: columns are attributes, jumps.t, jumps.edge, jumps.before.x; "
                "jumps[0] is the first jump"
            )
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = _place(index, len(self), "jump")
        t, _, edge, before, after = (column[place] for column in self.table)
        sides = (self._observed(t, x) for x in (before, after))
        return Jump(float(t), place, edge, *sides)

    @property
    def t(self) -> Numbers:
        """Times, shape (number of jumps,)."""
        return self.table.t

    @cached_property
    def j(self) -> np.ndarray:
        """Number of jumps before each jump."""
        return np.arange(len(self))

    @property
    def edge(self) -> np.ndarray:
        """Names of the edges."""
        return self.table.edge

    @cached_property
    def before(self) -> Record:
        """States before the jumps, as a record of columns."""
        return self._observed(self.t, self.table.before)

    @cached_property
    def after(self) -> Record:
        """States after the jumps, as a record of columns."""
        return self._observed(self.t, self.table.after)

    @cached_property
    def impulse(self) -> Numbers:
        """The impulse of each impact: the velocities change by ``impulse * W grad_q(gap)``.

        NaN for a jump that is not an impact: the reset of an edge need not be an impulse, and a
        release has none. With ``inverse_mass`` it is an impulse in the units of mass and gap;
        without, ``W`` is 1.

        Raises
        ------
        OptionError
            If the run was loaded without its model, or the impulse depends on the past.
        """
        return self._impulses(self.table)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Time between successive jumps, from compensated times."""
        return np.diff(self.table.t) + np.diff(self.table.low)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The table as a dict of columns: ``t``, ``j``, ``edge``, ``x_before``, ``x_after``."""
        found = {"t": self.t, "j": self.j, "edge": self.edge}
        for side, record in (("before", self.before), ("after", self.after)):
            for name in record.keys():
                for index in np.ndindex(record[name].shape[1:]):
                    element = name + (str(list(index)) if index else "")
                    found[f"{element}_{side}"] = record[name][(slice(None), *index)]
        return found

    def to_pandas(self) -> Any:
        """The table as a pandas data frame, one row per jump: see :attr:`columns`.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        OptionError
            If pandas is missing.
        """
        need("run.jumps.to_pandas", FRAMES)
        import pandas as pd

        return pd.DataFrame(self.columns)

    def __repr__(self) -> str:
        head = [counted(len(self), "jump")] + [
            f"  {jump.t:.12g}  {jump.edge}  {jump.before} -> {jump.after}" for jump in self[:10]
        ]
        return "\n".join(head + ["  ..."] * (len(self) > 10))


class Accumulations(list[Accumulation]):
    """The accumulations of a run, in order."""

    def __getitem__(self, index: Any) -> Any:
        found = index if isinstance(index, slice) else _place(index, len(self), "accumulation")
        return super().__getitem__(found)


def _place(index: Any, count: int, what: str) -> int:
    """An index counted from the start; an :class:`IndexError` says which ``what`` is missing."""
    try:
        return range(count)[index]
    except IndexError:
        raise IndexError(f"{what} {index}: the run has {counted(count, what)}") from None


@attrs.define(eq=False)
class Solution:
    """The result of a run in hybrid time, and sentences that explain it.

    The attributes are documented at :class:`hybrid.Trajectory`.
    """

    spec: Spec
    parameters: dict[str, Any]
    log: Log
    zeno: list[Accumulation] = attrs.field(converter=Accumulations)
    grazings: list[Jump]
    status: Status
    options: dict[str, Any]
    samples: np.ndarray | None = None
    pairs: list[tuple[int, int]] = attrs.Factory(list)
    hindsight: Any = None
    stats: Stats | None = None
    versions: dict[str, str] = attrs.Factory(dict)

    def observed(self, t: Any, x: Any) -> Record:
        """The record of states ``x`` (coordinates on the last axis) at times ``t``."""
        return observed(self.spec, self.parameters, t, x)

    # -- the record at a time -----------------------------------------------------------

    @cached_property
    def _apart(self) -> tuple[list[Part], dict[int, JumpRow]]:
        return self.log.apart()

    @property
    def parts(self) -> list[Part]:
        """Arcs and chattering tails, in order of time."""
        return self._apart[0]

    @property
    def own_jumps(self) -> dict[int, JumpRow]:
        """Jumps by the index of the part that they end; impacts within tails are left out."""
        return self._apart[1]

    @property
    def t0(self) -> float:
        """First time of the run."""
        return self.log.kept[0].t0

    @property
    def t1(self) -> float:
        """Last time of the run."""
        return self.log.kept[-1].t1

    @cached_property
    def size(self) -> Numbers:
        """Largest absolute value of each state element over the run."""
        return np.abs([state for arc in self.arcs for state in (arc.first, arc.last)]).max(axis=0)  # type: ignore[no-any-return]

    def differs(self, spec: Spec, parameters: dict[str, Any]) -> str:
        """How the run's model differs from that of a spec and parameters; empty if it does not."""
        mine, other = ([(s.name, s.shape) for s in own.states] for own in (self.spec, spec))
        if (self.spec.model, mine) != (spec.model, other):
            return f"the run is one of {self.spec.model}({', '.join(self.spec.names)})"
        for name, value in parameters.items():
            if not np.array_equal(self.parameters[name], value):
                return f"the run has {name} = {self.parameters[name]!r}, not {value!r}"
        return ""

    @property
    def surfaces(self) -> dict[str, Any]:
        """The guards at the end of the run, by edge; empty for a run that was loaded."""
        return dict(self.hindsight.scene.at(self.t1).guards) if self.hindsight else {}

    def __call__(self, t: Any, j: int | None = None, *, side: str = "right") -> Record:
        """The state at times ``t``.

        Parameters
        ----------
        t : float or array
        j : int, optional
            Number of jumps before the arc that is evaluated: selects a state at a jump time.
        side : "right" or "left"
            At a jump time: the state after all jumps there, or before them.

        Returns
        -------
        Record
            Fields of shape ``t.shape`` (plus the state's own shape), and the model's outputs by
            name.

        Raises
        ------
        OptionError
            If a time is outside the run, or no dense output was kept.
        """
        times = _times(t)
        return self.observed(times, self.states(times, j, side=side))

    def __getattr__(self, name: str) -> Any:
        """Raise an :class:`AttributeError` that says how to get a state, an output or a time."""
        spec = None if name.startswith("_") else self.spec
        own = () if spec is None else (*spec.names, *(output.name for output in spec.outputs))
        if name in own:
            raise AttributeError(
                f"a run has no {name!r} of its own: run(t).{name} at a time or an array of times, "
                f"run.final.{name} at the end, run.jumps.after.{name} behind each jump"
            )
        if name in ("t", "y", "x", "sol", "t_events", "y_events"):
            raise AttributeError(
                f"a run has no {name!r}: run(t) has the states at a time or an array of times, "
                "run.jumps.t the times of the jumps, run.t0 and run.t1 the ends"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def states(self, t: Any, j: int | None = None, *, side: str = "right") -> np.ndarray:
        """The states at times ``t`` as vectors, shape ``t.shape + (n,)``; see ``run(t)``."""
        times = _times(t)
        if side not in ("right", "left"):
            raise OptionError(f"side={side!r}: 'right' or 'left'")
        bad = times[(times < self.t0) | (times > self.t1) | np.isnan(times)]
        if bad.size:
            raise OptionError(f"t = {bad.flat[0]} is outside the run [{self.t0}, {self.t1}]")
        if j is not None:
            return self._in_arc(self._arc_of(j, times), times)
        kept = self._kept(times.reshape(-1))
        if kept is not None and side == "right":
            return kept.reshape((*times.shape, self.spec.dimension))
        flat = [self._at(float(v), side) for v in times.reshape(-1)] if times.size < 4 else None
        states = np.array(flat) if flat is not None else self._many(times.reshape(-1), side)
        return states.reshape((*times.shape, self.spec.dimension))

    def _kept(self, times: np.ndarray) -> np.ndarray | None:
        """The states kept at exactly these times; None if the run did not keep them."""
        if self.samples is None or not len(self.samples):
            return None
        asked = self.options["times"]
        places = np.minimum(np.searchsorted(asked, times), len(asked) - 1)
        return self.samples[places] if np.all(asked[places] == times) else None

    def _arc_of(self, j: int, times: np.ndarray) -> Arc:
        """The arc after ``j`` jumps; a limit of jumps separates two arcs with the same ``j``."""
        if isinstance(j, bool) or not isinstance(j, int | np.integer):
            raise OptionError(f"j = {j!r}: a whole number, the jumps before an arc")
        found = [arc for arc in self.arcs if arc.j == j]
        if not found:
            raise OptionError(f"j = {j}: this run has arcs 0 to {self.arcs[-1].j}")
        return next((arc for arc in found if np.all(times <= arc.t1)), found[-1])

    def _in_arc(self, arc: Arc, times: np.ndarray) -> np.ndarray:
        slack = 4 * np.spacing(max(abs(arc.t0), abs(arc.t1)))
        if np.any((times < arc.t0 - slack) | (times > arc.t1 + slack)):
            raise OptionError(f"arc j = {arc.j} covers [{arc.t0}, {arc.t1}] only")
        return self._dense(arc, times)

    def _dense(self, arc: Arc, times: np.ndarray) -> np.ndarray:
        tau = (times - arc.t0) - arc.low
        tau = np.where(times >= arc.t1, arc.length, np.where(times <= arc.t0, 0.0, tau))
        return arc.local(tau)

    @cached_property
    def _starts(self) -> list[float]:
        return [part.t0 for part in self.parts]

    def place(self, t: float, side: str = "right") -> int:
        """The index of the part at time ``t``."""
        found = (bisect_right if side == "right" else bisect_left)(self._starts, t)
        return max(found - 1, 0)

    def _at(self, t: float, side: str) -> np.ndarray:
        part = self.parts[self.place(t, side)]
        if isinstance(part, TailPart):
            if t >= part.t1:
                return part.last
            part = part.arc_at(t, side)
        return self._dense(part, np.asarray(t))

    def _many(self, times: np.ndarray, side: str) -> np.ndarray:
        states = np.empty((len(times), self.spec.dimension))
        index = np.searchsorted(self._starts, times, side=side) - 1  # type: ignore[call-overload]
        index = np.maximum(index, 0)
        for i in np.unique(index):
            chosen, part = index == i, self.parts[i]
            if isinstance(part, TailPart):
                states[chosen] = [self._at(float(t), side) for t in times[chosen]]
            else:
                states[chosen] = self._dense(part, times[chosen])
        return states

    def force(self, contact: str, t: Any) -> Any:
        """The force that a contact bears.

        Parameters
        ----------
        contact : str
        t : float or array

        Returns
        -------
        array
            Shape ``t.shape``. At rest, the multiplier of ``W grad_q(gap)`` that keeps the gap at
            zero; 0 while the contact is open; NaN at an impact. With ``inverse_mass`` it is a
            force in the units of mass and gap; without, all masses are 1, and it is an
            acceleration.

        Raises
        ------
        OptionError
            If there is no such contact, the time is outside the run, no dense output was kept, or
            the run was loaded without its model.

        Notes
        -----
        For several contacts at rest, each has its own force. At a time where a rest begins or ends,
        the value is the limit from later times; so it is at an accumulation point.
        """
        return force(self, contact, t)

    # -- tables -------------------------------------------------------------------------

    @cached_property
    def arcs(self) -> list[Arc]:
        """All arcs; those of a chattering tail as far as they differ in double precision."""
        return [arc for part in self.parts for arc in arcs_of(part)]

    @cached_property
    def jumps(self) -> Jumps:
        """All jumps, those of chattering tails included."""
        seen = partial(observed, self.spec, self.parameters)
        scene = self.hindsight and self.hindsight.scene
        gives = partial(impulses, self.spec, self.parameters, scene)
        return Jumps(self.log.table(self.spec.dimension), seen, gives)

    @property
    def final(self) -> Record:
        """The state at the end."""
        return self.observed(self.t1, self.log.kept[-1].last)

    @property
    def mode(self) -> str:
        """The mode at the end."""
        return self.log.kept[-1].mode

    # -- sentences --------------------------------------------------------------------

    def explain(self, *, whole: bool = False) -> str:
        """What happened in the run, in a few sentences.

        Parameters
        ----------
        whole : bool
            Whether to explain all accumulations; by default only the first and the last of many.
            Verdicts and error bounds of those explained are computed.
        """
        lines = [
            f"{self.spec.model}, t = {self.t0:g} to {self.t1:g}: "
            f"{counted(self.log.count, 'jump')} listed."
        ]
        lines += _few(self.zeno, explain, len(self.zeno) if whole else EXPLAINED)
        if self.status is Status.MAX_JUMPS:
            rows = list(self.own_jumps.values())
            lines.append(unfinished([row.edge for row in rows], [row.t for row in rows]))
        return "\n".join([*lines, self.ending])

    @property
    def ending(self) -> str:
        """How the run ended: the sentence of ``status``, with the edge that ended it."""
        if self.status is not Status.TERMINATED:
            return str(self.status)
        return f"The run ended at the edge {self.jumps[-1].edge}, which leads to hy.TERMINATE."

    def __repr__(self) -> str:
        jumps = counted(self.log.count, "jump")
        head = f"{self.spec.model}: {self.t0:g} <= t <= {self.t1:g}, {jumps} listed"
        zeno = _few(self.zeno, lambda point: f"accumulation at t = {point.t!r}", LISTED)
        return "\n  ".join([head, *zeno, self.ending])


def counted(count: int, what: str) -> str:
    """A number with a noun, in the plural unless it is 1."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _times(t: Any) -> np.ndarray:
    """Times as an array."""
    try:
        return reals(t)
    except ValueError:
        raise OptionError(f"t={short(t)}: a time, or an array of times") from None


def _few(
    points: Sequence[Accumulation], say: Callable[[Accumulation], str], most: int
) -> list[str]:
    """One line per point; the middle ones are left out if there are more than ``most``."""
    if len(points) <= most:
        return [say(point) for point in points]
    first, last = points[: most - most // 2], points[-(most // 2) :]
    left_out = f"... {len(points) - most} more accumulations ..."
    return [*map(say, first), left_out, *map(say, last)]
