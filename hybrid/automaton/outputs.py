"""Outputs: named functions of time and state, evaluated on demand.

Solvers and rules do not know them. They are the author's own methods, vectorised over times by JAX.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import attrs
import numpy as np

from ..errors import OptionError
from .captured import takes
from .markers import State, _Named
from .reals import short
from .record import Record
from .spec import Spec
from .trace import caller, real_valued, wide


@attrs.define(slots=False, eq=False)
class Output(_Named):
    """Marker of an output; made by :func:`output`."""

    function: Callable[..., Any]
    unit: str = ""
    doc: str = ""
    hides: bool = False

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self if instance is None else partial(_asked, self.function, instance)


def _asked(function: Callable[..., Any], model: Any, t: Any, s: Any) -> Any:
    """The method's value at a record, or at a dict of states (as :func:`as_function` returns)."""
    states = Record(tuple(s), tuple(s.values())) if isinstance(s, Mapping) else s
    return function(model, t, states)


def output(function: Callable[..., Any] | None = None, *, unit: str = "", doc: str = "") -> Any:
    """Declare an output: ``@hy.output`` or ``@hy.output(unit="J")`` over a method.

    Parameters
    ----------
    unit, doc : str
        Physical unit and a short description (the method's docstring if omitted); used in tables,
        pictures and saved files.

    Notes
    -----
    The method is ``def name(self, t, s)``; it returns a number or an array, written with
    ``jax.numpy``. An output is not a state: it is not integrated, and ``x, v = run(t)`` does not
    contain it. ``run(t).name`` computes it from the state, in any mode, for many times in one call
    and in 64 bits. ``model.name(t, s)`` calls the method on a record or a dict of the states.
    """
    hides = _hidden(sys._getframe(1))
    if function is not None:
        return Output(function, unit, doc or _said(function), hides(function))
    return lambda given: Output(given, unit, doc or _said(given), hides(given))


def _hidden(body: Any) -> Callable[[Any], bool]:
    """A test whether a function shadows a state of the same name in the class body."""
    return lambda function: isinstance(body.f_locals.get(getattr(function, "__name__", "")), State)


def _said(function: Any) -> str:
    """The first line of a function's docstring."""
    return (getattr(function, "__doc__", None) or "").strip().split("\n")[0]


def faults(markers: Mapping[str, Any], inherited: Mapping[str, Any]) -> Iterator[str]:
    """What is wrong with the outputs of a class, apart from their signatures."""
    for name, marker in markers.items():
        before = inherited.get(name)
        kinds = {type(each) for each in (marker, before)}
        if getattr(marker, "hides", False) or {State, Output} <= kinds:
            yield f"output {name}: {name} is a state; give the output another name"
        if isinstance(marker, Output) and takes(marker.function, "past"):
            yield f"output {name}: takes past; an output depends on t and s: (self, t, s)"


def numbers(call: Callable[..., Any]) -> Callable[..., Any]:
    """``call`` with its result checked to be a real number or array."""

    def checked(parameters: Any, t: Any, x: Any) -> Any:
        import jax.numpy as jnp

        return real_valued(jnp.asarray(call(parameters, t, x)), "")

    return checked


@lru_cache(maxsize=256)
def _vectorised(cls: Any, name: str, lanes: bool) -> Callable[..., Any]:
    """An output vectorised over times and states, and over parameters if ``lanes``."""
    import jax

    spec: Spec = cls.spec
    call = numbers(caller(cls, spec, spec.output(name).function))
    axes = (0 if lanes else None,) * len(spec.parameters) + (0,) * len(spec.signals)
    return jax.jit(jax.vmap(call, in_axes=(axes, 0, 0)))


def evaluated(
    spec: Spec, name: str, parameters: Sequence[Any], t: Any, x: Any, lanes: bool = False
) -> np.ndarray:
    """Values of an output at states ``x`` (coordinates on the last axis) and times ``t``.

    The result has the axes of ``t``, then those of the output. ``parameters`` are the parameters,
    then the data of the signals; with ``lanes`` each parameter has a leading axis, one entry per
    state. The number of rows is padded to a power of two, so few sizes are compiled.

    Raises
    ------
    OptionError
        If the run was loaded from a file without its model.
    """
    if spec.cls is None:
        raise OptionError(
            f"{spec.model}: {name} is worked out by the model's own method, which no file holds: "
            f"load the run with its model, hy.load(path, {spec.model})"
        )
    times = np.broadcast_to(np.asarray(t, dtype=float), x.shape[:-1])
    flat, states = times.reshape(-1), x.reshape(-1, spec.dimension)
    size = 1 << max(len(flat) - 1, 0).bit_length()
    count = len(spec.parameters)
    given = [np.asarray(value, dtype=float) for value in parameters[:count]]
    given = [_filled(value, size) for value in given] if lanes else given
    given += [_filled(each.pieces(flat), size) for each in parameters[count:]]
    with wide():
        found = _vectorised(spec.cls, name, lanes)(
            tuple(given), _filled(flat, size), _filled(states, size)
        )
    values = np.asarray(found)[: len(flat)]
    return values.reshape(times.shape + values.shape[1:])


def _filled(rows: np.ndarray, size: int) -> np.ndarray:
    """Rows padded to ``size`` by repeating the last one, or with zeros if there is none."""
    if not len(rows):
        return np.zeros((size, *rows.shape[1:]))
    return np.concatenate([rows, np.broadcast_to(rows[-1], (size - len(rows), *rows.shape[1:]))])


class Observed(Record):
    """A record of a run: its states, and by name its outputs, evaluated on demand.

    Iteration, unpacking and comparison see the states only.
    """

    def __init__(self, spec: Spec, parameters: Mapping[str, Any], t: Any, x: Any) -> None:
        states = spec.record(x)
        super().__init__(states._fields, states._values, unpacked=states._unpacked)
        self.__dict__.update(_seen=(spec, parameters, t, x))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        spec, parameters, t, x = self._seen
        known = [output.name for output in spec.outputs]
        if name not in known:
            try:
                return super().__getattr__(name)
            except AttributeError as fault:
                raise AttributeError(f"{fault}; outputs: {', '.join(known)}") from None
        given = [parameters[name] for name in spec.given]
        self.__dict__[name] = value = evaluated(spec, name, given, t, x)
        return value

    def __getitem__(self, name: str) -> Any:
        own = any(output.name == name for output in self._seen[0].outputs)
        return getattr(self, name) if own else super().__getitem__(name)


def observed(spec: Spec, parameters: Mapping[str, Any], t: Any, x: Any) -> Record:
    """The states ``x`` at times ``t`` as a record, with outputs if the model has any."""
    return Observed(spec, parameters, t, x) if spec.outputs else spec.record(x)


def require_outputs(
    spec: Spec, names: Any, taken: Sequence[str] = (), also: Iterable[str] = ()
) -> list[str]:
    """The output names among ``names``; names of states are left out.

    A refusal names ``also`` what else the caller takes.

    Raises
    ------
    OptionError
        If a name is neither a state nor an output, or is in ``taken``.
    """
    known = [output.name for output in spec.outputs]
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        example = names if isinstance(names, str) else (*known, *spec.names)[0]
        raise OptionError(f'{spec.model}: {short(names)}: give names in a list, ["{example}"]')
    for name in names:
        if name not in (*known, *spec.names):
            there, what = ", ".join((*spec.names, *known, *also)), "state or output"
            what = "state, output or measure" if also else what
            raise OptionError(f"{spec.model} has no {what} {name!r}; there are: {there}")
        if name in known and name in taken:
            raise OptionError(
                f"{spec.model}: output {name!r}: the table has another column of that name; give "
                "the output another name"
            )
    return [name for name in names if name in known]
