"""Signals: inputs of a model that are given as data and read at the present time.

Between two knots a signal is a polynomial in time. In a trace its current polynomial is an input,
after the parameters, so the trace does not grow with the data. For every reader of the trace a
model with signals is therefore an ordinary model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any

import attrs
import numpy as np

from ..errors import OptionError, ParameterError
from .reals import reals, short

#: Polynomial degree of each kind, and the choices for times outside the data.
KIND_DEGREES = {"previous": 0, "linear": 1, "cubic": 3}
BEYOND_DATA = ("error", "hold", "zero", "periodic")


@attrs.frozen
class SignalSpec:
    """A signal that a model declares."""

    name: str
    unit: str
    doc: str
    kind: str
    outside: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Numbers per piece: the time from which it counts, then its coefficients."""
        return 1 + (1 + KIND_DEGREES[self.kind]) * prod(self.shape)


def signal(
    unit: str = "",
    doc: str = "",
    kind: str = "linear",
    outside: str = "error",
    shape: tuple[int, ...] = (),
) -> Any:
    """Declare an input that is given as data: ``Model(road=(times, values))``, ``self.road(t)``.

    Parameters
    ----------
    unit, doc : str
        Physical unit and a short description.
    kind : "linear", "previous" or "cubic"
        Interpolation between the knots: linear; the value at the preceding knot; or a cubic spline
        with two continuous derivatives.
    outside : "error", "hold", "zero" or "periodic"
        The value before the first and after the last knot: a run over such times is refused; the
        value at that knot; zero; or the periodic continuation.
    shape : tuple of int
        Shape of the value at each time, ``()`` for a number.

    Raises
    ------
    ParameterError
        When a model is made without data, or with times that do not increase or values that are
        not finite or of another shape.

    Notes
    -----
    Data are given as ``(times, values)``, or as a series of pandas or xarray whose index is the
    time. Steps end at the knots.
    """
    metadata = {"hybrid": "signal", "spec": (unit, doc, kind, outside, shape)}
    return attrs.field(metadata=metadata, kw_only=True)


def is_signal(value: Any) -> bool:
    """Whether ``value`` is the marker of a signal."""
    return getattr(value, "metadata", {}).get("hybrid") == "signal"


def declared(markers: Mapping[str, Any]) -> tuple[tuple[SignalSpec, ...], list[str]]:
    """The signals among the markers of a class, and what is wrong with them."""
    found, faults = [], []
    for name, marker in markers.items():
        if not is_signal(marker):
            continue
        unit, doc, kind, outside, shape = marker.metadata["spec"]
        shape = (shape,) if isinstance(shape, int) else shape
        whole = isinstance(shape, tuple) and all(isinstance(n, int) and n > 0 for n in shape)
        kinds, beyond = (", ".join(map(repr, names)) for names in (KIND_DEGREES, BEYOND_DATA))
        wrong = [
            (kind not in KIND_DEGREES, f"kind={kind!r}; one of {kinds}"),
            (outside not in BEYOND_DATA, f"outside={outside!r}; one of {beyond}"),
            (not whole, f"shape={shape!r}; give whole numbers greater than 0: (3,)"),
        ]
        own = [f"signal {name}: {what}" for fault, what in wrong if fault]
        faults += own
        if not own:
            found.append(SignalSpec(name, unit, doc, kind, outside, shape))
    return tuple(found), faults


class Present:
    """A signal in a trace: its value at the present time, from the coefficients of its piece."""

    def __init__(self, spec: SignalSpec, t: Any, piece: Any) -> None:
        self.spec, self.t, self.piece = spec, t, piece

    def __call__(self, t: Any) -> Any:
        here = t
        while here is not self.t and hasattr(here, "primal"):  # tracers of a time derivative
            here = here.primal
        if here is not self.t:
            name = self.spec.name
            raise ValueError(
                f"self.{name}(...): a signal is read at the present time, self.{name}(t); for what "
                "depends on a state, or for another time, write a function of jax.numpy"
            )
        rows = self.piece[1:].reshape(1 + KIND_DEGREES[self.spec.kind], *self.spec.shape)
        since, value = t - self.piece[0], rows[-1]
        for k in range(KIND_DEGREES[self.spec.kind])[::-1]:
            value = value * since + rows[k]
        return value


class Samples:
    """The data of a model's signal: knots, and polynomials between them.

    ``model.road(t)`` is the value at a time, or at an array of times (the leading axes of the
    result).

    Attributes
    ----------
    times, values : array
        As given.

    Raises
    ------
    OptionError
        When it is evaluated outside its data and declared with ``outside="error"``.
    """

    def __init__(self, spec: SignalSpec, times: np.ndarray, values: np.ndarray) -> None:
        self.spec, self.times, self.values = spec, times, values

    def __reduce__(self) -> Any:
        return Samples, (self.spec, self.times, self.values)

    def __repr__(self) -> str:
        first, last = self.times[[0, -1]].tolist()
        return f"<{len(self.times)} knots from {first:g} to {last:g}>"

    @cached_property
    def _digest(self) -> bytes:
        made = hashlib.blake2b(repr(self.spec).encode())
        made.update(self.times.tobytes() + self.values.tobytes())
        return made.digest()

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Samples) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    @cached_property
    def table(self) -> np.ndarray:
        """One row of :attr:`SignalSpec.size` numbers per piece.

        The rows are the piece before the first knot, the pieces between knots, and the piece after
        the last. A periodic signal uses the inner rows only.
        """
        spec, times = self.spec, self.times
        values = self.values.reshape(len(times), -1)
        rows = np.zeros((len(times) + 1, 1 + KIND_DEGREES[spec.kind], values.shape[1]))
        rows[1:-1] = _between(spec, times, values)
        since = np.concatenate([times[:1], times])
        if spec.outside == "hold" or spec.kind == "previous":
            rows[0, 0], rows[-1, 0] = values[0], values[-1]
        if spec.outside == "zero":
            rows[[0, -1]] = 0.0
        if spec.outside == "error" and KIND_DEGREES[spec.kind]:  # the last piece includes its end
            rows[-1], since[-1] = rows[-2], since[-2]
        return np.column_stack([since, rows.reshape(len(rows), -1)])

    @property
    def period(self) -> float:
        """The period; infinite unless the signal is periodic."""
        span = float(self.times[-1] - self.times[0])
        return span if self.spec.outside == "periodic" else np.inf

    def knots(self, t: float, last: float, count: int) -> np.ndarray:
        """Up to ``count`` knots after ``t`` and before ``last``."""
        times, period = self.times, self.period
        if np.isfinite(period):
            first = np.floor((t - times[0]) / period) - 1.0
            turns = first + np.arange(count // (len(times) - 1) + 4)
            times = (times[:-1] + turns[:, None] * period).reshape(-1)
        begin = int(np.searchsorted(times, t, "right"))
        return times[begin : min(begin + count, int(np.searchsorted(times, last)))]

    def pieces(self, t: np.ndarray) -> np.ndarray:
        """The table rows that hold at times ``t``; a knot belongs to the piece after it."""
        times, period = self.times, self.period
        if not np.isfinite(period):
            return self.table[np.searchsorted(times, t, "right")]
        turn = np.floor((t - times[0]) / period)
        turn += times[0] + (turn + 1.0) * period <= t
        turn -= times[0] + turn * period > t
        place = np.clip(np.searchsorted(times, t - turn * period, "right"), 1, len(times) - 1)
        place -= (times[place - 1] + turn * period > t) & (place > 1)
        place += (times[place] + turn * period <= t) & (place < len(times) - 1)
        rows = self.table[place]
        rows[:, 0] += turn * period
        return rows

    def within(self, t: np.ndarray) -> np.ndarray:
        """For each time, whether the signal is defined there."""
        if self.spec.outside != "error":
            return np.ones(np.shape(t), dtype=bool)
        return (self.times[0] <= t) & (t <= self.times[-1])

    def require(self, model: str, t0: float, t1: float) -> None:
        """Refuse a run that leaves the times at which the signal is defined."""
        if not self.within(np.array([t0, t1])).all():
            first, last = self.times[[0, -1]].tolist()
            raise OptionError(
                f"{model}: t = ({t0!r}, {t1!r}), and the signal {self.spec.name} has data from "
                f"{first!r} to {last!r}; end the run there, or declare what is outside: "
                'outside="hold", "zero" or "periodic"'
            )

    def __call__(self, t: Any) -> Any:
        times = np.asarray(t, dtype=float)
        flat = times.reshape(-1)
        if not self.within(flat).all():
            self.require("a model", float(flat.min()), float(flat.max()))
        rows = self.pieces(flat)
        parts = rows[:, 1:].reshape(len(flat), 1 + KIND_DEGREES[self.spec.kind], -1)
        since, value = (flat - rows[:, 0])[:, None], parts[:, -1]
        for k in range(parts.shape[1] - 2, -1, -1):
            value = value * since + parts[:, k]
        found = value.reshape(times.shape + self.spec.shape)
        return found if found.ndim else float(found)


class EachLane:
    """A signal with its own data in each lane; ``pieces`` returns one row per lane."""

    def __init__(self, lanes: Sequence[Samples]) -> None:
        self.lanes = lanes

    def repeated(self, count: int) -> EachLane:
        """The same for several times per lane."""
        return EachLane([samples for samples in self.lanes for _ in range(count)])

    def pieces(self, t: np.ndarray) -> np.ndarray:
        """The table rows at one time per lane."""
        pairs = zip(self.lanes, t.reshape(-1, 1), strict=True)
        return np.concatenate([samples.pieces(when) for samples, when in pairs])


def of_lanes(model: Any, given: Mapping[str, Any]) -> dict[str, list[Samples]]:
    """Data of the signals in ``given``, by name, as lists: one entry per lane, or one for all."""
    found = {}
    for spec in model.spec.signals:
        if spec.name in given:
            data, name = given[spec.name], f"{model.spec.model}.{spec.name}"
            each = data if isinstance(data, list) else [data]
            rows = enumerate(each)
            found[spec.name] = [_taken(f"{name}, lane {i}", spec, own) for i, own in rows]
    return found


def _between(spec: SignalSpec, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients of the pieces between the knots, in powers of the time since the left knot."""
    if spec.kind == "previous":
        return values[:-1, None]
    if spec.kind == "linear":
        slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
        return np.stack([values[:-1], slopes], axis=1)
    from scipy.interpolate import CubicSpline

    ends = "periodic" if spec.outside == "periodic" else "not-a-knot"
    made = CubicSpline(times, values, bc_type=ends)
    return np.asarray(made.c)[::-1].transpose(1, 0, 2)


def taken(model: str, specs: Sequence[SignalSpec], given: Mapping[str, Any]) -> dict[str, Samples]:
    """The data of a model's signals, checked.

    Raises
    ------
    ParameterError
        If the data of a signal are missing or invalid.
    """
    missing = [spec.name for spec in specs if spec.name not in given]
    if missing:
        name = missing[0]
        raise ParameterError(f"{model}: no data for the signal {name}: give {name}=(times, values)")
    return {spec.name: _taken(f"{model}.{spec.name}", spec, given[spec.name]) for spec in specs}


def _taken(name: str, spec: SignalSpec, given: Any) -> Samples:
    if isinstance(given, Samples):
        if given.spec == spec:
            return given
        given = given.times, given.values
    try:
        times, values = (_real(part) for part in _pair(given))
    except (TypeError, ValueError) as fault:
        raise ParameterError(
            f"{name}: {fault}; give (times, values), or a series of pandas or xarray over the time"
        ) from None
    for what in _faults(spec, times, values):
        raise ParameterError(f"{name}: {what}")
    return Samples(spec, times, values)


def _pair(given: Any) -> tuple[Any, Any]:
    """Times and values from a pair or a pandas or xarray series."""
    if hasattr(given, "dims") and hasattr(given, "coords"):  # xarray
        return given.coords[given.dims[0]].values, given.values
    if hasattr(given, "index") and hasattr(given, "to_numpy"):  # pandas
        return given.index.to_numpy(), given.to_numpy()
    try:
        times, values = given
    except (TypeError, ValueError):
        raise ValueError(f"{short(given)} is no pair") from None
    return times, values


def _real(part: Any) -> np.ndarray:
    array = np.asarray(part)
    if array.dtype.kind in "mM":
        raise ValueError("its times are dates; give seconds, or another unit, as numbers")
    return np.array(reals(array), dtype=float)


def _faults(spec: SignalSpec, times: np.ndarray, values: np.ndarray) -> Iterator[str]:
    """What is wrong with the data."""
    least = 3 if spec.kind == "cubic" and spec.outside == "periodic" else 2
    if times.ndim != 1 or len(times) < least:
        yield f"times of shape {times.shape}; give a row of {least} or more"
    elif values.shape != (len(times), *spec.shape):
        yield f"values of shape {values.shape} where {(len(times), *spec.shape)} is due"
    elif not (np.isfinite(times).all() and np.isfinite(values).all()):
        yield "times and values must be finite"
    elif not (np.diff(times) > 0).all():
        k = int(np.argmin(np.diff(times) > 0))
        yield f"{float(times[k + 1])!r} behind {float(times[k])!r}; give increasing times"
    elif spec.outside == "periodic" and spec.kind != "previous" and (values[0] != values[-1]).any():
        yield (
            f"it begins with {values[0].tolist()} and ends with {values[-1].tolist()}; a periodic "
            "signal must end with its first value"
        )


def blank(specs: Sequence[SignalSpec], shown: float = 0.0) -> list[np.ndarray]:
    """Constant pieces with value ``shown``."""
    rows = [np.zeros(spec.size) for spec in specs]
    for spec, row in zip(specs, rows, strict=True):
        row[1 : 1 + prod(spec.shape)] = shown
    return rows


def placeholder(spec: SignalSpec) -> Samples:
    """Dummy data, for a model made only to check its parameters."""
    times = np.arange(4.0)
    return Samples(spec, times, np.zeros((4, *spec.shape)))
