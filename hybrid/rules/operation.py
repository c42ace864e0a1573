"""One operation of a tape, of which :mod:`hybrid.lowering.native` makes programs.

It is never called: where its numbers are known, all but a few of its instructions fall away.
"""

from __future__ import annotations

from .arrays import Floats, Ints, Matrix
from .operations import operate

__all__ = ("operation",)

#: A product and a sum are never one operation: a program's own machine code gives the same bits.
EXACT = True

#: This is kept in LLVM's language, and called by nobody.
TEXT = True


def operation(
    op: int,
    out: int,
    a: int,
    b: int,
    d: int,
    e: int,
    more: Ints,
    s: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
    k: int,
) -> None:
    """As :func:`.operations.operate`."""
    operate(op, out, a, b, d, e, more, s, sides, c, work, k)
