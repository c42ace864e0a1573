"""Calls of rules from Python, by ctypes.

Arguments are checked, and packed as :data:`.code.ENTRY` takes them, by code that is generated for
each rule.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .code import Kind, Placed

#: Numbers: to C, and packed into eight bytes.
C_TYPES = {"float": ctypes.c_double, "int": ctypes.c_int64, "bool": ctypes.c_bool}
PACKED = {"float": "d", "int": "q", "bool": "?7x"}

#: Arrays: the type of their elements, and how many axes they have.
REAL_TYPE, WHOLE_TYPE = np.dtype("f8"), np.dtype("i8")
ARRAY_TYPES = {
    "Floats": (REAL_TYPE, 1),
    "Matrix": (REAL_TYPE, 2),
    "Ints": (WHOLE_TYPE, 1),
    "Table": (WHOLE_TYPE, 2),
}

#: Tuples of arrays whose structs are kept, for those who hand on the same again and again.
TUPLES = 32

#: Of no length, at the place of what is contiguous and may be written; others are refused.
EMPTY = ctypes.c_char * 0

#: What packs the arguments of a rule, and what owns them.
PACK = """
def pack({names}):
{lines}
    return packed({values}), ({names},)
"""


class Call:
    """A rule as Python calls it."""

    def __init__(self, placed: Placed) -> None:
        rule, entry, self._owner = placed
        self.__name__ = rule.name
        self._pack = _packing(rule.kinds)
        self._entry = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_char_p)(entry)
        self._room, self._read = _results(rule.result)

    def __call__(self, *given: Any) -> Any:
        return self._run(self._room(), *self._pack(*given))

    def held(self, *given: Any) -> Callable[[], Any]:
        """The call with some arguments, to be made again and again; numbers are as they are now.

        Raises
        ------
        TypeError
            If an array is of another type, has other axes, is not contiguous or not to be written.
        """
        return partial(self._run, self._room(), *self._pack(*given))

    def _run(self, out: Any, args: bytes, _: Any) -> Any:
        if self._entry(ctypes.byref(out), args):
            raise RuntimeError(f"the rule {self.__name__} has failed")
        return self._read(out)


def held(rule: Callable[..., Any], *given: Any) -> Callable[[], Any]:
    """The call of a rule with some arguments, to be made again and again."""
    return rule.held(*given) if isinstance(rule, Call) else partial(rule, *given)


def _packing(kinds: Sequence[Kind], owners: str = "", size: str = "") -> Callable[..., Any]:
    """Code that packs values of some kinds; an array as its owners, length, element size, address
    and axes.

    For the arguments of a rule, the owners and the element size are put in by :data:`.code.ENTRY`.
    """
    names = [f"a{place}" for place in range(len(kinds))]
    known: dict[str, Any] = {"refuse": refuse, "AT": EMPTY, "address": ctypes.addressof}
    known |= {"REAL": REAL_TYPE, "WHOLE": WHOLE_TYPE}
    lines, values, packed = [], [], ""
    for a, kind in zip(names, kinds, strict=True):
        if not isinstance(kind, str):
            known[f"struct_{a}"] = Struct(kind)
            lines.append(f"{a} = struct_{a}({a})")
            values.append(f"{a}.address")
            packed += "q"
        elif kind in PACKED:
            values.append(a)
            packed += PACKED[kind]
        else:
            of, axes = ARRAY_TYPES[kind]
            name = "REAL" if of is REAL_TYPE else "WHOLE"
            lines.append(f"if {a}.dtype is not {name} or {a}.ndim != {axes}:")
            lines.append(f"    refuse({a}, {name}, {axes})")
            where = f"{size}address(AT.from_buffer({a}))"
            values.append(f"{owners}{a}.size, {where}, *{a}.shape, *{a}.strides")
            packed += "q" * (2 + 2 * axes + owners.count(",") + size.count(","))
    text = "\n".join(f"    {line}" for line in lines)
    known["packed"] = struct.Struct(packed).pack
    exec(PACK.format(names=", ".join(names), lines=text, values=", ".join(values)), known)
    return known["pack"]  # type: ignore[no-any-return]


def refuse(value: Any, of: Any, axes: int) -> None:
    """Raise TypeError if an array is of another type or has other axes."""
    if not isinstance(value, np.ndarray) or value.dtype != of or value.ndim != axes:
        raise TypeError(f"an array of {of} with {axes} axes is asked for, not {value!r}")


class Made(NamedTuple):
    """The struct of a tuple, and what it points to."""

    address: int
    owned: tuple[Any, ...]


class Struct:
    """Makes structs of tuples of one kind, in which an array has seven numbers and more."""

    def __init__(self, kind: Kind) -> None:
        self.name, parts = kind
        self._pack = _packing(parts, owners="0, 0, ", size="8, ")
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
        packed, owned = self._pack(*given)
        made_of = bytearray(packed)
        return Made(ctypes.addressof(EMPTY.from_buffer(made_of)), (made_of, given, owned))


def _results(kinds: Any) -> tuple[Any, Callable[[Any], Any]]:
    """Room for what a rule returns, and what reads it."""
    if not kinds:
        return ctypes.c_void_p, lambda out: None
    if isinstance(kinds, str):
        return C_TYPES[kinds], lambda out: out.value
    names = [f"n{place}" for place in range(len(kinds))]
    fields = [(name, C_TYPES[kind]) for name, kind in zip(names, kinds, strict=True)]
    layout = type("Result", (ctypes.Structure,), {"_fields_": fields})
    return layout, lambda out: tuple([getattr(out, name) for name in names])
