"""Many contacts in one line: a gap that is an array is as many contacts, each with its name."""

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
    """How many contacts a gap is; None for one number, and where tracing it will tell a fault."""
    import jax.numpy as jnp

    spec = Spec(cls.__name__, tuple(states), parameters, (), (), "", signals=signals, cls=cls)
    call = caller(cls, spec, gap, past=Asking)
    try:
        (found,) = trace(spec, lambda *given: jnp.asarray(call(*given))).out_avals
    except Exception:  # whatever the author's code raises is told when it is traced for good
        return None
    return found.shape[0] if len(found.shape) == 1 else None


def elements(contact: ContactSpec, count: int) -> list[ContactSpec]:
    """The contacts that one declared with an array of gaps is."""
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
    """One element of what a function gives; a number, where that is ``common`` to all, as it is."""

    @wraps(function)
    def element(*given: Any, **past: Any) -> Any:
        import jax.numpy as jnp

        values = jnp.asarray(function(*given, **past))
        if values.shape != (count,) and values.shape not in common:
            raise ValueError(f"a {what} of shape {values.shape} where {(count,)} is due")
        return values[i] if values.ndim else values

    return element
