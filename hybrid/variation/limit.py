"""The first variation through an accumulation of impacts (:mod:`hybrid.rules.limits`)."""

from __future__ import annotations

import attrs
import numpy as np

from ..errors import OrbitError, TraceError
from ..rules import unit
from ..rules.limits import USABLE
from ..zeno.accumulate import Tail
from .derivatives import Derivatives
from .saltation import Saltation
from .slopes import SlopeTables


@attrs.frozen(eq=False)
class LimitVariation:
    """Derivatives of a limit of impacts by the state after the first impact of the tail.

    The last ``q`` columns belong to the parameters, or to directions of them.

    Attributes
    ----------
    saltation : Saltation
        Variation of the state at equal times. Its rank is ``n - 2``: gap and gap speed are zero
        at rest.
    time, state, ratio : array, shapes (n + q,), (n, n + q) and (n + q,)
        Variation of the time of the limit, of the state there, and of the ratio of the series.
    """

    saltation: Saltation
    time: np.ndarray
    state: np.ndarray
    ratio: np.ndarray


def through(
    of: Derivatives,
    tail: Tail,
    directions: np.ndarray | None = None,
    incoming: np.ndarray | None = None,
) -> LimitVariation:
    """The first variation through an accumulation of impacts, from the tail's first impact.

    Parameters
    ----------
    directions : array, shape (q, m), optional
        Directions in parameter space; by default each parameter is one.
    incoming : array, shape (n, m), optional
        The change of the state, at equal times, with which the sum begins, a column for each
        parameter or direction: what is left of a derivative may be small beside what comes of that.

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
    columns, size = of.columns if directions is None else 1 + of.size + chosen.shape[1], of.size
    out = np.empty((2 * size + 2, columns))
    start = tail.t, tail.x, tail.v, tail.r, tail.remaining, tail.curve, tail.x_inf
    flow = tail.field.flow(tail.t, tail.x)
    across = of.guard(guard, tail.field)(tail.t, tail.x)[0, 1:]
    if directions is not None:
        across = np.append(across[:size], across[size:] @ chosen)
    first = -across / tail.v  # the first impact is so much later
    moved = _moved(first, flow, np.zeros((size, 0)) if incoming is None else incoming)
    with tail.programs() as (programs, sums):
        about = programs, 0, 1, tail.column, tail.field.project is not None
        room = tables.room(chosen.shape[1])
        given = *about, tables.slopes, row, *start, chosen, moved, sums, room, out
        left = unit("limits").limit(*given)
    if not left <= USABLE:
        raise OrbitError(
            f"{where}: the derivative of the limit of the impacts "
            f"of {tail.contact.name} is not resolved (it changes by {left:.2g} of its size)"
        )
    found = out[:, 1:], out[:, 0] + out[:, 1 : 1 + size] @ flow
    whole = found[0] + np.outer(found[1], first)
    rows = slice(1 + size, -1)
    saltation = Saltation(found[0][rows], found[1][rows], first)
    return LimitVariation(saltation, whole[0], whole[1 : 1 + size], whole[-1])


def _moved(first: np.ndarray, flow: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The change of time and state at the first impact, of one of the state at equal times."""
    count, size = min(change.shape[1], len(first) - len(flow)), len(flow)
    time = first[:size] @ change[:, :count] + first[size : size + count]
    return np.ascontiguousarray(np.vstack([time, change[:, :count] + np.outer(flow, time)]))
