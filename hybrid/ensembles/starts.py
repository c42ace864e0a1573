"""Starts, times and parameters of the lanes of an ensemble, as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from ..automaton.chance import STREAM, has_stream
from ..automaton.clocks import disordered
from ..automaton.discrete import misfit
from ..automaton.reals import reals, short
from ..automaton.record import Record
from ..automaton.signals import EachLane, of_lanes
from ..automaton.spec import Spec
from ..errors import OptionError, ParameterError, StartError
from ..lowering import Scene, scene_with
from ..run.options import values_of

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector


class Lane(NamedTuple):
    """One lane: its number, its scene, first and last time, start and history."""

    number: int
    scene: Scene
    t: tuple[float, float]
    x: StateVector
    history: Any


class Lanes:
    """Starts, times and parameters of all lanes, with one row for each lane.

    Attributes
    ----------
    count : int
        Number of lanes.
    varied : dict
        The given arrays over the lanes, by name.
    """

    def __init__(
        self,
        model: Any,
        start: Any,
        t: Any,
        given: dict[str, Any],
        history: Any,
        seed: int = 0,
    ) -> None:
        self.cls: Any = type(model)
        self.spec: Spec = model.spec
        self.varied: dict[str, np.ndarray] = {}
        self._signals, names = of_lanes(model, given), [s.name for s in self.spec.signals]
        self._samples, given = model.samples, {n: v for n, v in given.items() if n not in names}
        _check(model, given)
        if not (isinstance(t, Sequence) and len(t) == 2):
            raise OptionError(f"{self.spec.model}: t={short(t)}: give (first, last) time")
        states = self._states("start", values_of(self.spec, start, seed))
        self.shapes = tuple(np.shape(getattr(model, p.name)) for p in self.spec.parameters)
        parameters = [
            (self._array(p.name, given.get(p.name, getattr(model, p.name)), shape), shape)
            for p, shape in zip(self.spec.parameters, self.shapes, strict=True)
        ]
        times = [(self._array(name, v, ()), ()) for name, v in zip(("t0", "t1"), t, strict=True)]
        self.history, before = history, []
        if isinstance(history, Mapping | Record):
            self.history = {name: history[name] for name in history.keys()}
            before = [(self._past(name, v), self._shape(name)) for name, v in self._constants()]
        self.count = self._counted()
        self.x, self.values, self.t = map(self._rows, (states, parameters, times))
        if self.spec.chances and not has_stream(start):
            self.x[:, self.spec.place(STREAM)] += np.arange(self.count)
        self.known = [self._full(*each) for each in before]
        late = np.flatnonzero(~(self.t[:, 1] > self.t[:, 0]))
        if len(late):
            where, own = f"{self.spec.model}, lane {late[0]}", tuple(self.t[late[0]].tolist())
            raise OptionError(f"{where}: t={own}: give the first time before the last")

    def _counted(self) -> int:
        """The number of lanes; raises an :class:`OptionError` if arrays differ in length."""
        differ: dict[str, Any] = self.varied | {n: v for n, v in self._signals.items() if v[1:]}
        counts = {len(v) for v in differ.values()}
        if len(counts) > 1:
            each = ", ".join(f"{name}: {len(v)}" for name, v in differ.items())
            raise OptionError(f"{self.spec.model}: lanes differ in number ({each})")
        return counts.pop() if counts else 1

    def lane(self, i: int) -> Lane:
        """Lane number ``i``."""
        samples = tuple(each.lanes[i] for each in self.samples)
        scene = scene_with(self.cls, self.shapes, tuple(self.values[i].tolist()), samples)
        t0, t1 = self.t[i].tolist()
        return Lane(i, scene, (t0, t1), self.x[i].copy(), self.before(i))

    @cached_property
    def samples(self) -> list[EachLane]:
        """The data of each signal, lane by lane."""
        pairs = zip(self.spec.signals, self._samples, strict=True)
        rows = [self._signals.get(spec.name, [own]) for spec, own in pairs]
        return [EachLane(row if row[1:] else row * self.count) for row in rows]

    @property
    def parameters(self) -> list[np.ndarray]:
        """The values of each parameter; the first axis is that of the lanes."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes])[:-1]
        columns = np.split(self.values, ends, axis=1) if self.shapes else []
        pairs = zip(columns, self.shapes, strict=True)
        return [column.reshape((self.count, *shape)) for column, shape in pairs]

    def coordinates(self) -> dict[str, Any]:
        """Coordinates of a Dataset: the starts and parameters that vary, with their units."""
        states = {f"{s.name}_{what}": s for s in self.spec.states for what in ("start", "history")}
        known: dict[str, Any] = {p.name: p for p in self.spec.parameters} | states
        return {
            name: (
                ("lane", *(f"{name}_{i}" for i in range(v.ndim - 1))),
                v,
                attributes_of(known[name]) if name in known else {},
            )
            for name, v in self.varied.items()
        }

    def _states(self, what: str, values: Any) -> list[tuple[np.ndarray, tuple[int, ...]]]:
        pairs = zip(self.spec.states, values, strict=True)
        found = [(self._array(f"{s.name}_{what}", v, s.shape), s.shape) for s, v in pairs]
        for state, (array, _) in zip(self.spec.states, found, strict=True):
            wrong = misfit(state.kind, array)
            if wrong:
                raise StartError(f"{self.spec.model}: {what} {state.name}: a value {wrong}")
        return found

    def _constants(self) -> list[tuple[str, Any]]:
        """The states, with values, whose history is constant; these may differ between lanes."""
        known = self.spec.names
        return [(n, v) for n, v in self.history.items() if n in known and not callable(v)]

    def _past(self, name: str, value: Any) -> np.ndarray:
        return self._array(f"{name}_history", value, self._shape(name))

    def _shape(self, name: str) -> tuple[int, ...]:
        return self.spec.states[self.spec.names.index(name)].shape

    def before(self, i: int) -> Any:
        """The history of lane number ``i``."""
        if not self.known:
            return self.history
        own = zip(self._constants(), self.known, strict=True)
        return {**self.history, **{name: values[i] for (name, _), values in own}}

    def _array(self, name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
        """A value for all lanes, of the given shape, or an array of values, one for each lane.

        Such an array is added to ``varied``. Raises a :class:`StartError` for other values.
        """
        where = f"{self.spec.model}: {name}"
        try:
            array = reals(value)
        except ValueError:
            raise StartError(f"{where} = {short(value)} is no number") from None
        if not np.all(np.isfinite(array)):
            raise StartError(f"{where}: a value is not finite")
        own = array.ndim - len(shape)
        if own not in (0, 1) or array.shape[own:] != shape or array.size == 0:
            due = f"{shape} or (lanes, ...)" if shape else "one number, or one for each lane,"
            raise StartError(f"{where} has shape {array.shape}; {due} is due")
        if own:
            self.varied[name] = array
        return array

    def _full(self, array: np.ndarray, shape: tuple[int, ...]) -> Numbers:
        return np.broadcast_to(array, (self.count, *shape))

    def _rows(self, columns: list[tuple[np.ndarray, tuple[int, ...]]]) -> Matrix:
        """Columns of values as one array with a row of numbers for each lane."""
        parts = [self._full(v, shape).reshape(self.count, -1) for v, shape in columns]
        return np.concatenate([np.empty((self.count, 0)), *parts], axis=1)


def attributes_of(what: Any) -> dict[str, str]:
    """Unit and description of a state, a parameter or an output, as attributes of a variable."""
    return {"units": what.unit, "long_name": what.doc or what.name}


def _check(model: Any, given: dict[str, Any]) -> None:
    """Raise if a parameter is unknown, or the model's validators reject its extreme values."""
    spec = model.spec
    unknown = [name for name in given if name not in {p.name for p in spec.parameters}]
    if unknown:
        known = ", ".join(p.name for p in spec.parameters) or "none"
        raise OptionError(f"{spec.model}: parameters: it has no {unknown[0]!r}; there are: {known}")
    for extreme in (np.min, np.max):
        attrs.evolve(model, **{name: _end(spec, name, v, extreme) for name, v in given.items()})
    own = {p.name: getattr(model, p.name) for p in spec.parameters}
    varied = {name: v for name, v in given.items() if np.ndim(v) > np.ndim(own[name])}
    alike = len({len(v) for v in varied.values()}) == 1  # others are refused later
    lane = disordered(spec, own | given) if alike else None
    if lane is not None:
        attrs.evolve(model, **(given | {name: v[lane] for name, v in varied.items()}))


def _end(spec: Spec, name: str, value: Any, extreme: Any) -> Any:
    """The least or the greatest (``extreme``) of a parameter's values."""
    where = f"{spec.model}: parameters {name}={short(value)}"
    try:
        array = reals(value)
    except ValueError:
        raise ParameterError(f"{where}: a number or an array of numbers") from None
    if not array.size:
        raise OptionError(f"{where}: no value, so no lane; give one or more")
    return extreme(array, axis=0) if array.ndim else value
