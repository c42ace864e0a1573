"""Why an author's code is refused, in words of the author's rather than of JAX."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from attrs.exceptions import FrozenInstanceError

from ..errors import TraceError

#: What to say where JAX could not trace an author's code: by the kind of fault, and by its text.
BY_KIND = {
    "TracerBoolConversionError": "a choice by the value of a state, time or parameter: write "
    "jnp.where(condition, a, b) for `if`, jnp.maximum for `max`, or two modes",
    "TracerArrayConversionError": "a numpy function of a state, time or parameter: use the "
    "one of jax.numpy",
    "ConcretizationTypeError": "float() or a function of math of a state, time or parameter: "
    "use that of jax.numpy",
    "TracerIntegerConversionError": "an index by value: write jnp.where, or index by a constant",
}
BY_TEXT = {
    r"Tracer has no attribute '?(\w+)": r"a number has no attribute '\1': the arguments are "
    r"(self, t, s), in this order",
    r"Only integer scalar arrays|cannot be interpreted as an integer": "range() or an index by the "
    "value of a state or parameter: make it a number that is fixed with the class (N = 3)",
    r"in-place item assignment": "an array does not change in place: y = y.at[i].set(value) "
    "for y[i] = value",
    r"not a valid JAX array type|not a valid value for jnp.array": "it returns something that is "
    "no number: return numbers, or arrays of them",
}


def reason(fault: Exception) -> str:
    """Why an author's function could not be traced, in one line."""
    kind, text = type(fault).__name__, str(fault).split("\n")[0]
    if kind in BY_KIND:
        return f"{kind}: {BY_KIND[kind]}"
    for pattern, said in BY_TEXT.items():
        found = re.search(pattern, text)
        if found:
            return found.expand(said)
    if isinstance(fault, ValueError | TraceError | UnchangingError):
        return text
    return f"{kind}: {text}"


def misplaced(function: Any, arguments: Sequence[str]) -> bool:
    """Whether a function has these arguments after ``self``, in another order."""
    names = list(inspect.signature(function).parameters)[1 : len(arguments) + 1]
    return names != list(arguments) and sorted(names) == sorted(arguments)


def unknown_parameter(cls: type, name: str, known: Iterable[str]) -> str:
    """What to say to a parameter that a class does not have."""
    if hasattr(cls, name) and not callable(getattr(cls, name)):
        value = getattr(cls, name)
        return (
            f"{cls.__name__}.{name} is an attribute of the class, not a parameter: declare it as "
            f"{name} = hy.parameter({value!r})"
        )
    return f"{cls.__name__} has no parameter {name!r}; there are: {', '.join(known) or 'none'}"


class UnchangingError(FrozenInstanceError):
    """A model was to be changed."""

    def __init__(self, said: str) -> None:
        AttributeError.__init__(self)
        self.said = said

    def __str__(self) -> str:
        return self.said


def unchanging(self: Any, name: str, value: Any) -> NoReturn:
    """The ``__setattr__`` of a model."""
    model = type(self).__name__
    raise UnchangingError(
        f"{model}.{name} = ...: a model does not change; make another one, "
        f"attrs.evolve(model, {name}=...), or declare what changes as a state or hy.discrete"
    )
