"""Arrays of contacts: an array-valued gap declares one contact per element."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import attrs

from .past import Asking
from .signals import SignalSpec
from .spec import ContactSpec, ParameterSpec, Spec, StateSpec
from .trace import caller, trace


def length(
    cls: Any,
    states: Sequence[StateSpec],
    parameters: tuple[ParameterSpec, ...],
    signals: tuple[SignalSpec, ...],
    gap: Any,
) -> int | None:
    """Number of elements of an array gap; None for a scalar, or if tracing fails."""
    import jax.numpy as jnp

    spec = Spec(cls.__name__, tuple(states), parameters, (), (), "", signals=signals, cls=cls)
    call = caller(cls, spec, gap, past=Asking)
    try:
        (found,) = trace(spec, lambda *given: jnp.asarray(call(*given))).out_avals
    except Exception:  # any fault of the author's code is reported by the later trace
        return None
    return found.shape[0] if len(found.shape) == 1 else None


def elements(contact: ContactSpec, count: int) -> list[ContactSpec]:
    """One contact per element of an array of gaps."""
    names = tuple(f"{contact.name}[{i}]" for i in range(count))
    return [
        attrs.evolve(
            contact,
            name=name,
            guard=_element(contact.guard, i, count, "gap", ()),
            restitution=_element(contact.restitution, i, count, "restitution", ((),)),
            among=names,
        )
        for i, name in enumerate(names)
    ]


def _element(
    function: Callable[..., Any], i: int, count: int, what: str, common: tuple[Any, ...]
) -> Callable[..., Any]:
    """Element ``i`` of a function's result; a result of a shape in ``common`` is shared by all."""

    @wraps(function)
    def element(*given: Any, **past: Any) -> Any:
        import jax.numpy as jnp

        values = jnp.asarray(function(*given, **past))
        if values.shape != (count,) and values.shape not in common:
            raise ValueError(f"a {what} of shape {values.shape} where {(count,)} is due")
        return values[i] if values.ndim else values

    return element
