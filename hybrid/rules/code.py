"""Machine code as it is kept in files: put where it can run, and called from Python.

numba compiles the rules and does no more: to import it, and to have it load what it keeps itself,
takes longer than most runs. What is kept of a rule is its object file, the symbol under which it
stands there, and the kinds of its arguments and of its result. A kind is an annotation or, of a
tuple with names, its name and the kinds of its parts.
"""

from __future__ import annotations

import ctypes
import hashlib
import marshal
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

#: What an argument is to C, which is how numba hands on a number; arrays are the type of their
#: elements and the number of their axes.
NUMBERS = {"float": ctypes.c_double, "int": ctypes.c_int64, "bool": ctypes.c_bool}
ARRAYS = {"Floats": ("f8", 1), "Matrix": ("f8", 2), "Ints": ("i8", 1), "Table": ("i8", 2)}

#: Tuples of arrays whose structs are kept, for those who hand on the same again and again.
TUPLES = 32

#: Bytes of the hash of a file's content.
DIGEST = 32

Kind = Any


class Rule(NamedTuple):
    """A rule as it is kept.

    Attributes
    ----------
    name, symbol : str
        By which it is called, and what stands in the object file.
    kinds : tuple
    result : str or tuple of str
        Kinds of the numbers that it returns; none where it returns nothing.
    needs : tuple of str
        Functions that it calls, of other rules or of the system.
    code : bytes
    """

    name: str
    symbol: str
    kinds: tuple[Kind, ...]
    result: Any
    needs: tuple[str, ...]
    code: bytes


class Unit(NamedTuple):
    """What is kept of a file: the files that it calls, and its rules."""

    calls: tuple[str, ...]
    rules: tuple[Rule, ...]


# -- files ----------------------------------------------------------------------------------


def write(path: Path, unit: Unit) -> None:
    """Write a unit's file, whole or not at all."""
    body = marshal.dumps((unit.calls, tuple(map(tuple, unit.rules))))
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as draft:
        draft.write(hashlib.sha256(body).digest() + body)
    os.replace(draft.name, path)


def read(path: Path) -> Unit:
    """A unit's file.

    Raises
    ------
    OSError
        If it is not as it was written: LLVM does not look.
    """
    written = path.read_bytes()
    digest, body = written[:DIGEST], written[DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        raise OSError(f"{path} is damaged: remove it, and the rules are compiled again")
    calls, rules = marshal.loads(body)
    return Unit(calls, tuple(Rule(*rule) for rule in rules))


# -- LLVM -----------------------------------------------------------------------------------


@cache
def binding() -> Any:
    """LLVM, ready to make code for this machine."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


@cache
def processor() -> tuple[str, str]:
    """The name of this processor, and what it can do."""
    llvm = binding()
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def machine() -> Any:
    """What makes code for this machine."""
    triple = binding().Target.from_default_triple()
    return triple.create_target_machine(*processor(), opt=1, jit=True)


def engine(codes: Iterable[bytes]) -> Any:
    """Object files put where they can run, as long as this lives; what they call must be there."""
    llvm = binding()
    made = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    for code in codes:
        made.add_object_file(llvm.ObjectFileRef.from_data(code))
    made.finalize_object()
    return made


def missing(needs: Iterable[str]) -> list[str]:
    """Those functions that are not in this process."""
    llvm = binding()
    return [name for name in needs if llvm.address_of_symbol(name) is None]


class Placed(NamedTuple):
    """A rule where it can run, as long as its owner lives."""

    rule: Rule
    address: int
    owner: Any


@cache
def placed(path: Path) -> tuple[Placed, ...]:
    """The rules of a file, and before them what they call, put where they can run.

    Each has a name in this process under which others call it (:func:`symbol`).

    Raises
    ------
    ImportError
        If a function that they call is not in this process.
    """
    unit = read(path)
    for called in unit.calls:
        placed(path.with_name(called + path.suffix))
    if absent := missing(name for rule in unit.rules for name in rule.needs):
        raise ImportError(f"the rules {path.stem!r} call {', '.join(absent)}: not in this process")
    own = engine(rule.code for rule in unit.rules)
    found = [Placed(rule, own.get_function_address(rule.symbol), own) for rule in unit.rules]
    for rule, address, _ in found:
        binding().add_symbol(symbol(path, rule.name), address)
    return tuple(found)


def symbol(path: Path, name: str) -> str:
    """The symbol of a rule."""
    return f"{path.parent.name}.{path.stem}.{name}"


# -- calls ----------------------------------------------------------------------------------


class Call:
    """A rule as Python calls it.

    Arguments are handed on as numba has arranged them: of an array seven numbers and more, of a
    tuple of arrays the address of a struct of them.
    """

    def __init__(self, placed: Placed) -> None:
        rule, address, self._owner = placed
        self.__name__ = rule.name
        self._takes = [_taking(kind) for kind in rule.kinds]
        kinds = [ctypes.c_void_p] * 2 + [part for kind in rule.kinds for part in _types(kind)]
        self._function = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(address)
        self._result, self._given = _results(rule.result)

    def __call__(self, *given: Any) -> Any:
        return self.held(*given)()

    def held(self, *given: Any) -> Callable[[], Any]:
        """The call with some arguments, to be made again and again; numbers are as they are now.

        Raises
        ------
        TypeError
            If an array is of another type, has other axes, is not contiguous or not to be written.
        """
        flat: list[Any] = []
        owned: list[Any] = []
        for take, value in zip(self._takes, given, strict=True):
            take(value, flat, owned)
        return partial(self._call, self._result(), flat, owned)

    def _call(self, out: Any, flat: Sequence[Any], owned: Sequence[Any]) -> Any:
        if self._function(ctypes.byref(out), None, *flat):
            raise RuntimeError(f"the rule {self.__name__} has failed")
        return self._given(out)


def _types(kind: Kind) -> list[Any]:
    """What an argument of a kind is to C."""
    if not isinstance(kind, str):
        return [ctypes.c_void_p]
    return [NUMBERS[kind]] if kind in NUMBERS else [ctypes.c_int64] * (5 + 2 * ARRAYS[kind][1])


@cache
def _taking(kind: Kind) -> Callable[[Any, list[Any], list[Any]], None]:
    """What puts an argument of a kind among those of the call, and what it owns aside."""
    if not isinstance(kind, str):
        struct = Struct(kind)

        def take(value: Any, flat: list[Any], owned: list[Any]) -> None:
            made = struct(value)
            flat.append(made.address)
            owned.append(made)

    elif kind in NUMBERS:

        def take(value: Any, flat: list[Any], owned: list[Any]) -> None:
            flat.append(value)

    else:

        def take(value: Any, flat: list[Any], owned: list[Any]) -> None:
            flat += _numbers(value, *ARRAYS[kind])
            owned.append(value)

    return take


_NOTHING = ctypes.c_char * 0


def _numbers(value: Any, of: str, axes: int) -> tuple[int, ...]:
    """An array as numba hands it on: two that own it, its length, the size of an element, where
    they are, and its shape and strides."""
    if value.dtype != of or value.ndim != axes:
        raise TypeError(f"an array of {of} with {axes} axes is asked for, not {value!r}")
    where = ctypes.addressof(_NOTHING.from_buffer(value))
    return (0, 0, value.size, 8, where, *value.shape, *value.strides)


class Made(NamedTuple):
    """The struct of a tuple, and what it points to."""

    address: int
    owned: tuple[Any, ...]


class Struct:
    """Makes structs of tuples of one kind."""

    def __init__(self, kind: Kind) -> None:
        self.name, parts = kind
        self._takes = [_taking(part) for part in parts]
        self._layout = ctypes.c_int64 * sum(len(_types(part)) for part in parts)
        self._kept: dict[int, Made] = {}

    def __call__(self, given: Any) -> Made:
        made = self._kept.get(id(given))
        if made is None:
            made = self._make(given)
            if len(self._kept) >= TUPLES:
                self._kept.clear()
            self._kept[id(given)] = made
        return made

    def _make(self, given: Any) -> Made:
        if type(given).__name__ != self.name:
            raise TypeError(f"a tuple {self.name} is asked for, not {type(given).__name__}")
        flat: list[Any] = []
        owned: list[Any] = [given]
        for take, value in zip(self._takes, given, strict=True):
            take(value, flat, owned)
        struct = self._layout(*flat)
        return Made(ctypes.addressof(struct), (struct, *owned))


def _results(kinds: Any) -> tuple[Any, Callable[[Any], Any]]:
    """Room for what a rule returns, and what reads it."""
    if not kinds:
        return ctypes.c_void_p, lambda out: None
    if isinstance(kinds, str):
        return NUMBERS[kinds], lambda out: out.value
    names = [f"n{place}" for place in range(len(kinds))]
    fields = [(name, NUMBERS[kind]) for name, kind in zip(names, kinds, strict=True)]
    layout = type("Result", (ctypes.Structure,), {"_fields_": fields})
    return layout, lambda out: tuple([getattr(out, name) for name in names])


def held(rule: Callable[..., Any], *given: Any) -> Callable[[], Any]:
    """The call of a rule with some arguments, to be made again and again."""
    return rule.held(*given) if isinstance(rule, Call) else partial(rule, *given)
