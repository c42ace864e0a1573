"""Tuples of arrays as rules hand them on in machine code: the address of a struct with them.

numba hands on each number of each array, seven of them and more: a rule with an automaton, a state
and room to work in has 250 arguments then, which are copied at every call.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils, typing
from numba.core.datamodel.models import OpaqueModel
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.extending import infer_getattr, register_model


class Reference(types.Type):  # type: ignore[misc]
    """The address of a tuple with names, ``named``, whose elements are of the types ``parts``."""

    def __init__(self, named: type, parts: tuple[Any, ...]) -> None:
        self.named, self.parts = named, parts
        super().__init__(f"Reference({named.__module__}.{named.__qualname__}{parts})")


@cache
def reference(named: type, parts: tuple[Any, ...]) -> Reference:
    """The type of what Python hands on as such a tuple."""
    return Reference(named, parts)


register_model(Reference)(OpaqueModel)


@infer_getattr
class Attributes(typing.templates.AttributeTemplate):  # type: ignore[misc]
    """The types of a tuple's elements, by their names."""

    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:
        return dict(zip(kind.named._fields, kind.parts, strict=True)).get(name)  # type: ignore[attr-defined]


@lower_getattr_generic(Reference)  # type: ignore[untyped-decorator]
def _element(context: Any, builder: Any, kind: Reference, value: Any, name: str) -> Any:
    """An element, of which what is used is read."""
    place = kind.named._fields.index(name)  # type: ignore[attr-defined]
    layout = _layout(context, kind)
    address = _place(builder, builder.bitcast(value, layout.as_pointer()), place)
    found = _read(builder, address, layout.elements[place])
    return impl_ret_borrowed(context, builder, kind.parts[place], found)


def _layout(context: Any, kind: Reference) -> ir.LiteralStructType:
    return ir.LiteralStructType([context.get_value_type(part) for part in kind.parts])


def _place(builder: Any, address: Any, place: int) -> Any:
    return cgutils.gep_inbounds(builder, address, 0, place)


def _read(builder: Any, address: Any, layout: Any) -> Any:
    """What stands at an address, number by number: nobody writes there while a rule runs."""
    if not isinstance(layout, ir.LiteralStructType | ir.ArrayType):
        number = builder.load(address)
        number.set_metadata("invariant.load", builder.module.add_metadata([]))
        return number
    found = ir.Constant(layout, ir.Undefined)
    for place, part in enumerate(layout.elements):
        found = builder.insert_value(
            found, _read(builder, _place(builder, address, place), part), place
        )
    return found
