"""What a model's functions read besides their arguments: globals, closures, class attributes.

A function is traced once, when its class is defined, and the values it reads then become constants
of the model. A value that changes later would be ignored silently, and a value that differs from
call to call (a random number, the time, a counter) would be frozen. Both are reported to the
author.
"""

from __future__ import annotations

import dis
import inspect
import types
from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np

#: Packages whose functions, written in Python, read what is no part of a model.
LIBRARIES = ("jax", "numpy")

#: Packages whose functions are taken to be pure ...
PURE = (*LIBRARIES, "math", "cmath", "builtins", "operator", "functools", "hybrid")

#: ... except those with this in their names.
RANDOM = "random"

#: Types whose values are immutable.
IMMUTABLE = (int, float, complex, str, bytes, bool, type(None), np.generic)

#: Longest repr of a value, in characters, that a message shows.
SHOWN_CHARACTERS = 40

#: Depth to which containers and objects are compared.
COMPARED_DEPTH = 3


def takes(function: Any, name: str) -> bool:
    """Whether a function of a model has a parameter of that name."""
    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


@attrs.frozen(eq=False)
class Captured:
    """A name that a function reads, with its value when the class was made.

    Attributes
    ----------
    function : function
        The function that reads it.
    name : str
    owner : type or None
        The class whose attribute it is; None for a global or a closure variable.
    value : object
        A copy (see :func:`_copy`).
    """

    function: Any
    name: str
    owner: type | None
    value: Any

    def change(self) -> str | None:
        """A clause that says what has changed since; None if nothing has."""
        now = _look_up(self.function, self.name, self.owner)
        if now is self.value or (self.value is OPAQUE and isinstance(now, types.ModuleType)):
            return None
        now = _copy(now)
        if _same(self.value, now):
            return None
        then, now = repr(self.value), repr(now)
        if max(len(then), len(now)) > SHOWN_CHARACTERS:
            return f"{self.name} has changed since the class was made"
        return f"{self.name} was {then} when the class was made and is {now} now"


class _Missing:
    """Stands for a name without a value."""

    def __repr__(self) -> str:
        return "undefined"


class _Opaque:
    """Stands for a value that is not compared."""


MISSING, OPAQUE = _Missing(), _Opaque()


def captured(cls: type | None, function: Any) -> Iterator[Captured]:
    """All outer names that a function reads, directly or through functions that it calls."""
    for read in _reads(cls, function, set()):
        yield Captured(*read, _copy(_look_up(*read)))


def values(cls: type | None, function: Any) -> Iterator[tuple[str, Any]]:
    """Names and current values that a function reads."""
    for read in _reads(cls, function, set()):
        yield read[1], _look_up(*read)


def may_vary(cls: type, function: Any) -> list[str]:
    """Names that could make two calls with the same arguments differ."""
    reads = list(_reads(cls, function, set()))
    readers = dict.fromkeys([function, *(reader for reader, _, _ in reads)])
    found = [name for reader in readers for name in _stores(reader)]
    found += [name for reader, name, own in reads if _varies(reader, _look_up(reader, name, own))]
    return list(dict.fromkeys(found))


def _varies(reader: types.FunctionType, value: Any) -> bool:
    if isinstance(value, (*IMMUTABLE, types.FunctionType, np.ndarray)):
        return False
    if isinstance(value, list | dict | set):  # could hold a counter
        return True
    module = value.__name__ if isinstance(value, types.ModuleType) else _module(value)
    pure = module.split(".")[0] in PURE and RANDOM not in module
    return not pure or (module == "numpy" and RANDOM in _all_names(reader.__code__))


def _module(value: Any) -> str:
    """The module of a function or class; for an object or a bound method, that of its class."""
    owner = getattr(value, "__self__", None)
    if owner is not None and not isinstance(owner, types.ModuleType):
        return type(owner).__module__
    module = getattr(value, "__module__", None)
    return module if isinstance(module, str) else type(value).__module__


def _reads(
    cls: type | None, function: Any, seen: set[int]
) -> Iterator[tuple[types.FunctionType, str, type | None]]:
    """Yield (function, name, owning class) for every read, called functions included."""
    function = inspect.unwrap(getattr(function, "__func__", function))  # e.g. of jax.jit
    if not isinstance(function, types.FunctionType) or id(function) in seen:
        return
    seen.add(id(function))
    if _module(function).split(".")[0] in LIBRARIES:
        return
    found: list[tuple[str, type | None]] = [(name, None) for name in _outer_names(function)]
    found += [(name, cls) for name in _all_names(function.__code__) if _is_attribute(cls, name)]
    for name, owner in found:
        yield function, name, owner
        value = _look_up(function, name, owner)
        inner = value.fget if isinstance(value, property) else value
        yield from _reads(cls, inner, seen)


def _outer_names(function: types.FunctionType) -> list[str]:
    """Globals and closure variables that a function reads."""
    names = dict.fromkeys(function.__code__.co_freevars)
    names.update(dict.fromkeys(n for n in _globals(function.__code__) if n in function.__globals__))
    return list(names)


def _is_attribute(cls: type | None, name: str) -> bool:
    """Whether a name is an attribute or method that the author gave the class."""
    owner = next((base for base in getattr(cls, "__mro__", ()) if name in vars(base)), None)
    if owner is None or owner.__module__.split(".")[0] in ("hybrid", "builtins"):
        return False
    return isinstance(
        vars(owner)[name], (*IMMUTABLE, np.ndarray, list, tuple, dict, types.FunctionType, property)
    )


def _look_up(function: types.FunctionType, name: str, owner: type | None) -> Any:
    if owner is not None:
        bases = (vars(base) for base in owner.__mro__)
        return next((own[name] for own in bases if name in own), MISSING)
    if name in function.__code__.co_freevars:
        cell = (function.__closure__ or ())[function.__code__.co_freevars.index(name)]
        try:
            return cell.cell_contents
        except ValueError:  # not assigned yet
            return MISSING
    return function.__globals__.get(name, MISSING)


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _globals(code: types.CodeType) -> list[str]:
    """Names read as globals rather than as attributes."""
    instructions = (i for inner in _codes(code) for i in dis.get_instructions(inner))
    return [i.argval for i in instructions if i.opname in ("LOAD_GLOBAL", "LOAD_NAME")]


def _all_names(code: types.CodeType) -> list[str]:
    """Names of globals and attributes."""
    return list(dict.fromkeys(name for inner in _codes(code) for name in inner.co_names))


def _stores(function: Any) -> list[str]:
    """Globals and closure variables that a function assigns."""
    code = getattr(function, "__code__", None)
    if code is None:
        return []
    instructions = (i for inner in _codes(code) for i in dis.get_instructions(inner))
    changed = [i.argval for i in instructions if i.opname in ("STORE_GLOBAL", "STORE_DEREF")]
    return [name for name in changed if name not in code.co_cellvars]


def _copy(value: Any, depth: int = COMPARED_DEPTH) -> Any:
    """A snapshot that stays comparable if the original value is mutated."""
    if isinstance(value, (*IMMUTABLE, _Missing)):
        return value
    if isinstance(value, types.FunctionType):
        return _code_of(value.__code__)
    if hasattr(value, "__array__") and hasattr(value, "dtype"):
        return OPAQUE if value.dtype == object else np.array(value)
    if depth and isinstance(value, list | tuple):
        return tuple(_copy(v, depth - 1) for v in value)
    if depth and isinstance(value, dict):
        return {k: _copy(v, depth - 1) for k, v in value.items()}
    if depth and hasattr(value, "__dict__") and not isinstance(value, type | types.ModuleType):
        return {k: _copy(v, depth - 1) for k, v in vars(value).items()}
    return OPAQUE


def _code_of(code: types.CodeType) -> tuple[Any, ...]:
    """What a function does, independent of its position in the file."""
    constants = (_code_of(c) if isinstance(c, types.CodeType) else c for c in code.co_consts)
    return code.co_code, code.co_names, *map(repr, constants)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.shape == other.shape and np.array_equal(one, other, equal_nan=_is_real(one))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray) or type(one) is not type(other):
        return False
    return bool(one == other) or (one != one and other != other)


def _is_real(array: np.ndarray) -> bool:
    return bool(np.issubdtype(array.dtype, np.inexact))
