"""The first variation through an accumulation of impacts (:mod:`hybrid.rules.limits`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import OrbitError, TraceError
from ..rules import unit
from ..rules.limits import USABLE
from ..zeno.accumulate import Tail
from .derivatives import Derivatives
from .slopes import SlopeTables


class LimitVariation(NamedTuple):
    """Derivatives of a limit of impacts by the state after the first impact of the tail.

    The last ``q`` columns belong to the parameters, or to directions of them.

    Attributes
    ----------
    matrix : array, shape (n, n + q)
        Variation of the state at equal times. Its rank is ``n - 2``: gap and gap speed are zero
        at rest.
    time, state, ratio : array, shapes (n + q,), (n, n + q) and (n + q,)
        Variation of the time of the limit, of the state there, and of the ratio of the series.
    """

    matrix: np.ndarray
    time: np.ndarray
    state: np.ndarray
    ratio: np.ndarray


def through(of: Derivatives, tail: Tail, directions: np.ndarray | None = None) -> LimitVariation:
    """The first variation through an accumulation of impacts, from the tail's first impact.

    Parameters
    ----------
    directions : array, shape (q, m), optional
        Directions in parameter space; by default each parameter is one.

    Raises
    ------
    OrbitError
        If the impacts of the tail do not depend smoothly on its start.
    """
    where = f"mode {tail.field.name}, t = {tail.t!r}"
    tables, guard = SlopeTables(of), tail.field.guards[tail.column]
    try:
        row = tables.contact(tail.field, guard)
    except TraceError as error:
        raise OrbitError(f"{where}: no derivative of the limit is known: {error}") from None
    chosen = np.zeros((0, 0)) if directions is None else np.ascontiguousarray(directions)
    columns = of.columns - 1 if directions is None else of.size + chosen.shape[1]
    out, size = np.empty((2 * of.size + 2, columns)), of.size
    start = tail.t, tail.x, tail.v, tail.r, tail.remaining, tail.curve, tail.x_inf
    with tail.programs() as (programs, sums):
        about = programs, 0, 1, tail.column, tail.field.project is not None
        room = tables.room(chosen.shape[1])
        given = *about, tables.slopes, row, *start, chosen, sums, room, out
        left = unit("limits").limit(*given)
    if not left <= USABLE:
        raise OrbitError(
            f"{where}: the derivative of the limit of the impacts "
            f"of {tail.contact.name} is not resolved (it changes by {left:.2g} of its size)"
        )
    return LimitVariation(out[1 + size : -1], out[0], out[1 : 1 + size], out[-1])
