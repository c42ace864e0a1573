"""Clocks: the firing times of an edge as functions of time and parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import attrs
import numpy as np

from ..errors import ParameterError
from .markers import Times, is_number
from .spec import ClockSpec, Spec

#: A time, or the name of a parameter.
Given = Any


def faults(times: Times, parameters: Sequence[str]) -> Iterator[str]:
    """What is wrong with the declared times of an edge, as far as their values are known."""
    if not (times.at is None or times.every is None):
        yield "at= together with every=; give one of them"
    named = [given for given in _given(times) if isinstance(given, str)]
    known = ", ".join(parameters) or "none"
    yield from (f"{n!r} is no parameter; there are: {known}" for n in named if n not in parameters)
    wrong = [given for given in _given(times) if not (isinstance(given, str) or is_number(given))]
    yield from (f"{given!r} is no time; give numbers or names of parameters" for given in wrong)
    if not _given(times):
        yield f"at={times.at!r}; give one time at least"
    elif not (named or wrong):
        yield from _disorder(times, {})


def _given(times: Times) -> list[Given]:
    """The given numbers and names, one by one."""
    if times.at is None:
        return [times.every, times.offset]
    return [times.at] if np.ndim(times.at) == 0 else list(times.at)


def _disorder(times: Times, named: dict[str, Any]) -> Iterator[str]:
    """What is wrong with times whose values are all known."""
    values = [np.ravel(named.get(g, g) if isinstance(g, str) else g) for g in _given(times)]
    if times.at is None:
        period = values[0]
        if not (period.size == 1 and float(period[0]) > 0.0):
            yield f"every={times.every!r} is {period.tolist()}; a period is one number above 0"
        if values[1].size != 1:
            yield f"offset={times.offset!r} is {values[1].tolist()}; give one number"
        return
    rows = np.concatenate(values).astype(float).tolist()
    pairs = [(a, b) for a, b in itertools.pairwise(rows) if not a < b]
    if pairs:
        yield f"at={times.at!r} has {pairs[0][1]!r} after {pairs[0][0]!r}; give increasing times"


def require_clocks(model: Any, spec: Spec) -> None:
    """Refuse parameter values that give a clock no valid times."""
    for edge in spec.transitions:
        named = _given(edge.times) if isinstance(edge, ClockSpec) else []
        own = {name: getattr(model, name) for name in named if isinstance(name, str)}
        if own and all(isinstance(v, float | int | np.ndarray | Sequence) for v in own.values()):
            for fault in _disorder(edge.times, own):  # type: ignore[union-attr]
                raise ParameterError(f"{spec.model}, edge {edge.name}: {fault}")


def disordered(spec: Spec, values: dict[str, Any]) -> int | None:
    """The first lane in which a clock's times do not increase; None if they do in all.

    ``values``: those of each parameter, one, or one for each lane.
    """
    for edge in spec.transitions:
        if isinstance(edge, ClockSpec) and edge.times.at is not None:
            each = [values[g] if isinstance(g, str) else g for g in _given(edge.times)]
            rows = [one for one in each if np.ndim(one) == 2]
            if rows or (len(each) > 1 and all(np.ndim(one) <= 1 for one in each)):
                times = rows[0] if rows else np.column_stack(np.broadcast_arrays(*each))
                wrong = np.flatnonzero(~np.all(np.diff(times) > 0.0, axis=1))
                if len(wrong):
                    return int(wrong[0])
    return None


def first_after(times: Times) -> Callable[..., Any]:
    """A model function: the first firing time after ``t``, infinite if there is none.

    Periodic times are ``k * period + offset`` for whole numbers k.
    """

    def periodic(self: Any, t: Any, s: Any) -> Any:
        import jax.numpy as jnp

        period, offset = (_value(self, given) for given in (times.every, times.offset))
        k = jnp.round((t - offset) / period)
        here = k * period + offset
        return jnp.where(here > t, here, (k + 1.0) * period + offset)

    def listed(self: Any, t: Any, s: Any) -> Any:
        import jax.numpy as jnp

        each = _listed(self, times)
        return jnp.min(jnp.where(each > t, each, math.inf))

    return periodic if times.at is None else listed


def from_nearest(times: Times) -> Callable[..., Any]:
    """A model function: the signed distance from ``t`` to the nearest firing time.

    It serves as the clock's guard where derivatives need one.
    """

    def periodic(self: Any, t: Any, s: Any) -> Any:
        import jax.numpy as jnp

        period, offset = (_value(self, given) for given in (times.every, times.offset))
        return jnp.round((t - offset) / period) * period + offset - t

    def listed(self: Any, t: Any, s: Any) -> Any:
        import jax.numpy as jnp

        ways = _listed(self, times) - t
        nearest = jnp.min(jnp.abs(ways))
        return jnp.max(jnp.where(jnp.abs(ways) == nearest, ways, -math.inf))

    return periodic if times.at is None else listed


def _value(model: Any, given: Given) -> Any:
    return getattr(model, given) if isinstance(given, str) else float(given)


def _listed(model: Any, times: Times) -> Any:
    import jax.numpy as jnp

    each = [jnp.ravel(jnp.asarray(_value(model, given), dtype=float)) for given in _given(times)]
    return jnp.concatenate(each)


def clock(spec: Any, times: Times) -> ClockSpec:
    """The edge ``spec`` as a clock with these times in place of a guard."""
    own = {f.name: getattr(spec, f.name) for f in attrs.fields(type(spec))}
    own |= {"guard": from_nearest(times), "after": first_after(times), "times": times}
    return ClockSpec(**own)
