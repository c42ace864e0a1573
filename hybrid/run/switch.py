"""What happens on the surface of a switching: cross it, slide, or refuse to choose (rule 8)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import DomainError, HybridError, StartError
from ..lowering import Field, Guard
from ..lowering.automaton import DIRECTIONS
from ..rules import unit
from ..rules.switches import CROSSES, UNSETTLED
from .entry import Jumped, departed, heading, jumped_over
from .limits import pass_limit
from .noting import add_jump

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from .driver import Driver


def meet(driver: Driver, guard: Guard, x: StateVector, carried: bool) -> None:
    """Reach the surface of a switching: enter the other mode, or slide. One that has jumped over
    the state (``carried``) is crossed."""
    scene, here = driver.scene, driver.entry.field
    slides = scene.spec.sliding(here.mode) is not None
    if carried and not slides and jumped_over(scene, here, guard, driver.place, x):
        driver.interrupt(guard.edge, guard.to, x, x)
        if not (add_jump(driver, guard.edge, x, x) and pass_limit(driver, guard.to)):
            driver.enter(guard.to, x, Jumped())
        return
    mode = onward(driver, guard, x)
    field = driver.scene.field(mode)
    if field.project is not None:
        where, x = driver.where(x), np.array(field.project(driver.t, x.tolist()))
        if not np.isfinite(x).all():  # both flows go along the surface, to rounding
            raise _unsettled(driver, where, guard.edge)
        driver.record.end_on(x)
    driver.interrupt(guard.edge, mode, x, x)
    if add_jump(driver, guard.edge, x, x) and pass_limit(driver, mode):
        return
    driver.enter(mode, x, Jumped(vanishing(guard, field)))


def leave(driver: Driver, guard: Guard, x: StateVector, carried: bool) -> None:
    """Sliding ends. In the mode that follows, the surface function and its rate vanish, but where
    a flow, or the surface, has jumped (``carried``)."""
    overdue = carried or bool(driver.entry.at_once) or driver.forgets
    driver.interrupt(guard.edge, guard.to, x, x)
    add_jump(driver, guard.edge, x, x)
    known = vanishing(guard, driver.scene.field(guard.to))
    known = dict.fromkeys(known, 1) if overdue else known
    gone = carried and departed(driver.scene, guard, driver.place, x)
    driver.enter(guard.to, x, Jumped({} if gone else known))


def vanishing(guard: Guard, field: Field) -> dict[str, int]:
    """By edge, the power of the time by which the surface function vanishes in the field after a
    jump from the surface; empty while the state slides."""
    if guard.kind == "leave":
        return {guard.edge.rpartition(".")[0]: 2}
    return {guard.edge: 1} if field.project is None else {}


def onward(driver: Driver, guard: Guard, x: StateVector) -> str:
    """The mode that follows when a flow has reached the surface of a switching.

    Raises
    ------
    StartError, DomainError
        If the state would slide and the switching forbids it, or on two surfaces at once; or if
        nothing decides what follows.
    """
    scene, mode, name = driver.scene, driver.entry.field.mode, guard.edge
    at, where, kind = driver.t, driver.where(x), _kind(driver)
    switching = scene.spec.switching(name)
    if scene.spec.sliding(mode) is not None:
        raise kind(
            f"{where}: a state that slides reached the surface of {name} too; sliding on two "
            "surfaces at once is not known yet: declare an edge from "
            f'"{mode}" with this surface as its guard'
        ).by("undecided")
    order, _ = heading(scene, at, mode, x, name, driver.seen)
    across = heading(scene, at, guard.to, x, name, driver.seen)
    follows = unit("switches").goes(order, *across, DIRECTIONS[guard.crossing])
    if follows == CROSSES:
        return guard.to
    if follows == UNSETTLED:
        raise _unsettled(driver, where, name)
    if not switching.slides:
        raise kind(
            f"{where}: on the surface of {name} both flows lead to it and slides=False; declare "
            "slides=True, or two edges with a hysteresis between them"
        ).by("undecided")
    return switching.mode


def _kind(driver: Driver) -> type[StartError | DomainError]:
    return StartError if driver.t == driver.plan.t0 else DomainError


def _unsettled(driver: Driver, where: str, name: str) -> HybridError:
    return _kind(driver)(
        f"{where}: on the surface of {name} neither flow leads away, and no first derivative "
        "decides whether the state slides; start beside the surface"
    ).by("undecided")
