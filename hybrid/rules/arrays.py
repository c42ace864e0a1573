"""Names for what rules take, in annotations: from these their machine code gets its types."""

from __future__ import annotations

from typing import Any, NamedTuple

#: Contiguous arrays of ``float64``, with one axis or two.
Floats = Any
Matrix = Any

#: Contiguous arrays of ``int64``, with one axis or two.
Ints = Any
Table = Any


class Programs(NamedTuple):
    """A model as data: programs one behind the other, which :mod:`.jets` reads.

    Attributes
    ----------
    index : Table
        For each program a row: where its part of the arrays below begins and where it ends, of
        ``ops``, ``kinks``, ``output`` and ``flow``.
    ops, more : Table, Ints
        Operations, and lists of arguments that they point to.
    numbers : Floats
        What does not move.
    kinks : Table
        What is watched: its row; 1 where another formula holds beyond a zero of it, else 0; its
        kind; and the row of the function that it was made of (:mod:`.kinks`).
    bands : Matrix
        Between which values of its argument what is watched is more than rounding.
    output : Ints
        Rows that are asked for, besides the states.
    flow : Ints
        The derivative of each state; none in a program that is for values only.
    affine : Ints
        For each output 1 if it is affine in time and state, else 0.
    """

    index: Table
    ops: Table
    more: Ints
    numbers: Floats
    kinks: Table
    bands: Matrix
    output: Ints
    flow: Ints
    affine: Ints
