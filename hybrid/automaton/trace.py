"""Traces a model's functions as jaxprs, once for all readers.

Every flow, guard and reset is traced once, when its class is defined, in 64 bits and with the
parameters as inputs, so that changing a parameter retraces nothing. All traces have the signature
``(parameters, t, x, *extra)``, where ``parameters`` is a tuple of arrays in declared order and
``x`` the state vector.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import TraceError
from .captured import may_vary, takes, values
from .chance import Draw
from .discrete import require_kind, traced
from .past import Past, asking
from .signals import Present
from .spec import Spec

Traced = Callable[..., Any]


def wide() -> Any:
    """A context in which JAX uses 64 bits; the user's global setting is unchanged."""
    import jax

    return jax.enable_x64(True)


def instance(cls: type, names: Sequence[str], values: Sequence[Any]) -> Any:
    """A model built without validators, so that it may hold tracers."""
    model: Any = object.__new__(cls)
    for name, value in zip(names, values, strict=True):
        object.__setattr__(model, name, value)
    return model


def caller(
    cls: type,
    spec: Spec,
    function: Callable[..., Any],
    lags: Sequence[int] = (),
    past: Callable[..., Any] = Past,
) -> Traced:
    """The author's ``function(self, t, s, ...)`` with the signature of this module.

    For a function that takes ``past``, ``lags`` are the indices of its lags, and ``past(spec, t,
    windows, lags)`` makes the object it is given.
    """
    count, given = len(spec.parameters), spec.signals
    names = spec.given

    def call(parameters: Any, t: Any, x: Any, *extra: Any) -> Any:
        own, windows = parameters[: len(names)], parameters[len(names) :]
        record = past(spec, t, windows, lags)
        seeing = asking(function, record)
        state = spec.record(x, traced)
        more = {"draw": Draw(state)} if takes(function, "draw") else {}
        now = [Present(*each) for each in zip(given, [t] * len(given), own[count:], strict=True)]
        return seeing(instance(cls, names, (*own[:count], *now)), t, state, *extra, **more)

    return call


def vector(spec: Spec, call: Traced, rates: bool) -> Traced:
    """``call`` with its result (tuple, record, dict) flattened to a state vector.

    With ``rates`` the result is a flow's, and discrete variables get rate zero.
    """

    def flat(parameters: Any, t: Any, x: Any, *extra: Any) -> Any:
        import jax.numpy as jnp

        result, parts = call(parameters, t, x, *extra), []
        values = spec.values(result, spec.record(x, traced))
        if rates:
            spec.require_rates(result)
        for state, value in zip(spec.states, values, strict=True):
            if rates and state.kind:
                parts.append(jnp.zeros(state.size))
                continue
            array = real_valued(jnp.asarray(value), f"{state.name}: ")
            require_kind(state.name, state.kind, array.dtype)
            if array.shape != state.shape:
                raise ValueError(f"{state.name}: shape {array.shape} where {state.shape} is due")
            parts.append(array.astype(float).reshape(-1))
        return jnp.concatenate(parts)

    return flat


def scalar(call: Traced) -> Traced:
    """``call`` with its result checked to be one real number."""

    def one(parameters: Any, t: Any, x: Any, *extra: Any) -> Any:
        import jax.numpy as jnp

        value = real_valued(jnp.asarray(call(parameters, t, x, *extra)), "")
        if value.shape != ():
            raise ValueError(f"a value of shape {value.shape} where one number is due")
        if value.dtype == bool:
            raise ValueError(
                "a guard is a number, not a truth value: write the difference whose zero is the "
                "event (s.x - 1.0), or jnp.where(condition, 1.0, -1.0)"
            )
        return value.astype(float)

    return one


def condition(call: Traced) -> Traced:
    """``call`` as a number: a truth value becomes 1 or -1; a number is unchanged."""

    def number(*given: Any) -> Any:
        import jax.numpy as jnp

        value = jnp.asarray(call(*given))
        return jnp.where(value, 1.0, -1.0) if value.dtype == bool else value

    return scalar(number)


def real_valued(array: Any, name: str) -> Any:
    """``array``, refused if it is complex."""
    if np.issubdtype(array.dtype, np.complexfloating):
        raise ValueError(f"{name}a complex value where a real one is due")
    return array


def trace(spec: Spec, call: Traced, extra: int = 0, shapes: Sequence[Any] | None = None) -> Any:
    """The closed jaxpr of ``call``; inputs: parameters, ``t``, ``x``, then ``extra`` numbers.

    Parameters
    ----------
    shapes : sequence of tuple, optional
        Shapes of the parameters and windows; by default those of the parameters' defaults.
    """
    import jax

    if shapes is None:
        shapes = [*(np.shape(parameter.default) for parameter in spec.parameters), *spec.windows]
    with wide():
        real = np.dtype(np.float64)
        inputs = tuple(jax.ShapeDtypeStruct(shape, real) for shape in shapes)
        number = jax.ShapeDtypeStruct((), real)
        state = jax.ShapeDtypeStruct((spec.dimension,), real)
        return jax.make_jaxpr(call)(inputs, number, state, *[number] * extra)


def again(closed: Any) -> Traced:
    """A closed jaxpr as a function that JAX can trace again, for example to differentiate it."""
    from jax.extend.core import jaxpr_as_fun

    function = jaxpr_as_fun(closed)

    def call(parameters: Any, t: Any, x: Any, *extra: Any) -> Any:
        return function(*parameters, t, x, *extra)[0]

    return call


def require_wide(cls: type, closed: Any, function: Callable[..., Any]) -> None:
    """Refuse a trace that contains a 32-bit number.

    Raises
    ------
    TraceError
        Names the captured constant. It was rounded to 32 bits before this package saw it, so its
        digits are lost.
    """
    narrow = next(_narrow(closed), None)
    if narrow is None:
        return
    name = _captured_name(cls, function, narrow)
    what = f"the constant {name!r}" if name else f"a constant or cast of type {narrow.dtype}"
    raise TraceError(
        f"{what} has only 32 bits; make it a Python float, a numpy array or a hy.parameter"
    )


def _narrow(closed: Any) -> Iterator[Any]:
    """Constants and values of fewer than 64 bits in a closed jaxpr, nested ones included."""
    for constant in closed.consts:
        if _is_narrow(constant):
            yield constant
    for equation in closed.jaxpr.eqns:
        for value in (*equation.invars, *equation.outvars):
            if _is_narrow(value.aval):
                yield getattr(value, "val", value.aval)
        for inner in equation.params.values():
            if hasattr(inner, "jaxpr") and hasattr(inner, "consts"):
                yield from _narrow(inner)


def require_real(closed: Any) -> None:
    """Refuse a function that computes complex numbers or random keys, or that prints.

    Raises
    ------
    TraceError
        Names the author's line.
    """
    for equation in closed.jaxpr.eqns:
        if not equation.outvars:
            raise TraceError(
                f"a call of Python without a result ({line_of(equation)}the primitive "
                f"{equation.primitive.name!r}); leave it out; run(t) and @hy.output show values"
            )
        if equation.primitive.name == "scatter" and not _sets(equation):
            raise TraceError(
                f"x.at[i].apply(f) ({line_of(equation)}the primitive 'scatter'); write "
                "x.at[i].set(f(x[i]))"
            )
        kinds = [getattr(var.aval, "dtype", None) for var in equation.outvars]
        if not all(isinstance(kind, np.dtype) and kind.kind in "fiub" for kind in kinds):
            keys = any(not isinstance(kind, np.dtype) for kind in kinds if kind is not None)
            what, instead = (
                (
                    "a random key",
                    "resets and restitutions may ask draw.uniform() of an argument draw",
                )
                if keys
                else ("a complex number", "write real and imaginary parts as two numbers")
            )
            primitive = equation.primitive.name
            raise TraceError(f"{what} ({line_of(equation)}the primitive {primitive!r}); {instead}")
        inner = (value for value in equation.params.values() if hasattr(value, "consts"))
        for each in inner:
            require_real(each)


def _sets(equation: Any) -> bool:
    """Whether a scatter puts in what it is given: else it applies a function to what is there."""
    update = equation.params["update_jaxpr"]
    update = getattr(update, "jaxpr", update)
    return update is None or update.outvars[0] is update.invars[1]


def line_of(equation: Any) -> str:
    """The author's line behind an equation; empty if JAX does not know it."""
    from jax.extend.source_info_util import summarize

    found = re.match(r"(.+?):(\d+)", str(summarize(equation.source_info)))
    return f"{Path(found[1]).name}:{found[2]}, " if found else ""


def _is_narrow(value: Any) -> bool:
    kind = str(getattr(value, "dtype", ""))
    return kind in ("float32", "float16", "bfloat16", "complex64")


def _captured_name(cls: type, function: Callable[..., Any], constant: Any) -> str | None:
    value = getattr(constant, "shape", None) is not None and hasattr(constant, "__array__")
    for name, held in values(cls, function):
        if not _is_narrow(held):
            continue
        if held is constant or not value or np.array_equal(np.asarray(held), np.asarray(constant)):
            return name
    return None


def require_repeatable(
    cls: type, spec: Spec, call: Traced, extra: int, closed: Any, function: Callable[..., Any]
) -> None:
    """Refuse a function that gives a different trace when it is traced again."""
    names = may_vary(cls, function)
    if not names:
        return
    second = trace(spec, lambda *given: call(*given), extra)  # the lambda defeats JAX's trace cache
    pairs = zip_longest(_constants(closed), _constants(second))
    if str(closed.jaxpr) != str(second.jaxpr) or not all(_equal(*pair) for pair in pairs):
        raise TraceError(
            f"asked twice for the same t and s it gives two answers, by {' or '.join(names)} (a "
            "random number, a clock, a counter?); a model's functions are read once, when its "
            "class is made, and must depend on t, s and parameters only"
        )


def _equal(one: Any, other: Any) -> bool:
    """Whether two constants are the same; NaN is the same as NaN."""
    a, b = np.asarray(one), np.asarray(other)
    return a.shape == b.shape and bool(np.all((a == b) | ((a != a) & (b != b))))


def _constants(closed: Any) -> Iterator[Any]:
    """Constants and literals of a closed jaxpr, nested ones included."""
    yield from closed.consts
    for equation in closed.jaxpr.eqns:
        yield from (value.val for value in equation.invars if hasattr(value, "val"))
        for inner in equation.params.values():
            if hasattr(inner, "jaxpr") and hasattr(inner, "consts"):
                yield from _constants(inner)
