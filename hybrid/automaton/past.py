"""What a model sees of its past: ``past(lag)`` and the lags it asks for.

In a trace the past is, for each lag, a polynomial in time: the recorded trajectory on one *window*
of the past. Its coefficients are inputs of the trace, after the parameters. On a window a model
with delays is therefore an ordinary model for every reader of the trace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import attrs
import numpy as np

from ..rules.places import WINDOW_DEGREE
from .captured import takes
from .discrete import number
from .record import Record


@attrs.frozen
class LagSpec:
    """A lag that a model asks for.

    Attributes
    ----------
    name : str
        Name in messages: the parameter, the number, or the function that asks for it.
    value : float or None
        The lag if it is a constant; None if it is a parameter or depends on time or state.
    parameter : str or None
        The parameter that is the lag, if one is.
    """

    name: str
    value: float | None = None
    parameter: str | None = None


def window_shapes(lags: Iterable[LagSpec], dimension: int) -> tuple[tuple[int, ...], ...]:
    """Shapes of the windows' arrays: a frame and a coefficient array for each lag.

    The frame holds the midpoint and the half-length of the window. Row k of the coefficients
    multiplies the k-th power of the window's local coordinate, which runs from -1 to 1.
    """
    return ((2,), (WINDOW_DEGREE + 1, dimension)) * len(tuple(lags))


def blank(lags: Iterable[LagSpec], dimension: int, shown: float = np.nan) -> list[np.ndarray]:
    """Constant windows with value ``shown``; NaN, i.e. no value, by default."""
    rows = np.zeros((WINDOW_DEGREE + 1, dimension))
    rows[0] = shown
    return [np.array([0.0, 1.0]), rows] * len(tuple(lags))


def remembered(spec: Any, vector: Any) -> Record:
    """The part of a state that is recorded for delays: the flowing states."""
    whole = spec.record(vector, number)
    names = tuple(state.name for state in spec.flowing)
    label = "state that flows, which alone are remembered," if spec.discrete else "state"
    return Record(names, tuple(whole), label)


class Past:
    """``past`` in a trace: the record at ``t - lag``, evaluated from the windows.

    ``numbers`` are the indices of the lags among the model's, in the order of the calls.
    """

    def __init__(self, spec: Any, t: Any, windows: Any, numbers: Iterable[int]) -> None:
        self.spec, self.t, self.windows = spec, t, windows
        self.numbers = iter(numbers)
        self.lags: list[Any] = []

    def __call__(self, lag: Any) -> Any:
        import jax.numpy as jnp

        self.lags.append(lag)
        frame, rows = self.windows[2 * (number := next(self.numbers)) : 2 * number + 2]
        place = ((self.t - lag) - frame[0]) / frame[1]
        powers = [place**0, place]
        for _ in range(WINDOW_DEGREE - 1):
            powers.append(powers[-1] * place)
        return remembered(self.spec, jnp.stack(powers) @ rows)


class Asking:
    """``past`` during the search for lags: it records each lag and returns a dummy state."""

    def __init__(self, spec: Any, t: Any, *_: Any) -> None:
        self.spec, self.t = spec, t
        self.lags: list[Any] = []

    def __call__(self, lag: Any) -> Any:
        self.lags.append(_number(lag))
        return remembered(self.spec, np.ones(self.spec.dimension) * self.t)

    def __getattr__(self, name: str) -> Any:
        if name in self.spec.names:
            raise AttributeError(f"past.{name}: past is a function, write past(lag).{name}")
        raise AttributeError(f"past has no {name!r}; write past(lag), and a state of it")


def _number(lag: Any) -> Any:
    """The lag, checked to be a scalar and, if known, finite and not negative."""
    if isinstance(lag, str) or np.shape(lag) != ():
        what = repr(lag) if isinstance(lag, str) else f"of shape {np.shape(lag)}"
        raise ValueError(f"past(lag): the lag is {what}; one number is due")
    if _is_known(lag) and not (np.isfinite(lag) and lag >= 0):
        raise ValueError(f"past({float(lag)!r}): a lag must be a number of at least 0")
    return lag


class Lags:
    """Collects the lags of a model, function by function.

    ``numbers[kind, owner]`` lists, for one function, the indices in ``found`` of its lags.
    """

    def __init__(self, spec: Any) -> None:
        self.spec = spec
        self.found: list[LagSpec] = []
        self.numbers: dict[tuple[str, str], list[int]] = {}

    def note(self, key: tuple[str, str], where: str, lags: list[Any], parameters: Any) -> None:
        """Register the lags of one function; equal parameters and equal numbers share one entry."""
        names = [p.name for p in self.spec.parameters]
        by_identity = {id(value): name for name, value in zip(names, parameters, strict=True)}
        places: dict[int, int] = {}
        for lag in lags:
            if id(lag) not in places:
                places[id(lag)] = self._place(lag, by_identity.get(id(lag)), where)
        self.numbers[key] = [places[id(lag)] for lag in lags]

    def _place(self, lag: Any, parameter: str | None, where: str) -> int:
        if parameter is not None:
            made = LagSpec(parameter, parameter=parameter)
        elif _is_known(lag):
            made = LagSpec(repr(float(lag)), value=float(lag))
        else:
            own = sum(spec.name.startswith(f"{where}, lag") for spec in self.found)
            made = LagSpec(f"{where}, lag {own + 1}")
        if made not in self.found:
            self.found.append(made)
        return self.found.index(made)


def plain(lag: Any, parameters: int, extra: int) -> bool:
    """Whether a traced lag depends on parameters, ``t`` and ``x`` only.

    The inputs of the trace are parameters, windows of the past, ``t``, ``x`` and ``extra`` numbers.
    """
    jaxpr = lag.jaxpr
    needed = {id(v) for v in jaxpr.outvars}
    for equation in reversed(jaxpr.eqns):
        if needed.intersection(map(id, equation.outvars)):
            needed.update(map(id, equation.invars))
    last = len(jaxpr.invars) - extra
    others = [*jaxpr.invars[parameters : last - 2], *jaxpr.invars[last:]]
    return not needed.intersection(map(id, others))


def _is_known(lag: Any) -> bool:
    """Whether a lag is a number already when the class is defined."""
    import jax

    return not isinstance(lag, jax.core.Tracer)


def asking(function: Callable[..., Any], past: Any) -> Callable[..., Any]:
    """``function`` with its argument ``past`` bound, if it takes one."""
    if not takes(function, "past"):
        return function
    return partial(function, past=past)
