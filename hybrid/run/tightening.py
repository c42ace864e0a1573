"""Absolute tolerances of the steps in a cycle of jumps that shrinks.

Its flights fall below any absolute tolerance before the limit is known, and what steps then lose
hides the law by which they fall. So the absolute tolerances are held to the relative one of how far
the guards' states still move, until the cycle is over.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..rules.ties import MOST_LOST
from ..solvers.base import LEAST_ATOL

if TYPE_CHECKING:
    from .cycles import Seen
    from .driver import Driver


def tighten(driver: Driver) -> None:
    """Hold the absolute tolerances to the flights of the last turn, if it was shorter than the one
    before; otherwise go back to those that were asked for."""
    if driver.losses.exact:
        return
    length = driver.cycles.period
    jumps = driver.cycles.last(2 * length + 1) if length else []
    turn = jumps[length:]
    shrinks = length and turn[0].until(turn[-1]) < jumps[0].until(turn[0])
    moved = _moved(driver, turn) if shrinks else np.empty(0)
    allowed = driver.plan.rtol * float(moved.min(initial=np.inf))
    _tolerate(driver, min(1.0, allowed / driver.asked.limit))


def _moved(driver: Driver, turn: list[Seen]) -> np.ndarray:
    """How far the flights of a turn have moved the states that its guards are made of, by the rates
    with which they began; no state that has stayed."""
    moved, uses = np.zeros(len(turn[0].x)), set[int]()
    for jump, later in pairwise(turn):
        field = driver.scene.field(later.mode)
        moved = np.maximum(moved, jump.until(later) * np.abs(field.flow(jump.t, jump.x)))
        uses = uses.union(*(guard.uses for guard in field.guards if guard.edge == later.edge))
    own = moved[sorted(uses)]
    return own[own > 0.0]


def _tolerate(driver: Driver, share: float) -> None:
    """Give steps a share of the absolute tolerances that were asked for. What steps have lost is
    counted in tolerances: of smaller ones it is more."""
    atol, losses = np.maximum(share * driver.asked.atol, LEAST_ATOL), driver.losses
    if np.array_equal(atol, driver.plan.atol):
        return
    driver.solver.atol = driver.solver.atol * (atol / driver.plan.atol)
    lost, driver.plan = losses.tolerances * losses.share, attrs.evolve(driver.plan, atol=atol)
    losses.plan = driver.plan
    losses.tolerances = min(lost / losses.share, MOST_LOST)
    if driver.loop is not None:
        driver.loop.tolerate()
