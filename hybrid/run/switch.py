"""What happens on the surface of a switching: cross, slide, or refuse to choose (rule 8).

On the surface each of the two flows goes to one side: that of the first derivative of the
surface function along it that is not zero.
"""

from __future__ import annotations

import numpy as np

from ..errors import DomainError, StartError
from ..scene import Field, Guard, Scene
from .entry import describe, heading


def onward(
    scene: Scene, field: Field, guard: Guard, t: float, x: np.ndarray, reach: float, starting: bool
) -> str:
    """The mode that follows where a flow has reached the surface of a switching.

    Raises
    ------
    StartError, DomainError
        If the state would slide and the switching forbids it, or on two surfaces at once; or if
        nothing decides where it goes.
    """
    where, name = describe(scene, field, t, x), guard.edge
    kind = StartError if starting else DomainError
    switching = scene.spec.switching(name)
    if scene.spec.sliding(field.mode) is not None:
        raise kind(
            f"{where}: a state that slides reached the surface of {name} too; sliding on two "
            "surfaces at once is not known yet: declare an edge from "
            f'"{field.mode}" with this surface as its guard'
        )
    order, _ = heading(scene, t, field.mode, x, name, reach)
    other, sign = heading(scene, t, guard.to, x, name, reach)
    inside = 1 if guard.to == switching.positive else -1
    if sign == inside:
        return guard.to
    if sign == 0 or order > 1 < other:
        raise kind(
            f"{where}: on the surface of {name} neither flow leads away, and no first derivative "
            "decides whether the state slides; start beside the surface"
        )
    if not switching.slides:
        raise kind(
            f"{where}: on the surface of {name} both flows lead to it and slides=False; declare "
            "slides=True, or two edges with a hysteresis between them"
        )
    return switching.mode
